"""Obstacles of a site with several cranes: distances of capsules from them, and the proof that a
crane keeps from them wherever it is in intervals of its positions.
"""

from __future__ import annotations

from collections.abc import Sequence

import coal
import numpy as np
import pinocchio as pin

from cranedyn.planning.clearance import ROUNDING
from cranedyn.planning.fields import Field, Placed
from cranedyn.planning.solids import Solid
from cranedyn.sites.bodies import CraneBodies, PlacedCapsules, place_capsules
from cranedyn.sites.proof import motion_bound

_MOST = 200
"""Boxes that a proof examines before it fails."""

_UP = np.array([0.0, 0.0, 1.0])


class Obstacles:
    """Solids that all parts of cranes keep from, and zones that rope and load keep out of.

    Attributes:
        solids: All of them, in the frame of the site.
    """

    def __init__(self, solids: Sequence[Solid]) -> None:
        self.solids = tuple(solids)
        self._solids, self._zones = (
            Field(
                (solid.name, shape)
                for solid in solids
                if solid.zone is zone
                for shape in solid.geometries()
            )
            for zone in (False, True)
        )

    def margins(self, ends: np.ndarray, radius: np.ndarray, hangs: np.ndarray) -> np.ndarray:
        """Return the distance of capsules from solids and, of those that hang, from zones [m]; inf
        where there is none.

        Args:
            ends: Ends of the segments [m], shape (N, 2, 3).
            radius: Radii [m], shape (N,).
            hangs: Whether each hangs, shape (N,).
        """
        margins = np.full((2, len(ends)), np.inf)
        for i, (pair, r) in enumerate(zip(ends, radius.tolist(), strict=True)):
            placed = capsule(pair, r)
            margins[0, i] = self._solids.least(placed) - ROUNDING
            if hangs[i]:
                margins[1, i] = self._zones.least(placed) - ROUNDING
        return margins

    def nearest(self, ends: np.ndarray, radius: float, *, zones: bool) -> str:
        """Return the name of the obstacle nearest to a capsule, of zones or of solids."""
        distances = (self._zones if zones else self._solids).each(capsule(ends, radius))
        return min(distances, key=lambda name: distances[name])

    def proven_clear(
        self, bodies: CraneBodies, crane: int, box: np.ndarray, distance: float, swing: float
    ) -> bool:
        """Return whether no position of a crane in a box brings it nearer to a solid than a
        distance, or rope and load into a zone.

        In the middle of a box each capsule has a margin. Where that is no less than what the box
        can move the capsule by, all of the box is clear; else its widest interval is halved.

        Args:
            bodies: The cranes, `stacked`.
            crane: Index of the crane.
            box: Ends of its intervals, shape (2, k + 1), the cable length last.
            distance: Required distance [m].
            swing: Largest angle of the rope from plumb [rad].
        """
        count = bodies.radius.shape[1]
        which, capsules, turns = np.full(count, crane), np.arange(count), bodies.revolute[crane]
        boxes, examined = [box], 0
        while boxes:
            low, high = (end[None].repeat(count, axis=0) for end in boxes.pop())
            placed = place_capsules(bodies, which, capsules, low, high, swing)
            margins = self.margins(placed.ends, placed.radius, bodies.hangs[crane])
            margin = np.minimum(margins[0] - distance, margins[1])
            half, examined = (high - low)[:, :-1] / 2.0, examined + 1
            if margin.min() < 0.0 or examined > _MOST:
                return False
            turning = turns[None].repeat(count, axis=0)
            if (margin >= motion_bound(placed, turning, half)).all():
                continue
            widest = _widest(placed, turning, half)
            ends = np.array([low[0], high[0]])
            for part in (0, 1):
                halved = ends.copy()
                halved[part, widest] = ends[:, widest].mean()
                boxes.append(halved)
        return True


def capsule(ends: np.ndarray, radius: float) -> Placed:
    """Return a capsule about a segment [m], shape (2, 3), as a body for `Field`."""
    axis = ends[1] - ends[0]
    turn = pin.Quaternion.FromTwoVectors(_UP, axis) if axis.any() else pin.Quaternion.Identity()
    shape = coal.Capsule(radius, float(np.linalg.norm(axis)))
    return Placed(coal.CollisionObject(shape, turn.toRotationMatrix(), ends.mean(axis=0)), 0.0)


def _widest(placed: PlacedCapsules, turns: np.ndarray, half: np.ndarray) -> int:
    """Return the joint whose interval moves a capsule most."""
    each = [
        motion_bound(placed, turns, half * (np.arange(half.shape[1]) == k)).max()
        for k in range(half.shape[1])
    ]
    return int(np.argmax(each))
