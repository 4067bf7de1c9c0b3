"""Any strategy as rates, for drives with frequency converters.

A converter gives a drive the acceleration (r - v)/T where T is its lag and r its reference rate. So
what a strategy wants the drives to accelerate by, a, becomes the rate v + τ a, with v the rate of
the drive and τ the lag together with the time by which commands are late.

* A brake (`Hold`) asks for the rate at which its damping would take up its stiffness.
* Gains about a motion (`Tracking`, `HoistIntegral`) ask for the rate that their efforts would give:
  the crane's accelerations under these, linearised along the motion.
* Motions that are followed (`Follow`) ask for their own rates, and for a share of the distance.
* Drives that yield (`Damped`) ask for the rate that they compute anyway.
* Whatever else answers efforts, or accelerations, asks for v + τ a.

What is known beforehand is asked for early enough and with the lag undone. All but the last two are
affine in the state.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from cranedyn.checks import ShortRepr, check_choice, number
from cranedyn.clocks import Timed, soon_enough
from cranedyn.controllers.affine import Affine, at_drives, without_integral
from cranedyn.controllers.damped import Damped
from cranedyn.controllers.follow import Follow
from cranedyn.controllers.hold import Hold
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.controllers.tracking import Tracking
from cranedyn.dynamics.converters import Converters, fitting
from cranedyn.dynamics.linearisation import feedback_gain
from cranedyn.dynamics.pinocchio import acceleration, linearise
from cranedyn.interfaces import Controller, DirectDrive, Reference, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.references.rows import at_places, places
from cranedyn.references.tabulated import tabulated

RECOVERY = 1.0
"""Share of the distance from its reference that a drive takes back per second [1/s], ours."""


@dataclass(frozen=True, eq=False)
class _Lead:
    """What makes up for converters.

    Attributes:
        converters: These.
        ahead: From a command to the middle of the time for which it holds [s].
        period: Time between control instants [s].
    """

    converters: Converters
    ahead: float
    period: float

    @property
    def total(self) -> np.ndarray:
        """The same and the lag, for each drive [s], shape (m,)."""
        return self.converters.lags + self.ahead

    def undone(self, now: np.ndarray, later: np.ndarray) -> np.ndarray:
        """Commands that make ramps pass by reference rates, given those a period later, shape
        (rows, m) each: a ramp that gains ρ per second at jerk J stays ρ²/(2 J) behind.
        """
        most, jerk = self.converters.accelerations, self.converters.jerks
        gaining = np.clip((later - now) / self.period, -most, most)
        return now + gaining * np.abs(gaining) / (2.0 * jerk)


@dataclass(frozen=True, eq=False, repr=False)
class FollowRates(ShortRepr):
    """The rates of a reference, made up for what converters lag, and a share of the distance from
    it.

    Attributes:
        crane: The crane.
        reference: The reference to follow.
        lead: What makes up for the converters.
        recovery: Share of the distance that is taken back per second [1/s].
    """

    crane: Crane
    reference: Reference
    lead: _Lead
    recovery: float = RECOVERY

    def run_begins(self, t: float, control_period: float) -> None:
        """See `cranedyn.clocks.Timed`."""
        soon_enough(self.lead.period, control_period)

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Rates of the drives [rad/s or m/s], shape (m,)."""
        away = setpoint.position - state.q[self.crane.layout.drives]
        return self._rates(np.array([t]))[0] + self.recovery * away

    def affine(self, times: np.ndarray, positions: np.ndarray) -> Affine:
        """The common form, see `cranedyn.controllers.affine`."""
        m = self.crane.layout.m
        gain = feedback_gain(self.crane, np.full(m, self.recovery), np.zeros(m))
        rates = self._rates(times)
        return without_integral(
            rates,
            np.tile(gain, (len(rates), 1, 1)),
            at_drives(self.crane, positions, np.zeros_like(positions)),
        )

    def _rates(self, times: np.ndarray) -> np.ndarray:
        lags, m = self.lead.converters.lags, self.crane.layout.m
        now, later = (
            asked.velocity + lags * asked.acceleration
            for asked in (
                tabulated(self.reference, times + self.lead.ahead + wait, m)
                for wait in (0.0, self.lead.period)
            )
        )
        return self.lead.undone(now, later)


