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

_FAILURES = {
    -1: "its limits contradict each other",
    -2: "it goes in circles",
    -4: "it takes too many iterations",
}


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
    _closed: np.ndarray = field(init=False)
    _steered: np.ndarray = field(init=False)
    _lqr: dict[int, tuple[np.ndarray, np.ndarray]] = field(init=False)

    def __post_init__(self) -> None:
        """Compute the closed-loop matrices of each stretch."""
        self._closed = self.model.a - self.model.b @ self.sweep.gain
        self._steered, self._lqr = self.model.b @ self.root, {}

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return efforts [N m or N], shape (m,).

        Raises:
            RunError: If the optimisation fails.
            OutOfRange: If a coordinate or rate is not finite.
        """
        row, share = locate(t, self.model.period, len(self.model.efforts))
        instant = math.floor(t / self.model.period + ROW_TOLERANCE) // self.ratio
        if instant != self._instant or self.last is None or t <= self.last.t:
            check_finite(state)
            deviation = np.concatenate(state) - interpolate(self.model.setpoint, row, share)
            self._correction = self._optimised(t, instant, deviation)
            self._instant = instant
        return interpolate(self.model.efforts, row, share) + self._correction

    def _optimised(self, t: float, instant: int, deviation: np.ndarray) -> np.ndarray:
        """Return the first correction of the best sequence."""
        stretches = np.minimum(np.arange(instant, instant + self.horizon), len(self.root) - 1)
        k, count, m = int(stretches[0]), len(self.bound), self.root.shape[1]
        if k not in self._lqr:
            self._lqr[k] = self._predicted(stretches, np.eye(len(deviation)), 0)
        efforts, ahead = (by_deviation @ deviation for by_deviation in self._lqr[k])
        low, high = (side[stretches].ravel() - efforts for side in self.correction_limits)
        after = self.ratio * np.arange(instant + 1, instant + self.horizon + 1)
        after = np.minimum(after, len(self.model.setpoint) - 1)
        setpoint = self.model.setpoint[after[:, None], self.bounded]
        offset = (setpoint / self.bound).ravel() + ahead
        correction = -self.sweep.gain[k] @ deviation
        if low.max() <= 0.0 <= high.min() and np.abs(offset).max() <= 1.0:
            # the LQR alone keeps all bounds, so nothing better can be decided
            self.last = Solution(t, 1, 0, np.zeros(count))
            return correction
        efforts, ahead = self._predicted(stretches, deviation[:, None], m)
        slack, none = np.tile(np.eye(count), (self.horizon, 1)), np.full(len(offset), np.inf)
        slacks = np.concatenate([np.zeros((len(efforts), count)), -slack, slack])
        decided = np.concatenate([efforts[:, 1:], ahead[:, 1:], ahead[:, 1:]])
        rows = np.concatenate([slacks, decided], axis=1)
        size = rows.shape[1]
        solution, _, flag, details = self.solve(
            np.eye(size),
            np.concatenate([np.full(count, PENALTY), np.zeros(size - count)]),
            rows,
            np.concatenate([np.full(count, np.inf), high, 1.0 - offset, none]),
            np.concatenate([np.zeros(count), low, -none, -1.0 - offset]),
            np.zeros(count + len(rows), dtype=np.int32),
        )
        self.last = Solution(t, int(flag), int(details["iterations"]), solution[:count])
        if flag != 1:
            why = _FAILURES.get(self.last.flag, "the solver gave up")
            raise RunError(
                f"At t = {t:.4g} s the optimisation of the MPC failed: {why} (flag {flag} of "
                "DAQP).",
                t=t,
            )
        return self.root[k] @ solution[count : count + m] + correction

    def _predicted(
        self, stretches: np.ndarray, z: np.ndarray, free: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return corrections, and bounded quantities over their bounds, over the horizon, for
        deviations in columns and then for each number decided: of each stretch the first `free`.
        """
        width = z.shape[1] + free * self.horizon
        efforts = np.zeros((self.horizon, self.root.shape[1], width))
        ahead = np.zeros((self.horizon, len(self.bound), width))
        for j, k in enumerate(stretches.tolist()):
            now, later = z.shape[1], z.shape[1] + free
            efforts[j, :, :now] = -self.sweep.gain[k] @ z
            efforts[j, :, now:later] = self.root[k][:, :free]
            # it depends on no more of the decision than what came before
            z = np.concatenate([self._closed[k] @ z, self._steered[k][:, :free]], axis=1)
            ahead[j, :, :later] = z[self.bounded]
        ahead /= self.bound[:, None]
        return efforts.reshape(-1, width), ahead.reshape(-1, width)


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
    square = effort_weight + np.swapaxes(model.b, 1, 2) @ sweep.cost[1:] @ model.b
    factors, identity = map(scipy.linalg.cholesky, square), np.eye(layout.m)
    root = np.array([scipy.linalg.solve_triangular(factor, identity) for factor in factors])
    bounded = np.concatenate([layout.n + layout.drives, crane.swings])
    bound = np.concatenate([rates, np.full(len(crane.swings), swing)])
    limits = _correction_limits(model, efforts)
    return PredictiveController(
        model, ratio, int(horizon), sweep, root, limits, bounded, bound, solve
    )


def _correction_limits(model: Linearised, limit: np.ndarray) -> np.ndarray:
    """Return the least and largest corrections that keep the effort limits in each stretch,
    feed-forward included, shape (2, stretches, m).
    """
    stretches = [model.efforts[model.stretch == k] for k in range(len(model.a))]
    low = np.array([-limit - stretch.min(axis=0) for stretch in stretches])
    high = np.array([limit - stretch.max(axis=0) for stretch in stretches])
    if (low > high).any():
        allowed = "at least half of what the feed-forward changes by within a period"
        raise OutOfRange("effort limit", limit.tolist(), allowed)
    return np.stack([low, high])


def _solver() -> Callable[..., tuple[np.ndarray, float, int, dict]]:
    try:
        from daqp import solve
    except ImportError:
        raise CraneError(
            "The MPC needs the solver DAQP; install it with: pip install 'cranedyn[mpc]'"
        ) from None
    return solve
