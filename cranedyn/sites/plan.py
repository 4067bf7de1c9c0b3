"""Plan lifts of several cranes in space and time, so that no two come near each other.

Each crane in turn takes the way by which it arrives first at the goal of its next lift, past all
motions that are planned: its drives go in straight lines from point to point, directly or with the
load raised, either way round, without a stop or with stops where the load is raised. Such a motion
keeps from the obstacles of the site, and in each slice of time it is proven apart from all others.
In a slice a crane has a box: all that its guard (`cranedyn.sites.supervisor`) asks for in the
motion, half a second early or late. A supervisor therefore grants the plan.
"""

from __future__ import annotations

import heapq
import itertools
import math
from bisect import bisect_right
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.ndimage import uniform_filter1d

from cranedyn.checks import finite, number, within
from cranedyn.errors import CraneError, OutOfRange, UnknownName, quoted
from cranedyn.interfaces import State
from cranedyn.planning.curve import straight_time
from cranedyn.planning.lift import RESERVE, NoWay
from cranedyn.references.limits import Limits, use
from cranedyn.references.motion import Motion
from cranedyn.sites.brakes import CYCLE
from cranedyn.sites.guard import HORIZON, gentle
from cranedyn.sites.simulate import SiteOperator
from cranedyn.sites.site import CraneSite, Station

SLICE, _ROWS = 0.5, 10
"""Length of a slice of time, by which a motion may be early or late [s], and rows of a motion in
it."""

_PERIOD = SLICE / _ROWS
"""Time between rows of a motion [s]."""

_LEVELS = 1.0, 2.0, 4.0, 8.0, 16.0
"""Multiples of the required distance that a certificate tries to prove."""

_FEW, _HULLS = 8, (64, 8, 1)
"""Slices that are looked ahead, and numbers of slices that are proven apart at once, before those
in them."""

_PATIENCE = 120
"""Slices by which a crane may be ready after one that waits before others make way for it."""

_RAISED = 1.0
"""Cable length of a raised load beyond the shortest [m]."""

_REFUGES, _TRIALS = 300, 6
"""Positions among which a crane looks for one that is clear of another's way, and to how many of
them it tries to get."""

_GAIN = 0.3
"""Rate by which an operator corrects a deviation from the plan [1/s]."""

_AVERAGES, _STILL, _ROUNDS, _SLOWER = np.array([1.5, 1.0, 0.5]), 4, 20, 0.998
"""Times over which a motion is averaged, over the square root of cable length by gravity; rows at
rest at its ends; rounds in which it is slowed down to its limits, and a share beyond."""

_STARTS, _STEPS, _CLOSE = 500, 12, 1e-7
"""Places from which a goal is looked for, steps of Newton's method, and where it ends [m]."""

_Position = tuple[float, ...]
"""Position of the drives of a crane [rad or m]."""

_Points = tuple[_Position, ...]
"""Positions that a way passes."""

