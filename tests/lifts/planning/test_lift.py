"""Lifts: proven, certified, fast; refused where there is none; perturbed."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cranedyn.analysis.swing import swing_amplitude
from cranedyn.controllers.lqr import lqr
from cranedyn.dynamics.equations_of_motion import payload_position
from cranedyn.errors import CraneError, DataError, ModelError, OutOfRange, RunError
from cranedyn.estimation.sensor_model import with_sensor_model
from cranedyn.interfaces import Setpoint, State
from cranedyn.lifts.planning import curve, path_search, timing
from cranedyn.lifts.planning.certificate import ARRIVAL_SWING, Certificate, certify, controller_of
from cranedyn.lifts.planning.clearance_of import clearance_of
from cranedyn.lifts.planning.crane_bodies import neighbour
from cranedyn.lifts.planning.curve import LONGEST_LIFT, refuse_endless, straight_time
from cranedyn.lifts.planning.lift import (
    RESERVE,
    NoWay,
    _candidates,
    _is_proven,
    crane_of,
    plan_lift,
)
from cranedyn.lifts.planning.motion_proof import (
    Line,
    slew_range,
    unproven_parameter,
    unproven_row,
)
from cranedyn.lifts.planning.perturbed import (
    Perturbed,
    Spread,
    _chunks,
    _crane_with_load,
    _largest_silhouette,
    _least_distances,
    _simulate_chunk,
    hanging_in_wind,
    perturb,
)
from cranedyn.lifts.planning.site import Site
from cranedyn.lifts.planning.site_file import SITES, read_site
from cranedyn.lifts.planning.solids import body, box, prism
from cranedyn.lifts.planning.timing import STEP, timed
from cranedyn.model.load import load_crane
from cranedyn.references.limits import Limits, use
from experiments import lift as experiment
from tests.helpers import FAST, G, quickly
from tests.lifts.planning.sites import (
    LIMITS,
    WALL,
    certificate,
    corners,
    crane,
    lift,
    site,
    with_wall,
)

pytestmark = pytest.mark.slow


def red(certified: Certificate) -> list[str]:
    return [check.sentence for check in certified.checks if not check.holds]


@pytest.mark.long
def test_a_crane_with_slow_drives_is_planned_for_and_certified_at_its_own_rates() -> None:
    slow = load_crane(gravity=G, slew_velocity=0.03, trolley_velocity=0.3, hoist_velocity=0.2)
    planned = plan_lift(site(WALL), LIMITS, crane=slow)
    certified = certify(planned, engine=FAST)
    assert_allclose(planned.limits.rates, np.array([0.03, 0.3, 0.2]) / RESERVE)
    assert certified.holds and certified.run.valid.all()
    assert (np.abs(certified.run.v[:, [0, 1, 4]]).max(axis=0) <= slow.rate_limit).all()


def test_a_lift_over_a_wall_is_certified() -> None:
    assert red(certificate()) == []
    assert certificate().holds
    assert certificate().nearest.distance >= 0.5
    # Over it, not through it.
    assert lift().clearance.point(lift().timed.places)[:, 2].max() > 8.0 + 0.5 + 0.5


@pytest.mark.parametrize("count", [0, 10**10, pytest.param(10**5000, id="endless")])
def test_more_lifts_than_fit_are_refused(count: int) -> None:
    with pytest.raises(CraneError, match="number of lifts is"):
        perturb(certificate(), count)


def test_a_load_beyond_the_hoist_is_refused_with_both_masses() -> None:
    """100 kN hold 100,000 / 9.80665 = 10,197 kg."""
    heavy = load_crane(gravity=9.80665, payload_mass=10_300.0)
    with pytest.raises(
        NoWay, match="The hoist holds 10,197 kg; the load with rigging is 10,300 kg"
    ):
        plan_lift(site(), LIMITS, crane=heavy)


@pytest.mark.parametrize(
    ("entered", "loaded", "sentence"),
    [
        ({"payload_mass": 9000.0}, {"payload_mass": 1200.0}, "9,000 kg .* the crane has 1,200 kg"),
        ({"payload_mass": 9000.0}, {}, "9,000 kg as payload_mass; the crane has 1,000 kg"),
        ({"counter_jib": 12.0}, {}, "12 m as counter_jib; the crane has 0 m"),
        ({"counter_jib": 12.0}, {"counter_jib": 9.0}, "12 m as counter_jib; the crane has 9 m"),
        ({"payload_ixx": 7.0}, {}, r"7 kg m\^2 as payload_ixx; the crane has 400 kg m\^2"),
        ({"payload_ixx": 7.0}, {"payload_inertia": 9.0}, r"7 kg .* the crane has 9 kg m\^2"),
        ({"counterjib": 12.0}, {}, "There is no argument 'counterjib'"),
    ],
)
def test_a_crane_that_is_not_the_one_that_its_site_enters_is_refused(
    entered: dict[str, float], loaded: dict[str, float], sentence: str
) -> None:
    """Also where it was loaded with the defaults, which its record does not list."""
    other = load_crane(values=loaded)
    with pytest.raises(CraneError, match=sentence):
        plan_lift(site(crane=entered), LIMITS, crane=other)


@pytest.mark.parametrize(
    ("entered", "sentence"),
    [
        ({"payload_mass": 9000.0}, "enters 9,000 kg as payload_mass; .* has 1,000 kg"),
        ({"hoist_effort": 2e5}, "enters 200,000 N as hoist_effort; .* has 100,000 N"),
        ({"trolley_max": 30.0}, "enters trolley_max, an argument that .*mine.urdf does not have"),
    ],
)
def test_a_plain_urdf_is_not_another_crane_than_its_site_enters(
    tmp_path: Path, entered: dict[str, float], sentence: str
) -> None:
    file = tmp_path / "mine.urdf"
    file.write_text(load_crane().urdf)
    with pytest.raises(DataError, match=sentence):
        crane_of(site(crane=entered), urdf=file)


def test_a_plain_urdf_with_the_numbers_of_its_site_is_its_crane(tmp_path: Path) -> None:
    file = tmp_path / "mine.urdf"
    file.write_text(load_crane(payload_mass=1500.0, hoist_effort=2e5).urdf)
    entered = {"payload_mass": 1500.0, "hoist_effort": 2e5, "counter_jib": 9.4}
    assert crane_of(site(crane=entered), urdf=file).payload_mass == 1500.0


def test_a_lift_that_takes_days_is_refused() -> None:
    with pytest.raises(CraneError, match="more than 100000 s"):
        plan_lift(site(), LIMITS, crane=load_crane(gravity=1e-12))


def test_every_leg_curve_and_motion_of_a_lift_is_proven() -> None:
    asked = lift().clearance
    made = lift()
    assert all(
        unproven_parameter(asked, Line(one, other), 0.0, 1.0) is None
        for one, other in zip(made.points, made.points[1:], strict=False)
    )
    assert unproven_parameter(asked, made.path, 0.0, made.path.duration) is None
    motion = made.timed.motion
    envelope = asked.envelope(motion.q[:, asked.joints.hoist])
    assert unproven_row(asked, motion.q, motion.period, envelope=envelope) is None


def test_the_motion_is_fast_and_exceeds_no_limit() -> None:
    timed = lift().timed
    assert timed.bound <= timed.motion.arrival
    assert lift().path.duration <= timed.bound
    assert max(timed.shares.values()) <= 1.0 + 1e-6
    # Rows four times as dense.
    assert max(use(crane(), timed.motion, LIMITS).values()) <= 1.0 + 1e-3
    swing = np.hypot(*timed.motion.q[:, 2:4].T).max()
    assert 0.7 * lift().clearance.site.swing < swing <= lift().clearance.site.swing * (1.0 + 1e-3)


def test_a_lift_is_measured_against_the_shorter_way_round_whichever_way_it_goes() -> None:
    """Beside it the long way round, planned as if a tower stood in the short one."""
    made = lift()
    shortest = straight_time(made.ends, LIMITS)
    assert (
        shortest <= made.least_duration <= made.timed.motion.arrival <= 1.25 * made.least_duration
    )
    # A cell of half a second more at both ends.
    assert made.grid_duration - 1.0 <= made.way_duration <= 1.02 * made.grid_duration
    round_about = made.ends - np.array([[0.0, 0.0, 0.0], [2.0 * math.pi, 0.0, 0.0]])
    long = min(
        _candidates(made.clearance, round_about, made.slews, LIMITS, 5e-3, math.inf),
        key=lambda lift: lift.timed.motion.arrival,
    )
    assert long.least_duration == pytest.approx(made.least_duration, rel=1e-12)
    assert long.timed.motion.arrival > 1.4 * long.least_duration


def test_the_least_time_of_a_lift_of_centimetres_is_less_than_its_motion_takes() -> None:
    near = np.array([6.05, -12.0, 4.0])
    made = plan_lift(site(goal=near), LIMITS, crane=crane())
    assert made.way_duration < 0.1  # less than a cell of half a second
    assert 0.0 < made.least_duration <= made.timed.motion.arrival


@pytest.mark.parametrize("limits", [(50, 50), (50, 400_000)])
def test_a_way_round_whose_grid_is_too_large_takes_at_least_the_time_of_its_drives(
    limits: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of both ways round the shorter one is searched first."""
    each_limit = iter(limits)

    def hurried(*args: Any, **options: Any) -> path_search.GridSearch:
        return path_search.best_on_grid(*args, cell_limit=next(each_limit), **options)

    monkeypatch.setattr("cranedyn.lifts.planning.lift.best_on_grid", hurried)
    made = replace(lift())
    assert made.least_duration == straight_time(made.ends, LIMITS)


