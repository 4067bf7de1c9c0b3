"""Plan a lift: from a site to a motion of the crane that is proven to touch nothing.

`plan_lift` refuses first what cannot be lifted, then looks for a way both ways round the mast and
with several margins (`cranedyn.lifts.planning.path_search`), rounds its corners
(`cranedyn.lifts.planning.curve`), times it (`cranedyn.lifts.planning.timing`) and proves the motion
(`cranedyn.lifts.planning.motion_proof`). The fastest of all motions is the lift.
"""

from __future__ import annotations

import math
import pathlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from cranedyn.checks import finite
from cranedyn.errors import CraneError, DataError
from cranedyn.interfaces import State
from cranedyn.lifts.planning.clearance import Clearance
from cranedyn.lifts.planning.curve import (
    Path,
    leg_durations,
    refuse_endless,
    rest_to_rest_time,
    rounded_path,
    straight_time,
)
from cranedyn.lifts.planning.motion_proof import CLOSE, SlewRange, slew_range, unproven_row
from cranedyn.lifts.planning.path_search import CELLS, best_on_grid, search
from cranedyn.lifts.planning.plan_assumptions import held_mass
from cranedyn.lifts.planning.plausibility import findings, unusual_or_refuse
from cranedyn.lifts.planning.site import DRIVES, Site
from cranedyn.lifts.planning.standing import standing_check, standing_parts
from cranedyn.lifts.planning.timing import TimedMotion, timed
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.references.limits import Limits
from cranedyn.verdict import Verdict

EXTRA = (0.1, 0.2, 0.0)
"""Margins to plan a path with, where there is a way [m], one after the other: averaging takes a
motion off its curve, and what the curve keeps in addition is left for that."""

RESERVE = 1.1
"""Rate of a drive over the largest rate of a plan: the controller needs the rest for corrections.
"""

_LOWERING_STEP = 0.1
"""Step in which the lowest place of a load is looked for [m]."""

_RAISING_STEP = 0.05
"""Step in which a height is looked for at which a load is far enough from everything [m]."""

_FAST_ENOUGH = 1.15
"""A motion that lasts no more than so many times what the drives alone need from start to goal
without obstacles is fast enough: nothing else is tried."""

_FINE_CELL = 0.5
"""Edge of the cells of the grid that gives the least time of a lift [s]."""

_TURN = 2.0 * math.pi
"""A full turn [rad]."""

_MAX_SLEW_RESERVE = 0.1
"""Largest angle by which a way stays away from the ends of the slew range where an obstacle ends it
[rad]."""


class NoWay(CraneError):
    """There is no way for a lift, or none was found."""


class _Reference(NamedTuple):
    """What a lift is measured by; see the properties of the same names of `Lift`."""

    on_grid: float
    least: float


@dataclass(frozen=True, eq=False)
class Lift:
    """A planned lift.

    Attributes:
        clearance: Crane and site.
        limits: Limits of the drives.
        ends: First and last place of the load, shape (2, 3).
        slews: Slew angles through which the jib is proven to turn freely.
        path: The way with rounded corners, proven.
        timed: The motion, proven.
    """

    clearance: Clearance
    limits: Limits
    ends: np.ndarray
    slews: SlewRange
    path: Path
    timed: TimedMotion

    @property
    def crane(self) -> Crane:
        """The crane."""
        return self.clearance.crane

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
        """Length of the best way on a grid of cells of half a second with the required distance,
        whichever way round, as time at full speed [s].
        """
        return self._reference.on_grid

    @property
    def least(self) -> float:
        """Lower bound of the time of a motion [s], whichever way round: each drive needs it from
        start to goal, and the quickest to full speed needs it along the best way on the grid, less
        a cell by which that may be too long.
        """
        return self._reference.least

    @cached_property
    def _reference(self) -> _Reference:
        rates = np.array(self.limits.rates)
        # Time to full speed of the drive that reaches it first. In the time at full speed a way is
        # gone along at the rate 1, which is reached with the acceleration 1/ramp.
        ramp = (rates / np.array(self.limits.accelerations)).min()
        on_grid = math.inf
        least = math.inf
        for ends in _turns(self.ends[0], self.ends[1], self.slews):
            straight = straight_time(ends, self.limits)
            if straight >= least:
                continue  # no way in this direction is faster
            bounds = _bounds(self.clearance, ends, self.slews)
            grid = best_on_grid(self.clearance, ends, bounds, rates, cell=_FINE_CELL)
            shortest_way = np.array(grid.duration - _FINE_CELL)
            along = rest_to_rest_time(shortest_way, np.array(1.0), 1.0 / ramp)
            on_grid = min(on_grid, grid.duration)
            least = min(least, max(float(along), straight))
        return _Reference(on_grid, least)

    def states(self) -> tuple[State, State]:
        """Return start and goal, at rest with the load plumb."""
        at_rest = np.zeros(self.crane.layout.n)
        start = State(self.clearance.q(self.ends[0]), at_rest)
        goal = State(self.clearance.q(self.ends[1]), at_rest)
        return start, goal


