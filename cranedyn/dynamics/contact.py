"""Contact of the load with the ground and with platforms.

Points of the load push against faces: a spring with a damper that pushes but does not pull, and dry
friction. Friction is a spring with a damper from an anchor, the place where the point came to rest.
Its force is cut to the friction cone; the anchor follows a point that slides. So a point that
sticks does not creep. Faces of the load and edges of a platform do not touch: a load that is larger
than its support needs points between its corners.

Written once for any kind of number: arrays of floats in the plain loop, values of a program in
compiled code.

Source: Cundall and Strack, Géotechnique 29 (1979), 47-65 (friction); Schwager and Pöschel, Granular
Matter 9 (2007), 465-469 (restitution).
"""

from __future__ import annotations

import cmath
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from cranedyn.checks import finite, number, within
from cranedyn.dynamics.joint_forces import TAUT
from cranedyn.dynamics.pinocchio import body_points
from cranedyn.dynamics.scalars import chosen, flag, smaller, square_root
from cranedyn.errors import ModelError, OutOfRange, quoted
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane

_DEAD = 0.05
"""Coefficient of restitution up to which a load that falls by 1 m does not leave the ground again,
since gravity holds it. The damping of a smaller one is not stable in a substep of 0.5 ms."""

_SINKS = (5e-4, 0.1)
"""Range of static sinks [m]. A harder ground is not stable in a substep of 0.5 ms."""

ON_GROUND = 2.0
"""Phase of a load that stands, see `joint_forces.TAUT`."""

OFF_LEAD = 3.0
"""Phase of a load that is lifted off-lead."""

LEANS = math.radians(1.0)
"""Lean of a taut rope beyond which a load on the ground is lifted off-lead [rad]."""

SLIDES = 0.01
"""Speed of a point on the ground beyond which its load is lifted off-lead [m/s]."""

_START_DEPTH = 5.0
"""Static sinks that a load may be in the ground at the start; on one corner it is at four."""

_ITERATIONS = 20
"""Steps in which a load on a rope that leans is put on the ground; each leaves 1 - cos of the lean
of the error."""

_BEHIND = 1e-6
"""Distance behind a face at which another support covers it [m]."""

_COVERED = 0.1
"""Depth below other faces up to which no point leaves a support through a covered face [m]."""

_FARTHEST = 1e6
"""Largest distance of a platform or of a corner of a hull from the origin along an axis [m]. There
doubles tell places apart by 1e-10 m."""

_THINNEST = 1e-6
"""Least thickness of a hull and least side of a platform [m]. The planes of flatter bodies are
decided by round-off, and Qhull fails on them."""

Vector = Sequence[Any] | np.ndarray
"""Three numbers, or three arrays of them."""


class Face(NamedTuple):
    """Points with normal · p <= offset [m], in the world.

    Attributes:
        normal: Unit vector out of the body.
        offset: Distance from the origin [m].
        neighbours: Supports, by their indices, that begin behind a part of it.
    """

    normal: tuple[float, float, float]
    offset: float
    neighbours: tuple[int, ...] = ()


