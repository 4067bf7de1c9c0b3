"""Imperfect sensors, a Kalman filter instead of a swing sensor, and states that are no states."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov

from cranedyn.controllers import hold_controller, lqr
from cranedyn.controllers.lqr import linearised
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.linearisation import sampled
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.estimation import with_observer, with_sensor_model
from cranedyn.estimation.load_estimate import with_load_estimate
from cranedyn.estimation.observer import (
    ObserverController,
    disturbance_of,
    initial_std_of,
    kalman_gain,
    steady_correction,
)
from cranedyn.estimation.sensor_model import noise_of
from cranedyn.interfaces import Controller, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.references import Motion, hanging_reference, spline
from cranedyn.simulation.simulate import simulate
from tests import linear_laws
from tests.estimation.motions import PERIOD, REST, STILL, at_rest, combined, residual, tracked
from tests.helpers import crane, python, quickly
from tests.linear_laws import filtered

MEASURED = crane().layout.measured
NOISE = noise_of(crane())
DISTURBANCE = disturbance_of(crane())
INITIAL_STD = initial_std_of(crane())


def random_states(n: int) -> list[State]:
    return [State(*row) for row in np.random.default_rng(3).normal(size=(n, 2, 5))]


class Watched:
    """A controller that keeps what it is shown."""

    def __init__(self) -> None:
        self.seen: list[np.ndarray] = []

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Drives that do nothing."""
        self.seen.append(np.concatenate(state))
        return np.zeros(3)


# --- sensors --------------------------------------------------------------------------------------


def test_late_sensors_show_the_first_state_until_the_delay_has_passed_and_then_an_old_one() -> None:
    inner = Watched()
    late = with_sensor_model(
        crane(), inner, delay=3, noise=np.zeros(10), rng=np.random.default_rng(1)
    )
    states = random_states(8)
    for k, state in enumerate(states):
        late(k * PERIOD, state, STILL)
    np.testing.assert_array_equal(
        inner.seen, [np.concatenate(states[max(k - 3, 0)]) for k in range(8)]
    )


@pytest.mark.parametrize("noise", [NOISE, NOISE.tolist(), (NOISE[:5], NOISE[5:])])
@pytest.mark.slow
def test_noise_is_white_and_has_the_deviations_asked_for(noise: object) -> None:
    inner = Watched()
    n = 20_000
    noisy = with_sensor_model(crane(), inner, noise=noise, rng=np.random.default_rng(1))  # type: ignore[arg-type]
    state = crane().state()
    for k in range(n):
        noisy(k * PERIOD, state, STILL)
    found = (np.array(inner.seen) - np.concatenate(state)) / NOISE
    # statistics of n draws: deviation of a mean 1/√n, of a standard deviation 1/√(2n), of a
    # correlation 1/√n; four and a half of each
    np.testing.assert_allclose(found.mean(axis=0), 0.0, atol=4.5 / math.sqrt(n))
    np.testing.assert_allclose(found.std(axis=0), 1.0, atol=4.5 / math.sqrt(2 * n))
    np.testing.assert_allclose((found[1:] * found[:-1]).mean(axis=0), 0.0, atol=4.5 / math.sqrt(n))
    np.testing.assert_allclose(np.corrcoef(found.T), np.eye(10), atol=4.5 / math.sqrt(n))


def test_an_equal_seed_gives_an_equal_run_and_another_seed_another() -> None:
    start = crane().state(**REST)
    motion = at_rest(crane())

    def run(seed: int) -> Trajectory:
        controller = with_sensor_model(
            crane(), lqr(crane(), motion), delay=2, rng=np.random.default_rng(seed)
        )
        return quickly(crane(), controller, motion, start=start, duration=0.5)

    assert (run(1).command == run(1).command).all()
    assert (run(1).command != run(2).command).any()


@pytest.mark.slow
def test_noise_shakes_the_regulated_crane_as_much_as_the_lyapunov_equation_says() -> None:
    start = crane().state(**REST)
    motion = at_rest(crane())
    controller = lqr(crane(), motion)
    run = quickly(
        crane(),
        with_sensor_model(crane(), controller, rng=np.random.default_rng(5)),
        motion,
        start=start,
        duration=120.0,
    )
    model = sampled(crane(), start)
    gain = controller.gain[0]
    by_noise = model.b @ gain
    covariance = solve_discrete_lyapunov(
        model.closed(gain), by_noise @ np.diag(NOISE**2) @ by_noise.T
    )
    found = run.since(10.0)
    for i, values in ((2, found["phi_rad"]), (3, found["theta_rad"]), (1, found["x_m"] - 10.0)):
        # The slowest time constant is 4.6 s, that of squares half of it: 110 s are 24 independent
        # draws, of which a deviation is known to 1/√48.
        assert values.std() == pytest.approx(math.sqrt(covariance[i, i]), rel=3.0 / math.sqrt(48.0))


