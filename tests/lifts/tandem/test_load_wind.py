"""Wind on the load of two cranes: statics, energy, another engine, and gusts of a lift."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("coal", reason="extra planning (coal) is not installed")

from cranedyn.disturbances.wind import AIR_DENSITY, cosine_gust, drag_force, steady
from cranedyn.errors import OutOfRange
from cranedyn.lifts.tandem.judgement import judge_tandem
from cranedyn.lifts.tandem.load import TandemRope
from cranedyn.lifts.tandem.load_wind import LoadWind
from cranedyn.lifts.tandem.simulation import LoadPose, simulate_tandem
from cranedyn.lifts.tandem.statics import lean_in_wind
from tests.lifts.tandem.test_tandem import (
    ASIDE,
    BEAM,
    START,
    USUAL,
    YAW,
    G,
    askew_lift,
    held,
    lift_of,
    planned,
    tendon_model,
)


def test_the_faces_together_are_the_area_that_the_box_turns_to_the_wind() -> None:
    """The force is that of the projected area of the corners' hull, along the wind."""
    rotation = Rotation.from_euler("xyz", [0.3, -0.2, 0.9])
    wind = LoadWind(steady(9.0), 0.4, drag=1.1)
    blown = wind.on(BEAM, 0.0, rotation.as_matrix(), np.zeros(6))
    # A box seen along a unit vector u: the sum of its faces' areas times |u·n|.
    length, width, height = BEAM.size
    seen = np.abs(rotation.as_matrix().T @ wind.unit_vector)
    area = float(seen @ [width * height, length * height, length * width])
    force = rotation.apply(blown.force)
    expected = drag_force(1.1 * area, 9.0 * wind.unit_vector)
    np.testing.assert_allclose(force, expected, rtol=1e-12, atol=1e-9)
    assert blown.power == 0.0


def test_a_load_that_moves_with_the_wind_feels_none() -> None:
    wind = LoadWind(steady(2.0), 0.0)
    v = np.array([2.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    blown = wind.on(BEAM, 0.0, np.eye(3), v)
    assert not blown.force.any() and not blown.torque.any()
    faster = wind.on(BEAM, 0.0, np.eye(3), 2.0 * v)
    assert faster.force[0] < 0.0 and faster.power < 0.0


def test_a_load_hangs_still_in_a_steady_wind_where_statics_say() -> None:
    """A bifilar load drifts by (L + h) sin β, with tan β the force of the wind over the weight."""
    rope = TandemRope(2e8, 2e5)
    lift = lift_of(rope=rope)
    still = held(lift)
    lean = lean_in_wind(BEAM, 12.0, G)
    # Of the side alone the lean would be 2 % less.
    side = 0.5 * AIR_DENSITY * 1.2 * 15.0 * 0.8 * 12.0**2
    assert lean == pytest.approx(math.atan(side / (BEAM.mass * G)), rel=0.03)
    first = still.first
    unstretched = float(first.position[0, -1])
    pull = 0.5 * BEAM.mass * G
    length = unstretched * (1.0 + pull / math.cos(lean) / rope.stiffness)
    plumb = unstretched * (1.0 + pull / rope.stiffness)
    aside = (length + 0.4) * math.sin(lean)
    down = (length + 0.4) * math.cos(lean) - (plumb + 0.4)
    attitude = Rotation.from_euler("y", -lean) * Rotation.from_euler("z", YAW)
    start = LoadPose(np.add(START, (aside, 0.0, -down)), attitude)
    wind = LoadWind(steady(12.0), 0.0)
    run = simulate_tandem(lift, still, start=start, duration=4.0, dt=2e-3, wind=wind)
    # At rest but for rounding: what statics say is the rest of the simulation.
    np.testing.assert_allclose(run["load_x_m"] - START[0], aside, rtol=1e-7)
    assert np.ptp(run["load_z_m"]) < 1e-7 and np.ptp(run["roll_rad"]) < 1e-7


def test_energy_is_what_cranes_and_wind_put_in_less_what_damping_takes() -> None:
    gust = LoadWind(cosine_gust(steady(3.0), 9.0, at=1.0, lasts=4.0), 0.3)
    errors = []
    for dt in (2e-3, 1e-3):
        run = simulate_tandem(planned().lift, planned(), duration=8.0, dt=dt, wind=gust)
        gained = run["energy_J"] - run["energy_J"][0]
        errors.append(np.abs(gained - run["input_J"] - run["wind_J"] + run["loss_J"]).max())
    assert np.abs(run["wind_J"]).max() > 100.0
    assert run["wind_m_s"].max() == pytest.approx(12.0, rel=1e-4)
    # Of order 1: half the step, half the error.
    assert errors[1] < 0.6 * errors[0] < 60.0


def test_mujoco_moves_the_same_load_in_the_same_wind_alike() -> None:
    """The forces on its body are computed in the axes of the world, from MuJoCo's own state."""
    mujoco = pytest.importorskip("mujoco", reason="extra mujoco is not installed")
    lift = askew_lift()
    load = lift.load
    still = held(lift, ASIDE)
    start = LoadPose(np.array(ASIDE), Rotation.from_euler("z", YAW + 0.1))
    wind = LoadWind(steady(15.0), 0.5)
    dt = 2.5e-4
    run = simulate_tandem(lift, still, start=start, duration=3.0, dt=dt, period=0.05, wind=wind)
    model = tendon_model(lift, still, start, run, dt=dt, rule="Euler")
    data = mujoco.MjData(model)
    body = model.body("load").id
    air = 15.0 * np.array([math.cos(0.5), math.sin(0.5), 0.0])

    def push() -> None:
        """Set force and torque of all faces onto which the wind blows."""
        axes = data.xmat[body].reshape(3, 3)
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, body, velocity, 0)
        force = np.zeros(3)
        torque = np.zeros(3)
        for axis, sign in itertools.product(range(3), (-1.0, 1.0)):
            normal = sign * axes[:, axis]
            arm = normal * load.size[axis] / 2.0
            relative = air - velocity[3:] - np.cross(velocity[:3], arm)
            if relative @ normal < 0.0:
                area = math.prod(load.size) / load.size[axis]
                on_face = -0.5 * 1.25 * 1.2 * area * (relative @ normal) * relative
                force += on_face
                torque += np.cross(arm, on_face)
        data.xfrc_applied[body] = [*force, *torque]

    mujoco.mj_forward(model, data)
    positions = [data.qpos[:3].copy()]
    for _ in range(60):
        for _ in range(200):
            mujoco.mj_step1(model, data)
            push()
            mujoco.mj_step2(model, data)
        positions.append(data.qpos[:3].copy())
    calm = simulate_tandem(lift, still, start=start, duration=3.0, dt=dt, period=0.05)
    # The wind moves the load by a decimetre. Both step by semi-implicit Euler, with quaternions
    # that are stepped in other ways.
    assert np.abs(run.centres - calm.centres).max() > 0.1
    np.testing.assert_allclose(run.centres, positions, atol=1e-4)


def test_a_judged_lift_says_in_which_wind_it_was_simulated() -> None:
    wind = LoadWind(steady(4.0), 0.0)
    run = simulate_tandem(planned().lift, planned(), dt=4e-3, duration=2.0, wind=wind)
    sentences = [check.sentence for check in judge_tandem(run) if check.holds]
    assert any("a wind of up to 4.0 m/s that blows at 0°" in sentence for sentence in sentences)
    with pytest.raises(OutOfRange, match="drag coefficient of the load"):
        LoadWind(steady(4.0), 0.0, drag=-1.0)
    assert planned().lift.rope == USUAL
