"""Ropes that go slack: changes of phase within a step, impacts, and both engines."""

from __future__ import annotations

import importlib
import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from cranedyn import theory
from cranedyn.controllers import Hold, hold_controller
from cranedyn.controllers.hold import zero_command
from cranedyn.data.trajectory import Trajectory, join, read
from cranedyn.dynamics.drives import EffortDrives, MotionDrives
from cranedyn.dynamics.equations_of_motion import (
    acceleration,
    constraint_tension,
    holding_effort,
    linearise,
    payload_position,
    prescribed_acceleration,
)
from cranedyn.dynamics.integrators import rk4, semi_implicit_euler
from cranedyn.dynamics.joint_forces import JointForces, rope_tension
from cranedyn.dynamics.linearisation import free_modes, held_states, sampled
from cranedyn.errors import CraneError, RunError
from cranedyn.interfaces import State
from cranedyn.lifts.judging.loads import loads
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate
from experiments.scenarios.crane_variants import POINT
from tests.oracles.contact_engine import RopeOfDrives

pytestmark = pytest.mark.usefixtures("oracle")

ROPES = {"elastic": 3e6, "inextensible": math.inf}


@cache
def slack_crane(rope: str = "inextensible", **values: float) -> Crane:
    return load_crane(rope_stiffness=ROPES[rope], **{"hoist_velocity": 20.0, **POINT, **values})


def lifted(crane: Crane, by: float, **values: float) -> State:
    """Return a load that hangs a distance [m] higher than its rope lets it."""
    return crane.state(rope_stretch=-by, **values)


def run_of(crane: Crane, start: State, duration: float, **options: Any) -> Trajectory:
    controller = options.pop("controller", None) or zero_command(crane)
    return simulate(
        crane, controller, start=start, duration=duration, **{"drive": "motion", **options}
    )


def paid_out(crane: Crane, acceleration: float) -> Hold:
    """Return a controller whose hoist accelerates downward [m/s²]."""
    return Hold(crane, *np.zeros((2, crane.layout.m)), np.array([0.0, 0.0, acceleration]))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rope", "drive"),
    [
        # Both ropes and all drives are in the default run, but not each rope with each drive.
        ("elastic", "effort"),
        ("elastic", "velocity"),
        ("inextensible", "motion"),
        pytest.param("elastic", "motion", marks=pytest.mark.long),
        pytest.param("inextensible", "effort", marks=pytest.mark.long),
        pytest.param("inextensible", "velocity", marks=pytest.mark.long),
    ],
)
def test_both_engines_go_through_the_same_phases(rope: str, drive: str) -> None:
    crane = slack_crane(rope, payload_inertia=300.0, dummy_mass=20.0)
    start = lifted(crane, 0.6, phi=0.3, theta_dot=0.2)
    for integrator in (semi_implicit_euler, rk4):
        controller = hold_controller(crane) if drive == "effort" else zero_command(crane)
        options = {"drive": drive, "integrator": integrator, "controller": controller}
        plain, compiled = (
            run_of(crane, start, 1.5, engine=engine, **options) for engine in ("oracle", "compiled")
        )
        assert 0.0 < plain.phase.mean() < 1.0  # type: ignore[union-attr]
        for name in ("q", "v", "phase", "outside"):
            ours = getattr(plain, name)
            theirs = getattr(compiled, name)
            assert_allclose(ours, theirs, rtol=0, atol=1e-8 * max(1.0, np.abs(ours).max()))


@pytest.mark.slow
@pytest.mark.parametrize("rope", ROPES)
def test_rk4_keeps_its_order_through_changes_of_phase(rope: str) -> None:
    """A load that swings up while the drum pays out leaves its rope at an event of the state, and
    is caught again; a change that is a step late would cost the square of the step.
    """
    crane = slack_crane(rope)
    start = crane.state(phi=0.0, phi_dot=1.2, l=6.0, rope_stretch=0.01 * (rope == "elastic"))
    ends = []
    for dt in (1e-2, 5e-3, 2.5e-3, 3.125e-4):
        options = {"dt": dt, "control_period": dt, "integrator": rk4, "engine": "compiled"}
        first = run_of(crane, start, 1.0, controller=paid_out(crane, 9.6), **options)
        second = run_of(crane, first.state(-1), 0.5, **options)
        assert {*first["phase"]} == {*second["phase"]} == {0.0, 1.0}
        ends.append(second.q[-1])
    errors = [float(np.abs(end - ends[-1]).max()) for end in ends[:-1]]
    assert errors[2] < errors[0] / 100.0, errors  # 256 for order 4, 16 for order 2


