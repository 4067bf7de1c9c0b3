"""Moves of least time or least swing under the limits of the drives and a bound of the swing, by
optimal control on the full model.

CasADi (Andersson et al. 2019) gives IPOPT (Wächter & Biegler 2006) exact derivatives of the model's
inverse dynamics.
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
from cranedyn.clocks import intervals
from cranedyn.dynamics import symbolic
from cranedyn.dynamics.linearisation import free_modes
from cranedyn.dynamics.pinocchio import holding_effort, payload_position, prescribed_acceleration
from cranedyn.dynamics.symbolic import ca
from cranedyn.errors import OutOfRange, number, within
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.planning import transcription
from cranedyn.references.limits import Limits
from cranedyn.references.motion import Motion
from cranedyn.references.spline import spline

_ACCELERATION, _JERK = 0.010, 0.003
"""A drive at its limit of acceleration, or of jerk, counts like this much swing [rad]: drives are
quiet where it makes no difference."""

_WORTH = 3.0
"""Seconds of duration that are worth 1 rad² s of squared swing: little enough that a move loses
some milliseconds of time to swing at most, and that one whose duration is given does not last
longer; enough to decide among moves that are equally fast."""

_INTERVAL = 0.25
"""Longest interval of constant jerk [s]."""

_SHARE = 0.25
"""An interval is at most this share of the shortest period in which the passive joints swing."""

_ALONE = threading.Lock()
"""CasADi counts who holds its symbols without care for threads, so one thread at a time."""

_MOST, _RAMPS = 10_000, (1e-3, 3600.0)
"""Intervals that a motion may have, and the shortest and longest ramp [s]."""

_TAUT = 0.1
"""Least tension of the rope, as a share of the payload's weight."""

_SIZE = {"revolute": 1.0, "prismatic": 10.0}
"""Size of the way of a drive [rad or m], by its kind."""

_PLUMB = 1e-9
"""How far from its balance an elastic crane may be at rest [rad or m]."""

_SOON = 1e-6
"""What counts as the same time [s]."""


