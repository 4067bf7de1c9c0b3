"""Distances between crane, load and obstacles.

A *place* is slew [rad], trolley radius [m] and cable length [m] with the load plumb, shape (3,);
arguments that are places are called `drive_position`. A *margin* is a distance beyond the required
one. The shapes are inflated by the required distance, so that their distances are margins. The
swing of the load is an *envelope* about them: how far a point that hangs may be from where it is
with the load plumb.

What hangs is load, hook and rope; the trolley counts with them. Each of these is compared with what
it can meet:

* Load, hook and rope with all solids, with the crane's own mast and base, and with zones. A zone is
  only kept out of, at any distance.
* The trolley with the solids that are tall enough for it, since it rolls at a constant height.
* The load with the ground, since it hangs lowest.
* Load and hook with what slews below the trolley, since the rope begins at the trolley.

What slews with the jib is compared with the solids. `cranedyn.lifts.planning.coverage` checks that
no pair of a body and an obstacle is left out.
"""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Iterator
from dataclasses import InitVar, dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import coal
import numpy as np
import pinocchio as pin

from cranedyn.errors import CraneError, OutOfRange
from cranedyn.lifts.planning.crane_bodies import (
    CollisionBodies,
    collision_bodies,
    corners_of,
    refuse_other_kinematics,
)
from cranedyn.lifts.planning.fields import Body, Field, Placed
from cranedyn.lifts.planning.site import GROUND, MAST, OWN_BASE, OWN_UPPER, Site
from cranedyn.lifts.planning.solids import Solid, hull
from cranedyn.model.crane import Crane

ROUNDING = 1e-4
"""Deduction from every margin [m]: a hundred times the tolerance of coal's algorithm. Distances, as
of `Clearance.distances`, are not reduced."""

_KINEMATICS = threading.Lock()
"""Held while Pinocchio's data is written and read, which all threads share. A `Body` needs no lock,
because each thread has its own.
"""

Length = TypeVar("Length", float, np.ndarray)
"""One cable length, or an array of them [m]."""


class OutOfReach(OutOfRange):
    """A place that the load of a crane does not reach."""

    def __init__(self, sentence: str, *, name: str, value: float, allowed: str) -> None:
        """Set the attributes and the error message.

        Args:
            sentence: The message.
            name: What is out of its range.
            value: How much it is [m].
            allowed: The range in words [m].
        """
        self.name = name
        self.value = value
        self.allowed = allowed
        self.unit = "m"
        CraneError.__init__(self, sentence)  # OutOfRange would phrase a sentence of its own


class Joints(NamedTuple):
    """Indices of the joints of a tower crane among its coordinates."""

    slew: int
    trolley: int
    radial_swing: int
    tangential_swing: int
    hoist: int


class ObstaclePart(NamedTuple):
    """A convex part of an obstacle.

    Attributes:
        obstacle: Name of the solid, or "ground".
        number: Index of the part among `Solid.parts`; 0 for the ground.
    """

    obstacle: str
    number: int


class Nearest(NamedTuple):
    """Nearest pair of bodies and their distance.

    Attributes:
        distance: Distance between them [m]; zero or less where they touch.
        body: "load", "hook", "rope", "trolley", or "jib" for all that slews with it.
        obstacle: Name of the solid, or one of `cranedyn.lifts.planning.site.RESERVED_NAMES`: the
            ground, or a part of the crane itself.
    """

    distance: float
    body: str
    obstacle: str


class NearestPoints(NamedTuple):
    """Nearest points of a body and an obstacle.

    Attributes:
        margin: Distance beyond the required one [m].
        required: Required distance [m].
        body: "load", "hook", "rope" or "trolley".
        on_body: The point of the body [m], shape (3,).
        on_obstacle: The point of the obstacle [m], shape (3,).
        normal: Unit vector from the obstacle to the body, shape (3,).
    """

    margin: float
    required: float
    body: str
    on_body: np.ndarray
    on_obstacle: np.ndarray
    normal: np.ndarray


class _HangingBody(NamedTuple):
    """A body that hangs, or the trolley, with the obstacles that it keeps from.

    Attributes:
        name: "load", "hook", "rope" or "trolley".
        body: Its shape, inflated by the required distance; not inflated where it keeps out of
            zones.
        fields: The obstacles, in groups.
    """

    name: str
    body: Body
    fields: list[Field]


