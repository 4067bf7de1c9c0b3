"""Proofs that nothing comes too near along a whole motion, instead of samples of it.

*Curves* of places are proven with the envelope of the swing, by `unproven_parameter`. Over a
stretch `Clearance.swing_margin` changes by no more than `Clearance.travel`. If the margin in the
middle is more than that, the whole stretch is free. Otherwise a part about the middle is, and the
rest on both sides is examined in the same way. Such a proof fails where the margin in the middle of
a stretch is less than `PROOF_MARGIN`, or after `_MAX_STRETCHES`.

*Rows* of coordinates are proven as they are, by `unproven_row`: if the margin of a row is more than
`Clearance.displacement` to the rows about it, all between them is free. Such a proof fails where
the margin is less than the displacement from one row to the next.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple, Protocol

import numpy as np

from cranedyn.errors import CraneError
from cranedyn.lifts.planning.clearance import Clearance
from cranedyn.lifts.planning.tower_clearance import TowerClearance

PROOF_MARGIN = 1e-2
"""Margin in the middle of a stretch below which the proof of a curve gives up [m]. Between the
middles the margin of a curve that is proven may be less, down to zero."""

_MAX_STRETCHES = 20_000
"""Number of stretches after which the proof of a curve gives up."""

MAX_ACCELERATION = 32.0
"""Acceleration that is assumed of a point that hangs [m/s²], more than three times that of a fall.
Between two rows a period h apart the point is off the straight line between them by a h²/8 at most,
which is 0.1 mm for 5 ms. That no point accelerates more is not checked."""

_ROUNDING_SHARE = 0.99
"""Share that is taken of the part of a stretch that the margin in its middle proves. The rest is
left for rounding errors."""


class Unproven(CraneError):
    """A motion is not proven to keep the required distance.

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
    """A curve of places over a parameter, which `unproven_parameter` can prove free."""

    def at(self, s: float) -> np.ndarray:
        """Return the place at a parameter, shape (3,)."""

    def reach(self, first: float, last: float) -> np.ndarray:
        """Return how far places between two parameters are at most from that in their middle
        [rad, m, m], shape (3,).
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
    """Return a parameter about which a curve is not proven free; None if the whole curve from a
    first to a last parameter is.
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
        if not margin >= PROOF_MARGIN or examined > _MAX_STRETCHES:
            return middle
        change = clearance.travel(drive_position, curve.reach(low, high))
        if margin >= change:
            continue
        # The margin proves a part about the middle, which need not be examined again. Were the
        # travel proportional to its length, it would have this radius.
        radius = _ROUNDING_SHARE * (high - low) / 2.0 * margin / change
        reach = curve.reach(middle - radius, middle + radius)
        if not clearance.travel(drive_position, reach) <= margin:
            radius = 0.0
        stretches += [(low, middle - radius), (middle + radius, high)]
    return None


def unproven_row(
    clearance: Clearance, q: np.ndarray, period: float, *, envelope: np.ndarray | float = 0.0
) -> int | None:
    """Return a row of a motion about which it is not proven that all that hangs keeps its distance;
    None if it is proven at all times. A row with a coordinate that is not finite is not proven.

    Between two rows no point moves farther than `Clearance.displacement` of their coordinates, but
    for the bend of its way, see `MAX_ACCELERATION`. Stretches of rows are halved until the margin
    in their middle row is more than that, down to a single step between two rows.

    Args:
        clearance: Crane and site.
        q: Coordinates of all joints, shape (rows, n).
        period: Time between rows [s].
        envelope: How far a point that hangs may be from where the coordinates have it, in each row
            [m], shape (rows,) or one number.
    """
    envelope = np.broadcast_to(envelope, len(q))
    finite = np.isfinite(q).all(axis=1) & np.isfinite(envelope)
    if not finite.all():
        return int(np.argmin(finite))
    # How far a point that hangs moves from row to row at most, and how much its envelope changes.
    steps = clearance.displacement(q[:-1, :], q[1:, :]) + np.abs(np.diff(envelope))
    moved = np.concatenate([[0.0], np.cumsum(steps)])
    # The displacements are those of straight lines from row to row.
    bend = MAX_ACCELERATION * period**2 / 8.0
    stretches = [(0, len(q) - 1)]
    while stretches:
        low, high = stretches.pop()
        middle = (low + high) // 2
        # Not Python's max, which may drop a displacement that is not a number.
        bound = np.maximum(moved[middle] - moved[low], moved[high] - moved[middle]) + bend
        if clearance.margin(q[middle], float(envelope[middle])) > bound:
            continue
        if high - low <= 1:
            return middle
        stretches += [(low, middle), (middle, high)]
    return None


class SlewRange(NamedTuple):
    """Slew angles through which jib and counter-jib turn and keep the required distance.

    Attributes:
        low: Lower end of the range [rad].
        high: Upper end of the range [rad].
        below: Obstacle that stops the jib at the lower end; empty where the joint's range ends.
        above: Obstacle that stops the jib at the upper end; empty where the joint's range ends.
    """

    low: float
    high: float
    below: str
    above: str


def slew_range(clearance: TowerClearance, gamma: float, low: float, high: float) -> SlewRange:
    """Return the slew angles that jib and counter-jib are proven to reach from an angle gamma
    [rad], within the range of the joint from low to high [rad]. Where the jib is too close to an
    obstacle already, the range is empty: both of its ends are gamma.
    """
    lowest, below = _slewed_towards(clearance, gamma, low, sign=-1.0)
    highest, above = _slewed_towards(clearance, gamma, high, sign=1.0)
    return SlewRange(lowest, highest, below, above)


def _slewed_towards(
    clearance: TowerClearance, gamma: float, limit: float, *, sign: float
) -> tuple[float, str]:
    """Return the angle that the jib is proven to reach from an angle gamma towards a limit [rad],
    in the direction of a sign, and the name of the obstacle that stops it; an empty name where it
    reaches the limit.
    """
    angle = gamma
    while (limit - angle) * sign > 0.0 and abs(angle - gamma) <= 2.0 * math.pi:
        margin = clearance.slewing_margin(angle)
        if not margin >= PROOF_MARGIN:
            return angle, clearance.nearest_to_jib(angle)
        # No point of the jib moves farther than the radius times the change of the angle.
        angle += sign * min(margin / clearance.slewing_radius, math.pi)
    # After a full turn nothing is left that could stop it before the limit.
    has_turned_fully = abs(angle - gamma) > 2.0 * math.pi
    is_beyond = (angle - limit) * sign > 0.0
    return (limit if has_turned_fully or is_beyond else angle), ""
