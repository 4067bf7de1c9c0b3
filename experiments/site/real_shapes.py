"""Distances of cranes of a site by the shapes of their descriptions.

What keeps cranes apart, and what counts their contacts, measures by capsules that it puts around
these shapes. A fault in the capsules would go unseen by both: here is a measure that knows none.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from cranedyn.lifts.sites.crane_site import Station
from cranedyn.lifts.sites.site_simulation import SiteRun

INTERVAL = 100
"""Rows between two that are measured whatever the distance is."""

NEAREST_ROWS = 40
"""Rows of each pair that are measured since the capsules are nearest there."""

ROPE_RADIUS = 0.005
"""Radius of a rope [m]."""


class RealDistances(NamedTuple):
    """Distances of all pairs of cranes in a run by their real shapes.

    Attributes:
        instants: Number of instants of a pair that were measured.
        least: Least distance [m]; not positive where shapes overlap.
        overlaps: Number of instants in which shapes overlap.
        uncounted: Number of these before the first contact that was counted for the pair.
        excess: Largest distance by capsules less that by shapes [m]; not positive where all shapes
            lie in their capsules.
    """

    instants: int
    least: float
    overlaps: int
    uncounted: int
    excess: float


class _ShapesOfCrane:
    """The shapes of a crane, and its rope, at its coordinates."""

    def __init__(self, station: Station) -> None:
        crane = station.crane
        self._station = station
        self._data = crane.model.createData()
        self._load = int(crane.layout.drives[crane.winch]) + 1
        self._pivot = int(crane.swings[0]) + 1
        self._foot = pin.SE3(station.bodies.foot[:, :3], station.bodies.foot[:, 3])
        self._shapes = []
        for kind in (pin.GeometryType.VISUAL, pin.GeometryType.COLLISION):
            described = pin.buildGeomFromUrdfString(crane.model, crane.urdf, kind)
            for shape in described.geometryObjects:
                placed = coal.CollisionObject(shape.geometry)
                self._shapes.append((placed, int(shape.parentJoint), shape.placement))

    def placed(self, q: np.ndarray, *, with_standing: bool) -> coal.DynamicAABBTreeCollisionManager:
        """Return shapes at coordinates, shape (n,), in the frame of the site: all, or those that
        move.
        """
        pin.forwardKinematics(self._station.crane.model, self._data, q)
        manager = coal.DynamicAABBTreeCollisionManager()
        for shape, joint, placement in self._shapes:
            if joint == 0 and not with_standing:
                continue
            pose = self._foot * self._data.oMi[joint] * placement
            shape.setTransform(coal.Transform3s(pose.rotation, pose.translation))
            shape.computeAABB()
            manager.registerObject(shape)
        self._rope = self._placed_rope()
        manager.registerObject(self._rope)
        manager.setup()
        return manager

    def _placed_rope(self) -> coal.CollisionObject:
        ends = [self._foot.act(self._data.oMi[i].translation) for i in (self._pivot, self._load)]
        along = ends[1] - ends[0]
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along).toRotationMatrix()
        rope = coal.CollisionObject(coal.Capsule(ROPE_RADIUS, float(np.linalg.norm(along))))
        rope.setTransform(coal.Transform3s(turn, (ends[0] + ends[1]) / 2.0))
        rope.computeAABB()
        return rope


def real_distances(run: SiteRun) -> RealDistances:
    """Measure a run by the shapes of its cranes: each pair at regular instants, and at those at
    which its capsules are nearest.
    """
    stations = run.site.stations
    cranes = [_ShapesOfCrane(station) for station in stations]
    instants = 0
    overlaps = 0
    uncounted = 0
    least = math.inf
    excess = -math.inf
    for k, (i, j) in enumerate(itertools.combinations(range(len(cranes)), 2)):
        names = stations[i].name, stations[j].name
        # A bridge rests on the runway that it shares with another one.
        with_standing = not run.site.share_runway(i, j)
        times = [x.t for x in run.contacts if (x.first, x.second) == names]
        first_contact = min(times, default=math.inf)
        nearest = np.argsort(run.distances[:, k], kind="stable")[:NEAREST_ROWS]
        for row in np.union1d(nearest, np.arange(0, len(run.t), INTERVAL)).tolist():
            placed = []
            for c in (i, j):
                q = run.trajectories[c].q[row]
                placed.append(cranes[c].placed(q, with_standing=with_standing))
            query = coal.DistanceCallBackDefault()
            placed[0].distance(placed[1], query)
            distance = float(query.data.result.min_distance)
            instants += 1
            least = min(least, distance)
            # Capsules that overlap have a depth, which shapes that overlap need not have.
            excess = max(excess, float(run.distances[row, k]) - max(distance, 0.0))
            if distance <= 0.0:
                overlaps += 1
                uncounted += int(run.t[row] < first_contact)
    return RealDistances(instants, least, overlaps, uncounted, excess)
