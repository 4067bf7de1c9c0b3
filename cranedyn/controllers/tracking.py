"""Tracking of a motion by a table of feed-forward, setpoint and gain."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cranedyn.checks import ShortRepr, as_array, number
from cranedyn.controllers.affine import Affine, without_integral
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import Setpoint, State
from cranedyn.references.tabulated import interpolate, interpolate_many, locate, locate_many


@dataclass(frozen=True, eq=False, repr=False)
class Tracking(ShortRepr):
    """effort = feed_forward[k] - gain[k] (z - setpoint[k]) with z = (coordinates, rates); before
    time 0 k is 0, beyond the end the last.

    Between rows, where a loop is finer than they are, all three lie on straight lines.

    Attributes:
        period: Time between rows [s], the control period for which the gains are best.
        feed_forward: Efforts of the drives [N m or N], shape (rows, m).
        gain: Shape (rows, m, 2 n).
        setpoint: The motion to track, shape (rows, 2 n).
    """

    period: float
    feed_forward: np.ndarray
    gain: np.ndarray
    setpoint: np.ndarray

    def __post_init__(self) -> None:
        """Check the period and the shapes of the table."""
        number("period", self.period, "s", "> 0")
        feed_forward = as_array("feed-forward", self.feed_forward, ("rows", "m"))
        gain = as_array("gain", self.gain, (*feed_forward.shape, "2 n"))
        setpoint = as_array("setpoint", self.setpoint, (len(gain), gain.shape[2]))
        for name, table in (("feed_forward", feed_forward), ("gain", gain), ("setpoint", setpoint)):
            object.__setattr__(self, name, table)
        if not len(gain):
            raise OutOfRange("table", "one of no row", "one row or more")

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return efforts [N m or N], shape (m,); the table holds the setpoint already.

        Raises:
            OutOfRange: If a coordinate or rate is not finite.
        """
        k, share = locate(t, self.period, len(self.feed_forward))
        gain = interpolate(self.gain, k, share)
        efforts = interpolate(self.feed_forward, k, share) - gain @ (
            np.concatenate(state) - interpolate(self.setpoint, k, share)
        )
        # A number of the state that is not finite shows in the efforts: only then it is searched.
        if not math.isfinite(sum(efforts.tolist())):
            check_finite(state)
        return efforts

    def affine(self, times: np.ndarray, positions: np.ndarray) -> Affine:
        """Return the affine form, see `cranedyn.controllers.affine`."""
        last = len(self.feed_forward) - 1
        rows, shares = locate_many(times, self.period, last + 1)
        # Behind the last row of the table all is constant: one instant there stands for the rest.
        before_last = np.flatnonzero(rows < last)
        count = min(int(before_last[-1]) + 2 if len(before_last) else 1, len(rows))
        rows = rows[:count]
        shares = shares[:count]
        return without_integral(
            interpolate_many(self.feed_forward, rows, shares),
            interpolate_many(self.gain, rows, shares),
            interpolate_many(self.setpoint, rows, shares),
        )


def check_finite(state: State) -> None:
    """Return if every coordinate and rate is a finite number.

    Raises:
        OutOfRange: If one is not: which.
    """
    for i, (position, rate) in enumerate(zip(*state, strict=True), start=1):
        number(f"coordinate {i} of the state", position)
        number(f"rate {i} of the state", rate)
