"""Plan lifts of several cranes in space and time, so that no two come near each other.

Each lift is planned alone: of a tower crane around the obstacles of the site, of any other by all
drives in a straight line, which is proven to keep from them. In an order, each then begins at the
earliest time from which on its crane is proven apart from all others as they move by then, slice of
time by slice. In a slice a crane has a box: all that its guard (`cranedyn.sites.supervisor`) asks
for in the motion, half a second early or late. A supervisor therefore grants the plan.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline

from cranedyn.checks import finite, number, within
from cranedyn.errors import OutOfRange, UnknownName, quoted
from cranedyn.interfaces import State
from cranedyn.planning.clearance import Clearance
from cranedyn.planning.lift import RESERVE, NoWay, plan_lift
from cranedyn.planning.site import Site
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

_ORDERS, _RAW_ORDERS = 24, 5040
"""Most orders of lifts that are tried: all of four; and most permutations among which they are."""

_GAIN = 0.3
"""Rate by which an operator corrects a deviation from the plan [1/s]."""

_DEVIATION = 0.1
"""Deviation from the plan beside obstacles [m]."""

_AVERAGES, _STILL, _ROUNDS, _SLOWER = np.array([1.5, 1.0, 0.5]), 4, 20, 0.998
"""Times over which a straight motion is averaged, over the square root of cable length by gravity;
rows at rest at its ends; rounds in which it is slowed down to its limits, and a share beyond."""

_STARTS, _STEPS, _CLOSE = 500, 12, 1e-7
"""Places from which a goal is looked for, steps of Newton's method, and where it ends [m]."""

SiteLift = tuple[str, Sequence[float] | np.ndarray]
"""Name of a crane, and the goal of the centre of its load in the frame of the site [m], shape (3,).
"""


class ScheduledLift(NamedTuple):
    """A lift with its time.

    Attributes:
        crane: Index of the crane.
        motion: Its motion.
        begin: Time at which it begins [s].
    """

    crane: int
    motion: Motion
    begin: float

    @property
    def end(self) -> float:
        """Time at which the load has arrived [s]."""
        return self.begin + self.motion.arrival


@dataclass(frozen=True, eq=False, repr=False)
class SitePlan:
    """Lifts of several cranes with their certificate.

    Attributes:
        site: The site.
        lifts: The lifts, each given the earliest time after those before it.
    """

    site: CraneSite
    lifts: tuple[ScheduledLift, ...]

    def __repr__(self) -> str:
        proven = "proven" if self.holds else "not proven"
        return f"Plan of {len(self.lifts)} lifts in {self.duration:.1f} s, cranes {proven} apart"

    @property
    def duration(self) -> float:
        """Time at which all loads have arrived [s]."""
        return max(lift.end for lift in self.lifts)

    @property
    def least(self) -> float:
        """Lower bound of the duration of these motions in any order and at any times [s]: the
        longest that a crane takes for its own.
        """
        times = [(lift.crane, lift.motion.arrival) for lift in self.lifts]
        return max(sum(time for i, time in times if i == crane) for crane, _ in times)

    @cached_property
    def distances(self) -> np.ndarray:
        """Proven distance of each pair of cranes in each slice of time [m], shape (slices, pairs),
        in the order of `itertools.combinations`: the largest of five multiples of the required one
        that is proven, or 0.
        """
        schedule = _Schedule(self.site)
        for lift in self.lifts:
            schedule.put(*lift)
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

    def _rates(self, crane: int, t: float, states: Sequence[State]) -> np.ndarray:
        station = self.site.stations[crane]
        lead = station.converters.delay + CYCLE / 2.0 + station.converters.lags
        rates = np.zeros(len(lead))
        for lift in self.lifts:
            if lift.crane == crane and t >= lift.begin - SLICE:
                rates = lift.motion.at(t - lift.begin + lead).velocity.diagonal()
                off = lift.motion(t - lift.begin).position
                rates = rates + _GAIN * (off - states[crane].q[station.crane.layout.drives])
        return rates


