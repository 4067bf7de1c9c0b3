"""Other programs read what we write, and two of them agree on the numbers."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from numpy.testing import assert_allclose

from cranedyn import dynamics
from cranedyn.crane import JOINTS, State
from tests.helpers import G, crane, efforts, states

DAMPING = {"damp_slew": 3e4, "damp_trolley": 200.0, "damp_swing": 5e3, "damp_hoist": 700.0}


@pytest.fixture(scope="module")
def urdf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("urdf") / "crane.urdf"
    path.write_text(crane(**DAMPING).urdf)
    return path


def test_check_urdf_accepts_it(urdf: Path) -> None:
    program = Path(sys.executable).with_name("check_urdf")
    if not program.exists():
        pytest.skip("check_urdf is not beside this Python")
    run = subprocess.run([program, urdf], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert "robot name is: tower_crane" in run.stdout
    assert run.stderr == ""


def test_yourdfpy_puts_the_load_where_we_do(urdf: Path) -> None:
    yourdfpy = pytest.importorskip("yourdfpy")
    robot = yourdfpy.URDF.load(str(urdf), load_meshes=False)
    assert list(robot.actuated_joint_names) == [joint.name for joint in JOINTS]
    assert robot.validate()

    @given(states)
    def same_place(state: State) -> None:
        robot.update_cfg(state.q)
        expected = robot.get_transform("hook_link", "world")[:3, 3]
        assert_allclose(dynamics.payload_position(crane(), state.q), expected, atol=1e-12)  # rounding

    same_place()


def test_the_visuals_show_a_crane_of_its_measures(urdf: Path) -> None:
    yourdfpy = pytest.importorskip("yourdfpy")
    robot = yourdfpy.URDF.load(str(urdf))
    low, high = robot.scene.bounds
    assert low[2] >= -0.5
    assert high[2] == pytest.approx(33.45, abs=0.5)  # total height, plus half the thickness of a bar
    assert -25.0 < low[1] < -22.0  # the jib reaches along -Y beyond the largest trolley radius
    assert high[1] > 5.0  # counter-jib


# --- MuJoCo ------------------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def engine(urdf: Path) -> Any:
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(urdf))
    model.opt.gravity[:] = [0.0, 0.0, -G]
    return mujoco, model, mujoco.MjData(model)


def test_mujoco_has_the_same_joints_in_the_same_order(engine: Any) -> None:
    _, model, _ = engine
    assert [model.joint(i).name for i in range(model.njnt)] == [joint.name for joint in JOINTS]
    assert model.dof_damping.tolist() == crane(**DAMPING).damping.tolist()
    assert_allclose(model.jnt_range, np.stack([crane().lower, crane().upper], axis=1))


def test_mujoco_has_the_same_mass_matrix_and_the_same_bias(engine: Any) -> None:
    mujoco, model, data = engine
    c = crane(**DAMPING)
    matrix = np.zeros((5, 5))

    @given(states)
    def same(state: State) -> None:
        data.qpos[:], data.qvel[:] = state
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, matrix)
        assert_allclose(pin.crba(c.model, c.data, state.q), matrix, atol=1e-14 * 2e6)  # rounding of the largest inertia
        bias = pin.nonLinearEffects(c.model, c.data, *state)
        assert_allclose(bias, data.qfrc_bias, atol=1e-14 * 1e6)  # rounding of moments of 1e6 N m

    same()


def test_mujoco_has_the_same_accelerations_with_damping(engine: Any) -> None:
    mujoco, model, data = engine
    c = crane(**DAMPING)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT  # joint ranges: a state near one must not be pushed back

    @given(states, efforts)
    def same(state: State, effort: np.ndarray) -> None:
        data.qpos[:], data.qvel[:] = state
        data.qfrc_applied[:] = dynamics.full(effort)
        mujoco.mj_forward(model, data)
        assert_allclose(dynamics.acceleration(c, state, effort), data.qacc, atol=1e-10, rtol=1e-9)  # rounding, light trolley

    same()
