"""Validity of the model: joints within their ranges, a rope in tension, a load above the ground
and below the jib.

The tension is the sum of the forces of the hoist and of the buffers at the ends of the cable. At
the shortest cable the trolley can push the hook block down, but a rope cannot push the load: where
hoist and buffer together push, the model does not hold.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import reduce
from itertools import chain
from operator import and_
from typing import Any, NamedTuple

import numpy as np

from cranedyn.checks import as_array
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.bodies import heights, numeric_bodies
from cranedyn.dynamics.drives import cable_buffers
from cranedyn.dynamics.joint_forces import JointForces, tension_from_hoist_force
from cranedyn.model.crane import Crane
from cranedyn.model.layout import Layout


class Bound(NamedTuple):
    """Condition low <= value <= high, or low < value without an upper bound.

    Attributes:
        joint: Index of the joint concerned among the coordinates.
        value: Bounded quantity [rad, m or N].
        low, high: The bounds; no upper one where that is None.
        strict: Whether the bound itself is excluded.
        words: Message of a violation, without its time.
    """

    joint: int
    value: Any
    low: Any
    high: Any
    strict: bool
    words: str

    @property
    def conditions(self) -> list[Any]:
        """Comparisons that must be true."""
        above = self.value > self.low if self.strict else self.value >= self.low
        return [above] if self.high is None else [above, self.value <= self.high]

    @property
    def holds(self) -> np.ndarray:
        """Whether the condition holds at each row."""
        return reduce(and_, self.conditions)


_ROUND_OFF = 1.0 + 1e-9


def bounds(
    layout: Layout,
    limits: Any,
    q: np.ndarray,
    v: np.ndarray,
    swings: Mapping[int, Any],
    tension: Any,
    height: Any,
    *,
    buffers: bool,
    needed: Any,
    rates: bool,
    rope: Sequence[int] | None,
    level: float,
) -> Iterator[Bound]:
    """Yield the conditions that a state must meet, in any kind of number.

    Args:
        layout: Joints of the crane.
        limits: The crane, or its plant: ranges of the joints and limits of the drives.
        q: Coordinates, n numbers.
        v: Their rates, n numbers.
        swings: Swing angles from where the load hangs [rad], by index among the coordinates.
        tension: Tension of the rope [N]; None without a hoist.
        height: Height of the payload [m].
        buffers: See `conditions`.
        needed: See `conditions`, m numbers.
        rates: See `conditions`.
        rope: Indices of the stretch and of the length of a rope that may go slack; None for one
            that may not.
        level: Height of the ground [m].
    """
    for i, joint in enumerate(layout.joints):
        message = (
            f"{joint.name} is at {{value:.6g}} {joint.unit}, its range is {{low:.6g}} to "
            f"{{high:.6g}} {joint.unit}"
        )
        if joint.passive and joint.kind == "revolute":
            yield Bound(i, swings.get(i, q[i]), -math.pi / 2, math.pi / 2, False, message)
        if not (joint.driven and buffers):
            yield Bound(i, q[i], limits.lower[i], limits.upper[i], False, message)
    if rope is not None:
        distance = q[rope[0]] + q[rope[1]]
        yield Bound(rope[0], distance, 0.0, None, True, "the load is {value:.6g} m below its pivot")
    elif tension is not None:
        slack = (
            "the rope would have to push, its tension is {value:.6g} N; a rope goes slack, as with "
            "rope_stiffness = inf"
        )
        yield Bound(layout.role("hoist", "The rope"), tension, 0.0, None, True, slack)
    message = "the payload is at a height of {value:.6g} m, below the ground"
    yield Bound(layout.n - 1, height, level, None, False, message)
    for i, joint in enumerate(layout.driven):
        index = int(layout.drives[i])
        checks = list[tuple[Any, Any, str, str, str]]()
        if needed is not None:
            largest = limits.effort_limit[i]
            checks.append((needed[i], largest, "would need", "has", joint.effort_unit))
        if rates:
            checks.append((v[index], limits.rate_limit[i], "moves at", "at", f"{joint.unit}/s"))
        for value, largest, verb, ability, unit in checks:
            limit = largest * _ROUND_OFF
            message = (
                f"{{value:.6g}} {unit}, its drive {ability} {{low:.6g}} to {{high:.6g}} {unit}"
            )
            yield Bound(index, value, -limit, limit, False, f"{joint.name} {verb} {message}")


class Event(NamedTuple):
    """Row at which the model ceases to hold.

    Attributes:
        row: Index of the row.
        joint: Name of the joint concerned.
        value: Value that violates the condition [rad, m or N].
        words: Message, without its time.
    """

    row: int
    joint: str
    value: float
    words: str


def conditions(
    crane: Crane,
    q: np.ndarray,
    v: np.ndarray,
    hoist: np.ndarray,
    *,
    buffers: bool = False,
    needed: np.ndarray | None = None,
    rates: bool = False,
    level: float = 0.0,
) -> list[Bound]:
    """Return the conditions under which the model holds, for many rows.

    Args:
        crane: The crane.
        q: Coordinates, shape (rows, n).
        v: Their rates, shape (rows, n).
        hoist: Force of the hoist and of the buffers at the ends of the cable [N], shape (rows,);
            ignored without a hoist.
        buffers: Whether buffers end the ranges of the drives, so that leaving them a little is
            allowed.
        needed: Efforts needed to follow a motion or a rate [N m or N], shape (rows, m); None for
            drives that take efforts.
        rates: Whether the drives must keep their largest rates; frequency converters keep them by
            themselves.
        level: Height of the ground [m].

    Raises:
        OutOfRange: If an array has another shape.
    """
    q = as_array("q", q, ("rows", crane.layout.n))
    v = as_array("v", v, q.shape)
    hoist = as_array("hoist", hoist, q.shape[:1])
    height = heights(numeric_bodies(crane), q, crane.payload.body, crane.payload.lever)
    tension = tension_from_hoist_force(crane.layout, JointForces.of(crane), q.T, v.T, hoist)
    swings = dict(zip(crane.swings.tolist(), crane.swing_angles(q).T, strict=True))
    if needed is not None:
        needed = as_array("needed", needed, (len(q), crane.layout.m)).T
    rope = crane.springs.rope and crane.springs.rope[:2]
    options: Any = {"buffers": buffers, "needed": needed, "rates": rates, "level": level}
    motion = q.T, v.T, swings, tension, height
    return [*bounds(crane.layout, crane, *motion, rope=rope, **options)]


def valid(state_bounds: Sequence[Bound]) -> np.ndarray:
    """Return whether all `conditions` hold at each row, shape (rows,)."""
    return np.logical_and.reduce([bound.holds for bound in state_bounds])


def first_event(crane: Crane, state_bounds: Sequence[Bound]) -> Event | None:
    """Return the first row at which one of `conditions` does not hold, None if there is none."""
    beginnings = (_beginnings(crane, bound, bound.holds)[:1] for bound in state_bounds)
    return min(chain.from_iterable(beginnings), key=lambda event: event.row, default=None)


def events(crane: Crane, run: Trajectory) -> list[Event]:
    """Return the beginning of every stretch in which the model does not hold, ordered by time."""
    buffers = run.parameters.get("validity") == "buffers"
    hoist = hoisting(crane, run.effort) + (cable_buffers(crane, run.q, run.v) if buffers else 0.0)
    drive = run.parameters.get("drive")
    ground = run.record.get("ground", {})
    needed = run.command if drive in ("motion", "velocity") else None
    options: Any = {"buffers": buffers, "needed": needed, "rates": drive in ("motion", "effort")}
    level = ground.get("height", 0.0)
    state_bounds = conditions(crane, run.q, run.v, hoist, level=level, **options)
    holding = ((bound, bound.holds | (run.valid == 1.0)) for bound in state_bounds)
    return sorted(event for pair in holding for event in _beginnings(crane, *pair))


def hoisting(crane: Crane, effort: np.ndarray) -> np.ndarray:
    """Return the hoist's column of efforts of the drives [N], shape (rows,); zeros without a
    hoist.
    """
    hoist = crane.layout.drive_of("hoist")
    effort = as_array("effort", effort, ("rows", crane.layout.m))
    return np.zeros(len(effort)) if hoist is None else effort[:, hoist]


def _beginnings(crane: Crane, bound: Bound, holds: np.ndarray) -> list[Event]:
    if holds.all():
        return []
    rows = np.flatnonzero(~holds & np.concatenate([[True], holds[:-1]]))
    name = crane.layout.joints[bound.joint].name
    values = np.broadcast_to(bound.value, holds.shape)
    words = bound.words.format
    return [
        Event(int(row), name, float(x), words(value=x, low=bound.low, high=bound.high))
        for row, x in zip(rows, values[rows], strict=True)
    ]
