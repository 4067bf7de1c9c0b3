"""Command lines: arguments, exit codes, and what Ctrl-C, SIGTERM and errors end with."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

from cranedyn.errors import CraneError, printable

FAILED, REFUSED, INTERRUPTED = 1, 2, 130
"""Exit codes: a claim does not hold or a run failed; bad arguments or files; stopped by the
user."""


class Parser(argparse.ArgumentParser):
    """A parser of arguments whose error message is one printable line."""

    def error(self, message: str) -> NoReturn:
        """Print usage and message, and exit with `REFUSED`."""
        super().error(printable(message))


def command(run: Callable[[], int]) -> int:
    """Run a command and turn errors and signals into messages and exit codes.

    SIGTERM raises KeyboardInterrupt like Ctrl-C, so that temporary files are removed and child
    processes ended.

    Args:
        run: Function that does the work and returns the exit code.

    Returns:
        That code; `REFUSED` after a `CraneError`, whose message is printed; `INTERRUPTED` after
        Ctrl-C or SIGTERM; `FAILED` if whoever reads standard output stops reading.
    """
    try:
        with _sigterm_as_interrupt():
            code = run()
            print(end="", flush=True)
            return code
    except BrokenPipeError:
        # Python flushes standard output at its end; see the note on SIGPIPE in its signal module.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
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
