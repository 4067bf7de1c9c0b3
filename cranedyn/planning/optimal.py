"""Moves of least time or least swing under the limits of the drives and a bound of the swing, by optimal control on the full model.

CasADi (Andersson et al. 2019) gives IPOPT (Wächter & Biegler 2006) exact derivatives of the model's inverse dynamics.
"""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import PPoly

from cranedyn.arguments import checked
from cranedyn.dynamics import symbolic
from cranedyn.dynamics.pinocchio import holding_effort, prescribed_acceleration
from cranedyn.dynamics.symbolic import ca
from cranedyn.errors import OutOfRange, UnknownName, number, within
from cranedyn.interfaces import COORDINATES, UNITS, State
from cranedyn.model.crane import DRIVES, PASSIVE, Crane
from cranedyn.planning import transcription
from cranedyn.references.limits import Limits
from cranedyn.references.motion import Motion
from cranedyn.references.spline import spline
from cranedyn.simulation.clocks import intervals
from cranedyn.theory import point_period

_NAMES = tuple(COORDINATES[i] for i in DRIVES)
_ACCELERATION, _JERK = 0.010, 0.003
"""A drive at its limit of acceleration, or of jerk, counts like this much swing [rad]: drives are quiet where it makes no difference."""

_WORTH = 3.0
"""Seconds of duration that are worth 1 rad² s of squared swing: little enough that a move loses some milliseconds of time to swing at
most, and that one whose duration is given does not last longer; enough to decide among moves that are equally fast."""

_INTERVAL = 0.25
"""Longest interval of constant jerk [s]."""

_ALONE = threading.Lock()
"""CasADi counts who holds its symbols without care for threads, so one thread at a time."""

_MOST, _RAMPS = 10_000, (1e-3, 3600.0)
"""Intervals that a motion may have, and the shortest and longest ramp [s]."""

_TAUT = 0.1
"""Least tension of the rope, as a share of the payload's weight."""

_SOON = 1e-6
"""What counts as the same time [s]."""


@dataclass(frozen=True, eq=False)
class _Move:
    """What is asked for; `drives` are those that move, by their place among slew, trolley and hoist."""

    crane: Crane
    start: State
    goal: State
    drives: np.ndarray
    rate: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray
    swing: float


@checked
def optimal(
    crane: Crane,
    start: State,
    goal: State,
    limits: Limits,
    *,
    swing: float = 0.1,
    duration: float | None = None,
    ramp: float = 0.5,
    still: Sequence[str] | None = None,
    period: float = 5e-3,
) -> Motion:
    """The fastest move from rest to rest, or the one of least swing in a given time.

    The jerk of the drives is constant over intervals, so accelerations are continuous and a controller can track them. Kept are the
    ranges of the joints, rates, accelerations, the effort limits of the crane and the bound of the swing, and the rope stays taut.
    Rates, accelerations and jerks keep their limits at all times; the others do at points an eighth of a second apart or less, and
    between these the swing to second order.

    Swing is ∫ φ² + θ² dt, with a small share for accelerations and jerks. The longer a move and the shorter its ramp, the more
    intervals there are and the longer it takes to find it.

    Args:
        crane: The crane.
        start: Where it hangs at rest.
        goal: Where it shall hang at rest.
        limits: Of the rates and accelerations of the drives.
        swing: Largest size of φ and of θ [rad].
        duration: Time for the move [s]; None for the least. The last row of the motion is the first at or after its end.
        ramp: Time in which a drive may reach its limit of acceleration [s], which sets the limit of its jerk. Half of it, but no
            more than 0.25 s, is the length of an interval.
        still: Drives that shall not move, of "gamma", "x", "l". None for slew and hoist where they have no way to go; the trolley
            may always help, since slewing drives the load outward.
        period: Time between rows [s].

    Raises:
        OutOfRange: If an end is out of the crane's range or not at rest, both ends are one place, a number is not positive, the
            hoist cannot hold the load, or the duration is shorter than the least.
        UnknownName: If a drive that shall stand still is none.
        CraneError: If IPOPT does not converge.
    """
    _check_ends(crane, start, goal)
    swing, period = number("swing", swing, "rad", "> 0"), number("period", period, "s", "> 0")
    if swing >= math.pi / 2:
        raise OutOfRange("swing", swing, "above 0 and below π/2", "rad")
    drives = _moving(start, goal, still)
    rate, acceleration = np.asarray(limits.rates)[drives], np.asarray(limits.accelerations)[drives]
    jerk = acceleration / within("ramp", number("ramp", ramp, "s", "> 0"), *_RAMPS, "s")
    move = _Move(crane, start, goal, drives, rate, acceleration, jerk, swing)
    least = 0.0 if duration is None else number("duration", duration, "s", "> 0")
    about, interval = max(least, _about(move) + ramp), min(ramp / 2.0, _INTERVAL)
    intervals("duration", about, period)
    if about / interval > _MOST:
        raise OutOfRange("duration", about, f"{_MOST * interval:g} or less with intervals of {interval:g} s: half the ramp at most", "s")
    guess = _guess(move, about, interval)
    with _ALONE:
        plan = transcription.solve(_problem(move), guess, equal=True, least=least / len(guess.durations))
    if duration is not None and plan.durations.sum() > duration + _SOON:
        shortest = math.ceil(100.0 * plan.durations.sum()) / 100.0
        raise OutOfRange("duration", duration, f"at least {shortest:.2f} s to keep all limits", "s")
    return _motion(move, plan, period)


