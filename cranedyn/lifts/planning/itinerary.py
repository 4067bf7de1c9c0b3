"""Tours of several legs, repeated for ever: drives that move at limited rates and stand still, or
planned motions of all joints, which tracking controllers and shaped drives go by.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from cranedyn.checks import number
from cranedyn.clocks import intervals
from cranedyn.errors import OutOfRange, quoted
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.references.motion import Motion
from cranedyn.references.tabulated import Tabulating


class Leg:
    """Where to go next.

    Attributes:
        name: What the leg is called.
        targets: Positions to reach [rad or m], by the symbol of the drive; the others stay.
    """

    def __init__(self, name: str, **targets: float) -> None:
        self.name = name
        self.targets = targets


def leg_target(crane: Crane, leg: Leg, origin: np.ndarray) -> np.ndarray:
    """Return the position of the drives after a leg, shape (m,).

    Raises:
        UnknownName: If it names no drive.
        OutOfRange: If a target is no finite number.
    """
    target = origin.copy()
    for symbol, value in leg.targets.items():
        target[crane.layout.drive(symbol)] = number(f"{symbol} of leg {quoted(leg.name)}", value)
    return target


class Stage(NamedTuple):
    """A leg with its times since the start of a cycle.

    Attributes:
        leg: The leg.
        origin: Where the drives come from, shape (m,).
        target: Where they go, shape (m,).
        begin: When they leave [s].
        arrival: When the slowest of them is there [s].
        end: When the next leg begins [s].
    """

    leg: Leg
    origin: np.ndarray
    target: np.ndarray
    begin: float
    arrival: float
    end: float


ARTICLE_TOUR = (
    Leg("trolley out to the tip", x=20.0),
    Leg("lower", l=24.0),
    Leg("hoist", l=10.0),
    Leg("trolley in to the mast", x=6.0),
    Leg("slew right", gamma=0.6),
    Leg("slew left, trolley out and lower together", gamma=-0.6, x=16.0, l=20.0),
    Leg("back to the front", gamma=0.0, x=10.0, l=15.0),
)
"""The seven legs of the demonstration of Muddassir et al. (ISARC 2024). The article does not give
the targets of the sixth; those here are this project's."""


@dataclass(frozen=True, eq=False)
class Timetable(Tabulating):
    """A reference in stages that are repeated for ever.

    Attributes:
        stages: The stages of one cycle.
    """

    stages: tuple[Stage, ...]

    @property
    def duration(self) -> float:
        """Length of one cycle [s]."""
        return self.stages[-1].end

    def stage(self, t: float) -> tuple[Stage, float]:
        """Return the stage under way at a time [s], and the time at which its cycle began [s]."""
        cycle = t // self.duration * self.duration
        for stage in self.stages:
            if t - cycle < stage.end:
                return stage, cycle
        # By rounding a time may lie behind the last stage of its cycle.
        return self.stages[-1], cycle


@dataclass(frozen=True, eq=False)
class Itinerary(Timetable):
    """A timetable in which every drive moves at its rate until it is there.

    Attributes:
        rates: Largest rates of the drives [rad/s or m/s], shape (m,).
    """

    rates: np.ndarray

    @cached_property
    def _tables(self) -> _StageTables:
        """The stages as tables."""
        return _StageTables(
            origins=np.array([stage.origin for stage in self.stages]),
            targets=np.array([stage.target for stage in self.stages]),
            begins=np.array([stage.begin for stage in self.stages]),
            ends=np.array([stage.end for stage in self.stages]),
        )

    def at(self, times: np.ndarray) -> Setpoint:
        """Return setpoints at many times [s], shape (n, m) each. Accelerations are zero: the rates
        jump.
        """
        tables = self._tables
        cycle_times = times - times // self.duration * self.duration
        stage = np.searchsorted(tables.ends, cycle_times, side="right")
        stage = np.minimum(stage, len(tables.ends) - 1)  # as in `stage`
        origin = tables.origins[stage]
        way = tables.targets[stage] - origin
        length = np.abs(way)
        direction = np.sign(way)
        travelled = np.outer(cycle_times - tables.begins[stage], self.rates)
        position = origin + direction * np.minimum(travelled, length)
        velocity = direction * self.rates * (travelled < length)
        return Setpoint(position, velocity, np.zeros_like(way))


class _StageTables(NamedTuple):
    """Stages as tables, a row for each.

    Attributes:
        origins: Where the drives come from, shape (k, m).
        targets: Where they go, shape (k, m).
        begins: When they leave [s], shape (k,).
        ends: When the next leg begins [s], shape (k,).
    """

    origins: np.ndarray
    targets: np.ndarray
    begins: np.ndarray
    ends: np.ndarray


@dataclass(frozen=True, eq=False)
class Tour(Timetable):
    """A timetable of planned motions.

    Attributes:
        motion: One cycle of it.
    """

    motion: Motion

    def at(self, times: np.ndarray) -> Setpoint:
        """Return setpoints at many times [s], shape (n, m) each."""
        return self.motion.at(times % self.duration)


