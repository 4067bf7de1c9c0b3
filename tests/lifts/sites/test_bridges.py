"""Overhead cranes on sites: bridges that share a runway, and a hall beside a tower crane."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from cranedyn.errors import CraneError, OutOfRange
from cranedyn.interfaces import State
from cranedyn.lifts.sites.brakes import brakes
from cranedyn.lifts.sites.conflicts import nearest_bodies
from cranedyn.lifts.sites.crane_site import CraneSite, Station
from cranedyn.lifts.sites.crane_site_file import SITES, read_crane_site
from cranedyn.lifts.sites.lift_list import ListedLift
from cranedyn.lifts.sites.operators import reach
from cranedyn.lifts.sites.plan import Schedule
from cranedyn.lifts.sites.shift_checks import shift_checks
from cranedyn.lifts.sites.shift_plan import ShiftPlan, plan_shift
from cranedyn.lifts.sites.site_page import site_html
from cranedyn.lifts.sites.site_simulation import MessageChannel, SiteRun, simulate_site
from experiments.site.real_shapes import real_distances

slow = pytest.mark.slow

HALF_BASE = 1.6
"""Half of the length of an end carriage [m], see urdf/overhead_crane.urdf.xacro."""

CARRIAGE_RADIUS = math.hypot(0.2, 0.2)
"""Radius of the capsule around an end carriage, whose section is a square of 0.4 m [m]."""


@cache
def bridges() -> CraneSite:
    return read_crane_site("two_bridges")


@cache
def shift() -> ShiftPlan:
    return plan_shift(bridges())


@cache
def shift_run() -> SiteRun:
    return simulate_site(bridges(), shift().plan.operators(), duration=shift().duration + 1.0)


def lift_to(crane: str, start: Sequence[float], goal: Sequence[float]) -> ListedLift:
    return ListedLift("a", crane, np.array(start), np.array(goal))


def box_at(*position: float) -> np.ndarray:
    """Return the box of a crane that stands at a position."""
    return np.array([position, position])


def site_text(old: str = "", new: str = "") -> str:
    """Return the text of the example site without its lifts, with a part of it replaced."""
    text = (SITES / "two_bridges.toml").read_text("utf-8").partition("[[lift]]")[0]
    assert old in text
    return text.replace(old, new) if old else text


def test_a_bridge_and_its_runway_have_their_names_and_a_capsule_each_column() -> None:
    bodies = bridges().stations[0].bodies
    assert set(bodies.names) == {"runway", "bridge", "trolley", "rope", "load"}
    standing = bodies.joint == 0
    assert {name for name, is_standing in zip(bodies.names, standing, strict=True) if is_standing} \
        == {"runway"}  # fmt: skip
    # By hand: 7 columns on either side of the hall, whose section is a square of 0.4 m, two rails.
    assert standing.sum() == 16
    assert bodies.radius[standing].max() == pytest.approx(CARRIAGE_RADIUS, abs=1e-6)


def test_two_bridges_are_proven_apart_up_to_where_their_end_carriages_would_be_too_near() -> None:
    """By hand: both carriages with their capsules, and the required distance, between them."""
    site = bridges()
    nearest = 2.0 * (HALF_BASE + CARRIAGE_RADIUS) + site.distance
    west = np.array([[10.0, 3.0, 2.0], [20.0, 3.0, 2.0]])
    for beyond, is_apart in ((-0.01, False), (0.01, True)):
        east = west + np.array([10.0 + nearest + beyond, 14.0, 0.0])
        assert site.pair_apart(0, west, 1, east) == is_apart
        assert site.pair_apart(1, east, 0, west) == is_apart
        assert site.apart(0, west, [west, east])[1] == is_apart
        assert site.apart(1, east, [west, east])[0] == is_apart
    # The other way round no bridge is beyond the other one.
    assert not site.pair_apart(0, box_at(30.0, 3.0, 2.0), 1, box_at(30.0, 17.0, 2.0))


def test_the_nearest_bodies_of_bridges_on_one_runway_are_not_their_common_rails() -> None:
    bodies = nearest_bodies(bridges(), 0, box_at(20.0, 3.0, 2.0), 1, box_at(30.0, 17.0, 2.0))
    assert (bodies.first_body, bodies.second_body) == ("bridge", "bridge")
    gap = 10.0 - 2.0 * (HALF_BASE + CARRIAGE_RADIUS)
    assert bodies.distance == pytest.approx(gap, abs=1e-6)
    assert bodies.place[0] == pytest.approx(25.0, abs=0.1)


def test_the_outline_of_a_bridge_is_the_rectangle_in_which_its_hook_may_be() -> None:
    station = bridges().stations[0]
    (line,) = station.outline(np.array([[[10.0, 4.0, 3.0], [16.0, 9.0, 5.0]]]))
    assert np.allclose(line[0], line[-1])
    # The trolley runs along -Y, and the pivot is at the height of the bridge.
    assert np.allclose(line.min(axis=0), [10.0, -9.0, 12.0])
    assert np.allclose(line.max(axis=0), [16.0, -4.0, 12.0])
    on_edge = np.isclose(line[:, 0], 10.0) | np.isclose(line[:, 0], 16.0)
    on_edge |= np.isclose(line[:, 1], -4.0) | np.isclose(line[:, 1], -9.0)
    assert on_edge.all()


def test_a_crane_that_makes_way_stays_on_its_side_of_the_other_bridge() -> None:
    """Half of all random places of the eastern bridge are west of the box, all out of reach."""
    schedule = Schedule(bridges())
    box = np.array([[[25.0, 2.0, 2.0], [35.0, 18.0, 9.0]]])
    refuges = np.array([*schedule._refuges(1, {0: box})])
    assert len(refuges) > 20 and refuges[:, 0].min() > 35.0
    # Travelling away alone is tried as well: the trolley stays where it is.
    start = bridges().stations[1].crane.start.q
    assert (np.abs(refuges[:, 1] - start[1]) < 1e-9).sum() > 5


def test_a_lift_that_leaves_the_other_bridge_no_room_is_refused_with_bodies_and_place() -> None:
    """By hand: at 57 m the western bridge takes the last 3 m of the runway; the eastern one needs
    4.8 m from it.
    """
    lift = lift_to("west", [10.0, -6.0, 3.0], [57.0, -6.0, 3.0])
    (refusal,) = plan_shift(bridges(), [lift]).refusals
    words = r"cannot bring it to \[57, -6, 3\] m: .* the (\w+) of west .* the (\w+) of east at \["
    match = re.search(words, refusal)
    assert match is not None and set(match.groups()) <= {"bridge", "trolley", "load", "rope"}


@slow
def test_in_the_shift_bridges_make_way_and_all_loads_arrive_proven_apart() -> None:
    plan = shift().plan
    assert not shift().refusals and plan.holds and len(shift().lifts) == 5
    assert all(check.holds is not False for check in shift_checks(shift(), shift_run()))
    # Both bridges make way at least once: these motions end no lift, and leave the other its goal.
    makes_way = {motion.crane for motion in plan.lifts if not motion.lift}
    assert makes_way == {0, 1}
    run = shift_run()
    assert not run.contacts and run.outside.max() <= 0.0 and run.swing.max() <= run.site.swing
    west, east = (trajectory.q[:, 0] for trajectory in run.trajectories)
    assert (east - west).min() > 2.0 * HALF_BASE + run.site.distance
    # Each of them comes to where the other one has been.
    assert west.max() > east.min() + 20.0


@slow
def test_by_real_shapes_bridges_of_the_shift_keep_their_distance() -> None:
    """Forward kinematics by Pinocchio and distances by coal know neither capsules nor boxes."""
    real = real_distances(shift_run())
    assert real.least >= bridges().distance and not real.overlaps
    # Capsules cover the shapes: they say no more, and not much less.
    assert real.excess <= 0.0 and real.least - shift_run().least_distance < 1.2


class Rammer:
    """An operator who drives the bridge at the other one, swings the load by the trolley, hoists
    and lowers, all at full rates.
    """

    def __init__(self, station: Station, towards: float) -> None:
        self.rates = station.converters.rates
        self.towards = towards

    def __call__(self, t: float, states: Sequence[State]) -> np.ndarray:
        """Return the rates [m/s], shape (3,)."""
        backs_off = math.sin(t / 9.0) < -0.7
        shares = [-self.towards if backs_off else self.towards, math.sin(t), math.cos(t / 7.0)]
        return np.sign(shares) * self.rates


@slow
def test_adversaries_that_ram_bridges_are_held_apart_and_touch_without_the_supervisor() -> None:
    site = bridges()
    rammers = [Rammer(site.stations[0], 1.0), Rammer(site.stations[1], -1.0)]
    run = simulate_site(site, rammers, duration=60.0, channel=MessageChannel(0.2, 0.3))
    assert not run.contacts and run.outside.max() <= 0.0
    assert run.swing.max() <= site.swing
    assert real_distances(run).least >= site.distance
    # They do come near: the supervisor lets them as far as they can still stop.
    assert run.least_distance < 5.0
    free = simulate_site(site, rammers, duration=25.0, supervised=False)
    touching = {free.contacts[0].first_body, free.contacts[0].second_body}
    assert touching <= {"bridge", "trolley", "load", "rope"}
    # The counted contact comes before the shapes overlap.
    real = real_distances(free)
    assert real.overlaps and not real.uncounted
    page = site_html(free)
    assert "Runways, reach" in page and "bridge" in page


HALL_AND_TOWER = """
[[crane]]
name = "tower"
position = [30.0, 12.0, 0.0]
heading = 90.0
values = {mast_height = 28.0, pivot_height = 30.0, total_height = 36.0, trolley_max = 40.0, \
hoist_max = 28.0, counter_jib = 10.0, trolley_init = 20.0, hoist_init = 10.0}
"""


@slow
def test_a_hall_and_a_tower_crane_are_planned_together(tmp_path: Path) -> None:
    file = tmp_path / "hall.toml"
    file.write_text(site_text() + HALL_AND_TOWER, "utf-8")
    site = read_crane_site(file)
    lifts = [
        replace(lift_to("west", [8.0, -6.0, 2.5], [20.0, -14.0, 2.5]), name="in the hall"),
        # Over the bridges, from one side of the hall to the other.
        replace(lift_to("tower", [20.0, 25.0, 3.0], [40.0, -6.0, 16.0]), name="over it"),
    ]
    planned = plan_shift(site, lifts)
    assert not planned.refusals and planned.plan.holds
    # The tower does not reach into the hall: its jib is above, but its rope would go through beams.
    over = lift_to("tower", [20.0, 25.0, 3.0], [30.0, 0.5, 12.0])
    (refusal,) = plan_shift(site, [over]).refusals
    assert "runway" in refusal
    low, high = reach(site, 2)
    assert (high - low)[0] == pytest.approx(2.0 * math.pi)


def read(tmp_path: Path, text: str) -> CraneSite:
    file = tmp_path / "site.toml"
    file.write_text(text, "utf-8")
    return read_crane_site(file)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('runway = "west"\n', 'runway = "north"\n', r"line 16, .* runway: north is no crane"),
        ('runway = "west"\n', "", r"runways of west and east are 0.00 m .* enter runway = west"),
        ('runway = "west"\n', 'runway = "west"\nheading = 0.0\n', "runway: .*stands elsewhere"),
        ("bridge_init = 48.0", "bridge_init = 14.0", "At the start west and east, on one runway,"),
        (
            "{bridge_init = 48.0,", "{span = 18.0, bridge_init = 48.0,",
            "runway: .*its rails and columns differ",
        ),
        ('"overhead"\nrunway', '"truck"\nrunway', "There is no kind 'truck'; there are tower, lu"),
        ('"overhead"\nrunway', '"overhead"\nmodel = "tower_crane"\nrunway', "model: kind is given"),
        ('runway = "west"\n', 'runway = "west"\nbrakes = "gears"\n', "brakes of a crane without a"),
    ],
)  # fmt: skip
def test_a_bridge_that_cannot_be_on_its_runway_is_refused_with_line_and_field(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    with pytest.raises(CraneError, match=words):
        read(tmp_path, site_text(old, new))


def test_a_runway_of_its_own_a_place_of_its_own(tmp_path: Path) -> None:
    """Two halls side by side: no crane shares anything, and both runways count."""
    text = site_text('runway = "west"\n', "position = [0.0, -30.0, 0.0]\n")
    site = read(tmp_path, text)
    assert not site.share_runway(0, 1) and len(site.compared_capsules(0, 1)) > 16
    assert bridges().share_runway(0, 1) and bridges().share_runway(1, 0)
    assert not bridges().share_runway(0, 0)
    # By hand, between the end of a girder and the rail of the other hall: both stand 0.5 m beside
    # the span of 20 m, 30 m from hall to hall, and the girder 0.9 m higher; less the radii of their
    # capsules, for sections of 0.4 m by 0.9 m and 0.3 m by 0.4 m.
    gap = nearest_bodies(site, 0, box_at(12.0, 6.0, 6.0), 1, box_at(48.0, 6.0, 6.0)).distance
    radii = math.hypot(0.2, 0.45) + math.hypot(0.15, 0.2)
    assert gap == pytest.approx(math.hypot(30.0 - 21.0, 0.9) - radii, abs=1e-6)


def test_a_crane_may_share_only_a_runway_and_that_of_its_owner() -> None:
    west, east = bridges().stations
    tower = replace(read_crane_site("two_towers").stations[0], runway="west")
    with pytest.raises(CraneError, match="north has no runway: its first drive does not slide"):
        CraneSite("two", (west, tower))
    third = replace(east, name="third", runway="east")
    with pytest.raises(CraneError, match="travels on the runway of west itself"):
        CraneSite("three", (west, east, third))


@pytest.mark.parametrize(
    ("centre", "size", "part"),
    [
        ([12.8, -10.0], [1.0, 1.0, 12.5], "bridge"),
        ([20.0, 0.5], [1.0, 1.0, 2.0], "runway"),
        # Between two columns, below the rail, there is room.
        ([25.0, 0.5], [4.0, 1.0, 8.0], ""),
    ],
)
def test_an_obstacle_at_a_bridge_or_column_is_refused_and_one_between_columns_is_not(
    tmp_path: Path, centre: list[float], size: list[float], part: str
) -> None:
    text = site_text() + f'[[box]]\nname = "crate"\ncentre = {centre}\nsize = {size}\n'
    if not part:
        assert read(tmp_path, text).solids
        return
    with pytest.raises(CraneError, match=f"the {part} of west is in crate"):
        read(tmp_path, text)


def test_a_bridge_has_one_rated_load_wherever_its_trolley_is(tmp_path: Path) -> None:
    chart = 'name = "c"\nsource = "s"\n[[falls]]\ncount = 4\nrated = 6300.0\n'
    (tmp_path / "hall_crane.toml").write_text(chart, "utf-8")
    site = read(
        tmp_path, site_text('runway = "west"\n', 'runway = "west"\nchart = "hall_crane.toml"\n')
    )
    lift = lift_to("east", [48.0, -3.0, 3.0], [44.0, -17.0, 3.0])
    assert plan_shift(site, [replace(lift, load=6300.0)]).lifts
    (refusal,) = plan_shift(site, [replace(lift, load=6301.0)]).refusals
    assert "load of east" in refusal and "6300" in refusal


def test_gears_of_a_slewing_crane_are_no_brakes_of_a_bridge() -> None:
    with pytest.raises(OutOfRange, match="crane without a slew"):
        brakes(bridges().stations[0].crane, "gears")
