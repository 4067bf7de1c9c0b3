"""Other programs read what we write, and two of them agree on the numbers."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from numpy.testing import assert_allclose

from benchmarks.contestants.mujoco import twin
from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics import pinocchio as dynamics
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
    assert list(robot.actuated_joint_names) == [joint.name for joint in crane().layout.joints]
    assert robot.validate()

    @given(states)
    def same_place(state: State) -> None:
        robot.update_cfg(state.q)
        expected = robot.get_transform("hook_link", "world")[:3, 3]
        # rounding.
        assert_allclose(dynamics.payload_position(crane(), state.q), expected, atol=1e-12)

    same_place()


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


def test_mujoco_has_the_same_joints_in_the_same_order(engine: Any) -> None:
    _, model, _ = engine
    assert [model.joint(i).name for i in range(model.njnt)] == [
        joint.name for joint in crane().layout.joints
    ]
    assert model.dof_damping.tolist() == crane(**DAMPING).damping.tolist()
    assert_allclose(model.jnt_range, np.stack([crane().lower, crane().upper], axis=1))


def test_mujoco_has_the_same_mass_matrix_and_the_same_bias(engine: Any) -> None:
    mujoco, model, data = engine
    c = crane(**DAMPING)
    matrix = np.zeros((5, 5))

    @settings(max_examples=1000)
    @given(states)
    def same(state: State) -> None:
        data.qpos[:], data.qvel[:] = state
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, matrix)
        inertia = np.sqrt(np.diag(matrix))
        # rounding of a few dozen products. No entry exceeds √(M_ii M_jj), and the payload's weight
        # m g moves joint i by √(m M_ii) g at most
        assert (
            np.abs(pin.crba(c.model, c.data, state.q) - matrix)
            <= 1e-13 * np.outer(inertia, inertia)
        ).all()
        bias = pin.nonLinearEffects(c.model, c.data, *state)
        assert (
            np.abs(bias - data.qfrc_bias) <= 1e-13 * math.sqrt(c.payload_mass) * G * inertia
        ).all()

    same()


def test_mujoco_has_the_same_accelerations_with_damping(engine: Any) -> None:
    mujoco, model, data = engine
    c = crane(**DAMPING)
    # Joint ranges: a state near one must not be pushed back.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT

    @given(states, efforts)
    def same(state: State, effort: np.ndarray) -> None:
        data.qpos[:], data.qvel[:] = state
        data.qfrc_applied[:] = dynamics.full(crane(), effort)
        mujoco.mj_forward(model, data)
        # Rounding, light trolley.
        assert_allclose(dynamics.acceleration(c, state, effort), data.qacc, atol=1e-10, rtol=1e-9)

    same()


class Twin:
    """A URDF in MuJoCo, stepped as `simulate` steps."""

    def __init__(self, urdf: str) -> None:
        self.mujoco = pytest.importorskip("mujoco")
        self.model = twin(urdf, gravity=G, dt=DT)
        self.data = self.mujoco.MjData(self.model)

    def run(self, effort: Callable[[int, State], np.ndarray], like: Trajectory) -> np.ndarray:
        """Coordinates and rates, shape (n, 10), from the start of another run on, with efforts held
        over the same control periods.
        """
        self.mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = like.state(0)
        rows = []
        for k in range(len(like)):
            state = State(self.data.qpos.copy(), self.data.qvel.copy())
            rows.append(np.concatenate(state))
            self.data.qfrc_applied[:] = dynamics.full(crane(), effort(k, state))
            self.mujoco.mj_step(self.model, self.data, round(PERIOD / DT))
        return np.array(rows)


DT, PERIOD = 5e-4, 5e-3


@cache
def combined_move(**damping: float) -> tuple[Crane, Reference, Trajectory]:
    """Slew by 69°, trolley out by 6 m and hoist by 6 m, all together, with a load that swings from
    the start; and what was wanted.
    """
    c = crane(**damping)
    start = c.state(phi=0.3, theta=-0.2)
    reference = ramp(c, hold(c, start), "gamma", 1.2, rate=0.1, at=1.0)
    reference = ramp(c, ramp(c, reference, "x", 6.0, rate=0.5, at=2.0), "l", -6.0, rate=0.4, at=3.0)
    return (
        c,
        reference,
        simulate(
            c,
            hold_controller(c, gravity=G),
            reference,
            start=start,
            duration=30.0,
            dt=DT,
            control_period=PERIOD,
        ),
    )


def _apart(rows: np.ndarray, run: Trajectory) -> float:
    """The largest difference of any coordinate or rate [rad, m, per second]."""
    return float(np.abs(rows - np.hstack([run.q, run.v])).max())


@pytest.mark.parametrize("damping", [{"damp_swing": 0.0}, DAMPING], ids=["undamped", "damped"])
def test_mujoco_makes_the_same_combined_move_of_30_s_under_the_recorded_efforts(
    damping: dict[str, float],
) -> None:
    c, _, run = combined_move(**damping)
    assert (np.ptp(run.q, axis=0) > [1.2, 6.0, 0.3, 0.2, 6.0]).all()
    assert run.effort.tolist() == run.command.tolist()
    # the rule is the same, so rounding only: a push of 1e-15 g all the time would move a free drive
    # by ½ 1e-15 g (30 s)² = 4e-12 m
    assert _apart(Twin(c.urdf).run(lambda k, state: run.effort[k], run), run) < 2e-11


@pytest.mark.parametrize("damping", [{"damp_swing": 0.0}, DAMPING], ids=["undamped", "damped"])
def test_mujoco_makes_the_same_combined_move_of_30_s_in_a_loop_of_its_own(
    damping: dict[str, float],
) -> None:
    c, reference, run = combined_move(**damping)
    brake = hold_controller(c, gravity=G)
    # rounding, which the loop holds: a push of 1e-15 g all the time would move a load on 15 m by
    # 1e-15 l = 2e-14 m; ten times that
    assert (
        _apart(
            Twin(c.urdf).run(lambda k, state: brake(run.t[k], state, reference(run.t[k])), run), run
        )
        < 2e-13
    )


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
    old: str, new: str
) -> None:
    c, reference, run = combined_move(**DAMPING)
    brake = hold_controller(c, gravity=G)
    other = Twin(turned(old, new, c.urdf))
    # Four orders above what is allowed.
    assert _apart(other.run(lambda k, state: run.effort[k], run), run) > 1e-7
    assert (
        _apart(other.run(lambda k, state: brake(run.t[k], state, reference(run.t[k])), run), run)
        > 1e-7
    )


def test_damping_taken_at_the_end_of_the_step_makes_another_move() -> None:
    c, _, run = combined_move(**DAMPING)
    other = Twin(c.urdf)
    other.model.opt.disableflags &= ~int(other.mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    assert 1e-6 < _apart(other.run(lambda k, state: run.effort[k], run), run) < 1e-2  # of order dt
