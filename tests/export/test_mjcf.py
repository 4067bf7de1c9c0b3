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

from cranedyn.controllers import hold_controller
from cranedyn.errors import ModelError
from cranedyn.export import mjcf_file
from cranedyn.interfaces import Reference, State
from cranedyn.model.crane import Crane
from cranedyn.model.description import describe
from cranedyn.model.load import load_crane
from cranedyn.references import hold, ramp
from cranedyn.simulation.simulate import simulate
from tests.helpers import ROOT, G, crane, quickly, states
from tests.system.test_cross_engines import DAMPING, DT, PERIOD, combined_move


def opened(folder: Path, one: Crane) -> tuple[Any, Any, Any]:
    mujoco = pytest.importorskip(
        "mujoco", reason="mujoco is not installed: pip install 'cranedyn[mujoco]'"
    )
    model = mujoco.MjModel.from_xml_path(str(mjcf_file.export(folder / "crane.xml", one)))
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
    file = mjcf_file.export(tmp_path / "crane.xml", load_crane(tmp_path / "crane.urdf"))
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
    c = crane(**DAMPING)
    matrix = np.zeros((5, 5))

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


@pytest.mark.slow
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
        mjcf_file.export(tmp_path / "flat.xml", flat)


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


def text_of(folder: Path, name: str) -> str:
    """Return a text in the file that `opened` wrote."""
    text = ET.parse(folder / "crane.xml").find(f"custom/text[@name='{name}']")
    assert text is not None
    return text.get("data", "")


