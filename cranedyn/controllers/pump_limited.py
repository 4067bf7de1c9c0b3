"""Rates of drives that share a pump, within its flow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cranedyn.checks import ShortRepr
from cranedyn.clocks import Clocked
from cranedyn.dynamics.cylinders import Pump
from cranedyn.interfaces import Controller, Setpoint, State


@dataclass(frozen=True, eq=False, repr=False)
class PumpLimited(ShortRepr):
    """The rates that a controller commands, scaled down where the pump cannot feed them all; for
    `simulate(..., drive="velocity")`.

    The pump limits what is commanded. Drives that lag behind their commands move by what the
    commands of some instants before were, so that the oil they take may pass the flow of the pump
    for the time of that lag.

    Attributes:
        pump: The pump.
        controller: The controller that commands rates.
    """

    pump: Pump
    controller: Controller

    def begin_run(self, t: float, control_period: float) -> None:
        """See `cranedyn.clocks.Clocked`."""
        if isinstance(self.controller, Clocked):
            self.controller.begin_run(t, control_period)

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return rates of the drives [rad/s or m/s], shape (m,)."""
        return self.pump.limited(state.q, self.controller(t, state, setpoint))
