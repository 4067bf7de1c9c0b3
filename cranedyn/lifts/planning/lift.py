"""Plan a lift: from a site to a motion of the crane that is proven to touch nothing.

`plan_lift` refuses first what cannot be lifted. In both directions round the mast and with several
margins it searches a *way*, straight lines between places (`cranedyn.lifts.planning.path_search`),
rounds its corners to a *path* (`cranedyn.lifts.planning.curve`), times that to a *motion*
(`cranedyn.lifts.planning.timing`) and proves the motion (`cranedyn.lifts.planning.motion_proof`).
The fastest of all motions is the lift.
"""

from __future__ import annotations

import math
import pathlib
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from cranedyn.checks import finite
from cranedyn.errors import CraneError, DataError, UnknownName
from cranedyn.interfaces import State
from cranedyn.lifts.planning.clearance import ROUNDING, Clearance
from cranedyn.lifts.planning.clearance_of import clearance_of
from cranedyn.lifts.planning.curve import (
    Path,
    leg_durations,
    refuse_endless,
    rest_to_rest_time,
    rounded_path,
    straight_time,
)
from cranedyn.lifts.planning.motion_proof import PROOF_MARGIN, SlewRange, slew_range, unproven_row
from cranedyn.lifts.planning.path_search import MAX_CELLS, best_on_grid, search
from cranedyn.lifts.planning.plan_assumptions import held_mass, winch_of
from cranedyn.lifts.planning.plausibility import findings, unusual_or_refuse
from cranedyn.lifts.planning.site import Site
from cranedyn.lifts.planning.standing import standing_check, standing_parts
from cranedyn.lifts.planning.timing import TimedMotion, timed
from cranedyn.lifts.planning.tower_clearance import TowerClearance
from cranedyn.model.crane import Crane
from cranedyn.model.description import arguments
from cranedyn.model.load import load_crane
from cranedyn.references.limits import Limits
from cranedyn.verdict import Verdict

EXTRA = (0.1, 0.2, 0.0)
"""Distances that a path keeps beyond the required one [m], tried one after the other. A motion
leaves its path a little, since it is averaged over time, and has this distance left for that."""

RESERVE = 1.1
"""Ratio of the rate of a drive to the largest rate of a plan. The controller needs the difference
for corrections."""

_LOWERING_STEP = 0.1
"""Step by which a load is lowered in the search for its lowest place [m]."""

_RAISING_STEP = 0.05
"""Step by which a load is raised in the search for a height that is far enough from everything [m].
"""

_FAST_ENOUGH = 1.15
"""Ratio of the duration of a motion to the time that the drives alone need from start to goal
without obstacles. A motion below it is fast enough, and no other one is tried."""

_FINE_CELL = 0.5
"""Edge of the cells of the grid on which the least time of a lift is estimated [s]."""

_TURN = 2.0 * math.pi
"""A full turn [rad]."""

_MAX_SLEW_RESERVE = 0.1
"""Largest angle by which a way stays away from an end of the slew range at which an obstacle stops
the jib [rad]."""

_SMALL_LOAD_SCALE = 0.01
"""Ratio of the size of a load that nearly is a point to that of the load of a site."""

_ARGUMENT_AS_DEFAULT = re.compile(r"\$\(arg (?P<name>\w+)\)")
"""Default of an argument of a xacro file that is another argument."""


class NoWay(CraneError):
    """There is no way for a lift, or none was found."""


class _ReferenceTimes(NamedTuple):
    """Times that a lift is compared with; see the properties of the same names of `Lift`."""

    grid_duration: float
    least_duration: float


