"""Predictive control in compiled code: to a setpoint from any state, along a motion, in batches."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from llvmlite import ir
from scipy.integrate import solve_ivp

from cranedyn.analysis.swing import swing_amplitude
from cranedyn.compiled.batch import simulate_batch
from cranedyn.compiled.horizon import control_instant, horizon_model
from cranedyn.compiled.horizon.memory import REPORT
from cranedyn.compiled.horizon.receding import Receding, receding, usual_input_weight
from cranedyn.compiled.machine import translate
from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.converters import converters
from cranedyn.dynamics.equations_of_motion import payload_position, prescribed_acceleration
from cranedyn.dynamics.validity import hoist_force
from cranedyn.errors import CraneError
from cranedyn.estimation import with_sensor_model
from cranedyn.interfaces import Controller, Drive, Setpoint, State
from cranedyn.lifts.planning.optimal import optimal
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.model.rigid_rope import on_rigid_rope
from cranedyn.references import flat, hold
from cranedyn.references.limits import Limits
from cranedyn.references.motion import Motion
from tests.helpers import ROOT, crane, long_after, quickly

pytestmark = pytest.mark.slow

LIMITS = Limits(rates=(0.0838, 1.583, 1.0), accelerations=(0.02, 0.4, 0.4))
MOVES = {
    "trolley": ((0.0, 10.0, 15.0), (0.0, 20.0, 15.0)),
    "slew": ((0.0, 15.0, 15.0), (0.6, 15.0, 15.0)),
    "combined": ((0.0, 10.0, 15.0), (0.6, 20.0, 10.0)),
}


def at(place: Sequence[float], **more: float) -> State:
    gamma, x, length = place
    return crane().state(gamma=gamma, x=x, l=length, **more)


@cache
def overhead() -> Crane:
    return load_crane(ROOT / "urdf" / "overhead_crane.urdf.xacro")


def to(
    goal: State,
    start: State,
    made: Controller,
    duration: float = 25.0,
    moved: Crane | None = None,
    **how: Any,
) -> Trajectory:
    """A run of a crane, the tower crane if no other is named, to a goal."""
    moved = crane() if moved is None else moved
    how = {"engine": "compiled", "validity": "mark", **how}
    return quickly(moved, made, hold(moved, goal), start=start, duration=duration, **how)


def settled(run: Trajectory, goal: State, moved: Crane, within: float = 0.01) -> float:
    """Time from which the payload stays so near its goal [s]."""
    place = payload_position(moved, goal.q)
    off = np.array([np.linalg.norm(payload_position(moved, q) - place) for q in run.q])
    far = np.flatnonzero(off > within)
    assert off[-1] <= within
    return float(run.t[far[-1]]) if len(far) else 0.0


# --------------------------------------------------------------------------------------------------
# ---------------- what is predicted


class Linearised(NamedTuple):
    """What compiled code makes of a stage: two affine functions of its node, which holds the
    coordinates, rates and accelerations of the drives at its begin.

    Attributes:
        slope: Slopes of the state at the end of the stage, shape (states, node).
        shift: That state at a node of zeros, shape (states,).
        effort_slope: Slopes of the efforts at the begin of the stage, shape (drives, node).
        effort_shift: Those efforts at a node of zeros, shape (drives,).
    """

    slope: np.ndarray
    shift: np.ndarray
    effort_slope: np.ndarray
    effort_shift: np.ndarray


def linearised(made: Receding, length: float, nodes: np.ndarray) -> list[Linearised]:
    """Return what compiled code makes of stages of a length [s] that begin at nodes."""
    shape = made.programme.shape(1)
    module = ir.Module()
    known = horizon_model.emit(module, shape, made.programme.plant, length)
    work = np.zeros(shape.size)
    stages = work[shape.first_stage :].reshape(shape.stages, shape.stage_size)
    for name, i, lane, value in known:
        stages[:, shape.offset(name, i) + lane] = value
    count, width = nodes.shape
    stages[:count, shape.offset("node") :][:, :width] = nodes
    machine = translate(module)
    machine.function("linearise", 1)(work.ctypes.data)

    def matrix(stage: np.ndarray, name: str) -> np.ndarray:
        rows = shape.stage_rows[name]
        values = stage[shape.offset(name) :][: rows * shape.row_length]
        return values.reshape(rows, shape.row_length)

    # In that row the efforts come after the states and inputs.
    efforts = slice(shape.variables, shape.variables + shape.inputs)
    return [
        Linearised(
            matrix(stage, "forward")[:, : shape.variables],
            matrix(stage, "shift")[0, : shape.states],
            matrix(stage, "extra")[:, : shape.variables],
            matrix(stage, "extra_shift")[0, efforts],
        )
        for stage in stages[:count]
    ]


def slopes(function: Callable[[np.ndarray], np.ndarray], node: np.ndarray) -> np.ndarray:
    """Return the slopes of a function by central differences of 1e-5, one column a variable."""
    columns = []
    for step in 1e-5 * np.eye(len(node)):
        columns.append((function(node + step) - function(node - step)) / 2e-5)
    return np.column_stack(columns)


@pytest.mark.parametrize("which", long_after(1, ["tower", "overhead"]))
def test_a_stage_goes_where_the_crane_goes_and_its_slopes_are_those_of_the_crane(
    which: str,
) -> None:
    moved = crane() if which == "tower" else overhead()
    made = receding(moved, _limits(moved), drive="motion")
    n = moved.layout.n
    length = 0.05

    def flow(node: np.ndarray) -> np.ndarray:
        """Return the state at the end of the stage, integrated to 1e-11."""
        command = node[2 * n :]

        def rates(_: float, y: np.ndarray) -> np.ndarray:
            a = prescribed_acceleration(moved, State(y[:n], y[n:]), command)[0]
            return np.concatenate([y[n:], a])

        start = node[: 2 * n]
        return solve_ivp(rates, (0.0, length), start, rtol=1e-11, atol=1e-13).y[:, -1]

    def effort(node: np.ndarray) -> np.ndarray:
        state = State(node[:n], node[n : 2 * n])
        return prescribed_acceleration(moved, state, node[2 * n :])[1]

    rng = np.random.default_rng(1)
    middle = np.concatenate([moved.start.q, np.zeros(n + moved.layout.m)])
    nodes = middle + 0.03 * rng.normal(size=(8, len(middle)))
    found = linearised(made, length, nodes)
    for k in (0, 5):
        node = nodes[k]
        stage = found[k]
        # The next power of a stage's length times how its slopes change along it.
        ahead = stage.slope @ node + stage.shift
        np.testing.assert_allclose(ahead, flow(node), atol=2e-3 * length**2)
        np.testing.assert_allclose(stage.slope, slopes(flow, node), atol=0.1 * length**2)
        scale = np.abs(effort(node)).max()
        needed = stage.effort_slope @ node + stage.effort_shift
        np.testing.assert_allclose(needed, effort(node), atol=1e-12 * scale)
        # Rounding of a difference of efforts.
        rounding = 1e-9 * scale / 1e-5
        np.testing.assert_allclose(stage.effort_slope, slopes(effort, node), atol=rounding)


def _limits(moved: Crane) -> Limits:
    kinds = [joint.kind == "revolute" for joint in moved.layout.driven]
    return Limits(
        rates=tuple(0.0838 if turns else 1.0 for turns in kinds),
        accelerations=tuple(0.02 if turns else 0.4 for turns in kinds),
    )


# --------------------------------------------------------------------------------------------------
# ---------------- to a setpoint


@pytest.mark.parametrize(
    ("name", "drive"),
    [
        # A combined move is one of the trolley and one of the slew, too.
        pytest.param("trolley", "effort", marks=pytest.mark.long),
        pytest.param("slew", "effort", marks=pytest.mark.long),
        ("combined", "effort"),
        # In the default run a crane of a laboratory settles under accelerations.
        pytest.param("combined", "motion", marks=pytest.mark.long),
    ],
)
def test_it_settles_within_one_and_a_half_times_the_least_time_and_keeps_all_limits(
    name: str, drive: Drive
) -> None:
    start, goal = map(at, MOVES[name])
    made = receding(crane(), LIMITS, drive=drive)
    run = to(goal, start, made, drive=drive)
    assert run.valid.all()
    assert settled(run, goal, crane()) < 1.5 * least(name)
    drives = crane().layout.drives
    # Of a crane that takes efforts the acceleration follows within what a held effort misses.
    tolerance = 2e-3 if drive == "effort" else 1e-5
    assert (np.abs(run.v[:, drives]) <= np.array(LIMITS.rates) * (1.0 + tolerance)).all()
    faster = np.diff(run.v[:, drives], axis=0) / 5e-3
    assert (np.abs(faster) <= np.array(LIMITS.accelerations) * (1.0 + tolerance)).all()
    # The swing is kept at the stages' ends; between them it bulges by its curvature.
    curvature = np.abs(np.diff(run.v[:, crane().swings], axis=0)).max() / 5e-3
    bulge = made.programme.stage_length**2 * curvature / 8.0
    assert np.abs(run.q[:, crane().swings]).max() < 0.1 + bulge < 0.103


@cache
def least(name: str) -> float:
    start, goal = map(at, MOVES[name])
    return optimal(crane(), start, goal, LIMITS, swing=0.1).arrival


STARTS = {
    "a load that swings": at((0.0, 10.0, 15.0), phi=0.15, theta=0.1),
    "drives that move already": at(
        (0.0, 10.0, 15.0), gamma_dot=-0.05, x_dot=-1.2, l_dot=0.8, phi=0.05
    ),
    "the goal itself": at((0.6, 20.0, 10.0)),
    "beyond the limit of the rate": at((0.0, 8.0, 12.0), x_dot=2.0),
}


@pytest.mark.parametrize("which", list(STARTS))
def test_from_any_state_the_load_comes_to_rest_at_the_goal(which: str) -> None:
    goal = at((0.6, 20.0, 10.0))
    made = receding(crane(), LIMITS)
    run = to(goal, STARTS[which], made, duration=30.0)
    assert settled(run, goal, crane()) < 24.0
    assert made.status.failures == 0
    assert np.abs(run.q[-1, crane().swings]).max() < 1e-3


def test_its_code_is_emitted_once_and_compiled_for_this_process_only_when_it_is_called(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A page, a batch and a compiled loop have code of their own; what nobody calls is not
    compiled.
    """
    module = sys.modules[Receding.__module__]
    done = []

    def emit_plan(*arguments: Any) -> Any:
        done.append("emitted")
        return control_instant.emit_plan(*arguments)

    def translate_it(*_: Any) -> Any:
        done.append("compiled")
        raise ZeroDivisionError("stands for a compilation")

    monkeypatch.setattr(module, "emit_plan", emit_plan)
    monkeypatch.setattr(module, "translate", translate_it)
    # No other test has a controller of this time constant, whose code would be remembered.
    made = receding(crane(), LIMITS, settling=1.2345)
    for same in (made, deepcopy(made), receding(crane(), LIMITS, settling=1.2345)):
        same.memory(1)
    assert "instant" in module.emit_programme(made.programme).module.globals  # type: ignore[attr-defined]
    assert done == ["emitted"]
    with pytest.raises(ZeroDivisionError):
        made(0.0, crane().start, hold(crane())(0.0))
    assert done == ["emitted", "compiled"]


