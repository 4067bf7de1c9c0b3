"""What a lift plan adds to a judgement, by hand numbers: slings, heights, ground, wind, category,
positions and steps; and that what nobody entered is an empty field and no tick.
"""

from __future__ import annotations

import itertools
import math
import re
from dataclasses import replace
from functools import cache
from html import unescape

import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
pytest.importorskip("toppra", reason="extra planning (toppra) is not installed")

from cranedyn.assumptions import Origin
from cranedyn.lifts.judging.analysis import LiftAnalysis, Requirements
from cranedyn.lifts.judging.judged_inputs import resolve_inputs
from cranedyn.lifts.judging.judgement import Judgement, judge
from cranedyn.lifts.judging.lift_checks import (
    corners_pressed,
    run_checks,
    utilisation_below_warning,
    wind_borne,
)
from cranedyn.lifts.judging.lift_positions import lift_category, lift_positions
from cranedyn.lifts.judging.lift_tables import at_least, tables
from cranedyn.lifts.judging.numbered_positions import numbered_positions
from cranedyn.lifts.judging.plan_checks import (
    bearing_pressure,
    centre_between_lifting_points,
    corner_range,
    ground_bears,
    gust_below_all_limits,
    headroom,
    hook_block_bears,
    jib_as_long_as_entered,
    not_checked,
    papers_bear,
    plan_checks,
    rope_above_hook_block,
    sling_force,
    slings_bear,
    spreader_bears,
)
from cranedyn.lifts.judging.plan_fields import (
    PlanField,
    counting_assumptions,
    field_groups,
    identification,
    other_assumptions,
    signatures,
)
from cranedyn.lifts.judging.plan_tables import positions_table, sequence_table, wind_bounds_table
from cranedyn.lifts.judging.report_page import first_page_notices
from cranedyn.lifts.judging.sequence import LiftStep, all_steps, lift_steps
from cranedyn.lifts.planning.clearance import Nearest
from cranedyn.lifts.planning.perturbed import DRAG_COEFFICIENT, drag_area
from cranedyn.lifts.planning.plan_details import (
    CraneDocuments,
    GroundDetails,
    Job,
    LoadDetails,
    People,
    PlanDetails,
    SiteLimits,
    Slings,
    Spreader,
    WeightSource,
)
from cranedyn.lifts.planning.site_file import read_site
from tests.lifts.judging.test_judgement import small
from tests.lifts.planning.sites import certificate, clearance, lift

pytestmark = pytest.mark.slow

POINTS = ((-0.5, -0.5, 0.5), (0.5, -0.5, 0.5), (0.5, 0.5, 0.5), (-0.5, 0.5, 0.5))
"""Lifting points on the top of the load, which is a cube of 1 m."""


@cache
def bare() -> LiftAnalysis:
    """The lift over a wall, whose load, hook block and slings weigh 1,000 kg."""
    made = small()
    site = replace(made.site, rigging={"hook": 100.0, "slings": 30.0})
    return replace(made, site=site)


def planned(**details: object) -> LiftAnalysis:
    """The lift with details of its plan."""
    site = replace(bare().site, details=PlanDetails(**details))  # type: ignore[arg-type]
    return replace(bare(), site=site)


def pulling(analysis: LiftAnalysis, weights: float) -> LiftAnalysis:
    """The lift as if the rope pulled with some times the weight of all that hangs."""
    pull = np.full_like(analysis.loads.t, weights * 1000.0 * analysis.crane.gravity)
    values = {**analysis.loads.values, "rope_N": pull}
    return replace(analysis, loads=replace(analysis.loads, values=values))


def test_a_leg_carries_half_of_what_hangs_in_the_slings_over_the_cosine_of_its_angle() -> None:
    """1.3 for the tolerance, 1.1 for dynamics, 900 kg without the hook block: at 60° a leg of four
    carries 900 · 1.43 · ½ / cos 60° = 1,287 kg.
    """
    slings = Slings(number=4, angle=math.radians(60.0), limit=1300.0)
    found = pulling(planned(slings=slings), 1.1)
    leg = sling_force(found)
    assert leg is not None
    assert leg.force / found.crane.gravity == pytest.approx(1287.0)
    assert leg.utilisation == pytest.approx(1287.0 / 1300.0)
    check = slings_bear(found)
    assert check is not None and check.holds is True
    assert (
        "pulls with 1.29 t at most, 99 % of its working load limit of 1.30 t, entered as"
        in check.sentence
    )
    for changes in ({"limit": 1286.0}, {"angle": math.radians(61.0), "limit": 5000.0}):
        refused = slings_bear(pulling(planned(slings=replace(slings, **changes)), 1.1))
        assert refused is not None and refused.holds is False


def test_a_set_is_judged_by_its_leg_and_by_its_tag() -> None:
    """900 · 1.43 kg = 1,287 kg hang in the slings. At 60° a leg of four pulls with as much, so that
    the set needs a tag of 2.1 times that. At 20° two legs are limited by their tag: a leg pulls
    with ½ · 1,287 kg / cos 20°, three quarters of what it may of a tag of 1,287 kg.
    """
    steep = Slings(number=4, angle=math.radians(60.0), set_limit=2.1 * 1288.0)
    for limit, holds in ((2.1 * 1288.0, True), (2.1 * 1286.0, False)):
        check = slings_bear(pulling(planned(slings=replace(steep, set_limit=limit)), 1.1))
        assert check is not None and check.holds is holds, check.sentence
        assert "follows from 2.70 t on the tag of the set" in check.sentence
    upright = Slings(number=2, angle=math.radians(20.0), set_limit=1288.0)
    for limit, holds in ((1288.0, True), (1286.0, False)):
        found = pulling(planned(slings=replace(upright, set_limit=limit)), 1.1)
        check = slings_bear(found)
        assert check is not None and check.holds is holds, check.sentence
        leg = sling_force(found)
        assert leg is not None and leg.force < 0.8 * leg.limit
        assert leg.utilisation == pytest.approx(1287.0 / limit)


