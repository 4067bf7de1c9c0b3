"""The path of a load as a smooth curve: straight lines between places, with rounded corners.

Its parameter is *time at full speed*: on each straight line the drive that takes longest goes at
its full rate, so that the length of a path is a duration. A path says where the load goes, and not
yet when; see `cranedyn.lifts.planning.timing` for that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import Polynomial

from cranedyn.errors import OutOfRange
from cranedyn.lifts.planning.clearance import Clearance
from cranedyn.lifts.planning.motion_proof import unproven_parameter
from cranedyn.references.limits import Limits

# About a corner the derivative of a path is averaged with a weight w(u) on -1 to 1 whose integral
# is 1. As w and its first two derivatives are zero at both ends, paths have four continuous
# derivatives.
_KERNEL = Polynomial([35.0 / 32.0]) * Polynomial([1.0, 0.0, -1.0]) ** 3
"""The weight w(u) = 35/32 (1 - u²)³."""

_STEP = _KERNEL.integ(lbnd=-1)
"""Integral of the weight from -1: a smooth step from 0 to 1."""

_RAMP = _STEP.integ(lbnd=-1)
"""Integral of that step from -1."""

_MIN_WIDTH = 1e-3
"""Smallest width to which a corner is rounded [s]; about a sharper one accelerations are too large
for the timing."""

_MAX_TRIES = 9
"""Number of widths, each half of the one before, that are tried at a corner."""

_LEG_SHARE = 0.49
"""Largest share of a leg over which a corner at one of its ends is rounded: nearly half, since
there is another corner at the other end."""

_END_LEG_SHARE = 0.98
"""Largest share of the first and last leg over which their only corner is rounded."""

LONGEST_LIFT = 2.0 * 3600.0
"""Longest motion that is planned [s]. Longer ones would fill gigabytes with a row for each 5 ms."""


def interpolate_columns(t: np.ndarray, rows: np.ndarray, table: np.ndarray) -> np.ndarray:
    """Interpolate each column of a table linearly to other times; before and after its rows it is
    constant.

    Args:
        t: Times to interpolate to, shape (m,).
        rows: Increasing times of the rows of the table, shape (n,).
        table: The table, shape (n, k).

    Returns:
        The table at the other times, shape (m, k).
    """
    return np.column_stack([np.interp(t, rows, column) for column in table.T])


def leg_durations(points: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Return the time at full speed from each place to the next [s], shape (n - 1,).

    Args:
        points: Places, shape (n, 3).
        rates: Rates of slew [rad/s], trolley and hoist [m/s], shape (3,).
    """
    return (np.abs(np.diff(points, axis=0)) / rates).max(axis=1)


def rest_to_rest_time(
    distances: np.ndarray, rates: np.ndarray, accelerations: np.ndarray
) -> np.ndarray:
    """Return the times in which drives get from rest to rest by trapezoids of their rates [s],
    shape (m,).

    Args:
        distances: Distances d [rad or m], shape (m,).
        rates: Largest rates, shape (m,).
        accelerations: Largest accelerations a, shape (m,).
    """
    # Speeding up to the peak rate p and braking takes the distance p²/a. Where d is less, the rate
    # never reaches its limit: p = √(d a). The time is d/p at the peak rate, and p/a more for
    # speeding up and braking.
    peak = np.minimum(rates, np.sqrt(distances * accelerations))
    cruise = np.divide(distances, peak, out=np.zeros_like(distances), where=distances > 0.0)
    return cruise + peak / accelerations


def refuse_endless(duration: float, limits: Limits) -> None:
    """Refuse a motion that would take so long that its rows do not fit into memory.

    Args:
        duration: Time that the drives need at least [s].
        limits: Their limits.

    Raises:
        OutOfRange: If that is longer than `LONGEST_LIFT`.
    """
    if not duration <= LONGEST_LIFT:
        raise OutOfRange(
            f"time that drives need at rates of {_listed(limits.rates)} rad/s or m/s and "
            f"accelerations of {_listed(limits.accelerations)} rad/s² or m/s²",
            float(f"{duration / 3600.0:.3g}"),
            f"up to {LONGEST_LIFT / 3600.0:g}",
            "h",
        )


def _listed(numbers: Sequence[float]) -> str:
    """Return numbers to read, with three digits."""
    return ", ".join(f"{x:.3g}" for x in numbers)


def straight_time(ends: np.ndarray, limits: Limits) -> float:
    """Return the time [s] that the slowest drive needs from a place to another, shape (2, 3)."""
    distances = np.abs(ends[1] - ends[0])
    rates = np.array(limits.rates)
    accelerations = np.array(limits.accelerations)
    return float(rest_to_rest_time(distances, rates, accelerations).max())


