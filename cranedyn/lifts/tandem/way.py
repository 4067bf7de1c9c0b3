"""The way of a load between two cranes around obstacles: straight, or raised over them.

A straight way is taken if it is free. Otherwise the load is raised, moved level, and set down to
its goal, with the least raise that is free. The search looks at the planned motion, in which the
load does not swing, at the instants of the plan. That the load as it really moves is free, between
all instants, is what `cranedyn.lifts.tandem.judgement` proves of the simulated run.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cranedyn.checks import number
from cranedyn.errors import CraneError
from cranedyn.lifts.planning.lift import NoWay
from cranedyn.lifts.tandem.clearance import TandemDistance, tandem_distances
from cranedyn.lifts.tandem.plan import TandemLift, TandemPlan, plan_tandem
from cranedyn.lifts.tandem.simulation import TandemRun, planned_run

RAISE_STEP = 1.0
"""Step by which the way is raised in the search [m]."""

SPARE = 0.1
"""Distance beyond the required one that a planned way keeps [m], for the swing of the simulated
load and for what it moves between two instants."""


def plan_around(
    lift: TandemLift,
    start: Sequence[float],
    goal: Sequence[float],
    *,
    yaw: float = 0.0,
    distance: float | None = None,
) -> TandemPlan:
    """Return the plan of a load that keeps a distance from all that it must not meet: along a
    straight line, or raised as little as is enough.

    Args:
        lift: The lift.
        start: Place of the centre of mass at the start in the frame of the site [m].
        goal: Its place at the end [m].
        yaw: Angle of the load's X axis from that of the site [rad].
        distance: Distance to keep [m]; None for that of the site.

    Raises:
        NoWay: If no such way is free, with what is in the way and what would be enough.
        OutOfRange: As `cranedyn.lifts.tandem.plan.plan_tandem`.
        CraneError: As `cranedyn.lifts.tandem.plan.plan_tandem`.
    """
    required = lift.site.distance if distance is None else number("distance", distance, "m", ">= 0")
    straight = plan_tandem(lift, start, goal, yaw=yaw)
    run = planned_run(straight)
    nearest = _nearest(run, required)
    if nearest.spare >= SPARE:
        return straight
    _refuse_ends(run, required)
    best = nearest
    begin = max(float(straight.start[2]), float(straight.goal[2]))
    level = begin
    # The hoists or the jibs end the search, whose messages say so.
    while True:
        above = level + RAISE_STEP
        raised = [[float(end[0]), float(end[1]), above] for end in (straight.start, straight.goal)]
        try:
            plan = plan_tandem(lift, start, goal, yaw=yaw, via=raised)
        except CraneError as error:
            reason = _no_way(nearest, best, required, level - begin, str(error))
            raise NoWay(reason) from None
        level = above
        found = _nearest(planned_run(plan), required)
        if found.spare >= SPARE:
            return plan
        best = max(best, found, key=lambda distance: distance.spare)


class _Nearest(NamedTuple):
    """What comes nearest to what it must not meet.

    Attributes:
        distance: The distance.
        spare: How much farther than required it is [m].
    """

    distance: TandemDistance
    spare: float

    @property
    def text(self) -> str:
        """What it is between, and how near."""
        return f"{self.distance.between} are {max(self.distance.distance, 0.0):.2f} m apart"


def _nearest(run: TandemRun, required: float) -> _Nearest:
    """Return what comes nearest in a planned motion, beside what is required [m]."""
    found = [
        _Nearest(distance, distance.distance - distance.required(required))
        for distance in tandem_distances(run)
    ]
    return min(found, key=lambda nearest: nearest.spare)


def _refuse_ends(run: TandemRun, required: float) -> None:
    """Refuse a start or a goal of a planned motion at which the load is too near to something: no
    way helps.

    Raises:
        NoWay: With what it is too near to, and the distance that is missing.
    """
    for name, rows in (("start", slice(0, 2)), ("goal", slice(-2, None))):
        nearest = _nearest(run.rows(rows), required)
        missing = SPARE - nearest.spare
        if missing > 0.0:
            raise NoWay(
                f"At the {name}, {nearest.text}; {nearest.distance.required(required):g} m are "
                f"required, and {SPARE:g} m more for the swing. Move the {name} away by "
                f"{_rounded_up(missing):g} m or more, or require less."
            )


def _no_way(straight: _Nearest, best: _Nearest, required: float, raised: float, reach: str) -> str:
    """Return why there is no way, and what would be enough.

    Args:
        straight: What is nearest on the straight way.
        best: The same on the way that keeps away farthest.
        required: Required distance [m].
        raised: How far the way could be raised [m].
        reach: Why it could not be raised farther.
    """
    enough = math.floor(10.0 * (best.distance.distance - SPARE)) / 10.0
    advice = "Move what is in the way, or give places in between as via."
    if enough > 0.0 and not best.distance.from_zone:
        advice = f"A required distance of {enough:g} m would be kept; or give places as via."
    return (
        f"No way is free. Straight, {straight.text} at {straight.distance.t:.1f} s; {required:g} m "
        f"are required, and {SPARE:g} m more for the swing. Raised by up to {raised:g} m, "
        f"{best.text}; higher it does not go: {reach} {advice}"
    )


def _rounded_up(value: float) -> float:
    """Return a length rounded up to decimetres [m]."""
    return float(np.ceil(10.0 * value) / 10.0)