@pytest.mark.parametrize(
    ("slings", "shown", "hidden"),
    [
        (Slings(number=2, angle=0.5, limit=2000.0), "<dt>WLL of one leg</dt><dd>2.00 t<", "tag"),
        (
            Slings(number=2, angle=0.5, set_limit=2800.0),
            "<dt>WLL of the set, on its tag</dt><dd>2.80 t up to 45°<",
            "<dd>2.80 t<",
        ),
    ],
)
def test_the_page_says_whether_a_limit_is_of_a_leg_or_of_a_set(
    monkeypatch: pytest.MonkeyPatch, slings: Slings, shown: str, hidden: str
) -> None:
    monkeypatch.setattr(Judgement, "figures", {})
    found = planned(slings=slings)
    page = unescape(Judgement(found, run_checks(found)).html())
    assert shown in page and hidden not in page.split("<dt>Slings</dt>")[1].split("Headroom")[0]


def test_dynamics_of_the_simulated_lift_are_in_the_force_of_a_leg() -> None:
    """The hoist accelerates by up to 0.4 m/s², 4 % of gravity."""
    found = planned(slings=Slings(number=1, limit=1e4))
    leg = sling_force(found)
    assert leg is not None
    static = 1.3 * 900.0 * found.crane.gravity
    assert static < leg.force < (1.005 + 0.4 / 9.80665) * static


def test_an_eccentric_load_is_on_the_leg_that_it_is_nearest_to() -> None:
    """A quarter of a metre aside both ways, of points half a metre aside, is three quarters on one
    leg and a quarter on the opposite one.
    """
    load = LoadDetails(centre=(0.25, 0.25, 0.0), lifting_points=POINTS)
    slings = Slings(number=4, angle=0.0, limit=1e4)
    leg = sling_force(pulling(planned(slings=slings, load=load), 1.0))
    assert leg is not None and leg.share == pytest.approx(0.75)


@pytest.mark.parametrize(
    ("slings", "missing"),
    [
        (Slings(number=2, angle=0.5), "limit"),
        (Slings(limit=1e3, angle=0.5), "number"),
        (Slings(number=2, limit=1e3), "angle, or length beside"),
    ],
)
def test_slings_of_which_a_part_is_entered_are_not_judged(slings: Slings, missing: str) -> None:
    check = slings_bear(planned(slings=slings))
    assert check is not None and check.holds is None and missing in check.sentence


def test_a_hook_block_carries_all_that_hangs_below_it() -> None:
    for limit, holds in ((1171.0, True), (1169.0, False)):
        check = hook_block_bears(pulling(planned(hook_block_limit=limit), 1.0))
        assert check is not None and check.holds is holds  # 1.3 · 900 kg
        assert "of its rated load of 1.17 t" in check.sentence
    assert hook_block_bears(planned()) is None
    (missing,) = [s for s in not_checked(planned(), []) if s.startswith("The hook block:")]
    assert "lacks hook_limit" in missing


def test_a_limit_that_is_too_small_for_tonnes_is_shown_in_kilograms() -> None:
    slings = Slings(number=2, angle=0.5, limit=1.5)
    check = slings_bear(planned(slings=slings))
    assert check is not None and check.holds is False
    assert "of its working load limit of 1.5 kg" in check.sentence


def test_a_spreader_carries_load_and_slings() -> None:
    for limit, holds in ((1171.0, True), (1169.0, False), (None, None)):
        found = pulling(planned(spreader=Spreader(limit=limit)), 1.0)
        check = spreader_bears(found)
        assert check is not None and check.holds is holds  # 1.3 · 900 kg


@pytest.mark.parametrize(
    ("centre", "holds", "words"),
    [
        ((0.0, 0.0, 0.0), True, "one may carry 50 % of the weight; with all legs of one length"),
        ((0.6, 0.0, 0.0), False, "outside of the lifting points in plan"),
        ((0.0, 0.0, 0.7), None, "0.20 m above a lifting point"),
    ],
)
def test_a_centre_of_gravity_is_between_its_lifting_points_and_below_them(
    centre: tuple[float, float, float], holds: bool | None, words: str
) -> None:
    load = LoadDetails(centre=centre, lifting_points=POINTS)
    check = centre_between_lifting_points(planned(load=load, slings=Slings(number=4, length=2.0)))
    assert check is not None and check.holds is holds and words in check.sentence


