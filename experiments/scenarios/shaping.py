"""Motions of an operator who knows the way, and how these and splines are shaped so that no swing
is left.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

from cranedyn.interfaces import Reference, State
from cranedyn.lifts.planning.joystick import JoystickPulse, joystick
from cranedyn.model.crane import Crane
from cranedyn.references.limits import Limits
from cranedyn.references.shaped import Shaper, shaped, shaped_hoisting, zv
from cranedyn.references.simple import spline
from cranedyn.theory import point_period
from experiments.harness import Setup
from experiments.scenarios.moves import LIMITS, MovePlan, Planner, RestToRest, followed, instant


def joystick_path(
    crane: Crane, start: State, corners: Sequence[Sequence[float]], limits: Limits
) -> tuple[Reference, float]:
    """Return the motion of an operator who knows the way from corner to corner, the first of which
    is the start: full rate at once in every drive, and back to rest in time; with its end [s].
    """
    pulses = []
    end = 0.0
    drives = crane.layout.driven
    for corner, next_corner in itertools.pairwise(corners):
        lasts = 0.0
        for joint, begin, finish, rate, acceleration in zip(
            drives, corner, next_corner, limits.rates, limits.accelerations, strict=True
        ):
            distance = abs(finish - begin)
            if distance > 1e-6:
                speed = min(rate, math.sqrt(distance * acceleration))
                signed = math.copysign(speed, finish - begin)
                pulses.append(JoystickPulse(joint.symbol, signed, end, distance / speed))
                lasts = max(lasts, distance / speed + speed / acceleration)
        end += lasts
    return joystick(crane, start, pulses, accelerations=limits.accelerations), end


def joystick_move(setup: Setup, move: RestToRest) -> tuple[Reference, float]:
    """Return the motion of an operator for a move, and its end [s]."""
    crane = setup.crane
    start = move.ends(setup.crane)[0]
    return joystick_path(crane, start, [move.start, move.goal], LIMITS.for_crane(crane))


def operator_plan(setup: Setup, move: RestToRest) -> MovePlan:
    """Return the plan of an operator whose drives follow the joystick exactly."""
    reference, end = joystick_move(setup, move)
    return followed(setup, reference, instant(end, setup.control_period))


Base = Callable[[Setup, RestToRest, float], tuple[Reference, float]]
"""A motion that is to be shaped, and its end [s]: of a setup, a move, and by how much shaping
prolongs it [s]."""


def _joystick_base(setup: Setup, move: RestToRest, longer: float) -> tuple[Reference, float]:
    return joystick_move(setup, move)


def spline_base(setup: Setup, move: RestToRest, longer: float) -> tuple[Reference, float]:
    """Return a spline that is so much shorter that it ends with the move when shaped."""
    shorter = move.duration - longer
    start = move.ends(setup.crane)[0]
    return spline(setup.crane, start, [move.goal], [shorter]), shorter


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