@dataclass(frozen=True, eq=False)
class _Fields:
    """Obstacles of a site in the frame of the crane, by what keeps from them.

    Attributes:
        solids: All solids but zones.
        tall_solids: Solids that reach up to where the trolley may come close to them.
        solids_and_mast: All solids but zones, and the crane's own mast and base.
        zones: Zones to keep out of.
        ground: The ground; empty where the load stands on it, see `Clearance.contacts`.
    """

    solids: Field
    tall_solids: Field
    solids_and_mast: Field
    zones: Field
    ground: Field


@dataclass(frozen=True, eq=False)
class Clearance:
    """Crane and site, and the distances between them.

    Attributes:
        crane: The crane.
        site: The site.
        contacts: Parts of obstacles that the load stands on, which do not count here. Whoever
            leaves them out must show in another way that nothing sinks into them, see
            `cranedyn.lifts.planning.support`.
    """

    crane: Crane
    site: Site
    contacts: frozenset[ObstaclePart] = frozenset()
    known_bodies: InitVar[CollisionBodies | None] = None

    def __post_init__(self, known_bodies: CollisionBodies | None) -> None:
        """Check that a place determines where the crane is.

        Args:
            known_bodies: The bodies of the crane with the load of the site where they are known,
                which saves reading them from the URDF again; None to read them.

        Raises:
            MissingRole: If it is not a tower crane.
            ModelError: If it moves in other joints, too, or its joints are elsewhere than those of
                the tower crane of this project.
        """
        refuse_other_kinematics(self.crane)
        if known_bodies is not None:
            object.__setattr__(self, "bodies", known_bodies)

    def __getstate__(self) -> dict[str, Any]:
        """Return crane, site and contacts alone. Coal's bodies cannot be pickled, and what follows
        from these three is computed again where it is needed.
        """
        return {"crane": self.crane, "site": self.site, "contacts": self.contacts}

    @cached_property
    def joints(self) -> Joints:
        """Indices of the joints among the coordinates."""
        return Joints(*self.crane.layout.tower("A planned lift"))

    @cached_property
    def drive_joints(self) -> np.ndarray:
        """Indices of slew, trolley radius and cable length among the coordinates, shape (3,)."""
        return self.crane.layout.drives

    @cached_property
    def solids(self) -> list[Solid]:
        """The obstacles in the frame of the crane."""
        solids = []
        for solid in self.site.seen_by_crane():
            touched = [part.number for part in self.contacts if part.obstacle == solid.name]
            rest = solid.without_parts(touched)
            if rest is not None:
                solids.append(rest)
        return solids

    @cached_property
    def bodies(self) -> CollisionBodies:
        """The bodies of the crane and its load."""
        return collision_bodies(self.crane, self.site.load)

    @cached_property
    def height(self) -> float:
        """Height of the swing pivot above the crane's foot [m]."""
        (pivot,) = self._frames(self.crane.start.q, self.joints.radial_swing)
        return float(pivot.getTranslation()[2])

    @property
    def shortest_cable(self) -> float:
        """Shortest cable on which the hook, on top of the load, hangs below the trolley [m], not
        less than that of the crane.
        """
        hook = self.bodies.hook
        trolley = self.bodies.trolley
        # How far the top of the hook would be above the underside of the trolley on a cable of no
        # length: a cable of that length brings them together.
        overlap_at_zero = hook.top - trolley.centre[2] + trolley.size[2] / 2.0
        return max(float(self.crane.lower[self.joints.hoist]), float(overlap_at_zero))

    def with_more_distance(self, extra: float) -> Clearance:
        """Return the clearance for a required distance that is larger by an extra [m]."""
        farther = replace(self.site, distance=self.site.distance + extra)
        return replace(self, site=farther, known_bodies=self.bodies)

    def without(self, contacts: frozenset[ObstaclePart]) -> Clearance:
        """Return the clearance from everything but some parts of obstacles."""
        return replace(self, contacts=self.contacts | contacts, known_bodies=self.bodies)

    # --- places -----------------------------------------------------------------------------------

    def place(self, point: np.ndarray, label: str = "point") -> np.ndarray:
        """Return the place, its slew from -π to π, at which the centre of the load is at a point of
        the site [m], shape (3,). Errors call the point by a label.

        Raises:
            OutOfReach: If the crane does not reach it: how far or how high the load comes.
        """
        x, y, z = self.site.to_crane(point)
        radius = math.hypot(x, y)
        length = self.height - z
        self._refuse_radius(radius, point, label)
        self._refuse_length(length, point, label)
        return np.array([math.atan2(x, -y), radius, length])

    def _refuse_radius(self, radius: float, point: np.ndarray, label: str) -> None:
        """Refuse a point of the site [m], shape (3,), if the trolley does not reach its distance
        from the slew axis [m]. The label names the point.
        """
        inner = float(self.crane.lower[self.joints.trolley])
        outer = float(self.crane.upper[self.joints.trolley])
        if inner <= radius <= outer:
            return
        direction = "away from the axis" if radius < inner else "nearer to the axis"
        raise OutOfReach(
            f"The trolley reaches from {inner:g} to {outer:g} m from the slew axis; the {label} at "
            f"{_text(point)} is {radius:.2f} m from it. Move the {label} {direction}, or take a "
            "crane with another jib.",
            name="distance from the slew axis",
            value=radius,
            allowed=f"{inner:g} to {outer:g}",
        )

    def _refuse_length(self, length: float, point: np.ndarray, label: str) -> None:
        """Refuse a point of the site [m], shape (3,), if the hook does not reach it with the cable
        length that it needs [m]. The label names the point.
        """
        longest = float(self.crane.upper[self.joints.hoist])
        if self.shortest_cable <= length <= longest:
            return
        above = float(point[2]) - self.site.ground
        highest = above + length - self.shortest_cable
        lowest = above + length - longest
        if above > highest:
            reach = f"up to {highest:.2f}"
            change = f"Lower the {label}, or take a taller crane"
        else:
            reach = f"down to {lowest:.2f}"
            change = f"Raise the {label}, or take a crane with a longer rope"
        raise OutOfReach(
            f"The centre of this load gets {reach} m above the ground; the {label} at "
            f"{_text(point)} is {above:.2f} m above it. {change}.",
            name="height of the centre of the load",
            value=above,
            allowed=f"{lowest:.2f} to {highest:.2f}",
        )

    def point(self, drive_position: np.ndarray) -> np.ndarray:
        """Return the centre of the load in the frame of the crane [m], shape (..., 3), at places,
        shape (..., 3).
        """
        gamma, x, length = np.moveaxis(drive_position, -1, 0)
        return np.stack([x * np.sin(gamma), -x * np.cos(gamma), self.height - length], axis=-1)

    def q(self, drive_position: np.ndarray) -> np.ndarray:
        """Return all coordinates at a place, shape (n,), the load plumb."""
        q = np.zeros(self.crane.layout.n)
        q[self.drive_joints] = drive_position
        return q

    def tilt(self, q: np.ndarray) -> np.ndarray:
        """Return an upper bound of the angle of the rope from plumb [rad], shape (...), at
        coordinates of shape (..., n). Of differences of coordinates it is an upper bound of the
        angle by which the rope turns.

        The bound is √(φ² + θ²). The angle itself, acos(cos φ cos θ), is never larger and is the
        same to second order.
        """
        radial = self.joints.radial_swing
        tangential = self.joints.tangential_swing
        return np.sqrt(q[..., radial] ** 2 + q[..., tangential] ** 2)

    # --- what hangs -------------------------------------------------------------------------------

    def envelope(self, length: Length) -> Length:
        """Return how far a point of load, hook or rope may be from where it is with the load plumb
        [m], by the swing of the site on a cable of a length [m].
        """
        # A point at the distance r from the pivot moves by the chord 2 r sin(angle/2), and none is
        # farther from it than the end of the cable and what hangs below.
        return 2.0 * (length + self.bodies.below) * math.sin(self.site.swing / 2.0)

    def swing_margin(self, drive_position: np.ndarray) -> float:
        """Return the margin of all that hangs, with the envelope of its swing, at a place [m]."""
        return self.margin(self.q(drive_position)) - self.envelope(float(drive_position[2]))

    def travel(self, drive_position: np.ndarray, reach: np.ndarray) -> float:
        """Return an upper bound of the change of `swing_margin` [m] between a place and any that is
        no farther from it than a reach in each coordinate [rad, m, m], shape (3,).

        A point at the radius r from the slew axis moves by r |Δγ| + |Δx| across and by |Δl| down at
        most; the envelope grows with l.
        """
        slewed, outward, hoisted = reach.tolist()
        largest_radius = float(drive_position[1]) + outward + self.bodies.spread
        across = largest_radius * slewed + outward
        envelope_growth = 2.0 * math.sin(self.site.swing / 2.0) * hoisted
        return math.hypot(across, hoisted) + envelope_growth

    def margin(self, q: np.ndarray) -> float:
        """Return the margin of all that hangs at coordinates of all joints, shape (n,), as they
        are, without an envelope [m].
        """
        return min(self._margins(q))

    def least_distance(self, q: np.ndarray) -> float:
        """Return the distance of all that hangs from the nearest obstacle, less `ROUNDING` [m], at
        coordinates of all joints, shape (n,). Zones count where something is in them.
        """
        margin, zone_distance = self._margins(q)
        distance = margin + self.site.distance
        return min(distance, zone_distance) if zone_distance <= 0.0 else distance

    def nearest_row(self, q: np.ndarray) -> int:
        """Return the row of a motion, shape (rows, n), in which `least_distance` is smallest, or
        nearly: of every fourth row, to save time, and then of those beside the best. A dip of less
        than four rows may be missed; no proof rests on this.
        """

        def nearest_of(rows: range) -> int:
            return min(rows, key=lambda row: self.least_distance(q[row]))

        coarse = nearest_of(range(0, len(q), 4))
        return nearest_of(range(max(coarse - 3, 0), min(coarse + 4, len(q))))

    def displacement(self, q: np.ndarray, q_end: np.ndarray) -> np.ndarray:
        """Return an upper bound of the displacement of any point that hangs between coordinates,
        shape (..., n) each; in [m], shape (...).

        Drives move it one after the other: slew and trolley across, the hoist along a rope that
        leans and so takes it across, too.
        """
        largest_tilt = np.maximum(self.tilt(q), self.tilt(q_end))
        aside = np.minimum(largest_tilt, 1.0)  # the sine of the tilt is no larger
        change = np.abs(q_end - q)
        slewed = change[..., self.joints.slew]
        outward = change[..., self.joints.trolley]
        hoisted = change[..., self.joints.hoist]
        radius = np.maximum(q[..., self.joints.trolley], q_end[..., self.joints.trolley])
        cable = np.maximum(q[..., self.joints.hoist], q_end[..., self.joints.hoist])
        length = cable + self.bodies.below

        # Slew and trolley move a point horizontally, by `across`. The hoist moves it along the
        # rope, whose horizontal part is `aside`: the cosine of the angle between both displacements
        # is `aside` at most, and the law of cosines bounds their sum. Last, the change of the swing
        # turns the rope.
        across = (radius + self.bodies.spread + length * aside) * slewed + outward
        driven = np.sqrt(across**2 + hoisted**2 + 2.0 * aside * across * hoisted)
        return driven + length * self.tilt(change)

    # --- what slews with the jib ------------------------------------------------------------------

    def slewing_margin(self, gamma: float) -> float:
        """Return the margin of all that slews with the jib at a slew angle [rad]; in [m].

        At an angle that is not finite it is minus infinity, from which nothing is proven.
        """
        if not math.isfinite(gamma):
            return -math.inf
        solids = self._fields.solids
        return min(solids.least(moving) for moving in self._slewing(gamma)) - ROUNDING

    def nearest_to_jib(self, gamma: float) -> str:
        """Return the name of the solid that is nearest to all that slews with the jib, at a slew
        angle [rad]; empty if there is none.
        """
        nearest = (math.inf, "")
        for moving in self._slewing(gamma):
            for name, distance in self._fields.solids.distances(moving).items():
                nearest = min(nearest, (distance, name))
        return nearest[1]

    @cached_property
    def slewing_radius(self) -> float:
        """Upper bound of the distance from the slew axis of all that slews with the jib [m]."""
        return max(body.radius for body in self._slewing_bodies)

    # --- by name ----------------------------------------------------------------------------------

    def distances(self, q: np.ndarray, *, jib: bool = True) -> dict[str, Nearest]:
        """Return the nearest body to each obstacle, by name of the obstacle, at coordinates of all
        joints, shape (n,); with or without the jib.
        """
        nearest: dict[str, Nearest] = {}

        def compare(body: str, field: Field, moving: Placed) -> None:
            for name, distance in field.distances(moving).items():
                pair = Nearest(distance + moving.inflated, body, name)
                nearest[name] = min(nearest.get(name, pair), pair)

        # A body stays at its place only until the next one is asked for.
        for body, field, moving in itertools.chain(self._placed(q), self._placed_below_upper(q)):
            compare(body, field, moving)
        if jib:
            for moving in self._slewing(float(q[self.joints.slew])):
                compare("jib", self._fields.solids, moving)
        return nearest

    def nearest(self, q: np.ndarray, *, count_zones: bool = False) -> Nearest:
        """Return the pair of body and obstacle with the least margin at coordinates of all joints,
        shape (n,), the jib left out.

        Args:
            q: The coordinates.
            count_zones: Whether zones count with their distance as the margin. Otherwise a zone
                counts only if something is in it.
        """
        zones = {solid.name for solid in self.solids if solid.zone}

        def margin(pair: Nearest) -> float:
            if pair.obstacle in zones:
                return pair.distance
            return pair.distance - self.site.distance

        pairs = []
        for pair in self.distances(q, jib=False).values():
            if count_zones or pair.obstacle not in zones or pair.distance <= 0.0:
                pairs.append(pair)
        return min(pairs, key=margin)

    def nearest_points(self, q: np.ndarray, margin_limit: float) -> Iterator[NearestPoints]:
        """Yield the nearest points of each body that hangs and each shape that it is compared with,
        but for the own upper structure, at coordinates of all joints, shape (n,): those whose
        margin is below a limit [m].
        """
        for body, field, moving in self._placed(q):
            for pair in field.nearest_points(moving):
                margin = pair.distance - moving.inflated
                if margin < margin_limit:
                    yield NearestPoints(
                        margin, moving.inflated, body, pair.on_body, pair.on_shape, pair.normal
                    )

    # --- what is compared with what, see `cranedyn.lifts.planning.coverage` -----------------------

    def hanging_fields(self) -> Iterator[tuple[str, Field]]:
        """Yield the name of each body that hangs, and of the trolley, with the obstacles that it is
        compared with.
        """
        for hanging in self._hanging:
            for field in hanging.fields:
                yield hanging.name, field
        for name, _ in self._load_and_hook:
            yield name, self._low_upper_field

    @property
    def own_shape_counts(self) -> dict[str, int]:
        """Number of shapes of each part of the crane that is an obstacle to what hangs, by name."""
        return {
            MAST: len(self.bodies.mast),
            OWN_BASE: int(self.site.base is not None),
            OWN_UPPER: len(self._low_upper_parts),
        }

    @property
    def slewing_field(self) -> Field:
        """The obstacles that all that slews with the jib is compared with."""
        return self._fields.solids

    @property
    def trolley_bottom(self) -> float:
        """Height of the underside of the trolley above the crane's foot [m]."""
        trolley = self.bodies.trolley
        return self.height + float(trolley.centre[2] - trolley.size[2] / 2.0)

    # --- inside -----------------------------------------------------------------------------------

    @cached_property
    def _fields(self) -> _Fields:
        """The obstacles, by what keeps from them."""
        solids = self._shapes_of([solid for solid in self.solids if not solid.zone])
        zones = self._shapes_of([solid for solid in self.solids if solid.zone])

        # The trolley is at a constant height: solids that end far enough below it never come close
        # to it. Margins count with the envelope of the longest cable, so that it is deducted, too.
        longest = float(self.crane.upper[self.joints.hoist])
        low = self.trolley_bottom - self.site.distance - self.envelope(longest)
        tall = set()
        for solid in self.solids:
            if solid.vertices[:, 2].max() > low - ROUNDING:
                tall.add(solid.name)

        mast = [(MAST, hull(corners)) for corners in self.bodies.mast]
        if self.site.base is not None:
            mast.append((OWN_BASE, hull(self.site.base_corners)))

        level = self.site.ground - float(self.site.foot[2])
        ground = [(GROUND, coal.Halfspace(np.array([0.0, 0.0, 1.0]), level))]
        if any(part.obstacle == GROUND for part in self.contacts):
            ground = []
        return _Fields(
            solids=Field(solids),
            tall_solids=Field((name, shape) for name, shape in solids if name in tall),
            solids_and_mast=Field([*solids, *mast]),
            zones=Field(zones),
            ground=Field(ground),
        )

    @staticmethod
    def _shapes_of(solids: list[Solid]) -> list[tuple[str, coal.CollisionGeometry]]:
        """Return the shapes of solids, each with the name of its solid."""
        return [(solid.name, shape) for solid in solids for shape in solid.geometries()]

    @cached_property
    def _hanging(self) -> list[_HangingBody]:
        """Bodies that hang and the trolley, with what they keep from. Bodies that are not inflated
        keep out of zones, which need no distance. A body that keeps from nothing is left out.
        """
        fields = self._fields
        distance = self.site.distance
        load = hull(self.bodies.load)
        hook = coal.Box(self.bodies.hook.size)
        hook_place = coal.Transform3s(np.eye(3), self.bodies.hook.centre)
        trolley = coal.Box(self.bodies.trolley.size)
        trolley_place = coal.Transform3s(np.eye(3), self.bodies.trolley.centre)
        rope = coal.Capsule(self.bodies.falls, 1.0)  # stretched to its length where it is placed
        bodies = [
            _HangingBody("trolley", Body(trolley, distance, trolley_place), [fields.tall_solids]),
            _HangingBody("rope", Body(rope, distance), [fields.solids_and_mast]),
            _HangingBody("hook", Body(hook, distance, hook_place), [fields.solids_and_mast]),
            _HangingBody("load", Body(load, distance), [fields.solids_and_mast, fields.ground]),
            _HangingBody("rope", Body(rope, 0.0), [fields.zones]),
            _HangingBody("hook", Body(hook, 0.0, hook_place), [fields.zones]),
            _HangingBody("load", Body(load, 0.0), [fields.zones]),
        ]
        hanging = []
        for candidate in bodies:
            not_empty = [field for field in candidate.fields if len(field)]
            if not_empty:
                hanging.append(candidate._replace(fields=not_empty))
        return hanging

    @cached_property
    def _slewing_bodies(self) -> list[Body]:
        """All that slews with the jib, inflated by the required distance."""
        bodies = []
        for shape in self.bodies.upper:
            within = coal.Transform3s(shape.rotation, shape.translation)
            bodies.append(Body(shape.geometry, self.site.distance, within))
        return bodies

    @cached_property
    def _low_upper_parts(self) -> list[np.ndarray]:
        """Corners of each shape that slews with the jib and reaches below the trolley, such as a
        slewing column or a cab, in the frame of the slew joint [m], shape (n, 3) each.

        A shape that reaches out to the middle of the trolley's way is taken for the jib itself,
        below which the load hangs, and left out. Of a jib of many bars, those that end before count
        as obstacles if they reach below the trolley.
        """
        (frame,) = self._frames(self.crane.start.q, self.joints.slew)
        bottom = self.trolley_bottom - float(frame.getTranslation()[2])
        trolley = self.joints.trolley
        middle = float(self.crane.lower[trolley] + self.crane.upper[trolley]) / 2.0
        parts = []
        for shape in self.bodies.upper:
            corners = corners_of(shape)
            reach_along_jib = (-corners[:, 1]).max()  # the jib points along -Y
            if corners[:, 2].min() < bottom and reach_along_jib < middle:
                parts.append(corners)
        return parts

    @cached_property
    def _low_upper_bottom(self) -> float:
        """Height of the lowest corner of `_low_upper_parts` above the crane's foot [m]; infinite
        where there is none.
        """
        (frame,) = self._frames(self.crane.start.q, self.joints.slew)
        lowest = min((float(part[:, 2].min()) for part in self._low_upper_parts), default=math.inf)
        return float(frame.getTranslation()[2]) + lowest

    @cached_property
    def _low_upper_field(self) -> Field:
        """The hulls of `_low_upper_parts` as obstacles, in the frame of the slew joint."""
        return Field((OWN_UPPER, hull(corners)) for corners in self._low_upper_parts)

    @cached_property
    def _load_and_hook(self) -> list[tuple[str, Body]]:
        """Load and hook, for distances from `_low_upper_parts`. The rope needs none: it begins at
        the trolley, which is never where these parts are, and ends at the hook.
        """
        distance = self.site.distance
        hook = self.bodies.hook
        hook_place = coal.Transform3s(np.eye(3), hook.centre)
        return [
            ("load", Body(hull(self.bodies.load), distance)),
            ("hook", Body(coal.Box(hook.size), distance, hook_place)),
        ]

    def _gap_by_height(self, q: np.ndarray) -> float:
        """Return a lower bound of the margin of load and hook to `_low_upper_parts` [m]: that of
        their heights alone, which needs no kinematics.
        """
        length = float(q[self.joints.hoist])
        radial = q[self.joints.radial_swing]
        tangential = q[self.joints.tangential_swing]
        below_pivot = length * math.cos(radial) * math.cos(tangential)
        top = self.height - below_pivot + self._reach_up
        return self._low_upper_bottom - top - self.site.distance

    @cached_property
    def _reach_up(self) -> float:
        """Largest distance of a point of load or hook from the end of the cable [m], by which it
        may be above that.
        """
        hook_top = math.hypot(float(self.bodies.hook.top), self.bodies.spread)
        return max(self.bodies.below, hook_top)

    def _placed_below_upper(self, q: np.ndarray) -> Iterator[tuple[str, Field, Placed]]:
        """Yield load and hook, each with `_low_upper_field` and placed in the frame of the slew
        joint, in which that stays at rest.
        """
        if not self._low_upper_parts:
            return
        slew, load = self._frames(q, self.joints.slew, self.joints.hoist)
        relative = slew.inverse() * load
        for name, body in self._load_and_hook:
            yield name, self._low_upper_field, body.put(relative)

    def _margins(self, q: np.ndarray) -> tuple[float, float]:
        """Return two margins of all that hangs [m]: to everything but zones, and to zones. Both are
        minus infinity, from which nothing is proven, where a coordinate is not finite.
        """
        if not np.isfinite(q).all():
            return -math.inf, -math.inf
        margin = math.inf
        zone_margin = math.inf
        for _, field, moving in self._placed(q):
            if moving.inflated == 0.0:  # only what keeps out of zones is not inflated
                zone_margin = min(zone_margin, field.least(moving))
            else:
                margin = min(margin, field.least(moving))
        # The own upper structure nearly always is far above the load, and then needs no query: if
        # the bound of its margin is not below the other margins, the least of all stays the same.
        if self._gap_by_height(q) < margin:
            for _, field, moving in self._placed_below_upper(q):
                margin = min(margin, field.least(moving))
        return margin - ROUNDING, zone_margin - ROUNDING

    def _placed(self, q: np.ndarray) -> Iterator[tuple[str, Field, Placed]]:
        """Yield the name of each body that hangs, and of the trolley, with obstacles that it is
        compared with, and the body at its place, where it stays until it is placed again.
        """
        trolley, load = self._frames(q, self.joints.trolley, self.joints.hoist)
        length = float(q[self.joints.hoist])
        for name, body, fields in self._hanging:
            if name == "rope":
                body.stretch(length)
            moving = body.put(trolley if name == "trolley" else load)
            for field in fields:
                yield name, field, moving

    def _slewing(self, gamma: float) -> Iterator[Placed]:
        """Yield all that slews with the jib, at a slew angle [rad]."""
        (frame,) = self._frames(self.q(np.array([gamma, 0.0, 0.0])), self.joints.slew)
        for body in self._slewing_bodies:
            yield body.put(frame)

    @cached_property
    def _data(self) -> tuple[pin.Data, list[pin.SE3]]:
        """Pinocchio's data, and the frames of the joints in it, which it overwrites."""
        data = self.crane.model.createData()
        return data, [*data.oMi]

    def _frames(self, q: np.ndarray, *joints: int) -> list[coal.Transform3s]:
        """Return the frames of joints, by their indices among the coordinates."""
        data, frames = self._data
        with _KINEMATICS:
            pin.forwardKinematics(self.crane.model, data, q)
            return [coal.Transform3s(frames[joint + 1]) for joint in joints]


def _text(point: np.ndarray) -> str:
    """Return the coordinates of a point [m], to the millimetre."""
    return str(np.round(point, 3).tolist())
