"""Plan lifts of several cranes in space and time, so that no two come near each other.

Cranes are planned one after the other. Each takes the path by which it arrives first at the goal of
its next lift, past all motions that are already planned: directly or with the load raised, with the
slew either way round, with or without stops at the points between, and around obstacles where
nothing else is clear of them. A motion is proven to keep away from the obstacles of the site, and
in each slice of time (`SLICE`) it is proven apart from all other cranes.

In a slice a crane has a *box*, an interval for each of its drives: all that its guard
(`cranedyn.lifts.sites.guard`) asks for during the motion, if the motion is up to one slice early or
late. That is why a supervisor grants to a crane what the plan needs.

Conventions of this module:

* m drives, n coordinates (the drives and two swing joints).
* Positions of drives are in rad or m, rates in rad/s or m/s; points are in the frame of the site.
* A crane is named by its index among `CraneSite.stations`.
* A box has shape (2, m): the lower ends, then the upper ends.
* A *path* is a list of the motions that follow each other, each given by the positions of the
  drives that it passes. The load rests between two motions.
"""

from __future__ import annotations

import itertools
import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache, partial
from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import uniform_filter1d

from cranedyn.checks import finite, number, within
from cranedyn.errors import CraneError, OutOfRange, UnknownName, quoted
from cranedyn.interfaces import State
from cranedyn.lifts.planning.boom import boom_length
from cranedyn.lifts.planning.curve import refuse_endless, rest_to_rest_time
from cranedyn.lifts.planning.lift import RESERVE, NoWay
from cranedyn.lifts.sites.brakes import CYCLE
from cranedyn.lifts.sites.conflicts import Conflict, longest
from cranedyn.lifts.sites.crane_site import CraneSite, Station
from cranedyn.lifts.sites.guard import HORIZON, gentle, working_swing
from cranedyn.lifts.sites.site_simulation import SiteOperator
from cranedyn.lifts.sites.working_wind import GUST_RESPONSE, WorkingWind
from cranedyn.references.limits import Limits, use
from cranedyn.references.motion import Motion

SLICE = 0.5
"""Length of a slice of time [s]. It is also how much a crane may be early or late."""

_ROWS_PER_SLICE = 10
"""Rows of a motion in one slice."""

_ROW_PERIOD = SLICE / _ROWS_PER_SLICE
"""Time between two rows of a motion [s]."""

_CERTIFIED_MULTIPLES = (1.0, 2.0, 4.0, 8.0, 16.0)
"""Multiples of the required distance that a certificate tries to prove, in ascending order."""

_SLICES_BEFORE_MAKING_WAY = 120
"""Slices by which a crane may be ready after the first one, and still be planned before any crane
makes way."""

_RAISED_CABLE = 1.0
"""Cable length of a raised load beyond the shortest [m]."""

# A load that travels as far as it can be raised loses the time for which its hoist runs; half way
# up, or part of the way, is often enough to pass a jib, a rope or a load on the ground.
_ARCH_RISES = (0.3, 1.0)
"""How far a load is raised half way along an arch, over how far it can be raised."""

_REFUGE_COUNT = 300
"""Random positions among which a crane looks for a refuge, where it is clear of another's path."""

# The nearest refuges are enough most of the time, so that the others need not be examined.
_NEAREST_REFUGES = 30
"""Number of the position, in ascending order of travel time, from which on refuges are examined
only if none before has served; the first position is where the crane stands."""

_REFUGES_TRIED = 6
"""Refuges to which a crane tries to get."""

_GRID_TIME = 2.0
"""Spacing of the grid on which a path around obstacles is searched, as time at full rate [s]."""

_EDGE_MARGIN_TIME = 0.5
"""Margin on both sides of an edge of the grid that must be clear, too, as time at full rate [s]."""

_MAX_NODES = 5_000
"""Largest number of nodes that a search around obstacles reaches."""

_DEVIATION_GAIN = 0.3
"""Gain by which an operator corrects a deviation from the plan [1/s]."""

_SWING_AVERAGING_TIMES = np.array([1.5, 1.0, 0.5])
"""Durations of the moving averages that smooth the motion of a load, in units of √(l/g)."""

_ROWS_AT_REST = 4
"""Rows at rest before and after a motion."""

_MAX_SLOWDOWNS = 20
"""Times that a motion is slowed down until it keeps its limits."""

# A motion that is slowed down to exactly its limits may exceed them by rounding.
_SLOWDOWN_MARGIN = 0.998
"""Share of the limits to which a motion that exceeds them is slowed down."""

# Without it a leg between equal positions would take no time, and its rate would be 0/0.
_MIN_LEG_TIME = 1e-3
"""Time that is added to the duration of each leg [s]."""

_GOAL_STARTS = 500
"""Positions from which Newton's method looks for the positions of the drives at a goal."""

_NEWTON_STEPS = 12
"""Largest number of steps of Newton's method."""

_NEWTON_TOLERANCE = 1e-7
"""Largest distance of the rope from the point through which it should go [m]."""

# At singular positions, such as a trolley at the mast, the normal equations have no inverse.
_NEWTON_DAMPING = 1e-9
"""Damping of Newton's method, added to the diagonal of its normal equations [m²]."""

_SAME_POSITION_TOLERANCE = 1e-3
"""Largest difference of the drives between two solutions that count as one [rad or m]."""

_Position = tuple[float, ...]
"""Position of the drives of a crane [rad or m]."""

_Points = tuple[_Position, ...]
"""Positions that one motion passes, the first and the last at rest."""

_Path = list[_Points]
"""Motions that follow each other, each by the positions that it passes."""

_PendingLift = tuple[int, _Position]
"""Number of a lift of a crane, counted from 1, and the goal of its load [m]."""

SiteLift = tuple[str, Sequence[float] | np.ndarray]
"""Name of a crane, and the goal of the centre of its load in the frame of the site [m], shape (3,).
"""


class ScheduledLift(NamedTuple):
    """A motion of a lift, or one that makes way, with its time.

    Attributes:
        crane: Index of the crane.
        motion: Its motion.
        begin: Time at which it begins [s].
        lift: Number of the lift of its crane that it ends, from 1; 0 if it ends none.
    """

    crane: int
    motion: Motion
    begin: float
    lift: int = 0

    @property
    def end(self) -> float:
        """Time at which the drives have arrived [s]."""
        return self.begin + self.motion.arrival


