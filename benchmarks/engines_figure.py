"""Cost of a physics step against the number of cranes and against the length of the run."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from benchmarks.agreement import Ready
from benchmarks.contestants.ours import PLAIN
from benchmarks.timing import race, stretch
from benchmarks.workload import Case, Run
from cranedyn.plotting.figures import panels

SIZES = tuple(10**k for k in range(6))
"""Numbers of cranes."""

LENGTHS = (10, 100, 1_000, 10_000, 140_000)
"""Numbers of physics steps."""

_MARKS = "osD^vP*X"


def engines_figure(
    case: Case, ready: Sequence[Ready], rng: np.random.Generator, *, quick: bool
) -> Figure:
    """Measure in three shuffled rounds and plot both costs; short runs are repeated.

    Args:
        case: What is run.
        ready: Who runs it.
        rng: Shuffles the rounds.
        quick: Leave out the largest numbers.
    """
    sizes, lengths = (SIZES[:4], LENGTHS[:3]) if quick else (SIZES, LENGTHS)
    budget, fewest = (0.02, 1_000) if quick else (0.6, 10_000)
    runs = []
    for e in ready:
        if e.contestant.many:
            runs += [(e, size, stretch(case, e.run, size, budget)) for size in sizes]
        else:
            runs += [(e, 1, length * case.dt) for length in lengths]
    steps = [cranes * case.steps * case.periods(length) for _, cranes, length in runs]
    times = [max(fewest // count, 1) for count in steps]
    tasks = [
        partial(_repeat, e.run, case.starts(cranes), length, n)
        for (e, cranes, length), n in zip(runs, times, strict=True)
    ]
    costs = 1e9 * np.median(race(tasks, 3, rng), axis=1) / np.multiply(steps, times)
    figure, (left, right) = panels(1, 2, height=5.2, width=11.0, sharey=True)
    for k, e in enumerate(ready):
        ax, x = (left, sizes) if e.contestant.many else (right, lengths)
        cost = [cost for (other, _, _), cost in zip(runs, costs, strict=True) if other is e]
        colour: Any = mpl.colormaps["turbo"](0.05 + 0.9 * k / max(len(ready) - 1, 1))
        colour = "black" if e.contestant is PLAIN else colour
        mark = _MARKS[k % len(_MARKS)]
        name = e.contestant.name
        ax.plot(x, cost, marker=mark, markersize=5.0, color=colour, label=name)
        if e.contestant is PLAIN:
            left.axhline(cost[-1], linestyle=":", color="black", label=f"{PLAIN.name}, one crane")
    left.set(xlabel="cranes at once", ylabel="time per physics step [ns]")
    right.set(xlabel="physics steps of one crane")
    for ax in (left, right):
        ax.set(xscale="log", yscale="log")
        ax.legend(frameon=False, fontsize=9.0, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def _repeat(run: Run, starts: np.ndarray, duration: float, times: int) -> None:
    for _ in range(times):
        run(starts, duration)
