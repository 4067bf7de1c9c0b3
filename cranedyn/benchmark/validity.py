"""Whether an order of entries depends on what it should not: the seeds, the engine or the step.

The same entries are run again by other seeds, by Pinocchio's engine instead of the compiled one,
and with half of the physics step. The orders by mean place
(`cranedyn.benchmark.score.mean_places`) are compared by Kendall's τ, which is 1 for the same order
and 0 for unrelated ones. Five instances of a task do not tell neighbours apart, so entries also
have places that they may share (`cranedyn.benchmark.comparison.shared_places`); a pair of entries
that is apart in both orders, the other way round, is counted as reversed.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from cranedyn.benchmark.comparison import shared_places
from cranedyn.benchmark.entry_process import EntryLimits
from cranedyn.benchmark.entry_source import EntrySource
from cranedyn.benchmark.evaluate import USUAL, Variant
from cranedyn.benchmark.result import run_benchmark
from cranedyn.benchmark.score import mean_places, scores
from cranedyn.benchmark.task import PUBLIC, CraneTask
from cranedyn.errors import OutOfRange

OTHER_SEEDS = "2026-01-01"
"""Date of the other seeds. Any date would do."""

VARIANTS: Mapping[str, tuple[str, Variant]] = {
    "usual": (PUBLIC, USUAL),
    "other seeds": (OTHER_SEEDS, USUAL),
    "Pinocchio's engine": (PUBLIC, Variant(engine="pinocchio")),
    "half the step": (PUBLIC, Variant(substeps=2)),
}
"""What is varied: seeds and computation by name, the usual ones first."""


@dataclass(frozen=True)
class Order:
    """The order of entries under a variant.

    Attributes:
        variant: Name of the variant.
        places: Mean place of each entry.
        tau: Kendall's τ with the usual order; NaN if all entries share a place.
        shared: Place of each entry, which it shares with those that do not differ for certain.
        reversed_pairs: Number of pairs of entries of which the one is before the other by these
            places, and behind it in the usual order.
    """

    variant: str
    places: Mapping[str, float]
    tau: float
    shared: Mapping[str, int]
    reversed_pairs: int


def orders(
    tasks: Sequence[CraneTask],
    entries: Mapping[str, EntrySource],
    *,
    jobs: int | None = 1,
    limits: EntryLimits | None = None,
    progress: Callable[[int], object] | None = None,
) -> list[Order]:
    """Return the order of entries under each variant.

    Args:
        tasks: The tasks.
        entries: The entries by how they were named, two or more.
        jobs: Processes that share the tasks.
        limits: What an entry may use.
        progress: Function that is told how many runs of an entry are done.

    Raises:
        OutOfRange: If there are less than two entries.
    """
    from scipy.stats import kendalltau

    if len(entries) < 2:
        raise OutOfRange("number of entries", len(entries), "2 or more, which have an order")
    found: list[Order] = []
    done = 0
    for name, (seeds, variant) in VARIANTS.items():
        by_entry = {}
        results = {}
        for text, source in entries.items():
            result = run_benchmark(
                tasks, source, text, seeds=seeds, variant=variant, jobs=jobs, limits=limits
            )
            results[text] = result
            by_entry[text] = scores(result, tasks)
            done += 1
            if progress is not None:
                progress(done)
        places = mean_places(by_entry)
        usual = found[0].places if found else places
        tau = kendalltau([usual[text] for text in entries], [places[text] for text in entries])
        shared = shared_places(results, tasks)
        reversed_pairs = _reversed(found[0].shared, shared) if found else 0
        found.append(Order(name, places, float(tau.statistic), shared, reversed_pairs))
    return found


def _reversed(usual: Mapping[str, int], other: Mapping[str, int]) -> int:
    """Return the number of pairs of entries that are one way round in an order and the other way
    round in another; those that share a place in one of them do not count.
    """
    count = 0
    for one, another in itertools.combinations(usual, 2):
        before = usual[one] - usual[another]
        after = other[one] - other[another]
        count += before * after < 0
    return count


def order_table(found: Sequence[Order]) -> str:
    """Return the table of shared places and mean places, a row for each entry, with the reversed
    pairs and Kendall's τ below.
    """
    names = sorted(found[0].places, key=lambda name: found[0].places[name])
    lines = ["place (mean place)".ljust(24) + "".join(f"{order.variant:>20}" for order in found)]
    for name in names:
        cells = [f"{order.shared[name]:>11} ({order.places[name]:.2f})" for order in found]
        lines.append(name.ljust(24) + "".join(f"{cell:>20}" for cell in cells))
    pairs = "".join(f"{order.reversed_pairs:>20}" for order in found)
    lines.append("pairs reversed".ljust(24) + pairs)
    taus = ["-" if math.isnan(order.tau) else f"{order.tau:.3f}" for order in found]
    lines.append("Kendall's τ".ljust(24) + "".join(f"{tau:>20}" for tau in taus))
    return "\n".join(lines)
