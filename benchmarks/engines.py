"""The plain loop against every other way to run the same crane: the whole workload, with control
and logging.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

import numpy as np

from benchmarks.agreement import ALLOWED, STRETCH, Ready, refused_table, sort
from benchmarks.conduct import Results, conduct
from benchmarks.contestants import CONTESTANTS
from benchmarks.contestants.ours import PLAIN
from benchmarks.engines_figure import engines_figure
from benchmarks.timing import step_rates
from benchmarks.workload import DURATION, Case, Contestant
from cranedyn.errors import CraneError
from cranedyn.model.load import load_crane
from experiments.harness.outcome import ResultTable

CRANES = (64, 1024)
"""Numbers of cranes that run together, where a contestant runs many."""

HOOK_MASS = 200.0
"""Mass of the hook block of the double pendulum [kg]."""

COLUMNS = (
    ("strategy", ""),
    ("cranes", ",d"),
    ("million steps/s", ",.6g"),
    ("real time", ",.6g"),
    ("ratio", ",.6g"),
    ("apart", ".0e"),
)

Rows = list[list[float | str | None]]
"""Cells of a table by row."""


def measure_engines(
    case: Case, ready: Sequence[Ready], rounds: int, budget: float, rng: np.random.Generator
) -> Rows:
    """Return a row for each contestant and number of cranes: steps/s, real time, ratio; arguments
    as `benchmarks.timing.step_rates`, the plain loop among those that are ready.
    """
    entries = []
    for runner in ready:
        for cranes in CRANES if runner.contestant.many else (1,):
            entries.append((runner, cranes))
    runs = [(runner.run, cranes) for runner, cranes in entries]
    rates = step_rates(case, runs, rounds, budget, rng)
    plain = _rates_of_plain_loop(entries, rates)
    rows: Rows = []
    for (runner, cranes), rate in zip(entries, rates, strict=True):
        median = float(np.median(rate))
        # The ratio in each round, not that of the medians: both meet what else the machine does.
        ratio = np.median(rate / plain)
        is_plain = runner.contestant is PLAIN
        rows.append(
            [
                runner.contestant.name,
                cranes,
                _three_digits(median / 1e6),
                _three_digits(median * case.dt),
                _three_digits(ratio),
                None if is_plain else runner.max_deviation,
            ]
        )
    return rows


def _rates_of_plain_loop(entries: Sequence[tuple[Ready, int]], rates: np.ndarray) -> np.ndarray:
    """Return the rates of the plain loop in each round, shape (rounds,)."""
    for (runner, _), rate in zip(entries, rates, strict=True):
        if runner.contestant is PLAIN:
            return rate
    raise ValueError(f"The {PLAIN.name} is not among the contestants.")


def _three_digits(value: float) -> float:
    """Round to three digits: more of a measured time mean nothing."""
    return float(f"{value:.3g}")


def engine_tables(
    rows: Sequence[Sequence[float | str | None]], refused: Sequence[tuple[str, str]], rounds: int
) -> list[ResultTable]:
    """Return the tables of one crane, of many cranes, and of contestants that are not shown."""
    single = [row for row in rows if row[1] == 1]
    many = [row for row in rows if row[1] != 1]
    title = f"One crane for {DURATION:g} s, or as much of them as fits"
    result = [ResultTable(title, COLUMNS, single, _note(rounds))]
    if many:
        result.append(ResultTable("Many cranes at once", COLUMNS, many, _note(rounds)))
    return [*result, *refused_table(refused)]


def _note(rounds: int) -> str:
    """Return the note below the tables of contestants."""
    return (
        f"Median of {rounds} shuffled rounds on {os.cpu_count()} processors. Real time: time of "
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
    case = Case()
    rng = np.random.default_rng(0)
    ready, refused = sort(case, contestants)
    if not any(entry.contestant is PLAIN for entry in ready):
        reason = dict(refused).get(PLAIN.name, "it does not take part")
        raise CraneError(f"Nothing can be compared without the {PLAIN.name}: {reason}.")
    budget = 0.05 if quick else 1.0
    result = engine_tables(measure_engines(case, ready, rounds, budget, rng), refused, rounds)
    able = [entry for entry in contestants if entry.any_crane]
    if len(able) > 1:
        hook = Case(load_crane(hook_mass=HOOK_MASS))
        rows = measure_engines(hook, sort(hook, able)[0], rounds, budget, rng)
        title = "Double pendulum: hook and slung load"
        result.append(ResultTable(title, COLUMNS, rows, _note(rounds)))
    return result, lambda: engines_figure(case, ready, rng, quick=quick)


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    return conduct("engines", __doc__, engines_benchmark, argv)


if __name__ == "__main__":
    sys.exit(main())
