"""Is the model still a crane here: ranges of the joints, a rope in tension, a load above the ground and below the jib.

The tension is what the load feels: the forces of the hoist and of the buffers at the ends of the cable together. At the shortest cable
the trolley can push the hook block down, but no rope passes that on to the load: where hoist and buffer together push, the model ceases to
hold.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from cranedyn.arguments import checked
from cranedyn.arrays import shaped
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.drives import cable_buffers
from cranedyn.dynamics.pinocchio import pivot_position
from cranedyn.interfaces import UNITS
from cranedyn.model.crane import JOINTS, PASSIVE, Crane


class Event(NamedTuple):
    """The model ceases to hold.

    Attributes:
        row: Row of the log.
        joint: Name of the joint concerned.
        value: What was found there [rad, m or N].
        words: What happened, as the end of a sentence that names the time.
    """

    row: int
    joint: str
    value: float
    words: str


class _Condition(NamedTuple):
    joint: str
    values: np.ndarray
    holds: np.ndarray
    words: str


@checked
def first_event(crane: Crane, q: np.ndarray, v: np.ndarray, hoist: np.ndarray, *, buffers: bool = False) -> Event | None:
    """The first row at which the model does not hold, None if there is none.

    Args:
        crane: The crane.
        q: Coordinates, shape (n, 5).
        v: Their rates, shape (n, 5).
        hoist: Force of the hoist, and of the buffers at the ends of the cable [N], shape (n,).
        buffers: Whether the ranges of the drives are kept by buffers, so that leaving them a little is no event.

    Raises:
        OutOfRange: If an array has another shape.
    """
    found = [event for condition in _conditions(crane, q, v, hoist, buffers) for event in _beginnings(condition)[:1]]
    return min(found, key=lambda event: event.row, default=None)


@checked
def events(crane: Crane, run: Trajectory) -> list[Event]:
    """Every beginning of a stretch in which the model does not hold, in the order of time."""
    buffers = run.parameters.get("validity") == "buffers"
    hoist = run.effort[:, 2] + (cable_buffers(crane, run.q, run.v) if buffers else 0.0)
    conditions = _conditions(crane, run.q, run.v, hoist, buffers)
    known = [condition._replace(holds=condition.holds | (run.valid == 1.0)) for condition in conditions]
    return sorted(event for condition in known for event in _beginnings(condition))


@checked
def valid(crane: Crane, q: np.ndarray, v: np.ndarray, hoist: np.ndarray, *, buffers: bool = False) -> np.ndarray:
    """Whether the model holds at each row, shape (n,); arguments as of `first_event`.

    Raises:
        OutOfRange: If an array has another shape.
    """
    return np.logical_and.reduce([condition.holds for condition in _conditions(crane, q, v, hoist, buffers)])


def _conditions(crane: Crane, q: np.ndarray, v: np.ndarray, hoist: np.ndarray, buffers: bool) -> Iterator[_Condition]:
    q = shaped("q", q, ("n", 5))
    v, hoist = shaped("v", v, q.shape), shaped("hoist", hoist, q.shape[:1])
    for i, joint in enumerate(JOINTS):
        low, high = float(crane.lower[i]), float(crane.upper[i])
        if i in PASSIVE:
            low, high = max(low, -math.pi / 2), min(high, math.pi / 2)
        elif buffers:
            continue
        words = f"{joint.name} is at {{value:.6g}} {UNITS[i]}, its range is {low:.6g} to {high:.6g} {UNITS[i]}"
        yield _Condition(joint.name, q[:, i], (q[:, i] >= low) & (q[:, i] <= high), words)
    tension = crane.damping[4] * v[:, 4] - hoist
    yield _Condition(JOINTS[4].name, tension, tension > 0.0, "the rope would have to push, its tension is {value:.6g} N; a rope goes slack")
    height = float(pivot_position(crane, crane.start.q)[2]) - q[:, 4] * np.cos(q[:, 2]) * np.cos(q[:, 3])
    yield _Condition(JOINTS[4].name, height, height >= 0.0, "the payload is at a height of {value:.6g} m, below the ground")


def _beginnings(condition: _Condition) -> list[Event]:
    holds = condition.holds
    if holds.all():
        return []
    rows = np.flatnonzero(~holds & np.concatenate([[True], holds[:-1]]))
    return [
        Event(int(row), condition.joint, float(condition.values[row]), condition.words.format(value=condition.values[row])) for row in rows
    ]
