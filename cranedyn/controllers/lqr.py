"""Time-varying LQR on the full model: the crane linearised by Pinocchio along the motion to follow,
and the finite-horizon linear-quadratic regulator in discrete time.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
import scipy

from cranedyn.checks import as_array, finite, short_repr, weight_matrix, whole
from cranedyn.clocks import multiple
from cranedyn.controllers.tracking import Tracking
from cranedyn.dynamics.equations_of_motion import linearise
from cranedyn.dynamics.linearisation import held_states, over_period
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.references.motion import Motion, motion_efforts

BRYSON_ERRORS = {
    ("revolute", True): (0.01, 0.05),
    ("prismatic", True): (0.1, 0.5),
    ("revolute", False): (0.01, 0.01),
    ("prismatic", False): (0.1, 0.1),
}
"""Errors that weigh alike, ours, by kind of joint and whether it is driven: of the coordinate [rad
or m] and of its rate [per second]."""

BRYSON_EFFORTS = {"revolute": 2.0e4, "prismatic": 1.0e3}
"""Efforts beyond the feed-forward that weigh alike, ours, by kind of joint [N m or N]."""


class Linearised(NamedTuple):
    """Feed-forward at every row of a motion, and a linear model for each stretch of it.

    Attributes:
        period: Time between rows of the motion [s].
        efforts: Of the drives by inverse dynamics [N m or N], shape (rows, m).
        setpoint: Coordinates and rates, shape (rows, 2 n).
        stretch: Which model is meant for each row, shape (rows,); the last row has one of its own,
            which stands for all that follows.
        a: Deviations after one control period by those before, shape (stretches, 2 n, 2 n).
        b: The same by the efforts held beyond the feed-forward, shape (stretches, 2 n, m).
    """

    period: float
    efforts: np.ndarray
    setpoint: np.ndarray
    stretch: np.ndarray
    a: np.ndarray
    b: np.ndarray

    def row(self, t: float) -> int:
        """Return the row at a time [s]; the first before the beginning, the last after the end."""
        return min(max(round(t / self.period), 0), len(self.efforts) - 1)


def linearised(
    crane: Crane, motion: Motion, *, dt: float, every: int, control_period: float | None = None
) -> Linearised:
    """Linearise a crane along a motion.

    Args:
        crane: The crane.
        motion: What to linearise about.
        dt: Physics step of the simulation [s].
        every: Rows from one linearisation to the next.
        control_period: Time over which efforts are held [s]; by default the motion's period.

    Raises:
        OutOfRange: If the control period is not a multiple of `dt`, or `every` is not at least 1.
    """
    if not isinstance(motion, Motion):
        allowed = "a Motion, such as hanging_reference and flat return"
        raise OutOfRange("motion", short_repr(motion), allowed)
    motion.check_fits("motion", crane.layout)
    hold_time = motion.period if control_period is None else control_period
    steps = multiple("control period", hold_time, "dt", dt)
    every = min(whole("rows between linearisations", every, 1), len(motion.q))
    efforts = motion_efforts(crane, motion)
    last = len(motion.q) - 1
    rows = [*range(0, last, every), last]
    by_state = []
    by_effort = []
    for k in rows:
        row_by_state, row_by_effort = linearise(crane, State(motion.q[k], motion.v[k]), efforts[k])
        by_state.append(row_by_state)
        by_effort.append(row_by_effort)
    taut = held_states(crane, State(motion.q[0], motion.v[0]))
    a, b = over_period(np.array(by_state), np.array(by_effort), dt, steps, taut)
    stretch = np.arange(last + 1) // every
    stretch[-1] = len(rows) - 1
    setpoint = np.hstack([motion.q, motion.v])
    return Linearised(motion.period, efforts, setpoint, stretch, a, b)


class Sweep(NamedTuple):
    """The optimal feedback u = -gain z and what it costs to go from each instant.

    Attributes:
        gain: Shape (n, nu, nz).
        cost: The cost from instant k on is zᵀ cost[k] z, shape (n + 1, nz, nz); the last is the
            final weight.
    """

    gain: np.ndarray
    cost: np.ndarray


def riccati(
    a: np.ndarray,
    b: np.ndarray,
    state_weight: np.ndarray,
    effort_weight: np.ndarray,
    final_weight: np.ndarray | None = None,
) -> Sweep:
    """Return gains and costs-to-go that minimise Σ zᵀQz + uᵀRu + z_nᵀQ_n z_n along z[k+1] = a[k]
    z[k] + b[k] u[k], with u = -gain z.

    The backward sweep of Kwakernaak & Sivan, Linear Optimal Control Systems, §6.4.

    Args:
        a: Shape (n, nz, nz).
        b: Shape (n, nz, nu).
        state_weight: Q, positive semidefinite, shape (nz, nz).
        effort_weight: R, positive definite, shape (nu, nu).
        final_weight: Q_n, positive semidefinite, shape (nz, nz); None for the cost of going on for
            ever with the last a and b.

    Raises:
        OutOfRange: If shapes differ, or a weight is not symmetric or has an eigenvalue that is not
            allowed.
        CraneError: If no final weight is given and there is no stationary feedback, or gains or
            costs cannot be computed in double precision.
    """
    n, nz, nu = as_array("b", b, ("n", "nz", "nu")).shape
    a = finite("a", a, (n, nz, nz))
    b = finite("b", b, (n, nz, nu))
    if not n:
        raise OutOfRange("a", short_repr(a), "one instant or more")
    state_weight = weight_matrix("state weight", state_weight, nz, definite=False)
    effort_weight = weight_matrix("effort weight", effort_weight, nu, definite=True)
    gain = np.empty((n, nu, nz))
    cost = np.empty((n + 1, nz, nz))
    if final_weight is None:
        final_weight = stationary(a[-1], b[-1], state_weight, effort_weight)
        try:
            weight_matrix("cost of going on", final_weight, nz, definite=False)
        except OutOfRange as error:
            # It was computed here: what comes out is no mistake of whoever called.
            raise CraneError(
                "There is no linear-quadratic regulator about the end of this motion: the cost of "
                f"holding the crane there for ever comes out as {error.value}, where only costs "
                "are possible. Start from a rest that is nearer to hanging, or with a shorter "
                "control period."
            ) from error
    cost[-1] = weight_matrix("final weight", final_weight, nz, definite=False)
    with _solvable():
        # With P the cost-to-go of the next instant, the gain is K = (R + BᵀPB)⁻¹ BᵀP A, and the
        # cost-to-go Q + AᵀP (A - B K). It is kept symmetric, since round-off would grow over the
        # sweep.
        for k in range(len(a) - 1, -1, -1):
            input_cost = b[k].T @ cost[k + 1]
            gain[k] = np.linalg.solve(effort_weight + input_cost @ b[k], input_cost @ a[k])
            cost_to_go = state_weight + a[k].T @ cost[k + 1] @ (a[k] - b[k] @ gain[k])
            cost[k] = (cost_to_go + cost_to_go.T) / 2.0
        if not (np.isfinite(gain).all() and np.isfinite(cost).all()):
            raise ValueError("a gain is not finite")
    return Sweep(gain, cost)


def stationary(
    a: np.ndarray, b: np.ndarray, state_weight: np.ndarray, effort_weight: np.ndarray
) -> np.ndarray:
    """Return the cost, shape (nz, nz), of an endless horizon with constant a, shape (nz, nz), and
    b, shape (nz, nu).

    Raises:
        CraneError: If it cannot be computed in double precision.
    """
    with _solvable():
        return scipy.linalg.solve_discrete_are(a, b, state_weight, effort_weight)


@contextmanager
def _solvable() -> Iterator[None]:
    """Raise an error with a message for numbers that overflow or are ill-conditioned."""
    try:
        with np.errstate(all="ignore"):
            yield
    except (np.linalg.LinAlgError, ValueError) as error:
        reason = str(error).strip().partition("\n")[0].rstrip(".")
        raise CraneError(
            "There is no linear-quadratic regulator for this crane: its masses, dampings, gravity "
            f"or control period make numbers that differ too much for double precision ({reason})."
        ) from error


def state_weight_of(crane: Crane) -> np.ndarray:
    """Return Q for coordinates and rates by Bryson's rule, shape (2 n, 2 n): one over the square of
    an error that is as bad as each of the others.
    """
    errors = np.array([BRYSON_ERRORS[joint.kind, joint.driven] for joint in crane.layout.joints])
    return np.diag(1.0 / errors.T.ravel()) ** 2


def effort_weight_of(crane: Crane) -> np.ndarray:
    """Return R for the drives by the same rule, shape (m, m)."""
    return np.diag([1.0 / BRYSON_EFFORTS[joint.kind] for joint in crane.layout.driven]) ** 2


def lqr(
    crane: Crane,
    motion: Motion,
    *,
    dt: float = 5e-4,
    state_weight: np.ndarray | None = None,
    effort_weight: np.ndarray | None = None,
    every: int = 10,
) -> Tracking:
    """Return an LQR about a motion, with the efforts of inverse dynamics fed forward; after the
    motion, the stationary LQR about its end.

    Args:
        crane: The crane.
        motion: What to track; its period is the control period.
        dt: Physics step of the simulation [s].
        state_weight: Q for coordinates and rates, shape (2 n, 2 n); None for `state_weight_of`.
        effort_weight: R for the drives, shape (m, m); None for `effort_weight_of`.
        every: Control instants between linearisations.

    Raises:
        OutOfRange: If R is not positive definite or Q not positive semidefinite, or the motion's
            period is not a multiple of `dt`.
    """
    model = linearised(crane, motion, dt=dt, every=every)
    state_weight = state_weight_of(crane) if state_weight is None else state_weight
    effort_weight = effort_weight_of(crane) if effort_weight is None else effort_weight
    sweep = riccati(model.a[model.stretch], model.b[model.stretch], state_weight, effort_weight)
    return Tracking(motion.period, model.efforts, sweep.gain, model.setpoint)
