"""What the parts of the package say to each other: states, setpoints, and the functions that users
write.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np


class State(NamedTuple):
    """Where the crane is and how it moves.

    Attributes:
        q: Coordinates in the order of the crane's layout [rad or m], shape (n,).
        v: Their rates [rad/s or m/s], shape (n,).
    """

    q: np.ndarray
    v: np.ndarray


class Setpoint(NamedTuple):
    """Where the drives should be and how they should move.

    Attributes:
        position: In the order of the crane's drives [rad or m], shape (m,).
        velocity: Their rates, shape (m,).
        acceleration: Their accelerations, shape (m,).
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray


Reference = Callable[[float], Setpoint]
"""From time [s] to the setpoint then."""


Controller = Callable[[float, State, Setpoint], np.ndarray]
"""From time [s], state and setpoint to one number for each drive: efforts [N m or N], or
accelerations [rad/s² or m/s²] where the drives follow prescribed motion, or rates [rad/s or m/s]
where they have frequency converters. The passive joints cannot be addressed."""


Disturbance = Callable[[float, State], np.ndarray]
"""From time [s] and state to outside forces in the world [N], on the points of the crane, the
payload first, shape (points, 3)."""


Monitor = Callable[[int, float, State], object]
"""Called after each row of a run is logged, with the index of the row, its time [s] and its state.
Where an engine computes blocks of rows at once, it is called for the last of each. It may end the
run by raising an error; the run keeps what was logged."""


Drive = Literal["effort", "motion", "velocity"]
"""How the drives take a command, see `cranedyn.simulation.simulate.simulate`."""


DirectDrive = Literal["effort", "motion"]
"""How drives without a frequency converter take a command."""


Validity = Literal["stop", "buffers", "mark"]
"""What to do where the model ceases to hold: stop; let buffers end the ranges of the drives and
stop at all else; go on and mark it."""


EngineName = Literal["pinocchio", "compiled"]
"""Engines of this package, see `cranedyn.simulation.simulate.simulate`."""