def test_a_copy_of_the_controller_plans_in_memory_of_its_own() -> None:
    goal = at((0.6, 20.0, 10.0))
    setpoint = hold(crane(), goal)(0.0)
    start = at((0.0, 10.0, 15.0), phi=0.05)
    elsewhere = at((0.3, 12.0, 12.0), x_dot=0.5)
    made, alone = (receding(crane(), LIMITS) for _ in range(2))
    made(0.0, start, setpoint), alone(0.0, start, setpoint)
    copied = deepcopy(made)
    copied(0.05, elsewhere, setpoint)
    assert np.array_equal(made(0.05, start, setpoint), alone(0.05, start, setpoint))
    assert np.array_equal(made.memory_of_optimisation(), alone.memory_of_optimisation())
    assert not np.array_equal(copied.memory_of_optimisation(), alone.memory_of_optimisation())
    with pytest.raises(CraneError, match="Code that is bound to memory cannot be copied"):
        deepcopy(made._instant)


def test_on_the_numbers_of_grampcs_tower_crane_it_settles_as_fast_as_that() -> None:
    # GRAMPC's example Crane_3D, run to its end, keeps trolley, cable, slew and swing together
    # within 10 mm of where they shall be from 2.99 s on, within 5 mm from 3.73 s on. No number of
    # the controller is set: its times and errors follow from the crane.
    numbers: dict[str, Any] = {"trolley_min": 0.1, "trolley_max": 1.0, "trolley_init": 0.7}
    numbers |= {"hoist_min": 0.1, "hoist_max": 1.0, "hoist_init": 0.7}
    numbers |= {"payload_mass": 1.0, "trolley_mass": 1.0, "upper_mass": 1.0, "dummy_mass": 1e-3}
    numbers |= {"payload_inertia": 0.0, "trolley_inertia": 1e-3, "slewing_inertia": 1.0}
    numbers |= {"dummy_inertia": 1e-6, "damp_swing": 0.0, "slew_velocity": 3.0}
    lab = load_crane(**numbers)
    start = lab.state(gamma=-1.0472)
    goal = lab.state(gamma=1.0472, x=0.2, l=0.25)
    limits = Limits(rates=(3.0, 3.0, 3.0), accelerations=(2.0, 2.0, 2.0))
    run = to(goal, start, receding(lab, limits, drive="motion"), 5.0, lab, drive="motion")
    gamma, x, phi, theta, length = run.q.T
    away = np.hypot(np.hypot(x - 0.2, length - 0.25), (gamma - 1.0472) * x)
    off = away + length * np.hypot(phi, theta)
    for within, published in ((0.010, 2.99), (0.005, 3.73)):
        assert run.t[np.flatnonzero(off > within)[-1]] < published


