"""Distances measured a second time, in another way, beside those that a plan rests on.

Plan and proof share the shapes and distances of `cranedyn.lifts.planning.clearance`. If these were
wrong, a load of half its size for instance, plan and proof would be wrong alike and agree. This
module shares with them the site, the solids as they were read, Pinocchio's kinematics and, for a
site without a load, the corners of the shapes in the URDF. It shares neither their collision bodies
nor the library of distances: it takes points of the load as the site enters it, and of the rope,
and measures how far each is from the triangles of the obstacles.

A sample of points can only overestimate the distance of a body. Where it is less than what a proof
claims, the proof is wrong. It proves nothing itself: it misses an edge of the load that passes the
corner of an obstacle between two points.
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from cranedyn.command import uninterrupted_import
from cranedyn.lifts.planning.clearance import Nearest
from cranedyn.lifts.planning.crane_bodies import hook_turn, shape_corners
from cranedyn.lifts.planning.site import GROUND, Site
from cranedyn.lifts.planning.solids import Solid
from cranedyn.model.crane import Crane

ROPE_POINTS = 12
"""Points of the rope that are measured."""

SWING_DIRECTIONS = 8
"""Directions into which the load is swung."""

_PAIRS_AT_ONCE = 200_000
"""Pairs of a point and a triangle that are measured at once, so that they fit into memory."""


def second_look(
    site: Site, crane: Crane, q: np.ndarray, beyond: float, *, swing: float = 0.0
) -> Nearest:
    """Return the nearest point of load or rope to a solid or the ground, of all rows. Zones are
    left out, since no distance from them is required.

    Args:
        site: The site.
        crane: A crane whose load hangs on two swing joints at one point.
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
        # Only points whose distance from the box around the solid is less than the least so far
        # can be nearer to it.
        low = solid.vertices.min(axis=0)
        high = solid.vertices.max(axis=0)
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
    trimesh = uninterrupted_import("trimesh")
    corners = solid.vertices[solid.triangles]
    distances = np.full(len(points), math.inf)
    points_at_once = max(_PAIRS_AT_ONCE // len(corners), 1)
    for first in range(0, len(points), points_at_once):
        chunk = slice(first, first + points_at_once)
        some = points[chunk]
        repeated = np.repeat(some, len(corners), axis=0)
        triangles = np.tile(corners, (len(some), 1, 1))
        closest = trimesh.triangles.closest_point(triangles, repeated)
        lengths = np.linalg.norm(closest - repeated, axis=1).reshape(len(some), -1)
        distances[chunk] = lengths.min(axis=1)
    inside = _are_inside(points, solid)
    return np.where(inside, 0.0, distances)


def _are_inside(points: np.ndarray, solid: Solid) -> np.ndarray:
    """Return whether points [m], shape (n, 3), are inside of a solid, shape (n,)."""
    inside = np.zeros(len(points), dtype=bool)
    for part in solid.parts:
        # Rows of Qhull are the outward normal n and the offset d of a plane: n·x + d ≤ 0 inside.
        planes = ConvexHull(part).equations
        inside |= (points @ planes[:, :3].T + planes[:, 3] <= 0.0).all(axis=1)
    if not solid.parts:
        low = solid.vertices.min(axis=0)
        high = solid.vertices.max(axis=0)
        in_box = ((low < points) & (points < high)).all(axis=1)
        for i in np.flatnonzero(in_box):
            inside[i] = solid.surface_encloses(points[i])
    return inside


def _swung(crane: Crane, q: np.ndarray, swing: float) -> np.ndarray:
    """Return coordinates with the rope swung by an angle [rad] into all directions, shape (rows
    times directions, n); the same coordinates for the angle 0.
    """
    if swing == 0.0:
        return q
    first, second = crane.swings
    around = np.linspace(0.0, 2.0 * math.pi, SWING_DIRECTIONS, endpoint=False)
    swung = np.repeat(q, SWING_DIRECTIONS, axis=0)
    swung[:, first] += np.tile(swing * np.cos(around), len(q))
    swung[:, second] += np.tile(swing * np.sin(around), len(q))
    return swung


def _hanging_points(site: Site, crane: Crane, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return points of load and rope in the crane's frame [m], shape (rows, points, 3), and the
    body of each point, shape (points,).

    A site without a load lifts the one in the crane's URDF. All shapes of its link are then taken
    for the load, the hook among them; the hook above a load of the site is not measured.
    """
    pivot_joint = int(crane.swings[0]) + 1  # Pinocchio counts joints from 1; 0 is the world
    load_joint = crane.payload.body + 1
    if site.load is not None:
        load = site.load @ hook_turn(crane)  # along the axes of the joint
    else:
        carried = [corners for joint, corners in shape_corners(crane) if joint == load_joint]
        load = np.concatenate(carried)
    if len(load) > 8:  # more than a box has: those inside of the hull are never the nearest
        load = load[ConvexHull(load).vertices]
    data = crane.model.createData()
    share = np.linspace(0.0, 1.0, ROPE_POINTS)[:, None]
    rows = np.empty((len(q), len(load) + ROPE_POINTS, 3))
    for row, coordinates in enumerate(q):
        pin.forwardKinematics(crane.model, data, coordinates)
        pivot = data.oMi[pivot_joint].translation
        end = data.oMi[load_joint]
        rows[row, : len(load)] = load @ end.rotation.T + end.translation
        rows[row, len(load) :] = pivot + share * (end.translation - pivot)
    return rows, np.array(["load"] * len(load) + ["rope"] * ROPE_POINTS)