def itinerary(
    crane: Crane, start: State, legs: Sequence[Leg], *, rates: Sequence[float], dwell: float
) -> Itinerary:
    """Plan a tour that begins where the drives are.

    Args:
        crane: The crane.
        start: Where the drives are.
        legs: Where to go; the last must lead back to the start.
        rates: Rates of the drives [rad/s or m/s], shape (m,). A rate above the crane's own is
            replaced by that.
        dwell: How long to stand still after each leg [s].

    Raises:
        OutOfRange: For a rate that is not positive, a negative dwell, no leg at all, or a tour that
            does not end where it began.
    """
    start = crane.layout.as_state("start", start)
    limits = np.minimum(crane.layout.for_drives("rate", rates, "/s", "> 0"), crane.rate_limit)
    number("dwell", dwell, "s", ">= 0")
    stages: list[Stage] = []
    position = start.q[crane.layout.drives]
    t = 0.0
    for leg in legs:
        target = leg_target(crane, leg, position)
        with np.errstate(over="ignore"):  # an infinite time is refused by the next line
            duration = float(np.max(np.abs(target - position) / limits))
        number(f"time that leg {quoted(leg.name)} takes at these rates", duration, "s")
        arrival = t + duration
        stages.append(Stage(leg, position, target, t, arrival, arrival + dwell))
        position = target
        t = arrival + dwell
    _check_cycle(stages)
    return Itinerary(tuple(stages), limits)


def tour(
    crane: Crane, legs: Sequence[Leg], plan: Callable[[State, State], Motion], *, dwell: float
) -> Tour:
    """Plan a tour leg by leg, from where the crane starts and back.

    Args:
        crane: The crane.
        legs: Where to go; the last must lead back to the start.
        plan: The motion from one rest to another.
        dwell: How long to stand still after each leg [s].

    Raises:
        OutOfRange: For a target out of the crane's ranges, a negative dwell, no leg at all, motions
            of different periods, or a tour that does not end where it began.
    """
    number("dwell", dwell, "s", ">= 0")
    drives = crane.layout.drives
    symbols = [joint.symbol for joint in crane.layout.driven]
    stages: list[Stage] = []
    motions: list[Motion] = []
    state = crane.start
    row = 0
    for leg in legs:
        target = leg_target(crane, leg, state.q[drives])
        goal = crane.state(**dict(zip(symbols, target.tolist(), strict=True)))
        motion = plan(state, goal)
        motion.check_fits("motion that was planned", crane.layout)
        if motions and motion.period != motions[0].period:
            # The rows of all legs become one table with one period.
            raise OutOfRange(
                f"period of the motion of leg {quoted(leg.name)}",
                motion.period,
                f"that of the legs before it, {motions[0].period:g}",
                "s",
            )
        dwell_rows = intervals("dwell", dwell, motion.period) if dwell > 0.0 else 0
        motions.append(_dwelling(motion, goal, dwell_rows))

        arrival_row = row + len(motion.q) - 1
        end_row = arrival_row + dwell_rows
        stages.append(
            Stage(
                leg,
                origin=state.q[drives],
                target=goal.q[drives],
                begin=motion.period * row,
                arrival=motion.period * arrival_row,
                end=motion.period * end_row,
            )
        )
        state = goal
        row = end_row
    _check_cycle(stages)
    # The last row of a leg is the first of the next. Only the last leg keeps its own.
    at_rest = np.zeros((1, crane.layout.n))
    cycle = Motion(
        motions[0].period,
        np.concatenate([*(motion.q[:-1, :] for motion in motions), state.q[None]]),
        np.concatenate([*(motion.v[:-1, :] for motion in motions), at_rest]),
        np.concatenate([*(motion.a[:-1, :] for motion in motions), at_rest]),
        drives,
    )
    return Tour(tuple(stages), cycle)


def _dwelling(motion: Motion, goal: State, count: int) -> Motion:
    """Return a motion whose last row is its goal, at rest, followed by a count of such rows."""
    at_rest = np.zeros((count + 1, len(goal.q)))
    return Motion(
        motion.period,
        np.concatenate([motion.q[:-1, :], np.tile(goal.q, (count + 1, 1))]),
        np.concatenate([motion.v[:-1, :], at_rest]),
        np.concatenate([motion.a[:-1, :], at_rest]),
        motion.drives,
    )


def _check_cycle(stages: Sequence[Stage]) -> None:
    """Check that stages take time and lead back to where they began."""
    if not stages or stages[-1].end == 0.0:
        raise OutOfRange("tour", "empty", "one leg at least that moves or dwells")
    first = stages[0].origin
    last = stages[-1].target
    if not np.allclose(last, first):
        allowed = f"where it began, {first.tolist()}"
        raise OutOfRange("end of the tour", last.tolist(), allowed, "rad or m")
