"""One engine for all generators: a case is the name of a generator and a number, from which its
input and the verdict on it follow.
"""

from __future__ import annotations

import gc
import os
import re
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from random import Random
from types import FrameType
from typing import Any, NamedTuple

import numpy as np

from cranedyn.errors import CraneError

BUDGET = 2.0
"""Processor time after which a case is interrupted [s]."""

PATIENCE = 2.0
"""Processor time in which a case must end once it is interrupted [s]."""

TICK = 0.01
"""Processor time between two signals of the timer [s].

The timer repeats its signal, since one may be lost: the system may hand it to another thread that
is busy without Python's lock, and CPython 3.11 does not tell the main thread of it then.
"""

NUMBERS = (
    "0 -0.0 -1 1e300 -1e300 1e-300 5e-324 nan inf -inf 1e400 1e-400 1e29 1e9 1e15 1e-9 0x10 1_0 ١ "
    "1e --1 1,5 +1 1. 99999999999999999999 1e5 x"
).split()
"""What may stand where a number is asked for."""

LETTERS = [
    *("", " ", "\0", "a\0b", "\udcff", "a" * 300, "a\nerror: forged", "\x1b[31m", "\u2028", "-"),
    *("ä" * 200, "${1/0}", "$(id)", "%s", "{0}", "..", "/"),
]
"""What may stand where a word is asked for."""


@dataclass(frozen=True)
class Generator:
    """A kind of input.

    Attributes:
        name: Name of the kind.
        draw: Draws a case, made of plain values, the same for the same random numbers.
        attempt: Tries a case in an empty folder and returns in a word how it ended; raises
            `Broken` if a promise is broken, and breaks one by whatever else it raises.
        long: Whether a case may run until it is interrupted; else one of more than `BUDGET` breaks
            a promise.
    """

    name: str
    draw: Callable[[Random], Any]
    attempt: Callable[[Any, Path], str]
    long: bool = False


class Broken(Exception):
    """A promise is broken although nothing was raised."""

    def __init__(self, promise: str, detail: object = "") -> None:
        super().__init__(f"{promise}: {detail}" if detail != "" else promise)


class TooLong(BaseException):
    """An interruption was not answered."""


class Verdict(NamedTuple):
    """How a case ended, in a word, and the promise that it broke; empty if it broke none."""

    word: str
    fault: str = ""


def drawn(generator: Generator, number: int) -> Any:
    """Return a case of a generator."""
    return generator.draw(Random(f"{generator.name} {number}"))


def judged(generator: Generator, case: Any) -> Verdict:
    """Return the verdict on a case, tried in a folder of its own."""
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    home = os.getcwd()
    (folder / "work").mkdir()
    try:
        with _raw_output(folder / "raw"), _limited(), warnings.catch_warnings():
            # An interruption between open and `with` leaves a file to be collected.
            warnings.simplefilter("ignore", ResourceWarning)
            verdict = _attempted(generator, case, folder / "work")
        raw = (folder / "raw").read_text("utf-8", "replace")
    finally:
        os.chdir(home)
        shutil.rmtree(folder, ignore_errors=True)
    return Verdict("broken", f"raw words beside ours: {raw[:500]}") if raw else verdict


def _attempted(generator: Generator, case: Any, folder: Path) -> Verdict:
    try:
        return Verdict(generator.attempt(case, folder))
    except KeyboardInterrupt as stop:
        interrupt_after(0.0)  # what follows is not the case's time, and may take long
        if generator.long:
            return Verdict("interrupted")
        return Verdict("broken", f"takes more than {BUDGET:g} s\n{_trace(stop)}")
    except TooLong as error:
        interrupt_after(0.0)
        return Verdict("broken", f"Ctrl-C is not answered in {PATIENCE:g} s\n{_trace(error)}")
    except BaseException as error:
        return Verdict("broken", _trace(error))


def _trace(error: BaseException) -> str:
    return "".join(traceback.format_exception(error, limit=-6))[-2000:]


def check_message(error: CraneError) -> None:
    """Return if an error is one printable sentence; else raise `Broken`."""
    if not (str(error).isprintable() and str(error).endswith(".")):
        raise Broken("an error that is no printable sentence", repr(str(error))) from None


def outcome(action: Callable[[], object]) -> str:
    """Return how an action ends, good or refused in one printable sentence."""
    try:
        action()
    except CraneError as error:
        check_message(error)
        return "refused"
    return "good"


def check_line(code: int, err: str) -> None:
    """Return if a command that ends with 2 said why on one line; else raise `Broken`."""
    lines = [line for line in err.splitlines() if not line.startswith(("usage: ", " "))]
    if code == 2 and not (len(lines) == 1 and re.match(r"(python -m [\w.]+: )?error: .", lines[0])):
        raise Broken("exit code 2 without one line that begins with error:", err)


@contextmanager
def _limited() -> Iterator[None]:
    """Interrupt as Ctrl-C does at the end of the budget; raise `TooLong` if nothing answers.

    What a callback of the garbage collector raises (Hypothesis has one), Python drops; so these
    are left alone, until a later signal of the timer finds none of them at work.
    """
    interrupted_at: float | None = None
    ended = False

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal interrupted_at
        now = time.process_time()
        if ended or (interrupted_at is not None and now < interrupted_at + PATIENCE):
            return
        collectors = {getattr(callback, "__code__", None) for callback in gc.callbacks}
        if not collectors.isdisjoint(f.f_code for f, _ in traceback.walk_stack(frame)):
            return
        first = interrupted_at is None
        interrupted_at = now
        if not first:
            raise TooLong
        signal.raise_signal(signal.SIGINT)

    before = signal.signal(signal.SIGPROF, interrupt)
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    interrupt_after(BUDGET)
    try:
        # An interruption within `numpy.linalg` may leave its handling of floating-point errors in
        # place; every case begins with the usual one.
        with np.errstate():
            yield
    finally:
        # Python hears a timer that has gone off already only after it was stopped.
        ended = True
        interrupt_after(0.0)
        signal.signal(signal.SIGPROF, before)
        signal.signal(signal.SIGINT, handler)


def interrupt_after(seconds: float) -> None:
    """Interrupt after so much more processor time [s] instead of at the end of the budget; after 0
    never.
    """
    signal.setitimer(signal.ITIMER_PROF, seconds, TICK)


@contextmanager
def _raw_output(path: Path) -> Iterator[None]:
    """Keep in a file what is written to standard output and error past Python's streams."""
    with path.open("wb") as file:
        copies = [(number, os.dup(number)) for number in (1, 2)]
        sys.stdout.flush()
        sys.stderr.flush()
        try:
            for number, _ in copies:
                os.dup2(file.fileno(), number)
            yield
        finally:
            for number, copy in copies:
                os.dup2(copy, number)
                os.close(copy)
