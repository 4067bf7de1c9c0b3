"""The hold controller: proportional-derivative control of each drive about its reference, with the
load's weight fed forward.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from cranedyn.checks import ShortRepr, as_array, number
from cranedyn.controllers.affine import Affine, at_drives, without_integral
from cranedyn.dynamics.linearisation import feedback_gain
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.crane import Crane

STIFFNESS = {"slew": 5.0e5, "trolley": 3.0e5, "hoist": 3.0e4}
"""k_p of slew [N m/rad], trolley [N/m], hoist [N/m]. Only the trolley's is published."""

DAMPING = {"slew": 1.0e6, "trolley": 5.0e4, "hoist": 2.0e4}
"""k_d of slew [N m s/rad], trolley [N s/m], hoist [N s/m]; none is published.

Those of trolley and hoist are identified from the published columns of experiment A1 (``python -m
experiments.a1 --identify``), those of the slew are one of several pairs that meet the published
amplitude of experiment A3.
"""

_PERIOD = 5e-3
"""Control period [s] within which the damping must not stop what a drive moves."""

FREQUENCY = 5.0
"""Natural frequency [rad/s] of a drive in none of these roles with its inertia, held with critical
damping; ours."""


Gains = Sequence[float] | Mapping[str, float] | None
"""Gains of all drives, or of some by their symbols; None for the usual ones."""


@dataclass(frozen=True, eq=False, repr=False)
class Hold(ShortRepr):
    """Effort = feed-forward + k_p (setpoint - position) - k_d velocity, for each drive by itself.

    The velocity of the reference does not enter: on a ramp the drive lags by k_d / k_p times the
    rate.

    Attributes:
        crane: The crane that it is for.
        stiffness: k_p of the drives [N m/rad or N/m], shape (m,).
        damping: k_d of the drives [N m s/rad or N s/m], shape (m,).
        feed_forward: Effort added always [N m or N], shape (m,).
    """

    crane: Crane
    stiffness: np.ndarray
    damping: np.ndarray
    feed_forward: np.ndarray

    def __post_init__(self) -> None:
        """Check the gains and have them as plain numbers, which are quicker than NumPy's for a few
        drives by themselves.
        """
        for name in ("stiffness", "damping", "feed_forward"):
            gains = as_array(name, getattr(self, name), (self.crane.layout.m,))
            object.__setattr__(self, name, gains)
        plain = zip(
            range(self.crane.layout.m),
            self.crane.layout.drives.tolist(),
            self.feed_forward.tolist(),
            self.stiffness.tolist(),
            self.damping.tolist(),
            strict=True,
        )
        object.__setattr__(self, "_plain", tuple(plain))

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return efforts [N m or N], shape (m,)."""
        # A loop over plain numbers is quicker than a comprehension or NumPy of so few.
        q = state.q.tolist()
        v = state.v.tolist()
        target = setpoint.position.tolist()
        plain = self._plain  # type: ignore[attr-defined]
        if len(target) != len(plain):
            as_array("position of the setpoint", setpoint.position, (len(plain),))
        efforts = np.empty(len(plain))
        for drive, joint, feed_forward, k_p, k_d in plain:
            efforts[drive] = feed_forward + k_p * (target[drive] - q[joint]) - k_d * v[joint]
        return efforts

    def affine(self, times: np.ndarray, positions: np.ndarray) -> Affine:
        """Return the affine form, see `cranedyn.controllers.affine`."""
        gain = feedback_gain(self.crane, self.stiffness, self.damping)
        return without_integral(
            self.feed_forward[None],
            gain[None],
            at_drives(self.crane, positions, np.zeros_like(positions)),
        )


def hold_controller(
    crane: Crane,
    *,
    stiffness: Gains = None,
    damping: Gains = None,
    gravity: float | None = None,
) -> Hold:
    """Return a hold controller for a crane, with the weight of the load fed forward for a gravity
    [m/s²].

    Args:
        crane: The crane.
        stiffness: k_p of the drives, shape (m,), or of some by their symbols, for example ``{"x":
            3e5}``. The default is `STIFFNESS` by their roles; a drive without a role, or of a crane
            too light for these gains, has what makes it as fast as `FREQUENCY`.
        damping: k_d of the drives likewise, by default `DAMPING` or critical damping.
        gravity: Gravity assumed by the feed-forward [m/s²]; it may differ from that of the crane,
            which None takes.

    Raises:
        OutOfRange: If there is not one finite gain for each drive.
        UnknownName: If there is no drive of a symbol.
    """
    gravity = crane.gravity if gravity is None else number("gravity", gravity, "m/s²")
    inertias = np.diag(crane.mass_matrix(crane.start.q))[crane.layout.drives].tolist()
    usual_stiffness = []
    usual_damping = []
    for joint, inertia in zip(crane.layout.driven, inertias, strict=True):
        # A damping whose effort is held for a period stops an inertia within it where k_d times the
        # period reaches the inertia. A drive without a role has no usual gains.
        if DAMPING.get(joint.role, math.inf) * _PERIOD <= inertia:
            usual_stiffness.append(STIFFNESS[joint.role])
            usual_damping.append(DAMPING[joint.role])
        else:
            # Critical damping at the given frequency.
            usual_stiffness.append(FREQUENCY**2 * inertia)
            usual_damping.append(2.0 * FREQUENCY * inertia)
    return Hold(
        crane,
        _gains(crane, "stiffness", stiffness, usual_stiffness),
        _gains(crane, "damping", damping, usual_damping),
        np.array([_weight(crane, joint, gravity) for joint in crane.layout.drives.tolist()]),
    )


def _gains(crane: Crane, name: str, gains: Gains, usual: list[float]) -> np.ndarray:
    """Return gains of all drives, the usual ones by default."""
    if isinstance(gains, Mapping):
        for symbol, value in gains.items():
            usual[crane.layout.drive(symbol)] = value
        gains = None
    return crane.layout.for_drives(name, usual if gains is None else gains)


def _weight(crane: Crane, joint: int, gravity: float) -> float:
    """Return the effort that holds the weight on a drive [N m or N]."""
    model = crane.model
    kind = crane.layout.joints[joint].kind
    up = crane.layout.joints[joint].axis[2]
    if kind == "prismatic" and crane.coupling is None:
        return up * gravity * sum(model.inertias[i].mass for i in model.subtrees[joint + 1])
    if abs(up) == 1.0:
        return 0.0
    weights = pin.computeGeneralizedGravity(model, crane.data, crane.start.q)
    weight = (weights if crane.coupling is None else crane.coupling.gather(weights))[joint]
    return float(weight) * gravity / crane.gravity


def zero_command(crane: Crane) -> Hold:
    """Return a controller that commands zero to every drive.

    Drives in prescribed motion then keep their speed, drives with efforts exert none, and drives
    with frequency converters brake to a standstill.
    """
    zeros = np.zeros(crane.layout.m)
    return Hold(crane, stiffness=zeros, damping=zeros, feed_forward=zeros)
