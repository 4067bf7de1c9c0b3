"""What is told of an instance in plain numbers, for programs that are not in Python.

The fields are those of ``crane_briefing`` in ``crane_entry.h``, in the same order, and the keys of
the object in JSON that a program on OPC UA reads.
"""

from __future__ import annotations

from dataclasses import dataclass

from cranedyn.benchmark.entry import Briefing


@dataclass(frozen=True)
class PlainBriefing:
    """What is told of an instance of a crane with m drives and s swing angles, see
    ``crane_entry.h``.
    """

    task: str
    crane: str
    kind: str
    drives: int
    swings: int
    hoist: int
    drive_names: list[str]
    swing_names: list[str]
    period: float
    duration: float
    gravity: float
    payload_mass: float
    swing_period: float
    swing_bound: float
    tolerance: float
    delay: float
    largest_rates: list[float]
    largest_accelerations: list[float]
    largest_jerks: list[float]
    lags: list[float]
    lower: list[float]
    upper: list[float]
    start: list[float]
    goal: list[float] | None


def plain_briefing(briefing: Briefing) -> PlainBriefing:
    """Return what is told of an instance in plain numbers."""
    crane = briefing.crane
    drives = crane.layout.drives
    converters = briefing.converters
    goal = briefing.goal
    return PlainBriefing(
        task=briefing.task,
        crane=briefing.task.partition("/")[0],
        kind=briefing.kind,
        drives=crane.layout.m,
        swings=len(crane.swings),
        hoist=-1 if crane.winch is None else int(crane.winch),
        drive_names=[joint.symbol for joint in crane.layout.driven],
        swing_names=[crane.layout.symbols[i] for i in crane.swings.tolist()],
        period=briefing.period,
        duration=briefing.duration,
        gravity=crane.gravity,
        payload_mass=crane.payload_mass,
        swing_period=briefing.swing_period,
        swing_bound=briefing.swing_bound,
        tolerance=briefing.tolerance,
        delay=float(converters.delay),
        largest_rates=converters.rates.tolist(),
        largest_accelerations=converters.accelerations.tolist(),
        largest_jerks=converters.jerks.tolist(),
        lags=converters.lags.tolist(),
        lower=crane.lower[drives].tolist(),
        upper=crane.upper[drives].tolist(),
        start=briefing.start.q[drives].tolist(),
        goal=None if goal is None else goal.q[drives].tolist(),
    )