@pytest.mark.parametrize("drive", ["effort", pytest.param("motion", marks=pytest.mark.long)])
def test_it_never_commands_a_slack_rope_however_fast_the_hoist_may_be(drive: Drive) -> None:
    fast = Limits(rates=(0.5, 5.0, 8.0), accelerations=(0.5, 5.0, 40.0))
    rng = np.random.default_rng(3)
    for _ in range(4):
        start = at(
            (0.0, rng.uniform(4, 20), rng.uniform(6, 20)),
            phi=rng.uniform(-0.3, 0.3),
            theta=rng.uniform(-0.3, 0.3),
            l_dot=rng.uniform(-2.0, 2.0),
        )
        goal = at((rng.uniform(-1, 1), rng.uniform(4, 20), rng.uniform(6, 20)))
        made = receding(crane(), fast, drive=drive, swing_limit=0.5, stage=0.1)
        run = to(goal, start, made, duration=2.0, drive=drive)
        tension = -hoist_force(crane(), run.effort)
        # A tenth of the weight, which the effort of a held acceleration meets at control instants.
        assert tension.min() >= made.programme.min_tension * (1.0 - 1e-9)


@pytest.mark.parametrize("load", [pytest.param(500.0, marks=pytest.mark.long), 1500.0])
def test_a_load_of_another_mass_ends_where_it_shall_since_what_disturbs_is_estimated(
    load: float,
) -> None:
    goal = at((0.3, 15.0, 12.0))
    made = receding(crane(), LIMITS)
    other = crane(payload_mass=load)
    run = to(goal, at((0.0, 10.0, 15.0)), made, moved=other)
    np.testing.assert_allclose(run.q[-1], goal.q, atol=2e-4)


