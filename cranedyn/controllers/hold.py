"""The hold controller: proportional-derivative control of each drive about its reference, with the
load's weight fed forward.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

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

_CONTROL_PERIOD = 5e-3
"""Control period [s] within which the damping must not stop what a drive moves."""

FREQUENCY = 5.0
"""Natural frequency [rad/s] of a drive in none of these roles with its inertia, held with critical
damping; ours."""


Gains = Sequence[float] | Mapping[str, float] | None
"""Gains of all drives, or of some by their symbols; None for the usual ones."""


class _DriveGains(NamedTuple):
    """Gains of one drive as plain numbers.

    Attributes:
        drive: Index among the drives.
        joint: Index among the coordinates.
        feed_forward: Effort added always [N m or N].
        stiffness: k_p [N m/rad or N/m].
        damping: k_d [N m s/rad or N s/m].
    """

    drive: int
    joint: int
    feed_forward: float
    stiffness: float
    damping: float


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
        """Check the gains, and keep them as plain numbers too, which are quicker than arrays of so
        few.
        """
        for name in ("stiffness", "damping", "feed_forward"):
            gains = as_array(name, getattr(self, name), (self.crane.layout.m,))
            object.__setattr__(self, name, gains)
        of_drives = []
        for drive, joint in enumerate(self.crane.layout.drives.tolist()):
            of_drives.append(
                _DriveGains(
                    drive=drive,
                    joint=joint,
                    feed_forward=float(self.feed_forward[drive]),
                    stiffness=float(self.stiffness[drive]),
                    damping=float(self.damping[drive]),
                )
            )
        object.__setattr__(self, "_of_drives", tuple(of_drives))

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return efforts [N m or N], shape (m,)."""
        # A loop over plain numbers is quicker than a comprehension or NumPy of so few.
        q = state.q.tolist()
        v = state.v.tolist()
        target = setpoint.position.tolist()
        of_drives = self._of_drives  # type: ignore[attr-defined]
        if len(target) != len(of_drives):
            as_array("position of the setpoint", setpoint.position, (len(of_drives),))
        efforts = np.empty(len(of_drives))
        for drive, joint, feed_forward, k_p, k_d in of_drives:
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
        if DAMPING.get(joint.role, math.inf) * _CONTROL_PERIOD <= inertia:
            usual_stiffness.append(STIFFNESS[joint.role])
            usual_damping.append(DAMPING[joint.role])
        else:
            # Critical damping at the given frequency.
            usual_stiffness.append(FREQUENCY**2 * inertia)
            usual_damping.append(2.0 * FREQUENCY * inertia)
    weights = [_weight(crane, joint, gravity) for joint in crane.layout.drives.tolist()]
    return Hold(
        crane,
        stiffness=_gains(crane, "stiffness", stiffness, usual_stiffness),
        damping=_gains(crane, "damping", damping, usual_damping),
        feed_forward=np.array(weights),
    )


def _gains(crane: Crane, name: str, gains: Gains, usual: list[float]) -> np.ndarray:
    """Return gains of all drives, shape (m,).

    Args:
        crane: The crane.
        name: Name of the gains for an error.
        gains: What is given of them.
        usual: The usual gains, for drives of which none is given.
    """
    if gains is None:
        return crane.layout.for_drives(name, usual)
    if isinstance(gains, Mapping):
        merged = list(usual)
        for symbol, value in gains.items():
            merged[crane.layout.drive(symbol)] = value
        return crane.layout.for_drives(name, merged)
    return crane.layout.for_drives(name, gains)


def _weight(crane: Crane, joint: int, gravity: float) -> float:
    """Return the effort that holds the weight on a drive where the crane starts [N m or N].

    Args:
        crane: The crane.
        joint: Index of the drive among the coordinates.
        gravity: Gravity that is assumed [m/s²].
    """
    model = crane.model
    kind = crane.layout.joints[joint].kind
    up = crane.layout.joints[joint].axis[2]
    # Without joints that follow others two cases need no dynamics, and have no round-off: a drive
    # that slides carries all that is beyond it, along its axis; one that turns about the vertical
    # carries nothing.
    if crane.coupling is None:
        if kind == "prismatic":
            return up * gravity * sum(model.inertias[i].mass for i in model.subtrees[joint + 1])
        if abs(up) == 1.0:
            return 0.0
    weights = pin.computeGeneralizedGravity(model, crane.data, crane.start.q)
    if crane.coupling is not None:
        # A drive carries the weight on the joints that follow it, too.
        weights = crane.coupling.gather(weights)
    return float(weights[joint]) * gravity / crane.gravity


def zero_command(crane: Crane) -> Hold:
    """Return a controller that commands zero to every drive.

    Drives in prescribed motion then keep their speed, drives with efforts exert none, and drives
    with frequency converters brake to a standstill.
    """
    zeros = np.zeros(crane.layout.m)
    return Hold(crane, stiffness=zeros, damping=zeros, feed_forward=zeros)
