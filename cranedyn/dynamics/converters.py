"""Frequency converters: drives that are told a velocity and get there as fast as they can.

A command is cut to the largest rate, rounded to the resolution of the bus, and heard late. A ramp
generator leads a reference rate r to it, within an acceleration and a jerk; the speed control makes
the drive follow r as a first-order lag, T v̇ = r - v. Averaged by the lag, the acceleration of the
drive keeps the limits of the ramp. Whatever effort this needs is there up to the effort limit of
the drive; where it is not enough the drive stalls, and its reference waits within T times the
acceleration of its rate.

Written once for any kind of number, as `cranedyn.dynamics.joint_forces` is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from cranedyn.checks import finite, number, within
from cranedyn.dynamics import rigid_body
from cranedyn.dynamics.rigid_body import array
from cranedyn.dynamics.scalars import chosen, clipped, flag, magnitude, root, rounded
from cranedyn.errors import OutOfRange, UnknownName
from cranedyn.model.crane import Crane
from cranedyn.model.layout import Layout

RATES = {"slew": 0.0838, "trolley": 1.583, "hoist": 1.0}
"""Largest rates by role: 0.8 rpm of slewing, 95 m/min of the trolley and 60 m/min of hoisting, of a
large tower crane; for other drives, and where a crane has less, the velocity limit of its joint."""

HEADROOM = 1.1
"""Largest rate over that by role: a converter goes a tenth beyond it, into the range of weaker
field, to make up for what it lags."""

RAMP_TIMES = {"slew": 3.0, "trolley": 2.5, "hoist": 1.5}
"""Time from rest to the rate of `RATES` [s]; ours, within the 1 to 5 s that converters of cranes
are set to."""

LAGS = {"slew": 0.2, "trolley": 0.1, "hoist": 0.1}
"""Time constants of the speed control [s]; ours: soft for the slew, whose tower twists."""

RAMP_TIME, LAG = 2.5, 0.1
"""The same of drives in none of these roles [s]."""

ROUNDING = 0.2
"""Time in which the ramp gains its acceleration [s], the rounding of an S-curve; ours."""

STEPS = 16384
"""Steps of a command up to the largest rate: 4000 hex are 100 % in PROFIdrive's 16-bit words."""

DELAY = 0.02
"""From a command to the converter's answer [s]: a cycle of the bus and one of the converter;
ours."""

_MOST_LATE = 64


class Response(NamedTuple):
    """How m drives respond to commanded rates, in any kind of number.

    Attributes:
        rates: Largest [rad/s or m/s], shape (m,).
        accelerations: Largest of the ramp [per s²], shape (m,).
        jerks: Largest of the ramp [per s³], shape (m,).
        lags: Time constants of the speed control [s], shape (m,).
        resolutions: Steps of the commands [rad/s or m/s], shape (m,); 0 for none.
    """

    rates: Any
    accelerations: Any
    jerks: Any
    lags: Any
    resolutions: Any

    def heard(self, command: Any) -> list[Any]:
        """Commands cut to the largest rates and rounded to the resolution, m numbers."""
        found = []
        for w, most, step in zip(command, self.rates, self.resolutions, strict=True):
            cut = clipped(w, -most, most)
            if isinstance(step, float) and step == 0.0:
                found.append(cut)
                continue
            near = rounded(cut * (1.0 / chosen(step > 0.0, step, 1.0))) * step
            found.append(near if isinstance(step, float) else chosen(step > 0.0, near, cut))
        return found

    def cuts(self, command: Any) -> list[Any]:
        """For each drive, whether its command is beyond its largest rate."""
        pairs = zip(command, self.rates, strict=True)
        return [magnitude(w) > most * (1.0 + 1e-9) for w, most in pairs]

    def ramped(
        self, heard: Any, reference: Any, rising: Any, rate: Any, dt: Any
    ) -> tuple[list[Any], list[Any]]:
        """The reference rates after a step, and how fast they change, m numbers each.

        The deceleration towards the command is that from which it can be given up at the jerk in
        steps as long as this one: with n J dt in the n-th step before the end n (n + 1) J dt²/2 are
        left. Where n is no whole number the last step overshoots by J dt²/8 at most.

        Args:
            heard: Commanded rates.
            reference: Reference rates before.
            rising: How fast they change.
            rate: Rates of the drives.
            dt: The step [s].
        """
        references, rises = [], []
        for i, asked in enumerate(heard):
            jump = self.jerks[i] * dt
            away = asked - reference[i]
            distance = magnitude(away)
            curve = 0.5 * (root(jump * jump + 8.0 * self.jerks[i] * distance) - jump)
            most = clipped(clipped(curve, 0.0, distance / dt), 0.0, self.accelerations[i])
            wanted = chosen(away < 0.0, -most, most)
            rise = clipped(wanted, rising[i] - jump, rising[i] + jump)
            room = self.accelerations[i] * self.lags[i]
            rises.append(rise)
            references.append(clipped(reference[i] + dt * rise, rate[i] - room, rate[i] + room))
        return references, rises

    def accelerations_at(self, reference: Any, rate: Any) -> list[Any]:
        """What the speed control asks of each drive [rad/s² or m/s²], m numbers."""
        rows = zip(reference, rate, self.lags, strict=True)
        return [(r - v) / lag for r, v, lag in rows]


