"""What a reference says."""

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
        raise Misshapen(
            "answer of the reference",
            short_repr(setpoint),
            "a cranedyn.Setpoint: position, velocity, acceleration",
        )
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
        position, velocity = setpoint.position.tolist(), setpoint.velocity.tolist()
        acceleration = setpoint.acceleration.tolist()
        alike = len(position) == len(velocity) == len(acceleration) == drives
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
    at_once = getattr(reference, "at", None)
    with owned("reference"):
        if at_once is not None:
            return as_setpoint(at_once(times), (len(times), columns))
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
