"""Linear model predictive control: the LQR with limits of the drives and of the swing as
constraints.

The decision is the difference c of the efforts from those of the LQR: u = -K z + c. With Riccati's
cost-to-go P at the end of the horizon, completing the square makes the quadratic cost of the future
zᵀPz + Σ cᵀ(R + BᵀPB)c (Kouvaritakis & Cannon, Model Predictive Control, §2). So c = 0 where no
limit is active; elsewhere the efforts depart from the LQR's as little as possible.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import scipy

from cranedyn.checks import ShortRepr, number, whole, within
from cranedyn.clocks import multiple
from cranedyn.controllers.lqr import (
    Linearised,
    Sweep,
    effort_weight_of,
    linearised,
    riccati,
    state_weight_of,
)
from cranedyn.controllers.tracking import check_finite
from cranedyn.errors import CraneError, OutOfRange, RunError
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.references.motion import Motion
from cranedyn.references.tabulated import ROW_TOLERANCE, interpolate, locate

PENALTY = 1e6
"""Cost of exceeding a bound by the bound itself: linear, and far above the cost of the LQR, so that
a bound is exceeded only where the efforts cannot keep it."""

SOLVED = 1
"""Flag of DAQP for a solved programme."""

_FAILURES = {
    -1: "its limits contradict each other",
    -2: "it goes in circles",
    -4: "it takes too many iterations",
}
"""What the flags of DAQP for an unsolved programme mean."""


class _Horizon(NamedTuple):
    """What is predicted over the horizon: a row for each period and quantity.

    Attributes:
        corrections: Corrections of the efforts [N m or N], shape (horizon m, columns).
        bounded: Bounded rates and swings over their bounds, shape (horizon bounds, columns).
    """

    corrections: np.ndarray
    bounded: np.ndarray


class Solution(NamedTuple):
    """The last optimisation.

    Attributes:
        t: Its time [s].
        flag: Flag of the solver; 1 is solved.
        iterations: Number of iterations.
        excess: Excess over the bounds of drive rates and swings over the horizon, as a share of the
            bound, shape (bounds,); zero where they are kept.
    """

    t: float
    flag: int
    iterations: int
    excess: np.ndarray


@dataclass(eq=False, repr=False)
class PredictiveController(ShortRepr):
    """Model predictive control about a motion. Between optimisations the correction of the efforts
    is held, while the feed-forward follows the motion.

    Attributes:
        model: The crane along the motion, one stretch for each period of the controller.
        ratio: Control instants in one period.
        horizon: Length of the horizon [periods].
        sweep: Gain of the LQR for each stretch, and its cost-to-go.
        root: Square root of the inverse of R + BᵀPB for each stretch, shape (stretches, m, m):
            efforts of equal cost.
        correction_limits: Least and largest correction that keeps the effort limits in each
            stretch, shape (2, stretches, m).
        bounded: Indices of the bounded coordinates and rates: rates of the drives, then swings,
            shape (bounds,).
        bound: Their largest values, shape (bounds,).
        solve: Solver of the quadratic programme.
        last: The last optimisation, None before the first.
    """

    model: Linearised
    ratio: int
    horizon: int
    sweep: Sweep
    root: np.ndarray
    correction_limits: np.ndarray
    bounded: np.ndarray
    bound: np.ndarray
    solve: Callable[..., tuple[np.ndarray, float, int, dict]]
    last: Solution | None = None
    _instant: int = -1
    _correction: np.ndarray = field(init=False)
    _closed_loop: np.ndarray = field(init=False)
    _by_decision: np.ndarray = field(init=False)
    # What the LQR alone predicts from a unit deviation, by the stretch at the beginning.
    _by_deviation: dict[int, _Horizon] = field(init=False)

    def __post_init__(self) -> None:
        """Compute the closed-loop matrices of each stretch."""
        # With u = -K z + c and c = root w the deviation moves by z' = (A - B K) z + B root w.
        self._closed_loop = self.model.a - self.model.b @ self.sweep.gain
        self._by_decision = self.model.b @ self.root
        self._by_deviation = {}

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return efforts [N m or N], shape (m,).

        Raises:
            RunError: If the optimisation fails.
            OutOfRange: If a coordinate or rate is not finite.
        """
        row, share = locate(t, self.model.period, len(self.model.efforts))
        instant = math.floor(t / self.model.period + ROW_TOLERANCE) // self.ratio
        # A time that does not increase is that of another run, or of another state.
        if instant != self._instant or self.last is None or t <= self.last.t:
            check_finite(state)
            deviation = np.concatenate(state) - interpolate(self.model.setpoint, row, share)
            self._correction = self._optimised(t, instant, deviation)
            self._instant = instant
        return interpolate(self.model.efforts, row, share) + self._correction

    def _optimised(self, t: float, instant: int, deviation: np.ndarray) -> np.ndarray:
        """Return the first correction of the best sequence [N m or N], shape (m,).

        Args:
            t: Time [s].
            instant: Number of the optimisation from the beginning of the motion.
            deviation: Coordinates and rates less those of the motion, shape (2 n,).

        Raises:
            RunError: If the optimisation fails.
        """
        # Beyond the motion the last stretch holds.
        stretches = np.minimum(np.arange(instant, instant + self.horizon), len(self.root) - 1)
        k = int(stretches[0])
        if k not in self._by_deviation:
            self._by_deviation[k] = self._predicted(stretches, np.eye(len(deviation)), 0)
        corrections = self._by_deviation[k].corrections @ deviation
        bounded = self._by_deviation[k].bounded @ deviation
        low = self.correction_limits[0][stretches].ravel() - corrections
        high = self.correction_limits[1][stretches].ravel() - corrections

        # The bounds hold for the motion and the deviation together, at the end of each period.
        rows = self.ratio * np.arange(instant + 1, instant + self.horizon + 1)
        rows = np.minimum(rows, len(self.model.setpoint) - 1)
        setpoint = self.model.setpoint[rows[:, None], self.bounded]
        offset = (setpoint / self.bound).ravel() + bounded
        correction = -self.sweep.gain[k] @ deviation
        if low.max() <= 0.0 <= high.min() and np.abs(offset).max() <= 1.0:
            # The LQR alone keeps all bounds, so that nothing better can be decided.
            self.last = Solution(t, SOLVED, 0, np.zeros(len(self.bound)))
            return correction
        decision = self._solved(t, stretches, deviation, low, high, offset)
        return self.root[k] @ decision + correction

    def _solved(
        self,
        t: float,
        stretches: np.ndarray,
        deviation: np.ndarray,
        low: np.ndarray,
        high: np.ndarray,
        offset: np.ndarray,
    ) -> np.ndarray:
        """Solve the quadratic programme and return the first decision w, shape (m,).

        The unknowns are the excess s over each bound, shape (bounds,), and the decision w of each
        period, in which c = root w, so that the cost cᵀ (R + BᵀPB) c is |w|². It minimises
        ½ (|s|² + |w|²) + PENALTY Σ s with s ≥ 0, subject to the limits of the efforts, and for each
        bounded quantity y, over its bound, y - s ≤ 1 and y + s ≥ -1.

        Args:
            t: Time [s].
            stretches: Stretches of the motion over the horizon, shape (horizon,).
            deviation: Coordinates and rates less those of the motion, shape (2 n,).
            low: Least corrections beyond the LQR's, shape (horizon m,).
            high: Largest corrections beyond the LQR's, shape (horizon m,).
            offset: Bounded quantities over their bounds under the LQR alone, shape (horizon
                bounds,).

        Raises:
            RunError: If the solver fails.
        """
        m = self.root.shape[1]
        bounds = len(self.bound)
        predicted = self._predicted(stretches, deviation[:, None], m)
        # The first column is that of the deviation, which `low`, `high` and `offset` hold already.
        corrections_by_decision = predicted.corrections[:, 1:]
        bounded_by_decision = predicted.bounded[:, 1:]
        excess = np.tile(np.eye(bounds), (self.horizon, 1))
        no_excess = np.zeros((len(corrections_by_decision), bounds))
        by_excess = np.concatenate([no_excess, -excess, excess])
        by_decision = np.concatenate(
            [corrections_by_decision, bounded_by_decision, bounded_by_decision]
        )
        rows = np.concatenate([by_excess, by_decision], axis=1)
        unknowns = rows.shape[1]
        infinite = np.full(len(offset), np.inf)
        # DAQP takes simple bounds of the first unknowns, here s ≥ 0, before the rows.
        solution, _, flag, details = self.solve(
            np.eye(unknowns),
            np.concatenate([np.full(bounds, PENALTY), np.zeros(unknowns - bounds)]),
            rows,
            np.concatenate([np.full(bounds, np.inf), high, 1.0 - offset, infinite]),
            np.concatenate([np.zeros(bounds), low, -infinite, -1.0 - offset]),
            np.zeros(bounds + len(rows), dtype=np.int32),
        )
        self.last = Solution(t, int(flag), int(details["iterations"]), solution[:bounds])
        if flag != SOLVED:
            why = _FAILURES.get(self.last.flag, "the solver gave up")
            raise RunError(
                f"At t = {t:.4g} s the optimisation of the MPC failed: {why} (flag {flag} of "
                "DAQP).",
                t=t,
            )
        return solution[bounds : bounds + m]

    def _predicted(self, stretches: np.ndarray, z: np.ndarray, decision_size: int) -> _Horizon:
        """Return corrections and bounded quantities over the horizon.

        The first columns are those of some deviations, the others the derivatives by each number
        that is decided, period by period.

        Args:
            stretches: Stretches of the motion over the horizon, shape (horizon,).
            z: Deviations at its beginning, in columns, shape (2 n, deviations).
            decision_size: How many numbers are decided in each period: m, or 0 for the LQR alone.
        """
        width = z.shape[1] + decision_size * self.horizon
        corrections = np.zeros((self.horizon, self.root.shape[1], width))
        bounded = np.zeros((self.horizon, len(self.bound), width))
        for j, k in enumerate(stretches.tolist()):
            # A deviation depends on the decisions of the periods before it only: z grows by the
            # columns of one period in each.
            decided = z.shape[1]
            end = decided + decision_size
            corrections[j, :, :decided] = -self.sweep.gain[k] @ z
            corrections[j, :, decided:end] = self.root[k][:, :decision_size]
            by_decision = self._by_decision[k][:, :decision_size]
            z = np.concatenate([self._closed_loop[k] @ z, by_decision], axis=1)
            bounded[j, :, :end] = z[self.bounded]
        bounded /= self.bound[:, None]
        return _Horizon(corrections.reshape(-1, width), bounded.reshape(-1, width))


