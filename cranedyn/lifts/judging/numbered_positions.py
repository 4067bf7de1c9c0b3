"""The numbered positions of a lift: where it begins, turns, is nearest to an obstacle, and ends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cranedyn.lifts.judging.analysis import LiftAnalysis
from cranedyn.lifts.planning.ground_lift import load_corners, stands_at
from cranedyn.lifts.planning.timing import STEP

MAX_POSITIONS = 8
"""Largest number of positions; more numbers on one drawing cannot be told apart."""

_LEAST_ROWS = 100
"""Least number of rows of the motion between two positions, two seconds: what turns sooner again is
one turn for whoever stands beside the crane."""


@dataclass(frozen=True)
class Position:
    """A numbered position of a lift.

    Attributes:
        number: Its number, from 1.
        name: What it is, such as "pick-up".
        row: Its row among the places of the planned motion.
        t: Its time from the beginning of the planned motion [s].
        place: Positions of the drives, shape (3,).
        centre: Centre of the load in the frame of the site [m], shape (3,).
    """

    number: int
    name: str
    row: int
    t: float
    place: np.ndarray
    centre: np.ndarray


def numbered_positions(analysis: LiftAnalysis) -> list[Position]:
    """Return the positions of a lift in the order of time, at most `MAX_POSITIONS`."""
    lift = analysis.certificate.lift
    places = lift.timed.places
    last = len(places) - 1
    nearest = min(round(analysis.certificate.nearest_t / STEP), last)
    turns = turning_rows(places, lift.points, np.array(lift.limits.rates))

    first_name, last_name = end_names(analysis)
    named = {0: first_name, last: last_name}
    if _is_apart(nearest, named):
        named[nearest] = "nearest to an obstacle"
    for row in turns:
        if len(named) < MAX_POSITIONS and _is_apart(row, named):
            named[row] = "turning point"

    centres = analysis.site.to_site(lift.clearance.point(places))
    positions: list[Position] = []
    for row in sorted(named):
        number = len(positions) + 1
        position = Position(number, named[row], row, STEP * row, places[row], centres[row])
        positions.append(position)
    return positions


def end_names(analysis: LiftAnalysis) -> tuple[str, str]:
    """Return what the two ends of the planned motion are. A load that stands hangs above its place
    there: after it was lifted off, and before it is set down.
    """
    phases = {} if analysis.grounded is None else analysis.grounded.lift.phases
    site = analysis.site
    first = "above pick-up" if stands_at(site.start) else "pick-up"
    if "lift-off" in phases:
        first = "lifted off"
    return first, "above set-down" if stands_at(site.goal) else "set-down"


@dataclass(frozen=True, eq=False)
class LoadAtRest:
    """Where the load stands before it is lifted off, or after it was set down.

    Attributes:
        name: What happens there, "pick-up" or "set-down".
        corners: Corners of the load in the frame of the site [m], shape (8, 3).
    """

    name: str
    corners: np.ndarray

    @property
    def centre(self) -> np.ndarray:
        """The middle of the load [m], shape (3,)."""
        return self.corners.mean(axis=0)

    @property
    def underside(self) -> float:
        """Height of its lowest corner in the frame of the site [m]."""
        return float(self.corners[:, 2].min())


class LoadsAtRest(NamedTuple):
    """Where the load stands at both ends of a lift; None where it hangs, or lift-off and set-down
    were not simulated.

    Attributes:
        pick_up: Before it is lifted off.
        set_down: After it was set down.
    """

    pick_up: LoadAtRest | None
    set_down: LoadAtRest | None


def loads_at_rest(analysis: LiftAnalysis) -> LoadsAtRest:
    """Return where the load stands at both ends of the simulated run."""
    grounded = analysis.grounded
    if grounded is None:
        return LoadsAtRest(None, None)
    found: list[LoadAtRest | None] = []
    for phase, name, row in (("lift-off", "pick-up", 0), ("set-down", "set-down", -1)):
        stands = None
        if phase in grounded.lift.phases:
            in_crane = load_corners(grounded.lift, grounded.run.q[row])
            stands = LoadAtRest(name, analysis.site.to_site(in_crane))
        found.append(stands)
    return LoadsAtRest(*found)


def turning_rows(places: np.ndarray, corners: np.ndarray, rates: np.ndarray) -> list[int]:
    """Return the rows of a motion at which the drives change what they do, in order: those nearest
    to the corners of its way, whose rounding the motion follows.

    Args:
        places: Places of the motion in rows, shape (n, 3).
        corners: Ends and corners of the way, shape (k, 3).
        rates: Rates of the drives, by which their distances become times, shape (3,).
    """
    rows: list[int] = []
    begin = 0
    for corner in corners[1:-1]:
        times = np.linalg.norm((places[begin:] - corner) / rates, axis=1)
        begin += int(times.argmin())
        rows.append(begin)
    return rows


def _is_apart(row: int, named: dict[int, str]) -> bool:
    """Return whether a row is far enough from those that have names."""
    return min(abs(row - other) for other in named) >= _LEAST_ROWS
