"""Names of a crane's signals in other programs."""

from __future__ import annotations

from cranedyn.model.crane import Crane


def state_names(crane: Crane) -> list[str]:
    """Return the names of coordinates and rates, such as x and x_dot, in the order of z."""
    return [*crane.layout.symbols, *(f"{name}_dot" for name in crane.layout.symbols)]


def input_names(crane: Crane, drive: str) -> list[str]:
    """Return the names of the commands: torque T or force F of each drive, such as F_x, or with
    "motion" its acceleration, such as x_ddot.
    """
    return [
        joint.effort_name if drive == "effort" else f"{joint.symbol}_ddot"
        for joint in crane.layout.driven
    ]


def force_names(crane: Crane) -> list[str]:
    """Return the names of the external forces on each point along each axis of the world, such as
    payload_force_x.
    """
    return [f"{point}_force_{axis}" for point in crane.layout.points for axis in "xyz"]
