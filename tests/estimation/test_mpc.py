"""Model predictive control: the LQR where nothing is in the way, the limits where something is."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable

import numpy as np
import pytest
from scipy.linalg import cholesky, solve_discrete_are
from scipy.optimize import lsq_linear

pytest.importorskip("daqp", reason="daqp is not installed: pip install 'cranedyn[mpc]'")

from cranedyn.controllers import lqr
from cranedyn.controllers.lqr import effort_weight_of, riccati, state_weight_of
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.dynamics.linearisation import sampled
from cranedyn.errors import CraneError, RunError
from cranedyn.estimation import mpc
from cranedyn.estimation.mpc import PredictiveController
from cranedyn.interfaces import Controller, Setpoint, State
from tests.estimation.motions import REST, STILL, at_rest, combined, residual
from tests.helpers import crane, quickly

Q = state_weight_of(crane())
R = effort_weight_of(crane())
SIZE = np.array([0.01, 0.05, 0.02, 0.02, 0.05, 0.002, 0.02, 0.02, 0.02, 0.02])
"""Deviations that bring no drive to its limit."""


def state_of(z: np.ndarray) -> State:
    return State(z[:5], z[5:])


def rates(run: Trajectory) -> np.ndarray:
    return np.abs(run.v[:, crane().layout.drives]).max(axis=0)


def test_at_rest_without_a_limit_in_reach_it_is_the_stationary_lqr() -> None:
    rest = crane().state(**REST)
    rng = np.random.default_rng(1)
    controller = mpc(crane(), at_rest(crane()))
    model = sampled(crane(), rest, control_period=0.05)
    p = solve_discrete_are(model.a, model.b, Q, R)
    gain = np.linalg.solve(R + model.b.T @ p @ model.b, model.b.T @ p @ model.a)
    for k in range(10):
        z = SIZE * rng.normal(size=10)
        efforts = controller(0.05 * k, state_of(np.concatenate(rest) + z), STILL)
        # rounding of efforts of 1e5 in the solver
        np.testing.assert_allclose(
            efforts, holding_effort(crane(), rest.q) - gain @ z, rtol=1e-8, atol=1e-6
        )


@pytest.mark.slow
def test_along_a_motion_without_a_limit_in_reach_it_is_the_lqr_of_the_whole_motion() -> None:
    motion = combined(crane())
    rng = np.random.default_rng(2)
    controller = mpc(crane(), motion, horizon=20)
    feed_forward = lqr(crane(), motion).feed_forward
    rows = range(0, 4001, 10)
    models = [
        sampled(crane(), State(motion.q[k], motion.v[k]), feed_forward[k], control_period=0.05)
        for k in rows
    ]
    gain = riccati(np.array([m.a for m in models]), np.array([m.b for m in models]), Q, R).gain
    for i in (0, 1, 117, 200, 390, 400, 1000):
        k = min(10 * i, 4000)
        z = SIZE * rng.normal(size=10)
        efforts = controller(
            0.05 * i, state_of(np.concatenate([motion.q[k], motion.v[k]]) + z), STILL
        )
        # rounding.
        np.testing.assert_allclose(
            efforts, feed_forward[k] - gain[min(i, 400)] @ z, rtol=1e-8, atol=1e-6
        )


def test_with_efforts_at_their_limits_it_is_the_optimum_of_bounded_least_squares() -> None:
    limit = np.array([3e4, 1.5e3, 1.05e4])
    n = 6
    rest = crane().state(**REST)
    holding = holding_effort(crane(), rest.q)
    controller = mpc(crane(), at_rest(crane()), horizon=n, effort_limit=limit)
    model = sampled(crane(), rest, control_period=0.05)
    p = solve_discrete_are(model.a, model.b, Q, R)
    by_start = np.eye(10)
    by_effort = np.zeros((10, 3 * n))
    rows = [np.kron(np.eye(n), cholesky(R))]
    right = [np.zeros(3 * n)]
    z = np.array([0.02, 0.1, 0.08, -0.06, 0.1, 0.0, 0.1, 0.02, 0.02, -0.1])
    for k in range(1, n + 1):
        by_start = model.a @ by_start
        by_effort = model.a @ by_effort
        by_effort[:, 3 * k - 3 : 3 * k] += model.b
        root = cholesky(p if k == n else Q)
        rows.append(root @ by_effort)
        right.append(-root @ by_start @ z)
    scale = np.tile(limit, n)
    best = lsq_linear(
        np.vstack(rows) * scale,
        np.concatenate(right),
        bounds=(np.tile(-limit - holding, n) / scale, np.tile(limit - holding, n) / scale),
        tol=1e-14,
    )
    found = controller(0.0, state_of(np.concatenate(rest) + z), STILL)
    assert (
        (np.abs(best.x * scale + np.tile(holding, n)).reshape(n, 3) > 0.999 * limit)
        .any(axis=0)[:2]
        .all()
    )
    # lsq_linear's stopping rule.
    np.testing.assert_allclose(found, holding + best.x[:3] * limit, rtol=1e-5)


@pytest.mark.slow
def test_where_the_lqr_saturates_and_overspeeds_it_keeps_force_and_rate() -> None:
    weak = crane(trolley_effort=2000.0)
    motion = at_rest(weak)
    start = weak.state(**REST, phi=0.15)
    free = quickly(weak, lqr(weak, motion), motion, start=start, duration=20.0)
    assert np.abs(free.command[:, 1]).max() > 5.0 * 2000.0
    assert rates(free)[1] > 1.5 * 0.4
    controller = mpc(weak, motion, rate_limit=(0.05, 0.4, 0.5))
    run = quickly(weak, controller, motion, start=start, duration=40.0)
    # Met, and kept to rounding.
    assert np.abs(run.command[:, 1]).max() == pytest.approx(2000.0, rel=1e-9)
    # the model is linear: at 0.15 rad the pull of the load is 1 - φ²/2 of it, a hundredth less
    assert rates(run)[1] == pytest.approx(0.4, rel=0.011)
    assert np.abs(run.q[-200:, 2]).max() < 1e-3


@pytest.mark.long
@pytest.mark.parametrize(
    "values",
    [
        {"rope_stiffness": 1e7, "rope_damping": 500.0},
        {"rope_stiffness": math.inf},
        {"fall_spacing": 1.0, "payload_inertia": 200.0},
    ],
)
def test_on_a_rope_that_stretches_or_goes_slack_and_on_two_falls_it_does_so_too(
    values: dict[str, float],
) -> None:
    # The model is linear in all coordinates: the stretch and the yaw are two of them.
    weak = crane(trolley_effort=2000.0, **values)
    start = weak.state(**REST, phi=0.15)
    motion = at_rest(weak)
    controller = mpc(weak, motion, rate_limit=(0.05, 0.4, 0.5))
    run = quickly(weak, controller, motion, start=start, duration=40.0)
    assert np.abs(run.command[:, 1]).max() == pytest.approx(2000.0, rel=1e-9)
    # The hundredth of the pull that the linear model lacks comes at once as the load is let go, so
    # that a rope that stretches overshoots it: twice of it.
    assert rates(run)[1] == pytest.approx(0.4, rel=2.0 * 0.011)
    assert np.abs(run.q[-200:, 2]).max() < 1e-3


@pytest.mark.slow
def test_a_swing_beyond_its_bound_is_no_contradiction_and_is_brought_within() -> None:
    motion = at_rest(crane())
    start = crane().state(**REST, phi=0.12, theta=0.12)
    efforts = (4e4, 2e3, 1.2e4)
    speeds = (0.03, 0.4, 0.5)
    controller = mpc(crane(), motion, effort_limit=efforts, rate_limit=speeds, swing_limit=0.1)
    excess = []

    def noting(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        command = controller(t, state, setpoint)
        assert controller.last is not None
        assert controller.last.flag == 1
        excess.append(controller.last.excess)
        return command

    run = quickly(crane(), noting, motion, start=start, duration=20.0)
    assert (excess[0][3:] > 0.15).all()  # of 0.12 at first, a little less after the first period
    assert np.max(excess[300:]) < 1e-9  # the solver's tolerance
    # from then on within it, by what the linear model leaves out: φ² + θ² = 0.03 in halves and
    # quarters
    assert np.abs(run.since(1.5).q[:, 2:4]).max() < 0.1 * 1.01
    assert (np.abs(run.command) <= np.array([4e4, 2e3, 1.2e4]) * (1.0 + 1e-9)).all()
    assert (rates(run) <= np.array([0.03, 0.4, 0.5]) * 1.01).all()


@pytest.mark.slow
def test_a_plan_faster_than_the_drives_may_run_is_run_at_their_limits() -> None:
    motion = combined(crane())
    limit = np.array([0.055, 0.95, 0.5])
    assert (np.abs(motion.v[:, motion.drives]).max(axis=0) > 1.1 * limit).all()
    controller = mpc(crane(), motion, rate_limit=limit)
    run = quickly(crane(), controller, motion, start=crane().state(**REST), duration=40.0)
    # met; the model is linear and that of the beginning of each 50 ms, in which the plan changes a
    # rate by up to a hundredth of it
    np.testing.assert_allclose(rates(run), limit, rtol=4e-3)
    assert residual(run) < 1e-3


@pytest.mark.slow
def test_efforts_stay_within_their_limits_between_the_optimisations_too() -> None:
    motion = combined(crane())
    start = crane().state(**REST, phi=0.05, theta=0.05)
    limit = np.array([1.9e4, 5e2, 1.0e4])
    controller = mpc(crane(), motion, effort_limit=limit)
    run = quickly(crane(), controller, motion, start=start, duration=20.0)
    assert (np.abs(run.command) <= limit * (1.0 + 1e-9)).all()  # rounding
    assert (np.abs(run.command).max(axis=0)[:2] > 0.999 * limit[:2]).all()


@pytest.mark.slow
def test_between_optimisations_the_correction_is_held_and_the_feed_forward_goes_on() -> None:
    motion = combined(crane())
    controller = mpc(crane(), motion)
    feed_forward = lqr(crane(), motion).feed_forward
    rng = np.random.default_rng(4)
    when = []
    corrections = []
    for k in range(100, 131):
        z = np.concatenate([motion.q[k], motion.v[k]]) + SIZE * rng.normal(size=10)
        corrections.append(controller(5e-3 * k, state_of(z), STILL) - feed_forward[k])
        assert controller.last is not None
        when.append(controller.last.t)
    np.testing.assert_allclose(sorted(set(when)), [0.5, 0.55, 0.6, 0.65])
    by_period = np.array(corrections[:30]).reshape(3, 10, 3)
    # Rounding of efforts of 1e5.
    np.testing.assert_allclose(by_period, np.repeat(by_period[:, :1], 10, axis=1), atol=1e-9)
    assert np.abs(np.diff(by_period[:, 0], axis=0)).min() > 1.0


def test_a_second_run_does_not_begin_with_what_the_first_held() -> None:
    motion = at_rest(crane())
    c = crane()
    used, other = (mpc(c, motion, effort_limit=(4e4, 2e3, 1.2e4)) for _ in range(2))
    quickly(c, used, motion, start=c.state(**REST, phi=-0.1), duration=0.02)
    second, first = (
        quickly(c, controller, motion, start=c.state(**REST, phi=0.1), duration=0.02)
        for controller in (used, other)
    )
    assert (second.command == first.command).all()


@pytest.mark.slow
def test_it_keeps_its_period_of_50_ms() -> None:
    motion = combined(crane())
    start = crane().state(**REST, phi=0.12, theta=0.12)
    efforts = (6e4, 3e3, 1.2e4)
    speeds = (0.078, 1.28, 0.7)
    controller = mpc(crane(), motion, effort_limit=efforts, rate_limit=speeds, swing_limit=0.12)
    taken = []

    def timed(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        begun = time.process_time()
        command = controller(t, state, setpoint)
        if controller.last is not None and controller.last.t == t:
            taken.append(time.process_time() - begun)
        return command

    quickly(crane(), timed, motion, start=start, duration=10.0)
    assert len(taken) == 201
    assert np.median(taken) < 0.05


# --- refusals -------------------------------------------------------------------------------------


def failing(
    controller: PredictiveController, after: int
) -> Callable[..., tuple[np.ndarray, float, int, dict]]:
    """The controller's solver, which goes in circles from one call on."""
    solve = controller.solve
    calls = iter(range(10**6))
    return lambda *problem: (
        solve(*problem) if next(calls) < after else (np.zeros(125), 0.0, -2, {"iterations": 9})
    )


