"""Results side by side: the same instances, pair by pair, and places that entries share.

All entries met the same cranes, winds and sensors, so instances are paired, and a difference is
seen that the spread over instances would hide. An instance that one entry failed and the other
passed counts as worse than every ratio: else an entry that fails the hard instances would be judged
by the easy ones.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cranedyn.benchmark.evaluate import InstanceResult
from cranedyn.benchmark.result import Result
from cranedyn.benchmark.score import MAIN, mean_places, scores
from cranedyn.benchmark.task import KINDS, CraneTask
from cranedyn.errors import CraneError

CONFIDENCE = 0.95
"""Confidence of the intervals."""

SIGNIFICANCE = 0.01
"""p-value below which two entries have different places. Smaller than usual, since a table of ten
entries has 45 pairs. Our choice."""

FAILURE = 50.0
"""Logarithm of the ratio of a pair of which only the second failed; minus this if only the first
did. Any number beyond the ratios that occur means the same, as ranks and medians are taken."""

LEAST_ERROR = 1e-3
"""Errors below count as this [m], and settling times below a control period as one, so that ratios
of loads that are settled at once exist."""

_RESAMPLES = 5000
"""Resamples of the bootstrap, as many as are usual for percentile intervals."""

_MIN_PAIRS = 6
"""Fewest pairs for an interval: of fewer, not even the whole range covers the median at the
confidence, since 2 · 0.5^6 = 3 % and 2 · 0.5^5 = 6 %."""

Pair = tuple[InstanceResult, InstanceResult]
"""Results of two entries in one instance."""


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
        ratio: Median of the metric of the second over that of the first, over the instances that
            one of them passed, the geometric mean of the middle two of an even number. An instance
            that only the first passed counts as inf, one that only the second passed as 0. NaN if
            there is none.
        passed_ratio: The same over the instances that both passed.
        interval: Ends of the bootstrap interval of `ratio`; None for fewer pairs than `_MIN_PAIRS`.
        p: p-value of Wilcoxon's signed-rank test that the ratios are centred at 1; None as before.
    """

    kind: str
    metric: str
    both: int
    only_first: int
    only_second: int
    neither: int
    ratio: float
    passed_ratio: float
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
    known = {task.name: task for task in tasks}
    found = []
    for kind in KINDS:
        pairs = [
            (a, b)
            for a, b in _pairs(first, second)
            if a.task in known
            and known[a.task].kind == kind
            and "declined" not in (a.status, b.status)
        ]
        if pairs:
            found.append(_of_kind(kind, pairs, known))
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


def _pairs(first: Result, second: Result) -> list[Pair]:
    """Return the results of the instances that both have."""
    of_second = {(result.task, result.index): result for result in second.instances}
    pairs = []
    for result in first.instances:
        other = of_second.get((result.task, result.index))
        if other is not None:
            pairs.append((result, other))
    return pairs


def _of_kind(kind: str, pairs: Sequence[Pair], known: Mapping[str, CraneTask]) -> KindComparison:
    """Compare pairs of results of a kind of task."""
    counts = {(True, True): 0, (True, False): 0, (False, True): 0, (False, False): 0}
    for a, b in pairs:
        counts[a.status == "passed", b.status == "passed"] += 1
    logs = _log_ratios(pairs, known)
    interval, p = _uncertainty(logs)
    return KindComparison(
        kind=kind,
        metric=MAIN[kind],
        both=counts[True, True],
        only_first=counts[True, False],
        only_second=counts[False, True],
        neither=counts[False, False],
        ratio=_ratio(logs),
        passed_ratio=_ratio(logs[np.abs(logs) < FAILURE]),
        interval=interval,
        p=p,
    )


def _log_ratios(pairs: Sequence[Pair], known: Mapping[str, CraneTask]) -> np.ndarray:
    """Return the logarithms of the ratios of the second results over the first, shape (k,), of the
    k pairs of which one passed at least; ±`FAILURE` where only one did.

    Args:
        pairs: The pairs.
        known: Tasks by name.
    """
    logs = []
    for a, b in pairs:
        if a.status == b.status == "passed":
            logs.append(math.log(_main(b, known[b.task]) / _main(a, known[a.task])))
        elif a.status == "passed":
            logs.append(FAILURE)
        elif b.status == "passed":
            logs.append(-FAILURE)
    return np.array(logs)


def _main(result: InstanceResult, task: CraneTask) -> float:
    """Return the metric of `MAIN` of an instance that passed, at least what is distinguished."""
    metric = MAIN[task.kind]
    return max(result.metrics[metric], task.period if metric == "settled_s" else LEAST_ERROR)