def _check_ends(crane: Crane, start: State, goal: State) -> None:
    for where, state in (("start", start), ("goal", goal)):
        for i, (name, unit) in enumerate(zip(COORDINATES, UNITS, strict=True)):
            within(f"{name} at the {where}", state.q[i], crane.lower[i], crane.upper[i], unit)
            if i in PASSIVE and state.q[i] != 0.0:
                raise OutOfRange(f"{name} at the {where}", state.q[i], "0: it hangs at rest", unit)
            if state.v[i] != 0.0:
                raise OutOfRange(f"{name}_dot at the {where}", state.v[i], "0: it hangs at rest", f"{unit}/s")
    if np.array_equal(start.q, goal.q):
        raise OutOfRange("goal", "the start itself", "another place")
    holding = abs(holding_effort(crane, start.q)[2]) / crane.effort_limit[2]
    number("share of the hoist's effort limit that holds the load", holding, "", "0 to 1")


def _moving(start: State, goal: State, still: Sequence[str] | None) -> np.ndarray:
    """Which of the three drives move."""
    goes = goal.q[DRIVES] != start.q[DRIVES]
    if still is None:
        return np.flatnonzero(goes | [False, True, False])
    for name in still:
        if name not in _NAMES:
            raise UnknownName("drive", name, _NAMES)
        if goes[_NAMES.index(name)]:
            raise OutOfRange("still", name, "drives that have no way to go")
    return np.array([i for i, name in enumerate(_NAMES) if name not in still])


def _problem(move: _Move) -> transcription.Problem:
    """State: φ, θ, their rates, then positions, rates, accelerations of the drives that move. Control: jerks of these drives."""
    crane, m = move.crane, len(move.drives)
    drives, passive = DRIVES[move.drives].tolist(), PASSIVE.tolist()
    x, u, gap = ca.SX.sym("x", 4 + 3 * m), ca.SX.sym("u", m), ca.SX.sym("gap")
    angle, angle_rate, position, rate, acceleration = ca.vertsplit(x, [0, 2, 4, 4 + m, 4 + 2 * m, 4 + 3 * m])
    q, v, a = ca.SX(move.start.q), ca.SX(5, 1), ca.SX(3, 1)
    q[passive], v[passive], q[drives], v[drives], a[move.drives.tolist()] = angle, angle_rate, position, rate, acceleration
    full, effort = symbolic.prescribed_acceleration(crane, q, v, a)
    swing = ca.sumsqr(angle) + ca.sumsqr(_ACCELERATION * acceleration / move.acceleration) + ca.sumsqr(_JERK * u / move.jerk)
    # Between two points a parabola stays below the higher of them or the crossing of its tangents, half a gap ahead.
    shares = ca.vertcat(
        (angle + gap / 2.0 * angle_rate) / move.swing, (rate + gap / 2.0 * acceleration) / move.rate, effort / crane.effort_limit
    )
    tension = (crane.damping[4] * v[4] - effort[2]) / (crane.payload_mass * crane.gravity)
    ones = np.ones(shares.numel())
    free = np.full(2, np.inf)
    high = [np.minimum(move.swing, crane.upper[PASSIVE]), free, crane.upper[drives], move.rate, move.acceleration]
    low = [np.maximum(-move.swing, crane.lower[PASSIVE]), -free, crane.lower[drives], -move.rate, -move.acceleration]
    return transcription.Problem(
        x=x,
        u=u,
        gap=gap,
        rates=ca.vertcat(angle_rate, full[passive], rate, acceleration, u),
        cost=1.0 + _WORTH * swing,
        path=ca.vertcat(shares, tension),
        bounds=np.array([np.concatenate(low), np.concatenate(high)]),
        control_bounds=np.array([-move.jerk, move.jerk]),
        path_bounds=np.array([[*-ones, _TAUT], [*ones, np.inf]]),
        scale=np.concatenate([np.full(4, 0.1), np.array([1.0, 10.0, 10.0])[move.drives], move.rate, move.acceleration]),
    )


