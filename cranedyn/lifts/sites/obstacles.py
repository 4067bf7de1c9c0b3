"""Obstacles of a site with several cranes: distances of capsules from them, and the proof that a
crane keeps from them wherever it is in intervals of its positions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from cranedyn.lifts.planning.clearance import ROUNDING
from cranedyn.lifts.planning.fields import Field, Placed
from cranedyn.lifts.planning.solids import Solid
from cranedyn.lifts.sites.distance_proof import MAX_SWING, is_box
from cranedyn.lifts.sites.placed_capsules import CraneBodies, PlacedCapsules, place_capsules

_MAX_EXAMINED = 30
"""Boxes that a proof examines before it fails."""

_CAPSULE_AXIS = np.array([0.0, 0.0, 1.0])
"""Axis of a capsule of Coal in its own frame."""


class ObstacleMargins(NamedTuple):
    """Distances of a capsule from obstacles.

    Attributes:
        from_solids: Distance from the nearest solid [m]; inf where there is none.
        from_zones: Distance from the nearest zone [m]; inf where there is none, and for a capsule
            that may be in zones.
    """

    from_solids: float
    from_zones: float


class _BoxToExamine(NamedTuple):
    """A box of positions, and the capsules that are not proven clear in it yet.

    Attributes:
        box: Ends of the intervals, shape (2, k + 1), the cable length last.
        capsules: Indices of the capsules, shape (capsules,).
    """

    box: np.ndarray
    capsules: np.ndarray


class Obstacles:
    """Solids that all parts of cranes keep from, and zones that ropes and loads keep out of."""

    def __init__(self, solids: Sequence[Solid]) -> None:
        """Take solids and zones in the frame of the site."""
        self._solids = _field([solid for solid in solids if not solid.zone])
        self._zones = _field([solid for solid in solids if solid.zone])

    def margins(self, ends: np.ndarray, radius: float, *, hangs: bool) -> ObstacleMargins:
        """Return the distances of a capsule from solids and zones; both are NaN if a number of the
        capsule is not finite.

        Args:
            ends: Ends of its segment [m], shape (2, 3).
            radius: Its radius [m].
            hangs: Whether it is of a rope or a load, which keep out of zones.
        """
        if not (np.isfinite(ends).all() and math.isfinite(radius)):
            return ObstacleMargins(math.nan, math.nan)
        capsule = _capsule(ends, radius)
        from_solids = self._solids.least(capsule) - ROUNDING
        from_zones = self._zones.least(capsule) - ROUNDING if hangs else math.inf
        return ObstacleMargins(from_solids, from_zones)

    def nearest(self, ends: np.ndarray, radius: float, *, zones: bool) -> str:
        """Return the name of the solid, or zone, nearest to a capsule; see `margins`."""
        field = self._zones if zones else self._solids
        distances = field.distances(_capsule(ends, radius))
        return min(distances, key=lambda name: distances[name])

    def proven_clear(
        self, bodies: CraneBodies, crane: int, box: np.ndarray, distance: float, swing: float
    ) -> bool:
        """Return whether no position of a crane in a box brings it nearer to a solid than a
        distance, or rope and load into a zone.

        In the middle of a box each capsule has a margin. Where that is no less than the sum of all
        shifts by which the joints can move the capsule from there, the capsule is clear in all of
        the box. For the other capsules the box is halved along the joint that moves one of them
        most. The interval of the cable length is never halved: ropes and loads are swept over it.

        Args:
            bodies: The cranes, `stacked`.
            crane: Index of the crane.
            box: Ends of its intervals, shape (2, k + 1), the cable length last.
            distance: Required distance [m].
            swing: Largest angle of the rope from plumb [rad].
        """
        if not (is_box(box) and distance >= 0.0 and 0.0 <= swing <= MAX_SWING):
            return False
        remaining = [_BoxToExamine(box, np.arange(bodies.radius.shape[1]))]
        examined = 0
        while remaining:
            box, capsules = remaining.pop()
            low, high = box[:, None].repeat(len(capsules), axis=1)
            cranes = np.full(len(capsules), crane)
            placed = place_capsules(bodies, cranes, capsules, low, high, swing)
            hangs = bodies.hangs[crane, capsules]
            spare = self._spare(placed, hangs, distance)
            examined += 1
            # Each comparison is written so that NaN counts as too near. Where a capsule is too near
            # in the middle of the box, no halving helps.
            if not (spare >= 0.0).all() or examined > _MAX_EXAMINED:
                return False
            near = ~(spare >= placed.motion.sum(axis=1))
            if near.any():
                joint = int(placed.motion.max(axis=0).argmax())
                for end in (0, 1):
                    halved = box.copy()
                    halved[end, joint] = box[:, joint].mean()
                    remaining.append(_BoxToExamine(halved, capsules[near]))
        return True

    def _spare(self, placed: PlacedCapsules, hangs: np.ndarray, distance: float) -> np.ndarray:
        """Return by how much each of N capsules is farther from solids than a distance, or farther
        out of zones, whichever is less [m], shape (N,).

        Args:
            placed: The capsules.
            hangs: Whether each of them hangs, shape (N,).
            distance: Required distance from solids [m].
        """
        spare = []
        for ends, radius, hangs_on_rope in zip(
            placed.ends, placed.radius.tolist(), hangs.tolist(), strict=True
        ):
            margins = self.margins(ends, radius, hangs=hangs_on_rope)
            spare.append(np.minimum(margins.from_solids - distance, margins.from_zones))
        return np.array(spare)


def _field(solids: Sequence[Solid]) -> Field:
    """Return what measures distances from solids, each by its name."""
    named = []
    for solid in solids:
        named += [(solid.name, shape) for shape in solid.geometries()]
    return Field(named)


def _capsule(ends: np.ndarray, radius: float) -> Placed:
    """Return a capsule about a segment [m], shape (2, 3), as a body for `Field`."""
    axis = ends[1] - ends[0]
    length = math.sqrt(axis @ axis)
    # A segment without a length has no direction, and its capsule is a ball.
    rotation = pin.Quaternion.Identity()
    if length:
        rotation = pin.Quaternion.FromTwoVectors(_CAPSULE_AXIS, axis)
    centre = (ends[0] + ends[1]) / 2.0
    placed = coal.CollisionObject(coal.Capsule(radius, length), rotation.toRotationMatrix(), centre)
    query = coal.DistanceCallBackDefault()
    return Placed(placed, 0.0, query, query.data.result)
