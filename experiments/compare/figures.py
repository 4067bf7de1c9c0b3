"""The figures of the comparison."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from cranedyn.data.trajectory import Trajectory
from cranedyn.plotting.figures import panels
from cranedyn.plotting.style import run_colour
from experiments.compare.runs import Results, score_of
from experiments.compare.tables import least_swing
from experiments.scenarios.moves import RestToRest
from experiments.scenarios.strategies import strategy_colours

MIN_HEIGHT = 2.2
"""Smallest height of the figure of swings [inch]."""

_MARKERS = "osv^D*PX>d"
"""Markers of the cases, in their order."""


def swing_figure(move: RestToRest, runs: Mapping[str, Trajectory]) -> Figure:
    """Draw the swing of each strategy over time in one move, in strips of the same scale."""
    count = max(len(runs), 1)
    colours = strategy_colours(list(runs))
    # A strip for each strategy. Few of them are higher, so that the labels have room.
    height = max(0.75, MIN_HEIGHT / count)
    figure, axes = panels(count, height=height, sharex=True, sharey=True)
    for ax, (strategy, run) in zip(axes, runs.items(), strict=False):
        ax.plot(
            run.t,
            np.degrees(np.linalg.norm(run.coordinates("phi", "theta"), axis=1)),
            color=colours[strategy],
        )
        ax.axvline(move.duration, linestyle=":", color="#999999", linewidth=1.0)
        ax.text(1.0, 0.95, strategy, transform=ax.transAxes, ha="right", va="top", fontsize=9.0)
    axes[-1].set_xlabel(f"time [s]; dotted: {move.duration:g} s")
    figure.supylabel("swing [°]", fontsize=11.0)
    axes[0].set_title(
        f"Swing of the {move.name} move, radial and tangential together", fontsize=10.0, loc="left"
    )
    return figure


def robustness_figure(move: RestToRest, results: Results, drive: str) -> Figure:
    """Draw the swing 20 s after the arrival of each strategy under each case.

    A swing below the resolution of the tables is drawn at that resolution, as the tables say no
    more about it than that it is smaller.

    Args:
        move: The move.
        results: Results of the move.
        drive: Kind of the drives.
    """
    strategies = list(results)
    least = least_swing(drive)
    figure, (ax,) = panels(height=1.2 + 0.38 * len(strategies))
    cases = list(dict.fromkeys(case for of_case in results.values() for case in of_case))
    for k, (case, offset) in enumerate(zip(cases, np.linspace(0.3, -0.3, len(cases)), strict=True)):
        points = [
            (max(1e3 * score.later, least), len(strategies) - i + offset)
            for i, strategy in enumerate(strategies)
            if (score := score_of(results, strategy, case))
        ]
        if points:
            ax.plot(
                *zip(*points, strict=True),
                _MARKERS[k % 10],
                markersize=4.5,
                linestyle="none",
                color=run_colour(k),
                label=case,
            )
    ax.set(
        xscale="log",
        xlabel=f"swing [mrad]; a point at {least:g} mrad stands for at most that",
        yticks=range(len(strategies), 0, -1),
        yticklabels=strategies,
    )
    ax.set_title(f"Swing 20 s after the arrival of the {move.name} move", fontsize=10.0, loc="left")
    if ax.lines:  # some strategy could be made
        figure.legend(loc="outside upper center", ncols=5, fontsize=9.0, frameon=False)
    return figure
