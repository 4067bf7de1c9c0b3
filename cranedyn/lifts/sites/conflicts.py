"""What keeps a planned motion from passing another crane: which bodies would meet, and where."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cranedyn.lifts.sites.crane_site import CraneSite
from cranedyn.lifts.sites.distance_proof import least_distances
from cranedyn.lifts.sites.placed_capsules import PlacedCapsules, place_crane

_POINTS_OF_SEGMENT = 21
"""Points of the axis of a capsule among which the nearest to another capsule is looked for."""


class NearestBodies(NamedTuple):
    """The two bodies of a pair of cranes that come nearest to each other.

    Attributes:
        first_body: Body of the first crane, see `CraneBodies.names`.
        second_body: Body of the second crane.
        distance: Their distance [m]; negative where they overlap.
        place: Point between them in the frame of the site [m], shape (3,).
    """

    first_body: str
    second_body: str
    distance: float
    place: np.ndarray


@dataclass(frozen=True, eq=False)
class Conflict:
    """A slice of a motion that is not proven apart from another crane.

    Attributes:
        crane: Index of the crane that moves.
        box: Its box in that slice, shape (2, m).
        other: Index of the other crane.
        other_box: Box of the other crane, shape (2, m).
        wait: Time by which the motion begins later for it [s]; infinite where the other crane
            stands there for ever.
    """

    crane: int
    box: np.ndarray
    other: int
    other_box: np.ndarray
    wait: float

    def words(self, site: CraneSite) -> str:
        """Return which bodies would come too near to each other, and where."""
        bodies = nearest_bodies(site, self.crane, self.box, self.other, self.other_box)
        # Adding zero makes a rounded -0 a 0.
        x, y, z = bodies.place.round() + 0.0
        return (
            f"the {bodies.first_body} of {site.stations[self.crane].name} would come too near to "
            f"the {bodies.second_body} of {site.stations[self.other].name} at "
            f"[{x:.0f}, {y:.0f}, {z:.0f}] m"
        )


def nearest_bodies(
    site: CraneSite, a: int, box_a: np.ndarray, b: int, box_b: np.ndarray
) -> NearestBodies:
    """Return the bodies of two cranes that come nearest to each other with their loads plumb.

    The cranes are put at the middles and at all corners of their boxes. That is where positions in
    a box differ most, and no proof: other positions may come nearer.

    Args:
        site: The site.
        a: Index of a crane.
        box_a: Its box, shape (2, m).
        b: Index of the other crane.
        box_b: Its box, shape (2, m).
    """
    ends_a = _placed(site, a, box_a)
    ends_b = _placed(site, b, box_b)
    bodies_a = site.stations[a].bodies
    bodies_b = site.stations[b].bodies
    compared_a = site.compared_capsules(a, b)
    compared_b = site.compared_capsules(b, a)
    shape = len(ends_a), len(ends_b), len(compared_a), len(compared_b)
    row_a, row_b, column_a, column_b = np.indices(shape).reshape(4, -1)
    capsule_a = compared_a[column_a]
    capsule_b = compared_b[column_b]
    no_motion = np.zeros(0)
    gaps = least_distances(
        PlacedCapsules(ends_a[row_a, capsule_a], bodies_a.radius[capsule_a], no_motion),
        PlacedCapsules(ends_b[row_b, capsule_b], bodies_b.radius[capsule_b], no_motion),
    )
    k = int(gaps.argmin())
    nearest_a = ends_a[row_a[k], capsule_a[k]]
    nearest_b = ends_b[row_b[k], capsule_b[k]]
    return NearestBodies(
        first_body=bodies_a.names[capsule_a[k]],
        second_body=bodies_b.names[capsule_b[k]],
        distance=float(gaps[k]),
        place=_point_between(nearest_a, nearest_b),
    )


def _placed(site: CraneSite, crane: int, box: np.ndarray) -> np.ndarray:
    """Return the ends of the capsules of a crane at the middle and all corners of a box [m], shape
    (rows, capsules, 2, 3).
    """
    station = site.stations[crane]
    corners = np.array([*itertools.product(*box.T)])
    positions = np.vstack([box.mean(axis=0), corners])
    q, _ = station.plumb(positions)
    angles = q[:, station.crane.swings]
    ends = place_crane(site.bodies, crane, site.positions(crane, positions), angles)

    # All cranes have as many capsules as the one with most.
    return ends[:, : len(station.bodies.names)]


def _point_between(segment_a: np.ndarray, segment_b: np.ndarray) -> np.ndarray:
    """Return the middle between the nearest of some points of two segments [m], shape (3,), for
    segments given by their ends, shape (2, 3) each.
    """
    share = np.linspace(0.0, 1.0, _POINTS_OF_SEGMENT)[:, None]
    points_a = segment_a[0] + share * (segment_a[1] - segment_a[0])
    points_b = segment_b[0] + share * (segment_b[1] - segment_b[0])
    distances = np.linalg.norm(points_a[:, None] - points_b, axis=2)
    i, j = np.unravel_index(distances.argmin(), distances.shape)
    return (points_a[i] + points_b[j]) / 2.0


def longest(conflicts: list[Conflict]) -> Conflict | None:
    """Return the conflict for which a motion waits longest; None if there is none."""
    return max(conflicts, key=lambda conflict: conflict.wait, default=None)
