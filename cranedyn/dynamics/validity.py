"""Validity of the model: joints within their ranges, a rope in tension, swings of less than 90°,
and the centre of the payload above the ground.

The tension is the sum of the forces of the hoist and of the buffers at the ends of the cable. At
the shortest cable the trolley can push the hook block down, but a rope cannot push the load: where
hoist and buffer together push, the model does not hold.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from cranedyn.checks import as_array
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.bodies import bodies_of_crane, heights
from cranedyn.dynamics.drives import cable_buffers
from cranedyn.dynamics.joint_forces import JointForces, rope_tension
from cranedyn.model.crane import Crane
from cranedyn.model.layout import ALIGNED, Layout


class Bound(NamedTuple):
    """Condition low <= value <= high, or low < value, of one number or of many rows.

    Attributes:
        joint: Index of the joint concerned among the coordinates.
        value: Bounded quantity [rad, m or N].
        low: Lower bound.
        high: Upper bound; None where there is none.
        strict: Whether the lower bound itself is excluded.
        words: Message of a violation, without its time. It is a format string with the fields
            value, low and high.
        margin: How far the value may be beyond the bounds by round-off.
    """

    joint: int
    value: Any
    low: Any
    high: Any
    strict: bool
    words: str
    margin: float = 0.0

    @property
    def conditions(self) -> list[Any]:
        """Comparisons that must be true."""
        # Compiled code compares with a bound itself, not with a sum, where there is no margin.
        low = self.low - self.margin if self.margin else self.low
        above = self.value > low if self.strict else self.value >= low
        if self.high is None:
            return [above]
        high = self.high + self.margin if self.margin else self.high
        return [above, self.value <= high]

    @property
    def holds(self) -> np.ndarray:
        """Whether the condition holds at each row, shape (rows,)."""
        return np.logical_and.reduce(self.conditions)


_LIMIT_MARGIN = 1.0 + 1e-9
"""Factor on limits of drives, by which round-off may exceed them."""

_RANGE_MARGIN = 1e-9
"""How far round-off may carry a joint out of its range [rad or m]: a drive that starts at an end of
its range and holds there moves by some 1e-33 m."""


def bounds(
    layout: Layout,
    limits: Any,
    q: np.ndarray,
    v: np.ndarray,
    swings: Mapping[int, Any],
    tension: Any,
    payload: int,
    height: Any,
    *,
    buffers: bool,
    needed: Any,
    rates: bool,
    rope: tuple[int, int] | None,
    level: float,
) -> Iterator[Bound]:
    """Yield the conditions that a state must meet, in any kind of number.

    Args:
        layout: Joints of the crane.
        limits: The crane, or its plant in compiled code. Its attributes ``lower`` and ``upper`` are
            the ranges of the joints, n numbers each, ``effort_limit`` and ``rate_limit`` the limits
            of the drives, m numbers each.
        q: Coordinates, n numbers.
        v: Their rates, n numbers.
        swings: Angles of the swing joints from where they hang [rad], by their indices among the
            coordinates.
        tension: Tension of the rope [N]; None without a hoist. Not used for a rope that may go
            slack.
        payload: Index of the joint that carries the payload.
        height: Height of the centre of the payload in the world [m].
        buffers: Whether buffers end the ranges of the drives, so that leaving them a little is
            allowed.
        needed: Efforts that the drives need to follow a motion or a rate [N m or N], m numbers;
            None for drives that take efforts.
        rates: Whether the drives must keep their largest rates; frequency converters keep them by
            themselves.
        rope: Indices of the stretch and of the length of a rope that may go slack; None for one
            that may not.
        level: Height of the ground in the world [m].
    """
    yield from _joint_ranges(layout, limits, q, swings, buffers=buffers)

    if rope is not None:
        stretch, length = rope
        message = "the load is {value:.6g} m below its pivot"
        yield Bound(stretch, q[stretch] + q[length], 0.0, None, True, message)
    elif tension is not None:
        message = (
            "the rope would have to push, its tension is {value:.6g} N; give the crane "
            "rope_stiffness = inf to let it go slack"
        )
        yield Bound(layout.role("hoist", "The rope"), tension, 0.0, None, True, message)

    message = "the payload is at a height of {value:.6g} m, below the ground"
    yield Bound(payload, height, level, None, False, message)

    for i, joint in enumerate(layout.driven):
        index = int(layout.drives[i])
        if needed is not None:
            limit = limits.effort_limit[i] * _LIMIT_MARGIN
            unit = joint.effort_unit
            message = (
                f"{joint.name} would need {{value:.6g}} {unit} to accelerate as commanded, its "
                f"drive has {{low:.6g}} to {{high:.6g}} {unit}"
            )
            yield Bound(index, needed[i], -limit, limit, False, message)
        if rates:
            limit = limits.rate_limit[i] * _LIMIT_MARGIN
            unit = f"{joint.unit}/s"
            message = (
                f"{joint.name} moves at {{value:.6g}} {unit}, its drive at {{low:.6g}} to "
                f"{{high:.6g}} {unit}"
            )
            yield Bound(index, v[index], -limit, limit, False, message)


def _joint_ranges(
    layout: Layout, limits: Any, q: np.ndarray, swings: Mapping[int, Any], *, buffers: bool
) -> Iterator[Bound]:
    """Yield the conditions on coordinates: swings of less than 90° from where the load hangs, and
    joints inside their ranges, but for those of drives that buffers end. Arguments are those of
    `bounds`.
    """
    for i, joint in enumerate(layout.joints):
        # A joint about the vertical, such as a swivel, turns the load without lifting it.
        if joint.passive and joint.kind == "revolute" and abs(joint.axis[2]) < ALIGNED:
            message = (
                f"{joint.name} swings by {{value:.6g}} rad, beyond 90° from where the load hangs"
            )
            # A passive joint that is no swing, such as an elastic one, counts from its zero.
            yield Bound(i, swings.get(i, q[i]), -math.pi / 2, math.pi / 2, False, message)
        if not (joint.driven and buffers):
            message = (
                f"{joint.name} is at {{value:.6g}} {joint.unit}, its range is {{low:.6g}} to "
                f"{{high:.6g}} {joint.unit}"
            )
            low = limits.lower[i]
            high = limits.upper[i]
            yield Bound(i, q[i], low, high, False, message, margin=_RANGE_MARGIN)


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
        needed: Efforts that the drives need to follow a motion or a rate [N m or N], shape (rows,
            m); None for drives that take efforts.
        rates: Whether the drives must keep their largest rates; frequency converters keep them by
            themselves.
        level: Height of the ground in the world [m].

    Raises:
        OutOfRange: If an array has another shape.
    """
    q = as_array("q", q, ("rows", crane.layout.n))
    v = as_array("v", v, q.shape)
    hoist = as_array("hoist", hoist, q.shape[:1])
    height = heights(bodies_of_crane(crane), q, crane.payload.body, crane.payload.lever)
    tension = rope_tension(crane.layout, JointForces.of(crane), q.T, v.T, hoist)
    swings = dict(zip(crane.swings.tolist(), crane.swing_angles(q).T, strict=True))
    if needed is not None:
        needed = as_array("needed", needed, (len(q), crane.layout.m)).T
    rope = crane.springs.rope
    state_bounds = bounds(
        crane.layout,
        crane,
        q.T,
        v.T,
        swings,
        tension,
        crane.payload.body,
        height,
        buffers=buffers,
        needed=needed,
        rates=rates,
        rope=None if rope is None else (rope.stretch, rope.length),
        level=level,
    )
    return list(state_bounds)


