"""Strategies for a move: what is planned, what controls it, and on which kind of drives."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from cranedyn.clocks import whole_periods
from cranedyn.controllers import follow, hold_controller
from cranedyn.controllers.damping import with_damping
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.controllers.lqr import effort_weight_of, lqr
from cranedyn.controllers.paper import paper_controller
from cranedyn.controllers.velocity_command import VelocityCommand, as_velocity_command
from cranedyn.estimation.mpc import PredictiveController, mpc
from cranedyn.interfaces import Controller, Drive, Reference
from cranedyn.model.crane import Crane
from cranedyn.planning.joystick import JoystickPulse, joystick
from cranedyn.references import hold
from cranedyn.references.flat import flat
from cranedyn.references.limits import fastest
from cranedyn.references.motion import Motion, hanging_reference
from cranedyn.references.shaped import Shaper, ei, shaped, shaped_hoisting, zv, zvd
from cranedyn.references.simple import Spline, spline
from cranedyn.theory import point_period
from experiments.harness import Setup
from experiments.scenarios.moves import LIMITS, RestToRest


class MovePlan(NamedTuple):
    """How a move is to be made.

    Attributes:
        controller: Makes a controller, a new one for each run.
        reference: Where the drives should be.
        drive: How they take commands.
        arrives: When they should be there [s].
        motion: What a tracking controller goes by, None where there is none.
        uses_swing_sensor: Whether the controller needs the swing measured.
        softer: Makes a controller that is gentle enough for converters; None where the other is.
        rates: Makes a controller for converters that answers rates by itself; None where they are
            made of what the other answers.
    """

    controller: Callable[[], Controller]
    reference: Reference
    drive: Drive
    arrives: float
    motion: Motion | None = None
    uses_swing_sensor: bool = True
    softer: Callable[[], Controller] | None = None
    rates: Callable[[], Controller] | None = None


def on_converters(setup: Setup, plan: MovePlan) -> MovePlan:
    """Return a plan for drives with typical frequency converters: commands of its controller become
    rates, see `cranedyn.controllers.velocity_command`.
    """
    if plan.rates:
        return plan._replace(controller=plan.rates, drive="velocity")

    def controller() -> Controller:
        return as_velocity_command(
            setup.crane,
            (plan.softer or plan.controller)(),
            drive="motion" if plan.drive == "motion" else "effort",
            control_period=setup.control_period,
        )

    first = controller()
    if isinstance(first, VelocityCommand):  # what is inside may remember
        return plan._replace(controller=controller, drive="velocity")
    if isinstance(first, HoistIntegral):
        return plan._replace(controller=lambda: replace(first, integral=0.0), drive="velocity")
    return plan._replace(controller=lambda: first, drive="velocity")


def followed(setup: Setup, reference: Reference, arrives: float) -> MovePlan:
    """Return the plan of a reference that drives follow exactly and that nothing corrects."""
    return MovePlan(
        lambda: follow(setup.crane, reference, setup.control_period),
        reference,
        "motion",
        arrives,
        uses_swing_sensor=False,
    )


def _spline(setup: Setup, move: RestToRest) -> Spline:
    return spline(setup.crane, move.ends(setup.crane)[0], [move.goal], [move.duration])


def _alone(setup: Setup, move: RestToRest) -> MovePlan:
    return followed(setup, _spline(setup, move), move.duration)


def _spline_pd(setup: Setup, move: RestToRest) -> MovePlan:
    return MovePlan(
        lambda: hold_controller(setup.crane),
        _spline(setup, move),
        "effort",
        move.duration,
        uses_swing_sensor=False,
    )


def _paper(setup: Setup, move: RestToRest) -> MovePlan:
    reference = _spline(setup, move)
    motion = hanging_reference(setup.crane, reference, move.duration, setup.control_period)
    controller = paper_controller(setup.crane, motion)
    return MovePlan(
        lambda: replace(controller, integral=0.0), reference, "effort", move.duration, motion
    )


def _lqr(setup: Setup, move: RestToRest) -> MovePlan:
    return _tracked(
        setup,
        hanging_reference(setup.crane, _spline(setup, move), move.duration, setup.control_period),
    )


def flat_motion(setup: Setup, move: RestToRest, duration: float) -> Motion:
    """Return the motion along a flat path of the load in a time [s]."""
    return flat(setup.crane, *move.ends(setup.crane), duration, period=setup.control_period)


def _flat(setup: Setup, move: RestToRest) -> MovePlan:
    return _tracked(setup, flat_motion(setup, move, move.duration))


def _fastest_flat(setup: Setup, move: RestToRest) -> MovePlan:
    lasting = partial(flat_motion, setup, move)
    return _tracked(setup, lasting(fastest(setup.crane, lasting, LIMITS)))


def _tracked(setup: Setup, motion: Motion) -> MovePlan:
    controller = with_integral(setup, motion)
    return MovePlan(
        lambda: replace(controller, integral=0.0),
        motion,
        "effort",
        motion.arrival,
        motion,
        softer=lambda: with_integral(setup, motion, soft_weight(setup.crane)),
    )


def soft_weight(crane: Crane) -> np.ndarray:
    """Return R of an LQR for drives with converters, whose jerk is limited: efforts that move the
    load sideways weigh `SOFTER` times as much as for drives that take efforts, shape (m, m).
    """
    return effort_weight_of(crane) * np.diag(np.where(crane.layout.along("l") > 0.0, 1.0, SOFTER))


def with_integral(
    setup: Setup, motion: Motion, effort_weight: np.ndarray | None = None
) -> HoistIntegral:
    """Return the full-model LQR about a motion with an integrator on the hoist."""
    return HoistIntegral(
        setup.crane,
        lqr(setup.crane, motion, dt=setup.dt, effort_weight=effort_weight),
        HOIST_INTEGRAL,
        float(setup.crane.effort_limit[2]),
    )


def joystick_move(setup: Setup, move: RestToRest) -> tuple[Reference, float]:
    """Return the motion of an operator who knows the way: full rate at once in every drive, and
    back to rest in time; with its end [s].
    """
    pulses, end, limits = [], 0.0, LIMITS.for_crane(setup.crane)
    for drive, first, last, rate, acceleration in zip(
        ("gamma", "x", "l"), move.start, move.goal, limits.rates, limits.accelerations, strict=True
    ):
        distance = abs(last - first)
        if distance > 0.0:
            speed = min(rate, math.sqrt(distance * acceleration))
            pulses.append(
                JoystickPulse(drive, math.copysign(speed, last - first), 0.0, distance / speed)
            )
            end = max(end, distance / speed + speed / acceleration)
    return joystick(
        setup.crane, move.ends(setup.crane)[0], pulses, accelerations=LIMITS.accelerations
    ), end


def _operator(setup: Setup, move: RestToRest) -> MovePlan:
    reference, end = joystick_move(setup, move)
    return followed(setup, reference, instant(setup, end))


def _shaped(shaper: Shaper) -> Callable[[Setup, RestToRest], MovePlan]:
    def plan(setup: Setup, move: RestToRest) -> MovePlan:
        base, end = joystick_move(setup, move)
        period = mean_period(setup, move)
        reference = shaped(base, shaper, period)
        arrives = instant(setup, end + period * float(shaper.fractions[-1]))
        return followed(setup, reference, arrives)

    return plan


def _shaped_hoisting(setup: Setup, move: RestToRest) -> MovePlan:
    base, end = joystick_move(setup, move)
    reference = shaped_hoisting(setup.crane, base, zv(), end, step=setup.control_period)
    arrives = instant(setup, end + float(point_period(move.goal[2], setup.crane.gravity)) / 2.0)
    return followed(setup, reference, arrives)


def _damped(setup: Setup, move: RestToRest) -> MovePlan:
    reference, end = joystick_move(setup, move)
    controller = with_damping(
        setup.crane, reference, limits=LIMITS, recovery=0.3, control_period=setup.control_period
    )
    return MovePlan(lambda: controller, reference, "motion", instant(setup, end))


def mean_period(setup: Setup, move: RestToRest) -> float:
    """Swing period at the mean of the cable lengths at start and goal [s]."""
    return float(point_period((move.start[2] + move.goal[2]) / 2.0, setup.crane.gravity))


def instant(setup: Setup, t: float) -> float:
    """Return the first control instant at or after a time [s]."""
    return setup.control_period * float(np.ceil(t / setup.control_period - 1e-9))


def _mpc(setup: Setup, move: RestToRest) -> MovePlan:
    motion = flat_motion(setup, move, move.duration)

    def controller(effort_weight: np.ndarray | None = None) -> PredictiveController:
        return mpc(
            setup.crane,
            motion,
            dt=setup.dt,
            period=mpc_period(setup),
            rate_limit=LIMITS.rates,
            effort_weight=effort_weight,
        )

    first = cache(controller)  # it never runs, so that its copies remember nothing
    return MovePlan(
        lambda: replace(first()),
        motion,
        "effort",
        motion.arrival,
        motion,
        softer=lambda: controller(soft_weight(setup.crane)),
    )


def _receding(
    setup: Setup, motion: Motion | None, swing: float, drive: Drive = "effort"
) -> Controller:
    from cranedyn.compiled.horizon.receding import receding, usual_input_weight

    usual = usual_input_weight(np.array(LIMITS.accelerations))
    return receding(
        setup.crane,
        LIMITS,
        motion=motion,
        drive=drive,
        swing_limit=swing,
        input_weight=SOFTER_PLAN * usual if drive == "velocity" else None,
        control_period=setup.control_period,
        period=mpc_period(setup),
    )


def _compiled_mpc(setup: Setup, move: RestToRest) -> MovePlan:
    motion = flat_motion(setup, move, move.duration)
    swing = math.pi / 4.0
    return MovePlan(
        lambda: _receding(setup, motion, swing),
        motion,
        "effort",
        motion.arrival,
        motion,
        rates=lambda: _receding(setup, motion, swing, "velocity"),
    )


def _to_goal(setup: Setup, move: RestToRest) -> MovePlan:
    goal = hold(setup.crane, move.ends(setup.crane)[1])
    return MovePlan(
        lambda: _receding(setup, None, 0.1),
        goal,
        "effort",
        0.0,
        rates=lambda: _receding(setup, None, 0.1, "velocity"),
    )


def _least_time(setup: Setup, move: RestToRest) -> MovePlan:
    return _optimal(setup, move)


def _least_swing(setup: Setup, move: RestToRest) -> MovePlan:
    return _optimal(setup, move, duration=move.duration)


def _optimal(setup: Setup, move: RestToRest, duration: float | None = None) -> MovePlan:
    from cranedyn.planning.optimal import optimal

    clocks: dict[str, Any] = {"period": setup.control_period, "duration": duration}
    return _tracked(setup, optimal(setup.crane, *move.ends(setup.crane), LIMITS, **clocks))


PAPER, PD, LQR = "paper's LQR + PID", "spline + PD", "full-model LQR"
FLAT, MPC = "flat + LQR", "flat + MPC"
SOFTER = 30.0
"""By how much more efforts of slew and trolley weigh in an LQR for drives with converters, ours.
With the usual weights a swing of 0.1 rad asks for 40 times the accelerations that converters are
set to; their limited jerk then comes too late, and the load is swung up."""

SOFTER_PLAN = 1e3
"""By how much more accelerations weigh in predictive control for drives with converters, whose
limited jerk it does not know of, ours."""

HOIST_INTEGRAL = 4.0e3
"""k_i of the hoist beside the LQR [N/(m s)], ours: with the LQR's k_p of about 1e4 N/m it takes 2.5
s."""


def mpc_period(setup: Setup) -> float:
    """Return the time between optimisations of the MPC [s], 50 ms or the nearest multiple of the
    control period.
    """
    return whole_periods(0.05, setup.control_period)


COMPILED_MPC, TO_GOAL = "flat + compiled MPC", "MPC to the goal"
YIELD = "operator + yielding drives"
TIME, SWING, FASTEST = "least time + LQR", "least swing + LQR", "fastest flat + LQR"

STRATEGIES: dict[str, Callable[[Setup, RestToRest], MovePlan]] = {
    "spline alone": _alone,
    PD: _spline_pd,
    PAPER: _paper,
    LQR: _lqr,
    FLAT: _flat,
    MPC: _mpc,
    COMPILED_MPC: _compiled_mpc,
    TO_GOAL: _to_goal,
    FASTEST: _fastest_flat,
    SWING: _least_swing,
    TIME: _least_time,
    "operator": _operator,
    "operator + ZV": _shaped(zv()),
    "operator + ZVD": _shaped(zvd()),
    "operator + EI": _shaped(ei()),
    "operator + ZV for a moving cable": _shaped_hoisting,
    YIELD: _damped,
}
"""Plans by name. The spline alone and the operator have drives that follow exactly, as stiff
velocity-controlled drives do. The setpoint of the MPC to the goal is the goal from the start: it
arrives at once, and settles when the load is there."""


def file_name(strategy: str) -> str:
    """Return the name of a strategy as part of a file name."""
    return strategy.replace("'s", "").replace(" + ", "_").replace(" ", "_").lower()
