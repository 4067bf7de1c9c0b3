"""Obstacles as constraints of an optimal control problem: half spaces at each point of a plan.

Between a body and an obstacle lies a plane across their shortest distance. An obstacle that is
convex is beyond it as a whole, so that every place on this side is free. The planes are made about
a free plan, so that the best plan between them is not worse than that; planes about the best plan
may allow a better one. A plan between planes is free at its points; between these
`cranedyn.lifts.planning.motion_proof` must prove it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from cranedyn.lifts.planning.motion_proof import PROOF_MARGIN
from cranedyn.lifts.planning.solids import rotation_z
from cranedyn.lifts.planning.tower_clearance import TowerClearance
from cranedyn.lifts.planning.transcription import ca

_MAX_HALF_SPACES = 6
"""Largest number of half spaces at a point of a plan; the obstacles with the least margins count.
"""

_MAX_MARGIN = 8.0
"""Margin from which on an obstacle has no half space [m]. A point of a plan seldom moves as far as
that while the plan is improved; if one does, the proof of the motion finds it."""

_NO_OBSTACLE = -1e3
"""Offset of a half space of which every place is inside, where a point has fewer obstacles than
another [m]: with no direction its distance is minus the offset, 1 km."""

_HANGS = 1.0
"""Value of `_HalfSpace.hangs` of a point that hangs on the cable, which is lowered by this value
times the cable length."""

_ROLLS = 0.0
"""Value of `_HalfSpace.hangs` of a point that moves with the trolley."""


class _HalfSpace(NamedTuple):
    """A half space, of which one side is free of an obstacle.

    Attributes:
        margin: Distance of the body beyond the required one at the place it was made at [m].
        normal: Unit vector n away from the obstacle, in the frame of the crane, shape (3,).
        point: Point b of the body in the frame of its carrier, which slews with the jib [m], shape
            (3,).
        hangs: `_HANGS` if the carrier is the end of the cable, `_ROLLS` if it is the trolley.
        offset: Distance of the plane, moved by the required distance, from the origin along the
            normal [m].
    """

    margin: float
    normal: np.ndarray
    point: np.ndarray
    hangs: float
    offset: float

    def numbers(self) -> np.ndarray:
        """Return all but the margin in the order of `HalfSpaces.values`, shape (8,)."""
        return np.array([*self.normal, *self.point, self.hangs, self.offset])


_NUMBERS = 8
"""How many numbers describe a half space, see `_HalfSpace.numbers`."""


@dataclass(frozen=True, eq=False)
class HalfSpaces:
    """Half spaces at the points of a plan.

    A half space is eight numbers: the direction n away from the obstacle, a point b of the body in
    the frame of its carrier, 1 if that hangs and 0 if it is the trolley, and an offset; see
    `_HalfSpace`.

    Attributes:
        clearance: Crane and site.
        values: These numbers, shape (8 k, points) for k half spaces at each.
        margin: Distance to keep beyond what a proof needs [m].
    """

    clearance: TowerClearance
    values: np.ndarray
    margin: float

    @cached_property
    def symbols(self) -> ca.SX:
        """Symbols for the numbers at a point."""
        return ca.SX.sym("half_spaces", len(self.values))

    def margins(self, q: ca.SX) -> ca.SX:
        """Return the distances inside all half spaces with the envelope of the site's swing [m],
        shape (k,), at coordinates of all joints.
        """
        joints = self.clearance.joints
        gamma = q[joints.slew]
        x = q[joints.trolley]
        length = q[joints.hoist]
        n, b, hangs, offset = ca.vertsplit(
            ca.reshape(self.symbols, _NUMBERS, -1), [0, 3, 6, 7, _NUMBERS]
        )

        # The carrier is at (x sin γ, -x cos γ) and has turned with the jib: the jib points along
        # -Y at γ = 0. Where the point hangs, the cable lowers it.
        c = ca.cos(gamma)
        s = ca.sin(gamma)
        point_x = c * b[0, :] - s * b[1, :] + x * s
        point_y = s * b[0, :] + c * b[1, :] - x * c
        point_z = b[2, :] - hangs * length
        distance = n[0, :] * point_x + n[1, :] * point_y + n[2, :] * point_z - offset

        # `Clearance.envelope` of symbols.
        below = self.clearance.bodies.below
        envelope = (length + below) * self.clearance.swing_chord
        return (distance - envelope - PROOF_MARGIN - self.margin).T


def half_spaces(
    clearance: TowerClearance, drive_positions: np.ndarray, margin: float
) -> HalfSpaces:
    """Return the half spaces about the points of a plan, at places of shape (points, 3), with a
    margin beyond what a proof needs [m].
    """
    nearest = []
    for drive_position in drive_positions:
        found = sorted(_at(clearance, drive_position), key=lambda half_space: half_space.margin)
        nearest.append(found[:_MAX_HALF_SPACES])
    point_count = len(drive_positions)
    count = max(1, *map(len, nearest))
    unused = [*np.zeros(_NUMBERS - 1), _NO_OBSTACLE]
    values = np.tile(unused, (point_count, count, 1))
    for k, at_point in enumerate(nearest):
        for i, half_space in enumerate(at_point):
            values[k, i] = half_space.numbers()
    return HalfSpaces(clearance, values.reshape(point_count, -1).T, margin)


def _at(clearance: TowerClearance, drive_position: np.ndarray) -> list[_HalfSpace]:
    """Return the half spaces of all obstacles near a place, shape (3,)."""
    gamma, x, length = drive_position.tolist()
    rotation = rotation_z(gamma)
    # Origins of the carriers' frames. Their heights count from the pivot, those of all points from
    # the foot; the points in the frames of the carriers contain the difference, here and in
    # `HalfSpaces.margins`.
    carriers = {
        _ROLLS: rotation @ [0.0, -x, 0.0],
        _HANGS: rotation @ [0.0, -x, -length],
    }
    found = []
    for touch in clearance.nearest_points(clearance.q(drive_position), _MAX_MARGIN):
        if touch.body == "rope":
            # A rope ends at both carriers. The end that is nearer to the plane keeps all of it on
            # its side: the lower one where the normal points up.
            hangs = _HANGS if touch.normal[2] >= 0.0 else _ROLLS
            end = carriers[hangs] + [0.0, 0.0, clearance.height]
            point = end - clearance.bodies.falls * touch.normal
        else:
            hangs = _ROLLS if touch.body == "trolley" else _HANGS
            point = touch.on_body
        offset = float(touch.normal @ touch.on_obstacle) + touch.required
        in_carrier = rotation.T @ (point - carriers[hangs])
        found.append(_HalfSpace(touch.margin, touch.normal, in_carrier, hangs, offset))
    return found
