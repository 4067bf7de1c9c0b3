"""Bodies of a crane from the shapes in its URDF: mast, upper structure, trolley, rope, hook and
load; and all of a crane that is parked on a site, as an obstacle.
"""

from __future__ import annotations

import itertools
import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from cranedyn.errors import ModelError
from cranedyn.lifts.planning.solids import Solid, convex_hull, rotation_z
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane

Shape = tuple[coal.CollisionGeometry, np.ndarray, np.ndarray]
"""A shape with its rotation and translation in the frame of the joint that carries it."""


class BoundingBox(NamedTuple):
    """A box along the axes of a frame.

    Attributes:
        centre: Its centre [m], shape (3,).
        size: Its sides [m], shape (3,).
    """

    centre: np.ndarray
    size: np.ndarray

    @property
    def top(self) -> float:
        """Height of its top [m]."""
        return self.centre[2] + self.size[2] / 2.0


@dataclass(frozen=True, eq=False)
class CollisionBodies:
    """Bodies of a crane, each in the frame of the joint that carries it.

    Attributes:
        mast: Corners of the hulls of the mast and its foot [m], shape (n, 3) each.
        upper: Shapes that slew, jib and counter-jib among them.
        trolley: The box around the trolley.
        hook: The box around the hook, above the load.
        load: Corners of the load about the end of the cable [m], shape (n, 3).
        falls: Radius about the cable's axis within which the falls of the rope run [m]: half the
            width of the hook's block.
    """

    mast: list[np.ndarray]
    upper: list[Shape]
    trolley: BoundingBox
    hook: BoundingBox
    load: np.ndarray
    falls: float

    @cached_property
    def spread(self) -> float:
        """Largest distance of trolley, rope, hook or load from the plumb line [m]."""
        radii = [self.falls]
        for box in (self.trolley, self.hook):
            x, y = np.abs(box.centre[:2]) + box.size[:2] / 2.0
            radii.append(np.hypot(x, y))
        radii.append(np.linalg.norm(self.load[:, :2], axis=1).max())
        return float(max(radii))

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
    slew, trolley, radial, tangential, hoist = crane.layout.tower("Clearance")
    # Pinocchio counts joints from 1; 0 is the world, in which the mast stands. Links between the
    # swing joints hang at the trolley and move with it.
    carriers = {
        "mast": [0],
        "upper structure": [slew + 1],
        "trolley": [trolley + 1, radial + 1, tangential + 1],
        "payload": [hoist + 1],
    }
    shapes = _shapes(crane)
    groups: dict[str, list[Shape]] = {}
    for name, joints in carriers.items():
        groups[name] = []
        for joint in joints:
            groups[name] += shapes.get(joint, [])
    for name in ("upper structure", "trolley", "payload"):
        if not groups[name]:
            raise ModelError(
                f"The URDF of the crane shows no shapes of its {name}; clearance needs boxes, "
                "cylinders or spheres."
            )
    drawn = _drawn_payload(groups["payload"])
    carried = drawn.load if load is None else load
    rise = float(carried[:, 2].max()) - float(drawn.load[:, 2].max())
    return CollisionBodies(
        mast=_mast(groups["mast"]),
        upper=groups["upper structure"],
        trolley=_box(np.concatenate([corners_of(shape) for shape in groups["trolley"]])),
        hook=_box(np.concatenate(drawn.hook) + np.array([0.0, 0.0, rise])),
        load=carried,
        falls=float(np.ptp(drawn.block[:, :2], axis=0).max()) / 2.0,
    )


class _DrawnPayload(NamedTuple):
    """The link at the hook, as the URDF draws it; corners about the end of the cable [m], shape
    (n, 3) each.

    Attributes:
        load: Its largest shape, the load.
        hook: The shapes above that, the hook with its block and slings.
        block: The highest of them, from which the falls of the rope go up.
    """

    load: np.ndarray
    hook: list[np.ndarray]
    block: np.ndarray


