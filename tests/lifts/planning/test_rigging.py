"""Slings by hand: shares and angle of the legs, height of the rigging, and how a load hangs."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cranedyn.lifts.planning.plan_details import LoadDetails, PlanDetails, Slings, Spreader
from cranedyn.lifts.planning.rigging import (
    attachment_height,
    counted_legs,
    largest_share,
    leg_limit,
    leg_share,
    rigging_height,
    set_limit_at,
    sling_angle,
    tilt,
)

SQUARE = ((-1.0, -2.0, 0.5), (1.0, -2.0, 0.5), (1.0, 2.0, 0.5), (-1.0, 2.0, 0.5))
"""Lifting points at the corners of a rectangle of 2 m by 4 m."""


def details(load: LoadDetails, slings: Slings, spreader: Spreader | None = None) -> PlanDetails:
    return PlanDetails(load=load, slings=slings, spreader=spreader)


@pytest.mark.parametrize(
    ("centre", "share"),
    [
        # Two points are a lever: 3 m of 4 m away from the other one.
        ((0.0, 0.0, 0.0), 0.5),
        ((0.0, 1.0, 0.0), 0.75),
        ((0.0, 2.0, 0.0), 1.0),
        ((0.0, 2.1, 0.0), None),
        ((0.3, 1.0, 0.0), None),
    ],
)
def test_two_lifting_points_are_a_lever(
    centre: tuple[float, float, float], share: float | None
) -> None:
    found = largest_share([(0.0, -2.0, 0.0), (0.0, 2.0, 0.0)], centre)
    assert found == (None if share is None else pytest.approx(share))


def test_three_lifting_points_carry_as_areas_of_triangles_have_it() -> None:
    """Each point carries the share that the triangle of the other two with the centre has of all:
    at (1, 0.5) of the triangle (0, 0), (4, 0), (0, 3) these are 7/12, 1/4 and 1/6.
    """
    points = [(0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0)]
    assert largest_share(points, (1.0, 0.5, 0.0)) == pytest.approx(7.0 / 12.0)
    assert largest_share(points, (2.5, 2.5, 0.0)) is None


def test_of_four_legs_two_opposite_ones_carry_all_at_worst() -> None:
    """With the centre at (0.5, 0) the worst is one leg in a triangle with two of the others: at
    (1, -2) with (-1, 2) and (1, 2), moments about X and Y leave 1/2 for it, 1/4 for each.
    """
    assert largest_share(SQUARE) == pytest.approx(0.5)
    assert largest_share(SQUARE, (0.5, 0.0, 0.0)) == pytest.approx(0.5)
    # At (0.5, 1) the leg at (1, 2) carries 3/4 with that at (-1, -2), which are on one diagonal.
    assert largest_share(SQUARE, (0.5, 1.0, 0.0)) == pytest.approx(0.75)
    assert largest_share(SQUARE, (1.01, 0.0, 0.0)) is None


def test_no_more_than_two_legs_are_counted_on() -> None:
    assert [counted_legs(number) for number in (1, 2, 3, 4)] == [1, 2, 2, 2]
    no_points = LoadDetails()
    assert [leg_share(no_points, number) for number in (1, 2, 3, 4)] == [1.0, 0.5, 0.5, 0.5]
    # Three legs about the centre carry a third each, and are counted as two all the same.
    third = LoadDetails(lifting_points=((1.0, 0.0, 0.0), (-0.5, 0.9, 0.0), (-0.5, -0.9, 0.0)))
    assert leg_share(third, 3) == 0.5
    aside = LoadDetails(centre=(0.5, 1.0, 0.0), lifting_points=SQUARE)
    assert leg_share(aside, 4) == pytest.approx(0.75)
    # With two legs at a point one of them is counted on.
    assert leg_share(aside, 8) == pytest.approx(0.75)


def test_the_angle_of_a_leg_is_that_of_its_length_to_the_farthest_lifting_point() -> None:
    slings = Slings(number=4, length=math.sqrt(20.0))
    # The points are √5 m from the middle, so that legs of √20 m lean by asin(1/2).
    load = LoadDetails(lifting_points=SQUARE)
    assert sling_angle(details(load, slings)) == pytest.approx(math.radians(30.0))
    aside = LoadDetails(lifting_points=SQUARE, centre=(0.0, 1.0, 0.0))
    expected = math.asin(math.sqrt(10.0) / math.sqrt(20.0))
    assert sling_angle(details(aside, slings)) == pytest.approx(expected)
    # What is entered counts, and a single leg is plumb.
    assert sling_angle(details(load, Slings(number=4, length=9.0, angle=0.7))) == 0.7
    assert sling_angle(details(load, Slings(number=1))) == 0.0
    # Too short, of no length, or below a spreader it is not known.
    for slings, spreader in (
        (Slings(number=4, length=2.0), None),
        (Slings(number=4), None),
        (Slings(number=4, length=5.0), Spreader()),
    ):
        assert sling_angle(details(load, slings, spreader)) is None


def test_the_rigging_is_as_high_as_its_legs_and_its_spreader() -> None:
    load = LoadDetails(lifting_points=SQUARE)
    leaning = Slings(number=4, length=4.0, angle=math.radians(60.0))
    assert rigging_height(details(load, leaning)) == pytest.approx(2.0)
    assert rigging_height(details(load, leaning, Spreader(height=0.4))) == pytest.approx(2.4)
    assert rigging_height(details(load, leaning, Spreader())) is None
    # Without a length: √5 m aside at 45°.
    steep = Slings(number=4, angle=math.radians(45.0))
    assert rigging_height(details(load, steep)) == pytest.approx(math.sqrt(5.0))
    assert rigging_height(details(LoadDetails(), steep)) is None
    assert rigging_height(details(load, Slings())) is None
    box = np.array([[-1.0, -1.0, -0.6], [1.0, 1.0, 0.6]])
    assert attachment_height(details(load, leaning), box) == 0.5
    assert attachment_height(details(LoadDetails(), leaning), box) == 0.6


def test_a_load_in_legs_of_one_length_turns_until_its_centre_is_plumb_below_the_hook() -> None:
    """Legs of 3 m on points √5 m aside meet 2 m above them. The centre, 1 m below the points and
    0.25 m aside, is 3 m below the hook: tan of the tilt is a twelfth.
    """
    slings = Slings(number=4, length=3.0)
    level = LoadDetails(centre=(0.0, 0.0, 0.0), lifting_points=SQUARE)
    assert tilt(details(level, slings)) == pytest.approx(0.0, abs=1e-12)
    aside = LoadDetails(centre=(0.0, 0.25, -0.5), lifting_points=SQUARE)
    assert tilt(details(aside, slings)) == pytest.approx(math.atan(1.0 / 12.0))
    # Two legs: the hook is above the middle between the points.
    two = LoadDetails(centre=(0.0, 0.25, 0.0), lifting_points=((0.0, -2.0, 0.5), (0.0, 2.0, 0.5)))
    hook = math.sqrt(9.0 - 4.0)
    found = tilt(details(two, Slings(number=2, length=3.0)))
    assert found == pytest.approx(math.atan(0.25 / (hook + 0.5)))
    assert tilt(details(aside, slings, Spreader())) is None
    assert tilt(details(LoadDetails(lifting_points=SQUARE), slings)) is None


@pytest.mark.parametrize(
    ("number", "degrees", "of_leg", "of_set"),
    [
        # EN 818-4, chains of 10 mm of grade 8: 3.15 t a leg; 4.25 t for two legs, 6.7 t for three
        # or four up to 45°, 3.15 t and 4.75 t up to 60°, all rounded there to steps of their own.
        (1, 0.0, 3150.0, 3150.0),
        (2, 45.0, 4250.0 / 1.4, 4250.0),
        (2, 46.0, 4250.0 / 1.4, 3150.0),
        (3, 45.0, 6700.0 / 2.1, 6700.0),
        (4, 60.0, 6700.0 / 2.1, 4750.0),
    ],
)
def test_the_tag_of_a_set_has_the_limit_of_a_leg_times_the_factor_of_the_standard(
    number: int, degrees: float, of_leg: float, of_set: float
) -> None:
    on_tag = {1: 3150.0, 2: 4250.0, 3: 6700.0, 4: 6700.0}[number]
    slings = Slings(number=number, set_limit=on_tag)
    assert leg_limit(slings) == pytest.approx(of_leg)
    assert leg_limit(slings) == pytest.approx(3150.0, rel=0.04)
    found = set_limit_at(slings, math.radians(degrees))
    assert found == pytest.approx(of_set, rel=0.04)
    assert leg_limit(Slings(number=number, limit=3150.0)) == 3150.0
    assert set_limit_at(Slings(number=number, limit=3150.0), 0.0) is None
    assert leg_limit(Slings(set_limit=on_tag)) is None  # nobody entered how many legs it has
