"""Frequency converters: drives that follow commanded rates.

A command is cut to the largest rate, rounded to the resolution of the bus, and delayed. A ramp
generator leads a reference rate r to it, within an acceleration and a jerk. The speed control makes
the drive follow r as a first-order lag, T v̇ = r - v, so that the acceleration of the drive keeps
the limits of the ramp. The effort is limited; where it does not suffice the drive stalls, and the
reference waits within T times the acceleration of the rate of the drive.

Written once for any kind of number, as `cranedyn.dynamics.joint_forces` is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from cranedyn.checks import finite, number, within
from cranedyn.dynamics.scalars import (
    array,
    chosen,
    clipped,
    flag,
    magnitude,
    rounded,
    solve_linear,
    square_root,
)
from cranedyn.errors import OutOfRange, UnknownName
from cranedyn.model.crane import Crane

RATES = {"slew": 0.0838, "trolley": 1.583, "hoist": 1.0}
"""Largest rates by role: 0.8 rpm of slewing, 95 m/min of the trolley and 60 m/min of hoisting, of a
large tower crane; for other drives, and where a crane has less, the velocity limit of its joint."""

DEFAULT_RATES = {"revolute": 0.1, "prismatic": 1.0}
"""Largest rates by kind of joint [rad/s or m/s] of drives that are in none of these roles and have
no velocity limit, as in MJCF, which has none; ours, of the size of `RATES`."""

HEADROOM = 1.1
"""Largest rate over that by role: a converter goes a tenth beyond it, into field weakening, to make
up for its lag."""

RAMP_TIMES = {"slew": 3.0, "trolley": 2.5, "hoist": 1.5}
"""Time from rest to the rate of `RATES` [s]; ours, within the 1 to 5 s that converters of cranes
are set to."""

LAGS = {"slew": 0.2, "trolley": 0.1, "hoist": 0.1}
"""Time constants of the speed control [s]; ours: soft for the slew, whose tower twists."""

RAMP_TIME = 2.5
"""Time from rest to the rate of a drive in none of these roles [s]."""

LAG = 0.1
"""Time constant of the speed control of such a drive [s]."""

ROUNDING = 0.2
"""Time in which the ramp reaches its acceleration [s], the rounding of an S-curve; ours."""

STEPS = 16384
"""Steps of a command up to the largest rate: 4000 hex are 100 % in PROFIdrive's 16-bit words."""

DELAY = 0.02
"""Delay from a command to the response [s]: a cycle of the bus and one of the converter; ours."""

_LARGEST_DELAY = 64
"""Control periods of the longest delay."""


class Response(NamedTuple):
    """Response of m drives to commanded rates, in any kind of number.

    Attributes:
        rates: Largest rates [rad/s or m/s], shape (m,).
        accelerations: Largest accelerations of the ramp [rad/s² or m/s²], shape (m,).
        jerks: Largest jerks of the ramp [rad/s³ or m/s³], shape (m,).
        lags: Time constants of the speed control [s], shape (m,).
        resolutions: Resolutions of the commands [rad/s or m/s], shape (m,); 0 for none.
    """

    rates: Any
    accelerations: Any
    jerks: Any
    lags: Any
    resolutions: Any

    def heard(self, command: Any) -> list[Any]:
        """Return commands cut to the largest rates and rounded to the resolution, m numbers."""
        rates = []
        for w, rate_limit, step in zip(command, self.rates, self.resolutions, strict=True):
            cut = clipped(w, -rate_limit, rate_limit)
            if isinstance(step, float) and step == 0.0:
                rates.append(cut)
                continue
            near = rounded(cut * (1.0 / chosen(step > 0.0, step, 1.0))) * step
            rates.append(near if isinstance(step, float) else chosen(step > 0.0, near, cut))
        return rates

    def cuts(self, command: Any) -> list[Any]:
        """Return for each drive whether its command is beyond its largest rate."""
        pairs = zip(command, self.rates, strict=True)
        return [magnitude(w) > rate_limit * (1.0 + 1e-9) for w, rate_limit in pairs]

    def ramped(
        self, heard: Any, reference: Any, slope: Any, rate: Any, dt: Any
    ) -> tuple[list[Any], list[Any]]:
        """Return reference rates after a step and their slopes, m numbers each.

        The slope towards the command is the largest that the jerk can still bring to zero in steps
        as long as this one: with a slope of n J dt in the n-th step before the end, the reference
        still has n (n + 1) J dt²/2 to go. Where n is no whole number the last step overshoots by
        J dt²/8 at most.

        Args:
            heard: Commanded rates.
            reference: Reference rates before the step.
            slope: Slopes before the step.
            rate: Rates of the drives.
            dt: Time step [s].
        """
        references, slopes = [], []
        for i, target in enumerate(heard):
            jump = self.jerks[i] * dt
            error = target - reference[i]
            distance = magnitude(error)
            curve = 0.5 * (square_root(jump * jump + 8.0 * self.jerks[i] * distance) - jump)
            slope_limit = clipped(clipped(curve, 0.0, distance / dt), 0.0, self.accelerations[i])
            target_slope = chosen(error < 0.0, -slope_limit, slope_limit)
            new_slope = clipped(target_slope, slope[i] - jump, slope[i] + jump)
            lead = self.accelerations[i] * self.lags[i]
            slopes.append(new_slope)
            references.append(
                clipped(reference[i] + dt * new_slope, rate[i] - lead, rate[i] + lead)
            )
        return references, slopes

    def accelerations_at(self, reference: Any, rate: Any) -> list[Any]:
        """Return the accelerations that the speed control asks for [rad/s² or m/s²], m numbers."""
        rows = zip(reference, rate, self.lags, strict=True)
        return [(r - v) / lag for r, v, lag in rows]


