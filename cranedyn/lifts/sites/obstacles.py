"""Obstacles of a site with several cranes: distances of capsules from them, and the proof that a
crane keeps from them wherever it is in intervals of its positions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import coal
import numpy as np
import pinocchio as pin

from cranedyn.lifts.planning.clearance import ROUNDING
from cranedyn.lifts.planning.fields import Field, Placed
from cranedyn.lifts.planning.solids import Solid
from cranedyn.lifts.sites.distance_proof import MAX_SWING, is_box
from cranedyn.lifts.sites.placed_capsules import CraneBodies, place_capsules

_MOST = 30
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

    def margins(self, ends: np.ndarray, radius: float, *, hangs: bool) -> tuple[float, float]:
        """Return the distances of a capsule about a segment [m], shape (2, 3), from solids and, if
        it hangs, from zones [m]; inf where there is none, NaN for a capsule that is none.
        """
        if not (np.isfinite(ends).all() and math.isfinite(radius)):
            return math.nan, math.nan
        capsule = _capsule(ends, radius)
        solids, zones = (
            field.least(capsule) - ROUNDING if needed else math.inf
            for field, needed in zip(self._fields, (True, hangs), strict=True)
        )
        return solids, zones

    def nearest(self, ends: np.ndarray, radius: float, *, zones: bool) -> str:
        """Return the name of the solid, or zone, nearest to a capsule."""
        distances = self._fields[zones].distances(_capsule(ends, radius))
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
        if not (is_box(box) and distance >= 0.0 and 0.0 <= swing <= MAX_SWING):
            return False
        work = [(box, np.arange(bodies.radius.shape[1]))]
        examined = 0
        while work:
            box, capsules = work.pop()
            low, high = box[:, None].repeat(len(capsules), axis=1)
            cranes = np.full(len(capsules), crane)
            placed = place_capsules(bodies, cranes, capsules, low, high, swing)
            rows = zip(placed.ends, placed.radius.tolist(), capsules.tolist(), strict=True)
            hangs = bodies.hangs[crane].tolist()
            margins = np.array([self.margins(ends, r, hangs=hangs[c]) for ends, r, c in rows])
            margin = np.minimum(margins[:, 0] - distance, margins[:, 1])
            examined += 1
            # Each comparison is true for NaN.
            if not (margin >= 0.0).all() or examined > _MOST:
                return False
            near = ~(margin >= placed.motion.sum(axis=1))
            if near.any():
                widest = int(placed.motion.max(axis=0).argmax())
                for side in (0, 1):
                    halved = box.copy()
                    halved[side, widest] = box[:, widest].mean()
                    work.append((halved, capsules[near]))
        return True


def _capsule(ends: np.ndarray, radius: float) -> Placed:
    """Return a capsule about a segment [m], shape (2, 3), as a body for `Field`."""
    axis = ends[1] - ends[0]
    length = math.sqrt(axis @ axis)
    turn = pin.Quaternion.FromTwoVectors(_UP, axis) if length else pin.Quaternion.Identity()
    placed = coal.CollisionObject(
        coal.Capsule(radius, length), turn.toRotationMatrix(), (ends[0] + ends[1]) / 2.0
    )
    query = coal.DistanceCallBackDefault()
    return Placed(placed, 0.0, query, query.data.result)