@dataclass(frozen=True, eq=False)
class Lift:
    """A planned lift.

    Attributes:
        clearance: Crane and site.
        limits: Limits of the drives.
        ends: First and last place of the load, shape (2, 3).
        slews: Slew angles through which the jib is proven to turn freely.
        path: The way with rounded corners, proven free.
        timed: The motion along the path, proven free.
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
    def way_duration(self) -> float:
        """Length of the way, as time at full speed [s]."""
        return float(leg_durations(self.points, np.array(self.limits.rates)).sum())

    @property
    def grid_duration(self) -> float:
        """Length of the best way on a grid of cells of half a second with the required distance,
        the shorter one of both directions round the mast, as time at full speed [s]. It is infinite
        if the search finds none.
        """
        return self._reference_times.grid_duration

    @property
    def least_duration(self) -> float:
        """Estimate of the time that no motion falls below [s], in whichever direction round the
        mast.

        Each drive needs its time from start to goal, which is a bound. Obstacles make it longer:
        the drive that is first at full speed needs its time along the best way on the grid, less a
        cell. That no way between the cells is shorter than this is assumed and not proven. A
        direction whose grid is too large to be searched counts with the time of the drives.
        """
        return self._reference_times.least_duration

    @cached_property
    def _reference_times(self) -> _ReferenceTimes:
        """Length of the best way on a grid, and the estimate of the least time that follows."""
        rates = np.array(self.limits.rates)
        # The drive that is first at full speed takes this time to it. A way is measured in seconds
        # at full speed: the rate is 1, and the acceleration to it 1/ramp.
        ramp = (rates / np.array(self.limits.accelerations)).min()
        grid_duration = math.inf
        least = math.inf
        turning = self.clearance.turning
        both_ways = _ends_both_ways(self.ends[0], self.ends[1], turning, self.slews)
        for ends in both_ways:
            straight = straight_time(ends, self.limits)
            if straight >= least:
                continue  # no way in this direction is faster
            bounds = _bounds(self.clearance, ends, self.slews)
            grid = best_on_grid(self.clearance, ends, bounds, rates, cell=_FINE_CELL)
            grid_duration = min(grid_duration, grid.duration)
            if grid.gave_up:
                least = min(least, straight)
                continue
            shortest_way = np.array(max(grid.duration - _FINE_CELL, 0.0))
            along_way = rest_to_rest_time(shortest_way, np.array(1.0), 1.0 / ramp)
            least = min(least, max(float(along_way), straight))
        if least == math.inf:  # this lift goes between the cells
            least = min(straight_time(ends, self.limits) for ends in both_ways)
        return _ReferenceTimes(grid_duration, least)

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

    The crane is that which the site describes, or else the tower crane of this project.

    A file other than a ``.xacro`` has no arguments: its own numbers hold, and those that the site
    enters must be the same.

    Raises:
        DataError: If the site gives such a value, too, or enters a number that is another in the
            file, or that cannot be compared with it.
        CraneError: As `cranedyn.model.load.load_crane`.
    """
    for name in site.crane.keys() & values.keys():
        raise DataError(f"{name} is given by the site, too; leave one out.")
    described = site.description
    if described is not None and urdf is not None:
        raise DataError(f"The site says which crane it is ([crane]); leave {urdf} out.")
    if described is not None and described.file is not None:
        urdf = described.file
        crane = described.load(values, gravity)
    elif described is not None:
        return described.load({**site.crane, **values}, gravity)
    elif urdf is None or pathlib.Path(urdf).suffix == ".xacro":
        return load_crane(urdf, gravity=gravity, values={**site.crane, **values})
    else:
        crane = load_crane(urdf, gravity=gravity, values=values)
    # A description without arguments: what the site enters is compared with it, the counter-jib
    # with its shapes (`cranedyn.lifts.judging.lift_checks`).
    for name in site.crane.keys() - _numbers_by_argument(crane).keys() - {"counter_jib"}:
        raise DataError(
            f"The site enters {name}, an argument that {urdf} does not have, since it is no "
            ".xacro file; leave it out of the site, or give the crane as a .xacro file."
        )
    refuse_contradictions(site, crane)
    return crane


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
        NoWay: If there is no way, or none was found, with the reason: the crane stands in an
            obstacle, the load is too heavy for the hoist, start or goal are too close to an
            obstacle, an obstacle is in the way of the jib, or an end is enclosed.
        OutOfRange: If the crane does not reach start or goal, or its drives are so slow that the
            lift would take longer than `cranedyn.lifts.planning.curve.LONGEST_LIFT`.
        DataError: If a value of the site, the start or the goal cannot be meant, see
            `cranedyn.lifts.planning.plausibility`.
        ModelError: If its joints are others than a planned lift needs, see
            `cranedyn.lifts.planning.clearance_of.clearance_of`.
        Misshapen: If start or goal is no array of two or three numbers.
        CraneError: If there is no start or goal, the values of the site make no crane, or the extra
            `planning` is not installed.
    """
    if crane is None:
        crane = crane_of(site)
    refuse_contradictions(site, crane)
    limits = _planned_limits(crane, limits)
    clearance = clearance_of(crane, site)
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
    slews = _free_slews(clearance, first)
    lifts: list[Lift] = []
    for ends in _ends_both_ways(first, last, clearance.turning, slews):
        straight = straight_time(ends, limits)
        if not lifts:
            # Once there is a lift, a direction that takes too long is no reason to refuse it.
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


def _free_slews(clearance: Clearance, first: np.ndarray) -> SlewRange:
    """Return the slew angles that the jib is proven to reach from a place. Where the jib is proven
    together with what hangs, these are the range of the joint.

    Raises:
        NoWay: If the jib is too close to an obstacle there.
    """
    crane = clearance.crane
    if clearance.turning is None:
        return SlewRange(-math.inf, math.inf, "", "")
    slew = clearance.drive_joints[clearance.turning]
    low = float(crane.lower[slew])
    high = float(crane.upper[slew])
    if not isinstance(clearance, TowerClearance):
        return SlewRange(low, high, "", "")
    slews = slew_range(clearance, float(first[clearance.turning]), low, high)
    if slews.low == slews.high:
        # Where the start is at an end of the joint's range, only the other end names an obstacle.
        obstacle = slews.below or slews.above
        raise NoWay(
            f"At the start the jib is nearer to {obstacle} than {clearance.site.distance:g} m, "
            "the distance to keep; move the start round the mast, or the crane away from it."
        )
    return slews


def refuse_contradictions(site: Site, crane: Crane) -> None:
    """Refuse a crane that is not the one that its site enters.

    Raises:
        DataError: If a value of the site is another for the crane.
        UnknownName: If the tower crane of this project has no argument of that name.
    """
    for name, entered in site.crane.items():
        known = _value_of(crane, name)
        if known is not None and not math.isclose(float(entered), known.value, rel_tol=1e-9):
            raise DataError(
                f"The site enters {float(entered):,.6g} {known.unit} as {name}; the crane has "
                f"{known.value:,.6g} {known.unit}. Load the crane with the value of the site, or "
                "change one of them."
            )


class _Quantity(NamedTuple):
    """A number of a crane with its unit."""

    value: float
    unit: str


def _value_of(crane: Crane, name: str) -> _Quantity | None:
    """Return what a crane has for an argument of the tower crane of this project: what its model
    says, else what it was loaded with, else the default of the argument. None for a crane of
    another description, whose model does not say it either.

    Raises:
        UnknownName: If the tower crane of this project has no such argument.
    """
    of_model = _numbers_by_argument(crane)
    if name in of_model:
        return of_model[name]
    loaded_with = crane.record.get("arguments")
    if not isinstance(loaded_with, dict):
        return None
    declared = arguments()
    if name not in declared:
        raise UnknownName("argument", name, declared)
    if name in loaded_with:
        return _Quantity(float(loaded_with[name]), declared[name].unit)
    default = declared[name].default
    # The default of an argument may be another argument, as that of payload_ixx.
    other = _ARGUMENT_AS_DEFAULT.fullmatch(default)
    if other is not None:
        return _value_of(crane, other["name"])
    return _Quantity(float(default), declared[name].unit)


def _numbers_by_argument(crane: Crane) -> dict[str, _Quantity]:
    """Return the numbers of a model that a site may enter as arguments of a crane, whatever
    description it was loaded from: the mass of the load, and the largest effort of each drive.
    """
    numbers = {"payload_mass": _Quantity(crane.payload_mass, "kg")}
    for joint, effort in zip(crane.layout.driven, crane.effort_limit.tolist(), strict=True):
        name = joint.role or joint.symbol
        numbers[f"{name}_effort"] = _Quantity(effort, joint.effort_unit)
    return numbers


def _refuse_implausible(
    clearance: Clearance, start: np.ndarray | None, goal: np.ndarray | None
) -> None:
    """Refuse values of a site, and ends of a lift, that cannot be meant.

    Raises:
        DataError: With the value and the mistake that is likely.
    """

    def only_if_point(end: np.ndarray | None) -> np.ndarray | None:
        # An array of another shape is refused by `_end`, which names its shape.
        return end if end is not None and np.shape(end) in ((2,), (3,)) else None

    site = replace(clearance.site, start=only_if_point(start), goal=only_if_point(goal))
    unusual_or_refuse(findings(site, clearance.reach))


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
    hoist = winch_of(crane)
    largest_mass = float(crane.effort_limit[hoist]) / crane.gravity
    load = held_mass(crane)
    if not load <= largest_mass:
        raise NoWay(
            f"The hoist holds {largest_mass:,.0f} kg; the load with rigging is {load:,.0f} kg. "
            "Take a lighter load, or enter the force of the hoist as the last of efforts in "
            "[drives]."
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
        if solid.surface_encloses(centre):
            raise NoWay(
                f"At the {name} the load is inside of {solid.name}; move the {name} out of it."
            )
    if not clearance.swing_margin(drive_position) >= PROOF_MARGIN:
        raise NoWay(_too_close(clearance, name, drive_position))
    return drive_position


def _too_close(clearance: Clearance, name: str, drive_position: np.ndarray) -> str:
    """Return a sentence that at an end of a lift the load is too close to an obstacle, and what to
    do.
    """
    site = clearance.site
    q = clearance.q(drive_position)
    nearest = clearance.nearest(q, count_zones=True)
    zones = [solid.name for solid in clearance.solids if solid.zone]
    envelope = (
        f"{clearance.envelope(float(clearance.cable(q))):.2f} m for a swing of "
        f"{math.degrees(site.swing):.2g}°"
    )
    if nearest.obstacle in zones:
        rule = f"it must keep out of it, with {envelope}"
    else:
        rule = f"it must keep {site.distance:g} m, and {envelope} more"
    return (
        f"At the {name} the {nearest.body} is {max(nearest.distance, 0.0):.2f} m from "
        f"{nearest.obstacle}; {rule}. {_advice(clearance, name, drive_position)}"
    )


def _advice(clearance: Clearance, name: str, drive_position: np.ndarray) -> str:
    """Return what to change of an end of a lift at which the load is too near to something: how far
    to raise it, if that is enough.
    """
    foot = float(clearance.site.foot[2])
    lengths = np.arange(drive_position[2], clearance.shortest_cable, -_RAISING_STEP)
    for length in lengths[1:]:
        higher = np.array([*drive_position[:2], length])
        if clearance.swing_margin(higher) >= PROOF_MARGIN:
            now = foot + float(clearance.point(drive_position)[2])
            then = foot + float(clearance.point(higher)[2])
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

    The search goes down from the shortest cable as far as the load comes to nothing of the site. Up
    there a load hangs beside the head of a boom, so that the crane itself is no reason to stop: the
    load may be too near to its own boom at first, and far enough from it farther down.
    """
    place = clearance.highest_place(point, name, PROOF_MARGIN)
    longest = float(clearance.crane.upper[clearance.hoist])
    for length in np.arange(place[2], longest, _LOWERING_STEP):
        lower = np.array([*place[:2], length])
        if clearance.swing_margin(lower) >= max(EXTRA) + PROOF_MARGIN:
            place = lower
        elif _is_near_site(clearance, lower):
            break
    return place