def plan_site(site: CraneSite, lifts: Sequence[SiteLift]) -> SitePlan:
    """Plan lifts of several cranes, in each order of four and in `_ORDERS` orders of more.

    Args:
        site: The site; its cranes begin where they start.
        lifts: The lifts; those of one crane follow each other in this order. A crane without a lift
            stands still.

    Raises:
        NoWay: If a lift alone has no way, or in no order all were proven apart.
        OutOfRange: If there is no lift, a crane does not reach a goal, or a chart does not carry
            the load on its way.
        UnknownName: If there is no crane of a name.
    """
    alone, best, blocked = _alone(site, lifts), None, ""
    totals = {i: sum(motion.arrival for motion in motions) for i, motions in alone.items()}
    turns = [i for i in sorted(alone, key=lambda i: -totals[i]) for _ in alone[i]]
    orders = itertools.islice(itertools.permutations(turns), _RAW_ORDERS)  # some are the same
    for order in itertools.islice(dict.fromkeys(orders), _ORDERS):
        schedule, pending = _Schedule(site), {i: iter(alone[i]) for i in alone}
        for i in order:
            blocked = schedule.add(i, next(pending[i]))
            if blocked or (best is not None and schedule.duration >= best.duration):
                break
        else:
            best = schedule
        if best is not None and best.duration <= max(totals.values()):
            break
    if best is None:
        raise NoWay(f"In no order that was tried all lifts are proven apart: {blocked}")
    return SitePlan(site, tuple(best.lifts))


def _alone(site: CraneSite, lifts: Sequence[SiteLift]) -> dict[int, list[Motion]]:
    """Return the motions of each crane, each from the end of the one before."""
    names = [station.name for station in site.stations]
    alone: dict[int, list[Motion]] = {}
    for name, goal in lifts:
        if name not in names:
            raise UnknownName("crane", name, names)
        motions = alone.setdefault(names.index(name), [])
        station = site.stations[names.index(name)]
        q = motions[-1].q[-1] if motions else station.crane.start.q
        try:
            motions.append(_motion(site, station, q, finite("goal of a lift", goal, (3,))))
        except NoWay as error:
            raise NoWay(f"{quoted(name)} alone: {error}") from error
    if not alone:
        raise OutOfRange("number of lifts", 0, ">= 1")
    return alone


def _motion(site: CraneSite, station: Station, q: np.ndarray, goal: np.ndarray) -> Motion:
    """Return the motion of a lift alone from coordinates at rest, shape (n,)."""
    crane, roles = station.crane, [joint.role for joint in station.crane.layout.driven]
    slopes = gentle(station, site.swing).decelerations.tolist()
    limits = Limits((station.converters.rates / RESERVE).tolist(), slopes)
    planned = _tower_motion if roles == ["slew", "trolley", "hoist"] else _straight_motion
    motion = planned(site, station, limits, q, goal)
    if station.chart is not None:
        radii = np.linalg.norm((station.rope(motion.q)[0] - station.foot)[:, :2], axis=1)
        rated = float(station.chart.on().at(radii).min())
        number(f"load of {quoted(station.name)}", crane.payload_mass, "kg", f"0 to {rated:g}")
    return motion


def _tower_motion(
    site: CraneSite, station: Station, limits: Limits, q: np.ndarray, goal: np.ndarray
) -> Motion:
    """Return the motion of a tower crane around obstacles."""
    crane, foot = station.crane, np.asarray(station.foot, dtype=float)
    distance = site.distance + (_DEVIATION if site.solids else 0.0)
    alone = Site(
        site.name, site.solids, site.ground, foot, station.heading,
        distance=distance, swing=site.swing,
    )  # fmt: skip
    clearance = Clearance(crane, alone)
    start = alone.to_site(clearance.point(q[crane.layout.drives]))
    planned = plan_lift(alone, limits, start=start, goal=goal, crane=crane, period=_PERIOD)
    motion, slew = planned.timed.motion, clearance.joints.slew
    motion.q[:, slew] += 2.0 * math.pi * round((q[slew] - motion.q[0, slew]) / (2.0 * math.pi))
    if (np.clip(motion.q, crane.lower, crane.upper) != motion.q)[:, slew].any():
        raise NoWay("it would turn beyond the range of its slew.")
    return motion


def _straight_motion(
    site: CraneSite, station: Station, limits: Limits, q: np.ndarray, goal: np.ndarray
) -> Motion:
    """Return the motion of any crane in a straight line of its drives, proven clear."""
    begin, i = q[station.crane.layout.drives], site.stations.index(station)
    motion = _leg(station, limits, site.swing, begin, _position(station, begin, goal))
    bottom = station.rope(motion.q)[0][:, 2] - motion.q[:, motion.drives[station.crane.winch]]
    low = float(bottom.min()) - station.bodies.depth[-1, 1, 2] - site.ground
    if low < site.distance:
        raise NoWay(f"its load is {low:.2f} m above ground; required is {site.distance:g} m.")
    for box in _boxes(station, site.swing, motion) if site.solids else ():
        ends = site.positions(i, box)
        if not site.obstacles.proven_clear(site.bodies, i, ends, site.distance, site.swing):
            raise NoWay("a straight way of its drives is too near to an obstacle; go around it.")
    return motion


