"""The same path of a payload on a longer cable."""

from __future__ import annotations

import numpy as np

from cranedyn.checks import number
from cranedyn.model.crane import Crane
from cranedyn.references.motion import Motion

_ASIDE = 0.02
"""Step of the differences [s], at which truncation and rounding are alike for swings of seconds."""


def with_longer_cable(crane: Crane, motion: Motion, by: float) -> Motion:
    """Return a motion of a tower crane whose payload follows the same path lower down, on a longer
    cable.

    The rope points along p̈ + g ẑ (see `cranedyn.references.flat`), which a constant drop of the
    payload does not change: the swing in the world stays the same, and the pivot moves out along
    the rope. The share I/(m l²) of rotational inertia is neglected.

    Args:
        crane: A tower crane.
        motion: The motion.
        by: Additional length of the cable at rest [m].

    Raises:
        MissingRole: If it is not a tower crane.
        OutOfRange: If `by` is not finite, or makes the cable shorter than nothing.
    """
    slew, trolley, radial, tangential, hoist = crane.layout.tower("A motion on another cable")
    motion.check_fits("motion", crane.layout)
    shortest = float(motion.q[:, hoist].min()) + number("by", by, "m")
    number("length of the shortest cable", shortest, "m", "> 0")
    columns = [slew, trolley, radial, tangential, hoist]

    def beyond(q: np.ndarray) -> np.ndarray:
        changes = np.zeros_like(q)
        changes[:, columns] = _beyond(q[:, columns], by)
        return changes

    # Differences along q + s v + s² a/2 about each row need no neighbouring rows.
    change, change_before, change_after = (
        beyond(motion.q + s * motion.v + s**2 / 2.0 * motion.a) for s in (0.0, -_ASIDE, _ASIDE)
    )
    return Motion(
        motion.period,
        motion.q + change,
        motion.v + (change_after - change_before) / (2.0 * _ASIDE),
        motion.a + (change_after - 2.0 * change + change_before) / _ASIDE**2,
        motion.drives,
    )


def _beyond(q: np.ndarray, by: float) -> np.ndarray:
    """Return the changes of γ, x, φ, θ, l [rad or m], shape (rows, 5)."""
    gamma, x, phi, theta, _ = q.T
    along = np.stack([np.sin(gamma), -np.cos(gamma)], axis=1)
    across = np.stack([np.cos(gamma), np.sin(gamma)], axis=1)
    outward, sideward, up = np.sin(phi) * np.cos(theta), np.sin(theta), np.cos(phi) * np.cos(theta)
    rope = outward[:, None] * along + sideward[:, None] * across
    pivot = x[:, None] * along + (by / up)[:, None] * rope
    turned = np.arctan2((pivot * across).sum(axis=1), (pivot * along).sum(axis=1))
    cosine, sine = np.cos(turned), np.sin(turned)
    return np.stack(
        [
            turned,
            np.hypot(*pivot.T) - x,
            np.arctan2(outward * cosine + sideward * sine, up) - phi,
            np.arcsin(sideward * cosine - outward * sine) - theta,
            by / up,
        ],
        axis=1,
    )