def _is_near_site(clearance: Clearance, place: np.ndarray) -> bool:
    """Return whether what hangs at a place is nearer than the margins of `EXTRA` to something that
    is no part of the crane.
    """
    q = clearance.q(place)
    needed = max(EXTRA) + PROOF_MARGIN + ROUNDING + clearance.envelope(float(clearance.cable(q)))
    zones = {solid.name for solid in clearance.solids if solid.zone}
    for pair in clearance.distances(q, jib=False).values():
        required = 0.0 if pair.obstacle in zones else clearance.site.distance
        if not pair.is_own and not pair.distance - required >= needed:
            return True
    return False


def _ends_both_ways(
    first: np.ndarray, last: np.ndarray, turning: int | None, slews: SlewRange
) -> list[np.ndarray]:
    """Return start and goal, shape (2, 3), in both directions round the mast as far as the jib can
    turn, the nearer one first.

    Angles of slew a full turn apart are one direction of the jib. The two nearest of those that
    point to the goal are the ends of both ways; no way is longer than a full turn. A crane that
    does not turn has one way.

    Args:
        first: Place of the start, shape (3,).
        last: Place of the goal, shape (3,).
        turning: Index of the drive that turns the crane; None if there is none.
        slews: Its free angles.
    """
    if turning is None:
        return [np.array([first, last])]
    start_angle = first[turning]
    goal_angle = last[turning]
    fewest_turns = math.ceil((slews.low - goal_angle) / _TURN)
    most_turns = math.floor((slews.high - goal_angle) / _TURN)
    angles = [goal_angle + k * _TURN for k in range(fewest_turns, most_turns + 1)]
    angles.sort(key=lambda gamma: abs(gamma - start_angle))
    ends = []
    for gamma in angles[:2]:
        if abs(gamma - start_angle) <= _TURN:
            goal = last.copy()
            goal[turning] = gamma
            ends.append(np.array([first, goal]))
    return ends


