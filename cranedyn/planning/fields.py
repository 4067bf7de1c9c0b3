"""Distances between obstacles at rest and bodies that move, by coal (Pan et al. 2012; Montaut et
al. 2024).
"""

from __future__ import annotations

import math
import threading
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import coal
import numpy as np


class Placed(NamedTuple):
    """A body at its place.

    Attributes:
        moving: The inflated shape at its place.
        inflated: Distance by which it is inflated [m].
        query, result: Memory of a query of its distance.
    """

    moving: coal.CollisionObject
    inflated: float
    query: coal.DistanceCallBackDefault
    result: coal.DistanceResult

    @property
    def bare(self) -> coal.CollisionObject:
        """The shape without inflation: coal ignores that beside a surface of triangles."""
        shape = self.moving.collisionGeometry().clone()
        shape.setSweptSphereRadius(0.0)
        return coal.CollisionObject(shape, self.moving.getTransform())


class Body(threading.local):
    """A shape that moves, inflated by a distance on all sides; each thread has one of its own.

    Inflation is by coal's swept-sphere radius, which both its bounding boxes and its distances
    respect; its broad phase ignores the `security_margin` of a request.

    Attributes:
        shape: The shape, inflated.
        inflated: Distance by which it is inflated [m].
    """

    def __init__(
        self, shape: coal.CollisionGeometry, inflated: float, within: coal.Transform3s | None = None
    ) -> None:
        """Inflate a shape by a distance [m], at a place within the frame that it moves with."""
        self.inflated, self.shape = inflated, shape.clone()
        self.shape.setSweptSphereRadius(inflated)
        self._within = within or coal.Transform3s()
        moving, query = coal.CollisionObject(self.shape), coal.DistanceCallBackDefault()
        self._placed = Placed(moving, inflated, query, query.data.result)

    @property
    def radius(self) -> float:
        """Farthest point from the Z axis of the frame that it moves with [m], at most."""
        centre = self._within.transform(self.shape.aabb_center)
        return float(np.linalg.norm(centre[:2])) + float(self.shape.aabb_radius)

    def put(self, frame: coal.Transform3s) -> Placed:
        """Return the body, moved with the frame that it moves with to a place."""
        self._placed.moving.setTransform(frame * self._within)
        self._placed.moving.computeAABB()
        return self._placed

    def stretch(self, length: float) -> None:
        """Let a capsule reach from the origin of its frame to a length [m] along its Z axis."""
        self.shape.halfLength = length / 2.0
        self.shape.computeLocalAABB()
        self._within.setTranslation(np.array([0.0, 0.0, length / 2.0]))


class Field:
    """Obstacles at rest, by name: shapes in one broad phase, surfaces of triangles in another."""

    def __init__(self, named: Iterable[tuple[str, coal.CollisionGeometry]]) -> None:
        """Take obstacles where their corners are."""
        self._objects: dict[bool, list[tuple[str, coal.CollisionObject]]] = {False: [], True: []}
        self._managers: dict[bool, coal.DynamicAABBTreeCollisionManager] = {}
        for name, geometry in named:
            shape = coal.CollisionObject(geometry)
            shape.computeAABB()
            self._objects[isinstance(geometry, coal.BVHModelBase)].append((name, shape))
        for surfaces, objects in self._objects.items():
            if objects:
                manager = self._managers[surfaces] = coal.DynamicAABBTreeCollisionManager()
                for _, shape in objects:
                    manager.registerObject(shape)
                manager.setup()

    @property
    def shape_counts(self) -> Counter[str]:
        """Number of shapes of each obstacle, by name."""
        return Counter(name for objects in self._objects.values() for name, _ in objects)

    def __len__(self) -> int:
        """Return the number of shapes."""
        return sum(map(len, self._objects.values()))

    def least(self, body: Placed) -> float:
        """Return the distance of an inflated body from the nearest obstacle [m], inf where there is
        none; zero or less where they touch.
        """
        nearest = math.inf
        for surfaces, manager in self._managers.items():
            body.query.init()
            manager.distance(body.bare if surfaces else body.moving, body.query)
            distance = float(body.result.min_distance)
            nearest = min(nearest, distance - body.inflated if surfaces else distance)
        return nearest

    def each(self, body: Placed) -> dict[str, float]:
        """Return the distance of an inflated body from each obstacle, by name [m]."""
        request, distances = coal.DistanceRequest(), dict[str, float]()
        for surfaces, objects in self._objects.items():
            moving, inflated = (body.bare, body.inflated) if surfaces else (body.moving, 0.0)
            for name, shape in objects:
                distance = float(coal.distance(moving, shape, request, coal.DistanceResult()))
                distances[name] = min(distances.get(name, math.inf), distance - inflated)
        return distances

    def witnesses(self, body: Placed) -> Iterator[tuple[float, np.ndarray, np.ndarray, np.ndarray]]:
        """Yield the distance of a body, not inflated, from each shape [m], the nearest points of
        both, and the unit vector from the shape to the body, shape (3,) each.
        """
        request = coal.DistanceRequest()
        for objects in self._objects.values():
            for _, shape in objects:
                result = coal.DistanceResult()
                distance = float(coal.distance(body.bare, shape, request, result))
                ours, theirs = result.getNearestPoint1(), result.getNearestPoint2()
                normal = (ours - theirs) / distance if distance > 1e-6 else -result.normal
                yield distance, ours, theirs, normal
