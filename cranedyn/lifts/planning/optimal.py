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

import numpy as np

from cranedyn.checks import number, whole, within
from cranedyn.clocks import intervals
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import State
from cranedyn.lifts.planning import transcription
from cranedyn.lifts.planning.clearance import Clearance
from cranedyn.lifts.planning.clearance_of import tower_clearance
from cranedyn.lifts.planning.drive_trajectory import SAME_TIME_TOLERANCE, DriveTrajectory
from cranedyn.lifts.planning.half_spaces import half_spaces
from cranedyn.lifts.planning.motion_proof import (
    PROOF_MARGIN,
    Unproven,
    slew_range,
    unproven_parameter,
)
from cranedyn.lifts.planning.move import (
    BALANCE_TOLERANCE,
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
from cranedyn.lifts.planning.tower_clearance import TowerClearance
from cranedyn.lifts.planning.transcription import CollocationPlan
from cranedyn.model.crane import Crane
from cranedyn.references.limits import Limits
from cranedyn.references.motion import Motion

_LEAST_SWING_WEIGHT = 0.03
"""Weight of the cost where the duration is given, as `Preference.longer`: so little that a move
does not last longer than that."""

_MAX_INTERVAL = 0.25
"""Longest interval of constant jerk [s], if none is given."""

_MAX_PERIOD_SHARE = 0.25
"""Longest interval as a share of the shortest period of the passive joints."""

_CASADI_LOCK = threading.Lock()
"""Held while CasADi works: its reference counts are not safe for threads."""

_MAX_INTERVALS = 10_000
"""Largest number of intervals of a motion."""

_MIN_RAMP = 1e-3
"""Shortest ramp other than none [s]."""

_MAX_RAMP = 3600.0
"""Longest ramp [s]."""

_MARGINS = (0.02, 0.1, 0.3)
"""Margins at the points of a plan [m] for its motion between them, tried until it is proven."""

_LEAST_SHARE_AT_FIRST = 0.7
"""Least duration of a plan that is sought before the best one, over that of the first plan."""

_LONGEST_OVER_LEAST = 2.0
"""Largest duration of such a plan over its least."""

_ACTIVE_BOUND = 1e-3
"""Distance from a bound of its duration up to which such a plan is held by the bound, as a share of
the least duration."""

_END_TOLERANCE = 1e-6
"""Largest distance of the ends of a first motion from start and goal [rad or m]."""

_SLEW_MARGIN = 1e-3
"""Margin to the ends of the free slew angles [rad]: more than the jib turns between two rows."""

_ROUNDING = 1e-9
"""Share of a period by which a duration may exceed a whole number of periods by rounding."""


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
    and jerks keep their limits at all times; the others do at three points of each interval, half
    an interval apart or less, and between these the swing does to second order.

    Without a ramp accelerations are constant over intervals, and jump between them.

    Where a move begins or ends in motion, its drives do not accelerate there, unless there is no
    ramp. A move that ends in motion lasts a whole number of periods, and it is the one of least
    cost of those that last as long; after its last row a `Motion` stands still, so that another has
    to follow.

    Everything that hangs keeps the distance of the site from obstacles, with an envelope of its
    swing, as in `cranedyn.lifts.planning.lift`. The motion is proven, not sampled. It is the best
    between planes that separate crane and obstacles where the search begins, and so passes these on
    the same side. A search that begins with the result may improve it.

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
        still: Drives that shall not move, by symbol. None for those whose position is the same at
            start and goal, but for the trolley of a slewing crane, which may help since slewing
            drives the load outward. Among obstacles None lets all drives move.
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
        ModelError: If there are obstacles and it is not a tower crane of this project's kind.
        UnknownName: If one of `still` is no drive.
        Unproven: If a motion past obstacles is not proven.
        CraneError: If IPOPT does not converge.
    """
    swing = number("swing", swing, "rad", "> 0")
    period = number("period", period, "s", "> 0")
    crane.require_independent_joints("Planning a move of least time")
    if swing >= math.pi / 2:
        raise OutOfRange("swing", swing, "above 0 and below π/2", "rad")
    within("tolerance", number("tolerance", tolerance), 1e-12, 1e-2)
    whole("iterations", iterations, 1)
    start = crane.layout.as_state("start", start)
    goal = crane.layout.as_state("goal", goal)
    drives = _moving_drives(crane, start, goal, still, clearance is not None)
    limits = limits.for_crane(crane)
    rate = np.asarray(limits.rates)
    acceleration = np.asarray(limits.accelerations)
    _check_ends(crane, start, goal, rate, swing)
    jerk = None
    if number("ramp", ramp, "s", ">= 0") > 0.0:
        ramp = within("ramp", ramp, _MIN_RAMP, _MAX_RAMP, "s")
        jerk = (acceleration / ramp)[drives]
    if duration is not None:
        preference = replace(preference, longer=_LEAST_SWING_WEIGHT)
    move = Move(
        crane=crane,
        start=start,
        goal=goal,
        moving_drives=drives,
        rate=rate[drives],
        acceleration=acceleration[drives],
        jerk=jerk,
        swing=swing,
        preference=preference,
    )
    among = None
    if clearance is not None:
        among = tower_clearance(clearance, "A motion of least time among obstacles")
        move = _among_obstacles(move, among)
    shortest = 0.0 if duration is None else number("duration", duration, "s", "> 0")
    first = _first_plan(move, shortest, ramp, interval, period, begin)

    search = _Search(move, among, tolerance, iterations)
    with _CASADI_LOCK:
        plan = search.best(first, shortest)
        if duration is not None:
            _check_duration(duration, plan)
        if goal.v.any():
            # Rows come once a period, and the last must be in motion as the goal is.
            periods_needed = math.ceil(plan.durations.sum() / period - _ROUNDING)
            plan = search.lasting(plan, period * periods_needed)
    motion = DriveTrajectory(move, plan).motion(period)
    if among is not None:
        _check_rows(among, move, motion)
    return motion


def _check_duration(duration: float, plan: CollocationPlan) -> None:
    """Refuse a duration [s] that the fastest plan exceeds.

    Raises:
        OutOfRange: With the duration of that plan, rounded up to hundredths of a second.
    """
    needed = plan.durations.sum()
    if needed > duration + SAME_TIME_TOLERANCE:
        rounded_up = math.ceil(100.0 * needed) / 100.0
        allowed = f"at least {rounded_up:.2f} s to keep all limits"
        raise OutOfRange("duration", duration, allowed, "s")


@dataclass(frozen=True, eq=False)
class _Search:
    """A search for plans of a move, proven ones where there are obstacles.

    Attributes:
        move: The move.
        clearance: Crane and site; None for no obstacles.
        tolerance: Relative error at which the optimiser ends.
        iterations: Most iterations of the optimiser.
    """

    move: Move
    clearance: TowerClearance | None
    tolerance: float
    iterations: int

    def best(self, first: CollocationPlan, shortest: float) -> CollocationPlan:
        """Return the plan of least cost near a first one.

        Args:
            first: The plan with which the search begins.
            shortest: Least duration of the plan [s].

        Raises:
            Unsolved: If the optimiser does not converge.
            Unproven: If there are obstacles, and no plan is proven.
        """
        shortest_interval = shortest / len(first.durations)
        crane = self.move.crane
        if not (is_at_rest(crane, self.move.start) and is_at_rest(crane, self.move.goal)):
            # Such a first plan obeys the equations of motion so badly that the optimiser would make
            # it longer and longer at first. So a plan of about its duration is sought before the
            # best one.
            least = max(shortest_interval, _LEAST_SHARE_AT_FIRST * float(first.durations[0]))
            longest = _LONGEST_OVER_LEAST * least
            first = self._solved(first, least, longest)
            # Where neither bound of the duration is active, this is the best plan already.
            is_above = first.durations[0] > (1.0 + _ACTIVE_BOUND) * least
            is_below = first.durations[0] < (_LONGEST_OVER_LEAST - _ACTIVE_BOUND) * least
            if is_above and is_below and self.clearance is None:
                return first
        return self._proven_with_some_margin(_MARGINS, first, shortest_interval)

    def lasting(self, plan: CollocationPlan, duration: float) -> CollocationPlan:
        """Return the plan of least cost near one that lasts a duration [s], which differs from its
        own by less than a period.
        """
        interval = duration / len(plan.durations)
        plan = plan._replace(durations=np.full_like(plan.durations, interval))
        # Half of the least margin that the plan can have kept is tried first: it leaves room for a
        # plan of another duration.
        margins = (_MARGINS[0] / 2.0, *_MARGINS)
        return self._proven_with_some_margin(margins, plan, interval, interval)

    def _proven_with_some_margin(
        self,
        margins: Sequence[float],
        plan: CollocationPlan,
        shortest: float,
        longest: float = math.inf,
    ) -> CollocationPlan:
        """Return a proven plan of least cost near one. The margins [m] are tried one after the
        other until a plan is proven; other arguments as of `_solved`.

        Raises:
            Unsolved: If the optimiser does not converge with the last margin.
            Unproven: If the plan of the last margin is not proven.
        """
        if self.clearance is None:
            return self._solved(plan, shortest, longest)
        for margin in margins[:-1]:
            try:
                return self._proven(plan, shortest, longest, margin=margin)
            except (transcription.Unsolved, Unproven):
                continue
        return self._proven(plan, shortest, longest, margin=margins[-1])

    def _proven(
        self, plan: CollocationPlan, shortest: float, longest: float = math.inf, *, margin: float
    ) -> CollocationPlan:
        """Return a solved plan as `_solved`, proven to touch no obstacle.

        Raises:
            Unproven: If it is not proven.
        """
        plan = self._solved(plan, shortest, longest, margin)
        if self.clearance is not None:
            trajectory = DriveTrajectory(self.move, plan)
            t = unproven_parameter(self.clearance, trajectory, 0.0, trajectory.duration)
            if t is not None:
                left = self.clearance.swing_margin(trajectory.at(t))
                raise Unproven(t, f"the clearance margin is {left:.3f} m")
        return plan

    def _solved(
        self, plan: CollocationPlan, shortest: float, longest: float = math.inf, margin: float = 0.0
    ) -> CollocationPlan:
        """Return the plan of least cost near one.

        Args:
            plan: The plan with which the search begins.
            shortest: Least duration of an interval [s].
            longest: Largest duration of an interval [s].
            margin: Distance to obstacles at the points of the plan, beyond what a proof needs [m].

        Raises:
            Unsolved: If the optimiser does not converge.
        """
        spaces = None
        if self.clearance is not None:
            # Planes between crane and obstacles, about the places of the plan.
            spaces = half_spaces(self.clearance, self.move.drive_positions(plan.states[1:]), margin)
        return transcription.solve(
            problem(self.move, spaces),
            plan,
            # With one duration allowed the bounds make all intervals equal.
            equal=shortest < longest,
            shortest=shortest,
            longest=longest,
            tolerance=self.tolerance,
            iterations=self.iterations,
        )


def _first_plan(
    move: Move,
    shortest: float,
    ramp: float,
    interval: float | None,
    period: float,
    begin: Motion | None,
) -> CollocationPlan:
    """Return the plan with which the search begins.

    Args:
        move: The move.
        shortest: Least duration of the motion [s].
        ramp: As of `optimal`.
        interval: As of `optimal`.
        period: As of `optimal`.
        begin: As of `optimal`.

    Raises:
        OutOfRange: If the motion to begin with does not lead from start to goal, or there would be
            too many intervals or rows.
    """
    if begin is not None:
        _check_begin(begin, move)
    slowest_period, fastest_period = periods(move)
    longest_interval = min(
        _longest_interval(move, ramp, interval), _MAX_PERIOD_SHARE * fastest_period
    )
    if begin is None:
        # A ramp adds to a trapezoid of the rates the time in which its acceleration sets in.
        estimate = estimated_duration(move, slowest_period) + ramp
    else:
        estimate = begin.arrival
    duration = max(shortest, estimate)
    intervals("duration", duration, period)
    if duration / longest_interval > _MAX_INTERVALS:
        limit = (
            f"{_MAX_INTERVALS * longest_interval:g} or less with intervals of "
            f"{longest_interval:g} s: half the ramp at most"
        )
        raise OutOfRange("duration", duration, limit, "s")
    count = math.ceil(duration / longest_interval)
    if begin is not None:
        return plan_of_motion(move, begin, count)
    return straight_plan(move, duration, count)


def _longest_interval(move: Move, ramp: float, interval: float | None) -> float:
    """Return the longest interval of constant jerk [s], or acceleration without a ramp: a given
    one, or half of the ramp but no more than `_MAX_INTERVAL`.
    """
    if interval is not None:
        return number("interval", interval, "s", "> 0")
    if not move.has_ramp:
        return _MAX_INTERVAL
    return min(ramp / 2.0, _MAX_INTERVAL)


def _check_begin(begin: Motion, move: Move) -> None:
    """Refuse a motion to begin with whose drives do not go from start to goal."""
    begin.check_fits("begin", move.crane.layout)
    drives = move.crane.layout.drives
    for row, end in ((begin.q[0], move.start), (begin.q[-1], move.goal)):
        distance = np.abs(row - end.q)[drives].max()
        if len(begin.q) < 2 or distance > _END_TOLERANCE:
            raise OutOfRange("begin", "a motion between other places", "one from start to goal")


def _check_ends(crane: Crane, start: State, goal: State, rate: np.ndarray, swing: float) -> None:
    """Refuse a start and goal that a move cannot have.

    Args:
        crane: The crane.
        start: First state.
        goal: Last state.
        rate: Limits of the rates of all drives [rad/s or m/s], shape (m,).
        swing: Largest size of each swing [rad].

    Raises:
        OutOfRange: If a state is out of the ranges, limits or bounds or, at rest, not balanced;
            both are the same; or the hoist cannot hold the load.
    """
    layout = crane.layout
    rate_limit = np.full(layout.n, np.inf)
    rate_limit[layout.drives] = rate
    _check_end(crane, "start", start, rate_limit, swing)
    _check_end(crane, "goal", goal, rate_limit, swing)
    if np.array_equal(start.q, goal.q) and np.array_equal(start.v, goal.v):
        raise OutOfRange("goal", "the start itself", "another place")
    hoist = layout.drive_of("hoist")
    if hoist is not None:
        holding = abs(holding_effort(crane, start.q)[hoist]) / crane.effort_limit[hoist]
        number("share of the hoist's effort limit that holds the load", holding, "", "0 to 1")


def _check_end(crane: Crane, end: str, state: State, rate_limit: np.ndarray, swing: float) -> None:
    """Refuse a state that is out of ranges, limits or bounds, or does not hang in balance at rest.

    Args:
        crane: The crane.
        end: "start" or "goal", for the error.
        state: The state.
        rate_limit: Limits of the rates of all joints [rad/s or m/s], shape (n,).
        swing: Largest size of each swing [rad].
    """
    # A load that moves or swings need not be balanced.
    moves = bool(state.v.any() or crane.swing_angles(state.q).any())
    hanging = crane.hanging(state.q)
    for i, joint in enumerate(crane.layout.joints):
        name = f"{joint.symbol} at the {end}"
        position = state.q[i]
        within(name, position, crane.lower[i], crane.upper[i], joint.unit)
        if i in crane.swings:
            within(name, position, hanging[i] - swing, hanging[i] + swing, joint.unit)
        if not (joint.driven or moves) and abs(position - hanging[i]) > BALANCE_TOLERANCE:
            raise OutOfRange(name, position, f"{hanging[i]:g}: it hangs at rest", joint.unit)
        rate_name = f"{joint.symbol}_dot at the {end}"
        within(rate_name, state.v[i], -rate_limit[i], rate_limit[i], f"{joint.unit}/s")


def _moving_drives(
    crane: Crane, start: State, goal: State, still: Sequence[str] | None, obstacles: bool
) -> np.ndarray:
    """Return the indices of the drives that move, among the drives.

    Args:
        crane: The crane.
        start: First state.
        goal: Last state.
        still: As of `optimal`.
        obstacles: Whether there are obstacles; any drive may then have to move.

    Raises:
        OutOfRange: If a drive shall stand still whose position differs between start and goal, or
            which moves at one of them.
        UnknownName: If one of `still` is no drive.
    """
    layout = crane.layout
    differs = (goal.q != start.q) | (goal.v != 0.0) | (start.v != 0.0)
    has_to_move = differs[layout.drives]
    if still is None:
        if obstacles:
            return np.arange(layout.m)
        # Slewing drives the load outward, against which a trolley can help.
        helps = [joint.role == "trolley" and layout.has("slew") for joint in layout.driven]
        return np.flatnonzero(has_to_move | helps)
    for name in still:
        if has_to_move[layout.drive(name)]:
            raise OutOfRange("still", name, "drives that have no way to go")
    return np.array([i for i, joint in enumerate(layout.driven) if joint.symbol not in still])


def _among_obstacles(move: Move, clearance: TowerClearance) -> Move:
    """Return a move among obstacles: the jib in the slew angles that are free about the start, the
    rope within the swing of the site.

    Raises:
        OutOfRange: If start or goal is too close to an obstacle, the rope leans too far there, or
            the jib is not free to slew to the goal.
    """
    for end, state in (("start", move.start), ("goal", move.goal)):
        margin = clearance.swing_margin(state.q[clearance.drive_joints])
        number(f"clearance margin at the {end}", margin - PROOF_MARGIN, "m", ">= 0")
        tilt = float(clearance.tilt(state.q))
        within(f"tilt of the rope at the {end}", tilt, 0.0, clearance.site.swing, "rad")

    slew = clearance.joints.slew
    hoist = clearance.joints.hoist
    lower_limit = float(move.crane.lower[slew])
    upper_limit = float(move.crane.upper[slew])
    slews = slew_range(clearance, float(move.start.q[slew]), lower_limit, upper_limit)

    lower, upper = move.ranges
    lower[hoist] = max(lower[hoist], clearance.shortest_cable)
    lower[slew] = slews.low
    upper[slew] = slews.high
    # The jib keeps away from an obstacle; the end of the joint's own range needs no margin.
    if slews.below:
        lower[slew] += _SLEW_MARGIN
    if slews.above:
        upper[slew] -= _SLEW_MARGIN
    within("gamma at the goal", move.goal.q[slew], lower[slew], upper[slew], "rad")
    return replace(move, tilt=clearance.site.swing, given_ranges=np.array([lower, upper]))


def _check_rows(clearance: TowerClearance, move: Move, motion: Motion) -> None:
    """Check that the rows of a motion keep the angles of rope and jib, as the plan does at its
    points.

    Raises:
        Unproven: If they do not.
    """
    tilt = clearance.tilt(motion.q)
    if tilt.max() > clearance.site.swing:
        k = int(tilt.argmax())
        raise Unproven(k * motion.period, f"the rope leans by {tilt[k]:.4f} rad")
    slew = clearance.joints.slew
    low, high = move.ranges[:, slew]
    slews = motion.q[:, slew]
    # Half of the margin is left for the motion between the rows.
    leaves = (slews < low - _SLEW_MARGIN / 2.0) | (slews > high + _SLEW_MARGIN / 2.0)
    if leaves.any():
        raise Unproven(int(leaves.argmax()) * motion.period, "the jib leaves the free slew angles")
