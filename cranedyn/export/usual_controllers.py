"""Controllers that exporters of code offer by name, about the start of a crane.

Each has a usual kind of commands, `CONTROLLERS`. For drives behind frequency converters, such as
those of `cranedyn serve`, most of them also exist with rates as commands, `RATE_CONTROLLERS`;
`WITHOUT_RATES` says why the others do not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cranedyn.clocks import whole_periods
from cranedyn.compiled.horizon.receding import receding
from cranedyn.controllers.affine import Affine, at_rest_shifted
from cranedyn.controllers.damping import with_damping
from cranedyn.controllers.hold import Hold, hold_controller
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.controllers.lqr import lqr
from cranedyn.controllers.paper import HOIST
from cranedyn.controllers.tracking import Tracking
from cranedyn.controllers.velocity_command import (
    ShapedVelocityCommand,
    as_velocity_command,
    effort_weight_for_rates,
    gentle_recovery,
)
from cranedyn.dynamics.converters import converters
from cranedyn.errors import DataError, UnknownName
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


def rest_at_start(crane: Crane, period: float) -> Motion:
    """Return the motion of a crane that stands at its start, of one row."""
    no_motion = np.zeros((1, crane.layout.n))
    q = crane.resting(crane.start.q)[None]
    return Motion(period, q, no_motion, no_motion, crane.layout.drives)


def _hold(crane: Crane, period: float) -> Any:
    """Return a controller of each drive by itself."""
    return hold_controller(crane)


def _lqr(crane: Crane, period: float) -> SetpointRegulator:
    """Return an LQR about the start."""
    return _regulator(crane, period, None)


def _regulator(crane: Crane, period: float, effort_weight: np.ndarray | None) -> SetpointRegulator:
    """Return an LQR about the start.

    Args:
        crane: The crane.
        period: Control period [s].
        effort_weight: Weight of the efforts, shape (m, m); None for the usual one.
    """
    tracking = lqr(crane, rest_at_start(crane, period), effort_weight=effort_weight)
    return SetpointRegulator(
        tracking.period, tracking.feed_forward, tracking.gain, tracking.setpoint, crane
    )


def _integral(crane: Crane, period: float) -> HoistIntegral:
    """Return the LQR with an integral of the hoist, whose gain is that of the paper."""
    _, integral_gain, _ = HOIST
    limit = float(crane.effort_limit @ crane.layout.along("l"))
    return HoistIntegral(crane, _lqr(crane, period), integral_gain, limit)


def _observer(crane: Crane, period: float) -> Any:
    """Return the LQR behind an observer of the swing with constant gains."""
    return with_observer(_lqr(crane, period), crane, rest_at_start(crane, period), steady=True)


def _kalman(crane: Crane, period: float) -> Any:
    """Return the LQR behind an observer of the swing whose gains begin with what is expected of the
    start.
    """
    return with_observer(_lqr(crane, period), crane, rest_at_start(crane, period))


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
    """Return predictive control that commands efforts."""
    return _receding(crane, period, "effort")


def _receding(crane: Crane, period: float, drive: Drive) -> Any:
    """Return predictive control with few and long stages, for drives of a mode."""
    limits = usual_limits(converters(crane))
    stage = whole_periods(PREDICTIVE_STAGE, period)
    return receding(
        crane,
        limits,
        drive=drive,
        control_period=period,
        stages=PREDICTIVE_STAGES,
        stage=stage,
    )


def _hold_by_rates(crane: Crane, period: float) -> Hold:
    """Return position loops of the drives, which command rates."""
    zero = np.zeros(crane.layout.m)
    recovery = gentle_recovery(converters(crane))
    return Hold(crane, stiffness=recovery, damping=zero, feed_forward=zero)


def _lqr_by_rates(crane: Crane, period: float) -> Any:
    """Return an LQR about the start whose gains suit converters, and which commands rates."""
    efforts = _regulator(crane, period, effort_weight_for_rates(crane))
    return as_velocity_command(crane, efforts, drive="effort", control_period=period)


def _yielding_by_rates(crane: Crane, period: float) -> Any:
    """Return drives that yield to the swing by their rates."""
    accelerations = _yielding(crane, period)
    return as_velocity_command(crane, accelerations, drive="motion", control_period=period)


def _shaper_by_rates(crane: Crane, period: float) -> ShapedVelocityCommand:
    """Return input shaping of the setpoints, which the drives follow by their rates."""
    shaper = _shaper(crane, period)
    recovery = gentle_recovery(converters(crane))
    return ShapedVelocityCommand(crane, shaper.delays, shaper.amplitudes, period, recovery)


def _predictive_by_rates(crane: Crane, period: float) -> Any:
    """Return predictive control that commands rates."""
    return _receding(crane, period, "velocity")


CONTROLLERS: dict[str, tuple[Drive, Callable[[Crane, float], Any]]] = {
    "hold": ("effort", _hold),
    "lqr": ("effort", _lqr),
    "integral": ("effort", _integral),
    "observer": ("effort", _observer),
    "kalman": ("effort", _kalman),
    "yielding": ("motion", _yielding),
    "shaper": ("effort", _shaper),
    "predictive": ("effort", _predictive),
}
"""Drives, and the controller of a crane for a control period [s], by name: each drive by itself, an
LQR, the same with an integral of the hoist, the same behind an observer of the swing with constant
gains and with those of a Kalman filter from its start on, drives that yield to the swing, input
shaping of the setpoint, and predictive control, in C alone."""

RATE_CONTROLLERS: dict[str, Callable[[Crane, float], Any]] = {
    "hold": _hold_by_rates,
    "lqr": _lqr_by_rates,
    "yielding": _yielding_by_rates,
    "shaper": _shaper_by_rates,
    "predictive": _predictive_by_rates,
}
"""The controllers that also exist with rates as commands, by the same names."""

_UNSEEN_SWING = (
    "the load does not move a drive that takes rates, so that the motion of the drives says "
    "nothing about the swing; take lqr with a sensor of the swing"
)

WITHOUT_RATES = {
    "integral": (
        "a drive that takes rates holds its position under any load, so that the integral of the "
        "hoist has nothing to remove; take lqr"
    ),
    "observer": _UNSEEN_SWING,
    "kalman": _UNSEEN_SWING,
}
"""Why the other controllers do not exist with rates as commands, by name."""


def usual_controller(
    name: str, crane: Crane, period: float, drive: Drive | None = None
) -> tuple[Any, Drive]:
    """Return a controller by its name, and what its commands are.

    Args:
        name: One of `CONTROLLERS`.
        crane: The crane, about whose start it is.
        period: Control period [s].
        drive: What the drives take; None for what the controller usually commands.

    Raises:
        UnknownName: If there is no controller of this name.
        DataError: If the controller does not exist for such drives.
    """
    if name not in CONTROLLERS:
        raise UnknownName("controller", name, [*CONTROLLERS])
    usual_drive, make = CONTROLLERS[name]
    if drive is None or drive == usual_drive:
        return make(crane, period), usual_drive
    if drive != "velocity":
        raise DataError(
            f"The controller {name} has no commands for the drive mode {drive}; allowed are "
            f"{usual_drive}{' and velocity' if name in RATE_CONTROLLERS else ''}."
        )
    if name not in RATE_CONTROLLERS:
        raise DataError(f"There is no {name} with rates as commands: {WITHOUT_RATES[name]}.")
    return RATE_CONTROLLERS[name](crane, period), "velocity"
