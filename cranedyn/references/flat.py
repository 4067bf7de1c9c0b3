"""Plan the payload, not the drives: a path of the payload tells where pivot, cable and swing must
be.

The payload of a crane is a flat output (Fliess, Lévine, Martin, Rouchon 1995): the rope points
along p̈ + g ẑ.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy

from cranedyn.checks import finite, number, within
from cranedyn.clocks import intervals
from cranedyn.dynamics.equations_of_motion import pivot_position
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.references.motion import Motion

_REST_SAMPLES = 6
"""Samples before the start and behind the end of a move, at rest, so that the spline through the
samples has no end where its derivatives are needed."""

_MIN_SPACING = 5e-3
"""Least time between samples that derivatives are taken from [s]."""

_SMOOTHSTEP = np.poly1d([70.0, -315.0, 540.0, -420.0, 126.0] + [0.0] * 5)
"""The polynomial of `smoothstep`."""


def smoothstep(s: np.ndarray, order: int = 0) -> np.ndarray:
    """Return 126 s⁵ - 420 s⁶ + 540 s⁷ - 315 s⁸ + 70 s⁹, or its derivative of an order of 4 at most.

    It goes from 0 at s = 0 to 1 at s = 1, stays there outside, and has four derivatives that are
    zero at both ends.
    """
    s = np.clip(s, 0.0, 1.0)
    # The second half is the first one turned over: near s = 1 the terms would cancel.
    half = _SMOOTHSTEP.deriv(order)(np.minimum(s, 1.0 - s))
    return np.where(s <= 0.5, half, (order == 0) - (-1.0) ** order * half)


def cruise(t: np.ndarray, duration: float, ramp: float, order: int = 0) -> np.ndarray:
    """Return a path from 0 at t = 0 to 1 at the duration [s] at constant speed, or its derivative
    of an order [1/s per order]; the speed is reached and lost within a ramp [s] that is a
    smoothstep.
    """

    def distance(s: np.ndarray) -> np.ndarray:
        """Return the distance of a motion whose speed grows from 0 to 1 over s from 0 to 1, or its
        derivative of the order by time.
        """
        if order:
            return smoothstep(s, order - 1) / ramp**order
        return _SMOOTHSTEP.integ()(np.clip(s, 0.0, 1.0)) + np.maximum(s - 1.0, 0.0)

    # One motion speeds up at the beginning, and another one, subtracted, from a ramp before the
    # end. Both together go duration / ramp - 1.
    accelerating = distance(t / ramp)
    braking = distance((t - duration) / ramp + 1.0)
    return ramp / (duration - ramp) * (accelerating - braking)


def flat(
    crane: Crane,
    start: State,
    goal: State,
    duration: float,
    *,
    ramp: float | None = None,
    period: float = 5e-3,
) -> Motion:
    """Carry the payload from one rest to another along a smooth path, in cylindrical coordinates
    about the slew axis.

    A payload with rotational inertia I swings as a point at its centre of oscillation, I/(m l)
    below it; the path is that of this point. This is exact for a point load, and for any load that
    one drive moves in the plane of the jib on a cable of constant length, if its inertia is the
    same about both swing axes. A load that has inertia and is slewed turns with the jib, which the
    path knows nothing of: the default load is left with 0.006 mrad of 22 mrad by the slew of the
    experiments (0.6 rad in 20 s on 15 m of cable). Hoisting is right to first order.

    Args:
        crane: The crane.
        start: Where it hangs at rest.
        goal: Where it shall hang at rest.
        duration: Time for the move [s]; the last row is the first at or after it.
        ramp: Time in which the payload gains, and loses, its full speed [s]; at most half of the
            duration. None for one smooth sweep.
        period: Time between rows [s].

    Raises:
        MissingRole: If it is not a tower crane.
        OutOfRange: If the duration is not positive or takes more than 4 million rows, the ramp is
            too long, or the path would slacken the rope.
    """
    slew, trolley, *_, hoist = crane.layout.tower("A path planned for the payload (flat)")
    start = crane.layout.as_state("start", start)
    goal = crane.layout.as_state("goal", goal)
    last = intervals("duration", duration, period)
    if ramp is not None:
        within("ramp", ramp, period, duration / 2.0, "s")
    for end, state in (("start", start), ("goal", goal)):
        number(f"l at the {end}", state.q[hoist], "m", "> 0")

    # The ends of the path of the centre of oscillation, in γ, r and z.
    inertia = (crane.payload_inertia[0, 0] + sum(crane.dummy_inertia) / 2.0) / crane.payload_mass
    pivot_height = float(pivot_position(crane, start.q)[2])
    q_ends = np.array([start.q, goal.q])
    length = q_ends[:, hoist]
    ends = np.column_stack(
        [q_ends[:, slew], q_ends[:, trolley], pivot_height - length - inertia / length]
    )

    # The path is sampled more coarsely than the rows if these are very close.
    stride = max(1, math.ceil(_MIN_SPACING / period - 1e-9))
    samples = math.ceil(duration / (period * stride) - 1e-9) + 1
    t = period * stride * np.arange(-_REST_SAMPLES, samples + _REST_SAMPLES)
    path = _payload_path(ends, t, duration, ramp, crane.gravity)
    if path.rope[:, 2].min() <= 0.0:
        allowed = "longer: the payload would fall faster than gravity and slacken the rope"
        raise OutOfRange("duration", duration, allowed, "s")
    with np.errstate(over="ignore"):
        pull = np.linalg.norm(path.rope, axis=1)
    finite("acceleration of the payload", pull, (len(path.rope),))
    q = recover(path.position, path.rope / pull[:, None], pivot_height, inertia)

    curve = scipy.interpolate.make_interp_spline(t, q, k=7)
    rows = period * np.arange(last + 1)
    position = curve.derivative(0)(rows)
    v = curve.derivative(1)(rows)
    a = curve.derivative(2)(rows)
    # Samples are what they are, without the round-off of the spline, and the ends are at rest.
    position[::stride] = q[_REST_SAMPLES:][: len(rows[::stride])]
    v[[0, -1], :] = 0.0
    a[[0, -1]] = 0.0
    return Motion(period, position, v, a, crane.layout.drives)


class _PayloadPath(NamedTuple):
    """Path of the centre of oscillation of a payload.

    Attributes:
        position: Positions in the world [m], shape (samples, 3).
        rope: Vectors along the rope, from the payload to the pivot: p̈ + g ẑ [m/s²], shape
            (samples, 3).
    """

    position: np.ndarray
    rope: np.ndarray


def _payload_path(
    ends: np.ndarray, t: np.ndarray, duration: float, ramp: float | None, gravity: float
) -> _PayloadPath:
    """Return the path from one rest to another, straight in cylindrical coordinates.

    Args:
        ends: Both ends in γ [rad], r [m] and z [m], shape (2, 3).
        t: Times [s], shape (samples,).
        duration: Time for the move [s].
        ramp: See `flat`.
        gravity: Gravity [m/s²].

    Raises:
        OutOfRange: If a position is not finite.
    """

    def path_share(order: int) -> np.ndarray:
        """Return the share of the path that has passed, or its derivative by time."""
        if ramp is None:
            return smoothstep(t / duration, order) / duration**order
        return cruise(t, duration, ramp, order)

    share = path_share(0)
    share_rate = path_share(1)
    share_acceleration = path_share(2)
    displacement = ends[1] - ends[0]
    gamma, radius, z = (ends[0] + displacement * share[:, None]).T
    outward = _outward(gamma)
    tangent = _tangent(gamma)
    up = np.array([0.0, 0.0, 1.0])
    position = radius[:, None] * outward + z[:, None] * up
    finite("path of the payload", position, position.shape, unit="m")

    # The acceleration in cylindrical coordinates is r̈ - r γ̇² outward and r γ̈ + 2 ṙ γ̇ along the
    # tangent. Second differences of the path would magnify rounding to 1e-4 m/s² in the
    # acceleration of the drives.
    turn, travel, rise = displacement
    outward_acceleration = travel * share_acceleration - radius * (turn * share_rate) ** 2
    tangent_acceleration = radius * turn * share_acceleration + 2.0 * travel * turn * share_rate**2
    vertical = rise * share_acceleration + gravity
    rope = (
        outward_acceleration[:, None] * outward
        + tangent_acceleration[:, None] * tangent
        + vertical[:, None] * up
    )
    return _PayloadPath(position, rope)


def _outward(gamma: np.ndarray) -> np.ndarray:
    """Return the directions of the jib at slew angles [rad], shape (rows,): shape (rows, 3)."""
    return np.stack([np.sin(gamma), -np.cos(gamma), np.zeros_like(gamma)], axis=1)


def _tangent(gamma: np.ndarray) -> np.ndarray:
    """Return the directions in which the jib turns at slew angles [rad]: shape (rows, 3)."""
    return np.stack([np.cos(gamma), np.sin(gamma), np.zeros_like(gamma)], axis=1)


def recover(path: np.ndarray, rope: np.ndarray, height: float, inertia: float = 0.0) -> np.ndarray:
    """Return the coordinates of the crane from a path of its payload.

    Args:
        path: Centre of oscillation of the payload in the world [m], shape (n, 3).
        rope: Unit vectors along the rope from payload to pivot, shape (n, 3).
        height: Height of the pivot [m].
        inertia: Rotational inertia over mass [m²].

    Returns:
        γ, x, φ, θ, l [rad or m], shape (n, 5).
    """
    reach = (height - path[:, 2]) / rope[:, 2]
    pivot = path + rope * reach[:, None]
    gamma = np.unwrap(np.arctan2(pivot[:, 0], -pivot[:, 1]))
    theta = np.arcsin((rope * _tangent(gamma)).sum(axis=1))
    phi = np.arctan2((rope * _outward(gamma)).sum(axis=1), rope[:, 2])
    # The centre of oscillation lies at reach = l + inertia / l below the pivot.
    length = (reach + np.sqrt(reach**2 - 4.0 * inertia)) / 2.0
    return np.stack([gamma, np.hypot(pivot[:, 0], pivot[:, 1]), phi, theta, length], axis=1)