def test_the_hook_stays_below_its_largest_height_and_the_block_below_the_jib() -> None:
    """The cable ends in the middle of the load, 28 m below the pivot less its length. The load is
    0.5 m high from there, the slings √(4 - 0.5) m: legs of 2 m to points 1/√2 m aside.
    """
    shortest = float(certificate().run.q[:, 4].min())
    rigging = math.sqrt(3.5)
    hook = 28.0 - shortest + 0.5 + rigging
    load = LoadDetails(lifting_points=POINTS)
    slings = Slings(number=4, length=2.0)
    for height, holds in ((hook + 0.51, True), (hook + 0.49, False)):
        crane = CraneDocuments(height_under_hook=height)
        check = headroom(planned(load=load, slings=slings, crane=crane))
        assert check is not None and check.holds is holds  # the cable may be wrong by 0.5 m
        assert f"rises to {hook:.2f} m above the foot" in check.sentence
    unknown = headroom(planned(crane=CraneDocuments(height_under_hook=30.0)))
    assert unknown is not None and unknown.holds is None

    left = shortest - 0.5 - rigging
    for block, holds in ((left - 0.51, True), (left - 0.49, False)):
        check = rope_above_hook_block(planned(load=load, slings=slings, hook_block_height=block))
        assert check is not None and check.holds is holds
    unknown = rope_above_hook_block(planned(hook_block_height=1.0))
    assert unknown is not None and unknown.holds is None


def test_the_ground_bears_the_largest_corner_force_on_the_area_of_a_mat() -> None:
    forces = corner_range(bare())
    assert forces is not None
    pressure = forces.largest / 3.0
    for permitted, holds in ((1.001 * pressure, True), (0.999 * pressure, False)):
        ground = GroundDetails(permitted, None, 2.0, 1.5)
        check = ground_bears(planned(ground=ground))
        assert check is not None and check.holds is holds
        assert f"{pressure / 1e3:.0f} kPa at most" in check.sentence
    no_mat = ground_bears(planned(ground=GroundDetails(permitted_pressure=1e5)))
    assert no_mat is not None and no_mat.holds is None and "[ground] lacks mat" in no_mat.sentence
    no_base = planned(ground=GroundDetails(1e9, None, 2.0, 1.5))
    no_base = replace(no_base, site=replace(no_base.site, base=None))
    unknown = ground_bears(no_base)
    assert unknown is not None and unknown.holds is None


def test_a_permitted_pressure_takes_the_place_of_a_permitted_force() -> None:
    made = planned(ground=GroundDetails(1e9, None, 2.0, 2.0))
    assert made.site.base is not None
    made = replace(made, site=replace(made.site, base=replace(made.site.base, permitted=None)))
    corners = corners_pressed(made)
    assert corners.holds is True and "judged by its pressure" in corners.sentence


@pytest.mark.parametrize(
    ("in_service", "out_of_service", "holds", "words"),
    [
        (300e3, 380e3, True, "with 300 kN in service and 380 kN out of service, wind on the crane"),
        (300e3, 401e3, False, "400 kN permitted"),
        (401e3, 300e3, False, "400 kN permitted"),
        (300e3, None, None, "400 kN permitted. Out of service it is not judged: [crane] lacks"),
        (
            401e3,
            None,
            False,
            "with 401 kN in service, wind on the crane included; 400 kN permitted",
        ),
        (None, 300e3, None, "400 kN permitted. In service it is not judged: [crane] lacks"),
        (None, 401e3, False, "400 kN permitted"),
    ],
)
def test_the_ground_bears_what_the_papers_have_with_wind(
    in_service: float | None, out_of_service: float | None, holds: bool | None, words: str
) -> None:
    """The base of the crane permits 400 kN."""
    crane = CraneDocuments(corner_in_service=in_service, corner_out_of_service=out_of_service)
    check = papers_bear(planned(crane=crane))
    assert check is not None and check.holds is holds and words in check.sentence


@pytest.mark.parametrize(("in_service", "holds"), [(300e3, True), (401e3, False), (None, None)])
def test_a_crane_that_is_laid_down_needs_no_force_out_of_service(
    in_service: float | None, holds: bool | None
) -> None:
    crane = CraneDocuments(corner_in_service=in_service, out_of_service="boom laid down")
    made = planned(crane=crane)
    check = papers_bear(made)
    if in_service is None:
        assert check is None
    else:
        assert check is not None and check.holds is holds
        assert "Out of service it is not judged; the crane is left so: boom laid down." in (
            check.sentence
        )
    ground = next(group for group in field_groups(made) if group.title == "Ground")
    values = {entry.label: entry.value for entry in ground.fields}
    assert values["By the papers, out of service"] == "not judged: boom laid down"


def test_papers_with_less_force_than_the_lift_has_without_wind_are_of_another_crane() -> None:
    calm = max(float(planned().loads[f"corner_{i}_N"].max()) for i in range(1, 5))
    for force, holds in ((0.99 * calm, False), (1.01 * calm, True)):
        crane = CraneDocuments(corner_in_service=force, corner_out_of_service=390e3)
        check = papers_bear(planned(crane=crane))
        assert check is not None and check.holds is holds
        assert ("The papers are of another crane" in check.sentence) is not holds


def test_the_first_page_has_the_largest_pressure_that_is_known() -> None:
    """On mats of 2 by 1.5 m; without wind a corner presses with less than 100 kN per m²."""
    ground = GroundDetails(200e3, None, 2.0, 1.5)
    calm = bearing_pressure(planned(ground=ground))
    assert calm is not None and calm < 100e3
    for in_service, out_of_service, row in (
        (None, None, ["calm air", f"{calm / 1e3:.0f} kPa"]),
        (330e3, None, ["in service, papers", "110 kPa"]),
        (330e3, 360e3, ["out of service, papers", "120 kPa"]),
        (3e3, None, ["calm air", f"{calm / 1e3:.0f} kPa"]),
    ):
        crane = CraneDocuments(corner_in_service=in_service, corner_out_of_service=out_of_service)
        numbers = tables(planned(ground=ground, crane=crane))[0]
        (found,) = [r for r in numbers.rows if str(r[0]).startswith("pressure on the ground")]
        assert found == [f"pressure on the ground, {row[0]}", row[1], "200 kPa"]


