"""Distances between crane, load and obstacles.

A *place* is the positions of the three drives with which a crane lifts, shape (3,), with the load
plumb; the last is that of the hoist. Of a tower crane it is slew [rad], trolley radius [m] and
cable length [m]. Arguments that are places are called `drive_position`. A *margin* is a distance
beyond the required one. The shapes are inflated by the required distance, so that their distances
are margins. The swing of the load is an *envelope* about them: how far a point that hangs may be
from where it is with the load plumb.

`Clearance` is what a plan asks of a crane and its site. Its subclasses know how the bodies of a
crane move: `cranedyn.lifts.planning.tower_clearance` those of a tower crane, in closed form, and
`cranedyn.lifts.planning.chain_clearance` those of any other crane, from the chain of its joints.
`cranedyn.lifts.planning.clearance_of` tells which of them a crane needs.
"""

from __future__ import annotations

import itertools
import math
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import InitVar, dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self, TypeVar

import coal
import numpy as np
import pinocchio as pin

from cranedyn.errors import CraneError, OutOfRange
from cranedyn.lifts.planning.crane_bodies import CraneParts, HangingBodies
from cranedyn.lifts.planning.fields import Body, Field, Placed
from cranedyn.lifts.planning.site import GROUND, Site
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
        body: "load", "hook", "rope", "trolley", "jib" for all that slews with it, or a link that
            drives move.
        obstacle: Name of the solid, or one of `cranedyn.lifts.planning.site.RESERVED_NAMES`: the
            ground, or a part of the crane itself.
    """

    distance: float
    body: str
    obstacle: str

    @property
    def is_own(self) -> bool:
        """Whether the obstacle is a part of the crane itself."""
        return self.obstacle.startswith("own ")


class Approach(NamedTuple):
    """Where a part of the crane is nearest to an obstacle along a motion.

    Attributes:
        row: The row of the motion.
        nearest: The obstacle, and the distance there.
    """

    row: int
    nearest: Nearest


class MovingBody(NamedTuple):
    """A shape of a part of the crane that drives move above the rope.

    Attributes:
        part: Name of the part, such as the link, or "jib" for all that slews with it.
        joint: Index of the joint that carries it among the coordinates.
        body: The shape, perhaps inflated by a distance.
        field: The obstacles that it is compared with.
    """

    part: str
    joint: int
    body: Body
    field: Field


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


class ComparedBody(NamedTuple):
    """A body with the obstacles that it keeps from.

    Attributes:
        name: "load", "hook", "rope", or "trolley" of a tower crane.
        body: Its shape, inflated by the required distance; not inflated where it keeps out of
            zones.
        fields: The obstacles, in groups.
    """

    name: str
    body: Body
    fields: list[Field]


def keeping(bodies: Iterable[ComparedBody]) -> list[ComparedBody]:
    """Return bodies without groups of obstacles that are empty, and without those that then keep
    from nothing.
    """
    compared = []
    for candidate in bodies:
        not_empty = [field for field in candidate.fields if len(field)]
        if not_empty:
            compared.append(candidate._replace(fields=not_empty))
    return compared


@dataclass(frozen=True, eq=False)
class Clearance(ABC):
    """Crane and site, and the distances between them.

    Attributes:
        crane: The crane.
        site: The site.
        contacts: Parts of obstacles that the load stands on, which do not count here. Whoever
            leaves them out must show in another way that nothing sinks into them, see
            `cranedyn.lifts.planning.support`.
        jib_apart: Whether all that slews with the jib is proven by slew angles alone, see
            `cranedyn.lifts.planning.motion_proof.slew_range`, and not with what hangs.
    """

    crane: Crane
    site: Site
    contacts: frozenset[ObstaclePart] = frozenset()
    known_bodies: InitVar[HangingBodies | None] = None

    jib_apart: ClassVar[bool] = False

    def __post_init__(self, known_bodies: HangingBodies | None) -> None:
        """Check that a place determines where the crane is.

        Args:
            known_bodies: The bodies of the crane with the load of the site where they are known,
                which saves reading them from the URDF again; None to read them.

        Raises:
            MissingRole: If the crane has no joint of a role that is needed.
            ModelError: If its joints are others than those that distances are computed for.
        """
        self._refuse_other_joints()
        if known_bodies is not None:
            object.__setattr__(self, "bodies", known_bodies)

    def __getstate__(self) -> dict[str, Any]:
        """Return crane, site and contacts alone. Coal's bodies cannot be pickled, and what follows
        from these three is computed again where it is needed.
        """
        return {"crane": self.crane, "site": self.site, "contacts": self.contacts}

    # --- what a crane is, by its kind -------------------------------------------------------------

    @abstractmethod
    def _refuse_other_joints(self) -> None:
        """Refuse a crane that this class does not know, see `__post_init__`."""

    @cached_property
    @abstractmethod
    def bodies(self) -> HangingBodies:
        """The bodies of the crane and its load."""

    @property
    @abstractmethod
    def parts(self) -> CraneParts:
        """The names of these bodies."""

    @property
    @abstractmethod
    def standing(self) -> Sequence[np.ndarray]:
        """Corners of each body that stands and never moves, in the frame of the crane [m], shape
        (n, 3) each.
        """

    @property
    @abstractmethod
    def turning(self) -> int | None:
        """Index in a place of the drive that turns the crane about the vertical; None if there is
        none.
        """

    @property
    @abstractmethod
    def shortest_cable(self) -> float:
        """Least coordinate of the hoist at which the hook hangs below what carries it [m]."""

    @property
    @abstractmethod
    def reach(self) -> tuple[float, float]:
        """Least and largest distance in plan of the load from the foot of the crane [m]."""

    @property
    @abstractmethod
    def swing_inertia(self) -> float:
        """Rotational inertia of load and swing joints about the centre of the load, divided by the
        mass of the load [m²].
        """

    # --- places -----------------------------------------------------------------------------------

    @property
    def drive_joints(self) -> np.ndarray:
        """Indices of the drives of a place among the coordinates, shape (3,)."""
        return self.crane.layout.drives

    @cached_property
    def drive_names(self) -> tuple[str, ...]:
        """Names of the drives of a place."""
        return tuple(joint.role or joint.symbol for joint in self.crane.layout.driven)

    @property
    def hoist(self) -> int:
        """Index of the hoist among the coordinates."""
        return int(self.drive_joints[2])

    @property
    @abstractmethod
    def swing_joints(self) -> tuple[int, int]:
        """Indices of both swing joints among the coordinates, the first one nearer to the ground in
        the chain of joints. The frame of the first has its origin at the pivot.
        """

    @abstractmethod
    def place(self, point: np.ndarray, label: str = "point") -> np.ndarray:
        """Return the place at which the centre of the load is at a point of the site [m], shape
        (3,). Errors call the point by a label.

        Raises:
            OutOfReach: If the crane does not reach it: how far or how high the load comes.
        """

    @abstractmethod
    def highest_place(self, point: np.ndarray, label: str, reserve: float) -> np.ndarray:
        """Return the place of the load above a point of the site in plan [m], shape (2,), on the
        shortest cable and a reserve [m]. Errors call the point by a label.

        Raises:
            OutOfReach: If the crane does not reach it.
        """

    @abstractmethod
    def point(self, drive_position: np.ndarray) -> np.ndarray:
        """Return the centre of the load in the frame of the crane [m], shape (..., 3), at places,
        shape (..., 3).
        """

    @abstractmethod
    def q(self, drive_position: np.ndarray) -> np.ndarray:
        """Return all coordinates at places, shape (..., 3), the load plumb; shape (..., n)."""

    @abstractmethod
    def cable(self, q: np.ndarray) -> np.ndarray:
        """Return the length of the cable from the pivot to the centre of the load [m], shape (...),
        at coordinates of shape (..., n).
        """

    @abstractmethod
    def tilt(self, q: np.ndarray) -> np.ndarray:
        """Return an upper bound of the angle of the rope from plumb [rad], shape (...), at
        coordinates of shape (..., n).
        """

    @abstractmethod
    def swing(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the angles of both swings from plumb [rad] and their rates [rad/s], shape (..., 2)
        each, at coordinates and rates of shape (..., n).
        """

    @abstractmethod
    def hang_along(self, q: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Return coordinates whose rope points along a direction, the drives as they are.

        Args:
            q: Coordinates, shape (k, n).
            direction: Vectors of any length down along the rope, in the frame of the crane, shape
                (k, 3).
        """

    @abstractmethod
    def load_accelerations(
        self, drive_position: np.ndarray, first: np.ndarray, second: np.ndarray
    ) -> np.ndarray:
        """Return both horizontal accelerations of a plumb load, at right angles to each other,
        shape (n, 2), from places and their first and second derivatives, shape (n, 3) each.

        With derivatives by time these are the accelerations themselves [m/s²]. They are linear in
        the second derivatives and quadratic in the first ones.
        """

    @abstractmethod
    def carry(
        self, oscillating: np.ndarray, rope: np.ndarray, drive_position: np.ndarray
    ) -> np.ndarray:
        """Return the coordinates, shape (n, joints), with which the rope points along a direction
        and the centre of oscillation of the load is at a point.

        Args:
            oscillating: Centres of oscillation in the frame of the crane [m], shape (n, 3): each is
                `swing_inertia` over the cable length below the centre of a plumb load.
            rope: Unit vectors along the rope, up from load to pivot, shape (n, 3).
            drive_position: Places with the load plumb below these points, shape (n, 3), from which
                an iteration begins.
        """

    def load_turn(self, drive_position: np.ndarray) -> np.ndarray:
        """Return the angle by which the load is turned about the vertical from where it is with all
        drives at zero [rad], shape (...), at places, shape (..., 3). It is zero for a crane that
        does not turn; whether its first drive slides or not says nothing about that.
        """
        drive_position = np.asarray(drive_position, dtype=float)
        if self.turning is None:
            return np.zeros(drive_position.shape[:-1])
        axis = self.crane.layout.driven[self.turning].axis
        return math.copysign(1.0, axis[2]) * drive_position[..., self.turning]

    # --- bounds of motions ------------------------------------------------------------------------

    @abstractmethod
    def travel(self, drive_position: np.ndarray, reach: np.ndarray) -> float:
        """Return an upper bound of the change of `swing_margin` [m] between a place and any that is
        no farther from it than a reach in each coordinate [rad or m], shape (3,).
        """

    @abstractmethod
    def displacement(self, q: np.ndarray, q_end: np.ndarray) -> np.ndarray:
        """Return an upper bound of the change of `margin` between coordinates, shape (..., n) each;
        in [m], shape (...).
        """

    def displacements(self, q: np.ndarray, q_end: np.ndarray) -> np.ndarray:
        """Return upper bounds of the change of each of `margins_by_motion` between coordinates,
        shape (..., n) each; in [m], shape (..., groups).

        These bounds hold along a sequence of coordinates, too: the margin at its end is no less
        than that at its begin and the sum of the bounds of its steps allow.
        """
        return self.displacement(q, q_end)[..., None]

    # --- margins ----------------------------------------------------------------------------------

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

    def with_more_distance(self, extra: float) -> Self:
        """Return the clearance for a required distance that is larger by an extra [m]."""
        farther = replace(self.site, distance=self.site.distance + extra)
        return replace(self, site=farther, known_bodies=self.bodies)

    def without(self, contacts: frozenset[ObstaclePart]) -> Self:
        """Return the clearance from everything but some parts of obstacles."""
        return replace(self, contacts=self.contacts | contacts, known_bodies=self.bodies)

    def envelope(self, length: Length) -> Length:
        """Return how far a point of load, hook or rope may be from where it is with the load plumb
        [m], by the swing of the site on a cable of a length [m].
        """
        # No point is farther from the pivot than the end of the cable and what hangs below.
        return (length + self.bodies.below) * self.swing_chord

    @cached_property
    def swing_chord(self) -> float:
        """How far a point moves at most where the rope leans by the swing of the site, over its
        distance from the pivot.

        A point at the distance r moves by the chord 2 r sin(α/2), where α is the angle by which the
        load turns. Two swings φ and θ about axes at right angles lean the rope by s with cos s =
        cos φ cos θ, and turn the load by α with 1 + 2 cos α = cos φ + cos θ + cos φ cos θ, the
        trace of their rotation matrix. That is more than s, and most where φ = θ.
        """
        lean = math.cos(self.site.swing)
        turn = math.acos((2.0 * math.sqrt(lean) + lean - 1.0) / 2.0)
        return 2.0 * math.sin(turn / 2.0)

    def margins_by_motion(self, q: np.ndarray) -> np.ndarray:
        """Return the least margin at coordinates of all joints, shape (n,), of each group of bodies
        that has a bound of its own of how far it moves, see `displacements`; in [m], shape
        (groups,). The least of them is a lower bound of `margin`.
        """
        return np.array([self.margin(q)])

    def swing_margin(self, drive_position: np.ndarray) -> float:
        """Return the margin at a place [m], with the envelope of the swing of what hangs."""
        q = self.q(drive_position)
        return self.margin(q, self.envelope(float(self.cable(q))))

    def margin(self, q: np.ndarray, envelope: float = 0.0) -> float:
        """Return the least margin at coordinates of all joints, shape (n,), as they are [m].

        Args:
            q: The coordinates.
            envelope: How far a point that hangs may be from where the coordinates have it [m].
        """
        return min(self._margins(q)) - envelope

    def least_distance(self, q: np.ndarray) -> float:
        """Return the distance from the nearest obstacle, less `ROUNDING` [m], at
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
        for body, field, moving in itertools.chain(self._placed(q), self._placed_near_own(q)):
            compare(body, field, moving)
        if jib:
            for field, moving in self._placed_jib(q):
                compare("jib", field, moving)
        return nearest

    def nearest_of_structure(self, q: np.ndarray) -> dict[str, Approach]:
        """Return where each part of the crane that drives move above the rope, such as boom and
        superstructure with its tail, is nearest to a solid along a motion, or to the ground if the
        part moves up and down, by name of the part. Zones do not count.

        All rows count, and few are looked at: until the structure has moved by the distance that a
        body has beyond the least of its part so far, the body cannot come nearer than that.

        Args:
            q: Coordinates of all joints, shape (rows, n).
        """
        moved = self.structure_displacement(q[:-1, :], q[1:, :])
        travelled = np.concatenate([[0.0], np.cumsum(moved)])
        least: dict[str, float] = {}
        found: dict[str, tuple[int, MovingBody]] = {}
        for moving in self._structure:
            if not len(moving.field):
                continue
            row = 0
            while row < len(q):
                distance = moving.field.least(self._put(moving, q[row]))
                if distance < least.get(moving.part, math.inf):
                    least[moving.part] = distance
                    found[moving.part] = row, moving
                beyond = distance - least[moving.part]
                reached = np.searchsorted(travelled, travelled[row] + beyond, side="right")
                row = max(row + 1, int(reached))

        approaches = {}
        for part, (row, moving) in found.items():
            distances = moving.field.distances(self._put(moving, q[row]))
            name = min(distances, key=distances.__getitem__)
            nearest = Nearest(distances[name], part, name)
            approaches[part] = Approach(row, nearest)
        return approaches

    def _put(self, moving: MovingBody, q: np.ndarray) -> Placed:
        """Return a body at its place at coordinates of all joints, shape (n,)."""
        (frame,) = self._frames(q, moving.joint)
        return moving.body.put(frame)

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

    @abstractmethod
    def compared_fields(self) -> Iterator[tuple[str, Field]]:
        """Yield the name of each body of which `margin` counts the distances, with the obstacles
        that it is compared with.
        """

    @property
    @abstractmethod
    def own_shape_counts(self) -> Mapping[str, int]:
        """Number of shapes of each part of the crane that is an obstacle to what hangs, by name."""

    def out_of_range(self) -> Iterator[tuple[str, str]]:
        """Yield the names of bodies and obstacles that never come near each other, and need no
        comparison.
        """
        return iter(())

    # --- inside -----------------------------------------------------------------------------------

    @abstractmethod
    def _margins(self, q: np.ndarray) -> tuple[float, float]:
        """Return two margins [m]: to everything but zones, and to zones. Both are minus infinity,
        from which nothing is proven, where a coordinate is not finite.
        """

    @abstractmethod
    def _placed(self, q: np.ndarray) -> Iterator[tuple[str, Field, Placed]]:
        """Yield the name of each body that is compared with obstacles at rest, these obstacles, and
        the body at its place, where it stays until it is placed again.
        """

    @abstractmethod
    def _placed_near_own(self, q: np.ndarray) -> Iterator[tuple[str, Field, Placed]]:
        """Yield the same for parts of the crane itself that move: each body is placed in the frame
        in which these are at rest.
        """

    @property
    @abstractmethod
    def _structure(self) -> Iterable[MovingBody]:
        """All shapes of the parts of the crane that drives move above the rope, not inflated: of an
        inflated body that touches something coal does not say how deep. A shape that is compared
        with several fields is there for each of them.
        """

    @abstractmethod
    def structure_displacement(self, q: np.ndarray, q_end: np.ndarray) -> np.ndarray:
        """Return an upper bound of the displacement of any point of the parts of the crane that
        drives move above the rope between coordinates, shape (..., n) each; in [m], shape (...).
        """

    def _placed_jib(self, q: np.ndarray) -> Iterator[tuple[Field, Placed]]:
        """Yield all that slews with the jib, see `jib_apart`, and the obstacles that it is compared
        with.
        """
        return iter(())

    @cached_property
    def _solid_shapes(self) -> list[tuple[str, coal.CollisionGeometry]]:
        """Shapes of all solids but zones, each with the name of its solid."""
        return self._shapes_of([solid for solid in self.solids if not solid.zone])

    @cached_property
    def _zones(self) -> Field:
        """The zones to keep out of."""
        return Field(self._shapes_of([solid for solid in self.solids if solid.zone]))

    @cached_property
    def _ground(self) -> Field:
        """The ground of the site; empty where the load stands on it, see `contacts`."""
        if any(part.obstacle == GROUND for part in self.contacts):
            return Field([])
        level = self.site.ground - float(self.site.foot[2])
        return Field([(GROUND, coal.Halfspace(np.array([0.0, 0.0, 1.0]), level))])

    def _body(self, name: str, inflated: float) -> Body:
        """Return load, hook or rope, inflated by a distance [m], in the frame of the joint that
        carries the load. The rope is stretched to its length where it is placed.
        """
        if name == "load":
            return Body(hull(self.bodies.load), inflated)
        if name == "rope":
            return Body(coal.Capsule(self.bodies.falls, 1.0), inflated)
        hook = self.bodies.hook
        hook_place = coal.Transform3s(np.eye(3), hook.centre)
        return Body(coal.Box(hook.size), inflated, hook_place)

    def _hanging_bodies(self, at_rest: Field) -> list[ComparedBody]:
        """Return what hangs with what it keeps from: obstacles at rest and, of the load, the ground
        by the required distance, and zones, which need none.
        """
        compared = []
        for name in ("rope", "hook", "load"):
            fields = [at_rest, self._ground] if name == "load" else [at_rest]
            compared.append(ComparedBody(name, self._body(name, self.site.distance), fields))
        for name in ("rope", "hook", "load"):
            compared.append(ComparedBody(name, self._body(name, 0.0), [self._zones]))
        return keeping(compared)

    def _refuse_length(
        self, length: float, point: np.ndarray, label: str, *, begins: str = "The centre"
    ) -> None:
        """Refuse a point of the site [m], shape (3,), if the hook does not reach it with the
        coordinate of the hoist that it needs [m]. The label names the point, and the sentence
        begins as said.

        Raises:
            OutOfReach: With the heights that the load reaches.
        """
        longest = float(self.crane.upper[self.hoist])
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
            f"{begins} of this load gets {reach} m above the ground; the {label} at "
            f"{point_text(point)} is {above:.2f} m above it. {change}.",
            name="height of the centre of the load",
            value=above,
            allowed=f"{lowest:.2f} to {highest:.2f}",
        )

    @staticmethod
    def _shapes_of(solids: list[Solid]) -> list[tuple[str, coal.CollisionGeometry]]:
        """Return the shapes of solids, each with the name of its solid."""
        return [(solid.name, shape) for solid in solids for shape in solid.geometries()]

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


def point_text(point: np.ndarray) -> str:
    """Return the coordinates of a point [m] to read, to the millimetre."""
    return str(np.round(point, 3).tolist())
