"""Shifts on a site: the list of lifts in a file, its plan, and its timetable."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from cranedyn.errors import CraneError, DataError, OutOfRange
from cranedyn.lifts.planning.lift import NoWay
from cranedyn.lifts.sites import plan
from cranedyn.lifts.sites.conflicts import nearest_bodies
from cranedyn.lifts.sites.crane_site import CraneSite
from cranedyn.lifts.sites.crane_site_file import SITES, read_crane_site
from cranedyn.lifts.sites.lift_list import HOOKING_TIME, ListedLift
from cranedyn.lifts.sites.plan import plan_site
from cranedyn.lifts.sites.shift_checks import shift_checks
from cranedyn.lifts.sites.shift_plan import ShiftPlan, plan_shift
from cranedyn.lifts.sites.site_simulation import simulate_site
from cranedyn.lifts.sites.working_wind import WorkingWind

slow = pytest.mark.slow

LIFT = '[[lift]]\nname = "{}"\nfrom = [-30.0, 15.0, 3.0]\nto = [-10.0, 25.0, 12.0]\n'


def site_from(folder: Path, lifts: str) -> CraneSite:
    """Return the example site of two towers with a list of lifts."""
    towers = (SITES / "two_towers.toml").read_text("utf-8")
    file = folder / "site.toml"
    file.write_text(f"{towers}\n{lifts}", "utf-8")
    return read_crane_site(file)


def lift_of(name: str, crane: str = "any", **fields: object) -> ListedLift:
    """Return a lift from one side of the northern tower to another, with other fields."""
    start = np.array([-30.0, 15.0, 3.0])
    goal = np.array([-10.0, 25.0, 12.0])
    return replace(ListedLift(name, crane, start, goal), **fields)  # type: ignore[arg-type]


@cache
def towers() -> CraneSite:
    return read_crane_site("two_towers")


@cache
def example_shift() -> ShiftPlan:
    """Return the plan of the example shift, in which a crane waits for the other."""
    return plan_shift(read_crane_site("two_towers_shift"))


@slow
def test_the_lifts_of_a_file_are_read_with_all_fields_and_their_defaults(tmp_path: Path) -> None:
    panel = 'crane = "south"\nload = 800\nearliest = 60\nafter = ["formwork"]\n'
    site = site_from(tmp_path, LIFT.format("panel") + panel + LIFT.format("formwork"))
    panel_lift, formwork = site.lifts
    assert np.array_equal(panel_lift.start, [-30.0, 15.0, 3.0])
    assert np.array_equal(panel_lift.goal, [-10.0, 25.0, 12.0])
    assert (panel_lift.crane, panel_lift.load, panel_lift.earliest) == ("south", 800.0, 60.0)
    assert panel_lift.after == ("formwork",)
    assert (formwork.crane, formwork.load, formwork.earliest) == ("any", None, 0.0)
    assert site.hooking_time == HOOKING_TIME


@slow
@pytest.mark.parametrize(
    ("entry", "words"),
    # The first lift begins in line 20 of the file and has four lines.
    [
        ('crane = "west"\n', r"line 24, \[lift\] crane: .*west"),
        ("load = -1.0\n", r"line 24, \[lift\] load: .*> 0"),
        ("earliest = -5\n", r"line 24, \[lift\] earliest"),
        ("earliest = nan\n", r"line 24, \[lift\] earliest"),
        ('after = "first"\n', r"line 24, \[lift\] after: .*list of names"),
        ('after = ["second"]\n', r"line 24, \[lift\] after: .*second"),
        ('after = ["first"]\n', r"line 24, \[lift\] after: .*circle: first before first"),
        ("weight = 1.0\n", r"line 24, \[lift\] weight: .*weight"),
        (LIFT.format("first"), r"line 25, \[lift\] name: Two lifts are called first"),
        (
            'after = ["b"]\n' + LIFT.format("b") + 'after = ["first"]\n',
            r"line 29, \[lift\] after: .*circle",
        ),
        ('[[lift]]\nname = "b"\nto = [0.0, 0.0, 1.0]\n', r"line 24, \[lift\] from: it is missing"),
        ('[[lift]]\nname = "b"\nfrom = [1.0, 2.0]\n', r"line 26, \[lift\] from: .*3 numbers"),
    ],
)
def test_a_bad_lift_of_a_site_is_refused_with_line_and_field(
    tmp_path: Path, entry: str, words: str
) -> None:
    with pytest.raises(DataError, match=words):
        site_from(tmp_path, LIFT.format("first") + entry)


@slow
def test_a_crane_called_any_is_refused_beside_lifts() -> None:
    stations = (replace(towers().stations[0], name="any"), towers().stations[1])
    with pytest.raises(DataError, match="stands for every crane"):
        replace(towers(), stations=stations, lifts=(lift_of("a"),))


def times_of(shift: ShiftPlan) -> dict[str, tuple[float, float, float]]:
    """Return when each hook is at its load, leaves, and is free [s], by the name of the lift."""
    return {x.lift.name: (x.at_load, x.off, x.end) for x in shift.lifts}


@slow
def test_a_lift_takes_the_time_of_its_two_motions_and_of_hooking_on_and_off() -> None:
    """Alone on the site: what `plan_site` needs for both motions, with a stay between."""
    lift = lift_of("a", "north")
    shift = plan_shift(towers(), [lift])
    planned = plan_site(towers(), [("north", lift.start), ("north", lift.goal)], stay=HOOKING_TIME)
    to_load, to_goal = (motion for motion in planned.lifts if motion.lift)
    assert shift.lifts[0].at_load == to_load.end
    assert shift.lifts[0].delivered == to_goal.end
    assert shift.lifts[0].end == shift.duration == to_goal.end + HOOKING_TIME
    assert shift.lifts[0].waited == 0.0 and shift.plan.holds


@slow
def test_of_two_lifts_the_one_that_can_begin_first_comes_first_whatever_their_order() -> None:
    """By hand: the second of the list can begin at once, the first not before 300 s."""
    lifts = [lift_of("late", "north", earliest=300.0), lift_of("now", "north")]
    shift = plan_shift(towers(), lifts)
    assert [x.lift.name for x in shift.lifts] == ["now", "late"]
    late = shift.lifts[1]
    # The crane has done the other lift long before: it arrives with the slice that holds 300 s.
    assert 300.0 <= late.at_load < 300.5 and late.waited == 0.0


@slow
def test_of_two_lifts_that_can_begin_at_once_the_shorter_one_comes_first() -> None:
    far = lift_of("far", "north", goal=np.array([25.0, -15.0, 12.0]))
    lifts = [far, lift_of("near", "north")]
    alone = [plan_shift(towers(), [lift]).duration for lift in lifts]
    assert alone[1] < alone[0]
    assert [x.lift.name for x in plan_shift(towers(), lifts).lifts] == ["near", "far"]


@slow
def test_a_load_is_hooked_on_only_after_the_loads_it_waits_for_are_unhooked() -> None:
    far = np.array([30.0, -65.0, 3.0])
    lifts = [
        lift_of("second", "south", start=far, goal=np.array([35.0, -70.0, 12.0]), after=("first",)),
        lift_of("first", "north"),
    ]
    shift = plan_shift(towers(), lifts)
    times = times_of(shift)
    # Both are far from each other: the second crane waits at its load for nothing else.
    assert times["first"][2] <= times["second"][0] < times["first"][2] + 0.5
    assert shift.plan.holds and not shift.refusals


@slow
def test_any_crane_is_the_one_that_is_done_first() -> None:
    lift = lift_of("a", start=np.array([10.0, -25.0, 3.0]), goal=np.array([15.0, -35.0, 6.0]))
    ends = {}
    for crane in ("north", "south"):
        ends[crane] = plan_shift(towers(), [replace(lift, crane=crane)]).duration
    shift = plan_shift(towers(), [lift])
    assert ends[shift.lifts[0].crane] == shift.duration == min(ends.values())


@slow
def test_a_lift_for_any_crane_goes_to_the_only_one_that_reaches_it() -> None:
    south = np.array([20.0, -80.0, 3.0])
    shift = plan_shift(towers(), [lift_of("a", start=south, goal=np.array([25.0, -75.0, 7.0]))])
    assert shift.lifts[0].crane == "south"


@slow
def test_a_lift_without_a_way_is_left_out_with_those_that_follow_it() -> None:
    far = np.array([500.0, 0.0, 16.0])
    lifts = [lift_of("far", goal=far), lift_of("next", after=("far",)), lift_of("near")]
    shift = plan_shift(towers(), lifts)
    assert [x.lift.name for x in shift.lifts] == ["near"]
    first, second = shift.refusals
    # 500 m less the 50 m of the trolley of north; south stands 32 m farther from the load.
    assert first.startswith("Lift far: north (its load would hang 450.0 m beside it) does not")
    assert (
        "south (its load would hang 26.2 m beside it) does not reach it from [-30, 15, 3]" in first
    )
    assert first.endswith("Of these, north needs the least: 450.0 m more for both places.")
    assert second == "Lift next: it is to follow far, which is left out."
    with pytest.raises(NoWay, match="Lift far"):
        plan_shift(towers(), lifts, strict=True)


@slow
def test_a_shift_without_lifts_is_refused() -> None:
    with pytest.raises(OutOfRange, match="number of lifts"):
        plan_shift(towers())


@slow
def test_a_load_lighter_than_that_of_the_guards_is_refused_in_wind_only() -> None:
    light = [lift_of("a", "north", load=10.0)]
    windy = replace(towers(), working_wind=WorkingWind(gust=4.0, area=2.0))
    assert "cannot carry 10 kg in wind" in plan_shift(windy, light).refusals[0]
    assert plan_shift(towers(), light).lifts


@slow
def test_a_load_is_compared_with_the_chart_where_it_hangs_and_an_empty_hook_is_not(
    tmp_path: Path,
) -> None:
    chart = "[[falls]]\ncount = 1\nradii = [10.0, 40.0, 60.0]\nloads = [4000.0, 2000.0, 500.0]\n"
    (tmp_path / "chart.toml").write_text(f'name = "c"\nsource = "s"\n{chart}', "utf-8")
    text = (SITES / "two_towers.toml").read_text("utf-8").replace(
        'name = "north"', 'name = "north"\nchart = "chart.toml"'
    )  # fmt: skip
    file = tmp_path / "site.toml"
    file.write_text(text, "utf-8")
    site = read_crane_site(file)
    # Between radii a chart is linear in 1/r: 4000 kg at 10 m, 2000 kg at 40 m, 2095 kg at 35 m.
    for load, is_carried in ((2090.0, True), (2100.0, False)):
        start = np.array([0.0, 35.0, 3.0])
        lift = lift_of("a", "north", start=start, goal=np.array([-5.0, 33.0, 8.0]), load=load)
        shift = plan_shift(site, [lift])
        assert bool(shift.lifts) is is_carried
    assert "load of north" in shift.refusals[0]


@slow
def test_a_lift_with_a_point_that_is_no_point_is_refused() -> None:
    with pytest.raises(CraneError, match="start of the lift a"):
        lift_of("a", start=np.array([0.0, np.nan, 1.0]))


@slow
def test_a_shift_whose_loads_miss_their_places_or_whose_plan_is_disturbed_fails() -> None:
    shift = example_shift()
    site = shift.plan.site
    run = simulate_site(site, shift.plan.operators(), duration=shift.duration + 1.0)
    assert all(check.holds is not False for check in shift_checks(shift, run))

    # Nobody follows the plan: no load arrives.
    at_rest = simulate_site(site, [lambda t, states: np.zeros(3)] * 2, duration=shift.duration)
    assert not shift_checks(shift, at_rest)[-1].holds

    # The run ends before the last load is unhooked.
    early = simulate_site(site, shift.plan.operators(), duration=shift.duration - 5.0)
    assert not shift_checks(shift, early)[-1].holds

    # The lift for which the southern crane waited begins without that wait.
    (waiting,) = [planned for planned in shift.lifts if planned.waited]
    motions = []
    for motion in shift.plan.lifts:
        is_early = motion.crane == 1 and motion.begin >= waiting.begin
        motions.append(motion._replace(begin=motion.begin - 40.0 * is_early))
    disturbed = replace(shift, plan=replace(shift.plan, lifts=tuple(motions)))
    words = "The plan is proven to keep"
    (proof,) = [x for x in shift_checks(disturbed, run) if x.sentence.startswith(words)]
    assert not proof.holds


@slow
def test_a_crane_that_waits_says_which_bodies_would_meet_and_where() -> None:
    """Both jibs cross over the same place; the words name bodies of both cranes beside it."""
    shift = example_shift()
    (waiting,) = [planned for planned in shift.lifts if planned.waited]
    other = {"north": "south", "south": "north"}[waiting.crane]
    assert f" of {waiting.crane} would come too near to the " in waiting.waits_for
    assert f" of {other} at [" in waiting.waits_for
    x, y, z = (float(word) for word in re.findall(r"-?\d+", waiting.waits_for)[-3:])
    assert -60.0 < y < 5.0 and abs(x) < 40.0 and 0.0 < z < 60.0


@slow
def test_the_nearest_bodies_of_two_cranes_are_those_that_touch_in_a_simulation() -> None:
    """The contact that a run counts, against the bodies that a conflict names for its boxes."""
    rates = ([0.05, 0.0, 0.3], [-0.05, 0.0, 0.0])
    operators = [lambda t, states, rate=rate: np.array(rate) for rate in rates]
    run = simulate_site(towers(), operators, duration=75.0, supervised=False)
    contact = run.contacts[0]
    row = round(contact.t / 0.1)
    boxes = []
    for station, trajectory in zip(towers().stations, run.trajectories, strict=True):
        position = trajectory.q[row, station.crane.layout.drives]
        boxes.append(np.array([position, position]))
    bodies = nearest_bodies(towers(), 0, boxes[0], 1, boxes[1])
    assert (bodies.first_body, bodies.second_body) == (contact.first_body, contact.second_body)
    # They touch where the rope hangs, seen from above; the middle between both axes is beside it by
    # no more than the radius of the jib, and the points of an axis of 50 m are 2.5 m apart.
    pivot = towers().stations[1].rope(run.trajectories[1].q[row : row + 1]).pivot[0]
    jib = towers().stations[0].bodies
    radius = max(r for r, name in zip(jib.radius, jib.names, strict=True) if name == "jib")
    assert np.linalg.norm(bodies.place[:2] - pivot[:2]) < radius + 1.25


def test_an_arch_raises_the_load_half_way_by_its_share_of_what_the_hoist_can() -> None:
    """By hand: cables of 30 m and 24 m, the shortest 1 m above the end of the range."""
    station = towers().stations[0]
    shortest = station.ranges[0][station.crane.winch] + 1.0
    begin = (0.0, 20.0, 30.0)
    end = (1.0, 40.0, 24.0)
    cables = []
    for ((first, middle, last),) in plan._arches(station, begin, end):
        assert (first, last) == (begin, end)
        assert middle[:2] == (0.5, 30.0)
        cables.append(middle[2])
    assert cables == pytest.approx([24.0 - 0.3 * (24.0 - shortest), shortest])
