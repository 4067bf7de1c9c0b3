"""Shares of a load on two plumb ropes, its lean in a steady wind, and its frequencies, in closed
form.
"""

from __future__ import annotations

import math

import numpy as np

from cranedyn.disturbances.wind import AIR_DENSITY
from cranedyn.lifts.tandem.load import TandemLoad
from cranedyn.lifts.tandem.load_wind import DRAG_COEFFICIENT

_FIXED_POINT_STEPS = 50
"""Steps to a lean that no longer changes; each makes the error ten times less and better."""


def static_shares(load: TandemLoad, tilt: float = 0.0) -> np.ndarray:
    """Return the share of the weight that each of two plumb ropes carries, shape (2,).

    The load is tilted about the horizontal axis across the line of its lugs: by a positive angle
    its second lug is higher. With the lugs at a_i along that line from the centre of mass and at
    the heights h_i above it, their horizontal distances become x_i = a_i cos α - h_i sin α. Moments
    about the centre of mass give the shares x_2/(x_2 - x_1) and -x_1/(x_2 - x_1). So of lugs above
    the centre of mass the higher one carries more.

    Args:
        load: The load.
        tilt: The angle α [rad].
    """
    lugs = np.array(load.lugs, dtype=float)
    between = lugs[1, :2] - lugs[0, :2]
    line = between / np.linalg.norm(between)
    along = lugs[:, :2] @ line
    horizontal = along * math.cos(tilt) - lugs[:, 2] * math.sin(tilt)
    first, second = horizontal.tolist()
    return np.array([second, -first]) / (second - first)


def lean_in_wind(
    load: TandemLoad, speed: float, gravity: float, drag: float = DRAG_COEFFICIENT
) -> float:
    """Return the lean of a load and of its ropes in a steady wind across the line of its lugs
    [rad].

    The wind pushes with F = ½ ρ c (A_s cos β + A_t sin β) v², with the areas A_s of the side and
    A_t of the top that it meets, and both ropes lean along F and the weight: tan β = F/(m g). The
    load leans with them, since all forces go through its centre of mass, but for the wind on
    faces that are not plumb above it, which is of second order in β. So the load drifts by
    (L + h) sin β on ropes of the length L, with its lugs at h above the centre of mass.

    Args:
        load: The load; its X axis is along the line of its lugs.
        speed: Speed of the wind [m/s].
        gravity: Gravity [m/s²].
        drag: Drag coefficient c.
    """
    length, width, height = (float(side) for side in load.size)
    pressure = 0.5 * AIR_DENSITY * drag * speed**2
    lean = 0.0
    # A fixed point: the right side changes with the lean by F/(m g), which is far below 1.
    for _ in range(_FIXED_POINT_STEPS):
        area = length * (height * math.cos(lean) + width * math.sin(lean))
        lean = math.atan(pressure * area / (load.mass * gravity))
    return lean


def sway_frequency(length: float, gravity: float) -> float:
    """Return the angular frequency of small swings along the line of two lugs [rad/s].

    Ropes of one length stay parallel, and the load moves without turning: √(g/L), whatever the
    load.

    Args:
        length: Length of the ropes [m].
        gravity: Gravity [m/s²].
    """
    return math.sqrt(gravity / length)


def yaw_frequency(load: TandemLoad, length: float, gravity: float) -> float:
    """Return the angular frequency with which a load turns about the vertical on two parallel ropes
    of one length [rad/s].

    A turn by ψ leans the rope at a_i by a_i ψ/L, and its tension m g s_i pulls back by
    m g s_i a_i² ψ/L with the share s_i of the weight: ω² = m g Σ s_i a_i²/(I L) (bifilar
    suspension), with the inertia I about the vertical. For the shares of the lever rule the sum is
    -a_1 a_2.

    Args:
        load: The load, whose lugs are level with each other.
        length: Length of the ropes [m].
        gravity: Gravity [m/s²].
    """
    lugs = np.array(load.lugs, dtype=float)
    squares = (lugs[:, :2] ** 2).sum(axis=1)
    stiffness = load.mass * gravity * float(static_shares(load) @ squares) / length
    return math.sqrt(stiffness / float(load.moments[2]))
