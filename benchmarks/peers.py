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

OUR_COLOUR = "#1f77b4"
"""Colour of the engines of this project."""

LIMIT_COLOUR = "#444444"
"""Colour of equations written by hand, which show what can be reached."""

OTHER_COLOUR = "#bbbbbb"
"""Colour of other simulators."""


def peers() -> tuple[Contestant, ...]:
    """Return all contestants, less slower variants of this project and of C on one thread."""
    best = (_BATCH, "plain loop", f"C by hand, {os.cpu_count()} threads")
    slower = {c.name for c in ours.CONTESTANTS} - {*best}
    return tuple(
        c
        for c in (*CONTESTANTS, *jax.CONTESTANTS)
        if c.name not in slower and not (c.name.startswith("C by hand") and c.name not in best)
    )


def measure_peers(case: Case, ready: Sequence[Ready], rounds: int, budget: float) -> Rows:
    """Return a row for each engine, the fastest first: steps/s, ratio, deviation; arguments as
    `benchmarks.timing.step_rates`.
    """
    names = [e.contestant.name for e in ready]
    if _BATCH not in names:
        raise CraneError("Nothing can be compared: the compiled batch cannot run here.")
    sizes = [CRANES if e.contestant.many else 1 for e in ready]
    entries = [(e.run, size) for e, size in zip(ready, sizes, strict=True)]
    rates = 1e-6 * step_rates(case, entries, rounds, budget, np.random.default_rng(0))
    middle = np.median(rates, axis=1)
    batch_rate = middle[names.index(_BATCH)]
    rows: Rows = [
        [name, size, float(f"{rate:.3g}"), float(f"{rate / batch_rate:.3g}"), e.max_deviation]
        for name, size, rate, e in zip(names, sizes, middle.tolist(), ready, strict=True)
    ]
    return sorted(rows, key=lambda row: -float(row[2] or 0.0))


def chart(rows: Rows) -> Figure:
    """Draw a bar for each engine with its number, the fastest on top."""
    figure, (ax,) = panels(height=0.4 * len(rows) + 1.2, width=9.0)
    names = [
        ("cranedyn, compiled batch" if name == _BATCH else f"{name}")
        + ("" if cranes == CRANES else " (one crane)")
        for name, cranes, *_ in rows
    ]
    rates = [float(row[2] or 0.0) for row in rows]
    colours = [
        OUR_COLOUR if row[0] in (_BATCH, "plain loop")
        else LIMIT_COLOUR if str(row[0]).startswith("C by hand")
        else OTHER_COLOUR
        for row in rows
    ]  # fmt: skip
    ax.barh(names, rates, color=colours)
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