@dataclass(frozen=True)
class Platform:
    """A box that stands on the ground.

    Attributes:
        centre: Of its plan in the world [m], shape (2,).
        size: Its sides [m], shape (2,), the first along X where yaw is zero.
        height: Height of its top in the world [m].
        yaw: Its turn from X towards Y [rad].

    Raises:
        OutOfRange: If a number is not finite, farther than 1000 km, or a side less than 1 µm.
    """

    centre: tuple[float, float]
    size: tuple[float, float]
    height: float
    yaw: float = 0.0

    def __post_init__(self) -> None:
        for name in ("centre", "size"):
            least = _THINNEST if name == "size" else -_FARTHEST
            values = [
                within(f"{name} of a platform", x, least, _FARTHEST, "m")
                for x in getattr(self, name)
            ]
            object.__setattr__(self, name, tuple(values))
        within("height of a platform", self.height, -_FARTHEST, _FARTHEST, "m")
        number("yaw of a platform", self.yaw, "rad")

    @property
    def faces(self) -> tuple[Face, ...]:
        """Its top and its four sides."""
        x, y = self.centre
        cosine, sine = math.cos(self.yaw), math.sin(self.yaw)
        sides = [
            Face((u, w, 0.0), u * x + w * y + size / 2.0)
            for (a, b), size in zip(((cosine, sine), (-sine, cosine)), self.size, strict=True)
            for u, w in ((a, b), (-a, -b))
        ]
        return (Face((0.0, 0.0, 1.0), self.height), *sides)


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
        within("coordinate of a corner of a hull", farthest, 0.0, _FARTHEST, "m")
        # The spread across the plane that is fitted to the corners, which is their thickness.
        centred = corners - corners.mean(axis=0) if len(corners) else np.zeros((1, 3))
        normal = np.linalg.svd(centred)[2][-1]
        if not np.ptp(centred @ normal) >= _THINNEST:
            allowed = "four that are not in a plane, to within 1 µm"
            raise OutOfRange("corners of a hull", quoted(self.corners), allowed, "m")

    @property
    def faces(self) -> tuple[Face, ...]:
        """Its faces."""
        from scipy.spatial import ConvexHull  # takes long to import, and few runs need it

        planes = np.unique(ConvexHull(np.array(self.corners)).equations.round(9), axis=0)
        return tuple(Face((x, y, z), -offset) for x, y, z, offset in planes.tolist())


