"""Proofs that nothing is touched along a whole motion, not samples of it.

`Clearance.swing_margin` changes by no more than `Clearance.travel` over a stretch. Where the margin
in the middle is more than that, the whole stretch is free. Elsewhere a part about the middle is,
and both sides of it are examined in the same way. A proof fails only where the clearance is within
`CLOSE` of the required one.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple, Protocol

import numpy as np

from cranedyn.errors import CraneError
from cranedyn.lifts.planning.clearance import Clearance

CLOSE = 1e-2
"""Margin that a proof does not go below [m]: a motion with less is not proven."""

_MAX_STRETCHES = 20_000
"""Stretches that a proof examines before it fails."""

_MAX_ACCELERATION = 32.0
"""Acceleration of a point that hangs [m/s²], more than thrice that of a fall. Between two rows a
period h apart it is off the straight line between them by a h²/8 at most."""

_ROUNDING_SHARE = 0.99
"""Share that is taken of the part of a stretch that the margin in its middle proves; the rest is
for rounding errors."""


class Unproven(CraneError):
    """A motion is not proven to touch nothing.

    Attributes:
        t: Time at which the proof fails [s].
    """

    def __init__(self, t: float, reason: str) -> None:
        """Keep the time and phrase the sentence."""
        self.t = t
        super().__init__(
            f"The motion found is not proven to keep the distance of the site at t = {t:.2f} s: "
            f"{reason}."
        )


class DriveCurve(Protocol):
    """A curve of places over a parameter, which `unproven_parameter` proves free."""

    def at(self, s: float) -> np.ndarray:
        """Return the place at a parameter, shape (3,)."""

    def reach(self, first: float, last: float) -> np.ndarray:
        """Return how far places between two parameters are at most from that in their middle, for
        each coordinate, shape (3,).
        """


class Line(NamedTuple):
    """A straight line from one place to another, its parameter from 0 to 1."""

    start: np.ndarray
    end: np.ndarray

    def at(self, s: float) -> np.ndarray:
        """See `DriveCurve`."""
        return self.start + s * (self.end - self.start)

    def reach(self, first: float, last: float) -> np.ndarray:
        """See `DriveCurve`."""
        return np.abs(self.end - self.start) * ((last - first) / 2.0)


def is_proven_free(clearance: Clearance, start: np.ndarray, end: np.ndarray) -> bool:
    """Return whether the straight line between two places is proven free."""
    return unproven_parameter(clearance, Line(start, end), 0.0, 1.0) is None


def unproven_parameter(
    clearance: Clearance, curve: DriveCurve, first: float, last: float
) -> float | None:
    """Return a parameter about which a curve is not proven free; None if it is from a first to a
    last parameter.
    """
    stretches = deque([(first, last)])
    examined = 0
    while stretches:
        low, high = stretches.popleft()
        middle = (low + high) / 2.0
        drive_position = curve.at(middle)
        margin = clearance.swing_margin(drive_position)
        examined += 1
        # Written so that a margin that is not a number proves nothing.
        if not margin >= CLOSE or examined > _MAX_STRETCHES:
            return middle
        change = clearance.travel(drive_position, curve.reach(low, high))
        if not margin >= change:
            # The part about the middle that is proven need not be examined again.
            radius = _ROUNDING_SHARE * (high - low) / 2.0 * margin / change
            reach = curve.reach(middle - radius, middle + radius)
            if not clearance.travel(drive_position, reach) <= margin:
                radius = 0.0
            stretches += [(low, middle - radius), (middle + radius, high)]
    return None


def unproven_row(
    clearance: Clearance, q: np.ndarray, period: float, *, envelope: np.ndarray | float = 0.0
) -> int | None:
    """Return a row of a motion about which it is not proven that all that hangs keeps its distance,
    such as one with a coordinate that is not finite; None if it does at all times.

    Between two rows no point moves farther than the difference of their coordinates says. Stretches
    of rows are halved until the margin in their middle is more than that.

    Args:
        clearance: Crane and site.
        q: Coordinates of all joints, shape (rows, n).
        period: Time between rows [s].
        envelope: How far a point that hangs may be from its place in each row [m], shape (rows,).
    """
    envelope = np.broadcast_to(envelope, len(q))
    finite = np.isfinite(q).all(axis=1) & np.isfinite(envelope)
    if not finite.all():
        return int(np.argmin(finite))
    # Bounds of how far a point that hangs moves from row to row, and of how much its envelope
    # grows.
    steps = clearance.displacement(q[:-1, :], q[1:, :]) + np.abs(np.diff(envelope))
    moved = np.concatenate([[0.0], np.cumsum(steps)])
    bend = _MAX_ACCELERATION * period**2 / 8.0
    stretches = [(0, len(q) - 1)]
    while stretches:
        low, high = stretches.pop()
        middle = (low + high) // 2
        # Not Python's max, which would drop a way that is not a number.
        bound = np.maximum(moved[middle] - moved[low], moved[high] - moved[middle]) + bend
        if clearance.margin(q[middle]) - envelope[middle] > bound:
            continue
        if high - low <= 1:
            return middle
        stretches += [(low, middle), (middle, high)]
    return None


class SlewRange(NamedTuple):
    """Slew angles through which jib and counter-jib turn and keep the required distance.

    Attributes:
        low, high: Ends of the range [rad].
        below, above: Obstacles at these ends; empty where the joint's own range ends.
    """

    low: float
    high: float
    below: str
    above: str


def slew_range(clearance: Clearance, gamma: float, low: float, high: float) -> SlewRange:
    """Return the slew angles that jib and counter-jib are proven to reach from an angle gamma
    [rad], within the range of the joint from low to high [rad]; an empty range, with both ends at
    gamma, where the jib is too close to an obstacle.
    """
    lowest, below = _slewed_towards(clearance, gamma, low, sign=-1.0)
    highest, above = _slewed_towards(clearance, gamma, high, sign=1.0)
    return SlewRange(lowest, highest, below, above)


def _slewed_towards(
    clearance: Clearance, gamma: float, limit: float, *, sign: float
) -> tuple[float, str]:
    """Return the angle that the jib is proven to reach from an angle gamma towards a limit [rad],
    in the direction of a sign, and the obstacle that is there; no name where it reaches the limit.
    """
    angle = gamma
    while (limit - angle) * sign > 0.0 and abs(angle - gamma) <= 2.0 * math.pi:
        margin = clearance.slewing_margin(angle)
        if not margin >= CLOSE:
            return angle, _nearest_to_jib(clearance, angle)
        # No point of the jib moves farther than the radius times the change of the angle.
        angle += sign * min(margin / clearance.slewing_radius, math.pi)
    has_turned_fully = abs(angle - gamma) > 2.0 * math.pi
    is_beyond = (angle - limit) * sign > 0.0
    return (limit if has_turned_fully or is_beyond else angle), ""


def _nearest_to_jib(clearance: Clearance, gamma: float) -> str:
    """Return the name of the obstacle that is nearest to the jib at a slew angle [rad], wherever
    the load hangs.
    """
    q = clearance.q(np.array([gamma, 0.0, 1.0]))
    pairs = [pair for pair in clearance.distances(q).values() if pair.body == "jib"]
    return min(pairs).obstacle
