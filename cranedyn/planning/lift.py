"""A lift: from a site to a motion of the crane that is proven to touch nothing."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from cranedyn.arguments import checked
from cranedyn.arrays import finite
from cranedyn.errors import CraneError, DataError
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.planning.clearance import Clearance
from cranedyn.planning.curve import Path, leg_durations, rest_to_rest_time, rounded, straight_time
from cranedyn.planning.grid import best_on_grid
from cranedyn.planning.proof import CLOSE, SlewRange, slew_range, unproven_row
from cranedyn.planning.search import CELLS, search
from cranedyn.planning.site import Site
from cranedyn.planning.timing import RAMP, TimedMotion, timed
from cranedyn.references.limits import Limits

EXTRA = (0.1, 0.2, 0.0)
"""Room beyond what is required that a path is planned with, as far as there is a way [m]: what
averaging may take it off its curve."""

RESERVE = 1.1
"""Rate that a drive of the crane has over the largest that is planned with: what the controller
needs to make up for what is not as planned."""

_FAST = 1.15
"""A motion is fast enough, so that nothing else is tried, if it lasts no more than so many times
what the drives alone would need from start to goal if nothing stood there."""

_FINE = 0.5
"""Edge of the cells of the grid that lifts are measured against [s]."""

_TURN = 2.0 * math.pi


class NoWay(CraneError):
    """There is no way for a lift, or none was found: why."""


@dataclass(frozen=True, eq=False)
class Lift:
    """A planned lift.

    Attributes:
        clearance: Crane and site.
        limits: Of the drives.
        ends: First and last place of the load, shape (2, 3).
        slews: Slew angles through which the jib is proven to turn freely.
        path: The way that was found, with rounded corners, proven.
        timed: The motion, proven.
        extra: Room beyond what is required that the way keeps [m].
    """

    clearance: Clearance
    limits: Limits
    ends: np.ndarray
    slews: SlewRange
    path: Path
    timed: TimedMotion
    extra: float = 0.0

    @property
    def crane(self) -> Crane:
        """The crane."""
        return self.clearance.crane

    @property
    def bounds(self) -> np.ndarray:
        """Least and largest place that the search looks at, shape (2, 3)."""
        return _bounds(self.clearance, self.ends, self.slews)

    @property
    def points(self) -> np.ndarray:
        """The corners of the way, each proven to be reached from the one before, shape (n, 3)."""
        return self.path.points

    @property
    def way(self) -> float:
        """Length of the way as time at full speed [s]."""
        return float(leg_durations(self.points, np.array(self.limits.rates)).sum())

    @property
    def on_grid(self) -> float:
        """Length of the best way on a grid of cells of half a second that keeps no more room than
        required, whichever way round, as time at full speed [s].
        """
        return self._reference[0]

    @property
    def least(self) -> float:
        """Time [s] that no motion falls short of, whichever way round: each drive needs it from
        start to goal, and the quickest to full speed needs it along the best way on the grid, less
        a cell by which that may be too long.
        """
        return self._reference[1]

    @cached_property
    def _reference(self) -> tuple[float, float]:
        rates = np.array(self.limits.rates)
        ramp = rates / np.array(self.limits.accelerations)
        grid = least = math.inf
        for there in _turns(self.ends[0], self.ends[1], self.slews):
            ends = np.array([self.ends[0], there])
            straight = straight_time(ends, self.limits)
            if straight < least:
                bounds = _bounds(self.clearance, ends, self.slews)
                way = best_on_grid(self.clearance, ends, bounds, rates, cell=_FINE).duration
                along = rest_to_rest_time(np.array(way - _FINE), np.array(1.0), 1.0 / ramp.min())
                grid, least = min(grid, way), min(least, max(float(along), straight))
        return grid, least

    def states(self) -> tuple[State, State]:
        """Start and goal, at rest with the load plumb."""
        start, goal = (
            State(self.clearance.q(end), np.zeros(self.crane.layout.n)) for end in self.ends
        )
        return start, goal


@checked
def crane_of(site: Site, *, gravity: float | None = None, **values: object) -> Crane:
    """Load the crane of a site, with further numbers of it changed by name.

    Raises:
        DataError: If the site gives such a number, too.
        CraneError: As `cranedyn.model.load.load_crane`.
    """
    for name in site.crane.keys() & values.keys():
        raise DataError(f"{name} is given by the site, too; leave one out.")
    given = {**site.crane, **values}
    return load_crane(**given) if gravity is None else load_crane(gravity=gravity, **given)  # type: ignore[arg-type]


@checked
def plan_lift(
    site: Site,
    limits: Limits,
    *,
    start: np.ndarray | None = None,
    goal: np.ndarray | None = None,
    crane: Crane | None = None,
    ramp: float = RAMP,
    period: float = 5e-3,
) -> Lift:
    """Plan a lift. What it returns is proven to keep the distance of the site from everything,
    within the swing of the site.

    Args:
        site: Where it takes place.
        limits: Rates and accelerations of the drives; of the crane's own rates a plan uses ten
            elevenths at most, and leaves the rest to the controller.
        start: Centre of the load at the start, in the frame of the site [m], shape (3,); None for
            that of the site.
        goal: The same at the end.
        crane: The crane; None for that of the site.
        ramp: Time in which a drive may reach its limit of acceleration [s].
        period: Time between rows of the motion [s].

    Raises:
        NoWay: If there is no way: start or goal too near to what, the jib in the way of what,
            enclosed by what, or none found.
        OutOfRange: If the crane does not reach start or goal.
        MissingRole: If it is not a tower crane.
        Misshapen: If start or goal is no array of three numbers.
        CraneError: If there is no start or goal, the crane is none, or the extra `planning` is not
            installed.
    """
    crane = crane_of(site) if crane is None else crane
    clearance, limits = Clearance(crane, site), _with_reserve(limits.for_crane(crane), crane)
    first, last = (
        _end(clearance, what, point if point is not None else default)
        for what, point, default in (("start", start, site.start), ("goal", goal, site.goal))
    )
    slew = clearance.joints.slew
    slews = slew_range(
        clearance,
        float(first[0]),
        float(clearance.crane.lower[slew]),
        float(clearance.crane.upper[slew]),
    )
    if slews.low == slews.high:
        raise NoWay(f"At the start the jib is nearer to {slews.below} than {site.distance:g} m.")
    rates = np.array(limits.rates)
    best: Lift | None = None
    for there in _turns(first, last, slews):
        ends = np.array([first, there])
        if best is None or straight_time(ends, limits) < best.timed.motion.arrival:
            found = _way(clearance, ends, slews, rates, ramp, limits, period)
            best = (
                found
                if best is None
                or (found is not None and found.timed.motion.arrival < best.timed.motion.arrival)
                else best
            )
    if best is None:
        raise NoWay(_why(clearance, first, last, slews, rates))
    return best


def _with_reserve(limits: Limits, crane: Crane) -> Limits:
    return replace(limits, rates=np.minimum(limits.rates, crane.rate_limit / RESERVE).tolist())


def _end(clearance: Clearance, what: str, point: np.ndarray | None) -> np.ndarray:
    """The place of an end of a lift, if the load may hang there."""
    if point is None:
        raise CraneError(f"The site does not say where the {what} of the lift is; give it.")
    place = clearance.place(finite(f"{what} of the load", point, (3,), unit="m"), what)
    room, site = clearance.swing_margin(place), clearance.site
    centre = clearance.point(place)
    for solid in clearance.solids:
        if solid.holds(centre):
            raise NoWay(f"At the {what} the load is inside of {solid.name}.")
    if room < CLOSE:
        near = clearance.nearest(clearance.q(place), beside_zones=True)
        zones = [solid.name for solid in clearance.solids if solid.zone]
        asked = "kept out of" if near.obstacle in zones else f"required are {site.distance:g} m"
        raise NoWay(
            f"At the {what} the {near.body} is {max(near.distance, 0.0):.2f} m from "
            f"{near.obstacle}; {asked}, and "
            f"{clearance.envelope(float(place[2])):.2f} m for a swing of "
            f"{math.degrees(site.swing):.2g}°."
        )
    return place


def _turns(first: np.ndarray, last: np.ndarray, slews: SlewRange) -> list[np.ndarray]:
    """The goal by the slew angles at which it is reached, the two nearest ones."""
    around = [
        last[0] + k * _TURN
        for k in range(
            math.ceil((slews.low - last[0]) / _TURN), math.floor((slews.high - last[0]) / _TURN) + 1
        )
    ]
    nearest = sorted(around, key=lambda gamma: abs(gamma - first[0]))[:2]
    return [np.array([gamma, *last[1:]]) for gamma in nearest if abs(gamma - first[0]) <= _TURN]


def _bounds(clearance: Clearance, ends: np.ndarray, slews: SlewRange) -> np.ndarray:
    """Least and largest place to look at: half a turn beyond the ends, and the ranges of trolley
    and hoist.
    """
    (_, near, _), (_, far, long) = (
        one[clearance.drive_joints].tolist()
        for one in (clearance.crane.lower, clearance.crane.upper)
    )
    gammas = ends[:, 0].min() - math.pi / 2.0, ends[:, 0].max() + math.pi / 2.0
    margin = clearance.site.swing * long / near
    low = max(slews.low + min(margin, 0.1), gammas[0]) if slews.below else max(slews.low, gammas[0])
    high = (
        min(slews.high - min(margin, 0.1), gammas[1]) if slews.above else min(slews.high, gammas[1])
    )
    return np.array([[low, near, clearance.shortest_cable], [high, far, long]])


def _way(
    clearance: Clearance,
    ends: np.ndarray,
    slews: SlewRange,
    rates: np.ndarray,
    ramp: float,
    limits: Limits,
    period: float,
) -> Lift | None:
    """A lift between two places, with as much room beyond what is required as there is; None if
    none was found.
    """
    least = min(clearance.swing_margin(end) for end in ends)
    bounds = _bounds(clearance, ends, slews)
    if not ((bounds[0] <= ends).all() and (ends <= bounds[1]).all()):
        return None
    best: Lift | None = None
    for extra in EXTRA:
        if extra and least < extra + CLOSE:
            continue
        wider = clearance.with_more_distance(extra) if extra else clearance
        for points in search(wider, ends, bounds, rates):
            path = rounded(wider, points, rates)
            made = None
            if path is not None:
                made = timed(
                    clearance,
                    path,
                    limits,
                    lambda one: _proven(clearance, one, slews),
                    ramp=ramp,
                    period=period,
                )
            if path is None or made is None:
                continue
            if best is None or made.motion.arrival < best.timed.motion.arrival:
                best = Lift(clearance, limits, ends, slews, path, made, extra)
            if made.motion.arrival < _FAST * straight_time(ends, limits):
                return best
    return best


def _proven(clearance: Clearance, made: TimedMotion, slews: SlewRange) -> bool:
    """Return whether all that hangs is proven free where a motion has it, with its envelope of
    swing, all joints stay in their ranges, and the jib among the slew angles that are free.
    """
    q, slew = made.motion.q, made.motion.q[:, clearance.joints.slew]
    inside = bool((q >= clearance.crane.lower).all() and (q <= clearance.crane.upper).all())
    turns = bool(slews.low <= slew.min() and slew.max() <= slews.high)
    return (
        inside and turns and unproven_row(clearance, q, made.motion.period, swinging=True) is None
    )


def _why(
    clearance: Clearance, first: np.ndarray, last: np.ndarray, slews: SlewRange, rates: np.ndarray
) -> str:
    """Why there is no way, by a search on a grid from both ends, and by one with a load of no
    size.
    """
    turns = _turns(first, last, slews)
    if not turns:
        names = [name for name in (slews.below, slews.above) if name]
        return (
            f"The jib cannot turn to the goal: {' and '.join(names) or 'the range of the slew'} "
            "is in its way on both sides."
        )
    ends = np.array([first, turns[0]])
    bounds = _bounds(clearance, ends, slews)
    for what, pair in (("start", ends), ("goal", ends[::-1])):
        searched = best_on_grid(clearance, pair, bounds, rates, most=CELLS)
        if searched.points is None and searched.blocked:
            around = ", ".join(searched.blocked[:3])
            small = Clearance(
                clearance.crane, replace(clearance.site, load=0.01 * clearance.bodies.load)
            )
            hook = (
                ""
                if best_on_grid(small, pair, bounds, rates, most=CELLS).points is None
                else " The hook without a load could pass: every gap is narrower than the load "
                "with its distance and swing."
            )
            return (
                f"There is no way: the {what} is enclosed by {around}; {searched.reached} cells "
                f"of 1 s can be reached from it.{hook}"
            )
    return "No way was found; one on a grid exists, but no motion along it could be proven."