def crane_of(
    site: Site,
    *,
    gravity: float | None = None,
    urdf: str | pathlib.Path | None = None,
    **values: object,
) -> Crane:
    """Load the crane of a site, from another file or with further values changed by name.

    A file other than a ``.xacro`` has no arguments: its own numbers hold, and those that the site
    enters must be the same.

    Raises:
        DataError: If the site gives such a value, too, or enters a number that is another in the
            file, or that cannot be compared with it.
        CraneError: As `cranedyn.model.load.load_crane`.
    """
    for name in site.crane.keys() & values.keys():
        raise DataError(f"{name} is given by the site, too; leave one out.")
    if urdf is None or pathlib.Path(urdf).suffix == ".xacro":
        return load_crane(urdf, gravity=gravity, values={**site.crane, **values})
    crane = load_crane(urdf, gravity=gravity, values=values)
    for name in site.crane:
        if name not in _COMPARED_ARGUMENTS:
            raise DataError(
                f"The site enters {name}, an argument that {urdf} does not have, since it is no "
                ".xacro file; leave it out of the site, or give the crane as a .xacro file."
            )
    refuse_contradictions(site, crane)
    return crane


_COMPARED_ARGUMENTS = {
    "payload_mass",
    "slew_effort",
    "trolley_effort",
    "hoist_effort",
    "counter_jib",
}
"""Arguments that a site may enter for a crane whose description has no arguments: they are compared
with the description itself, the counter-jib with its shapes
(`cranedyn.lifts.judging.lift_checks`)."""


def plan_lift(
    site: Site,
    limits: Limits,
    *,
    start: np.ndarray | None = None,
    goal: np.ndarray | None = None,
    crane: Crane | None = None,
    period: float = 5e-3,
) -> Lift:
    """Plan a lift that is proven to keep the distance of the site from every obstacle, within the
    swing of the site.

    Args:
        site: The site.
        limits: Rates and accelerations of the drives; of the crane's own rates a plan uses ten
            elevenths at most, and leaves the rest to the controller.
        start: Centre of the load at the start, in the frame of the site [m], shape (3,), or shape
            (2,) for as low as it can hang there; None for that of the site.
        goal: The same at the end.
        crane: The crane; None for that of the site.
        period: Time between rows of the motion [s].

    Raises:
        NoWay: If there is no way, with the reason: the crane stands in an obstacle, the load is too
            heavy for the hoist, start or goal too close to an obstacle, an obstacle in the way of
            the jib, an end that is enclosed, or none found.
        OutOfRange: If the crane does not reach start or goal, or its drives are so slow that the
            lift would take longer than `cranedyn.lifts.planning.curve.LONGEST_LIFT`.
        DataError: If a value of the site, the start or the goal cannot be meant, see
            `cranedyn.lifts.planning.plausibility`.
        MissingRole: If it is not a tower crane.
        Misshapen: If start or goal is no array of two or three numbers.
        CraneError: If there is no start or goal, the crane is none, or the extra `planning` is not
            installed.
    """
    if crane is None:
        crane = crane_of(site)
    refuse_contradictions(site, crane)
    limits = _planned_limits(crane, limits)
    clearance = Clearance(crane, site)
    start = site.start if start is None else start
    goal = site.goal if goal is None else goal
    _refuse_implausible(clearance, start, goal)
    _refuse_unless_it_stands(clearance)
    _refuse_unless_it_holds(crane)
    first = _end(clearance, "start", start)
    last = _end(clearance, "goal", goal)
    if np.allclose(first, last, atol=1e-6):
        place = np.round(np.asarray(goal), 3).tolist()
        raise NoWay(f"Start and goal of the lift are the same place, {place}; give another goal.")
    slews = _free_slews(clearance, float(first[0]))
    lifts: list[Lift] = []
    for ends in _turns(first, last, slews):
        straight = straight_time(ends, limits)
        refuse_endless(straight, limits)
        shortest = min((lift.timed.motion.arrival for lift in lifts), default=math.inf)
        if straight < shortest:
            lifts += _candidates(clearance, ends, slews, limits, period, shortest)
    if not lifts:
        raise NoWay(_reason(clearance, first, last, slews, np.array(limits.rates)))
    return min(lifts, key=lambda lift: lift.timed.motion.arrival)


