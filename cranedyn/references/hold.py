"""Stay where you are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cranedyn.arguments import checked
from cranedyn.interfaces import Reference, Setpoint, State
from cranedyn.model.crane import DRIVES


@dataclass(frozen=True, eq=False)
class Still:
    """A reference that does not move.

    Attributes:
        setpoint: What it always says.
    """

    setpoint: Setpoint

    def __call__(self, t: float) -> Setpoint:
        """The setpoint at a time [s]."""
        return self.setpoint

    def at(self, times: np.ndarray) -> Setpoint:
        """Setpoints at many times [s], shape (n, 3) each."""
        return Setpoint(*(np.broadcast_to(part, (len(times), 3)) for part in self.setpoint))


@checked
def hold(state: State) -> Reference:
    """Keep the drives where this state has them."""
    setpoint = Setpoint(state.q[DRIVES], np.zeros(3), np.zeros(3))
    for part in setpoint:
        part.flags.writeable = False  # one for the whole run, and handed to whoever asks
    return Still(setpoint)
