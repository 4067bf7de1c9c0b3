"""Strategies at other control periods than the default of 5 ms: what they do converges, and nothing
spikes.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cranedyn.controllers.integral import HoistIntegral
from cranedyn.controllers.lqr import lqr
from cranedyn.data.trajectory import Trajectory
from cranedyn.model.load import load_crane
from cranedyn.references import hanging_reference, spline
from cranedyn.references.flat import flat
from cranedyn.simulation.simulate import simulate
from experiments import harness
from experiments.scenarios.moves import RestToRest
from experiments.scenarios.strategies import (
    COMPILED_MPC,
    FLAT,
    LQR,
    MPC,
    PAPER,
    STRATEGIES,
    TO_GOAL,
)
from tests.helpers import FAST

MOVE = RestToRest("short", (0.0, 10.0, 12.0), (0.1, 11.0, 11.0), 8.0)
EACH = 0.02
"""Time between the rows that are compared [s]: the longest control period."""


@cache
def _run(strategy: str, planned: float, period: float) -> Trajectory:
    """A strategy planned for one control period and run at another [s]."""
    if strategy == MPC:
        pytest.importorskip("daqp", reason="extra mpc (daqp) is not installed")
    setup = harness.Setup(control_period=planned, engine=FAST)
    plan = STRATEGIES[strategy](setup, MOVE)
    start = MOVE.ends(setup.crane)[0]
    return simulate(
        setup.crane,
        plan.controller(),
        plan.reference,
        start=start,
        duration=10.0,
        control_period=period,
        drive=plan.drive,
        engine=FAST,
    )


def _apart(one: Trajectory, other: Trajectory) -> float:
    """Largest distance of two runs in any coordinate [m or rad]."""
    rows = (run.q[:: round(EACH / (run.t[1] - run.t[0]))] for run in (one, other))
    return float(np.abs(np.subtract(*rows)).max())


def _peak(run: Trajectory) -> np.ndarray:
    """Largest effort beyond that at the end, shape (3,)."""
    return np.abs(run.effort - run.effort[-1]).max(axis=0)


# "least ..." is an LQR about another motion. The compiled MPC is that of TO_GOAL about a motion.
@pytest.mark.parametrize(
    "strategy",
    [
        pytest.param(name, marks=[pytest.mark.long] * (name in (COMPILED_MPC, TO_GOAL)))
        for name in STRATEGIES
        if not name.startswith("least")
    ],
)
def test_a_finer_loop_does_the_same_the_more_exactly(strategy: str) -> None:
    fine, middle, coarse = (_run(strategy, period, period) for period in (5e-3, 0.01, 0.02))
    # of first order: errors against the fine one in proportion to 5 and 15 ms; up to 0.5 where
    # accelerations jump at their limits
    assert _apart(middle, fine) < 0.5 * _apart(coarse, fine) < 0.5 * 3e-3
    for run in (middle, coarse):
        # feed-forward held for 20 ms lags by 10 ms, which feedback makes up.
        np.testing.assert_allclose(_peak(run), _peak(fine), rtol=0.12)


@pytest.mark.parametrize("strategy", [PAPER, LQR, FLAT, MPC])
@pytest.mark.parametrize(("planned", "period"), [(0.02, 2.5e-3), (5e-3, 4e-3), (5e-3, 0.02)])
def test_a_loop_at_another_period_than_the_rows_of_its_plan_does_not_spike(
    strategy: str, planned: float, period: float
) -> None:
    meant = _run(strategy, planned, planned)
    run = _run(strategy, planned, period)
    assert _apart(run, meant) < 1e-3
    np.testing.assert_allclose(_peak(run), _peak(meant), rtol=0.12)
    # efforts change from one control instant to the next as fast as they are meant to, but not
    # faster
    speeds = [
        np.abs(np.diff(r.effort[2:], axis=0)).max(axis=0) / (r.t[1] - r.t[0]) for r in (run, meant)
    ]
    assert (speeds[0] < 1.3 * speeds[1]).all()


def test_a_flat_motion_in_fine_rows_is_that_in_coarse_ones() -> None:
    crane = load_crane()
    start, goal = MOVE.ends(crane)
    coarse = flat(crane, start, goal, 8.0, period=5e-3)
    for each in (2, 5):
        fine = flat(crane, start, goal, 8.0, period=5e-3 / each)
        for one, other in ((fine.q, coarse.q), (fine.v, coarse.v), (fine.a, coarse.a)):
            # Second derivatives of 20 m round at 1e-16 over the square of 5 ms, which the ends of a
            # spline magnify by 100.
            np.testing.assert_allclose(one[::each], other, rtol=0.0, atol=1e-9)
        # Between the samples they lie on the same curve: second differences of the accelerations go
        # with the square of the period, 5 % for the finite ones. At both ends the jerk begins with
        # a jump, about which a spline rings for some samples.
        few, many = (
            np.abs(np.diff(motion.a, 2, axis=0))[10 * by : -10 * by].max()
            for motion, by in ((coarse, 1), (fine, each))
        )
        assert few / many == pytest.approx(each**2, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("period", [2.5e-3, 0.02])
def test_a_load_heavier_than_believed_ends_where_it_shall_at_any_control_period(
    period: float,
) -> None:
    crane = load_crane()
    heavy = load_crane(payload_mass=1.2 * crane.payload_mass)
    start = heavy.state(gamma=0.0, x=10.0, l=15.01)
    reference = spline(heavy, start, [(0.0, 11.0, 13.0)], [8.0])
    motion = hanging_reference(crane, reference, 8.0)
    made = HoistIntegral(crane, lqr(crane, motion), 4e3, float(crane.effort_limit[2]))
    how = {"start": start, "duration": 20.0, "control_period": period}
    plain = simulate(heavy, replace(made, integral=0.0), motion, **how)
    # The integrator takes 2.5 s; 12 s after the arrival e^-4.8 of 2 kN / 1e4 N/m are left.
    assert abs(plain["l_m"][-1] - 13.0) < 2e-4
    if FAST == "compiled":
        from cranedyn.compiled.batch import simulate_batch

        compiled = simulate(heavy, replace(made, integral=0.0), motion, engine=FAST, **how)
        batch = simulate_batch(heavy, made, motion, **{**how, "start": [start]})
        np.testing.assert_allclose(compiled.q, plain.q, atol=1e-12)  # round-off, here and below
        np.testing.assert_allclose(batch.end.q[0], plain.q[-1], atol=1e-12)