def accelerations_there_and_here(
    engine: tuple[Any, Any, Any], c: Crane, state: State, effort: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the accelerations of MuJoCo, and those of Pinocchio under efforts on the joints."""
    mujoco, model, data = engine
    data.qpos[:], data.qvel[:] = state
    mujoco.mj_forward(model, data)
    here = pin.aba(c.model, c.data, state.q, state.v, effort - c.damping * state.v)
    return data.qacc.copy(), here


def state_at_length(c: Crane, stretch: float = 0.0) -> State:
    """Return a moving state with the rope as long as at the start."""
    rng = np.random.default_rng(3)
    q = c.start.q + 0.1 * rng.normal(size=c.layout.n)
    length = c.layout.index("l")
    q[length] = c.start.q[length]
    if c.springs.rope is not None:
        q[c.springs.rope.stretch] = stretch
    return State(q, 0.3 * rng.normal(size=c.layout.n))


@pytest.mark.slow
def test_a_double_pendulum_with_a_solid_hook_moves_as_here(tmp_path: Path) -> None:
    c = load_crane(hook_mass=200.0, hook_inertia=20.0, damp_sling=3.0)
    state = state_at_length(c)
    there, here = accelerations_there_and_here(opened(tmp_path, c), c, state, np.zeros(c.layout.n))
    assert_allclose(there, here, rtol=0.0, atol=1e-12 * np.abs(here).max())  # rounding


@pytest.mark.slow
@pytest.mark.parametrize("stretch", [0.02, -0.02])
def test_a_rope_that_stretches_pulls_as_here_and_pushes_as_little(
    stretch: float, tmp_path: Path
) -> None:
    c = load_crane(rope_stiffness=1e7, rope_damping=500.0)
    state = state_at_length(c, stretch)
    rope = c.springs.rope
    assert rope is not None
    effort = c.springs.effort(state.q)
    # What the text in the file says is neglected: the derivative of EA s²/(2 l) by l.
    strain = max(stretch, 0.0) / state.q[rope.length]
    effort[rope.length] -= 0.5 * rope.stiffness * strain * strain
    engine = opened(tmp_path, c)
    there, here = accelerations_there_and_here(engine, c, state, effort)
    assert_allclose(there, here, rtol=0.0, atol=1e-12 * np.abs(here).max())  # rounding
    assert effort[rope.stretch] == pytest.approx(-1e7 / 15.0 * 0.02 if stretch > 0.0 else 0.0)
    validity = text_of(tmp_path, "validity")
    assert "EA/l = 666666.667 N/m of the length l = 15 m" in validity


def test_a_crane_with_a_rope_that_stretches_hangs_still_from_its_keyframe_on(
    tmp_path: Path,
) -> None:
    c = load_crane(rope_stiffness=1e7, rope_damping=500.0)
    mujoco, model, data = opened(tmp_path, c)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    start = data.qpos.copy()
    assert start.tolist() == c.start.q.tolist()
    mujoco.mj_step(model, data, 2000)
    # For 1 s the hoist falls by the force that is neglected, EA (s/l)²/2, on drum and load, half of
    # which swings: t² F / (2 m) bounds it, with the drum of 5000 kg alone.
    rope = c.springs.rope
    assert rope is not None
    strain = start[rope.stretch] / start[rope.length]
    assert np.abs(data.qpos - start).max() <= 0.5 * rope.stiffness * strain**2 / 2.0 / 5000.0


@pytest.mark.slow
def test_two_falls_resist_yaw_as_here_for_small_yaws(tmp_path: Path) -> None:
    c = load_crane(fall_spacing=1.0, hook_mass=200.0, hook_inertia=20.0)
    state = state_at_length(c)
    falls = c.springs.bifilar
    assert falls is not None
    effort = np.zeros(c.layout.n)
    # What the text in the file says: W a²/l, linear in the yaw, and no lift.
    weight = 1200.0 * c.gravity
    effort[falls.yaw] = -weight * 0.5**2 / 15.0 * state.q[falls.yaw]
    there, here = accelerations_there_and_here(opened(tmp_path, c), c, state, effort)
    assert_allclose(there, here, rtol=0.0, atol=1e-11 * np.abs(here).max())  # rounding


def moved_there_and_here(
    folder: Path,
    c: Crane,
    reference: Reference,
    start: State,
    duration: float,
    *,
    divide_by_length: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Return coordinates and rates at the control instants of a run under the hold controller in
    MuJoCo, and in a run here, shape (instants, 2 n) each.

    With `divide_by_length` the stiffness in MuJoCo is set from the present length of the rope at
    each control instant, as docs/howto/mujoco.md does.
    """
    mujoco, model, data = opened(folder, c)
    brake = hold_controller(c)
    data.qpos[:], data.qvel[:] = start
    there = []
    for i in range(round(duration / PERIOD) + 1):
        state = State(data.qpos.copy(), data.qvel.copy())
        there.append(np.concatenate(state))
        if divide_by_length:
            times_length = model.numeric("stiffness_times_length").data[0]
            stiffness = times_length / data.joint("hoist_joint").qpos[0]
            if c.springs.rope is not None:
                model.tendon_stiffness[0] = stiffness
            else:
                model.jnt_stiffness[model.joint("load_yaw_joint").id] = stiffness
        data.ctrl[:] = brake(i * PERIOD, state, reference(i * PERIOD))
        mujoco.mj_step(model, data, round(PERIOD / DT))
    run = simulate(
        c, brake, reference, start=start, duration=duration, engine="compiled", validity="mark"
    )
    return np.array(there), np.hstack([run.q, run.v])


def elastic() -> Crane:
    return load_crane(rope_stiffness=1e7, rope_damping=5000.0)


@pytest.mark.slow
def test_a_load_on_an_elastic_rope_swings_as_here_at_the_length_of_the_stiffness(
    tmp_path: Path,
) -> None:
    c = elastic()
    start = c.state(phi=0.1, theta=-0.05)
    there, here = moved_there_and_here(tmp_path, c, hold(c, start), start, 10.0)
    off = np.abs(there - here)[:, : c.layout.n].max(axis=0)
    # What is neglected, EA (s/l)²/2 = 4.8 N, moves the hoist in its controller of 3e4 N/m.
    hoist = c.layout.index("l")
    assert off[hoist] == pytest.approx(4.8 / 3e4, rel=0.1)
    # The pendulum is longer by as much: a share of 1e-5 of l, and half of it of the frequency,
    # which is a phase of 0.5e-5 · 0.8 rad/s · 10 s.
    assert off[c.swings].max() < 0.1 * 0.5e-5 * 0.8 * 10.0 * 2.0
    assert off[[0, 1]].max() < 1e-6


@pytest.mark.long
def test_at_another_length_an_elastic_rope_stretches_too_much_by_the_ratio_of_the_lengths(
    tmp_path: Path,
) -> None:
    c = elastic()
    start = c.state(phi=0.1, theta=-0.05)
    # From 15 m, for which the stiffness is, to 8 m.
    hoisting = ramp(c, hold(c, start), "l", -7.0, rate=0.5, at=1.0)
    stretch = c.springs.rope.stretch
    off = {}
    for divide in (False, True):
        folder = tmp_path / str(divide)
        folder.mkdir()
        there, here = moved_there_and_here(
            folder, c, hoisting, start, 20.0, divide_by_length=divide
        )
        ratio = there[-1, stretch] / here[-1, stretch]
        # 3e-4: what the load still swings, which pulls at the rope with φ² of its weight
        assert ratio == pytest.approx(1.0 if divide else 15.0 / 8.0, rel=3e-4)
        off[divide] = np.abs(there - here)[:, c.swings].max()
    # The swing of 0.1 rad is right within 0.6 mrad with the fixed stiffness,
    # and within 0.03 mrad with the stiffness of the present length.
    assert off[False] < 0.6e-3
    assert off[True] < 0.03e-3


@pytest.mark.long
def test_at_another_length_two_falls_yaw_too_slowly_by_the_root_of_the_ratio_of_the_lengths(
    tmp_path: Path,
) -> None:
    c = load_crane(fall_spacing=1.0, payload_inertia=200.0)
    yaw = c.layout.index("load_yaw")
    start = c.state(l=8.0, load_yaw=0.02)
    period = {}
    for divide in (False, True):
        folder = tmp_path / str(divide)
        folder.mkdir()
        there, here = moved_there_and_here(
            folder, c, hold(c, start), start, 25.0, divide_by_length=divide
        )
        period[divide] = yaw_period(there[:, yaw])
        if divide:
            # A yaw of 0.02 rad is slower by 0.02²/16 than in the linear law.
            assert period[divide] == pytest.approx(yaw_period(here[:, yaw]), rel=1e-4)
    # A closed form: ω² = W a²/(l I), with a = 0.5 m.
    weight = 1000.0 * c.gravity
    exact = 2.0 * math.pi * math.sqrt(200.0 * 8.0 / (weight * 0.25))
    # The slew yields to the yaw by a share of about the inertia of the load in that of the crane.
    assert period[True] == pytest.approx(exact, rel=2e-3)
    assert period[False] / period[True] == pytest.approx(math.sqrt(15.0 / 8.0), rel=1e-3)


def yaw_period(yaw: np.ndarray) -> float:
    """Return the mean time between the upward zero crossings of a yaw [s]."""
    before = np.flatnonzero((yaw[:-1] < 0.0) & (yaw[1:] >= 0.0))
    crossings = before + yaw[before] / (yaw[before] - yaw[before + 1])
    return float(PERIOD * (crossings[-1] - crossings[0]) / (len(crossings) - 1))


@pytest.mark.slow
def test_an_inextensible_rope_hangs_goes_slack_and_catches_its_load_as_here(
    tmp_path: Path,
) -> None:
    c = load_crane(rope_stiffness=math.inf)
    stretch = c.springs.rope.stretch
    mujoco, model, data = opened(tmp_path, c)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, 4000)
    assert "by about 4e-10 s² times gravity" in text_of(tmp_path, "validity")
    assert 0.5 * 4e-10 < data.qpos[stretch] / c.gravity < 2.0 * 4e-10

    # The load is lifted by 0.3 m and falls into the rope, which shakes the hoist.
    start = c.start._replace(q=c.start.q.copy())
    start.q[stretch] = -0.3
    (tmp_path / "fall").mkdir()
    there, here = moved_there_and_here(tmp_path / "fall", c, hold(c, start), start, 3.0)
    # It hangs loose for √(2 0.3 m/g) = 0.247 s; the drum takes in rope meanwhile.
    loose = (there[:, stretch] < -1e-3).sum() * PERIOD
    assert loose == pytest.approx((here[:, stretch] < -1e-3).sum() * PERIOD, abs=PERIOD)
    assert there[:, stretch].max() < 2e-3
    # The speed of the catch, 2.4 m/s, for a step of 0.5 ms, which is when MuJoCo notices it.
    assert np.abs(there - here)[:, c.layout.index("l")].max() < 2.4 * DT
    assert there[-1, stretch] < 1e-8

    # Nobody reads it back as a load that falls freely within the range of a joint.
    with pytest.raises(ModelError, match="the tendon rope exerts forces"):
        load_crane(tmp_path / "crane.xml")


