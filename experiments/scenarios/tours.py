"""Strategies to drive the article's seven legs; shared by the demo and the comparison."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cranedyn.controllers import hold_controller, paper_controller
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.controllers.repeated import Repeated
from cranedyn.errors import CraneError
from cranedyn.interfaces import Controller, State
from cranedyn.lifts.planning.itinerary import ARTICLE_TOUR, Timetable, Tour, itinerary, tour
from cranedyn.model.crane import STANDARD_GRAVITY
from cranedyn.references import hanging_reference, shaped_hoisting, shortest, spline, zv
from cranedyn.references.flat import flat
from cranedyn.references.limits import Limits, fastest, use
from cranedyn.references.motion import Motion
from experiments.harness import Setup
from experiments.scenarios.strategies import with_integral

ControlledTour = tuple[Timetable, Controller]
"""A tour, which is the reference, and the controller that drives it."""

TourControl = Callable[[Setup, Limits, float], ControlledTour]
"""Function that returns a tour from a setup, limits of the drives, and the time at rest after each
leg [s]."""

RAMP_FACTOR = 2.5
"""Duration of a ramp over that of an even acceleration.

The smoothstep of `cranedyn.references.flat` rises at up to 2.46 times its mean slope.
"""


def _none(setup: Setup, limits: Limits, dwell: float) -> ControlledTour:
    """Return the tour at constant rates under PD controllers, without swing control."""
    crane = setup.crane
    timetable = itinerary(crane, crane.start, ARTICLE_TOUR, rates=limits.rates, dwell=dwell)
    for stage in timetable.stages:
        # Refuses a target out of range.
        crane.state(**dict(zip(("gamma", "x", "l"), stage.target, strict=True)))
    return timetable, hold_controller(crane, gravity=STANDARD_GRAVITY)


def _shaped(setup: Setup, limits: Limits, dwell: float) -> ControlledTour:
    """Return the same tour with commands that a ZV shaper has shaped.

    Raises:
        CraneError: If a shaped leg would not end within its dwell.
    """
    unshaped, brake = _none(setup, limits, dwell)
    reference = shaped_hoisting(
        setup.crane, unshaped, zv(), unshaped.duration, step=setup.control_period
    )
    hoist = setup.crane.layout.along("l")
    stages = []
    longest_delay = 0.0
    for stage in unshaped.stages:
        # ZV prolongs a leg by half a period at its end.
        length = stage.target @ hoist
        delay = float(np.pi * np.sqrt(length / setup.crane.gravity))
        longest_delay = max(longest_delay, delay)
        stages.append(stage._replace(arrival=stage.arrival + delay))
    if dwell < longest_delay:
        raise CraneError(
            f"The dwell is {dwell:g} s; shaped legs take {longest_delay:.2f} s longer than bare "
            "ones, so it must be that at least."
        )
    plan = hanging_reference(setup.crane, reference, unshaped.duration, setup.control_period)
    return Tour(tuple(stages), plan), brake


def _spline(setup: Setup, limits: Limits, dwell: float) -> Tour:
    """Return the tour by splines of the drives, each as fast as the limits allow."""
    crane = setup.crane
    period = setup.control_period

    def plan(start: State, goal: State) -> Motion:
        aim = [goal.q[crane.layout.drives]]
        (duration,) = shortest(
            crane, start, aim, rates=limits.rates, accelerations=limits.accelerations
        )
        duration = period * np.ceil(duration / period)
        return hanging_reference(crane, spline(crane, start, aim, [duration]), duration, period)

    return tour(crane, ARTICLE_TOUR, plan, dwell=dwell)


def _flat(setup: Setup, limits: Limits, dwell: float) -> Tour:
    """Return the tour by flat paths of the payload, each as fast as the limits allow."""
    # Time in which each drive reaches its full rate [s].
    ramps = RAMP_FACTOR * np.divide(limits.rates, limits.accelerations)

    def plan(start: State, goal: State) -> Motion:
        moving = ~np.isclose(goal.q, start.q, rtol=0.0, atol=1e-9)[setup.crane.layout.drives]
        ramp = float(ramps[moving].max(initial=0.0))

        def lasting(duration: float, period: float = 10.0 * setup.control_period) -> Motion:
            # Half of the duration for speeding up is the most, and a sample the least.
            fitting_ramp = max(period, min(ramp, duration / 2.0))
            return flat(setup.crane, start, goal, duration, ramp=fitting_ramp, period=period)

        # The search takes fewer samples. Between them the motion may go beyond the limits a little.
        duration = fastest(setup.crane, lasting, limits)
        beyond = max(use(setup.crane, lasting(duration, setup.control_period), limits).values())
        return lasting(duration * max(1.0, beyond), setup.control_period)

    return tour(setup.crane, ARTICLE_TOUR, plan, dwell=dwell)


def _tracked(
    plan: Callable[[Setup, Limits, float], Tour], design: Callable[[Setup, Motion], HoistIntegral]
) -> TourControl:
    """Return the control of a tour that a controller tracks.

    Args:
        plan: Function that plans the tour.
        design: Function that makes the controller for one cycle of its motion.
    """

    def control(setup: Setup, limits: Limits, dwell: float) -> ControlledTour:
        planned = plan(setup, limits, dwell)
        return planned, Repeated(design(setup, planned.motion), planned.duration)

    return control


def _paper(setup: Setup, motion: Motion) -> HoistIntegral:
    return paper_controller(setup.crane, motion, gravity=STANDARD_GRAVITY)


CONTROLS: dict[str, TourControl] = {
    "none": _none,
    "shaped": _shaped,
    "paper": _tracked(_spline, _paper),
    "lqr": _tracked(_spline, with_integral),
    "flat": _tracked(_flat, with_integral),
}
"""By name: PD without swing control; the same with shaped commands; splines with the paper's
control or the full-model LQR; flat paths."""
