"""How far crane and load are from what stands about them.

A place is slew [rad], trolley radius [m] and cable length [m] with the load plumb, shape (3,). The
required distance is part of the shapes, which are inflated by it, and the swing of the load is an
envelope about these.
"""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, TypeVar

import coal
import numpy as np
import pinocchio as pin

from cranedyn.checks import within
from cranedyn.errors import quoted
from cranedyn.model.crane import Crane
from cranedyn.planning.bodies import Bodies, bodies
from cranedyn.planning.fields import Body, Field, Placed, rope
from cranedyn.planning.site import Site
from cranedyn.planning.solids import Solid, hull

GROUND, MAST = "ground", "own mast"
"""What the ground and the crane's own mast are called among the obstacles."""

ROUNDING = 1e-4
"""By how much a distance counts as less [m]: a hundred times the tolerance of coal's algorithm."""

_KINEMATICS = threading.Lock()
"""Held while Pinocchio's data is written and read; all else is the same for all threads."""

_KEEPS_FROM = {
    "inflated": {
        "trolley": ["tall solids"],
        "rope": ["solids and mast"],
        "hook": ["solids and mast"],
        "load": ["solids and mast", "ground"],
    },
    "bare": {"trolley": [], "rope": ["zones"], "hook": ["zones"], "load": ["zones"]},
}
"""Which obstacles which body has to keep away from: by the required distance, and as it is. The
load hangs lowest, and solids that are not tall never come near the trolley, whose height does not
change."""


Length = TypeVar("Length", float, np.ndarray)


class Joints(NamedTuple):
    """Where the joints of a tower crane stand among its coordinates."""

    slew: int
    trolley: int
    radial_swing: int
    tangential_swing: int
    hoist: int


class Nearest(NamedTuple):
    """Which body is how near to what.

    Attributes:
        distance: Between them [m]; zero or less where they touch.
        body: "load", "hook", "rope", "trolley", or "jib" for all that slews with it.
        obstacle: Name of the solid, "ground" or "own mast".
    """

    distance: float
    body: str
    obstacle: str


class Touch(NamedTuple):
    """Where a body and an obstacle are nearest to each other.

    Attributes:
        room: By how much their distance is more than required [m].
        required: The distance that is required [m].
        body: "load", "hook", "rope" or "trolley".
        on_body: The point of the body [m], shape (3,).
        on_obstacle: The point of the obstacle [m], shape (3,).
        normal: Unit vector from the obstacle to the body, shape (3,).
    """

    room: float
    required: float
    body: str
    on_body: np.ndarray
    on_obstacle: np.ndarray
    normal: np.ndarray


