"""Distances of a tower crane, whose bodies move in closed form.

A place is slew [rad], trolley radius [m] and cable length [m]. What hangs is load, hook and rope;
the trolley counts with them. Each of these is compared with what it can meet:

* Load, hook and rope with all solids, with the crane's own mast and base, and with zones. A zone is
  only kept out of, at any distance.
* The trolley with the solids that are tall enough for it, since it rolls at a constant height.
* The load with the ground, since it hangs lowest.
* Load and hook with what slews below the trolley, since the rope begins at the trolley.

What slews with the jib is compared with the solids. `cranedyn.lifts.planning.coverage` checks that
no pair of a body and an obstacle is left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import coal
import numpy as np

from cranedyn.lifts.planning.clearance import (
    ROUNDING,
    Clearance,
    ComparedBody,
    MovingBody,
    OutOfReach,
    keeping,
    point_text,
)
from cranedyn.lifts.planning.crane_bodies import (
    CollisionBodies,
    CraneParts,
    collision_bodies,
    corners_of,
    refuse_other_kinematics,
    with_hook_above_rigging,
)
from cranedyn.lifts.planning.fields import Body, Field, Placed
from cranedyn.lifts.planning.site import BELOW_UPPER, HANGING, MAST, OWN_BASE, OWN_UPPER
from cranedyn.lifts.planning.solids import hull
from cranedyn.references.flat import recover


class Joints(NamedTuple):
    """Indices of the joints of a tower crane among its coordinates."""

    slew: int
    trolley: int
    radial_swing: int
    tangential_swing: int
    hoist: int


@dataclass(frozen=True, eq=False)
class _Fields:
    """Obstacles of a site in the frame of the crane, by what keeps from them.

    Attributes:
        solids: All solids but zones.
        tall_solids: Solids that reach up to where the trolley may come close to them.
        solids_and_mast: All solids but zones, and the crane's own mast and base.
    """

    solids: Field
    tall_solids: Field
    solids_and_mast: Field


@dataclass(frozen=True, eq=False)
class TowerClearance(Clearance):
    """A tower crane and its site, and the distances between them."""

    jib_apart: ClassVar[bool] = True

    def _refuse_other_joints(self) -> None:
        refuse_other_kinematics(self.crane)

    @cached_property
    def joints(self) -> Joints:
        """Indices of the joints among the coordinates."""
        return Joints(*self.crane.layout.tower("A planned lift"))

    @cached_property
    def bodies(self) -> CollisionBodies:
        """See `Clearance`."""
        return with_hook_above_rigging(collision_bodies(self.crane, self.site.load), self.site)

    @property
    def parts(self) -> CraneParts:
        """See `Clearance`."""
        own = {MAST: HANGING, OWN_UPPER: BELOW_UPPER}
        if self.site.base is not None:
            own[OWN_BASE] = HANGING
        return CraneParts(standing=("mast",), moving=("jib", "trolley"), own=own)

    @property
    def standing(self) -> list[np.ndarray]:
        """See `Clearance`."""
        return self.bodies.mast

    @property
    def turning(self) -> int:
        """See `Clearance`."""
        return 0

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

    @property
    def reach(self) -> tuple[float, float]:
        """See `Clearance`."""
        trolley = self.joints.trolley
        return float(self.crane.lower[trolley]), float(self.crane.upper[trolley])

    @cached_property
    def swing_inertia(self) -> float:
        """See `Clearance`."""
        crane = self.crane
        # Of the load about its X axis, and of the links between the swing joints, which turn with
        # the rope, in the mean of both swings. It is exact where both swings have the same inertia;
        # what is left of the swing of a long load is for the controller.
        return (crane.payload_inertia[0, 0] + sum(crane.dummy_inertia) / 2.0) / crane.payload_mass

    # --- places -----------------------------------------------------------------------------------

    @property
    def swing_joints(self) -> tuple[int, int]:
        """See `Clearance`."""
        return self.joints.radial_swing, self.joints.tangential_swing

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
            f"{point_text(point)} is {radius:.2f} m from it. Move the {label} {direction}, or take "
            "a crane with another jib.",
            name="distance from the slew axis",
            value=radius,
            allowed=f"{inner:g} to {outer:g}",
        )

    def highest_place(self, point: np.ndarray, label: str, reserve: float) -> np.ndarray:
        """See `Clearance`."""
        top = float(self.site.foot[2]) + self.height - self.shortest_cable - reserve
        return self.place(np.array([*point, top]), label)

    def point(self, drive_position: np.ndarray) -> np.ndarray:
        """Return the centre of the load in the frame of the crane [m], shape (..., 3), at places,
        shape (..., 3).
        """
        gamma, x, length = np.moveaxis(drive_position, -1, 0)
        return np.stack([x * np.sin(gamma), -x * np.cos(gamma), self.height - length], axis=-1)

    def q(self, drive_position: np.ndarray) -> np.ndarray:
        """See `Clearance`."""
        q = np.zeros((*np.shape(drive_position)[:-1], self.crane.layout.n))
        q[..., self.drive_joints] = drive_position
        return q

    def cable(self, q: np.ndarray) -> np.ndarray:
        """See `Clearance`."""
        return q[..., self.hoist]

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

    def swing(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `Clearance`."""
        swings = list(self.swing_joints)
        return q[..., swings], v[..., swings]

    def hang_along(self, q: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """See `Clearance`.

        The radial angle turns first, so that it takes the outward part F_o against the vertical
        part W, and the tangential angle takes the part F_t along the direction of positive slew
        against √(W² + F_o²).
        """
        gamma = q[:, self.joints.slew]
        down = -direction[:, 2]
        # At a slew of zero the jib points along -Y, and positive slew moves it towards +X.
        outward = direction[:, 0] * np.sin(gamma) - direction[:, 1] * np.cos(gamma)
        tangential = direction[:, 0] * np.cos(gamma) + direction[:, 1] * np.sin(gamma)
        hanging = q.copy()
        hanging[:, self.joints.radial_swing] = -np.arctan2(outward, down)
        hanging[:, self.joints.tangential_swing] = -np.arctan2(tangential, np.hypot(down, outward))
        return hanging

    def load_accelerations(
        self, drive_position: np.ndarray, first: np.ndarray, second: np.ndarray
    ) -> np.ndarray:
        """See `Clearance`: outward and along the circle round the slew axis.

        In polar coordinates about the slew axis the load at the radius x and the angle γ
        accelerates by x'' - x γ'² outward and by x γ'' + 2 x' γ' along the circle.
        """
        radius = drive_position[:, 1]
        slew_rate = first[:, 0]
        radial_rate = first[:, 1]
        outward = second[:, 1] - radius * slew_rate**2
        tangential = radius * second[:, 0] + 2.0 * radial_rate * slew_rate
        return np.column_stack([outward, tangential])

    def carry(
        self, oscillating: np.ndarray, rope: np.ndarray, drive_position: np.ndarray
    ) -> np.ndarray:
        """See `Clearance`."""
        q = recover(oscillating, rope, self.height, self.swing_inertia)
        # `recover` knows the slew up to full turns.
        slew = self.joints.slew
        q[:, slew] += drive_position[0, 0] - q[0, slew]
        return q

    # --- bounds of motions ------------------------------------------------------------------------

    def travel(self, drive_position: np.ndarray, reach: np.ndarray) -> float:
        """Return an upper bound of the change of `swing_margin` [m] between a place and any that is
        no farther from it than a reach in each coordinate [rad, m, m], shape (3,).

        A point at the radius r from the slew axis moves by r |Δγ| + |Δx| across and by |Δl| down at
        most; the envelope grows with l.
        """
        slewed, outward, hoisted = reach.tolist()
        largest_radius = float(drive_position[1]) + outward + self.bodies.spread
        across = largest_radius * slewed + outward
        envelope_growth = self.swing_chord * hoisted
        return math.hypot(across, hoisted) + envelope_growth

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

    def structure_displacement(self, q: np.ndarray, q_end: np.ndarray) -> np.ndarray:
        """See `Clearance`. The slew turns all of it, and the trolley rolls."""
        change = np.abs(q_end - q)
        trolley = np.maximum(np.abs(q), np.abs(q_end))[..., self.joints.trolley]
        farthest = trolley + self._trolley(0.0).radius
        radius = np.maximum(farthest, self.slewing_radius)
        return radius * change[..., self.joints.slew] + change[..., self.joints.trolley]

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

    # --- what is compared with what ---------------------------------------------------------------

    def compared_fields(self) -> Iterator[tuple[str, Field]]:
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
        solids = self._solid_shapes

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
        return _Fields(
            solids=Field(solids),
            tall_solids=Field((name, shape) for name, shape in solids if name in tall),
            solids_and_mast=Field([*solids, *mast]),
        )

    @cached_property
    def _hanging(self) -> list[ComparedBody]:
        """The trolley and what hangs, with what they keep from."""
        trolley = ComparedBody(
            "trolley", self._trolley(self.site.distance), [self._fields.tall_solids]
        )
        return [*keeping([trolley]), *self._hanging_bodies(self._fields.solids_and_mast)]

    def _trolley(self, inflated: float) -> Body:
        """Return the trolley, inflated by a distance [m]."""
        shape = coal.Box(self.bodies.trolley.size)
        place = coal.Transform3s(np.eye(3), self.bodies.trolley.centre)
        return Body(shape, inflated, place)

    @cached_property
    def _slewing_bodies(self) -> list[Body]:
        """All that slews with the jib, inflated by the required distance."""
        return self._upper(self.site.distance)

    def _upper(self, inflated: float) -> list[Body]:
        """Return all that slews with the jib, inflated by a distance [m]."""
        bodies = []
        for shape in self.bodies.upper:
            within = coal.Transform3s(shape.rotation, shape.translation)
            bodies.append(Body(shape.geometry, inflated, within))
        return bodies

    @cached_property
    def _structure(self) -> list[MovingBody]:
        """See `Clearance`."""
        solids = self._fields.solids
        parts = [MovingBody("trolley", self.joints.trolley, self._trolley(0.0), solids)]
        for body in self._upper(0.0):
            parts.append(MovingBody("jib", self.joints.slew, body, solids))
        return parts

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
        return [(name, self._body(name, self.site.distance)) for name in ("load", "hook")]

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

    def _placed_near_own(self, q: np.ndarray) -> Iterator[tuple[str, Field, Placed]]:
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
            for _, field, moving in self._placed_near_own(q):
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

    def _placed_jib(self, q: np.ndarray) -> Iterator[tuple[Field, Placed]]:
        for moving in self._slewing(float(q[self.joints.slew])):
            yield self._fields.solids, moving

    def out_of_range(self) -> Iterator[tuple[str, str]]:
        """See `Clearance`. The trolley rolls at a constant height: a solid that ends far enough
        below it needs no comparison.
        """
        for solid in self.site.seen_by_crane():
            top = float(solid.vertices[:, 2].max())
            if top + self.site.distance < self.trolley_bottom:
                yield "trolley", solid.name
