"""Baselines of the benchmark: strategies of cranedyn as entries, through the same door as all
others. ``cranedyn benchmark run NAME`` names one.

They get what every entry gets: the planned crane and what sensors measure, no state and no
perturbation. Each is a function of a `Briefing` that stands below with a docstring of one sentence.
Those that plan a motion differ in the tasks with a goal only; on a path and in wind they all track
the path, or the rest. Under an operator, whose commands nobody knows in advance, those that track a
planned motion decline.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import numpy as np
import pinocchio as pin

from cranedyn.benchmark.entries.targets import Target, Targets
from cranedyn.benchmark.entry import Briefing, Declined, Entry
from cranedyn.benchmark.sensors import SensorReading
from cranedyn.benchmark.task import MOVES
from cranedyn.controllers import Tracking, follow, hold_controller, lqr
from cranedyn.controllers.damping import with_damping
from cranedyn.controllers.paper import paper_controller
from cranedyn.controllers.velocity_command import ShapedVelocityCommand, gentle_recovery
from cranedyn.dynamics.equations_of_motion import payload_position
from cranedyn.errors import MissingRole, ModelError
from cranedyn.interfaces import Reference, Setpoint
from cranedyn.lifts.planning.joystick import joystick_path
from cranedyn.references import hold
from cranedyn.references.flat import flat
from cranedyn.references.limits import Limits, fastest
from cranedyn.references.motion import Motion
from cranedyn.references.shaped import Shaper, ei, zv, zvd

PLANNED_SHARE = 0.8
"""Share of the bound of the swing, and of the rates and accelerations of the drives, that planned
motions use; the rest is for feedback. Our choice."""

SOFTER = 1e3
"""Factor on the weight of accelerations in predictive control, which knows nothing of the limited
jerk of converters. Our choice."""

EFFORT_FACTOR = 3.0
"""Factor on the weight of efforts in LQRs. With 1 the LQRs diverge on a small crane once its drives
saturate, whose lag and jerk are long beside its swing; with 10 and more a swing decays slowly. Our
choice, on the crane inteco."""

MPC_EVERY = 2
"""Control periods from one optimisation of `kaepernick_mpc` to the next. Our choice: it takes some
milliseconds for each axis."""

_KEPT_DESIGNS = 4
"""Number of LQRs that are kept, for the instances of a task that follow one another."""

YIELD_RECOVERY = 0.3
"""Share of the distance of yielding drives from their reference that is taken back per second
[1/s]. Our choice."""


class _Operator:
    """Where the operator has sent the drives so far: a reference that is fed readings."""

    def __init__(self, briefing: Briefing) -> None:
        start = briefing.start.q[briefing.crane.layout.drives]
        self._targets = Targets(briefing)
        self._target = Target(start, np.zeros_like(start))

    def hear(self, reading: SensorReading) -> None:
        """Take what the operator asks for now."""
        self._target = self._targets(reading)

    def __call__(self, t: float) -> Setpoint:
        """Return the setpoint now, at whatever time it is asked for."""
        position, rate = self._target
        return Setpoint(position, rate, np.zeros_like(rate))


def _with_operator(briefing: Briefing, make: Callable[[Reference], tuple[Any, str]]) -> Entry:
    """Return an entry whose reference is the operator.

    Args:
        briefing: What the entry is told.
        make: From the reference to a controller and the kind of its commands.
    """
    operator = _Operator(briefing)
    controller, drive = make(operator)
    commanded = briefing.entry(controller, operator, drive)

    def rates(reading: SensorReading) -> np.ndarray:
        operator.hear(reading)
        return commanded(reading)

    return rates


def _gains(briefing: Briefing, motion: Motion) -> Tracking:
    """Return an LQR of the full model about a motion, with gains that suit the converters."""
    state_weight, effort_weight = natural_weights(briefing)
    return lqr(
        briefing.crane,
        motion,
        dt=briefing.step,
        state_weight=state_weight,
        effort_weight=effort_weight,
    )


@lru_cache(maxsize=_KEPT_DESIGNS)
def _design(briefing: Briefing, plan: Callable[[Briefing], Motion]) -> tuple[Tracking, Motion]:
    """Return an LQR about a planned motion, and the motion; all instances of a task have the same
    ones.
    """
    motion = plan(briefing)
    return _gains(briefing, motion), motion


def natural_weights(briefing: Briefing) -> tuple[np.ndarray, np.ndarray]:
    """Return Q and R of an LQR for a crane of any size, shapes (2 n, 2 n) and (m, m).

    By Bryson's rule each weight is one over the square of a size, and the sizes are those of a
    swing that a drive causes at the largest acceleration a of its converter. With the frequency ω
    of the load these are a/ω² of its position, a/ω of its rate, the effort that accelerates it by
    a, and the angle by which the load lags, the horizontal acceleration of the load over
    gravity.
    """
    crane = briefing.crane
    drives = crane.layout.drives
    n = crane.layout.n
    q = briefing.start.q
    frequency = 2.0 * math.pi / briefing.swing_period
    accelerations = briefing.converters.accelerations

    inertia = pin.crba(crane.model, crane.data, q)
    efforts = np.diag(inertia)[drives] * accelerations

    # Way of the load per unit of each drive, by a difference small beside every crane.
    step = 1e-6
    place = payload_position(crane, q)
    largest = 0.0
    for drive, acceleration in zip(drives, accelerations, strict=True):
        moved = q.copy()
        moved[drive] += step
        way = (payload_position(crane, moved) - place) / step
        largest = max(largest, float(np.hypot(way[0], way[1])) * float(acceleration))

    sizes = np.full(n, largest / crane.gravity)
    sizes[drives] = accelerations / frequency**2
    state_sizes = np.concatenate([sizes, frequency * sizes])
    return np.diag(state_sizes**-2.0), EFFORT_FACTOR * np.diag(efforts**-2.0)


def _planned(briefing: Briefing, plan: Callable[[Briefing], Motion]) -> Entry:
    """Return an LQR about a planned motion to the goal; about the path or the rest elsewhere.

    Raises:
        Declined: Under an operator, or if the plan is for tower cranes and this is none.
    """
    try:
        gains, motion = _design(briefing, plan if briefing.kind in MOVES else _smooth)
    except (MissingRole, ModelError) as error:
        raise Declined(str(error)) from error
    return briefing.entry(gains, motion, "effort")


def _smooth(briefing: Briefing) -> Motion:
    """Return the smooth motion that does what the task asks for."""
    return briefing.motion


def _plain_reference(briefing: Briefing) -> Reference:
    """Return a smooth motion of the drives to the goal, the path, or the rest.

    Raises:
        Declined: Under an operator.
    """
    return briefing.motion if briefing.path is None else briefing.path


def _planning_limits(briefing: Briefing) -> Limits:
    """Return the limits that planned motions keep."""
    limits = briefing.limits
    return Limits(
        (PLANNED_SHARE * np.array(limits.rates)).tolist(),
        (PLANNED_SHARE * np.array(limits.accelerations)).tolist(),
    )


# --- the baselines --------------------------------------------------------------------------------


def spline_alone(briefing: Briefing) -> Entry:
    """A smooth motion of the drives without a look at the swing, followed with compensated lag."""
    reference = _plain_reference(briefing)
    return briefing.entry(follow(briefing.crane, reference, briefing.period), reference, "motion")


def spline_pd(briefing: Briefing) -> Entry:
    """The same motion, followed by PD controllers of the drives."""
    reference = _plain_reference(briefing)
    return briefing.entry(hold_controller(briefing.crane), reference, "effort")


def paper_lqr_pid(briefing: Briefing) -> Entry:
    """Two LQRs and a PID for the hoist, of the paper that the README names; tower cranes only."""
    motion = briefing.motion
    try:
        controller = paper_controller(briefing.crane, motion)
    except (MissingRole, ModelError) as error:
        raise Declined(str(error)) from error
    return briefing.entry(controller, motion, "effort")


def full_lqr(briefing: Briefing) -> Entry:
    """An LQR of the full model about a smooth motion of the drives with the load plumb."""
    return _planned(briefing, _smooth)


def flat_lqr(briefing: Briefing) -> Entry:
    """The same LQR about a motion that carries the load along its own path; tower cranes only."""
    return _planned(briefing, _flat)


def _flat(briefing: Briefing) -> Motion:
    """Return a motion that carries the load along its own path, as long as the smooth one."""
    return _flat_lasting(briefing, briefing.moderate_duration)


def _flat_lasting(briefing: Briefing, duration: float) -> Motion:
    """Return a motion that carries the load along its own path in a duration [s]."""
    assert briefing.goal is not None
    return flat(briefing.crane, briefing.start, briefing.goal, duration, period=briefing.period)


def fastest_flat_lqr(briefing: Briefing) -> Entry:
    """The same, as fast as four fifths of the drives' limits allow; tower cranes only."""
    return _planned(briefing, _fastest_flat)