def test_noise_is_drawn_by_a_generator_and_not_by_a_seed() -> None:
    with pytest.raises(OutOfRange, match="rng is 5; allowed is a generator, such as"):
        with_sensor_model(crane(), hold_controller(crane()), rng=5)  # type: ignore[arg-type]


@pytest.mark.parametrize("behind", ["sensors", "observer", "load estimate"])
def test_behind_new_sensors_or_a_new_observer_a_controller_begins_anew(behind: str) -> None:
    law = filtered()
    c = linear_laws.CRANE
    still = np.zeros((1, 5))
    motion = Motion(linear_laws.PERIOD, linear_laws.REST.q[None], still, still, c.layout.drives)
    ends = []
    for _ in range(2):
        if behind == "sensors":
            controller: Any = with_sensor_model(c, law, rng=np.random.default_rng(0))
        elif behind == "observer":
            controller = with_observer(law, c, motion, dt=2e-3)
        else:
            controller = with_load_estimate(law, c, motion)
        run = simulate(
            c, controller, start=c.state(x=12.3, l=15.0), duration=1.0, dt=2e-3,
            control_period=linear_laws.PERIOD,
        )  # fmt: skip
        ends.append(run.q[-1].tolist())
    assert ends[0] == ends[1]


def test_sensors_of_one_run_are_refused_in_another() -> None:
    used = with_sensor_model(crane(), hold_controller(crane()), rng=np.random.default_rng(1))
    quickly(crane(), used, duration=0.1)
    with pytest.raises(CraneError, match="make new ones for each run"):
        quickly(crane(), used, duration=0.1)


# --- the observer ---------------------------------------------------------------------------------


class Compared:
    """An observer whose errors are kept; `outer` stands between it and the crane."""

    def __init__(self, observer: ObserverController, outer: Controller | None = None) -> None:
        self.observer = observer
        self.outer = outer or observer
        self.errors: list[np.ndarray] = []

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """What `outer` commands."""
        command = self.outer(t, state, setpoint)
        self.errors.append(np.subtract(self.observer.estimate, state).ravel())
        return command

    def swing(self, since: float) -> float:
        """Largest error of the swing from a time on [rad]."""
        return float(
            np.linalg.norm(np.array(self.errors)[round(since / PERIOD) :, 2:4], axis=1).max()
        )


def process_noise() -> np.ndarray:
    """Accelerations held over a period: half its square to positions, itself to rates (Bar-Shalom,
    Li, Kirubarajan, §6.3.2).
    """
    reach = np.kron([[PERIOD**2 / 2.0], [PERIOD]], np.eye(5))
    return reach @ np.diag(np.square(DISTURBANCE)) @ reach.T


@pytest.mark.slow
def test_the_filters_gain_tends_to_that_of_the_dual_riccati_equation() -> None:
    motion = at_rest(crane())
    observer = with_observer(lqr(crane(), motion), crane(), motion)
    model = sampled(crane(), crane().state(**REST))
    gain, _ = observer.gains.correction(0, 4000)
    noise = np.diag(NOISE[MEASURED] ** 2)
    p = solve_discrete_are(model.a.T, np.eye(10)[MEASURED].T, process_noise(), noise)
    steady = p[:, MEASURED] @ np.linalg.inv(p[np.ix_(MEASURED, MEASURED)] + noise)
    # after 20 s the slowest mode of the filter, 1/s, has left exp(-40); the algebraic solution is
    # good to about 1e-8 of its largest entry
    np.testing.assert_allclose(gain, steady, rtol=1e-5, atol=1e-7 * np.abs(steady).max())


@pytest.mark.slow
def test_a_steady_observer_corrects_from_the_first_instant_on_as_the_varying_one_does_at_last() -> (
    None
):
    motion = at_rest(crane())
    varying, steady = (
        with_observer(lqr(crane(), motion), crane(), motion, steady=is_steady)
        for is_steady in (False, True)
    )
    gain, covariance = varying.gains.correction(0, 4000)
    for k in (0, 7, 4000):
        constant = steady.gains.correction(0, k)
        # As above: the algebraic solution is good to about 1e-8 of its largest entry.
        assert_allclose(constant.gain, gain, rtol=1e-5, atol=1e-7 * np.abs(gain).max())
        atol = 1e-7 * np.abs(covariance).max()
        assert_allclose(constant.covariance, covariance, rtol=1e-5, atol=atol)