def test_a_search_that_gives_up_may_have_missed_the_best_way() -> None:
    made = lift()
    bounds = np.array([[-3.0, 2.0, made.clearance.shortest_cable], [3.0, 22.0, 26.0]])
    best, hurried = (
        path_search.best_on_grid(
            made.clearance, made.ends, bounds, np.array(LIMITS.rates), cell_limit=limit
        )
        for limit in (400_000, 40)
    )
    assert best.points is not None and not best.gave_up
    assert hurried.gave_up and hurried.reached == 40


def test_a_lift_planned_after_another_is_the_same_to_the_last_bit() -> None:
    before = lift()
    plan_lift(site(start=np.array([9.0, -12.0, 4.0])), LIMITS, crane=crane())
    again = plan_lift(site(WALL), LIMITS, crane=crane())
    np.testing.assert_array_equal(again.timed.motion.q, before.timed.motion.q)


def test_the_load_goes_where_the_plan_says_and_arrives_without_swing_in_pinocchio_too() -> None:
    made = lift()
    certified = certify(made, engine="pinocchio", dt=1e-3)
    assert certified.holds
    run = certified.run
    other = certificate().run
    assert np.abs(run.q - other.q).max() < 2e-3  # steps of 1 ms instead of 0.5 ms
    points = made.clearance.point(made.timed.places)[:-1:50]
    rows = np.searchsorted(run.t, 50 * STEP * np.arange(len(points)) - 1e-9)
    carried = np.array([payload_position(crane(), run.q[row]) for row in rows])
    assert np.linalg.norm(carried - points, axis=1).max() < 0.02  # hoisting is of first order
    at_rest = other.q[-1:, 2:4], other.v[-1:, 2:4], float(other.q[-1, 4]), crane().gravity
    assert float(swing_amplitude(*at_rest)[0]) < ARRIVAL_SWING