def _drawn_payload(shapes: list[Shape]) -> _DrawnPayload:
    """Tell load and hook apart among the shapes of a link.

    Raises:
        ModelError: If there is no shape above the load.
    """

    def volume(points: np.ndarray) -> float:
        return float(np.prod(np.ptp(points, axis=0)))

    def highest(points: np.ndarray) -> float:
        return float(points[:, 2].max())

    corners = [corners_of(shape) for shape in shapes]
    load = max(corners, key=volume)
    hook = [points for points in corners if points[:, 2].mean() > highest(load)]
    if not hook:
        raise ModelError(
            "The URDF of the crane shows no hook above its load, so that the width of the rope is "
            "not known."
        )
    return _DrawnPayload(load, hook, max(hook, key=highest))


def _mast(shapes: list[Shape]) -> list[np.ndarray]:
    """Return the corners of two hulls instead of a hundred bars: one around all bars that reach
    above a quarter of the height, one around the foot; shape (n, 3) each.
    """
    corners = [corners_of(shape) for shape in shapes]
    quarter = max((float(points[:, 2].max()) for points in corners), default=0.0) / 4.0
    high = [points for points in corners if points[:, 2].max() > quarter]
    low = [points for points in corners if not points[:, 2].max() > quarter]
    return [np.concatenate(half) for half in (high, low) if half]


def shape_corners(crane: Crane) -> list[tuple[int, np.ndarray]]:
    """Return every shape in the URDF: the joint that carries it (0 for none), and its corners in
    the frame of that joint [m].
    """
    corners = []
    for joint, shapes in _shapes(crane).items():
        for shape in shapes:
            corners.append((joint, corners_of(shape)))
    return corners


def _shapes(crane: Crane) -> dict[int, list[Shape]]:
    """Return all shapes in a URDF, those to look at and those for collisions, by the joint that
    carries them; 0 is the world.

    Raises:
        ModelError: If it shows a mesh.
    """
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
    low = geometry.aabb_local.min_
    high = geometry.aabb_local.max_
    xs, ys, zs = zip(low, high, strict=True)
    box = np.array(list(itertools.product(xs, ys, zs)))
    return box @ rotation.T + translation


def _box(points: np.ndarray) -> BoundingBox:
    """Return the box around points [m], shape (n, 3)."""
    low = points.min(axis=0)
    high = points.max(axis=0)
    return BoundingBox((low + high) / 2.0, high - low)


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
    coordinates = {
        "gamma": math.radians(drive_position["slew"]),
        "x": drive_position["trolley"],
        "l": drive_position["cable"],
    }
    # What is 0 stays at the start of the crane, as 0 need not be in the range of the drive.
    given = {name: value for name, value in coordinates.items() if value}
    q = crane.state(**given).q

    rotation = rotation_z(heading + math.pi / 2.0)  # its jib points along -Y at zero slew
    parts = []
    corners = []
    triangles = []
    corner_count = 0
    for points in _parts(crane, q):
        placed = points @ rotation.T + position
        hull_corners, hull_triangles = convex_hull(placed)
        parts.append(placed)
        corners.append(hull_corners)
        # Each hull counts its corners from zero; in the solid they follow those before.
        triangles.append(hull_triangles + corner_count)
        corner_count += len(hull_corners)
    return [Solid(name, tuple(parts), np.vstack(corners), np.vstack(triangles))]


def _parts(crane: Crane, q: np.ndarray) -> list[np.ndarray]:
    """Return the corners of all shapes of a crane and of its rope, in its own frame [m], shape
    (n, 3) each.
    """
    data = crane.model.createData()
    pin.forwardKinematics(crane.model, data, q)
    shapes = []
    for joint, corners in shape_corners(crane):
        frame = data.oMi[joint]
        placed = frame.rotation @ corners.T + frame.translation[:, None]
        shapes.append(placed.T)

    # The rope, plumb, as a square column around its falls.
    _, _, pivot, _, hoist = crane.layout.tower("A parked neighbour")
    falls = collision_bodies(crane).falls
    square = np.array([[x, y, 0.0] for x, y in itertools.product((-falls, falls), repeat=2)])
    upper_end = data.oMi[pivot + 1].translation + square
    lower_end = data.oMi[hoist + 1].translation + square
    rope = np.vstack([upper_end, lower_end])
    return [*shapes, rope]