def _planned_limits(crane: Crane, limits: Limits) -> Limits:
    """Return the limits to plan with: those given, and of the crane's own rates no more than what
    `RESERVE` leaves.
    """
    limits = limits.for_crane(crane)
    rates = np.minimum(limits.rates, crane.rate_limit / RESERVE)
    return replace(limits, rates=rates.tolist())


def _free_slews(clearance: Clearance, gamma: float) -> SlewRange:
    """Return the slew angles that the jib is proven to reach from an angle [rad].

    Raises:
        NoWay: If the jib is too close to an obstacle there.
    """
    crane = clearance.crane
    slew = clearance.joints.slew
    slews = slew_range(clearance, gamma, float(crane.lower[slew]), float(crane.upper[slew]))
    if slews.low == slews.high:
        raise NoWay(
            f"At the start the jib is nearer to {slews.below} than {clearance.site.distance:g} m, "
            "the distance to keep; move the start round the mast, or the crane away from it."
        )
    return slews


def refuse_contradictions(site: Site, crane: Crane) -> None:
    """Refuse a crane that is not the one that its site enters.

    Raises:
        DataError: If a value of the site is another for the crane.
    """
    arguments = crane.record.get("arguments")
    if isinstance(arguments, dict):
        for name, value in site.crane.items():
            if name in arguments and float(arguments[name]) != float(value):
                raise DataError(
                    f"The site enters {name} {value:g}; the crane has {arguments[name]}. Load the "
                    "crane with the value of the site, or change it there."
                )
        return
    # Any other description has no values by name. What it says itself is compared.
    for name, (actual, unit) in _numbers_by_argument(crane).items():
        entered = site.crane.get(name)
        if entered is not None and not math.isclose(float(entered), actual, rel_tol=1e-9):
            raise DataError(
                f"The site enters {float(entered):,.6g} {unit} as {name}; the description of the "
                f"crane has {actual:,.6g} {unit}. Change one of them."
            )


def _numbers_by_argument(crane: Crane) -> dict[str, tuple[float, str]]:
    """Return the numbers of a crane, with units, that a site may enter as arguments of the tower
    crane of this project.
    """
    layout = crane.layout
    numbers = {"payload_mass": (crane.payload_mass, "kg")}
    for role in DRIVES:
        drive = layout.drive_of(role)
        if drive is not None:
            unit = layout.driven[drive].effort_unit
            numbers[f"{role}_effort"] = (float(crane.effort_limit[drive]), unit)
    return numbers


