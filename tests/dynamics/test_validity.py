"""Where the model ceases to hold, and what a run does about it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from cranedyn.compiled.batch import simulate_batch
from cranedyn.controllers import hold_controller, lqr
from cranedyn.data.trajectory import QUANTITIES, Trajectory
from cranedyn.dynamics.bodies import bodies_of_model, heights, point_paths
from cranedyn.dynamics.equations_of_motion import point_positions
from cranedyn.dynamics.validity import conditions, events, first_event, valid
from cranedyn.errors import CraneError, RunError
from cranedyn.export.usual_controllers import usual_controller
from cranedyn.interfaces import EngineName, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.references import hold, ramp
from cranedyn.references.flat import flat
from cranedyn.simulation.simulate import simulate
from tests.helpers import FAST, ROOT, G, big_crane, constant, crane, locked


def outward(validity: str) -> Trajectory:
    """The trolley is asked to go 2 m beyond the tip of the jib."""
    start = crane().state(x=10.0, l=15.0)
    reference = ramp(crane(), hold(crane(), start), "x", 14.0, rate=1.5, at=1.0)
    return simulate(
        crane(),
        hold_controller(crane(), gravity=G),
        reference,
        start=start,
        duration=20.0,
        validity=validity,
    )  # type: ignore[arg-type]


def test_a_run_stops_where_a_drive_leaves_its_range_and_keeps_what_it_has() -> None:
    with pytest.raises(
        RunError, match=r"trolley_joint is at 22\.\d+ m, its range is 2 to 22"
    ) as caught:
        outward("stop")
    error = caught.value
    assert error.joint == "trolley_joint"
    assert error.trajectory is not None
    assert error.trajectory["x_m"][-1] == error.value > 22.0
    assert (error.trajectory["x_m"][:-1] <= 22.0).all()
    assert error.t == error.trajectory.t[-1]
    assert error.trajectory["valid"].tolist() == [1.0] * (len(error.trajectory) - 1) + [0.0]


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["pinocchio", FAST])
def test_rows_in_which_a_drive_is_faster_than_its_joint_allows_are_not_valid_and_the_run_goes_on(
    engine: EngineName,
) -> None:
    slow = load_crane(trolley_velocity=0.5)
    start = slow.state(x=8.0, l=10.0)
    motion = flat(slow, start, slow.state(x=18.0, l=10.0), 20.0)
    controller = lqr(slow, motion)
    run = simulate(slow, controller, motion, start=start, duration=25.0, engine=engine)
    too_fast = np.abs(run["x_dot_m_s"]) > 0.5
    assert too_fast.any() and run.t[-1] == 25.0
    assert ((run.valid == 0.0) == too_fast).all()
    assert "trolley_joint moves at 0.5" in events(slow, run)[0].words
    pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    batch = simulate_batch(slow, controller, motion, start=[start] * 2, duration=25.0)
    assert (batch.valid_until == run.t[too_fast.argmax()]).all()


def test_a_joint_may_leave_its_range_by_round_off_and_by_no_more() -> None:
    """A nanometre is far above the round-off of a coordinate, and far below what matters."""
    one = crane()
    x = one.layout.index("x")
    start = one.state(x=10.0)
    held = np.array([0.0, 0.0, -one.payload_mass * G])
    for end, outward_sign in ((one.lower[x], -1.0), (one.upper[x], 1.0)):
        rows = np.tile(start.q, (3, 1))
        rows[:, x] = end + outward_sign * np.array([0.0, 1e-12, 1e-8])
        hoist = np.full(3, held[2])
        within = valid(conditions(one, rows, np.zeros_like(rows), hoist))
        assert within.tolist() == [True, True, False]


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["pinocchio", FAST])
def test_a_drive_that_holds_at_the_end_of_its_range_ends_no_run(engine: EngineName) -> None:
    """Behind an observer the travel of the portal crane creeps by 2e-33 m."""
    portal = load_crane(ROOT / "examples" / "portal_crane.urdf")
    travel = portal.layout.index("travel")
    assert portal.start.q[travel] == portal.lower[travel]
    controller, _ = usual_controller("observer", portal, 5e-3)
    run = simulate(portal, controller, duration=0.1, engine=engine)
    assert run.valid.all()
    assert (run.q[:, travel] < portal.lower[travel]).any()


@pytest.mark.slow
def test_a_marked_run_goes_on_to_its_end_and_names_where_it_left_the_range() -> None:
    run = outward("mark")
    assert run.t[-1] == 20.0
    assert run["x_m"][-1] == pytest.approx(24.0, abs=0.1)
    assert ((run["x_m"] > 22.0) == (run["valid"] == 0.0)).all()
    found = events(crane(), run)
    assert [(event.joint, event.row) for event in found[:1]] == [
        ("trolley_joint", int(np.argmax(run["x_m"] > 22.0)))
    ]


@pytest.mark.slow
def test_buffers_hold_the_trolley_at_the_end_of_its_range_with_their_energy_in_the_ledger() -> None:
    run = outward("buffers")
    # the drive presses with 300 kN/m · 2 m against a spring of (20 rad/s)² times the joint's
    # inertia of at most 1.6 t
    assert 22.5 < run["x_m"].max() < 24.0
    assert run["W_buffers_J"][-1] < -1e4
    assert np.abs(run.unexplained).max() < 1e-3 * abs(run["W_buffers_J"][-1])  # a step's error
    assert run["valid"].all()


def test_a_buffer_pushes_but_never_pulls() -> None:
    # a trolley without drive rolls against the end and comes back slower, the damper has taken some
    light = crane(payload_mass=1e-6, payload_inertia=0.0)
    start = light.state(x=21.5, x_dot=1.0)
    run = simulate(
        light, constant(0.0, 0.0, -1e-6 * G), start=start, duration=2.0, validity="buffers"
    )
    assert 22.0 < run["x_m"].max() < 22.1
    # a mass on a spring with a damper of ζ that lets go when it would pull keeps exp(-2ζ acos
    # ζ/√(1-ζ²)) of its speed; within a step's 1 %
    assert run["x_dot_m_s"][-1] == pytest.approx(
        -math.exp(-math.acos(0.5) / math.sqrt(0.75)), rel=0.01
    )
    # Free again; the load of 1e-6 kg.
    assert_allclose(run["x_dot_m_s"][-50:], run["x_dot_m_s"][-1], rtol=1e-6)


@pytest.mark.slow
def test_a_buffer_at_the_end_of_the_cable_holds_the_load_whose_rope_stays_taut() -> None:
    start = crane().state(l=23.0)
    reference = ramp(crane(), hold(crane(), start), "l", 4.0, rate=1.0, at=0.5)
    run = simulate(
        crane(),
        hold_controller(crane(), gravity=G),
        reference,
        start=start,
        duration=15.0,
        validity="buffers",
    )
    # the drive lets down with 30 kN/m beyond 26.4 m, against (20 rad/s)² times the load of 1 t: 0.6
    # m off its aim less 0.04 m
    assert 26.4 < run["l_m"][-1] < 26.5
    assert run["valid"].all()
    assert run["W_buffers_J"][-1] < -10.0


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["pinocchio", FAST])
def test_a_buffer_at_the_shortest_cable_stops_the_hook_block_but_cannot_push_the_load(
    engine: EngineName,
) -> None:
    start = crane().state(l=3.6)
    brake = hold_controller(crane(), gravity=G)
    gentle = ramp(crane(), hold(crane(), start), "l", -0.6, rate=0.2, at=0.5)
    run = simulate(
        crane(), brake, gentle, start=start, duration=20.0, validity="buffers", engine=engine
    )
    # the drive pulls with 30 kN/m above its aim of 3 m, the buffer pushes with (20 rad/s)² times
    # the load of 1 t below 3.4 m
    assert run["l_m"][-1] == pytest.approx((3.0 * 3e4 + 3.4 * 4e5) / (3e4 + 4e5), abs=1e-6)
    assert run["valid"].all()
    # at 1 m/s the damper alone pushes with 20 kN, the hoist pulls with 10 kN
    fast = ramp(crane(), hold(crane(), crane().state(l=6.0)), "l", -3.0, rate=1.0, at=0.5)
    how = {"start": crane().state(l=6.0), "duration": 5.0}
    with pytest.raises(RunError, match="the rope would have to push") as caught:
        simulate(crane(), brake, fast, validity="buffers", engine=engine, **how)
    error = caught.value
    assert error.trajectory is not None
    assert error.trajectory["l_m"][-1] < 3.4
    assert error.trajectory["valid"].tolist() == [1.0] * (len(error.trajectory) - 1) + [0.0]
    (event,) = events(crane(), error.trajectory)
    assert (event.row, event.value) == (len(error.trajectory) - 1, pytest.approx(error.value))
    if engine == "compiled":
        from cranedyn.compiled.batch import simulate_batch

        batch = simulate_batch(
            crane(), brake, fast, start=[how["start"]], duration=5.0, buffers=True
        )
        assert batch.valid_until[0] == pytest.approx(error.t, abs=1e-9)


def test_heights_of_many_rows_are_pinocchios_on_an_arm_with_turned_joints() -> None:
    model = pin.buildSampleModelManipulator()
    rng = np.random.default_rng(5)
    for i in range(1, model.njoints):
        model.jointPlacements[i] = pin.SE3.Random()
    data = model.createData()
    q = rng.normal(size=(20, model.nv))
    point = rng.normal(size=3)
    expected = np.empty((20, model.nv))
    for row, one in enumerate(q):
        pin.forwardKinematics(model, data, one)
        expected[row] = [data.oMi[i].act(point)[2] for i in range(1, model.njoints)]
    found = [heights(bodies_of_model(model), q, body, point) for body in range(model.nv)]
    assert_allclose(np.transpose(found), expected, atol=1e-13)  # rounding of heights of some metres


def test_positions_of_points_in_many_rows_are_pinocchios() -> None:
    q = crane().start.q + np.random.default_rng(0).uniform(-1.0, 1.0, (20, 5))
    expected = [point_positions(crane(), row) for row in q]
    assert_allclose(point_paths(crane(), q), expected, atol=1e-13)  # rounding, as above


def test_a_load_on_the_ground_stops_the_run_when_it_gets_there() -> None:
    low = crane(pivot_height=27.0, hoist_max=30.0)
    start = low.state(l=26.0)
    reference = ramp(low, hold(low, start), "l", 2.0, rate=0.5, at=0.0)
    with pytest.raises(RunError, match="below the ground") as caught:
        simulate(low, hold_controller(low, gravity=G), reference, start=start, duration=10.0)
    assert caught.value.trajectory is not None
    assert caught.value.trajectory["l_m"][-1] == pytest.approx(27.0, abs=0.01)  # 5 ms at 0.5 m/s


def test_a_swing_beyond_the_jib_stops_the_run() -> None:
    point = big_crane()
    start = point.state(l=20.0, phi=1.5, phi_dot=0.5)
    with pytest.raises(RunError, match=r"swing_radial_joint swings by 1\.57\d* rad"):
        simulate(point, locked, start=start, duration=5.0, drive="motion")


@pytest.mark.parametrize("where", [0, 100, 101, 199, 200, 1999, 2000])
def test_no_row_escapes_the_look_at_validity(where: int) -> None:
    def slack_once(t: float, *_: object) -> np.ndarray:
        return np.array([0.0, 0.0, 5.0 if round(t / 5e-3) == where else -1000.0 * G])

    with pytest.raises(RunError, match="rope would have to push, its tension is -5 N") as caught:
        simulate(crane(), slack_once, duration=10.0)
    assert caught.value.joint == "hoist_joint" and caught.value.trajectory is not None
    assert len(caught.value.trajectory) == where + 1


def test_what_a_controller_cannot_answer_is_said_with_the_record_so_far() -> None:
    def gives_up(t: float, *_: object) -> np.ndarray:
        if t > 0.5:
            raise CraneError("No solution.")
        return np.array([0.0, 0.0, -1000.0 * G])

    with pytest.raises(RunError, match=r"At t = 0\.505 s: No solution\.") as caught:
        simulate(crane(), gives_up, duration=1.0)
    assert caught.value.trajectory is not None
    assert len(caught.value.trajectory) == 101


def test_a_load_on_no_cable_is_refused_where_motion_is_prescribed() -> None:
    point = crane(payload_inertia=0.0, dummy_mass=0.0, dummy_inertia=0.0)
    with pytest.raises(CraneError, match="inertia against swing is 0 and 0 kg m²"):
        simulate(
            point,
            locked,
            start=State(np.array([0.0, 10.0, 0.0, 0.0, 0.0]), np.zeros(5)),
            duration=0.1,
            drive="motion",
        )


@pytest.mark.parametrize("force", [1.5e308, 1e200])
def test_a_motion_that_costs_no_finite_effort_keeps_a_finite_record(force: float) -> None:
    def disturbance(t: float, state: State) -> np.ndarray:
        return np.full((2, 3), force if t > 0.05 else 0.0)

    with pytest.raises(RunError) as caught:
        simulate(
            crane(), locked, duration=1.0, drive="motion", validity="mark", disturbance=disturbance
        )
    assert caught.value.trajectory is not None
    assert all(np.isfinite(getattr(caught.value.trajectory, name)).all() for name in QUANTITIES)


@pytest.mark.parametrize("part", ["q", "v"])
@pytest.mark.parametrize("first", [0.0, 0.5])
def test_a_controller_cannot_change_the_state_it_is_given(part: str, first: float) -> None:
    def meddling(t: float, state: State, setpoint: object) -> np.ndarray:
        if t >= first:
            getattr(state, part)[0] += 1.0
        return np.array([0.0, 0.0, -1000.0 * G])

    with pytest.raises(RunError, match="read-only") as caught:
        simulate(crane(), meddling, duration=1.0)
    assert isinstance(caught.value.__cause__, ValueError)
    assert caught.value.trajectory is not None and len(caught.value.trajectory) == round(
        first / 5e-3
    )


def test_a_controller_cannot_change_the_setpoint_it_is_given() -> None:
    def meddling(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        setpoint.position[1] += 1.0
        return np.zeros(3)

    with pytest.raises(RunError, match="read-only"):
        simulate(crane(), meddling, duration=1.0)


BRANCHED = """<robot name="bridge"><link name="ground"/>
  <link name="carriage">{body}</link><link name="rod"/>
  <link name="load">{body}</link><link name="camera">{body}</link><link name="spun">{body}</link>
  <joint name="travel" type="prismatic"><parent link="ground"/><child link="carriage"/>
    <origin xyz="0 0 9"/><axis xyz="1 0 0"/>
    <limit lower="-5" upper="5" effort="1e4" velocity="1"/></joint>
  <joint name="swing" type="revolute"><parent link="carriage"/><child link="rod"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <joint name="lift" type="prismatic"><parent link="rod"/><child link="load"/>
    <axis xyz="0 0 -1"/><limit lower="1" upper="20" effort="1e4" velocity="1"/></joint>
  <joint name="swivel" type="revolute"><parent link="load"/><child link="spun"/>
    <axis xyz="0 0 1"/><limit lower="-9" upper="9" effort="1" velocity="1"/></joint>
  <joint name="zoom" type="prismatic"><parent link="carriage"/><child link="camera"/>
    <axis xyz="0 0 1"/><limit lower="0" upper="1" effort="1e3" velocity="1"/></joint>
</robot>""".replace(
    "{body}",
    '<inertial><mass value="50"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    "</inertial>",
)
"""A bridge crane with a camera on its carriage, whose joint comes after that of the payload, and a
swivel below the hook."""


@pytest.fixture
def branched(tmp_path: Path) -> Crane:
    path = tmp_path / "bridge.urdf"
    path.write_text(BRANCHED, encoding="utf-8")
    return load_crane(path, driven=["travel", "lift", "zoom"], payload="swivel")


def test_a_payload_below_the_ground_is_named_by_its_joint_in_a_tree_too(branched: Crane) -> None:
    q = branched.state(lift=10.0).q
    event = first_event(branched, conditions(branched, q[None], 0.0 * q[None], np.array([-500.0])))
    assert event is not None
    assert (event.joint, event.value) == ("swivel", pytest.approx(-1.0))


def test_a_load_may_turn_about_the_vertical_as_far_as_its_swivel_does(branched: Crane) -> None:
    q = branched.state(swivel=3.0, lift=5.0).q
    assert valid(conditions(branched, q[None], 0.0 * q[None], np.array([-500.0]))).all()
