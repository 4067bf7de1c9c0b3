"""Figures of the sweep."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from scipy.stats import binned_statistic_2d

from cranedyn.plotting.figures import panels
from experiments.scenarios.colours import strategy_colour
from experiments.scenarios.drawn import RANGES

Columns = Mapping[str, np.ndarray]


def map_figure(found: Columns) -> Figure:
    """Residual swing of each strategy over load and cable, for the middle one of the durations."""
    durations = np.unique(found["duration_s"])
    here = found["duration_s"] == durations[len(durations) // 2]
    left = 1e3 * found["residual_swing_rad"][here]
    maps = {}
    for strategy in dict.fromkeys(found["strategy"].tolist()):
        mine = found["strategy"][here] == strategy
        loads, cables = (np.unique(found[name][here][mine]) for name in ("load", "cable_error_m"))
        maps[strategy] = _Map(cables, loads, left[mine].reshape(len(loads), len(cables)))
    seconds = f"{durations[len(durations) // 2]:.3g} s"
    return _maps(maps, f"swing left of a move in {seconds} [mrad]")


_CELLS = 12
"""Of a map of drawn cases, on each side."""


def drawn_figure(found: Columns) -> Figure:
    """Residual swing of each strategy over load and cable, the median of the cases in each cell; a
    cell in which most diverge, or none is, stays empty.
    """
    maps = {}
    for strategy in dict.fromkeys(found["strategy"].tolist()):
        mine = found["strategy"] == strategy
        left = 1e3 * found["residual_swing_rad"][mine]
        median, loads, cables, _ = binned_statistic_2d(
            found["load"][mine],
            found["cable_error_m"][mine],
            np.where(np.isfinite(left), left, np.inf),
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
    """A panel for each strategy, all on one scale."""
    known = np.concatenate([one.left[np.isfinite(one.left)] for one in maps.values()])
    norm = LogNorm(known.min(), known.max()) if len(known) else LogNorm(1.0, 10.0)
    rows = -(-len(maps) // 4)
    figure, axes = panels(rows, 4, height=2.6, width=11.0, sharex=True, sharey=True)
    for ax, (strategy, one) in zip(axes, maps.items(), strict=False):
        drawn = ax.pcolormesh(*one, norm=norm, cmap="viridis", rasterized=True)
        ax.set_title(strategy, fontsize=10.0)
        ax.grid(visible=False)
    for ax in axes[len(maps) :]:
        ax.set_axis_off()
    figure.supxlabel("cable longer than measured by [m]", fontsize=11.0)
    figure.supylabel("payload over that planned for", fontsize=11.0)
    figure.colorbar(drawn, ax=axes, label=label)
    return figure


def timing_figure(found: Columns) -> Figure:
    """Residual swing of each strategy over the time for the move: median, and a band from the least
    to the most.
    """
    figure, (ax,) = panels(height=4.6)
    durations = np.unique(found["duration_s"])
    for k, strategy in enumerate(dict.fromkeys(found["strategy"].tolist())):
        left = [
            1e3
            * found["residual_swing_rad"][
                (found["strategy"] == strategy) & (found["duration_s"] == d)
            ]
            for d in durations
        ]
        least, middle, most = np.nanquantile(np.array(left), [0.0, 0.5, 1.0], axis=1)
        (line,) = ax.plot(
            durations,
            middle,
            marker="osv^D*Px"[k % 8],
            markersize=4.0,
            color=strategy_colour(strategy),
            label=strategy,
        )
        ax.fill_between(durations, least, most, color=line.get_color(), alpha=0.15, linewidth=0.0)
    ax.set(yscale="log", xlabel="time for the move [s]", ylabel="swing left 10 s after it [mrad]")
    ax.legend(ncols=2, fontsize=9.0)
    return figure
