"""Drives that are told rates, in both engines and in batches; and what drives cannot do, seen in
every record.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cranedyn.controllers import follow, hold_controller
from cranedyn.controllers.velocity_command import as_velocity_command
from cranedyn.data.trajectory import Trajectory
from cranedyn.disturbances import wind
from cranedyn.dynamics.converters import converters
from cranedyn.dynamics.integrators import Integrator, rk4, semi_implicit_euler
from cranedyn.dynamics.validity import conditions, events, first_event
from cranedyn.errors import CraneError, RunError
from cranedyn.interfaces import Reference, State
from cranedyn.model.crane import Crane
from cranedyn.references import hold, pulse, ramp
from cranedyn.simulation.simulate import simulate
from tests.helpers import crane

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")

from cranedyn.compiled.batch import simulate_batch

SMOOTH = {"semi-implicit Euler": 1e-3, "RK4": 5e-3}
"""Steps by stepping rule [s]."""


def start() -> State:
    return crane().state(x=12.0, l=10.0, phi=0.1, theta=-0.05, x_dot=0.1, theta_dot=0.05)


def moved(c: Crane) -> Reference:
    base = ramp(c, hold(c, start()), "x", 0.1, rate=0.8, at=0.1)
    return ramp(c, ramp(c, base, "l", -0.5, rate=0.5, at=0.3), "gamma", 0.05, rate=0.05, at=0.2)


def agree(c: Crane, one: Trajectory, other: Trajectory) -> None:
    """Both are the same but for rounding, of efforts with a tenth of a meganewton in them."""
    for name in ("q", "v"):
        assert_allclose(getattr(other, name), getattr(one, name), rtol=0.0, atol=1e-12)
    for name in ("command", "effort"):
        assert_allclose(getattr(other, name), getattr(one, name), rtol=1e-12, atol=1e-7)
    assert_allclose(other.energy, one.energy, rtol=1e-12)
    assert (other.valid == one.valid).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rule", "strong", "blows"),
    [
        (semi_implicit_euler, True, False),
        (semi_implicit_euler, False, True),
        (rk4, False, False),
        (rk4, True, True),
    ],
    ids=["Euler", "Euler, weak, wind", "RK4, weak", "RK4, wind"],
)
def test_both_engines_and_a_batch_record_the_same(
    rule: Integrator, strong: bool, blows: bool
) -> None:
    c = crane() if strong else crane(trolley_effort=400.0, slew_effort=2e4)
    law = as_velocity_command(c, hold_controller(c), drive="effort")
    how: dict[str, Any] = {
        "start": start(),
        "duration": 1.0,
        "dt": SMOOTH[rule.name],
        "drive": "velocity",
        "integrator": rule,
    }
    gust = wind.constant_force(c, payload=(500.0, -300.0, 100.0), at=0.2) if blows else None
    plain = simulate(c, law, moved(c), disturbance=gust, **how)
    agree(c, plain, simulate(c, law, moved(c), disturbance=gust, engine="compiled", **how))
    called = simulate(
        c, lambda *now: law(*now), moved(c), disturbance=gust, engine="compiled", **how
    )
    agree(c, plain, called)
    assert strong == bool(plain.valid.all())
    assert (np.abs(plain.effort) <= c.effort_limit).all()
    if blows:
        return
    batch = simulate_batch(c, law, moved(c), record=1, **{**how, "start": [start()] * 3})
    assert_allclose(batch.q[1], plain.q, rtol=0.0, atol=1e-12)
    assert_allclose(batch.effort[1], plain.effort, rtol=1e-12, atol=1e-7)
    first = math.inf if strong else plain.t[np.argmin(plain.valid)]
    assert batch.valid_until[1] == pytest.approx(first, abs=1e-12)


@pytest.mark.slow
def test_cranes_of_a_batch_may_have_converters_of_their_own() -> None:
    c = crane()
    made = [converters(c, lags={"x": lag, "gamma": lag}) for lag in (0.05, 0.1, 0.3)]
    law = as_velocity_command(c, hold_controller(c), drive="effort")
    how: dict[str, Any] = {"duration": 1.0, "dt": 1e-3}
    batch = simulate_batch(
        c, law, moved(c), start=[start()] * 3, drive="velocity", converters=made, **how
    )
    alone = [
        simulate(c, law, moved(c), start=start(), drive=one, engine="compiled", **how).q[-1]
        for one in made
    ]
    assert_allclose(batch.end.q, alone, rtol=0.0, atol=1e-12)
    assert np.ptp(batch.end.q[:, 1]) > 1e-2


def test_a_batch_hears_with_one_delay_and_gets_as_many_converters_as_cranes() -> None:
    c = crane()
    law = as_velocity_command(c, hold_controller(c), drive="effort")
    how: dict[str, Any] = {"start": [start()] * 2, "duration": 0.1, "drive": "velocity"}
    with pytest.raises(CraneError, match="delays of converters is 4 to 8 control periods"):
        simulate_batch(c, law, converters=[converters(c), converters(c, delay=0.04)], **how)
    with pytest.raises(CraneError, match="number of starts is 2; allowed is 3"):
        simulate_batch(c, law, converters=[converters(c)] * 3, **how)


def test_the_ledger_of_energy_closes_the_better_the_finer_the_step() -> None:
    c = crane()
    law = as_velocity_command(c, hold_controller(c), drive="effort")
    options: Any = {"start": start(), "duration": 3.0, "drive": "velocity", "engine": "compiled"}
    steps = 5e-3, 2.5e-3, 1.25e-3
    left = [simulate(c, law, moved(c), dt=dt, control_period=5e-3, **options) for dt in steps]
    open_ = [np.abs(run.unexplained).max() for run in left]
    assert np.abs(left[0].work).max() > 500.0  # J: the drives do work
    assert open_[0] > 1.7 * open_[1] > 1.7 * 1.7 * open_[2]  # order 1


def test_a_record_names_the_converters() -> None:
    c = crane()
    run = simulate(c, lambda *now: np.zeros(3), duration=0.1, drive="velocity")
    assert run.parameters["drive"] == "velocity"
    assert run.record["converters"]["lags"] == converters(c).lags.tolist()


# --- what drives cannot do ------------------------------------------------------------------------


@pytest.mark.slow
def test_a_motion_that_needs_more_effort_than_a_drive_has_is_refused_or_marked() -> None:
    c = crane(trolley_effort=2e3)
    jumps = follow(c, ramp(c, hold(c), "x", 1.0, rate=0.5, at=0.1))  # half a metre a second at once
    how: dict[str, Any] = {"duration": 0.5, "drive": "motion"}
    with pytest.raises(
        RunError,
        match=r"trolley_joint would need .* N to accelerate as commanded, its drive has -2000 to",
    ):
        simulate(c, jumps, **how)
    marked = simulate(c, jumps, validity="mark", **how)
    beyond = np.abs(marked.effort[:, 1]) > 2e3
    assert beyond.any()
    assert ((marked.valid == 0.0) == beyond).all()
    assert [event.joint for event in events(c, marked)] == ["trolley_joint"]
    batch = simulate_batch(c, jumps, start=[c.start] * 2, **how)
    assert batch.valid_until.tolist() == [pytest.approx(marked.t[np.argmax(beyond)])] * 2


@pytest.mark.slow
def test_a_motion_faster_than_a_drive_is_refused_or_marked() -> None:
    c = crane(trolley_velocity=0.4)
    fast = follow(c, ramp(c, hold(c), "x", 1.0, rate=0.5, at=0.1))
    how: dict[str, Any] = {"duration": 0.5, "drive": "motion"}
    with pytest.raises(
        RunError, match=r"trolley_joint moves at 0\.5 m/s, its drive at -0\.4 to 0\.4"
    ):
        simulate(c, fast, **how)
    marked = simulate(c, fast, validity="mark", **how)
    assert ((marked.valid == 0.0) == (np.abs(marked["x_dot_m_s"]) > 0.4 + 1e-9)).all()
    assert math.isfinite(simulate_batch(c, fast, start=[c.start], **how).valid_until[0])


@pytest.mark.parametrize("engine", ["pinocchio", "compiled"])
def test_converters_that_are_told_more_than_their_rate_are_cut_and_marked(engine: Any) -> None:
    c = crane()
    most = float(converters(c).rates[1])
    run = simulate(
        c,
        lambda t, state, setpoint: np.array([0.0, 2.0 * most if 0.2 < t < 0.3 else 0.1, 0.0]),
        duration=0.5,
        drive="velocity",
        engine=engine,
    )
    told = (run.t > 0.2 + 1e-9) & (run.t < 0.3 - 1e-9)
    assert ((run.valid == 0.0) == told).all()


@pytest.mark.slow
def test_a_batch_says_when_a_converter_was_first_told_more_than_its_rate() -> None:
    c = crane()
    law = as_velocity_command(c, hold_controller(c), drive="effort")  # 6 m/s for a jump of 1 m
    jump = pulse(c, hold(c), "x", 1.0, at=0.2, width=0.1)
    batch = simulate_batch(c, law, jump, start=[c.start] * 2, duration=0.5, drive="velocity")
    assert batch.valid_until.tolist() == [pytest.approx(0.2, abs=1e-12)] * 2


def test_without_efforts_given_rows_are_judged_as_before() -> None:
    c = crane()
    weak = crane(slew_effort=1.0)
    run = simulate(c, hold_controller(c), start=c.state(phi=0.1, theta=0.1), duration=0.2)
    rows = run.q, run.v, run.effort[:, 2]
    assert first_event(weak, conditions(weak, *rows)) is None
    event = first_event(weak, conditions(weak, *rows, needed=run.effort))
    assert event is not None
    assert event.joint == "yaw_joint"
