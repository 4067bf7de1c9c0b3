"""Bodies of a crane from the shapes in its URDF: mast, upper structure, trolley, rope, hook and
load; and all of a crane that is parked on a site, as an obstacle.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import coal
import numpy as np
import pinocchio as pin

from cranedyn.errors import ModelError
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.planning.solids import Solid, convex_hull, rotation_z

Shape = tuple[coal.CollisionGeometry, np.ndarray, np.ndarray]
"""A shape with its rotation and translation in the frame of the joint that carries it."""


@dataclass(frozen=True, eq=False)
class CollisionBodies:
    """Bodies of a crane, each in the frame of the joint that carries it.

    Attributes:
        mast: Corners of the hulls of the mast and its foot [m], shape (n, 3) each.
        upper: Shapes that slew, jib and counter-jib among them.
        trolley: The box around the trolley: centre and size [m].
        hook: The box around the hook, above the load: centre and size [m].
        load: Corners of the load about the end of the cable [m], shape (n, 3).
        falls: Radius about the cable's axis within which the falls of the rope run [m]: half the
            width of the hook's block.
    """

    mast: list[np.ndarray]
    upper: list[Shape]
    trolley: tuple[np.ndarray, np.ndarray]
    hook: tuple[np.ndarray, np.ndarray]
    load: np.ndarray
    falls: float

    @cached_property
    def spread(self) -> float:
        """Largest distance of trolley, rope, hook or load from the plumb line [m]."""
        boxes = [np.abs(centre[:2]) + size[:2] / 2.0 for centre, size in (self.trolley, self.hook)]
        load = np.linalg.norm(self.load[:, :2], axis=1).max()
        return float(max(self.falls, *map(np.hypot.reduce, boxes), load))

    @cached_property
    def below(self) -> float:
        """Largest distance of a point of the load from the end of the cable [m]: no point is
        farther from the pivot than l and this.
        """
        return float(np.linalg.norm(self.load, axis=1).max())


def collision_bodies(crane: Crane, load: np.ndarray | None = None) -> CollisionBodies:
    """Return the bodies of a crane from the boxes, cylinders and spheres in its URDF.

    The largest shape of the link at the hook is the load, those above it are the hook.

    Args:
        crane: The crane.
        load: Corners of another load about the end of the cable [m], shape (n, 3); the hook then
            stands on top of it.

    Raises:
        MissingRole: If it is not a tower crane.
        ModelError: If it moves in other joints, too, or the URDF shows a mesh, or no shapes where
            one is needed.
    """
    slew, trolley, radial, tangential, hoist = (
        joint + 1 for joint in crane.layout.tower("Clearance")
    )
    carriers = {
        "mast": [0],
        "upper structure": [slew],
        "trolley": [trolley, radial, tangential],
        "payload": [hoist],
    }
    shapes = _shapes(crane)
    groups = {
        name: [shape for joint in joints for shape in shapes.get(joint, [])]
        for name, joints in carriers.items()
    }
    for name in ("upper structure", "trolley", "payload"):
        if not groups[name]:
            raise ModelError(
                f"The URDF of the crane shows no shapes of its {name}; clearance needs boxes, "
                "cylinders or spheres."
            )
    corners = [corners_of(shape) for shape in groups["payload"]]
    largest = max(corners, key=lambda points: float(np.prod(np.ptp(points, axis=0))))
    top = float(largest[:, 2].max())
    above = [points for points in corners if points[:, 2].mean() > top]
    if not above:
        raise ModelError(
            "The URDF of the crane shows no hook above its load, so that the width of the rope is "
            "not known."
        )
    block = max(above, key=lambda points: float(points[:, 2].max()))
    carried = largest if load is None else load
    hook = np.concatenate(above) + np.array([0.0, 0.0, float(carried[:, 2].max()) - top])
    return CollisionBodies(
        mast=_mast(groups["mast"]),
        upper=groups["upper structure"],
        trolley=_box(np.concatenate([corners_of(shape) for shape in groups["trolley"]])),
        hook=_box(hook),
        load=carried,
        falls=float(np.ptp(block[:, :2], axis=0).max()) / 2.0,
    )


def _mast(shapes: list[Shape]) -> list[np.ndarray]:
    """Return the corners of two hulls instead of a hundred bars: one around all bars that reach
    above a quarter of the height, one around the foot; shape (n, 3) each.
    """
    corners = [corners_of(shape) for shape in shapes]
    quarter = max((float(points[:, 2].max()) for points in corners), default=0.0) / 4.0
    halves = (
        [points for points in corners if bool(points[:, 2].max() > quarter) is high]
        for high in (True, False)
    )
    return [np.concatenate(half) for half in halves if half]


def shape_corners(crane: Crane) -> list[tuple[int, np.ndarray]]:
    """Return every shape in the URDF: the joint that carries it (0 for none), and its corners in
    the frame of that joint [m].
    """
    return [
        (joint, corners_of(shape)) for joint, shapes in _shapes(crane).items() for shape in shapes
    ]


def _shapes(crane: Crane) -> dict[int, list[Shape]]:
    urdf = crane.urdf
    if ET.fromstring(urdf).find(".//geometry/mesh") is not None:
        raise ModelError(
            "The URDF of the crane shows a mesh; clearance needs boxes, cylinders or spheres."
        )
    shapes: dict[int, list[Shape]] = {}
    for kind in (pin.GeometryType.VISUAL, pin.GeometryType.COLLISION):
        for shape in pin.buildGeomFromUrdfString(crane.model, urdf, kind).geometryObjects:
            placed = (shape.geometry, shape.placement.rotation, shape.placement.translation)
            shapes.setdefault(int(shape.parentJoint), []).append(placed)
    return shapes


def corners_of(shape: Shape) -> np.ndarray:
    """Return the corners of the box around a shape, aligned with it, in the frame of the joint [m],
    shape (8, 3).
    """
    geometry, rotation, translation = shape
    geometry.computeLocalAABB()
    low, high = geometry.aabb_local.min_, geometry.aabb_local.max_
    box = np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )
    return box @ rotation.T + translation


def _box(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    low, high = points.min(axis=0), points.max(axis=0)
    return (low + high) / 2.0, high - low


def neighbour(
    name: str,
    position: np.ndarray,
    heading: float,
    drive_position: Mapping[str, float],
    values: Mapping[str, float],
) -> list[Solid]:
    """Return a parked crane with its rope and hook as an obstacle.

    Args:
        name: Its name.
        position: Foot of its mast [m], shape (3,).
        heading: Direction of its jib at zero slew, from X towards Y [rad].
        drive_position: Its slew [°], trolley radius [m] and cable length [m], by "slew", "trolley",
            "cable"; 0 is where its URDF has them.
        values: Values of the crane that differ from its defaults, by name.

    Raises:
        CraneError: If there is no such crane, or it cannot stand so.
    """
    crane = load_crane(values=values)
    crane.layout.tower("A parked neighbour")
    slew, trolley, cable = (drive_position[name] for name in ("slew", "trolley", "cable"))
    coordinates = {"gamma": math.radians(slew), "x": trolley, "l": cable}
    q = crane.state(**{coordinate: value for coordinate, value in coordinates.items() if value}).q
    rotation = rotation_z(heading + math.pi / 2.0)
    placed = [points @ rotation.T + position for points in _parts(crane, q)]
    corners, triangles = zip(*map(convex_hull, placed), strict=True)
    firsts = np.cumsum([0, *map(len, corners[:-1])])
    numbered = [indices + first for indices, first in zip(triangles, firsts, strict=True)]
    return [Solid(name, tuple(placed), np.vstack(corners), np.vstack(numbered))]


def _parts(crane: Crane, q: np.ndarray) -> list[np.ndarray]:
    """Return the corners of all shapes of a crane and of its rope, in its own frame [m]."""
    data = crane.model.createData()
    pin.forwardKinematics(crane.model, data, q)
    shapes = [
        data.oMi[joint].rotation @ corners.T + data.oMi[joint].translation[:, None]
        for joint, corners in shape_corners(crane)
    ]
    _, _, pivot, _, hoist = crane.layout.tower("A parked neighbour")
    falls = collision_bodies(crane).falls
    square = np.array([[x, y, 0.0] for x in (-falls, falls) for y in (-falls, falls)])
    rope = [data.oMi[joint + 1].translation + square for joint in (pivot, hoist)]
    return [shape.T for shape in shapes] + [np.vstack(rope)]
