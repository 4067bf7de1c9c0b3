"""Columns as they were sampled: which rows bring a fresh value, how sure it is, and a smooth curve.

A logger often writes a row whenever any sensor reports, so that a column repeats its last value
until its own sensor reports again, and two rows may follow each other within microseconds. The
derivative of an interpolation through such rows is noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import UnivariateSpline

_HELD = 0.2
"""Share of rows that repeat the value before them, above which a column is sampled and held."""

_IRREGULAR = 0.2
"""Least step of a clock over its usual step, below which its times are irregular."""

_STILL = 3.0
"""Intervals without a fresh value after which the sensor stands still, and its value counts."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Fresh values of a column.

    Attributes:
        rows: Indices of the rows with a fresh value, and of some where the sensor stands still.
        held: Share of rows that repeat the value before them while it changes.
        interval: Usual time from one fresh value to the next [s].
        resolution: Least difference of two values.
        lateness: Time [s] that a value may have waited for its row, at most.
    """

    rows: np.ndarray
    held: float
    interval: float
    resolution: float
    lateness: float

    @property
    def is_held(self) -> bool:
        """Whether most rows of the column are no measurements of their own."""
        return self.held > _HELD


def samples(t: np.ndarray, values: np.ndarray) -> Samples:
    """Return the fresh values of a column.

    Args:
        t: Times [s], increasing, shape (rows,).
        values: The column, shape (rows,).
    """
    changed = np.flatnonzero(np.diff(values)) + 1
    fresh = np.concatenate([[0], changed])
    distinct = np.unique(values)
    resolution = float(np.min(np.diff(distinct))) if len(distinct) > 1 else 0.0
    lateness = float(np.mean(np.diff(t)))
    if len(changed) < 2:
        return Samples(np.arange(len(t)), 0.0, lateness, resolution, lateness)
    gaps = np.diff(t[fresh])
    interval = float(np.median(gaps[gaps < 2.0 * np.percentile(gaps, 25)]))
    moving = gaps < _STILL * interval
    rows_moving = int(np.diff(fresh)[moving].sum())
    held = 1.0 - float(moving.sum()) / rows_moving if rows_moving else 0.0
    if held <= _HELD:
        return Samples(np.arange(len(t)), held, lateness, resolution, lateness)
    rows, last = [0], 0
    for row in range(1, len(t)):
        if values[row] != values[row - 1] or t[row] - t[last] > _STILL * interval:
            rows.append(row)
            last = row
    return Samples(np.array(rows), held, interval, resolution, lateness)


def is_irregular(t: np.ndarray) -> bool:
    """Return whether some times follow each other much closer than is usual."""
    steps = np.diff(t)
    return bool(steps.min() < _IRREGULAR * np.median(steps))


def smooth(t: np.ndarray, values: np.ndarray, sampled: Samples) -> tuple[UnivariateSpline, float]:
    """Return a smoothing spline through the fresh values of a column, and its largest allowed
    deviation there as a standard deviation.

    The variance of a value is that of its rounding, r²/12, and that of its time, (v τ)²/12 for a
    value that moves at v and waited up to τ. The spline deviates by these on average, and by no
    more: it is as stiff as they allow.

    Args:
        t: Times [s], shape (rows,).
        values: The column, shape (rows,).
        sampled: Its samples.
    """
    times, points = t[sampled.rows], values[sampled.rows]
    rate = np.gradient(points, times)
    usual = np.convolve(np.abs(rate), np.full(5, 0.2), mode="same")
    variance = (sampled.resolution**2 + (usual * sampled.lateness) ** 2) / 12.0
    deviation = np.sqrt(np.maximum(variance, 1e-24))
    spline = UnivariateSpline(times, points, w=1.0 / deviation, s=len(times), ext="const")
    return spline, float(math.sqrt(np.mean(variance)))
