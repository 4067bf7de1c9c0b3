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
from cranedyn.lifts.planning.site import GROUND, MAST, OWN_BASE, OWN_UPPER, Site
from cranedyn.verdict import Check

HANGING = ("hook", "rope", "load")
"""Bodies that hang from the trolley and swing."""

BELOW_UPPER = ("hook", "load")
"""Bodies that keep from what slews below the trolley, such as the slewing column. The rope does not
need to: it hangs from the trolley, which rolls beside these parts, above hook and load."""

BODIES = ("mast", "jib", "trolley", *HANGING)
"""All bodies of a crane; the jib stands for all that slews with it, the counter-jib too."""


class BodyAndObstacle(NamedTuple):
    """A body of the crane and an obstacle by their names, which are to be compared."""

    body: str
    obstacle: str


Pairs = frozenset[BodyAndObstacle]
"""Pairs of bodies and obstacles, in no order."""


def required_pairs(site: Site) -> Pairs:
    """Return all pairs of bodies and obstacles that a certificate must compare.

    Every body keeps from every solid, and what hangs keeps out of every zone and from the crane's
    own mast and base; hook and load also from what slews below the trolley. The ground is for the
    load alone: hook and rope hang above it, and the mast stands on it.
    """
    pairs: set[BodyAndObstacle] = set()
    for solid in site.solids:
        pairs |= _pairs_with(solid.name, HANGING if solid.zone else BODIES)
    pairs |= _pairs_with(MAST, HANGING)
    pairs |= _pairs_with(OWN_UPPER, BELOW_UPPER)
    if site.base is not None:
        pairs |= _pairs_with(OWN_BASE, HANGING)
    pairs |= _pairs_with(GROUND, ("load",))
    return frozenset(pairs)


def _pairs_with(obstacle: str, bodies: Iterable[str]) -> set[BodyAndObstacle]:
    """Return the pairs of bodies with an obstacle."""
    return {BodyAndObstacle(body, obstacle) for body in bodies}


def hanging_pairs(clearance: Clearance) -> Pairs:
    """Return the pairs of trolley, hook, rope and load with obstacles that `Clearance.margin`
    compares. An obstacle counts only if all of its parts are among the compared shapes: one that a
    proof left out, see `Clearance.contacts`, makes it missing.

    The trolley rolls at a constant height. A solid that ends far enough below it needs no
    comparison with it, and counts as compared.
    """
    part_counts = _shape_counts(clearance)
    pairs: set[BodyAndObstacle] = set()
    for body, field in clearance.hanging_fields():
        for obstacle, count in field.shape_counts.items():
            if count >= part_counts[obstacle]:
                pairs.add(BodyAndObstacle(body, obstacle))
    if not part_counts[OWN_UPPER]:  # a crane without such shapes has nothing to compare
        pairs |= _pairs_with(OWN_UPPER, BELOW_UPPER)
    for solid in clearance.site.seen_by_crane():
        top = float(solid.vertices[:, 2].max())
        if top + clearance.site.distance < clearance.trolley_bottom:
            pairs.add(BodyAndObstacle("trolley", solid.name))
    return frozenset(pairs)


def slewing_pairs(clearance: Clearance) -> Pairs:
    """Return the pairs of the jib with obstacles that `Clearance.slewing_margin` compares."""
    part_counts = _shape_counts(clearance)
    pairs: set[BodyAndObstacle] = set()
    for name, count in clearance.slewing_field.shape_counts.items():
        if count >= part_counts[name]:
            pairs.add(BodyAndObstacle("jib", name))
    return frozenset(pairs)


def _shape_counts(clearance: Clearance) -> Mapping[str, int]:
    """Return the number of shapes that each obstacle of the site consists of, by name."""
    # A surface of triangles has no parts and is one shape.
    solids = {solid.name: max(len(solid.parts), 1) for solid in clearance.site.solids}
    return {**solids, GROUND: 1, **clearance.own_shape_counts}


def coverage_check(site: Site, covered: Pairs) -> Check:
    """Return a check that proofs compare every body of the crane with every obstacle; it is not
    judged, and names the pairs, where they do not.
    """
    required = required_pairs(site)
    missing = sorted(required - covered)
    if missing:
        listed = ", ".join(f"{body} and {obstacle}" for body, obstacle in missing[:5])
        more = f" and {len(missing) - 5} more" if len(missing) > 5 else ""
        return Check(f"No proof compares {listed}{more}.", None)
    count = len(site.solids)
    obstacles = "1 obstacle" if count == 1 else f"{count} obstacles"
    return Check(
        f"The proofs compare the {len(BODIES)} bodies of the crane with {obstacles}, the mast and "
        f"the ground, and leave none of the {len(required)} pairs out.",
        True,
    )
