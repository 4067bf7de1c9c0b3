"""Strategies for a move: what is planned, what controls it, on which kind of drives.

A strategy is a function that takes a setup and a move, and returns a `MovePlan`. `STRATEGIES` has
them by their names in tables. Each has one colour in every figure and recording.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace
from functools import cache, partial

import numpy as np

from cranedyn.clocks import whole_periods
from cranedyn.controllers import hold_controller
from cranedyn.controllers.damping import with_damping
from cranedyn.controllers.integral import HOIST_INTEGRAL, HoistIntegral
from cranedyn.controllers.lqr import lqr
from cranedyn.controllers.paper import paper_controller
from cranedyn.controllers.velocity_command import effort_weight_for_rates
from cranedyn.estimation.mpc import PredictiveController, mpc
from cranedyn.interfaces import Controller, Drive
from cranedyn.model.crane import STANDARD_GRAVITY
from cranedyn.plotting.style import run_colour
from cranedyn.references import hold
from cranedyn.references.flat import flat
from cranedyn.references.limits import fastest
from cranedyn.references.motion import Motion, hanging_reference
from cranedyn.references.shaped import ei, zv, zvd
from cranedyn.references.simple import Spline, spline
from experiments.harness import Setup
from experiments.scenarios.moves import LIMITS, MovePlan, Planner, RestToRest, followed, instant
from experiments.scenarios.shaping import (
    joystick_move,
    operator_plan,
    plan_for_moving_cable,
    shaped_plan,
)


def _spline(setup: Setup, move: RestToRest) -> Spline:
    """Return a quintic spline of the drives, which does not regard the swing."""
    return spline(setup.crane, move.ends(setup.crane)[0], [move.goal], [move.duration])


def _alone(setup: Setup, move: RestToRest) -> MovePlan:
    """Let the drives follow a spline exactly."""
    return followed(setup, _spline(setup, move), move.duration)


def _spline_pd(setup: Setup, move: RestToRest) -> MovePlan:
    """Let PD controllers of the drives follow a spline by efforts."""
    hold = partial(hold_controller, setup.crane)
    reference = _spline(setup, move)
    return MovePlan(hold, reference, "effort", move.duration, uses_swing_sensor=False)


def _hanging(setup: Setup, move: RestToRest) -> Motion:
    """Return a spline of the drives below which the load hangs at rest."""
    spline = _spline(setup, move)
    return hanging_reference(setup.crane, spline, move.duration, setup.control_period)


def _paper(setup: Setup, move: RestToRest) -> MovePlan:
    """Let the paper's controllers follow a spline."""
    motion = _hanging(setup, move)
    reference = _spline(setup, move)
    controller = paper_controller(setup.crane, motion, gravity=STANDARD_GRAVITY)

    def fresh() -> Controller:
        """Return the controller with an integral that a run before it has not changed."""
        return replace(controller, integral=0.0)

    return MovePlan(fresh, reference, "effort", move.duration, motion)


def flat_motion(setup: Setup, move: RestToRest, duration: float | None = None) -> Motion:
    """Return the motion along a flat path of the load: one from which that of the drives follows.

    Args:
        setup: Crane and clocks.
        move: The move.
        duration: Duration [s]; that of the move if None.
    """
    start, goal = move.ends(setup.crane)
    return flat(setup.crane, start, goal, duration or move.duration, period=setup.control_period)


def _fastest_flat(setup: Setup, move: RestToRest) -> Motion:
    """Return that motion in the shortest duration in which drives keep their limits."""
    lasting = partial(flat_motion, setup, move)
    return lasting(fastest(setup.crane, lasting, LIMITS))


def _least_time(setup: Setup, move: RestToRest, duration: float | None = None) -> Motion:
    """Return the motion of least time; if a duration is given [s], that of least swing in it."""
    from cranedyn.lifts.planning.optimal import optimal

    start, goal = move.ends(setup.crane)
    period = setup.control_period
    return optimal(setup.crane, start, goal, LIMITS, period=period, duration=duration)


def _least_swing(setup: Setup, move: RestToRest) -> Motion:
    """Return the motion of least swing in the duration of the move."""
    return _least_time(setup, move, move.duration)


def _tracked(motion_of: Callable[[Setup, RestToRest], Motion]) -> Planner:
    """Return plans of a motion that the full-model LQR tracks."""

    def plan(setup: Setup, move: RestToRest) -> MovePlan:
        motion = motion_of(setup, move)
        controller = with_integral(setup, motion)
        softer = partial(with_integral, setup, motion, effort_weight_for_rates(setup.crane))
        # Runs begin with an integral that the ones before have not changed.
        fresh = partial(replace, controller, integral=0.0)
        return MovePlan(fresh, motion, "effort", motion.arrival, motion, softer=softer)

    return plan


def with_integral(
    setup: Setup, motion: Motion, effort_weight: np.ndarray | None = None
) -> HoistIntegral:
    """Return the full-model LQR about a motion, with an integrator on the hoist.

    Args:
        setup: Crane and clocks.
        motion: The motion.
        effort_weight: Weight R of efforts, shape (m, m); the usual one if None.
    """
    crane = setup.crane
    tracking = lqr(crane, motion, dt=setup.dt, effort_weight=effort_weight)
    return HoistIntegral(crane, tracking, HOIST_INTEGRAL, float(crane.effort_limit[2]))


def _damped(setup: Setup, move: RestToRest) -> MovePlan:
    """Let an operator move the crane, whose drives yield so that the swing is damped."""
    reference, end = joystick_move(setup, move)
    controller = with_damping(
        setup.crane, reference, limits=LIMITS, recovery=0.3, control_period=setup.control_period
    )
    return MovePlan(lambda: controller, reference, "motion", instant(end, setup.control_period))


