"""Proofs that nothing is touched on the way, not samples of it.

`Clearance.room` changes by no more than `Clearance.travel` over a stretch. Where the room in the
middle is more than that, the whole stretch is free; where not, a part about the middle is, and what
lies on both sides of it is looked at in the same way. What is left is either free for certain or
nearer than `CLOSE` to the required distance.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple, Protocol

import numpy as np

from cranedyn.errors import CraneError
from cranedyn.planning.clearance import Clearance

CLOSE = 1e-2
"""Room that a proof does not go below [m]: stretches of a motion with less are not proven."""

_MOST = 20_000

_FASTEST = 32.0
"""Acceleration of a point that hangs [m/s²], more than thrice that of a fall: between two rows it
is off its straight line by h²/8 of it at most."""


class Unproven(CraneError):
    """A motion that is not proven to touch nothing.

    Attributes:
        t: When it is not [s].
    """

    def __init__(self, t: float, why: str) -> None:
        """Keep the time and phrase the sentence."""
        self.t = t
        super().__init__(
            f"The motion found is not proven to keep the distance of the site at t = {t:.2f} s: "
            f"{why}."
        )


class Curve(Protocol):
    """Places over a parameter."""

    def at(self, s: float) -> np.ndarray:
        """The place at a parameter, shape (3,)."""

    def reach(self, first: float, last: float) -> np.ndarray:
        """How far places between two parameters are at most from that in their middle, each
        coordinate for itself, shape (3,).
        """


class Line(NamedTuple):
    """A straight line from one place to another, its parameter from 0 to 1."""

    start: np.ndarray
    end: np.ndarray

    def at(self, s: float) -> np.ndarray:
        """See `Curve`."""
        return self.start + s * (self.end - self.start)

    def reach(self, first: float, last: float) -> np.ndarray:
        """See `Curve`."""
        return np.abs(self.end - self.start) * ((last - first) / 2.0)


def unproven(clearance: Clearance, curve: Curve, first: float, last: float) -> float | None:
    """Where a curve is not proven free between two parameters; None if all of it is."""
    waiting, looked_at = deque([(first, last)]), 0
    while waiting:
        low, high = waiting.popleft()
        middle = (low + high) / 2.0
        place = curve.at(middle)
        room, looked_at = clearance.room(place), looked_at + 1
        if room < CLOSE or looked_at > _MOST:
            return middle
        far = clearance.travel(place, curve.reach(low, high))
        if room < far:
            # What is proven about the middle need not be looked at again.
            near = 0.99 * (high - low) / 2.0 * room / far
            if clearance.travel(place, curve.reach(middle - near, middle + near)) > room:
                near = 0.0
            waiting += [(low, middle - near), (middle + near, high)]
    return None


def unproven_row(
    clearance: Clearance, q: np.ndarray, period: float, *, swinging: bool = False
) -> int | None:
    """Return a row of a motion about which it is not proven that all that hangs keeps its distance;
    None if it does at all times.

    Between two rows no point moves farther than the difference of their coordinates says; stretches
    of rows are halved until the room in their middle is more than that.

    Args:
        clearance: Crane and site.
        q: Coordinates of all joints, shape (rows, n).
        period: Time between rows [s].
        swinging: Whether the envelope of swing has to be free about what hangs, too.
    """
    margin = clearance.envelope(q[:, clearance.joints.hoist]) * swinging
    before, after = (np.delete(q, end, axis=0) for end in (-1, 0))
    steps = clearance.moved(before, after) + np.abs(np.diff(margin))
    gone = np.concatenate([[0.0], np.cumsum(steps)])
    bend, waiting = _FASTEST * period**2 / 8.0, [(0, len(q) - 1)]
    while waiting:
        low, high = waiting.pop()
        middle = (low + high) // 2
        way = max(gone[middle] - gone[low], gone[high] - gone[middle]) + bend
        if clearance.true_room(q[middle]) - margin[middle] > way:
            continue
        if high - low <= 1:
            return middle
        waiting += [(low, middle), (middle, high)]
    return None


class SlewRange(NamedTuple):
    """Slew angles through which jib and counter-jib turn without coming nearer to anything than
    required.

    Attributes:
        low, high: The range [rad].
        below, above: What ends it there, empty for the range of the joint itself.
    """

    low: float
    high: float
    below: str
    above: str


def slew_range(clearance: Clearance, gamma: float, low: float, high: float) -> SlewRange:
    """The slew angles that can be reached from one without jib or counter-jib coming too near to
    anything, proven on the way.

    Args:
        clearance: Crane and site.
        gamma: Where the jib stands [rad].
        low: Least slew angle of the joint [rad].
        high: Largest slew angle of the joint [rad].

    Returns:
        The range; empty, with both ends at the angle, where the jib is too near to something as it
        stands.
    """
    ends, names = [], []
    for sign, limit in ((-1.0, low), (1.0, high)):
        here, name = gamma, ""
        while (limit - here) * sign > 0.0 and abs(here - gamma) <= 2.0 * math.pi:
            room = clearance.slewing_room(here)
            if room < CLOSE:
                q = clearance.q(np.array([here, 0.0, 1.0]))
                name = min(
                    found for found in clearance.distances(q).values() if found.body == "jib"
                ).obstacle
                break
            here += sign * min(room / clearance.slewing_radius, math.pi)
        whole = abs(here - gamma) > 2.0 * math.pi
        ends.append(limit if whole or (here - limit) * sign > 0.0 else here)
        names.append(name)
    return SlewRange(ends[0], ends[1], names[0], names[1])
