"""Moves of least time or least swing under the limits of the drives and a bound of the swing, by
optimal control on the full model.

CasADi (Andersson et al. 2019) gives IPOPT (Wächter & Biegler 2006) exact derivatives of the model's
inverse dynamics.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cranedyn.checks import number, whole, within
from cranedyn.clocks import intervals
from cranedyn.dynamics.pinocchio import holding_effort
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.planning import transcription
from cranedyn.planning.clearance import Clearance
from cranedyn.planning.drive_trajectory import SOON, DriveTrajectory
from cranedyn.planning.half_spaces import half_spaces
from cranedyn.planning.move import (
    PLUMB,
    USUAL,
    Move,
    Preference,
    estimated_duration,
    is_at_rest,
    periods,
    plan_of_motion,
    problem,
    straight_plan,
)
from cranedyn.planning.proof import CLOSE, Unproven, slew_range, unproven_parameter
from cranedyn.planning.transcription import CollocationPlan
from cranedyn.references.limits import Limits
from cranedyn.references.motion import Motion

_LEAST_SWING = 0.03
"""Weight of the cost where the duration is given: so little that a move does not last longer."""

_INTERVAL = 0.25
"""Longest interval of constant jerk [s], if none is given."""

_SHARE = 0.25
"""Longest interval as a share of the shortest period of the passive joints."""

_ALONE = threading.Lock()
"""Held while CasADi works: its reference counts are not safe for threads."""

_MOST, _RAMPS = 10_000, (1e-3, 3600.0)
"""Most intervals of a motion, and shortest and longest ramp other than none [s]."""

_MARGINS = (0.02, 0.1, 0.3)
"""Margins at the points of a plan [m] for its motion between them, tried until it is proven."""

_NEAR = 1e-6
"""Largest distance of the ends of a first motion from start and goal [rad or m]."""

_TURNED = 1e-3
"""Margin to the ends of the free slew angles [rad]: more than the jib turns between two rows."""


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
    interval: float | None = None,
    preference: Preference = USUAL,
    tolerance: float = transcription.TOLERANCE,
    iterations: int = transcription.ITERATIONS,
    clearance: Clearance | None = None,
    begin: Motion | None = None,
) -> Motion:
    """Return the fastest move from one state to another, or the one of least swing in a time.

    The jerk of the drives is constant over intervals, so accelerations are continuous and a
    controller can track them. Kept are the ranges of the joints, rates, accelerations, the effort
    limits of the crane and the bound of the swing, and the rope stays taut. Rates, accelerations
    and jerks keep their limits at all times; the others do at points an eighth of a second apart or
    less, and between these the swing to second order.

    Without a ramp accelerations are constant over intervals, and jump between them.

    Drives that begin or end in motion do so without acceleration, or where there is no ramp with
    any. A motion that ends in motion lasts a whole number of periods, and it is the one of least
    cost of those that last as long; after its last row a `Motion` stands still, so that another has
    to follow.

    Everything that hangs keeps the distance of the site from obstacles, with an envelope of its
    swing, as in `cranedyn.planning.lift`. The motion is proven, not sampled. It is the best between
    planes that separate crane and obstacles where the search begins, and so passes these on the
    same side. A search that begins with the result may improve it.

    The longer a move and the shorter its ramp, the more intervals there are and the longer it takes
    to find it.

    Args:
        crane: The crane.
        start: First state, at rest or in motion.
        goal: Last state, at rest or in motion.
        limits: Rates and accelerations of the drives.
        swing: Largest size of each swing [rad].
        duration: Time for the move [s]; None for the least. The last row of the motion is the first
            at or after its end.
        ramp: Time in which a drive may reach its limit of acceleration [s], which sets the limit of
            its jerk; 0 for accelerations that jump.
        still: Drives that shall not move, by symbol. None for those that have no way to go, but for
            a trolley, which may always help, since slewing drives the load outward; and none where
            there are obstacles.
        period: Time between rows [s].
        interval: Longest interval [s]. None for half of the ramp but no more than 0.25 s. It is
            also no longer than a quarter of the shortest period of a swing.
        preference: Weights that decide among motions that are nearly as fast.
        tolerance: Relative error at which the optimiser ends.
        iterations: Most iterations of the optimiser.
        clearance: Crane and site, so that nothing is touched; the rope then leans no more than the
            swing of the site. None for no obstacles. For a tower crane only.
        begin: A motion from the start to the goal with which the search begins, as of a planned
            lift; None for a straight one.

    Raises:
        OutOfRange: If an end is out of the ranges, limits or bounds or, for what does not move, off
            its balance, both ends are one state, a number makes no sense, the hoist cannot hold
            the load, or the duration is shorter than the least.
        MissingRole: If there are obstacles and it is not a tower crane.
        UnknownName: If a drive that shall stand still is none.
        Unproven: If a motion past obstacles is not proven.
        CraneError: If IPOPT does not converge.
    """
    swing, period = number("swing", swing, "rad", "> 0"), number("period", period, "s", "> 0")
    crane.require_independent_joints("Planning a move of least time")
    if swing >= math.pi / 2:
        raise OutOfRange("swing", swing, "above 0 and below π/2", "rad")
    within("tolerance", number("tolerance", tolerance), 1e-12, 1e-2)
    whole("iterations", iterations, 1)
    start = crane.layout.as_state("start", start)
    goal = crane.layout.as_state("goal", goal)
    drives = _moving(crane, start, goal, still, clearance is not None)
    limits = limits.for_crane(crane)
    rate, acceleration = np.asarray(limits.rates), np.asarray(limits.accelerations)
    _check_ends(crane, start, goal, rate, swing)
    jerk = None
    if number("ramp", ramp, "s", ">= 0") > 0.0:
        jerk = (acceleration / within("ramp", ramp, *_RAMPS, "s"))[drives]
    if duration is not None:
        preference = replace(preference, longer=_LEAST_SWING)
    kept = rate[drives], acceleration[drives], jerk
    move = Move(crane, start, goal, drives, *kept, swing, preference)
    if clearance is not None:
        move = _among_obstacles(move, clearance)
    shortest_duration = 0.0 if duration is None else number("duration", duration, "s", "> 0")
    first = _first_plan(move, shortest_duration, ramp, interval, period, begin)
    search = _Search(move, clearance, {"tolerance": tolerance, "iterations": iterations})
    with _ALONE:
        plan = search.best(first, shortest_duration)
        if duration is not None and plan.durations.sum() > duration + SOON:
            shortest = math.ceil(100.0 * plan.durations.sum()) / 100.0
            raise OutOfRange(
                "duration", duration, f"at least {shortest:.2f} s to keep all limits", "s"
            )
        if goal.v.any():
            plan = search.lasting(plan, period * math.ceil(plan.durations.sum() / period - 1e-9))
    motion = DriveTrajectory(move, plan).motion(period)
    if clearance is not None:
        _check_rows(clearance, move, motion)
    return motion


@dataclass(frozen=True, eq=False)
class _Search:
    """A search for plans of a move, proven ones where there are obstacles.

    Attributes:
        move: The move.
        clearance: Crane and site; None for no obstacles.
        options: Options of the optimiser.
    """

    move: Move
    clearance: Clearance | None
    options: dict[str, Any]

    def best(self, first: CollocationPlan, shortest: float) -> CollocationPlan:
        """Return the best plan near a first one, of no less than a duration [s]."""
        move = self.move
        if not (is_at_rest(move.crane, move.start) and is_at_rest(move.crane, move.goal)):
            # Such a first plan is so far from a motion that the optimiser would give up time first.
            interval = max(shortest / len(first.durations), 0.7 * float(first.durations[0]))
            first = self._solved(first, interval, 2.0 * interval)
            inside = 1.001 * interval < first.durations[0] < 1.999 * interval
            if inside and self.clearance is None:
                return first
        if self.clearance is None:
            return self._solved(first, shortest / len(first.durations))
        failed: CraneError | None = None
        for margin in _MARGINS:
            try:
                return self._proven(first, shortest / len(first.durations), margin=margin)
            except (transcription.Unsolved, Unproven) as error:
                failed = error
        assert failed is not None
        raise failed

    def lasting(self, plan: CollocationPlan, duration: float) -> CollocationPlan:
        """Return the plan of least cost near one that lasts a duration [s]."""
        interval = duration / len(plan.durations)
        plan = plan._replace(durations=np.full_like(plan.durations, interval))
        return self._proven(plan, interval, interval, margin=_MARGINS[0] / 2.0)

    def _proven(
        self, plan: CollocationPlan, shortest: float, longest: float = math.inf, *, margin: float
    ) -> CollocationPlan:
        """Return a solved plan, proven to touch no obstacle."""
        plan = self._solved(plan, shortest, longest, margin)
        if self.clearance is not None:
            drives = DriveTrajectory(self.move, plan)
            t = unproven_parameter(self.clearance, drives, 0.0, drives.duration)
            if t is not None:
                margin = self.clearance.swing_margin(drives.at(t))
                raise Unproven(t, f"the clearance margin is {margin:.3f} m")
        return plan

    def _solved(
        self, plan: CollocationPlan, shortest: float, longest: float = math.inf, margin: float = 0.0
    ) -> CollocationPlan:
        spaces = None
        if self.clearance is not None:
            spaces = half_spaces(self.clearance, self.move.drives_of(plan.states[1:]), margin)
        return transcription.solve(
            problem(self.move, spaces),
            plan,
            equal=shortest < longest,
            shortest=shortest,
            longest=longest,
            **self.options,
        )


def _first_plan(
    move: Move,
    shortest: float,
    ramp: float,
    interval: float | None,
    period: float,
    begin: Motion | None,
) -> CollocationPlan:
    """Return the plan with which the search begins."""
    if begin is not None:
        begin.check_fits("begin", move.crane.layout)
        drives = move.crane.layout.drives
        for row, end in ((begin.q[0], move.start), (begin.q[-1], move.goal)):
            if len(begin.q) < 2 or np.abs(row - end.q)[drives].max() > _NEAR:
                raise OutOfRange("begin", "a motion between other places", "one from start to goal")
    slowest, fastest = periods(move)
    longest = min(ramp / 2.0, _INTERVAL) if move.jerk is not None else _INTERVAL
    if interval is not None:
        longest = number("interval", interval, "s", "> 0")
    longest = min(longest, _SHARE * fastest)
    enough = estimated_duration(move, slowest) + ramp if begin is None else begin.arrival
    duration = max(shortest, enough)
    intervals("duration", duration, period)
    if duration / longest > _MOST:
        limit = (
            f"{_MOST * longest:g} or less with intervals of {longest:g} s: half the ramp at most"
        )
        raise OutOfRange("duration", duration, limit, "s")
    count = math.ceil(duration / longest)
    if begin is not None:
        return plan_of_motion(move, begin, count)
    return straight_plan(move, duration, count)


def _check_ends(crane: Crane, start: State, goal: State, rate: np.ndarray, swing: float) -> None:
    layout = crane.layout
    for end, state in (("start", start), ("goal", goal)):
        rate_limit = np.full(layout.n, np.inf)
        rate_limit[layout.drives] = rate
        moves = bool(state.v.any() or crane.swing_angles(state.q).any())
        hanging = crane.hanging(state.q)
        for i, joint in enumerate(layout.joints):
            name, unit = f"{joint.symbol} at the {end}", joint.unit
            within(name, state.q[i], crane.lower[i], crane.upper[i], unit)
            if i in crane.swings:
                within(name, state.q[i], hanging[i] - swing, hanging[i] + swing, unit)
            if not (joint.driven or moves) and abs(state.q[i] - hanging[i]) > PLUMB:
                raise OutOfRange(name, state.q[i], f"{hanging[i]:g}: it hangs at rest", unit)
            rate_name, limit = f"{joint.symbol}_dot at the {end}", rate_limit[i]
            within(rate_name, state.v[i], -limit, limit, f"{unit}/s")
    if np.array_equal(start.q, goal.q) and np.array_equal(start.v, goal.v):
        raise OutOfRange("goal", "the start itself", "another place")
    hoist = layout.drive_of("hoist")
    if hoist is not None:
        holding = abs(holding_effort(crane, start.q)[hoist]) / crane.effort_limit[hoist]
        number("share of the hoist's effort limit that holds the load", holding, "", "0 to 1")


def _moving(
    crane: Crane, start: State, goal: State, still: Sequence[str] | None, obstacles: bool
) -> np.ndarray:
    """Return the indices of the drives that move."""
    layout, drives = crane.layout, crane.layout.drives
    goes = (goal.q != start.q)[drives] | (goal.v != 0.0)[drives] | (start.v != 0.0)[drives]
    if still is None:
        helps = [joint.role == "trolley" and layout.has("slew") for joint in layout.driven]
        return np.flatnonzero(goes | helps | [obstacles])
    for name in still:
        if goes[layout.drive(name)]:
            raise OutOfRange("still", name, "drives that have no way to go")
    return np.array([i for i, joint in enumerate(layout.driven) if joint.symbol not in still])


def _among_obstacles(move: Move, clearance: Clearance) -> Move:
    """Return a move among obstacles: the jib in the slew angles that are free about the start, the
    rope within the swing of the site.
    """
    crane, joints, drive_joints = move.crane, clearance.joints, clearance.drive_joints
    for end, state in (("start", move.start), ("goal", move.goal)):
        margin = clearance.swing_margin(state.q[drive_joints])
        number(f"clearance margin at the {end}", margin - CLOSE, "m", ">= 0")
        tilt = float(clearance.tilt(state.q))
        within(f"tilt of the rope at the {end}", tilt, 0.0, clearance.site.swing, "rad")
    slew, hoist = joints.slew, joints.hoist
    slews = slew_range(
        clearance, float(move.start.q[slew]), float(crane.lower[slew]), float(crane.upper[slew])
    )
    lower, upper = move.ranges
    lower[hoist] = max(lower[hoist], clearance.shortest_cable)
    lower[slew], upper[slew] = slews.low + _TURNED * bool(slews.below), slews.high
    upper[slew] -= _TURNED * bool(slews.above)
    within("gamma at the goal", move.goal.q[slew], lower[slew], upper[slew], "rad")
    return replace(move, tilt=clearance.site.swing, given_ranges=np.array([lower, upper]))


def _check_rows(clearance: Clearance, move: Move, motion: Motion) -> None:
    """Check that the rows of a motion keep the angles of rope and jib, as the plan does at its
    points.
    """
    tilt, slew = clearance.tilt(motion.q), clearance.joints.slew
    if tilt.max() > clearance.site.swing:
        k = int(tilt.argmax())
        raise Unproven(k * motion.period, f"the rope leans by {tilt[k]:.4f} rad")
    low, high = move.ranges[:, slew]
    slews = motion.q[:, slew]
    off = (slews < low - _TURNED / 2.0) | (slews > high + _TURNED / 2.0)
    if off.any():
        raise Unproven(int(off.argmax()) * motion.period, "the jib leaves the free slew angles")
