"""Strategies that were made for other drives, as rates."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cranedyn.analysis.swing import swing_amplitude
from cranedyn.controllers import follow, hold_controller
from cranedyn.controllers.affine import affine_form
from cranedyn.controllers.damping import with_damping
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.controllers.lqr import lqr
from cranedyn.controllers.velocity_command import VelocityCommand, as_velocity_command
from cranedyn.dynamics.converters import Converters, converters
from cranedyn.dynamics.equations_of_motion import acceleration
from cranedyn.interfaces import Setpoint, State
from cranedyn.references import hold
from cranedyn.references.flat import flat
from cranedyn.references.limits import Limits
from cranedyn.references.motion import Motion
from cranedyn.references.simple import spline
from cranedyn.simulation.simulate import simulate
from tests.helpers import FAST, crane

STILL = Setpoint(np.array([0.0, 12.0, 10.0]), np.zeros(3), np.zeros(3))
PERIOD = 5e-3


def planned() -> Motion:
    c = crane()
    return flat(c, c.state(x=10.0, l=12.0), c.state(gamma=0.1, x=12.0, l=11.0), 10.0)


def lead(made: Converters) -> np.ndarray:
    """Lag, delay and half of a control period [s]."""
    return made.lags + made.delay + PERIOD / 2.0


def test_an_effort_becomes_the_rate_that_its_acceleration_leads_to() -> None:
    c = crane()
    state = crane().state(x=12.0, l=10.0, phi=0.1, x_dot=0.3, gamma_dot=0.02)
    efforts = np.array([5e3, 400.0, -9000.0])
    law = as_velocity_command(c, lambda *now: efforts, drive="effort")
    assert isinstance(law, VelocityCommand)
    a = acceleration(c, state, efforts)
    drives = c.layout.drives
    expected = state.v[drives] + lead(converters(c)) * a[drives]
    assert_allclose(law(0.0, state, STILL), expected, rtol=1e-12)
    told = as_velocity_command(c, lambda *now: np.ones(3), drive="motion")
    assert_allclose(told(0.0, state, STILL), state.v[drives] + lead(converters(c)), rtol=1e-12)


def test_gains_about_a_motion_ask_for_the_rates_that_their_efforts_give_to_first_order() -> None:
    c = crane()
    motion = planned()
    tracking = lqr(c, motion)
    law, exact = (
        as_velocity_command(c, one, drive="effort")
        for one in (tracking, lambda *now: tracking(*now))
    )
    rng = np.random.default_rng(0)
    row = 1000

    def at(one: Any, z: Any) -> np.ndarray:
        return one(row * PERIOD, State(*z), STILL)

    here = motion.q[row], motion.v[row]
    away = [rng.normal(size=c.layout.n) for _ in here]

    def wrong(scale: float) -> float:
        """By how much changes of the commands differ."""
        off = tuple(part + scale * by for part, by in zip(here, away, strict=True))
        change, exactly = (at(one, off) - at(one, here) for one in (law, exact))
        return float(np.abs(change - exactly).max())

    # what is left is of second order: a quarter for half the distance
    assert wrong(5e-4) == pytest.approx(wrong(1e-3) / 4.0, rel=0.05)


@pytest.mark.parametrize("made", ["hold", "follow", "lqr", "integral"])
def test_what_was_affine_in_the_state_still_is_and_answers_the_same(made: str) -> None:
    c = crane()
    motion = planned()
    controller: Any = {
        "hold": lambda: hold_controller(c),
        "follow": lambda: follow(c, motion),
        "lqr": lambda: lqr(c, motion),
        "integral": lambda: HoistIntegral(c, lqr(c, motion), 4e3, 1e5),
    }[made]()
    law = as_velocity_command(c, controller, drive="motion" if made == "follow" else "effort")
    times = PERIOD * np.arange(1000, 1003)
    setpoints = motion.at(times)
    common = affine_form(law, times, setpoints.position, 2 * c.layout.n)
    assert common is not None
    state = c.state(x=11.0, l=11.5, phi=0.02, x_dot=0.1, gamma=0.03)
    k = min(1, len(common.feed_forward) - 1)
    z = np.concatenate(state)
    told = common.feed_forward[k] - common.gain[k] @ (z - common.setpoint[1])
    if made == "integral":  # the error has been integrated for one period
        error = setpoints.position[1, 2] - state.q[4]
        told = told + common.integral_gain * (error * PERIOD)
        law.begin_run(times[1], PERIOD)
    setpoint = Setpoint(*(part[1] for part in setpoints))
    assert_allclose(law(float(times[1]), state, setpoint), told, rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_a_planned_motion_is_followed_as_if_there_were_no_converters() -> None:
    c = crane()
    motion = planned()
    made = HoistIntegral(c, lqr(c, motion), 4e3, 1e5)
    left = {}
    for drive, law in (
        ("effort", made),
        ("velocity", as_velocity_command(c, made, drive="effort")),
    ):
        run = simulate(
            c,
            law,
            motion,
            start=c.state(x=10.0, l=12.0),
            duration=12.0,
            drive=drive,  # type: ignore[arg-type]
            engine=FAST,
        )
        made = HoistIntegral(c, made.tracking, 4e3, 1e5)
        off = np.abs(run.q[:, c.layout.drives] - run.setpoint).max(axis=0)
        assert (off < [1e-4, 1e-3, 1e-3]).all()
        rows = run.q[-1:, 2:4], run.v[-1:, 2:4], run.q[-1:, 4]
        left[drive] = float(swing_amplitude(*rows, c.gravity)[0])
    # a step of a command, an eighth of a millimetre a second and twenty times less for the slew,
    # gives the pivot so much of a swing: rate/√(g l)
    step = float(converters(c).resolutions[1])
    assert left["velocity"] < left["effort"] + 2.0 * step / np.sqrt(c.gravity * 11.0)


@pytest.mark.slow
def test_a_spline_is_followed_within_a_millimetre_and_a_jump_is_made_up_for() -> None:
    c = crane()
    start = c.state(x=10.0, l=12.0)
    smooth = spline(c, start, [(0.1, 12.0, 11.0)], [10.0])
    law = as_velocity_command(c, follow(c, smooth), drive="motion")
    run = simulate(c, law, smooth, start=start, duration=11.0, drive="velocity", engine=FAST)
    assert (np.abs(run.q[:, c.layout.drives] - run.setpoint).max(axis=0) < 1e-3).all()
    aside = as_velocity_command(c, follow(c, hold(c, c.state(x=10.2, l=12.0))), drive="motion")
    back = simulate(
        c, aside, hold(c, c.state(x=10.2, l=12.0)), start=start, duration=12.0, drive="velocity"
    )
    # a share of 1 a second: e^-12 of 0.2 m, and half a step of the command over that share
    step = float(converters(c).resolutions[1])
    assert abs(back["x_m"][-1] - 10.2) < 0.2 * np.exp(-10.0) + step / 2.0


@pytest.mark.slow
def test_drives_that_yield_ask_for_the_rate_that_they_compute() -> None:
    c = crane()
    reference = hold(c, c.state(x=12.0, l=10.0))
    limits = Limits((0.1, 1.0, 1.0), (0.02, 0.4, 0.4))
    yielding = with_damping(c, reference, limits=limits, recovery=0.3)
    law = as_velocity_command(c, yielding, drive="motion")
    state = c.state(x=12.1, l=10.0, phi=0.1)
    rates = yielding.velocity(yielding.reference(5e-3).velocity, STILL.position, state.q)
    assert law(0.0, state, STILL).tolist() == rates.tolist()
    run = simulate(
        c,
        law,
        reference,
        start=c.state(x=12.0, l=10.0, phi=0.1),
        duration=30.0,
        drive="velocity",
        engine=FAST,
    )
    # ζ = 0.2 at 1 rad/s for 30 s: e^-6
    assert np.abs(run["phi_rad"][-1000:]).max() < 0.1 * np.exp(-5.0)
