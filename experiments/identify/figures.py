"""Figures of an identified crane: its record beside the run of its twin, and the residual."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.signal import periodogram

from cranedyn.identification import Estimate
from cranedyn.plotting.figures import COLOURS, legend_above, panels
from cranedyn.plotting.style import GREEK

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RECORDED_COLOUR = "#777777"
"""Colour of what was recorded."""

RESIDUAL_COLOUR = "#000000"
"""Colour of the residual."""


def beside(estimate: Estimate, index: int) -> Figure:
    """Draw each swing of a record as recorded and as predicted, the residual, and both spectra."""
    model = estimate.model
    of_record = model.channels[index]
    channels = [(c, channel) for c, channel in enumerate(of_record) if channel.kind == "swing"]
    record = model.records[index]
    rows = model.rows(index)
    t = record.t[rows]
    measured = model.measured(index)
    figure, axes = panels(len(channels), 3, height=2.8, width=13.0)
    for row, (c, channel) in enumerate(channels):
        wave, residual, spectrum = axes[3 * row : 3 * row + 3]
        symbol = model.prior.crane.layout.symbols[channel.at]
        greek = GREEK.get(symbol, symbol)
        left = estimate.residuals[index][c]
        recorded = 1e3 * measured[c]
        twin = recorded - 1e3 * left
        twin_colour = COLOURS.get(symbol, "#0072B2")
        wave.plot(t, recorded, color=RECORDED_COLOUR, linewidth=2.4, label="recorded")
        wave.plot(t, twin, color=twin_colour, linewidth=1.0, label="twin")
        wave.set(xlabel="time [s]", ylabel=f"{greek} [m{channel.unit}]")
        legend_above(wave)
        residual.plot(t, 1e3 * left, color=RESIDUAL_COLOUR, linewidth=0.7)
        residual.set(xlabel="time [s]", ylabel=f"recorded - twin [m{channel.unit}]")
        shown = spectra(record.interval, t, measured[c], left)
        for density, name, colour in (
            (shown.recorded, "recorded", RECORDED_COLOUR),
            (shown.residual, "left", RESIDUAL_COLOUR),
        ):
            # A logarithmic axis has no zero.
            amplitude = np.sqrt(np.maximum(density, 1e-300))
            spectrum.loglog(shown.frequency, amplitude, color=colour, linewidth=0.9, label=name)
        spectrum.set(xlabel="frequency [Hz]", ylabel="rad/√Hz")
        legend_above(spectrum)
    figure.suptitle(record.name)
    return figure


class Spectra(NamedTuple):
    """Spectra of a record and of its residual.

    Attributes:
        frequency: Frequencies above zero [Hz], shape (frequencies,).
        recorded: Power spectral density of the record [rad²/Hz], shape (frequencies,).
        residual: That of the residual.
    """

    frequency: np.ndarray
    recorded: np.ndarray
    residual: np.ndarray


def spectra(interval: float, t: np.ndarray, measured: np.ndarray, left: np.ndarray) -> Spectra:
    """Return the spectra of a record and of its residual.

    Args:
        interval: Time between the equidistant samples to which both are interpolated [s].
        t: Times of the rows [s].
        measured: The record [rad].
        left: Its residual [rad].
    """
    even = np.arange(t[0], t[-1], interval)
    rate = 1.0 / interval
    frequency, recorded = periodogram(np.interp(even, t, measured), rate, window="hann")
    _, residual = periodogram(np.interp(even, t, left), rate, window="hann")
    return Spectra(frequency[1:], recorded[1:], residual[1:])


def correlations(names: list[str], correlation: np.ndarray) -> Figure:
    """Draw the correlation of each two parameters of the crane."""
    figure, (ax,) = panels(1, height=0.45 * len(names) + 2.0, width=0.55 * len(names) + 3.5)
    image = ax.imshow(correlation, vmin=-1.0, vmax=1.0, cmap="RdBu_r")
    ax.set_xticks(range(len(names)), names, rotation=60, ha="right")
    ax.set_yticks(range(len(names)), names)
    ax.grid(False)
    figure.colorbar(image, ax=ax, label="correlation", shrink=0.8)
    return figure
