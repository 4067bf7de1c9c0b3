"""One engine for all generators: a case is the name of a generator and a number; from these come
its input and the verdict on it.
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
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from random import Random
from types import FrameType
from typing import Any, NamedTuple, Protocol

ROOT = Path(__file__).resolve().parents[3]
"""Where the repository is."""

OURS = ("cranedyn", "experiments")
"""The folders whose promises are tested."""

BUDGET, PATIENCE = 2.0, 2.0
"""Processor time after which a case is interrupted, and in which it must then end [s]."""


class Case(NamedTuple):
    """An input.

    Attributes:
        head: What stays when the smallest reproduction is looked for.
        parts: What may be left out, part by part.
    """

    head: Any
    parts: list[Any]


class Generator(Protocol):
    """A kind of input.

    Attributes:
        name: Of the kind.
        weight: How many are made of it, beside the others.
        interruptible: Whether a case may run until it is interrupted; else taking longer than
            `BUDGET` breaks a promise.
    """

    @property
    def name(self) -> str:
        """Of the kind."""

    @property
    def weight(self) -> float:
        """How many, beside the others."""

    @property
    def interruptible(self) -> bool:
        """Whether a case may take long."""

    def draw(self, rng: Random) -> Case:
        """An input, the same for the same random numbers; made of plain values, so that it can go
        to another process.
        """

    def attempt(self, case: Case, folder: Path) -> str:
        """Give the input to what it is meant for; how that ended, in a word.

        Args:
            case: The input.
            folder: A folder to work in, empty.

        Raises:
            Broken: If a promise is broken.
            BaseException: Whatever escapes breaks one, too.
        """

    def shown(self, case: Case) -> str:
        """The input as something to paste."""


class Broken(Exception):
    """A promise is broken although nothing was raised.

    Attributes:
        promise: Which, in words that are the same for all inputs that break it alike.
    """

    def __init__(self, promise: str, detail: object = "") -> None:
        self.promise = promise
        super().__init__(f"{promise}: {detail}" if detail != "" else promise)


class TooLong(BaseException):
    """An interruption was not answered."""


class Verdict(NamedTuple):
    """How a case ended.

    Attributes:
        word: How, in a word, for counting.
        place: Where a promise is broken, the same for all cases that break it there; empty if none
            is.
        text: What happened there.
    """

    word: str
    place: str = ""
    text: str = ""


@dataclass
class Found:
    """A broken promise.

    Attributes:
        name: The generator.
        number: The first case that breaks it.
        case: The input, the smallest found.
        verdict: What happened.
        count: How many cases break it.
    """

    name: str
    number: int
    case: Case
    verdict: Verdict
    count: int = 1


def drawn(generator: Generator, number: int) -> Case:
    """The input of a case."""
    return generator.draw(Random(f"{generator.name} {number}"))


def judged(generator: Generator, case: Case, base: Path | None = None) -> Verdict:
    """The verdict on an input, tried in a folder of its own below a given one."""
    folder = Path(tempfile.mkdtemp(prefix="fuzz-", dir=base))
    home = os.getcwd()
    try:
        with _raw_words(folder) as raw, _limited(BUDGET), warnings.catch_warnings():
            # As Python does by default: an interruption between the opening of a file and its
            # `with` leaves it to be collected.
            warnings.simplefilter("ignore", ResourceWarning)
            verdict = _attempted(generator, case, folder)
        said = raw()
    finally:
        os.chdir(home)
        shutil.rmtree(folder, ignore_errors=True)
    if said and not verdict.place:
        line = " ".join(re.sub(r"\x1b\[[0-9;]*m|\[[^]]*\]|\S*[0-9]\S*", "", said).split()[:5])
        return Verdict("broken", f"raw words beside ours: {line}", said[:500])
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
    """The kind of an exception, and the last line of ours through which it came."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if _ours(frame.filename)]
    kind = (
        type(error).__name__
        if not isinstance(error, TooLong)
        else f"Ctrl-C is not answered in {PATIENCE:g} s"
    )
    if not frames:
        return f"{kind} in the fuzzer"
    last = frames[-1]
    return f"{kind} at {Path(last.filename).relative_to(ROOT)}:{last.lineno} {last.name}"


def _ours(file: str) -> bool:
    path = Path(file)
    return path.is_relative_to(ROOT) and path.relative_to(ROOT).parts[0] in OURS


def place_in_dump(text: str) -> str:
    """The last line of ours in what `faulthandler` writes."""
    for file, line, name in re.findall(r'File "([^"]+)", line (\d+) in (\S+)', text):
        if _ours(file):
            return f"{Path(file).relative_to(ROOT)}:{line} {name}"
    return "a place unknown"


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
    """Have Ctrl-C come after so much more processor time [s] instead of at the end of the
    budget.
    """
    signal.setitimer(signal.ITIMER_PROF, seconds)


@contextmanager
def _raw_words(folder: Path) -> Iterator[Any]:
    """Keep what anybody writes to the file descriptors of standard output and error past Python's
    streams.
    """
    with (folder / "raw").open("w+b") as file:
        kept = [(number, os.dup(number)) for number in (1, 2)]
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        try:
            for number, _ in kept:
                os.dup2(file.fileno(), number)
            yield lambda: (folder / "raw").read_bytes().decode(errors="replace")
        finally:
            for number, copy in kept:
                os.dup2(copy, number)
                os.close(copy)


def smallest(case: Case, fails: Any, tries: int = 60) -> Case:
    """What is left of an input when parts are left out as long as it still fails.

    Args:
        case: An input that fails.
        fails: Whether an input does.
        tries: How often that may be asked.
    """
    parts, size = list(case.parts), max(1, len(case.parts) // 2)
    while size and parts and tries > 0:
        at = 0
        while at < len(parts) and tries > 0:
            fewer, tries = Case(case.head, parts[:at] + parts[at + size :]), tries - 1
            if fails(fewer):
                parts = fewer.parts
            else:
                at += size
        size //= 2
    return Case(case.head, parts)


def listed(found: Sequence[Found], generators: dict[str, Generator]) -> str:
    """Broken promises as text, each with its smallest reproduction."""
    return "\n".join(
        f"* {one.verdict.place}\n    {one.count} times; first {one.name}/{one.number}\n    "
        f"{generators[one.name].shown(one.case)}\n"
        + "".join(f"    | {line}\n" for line in one.verdict.text.strip().splitlines()[-4:])
        for one in found
    )
