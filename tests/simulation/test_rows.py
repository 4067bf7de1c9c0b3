"""Rows of a log, which are kept as they came and written together."""

from __future__ import annotations

import numpy as np
import pytest

from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.interfaces import Setpoint, State
from cranedyn.references import hold
from cranedyn.simulation.simulate import simulate
from tests.helpers import crane

START = crane().state(phi=0.1)


def test_a_reference_that_writes_into_its_last_answer_is_logged_as_it_was() -> None:
    answer = Setpoint(START.q[crane().layout.drives], np.zeros(3), np.zeros(3))

    def reference(t: float) -> Setpoint:
        answer.position[0] = t
        return answer

    # more rows than are written together
    run = simulate(crane(), hold_controller(crane()), reference, start=START, duration=1.5)
    assert np.array_equal(run.setpoint[:, 0], run.t)


def test_an_answer_that_can_change_is_looked_at_every_time() -> None:
    answer = Setpoint(np.zeros(3), np.zeros(3), np.zeros(3))

    def reference(t: float) -> Setpoint:
        answer.velocity[1] = np.nan if t > 0.05 else 0.0
        return answer

    with pytest.raises(CraneError, match=r"At t = 0\.055 s: velocity of the setpoint is nan"):
        simulate(crane(), hold_controller(crane()), reference, start=START, duration=0.1)


def test_both_ends_of_a_long_run_are_those_of_a_run_in_two_parts() -> None:
    def run(duration: float, t_start: float = 0.0, start: State = START) -> Trajectory:
        return simulate(
            crane(),
            hold_controller(crane()),
            hold(crane(), START),
            start=start,
            t_start=t_start,
            duration=duration,
        )

    whole = run(2.56)
    first = run(1.28)
    then = run(1.28, 1.28, State(first.q[-1], first.v[-1]))
    for name in ("q", "v", "setpoint", "command", "effort"):
        parts = np.concatenate([getattr(first, name)[:-1], getattr(then, name)])
        assert np.allclose(getattr(whole, name), parts, rtol=0.0, atol=1e-9), name


def test_hold_control_refuses_a_setpoint_of_other_drives() -> None:
    for count in (2, 4):
        setpoint = Setpoint(*np.zeros((3, count)))
        with pytest.raises(OutOfRange, match=rf"array of shape \({count},\)"):
            hold_controller(crane())(0.0, START, setpoint)
