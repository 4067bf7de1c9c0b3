"""A person at the joystick: velocity commands that the drives follow with limited acceleration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cranedyn.arguments import checked, of_drives
from cranedyn.crane import DRIVES, State
from cranedyn.errors import number
from cranedyn.references.wanted import Reference, Tabulating, Wanted, along


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


@dataclass(frozen=True, eq=False)
class Operator(Tabulating):
    """Drives whose accelerations are on for a while, again and again.

    Attributes:
        start: Slew [rad], trolley radius [m], cable length [m] before all, shape (3,).
        begins: When each acceleration sets in [s], shape (m,).
        lasts: How long it lasts [s], shape (m,).
        accelerations: Of slew [rad/s²], trolley [m/s²], hoist [m/s²], shape (m, 3).
    """

    start: np.ndarray
    begins: np.ndarray
    lasts: np.ndarray
    accelerations: np.ndarray

    def at(self, times: np.ndarray) -> Wanted:
        """What is wanted at many times [s], shape (n, 3) each."""
        since = np.maximum(times[:, None] - self.begins, 0.0)
        rising, on = np.minimum(since, self.lasts), (since > 0.0) & (since < self.lasts)
        parts = np.array([rising * (since - rising / 2.0), rising, on])
        gone, velocity, acceleration = (parts[..., None] * self.accelerations).sum(axis=2)
        return Wanted(self.start + gone, velocity, acceleration)


@checked
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
    limits = of_drives("acceleration limit", accelerations, "/s²", "> 0")
    ramps: list[tuple[float, float, np.ndarray]] = []
    for push in pushes:
        axis = along(push.drive)
        limit = float(axis @ limits)
        at, hold = number("start of a push", push.at, "s"), number("hold of a push", push.hold, "s", "> 0")
        lasts = min(abs(number("rate of a push", push.rate)) / limit, hold)
        acceleration = math.copysign(limit, push.rate) * axis
        ramps += [(at, lasts, acceleration), (at + hold, lasts, -acceleration)]
    columns = [np.array([ramp[i] for ramp in ramps], dtype=float) for i in range(3)]
    return Operator(start.q[DRIVES], columns[0], columns[1], columns[2].reshape(-1, 3))
