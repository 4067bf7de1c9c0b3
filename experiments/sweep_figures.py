"""Figures of the sweep."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from cranedyn.plotting.figures import panels
from experiments.scenarios.colours import strategy_colour

Columns = Mapping[str, np.ndarray]


def map_figure(found: Columns) -> Figure:
    """Residual swing of each strategy over load and cable, for the middle one of the durations."""
    durations = np.unique(found["duration_s"])
    here = found["duration_s"] == durations[len(durations) // 2]
    left = 1e3 * found["residual_swing_rad"][here]
    norm = LogNorm(np.nanmin(left), np.nanmax(left))
    strategies = list(dict.fromkeys(found["strategy"].tolist()))
    rows = -(-len(strategies) // 4)
    figure, axes = panels(rows, 4, height=2.6, width=11.0, sharex=True, sharey=True)
    for ax, strategy in zip(axes, strategies, strict=False):
        mine = found["strategy"][here] == strategy
        loads, cables = (np.unique(found[name][here][mine]) for name in ("load", "cable_error_m"))
        drawn = ax.pcolormesh(
            cables,
            loads,
            left[mine].reshape(len(loads), len(cables)),
            norm=norm,
            cmap="viridis",
            rasterized=True,
        )
        ax.set_title(strategy, fontsize=10.0)
        ax.grid(visible=False)
    for ax in axes[len(strategies) :]:
        ax.set_axis_off()
    figure.supxlabel("cable longer than measured by [m]", fontsize=11.0)
    figure.supylabel("payload over that planned for", fontsize=11.0)
    seconds = f"{durations[len(durations) // 2]:.3g} s"
    figure.colorbar(drawn, ax=axes, label=f"swing left of a move in {seconds} [mrad]")
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
