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
        self.inflated = inflated
        self.shape = shape.clone()
        self.shape.setSweptSphereRadius(inflated)
        self._within = within or coal.Transform3s()
        query = coal.DistanceCallBackDefault()
        self._placed = Placed(coal.CollisionObject(self.shape), inflated, query, query.data.result)

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
    """Obstacles at rest, by name: convex shapes in one broad phase, surfaces of triangles in
    another, since coal inflates bodies beside the former only.
    """

    def __init__(self, named: Iterable[tuple[str, coal.CollisionGeometry]]) -> None:
        """Take obstacles where their corners are.

        Args:
            named: Shapes, each with the name of its obstacle.
        """
        self._shapes: list[tuple[str, coal.CollisionObject]] = []
        self._surfaces: list[tuple[str, coal.CollisionObject]] = []
        for name, geometry in named:
            placed = coal.CollisionObject(geometry)
            placed.computeAABB()
            if isinstance(geometry, coal.BVHModelBase):
                self._surfaces.append((name, placed))
            else:
                self._shapes.append((name, placed))
        self._shape_manager = _broad_phase(self._shapes)
        self._surface_manager = _broad_phase(self._surfaces)

    @property
    def shape_counts(self) -> Counter[str]:
        """Number of shapes of each obstacle, by name."""
        return Counter(name for name, _ in (*self._shapes, *self._surfaces))

    def __len__(self) -> int:
        """Return the number of shapes."""
        return len(self._shapes) + len(self._surfaces)

    def least(self, body: Placed) -> float:
        """Return the distance of an inflated body from the nearest obstacle [m], inf where there is
        none; zero or less where they touch.
        """
        nearest = math.inf
        if self._shape_manager is not None:
            body.query.init()
            self._shape_manager.distance(body.moving, body.query)
            nearest = min(nearest, float(body.result.min_distance))
        if self._surface_manager is not None:
            body.query.init()
            self._surface_manager.distance(body.bare, body.query)
            nearest = min(nearest, float(body.result.min_distance) - body.inflated)
        return nearest

    def each(self, body: Placed) -> dict[str, float]:
        """Return the distance of an inflated body from each obstacle, by name [m]."""
        request = coal.DistanceRequest()
        distances: dict[str, float] = {}
        for name, shape in self._shapes:
            distance = float(coal.distance(body.moving, shape, request, coal.DistanceResult()))
            distances[name] = min(distances.get(name, math.inf), distance)
        bare = body.bare
        for name, surface in self._surfaces:
            from_bare = float(coal.distance(bare, surface, request, coal.DistanceResult()))
            distance = from_bare - body.inflated
            distances[name] = min(distances.get(name, math.inf), distance)
        return distances

    def witnesses(self, body: Placed) -> Iterator[tuple[float, np.ndarray, np.ndarray, np.ndarray]]:
        """Yield the distance of a body, not inflated, from each shape [m], the nearest points of
        both, and the unit vector from the shape to the body, shape (3,) each.
        """
        request = coal.DistanceRequest()
        for _, shape in (*self._shapes, *self._surfaces):
            result = coal.DistanceResult()
            distance = float(coal.distance(body.bare, shape, request, result))
            on_body = result.getNearestPoint1()
            on_shape = result.getNearestPoint2()
            # Where they touch, the two points are one and give no direction; coal's normal points
            # from the first of both to the second.
            normal = (on_body - on_shape) / distance if distance > 1e-6 else -result.normal
            yield distance, on_body, on_shape, normal


def _broad_phase(
    named: list[tuple[str, coal.CollisionObject]],
) -> coal.DynamicAABBTreeCollisionManager | None:
    """Return a tree of the bounding boxes of shapes, which finds the near ones; None if there is no
    shape.
    """
    if not named:
        return None
    manager = coal.DynamicAABBTreeCollisionManager()
    for _, shape in named:
        manager.registerObject(shape)
    manager.setup()
    return manager