def test_the_pressure_with_wind_is_that_of_the_papers_on_the_mat() -> None:
    crane = CraneDocuments(corner_in_service=240e3, corner_out_of_service=300e3)
    for permitted, holds in ((100.1e3, True), (99.9e3, False)):
        ground = GroundDetails(permitted, None, 2.0, 1.5)
        check = papers_bear(planned(crane=crane, ground=ground))
        assert (
            check is not None and check.holds is holds and "100 kPa below a mat" in check.sentence
        )
    no_mat = papers_bear(planned(crane=crane, ground=GroundDetails(permitted_pressure=1e5)))
    assert no_mat is not None and no_mat.holds is None


def test_the_first_page_says_that_forces_on_the_ground_are_without_wind(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Judgement, "figures", {})
    crane = CraneDocuments(corner_in_service=240e3, corner_out_of_service=300e3)
    for found, words in (
        (bare(), "With wind, in service and out of service, the ground is not judged"),
        (planned(crane=crane), "those of its papers count"),
    ):
        page = unescape(Judgement(found, run_checks(found)).html())
        assert words in page[: page.index("Sign-off")]


def test_each_corner_of_the_base_has_its_forces() -> None:
    """The load goes from (6, -12) to (6, 12) m: the corner at +x, -y presses most when it is picked
    up, and that at +x, +y when it is set down.
    """
    ground = next(group for group in field_groups(bare()) if group.title == "Ground")
    forces = {}
    for field in ground.fields[:4]:
        assert field.value is not None
        largest = re.fullmatch(r"(\d+) to (\d+) kN", field.value)
        assert largest is not None
        forces[field.label.split(" of the site")[0]] = float(largest[2])
    assert forces["Corner at +x, +y"] == pytest.approx(forces["Corner at +x, −y"], rel=0.05)
    assert forces["Corner at +x, +y"] > 1.1 * forces["Corner at −x, −y"]
    no_base = replace(bare(), site=replace(bare().site, base=None))
    ground = next(group for group in field_groups(no_base) if group.title == "Ground")
    assert ground.fields[0] == PlanField("Force of each corner", None)


def test_tag_lines_trial_lift_ballast_and_storm_are_fields_to_be_filled_in() -> None:
    labels = ("Tag lines", "Trial lift", "Central ballast", "How it is left out of service")
    crane = CraneDocuments(central_ballast=40e3, out_of_service="brake open", examined="4711")
    entered = planned(
        crane=crane, tag_lines="two", trial_lift="0.3 m high", rigging_examined="4712"
    )
    of_entered = {f.label: f.value for group in field_groups(entered) for f in group.fields}
    assert of_entered["Thoroughly examined"] == "4711"
    assert of_entered["Accessories thoroughly examined"] == "4712"
    for found, values in ((bare(), [None] * 4), (entered, ["two", "0.3 m high", "40.00 t", None])):
        fields = {f.label: f.value for group in field_groups(found) for f in group.fields}
        shown = [fields[label] for label in labels]
        assert shown[:3] == values[:3]
        assert shown[3] == (None if found is bare() else "brake open")


def test_the_least_limit_of_the_wind_counts() -> None:
    """The lift is simulated in gusts up to 8 m/s and must be possible in 8 m/s."""
    for maker, site, holds, whose in (
        (20.0, 12.0, True, "this load, by its area, 8 m/s (29 km/h)"),
        (7.0, 12.0, False, "the maker of the crane, 7 m/s (25 km/h)"),
        (20.0, 7.5, False, "the site, 7.5 m/s (27 km/h)"),
    ):
        found = planned(crane=CraneDocuments(wind_limit=maker), limits=SiteLimits(wind=site))
        check = gust_below_all_limits(found)
        assert check is not None and check.holds is holds and whose in check.sentence
        rows = wind_bounds_table(found).rows
        # The least has a row of its own before the three.
        assert rows[0][:2] == ["the least that is known: stop here", min(maker, site, 8.0)]
        assert [row[1] for row in rows[1:]] == sorted([maker, site, 8.0])


def test_limits_of_other_makers_are_left_out_beside_that_of_this_crane() -> None:
    for maker, is_there in ((9.0, False), (None, True)):
        made = {
            table.title: table for table in tables(planned(crane=CraneDocuments(wind_limit=maker)))
        }
        names = [str(row[0]) for row in made["Wind limits in comparison"].rows]
        assert any("a maker's manual" in name for name in names) is is_there


def test_what_counts_on_the_day_is_what_people_can_watch() -> None:
    made = judge_inputs_entered()
    watched = {assumption.field for assumption in counting_assumptions(made)}
    assert {"[lift] swing", "[lift] distance", "[wind] gust", "[uncertainty] wind"} <= watched
    others = {assumption.field for assumption in other_assumptions(made)}
    assert {"[lift] risk", "[uncertainty] delay", "[uncertainty] cable"} <= others


def judge_inputs_entered() -> LiftAnalysis:
    """The lift with all of its assumptions entered."""
    made = bare()
    entered = [replace(a, origin=Origin.ENTERED) for a in made.inputs.assumptions]
    return replace(made, inputs=replace(made.inputs, assumptions=tuple(entered)))