def test_nothing_is_optimised_where_the_lqr_keeps_all_bounds() -> None:
    motion = at_rest(crane())
    start = crane().state(**REST, phi=0.1)
    runs = []
    for swing_limit, solved in ((math.pi / 2.0, failing), (0.1001, None)):
        controller = mpc(crane(), motion, swing_limit=swing_limit)
        if solved:
            controller.solve = solved(controller, after=0)
        runs.append(quickly(crane(), controller, motion, start=start, duration=1.0))
    assert np.abs(runs[0].q - runs[1].q).max() < 1e-9  # accuracy of DAQP


def test_an_optimisation_that_fails_ends_the_run_and_no_old_command_goes_on() -> None:
    motion = at_rest(crane())
    start = crane().state(**REST, phi=0.1)
    controller = mpc(crane(), motion, swing_limit=0.01)
    controller.solve = failing(controller, after=3)
    with pytest.raises(
        RunError, match=r"At t = 0\.15 s the optimisation of the MPC failed: it goes in circles"
    ) as caught:
        quickly(crane(), controller, motion, start=start, duration=1.0)
    assert caught.value.trajectory is not None
    assert caught.value.trajectory.t[-1] == pytest.approx(0.145)
    assert controller.last is not None
    assert controller.last.flag == -2
    with pytest.raises(CraneError, match="goes in circles"):
        controller(0.155, start, STILL)


@pytest.mark.parametrize(("index", "name"), [(3, "coordinate 4"), (9, "rate 5")])
@pytest.mark.parametrize("controller_of", [lqr, mpc])
def test_a_state_that_is_not_finite_is_named_and_gives_no_efforts(
    controller_of: Callable[..., Controller], index: int, name: str
) -> None:
    controller = controller_of(crane(), at_rest(crane()))
    z = np.concatenate(crane().state(**REST))
    z[index] = math.nan
    with pytest.raises(CraneError, match=f"{name} of the state is nan; allowed is a finite number"):
        controller(0.0, state_of(z), STILL)


def test_a_feed_forward_that_leaves_no_room_for_any_held_correction_is_refused() -> None:
    with pytest.raises(CraneError, match="half of what the feed-forward changes by within a perio"):
        mpc(crane(), combined(crane()), period=1.0, effort_limit=(100.0, 1e4, 2e4))


def test_a_missing_solver_is_said_with_the_command_that_installs_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "daqp", None)
    with pytest.raises(CraneError, match=r"pip install 'cranedyn\[mpc\]'"):
        mpc(crane(), at_rest(crane()))
