"""Time-varying LQR on the full model: all joints, linearised by Pinocchio along the motion to
follow.
"""

from __future__ import annotations

import numpy as np

from cranedyn.controllers.linearised import linearised
from cranedyn.controllers.riccati import riccati
from cranedyn.controllers.tracking import Tracking
from cranedyn.model.crane import Crane
from cranedyn.references.motion import Motion

ERROR = {
    ("revolute", True): (0.01, 0.05),
    ("prismatic", True): (0.1, 0.5),
    ("revolute", False): (0.01, 0.01),
    ("prismatic", False): (0.1, 0.1),
}
"""Errors that weigh alike, ours, by kind of joint and whether it is driven: of the coordinate [rad
or m] and of its rate [per second]."""

EFFORT = {"revolute": 2.0e4, "prismatic": 1.0e3}
"""Efforts beyond the feed-forward that weigh alike, ours [N m or N]."""


def state_weight_of(crane: Crane) -> np.ndarray:
    """Q for coordinates and rates by Bryson's rule, shape (2 n, 2 n)."""
    errors = np.array([ERROR[joint.kind, joint.driven] for joint in crane.layout.joints])
    return np.diag(1.0 / errors.T.ravel()) ** 2


def effort_weight_of(crane: Crane) -> np.ndarray:
    """R for the drives by the same rule, shape (m, m)."""
    return np.diag([1.0 / EFFORT[joint.kind] for joint in crane.layout.driven]) ** 2


def lqr(
    crane: Crane,
    motion: Motion,
    *,
    dt: float = 5e-4,
    state_weight: np.ndarray | None = None,
    effort_weight: np.ndarray | None = None,
    every: int = 10,
) -> Tracking:
    """LQR about a motion, with the efforts of inverse dynamics fed forward; after it, the
    stationary LQR about its end.

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
