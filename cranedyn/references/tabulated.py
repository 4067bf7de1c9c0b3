"""What a reference says."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from cranedyn.arguments import described
from cranedyn.arrays import finite
from cranedyn.errors import Misshapen, UnknownName
from cranedyn.interfaces import Reference, Setpoint

_PARTS = ("position", "velocity", "acceleration")


def checked_setpoint(answer: Any) -> Setpoint:
    """What a reference answered, if it is three finite positions, rates and accelerations.

    Raises:
        Misshapen: If it is anything else.
        OutOfRange: If a number is not finite.
    """
    try:  # quickly, since it is asked at every control instant
        (a, b, c), (d, e, f), (g, h, i) = answer.position.tolist(), answer.velocity.tolist(), answer.acceleration.tolist()
        if math.isfinite(a + b + c + d + e + f + g + h + i) and type(answer) is Setpoint:
            return answer
    except (AttributeError, TypeError, ValueError):
        pass
    return _setpoints(answer, (3,))


def _setpoints(answer: Any, shape: tuple[int, ...]) -> Setpoint:
    """What a reference answered, as arrays of finite numbers of one shape."""
    if not isinstance(answer, Setpoint):
        raise Misshapen("answer of the reference", described(answer), "a cranedyn.Setpoint: position, velocity, acceleration")
    return Setpoint(*(finite(f"{name} that the reference wants", part, shape) for name, part in zip(_PARTS, answer, strict=True)))


def tabulated(reference: Reference, times: np.ndarray) -> Setpoint:
    """The setpoints of a reference at many times [s], shape (n, 3) each; by its own `at` if it has one, which takes all at once.

    Raises:
        Misshapen: If it answers with anything but arrays of that shape.
        OutOfRange: If a number is not finite.
    """
    at_once = getattr(reference, "at", None)
    if at_once is not None:
        return _setpoints(at_once(times), (len(times), 3))
    rows = [checked_setpoint(reference(t)) for t in times.tolist()]
    return Setpoint(*(np.array(column, dtype=float) for column in zip(*rows, strict=True)))


class Tabulating(ABC):
    """A reference that is written down for many times at once."""

    @abstractmethod
    def at(self, times: np.ndarray) -> Setpoint:
        """Setpoints at many times [s], shape (n, 3) each."""

    def __call__(self, t: float) -> Setpoint:
        """The setpoint at a time [s]."""
        return Setpoint(*(part[0] for part in self.at(np.array([t]))))


_DRIVES = ("gamma", "x", "l")


def along(drive: str) -> np.ndarray:
    """Unit vector of one drive among slew "gamma", trolley "x" and hoist "l", shape (3,).

    Raises:
        UnknownName: For another name.
    """
    if drive not in _DRIVES:
        raise UnknownName("drive", drive, _DRIVES)
    return np.eye(3)[_DRIVES.index(drive)]
