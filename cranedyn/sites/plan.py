"""Plan lifts of several cranes in space and time, so that no two come near each other.

Each lift is planned alone, past the obstacles of the site. In every order of few lifts, each then
begins at the earliest time from which on its crane is proven apart from all others as they move by
then, slice of time by slice. So a lift waits for those before it in the order, never for a later
one. A crane has a box in each slice: all that a guard of `cranedyn.sites.supervisor` reserves for
the motion, half a second early or late. A supervisor therefore grants all that the plan asks for.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np

from cranedyn.checks import finite
from cranedyn.errors import OutOfRange, UnknownName, quoted
from cranedyn.interfaces import State
from cranedyn.planning.clearance import Clearance
from cranedyn.planning.lift import RESERVE, NoWay, plan_lift
from cranedyn.planning.site import Site
from cranedyn.references.limits import Limits
from cranedyn.references.motion import Motion
from cranedyn.sites.proof import proven_apart
from cranedyn.sites.simulate import SiteOperator
from cranedyn.sites.site import CraneSite, Station
from cranedyn.sites.supervisor import CYCLE, HORIZON, gentle

SLICE = 0.5
"""Length of a slice of time [s], and the time by which a motion may be early or late."""

_PERIOD, _ROWS = 0.05, 10
"""Time between rows of a motion [s], and rows of a slice."""

_LEVELS = 1.0, 2.0, 4.0, 8.0, 16.0
"""Multiples of the required distance that a certificate tries to prove."""

_ORDERS = 24
"""Most orders of lifts that are tried."""

_GAIN = 0.3
"""Rate by which an operator corrects a deviation from the plan [1/s]."""


class SiteLift(NamedTuple):
    """A lift of a crane from where it stands then.

    Attributes:
        crane: Name of the crane.
        goal: Centre of the load at the end, in the frame of the site [m], shape (3,).
    """

    crane: str
    goal: Sequence[float] | np.ndarray


class ScheduledLift(NamedTuple):
    """A lift with its time.

    Attributes:
        crane: Index of the crane.
        begin: Time at which it begins [s].
        motion: Motion of the crane from then on.
    """

    crane: int
    begin: float
    motion: Motion

    @property
    def end(self) -> float:
        """Time at which the load has arrived [s]."""
        return self.begin + self.motion.arrival


@dataclass(frozen=True, eq=False)
class SitePlan:
    """Lifts of several cranes with their certificate.

    Attributes:
        site: The site.
        lifts: The lifts in the order in which they were given a time.
        t: Begin of each slice of time [s], shape (slices,); the last has no end.
        distances: Proven distance of each pair of cranes in each slice [m], shape (slices, pairs),
            in the order of `itertools.combinations`: the largest of a few multiples of the required
            one that a proof reaches, 0 where it reaches none.
        least: Lower bound of the duration [s]: a crane needs this for its lifts alone.
    """

    site: CraneSite
    lifts: tuple[ScheduledLift, ...]
    t: np.ndarray
    distances: np.ndarray
    least: float

    @property
    def duration(self) -> float:
        """Time at which all loads have arrived [s]."""
        return max(lift.end for lift in self.lifts)

    @property
    def holds(self) -> bool:
        """Whether all pairs are proven apart in all slices."""
        return bool((self.distances >= self.site.distance).all())

    def operators(self) -> list[SiteOperator]:
        """Return an operator for each crane that follows the plan."""
        return [partial(self._rates, i) for i in range(len(self.site.stations))]

    def _rates(self, crane: int, t: float, states: Sequence[State]) -> np.ndarray:
        station = self.site.stations[crane]
        drives, response = station.crane.layout.drives, station.converters
        lead = response.delay + CYCLE / 2.0 + response.lags
        begun = [lift for lift in self.lifts if lift.crane == crane and t >= lift.begin - SLICE]
        if not begun:
            return np.zeros(len(drives))
        begin, motion = begun[-1].begin, begun[-1].motion
        rates = motion.at(t - begin + lead).velocity.diagonal()
        return rates + _GAIN * (motion(t - begin).position - states[crane].q[drives])


def plan_site(site: CraneSite, lifts: Sequence[SiteLift], *, seed: int = 0) -> SitePlan:
    """Plan lifts of several cranes.

    Args:
        site: The site; its cranes begin where they start.
        lifts: The lifts. Those of one crane follow each other in this order, and a crane stands
            for a second between two. Cranes without a lift stand still.
        seed: Seed of the orders that are tried of more than four lifts.

    Raises:
        NoWay: If a lift alone has no way, a chart does not carry it, or in none of the orders all
            were proven apart.
        OutOfRange: If there is no lift, or a crane does not reach a goal.
        UnknownName: If there is no crane of a name.
        MissingRole: If one that is to lift is no tower crane.
    """
    cranes, motions = _alone(site, lifts)
    alone = np.bincount(cranes, [motion.arrival for motion in motions])
    best: _Schedule | None = None
    blocked = ""
    for order in _orders(cranes, motions, seed):
        schedule = _Schedule(site, proofs={} if best is None else best.proofs)
        pending = {crane: [k for k, c in enumerate(cranes) if c == crane] for crane in order}
        for crane in order:
            blocked = schedule.add(crane, motions[pending[crane].pop(0)]) or blocked
            if blocked or (best is not None and schedule.duration >= best.duration):
                break
        else:
            best, blocked = schedule, ""
            if best.duration <= float(alone.max()):
                break
    if best is None:
        raise NoWay(f"In no order that was tried all lifts are proven apart: {blocked}")
    return SitePlan(site, tuple(best.lifts), *best.certificate(), float(alone.max()))


def _alone(site: CraneSite, lifts: Sequence[SiteLift]) -> tuple[list[int], list[Motion]]:
    """Return the crane and the motion of each lift alone."""
    names = [station.name for station in site.stations]
    if not len(lifts):
        raise OutOfRange("number of lifts", 0, ">= 1")
    cranes: list[int] = []
    motions: list[Motion] = []
    for lift in lifts:
        if lift.crane not in names:
            raise UnknownName("crane", lift.crane, names)
        crane = names.index(lift.crane)
        before = [motion for c, motion in zip(cranes, motions, strict=True) if c == crane]
        station = site.stations[crane]
        q = before[-1].q[-1] if before else station.crane.start.q
        goal = finite("goal of a lift", lift.goal, (3,), unit="m")
        motions.append(_motion(site, station, q, goal))
        cranes.append(crane)
    return cranes, motions


def _motion(site: CraneSite, station: Station, q: np.ndarray, goal: np.ndarray) -> Motion:
    """Return the motion of a lift alone from coordinates at rest, shape (n,)."""
    crane, drives = station.crane, station.crane.layout.drives
    surroundings = Site(
        site.name, (), site.ground, np.asarray(station.foot, dtype=float), station.heading,
        distance=site.distance, swing=site.swing,
    )  # fmt: skip
    clearance = Clearance(crane, surroundings)
    accelerations = gentle(station, site.swing).decelerations
    limits = Limits((station.converters.rates / RESERVE).tolist(), accelerations.tolist())
    start = surroundings.to_site(clearance.point(q[drives]))
    try:
        planned = plan_lift(
            surroundings, limits, start=start, goal=goal, crane=crane, period=_PERIOD
        )
    except NoWay as error:
        raise NoWay(f"{quoted(station.name)} alone: {error}") from error
    motion, slew = planned.timed.motion, clearance.joints.slew
    motion.q[:, slew] += 2.0 * math.pi * round((q[slew] - motion.q[0, slew]) / (2.0 * math.pi))
    low, high = motion.q[:, slew].min(), motion.q[:, slew].max()
    if low < crane.lower[slew] or high > crane.upper[slew]:
        raise NoWay(f"{quoted(station.name)} would turn beyond the range of its slew.")
    return motion


def _orders(
    cranes: Sequence[int], motions: Sequence[Motion], seed: int
) -> list[tuple[int, ...]]:
    """Return orders of cranes, once for each of their lifts: longest first, then others."""
    longest = sorted(range(len(cranes)), key=lambda k: -motions[k].arrival)
    first = tuple(cranes[k] for k in longest)
    if len(cranes) <= 4:
        return list(dict.fromkeys(itertools.permutations(first)))
    rng = np.random.default_rng(seed)
    return [first, *(tuple(rng.permutation(first).tolist()) for _ in range(_ORDERS - 1))]


def _boxes(station: Station, swing: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return what a guard reserves in each slice of a motion of its drives, shape (rows, m) each,
    from the slice before it to the one after it: shape (slices, 2, m).
    """
    brakes = gentle(station, swing)
    low, high = brakes.tube(q, v, v)
    low = low - brakes.tolerances + HORIZON * np.minimum(v, 0.0)
    high = high + brakes.tolerances + HORIZON * np.maximum(v, 0.0)
    slices = np.arange(-1, math.ceil(len(q) / _ROWS) + 2)[:, None]
    rows = np.clip(slices * _ROWS + np.arange(-_ROWS, 2 * _ROWS + 1), 0, len(q) - 1)
    return np.stack([low[rows].min(axis=1), high[rows].max(axis=1)], axis=1)