def _about(move: _Move) -> float:
    """About the least time [s], to begin the search: trapezoids of the rates, slow enough for the swing, and one period at least."""
    gravity, reach, length = move.crane.gravity, max(move.start.q[1], move.goal.q[1]), max(move.start.q[4], move.goal.q[4])
    way = np.abs(move.goal.q - move.start.q)[DRIVES][move.drives]
    acceleration = np.minimum(move.acceleration, np.array([gravity * move.swing / reach, gravity * move.swing, np.inf])[move.drives])
    peak = np.minimum(move.rate, np.sqrt(way * acceleration))
    trapezoids = np.divide(way, peak, out=np.zeros_like(way), where=way > 0.0) + peak / acceleration
    return max(float(point_period(length, gravity)), float(trapezoids.max()))


def _guess(move: _Move, duration: float, interval: float) -> transcription.Plan:
    """A spline of the drives, with the load plumb."""
    n = math.ceil(duration / interval)
    durations = np.full(n, duration / n)
    setpoint = [spline(move.start, [move.goal.q[DRIVES]], [duration])(t) for t in transcription.times(durations)]
    states = np.array([np.concatenate([np.zeros(4), *(part[move.drives] for part in w)]) for w in setpoint])
    return transcription.Plan(durations, np.zeros((n, len(move.drives))), states)


def _motion(move: _Move, plan: transcription.Plan, period: float) -> Motion:
    """A plan on the control instants: the drives by integrating its jerks, the swing by integrating the crane's own equations."""
    nodes = np.concatenate([[0.0], np.cumsum(plan.durations)])
    jerk = np.zeros((1, len(plan.durations), 3))
    jerk[0][:, move.drives] = plan.controls
    acceleration = PPoly(jerk, nodes).antiderivative()
    velocity, way = acceleration.antiderivative(), acceleration.antiderivative(2)

    def state(t: float, y: np.ndarray) -> State:
        q, v = move.start.q.copy(), np.zeros(5)
        q[DRIVES] += way(t)
        v[DRIVES] = velocity(t)
        q[PASSIVE], v[PASSIVE] = y[:2], y[2:]
        return State(q, v)

    def accelerations(t: float, y: np.ndarray) -> np.ndarray:
        return prescribed_acceleration(move.crane, state(t, y), acceleration(t))[0]

    t = period * np.arange(math.ceil((nodes[-1] - _SOON) / period))
    swing = _integrate(lambda s, y: np.append(y[2:], accelerations(s, y)[PASSIVE]), nodes, t)
    states = [state(*row) for row in zip(t, swing, strict=True)]
    q, v = [*(row.q for row in states), move.goal.q], [*(row.v for row in states), np.zeros(5)]
    a = [*(accelerations(*row) for row in zip(t, swing, strict=True)), np.zeros(5)]
    return Motion(period, np.array(q), np.array(v), np.array(a))


def _integrate(flow: Callable[[float, np.ndarray], np.ndarray], nodes: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Swing and its rates from rest, shape (n, 4), at times before the last node; interval by interval, since the jerk jumps between."""
    rows, y = [], np.zeros(4)
    for first, last in itertools.pairwise(nodes):
        inside = t[(t >= first) & (t < last)]
        found = solve_ivp(flow, (first, last), y, method="DOP853", t_eval=np.append(inside, last), rtol=1e-10, atol=1e-12).y.T
        rows.append(found[:-1])
        y = found[-1]
    return np.concatenate(rows)
