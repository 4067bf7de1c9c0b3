"""Which bodies of the crane a proof compares with which obstacles, and which it should.

A proof that leaves a pair of a body and an obstacle out says nothing about it, however well it goes
for the others. So a certificate asks twice. `required_pairs` lists all pairs from the site alone.
`hanging_pairs`, `slewing_pairs` and `cranedyn.lifts.planning.standing.Standing.pairs` list the
pairs that are compared, from the very shapes that distances are measured between. What is in the
first list and not in the second is missing, and the certificate does not hold.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from cranedyn.lifts.planning.clearance import Clearance
from cranedyn.lifts.planning.crane_bodies import CraneParts
from cranedyn.lifts.planning.site import BELOW_UPPER, GROUND, HANGING, OWN_UPPER, Site
from cranedyn.lifts.planning.tower_clearance import TowerClearance
from cranedyn.verdict import Check


class BodyAndObstacle(NamedTuple):
    """A body of the crane and an obstacle by their names, which are to be compared."""

    body: str
    obstacle: str


Pairs = frozenset[BodyAndObstacle]
"""Pairs of bodies and obstacles, in no order."""


def required_pairs(site: Site, parts: CraneParts) -> Pairs:
    """Return all pairs of bodies and obstacles that a certificate must compare.

    Every body keeps from every solid, and what hangs keeps out of every zone and from parts of the
    crane itself, such as its mast. The ground is for the load alone: hook and rope hang above it,
    and the crane stands on it.

    Args:
        site: The site.
        parts: The bodies of the crane.
    """
    pairs: set[BodyAndObstacle] = set()
    for solid in site.solids:
        pairs |= _pairs_with(solid.name, HANGING if solid.zone else parts.bodies)
    for obstacle, bodies in parts.own.items():
        pairs |= _pairs_with(obstacle, bodies)
    pairs |= _pairs_with(GROUND, ("load",))
    return frozenset(pairs)


def _pairs_with(obstacle: str, bodies: Iterable[str]) -> set[BodyAndObstacle]:
    """Return the pairs of bodies with an obstacle."""
    return {BodyAndObstacle(body, obstacle) for body in bodies}


def hanging_pairs(clearance: Clearance) -> Pairs:
    """Return the pairs of bodies with obstacles that `Clearance.margin` compares.

    An obstacle counts only if all of its parts are among the compared shapes: one that a proof left
    out, see `Clearance.contacts`, makes it missing. Pairs that never come near each other, see
    `Clearance.out_of_range`, count as compared.
    """
    part_counts = _shape_counts(clearance)
    pairs: set[BodyAndObstacle] = set()
    for body, field in clearance.compared_fields():
        for obstacle, count in field.shape_counts.items():
            if count >= part_counts[obstacle]:
                pairs.add(BodyAndObstacle(body, obstacle))
    if not part_counts.get(OWN_UPPER):  # a crane without such shapes has nothing to compare
        pairs |= _pairs_with(OWN_UPPER, BELOW_UPPER)
    for body, obstacle in clearance.out_of_range():
        pairs.add(BodyAndObstacle(body, obstacle))
    return frozenset(pairs)


def slewing_pairs(clearance: Clearance) -> Pairs:
    """Return the pairs of the jib with obstacles that `TowerClearance.slewing_margin` compares;
    none for a crane whose structure is compared together with what hangs.
    """
    pairs: set[BodyAndObstacle] = set()
    if not isinstance(clearance, TowerClearance):
        return frozenset(pairs)
    part_counts = _shape_counts(clearance)
    for name, count in clearance.slewing_field.shape_counts.items():
        if count >= part_counts[name]:
            pairs.add(BodyAndObstacle("jib", name))
    return frozenset(pairs)


def _shape_counts(clearance: Clearance) -> Mapping[str, int]:
    """Return the number of shapes that each obstacle of the site consists of, by name."""
    # A surface of triangles has no parts and is one shape.
    solids = {solid.name: max(len(solid.parts), 1) for solid in clearance.site.solids}
    return {**solids, GROUND: 1, **clearance.own_shape_counts}


def coverage_check(clearance: Clearance, covered: Pairs) -> Check:
    """Return a check that proofs compare every body of the crane with every obstacle; it is not
    judged, and names the pairs, where they do not. Of a link that is not drawn nothing is compared.
    """
    site = clearance.site
    parts = clearance.parts
    if parts.undrawn:
        return Check(
            f"The description of the crane draws nothing of {' and '.join(parts.undrawn)}, so that "
            "no proof compares it with anything; draw it with boxes, cylinders or spheres.",
            None,
        )
    required = required_pairs(site, parts)
    missing = sorted(required - covered)
    if missing:
        listed = ", ".join(f"{body} and {obstacle}" for body, obstacle in missing[:5])
        more = f" and {len(missing) - 5} more" if len(missing) > 5 else ""
        return Check(f"No proof compares {listed}{more}.", None)
    count = len(site.solids)
    obstacles = "1 obstacle" if count == 1 else f"{count} obstacles"
    standing = "the mast" if "mast" in parts.standing else "its own structure"
    return Check(
        f"The proofs compare the {len(parts.bodies)} bodies of the crane with {obstacles}, "
        f"{standing} and the ground, and leave none of the {len(required)} pairs out.",
        True,
    )