def _refuse_implausible(
    clearance: Clearance, start: np.ndarray | None, goal: np.ndarray | None
) -> None:
    """Refuse values of a site, and ends of a lift, that cannot be meant.

    Raises:
        DataError: With the value and the mistake that is likely.
    """

    def judged(point: np.ndarray | None) -> np.ndarray | None:
        # What has another shape is refused with its shape, see `_end`.
        return None if point is None or np.shape(point) not in ((2,), (3,)) else point

    site = replace(clearance.site, start=judged(start), goal=judged(goal))
    trolley = clearance.joints.trolley
    reach = float(clearance.crane.lower[trolley]), float(clearance.crane.upper[trolley])
    unusual_or_refuse(findings(site, reach))


def _refuse_unless_it_stands(clearance: Clearance) -> None:
    """Refuse a site whose crane stands in an obstacle.

    Raises:
        NoWay: With the obstacle.
    """
    check = standing_check(standing_parts(clearance))
    if check.verdict is not Verdict.HOLDS:
        raise NoWay(check.sentence)


def _refuse_unless_it_holds(crane: Crane) -> None:
    """Refuse a load that the hoist cannot hold, before a way is searched for it.

    Raises:
        NoWay: With both masses.
    """
    hoist = crane.layout.drive("l")
    held = float(crane.effort_limit[hoist]) / crane.gravity
    load = held_mass(crane)
    if not load <= held:
        raise NoWay(
            f"The hoist holds {held:,.0f} kg; the load with rigging is {load:,.0f} kg. Take a "
            "lighter load, or enter the force of the hoist as the last of efforts in [drives]."
        )


def _end(clearance: Clearance, name: str, point: np.ndarray | None) -> np.ndarray:
    """Return the place of an end of a lift, if the load may hang there.

    Args:
        clearance: Crane and site.
        name: "start" or "goal".
        point: Centre of the load in the frame of the site [m], shape (3,), or shape (2,) for as low
            as it can hang there; None if it is not given.

    Raises:
        CraneError: If it is not given.
        Misshapen: If it is no array of two or three numbers.
        OutOfRange: If the crane does not reach it.
        NoWay: If the load is too close to an obstacle, or inside of one.
    """
    if point is None:
        field, option = ("from", "--from") if name == "start" else ("to", "--to")
        raise CraneError(
            f"The site does not say where the {name} of the lift is; give {field} in [lift], or "
            f"{option}."
        )
    label = f"{name} of the load"
    if np.shape(point) == (2,):
        drive_position = _lowest(clearance, finite(label, point, (2,), unit="m"), name)
    else:
        drive_position = clearance.place(finite(label, point, (3,), unit="m"), name)
    centre = clearance.point(drive_position)
    # Surfaces of triangles are hollow: a load inside of one has a distance from it.
    for solid in clearance.solids:
        if solid.holds(centre):
            raise NoWay(
                f"At the {name} the load is inside of {solid.name}; move the {name} out of it."
            )
    if not clearance.swing_margin(drive_position) >= CLOSE:
        raise NoWay(_too_close(clearance, name, drive_position))
    return drive_position


def _too_close(clearance: Clearance, name: str, drive_position: np.ndarray) -> str:
    """Return a sentence that at an end of a lift the load is too close to an obstacle, and what to
    do.
    """
    site = clearance.site
    nearest = clearance.nearest(clearance.q(drive_position), beside_zones=True)
    zones = [solid.name for solid in clearance.solids if solid.zone]
    rule = "kept out of" if nearest.obstacle in zones else f"required are {site.distance:g} m"
    envelope = clearance.envelope(float(drive_position[2]))
    return (
        f"At the {name} the {nearest.body} is {max(nearest.distance, 0.0):.2f} m from "
        f"{nearest.obstacle}; {rule}, and {envelope:.2f} m for a swing of "
        f"{math.degrees(site.swing):.2g}°. {_advice(clearance, name, drive_position)}"
    )


