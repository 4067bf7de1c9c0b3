"""What the signals of a crane are called in other people's tools."""

from __future__ import annotations

from cranedyn.interfaces import COORDINATES, UNITS
from cranedyn.model.crane import DRIVES, Crane


def state_names(crane: Crane) -> list[str]:
    """Names of coordinates and rates, such as x and x_dot, in the order of z."""
    return [*COORDINATES, *(f"{name}_dot" for name in COORDINATES)]


def input_names(crane: Crane, drive: str) -> list[str]:
    """Names of the commands: torque T or force F of each drive, such as F_x, or with "motion" its acceleration, such as x_ddot."""
    driven = [(COORDINATES[i], "T" if UNITS[i] == "rad" else "F") for i in DRIVES]
    return [f"{effort}_{name}" if drive == "effort" else f"{name}_ddot" for name, effort in driven]
