"""The motion of a drive as it was recorded, at any time: through its positions, its rates, or its
setpoints behind a lag.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline, PchipInterpolator
from scipy.signal import lfilter

from cranedyn.identification.record import Record
from cranedyn.interfaces import Setpoint
from cranedyn.model.layout import Joint
from cranedyn.references.tabulated import Tabulating

_SHORTEST = 1e-4


def recorded_motion(record: Record, joint: Joint, still: float) -> Any:
    """A function of time through what was recorded of a drive, with a derivative; None where only
    its setpoint was.

    Args:
        record: The record.
        joint: The drive.
        still: Where it stands if nothing is said of it.
    """
    position, rate = (record.columns.get(name) for name in joint.columns)
    if position is not None and rate is not None:
        return CubicHermiteSpline(record.t, position, rate)
    if position is not None:
        return CubicSpline(record.t, position)
    if rate is not None:
        found = CubicSpline(record.t, rate).antiderivative()
        found.c[-1] += still
        return found
    if joint.setpoint_column in record.columns:
        return None
    return CubicSpline(record.t[[0, -1]], [still, still])


def recorded_setpoint(record: Record, joint: Joint) -> Any:
    """A function of time through the setpoints of a drive that nowhere overshoots them."""
    return PchipInterpolator(record.t, record.columns[joint.setpoint_column])


def lagged(setpoint: np.ndarray, period: float, lag: float) -> tuple[np.ndarray, np.ndarray]:
    """Position and rate of a drive that follows its setpoint with a time constant, at rest at
    first: ẏ = (setpoint - y) / lag, exact where the setpoint runs on straight lines.

    Args:
        setpoint: At equal times, shape (rows,).
        period: Time between rows [s].
        lag: The time constant [s].
    """
    tau = max(lag, _SHORTEST)
    share = period / tau
    left = np.exp(-share)
    before, now = (1.0 - left) / share - left, 1.0 - (1.0 - left) / share
    first = setpoint[0]
    position = first + lfilter([now, before], [1.0, -left], setpoint - first)
    return position, (setpoint - position) / tau


@dataclass(frozen=True, eq=False)
class Rows(Tabulating):
    """A reference in rows at the control instants of a run.

    Attributes:
        period: Time between rows [s].
        position, velocity: Of the drives, shape (rows, m) each.
    """

    period: float
    position: np.ndarray
    velocity: np.ndarray

    def at(self, times: np.ndarray) -> Setpoint:
        """Setpoints at many times [s], shape (rows, m) each."""
        rows = np.clip(np.rint(times / self.period).astype(int), 0, len(self.position) - 1)
        position = self.position[rows]
        return Setpoint(position, self.velocity[rows], np.zeros_like(position))
