"""Plan lifts of several cranes in space and time, so that no two come near each other.

Each lift is planned alone, past the obstacles of the site. In an order, each then begins at the
earliest time from which on its crane is proven apart from all others as they move by then, slice of
time by slice. In a slice a crane has a box: all that its guard (`cranedyn.sites.supervisor`) asks
for in the motion, half a second early or late. A supervisor therefore grants the plan.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline

from cranedyn.checks import finite, number
from cranedyn.errors import OutOfRange, UnknownName, quoted
from cranedyn.interfaces import State
from cranedyn.planning.clearance import Clearance
from cranedyn.planning.lift import RESERVE, NoWay, plan_lift
from cranedyn.planning.site import Site
from cranedyn.references.limits import Limits, use
from cranedyn.references.motion import Motion
from cranedyn.sites.bodies import rope_poses
from cranedyn.sites.brakes import CYCLE
from cranedyn.sites.guard import HORIZON, gentle
from cranedyn.sites.simulate import SiteOperator
from cranedyn.sites.site import CraneSite, Station

SLICE, _ROWS = 0.5, 10
_PERIOD = SLICE / _ROWS
"""Length of a slice of time, by which a motion may be early or late [s], and rows of a motion in
it."""

_LEVELS = 1.0, 2.0, 4.0, 8.0, 16.0
"""Multiples of the required distance that a certificate tries to prove."""

_ORDERS, _RAW_ORDERS = 24, 5040
"""Most orders of lifts that are tried: all of four; and most permutations among which they are."""

_GAIN = 0.3
"""Rate by which an operator corrects a deviation from the plan [1/s]."""

_DEVIATION = 0.1
"""Deviation from the plan beside obstacles [m]."""

_AVERAGES, _STILL = (3.0, 2.0, 1.0), 4
"""Times over which a motion of the drives is averaged, over the square root of cable length by
gravity, and rows at rest before and after it."""

_ROUNDS, _SLOWER = 20, 0.998
"""Most rounds in which a motion is made slower until it keeps its limits, and a share by which it
then is slower still."""

_STARTS, _STEPS, _CLOSE = 7, 12, 1e-6
"""Places of each drive from which a goal is looked for, steps of Newton's method, and distance from
the goal at which it is reached [m]."""

SiteLift = tuple[str, Sequence[float] | np.ndarray]
"""Name of a crane, and the goal of the centre of its load in the frame of the site [m], shape (3,).
"""


class ScheduledLift(NamedTuple):
    """A lift with its time.

    Attributes:
        crane: Index of the crane.
        motion: Its motion.
        begin: Time at which it begins [s].
        end: Time at which the load has arrived [s].
    """

    crane: int
    motion: Motion
    begin: float
    end: float


@dataclass(frozen=True, eq=False, repr=False)
class SitePlan:
    """Lifts of several cranes with their certificate.

    Attributes:
        site: The site.
        lifts: The lifts, each given the earliest time after those before it.
        t: Begin of each slice of time [s], shape (slices,); the last has no end.
        distances: Proven distance of each pair of cranes in each slice [m], shape (slices, pairs),
            in the order of `itertools.combinations`: the largest of five multiples of the required
            one that is proven, or 0.
        duration: Time at which all loads have arrived [s].
        least: Lower bound of the duration [s]: the longest that a crane takes for its lifts alone.
    """

    site: CraneSite
    lifts: tuple[ScheduledLift, ...]
    t: np.ndarray
    distances: np.ndarray
    duration: float
    least: float

    def __repr__(self) -> str:
        proven = "proven" if self.holds else "not proven"
        return f"Plan of {len(self.lifts)} lifts in {self.duration:.1f} s, cranes {proven} apart"

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
        MissingRole: If one that is to lift is no tower crane.
    """
    alone = _alone(site, lifts)
    least = max(sum(motion.arrival for motion in motions) for motions in alone.values())
    first = sorted(alone, key=lambda i: -sum(motion.arrival for motion in alone[i]))
    turns = [i for i in first for _ in alone[i]]
    best: _Schedule | None = None
    proofs: dict[bytes, bool] = {}
    blocked = ""
    orders = itertools.islice(itertools.permutations(turns), _RAW_ORDERS)  # some are the same
    for order in itertools.islice(dict.fromkeys(orders), _ORDERS):
        schedule, pending = _Schedule(site, proofs), {i: iter(alone[i]) for i in alone}
        for i in order:
            blocked = schedule.add(i, next(pending[i]))
            if blocked or (best is not None and schedule.duration >= best.duration):
                break
        else:
            best = schedule
        if best is not None and best.duration <= least:
            break
    if best is None:
        raise NoWay(f"In no order that was tried all lifts are proven apart: {blocked}")
    return SitePlan(site, tuple(best.lifts), *best.certificate(), best.duration, least)


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
    limits = Limits(
        (station.converters.rates / RESERVE).tolist(),
        gentle(station, site.swing).decelerations.tolist(),
    )
    planned = _tower_motion if roles == ["slew", "trolley", "hoist"] else _straight_motion
    motion = planned(site, station, limits, q, goal)
    if station.chart is not None:
        pivots, _ = _pivots(station, motion.q[:, motion.drives])
        radii = np.linalg.norm((pivots - station.foot)[:, :2], axis=1)
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
    """Return the motion of any crane: all drives together or, past obstacles, with the load hoisted
    first and lowered last.
    """
    crane, drives = station.crane, station.crane.layout.drives
    begin, end = q[drives], _reached(station, q[drives], goal)
    above = np.array([begin, end])
    above[:, crane.winch] = crane.lower[drives[crane.winch]]
    for corners in ([begin, end], [begin, *above, end]):
        legs = [_leg(station, limits, site.swing, *pair) for pair in itertools.pairwise(corners)]
        tables = (np.concatenate([getattr(leg, name) for leg in legs]) for name in "qva")
        motion = Motion(_PERIOD, *tables, drives)
        if not (blocked := _blocked(site, station, motion)):
            return motion
    raise NoWay(blocked)


