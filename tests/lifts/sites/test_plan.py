"""Several cranes on one site: plans, obstacles, files, tables and recordings."""

from __future__ import annotations

import itertools
import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from markupsafe import escape

from cranedyn.data.trajectory import read_columns
from cranedyn.disturbances.wind import steady
from cranedyn.dynamics.equations_of_motion import payload_position
from cranedyn.errors import CraneError, DataError
from cranedyn.lifts.planning.lift import NoWay
from cranedyn.lifts.planning.solids import Solid, box, prism
from cranedyn.lifts.sites import site_page, site_simulation
from cranedyn.lifts.sites.crane_site import CraneSite, SiteWind
from cranedyn.lifts.sites.crane_site_file import SITES, read_crane_site
from cranedyn.lifts.sites.plan import SLICE, SitePlan, plan_site
from cranedyn.lifts.sites.site_simulation import (
    Deadlock,
    SiteContact,
    SiteRun,
    simulate_site,
)
from cranedyn.recording import Run
from tests.helpers import HOSTILE_NAMES, ROOT, long_after

slow = pytest.mark.slow

GOALS = {
    "two_towers": {"north": [-8.9, -6.7, 15.9], "south": [-36.4, -37.9, 30.1]},
    "luffing_between": {
        "west": [-53.0, -37.7, 23.2], "luffing": [-21.0, -26.4, 50.6], "east": [18.1, -38.1, 32.9]
    },
}  # fmt: skip
WALL = box("wall", [-20.0, 20.0], [4.0, 4.0, 30.0], 0.0)
STREET = prism(
    "street", np.array([[-40.0, 0.0], [-15.0, 0.0], [-15.0, 40.0], [-40.0, 40.0]]), 0.0, 60.0,
    zone=True,
)  # fmt: skip


@cache
def site_of(name: str = "two_towers") -> CraneSite:
    return read_crane_site(name)


@cache
def plan(name: str = "two_towers") -> SitePlan:
    return plan_site(site_of(name), [*GOALS[name].items()])


def follow(plan: SitePlan, *, supervised: bool) -> SiteRun:
    return simulate_site(
        plan.site, plan.operators(), duration=plan.duration + 5.0, supervised=supervised
    )


def load(run: SiteRun, i: int, row: int) -> np.ndarray:
    """Return the centre of a load in the frame of the site [m]."""
    station = run.site.stations[i]
    point = payload_position(station.crane, run.trajectories[i].q[row])
    return station.bodies.foot[:, :3] @ point + station.bodies.foot[:, 3]


@slow
@pytest.mark.parametrize(
    ("name", "supervised"),
    # Each site and each way to follow the plan is in the default run.
    long_after(
        2,
        [
            ("luffing_between", True),
            ("two_towers", False),
            ("luffing_between", False),
            ("two_towers", True),
        ],
    ),
)
def test_planned_lifts_arrive_and_keep_the_distance_that_is_proven(
    name: str, supervised: bool
) -> None:
    planned = plan(name)
    assert planned.holds and planned.least < planned.duration  # one waits
    run = follow(planned, supervised=supervised)
    rows = np.searchsorted(planned.t, run.t, "right") - 1
    assert (run.distances >= planned.distances[rows]).all() and not run.contacts
    for i, station in enumerate(planned.site.stations):
        assert np.linalg.norm(load(run, i, -1) - GOALS[name][station.name]) < 0.15  # 3 mrad of 50 m


@slow
def test_a_lift_of_a_luffing_crane_leaves_no_swing_in_little_more_than_the_least_time() -> None:
    # slew 2, luff 0.7, cable 35
    site = site_of("luffing_between")
    goal = [-14.32, 31.30, 38.99]
    planned = plan_site(site, [("luffing", goal)])
    run = follow(planned, supervised=False)
    crane = site.stations[1].crane
    assert abs(crane.swing_angles(run.trajectories[1].q[-40:])).max() < 1e-3
    assert planned.duration < 1.15 * 51.5  # that of `optimal`, all else the same


@slow
def test_the_certificate_of_a_plan_fails_where_it_is_disturbed() -> None:
    first, second = plan().lifts
    early = replace(plan(), lifts=(first, second._replace(begin=second.begin - SLICE)))
    late = replace(plan(), lifts=(first._replace(begin=4.0), second))
    assert not early.holds and not late.holds
    again = replace(plan(), lifts=(first, second, first._replace(begin=first.end - 3.0)))
    wide = [replace(station) for station in site_of().stations]
    for station in wide:
        grown = station.bodies.radius + 4.0 * station.bodies.hangs
        station.__dict__["bodies"] = replace(station.bodies, radius=grown)
    assert not replace(plan(), site=replace(site_of(), stations=(*wide,))).holds
    with pytest.raises(CraneError, match="begin of a lift after another"):
        _ = again.holds
    with pytest.raises(CraneError, match=r"multiples of 0\.5"):
        _ = replace(plan(), lifts=(first, second._replace(begin=second.begin + 0.3))).holds


