"""Cost of a physics step against the number of cranes and against the length of the run."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from benchmarks.agreement import Ready
from benchmarks.contestants.ours import PLAIN
from benchmarks.timing import race, stretch
from benchmarks.workload import Case, Run
from cranedyn.plotting.figures import legend_above, panels

SIZES = tuple(10**k for k in range(6))
"""Numbers of cranes."""

LENGTHS = (10, 100, 1_000, 10_000, 140_000)
"""Numbers of physics steps."""

ROUNDS = 3
"""Number of shuffled rounds in which all are measured."""

_MARKS = "osD^vP*X"
"""Marks of curves; they repeat."""


class _Entry(NamedTuple):
    """What is measured.

    Attributes:
        ready: Who runs.
        cranes: How many cranes run together.
        duration: Simulated time of a run [s].
        repetitions: How often the run is repeated, so that short ones take long enough.
    """

    ready: Ready
    cranes: int
    duration: float
    repetitions: int


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
    sizes = SIZES[:4] if quick else SIZES
    lengths = LENGTHS[:3] if quick else LENGTHS
    entries = _entries(case, ready, sizes, lengths, quick=quick)
    costs = _costs(case, entries, rng)
    figure, (left, right) = panels(1, 2, height=5.2, width=11.0, sharey=True)
    for k, runner in enumerate(ready):
        contestant = runner.contestant
        cost = []
        for entry, entry_cost in zip(entries, costs, strict=True):
            if entry.ready is runner:
                cost.append(entry_cost)
        colour: Any = mpl.colormaps["turbo"](0.05 + 0.9 * k / max(len(ready) - 1, 1))
        if contestant is PLAIN:
            colour = "black"
            left.axhline(cost[-1], linestyle=":", color="black", label=f"{PLAIN.name}, one crane")
        mark = _MARKS[k % len(_MARKS)]
        ax, x = (left, sizes) if contestant.many else (right, lengths)
        ax.plot(x, cost, marker=mark, markersize=5.0, color=colour, label=contestant.name)
    left.set(xlabel="cranes at once", ylabel="time per physics step [ns]")
    right.set(xlabel="physics steps of one crane")
    for ax in (left, right):
        ax.set(xscale="log", yscale="log")
        legend_above(ax, columns=2)
    return figure


def _entries(
    case: Case,
    ready: Sequence[Ready],
    sizes: Sequence[int],
    lengths: Sequence[int],
    *,
    quick: bool,
) -> list[_Entry]:
    """Return what is measured: all sizes of who runs many cranes, all lengths of the others.

    Args:
        case: What is run.
        ready: Who runs it.
        sizes: Numbers of cranes.
        lengths: Numbers of physics steps.
        quick: Measure less precisely.
    """
    budget = 0.02 if quick else 0.6
    fewest_steps = 1_000 if quick else 10_000
    entries = []
    for runner in ready:
        if runner.contestant.many:
            runs = [(size, stretch(case, runner.run, size, budget)) for size in sizes]
        else:
            runs = [(1, length * case.dt) for length in lengths]
        for cranes, duration in runs:
            steps = cranes * case.steps * case.periods(duration)
            repetitions = max(fewest_steps // steps, 1)
            entries.append(_Entry(runner, cranes, duration, repetitions))
    return entries


def _costs(case: Case, entries: Sequence[_Entry], rng: np.random.Generator) -> np.ndarray:
    """Return the median time of a physics step of each entry [ns], shape (entries,)."""
    tasks = []
    steps = []
    for entry in entries:
        starts = case.starts(entry.cranes)
        tasks.append(partial(_repeat, entry.ready.run, starts, entry.duration, entry.repetitions))
        run_steps = entry.cranes * case.steps * case.periods(entry.duration)
        steps.append(run_steps * entry.repetitions)
    times = np.median(race(tasks, ROUNDS, rng), axis=1)
    return 1e9 * times / np.array(steps)


def _repeat(run: Run, starts: np.ndarray, duration: float, times: int) -> None:
    """Run cranes from their starts several times in a row."""
    for _ in range(times):
        run(starts, duration)
