"""Where the crane stands: mast, foot and base must not be inside any obstacle, and the foot must
stand on something.

They need not keep the required distance: a crane stands on its foundation, and may be tied to the
building that it serves.
"""

from __future__ import annotations

from dataclasses import dataclass

import coal
import numpy as np

from cranedyn.lifts.planning.clearance import Clearance
from cranedyn.lifts.planning.coverage import BodyAndObstacle, Pairs
from cranedyn.lifts.planning.fields import Body, Field
from cranedyn.lifts.planning.site import GROUND
from cranedyn.lifts.planning.solids import hull
from cranedyn.verdict import Check

TOUCHING = 0.01
"""Depth up to which a part that stands may be in an obstacle [m]. A crane stands on a foundation
and may be tied to a building, so that it touches them; what is deeper is inside of them.
"""

UNEVEN = 0.05
"""How far the ground, or the top of an obstacle, may be below the foot that stands on it [m]."""

FOOTPRINT = 0.5
"""Side of the square about the middle of the foot below which an obstacle must reach up to the foot
[m]."""


@dataclass(frozen=True)
class Standing:
    """How the parts of a crane that stand are placed among the obstacles.

    Attributes:
        inside: Pairs of a part and an obstacle that it is inside of.
        below: What the foot stands on, the ground or an obstacle; empty if it stands on nothing.
        pairs: Pairs of what stands with the obstacles that it was compared with.
        standing: What stands, to begin a sentence with.
        is_mobile: Whether it is the mobile crane of this project, whose structure is its carrier.
    """

    inside: tuple[BodyAndObstacle, ...]
    below: str
    pairs: Pairs
    standing: str
    is_mobile: bool = False


def standing_parts(clearance: Clearance) -> Standing:
    """Compare mast, foot and base of a crane with all solids of its site, but for zones, which only
    what hangs keeps out of.
    """
    site = clearance.site
    (name_of_standing,) = clearance.parts.standing
    parts = {name_of_standing: clearance.standing}
    if site.base is not None:
        parts["base"] = [site.base_corners]
    shapes = []
    for name, hulls in parts.items():
        for corners in map(_shrunk, hulls):
            shapes.append((name, corners, hull(corners)))
    level = site.ground - float(site.foot[2])
    below = GROUND if abs(level) <= UNEVEN else ""
    # What the foot stands on reaches into this space below it. A wall beside the foot does not, nor
    # does a beam above it.
    middle = coal.Transform3s(np.eye(3), np.array([0.0, 0.0, -UNEVEN / 2.0]))
    below_foot = Body(coal.Box(FOOTPRINT, FOOTPRINT, UNEVEN), 0.0).put(middle)
    inside: list[BodyAndObstacle] = []
    compared: set[BodyAndObstacle] = set()
    for solid in site.seen_by_crane():
        if solid.zone:
            continue
        geometries = solid.geometries()
        field = Field((solid.name, shape) for shape in geometries)
        compared.add(BodyAndObstacle(name_of_standing, solid.name))
        if not below and field.least(below_foot) <= 0.0:
            below = solid.name
        for name, corners, shape in shapes:
            if solid.meets(corners, shape, geometries):
                inside.append(BodyAndObstacle(name, solid.name))
    if level > UNEVEN:  # the ground is above the foot
        inside.append(BodyAndObstacle(name_of_standing, GROUND))
    each_once = tuple(dict.fromkeys(inside))
    standing = "Mast, foot and base" if name_of_standing == "mast" else "The standing parts"
    described = site.description
    is_mobile = described is not None and described.kind == "mobile"
    return Standing(each_once, below, frozenset(compared), standing, is_mobile)


def standing_check(result: Standing) -> Check:
    """Return a check that nothing of the crane stands in an obstacle, and its foot on something."""
    if not result.inside and not result.below:
        return Check(
            "The foot of the crane stands on nothing: neither the ground nor the top of an "
            "obstacle is below it.",
            False,
        )
    if not result.inside:
        return Check(
            f"{result.standing} of the crane stand in no obstacle, the foot on {result.below}.",
            True,
        )
    listed = ", ".join(f"the {body} stands in {obstacle}" for body, obstacle in result.inside[:5])
    carrier = ""
    if result.is_mobile:
        carrier = (
            " The structure is the carrier with its outriggers; its nose points to -Y of the site "
            "at yaw = 0, and turns with yaw counter-clockwise."
        )
    return Check(f"The crane cannot stand there: {listed}.{carrier}", False)


def _shrunk(corners: np.ndarray) -> np.ndarray:
    """Return corners [m], shape (n, 3), moved towards the middle of their box by `TOUCHING` in each
    direction, and no farther than to the middle.
    """
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2.0
    offset = corners - middle
    return middle + np.sign(offset) * np.maximum(np.abs(offset) - TOUCHING, 0.0)
