"""Many cranes at once, by whoever can: this engine beside MuJoCo, MJX, JAX by hand, Drake, PyBullet
and C by hand, all in double precision on this machine, as one chart.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from benchmarks.agreement import ALLOWED, STRETCH, Ready, refused_table, sort
from benchmarks.conduct import Results, conduct
from benchmarks.contestants import CONTESTANTS, jax, ours
from benchmarks.engines import Rows
from benchmarks.timing import step_rates
from benchmarks.workload import Case, Contestant
from cranedyn.errors import CraneError
from cranedyn.plotting.figures import panels
from experiments.harness.outcome import ResultTable

CRANES = 1024
"""How many cranes run together, where an engine runs many."""

COLUMNS = (
    ("strategy", ""),
    ("cranes", ",d"),
    ("million steps/s", ",.6g"),
    ("of this engine", ".3g"),
    ("apart", ".0e"),
)

_BATCH = "compiled batch, all cores"
"""Name of the contestant that all others are compared with."""

_BY_HAND = "C by hand"
"""Beginning of the names of the equations written by hand in C."""

OUR_COLOUR = "#1f77b4"
"""Colour of the engines of this project."""

LIMIT_COLOUR = "#444444"
"""Colour of equations written by hand, which show what can be reached."""

OTHER_COLOUR = "#bbbbbb"
"""Colour of other simulators."""


def peers() -> tuple[Contestant, ...]:
    """Return all contestants, less slower variants of this project and of C on one thread."""
    best = (_BATCH, "plain loop", f"{_BY_HAND}, {os.cpu_count()} threads")
    names_of_ours = {contestant.name for contestant in ours.CONTESTANTS}
    result = []
    for contestant in (*CONTESTANTS, *jax.CONTESTANTS):
        has_variants = contestant.name in names_of_ours or contestant.name.startswith(_BY_HAND)
        if not has_variants or contestant.name in best:
            result.append(contestant)
    return tuple(result)


def measure_peers(case: Case, ready: Sequence[Ready], rounds: int, budget: float) -> Rows:
    """Return a row for each engine, the fastest first: name, cranes, million steps a second, ratio
    to the compiled batch, largest deviation.

    Args:
        case: What to run.
        ready: Who runs it.
        rounds: How often.
        budget: How long each takes in a round [s].

    Raises:
        CraneError: If the compiled batch is not among them.
    """
    names = [runner.contestant.name for runner in ready]
    if _BATCH not in names:
        raise CraneError("Nothing can be compared: the compiled batch cannot run here.")
    entries = [(runner.run, _cranes(runner)) for runner in ready]
    rates = 1e-6 * step_rates(case, entries, rounds, budget, np.random.default_rng(0))
    medians = np.median(rates, axis=1)
    batch_rate = medians[names.index(_BATCH)]
    rows: Rows = []
    for runner, rate in zip(ready, medians.tolist(), strict=True):
        name = runner.contestant.name
        # More than three digits of a measured time mean nothing.
        rounded = float(f"{rate:.3g}")
        ratio = float(f"{rate / batch_rate:.3g}")
        rows.append([name, _cranes(runner), rounded, ratio, runner.max_deviation])
    return sorted(rows, key=lambda row: -float(row[2] or 0.0))


def _cranes(runner: Ready) -> int:
    """Return how many cranes a contestant runs together."""
    return CRANES if runner.contestant.many else 1


def chart(rows: Rows) -> Figure:
    """Draw a bar for each engine with its number, the fastest on top."""
    figure, (ax,) = panels(height=0.4 * len(rows) + 1.2, width=9.0)
    labels = []
    colours = []
    rates = []
    for name, cranes, rate, *_ in rows:
        label = "cranedyn, compiled batch" if name == _BATCH else f"{name}"
        labels.append(label if cranes == CRANES else f"{label} (one crane)")
        rates.append(float(rate or 0.0))
        if name in (_BATCH, "plain loop"):
            colours.append(OUR_COLOUR)
        elif str(name).startswith(_BY_HAND):
            colours.append(LIMIT_COLOUR)
        else:
            colours.append(OTHER_COLOUR)
    ax.barh(labels, rates, color=colours)
    for place, rate in enumerate(rates):
        ax.text(1.08 * rate, place, f"{rate:,.3g}", va="center")
    ax.set(xscale="log", xlim=(0.5 * min(rates), 4.0 * max(rates)))
    ax.set(xlabel=f"million physics steps a second, {CRANES:,} cranes (log)")
    ax.invert_yaxis()
    return figure


def peers_benchmark(
    rounds: int, quick: bool, contestants: Sequence[Contestant] | None = None
) -> Results:
    """Return the tables of engines and of those not shown, and the chart."""
    case = Case()
    ready, refused = sort(case, peers() if contestants is None else contestants)
    rows = measure_peers(case, ready, rounds, 0.05 if quick else 0.5)
    note = (
        f"Median of {rounds} shuffled rounds on {os.cpu_count()} processors that had "
        f"{os.getloadavg()[1]:.0f} processes to run on average; compiling not counted. Apart: "
        f"largest difference from the plain loop over {STRETCH:g} s; who differs by more than "
        f"{ALLOWED:g} is not shown."
    )
    title = f"{CRANES:,} cranes, or one where an engine runs one"
    tables = [ResultTable(title, COLUMNS, rows, note), *refused_table(refused)]
    return tables, lambda: chart(rows)


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    return conduct("peers", __doc__, peers_benchmark, argv, rounds=5)


if __name__ == "__main__":
    sys.exit(main())
