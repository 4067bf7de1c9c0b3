"""A load that overhangs its support, by hand: what carries it, and whether it tips."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cranedyn.dynamics.contact import box_corners
from cranedyn.lifts.planning.clearance import ObstaclePart
from cranedyn.lifts.planning.site import GROUND
from cranedyn.lifts.planning.solids import Solid, box
from cranedyn.lifts.planning.support import Support, balance_check, carried_area

LOAD = np.array(box_corners(2.0, 4.0, 1.0)) + np.array([0.0, 0.0, 1.5])
"""A load of 2 m by 4 m whose underside is at 1 m."""


def beside(*solids: Solid) -> Any:
    """What `carried_area` needs of a crane with a site."""
    return SimpleNamespace(site=SimpleNamespace(seen_by_crane=lambda: list(solids)))


def on(*names: str) -> Support:
    return Support(1.0, frozenset(ObstaclePart(name, 0) for name in names))


def slab(name: str, first: float, last: float, top: float = 1.0) -> Solid:
    """A slab below all of the load's width, from one to another y."""
    return box(name, (0.0, (first + last) / 2.0), (3.0, last - first, top), 0.0)


@pytest.mark.parametrize(
    ("first", "known", "holds", "words"),
    [
        (-3.0, False, True, "all of its underside is on slab"),
        # From y = -1 on three quarters are carried, and the middle is a metre from the edge.
        (-1.0, True, True, "carries 75 % of it, its centre of gravity 1.00 m inside the edge"),
        (-1.0, False, None, "carries 75 % of it, and nobody entered [load] centre: not judged"),
        (-0.04, True, False, "0.04 m inside the edge"),
        (0.5, True, False, "0.50 m outside the edge"),
        (0.5, False, False, "0.50 m outside the edge"),
    ],
)
def test_a_load_that_overhangs_is_judged_by_its_centre_of_gravity(
    first: float, known: bool, holds: bool | None, words: str
) -> None:
    ends = [("goal", on("slab"), LOAD)]
    check = balance_check(beside(slab("slab", first, 3.0)), ends, centre_known=known)
    assert check.holds is holds and words in check.sentence, check.sentence


def test_two_beams_carry_what_is_between_them() -> None:
    """Beams below both ends of the load carry its middle, though nothing is below that."""
    beams = slab("one", -3.0, -1.5), slab("other", 1.5, 3.0)
    area = carried_area(beside(*beams), LOAD, on("one", "other"))
    assert area.area == pytest.approx(8.0)
    check = balance_check(beside(*beams), [("start", on("one"), LOAD)], centre_known=True)
    assert check.holds is False and "1.50 m outside" in check.sentence


def test_a_lower_part_of_a_support_carries_nothing_and_the_ground_all() -> None:
    lower = slab("lower", -3.0, 1.0, top=0.9)
    area = carried_area(beside(lower, slab("slab", 1.0, 3.0)), LOAD, on("lower", "slab"))
    assert area.area == pytest.approx(2.0)
    assert carried_area(beside(), LOAD, on(GROUND)).area == pytest.approx(8.0)
    hangs = balance_check(beside(), [("goal", on(), LOAD)], centre_known=True)
    assert hangs.holds is False and "stands on nothing" in hangs.sentence