@dataclass(frozen=True, eq=False, repr=False)
class SitePlan:
    """Lifts of several cranes with their certificate.

    Attributes:
        site: The site.
        lifts: Their motions, each past those before it; those of one crane in the order of time.
        stay: Time for which a load stays at its goal [s].
        refusals: Which lifts are left out, and why.
    """

    site: CraneSite
    lifts: tuple[ScheduledLift, ...]
    stay: float = 0.0
    refusals: tuple[str, ...] = ()

    def __repr__(self) -> str:
        proven = "proven" if self.holds else "not proven"
        count = sum(bool(motion.lift) for motion in self.lifts)
        return (
            f"Plan of {count} lifts in {self.duration:.1f} s, drives need {self.least:.1f} s; "
            f"cranes {proven} apart"
        )

    @property
    def duration(self) -> float:
        """Time at which all loads have arrived [s]; 0 if all lifts are left out."""
        return max((motion.end for motion in self.lifts if motion.lift), default=0.0)

    @property
    def least(self) -> float:
        """Lower bound of the duration of a plan whose drives end each lift where they do here [s].

        It is the longest time that the drives of one crane need from goal to goal, each from rest
        to rest, including the time for which its loads stay at the goals between.
        """
        times = [0.0]
        for crane, station in enumerate(self.site.stations):
            layout = station.crane.layout
            ends = [m.motion.q[-1] for m in self.lifts if m.crane == crane and m.lift]
            courses = np.diff([station.crane.start.q, *ends], axis=0)[:, layout.drives]

            # A slew may turn either way round: the shorter way is the lower bound.
            slew = layout.drive_of("slew")
            if slew is not None:
                courses[:, slew] = (courses[:, slew] + math.pi) % (2.0 * math.pi) - math.pi

            limits = _drive_limits(station, _swing_of_drives(self.site, crane))
            rates = np.array(limits.rates)
            accelerations = np.array(limits.accelerations)
            needed = rest_to_rest_time(np.abs(courses), rates, accelerations)
            times.append(needed.max(axis=1).sum() + self.stay * (len(ends) - 1))
        return max(times)

    @cached_property
    def distances(self) -> np.ndarray:
        """Proven distance of each pair of cranes in each slice of time [m], shape (slices, pairs).

        The pairs are in the order of `itertools.combinations`. A distance is the largest of the
        `_CERTIFIED_MULTIPLES` of the required one that is proven, or 0 if none is.
        """
        schedule = Schedule(self.site)
        for motion in self.lifts:
            schedule.put(motion.crane, motion.motion, motion.begin, motion.lift)
        count = max(len(boxes) for boxes in schedule.boxes)
        boxes = [_extended(boxes, count) for boxes in schedule.boxes]
        pairs = list(itertools.combinations(range(len(boxes)), 2))
        multiples = np.zeros((count, len(pairs)))
        for column, (a, b) in enumerate(pairs):
            for multiple in _CERTIFIED_MULTIPLES:
                proven = self.site.pair_apart(a, boxes[a], b, boxes[b], multiple)
                multiples[proven, column] = multiple
        return self.site.distance * multiples

    @property
    def t(self) -> np.ndarray:
        """Begin of each slice of time [s], shape (slices,); the last slice has no end."""
        return SLICE * np.arange(-1, len(self.distances) - 1)

    @property
    def holds(self) -> bool:
        """Whether all pairs are proven to keep the required distance in all slices."""
        return bool((self.distances >= self.site.distance).all())

    def operators(self) -> list[SiteOperator]:
        """Return an operator for each crane that follows the plan."""
        operators: list[SiteOperator] = []
        for crane, station in enumerate(self.site.stations):
            motions = [motion for motion in self.lifts if motion.crane == crane]
            operators.append(partial(_follow, station, motions))
        return operators


def _follow(
    station: Station, motions: list[ScheduledLift], t: float, states: Sequence[State]
) -> np.ndarray:
    """Return the rates of the drives that follow the motions of a crane, shape (m,).

    Args:
        station: The crane at its place.
        motions: Its motions, in the order of time.
        t: Time [s].
        states: States of all cranes of the site.
    """
    # A command is held for one cycle, half a cycle on average, and the drives follow it after their
    # delay and their lag.
    lead = station.converters.delay + CYCLE / 2.0 + station.converters.lags

    # With this lead the drives are commanded before a motion begins. The boxes of a motion are
    # reserved from the slice before its begin on, see `_guard_boxes`.
    begun = bisect_right(motions, t + SLICE, key=lambda motion: motion.begin)
    if not begun:
        return np.zeros(len(lead))
    scheduled = motions[begun - 1]
    motion = scheduled.motion
    elapsed = t - scheduled.begin
    deviation = motion(elapsed).position - states[scheduled.crane].q[motion.drives]

    # Each drive has a lead of its own: row k is the setpoint at the time of drive k.
    planned_rates = motion.at(elapsed + lead).velocity.diagonal()
    return planned_rates + _DEVIATION_GAIN * deviation


def plan_site(
    site: CraneSite,
    lifts: Sequence[SiteLift],
    *,
    stay: float = 0.0,
    until: float | None = None,
    strict: bool = True,
) -> SitePlan:
    """Plan lifts of several cranes, one after the other; the crane that is ready first comes first.

    A crane for which no path is free waits for the next motion of another. Where all cranes wait,
    others make way for one of them.

    Args:
        site: The site; its cranes begin where they start.
        lifts: The lifts; those of one crane follow each other in this order. A crane stands still
            before its first and after its last lift, unless it makes way for another.
        stay: Time for which a load stays at its goal [s].
        until: Time from which on no crane that is ready is given another lift [s]; the lifts that
            are left then are no refusals. None for no end.
        strict: Whether a lift for which there is no path raises an error. Otherwise it is left out,
            see `SitePlan.refusals`.

    Raises:
        NoWay: If there is no path for a lift: alone, or past the others; or if it would take longer
            than `cranedyn.lifts.planning.curve.LONGEST_LIFT`.
        OutOfRange: If there is no lift, `stay` is negative, or `until` is not positive.
        UnknownName: If there is no crane of a name.
    """
    number("stay", stay, "s", ">= 0")
    latest_begin = math.inf if until is None else number("until", until, "s", "> 0")
    pending = _lifts_by_crane(site, lifts)
    schedule = Schedule(site, stay)
    refusals: list[str] = []

    while True:
        ready = []
        for crane, remaining in enumerate(pending):
            if remaining and schedule.ready[crane] * SLICE < latest_begin:
                ready.append(crane)
        if not ready:
            break
        # Of cranes that are ready at once the first one of the site comes first: sorting is stable.
        ready.sort(key=lambda crane: schedule.ready[crane])
        crane, refusal = _plan_next_lift(schedule, pending, ready)
        if refusal:
            if strict:
                raise NoWay(refusal)
            refusals.append(refusal)
        del pending[crane][0]
    return SitePlan(site, tuple(schedule.lifts), stay, tuple(refusals))


def _lifts_by_crane(site: CraneSite, lifts: Sequence[SiteLift]) -> list[list[_PendingLift]]:
    """Return the numbered lifts of each crane, in their order.

    Raises:
        OutOfRange: If there is no lift, or a goal is not three finite numbers.
        UnknownName: If there is no crane of a name.
    """
    names = [station.name for station in site.stations]
    pending: list[list[_PendingLift]] = [[] for _ in names]
    for name, goal in lifts:
        if name not in names:
            raise UnknownName("crane", name, names)
        of_crane = pending[names.index(name)]
        point = tuple(finite("goal of a lift", goal, (3,)).tolist())
        of_crane.append((len(of_crane) + 1, point))
    if not any(pending):
        raise OutOfRange("number of lifts", 0, ">= 1")
    return pending


