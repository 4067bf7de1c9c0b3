"""Distances by coal (Pan et al. 2012; Montaut et al. 2024): sets of things that stand still, and bodies that move among them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import coal
import numpy as np

from cranedyn.planning.bodies import Placed


class Body:
    """A shape that moves, inflated by a distance on all sides.

    Inflating is by coal's swept-sphere radius, which its bounding boxes and its distances both know of; a `security_margin` of a request
    is unknown to its broad phase.

    Attributes:
        shape: The shape.
        moving: The shape at its place.
    """

    def __init__(self, placed: Placed, inflated: float) -> None:
        """Inflate a shape by a distance [m]; its rotation and translation are those in the frame that it moves with."""
        shape, self._rotation, self._translation = placed
        self.shape = shape.clone()
        self.shape.setSweptSphereRadius(inflated)
        self.shape.computeLocalAABB()
        self.moving = coal.CollisionObject(self.shape)
        self._upright = np.array_equal(self._rotation, np.eye(3))

    @property
    def radius(self) -> float:
        """Farthest point from the Z axis of the frame that it moves with [m], at most."""
        centre = self._rotation @ self.shape.aabb_center + self._translation
        return float(np.linalg.norm(centre[:2])) + float(self.shape.aabb_radius)

    def put(self, rotation: np.ndarray, translation: np.ndarray) -> coal.CollisionObject:
        """Put the frame that it moves with somewhere."""
        turned = rotation if self._upright else rotation @ self._rotation
        self.moving.setTransform(coal.Transform3s(turned, rotation @ self._translation + translation))
        self.moving.computeAABB()
        return self.moving


class Rope(Body):
    """A capsule whose length changes."""

    def __init__(self, radius: float, inflated: float) -> None:
        """A rope of a radius [m], inflated by a distance [m]."""
        super().__init__((coal.Capsule(radius, 1.0), np.eye(3), np.zeros(3)), inflated)

    def between(self, rotation: np.ndarray, one: np.ndarray, other: np.ndarray) -> coal.CollisionObject:
        """Put it from a point to another [m] along the Z axis of a rotation."""
        self.shape.halfLength = math.dist(one, other) / 2.0
        self.shape.computeLocalAABB()
        return self.put(rotation, (one + other) / 2.0)


class Field:
    """Things that stand still, by name, in one broad phase."""

    def __init__(self, named: Sequence[tuple[str, Placed]]) -> None:
        """Take the things at their places."""
        self._objects, self._names = [], [name for name, _ in named]
        self._manager = coal.DynamicAABBTreeCollisionManager()
        for _, (geometry, rotation, translation) in named:
            one = coal.CollisionObject(geometry, coal.Transform3s(rotation, translation))
            one.computeAABB()
            self._objects.append(one)
            self._manager.registerObject(one)
        self._manager.setup()

    def __len__(self) -> int:
        """How many things there are."""
        return len(self._objects)

    def least(self, moving: coal.CollisionObject) -> float:
        """Distance of a body from the nearest of them [m], inf where there is nothing; zero or less where it touches."""
        if not self._objects:
            return math.inf
        callback = coal.DistanceCallBackDefault()
        self._manager.distance(moving, callback)
        return float(callback.data.result.min_distance)

    def each(self, moving: coal.CollisionObject) -> dict[str, float]:
        """Distance of a body from all things of a name, by name [m]; one after the other, without the broad phase."""
        request, found = coal.DistanceRequest(), dict.fromkeys(self._names, math.inf)
        for one, name in zip(self._objects, self._names, strict=True):
            found[name] = min(found[name], float(coal.distance(moving, one, request, coal.DistanceResult())))
        return found
