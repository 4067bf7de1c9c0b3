"""Frequency converters: drives that follow commanded rates.

A command is clipped to the largest rate, rounded to the resolution of the bus, and delayed. A ramp
generator leads a reference rate r to it, within an acceleration and a jerk. The speed control makes
the drive follow r as a first-order lag, T v̇ = r - v, so that the acceleration of the drive keeps
the limits of the ramp. The effort is limited. Where it does not suffice the drive stalls; then the
reference r stays within T A of the rate v of the drive, with the largest acceleration A.

The functions work on any kind of number, see `cranedyn.dynamics.scalars`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from cranedyn.checks import finite, number, within
from cranedyn.dynamics.scalars import (
    array,
    clipped,
    indicator,
    magnitude,
    rounded,
    solve_linear,
    square_root,
    where,
)
from cranedyn.errors import OutOfRange, UnknownName
from cranedyn.model.crane import Crane

RATES = {"slew": 0.0838, "trolley": 1.583, "hoist": 1.0}
"""Largest rates by role [rad/s or m/s], of a large tower crane: 0.8 rpm of slewing, 95 m/min of the
trolley and 60 m/min of hoisting.

Other drives, and those of a crane that allows less, have the velocity limit of their joint.
"""

DEFAULT_RATES = {"revolute": 0.1, "prismatic": 1.0}
"""Largest rates by kind of joint [rad/s or m/s] of drives that are in none of these roles and have
no velocity limit, such as those of an MJCF, which knows none.

Own choice, in the order of magnitude of `RATES`.
"""

HEADROOM = 1.1
"""Largest rate over that of `RATES`: a converter goes a tenth beyond it, into field weakening, to
make up for its lag.
"""

RAMP_TIMES = {"slew": 3.0, "trolley": 2.5, "hoist": 1.5}
"""Time from rest to the rate of `RATES` by role [s]. Own choice, within the 1 to 5 s to which
converters of cranes are set.
"""

LAGS = {"slew": 0.2, "trolley": 0.1, "hoist": 0.1}
"""Time constants of the speed control by role [s]. Own choice: long for the slew, whose tower
twists."""

RAMP_TIME = 2.5
"""Time from rest to the rate of a drive in none of these roles [s]."""

LAG = 0.1
"""Time constant of the speed control of such a drive [s]."""

ROUNDING = 0.2
"""Time in which the ramp reaches its acceleration [s], the rounding of an S-curve. Own choice."""

STEPS = 16384
"""Steps of a command up to the largest rate: 4000 hex are 100 % in PROFIdrive's 16-bit words."""

DELAY = 0.02
"""Delay from a command to the response [s]: a cycle of the bus and one of the
converter. Own choice."""

MAX_DELAY_STEPS = 64
"""Number of control periods of the longest delay."""

