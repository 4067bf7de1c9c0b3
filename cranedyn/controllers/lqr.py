"""Time-varying LQR on the full model: all five joints, linearised by Pinocchio along the motion to follow."""

from __future__ import annotations

import numpy as np

from cranedyn.arguments import checked
from cranedyn.controllers.linearised import linearised
from cranedyn.controllers.riccati import riccati
from cranedyn.controllers.tracking import Tracking
from cranedyn.model.crane import Crane
from cranedyn.references.motion import Motion

STATE_WEIGHT = np.diag([100.0, 10.0, 100.0, 100.0, 10.0, 20.0, 2.0, 100.0, 100.0, 2.0]) ** 2
"""Q by Bryson's rule, ours: errors that weigh alike are 0.01 rad, 0.1 m, 0.01 rad of swing, and 0.05 rad/s, 0.5 m/s, 0.01 rad/s."""

EFFORT_WEIGHT = np.diag([1.0 / 2.0e4, 1.0 / 1.0e3, 1.0 / 1.0e3]) ** 2
"""R by the same rule, ours: as 20 kN m of slew torque, 1 kN of trolley force and 1 kN of hoist force beyond the feed-forward."""


@checked
def lqr(
    crane: Crane,
    motion: Motion,
    *,
    dt: float = 5e-4,
    state_weight: np.ndarray = STATE_WEIGHT,
    effort_weight: np.ndarray = EFFORT_WEIGHT,
    every: int = 10,
) -> Tracking:
    """LQR about a motion, with the efforts of inverse dynamics fed forward; after it, the stationary LQR about its end.

    Args:
        crane: The crane.
        motion: What to track; its period is the control period.
        dt: Physics step of the simulation [s].
        state_weight: Q for coordinates and rates, shape (10, 10).
        effort_weight: R for slew, trolley, hoist, shape (3, 3).
        every: Control instants between linearisations.

    Raises:
        OutOfRange: If R is not positive definite or Q not positive semidefinite, or the motion's period is not a multiple of `dt`.
    """
    model = linearised(crane, motion, dt=dt, every=every)
    sweep = riccati(model.a[model.stretch], model.b[model.stretch], state_weight, effort_weight)
    return Tracking(motion.period, model.efforts, sweep.gain, model.setpoint)
