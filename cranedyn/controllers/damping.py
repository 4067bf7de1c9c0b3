"""Damping of the swing by drives that yield to the load."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from cranedyn.checks import ShortRepr, number
from cranedyn.clocks import soon_enough
from cranedyn.dynamics.scalars import array, clipped, square_root, where
from cranedyn.interfaces import Reference, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.references.limits import Limits


class _TowerDrives(NamedTuple):
    """Where joints and drives of a tower crane stand.

    Attributes:
        swing_joints: Indices of x, φ, θ and l among the coordinates.
        slew: One for the slew, zero for the other drives, shape (m,).
        trolley: One for the trolley, zero for the other drives, shape (m,).
    """

    swing_joints: list[int]
    slew: np.ndarray
    trolley: np.ndarray


@dataclass(frozen=True, eq=False, repr=False)
class DampingController(ShortRepr):
    """Drives that yield to the swing, see `with_damping`.

    Attributes:
        crane, reference, ratio, recovery, control_period: Arguments of `with_damping`.
        rates: Largest of the drives [rad/s or m/s], shape (m,).
        accelerations: Largest of the drives [rad/s² or m/s²], shape (m,).
    """

    crane: Crane
    reference: Reference
    ratio: float
    recovery: float
    rates: np.ndarray
    accelerations: np.ndarray
    control_period: float

    def begin_run(self, t: float, control_period: float) -> None:
        """See `cranedyn.clocks.Clocked`."""
        soon_enough(self.control_period, control_period)

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return accelerations of the drives [rad/s² or m/s²], shape (m,)."""
        rates = self.reference(t + self.control_period).velocity
        return self.command(rates, setpoint.position, *state).astype(float)

    def command(
        self, wanted: np.ndarray, position: np.ndarray, q: np.ndarray, v: np.ndarray
    ) -> np.ndarray:
        """Return what a call returns, in any kind of number.

        Args:
            wanted: Rates of the reference one control period later, shape (m,).
            position: Positions of the reference now, shape (m,).
            q: Coordinates, shape (n,).
            v: Their rates, shape (n,).
        """
        rates = self.velocity(wanted, position, q)
        accelerations = (rates - v[self.crane.layout.drives]) * (1.0 / self.control_period)
        pairs = zip(accelerations, self.accelerations.tolist(), strict=True)
        return array([clipped(a, -limit, limit) for a, limit in pairs])

    def velocity(self, wanted: np.ndarray, position: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Return the rates of the drives to reach within a control period [rad/s or m/s], shape
        (m,), in any kind of number; see `command`.
        """
        layout = self._layout
        x, phi, theta, length = q[layout.swing_joints]
        # The pivot yields by 2 ζ ω l φ = 2 ζ √(g l) φ: the trolley along the jib, and across it the
        # slew by the θ part over the radius x. On the slew axis slewing does not move the pivot.
        is_off_axis = x * x > 0.0
        theta_over_radius = where(is_off_axis, theta / where(is_off_axis, x, 1.0), 0.0)
        speed = 2.0 * self.ratio * square_root(self.crane.gravity * length)
        rates = wanted + self.recovery * (position - q[self.crane.layout.drives])
        rates = rates - (layout.slew * (theta_over_radius * speed) + layout.trolley * (phi * speed))
        pairs = zip(rates, self.rates.tolist(), strict=True)
        return array([clipped(rate, -limit, limit) for rate, limit in pairs])

    @cached_property
    def _layout(self) -> _TowerDrives:
        """Where joints and drives of the tower crane stand."""
        layout = self.crane.layout
        _, *swing_joints = layout.tower("Drives that yield to the swing")
        return _TowerDrives(
            swing_joints=swing_joints,
            slew=array(layout.along("gamma").tolist()),
            trolley=array(layout.along("x").tolist()),
        )


def with_damping(
    crane: Crane,
    reference: Reference,
    *,
    ratio: float = 0.2,
    recovery: float = 0.0,
    limits: Limits,
    control_period: float = 5e-3,
) -> DampingController:
    """Return a controller that commands the reference's velocity less what damps the swing, for
    `simulate(..., drive="motion")`.

    With a pivot that moves at its commanded velocity less 2 ζ ω l φ the small swing obeys φ̈ + 2 ζ
    ω φ̇ + ω² φ = ẍ/l, ω² = g/l. The position drifts by the integral of the correction, unless it is
    taken back. On the slew axis, at radius 0, slewing does not move the pivot, so the slew does not
    yield there.

    Args:
        crane: The crane.
        reference: Its velocity is the command, looked up one control period ahead.
        ratio: ζ, the share of critical damping that the swing gets.
        recovery: Share of the distance from the reference's position that is corrected per second
            [1/s].
        limits: Limits of the drives; the command is kept within.
        control_period: Time between control instants [s], the same as in `simulate`; a run with a
            longer one is refused.

    Raises:
        MissingRole: If it is not a tower crane.
        OutOfRange: If the ratio is not between 0 and 1, or the recovery negative.
    """
    zeta = number("damping ratio", ratio, "", "0 to 1")
    pull = number("recovery", recovery, "1/s", ">= 0")
    number("control_period", control_period, "s", "> 0")
    crane.layout.tower("Drives that yield to the swing")
    drive_limits = limits.for_crane(crane)
    rates = np.array(drive_limits.rates)
    accelerations = np.array(drive_limits.accelerations)
    return DampingController(crane, reference, zeta, pull, rates, accelerations, control_period)
