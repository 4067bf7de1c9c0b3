"""Two results side by side: the same instances, pair by pair.

Both entries met the same cranes, winds and sensors, so instances are paired, and a difference is
seen that the spread over instances would hide.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cranedyn.benchmark.evaluate import InstanceResult
from cranedyn.benchmark.result import Result
from cranedyn.benchmark.score import MAIN
from cranedyn.benchmark.task import KINDS, CraneTask
from cranedyn.errors import CraneError

CONFIDENCE = 0.95
"""Confidence of the intervals."""

_RESAMPLES = 5000
"""Resamples of the bootstrap, as many as are usual for percentile intervals."""

_MIN_PAIRS = 6
"""Fewest pairs for an interval: of fewer, not even the whole range covers the median at the
confidence, since 2 · 0.5^6 = 3 % and 2 · 0.5^5 = 6 %."""


@dataclass(frozen=True)
class KindComparison:
    """One result over another in the tasks of a kind.

    Attributes:
        kind: Kind of the tasks.
        metric: Name of the metric that is compared.
        both: Number of instances that both passed.
        only_first: Number that only the first passed.
        only_second: Number that only the second passed.
        neither: Number that neither passed.
        ratio: Median of the metric of the second over that of the first, over the pairs that both
            passed, the geometric mean of the middle two of an even number; NaN if there is none.
        interval: Ends of its bootstrap interval; None for fewer pairs than `_MIN_PAIRS`.
        p: p-value of Wilcoxon's signed-rank test that the ratios are centred at 1; None as before.
    """

    kind: str
    metric: str
    both: int
    only_first: int
    only_second: int
    neither: int
    ratio: float
    interval: tuple[float, float] | None
    p: float | None


def compare(first: Result, second: Result, tasks: Sequence[CraneTask]) -> list[KindComparison]:
    """Compare two results in each kind of task that both have.

    Instances that one of them does not take part in do not count.

    Raises:
        CraneError: If the results are of other tasks, seeds or engines, and so not of the same
            instances.
    """
    check_comparable(first, second)
    kinds = {task.name: task.kind for task in tasks}
    found = []
    for kind in KINDS:
        pairs = [
            (a, b)
            for a, b in _pairs(first, second)
            if kinds.get(a.task) == kind and "declined" not in (a.status, b.status)
        ]
        if pairs:
            found.append(_of_kind(kind, pairs))
    return found


def check_comparable(first: Result, second: Result) -> None:
    """Check that two results are of the same instances.

    Raises:
        CraneError: If they are not.
    """
    for name, a, b in (
        ("version of the benchmark", first.benchmark, second.benchmark),
        ("seeds", first.seeds, second.seeds),
        ("engine", first.variant, second.variant),
    ):
        if a != b:
            raise CraneError(
                f"The results of {first.entry} and {second.entry} cannot be compared: the {name} "
                f"of one is {a}, of the other {b}."
            )
    shared = {*first.tasks} & {*second.tasks}
    if not shared:
        raise CraneError(f"{first.entry} and {second.entry} have no task in common.")
    for name in sorted(shared):
        if first.tasks[name] != second.tasks[name]:
            raise CraneError(
                f"The task {name} differs between the results of {first.entry} and {second.entry}; "
                "run one of them again."
            )


def _pairs(first: Result, second: Result) -> list[tuple[InstanceResult, InstanceResult]]:
    """Return the results of the instances that both have."""
    of_second = {(result.task, result.index): result for result in second.instances}
    pairs = []
    for result in first.instances:
        other = of_second.get((result.task, result.index))
        if other is not None:
            pairs.append((result, other))
    return pairs


def _of_kind(kind: str, pairs: Sequence[tuple[InstanceResult, InstanceResult]]) -> KindComparison:
    """Compare pairs of results of a kind of task."""
    metric = MAIN[kind]
    counts = {(True, True): 0, (True, False): 0, (False, True): 0, (False, False): 0}
    logs = []
    for a, b in pairs:
        passed = a.status == "passed", b.status == "passed"
        counts[passed] += 1
        if all(passed) and a.metrics[metric] > 0.0 and b.metrics[metric] > 0.0:
            logs.append(math.log(b.metrics[metric] / a.metrics[metric]))
    ratio = math.exp(float(np.median(logs))) if logs else math.nan
    interval, p = _uncertainty(np.array(logs))
    return KindComparison(
        kind=kind,
        metric=metric,
        both=counts[True, True],
        only_first=counts[True, False],
        only_second=counts[False, True],
        neither=counts[False, False],
        ratio=ratio,
        interval=interval,
        p=p,
    )


def _uncertainty(logs: np.ndarray) -> tuple[tuple[float, float] | None, float | None]:
    """Return the bootstrap interval of the median of ratios, and Wilcoxon's p-value, from their
    logarithms; None for both if there are too few.
    """
    from scipy.stats import bootstrap, wilcoxon

    if len(logs) < _MIN_PAIRS:
        return None, None
    if not logs.any():
        # The same numbers in every pair: there is nothing to resample or to rank.
        return (1.0, 1.0), 1.0
    resampled = bootstrap(
        (logs,),
        np.median,
        confidence_level=CONFIDENCE,
        n_resamples=_RESAMPLES,
        method="percentile",
        rng=np.random.default_rng(0),
    )
    low, high = resampled.confidence_interval
    return (math.exp(low), math.exp(high)), float(wilcoxon(logs).pvalue)


_HEAD = "kind      compared      ratio  95 % interval       p   passed by both  1st  2nd  none"

_WORDS = {"settled_s": "settled", "rms_error_m": "rms error"}
"""Words for metrics in the table."""


def benchmark_table(found: Sequence[KindComparison]) -> str:
    """Return the table of a comparison; a dash is a number that there is not."""
    lines = [_HEAD]
    for one in found:
        ratio = "-" if math.isnan(one.ratio) else f"{one.ratio:.3f}"
        interval = "-"
        p = "-"
        if one.interval is not None:
            interval = f"{one.interval[0]:.3f} to {one.interval[1]:.3f}"
        if one.p is not None:
            p = f"{one.p:.2g}"
        lines.append(
            f"{one.kind:<10}{_WORDS[one.metric]:<10}{ratio:>9}  {interval:>14}{p:>8}"
            f"{one.both:>17}{one.only_first:>5}{one.only_second:>5}{one.neither:>6}"
        )
    return "\n".join(lines)