def test_the_first_page_counts_what_was_entered_and_lists_the_rest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """All of it has no room there beside the reasons of a plan that is not complete."""
    monkeypatch.setattr(Judgement, "figures", {})
    made = bare()
    page = unescape(Judgement(made, run_checks(made)).html())
    cover = page[: page.index("Sign-off")]
    others = other_assumptions(made)
    entered = [a for a in others if a.origin is Origin.ENTERED]
    assert f"and on {len(entered)} more that were entered" in cover
    for assumption in others:
        listed = f"{assumption.name}: {assumption.value}" in cover
        assert listed is (assumption.origin is not Origin.ENTERED), assumption


def test_a_distance_that_suffices_is_said_to_be_a_bound() -> None:
    assert at_least(0.5, 0.5) == "at least 0.50"
    assert at_least(0.49, 0.5) == "0.49"
    wind = bare().wind
    assert wind is not None
    near = replace(wind, worst={**wind.worst, "clearance": np.array([2.0, 0.1])})
    (table,) = [t for t in tables(replace(bare(), wind=near)) if t.title == "Wind"]
    column = [header for header, _ in table.columns].index("clearance [m]")
    assert [row[column] for row in table.rows] == ["at least 2.00", "0.10"]


def test_the_people_at_both_ends_are_fields_to_fill_in() -> None:
    people = People(receiver="R. Eceiver", guard="G. Uard", second_signaller="S. Econd")
    for entered, values in (
        (people, ["G. Uard", "R. Eceiver", "S. Econd"]),
        (People(), [None, None, None]),
    ):
        group = field_groups(planned(people=entered))[-1]
        named = {entry.label: entry.value for entry in group.fields}
        labels = ("Guards the exclusion zone", "Receives the load", "Second signaller")
        assert [named[label] for label in labels] == values
        signed = {entry.label: entry.value for entry in signatures(planned(people=entered))}
        labels = ("Guards the zone", "Receives the load", "Second signaller")
        assert [signed[label] for label in labels] == values


def test_a_load_that_is_seen_all_the_way_needs_no_second_signaller() -> None:
    for blind, fields in ((None, 1), (True, 1), (False, 0)):
        found = planned(limits=SiteLimits(blind=blind))
        for group in (signatures(found), field_groups(found)[-1].fields):
            assert [entry.label for entry in group].count("Second signaller") == fields
    entered = planned(limits=SiteLimits(blind=False), people=People(second_signaller="S. Econd"))
    assert PlanField("Second signaller", "S. Econd") in signatures(entered)


def test_the_job_has_its_revision_and_its_crane() -> None:
    made = planned(job=Job(revision="A"), crane=CraneDocuments(maker="Terex", type="T340"))
    named = {entry.label: entry.value for entry in identification(made).fields}
    assert named["Revision of the job"] == "A" and named["Crane"] == "Terex T340"


def test_parts_that_move_above_the_rope_have_their_least_distance() -> None:
    """Jib and trolley of the crane over the wall, from the highest solid of the site."""
    (table,) = [t for t in tables(bare()) if t.title == "Clearances"]
    named = {str(row[0]): row[1] for row in table.rows}
    assert "jib, with its tail: from wall" in named, named
    clearance_of_lift = bare().certificate.lift.clearance
    expected = min(
        clearance_of_lift.nearest_of_structure(q[None])["jib"].nearest.distance
        for q in bare().certificate.run.q[::10]
    )
    assert named["jib, with its tail: from wall"] == pytest.approx(expected, abs=0.01)
    assert "for this motion of the drives alone" in table.note
    assert "slings, spreader and tag lines are neither in this proof" in table.note
    assert "drives that move at other times" in sequence_table(bare()).note


def test_a_site_without_obstacles_has_no_distances_of_the_structure() -> None:
    clearance_of_lift = clearance()
    q = clearance_of_lift.q(np.array([0.0, 8.0, 5.0]))
    assert clearance_of_lift.nearest_of_structure(q[None]) == {}


def test_a_jib_that_is_longer_than_that_of_the_model_is_not_judged() -> None:
    """The trolley runs to 22 m, and the jib of the model ends 1.54 m beyond."""
    for length, holds in ((22.0, True), (23.54, True), (23.6, None), (40.0, None)):
        check = jib_as_long_as_entered(planned(crane=CraneDocuments(jib_length=length)))
        assert check is not None and check.holds is holds, check.sentence
    assert jib_as_long_as_entered(planned()) is None


def test_the_first_page_has_what_is_used_of_the_chart_in_the_gust_needed() -> None:
    made = bare()
    assert made.wind is not None
    worst = {**made.wind.worst, "utilisation": np.full_like(made.wind.speeds, 0.946)}
    for allowed, limit in ((1.0, "100 %"), (0.9, "90 %")):
        of_site = {**made.wind.allowed, "utilisation": allowed}
        blown = replace(made, wind=replace(made.wind, worst=worst, allowed=of_site))
        (table,) = [t for t in tables(blown) if t.title == "In numbers"]
        assert ["utilisation in the gust needed", "94.6 %", limit] in table.cells()


def test_speeds_of_a_step_are_those_of_the_drives() -> None:
    """Drives lead the load, and one of them is at its limit of the plan somewhere."""
    drives = bare().certificate.lift.clearance.drive_joints
    motion = bare().certificate.lift.timed.motion
    rates = np.abs(np.diff(motion.q[:, drives], axis=0)).max(axis=0) / motion.period
    speeds = " ".join(speed for step in lift_steps(bare()) for speed in step.speeds)
    for name, rate in (("slew", math.degrees(rates[0])), ("hoist", rates[2])):
        told = [float(text) for text in re.findall(rf"{name} ([\d.]+)", speeds)]
        assert max(told) == pytest.approx(rate, abs=0.06)