def _ratio(logs: np.ndarray) -> float:
    """Return the median of ratios of some logarithms; inf or 0 if it is a failure, NaN of none."""
    return _exponential(float(np.median(logs))) if len(logs) else math.nan


def _exponential(log: float) -> float:
    """Return e to a power, inf or 0 for logarithms that are failures, or half ones: the mean of one
    and a true ratio.
    """
    if abs(log) > 0.4 * FAILURE:
        return math.inf if log > 0.0 else 0.0
    return math.exp(log)


def _uncertainty(logs: np.ndarray) -> tuple[tuple[float, float] | None, float | None]:
    """Return the bootstrap interval of the median of ratios, and Wilcoxon's p-value, from their
    logarithms; None for both if there are too few.
    """
    from scipy.stats import bootstrap

    if len(logs) < _MIN_PAIRS:
        return None, None
    if (logs == logs[0]).all():
        # There is nothing to resample.
        end = _exponential(float(logs[0]))
        return (end, end), _p_value(logs)
    resampled = bootstrap(
        (logs,),
        np.median,
        confidence_level=CONFIDENCE,
        n_resamples=_RESAMPLES,
        method="percentile",
        rng=np.random.default_rng(0),
    )
    low, high = resampled.confidence_interval
    return (_exponential(float(low)), _exponential(float(high))), _p_value(logs)


def _p_value(logs: np.ndarray) -> float:
    """Return the p-value of Wilcoxon's signed-rank test of logarithms of ratios."""
    from scipy.stats import wilcoxon

    # Of the same numbers in every pair there is nothing to rank.
    return float(wilcoxon(logs).pvalue) if logs.any() else 1.0


# --- places ---------------------------------------------------------------------------------------


def shared_places(results: Mapping[str, Result], tasks: Sequence[CraneTask]) -> dict[str, int]:
    """Return the place of each entry, from 1; entries that do not differ for certain share one.

    Entries are taken in the order of `mean_places`. Each shares the place of the first one above
    it of that place, unless it is worse than this one by Wilcoxon's signed-rank test over all
    instances of all tasks with a p-value below `SIGNIFICANCE`. Failing and not taking part count
    as worse than every ratio.

    Args:
        results: Results of the same tasks by entry.
        tasks: The tasks.
    """
    known = {task.name: task for task in tasks}
    means = mean_places({name: scores(result, tasks) for name, result in results.items()})
    places: dict[str, int] = {}
    leader = ""
    for i, name in enumerate(sorted(results, key=lambda name: means[name])):
        if i == 0 or is_worse(results[name], results[leader], known):
            leader = name
            places[name] = i + 1
        else:
            places[name] = places[leader]
    return places


def is_worse(one: Result, other: Result, known: Mapping[str, CraneTask]) -> bool:
    """Return whether one result is worse than another for certain, see `shared_places`.

    Args:
        one: The one.
        other: The other, of the same instances.
        known: Tasks by name.
    """
    logs = _log_ratios(_pairs(other, one), known)
    if len(logs) < _MIN_PAIRS or _p_value(logs) >= SIGNIFICANCE:
        return False
    return bool(_rank_sum(logs) > 0.0)


def _rank_sum(logs: np.ndarray) -> float:
    """Return the sum of the signed ranks of logarithms: positive if ratios are mostly above 1."""
    from scipy.stats import rankdata

    return float(np.sign(logs) @ rankdata(np.abs(logs)))


# --- table ----------------------------------------------------------------------------------------

_HEAD = (
    "                                                     ratio if  passed by\n"
    "kind      compared    ratio    95 % interval       p     both  both 1st 2nd none"
)

_WORDS = {"settled_s": "settled", "rms_error_m": "rms error"}
"""Words for metrics in the table."""


def benchmark_table(found: Sequence[KindComparison]) -> str:
    """Return the table of a comparison; a dash is a number that there is not, and ∞ a ratio to an
    instance that only the first passed.
    """
    lines = [_HEAD]
    for one in found:
        interval = "-"
        if one.interval is not None:
            low, high = one.interval
            interval = f"{_shown(low)} to {_shown(high)}"
        p = "-" if one.p is None else f"{one.p:.2g}"
        lines.append(
            f"{one.kind:<10}{_WORDS[one.metric]:<10}{_shown(one.ratio):>7}{interval:>17}{p:>8}"
            f"{_shown(one.passed_ratio):>9}{one.both:>6}{one.only_first:>4}{one.only_second:>4}"
            f"{one.neither:>5}"
        )
    return "\n".join(lines)


def _shown(ratio: float) -> str:
    """Return a ratio as text."""
    if math.isnan(ratio):
        return "-"
    return "∞" if math.isinf(ratio) else f"{ratio:.3f}"
