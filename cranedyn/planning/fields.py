"""Distances between obstacles at rest and bodies that move, by coal (Pan et al. 2012; Montaut et
al. 2024).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import coal
import numpy as np

from cranedyn.planning.bodies import Placed as Shape


class Placed(NamedTuple):
    """A body at its place.

    Attributes:
        moving: The shape there, inflated.
        inflated: By how much [m].
    """

    moving: coal.CollisionObject
    inflated: float

    @property
    def bare(self) -> coal.CollisionObject:
        """The shape without what it is inflated by: coal knows of no inflated shape beside a
        surface of triangles.
        """
        shape = self.moving.collisionGeometry().clone()
        shape.setSweptSphereRadius(0.0)
        return coal.CollisionObject(shape, self.moving.getTransform())


class Body:
    """A shape that moves, inflated by a distance on all sides. It is the same wherever it is put,
    so that threads may share it.

    Inflating is by coal's swept-sphere radius, which its bounding boxes and its distances both know
    of; a `security_margin` of a request is unknown to its broad phase.

    Attributes:
        shape: The shape, inflated.
        inflated: By how much it is inflated [m].
    """

    def __init__(self, placed: Shape, inflated: float) -> None:
        """Inflate a shape by a distance [m]; its rotation and translation are those in the frame
        that it moves with.
        """
        shape, rotation, translation = placed
        self.inflated, self.shape = inflated, shape.clone()
        self.shape.setSweptSphereRadius(inflated)
        self.shape.computeLocalAABB()
        self._within = coal.Transform3s(rotation, translation)

    @property
    def radius(self) -> float:
        """Farthest point from the Z axis of the frame that it moves with [m], at most."""
        centre = self._within.transform(self.shape.aabb_center)
        return float(np.linalg.norm(centre[:2])) + float(self.shape.aabb_radius)

    def put(self, frame: coal.Transform3s) -> Placed:
        """Return it with the frame that it moves with put somewhere."""
        moving = coal.CollisionObject(self.shape, frame * self._within, False)
        return Placed(moving, self.inflated)


def rope(frame: coal.Transform3s, radius: float, length: float, inflated: float) -> Placed:
    """Return a rope of a radius and a length [m] from the origin of a frame up along its Z axis,
    inflated by a distance [m].
    """
    shape = coal.Capsule(radius, length)
    shape.setSweptSphereRadius(inflated)
    middle = frame.getTranslation() + frame.getRotation()[:, 2] * (length / 2.0)
    return Placed(coal.CollisionObject(shape, frame.getRotation(), middle), inflated)


class Field:
    """Things that stand still, by name: shapes in one broad phase, surfaces of triangles in
    another.
    """

    def __init__(self, named: Sequence[tuple[str, Shape]]) -> None:
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

    def least(self, body: Placed) -> float:
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

    def each(self, body: Placed) -> dict[str, float]:
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

    def witnesses(self, body: Placed) -> Iterator[tuple[float, np.ndarray, np.ndarray, np.ndarray]]:
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