def test_the_table_of_winds_says_where_the_utilisation_of_the_first_page_is() -> None:
    """Lift-off uses more of the chart than gusts do."""
    made = bare()
    grounded = from_the_ground().grounded
    assert made.wind is not None and made.utilisation is not None
    for share, says in ((2.0, True), (0.5, False)):
        used = made.utilisation * share * made.wind.worst["utilisation"][0] / made.utilisation.max()
        found = replace(made, grounded=grounded, utilisation=used)
        (table,) = [t for t in tables(found) if t.title == "Wind"]
        assert ("with lift-off and set-down, which is in calm air" in table.note) is says
    (table,) = [t for t in tables(made) if t.title == "Wind"]
    assert "lift-off" not in table.note and "more may be left" in table.note


def test_an_estimated_chart_is_said_on_the_first_page() -> None:
    made = bare()
    assumptions = [
        replace(a, origin=Origin.ESTIMATED, field="[crane] chart") if a.name == "load chart" else a
        for a in made.inputs.assumptions
    ]
    guessed = replace(made, inputs=replace(made.inputs, assumptions=tuple(assumptions)))
    said = [notice for notice in first_page_notices(guessed) if "is an estimate" in notice.sentence]
    assert len(said) == 1 and said[0].warns
    assert all("estimate" not in notice.sentence for notice in first_page_notices(made))


def test_a_wind_that_takes_the_clearance_names_the_obstacle() -> None:
    wind = bare().wind
    assert wind is not None
    strong = replace(
        wind,
        worst={**wind.worst, "clearance": np.array([2.0, 0.1])},
        nearest=Nearest(0.1, "load", "wall"),
    )
    blown = replace(bare(), wind=strong)
    check = wind_borne(blown)
    assert check.sentence.endswith("The first limit is clearance, between load and wall.")
    rows = wind_bounds_table(blown).rows
    assert str(rows[1][0]).startswith("this load, by its area (clearance between load and wall)")


def test_a_site_may_allow_less_of_the_chart_than_a_limiter() -> None:
    made = bare()
    assert made.utilisation is not None
    used = 0.7 * made.utilisation / made.utilisation.max()
    for share, holds in ((0.71, True), (0.69, False)):
        found = replace(planned(limits=SiteLimits(chart_share=share)), utilisation=used)
        check = utilisation_below_warning(found)
        assert check.holds is holds and f"{100 * share:g} % allowed on this site" in check.sentence


def test_pick_up_and_set_down_have_the_rated_load_of_the_chart_at_their_radius() -> None:
    """Both ends are at (6, ∓12) m, √180 m from the slew axis, where the chart rates 2.5 t."""
    pick_up, farthest, set_down = lift_positions(bare())
    for position in (pick_up, set_down):
        assert position.radius == pytest.approx(math.sqrt(180.0), abs=0.02)
        assert position.rated == pytest.approx(2500.0)
        assert position.gross == pytest.approx(1000.0)
        assert position.share == pytest.approx(0.4)
    np.testing.assert_allclose(pick_up.place, [6.0, -12.0, 4.0], atol=0.02)
    np.testing.assert_allclose(set_down.place, [6.0, 12.0, 4.0], atol=0.02)
    assert pick_up.t <= farthest.t <= set_down.t
    assert farthest.radius is not None and set_down.radius is not None
    assert farthest.radius >= set_down.radius
    unknown = replace(bare(), utilisation=None)
    assert [row[3] for row in positions_table(unknown).rows] == [None, None, None]


@cache
def from_the_ground() -> LiftAnalysis:
    """The lift of the example, from ground to ground: its load is 1.2 m high."""
    return judge(read_site("signed_lift"), requirements=Requirements(lifts=0, gusts=0)).analysis


def test_a_load_that_stands_is_picked_up_and_set_down_on_the_ground() -> None:
    positions = lift_positions(from_the_ground())
    names = ["pick-up", "lifted off", "largest radius", "above set-down", "set-down"]
    assert [position.name for position in positions] == names
    first, off, _, above, last = positions
    for stands, hangs, place in ((first, off, (6.0, -14.0)), (last, above, (13.0, 9.0))):
        # Half of its height above the ground, into which a load at rest sinks by 2 mm.
        np.testing.assert_allclose(stands.place, [*place, 0.6], atol=0.01)
        np.testing.assert_allclose(hangs.place[:2], place, atol=0.02)
        assert hangs.place[2] > 1.0
        assert (stands.radius, stands.rated) == (hangs.radius, hangs.rated)
        assert stands.radius == pytest.approx(math.hypot(*place), abs=0.02)


def test_the_lift_goes_from_where_the_load_stands_to_where_it_is_set_down() -> None:
    table = next(table for table in tables(from_the_ground()) if table.title == "The lift")
    rows = {row[0]: row[1] for row in table.rows}
    assert rows["from, to [m]"] == "(6.0, -14.0, 0.6) to (13.0, 9.0, 0.6)"


def test_the_sequence_begins_and_ends_where_the_load_stands() -> None:
    first, *_, last = lift_steps(from_the_ground())
    assert first.movements[0].startswith("Lift off from (6.0, -14.0, 0.6): take up the slack")
    np.testing.assert_allclose(last.place, [13.0, 9.0, 0.6], atol=0.01)
    above = lift_positions(from_the_ground())[-2]
    assert f"lower the load by {above.place[2] - 0.6:.1f} m onto its support" in last.movements[0]


