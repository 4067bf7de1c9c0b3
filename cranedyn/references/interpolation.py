"""Tables with a row at every multiple of a period, and straight lines between them; beyond their
ends the first and the last row stand.
"""

from __future__ import annotations

import math

import numpy as np

ROW_TOLERANCE = 1e-6
"""By how much of a period a time may miss a row and still be that of the row: what clocks round
off."""


def locate(t: float, period: float, rows: int) -> tuple[int, float]:
    """The row at or before a time, and how far the time is on the way to the next, from 0 to less
    than 1.

    Args:
        t: The time [s].
        period: Time between rows [s].
        rows: How many rows there are.
    """
    where = min(max(t / period, 0.0), rows - 1.0)
    nearest = round(where)
    if abs(where - nearest) <= ROW_TOLERANCE:
        return nearest, 0.0
    before = math.floor(where)
    return before, where - before


def locate_many(times: np.ndarray, period: float, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """`place` for many times [s], shape (n,) each."""
    where = np.clip(times / period, 0.0, rows - 1.0)
    nearest = np.round(where)
    where = np.where(np.abs(where - nearest) <= ROW_TOLERANCE, nearest, where)
    before = np.floor(where)
    return before.astype(int), where - before


def interpolate(table: np.ndarray, row: int, share: float) -> np.ndarray:
    """What a table, shape (rows, ...), says at a place; the row itself where the place is one,
    whatever stands in the next.
    """
    here = table[row]
    return here + share * (table[row + 1] - here) if share else here


def interpolate_many(table: np.ndarray, row: np.ndarray, share: np.ndarray) -> np.ndarray:
    """`at_place` for many places, shape (n, ...)."""
    found = table[row]
    between = share > 0.0
    if between.any():
        before, way = row[between], share[between].reshape(-1, *[1] * (table.ndim - 1))
        found[between] += way * (table[before + 1] - table[before])
    return found