def _plan_next_lift(
    schedule: Schedule, pending: list[list[_PendingLift]], ready: list[int]
) -> tuple[int, str]:
    """Put the next lift of one of the cranes into a schedule, or refuse it.

    Cranes that are ready soon after the first one are tried first. Only if none of them has a path
    do others make way for one of them, since that costs time; cranes that are ready much later
    come last.

    Args:
        schedule: The motions that are planned.
        pending: Lifts of each crane that are not planned yet.
        ready: Cranes with such lifts, in the order in which they are ready.

    Returns:
        The crane whose next lift is done with, and why it is refused; "" if it is planned.
    """
    names = [station.name for station in schedule.site.stations]
    latest = schedule.ready[ready[0]] + _SLICES_BEFORE_MAKING_WAY
    soon = [crane for crane in ready if schedule.ready[crane] <= latest]
    later = ready[len(soon) :]
    trials = [(crane, False) for crane in soon]
    trials += [(crane, True) for crane in soon]
    trials += [(crane, False) for crane in later]

    for crane, cleared in trials:
        lift, goal = pending[crane][0]
        try:
            if schedule.lift(crane, goal, lift, cleared=cleared):
                return crane, ""
        except CraneError as error:
            return crane, f"Lift {lift} of {quoted(names[crane])} alone: {error}"
    crane = ready[0]
    lift, _ = pending[crane][0]
    waits = f"Lift {lift} of {quoted(names[crane])} waits for others, and nothing "
    return crane, waits + "brings them out of its way."


def leaves_room(site: CraneSite, crane: int, position: np.ndarray) -> bool:
    """Return whether each other crane can stand clear of a crane that stands at a position.

    Places to stand are searched as by cranes that make way in a plan: among some random positions,
    with the other cranes at their starts. False is no proof that there is none.

    Args:
        site: The site.
        crane: Index of the crane.
        position: Position of its drives [rad or m], shape (m,).
    """
    return Schedule(site).others_can_stand_clear(crane, _standing(site.stations[crane], position))


# The cache keeps no exceptions. A motion that is refused is an answer, too, so errors are returned.
@lru_cache(maxsize=512)
def _motion(site: CraneSite, crane: int, points: _Points, mass: float) -> Motion | CraneError:
    """Return the motion of a crane through points, or the error that says why there is none.

    The motion keeps the load above ground, all parts away from obstacles, the drives in their
    ranges and the load in its chart. Other cranes are not looked at.

    Args:
        site: The site.
        crane: Index of the crane.
        points: Positions of its drives that the motion passes.
        mass: Mass that is compared with the chart [kg].
    """
    station = site.stations[crane]
    swing = _swing_of_drives(site, crane)
    try:
        motion = _smooth_motion(station, swing, site.working_wind, np.array(points))
        load = station.plumb(motion.q[:, motion.drives])[1]
        _check_height(site, crane, load)
        _check_chart(station, load, mass)
        if site.solids:
            _check_obstacles(site, crane, _guard_boxes(station, swing, motion))
    except CraneError as error:
        return error
    return motion


def _check_height(site: CraneSite, crane: int, load: np.ndarray) -> None:
    """Raise `NoWay` if a load at points, shape (rows, 3), is too near to the ground."""
    low = _height(site, crane, load)
    if low < site.distance:
        raise NoWay(f"its load is {low:.2f} m above ground; required is {site.distance:g} m.")


def _check_chart(station: Station, load: np.ndarray, mass: float) -> None:
    """Raise `OutOfRange` if the crane may not carry a mass [kg] at all points, shape (rows, 3)."""
    if station.chart is None:
        return
    radii = np.linalg.norm((load - station.foot)[:, :2], axis=1)
    boom = boom_length(station.crane, station.crane.start.q)
    rated = float(station.chart.on(boom=boom).at(radii).min())
    within(f"load of {quoted(station.name)}", mass, 0.0, rated, "kg")


def _check_obstacles(site: CraneSite, crane: int, boxes: np.ndarray) -> None:
    """Raise `NoWay` unless a crane is proven clear of obstacles in all boxes, shape (k, 2, m)."""
    for box in boxes:
        ends = site.positions(crane, box)
        if not site.obstacles.proven_clear(site.bodies, crane, ends, site.distance, site.swing):
            raise NoWay("each way that was tried is too near to an obstacle.")


def _boxes_along(site: CraneSite, crane: int, path: _Path, mass: float) -> list[np.ndarray]:
    """Return the boxes of each motion of a crane along a path with a mass on its hook [kg], shape
    (slices, 2, m) each; an empty list if one of the motions is refused.
    """
    boxes = []
    for points in path:
        motion = _motion(site, crane, points, mass)
        if isinstance(motion, Motion):
            swing = _swing_of_drives(site, crane)
            boxes.append(_guard_boxes(site.stations[crane], swing, motion))
    return boxes if len(boxes) == len(path) else []


def _height(site: CraneSite, crane: int, load: np.ndarray) -> float:
    """Return the least height above ground [m] of the lower end of a load whose centre is at
    points [m], shape (rows, 3).
    """
    # The load is the last capsule; its depth below the end of the cable is the second end's last.
    below_cable = site.stations[crane].bodies.depth[-1, 1, 2]
    return float(load[:, 2].min()) - below_cable - site.ground


def _swing_of_drives(site: CraneSite, crane: int) -> float:
    """Return the swing that the wind of a site leaves to the drives of a crane [rad]."""
    return working_swing(site.stations[crane], site.swing, site.working_wind)


def _drive_limits(station: Station, swing: float) -> Limits:
    """Return the limits of the drives of a crane in a plan.

    The rates leave a reserve for corrections by the operator. The accelerations are those that the
    guard plans with, so that it need not intervene.
    """
    accelerations = gentle(station, swing).decelerations.tolist()
    return Limits((station.converters.rates / RESERVE).tolist(), accelerations)


class GoalOutOfReach(OutOfRange):
    """A goal at which the load of a crane cannot hang with its drives in their ranges.

    Attributes:
        aside: Distance in plan view by which the load would hang beside the goal at least [m].
        rope: Length by which the rope is too long or too short where the load hangs nearest to the
            goal [m].
    """

    def __init__(self, station: Station, goal: _Position, tried: np.ndarray) -> None:
        """Find what is missing.

        Args:
            station: The crane.
            goal: Goal of the centre of the load [m].
            tried: Coordinates from which the search for a position has ended, drives outside of
                their ranges among them, shape (k, n).
        """
        super().__init__(
            f"goal of the load of {quoted(station.name)}",
            np.round(goal, 3).tolist(),
            f"a place where its load hangs with its drives in their ranges: {_ranges_of(station)}",
            "m",
        )
        low, high = station.ranges
        winch = station.crane.winch
        # Each drive goes as far as its range lets it.
        positions = np.clip(tried[:, station.crane.layout.drives], low, high)
        _, load = station.plumb(positions)
        aside = np.linalg.norm(load[:, :2] - np.asarray(goal)[:2], axis=1)
        row = int(aside.argmin())
        needed = float(load[row, 2] + positions[row, winch] - goal[2])
        self.aside = float(aside[row])
        self.rope = max(float(low[winch]) - needed, needed - float(high[winch]), 0.0)

    @property
    def words(self) -> str:
        """What is missing, in words."""
        parts = []
        if self.aside > _SAME_POSITION_TOLERANCE:
            parts.append(f"its load would hang {self.aside:.1f} m beside it")
        if self.rope > _SAME_POSITION_TOLERANCE:
            parts.append(f"its rope differs by {self.rope:.1f} m from what it would need")
        return " and ".join(parts) or "no position of its drives was found"


def missing_reach(station: Station, goal: _Position) -> float:
    """Return by how much the reach of a crane is too short for a goal of its load in plan view [m],
    0 where it reaches it.
    """
    try:
        _positions_at_goal(station, tuple(station.ranges.mean(axis=0).tolist()), goal)
    except GoalOutOfReach as error:
        return max(error.aside, error.rope)
    return 0.0


