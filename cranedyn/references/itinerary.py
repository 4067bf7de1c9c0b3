"""A tour of several legs: move at limited rates, stand still, move on; again and again."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cranedyn.arguments import checked, of_drives
from cranedyn.errors import OutOfRange, number
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.crane import DRIVES


class Leg(NamedTuple):
    """Where to go next.

    Attributes:
        name: What the leg is called.
        gamma: Slew angle to reach [rad], None to stay.
        x: Trolley radius to reach [m], None to stay.
        l: Cable length to reach [m], None to stay.
    """

    name: str
    gamma: float | None = None
    x: float | None = None
    l: float | None = None  # noqa: E741


class Stage(NamedTuple):
    """A leg with its times since the start of a cycle.

    Attributes:
        leg: The leg.
        origin: Where the drives come from, shape (3,).
        target: Where they go, shape (3,).
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
        """The stage under way at a time [s], and the time at which its cycle began [s]."""
        cycle = t // self.duration * self.duration
        return next((stage for stage in self.stages if t - cycle < stage.end), self.stages[-1]), cycle

    @abstractmethod
    def __call__(self, t: float) -> Setpoint:
        """The setpoint of the drives at a time [s]."""


@dataclass(frozen=True, eq=False)
class Itinerary(Timetable):
    """A reference that repeats its stages for ever; every drive moves at its rate until it is there.

    Attributes:
        rates: Largest rate of slew [rad/s], trolley [m/s], hoist [m/s], shape (3,).
    """

    rates: np.ndarray

    def __call__(self, t: float) -> Setpoint:
        """The setpoint at a time [s]."""
        stage, cycle = self.stage(t)
        path, gone = stage.target - stage.origin, self.rates * (t - cycle - stage.begin)
        moving = gone < np.abs(path)
        return Setpoint(stage.origin + np.sign(path) * np.minimum(gone, np.abs(path)), np.sign(path) * self.rates * moving, np.zeros(3))

    def at(self, times: np.ndarray) -> Setpoint:
        """Setpoints at many times [s], shape (n, 3) each."""
        origins, targets = np.array([stage.origin for stage in self.stages]), np.array([stage.target for stage in self.stages])
        begins, ends = np.array([stage.begin for stage in self.stages]), np.array([stage.end for stage in self.stages])
        here = times - times // self.duration * self.duration
        under_way = np.minimum(np.searchsorted(ends, here, side="right"), len(ends) - 1)
        path, gone = (targets - origins)[under_way], np.outer(here - begins[under_way], self.rates)
        moving = gone < np.abs(path)
        position = origins[under_way] + np.sign(path) * np.minimum(gone, np.abs(path))
        return Setpoint(position, np.sign(path) * self.rates * moving, np.zeros_like(path))


@checked
def itinerary(start: State, legs: Sequence[Leg], *, rates: Sequence[float], dwell: float) -> Itinerary:
    """Plan a tour that begins where the drives are.

    Args:
        start: Where the drives are.
        legs: Where to go; the last should lead back to the start, else the repetition begins with a jump.
        rates: Rate of slew [rad/s], trolley [m/s], hoist [m/s].
        dwell: How long to stand still after each leg [s].

    Raises:
        OutOfRange: For a rate that is not positive, a negative dwell, no leg at all, or a tour that does not end where it began.
    """
    limits = of_drives("rate", rates, "/s", "> 0")
    number("dwell", dwell, "s", ">= 0")
    stages: list[Stage] = []
    here, t = start.q[DRIVES], 0.0
    for leg in legs:
        target = np.array(
            [old if new is None else number(f"target of leg {leg.name!r}", new) for old, new in zip(here, leg[1:], strict=True)]
        )
        arrival = t + float(np.max(np.abs(target - here) / limits))
        stages.append(Stage(leg, here, target, t, arrival, arrival + dwell))
        here, t = target, arrival + dwell
    if not stages or t == 0.0:
        raise OutOfRange("tour", "empty", "one leg at least that moves or dwells")
    if not np.allclose(here, start.q[DRIVES]):
        raise OutOfRange("end of the tour", here.tolist(), f"where it began, {start.q[DRIVES].tolist()}", "rad, m, m")
    return Itinerary(tuple(stages), limits)
