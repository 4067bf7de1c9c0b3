"""A crane that is parked on the site, as an obstacle."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.planning.bodies import collision_bodies, shape_corners
from cranedyn.planning.solids import Solid, convex_hull, rotation_z


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
    q = crane.state(**{coordinate: value for coordinate, value in coordinates.items() if value}).q
    point_sets = _parts(crane, q)
    rotation = rotation_z(heading + math.pi / 2.0)
    placed = [points @ rotation.T + position for points in point_sets]
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
    falls, ends = (
        collision_bodies(crane).falls,
        [data.oMi[joint + 1].translation for joint in (pivot, hoist)],
    )
    rope = [
        end + np.array([x, y, 0.0])
        for end in ends
        for x in (-falls, falls)
        for y in (-falls, falls)
    ]
    return [shape.T for shape in shapes] + [np.array(rope)]