@lru_cache(maxsize=64)
def _positions_at_goal(station: Station, begin: _Position, goal: _Position) -> list[_Position]:
    """Return the positions of the drives, at most two, at which the load hangs plumb at a goal.

    They are found by Newton's method from random positions in all of the ranges. The first is the
    one that the drives reach in the shortest time from where they begin, the second the nearest
    that differs from it, such as with the slew the other way round.

    Args:
        station: The crane at its place.
        begin: Position where the drives begin [rad or m].
        goal: Goal of the centre of the load [m].

    Raises:
        GoalOutOfReach: If no position in the ranges of the drives is found.
    """
    crane = station.crane
    rng = np.random.default_rng(0)
    starts = rng.uniform(crane.lower, crane.upper, (_GOAL_STARTS, crane.layout.n))
    q, miss = _hang_through(station, starts, np.array(goal), np.zeros((1, 2)))
    inside = (np.clip(q, crane.lower, crane.upper) == q).all(axis=1)
    reached = q[inside & (miss < _NEWTON_TOLERANCE)][:, crane.layout.drives]
    if not len(reached):
        raise GoalOutOfReach(station, goal, q)
    times = (np.abs(reached - begin) / station.converters.rates).max(axis=1)
    reached = reached[times.argsort()]
    differs = np.abs(reached - reached[0]).max(axis=1) > _SAME_POSITION_TOLERANCE
    nearest = [reached[0], *reached[differs][:1]]
    return [tuple(position.tolist()) for position in nearest]


def _ranges_of(station: Station) -> str:
    """Return the ranges of the drives of a crane in words."""
    crane = station.crane
    ranges = []
    for drive in crane.layout.drives.tolist():
        low = float(crane.lower[drive])
        high = float(crane.upper[drive])
        symbol = crane.layout.symbols[drive]
        ranges.append(f"{symbol} from {low:.4g} to {high:.4g} {crane.layout.units[drive]}")
    return ", ".join(ranges)


def _smooth_motion(station: Station, swing: float, wind: WorkingWind, points: np.ndarray) -> Motion:
    """Return the motion through positions of the drives, at rest at both ends, without a swing
    left.

    The motion is planned for the load, and the drives follow from it, as in
    `cranedyn.references.flat`. The load moves as if it hung plumb from drives that go along
    straight lines from point to point, see `_averaged_positions`. From its acceleration a follows
    where the rope points, and so where the drives must be, see `_drives_that_lead`.

    A motion that exceeds its limits is planned again with lower rates and accelerations.

    Args:
        station: The crane at its place.
        swing: Largest inclination of the rope that the drives may cause [rad].
        wind: Wind up to which the crane works.
        points: Positions of the drives, shape (k, m).

    Raises:
        NoWay: If a drive would leave its range, or the motion exceeds its limits after
            `_MAX_SLOWDOWNS` attempts.
        OutOfRange: If it would take longer than `cranedyn.lifts.planning.curve.LONGEST_LIFT`.
    """
    crane = station.crane
    limits = _drive_limits(station, swing)
    share = 1.0
    used = math.inf
    for _ in range(_MAX_SLOWDOWNS):
        position = _averaged_positions(station, limits, share, points)
        t = _ROW_PERIOD * np.arange(len(position))
        plumb, load = station.plumb(position)
        load_curve = make_interp_spline(t, load, k=5)
        lean = _lean(load_curve, t, crane.gravity)
        motion = _drives_that_lead(station, t, plumb, load, lean)

        by_gust = _lean_by_gust(station, wind, load_curve, t)
        largest_lean = float((np.linalg.norm(lean, axis=1) + by_gust).max())
        used = max(largest_lean / swing, *use(crane, motion, limits).values())
        if used <= 1.0:
            drives = crane.layout.drives
            inside = np.clip(motion.q, crane.lower, crane.upper) == motion.q
            if not inside[:, drives].all():
                raise NoWay("a drive would leave its range.")
            return motion
        share *= _SLOWDOWN_MARGIN / used
    raise NoWay(f"no motion of its drives keeps their limits; one uses {used:.2f} of them.")


def _averaged_positions(
    station: Station, limits: Limits, share: float, points: np.ndarray
) -> np.ndarray:
    """Return positions of drives along straight lines, smoothed by moving averages, in rows
    `_ROW_PERIOD` apart, shape (rows, m).

    All drives go along a line at constant rates and arrive at once. These positions are averaged
    four times: over the time that the drives need to change their rates, and over three durations
    in proportion to √(l/g), the time scale of the swing, see `_SWING_AVERAGING_TIMES`. So the
    drives pass points between the ends without a stop, and near them.

    Four averages are needed because the pivot of a load that does not swing is at p + (l/g) p'',
    with p the position of the load: the acceleration of the drives contains the fourth derivative
    of p. The straight lines have a bounded first derivative, and each average makes one more
    derivative bounded: the fourth is continuous.

    Args:
        station: The crane at its place.
        limits: Limits of its drives.
        share: Share of the limits that may be used.
        points: Positions of the drives, shape (k, m).

    Raises:
        OutOfRange: If it would take longer than `cranedyn.lifts.planning.curve.LONGEST_LIFT`.
    """
    rates = share * np.array(limits.rates)
    accelerations = share * np.array(limits.accelerations)
    courses = np.diff(points, axis=0)
    lengths = np.abs(courses)

    # A line of length L at the rate L/T, averaged over the time (L/T)/a to change the rate, has
    # the acceleration a. For T >= √(L/a) that time is no longer than the line itself.
    leg_times = np.maximum(lengths / rates, np.sqrt(lengths / accelerations))
    times = leg_times.max(axis=1) + _MIN_LEG_TIME
    refuse_endless(float(times.sum()), limits)
    knots = np.append(0.0, np.cumsum(times))

    rate_changes = np.diff(courses / times[:, None], axis=0, prepend=0.0, append=0.0)
    ramp_time = np.max(np.abs(rate_changes) / accelerations)
    longest_cable = points[:, station.crane.winch].max()
    swing_times = _SWING_AVERAGING_TIMES * math.sqrt(longest_cable / station.crane.gravity)
    averaging_times = np.append(ramp_time, swing_times)

    # An odd number of rows is centred about a row.
    counts = 2 * np.ceil(averaging_times / (2.0 * _ROW_PERIOD)).astype(int) + 1

    # The averages spread the motion by half of their rows to both sides.
    rows_before = counts.sum() // 2 + _ROWS_AT_REST
    t = _ROW_PERIOD * np.arange(2 * rows_before + math.ceil(knots[-1] / _ROW_PERIOD))
    columns = [np.interp(t - rows_before * _ROW_PERIOD, knots, drive) for drive in points.T]
    position = np.column_stack(columns)
    for count in counts:
        position = uniform_filter1d(position, count, axis=0, mode="nearest")
    return position


def _lean(load_curve: BSpline, t: np.ndarray, gravity: float) -> np.ndarray:
    """Return the slope of the rope that accelerates a load along a curve: its horizontal extent
    over its vertical one, from the load to the pivot, shape (rows, 2).

    The rope pulls the load with the force m (a + g e_z), so it points along a + g e_z.
    """
    load_acceleration = load_curve.derivative(2)(t)
    return load_acceleration[:, :2] / (load_acceleration[:, 2:] + gravity)