def _fastest_flat(briefing: Briefing) -> Motion:
    """Return the fastest motion that carries the load along its own path within the limits."""
    lasting = partial(_flat_lasting, briefing)
    return lasting(fastest(briefing.crane, lasting, _planning_limits(briefing)))


def least_time_lqr(briefing: Briefing) -> Entry:
    """An LQR about the motion of least time at four fifths of all limits, by optimal control."""
    return _planned(briefing, _least_time)


def _least_time(briefing: Briefing) -> Motion:
    """Return the motion of least time."""
    return _optimal(briefing, None)


def least_swing_lqr(briefing: Briefing) -> Entry:
    """An LQR about the motion of least swing in the duration of the smooth motion."""
    return _planned(briefing, _least_swing)


def _least_swing(briefing: Briefing) -> Motion:
    """Return the motion of least swing that lasts as long as the smooth one."""
    return _optimal(briefing, briefing.moderate_duration)


def _optimal(briefing: Briefing, duration: float | None) -> Motion:
    """Return the motion of least time, or of least swing in a duration [s]."""
    from cranedyn.lifts.planning.optimal import optimal

    assert briefing.goal is not None
    converters = briefing.converters
    return optimal(
        briefing.crane,
        briefing.start,
        briefing.goal,
        _planning_limits(briefing),
        swing=PLANNED_SHARE * briefing.swing_bound / math.sqrt(2.0),
        ramp=float((converters.accelerations / converters.jerks).max()),
        period=briefing.period,
        duration=duration,
    )