@dataclass(frozen=True, eq=False)
class _Move:
    """What is asked for; `drives` are those that move, by their place among the drives."""

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

    The jerk of the drives is constant over intervals, so accelerations are continuous and a
    controller can track them. Kept are the ranges of the joints, rates, accelerations, the effort
    limits of the crane and the bound of the swing, and the rope stays taut. Rates, accelerations
    and jerks keep their limits at all times; the others do at points an eighth of a second apart or
    less, and between these the swing to second order.

    Swing is the integral of the squares of all swings, with a small share for accelerations and
    jerks. The longer a move and the shorter its ramp, the more intervals there are and the longer
    it takes to find it.

    Args:
        crane: The crane.
        start: Where it hangs at rest.
        goal: Where it shall hang at rest.
        limits: Of the rates and accelerations of the drives.
        swing: Largest size of each swing [rad].
        duration: Time for the move [s]; None for the least. The last row of the motion is the first
            at or after its end.
        ramp: Time in which a drive may reach its limit of acceleration [s], which sets the limit of
            its jerk. Half of it, but no more than 0.25 s, is the length of an interval.
        still: Drives that shall not move, by symbol. None for those that have no way to go, but for
            a trolley, which may always help, since slewing drives the load outward.
        period: Time between rows [s].

    Raises:
        OutOfRange: If an end is out of the crane's range or not at rest, both ends are one place, a
            number is not positive, the hoist cannot hold the load, or the duration is shorter than
            the least.
        UnknownName: If a drive that shall stand still is none.
        CraneError: If IPOPT does not converge.
    """
    _check_ends(crane, start, goal)
    swing, period = number("swing", swing, "rad", "> 0"), number("period", period, "s", "> 0")
    if swing >= math.pi / 2:
        raise OutOfRange("swing", swing, "above 0 and below π/2", "rad")
    drives = _moving(crane, start, goal, still)
    rate = crane.layout.for_drives("rate limit", limits.rates, "/s", "> 0")[drives]
    acceleration = crane.layout.for_drives(
        "acceleration limit", limits.accelerations, "/s²", "> 0"
    )[drives]
    jerk = acceleration / within("ramp", number("ramp", ramp, "s", "> 0"), *_RAMPS, "s")
    move = _Move(crane, start, goal, drives, rate, acceleration, jerk, swing)
    least = 0.0 if duration is None else number("duration", duration, "s", "> 0")
    slowest, fastest = _periods(move)
    about, interval = (
        max(least, _about(move, slowest) + ramp),
        min(ramp / 2.0, _INTERVAL, _SHARE * fastest),
    )
    intervals("duration", about, period)
    if about / interval > _MOST:
        raise OutOfRange(
            "duration",
            about,
            f"{_MOST * interval:g} or less with intervals of {interval:g} s: half the ramp at most",
            "s",
        )
    guess = _guess(move, about, interval)
    with _ALONE:
        plan = transcription.solve(
            _problem(move), guess, equal=True, least=least / len(guess.durations)
        )
    if duration is not None and plan.durations.sum() > duration + _SOON:
        shortest = math.ceil(100.0 * plan.durations.sum()) / 100.0
        raise OutOfRange("duration", duration, f"at least {shortest:.2f} s to keep all limits", "s")
    return _motion(move, plan, period)


def _check_ends(crane: Crane, start: State, goal: State) -> None:
    layout = crane.layout
    for where, state in (("start", start), ("goal", goal)):
        rest = crane.hanging(state.q) if crane.springs.any else np.zeros(layout.n)
        for i, joint in enumerate(layout.joints):
            within(
                f"{joint.symbol} at the {where}",
                state.q[i],
                crane.lower[i],
                crane.upper[i],
                joint.unit,
            )
            if not joint.driven and abs(state.q[i] - rest[i]) > _PLUMB * crane.springs.any:
                raise OutOfRange(
                    f"{joint.symbol} at the {where}",
                    state.q[i],
                    f"{rest[i]:g}: it hangs at rest",
                    joint.unit,
                )
            if state.v[i] != 0.0:
                raise OutOfRange(
                    f"{joint.symbol}_dot at the {where}",
                    state.v[i],
                    "0: it hangs at rest",
                    f"{joint.unit}/s",
                )
    if np.array_equal(start.q, goal.q):
        raise OutOfRange("goal", "the start itself", "another place")
    hoist = layout.drive_of("hoist")
    if hoist is not None:
        holding = abs(holding_effort(crane, start.q)[hoist]) / crane.effort_limit[hoist]
        number("share of the hoist's effort limit that holds the load", holding, "", "0 to 1")


def _moving(crane: Crane, start: State, goal: State, still: Sequence[str] | None) -> np.ndarray:
    """Which of the drives move."""
    layout = crane.layout
    goes = goal.q[layout.drives] != start.q[layout.drives]
    if still is None:
        helps = [joint.role == "trolley" and layout.has("slew") for joint in layout.driven]
        return np.flatnonzero(goes | helps)
    for name in still:
        if goes[layout.drive(name)]:
            raise OutOfRange("still", name, "drives that have no way to go")
    return np.array([i for i, joint in enumerate(layout.driven) if joint.symbol not in still])


def _periods(move: _Move) -> tuple[float, float]:
    """The longest and the shortest period of the passive joints with the drives at rest, at either
    end [s].
    """
    if not len(move.crane.layout.passive):
        return 0.0, math.inf
    rates = np.concatenate(
        [free_modes(move.crane, end).frequencies for end in (move.start, move.goal)]
    )
    return 2.0 * math.pi / float(rates.min()), 2.0 * math.pi / float(rates.max())


def _problem(move: _Move) -> transcription.Problem:
    """State: passive joints, their rates, then positions, rates, accelerations of the drives that
    move. Control: jerks of these drives.
    """
    crane, m, layout = move.crane, len(move.drives), move.crane.layout
    drives, passive, p = (
        layout.drives[move.drives].tolist(),
        layout.passive.tolist(),
        len(layout.passive),
    )
    x, u, gap = ca.SX.sym("x", 2 * p + 3 * m), ca.SX.sym("u", m), ca.SX.sym("gap")
    free, free_rate, position, rate, acceleration = ca.vertsplit(
        x, np.cumsum([0, p, p, m, m, m]).tolist()
    )
    q, v, a = ca.SX(move.start.q), ca.SX(layout.n, 1), ca.SX(layout.m, 1)
    q[passive], v[passive], q[drives], v[drives], a[move.drives.tolist()] = (
        free,
        free_rate,
        position,
        rate,
        acceleration,
    )
    full, effort = symbolic.prescribed_acceleration(crane, q, v, a)
    swings = np.isin(layout.passive, crane.swings)
    angle, angle_rate = (part[np.flatnonzero(swings).tolist()] for part in (free, free_rate))
    swing = (
        ca.sumsqr(angle)
        + ca.sumsqr(_ACCELERATION * acceleration / move.acceleration)
        + ca.sumsqr(_JERK * u / move.jerk)
    )
    # Between two points a parabola stays below the higher of them or the crossing of its tangents,
    # half a gap ahead.
    shares = ca.vertcat(
        (angle + gap / 2.0 * angle_rate) / move.swing,
        (rate + gap / 2.0 * acceleration) / move.rate,
        effort / crane.effort_limit,
    )
    tension, hoist = ca.SX(0, 1), layout.drive_of("hoist")
    if hoist is not None:
        cable = int(layout.drives[hoist])
        tension = (crane.damping[cable] * v[cable] - effort[hoist]) / abs(
            holding_effort(crane, move.start.q)[hoist]
        )
    moving = [layout.driven[drive] for drive in move.drives]
    ones, any_rate, bound = (
        np.ones(shares.numel()),
        np.full(p, np.inf),
        np.where(swings, move.swing, np.inf),
    )
    high = [
        np.minimum(bound, crane.upper[passive]),
        any_rate,
        crane.upper[drives],
        move.rate,
        move.acceleration,
    ]
    low = [
        np.maximum(-bound, crane.lower[passive]),
        -any_rate,
        crane.lower[drives],
        -move.rate,
        -move.acceleration,
    ]
    return transcription.Problem(
        x=x,
        u=u,
        gap=gap,
        rates=ca.vertcat(free_rate, full[passive], rate, acceleration, u),
        cost=1.0 + _WORTH * swing,
        path=ca.vertcat(shares, tension),
        bounds=np.array([np.concatenate(low), np.concatenate(high)]),
        control_bounds=np.array([-move.jerk, move.jerk]),
        path_bounds=np.array(
            [[*-ones, *np.full(tension.numel(), _TAUT)], [*ones, *np.full(tension.numel(), np.inf)]]
        ),
        scale=np.concatenate(
            [
                np.full(2 * p, 0.1),
                [_SIZE[joint.kind] for joint in moving],
                move.rate,
                move.acceleration,
            ]
        ),
    )


def _about(move: _Move, slowest: float) -> float:
    """About the least time [s], to begin the search: trapezoids of the rates, slow enough for the
    swing; the longest period at least.
    """
    crane, layout = move.crane, move.crane.layout
    reach = max(
        float(np.hypot(*payload_position(crane, end.q)[:2])) for end in (move.start, move.goal)
    )
    way = np.abs(move.goal.q - move.start.q)[layout.drives][move.drives]
    gentle = crane.gravity * move.swing
    joints = [layout.driven[drive] for drive in move.drives]
    at_most = [
        math.inf if joint.role == "hoist" else gentle / (reach if joint.kind == "revolute" else 1.0)
        for joint in joints
    ]
    acceleration = np.minimum(move.acceleration, at_most)
    peak = np.minimum(move.rate, np.sqrt(way * acceleration))
    trapezoids = np.divide(way, peak, out=np.zeros_like(way), where=way > 0.0) + peak / acceleration
    return max(slowest, float(trapezoids.max()))


def _guess(move: _Move, duration: float, interval: float) -> transcription.Plan:
    """A spline of the drives, with the load plumb."""
    n, layout = math.ceil(duration / interval), move.crane.layout
    durations = np.full(n, duration / n)
    times = transcription.times(durations)
    curve = spline(move.crane, move.start, [move.goal.q[layout.drives]], [duration])
    rest = [
        np.outer(1.0 - times / duration, move.start.q[layout.passive])
        + np.outer(times / duration, move.goal.q[layout.passive])
    ]
    rest.append(np.zeros_like(rest[0]))
    states = np.hstack([*rest, *(part[:, move.drives] for part in curve.at(times))])
    return transcription.Plan(durations, np.zeros((n, len(move.drives))), states)


def _motion(move: _Move, plan: transcription.Plan, period: float) -> Motion:
    """A plan on the control instants: the drives by integrating its jerks, the swing by integrating
    the crane's own equations.
    """
    nodes = np.concatenate([[0.0], np.cumsum(plan.durations)])
    n, drives, passive = move.crane.layout.n, move.crane.layout.drives, move.crane.layout.passive
    jerk = np.zeros((1, len(plan.durations), len(drives)))
    jerk[0][:, move.drives] = plan.controls
    acceleration = PPoly(jerk, nodes).antiderivative()
    velocity, way = acceleration.antiderivative(), acceleration.antiderivative(2)

    def state(t: float, y: np.ndarray) -> State:
        q, v = move.start.q.copy(), np.zeros(n)
        q[drives] += way(t)
        v[drives] = velocity(t)
        q[passive], v[passive] = np.split(y, 2)
        return State(q, v)

    def accelerations(t: float, y: np.ndarray) -> np.ndarray:
        return prescribed_acceleration(move.crane, state(t, y), acceleration(t))[0]

    t = period * np.arange(math.ceil((nodes[-1] - _SOON) / period))
    rest = np.concatenate([move.start.q[passive], np.zeros(len(passive))])
    swing = _integrate(
        lambda s, y: np.append(y[len(passive) :], accelerations(s, y)[passive]), nodes, t, rest
    )
    states = [state(*row) for row in zip(t, swing, strict=True)]
    q, v = [*(row.q for row in states), move.goal.q], [*(row.v for row in states), np.zeros(n)]
    a = [*(accelerations(*row) for row in zip(t, swing, strict=True)), np.zeros(n)]
    return Motion(period, np.array(q), np.array(v), np.array(a), drives)


def _integrate(
    flow: Callable[[float, np.ndarray], np.ndarray], nodes: np.ndarray, t: np.ndarray, y: np.ndarray
) -> np.ndarray:
    """Passive joints and their rates from y on, at times before the last node; interval by
    interval, since the jerk jumps between.
    """
    rows = []
    for first, last in itertools.pairwise(nodes):
        inside = t[(t >= first) & (t < last)]
        found = solve_ivp(
            flow,
            (first, last),
            y,
            method="DOP853",
            t_eval=np.append(inside, last),
            rtol=1e-10,
            atol=1e-12,
        ).y.T
        rows.append(found[:-1])
        y = found[-1]
    return np.concatenate(rows)