def test_what_people_do_while_the_crane_stands_are_steps_without_a_time() -> None:
    rows = sequence_table(from_the_ground()).rows
    assert [str(row[2])[:9] for row in rows[:3]] == ["Sling the", "Trial lif", "Lift off "]
    assert str(rows[1][2]).endswith(
        "0.3 m above the ground for a minute: brakes, slings, level; then lift off"
    )
    assert str(rows[-1][2]).startswith("Unhook the load")
    assert [row[0] for row in rows[:3]] == ["1", "1", "1"] and rows[-1][0] == rows[-2][0]
    assert [row[1] for row in (rows[0], rows[1], rows[-1])] == ["-", "-", "-"]
    # A load that hangs at both ends is slung and unhooked in other lifts.
    assert [type(step) for step in all_steps(bare())] == [LiftStep] * len(lift_steps(bare()))


def test_lift_off_and_set_down_that_are_not_simulated_are_steps_that_say_so() -> None:
    site = replace(bare().site, start=np.array([6.0, -12.0]), goal=np.array([6.0, 12.0]))
    rows = sequence_table(replace(bare(), site=site)).rows
    assert rows[2][2] == "Lift off; not simulated" and rows[-2][2] == "Set down; not simulated"


def of_share(share: float, **limits: bool) -> LiftAnalysis:
    """The lift with a chart of which its gross load is a share, and what the site says of it."""
    made = planned(limits=SiteLimits(**limits))
    rated = 1000.0 / share
    return replace(made, utilisation=made.loads["pull_N"] / (made.crane.gravity * rated))


CLEAR = {"over_people": False, "over_services": False, "blind": False}


@pytest.mark.parametrize(
    ("share", "said", "category"),
    [
        (0.74, CLEAR, "routine"),
        (0.76, CLEAR, "intermediate"),
        (0.81, CLEAR, "complex"),
        (0.91, CLEAR, "critical"),
        (0.40, {**CLEAR, "blind": True}, "complex"),
        (0.40, {**CLEAR, "over_services": True}, "complex"),
        (0.40, {**CLEAR, "over_people": True}, "critical"),
        (0.40, {"over_people": False, "blind": False}, "at least routine"),
        (0.40, {}, "at least routine"),
        (0.91, {}, "critical"),
    ],
)
def test_the_category_is_the_highest_that_a_rule_gives(
    share: float, said: dict[str, bool], category: str
) -> None:
    found = lift_category(of_share(share, **said))
    assert found.text == category
    assert len(found.not_entered) == 3 - len(said)
    assert found.rules


def test_what_stands_in_the_exclusion_zone_leaves_the_category_open() -> None:
    found = of_share(0.4, **CLEAR)
    category = lift_category(found, ("shed", "street"))
    assert category.text == "at least routine"
    assert category.not_judged == ("what stands in the exclusion zone (shed and street)",)
    details = replace(found.site.details, in_zone={"shed*": "it is empty"})
    cleared = replace(found, site=replace(found.site, details=details))
    assert lift_category(cleared, ("shed",)).text == "routine"
    # A sentence about one of them says nothing of what comes to stand there later.
    category = lift_category(cleared, ("shed", "street"))
    assert category.text == "at least routine"
    assert category.not_judged == ("what stands in the exclusion zone (street)",)
    fields = field_groups(cleared, ("shed", "shed, annexe", "street"))[-1].fields
    assert PlanField("In that zone: shed, shed, annexe", "it is empty") in fields
    assert PlanField("In that zone: street", None) in fields
    many = [f"house: wall {i}" for i in range(20)]
    assert lift_category(found, many).not_judged[0].endswith("house: wall 11 and 8 more)")
    fields = field_groups(found, many)[-1].fields
    assert PlanField("In that zone: 8 more", None) in fields


def test_what_was_answered_with_no_is_said_beside_the_category() -> None:
    said = ("not over people or a public way", "not over services")
    found = lift_category(of_share(0.4, over_people=False, over_services=False, blind=True))
    assert found.answered_no == said and found.text == "complex"


def test_a_rated_load_between_two_points_of_the_chart_is_called_interpolated() -> None:
    """The chart has 2,500 kg up to 20 m, 2,350 at 21 and 2,200 at 22 m."""
    made = bare()
    radius = made.loads["radius_m"]
    for largest, between in ((20.5, "between 20 and 21 m"), (21.0, ""), (19.0, "")):
        values = {**made.loads.values, "radius_m": radius + largest - radius.max()}
        far = replace(made, loads=replace(made.loads, values=values))
        rated = far.chart.on(2).at(far.loads["radius_m"])
        far = replace(far, utilisation=made.loads["pull_N"] / (made.crane.gravity * rated))
        row = int(far.loads["radius_m"].argmax())
        highest = np.zeros(len(radius))
        highest[row] = 0.5
        check = utilisation_below_warning(replace(far, utilisation=highest))
        note = positions_table(far).note
        if between:
            assert f"of the chart, interpolated {between}, at most" in check.sentence
            assert f"Interpolated {between}: pick-up, largest radius, set-down." in note
        else:
            assert "nterpolated" not in check.sentence
            assert ": largest radius" not in note and ", largest radius" not in note


def test_without_a_chart_the_category_is_at_least_what_the_other_rules_give() -> None:
    made = replace(bare(), utilisation=None)
    assert lift_category(made).text == "not judged"
    blind = replace(
        made, site=replace(made.site, details=PlanDetails(limits=SiteLimits(blind=True)))
    )
    assert lift_category(blind).text == "at least complex"