def operator_alone(briefing: Briefing) -> Entry:
    """The joystick held so that the drives arrive soonest, or the operator's rates as they are."""
    return _shaped(briefing, Shaper(np.array([0.0]), np.array([1.0])))


def operator_zv(briefing: Briefing) -> Entry:
    """The same, shaped by two impulses so that no swing is left (zero vibration)."""
    return _shaped(briefing, zv())


def operator_zvd(briefing: Briefing) -> Entry:
    """The same, shaped by three impulses (zero vibration and derivative)."""
    return _shaped(briefing, zvd())


def operator_ei(briefing: Briefing) -> Entry:
    """The same, shaped by three impulses, extra insensitive to the period."""
    return _shaped(briefing, ei())


def _shaped(briefing: Briefing, shaper: Shaper) -> Entry:
    """Return the motion of an operator, or the path, shaped for the period of the load."""
    crane = briefing.crane
    command = ShapedVelocityCommand(
        crane,
        delays=briefing.swing_period * shaper.fractions,
        amplitudes=shaper.amplitudes,
        period=briefing.period,
        recovery=gentle_recovery(briefing.converters),
    )
    if briefing.kind == "operator":
        return _with_operator(briefing, lambda operator: (command, "velocity"))
    return briefing.entry(command, _joystick_reference(briefing))


def _joystick_reference(briefing: Briefing) -> Reference:
    """Return the motion of an operator to the goal; the path or the rest elsewhere."""
    if briefing.kind not in MOVES:
        return _plain_reference(briefing)
    assert briefing.goal is not None
    drives = briefing.crane.layout.drives
    corners = [briefing.start.q[drives].tolist(), briefing.goal.q[drives].tolist()]
    limits = briefing.limits.for_crane(briefing.crane)
    return joystick_path(briefing.crane, briefing.start, corners, limits).reference


def yielding_drives(briefing: Briefing) -> Entry:
    """Drives that yield to the swing while they follow an operator; tower cranes only."""
    crane = briefing.crane
    limits = briefing.limits

    def make(reference: Reference) -> tuple[Any, str]:
        damping = with_damping(
            crane,
            reference,
            limits=limits,
            recovery=YIELD_RECOVERY,
            control_period=briefing.period,
        )
        return damping, "motion"

    try:
        if briefing.kind == "operator":
            return _with_operator(briefing, make)
        reference = _joystick_reference(briefing)
        controller, drive = make(reference)
        return briefing.entry(controller, reference, drive)
    except (MissingRole, ModelError) as error:
        raise Declined(str(error)) from error


def mpc_path(briefing: Briefing) -> Entry:
    """Compiled predictive control that tracks the smooth motion."""
    motion = briefing.motion
    return briefing.entry(_receding(briefing, motion), motion)


