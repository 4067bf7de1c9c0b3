"""Obstacles as constraints of an optimal control problem: half spaces at each point of a plan.

Between a body and an obstacle lies a plane across their shortest distance. An obstacle that is
convex is beyond it as a whole, so that every place on this side is free. The best plan between the
planes about a free plan is not worse than that, and planes about it are made again. Such a plan is
free at its points; between them `cranedyn.planning.proof` must prove it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cranedyn.planning.clearance import Clearance
from cranedyn.planning.proof import CLOSE
from cranedyn.planning.solids import rotation_z
from cranedyn.planning.transcription import ca

_MOST, _FAR = 6, 8.0
"""Most half spaces at a point, and distance from which on an obstacle has none [m]."""

_NUMBERS = 8


@dataclass(frozen=True, eq=False)
class HalfSpaces:
    """Half spaces at the points of a plan.

    A half space is eight numbers: the direction n away from the obstacle, a point b of the body in
    the frame of its carrier, 1 if that hangs and 0 if it is the trolley, and an offset.

    Attributes:
        clearance: Crane and site.
        values: These numbers, shape (8 k, points) for k half spaces at each.
        margin: Distance to keep beyond what a proof needs [m].
    """

    clearance: Clearance
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
        joints, below = self.clearance.joints, self.clearance.bodies.below
        gamma, x, length = q[joints.slew], q[joints.trolley], q[joints.hoist]
        n, b, hangs, offset = ca.vertsplit(
            ca.reshape(self.symbols, _NUMBERS, -1), [0, 3, 6, 7, _NUMBERS]
        )
        c, s = ca.cos(gamma), ca.sin(gamma)
        across = c * b[0, :] - s * b[1, :] + x * s
        along = s * b[0, :] + c * b[1, :] - x * c
        up = b[2, :] - hangs * length
        envelope = 2.0 * (length + below) * math.sin(self.clearance.site.swing / 2.0)
        distance = n[0, :] * across + n[1, :] * along + n[2, :] * up - offset
        return (distance - envelope - CLOSE - self.margin).T


def half_spaces(clearance: Clearance, drive_positions: np.ndarray, margin: float) -> HalfSpaces:
    """Return the half spaces about the points of a plan, at places of shape (points, 3), with a
    margin beyond what a proof needs [m].
    """
    nearest = [
        sorted(_at(clearance, drive_position), key=lambda pair: pair[0])[:_MOST]
        for drive_position in drive_positions
    ]
    count = max(1, *map(len, nearest))
    values = np.tile([*np.zeros(_NUMBERS - 1), -1e3], (len(drive_positions), count, 1))
    for k, pairs in enumerate(nearest):
        for i, (_, numbers) in enumerate(pairs):
            values[k, i] = numbers
    return HalfSpaces(clearance, values.reshape(len(drive_positions), -1).T, margin)


def _at(clearance: Clearance, drive_position: np.ndarray) -> list[tuple[float, np.ndarray]]:
    """Return margins [m], each with the numbers of a half space, at a place."""
    gamma, x, length = drive_position.tolist()
    rotation = rotation_z(gamma)
    carriers = {hangs: rotation @ [0.0, -x, -hangs * length] for hangs in (0.0, 1.0)}
    pairs = []
    for touch in clearance.touches(clearance.q(drive_position), _FAR):
        # A rope ends at both carriers.
        hangs = float(touch.normal[2] >= 0.0 if touch.body == "rope" else touch.body != "trolley")
        point = touch.on_body
        if touch.body == "rope":
            end = carriers[hangs] + [0.0, 0.0, clearance.height]
            point = end - clearance.bodies.falls * touch.normal
        offset = float(touch.normal @ touch.on_obstacle) + touch.required
        b = rotation.T @ (point - carriers[hangs])
        pairs.append((touch.margin, np.array([*touch.normal, *b, hangs, offset])))
    return pairs
