"""A crane on a base that moves: against closed forms, other programs, principles of mechanics."""

from __future__ import annotations

import itertools
import math
import xml.etree.ElementTree as ET
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq
from scipy.special import mathieu_a, mathieu_b

from cranedyn.controllers import hold_controller
from cranedyn.controllers.hold import zero_command
from cranedyn.data.trajectory import Trajectory, read
from cranedyn.disturbances.base_motion import BaseCoordinates, BaseMotion
from cranedyn.disturbances.wind import constant_force, steady, wind
from cranedyn.dynamics.bodies import point_paths
from cranedyn.dynamics.contact import Ground
from cranedyn.dynamics.drives import EffortDrives, ExternalForces
from cranedyn.dynamics.equations_of_motion import point_positions
from cranedyn.dynamics.integrators import rk4, semi_implicit_euler
from cranedyn.dynamics.root_motion import RootMotion, floating_model
from cranedyn.errors import OutOfRange, RunError
from cranedyn.interfaces import EngineName, State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate
from cranedyn.simulation.stepper import Stepper
from experiments.scenarios.crane_variants import POINT
from tests.helpers import EXPLICIT_EULER, G, big_crane, crane, locked, quickly

SEA = BaseMotion.sines(
    surge=(0.5, 7.0),
    sway=(0.3, 6.0, 1.0),
    heave=(1.0, 8.0, 0.3),
    roll=(0.05, 9.0, 0.2),
    pitch=(0.04, 8.0, 2.0),
    yaw=(0.1, 11.0, 0.4),
)
"""A base that moves in all coordinates."""

ENGINES: tuple[EngineName, ...] = ("pinocchio", "compiled")

CRANES: dict[str, Callable[[], Crane]] = {
    "tower": crane,
    "tower that bends": lambda: crane(tower_bend_stiffness=1e9),
    "hook and load": lambda: crane(hook_mass=300.0),
    "luffing": lambda: load_crane("urdf/luffing_crane.urdf.xacro"),
    "overhead": lambda: load_crane("urdf/overhead_crane.urdf.xacro"),
}


def random_state(one: Crane, seed: int) -> State:
    rng = np.random.default_rng(seed)
    n = one.layout.n
    return State(one.start.q + 0.3 * rng.normal(size=n), rng.normal(size=n))


# --- the forces of the base at one instant --------------------------------------------------------


def hybrid_acceleration(
    mass: np.ndarray, bias: np.ndarray, root: np.ndarray, effort: np.ndarray
) -> np.ndarray:
    """Accelerations of the joints of a mechanism whose first six accelerations are given."""
    return np.linalg.solve(mass[6:, 6:], effort - bias[6:] - mass[6:, :6] @ root)