def mpc_goal(briefing: Briefing) -> Entry:
    """Compiled predictive control that finds its own way to the goal, or follows the operator."""
    if briefing.kind == "operator":
        return _with_operator(briefing, lambda operator: (_receding(briefing, None), "velocity"))
    if briefing.path is not None:
        return briefing.entry(_receding(briefing, None), briefing.path)
    return briefing.entry(_receding(briefing, None), hold(briefing.crane, briefing.goal))


def _receding(briefing: Briefing, motion: Motion | None) -> Any:
    """Return compiled predictive control for converters."""
    from cranedyn.compiled.horizon.receding import receding, usual_input_weight

    limits = briefing.limits
    return receding(
        briefing.crane,
        limits,
        motion=motion,
        drive="velocity",
        converters=briefing.converters,
        swing_limit=PLANNED_SHARE * briefing.swing_bound / math.sqrt(2.0),
        control_period=briefing.period,
        input_weight=SOFTER * usual_input_weight(np.array(limits.accelerations)),
    )


# --- controllers of other papers ------------------------------------------------------------------


def kaepernick_mpc(briefing: Briefing) -> Entry:
    """Predictive control of Käpernick and Graichen (2013), a problem for each axis; bridge cranes
    only, no paths and operators.
    """
    from cranedyn.benchmark.papers import (
        GRAMPC_POINTS,
        GRAMPC_ROPE,
        GRAMPC_SWING_RATE,
        CraneMpc,
    )

    _check_bridge_crane(briefing)
    if briefing.goal is None:
        raise Declined("It goes to a goal that stays.")
    converters = briefing.converters
    drives = briefing.crane.layout.drives
    goal = briefing.goal.q[drives]
    ropes = (briefing.start.q[drives[2]], goal[2])
    # The rope of the example is 2 m long; times grow with the square root of lengths.
    scale = max(ropes) / GRAMPC_ROPE
    swing_rate = GRAMPC_SWING_RATE / math.sqrt(scale)
    bridge_limit, trolley_limit, hoist_limit = PLANNED_SHARE * converters.accelerations

    def control(trolley_limit: float, *, hoists: bool) -> CraneMpc:
        return CraneMpc(
            accelerations=[trolley_limit, hoist_limit],
            swing_rate=swing_rate,
            scale=scale,
            gravity=briefing.crane.gravity,
            hoists=hoists,
        )

    bridge = control(bridge_limit, hoists=False)
    trolley = control(trolley_limit, hoists=True)
    points = trolley.step * np.arange(GRAMPC_POINTS)
    # The rates of a plan are commanded so much earlier as the drives are late.
    lead = briefing.period + converters.delay + converters.lags
    plans = np.zeros((GRAMPC_POINTS, 3))
    begun = -math.inf

    def rates(reading: SensorReading) -> np.ndarray:
        nonlocal plans, begun
        if reading.t - begun > (MPC_EVERY - 0.5) * briefing.period:
            begun = reading.t
            bridge_x, x, rope = reading.position
            bridge_rate, x_rate, rope_rate = reading.rate
            phi, theta = reading.swing
            phi_rate, theta_rate = reading.swing_rate
            trolley_plan, _ = trolley.plan(
                np.array([x, x_rate, rope, rope_rate, phi, phi_rate]),
                np.array([goal[1], 0.0, goal[2], 0.0, 0.0, 0.0]),
            )
            bridge_plan, _ = bridge.plan(
                np.array([bridge_x, bridge_rate, rope, 0.0, theta, theta_rate]),
                np.array([goal[0], 0.0, rope, 0.0, 0.0, 0.0]),
            )
            plans = np.column_stack([bridge_plan[:, 1], trolley_plan[:, 1], trolley_plan[:, 3]])
        ahead = reading.t - begun + lead
        planned = [np.interp(t, points, plan) for t, plan in zip(ahead, plans.T, strict=True)]
        return np.clip(planned, -converters.rates, converters.rates)

    return rates


