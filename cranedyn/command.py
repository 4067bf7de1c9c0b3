"""How every command ends: one sentence for what went wrong, quietly when interrupted; whoever stops
listening stops nothing.
"""

from __future__ import annotations

import _thread
import argparse
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from types import FrameType
from typing import Any, NoReturn

from cranedyn.errors import CraneError, printable

FAILED, REFUSED, INTERRUPTED = 1, 2, 130
"""Exit codes: a claim does not hold or a run failed; bad arguments or files; stopped by the
user."""


class Parser(argparse.ArgumentParser):
    """One whose errors cannot be ended by what they quote, and that takes no ``--`` for a value,
    which argparse would leave out.
    """

    def error(self, message: str) -> NoReturn:
        """Say what is wrong, on one line after the usage, and end with `REFUSED`."""
        super().error(printable(message))

    def parse_known_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:  # type: ignore[override]
        """As argparse does."""
        words = [*(sys.argv[1:] if args is None else args)]
        for word in words[: words.index("--") if "--" in words else None]:
            if re.fullmatch(r"-[^=]*=--|-\w--", word):
                self.error(
                    f"argument {word.removesuffix('--').removesuffix('=')}: -- is not a value"
                )
        return super().parse_known_args(words, namespace)


def command(run: Callable[[], int]) -> int:
    """Run what stands behind a command line.

    A pipe that is closed or a full disk behind standard output, and letters that a terminal does
    not have, cost words but no files. SIGTERM is taken like Ctrl-C, so that drafts are removed and
    viewers ended.

    Args:
        run: Does it and returns the exit code.

    Returns:
        That code; `REFUSED` after a `CraneError`, whose sentence is printed; `INTERRUPTED` after
        Ctrl-C or SIGTERM.
    """
    try:
        with _interruptible(), _patient():
            try:
                return run()
            except KeyboardInterrupt as stop:
                print(str(stop) or "Interrupted.", file=sys.stderr)
                return INTERRUPTED
            except Exception as error:
                if interrupted(error):
                    print("Interrupted.", file=sys.stderr)
                    return INTERRUPTED
                if not isinstance(error, CraneError):
                    raise
                print(f"error: {error}", file=sys.stderr)
                return REFUSED
    except KeyboardInterrupt:  # before it began, or when all was said
        return INTERRUPTED
    finally:
        # Python kills its own process at the end if an interruption once fell into the text of an
        # exec (that of a dataclass, say), even one that was caught since; the next text forgets it.
        exec("")


def interrupted(error: BaseException | None) -> bool:
    """Whether an error came of an interruption that some library took for a fault of its own."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None


@contextmanager
def held_back() -> Iterator[Callable[[], bool]]:
    """Hold Ctrl-C back while code of others calls functions of ours, through which it takes no
    exception.

    Yields:
        Whether it has come, so that the functions may ask the others to end.

    Raises:
        KeyboardInterrupt: At the end, if it has come.
    """
    came: list[int] = []
    main = threading.current_thread() is threading.main_thread()
    handlers = _handlers() if main else {}
    ours = {
        number: handler
        for number, handler in handlers.items()
        if handler is signal.default_int_handler or isinstance(handler, _Interrupt)
    }
    for number in ours:
        signal.signal(number, lambda number, _: came.append(number))
    try:
        yield lambda: bool(came)
    finally:
        for number, handler in ours.items():
            signal.signal(number, handler)
    if came:
        raise KeyboardInterrupt


@contextmanager
def _interruptible() -> Iterator[None]:
    main = threading.current_thread() is threading.main_thread()
    before = _handlers() if main else {}
    ours = [
        number
        for number, handler in before.items()
        if handler in (signal.SIG_DFL, signal.default_int_handler)
    ]
    interrupt = _Interrupt()
    for number in ours:
        signal.signal(number, interrupt)

    def again(lost: sys.UnraisableHookArgs) -> None:
        # What interrupts code in which nothing can be raised would be lost.
        if lost.exc_type is KeyboardInterrupt and ours:
            _thread.start_new_thread(_interrupt_later, (ours[0],))
        else:
            sys.__unraisablehook__(lost)

    hook, sys.unraisablehook = sys.unraisablehook, again
    try:
        yield
    finally:
        sys.unraisablehook = hook
        for number in ours:
            signal.signal(number, before[number])


def _handlers() -> dict[signal.Signals, Any]:
    return {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}


class _Interrupt:
    """Raises KeyboardInterrupt, but not into an import, whose ``except`` may take it for a module
    that is missing: there it waits, though not for ever.
    """

    def __init__(self) -> None:
        self._tries = 1000

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """As a handler of signals is called."""
        while frame and not frame.f_code.co_filename.startswith("<frozen importlib"):
            frame = frame.f_back
        self._tries -= 1
        if not frame or self._tries < 0:
            raise KeyboardInterrupt
        _thread.start_new_thread(_interrupt_later, (signal.Signals(number),))


def _interrupt_later(number: signal.Signals) -> None:
    time.sleep(0.01)
    _thread.interrupt_main(number)


@contextmanager
def _patient() -> Iterator[None]:
    with ExitStack() as stack:
        out, err = (
            _Patient(stream or stack.enter_context(open(os.devnull, "w")))
            for stream in (sys.stdout, sys.stderr)
        )
        stack.enter_context(redirect_stdout(out))
        stack.enter_context(redirect_stderr(err))
        yield
        out.flush()
        err.flush()


class _Patient:
    """A stream that goes on when nobody takes what is written, as all of a stream but these two
    methods.
    """

    def __init__(self, stream: Any) -> None:
        self._stream = stream
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")

    def write(self, text: str) -> int:
        self._try(lambda: self._stream.write(text))
        return len(text)

    def flush(self) -> None:
        self._try(self._stream.flush)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def _try(self, say: Callable[[], object]) -> None:
        try:
            say()
        except OSError as error:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)
            if not isinstance(error, BrokenPipeError):
                print(f"Some words could not be written: {error.strerror}.", file=sys.stderr)