DAMPED_FALLS = {"fall_spacing": 1.0, "payload_inertia": 200.0, "damp_yaw": 20.0}

MOVES: list[tuple[dict[str, float], bool, float, float, float]] = [
    ({"hook_mass": 200.0}, False, 0.02, 0.0, 0.0),
    ({"rope_stiffness": math.inf}, False, 1e-4, 2e-3, 0.0),
    ({"rope_stiffness": 1e7, "rope_damping": 5000.0}, False, 0.1, 5.0, 0.0),
    ({"rope_stiffness": 1e7, "rope_damping": 5000.0}, True, 0.006, 2e-3, 0.0),
    (DAMPED_FALLS, False, 0.02, 0.0, 30.0),
    (DAMPED_FALLS, True, 1e-4, 0.0, 0.1),
]
"""Arguments of a crane, whether its loop divides by the present length, and the largest errors of
the swings [mrad], the stretch [mm] and the yaw [mrad], as docs/howto/mujoco.md states them."""


@pytest.mark.long
@pytest.mark.parametrize(("values", "divide", "swing", "stretch", "yaw"), MOVES)
def test_a_combined_move_differs_from_that_here_by_no_more_than_the_page_says(
    values: dict[str, float],
    divide: bool,
    swing: float,
    stretch: float,
    yaw: float,
    tmp_path: Path,
) -> None:
    c = load_crane(**values)  # type: ignore[arg-type]
    start = c.state(phi=0.1, theta=-0.05)
    reference = ramp(c, hold(c, start), "gamma", 0.5, rate=0.1, at=1.0)
    reference = ramp(c, reference, "x", 4.0, rate=0.5, at=2.0)
    reference = ramp(c, reference, "l", -5.0, rate=0.4, at=3.0)
    there, here = moved_there_and_here(tmp_path, c, reference, start, 20.0, divide_by_length=divide)
    off = 1e3 * np.abs(there - here)[:, : c.layout.n].max(axis=0)
    assert off[c.swings].max() <= swing
    if c.springs.rope is not None:
        assert off[c.springs.rope.stretch] <= stretch
    if c.springs.bifilar is not None:
        assert off[c.springs.bifilar.yaw] <= yaw


