"""Command lines: arguments, exit codes, and what Ctrl-C, SIGTERM and errors end with."""

from __future__ import annotations

import argparse
import ctypes
import os
import re
import shlex
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cached_property
from importlib import import_module
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

from cranedyn.errors import CraneError, UnknownName, decimal_comma, nearest, printable

if TYPE_CHECKING:
    from concurrent.futures import Future

_Result = TypeVar("_Result")

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
        """Add the usage: positional arguments, and "[options]" for all options."""
        positional = [action for action in actions if not action.option_strings]
        if len(positional) < len(actions):
            positional.append(argparse.Action(["options"], "options", nargs=0))
        super().add_usage(usage, positional, (), prefix)

    def _get_help_string(self, action: argparse.Action) -> str | None:
        """Return the help of an option, with its default unless that is none or the help says
        it.
        """
        has_no_default = action.default in (None, False, [])
        if has_no_default or "default" in (action.help or ""):
            return action.help
        return super()._get_help_string(action)


class Parser(argparse.ArgumentParser):
    """A parser of arguments whose help begins with an example, and whose error message is one
    printable line.

    Attributes:
        example: A command line to begin with, by default the name of the program.
    """

    def __init__(self, *args: Any, example: str = "", **options: Any) -> None:
        """Set the example.

        Args:
            args: Positional arguments of `argparse.ArgumentParser`.
            example: A command line to begin with; empty for the name of the program.
            options: Keyword arguments of `argparse.ArgumentParser`.
        """
        # Also subparsers are made by this constructor, with arguments that argparse chooses.
        options.setdefault("formatter_class", _Help)
        super().__init__(*args, **options)
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
        # A cached property stands among the attributes once it has been asked for.
        has_common_options = "common" in vars(self)
        if has_common_options and "--help-all" not in args:
            for action in self.common._group_actions:
                action.help = argparse.SUPPRESS
        options, extras = super().parse_known_args(args, namespace)
        known: list[str] = []
        for action in self._actions:
            known += action.option_strings
        for extra in extras:
            if extra.startswith("-"):
                option = extra.partition("=")[0]
                self.error(
                    f"There is no option {option}{nearest(option, known)}; --help lists them."
                )
        return options, extras

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse a value that is none of the choices of an argument, with the nearest of them.

        argparse's own message lists the choices only.
        """
        if action.choices is not None and value not in action.choices:
            kind = str(action.metavar or "/".join(action.option_strings) or action.dest).lower()
            self.error(str(UnknownName(kind, value, action.choices)))

    def error(self, message: str) -> NoReturn:
        """Print the message and exit with `REFUSED`."""
        text = printable(message)
        invalid_value = _INVALID_VALUE.search(text)
        advice = "" if invalid_value is None else decimal_comma(invalid_value[1])
        if advice:
            # argparse ends its messages without a full stop.
            text = f"{text}.{advice}"
        self.exit(REFUSED, f"error: {text}\n")


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
            # Output is flushed here, where an error of it is seen; at its end Python would print a
            # traceback.
            try:
                code = run()
            except SystemExit:
                # argparse has printed a help or an error.
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
        # Libraries turn an interruption into errors of their own.
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


def command_line(*words: object) -> str:
    """Return words as a command line that a shell splits into these words."""
    return shlex.join(str(word) for word in words)


def open_line(page: str | Path) -> str:
    """Return the command line that opens a page or a film in the browser of this machine."""
    # Not every system takes a path: the browser of macOS is told an address.
    return command_line("python", "-m", "webbrowser", Path(page).absolute().as_uri())


def next_lines(*command_lines: str) -> str:
    """Return the lines that end the output of a command: what to run next, one line each.

    Args:
        command_lines: Command lines that work with what has just been written, the most useful
            first; a remark may follow behind a ``#``.
    """
    lines = []
    for i, line in enumerate(command_lines):
        lead = "Next: " if i == 0 else " " * len("Next: ")
        lines.append(lead + line)
    return "\n".join(lines)


def _output_is_broken() -> bool:
    """Return whether standard output does not take what has been printed."""
    try:
        # What was not written the first time is still in its buffer.
        print(end="", flush=True)
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
    """Delay Ctrl-C and SIGTERM to the end of the block.

    It is for native code that calls Python functions but passes no exception on, and for what must
    not be left half done.

    Yields:
        Function that returns whether a signal has arrived.
    """
    arrived: list[tuple[int, FrameType | None]] = []
    handlers: dict[int, Callable[[int, FrameType | None], Any]] = {}

    def note(number: int, frame: FrameType | None) -> None:
        arrived.append((number, frame))

    try:
        # Python lets the main thread alone set handlers, and runs them there.
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                handler = signal.getsignal(number)
                # The default action of the system, or none, is no function and stays.
                if callable(handler):
                    handlers[number] = handler
                    signal.signal(number, note)
        yield lambda: bool(arrived)
    finally:
        for replaced, former_handler in handlers.items():
            signal.signal(replaced, former_handler)
    # Not reached if the block has raised an error: that one counts. Several signals count as one.
    if arrived:
        first_number, frame = arrived[0]
        handlers[first_number](first_number, frame)


def defer_next_sigint(error: BaseException | None) -> AbstractContextManager[object]:
    """Delay Ctrl-C and SIGTERM to the end of the block if an error is that of an interruption.

    What the user stopped is kept in the block: the first Ctrl-C began that, and the next one waits.
    """
    return defer_sigint() if interrupted(error) else nullcontext()


def uninterrupted_import(name: str) -> Any:
    """Import a module and return it; Ctrl-C waits until it is there.

    Some packages take an interruption for a module that is missing, and go on without it.
    """
    with defer_sigint():
        return import_module(name)


@contextmanager
def side_thread(function: Callable[..., _Result], *arguments: Any) -> Iterator[Future[_Result]]:
    """Run a function in a thread beside the block, and wait for it at the end of the block.

    An error of the block, such as Ctrl-C, also ends the function, at its next instruction in
    Python: otherwise the process would wait until it is done. Native code that it has called goes
    on until it returns.

    Args:
        function: The function.
        arguments: Its arguments.

    Yields:
        Its result, to be asked for after the block.
    """
    from concurrent.futures import Future  # it takes long, and few commands need it

    future: Future[_Result] = Future()

    def run() -> None:
        """Give the future a result or an error."""
        try:
            future.set_result(function(*arguments))
        except SystemExit:  # from below; nobody asks for the result any more
            future.cancel()
        except BaseException as error:
            future.set_exception(error)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield future
        thread.join()
    except BaseException:
        # Of all errors, a thread passes over this one in silence, wherever it is raised.
        ctypes.pythonapi.PyThreadState_SetAsyncExc(
            ctypes.c_ulong(thread.ident or 0), ctypes.py_object(SystemExit)
        )
        thread.join()
        raise


@contextmanager
def _sigterm_as_interrupt() -> Iterator[None]:
    """Let SIGTERM raise KeyboardInterrupt in the block, unless it has a handler already."""
    is_main_thread = threading.current_thread() is threading.main_thread()
    is_replaced = is_main_thread and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    if is_replaced:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        if is_replaced:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