@dataclass(frozen=True, eq=False, repr=False)
class DampedRates(Damped):
    """Drives that yield to the swing, told by rates."""

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Rates of the drives [rad/s or m/s], shape (m,)."""
        return self.velocity(t, state, setpoint)


@dataclass(eq=False, repr=False)
class GivenRates(ShortRepr):
    """The rates v + τ a that efforts, or accelerations, of another controller would give.

    Attributes:
        crane: The crane, as far as it is known.
        controller: The other.
        drive: What that one answers.
        lead: τ for each drive [s], shape (m,).
    """

    crane: Crane
    controller: Controller
    drive: DirectDrive
    lead: np.ndarray

    def run_begins(self, t: float, control_period: float) -> None:
        """See `cranedyn.clocks.Timed`."""
        if isinstance(self.controller, Timed):
            self.controller.run_begins(t, control_period)

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Rates of the drives [rad/s or m/s], shape (m,)."""
        drives, answer = self.crane.layout.drives, self.controller(t, state, setpoint)
        if self.drive == "effort":
            answer = acceleration(self.crane, state, answer)[drives]
        return state.v[drives] + self.lead * answer


def rated(
    crane: Crane,
    controller: Controller,
    *,
    drive: DirectDrive,
    converters: Converters | None = None,
    control_period: float = 5e-3,
) -> Controller:
    """A controller made for other drives, for `simulate(..., drive="velocity")`.

    Args:
        crane: The crane, as far as the controller knows it.
        controller: What it does.
        drive: What it answers: efforts, or with "motion" accelerations.
        converters: Frequency converters of the drives; None for typical ones.
        control_period: Time between control instants [s], the same as in `simulate`.

    Raises:
        OutOfRange: If a brake has no damping, or a number is out of range.
    """
    check_choice("drive", drive, DirectDrive)
    period = number("control_period", control_period, "s", "> 0")
    made = fitting(crane, "velocity", converters)
    assert made is not None
    lead = _Lead(made, made.ahead(period), period)
    if isinstance(controller, Hold):
        for damping in controller.damping.tolist():
            number("damping of a brake that is told by rates", damping, "", "> 0")
        none = np.zeros(crane.layout.m)
        return Hold(crane, controller.stiffness / controller.damping, none, none)
    if isinstance(controller, Tracking):
        return _tracking(crane, controller, lead)[0]
    if isinstance(controller, HoistIntegral):
        tracking, given = _tracking(crane, controller.tracking, lead)
        hoist = int(np.flatnonzero(crane.layout.along("l"))[0])
        return replace(
            controller,
            tracking=tracking,
            integral_gain=controller.integral_gain * float(given[hoist, hoist]),
            limit=float(made.rates[hoist]),
        )
    if isinstance(controller, Follow):
        return FollowRates(crane, controller.reference, lead)
    if isinstance(controller, Damped):
        parts = {part.name: getattr(controller, part.name) for part in fields(Damped)}
        return DampedRates(**parts)
    return GivenRates(crane, controller, drive, lead.total)


def _tracking(crane: Crane, tracking: Tracking, lead: _Lead) -> tuple[Tracking, np.ndarray]:
    """Gains about a motion that answer rates, and the rates per effort at its end, shape (m, m)."""
    layout, total = crane.layout, lead.total[:, None]
    n, drives = layout.n, layout.drives
    rates, gains = np.empty_like(tracking.feed_forward), np.empty_like(tracking.gain)
    for k, (z, effort) in enumerate(zip(tracking.setpoint, tracking.feed_forward, strict=True)):
        state = State(z[:n], z[n:])
        by_state, by_effort = linearise(crane, state, effort)
        a = acceleration(crane, state, effort)[drives]
        rates[k] = state.v[drives] + lead.converters.lags * a
        gains[k] = total * (by_effort[drives] @ tracking.gain[k] - by_state[drives])
    gains[:, range(layout.m), n + drives] -= 1.0
    times = tracking.period * np.arange(len(rates)) + lead.ahead
    now, later = (
        at_places(rates, *places(times + wait, tracking.period, len(rates)))
        for wait in (0.0, lead.period)
    )
    made = Tracking(tracking.period, lead.undone(now, later), gains, tracking.setpoint)
    return made, total * by_effort[drives]
