"""Step one drive aside and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cranedyn.arguments import checked
from cranedyn.errors import number
from cranedyn.interfaces import Reference, Wanted
from cranedyn.references.tabulated import along, tabulated


@dataclass(frozen=True, eq=False)
class Pulse:
    """A reference and a rectangular pulse.

    Attributes:
        base: What is wanted otherwise.
        step: How far slew, trolley and hoist are aside [rad, m, m], shape (3,).
        first, last: When the pulse starts and ends [s].
    """

    base: Reference
    step: np.ndarray
    first: float
    last: float

    def __call__(self, t: float) -> Wanted:
        """What is wanted at a time [s]."""
        wanted = self.base(t)
        return wanted._replace(position=wanted.position + self.step) if self.first <= t < self.last else wanted

    def at(self, times: np.ndarray) -> Wanted:
        """What is wanted at many times [s], shape (n, 3) each."""
        wanted = tabulated(self.base, times)
        aside = (self.first <= times) & (times < self.last)
        return wanted._replace(position=wanted.position + np.outer(aside, self.step))


@checked
def pulse(base: Reference, drive: str, amplitude: float, *, at: float, width: float) -> Reference:
    """Add a rectangular pulse to one drive of a reference.

    A pivot that follows it and comes back after half a swing period leaves a swing of 2 amplitude / cable length (small angles).

    Args:
        base: What is wanted otherwise.
        drive: "gamma", "x" or "l".
        amplitude: How far aside [rad or m].
        at: When it starts [s].
        width: How long it lasts [s].

    Raises:
        UnknownName: For another drive.
        OutOfRange: For a number that is not finite, or a width that is not positive.
    """
    step = number("pulse amplitude", amplitude) * along(drive)
    return Pulse(base, step, number("pulse start", at, "s"), at + number("pulse width", width, "s", "> 0"))