def within_efforts(
    inertia: np.ndarray, resisting: np.ndarray, wanted: np.ndarray, limits: Any
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Accelerations of m drives where none exerts more than it can.

    A drive that would need more exerts its limit and accelerates as that makes it; the others do
    as they want, unless that drive's yielding asks too much of them.

    Args:
        inertia: What the drives feel with the passive joints free, shape (m, m).
        resisting: Efforts that hold them without acceleration [N m or N], shape (m,).
        wanted: Accelerations, shape (m,).
        limits: Largest efforts, m numbers.

    Returns:
        Accelerations, efforts, and efforts that the wanted accelerations would need, shape (m,)
        each.
    """
    m = len(wanted)
    needed = inertia @ wanted + resisting
    effort, held, goal = list(needed), [0.0] * m, list(needed)
    gained: Any = wanted
    for _ in range(m):
        for i, limit in enumerate(limits):
            over = flag(magnitude(effort[i]) > limit, effort[i])
            goal[i] = chosen(over > 0.5, clipped(effort[i], -limit, limit), goal[i])
            held[i] = held[i] + over - held[i] * over
        matrix = np.array([[held[i] * inertia[i, j] * held[j] for j in range(m)] for i in range(m)])
        right = np.array([held[i] * (goal[i] - needed[i]) for i in range(m)])
        for i in range(m):
            matrix[i, i] = matrix[i, i] + (1.0 - held[i])
        more = rigid_body.solve(matrix, right)
        gained, effort = wanted + more, list(needed + inertia @ more)
    cut = [
        chosen(held[i] > 0.5, goal[i], clipped(effort[i], -limit, limit))
        for i, limit in enumerate(limits)
    ]
    return gained, _like(wanted, cut), needed


def _like(other: np.ndarray, values: list[Any]) -> np.ndarray:
    return array(values) if other.dtype == object else np.array(values)


def held_back(
    mass: np.ndarray, resisting: np.ndarray, wanted: np.ndarray, limits: np.ndarray, layout: Layout
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What drives do that want to accelerate but exert no more than they can, in any kind of
    number, see `within_efforts`.

    Args:
        mass: Mass matrix, shape (n, n).
        resisting: Generalized forces at no acceleration, shape (n,).
        wanted: Accelerations of the drives, shape (m,).
        limits: Their largest efforts, shape (m,).
        layout: The joints.

    Returns:
        Accelerations of all joints, shape (n,), efforts of the drives and those that they would
        need, shape (m,) each.
    """
    drives, passive = layout.drives, layout.passive
    inertia, held = mass[np.ix_(drives, drives)], resisting[drives]
    a = np.zeros_like(resisting) if resisting.dtype != object else array([0.0] * len(resisting))
    if not len(passive):
        a[drives], effort, needed = within_efforts(inertia, held, wanted, limits)
        return a, effort, needed
    own, coupling = mass[np.ix_(passive, passive)], mass[np.ix_(passive, drives)]
    falling = rigid_body.solve(own, resisting[passive])
    carried = np.array([rigid_body.solve(own, coupling[:, i]) for i in range(len(drives))]).T
    free = held - coupling.T @ falling
    a[drives], effort, needed = within_efforts(inertia - coupling.T @ carried, free, wanted, limits)
    a[passive] = -(falling + carried @ a[drives])
    return a, effort, needed


@dataclass(frozen=True, eq=False)
class Converters:
    """The frequency converters of a crane with m drives; `converters` makes typical ones.

    Attributes:
        rates: Largest rates [rad/s or m/s], shape (m,); commands beyond are cut to them.
        accelerations: Largest of the ramps [rad/s² or m/s²], shape (m,).
        jerks: Largest of the ramps [rad/s³ or m/s³], shape (m,).
        lags: Time constants of the speed control [s], shape (m,); no less than the physics step.
        resolutions: To which commands are rounded [rad/s or m/s], shape (m,); 0 for no rounding.
        delay: From a command to the answer [s]: it is heard at the first control instant that is so
            much later, 64 control periods at most.
    """

    rates: np.ndarray
    accelerations: np.ndarray
    jerks: np.ndarray
    lags: np.ndarray
    resolutions: np.ndarray
    delay: float = DELAY

    def __post_init__(self) -> None:
        """Check the numbers."""
        m = np.size(self.rates)
        for part in fields(self)[:-1]:
            name, values = f"{part.name} of converters", getattr(self, part.name)
            found = finite(name, values, (m,)).astype(float)
            allowed = ">= 0" if part.name == "resolutions" else "> 0"
            for value in found.tolist():
                number(name, value, "", allowed)
            found.flags.writeable = False
            object.__setattr__(self, part.name, found)
        number("delay of converters", self.delay, "s", ">= 0")

    @property
    def response(self) -> Response:
        """Their numbers."""
        return Response(self.rates, self.accelerations, self.jerks, self.lags, self.resolutions)

    def late(self, dt: float, control_period: float) -> int:
        """By how many control periods [s] commands are late.

        Raises:
            OutOfRange: If there are more than 64, or a physics step [s] is longer than a lag.
        """
        within("shortest lag of the converters", float(self.lags.min()), dt, math.inf, "s")
        late = math.ceil(self.delay / control_period - 1e-9)
        if late > _MOST_LATE:
            most = _MOST_LATE * control_period
            raise OutOfRange(
                "delay of converters", self.delay, f"{most:g} or less: 64 control periods", "s"
            )
        return late

    def ahead(self, control_period: float) -> float:
        """From a command to the middle of the time for which it holds [s].

        Raises:
            OutOfRange: As `late`.
        """
        return (self.late(0.0, control_period) + 0.5) * control_period

    def of(self, crane: Crane) -> Converters:
        """The same, if there is one for each drive of a crane.

        Raises:
            OutOfRange: If not.
        """
        if len(self.rates) != crane.layout.m:
            raise OutOfRange(
                "number of converters",
                len(self.rates),
                f"{crane.layout.m}: {', '.join(joint.symbol for joint in crane.layout.driven)}",
            )
        return self


def converters(crane: Crane, *, delay: float = DELAY, **values: Mapping[str, float]) -> Converters:
    """Typical frequency converters for a crane.

    Their rates are those of `RATES` with `HEADROOM`, and never more than the velocity limits of
    the crane's joints; they ramp up to `RATES` in `RAMP_TIMES`, and gain this acceleration in
    `ROUNDING`.

    Args:
        crane: The crane.
        delay: See `Converters`.
        values: Other numbers of some drives by their symbols, by the name of an attribute of
            `Converters`; for example ``lags={"x": 0.2}``.

    Raises:
        OutOfRange: If a number is not allowed, or a joint has no velocity limit above 0 and plays
            no role in `RATES`.
        UnknownName: If there is no such attribute or drive.
    """
    layout = crane.layout
    parts: dict[str, list[float]] = {part.name: [] for part in fields(Converters)[:-1]}
    for joint, limit in zip(layout.driven, crane.rate_limit.tolist(), strict=True):
        usual = min(RATES.get(joint.role, math.inf), limit)
        number(f"velocity limit of {joint.name}", usual, f"{joint.unit}/s", "> 0")
        acceleration = usual / RAMP_TIMES.get(joint.role, RAMP_TIME)
        most = min(HEADROOM * usual, limit)
        parts["rates"].append(most)
        parts["accelerations"].append(acceleration)
        parts["jerks"].append(acceleration / ROUNDING)
        parts["lags"].append(LAGS.get(joint.role, LAG))
        parts["resolutions"].append(most / STEPS)
    for name, of_drives in values.items():
        if name not in parts:
            raise UnknownName("number of converters", name, [*parts, "delay"])
        for symbol, value in of_drives.items():
            parts[name][layout.drive(symbol)] = number(f"{name} of {symbol}", value)
    made = Response(*(np.array(part) for part in parts.values()))
    return Converters(*made, delay)


def fitting(crane: Crane, drive: str, given: Converters | None) -> Converters | None:
    """The frequency converters of a run; typical ones where none are given to drives that take
    velocities.

    Raises:
        OutOfRange: If some are given to drives that have none, or not one for each drive.
    """
    if drive == "velocity":
        return converters(crane) if given is None else given.of(crane)
    if given is not None:
        raise OutOfRange("converters", "given", f"None where drive = {drive}")
    return None
