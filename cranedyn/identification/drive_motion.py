"""Recorded motion of a drive at any time: interpolated from its positions or rates, or from its
setpoints behind a lag.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline, PchipInterpolator
from scipy.signal import lfilter

from cranedyn.identification.checked_record import Record
from cranedyn.interfaces import Setpoint
from cranedyn.model.layout import Joint
from cranedyn.references.tabulated import Tabulating

_MIN_LAG = 1e-4
"""Least time constant of a lag [s], to divide by; a drive is at its setpoint then."""


def recorded_motion(record: Record, joint: Joint, still: float) -> Any:
    """Return the recorded position of a drive as a differentiable function of time: through its
    positions and rates, its positions, or the integral of its rates. Return None where only its
    setpoint was recorded.

    Args:
        record: The record.
        joint: The drive.
        still: Position if none of its columns was recorded.
    """
    position_column, rate_column = joint.columns
    position = record.columns.get(position_column)
    rate = record.columns.get(rate_column)
    if position is not None and rate is not None:
        return CubicHermiteSpline(record.t, position, rate)
    if position is not None:
        return CubicSpline(record.t, position)
    if rate is not None:
        motion = CubicSpline(record.t, rate).antiderivative()
        motion.c[-1] += still  # the constant of each piece
        return motion
    if joint.setpoint_column in record.columns:
        return None
    return CubicSpline(record.t[[0, -1]], [still, still])


def recorded_setpoint(record: Record, joint: Joint) -> Any:
    """Return the setpoint of a drive as a function of time that does not overshoot."""
    return PchipInterpolator(record.t, record.columns[joint.setpoint_column])


def lagged(setpoint: np.ndarray, period: float, lag: float) -> tuple[np.ndarray, np.ndarray]:
    """Return position and rate of a drive that follows its setpoint with a time constant, at rest
    at first: ẏ = (setpoint - y) / lag, exact where the setpoint is piecewise linear.

    Args:
        setpoint: Setpoints at equal intervals, shape (rows,).
        period: Time between rows [s].
        lag: Time constant [s].
    """
    # Over one period h, with r = h / τ, d = exp(-r) and a setpoint that is linear from s0 to s1,
    # the solution is y1 = d y0 + ((1 - d) / r - d) s0 + (1 - (1 - d) / r) s1: a digital filter of
    # first order.
    tau = max(lag, _MIN_LAG)
    ratio = period / tau
    decay = np.exp(-ratio)
    weight_before = (1.0 - decay) / ratio - decay
    weight_now = 1.0 - (1.0 - decay) / ratio
    first = setpoint[0]
    position = first + lfilter([weight_now, weight_before], [1.0, -decay], setpoint - first)
    return position, (setpoint - position) / tau


@dataclass(frozen=True, eq=False)
class SampledMotion(Tabulating):
    """Reference sampled at the control instants of a run.

    Attributes:
        period: Time between rows [s].
        position, velocity: Positions and rates of the drives, shape (rows, m) each.
    """

    period: float
    position: np.ndarray
    velocity: np.ndarray

    def at(self, times: np.ndarray) -> Setpoint:
        """Return setpoints at many times [s], shape (rows, m) each."""
        rows = np.clip(np.rint(times / self.period).astype(int), 0, len(self.position) - 1)
        position = self.position[rows]
        return Setpoint(position, self.velocity[rows], np.zeros_like(position))
