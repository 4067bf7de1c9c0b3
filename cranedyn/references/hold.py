"""Stay where you are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cranedyn.interfaces import Reference, Setpoint, State
from cranedyn.model.crane import Crane


@dataclass(frozen=True, eq=False)
class Still:
    """A reference that does not move.

    Attributes:
        setpoint: What it always says.
    """

    setpoint: Setpoint

    def __call__(self, t: float) -> Setpoint:
        """Return the setpoint at a time [s]."""
        return self.setpoint

    def at(self, times: np.ndarray) -> Setpoint:
        """Return setpoints at many times [s], shape (n, m) each."""
        return Setpoint(
            *(
                np.broadcast_to(component, (len(times), len(component)))
                for component in self.setpoint
            )
        )


def hold(crane: Crane, state: State | None = None) -> Reference:
    """Keep the drives of a crane where a state has them; None for where it starts."""
    position = crane.layout.as_state("state", crane.start if state is None else state).q[
        crane.layout.drives
    ]
    setpoint = Setpoint(position, np.zeros_like(position), np.zeros_like(position))
    for component in setpoint:
        component.flags.writeable = False  # one for the whole run, and handed to whoever asks
    return Still(setpoint)