@pytest.mark.slow
def test_a_steady_observer_finds_a_swing_that_no_sensor_sees_in_three_seconds() -> None:
    motion = at_rest(crane())
    start = crane().state(**REST, phi=0.05, theta=0.03)
    compared = Compared(with_observer(lqr(crane(), motion), crane(), motion, steady=True))
    quickly(crane(), compared, motion, start=start, duration=20.0)
    assert compared.swing(0.0) == pytest.approx(math.hypot(0.05, 0.03), rel=0.1)
    # Its slowest mode decays with 1 s.
    assert compared.swing(3.0) < 0.1 * math.hypot(0.05, 0.03)


def test_a_steady_observer_along_a_motion_or_of_what_is_not_seen_is_refused() -> None:
    motion = combined(crane())
    with pytest.raises(OutOfRange, match="rows of the motion of a steady observer"):
        with_observer(lqr(crane(), motion), crane(), motion, steady=True)
    gains = with_observer(lqr(crane(), motion), crane(), at_rest(crane())).gains
    unseen = replace(gains, disturbance=0.0 * gains.disturbance, measured=gains.measured[:0])
    unseen = replace(unseen, noise=np.zeros((0, 0)))
    with pytest.raises(CraneError, match="gains of this observer do not converge"):
        steady_correction(unseen)


@pytest.mark.slow
def test_the_filter_errs_as_much_as_it_says() -> None:
    motion = at_rest(crane())
    rng = np.random.default_rng(11)
    runs = 30
    model = sampled(crane(), crane().state(**REST))
    shares = []
    values, vectors = np.linalg.eigh(process_noise())
    root = vectors * np.sqrt(values.clip(0.0))
    for _ in range(runs):
        observer = with_observer(lqr(crane(), motion), crane(), motion)
        z = rng.normal(size=10) * INITIAL_STD
        for k in range(100):
            reading = np.concatenate([motion.q[0], np.zeros(5)]) + z
            reading[MEASURED] += rng.normal(size=6) * NOISE[MEASURED]
            command = observer(k * PERIOD, State(reading[:5], reading[5:]), STILL)
            error = (
                np.concatenate(observer.estimate) - np.concatenate([motion.q[0], np.zeros(5)]) - z
            )  # type: ignore[arg-type]
            z = (
                model.a @ z
                + model.b @ (command - observer.gains.model.efforts[0])
                + root @ rng.normal(size=10)
            )
        shares.append(error @ np.linalg.solve(observer.gains.correction(0, k)[1], error))
    # the errors squared over their covariance are χ² with ten degrees of freedom in each run: mean
    # 10, deviation √20
    assert np.mean(shares) == pytest.approx(10.0, abs=4.0 * math.sqrt(20.0 / runs))


@pytest.mark.slow
@pytest.mark.parametrize("motion_of", [at_rest, combined], ids=["rest", "move"])
@pytest.mark.parametrize("swing", ["phi", "theta"])
def test_a_swing_that_no_sensor_sees_is_known_to_a_hundredth_after_two_seconds(
    motion_of: Callable[[Crane], Motion], swing: str
) -> None:
    motion = motion_of(crane())
    start = crane().state(**REST, **{swing: 0.05})
    compared = Compared(with_observer(lqr(crane(), motion), crane(), motion))
    quickly(crane(), compared, motion, start=start, duration=10.0)
    # The first estimate is that it hangs plumb.
    assert compared.swing(0.0) == pytest.approx(0.05, rel=0.1)
    assert compared.swing(2.0) < 5e-4


@pytest.mark.parametrize("delay", [0, 10])
@pytest.mark.slow
def test_noisy_and_late_sensors_of_the_drives_alone_still_end_the_move_below_a_milliradian(
    delay: int,
) -> None:
    motion = combined(crane())
    observer = with_observer(tracked(), crane(), motion, delay=delay)
    compared = Compared(
        observer, with_sensor_model(crane(), observer, delay=delay, rng=np.random.default_rng(2))
    )
    run = quickly(crane(), compared, motion, start=crane().state(**REST), duration=40.0)
    # five deviations of the swing as the filter says them
    _, covariance = observer.gains.correction(0, len(run))
    assert compared.swing(2.0) < 5.0 * math.sqrt(np.trace(covariance[2:4, 2:4]))
    assert residual(run) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("motion_of", [at_rest, combined], ids=["rest", "move"])
def test_a_delay_known_to_the_observer_is_predicted_away(
    motion_of: Callable[[Crane], Motion],
) -> None:
    motion = motion_of(crane())
    delay = 6
    rng = np.random.default_rng(1)
    observer = with_observer(lqr(crane(), motion), crane(), motion, delay=delay)
    late = with_sensor_model(crane(), observer, delay=delay, noise=np.zeros(10), rng=rng)
    compared = Compared(observer, late)
    run = quickly(crane(), compared, motion, start=crane().state(**REST, phi=0.05), duration=5.0)
    # so far the trolley runs meanwhile [m]
    assert np.abs(run.v[200:, 1]).max() * delay * PERIOD > 5e-3
    # as without a delay: a hundredth of the swing; and a fiftieth of that way
    assert compared.swing(1.0) < 5e-4
    assert np.abs(np.array(compared.errors)[200:, [0, 1, 4]]).max() < 1e-4