def _mpc(setup: Setup, move: RestToRest) -> MovePlan:
    """Let predictive control track the flat motion."""
    motion = flat_motion(setup, move)

    def controller(effort_weight: np.ndarray | None = None) -> PredictiveController:
        return mpc(
            setup.crane,
            motion,
            dt=setup.dt,
            period=mpc_period(setup),
            rate_limit=LIMITS.rates,
            effort_weight=effort_weight,
        )

    # Made once, when it is first needed. It never runs itself, so that its copies remember nothing.
    first = cache(controller)
    softer = partial(controller, effort_weight_for_rates(setup.crane))
    return MovePlan(lambda: copy(first()), motion, "effort", motion.arrival, motion, softer=softer)


def _receding(
    setup: Setup, motion: Motion | None, swing: float, drive: Drive = "effort"
) -> Controller:
    """Return the compiled predictive control.

    Args:
        setup: Crane and clocks.
        motion: Motion that it tracks; None to go to the goal of its reference.
        swing: Largest swing that it plans with [rad].
        drive: Kind of drives.
    """
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
    """Let the compiled predictive control track the flat motion."""
    motion = flat_motion(setup, move)
    controller = partial(_receding, setup, motion, math.pi / 4.0)
    rates = partial(controller, "velocity")
    return MovePlan(controller, motion, "effort", motion.arrival, motion, rates=rates)


def _to_goal(setup: Setup, move: RestToRest) -> MovePlan:
    """Let the compiled predictive control find its own way to the goal."""
    goal = hold(setup.crane, move.ends(setup.crane)[1])
    controller = partial(_receding, setup, None, 0.1)
    return MovePlan(controller, goal, "effort", 0.0, rates=partial(controller, "velocity"))


# Names of strategies that experiments refer to, see `STRATEGIES`.

PAPER = "paper's LQR + PID"
"""The control of the paper: two LQRs and a PID for the hoist."""

PD = "spline + PD"
"""A spline of the drives, which PD controllers follow."""

LQR = "full-model LQR"
"""A path of the load, tracked by an LQR of the full model."""

FLAT = "flat + LQR"
"""A motion of the drives that carries the load along its own path, tracked by an LQR."""

MPC = "flat + MPC"
"""The same motion, tracked by predictive control."""

SOFTER_PLAN = 1e3
"""Factor on the weight of accelerations in predictive control for drives with converters, whose
limited jerk it does not know. The value is our choice."""


def mpc_period(setup: Setup) -> float:
    """Return the time between optimisations of the MPC [s], 50 ms or the nearest multiple of the
    control period.
    """
    return whole_periods(0.05, setup.control_period)


COMPILED_MPC = "flat + compiled MPC"
"""The flat motion, tracked by the compiled predictive control."""

TO_GOAL = "MPC to the goal"
"""Predictive control that is given the goal only, and no motion."""

YIELD = "operator + yielding drives"
TIME = "least time + LQR"
"""The motion of least time, tracked by an LQR."""

SWING = "least swing + LQR"
"""The motion of least swing, tracked by an LQR."""

FASTEST = "fastest flat + LQR"
"""The flat motion as fast as the drives can, tracked by an LQR."""

STRATEGIES: dict[str, Planner] = {
    "spline alone": _alone,
    PD: _spline_pd,
    PAPER: _paper,
    LQR: _tracked(_hanging),
    FLAT: _tracked(flat_motion),
    MPC: _mpc,
    COMPILED_MPC: _compiled_mpc,
    TO_GOAL: _to_goal,
    FASTEST: _tracked(_fastest_flat),
    SWING: _tracked(_least_swing),
    TIME: _tracked(_least_time),
    "operator": operator_plan,
    "operator + ZV": shaped_plan(zv()),
    "operator + ZVD": shaped_plan(zvd()),
    "operator + EI": shaped_plan(ei()),
    "operator + ZV for a moving cable": plan_for_moving_cable(),
    YIELD: _damped,
}
"""Plans by name. The spline alone and the operator have drives that follow exactly, as stiff
velocity-controlled drives do. The setpoint of the MPC to the goal is the goal from the start: it
arrives at once, and settles when the load is there."""


def file_name(strategy: str) -> str:
    """Return the name of a strategy as part of a file name."""
    return strategy.replace("'s", "").replace(" + ", "_").replace(" ", "_").lower()


_FIRST = (FLAT, PAPER, LQR, PD, "spline alone", TIME, MPC, "operator")
"""Those that are shown together most often have colours that nobody else of these has."""

_SHAPED = {"spline + ZV": TIME, "spline + ZVD": MPC, "spline + ZV for a moving cable": "operator"}
"""Strategies of the sweep, each with the colour of one that is not shown beside it."""

_ORDER = (*_FIRST, *(strategy for strategy in STRATEGIES if strategy not in _FIRST))


def strategy_colour(strategy: str) -> str:
    """Return the hex colour of a strategy by its name; an unknown one has the last of the first
    eight.
    """
    name = _SHAPED.get(strategy, strategy)
    return run_colour(_ORDER.index(name) if name in _ORDER else len(_FIRST) - 1)


def strategy_colours(names: Sequence[str]) -> dict[str, str]:
    """Return the hex colours of strategies, and of controllers of one's own among them, by their
    names.

    Those of one's own take the colours of strategies that are not recorded beside them.
    """
    lent = ("operator", MPC, "spline alone", LQR)
    own = [name for name in names if name not in STRATEGIES]
    lender = {name: lent[i % len(lent)] for i, name in enumerate(own)}
    return {name: strategy_colour(lender.get(name, name)) for name in names}
