"""The same path of a payload on a longer cable."""

from __future__ import annotations

import numpy as np
import scipy

from cranedyn.arguments import checked
from cranedyn.errors import number
from cranedyn.model.crane import Crane
from cranedyn.references.motion import Motion


@checked
def longer(crane: Crane, motion: Motion, by: float) -> Motion:
    """A motion of a tower crane whose payload goes the same way lower down, on a cable that is
    longer by so much.

    The rope points along p̈ + g ẑ (see `cranedyn.references.flat`), of which a constant drop of the
    payload changes nothing: swing stays what it is in the world, and the pivot goes further out
    along the rope. A load that hangs plumb all the way is just lower. What rotational inertia makes
    of another length, the share I/(m l²) of it, is left out.

    Args:
        crane: A tower crane.
        motion: The motion.
        by: By how much the payload hangs lower at rest [m].

    Raises:
        MissingRole: If it is not a tower crane.
        OutOfRange: If `by` is not finite, or makes the cable shorter than nothing.
    """
    slew, trolley, radial, tangential, hoist = crane.layout.tower("A motion on another cable")
    shortest = float(motion.q[:, hoist].min()) + number("by", by, "m")
    number("length of the shortest cable", shortest, "m", "> 0")
    gamma, x, phi, theta, _ = motion.q[:, [slew, trolley, radial, tangential, hoist]].T
    along = np.stack([np.sin(gamma), -np.cos(gamma)], axis=1)
    across = np.stack([np.cos(gamma), np.sin(gamma)], axis=1)
    out, side, up = np.sin(phi) * np.cos(theta), np.sin(theta), np.cos(phi) * np.cos(theta)
    rope = out[:, None] * along + side[:, None] * across
    pivot = x[:, None] * along + (by / up)[:, None] * rope
    turned = np.arctan2((pivot * across).sum(axis=1), (pivot * along).sum(axis=1))
    cosine, sine = np.cos(turned), np.sin(turned)
    further = np.zeros_like(motion.q)
    further[:, slew] = turned
    further[:, trolley] = np.hypot(*pivot.T) - x
    further[:, radial] = np.arctan2(out * cosine + side * sine, up) - phi
    further[:, tangential] = np.arcsin(side * cosine - out * sine) - theta
    further[:, hoist] = by / up
    if len(further) < 4:
        return Motion(motion.period, motion.q + further, motion.v, motion.a, motion.drives)
    rows = motion.period * np.arange(len(further))
    curve = scipy.interpolate.make_interp_spline(rows, further, k=3)
    rates, accelerations = curve.derivative(1)(rows), curve.derivative(2)(rows)
    moving, speeding = (part.any(axis=1)[:, None] for part in (motion.v, motion.a))
    return Motion(
        motion.period,
        motion.q + further,
        motion.v + rates * moving,
        motion.a + accelerations * speeding,
        motion.drives,
    )