_Legs = tuple[tuple[_Points, int], ...]
"""Ways of a crane, one after the other, and the slices in which they begin."""

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
        lifts: Their motions, each past those before it; of each crane in the order of time.
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
        """Time at which all loads have arrived [s]."""
        return max(motion.end for motion in self.lifts if motion.lift)

    @property
    def least(self) -> float:
        """Lower bound of the duration of any plan of these lifts [s]: the longest that the drives
        of a crane need from goal to goal, from rest to rest, while its loads stay there.
        """
        times = [0.0]
        for i, station in enumerate(self.site.stations):
            layout, slew = station.crane.layout, station.crane.layout.drive_of("slew")
            ends = [m.motion.q[-1] for m in self.lifts if m.crane == i and m.lift]
            courses = np.diff([station.crane.start.q, *ends], axis=0)[:, layout.drives]
            if slew is not None:
                courses[:, slew] = (courses[:, slew] + math.pi) % (2.0 * math.pi) - math.pi
            limits = _limits(station, self.site.swing)
            needs = [
                straight_time(np.array([0.0 * course, course]), limits) + self.stay
                for course in courses
            ]
            times.append(sum(needs) - self.stay)
        return max(times)

    @cached_property
    def distances(self) -> np.ndarray:
        """Proven distance of each pair of cranes in each slice of time [m], shape (slices, pairs),
        in the order of `itertools.combinations`: the largest of five multiples of the required one
        that is proven, or 0.
        """
        schedule = _Schedule(self.site)
        for motion in self.lifts:
            schedule.put(*motion)
        count = max(map(len, schedule.boxes))
        boxes = [_extended(item, count) for item in schedule.boxes]
        pairs = list(itertools.combinations(range(len(boxes)), 2))
        distances = np.zeros((count, len(pairs)))
        for k, (a, b) in enumerate(pairs):
            for level in self.site.distance * np.array(_LEVELS):
                distances[self.site.pair_apart(a, boxes[a], b, boxes[b], level), k] = level
        return distances

    @property
    def t(self) -> np.ndarray:
        """Begin of each slice of time [s], shape (slices,); the last has no end."""
        return SLICE * np.arange(-1, len(self.distances) - 1)

    @property
    def holds(self) -> bool:
        """Whether all pairs are proven to keep the required distance in all slices."""
        return bool((self.distances >= self.site.distance).all())

    def operators(self) -> list[SiteOperator]:
        """Return an operator for each crane that follows the plan."""
        return [partial(self._rates, i) for i in range(len(self.site.stations))]

    @cached_property
    def _motions(self) -> list[list[ScheduledLift]]:
        cranes = range(len(self.site.stations))
        return [[motion for motion in self.lifts if motion.crane == i] for i in cranes]

    def _rates(self, crane: int, t: float, states: Sequence[State]) -> np.ndarray:
        station = self.site.stations[crane]
        lead = station.converters.delay + CYCLE / 2.0 + station.converters.lags
        row = bisect_right(self._motions[crane], t + SLICE, key=lambda motion: motion.begin) - 1
        if row < 0:
            return np.zeros(len(lead))
        _, motion, begin, _ = self._motions[crane][row]
        rates = motion.at(t - begin + lead).velocity.diagonal()
        return rates + _GAIN * (
            motion(t - begin).position - states[crane].q[station.crane.layout.drives]
        )


def plan_site(
    site: CraneSite,
    lifts: Sequence[SiteLift],
    *,
    stay: float = 0.0,
    until: float | None = None,
    strict: bool = True,
) -> SitePlan:
    """Plan lifts of several cranes, one after the other; the crane that is ready first comes first.

    One without a way waits for the next motion of another. Where all wait, cranes make way for one.

    Args:
        site: The site; its cranes begin where they start.
        lifts: The lifts; those of one crane follow each other in this order. A crane stands still
            before its first and after its last lift, unless it makes way for another.
        stay: Time for which a load stays at its goal [s].
        until: Time from which on no lift begins [s]; None for no end.
        strict: Whether a lift without a way raises; else it is left out, see `SitePlan.refusals`.

    Raises:
        NoWay: If a lift has no way: alone, or past the others.
        OutOfRange: If there is no lift, or a time is negative.
        UnknownName: If there is no crane of a name.
    """
    number("stay", stay, "s", ">= 0")
    until = math.inf if until is None else number("until", until, "s", "> 0")
    names, pending = [station.name for station in site.stations], dict[int, list[np.ndarray]]()
    for name, goal in lifts:
        if name not in names:
            raise UnknownName("crane", name, names)
        goals = pending.setdefault(names.index(name), [])
        goals.append(finite("goal of a lift", goal, (3,)))
    if not pending:
        raise OutOfRange("number of lifts", 0, ">= 1")
    schedule, done, refusals = _Schedule(site, stay), dict.fromkeys(pending, 0), list[str]()
    while ready := [
        i for i in pending if done[i] < len(pending[i]) and schedule.ready[i] * SLICE < until
    ]:
        ready.sort(key=lambda i: schedule.ready[i])
        for i in ready:
            lift = i, pending[i][done[i]], done[i] + 1
            late = schedule.ready[i] > schedule.ready[ready[0]] + _PATIENCE
            if late and (cleared := schedule.first_cleared(ready, pending, done)) is not None:
                i, schedule = cleared
                break
            try:
                if schedule.lift(*lift):
                    break
            except NoWay as error:
                if strict:
                    raise
                refusals.append(str(error))
                break
        else:
            i = ready[0]
            if (cleared := schedule.first_cleared(ready, pending, done)) is None:
                text = f"Lift {done[i] + 1} of {quoted(names[i])} waits for others, and nothing "
                if strict:
                    raise NoWay(text + "brings them out of its way.")
                refusals.append(text + "brings them out of its way.")
            else:
                i, schedule = cleared
        done[i] += 1
    return SitePlan(site, tuple(schedule.lifts), stay, tuple(refusals))