def _lean_by_gust(
    station: Station, wind: WorkingWind, load_curve: BSpline, t: np.ndarray
) -> np.ndarray:
    """Return by how much more a gust swings a load that travels than one at rest [rad], (rows,).

    A gust that blows against the load meets it at the speed w + v instead of w, and drag goes with
    the square of the speed, see `WorkingWind`. What the gust does to a load at rest is not in the
    swing that the drives may use, so only the difference (w + v)² - w² counts here.
    """
    speed = np.linalg.norm(load_curve.derivative()(t), axis=1)
    against = (wind.gust + speed) ** 2 - wind.gust**2
    return GUST_RESPONSE * wind.drag_ratio(station.crane) * against


def _drives_that_lead(
    station: Station, t: np.ndarray, plumb: np.ndarray, load: np.ndarray, lean: np.ndarray
) -> Motion:
    """Return the motion in which the rope goes through the load at its lean in each row. It is one
    of the drives: the swing in it is that of a load that hangs plumb.

    Args:
        station: The crane at its place.
        t: Times [s], shape (rows,).
        plumb: Coordinates at which the load would hang plumb there, shape (rows, n).
        load: Points of the load [m], shape (rows, 3).
        lean: Slopes of the rope, see `_lean`, shape (rows, 2).
    """
    coordinates, _ = _hang_through(station, plumb, load, lean)
    curve = make_interp_spline(t, coordinates, k=5)
    q = curve.derivative(0)(t)
    v = curve.derivative(1)(t)
    a = curve.derivative(2)(t)
    return Motion(_ROW_PERIOD, q, v, a, station.crane.layout.drives)


