"""Figures of an identified crane: what was recorded beside what its twin does, and what is left."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import periodogram

from cranedyn.identification import Estimate
from cranedyn.plotting.figures import COLOURS, panels

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LINES = {"recorded": "#777777", "left": "#000000"}


def beside(estimate: Estimate, index: int) -> Figure:
    """Draw each swing of a record as recorded and as predicted, the residual, and both spectra."""
    model = estimate.model
    channels = [
        (c, channel) for c, channel in enumerate(model.channels[index]) if channel.kind == "swing"
    ]
    record = model.records[index]
    rows = model.rows(index)
    t = record.t[rows]
    measured = model.measured(index)
    figure, axes = panels(len(channels), 3, height=2.8, width=13.0)
    for row, (c, channel) in enumerate(channels):
        wave, residual, spectrum = axes[3 * row : 3 * row + 3]
        symbol = model.prior.crane.layout.symbols[channel.at]
        off = estimate.residuals[index][c]
        recorded = 1e3 * measured[c]
        wave.plot(t, recorded, color=_LINES["recorded"], linewidth=2.4, label="recorded")
        wave.plot(t, recorded - 1e3 * off, color=COLOURS.get(symbol, "#0072B2"), linewidth=1.0,
                  label="twin")  # fmt: skip
        wave.set(xlabel="time [s]", ylabel=f"{symbol} [m{channel.unit}]")
        wave.legend(loc="upper right", fontsize=9)
        residual.plot(t, 1e3 * off, color=_LINES["left"], linewidth=0.7)
        residual.set(xlabel="time [s]", ylabel=f"recorded less twin [m{channel.unit}]")
        frequency, *densities = spectra(record.interval, t, measured[c], off)
        for density, (name, colour) in zip(densities, _LINES.items(), strict=True):
            amplitude = np.sqrt(np.maximum(density, 1e-300))
            spectrum.loglog(frequency, amplitude, color=colour, linewidth=0.9, label=name)
        spectrum.set(xlabel="frequency [Hz]", ylabel="rad/√Hz")
        spectrum.legend(loc="lower left", fontsize=9)
    figure.suptitle(record.name)
    return figure


def spectra(
    interval: float, t: np.ndarray, measured: np.ndarray, off: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return frequencies [Hz], and densities of the record and of its residual [rad²/Hz], at equal
    times an interval [s] apart.
    """
    even = np.arange(t[0], t[-1], interval)
    densities = [
        periodogram(np.interp(even, t, values), 1.0 / interval, window="hann")
        for values in (measured, off)
    ]
    return densities[0][0][1:], densities[0][1][1:], densities[1][1][1:]


def correlations(names: list[str], correlation: np.ndarray) -> Figure:
    """Draw the correlation of each two parameters of the crane."""
    figure, (ax,) = panels(1, height=0.45 * len(names) + 2.0, width=0.55 * len(names) + 3.5)
    image = ax.imshow(correlation, vmin=-1.0, vmax=1.0, cmap="RdBu_r")
    ax.set_xticks(range(len(names)), names, rotation=60, ha="right")
    ax.set_yticks(range(len(names)), names)
    ax.grid(False)
    figure.colorbar(image, ax=ax, label="correlation", shrink=0.8)
    return figure