def _advice(clearance: Clearance, name: str, drive_position: np.ndarray) -> str:
    """Return what to change of an end of a lift at which the load is too near to something: how far
    to raise it, if that is enough.
    """
    foot = float(clearance.site.foot[2])
    lengths = np.arange(drive_position[2], clearance.shortest_cable, -_RAISING_STEP)
    for length in lengths[1:]:
        higher = np.array([*drive_position[:2], length])
        if clearance.swing_margin(higher) >= CLOSE:
            now = foot + clearance.height - float(drive_position[2])
            then = foot + clearance.height - length
            # Rounded up: a height that is rounded down would be too low again.
            return (
                f"Raise the {name} from z = {now:.2f} m to {math.ceil(10.0 * then) / 10.0:.1f} m."
            )
    return (
        f"No height above it is far enough; move the {name} aside, or allow a smaller distance or "
        "swing in [lift]."
    )


def _lowest(clearance: Clearance, point: np.ndarray, name: str) -> np.ndarray:
    """Return the place down to which the load can hang with its swing and the margins of `EXTRA`,
    above a point [m], shape (2,).
    """
    top = float(clearance.site.foot[2]) + clearance.height - clearance.shortest_cable - CLOSE
    place = clearance.place(np.array([*point, top]), name)
    longest = float(clearance.crane.upper[clearance.joints.hoist])
    for length in np.arange(place[2], longest, _LOWERING_STEP):
        lower = np.array([*place[:2], length])
        if not clearance.swing_margin(lower) >= max(EXTRA) + CLOSE:
            break
        place = lower
    return place


def _turns(first: np.ndarray, last: np.ndarray, slews: SlewRange) -> list[np.ndarray]:
    """Return start and goal, shape (2, 3), by the two nearest slew angles that reach the goal: the
    ways to it in both directions round the mast, as far as the jib can turn. No way is longer than
    a full turn.
    """
    start_angle = first[0]
    goal_angle = last[0]
    fewest_turns = math.ceil((slews.low - goal_angle) / _TURN)
    most_turns = math.floor((slews.high - goal_angle) / _TURN)
    angles = [goal_angle + k * _TURN for k in range(fewest_turns, most_turns + 1)]
    angles.sort(key=lambda gamma: abs(gamma - start_angle))
    ends = []
    for gamma in angles[:2]:
        if abs(gamma - start_angle) <= _TURN:
            ends.append(np.array([first, [gamma, *last[1:]]]))
    return ends


def _bounds(clearance: Clearance, ends: np.ndarray, slews: SlewRange) -> np.ndarray:
    """Return the least and largest place of the search: a quarter turn beyond the ends, and the
    ranges of trolley and hoist.
    """
    lower = clearance.crane.lower[clearance.drive_joints]
    upper = clearance.crane.upper[clearance.drive_joints]
    _, inner, _ = lower.tolist()
    _, outer, longest = upper.tolist()

    # Where the jib is stopped by an obstacle, the way stays away from the end of the slew range:
    # the pivot of a load that swings is beside it by the swing times the cable length, which is the
    # larger an angle the nearer the trolley is to the mast.
    away = min(clearance.site.swing * longest / max(inner, 1e-3), _MAX_SLEW_RESERVE)
    lowest_slew = slews.low + away if slews.below else slews.low
    highest_slew = slews.high - away if slews.above else slews.high
    low = max(lowest_slew, ends[:, 0].min() - math.pi / 2.0)
    high = min(highest_slew, ends[:, 0].max() + math.pi / 2.0)
    return np.array([[low, inner, clearance.shortest_cable], [high, outer, longest]])


