"""A site with several cranes."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

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

_ARC = 13
"""Points of an arc that a jib sweeps."""


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
        """Check that all drives have converters and brakes.

        Raises:
            OutOfRange: If not, a number is not finite or beyond `FARTHEST`, or brakes react sooner.
        """
        for x in finite(name := f"foot of {quoted(self.name)}", self.foot, (3,), unit="m"):
            within(name, x, -FARTHEST, FARTHEST, "m")
        number(f"heading of {quoted(self.name)}", self.heading, "rad")
        self.converters.checked_for(self.crane)
        if len(self.brakes.decelerations) != (m := self.crane.layout.m):
            raise OutOfRange("number of brakes", len(self.brakes.decelerations), f"{m}")
        drives = self.converters
        reaction = self.brakes.reaction
        least = CYCLE + drives.delay + (drives.lags + drives.accelerations / drives.jerks).max()
        if reaction < least - 1e-9:
            allowed = f">= {least:.3g}, a cycle, delay, lag and rounding of the drives"
            raise OutOfRange("reaction time of brakes", reaction, allowed, "s")

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
        return math.atan2(*self.bodies.foot[1::-1, 0])

    def in_crane_frame(self, solids: Sequence[Solid]) -> list[Solid]:
        """Return solids of the site in the frame of the crane."""
        turn = self.bodies.foot[:, :3].T
        return [solid.moved(turn, -turn @ np.asarray(self.foot)) for solid in solids]

    def rope(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return pivots [m], shape (rows, 3), directions of the rope, shape (rows, 3), and motions
        of the pivot by each drive [m/rad or m/m], shape (rows, m, 3), in the frame of the site, at
        coordinates of shape (rows, n).
        """
        chain = self.bodies.columns[:-1]
        crane = self.crane
        ends = q[:, crane.layout.drives[chain]], q[:, crane.swings]
        poses = rope_poses(self.ropes.repeat(len(q), axis=0), *ends)
        motion = np.zeros((len(q), crane.layout.m, 3))
        motion[:, chain] = poses[:, 6:].reshape(len(q), -1, 3)
        return poses[:, :3], poses[:, 3:6], motion

    def plumb(self, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return coordinates of the crane at rest, shape (rows, n), and points of its load in the
        frame of the site [m], shape (rows, 3), for positions of the drives, shape (rows, m).
        """
        q = np.tile(self.crane.start.q, (len(position), 1))
        q[:, self.crane.layout.drives], q[:, self.crane.swings] = position, 0.0
        q[:, self.crane.swings] = -self.crane.swing_angles(q)
        load, *_ = self.rope(q)
        load[:, 2] -= position[:, self.crane.winch]
        return q, load

    def outline(self, boxes: np.ndarray) -> np.ndarray:
        """Return lines around the places of the rope's pivot in boxes of the drives, shape (rows,
        2, m), and from there to the mast, in the frame of the crane [m], shape (rows, points, 3).
        """
        columns = self.bodies.columns
        arc = np.linspace(0.0, 1.0, _ARC)
        ends = [columns[0], columns[max(len(columns) - 2, 0)]]  # such as slew and trolley
        inner, outer = (np.column_stack([arc, np.full(_ARC, end)]) for end in (0.0, 1.0))
        share = np.full((2 * _ARC + 2, self.crane.layout.m), 0.5)
        share[:, ends] = np.concatenate([inner[::-1], outer[:1], outer, outer[-1:]])
        drives = boxes[:, :1] + share * np.diff(boxes, axis=1)
        q, _ = self.plumb(drives.reshape(-1, self.crane.layout.m))
        lines = ((self.rope(q)[0] - self.foot) @ self.bodies.foot[:, :3]).reshape(len(boxes), -1, 3)
        lines[:, [_ARC, -1], :2] = 0.0
        return lines

    @cached_property
    def ropes(self) -> np.ndarray:
        """Numbers of its foot, joints and rope, see
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
    """

    name: str
    stations: tuple[Station, ...]
    ground: float = 0.0
    distance: float = DISTANCE
    swing: float = SWING
    solids: tuple[Solid, ...] = ()
    working_wind: WorkingWind = CALM
    entered: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        """Check names and towers.

        Raises:
            DataError: If there is no crane, two cranes or pairs have one name, towers are nearer
                than the required distance, or a part of a crane, its rope or its load is in an
                obstacle at the start.
            OutOfRange: If the distance is not positive, or the swing not from 0.001 to 0.5.
        """
        number("height of the ground", self.ground, "m")
        number("required distance", self.distance, "m", "> 0")
        within("swing of the load", self.swing, 0.001, 0.5, "rad")
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
        for station in self.stations if self.solids else ():
            bodies = [solid for solid in self.solids if not solid.zone]
            collision = first_collision(station.parts_at_start, bodies)
            if collision is not None:
                part, solid = collision
                raise DataError(
                    f"At the start the {part} of {quoted(station.name)} is in {quoted(solid)}: no "
                    "obstacle can be where a crane stands."
                )

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
        """Return whether a crane with its drives in a box, shape (..., 2, m), is proven to keep the
        required distance from each crane in its box, shape (..., 2, m) each, and at its own index
        from all obstacles, shape (..., cranes); True wherever there is no doubt, in the same shape.
        """
        cranes = len(self.stations)
        shape = box.shape[:-2]
        sound = is_box(box).reshape(-1)
        doubts = np.broadcast_to(doubtful, (*shape, cranes)).reshape(-1, cranes).copy()
        doubts[:, station] &= len(self.solids) > 0
        ends = np.zeros((*shape, cranes, 2, self.bodies.axis.shape[1] + 1))
        for i in {station, *np.flatnonzero(doubts.any(axis=0)).tolist()}:
            ends[..., i, :, :] = self.positions(i, box if i == station else boxes[i])
        rows = ends.reshape(-1, *ends.shape[-3:])
        proven = ~doubts
        for row in np.flatnonzero(doubts[:, station]):
            proven[row, station] = self.obstacles.proven_clear(
                self.bodies, station, rows[row, station], self.distance, self.swing
            )
        doubts[:, station] = False
        pairs = np.nonzero(doubts)
        if len(pairs[0]):
            proven[pairs] = proven_apart(
                self.bodies,
                np.full(len(pairs[0]), station),
                rows[pairs[0], station],
                pairs[1],
                rows[pairs],
                self.distance,
                self.swing,
            )
        # Where there is no doubt, a box that is none is proven nothing either.
        proven[~sound] = False
        return proven.reshape(*shape, cranes)

    def pair_apart(
        self, a: int, box_a: np.ndarray, b: int, box_b: np.ndarray, factor: float = 1.0
    ) -> np.ndarray:
        """Return whether two cranes in boxes, shape (..., 2, m), are proven to keep a multiple of
        the required distance, shape (...); the same whichever crane is first.
        """
        if a > b:
            return self.pair_apart(b, box_b, a, box_a, factor)
        ends = np.broadcast_arrays(self.positions(a, box_a), self.positions(b, box_b))
        first, second = (x.reshape(-1, *x.shape[-2:]) for x in ends)
        rows = np.zeros(len(first), dtype=int)
        distance = factor * self.distance
        proven = proven_apart(self.bodies, rows + a, first, rows + b, second, distance, self.swing)
        return proven.reshape(ends[0].shape[:-2])

    def _tower_gap(self, a: int, b: int) -> float:
        towers = []
        for bodies in (self.stations[i].bodies for i in (a, b)):
            still = bodies.joint == 0
            ends = bodies.ends[still] @ bodies.foot[:, :3].T + bodies.foot[:, 3]
            towers.append(PlacedCapsules(ends[None], bodies.radius[still], np.zeros(0)))
        return float(least_distances(*towers)[0])


def check_names(names: Sequence[str]) -> None:
    """Raise `DataError` if two cranes or pairs of cranes would share the columns of a run."""
    pairs = ["_".join(pair) for pair in itertools.combinations([*names, "obstacles"], 2)]
    name, count = Counter([*names, *pairs]).most_common(1)[0]
    if count > 1:
        called = f"{count} cranes or pairs of cranes are called {quoted(name)}"
        raise DataError(f"{called}; give each its own name.")
