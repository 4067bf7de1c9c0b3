"""The motion of all five joints over time, not of the drives alone: what tracking controllers linearise about."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cranedyn.arguments import checked, described
from cranedyn.arrays import finite
from cranedyn.errors import OutOfRange, number
from cranedyn.interfaces import Reference, Setpoint
from cranedyn.model.crane import DRIVES
from cranedyn.references.rows import SAME, at_place, at_places, place, places
from cranedyn.references.tabulated import tabulated
from cranedyn.simulation.clocks import intervals


@checked
@dataclass(frozen=True, eq=False)
class Motion:
    """A motion in rows, with straight lines between them; before and after it stands still. Itself a reference for the drives.

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

    @classmethod
    def checked(cls, name: str, value: Any) -> Motion:
        """A motion; of a reference it says how to make one.

        Raises:
            OutOfRange: If it is none.
        """
        if isinstance(value, Motion):
            return value
        raise OutOfRange(name, described(value), "a Motion of all joints, as cranedyn.references.plumb makes it of a reference")

    @property
    def arrival(self) -> float:
        """When it ends [s]."""
        return self.period * (len(self.q) - 1)

    def __call__(self, t: float) -> Setpoint:
        """The setpoint of the drives at a time [s]."""
        row, share = place(t, self.period, len(self.q))
        position, velocity, acceleration = (at_place(part, row, share)[DRIVES] for part in (self.q, self.v, self.a))
        return Setpoint(position, velocity, acceleration) if self._moves(t) else Setpoint(position, np.zeros(3), np.zeros(3))

    def at(self, times: np.ndarray) -> Setpoint:
        """Setpoints at many times [s], shape (n, 3) each."""
        row, share = places(times, self.period, len(self.q))
        position, *derivatives = (at_places(part, row, share)[:, DRIVES] for part in (self.q, self.v, self.a))
        moving = self._moves(times)[:, None]
        return Setpoint(position, *(np.where(moving, part, 0.0) for part in derivatives))

    def _moves(self, t: Any) -> Any:
        """Whether a time, or each of many [s], is neither before the first row nor after the last."""
        return (t >= -SAME * self.period) & (t <= self.arrival + SAME * self.period)


@checked
def plumb(reference: Reference, duration: float, period: float = 5e-3) -> Motion:
    """The motion of a reference over a duration [s], sampled at a period [s], with the load hanging plumb; its last row is at rest.

    Raises:
        OutOfRange: If a time is not positive, or there would be more than 4 million rows.
    """
    intervals("duration", duration, period)
    times = period * np.arange(round(duration / period) + 1)
    parts = np.zeros((3, len(times), 5))
    parts[:, :, DRIVES] = tabulated(reference, times)
    parts[1:, -1] = 0.0
    return Motion(period, *parts)