class _Way(NamedTuple):
    """A motion of a crane between two positions, with its boxes, shape (slices, 2, m)."""

    motion: Motion
    boxes: np.ndarray


@lru_cache(maxsize=512)
def _way(site: CraneSite, i: int, points: _Points) -> _Way | CraneError:
    """Return the way of a crane through points, or why it is none: it keeps above ground, from
    obstacles, and in its ranges and its chart.
    """
    station, crane = site.stations[i], site.stations[i].crane
    try:
        motion = _leg(station, _limits(station, site.swing), site.swing, np.array(points))
        pivots, cables = station.rope(motion.q)[0], motion.q[:, motion.drives[crane.winch]]
        low = float((pivots[:, 2] - cables).min()) - station.bodies.depth[-1, 1, 2] - site.ground
        if low < site.distance:
            raise NoWay(f"its load is {low:.2f} m above ground; required is {site.distance:g} m.")
        if station.chart is not None:
            radii = np.linalg.norm((pivots - station.foot)[:, :2], axis=1)
            rated = float(station.chart.on().at(radii).min())
            number(f"load of {quoted(station.name)}", crane.payload_mass, "kg", f"0 to {rated:g}")
    except CraneError as error:
        return error
    boxes = _boxes(station, site.swing, motion)
    for box in boxes if site.solids else ():
        ends = site.positions(i, box)
        if not site.obstacles.proven_clear(site.bodies, i, ends, site.distance, site.swing):
            return NoWay("its way is too near to an obstacle.")
    return _Way(motion, boxes)


def _limits(station: Station, swing: float) -> Limits:
    """Return the limits of the drives of a crane in a plan."""
    slopes = gentle(station, swing).decelerations.tolist()
    return Limits((station.converters.rates / RESERVE).tolist(), slopes)


@lru_cache(maxsize=64)
def _positions(station: Station, begin: _Position, goal: _Position) -> list[_Position]:
    """Return the two nearest positions of the drives in time at which the load hangs at a point, of
    those to which Newton's method leads from places all over their ranges.
    """
    crane, rng = station.crane, np.random.default_rng(0)
    trials = rng.uniform(crane.lower, crane.upper, (_STARTS, crane.layout.n))
    trials, off = _hung(station, trials, np.array(goal), np.zeros((1, 2)))
    inside = (np.clip(trials, crane.lower, crane.upper) == trials).all(axis=1)
    reached = trials[inside & (off < _CLOSE)][:, crane.layout.drives]
    if not len(reached):
        raise OutOfRange("goal of the load", list(goal), "what the crane reaches", "m")
    times = (np.abs(reached - begin) / station.converters.rates).max(axis=1)
    reached = reached[times.argsort()]
    other_turn = np.abs(reached - reached[0]).max(axis=1) > 1e-3
    return [tuple(x.tolist()) for x in (reached[0], *reached[other_turn][:1])]


