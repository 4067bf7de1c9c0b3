"""Geometry and statics of the rigging: which share of a load a leg of the slings carries, how far
it leans, how high the rigging is, and how the load hangs in it.

The derivations are in docs/concepts/lifting.md, "Slings". All points are in the axes of the load,
from the centre of the box around it, X across the jib, Y along it and Z up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cranedyn.lifts.planning.plan_details import LoadDetails, PlanDetails, Slings

CARRYING_LEGS = 2
"""Number of legs that are counted on where there are more. A rigid load on three or four legs hangs
on two of them where one leg is a little too long. Guides for slingers count so; read second hand.
"""

SET_FACTORS = {1: 1.0, 2: 1.4, 3: 2.1, 4: 2.1}
"""Working load limit on the tag of a set, up to `SET_ANGLE`, over that of one of its legs, by the
number of legs: EN 818-4 for chains, EN 13414-1 for wire ropes, EN 1492 for textile slings; read
second hand."""

STEEP_SET_FACTORS = {1: 1.0, 2: 1.0, 3: 1.5, 4: 1.5}
"""The same from `SET_ANGLE` to 60° from the vertical."""

SET_ANGLE = math.radians(45.0)
"""Angle of a leg from the vertical up to which the larger limit on the tag of a set counts
[rad]."""

ON_LINE = 1e-3
"""Distance up to which a centre of gravity is on the line of two lifting points [m]: a millimetre,
which nobody measures on a load."""


def counted_legs(number: int) -> int:
    """Return how many of a number of legs are counted on to carry."""
    return min(number, CARRYING_LEGS)


def largest_share(
    points: Sequence[Sequence[float]], centre: Sequence[float] = (0.0, 0.0, 0.0)
) -> float | None:
    """Return the largest share of the weight that any one lifting point may have to carry, with the
    hook above the centre of gravity; None if that lies outside of the polygon of the points in
    plan, where no forces that pull upwards hold it.

    The shares w_i are not negative, add up to one, and have the centre of gravity as their mean:
    Σ w_i p_i = c. Two points, or three that form a triangle, leave one solution. Of four or more
    points, the legs that are a little longer stay slack, and nobody knows which. So the largest
    w_i of all solutions counts, which is that of a linear program.

    Args:
        points: Lifting points [m], shape (n, 3).
        centre: Centre of gravity [m], shape (3,).
    """
    from scipy.optimize import linprog  # slow, and only loads with lifting points need it

    in_plan = np.asarray(points, dtype=float)[:, :2]
    offsets = in_plan - np.asarray(centre, dtype=float)[:2]
    count = len(offsets)
    # Of points on one line only the lever arms along it hold a load, and the centre of gravity must
    # be on the line.
    middle = offsets.mean(axis=0)
    spans = np.linalg.svd(offsets - middle)
    on_one_line = count < 3 or spans.S[1] <= ON_LINE
    if on_one_line:
        along, across = spans.Vh
        if abs(float(middle @ across)) > ON_LINE:
            return None
        offsets = (offsets @ along)[:, None]
        if count == 1:
            return 1.0 if abs(float(offsets[0, 0])) <= ON_LINE else None
    balance = np.vstack([np.ones(count), offsets.T])
    wanted = np.zeros(len(balance))
    wanted[0] = 1.0
    shares = []
    for i in range(count):
        cost = np.zeros(count)
        cost[i] = -1.0
        solution = linprog(cost, A_eq=balance, b_eq=wanted, bounds=(0.0, 1.0))
        if not solution.success:
            return None
        shares.append(-float(solution.fun))
    return max(shares)


def leg_share(load: LoadDetails, number: int) -> float | None:
    """Return the share of the weight that the most loaded leg is counted with: that of
    `largest_share`, and no less than an equal part for each of `counted_legs`; None if the centre
    of gravity is outside of the lifting points.

    Args:
        load: Its lifting points and centre of gravity, where they are entered; without lifting
            points equal parts count. One leg is counted on to hold a point, however many do.
        number: Number of legs.
    """
    equal = 1.0 / counted_legs(number)
    if not load.lifting_points:
        return equal
    share = largest_share(load.lifting_points, load.centre or (0.0, 0.0, 0.0))
    return None if share is None else max(share, equal)


def leg_limit(slings: Slings) -> float | None:
    """Return the working load limit of one leg in a straight pull [kg]: as entered, or that of a
    set over `SET_FACTORS`; None if it does not follow from what is entered.
    """
    if slings.limit is not None:
        return slings.limit
    if slings.set_limit is None or slings.number not in SET_FACTORS:
        return None
    return slings.set_limit / SET_FACTORS[slings.number]


def set_limit_at(slings: Slings, angle: float) -> float | None:
    """Return the working load limit of a set whose legs lean by an angle from the vertical [rad],
    as its tag has it [kg]; None if that of one leg was entered, or the number of legs was not.
    """
    if slings.set_limit is None or slings.number not in SET_FACTORS:
        return None
    if angle <= SET_ANGLE:
        return slings.set_limit
    return slings.set_limit * STEEP_SET_FACTORS[slings.number] / SET_FACTORS[slings.number]


def sling_angle(details: PlanDetails) -> float | None:
    """Return the largest angle of a leg from the vertical [rad]: as entered, or that of legs of the
    entered length from the hook, above the centre of gravity, to the lifting points; 0 for a single
    leg. None if it does not follow from what is entered.
    """
    slings = details.slings
    if slings.angle is not None:
        return slings.angle
    if slings.number == 1:
        return 0.0
    # Below a spreader the upper ends of the slings are not in one point.
    if slings.length is None or details.spreader is not None:
        return None
    farthest = _farthest_point(details.load)
    if farthest is None or not farthest < slings.length:
        return None
    return math.asin(farthest / slings.length)


def _farthest_point(load: LoadDetails) -> float | None:
    """Return the largest distance in plan of a lifting point from the centre of gravity [m]; None
    if there are no lifting points.
    """
    if not load.lifting_points:
        return None
    centre = np.array(load.centre or (0.0, 0.0, 0.0))
    offsets = np.array(load.lifting_points) - centre
    return float(np.linalg.norm(offsets[:, :2], axis=1).max())


def sling_height(details: PlanDetails) -> float | None:
    """Return the height from the upper eye of the slings to the lifting points [m]; None if it does
    not follow from what is entered.

    With the length L of a leg and its angle β from the vertical it is L cos β; without a length,
    and without a spreader, r / tan β by the lifting point that is farthest from the centre of
    gravity in plan, at the distance r, whose leg leans most.
    """
    angle = sling_angle(details)
    if angle is None:
        return None
    length = details.slings.length
    if length is not None:
        return length * math.cos(angle)
    farthest = _farthest_point(details.load)
    if farthest is not None and angle > 0.0 and details.spreader is None:
        return farthest / math.tan(angle)
    return None


def rigging_height(details: PlanDetails) -> float | None:
    """Return the height from the lifting points of the load to the saddle of the hook [m]: of the
    slings and of the spreader; None if it does not follow from what is entered.
    """
    height = sling_height(details)
    if height is None or details.spreader is None:
        return height
    if details.spreader.height is None:
        return None
    return height + details.spreader.height


def attachment_height(details: PlanDetails, corners: np.ndarray) -> float:
    """Return the height of the lifting points above the centre of the box around the load [m]: the
    highest of them, or the top of the box where none are entered.

    Args:
        details: The details of the plan.
        corners: Corners of the load [m], shape (n, 3).
    """
    if details.load.lifting_points:
        return max(z for _, _, z in details.load.lifting_points)
    return float(np.ptp(corners[:, 2])) / 2.0


def tilt(details: PlanDetails) -> float | None:
    """Return the angle by which the load hangs out of level [rad] if all legs are of one length, so
    that the hook is as far from each lifting point; None if it does not follow from what is
    entered.

    The hook is then at a fixed place of the load, at the height h above the middle m of the circle
    through the lifting points, and the load turns until its centre of gravity c is plumb below it:
    tan of the angle is |c - m| in plan over the height of the hook above c.
    """
    load = details.load
    slings = details.slings
    if details.spreader is not None or len(load.lifting_points) < 2 or load.centre is None:
        return None
    points = np.array(load.lifting_points)
    in_plan = points[:, :2] - points[:, :2].mean(axis=0)
    # |p - m|² = R² for all points is linear in m and in k = R² - |m|²: 2 p·m + k = |p|². The least
    # solution puts m between two points, or in the middle of points on a line.
    equations = np.column_stack([2.0 * in_plan, np.ones(len(in_plan))])
    solution = np.linalg.lstsq(equations, (in_plan**2).sum(axis=1), rcond=None)[0]
    middle = solution[:2]
    radius = float(np.linalg.norm(in_plan - middle, axis=1).mean())
    if slings.length is not None and slings.length > radius:
        hook = math.sqrt(slings.length**2 - radius**2)
    elif slings.angle is not None and slings.angle > 0.0:
        hook = radius / math.tan(slings.angle)
    else:
        return None
    centre = np.array(load.centre)
    aside = float(np.linalg.norm(centre[:2] - points[:, :2].mean(axis=0) - middle))
    above_centre = float(points[:, 2].mean()) + hook - float(centre[2])
    return math.atan2(aside, above_centre)
