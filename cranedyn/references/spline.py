"""Quintic splines, rest to rest: position, velocity and acceleration of the drives without a
jump.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from cranedyn.checks import finite, number, short_repr
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.crane import Crane

PEAK_RATE, PEAK_ACCELERATION = 15.0 / 8.0, 10.0 / np.sqrt(3.0)
"""Of a quintic from 0 to 1 in unit time, rest to rest: its largest velocity and its largest
acceleration."""


@dataclass(frozen=True, eq=False)
class Spline:
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

    def __call__(self, t: float) -> Setpoint:
        """Return the setpoint at a time [s]."""
        inside = min(max(t, self.times[0]), self.times[-1])
        return Setpoint(*(curve(inside) for curve in self._curves))  # type: ignore[attr-defined]

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
        raise OutOfRange(
            "number of durations",
            len(durations),
            f"that of the waypoints, {len(waypoints)}, and one at least",
        )
    points = [crane.layout.as_state("start", start).q[crane.layout.drives]]
    for waypoint in waypoints:
        points.append(crane.layout.for_drives("waypoint", waypoint))
    steps = [number("duration of a section", duration, "s", "> 0") for duration in durations]
    return Spline(
        number("departure", at, "s") + np.concatenate([[0.0], np.cumsum(steps)]), np.array(points)
    )


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
    points = [
        crane.layout.as_state("start", start).q[crane.layout.drives],
        *(crane.layout.for_drives("waypoint", waypoint) for waypoint in waypoints),
    ]
    paths = np.abs(np.diff(points, axis=0))
    return [
        float(max((PEAK_RATE * path / v).max(), np.sqrt(PEAK_ACCELERATION * path / a).max()))
        for path in paths
    ]