def _position(station: Station, drives: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Return the nearest position of the drives in time, shape (m,), at which the load hangs at a
    point, of those to which Newton's method leads from places all over their ranges.
    """
    crane, rng = station.crane, np.random.default_rng(0)
    trials = rng.uniform(crane.lower, crane.upper, (_STARTS, crane.layout.n))
    trials, off = _hung(station, trials, goal, np.zeros((1, 2)))
    inside = (np.clip(trials, crane.lower, crane.upper) == trials).all(axis=1)
    reached = trials[inside & (off < _CLOSE)][:, crane.layout.drives]
    if not len(reached):
        raise OutOfRange("goal of the load", goal.tolist(), "what the crane reaches", "m")
    times = (np.abs(reached - drives) / station.converters.rates).max(axis=1)
    return reached[times.argmin()]


def _leg(
    station: Station, limits: Limits, swing: float, begin: np.ndarray, end: np.ndarray
) -> Motion:
    """Return the motion between two positions of the drives at rest, shape (m,) each.

    The load moves as if it hung plumb from drives that move in a straight line; the drives go where
    its rope points then, as in `cranedyn.references.flat`. Along the line they go at constant
    rates, averaged over the time to full rate and over shares of the time in which the load swings.
    """
    crane, layout = station.crane, station.crane.layout
    ways = np.abs(end - begin) + 1e-9
    fastest = (np.array([limits.rates, limits.accelerations]) / ways).min(axis=1)
    swings = _AVERAGES * math.sqrt(max(begin[crane.winch], end[crane.winch]) / crane.gravity)
    for _ in range(_ROUNDS):
        duration, steps = max(1.0 / fastest[0], fastest[1] ** -0.5), np.ones(1)
        for average in (duration, 1.0 / (fastest[1] * duration), *swings):
            count = max(1, round(average / _PERIOD))
            steps = np.convolve(steps, np.full(count, 1.0 / count))
        share = np.pad(np.cumsum(steps), _STILL, constant_values=(0.0, 1.0))
        plumb, t = np.zeros((len(share), layout.n)), _PERIOD * np.arange(len(share))
        plumb[:, layout.drives] = begin + share[:, None] * (end - begin)
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
            return motion
        fastest *= _SLOWER / used
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
    """Lifts with times, and the box of each crane in slices of time from -`SLICE` on, the last for
    ever.
    """

    def __init__(self, site: CraneSite) -> None:
        self.site, self.duration = site, 0.0
        self.lifts: list[ScheduledLift] = []
        self.boxes = []
        for station in site.stations:
            q = station.crane.start.q[None]
            still = Motion(_PERIOD, q, 0.0 * q, 0.0 * q, station.crane.layout.drives)
            self.boxes.append(_boxes(station, site.swing, still)[:1])

    def add(self, crane: int, motion: Motion) -> str:
        """Give a lift its earliest time; return why there is none, or an empty text."""
        station, blocking = self.site.stations[crane], 0
        boxes = _boxes(station, self.site.swing, motion)
        for k in range(len(self.boxes[crane]) - 1, max(map(len, self.boxes)) + 1):
            for blocking, theirs in enumerate(self.boxes):
                if blocking == crane:
                    continue
                count = max(len(boxes), len(theirs) - k)
                pair = _extended(boxes, count), blocking, _extended(theirs, k + count)[k:]
                if not self.site.pair_apart(crane, *pair, self.site.distance).all():
                    break
            else:
                self.put(crane, motion, k * SLICE)
                return ""
        names = quoted(station.name), quoted(self.site.stations[blocking].name)
        return f"a lift of {names[0]} waits for {names[1]}."

    def put(self, crane: int, motion: Motion, begin: float) -> None:
        """Give a lift a time [s].

        Raises:
            OutOfRange: If it is no multiple of `SLICE`, or the crane's last lift is not done.
        """
        mine, boxes = self.boxes[crane], _boxes(self.site.stations[crane], self.site.swing, motion)
        within("begin of a lift after another", begin, (len(mine) - 1) * SLICE, math.inf, "s")
        if (k := round(begin / SLICE)) * SLICE != begin:
            raise OutOfRange("begin of a lift", begin, f"multiples of {SLICE:g}", "s")
        self.boxes[crane] = np.concatenate([_extended(mine, k)[:k], boxes])
        self.lifts.append(ScheduledLift(crane, motion, begin))
        self.duration = max(self.duration, self.lifts[-1].end)


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
