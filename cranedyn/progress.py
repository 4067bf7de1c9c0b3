"""Bars on a terminal while work takes long, with the time that is left."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
)
from rich.text import Text


class TimeLeftColumn(ProgressColumn):
    """The time that a task still takes at its present speed; nothing while that is unknown."""

    # An estimate that changes with each drawing cannot be read.
    max_refresh = 0.5

    def render(self, task: Task) -> Text:
        """Return the time in words."""
        remaining = task.time_remaining
        if remaining is None or task.finished:
            return Text("")
        return Text(f"{timedelta(seconds=round(remaining))} left", style="progress.remaining")


def shows_bars() -> bool:
    """Return whether bars are shown: on a terminal, and unless what is printed goes elsewhere.

    Bars are drawn on standard error. Beside a program that reads standard output, such as a pager,
    they would disturb its screen.
    """
    return Console(stderr=True).is_terminal and Console(file=sys.stdout).is_terminal


def bars(*columns: ProgressColumn) -> Progress:
    """Return bars on standard error that disappear when they are stopped.

    Args:
        columns: What stands between a bar and its times.
    """
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        *columns,
        TimeElapsedColumn(),
        TimeLeftColumn(),
        console=Console(stderr=True),
        transient=True,
    )


@contextmanager
def bar(name: str, total: float | None = None) -> Iterator[Callable[[float], None]]:
    """Show a bar while the block runs, where `shows_bars`.

    Args:
        name: What is done.
        total: What the work is measured by at its end, such as a number of pictures; None if that
            is unknown: the bar then moves, and shows no time left.

    Yields:
        Function that takes how much is done.
    """
    if not shows_bars():
        yield lambda done: None
        return
    with bars() as progress:
        task = progress.add_task(name, total=total)
        yield lambda done: progress.update(task, completed=done)
