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
from cranedyn.sites.bodies import CraneBodies, place_capsules
from cranedyn.sites.proof import motion_bound

_MOST = 200
"""Boxes that a proof examines before it fails."""

_UP = np.array([0.0, 0.0, 1.0])


class Obstacles:
    """Solids that all parts of cranes keep from, and zones that ropes and loads keep out of."""

    def __init__(self, solids: Sequence[Solid]) -> None:
        """Take them in the frame of the site."""
        self._fields = [
            Field(
                (solid.name, shape)
                for solid in solids
                if solid.zone is zone
                for shape in solid.geometries()
            )
            for zone in (False, True)
        ]

    def margin(self, ends: np.ndarray, radius: float, *, zones: bool) -> float:
        """Return the distance of a capsule about a segment [m], shape (2, 3), from solids, or from
        zones [m]; inf where there is none.
        """
        return self._fields[zones].least(_capsule(ends, radius)) - ROUNDING

    def nearest(self, ends: np.ndarray, radius: float, *, zones: bool) -> str:
        """Return the name of the solid, or zone, nearest to a capsule."""
        distances = self._fields[zones].each(_capsule(ends, radius))
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
            margin = np.array(
                [
                    min(
                        self.margin(ends, radius, zones=False) - distance,
                        self.margin(ends, radius, zones=True) if hangs else np.inf,
                    )
                    for ends, radius, hangs in zip(
                        placed.ends, placed.radius, bodies.hangs[crane], strict=True
                    )
                ]
            )
            half, examined = (high - low)[:, :-1] / 2.0, examined + 1
            if margin.min() < 0.0 or examined > _MOST:
                return False
            turning = turns[None].repeat(count, axis=0)
            if (margin >= motion_bound(placed, turning, half)).all():
                continue
            each = [
                motion_bound(placed, turning, half * (np.arange(len(turns)) == k)).max()
                for k in range(len(turns))
            ]
            widest = int(np.argmax(each))
            for part in (0, 1):
                boxes.append(np.array([low[0], high[0]]))
                boxes[-1][part, widest] = (low[0, widest] + high[0, widest]) / 2.0
        return True


def _capsule(ends: np.ndarray, radius: float) -> Placed:
    """Return a capsule about a segment [m], shape (2, 3), as a body for `Field`."""
    axis = ends[1] - ends[0]
    turn = pin.Quaternion.FromTwoVectors(_UP, axis) if axis.any() else pin.Quaternion.Identity()
    shape = coal.Capsule(radius, float(np.linalg.norm(axis)))
    return Placed(coal.CollisionObject(shape, turn.toRotationMatrix(), ends.mean(axis=0)), 0.0)