@pytest.mark.slow
def test_a_hook_block_that_is_a_point_is_a_ball_of_steel_and_says_so(tmp_path: Path) -> None:
    point = load_crane(hook_mass=200.0)
    _, model, _ = opened(tmp_path, point)
    # A solid ball of 7850 kg/m³: V = m/ρ = 4/3 π r³, and 2/5 m r².
    radius = (200.0 / 7850.0 * 3.0 / 4.0 / math.pi) ** (1.0 / 3.0)
    inertia = 0.4 * 200.0 * radius**2
    assert_allclose(model.body("hook_link").inertia, inertia, rtol=1e-12)
    notes = text_of(tmp_path, "notes")
    assert "The link hook_link of 200 kg is a point in the crane." in notes
    assert "0.1825 m" in notes
    assert "2.666 kg m²" in notes

    # The motion is that of the crane whose hook has this inertia.
    robot = ET.fromstring(point.urdf)
    moments = robot.find("link[@name='hook_link']/inertial/inertia")
    assert moments is not None
    for moment in ("ixx", "iyy", "izz"):
        moments.set(moment, repr(inertia))
    (tmp_path / "solid.urdf").write_bytes(ET.tostring(robot))
    solid = load_crane(tmp_path / "solid.urdf")
    (tmp_path / "run").mkdir()
    start = point.state(phi=0.1, theta=-0.05)
    there, _ = moved_there_and_here(tmp_path / "run", point, hold(point, start), start, 5.0)
    run = quickly(solid, hold_controller(solid), hold(solid, start), start=start, duration=5.0)
    # rounding, which the double pendulum multiplies
    assert np.abs(there - np.hstack([run.q, run.v])).max() < 1e-10


