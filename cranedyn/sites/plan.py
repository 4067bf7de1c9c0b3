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

from cranedyn.checks import finite, number
from cranedyn.errors import OutOfRange, UnknownName, quoted
from cranedyn.interfaces import State
from cranedyn.planning.clearance import Clearance
from cranedyn.planning.lift import RESERVE, NoWay, plan_lift
from cranedyn.planning.site import Site
from cranedyn.references.limits import Limits
from cranedyn.references.motion import Motion
from cranedyn.sites.brakes import CYCLE
from cranedyn.sites.guard import HORIZON, gentle
from cranedyn.sites.simulate import SiteOperator
from cranedyn.sites.site import CraneSite, Station

SLICE, _ROWS = 0.5, 10
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
    crane, foot = station.crane, np.asarray(station.foot, dtype=float)
    distance = site.distance + (_DEVIATION if site.solids else 0.0)
    alone = Site(
        site.name, site.solids, site.ground, foot, station.heading,
        distance=distance, swing=site.swing,
    )  # fmt: skip
    clearance = Clearance(crane, alone)
    accelerations = gentle(station, site.swing).decelerations
    limits = Limits((station.converters.rates / RESERVE).tolist(), accelerations.tolist())
    start = alone.to_site(clearance.point(q[crane.layout.drives]))
    planned = plan_lift(
        alone, limits, start=start, goal=goal, crane=crane, period=SLICE / _ROWS
    )  # fmt: skip
    motion, slew, radius = planned.timed.motion, clearance.joints.slew, clearance.joints.trolley
    motion.q[:, slew] += 2.0 * math.pi * round((q[slew] - motion.q[0, slew]) / (2.0 * math.pi))
    if (np.clip(motion.q, crane.lower, crane.upper) != motion.q)[:, slew].any():
        raise NoWay("it would turn beyond the range of its slew.")
    if station.chart is not None:
        rated = float(station.chart.on().at(motion.q[:, radius]).min())
        number(f"load of {quoted(station.name)}", crane.payload_mass, "kg", f"0 to {rated:g}")
    return motion


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
