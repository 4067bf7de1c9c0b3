"""Contact of the load with the ground and with platforms.

Points of the load push against faces: a spring with a damper that pushes but does not pull, and dry
friction. Friction is a spring with a damper from an anchor, the place where the point came to rest.
Its force is limited to the friction cone; the anchor follows a point that slides. So a point that
sticks does not creep. Faces of the load and edges of a platform do not touch: a load that is larger
than its support needs points between its corners. `Contacts.reaction` states the equations.

The functions work on any kind of number, see `cranedyn.dynamics.scalars`: arrays of floats in
Python, values of a program in compiled code.

Source: Cundall and Strack, Géotechnique 29 (1979), 47-65 (friction); Schwager and Pöschel, Granular
Matter 9 (2007), 465-469 (restitution).
"""

from __future__ import annotations

import cmath
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from cranedyn.checks import finite, number, within
from cranedyn.dynamics.equations_of_motion import body_points
from cranedyn.dynamics.joint_forces import TAUT
from cranedyn.dynamics.scalars import indicator, smaller, square_root, where
from cranedyn.errors import ModelError, OutOfRange, quoted
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane

MIN_RESTITUTION = 0.05
"""Smallest coefficient of restitution that is computed; a smaller one counts as this.

A load that falls by 1 m does not leave the ground again with it, since gravity holds the load down.
The damping of a smaller one would not be stable in substeps of 0.5 ms.
"""

MIN_SINK = 5e-4
"""Smallest static sink [m]. A harder ground would not be stable in substeps of 0.5 ms."""

MAX_SINK = 0.1
"""Largest static sink [m]."""

ON_GROUND = 2.0
"""Phase of the rope of a load that stands, beside `joint_forces.TAUT` and `joint_forces.SLACK`."""

OFF_LEAD = 3.0
"""Phase of the rope of a load that is lifted off-lead: it slides, or the taut rope leans."""

OFF_LEAD_ANGLE = math.radians(1.0)
"""Lean of a taut rope beyond which a load on the ground is lifted off-lead [rad]."""

OFF_LEAD_SPEED = 0.01
"""Speed of a point on the ground beyond which its load is lifted off-lead [m/s]."""

MAX_START_SINKS = 5.0
"""Depth that a load may have in the ground at the start, in static sinks.

Where a load stands on one of its four corners alone, that corner is at four static sinks.
"""

STANDING_ITERATIONS = 20
"""Number of times that `standing` moves a load along its rope.

A rope that leans by an angle α lowers the load by cos α times what it lengthens, so that each
iteration leaves 1 - cos α of the error.
"""

NEIGHBOUR_GAP = 1e-6
"""Distance by which supports may be apart and still adjoin [m]; and distance in front of a face,
outside of its body, at which a point must lie in another support for that support to cover the face
there."""

COVERED_PENALTY = 0.1
"""Amount that is added to the way out of a support through a covered face [m].

A point leaves through a face that is not covered as long as it is less than this deeper below it.
"""

MAX_COORDINATE = 1e6
"""Largest distance of a platform or of a corner of a hull from the origin along an axis [m].

Doubles of this size tell places apart by 1e-10 m.
"""

MIN_THICKNESS = 1e-6
"""Least thickness of a hull and least side of a platform [m]. The planes of flatter bodies are
decided by round-off, and Qhull fails on them.
"""

PLANE_DECIMALS = 9
"""Decimals to which the planes of a hull are rounded, to find those that Qhull lists repeatedly."""

Vector = Sequence[Any] | np.ndarray
"""Three numbers, or three arrays of them."""


class Face(NamedTuple):
    """A face of a body, by the half-space of the points p with normal · p <= offset [m] in the
    world, in which the body lies.

    Attributes:
        normal: Unit vector out of the body.
        offset: Distance from the origin [m].
        neighbours: Supports, by their indices in `Contacts.supports`, that begin in front of a part
            of it, on its outer side.
    """

    normal: tuple[float, float, float]
    offset: float
    neighbours: tuple[int, ...] = ()


