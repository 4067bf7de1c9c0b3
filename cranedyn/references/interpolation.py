"""Linear interpolation in tables with a row at every multiple of a period. Beyond their ends the
first and the last row hold.
"""

from __future__ import annotations

import math

import numpy as np

ROW_TOLERANCE = 1e-6
"""Largest distance of a time from a row at which it counts as the time of that row, as a share of
the period: the rounding of clocks."""


def locate(t: float, period: float, rows: int) -> tuple[int, float]:
    """Return the row at or before a time, and the share of the way to the next row, from 0 to less
    than 1.

    Args:
        t: The time [s].
        period: Time between rows [s].
        rows: Number of rows.
    """
    index = min(max(t / period, 0.0), rows - 1.0)
    nearest = round(index)
    if abs(index - nearest) <= ROW_TOLERANCE:
        return nearest, 0.0
    before = math.floor(index)
    return before, index - before


def locate_many(times: np.ndarray, period: float, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and shares as `locate` for many times [s], shape (n,) each."""
    index = np.clip(times / period, 0.0, rows - 1.0)
    nearest = np.round(index)
    index = np.where(np.abs(index - nearest) <= ROW_TOLERANCE, nearest, index)
    before = np.floor(index)
    return before.astype(int), index - before


def interpolate(table: np.ndarray, row: int, share: float) -> np.ndarray:
    """Return the values of a table, shape (rows, ...), at a row and a share of the way to the next;
    with share 0 the row itself, whatever the next one holds.
    """
    value = table[row]
    return value + share * (table[row + 1] - value) if share else value


def interpolate_many(table: np.ndarray, row: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return values as `interpolate` at many rows and shares, shape (n, ...)."""
    values = table[row]
    between = share > 0.0
    if between.any():
        before, fraction = row[between], share[between].reshape(-1, *[1] * (table.ndim - 1))
        values[between] += fraction * (table[before + 1] - table[before])
    return values
