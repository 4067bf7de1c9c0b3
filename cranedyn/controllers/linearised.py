"""The crane linearised along a motion: what controllers that know the model share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cranedyn.checks import whole
from cranedyn.clocks import multiple
from cranedyn.dynamics.linearisation import over_period
from cranedyn.dynamics.pinocchio import linearise
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.references.motion import Motion, motion_efforts


class Linearised(NamedTuple):
    """Feed-forward at every row of a motion, and a linear model for each stretch of it.

    Attributes:
        period: Time between rows of the motion [s].
        efforts: Of the drives by inverse dynamics [N m or N], shape (rows, m).
        setpoint: Coordinates and rates, shape (rows, 2 n).
        stretch: Which model is meant for each row, shape (rows,); the last row has one of its own,
            which stands for all that follows.
        a: Deviations after one control period by those before, shape (stretches, 2 n, 2 n).
        b: The same by the efforts held beyond the feed-forward, shape (stretches, 2 n, m).
    """

    period: float
    efforts: np.ndarray
    setpoint: np.ndarray
    stretch: np.ndarray
    a: np.ndarray
    b: np.ndarray

    def row(self, t: float) -> int:
        """Return the row at a time [s]; the first before the beginning, the last after the end."""
        return min(max(round(t / self.period), 0), len(self.efforts) - 1)


def linearised(
    crane: Crane, motion: Motion, *, dt: float, every: int, control_period: float | None = None
) -> Linearised:
    """Linearise a crane along a motion.

    Args:
        crane: The crane.
        motion: What to linearise about.
        dt: Physics step of the simulation [s].
        every: Rows from one linearisation to the next.
        control_period: Time over which efforts are held [s]; by default the motion's period.

    Raises:
        OutOfRange: If the control period is not a multiple of `dt`, or `every` is not at least 1.
    """
    motion.check_fits("motion", crane.layout)
    hold_time = motion.period if control_period is None else control_period
    steps = multiple("control period", hold_time, "dt", dt)
    every = min(whole("rows between linearisations", every, 1), len(motion.q))
    efforts = motion_efforts(crane, motion)
    last = len(motion.q) - 1
    rows = [*range(0, last, every), last]
    at_rows = [linearise(crane, State(motion.q[k], motion.v[k]), efforts[k]) for k in rows]
    by_state, by_effort = map(np.array, zip(*at_rows, strict=True))
    a, b = over_period(by_state, by_effort, dt, steps)
    stretch = np.arange(last + 1) // every
    stretch[-1] = len(rows) - 1
    setpoint = np.hstack([motion.q, motion.v])
    return Linearised(motion.period, efforts, setpoint, stretch, a, b)