def within_efforts(
    inertia: np.ndarray, resisting: np.ndarray, target: np.ndarray, limits: Any
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return accelerations of m drives of limited effort.

    A drive that would need more than its limit exerts its limit and accelerates accordingly. The
    others accelerate as wanted, unless the yielding of that drive takes them beyond their limits.

    Args:
        inertia: Inertia of the drives with the passive joints free, shape (m, m).
        resisting: Efforts without acceleration [N m or N], shape (m,).
        target: Wanted accelerations, shape (m,).
        limits: Largest efforts, m numbers.

    Returns:
        Accelerations, efforts, and the efforts that the wanted accelerations need, shape (m,) each.
    """
    m = len(target)
    needed = inertia @ target + resisting
    effort = list(needed)
    saturated = [0.0] * m
    goal = list(needed)
    gained: Any = target
    for _ in range(m):
        for i, limit in enumerate(limits):
            over = flag(magnitude(effort[i]) > limit, effort[i])
            goal[i] = chosen(over > 0.5, clipped(effort[i], -limit, limit), goal[i])
            saturated[i] = saturated[i] + over - saturated[i] * over
        matrix = np.array(
            [[saturated[i] * inertia[i, j] * saturated[j] for j in range(m)] for i in range(m)]
        )
        right = np.array([saturated[i] * (goal[i] - needed[i]) for i in range(m)])
        for i in range(m):
            matrix[i, i] = matrix[i, i] + (1.0 - saturated[i])
        correction = solve_linear(matrix, right)
        gained = target + correction
        effort = list(needed + inertia @ correction)
    cut = [
        chosen(saturated[i] > 0.5, goal[i], clipped(effort[i], -limit, limit))
        for i, limit in enumerate(limits)
    ]
    return gained, array(cut) if target.dtype == object else np.array(cut), needed


def saturate_acceleration(
    mass: np.ndarray,
    resisting: np.ndarray,
    target: np.ndarray,
    limits: np.ndarray,
    drives: np.ndarray,
    passive: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return accelerations of all joints for drives of limited effort, in any kind of number.

    See `within_efforts`.

    Args:
        mass: Mass matrix, shape (n, n).
        resisting: Generalized forces without acceleration, shape (n,).
        target: Wanted accelerations of the drives, shape (m,).
        limits: Their largest efforts, shape (m,).
        drives: Indices of the drives.
        passive: Indices of the passive joints; the others stand still.

    Returns:
        Accelerations of all joints, shape (n,), efforts of the drives and the efforts that they
        would need, shape (m,) each.
    """
    inertia = mass[np.ix_(drives, drives)]
    resisting_drives = resisting[drives]
    a = np.array([0.0] * len(resisting), dtype=resisting.dtype)
    if not len(passive):
        a[drives], effort, needed = within_efforts(inertia, resisting_drives, target, limits)
        return a, effort, needed
    passive_mass, coupling = mass[np.ix_(passive, passive)], mass[np.ix_(passive, drives)]
    falling = solve_linear(passive_mass, resisting[passive])
    carried = np.array([solve_linear(passive_mass, coupling[:, i]) for i in range(len(drives))]).T
    free = resisting_drives - coupling.T @ falling
    a[drives], effort, needed = within_efforts(inertia - coupling.T @ carried, free, target, limits)
    a[passive] = -(falling + carried @ a[drives])
    return a, effort, needed


@dataclass(frozen=True, eq=False)
class Converters:
    """Frequency converters of a crane with m drives; `converters` returns typical ones.

    Attributes:
        rates: Largest rates [rad/s or m/s], shape (m,); commands beyond are cut to them.
        accelerations: Largest accelerations of the ramps [rad/s² or m/s²], shape (m,).
        jerks: Largest jerks of the ramps [rad/s³ or m/s³], shape (m,).
        lags: Time constants of the speed control [s], shape (m,); no less than the physics step.
        resolutions: Resolutions of commands [rad/s or m/s], shape (m,); 0 for no rounding.
        delay: Delay from a command to the response [s], rounded up to control periods; 64 control
            periods at most.
    """

    rates: np.ndarray
    accelerations: np.ndarray
    jerks: np.ndarray
    lags: np.ndarray
    resolutions: np.ndarray
    delay: float = DELAY

    def __post_init__(self) -> None:
        m = np.size(self.rates)
        for field in fields(self)[:-1]:
            name = f"{field.name} of converters"
            values = getattr(self, field.name)
            column = finite(name, values, (m,)).astype(float)
            allowed = ">= 0" if field.name == "resolutions" else "> 0"
            for value in column.tolist():
                number(name, value, "", allowed)
            column.flags.writeable = False
            object.__setattr__(self, field.name, column)
        number("delay of converters", self.delay, "s", ">= 0")

    @property
    def response(self) -> Response:
        """Numbers of the converters."""
        return Response(self.rates, self.accelerations, self.jerks, self.lags, self.resolutions)

    def delay_steps(self, dt: float, control_period: float) -> int:
        """Return the delay in control periods.

        Raises:
            OutOfRange: If there are more than 64, or a physics step [s] is longer than a lag.
        """
        within("shortest lag of the converters", float(self.lags.min()), dt, math.inf, "s")
        steps = math.ceil(self.delay / control_period - 1e-9)
        if steps > _LARGEST_DELAY:
            longest = _LARGEST_DELAY * control_period
            raise OutOfRange(
                "delay of converters", self.delay, f"{longest:g} or less: 64 control periods", "s"
            )
        return steps

    def ahead(self, control_period: float) -> float:
        """Return the time from a command to the middle of the period for which it holds [s].

        Raises:
            OutOfRange: As of `delay_steps`.
        """
        return (self.delay_steps(0.0, control_period) + 0.5) * control_period

    def of(self, crane: Crane) -> Converters:
        """Return the same if there is a converter for each drive of a crane.

        Raises:
            OutOfRange: If there is not.
        """
        if len(self.rates) != crane.layout.m:
            raise OutOfRange(
                "number of converters",
                len(self.rates),
                f"{crane.layout.m}: {', '.join(joint.symbol for joint in crane.layout.driven)}",
            )
        return self


def converters(crane: Crane, *, delay: float = DELAY, **values: Mapping[str, float]) -> Converters:
    """Return typical frequency converters for a crane.

    Their rates are those of `RATES` with `HEADROOM`, and never more than the velocity limits of the
    crane's joints. A drive that has neither gets one of `DEFAULT_RATES`, see `default_rates`. They
    ramp up to `RATES` in `RAMP_TIMES`, and reach this acceleration in
    `ROUNDING`.

    Args:
        crane: The crane.
        delay: See `Converters`.
        values: Numbers of some drives by symbol, for attributes of `Converters` by name; for
            example ``lags={"x": 0.2}``.

    Raises:
        OutOfRange: If a number is not allowed.
        UnknownName: If there is no such attribute or drive.
    """
    layout = crane.layout
    columns: dict[str, list[float]] = {field.name: [] for field in fields(Converters)[:-1]}
    for joint, limit in zip(layout.driven, crane.rate_limit.tolist(), strict=True):
        usual = min(RATES.get(joint.role, math.inf), limit)
        if not math.isfinite(usual):
            usual = DEFAULT_RATES[joint.kind]
        acceleration = usual / RAMP_TIMES.get(joint.role, RAMP_TIME)
        rate = min(HEADROOM * usual, limit)
        columns["rates"].append(rate)
        columns["accelerations"].append(acceleration)
        columns["jerks"].append(acceleration / ROUNDING)
        columns["lags"].append(LAGS.get(joint.role, LAG))
        columns["resolutions"].append(rate / STEPS)
    for name, of_drives in values.items():
        if name not in columns:
            raise UnknownName("number of converters", name, [*columns, "delay"])
        for symbol, value in of_drives.items():
            columns[name][layout.drive(symbol)] = number(f"{name} of {symbol}", value)
    numbers = {name: np.array(column) for name, column in columns.items()}
    return Converters(**numbers, delay=delay)


def default_rates(crane: Crane) -> list[str]:
    """Return a sentence for each drive whose converter has one of `DEFAULT_RATES`, for whoever
    shows what a crane with converters does.
    """
    return [
        f"{joint.name} has no velocity limit; its converter is taken to reach the default rate of "
        f"{DEFAULT_RATES[joint.kind]:g} {joint.unit}/s. A URDF says another as velocity of "
        "<limit>, Python as converters(crane, rates=...)."
        for joint, limit in zip(crane.layout.driven, crane.rate_limit.tolist(), strict=True)
        if joint.role not in RATES and not math.isfinite(limit)
    ]


def fitting(crane: Crane, drive: str, explicit: Converters | None) -> Converters | None:
    """Return the frequency converters of a run, typical ones where none are given to drives that
    take velocities.

    Raises:
        OutOfRange: If some are given to drives that have none, or not one for each drive.
    """
    if drive == "velocity":
        return converters(crane) if explicit is None else explicit.of(crane)
    if explicit is not None:
        raise OutOfRange("converters", "given", f"None where drive = {drive}")
    return None