def _swing_left(run: Trajectory, length: float) -> np.ndarray:
    """Amplitudes of the swing after half a minute [rad]."""
    rows = run.t > 30.0
    swings = crane().swings
    return swing_amplitude(run.q[rows][:, swings], run.v[rows][:, swings], length, crane().gravity)


@pytest.mark.parametrize(("smoothing", "least", "most"), [(0.2, 0.0, 2.5e-3), (5e-3, 5e-3, 1.0)])
def test_noise_of_the_swings_sensors_is_averaged(
    smoothing: float, least: float, most: float
) -> None:
    goal = at((0.3, 15.0, 12.0))
    made = receding(crane(), LIMITS, smoothing=smoothing)
    noisy = with_sensor_model(crane(), made, rng=np.random.default_rng(1))
    run = to(goal, at((0.0, 10.0, 15.0)), noisy, duration=40.0)
    assert least < np.quantile(_swing_left(run, 12.0), 0.9) < most


@pytest.mark.long
def test_what_it_believes_of_the_swing_is_what_swings_where_sensors_are_exact() -> None:
    start = at((0.0, 10.0, 15.0), phi=0.05, theta=-0.03)
    goal = at((0.3, 15.0, 12.0))
    runs = [
        to(goal, start, receding(crane(), LIMITS, smoothing=smoothing), duration=20.0)
        for smoothing in (5e-3, 0.2)
    ]
    assert np.abs(runs[0].q[:, crane().swings] - runs[1].q[:, crane().swings]).max() < 1e-3


def test_an_overhead_crane_is_brought_to_its_goal_by_the_same_controller() -> None:
    moved = overhead()
    start = moved.start
    goal = State(start.q.copy(), np.zeros(moved.layout.n))
    goal.q[moved.layout.drives] += np.array([3.0, 2.0, -1.0])[: moved.layout.m]
    run = to(goal, start, receding(moved, _limits(moved)), moved=moved)
    assert run.valid.all()
    assert settled(run, goal, moved) < 20.0


# --------------------------------------------------------------------------------------------------
# ---------------- along a motion


def test_along_a_motion_nothing_is_left_at_its_end() -> None:
    start, goal = map(at, MOVES["combined"])
    motion = flat(crane(), start, goal, 20.0)
    made = receding(crane(), LIMITS, motion=motion, swing_limit=0.2)
    run = quickly(
        crane(), made, motion, start=start, duration=25.0, engine="compiled", validity="mark"
    )
    assert np.abs(run.q[4000:, crane().swings]).max() < 5e-5
    assert made.status.failures == 0


