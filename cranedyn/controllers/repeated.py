"""A controller for a cycle that is driven again and again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cranedyn.controllers.affine import Affine
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.interfaces import Setpoint, State


@dataclass(frozen=True, eq=False)
class Repeated:
    """A controller that repeats a cycle.

    Attributes:
        controller: The controller of one cycle.
        cycle: Duration of the cycle [s].
    """

    controller: HoistIntegral
    cycle: float

    def begin_run(self, t: float, control_period: float) -> None:
        """Begin a run, see `cranedyn.clocks.Clocked`."""
        self.controller.begin_run(t % self.cycle, control_period)

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return the efforts [N m or N], shape (m,)."""
        return self.controller(t % self.cycle, state, setpoint)

    def affine(self, times: np.ndarray, positions: np.ndarray) -> Affine | None:
        """Return the affine form, see `cranedyn.controllers.affine`."""
        return self.controller.affine(times % self.cycle, positions)

    def resume(self, t: float, integral: np.ndarray) -> None:
        """Resume a run, see `cranedyn.controllers.affine.Stateful`."""
        self.controller.resume(t % self.cycle, integral)
