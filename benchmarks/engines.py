"""The plain loop against every other way to run the same crane: the whole workload, with control
and logging.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from functools import partial

import numpy as np

from benchmarks.agreement import ALLOWED, STRETCH, Ready, sort
from benchmarks.conduct import Results, conduct
from benchmarks.contestants import CONTESTANTS
from benchmarks.contestants.ours import PLAIN
from benchmarks.engines_figure import engines_figure
from benchmarks.timing import race, stretch
from benchmarks.workload import DURATION, Case, Contestant
from cranedyn.errors import CraneError
from cranedyn.model.load import load_crane
from experiments.harness.outcome import ResultTable

CRANES = (64, 1024)
"""How many cranes run together."""

HOOK_MASS = 200.0
"""Of the hook block of the double pendulum [kg]."""

COLUMNS = (
    ("strategy", ""),
    ("cranes", ",d"),
    ("million steps/s", ",.6g"),
    ("real time", ",.6g"),
    ("ratio", ",.6g"),
    ("apart", ".0e"),
)


def measure_engines(
    case: Case, ready: Sequence[Ready], rounds: int, budget: float, rng: np.random.Generator
) -> list[list[float | str | None]]:
    """Return a row for each contestant and number of cranes: steps/s, real time, ratio.

    Args:
        case: What to run.
        ready: Who, the plain loop among them.
        rounds: How often.
        budget: How long each takes in a round [s]; a run is cut to fit, never below a control
            period.
        rng: Shuffles the rounds.
    """
    entries = [(e, cranes) for e in ready for cranes in (CRANES if e.contestant.many else (1,))]
    lengths = [stretch(case, e.run, cranes, budget) for e, cranes in entries]
    tasks = [
        partial(e.run, case.starts(cranes), length)
        for (e, cranes), length in zip(entries, lengths, strict=True)
    ]
    steps = [
        cranes * case.steps * case.periods(length)
        for (_, cranes), length in zip(entries, lengths, strict=True)
    ]
    rates = np.array(steps)[:, None] / race(tasks, rounds, rng)
    (plain,) = (rate for rate, (e, _) in zip(rates, entries, strict=True) if e.contestant is PLAIN)
    return [
        [
            e.contestant.name,
            cranes,
            *_numbers(case, rate, plain),
            None if e.contestant is PLAIN else e.max_deviation,
        ]
        for (e, cranes), rate in zip(entries, rates, strict=True)
    ]


def _numbers(case: Case, rate: np.ndarray, plain: np.ndarray) -> tuple[float, float, float]:
    middle = float(np.median(rate))
    million, real_time, ratio = (
        float(f"{value:.3g}") for value in (middle / 1e6, middle * case.dt, np.median(rate / plain))
    )
    return million, real_time, ratio


def engine_tables(
    rows: Sequence[Sequence[float | str | None]], refused: Sequence[tuple[str, str]], rounds: int
) -> list[ResultTable]:
    """Return the tables of one crane, of many cranes, and of contestants that are not shown."""
    note = _note(rounds)
    single = [row for row in rows if row[1] == 1]
    result = [
        ResultTable(
            f"One crane for {DURATION:g} s, or as much of them as fits", COLUMNS, single, note
        )
    ]
    if len(single) < len(rows):
        result.append(
            ResultTable("Many cranes at once", COLUMNS, [row for row in rows if row[1] != 1], note)
        )
    if refused:
        result.append(ResultTable("Not shown", (("strategy", ""), ("why", "")), refused))
    return result


def _note(rounds: int) -> str:
    return (
        f"Median of {rounds} shuffled rounds on {os.cpu_count()} processors, with whatever else "
        "they did. Real time: simulated time of "
        "all cranes over wall time. Ratio: to the plain loop of the same round. Apart: largest "
        "difference from the plain loop over "
        f"{STRETCH:g} s, of a coordinate or rate [rad, m, per second] or of an effort as a share "
        f"of its limit; {ALLOWED:g} at most."
    )


def engines_benchmark(
    rounds: int, quick: bool, contestants: Sequence[Contestant] = CONTESTANTS
) -> Results:
    """Return the tables, and the function that measures and draws the figure.

    Raises:
        CraneError: If the plain loop itself cannot be shown.
    """
    case, rng = Case(), np.random.default_rng(0)
    ready, refused = sort(case, contestants)
    if not any(entry.contestant is PLAIN for entry in ready):
        raise CraneError(
            f"Nothing can be compared without the {PLAIN.name}: "
            f"{dict(refused).get(PLAIN.name, 'it does not take part')}."
        )
    budget = 0.05 if quick else 1.0
    result = engine_tables(measure_engines(case, ready, rounds, budget, rng), refused, rounds)
    able = [entry for entry in contestants if entry.any_crane]
    if len(able) > 1:
        hook = Case(load_crane(hook_mass=HOOK_MASS))
        able_ready, _ = sort(hook, able)
        rows = measure_engines(hook, able_ready, rounds, budget, rng)
        result.append(
            ResultTable("Double pendulum: hook and slung load", COLUMNS, rows, _note(rounds))
        )
    return result, lambda: engines_figure(case, ready, rng, quick=quick)


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    return conduct("engines", __doc__, engines_benchmark, argv)


if __name__ == "__main__":
    sys.exit(main())
