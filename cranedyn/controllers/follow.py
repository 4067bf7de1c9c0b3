"""Accelerations that take motion-controlled drives along a reference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cranedyn.checks import ShortRepr, number
from cranedyn.clocks import soon_enough
from cranedyn.controllers.affine import Affine, at_drives, without_integral
from cranedyn.dynamics.linearisation import feedback_gain
from cranedyn.interfaces import Reference, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.references.tabulated import tabulated


@dataclass(frozen=True, eq=False, repr=False)
class Follow(ShortRepr):
    """Reach the reference's velocity at the next control instant; for `simulate(...,
    drive="motion")`.

    Attributes:
        crane: The crane.
        reference: The reference to follow, looked up one control period ahead.
        control_period: Time between control instants [s], the same as in `simulate`; a run in which
            they are further apart is refused.
    """

    crane: Crane
    reference: Reference
    control_period: float = 5e-3

    def __post_init__(self) -> None:
        """Check the control period."""
        number("control_period", self.control_period, "s", "> 0")

    def begin_run(self, t: float, control_period: float) -> None:
        """See `cranedyn.clocks.Clocked`."""
        soon_enough(self.control_period, control_period)

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return accelerations of the drives [rad/s² or m/s²], shape (m,)."""
        wanted = self.reference(t + self.control_period).velocity
        return (wanted - state.v[self.crane.layout.drives]) / self.control_period

    def affine(self, times: np.ndarray, positions: np.ndarray) -> Affine:
        """Return the affine form, see `cranedyn.controllers.affine`.

        Raises:
            OutOfRange: If the control instants are further apart than the period.
        """
        if len(times) > 1:
            soon_enough(self.control_period, float(times[1] - times[0]))
        drives = self.crane.layout.m
        ahead = tabulated(self.reference, times + self.control_period, drives).velocity
        gain = feedback_gain(
            self.crane, np.zeros(drives), np.full(drives, 1.0 / self.control_period)
        )
        return without_integral(
            np.zeros((1, drives)), gain[None], at_drives(self.crane, np.zeros_like(ahead), ahead)
        )


def follow(crane: Crane, reference: Reference, control_period: float = 5e-3) -> Follow:
    """Take motion-controlled drives along a reference, control instants being a period [s]
    apart.
    """
    return Follow(crane, reference, control_period)
