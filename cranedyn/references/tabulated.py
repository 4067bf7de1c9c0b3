"""Setpoints in tables: checked, at many times at once, and on straight lines between rows. Beyond
the ends of a table its first and last row hold.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from cranedyn.checks import finite, short_repr
from cranedyn.errors import CraneError, Misshapen, format_error
from cranedyn.interfaces import Reference, Setpoint

_PARTS = ("position", "velocity", "acceleration")


def as_setpoint(setpoint: Any, shape: tuple[int | str, ...] = ("m",)) -> Setpoint:
    """Check the setpoint of a reference.

    Args:
        setpoint: The setpoint.
        shape: Shape of positions, rates and accelerations; a letter stands for any length.

    Raises:
        Misshapen: If it is not a setpoint of arrays of this shape.
        OutOfRange: If a number is not finite.
    """
    if len(shape) == 1 and _sound(setpoint, shape[0]):
        return setpoint
    if not isinstance(setpoint, Setpoint):
        allowed = "a cranedyn.Setpoint: position, velocity, acceleration"
        raise Misshapen("answer of the reference", short_repr(setpoint), allowed)
    arrays = []
    for name, component in zip(_PARTS, setpoint, strict=True):
        arrays.append(finite(f"{name} of the setpoint", component, shape))
        shape = arrays[0].shape
    return Setpoint(*arrays)


def _sound(setpoint: Any, drives: int | str) -> bool:
    """Return whether a setpoint holds finite numbers for all drives; quick, for every control
    instant.
    """
    try:
        position = setpoint.position.tolist()
        velocity = setpoint.velocity.tolist()
        acceleration = setpoint.acceleration.tolist()
        alike = len(position) == len(velocity) == len(acceleration) == drives
        # A sum is finite if every term is; NaN and infinity remain in it.
        is_finite = math.isfinite(sum(position) + sum(velocity) + sum(acceleration))
        return alike and is_finite and type(setpoint) is Setpoint
    except (AttributeError, TypeError, ValueError):
        return False


def tabulated(reference: Reference, times: np.ndarray, drives: int | None = None) -> Setpoint:
    """Return the setpoints of a reference at many times [s], shape (rows, m) each, by its method
    `at` if it has one.

    Args:
        reference: The reference.
        times: The times [s].
        drives: Number of drives; None for any number.

    Raises:
        Misshapen: If a setpoint has another shape.
        OutOfRange: If a number is not finite.
        CraneError: If the reference raises an error, which is its cause.
    """
    columns = "m" if drives is None else drives
    at = getattr(reference, "at", None)
    with owned("reference"):
        if at is not None:
            return as_setpoint(at(times), (len(times), columns))
        rows = [as_setpoint(reference(t), (columns,)) for t in times.tolist()]
    if not rows:
        return Setpoint(*np.empty((3, 0, drives or 0)))
    return Setpoint(*(np.array(column, dtype=float) for column in zip(*rows, strict=True)))


@contextmanager
def owned(role: str) -> Iterator[None]:
    """Turn errors of a caller's function into a `CraneError` that names its role.

    Raises:
        CraneError: If the block raises any other error, which is its cause.
    """
    try:
        yield
    except CraneError:
        raise
    except Exception as error:
        raise CraneError(f"The {role} raised {format_error(error)}") from error


class Tabulating(ABC):
    """A reference that is written down for many times at once."""

    @abstractmethod
    def at(self, times: np.ndarray) -> Setpoint:
        """Return setpoints at many times [s], shape (rows, m) each."""

    def __call__(self, t: float) -> Setpoint:
        """Return the setpoint at a time [s]."""
        return Setpoint(*(component[0] for component in self.at(np.array([t]))))


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
        before = row[between]
        # One share for each row, whatever the number of axes of the table.
        fraction = share[between].reshape(-1, *[1] * (table.ndim - 1))
        values[between] += fraction * (table[before + 1] - table[before])
    return values