def _hang_through(
    station: Station, q: np.ndarray, load: np.ndarray, lean: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return coordinates at which the rope goes through points of the load at given leans.

    With d the vector from the load to the pivot and s the lean, the rope is right where
    d_xy - d_z s = 0: two equations for the drives of the chain, solved by Newton's method. Where
    more than two drives move the pivot, a step is the shortest one. The winch follows: its
    position is the length of d, or its negative, which no winch has, where the load would be above
    the pivot.

    Args:
        station: The crane at its place.
        q: Coordinates from which the search begins, shape (rows, n).
        load: Points of the load [m], shape (rows, 3) or (3,).
        lean: Horizontal extent of the rope over its vertical one, shape (rows, 2) or (1, 2).

    Returns:
        The coordinates, shape (rows, n), and by how much the rope missed the points before the last
        step [m], shape (rows,).
    """
    q = q.copy()
    drives = station.crane.layout.drives
    lower, upper = station.ranges

    # Near singular positions a step can be of any size, and the next would overflow.
    farthest_beyond = upper - lower
    for _ in range(_NEWTON_STEPS):
        rope = station.rope(q)
        to_pivot = rope.pivot - load
        miss = to_pivot[:, None, :2] - to_pivot[:, None, 2:] * lean[:, None]
        jacobian = rope.motion[..., :2] - rope.motion[..., 2:] * lean[:, None]
        square = jacobian.mT @ jacobian + _NEWTON_DAMPING * np.eye(2)
        step = (jacobian @ np.linalg.solve(square, miss.mT))[..., 0]
        q[:, drives] = np.clip(
            q[:, drives] - step, lower - farthest_beyond, upper + farthest_beyond
        )
        if np.abs(miss).max() < _NEWTON_TOLERANCE:
            break
    length = np.linalg.norm(to_pivot, axis=1)
    q[:, drives[station.crane.winch]] = np.copysign(length, to_pivot[:, 2])
    return q, np.linalg.norm(miss[:, 0], axis=1)


class _PlacedPath(NamedTuple):
    """A path with its time.

    Attributes:
        legs: Each motion, and the slice in which it begins.
        arrival: Slice in which the crane has arrived.
        end: Position where it arrives.
        conflicts: What its motions wait for.
    """

    legs: list[tuple[Motion, int]]
    arrival: int
    end: _Position
    conflicts: list[Conflict]


class _Begin(NamedTuple):
    """When a motion can begin.

    Attributes:
        slice: Earliest slice; None if there is none.
        conflicts: What it waits for; the last one is for ever where there is no slice.
    """

    slice: int | None
    conflicts: list[Conflict]


class ScheduleState(NamedTuple):
    """Copy of what changes in a schedule, see `Schedule`."""

    lifts: list[ScheduledLift]
    boxes: list[np.ndarray]
    positions: list[_Position]
    ready: list[int]
    masses: list[float]


class Schedule:
    """Motions of all cranes with their times, and the boxes that the cranes have in them.

    Slice k of a crane begins at (k - 1) `SLICE`: the boxes of a motion that begins at time 0 begin
    one slice before it.

    Attributes:
        site: The site.
        stay: Time for which a load stays at its goal [s].
        arched: Whether loads may also travel along arches.
        lifts: All motions that are planned.
        boxes: Box of each crane in each slice, shape (slices, 2, m) each. The last is for ever.
        positions: Where the drives of each crane stand after their last motion.
        ready: Number of slices after time 0 from which on each crane can begin its next motion.
        masses: Mass on the hook of each crane in its next motion [kg], which is compared with its
            chart; at first that of the load of the crane.
        conflict: What the latest motion that was looked for waits for longest, or cannot pass at
            all; None if it waits for nothing.
    """

    def __init__(self, site: CraneSite, stay: float = 0.0, *, arched: bool = False) -> None:
        """Start with all cranes at rest at their starts.

        Args:
            site: The site.
            stay: Time for which a load stays at its goal [s].
            arched: Whether loads may also travel along arches, raised and lowered on the way.
        """
        starts = [x.crane.start.q[x.crane.layout.drives] for x in site.stations]
        self.site = site
        self.stay = stay
        self.arched = arched
        self.lifts: list[ScheduledLift] = []
        self.boxes: list[np.ndarray] = []
        for station, start in zip(site.stations, starts, strict=True):
            self.boxes.append(_standing(station, start))
        self.positions: list[_Position] = [tuple(start.tolist()) for start in starts]
        self.ready = [0] * len(starts)
        self.masses = [station.crane.payload_mass for station in site.stations]
        self.conflict: Conflict | None = None

    def saved(self) -> ScheduleState:
        """Return a copy of all that changes. Boxes are replaced, never written into."""
        return ScheduleState(
            lifts=list(self.lifts),
            boxes=list(self.boxes),
            positions=list(self.positions),
            ready=list(self.ready),
            masses=list(self.masses),
        )

    def restore(self, saved: ScheduleState) -> None:
        """Go back to a copy of what changes, see `saved`."""
        self.lifts = saved.lifts
        self.boxes = saved.boxes
        self.positions = saved.positions
        self.ready = saved.ready
        self.masses = saved.masses

    def _others(self, crane: int) -> list[int]:
        """Return the indices of all cranes but one."""
        return [other for other in range(len(self.boxes)) if other != crane]

    def lift(
        self, crane: int, goal: _Position, lift: int, *, cleared: bool, earliest: float = 0.0
    ) -> bool:
        """Put in the next lift of a crane; return whether there is a path for it.

        Args:
            crane: Index of the crane.
            goal: Goal of its load [m].
            lift: Number of the lift.
            cleared: Whether other cranes make way for it. Otherwise they stay as they are planned.
            earliest: Time before which the load does not arrive at the goal [s].

        Raises:
            CraneError: If there is no path, whatever others do.
        """
        station = self.site.stations[crane]
        ends = []
        for end in _positions_at_goal(station, self.positions[crane], goal):
            if self.others_can_stand_clear(crane, _standing(station, end)):
                ends.append(end)
        if not ends:
            raise NoWay(self._who_is_in_the_way(crane, goal))
        if cleared:
            return self._move_past_cleared_cranes(crane, ends, lift, earliest)
        return self._move(crane, ends, lift, earliest)

    def _who_is_in_the_way(self, crane: int, goal: _Position) -> str:
        """Return in words which crane finds no place to stand while a crane is at a goal of its
        load, and which bodies would come too near to each other where that crane stands now.
        """
        station = self.site.stations[crane]
        words = "wherever it may stand, another crane is in the way of its goal"
        for end in _positions_at_goal(station, self.positions[crane], goal):
            box = _standing(station, end)
            for other in self._others(crane):
                if next(self._refuges(other, {crane: box}), None) is None:
                    theirs = _standing(self.site.stations[other], self.positions[other])
                    conflict = Conflict(crane, box[0], other, theirs[0], math.inf)
                    return f"{words}, and no place was found to which that could go: " + (
                        f"{conflict.words(self.site)}."
                    )
        return f"{words}."

    def _move_past_cleared_cranes(
        self, crane: int, ends: list[_Position], lift: int, earliest: float
    ) -> bool:
        """Put in the motions of a lift, each after all others have made way for it; return whether
        a path was found. The load does not arrive before the earliest time [s].

        Raises:
            CraneError: If there is no path, whatever others do.
        """
        passable = []
        mass = self.masses[crane]
        for path in self._paths(crane, ends):
            boxes = _boxes_along(self.site, crane, path, mass)
            if boxes and all(self.others_can_stand_clear(crane, of_leg) for of_leg in boxes):
                passable.append((path, boxes))
        if not passable:
            raise NoWay("each way that was tried passes another crane wherever that may stand.")
        for path, boxes in passable:
            # A path may fail at its second motion, after cranes have moved for the first.
            saved = self.saved()
            if self._clear_and_move(crane, path, boxes, lift, earliest):
                return True
            self.restore(saved)
        return False

    def _clear_and_move(
        self, crane: int, path: _Path, boxes: list[np.ndarray], lift: int, earliest: float
    ) -> bool:
        """Put in each motion of a path after others have made way for it; return whether all
        succeed. The last one does not arrive before the earliest time [s].
        """
        for leg, (points, of_leg) in enumerate(zip(path, boxes, strict=True), start=1):
            if not all(self._make_way(other, crane, of_leg) for other in self._others(crane)):
                return False
            is_last = leg == len(path)
            ended = lift if is_last else 0
            if not self._move(crane, [points[-1]], ended, earliest if is_last else 0.0):
                return False
        return True

    def _paths(self, crane: int, ends: list[_Position]) -> list[_Path]:
        """Return the paths on which a crane may get to one of some ends."""
        begin = self.positions[crane]
        paths = _candidate_paths(self.site, crane, begin, ends, self.masses[crane])
        if self.arched:
            station = self.site.stations[crane]
            for end in ends:
                paths += _arches(station, begin, end)
        return paths

    def others_can_stand_clear(self, crane: int, boxes: np.ndarray) -> bool:
        """Return whether each other crane has a position clear of boxes of a crane, shape (k, 2,
        m), as far as it is found.
        """
        for other in self._others(crane):
            if next(self._refuges(other, {crane: boxes}), None) is None:
                return False
        return True

    def _make_way(self, crane: int, passing: int, boxes: np.ndarray) -> bool:
        """Bring a crane to where it stands clear of the boxes of another that passes, shape (k, 2,
        m), and of all others where they stand last; return whether that succeeds.
        """
        to_avoid = {other: self.boxes[other][-1:] for other in self._others(crane)}
        to_avoid[passing] = boxes
        for refuge in itertools.islice(self._refuges(crane, to_avoid), _REFUGES_TRIED):
            if refuge == self.positions[crane]:
                return True
            # A refuge to which no motion leads is no reason to give up: the next may serve.
            with suppress(CraneError):
                if self._move(crane, [refuge], 0):
                    return True
        return False

    def _refuges(self, crane: int, to_avoid: dict[int, np.ndarray]) -> Iterator[_Position]:
        """Yield positions where a crane stands clear of boxes of others.

        First comes where it stands, then random positions with the load raised, in ascending order
        of the time in which the drives get there. In every other one the slew alone differs, or the
        first drive of a crane without one, as turning or travelling away is the simplest way to
        clear a path; no slew turns more than once around. On a runway no position lies beyond
        another crane, see `_keeps_order`.

        Args:
            crane: Index of the crane.
            to_avoid: Boxes of other cranes, shape (k, 2, m) each.
        """
        station = self.site.stations[crane]
        begin = self.positions[crane]
        winch = station.crane.winch
        low, high = _once_around(station, begin)
        rng = np.random.default_rng(0)
        candidates = rng.uniform(low, high, (_REFUGE_COUNT, len(low)))
        candidates[::2] = np.where(_turns_away(station), candidates[::2], begin)
        candidates[0] = begin
        candidates[:, winch] = low[winch] + _RAISED_CABLE
        times = (np.abs(candidates - begin) / station.converters.rates).max(axis=1)
        ordered = np.array([begin, *candidates[times.argsort()]])
        for other, boxes in to_avoid.items():
            ordered = ordered[self._keeps_order(crane, ordered, other, boxes)]

        # Boxes of successive slices are nearly alike: in random order one of the first few tells
        # most candidates that fail.
        obstructing = []
        for other, boxes in to_avoid.items():
            for box in rng.permutation(boxes):
                obstructing.append((other, box))

        stands = [ordered[:1], ordered[1:_NEAREST_REFUGES], ordered[_NEAREST_REFUGES:]]
        groups = [group for group in stands if len(group)]
        for group in groups:
            clear = group
            for other, box in obstructing:
                boxes = _standing(station, clear)
                clear = clear[self.site.pair_apart(crane, boxes, other, box)]
                if not len(clear):
                    break
            for position in clear.tolist():
                yield tuple(position)

    def _keeps_order(
        self, crane: int, positions: np.ndarray, other: int, boxes: np.ndarray
    ) -> np.ndarray:
        """Return whether positions of a crane, shape (rows, m), lie on the same side of boxes of
        another, shape (k, 2, m), as the crane stands of that one after its last motion: True for
        all unless both travel on one runway, where no bridge gets past another; shape (rows,).
        """
        if not self.site.share_runway(crane, other):
            return np.ones(len(positions), dtype=bool)

        # Both have their first drive along the same rails, from the same origin.
        mine = self.site.stations[crane].bodies.columns[0]
        theirs = self.site.stations[other].bodies.columns[0]
        if self.positions[crane][mine] < self.positions[other][theirs]:
            return positions[:, mine] < boxes[:, 0, theirs].min()
        return positions[:, mine] > boxes[:, 1, theirs].max()

    def _move(self, crane: int, ends: list[_Position], lift: int, earliest: float = 0.0) -> bool:
        """Put in the motions by which a crane arrives first at one of some ends, and where nothing
        comes near it later; return whether there are any.

        Args:
            crane: Index of the crane.
            ends: Positions of its drives.
            lift: Number of the lift that the last motion ends; 0 for none.
            earliest: Time before which the last motion does not arrive [s].

        Raises:
            CraneError: If all paths are refused whatever others do; the error of the first one.
        """
        paths = self._paths(crane, ends)
        refusals: list[CraneError] = []
        conflicts: list[Conflict] = []
        first_there: _PlacedPath | None = None
        for path in paths:
            latest = math.inf if first_there is None else first_there.arrival
            placed = self._place(crane, path, latest, earliest)
            if isinstance(placed, CraneError):
                refusals.append(placed)
            elif isinstance(placed, Conflict):
                conflicts.append(placed)
            elif placed is not None:
                first_there = placed
        if len(refusals) == len(paths):
            raise refusals[0]
        if first_there is None:
            self.conflict = longest(conflicts)
            return False
        self.conflict = longest(first_there.conflicts)
        self.positions[crane] = first_there.end
        for leg, (motion, begin) in enumerate(first_there.legs, start=1):
            ended = lift if leg == len(first_there.legs) else 0
            self.put(crane, motion, begin * SLICE, ended)
        return True

    def _place(
        self, crane: int, path: _Path, latest: float, earliest: float
    ) -> _PlacedPath | CraneError | Conflict | None:
        """Return a path with the earliest times at which it passes all others.

        Args:
            crane: Index of the crane.
            path: The path.
            latest: Slice before which it must arrive.
            earliest: Time before which its last motion does not arrive [s].

        Returns:
            The path; the error of the first motion that is refused; what stands in the way of a
            motion for ever; or None if the crane does not arrive before the latest slice.
        """
        station = self.site.stations[crane]
        swing = _swing_of_drives(self.site, crane)
        least_times = []
        for points in path:
            travel = np.abs(np.diff(points, axis=0)) / station.converters.rates
            least_times.append(travel.max(axis=1).sum())
        legs: list[tuple[Motion, int]] = []
        conflicts: list[Conflict] = []
        after = self.ready[crane]
        for leg, points in enumerate(path):
            # Motions are costly to compute: at full rate this path would already be too late.
            if after + sum(least_times[leg:]) // SLICE >= latest:
                return None
            motion = _motion(self.site, crane, points, self.masses[crane])
            if isinstance(motion, CraneError):
                return motion
            boxes = _guard_boxes(station, swing, motion)
            if leg == len(path) - 1:
                # The slice from which on the motion arrives at the earliest time.
                after = max(after, math.ceil((earliest - motion.arrival) / SLICE))
            begin, waits_for = self._earliest_begin(crane, boxes, after)
            if begin is None:
                return waits_for[-1]
            conflicts += waits_for
            after = begin + len(boxes) - 1
            if after >= latest:
                return None
            legs.append((motion, begin))
        return _PlacedPath(legs, after, path[-1][-1], conflicts)

    def _earliest_begin(self, crane: int, boxes: np.ndarray, first: int) -> _Begin:
        """Return the earliest slice from which on the boxes of a motion are proven apart from all
        other cranes, and what it waits for.

        Args:
            crane: Index of the crane that moves.
            boxes: Its boxes, shape (slices, 2, m); it stays in the last for ever.
            first: First slice that is tried.
        """
        last = len(boxes) - 1
        begin = first
        other = 0
        conflicts: list[Conflict] = []
        while other < len(self.boxes):
            if other == crane:
                other += 1
                continue
            # Boxes of the other crane from the slice on in which the motion would begin; the last
            # is for ever.
            of_other = self.boxes[other]
            theirs = of_other[min(begin, len(of_other) - 1) :]
            meeting = _first_near(self.site, crane, boxes, other, theirs)
            if meeting is None:
                other += 1
                continue

            # So many slices after its begin the motion meets the other crane. It begins later, by
            # as many slices as pass until the other one is clear of the box that is met.
            box = boxes[min(meeting, last)]
            wait = None
            for k, their_box in enumerate(of_other[begin + meeting :]):
                if self.site.pair_apart(crane, box, other, their_box):
                    wait = k
                    break
            met = of_other[min(begin + meeting, len(of_other) - 1)]
            if wait is None:
                # The other crane stands there for ever.
                return _Begin(None, [*conflicts, Conflict(crane, box, other, met, math.inf)])
            # Where the crane had arrived before they meet, it is its last box that is met: it must
            # not arrive before the other one is gone, either.
            delay = max(meeting - last, 0) + wait
            conflicts.append(Conflict(crane, box, other, met, SLICE * delay))
            begin += delay

            # A later begin may meet the cranes that were looked at before.
            other = 0
        return _Begin(begin, conflicts)

    def put(self, crane: int, motion: Motion, begin: float, lift: int = 0) -> None:
        """Give a motion a time.

        Args:
            crane: Index of the crane.
            motion: Its motion.
            begin: Time at which it begins [s].
            lift: Number of the lift that it ends; 0 for none.

        Raises:
            OutOfRange: If the time is no multiple of `SLICE`, or the last motion of the crane is
                not done by then.
        """
        before = self.boxes[crane]
        swing = _swing_of_drives(self.site, crane)
        boxes = _guard_boxes(self.site.stations[crane], swing, motion)
        earliest = (len(before) - 1) * SLICE
        within("begin of a lift after another", begin, earliest, math.inf, "s")
        first = round(begin / SLICE)
        if first * SLICE != begin:
            raise OutOfRange("begin of a lift", begin, f"multiples of {SLICE:g}", "s")
        self.boxes[crane] = np.concatenate([_extended(before, first)[:first], boxes])
        scheduled = ScheduledLift(crane, motion, begin, lift)
        self.lifts.append(scheduled)

        # The load stays where a lift ends, but not where the crane has only made way.
        stays_until = math.ceil((scheduled.end + self.stay) / SLICE) if lift else 0
        self.ready[crane] = max(len(self.boxes[crane]) - 1, stays_until)


def _candidate_paths(
    site: CraneSite, crane: int, begin: _Position, ends: list[_Position], mass: float
) -> list[_Path]:
    """Return paths on which a crane may get to one of some ends with a mass on its hook [kg].

    To each end they go directly, and with the load raised before and lowered after, in one motion
    without a stop or in several with stops. Where no such path is clear of obstacles, paths around
    these are searched and added, since a search takes much longer.
    """
    station = site.stations[crane]
    paths: list[_Path] = []
    for end in ends:
        points: _Points = begin, _raised(station, begin), _raised(station, end), end
        with_stops: _Path = list(itertools.pairwise(dict.fromkeys(points)))
        paths.append([(begin, end)])
        paths.append([points])
        # Without any stop where all points are equal: the crane stands at its goal.
        if with_stops:
            paths.append(with_stops)
    if site.solids and not any(_boxes_along(site, crane, path, mass) for path in paths):
        for end in ends:
            around = _around_obstacles(site, crane, begin, end)
            if around:
                paths.append([around])
                around_with_stops: _Path = list(itertools.pairwise(around))
                paths.append(around_with_stops)
    return paths


def _arches(station: Station, begin: _Position, end: _Position) -> list[_Path]:
    """Return paths between two positions on which the load is raised over the first half of the
    way and lowered over the second, while all other drives go on.
    """
    winch = station.crane.winch
    ends = np.array([begin, end])
    shorter = float(ends[:, winch].min())
    paths: list[_Path] = []
    for rise in _ARCH_RISES:
        middle = ends.mean(axis=0)
        middle[winch] = shorter
        raised = np.array(_raised(station, tuple(middle.tolist())))
        middle[winch] = shorter + rise * (float(raised[winch]) - shorter)
        paths.append([(begin, tuple(middle.tolist()), end)])
    return paths


class _SearchNode(NamedTuple):
    """Node of the search around obstacles; the queue compares nodes field by field.

    Attributes:
        estimate: Lower bound of the time of a path through this node [s].
        cost: Time from the begin to this node [s].
        position: Position of the drives.
        drive: Index of the drive that moved last; -1 at the begin.
        path: Positions from the begin up to the node before this one.
    """

    estimate: float
    cost: float
    position: _Position
    drive: int
    path: _Points


@lru_cache(maxsize=64)
def _around_obstacles(site: CraneSite, crane: int, begin: _Position, end: _Position) -> _Points:
    """Return the points of the quickest path around obstacles that is found, by A* over a grid.

    One drive moves at a time, along edges of the grid that are proven clear. Then points are left
    out between which all positions are clear, so that drives move together. No point is returned if
    no path is found.
    """
    station = site.stations[crane]
    limits = _drive_limits(station, _swing_of_drives(site, crane))
    rates = np.array(limits.rates)
    accelerations = np.array(limits.accelerations)
    low, high = _once_around(station, begin, end)
    grid: list[list[float]] = []
    for k, rate in enumerate(rates):
        values = np.arange(low[k], high[k], _GRID_TIME * rate)
        grid.append(np.unique([*values, begin[k], end[k]]).tolist())

    @cache
    def is_clear(a: _Position, b: _Position) -> bool:
        """Return whether all positions between two, and a margin around them, are clear."""
        margin = _EDGE_MARGIN_TIME * rates
        box = np.sort([a, b], axis=0) + np.array([-margin, margin])
        ends = site.positions(crane, box)
        required = site.distance
        if not site.obstacles.proven_clear(site.bodies, crane, ends, required, site.swing):
            return False
        return _height(site, crane, station.plumb(np.array([a, b]))[1]) >= required

    if not is_clear(end, end):
        return ()
    reached: set[tuple[_Position, int]] = set()
    queue = [_SearchNode(0.0, 0.0, begin, -1, (begin,))]
    while queue and len(reached) < _MAX_NODES:
        node = heappop(queue)
        position = node.position
        # Which drive moved last is part of the state, as it decides what the next move costs.
        # Edges are examined only here: most nodes of the queue are never taken from it.
        if (position, node.drive) in reached or not is_clear(node.path[-1], position):
            continue
        reached.add((position, node.drive))
        path = (*node.path, position)
        if position == end:
            return _shortened(path, is_clear)
        for drive, neighbour in _neighbours(grid, position):
            # A drive that did not move before must get up to its rate.
            start = rates[drive] / accelerations[drive] if drive != node.drive else 0.0
            travel = abs(neighbour[drive] - position[drive]) / rates[drive]
            cost = node.cost + travel + start
            # One drive moves at a time, so that the times of all drives add up.
            estimate = cost + (abs(np.subtract(neighbour, end)) / rates).sum()
            heappush(queue, _SearchNode(estimate, cost, neighbour, drive, path))
    return ()


def _neighbours(grid: list[list[float]], position: _Position) -> Iterator[tuple[int, _Position]]:
    """Yield the neighbours of a node of a grid: the drive that differs, and the position."""
    for drive, values in enumerate(grid):
        index = values.index(position[drive])
        for value in (*values[max(index - 1, 0) : index], *values[index + 1 : index + 2]):
            yield drive, (*position[:drive], value, *position[drive + 1 :])


def _shortened(path: _Points, is_clear: Callable[[_Position, _Position], bool]) -> _Points:
    """Return the points of a path without those that can be left out: from each point it goes on to
    the last one up to which all positions between are clear.
    """
    points = [path[0]]
    # The path begins with its first point twice, as the node of the begin has itself before it.
    remaining = path[path.index(points[-1]) + 1 :]
    while remaining:
        points.append(next(x for x in reversed(remaining) if is_clear(points[-1], x)))
        remaining = remaining[remaining.index(points[-1]) + 1 :]
    return tuple(points)


def _is_slew(station: Station) -> list[bool]:
    """Return whether each drive of a crane is its slew."""
    return [joint.role == "slew" for joint in station.crane.layout.driven]


def _turns_away(station: Station) -> list[bool]:
    """Return whether each drive of a crane is the one that takes it out of the way of others: its
    slew, or the first drive of a crane without one.
    """
    is_slew = _is_slew(station)
    if not any(is_slew):
        is_slew[station.bodies.columns[0]] = True
    return is_slew


def _once_around(station: Station, *positions: _Position) -> np.ndarray:
    """Return the ranges of the drives, shape (2, m), in which a slew turns no more than half a turn
    away from some positions.
    """
    half_turn = np.where(_is_slew(station), math.pi, math.inf)
    rows = np.array(positions)
    low = rows.min(axis=0) - half_turn
    high = rows.max(axis=0) + half_turn
    return np.clip([low, high], *station.ranges)


def _raised(station: Station, position: _Position) -> _Position:
    """Return a position with the load raised."""
    raised = np.array(position)
    winch = station.crane.winch
    shortest = float(station.crane.lower[station.crane.layout.drives[winch]])
    raised[winch] = min(raised[winch], shortest + _RAISED_CABLE)
    return tuple(raised.tolist())


def _standing(station: Station, position: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return the boxes of a crane that stands at positions, shape (rows, m) or (m,): (rows, 2, m).

    A box extends by two errors of measurement to each side: one by which the crane may stand beside
    the position, and one by which its guard may see it beside that.
    """
    slack = np.array([[-2.0], [2.0]]) * station.brakes.tolerances
    return np.atleast_2d(position)[:, None] + slack


def _first_near(
    site: CraneSite, a: int, boxes_a: np.ndarray, b: int, boxes_b: np.ndarray
) -> int | None:
    """Return the first slice in which two cranes are not proven apart; None if they are in all.

    The last box of each is for ever. Each slice is proven by itself, as a certificate proves it: a
    larger box around many slices can be proven where one of the slices alone is not.
    """
    count = max(len(boxes_a), len(boxes_b))
    proven = site.pair_apart(a, _extended(boxes_a, count), b, _extended(boxes_b, count))
    return None if proven.all() else int(proven.argmin())


@lru_cache(maxsize=512)
def _guard_boxes(station: Station, swing: float, motion: Motion) -> np.ndarray:
    """Return what a guard asks for in each slice of a motion, shape (slices, 2, m).

    The slices go from one before the motion to two after it, and the motion may be one slice early
    or late. A guard asks for where the drives stop if they brake now, and for as far beyond as they
    get within its `HORIZON`.
    """
    v = motion.v[:, motion.drives]
    brakes = gentle(station, swing)
    # The rates of a motion are known: the lowest and the highest are the same.
    low, high = brakes.tube(motion.q[:, motion.drives], v, v)
    low = low - brakes.tolerances + HORIZON * np.minimum(v, 0.0)
    high = high + brakes.tolerances + HORIZON * np.maximum(v, 0.0)

    row_count = len(motion.q)
    slices = np.arange(-1, math.ceil(row_count / _ROWS_PER_SLICE) + 2)[:, None]
    early_to_late = np.arange(-_ROWS_PER_SLICE, 2 * _ROWS_PER_SLICE + 1)
    rows = np.clip(slices * _ROWS_PER_SLICE + early_to_late, 0, row_count - 1)
    return np.stack([low[rows].min(axis=1), high[rows].max(axis=1)], axis=1)


def _extended(boxes: np.ndarray, count: int) -> np.ndarray:
    """Return the boxes of at least so many slices, the last box repeated."""
    return np.concatenate([boxes, boxes[-1:].repeat(max(count - len(boxes), 0), axis=0)])
