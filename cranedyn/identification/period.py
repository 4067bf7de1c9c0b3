"""The period of a recorded swing, and the periods that a crane can have."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.signal import detrend

from cranedyn.dynamics.equations_of_motion import natural_frequencies
from cranedyn.model.crane import Crane

MAX_SAMPLES = 2**16
"""Largest number of samples of a spectrum; a longer record is resampled more coarsely."""

MIN_RECORDED_PERIODS = 2.0
"""Least number of periods in a record by which its period is told."""

DOMINANT_SHARE = 0.5
"""Least share of the power of a spectrum that its peak holds, where one period dominates."""

_MIN_ROWS = 8
"""Least number of rows of a record whose spectrum is looked at."""

_PEAK_BINS = 2
"""Bins to either side of the peak that belong to it: the main lobe of Hann's window."""

_LENGTHS = 41
"""Number of cable lengths at which the periods of a crane are looked at."""

_SHORTEST_CABLE = 0.05
"""Shortest cable that is looked at [m]."""


class PeriodRange(NamedTuple):
    """Shortest and longest period of small swings of a crane [s]."""

    shortest: float
    longest: float


def recorded_period(t: np.ndarray, values: np.ndarray, *, is_rate: bool) -> float | None:
    """Return the period of the largest oscillation of a swing [s], by its spectrum; None where no
    period dominates, or fewer than `MIN_RECORDED_PERIODS` of it were recorded.

    Args:
        t: Times [s], increasing, shape (rows,).
        values: The swing or its rate, shape (rows,).
        is_rate: Whether it is the rate. Its spectrum is divided by the frequency, as an angle's.
    """
    if len(t) < _MIN_ROWS:
        return None
    count = min(len(t), MAX_SAMPLES)
    even_times = np.linspace(t[0], t[-1], count)
    samples = detrend(np.interp(even_times, t, values)) * np.hanning(count)
    frequencies = np.fft.rfftfreq(count, (t[-1] - t[0]) / (count - 1))
    spectrum = np.abs(np.fft.rfft(samples)) ** 2
    power = spectrum.copy()
    power[0] = 0.0
    if is_rate:
        # The power of an angle is that of its rate over ω². That lifts the lowest bins, which hold
        # the drift of a gyroscope.
        power[1:] /= frequencies[1:] ** 2
        power[1:_PEAK_BINS] = 0.0
    total = float(power.sum())
    # The index of a bin is the number of its periods in the record.
    peak = int(np.argmax(power))
    if total <= 0.0 or not MIN_RECORDED_PERIODS <= peak < len(power) - 1:
        return None
    lobe = power[max(peak - _PEAK_BINS, 1) : peak + _PEAK_BINS + 1]
    if float(lobe.sum()) < DOMINANT_SHARE * total:
        return None
    # The top of a parabola through the logarithms of three bins lies between them.
    # It is laid through the spectrum as recorded, also where that is of a rate.
    near = np.maximum(spectrum[peak - 1 : peak + 2], 1e-12 * spectrum[peak])
    left, middle, right = np.log(near)
    shift = 0.5 * (left - right) / (left - 2.0 * middle + right)
    return float(1.0 / ((peak + float(np.clip(shift, -0.5, 0.5))) * frequencies[1]))


def possible_periods(crane: Crane, q: np.ndarray, offset: float) -> PeriodRange:
    """Return the range of the periods of small swings over all lengths of the cable.

    Args:
        crane: The crane.
        q: Coordinates of the drives, shape (n,); the cable's does not count.
        offset: How far beyond its range the cable may be [m].
    """
    lengths: list[float | None] = [None]
    hoist = None if crane.winch is None else int(crane.layout.drives[crane.winch])
    if hoist is not None:
        low = max(float(crane.lower[hoist]) - offset, _SHORTEST_CABLE)
        high = max(float(crane.upper[hoist]) + offset, low)
        lengths = list(np.geomspace(low, high, _LENGTHS).tolist())
    shortest = math.inf
    longest = 0.0
    for length in lengths:
        position = q.copy()
        if hoist is not None:
            position[hoist] = length
        frequencies = natural_frequencies(crane, position, crane.swings)
        swinging = frequencies[frequencies > 0.0]
        if len(swinging):
            shortest = min(shortest, 2.0 * math.pi / float(swinging[-1]))
            longest = max(longest, 2.0 * math.pi / float(swinging[0]))
    return PeriodRange(shortest, longest or math.inf)
