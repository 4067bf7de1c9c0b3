"""Progress of runs, counts and sweeps.

On a terminal it is shown as bars. Elsewhere a line goes to standard error now and then, so that a
log shows that work goes on, and results on standard output stay clean.
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

from rich.progress import Progress, TextColumn

from cranedyn.progress import bars as progress_bars
from cranedyn.progress import shows_bars
from cranedyn.sweep import Progress as SweepProgress

LINE_INTERVAL = 10.0
"""Time between two lines, and before the first [s]; work that takes less time prints nothing."""

BAR_INTERVAL = 0.5
"""Simulated time between two updates of a bar [s].

A run reports each control instant, of which there are hundreds in a second; drawing is slower.
"""


class ProgressLines:
    """Lines on standard error, at least `LINE_INTERVAL` apart."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin to wait for the first line.

        Args:
            clock: Function that returns the time [s].
        """
        self._clock = clock
        self._due = clock() + LINE_INTERVAL

    def say(self, text: Callable[[], str]) -> None:
        """Print a line if the next one is due.

        Args:
            text: Function that makes the line; it is called only if the line is printed.
        """
        now = self._clock()
        if now >= self._due:
            self._due = now + LINE_INTERVAL
            print(text(), file=sys.stderr, flush=True)


@dataclass(frozen=True)
class ProgressReporter:
    """Shows progress in bars or in lines; with neither, it shows nothing.

    Attributes:
        bars: Bars on a terminal.
        lines: Lines on standard error, if there are no bars.
    """

    bars: Progress | None = None
    lines: ProgressLines | None = None

    def run(self, name: str, duration: float) -> Callable[[float], None] | None:
        """Return a callback that takes the simulated time of a run [s].

        Args:
            name: Name of the run.
            duration: Simulated time at its end [s].

        Returns:
            The callback; None if nothing is shown.
        """
        bars = self.bars
        if bars is None:
            return self.message(name, f"of {duration:g} s", ".1f")
        task = bars.add_task(name, total=duration, speed="")
        last = -math.inf

        def update(t: float) -> None:
            nonlocal last
            # Always at the end of the run, so that no bar stays short of it. Times are sums of
            # steps, which rounding leaves a little short of the number that is meant.
            if t > min(last + BAR_INTERVAL, duration) - 1e-9:
                last = t
                elapsed = bars.tasks[task].elapsed or 0.0
                # A speed from less than a tenth of a second would jump.
                speed = f"{t:6.1f} s, {t / elapsed:.0f}x real time" if elapsed > 0.1 else ""
                bars.update(task, completed=t, speed=speed)

        return update

    def count(self, name: str, total: int) -> Callable[[int], None]:
        """Return a callback that takes the number of tasks that are done.

        Args:
            name: What the tasks are.
            total: Number of all tasks.
        """
        bars = self.bars
        if bars is None:
            return self.message(name, f"of {total}") or (lambda done: None)
        task = bars.add_task(name, total=total, speed="")
        return lambda done: bars.update(task, completed=done, speed=f"{done} of {total}")

    def message(self, name: str, unit: str, form: str = "") -> Callable[[float], None] | None:
        """Return a callback that shows a number whose last value is not known; None if nothing is
        shown.

        Args:
            name: What stands before the number.
            unit: What stands after it.
            form: Format of the number.
        """
        bars = self.bars
        if bars is None:
            return self._lines(lambda number: f"{name}: {number:{form}} {unit}")
        for earlier in bars.tasks:
            if earlier.total is None:
                # Nobody says when such a task ends: it has ended where the next one begins.
                bars.update(earlier.id, total=1.0, completed=1.0)
        task = bars.add_task(name, total=None, speed="")
        return lambda number: bars.update(task, speed=f"{number:{form}} {unit}")

    def sweep(
        self, name: str, clock: Callable[[], float] = time.monotonic
    ) -> Callable[[SweepProgress], None] | None:
        """Return the progress callback for `cranedyn.sweep.sweep`; None if nothing is shown.

        Args:
            name: Name of the sweep.
            clock: Function that returns the time [s].
        """
        bars = self.bars
        start = clock()
        if bars is None:
            return self._lines(lambda progress: f"{name}: {_rate(progress, clock() - start)}")
        task = bars.add_task(name, total=None, speed="")

        def update(progress: SweepProgress) -> None:
            # The bar shows the time left itself.
            speed = _rate(progress, clock() - start, with_time_left=False)
            bars.update(task, total=progress.cases, completed=progress.done, speed=speed)

        return update

    def _lines(self, text: Callable[[Any], str]) -> Callable[[Any], None] | None:
        """Return a callback that prints its argument as a text makes a line of it; None if no lines
        are printed.
        """
        lines = self.lines
        if lines is None:
            return None
        return lambda value: lines.say(lambda: text(value))


@contextmanager
def reporting() -> Iterator[ProgressReporter]:
    """Yield a reporter that shows bars on a terminal, see `shows_bars`, and prints lines elsewhere.

    The bars disappear with the context, so that only results stay on the screen.
    """
    if not shows_bars():
        yield ProgressReporter(lines=ProgressLines())
        return
    with progress_bars(TextColumn("{task.fields[speed]}")) as bars:
        yield ProgressReporter(bars)


@contextmanager
def sweeping(name: str) -> Iterator[Callable[[SweepProgress], None] | None]:
    """Yield the progress callback of a sweep outside of an experiment."""
    with reporting() as reporter:
        yield reporter.sweep(name)


def _rate(progress: SweepProgress, elapsed: float, *, with_time_left: bool = True) -> str:
    """Return the progress of a sweep in words: cases done, their rate, how many failed, and the
    time left.

    Args:
        progress: Counts of cases.
        elapsed: Time since the sweep began or was taken up again [s].
        with_time_left: Whether to say the time left.
    """
    phrases = [f"{progress.done} of {progress.cases} cases"]
    remaining = progress.left(elapsed)
    if remaining is not None and elapsed > 0.0:
        # Without the cases that were done before the sweep was taken up again.
        phrases.append(f"{(progress.done - progress.before) / elapsed:.3g}/s")
    if progress.errors:
        phrases.append(f"{progress.errors} bad")
    if remaining is not None and with_time_left:
        phrases.append(f"{timedelta(seconds=round(remaining))} left")
    return ", ".join(phrases)
