"""Distances during a tandem lift: of each crane, its rope and the load from the other crane, from
the obstacles of the site and from the ground.

Cranes are covered by the capsules of `cranedyn.lifts.sites.placed_capsules`, a rope by one capsule,
and the load by capsules along its longest side. So a distance is never more than the true one.

Distances are measured at the recorded rows, and proven between them. From a row to the next

* no point of the load and of its lugs goes farther than its path, whose bound the run records;
* the drives stay in intervals, see `cranedyn.lifts.tandem.drives.DriveMotion.intervals`, in which
  `cranedyn.lifts.sites.placed_capsules.place_capsules` bounds how far they move each capsule;
* a point of a rope moves no farther than one of its ends, since the rope is straight.

Capsules that are inflated by these bounds cover what moves at all times between the rows, so that
their distance is a lower bound of it.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from cranedyn.lifts.sites.distance_proof import ROUNDING, least_distances
from cranedyn.lifts.sites.obstacles import Obstacles
from cranedyn.lifts.sites.placed_capsules import PlacedCapsules, place_capsules
from cranedyn.lifts.tandem.simulation import TandemRun

_ROPE_RADIUS = 0.2
"""Radius of the capsule around a rope with its falls and its hook [m]."""


class TandemDistance(NamedTuple):
    """Least distance of two things during a run.

    Attributes:
        between: What it is between, in words.
        distance: The least distance at the recorded rows [m].
        t: Time at which they are so near [s].
        proven: Distance below which they are proven never to come, also between the rows [m].
        from_zone: Whether it is from a zone, out of which what hangs has to keep, at whatever
            distance.
    """

    between: str
    distance: float
    t: float
    proven: float
    from_zone: bool = False

    def required(self, distance: float) -> float:
        """Return the distance to keep [m], where that of bodies is given."""
        return 0.0 if self.from_zone else distance


class _Moving(NamedTuple):
    """Something that moves during a run, as capsules from each row to the next.

    Attributes:
        name: What it is, in words.
        ends: Ends of the capsules [m], shape (intervals, capsules, 2, 3).
        radius: Radii of what is there [m], shape (capsules,).
        swept: How far a point may be from there in each interval [m], shape (intervals, capsules).
        hangs: Whether it keeps out of zones, as rope and load do.
    """

    name: str
    ends: np.ndarray
    radius: np.ndarray
    swept: np.ndarray
    hangs: bool = False

    def at_rows(self) -> PlacedCapsules:
        """Return the capsules as they are, one group for each interval."""
        return self._with_radius(np.broadcast_to(self.radius, self.swept.shape))

    def inflated(self) -> PlacedCapsules:
        """Return capsules that cover it in the whole of each interval."""
        return self._with_radius(self.radius + self.swept)

    def _with_radius(self, radius: np.ndarray) -> PlacedCapsules:
        return PlacedCapsules(self.ends, radius, np.zeros(0))


def tandem_distances(run: TandemRun) -> list[TandemDistance]:
    """Return the least distances of a run: of the structures of both cranes, of each structure from
    the rope of the other crane, of each structure from the load, of the load from the ground, and
    of all that moves from each obstacle of the site.
    """
    lift = run.lift
    first, second = lift.names
    structures = [_structure(run, i) for i in range(2)]
    ropes = [_rope(run, i, structures[i]) for i in range(2)]
    load = _load(run)
    found = [
        _pair(run, f"{first} and {second}", structures[0], structures[1]),
        _pair(run, f"{first} and the rope of {second}", structures[0], ropes[1]),
        _pair(run, f"{second} and the rope of {first}", structures[1], ropes[0]),
        _pair(run, f"{first} and the load", structures[0], load),
        _pair(run, f"{second} and the load", structures[1], load),
        _above_ground(run),
    ]
    moving = [load, *ropes, *(_structure(run, i, moving=True) for i in range(2))]
    return found + list(_from_obstacles(run, moving))


def _pair(run: TandemRun, between: str, a: _Moving, b: _Moving) -> TandemDistance:
    """Return the least distance of two things that move."""
    distances = least_distances(a.at_rows(), b.at_rows())
    row = int(np.argmin(distances))
    bounds = least_distances(a.inflated(), b.inflated()) - ROUNDING
    return TandemDistance(between, float(distances[row]), float(run.t[row]), float(np.min(bounds)))


def _above_ground(run: TandemRun) -> TandemDistance:
    """Return the least distance of the load from the ground."""
    above = _lowest_corner(run) - run.lift.site.ground
    row = int(np.argmin(above))
    bound = float((above[:-1] - np.diff(run["travel_m"])).min()) - ROUNDING
    between = "the load and the ground"
    return TandemDistance(between, float(above[row]), float(run.t[row]), bound)


def _from_obstacles(run: TandemRun, moving: Sequence[_Moving]) -> Iterator[TandemDistance]:
    """Yield the least distance of each thing that moves from the solids of the site, and of what
    hangs from its zones.
    """
    obstacles = run.lift.site.obstacles
    kinds = {solid.zone for solid in run.lift.site.solids}
    for thing in moving:
        at_rows = _margins(obstacles, thing.at_rows(), hangs=thing.hangs)
        bounds = _margins(obstacles, thing.inflated(), hangs=thing.hangs)
        for zones in sorted(kinds):
            if zones and not thing.hangs:
                continue
            nearest = at_rows.of(zones=zones)
            interval, capsule = np.unravel_index(int(np.argmin(nearest)), nearest.shape)
            name = obstacles.nearest(
                thing.ends[interval, capsule], float(thing.radius[capsule]), zones=zones
            )
            yield TandemDistance(
                f"{thing.name} and {name}",
                float(nearest[interval, capsule]),
                float(run.t[interval]),
                float(bounds.of(zones=zones).min()),
                from_zone=zones,
            )


class _Margins(NamedTuple):
    """Distances of capsules from the obstacles of a site [m], shape (intervals, capsules) each.

    Attributes:
        from_solids: From the nearest solid.
        from_zones: From the nearest zone; inf for what does not hang.
    """

    from_solids: np.ndarray
    from_zones: np.ndarray

    def of(self, *, zones: bool) -> np.ndarray:
        """Return those from zones, or else those from solids."""
        return self.from_zones if zones else self.from_solids


def _margins(obstacles: Obstacles, capsules: PlacedCapsules, *, hangs: bool) -> _Margins:
    """Return the distances of capsules in each interval, see `Obstacles.margins`."""
    found = _Margins(np.empty(capsules.radius.shape), np.empty(capsules.radius.shape))
    for place in np.ndindex(*capsules.radius.shape):
        margins = obstacles.margins(
            capsules.ends[place], float(capsules.radius[place]), hangs=hangs
        )
        found.from_solids[place] = margins.from_solids
        found.from_zones[place] = margins.from_zones
    return found


def _structure(run: TandemRun, crane: int, *, moving: bool = False) -> _Moving:
    """Return the capsules of all of a crane but what hangs, or of that of it which moves, in the
    middle of the intervals of its drives.
    """
    site = run.lift.site
    station = run.lift.stations[crane]
    index = site.stations.index(station)
    bodies = station.bodies
    kept = np.flatnonzero(~bodies.hangs & ((bodies.joint > 0) | (not moving)))
    boxes = run.drives[crane].intervals(run.t)
    low = site.positions(index, boxes[:, 0])
    high = site.positions(index, boxes[:, 1])
    intervals = len(boxes)
    placed = place_capsules(
        site.bodies,
        np.full(intervals * len(kept), index),
        np.tile(kept, intervals),
        low.repeat(len(kept), axis=0),
        high.repeat(len(kept), axis=0),
        0.0,
    )
    return _Moving(
        name=station.name,
        ends=placed.ends.reshape(intervals, len(kept), 2, 3),
        radius=bodies.radius[kept],
        swept=placed.motion.sum(axis=1).reshape(intervals, len(kept)),
    )


def _rope(run: TandemRun, crane: int, structure: _Moving) -> _Moving:
    """Return the capsule around the rope of a crane, whose structure is given. The pivot moves with
    that, from one side of the middle of its intervals to the other at most.
    """
    ends = rope_ends(run, crane)[:-1, None]
    of_pivot = 2.0 * structure.swept.max(axis=1)
    swept = np.maximum(of_pivot, np.diff(run["travel_m"]))
    name = f"the rope of {run.lift.names[crane]}"
    return _Moving(name, ends, np.array([_ROPE_RADIUS]), swept[:, None], hangs=True)


def rope_ends(run: TandemRun, crane: int) -> np.ndarray:
    """Return pivot and lug of the rope of a crane in the frame of the site [m], shape
    (rows, 2, 3).
    """
    lug = np.array(run.lift.load.lugs[crane], dtype=float)
    return np.stack([run.pivots(crane), run.centres + run.rotations.apply(lug)], axis=1)


def _load(run: TandemRun) -> _Moving:
    """Return capsules around the load: along its longest side, side by side across the middle one,
    so many that each is about as wide as it is high.
    """
    size = np.array(run.lift.load.size, dtype=float)
    shortest, middle, longest = np.argsort(size).tolist()
    count = max(1, round(size[middle] / size[shortest]))
    width = size[middle] / count
    half = np.zeros(3)
    half[longest] = size[longest] / 2.0
    ends = []
    for i in range(count):
        offset = np.zeros(3)
        offset[middle] = (i + 0.5) * width - size[middle] / 2.0
        both = [run.centres + run.rotations.apply(offset + sign * half) for sign in (-1.0, 1.0)]
        ends.append(np.stack(both, axis=1))
    radius = float(np.hypot(width, size[shortest])) / 2.0
    swept = np.repeat(np.diff(run["travel_m"])[:, None], count, axis=1)
    capsules = np.stack(ends, axis=1)[:-1]
    return _Moving("the load", capsules, np.full(count, radius), swept, hangs=True)


def _lowest_corner(run: TandemRun) -> np.ndarray:
    """Return the height of the lowest corner of the load in each row [m], shape (rows,)."""
    half = np.array(run.lift.load.size, dtype=float) / 2.0
    heights = []
    for signs in itertools.product((-1.0, 1.0), repeat=3):
        heights.append(run.rotations.apply(half * np.array(signs))[:, 2])
    return run["load_z_m"] + np.min(heights, axis=0)
