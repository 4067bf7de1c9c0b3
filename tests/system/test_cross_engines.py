"""Other programs read what we write, and two of them agree on the numbers."""

from __future__ import annotations

import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from numpy.testing import assert_allclose

from benchmarks.contestants.mujoco import twin
from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics import equations_of_motion as dynamics
from cranedyn.interfaces import Reference, State
from cranedyn.model.crane import Crane
from cranedyn.references import hold, ramp
from cranedyn.simulation.simulate import simulate
from tests.helpers import G, crane, efforts, states, turned

DAMPING = {"damp_slew": 3e4, "damp_trolley": 200.0, "damp_swing": 5e3, "damp_hoist": 700.0}


@pytest.fixture(scope="module")
def urdf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("urdf") / "crane.urdf"
    path.write_text(crane(**DAMPING).urdf)
    return path


@pytest.mark.slow
def test_check_urdf_accepts_it(urdf: Path) -> None:
    program = Path(sys.executable).with_name("check_urdf")
    if not program.exists():
        pytest.skip("check_urdf is not beside this Python")
    run = subprocess.run([program, urdf], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert "robot name is: tower_crane" in run.stdout
    assert run.stderr == ""


@pytest.mark.slow
def test_yourdfpy_puts_the_load_where_we_do(urdf: Path) -> None:
    yourdfpy = pytest.importorskip("yourdfpy")
    robot = yourdfpy.URDF.load(str(urdf), load_meshes=False)
    assert list(robot.actuated_joint_names) == [joint.name for joint in crane().layout.joints]
    assert robot.validate()

    @given(states)
    def same_place(state: State) -> None:
        robot.update_cfg(state.q)
        expected = robot.get_transform("hook_link", "world")[:3, 3]
        # rounding.
        assert_allclose(dynamics.payload_position(crane(), state.q), expected, atol=1e-12)

    same_place()


@pytest.mark.slow
def test_the_visuals_show_a_crane_of_its_measures(urdf: Path) -> None:
    yourdfpy = pytest.importorskip("yourdfpy")
    robot = yourdfpy.URDF.load(str(urdf))
    low, high = robot.scene.bounds
    assert low[2] >= -0.5
    # Total height, plus half the thickness of a bar.
    assert high[2] == pytest.approx(33.45, abs=0.5)
    assert -25.0 < low[1] < -22.0  # the jib reaches along -Y beyond the largest trolley radius
    assert high[1] > 5.0  # counter-jib


# --- MuJoCo ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def engine(urdf: Path) -> Any:
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(urdf))
    model.opt.gravity[:] = [0.0, 0.0, -G]
    return mujoco, model, mujoco.MjData(model)


def test_mujoco_has_the_same_accelerations_with_damping(engine: Any) -> None:
    mujoco, model, data = engine
    c = crane(**DAMPING)
    # Joint ranges: a state near one must not be pushed back.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT

    @given(states, efforts)
    def same(state: State, effort: np.ndarray) -> None:
        data.qpos[:], data.qvel[:] = state
        data.qfrc_applied[:] = dynamics.over_all_joints(crane(), effort)
        mujoco.mj_forward(model, data)
        # Rounding, light trolley.
        assert_allclose(dynamics.acceleration(c, state, effort), data.qacc, atol=1e-10, rtol=1e-9)

    same()


DT = 5e-4
PERIOD = 5e-3


@cache
def combined_move(**damping: float) -> tuple[Crane, Reference, Trajectory]:
    """Slew by 69°, trolley out by 6 m and hoist by 6 m, all together, with a load that swings from
    the start; and what was wanted.
    """
    c = crane(**damping)
    start = c.state(phi=0.3, theta=-0.2)
    law = hold_controller(c, gravity=G)
    reference = ramp(c, hold(c, start), "gamma", 1.2, rate=0.1, at=1.0)
    reference = ramp(c, ramp(c, reference, "x", 6.0, rate=0.5, at=2.0), "l", -6.0, rate=0.4, at=3.0)
    clock = dict(duration=30.0, dt=DT, control_period=PERIOD)
    return c, reference, simulate(c, law, reference, start=start, **clock)


def _apart(urdf: str, loop: str, *, implicit: bool = False, **damping: float) -> float:
    """Return the largest difference of any coordinate or rate [rad, m, per second] between the
    combined move and that of a URDF in MuJoCo, under the recorded efforts or in a loop of its own.
    """
    mujoco = pytest.importorskip("mujoco")
    c, reference, run = combined_move(**damping)
    model = twin(urdf, gravity=G, dt=DT)
    law = hold_controller(c, gravity=G)
    if implicit:
        model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = run.state(0)
    apart = 0.0
    for k, t in enumerate(run.t):
        state = State(data.qpos.copy(), data.qvel.copy())
        apart = max(apart, *np.abs(state.q - run.q[k]), *np.abs(state.v - run.v[k]))
        effort = run.effort[k] if loop == "recorded" else law(t, state, reference(t))
        data.qfrc_applied[:] = dynamics.over_all_joints(c, effort)
        mujoco.mj_step(model, data, round(PERIOD / DT))
    return apart


@pytest.mark.slow
@pytest.mark.parametrize("damping", [{"damp_swing": 0.0}, DAMPING], ids=["undamped", "damped"])
@pytest.mark.parametrize(("loop", "allowed"), [("recorded", 2e-11), ("own", 2e-13)])
def test_mujoco_makes_the_same_combined_move_of_30_s(
    loop: str, allowed: float, damping: dict[str, float]
) -> None:
    """The rule is the same, so there is rounding only. A push of 1e-15 g all the time would move a
    free drive by ½ 1e-15 g (30 s)² = 4e-12 m, and a load on 15 m that a loop holds by 1e-15 l =
    2e-14 m.
    """
    c, _, run = combined_move(**damping)
    assert (np.ptp(run.q, axis=0) > [1.2, 6.0, 0.3, 0.2, 6.0]).all()
    assert run.effort.tolist() == run.command.tolist()
    assert _apart(c.urdf, loop, **damping) < allowed


@pytest.mark.slow
@pytest.mark.parametrize("loop", ["recorded", "own"])
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('damping="30000.0"', 'damping="30003.0"'),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 -1 0"/>'),
        ('<mass value="1000.0"/>', '<mass value="1000.1"/>'),
    ],
    ids=["slew damping", "sign of the tangential swing", "payload mass"],
)
def test_a_crane_that_differs_by_a_ten_thousandth_or_a_sign_makes_another_move(
    old: str, new: str, loop: str
) -> None:
    c, *_ = combined_move(**DAMPING)
    # Four orders above what is allowed.
    assert _apart(turned(old, new, c.urdf), loop, **DAMPING) > 1e-7


@pytest.mark.slow
def test_damping_taken_at_the_end_of_the_step_makes_another_move() -> None:
    c, *_ = combined_move(**DAMPING)
    assert 1e-6 < _apart(c.urdf, "recorded", implicit=True, **DAMPING) < 1e-2  # of order dt