@dataclass(frozen=True)
class Platform:
    """A box that stands on the ground.

    Attributes:
        centre: Centre of its plan in the world [m], shape (2,).
        size: Its sides [m], shape (2,), the first along X where yaw is zero.
        height: Height of its top in the world [m].
        yaw: Angle from X towards Y by which it is turned [rad].

    Raises:
        OutOfRange: If a number is not finite, farther than 1000 km, or a side less than 1 µm.
    """

    centre: tuple[float, float]
    size: tuple[float, float]
    height: float
    yaw: float = 0.0

    def __post_init__(self) -> None:
        for name, lowest in (("centre", -MAX_COORDINATE), ("size", MIN_THICKNESS)):
            values = []
            for value in getattr(self, name):
                values.append(within(f"{name} of a platform", value, lowest, MAX_COORDINATE, "m"))
            object.__setattr__(self, name, tuple(values))
        within("height of a platform", self.height, -MAX_COORDINATE, MAX_COORDINATE, "m")
        number("yaw of a platform", self.yaw, "rad")

    @property
    def faces(self) -> tuple[Face, ...]:
        """Its top and its four sides. It has no underside, since it stands on the ground."""
        x, y = self.centre
        cosine = math.cos(self.yaw)
        sine = math.sin(self.yaw)
        first_axis = (cosine, sine)
        second_axis = (-sine, cosine)
        faces = [Face((0.0, 0.0, 1.0), self.height)]
        for (a, b), size in zip((first_axis, second_axis), self.size, strict=True):
            for u, w in ((a, b), (-a, -b)):
                faces.append(Face((u, w, 0.0), u * x + w * y + size / 2.0))
        return tuple(faces)


@dataclass(frozen=True)
class Hull:
    """The convex hull of corners, such as a part of an obstacle.

    Attributes:
        corners: Corners in the world [m], shape (n, 3).

    Raises:
        OutOfRange: If they are not finite, farther than 1000 km, or lie in a plane to within 1 µm.
    """

    corners: Sequence[Sequence[float]]

    def __post_init__(self) -> None:
        corners = finite("corners of a hull", self.corners, ("n", 3), unit="m")
        farthest = float(np.abs(corners).max(initial=0.0))
        within("coordinate of a corner of a hull", farthest, 0.0, MAX_COORDINATE, "m")

        # The plane that fits the corners best passes through their mean; its normal is the last
        # right singular vector of the centred corners. Their spread along it is their thickness.
        centred = corners - corners.mean(axis=0) if len(corners) else np.zeros((1, 3))
        normal = np.linalg.svd(centred)[2][-1]
        if not np.ptp(centred @ normal) >= MIN_THICKNESS:
            allowed = "four that are not in a plane, to within 1 µm"
            raise OutOfRange("corners of a hull", quoted(self.corners), allowed, "m")

    @property
    def faces(self) -> tuple[Face, ...]:
        """Its faces."""
        from scipy.spatial import ConvexHull  # takes long to import, and few runs need it

        # Qhull divides faces into triangles and lists the plane of each: normal and -offset.
        planes = ConvexHull(np.array(self.corners)).equations.round(PLANE_DECIMALS)
        faces = []
        for x, y, z, negative_offset in np.unique(planes, axis=0).tolist():
            faces.append(Face((x, y, z), -negative_offset))
        return tuple(faces)


@dataclass(frozen=True)
class Ground:
    """Level ground, platforms, and the points of the load that touch them.

    Attributes:
        points: Points of the load from its centre of mass, in the frame of its joint [m], shape
            (n, 3), such as `box_corners`.
        platforms: Platforms and hulls on the ground.
        friction: Coefficient of dry friction.
        restitution: Speed after an impact over the speed before it, where all points touch at once
            and without gravity, 0 to 1. Up to 0.05 it counts as 0.05: a load that falls by 1 m then
            stays down.
        sink: Depth to which the load at rest sinks with four points below it [m], 0.5 mm to 0.1 m.
        height: Height of the ground in the world [m].

    Raises:
        OutOfRange: If a number is out of its range, or a platform below the ground.
    """

    points: Sequence[Sequence[float]]
    platforms: tuple[Platform | Hull, ...] = ()
    friction: float = 0.5
    restitution: float = 0.1
    sink: float = 0.002
    height: float = 0.0

    def __post_init__(self) -> None:
        points = tuple(tuple(number("point of a load", x, "m") for x in p) for p in self.points)
        if not points or any(len(point) != 3 for point in points):
            raise OutOfRange("points of a load", points, "one or more of three numbers each", "m")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "platforms", tuple(self.platforms))
        number("coefficient of friction", self.friction, "", ">= 0")
        within("coefficient of restitution", self.restitution, 0.0, 1.0, "")
        within("static sink of the load", self.sink, MIN_SINK, MAX_SINK, "m")
        level = number("height of the ground", self.height, "m")
        for body in self.platforms:
            if isinstance(body, Platform):
                number("height of a platform above the ground", body.height - level, "m", "> 0")

    def contacts(self, crane: Crane) -> Contacts:
        """Return the contacts of the load of a crane.

        At rest on four points a load of mass m is carried by four springs that are compressed by
        the static sink s, so that each has the stiffness

            k = m g / (4 s) = (m/4) ω²   with   ω = √(g/s),

        and the damping 2 ζ (m/4) ω along the normal, see `damping_ratio`. Across the normal, where
        a point sticks, the same spring is damped critically.
        """
        omega = math.sqrt(crane.gravity / self.sink)
        mass = crane.payload_mass / 4.0
        level = float(self.height)
        points = crane.payload.lever + np.array(self.points)
        ratio = damping_ratio(max(self.restitution, MIN_RESTITUTION))

        # What stands on the ground has no underside: points sink below the ground, and must not be
        # pushed out of the platform downwards.
        bodies = []
        for body in self.platforms:
            faces = [f for f in body.faces if f.normal[2] > -1.0 or -f.offset > level]
            bodies.append(tuple(faces))
        ground = (Face((0.0, 0.0, 1.0), level),)
        return Contacts(
            body=crane.payload.body,
            points=tuple(tuple(point) for point in points.tolist()),
            supports=(ground, *_with_neighbours(bodies)),
            stiffness=mass * omega**2,
            damping=2.0 * ratio * mass * omega,
            slip_damping=2.0 * mass * omega,
            friction=float(self.friction),
        )


