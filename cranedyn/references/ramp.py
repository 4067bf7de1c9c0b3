"""Move one drive at constant speed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cranedyn.checks import number
from cranedyn.interfaces import Reference, Setpoint
from cranedyn.model.crane import Crane
from cranedyn.references.tabulated import as_setpoint, tabulated


@dataclass(frozen=True, eq=False)
class Ramp:
    """A reference and a move at constant speed.

    Attributes:
        base: The reference otherwise.
        rates: Of the drives during the move [rad/s or m/s], shape (m,).
        first, last: When the move starts and ends [s].
    """

    base: Reference
    rates: np.ndarray
    first: float
    last: float

    def __call__(self, t: float) -> Setpoint:
        """Return the setpoint at a time [s]."""
        setpoint = as_setpoint(self.base(t), self.rates.shape)
        if t < self.first:
            return setpoint
        moved = setpoint._replace(
            position=setpoint.position + (min(t, self.last) - self.first) * self.rates
        )
        return moved._replace(velocity=setpoint.velocity + self.rates) if t < self.last else moved

    def at(self, times: np.ndarray) -> Setpoint:
        """Return setpoints at many times [s], shape (n, m) each."""
        setpoint = tabulated(self.base, times, len(self.rates))
        elapsed, moving = (
            np.clip(times, self.first, self.last) - self.first,
            (self.first <= times) & (times < self.last),
        )
        position, velocity = (
            setpoint.position + np.outer(elapsed, self.rates),
            setpoint.velocity + np.outer(moving, self.rates),
        )
        return Setpoint(position, velocity, setpoint.acceleration)


def ramp(
    crane: Crane, base: Reference, drive: str, by: float, *, rate: float, at: float
) -> Reference:
    """Add a move at constant speed to one drive of a reference.

    Args:
        crane: The crane.
        base: The reference otherwise.
        drive: Symbol of its coordinate, such as "x".
        by: How far to move, with sign [rad or m].
        rate: Speed [rad/s or m/s].
        at: When it starts [s].

    Raises:
        UnknownName: For another drive.
        OutOfRange: For a number that is not finite, or a rate that is not positive.
    """
    direction = math.copysign(1.0, number("ramp distance", by)) * crane.layout.along(drive)
    speed = number("ramp rate", rate, "rad/s or m/s", "> 0")
    return Ramp(base, speed * direction, number("ramp start", at, "s"), at + abs(by) / speed)
