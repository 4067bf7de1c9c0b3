"""Figures of the sweep."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from scipy.stats import binned_statistic_2d

from cranedyn.plotting.figures import panels
from experiments.scenarios.drawn import RANGES
from experiments.scenarios.strategies import strategy_colour

Columns = Mapping[str, np.ndarray]


def map_figure(columns: Columns) -> Figure:
    """Plot the residual swing of each strategy over load and cable, for the median duration."""
    durations = np.unique(columns["duration_s"])
    duration = durations[len(durations) // 2]
    selected = columns["duration_s"] == duration
    maps = {}
    for strategy in dict.fromkeys(columns["strategy"].tolist()):
        of_strategy = selected & (columns["strategy"] == strategy)
        loads, cables = (
            np.unique(columns[name][of_strategy]) for name in ("load", "cable_error_m")
        )
        residual = 1e3 * columns["residual_swing_rad"][of_strategy].reshape(len(loads), len(cables))
        maps[strategy] = _Map(cables, loads, residual)
    return _maps(maps, f"swing left of a move in {duration:.3g} s [mrad]")


_CELLS = 12
"""Cells of a map of drawn cases along each side."""


def drawn_figure(columns: Columns) -> Figure:
    """Plot the median residual swing of each strategy in cells of load and cable.

    A cell without cases, or in which most diverge, stays empty.
    """
    maps = {}
    for strategy in dict.fromkeys(columns["strategy"].tolist()):
        of_strategy = columns["strategy"] == strategy
        residual = 1e3 * columns["residual_swing_rad"][of_strategy]
        median, loads, cables, _ = binned_statistic_2d(
            columns["load"][of_strategy],
            columns["cable_error_m"][of_strategy],
            np.where(np.isfinite(residual), residual, np.inf),
            statistic="median",
            bins=_CELLS,
            range=[RANGES["load"], RANGES["cable_error_m"]],
        )
        across, up = ((edges[1:] + edges[:-1]) / 2.0 for edges in (cables, loads))
        maps[strategy] = _Map(across, up, np.where(np.isfinite(median), median, np.nan))
    return _maps(maps, "median of the swing left [mrad]")


class _Map(NamedTuple):
    """Swing left [mrad], shape (loads, cables), over errors of the cable [m] and loads."""

    cables: np.ndarray
    loads: np.ndarray
    left: np.ndarray


def _maps(maps: Mapping[str, _Map], label: str) -> Figure:
    swings = np.concatenate([panel.left[np.isfinite(panel.left)] for panel in maps.values()])
    norm = LogNorm(swings.min(), swings.max()) if len(swings) else LogNorm(1.0, 10.0)
    rows = -(-len(maps) // 4)
    figure, axes = panels(rows, 4, height=2.6, width=11.0, sharex=True, sharey=True)
    for ax, (strategy, values) in zip(axes, maps.items(), strict=False):
        mesh = ax.pcolormesh(*values, norm=norm, cmap="viridis", rasterized=True)
        ax.set_title(strategy, fontsize=10.0)
        ax.grid(visible=False)
    for ax in axes[len(maps) :]:
        ax.set_axis_off()
    figure.supxlabel("cable longer than measured by [m]", fontsize=11.0)
    figure.supylabel("payload over that planned for", fontsize=11.0)
    figure.colorbar(mesh, ax=axes, label=label)
    return figure


def timing_figure(columns: Columns) -> Figure:
    """Plot the residual swing of each strategy over the time for the move: median and range."""
    figure, (ax,) = panels(height=4.6)
    durations = np.unique(columns["duration_s"])
    for k, strategy in enumerate(dict.fromkeys(columns["strategy"].tolist())):
        of_strategy = columns["strategy"] == strategy
        residual = [
            1e3 * columns["residual_swing_rad"][of_strategy & (columns["duration_s"] == d)]
            for d in durations
        ]
        lowest, middle, highest = np.nanquantile(np.array(residual), [0.0, 0.5, 1.0], axis=1)
        (line,) = ax.plot(
            durations,
            middle,
            marker="osv^D*Px"[k % 8],
            markersize=4.0,
            color=strategy_colour(strategy),
            label=strategy,
        )
        ax.fill_between(
            durations, lowest, highest, color=line.get_color(), alpha=0.15, linewidth=0.0
        )
    ax.set(yscale="log", xlabel="time for the move [s]", ylabel="swing left 10 s after it [mrad]")
    ax.legend(ncols=2, fontsize=9.0)
    return figure
