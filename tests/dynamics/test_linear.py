"""The linear crane and the prediction made with it, against the loop they stand for."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cranedyn.analysis.prediction import free_swing
from cranedyn.analysis.swing import fit_swing
from cranedyn.controllers import Hold, hold_controller
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.dynamics.linearisation import dominant_mode, feedback_gain, sampled
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.crane import STANDARD_GRAVITY
from cranedyn.model.load import load_crane
from cranedyn.references import hold, pulse
from cranedyn.simulation.simulate import simulate
from experiments import a1, harness
from tests.helpers import G, big_crane, constant, crane

DAMPED = {"damp_slew": 3e4, "damp_trolley": 200.0, "damp_swing": 5e3, "damp_hoist": 700.0}


def test_one_sampled_period_is_the_derivative_of_one_simulated_period() -> None:
    c = crane(**DAMPED)
    clocks = {"dt": 2e-3, "control_period": 2e-2}
    rest = c.state(x=17.0, l=11.0)
    effort = holding_effort(c, rest.q)

    def step(z: np.ndarray, u: np.ndarray) -> np.ndarray:
        start = State(rest.q + z[:5], rest.v + z[5:])
        found = simulate(c, constant(*(effort + u)), start=start, duration=2e-2, **clocks)
        return np.concatenate([found.q[1], found.v[1]])

    plant = sampled(c, rest, **clocks)
    h = 1e-4
    by_state = np.array(
        [(step(h * e, np.zeros(3)) - step(-h * e, np.zeros(3))) / (2 * h) for e in np.eye(10)]
    ).T
    by_effort = np.array(
        [(step(np.zeros(10), e) - step(np.zeros(10), -e)) / 2.0 for e in np.eye(3)]
    ).T
    assert plant.period == 2e-2
    # Central differences: order h², third derivatives of about 1.
    assert_allclose(plant.a, by_state, atol=1e-8)
    # Efforts of 1 N on 1000 kg: 1e-5 of motion, squares of it.
    assert_allclose(plant.b, by_effort, atol=1e-12)


def test_feedback_sets_each_drive_by_itself() -> None:
    gain = feedback_gain(crane(), np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0]))
    z = np.array([10.0, 20.0, 99.0, 99.0, 30.0, 1.0, 2.0, 99.0, 99.0, 3.0])
    assert (gain @ z).tolist() == [14.0, 50.0, 108.0]
    brake = Hold(crane(), np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0]), np.zeros(3))
    assert (gain @ z).tolist() == (
        -brake(0.0, State(z[:5], z[5:]), Setpoint(np.zeros(3), np.zeros(3), np.zeros(3)))
    ).tolist()


@pytest.mark.parametrize(("coordinate", "inertia"), [(2, 500.0), (3, 450.0)])
def test_with_drives_held_hard_the_mode_is_the_compound_pendulum(
    coordinate: int, inertia: float
) -> None:
    c = crane(damp_swing=2e3, trolley_mass=1e8, slewing_inertia=1e12)
    dt = 1e-3
    plant = sampled(c, c.state(l=10.0), dt=dt, control_period=5e-3)
    gain = feedback_gain(c, np.array([0.0, 0.0, 3e4]), np.array([0.0, 0.0, 2e4]))
    mode = dominant_mode(plant.closed(gain), 5e-3, coordinate)
    total = 1000.0 * 10.0**2 + inertia
    natural = math.sqrt(1000.0 * G * 10.0 / total)
    ratio = 2e3 / (2.0 * total * natural)
    # mass ratio 1e-5; (ω dt)²/24 = 4e-8; the damping ratio is met at half a step's delay, ω dt/2
    assert mode.period == pytest.approx(
        2.0 * math.pi / (natural * math.sqrt(1.0 - ratio**2)), rel=1e-5
    )
    assert mode.damping_ratio == pytest.approx(ratio, rel=1e-3)


def test_a_mode_is_measured_by_its_weights() -> None:
    c = crane()
    plant = sampled(c, c.start)
    loop = plant.closed(feedback_gain(c, np.array([5e5, 3e5, 3e4]), np.array([1e6, 5e4, 2e4])))
    mode = dominant_mode(loop, plant.period, 2)
    # rounding.
    assert_allclose(loop @ mode.shape, np.exp(mode.rate * plant.period) * mode.shape, atol=1e-12)
    assert mode.shape[2] == pytest.approx(1.0, abs=1e-12)
    assert mode.weights @ mode.shape == pytest.approx(1.0, abs=1e-9)
    assert mode.weights @ mode.shape.conj() == pytest.approx(0.0, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    "clocks",
    [{"dt": 5e-4, "control_period": 5e-3}, {"dt": 2e-3, "control_period": 2e-2}],
    ids=["200 Hz", "50 Hz"],
)
@pytest.mark.parametrize("coordinate", ["phi", "theta"])
def test_a_tiny_swing_in_the_loop_is_the_mode(coordinate: str, clocks: dict[str, Any]) -> None:
    c = crane()
    brake = hold_controller(c, gravity=G)
    i = c.layout.index(coordinate)
    found = simulate(c, brake, start=c.state(l=6.0, **{coordinate: 1e-4}), duration=60.0, **clocks)
    late = found.since(35.0)  # of the drives' own modes the slew's is slowest: exp(-t/2)
    fit = fit_swing(late.t, late.q[:, i])
    plant = sampled(c, c.state(l=6.0), **clocks)
    mode = dominant_mode(
        plant.closed(feedback_gain(c, brake.stiffness, brake.damping)), plant.period, i
    )
    # amplitude² / 16 = 6e-10, what is left of other modes.
    assert fit.period == pytest.approx(mode.period, rel=1e-7)
    assert fit.damping_ratio == pytest.approx(mode.damping_ratio, abs=1e-7)
    assert np.std(late.q[:, i]) > 1e-5


# --- prediction -----------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gravity", "length"),
    [
        (9.80665, 15.0),
        (3.7, 4.0),
        pytest.param(20.0, 10.0, marks=pytest.mark.long),
        pytest.param(9.8, 26.0, marks=pytest.mark.long),
    ],
)
def test_the_free_swing_is_predicted(gravity: float, length: float) -> None:
    case = a1.run(harness.Setup(gravity), length)
    # 0.003 %: fourth order in the amplitude, and the fit of a swing whose period changes while it
    # decays
    assert case.fit.period == pytest.approx(case.predicted.period, rel=3e-5)
    amplitude = float(np.sqrt(np.mean(case.fit.amplitude_at(case.trajectory.since(12.0).t) ** 2)))
    # Second order in 0.1 rad, of the pulse and of the pivot.
    assert case.predicted.amplitude == pytest.approx(amplitude, rel=5e-3)
    # As the amplitude, squared in the hoist's part.
    assert case.predicted.damping_ratio == pytest.approx(case.fit.damping_ratio, rel=0.02)


def test_without_effects_of_amplitude_the_prediction_is_the_mode() -> None:
    c = crane()
    brake = hold_controller(c, gravity=G)
    start = c.state(l=8.0)
    tiny = pulse(c, hold(c, start), "x", 1e-6, at=1.0, width=2.8)
    found = free_swing(c, brake, tiny, start, since=12.0, until=50.0)
    plant = sampled(c, start)
    mode = dominant_mode(
        plant.closed(feedback_gain(c, brake.stiffness, brake.damping)), plant.period, 2
    )
    assert found.period == pytest.approx(mode.period, rel=1e-12)
    assert found.damping_ratio == pytest.approx(mode.damping_ratio, rel=1e-9)


def test_a_pulse_half_a_period_long_leaves_twice_its_amplitude_over_the_length() -> None:
    c = big_crane(trolley_mass=1e3)
    stiff = Hold(
        c, np.array([1e8, 1e8, 1e8]), np.array([1e6, 8e5, 8e5]), np.array([0.0, 0.0, -1000.0 * G])
    )
    start = c.state(l=20.0)
    reference = pulse(c, hold(c, start), "x", 0.01, at=1.0, width=math.pi * math.sqrt(20.0 / G))
    found = free_swing(
        c, stiff, reference, start, since=12.0, until=60.0, dt=5e-4, control_period=5e-4
    )
    # k_d/k_p = 8 ms of lag in the trolley smooths the edges by (ω · 8 ms)²; the pulse is sampled to
    # 0.5 ms of its width
    assert found.amplitude == pytest.approx(2.0 * 0.01 / 20.0, rel=2e-3)


def test_where_the_hold_believes_in_another_gravity_the_load_hangs_lower() -> None:
    c = load_crane(gravity=9.9)
    brake = hold_controller(c, gravity=STANDARD_GRAVITY)
    start = c.state(l=8.0)
    reference = pulse(c, hold(c, start), "x", 1e-6, at=1.0, width=2.8)
    found = free_swing(c, brake, reference, start, since=12.0, until=50.0)
    sag = 1000.0 * (9.9 - STANDARD_GRAVITY) / 3e4
    lower = sampled(c, c.state(l=8.0 + sag))
    mode = dominant_mode(
        lower.closed(feedback_gain(c, brake.stiffness, brake.damping)), lower.period, 2
    )
    assert found.period == pytest.approx(mode.period, rel=1e-12)
