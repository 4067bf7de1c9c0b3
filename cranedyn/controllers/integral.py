"""An integrator on the hoist: a load of another mass than believed ends where it shall all the same."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cranedyn.controllers.tracking import Tracking
from cranedyn.crane import State
from cranedyn.references import Wanted


@dataclass(eq=False)
class HoistIntegral:
    """A tracking controller whose hoist has an integrator besides; it stops integrating at the limit of the drive (anti-windup).

    It remembers: make a new one for each run.

    Attributes:
        tracking: What it does without the integrator.
        integral_gain: k_i of the hoist [N/(m s)].
        limit: Largest hoist force [N].
        integral: What has been integrated so far [m s].
    """

    tracking: Tracking
    integral_gain: float
    limit: float
    integral: float = field(default=0.0)

    def __call__(self, t: float, state: State, wanted: Wanted) -> np.ndarray:
        """Efforts [N m, N, N], shape (3,)."""
        effort = self.tracking(t, state, wanted)
        error = float(wanted.position[2] - state.q[4])
        integral = self.integral + error * self.tracking.period
        if abs(effort[2] + self.integral_gain * integral) <= self.limit:
            self.integral = integral
        effort[2] += self.integral_gain * self.integral
        return effort
