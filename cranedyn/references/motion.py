"""The motion of all five joints over time, not of the drives alone: what tracking controllers linearise about."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cranedyn.arguments import checked, finite
from cranedyn.clocks import intervals
from cranedyn.crane import DRIVES
from cranedyn.errors import OutOfRange, number
from cranedyn.references.wanted import Reference, Wanted, tabulated


@checked
@dataclass(frozen=True, eq=False)
class Motion:
    """A wanted motion at the control instants; before and after it stands still. Itself a reference for the drives.

    Attributes:
        period: Time between rows [s].
        q: Coordinates γ, x, φ, θ, l [rad or m], shape (n, 5).
        v: Their rates, shape (n, 5).
        a: Their accelerations, shape (n, 5).
    """

    period: float
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray

    def __post_init__(self) -> None:
        """Check the period, and that there are five finite numbers of each kind in every row."""
        number("period", self.period, "s", "> 0")
        for name in ("q", "v", "a"):
            finite(f"{name} of a motion", getattr(self, name), (len(self.q) if self.q.ndim else "n", 5))
        if not len(self.q):
            raise OutOfRange("motion", "one of no row", "one row or more")

    @property
    def arrival(self) -> float:
        """When it ends [s]."""
        return self.period * (len(self.q) - 1)

    def __call__(self, t: float) -> Wanted:
        """What is wanted of the drives at a time [s]."""
        k = min(max(round(t / self.period), 0), len(self.q) - 1)
        return Wanted(self.q[k, DRIVES], self.v[k, DRIVES], self.a[k, DRIVES])

    def at(self, times: np.ndarray) -> Wanted:
        """What is wanted at many times [s], shape (n, 3) each."""
        rows = np.clip(np.round(times / self.period).astype(int), 0, len(self.q) - 1)
        return Wanted(*(part[rows][:, DRIVES] for part in (self.q, self.v, self.a)))


@checked
def plumb(reference: Reference, duration: float, period: float = 5e-3) -> Motion:
    """The motion of a reference [s] with the load hanging plumb under the trolley all the way, sampled at a period [s].

    Raises:
        OutOfRange: If a time is not positive, or there would be more than 4 million rows.
    """
    intervals("duration", duration, period)
    times = period * np.arange(round(duration / period) + 1)
    parts = np.zeros((3, len(times), 5))
    parts[:, :, DRIVES] = tabulated(reference, times)
    return Motion(period, *parts)
