"""One engine for all generators: a case is the name of a generator and a number, from which its
input and the verdict on it follow.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random
from types import FrameType
from typing import Any, NamedTuple, Protocol

ROOT = Path(__file__).resolve().parents[3]
"""Root of the repository."""

OURS = ("cranedyn", "experiments")
"""Folders whose promises are tested."""

BUDGET, PATIENCE = 2.0, 2.0
"""Processor time after which a case is interrupted, and in which it must then end [s]."""


class Case(NamedTuple):
    """An input: what a generator drew, made of plain values."""

    head: Any
    parts: list[Any]


class Generator(Protocol):
    """A kind of input.

    Attributes:
        name: Name of the kind.
        weight: Share of the cases, beside the other kinds.
        interruptible: Whether a case may run until it is interrupted; else a case of more than
            `BUDGET` is broken.
    """

    @property
    def name(self) -> str:
        """Name of the kind."""

    @property
    def weight(self) -> float:
        """Share of the cases."""

    @property
    def interruptible(self) -> bool:
        """Whether a case may take long."""

    def draw(self, rng: Random) -> Case:
        """Draw an input, the same for the same random numbers."""

    def attempt(self, case: Case, folder: Path) -> str:
        """Try the input in an empty folder; return in a word how it ended.

        Raises:
            Broken: If a promise is broken.
            BaseException: Whatever escapes breaks one, too.
        """

    def shown(self, case: Case) -> str:
        """Return the input as something to paste."""


class Broken(Exception):
    """A promise is broken although nothing was raised.

    Attributes:
        promise: The promise, in words that are the same for all inputs that break it alike.
    """

    def __init__(self, promise: str, detail: object = "") -> None:
        self.promise = promise
        super().__init__(f"{promise}: {detail}" if detail != "" else promise)


class TooLong(BaseException):
    """An interruption was not answered."""


class Verdict(NamedTuple):
    """Verdict on a case.

    Attributes:
        word: How it ended, for counting.
        place: Where a promise is broken; empty if none is.
        text: What happened there.
    """

    word: str
    place: str = ""
    text: str = ""


def drawn(generator: Generator, number: int) -> Case:
    """Return the input of a case."""
    return generator.draw(Random(f"{generator.name} {number}"))


def judged(generator: Generator, case: Case) -> Verdict:
    """Return the verdict on an input, tried in a folder of its own."""
    folder, home = Path(tempfile.mkdtemp(prefix="fuzz-")), os.getcwd()
    try:
        with _raw_output(folder) as output, _limited(BUDGET), warnings.catch_warnings():
            # An interruption between open and `with` leaves a file to be collected.
            warnings.simplefilter("ignore", ResourceWarning)
            verdict = _attempted(generator, case, folder)
        text = output()
    finally:
        os.chdir(home)
        shutil.rmtree(folder, ignore_errors=True)
    if text and not verdict.place:
        line = " ".join(re.sub(r"\x1b\[[0-9;]*m|\[[^]]*\]|\S*[0-9]\S*", "", text).split()[:5])
        return Verdict("broken", f"raw words beside ours: {line}", text[:500])
    return verdict


def _attempted(generator: Generator, case: Case, folder: Path) -> Verdict:
    work = folder / "work"
    work.mkdir()
    try:
        return Verdict(generator.attempt(case, work))
    except Broken as broken:
        return Verdict("broken", broken.promise, str(broken)[:2000])
    except KeyboardInterrupt as stop:
        if generator.interruptible:
            return Verdict("interrupted")
        return Verdict("broken", f"takes more than {BUDGET:g} s, {place_of(stop)}", _trace(stop))
    except BaseException as error:
        return Verdict("broken", place_of(error), _trace(error))


def _trace(error: BaseException) -> str:
    return "".join(traceback.format_exception(error, limit=-6))[-1500:]


def place_of(error: BaseException) -> str:
    """Return the kind of an exception, and the last line of ours through which it came."""
    paths = [(Path(one.filename), one) for one in traceback.extract_tb(error.__traceback__)]
    frames = [
        (path.relative_to(ROOT), frame)
        for path, frame in paths
        if path.is_relative_to(ROOT) and path.relative_to(ROOT).parts[0] in OURS
    ]
    kind = type(error).__name__
    if isinstance(error, TooLong):
        kind = f"Ctrl-C is not answered in {PATIENCE:g} s"
    if not frames:
        return f"{kind} in the fuzzer"
    path, frame = frames[-1]
    return f"{kind} at {path}:{frame.lineno} {frame.name}"


@contextmanager
def _limited(seconds: float) -> Iterator[None]:
    """Interrupt as Ctrl-C does after so much processor time [s]; raise `TooLong` if that is not
    answered.
    """
    before = signal.signal(signal.SIGPROF, _over)
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    _over.fired = False  # type: ignore[attr-defined]
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
        signal.signal(signal.SIGINT, handler)


def _over(number: int, frame: FrameType | None) -> None:
    if _over.fired:  # type: ignore[attr-defined]
        raise TooLong
    _over.fired = True  # type: ignore[attr-defined]
    signal.setitimer(signal.ITIMER_PROF, PATIENCE)
    signal.raise_signal(signal.SIGINT)


def interrupt_after(seconds: float) -> None:
    """Interrupt after so much more processor time [s] instead of at the end of the budget."""
    signal.setitimer(signal.ITIMER_PROF, seconds)


@contextmanager
def _raw_output(folder: Path) -> Iterator[Any]:
    """Keep what is written to the file descriptors of standard output and error past Python's
    streams.
    """
    with (folder / "raw").open("w+b") as file:
        copies = [(number, os.dup(number)) for number in (1, 2)]
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        try:
            for number, _ in copies:
                os.dup2(file.fileno(), number)
            yield lambda: (folder / "raw").read_bytes().decode(errors="replace")
        finally:
            for number, copy in copies:
                os.dup2(copy, number)
                os.close(copy)
