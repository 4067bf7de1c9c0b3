"""Controllers that exporters of code offer by name, about the start of a crane."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cranedyn.bridges.browser_crane import swing_period, usual_limits
from cranedyn.clocks import whole_periods
from cranedyn.compiled.horizon.receding import receding
from cranedyn.controllers.affine import Affine, at_drives
from cranedyn.controllers.damping import with_damping
from cranedyn.controllers.hold import hold_controller
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.controllers.lqr import lqr
from cranedyn.controllers.paper import HOIST
from cranedyn.controllers.tracking import Tracking
from cranedyn.dynamics.converters import converters
from cranedyn.estimation.observer import with_observer
from cranedyn.interfaces import Drive, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.references import hold
from cranedyn.references.motion import Motion
from cranedyn.references.shaped import shaped, zv


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
        drives = self.crane.layout.drives
        return at_drives(
            self.crane, (position - self.setpoint[0, drives])[None], np.zeros((1, len(drives)))
        )[0]


def _at_rest(crane: Crane, period: float) -> Motion:
    """Return the motion of a crane that stands at its start, of one row."""
    still = np.zeros((1, crane.layout.n))
    return Motion(period, crane.resting(crane.start.q)[None], still, still, crane.layout.drives)


def _lqr(crane: Crane, period: float) -> SetpointRegulator:
    return SetpointRegulator(**vars(lqr(crane, _at_rest(crane, period))), crane=crane)


def _integral(crane: Crane, period: float) -> HoistIntegral:
    limit = float(crane.effort_limit @ crane.layout.along("l"))
    return HoistIntegral(crane, _lqr(crane, period), HOIST[1], limit)


def _yielding(crane: Crane, period: float) -> Any:
    options: dict[str, Any] = {"limits": usual_limits(converters(crane)), "control_period": period}
    return with_damping(crane, hold(crane), recovery=0.2, **options)


def _predictive(crane: Crane, period: float) -> Any:
    stage = whole_periods(0.6, period)
    limits = usual_limits(converters(crane))
    return receding(crane, limits, control_period=period, stages=20, stage=stage)


CONTROLLERS: dict[str, tuple[Drive, Callable[[Crane, float], Any]]] = {
    "hold": ("effort", lambda crane, period: hold_controller(crane)),
    "lqr": ("effort", _lqr),
    "integral": ("effort", _integral),
    "observer": (
        "effort",
        lambda crane, t: with_observer(_lqr(crane, t), crane, _at_rest(crane, t)),
    ),
    "yielding": ("motion", _yielding),
    "shaper": (
        "effort",
        lambda crane, period: shaped(hold(crane), zv(), swing_period(crane, crane.start.q)),
    ),
    "predictive": ("effort", _predictive),
}
"""Drives, and the controller of a crane for a control period [s], by name: each drive by itself, an
LQR, the same with an integral of the hoist, the same behind an observer of the swing, drives that
yield to the swing, input shaping of the setpoint, and predictive control, in C alone."""
