"""Ways to drive the article's seven legs; shared by the demo and the comparison."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cranedyn.controllers import hold_controller, paper_controller
from cranedyn.errors import CraneError
from cranedyn.interfaces import Controller, State
from cranedyn.model.crane import DRIVES
from cranedyn.references import ARTICLE_TOUR, itinerary, plumb, shaped_hoisting, shortest, spline, zv
from cranedyn.references.flat import flat
from cranedyn.references.itinerary import Timetable
from cranedyn.references.limits import Limits, fastest, use
from cranedyn.references.motion import Motion
from cranedyn.references.tour import Tour, tour
from experiments.harness import conduct as common
from experiments.scenarios.strategies import with_integral

Way = tuple[Timetable, Controller]
"""A tour, which is the reference, and what drives it."""


def _none(world: common.World, limits: Limits, dwell: float) -> Way:
    made = itinerary(world.crane.start, ARTICLE_TOUR, rates=limits.rates, dwell=dwell)
    for stage in made.stages:
        world.crane.state(gamma=stage.target[0], x=stage.target[1], l=stage.target[2])  # refuses a target out of range
    return made, hold_controller(world.crane)


def _shaped(world: common.World, limits: Limits, dwell: float) -> Way:
    bare, brake = _none(world, limits, dwell)
    reference = shaped_hoisting(bare, zv(), world.crane.gravity, bare.duration, step=world.control_period)
    longest = max(np.pi * np.sqrt(stage.target[2] / world.crane.gravity) for stage in bare.stages)
    if dwell < longest:
        raise CraneError(f"The dwell is {dwell:g} s; shaped legs take {longest:.2f} s longer than bare ones, so it must be that at least.")
    stages = tuple(s._replace(arrival=s.arrival + float(np.pi * np.sqrt(s.target[2] / world.crane.gravity))) for s in bare.stages)
    plan = plumb(reference, bare.duration, world.control_period)
    return Tour(stages, plan), brake


def _spline(world: common.World, limits: Limits, dwell: float) -> Tour:
    def plan(start: State, goal: State) -> Motion:
        aim = [goal.q[DRIVES]]
        (duration,) = shortest(start, aim, rates=limits.rates, accelerations=limits.accelerations)
        duration = world.control_period * np.ceil(duration / world.control_period)
        return plumb(spline(start, aim, [duration]), duration, world.control_period)

    return tour(world.crane, ARTICLE_TOUR, plan, dwell=dwell)


def _flat(world: common.World, limits: Limits, dwell: float) -> Tour:
    gaining = 2.5 * np.divide(limits.rates, limits.accelerations)

    def plan(start: State, goal: State) -> Motion:
        ramp = float(gaining[(goal.q != start.q)[DRIVES]].max(initial=0.0))

        def lasting(duration: float, period: float = 10.0 * world.control_period) -> Motion:
            return flat(world.crane, start, goal, duration, ramp=max(period, min(ramp, duration / 2.0)), period=period)

        duration = fastest(world.crane, lasting, limits)
        beyond = max(use(world.crane, lasting(duration, world.control_period), limits).values())  # between the samples of the search
        return lasting(duration * max(1.0, beyond), world.control_period)

    return tour(world.crane, ARTICLE_TOUR, plan, dwell=dwell)


def repeated(controller: Controller, cycle: float) -> Controller:
    """A controller that goes by the time in its cycle [s]."""
    return lambda t, state, wanted: controller(t % cycle, state, wanted)


def _tracked(made: Tour, controller: Controller) -> Way:
    return made, repeated(controller, made.duration)


CONTROLS: dict[str, Callable[[common.World, Limits, float], Way]] = {
    "none": _none,
    "shaped": _shaped,
    "paper": lambda world, limits, dwell: _tracked(made := _spline(world, limits, dwell), paper_controller(world.crane, made.motion)),
    "lqr": lambda world, limits, dwell: _tracked(made := _spline(world, limits, dwell), with_integral(world, made.motion)),
    "flat": lambda world, limits, dwell: _tracked(made := _flat(world, limits, dwell), with_integral(world, made.motion)),
}
"""By name: PD without swing control; the same with shaped commands; splines with the paper's control or the full-model LQR; flat paths."""
