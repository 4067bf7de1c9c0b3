"""Distances between crane, load and obstacles.

A place is slew [rad], trolley radius [m] and cable length [m] with the load plumb, shape (3,). A
margin is a distance beyond the required one. The shapes are inflated by the required distance, and
the swing of the load is an envelope about them.
"""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import coal
import numpy as np
import pinocchio as pin

from cranedyn.errors import CraneError, OutOfRange
from cranedyn.model.crane import Crane
from cranedyn.planning.bodies import CollisionBodies, collision_bodies, corners_of
from cranedyn.planning.fields import Body, Field, Placed
from cranedyn.planning.site import GROUND, MAST, OWN_BASE, OWN_UPPER, Site
from cranedyn.planning.solids import Solid, hull

ROUNDING = 1e-4
"""Deduction from every distance [m]: a hundred times the tolerance of coal's algorithm."""

_KINEMATICS = threading.Lock()
"""Held while Pinocchio's data is written and read; all else is the same for all threads."""

_KEEPS_FROM = (
    ("trolley", "inflated", ("tall solids",)),
    ("rope", "inflated", ("solids and mast",)),
    ("hook", "inflated", ("solids and mast",)),
    ("load", "inflated", ("solids and mast", "ground")),
    ("rope", "bare", ("zones",)),
    ("hook", "bare", ("zones",)),
    ("load", "bare", ("zones",)),
)
"""Obstacles that each body, inflated by the required distance or bare, keeps from. The load hangs
lowest, and solids that are not tall never come close to the trolley, whose height is constant."""

Length = TypeVar("Length", float, np.ndarray)


