"""The brake: proportional-derivative control of each drive about its reference, with the load's weight fed forward."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from cranedyn.arguments import checked
from cranedyn.arrays import finite, shaped
from cranedyn.controllers.affine import Affine, at_drives, without_integral
from cranedyn.dynamics.linearisation import feedback_gain
from cranedyn.errors import number
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.crane import STANDARD_GRAVITY, Crane

STIFFNESS = (5.0e5, 3.0e5, 3.0e4)
"""k_p of slew [N m/rad], trolley [N/m], hoist [N/m]. Only the trolley's is published."""

DAMPING = (1.0e6, 5.0e4, 2.0e4)
"""k_d of slew [N m s/rad], trolley [N s/m], hoist [N s/m]; none is published.

Those of trolley and hoist are identified from the published columns of experiment A1 (``python -m experiments.a1 --identify``), those of
the slew are one of several pairs that meet the published amplitude of experiment A3.
"""


@checked
@dataclass(frozen=True, eq=False)
class Hold:
    """Effort = feed-forward + k_p (setpoint - position) - k_d velocity, for each drive by itself.

    The velocity of the reference does not enter: on a ramp the drive lags by k_d / k_p times the rate.

    Attributes:
        stiffness: k_p of slew [N m/rad], trolley [N/m], hoist [N/m], shape (3,).
        damping: k_d of slew [N m s/rad], trolley [N s/m], hoist [N s/m], shape (3,).
        feed_forward: Effort added always [N m, N, N], shape (3,).
    """

    stiffness: np.ndarray
    damping: np.ndarray
    feed_forward: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        """Check the gains and have them as plain numbers, which are quicker than NumPy's for three drives by themselves."""
        for name in ("stiffness", "damping", "feed_forward"):
            shaped(name, getattr(self, name), (3,))
        object.__setattr__(self, "_plain", tuple(part.tolist() for part in (self.feed_forward, self.stiffness, self.damping)))

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Efforts [N m, N, N], shape (3,)."""
        (a, b, c), (k_a, k_b, k_c), (d_a, d_b, d_c) = self._plain  # type: ignore[attr-defined]
        (slew, trolley, hoist), (gamma, x, _, _, length) = setpoint.position.tolist(), state.q.tolist()
        slewing, trolleying, _, _, hoisting = state.v.tolist()
        return np.array(
            [
                a + k_a * (slew - gamma) - d_a * slewing,
                b + k_b * (trolley - x) - d_b * trolleying,
                c + k_c * (hoist - length) - d_c * hoisting,
            ]
        )

    def affine(self, times: np.ndarray, positions: np.ndarray) -> Affine:
        """The common form, see `cranedyn.controllers.affine`."""
        gain = feedback_gain(self.stiffness, self.damping)
        return without_integral(self.feed_forward[None], gain[None], at_drives(positions, np.zeros_like(positions)))


@checked
def hold_controller(
    crane: Crane, *, stiffness: Sequence[float] = STIFFNESS, damping: Sequence[float] = DAMPING, gravity: float = STANDARD_GRAVITY
) -> Hold:
    """The hold controller for a crane, which knows the payload's mass and believes in a gravity [m/s²] of its own.

    Raises:
        OutOfRange: If a gain or gravity is not finite, or there are not three of a gain.
    """
    number("gravity", gravity, "m/s²")
    return Hold(finite("stiffness", stiffness, (3,)), finite("damping", damping, (3,)), np.array([0.0, 0.0, -crane.payload_mass * gravity]))