@dataclass(frozen=True, eq=False)
class Path:
    """A curve along straight legs between places, with rounded corners. It begins at the first
    place, ends at the last one, and leaves the legs only where a corner is rounded.

    Attributes:
        points: Places, no two consecutive ones equal, shape (n, 3).
        rates: Rates of slew [rad/s], trolley and hoist [m/s], shape (3,).
        widths: Over which time at full speed each corner is rounded before it, and the same after
            it [s], shape (n - 2,).
    """

    points: np.ndarray
    rates: np.ndarray
    widths: np.ndarray

    @cached_property
    def knots(self) -> np.ndarray:
        """Parameter of each place [s], shape (n,)."""
        return np.concatenate([[0.0], np.cumsum(leg_durations(self.points, self.rates))])

    @property
    def duration(self) -> float:
        """Its length as time at full speed [s]."""
        return float(self.knots[-1])

    @cached_property
    def _speeds(self) -> np.ndarray:
        """Derivative of the place with respect to the parameter on each leg, shape (n - 1, 3)."""
        return np.diff(self.points, axis=0) / np.diff(self.knots)[:, None]

    def derivatives(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return places and their first and second derivatives, shape (m, 3) each, at parameters
        [s], shape (m,).
        """
        leg = np.clip(np.searchsorted(self.knots, s, side="right") - 1, 0, len(self.points) - 2)
        position = self.points[leg] + (s - self.knots[leg])[:, None] * self._speeds[leg]
        first = self._speeds[leg].copy()
        second = np.zeros_like(position)

        # Near a corner a smooth step replaces the jump from the speed of one leg to that of the
        # next, and its integral replaces the kink of the place.
        for k, width in enumerate(self.widths):
            from_corner = (s - self.knots[k + 1]) / width
            inside = np.abs(from_corner) < 1.0
            bend = self._speeds[k + 1] - self._speeds[k]
            u = from_corner[inside]
            position[inside] += (width * (_RAMP(u) - np.maximum(u, 0.0)))[:, None] * bend
            first[inside] += (_STEP(u) - (u >= 0.0))[:, None] * bend
            second[inside] += (_KERNEL(u) / width)[:, None] * bend
        return position, first, second

    def at(self, s: float) -> np.ndarray:
        """Return the place at a parameter [s], shape (3,)."""
        return self.derivatives(np.array([s]))[0][0]

    def reach(self, first: float, last: float) -> np.ndarray:
        """See `cranedyn.lifts.planning.motion_proof.DriveCurve`.

        Within a corner the speed is a mean of the speeds before and after it, so that a leg counts
        as far as the corners at its ends are rounded.
        """
        begins = self.knots[:-1] - np.append(0.0, self.widths)
        ends = self.knots[1:] + np.append(self.widths, 0.0)
        legs = (begins <= last) & (ends >= first)
        return np.abs(self._speeds[legs]).max(axis=0) * ((last - first) / 2.0)


def rounded_path(clearance: Clearance, points: np.ndarray, rates: np.ndarray) -> Path | None:
    """Return a curve along straight lines between places, each corner rounded as widely as can be
    proven; None if a corner cannot be rounded.

    Args:
        clearance: Crane and site.
        points: Places, shape (n, 3); the straight lines between them are proven free.
        rates: Rates of the drives, shape (3,).
    """
    legs = leg_durations(points, rates)
    shares = np.full(len(legs), _LEG_SHARE)
    shares[0] = _END_LEG_SHARE
    shares[-1] = _END_LEG_SHARE
    longest = shares * legs
    widths = np.minimum(longest[:-1], longest[1:])
    for k in range(len(widths)):
        width = _proven_width(clearance, points, rates, widths, k)
        if width is None or width < _MIN_WIDTH:
            return None
        widths[k] = width
    return Path(points, rates, widths)


def _proven_width(
    clearance: Clearance, points: np.ndarray, rates: np.ndarray, widths: np.ndarray, k: int
) -> float | None:
    """Return the largest width of a corner that is proven free, of its width and the halves of it;
    None if none is.

    Args:
        clearance: Crane and site.
        points: Places of the path, shape (n, 3).
        rates: Rates of the drives, shape (3,).
        widths: Widths of all corners [s], shape (n - 2,).
        k: Index of the corner among them.
    """
    tried = widths.copy()
    for _ in range(_MAX_TRIES):
        path = Path(points, rates, tried)
        corner = path.knots[k + 1]
        width = tried[k]
        if unproven_parameter(clearance, path, corner - width, corner + width) is None:
            return width
        tried[k] /= 2.0
    return None