def _blocked(site: CraneSite, station: Station, motion: Motion) -> str:
    """Return why a motion is not proven to keep from ground and obstacles; "" if it is."""
    q, v = motion.q[:, motion.drives], motion.v[:, motion.drives]
    bottom = q[:, station.crane.winch] + station.bodies.depth[-1, 1, 2]
    above = float((_pivots(station, q)[0][:, 2] - bottom).min()) - site.ground
    if above < site.distance:
        return f"its load would hang {above:.2f} m above the ground; required is {site.distance:g} m."
    index, distances = site.stations.index(station), (site.distance, site.swing)
    for box in _boxes(station, site.swing, q, v) if site.solids else ():
        box = site.positions(index, box)
        if not site.obstacles.proven_clear(site.bodies, index, box, *distances):
            return "no straight way of its drives is proven to keep from the obstacles."
    return ""


def _reached(station: Station, drives: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Return the nearest position of the drives, shape (m,), at which the load hangs at a point of
    the site, of those to which Newton's method leads from places all over their ranges.
    """
    crane, chain = station.crane, station.bodies.columns[:-1]
    joints, rates = crane.layout.drives[chain], station.converters.rates
    ranges = np.array([crane.lower, crane.upper])[:, crane.layout.drives]
    turn = [math.pi if joint.unit == "rad" else math.inf for joint in crane.layout.driven]
    ends = np.clip([drives - turn, drives + turn], *ranges)
    starts = np.array([*itertools.product(*np.linspace(*ends[:, chain], _STARTS).T)])
    trials = np.tile(drives, (len(starts), 1))
    trials[:, chain] = starts
    trials, off = _hung(station, trials, goal[None], np.zeros((1, 2)))
    reached = (off < _CLOSE) & (np.clip(trials, *ranges) == trials).all(axis=1)
    if not reached.any():
        raise OutOfRange("goal of a lift", goal.tolist(), "what the drives reach", "m")
    return min(trials[reached], key=lambda x: float((np.abs(x - drives) / rates).max()))


def _leg(
    station: Station, limits: Limits, swing: float, begin: np.ndarray, end: np.ndarray
) -> Motion:
    """Return a motion between two positions of the drives at rest, shape (m,) each.

    The load moves as if it hung plumb from drives that move in a straight line; the drives go where
    its rope points then, as in `cranedyn.references.flat`. The line is averaged over the time to
    full rate and over shares of the time in which the load swings.
    """
    crane, drives, winch = station.crane, station.crane.layout.drives, station.crane.winch
    ways = np.abs(end - begin) + 1e-9
    rate, acceleration = (
        float((limit / ways).min()) for limit in (limits.rates, limits.accelerations)
    )
    swings = np.array(_AVERAGES) * math.sqrt(max(begin[winch], end[winch]) / crane.gravity)
    for _ in range(_ROUNDS):
        duration = max(1.0 / rate, acceleration**-0.5)
        steps = np.ones(1)
        for average in (duration, 1.0 / (acceleration * duration), *swings):
            count = max(1, round(average / _PERIOD))
            steps = np.convolve(steps, np.full(count, 1.0 / count))
        share = np.concatenate([np.zeros(_STILL), np.cumsum(steps), np.ones(_STILL)])
        plumb, t = begin + share[:, None] * (end - begin), _PERIOD * np.arange(len(share))
        load = _pivots(station, plumb)[0]
        load[:, 2] -= plumb[:, winch]
        acceleration_ = make_interp_spline(t, load, k=5).derivative(2)(t)
        lean = acceleration_[:, :2] / (crane.gravity + acceleration_[:, 2:])
        curve = make_interp_spline(t, _hung(station, plumb, load, lean)[0], k=5)
        samples = np.zeros((3, len(t), crane.layout.n))
        samples[:, :, drives] = [curve.derivative(order)(t) for order in range(3)]
        samples[0][:, crane.swings] = crane.rest.angle + samples[0][:, drives] @ crane.rest.slope.T
        samples[1:, [0, -1]] = 0.0
        motion = Motion(_PERIOD, *samples, drives)
        tilt = float(np.linalg.norm(lean, axis=1).max())
        used = max(tilt / swing, *use(crane, motion, limits).values())
        if used <= 1.0:
            return motion
        rate, acceleration = _SLOWER * rate / used, _SLOWER * acceleration / used
    raise NoWay(f"no motion of its drives keeps their limits; one uses {used:.2f} of them.")


def _pivots(station: Station, drives: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return pivots of the rope [m], shape (rows, 3), and their motion by each drive before the
    rope, shape (rows, k, 3), at positions of the drives, shape (rows, m).
    """
    chain = drives[:, station.bodies.columns[:-1]]
    poses = rope_poses(station.ropes.repeat(len(chain), 0), chain, np.zeros((len(chain), 2)))
    return poses[:, :3], poses[:, 6:].reshape(*chain.shape, 3)


def _hung(
    station: Station, drives: np.ndarray, load: np.ndarray, lean: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return positions of the drives, shape (rows, m), near some others, with the rope through
    points of the load [m], shape (rows, 3), at a lean from plumb, shape (rows, 2), and by how much
    it misses them [m], shape (rows,).
    """
    drives, chain = drives.copy(), station.bodies.columns[:-1]
    for _ in range(_STEPS):
        pivots, motion = _pivots(station, drives)
        rope = pivots - load
        off = rope[:, None, :2] - rope[:, None, 2:] * lean[:, None]
        slope = motion[..., :2] - motion[..., 2:] * lean[:, None]
        drives[:, chain] -= (off @ np.linalg.pinv(slope))[:, 0]
    drives[:, station.crane.winch] = np.linalg.norm(rope, axis=1)
    return drives, np.linalg.norm(off[:, 0], axis=1)


class _Schedule:
    """Lifts with times, and the box of each crane in slices of time from -`SLICE` on, the last for
    ever.
    """

    def __init__(self, site: CraneSite, proofs: dict[bytes, bool]) -> None:
        self.site, self.duration, self._proofs = site, 0.0, proofs
        self.lifts: list[ScheduledLift] = []
        self._boxes = []
        for station in site.stations:
            q = station.crane.start.q[None, station.crane.layout.drives]
            self._boxes.append(_boxes(station, site.swing, q, 0.0 * q)[:1])

    def add(self, crane: int, motion: Motion) -> str:
        """Give a lift its earliest time; return why there is none, or an empty text."""
        station, q, v = self.site.stations[crane], motion.q, motion.v
        boxes = _boxes(station, self.site.swing, q[:, motion.drives], v[:, motion.drives])
        mine = self._boxes[crane]
        first, blocking = len(mine) if len(mine) > 1 else 0, 0
        for k in range(first, max(first, *map(len, self._boxes)) + 1):
            for blocking, theirs in enumerate(self._boxes):
                count = max(len(boxes), len(theirs) - k)
                later = _extended(theirs, k + count)[k:]
                if blocking != crane and not self._apart(
                    crane, _extended(boxes, count), blocking, later
                ):
                    break
            else:
                self._boxes[crane] = np.concatenate([_extended(mine, k)[:k], boxes])
                begin = k * SLICE
                self.lifts.append(ScheduledLift(crane, motion, begin, begin + motion.arrival))
                self.duration = max(self.duration, self.lifts[-1].end)
                return ""
        names = quoted(station.name), quoted(self.site.stations[blocking].name)
        return f"a lift of {names[0]} waits for {names[1]}."

    def _apart(self, a: int, boxes_a: np.ndarray, b: int, boxes_b: np.ndarray) -> bool:
        """Return whether two cranes are proven apart in all slices: all at once, or else halves."""
        hulls = [
            np.array([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
            for boxes in (boxes_a, boxes_b)
        ]
        key = b"".join([bytes([a, b]), *(hull.tobytes() for hull in hulls)])
        if key not in self._proofs:
            self._proofs[key] = self.site.pair_apart(a, hulls[0], b, hulls[1], self.site.distance)
        half = len(boxes_a) // 2
        halves = slice(half), slice(half, None)
        if not self._proofs[key] and half:
            return all(self._apart(a, boxes_a[part], b, boxes_b[part]) for part in halves)
        return self._proofs[key]

    def certificate(self) -> tuple[np.ndarray, np.ndarray]:
        """Return slices of time and proven distances, each slice by a proof of its own."""
        count = max(map(len, self._boxes))
        boxes = [_extended(item, count) for item in self._boxes]
        pairs = list(itertools.combinations(range(len(boxes)), 2))
        distances = np.zeros((count, len(pairs)))
        for k, pair in np.ndindex(*distances.shape):
            a, b = pairs[pair]
            for level in self.site.distance * np.array(_LEVELS):
                if not self.site.pair_apart(a, boxes[a][k], b, boxes[b][k], level):
                    break
                distances[k, pair] = level
        return SLICE * np.arange(-1, count - 1), distances


def _boxes(station: Station, swing: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return what a guard asks for in each slice of a motion of its drives, shape (rows, m) each,
    from the slice before it to the one after it: shape (slices, 2, m).
    """
    brakes = gentle(station, swing)
    low, high = brakes.tube(q, v, v)
    low = low - brakes.tolerances + HORIZON * np.minimum(v, 0.0)
    high = high + brakes.tolerances + HORIZON * np.maximum(v, 0.0)
    slices = np.arange(-1, math.ceil(len(q) / _ROWS) + 2)[:, None]
    rows = np.clip(slices * _ROWS + np.arange(-_ROWS, 2 * _ROWS + 1), 0, len(q) - 1)
    return np.stack([low[rows].min(axis=1), high[rows].max(axis=1)], axis=1)


def _extended(boxes: np.ndarray, count: int) -> np.ndarray:
    """Return so many slices or more, the last repeated."""
    return np.concatenate([boxes, boxes[-1:].repeat(max(count - len(boxes), 0), axis=0)])