def box_corners(width: float, length: float, height: float) -> tuple[tuple[float, ...], ...]:
    """Return the eight corners of a box about its centre [m].

    Args:
        width: Side along X of its joint, for a tower crane across the jib [m].
        length: Side along Y [m].
        height: Height [m].

    Raises:
        OutOfRange: If a side is not positive.
    """
    sides = _positive_sides(width, length, height)
    ends = [(-side / 2.0, side / 2.0) for side in sides]
    return tuple(itertools.product(*ends))


def box_load(mass: float, width: float, length: float, height: float) -> dict[str, float]:
    """Return the values of `load_crane` for a uniform box that hangs on a lug amid its top.

    Args:
        mass: Mass of the box [kg].
        width: Side along X, as for `box_corners` [m].
        length: Side along Y [m].
        height: Height [m].

    Raises:
        OutOfRange: If a side is not positive.
    """
    width, length, height = _positive_sides(width, length, height)
    x_squared = width * width
    y_squared = length * length
    z_squared = height * height
    # The moment of inertia about an axis through the centre is m/12 times the sum of the squares of
    # the two sides across it.
    return {
        "payload_mass": mass,
        "lug_height": height / 2.0,
        "payload_ixx": mass * (y_squared + z_squared) / 12.0,
        "payload_iyy": mass * (x_squared + z_squared) / 12.0,
        "payload_izz": mass * (x_squared + y_squared) / 12.0,
    }


def _positive_sides(width: float, length: float, height: float) -> list[float]:
    return [number("side of a box", side, "m", "> 0") for side in (width, length, height)]


def damping_ratio(restitution: float) -> float:
    """Return the damping ratio by which an impact without gravity has a coefficient of restitution.

    The contact is a spring with a damper that pushes but does not pull, so that it ends where the
    force is zero, which is before the depth is. With the depth d, d(0) = 0 and d'(0) = v,

        d'' + 2 ζ ω d' + ω² d = 0
        d(t) = v/(ω sin α) exp(-ζ ω t) sin(ω t sin α)   with   ζ = cos α.

    The force, as d'', is zero where ω t sin α = 2 α. There d' = -v exp(-2 ζ α / sin α), whence

        e = exp(-2 ζ arccos(ζ) / √(1 - ζ²)).

    Above critical damping both the angle and the root are imaginary, and their ratio is
    arcosh(ζ) / √(ζ² - 1).

    Source: Schwager and Pöschel, Granular Matter 9 (2007), 465-469.

    Args:
        restitution: Coefficient of restitution, 0.03 to 1.
    """

    def excess(ratio: float) -> float:
        angle = abs(cmath.acos(ratio))
        return math.exp(-2.0 * ratio * angle / math.sqrt(abs(1.0 - ratio**2))) - restitution

    from scipy.optimize import brentq  # takes long to import, and few runs need it

    return float(brentq(excess, 0.0, 3.0, xtol=1e-15))


