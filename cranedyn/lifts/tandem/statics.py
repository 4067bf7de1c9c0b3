"""Shares of a load on two plumb ropes, in closed form."""

from __future__ import annotations

import math

import numpy as np

from cranedyn.lifts.tandem.load import TandemLoad


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