@dataclass(frozen=True, eq=False)
class Clearance:
    """What stands about a crane, and how near the crane comes to it.

    Attributes:
        crane: The crane.
        site: Where it stands.
    """

    crane: Crane
    site: Site

    def __post_init__(self) -> None:
        """Check that the crane is one of which a place says all.

        Raises:
            MissingRole: If it is not a tower crane.
            ModelError: If it moves in other joints, too.
        """
        self.crane.layout.tower("A planned lift")

    @cached_property
    def joints(self) -> Joints:
        """Where the joints stand among the coordinates."""
        return Joints(*self.crane.layout.tower("A planned lift"))

    @cached_property
    def place_of(self) -> np.ndarray:
        """Where slew, trolley radius and cable length stand among the coordinates, shape (3,)."""
        return self.crane.layout.drives

    @cached_property
    def solids(self) -> list[Solid]:
        """What stands there, in the frame of the crane."""
        return self.site.seen_by_crane()

    @cached_property
    def bodies(self) -> Bodies:
        """The bodies of the crane and its load."""
        return bodies(self.crane, self.site.load)

    @cached_property
    def height(self) -> float:
        """Of the swing pivot above the crane's foot [m]."""
        (pivot,) = self._frames(self.crane.start.q, self.joints.radial_swing)
        return float(pivot.getTranslation()[2])

    @property
    def shortest(self) -> float:
        """Shortest cable on which the hook, on top of the load, hangs below the trolley [m], not
        less than that of the crane.
        """
        (_, _, hook), (_, _, tall) = self.bodies.hook
        (_, _, trolley), (_, _, deep) = self.bodies.trolley
        return max(
            float(self.crane.lower[self.joints.hoist]),
            float(hook + tall / 2.0 - trolley + deep / 2.0),
        )

    def with_more_distance(self, extra: float) -> Clearance:
        """The same where more distance is asked for [m]."""
        wider = Clearance(self.crane, replace(self.site, distance=self.site.distance + extra))
        wider.__dict__["bodies"] = self.bodies
        return wider

    # --- places -----------------------------------------------------------------------------------

    def place(self, point: np.ndarray, what: str = "point") -> np.ndarray:
        """The place at which the centre of the load is at a point of the site [m], its slew from -π
        to π.

        Raises:
            OutOfRange: If the crane does not reach it: which coordinate is how far out of its
                range.
        """
        x, y, z = self.site.to_crane(point)
        found = np.array([math.atan2(x, -y), math.hypot(x, y), self.height - z])
        (_, low, _), (_, *high) = (
            ends[self.place_of].tolist() for ends in (self.crane.lower, self.crane.upper)
        )
        ranges = zip((low, self.shortest), high, strict=True)
        for words, value, (low, high) in zip(
            ("trolley radius", "cable length"), found[1:], ranges, strict=True
        ):
            within(
                f"{words} for the {what} {quoted(np.round(point, 3).tolist())}",
                float(value),
                low,
                high,
                "m",
            )
        return found

    def point(self, place: np.ndarray) -> np.ndarray:
        """Centre of the load at places, shape (..., 3), in the frame of the crane [m], shape (...,
        3).
        """
        gamma, x, length = np.moveaxis(place, -1, 0)
        return np.stack([x * np.sin(gamma), -x * np.cos(gamma), self.height - length], axis=-1)

    def q(self, place: np.ndarray) -> np.ndarray:
        """All coordinates at a place, shape (n,), the load plumb."""
        q = np.zeros(self.crane.layout.n)
        q[self.place_of] = place
        return q

    def tilt(self, q: np.ndarray) -> np.ndarray:
        """How far the rope leans, or its leaning differs where coordinates do, shape (..., n); in
        [rad], shape (...).
        """
        return np.hypot(q[..., self.joints.radial_swing], q[..., self.joints.tangential_swing])

    # --- what hangs -------------------------------------------------------------------------------

    def envelope(self, length: Length) -> Length:
        """Return how far a point of load, hook or rope may be from where it is with the load plumb
        under its trolley [m], on a cable of a length [m].

        All of these are turned about the pivot by no more than the swing of the site.
        """
        return 2.0 * (length + self.bodies.below) * math.sin(self.site.swing / 2.0)

    def room(self, place: np.ndarray) -> float:
        """By how much all that hangs, with its envelope of swing, is farther from everything than
        required [m].
        """
        return self.true_room(self.q(place)) - self.envelope(float(place[2]))

    def travel(self, place: np.ndarray, reach: np.ndarray) -> float:
        """By how much `room` changes at most between a place and one that is no farther from it
        than a reach in each coordinate [m].

        A point at the radius r from the slew axis moves by r |Δγ| + |Δx| across and by |Δl| down at
        most; the envelope grows with l.
        """
        gamma, x, length = reach.tolist()
        across = (float(place[1]) + x + self.bodies.spread) * gamma + x
        return math.hypot(across, length) + 2.0 * math.sin(self.site.swing / 2.0) * length

    def true_room(self, q: np.ndarray) -> float:
        """By how much all that hangs is farther from everything than required, at coordinates of
        all joints, shape (n,); in [m].
        """
        return min(self._rooms(q))

    def least(self, q: np.ndarray) -> float:
        """Return the least distance of all that hangs [m], at coordinates of all joints, shape
        (n,); zones count where something is in them.
        """
        room, in_zones = self._rooms(q)
        return min(room + self.site.distance, in_zones if in_zones <= 0.0 else math.inf)

    def moved(self, q: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Return how far any point of what hangs is moved at most between coordinates, shape
        (..., n) each; in [m], shape (...).

        Drives move it one after the other: slew and trolley across, the hoist along a rope that
        leans and so takes it across, too.
        """
        apart = np.abs(other - q)
        swing = np.maximum(self.tilt(q), self.tilt(other))
        slewed, out, hoisted = np.moveaxis(apart[..., self.place_of], -1, 0)
        _, x, length = np.moveaxis(np.maximum(q, other)[..., self.place_of], -1, 0)
        length = length + self.bodies.below
        aside = np.sin(np.minimum(swing, math.pi / 2.0))
        across = (x + self.bodies.spread + length * aside) * slewed + out
        driven = np.sqrt(across**2 + hoisted**2 + 2.0 * aside * across * hoisted)
        return driven + length * self.tilt(apart)

    # --- what slews with the jib ------------------------------------------------------------------

    def slewing_room(self, gamma: float) -> float:
        """By how much all that slews with the jib is farther from every solid than required, at a
        slew angle [rad]; in [m].
        """
        field = self._fields["solids"]
        return (
            min(field.least(moving) for moving in self._slewing(gamma)) - ROUNDING
            if len(field)
            else math.inf
        )

    @cached_property
    def slewing_radius(self) -> float:
        """Farthest point of what slews with the jib from the slew axis [m], at most."""
        return max(body.radius for body in self._upper)

    # --- by name ----------------------------------------------------------------------------------

    def distances(self, q: np.ndarray, *, jib: bool = True) -> dict[str, Nearest]:
        """What is nearest to each obstacle, by its name, at coordinates of all joints, shape (n,);
        the jib counted or not.
        """
        found: dict[str, Nearest] = {}
        jib_parts = self._slewing(float(q[self.joints.slew])) if jib else ()
        for body, kind, moving in itertools.chain(
            self._placed(q), (("jib", "solids", moving) for moving in jib_parts)
        ):
            inflated = 0.0 if kind == "zones" else self.site.distance
            for name, distance in self._fields[kind].each(moving).items():
                found[name] = min(
                    found.get(name, Nearest(math.inf, "", name)),
                    Nearest(distance + inflated, body, name),
                )
        return found

    def nearest(self, q: np.ndarray, *, beside_zones: bool = False) -> Nearest:
        """Return which body that hangs has the least room, at coordinates of all joints, shape
        (n,); zones count where something is in them, or beside them, too.
        """
        zones = {solid.name for solid in self.solids if solid.zone}
        return min(
            (
                found
                for found in self.distances(q, jib=False).values()
                if beside_zones or found.obstacle not in zones or found.distance <= 0.0
            ),
            key=lambda one: one.distance - self.site.distance * (one.obstacle not in zones),
        )

    def touches(self, q: np.ndarray, far: float) -> Iterator[Touch]:
        """Where all that hangs is nearest to each obstacle with less room than a distance [m], at
        coordinates of all joints, shape (n,).
        """
        for body, kind, moving in self._placed(q):
            for distance, on_body, on_obstacle, normal in self._fields[kind].witnesses(moving):
                if (room := distance - moving.inflated) < far:
                    yield Touch(room, moving.inflated, body, on_body, on_obstacle, normal)

    # --- inside -----------------------------------------------------------------------------------

    @cached_property
    def _fields(self) -> dict[str, Field]:
        here = np.eye(3), np.zeros(3)
        ground = coal.Halfspace(
            np.array([0.0, 0.0, 1.0]), self.site.ground - float(self.site.foot[2])
        )
        solids, zones = (
            [
                (one.name, (shape, *here))
                for one in self.solids
                if one.zone is zone
                for shape in one.geometries()
            ]
            for zone in (False, True)
        )
        longest = float(self.crane.upper[self.joints.hoist])
        low = (
            self.height
            + self.bodies.trolley[0][2]
            - self.bodies.trolley[1][2] / 2.0
            - self.site.distance
            - self.envelope(longest)
        )
        tall = {one.name for one in self.solids if one.vertices[:, 2].max() > low - ROUNDING}
        return {
            "solids": Field(solids),
            "tall solids": Field([one for one in solids if one[0] in tall]),
            "solids and mast": Field([*solids, *((MAST, one) for one in self.bodies.mast)]),
            "zones": Field(zones),
            "ground": Field([(GROUND, (ground, *here))]),
        }

    @cached_property
    def _bodies(self) -> dict[str, dict[str, Body]]:
        """What hangs, inflated by the required distance, and bare against zones."""
        made, here = {}, (np.eye(3), np.zeros(3))
        for kind, inflated in (("inflated", self.site.distance), ("bare", 0.0)):
            boxes = {"trolley": self.bodies.trolley, "hook": self.bodies.hook}
            made[kind] = {
                name: Body((coal.Box(size), np.eye(3), centre), inflated)
                for name, (centre, size) in boxes.items()
            }
            made[kind]["load"] = Body((hull(self.bodies.load), *here), inflated)
        return made

    @cached_property
    def _above(self) -> float:
        """How far the swing pivot is above the load where the hoist stands at zero [m]."""
        start = self.crane.start.q
        pivot, load = self._frames(start, self.joints.radial_swing, self.joints.hoist)
        return math.dist(pivot.getTranslation(), load.getTranslation()) - float(
            start[self.joints.hoist]
        )

    @cached_property
    def _upper(self) -> list[Body]:
        return [Body(placed, self.site.distance) for placed in self.bodies.upper]

    def _rooms(self, q: np.ndarray) -> tuple[float, float]:
        """Return by how much all that hangs is farther than required from everything but zones,
        and from zones [m].
        """
        least = [math.inf, math.inf]
        for _, kind, moving in self._placed(q):
            least[kind == "zones"] = min(least[kind == "zones"], self._fields[kind].least(moving))
        return least[0] - ROUNDING, least[1] - ROUNDING

    def _placed(self, q: np.ndarray) -> Iterator[tuple[str, str, Placed]]:
        """Each body that hangs, at its place, with each kind of obstacle that it has to keep away
        from.
        """
        trolley, load = self._frames(q, self.joints.trolley, self.joints.hoist)
        length = float(q[self.joints.hoist]) + self._above
        for which, hanging in self._bodies.items():
            for name, kinds in _KEEPS_FROM[which].items():
                kinds = [kind for kind in kinds if len(self._fields[kind])]
                if not kinds:
                    continue
                if name == "rope":
                    inflated = self.site.distance if which == "inflated" else 0.0
                    moving = rope(load, self.bodies.falls, length, inflated)
                else:
                    moving = hanging[name].put(trolley if name == "trolley" else load)
                for kind in kinds:
                    yield name, kind, moving

    def _slewing(self, gamma: float) -> Iterator[Placed]:
        q = np.zeros(self.crane.layout.n)
        q[self.joints.slew] = gamma
        (frame,) = self._frames(q, self.joints.slew)
        for body in self._upper:
            yield body.put(frame)

    @cached_property
    def _data(self) -> pin.Data:
        return self.crane.model.createData()

    def _frames(self, q: np.ndarray, *joints: int) -> list[coal.Transform3s]:
        """Return where joints are, by their numbers among the coordinates."""
        with _KINEMATICS:
            pin.forwardKinematics(self.crane.model, self._data, q)
            placements = [self._data.oMi[joint + 1] for joint in joints]
            return [coal.Transform3s(one.rotation, one.translation) for one in placements]
