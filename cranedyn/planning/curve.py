"""The path of a load as a smooth curve: straight lines between places, with rounded corners.

Its parameter is time at full speed: the drive that has the longest way goes at its rate, so that
the length of a path is a duration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import Polynomial

from cranedyn.errors import OutOfRange
from cranedyn.planning.clearance import Clearance
from cranedyn.planning.proof import unproven_parameter
from cranedyn.references.limits import Limits

_KERNEL = Polynomial([35.0 / 32.0]) * Polynomial([1.0, 0.0, -1.0]) ** 3
_STEP = _KERNEL.integ(lbnd=-1)
_RAMP = _STEP.integ(lbnd=-1)
"""A weight on -1 to 1 that averages directions about a corner, its integral and that one's: curves
have four derivatives."""

_SHARPEST, _HALVINGS = 1e-3, 9

LONGEST_LIFT = 2.0 * 3600.0
"""Longest motion that is planned [s]. With a row for each 5 ms longer ones fill some GB."""


def interpolate_columns(t: np.ndarray, rows: np.ndarray, table: np.ndarray) -> np.ndarray:
    """Interpolate each column of a table, shape (n, k), linearly from its rows at increasing times,
    shape (n,), to other times, shape (m,); before and after its rows it is constant.
    """
    return np.column_stack([np.interp(t, rows, column) for column in table.T])


def leg_durations(points: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Return the time at full speed from each place to the next [s], shape (n - 1,): of places of
    shape (n, 3) at rates of slew [rad/s], trolley and hoist [m/s], shape (3,).
    """
    return (np.abs(np.diff(points, axis=0)) / rates).max(axis=1)


def rest_to_rest_time(
    distances: np.ndarray, rates: np.ndarray, accelerations: np.ndarray
) -> np.ndarray:
    """Return the times [s] in which drives get along ways from rest to rest by trapezoids of their
    rates, shape (m,) each.
    """
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
    return ", ".join(f"{x:.3g}" for x in numbers)


def straight_time(ends: np.ndarray, limits: Limits) -> float:
    """Return the time [s] that the slowest drive needs from a place to another, shape (2, 3)."""
    rates, accelerations = np.array(limits.rates), np.array(limits.accelerations)
    return float(rest_to_rest_time(np.abs(ends[1] - ends[0]), rates, accelerations).max())


@dataclass(frozen=True, eq=False)
class Path:
    """A curve through places with rounded corners; it meets its first and last place, and the
    middles of its legs.

    Attributes:
        points: Places, no two following ones equal, shape (n, 3).
        rates: Rates of slew [rad/s], trolley and hoist [m/s], shape (3,).
        widths: Before and after each corner, how long it is rounded [s], shape (n - 2,).
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
        return np.diff(self.points, axis=0) / np.diff(self.knots)[:, None]

    def derivatives(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return places and their first and second derivatives, shape (m, 3) each, at parameters
        [s], shape (m,).
        """
        leg = np.clip(np.searchsorted(self.knots, s, side="right") - 1, 0, len(self.points) - 2)
        position = self.points[leg] + (s - self.knots[leg])[:, None] * self._speeds[leg]
        first, second = self._speeds[leg].copy(), np.zeros_like(position)
        for k, width in enumerate(self.widths):
            share = (s - self.knots[k + 1]) / width
            inside, bend = np.abs(share) < 1.0, self._speeds[k + 1] - self._speeds[k]
            u = share[inside]
            position[inside] += (width * (_RAMP(u) - np.maximum(u, 0.0)))[:, None] * bend
            first[inside] += (_STEP(u) - (u >= 0.0))[:, None] * bend
            second[inside] += (_KERNEL(u) / width)[:, None] * bend
        return position, first, second

    def at(self, s: float) -> np.ndarray:
        """Return the place at a parameter [s], shape (3,)."""
        return self.derivatives(np.array([s]))[0][0]

    def reach(self, first: float, last: float) -> np.ndarray:
        """See `cranedyn.planning.proof.DriveCurve`.

        Within a corner the speed is a mean of the speeds before and after it.
        """
        begins = self.knots[:-1] - np.append(0.0, self.widths)
        ends = self.knots[1:] + np.append(self.widths, 0.0)
        legs = (begins <= last) & (ends >= first)
        return np.abs(self._speeds[legs]).max(axis=0) * ((last - first) / 2.0)


def rounded_path(clearance: Clearance, points: np.ndarray, rates: np.ndarray) -> Path | None:
    """Return a proven curve along proven straight lines between places, shape (n, 3), each corner
    rounded as widely as can be proven; None if a corner cannot be rounded.
    """
    legs = leg_durations(points, rates)
    # An end of the way needs no part of its leg for another corner.
    shares = np.where(np.arange(len(legs)) % max(len(legs) - 1, 1) == 0, 0.98, 0.49)
    widths = np.minimum((shares * legs)[:-1], (shares * legs)[1:])
    for k in range(len(widths)):
        for _ in range(_HALVINGS):
            path = Path(points, rates, widths)
            corner, width = path.knots[k + 1], widths[k]
            if unproven_parameter(clearance, path, corner - width, corner + width) is None:
                break
            widths[k] /= 2.0
        else:
            return None
        if widths[k] < _SHARPEST:
            return None
    return Path(points, rates, widths)
