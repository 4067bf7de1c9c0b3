"""What stands where in the memory that compiled loops share with Python."""

from __future__ import annotations

import numpy as np

from cranedyn.compiled.code import DOUBLE, INTEGER, POINTER

STATE = {"q": 5, "v": 5, "integral": 3, "last_command": 3, "buffers": 1}
"""What a crane is at a control instant: coordinates, rates, integrals of the controller, the last command, work of the buffers."""

LAW = {"feed_forward": 3, "gain": 30, "integral_gain": 3, "limit": 3}
"""One row of a controller that is affine in the state."""

AIM = {"setpoint": 10, "position": 3}
"""One row of what it is about: coordinates and rates, and the setpoint of the drives."""

FORCE = {"force": 6}
"""One row of outside forces, on payload and trolley."""

ROW = {"q": 5, "v": 5, "command": 3, "effort": 3, "before": 3, "energy": 1, "buffers": 1, "stop_force": 1}
"""One row of the log."""

SUMMARY = {"peak": 1, "residual": 1, "invalid": 1, "effort": 3}
"""What is kept of a whole run: squares of the largest swing and of the largest amplitude from a row on, the first row at which the model
does not hold, and the largest efforts."""


def size(layout: dict[str, int]) -> int:
    """How many numbers a layout has."""
    return sum(layout.values())


def places(layout: dict[str, int]) -> dict[str, slice]:
    """Where each part of a layout stands."""
    ends = np.cumsum(list(layout.values())).tolist()
    return {name: slice(end - count, end) for (name, count), end in zip(layout.items(), ends, strict=True)}


CALL = {
    POINTER: ("state", "numbers", "offset", "law", "aim", "force", "starts", "log", "summary"),
    INTEGER: ("law_rows", "aim_rows", "force_rows", "first", "last", "end", "steps", "small", "every", "after", "going_on"),
    DOUBLE: ("dt", "period"),
}
"""What a call of the loop gives, eight bytes each. Addresses: memory of a group of lanes, tables, where each lane's tables start [rows].
Whole numbers: rows of the tables; control instants from the first up to, but without, the last, of which that at the end is not followed by
steps; steps in a period; small steps in a step where buffers act; instants for a row of the log; instant from which a swing is residual;
1 where the first instant was begun before and goes on with steps, else 0. Times [s]."""

SLOTS = {name: slot for slot, name in enumerate(name for names in CALL.values() for name in names)}