@pytest.mark.slow
@pytest.mark.parametrize(
    "values", [{"tower_bend_stiffness": 1e8}, {"jib_bend_stiffness": 1e8}, {"lug_height": 1.0}]
)
def test_links_without_mass_that_have_a_visual_move_as_here(
    values: dict[str, Any], tmp_path: Path
) -> None:
    c = load_crane(**values)
    state = state_at_length(c)
    effort = c.springs.effort(state.q)
    there, here = accelerations_there_and_here(opened(tmp_path, c), c, state, effort)
    # The light bodies weigh 1e-5 kg, beside a load of 1000 kg.
    assert_allclose(there, here, rtol=0.0, atol=1e-7 * np.abs(here).max())


TURNED = """<robot name="turned"><link name="world"/>
<link name="between"/>
<link name="load"><inertial><origin xyz="0.1 0.2 -1"/><mass value="3"/>
<inertia ixx="0.2" iyy="0.3" izz="0.25" ixy="0.01" ixz="0" iyz="0"/></inertial></link>
<joint name="first" type="revolute"><parent link="world"/><child link="between"/>
<origin xyz="1 2 3" rpy="0.3 0.4 0.5"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="10" velocity="2"/></joint>
<joint name="second" type="prismatic"><parent link="between"/><child link="load"/>
<origin xyz="0.3 -0.2 0.5" rpy="-0.7 0.2 0.9"/><axis xyz="0.6 0 0.8"/>
<limit lower="-2" upper="2" effort="10" velocity="3"/></joint></robot>"""
"""A link without mass between two joints whose frames are turned and apart."""


def test_a_link_without_mass_is_one_body_with_the_next_and_moves_as_here(tmp_path: Path) -> None:
    (tmp_path / "turned.urdf").write_text(TURNED)
    c = load_crane(tmp_path / "turned.urdf", driven=["second"])
    engine = opened(tmp_path, c)
    _, model, data = engine
    assert [model.joint(i).name for i in range(model.njnt)] == ["first", "second"]
    assert model.nbody == 2
    for seed in range(5):
        rng = np.random.default_rng(seed)
        state = State(rng.uniform(-1.5, 1.5, size=2), rng.normal(size=2))
        there, here = accelerations_there_and_here(engine, c, state, np.zeros(2))
        assert_allclose(there, here, rtol=0.0, atol=1e-12 * np.abs(here).max())  # rounding
        load = pin.Data(c.model)
        pin.forwardKinematics(c.model, load, state.q)
        assert_allclose(data.body("load").xpos, load.oMi[2].translation, atol=1e-12)
    assert model.numeric("second_rate_limit").data.tolist() == [3.0]


@pytest.mark.slow
def test_dry_friction_is_written_and_read_again(tmp_path: Path) -> None:
    text = crane().urdf.replace('<dynamics damping="0.0"/>', '<dynamics friction="70"/>', 1)
    (tmp_path / "dry.urdf").write_text(text, encoding="utf-8")
    dry = load_crane(tmp_path / "dry.urdf")
    assert dry.friction is not None
    again = load_crane(mjcf_file.export(tmp_path / "dry.xml", dry))
    assert again.friction is not None
    assert again.friction.joints == dry.friction.joints
    assert again.friction.effort.tolist() == dry.friction.effort.tolist() == [70.0]