def test_a_wall_moved_by_a_metre_into_the_plan_turns_its_certificate_red() -> None:
    moved = certify(lift(), with_wall(1.0))
    assert not moved.holds
    assert moved.nearest.obstacle == "wall"
    assert "not proven at t =" in red(moved)[0]
    assert certify(lift(), with_wall(0.0)).holds


ROAD = prism(
    "road", np.array([[4.0, -16.0], [8.0, -16.0], [8.0, -13.2], [4.0, -13.2]]), 0.0, 10.0, zone=True
)
"""Behind the start, nearer to the load there than the half metre that the wall keeps from it."""


def test_the_least_distance_of_a_certificate_is_that_of_the_whole_run_beside_a_zone_too() -> None:
    beside = clearance_of(crane(), site(WALL, ROAD))
    certified = certify(lift(), beside)
    rows = certified.run.q[::4]
    # The zone has the least room at the start; it asks for no distance, so the wall is nearest.
    assert 0.0 < beside.distances(rows[0], jib=False)["road"].distance < 0.5
    brute = min(one["wall"].distance for one in (beside.distances(q, jib=False) for q in rows))
    assert certified.nearest.obstacle == "wall"
    # Between rows 20 ms apart: a t²/2 of 1 m/s², and coal's tolerance.
    assert certified.nearest.distance == pytest.approx(brute, abs=1e-4)
    assert f"least is {brute:.2f} m, load and wall" in certified.checks[0].sentence


def test_a_start_too_near_to_a_zone_names_the_zone() -> None:
    with pytest.raises(
        NoWay, match=r"At the start the hook is 0\.\d\d m from road; it must keep out"
    ):
        plan_lift(site(WALL, ROAD), LIMITS, crane=crane())


def test_a_tower_in_the_way_of_the_jib_and_a_swing_at_the_arrival_turn_a_certificate_red() -> None:
    tower = box("tower", (22.0, 0.0), (4.0, 4.0, 40.0), 0.0)
    there = clearance_of(crane(), site(WALL, tower))
    strong = controller_of(lift())
    gain = strong.tracking.gain
    setpoint = strong.tracking.setpoint
    weak = replace(strong.tracking, gain=0.3 * gain, setpoint=setpoint + 0.05 * np.eye(10)[1])
    sentences = " ".join(red(certify(lift(), there, controller=replace(strong, tracking=weak))))
    assert "the jib comes too near to tower" in sentences
    assert "At the arrival it swings" in sentences


