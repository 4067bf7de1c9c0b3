"""Scores: what the instances of each task say together, as a table; and an order of entries.

There is no single number. An entry is judged by what failed, by medians and by worst cases, each
task for itself. An order of several entries, as `validity` needs one, is by their mean place over
the tasks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cranedyn.benchmark.evaluate import InstanceResult
from cranedyn.benchmark.result import Result
from cranedyn.benchmark.task import CraneTask

MAIN = {
    "move": "settled_s",
    "path": "rms_error_m",
    "wind": "rms_error_m",
    "operator": "settled_s",
    "unknown": "settled_s",
    "sensors": "settled_s",
}
"""The metric by which entries that fail equally often are ordered, by the kind of the task."""


@dataclass(frozen=True)
class TaskScore:
    """What the instances of a task say together. Medians are over those that passed, NaN if none
    did; the largest values are over all that ran to their end.

    Attributes:
        task: Name of the task.
        instances: Number of instances.
        declined: Whether the entry does not take part.
        failed: Number of instances that failed.
        settled: Median of the settling time [s].
        slowest: Largest settling time [s]; inf if an instance failed.
        share: Least time of the move over the median of the settling time; NaN where no least time
            is known.
        swing: Largest swing [rad].
        error: Largest distance of the load from where it should be [m]; NaN where that is not
            measured.
        work: Median of the work of the drives [J].
        command: Median of the processor time of a command [µs].
        main: Median of the metric of `MAIN`.
    """

    task: str
    instances: int
    declined: bool
    failed: int
    settled: float
    slowest: float
    share: float
    swing: float
    error: float
    work: float
    command: float
    main: float


def task_score(task: CraneTask, results: Sequence[InstanceResult]) -> TaskScore:
    """Return what the instances of a task say together."""
    passed = [result for result in results if result.status == "passed"]
    failed = sum(result.status == "failed" for result in results)
    settled = _median(passed, "settled_s")
    slowest = max((result.metrics["settled_s"] for result in passed), default=math.nan)
    share = math.nan
    if task.least_time is not None and settled > 0.0:
        share = task.least_time / settled
    commands = [result.command_us[0] for result in results if result.command_us]
    return TaskScore(
        task=task.name,
        instances=len(results),
        declined=any(result.status == "declined" for result in results),
        failed=failed,
        settled=settled,
        slowest=math.inf if failed else slowest,
        share=share,
        swing=_largest(results, "swing_rad"),
        error=_largest(results, "error_m"),
        work=_median(passed, "work_J"),
        command=float(np.median(commands)) if commands else math.nan,
        main=_median(passed, MAIN[task.kind]),
    )


def _median(results: Sequence[InstanceResult], metric: str) -> float:
    """Return the median of a metric; NaN if no result has it."""
    values = [result.metrics[metric] for result in results if metric in result.metrics]
    return float(np.median(values)) if values else math.nan


def _largest(results: Sequence[InstanceResult], metric: str) -> float:
    """Return the largest value of a metric; NaN if no result has it."""
    values = [result.metrics[metric] for result in results if metric in result.metrics]
    return max(values) if values else math.nan


def scores(result: Result, tasks: Sequence[CraneTask]) -> list[TaskScore]:
    """Return the score of each task that a result has, in the order of the tasks."""
    found = []
    for task in tasks:
        results = result.of_task(task.name)
        if results:
            found.append(task_score(task, results))
    return found


_HEAD = (
    "task              failed  settled [s]  share  swing  error     work  command\n"
    "                           med. worst    [%] [mrad]   [mm]     [kJ]     [µs]"
)


def score_table(found: Sequence[TaskScore]) -> str:
    """Return the table of scores, 77 characters wide. A dash is a number that there is not."""
    lines = [_HEAD]
    for score in found:
        if score.declined:
            lines.append(f"{score.task:<18}does not take part")
            continue
        failed = f"{score.failed}/{score.instances}"
        slowest = "fails" if math.isinf(score.slowest) else _shown(score.slowest, ".2f")
        lines.append(
            f"{score.task:<18}{failed:>6}{_shown(score.settled, '.2f'):>7}{slowest:>6}"
            f"{_shown(100.0 * score.share, '.0f'):>7}{_shown(1e3 * score.swing, '.1f'):>7}"
            f"{_shown(1e3 * score.error, '.0f'):>7}{_shown(1e-3 * score.work, '.3g'):>9}"
            f"{_shown(score.command, '.0f'):>9}"
        )
    return "\n".join(lines)


def _shown(value: float, form: str) -> str:
    """Return a number as text, a dash for NaN."""
    return "-" if math.isnan(value) else format(value, form)


def totals(found: Sequence[TaskScore]) -> str:
    """Return a sentence of how many instances passed."""
    taken = [score for score in found if not score.declined]
    count = sum(score.instances for score in taken)
    passed = count - sum(score.failed for score in taken)
    clean = sum(score.failed == 0 for score in taken)
    text = f"{passed} of {count} instances passed, all of {clean} of {len(taken)} tasks"
    if len(taken) < len(found):
        text += f"; {len(found) - len(taken)} tasks without this entry"
    return f"{text}."


def mean_places(by_entry: Mapping[str, Sequence[TaskScore]]) -> dict[str, float]:
    """Return the mean place of each entry over the tasks, 1 for one that is first everywhere.

    In a task entries are ordered by how many instances fail, and then by the median of the metric
    of `MAIN`. Equal ones share the mean of their places; those that do not take part share the last
    ones.

    Args:
        by_entry: Scores of the same tasks by entry.
    """
    from scipy.stats import rankdata

    names = list(by_entry)
    places = []
    for of_task in zip(*by_entry.values(), strict=True):
        keys = []
        for score in of_task:
            failed = math.inf if score.declined else score.failed
            keys.append((failed, math.inf if math.isnan(score.main) else score.main))
        order = sorted(set(keys))
        places.append(rankdata([order.index(key) for key in keys]))
    means = np.mean(places, axis=0)
    return dict(zip(names, means.tolist(), strict=True))
