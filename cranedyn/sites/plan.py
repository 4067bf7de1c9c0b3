"""Plan lifts of several cranes in space and time, so that no two come near each other.

Each crane in turn takes the way by which it arrives first at the goal of its next lift, past all
motions that are planned: its drives go in straight lines from point to point, directly or with the
load raised, either way round, without a stop or with stops; around obstacles if need be. A motion
keeps from the obstacles of the site, and in each slice of time it is proven apart from all others.
In a slice a crane has a box: all that its guard (`cranedyn.sites.supervisor`) asks for in the
motion, half a second early or late. A supervisor therefore grants the plan.
"""

from __future__ import annotations

import itertools
import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache, partial
from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.ndimage import uniform_filter1d

from cranedyn.checks import finite, number, within
from cranedyn.errors import CraneError, OutOfRange, UnknownName, quoted
from cranedyn.interfaces import State
from cranedyn.planning.curve import refuse_endless, rest_to_rest_time
from cranedyn.planning.lift import RESERVE, NoWay
from cranedyn.references.limits import Limits, use
from cranedyn.references.motion import Motion
from cranedyn.sites.brakes import CYCLE
from cranedyn.sites.guard import HORIZON, gentle, working_swing
from cranedyn.sites.simulate import SiteOperator
from cranedyn.sites.site import CraneSite, Station
from cranedyn.sites.working_wind import GUST_RESPONSE, WorkingWind

SLICE, _ROWS = 0.5, 10
"""Length of a slice of time, by which a motion may be early or late [s], and its rows."""

_PERIOD = SLICE / _ROWS
"""Time between rows of a motion [s]."""

_LEVELS = 1.0, 2.0, 4.0, 8.0, 16.0
"""Multiples of the required distance that a certificate tries to prove."""

_PATIENCE = 120
"""Slices by which a crane may be ready after one that waits before others make way for it."""

_RAISED = 1.0
"""Cable length of a raised load beyond the shortest [m]."""

_REFUGES, _GROUP, _TRIALS = 300, 30, 6
"""Positions among which a crane looks for one that is clear of another's way, how many are examined
at first, and to how many it tries to get."""

_CELL, _ROOM, _NODES = 2.0, 0.5, 5_000
"""Edge of a cell of the grid on which a way around obstacles is looked for, and room beside its
edges, as times at full rate [s]; most nodes that are reached."""

_GAIN = 0.3
"""Rate by which an operator corrects a deviation from the plan [1/s]."""

_AVERAGES, _STILL, _ROUNDS, _SLOWER = np.array([1.5, 1.0, 0.5]), 4, 20, 0.998
"""Times over which a motion is averaged, over the square root of cable length by gravity; rows at
rest at its ends; rounds in which it is slowed down to its limits, and a share beyond."""

_STARTS, _STEPS, _CLOSE, _DAMPING = 500, 12, 1e-7, 1e-9
"""Places from which a goal is looked for; steps, end [m] and damping [m²] of Newton's method."""

_Position = tuple[float, ...]
"""Position of the drives of a crane [rad or m]."""

_Points = tuple[_Position, ...]
"""Positions that a motion passes."""

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
        """Time at which all loads have arrived [s]; 0 if all lifts are left out."""
        return max((motion.end for motion in self.lifts if motion.lift), default=0.0)

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
            limits = _limits(station, _swing(self.site, i))
            needs = rest_to_rest_time(abs(courses), *np.array([limits.rates, limits.accelerations]))
            times.append(needs.max(axis=1).sum() + self.stay * (len(ends) - 1))
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
            for level in _LEVELS:
                distances[self.site.pair_apart(a, boxes[a], b, boxes[b], level), k] = level
        return self.site.distance * distances

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
        return [
            partial(_follow, station, [motion for motion in self.lifts if motion.crane == i])
            for i, station in enumerate(self.site.stations)
        ]


