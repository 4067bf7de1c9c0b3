"""Distances during a tandem lift: of each crane, its rope and the load from the other crane, and of
the load from the ground, at the recorded rows.

Cranes are covered by the capsules of `cranedyn.lifts.sites.placed_capsules`, the load and its ropes
by a capsule each. So a distance is never more than the true one. Between the rows nothing is
proven.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from cranedyn.lifts.sites.distance_proof import least_distances
from cranedyn.lifts.sites.placed_capsules import PlacedCapsules, place_crane
from cranedyn.lifts.tandem.simulation import TandemRun

_HANGING = ("rope", "load")
"""Names of capsules of a crane that hang: those of its own load, which is not there."""

_ROPE_RADIUS = 0.2
"""Radius of the capsule around a rope with its falls and its hook [m]."""


class TandemDistance(NamedTuple):
    """Least distance of two things during a run.

    Attributes:
        between: What it is between, in words.
        distance: The distance [m].
        t: Time at which they are so near [s].
    """

    between: str
    distance: float
    t: float


def tandem_distances(run: TandemRun) -> list[TandemDistance]:
    """Return the least distances of a run: of the structures of both cranes, of each structure from
    the rope of the other crane, of each structure from the load, and of the load from the ground.
    """
    lift = run.lift
    structures = [_structure(run, i) for i in range(2)]
    ropes = [_rope(run, i) for i in range(2)]
    load = _load(run)
    first, second = lift.names
    pairs = {
        f"{first} and {second}": (structures[0], structures[1]),
        f"{first} and the rope of {second}": (structures[0], ropes[1]),
        f"{second} and the rope of {first}": (structures[1], ropes[0]),
        f"{first} and the load": (structures[0], load),
        f"{second} and the load": (structures[1], load),
    }
    found = []
    for name, (a, b) in pairs.items():
        distances = least_distances(a, b)
        row = int(np.argmin(distances))
        found.append(TandemDistance(name, float(distances[row]), float(run.t[row])))
    above = _lowest_corner(run) - lift.site.ground
    row = int(np.argmin(above))
    found.append(TandemDistance("the load and the ground", float(above[row]), float(run.t[row])))
    return found


def _structure(run: TandemRun, crane: int) -> PlacedCapsules:
    """Return the capsules of all of a crane but what hangs, in each row."""
    site = run.lift.site
    station = run.lift.stations[crane]
    index = site.stations.index(station)
    positions = run.drive_positions(crane)
    q, _ = station.plumb(positions)
    angles = q[:, station.crane.swings]
    ends = place_crane(site.bodies, index, site.positions(index, positions), angles)
    names = station.bodies.names
    kept = [i for i, name in enumerate(names) if name not in _HANGING]
    radius = np.broadcast_to(station.bodies.radius[kept], (len(run), len(kept)))
    return PlacedCapsules(ends[:, kept], radius, np.zeros(0))


def _rope(run: TandemRun, crane: int) -> PlacedCapsules:
    """Return the capsule around the rope of a crane in each row."""
    ends = rope_ends(run, crane)[:, None]
    return PlacedCapsules(ends, np.full((len(run), 1), _ROPE_RADIUS), np.zeros(0))


def rope_ends(run: TandemRun, crane: int) -> np.ndarray:
    """Return pivot and lug of the rope of a crane in the frame of the site [m], shape
    (rows, 2, 3).
    """
    lug = np.array(run.lift.load.lugs[crane], dtype=float)
    return np.stack([run.pivots(crane), run.centres + run.rotations.apply(lug)], axis=1)


def _load(run: TandemRun) -> PlacedCapsules:
    """Return the capsule around the load in each row: about its longest side."""
    size = np.array(run.lift.load.size, dtype=float)
    longest = int(size.argmax())
    across = np.delete(size, longest)
    half = np.zeros(3)
    half[longest] = size[longest] / 2.0
    axis = run.rotations.apply(half)
    centre = run.centres
    ends = np.stack([centre - axis, centre + axis], axis=1)[:, None]
    radius = float(np.linalg.norm(across)) / 2.0
    return PlacedCapsules(ends, np.full((len(run), 1), radius), np.zeros(0))


def _lowest_corner(run: TandemRun) -> np.ndarray:
    """Return the height of the lowest corner of the load in each row [m], shape (rows,)."""
    half = np.array(run.lift.load.size, dtype=float) / 2.0
    heights = []
    for signs in itertools.product((-1.0, 1.0), repeat=3):
        heights.append(run.rotations.apply(half * np.array(signs))[:, 2])
    return run["load_z_m"] + np.min(heights, axis=0)