def _bounds(clearance: Clearance, ends: np.ndarray, slews: SlewRange) -> np.ndarray:
    """Return the least and largest place of the search, shape (2, 3): the ranges of the drives, and
    of the drive that turns the crane up to a quarter turn beyond the ends within its free angles.
    """
    lower = clearance.crane.lower[clearance.drive_joints]
    upper = clearance.crane.upper[clearance.drive_joints]
    lower[2] = clearance.shortest_cable
    turning = clearance.turning
    if turning is None:
        return np.array([lower, upper])
    longest = float(upper[2])
    inner, _ = clearance.reach

    # Where an obstacle stops the jib, the way stays away from the end of the slew range, since the
    # jib has to go ahead of a load that swings across it. A swing s on the cable length l moves the
    # load by s l, which is the angle s l / r seen from the mast: the largest one at the least
    # radius r.
    reserve = min(clearance.site.swing * longest / max(inner, 1e-3), _MAX_SLEW_RESERVE)
    lowest_slew = slews.low + reserve if slews.below else slews.low
    highest_slew = slews.high - reserve if slews.above else slews.high
    lower[turning] = max(lowest_slew, ends[:, turning].min() - math.pi / 2.0)
    upper[turning] = min(highest_slew, ends[:, turning].max() + math.pi / 2.0)
    return np.array([lower, upper])


