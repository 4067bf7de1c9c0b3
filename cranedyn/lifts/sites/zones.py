"""Static zones: a box of drive positions for each crane of a site, all of them proven apart.

Cranes that keep to their zones need no supervisor, but leave most lifts of a dense site undone.
"""

from __future__ import annotations

import itertools
import math
from functools import cache

import numpy as np

from cranedyn.lifts.sites.crane_site import CraneSite
from cranedyn.lifts.sites.guard import Guard
from cranedyn.lifts.sites.operators import reach

ZONE_STEPS = {"rad": math.radians(5.0), "m": 2.5}
"""Steps by which static zones grow, by the unit of the drive."""


@cache
def static_zones(site: CraneSite) -> list[np.ndarray]:
    """Return a box of positions for each crane, shape (2, m), all of them proven apart.

    The boxes begin around the cranes at their start. First the hoists get their ranges, then in
    turn each end of each drive is moved outwards by a step, until none can be.
    """
    zones = [Guard(station, site.swing).box[0] for station in site.stations]
    ranges = [np.array(reach(site, i)) for i in range(len(site.stations))]
    for i, station in enumerate(site.stations):
        winch = station.crane.winch
        larger = zones[i].copy()
        larger[:, winch] = ranges[i][:, winch]
        if site.apart(i, larger, zones).all():
            zones[i] = larger

    grown = True
    while grown:
        grown = False
        for i, end in itertools.product(range(len(zones)), (0, 1)):
            grown |= _grow_end(site, zones, i, end, ranges[i])
    return zones


def _grow_end(
    site: CraneSite, zones: list[np.ndarray], crane: int, end: int, ranges: np.ndarray
) -> bool:
    """Move one end of each drive of a zone outwards by a step where it stays proven apart.

    Args:
        site: The site.
        zones: Zones of all cranes; that of the crane is replaced.
        crane: Index of the crane.
        end: 0 for the lower ends, 1 for the upper ones.
        ranges: Farthest ends, shape (2, m).

    Returns:
        Whether an end was moved.
    """
    outwards = 2 * end - 1
    grown = False
    for drive, joint in enumerate(site.stations[crane].crane.layout.driven):
        zone = zones[crane]
        larger = zone.copy()
        step = ZONE_STEPS[joint.unit] * outwards
        larger[end, drive] = np.clip(larger[end, drive] + step, *ranges[:, drive])
        moved = abs(larger[end, drive] - zone[end, drive]) > 1e-9
        if moved and site.apart(crane, larger, zones).all():
            zones[crane] = larger
            grown = True
    return grown