@slow
@pytest.mark.parametrize(
    ("goal", "words"),
    [
        ([-14.3, 31.3, 39.0], "too near to an obstacle"),
        ([35.0, 20.0, 0.5], "above ground"),
        ([70.0, 22.0, 20.0], "allowed is a place where its load hangs"),
    ],
)
def test_a_lift_of_a_luffing_crane_without_a_way_is_refused(goal: list, words: str) -> None:
    hall = box("hall", [-14.3, 31.3], [6.0, 6.0, 70.0], 0.0)
    solids = (hall,) if "obstacle" in words else ()
    with pytest.raises(CraneError, match=words):
        plan_site(replace(site_of("luffing_between"), solids=solids), [("luffing", goal)])


@slow
def test_a_goal_above_the_jib_is_refused_and_not_mirrored_below_it() -> None:
    site = site_of()
    (station,) = (station for station in site.stations if station.name == "north")
    (pivot,), *_ = station.rope(station.crane.start.q[None])
    with pytest.raises(CraneError, match="allowed is a place where its load hangs"):
        plan_site(site, [("north", pivot + np.array([0.0, 0.0, 10.0]))])


def test_a_plan_whose_lifts_are_all_left_out_lasts_no_time_and_can_be_printed() -> None:
    plan = plan_site(site_of(), [("north", [500.0, 0.0, 16.0])], strict=False)
    assert plan.refusals[0].startswith("Lift 1 of north alone: ")
    assert (plan.lifts, plan.duration, plan.least) == ((), 0.0, 0.0)
    assert repr(plan).startswith("Plan of 0 lifts in 0.0 s, drives need 0.0 s; ")


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("acceleration", ["1e-300", "1e-9"])
def test_drives_that_would_need_hours_are_refused_before_a_motion_is_made(
    acceleration: str, tmp_path: Path
) -> None:
    drives = f"drives = {{rates = [4.0, 1.0, 1.0], accelerations = [{acceleration}, 0.1, 0.1]}}\n"
    north = '[[crane]]\nname = "b"\nposition = [90.0, 0.0, 0.0]\n'
    site = site_from(tmp_path, HEAD + drives + north)
    with pytest.raises(NoWay, match=r"accelerations of .* is .* h; allowed is up to 2\.$"):
        plan_site(site, [("a", [-20.0, 5.0, 15.0])])


@slow
@pytest.mark.parametrize(
    ("lifts", "words"),
    [
        ([], "number of lifts"),
        ([("west", [0.0, 0.0, 0.0])], "west"),
        (
            [("north", [90.0, 0.0, 10.0])],
            "Lift 1 of north alone: .*allowed is a place where its load hangs",
        ),
        ([("south", [0.0, -5.3, 10.0])], "Lift 1 of south alone: wherever it may stand, another"),
    ],
)
def test_lifts_without_a_plan_are_refused_with_the_reason(lifts: list, words: str) -> None:
    with pytest.raises(CraneError, match=words):
        plan_site(site_of(), lifts)


@pytest.mark.long
def test_a_lift_for_which_no_crane_can_make_way_does_not_wait() -> None:
    lifts = [("c", [73.7, 69.3, 16.0]), ("c", [35.5, 5.3, 16.0])]
    with pytest.raises(CraneError, match="Lift 2 of c alone: each way that was tried passes"):
        plan_site(site_of("four_towers"), lifts)


@pytest.mark.long
def test_a_lift_goes_around_obstacles_over_which_its_load_cannot_be_raised() -> None:
    walls = tuple(box(f"wall {x}", [x, 20.0], [4.0, 4.0, 36.0], 0.0) for x in (-20.0, 20.0))
    planned = plan_site(replace(site_of(), solids=walls), [("north", [30.0, 0.0, 20.0])])
    run = follow(planned, supervised=True)
    assert planned.holds and run.clearances[:, 0].min() >= planned.site.distance
    assert np.linalg.norm(load(run, 0, -1) - [30.0, 0.0, 20.0]) < 0.15


