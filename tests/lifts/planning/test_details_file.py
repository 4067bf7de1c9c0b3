"""What a site's file enters for a lift plan, and how what cannot be meant is refused."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path

import numpy as np
import pytest

from cranedyn.errors import CraneError, DataError
from cranedyn.lifts.planning.ground_lift import _refuse_unless_a_box
from cranedyn.lifts.planning.lift import NoWay
from cranedyn.lifts.planning.plan_details import (
    CraneDocuments,
    GroundDetails,
    Job,
    LoadDetails,
    PlanDetails,
    SiteLimits,
    Slings,
    Spreader,
)
from cranedyn.lifts.planning.plausibility import is_limit_of_a_set
from cranedyn.lifts.planning.site import Site
from cranedyn.lifts.planning.site_file import SITES, read_site

WHOLE = """
[job]
site = "yard"
number = 12
date = 2027-03-01
[people]
prepared = "A. Nybody"
[crane]
maker = "maker"
jib_length = 22.0
counter_ballast = 3000.0
height_under_hook = 26.0
wind_limit = 20.0
corner_in_service = 300.0
[ground]
height = 0.0
permitted_pressure = 150.0
mat = [2.0, 1.5]
[load]
size = [1.5, 3.0, 1.2]
mass = 870.0
source = "weighed"
centre = [0.1, -0.2, -0.1]
lifting_points = [[0.0, -1.2, 0.6], [0.0, 1.2, 0.6]]
area = 4.0
drag = 1.3
[rigging]
hook = 100.0
hook_height = 0.9
hook_limit = 3000.0
falls = 2
[rigging.slings]
mass = 30.0
type = "chain"
number = 2
length = 3.0
angle = 25.0
limit = 2000.0
[rigging.spreader]
mass = 50.0
height = 0.3
limit = 3000.0
[limits]
chart_share = 85.0
over_people = false
[safety]
exclusion = "barriers"
contingency = ["set down", "wait"]
"""


def read(tmp_path: Path, text: str = WHOLE) -> Site:
    file = tmp_path / "site.toml"
    file.write_text(text, encoding="utf-8")
    return read_site(file)


def test_a_lift_plan_is_what_its_tables_enter_in_si_units(tmp_path: Path) -> None:
    found = read(tmp_path)
    details = found.details
    assert details.job == Job(site="yard", number="12", date="2027-03-01")
    assert details.people.prepared == "A. Nybody" and details.people.approved is None
    assert details.crane == CraneDocuments(
        maker="maker",
        jib_length=22.0,
        counter_ballast=3000.0,
        height_under_hook=26.0,
        wind_limit=20.0,
        corner_in_service=300e3,
    )
    assert details.load == LoadDetails(
        "weighed", (0.1, -0.2, -0.1), ((0.0, -1.2, 0.6), (0.0, 1.2, 0.6)), 4.0, 1.3
    )
    angle = math.radians(25.0)
    assert details.slings == Slings("chain", 2, angle, 3.0, 2000.0)
    assert details.spreader == Spreader(height=0.3, limit=3000.0)
    assert details.hook_block_height == 0.9 and details.hook_block_limit == 3000.0
    assert details.ground == GroundDetails(150e3, None, 2.0, 1.5)
    assert details.limits == SiteLimits(chart_share=0.85, over_people=False)
    assert (details.exclusion, details.contingency) == ("barriers", ("set down", "wait"))
    # All of the rigging hangs with the load.
    assert found.rigging == {"hook": 100.0, "slings": 30.0, "spreader": 50.0}
    assert found.crane["payload_mass"] == 1050.0
    assert "[rigging.slings] angle" in found.entered
    # The rope is above the centre of gravity, so that the box is beside it.
    assert found.load is not None
    middle = (found.load.min(axis=0) + found.load.max(axis=0)) / 2.0
    np.testing.assert_allclose(middle, [-0.1, 0.2, 0.0], atol=1e-12)


def test_what_nobody_entered_has_no_value(tmp_path: Path) -> None:
    found = read(tmp_path, "[ground]\nheight = 0.0\n[rigging]\n[rigging.slings]\n")
    assert found.details == PlanDetails() and found.rigging == {}


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('site = "yard"', "site = 1.5", "[job] site: site is 1.5; allowed is a printable text"),
        ('prepared = "A. Nybody"', 'prepered = "x"', "[people] prepered: There is no field"),
        ('"weighed"', '"weighted"', "[load] source: There is no source 'weighted'"),
        ('"chain"', '"rope"', "[rigging.slings] type: There is no type 'rope'"),
        ("number = 2\n", "number = 0\n", "[rigging.slings] number: number is 0"),
        ("angle = 25.0", "angle = 95.0", "angle is 95.0 degrees; allowed is 0 to 85"),
        ("angle = 25.0", "angel = 25.0", "line 37, [rigging.slings] angel: There is no field"),
        ("limit = 2000.0", "limit = 2000.0\nset_limit = 2800.0", "set_limit: limit is given, too"),
        ("number = 2\n", "number = 5\nset_limit = 9.0\n", "set_limit: limit is given, too"),
        ("\nlimit = 3000.0", "\nlimit = -1.0", "[rigging.spreader] limit: limit is -1.0 kg"),
        ("mat = [2.0, 1.5]", "mat = [2.0]", "[ground] mat: mat is '[2.0]'; allowed is 2 numbers"),
        (
            "[crane]",
            "[counter_jib]\nlength = 9.4\n[crane]\nvalues = {counter_jib = 9.4}",
            "entered twice: here, and as counter_jib = 9.4 in the values of [crane]. Keep this",
        ),
        ("over_people = false", "over_people = 0", "over_people: allowed is true or false"),
        ("[0.0, 1.2, 0.6]]", "[0.0, 1.2]]", "lifting_points: point of lifting_points is"),
        ('["set down", "wait"]', "3", "[safety] contingency: contingency is 3"),
        ("centre = [0.1", "centre = [100.0", "[load] centre: The centre of gravity (100, -0.2"),
        ("[0.0, 1.2, 0.6]]", "[0.0, 1200, 600]]", "lifting_points: The lifting point (0, 1200"),
        ("= 150.0", "= 150000.0", "Is 150,000 in pascals? Then write 150."),
        ("= 150.0", "= 0.15", "Is 0.15 in newtons per square millimetre? Then write 150."),
        ("chart_share = 85.0", "chart_share = 0.85", "Is 0.85 in parts of 1? Then write 85."),
        ("= 22.0", "= 22000.0", "jib_length: The length of the jib is 22,000 m"),
        ("\n[rigging.spreader]\nmass = 50.0\n", "\n[rigging]\n", "is not TOML"),
    ],
)
def test_what_is_wrong_in_a_lift_plan_is_said_with_its_field_and_the_likely_mistake(
    tmp_path: Path, old: str, new: str, sentence: str
) -> None:
    assert WHOLE.count(old) >= 1
    with pytest.raises(CraneError, match=re.escape(sentence)):
        read(tmp_path, WHOLE.replace(old, new, 1))


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("limit = 2000.0", "limit = 2.0", "Is 2 in tonnes? Then write 2000."),
        ("limit = 2000.0", "set_limit = 2.8", "Is 2.8 in tonnes? Then write 2800."),
        (
            "[job]",
            "[drives]\nrates = [0.8, 1.5, 1.0]\naccelerations = [1.0, 0.4, 0.4]\n[job]",
            "Is 0.8 in revolutions per minute? Then write 4.8.",
        ),
        ("counter_ballast = 3000.0", "counter_ballast = 3.0", "Is 3 in tonnes? Then write 3000."),
        ("angle = 25.0", "angle = 0.44", "Is 0.44 in radians? Then write 25.2"),
        ("wind_limit = 20.0", "wind_limit = 72.0", "Is 72 in kilometres per hour? Then write 20."),
        ("hook_height = 0.9", "hook_height = 90.0", "possible is 0.001 to 50"),
        ("area = 4.0", "area = 9.0", "the largest section of its box has 4.02492 m²"),
        ("area = 4.0", "area = 0.04", "the largest section of its box has 4.02492 m²"),
    ],
)
def test_what_is_unusual_in_a_lift_plan_asks_for_the_likely_mistake(
    tmp_path: Path, old: str, new: str, sentence: str
) -> None:
    text = WHOLE.replace(old, new, 1)
    try:
        found = " ".join(read(tmp_path, text).unusual)
    except DataError as error:
        found = str(error)
    assert sentence in found


def test_an_angle_from_the_horizontal_is_seen_by_the_length_of_the_leg(tmp_path: Path) -> None:
    """Legs of 3 m to points 1.4 m and 1.0 m along, with the centre 0.1 m aside, lean by 28°; 62° is
    the rest of a right angle.
    """
    no_spreader = WHOLE[: WHOLE.index("[rigging.spreader]")] + WHOLE[WHOLE.index("[limits]") :]
    assert read(tmp_path, no_spreader).unusual == ()
    (sentence,) = read(tmp_path, no_spreader.replace("angle = 25.0", "angle = 60.0")).unusual
    assert "from its length and the lifting points it is 28°" in sentence
    (sentence,) = read(tmp_path, no_spreader.replace("number = 2", "number = 4")).unusual
    assert "There are 4 legs and 2 lifting points" in sentence


def test_what_stands_in_the_zone_is_cleared_by_its_name(tmp_path: Path) -> None:
    box = '[[box]]\nname = "site office"\ncentre = [9.0, 9.0]\nsize = [1.0, 1.0, 1.0]\n'
    said = WHOLE.replace("[safety]\n", '[safety]\nin_zone = { "site*" = "it is emptied" }\n')
    details = read(tmp_path, said + box).details
    assert details.done_about("site office") == "it is emptied"
    assert details.done_about("shed") is None
    exact = read(tmp_path, said.replace('"site*"', '"site office"') + box).details
    assert exact.done_about("site office") == "it is emptied"
    assert exact.done_about("site office 2") is None
    for wrong, sentence in (
        ('{ "ofice" = "empty" }', "no obstacle has the name ofice"),
        ('{ "" = "all are empty" }', "no obstacle has the name"),
        ('{ "site" = "it is emptied" }', "no obstacle has the name site."),
        ('{ "site office" = "" }', "a printable text"),
        ('"it is emptied"', "a table of sentences by name"),
    ):
        text = said.replace('{ "site*" = "it is emptied" }', wrong) + box
        with pytest.raises(DataError, match=re.escape(sentence)):
            read(tmp_path, text)


def test_a_set_has_as_many_legs_as_a_standard_has(tmp_path: Path) -> None:
    five = WHOLE.replace("number = 2\n", "number = 5\n").replace("limit = 2000", "set_limit = 2000")
    with pytest.raises(DataError, match=re.escape("a set has 1 to 4 legs, and number is 5")):
        read(tmp_path, five)


@pytest.mark.parametrize(
    ("number", "limit", "asked"),
    [
        # Chains of grade 8 by EN 818-4: 10 mm lift 3.15 t on a leg, 4.25 t on two, 6.7 t on four.
        (2, 3150.0, False),
        (2, 4250.0, True),
        (4, 4250.0, True),
        (4, 2000.0, False),
        (1, 4250.0, False),
        (2, 17000.0, True),
        (2, 11200.0, False),  # a chain of 19 mm lifts it on one leg
        (4, 6700.0, False),
    ],
)
def test_a_limit_of_a_leg_that_only_a_set_has_is_asked_about(
    number: int, limit: float, asked: bool
) -> None:
    assert is_limit_of_a_set(Slings("chain", number, limit=limit)) is asked
    assert not is_limit_of_a_set(Slings("webbing", number, limit=limit))


def test_a_limit_that_only_a_set_has_is_unusual(tmp_path: Path) -> None:
    (sentence,) = read(tmp_path, WHOLE.replace("limit = 2000.0", "limit = 2120.0")).unusual
    assert "Is it that of the set? Then write it as set_limit." in sentence
    assert read(tmp_path, WHOLE.replace("limit = 2000.0", "set_limit = 2120.0")).unusual == ()


def test_a_load_that_stands_hangs_below_the_middle_of_its_box() -> None:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-2, 2) for z in (-1, 1)]) * 0.5
    _refuse_unless_a_box(corners + np.array([0.009, 0.0, 0.0]))
    with pytest.raises(NoWay, match=re.escape("is 0.20 m beside it in plan")):
        _refuse_unless_a_box(corners + np.array([0.0, 0.2, 0.0]))


def test_the_example_of_a_lift_plan_leaves_no_field_empty() -> None:
    details = read_site(SITES / "signed_lift.toml").details
    for part in dataclasses.fields(details):
        value = getattr(details, part.name)
        if part.name in ("spreader", "shift"):
            continue  # that lift has no spreader, and is of no shift
        assert value, part.name
        if dataclasses.is_dataclass(value):
            for field in dataclasses.fields(value):
                if field.name == "set_limit":
                    continue  # that of one leg is entered instead
                entered = getattr(value, field.name)
                assert entered is not None and entered != (), f"{part.name} {field.name}"
