"""What the parts of the house say to each other: states, setpoints, and the callables that users write."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np

from cranedyn.arguments import described, taken
from cranedyn.errors import OutOfRange, number

COORDINATES = ("gamma", "x", "phi", "theta", "l")
"""The five coordinates in chain order: slew, trolley radius, radial swing, tangential swing, cable length."""


UNITS = ("rad", "m", "rad", "rad", "m")
"""Unit of each coordinate."""


class State(NamedTuple):
    """Where the crane is and how it moves.

    Attributes:
        q: Slew [rad], trolley radius [m], radial swing [rad], tangential swing [rad], cable length [m]; shape (5,).
        v: Their rates, per second; shape (5,).
    """

    q: np.ndarray
    v: np.ndarray

    @classmethod
    def checked(cls, name: str, value: Any) -> State:
        """A state of five finite coordinates and rates that nobody else can change.

        Args:
            name: Which state it is, for the sentence.
            value: A state, or two sequences of five numbers.

        Raises:
            OutOfRange: If it is none.
        """
        try:
            coordinates, rates = value
        except Exception:  # whatever it is, it is no pair
            raise OutOfRange(name, described(value), "five coordinates and five rates, all numbers") from None
        state = cls(*(taken(name, part, np.ndarray).copy() for part in (coordinates, rates)))
        for kind, part in zip(("coordinates", "rates"), state, strict=True):
            if part.shape != (5,):
                raise OutOfRange(f"{kind} at the {name}", described(part), f"five numbers: {', '.join(COORDINATES)}")
            for coordinate, unit, one in zip(COORDINATES, UNITS, part, strict=True):
                if kind == "rates":
                    number(f"{coordinate} among the rates at the {name}", one, f"{unit}/s")
                else:
                    number(f"{coordinate} at the {name}", one, unit)
            part.flags.writeable = False
        return state


class Setpoint(NamedTuple):
    """Where slew, trolley and hoist should be and how they should move.

    Attributes:
        position: Slew [rad], trolley radius [m], cable length [m], shape (3,).
        velocity: Their rates, shape (3,).
        acceleration: Their accelerations, shape (3,).
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray


Reference = Callable[[float], Setpoint]
"""From time [s] to the setpoint then."""


Controller = Callable[[float, State, Setpoint], np.ndarray]
"""From time [s], state and setpoint to three numbers for slew, trolley and hoist: efforts [N m, N, N], or accelerations
[rad/s², m/s², m/s²] where the drives follow prescribed motion. The passive joints cannot be addressed."""


Disturbance = Callable[[float, State], np.ndarray]
"""From time [s] and state to outside forces in the world [N], on the centre of the payload and on the trolley, shape (2, 3)."""


Drive = Literal["effort", "motion"]
"""How the drives take a command."""


Validity = Literal["stop", "buffers", "mark"]
"""What to do where the model ceases to hold: stop; let buffers end the ranges of the drives and stop at all else; go on and mark it."""


EngineName = Literal["pinocchio", "compiled"]
"""What computes a step."""