@slow
def test_a_crane_that_stands_at_the_goal_of_another_makes_way_for_it() -> None:
    lifts = [("north", [15.0, -27.0, 12.0]), ("south", [15.0, -27.0, 22.0])]
    planned = plan_site(site_of(), lifts, stay=20.0)
    north, south = (
        [motion for motion in planned.lifts if motion.crane == crane] for crane in (0, 1)
    )
    first, second = (max(motions, key=lambda motion: motion.lift) for motions in (north, south))
    assert planned.holds and min(first.end, second.end) + 20.0 < planned.duration
    assert [motion.lift for motion in planned.lifts if not motion.lift]  # one makes way


@slow
def test_a_goal_is_reached_although_a_search_for_it_diverges() -> None:
    goal = [10.481632546190115, 36.976043837867714, 9.6]  # overflowed from one of 500 places
    assert plan_site(site_of(), [("north", goal)]).holds


@slow
def test_a_lift_without_a_way_is_left_out_of_a_shift_with_the_reason() -> None:
    lifts = [("south", [0.0, -5.3, 10.0]), ("south", [0.0, -25.0, 20.0])]
    planned = plan_site(site_of(), lifts, strict=False)
    assert {motion.lift for motion in planned.lifts} - {0} == {2}
    assert len(planned.refusals) == 1 and "Lift 1 of south" in planned.refusals[0]


def test_bodies_that_pass_each_other_between_two_rows_are_told_from_those_that_meet() -> None:
    for closest, apart in ((0.3, True), (0.05, False), (-0.3, False)):
        gap = lambda share, least=closest: least + abs(2.0 * share - 1.0)  # noqa: E731
        assert site_simulation._proven(gap, 2.0, 0.1, gap(0.0), gap(1.0)) is apart


@slow
@pytest.mark.parametrize("solid", [WALL, STREET])
def test_a_supervised_crane_stops_before_an_obstacle_or_zone(solid: Solid) -> None:
    site = replace(site_of(), solids=(solid,))
    operators = [lambda t, states: np.array([0.05, 0.0, 0.2]), lambda t, states: np.zeros(3)]
    # The free crane is in contact after 16 s; the supervised one has come to rest by the end.
    free, kept = (
        simulate_site(site, operators, duration=25.0, supervised=supervised)
        for supervised in (False, True)
    )
    contact = free.contacts[0]
    assert (contact.first, contact.second) == ("north", site.solids[0].name)
    assert not kept.contacts and not kept.deadlocks
    required = 0.0 if site.solids[0].zone else site.distance
    assert kept.clearances[:, 0].min() >= required - 1e-3  # the rounding that a margin takes off
    assert np.ptp(kept.trajectories[0].q[:, 0]) > 0.1


@slow
def test_wind_blows_all_loads_in_its_direction_on_the_site() -> None:
    operators = [lambda t, states: np.zeros(3)] * 2
    wind = SiteWind(steady(12.0), direction=0.7)
    run = simulate_site(site_of(), operators, duration=4.0, supervised=False, wind=wind)
    for i in (0, 1):
        moved = load(run, i, 30) - load(run, i, 0)
        assert np.arctan2(moved[1], moved[0]) == pytest.approx(0.7, abs=1e-2)  # a swing's curvature


@slow
def test_a_run_is_recorded_with_each_crane_at_its_place_and_written_as_one_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = replace(site_of(), solids=(WALL,))
    operators = [lambda t, states: np.array([0.02, 0.1, 0.1])] * 2
    run = simulate_site(site, operators, duration=2.0)
    withdrawn = ({}, {1: np.array([0.5, 20.0, 10.0])})
    deadlocks = [Deadlock(1.0 + k / 10, (0, 1), withdrawn[k]) for k in (0, 1)]
    run = replace(run, deadlocks=tuple(deadlocks))
    chain = "north for south for north; south lets pass at gamma 0.50 rad, x 20.00 m, l 10.00 m"
    assert f"waits in a circle: 1, first {chain}" in repr(run)
    drawn: list[Run] = []
    real = site_simulation.record

    def record(path: Path, runs: list[Run], **rest: Any) -> Path:
        drawn.extend(runs)
        assert f"{chain}, 0.2 s" in rest["text"]
        return real(path, runs, **rest)

    monkeypatch.setattr(site_simulation, "record", record)
    assert run.record(tmp_path / "site.rrd").stat().st_size > 10_000
    for i, each in enumerate(drawn):
        point = each.to_scene(payload_position(each.crane, each.trajectory.q[-1]))
        assert np.allclose(point, load(run, i, -1), atol=1e-9)
        assert each.scenery is not None and each.scenery.reserved is not None
        q = np.tile(each.crane.start.q, (4, 1))
        q[:, each.crane.layout.drives[:2]] = [*itertools.product(*run.boxes[i][-1][:, :2].T)]
        line = each.to_scene(each.scenery.reserved[1][-1])[:, None]
        corners = np.linalg.norm(line - site.stations[i].rope(q)[0], axis=2).min(axis=0)
        assert corners.max() < 1e-9
    scenery = drawn[0].scenery
    assert scenery is not None
    corners = drawn[0].to_scene(scenery.obstacles[0].vertices)
    assert np.allclose(corners, WALL.vertices, atol=1e-9)
    names = ["t_s", "south_gamma_rad", "north_x_passed_m_s", "north_south_distance_m"]
    for ending in ("csv", "parquet"):
        columns = read_columns(run.write(tmp_path / f"site.{ending}"), names)
        assert np.array_equal(columns["north_south_distance_m"], run.distances[:, 0])
        assert np.array_equal(columns["south_gamma_rad"], run.trajectories[1].q[:, 0])