def test_an_impact_keeps_the_momentum_of_all_that_is_free() -> None:
    crane = slack_crane(payload_inertia=300.0, dummy_mass=20.0)
    rng = np.random.default_rng(5)
    stretch = crane.layout.index("rope_stretch")
    for drives, kept in (
        (EffortDrives(crane, None), [0, 1, 2, 3, 4]),
        (MotionDrives(crane, None), [2, 3]),
    ):
        state = lifted(crane, 0.0, phi=0.4, theta=-0.3)
        v = rng.normal(size=crane.layout.n)
        after, gained = RopeOfDrives(crane, drives).impact(state.q, v)
        mass = pin.crba(crane.model, crane.data, state.q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        assert after[stretch] == 0.0
        assert_allclose((mass @ (after - v))[kept], 0.0, atol=1e-9 * np.abs(mass @ v).max())
        assert_allclose(np.delete(after, [*kept, stretch]), np.delete(v, [*kept, stretch]))
        assert gained == pytest.approx(0.5 * (after @ mass @ after - v @ mass @ v), rel=1e-9)


@pytest.mark.parametrize("engine", ["oracle", "compiled"])
def test_a_load_falls_freely_until_the_rope_catches_it_and_then_hangs(engine: Any) -> None:
    crane = slack_crane()
    run = run_of(crane, lifted(crane, 0.8), 0.6, engine=engine, integrator=rk4)
    weight = crane.payload_mass * crane.gravity
    time = math.sqrt(1.6 / crane.gravity)
    assert_allclose(run.phase, run.t < time)  # type: ignore[arg-type]
    caught = run.t > time
    assert (run["rope_stretch_m"][caught] == 0.0).all()
    assert_allclose(run["F_l_N"], np.where(caught, -weight, 0.0), atol=1e-6)
    assert run["W_impacts_J"][-1] == pytest.approx(-0.8 * weight, rel=1e-9)
    assert np.abs(run.unexplained).max() < 1e-12 * run["energy_J"].max()
    assert_allclose(loads(crane, run)["rope_N"], np.where(caught, weight, 0.0), atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["oracle", "compiled"])
def test_a_drum_that_pays_out_faster_than_a_load_falls_leaves_the_rope_slack(engine: Any) -> None:
    crane = slack_crane()
    rigid = load_crane(hoist_velocity=20.0, **POINT)
    with pytest.raises(RunError, match=r"would have to push.*give the crane rope_stiffness = inf"):
        run_of(rigid, rigid.start, 0.1, controller=paid_out(rigid, 12.0), engine=engine)
    run = run_of(crane, crane.start, 0.5, controller=paid_out(crane, 12.0), engine=engine)
    fallen = crane.start.q[4] - (run["l_m"] + run["rope_stretch_m"])
    assert_allclose(-fallen, crane.gravity * run.t * (run.t + 5e-4) / 2.0, atol=1e-9)  # Euler
    assert (run.phase[1:] == 1.0).all()  # type: ignore[index]


@pytest.mark.slow
def test_lanes_of_a_batch_change_their_phases_on_their_own() -> None:
    from cranedyn.compiled.batch import simulate_batch

    crane = slack_crane()
    starts = [lifted(crane, by) for by in (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.1, 1.3, 1.5)]
    options: Any = {"drive": "motion", "duration": 1.0, "integrator": rk4}
    batch = simulate_batch(crane, zero_command(crane), start=starts, **options)
    for i, start in enumerate(starts):
        alone = simulate(crane, zero_command(crane), start=start, **options)
        assert_allclose(batch.end.q[i], alone.q[-1], atol=1e-9)


def test_a_taut_rope_that_does_not_stretch_is_a_rigid_one() -> None:
    """Its linear model, its modes and its motion, with a drum that weighs next to nothing."""
    crane = slack_crane(drum_inertia=1e-6)
    rigid = load_crane(**POINT)
    state = rigid.state(phi=0.2, theta=-0.1, gamma_dot=0.1, l_dot=0.3)
    with_stretch = State(np.append(state.q, 0.0), np.append(state.v, 0.0))
    effort = holding_effort(rigid, state.q)
    expected, theirs = linearise(rigid, state, effort)
    ours, by_effort = linearise(crane, with_stretch, effort)
    columns = [i for i in range(12) if i not in (5, 11)]
    assert_allclose(ours[np.ix_(range(5), columns)], expected, rtol=1e-6, atol=1e-8)
    assert_allclose(by_effort[:5], theirs, rtol=1e-6, atol=1e-12)
    assert not ours[5].any()
    held = held_states(crane, with_stretch)
    assert held == [5, 11] and not sampled(crane, with_stretch).a[:, held].any()
    modes = [free_modes(c, c.start).frequencies for c in (crane, rigid)]
    assert_allclose(*modes, rtol=1e-12)
    runs = [run_of(c, s, 1.0) for c, s in ((crane, with_stretch), (rigid, state))]
    assert_allclose(runs[0].q[:, :5], runs[1].q, atol=1e-10)


def test_phases_and_impacts_are_read_and_joined_as_written(tmp_path: Path) -> None:
    crane = slack_crane()
    run = run_of(crane, lifted(crane, 0.2), 0.4)
    for name in ("run.csv", "run.parquet"):
        run.write(tmp_path / name)
        again = read(tmp_path / name)
        assert_allclose(again["phase"], run["phase"])
        assert_allclose(again["W_impacts_J"], run["W_impacts_J"])
    assert load_crane(from_record=tmp_path / "run.parquet").springs.rope == crane.springs.rope
    pieces = [run.between(0.0, 0.3), run_of(crane, run.state(60), 0.1, t_start=0.3)]
    whole = join(pieces)
    assert_allclose(whole["phase"], run["phase"])
    assert_allclose(whole.ledger, run.ledger, rtol=1e-12)


@pytest.mark.parametrize("rope", ROPES)
def test_a_load_thrown_up_to_its_pivot_ends_the_run(rope: str) -> None:
    crane = slack_crane(rope)
    thrown = lifted(crane, 0.1, rope_stretch_dot=-20.0)
    with pytest.raises(RunError, match=r"the load is -.* m below its pivot"):
        run_of(crane, thrown, 2.0)


def test_two_falls_do_not_stretch() -> None:
    with pytest.raises(CraneError, match="two falls and a rope that stretches"):
        load_crane(fall_spacing=2.0, rope_stiffness=math.inf)


# --- another engine -------------------------------------------------------------------------------


def _mujoco(rope: str, start: np.ndarray, length: float, stiffness: float, dt: float) -> Any:
    """Return the position of a point load on a spatial tendon after 1.5 s, relative to its pivot:
    a spring with a dead band, or a limit of the length, which MuJoCo softens over two steps.
    """
    mujoco = pytest.importorskip("mujoco")
    tendon = (
        f'stiffness="{stiffness}" springlength="0 {length}"'
        if rope == "elastic"
        else f'limited="true" range="0 {length}" solreflimit="{2.0 * dt} 1" '
        'solimplimit="0.9999 0.9999 0.001"'
    )
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="{dt}" gravity="0 0 -9.80665" integrator="RK4"/>
        <worldbody><site name="pivot"/><body pos="{start[0]} {start[1]} {start[2]}">
        <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
        <joint type="slide" axis="0 0 1"/><geom size="0.1" mass="1000"/><site name="load"/>
        </body></worldbody><tendon><spatial {tendon}>
        <site site="pivot"/><site site="load"/></spatial></tendon></mujoco>"""
    )
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, round(1.5 / dt))
    return start + data.qpos


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rope", "far"),
    [
        ("elastic", 2e-6),  # both by RK4; MuJoCo does not look for the event: (ω dt)² of the speed
        ("inextensible", 5e-3),  # MuJoCo's limit is soft over two steps of 0.1 ms and rebounds
    ],
)
def test_a_load_that_falls_beside_its_pivot_moves_as_on_a_tendon_of_mujoco(
    rope: str, far: float
) -> None:
    crane = slack_crane(rope)
    dt = 1e-4
    start = lifted(crane, 2.0, phi=0.5, theta=0.3)
    run = run_of(crane, start, 1.5, integrator=rk4, engine="compiled")
    pivot = np.array([0.0, -10.0, 28.0])
    length = 15.0
    begin, end = (payload_position(crane, q) - pivot for q in (run.q[0], run.q[-1]))
    theirs = _mujoco(rope, begin, length, ROPES["elastic"] / length, dt)
    assert np.abs(end - theirs).max() < far


def _exudyn(rope: float, length: float, start: float, speed: float, duration: float) -> Any:
    """Return tension and depth below its pivot of a point load on a reeving system of springs that
    pulls only, in 0.1 ms, from a depth [m] and a speed downward [m/s]; rope is EA [N].
    """
    exu = pytest.importorskip("exudyn", reason="extra peers (exudyn) is not installed")
    items = importlib.import_module("exudyn.itemInterface")
    dt = 1e-4
    container = exu.SystemContainer()
    system = container.AddSystem()
    down = np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
    node = system.AddNode(
        items.NodeRigidBodyRxyz(
            referenceCoordinates=(length * down).tolist(),
            initialCoordinates=((start - length) * down).tolist(),
            initialVelocities=(speed * down).tolist(),
        )
    )
    load = items.ObjectRigidBody(nodeNumber=node, mass=1000.0, inertia=[1.0] * 3 + [0.0] * 3)
    bodies = system.AddObject(items.ObjectGround()), system.AddObject(load)
    ends = [system.AddMarker(items.MarkerBodyRigid(bodyNumber=body)) for body in bodies]
    weight = (1000.0 * 9.80665 * down[:3]).tolist()
    system.AddLoad(items.LoadForceVector(markerNumber=ends[1], loadVector=weight))
    springs = items.ObjectConnectorReevingSystemSprings(
        markerNumbers=ends,
        sheavesAxes=exu.Vector3DList([[1.0, 0.0, 0.0]] * 2),
        sheavesRadii=[0.0, 0.0],
        referenceLength=length,
        stiffnessPerLength=rope,
        regularizationForce=1e-4,
    )
    of = {"objectNumber": system.AddObject(springs), "storeInternal": True}
    kinds = exu.OutputVariableType
    pull = system.AddSensor(items.SensorObject(**of, outputVariableType=kinds.ForceLocal))
    way = system.AddSensor(items.SensorObject(**of, outputVariableType=kinds.Distance))
    system.Assemble()
    settings = exu.SimulationSettings()
    settings.timeIntegration.numberOfSteps = round(duration / dt)
    settings.timeIntegration.endTime = duration
    settings.solutionSettings.sensorsWritePeriod = dt
    settings.solutionSettings.writeSolutionToFile = False
    system.SolveDynamic(settings, solverType=exu.DynamicSolverType.RK44)
    return system.GetSensorStoredData(pull)[:, 1], system.GetSensorStoredData(way)[:, 1]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("taken_up", [False, True])
def test_a_load_that_falls_or_is_taken_up_pulls_and_bounces_as_on_a_rope_of_exudyn(
    taken_up: bool,
) -> None:
    crane = slack_crane("elastic")
    length = 15.0
    ea = ROPES["elastic"]
    weight = 1000.0 * crane.gravity
    stiffness = ea / length
    factor = theory.fall_factor(0.5, stiffness, weight)
    stretch = -0.5
    speed = 0.0
    if taken_up:
        stretch = weight / stiffness
        speed = 2.0
        factor = theory.pickup_factor(speed, math.sqrt(stiffness / 1000.0), crane.gravity)
    pull, depth = _exudyn(ea, length, length + stretch, speed, 1.5)
    start = crane.state(rope_stretch=stretch, rope_stretch_dot=speed)
    run = run_of(crane, start, 1.5, dt=1e-4, integrator=rk4, engine="compiled")
    assert pull.max() / weight == pytest.approx(factor, rel=2e-6)  # between rows, (ω dt)²/8
    assert -1e-3 < pull.min() <= 0.0 and 1.0 in run["phase"]  # theirs is regularised by 1e-4 N
    # Exudyn's steps do not end at an event: (ω dt)² of the speed
    assert_allclose(depth[-1], length + run["rope_stretch_m"][-1], atol=2e-6)


def test_a_taut_rope_that_does_not_stretch_holds_its_load_also_where_one_state_is_asked_for() -> (
    None
):
    c = slack_crane()
    rest = c.start
    held = holding_effort(c, rest.q)
    assert_allclose(acceleration(c, rest, held), 0.0, atol=1e-12)
    a, needed = prescribed_acceleration(c, rest, np.zeros(3))
    assert_allclose(a, 0.0, atol=1e-12)
    assert_allclose(needed, held)
    slack = lifted(c, 0.5)
    stretch = c.layout.index("rope_stretch")
    assert acceleration(c, slack, 0.0 * held)[stretch] == pytest.approx(c.gravity)
    assert prescribed_acceleration(c, slack, np.zeros(3))[0][stretch] == pytest.approx(c.gravity)


@pytest.mark.parametrize("start", [{}, {"phi": 0.3, "phi_dot": 0.2}])
def test_the_tension_of_a_rope_that_does_not_stretch_is_that_of_a_rigid_one(
    start: dict[str, float],
) -> None:
    rigid = load_crane(**POINT, hoist_velocity=20.0)
    c = slack_crane()
    wind = np.zeros((len(c.points), 3))
    wind[0, 1] = 900.0
    state = c.state(**start)
    # At rest of the hoist the force of its drive is the tension, whatever the mass of the drum.
    _, needed = prescribed_acceleration(c, state, np.zeros(3))
    _, expected = prescribed_acceleration(rigid, rigid.state(**start), np.zeros(3))
    assert constraint_tension(c, state, needed) == pytest.approx(-expected[2])
    gusty = constraint_tension(c, state, needed, wind)
    assert (abs(gusty + expected[2]) > 100.0) == bool(start)
    assert constraint_tension(c, lifted(c, 0.5), needed) == 0.0
    assert rope_tension(c.layout, JointForces.of(c), state.q, state.v, needed[2]) is None
