"""Strategies to drive the article's seven legs; shared by the demo and the comparison."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cranedyn.controllers import hold_controller, paper_controller
from cranedyn.controllers.affine import Affine
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.errors import CraneError
from cranedyn.interfaces import Controller, Setpoint, State
from cranedyn.lifts.planning.itinerary import ARTICLE_TOUR, Timetable, Tour, itinerary, tour
from cranedyn.model.crane import STANDARD_GRAVITY
from cranedyn.references import hanging_reference, shaped_hoisting, shortest, spline, zv
from cranedyn.references.flat import flat
from cranedyn.references.limits import Limits, fastest, use
from cranedyn.references.motion import Motion
from experiments.harness import Setup
from experiments.scenarios.strategies import with_integral

Way = tuple[Timetable, Controller]
"""A tour, which is the reference, and what drives it."""


def _none(setup: Setup, limits: Limits, dwell: float) -> Way:
    crane = setup.crane
    timetable = itinerary(crane, crane.start, ARTICLE_TOUR, rates=limits.rates, dwell=dwell)
    for stage in timetable.stages:
        # Refuses a target out of range.
        crane.state(**dict(zip(("gamma", "x", "l"), stage.target, strict=True)))
    return timetable, hold_controller(crane, gravity=STANDARD_GRAVITY)


def _shaped(setup: Setup, limits: Limits, dwell: float) -> Way:
    bare, brake = _none(setup, limits, dwell)
    reference = shaped_hoisting(setup.crane, bare, zv(), bare.duration, step=setup.control_period)
    hoist = setup.crane.layout.along("l")
    later = [
        float(np.pi * np.sqrt(stage.target @ hoist / setup.crane.gravity)) for stage in bare.stages
    ]
    if dwell < max(later):
        raise CraneError(
            f"The dwell is {dwell:g} s; shaped legs take {max(later):.2f} s longer than bare ones, "
            "so it must be that at least."
        )
    stages = tuple(
        stage._replace(arrival=stage.arrival + by)
        for stage, by in zip(bare.stages, later, strict=True)
    )
    plan = hanging_reference(setup.crane, reference, bare.duration, setup.control_period)
    return Tour(stages, plan), brake


def _spline(setup: Setup, limits: Limits, dwell: float) -> Tour:
    def plan(start: State, goal: State) -> Motion:
        aim = [goal.q[setup.crane.layout.drives]]
        (duration,) = shortest(
            setup.crane, start, aim, rates=limits.rates, accelerations=limits.accelerations
        )
        duration = setup.control_period * np.ceil(duration / setup.control_period)
        return hanging_reference(
            setup.crane, spline(setup.crane, start, aim, [duration]), duration, setup.control_period
        )

    return tour(setup.crane, ARTICLE_TOUR, plan, dwell=dwell)


def _flat(setup: Setup, limits: Limits, dwell: float) -> Tour:
    gaining = 2.5 * np.divide(limits.rates, limits.accelerations)

    def plan(start: State, goal: State) -> Motion:
        moving = ~np.isclose(goal.q, start.q, rtol=0.0, atol=1e-9)[setup.crane.layout.drives]
        ramp = float(gaining[moving].max(initial=0.0))

        def lasting(duration: float, period: float = 10.0 * setup.control_period) -> Motion:
            soft = max(period, min(ramp, duration / 2.0))
            return flat(setup.crane, start, goal, duration, ramp=soft, period=period)

        duration = fastest(setup.crane, lasting, limits)
        # Between the samples of the search.
        beyond = max(use(setup.crane, lasting(duration, setup.control_period), limits).values())
        return lasting(duration * max(1.0, beyond), setup.control_period)

    return tour(setup.crane, ARTICLE_TOUR, plan, dwell=dwell)


@dataclass(frozen=True, eq=False)
class Repeated:
    """A controller that repeats a cycle.

    Attributes:
        controller: The controller of one cycle.
        cycle: Duration of the cycle [s].
    """

    controller: HoistIntegral
    cycle: float

    def begin_run(self, t: float, control_period: float) -> None:
        """Begin a run, see `cranedyn.clocks.Clocked`."""
        self.controller.begin_run(t % self.cycle, control_period)

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return the efforts [N m or N], shape (m,)."""
        return self.controller(t % self.cycle, state, setpoint)

    def affine(self, times: np.ndarray, positions: np.ndarray) -> Affine | None:
        """Return the affine form, see `cranedyn.controllers.affine`."""
        return self.controller.affine(times % self.cycle, positions)

    def resume(self, t: float, integral: np.ndarray) -> None:
        """Resume a run, see `cranedyn.controllers.affine.Stateful`."""
        self.controller.resume(t % self.cycle, integral)


def _tracked(
    plan: Callable[[Setup, Limits, float], Tour], design: Callable[[Setup, Motion], HoistIntegral]
) -> Callable[[Setup, Limits, float], Way]:
    def control(setup: Setup, limits: Limits, dwell: float) -> Way:
        planned = plan(setup, limits, dwell)
        return planned, Repeated(design(setup, planned.motion), planned.duration)

    return control


CONTROLS: dict[str, Callable[[Setup, Limits, float], Way]] = {
    "none": _none,
    "shaped": _shaped,
    "paper": _tracked(
        _spline,
        lambda setup, motion: paper_controller(setup.crane, motion, gravity=STANDARD_GRAVITY),
    ),
    "lqr": _tracked(_spline, with_integral),
    "flat": _tracked(_flat, with_integral),
}
"""By name: PD without swing control; the same with shaped commands; splines with the paper's
control or the full-model LQR; flat paths."""
