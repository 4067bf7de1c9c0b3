"""The figure of the margins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from cranedyn.plotting.figures import panels


def margin_values(margins: Sequence[Sequence[Any]], name: str) -> np.ndarray:
    """Return one of the margins over a map: damping, or the margin of the worst drive."""
    return np.array(
        [
            [m.damping if name == "damping" else getattr(m.least, name) for m in row]
            for row in margins
        ],
        dtype=float,
    )


def margins_figure(
    radii: np.ndarray, cables: np.ndarray, maps_of: Mapping[str, Sequence[Sequence[Any]]]
) -> Figure:
    """Draw damping, and the delay that the worst drive bears, of each strategy over radius and
    cable.
    """
    figure, axes = panels(2, len(maps_of), height=2.8, width=12.5, sharex=True, sharey=True)
    for row, (title, name, scale, form) in enumerate(
        (
            ("least damping [% of critical]", "damping", 100.0, "{:.2g}"),
            ("delay borne [ms]", "late", 1e3, "{:.0f}"),
        )
    ):
        maps = {
            strategy: scale * margin_values(panels_of_row, name)
            for strategy, panels_of_row in maps_of.items()
        }
        norm = LogNorm(
            min(v[v > 0.0].min(initial=v.max()) for v in maps.values()),
            max(v.max() for v in maps.values()),
        )
        panels_of_row = axes[row * len(maps_of) : (row + 1) * len(maps_of)]
        for ax, (strategy, numbers) in zip(panels_of_row, maps.items(), strict=True):
            drawn = ax.pcolormesh(
                radii, cables, numbers, norm=norm, cmap="viridis", rasterized=True
            )
            for (i, j), number in np.ndenumerate(numbers):
                ends = number <= 0.0
                bright = ends or norm(number) > 0.6
                ax.text(
                    float(radii[j]),
                    float(cables[i]),
                    "unstable" if ends else form.format(number),
                    ha="center",
                    va="center",
                    fontsize=6.5,
                    color="black" if bright else "white",
                )
            ax.grid(visible=False)
            if not row:
                ax.set_title(strategy, fontsize=9.5)
        figure.colorbar(drawn, ax=panels_of_row, label=title)
    figure.supxlabel("trolley radius [m]", fontsize=11.0)
    figure.supylabel("cable length [m]", fontsize=11.0)
    return figure