def _leg(station: Station, limits: Limits, swing: float, points: np.ndarray) -> Motion:
    """Return the motion through positions of the drives, shape (k, m), at rest at both ends.

    The load moves as if it hung plumb from drives that move in straight lines; the drives go where
    its rope points then, as in `cranedyn.references.flat`. Along a line they go at constant rates,
    averaged over the time to change their rates and over shares of the time in which the load
    swings. So they pass points between the ends without a stop, and beside them.
    """
    crane, layout, share = station.crane, station.crane.layout, 1.0
    courses = np.diff(points, axis=0)
    swings = _AVERAGES * math.sqrt(points[:, crane.winch].max() / crane.gravity)
    for _ in range(_ROUNDS):
        rates, slopes = share * np.array([limits.rates, limits.accelerations])
        times = (
            np.maximum(np.abs(courses) / rates, np.sqrt(np.abs(courses) / slopes)).max(axis=1)
            + 1e-3
        )
        knots = np.append(0.0, np.cumsum(times))
        jumps = np.diff(courses / times[:, None], axis=0, prepend=0.0, append=0.0)
        averages = np.append(np.max(np.abs(jumps) / slopes), swings)
        counts = 2 * np.ceil(averages / (2.0 * _PERIOD)).astype(int) + 1  # odd: about a row
        before = counts.sum() // 2 + _STILL
        t = _PERIOD * np.arange(2 * before + math.ceil(knots[-1] / _PERIOD))
        plumb = np.zeros((len(t), layout.n))
        for drive, joint in enumerate(layout.drives):
            plumb[:, joint] = np.interp(t - before * _PERIOD, knots, points[:, drive])
        for count in counts:
            plumb = uniform_filter1d(plumb, count, axis=0, mode="nearest")
        plumb[:, crane.swings] = crane.rest.angle + plumb[:, layout.drives] @ crane.rest.slope.T
        load, *_ = station.rope(plumb)
        load[:, 2] -= plumb[:, layout.drives[crane.winch]]
        pull = make_interp_spline(t, load, k=5).derivative(2)(t)
        lean = pull[:, :2] / (pull[:, 2:] + crane.gravity)
        curve = make_interp_spline(t, _hung(station, plumb, load, lean)[0], k=5)
        q, v, a = (curve.derivative(order)(t) for order in range(3))
        motion = Motion(_PERIOD, q, v, a, layout.drives)
        tilt = float(np.linalg.norm(lean, axis=1).max())
        if (used := max(tilt / swing, *use(crane, motion, limits).values())) <= 1.0:
            if (np.clip(q, crane.lower, crane.upper) != q)[:, layout.drives].any():
                raise NoWay("a drive would leave its range.")
            return motion
        share *= _SLOWER / used
    raise NoWay(f"no motion of its drives keeps their limits; one uses {used:.2f} of them.")