@dataclass
class _Schedule:
    """Lifts with times, and the boxes of each crane in the slices of time from -`SLICE` on, the
    last for ever.
    """

    site: CraneSite
    proofs: dict[bytes, bool] = field(repr=False)
    lifts: list[ScheduledLift] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._boxes: list[np.ndarray] = []
        for station in self.site.stations:
            q = station.crane.start.q[station.crane.layout.drives][None]
            self._boxes.append(_boxes(station, self.site.swing, q, 0.0 * q)[:1])

    @property
    def duration(self) -> float:
        return max((lift.end for lift in self.lifts), default=0.0)

    def add(self, crane: int, motion: Motion) -> str:
        """Give a lift its earliest time; return why there is none, or an empty text."""
        drives = motion.drives
        station, name = self.site.stations[crane], self.site.stations[crane].name
        boxes = _boxes(station, self.site.swing, motion.q[:, drives], motion.v[:, drives])
        mine = [lift for lift in self.lifts if lift.crane == crane]
        first = len(self._boxes[crane]) if mine else 0
        blocking: int | None = None
        for k in range(first, max(first, *map(len, self._boxes)) + 1):
            blocking = self._blocking(crane, boxes, k)
            if blocking is None:
                before = _extended(self._boxes[crane], k)[:k]
                self._boxes[crane] = np.concatenate([before, boxes])
                self.lifts.append(ScheduledLift(crane, k * SLICE, motion))
                return ""
        assert blocking is not None
        return f"a lift of {quoted(name)} waits for {quoted(self.site.stations[blocking].name)}."

    def _blocking(self, crane: int, boxes: np.ndarray, k: int) -> int | None:
        """Return a crane that is not proven apart from one that has boxes from a slice k on."""
        for other, theirs in enumerate(self._boxes):
            count = max(len(boxes), len(theirs) - k)
            if other != crane and not self._apart(
                crane, _extended(boxes, count), other, _extended(theirs, k + count)[k:]
            ):
                return other
        return None

    def _apart(self, a: int, boxes_a: np.ndarray, b: int, boxes_b: np.ndarray) -> bool:
        """Return whether two cranes are proven apart in all slices: all at once, or else halves."""
        hulls = [
            np.array([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
            for boxes in (boxes_a, boxes_b)
        ]
        key = b"".join([bytes([a, b]), *(hull.tobytes() for hull in hulls)])
        if key not in self.proofs:
            self.proofs[key] = _proven(self.site, a, hulls[0], b, hulls[1], self.site.distance)
        if self.proofs[key] or len(boxes_a) == 1:
            return self.proofs[key]
        half = len(boxes_a) // 2
        return all(
            self._apart(a, boxes_a[part], b, boxes_b[part])
            for part in (slice(half), slice(half, None))
        )

    def certificate(self) -> tuple[np.ndarray, np.ndarray]:
        """Return slices of time and proven distances, each slice by a proof of its own."""
        count = max(map(len, self._boxes))
        boxes = [_extended(item, count) for item in self._boxes]
        pairs = list(itertools.combinations(range(len(boxes)), 2))
        distances = np.zeros((count, len(pairs)))
        for (k, pair), _ in np.ndenumerate(distances):
            a, b = pairs[pair]
            for level in self.site.distance * np.array(_LEVELS):
                if not _proven(self.site, a, boxes[a][k], b, boxes[b][k], level):
                    break
                distances[k, pair] = level
        return SLICE * np.arange(-1, count - 1), distances


def _proven(
    site: CraneSite, a: int, box_a: np.ndarray, b: int, box_b: np.ndarray, distance: float
) -> bool:
    """Return whether two cranes with their drives in boxes are proven to keep a distance [m]."""
    ends = [site.positions(i, box)[None] for i, box in ((a, box_a), (b, box_b))]
    return bool(
        proven_apart(
            site.bodies, np.array([a]), ends[0], np.array([b]), ends[1], distance, site.swing
        )[0]
    )


def _extended(boxes: np.ndarray, count: int) -> np.ndarray:
    """Return so many slices or more, the last repeated."""
    return np.concatenate([boxes, boxes[-1:].repeat(max(count - len(boxes), 0), axis=0)])
