"""How far a sweep is, on a terminal: a bar, the cases done, their rate, the bad ones, and an
estimate of the time left.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta

from rich.progress import Progress as Bars

from cranedyn.sweep import Progress
from experiments.harness.setup import ProgressReporter, reporting


@contextmanager
def sweeping(name: str) -> Iterator[Callable[[Progress], None] | None]:
    """What to give to `cranedyn.sweep.sweep` as its progress, for as long as the context lasts;
    None where nobody watches.
    """
    with reporting() as reporter:
        yield watching(reporter, name)


def watching(reporter: ProgressReporter, name: str) -> Callable[[Progress], None] | None:
    """What shows a sweep where this reporter does; None where nobody watches."""
    if reporter.progress is not None:
        return shown(reporter.progress, name, time.monotonic)
    lines, began = reporter.lines, time.monotonic()
    if lines is None:
        return None
    return lambda progress: lines.say(
        lambda: f"{name}: {words(progress, time.monotonic() - began)}"
    )


def shown(bars: Bars, name: str, clock: Callable[[], float]) -> Callable[[Progress], None]:
    """Show a sweep among the bars; the clock [s] starts here."""
    began, task = clock(), bars.add_task(name, total=None, speed="")

    def show(progress: Progress) -> None:
        bars.update(
            task,
            total=progress.cases,
            completed=progress.done,
            speed=words(progress, clock() - began),
        )

    return show


def words(progress: Progress, elapsed: float) -> str:
    """What is said beside the bar when this process has swept for so long [s]."""
    parts = [f"{progress.done} of {progress.cases} cases"]
    left = progress.left(elapsed)
    if left is not None and elapsed > 0.0:
        parts.append(f"{(progress.done - progress.before) / elapsed:.3g}/s")
    if progress.errors:
        parts.append(f"{progress.errors} bad")
    if left is not None:
        parts.append(f"{timedelta(seconds=round(left))} left")
    return ", ".join(parts)
