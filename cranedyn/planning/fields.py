"""Distances by coal (Pan et al. 2012; Montaut et al. 2024): sets of things that stand still, and
bodies that move among them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import coal
import numpy as np

from cranedyn.planning.bodies import Placed


class Body:
    """A shape that moves, inflated by a distance on all sides.

    Inflating is by coal's swept-sphere radius, which its bounding boxes and its distances both know
    of; a `security_margin` of a request is unknown to its broad phase.

    Attributes:
        shape: The shape.
        inflated: By how much it is inflated [m].
        moving: The shape at its place.
    """

    def __init__(self, placed: Placed, inflated: float) -> None:
        """Inflate a shape by a distance [m]; its rotation and translation are those in the frame
        that it moves with.
        """
        shape, rotation, translation = placed
        self.shape = shape.clone()
        self.inflated, self._bare = inflated, coal.CollisionObject(shape.clone())
        self.shape.setSweptSphereRadius(inflated)
        self.shape.computeLocalAABB()
        self.moving = coal.CollisionObject(self.shape)
        self._within = coal.Transform3s(rotation, translation)

    @property
    def radius(self) -> float:
        """Farthest point from the Z axis of the frame that it moves with [m], at most."""
        centre = self._within.transform(self.shape.aabb_center)
        return float(np.linalg.norm(centre[:2])) + float(self.shape.aabb_radius)

    @property
    def bare(self) -> coal.CollisionObject:
        """The shape at the same place without what it is inflated by: coal knows of no inflated
        shape beside a surface of triangles.
        """
        self._bare.setTransform(self.moving.getTransform())
        self._bare.computeAABB()
        return self._bare

    def put(self, frame: coal.Transform3s) -> Body:
        """Put the frame that it moves with somewhere."""
        self.moving.setTransform(frame * self._within)
        self.moving.computeAABB()
        return self


class Rope(Body):
    """A capsule whose length changes."""

    def __init__(self, radius: float, inflated: float) -> None:
        """A rope of a radius [m], inflated by a distance [m]."""
        super().__init__((coal.Capsule(radius, 1.0), np.eye(3), np.zeros(3)), inflated)

    @property
    def bare(self) -> coal.CollisionObject:
        """See `Body`."""
        self._bare = coal.CollisionObject(
            coal.Capsule(self.shape.radius, 2.0 * self.shape.halfLength)
        )
        return super().bare

    def along(self, frame: coal.Transform3s, length: float) -> Body:
        """Put it from the origin of a frame up along its Z axis, of a length [m]."""
        self.shape.halfLength = length / 2.0
        self.shape.computeLocalAABB()
        return self.put(frame * coal.Transform3s(np.array([0.0, 0.0, length / 2.0])))


class Field:
    """Things that stand still, by name: shapes in one broad phase, surfaces of triangles in
    another.
    """

    def __init__(self, named: Sequence[tuple[str, Placed]]) -> None:
        """Take the things at their places."""
        self._things: dict[bool, list[tuple[str, coal.CollisionObject]]] = {False: [], True: []}
        for name, (geometry, rotation, translation) in named:
            one = coal.CollisionObject(geometry, coal.Transform3s(rotation, translation))
            one.computeAABB()
            self._things[isinstance(geometry, coal.BVHModelBase)].append((name, one))
        self._managers = {
            kind: _manager([one for _, one in things])
            for kind, things in self._things.items()
            if things
        }

    def __len__(self) -> int:
        """How many things there are."""
        return sum(map(len, self._things.values()))

    def least(self, body: Body) -> float:
        """Distance of a body, inflated, from the nearest of them [m], inf where there is nothing;
        zero or less where it touches.
        """
        least = math.inf
        for surfaces, manager in self._managers.items():
            callback = coal.DistanceCallBackDefault()
            manager.distance(body.bare if surfaces else body.moving, callback)
            distance = float(callback.data.result.min_distance)
            least = min(least, distance - body.inflated if surfaces else distance)
        return least

    def each(self, body: Body) -> dict[str, float]:
        """Distance of a body, inflated, from all things of a name, by name [m]; one after the
        other, without the broad phase.
        """
        request, found = coal.DistanceRequest(), dict[str, float]()
        for surfaces, things in self._things.items():
            moving, inflated = (body.bare, body.inflated) if surfaces else (body.moving, 0.0)
            for name, one in things:
                distance = (
                    float(coal.distance(moving, one, request, coal.DistanceResult())) - inflated
                )
                found[name] = min(found.get(name, math.inf), distance)
        return found

    def witnesses(self, body: Body) -> Iterator[tuple[float, np.ndarray, np.ndarray, np.ndarray]]:
        """Distance of a body, not inflated, from each thing [m], the points of both that are
        nearest, and the unit vector from the thing to the body, shape (3,) each.
        """
        request = coal.DistanceRequest()
        for things in self._things.values():
            for _, one in things:
                found = coal.DistanceResult()
                distance = float(coal.distance(body.bare, one, request, found))
                ours, theirs = found.getNearestPoint1(), found.getNearestPoint2()
                apart = distance > 1e-6
                yield distance, ours, theirs, (ours - theirs) / distance if apart else -found.normal


def _manager(objects: Sequence[coal.CollisionObject]) -> coal.DynamicAABBTreeCollisionManager:
    made = coal.DynamicAABBTreeCollisionManager()
    for one in objects:
        made.registerObject(one)
    made.setup()
    return made