def _candidates(
    clearance: Clearance,
    ends: np.ndarray,
    slews: SlewRange,
    limits: Limits,
    period: float,
    shortest: float,
) -> Iterator[Lift]:
    """Yield lifts between two places with margins of `EXTRA`, until one is fast enough; those that
    last longer than the shortest so far may be left out.

    Args:
        clearance: Crane and site.
        ends: First and last place, shape (2, 3).
        slews: Slew angles through which the jib turns freely.
        limits: Limits of the drives.
        period: Time between rows of a motion [s].
        shortest: Duration of the shortest lift so far [s].
    """
    bounds = _bounds(clearance, ends, slews)
    rates = np.array(limits.rates)
    if not ((bounds[0] <= ends).all() and (ends <= bounds[1]).all()):
        return

    def proven(candidate: TimedMotion) -> bool:
        return _is_proven(clearance, slews, candidate)

    end_margin = min(clearance.swing_margin(end) for end in ends)
    tried_straight = False
    for extra in EXTRA:
        if extra and end_margin < extra + CLOSE:
            continue
        wider = clearance.with_more_distance(extra) if extra else clearance
        for points in search(wider, ends, bounds, rates):
            is_straight = len(points) == 2
            if is_straight and tried_straight:
                continue  # the same with any margin
            tried_straight = tried_straight or is_straight
            path = rounded_path(wider, points, rates)
            if path is None:
                continue
            motion = timed(clearance, path, limits, proven, within=shortest, period=period)
            if motion is None:
                continue
            shortest = min(shortest, motion.motion.arrival)
            yield Lift(clearance, limits, ends, slews, path, motion)
            if motion.motion.arrival < _FAST_ENOUGH * straight_time(ends, limits):
                return


def _is_proven(clearance: Clearance, slews: SlewRange, timed: TimedMotion) -> bool:
    """Return whether all that hangs is proven free along a motion, with its envelope of swing, all
    joints stay in their ranges, and the jib in the slew angles that are free.
    """
    motion = timed.motion
    q = motion.q
    slew = q[:, clearance.joints.slew]
    in_ranges = bool((q >= clearance.crane.lower).all() and (q <= clearance.crane.upper).all())
    jib_is_free = bool(slews.low <= slew.min() and slew.max() <= slews.high)
    if not (in_ranges and jib_is_free):
        return False
    envelope = clearance.envelope(q[:, clearance.joints.hoist])
    return unproven_row(clearance, q, motion.period, envelope=envelope) is None


def _reason(
    clearance: Clearance, first: np.ndarray, last: np.ndarray, slews: SlewRange, rates: np.ndarray
) -> str:
    """Return why there is no way, by a search on a grid from both ends, and by one with a load of
    no size.
    """
    turns = _turns(first, last, slews)
    if not turns:
        names = [name for name in (slews.below, slews.above) if name]
        return (
            f"The jib cannot turn to the goal: {' and '.join(names) or 'the range of the slew'} "
            "is in its way on both sides."
        )
    ends = turns[0]
    bounds = _bounds(clearance, ends, slews)
    for end_name, pair in (("start", ends), ("goal", ends[::-1])):
        result = best_on_grid(clearance, pair, bounds, rates, cell_limit=CELLS)
        if result.points is None and result.reached >= CELLS:
            # The search has given up, which proves nothing.
            near = f"; near are {', '.join(result.blocked[:3])}" if result.blocked else ""
            return (
                f"No way was found among {result.reached} cells of 1 s from the {end_name}{near}. "
                "Whether there is one is not known."
            )
        if result.points is None and result.blocked:
            hook = ""
            if _small_load_passes(clearance, pair, bounds, rates):
                hook = (
                    " The hook without a load could pass: every gap is narrower than the load "
                    "with its distance and swing."
                )
            return (
                f"There is no way: the {end_name} is enclosed by {', '.join(result.blocked[:3])}; "
                f"{result.reached} cells of 1 s can be reached from it.{hook}"
            )
    return (
        "No way was found: one on a grid of cells exists, but no motion along it could be proven. "
        "A smaller swing or distance in [lift], or slower [drives], leave more "
        "room."
    )


def _small_load_passes(
    clearance: Clearance, ends: np.ndarray, bounds: np.ndarray, rates: np.ndarray
) -> bool:
    """Return whether there is a way on the grid for a load of a hundredth of the size."""
    site = replace(clearance.site, load=0.01 * clearance.bodies.load)
    small = Clearance(clearance.crane, site)
    return best_on_grid(small, ends, bounds, rates, cell_limit=CELLS).points is not None
