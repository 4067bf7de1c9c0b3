"""Controllers that exporters of code offer by name, about the start of a crane."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cranedyn.clocks import whole_periods
from cranedyn.compiled.horizon.receding import receding
from cranedyn.controllers.affine import Affine, at_rest_shifted
from cranedyn.controllers.damping import with_damping
from cranedyn.controllers.hold import hold_controller
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.controllers.lqr import lqr
from cranedyn.controllers.paper import HOIST
from cranedyn.controllers.tracking import Tracking
from cranedyn.dynamics.converters import converters
from cranedyn.estimation.observer import with_observer
from cranedyn.export.browser_crane import swing_period, usual_limits
from cranedyn.interfaces import Drive, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.references import hold
from cranedyn.references.motion import Motion
from cranedyn.references.shaped import shaped, zv

YIELDING_RECOVERY = 0.2
"""Share of the distance from the setpoint that drives which yield correct in a second [1/s]."""

PREDICTIVE_STAGES = 20
"""Stages of the horizon of predictive control."""

PREDICTIVE_STAGE = 0.6
"""Length of a stage of predictive control [s], rounded to whole control periods."""


@dataclass(frozen=True, eq=False, repr=False)
class SetpointRegulator(Tracking):
    """A tracking controller of one row whose drives are held at the setpoint of the loop.

    Attributes:
        crane: The crane.
    """

    crane: Crane

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return efforts [N m or N], shape (m,)."""
        return super().__call__(t, state, setpoint) + self.gain[0] @ self._shift(setpoint.position)

    def affine(self, times: np.ndarray, positions: np.ndarray) -> Affine:
        """Return the affine form, see `cranedyn.controllers.affine`."""
        shifts = np.array([self._shift(position) for position in positions])
        return replace(super().affine(times, positions), setpoint=self.setpoint + shifts)

    def _shift(self, position: np.ndarray) -> np.ndarray:
        """Return by how much a setpoint of the drives moves the setpoint of the state, shape
        (2 n,).
        """
        drives = self.crane.layout.drives
        distances = position - self.setpoint[0, drives]
        return at_rest_shifted(self.crane, distances[None])[0]


def _at_rest(crane: Crane, period: float) -> Motion:
    """Return the motion of a crane that stands at its start, of one row."""
    no_motion = np.zeros((1, crane.layout.n))
    q = crane.resting(crane.start.q)[None]
    return Motion(period, q, no_motion, no_motion, crane.layout.drives)


def _hold(crane: Crane, period: float) -> Any:
    """Return a controller of each drive by itself."""
    return hold_controller(crane)


def _lqr(crane: Crane, period: float) -> SetpointRegulator:
    """Return an LQR about the start."""
    tracking = lqr(crane, _at_rest(crane, period))
    return SetpointRegulator(
        tracking.period, tracking.feed_forward, tracking.gain, tracking.setpoint, crane
    )


def _integral(crane: Crane, period: float) -> HoistIntegral:
    """Return the LQR with an integral of the hoist, whose gain is that of the paper."""
    _, integral_gain, _ = HOIST
    limit = float(crane.effort_limit @ crane.layout.along("l"))
    return HoistIntegral(crane, _lqr(crane, period), integral_gain, limit)


def _observer(crane: Crane, period: float) -> Any:
    """Return the LQR behind an observer of the swing."""
    return with_observer(_lqr(crane, period), crane, _at_rest(crane, period))


def _yielding(crane: Crane, period: float) -> Any:
    """Return drives that yield to the swing."""
    limits = usual_limits(converters(crane))
    return with_damping(
        crane, hold(crane), recovery=YIELDING_RECOVERY, limits=limits, control_period=period
    )


def _shaper(crane: Crane, period: float) -> Any:
    """Return input shaping of the setpoints for the swing at the start."""
    return shaped(hold(crane), zv(), swing_period(crane, crane.start.q))


def _predictive(crane: Crane, period: float) -> Any:
    """Return predictive control with few and long stages."""
    limits = usual_limits(converters(crane))
    stage = whole_periods(PREDICTIVE_STAGE, period)
    return receding(crane, limits, control_period=period, stages=PREDICTIVE_STAGES, stage=stage)


CONTROLLERS: dict[str, tuple[Drive, Callable[[Crane, float], Any]]] = {
    "hold": ("effort", _hold),
    "lqr": ("effort", _lqr),
    "integral": ("effort", _integral),
    "observer": ("effort", _observer),
    "yielding": ("motion", _yielding),
    "shaper": ("effort", _shaper),
    "predictive": ("effort", _predictive),
}
"""Drives, and the controller of a crane for a control period [s], by name: each drive by itself, an
LQR, the same with an integral of the hoist, the same behind an observer of the swing, drives that
yield to the swing, input shaping of the setpoint, and predictive control, in C alone."""