def valid(state_bounds: Sequence[Bound]) -> np.ndarray:
    """Return whether all `conditions` hold at each row, shape (rows,)."""
    return np.logical_and.reduce([bound.holds for bound in state_bounds])


def first_event(crane: Crane, state_bounds: Sequence[Bound]) -> Event | None:
    """Return the first row at which one of `conditions` does not hold, None if there is none."""
    first_events = []
    for bound in state_bounds:
        first_events += _beginnings(crane, bound, bound.holds)[:1]
    return min(first_events, key=lambda event: event.row, default=None)


def events(crane: Crane, run: Trajectory) -> list[Event]:
    """Return the beginnings of all times in which the model does not hold, ordered by time.

    Args:
        crane: The crane of the run.
        run: The run. Rows that it marks as valid count as such.
    """
    buffers = run.parameters.get("validity") == "buffers"
    hoist = hoist_force(crane, run.effort)
    if buffers:
        hoist = hoist + cable_buffers(crane, run.q, run.v)
    drive = run.parameters.get("drive")
    # Of drives that follow a motion or a rate a run records in `command` the effort that they need,
    # see `take_command` of `cranedyn.dynamics.drives`.
    state_bounds = conditions(
        crane,
        run.q,
        run.v,
        hoist,
        buffers=buffers,
        needed=run.command if drive in ("motion", "velocity") else None,
        rates=drive in ("motion", "effort"),
        level=run.record.get("ground", {}).get("height", 0.0),
    )
    found = []
    for bound in state_bounds:
        found += _beginnings(crane, bound, bound.holds | (run.valid == 1.0))
    return sorted(found)


def hoist_force(crane: Crane, effort: np.ndarray) -> np.ndarray:
    """Return the force of the hoist from the efforts of all drives [N], shape (rows,); zeros
    without a hoist.

    Args:
        crane: The crane.
        effort: Efforts of the drives [N m or N], shape (rows, m).
    """
    hoist = crane.layout.drive_of("hoist")
    effort = as_array("effort", effort, ("rows", crane.layout.m))
    return np.zeros(len(effort)) if hoist is None else effort[:, hoist]


def _beginnings(crane: Crane, bound: Bound, holds: np.ndarray) -> list[Event]:
    """Return an event for each row at which a condition does not hold and did so in the row before.

    Args:
        crane: The crane.
        bound: The condition.
        holds: Whether it holds at each row, shape (rows,).
    """
    if holds.all():
        return []
    held_before = np.concatenate([[True], holds[:-1]])
    name = crane.layout.joints[bound.joint].name
    values = np.broadcast_to(bound.value, holds.shape)
    found = []
    for row in np.flatnonzero(~holds & held_before):
        value = values[row]
        message = bound.words.format(value=value, low=bound.low, high=bound.high)
        found.append(Event(int(row), name, float(value), message))
    return found
