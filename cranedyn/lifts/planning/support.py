"""What a load stands on, and how much of it a proof of distances may leave out.

A load touches its support, so that the required distance from it cannot be kept. What may be left
out of the proof of distances is no more than the contact needs: the convex parts of the support
that end below the load. A load that stands on a slab of 1 m is 0 m from it; but as long as its
lowest corner stays at 1 m, no part of it is inside of the slab, nor of anything else that ends at
1 m. So `contact_check` shows that it does not sink into the top.

Parts of the same obstacle that reach higher, such as the walls of a box that is open at the top,
stay in the proof, and so do all other obstacles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np

from cranedyn.lifts.planning.clearance import Clearance, ObstaclePart
from cranedyn.lifts.planning.coverage import HANGING, BodyAndObstacle, Pairs
from cranedyn.lifts.planning.fields import Body, Field
from cranedyn.lifts.planning.site import GROUND, Site
from cranedyn.lifts.planning.solids import hull
from cranedyn.verdict import Check

CONTACT_TOLERANCE = 0.01
"""Depth up to which a load counts as standing on a surface and not as being in it [m].

A load at rest sinks by `cranedyn.dynamics.contact.Ground.sink`, 2 mm, into what it stands on. Set
down at a speed v it goes to (1 + √(1 + v²/(g sink))) times that, 7 mm at 0.3 m/s.
"""


WHOLE_UNDERSIDE = 0.995
"""Share of the underside of a load from which on it does not overhang: what is less is the rounding
of a load that is as long as its support."""

EDGE_MARGIN = 0.05
"""Least distance in plan of the centre of gravity of a load that overhangs from the edge of what
carries it [m]: a centre of gravity is hardly known better."""


@dataclass(frozen=True)
class Support:
    """What a load stands on.

    Attributes:
        height: Height of the surface of contact above the crane's foot [m].
        parts: Parts that end below it, of the obstacles that the load touches there; the ground is
            one of them where it stands on that. Empty where the load hangs.
    """

    height: float
    parts: frozenset[ObstaclePart]

    @property
    def pairs(self) -> Pairs:
        """The pairs of what hangs with the obstacles that are in contact, see `contact_check`."""
        names = {part.obstacle for part in self.parts}
        return frozenset(BodyAndObstacle(body, name) for body in HANGING for name in names)


NO_SUPPORT = Support(-np.inf, frozenset())
"""The support of a load that hangs. Its height is never read."""


def support_of(clearance: Clearance, corners: np.ndarray) -> Support:
    """Return what a load stands on.

    Args:
        clearance: Crane and site.
        corners: Corners of the standing load in the frame of the crane [m], shape (n, 3).
    """
    site = clearance.site
    bottom = float(corners[:, 2].min())
    load = Body(hull(corners), 0.0).put(coal.Transform3s())
    parts: set[ObstaclePart] = set()
    tops: list[float] = []
    level = site.ground - float(site.foot[2])
    if abs(level - bottom) <= CONTACT_TOLERANCE:
        parts.add(ObstaclePart(GROUND, 0))
        tops.append(level)
    for solid in site.seen_by_crane():
        if solid.zone:
            continue
        below: set[ObstaclePart] = set()
        touched: list[float] = []
        for i, part in enumerate(solid.parts):
            top = float(part[:, 2].max())
            if top <= bottom + CONTACT_TOLERANCE:
                below.add(ObstaclePart(solid.name, i))
                if Field([(solid.name, hull(part))]).least(load) <= CONTACT_TOLERANCE:
                    touched.append(top)
        # Parts beside a touched one, of the same obstacle and below the load as well, are left out
        # with it: a slab may be made of several.
        if touched:
            parts |= below
            tops += touched
    return Support(max(tops), frozenset(parts)) if parts else NO_SUPPORT


def carried_area(clearance: Clearance, corners: np.ndarray, support: Support) -> Any:
    """Return what carries a standing load, as a `shapely` area in plan in the frame of the crane:
    the convex hull of all places where its underside rests on a part of its support.

    Args:
        clearance: Crane and site.
        corners: Corners of the standing load in the frame of the crane [m], shape (n, 3).
        support: Its support, see `support_of`.
    """
    import shapely  # slow, and few lifts need it

    underside = underside_of(corners)
    if ObstaclePart(GROUND, 0) in support.parts:
        return underside
    tops = []
    for solid in clearance.site.seen_by_crane():
        for i, part in enumerate(solid.parts):
            top = float(part[:, 2].max())
            if ObstaclePart(solid.name, i) not in support.parts:
                continue
            if abs(top - support.height) > CONTACT_TOLERANCE:
                continue  # a part of the same obstacle that ends lower carries nothing
            upper = part[part[:, 2] > top - CONTACT_TOLERANCE]
            tops.append(shapely.MultiPoint(upper[:, :2]).convex_hull.intersection(underside))
    return shapely.union_all(tops).convex_hull


def underside_of(corners: np.ndarray) -> Any:
    """Return the underside of a load as a `shapely` area in plan: the hull of its lowest corners.

    Args:
        corners: Its corners [m], shape (n, 3).
    """
    import shapely

    lowest = corners[:, 2] < float(corners[:, 2].min()) + CONTACT_TOLERANCE
    return shapely.MultiPoint(corners[lowest, :2]).convex_hull


def balance_check(
    clearance: Clearance, ends: Sequence[tuple[str, Support, np.ndarray]], *, centre_known: bool
) -> Check:
    """Return a check that a standing load does not tip over the edge of what it stands on: its
    centre of gravity, the middle of its box in plan, is above the area that carries it. A load that
    overhangs and whose centre of gravity nobody entered is not judged.

    Args:
        clearance: Crane and site.
        ends: Name, support, and corners of the standing load in the frame of the crane [m], shape
            (8, 3), of each end of the lift at which the load stands.
        centre_known: Whether somebody entered the centre of gravity.
    """
    import shapely

    sentences = []
    verdicts: list[bool | None] = []
    for name, support, corners in ends:
        if not support.parts:
            sentences.append(f"at the {name} it stands on nothing")
            verdicts.append(False)
            continue
        area = carried_area(clearance, corners, support)
        share = area.area / underside_of(corners).area
        on = ", ".join(sorted({part.obstacle for part in support.parts}))
        if share > WHOLE_UNDERSIDE:
            sentences.append(f"at the {name} all of its underside is on {on}")
            verdicts.append(True)
            continue
        middle = shapely.Point(corners[:, :2].mean(axis=0))
        inside = area.contains(middle)
        edge = float(area.boundary.distance(middle))
        overhangs = f"at the {name} it overhangs {on}, which carries {100.0 * share:.0f} % of it"
        if inside and not centre_known:
            sentences.append(f"{overhangs}, and nobody entered [load] centre: not judged")
            verdicts.append(None)
            continue
        where = "inside" if inside else "outside"
        sentences.append(
            f"{overhangs}, its centre of gravity {edge:.2f} m {where} the edge that carries it"
        )
        verdicts.append(inside and edge >= EDGE_MARGIN)
    verdict = False if False in verdicts else None if None in verdicts else True
    tips = "would tip" if verdict is False else "does not tip"
    return Check(
        f"The load {tips} where it stands: {'; '.join(sentences)}; {EDGE_MARGIN:g} m from the edge "
        "required.",
        verdict,
    )


def meshes_at(site: Site, corners: np.ndarray) -> list[str]:
    """Return the names of meshes that are not convex and that a load with these corners in the
    frame of the crane [m], shape (n, 3), would stand on or be in. None can be a support, since
    contact is computed with convex parts.
    """
    load = Body(hull(corners), 0.0).put(coal.Transform3s())
    centre = corners.mean(axis=0)
    names = []
    for solid in site.seen_by_crane():
        is_mesh = not solid.zone and not solid.parts
        if not is_mesh:
            continue
        surface = Field((solid.name, shape) for shape in solid.geometries())
        if surface.least(load) <= CONTACT_TOLERANCE or solid.surface_encloses(centre):
            names.append(solid.name)
    return names


def contact_check(phases: Sequence[tuple[str, Support, np.ndarray]]) -> Check:
    """Return a check that a load does not sink into what it stands on.

    Args:
        phases: Name, support, and height of the lowest corner of the load above the crane's foot in
            each row [m], shape (rows,), of each phase in which the load stands.
    """
    sentences = []
    holds = True
    for name, support, lowest in phases:
        if not support.parts:
            sentences.append(f"at the {name} the load stands on nothing")
            holds = False
            continue
        depth = support.height - float(lowest.min())
        holds = holds and depth <= CONTACT_TOLERANCE
        listed = ", ".join(sorted({part.obstacle for part in support.parts}))
        sentences.append(f"at the {name} it sinks {1e3 * max(depth, 0.0):.1f} mm into {listed}")
    return Check(
        f"The load stays on what it stands on: {'; '.join(sentences)}; "
        f"{1e3 * CONTACT_TOLERANCE:g} mm allowed.",
        holds,
    )