def test_steps_follow_each_other_from_the_start_to_the_goal_and_say_what_the_drives_do() -> None:
    """From (6, -12) to (6, 12) beyond +X the jib turns by 2 atan(12/6) = 127° to the left, and what
    is hoisted over the wall is lowered behind it.
    """
    steps = lift_steps(bare())
    assert [step.positions for step in steps] == [
        f"{i} to {i + 1}" for i in range(1, len(steps) + 1)
    ]
    assert [step.ends for step in steps] == [p.t for p in numbered_positions(bare())][1:]
    assert steps[0].begins == 0.0
    assert steps[-1].ends == pytest.approx(lift().timed.motion.arrival, abs=0.03)
    for before, after in itertools.pairwise(steps):
        assert before.ends == after.begins
    actions = " ".join(sentence for step in steps for sentence in step.movements)
    turned = [float(angle) for angle in re.findall(r"Slew (\d+)° to the left", actions)]
    assert "to the right" not in actions
    assert sum(turned) == pytest.approx(2.0 * math.degrees(math.atan(2.0)), abs=len(turned))
    raised = sum(float(way) for way in re.findall(r"Hoist ([\d.]+) m", actions))
    lowered = sum(float(way) for way in re.findall(r"Lower ([\d.]+) m", actions))
    assert raised > 3.0 and raised == pytest.approx(lowered, abs=0.1 * len(steps))
    np.testing.assert_allclose(steps[-1].place, [6.0, 12.0, 4.0], atol=0.01)
    # 4.8 °/s are the limit of the slew.
    speeds = " ".join(speed for step in steps for speed in step.speeds)
    rates = [float(rate) for rate in re.findall(r"slew ([\d.]+) °", speeds)]
    assert 1.0 < max(rates) <= 4.85


def test_who_speaks_is_entered_or_a_line_to_be_filled_in() -> None:
    people = People(signaller="B. Nemo", communication="radio 4")
    assert {row[-1] for row in sequence_table(planned(people=people)).rows} == {"B. Nemo"}
    assert {row[-1] for row in sequence_table(bare()).rows} == {"____________"}


@pytest.mark.parametrize(
    ("source", "entered", "tolerance", "origin"),
    [
        ("weighed", {}, 0.03, Origin.COMPUTED),
        ("drawing", {}, 0.10, Origin.COMPUTED),
        ("estimated", {}, 0.25, Origin.COMPUTED),
        ("weighed", {"load": 0.2}, 0.2, Origin.ENTERED),
        (None, {}, 0.25, Origin.DEFAULT),
    ],
)
def test_the_tolerance_of_the_mass_follows_from_how_it_is_known(
    source: WeightSource | None, entered: dict[str, float], tolerance: float, origin: Origin
) -> None:
    details = PlanDetails(load=LoadDetails(source=source))
    site = replace(bare().site, details=details, spread=entered)
    inputs = resolve_inputs(site, bare().crane, lift().limits, Requirements())
    assert inputs.spread.load == tolerance
    (assumption,) = [a for a in inputs.assumptions if a.name == "tolerance of the load's mass"]
    assert assumption.origin is origin


def test_the_wind_acts_on_the_area_and_drag_that_are_entered() -> None:
    """The largest section of a cube of 1 m is √2 m²."""
    asked = clearance()
    for load, expected in (
        (LoadDetails(), DRAG_COEFFICIENT * math.sqrt(2.0)),
        (LoadDetails(area=3.0), 3.0 * DRAG_COEFFICIENT),
        (LoadDetails(drag=2.0), 2.0 * math.sqrt(2.0)),
        (LoadDetails(area=3.0, drag=0.5), 1.5),
    ):
        site = replace(asked.site, details=PlanDetails(load=load))
        assert drag_area(replace(asked, site=site)) == pytest.approx(expected)


def test_what_nobody_entered_is_no_check_and_said_beside_the_checks() -> None:
    assert plan_checks(bare()) == []
    missing = not_checked(bare(), plan_checks(bare()))
    assert len(missing) == 8
    for words in ("slings", "lifting_points", "height_under_hook", "permitted_pressure"):
        assert any(words in sentence for sentence in missing)


def test_missing_names_never_change_the_verdict_and_are_lines_to_be_filled_in(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Judgement, "figures", {})
    named = planned(job=Job(site="yard", number="7"), people=People(prepared="A. Nybody"))
    pages = []
    for analysis in (bare(), named):
        judgement = Judgement(analysis, run_checks(analysis))
        assert judgement.go
        pages.append(unescape(judgement.html()))
    without, with_names = pages
    empty = '<span class="blank" title="not entered"></span>'
    assert without.count(empty) == with_names.count(empty) + 3
    assert "<dt>Lift number</dt><dd>7</dd>" in with_names
    assert f"<dt>Lift number</dt><dd>{empty}</dd>" in without
    assert "A. Nybody" in with_names
    # An empty field has no sign of a check.
    assert not re.search(r"✔[^<]*<[^>]*blank", without)
    for sentence in not_checked(bare(), plan_checks(bare())):
        assert f"<li>{sentence}</li>" in without


@pytest.mark.long
def test_the_example_of_a_lift_plan_is_a_go_and_leaves_only_dates_and_signatures_empty() -> None:
    judgement = judge(read_site("signed_lift"), requirements=Requirements(lifts=400, gusts=2))
    assert judgement.go, judgement.reasons
    page = judgement.html()
    # Ten people sign, each with a date.
    assert page.count('class="blank"') == 20
    assert "Category: routine." in page and "Not checked here" not in page
