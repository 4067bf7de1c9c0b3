"""References that know nothing of the load: hold still, pulses, ramps, and quintic splines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy

from cranedyn.checks import finite, number, read_only, short_repr
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.interfaces import Reference, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.layout import Layout
from cranedyn.references.motion import Motion
from cranedyn.references.tabulated import Tabulating, as_setpoint, tabulated

_BLOCK = 100
"""Control instants for which a reference is asked at once."""


@dataclass(frozen=True, eq=False)
class Still:
    """A reference that does not move.

    Attributes:
        setpoint: The setpoint at all times, read-only.
    """

    setpoint: Setpoint

    def __post_init__(self) -> None:
        """Check the setpoint and copy it."""
        arrays = (read_only(np.array(component)) for component in as_setpoint(self.setpoint))
        object.__setattr__(self, "setpoint", Setpoint(*arrays))

    def __call__(self, t: float) -> Setpoint:
        """Return the setpoint at a time [s]."""
        return self.setpoint

    def at(self, times: np.ndarray) -> Setpoint:
        """Return setpoints at many times [s], shape (n, m) each: views of one row."""
        views = []
        for row in self.setpoint:
            # A stride of zero bytes from row to row repeats the one row without copying it.
            shape = (len(times), len(row))
            views.append(np.ndarray(shape, row.dtype, row, strides=(0, row.itemsize)))
        return Setpoint(*views)


def hold(crane: Crane, state: State | None = None) -> Reference:
    """Keep the drives of a crane where a state has them; None for where it starts."""
    q = crane.layout.as_state("state", crane.start if state is None else state).q
    at_rest = np.zeros(crane.layout.m)
    return Still(Setpoint(q[crane.layout.drives], at_rest, at_rest))


def checked_reference(
    reference: Reference, layout: Layout, t_start: float, period: float
) -> Reference:
    """Return a reference that checks its setpoints at the control instants of a run, see
    `as_setpoint`.

    A reference with a method `at` is asked for many instants at once, which is faster. The setpoint
    of `Still`, which cannot change, is checked only once.

    Args:
        reference: The reference.
        layout: Coordinates of the crane.
        t_start: First control instant [s].
        period: Time between control instants [s].

    Raises:
        OutOfRange: If it is a `Motion` of another crane.
    """
    if isinstance(reference, Motion):
        reference.check_fits("reference", layout)
    if type(reference) is Still:
        as_setpoint(reference.setpoint, (layout.m,))
        return reference

    def checked_setpoint(t: float) -> Setpoint:
        """Return the setpoint at an instant, of which the reference is asked by itself."""
        return as_setpoint(reference(t), (layout.m,))

    @lru_cache(maxsize=1)
    def block(first: int) -> list[Setpoint]:
        """Return the setpoints of a block of instants from one on; none if one of them raises."""
        times = t_start + period * np.arange(first, first + _BLOCK)
        # An error may be that of an instant that the run does not reach: then the reference is
        # asked for each instant by itself.
        with suppress(CraneError):
            table = tabulated(reference, times, layout.m)
            return list(map(Setpoint, table.position, table.velocity, table.acceleration))
        return []

    def from_block(t: float) -> Setpoint:
        """Return the setpoint at an instant from the block in which it is."""
        k = round((t - t_start) / period)
        rows = block(k - k % _BLOCK)
        return rows[k % _BLOCK] if rows else checked_setpoint(t)

    return from_block if hasattr(reference, "at") else checked_setpoint


@dataclass(frozen=True, eq=False)
class Pulse(Tabulating):
    """A reference and a rectangular pulse.

    Attributes:
        base: The reference otherwise.
        step: Displacement of the drives during the pulse [rad or m], shape (m,).
        first: Time at which the pulse starts [s].
        last: Time at which it ends [s].
    """

    base: Reference
    step: np.ndarray
    first: float
    last: float

    def at(self, times: np.ndarray) -> Setpoint:
        """Return setpoints at many times [s], shape (n, m) each."""
        setpoint = tabulated(self.base, times, len(self.step))
        is_displaced = (self.first <= times) & (times < self.last)
        return setpoint._replace(position=setpoint.position + np.outer(is_displaced, self.step))


def pulse(
    crane: Crane, base: Reference, drive: str, amplitude: float, *, at: float, width: float
) -> Reference:
    """Add a rectangular pulse to one drive of a reference.

    A pivot that follows it and comes back after half a swing period leaves a swing of 2 amplitude /
    cable length (small angles).

    Args:
        crane: The crane.
        base: The reference otherwise.
        drive: Symbol of its coordinate, such as "x".
        amplitude: Displacement of the drive, with sign [rad or m].
        at: Time at which it starts [s].
        width: Duration [s].

    Raises:
        UnknownName: For another drive.
        OutOfRange: For a number that is not finite, or a width that is not positive.
    """
    step = number("pulse amplitude", amplitude) * crane.layout.along(drive)
    start = number("pulse start", at, "s")
    duration = number("pulse width", width, "s", "> 0")
    return Pulse(base, step, start, start + duration)


@dataclass(frozen=True, eq=False)
class Ramp(Tabulating):
    """A reference and a move at constant speed.

    Attributes:
        base: The reference otherwise.
        rates: Rates of the drives during the move [rad/s or m/s], shape (m,).
        first: Time at which the move starts [s].
        last: Time at which it ends [s].
    """

    base: Reference
    rates: np.ndarray
    first: float
    last: float

    def at(self, times: np.ndarray) -> Setpoint:
        """Return setpoints at many times [s], shape (n, m) each."""
        setpoint = tabulated(self.base, times, len(self.rates))
        elapsed = np.clip(times, self.first, self.last) - self.first
        moving = (self.first <= times) & (times < self.last)
        return setpoint._replace(
            position=setpoint.position + np.outer(elapsed, self.rates),
            velocity=setpoint.velocity + np.outer(moving, self.rates),
        )


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
    start = number("ramp start", at, "s")
    return Ramp(base, rates=speed * direction, first=start, last=at + abs(by) / speed)


PEAK_RATE = 15.0 / 8.0
"""Largest velocity of the quintic 10 s³ - 15 s⁴ + 6 s⁵ from 0 to 1 in unit time, at s = 1/2."""

PEAK_ACCELERATION = 10.0 / np.sqrt(3.0)
"""Largest acceleration of the same quintic, at s = (1 ± 1/√3) / 2."""


@dataclass(frozen=True, eq=False)
class Spline(Tabulating):
    """A reference of one quintic for each drive and each section, at rest at every waypoint; before
    and after it stands still.

    Attributes:
        times: When the waypoints are reached, the first is the departure [s], shape (n,).
        points: Positions of the drives at each of them [rad or m], shape (n, m).
    """

    times: np.ndarray
    points: np.ndarray

    def __post_init__(self) -> None:
        """Build the polynomials."""
        times = finite("times", self.times, ("n",), unit="s")
        points = finite("points", self.points, (times.size, "m"))
        if len(times) < 2 or not (np.diff(times) > 0.0).all():
            raise OutOfRange("times", short_repr(times), "two or more that increase", "s")
        zeros = np.zeros_like(points)
        curve = scipy.interpolate.BPoly.from_derivatives(
            times, np.stack([points, zeros, zeros], axis=1)
        )
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "_curves", (curve, curve.derivative(), curve.derivative(2)))

    @property
    def arrival(self) -> float:
        """When the last waypoint is reached [s]."""
        return float(self.times[-1])

    def at(self, times: np.ndarray) -> Setpoint:
        """Return setpoints at many times [s], shape (n, m) each."""
        inside = np.clip(times, self.times[0], self.times[-1])
        return Setpoint(*(curve(inside) for curve in self._curves))  # type: ignore[attr-defined]


def spline(
    crane: Crane,
    start: State,
    waypoints: Sequence[Sequence[float]],
    durations: Sequence[float],
    *,
    at: float = 0.0,
) -> Spline:
    """Return a spline from the position of the drives through waypoints.

    Args:
        crane: The crane.
        start: Where the drives are.
        waypoints: Positions of the drives at each [rad or m], shape (k, m).
        durations: Time for each section [s].
        at: Departure [s].

    Raises:
        OutOfRange: If there is no waypoint, the numbers of waypoints and durations differ, or a
            number is not finite or not positive.
    """
    if not len(waypoints) or len(waypoints) != len(durations):
        allowed = f"that of the waypoints, {len(waypoints)}, and one at least"
        raise OutOfRange("number of durations", len(durations), allowed)
    points = _points(crane, start, waypoints)
    steps = [number("duration of a section", duration, "s", "> 0") for duration in durations]
    return Spline(number("departure", at, "s") + np.cumsum([0.0, *steps]), points)


def _points(crane: Crane, start: State, waypoints: Sequence[Sequence[float]]) -> np.ndarray:
    """Return the positions of the drives at a start and at waypoints, shape (1 + k, m)."""
    first = crane.layout.as_state("start", start).q[crane.layout.drives]
    return np.array([first, *(crane.layout.for_drives("waypoint", point) for point in waypoints)])


def shortest(
    crane: Crane,
    start: State,
    waypoints: Sequence[Sequence[float]],
    *,
    rates: Sequence[float],
    accelerations: Sequence[float],
) -> list[float]:
    """Return the shortest durations of the sections [s] at which no drive exceeds its rate or
    acceleration.

    Args:
        crane: The crane.
        start: Where the drives are.
        waypoints: Positions of the drives at each [rad or m], shape (k, m).
        rates: Limits of the drives [rad/s or m/s]; the crane's own hold as well.
        accelerations: Limits of the drives [rad/s² or m/s²].

    Raises:
        OutOfRange: If a limit is not positive, or a waypoint not one number for each drive.
    """
    v = np.minimum(crane.layout.for_drives("rate limit", rates, "/s", "> 0"), crane.rate_limit)
    a = crane.layout.for_drives("acceleration limit", accelerations, "/s²", "> 0")
    paths = np.abs(np.diff(_points(crane, start, waypoints), axis=0))
    # In a duration T over a path s the peaks are PEAK_RATE s / T and PEAK_ACCELERATION s / T².
    durations = []
    for path in paths:
        by_rate = (PEAK_RATE * path / v).max()
        by_acceleration = np.sqrt(PEAK_ACCELERATION * path / a).max()
        durations.append(float(max(by_rate, by_acceleration)))
    return durations
