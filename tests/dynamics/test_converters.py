"""Frequency converters against closed forms: lag, ramps, limits, rounding, delay, stall."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from cranedyn.dynamics.converters import (
    DEFAULT_RATES,
    HEADROOM,
    RATES,
    Converters,
    Response,
    converters,
    default_rates,
    within_efforts,
)
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate
from tests.helpers import FAST, crane

DT = 5e-4


def told(*rates: float) -> Any:
    """A controller that always commands the same."""
    return lambda t, state, setpoint: np.array(rates)


def only_lag(c: Crane, lag: float) -> Converters:
    """Converters that ramp at once, and hear at once all that there is."""
    m = c.layout.m
    endless = np.full(m, 1e9)
    return Converters(endless, endless, 1e9 * endless, np.full(m, lag), np.zeros(m), 0.0)


def one(acceleration: float, jerk: float, lag: float = 1e6) -> Response:
    """A converter by itself."""
    return Response(*([value] for value in (1e9, acceleration, jerk, lag, 0.0)))


def ramp(response: Response, goal: float, dt: float, steps: int) -> np.ndarray:
    """Reference rate and how fast it changes after each step, shape (steps, 2)."""
    reference = [0.0]
    rising = [0.0]
    rows = []
    for _ in range(steps):
        reference, rising = response.ramped([goal], reference, rising, reference, dt)
        rows.append((reference[0], rising[0]))
    return np.array(rows)


def test_a_step_is_followed_as_a_lag_of_first_order() -> None:
    c = crane()
    run = simulate(
        c,
        told(0.01, 0.3, -0.2),
        start=c.state(x=12.0, l=10.0),
        duration=0.5,
        drive=only_lag(c, 0.1),
    )
    rates = run.v[:, c.layout.drives] / [0.01, 0.3, -0.2]
    steps = np.round(run.t / DT)
    # T v̇ = r - v in steps of dt; rounding
    assert_allclose(
        rates, np.repeat(1.0 - (1.0 - DT / 0.1) ** steps[:, None], 3, axis=1), rtol=1e-9
    )
    # and that is the exponential but for dt/(2 T) of t/T e^(-t/T), which is 1/e at most
    assert_allclose(rates[:, 1], 1.0 - np.exp(-run.t / 0.1), atol=DT / 0.1 / 2 / math.e * 1.05)


@pytest.mark.parametrize(
    ("goal", "lasts"),
    [
        (1.2, 1.2 / 0.5 + 0.5 / 2.0),
        (-1.2, 1.2 / 0.5 + 0.5 / 2.0),
        (0.05, 2 * math.sqrt(0.05 / 2.0)),
    ],
)
def test_a_ramp_takes_the_time_of_an_s_curve(goal: float, lasts: float) -> None:
    # at acceleration A and jerk J: w/A + A/J, or 2 √(w/J) where A is never reached
    dt = 1e-4
    rows = ramp(one(0.5, 2.0), goal, dt, 40_000)
    there = np.flatnonzero(np.abs(rows[:, 0] - goal) <= 1e-9)[0] * dt
    assert there == pytest.approx(lasts, abs=5 * dt)
    assert np.abs(rows[:, 1]).max() == pytest.approx(min(0.5, math.sqrt(2.0 * abs(goal))), rel=2e-3)


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(
    goal=st.floats(-2.0, 2.0),
    acceleration=st.floats(0.01, 5.0),
    jerk=st.floats(0.01, 50.0),
    dt=st.floats(1e-3, 2e-2),
)
def test_no_ramp_overshoots_or_exceeds_its_limits(
    goal: float, acceleration: float, jerk: float, dt: float
) -> None:
    rows = ramp(one(acceleration, jerk), goal, dt, 400)
    # the last step may take an eighth of J dt² too much, see `Response.ramped`
    assert (np.sign(goal) * rows[:, 0]).max() <= abs(goal) * (1 + 1e-9) + jerk * dt**2 / 8 + 1e-12
    assert np.abs(rows[:, 1]).max() <= acceleration * (1.0 + 1e-9)
    assert np.abs(np.diff(rows[:, 1], prepend=0.0)).max() <= jerk * dt * (1.0 + 1e-6) + 1e-12


def test_a_reference_waits_for_a_drive_that_stalls() -> None:
    response = one(0.5, 5.0, lag=0.1)
    dt = 1e-3
    reference = [0.0]
    rising = [0.0]
    for _ in range(3000):  # it could be at 1 m/s after 2.1 s
        reference, rising = response.ramped([1.0], reference, rising, [0.0], dt)
    assert reference[0] == pytest.approx(0.5 * 0.1, rel=1e-12)
    # so that it goes on at no more than the acceleration of its ramp
    assert response.accelerations_at(reference, [0.0])[0] == pytest.approx(0.5, rel=1e-12)


def test_commands_are_cut_to_the_rate_and_rounded_to_the_resolution() -> None:
    response = Response([1.0, 1.0], [1.0] * 2, [1.0] * 2, [1.0] * 2, [0.25, 0.0])
    assert response.quantize_commands([0.3, 0.3]) == [0.25, 0.3]
    assert response.quantize_commands([-9.0, 9.0]) == [-1.0, 1.0]
    assert response.saturates([1.0, 1.1]) == [False, True]


@pytest.mark.parametrize("engine", ["pinocchio", FAST])
def test_commands_are_late_by_the_delay_and_drives_go_on_until_they_are_heard(engine: Any) -> None:
    c = crane()
    late = replace(only_lag(c, 0.1), delay=0.0175)  # 3.5 control periods: heard at the fourth
    start = c.state(x=12.0, l=10.0, x_dot=0.2)
    run = simulate(c, told(0.0, 0.7, 0.0), start=start, duration=0.1, drive=late, engine=engine)
    assert_allclose(run["x_dot_m_s"][:5], 0.2, rtol=1e-12)  # rounding
    assert run["x_dot_m_s"][5] > 0.2 + 0.5 * 0.5 * 5e-3 / 0.1


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["pinocchio", FAST])
def test_a_hoist_too_weak_for_its_load_stalls_and_sinks_at_what_is_left(engine: Any) -> None:
    weight = -holding_effort(crane(), crane().state(l=8.0).q)[2]
    c = crane(hoist_effort=0.99 * weight)
    run = simulate(
        c,
        told(0.0, 0.0, -0.3),
        start=c.state(x=12.0, l=8.0),
        duration=1.0,
        drive="velocity",
        engine=engine,
    )
    # a hundredth of the weight is left of gravity; the hook's share of the mass too
    sinking = run["l_dot_m_s"]
    assert_allclose(np.diff(sinking) / np.diff(run.t), 0.01 * c.gravity, rtol=1e-6)
    assert_allclose(run.effort[:, 2], -0.99 * weight, rtol=1e-12)
    assert (run.command[:, 2] < run.effort[:, 2]).all()  # it would need more
    assert not run.valid.any()


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["pinocchio", FAST])
def test_drives_that_all_stall_move_as_drives_that_exert_their_limits(engine: Any) -> None:
    start = State(crane().state(x=12.0, l=10.0, phi=0.1, theta=-0.05).q, np.zeros(5))
    weight = -holding_effort(crane(), start.q)[2]
    c = crane(slew_effort=2e4, trolley_effort=300.0, hoist_effort=1.02 * weight)
    how: dict[str, Any] = {"start": start, "duration": 0.4, "engine": engine}
    swift = replace(only_lag(c, 0.1), accelerations=np.full(3, 1e6))
    stalled = simulate(c, told(9.0, 9.0, -9.0), drive=swift, **how)
    limits = c.effort_limit * [1.0, 1.0, -1.0]
    exerted = simulate(c, told(*limits), drive="effort", **how)
    # from the first step on; rounding of a mass matrix that is solved in another order
    assert_allclose(stalled.q, exerted.q, rtol=0.0, atol=1e-11)
    assert_allclose(stalled.effort[1:], np.tile(limits, (len(stalled) - 1, 1)), rtol=1e-12)


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(st.integers(1, 4), st.integers(0, 10**6))
def test_no_drive_exerts_more_than_it_can_and_the_others_do_as_they_want(m: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(m, m))
    inertia = root @ root.T + np.eye(m)
    resisting = rng.normal(size=m)
    wanted = 3.0 * rng.normal(size=m)
    limits = rng.uniform(0.5, 5, m)
    gained, effort, needed = within_efforts(inertia, resisting, wanted, limits)
    assert (np.abs(effort) <= limits).all()
    assert_allclose(needed, inertia @ wanted + resisting, rtol=1e-12, atol=1e-12)
    # forces and accelerations belong together
    assert_allclose(inertia @ gained + resisting, effort, rtol=1e-9, atol=1e-9)
    free = np.abs(effort) < limits * (1.0 - 1e-9)
    assert_allclose(gained[free], wanted[free], rtol=1e-9, atol=1e-9)


def test_typical_converters_are_those_of_the_role_and_never_faster_than_the_joint() -> None:
    usual = converters(crane())
    slow = converters(crane(trolley_velocity=0.5))
    assert_allclose(
        usual.rates, HEADROOM * np.array([RATES[r] for r in ("slew", "trolley", "hoist")])
    )
    assert slow.rates[1] == 0.5
    own = converters(crane(), lags={"x": 0.25}, delay=0.04)
    assert own.lags.tolist() == [usual.lags[0], 0.25, usual.lags[2]] and own.delay == 0.04


def test_a_drive_without_role_and_velocity_limit_has_the_default_rate_and_is_named(
    tmp_path: Path,
) -> None:
    (tmp_path / "cart.xml").write_text(CART)
    cart = load_crane(tmp_path / "cart.xml")
    drives = converters(cart)
    assert drives.rates.tolist() == [HEADROOM * DEFAULT_RATES["prismatic"]]
    (sentence,) = default_rates(cart)
    assert "rail has no velocity limit" in sentence and "default rate of 1 m/s" in sentence
    assert default_rates(crane()) == []


CART = """<mujoco model="cart">
  <worldbody>
    <body name="cart" pos="0 0 5">
      <joint name="rail" type="slide" axis="1 0 0" range="-4 4"/>
      <geom type="box" size=".2 .2 .1" mass="60"/>
      <body name="bob">
        <joint name="swing" type="hinge" axis="0 1 0" range="-80 80"/>
        <geom type="sphere" size=".15" pos="0 0 -3" mass="120"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="rail" gear="30" ctrlrange="-25 25"/></actuator>
</mujoco>"""
"""A cart with a pendulum, in a format that has no velocity limits."""
