"""Progress of runs, counts and sweeps: bars on a terminal, else a line on standard error now and
then.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from cranedyn.sweep import Progress as SweepProgress

LINE_INTERVAL = 10.0
"""Time between two lines, and before the first [s]: short work prints nothing."""

_BAR_INTERVAL = 0.5
"""Simulated time between two updates of a bar [s]."""


class ProgressLines:
    """Lines on standard error, at least `LINE_INTERVAL` apart by a clock [s]."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._due = clock, clock() + LINE_INTERVAL

    def say(self, text: Callable[[], str]) -> None:
        """Print a text if the next line is due."""
        now = self._clock()
        if now >= self._due:
            self._due = now + LINE_INTERVAL
            print(text(), file=sys.stderr, flush=True)


@dataclass(frozen=True)
class ProgressReporter:
    """Progress in bars or in lines; with neither, nothing is shown.

    Attributes:
        bars: Bars of rich.
        lines: Lines on standard error.
    """

    bars: Progress | None = None
    lines: ProgressLines | None = None

    def run(self, name: str, duration: float) -> Callable[[float], None] | None:
        """Return the callback of a run for `simulate`, None if nothing is shown."""
        bars = self.bars
        if bars is None:
            return self.message(name, f"of {duration:g} s", ".1f")
        task, last = bars.add_task(name, total=duration, speed=""), -math.inf

        def update(t: float) -> None:
            nonlocal last
            if t > min(last + _BAR_INTERVAL, duration) - 1e-9:
                last, elapsed = t, bars.tasks[task].elapsed or 0.0
                speed = f"{t:6.1f} s, {t / elapsed:.0f}x real time" if elapsed > 0.1 else ""
                bars.update(task, completed=t, speed=speed)

        return update

    def count(self, name: str, total: int) -> Callable[[int], None]:
        """Return a callback that takes how many of several tasks are done."""
        bars = self.bars
        if bars is None:
            return self.message(name, f"of {total}") or (lambda done: None)
        task = bars.add_task(name, total=total, speed="")
        return lambda done: bars.update(task, completed=done, speed=f"{done} of {total}")

    def message(self, name: str, unit: str, form: str = "") -> Callable[[float], None] | None:
        """Return a callback that prints a number with its unit in lines, None on a terminal."""
        return self._lines(lambda number: f"{name}: {number:{form}} {unit}")

    def sweep(
        self, name: str, clock: Callable[[], float] = time.monotonic
    ) -> Callable[[SweepProgress], None] | None:
        """Return the callback of a sweep for `cranedyn.sweep.sweep`, None if nothing is shown."""
        bars, start = self.bars, clock()
        if bars is None:
            return self._lines(lambda progress: f"{name}: {_rate(progress, clock() - start)}")
        task = bars.add_task(name, total=None, speed="")

        def update(progress: SweepProgress) -> None:
            speed = _rate(progress, clock() - start)
            bars.update(task, total=progress.cases, completed=progress.done, speed=speed)

        return update

    def _lines(self, text: Callable[[Any], str]) -> Callable[[Any], None] | None:
        lines = self.lines
        return None if lines is None else lambda value: lines.say(lambda: text(value))


@contextmanager
def reporting() -> Iterator[ProgressReporter]:
    """Report progress while the context lasts: in bars on a terminal, else in lines."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield ProgressReporter(lines=ProgressLines())
        return
    texts = TextColumn("{task.description}"), TextColumn("{task.fields[speed]}")
    columns = texts[0], BarColumn(), texts[1], TimeElapsedColumn()
    with Progress(*columns, console=console, transient=True) as bars:
        yield ProgressReporter(bars)


@contextmanager
def sweeping(name: str) -> Iterator[Callable[[SweepProgress], None] | None]:
    """Yield the progress callback of a sweep outside of an experiment."""
    with reporting() as reporter:
        yield reporter.sweep(name)


def _rate(progress: SweepProgress, elapsed: float) -> str:
    """Return the cases done, their rate, the bad ones and the time left, after a time [s]."""
    phrases = [f"{progress.done} of {progress.cases} cases"]
    remaining = progress.left(elapsed)
    if remaining is not None and elapsed > 0.0:
        phrases.append(f"{(progress.done - progress.before) / elapsed:.3g}/s")
    if progress.errors:
        phrases.append(f"{progress.errors} bad")
    if remaining is not None:
        phrases.append(f"{timedelta(seconds=round(remaining))} left")
    return ", ".join(phrases)
