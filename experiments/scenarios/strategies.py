"""Ways to make a move: what is planned, what controls it, and on which kind of drives."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cranedyn.controllers import follow, hold_controller
from cranedyn.controllers.damped import damped
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.controllers.lqr import lqr
from cranedyn.controllers.mpc import mpc
from cranedyn.controllers.paper import paper_controller
from cranedyn.interfaces import Controller, Drive, Reference
from cranedyn.references.flat import flat
from cranedyn.references.limits import fastest
from cranedyn.references.motion import Motion, plumb
from cranedyn.references.operator import Push, operator
from cranedyn.references.shaped import Shaper, ei, shaped, shaped_hoisting, zv, zvd
from cranedyn.references.spline import Spline, spline
from cranedyn.theory import point_period
from experiments.harness import conduct as common
from experiments.scenarios.moves import LIMITS, Move


class Plan(NamedTuple):
    """How a move is to be made.

    Attributes:
        controller: Makes a controller, a new one for each run.
        reference: Where the drives should be.
        drive: How they take commands.
        arrives: When they should be there [s].
        motion: What a tracking controller goes by, None where there is none.
        looks: Whether the controller looks at the swing.
    """

    controller: Callable[[], Controller]
    reference: Reference
    drive: Drive
    arrives: float
    motion: Motion | None = None
    looks: bool = True


def _spline(world: common.World, move: Move) -> Spline:
    return spline(move.ends(world.crane)[0], [move.goal], [move.duration])


def _alone(world: common.World, move: Move) -> Plan:
    reference = _spline(world, move)
    return Plan(lambda: follow(reference, world.control_period), reference, "motion", move.duration, looks=False)


def _held(world: common.World, move: Move) -> Plan:
    return Plan(lambda: hold_controller(world.crane), _spline(world, move), "effort", move.duration, looks=False)


def _paper(world: common.World, move: Move) -> Plan:
    reference = _spline(world, move)
    motion = plumb(reference, move.duration, world.control_period)
    made = paper_controller(world.crane, motion)
    return Plan(lambda: replace(made, integral=0.0), reference, "effort", move.duration, motion)


def _lqr(world: common.World, move: Move) -> Plan:
    return _tracked(world, plumb(_spline(world, move), move.duration, world.control_period))


def _flat(world: common.World, move: Move) -> Plan:
    return _tracked(world, flat(world.crane, *move.ends(world.crane), move.duration, period=world.control_period))


def _fastest_flat(world: common.World, move: Move) -> Plan:
    def lasting(duration: float) -> Motion:
        return flat(world.crane, *move.ends(world.crane), duration, period=world.control_period)

    return _tracked(world, lasting(fastest(world.crane, lasting, LIMITS)))


def _tracked(world: common.World, motion: Motion) -> Plan:
    made = with_integral(world, motion)
    return Plan(lambda: replace(made, integral=0.0), motion, "effort", motion.arrival, motion)


def with_integral(world: common.World, motion: Motion) -> HoistIntegral:
    """The full-model LQR about a motion with an integrator on the hoist."""
    return HoistIntegral(lqr(world.crane, motion, dt=world.dt), HOIST_INTEGRAL, float(world.crane.effort_limit[2]))


def joystick(world: common.World, move: Move) -> tuple[Reference, float]:
    """What an operator who knows the way does: full rate at once in every drive, and back to rest in time; with its end [s]."""
    pushes, end = [], 0.0
    for drive, first, last, rate, acceleration in zip(
        ("gamma", "x", "l"), move.start, move.goal, LIMITS.rates, LIMITS.accelerations, strict=True
    ):
        way = abs(last - first)
        if way > 0.0:
            speed = min(rate, math.sqrt(way * acceleration))
            pushes.append(Push(drive, math.copysign(speed, last - first), 0.0, way / speed))
            end = max(end, way / speed + speed / acceleration)
    return operator(move.ends(world.crane)[0], pushes, accelerations=LIMITS.accelerations), end


def _operator(world: common.World, move: Move) -> Plan:
    reference, end = joystick(world, move)
    return Plan(lambda: follow(reference, world.control_period), reference, "motion", instant(world, end), looks=False)


def _shaped(shaper: Shaper) -> Callable[[common.World, Move], Plan]:
    def plan(world: common.World, move: Move) -> Plan:
        base, end = joystick(world, move)
        period = mean_period(world, move)
        reference = shaped(base, shaper, period)
        arrives = instant(world, end + period * float(shaper.fractions[-1]))
        return Plan(lambda: follow(reference, world.control_period), reference, "motion", arrives, looks=False)

    return plan


def _shaped_hoisting(world: common.World, move: Move) -> Plan:
    base, end = joystick(world, move)
    reference = shaped_hoisting(base, zv(), world.crane.gravity, end, step=world.control_period)
    arrives = instant(world, end + float(point_period(move.goal[2], world.crane.gravity)) / 2.0)
    return Plan(lambda: follow(reference, world.control_period), reference, "motion", arrives, looks=False)


def _damped(world: common.World, move: Move) -> Plan:
    reference, end = joystick(world, move)
    controller = damped(world.crane, reference, limits=LIMITS, recovery=0.3, control_period=world.control_period)
    return Plan(lambda: controller, reference, "motion", instant(world, end))


def mean_period(world: common.World, move: Move) -> float:
    """Swing period at the mean of the cable lengths at start and goal [s]."""
    return float(point_period((move.start[2] + move.goal[2]) / 2.0, world.crane.gravity))


def instant(world: common.World, t: float) -> float:
    """The first control instant at or after a time [s]."""
    return world.control_period * float(np.ceil(t / world.control_period - 1e-9))


def _mpc(world: common.World, move: Move) -> Plan:
    motion = flat(world.crane, *move.ends(world.crane), move.duration, period=world.control_period)
    return Plan(
        lambda: mpc(world.crane, motion, dt=world.dt, period=mpc_period(world), rate_limit=LIMITS.rates),
        motion,
        "effort",
        motion.arrival,
        motion,
    )


def _least_time(world: common.World, move: Move) -> Plan:
    from cranedyn.planning.optimal import optimal

    return _tracked(world, optimal(world.crane, *move.ends(world.crane), LIMITS, period=world.control_period))


def _least_swing(world: common.World, move: Move) -> Plan:
    from cranedyn.planning.optimal import optimal

    return _tracked(world, optimal(world.crane, *move.ends(world.crane), LIMITS, duration=move.duration, period=world.control_period))


PAPER, PD, LQR, FLAT, MPC = "paper's LQR + PID", "spline + PD", "full-model LQR", "flat + LQR", "flat + MPC"
HOIST_INTEGRAL = 4.0e3
"""k_i of the hoist beside the LQR [N/(m s)], ours: with the LQR's k_p of about 1e4 N/m it takes 2.5 s."""


def mpc_period(world: common.World) -> float:
    """Time between optimisations of the MPC [s], 50 ms or the multiple of the control period that is nearest."""
    return world.control_period * max(1, round(0.05 / world.control_period))


TIME, SWING, FASTEST = "least time + LQR", "least swing + LQR", "fastest flat + LQR"

WAYS: dict[str, Callable[[common.World, Move], Plan]] = {
    "spline alone": _alone,
    PD: _held,
    PAPER: _paper,
    LQR: _lqr,
    FLAT: _flat,
    MPC: _mpc,
    FASTEST: _fastest_flat,
    SWING: _least_swing,
    TIME: _least_time,
    "operator": _operator,
    "operator, ZV": _shaped(zv()),
    "operator, ZVD": _shaped(zvd()),
    "operator, EI": _shaped(ei()),
    "operator, ZV for a moving cable": _shaped_hoisting,
    "operator, drives yield": _damped,
}
"""Plans by name. The spline alone and the operator have drives that follow exactly, as stiff velocity-controlled drives do."""