_ROUND_OFF = 1e-9
"""Relative round-off of a rate at its limit, and of a delay that is a number of control periods."""


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

    def quantize_commands(self, command: Any) -> list[Any]:
        """Return commands as the bus carries them to the converters: clipped to the largest rates
        and rounded to the resolution, m numbers.
        """
        rates = []
        for rate, limit, step in zip(command, self.rates, self.resolutions, strict=True):
            allowed = clipped(rate, -limit, limit)
            if isinstance(step, float) and step == 0.0:
                rates.append(allowed)
                continue
            # A resolution that is not known yet may turn out to be 0, which means no rounding. It
            # is replaced by 1 where it divides.
            divisor = where(step > 0.0, step, 1.0)
            quantized = rounded(allowed * (1.0 / divisor)) * step
            if not isinstance(step, float):
                quantized = where(step > 0.0, quantized, allowed)
            rates.append(quantized)
        return rates

    def saturates(self, command: Any) -> list[Any]:
        """Return for each drive whether its command is beyond its largest rate."""
        exceeds = []
        for rate, limit in zip(command, self.rates, strict=True):
            exceeds.append(magnitude(rate) > limit * (1.0 + _ROUND_OFF))
        return exceeds

    def ramped(
        self, commanded: Any, reference: Any, slope: Any, rate: Any, dt: Any
    ) -> tuple[list[Any], list[Any]]:
        """Return reference rates after a step and their slopes, m numbers each.

        The slope towards the command is the largest that the jerk J can still bring to zero in
        steps as long as this one. With a slope of n J dt in the n-th step before the end, the
        reference still has e = n (n + 1) J dt²/2 to go, so that the slope is

            n J dt = ½ (√((J dt)² + 8 J e) - J dt).

        Where n is no whole number the last step overshoots by J dt²/8 at most. The slope is also
        limited to e/dt, which reaches the command in this step, and to the largest acceleration A.

        The reference stays within T A of the rate of the drive, with the lag T: the speed control
        then asks for no more than A, also after the drive has stalled.

        Args:
            commanded: Commanded rates that have reached the converters.
            reference: Reference rates before the step.
            slope: Slopes before the step.
            rate: Rates of the drives.
            dt: Time step [s].
        """
        references = []
        slopes = []
        for i, target in enumerate(commanded):
            jump = self.jerks[i] * dt
            error = target - reference[i]
            distance = magnitude(error)
            stoppable = 0.5 * (square_root(jump * jump + 8.0 * self.jerks[i] * distance) - jump)
            slope_limit = clipped(stoppable, 0.0, distance / dt)
            slope_limit = clipped(slope_limit, 0.0, self.accelerations[i])
            target_slope = where(error < 0.0, -slope_limit, slope_limit)
            new_slope = clipped(target_slope, slope[i] - jump, slope[i] + jump)
            lead = self.accelerations[i] * self.lags[i]
            new_reference = reference[i] + dt * new_slope
            slopes.append(new_slope)
            references.append(clipped(new_reference, rate[i] - lead, rate[i] + lead))
        return references, slopes

    def accelerations_at(self, reference: Any, rate: Any) -> list[Any]:
        """Return the accelerations (r - v)/T that the speed control asks for [rad/s² or m/s²], m
        numbers.
        """
        accelerations = []
        for r, v, lag in zip(reference, rate, self.lags, strict=True):
            accelerations.append((r - v) / lag)
        return accelerations


class DrivenMotion(NamedTuple):
    """Motion of a crane whose drives follow commands, and the efforts that it takes.

    Attributes:
        acceleration: Accelerations, of the drives or of all joints [rad/s² or m/s²].
        effort: Efforts of the drives [N m or N], shape (m,).
        needed: Efforts that the drives would need to accelerate as wanted, shape (m,).
    """

    acceleration: np.ndarray
    effort: np.ndarray
    needed: np.ndarray


def within_efforts(
    inertia: np.ndarray, resisting: np.ndarray, target: np.ndarray, limits: Any
) -> DrivenMotion:
    """Return the accelerations and efforts of m drives of limited effort.

    A drive that would need more than its limit exerts its limit and accelerates accordingly. The
    others accelerate as wanted, unless the yielding of that drive takes them beyond their limits.

    With the inertia M, the wanted accelerations a take the efforts M a + resisting. Of the set S of
    drives that saturate, the accelerations change by x_S so that they exert their limits,

        M_SS x_S = limit_S - (M a + resisting)_S,

    and those of the others by x = 0. This changes the efforts of the others, too, so that more of
    them may saturate: the next pass adds these to S. S only grows, so that after m passes nothing
    changes any more. All m passes are always made, since compiled code does not know S.

    Args:
        inertia: Inertia of the drives with the passive joints free, shape (m, m).
        resisting: Efforts without acceleration [N m or N], shape (m,).
        target: Wanted accelerations, shape (m,).
        limits: Largest efforts, m numbers.

    Returns:
        The motion of the drives, shape (m,) each.
    """
    m = len(target)
    needed = inertia @ target + resisting
    effort = list(needed)
    # 1 for a drive that saturates, 0 for the others. In code the set is not known, so that all m
    # equations are solved: those of the others read 1 x = 0.
    saturated: list[Any] = [0.0] * m
    goal = list(needed)
    acceleration: Any = target
    for _ in range(m):
        for i, limit in enumerate(limits):
            over = indicator(magnitude(effort[i]) > limit, effort[i])
            goal[i] = where(over > 0.5, clipped(effort[i], -limit, limit), goal[i])
            saturated[i] = saturated[i] + over - saturated[i] * over  # logical or
        correction = solve_linear(*_saturated_system(inertia, saturated, goal, needed))
        acceleration = target + correction
        effort = list(needed + inertia @ correction)
    limited = []
    for i, limit in enumerate(limits):
        is_saturated = saturated[i] > 0.5
        limited.append(where(is_saturated, goal[i], clipped(effort[i], -limit, limit)))
    efforts = array(limited) if target.dtype == object else np.array(limited)
    return DrivenMotion(acceleration, efforts, needed)


