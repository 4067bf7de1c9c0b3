"""Names of a crane's signals: its coordinates, their rates, and the commands of its drives."""

from __future__ import annotations

from cranedyn.model.crane import Crane


def state_names(crane: Crane) -> list[str]:
    """Return the names of the coordinates, such as x, and then of their rates, such as x_dot."""
    return [*crane.layout.symbols, *(f"{name}_dot" for name in crane.layout.symbols)]


def input_names(crane: Crane, drive: str) -> list[str]:
    """Return the names of the commands of the drives in a drive mode.

    With "effort" they are torques T and forces F, such as F_x, with "motion" accelerations, such as
    x_ddot, and with "velocity" rates, such as x_dot_command.
    """
    driven = crane.layout.driven
    if drive == "effort":
        return [joint.effort_name for joint in driven]
    ending = "ddot" if drive == "motion" else "dot_command"
    return [f"{joint.symbol}_{ending}" for joint in driven]