def mpc(
    crane: Crane,
    motion: Motion,
    *,
    dt: float = 5e-4,
    period: float = 0.05,
    horizon: int = 40,
    effort_limit: Sequence[float] | np.ndarray | None = None,
    rate_limit: Sequence[float] | np.ndarray | None = None,
    swing_limit: float = math.pi / 2.0,
    state_weight: np.ndarray | None = None,
    effort_weight: np.ndarray | None = None,
) -> PredictiveController:
    """Return model predictive control about a motion, with the efforts of inverse dynamics fed
    forward.

    Efforts always keep their limits. Rates and swing keep theirs at the optimisations, within the
    accuracy of the model, if the efforts allow it; an initial swing may exceed its bound.

    The model is linear in all coordinates, so that springs, the stretch of a rope and the yaw on
    two falls are part of it. For such a crane `cranedyn.references.motion.hanging_reference` makes
    a motion of any reference.

    Args:
        crane: The crane.
        motion: The motion to track; its period is the control period of the feed-forward.
        dt: Physics step of the simulation [s].
        period: Time between optimisations [s], a multiple of the control period.
        horizon: Length of the horizon, in optimisations.
        effort_limit: Largest efforts of the drives [N m or N], shape (m,); by default those of the
            crane.
        rate_limit: Largest rates of the drives [rad/s or m/s], shape (m,), where they shall be less
            than the crane's own.
        swing_limit: Largest swing of each swing joint [rad], up to π/2.
        state_weight: Q for coordinates and rates, shape (2 n, 2 n); None for that of `lqr`.
        effort_weight: R for the drives, shape (m, m); None for that of `lqr`.

    Raises:
        CraneError: If the solver DAQP is not installed.
        OutOfRange: If times do not divide, a limit is not positive, a weight not allowed, the
            horizon not a whole number from 1 on, or the feed-forward changes within a period by
            more than twice a limit.
    """
    solve = _solver()
    whole("horizon", horizon, 1, "periods")
    crane.require_independent_joints("Predictive control")
    layout = crane.layout
    effort_limit = crane.effort_limit if effort_limit is None else effort_limit
    efforts = layout.for_drives("effort limit", effort_limit, None, "> 0")
    rate_limit = crane.rate_limit if rate_limit is None else rate_limit
    rates = np.minimum(layout.for_drives("rate limit", rate_limit, "/s", "> 0"), crane.rate_limit)
    swing = number("swing limit", swing_limit, "rad", "> 0")
    within("swing limit", swing, 0.0, math.pi / 2.0, "rad")
    ratio = multiple("period", period, "the motion's period", motion.period)
    model = linearised(crane, motion, dt=dt, every=ratio, control_period=period)
    state_weight = state_weight_of(crane) if state_weight is None else state_weight
    effort_weight = effort_weight_of(crane) if effort_weight is None else effort_weight
    sweep = riccati(model.a, model.b, state_weight, effort_weight)
    # With R + BᵀPB = UᵀU, root = U⁻¹ makes the cost of a correction c = root w the plain |w|².
    correction_cost = effort_weight + np.swapaxes(model.b, 1, 2) @ sweep.cost[1:] @ model.b
    identity = np.eye(layout.m)
    roots = []
    for cost in correction_cost:
        roots.append(scipy.linalg.solve_triangular(scipy.linalg.cholesky(cost), identity))
    bounded = np.concatenate([layout.n + layout.drives, crane.swings])
    bound = np.concatenate([rates, np.full(len(crane.swings), swing)])
    return PredictiveController(
        model=model,
        ratio=ratio,
        horizon=int(horizon),
        sweep=sweep,
        root=np.array(roots),
        correction_limits=_correction_limits(model, efforts),
        bounded=bounded,
        bound=bound,
        solve=solve,
    )


def _correction_limits(model: Linearised, limit: np.ndarray) -> np.ndarray:
    """Return the least and largest corrections that keep the effort limits in each stretch,
    feed-forward included, shape (2, stretches, m).

    Raises:
        OutOfRange: If the feed-forward changes by more than both limits within a stretch.
    """
    stretches = [model.efforts[model.stretch == k] for k in range(len(model.a))]
    low = np.array([-limit - stretch.min(axis=0) for stretch in stretches])
    high = np.array([limit - stretch.max(axis=0) for stretch in stretches])
    if (low > high).any():
        allowed = "at least half of what the feed-forward changes by within a period"
        raise OutOfRange("effort limit", limit.tolist(), allowed)
    return np.stack([low, high])


def _solver() -> Callable[..., tuple[np.ndarray, float, int, dict]]:
    """Return the function `solve` of DAQP, which is an optional dependency."""
    try:
        from daqp import solve
    except ImportError:
        raise CraneError(
            "The MPC needs the solver DAQP; install it with: pip install 'cranedyn[mpc]'"
        ) from None
    return solve