@pytest.mark.parametrize("name", CRANES)
def test_a_crane_accelerates_as_on_a_floating_body_whose_motion_is_given(name: str) -> None:
    # the same crane by Pinocchio as a free body with its true position, velocity and gravity in the
    # world, instead of what is felt in the base
    one = CRANES[name]()
    floating = floating_model(one.model)
    floating.gravity = one.model.gravity
    data = floating.createData()
    for seed in range(4):
        state = random_state(one, seed)
        frames = SEA.frames(np.array([1.7 * seed]))
        rotation = frames.rotation[0]
        velocity = rotation.T @ frames.velocity[0]
        omega = frames.omega[0]
        q = np.concatenate([frames.origin[0], pin.Quaternion(rotation).coeffs(), state.q])
        v = np.concatenate([velocity, omega, state.v])
        # Pinocchio's acceleration of the root is the derivative of its velocity in its own axes.
        linear = rotation.T @ frames.acceleration[0] - np.cross(omega, velocity)
        root = np.concatenate([linear, frames.alpha[0]])
        mass = pin.crba(floating, data, q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        bias = pin.nonLinearEffects(floating, data, q, v)
        external = ExternalForces(one, buffers=False, moving_base=True)
        assert external.root is not None
        gravity = one.model.gravity.linear
        external.root.motion = RootMotion.of(frames.root_numbers(gravity)[0])
        drives = EffortDrives(one, external)
        drives.convention = pin.Convention.LOCAL
        drives.take_command(1e3 * np.ones(one.layout.m), state)
        effort = drives._tau + drives._joint_forces.effort(state.q, state.v)
        expected = hybrid_acceleration(mass, bias, root, effort)
        found = drives.acceleration(state.q, state.v)
        # 1e-10 of the largest, times what the mass matrix loses of the digits
        assert_allclose(found, expected, rtol=0.0, atol=1e-10 * np.abs(expected).max())


@pytest.mark.slow
def test_mujoco_accelerates_a_crane_on_a_body_whose_motion_is_given_alike() -> None:
    mujoco = pytest.importorskip("mujoco")
    from cranedyn.export import mjcf_file
    from cranedyn.export.crane_data import urdf_element

    one = crane()
    root = mjcf_file.mjcf(one, urdf_element(one), 1e-3)
    world = root.find("worldbody")
    assert world is not None
    # All bodies of the crane hang from a free body.
    base = ET.Element("body", name="base")
    base.append(ET.Element("freejoint"))
    base.append(
        ET.Element("inertial", mass="1", pos="0 0 0", diaginertia="1 1 1")
    )  # moved as prescribed, so that it does not matter
    for body in list(world.findall("body")):
        world.remove(body)
        base.append(body)
    world.append(base)
    for constraint in root.findall("equality"):
        root.remove(constraint)
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    data = mujoco.MjData(model)
    names = [joint.name for joint in one.layout.joints]
    order = [model.joint(name).dofadr[0] for name in names]
    for seed in range(3):
        state = random_state(one, seed)
        frames = SEA.frames(np.array([2.1 * seed]))
        rotation = frames.rotation[0]
        quaternion = pin.Quaternion(rotation)
        data.qpos[:3] = frames.origin[0]
        data.qpos[3:7] = [quaternion.w, quaternion.x, quaternion.y, quaternion.z]
        # MuJoCo's free joint has its velocity in the world and its angular velocity in the body.
        data.qvel[:3] = frames.velocity[0]
        data.qvel[3:6] = frames.omega[0]
        for name, address, q, v in zip(names, order, *state, strict=True):
            data.qpos[model.joint(name).qposadr[0]] = q
            data.qvel[address] = v
        mujoco.mj_forward(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        passive = data.qfrc_passive
        forces = passive - data.qfrc_bias
        given = np.concatenate([frames.acceleration[0], frames.alpha[0]])
        rows = np.array(order)
        right = forces[rows] - mass[np.ix_(rows, np.arange(6))] @ given
        expected = np.linalg.solve(mass[np.ix_(rows, rows)], right)
        external = ExternalForces(one, buffers=False, moving_base=True)
        assert external.root is not None
        external.root.motion = RootMotion.of(frames.root_numbers(one.model.gravity.linear)[0])
        drives = EffortDrives(one, external)
        found = drives.acceleration(*state)
        # MuJoCo reads its file with six digits, or so
        assert_allclose(found, expected, rtol=0.0, atol=1e-6 * np.abs(expected).max())


# --- both engines ---------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drive", "rule"),
    [
        pytest.param("effort", semi_implicit_euler, id="effort, Euler"),
        pytest.param("effort", rk4, id="effort, RK4"),
        pytest.param("effort", EXPLICIT_EULER, id="effort, another rule"),
        pytest.param("motion", rk4, id="motion, RK4"),
        pytest.param("velocity", semi_implicit_euler, id="velocity, Euler"),
        pytest.param("velocity", rk4, id="velocity, RK4"),
    ],
)
def test_both_engines_move_a_crane_on_a_base_alike(drive: str, rule: Any) -> None:
    one = crane()
    start = one.state(x=12.0, l=10.0, phi=0.05)
    held = hold_controller(one)

    def waving(t: float, state: State, setpoint: Any) -> np.ndarray:
        return held(t, state, setpoint) if drive == "effort" else 0.05 * np.sin([t, 2.0 * t, t])

    how: dict[str, Any] = dict(
        start=start, duration=1.0, drive=drive, base=SEA, dt=1e-3, integrator=rule
    )
    runs = [simulate(one, waving, engine=engine, **how) for engine in ENGINES]
    for name in ("q", "v", "effort", "energy", "outside", "base"):
        plain, compiled = (getattr(run, name) for run in runs)
        assert_allclose(compiled, plain, rtol=0.0, atol=1e-11 * max(1.0, np.abs(plain).max()))


@pytest.mark.slow
def test_buffers_act_on_a_moving_base_alike_in_both_engines() -> None:
    # Where a buffer acts, small steps replace each step of RK4: they must know the time within it.
    one = crane()
    start = one.state(x=float(one.upper[1]) - 0.01, l=10.0)
    pushed = one.effort_limit * np.array([0.0, 1.0, 0.0])
    pushed[2] = -one.payload_mass * G
    shaking = BaseMotion.sines(sway=(0.05, 0.4), roll=(0.02, 0.5))
    how: dict[str, Any] = dict(
        start=start, duration=0.4, validity="buffers", integrator=rk4, dt=5e-3, base=shaking
    )
    runs = [
        simulate(one, lambda t, state, setpoint: pushed, engine=engine, **how) for engine in ENGINES
    ]
    assert abs(runs[0]["W_buffers_J"][-1]) > 10.0
    assert_allclose(runs[1].q, runs[0].q, rtol=0.0, atol=1e-10)
    assert_allclose(runs[1].outside, runs[0].outside, rtol=0.0, atol=1e-5)


@pytest.mark.slow
def test_a_rope_catches_its_load_on_a_heaving_base_where_its_ends_meet() -> None:
    # In coarse steps, too: the pieces of a step know when in the step they begin. The load falls
    # freely while the base heaves, and the closed form says when the rope has no more slack.
    one = load_crane(gravity=G, rope_stiffness=math.inf)
    stretch = one.springs.rope.stretch
    start = one.state(x=12.0, l=10.0)
    q = start.q.copy()
    q[stretch] = -0.05
    amplitude = 0.1
    omega = 2.0 * math.pi / 1.6
    base = BaseMotion.sines(heave=(amplitude, 1.6))
    found = []
    for dt in (2e-2, 1e-3):
        run = quickly(
            one,
            locked,
            start=State(q, start.v),
            duration=0.3,
            dt=dt,
            control_period=0.02,
            drive="motion",
            integrator=rk4,
            base=base,
            validity="mark",
        )
        found.append(run["W_impacts_J"][-1])
    # The stretch is s = -0.05 + g t²/2 + A (sin ωt - ωt), as the load is released at the rate of
    # the base; the impact takes ½ m ṡ² where s = 0.
    t = brentq(
        lambda t: -0.05 + G * t**2 / 2.0 + amplitude * (math.sin(omega * t) - omega * t), 0, 1
    )
    rate = G * t + amplitude * omega * (math.cos(omega * t) - 1.0)
    expected = -0.5 * one.payload_mass * rate**2
    # RK4 in steps of 0.02 s: (ω dt)⁴/100 = 1e-7
    assert_allclose(found, expected, rtol=1e-6)


@pytest.mark.slow
def test_wind_blows_against_the_motion_of_the_base_in_both_engines() -> None:
    # a base that drives into calm air as fast as the wind blows at a crane at rest
    one = crane()
    speed = 12.0
    driving = BaseMotion(steadily(np.array([speed, 0.0, 0.0])))
    start = one.state(x=12.0, l=10.0)
    held = hold_controller(one)
    how: dict[str, Any] = dict(start=start, duration=2.0)
    blown = wind(one, steady(speed), direction=math.pi, payload_area=6.0)
    calm = wind(one, steady(0.0), direction=0.0, payload_area=6.0)
    standing = simulate(one, held, disturbance=blown, **how)
    assert np.abs(standing["theta_rad"]).max() > 0.01
    for engine in ENGINES:
        moving = simulate(one, held, disturbance=calm, base=driving, engine=engine, **how)
        assert_allclose(moving.q, standing.q, rtol=0.0, atol=1e-12)
        assert_allclose(moving.force, standing.force, rtol=0.0, atol=1e-9)


def steadily(velocity: np.ndarray) -> Callable[[np.ndarray], BaseCoordinates]:
    """A base that moves along with a steady velocity."""

    def function(times: np.ndarray) -> BaseCoordinates:
        rows = len(times)
        position = np.zeros((rows, 6))
        rate = np.zeros((rows, 6))
        position[:, :3] = np.outer(times, velocity)
        rate[:, :3] = velocity
        return BaseCoordinates(position, rate, np.zeros((rows, 6)))

    return function


def rising(column: int, acceleration: float) -> BaseMotion:
    """A base one of whose coordinates accelerates steadily from rest."""

    def function(times: np.ndarray) -> BaseCoordinates:
        arrays = np.zeros((3, len(times), 6))
        arrays[0, :, column] = 0.5 * acceleration * times**2
        arrays[1, :, column] = acceleration * times
        arrays[2, :, column] = acceleration
        return BaseCoordinates(*arrays)

    return BaseMotion(function)


@pytest.mark.slow
def test_a_base_at_rest_changes_nothing() -> None:
    one = crane()
    start = one.state(x=12.0, l=10.0, phi=0.1)
    for engine in ENGINES:
        how: dict[str, Any] = dict(start=start, duration=1.0, engine=engine)
        standing = simulate(one, hold_controller(one), **how)
        on_base = simulate(one, hold_controller(one), base=rising(2, 0.0), **how)
        assert_allclose(on_base.q, standing.q, rtol=0.0, atol=1e-13)
        assert_allclose(on_base.energy, standing.energy, rtol=1e-12)
        assert np.abs(on_base["W_base_J"]).max() < 1e-6


# --- principles of mechanics ----------------------------------------------------------------------

LIFTED = {
    "rigid rope": {},
    "elastic rope": {"rope_stiffness": 2e6},
    "slack rope": {"rope_stiffness": math.inf},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LIFTED)
def test_a_base_that_accelerates_upwards_is_more_gravity(name: str) -> None:
    # Einstein's lift, through the phases of a rope that goes slack and catches the load, too
    extra = 1.7
    values = LIFTED[name]
    standing = load_crane(gravity=G + extra, **values)
    lifted = load_crane(gravity=G, **values)
    start = standing.state(x=12.0, l=10.0, phi=0.1)
    if "rope_stiffness" in values:
        stretch = standing.springs.rope.stretch
        q = start.q.copy()
        q[stretch] = -0.05  # falls into its rope
        start = State(q, start.v)
    how: dict[str, Any] = dict(
        start=start, duration=0.6, drive="motion", validity="mark", integrator=rk4, dt=1e-3
    )
    expected = simulate(standing, locked, **how)
    for engine in ENGINES if name == "rigid rope" else ("compiled",):
        found = simulate(lifted, locked, base=rising(2, extra), engine=engine, **how)
        assert_allclose(found.q, expected.q, rtol=0.0, atol=1e-10)
        assert_allclose(found.effort, expected.effort, rtol=1e-8, atol=1e-5)


@pytest.mark.slow
def test_a_load_on_a_deck_that_rises_stands_as_under_more_gravity() -> None:
    extra = 1.5
    corners = [(x, y, -0.5) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]
    results = []
    for gravity, motion in ((G + extra, None), (G, rising(2, extra))):
        one = load_crane(gravity=gravity, rope_stiffness=math.inf)
        start = one.state(x=12.0, l=10.0)
        height = float(point_positions(one, start.q)[0, 2]) - 0.503
        # The stiffness of a ground is made for the weight of the load at rest.
        sink = 0.002 * gravity / (G + extra)
        results.append(
            simulate(
                one,
                lambda t, state, setpoint: np.array([0.0, 0.0, 0.2 if t < 0.1 else 0.0]),
                start=start,
                duration=0.5,
                drive="motion",
                validity="mark",
                ground=Ground(corners, height=height, sink=sink),
                base=motion,
            )
        )
    standing, lifted = results
    assert (standing.phase == 2.0).any()
    assert_allclose(lifted.phase, standing.phase)
    assert_allclose(lifted.q, standing.q, rtol=0.0, atol=1e-8)


@pytest.mark.slow
def test_a_base_that_yaws_is_a_jib_that_slews() -> None:
    # Coriolis, centrifugal and Euler forces: the slew turns about the axis of the yaw
    one = crane()
    angular = 0.05
    start = one.state(x=15.0, l=10.0, phi=0.02)
    accelerate = np.array([angular, 0.0, 0.0])
    how: dict[str, Any] = dict(start=start, duration=3.0, drive="motion")
    slewing = simulate(one, lambda t, state, setpoint: accelerate, **how)
    for engine in ENGINES:
        yawing = simulate(one, locked, base=rising(5, angular), engine=engine, **how)
        assert_allclose(yawing.q[:, 1:], slewing.q[:, 1:], rtol=0.0, atol=1e-10)
        assert_allclose(yawing["base_yaw_rad"], 0.5 * angular * yawing.t**2, atol=1e-15)


# --- closed forms ---------------------------------------------------------------------------------


def trace_over_a_period(one: Crane, length: float, motion: BaseMotion, period: float) -> float:
    """Trace of the matrix that maps a small swing and its rate over a period of the base."""
    small = 1e-4
    index = one.layout.index("phi")
    trace = 0.0
    for value in ("q", "v"):
        start = one.state(x=12.0, l=length)
        q = start.q.copy()
        v = start.v.copy()
        (q if value == "q" else v)[index] = small
        step = period / 400
        run = quickly(
            one,
            locked,
            start=State(q, v),
            duration=period,
            dt=step,
            control_period=step,
            drive="motion",
            integrator=rk4,
            base=motion,
            validity="mark",
        )
        trace += float(getattr(run, value)[-1, index]) / small
    return trace


@pytest.mark.slow
@pytest.mark.parametrize("boundary", [mathieu_b, mathieu_a])
def test_a_pendulum_on_a_heaving_pivot_has_mathieus_boundaries(boundary: Any) -> None:
    # y'' + (a - 2 q cos 2τ) y = 0 with τ = ω t/2, a = 4 g/(l ω²), q = 2 A/l: at both boundaries of
    # the first tongue a solution has twice the period of the base, and the trace is -2
    one = big_crane()
    length = 12.0
    q = 0.15
    a = float(boundary(1, q))
    omega = math.sqrt(4.0 * G / (length * a))
    period = 2.0 * math.pi / omega
    # acceleration = -A ω² sin(ω t + phase), that is a cosine for τ
    heaving = BaseMotion.sines(heave=(0.5 * q * length, period, math.pi / 2.0))
    trace = trace_over_a_period(one, length, heaving, period)
    # O(φ²) = 1e-8 by the nonlinearity, and that of RK4 with 400 steps
    assert trace == pytest.approx(-2.0, abs=1e-6)


def test_heave_inside_the_first_tongue_makes_a_swing_grow_at_the_rate_of_theory() -> None:
    # In the middle of the tongue, with the detuning 0, the rate is q ω/4 to first order in q.
    one = big_crane()
    length = 12.0
    q = 0.02
    omega = 2.0 * math.sqrt(G / length)
    period = 2.0 * math.pi / omega
    heaving = BaseMotion.sines(heave=(0.5 * q * length, period))
    trace = trace_over_a_period(one, length, heaving, period)
    rate = math.acosh(-trace / 2.0) / period
    assert rate == pytest.approx(q * omega / 4.0, rel=q)  # the next term of the series


def _py_crane_directions(base: BaseMotion, dt: float, duration: float) -> np.ndarray:
    """Directions of the rope in the world by DNV's py-crane, from pivot to load, shape (rows, 3): a
    pedestal of 28 m, a boom of 12 m along -Y and a wire of 10 m, whose base moves.
    """
    from py_crane.crane import Crane as PyCrane

    made = PyCrane(to_crane_angle=lambda angle: np.asarray(angle, dtype=float))
    made.add_boom("pedestal", mass=1.0, boom=(28.0, 0.0, 0.0))
    made.add_boom("boom", mass=1.0, boom=(12.0, np.pi / 2.0, -np.pi / 2.0))
    # The Q factor of a swing that is as good as undamped.
    made.add_boom("wire", mass=1000.0, mass_center=1.0, boom=(10.0, np.pi, 0.0), q_factor=1e9)
    wire = made.boom_
    wire.pendulum_relax()
    frames = base.frames(dt * np.arange(round(duration / dt) + 1))
    made.position = frames.origin[0].copy()
    wire.origin = wire.anchor0.end
    wire.origin_v = frames.velocity[0].copy()
    directions = [wire.direction.copy()]
    for before, after in itertools.pairwise(frames.origin):
        made.velocity = (after - before) / dt
        made.do_step(0.0, dt)
        directions.append(wire.direction.copy())
    return np.array(directions)


@pytest.mark.slow
def test_py_crane_of_dnv_swings_a_load_on_a_swaying_base_alike() -> None:
    """py-crane takes the mean velocity of the pivot over a step, which is half a step late: an
    error of first order, which two steps tell and remove. It also leaves the acceleration of the
    pivot along the rope in the velocity of its load, so that it is compared at a small sway: at
    ±0.3 m it differs by 1 % of the swing, with a heave of ±0.3 m beside it by 6 %.
    """
    pytest.importorskip("py_crane", reason="py-crane is not installed: pip install py-crane")
    base = BaseMotion.sines(sway=(0.03, 7.0, 0.5 * math.pi))
    one = load_crane(gravity=9.81, **POINT)  # as py-crane has it
    run = simulate(
        one,
        zero_command(one),
        None,
        start=one.state(x=12.0, l=10.0),
        duration=8.0,
        dt=1e-3,
        control_period=1e-2,
        drive="motion",
        integrator=rk4,
        base=base,
    )
    points = base.frames(run.t).points_in_world(point_paths(one, run.q))
    rope = points[:, 0] - points[:, 1]
    ours = rope / np.linalg.norm(rope, axis=1)[:, None]
    swing = np.abs(ours[:, 1]).max()
    coarse = _py_crane_directions(base, 0.02, 8.0)
    fine = _py_crane_directions(base, 0.01, 8.0)[::2]
    late = np.abs(fine - ours[::2]).max()
    assert 0.45 * np.abs(coarse - ours[::2]).max() < late < 6e-3 * swing
    # What is left is of second order in the step of 0.02 s, (ω dt)², and in the swing of 14 mrad.
    assert np.abs(2.0 * fine - coarse - ours[::2]).max() < 4e-4 * swing


@pytest.mark.slow
def test_a_rolling_base_swings_a_load_as_the_linear_response_says() -> None:
    # Roll about X moves the pivot at the height h sideways by -h φ; the load answers as a pendulum
    # whose pivot is driven: (ω0² - ω²) β = -ω² h φ/l with the angle β in the world.
    one = big_crane()
    length = 12.0
    amplitude = 1e-5
    period = 9.0
    omega = 2.0 * math.pi / period
    natural = math.sqrt(G / length)
    start = one.state(x=20.0, l=length)
    pivot = point_positions(one, start.q)[1]
    roll = BaseMotion.sines(roll=(amplitude, period))
    lateral = -float(pivot[2]) * amplitude
    # The jib points along -Y, and φ is positive where the load lags inwards, towards +Y.
    in_world = omega**2 * lateral / length / (natural**2 - omega**2)
    # The load lies at l β along Y in the world, and what is plumb in the base at l φ.
    steady_amplitude = in_world - amplitude
    # begin in the steady motion, which is a sine
    v = start.v.copy()
    index = one.layout.index("phi")
    v[index] = steady_amplitude * omega
    run = quickly(
        one,
        locked,
        start=State(start.q, v),
        duration=18.0,
        dt=5e-3,
        drive="motion",
        integrator=rk4,
        base=roll,
    )
    expected = steady_amplitude * np.sin(omega * run.t)
    # the square of the roll is lost, and the cable is longer by the jib's share
    assert_allclose(run["phi_rad"], expected, rtol=0.0, atol=1e-3 * abs(steady_amplitude))


# --- energy and record ----------------------------------------------------------------------------


def unexplained(period: float, **how: Any) -> float:
    one = crane()
    run = quickly(
        one,
        hold_controller(one),
        start=one.state(x=12.0, l=10.0),
        duration=4.0,
        base=SEA,
        dt=2.5e-3,
        control_period=period,
        integrator=rk4,
        **how,
    )
    assert np.ptp(run["W_base_J"]) > 1e4
    return float(np.abs(run.unexplained).max())


def test_the_work_of_the_base_closes_the_energy_in_the_world() -> None:
    # The work is a sum by the trapezoidal rule: halving the control period divides what is left by
    # four. Momentum gives the force of the base, so that nothing here comes from the dynamics.
    coarse = unexplained(5e-3)
    fine = unexplained(2.5e-3)
    assert coarse < 1.0
    assert fine == pytest.approx(coarse / 4.0, rel=0.05)


@pytest.mark.slow
def test_a_run_keeps_the_motion_of_its_base_in_its_files(tmp_path: Any) -> None:
    one = crane()
    run = quickly(one, hold_controller(one), duration=0.1, base=SEA)
    assert_allclose(run["base_heave_m"], np.sin(2.0 * np.pi * run.t / 8.0 + 0.3), atol=1e-15)
    for ending in ("csv", "parquet"):
        run.write(tmp_path / f"run.{ending}")
        again = read(tmp_path / f"run.{ending}")
        assert again.base is not None and run.base is not None
        assert np.array_equal(again.base, run.base)
        assert again.keys() == run.keys()
    back = BaseMotion.from_file(tmp_path / "run.csv")
    assert_allclose(back.at(run.t[3:5]).position, run.base[3:5], atol=1e-14)
    assert run.record["base"]["source"].startswith("sines of surge")
    assert run.since(0.05).base.shape == (len(run.since(0.05)), 6)


def test_a_stepper_moves_a_crane_on_a_base_as_a_run_does() -> None:
    one = crane()
    held = hold_controller(one)
    start = one.state(x=12.0, l=10.0)
    run = simulate(one, held, start=start, duration=0.1, base=SEA)
    for engine in ENGINES:
        stepper = Stepper(one, start=start, base=SEA, engine=engine)
        for row in range(20):
            state = stepper.state
            assert_allclose(state.q, run.q[row], rtol=0.0, atol=1e-13)
            stepper.step(run.command[row])
        stepper.reset(start)
        stepper.step(run.command[0])
        assert_allclose(stepper.state.q, run.q[1], rtol=0.0, atol=1e-13)


@pytest.mark.slow
def test_many_cranes_on_one_base_move_as_each_alone() -> None:
    from cranedyn.compiled.batch import simulate_batch

    cranes = [crane(payload_mass=mass) for mass in (500.0, 1500.0)]
    start = cranes[0].state(x=12.0, l=10.0)
    force = np.array([[500.0, -300.0, 100.0, 50.0, 0.0, 0.0], [0.0] * 6])
    held = [hold_controller(one) for one in cranes]
    how: dict[str, Any] = dict(start=start, duration=1.0, base=SEA)
    batch = simulate_batch(cranes, held, record=1, force=force, **how)
    for row, one in enumerate(cranes):

        def push(t: float, state: State) -> np.ndarray:
            return force[0 if t < 2.5e-3 else 1].reshape(2, 3)

        alone = simulate(one, held[row], disturbance=push, **how)
        assert_allclose(batch.q[row], alone.q, rtol=0.0, atol=1e-11)


@pytest.mark.slow
def test_each_crane_of_a_batch_may_stand_on_a_base_of_its_own() -> None:
    from cranedyn.compiled.batch import simulate_batch

    one = crane()
    held = hold_controller(one)
    start = one.state(x=12.0, l=10.0)
    bases = [SEA, BaseMotion.sines(heave=(0.3, 5.0), pitch=(0.05, 6.0)), SEA]
    force = np.array([[500.0, -300.0, 100.0, 50.0, 0.0, 0.0]])
    how: dict[str, Any] = dict(start=start, duration=0.5)
    batch = simulate_batch(one, held, base=bases, record=1, force=force, **how)
    push = constant_force(one, payload=force[0, :3], trolley=force[0, 3:])
    for row, base in enumerate(bases):
        alone = simulate(one, held, disturbance=push, base=base, **how)
        assert_allclose(batch.q[row], alone.q, rtol=0.0, atol=1e-11)
    assert np.abs(batch.q[0] - batch.q[1]).max() > 1e-4
    with pytest.raises(OutOfRange, match="number of bases is 2"):
        simulate_batch([one] * 3, held, base=bases[:2], **how)


# --- errors ---------------------------------------------------------------------------------------


def run_on(base: Any, **how: Any) -> Trajectory:
    one = crane()
    return simulate(one, hold_controller(one), duration=1.0, base=base, **how)


def test_a_base_that_is_none_is_refused_in_a_sentence() -> None:
    with pytest.raises(OutOfRange, match="allowed is a BaseMotion"):
        run_on("heave")
    t = np.linspace(0.0, 0.5, 20)
    short = BaseMotion.from_table(t, heave=np.sin(t))
    with pytest.raises(OutOfRange, match=r"is 1\.0 s; allowed is 0 to 0\.5, for which a table"):
        run_on(short)
    with pytest.raises(OutOfRange, match=r"is -1\.0 s"):
        run_on(short, t_start=-1.0)
    steep = BaseMotion.sines(pitch=(1.6, 4.0))
    with pytest.raises(OutOfRange, match="pitch of the base"):
        run_on(steep)


def test_a_function_that_fails_on_the_way_ends_a_run_with_its_rows() -> None:
    def function(times: np.ndarray) -> BaseCoordinates:
        if ((times > 0.5) & (times < 0.9)).any():
            raise ValueError("no sea here")
        return BaseCoordinates(*np.zeros((3, len(times), 6)))

    for engine in ENGINES:
        with pytest.raises(RunError, match=r"The function of the base failed.*no sea here") as told:
            run_on(BaseMotion(function), engine=engine)
        assert told.value.trajectory is not None


# --- what follows a run ---------------------------------------------------------------------------


@pytest.mark.slow
def test_what_knows_no_base_that_moves_refuses_such_a_run() -> None:
    from cranedyn.lifts.judging.loads import loads

    one = crane()
    run = quickly(one, hold_controller(one), duration=0.5, base=SEA)
    with pytest.raises(OutOfRange, match="the computation of loads knows no base that moves"):
        loads(one, run)


@pytest.mark.slow
def test_an_mcap_file_has_the_root_of_the_crane_in_the_world(tmp_path: Any) -> None:
    pytest.importorskip("mcap", reason="extra mcap is not installed")
    from mcap_ros2.reader import read_ros2_messages

    from cranedyn.export import mcap

    one = crane()
    run = quickly(one, hold_controller(one), duration=0.1, base=SEA)
    file = mcap.export(tmp_path / "run.mcap", one, run)
    last = [message.ros_msg for message in read_ros2_messages(str(file), topics=["/tf"])][-1]
    (root,) = [item for item in last.transforms if item.child_frame_id == "world"]
    # The root link of the tower crane has the name of the world itself.
    assert root.header.frame_id == "earth"
    t = root.header.stamp.sec + 1e-9 * root.header.stamp.nanosec
    frames = SEA.frames(np.array([t]))
    moved = root.transform.translation
    assert_allclose([moved.x, moved.y, moved.z], frames.origin[0], atol=1e-8)
    turn = root.transform.rotation
    rotation = pin.Quaternion(turn.w, turn.x, turn.y, turn.z).matrix()
    assert_allclose(rotation, frames.rotation[0], atol=1e-8)