def _follow(
    station: Station, motions: list[ScheduledLift], t: float, states: Sequence[State]
) -> np.ndarray:
    """Return rates of the drives that follow motions, and correct deviations."""
    lead = station.converters.delay + CYCLE / 2.0 + station.converters.lags
    row = bisect_right(motions, t + SLICE, key=lambda motion: motion.begin) - 1
    if row < 0:
        return np.zeros(len(lead))
    crane, motion, begin, _ = motions[row]
    off = motion(t - begin).position - states[crane].q[motion.drives]
    return motion.at(t - begin + lead).velocity.diagonal() + _GAIN * off


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
        NoWay: If a lift has no way: alone, or past the others; or if it would take longer than
            `cranedyn.planning.curve.LONGEST_LIFT`.
        OutOfRange: If there is no lift, or a time is negative.
        UnknownName: If there is no crane of a name.
    """
    number("stay", stay, "s", ">= 0")
    until = math.inf if until is None else number("until", until, "s", "> 0")
    names = [station.name for station in site.stations]
    pending = {i: list[tuple[int, _Position]]() for i in range(len(names))}
    for name, goal in lifts:
        if name not in names:
            raise UnknownName("crane", name, names)
        goals = pending[names.index(name)]
        point = tuple(finite("goal of a lift", goal, (3,)).tolist())
        goals.append((len(goals) + 1, point))
    if not any(pending.values()):
        raise OutOfRange("number of lifts", 0, ">= 1")
    schedule, refusals = _Schedule(site, stay), list[str]()
    while ready := [i for i in pending if pending[i] and schedule.ready[i] * SLICE < until]:
        ready.sort(key=lambda i: schedule.ready[i])
        soon = schedule.ready[ready[0]] + _PATIENCE
        first = [i for i in ready if schedule.ready[i] <= soon]
        trials = [(False, first), (True, first), (False, ready[len(first) :])]
        for cleared, i in ((cleared, i) for cleared, cranes in trials for i in cranes):
            lift, goal = pending[i][0]
            try:
                if schedule.lift(i, goal, lift, cleared=cleared):
                    break
            except CraneError as error:
                refusals.append(f"Lift {lift} of {quoted(names[i])} alone: {error}")
                break
        else:
            i = ready[0]
            waits = f"Lift {pending[i][0][0]} of {quoted(names[i])} waits for others, and nothing "
            refusals.append(waits + "brings them out of its way.")
        if strict and refusals:
            raise NoWay(refusals[0])
        del pending[i][0]
    return SitePlan(site, tuple(schedule.lifts), stay, tuple(refusals))


def leaves_room(site: CraneSite, crane: int, position: np.ndarray) -> bool:
    """Return whether each other crane can stand clear of one whose drives are at a position, (m,).

    It is looked for as where cranes make way, by some positions at random, from their starts.
    """
    return _Schedule(site).clear(crane, _standing(site.stations[crane], position))


@lru_cache(maxsize=512)
def _motion(site: CraneSite, i: int, points: _Points) -> Motion | CraneError:
    """Return the motion of a crane through points, or why there is none: it keeps above ground,
    from obstacles, and in its ranges and its chart.
    """
    station, crane = site.stations[i], site.stations[i].crane
    try:
        motion = _leg(station, _swing(site, i), site.working_wind, np.array(points))
        load = station.plumb(motion.q[:, motion.drives])[1]
        low = _height(site, i, load)
        if low < site.distance:
            raise NoWay(f"its load is {low:.2f} m above ground; required is {site.distance:g} m.")
        if station.chart is not None:
            radii = np.linalg.norm((load - station.foot)[:, :2], axis=1)
            rated = float(station.chart.on().at(radii).min())
            number(f"load of {quoted(station.name)}", crane.payload_mass, "kg", f"0 to {rated:g}")
        for box in _boxes(station, _swing(site, i), motion) if site.solids else ():
            ends = site.positions(i, box)
            if not site.obstacles.proven_clear(site.bodies, i, ends, site.distance, site.swing):
                raise NoWay("each way that was tried is too near to an obstacle.")
    except CraneError as error:
        return error
    return motion


def _swept(site: CraneSite, i: int, path: list[_Points]) -> list[np.ndarray]:
    """Return the boxes of the motions of a crane through a path; none if one of them has none."""
    motions = [x for x in (_motion(site, i, points) for points in path) if isinstance(x, Motion)]
    boxes = [_boxes(site.stations[i], _swing(site, i), motion) for motion in motions]
    return boxes if len(boxes) == len(path) else []


def _height(site: CraneSite, i: int, load: np.ndarray) -> float:
    """Return the least height above ground [m] of a load hung at points, shape (rows, 3)."""
    return float(load[:, 2].min()) - site.stations[i].bodies.depth[-1, 1, 2] - site.ground


def _swing(site: CraneSite, i: int) -> float:
    """Return the swing that the wind of a site leaves to the drives of a crane [rad]."""
    return working_swing(site.stations[i], site.swing, site.working_wind)


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
        layout, drives = crane.layout, crane.layout.drives
        ranges = ", ".join(
            f"{symbol} from {low:.4g} to {high:.4g} {unit}"
            for symbol, unit, low, high in zip(
                (layout.symbols[i] for i in drives),
                (layout.units[i] for i in drives),
                crane.lower[drives].tolist(),
                crane.upper[drives].tolist(),
                strict=True,
            )
        )
        raise OutOfRange(
            f"goal of the load of {quoted(station.name)}",
            np.round(goal, 3).tolist(),
            f"a place where its load hangs with its drives in their ranges: {ranges}",
            "m",
        )
    times = (np.abs(reached - begin) / station.converters.rates).max(axis=1)
    reached = reached[times.argsort()]
    other_turn = np.abs(reached - reached[0]).max(axis=1) > 1e-3
    return [tuple(x.tolist()) for x in (reached[0], *reached[other_turn][:1])]


def _leg(station: Station, swing: float, wind: WorkingWind, points: np.ndarray) -> Motion:
    """Return the motion through positions of the drives, shape (k, m), at rest at both ends.

    The load moves as if it hung plumb from drives that move in straight lines; the drives go where
    its rope points then, as in `cranedyn.references.flat`. Along a line they go at constant rates,
    averaged over the time to change their rates and over shares of the time in which the load
    swings. So they pass points between the ends without a stop, and beside them.
    """
    crane, layout, share = station.crane, station.crane.layout, 1.0
    limits = _limits(station, swing)
    courses = np.diff(points, axis=0)
    lengths = np.abs(courses)
    swings = _AVERAGES * math.sqrt(points[:, crane.winch].max() / crane.gravity)
    for _ in range(_ROUNDS):
        rates, slopes = share * np.array([limits.rates, limits.accelerations])
        times = np.maximum(lengths / rates, np.sqrt(lengths / slopes)).max(axis=1) + 1e-3
        refuse_endless(float(times.sum()), limits)
        knots = np.append(0.0, np.cumsum(times))
        jumps = np.diff(courses / times[:, None], axis=0, prepend=0.0, append=0.0)
        averages = np.append(np.max(np.abs(jumps) / slopes), swings)
        counts = 2 * np.ceil(averages / (2.0 * _PERIOD)).astype(int) + 1  # odd: about a row
        before = counts.sum() // 2 + _STILL
        t = _PERIOD * np.arange(2 * before + math.ceil(knots[-1] / _PERIOD))
        position = np.column_stack([np.interp(t - before * _PERIOD, knots, x) for x in points.T])
        for count in counts:
            position = uniform_filter1d(position, count, axis=0, mode="nearest")
        plumb, load = station.plumb(position)
        pull = make_interp_spline(t, load, k=5).derivative(2)(t)
        lean = pull[:, :2] / (pull[:, 2:] + crane.gravity)
        curve = make_interp_spline(t, _hung(station, plumb, load, lean)[0], k=5)
        q, v, a = (curve.derivative(order)(t) for order in range(3))
        motion = Motion(_PERIOD, q, v, a, layout.drives)
        # A gust that blows against a load that travels swings it farther, see `WorkingWind`; what
        # it does to a load at rest is not in the swing that the drives may use.
        speed = np.linalg.norm(make_interp_spline(t, load, k=5).derivative()(t), axis=1)
        against = (wind.gust + speed) ** 2 - wind.gust**2
        by_gust = GUST_RESPONSE * wind.drag_ratio(crane) * against
        tilt = float((np.linalg.norm(lean, axis=1) + by_gust).max())
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
    lower, upper = station.ranges
    beyond = upper - lower  # as far as steps may lead, which else overflow near singular places
    for _ in range(_STEPS):
        pivots, _, motion = station.rope(q)
        rope = pivots - load
        off = rope[:, None, :2] - rope[:, None, 2:] * lean[:, None]
        slope = motion[..., :2] - motion[..., 2:] * lean[:, None]
        square = slope.mT @ slope + _DAMPING * np.eye(2)
        drive = q[:, drives] - (slope @ np.linalg.solve(square, off.mT))[..., 0]
        q[:, drives] = np.clip(drive, lower - beyond, upper + beyond)
        if np.abs(off).max() < _CLOSE:
            break
    q[:, drives[station.crane.winch]] = np.linalg.norm(rope, axis=1)
    return q, np.linalg.norm(off[:, 0], axis=1)


class _Schedule:
    """Motions with times, and the box of each crane in slices of time from -`SLICE` on, the last
    for ever.
    """

    def __init__(self, site: CraneSite, stay: float = 0.0) -> None:
        starts = [x.crane.start.q[x.crane.layout.drives] for x in site.stations]
        self.site, self.stay, self.lifts = site, stay, list[ScheduledLift]()
        self.boxes = [*map(_standing, site.stations, starts)]
        self.positions: list[_Position] = [tuple(start.tolist()) for start in starts]
        self.ready = [0] * len(starts)

    def lift(self, crane: int, goal: _Position, lift: int, *, cleared: bool) -> bool:
        """Put in the next lift of a crane, after others have made way for it if it is to be
        cleared; return whether there is a way.

        Raises:
            CraneError: If there is none, whatever others do.
        """
        station, begin = self.site.stations[crane], self.positions[crane]
        cranes = {*range(len(self.boxes))} - {crane}
        ends = _positions(station, begin, goal)
        if not (ends := [end for end in ends if self.clear(crane, _standing(station, end))]):
            raise NoWay("wherever it may stand, another crane is in the way of its goal.")
        if not cleared:
            return self._move(crane, ends, lift)
        paths = _ways(self.site, crane, begin, ends)
        ways = [(path, _swept(self.site, crane, path)) for path in paths]
        ways = [way for way in ways if way[1] and all(self.clear(crane, x) for x in way[1])]
        if not ways:
            raise NoWay("each way that was tried passes another crane wherever that may stand.")
        for path, boxes in ways:
            before = {name: [*x] for name, x in vars(self).items() if isinstance(x, list)}
            if all(
                all(self._make_way(i, crane, x) for i in cranes)
                and self._move(crane, [points[-1]], lift * (points is path[-1]))
                for points, x in zip(path, boxes, strict=True)
            ):
                return True
            vars(self).update(before)
        return False

    def clear(self, crane: int, boxes: np.ndarray) -> bool:
        """Return whether each other crane has a position clear of boxes of one."""
        others = (i for i in range(len(self.boxes)) if i != crane)
        return all(any(self._refuges(i, {crane: boxes})) for i in others)

    def _make_way(self, crane: int, passing: int, boxes: np.ndarray) -> bool:
        """Return whether a crane stands clear of the boxes of another, and bring it there."""
        ends = {i: x[-1:] for i, x in enumerate(self.boxes) if i != crane} | {passing: boxes}
        for refuge in itertools.islice(self._refuges(crane, ends), _TRIALS):
            if refuge == self.positions[crane]:
                return True
            with suppress(CraneError):
                if self._move(crane, [refuge], 0):
                    return True
        return False

    def _refuges(self, crane: int, boxes: dict[int, np.ndarray]) -> Iterator[_Position]:
        """Yield positions of a crane that are clear of boxes of others: where it stands, and with
        the load raised, in the order of time, where only the slew differs or anything, once around.
        """
        station, begin = self.site.stations[crane], self.positions[crane]
        layout, winch = station.crane.layout, station.crane.winch
        slews = [joint.role == "slew" for joint in layout.driven]
        low, high = _once_around(station, begin)
        rng = np.random.default_rng(0)
        refuges = rng.uniform(low, high, (_REFUGES, len(low)))
        refuges[::2] = np.where(slews, refuges[::2], begin)
        refuges[0], refuges[:, winch] = begin, low[winch] + _RAISED
        times = (np.abs(refuges - begin) / station.converters.rates).max(axis=1)
        slices = [(i, box) for i, x in boxes.items() for box in rng.permutation(x)]
        for group in np.split(np.array([begin, *refuges[times.argsort()]]), [1, _GROUP]):
            for i, box in slices:  # in any order, as neighbours fail alike
                group = group[self.site.pair_apart(crane, _standing(station, group), i, box)]
                if not len(group):
                    break
            yield from map(tuple, group.tolist())

    def _move(self, crane: int, ends: list[_Position], lift: int) -> bool:
        """Put in the motions by which a crane arrives first at one of the ends, where nothing comes
        near it later; return whether there are any.
        """
        station, swing = self.site.stations[crane], _swing(self.site, crane)
        paths, refusals = _ways(self.site, crane, self.positions[crane], ends), list[CraneError]()
        arrival, earliest = math.inf, list[tuple[Motion, int]]()
        for path in paths:
            legs, after = list[tuple[Motion, int]](), self.ready[crane]
            times = [np.abs(np.diff(x, axis=0)) / station.converters.rates for x in path]
            for k, points in enumerate(path):
                if after + sum(x.max(axis=1).sum() for x in times[k:]) // SLICE >= arrival:
                    break
                motion = _motion(self.site, crane, points)
                if isinstance(motion, CraneError):
                    refusals.append(motion)
                    break
                boxes = _boxes(station, swing, motion)
                begin = self._begin(crane, boxes, after)
                if begin is None or (after := begin + len(boxes) - 1) >= arrival:
                    break
                legs.append((motion, begin))
            else:
                arrival, earliest, self.positions[crane] = after, legs, points[-1]
        if len(refusals) == len(paths):
            raise refusals[0]
        for k, (motion, begin) in enumerate(earliest, start=1):
            self.put(crane, motion, begin * SLICE, lift * (k == len(earliest)))
        return bool(earliest)

    def _begin(self, crane: int, boxes: np.ndarray, first: int) -> int | None:
        """Return the earliest slice, from the first on, from which boxes, the last for ever, are
        proven apart from all others; None if there is none.
        """
        last, i = len(boxes) - 1, 0
        while i < len(self.boxes):
            theirs = self.boxes[i][min(first, len(self.boxes[i]) - 1) :]
            row = None if i == crane else _near(self.site, crane, boxes, i, theirs)
            if row is None:
                i += 1
                continue
            box, theirs = boxes[min(row, last)], self.boxes[i][first + row :]
            waits = (k for k, x in enumerate(theirs) if self.site.pair_apart(crane, box, i, x))
            if (wait := next(waits, None)) is None:  # it stands there for ever
                return None
            first, i = first + max(row - last, 0) + wait, 0
        return first

    def put(self, crane: int, motion: Motion, begin: float, lift: int = 0) -> None:
        """Give a motion a time [s].

        Raises:
            OutOfRange: If it is no multiple of `SLICE`, or the crane's last motion is not done.
        """
        mine, swing = self.boxes[crane], _swing(self.site, crane)
        boxes = _boxes(self.site.stations[crane], swing, motion)
        within("begin of a lift after another", begin, (len(mine) - 1) * SLICE, math.inf, "s")
        if (k := round(begin / SLICE)) * SLICE != begin:
            raise OutOfRange("begin of a lift", begin, f"multiples of {SLICE:g}", "s")
        self.boxes[crane] = np.concatenate([_extended(mine, k)[:k], boxes])
        self.lifts.append(ScheduledLift(crane, motion, begin, lift))
        after = math.ceil((self.lifts[-1].end + self.stay) / SLICE) if lift else 0
        self.ready[crane] = max(len(self.boxes[crane]) - 1, after)


def _ways(site: CraneSite, i: int, begin: _Position, ends: list[_Position]) -> list[list[_Points]]:
    """Return ways to ends, each by the points of its motions: straight, and with the load raised,
    without a stop and with stops; where obstacles are in all of them, also around these.
    """
    station, paths = site.stations[i], list[list[_Points]]()
    for end in ends:
        points: _Points = begin, _raised(station, begin), _raised(station, end), end
        paths += [[(begin, end)], [points], [*itertools.pairwise(dict.fromkeys(points))]]
    paths = [path for path in paths if path]
    if site.solids and not any(_swept(site, i, path) for path in paths):
        for points in (_around(site, i, begin, end) for end in ends):
            paths += [[points], [*itertools.pairwise(points)]] if points else []
    return paths


@lru_cache(maxsize=64)
def _around(site: CraneSite, i: int, begin: _Position, end: _Position) -> _Points:
    """Return points of the quickest way around obstacles, by A* over a grid: one drive moves at a
    time, along edges that are proven clear. Then points are left out between which all is clear. No
    point if there is no way.
    """
    station = site.stations[i]
    limits = _limits(station, _swing(site, i))
    rates, slopes = np.array([limits.rates, limits.accelerations])
    low, high = _once_around(station, begin, end)
    ranges = zip(low, high, _CELL * rates, begin, end, strict=True)
    grid = [np.unique([*np.arange(*cells), a, b]).tolist() for *cells, a, b in ranges]

    @cache
    def free(a: _Position, b: _Position) -> bool:
        ends = np.sort([a, b], axis=0) + np.multiply.outer([-_ROOM, _ROOM], rates)
        box, required = site.positions(i, ends), site.distance
        clear = site.obstacles.proven_clear(site.bodies, i, box, required, site.swing)
        return clear and _height(site, i, station.plumb(np.array([a, b]))[1]) >= required

    if not free(end, end):
        return ()
    reached, start = set[tuple[_Position, int]](), (begin,)
    queue: list[tuple[float, float, _Position, int, _Points]] = [(0.0, 0.0, begin, -1, start)]
    while queue and len(reached) < _NODES:
        _, cost, node, last, path = heappop(queue)
        if (node, last) in reached or not free(path[-1], node):
            continue
        reached.add((node, last))
        path += (node,)
        if node == end:
            points = [begin]
            while path := path[path.index(points[-1]) + 1 :]:
                points.append(next(x for x in reversed(path) if free(points[-1], x)))
            return tuple(points)
        for k, values in enumerate(grid):
            j = values.index(node[k])
            for value in (*values[max(j - 1, 0) : j], *values[j + 1 : j + 2]):
                to = (*node[:k], value, *node[k + 1 :])
                time = cost + abs(value - node[k]) / rates[k] + (k != last) * rates[k] / slopes[k]
                guess = time + (abs(np.subtract(to, end)) / rates).sum()
                heappush(queue, (guess, time, to, k, path))
    return ()


def _once_around(station: Station, *positions: _Position) -> np.ndarray:
    """Return ranges of the drives, shape (2, m), of a slew half a turn about positions."""
    slews = [joint.role == "slew" for joint in station.crane.layout.driven]
    half, rows = np.where(slews, math.pi, math.inf), np.array(positions)
    return np.clip([rows.min(axis=0) - half, rows.max(axis=0) + half], *station.ranges)


def _raised(station: Station, position: _Position) -> _Position:
    """Return a position with the load raised."""
    raised, winch = np.array(position), station.crane.winch
    cable = float(station.crane.lower[station.crane.layout.drives[winch]]) + _RAISED
    raised[winch] = min(raised[winch], cable)
    return tuple(raised.tolist())


def _standing(station: Station, position: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return boxes of a crane that stands at positions, shape (rows, m) or (m,): (rows, 2, m)."""
    slack = np.array([[-2.0], [2.0]]) * station.brakes.tolerances
    return np.atleast_2d(position)[:, None] + slack


def _near(site: CraneSite, a: int, boxes_a: np.ndarray, b: int, boxes_b: np.ndarray) -> int | None:
    """Return the first slice in which two cranes are not proven apart, the last box of each for
    ever; None if they are in all. Each slice is proven by itself, as a certificate proves it.
    """
    count = max(len(boxes_a), len(boxes_b))
    proven = site.pair_apart(a, _extended(boxes_a, count), b, _extended(boxes_b, count))
    return None if proven.all() else int(proven.argmin())


@lru_cache(maxsize=512)
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
