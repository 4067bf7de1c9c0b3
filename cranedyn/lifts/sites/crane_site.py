"""A site with several cranes: where they stand, and what is proven about their positions.

Conventions of this module: a crane has m drives and n coordinates, the drives and two swing joints.
A *box* is an interval of positions for each drive, shape (2, m): the lower ends, then the upper
ends. A crane is named by its index among `CraneSite.stations`.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from cranedyn.checks import finite, number, within
from cranedyn.disturbances.wind import Speed, wind
from cranedyn.dynamics.converters import Converters
from cranedyn.errors import DataError, OutOfRange, UnknownName, quoted
from cranedyn.interfaces import Disturbance
from cranedyn.lifts.judging.chart import Chart
from cranedyn.lifts.planning.solids import FARTHEST, Solid
from cranedyn.lifts.sites.brakes import CYCLE, Brakes
from cranedyn.lifts.sites.distance_proof import is_box, least_distances, proven_apart
from cranedyn.lifts.sites.lift_list import HOOKING_TIME, ListedLift, check_lift, check_order
from cranedyn.lifts.sites.obstacles import Obstacles
from cranedyn.lifts.sites.placed_capsules import (
    CraneBodies,
    PlacedCapsules,
    crane_bodies,
    rope_poses,
    stacked,
    travels,
    without_standing,
)
from cranedyn.lifts.sites.start import StartPart, first_collision, parts_at_start
from cranedyn.lifts.sites.working_wind import CALM, WorkingWind
from cranedyn.model.crane import Crane

DISTANCE = 1.0
"""Required distance between cranes of a site that does not enter it [m]."""

SWING = 0.1
"""Largest swing of the ropes from plumb of a site that does not enter it [rad]."""

_ARC_POINTS = 13
"""Number of points with which an arc is drawn that a jib sweeps."""

_SAME_PLACE = 1e-6
"""Largest difference of two places that count as one [m]; of unit vectors it is a number."""

_ROUNDING = 1e-9
"""Rounding error of times and accelerations [s, rad/s² or m/s²]."""


class RopePoses(NamedTuple):
    """How the rope of a crane hangs in some rows, in the frame of the site.

    Attributes:
        pivot: The point from which it hangs [m], shape (rows, 3).
        direction: Unit vector along the rope, from the pivot to the load, shape (rows, 3).
        motion: Motion of the pivot by each drive [m/rad or m/m], shape (rows, m, 3).
    """

    pivot: np.ndarray
    direction: np.ndarray
    motion: np.ndarray


@dataclass(frozen=True, eq=False)
class Station:
    """A crane at its place.

    Attributes:
        name: Its name.
        crane: The crane; its drives stand at the start where its `start` says.
        foot: Foot of its mast in the frame of the site [m], shape (3,); of a crane that travels the
            origin of its frame.
        heading: Direction of the jib at zero slew, from X towards Y [rad]; of a crane that travels
            the direction of -Y of its frame, in which the trolley of an overhead crane runs.
        converters: Frequency converters of its drives.
        brakes: Its brakes at their weakest.
        chart: Its load chart; None if unknown.
        entered: Which of its values somebody entered: "brakes", "reaction", "tolerances", "drives",
            "crane" (its shapes) and "load" (its mass). All others are defaults.
        runway: Name of the crane on whose runway it travels; "" for one of its own.
    """

    name: str
    crane: Crane
    foot: np.ndarray
    heading: float
    converters: Converters
    brakes: Brakes
    chart: Chart | None = None
    entered: frozenset[str] = frozenset()
    runway: str = ""

    def __post_init__(self) -> None:
        """Check that the foot is near enough, and that the drives brake as the brakes say.

        Raises:
            OutOfRange: If a number is not finite, the foot is beyond `FARTHEST`, not every drive
                has a converter and a brake, or the drives react later or ramp more slowly than the
                brakes.
        """
        name = f"foot of {quoted(self.name)}"
        for coordinate in finite(name, self.foot, (3,), unit="m"):
            within(name, coordinate, -FARTHEST, FARTHEST, "m")
        number(f"heading of {quoted(self.name)}", self.heading, "rad")
        self.converters.checked_for(self.crane)
        decelerations = self.brakes.decelerations
        drive_count = self.crane.layout.m
        if len(decelerations) != drive_count:
            raise OutOfRange("number of brakes", len(decelerations), f"{drive_count}")

        # Drives brake by the ramps of their converters: a guard that counted on more would let them
        # run out of their box.
        accelerations = self.converters.accelerations
        for joint, brake, ramp in zip(
            self.crane.layout.driven, decelerations, accelerations, strict=True
        ):
            if brake > ramp + _ROUNDING:
                raise OutOfRange(
                    f"deceleration of the brake of {joint.symbol} of {quoted(self.name)}",
                    f"{brake:.4g}",
                    f"up to {ramp:.4g}, by which its drive slows down",
                    f"{joint.unit}/s²",
                )

        # A guard looks once a cycle, so that its command to brake may come a cycle late. It reaches
        # the drive after the delay of the bus; the ramp takes the time acceleration / jerk to
        # become as steep as it gets, and the drive follows the ramp with its lag.
        ramp_times = accelerations / self.converters.jerks
        slowest = float((self.converters.lags + ramp_times).max())
        least = CYCLE + self.converters.delay + slowest
        if self.brakes.reaction < least - _ROUNDING:
            allowed = f">= {least:.3g}, a cycle, delay, lag and rounding of the drives"
            raise OutOfRange("reaction time of brakes", self.brakes.reaction, allowed, "s")

    @cached_property
    def bodies(self) -> CraneBodies:
        """Capsules around its shapes, in the frame of the site."""
        return crane_bodies(self.crane, np.asarray(self.foot, dtype=float), self.heading)

    @cached_property
    def parts_at_start(self) -> list[StartPart]:
        """Its convex parts at the start, in the frame of the site."""
        return parts_at_start(self.crane, self.bodies.foot)

    @cached_property
    def ranges(self) -> np.ndarray:
        """Lower and upper ends of the ranges of its drives, shape (2, m)."""
        return np.array([self.crane.lower, self.crane.upper])[:, self.crane.layout.drives]

    @property
    def turn(self) -> float:
        """Angle from the frame of the crane to that of the site about Z [rad]."""
        # The first column of the rotation of the foot is the X axis of the crane.
        x, y, _ = self.bodies.foot[:, 0]
        return math.atan2(y, x)

    def in_crane_frame(self, solids: Sequence[Solid]) -> list[Solid]:
        """Return solids of the site in the frame of the crane."""
        turn = self.bodies.foot[:, :3].T
        return [solid.moved(turn, -turn @ np.asarray(self.foot)) for solid in solids]

    def rope(self, q: np.ndarray) -> RopePoses:
        """Return how the rope hangs at coordinates of shape (rows, n)."""
        crane = self.crane
        # All drives but the winch move the pivot.
        chain = self.bodies.columns[:-1]
        chain_position = q[:, crane.layout.drives[chain]]
        swing_angles = q[:, crane.swings]
        poses = rope_poses(self.ropes.repeat(len(q), axis=0), chain_position, swing_angles)
        motion = np.zeros((len(q), crane.layout.m, 3))
        motion[:, chain] = poses[:, 6:].reshape(len(q), -1, 3)
        return RopePoses(poses[:, :3], poses[:, 3:6], motion)

    def plumb(self, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return coordinates of the crane at rest, shape (rows, n), and points of its load in the
        frame of the site [m], shape (rows, 3), for positions of the drives, shape (rows, m).
        """
        crane = self.crane
        q = np.tile(crane.start.q, (len(position), 1))
        q[:, crane.layout.drives] = position
        # A swing joint is measured from the link before it, which leans where a jib luffs. So the
        # angles at which the rope hangs plumb take back those that it has where the joints are at
        # zero.
        q[:, crane.swings] = 0.0
        q[:, crane.swings] = -crane.swing_angles(q)
        load = self.rope(q).pivot
        load[:, 2] -= position[:, crane.winch]
        return q, load

    def outline(self, boxes: np.ndarray) -> np.ndarray:
        """Return where the rope's pivot may be in boxes of the drives, as lines.

        Of a crane that slews this is a sector: a line goes along the inner arc, to the mast, back
        along the outer arc, and again to the mast. Of a crane that travels it is the area between
        both ends of its way, with a closed line around it. Drives other than the first and the last
        before the rope, such as slew and trolley, are in the middle of their intervals.

        Args:
            boxes: The boxes, shape (rows, 2, m).

        Returns:
            Points in the frame of the crane [m], shape (rows, points, 3).
        """
        # The first drive of the chain turns the jib or moves the bridge, the last one moves the
        # pivot along it.
        columns = self.bodies.columns
        first = columns[0]
        last = columns[max(len(columns) - 2, 0)]

        # Where each drive is in its interval, from 0 to 1. The points at the mast are put there
        # below; until then they repeat an end of the outer arc. Of a crane that travels they stay
        # there, and the last point closes the line.
        arc = np.linspace(0.0, 1.0, _ARC_POINTS)
        inner = np.zeros(_ARC_POINTS)
        outer = np.ones(_ARC_POINTS)
        shares = np.full((2 * _ARC_POINTS + 2, self.crane.layout.m), 0.5)
        shares[:, first] = np.concatenate([arc[::-1], arc[:1], arc, arc[-1:]])
        shares[:, last] = np.concatenate([inner, outer[:1], outer, outer[-1:]])
        drives = boxes[:, :1] + shares * np.diff(boxes, axis=1)

        q, _ = self.plumb(drives.reshape(-1, self.crane.layout.m))
        points = (self.rope(q).pivot - self.foot) @ self.bodies.foot[:, :3]
        lines = points.reshape(len(boxes), -1, 3)
        if travels(self.crane):
            lines[:, -1] = lines[:, 0]
            return lines
        at_mast = [_ARC_POINTS, -1]
        lines[:, at_mast, :2] = 0.0
        return lines

    @cached_property
    def ropes(self) -> np.ndarray:
        """Numbers of its foot, joints and rope in one row, see
        `cranedyn.lifts.sites.placed_capsules.rope_poses`.
        """
        return stacked([self.bodies]).ropes