def test_the_regulator_of_a_lift_is_designed_once_for_each_step_and_integrals_are_not_shared(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = replace(lift())  # nothing is known of it yet
    steps = []

    def design(*given: Any, dt: float) -> Any:
        steps.append(dt)
        return lqr(*given, dt=dt)

    monkeypatch.setattr("cranedyn.lifts.planning.certificate.lqr", design)
    one = controller_of(made)
    other = controller_of(made)
    coarse = controller_of(made, dt=1e-3)
    assert steps == [5e-4, 1e-3]
    assert one is not other
    assert one.tracking is other.tracking is not coarse.tracking


# --- no way ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        (
            {"start": (6.0, -12.0, 1.7)},
            r"At the start the load is 1\.20 m from ground; it must keep 0\.5 m, and 0\.\d\d m for "
            r"a swing of .*° more\. Raise the start from z = 1\.70 m to 2\.0 m\.",
        ),
        (
            {"goal": (14.0, 0.5, 4.0)},
            "At the goal the (load|hook) is 0.00 m from wall; it must keep",
        ),
        (
            {"goal": (30.0, 0.0, 4.0)},
            r"reaches from 2 to 22 m from the slew axis; the goal at .* is 30\.00 m from it\. Move "
            r"the goal nearer to the axis",
        ),
        (
            {"goal": (10.0, 10.0, 27.0)},
            r"The centre of this load gets up to 24\.60 m above the ground; the goal at .* is "
            r"27\.00 m above it\. Lower the goal, or take",
        ),
        ({"start": None}, "does not say where the start of the lift is"),
        (  # the hook, on top of the load, would be in the trolley
            {
                "load": corners(1.0, 1.0, 21.0),
                "goal": (6.0, 12.0, 20.0),
                "start": (6.0, -12.0, 14.0),
            },
            r"centre of this load gets up to 1\d\.\d\d m above .* the goal .* is 20\.00 m above it",
        ),
    ],
)
def test_what_is_no_lift_is_refused_in_a_sentence(
    changes: dict[str, object], sentence: str
) -> None:
    given = {name: None if end is None else np.array(end) for name, end in changes.items()}
    with pytest.raises(CraneError, match=sentence):
        plan_lift(site(WALL, **given), LIMITS, crane=crane())


def test_a_load_inside_of_a_mesh_is_refused() -> None:
    import trimesh

    torus = trimesh.creation.torus(6.0, 4.0)
    mesh = body(
        "torus", np.array(torus.vertices) + np.array([14.0, 6.0, 8.0]), np.array(torus.faces)
    )
    with pytest.raises(NoWay, match=r"At the goal the load is inside of torus"):
        plan_lift(site(mesh, goal=np.array([14.0, 12.0, 8.0])), LIMITS, crane=crane())


def shaft() -> Site:
    """Return a site with a shaft up to the jib with a gate of 3.7 m: wide enough for a hook of
    1.8 m with 0.5 m on both sides, not for a load of 2.6 m.
    """
    walls = [
        ("inner", (8.0, -11.0), (0.5, 10.0)),
        ("outer", (17.0, -11.0), (0.5, 10.0)),
        ("back", (12.5, -16.5), (9.0, 0.5)),
    ]
    gates = [
        ("left of the gate", (9.1, -5.5), (2.5, 0.5)),
        ("right of the gate", (15.7, -5.5), (3.2, 0.5)),
    ]
    around = [box(name, centre, (*size, 26.0), 0.0) for name, centre, size in (*walls, *gates)]
    ends = {"start": np.array([12.3, -11.0, 4.0]), "goal": np.array([12.3, 6.0, 4.0])}
    return site(*around, load=corners(2.6, 2.6, 2.6), swing=0.003, **ends)


def test_a_load_wider_than_every_gap_is_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(path_search, "CELL_EDGES", (1.0,))
    with pytest.raises(
        NoWay,
        match=r"the start is enclosed by .*gate.* cells of 1 s can be reached from it\. The hook "
        r"without a load could",
    ):
        plan_lift(shaft(), LIMITS, crane=crane())


