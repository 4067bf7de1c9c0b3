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

_TOUCHING = 1e-6
"""Distance of two shapes up to which they touch, and their nearest points give no direction [m]. It
is the tolerance of coal."""


class Placed(NamedTuple):
    """A body at its place.

    Attributes:
        moving: The inflated shape at its place.
        inflated: Distance by which it is inflated [m].
        query: Question for its distance to the broad phase, used again and again.
        result: Where coal puts the answer to it.
    """

    moving: coal.CollisionObject
    inflated: float
    query: coal.DistanceCallBackDefault
    result: coal.DistanceResult

    @property
    def without_inflation(self) -> coal.CollisionObject:
        """The shape at its place, not inflated, for distances from surfaces of triangles: there
        coal ignores the inflation.
        """
        shape = self.moving.collisionGeometry().clone()
        shape.setSweptSphereRadius(0.0)
        return coal.CollisionObject(shape, self.moving.getTransform())


class PointPair(NamedTuple):
    """Nearest points of a body and a shape.

    Attributes:
        distance: Their distance [m], the body not inflated.
        on_body: The point of the body [m], shape (3,).
        on_shape: The point of the shape [m], shape (3,).
        normal: Unit vector from the shape to the body, shape (3,).
    """

    distance: float
    on_body: np.ndarray
    on_shape: np.ndarray
    normal: np.ndarray


class Body(threading.local):
    """A shape that moves, inflated by a distance on all sides.

    Each thread has a copy of its own: Python calls `__init__` again, with the same arguments, where
    a thread first uses the body.

    Inflation is by coal's swept-sphere radius, which both its bounding boxes and its distances
    respect; its broad phase ignores the `security_margin` of a request.

    Attributes:
        shape: The shape, inflated.
        inflated: Distance by which it is inflated [m].
    """

    def __init__(
        self, shape: coal.CollisionGeometry, inflated: float, within: coal.Transform3s | None = None
    ) -> None:
        """Copy and inflate a shape.

        Args:
            shape: The shape.
            inflated: Distance by which it is inflated [m].
            within: Its place in the frame that it moves with; None for the origin.
        """
        self.inflated = inflated
        self.shape = shape.clone()
        self.shape.setSweptSphereRadius(inflated)
        self._within = within or coal.Transform3s()
        query = coal.DistanceCallBackDefault()
        self._placed = Placed(coal.CollisionObject(self.shape), inflated, query, query.data.result)

    @property
    def radius(self) -> float:
        """Upper bound of the distance of its points from the Z axis of the frame that it moves with
        [m], not inflated.
        """
        centre = self._within.transform(self.shape.aabb_center)
        return float(np.linalg.norm(centre[:2])) + float(self.shape.aabb_radius)

    def put(self, frame: coal.Transform3s) -> Placed:
        """Return the body where it is if the frame that it moves with is at a place."""
        self._placed.moving.setTransform(frame * self._within)
        self._placed.moving.computeAABB()
        return self._placed

    def stretch(self, length: float) -> None:
        """Let a capsule reach from the origin of its frame to a length [m] along its Z axis."""
        self.shape.halfLength = length / 2.0
        self.shape.computeLocalAABB()
        self._within.setTranslation(np.array([0.0, 0.0, length / 2.0]))


class Field:
    """Obstacles at rest, by name. Convex shapes are in one broad phase and surfaces of triangles in
    another, since coal measures inflated bodies only against the former.
    """

    def __init__(self, named: Iterable[tuple[str, coal.CollisionGeometry]]) -> None:
        """Take obstacles, at rest where their corners are.

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
        """Return the distance of an inflated body from the nearest obstacle [m]: zero or less where
        they touch, and infinite if there is no obstacle.
        """
        nearest = math.inf
        if self._shape_manager is not None:
            body.query.init()
            self._shape_manager.distance(body.moving, body.query)
            nearest = min(nearest, float(body.result.min_distance))
        if self._surface_manager is not None:
            body.query.init()
            self._surface_manager.distance(body.without_inflation, body.query)
            nearest = min(nearest, float(body.result.min_distance) - body.inflated)
        return nearest

    def distances(self, body: Placed) -> dict[str, float]:
        """Return the distance of an inflated body from each obstacle [m], by name."""
        request = coal.DistanceRequest()
        distances: dict[str, float] = {}
        for name, shape in self._shapes:
            distance = float(coal.distance(body.moving, shape, request, coal.DistanceResult()))
            distances[name] = min(distances.get(name, math.inf), distance)
        not_inflated = body.without_inflation
        for name, surface in self._surfaces:
            plain = float(coal.distance(not_inflated, surface, request, coal.DistanceResult()))
            distance = plain - body.inflated
            distances[name] = min(distances.get(name, math.inf), distance)
        return distances

    def nearest_points(self, body: Placed) -> Iterator[PointPair]:
        """Yield the nearest points of a body, not inflated, and each shape."""
        request = coal.DistanceRequest()
        for _, shape in (*self._shapes, *self._surfaces):
            result = coal.DistanceResult()
            distance = float(coal.distance(body.without_inflation, shape, request, result))
            on_body = result.getNearestPoint1()
            on_shape = result.getNearestPoint2()
            # Where they touch, the two points are one and give no direction; coal's normal points
            # from the first of both to the second.
            if distance > _TOUCHING:
                normal = (on_body - on_shape) / distance
            else:
                normal = -result.normal
            yield PointPair(distance, on_body, on_shape, normal)


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
