"""Stay where you are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cranedyn.arguments import checked
from cranedyn.interfaces import Reference, State, Wanted
from cranedyn.model.crane import DRIVES


@dataclass(frozen=True, eq=False)
class Still:
    """A reference that does not move.

    Attributes:
        wanted: What it always says.
    """

    wanted: Wanted

    def __call__(self, t: float) -> Wanted:
        """What is wanted at a time [s]."""
        return self.wanted

    def at(self, times: np.ndarray) -> Wanted:
        """What is wanted at many times [s], shape (n, 3) each."""
        return Wanted(*(np.broadcast_to(part, (len(times), 3)) for part in self.wanted))


@checked
def hold(state: State) -> Reference:
    """Keep the drives where this state has them."""
    wanted = Wanted(state.q[DRIVES], np.zeros(3), np.zeros(3))
    for part in wanted:
        part.flags.writeable = False  # one for the whole run, and handed to whoever asks
    return Still(wanted)
