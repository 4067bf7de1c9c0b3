"""The brake and the follower: the commands they give."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from numpy.testing import assert_allclose

from cranedyn.compiled.horizon.receding import receding
from cranedyn.controllers import Hold, follow, hold_controller, lqr, paper_controller
from cranedyn.controllers.hold import DAMPING, STIFFNESS
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.controllers.tracking import Tracking
from cranedyn.controllers.velocity_command import as_velocity_command
from cranedyn.estimation import mpc, with_load_estimate, with_observer, with_sensor_model
from cranedyn.interfaces import Controller, EngineName, Setpoint, State
from cranedyn.model.load import load_crane
from cranedyn.references import hanging_reference, hold, ramp, spline
from cranedyn.references.limits import Limits
from cranedyn.simulation.simulate import simulate
from tests.helpers import FAST, crane, states
from tests.model.test_locked import JOINT, LINK
from tests.model.test_mimics import MIMIC

STILL = Setpoint(np.array([0.1, 11.0, 14.0]), np.zeros(3), np.zeros(3))


def test_hold_pushes_towards_what_is_setpoint_against_the_velocity_and_carries_the_load() -> None:
    stiffness = np.array([10.0, 20.0, 30.0])
    damping = np.array([1.0, 2.0, 3.0])
    feed_forward = np.array([0.0, 0.0, -500.0])
    brake = Hold(crane(), stiffness, damping, feed_forward)
    state = State(np.array([0.0, 10.0, 0.3, -0.2, 15.0]), np.array([0.5, -0.25, 9.0, 9.0, 2.0]))
    # slew 10·0.1 - 0.5, trolley 20·1 + 2·0.25, hoist -500 - 30·1 - 3·2, whatever rates are asked
    moving = STILL._replace(velocity=np.ones(3), acceleration=np.ones(3))
    assert_allclose(brake(7.0, state, moving), [0.5, 20.5, -536.0], rtol=1e-14)  # rounding


@given(states)
def test_hold_does_not_see_the_swing(state: State) -> None:
    brake = hold_controller(crane())
    q = state.q.copy()
    v = state.v.copy()
    q[2:4] = 0.0
    v[2:4] = 0.0
    assert brake(0.0, state, STILL).tolist() == brake(0.0, State(q, v), STILL).tolist()


def test_the_published_gain_is_the_default_and_the_weight_is_fed_forward() -> None:
    assert list(STIFFNESS) == list(DAMPING) == [joint.role for joint in crane().layout.driven]
    assert STIFFNESS["trolley"] == 3.0e5
    brake = hold_controller(crane(payload_mass=2000))
    assert brake.stiffness.tolist() == list(STIFFNESS.values())
    assert brake.damping.tolist() == list(DAMPING.values())
    assert brake.feed_forward.tolist() == [0.0, 0.0, -2000 * crane().gravity]
    assert hold_controller(crane(), gravity=9.8).feed_forward[2] == -9800.0


def test_a_drive_feeds_forward_the_weight_on_the_joints_that_follow_it(tmp_path: Path) -> None:
    """A mast of two sections, of which the upper one rises half as far again as the lower one."""
    follower = MIMIC.format("rise", 0.5, 0.0)
    links = (("s1", 200), ("s2", 100), ("load", 50))
    mast = (
        '<robot name="mast"><link name="truck"/>'
        + "".join(LINK.format(*link) for link in links)
        + JOINT.format("rise", "prismatic", "truck", "s1", "0 0 1", "")
        + JOINT.format("rise2", "prismatic", "s1", "s2", "0 0 1", follower)
        + JOINT.format("swing", "revolute", "s2", "load", "0 1 0", "")
        + "</robot>"
    )
    path = tmp_path / "mast.urdf"
    path.write_text(mast.replace('rpy="0.1 0.2 0"', 'rpy="0 0 0"'), encoding="utf-8")
    lifted = load_crane(path, driven=["rise"], payload="swing")
    weight = (200.0 + 1.5 * (100.0 + 50.0)) * lifted.gravity
    assert_allclose(hold_controller(lifted).feed_forward, [weight], rtol=1e-12)


def test_one_gain_can_be_changed_alone() -> None:
    brake = hold_controller(crane(), stiffness=(1.0, 2.0, 3.0))
    assert brake.stiffness.tolist() == [1.0, 2.0, 3.0]
    assert brake.damping.tolist() == list(DAMPING.values())


@pytest.mark.parametrize("period", [5e-3, 0.1])
def test_follow_reaches_the_velocity_that_is_setpoint_one_period_later(period: float) -> None:
    start = crane().state(x_dot=0.2, gamma_dot=-0.1)
    outward = ramp(crane(), hold(crane(), start), "x", 5.0, rate=0.8, at=1.0)
    reference = ramp(crane(), outward, "l", -2.0, rate=0.5, at=1.0)
    drives = follow(crane(), reference, period)
    for t in (0.5, 1.0 - period / 2, 2.0):
        reached = start.v[crane().layout.drives] + period * drives(t, start, reference(t))
        assert_allclose(reached, reference(t + period).velocity, atol=1e-15)  # rounding


def test_tracking_goes_by_its_first_row_before_it_begins_and_by_its_last_when_it_is_over() -> None:
    rows = np.arange(12.0).reshape(4, 3)
    tracking = Tracking(0.5, rows, np.zeros((4, 3, 10)), np.zeros((4, 10)))
    times = np.array([-7.0, -0.5, 0.0, 0.5, 1.5, 9.0])
    commands = [tracking(t, crane().start, STILL) for t in times]
    assert_allclose(commands, rows[[0, 0, 0, 1, 3, 3]])
    form = tracking.affine(times, np.zeros((6, 3)))
    assert_allclose(form.feed_forward[np.minimum(range(6), len(form.feed_forward) - 1)], commands)


@pytest.mark.parametrize("period", [0.2, 0.25, 0.5, 0.75])
def test_between_rows_tracking_goes_on_straight_lines(period: float) -> None:
    rng = np.random.default_rng(1)
    row_times = 0.5 * np.arange(5)
    feed_forward_rows = rng.normal(size=(5, 3))
    gain_rows = rng.normal(size=(5, 3, 10))
    setpoint_rows = rng.normal(size=(5, 10))
    tracking = Tracking(0.5, feed_forward_rows, gain_rows, setpoint_rows)
    state = State(*rng.normal(size=(2, 5)))
    times = period * np.arange(-2, 15)

    def between(rows: np.ndarray) -> np.ndarray:
        """Interpolate each number of the rows by itself."""
        columns = [np.interp(times, row_times, column) for column in rows.reshape(5, -1).T]
        return np.stack(columns, axis=1).reshape(len(times), *rows.shape[1:])

    feed_forward = between(feed_forward_rows)
    gain = between(gain_rows)
    setpoint = between(setpoint_rows)

    commands = np.array([tracking(t, state, STILL) for t in times.tolist()])
    form = tracking.affine(times, np.zeros((len(times), 3)))

    deviation = np.concatenate(state) - setpoint
    expected = feed_forward - np.einsum("tij,tj->ti", gain, deviation)
    assert_allclose(commands, expected, atol=1e-13)  # rounding
    # The last row of the affine form holds for all later times.
    rows = np.minimum(np.arange(len(times)), len(form.feed_forward) - 1)
    assert_allclose(form.feed_forward[rows], feed_forward, atol=1e-13)
    assert_allclose(form.gain[rows], gain, atol=1e-13)
    assert_allclose(form.setpoint[rows], setpoint, atol=1e-13)


def test_a_row_that_is_met_is_that_row_whatever_the_next_one_holds() -> None:
    rows = np.array([[0.0] * 3, [0.1, 0.2, 0.3], [np.nan] * 3])
    tracking = Tracking(5e-3, rows, np.zeros((3, 3, 10)), np.zeros((3, 10)))
    command = tracking(0.005 + 1e-15, crane().start, STILL)
    assert command.tolist() == rows[1].tolist()
    form = tracking.affine(np.array([0.0, 0.005 - 1e-15]), np.zeros((2, 3)))
    assert form.feed_forward[1].tolist() == rows[1].tolist()


def _integral() -> HoistIntegral:
    return HoistIntegral(
        crane(),
        Tracking(5e-3, np.zeros((1, 3)), np.zeros((1, 3, 10)), np.zeros((1, 10))),
        1e-9,
        1.0,
    )


def _asked(integral: HoistIntegral) -> Controller:
    """The same behind a function, which is not told how the run is divided."""
    return lambda t, state, setpoint: integral(t, state, setpoint)


@pytest.mark.parametrize("period", [2.5e-3, 5e-3, 0.02])
@pytest.mark.parametrize("engine", ["pinocchio", FAST])
def test_an_integrator_goes_by_the_period_of_its_loop(period: float, engine: EngineName) -> None:
    c = crane()
    # Where it stays: the drives accelerate by 1e-9 of the integral.
    away = c.state(l=c.start.q[c.layout.index("l")] - 0.5)
    told = _integral()
    asked = _integral()
    for controller in (told, _asked(asked)):
        how = {"control_period": period, "engine": engine, "drive": "motion"}
        simulate(c, controller, hold(c, c.start), start=away, t_start=3.0, duration=1.0, **how)
    assert told.integral == pytest.approx(0.5 * (1.0 + period), rel=1e-8)  # both ends count
    # The first instant as a row of its table.
    assert asked.integral == pytest.approx(0.5 * (1.0 + 5e-3), rel=1e-8)


def test_where_time_begins_anew_an_integrator_goes_on_as_before() -> None:
    integral = _integral()
    away = crane().state(l=14.5)
    reference = STILL._replace(position=np.array([0.0, 10.0, 15.0]))
    for t in (0.0, 0.02, 0.04, 0.0, 0.02):
        integral(t, away, reference)
    assert integral.integral == pytest.approx(0.5 * (5e-3 + 4 * 0.02), rel=1e-9)


@pytest.mark.slow
def test_a_controller_shows_itself_in_a_line() -> None:
    way = hanging_reference(
        crane(), spline(crane(), crane().state(l=20), [(0.1, 11, 20)], [5.0]), 5.0
    )
    tracking = lqr(crane(), way)
    for controller in (
        hold_controller(crane()),
        follow(crane(), hold(crane(), crane().start)),
        paper_controller(crane(), way),
        tracking,
        mpc(crane(), way),
        with_observer(tracking, crane(), way),
        with_sensor_model(crane(), tracking, rng=np.random.default_rng(0)),
        with_load_estimate(tracking, crane(), way),
        as_velocity_command(crane(), tracking, drive="motion"),
        receding(crane(), Limits([0.1, 0.5, 0.5], [0.05, 0.3, 0.3])),
    ):
        shown = repr(controller)
        assert "\n" not in shown
        assert len(shown) < 1200, shown