def _saturated_system(
    inertia: np.ndarray, saturated: Sequence[Any], goal: Sequence[Any], needed: Sequence[Any]
) -> tuple[np.ndarray, np.ndarray]:
    """Return matrix and right side of the equations for the accelerations by which drives yield,
    see `within_efforts`.
    """
    m = len(saturated)
    matrix = np.array(
        [[saturated[i] * inertia[i, j] * saturated[j] for j in range(m)] for i in range(m)]
    )
    right = np.array([saturated[i] * (goal[i] - needed[i]) for i in range(m)])
    for i in range(m):
        matrix[i, i] = matrix[i, i] + (1.0 - saturated[i])
    return matrix, right


def saturate_acceleration(
    mass: np.ndarray,
    resisting: np.ndarray,
    target: np.ndarray,
    limits: np.ndarray,
    drives: np.ndarray,
    passive: np.ndarray,
) -> DrivenMotion:
    """Return accelerations of all joints for drives of limited effort, in any kind of number.

    With the accelerations split into those of the drives d and the passive joints p, the passive
    rows of the equation of motion give a_p = -M_pp⁻¹ (r_p + M_pd a_d). The drive rows then are

        τ = (M_dd - M_dp M_pp⁻¹ M_pd) a_d + (r_d - M_dp M_pp⁻¹ r_p):

    the bracket before a_d is the inertia of the drives with the passive joints free, see
    `within_efforts`.

    Args:
        mass: Mass matrix, shape (n, n).
        resisting: Generalized forces r without acceleration, shape (n,).
        target: Wanted accelerations of the drives, shape (m,).
        limits: Their largest efforts, shape (m,).
        drives: Indices of the drives.
        passive: Indices of the passive joints; the others stand still.

    Returns:
        The motion: accelerations of all joints, shape (n,), and efforts of the drives.
    """
    inertia = mass[np.ix_(drives, drives)]
    resisting_drives = resisting[drives]
    a = np.array([0.0] * len(resisting), dtype=resisting.dtype)
    if not len(passive):
        driven = within_efforts(inertia, resisting_drives, target, limits)
        a[drives] = driven.acceleration
        return DrivenMotion(a, driven.effort, driven.needed)
    passive_mass = mass[np.ix_(passive, passive)]
    coupling = mass[np.ix_(passive, drives)]
    falling = solve_linear(passive_mass, resisting[passive])  # -a_p where the drives do not move
    columns = [solve_linear(passive_mass, coupling[:, i]) for i in range(len(drives))]
    carried = np.array(columns).T  # -a_p for a unit acceleration of each drive
    resisting_free = resisting_drives - coupling.T @ falling
    inertia_free = inertia - coupling.T @ carried
    driven = within_efforts(inertia_free, resisting_free, target, limits)
    a[drives] = driven.acceleration
    a[passive] = -(falling + carried @ a[drives])
    return DrivenMotion(a, driven.effort, driven.needed)


