"""A person at the joystick: velocity commands that the drives follow with limited acceleration."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cranedyn.checks import number, within
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import Reference, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.references.limits import Limits
from cranedyn.references.tabulated import Tabulating

_ROUNDING = 1e-9
"""Time by which a pulse may begin before the last one ends and still follow it [s]: the rounding
error of sums of times."""


_MIN_DISTANCE = 1e-6
"""Distance up to which a drive does not move [rad or m]."""


class JoystickPulse(NamedTuple):
    """The joystick held for a while.

    Attributes:
        drive: Symbol of its coordinate, such as "x".
        rate: Velocity asked for, with sign [rad/s or m/s].
        at: Time at which it begins [s].
        hold: Time for which it lasts [s].
    """

    drive: str
    rate: float
    at: float
    hold: float


@dataclass(frozen=True, eq=False)
class AccelerationSteps(Tabulating):
    """A reference of drives that accelerate at a constant rate for a while, again and again.

    Attributes:
        start: Positions of the drives before the first step [rad or m], shape (m,).
        begins: Times at which the k steps begin [s], shape (k,).
        lasts: How long they last [s], shape (k,).
        accelerations: Accelerations of the drives in each step [rad/s² or m/s²], shape (k, m).
    """

    start: np.ndarray
    begins: np.ndarray
    lasts: np.ndarray
    accelerations: np.ndarray

    def at(self, times: np.ndarray) -> Setpoint:
        """Return setpoints at many times [s], shape (n, m) each."""
        # At a time s after it begins, an acceleration a that lasts τ has acted for r = min(s, τ).
        # It has added a r to the velocity and a (r²/2 + r (s - r)) = a r (s - r/2) to the position.
        since = np.maximum(times[:, None] - self.begins, 0.0)
        acted = np.minimum(since, self.lasts)
        accelerating = (since > 0.0) & (since < self.lasts)
        shares = np.array([acted * (since - acted / 2.0), acted, accelerating])
        displacement, velocity, acceleration = (shares[..., None] * self.accelerations).sum(axis=2)
        return Setpoint(self.start + displacement, velocity, acceleration)


def joystick(
    crane: Crane, start: State, pulses: Sequence[JoystickPulse], *, accelerations: Sequence[float]
) -> Reference:
    """Return the reference of drives that follow a joystick: it commands a velocity, which each
    drive approaches within its acceleration.

    A pulse by itself is a trapezoid in velocity. One that comes while the drive still slows down
    accelerates it from the velocity that is left. The drive never exceeds the velocities that are
    asked for, or a limit.

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
    begins: list[float] = []
    lasts: list[float] = []
    signed: list[np.ndarray] = []
    for drive in dict.fromkeys(pulse.drive for pulse in pulses):
        axis = crane.layout.along(drive)
        limit = float(axis @ limits)
        largest_rate = float(crane.rate_limit[axis > 0.0][0])
        of_drive = [_checked(pulse, largest_rate) for pulse in pulses if pulse.drive == drive]
        for ramp in _ramps(of_drive, limit):
            begins.append(ramp.begin)
            lasts.append(abs(ramp.speed_change))
            signed.append(math.copysign(limit, ramp.speed_change) * axis)
    return AccelerationSteps(
        start.q[crane.layout.drives],
        np.array(begins, dtype=float),
        np.array(lasts, dtype=float),
        np.array(signed, dtype=float).reshape(-1, crane.layout.m),
    )


class _Ramp(NamedTuple):
    """A time in which a drive accelerates at its limit.

    Attributes:
        begin: When it begins [s].
        speed_change: Change of the velocity over the limit of the acceleration [s], negative where
            the drive accelerates backwards. Its magnitude is the length of the ramp.
    """

    begin: float
    speed_change: float


def _ramps(pulses: Sequence[JoystickPulse], limit: float) -> list[_Ramp]:
    """Return the ramps of a drive with a limit of its acceleration [rad/s² or m/s²].

    Raises:
        OutOfRange: If two pulses overlap.
    """
    in_order = sorted(pulses, key=lambda pulse: pulse.at)
    next_begins = [*(pulse.at for pulse in in_order[1:]), math.inf]
    ramps: list[_Ramp] = []
    speed = 0.0  # over the limit of the acceleration, so that it is a time [s]

    def approach(target: float, begin: float, available: float) -> float:
        """Add the ramp towards a speed in the time that there is; return the speed reached."""
        lasts = min(abs(target - speed), max(available, 0.0))
        change = math.copysign(lasts, target - speed)
        ramps.append(_Ramp(begin, change))
        return speed + change

    for pulse, next_begin in zip(in_order, next_begins, strict=True):
        end = pulse.at + pulse.hold
        if next_begin < end - _ROUNDING:
            allowed = f"{end:g} or later, when the one before it ends"
            raise OutOfRange(f"start of a pulse of {pulse.drive}", next_begin, allowed, "s")
        speed = approach(pulse.rate / limit, pulse.at, pulse.hold)
        # Let go, the drive slows down until the next pulse begins.
        speed = approach(0.0, end, next_begin - end)
    return ramps


def _checked(pulse: JoystickPulse, largest_rate: float) -> JoystickPulse:
    """Return a pulse whose numbers are checked, of a drive with a largest rate."""
    rate = number(f"rate of a pulse of {pulse.drive}", pulse.rate)
    within(f"rate of a pulse of {pulse.drive}", rate, -largest_rate, largest_rate, "rad/s or m/s")
    begin = number("start of a pulse", pulse.at, "s")
    hold = number("hold of a pulse", pulse.hold, "s", "> 0")
    return JoystickPulse(pulse.drive, rate, begin, hold)


class TimedReference(NamedTuple):
    """A motion of the drives that ends.

    Attributes:
        reference: Motion of the drives.
        end: Time at which it ends [s].
    """

    reference: Reference
    end: float


def joystick_path(
    crane: Crane, start: State, corners: Sequence[Sequence[float]], limits: Limits
) -> TimedReference:
    """Return the motion of an operator who knows the way from corner to corner.

    At each corner every drive begins at full rate, and brakes in time to rest at the next one. All
    drives wait there for the last.

    Args:
        crane: The crane.
        start: State at the start.
        corners: Positions of the drives at the corners [rad or m]; the first is the start.
        limits: Limits of the drives.
    """
    pulses = []
    end = 0.0
    for corner, next_corner in itertools.pairwise(corners):
        leg_duration = 0.0
        for i, joint in enumerate(crane.layout.driven):
            begin = corner[i]
            finish = next_corner[i]
            rate = limits.rates[i]
            acceleration = limits.accelerations[i]
            distance = abs(finish - begin)
            if distance > _MIN_DISTANCE:
                # A short way ends before the full rate is reached, at v = √(d a).
                speed = min(rate, math.sqrt(distance * acceleration))
                signed_speed = math.copysign(speed, finish - begin)
                pulses.append(JoystickPulse(joint.symbol, signed_speed, end, distance / speed))
                leg_duration = max(leg_duration, distance / speed + speed / acceleration)
        end += leg_duration
    return TimedReference(joystick(crane, start, pulses, accelerations=limits.accelerations), end)