@dataclass(frozen=True)
class SiteWind:
    """Wind that blows on the loads of all cranes.

    Attributes:
        speed: Speed over time [m/s], see `cranedyn.disturbances.wind`.
        direction: Direction in which it blows, from X towards Y [rad].
        area: Drag coefficient times area of each load [m²].
    """

    speed: Speed
    direction: float = 0.0
    area: float = 4.0

    def on(self, station: Station) -> Disturbance:
        """Return the forces on a crane.

        Raises:
            OutOfRange: If a number is not finite or the area is negative.
        """
        direction = self.direction - station.turn
        return wind(station.crane, self.speed, direction=direction, payload_area=self.area)


@dataclass(frozen=True, eq=False)
class CraneSite:
    """Several cranes on a site, in a frame of its own: metres, Z up.

    Attributes:
        name: Its name.
        stations: The cranes.
        ground: Height of the ground [m].
        distance: Required distance between parts of different cranes [m].
        swing: Largest angle of a rope from plumb [rad].
        solids: Obstacles that all parts of cranes keep from, and zones that ropes and loads keep
            out of.
        working_wind: Wind up to which the cranes work; by default none at all.
        entered: Which of "distance", "swing" and "wind" somebody entered. All others are defaults.
        lifts: The lifts of a shift, see `cranedyn.lifts.sites.shift_plan`.
        hooking_time: Time to hook a load on, or to unhook it [s].
    """

    name: str
    stations: tuple[Station, ...]
    ground: float = 0.0
    distance: float = DISTANCE
    swing: float = SWING
    solids: tuple[Solid, ...] = ()
    working_wind: WorkingWind = CALM
    entered: frozenset[str] = frozenset()
    lifts: tuple[ListedLift, ...] = ()
    hooking_time: float = HOOKING_TIME

    def __post_init__(self) -> None:
        """Check names, towers and lifts.

        Raises:
            DataError: If there is no crane, two cranes or pairs have one name, towers are nearer
                than the required distance, cranes on one runway do not stand as one runway does or
                are too near to each other at the start, or a part of a crane, its rope or its load
                is in an obstacle at the start; or if two lifts have one name, or lifts wait for
                each other in a circle.
            OutOfRange: If the distance is not positive, the swing not from 0.001 to 0.5, or the
                hooking time is negative.
            UnknownName: If a lift names a crane or a lift that there is not.
        """
        number("height of the ground", self.ground, "m")
        number("required distance", self.distance, "m", "> 0")
        within("swing of the load", self.swing, 0.001, 0.5, "rad")
        number("hooking time", self.hooking_time, "s", ">= 0")
        if not self.stations:
            raise DataError(f"The site {quoted(self.name)} has no crane.")
        names = [station.name for station in self.stations]
        check_names(names)
        for station in self.stations:
            if station.runway:
                self._check_runway(station)
        for a, b in itertools.combinations(range(len(self.stations)), 2):
            if self.share_runway(a, b):
                self._check_starts_apart(a, b)
            else:
                self._check_tower_gap(a, b)
        # Zones are not solid: towers and jibs may be in them.
        bodies = [solid for solid in self.solids if not solid.zone]
        for station in self.stations:
            collision = first_collision(station.parts_at_start, bodies) if bodies else None
            if collision is not None:
                part, solid = collision
                raise DataError(
                    f"At the start the {part} of {quoted(station.name)} is in {quoted(solid)}: no "
                    "obstacle can be where a crane stands."
                )
        earlier: dict[str, ListedLift] = {}
        for lift in self.lifts:
            check_lift(lift, names, earlier)
            earlier[lift.name] = lift
        check_order(self.lifts)

    @cached_property
    def bodies(self) -> CraneBodies:
        """Capsules of all cranes, `stacked`."""
        return stacked([station.bodies for station in self.stations])

    @cached_property
    def moving_bodies(self) -> CraneBodies:
        """Capsules of all cranes without those that stand still, `stacked`."""
        return stacked([without_standing(station.bodies) for station in self.stations])

    def index_of(self, name: str) -> int:
        """Return the index of the crane of a name.

        Raises:
            ValueError: If there is none.
        """
        return [station.name for station in self.stations].index(name)

    def share_runway(self, a: int, b: int) -> bool:
        """Return whether two cranes travel on one runway.

        What stands of them then stands once. It is not compared with what moves of either, just as
        what moves of a crane is not compared with its own tower: a bridge rests on its rails.
        """
        runways = [self.stations[i].runway or self.stations[i].name for i in (a, b)]
        return a != b and runways[0] == runways[1]

    @cached_property
    def _on_runway(self) -> np.ndarray:
        """Whether two cranes travel on one runway, see `share_runway`, shape (cranes, cranes)."""
        cranes = range(len(self.stations))
        return np.array([[self.share_runway(a, b) for b in cranes] for a in cranes])

    @cached_property
    def _most_drives(self) -> int:
        """Number of the drives of the crane that has most."""
        return max(station.crane.layout.m for station in self.stations)

    @cached_property
    def _drive_columns(self) -> np.ndarray:
        """Indices of the drives of each crane that stand in the columns of `bodies`, shape (cranes,
        1, k + 1). Index `_most_drives` stands for a joint that a crane does not have, whose value
        is zero.
        """
        joints = self.bodies.axis.shape[1]
        chains = np.full((len(self.stations), 1, joints + 1), self._most_drives)
        for chain, station in zip(chains[:, 0], self.stations, strict=True):
            columns = station.bodies.columns
            chain[: len(columns) - 1] = columns[:-1]
            chain[-1] = columns[-1]
        return chains

    def compared_capsules(self, crane: int, other: int) -> np.ndarray:
        """Return the indices of the capsules of a crane that are compared with those of another:
        all, or those that move where both travel on one runway.
        """
        joint = self.stations[crane].bodies.joint
        if self.share_runway(crane, other):
            return np.flatnonzero(joint > 0)
        return np.arange(len(joint))

    @cached_property
    def obstacles(self) -> Obstacles:
        """The solids with what measures distances from them."""
        return Obstacles(self.solids)

    def positions(self, station: int, values: np.ndarray) -> np.ndarray:
        """Return values of the drives of a crane, shape (..., m), in the columns of `bodies`."""
        drives = np.zeros((*np.shape(values)[:-1], self._most_drives + 1))
        drives[..., : np.shape(values)[-1]] = values
        # Compiled code reads it: np.take, other than an index, gives contiguous numbers.
        return np.take(drives, self._drive_columns[station, 0], axis=-1)

    def apart(
        self,
        station: int,
        box: np.ndarray,
        boxes: Sequence[np.ndarray],
        doubtful: np.ndarray | bool = True,
    ) -> np.ndarray:
        """Return whether a crane in a box is proven to keep the required distance from each other
        crane in its box, and from all obstacles.

        Args:
            station: Index of the crane.
            box: Its box, shape (..., 2, m).
            boxes: Boxes of all cranes, shape (..., 2, m) each; its own one is not read.
            doubtful: Whether there is something to prove about each crane, shape (..., cranes), and
                at its own index about obstacles. What is not doubtful counts as proven: whoever
                says so knows it from an earlier proof.

        Returns:
            Whether it keeps apart from each crane, shape (..., cranes), and at its own index from
            all obstacles. False everywhere for a box whose ends are swapped or no numbers.
        """
        cranes = len(self.stations)
        shape = box.shape[:-2]
        sound = is_box(box).reshape(-1)
        to_prove = np.broadcast_to(doubtful, (*shape, cranes)).reshape(-1, cranes).copy()
        to_prove[:, station] &= len(self.solids) > 0

        # Boxes of all cranes that a proof reads, in the columns of `bodies`: all at once, which
        # takes a fifth of the time of one after the other.
        drives = np.zeros((*shape, cranes, 2, self._most_drives + 1))
        for i in {station, *np.flatnonzero(to_prove.any(axis=0)).tolist()}:
            box_of_crane = box if i == station else boxes[i]
            drives[..., i, :, : box_of_crane.shape[-1]] = box_of_crane
        rows = drives.reshape(-1, *drives.shape[-3:])
        rows = np.take_along_axis(rows, self._drive_columns[None], axis=-1)

        proven = ~to_prove
        for row in np.flatnonzero(to_prove[:, station]):
            proven[row, station] = self.obstacles.proven_clear(
                self.bodies, station, rows[row, station], self.distance, self.swing
            )
        to_prove[:, station] = False
        on_runway = self._on_runway[station]
        for bodies, is_compared in (
            (self.bodies, ~on_runway),
            (self.moving_bodies, on_runway),
        ):
            pair_row, other = np.nonzero(to_prove & is_compared)
            if len(pair_row):
                proven[pair_row, other] = proven_apart(
                    bodies,
                    np.full(len(pair_row), station),
                    rows[pair_row, station],
                    other,
                    rows[pair_row, other],
                    self.distance,
                    self.swing,
                )

        # A box that is no box is apart from nothing, also where nobody doubts it.
        proven[~sound] = False
        return proven.reshape(*shape, cranes)

    def pair_apart(
        self, a: int, box_a: np.ndarray, b: int, box_b: np.ndarray, factor: float = 1.0
    ) -> np.ndarray:
        """Return whether two cranes in boxes are proven to keep a multiple of the required distance
        from each other, shape (...).

        Args:
            a: Index of a crane.
            box_a: Its boxes, shape (..., 2, m).
            b: Index of the other crane.
            box_b: Its boxes, shape (..., 2, m).
            factor: The multiple.
        """
        # Rounding and the order in which halves of boxes are examined depend on which crane is
        # first. In one order the answer is the same whoever asks.
        if a > b:
            return self.pair_apart(b, box_b, a, box_a, factor)
        first, second = np.broadcast_arrays(self.positions(a, box_a), self.positions(b, box_b))
        shape = first.shape[:-2]
        first = first.reshape(-1, *first.shape[-2:])
        second = second.reshape(-1, *second.shape[-2:])
        proven = proven_apart(
            self.moving_bodies if self.share_runway(a, b) else self.bodies,
            np.full(len(first), a),
            first,
            np.full(len(first), b),
            second,
            factor * self.distance,
            self.swing,
        )
        return proven.reshape(shape)

    def _check_tower_gap(self, a: int, b: int) -> None:
        """Check that all that stands still of two cranes keeps the required distance.

        Raises:
            DataError: If it does not.
        """
        first = self.stations[a]
        second = self.stations[b]
        standing = [_standing_capsules(station.bodies) for station in (first, second)]
        # A crane of which nothing is drawn that stands is near to no tower.
        if not all(capsules.radius.size for capsules in standing):
            return
        gap = float(least_distances(*standing)[0])
        if gap >= self.distance:
            return
        kind = "towers"
        advice = ""
        if travels(first.crane) and travels(second.crane):
            kind = "runways"
            advice = (
                f" If both cranes travel on one runway, enter runway = {quoted(first.name)} for "
                f"{quoted(second.name)}."
            )
        elif travels(first.crane) or travels(second.crane):
            kind = "tower and runway"
        raise DataError(
            f"The {kind} of {quoted(first.name)} and {quoted(second.name)} are "
            f"{max(gap, 0.0):.2f} m apart; required is {self.distance:g} m.{advice}"
        )

    def _check_starts_apart(self, a: int, b: int) -> None:
        """Check that two cranes on one runway are apart at the start: their order is that in which
        they start, and stays.

        Raises:
            DataError: If they are not proven to be.
        """
        boxes = []
        for station in (self.stations[a], self.stations[b]):
            start = station.crane.start.q[station.crane.layout.drives]
            boxes.append(np.array([start, start]))
        if not self.pair_apart(a, boxes[0], b, boxes[1]):
            names = [quoted(self.stations[i].name) for i in (a, b)]
            raise DataError(
                f"At the start {names[0]} and {names[1]}, on one runway, are not {self.distance:g} "
                "m apart, with the load swinging; give each its own start, such as bridge_init "
                "among the values of an overhead crane."
            )

    def _check_runway(self, station: Station) -> None:
        """Check that a crane travels on the runway of another one: that both travel, stand at one
        place, and have the same shapes standing there.

        Raises:
            UnknownName: If there is no such crane.
            DataError: If one does not travel, the other one has no runway of its own, or both do
                not stand as one runway does.
        """
        name = quoted(station.name)
        names = [other.name for other in self.stations if other is not station]
        if station.runway not in names:
            raise UnknownName("crane", station.runway, names)
        owner = next(other for other in self.stations if other.name == station.runway)
        other_name = quoted(owner.name)
        for crane in (station, owner):
            if not travels(crane.crane):
                raise DataError(
                    f"{quoted(crane.name)} has no runway: its first drive does not slide. Leave "
                    f"out the runway of {name}."
                )
        if owner.runway:
            raise DataError(
                f"{other_name} travels on the runway of {quoted(owner.runway)} itself: enter "
                f"runway = {quoted(owner.runway)} for {name}, too."
            )
        if not np.allclose(station.bodies.foot, owner.bodies.foot, rtol=0.0, atol=_SAME_PLACE):
            raise DataError(
                f"{name} travels on the runway of {other_name}, but stands elsewhere: give both "
                "the same position and heading."
            )
        # Rails, columns, and where the first drive stands at zero and which way it goes.
        numbers = []
        for bodies in (station.bodies, owner.bodies):
            standing = _standing_capsules(bodies)
            direction = bodies.rotation[0] @ bodies.axis[0]
            fields = [standing.ends.ravel(), standing.radius, bodies.translation[0], direction]
            numbers.append(np.concatenate(fields))
        is_same = numbers[0].shape == numbers[1].shape and np.allclose(
            numbers[0], numbers[1], rtol=0.0, atol=_SAME_PLACE
        )
        if not is_same:
            raise DataError(
                f"{name} travels on the runway of {other_name}, but its rails and columns differ: "
                "give both the same values of what stands, such as span, runway and height."
            )


def _standing_capsules(bodies: CraneBodies) -> PlacedCapsules:
    """Return the capsules of a crane that no drive moves, in the frame of the site."""
    still = bodies.joint == 0
    ends = bodies.ends[still] @ bodies.foot[:, :3].T + bodies.foot[:, 3]
    return PlacedCapsules(ends[None], bodies.radius[still], np.zeros(0))


def check_names(names: Sequence[str]) -> None:
    """Check that the columns of a run have different names: those of a crane begin with its name,
    those of distances with the names of a pair.

    Raises:
        DataError: If two names are equal.
    """
    pairs = ["_".join(pair) for pair in itertools.combinations([*names, "obstacles"], 2)]
    name, count = Counter([*names, *pairs]).most_common(1)[0]
    if count > 1:
        called = f"{count} cranes or pairs of cranes are called {quoted(name)}"
        raise DataError(f"{called}; give each its own name.")
