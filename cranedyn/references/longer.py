"""The same path of a payload on a longer cable."""

from __future__ import annotations

import numpy as np

from cranedyn.checks import number
from cranedyn.model.crane import Crane
from cranedyn.references.motion import Motion

_ASIDE = 0.02
"""How far before and after a row derivatives are taken from [s]: truncation and rounding are alike
there for swings that take seconds."""


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
    motion.check_fits("motion", crane.layout)
    shortest = float(motion.q[:, hoist].min()) + number("by", by, "m")
    number("length of the shortest cable", shortest, "m", "> 0")
    parts = [slew, trolley, radial, tangential, hoist]

    def beyond(q: np.ndarray) -> np.ndarray:
        found = np.zeros_like(q)
        found[:, parts] = _beyond(q[:, parts], by)
        return found

    # along q + s v + s² a/2 to both sides of each row, which needs no neighbours and ends at rest
    here, behind, ahead = (
        beyond(motion.q + s * motion.v + s**2 / 2.0 * motion.a) for s in (0.0, -_ASIDE, _ASIDE)
    )
    return Motion(
        motion.period,
        motion.q + here,
        motion.v + (ahead - behind) / (2.0 * _ASIDE),
        motion.a + (ahead - 2.0 * here + behind) / _ASIDE**2,
        motion.drives,
    )


def _beyond(q: np.ndarray, by: float) -> np.ndarray:
    """What γ, x, φ, θ, l [rad or m], shape (rows, 5), change by."""
    gamma, x, phi, theta, _ = q.T
    along = np.stack([np.sin(gamma), -np.cos(gamma)], axis=1)
    across = np.stack([np.cos(gamma), np.sin(gamma)], axis=1)
    out, side, up = np.sin(phi) * np.cos(theta), np.sin(theta), np.cos(phi) * np.cos(theta)
    rope = out[:, None] * along + side[:, None] * across
    pivot = x[:, None] * along + (by / up)[:, None] * rope
    turned = np.arctan2((pivot * across).sum(axis=1), (pivot * along).sum(axis=1))
    cosine, sine = np.cos(turned), np.sin(turned)
    return np.stack(
        [
            turned,
            np.hypot(*pivot.T) - x,
            np.arctan2(out * cosine + side * sine, up) - phi,
            np.arcsin(side * cosine - out * sine) - theta,
            by / up,
        ],
        axis=1,
    )