def test_on_its_motion_it_plans_the_accelerations_of_the_motion_whatever_they_cost() -> None:
    motion = flat(crane(), at((0.0, 10.0, 15.0)), at((0.3, 14.0, 12.0)), 12.0)
    # Accelerations cost their difference from those of the motion, which is none here.
    weight = 100.0 * usual_input_weight(np.array(LIMITS.accelerations))
    made = receding(
        crane(), LIMITS, motion=motion, drive="motion", swing_limit=0.3, input_weight=weight
    )
    made.begin_run(0.0, 5e-3)
    drives = crane().layout.drives
    stage = round(made.programme.stage_length / 5e-3)
    largest = np.abs(motion.a[:, drives]).max(axis=0)
    worst = 0.0
    for k in range(1600):
        setpoint = Setpoint(motion.q[k, drives], motion.v[k, drives], motion.a[k, drives])
        planned = made(5e-3 * k, State(motion.q[k], motion.v[k]), setpoint)
        # The first plan begins with a crane at rest, and one iteration does not undo that.
        if k and k % made.programme.ratio == 0:
            mean = (motion.v[k + stage] - motion.v[k])[drives] / made.programme.stage_length
            worst = max(worst, float((np.abs(planned - mean) / largest).max()))
    # Plans hold accelerations over a stage; those of the motion change by some percent in it.
    assert worst < 0.02


# --------------------------------------------------------------------------------------------------
# ---------------- ropes that stretch or go slack, and two falls

SOFT_ROPE = {"rope_stiffness": 1e6, "rope_damping": 500.0}
"""A rope whose load bounces with about 1.3 Hz at 15 m, and is 0.15 m lower than the drum has paid
out."""


@pytest.mark.long
def test_a_crane_on_a_soft_rope_is_commanded_as_if_its_rope_were_rigid() -> None:
    soft = load_crane(**SOFT_ROPE)
    rigid = on_rigid_rope(soft)
    kept = list(rigid.kept)
    q = soft.start.q + 0.05 * np.random.default_rng(5).normal(size=soft.layout.n)
    v = 0.05 * np.random.default_rng(6).normal(size=soft.layout.n)
    setpoint = Setpoint(np.array([0.3, 15.0, 12.0]), np.zeros(3), np.zeros(3))
    made = receding(soft, LIMITS)
    assert made.notes()["planned_without"] == ["rope_stretch_joint"]
    command = made(0.0, State(q, v), setpoint)
    expected = receding(rigid.crane, LIMITS)(0.0, State(q[kept], v[kept]), setpoint)
    assert command.tolist() == expected.tolist()


@pytest.mark.long
def test_a_crane_on_a_soft_rope_moves_in_compiled_loops_and_batches_as_in_python() -> None:
    soft = load_crane(**SOFT_ROPE)
    goal = soft.state(gamma=0.2, x=15.0, l=12.0)
    asked = receding(soft, LIMITS)
    in_python = to(goal, soft.start, lambda t, s, setpoint: asked(t, s, setpoint), 3.0, soft)
    compiled = to(goal, soft.start, receding(soft, LIMITS), 3.0, soft)
    np.testing.assert_array_equal(in_python.q, compiled.q)
    starts = [soft.start] * 9
    reference = hold(soft, goal)
    batch = simulate_batch(soft, receding(soft, LIMITS), reference, start=starts, duration=3.0)
    for q in batch.end.q:
        # Sums of eight cranes in lanes may be fused otherwise than of one.
        np.testing.assert_allclose(q, compiled.q[-1], rtol=0.0, atol=1e-9)


@pytest.mark.long
def test_along_a_motion_of_the_soft_rope_the_other_joints_are_tracked() -> None:
    soft = load_crane(**SOFT_ROPE)
    kept = list(on_rigid_rope(soft).kept)
    q = np.tile(soft.start.q, (3, 1))
    q[:, 1] += [0.0, 0.001, 0.002]
    motion = Motion(5e-3, q, 0.1 * q, np.zeros_like(q), soft.layout.drives)
    path = receding(soft, LIMITS, motion=motion).path
    assert path.tolist() == np.hstack([q[:, kept], 0.1 * q[:, kept]]).tolist()


def test_a_structure_that_bends_is_refused_with_the_joints_to_hold() -> None:
    bending = load_crane(jib_bend_stiffness=1e8, tower_twist_stiffness=1e8)
    with pytest.raises(CraneError, match=r"springs in .* and .*Hold these joints by locked="):
        receding(bending, LIMITS)


# --------------------------------------------------------------------------------------------------
# ---------------- in code, and in batches


@pytest.mark.parametrize(
    ("drive", "moving"),
    [
        ("effort", False),
        ("motion", True),
        # In the default run a batch at rates does what each crane does alone.
        pytest.param("velocity", True, marks=pytest.mark.long),
    ],
)
def test_the_compiled_loop_does_what_python_does_to_the_bit(drive: Drive, moving: bool) -> None:
    start, goal = map(at, MOVES["combined"])
    motion = flat(crane(), start, goal, 20.0) if moving else None

    asked, inside = (receding(crane(), LIMITS, motion=motion, drive=drive) for _ in range(2))
    runs = [
        to(goal, start, controller, duration=11.0, drive=drive)  # more than one block
        for controller in (lambda t, state, setpoint: asked(t, state, setpoint), inside)
    ]
    np.testing.assert_array_equal(runs[0].q, runs[1].q)
    assert asked.status == inside.status