@dataclass(frozen=True, eq=False)
class Converters:
    """Frequency converters of a crane with m drives; `converters` returns typical ones.

    Attributes:
        rates: Largest rates [rad/s or m/s], shape (m,); commands beyond are clipped to them.
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
        for attribute in Response._fields:
            name = f"{attribute} of converters"
            column = finite(name, getattr(self, attribute), (m,)).astype(float)
            allowed = ">= 0" if attribute == "resolutions" else "> 0"
            for value in column.tolist():
                number(name, value, "", allowed)
            column.flags.writeable = False
            object.__setattr__(self, attribute, column)
        number("delay of converters", self.delay, "s", ">= 0")

    @property
    def response(self) -> Response:
        """Numbers of the converters without their delay."""
        return Response(self.rates, self.accelerations, self.jerks, self.lags, self.resolutions)

    def delay_steps(self, dt: float, control_period: float) -> int:
        """Return the delay in control periods, rounded up.

        Args:
            dt: Physics step [s].
            control_period: Time from a command to the next [s].

        Raises:
            OutOfRange: If there are more than 64, or a physics step [s] is longer than a lag.
        """
        within("shortest lag of the converters", float(self.lags.min()), dt, math.inf, "s")
        steps = math.ceil(self.delay / control_period - _ROUND_OFF)
        if steps > MAX_DELAY_STEPS:
            longest = MAX_DELAY_STEPS * control_period
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

    def checked_for(self, crane: Crane) -> Converters:
        """Return these converters, checked to be one for each drive of a crane.

        Raises:
            OutOfRange: If their number is another.
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
    crane's joints. A drive that has neither gets one of `DEFAULT_RATES` with `HEADROOM`, see
    `default_rates`. They ramp up to the rate without headroom in `RAMP_TIMES`, and reach this
    acceleration in `ROUNDING`.

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
    columns: dict[str, list[float]] = {attribute: [] for attribute in Response._fields}
    for joint, limit in zip(layout.driven, crane.rate_limit.tolist(), strict=True):
        nominal_rate = min(RATES.get(joint.role, math.inf), limit)
        if not math.isfinite(nominal_rate):
            nominal_rate = DEFAULT_RATES[joint.kind]
        acceleration = nominal_rate / RAMP_TIMES.get(joint.role, RAMP_TIME)
        rate = min(HEADROOM * nominal_rate, limit)
        columns["rates"].append(rate)
        columns["accelerations"].append(acceleration)
        columns["jerks"].append(acceleration / ROUNDING)
        columns["lags"].append(LAGS.get(joint.role, LAG))
        columns["resolutions"].append(rate / STEPS)
    for name, values_by_symbol in values.items():
        if name not in columns:
            raise UnknownName("number of converters", name, [*columns, "delay"])
        for symbol, value in values_by_symbol.items():
            columns[name][layout.drive(symbol)] = number(f"{name} of {symbol}", value)
    return Converters(
        rates=np.array(columns["rates"]),
        accelerations=np.array(columns["accelerations"]),
        jerks=np.array(columns["jerks"]),
        lags=np.array(columns["lags"]),
        resolutions=np.array(columns["resolutions"]),
        delay=delay,
    )


def default_rates(crane: Crane) -> list[str]:
    """Return a sentence for each drive whose converter has one of `DEFAULT_RATES`.

    It is shown beside the motion of a crane with converters.
    """
    sentences = []
    for joint, limit in zip(crane.layout.driven, crane.rate_limit.tolist(), strict=True):
        if joint.role in RATES or math.isfinite(limit):
            continue
        sentences.append(
            f"{joint.name} has no velocity limit; its converter is given the default rate of "
            f"{DEFAULT_RATES[joint.kind]:g} {joint.unit}/s, and {HEADROOM:g} times that at most. A "
            "URDF states another rate as velocity of <limit>, Python as converters(crane, "
            "rates=...)."
        )
    return sentences


def converters_of_run(crane: Crane, drive: str, explicit: Converters | None) -> Converters | None:
    """Return the frequency converters of a run: those given, or typical ones, for drives that take
    velocities, and None for other drives.

    Args:
        crane: The crane.
        drive: What the drives take: "effort", "motion" or "velocity".
        explicit: Converters that the caller gives; None for none.

    Raises:
        OutOfRange: If converters are given to drives that have none, or not one for each drive.
    """
    if drive == "velocity":
        return converters(crane) if explicit is None else explicit.checked_for(crane)
    if explicit is not None:
        raise OutOfRange("converters", "given", f"None where drive = {drive}")
    return None