def standing(crane: Crane, ground: Ground, state: State) -> State:
    """Return a state with the load moved along its rope until it stands on the ground.

    The stretch of the rope takes up the difference: it is negative, the rope slack, where the
    support is higher than the load would hang.

    Args:
        crane: The crane, whose rope may stretch or go slack.
        ground: The ground.
        state: State with the load anywhere above or below its support.

    Raises:
        ModelError: If the rope of the crane can neither stretch nor go slack.
        OutOfRange: If an inextensible rope is too short to reach the ground.
    """
    contacts = ground.contacts(crane)
    q = state.q.copy()
    rope = crane.springs.rope
    if rope is None:
        raise ModelError(
            "A load can stand on the ground only below a rope that stretches or goes slack; give "
            "the crane a rope_stiffness, such as 2e7 N, or inf."
        )
    points = np.array(contacts.points)
    at_rest = 0.0 * q
    for _ in range(STANDING_ITERATIONS):
        position, _ = body_points(crane.model, crane.data, contacts.body, points, q, at_rest)
        # A longer rope lowers the load: it is shortened by what the load is too deep.
        q[rope.stretch] -= np.max(contacts.depth(position)[0]) - ground.sink
    stretch = float(q[rope.stretch])
    if rope.inextensible and stretch > 0.0:
        symbol = crane.layout.symbols[rope.length]
        allowed = f"0 or less, since the rope does not stretch; give a larger {symbol}"
        raise OutOfRange("stretch of the rope of a load on the ground", stretch, allowed, "m")
    return State(q, state.v)


def anchors_at(crane: Crane, contacts: Contacts, start: State) -> np.ndarray:
    """Return the anchors of a load at a start, which are where its points are in the world [m],
    shape (3, points).

    Raises:
        OutOfRange: If the load is deeper in the ground than `MAX_START_SINKS` static sinks.
    """
    points = np.array(contacts.points)
    anchors, _ = body_points(crane.model, crane.data, contacts.body, points, start.q, start.v)
    depth = float(np.max(contacts.depth(anchors)[0]))
    weight = crane.payload_mass * crane.gravity
    # At rest, four points carry the load.
    static_sink = weight / 4.0 / contacts.stiffness
    deepest = MAX_START_SINKS * static_sink
    if depth > deepest:
        allowed = f"{deepest:g} or less; contact.standing puts the load onto the ground"
        raise OutOfRange("depth of the load in the ground at the start", depth, allowed, "m")
    return anchors


def ground_phases(
    crane: Crane, contacts: Contacts, q: np.ndarray, v: np.ndarray, phase: np.ndarray
) -> np.ndarray:
    """Return phases of a rope with those of a load on the ground filled in.

    They are `ON_GROUND` where the load touches, and `OFF_LEAD` where it touches and the rope is
    taut, and either a point that touches slides or the rope leans. Elsewhere they stay.

    Args:
        crane: The crane.
        contacts: Contacts of its load.
        q: Coordinates, shape (rows, n).
        v: Their rates, shape (rows, n).
        phase: Phases of the rope without the ground, `TAUT` or `SLACK`, shape (rows,).

    Returns:
        Phases, shape (rows,).
    """
    points = np.array(contacts.points)
    radial = crane.layout.role("radial_swing", "Off-lead")
    tangential = crane.layout.role("tangential_swing", "Off-lead")
    lean = np.hypot(q[:, radial], q[:, tangential])

    positions = np.empty((3, len(q), len(points)))
    velocities = np.empty_like(positions)
    for row, (row_q, row_v) in enumerate(zip(q, v, strict=True)):
        positions[:, row], velocities[:, row] = body_points(
            crane.model, crane.data, contacts.body, points, row_q, row_v
        )
    touches = contacts.depth(positions)[0] > 0.0
    speeds = np.where(touches, np.hypot(velocities[0], velocities[1]), 0.0).max(axis=1)
    off_lead = (phase == TAUT) & ((speeds > OFF_LEAD_SPEED) | (lean > OFF_LEAD_ANGLE))
    return np.where(touches.any(axis=1), np.where(off_lead, OFF_LEAD, ON_GROUND), phase)


class _FaceDepth(NamedTuple):
    """Depth of a point below a face [m], and the normal of that face."""

    depth: Any
    normal: Vector


