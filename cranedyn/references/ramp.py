"""Move one drive at constant speed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cranedyn.arguments import checked
from cranedyn.errors import number
from cranedyn.interfaces import Reference, Wanted
from cranedyn.references.tabulated import along, tabulated


@dataclass(frozen=True, eq=False)
class Ramp:
    """A reference and a move at constant speed.

    Attributes:
        base: What is wanted otherwise.
        rates: Of slew, trolley and hoist during the move [rad/s, m/s, m/s], shape (3,).
        first, last: When the move starts and ends [s].
    """

    base: Reference
    rates: np.ndarray
    first: float
    last: float

    def __call__(self, t: float) -> Wanted:
        """What is wanted at a time [s]."""
        wanted = self.base(t)
        if t < self.first:
            return wanted
        moved = wanted._replace(position=wanted.position + (min(t, self.last) - self.first) * self.rates)
        return moved._replace(velocity=wanted.velocity + self.rates) if t < self.last else moved

    def at(self, times: np.ndarray) -> Wanted:
        """What is wanted at many times [s], shape (n, 3) each."""
        wanted = tabulated(self.base, times)
        gone, moving = np.clip(times, self.first, self.last) - self.first, (self.first <= times) & (times < self.last)
        position, velocity = wanted.position + np.outer(gone, self.rates), wanted.velocity + np.outer(moving, self.rates)
        return Wanted(position, velocity, wanted.acceleration)


@checked
def ramp(base: Reference, drive: str, by: float, *, rate: float, at: float) -> Reference:
    """Add a move at constant speed to one drive of a reference.

    Args:
        base: What is wanted otherwise.
        drive: "gamma", "x" or "l".
        by: How far to move, with sign [rad or m].
        rate: Speed [rad/s or m/s].
        at: When it starts [s].

    Raises:
        UnknownName: For another drive.
        OutOfRange: For a number that is not finite, or a rate that is not positive.
    """
    direction = math.copysign(1.0, number("ramp distance", by)) * along(drive)
    speed = number("ramp rate", rate, "rad/s or m/s", "> 0")
    return Ramp(base, speed * direction, number("ramp start", at, "s"), at + abs(by) / speed)
