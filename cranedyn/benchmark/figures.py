"""The figure of a comparison: every instance of every task, one colour for each entry."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cranedyn.benchmark.result import Result
from cranedyn.benchmark.score import MAIN
from cranedyn.benchmark.task import CraneTask
from cranedyn.data.files import atomic_write

_SPREAD = 0.6
"""Share of the height of a row over which the entries are spread."""

_FAILED_AT = 4.0
"""Place of failed instances on the axis, right of nearly all others."""


def write_figure(file: Path, results: Sequence[Result], tasks: Sequence[CraneTask]) -> None:
    """Write the figure of results as a picture or a PDF, by the ending of the file.

    A point is an instance: its time of settling, or in wind and on a path its error, over the
    median of the first result in the same task. Crosses at the right are instances that failed.

    Args:
        file: Where to write.
        results: The results; the first is what the others are compared with.
        tasks: The tasks.
    """
    from matplotlib.figure import Figure

    from cranedyn.plotting.style import run_colour

    shown = [task for task in tasks if results[0].of_task(task.name)]
    figure = Figure(figsize=(7.5, 1.2 + 0.28 * len(shown)), layout="constrained")
    axes = figure.add_subplot()
    for i, result in enumerate(results):
        offset = _SPREAD * ((i + 0.5) / len(results) - 0.5)
        colour = run_colour(i)
        points: list[tuple[float, float]] = []
        failed: list[tuple[float, float]] = []
        for row, task in enumerate(shown):
            metric = MAIN[task.kind]
            scale = _scale(results, task, metric)
            for instance in result.of_task(task.name):
                if instance.status == "failed":
                    failed.append((_FAILED_AT, row + offset))
                elif instance.status == "passed":
                    points.append((instance.metrics[metric] / scale, row + offset))
        _scatter(axes, points, marker="o", colour=colour, label=result.entry)
        _scatter(axes, failed, marker="x", colour=colour, label=None)
    axes.axvline(1.0, color="0.5", linewidth=0.8)
    axes.set_xscale("log", base=2)
    axes.set_xticks([0.25, 0.5, 1.0, 2.0, _FAILED_AT], ["¼", "½", "1", "2", "failed"])
    axes.set_yticks(range(len(shown)), [task.name for task in shown])
    axes.invert_yaxis()
    axes.grid(axis="y", alpha=0.3)
    words = (
        "settling time, on paths and in wind rms error, over the median of "
        f"{results[0].entry}, or of the first that passed"
    )
    axes.set_xlabel(words, fontsize="small")
    figure.legend(loc="outside upper center", ncols=4, fontsize="small")
    with atomic_write(file) as draft:
        figure.savefig(draft, format=file.suffix[1:] or "png", dpi=120)


def _scatter(
    axes: object, points: Sequence[tuple[float, float]], marker: str, colour: str, label: str | None
) -> None:
    """Draw points, or an entry of the legend alone if there are none."""
    x, y = np.array(points).reshape(-1, 2).T
    axes.scatter(x, y, s=18, marker=marker, color=colour, label=label)  # type: ignore[attr-defined]


def _scale(results: Sequence[Result], task: CraneTask, metric: str) -> float:
    """Return the median of a metric in a task: of the first result that passed an instance there.
    Where that is 0, as of a load that is settled at once, it is a control period or a millimetre.
    """
    for result in results:
        values = [
            instance.metrics[metric]
            for instance in result.of_task(task.name)
            if instance.status == "passed"
        ]
        if values:
            return max(float(np.median(values)), task.period if metric == "settled_s" else 1e-3)
    return 1.0
