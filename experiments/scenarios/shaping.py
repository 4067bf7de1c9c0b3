"""Motions of an operator who knows the way, and how these and splines are shaped so that no swing
is left.
"""

from __future__ import annotations

from collections.abc import Callable

from cranedyn.lifts.planning.joystick import TimedReference, joystick_path
from cranedyn.references.shaped import Shaper, shaped, shaped_hoisting, zv
from cranedyn.references.simple import spline
from cranedyn.theory import point_period
from experiments.harness import Setup
from experiments.scenarios.moves import LIMITS, MovePlan, Planner, RestToRest, followed, instant


def joystick_move(setup: Setup, move: RestToRest) -> TimedReference:
    """Return the motion of an operator for a move."""
    crane = setup.crane
    start = move.ends(setup.crane)[0]
    return joystick_path(crane, start, [move.start, move.goal], LIMITS.for_crane(crane))


def operator_plan(setup: Setup, move: RestToRest) -> MovePlan:
    """Return the plan of an operator whose drives follow the joystick exactly."""
    reference, end = joystick_move(setup, move)
    return followed(setup, reference, instant(end, setup.control_period))


Base = Callable[[Setup, RestToRest, float], TimedReference]
"""Function that returns a motion to be shaped, from a setup, a move, and the time by which shaping
prolongs it [s]."""


def _joystick_base(setup: Setup, move: RestToRest, longer: float) -> TimedReference:
    """Return the motion of an operator, who does not know of the shaping."""
    return joystick_move(setup, move)


def spline_base(setup: Setup, move: RestToRest, longer: float) -> TimedReference:
    """Return a spline that is so much shorter that it ends with the move when shaped."""
    shorter = move.duration - longer
    start = move.ends(setup.crane)[0]
    return TimedReference(spline(setup.crane, start, [move.goal], [shorter]), shorter)


def shaped_plan(shaper: Shaper, base: Base = _joystick_base) -> Planner:
    """Return plans of a motion shaped for the mean cable length."""

    def plan(setup: Setup, move: RestToRest) -> MovePlan:
        mean_length = (move.start[2] + move.goal[2]) / 2.0
        period = float(point_period(mean_length, setup.crane.gravity))
        longer = period * float(shaper.fractions[-1])
        reference, end = base(setup, move, longer)
        arrives = instant(end + longer, setup.control_period)
        return followed(setup, shaped(reference, shaper, period), arrives)

    return plan


def plan_for_moving_cable(base: Base = _joystick_base) -> Planner:
    """Return plans of a motion shaped for a cable of varying length."""

    def plan(setup: Setup, move: RestToRest) -> MovePlan:
        longer = float(point_period(move.goal[2], setup.crane.gravity)) / 2.0
        reference, end = base(setup, move, longer)
        reference = shaped_hoisting(setup.crane, reference, zv(), end, step=setup.control_period)
        return followed(setup, reference, instant(end + longer, setup.control_period))

    return plan
