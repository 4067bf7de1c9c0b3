"""The exporter to MuJoCo: the MJCF file is the crane, and moves as it does here."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from numpy.testing import assert_allclose

from cranedyn.bridges import mjcf
from cranedyn.controllers import hold_controller
from cranedyn.errors import ModelError
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.model.description import describe
from cranedyn.model.load import load_crane
from tests.helpers import ROOT, G, crane, states
from tests.system.test_cross_engines import DAMPING, DT, PERIOD, combined_move


def opened(folder: Path, one: Crane) -> tuple[Any, Any, Any]:
    mujoco = pytest.importorskip(
        "mujoco", reason="mujoco is not installed: pip install 'cranedyn[mujoco]'"
    )
    model = mujoco.MjModel.from_xml_path(str(mjcf.export(folder / "crane.xml", one)))
    return mujoco, model, mujoco.MjData(model)


@pytest.fixture(scope="module")
def engine(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Any, Any]:
    return opened(tmp_path_factory.mktemp("mjcf"), crane(**DAMPING))


@pytest.mark.slow
def test_joints_damping_ranges_gravity_start_and_drives_are_those_of_the_crane(engine: Any) -> None:
    _, model, _ = engine
    c = crane(**DAMPING)
    assert [model.joint(i).name for i in range(model.njnt)] == list(c.model.names)[1:]
    assert model.dof_damping.tolist() == c.damping.tolist()
    assert_allclose(model.jnt_range, np.stack([c.lower, c.upper], axis=1), rtol=1e-15)
    assert model.opt.gravity.tolist() == [0.0, 0.0, -G]
    assert model.key("start").qpos.tolist() == c.start.q.tolist()
    assert [model.actuator(i).name for i in range(model.nu)] == ["yaw", "trolley", "hoist"]
    assert model.actuator_ctrlrange[:, 1].tolist() == c.effort_limit.tolist()
    assert model.ngeom > 200  # it is drawn


def test_cylinders_are_as_long_and_as_wide_as_those_of_the_urdf(engine: Any) -> None:
    mujoco, model, _ = engine
    drawn = model.geom_size[model.geom_type == mujoco.mjtGeom.mjGEOM_CYLINDER, :2]
    urdf = [
        (float(shape.get("radius", "nan")), float(shape.get("length", "nan")) / 2.0)
        for shape in ET.fromstring(crane(**DAMPING).urdf.encode()).iterfind(".//visual//cylinder")
    ]
    assert len(urdf) > 0
    assert_allclose(sorted(map(tuple, drawn.tolist())), sorted(urdf))


def test_a_turned_box_has_the_size_and_the_axes_of_the_urdf(engine: Any, tmp_path: Path) -> None:
    mujoco, _, _ = engine
    box = (
        '<visual><origin xyz="1 2 3" rpy="0.3 0.4 0.5"/><geometry><box size="0.123 0.2 0.7"/>'
        "</geometry></visual></link>"
    )
    (tmp_path / "crane.urdf").write_text(describe().replace("</link>", box, 1))
    file = mjcf.export(tmp_path / "crane.xml", load_crane(tmp_path / "crane.urdf"))
    model = mujoco.MjModel.from_xml_path(str(file))
    (i,) = np.flatnonzero(np.isclose(model.geom_size[:, 0], 0.123 / 2.0))
    assert_allclose(model.geom_size[i], [0.0615, 0.1, 0.35])
    w, *axis = model.geom_quat[i]
    # Roll, pitch and yaw about fixed axes, which is yaw, pitch and roll about moving ones.
    expected = pin.utils.rotate("z", 0.5) @ pin.utils.rotate("y", 0.4) @ pin.utils.rotate("x", 0.3)
    assert_allclose(pin.Quaternion(w, *axis).matrix(), expected, atol=1e-9)


@pytest.mark.slow
def test_mass_matrix_and_bias_are_those_of_pinocchio(engine: Any) -> None:
    mujoco, model, data = engine
    c, matrix = crane(**DAMPING), np.zeros((5, 5))

    @given(states)
    def same(state: State) -> None:
        data.qpos[:], data.qvel[:] = state
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, matrix)
        inertia = np.sqrt(np.diag(matrix))
        # rounding.
        assert (
            np.abs(pin.crba(c.model, c.data, state.q) - matrix)
            <= 1e-13 * np.outer(inertia, inertia)
        ).all()
        bias = pin.nonLinearEffects(c.model, c.data, *state)
        assert (
            np.abs(bias - data.qfrc_bias) <= 1e-13 * math.sqrt(c.payload_mass) * G * inertia
        ).all()

    same()


@pytest.mark.slow
def test_the_same_combined_move_of_30_s_under_the_hold_controller_by_its_own_motors_and_step(
    tmp_path: Path,
) -> None:
    c, reference, run = combined_move(**DAMPING)
    mujoco, model, data = opened(tmp_path, c)
    brake = hold_controller(c, gravity=G)
    data.qpos[:], data.qvel[:] = run.state(0)
    rows = []
    for t in run.t:
        state = State(data.qpos.copy(), data.qvel.copy())
        rows.append(np.concatenate(state))
        data.ctrl[:] = brake(t, state, reference(t))
        mujoco.mj_step(model, data, round(PERIOD / DT))
    # Rounding, as in test_cross_engines.
    assert np.abs(np.array(rows) - np.hstack([run.q, run.v])).max() < 2e-13


@pytest.mark.parametrize("xacro", ["tower_crane", "overhead_crane"])
def test_a_crane_hangs_still_from_its_keyframe_on(xacro: str, tmp_path: Path) -> None:
    mujoco, model, data = opened(tmp_path, load_crane(ROOT / "urdf" / f"{xacro}.urdf.xacro"))
    mujoco.mj_resetDataKeyframe(model, data, 0)
    start = data.qpos.copy()
    mujoco.mj_step(model, data, 20_000)
    # Rounding of the weight: 10 s under eps g is 5e-14 m.
    assert_allclose(data.qpos, start, atol=1e-12)


def test_a_motor_gives_no_more_than_the_limit_of_its_drive(engine: Any) -> None:
    mujoco, model, data = engine
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.ctrl[:] = 1e9
    mujoco.mj_forward(model, data)
    assert data.qfrc_actuator[[0, 1, 4]].tolist() == crane().effort_limit.tolist()


def test_springs_motors_and_turned_inertias_are_carried(tmp_path: Path) -> None:
    spring = (
        "<gazebo reference='swing_radial_joint'>"
        "<springStiffness>70.0</springStiffness><springReference>0.25</springReference></gazebo>"
    )
    text = load_crane(gravity=G).urdf.replace("</robot>", f"{spring}</robot>")
    old = text.index("<inertial>", text.index('<link name="hook_link">'))
    inertial = (
        "<inertial><origin xyz='0.1 0.2 0.3' rpy='0.3 -0.5 0.7'/><mass value='1000'/>"
        "<inertia ixx='300' iyy='400' izz='500' ixy='10' ixz='20' iyz='30'/></inertial>"
    )
    text = text[:old] + inertial + text[text.index("</inertial>", old) + len("</inertial>") :]
    path = tmp_path / "other.urdf"
    path.write_text(text.replace('armature="0"', 'armature="250.0"'))
    c = load_crane(path, gravity=G)
    mujoco, model, data = opened(tmp_path, c)
    assert (model.jnt_stiffness[2], model.qpos_spring[2]) == (70.0, 0.25)
    data.qpos[:] = q = np.array([0.3, 12.0, 0.2, -0.3, 9.0])
    mujoco.mj_forward(model, data)
    matrix = np.zeros((5, 5))
    mujoco.mj_fullM(model, data, matrix)
    inertia = np.sqrt(np.diag(matrix))
    assert (
        np.abs(pin.crba(c.model, c.data, q) - matrix) <= 1e-12 * np.outer(inertia, inertia)
    ).all()
    assert data.qfrc_passive[2] == pytest.approx(-70.0 * (0.2 - 0.25))


@pytest.mark.parametrize("size", ["0 1 1", "1 -1 1"])
def test_a_shape_without_size_with_which_mujoco_takes_no_file_is_refused(
    size: str, tmp_path: Path
) -> None:
    robot = ET.fromstring(load_crane().urdf.encode())
    next(robot.iter("box")).set("size", size)
    ET.ElementTree(robot).write(tmp_path / "flat.urdf")
    flat = load_crane(tmp_path / "flat.urdf")
    with pytest.raises(ModelError, match=r"A box of the link \w+ has no size, with which MuJoCo"):
        mjcf.export(tmp_path / "flat.xml", flat)


@pytest.mark.parametrize("length", ["1e-20", "7"])
def test_an_axis_of_any_length_is_the_same_axis(length: str, tmp_path: Path) -> None:
    text = load_crane().urdf
    short = text.replace('<axis xyz="0 1 0"/>', f'<axis xyz="0 {length} 0"/>')
    assert short != text
    (tmp_path / "short.urdf").write_text(short)
    _, model, _ = opened(tmp_path, load_crane(tmp_path / "short.urdf"))
    (tmp_path / "usual").mkdir()
    _, usual, _ = opened(tmp_path / "usual", load_crane())
    assert np.array_equal(model.jnt_axis, usual.jnt_axis)