def _hung(
    station: Station, q: np.ndarray, load: np.ndarray, lean: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return coordinates near others, shape (rows, n), at which the rope goes through points of the
    load [m], shape (rows, 3), at a lean, shape (rows, 2), and by how much it misses them [m].
    """
    q, drives = q.copy(), station.crane.layout.drives
    for _ in range(_STEPS):
        pivots, _, motion = station.rope(q)
        rope = pivots - load
        off = rope[:, None, :2] - rope[:, None, 2:] * lean[:, None]
        slope = motion[..., :2] - motion[..., 2:] * lean[:, None]
        q[:, drives] -= (off @ np.linalg.pinv(slope))[:, 0]
        if np.abs(off).max() < _CLOSE:
            break
    q[:, drives[station.crane.winch]] = np.linalg.norm(rope, axis=1)
    return q, np.linalg.norm(off[:, 0], axis=1)


class _Schedule:
    """Motions with times, and the box of each crane in slices of time from -`SLICE` on, the last
    for ever.
    """

    def __init__(self, site: CraneSite, stay: float = 0.0) -> None:
        self.site, self.stay, self.lifts = site, stay, list[ScheduledLift]()
        self.ready = [0] * len(site.stations)
        self.boxes = []
        for station in site.stations:
            start = station.crane.start.q[station.crane.layout.drives]
            self.boxes.append(_standing(station, start[None]))
        self.positions = [
            tuple(s.crane.start.q[s.crane.layout.drives].tolist()) for s in site.stations
        ]

    def lift(self, crane: int, goal: np.ndarray, lift: int) -> bool:
        """Put in the next lift of a crane; return whether there is a way."""
        station = self.site.stations[crane]
        try:
            ends = _positions(station, self.positions[crane], tuple(goal.tolist()))
            free = [end for end in ends if self._possible(crane, end)]
            if not free:
                raise NoWay("wherever it may stand, another crane is in the way of its goal.")
            return self.move(crane, free, lift)
        except CraneError as error:
            raise NoWay(f"Lift {lift} of {quoted(station.name)} alone: {error}") from error

    def _possible(self, crane: int, end: _Position) -> bool:
        """Return whether each other crane has a position clear of one of a crane."""
        box = _standing(self.site.stations[crane], np.array([end]))
        for i, station in enumerate(self.site.stations):
            chunks = np.split(
                _standing(station, _refuges(station, self.positions[i])), _REFUGES // 10
            )
            if i != crane and not any(
                self._apart(crane, _extended(box, len(x)), i, x).any() for x in chunks
            ):
                return False
        return True

    def first_cleared(
        self, ready: list[int], goals: dict[int, list[np.ndarray]], done: dict[int, int]
    ) -> tuple[int, _Schedule] | None:
        """Return the first crane that others can make way for, and the schedule with its lift; None
        if they can for none of those that are ready within `_PATIENCE` of the first.
        """
        for i in ready:
            if self.ready[i] <= self.ready[ready[0]] + _PATIENCE:
                trial = self.cleared(i, goals[i][done[i]], done[i] + 1)
                if trial is not None:
                    return i, trial
        return None

    def cleared(self, crane: int, goal: np.ndarray, lift: int) -> _Schedule | None:
        """Return the schedule with the next lift of a crane, after others have made way for it;
        None if they cannot.
        """
        station, begin = self.site.stations[crane], self.positions[crane]
        ends = _positions(station, begin, tuple(goal.tolist()))
        for points in _direct(station, begin, ends):
            course, trial = _way(self.site, crane, points), self.copy()
            if isinstance(course, CraneError):
                continue
            rivals = (i for i in range(len(self.boxes)) if i != crane)
            if all(trial.make_way(i, crane, course) for i in rivals) and trial.lift(
                crane, goal, lift
            ):
                return trial
        return None

    def copy(self) -> _Schedule:
        """Return a copy to which motions can be added."""
        duplicate = copy(self)
        for name in ("lifts", "ready", "boxes", "positions"):
            setattr(duplicate, name, [*getattr(self, name)])
        return duplicate

    def make_way(self, crane: int, passing: int, course: _Way) -> bool:
        """Return whether a crane stands clear of the way of another, and bring it there."""
        station = self.site.stations[crane]

        def clear(box: np.ndarray) -> bool:
            ends = [course.boxes if i == passing else x[-1:] for i, x in enumerate(self.boxes)]
            return all(
                i == crane or self._first(crane, _extended(box, len(x)), i, x) is None
                for i, x in enumerate(ends)
            )

        if clear(self.boxes[crane][-1:]):
            return True
        begin = np.array(self.positions[crane])
        refuges = _refuges(station, self.positions[crane])
        times = (np.abs(refuges - begin) / station.converters.rates).max(axis=1)
        refuges = refuges[times.argsort()]
        free = (x for x in refuges if clear(_standing(station, x[None])))
        for refuge in itertools.islice(free, _TRIALS):
            try:
                if self.move(crane, [tuple(refuge.tolist())], 0):
                    return True
            except CraneError:
                continue
        return False

    def move(self, crane: int, ends: list[_Position], lift: int) -> bool:
        """Put in the motions by which a crane arrives first at one of the ends; return whether
        there are any.
        """
        station, begin = self.site.stations[crane], self.positions[crane]
        courses = [_way(self.site, crane, points) for points in _direct(station, begin, ends)]
        refusals = [course for course in courses if isinstance(course, CraneError)]
        if len(refusals) == len(courses):
            raise refusals[0]
        if (legs := self._route(crane, ends)) is None:
            return False
        for k, (points, first) in enumerate(legs):
            course = _way(self.site, crane, points)
            assert isinstance(course, _Way)
            self.put(crane, course.motion, first * SLICE, lift * (k == len(legs) - 1))
            self.positions[crane] = points[-1]
        return True

    def _route(self, crane: int, ends: list[_Position]) -> _Legs | None:
        """Return the ways by which a crane arrives first at one of the ends, where nothing comes
        near it later; None if there are none.

        A queue has ways in the order of their arrival, first with a lower bound, then as the other
        cranes let them begin. Where a crane cannot stay, the same way is tried later.
        """
        station, begin = self.site.stations[crane], self.positions[crane]
        up = _raised(station, begin)
        courses = [*_direct(station, begin, ends), (begin, up)]
        for end in ends:
            courses += [(up, _raised(station, end)), (_raised(station, end), end)]
        courses = [
            points for points in dict.fromkeys(courses) if len(points) > 2 or points[0] != points[1]
        ]
        queue: list[tuple[int, int, _Legs, _Points, int, float, bool]] = []
        order = itertools.count()

        def push(legs: _Legs, points: _Points, first: int, limit: float) -> None:
            moved = np.abs(np.diff(points, axis=0)).sum(axis=0) / station.converters.rates
            estimate = first + int(moved.max() / SLICE)
            heapq.heappush(queue, (estimate, next(order), legs, points, first, limit, False))

        for points in courses:
            if points[0] == begin:
                push((), points, self.ready[crane], math.inf)
        while queue:
            arrival, _, legs, points, first, limit, arrived = heapq.heappop(queue)
            course = _way(self.site, crane, points)
            if isinstance(course, CraneError):
                continue
            if not arrived:
                begins = self._begin(crane, course.boxes, first, limit)
                if begins is not None:
                    arrival = begins + len(course.boxes) - 1
                    item = arrival, next(order), legs, points, begins, limit, True
                    heapq.heappush(queue, item)
                continue
            conflict, until = self._conflict(crane, course.boxes[-1:], arrival), math.inf
            if conflict is not None:
                until = arrival + conflict[0]
                push(legs, points, first + conflict[0] + 1, limit)
            legs = (*legs, (points, first))
            if points[-1] in ends and conflict is None:
                return legs
            for following in courses:
                if following[0] == points[-1]:
                    push(legs, following, arrival, until)
        return None

    def _begin(self, crane: int, boxes: np.ndarray, first: int, limit: float) -> int | None:
        """Return the earliest slice in which a motion may begin, from the first on and before a
        limit; None if there is none.
        """
        while first < limit:
            if (conflict := self._conflict(crane, boxes, first)) is None:
                return first
            row, neighbour = conflict
            theirs, k = self.boxes[neighbour], first + row
            while k < len(theirs) - 1:
                ahead = theirs[k : k + _FEW]
                mine = boxes[min(row, len(boxes) - 1)][None].repeat(len(ahead), axis=0)
                free = self._apart(crane, mine, neighbour, ahead)
                k += int(free.argmax()) if free.any() else len(ahead)
                if free.any():
                    break
            else:
                return None
            first = max(first + 1, k - min(row, len(boxes) - 1))  # at the end it stands for ever
        return None

    def _conflict(self, crane: int, boxes: np.ndarray, first: int) -> tuple[int, int] | None:
        """Return the first row in which boxes that begin in a slice, the last for ever, are not
        proven apart from another crane, and its index; None if they are.
        """
        conflicts = []
        for neighbour, theirs in enumerate(self.boxes):
            if neighbour == crane:
                continue
            theirs = theirs[min(first, len(theirs) - 1) :]
            count = max(len(boxes), len(theirs))
            pair = crane, _extended(boxes, count), neighbour, _extended(theirs, count)
            if (row := self._first(*pair)) is not None:
                conflicts.append((row, neighbour))
        return min(conflicts, default=None)

    def _first(
        self,
        crane: int,
        mine: np.ndarray,
        neighbour: int,
        theirs: np.ndarray,
        begin: int = 0,
        sizes: tuple[int, ...] = _HULLS,
    ) -> int | None:
        """Return the first row in which two cranes are not proven apart, counted from a begin; None
        if they are in all.
        """
        size, *finer = sizes
        near = ~self._apart(crane, _hulls(mine, size), neighbour, _hulls(theirs, size))
        for k in np.nonzero(near)[0].tolist():
            if size == 1:
                return begin + k
            rows = slice(k * size, (k + 1) * size)
            row = self._first(
                crane, mine[rows], neighbour, theirs[rows], begin + k * size, (*finer,)
            )
            if row is not None:
                return row
        return None

    def _apart(self, a: int, box_a: np.ndarray, b: int, box_b: np.ndarray) -> np.ndarray:
        """Return whether two cranes in boxes are proven apart, as a certificate asks it."""
        (a, box_a), (b, box_b) = sorted([(a, box_a), (b, box_b)], key=lambda pair: pair[0])
        return self.site.pair_apart(a, box_a, b, box_b, self.site.distance)

    def put(self, crane: int, motion: Motion, begin: float, lift: int = 0) -> None:
        """Give a motion a time [s].

        Raises:
            OutOfRange: If it is no multiple of `SLICE`, or the crane's last motion is not done.
        """
        mine, boxes = self.boxes[crane], _boxes(self.site.stations[crane], self.site.swing, motion)
        within("begin of a lift after another", begin, (len(mine) - 1) * SLICE, math.inf, "s")
        if (k := round(begin / SLICE)) * SLICE != begin:
            raise OutOfRange("begin of a lift", begin, f"multiples of {SLICE:g}", "s")
        self.boxes[crane] = np.concatenate([_extended(mine, k)[:k], boxes])
        self.lifts.append(ScheduledLift(crane, motion, begin, lift))
        after = math.ceil((self.lifts[-1].end + self.stay) / SLICE) if lift else 0
        self.ready[crane] = max(len(self.boxes[crane]) - 1, after)


def _refuges(station: Station, begin: _Position) -> np.ndarray:
    """Return positions of the drives with the load raised, shape (`_REFUGES`, m): that of a
    position, such that differ in the slew alone, and such all over the ranges, once around.
    """
    drives, slew, winch = (
        station.crane.layout.drives,
        station.crane.layout.drive_of("slew"),
        station.crane.winch,
    )
    low, high = np.array([station.crane.lower, station.crane.upper])[:, drives]
    if slew is not None:
        low[slew] = max(low[slew], begin[slew] - math.pi)
        high[slew] = min(high[slew], begin[slew] + math.pi)
    refuges = np.random.default_rng(0).uniform(low, high, (_REFUGES, len(low)))
    if slew is not None:
        turned = np.array([begin]).repeat(_REFUGES // 2, axis=0)
        turned[:, slew] = refuges[: len(turned), slew]
        refuges[: len(turned)] = turned
    refuges[:, winch] = low[winch] + _RAISED
    refuges[0] = _raised(station, begin)
    return refuges


def _direct(station: Station, begin: _Position, ends: list[_Position]) -> list[_Points]:
    """Return the points of ways without a stop: straight, and with the load raised."""
    return [
        points
        for end in ends
        for points in ((begin, end), (begin, _raised(station, begin), _raised(station, end), end))
    ]


def _raised(station: Station, position: _Position) -> _Position:
    """Return a position with the load raised."""
    raised, winch = np.array(position), station.crane.winch
    cable = float(station.crane.lower[station.crane.layout.drives[winch]]) + _RAISED
    raised[winch] = min(raised[winch], cable)
    return tuple(raised.tolist())


def _standing(station: Station, positions: np.ndarray) -> np.ndarray:
    """Return boxes of a crane that stands at positions, shape (k, m): shape (k, 2, m)."""
    slack = 2.0 * station.brakes.tolerances
    return np.stack([positions - slack, positions + slack], axis=1)


def _hulls(boxes: np.ndarray, size: int) -> np.ndarray:
    """Return boxes around so many boxes each, shape (k, 2, m)."""
    rows = range(0, len(boxes), size)
    low, high = np.minimum.reduceat(boxes[:, 0], rows), np.maximum.reduceat(boxes[:, 1], rows)
    return np.stack([low, high], axis=1)


def _boxes(station: Station, swing: float, motion: Motion) -> np.ndarray:
    """Return what a guard asks for in each slice of a motion, from the slice before it to the one
    after it: shape (slices, 2, m).
    """
    brakes, q, v = gentle(station, swing), motion.q[:, motion.drives], motion.v[:, motion.drives]
    low, high = brakes.tube(q, v, v)
    low = low - brakes.tolerances + HORIZON * np.minimum(v, 0.0)
    high = high + brakes.tolerances + HORIZON * np.maximum(v, 0.0)
    slices = np.arange(-1, math.ceil(len(q) / _ROWS) + 2)[:, None]
    rows = np.clip(slices * _ROWS + np.arange(-_ROWS, 2 * _ROWS + 1), 0, len(q) - 1)
    return np.stack([low[rows].min(axis=1), high[rows].max(axis=1)], axis=1)


def _extended(boxes: np.ndarray, count: int) -> np.ndarray:
    """Return so many slices or more, the last repeated."""
    return np.concatenate([boxes, boxes[-1:].repeat(max(count - len(boxes), 0), axis=0)])