class Contacts(NamedTuple):
    """Contacts of points of a body with convex supports, in SI units, or in those of `in_steps`.

    Attributes:
        body: Index of the joint that carries the points.
        points: Points in its frame [m].
        supports: Faces of each support; the first support is the ground.
        stiffness: Stiffness of a point, along and across a face [N/m].
        damping: Damping of a point along the normal [N s/m].
        slip_damping: Damping of a point that sticks, across the normal [N s/m].
        friction: Coefficient of dry friction.
    """

    body: int
    points: tuple[tuple[float, ...], ...]
    supports: tuple[tuple[Face, ...], ...]
    stiffness: Any
    damping: Any
    slip_damping: Any
    friction: float

    def in_steps(self, dt: Any, mass: Any) -> Contacts:
        """Return the same in other units, see `JointForces.in_steps`."""
        return self._replace(
            stiffness=self.stiffness * (dt * dt / mass),
            damping=self.damping * (dt / mass),
            slip_damping=self.slip_damping * (dt / mass),
        )

    @property
    def level(self) -> float:
        """Height of the ground [m]."""
        return self.supports[0][0].offset

    def depth(self, position: Vector) -> tuple[Any, Vector]:
        """Return how deep a point is in the supports, and the normal along which it is pushed out.

        For each support this is the depth below its nearest face that no other support covers, see
        `_nearest_face`. Of all supports that in which the point is deepest counts. The depth is
        negative where the point is outside of all [m].

        Args:
            position: The point in the world [m].
        """
        deepest: _FaceDepth | None = None
        for faces in self.supports:
            nearest = self._nearest_face(faces, position)
            if deepest is not None:
                nearest = _choose(nearest.depth > deepest.depth, nearest, deepest)
            deepest = nearest
        assert deepest is not None
        return deepest

    def _nearest_face(self, faces: Sequence[Face], position: Vector) -> _FaceDepth:
        """Return the face of one support through which a point is nearest to the outside.

        The way out through a face that another support covers at the place where the point would
        come out counts as longer by `COVERED_PENALTY`. On a seam of two platforms that are flush, a
        point is therefore pushed up and not into the other platform.
        """
        nearest: _FaceDepth | None = None
        shortest: Any = None
        for face in faces:
            depth = face.offset - _dot(face.normal, position)
            face_depth = _FaceDepth(depth, face.normal)
            exit_distance = self._exit_distance(face, depth, position)
            if nearest is None:
                nearest = face_depth
                shortest = exit_distance
                continue
            nearest = _choose(exit_distance < shortest, face_depth, nearest)
            shortest = where(exit_distance < shortest, exit_distance, shortest)
        assert nearest is not None
        return nearest

    def _exit_distance(self, face: Face, depth: Any, position: Vector) -> Any:
        """Return the way of a point out of a support through a face [m], with `COVERED_PENALTY`
        where another support covers the face.
        """
        if not face.neighbours:
            return depth
        exit_point = []
        for coordinate, component in zip(position, face.normal, strict=True):
            exit_point.append(coordinate + (depth + NEIGHBOUR_GAP) * component)
        distance = depth
        for neighbour in face.neighbours:
            depth_inside = self._depth_inside(neighbour, exit_point)
            is_covered = depth_inside > 0.0
            distance = where(is_covered, depth + COVERED_PENALTY, distance)
        return distance

    def _depth_inside(self, support: int, point: Vector) -> Any:
        """Return the depth of a point in a support [m]; it is outside where that is negative."""
        least: Any = None
        for face in self.supports[support]:
            depth = face.offset - _dot(face.normal, point)
            least = depth if least is None else smaller(least, depth)
        return least

    def reaction(
        self, position: Vector, velocity: Vector, anchor: Vector
    ) -> tuple[list[Any], list[Any]]:
        """Return the force on a point [N] and its anchor after that [m], in the world.

        With depth d, normal n, velocity v, and the offset s of the point from its anchor and its
        velocity r, both across the normal, the force is F = N n + f with

            N = max(k d - c n·v, 0)        in contact, d > 0, and 0 elsewhere,
            f = -(k s + b r)               where |k s + b r| <= μ N: the point sticks,
            f = -μ N (k s + b r)/|k s + b r|   elsewhere: the point slides.

        The anchor of a point that slides follows it so that spring and damper together make up the
        friction, f = -(k h + b r): it is left behind by h = -(f + b r)/k. The anchor of a point in
        the air is the point.

        Sources: Cundall and Strack, Géotechnique 29 (1979), 47-65 (friction); Schwager and Pöschel,
        Granular Matter 9 (2007), 465-469 (no pull at the end of contact).

        Args:
            position: Position of the point in the world [m].
            velocity: Its velocity [m/s].
            anchor: Place where it came to rest [m].
        """
        depth, normal = self.depth(position)
        push = self.stiffness * depth - self.damping * _dot(normal, velocity)
        load = where(depth > 0.0, where(push > 0.0, push, 0.0), 0.0)

        offset = [p - a for p, a in zip(position, anchor, strict=True)]
        slip = _across(normal, offset)
        rate = _across(normal, velocity)
        sticking = []
        for s, r in zip(slip, rate, strict=True):
            sticking.append(-(self.stiffness * s + self.slip_damping * r))

        # Where the point sticks, the square may be 0. It is replaced by 1 there, since a division
        # by zero would give NaN, also times a flag of 0.
        square = _dot(sticking, sticking)
        limit = self.friction * load
        slides = square > limit * limit
        root = square_root(where(slides, square, 1.0))
        share = 1.0 - indicator(slides, square) * (1.0 - limit / root)
        friction = [share * component for component in sticking]

        spring_offset = []
        for f, r in zip(friction, rate, strict=True):
            spring_offset.append(-(f + self.slip_damping * r) / self.stiffness)
        moved = []
        for p, h, a in zip(position, spring_offset, anchor, strict=True):
            moved.append(where(load > 0.0, where(slides, p - h, a), p))
        force = [load * n + f for n, f in zip(normal, friction, strict=True)]
        return force, moved


