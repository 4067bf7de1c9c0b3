"""Period and amplitude read off a swing on a moving cable."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cranedyn import theory
from cranedyn.analysis.swing import PowerLaw, fit_power_law, peaks, zero_crossings
from cranedyn.errors import DataError
from cranedyn.model.crane import STANDARD_GRAVITY

RATE, ANALYSED_FROM = 0.5, 12.0
"""Hoisting speed [m/s], and start of the analysis [s]."""


@dataclass(frozen=True)
class Reading:
    """Periods and amplitudes of a record of t, φ, l.

    Attributes:
        times, errors: Middle of each half swing [s], and its period against 2π√(l/g) there,
            relative.
        lengths, amplitudes: Cable length [m] at each peak of |φ|, and the peak [rad].
        hoisting: Whether the cable runs at more than half its speed at a peak.
        everywhere, section: Power laws through all peaks and through those.
    """

    times: np.ndarray
    errors: np.ndarray
    lengths: np.ndarray
    amplitudes: np.ndarray
    hoisting: np.ndarray
    everywhere: PowerLaw
    section: PowerLaw

    @property
    def worst(self) -> float:
        """Largest relative period error."""
        return float(np.abs(self.errors).max())


def read_swing(
    t: np.ndarray, phi: np.ndarray, length: np.ndarray, *, since: float = ANALYSED_FROM
) -> Reading:
    """Read period and amplitude off a swing on a moving cable from a time on, shapes (n,).

    Raises:
        DataError: If the swing has less than three peaks while the cable runs.
    """
    late = t >= since
    crossings = zero_crossings(t[late], phi[late])
    middle = (crossings[1:] + crossings[:-1]) / 2.0
    period = theory.point_period(np.interp(middle, t, length), STANDARD_GRAVITY)
    errors = 2.0 * np.diff(crossings) / period - 1.0
    peak_times, amplitudes = peaks(t[late], phi[late])
    lengths = np.interp(peak_times, t, length)
    hoisting = np.abs(np.interp(peak_times, t, np.gradient(length, t))) > RATE / 2.0
    if hoisting.sum() < 3:
        raise DataError(
            f"From {since:g} s on the swing has {hoisting.sum()} peaks while the cable runs at "
            f"{RATE / 2:g} m/s or more; three are needed."
        )
    everywhere = fit_power_law(lengths, amplitudes)
    section = fit_power_law(lengths[hoisting], amplitudes[hoisting])
    return Reading(middle, errors, lengths, amplitudes, hoisting, everywhere, section)
