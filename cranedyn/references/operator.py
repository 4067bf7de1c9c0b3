"""A person at the joystick: velocity commands that the drives follow with limited acceleration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cranedyn.crane import DRIVES, State
from cranedyn.errors import number
from cranedyn.references.wanted import Reference, Wanted, along


class Push(NamedTuple):
    """The joystick held for a while.

    Attributes:
        drive: "gamma", "x" or "l".
        rate: Velocity asked for, with sign [rad/s or m/s].
        at: From when [s].
        hold: For how long [s].
    """

    drive: str
    rate: float
    at: float
    hold: float


def operator(start: State, pushes: Sequence[Push], *, accelerations: Sequence[float]) -> Reference:
    """Where the drives get to: each push is a trapezoid in velocity; pushes of one drive must not overlap to be obeyed in full.

    Args:
        start: Where the drives are.
        pushes: What the operator does.
        accelerations: Limits of slew [rad/s²], trolley [m/s²], hoist [m/s²].

    Raises:
        OutOfRange: If a limit or a hold is not positive.
        UnknownName: If a drive is none of the three.
    """
    limits = [number("acceleration limit", a, "per s²", "> 0") for a in accelerations]
    moves = []
    for push in pushes:
        axis = along(push.drive)
        limit = float(axis @ limits)
        hold = number("hold of a push", push.hold, "s", "> 0")
        ramp = min(abs(number("rate of a push", push.rate)) / limit, hold)
        moves.append((push.at, hold, ramp, np.sign(push.rate) * limit * axis))

    def reference(t: float) -> Wanted:
        position, velocity, acceleration = start.q[DRIVES].copy(), np.zeros(3), np.zeros(3)
        for at, hold, ramp, push in moves:
            for sign, since in ((1.0, t - at), (-1.0, t - at - hold)):
                if since > 0.0:
                    rising = min(since, ramp)
                    position += sign * push * rising * (since - rising / 2.0)
                    velocity += sign * push * rising
                    acceleration += sign * push * (since < ramp)
        return Wanted(position, velocity, acceleration)

    return reference
