"""Whether a crane stands in an obstacle at its start, by its real shapes and not by capsules."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from cranedyn.lifts.planning.crane_bodies import shape_corners
from cranedyn.lifts.planning.solids import Solid, hull
from cranedyn.lifts.sites.placed_capsules import (
    convex_parts,
    is_bridge_crane,
    standing_part,
)
from cranedyn.model.crane import Crane

TOUCH_TOLERANCE = 1e-3
"""Distance by which the corners of a shape are moved inwards before they count [m], so that what
only touches an obstacle is not in it."""


class StartPart(NamedTuple):
    """A convex part of a crane at its start.

    Attributes:
        name: Its name, such as "tower".
        corners: Its corners in the frame of the site [m], shape (n, 3).
    """

    name: str
    corners: np.ndarray


def parts_at_start(crane: Crane, foot: np.ndarray) -> list[StartPart]:
    """Return the convex parts of a crane at its start.

    All shapes of the description count, those that stand still, those that turn, and the load, and
    the rope. Shapes that one capsule covers count as their convex hull: what is between the chords
    of a mast is in the mast.

    Args:
        crane: The crane.
        foot: Rotation and translation of its foot in the frame of the site [R, p], shape (3, 4).
    """
    parts = []
    for name, corners in _named_corners(crane, foot):
        # A foot that stands on a slab touches it, and is not in it.
        inward = corners.mean(axis=0) - corners
        lengths = np.linalg.norm(inward, axis=1, keepdims=True)
        step = TOUCH_TOLERANCE * inward / np.maximum(lengths, TOUCH_TOLERANCE)
        corners = corners + step
        parts.append(StartPart(name, corners))
    return parts


def first_collision(parts: Sequence[StartPart], solids: Sequence[Solid]) -> tuple[str, str] | None:
    """Return the names of the first part that has a point in common with a solid, and of this
    solid; None if there is none.
    """
    geometries = [solid.geometries() for solid in solids]
    for part in parts:
        shape = hull(part.corners)
        for solid, of_solid in zip(solids, geometries, strict=True):
            if solid.meets(part.corners, shape, of_solid):
                return part.name, solid.name
    return None


def _named_corners(crane: Crane, foot: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Yield each convex part of a crane at its start: name, and corners on the site [m], shape
    (n, 3).
    """
    data = crane.model.createData()
    pin.forwardKinematics(crane.model, data, crane.start.q)
    pivot = int(crane.swings[0]) + 1
    load = int(crane.layout.drives[crane.winch]) + 1
    rope = np.array([data.oMi[pivot].translation, data.oMi[load].translation])
    shapes: dict[int, list[np.ndarray]] = {}
    for joint, corners in shape_corners(crane):
        points = np.array([data.oMi[joint].act(corner) for corner in corners])
        shapes.setdefault(joint, []).append(points @ foot[:, :3].T + foot[:, 3])
    for joint, placed in shapes.items():
        for corners in convex_parts(crane, joint, placed):
            yield _part_name(crane, joint, load), corners
    yield "rope", rope @ foot[:, :3].T + foot[:, 3]


def _part_name(crane: Crane, joint: int, load: int) -> str:
    """Return what a shape behind a joint is called."""
    if joint == 0:
        return standing_part(crane)
    if joint == load:
        return "load"
    if joint == 1 and is_bridge_crane(crane):
        return "bridge"
    names = {"slew": "slewing part", "trolley": "trolley"}
    return names.get(crane.layout.joints[joint - 1].role, "moving part")
