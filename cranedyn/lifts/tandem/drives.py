"""How the drives of two cranes move during a tandem lift: positions over time, and what becomes of
them where the cranes are not synchronised, or a drive stops.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from cranedyn.checks import finite, number
from cranedyn.errors import OutOfRange


class DrivePositions(NamedTuple):
    """Positions of the drives of one crane at k times.

    Attributes:
        position: Positions [rad or m], shape (k, m).
        rate: Rates [rad/s or m/s], shape (k, m).
    """

    position: np.ndarray
    rate: np.ndarray


@dataclass(frozen=True, eq=False)
class DriveMotion:
    """Motion of the drives of one crane, which follow it exactly.

    Before the first time the drives stand where they begin, after the last one where they end.

    Attributes:
        t: Times [s], shape (rows,).
        position: Positions at these times [rad or m], shape (rows, m).
        rate: Rates [rad/s or m/s], shape (rows, m).
        delay: Time by which all of it is later [s].
    """

    t: np.ndarray
    position: np.ndarray
    rate: np.ndarray
    delay: float = 0.0

    def __post_init__(self) -> None:
        """Check the tables.

        Raises:
            OutOfRange: If a number is not finite, the times do not increase, or the tables have
                different shapes.
        """
        times = finite("times of a motion of drives", self.t, ("rows",), unit="s")
        gaps = np.diff(times)
        if len(times) < 2 or not (gaps > 0.0).all():
            raise OutOfRange("times of a motion of drives", times.tolist(), "2 or more, increasing")
        positions = finite("positions of drives", self.position, (len(times), "m"))
        finite("rates of drives", self.rate, positions.shape)
        number("delay of a motion of drives", self.delay, "s", ">= 0")

    @cached_property
    def _spline(self) -> CubicHermiteSpline:
        """Positions between the rows [rad or m]."""
        return CubicHermiteSpline(self.t, self.position, self.rate, axis=0)

    @cached_property
    def _spline_rate(self) -> CubicHermiteSpline:
        """Rates between the rows [rad/s or m/s]."""
        return self._spline.derivative()

    def at(self, t: np.ndarray) -> DrivePositions:
        """Return positions and rates of the drives at times [s], shape (k, m) each."""
        own_time = np.asarray(t, dtype=float) - self.delay
        # The table is held at both ends.
        inside = (own_time >= self.t[0]) & (own_time <= self.t[-1])
        held = np.clip(own_time, self.t[0], self.t[-1])
        rate = np.where(inside[:, None], self._spline_rate(held), 0.0)
        return DrivePositions(self._spline(held), rate)

    @property
    def end(self) -> float:
        """Time from which on the drives stand [s]."""
        return float(self.t[-1]) + self.delay

    def intervals(self, t: np.ndarray) -> np.ndarray:
        """Return bounds of the positions between successive times [s], shape (k - 1, 2, m): the
        lower and the upper end.

        Between two times h apart, a motion with accelerations of no more than A leaves the interval
        of its ends by no more than A h²/8. Where the table begins or ends with a rate v, the drive
        is held there at once, which adds no more than v h.
        """
        position = self.at(t).position
        step = np.diff(t)[:, None]
        jumps = np.abs(self.rate[[0, -1]]).max(axis=0)
        beyond = self._largest_acceleration * step**2 / 8.0 + jumps * step
        low = np.minimum(position[:-1], position[1:]) - beyond
        high = np.maximum(position[:-1], position[1:]) + beyond
        return np.stack([low, high], axis=1)

    @cached_property
    def _largest_acceleration(self) -> np.ndarray:
        """Largest acceleration of each drive [rad/s² or m/s²], shape (m,). Between two rows of the
        table it changes linearly, so that it is largest at one of them.
        """
        cubic, square, *_ = self._spline.c
        begin = 2.0 * square
        end = begin + 6.0 * cubic * np.diff(self.t)[:, None]
        return np.maximum(np.abs(begin), np.abs(end)).max(axis=0)

    def after(self, earlier: DriveMotion) -> DriveMotion:
        """Return a motion that ends where and when this one begins, followed by this one.

        Args:
            earlier: The motion before it, whose last position is the first one of this motion.
        """
        return DriveMotion(
            np.concatenate([earlier.t, earlier.t[-1] + self.t[1:] - self.t[0]]),
            np.concatenate([earlier.position, self.position[1:]]),
            np.concatenate([earlier.rate, self.rate[1:]]),
        )

    def stopped(self, drive: int, time: float, deceleration: float) -> DriveMotion:
        """Return the motion of which one drive brakes at a time, and then stands.

        Args:
            drive: Index of the drive.
            time: Time at which it begins to brake [s].
            deceleration: Its deceleration [rad/s² or m/s²].

        Raises:
            OutOfRange: If there is no such drive, or the deceleration is not positive.
        """
        count = self.position.shape[1]
        if not 0 <= drive < count:
            raise OutOfRange("drive that stops", drive, f"0 to {count - 1}")
        number("time of a stop", time, "s")
        number("deceleration of a stop", deceleration, "", "> 0")
        begin = self.at(np.array([time]))
        speed = float(begin.rate[0, drive])
        braking_time = abs(speed) / deceleration
        own_time = time - self.delay
        # Rows at both ends of the braking, so that nothing is smoothed over them.
        t = np.unique(np.concatenate([self.t, [own_time, own_time + braking_time]]))
        position, rate = self.at(t + self.delay)
        since = np.clip(t - own_time, 0.0, braking_time)
        after = t >= own_time
        braking = np.sign(speed) * deceleration
        way = speed * since - 0.5 * braking * since**2
        position[after, drive] = begin.position[0, drive] + way[after]
        rate[after, drive] = speed - braking * since[after]
        return replace(self, t=t, position=position, rate=rate)


class TandemDrives(NamedTuple):
    """Motions of the drives of both cranes.

    Attributes:
        first: Those of the first crane.
        second: Those of the second one.
    """

    first: DriveMotion
    second: DriveMotion

    @property
    def end(self) -> float:
        """Time from which on all drives stand [s]."""
        return max(self.first.end, self.second.end)

    def delayed(self, time: float) -> TandemDrives:
        """Return the motions of which the second one is later by a time [s]."""
        return self._replace(second=replace(self.second, delay=self.second.delay + time))