def test_the_observer_looks_at_the_drives_only() -> None:
    motion = at_rest(crane())
    one, other = (with_observer(lqr(crane(), motion), crane(), motion) for _ in range(2))
    for k, state in enumerate(random_states(5)):
        blind = State(*(np.where([0, 0, 1, 1, 0], math.nan, array) for array in state))
        assert one(k * PERIOD, state, STILL).tolist() == other(k * PERIOD, blind, STILL).tolist()


@pytest.mark.slow
def test_the_observer_knows_what_the_drives_cannot_give() -> None:
    weak = crane(trolley_effort=300.0)
    motion = at_rest(weak)
    compared = Compared(with_observer(lqr(weak, motion), weak, motion))
    run = quickly(weak, compared, motion, start=weak.state(**REST, phi=0.05), duration=5.0)
    assert np.abs(run.command[:, 1]).max() > 1000.0
    assert compared.swing(2.0) < 5e-4


def test_a_start_that_is_told_is_believed() -> None:
    motion = at_rest(crane())
    start = crane().state(**REST, phi=0.05, theta=-0.03)
    compared = Compared(with_observer(lqr(crane(), motion), crane(), motion, start=start))
    quickly(crane(), compared, motion, start=start, duration=1.0)
    # The linear model's: φ²/2 = 1e-3 of the load's pull, and cubes.
    assert compared.swing(0.0) < 2e-3


def test_an_observer_is_refused_in_a_second_run_and_where_a_call_is_left_out() -> None:
    motion = at_rest(crane())
    start = crane().state(**REST)
    used, other = (with_observer(lqr(crane(), motion), crane(), motion) for _ in range(2))
    quickly(crane(), used, motion, start=start, duration=0.1)
    with pytest.raises(CraneError, match="a new one for each run"):
        quickly(crane(), used, motion, start=start, duration=0.1)
    with pytest.raises(CraneError, match=r"every 0\.005 s"):
        quickly(crane(), other, motion, duration=0.1, control_period=0.01)


@pytest.mark.slow
def test_what_an_observer_needs_is_loaded_before_its_first_control_instant() -> None:
    program = """
import sys
from cranedyn.controllers import hold_controller
from cranedyn.estimation import with_load_estimate, with_observer
from tests.estimation.motions import at_rest, crane
for observer in (with_observer, with_load_estimate):
    for name in [name for name in sys.modules if name.startswith("scipy.linalg")]:
        del sys.modules[name]
    observer(hold_controller(crane()), crane(), at_rest(crane()))
    print("scipy.linalg.lapack" in sys.modules)
"""
    assert python(program).stdout.split() == ["True"] * 2


def test_errors_that_have_no_covariance_have_no_gain() -> None:
    with pytest.raises(CraneError, match="not positive definite any more"):
        kalman_gain(np.ones((2, 3)), -np.eye(2))
    # what is no number stays none, and is refused as a command
    assert np.isnan(kalman_gain(np.ones((2, 3)), np.full((2, 2), math.nan))).all()


# --- along a motion -------------------------------------------------------------------------------


def test_the_last_row_of_a_motion_has_a_model_of_its_own_wherever_it_falls() -> None:
    whole = combined(crane())
    for n in (21, 24, 30):
        arrays = (array[2000 : 2000 + n] for array in (whole.q, whole.v, whole.a))
        motion = Motion(PERIOD, *arrays, whole.drives)
        found = linearised(crane(), motion, dt=5e-4, every=10)
        for k in (0, 7, 10, 19, n - 1):
            row = k if k == n - 1 else k - k % 10
            here = sampled(crane(), State(motion.q[row], motion.v[row]), found.efforts[row])
            assert (found.a[found.stretch[k]] == here.a).all()
            assert (found.b[found.stretch[k]] == here.b).all()


def test_an_observer_is_asked_at_the_rows_of_its_motion_or_refuses() -> None:
    move = spline(crane(), crane().start, [(0.0, 11.0, 15.0)], [4.0])
    motion = hanging_reference(crane(), move, 4.0)
    late = 1.0 + PERIOD / 2.0
    with pytest.raises(CraneError, match=r"asked for t = 1.0025 s; its motion has rows every 0"):
        with_observer(Watched(), crane(), motion)(late, crane().start, STILL)
    # Wherever it stands still all rows are one.
    with_observer(Watched(), crane(), at_rest(crane()))(late, crane().start, STILL)