def test_rates_for_converters_are_those_that_accelerate_the_drives_as_planned() -> None:
    start = at((0.1, 12.0, 14.0), gamma_dot=0.02, x_dot=0.3)
    goal = at((0.3, 15.0, 12.0))
    soft = converters(crane(), lags={"x": 0.25}, delay=0.012)
    aim = hold(crane(), goal)(0.0)
    accelerations = receding(crane(), LIMITS, drive="motion")(0.0, start, aim)
    rates = receding(crane(), LIMITS, drive="velocity", converters=soft)(0.0, start, aim)
    # 0.012 s are heard three periods late, and a command holds for one
    lead = np.array([0.2, 0.25, 0.1]) + 0.0175
    expected = start.v[crane().layout.drives] + lead * accelerations
    np.testing.assert_allclose(rates, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.long
def test_drives_twice_as_late_as_believed_leave_no_swing() -> None:
    typical = converters(crane())
    goal = at((0.3, 15.0, 12.0))
    weight = 1e3 * usual_input_weight(np.array(LIMITS.accelerations))
    made = receding(crane(), LIMITS, drive="velocity", input_weight=weight)
    slow = replace(typical, lags=2.0 * typical.lags)
    run = to(goal, at((0.0, 10.0, 15.0)), made, duration=40.0, drive=slow)
    assert _swing_left(run, 12.0).max() < 2e-3


# In the default run a batch from hard starts takes efforts.
@pytest.mark.parametrize("drive", long_after(1, ["velocity", "effort"]))
def test_a_batch_does_what_each_crane_does_alone(drive: Drive) -> None:
    rng = np.random.default_rng(7)
    starts = [at((0.0, rng.uniform(6, 20), rng.uniform(8, 20)), phi=0.02) for _ in range(11)]
    goals = [at((rng.uniform(-0.5, 0.5), rng.uniform(6, 20), 12.0)) for _ in range(11)]
    references = [hold(crane(), goal) for goal in goals]
    made = receding(crane(), LIMITS, drive=drive)
    batch = simulate_batch(crane(), made, references, start=starts, duration=4.0, drive=drive)
    assert (batch.failures == 0).all()
    for i in (0, 7, 10):

        def end(start: State, goal: State = goals[i]) -> np.ndarray:
            controller = receding(crane(), LIMITS, drive=drive)
            return to(goal, start, controller, duration=4.0, drive=drive).q[-1]

        alone = end(starts[i])
        # Sums of eight cranes in lanes may be fused otherwise than of one; where a plan is
        # sensitive to a rounding, as that of the first, so is its end.
        near = starts[i]._replace(q=starts[i].q * (1.0 + np.finfo(float).eps))
        allowed = 1e-12 + 10.0 * np.abs(end(near) - alone).max()
        assert allowed < 1e-7
        np.testing.assert_allclose(batch.end.q[i], alone, rtol=0.0, atol=allowed)


def hard(count: int, seed: int) -> list[State]:
    """Return starts near all limits at once, from which optimisations fail now and then."""
    rng = np.random.default_rng(seed)
    low = (-3.0, 2.1, -0.6, -0.6, 3.5, -0.08, -1.5, -0.5, -0.5, -1.0)
    high = (3.0, 21.9, 0.6, 0.6, 26.0, 0.08, 1.5, 0.5, 0.5, 1.0)
    draws = rng.uniform(low, high, (count, 10))
    return [State(draw[:5], draw[5:]) for draw in draws]


def test_from_hard_starts_each_crane_of_a_batch_goes_where_it_goes_alone_in_any_lane() -> None:
    starts = hard(104, seed=5)
    goal = hold(crane(), at((0.5, 14.0, 12.0)))
    order = np.random.default_rng(6).permutation(len(starts))

    def run(which: Sequence[int] | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        chosen = [starts[i] for i in which]
        made = receding(crane(), LIMITS)
        batch = simulate_batch(crane(), made, goal, start=chosen, duration=2.0)
        return np.hstack(batch.end), batch.failures

    ends, failures = run(range(len(starts)))
    assert ((failures > 0) & (failures < 10)).sum() > 8  # some fail, and recover by themselves
    permuted, permuted_failures = run(order)
    np.testing.assert_array_equal(permuted, ends[order])
    np.testing.assert_array_equal(permuted_failures, failures[order])
    for i in np.argsort(-failures, kind="stable")[:8].tolist():
        alone, alone_failures = run([i])
        np.testing.assert_array_equal(alone[0], ends[i])
        assert alone_failures[0] == failures[i]


def test_a_crane_that_diverges_leaves_others_of_its_batch_alone() -> None:
    good = at((0.0, 10.0, 15.0), phi=0.05)
    made = receding(crane(), LIMITS)
    goal = at((0.3, 15, 12))
    bad = State(good.q, np.array([0.0, 0.0, 1e200, 0.0, 0.0]))
    runs = [
        simulate_batch(crane(), made, hold(crane(), goal), start=starts, duration=2.0, threads=2)
        for starts in ([good], [good, bad, good], [bad, *[good] * 4])
    ]
    alone, *others = (np.hstack(run.end) for run in runs)
    assert not np.isfinite(others[0][1]).all() and runs[1].refusals[1] > 0
    np.testing.assert_array_equal(others[0][[0, 2]], alone[[0, 0]])
    np.testing.assert_array_equal(others[1][1:], alone[[0] * 4])


def test_a_second_run_does_not_go_on_with_the_plan_of_the_first() -> None:
    made = receding(crane(), LIMITS)
    goal = at((0.3, 15.0, 12.0))
    first, second = (to(goal, at((0.0, 10.0, 15.0)), made, duration=3.0) for _ in range(2))
    np.testing.assert_array_equal(first.q, second.q)


# --------------------------------------------------------------------------------------------------
# ---------------- what fails, and what is refused


def failing() -> Receding:
    """A controller with a solver that begins so near its bounds that it does not get away."""
    made = receding(crane(), LIMITS)
    made.table[made.programme.shape(1).offset("report") + REPORT.index("usual_barrier")] = 1e-7
    return Receding(made.programme, made.table, made.path)


def test_an_optimisation_that_fails_leaves_the_last_plan_and_a_note_in_the_record() -> None:
    start, goal = map(at, MOVES["combined"])
    made = failing()
    run = to(goal, start, made, duration=5.0)
    failed = run.record["notes"]["failed_optimisations"]
    assert failed == made.status.failures > 0
    assert np.isfinite(run.q).all()
    assert run.valid.all()
    references = [hold(crane(), goal)] * 2
    batch = simulate_batch(crane(), failing(), references, start=start, duration=2.0)
    assert (batch.failures > 0).all()


GLITCHES = (0.1, 1.0, 30.0, 1257.0, 1e8)
"""Once added to a reading; an encoder that wraps in a control period of 5 ms reads 1257 rad/s."""


@pytest.mark.parametrize("drive", ["effort", pytest.param("velocity", marks=pytest.mark.long)])
def test_one_wrong_reading_of_any_size_leaves_nothing(drive: Drive) -> None:
    goal = at((0.3, 15.0, 12.0))
    start = at((0.0, 10.0, 15.0))
    offset = np.zeros((1 + 10 * len(GLITCHES), 402, 10))
    for lane, (i, size) in enumerate(np.ndindex(10, len(GLITCHES)), 1):
        offset[lane, 400, i] = GLITCHES[size]  # at an instant of an optimisation
    made = receding(crane(), LIMITS, drive=drive)
    starts = [start] * len(offset)
    how: Any = {"start": starts, "duration": 25.0, "drive": drive, "sensor_offset": offset}
    batch = simulate_batch(crane(), made, hold(crane(), goal), **how)
    # A hundredth of what is called settled, 10 mm, and as many radians.
    assert np.abs(batch.end.q - batch.end.q[0]).max() < 1e-4
    assert (batch.peak_swing < 0.11).all()
    refused = batch.refusals[1:].reshape(10, -1)
    assert (refused[:, 3:] == 1).all() and (refused[:, 0] == 0).all()
    assert (batch.failures >= batch.refusals).all()


def test_a_reading_that_cannot_be_is_refused_and_said() -> None:
    goal = at((0.3, 15.0, 12.0))
    count = 0

    def wrapped(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        nonlocal count
        count += 1
        v = state.v.copy()
        v[0] += 1257.0 * (count == 201)
        return made(t, State(state.q, v), setpoint)

    made = receding(crane(), LIMITS)
    run = to(goal, at((0.0, 10.0, 15.0)), made, duration=1.0)
    assert run.record["notes"] == {"failed_optimisations": 0}
    run = quickly(crane(), wrapped, hold(crane(), goal), start=at((0.0, 10.0, 15.0)), duration=2.0)
    assert np.isfinite(run.effort).all()
    notes = made.notes()
    assert notes["failed_optimisations"] == notes["refused_readings"] == 1
    assert notes["last_refused"] == pytest.approx({"gamma_dot_rad_s": 1257.0}, rel=1e-3)


@pytest.mark.parametrize(
    ("x", "x_dot", "refused"),
    # Within a range of 20 m beyond the trolley's 2 to 22 m, and ten times its largest rate.
    [
        *[(1.0, 0.0, 0), (-17.0, 0.0, 0), (41.0, 0.0, 0), (-19.0, 0.0, 1), (43.0, 0.0, 1)],
        *[(12.0, 2.0, 0), (12.0, -15.0, 0), (12.0, 17.0, 1), (12.0, -17.0, 1)],
    ],
)
def test_a_reading_is_refused_a_range_beyond_the_range_and_at_ten_times_the_rate(
    x: float, x_dot: float, refused: int
) -> None:
    made = receding(crane(), LIMITS)
    drives = crane().layout.drives
    made.begin_run(0.0, 5e-3)
    start = at((0.0, 12.0, 15.0))
    setpoint = Setpoint(start.q[drives], np.zeros(3), np.zeros(3))
    made(0.0, start, setpoint)
    q = start.q.copy()
    v = start.v.copy()
    q[1] = x
    v[1] = x_dot
    assert np.isfinite(made(5e-3, State(q, v), setpoint)).all()
    assert made.notes().get("refused_readings", 0) == refused


def test_after_each_failure_the_next_plan_begins_farther_from_its_bounds() -> None:
    made = failing()
    start = at(MOVES["combined"][0])
    goal = at(MOVES["combined"][1])
    made.begin_run(0.0, 5e-3)
    setpoint = Setpoint(goal.q[crane().layout.drives], np.zeros(3), np.zeros(3))
    for k in range(25):
        made(5e-3 * k, start, setpoint)
        # An optimisation in every tenth call; the first begins at 1e-6.
        assert made.status.failures == k // 10 + 1
        assert made.status.barrier == pytest.approx(1e-5)


def test_sensors_that_fail_at_the_first_instant_or_for_a_second_are_outlived() -> None:
    goal = at((0.3, 15.0, 12.0))
    start = at((0.0, 10.0, 15.0))
    offset = np.zeros((3, 602, 10))
    offset[1, 0, 5] = 1257.0
    offset[2, 400:600, 2] = 1e3
    how: Any = {"start": [start] * 3, "duration": 25.0, "sensor_offset": offset}
    batch = simulate_batch(crane(), receding(crane(), LIMITS), hold(crane(), goal), **how)
    np.testing.assert_array_equal(batch.refusals, [0, 1, 200])
    np.testing.assert_array_equal(batch.failures, [0, 1, 20])
    # As above.
    assert np.abs(batch.end.q - batch.end.q[0]).max() < 1e-4


def test_what_was_not_read_teaches_nothing_of_what_disturbs() -> None:
    """Neither the first instant, before which nothing was expected, nor an impossible reading."""
    start = at((0.0, 10.0, 15.0), x_dot=0.5, l_dot=0.2)
    impossible = State(start.q, start.v + 1257.0)
    aim = hold(crane(), at((0.3, 15.0, 12.0)))(0.0)
    commands = [
        [made(5e-3 * k, state, aim).tolist() for k, state in enumerate((start, impossible, start))]
        for made in (receding(crane(), LIMITS, settling=settling) for settling in (0.02, 2.0))
    ]
    assert commands[0][:2] == commands[1][:2]
    assert commands[0][2] != commands[1][2]  # as quickly as it is told to learn


def test_a_note_is_found_in_a_controller_behind_sensors() -> None:
    goal = at((0.3, 15.0, 12.0))
    behind = with_sensor_model(
        crane(), receding(crane(), LIMITS), delay=1, rng=np.random.default_rng(1)
    )
    run = quickly(crane(), behind, hold(crane(), goal), start=at((0.0, 10.0, 15.0)), duration=0.1)
    assert run.record["notes"] == {"failed_optimisations": 0}


def test_a_state_that_is_not_finite_is_refused() -> None:
    still = Setpoint(np.array([0.0, 10.0, 15.0]), np.zeros(3), np.zeros(3))
    with pytest.raises(CraneError, match="coordinate 4 of the state is nan"):
        receding(crane(), LIMITS)(
            0.0, State(np.array([0.0, 10.0, 0.0, math.nan, 15.0]), np.zeros(5)), still
        )


def test_a_run_with_another_control_period_or_other_drives_is_refused() -> None:
    start = at((0.0, 10.0, 15.0))
    made = receding(crane(), LIMITS)
    with pytest.raises(CraneError, match=r"control period of the run is 0\.01 s; allowed is"):
        to(at((0.3, 15.0, 12.0)), start, made, duration=1.0, control_period=0.01)
    with pytest.raises(CraneError, match="drive is motion; allowed is the controller's, eff"):
        simulate_batch(crane(), made, start=start, duration=1.0, drive="motion")


def test_a_batch_of_two_predictive_controllers_is_refused() -> None:
    pair = [receding(crane(), LIMITS), hold_controller(crane())]
    with pytest.raises(CraneError, match="one predictive controller for all cranes"):
        simulate_batch(crane(), pair, start=[at((0.0, 10.0, 15.0))] * 2, duration=1.0)