def container_crane_lqr(briefing: Briefing) -> Entry:
    """An LQR about the motion of least swing of Augustin and Maurer (2001); where a trolley and its
    rope alone move.
    """
    from cranedyn.benchmark.papers import ContainerCrane, minimum_swing

    _check_bridge_crane(briefing)
    if briefing.kind not in MOVES:
        raise Declined("It plans a move from rest to rest.")
    assert briefing.goal is not None
    crane = briefing.crane
    drives = crane.layout.drives
    start = briefing.start.q[drives]
    goal = briefing.goal.q[drives]
    if start[0] != goal[0]:
        raise Declined("It plans a trolley and its rope in a plane; here the bridge moves as well.")
    limits = _planning_limits(briefing)
    _, trolley_rate, hoist_rate = limits.rates
    _, trolley_acceleration, hoist_acceleration = limits.accelerations
    plan = minimum_swing(
        ContainerCrane(
            start=(start[1], start[2], 0.0, 0.0, 0.0, 0.0),
            goal=(goal[1], goal[2], 0.0, 0.0, 0.0, 0.0),
            duration=briefing.moderate_duration,
            c4=0.0,
            c5=crane.gravity,
            trolley=trolley_acceleration,
            hoist=(-hoist_acceleration, hoist_acceleration),
            rates=(trolley_rate, hoist_rate),
        )
    )
    rows = round(briefing.moderate_duration / briefing.period) + 1
    times = briefing.period * np.arange(rows)
    x, rope, angle, x_rate, rope_rate, angle_rate = [
        np.interp(times, plan.t, column) for column in plan.x.T
    ]
    u, rope_acceleration = [np.interp(times, plan.t, column) for column in plan.u.T]
    angle_acceleration = -(u + crane.gravity * angle + 2.0 * rope_rate * angle_rate) / rope
    samples = np.zeros((3, rows, crane.layout.n))
    samples[0] = briefing.start.q
    samples[:, :, drives[1]] = x, x_rate, u
    samples[:, :, drives[2]] = rope, rope_rate, rope_acceleration
    # The angle of the paper is positive where the load leads, that of the crane where it lags.
    samples[:, :, crane.swings[0]] = -angle, -angle_rate, -angle_acceleration
    # After its last row the crane stands still.
    samples[1:, -1] = 0.0
    q, v, a = samples
    motion = Motion(briefing.period, q, v, a, drives)
    return briefing.entry(_gains(briefing, motion), motion, "effort")


def _check_bridge_crane(briefing: Briefing) -> None:
    """Check that a crane has a bridge, a trolley and a hoist, and a load on a rope.

    Raises:
        Declined: If it has not.
    """
    crane = briefing.crane
    drives = [joint.symbol for joint in crane.layout.driven]
    if drives != ["bridge", "x", "l"] or len(crane.swings) != 2:
        raise Declined("It is for cranes with a bridge, a trolley, a hoist, and a load on a rope.")


# --- trained policies -----------------------------------------------------------------------------


def ppo_inteco(briefing: Briefing) -> Entry:
    """A small network trained by PPO on the crane inteco; no paths and operators."""
    return _trained(briefing, "ppo_inteco")


def ppo_gantry(briefing: Briefing) -> Entry:
    """A small network trained by PPO on the crane gantry; no paths and operators."""
    return _trained(briefing, "ppo_gantry")


def sac_inteco(briefing: Briefing) -> Entry:
    """A small network trained by SAC on the crane inteco; no paths and operators."""
    return _trained(briefing, "sac_inteco")


def _trained(briefing: Briefing, name: str) -> Entry:
    """Return a trained policy.

    Raises:
        Declined: On another crane than that on which it was trained, on a path, and under an
            operator.
    """
    from cranedyn.benchmark.policy import FOLDER, read_policy

    policy = read_policy(FOLDER / f"{name}.npz")
    trained_on = policy.task.partition("/")[0]
    if briefing.task.partition("/")[0] != trained_on:
        raise Declined(f"It was trained on the crane {trained_on}.")
    if briefing.goal is None:
        raise Declined("It was trained to go to a goal that stays.")
    goal = briefing.goal.q[briefing.crane.layout.drives]
    command = np.zeros(len(goal))
    next_action = 0.0

    def rates(reading: SensorReading) -> np.ndarray:
        nonlocal command, next_action
        if reading.t > next_action - 0.5 * briefing.period:
            next_action += policy.period
            action = policy.action(
                goal - reading.position,
                reading.position,
                reading.rate,
                reading.swing,
                reading.swing_rate,
            )
            command = action * policy.scales.rate
        return command

    return rates


NAMES = (
    *("spline_alone", "spline_pd", "paper_lqr_pid", "full_lqr", "flat_lqr", "fastest_flat_lqr"),
    *("least_time_lqr", "least_swing_lqr", "operator_alone", "operator_zv", "operator_zvd"),
    *("operator_ei", "yielding_drives", "mpc_path", "mpc_goal"),
    *("kaepernick_mpc", "container_crane_lqr"),
    *("ppo_inteco", "ppo_gantry", "sac_inteco"),
)
"""Names of the baselines."""