@slow
def test_a_page_of_a_run_shows_where_cranes_touch_and_what_is_lost(tmp_path: Path) -> None:
    site = site_of()
    rates = ([0.05, 0.0, 0.3], [-0.05, 0.0, 0.0])
    operators = [lambda t, states, rate=rate: np.array(rate) for rate in rates]
    run = simulate_site(site, operators, duration=75.0, supervised=False)
    run = replace(run, passed=[0.5 * command for command in run.commands], swing=np.full(2, 0.2))
    text = site_page.write_page(run, tmp_path / "site.html").read_text("utf-8")
    contact = run.contacts[0]
    assert contact[1:] == ("north", "south", "jib", "rope")
    for shown in (f"<td>{contact.t:.1f}</td>", "hoist_joint is at 38.0", "11.5°, allowed 6.0°"):
        assert shown in text
    assert not re.search(r"""(src|href)=["'](?!data:)""", text) and "<script" not in text
    assert "hoist_joint is at 38.0" in repr(run) and "191 % of the envelope" in repr(run)
    seconds = 0.5 * 75.0 * np.array(rates[0]) / site.stations[0].converters.rates
    assert np.allclose(site_page.lost_time(run)[0][-1], seconds)
    (cross,) = [
        line.get_xydata() for line in site_page._plan(run).axes[0].lines if line.get_marker() == "x"
    ]
    assert np.linalg.norm(cross - load(run, 1, round(contact.t / 0.1))[:2]) < 0.5


def test_a_crane_whose_name_an_obstacle_has_takes_no_part_in_a_contact_with_it() -> None:
    touches_wall = SiteContact(1.0, "a", "b", "load", "")
    assert site_page._touching_body(touches_wall, "a") == "load"
    assert site_page._touching_body(touches_wall, "b") == ""
    assert site_page._touching_body(touches_wall._replace(second_body="jib"), "b") == "jib"


@slow
@pytest.mark.parametrize("name", long_after(2, HOSTILE_NAMES[::-1]))
def test_a_page_of_a_run_takes_names_for_data(name: str, tmp_path: Path) -> None:
    quoted_name = json.dumps(name)  # a string of TOML, too
    ends = "".join(
        f"\n[[crane]]\nname = {n}\nposition = {p}\n"
        for n, p in ((quoted_name, [0.0, 0.0, 0.0]), ('"b"', [90.0, 0.0, 0.0]))
    )
    wall = f"[[box]]\nname = {quoted_name}\ncentre = [30.0, 30.0]\nsize = [9.0, 9.0, 9.0]\n"
    site = site_from(tmp_path, f"name = {quoted_name}\n{ends}{wall}")
    run = simulate_site(site, [lambda t, states: np.zeros(3)] * 2, duration=1.0)
    text = site_page.site_html(run)
    assert f"<h1>Site: {escape(name)}</h1>" in text
    assert "<img src=x" not in text and "<script" not in text and "<b>" not in text


@pytest.mark.slow
def test_the_site_files_of_the_how_to_are_read(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "howto" / "several_cranes.md").read_text("utf-8")
    lifts, _, bridges, cranes = re.findall(r"^```toml\n(.*?)^```", text, re.S | re.M)
    assert site_from(tmp_path, bridges).share_runway(0, 1)
    site = site_from(tmp_path, cranes)
    assert [station.name for station in site.stations] == ["west", "east"] and site.solids
    head, _, towers = (SITES / "two_towers.toml").read_text("utf-8").partition("[[crane]]")
    shift = site_from(tmp_path, f"{head}\n{lifts}\n[[crane]]{towers}")
    assert [(lift.name, lift.crane) for lift in shift.lifts] == [
        ("formwork", "north"),
        ("bucket", "any"),
    ]


HEAD = '[[crane]]\nname = "a"\n'