def test_a_search_that_gave_up_does_not_say_that_there_is_no_way(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(path_search, "CELL_EDGES", (1.0,))
    monkeypatch.setattr("cranedyn.lifts.planning.lift.MAX_CELLS", 3)
    with pytest.raises(
        NoWay, match=r"among \d+ cells of 1 s from the start.* Whether there is one is not known\."
    ):
        plan_lift(shaft(), LIMITS, crane=crane())


def test_a_direction_that_takes_too_long_is_no_reason_to_refuse_the_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Round the mast the lift takes more than the hours that a motion may, and the lift that was
    found takes longer than that as well, since its load must not swing.
    """
    made = lift()
    longer = made.ends - np.array([[0.0, 0.0, 0.0], [2.0 * math.pi, 0.0, 0.0]])
    between = 0.5 * (straight_time(made.ends, LIMITS) + straight_time(longer, LIMITS))
    monkeypatch.setattr(curve, "LONGEST_LIFT", between)
    gentle = site(WALL, swing=1e-3)
    found = plan_lift(gentle, LIMITS, crane=crane())
    assert found.timed.motion.arrival > straight_time(longer, LIMITS)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_jib_that_starts_too_near_to_something_at_an_end_of_its_range_names_it(
    side: float,
) -> None:
    start = np.array([6.0 * side, -12.0, 4.0])
    ends = load_crane(slew_limit=math.atan2(6.0, 12.0))
    beam = box("beam", (9.0 * side, -18.0), (1.0, 1.0, 60.0), 0.0)
    with pytest.raises(NoWay, match="At the start the jib is nearer to beam than"):
        plan_lift(site(beam, start=start, goal=np.array([0.0, -12.0, 4.0])), LIMITS, crane=ends)


def test_a_goal_close_to_where_the_jib_is_stopped_is_told_so() -> None:
    """The jib can turn to 0.06 rad beyond the goal, where the tower is; it must stay 0.1 rad away,
    for the swing of the load.
    """
    tower = box("tower", (25.0, 0.0), (12.0, 20.0, 40.0), 0.0)
    free = slew_range(clearance_of(crane(), site(tower)), 0.0, -math.pi, math.pi)
    angle = free.high - 0.06
    goal = np.array([10.0 * math.sin(angle), -10.0 * math.cos(angle), 4.0])
    with pytest.raises(NoWay, match=r"At the goal the slew is .*°; a lift needs it below .* tower"):
        plan_lift(site(tower, start=np.array([0.0, -12.0, 4.0]), goal=goal), LIMITS, crane=crane())


def test_an_end_beyond_the_range_of_the_slew_is_told_so() -> None:
    half = load_crane(slew_limit=1.0)
    with pytest.raises(NoWay, match=r"At the start the slew is -\d+\.\d°; .* where its range ends"):
        plan_lift(
            site(start=np.array([-12.0, 0.0, 4.0]), goal=np.array([0.0, -12.0, 4.0])),
            LIMITS,
            crane=half,
        )


def test_a_goal_behind_the_neighbours_jib_names_it() -> None:
    towers = [
        box(name, (x, y), (3.0, 3.0, 40.0), 0.0)
        for name, x, y in (("east", 20.0, 0.0), ("west", -20.0, 0.0))
    ]
    with pytest.raises(NoWay, match=r"cannot turn to the goal: (west and east|east and west) is"):
        plan_lift(site(*towers), LIMITS, crane=crane())


@pytest.mark.parametrize("other", [{"hook_mass": 300.0}, {"rope_stiffness": 1e7}])
def test_a_crane_of_other_joints_is_refused_in_a_sentence(other: dict[str, float]) -> None:
    needed = "A planned lift needs one chain of joints from the ground.*on the crane without a rope"
    with pytest.raises(ModelError, match=needed):
        plan_lift(site(WALL), LIMITS, crane=load_crane(**other))  # type: ignore[arg-type]
    sentence = " is made for a tower crane of five joints; this one also moves in "
    with pytest.raises(ModelError, match=f"A parked neighbour{sentence}"):
        parked = load_crane(**other)  # type: ignore[arg-type]
        neighbour("n", parked, parked.start.q, np.zeros(3), 0.0)


# --- perturbed ------------------------------------------------------------------------------------


def test_lifts_that_are_as_planned_are_as_near_as_planned() -> None:
    same = perturb(certificate(), 9, spread=Spread(0.0, 0.0, 0.0, 0.0, late=(0.0,)))
    assert same.failures == 0
    # a load that moves through still air is held back a little; between rows it is taken to be
    # nearer by half of its way of 0.1 s
    assert np.ptp(same.least) < 1e-6
    assert -0.25 < same.least[0] - certificate().nearest.distance <= 1e-3


def test_perturbed_lifts_by_many_threads_are_those_by_one_and_a_storm_is_not_survived() -> None:
    calm, again = (perturb(certificate(), 40, seed=3, threads=threads) for threads in (1, 4))
    np.testing.assert_array_equal(calm.least, again.least)
    np.testing.assert_array_equal(calm.swing, again.swing)
    storm = perturb(certificate(), 40, seed=3, spread=Spread(wind=15.0, gust=40.0))
    assert storm.failures > calm.failures
    assert storm.interval()[1] > calm.interval()[1]


def test_a_perturbed_lift_is_what_the_plain_loop_makes_of_it() -> None:
    """One with a heavy load, a long cable and late sensors, beside the plain loop with sensors that
    are really late.
    """
    made = lift()
    load = 1.3
    cable = 0.4
    delay = 4
    heavy = _crane_with_load(crane(), load)
    motion = made.timed.motion
    control = controller_of(lift(), dt=1e-3)
    weight = (load - 1.0) * crane().payload_mass * crane().gravity
    remembered = replace(control, integral=-weight / control.integral_gain)

    def misread(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        q = state.q.copy()
        q[made.clearance.joints.hoist] -= cable
        return remembered(t, State(q, state.v), setpoint)

    q = made.states()[0].q.copy()
    q[made.clearance.joints.hoist] += cable
    behind = with_sensor_model(
        made.crane, misread, delay=delay, noise=np.zeros(10), rng=np.random.default_rng(0)
    )
    duration = motion.arrival + 5.0
    start = State(q, np.zeros(5))
    run = quickly(heavy, behind, motion, start=start, duration=duration, dt=1e-3)
    drawn = dict.fromkeys(("wind_m_s", "gust_m_s", "gust_at_s", "direction_rad"), np.zeros(1))
    drawn |= {"load": np.array([load]), "cable_m": np.array([cable]), "gust_lasts_s": np.ones(1)}
    off = []
    for seconds in (delay * motion.period, 0.0):
        late_by = {"late_s": np.array([seconds])}
        batch, _ = _simulate_chunk(made, control, drawn | late_by, {load: heavy}, 1e-3)
        rows = np.searchsorted(run.t, batch.t - 1e-9)
        off.append(float(made.clearance.displacement(batch.q[0], run.q[rows]).max()))
    # half a kilogram force of still air's drag
    assert off[0] < 0.05
    assert off[0] < 0.6 * off[1]


def test_sensors_that_are_so_late_that_a_controller_is_unstable_break_every_lift_off() -> None:
    """The delay is fed back: it does not only move what was planned."""
    made = lift()
    late = perturb(certificate(), 9, spread=Spread(0.0, 0.0, 0.0, 0.0, late=(0.3,)))
    assert late.broken_off == 9
    # As the plain loop has it.
    behind = with_sensor_model(
        made.crane,
        controller_of(made, dt=1e-3),
        delay=60,
        noise=np.zeros(10),
        rng=np.random.default_rng(0),
    )
    motion = made.timed.motion
    with pytest.raises(RunError, match="its range is"):
        quickly(made.crane, behind, motion, start=made.states()[0], duration=10.0, dt=1e-3)


def test_lifts_that_run_at_once_share_a_load_and_none_is_lost() -> None:
    loads = np.random.default_rng(0).choice([0.7, 1.0], 2400)
    chunks = _chunks(loads)
    assert np.sort(np.concatenate(chunks)).tolist() == list(range(2400))
    assert all(np.ptp(loads[rows]) == 0.0 for rows in chunks)
    assert max(map(len, chunks)) <= 300


def test_a_lift_that_passes_a_plate_between_two_rows_kept_is_near_to_it() -> None:
    plate = box("plate", (13.4, 0.0), (6.0, 0.02, 20.0), 0.0)
    asked = clearance_of(crane(), site(plate))
    q = np.array([[asked.q(np.array([gamma, 13.4, 20.0])) for gamma in (1.3, 1.85)]])
    rooms = np.array([asked.margins_by_motion(row) for row in q[0]])
    assert rooms.min() > 0.5
    (least,) = _least_distances(asked, q[0], rooms, q, np.array([math.inf]), 0.1)
    assert least <= 0.0


def test_a_load_that_swings_out_and_back_between_two_rows_kept_is_not_where_these_are() -> None:
    """Pushed for half of the time and back for the other half, it is a h²/8 off at the middle."""
    asked = clearance_of(crane(), site(WALL))
    q = asked.q(np.array([0.0, 13.4, 20.0]))[None, None].repeat(2, axis=1)
    margins = np.full((2, 1), 1.0)
    (least,) = _least_distances(asked, q[0], margins, q, np.array([math.inf]), 0.1)
    assert least == pytest.approx(asked.site.distance + 1.0 - 32.0 * 0.1**2 / 8.0, abs=1e-12)


def test_rows_beside_a_measured_one_are_bounded_by_the_way_to_them() -> None:
    asked = clearance_of(crane(), site(WALL))
    q = np.array([asked.q(np.array([gamma, 13.4, 22.0])) for gamma in np.linspace(0.5, 1.6, 60)])
    half = asked.displacement(q[:-1], q[1:]) / 2.0
    steps = np.maximum(np.append(0.0, half), np.append(half, 0.0))
    bend = 32.0 * 0.1**2 / 8.0
    least = min(asked.margin(row) - step - bend for row, step in zip(q, steps, strict=True))
    far = np.full((len(q), 1), -9.0)
    (bound,) = _least_distances(asked, q, far, q[None], np.array([math.inf]), 0.1)
    assert least < 0.0
    assert bound == pytest.approx(least + asked.site.distance, abs=1e-9)


@pytest.mark.parametrize(
    "last_legs",
    [(0.0017, 5e-4), (0.3, 1.1e-4), (5e-5, 5e-5)],
    ids=["close points before the last", "a last leg of a tenth of a millimetre", "both so short"],
)
def test_no_two_points_of_the_grid_of_a_path_are_too_close(last_legs: tuple[float, float]) -> None:
    outward, down = last_legs
    points = np.array([[0.0, 10.0, 15.0]] * 4)
    points[1:, 0] = 0.1
    points[2:, 1] += outward
    points[3:, 2] += down
    rates = np.array(LIMITS.rates)
    legs = curve.leg_durations(points, rates)
    widths = np.minimum([0.98, 0.49] * legs[:-1], [0.49, 0.98] * legs[1:])
    path = curve.Path(points, rates, widths)
    s = timing._grid(path).s
    assert np.diff(s).min() > timing._MIN_GRID_DISTANCE
    assert s[0] == 0.0
    assert s[-1] == path.duration


@pytest.mark.parametrize("distance", [1e-2, 1e-5])
def test_a_lift_of_a_hundredth_of_a_millimetre_has_a_grid_as_any_other(distance: float) -> None:
    points = np.array([[0.0, 10.0, 15.0], [0.0, 10.0 + distance, 15.0]])
    path = curve.Path(points, np.array(LIMITS.rates), np.zeros(0))
    s = timing._grid(path).s
    assert_allclose(s, np.linspace(0.0, path.duration, 60), rtol=1e-12)


def test_a_way_that_takes_longer_than_another_is_given_up() -> None:
    made = lift()
    proven = partial(_is_proven, made.clearance, made.slews)
    arrival = made.timed.motion.arrival
    same, longer = (
        timed(made.clearance, made.path, made.limits, proven, shorter_than=duration)
        for duration in (arrival + 1.0, 0.5 * arrival)
    )
    assert same is not None and longer is None
    np.testing.assert_array_equal(same.motion.q, made.timed.motion.q)


def test_the_wind_at_the_start_leans_the_load_to_its_lee_and_meets_its_broad_side() -> None:
    start = np.tile(lift().states()[0].q, (2, 1))
    start[1, 0] = -2.0
    force = np.array([[300.0, 0.0, 0.0], [120.0, 500.0, 0.0]])
    plumb = [payload_position(crane(), q) for q in start]
    weight = crane().payload_mass * crane().gravity
    start = hanging_in_wind(lift().clearance, start, force, weight)
    off = np.array([payload_position(crane(), q) for q in start]) - plumb
    lean = np.linalg.norm(force, axis=1) / (crane().payload_mass * crane().gravity)
    length = float(start[0, 4])
    for shift, push, angle in zip(off, force, np.arctan(lean), strict=True):
        np.testing.assert_allclose(
            shift[:2], length * math.sin(angle) * push[:2] / np.linalg.norm(push), rtol=1e-9
        )
    assert _largest_silhouette(corners(2.0, 3.0, 4.0)) == pytest.approx(4.0 * math.sqrt(13.0))


def test_a_lift_that_failed_counts_as_one_that_came_too_near() -> None:
    perturbed = Perturbed(np.array([1.0, math.nan, 0.4]), 0.5, {}, np.zeros(3))
    assert (perturbed.failures, perturbed.broken_off) == (2, 1)


# --- the experiment -------------------------------------------------------------------------------


SITE = """
[crane]
values = {hoist_max = 30.0}
[ground]
height = 0.0
[load]
size = [1.0, 1.0, 1.0]
[lift]
from = [6.0, -12.0, 4.0]
to = [10.0, 6.0, 6.0]
[[box]]
name = "wall"
centre = [14.0, -2.0]
size = [14.0, 1.0, 5.0]
[[keep_out]]
name = "road"
outline = [[-8.0, -3.0], [-4.0, -3.0], [-4.0, 3.0]]
"""


@pytest.mark.long
def test_the_experiment_lifts_from_the_ground_and_leaves_tables_runs_and_a_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import rerun.chunk

    (tmp_path / "yard.toml").write_text(SITE.replace("-12.0, 4.0]", "-12.0]"))
    out = tmp_path / "out"
    options = "--to 10 6 --lifts=16 --least-time --out".split()
    code = experiment.main(["--site", str(tmp_path / "yard.toml"), *options, str(out)])
    text = capsys.readouterr().out
    assert code == 0, text
    assert {path.name for path in out.iterdir()} == {
        *("result.json", "lift.rrd", "lift_yard.parquet", "grounded_yard.parquet"),
        "least_time_yard.parquet",
        *(f"{figure}_yard.{kind}" for figure in ("site", "time") for kind in ("png", "svg")),
    }
    result = json.loads((out / "result.json").read_text())
    assert [table["title"] for table in result["tables"]] == [
        "Certified lifts",
        "Perturbed lifts",
        "In least time",
        "What the certificates rest on",
        "How long it took on this machine",
    ]
    origins = {row[1]: row[3] for row in result["tables"][3]["rows"]}
    assert origins["size of the load"] == "entered"
    assert origins["mass of the load with its rigging"] == "default"
    assert all(claim["holds"] for claim in result["claims"])
    phases = ["yard: Lift-off", "yard: Motion", "yard: Above its supports", "yard: Set-down"]
    said = [claim["sentence"] for claim in result["claims"]]
    assert all(any(sentence.startswith(phase) for sentence in said) for phase in phases)
    entities = {
        str(chunk.entity_path) for chunk in rerun.chunk.RrdReader(out / "lift.rrd").stream()
    }
    assert {f"/yard/scene/{part}" for part in ("site/0", "site/1", "planned", "swept")} <= entities


KIOSK = """
[ground]
height = 0.0
[load]
size = [1.0, 1.0, 1.0]
mass = 500.0
[lift]
from = [8.0, -10.0, 2.0]
to = [14.0, 8.0, 4.0]
[[box]]
name = "kiosk"
centre = [12.0, 0.0]
size = [5.0, 5.0, 2.3]
"""


def test_a_lift_of_somebody_that_takes_long_is_certified_all_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its motion takes 1.9 times what the drives need, more than is claimed of examples."""
    (tmp_path / "kiosk.toml").write_text(KIOSK)
    words = ["--site", str(tmp_path / "kiosk.toml"), "--lifts", "0", "--all"]
    assert experiment.main([*words, "--out", str(tmp_path / "out")]) == 0
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    table = result["tables"][0]
    ratio = table["rows"][0][table["columns"].index("motion / bound")]
    assert ratio > experiment.MAX_MOTION_RATIO
    sentences = [claim["sentence"] for claim in result["claims"]]
    assert sentences[-1] == "kiosk: the lift is certified, all 8 checks hold."
    assert not any("times what drives need" in sentence for sentence in sentences)


def box_of(name: str, centre: tuple[float, ...], size: tuple[float, ...]) -> str:
    """Return a box as a table of a site's file."""
    return f'[[box]]\nname = "{name}"\ncentre = {[*centre]}\nsize = {[*size]}\n'


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ("--site yard.toml --set hoist_effort:=9000", "The hoist holds 918 kg; the load with"),
        ("--site yard.toml --from 6000 -12000 4000", "Is 12,000 in millimetres?"),
        ("--site tower.toml", "the mast stands in office around the mast"),
        ("--site nowhere.toml", "Cannot read nowhere.toml"),
        ("--from 1 2 3", "--from is for one site; give one with --site"),
        ("--lifts -1", "lifts is -1"),
        ("--site yard.toml --from 14 -2 4", "is 0.00 m from wall"),
        ("--site yard.toml --from 6", "start of the load is an array of shape (1,)"),
    ],
)
def test_the_experiment_refuses_in_a_sentence_and_leaves_nothing(
    arguments: str,
    sentence: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("yard.toml").write_text(SITE)
    office = (
        '[[box]]\nname = "office around the mast"\ncentre = [0.0, 0.0]\nsize = [6.0, 6.0, 9.0]\n'
    )
    Path("tower.toml").write_text(SITE + office)
    assert experiment.main([*arguments.split(), "--out", "out"]) == 2
    assert sentence in capsys.readouterr().err and not Path("out").exists()


@pytest.mark.parametrize("duration", [LONGEST_LIFT + 1.0, math.inf, math.nan])
def test_a_motion_of_hours_is_refused_and_one_of_minutes_is_not(duration: float) -> None:
    refuse_endless(LONGEST_LIFT, LIMITS)
    with pytest.raises(OutOfRange, match="allowed is up to 2"):
        refuse_endless(duration, LIMITS)


@pytest.mark.parametrize(
    "limits", [Limits([1e-9] * 3, [0.1] * 3), Limits([0.08, 1.0, 1.0], [1e-9] * 3)]
)
def test_a_lift_that_would_take_hours_is_refused_before_it_is_planned(limits: Limits) -> None:
    yard = read_site(SITES / "open_yard.toml")
    ends = {"start": np.array([6.0, -14.0]), "goal": np.array([8.0, -13.0])}
    with pytest.raises(OutOfRange, match=r"time that drives need at .* h; allowed is up to 2\."):
        plan_lift(yard, limits, **ends)
