"""Command lines: arguments, exit codes, and what Ctrl-C, SIGTERM and errors end with."""

from __future__ import annotations

import argparse
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from importlib import import_module
from types import FrameType
from typing import Any, NoReturn

from cranedyn.errors import CraneError, UnknownName, decimal_comma, nearest, printable

FAILED = 1
"""Exit code of a claim or a run that failed."""

REFUSED = 2
"""Exit code of arguments or files that are not what they must be."""

INTERRUPTED = 130
"""Exit code of what the user stopped: 128 and the number of the signal, as shells count."""


_INVALID_VALUE = re.compile(r"invalid \w+ value: ('[^']*')")
"""What argparse says of a value that a type refuses."""


class _Help(argparse.ArgumentDefaultsHelpFormatter):
    """Help with defaults that say something, and a usage without the options listed below it."""

    def add_usage(self, usage: Any, actions: Any, groups: Any, prefix: Any = None) -> None:
        """Add the usage: positional arguments alone."""
        positional = [action for action in actions if not action.option_strings]
        if len(positional) < len(actions):
            positional.append(argparse.Action(["options"], "options", nargs=0))
        super().add_usage(usage, positional, (), prefix)

    def _get_help_string(self, action: argparse.Action) -> str | None:
        said = action.default in (None, False, []) or "default" in (action.help or "")
        return action.help if said else super()._get_help_string(action)


class Parser(argparse.ArgumentParser):
    """A parser of arguments whose help begins with an example, and whose error message is one
    printable line.

    Attributes:
        example: A command line to begin with, by default the name of the program.
    """

    def __init__(self, *args: Any, example: str = "", **options: Any) -> None:
        """Set the example, and whatever else argparse takes."""
        super().__init__(*args, **{"formatter_class": _Help, **options})
        self.example = example or self.prog

    @cached_property
    def common(self) -> argparse._ArgumentGroup:
        """Group of options that --help leaves out and --help-all shows."""
        text = "show this help with the common options, such as those of the crane"
        self.add_argument("--help-all", action="help", help=text)
        return self.add_argument_group("common options")

    def format_help(self) -> str:
        """Return the help, the example first."""
        return f"example: {self.example}\n\n{super().format_help()}"

    def parse_known_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:  # type: ignore[override]
        """Parse as argparse does; an unknown option is an error of the command that it follows."""
        args = sys.argv[1:] if args is None else args
        if "common" in vars(self) and "--help-all" not in args:
            for action in self.common._group_actions:
                action.help = argparse.SUPPRESS
        options, extras = super().parse_known_args(args, namespace)
        for option in (extra.partition("=")[0] for extra in extras if extra.startswith("-")):
            known = [name for action in self._actions for name in action.option_strings]
            self.error(f"There is no option {option}{nearest(option, known)}; --help lists them.")
        return options, extras

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            kind = str(action.metavar or "/".join(action.option_strings) or action.dest).lower()
            self.error(str(UnknownName(kind, value, action.choices)))

    def error(self, message: str) -> NoReturn:
        """Print the message and exit with `REFUSED`."""
        text = printable(message)
        given = _INVALID_VALUE.search(text)
        advice = "" if given is None else decimal_comma(given[1])
        self.exit(REFUSED, f"error: {text}{'.' * bool(advice)}{advice}\n")


def command(run: Callable[[], int]) -> int:
    """Run a command and turn errors and signals into messages and exit codes.

    SIGTERM raises KeyboardInterrupt like Ctrl-C, so that temporary files are removed and child
    processes ended.

    Args:
        run: Function that does the work and returns the exit code.

    Returns:
        That code; `REFUSED` after a `CraneError`, whose message is printed, or if standard output
        cannot be written, such as on a full disk; `INTERRUPTED` after Ctrl-C or SIGTERM; `FAILED`
        if the reader of standard output stops reading.
    """
    try:
        with _sigterm_as_interrupt():
            try:
                code = run()
            except SystemExit:  # argparse has printed a help or an error
                print(end="", flush=True)
                raise
            print(end="", flush=True)
            return code
    except BrokenPipeError:
        _discard_output()
        return FAILED
    except KeyboardInterrupt as stop:
        print(str(stop) or "Interrupted.", file=sys.stderr)
        return INTERRUPTED
    except Exception as error:
        if interrupted(error):
            print("Interrupted.", file=sys.stderr)
            return INTERRUPTED
        if isinstance(error, OSError) and _output_is_broken():
            _discard_output()
            reason = error.strerror or error
            print(f"error: Cannot write to standard output: {reason}.", file=sys.stderr)
            return REFUSED
        if not isinstance(error, CraneError):
            raise
        print(f"error: {error}", file=sys.stderr)
        return REFUSED


def _output_is_broken() -> bool:
    """Return whether standard output does not take what has been printed."""
    try:
        print(end="", flush=True)  # what was not written the first time is still in its buffer
    except OSError:
        return True
    return False


def _discard_output() -> None:
    """Send standard output nowhere from now on.

    Python flushes it once more at its end; see the note on SIGPIPE in its signal module.
    """
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def interrupted(error: BaseException | None) -> bool:
    """Return whether an error was raised while a KeyboardInterrupt was handled."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None


@contextmanager
def defer_sigint() -> Iterator[Callable[[], bool]]:
    """Delay Ctrl-C and SIGTERM to the end of the block: for native code that calls Python functions
    but passes no exception on.

    Yields:
        Function that returns whether a signal has arrived.
    """
    arrived: list[tuple[int, FrameType | None]] = []
    handlers = {}
    try:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                if callable(handler := signal.getsignal(number)):
                    handlers[number] = handler
                    signal.signal(number, lambda *args: arrived.append(args))
        yield lambda: bool(arrived)
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    for args in arrived[:1]:
        handlers[args[0]](*args)  # type: ignore[index]


def uninterrupted_import(name: str) -> Any:
    """Import a module that would take an interruption for a module that is missing; return it."""
    with defer_sigint():
        return import_module(name)


@contextmanager
def _sigterm_as_interrupt() -> Iterator[None]:
    replaced = (
        threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    )
    if replaced:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        if replaced:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
