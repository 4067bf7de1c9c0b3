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
from cranedyn.errors import DataError, OutOfRange, quoted
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
        foot: Foot of its mast in the frame of the site [m], shape (3,).
        heading: Direction of the jib at zero slew, from X towards Y [rad].
        converters: Frequency converters of its drives.
        brakes: Its brakes at their weakest.
        chart: Its load chart; None if unknown.
        entered: Which of its values somebody entered: "brakes", "reaction", "tolerances", "drives",
            "crane" (its shapes) and "load" (its mass). All others are defaults.
    """

    name: str
    crane: Crane
    foot: np.ndarray
    heading: float
    converters: Converters
    brakes: Brakes
    chart: Chart | None = None
    entered: frozenset[str] = frozenset()

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
        """Return the sectors in which the rope's pivot may be in boxes of the drives, as lines.

        A line goes along the inner arc of the sector, to the mast, back along the outer arc, and
        again to the mast. Drives other than slew and trolley are in the middle of their intervals.

        Args:
            boxes: The boxes, shape (rows, 2, m).

        Returns:
            Points in the frame of the crane [m], shape (rows, points, 3).
        """
        # The first drive of the chain turns the jib, the last one moves the pivot along it.
        columns = self.bodies.columns
        slew = columns[0]
        trolley = columns[max(len(columns) - 2, 0)]

        # Where each drive is in its interval, from 0 to 1. The points at the mast are put there
        # below; until then they repeat an end of the outer arc.
        arc = np.linspace(0.0, 1.0, _ARC_POINTS)
        inner = np.zeros(_ARC_POINTS)
        outer = np.ones(_ARC_POINTS)
        shares = np.full((2 * _ARC_POINTS + 2, self.crane.layout.m), 0.5)
        shares[:, slew] = np.concatenate([arc[::-1], arc[:1], arc, arc[-1:]])
        shares[:, trolley] = np.concatenate([inner, outer[:1], outer, outer[-1:]])
        drives = boxes[:, :1] + shares * np.diff(boxes, axis=1)

        q, _ = self.plumb(drives.reshape(-1, self.crane.layout.m))
        points = (self.rope(q).pivot - self.foot) @ self.bodies.foot[:, :3]
        lines = points.reshape(len(boxes), -1, 3)
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
                than the required distance, or a part of a crane, its rope or its load is in an
                obstacle at the start; or if two lifts have one name, or lifts wait for each other
                in a circle.
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
        for a, b in itertools.combinations(range(len(self.stations)), 2):
            gap = self._tower_gap(a, b)
            if not gap >= self.distance:
                raise DataError(
                    f"The towers of {quoted(names[a])} and {quoted(names[b])} are "
                    f"{max(gap, 0.0):.2f} m apart; required is {self.distance:g} m."
                )
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
    def obstacles(self) -> Obstacles:
        """The solids with what measures distances from them."""
        return Obstacles(self.solids)

    def positions(self, station: int, values: np.ndarray) -> np.ndarray:
        """Return values of the drives of a crane, shape (..., m), in the columns of `bodies`."""
        columns = self.stations[station].bodies.columns
        joints = self.bodies.axis.shape[1]
        chain = np.zeros((*np.shape(values)[:-1], joints + 1))
        chain[..., : len(columns) - 1] = values[..., columns[:-1]]
        chain[..., -1] = values[..., columns[-1]]
        return chain

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

        # Boxes of all cranes that a proof reads, in the columns of `bodies`.
        ends = np.zeros((*shape, cranes, 2, self.bodies.axis.shape[1] + 1))
        for i in {station, *np.flatnonzero(to_prove.any(axis=0)).tolist()}:
            ends[..., i, :, :] = self.positions(i, box if i == station else boxes[i])
        rows = ends.reshape(-1, *ends.shape[-3:])

        proven = ~to_prove
        for row in np.flatnonzero(to_prove[:, station]):
            proven[row, station] = self.obstacles.proven_clear(
                self.bodies, station, rows[row, station], self.distance, self.swing
            )
        to_prove[:, station] = False
        pair_row, other = np.nonzero(to_prove)
        if len(pair_row):
            proven[pair_row, other] = proven_apart(
                self.bodies,
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
            self.bodies,
            np.full(len(first), a),
            first,
            np.full(len(first), b),
            second,
            factor * self.distance,
            self.swing,
        )
        return proven.reshape(shape)

    def _tower_gap(self, a: int, b: int) -> float:
        """Return the distance between all that stands still of two cranes [m]."""
        first = _standing_capsules(self.stations[a].bodies)
        second = _standing_capsules(self.stations[b].bodies)
        return float(least_distances(first, second)[0])


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
