"""Step one drive aside and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cranedyn.checks import number
from cranedyn.interfaces import Reference, Setpoint
from cranedyn.model.crane import Crane
from cranedyn.references.tabulated import as_setpoint, tabulated


@dataclass(frozen=True, eq=False)
class Pulse:
    """A reference and a rectangular pulse.

    Attributes:
        base: The reference otherwise.
        step: How far the drives are aside [rad or m], shape (m,).
        first, last: When the pulse starts and ends [s].
    """

    base: Reference
    step: np.ndarray
    first: float
    last: float

    def __call__(self, t: float) -> Setpoint:
        """Return the setpoint at a time [s]."""
        setpoint = as_setpoint(self.base(t), self.step.shape)
        return (
            setpoint._replace(position=setpoint.position + self.step)
            if self.first <= t < self.last
            else setpoint
        )

    def at(self, times: np.ndarray) -> Setpoint:
        """Return setpoints at many times [s], shape (n, m) each."""
        setpoint = tabulated(self.base, times, len(self.step))
        aside = (self.first <= times) & (times < self.last)
        return setpoint._replace(position=setpoint.position + np.outer(aside, self.step))


def pulse(
    crane: Crane, base: Reference, drive: str, amplitude: float, *, at: float, width: float
) -> Reference:
    """Add a rectangular pulse to one drive of a reference.

    A pivot that follows it and comes back after half a swing period leaves a swing of 2 amplitude /
    cable length (small angles).

    Args:
        crane: The crane.
        base: The reference otherwise.
        drive: Symbol of its coordinate, such as "x".
        amplitude: How far aside [rad or m].
        at: When it starts [s].
        width: How long it lasts [s].

    Raises:
        UnknownName: For another drive.
        OutOfRange: For a number that is not finite, or a width that is not positive.
    """
    step = number("pulse amplitude", amplitude) * crane.layout.along(drive)
    return Pulse(
        base, step, number("pulse start", at, "s"), at + number("pulse width", width, "s", "> 0")
    )
