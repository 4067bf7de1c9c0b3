"""Distances measured a second time, in another way, beside those that a plan rests on.

Plan and proof share the shapes and distances of `cranedyn.planning.clearance`. If these were wrong,
a load of half its size for instance, plan and proof would be wrong alike and agree. This module
shares with them the site and Pinocchio's kinematics, and neither shapes nor the library of
distances: it takes points of the load as the site enters it, and of the rope, and measures how far
each is from the triangles of the obstacles.

A sample of points can only overestimate the distance of a body. Where it is less than what a proof
claims, the proof is wrong. It proves nothing itself: it misses an edge of the load that passes the
corner of an obstacle between two points.
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from cranedyn.model.crane import Crane
from cranedyn.planning.bodies import shape_corners
from cranedyn.planning.clearance import Nearest
from cranedyn.planning.site import GROUND, Site
from cranedyn.planning.solids import Solid

ROPE_POINTS = 12
"""Points of the rope that are measured."""

SWING_DIRECTIONS = 8
"""Directions into which the load is swung."""

_CHUNK = 200_000
"""Pairs of a point and a triangle that are measured at once."""


def second_look(
    site: Site, crane: Crane, q: np.ndarray, beyond: float, *, swing: float = 0.0
) -> Nearest:
    """Return the nearest point of load or rope to a solid or the ground, of all rows.

    Args:
        site: The site.
        crane: A tower crane.
        q: Coordinates, shape (rows, n).
        beyond: Distance from which on a point is not measured [m]; the distance returned is this,
            with no names, where no point is nearer.
        swing: Angle by which the rope is swung from its direction in each row, into
            `SWING_DIRECTIONS` directions [rad]; 0 to leave it.
    """
    points, names = _hanging_points(site, crane, _swung(crane, q, swing))
    points = points.reshape(-1, 3)
    names = np.tile(names, len(points) // len(names))
    found = Nearest(beyond, "", "")
    level = site.ground - float(site.foot[2])
    lowest = int(points[:, 2].argmin())
    if points[lowest, 2] - level < found.distance:
        found = Nearest(float(points[lowest, 2]) - level, str(names[lowest]), GROUND)
    for solid in site.seen_by_crane():
        if solid.zone:
            continue
        low, high = solid.vertices.min(axis=0), solid.vertices.max(axis=0)
        outside = np.maximum(np.maximum(low - points, points - high), 0.0)
        near = np.flatnonzero(np.linalg.norm(outside, axis=1) < found.distance)
        if not len(near):
            continue
        distances = point_distances(points[near], solid)
        nearest = int(distances.argmin())
        if distances[nearest] < found.distance:
            body = str(names[near[nearest]])
            found = Nearest(float(distances[nearest]), body, solid.name)
    return found


def point_distances(points: np.ndarray, solid: Solid) -> np.ndarray:
    """Return the distances of points [m], shape (n, 3), from a solid; 0 inside of it; in [m], shape
    (n,).
    """
    import trimesh

    corners = solid.vertices[solid.triangles]
    distances = np.full(len(points), math.inf)
    rows = max(_CHUNK // len(corners), 1)
    for first in range(0, len(points), rows):
        some = points[first : first + rows]
        pairs = np.repeat(some, len(corners), axis=0)
        closest = trimesh.triangles.closest_point(np.tile(corners, (len(some), 1, 1)), pairs)
        lengths = np.linalg.norm(closest - pairs, axis=1).reshape(len(some), -1)
        distances[first : first + rows] = lengths.min(axis=1)
    inside = np.zeros(len(points), dtype=bool)
    for part in solid.parts:
        planes = ConvexHull(part).equations
        inside |= (points @ planes[:, :3].T + planes[:, 3] <= 0.0).all(axis=1)
    if not solid.parts:
        low, high = solid.vertices.min(axis=0), solid.vertices.max(axis=0)
        for i in np.flatnonzero(((low < points) & (points < high)).all(axis=1)):
            inside[i] = solid.holds(points[i])
    return np.where(inside, 0.0, distances)


def _swung(crane: Crane, q: np.ndarray, swing: float) -> np.ndarray:
    """Return coordinates, shape (k, n), with the rope swung into all directions."""
    if swing == 0.0:
        return q
    _, _, radial, tangential, _ = crane.layout.tower("A measurement of distances")
    around = np.linspace(0.0, 2.0 * math.pi, SWING_DIRECTIONS, endpoint=False)
    swung = np.repeat(q, SWING_DIRECTIONS, axis=0)
    swung[:, radial] += np.tile(swing * np.cos(around), len(q))
    swung[:, tangential] += np.tile(swing * np.sin(around), len(q))
    return swung


def _hanging_points(site: Site, crane: Crane, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return points of load and rope in the crane's frame [m], shape (rows, points, 3), and the
    body of each point, shape (points,).
    """
    _, _, radial, _, hoist = (joint + 1 for joint in crane.layout.tower("A measurement"))
    load = site.load
    if load is None:
        carried = [corners for joint, corners in shape_corners(crane) if joint == hoist]
        load = np.concatenate(carried)
    if len(load) > 8:
        load = load[ConvexHull(load).vertices]
    data = crane.model.createData()
    share = np.linspace(0.0, 1.0, ROPE_POINTS)[:, None]
    rows = np.empty((len(q), len(load) + ROPE_POINTS, 3))
    for row, coordinates in enumerate(q):
        pin.forwardKinematics(crane.model, data, coordinates)
        pivot, end = data.oMi[radial].translation, data.oMi[hoist]
        rows[row, : len(load)] = load @ end.rotation.T + end.translation
        rows[row, len(load) :] = pivot + share * (end.translation - pivot)
    return rows, np.array(["load"] * len(load) + ["rope"] * ROPE_POINTS)