def _with_neighbours(supports: Sequence[tuple[Face, ...]]) -> list[tuple[Face, ...]]:
    """Return supports whose faces know the supports that begin in front of them.

    Args:
        supports: Supports without the ground, which is number 0 of `Contacts.supports`.
    """
    bodies = []
    for body in supports:
        adjoining = []
        for index, other in enumerate(supports):
            if other is not body and _ball_radius([*body, *other]) > -NEIGHBOUR_GAP:
                adjoining.append(index)
        faces = []
        for face in body:
            neighbours = _supports_in_front(face, body, supports, adjoining)
            faces.append(face._replace(neighbours=neighbours))
        bodies.append(tuple(faces))
    return bodies


def _supports_in_front(
    face: Face,
    body: Sequence[Face],
    supports: Sequence[tuple[Face, ...]],
    adjoining: Sequence[int],
) -> tuple[int, ...]:
    """Return the supports, by their numbers in `Contacts.supports`, of which a part lies straight
    in front of a face of a body, on its outer side and between the planes of its other faces.
    """
    x, y, z = face.normal
    outside = Face((-x, -y, -z), -face.offset)
    sides = [other for other in body if other is not face]
    in_front = []
    for index in adjoining:
        if _ball_radius([outside, *sides, *supports[index]]) > NEIGHBOUR_GAP:
            in_front.append(index + 1)  # the ground is number 0
    return tuple(in_front)


def _ball_radius(faces: Sequence[Face]) -> float:
    """Return the radius of the largest ball within faces [m], 1 m at most. It is negative where the
    faces have no point in common.

    The ball of centre p and radius r is within a face where n·p + r <= offset. The largest one is a
    linear programme in p and r.
    """
    from scipy.optimize import linprog  # takes long to import, and few runs need it

    planes = [[*face.normal, 1.0] for face in faces]
    offsets = [face.offset for face in faces]
    free = (None, None)
    at_most_one = (None, 1.0)  # keeps the programme bounded where the faces do not enclose a space
    bounds = [free, free, free, at_most_one]
    return -float(linprog([0, 0, 0, -1], planes, offsets, bounds=bounds).fun)


def _dot(a: Vector, b: Vector) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _across(normal: Vector, vector: Vector) -> list[Any]:
    """Return the part of a vector across a unit vector."""
    length = _dot(normal, vector)
    return [x - length * n for x, n in zip(vector, normal, strict=True)]


def _choose(condition: Any, yes: _FaceDepth, no: _FaceDepth) -> _FaceDepth:
    """Return one depth and normal where a condition holds, another where not.

    Components of two normals are often plain floats, among which a condition of compiled code
    cannot choose, see `scalars.where`. They are therefore mixed by a weight of 1 or 0.
    """
    depth = where(condition, yes.depth, no.depth)
    weight = indicator(condition, depth)
    normal = []
    for a, b in zip(yes.normal, no.normal, strict=True):
        is_same = isinstance(a, float) and isinstance(b, float) and a == b
        normal.append(b if is_same else b + weight * (a - b))
    return _FaceDepth(depth, normal)
