"""A person at the joystick: velocity commands that the drives follow with limited acceleration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cranedyn.checks import number, within
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import Reference, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.references.tabulated import Tabulating

_TOUCH = 1e-9
"""By how much one push may begin before the last one ends and still follow it: what sums of times
round off [s]."""


class JoystickPulse(NamedTuple):
    """The joystick held for a while.

    Attributes:
        drive: Symbol of its coordinate, such as "x".
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
        start: Positions of the drives before all [rad or m], shape (m,).
        begins: When each acceleration sets in [s], shape (k,).
        lasts: How long it lasts [s], shape (k,).
        accelerations: Of the drives [rad/s² or m/s²], shape (k, m).
    """

    start: np.ndarray
    begins: np.ndarray
    lasts: np.ndarray
    accelerations: np.ndarray

    def at(self, times: np.ndarray) -> Setpoint:
        """Return setpoints at many times [s], shape (n, m) each."""
        since = np.maximum(times[:, None] - self.begins, 0.0)
        rising, accelerating = np.minimum(since, self.lasts), (since > 0.0) & (since < self.lasts)
        terms = np.array([rising * (since - rising / 2.0), rising, accelerating])
        displacement, velocity, acceleration = (terms[..., None] * self.accelerations).sum(axis=2)
        return Setpoint(self.start + displacement, velocity, acceleration)


def joystick(
    crane: Crane, start: State, pulses: Sequence[JoystickPulse], *, accelerations: Sequence[float]
) -> Reference:
    """Return the reference of drives that follow a joystick: it commands a velocity, which each
    drive approaches within its acceleration.

    A push by itself is a trapezoid in velocity, one that comes while the drive still slows down
    takes it on from there. No velocity is exceeded that was asked for, and no limit.

    Args:
        crane: The crane.
        start: Where the drives are.
        pulses: What the operator does; in any order, but a joystick has one position at a time:
            those of one drive must not overlap.
        accelerations: Limits of the drives [rad/s² or m/s²], shape (m,).

    Raises:
        OutOfRange: If a limit or a hold is not positive, a number is not finite, a rate is more
            than the drive has, or two pulses of one drive overlap.
        UnknownName: If there is no such drive.
    """
    start = crane.layout.as_state("start", start)
    limits = crane.layout.for_drives("acceleration limit", accelerations, "/s²", "> 0")
    ramps: list[tuple[float, float, np.ndarray]] = []
    for drive in dict.fromkeys(pulse.drive for pulse in pulses):
        axis = crane.layout.along(drive)
        limit, fastest = float(axis @ limits), float(crane.rate_limit[axis > 0.0][0])
        mine = [_checked(pulse, fastest) for pulse in pulses if pulse.drive == drive]
        ramps += [
            (begin, lasts, math.copysign(limit, lasts) * axis)
            for begin, lasts in _ramps(mine, limit)
        ]
    begins, lasts, signed = (np.array([ramp[i] for ramp in ramps], dtype=float) for i in range(3))
    signed = signed.reshape(-1, crane.layout.m)
    return Operator(start.q[crane.layout.drives], begins, np.abs(lasts), signed)


def _ramps(pulses: Sequence[JoystickPulse], limit: float) -> list[tuple[float, float]]:
    """Return when a drive accelerates at its limit and for how long [s], negative where it
    accelerates the other way.
    """
    mine = sorted(pulses, key=lambda pulse: pulse.at)
    ramps, speed = [], 0.0  # the speed counted in seconds of acceleration
    for pulse, following in zip(mine, [*(pulse.at for pulse in mine[1:]), math.inf], strict=True):
        end = pulse.at + pulse.hold
        if following < end - _TOUCH:
            allowed = f"{end:g} or later, when the one before it ends"
            raise OutOfRange(f"start of a push of {pulse.drive}", following, allowed, "s")
        held, let_go = (pulse.at, pulse.hold, pulse.rate / limit), (end, following - end, 0.0)
        for begin, until, target in (held, let_go):
            lasts = math.copysign(min(abs(target - speed), max(until, 0.0)), target - speed)
            ramps.append((begin, lasts))
            speed += lasts
    return ramps


def _checked(pulse: JoystickPulse, fastest: float) -> JoystickPulse:
    rate = number(f"rate of a push of {pulse.drive}", pulse.rate)
    within(f"rate of a push of {pulse.drive}", rate, -fastest, fastest, "rad/s or m/s")
    begin = number("start of a push", pulse.at, "s")
    return JoystickPulse(pulse.drive, rate, begin, number("hold of a push", pulse.hold, "s", "> 0"))
