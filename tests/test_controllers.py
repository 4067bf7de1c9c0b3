"""The brake and the follower: the commands they give."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from numpy.testing import assert_allclose

from cranedyn.controllers import Hold, follow, hold_controller
from cranedyn.controllers.hold import DAMPING, STIFFNESS
from cranedyn.controllers.tracking import Tracking
from cranedyn.crane import State
from cranedyn.references import Wanted, hold, ramp
from tests.helpers import crane, states

STILL = Wanted(np.array([0.1, 11.0, 14.0]), np.zeros(3), np.zeros(3))


def test_hold_pushes_towards_what_is_wanted_against_the_velocity_and_carries_the_load() -> None:
    brake = Hold(np.array([10.0, 20.0, 30.0]), np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.0, -500.0]))
    state = State(np.array([0.0, 10.0, 0.3, -0.2, 15.0]), np.array([0.5, -0.25, 9.0, 9.0, 2.0]))
    # slew 10·0.1 - 0.5, trolley 20·1 + 2·0.25, hoist -500 - 30·1 - 3·2
    assert_allclose(brake(7.0, state, STILL), [0.5, 20.5, -536.0], rtol=1e-14)  # rounding


@given(states)
def test_hold_does_not_see_the_swing(state: State) -> None:
    brake = hold_controller(crane())
    q, v = state.q.copy(), state.v.copy()
    q[2:4], v[2:4] = 0.0, 0.0
    assert brake(0.0, state, STILL).tolist() == brake(0.0, State(q, v), STILL).tolist()


def test_the_velocity_of_the_reference_does_not_enter() -> None:
    brake = hold_controller(crane())
    running = STILL._replace(velocity=np.ones(3), acceleration=np.ones(3))
    assert brake(0.0, crane().start, running).tolist() == brake(0.0, crane().start, STILL).tolist()


def test_the_published_gain_is_the_default_and_the_weight_is_fed_forward() -> None:
    assert STIFFNESS[1] == 3.0e5
    brake = hold_controller(crane(payload_mass=2000))
    assert brake.stiffness.tolist() == list(STIFFNESS)
    assert brake.damping.tolist() == list(DAMPING)
    # it believes in standard gravity, whatever the world has
    assert brake.feed_forward.tolist() == [0.0, 0.0, -2000 * 9.80665]
    assert hold_controller(crane(), gravity=9.8).feed_forward[2] == -9800.0


def test_one_gain_can_be_changed_alone() -> None:
    brake = hold_controller(crane(), stiffness=(1.0, 2.0, 3.0))
    assert brake.stiffness.tolist() == [1.0, 2.0, 3.0]
    assert brake.damping.tolist() == list(DAMPING)


@pytest.mark.parametrize("period", [5e-3, 0.1])
def test_follow_reaches_the_velocity_that_is_wanted_one_period_later(period: float) -> None:
    start = crane().state(x_dot=0.2, gamma_dot=-0.1)
    reference = ramp(ramp(hold(start), "x", 5.0, rate=0.8, at=1.0), "l", -2.0, rate=0.5, at=1.0)
    drives = follow(reference, period)
    for t in (0.5, 1.0 - period / 2, 2.0):
        reached = start.v[[0, 1, 4]] + period * drives(t, start, reference(t))
        assert_allclose(reached, reference(t + period).velocity, atol=1e-15)  # rounding


def test_tracking_goes_by_its_first_row_before_it_begins_and_by_its_last_when_it_is_over() -> None:
    rows = np.arange(12.0).reshape(4, 3)
    tracking = Tracking(0.5, rows, np.zeros((4, 3, 10)), np.zeros((4, 10)))
    times = np.array([-7.0, -0.5, 0.0, 0.5, 1.5, 9.0])
    commands = [tracking(t, crane().start, STILL) for t in times]
    assert_allclose(commands, rows[[0, 0, 0, 1, 3, 3]])
    form = tracking.affine(times, np.zeros((6, 3)))
    assert_allclose(form.feed_forward[np.minimum(range(6), len(form.feed_forward) - 1)], commands)
