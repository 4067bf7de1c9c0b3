"""Shapes of crane and load at a place, in the frame of the site: those that distances are computed
from, and no other ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import shapely

from cranedyn.lifts.planning.chain_bodies import ChainBodies
from cranedyn.lifts.planning.clearance import Clearance
from cranedyn.lifts.planning.crane_bodies import CollisionBodies, corners_of

_THIN = 0.02
"""Half the width that a body has at least in a drawing [m]: a hull seen from its edge is a line."""


@dataclass(frozen=True, eq=False)
class CraneShapes:
    """Crane and load at a place; corners of convex bodies in the frame of the site [m], shape
    (n, 3) each.

    Attributes:
        standing: What never moves.
        moving: What drives move above the rope, such as jib, bridge, boom and trolley.
        hook: The box around the hook.
        load: The load.
        pivot: Upper end of the rope, shape (3,).
        centre: Centre of the load, shape (3,).
        axis: A point of the axis about which the crane turns, shape (3,); None if it does not.
    """

    standing: Sequence[np.ndarray]
    moving: Sequence[np.ndarray]
    hook: np.ndarray
    load: np.ndarray
    pivot: np.ndarray
    centre: np.ndarray
    axis: np.ndarray | None


def crane_shapes(clearance: Clearance, place: np.ndarray) -> CraneShapes:
    """Return crane and load at a place, shape (3,), with the load plumb."""
    crane = clearance.crane
    site = clearance.site
    q = clearance.q(place)
    data = crane.model.createData()
    pin.forwardKinematics(crane.model, data, q)

    def on_site(joint: int, corners: np.ndarray) -> np.ndarray:
        frame = data.oMi[joint + 1]
        return site.to_site(corners @ frame.rotation.T + frame.translation)

    bodies = clearance.bodies
    moving = []
    if isinstance(bodies, CollisionBodies):
        slew, trolley, *_ = crane.layout.tower("A drawing")
        for shape in bodies.upper:
            moving.append(on_site(slew, corners_of(shape)))
        moving.append(on_site(trolley, bodies.trolley.corners))
    else:
        assert isinstance(bodies, ChainBodies)
        for joint, link in bodies.links.items():
            for shape in link.shapes:
                moving.append(on_site(joint, corners_of(shape)))
    standing = [site.to_site(corners) for corners in clearance.standing]
    if site.base is not None:
        standing.append(site.to_site(site.base_corners))

    turning = clearance.turning
    axis = None
    if turning is not None:
        axis = on_site(int(clearance.drive_joints[turning]), np.zeros(3))
    return CraneShapes(
        standing=standing,
        moving=moving,
        hook=on_site(clearance.hoist, bodies.hook.corners),
        load=on_site(clearance.hoist, bodies.load),
        pivot=on_site(clearance.swing_joints[0], np.zeros(3)),
        centre=site.to_site(clearance.point(place)),
        axis=axis,
    )


def hull_of(points: np.ndarray) -> shapely.Polygon:
    """Return the convex hull of points of a drawing [m], shape (n, 2), as an area: what is seen
    from its edge is as wide as a thin line.
    """
    hull = shapely.MultiPoint(points).convex_hull
    return hull if hull.geom_type == "Polygon" else hull.buffer(_THIN, cap_style="flat")


def outlines_of(bodies: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return the outlines of the union of convex bodies that are seen in a drawing, shape (n, 2)
    each, from their corners there [m], shape (k, 2) each.
    """
    if not bodies:
        return []
    union = shapely.union_all([hull_of(corners) for corners in bodies])
    return rings_of(union)


def rings_of(area: shapely.Geometry) -> list[np.ndarray]:
    """Return the closed lines around an area and its holes, shape (n, 2) each; the first point is
    not repeated.
    """
    rings = []
    for part in shapely.get_parts(area):
        if part.geom_type != "Polygon":
            continue
        for ring in (part.exterior, *part.interiors):
            rings.append(np.array(ring.coords)[:-1, :2])
    return rings
