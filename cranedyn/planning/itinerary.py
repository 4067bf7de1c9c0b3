"""A tour of several legs: move at limited rates, stand still, move on; again and again."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cranedyn.checks import number
from cranedyn.errors import OutOfRange, quoted
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.crane import Crane


class Leg:
    """Where to go next.

    Attributes:
        name: What the leg is called.
        targets: Positions to reach [rad or m], by the symbol of the drive; the others stay.
    """

    def __init__(self, name: str, **targets: float) -> None:
        self.name, self.targets = name, targets


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
"""The seven legs of the article's demonstration; the targets of the sixth are ours."""


@dataclass(frozen=True, eq=False)
class Timetable(ABC):
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
        return next(
            (stage for stage in self.stages if t - cycle < stage.end), self.stages[-1]
        ), cycle

    @abstractmethod
    def __call__(self, t: float) -> Setpoint:
        """Return the setpoint of the drives at a time [s]."""


@dataclass(frozen=True, eq=False)
class Itinerary(Timetable):
    """A reference that repeats its stages for ever; every drive moves at its rate until it is
    there.

    Attributes:
        rates: Largest rates of the drives [rad/s or m/s], shape (m,).
    """

    rates: np.ndarray

    def __call__(self, t: float) -> Setpoint:
        """Return the setpoint at a time [s]."""
        stage, cycle = self.stage(t)
        path, travelled = stage.target - stage.origin, self.rates * (t - cycle - stage.begin)
        moving = travelled < np.abs(path)
        return Setpoint(
            stage.origin + np.sign(path) * np.minimum(travelled, np.abs(path)),
            np.sign(path) * self.rates * moving,
            np.zeros_like(path),
        )

    def at(self, times: np.ndarray) -> Setpoint:
        """Return setpoints at many times [s], shape (n, m) each."""
        origins, targets = (
            np.array([stage.origin for stage in self.stages]),
            np.array([stage.target for stage in self.stages]),
        )
        begins, ends = (
            np.array([stage.begin for stage in self.stages]),
            np.array([stage.end for stage in self.stages]),
        )
        cycle_times = times - times // self.duration * self.duration
        under_way = np.minimum(np.searchsorted(ends, cycle_times, side="right"), len(ends) - 1)
        path, travelled = (
            (targets - origins)[under_way],
            np.outer(cycle_times - begins[under_way], self.rates),
        )
        moving = travelled < np.abs(path)
        position = origins[under_way] + np.sign(path) * np.minimum(travelled, np.abs(path))
        return Setpoint(position, np.sign(path) * self.rates * moving, np.zeros_like(path))


def itinerary(
    crane: Crane, start: State, legs: Sequence[Leg], *, rates: Sequence[float], dwell: float
) -> Itinerary:
    """Plan a tour that begins where the drives are.

    Args:
        crane: The crane.
        start: Where the drives are.
        legs: Where to go; the last should lead back to the start, else the repetition begins with a
            jump.
        rates: Rates of the drives [rad/s or m/s], shape (m,), at most the crane's own.
        dwell: How long to stand still after each leg [s].

    Raises:
        OutOfRange: For a rate that is not positive, a negative dwell, no leg at all, or a tour that
            does not end where it began.
    """
    start = crane.layout.as_state("start", start)
    limits = np.minimum(crane.layout.for_drives("rate", rates, "/s", "> 0"), crane.rate_limit)
    number("dwell", dwell, "s", ">= 0")
    stages: list[Stage] = []
    position, t = start.q[crane.layout.drives], 0.0
    for leg in legs:
        target = leg_target(crane, leg, position)
        with np.errstate(over="ignore"):
            lasts = float(np.max(np.abs(target - position) / limits))
        arrival = t + number(f"time that leg {quoted(leg.name)} takes at these rates", lasts, "s")
        stages.append(Stage(leg, position, target, t, arrival, arrival + dwell))
        position, t = target, arrival + dwell
    if not stages or t == 0.0:
        raise OutOfRange("tour", "empty", "one leg at least that moves or dwells")
    if not np.allclose(position, start.q[crane.layout.drives]):
        raise OutOfRange(
            "end of the tour",
            position.tolist(),
            f"where it began, {start.q[crane.layout.drives].tolist()}",
            "rad or m",
        )
    return Itinerary(tuple(stages), limits)