def _are_within(bounds: np.ndarray, ends: np.ndarray) -> bool:
    """Return whether start and goal, shape (2, 3), are within the bounds of a search, shape
    (2, 3).
    """
    return bool((bounds[0] <= ends).all() and (ends <= bounds[1]).all())


def _candidates(
    clearance: Clearance,
    ends: np.ndarray,
    slews: SlewRange,
    limits: Limits,
    period: float,
    shortest: float,
) -> Iterator[Lift]:
    """Yield lifts between two places along paths with the distances of `EXTRA`, until one is fast
    enough. Lifts that last longer than the shortest so far may be left out. No lift is yielded if
    an end is out of the bounds of the search.

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
    if not _are_within(bounds, ends):
        return

    def proven(candidate: TimedMotion) -> bool:
        return _is_proven(clearance, slews, candidate)

    end_margin = min(clearance.swing_margin(end) for end in ends)
    tried_straight = False
    for extra in EXTRA:
        if extra and end_margin < extra + PROOF_MARGIN:
            continue
        farther = clearance.with_more_distance(extra) if extra else clearance
        for points in search(farther, ends, bounds, rates):
            is_straight = len(points) == 2
            if is_straight and tried_straight:
                continue  # the straight line is the same with any distance
            tried_straight = tried_straight or is_straight
            path = rounded_path(farther, points, rates)
            if path is None:
                continue
            motion = timed(clearance, path, limits, proven, shorter_than=shortest, period=period)
            if motion is None:
                continue
            shortest = min(shortest, motion.motion.arrival)
            yield Lift(clearance, limits, ends, slews, path, motion)
            if motion.motion.arrival < _FAST_ENOUGH * straight_time(ends, limits):
                return


def _is_proven(clearance: Clearance, slews: SlewRange, candidate: TimedMotion) -> bool:
    """Return whether along a motion all that hangs is proven free with the envelope of its swing,
    all joints stay in their ranges, and the jib stays in the slew angles that are free.
    """
    motion = candidate.motion
    q = motion.q
    in_ranges = bool((q >= clearance.crane.lower).all() and (q <= clearance.crane.upper).all())
    if not in_ranges:
        return False
    if clearance.turning is not None:
        slew = q[:, clearance.drive_joints[clearance.turning]]
        if not (slews.low <= slew.min() and slew.max() <= slews.high):
            return False
    envelope = clearance.envelope(clearance.cable(q))
    return unproven_row(clearance, q, motion.period, envelope=envelope) is None


def _reason(
    clearance: Clearance, first: np.ndarray, last: np.ndarray, slews: SlewRange, rates: np.ndarray
) -> str:
    """Return why no lift was found, by a search on a grid from both ends, and by one with a load
    that nearly is a point.
    """
    both_ways = _ends_both_ways(first, last, clearance.turning, slews)
    if not both_ways:
        names = [name for name in (slews.below, slews.above) if name]
        return (
            f"The jib cannot turn to the goal: {' and '.join(names) or 'the range of the slew'} "
            "is in its way on both sides."
        )
    bounds_of_ways = [_bounds(clearance, ends, slews) for ends in both_ways]
    searched = [
        (ends, bounds)
        for ends, bounds in zip(both_ways, bounds_of_ways, strict=True)
        if _are_within(bounds, ends)
    ]
    if not searched:
        return _out_of_bounds(both_ways[0], bounds_of_ways[0], clearance.turning, slews)
    ends, bounds = searched[0]
    for end_name, pair in (("start", ends), ("goal", ends[::-1])):
        result = best_on_grid(clearance, pair, bounds, rates, cell_limit=MAX_CELLS)
        if result.points is None and result.gave_up:
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
        "A smaller swing or distance in [lift], or slower [drives], leave more room."
    )


def _out_of_bounds(
    ends: np.ndarray, bounds: np.ndarray, turning: int | None, slews: SlewRange
) -> str:
    """Return a sentence about the first end of a lift that is out of the bounds of the search: its
    jib is too near to where an obstacle stops it, or beyond the range of its slew. Places are
    within the ranges of trolley and hoist, see `Clearance.place`.
    """
    if turning is None:
        return "Start or goal is out of the ranges of the drives."
    lowest = float(bounds[0, turning])
    highest = float(bounds[1, turning])
    for name, slew in zip(("start", "goal"), ends[:, turning].tolist(), strict=True):
        below = slew < lowest
        if not below and not slew > highest:
            continue
        obstacle = slews.below if below else slews.above
        limit = math.degrees(lowest if below else highest)
        side = "above" if below else "below"
        where = f"At the {name} the slew is {math.degrees(slew):.1f}°; a lift needs it {side}"
        if not obstacle:
            return f"{where} {limit:.1f}°, where its range ends. Move the {name} round the mast."
        return (
            f"{where} {limit:.1f}°, at a distance from where {obstacle} stops the jib, since the "
            f"jib goes ahead of a load that swings. Move the {name} round the mast, or allow a "
            "smaller swing in [lift]."
        )
    return "Start or goal is out of the ranges of the drives."


def _small_load_passes(
    clearance: Clearance, ends: np.ndarray, bounds: np.ndarray, rates: np.ndarray
) -> bool:
    """Return whether there is a way on the grid for a load that nearly is a point."""
    bodies = clearance.bodies
    site = replace(clearance.site, load=_SMALL_LOAD_SCALE * bodies.load @ bodies.hook_turn.T)
    small = replace(clearance, site=site, known_bodies=None)
    return best_on_grid(small, ends, bounds, rates, cell_limit=MAX_CELLS).points is not None