class OutOfReach(OutOfRange):
    """A place that the load of a crane does not reach."""

    def __init__(self, sentence: str, limit: tuple[str, float, str]) -> None:
        """Set the attributes and the error message.

        Args:
            sentence: The message.
            limit: What is out of its range, how much it is [m], and the range in words.
        """
        self.name, self.value, self.allowed = limit
        self.unit = "m"
        CraneError.__init__(self, sentence)


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
        obstacle: Name of the solid, "ground" or "own mast".
    """

    distance: float
    body: str
    obstacle: str


class Touch(NamedTuple):
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


@dataclass(frozen=True, eq=False)
class Clearance:
    """Crane and site, and the distances between them.

    Attributes:
        crane: The crane.
        site: The site.
        contacts: Parts of obstacles that the load stands on, which do not count here. Who leaves
            them out must show otherwise that nothing enters them: `cranedyn.planning.support`.
    """

    crane: Crane
    site: Site
    contacts: frozenset[ObstaclePart] = frozenset()

    def __post_init__(self) -> None:
        """Check that a place determines the crane.

        Raises:
            MissingRole: If it is not a tower crane.
            ModelError: If it moves in other joints, too.
        """
        _ = self.joints

    def __getstate__(self) -> dict[str, Any]:
        """Return crane, site and contacts alone: coal's bodies cannot be pickled, and what is
        computed from these three is computed again where it is needed.
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
        kept = (
            solid.without_parts(
                part.number for part in self.contacts if part.obstacle == solid.name
            )
            for solid in self.site.seen_by_crane()
        )
        return [solid for solid in kept if solid is not None]

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
        (_, _, hook), (_, _, tall) = self.bodies.hook
        (_, _, trolley), (_, _, deep) = self.bodies.trolley
        hanging = float(hook + tall / 2.0 - trolley + deep / 2.0)
        return max(float(self.crane.lower[self.joints.hoist]), hanging)

    def with_more_distance(self, extra: float) -> Clearance:
        """Return the clearance for a required distance that is larger by an extra [m]."""
        return self._changed(site=replace(self.site, distance=self.site.distance + extra))

    def without(self, contacts: frozenset[ObstaclePart]) -> Clearance:
        """Return the clearance from everything but some parts of obstacles."""
        return self._changed(contacts=self.contacts | contacts)

    def _changed(self, **changes: Any) -> Clearance:
        changed = replace(self, **changes)
        changed.__dict__["bodies"] = self.bodies
        return changed

    # --- places -----------------------------------------------------------------------------------

    def place(self, point: np.ndarray, label: str = "point") -> np.ndarray:
        """Return the place, its slew from -π to π, at which the centre of the load is at a point of
        the site [m], shape (3,), that errors call by a label.

        Raises:
            OutOfReach: If the crane does not reach it: how far or how high the load comes.
        """
        x, y, z = self.site.to_crane(point)
        radius, length = math.hypot(x, y), self.height - z
        (_, inner, _), (_, outer, longest) = (
            ends[self.drive_joints].tolist() for ends in (self.crane.lower, self.crane.upper)
        )
        place = f"the {label} {np.round(point, 3).tolist()}"
        if not inner <= radius <= outer:
            way = "farther out" if radius < inner else "nearer to it"
            raise OutOfReach(
                f"The trolley reaches from {inner:g} to {outer:g} m from the slew axis, {place} is "
                f"{radius:.2f} m from it; move it {way}, or take a crane with another jib.",
                ("distance from the slew axis", radius, f"{inner:g} to {outer:g}"),
            )
        if not self.shortest_cable <= length <= longest:
            above = float(point[2]) - self.site.ground
            highest, lowest = (above + length - cable for cable in (self.shortest_cable, longest))
            reaches = f"at most {highest:.2f}" if above > highest else f"no lower than {lowest:.2f}"
            limit = f"reaches {reaches} m above the ground with the centre of this load"
            change = "lower it" if above > highest else "raise it"
            other = "a taller crane" if above > highest else "a crane with a longer rope"
            raise OutOfReach(
                f"The hook {limit}, {place} is at {above:.2f} m; {change}, or take {other}.",
                ("height of the centre of the load", above, f"{lowest:.2f} to {highest:.2f}"),
            )
        return np.array([math.atan2(x, -y), radius, length])

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
        """Return the angle of the rope from plumb [rad], shape (...), at coordinates of shape (...,
        n); of differences of coordinates, its change.
        """
        radial, tangential = self.joints.radial_swing, self.joints.tangential_swing
        return np.sqrt(q[..., radial] ** 2 + q[..., tangential] ** 2)

    # --- what hangs -------------------------------------------------------------------------------

    def envelope(self, length: Length) -> Length:
        """Return the largest displacement of a point of load, hook or rope from its place with the
        load plumb [m], by the swing of the site on a cable of a length [m].
        """
        return 2.0 * (length + self.bodies.below) * math.sin(self.site.swing / 2.0)

    def swing_margin(self, drive_position: np.ndarray) -> float:
        """Return the margin of all that hangs with its envelope of swing at a place [m]."""
        return self.margin(self.q(drive_position)) - self.envelope(float(drive_position[2]))

    def travel(self, drive_position: np.ndarray, reach: np.ndarray) -> float:
        """Return an upper bound of the change of `swing_margin` between a place and one that is no
        farther from it than a reach in each coordinate [m].

        A point at the radius r from the slew axis moves by r |Δγ| + |Δx| across and by |Δl| down at
        most; the envelope grows with l.
        """
        gamma, x, length = reach.tolist()
        across = (float(drive_position[1]) + x + self.bodies.spread) * gamma + x
        return math.hypot(across, length) + 2.0 * math.sin(self.site.swing / 2.0) * length

    def margin(self, q: np.ndarray) -> float:
        """Return the margin of all that hangs at coordinates of all joints, shape (n,), as they
        are, without an envelope [m].
        """
        return min(self._margins(q))

    def least_distance(self, q: np.ndarray) -> float:
        """Return the least distance of all that hangs [m], at coordinates of all joints, shape
        (n,); zones count where something is in them.
        """
        margin, in_zones = self._margins(q)
        return min(margin + self.site.distance, in_zones if in_zones <= 0.0 else math.inf)

    def nearest_row(self, q: np.ndarray) -> int:
        """Return the row of a motion, shape (rows, n), in which the least distance is least: of
        every fourth row, then of those beside the best.
        """

        def least(rows: range) -> int:
            return min(rows, key=lambda k: self.least_distance(q[k]))

        k = least(range(0, len(q), 4))
        return least(range(max(k - 3, 0), min(k + 4, len(q))))

    def displacement(self, q: np.ndarray, q_end: np.ndarray) -> np.ndarray:
        """Return an upper bound of the displacement of any point that hangs between coordinates,
        shape (..., n) each; in [m], shape (...).

        Drives move it one after the other: slew and trolley across, the hoist along a rope that
        leans and so takes it across, too.
        """
        aside = np.minimum(np.maximum(self.tilt(q), self.tilt(q_end)), 1.0)  # sin(x) is less
        change = np.abs(q_end - q)
        slewed, outward, hoisted = (change[..., joint] for joint in self.drive_joints)
        _, x, length = (np.maximum(q[..., joint], q_end[..., joint]) for joint in self.drive_joints)
        length = length + self.bodies.below
        across = (x + self.bodies.spread + length * aside) * slewed + outward
        driven = np.sqrt(across**2 + hoisted**2 + 2.0 * aside * across * hoisted)
        return driven + length * self.tilt(change)

    # --- what slews with the jib ------------------------------------------------------------------

    def slewing_margin(self, gamma: float) -> float:
        """Return the margin of all that slews with the jib at a slew angle [rad]; in [m].

        At an angle that is not finite it is minus infinity, from which nothing is proven.
        """
        if not math.isfinite(gamma):
            return -math.inf
        field = self._fields["solids"]
        return min(field.least(moving) for moving in self._slewing(gamma)) - ROUNDING

    @cached_property
    def slewing_radius(self) -> float:
        """Upper bound of the distance from the slew axis of all that slews with the jib [m]."""
        return max(body.radius for body in self._upper)

    # --- by name ----------------------------------------------------------------------------------

    def distances(self, q: np.ndarray, *, jib: bool = True) -> dict[str, Nearest]:
        """Return the nearest body to each obstacle, by name of the obstacle, at coordinates of all
        joints, shape (n,); with or without the jib.
        """
        nearest: dict[str, Nearest] = {}
        jib_parts = self._slewing(float(q[self.joints.slew])) if jib else ()
        slewing = (("jib", self._fields["solids"], moving) for moving in jib_parts)
        own = self._beside_upper(q)
        for body, field, moving in itertools.chain(self._placed(q), own, slewing):
            for name, distance in field.each(moving).items():
                pair = Nearest(distance + moving.inflated, body, name)
                nearest[name] = min(nearest.get(name, pair), pair)
        return nearest

    def nearest(self, q: np.ndarray, *, beside_zones: bool = False) -> Nearest:
        """Return the pair of body and obstacle with the least margin at coordinates of all joints,
        shape (n,); zones count where something is in them, or always beside zones.
        """
        zones = {solid.name for solid in self.solids if solid.zone}
        pairs = [
            pair
            for pair in self.distances(q, jib=False).values()
            if beside_zones or pair.obstacle not in zones or pair.distance <= 0.0
        ]
        required = self.site.distance
        return min(pairs, key=lambda pair: pair.distance - required * (pair.obstacle not in zones))

    def touches(self, q: np.ndarray, margin_limit: float) -> Iterator[Touch]:
        """Yield the nearest points of each body that hangs and each obstacle at coordinates of all
        joints, shape (n,), but for those with a margin from a limit on [m].
        """
        for body, field, moving in self._placed(q):
            for distance, on_body, on_obstacle, normal in field.witnesses(moving):
                if (margin := distance - moving.inflated) < margin_limit:
                    yield Touch(margin, moving.inflated, body, on_body, on_obstacle, normal)

    # --- what is compared with what, see `cranedyn.planning.coverage` -----------------------------

    def hanging_fields(self) -> Iterator[tuple[str, Field]]:
        """Yield the name of each body that hangs, and of the trolley, with the obstacles that it is
        compared with.
        """
        for name, _, fields in self._hanging:
            for field in fields:
                yield name, field
        for name, _ in self._below_upper:
            yield name, self._upper_field

    @property
    def own_shape_counts(self) -> dict[str, int]:
        """Number of shapes of each part of the crane that is an obstacle to what hangs, by name."""
        return {
            MAST: len(self.bodies.mast),
            OWN_BASE: int(self.site.base is not None),
            OWN_UPPER: len(self._upper_parts),
        }

    @property
    def slewing_field(self) -> Field:
        """The obstacles that all that slews with the jib is compared with."""
        return self._fields["solids"]

    @property
    def trolley_bottom(self) -> float:
        """Height of the underside of the trolley above the crane's foot [m]."""
        (_, _, centre), (_, _, height) = self.bodies.trolley
        return self.height + float(centre - height / 2.0)

    # --- inside -----------------------------------------------------------------------------------

    @cached_property
    def _fields(self) -> dict[str, Field]:
        level = self.site.ground - float(self.site.foot[2])
        level_ground = coal.Halfspace(np.array([0.0, 0.0, 1.0]), level)
        stands_on_ground = any(part.obstacle == GROUND for part in self.contacts)
        named = [(s.zone, (s.name, shape)) for s in self.solids for shape in s.geometries()]
        solids = [pair for zone, pair in named if not zone]
        zones = [pair for zone, pair in named if zone]
        envelope = self.envelope(float(self.crane.upper[self.joints.hoist]))
        low = self.trolley_bottom - self.site.distance - envelope
        tall = {solid.name for solid in self.solids if solid.vertices[:, 2].max() > low - ROUNDING}
        mast = [(MAST, hull(corners)) for corners in self.bodies.mast]
        if self.site.base is not None:
            mast.append((OWN_BASE, hull(self.site.base_corners)))
        return {
            "solids": Field(solids),
            "tall solids": Field(named for named in solids if named[0] in tall),
            "solids and mast": Field([*solids, *mast]),
            "zones": Field(zones),
            "ground": Field([] if stands_on_ground else [(GROUND, level_ground)]),
        }

    @cached_property
    def _hanging(self) -> list[tuple[str, Body, list[Field]]]:
        """Bodies that hang and what they keep from."""
        shapes: dict[str, tuple[Any, ...]] = {
            "load": (hull(self.bodies.load), None),
            "rope": (coal.Capsule(self.bodies.falls, 1.0), None),
        }
        for name, (centre, size) in (("trolley", self.bodies.trolley), ("hook", self.bodies.hook)):
            shapes[name] = coal.Box(size), coal.Transform3s(np.eye(3), centre)
        hanging = []
        for name, variant, kinds in _KEEPS_FROM:
            inflated = self.site.distance if variant == "inflated" else 0.0
            shape, within = shapes[name]
            fields = [self._fields[kind] for kind in kinds if len(self._fields[kind])]
            if fields:
                hanging.append((name, Body(shape, inflated, within), fields))
        return hanging

    @cached_property
    def _above(self) -> float:
        """Height of the swing pivot above the load where the hoist is at zero [m]."""
        start = self.crane.start.q
        pivot, load = self._frames(start, self.joints.radial_swing, self.joints.hoist)
        distance = math.dist(pivot.getTranslation(), load.getTranslation())
        return distance - float(start[self.joints.hoist])

    @cached_property
    def _upper(self) -> list[Body]:
        return [
            Body(shape, self.site.distance, coal.Transform3s(*placement))
            for shape, *placement in self.bodies.upper
        ]

    @cached_property
    def _upper_parts(self) -> list[np.ndarray]:
        """Corners of each shape that slews with the jib and reaches below the trolley, in the frame
        of the slew joint [m], shape (n, 3) each.

        Shapes that reach out to the middle of the trolley's way are the jib itself, under which the
        load hangs by construction.
        """
        (frame,) = self._frames(self.crane.start.q, self.joints.slew)
        bottom = self.trolley_bottom - float(frame.getTranslation()[2])
        trolley = self.joints.trolley
        middle = float(self.crane.lower[trolley] + self.crane.upper[trolley]) / 2.0
        shapes = [corners_of(shape) for shape in self.bodies.upper]
        return [
            corners
            for corners in shapes
            if corners[:, 2].min() < bottom and (-corners[:, 1]).max() < middle
        ]

    @cached_property
    def _upper_bottom(self) -> float:
        """Height of the lowest corner of `_upper_parts` above the crane's foot [m]; infinite where
        there is none.
        """
        (frame,) = self._frames(self.crane.start.q, self.joints.slew)
        lowest = min((float(part[:, 2].min()) for part in self._upper_parts), default=math.inf)
        return float(frame.getTranslation()[2]) + lowest

    @cached_property
    def _upper_field(self) -> Field:
        """The hulls of `_upper_parts`, in the frame of the slew joint."""
        return Field((OWN_UPPER, hull(corners)) for corners in self._upper_parts)

    @cached_property
    def _below_upper(self) -> list[tuple[str, Body]]:
        """Load and hook, for distances from what slews above them. The rope hangs from the trolley,
        and so is beside them wherever that can be.
        """
        centre, size = self.bodies.hook
        distance = self.site.distance
        return [
            ("load", Body(hull(self.bodies.load), distance)),
            ("hook", Body(coal.Box(size), distance, coal.Transform3s(np.eye(3), centre))),
        ]

    def _upper_gap(self, q: np.ndarray) -> float:
        """Return a lower bound of the margin of load and hook to what slews below the trolley [m]:
        that of their heights alone, which needs no kinematics.
        """
        length = float(q[self.joints.hoist]) + self._above
        radial, tangential = q[self.joints.radial_swing], q[self.joints.tangential_swing]
        below_pivot = length * math.cos(radial) * math.cos(tangential)
        top = self.height - below_pivot + self._reach_above
        return self._upper_bottom - top - self.site.distance

    @cached_property
    def _reach_above(self) -> float:
        """Largest distance of a point of load or hook from the end of the cable [m]."""
        (_, _, centre), (_, _, tall) = self.bodies.hook
        hook_top = math.hypot(float(centre + tall / 2.0), self.bodies.spread)
        return max(self.bodies.below, hook_top)

    def _beside_upper(self, q: np.ndarray) -> Iterator[tuple[str, Field, Placed]]:
        """Yield load and hook in the frame of the slew joint, with what slews with it."""
        if not self._upper_parts:
            return
        slew, load = self._frames(q, self.joints.slew, self.joints.hoist)
        relative = slew.inverse() * load
        for name, body in self._below_upper:
            yield name, self._upper_field, body.put(relative)

    def _margins(self, q: np.ndarray) -> tuple[float, float]:
        """Return the margins of all that hangs to everything but zones, and to zones [m]; minus
        infinity, which nothing is proven from, at coordinates that are not finite.
        """
        if not np.isfinite(q).all():
            return -math.inf, -math.inf
        margins = [math.inf, math.inf]
        for _, field, moving in self._placed(q):
            zones = moving.inflated == 0.0
            margins[zones] = min(margins[zones], field.least(moving))
        # Its own upper structure is far above the load nearly always, and then needs no query: a
        # bound that is no less than the other margins leaves the least of all as it is.
        if self._upper_gap(q) < margins[0]:
            for _, field, moving in self._beside_upper(q):
                margins[0] = min(margins[0], field.least(moving))
        return margins[0] - ROUNDING, margins[1] - ROUNDING

    def _placed(self, q: np.ndarray) -> Iterator[tuple[str, Field, Placed]]:
        """Yield each body that hangs with the obstacles that it must keep away from. It stays at
        its place until it is placed again.
        """
        trolley, load = self._frames(q, self.joints.trolley, self.joints.hoist)
        length = float(q[self.joints.hoist]) + self._above
        for name, body, fields in self._hanging:
            if name == "rope":
                body.stretch(length)
            moving = body.put(trolley if name == "trolley" else load)
            for field in fields:
                yield name, field, moving

    def _slewing(self, gamma: float) -> Iterator[Placed]:
        (frame,) = self._frames(self.q(np.array([gamma, 0.0, 0.0])), self.joints.slew)
        for body in self._upper:
            yield body.put(frame)

    @cached_property
    def _data(self) -> tuple[pin.Data, list[pin.SE3]]:
        data = self.crane.model.createData()
        return data, [*data.oMi]

    def _frames(self, q: np.ndarray, *joints: int) -> list[coal.Transform3s]:
        """Return the frames of joints, by their indices among the coordinates."""
        data, frames = self._data
        with _KINEMATICS:
            pin.forwardKinematics(self.crane.model, data, q)
            return [coal.Transform3s(frames[joint + 1]) for joint in joints]
