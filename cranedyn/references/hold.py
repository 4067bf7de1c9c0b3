"""Stay where you are."""

from __future__ import annotations

import numpy as np

from cranedyn.crane import DRIVES, State
from cranedyn.references.wanted import Reference, Wanted


def hold(state: State) -> Reference:
    """Keep the drives where this state has them."""
    wanted = Wanted(state.q[DRIVES], np.zeros(3), np.zeros(3))
    return lambda t: wanted
