"""What a lift sweeps in plan: the load with its swing, what a falling part may reach, and what jib
and load pass over. Derivations are in docs/concepts/lifting.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely

from cranedyn.lifts.judging.drawings.outlines import CraneShapes, crane_shapes, hull_of
from cranedyn.lifts.planning.clearance import Clearance
from cranedyn.lifts.planning.lift import Lift
from cranedyn.lifts.planning.timing import STEP

_SAMPLES = 80
"""Number of places along a motion from which areas are made. Between two of them the hull of both
footprints stands for all between."""


@dataclass(frozen=True, eq=False)
class SweptAreas:
    """Areas in plan, in the frame of the site.

    Attributes:
        envelope: What load and hook may be above, with the swing that the site allows.
        exclusion: The same, and where a part that comes off what hangs first meets the ground.
        farthest_throw: Largest way in plan of such a part [m].
        passed: What jib and load pass over, or come nearer to than is required; None for a crane
            that does not turn.
        bearings: Directions from the slew axis to the load, unwrapped [rad], shape (k,); None for a
            crane that does not turn.
        turned_path: Radius and height of the load's centre in the same places [m], shape (k, 2);
            None for a crane that does not turn.
    """

    envelope: shapely.Geometry
    exclusion: shapely.Geometry
    farthest_throw: float
    passed: shapely.Geometry | None
    bearings: np.ndarray | None
    turned_path: np.ndarray | None


def throw_distance(
    speed: float | np.ndarray,
    upward: float | np.ndarray,
    height: float | np.ndarray,
    gravity: float,
) -> np.ndarray:
    """Return how far a part flies in plan that comes off at a height [m], without drag.

    It leaves with a horizontal speed v and an upward speed w, and meets the ground after
    t = (w + √(w² + 2 g h)) / g. Until then it has gone v t. It may bounce and roll farther, which
    is not in this number.

    Args:
        speed: Horizontal speed at which it leaves [m/s].
        upward: Upward speed at which it leaves [m/s].
        height: Height above the ground [m], 0 or more.
        gravity: Gravity [m/s²].
    """
    falls = (upward + np.sqrt(np.square(upward) + 2.0 * gravity * np.asarray(height))) / gravity
    return np.asarray(speed * falls)


def sampled_rows(lift: Lift) -> np.ndarray:
    """Return the rows of the planned motion from which areas are made."""
    count = len(lift.timed.places)
    return np.unique(np.linspace(0, count - 1, min(_SAMPLES, count)).round().astype(int))


def throw_of_rows(lift: Lift, rows: np.ndarray) -> np.ndarray:
    """Return how far a part of what hangs may fly in plan in rows of a motion [m], shape (k,).

    Its speed is that of the planned motion, that of the load's turn about the rope, and that of the
    largest allowed swing, all in one direction. A load that swings by an amplitude A on a cable l
    has the speed A √(g/l) at most; its own inertia makes it slower. A part comes off at the height
    of the hook's top, above which nothing of what hangs is.
    """
    clearance = lift.clearance
    gravity = clearance.crane.gravity
    places = lift.timed.places
    centres = clearance.site.to_site(clearance.point(places))
    velocity = np.gradient(centres, STEP, axis=0)[rows]
    turn_rate = np.gradient(clearance.load_turn(places), STEP)[rows]
    cable = clearance.cable(clearance.q(places[rows]))
    swing_speed = clearance.envelope(cable) * np.sqrt(gravity / cable)
    speed = np.linalg.norm(velocity[:, :2], axis=1)
    speed = speed + np.abs(turn_rate) * clearance.bodies.spread + swing_speed
    upward = np.maximum(velocity[:, 2], 0.0)
    top = centres[rows, 2] + float(clearance.bodies.hook.top) - clearance.site.ground
    return throw_distance(speed, upward, np.maximum(top, 0.0), gravity)


def swept_areas(lift: Lift) -> SweptAreas:
    """Return the areas that a lift sweeps."""
    clearance = lift.clearance
    rows = sampled_rows(lift)
    shapes = [crane_shapes(clearance, lift.timed.places[row]) for row in rows]
    cable = clearance.cable(clearance.q(lift.timed.places[rows]))
    swings = clearance.envelope(cable)
    throws = throw_of_rows(lift, rows)

    envelope = []
    exclusion = []
    passed = []
    for i in range(len(rows) - 1):
        footprint = hull_of(np.concatenate([_hanging(shapes[i]), _hanging(shapes[i + 1])]))
        swing = float(max(swings[i], swings[i + 1]))
        envelope.append(footprint.buffer(swing))
        exclusion.append(footprint.buffer(swing + float(max(throws[i], throws[i + 1]))))
        under = _under_jib(shapes[i], shapes[i + 1])
        if under is not None:
            passed.append(under.buffer(swing + clearance.site.distance))
    return SweptAreas(
        envelope=shapely.union_all(envelope),
        exclusion=shapely.union_all(exclusion),
        farthest_throw=float(throws.max()),
        passed=shapely.union_all(passed) if passed else None,
        bearings=load_bearings(clearance, shapes),
        turned_path=_turned_path(shapes) if passed else None,
    )


def _turned_path(shapes: list[CraneShapes]) -> np.ndarray:
    """Return radius and height of the load's centre in consecutive places [m], shape (k, 2)."""
    flat = []
    for shape in shapes:
        assert shape.axis is not None
        flat.append([np.linalg.norm((shape.centre - shape.axis)[:2]), shape.centre[2]])
    return np.array(flat)


def load_bearings(clearance: Clearance, shapes: list[CraneShapes]) -> np.ndarray | None:
    """Return the directions from the slew axis to the load in consecutive places, unwrapped [rad],
    from X towards Y of the site; None for a crane that does not turn.
    """
    if clearance.turning is None:
        return None
    angles = []
    for shape in shapes:
        assert shape.axis is not None
        across, along = (shape.centre - shape.axis)[:2]
        angles.append(math.atan2(along, across))
    return np.unwrap(angles)


def _hanging(shape: CraneShapes) -> np.ndarray:
    """Return the corners of load and hook in plan [m], shape (n, 2)."""
    return np.concatenate([shape.load, shape.hook])[:, :2]


def _under_jib(first: CraneShapes, second: CraneShapes) -> shapely.Polygon | None:
    """Return the hull in plan from the slew axis to the ends of jib and load at two places; None
    for a crane that does not turn.
    """
    if first.axis is None or second.axis is None:
        return None
    corners = [_hanging(first), _hanging(second)]
    for shape in (first, second):
        assert shape.axis is not None
        outward = unit_in_plan(shape.centre - shape.axis)
        farthest = max(float(((body - shape.axis)[:, :2] @ outward).max()) for body in shape.moving)
        corners.append(shape.axis[None, :2])
        corners.append((shape.axis[:2] + farthest * outward)[None])
    return hull_of(np.concatenate(corners))


def unit_in_plan(vector: np.ndarray) -> np.ndarray:
    """Return the direction in plan of a vector, shape (2,); that of X if it is vertical."""
    length = float(np.linalg.norm(vector[:2]))
    return np.array([1.0, 0.0]) if length < 1e-9 else vector[:2] / length
