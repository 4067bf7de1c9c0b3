"""Distances of a crane whose load hangs at the end of a chain of joints.

A place is the positions of both drives that carry the pivot, and that of the hoist. The bodies are
those that the URDF shows, by the joint that carries them (`cranedyn.lifts.planning.chain_bodies`).
Each is compared with what it can meet:

* Load, hook and rope with all solids and with what stands of the crane, such as the columns of its
  runway, by the required distance; and with zones, in which they must not be.
* Each link that drives move, such as a bridge with its legs or a boom, with all solids, and with
  the ground if its height changes.
* The load with the ground, since it hangs lowest.
* Load and hook with each of these links, such as a gantry's legs. The hook may come near to the
  link that it hangs on, and the rope may run between the girders of a bridge: they must not touch.
  Nor must that last link touch what stands.

A motion is proven by bounds of how far its bodies move. A joint that turns by δ moves a point at
the distance r from its axis by r δ at most, and one that slides by δ moves it by δ. Several joints
move it by the sum of that, where r is the largest distance that the others leave it
(Schwarzer, Saha, Latombe 2005).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import coal
import numpy as np

from cranedyn.lifts.planning.chain_bodies import ChainBodies, chain_bodies
from cranedyn.lifts.planning.clearance import (
    ROUNDING,
    Clearance,
    ComparedBody,
    MovingBody,
    OutOfReach,
    point_text,
)
from cranedyn.lifts.planning.crane_bodies import (
    CraneParts,
    DrawnShape,
    corners_of,
    with_hook_above_rigging,
)
from cranedyn.lifts.planning.fields import Body, Field, Placed
from cranedyn.lifts.planning.hoist_chain import CarrierLines, HoistChain
from cranedyn.lifts.planning.site import BELOW_UPPER, GROUND, HANGING, OWN_BASE, OWN_STRUCTURE
from cranedyn.lifts.planning.solids import hull
from cranedyn.model.layout import ALIGNED, LEVEL

_GRID_POINTS = 41
"""Positions of each drive from which the drives above a point are searched."""

_TRIED_STARTS = 8
"""Number of the nearest of these from which the search goes on."""

_RANGE_SLACK = 1e-6
"""How far a solution may be out of the range of a drive, to whose end it is then moved [rad or m].
"""

_POSTURES = 5
"""Positions of each drive in which the shortest cable is looked for."""

_TRIED_LENGTHS = 40
"""Lengths of the rope at which it is looked whether the hook touches the link that carries it."""

_CABLE_TOLERANCE = 1e-3
"""Accuracy of the shortest cable [m]."""

_PLUMB_STEP = 1e-6
"""Time over which the rate of a plumb rope is taken by a difference [s]."""

_MAX_ROPE_MARGIN = 0.5
"""Margin of the rope from links of the crane beyond which it is not told apart [m]: the larger, the
more of the rope moves near the links, see `ChainClearance.displacements`."""

_MAX_LEAN = math.radians(20.0)
"""Lean of a rope up to which its lower part is known to be below the links of the crane: four times
the swing that a lift is usually allowed."""


class _Ball(NamedTuple):
    """A ball around the shapes of a link, in the frame of its joint.

    Attributes:
        joint: Index of the joint among the coordinates.
        centre: Its centre [m], shape (3,).
        radius: Its radius [m].
    """

    joint: int
    centre: np.ndarray
    radius: float


class _OwnLink(NamedTuple):
    """A link of the crane as an obstacle to what hangs.

    Attributes:
        name: Its name among the obstacles.
        joint: Index of the joint that carries it.
        field: Its shapes, in the frame of that joint.
        bodies: What keeps the required distance from it: the load, and the hook if it hangs on
            another link.
        touching: What may come near to it and must not touch it: the hook if it hangs on this link,
            and otherwise the rope, which may run between two girders.
    """

    name: str
    joint: int
    field: Field
    bodies: tuple[str, ...]
    touching: tuple[str, ...]


class _Posture(NamedTuple):
    """Where the joints of a crane have its bodies.

    Attributes:
        frames: Frames of both drives that carry the pivot, by the index of their joints.
        load: Frame of the joint that carries the load.
        cable: Length of the cable [m].
    """

    frames: dict[int, coal.Transform3s]
    load: coal.Transform3s
    cable: float


class _Steps(NamedTuple):
    """Steps from coordinates to others.

    Attributes:
        start: Coordinates from which they lead, shape (rows, n).
        change: How much each coordinate changes, shape (rows, n).
        lines: Axes of the drives at the start, see `ChainClearance._lines`.
        lean: Angle of the rope from plumb at that end at which it is larger [rad], shape (rows,).
    """

    start: np.ndarray
    change: np.ndarray
    lines: CarrierLines | None
    lean: np.ndarray


class _Margins(NamedTuple):
    """Margins at a place [m].

    Attributes:
        hanging: Of what hangs to everything from which it keeps the required distance.
        zones: Of what hangs to zones.
        structure: Of links that drives move, to everything from which they keep that distance.
        hook: Of the hook to the link on which it hangs, see `ChainClearance._touching`; infinite
            where it was not asked for.
        last_link: Of that link to what stands of the crane, likewise.
        rope: Of the rope to links of the crane, likewise.
    """

    hanging: float
    zones: float
    structure: float
    hook: float
    last_link: float
    rope: float

    @property
    def contact(self) -> float:
        """Of all to what they must not touch."""
        return min(self.hook, self.last_link, self.rope)


@dataclass(frozen=True, eq=False)
class ChainClearance(Clearance):
    """A crane of a chain of joints and its site, and the distances between them."""

    def _refuse_other_joints(self) -> None:
        _ = self.chain  # `HoistChain` refuses them

    @cached_property
    def chain(self) -> HoistChain:
        """The joints of the crane."""
        return HoistChain(self.crane)

    @cached_property
    def bodies(self) -> ChainBodies:
        """See `Clearance`."""
        return with_hook_above_rigging(chain_bodies(self.crane, self.site.load), self.site)

    @property
    def parts(self) -> CraneParts:
        """See `Clearance`."""
        own: dict[str, tuple[str, ...]] = {OWN_STRUCTURE: HANGING}
        last = self.bodies.links.get(self.chain.carriers[1])
        if last is not None and self.bodies.standing:
            own[OWN_STRUCTURE] = (*HANGING, last.name)
        for link in self._own_links:
            own[link.name] = (*link.bodies, *link.touching)
        tipped = tuple(self.bodies.links[joint].name for joint in self._tipped_links)
        if tipped:
            own[GROUND] = tipped
        if self.site.base is not None:
            own[OWN_BASE] = HANGING
        links = tuple(link.name for link in self.bodies.links.values())
        undrawn = list(self.bodies.undrawn)
        if not self.bodies.standing:
            undrawn.append("what stands")
        return CraneParts(("structure",), links, own, undrawn=tuple(undrawn))

    @property
    def standing(self) -> list[np.ndarray]:
        """See `Clearance`."""
        return self.bodies.standing

    @cached_property
    def turning(self) -> int | None:
        """See `Clearance`. It is the first drive, or the second one on a first that slides."""
        for i, joint in enumerate(self.chain.carriers):
            described = self.crane.layout.joints[joint]
            if described.kind == "revolute":
                return i if abs(described.axis[2]) >= ALIGNED else None
        return None

    @cached_property
    def shortest_cable(self) -> float:
        """Least coordinate of the hoist from which on the hook does not touch the link that carries
        it [m], in a few positions of both drives over their ranges.

        A link that leans, such as a boom, is nearest to the hook in another position than one that
        is level, so that no formula tells it. It is where a search begins; that the hook touches
        nothing is proven with everything else, see `_touching`.
        """
        lowest = float(self.crane.lower[self.hoist])
        longest = float(self.crane.upper[self.hoist])
        link = self.bodies.links.get(self.chain.carriers[1])
        if link is None:
            return lowest
        field = Field(("carrier", hull(corners_of(shape))) for shape in link.shapes)
        hook = self._body("hook", 0.0)

        def touches(carriers: np.ndarray, length: float) -> bool:
            q = self.q(np.array([*carriers, length]))
            carrier, load = self._frames(q, self.chain.carriers[1], self.hoist)
            return field.least(hook.put(carrier.inverse() * load)) <= 2.0 * ROUNDING

        shortest = lowest
        for carriers in self._grid(_POSTURES):
            # From the longest rope upwards, to the first length at which they touch.
            lengths = np.linspace(longest, shortest, _TRIED_LENGTHS)
            touching = [i for i, length in enumerate(lengths) if touches(carriers, length)]
            if not touching:
                continue
            if touching[0] == 0:
                return longest  # no rope is long enough there
            free = lengths[touching[0] - 1]
            shortest = lengths[touching[0]]
            while free - shortest > _CABLE_TOLERANCE:
                middle = (free + shortest) / 2.0
                if touches(carriers, middle):
                    shortest = middle
                else:
                    free = middle
            shortest = free
        return float(shortest)

    @cached_property
    def reach(self) -> tuple[float, float]:
        """See `Clearance`."""
        positions = self.chain.pivot(self._grid(_GRID_POINTS)).point
        radii = np.linalg.norm(positions[:, :2], axis=1)
        return float(radii.min()), float(radii.max())

    @cached_property
    def swing_inertia(self) -> float:
        """See `Clearance`."""
        crane = self.crane
        first, second = self.chain.swings
        # With the load about its centre, and the links between the swing joints about the pivot,
        # the inertia about a swing axis through the pivot is m l² and this. It differs a little
        # between both axes, and a path has one number for both: their mean.
        hanging = self.chain.about_swings(self.hoist, crane.payload_inertia)
        for joint in (first, second):
            about_pivot = crane.model.inertias[joint + 1].matrix()[3:, 3:]
            about = self.chain.about_swings(joint, about_pivot)
            # The first swing does not turn about the axis of the second.
            hanging = hanging + (about if joint == second else about * [1.0, 0.0])
        return float(hanging.mean()) / crane.payload_mass

    # --- places -----------------------------------------------------------------------------------

    @property
    def swing_joints(self) -> tuple[int, int]:
        """See `Clearance`."""
        return self.chain.swings

    def place(self, point: np.ndarray, label: str = "point") -> np.ndarray:
        """See `Clearance`. Of the places that are found it is the one nearest to the start of the
        crane.
        """
        target = self.site.to_crane(point)
        carriers = self._carriers_above(target[:2], point, label)
        pivot_height = float(self.chain.pivot(carriers[None]).point[0, 2])
        length = pivot_height - float(target[2]) - self.chain.offset
        self._refuse_length(length, point, label, begins="There the centre")
        return np.array([*carriers, length])

    def highest_place(self, point: np.ndarray, label: str, reserve: float) -> np.ndarray:
        """See `Clearance`."""
        target = self.site.to_crane(np.array([*point, 0.0]))
        carriers = self._carriers_above(target[:2], np.asarray(point), label)
        return np.array([*carriers, self.shortest_cable + reserve])

    def _carriers_above(self, target: np.ndarray, point: np.ndarray, label: str) -> np.ndarray:
        """Return the positions of both drives with which the pivot is above a target in plan, in
        the frame of the crane [m], shape (2,).

        Raises:
            OutOfReach: If there are none within the ranges of the drives.
        """
        grid = self._grid(_GRID_POINTS)
        off = np.linalg.norm(self.chain.pivot(grid).point[:, :2] - target, axis=1)
        nearest = grid[np.argsort(off, kind="stable")[:_TRIED_STARTS]]
        found = self.chain.carriers_above(np.tile(target, (len(nearest), 1)), nearest)
        low, high = self._carrier_ranges
        if self.turning is not None:
            # Newton's method may go round.
            beyond = found[:, self.turning] - low[self.turning] + _RANGE_SLACK
            found[:, self.turning] -= 2.0 * math.pi * np.floor(beyond / (2.0 * math.pi))
        inside = (found >= low - _RANGE_SLACK) & (found <= high + _RANGE_SLACK)
        found = np.clip(found[inside.all(axis=1)], low, high)
        if not len(found):
            raise OutOfReach(
                f"The crane does not reach above the {label} at {point_text(point)}: its hook "
                f"comes no nearer to that in plan than about {off.min():.2f} m. Move the {label}, "
                "or the crane.",
                name="distance in plan from the reach of the crane",
                value=float(off.min()),
                allowed="0",
            )
        at_start = self.crane.start.q[list(self.chain.carriers)]
        ranges = np.maximum(high - low, _RANGE_SLACK)  # a drive may have none
        distances = np.abs((found - at_start) / ranges).sum(axis=1)
        return found[int(distances.argmin())]

    @cached_property
    def _carrier_ranges(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest position of both drives that carry the pivot, shape (2,) each. Of a
        drive that turns the crane by more than a full turn they are one turn, from -π on as far as
        that is in its range.
        """
        carriers = list(self.chain.carriers)
        low = self.crane.lower[carriers].copy()
        high = self.crane.upper[carriers].copy()
        turning = self.turning
        if turning is not None and high[turning] - low[turning] > 2.0 * math.pi:
            low[turning] = min(max(low[turning], -math.pi), high[turning] - 2.0 * math.pi)
            high[turning] = low[turning] + 2.0 * math.pi
        return low, high

    def _grid(self, count: int) -> np.ndarray:
        """Return positions of both drives over their ranges, a count of each; shape (count², 2)."""
        low, high = self._carrier_ranges
        first = np.linspace(low[0], high[0], count)
        second = np.linspace(low[1], high[1], count)
        return np.array(list(itertools.product(first, second)))

    def point(self, drive_position: np.ndarray) -> np.ndarray:
        """See `Clearance`."""
        places = np.asarray(drive_position, dtype=float)
        rows = places.reshape(-1, 3)
        points = self.chain.pivot(rows[:, :2]).point
        points[:, 2] -= rows[:, 2] + self.chain.offset
        return points.reshape(places.shape)

    def q(self, drive_position: np.ndarray) -> np.ndarray:
        """See `Clearance`."""
        places = np.asarray(drive_position, dtype=float)
        q = self.chain.plumb(places.reshape(-1, 3))
        return q.reshape(*places.shape[:-1], -1)

    def cable(self, q: np.ndarray) -> np.ndarray:
        """See `Clearance`."""
        return q[..., self.hoist] + self.chain.offset

    def tilt(self, q: np.ndarray) -> np.ndarray:
        """See `Clearance`. This is the angle itself."""
        shape = np.shape(q)[:-1]
        rope = self.chain.rope(q.reshape(-1, q.shape[-1]))
        aside = np.linalg.norm(rope[:, :2], axis=1)
        return np.arctan2(aside, -rope[:, 2]).reshape(shape)

    def swing(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `Clearance`."""
        shape = np.shape(q)[:-1]
        q = q.reshape(-1, q.shape[-1])
        v = v.reshape(q.shape)
        swings = list(self.chain.swings)
        drives = self.drive_joints

        def plumb(places: np.ndarray) -> np.ndarray:
            return self.chain.plumb(places)[:, swings]

        later = plumb(q[:, drives] + _PLUMB_STEP * v[:, drives])
        earlier = plumb(q[:, drives] - _PLUMB_STEP * v[:, drives])
        angles = q[:, swings] - plumb(q[:, drives])
        rates = v[:, swings] - (later - earlier) / (2.0 * _PLUMB_STEP)
        return angles.reshape(*shape, 2), rates.reshape(*shape, 2)

    def hang_along(self, q: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """See `Clearance`."""
        attitude = self.chain.pivot(q[:, list(self.chain.carriers)]).attitude
        unit = direction / np.linalg.norm(direction, axis=1)[:, None]
        hanging = q.copy()
        hanging[:, list(self.chain.swings)] = self.chain.swing_along(attitude, unit)
        return hanging

    def load_accelerations(
        self, drive_position: np.ndarray, first: np.ndarray, second: np.ndarray
    ) -> np.ndarray:
        """See `Clearance`: along X and Y of the crane."""
        pivot = self.chain.pivot_acceleration(drive_position[:, :2], first[:, :2], second[:, :2])
        return pivot[:, :2]

    def carry(
        self, oscillating: np.ndarray, rope: np.ndarray, drive_position: np.ndarray
    ) -> np.ndarray:
        """See `Clearance`."""
        inertia = self.swing_inertia
        plumb_cable = drive_position[:, 2] + self.chain.offset
        # The centre of oscillation is at reach = l + inertia / l below the pivot.
        first = np.column_stack([drive_position[:, :2], plumb_cable + inertia / plumb_cable])
        found = self.chain.carriers_along(oscillating, rope, first)
        reach = found[:, 2]
        cable = (reach + np.sqrt(reach**2 - 4.0 * inertia)) / 2.0
        q = np.zeros((len(oscillating), self.crane.layout.n))
        q[:, list(self.chain.carriers)] = found[:, :2]
        q[:, self.hoist] = cable - self.chain.offset
        return self.hang_along(q, -rope)

    # --- bounds of motions ------------------------------------------------------------------------

    def travel(self, drive_position: np.ndarray, reach: np.ndarray) -> float:
        """See `Clearance`. What hangs moves against what stands, links of the crane against what
        stands, and what hangs against links of the crane; this is the largest of these bounds.
        """
        places = drive_position[None]
        change = np.zeros((1, self.crane.layout.n))
        change[0, self.drive_joints] = reach
        lines = self._lines(places[:, :2])
        pivot_moved, turned = self._pivot_bound(lines, change)
        # The envelope of the swing grows with the rope.
        hoisted = float(reach[2]) * (1.0 + self.swing_chord)
        # A plumb load turns about the vertical only, no faster than the drives turn the crane.
        spread = self.bodies.spread
        hanging = float(pivot_moved[0]) + spread * float(turned[0]) + hoisted
        bounds = [hanging, float(self._structure_bound(lines, change)[0])]
        length = float(drive_position[2]) + hoisted + self.chain.offset + self.bodies.below
        for joint in self.bodies.links:
            moved, turned = self._pivot_bound(lines, change, beyond=joint)
            # Seen from a link that is tipped, a plumb rope turns about the pivot.
            tipped = sum(float(change[0, i]) for i in self._tipping if i <= joint)
            relative = float(moved[0]) + spread * float(turned[0]) + length * tipped
            bounds.append(relative + hoisted)
        return max(bounds)

    def displacement(self, q: np.ndarray, q_end: np.ndarray) -> np.ndarray:
        """See `Clearance`."""
        shape = np.broadcast_shapes(np.shape(q), np.shape(q_end))
        steps = self._steps(q, q_end)
        structure = self._structure_bound(steps.lines, steps.change)
        return self._displacement(steps, structure).reshape(shape[:-1])

    def structure_displacement(self, q: np.ndarray, q_end: np.ndarray) -> np.ndarray:
        """See `Clearance`."""
        shape = np.broadcast_shapes(np.shape(q), np.shape(q_end))
        steps = self._steps(q, q_end)
        return self._structure_bound(steps.lines, steps.change).reshape(shape[:-1])

    def _steps(self, q: np.ndarray, q_end: np.ndarray) -> _Steps:
        """Return the steps between coordinates, shape (..., n) each."""
        shape = np.broadcast_shapes(np.shape(q), np.shape(q_end))
        start = np.broadcast_to(q, shape).reshape(-1, shape[-1])
        end = np.broadcast_to(q_end, shape).reshape(start.shape)
        return _Steps(
            start,
            change=np.abs(end - start),
            lines=self._lines(start[:, list(self.chain.carriers)]),
            lean=np.maximum(self.tilt(start), self.tilt(end)),
        )

    def _displacement(self, steps: _Steps, structure: np.ndarray) -> np.ndarray:
        """Return an upper bound of the change of `margin` in steps [m], shape (rows,).

        Args:
            steps: The steps.
            structure: The bound of the links that drives move [m], shape (rows,).
        """
        change = steps.change
        lines = steps.lines
        pivot_moved, turned = self._pivot_bound(lines, change)
        swung = change[:, list(self.chain.swings)].sum(axis=1)
        hoisted = change[:, self.hoist]
        cable = steps.start[:, self.hoist] + self.chain.offset
        length = cable + hoisted + self.bodies.below
        # On the way from one to the other a rope leans no more than at an end and by what turns it.
        # Drives and swings turn the rope about the pivot, with all that hangs on it. A turn about
        # the vertical moves a point by its distance from the plumb line: with the rope leaning by
        # an angle, that is no more than the length times the angle, and the spread.
        about_vertical = np.zeros(len(change))
        if self.turning is not None:
            about_vertical = change[:, self.chain.carriers[self.turning]]
        tipped = turned - about_vertical
        lean = steps.lean + swung + tipped
        hanging = pivot_moved + hoisted + length * (tipped + swung)
        hanging += (self.bodies.spread + length * lean) * about_vertical
        largest = np.maximum(hanging, structure)
        for joint in self.bodies.links:
            # Against a link moves what hangs by the drives between the two, swings, and hoist.
            moved, turned = self._pivot_bound(lines, change, beyond=joint)
            largest = np.maximum(largest, moved + hoisted + length * (turned + swung))
        return largest

    def displacements(self, q: np.ndarray, q_end: np.ndarray) -> np.ndarray:
        """See `Clearance`.

        A crane drives its rope along a girder that may be a hand's breadth beside it. The lower end
        of the rope swings by metres, and the little that hangs as high as the girder does not. So
        the bound of the rope is that of its part above the length `_upper_rope`, and what hangs
        below that is farther from all links than `_MAX_ROPE_MARGIN`, however it moves.
        """
        shape = np.broadcast_shapes(np.shape(q), np.shape(q_end))
        steps = self._steps(q, q_end)
        structure = self._structure_bound(steps.lines, steps.change)
        bounds = [self._displacement(steps, structure), structure, self._rope_displacement(steps)]
        return np.stack(bounds, axis=-1).reshape(*shape[:-1], 3)

    def _rope_displacement(self, steps: _Steps) -> np.ndarray:
        """Return an upper bound of the change of the margin of the rope from links in steps [m],
        shape (rows,).
        """
        change = steps.change
        swung = change[:, list(self.chain.swings)].sum(axis=1)
        hoisted = change[:, self.hoist]
        cable = steps.start[:, self.hoist] + self.chain.offset
        is_upper = (steps.lean <= _MAX_LEAN) & (cable - hoisted >= self._upper_rope)
        length = np.where(is_upper, self._upper_rope, cable + hoisted)
        paid_out = np.where(is_upper, 0.0, hoisted)
        largest = np.zeros(len(change))
        for own in self._own_links:
            if "rope" in own.touching:
                moved, turned = self._pivot_bound(steps.lines, change, beyond=own.joint)
                bound = moved + paid_out + length * (turned + swung)
                largest = np.maximum(largest, bound)
        return largest

    @cached_property
    def _upper_rope(self) -> float:
        """Length of the rope from the pivot beyond which it is `_MAX_ROPE_MARGIN` below all links
        that it must not touch, as long as it leans no more than `_MAX_LEAN` [m]. It is infinite
        where a drive changes the height of the pivot or of a link: there is no such length then.
        """
        beside_rope = [own for own in self._own_links if "rope" in own.touching]
        moves_up = any(self._moves_up(carrier) for carrier in self.chain.carriers)
        if moves_up or not beside_rope:
            return math.inf
        q = self.crane.start.q
        posture = self._posture(q)
        pivot = self.chain.pivot(q[None, list(self.chain.carriers)]).point[0]
        lowest = float(pivot[2])
        for own in beside_rope:
            frame = posture.frames[own.joint]
            for shape in self.bodies.links[own.joint].shapes:
                heights = [float(frame.transform(corner)[2]) for corner in corners_of(shape)]
                lowest = min(lowest, *heights)
        below_pivot = float(pivot[2]) - lowest + _MAX_ROPE_MARGIN + self.bodies.falls
        return below_pivot / math.cos(_MAX_LEAN)

    @cached_property
    def _tipping(self) -> list[int]:
        """Indices of the drives that turn the pivot about another axis than the vertical."""
        return [joint for joint in self.chain.carriers if self.chain.tips(joint)]

    def _lines(self, carriers: np.ndarray) -> CarrierLines | None:
        """Return the axes of both drives that carry the pivot at positions of shape (rows, 2); None
        where neither turns, and the bounds below do not depend on them.
        """
        if not any(self.chain.turns(joint) for joint in self.chain.carriers):
            return None
        return self.chain.carrier_lines(carriers)

    def _pivot_bound(
        self, lines: CarrierLines | None, change: np.ndarray, *, beyond: int = -1
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return how far the pivot moves at most [m], and by how much the drives turn what it
        carries [rad], where coordinates change by no more than a bound; shape (rows,) each.

        Args:
            lines: Axes of the drives, see `_lines`.
            change: Bounds of the change of all coordinates, shape (rows, n).
            beyond: Index of the joint in whose frame this is seen, which then rests; -1 for the
                frame of the crane.
        """
        ball = _Ball(self.chain.swings[0], np.zeros(3), 0.0)
        return self._moved(lines, change, ball, beyond=beyond)

    def _structure_bound(self, lines: CarrierLines | None, change: np.ndarray) -> np.ndarray:
        """Return how far any point of the links that drives move does so at most [m], shape
        (rows,); arguments as of `_pivot_bound`.
        """
        largest = np.zeros(len(change))
        for ball in self._balls:
            moved, _ = self._moved(lines, change, ball)
            largest = np.maximum(largest, moved)
        return largest

    def _moved(
        self,
        lines: CarrierLines | None,
        change: np.ndarray,
        ball: _Ball,
        *,
        beyond: int = -1,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return how far the points of a ball move at most [m], and by how much they are turned
        [rad], where the drives that carry it change by no more than a bound.

        Args:
            lines: Axes of the drives, see `_lines`.
            change: Bounds of the change of all coordinates, shape (rows, n).
            ball: The ball. If its joint is the first swing, both drives carry it.
            beyond: As of `_pivot_bound`.
        """
        moved = np.zeros(len(change))
        turned = np.zeros(len(change))
        point = None if lines is None else lines.point_on(ball.joint, ball.centre)
        # From the outermost drive inwards: what the outer ones have moved is farther from the axes
        # of the inner ones by no more than that.
        for i in reversed(range(2)):
            joint = self.chain.carriers[i]
            if not beyond < joint <= ball.joint:
                continue
            if lines is None or not self.chain.turns(joint):
                moved = moved + change[:, joint]
                continue
            to_point = point - lines.origins[i]
            axis = lines.axes[i]
            along = np.einsum("rj,rj->r", to_point, axis)[:, None]
            distance = np.linalg.norm(to_point - along * axis, axis=1) + ball.radius
            moved = moved + (distance + moved) * change[:, joint]
            turned = turned + change[:, joint]
        return moved, turned

    @cached_property
    def _balls(self) -> list[_Ball]:
        """A ball around the shapes of each link that drives move."""
        balls = []
        for joint, link in self.bodies.links.items():
            corners = np.concatenate([corners_of(shape) for shape in link.shapes])
            centre = (corners.min(axis=0) + corners.max(axis=0)) / 2.0
            radius = float(np.linalg.norm(corners - centre, axis=1).max())
            balls.append(_Ball(joint, centre, radius))
        return balls

    # --- margins ----------------------------------------------------------------------------------

    def margin(self, q: np.ndarray, envelope: float = 0.0) -> float:
        """See `Clearance`. The envelope is that of what hangs; drives and not the swing move the
        other bodies.

        With an envelope, as in the search for a motion, `_touching` is left out: near the pivot a
        rope moves aside far less than the envelope says. A certificate asks without one, of the
        coordinates that a simulated run has.
        """
        if not np.isfinite(q).all():
            return -math.inf
        is_as_it_is = envelope == 0.0
        of_bodies = self._margins_of_bodies(q, contacts=is_as_it_is)
        hanging = min(of_bodies.hanging, of_bodies.zones) - envelope
        return min(hanging, of_bodies.structure, of_bodies.contact) - ROUNDING

    def _margins(self, q: np.ndarray) -> tuple[float, float]:
        """See `Clearance`."""
        if not np.isfinite(q).all():
            return -math.inf, -math.inf
        of_bodies = self._margins_of_bodies(q)
        distance = min(of_bodies.hanging, of_bodies.structure)
        return distance - ROUNDING, min(of_bodies.zones, of_bodies.contact) - ROUNDING

    def margins_by_motion(self, q: np.ndarray) -> np.ndarray:
        """See `Clearance`. The groups are what hangs, the links that drives move, which no swing
        brings nearer to what stands, and the rope beside these links.
        """
        of_bodies = self._margins_of_bodies(q)
        hanging = min(of_bodies.hanging, of_bodies.zones, of_bodies.hook)
        structure = min(of_bodies.structure, of_bodies.last_link)
        rope = of_bodies.rope
        if self._upper_rope < math.inf:
            rope = min(rope, _MAX_ROPE_MARGIN)
        return np.array([hanging, structure, rope]) - ROUNDING

    def _margins_of_bodies(self, q: np.ndarray, *, contacts: bool = True) -> _Margins:
        """Return the margins of all bodies, with or without those of `_touching`."""
        hanging = math.inf
        zones = math.inf
        structure = math.inf
        hook = math.inf
        last_link = math.inf
        rope = math.inf
        posture = self._posture(q)
        beside = (self._beside_obstacles(posture), self._beside_own_links(posture))
        for name, field, moving in itertools.chain(*beside):
            least = field.least(moving)
            if name not in HANGING:
                structure = min(structure, least)
            elif moving.inflated == 0.0:  # only what keeps out of zones is not inflated
                zones = min(zones, least)
            else:
                hanging = min(hanging, least)
        for name, field, moving in self._touching(posture) if contacts else ():
            least = field.least(moving)
            if name == "rope":
                rope = min(rope, least)
            elif name == "hook":
                hook = min(hook, least)
            else:
                last_link = min(last_link, least)
        return _Margins(hanging, zones, structure, hook, last_link, rope)

    # --- what is compared with what ---------------------------------------------------------------

    def compared_fields(self) -> Iterator[tuple[str, Field]]:
        """See `Clearance`."""
        for hanging in self._hanging:
            for field in hanging.fields:
                yield hanging.name, field
        for link in self.bodies.links.values():
            if len(self._solids):
                yield link.name, self._solids
        for own in self._own_links:
            for name in (*own.bodies, *own.touching):
                yield name, own.field
        last = self.bodies.links.get(self.chain.carriers[1])
        if last is not None and len(self._standing_field):
            yield last.name, self._standing_field
        for joint in self._tipped_links:
            yield self.bodies.links[joint].name, self._ground

    @property
    def own_shape_counts(self) -> dict[str, int]:
        """See `Clearance`."""
        counts = {
            OWN_STRUCTURE: len(self.bodies.standing),
            OWN_BASE: int(self.site.base is not None),
        }
        for link in self._own_links:
            counts[link.name] = len(link.field)
        return counts

    def out_of_range(self) -> Iterator[tuple[str, str]]:
        """See `Clearance`. A crane of which nothing is drawn that stands has nothing to compare
        with it; `CraneParts.undrawn` tells of that.
        """
        if not self.bodies.standing:
            for body in HANGING:
                yield body, OWN_STRUCTURE

    # --- inside -----------------------------------------------------------------------------------

    @cached_property
    def _solids(self) -> Field:
        """All solids but zones."""
        return Field(self._solid_shapes)

    @cached_property
    def _hanging(self) -> list[ComparedBody]:
        """What hangs, with what it keeps from."""
        standing = [(OWN_STRUCTURE, hull(corners)) for corners in self.bodies.standing]
        if self.site.base is not None:
            standing.append((OWN_BASE, hull(self.site.base_corners)))
        return self._hanging_bodies(Field([*self._solid_shapes, *standing]))

    @cached_property
    def _moving(self) -> list[MovingBody]:
        """The links that drives move, inflated by the required distance, beside the solids."""
        return self._links_beside_solids(self.site.distance)

    @cached_property
    def _moving_over_ground(self) -> list[MovingBody]:
        """Those that drives move up and down, beside the ground."""
        return self._beside_ground(self._moving)

    @cached_property
    def _structure(self) -> list[MovingBody]:
        """See `Clearance`."""
        links = self._links_beside_solids(0.0)
        return [*links, *self._beside_ground(links)]

    def _links_beside_solids(self, inflated: float) -> list[MovingBody]:
        """Return all shapes of the links that drives move, inflated by a distance [m]."""
        moving = []
        for joint, link in self.bodies.links.items():
            for shape in link.shapes:
                body = _body_of_shape(shape, inflated)
                moving.append(MovingBody(link.name, joint, body, self._solids))
        return moving

    def _beside_ground(self, links: Sequence[MovingBody]) -> list[MovingBody]:
        """Return those of the links that drives move up and down, beside the ground."""
        return [x._replace(field=self._ground) for x in links if x.joint in self._tipped_links]

    @cached_property
    def _own_links(self) -> list[_OwnLink]:
        """The links that drives move, as obstacles to what hangs."""
        links = []
        for joint, link in self.bodies.links.items():
            name = f"own {link.name}"
            field = Field((name, hull(corners_of(shape))) for shape in link.shapes)
            if joint == self.chain.carriers[1]:
                links.append(_OwnLink(name, joint, field, bodies=("load",), touching=("hook",)))
            else:
                links.append(_OwnLink(name, joint, field, bodies=BELOW_UPPER, touching=("rope",)))
        return links

    @cached_property
    def _standing_field(self) -> Field:
        """What stands of the crane, but for its base."""
        return Field((OWN_STRUCTURE, hull(corners)) for corners in self.bodies.standing)

    @cached_property
    def _tipped_links(self) -> list[int]:
        """Joints of the links whose height changes as drives move: they keep from the ground."""
        tipped = []
        for joint in self.bodies.links:
            drives = [carrier for carrier in self.chain.carriers if carrier <= joint]
            if any(self._moves_up(carrier) for carrier in drives):
                tipped.append(joint)
        return tipped

    def _moves_up(self, joint: int) -> bool:
        """Return whether a drive changes the height of what it carries."""
        axis = self.crane.layout.joints[joint].axis
        if self.chain.turns(joint):
            return joint in self._tipping
        return abs(axis[2]) > LEVEL or any(carrier < joint for carrier in self._tipping)

    @cached_property
    def _not_inflated(self) -> dict[str, Body]:
        """Hook and rope, for links that they must not touch."""
        return {name: self._body(name, 0.0) for name in ("hook", "rope")}

    @cached_property
    def _last_link(self) -> list[Body]:
        """Shapes of the link that carries the rope, not inflated."""
        link = self.bodies.links.get(self.chain.carriers[1])
        return [] if link is None else [_body_of_shape(shape, 0.0) for shape in link.shapes]

    @cached_property
    def _load_and_hook(self) -> dict[str, Body]:
        """Load and hook, for distances from the links of the crane itself."""
        return {name: self._body(name, self.site.distance) for name in ("load", "hook")}

    def _posture(self, q: np.ndarray) -> _Posture:
        """Return where the joints have the bodies at coordinates, shape (n,)."""
        first, second = self.chain.carriers
        first_frame, second_frame, load = self._frames(q, first, second, self.hoist)
        frames = {first: first_frame, second: second_frame}
        return _Posture(frames, load, float(self.cable(q)))

    def _placed(self, q: np.ndarray) -> Iterator[tuple[str, Field, Placed]]:
        """See `Clearance`."""
        return self._beside_obstacles(self._posture(q))

    def _placed_near_own(self, q: np.ndarray) -> Iterator[tuple[str, Field, Placed]]:
        """See `Clearance`. The links whose height changes come with the ground."""
        return self._beside_own_links(self._posture(q))

    def _beside_obstacles(self, posture: _Posture) -> Iterator[tuple[str, Field, Placed]]:
        """Yield what hangs and the links that drives move, as `_placed`."""
        for name, body, fields in self._hanging:
            if name == "rope":
                body.stretch(posture.cable)
            placed = body.put(posture.load)
            for field in fields:
                yield name, field, placed
        if not len(self._solids):
            return
        for link, joint, body, solids in self._moving:
            yield link, solids, body.put(posture.frames[joint])

    def _beside_own_links(self, posture: _Posture) -> Iterator[tuple[str, Field, Placed]]:
        """Yield what keeps its distance from links of the crane, as `_placed_near_own`."""
        for own in self._own_links:
            relative = posture.frames[own.joint].inverse() * posture.load
            for name in own.bodies:
                yield name, own.field, self._load_and_hook[name].put(relative)
        for link, joint, body, ground in self._moving_over_ground:
            yield link, ground, body.put(posture.frames[joint])

    def _touching(self, posture: _Posture) -> Iterator[tuple[str, Field, Placed]]:
        """Yield what must not touch, and of which no distance is required, with what it must not
        touch: the rope and links above it, the hook and the link that it hangs on, that link and
        what stands.
        """
        for own in self._own_links:
            relative = posture.frames[own.joint].inverse() * posture.load
            for name in own.touching:
                body = self._not_inflated[name]
                if name == "rope":
                    body.stretch(posture.cable)
                yield name, own.field, body.put(relative)
        if not len(self._standing_field):
            return
        for body in self._last_link:
            frame = posture.frames[self.chain.carriers[1]]
            yield "last link", self._standing_field, body.put(frame)


def _body_of_shape(shape: DrawnShape, inflated: float) -> Body:
    """Return a shape of a link in the frame of its joint, inflated by a distance [m]."""
    within = coal.Transform3s(shape.rotation, shape.translation)
    return Body(shape.geometry, inflated, within)