def site_from(tmp_path: Path, text: str) -> CraneSite:
    file = tmp_path / "site.toml"
    file.write_text(text, "utf-8")
    return read_crane_site(file)


@slow
def test_a_crane_of_a_site_has_its_own_machine_drives_brakes_and_chart(tmp_path: Path) -> None:
    chart = "[[falls]]\ncount = 1\nradii = [10.0, 60.0]\nloads = [4000.0, 1000.0]\n"
    (tmp_path / "chart.toml").write_text(f'name = "c"\nsource = "s"\n{chart}', "utf-8")
    own = "drives = {rates = [4.0, 1.0, 0.8], accelerations = [1.0, 0.4, 0.5]}\n"
    brakes = "brakes = {decelerations = [0.5, 0.3, 0.4]}\nreaction = 1.0\n"
    hall = '[[box]]\nname = "hall"\ncentre = [30.0, 30.0]\nsize = [9.0, 9.0, 9.0]\n'
    machine = '[[crane]]\nname = "b"\nposition = [90.0, 0.0, 0.0]\nmachine = "tower_hkcrc"\n'
    site = site_from(tmp_path, HEAD + own + brakes + 'chart = "chart.toml"\n' + machine + hall)
    first, second = site.stations
    assert np.allclose(first.converters.rates, [np.radians(4.0), 1.0, 0.8])
    assert np.allclose(first.brakes.decelerations, [np.radians(0.5), 0.3, 0.4])
    assert first.chart is not None and first.brakes.reaction == 1.0
    assert second.converters.accelerations[0] == pytest.approx(5.39e-3)  # that of the machine
    assert second.brakes.decelerations[0] == pytest.approx(0.9 * 5.39e-3)
    assert [solid.name for solid in site.solids] == ["hall"]
    heavy = replace(first, chart=replace(first.chart, reevings=(
        replace(first.chart.reevings[0], rated=np.array([10.0, 10.0])),)))  # fmt: skip
    with pytest.raises(CraneError, match="load of a"):
        plan_site(replace(site, stations=(heavy, second)), [("a", [0.0, -12.0, 10.0])])


@slow
@pytest.mark.parametrize(("excess", "is_carried"), [(1e-4, False), (-1e-4, True)])
def test_a_load_is_compared_with_all_digits_of_the_rated_one(
    tmp_path: Path, excess: float, is_carried: bool
) -> None:
    """A rated load of 1234.5678 kg is 1234.57 kg with six digits, which carries 0.1 g more."""
    rated = 1234.5678
    chart = f"[[falls]]\ncount = 1\nradii = [60.0]\nloads = [{rated}]\n"
    (tmp_path / "chart.toml").write_text(f'name = "c"\nsource = "s"\n{chart}', "utf-8")
    values = f"values = {{payload_mass = {rated + excess}}}\n"
    site = site_from(tmp_path, f'{HEAD}{values}chart = "chart.toml"\n')
    lift = [("a", site.stations[0].plumb(site.stations[0].ranges.mean(axis=0)[None])[1][0])]
    if is_carried:
        assert plan_site(site, lift).holds
        return
    with pytest.raises(CraneError, match="load of a"):
        plan_site(site, lift)


@slow
@pytest.mark.parametrize("name", ["four_towers"])
def test_drives_with_weak_gears_ramp_no_faster_than_their_brakes_stop(name: str) -> None:
    third = read_crane_site(name).stations[2]
    assert (third.converters.accelerations <= third.brakes.decelerations).all()


@slow
@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ('machine = "x"', r"line 3, \[crane\] machine"),
        ('machine = "tower_hkcrc"\nmodel = "tower_crane"', r"line 3, \[crane\] machine: model is"),
        ("drives = {rates = [1.0]}", r"line 3, \[drives\] rates"),
        ("drives = 3", r"line 3, \[crane\] drives"),
        ("brakes = {decelerations = [9.0, 9.0, 9.0]}", r"line 3, \[crane\] brakes: decelerations"),
        ('chart = "none.toml"', r"line 3, \[crane\] chart: Cannot read"),
        ('chart = "../c.toml"', r"line 3, \[crane\] chart: .*outside"),
        ('[[box]]\nname = "b"\nsize = [1.0, 1.0, 0.0]', r"line 5, \[box\] size"),
        ('[[mesh]]\nname = "b"\nfile = "b.stl"', r"line \d, \[mesh\]"),
    ],
)  # fmt: skip
def test_a_bad_entry_of_a_site_is_refused_with_line_and_field(
    tmp_path: Path, entry: str, words: str
) -> None:
    with pytest.raises(DataError, match=words):
        site_from(tmp_path, f"{HEAD}{entry}\n")