@dataclass(frozen=True)
class Ground:
    """Level ground, platforms, and the points of the load that touch them.

    Attributes:
        points: Points of the load from its centre of mass, in the frame of its joint [m], shape
            (n, 3), such as `box_corners`.
        platforms: Platforms on it and hulls.
        friction: Coefficient of dry friction.
        restitution: Speed after over speed before an impact of all points at once, without gravity,
            0 to 1. Up to 0.05 it counts as 0.05: a load that falls by 1 m then stays down.
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
        within("static sink of the load", self.sink, *_SINKS, "m")
        level = number("height of the ground", self.height, "m")
        for body in self.platforms:
            if isinstance(body, Platform):
                number("height of a platform above the ground", body.height - level, "m", "> 0")

    def contacts(self, crane: Crane) -> Contacts:
        """Return the contacts of the load of a crane: masses and gravity give the stiffness."""
        omega = math.sqrt(crane.gravity / self.sink)
        mass = crane.payload_mass / 4.0
        level = float(self.height)
        points = crane.payload.lever + np.array(self.points)
        # what stands on the ground has no underside, since points sink below it
        bodies = [
            tuple(f for f in body.faces if f.normal[2] > -1.0 or -f.offset > level)
            for body in self.platforms
        ]
        return Contacts(
            crane.payload.body,
            tuple(map(tuple, points.tolist())),
            ((Face((0.0, 0.0, 1.0), level),), *_with_neighbours(bodies)),
            mass * omega**2,
            2.0 * damping_ratio(max(self.restitution, _DEAD)) * mass * omega,
            2.0 * mass * omega,
            float(self.friction),
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
    sides = (number("side of a box", side, "m", "> 0") for side in (width, length, height))
    return tuple(itertools.product(*((-side / 2.0, side / 2.0) for side in sides)))


def box_load(mass: float, width: float, length: float, height: float) -> dict[str, float]:
    """Return the values of `load_crane` for a uniform box of a mass [kg] that hangs on a lug amid
    its top; its sides are as for `box_corners`.
    """
    across, along, up = (2.0 * x for x in box_corners(width, length, height)[-1])
    x, y, z = across * across, along * along, up * up
    xx, yy, zz = y + z, x + z, x + y
    inertia = {
        f"payload_i{axis}": mass * x / 12.0 for axis, x in (("xx", xx), ("yy", yy), ("zz", zz))
    }
    return {"payload_mass": mass, "lug_height": up / 2.0, **inertia}


def damping_ratio(restitution: float) -> float:
    """Return the damping ratio of a spring and damper that pushes but does not pull, by which an
    impact without gravity has a coefficient of restitution. The contact ends where the force is
    zero, which is before the depth is.
    """

    def excess(ratio: float) -> float:
        angle = abs(cmath.acos(ratio))  # of the hyperbolic cosine above critical damping
        return math.exp(-2.0 * ratio * angle / math.sqrt(abs(1.0 - ratio**2))) - restitution

    from scipy.optimize import brentq  # takes long to import, and few runs need it

    return float(brentq(excess, 0.0, 3.0, xtol=1e-15))


def standing(crane: Crane, ground: Ground, state: State) -> State:
    """Return a state with the load moved along its rope until it stands on the ground; the rope is
    slack where it is longer than that.

    Args:
        crane: The crane, whose rope stretches.
        ground: The ground.
        state: State with the load anywhere above or below its support.
    """
    contacts = ground.contacts(crane)
    q = state.q.copy()
    rope = crane.springs.rope
    if rope is None:
        raise ModelError(
            "A load can stand on the ground only below a rope that stretches; give the crane a "
            "rope_stiffness, such as 2e7 N."
        )
    for _ in range(_ITERATIONS):
        position, _ = body_points(
            crane.model, crane.data, contacts.body, np.array(contacts.points), q, 0.0 * q
        )
        q[rope.stretch] -= np.max(contacts.depth(position)[0]) - ground.sink
    return State(q, state.v)


def anchors_at(crane: Crane, contacts: Contacts, start: State) -> np.ndarray:
    """Return the anchors of a load at a start, which are where its points are in the world [m],
    shape (3, points).

    Raises:
        OutOfRange: If the load is deeper in the ground than `_START_DEPTH` static sinks.
    """
    anchors, _ = body_points(
        crane.model, crane.data, contacts.body, np.array(contacts.points), *start
    )
    depth = float(np.max(contacts.depth(anchors)[0]))
    weight = crane.payload_mass * crane.gravity
    # At rest, four points carry the load.
    static_sink = weight / 4.0 / contacts.stiffness
    deepest = _START_DEPTH * static_sink
    if depth > deepest:
        allowed = f"{deepest:g} at most, above it the load stands"
        raise OutOfRange("depth of the load in the ground at the start", depth, allowed, "m")
    return anchors


def ground_phases(
    crane: Crane, contacts: Contacts, q: np.ndarray, v: np.ndarray, phase: np.ndarray
) -> np.ndarray:
    """Return phases of a rope, shape (rows,), with `ON_GROUND` where the load touches, and
    `OFF_LEAD` where it slides or leans on a taut rope, from coordinates and rates, shape (rows, n).
    """
    points = np.array(contacts.points)
    roles = ("radial_swing", "tangential_swing")
    lean = np.hypot.reduce([q[:, crane.layout.role(role, "Off-lead")] for role in roles])
    body = crane.model, crane.data, contacts.body, points
    motions = [body_points(*body, *state) for state in zip(q, v, strict=True)]
    position, velocity = np.reshape(motions, (-1, 2, 3, len(points))).transpose(1, 2, 0, 3)
    touches = contacts.depth(position)[0] > 0.0
    speeds = np.where(touches, np.hypot(*velocity[:2]), 0.0).max(axis=1)
    off_lead = (phase == TAUT) & ((speeds > SLIDES) | (lean > LEANS))
    return np.where(touches.any(axis=1), np.where(off_lead, OFF_LEAD, ON_GROUND), phase)


class Contacts(NamedTuple):
    """Contacts of points of a body with convex supports, in any units.

    Attributes:
        body: Index of the joint that carries the points.
        points: Points in its frame [m].
        supports: Faces of each support.
        stiffness: Of a point, along and across a face [N/m].
        damping: Of a point along the normal [N s/m].
        slip_damping: Of a point that sticks [N s/m].
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
        """Return the depth of a point in the support in which it is deepest [m], negative outside
        of all, and the normal of the nearest face there that no other support covers.
        """
        deepest: tuple[Any, Vector] | None = None
        for faces in self.supports:
            nearest: tuple[Any, Vector] | None = None
            for normal, offset, neighbours in faces:
                face = (offset - _dot(normal, position), normal)
                exit_depth = face[0]
                if neighbours:
                    steps = zip(position, normal, strict=True)
                    exit_point = [x + (face[0] + _BEHIND) * n for x, n in steps]
                    for k in neighbours:
                        depths = (f.offset - _dot(f.normal, exit_point) for f in self.supports[k])
                        covered = reduce(smaller, depths) > 0.0
                        exit_depth = chosen(covered, face[0] + _COVERED, exit_depth)
                if nearest is None:
                    nearest, shortest = face, exit_depth
                    continue
                nearest = _choose(exit_depth < shortest, face, nearest)
                shortest = chosen(exit_depth < shortest, exit_depth, shortest)
            assert nearest is not None
            if deepest is not None:
                nearest = _choose(nearest[0] > deepest[0], nearest, deepest)
            deepest = nearest
        assert deepest is not None
        return deepest

    def reaction(
        self, position: Vector, velocity: Vector, anchor: Vector
    ) -> tuple[list[Any], list[Any]]:
        """Return the force on a point [N] and its anchor after that [m], in the world.

        Args:
            position: Of the point in the world [m].
            velocity: Of the point [m/s].
            anchor: Where it came to rest [m].
        """
        depth, normal = self.depth(position)
        push = self.stiffness * depth - self.damping * _dot(normal, velocity)
        load = chosen(depth > 0.0, chosen(push > 0.0, push, 0.0), 0.0)
        offset = [p - a for p, a in zip(position, anchor, strict=True)]
        slip, rate = _across(normal, offset), _across(normal, velocity)
        pull = [
            -(self.stiffness * s + self.slip_damping * r) for s, r in zip(slip, rate, strict=True)
        ]
        square = _dot(pull, pull)
        limit = self.friction * load
        slides = square > limit * limit
        root = square_root(chosen(slides, square, 1.0))
        share = 1.0 - flag(slides, square) * (1.0 - limit / root)
        friction = [share * component for component in pull]
        hold = [
            -(f + self.slip_damping * r) / self.stiffness
            for f, r in zip(friction, rate, strict=True)
        ]
        moved = [
            chosen(load > 0.0, chosen(slides, p - h, a), p)
            for p, h, a in zip(position, hold, anchor, strict=True)
        ]
        return [load * n + f for n, f in zip(normal, friction, strict=True)], moved


