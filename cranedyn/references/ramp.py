"""Move one drive at constant speed."""

from __future__ import annotations

import math

from cranedyn.errors import number
from cranedyn.references.wanted import Reference, Wanted, along


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
    first, last = number("ramp start", at, "s"), at + abs(by) / speed

    def reference(t: float) -> Wanted:
        wanted = base(t)
        if t < first:
            return wanted
        moved = wanted._replace(position=wanted.position + speed * (min(t, last) - first) * direction)
        return moved._replace(velocity=wanted.velocity + speed * direction) if t < last else moved

    return reference