def _with_neighbours(supports: Sequence[tuple[Face, ...]]) -> list[tuple[Face, ...]]:
    """Return supports whose faces know the supports behind them; the ground comes before all."""
    from scipy.optimize import linprog  # takes long to import, and few runs need it

    def radius(*faces: Face) -> float:
        """Return the radius of the largest ball within faces [m], 1 m at most."""
        planes = [[*face.normal, 1.0] for face in faces]
        bounds = [(None, None)] * 3 + [(None, 1.0)]
        return -float(linprog([0, 0, 0, -1], planes, [f.offset for f in faces], bounds=bounds).fun)

    def behind(face: Face, body: tuple[Face, ...], adjacent: list[int]) -> tuple[int, ...]:
        (x, y, z), sides = face.normal, [f for f in body if f is not face]
        beyond = Face((-x, -y, -z), -face.offset)
        return tuple(k + 1 for k in adjacent if radius(beyond, *sides, *supports[k]) > _BEHIND)

    bodies = []
    for body in supports:
        adjacent = [k for k, support in enumerate(supports) if support is not body]
        adjacent = [k for k in adjacent if radius(*body, *supports[k]) > -_BEHIND]
        bodies.append(
            tuple(face._replace(neighbours=behind(face, body, adjacent)) for face in body)
        )
    return bodies


def _dot(a: Vector, b: Vector) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _across(normal: Vector, vector: Vector) -> list[Any]:
    """Return the part of a vector across a unit vector."""
    along = _dot(normal, vector)
    return [x - along * n for x, n in zip(vector, normal, strict=True)]


def _choose(condition: Any, yes: tuple[Any, Vector], no: tuple[Any, Vector]) -> tuple[Any, Vector]:
    """Return one depth and normal or the other."""
    depth = chosen(condition, yes[0], no[0])
    weight = flag(condition, depth)
    normal = [
        b if isinstance(a, float) and isinstance(b, float) and a == b else b + weight * (a - b)
        for a, b in zip(yes[1], no[1], strict=True)
    ]
    return depth, normal
