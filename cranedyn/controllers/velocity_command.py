"""Any controller as one that commands rates, for drives with frequency converters.

A converter gives a drive the acceleration (r - v)/T, with its lag T and its reference rate r. So a
desired acceleration a becomes the rate v + τ a, with the rate v of the drive and τ the sum of the
lag and the delay of commands.

* A hold controller (`Hold`) commands the rate at which its damping balances its stiffness.
* Gains about a motion (`Tracking`, `HoistIntegral`) command the rate that their efforts would give:
  the crane's accelerations under these efforts, linearised along the motion.
* `Follow` commands the rates of its reference and a share of the distance from it.
* `DampingController` commands the rate that it computes anyway.
* Any other controller of efforts or accelerations commands v + τ a.

Feed-forward is commanded early by the delay, and compensated for the lag. All controllers of this
list but the last two are affine in the state.

Gains for efforts are too high for converters, whose limited jerk comes too late for them:
`effort_weight_for_rates` is the weight of an LQR whose gains are not. `ShapedVelocityCommand` is
input shaping of the setpoint itself, by the drives' rates.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from cranedyn.checks import ShortRepr, check_choice, number
from cranedyn.clocks import SAME_PERIOD, Clocked, soon_enough
from cranedyn.controllers.affine import Affine, at_drives, without_integral
from cranedyn.controllers.damping import DampingController
from cranedyn.controllers.follow import Follow
from cranedyn.controllers.hold import Hold
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.controllers.lqr import effort_weight_of
from cranedyn.controllers.tracking import Tracking
from cranedyn.dynamics.converters import Converters, converters_of_run
from cranedyn.dynamics.equations_of_motion import acceleration, linearise
from cranedyn.dynamics.linearisation import feedback_gain
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import Controller, DirectDrive, Reference, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.references.tabulated import interpolate_many, locate_many, tabulated

RECOVERY = 1.0
"""Share of a drive's distance from its reference that is corrected per second [1/s], ours."""

SIDEWAYS_EFFORT_FACTOR = 30.0
"""Factor on the weight of the efforts that move the load sideways, in an LQR for drives with
converters.

With the usual weights a swing of 0.1 rad asks for 40 times the accelerations that converters are
set to; their limited jerk then comes too late, and the load is swung up. The value is our choice.
"""


def gentle_recovery(converters: Converters) -> np.ndarray:
    """Return gains of position loops that never ask a drive to brake harder than its ramp does
    [1/s], shape (m,).

    A drive at the distance e from its goal that is commanded the rate v = K e brakes by K v, at
    most by K times its largest rate. With K = A/v_max that is the acceleration A of its ramp. With
    a larger K a drive that comes from afar runs past its goal, and may never come to rest there.
    """
    return converters.accelerations / converters.rates


def effort_weight_for_rates(crane: Crane) -> np.ndarray:
    """Return the weight R of efforts in an LQR whose gains suit drives with converters, shape
    (m, m): that of `effort_weight_of`, times `SIDEWAYS_EFFORT_FACTOR` for all drives but the hoist.
    """
    is_hoist = crane.layout.along("l") > 0.0
    return effort_weight_of(crane) * np.diag(np.where(is_hoist, 1.0, SIDEWAYS_EFFORT_FACTOR))


@dataclass(frozen=True, eq=False)
class _LagCompensation:
    """Compensation of the delay and lag of converters.

    Attributes:
        converters: The converters.
        ahead: Time from a command to the middle of the time for which it holds [s].
        period: Time between control instants [s].
    """

    converters: Converters
    ahead: float
    period: float

    @property
    def total(self) -> np.ndarray:
        """Delay and lag of each drive [s], shape (m,)."""
        return self.converters.lags + self.ahead

    def commands_for(self, rates: np.ndarray, later_rates: np.ndarray) -> np.ndarray:
        """Return the commands for which the ramps of the converters pass reference rates, shape
        (rows, m).

        A ramp generator takes the time a/J to reach an acceleration a at the jerk J. So a command
        that rises at the slope a is followed by a ramp that stays a²/(2 J) behind it.

        Args:
            rates: Reference rates [rad/s or m/s], shape (rows, m).
            later_rates: Those a period later, shape (rows, m).
        """
        limit = self.converters.accelerations
        slope = np.clip((later_rates - rates) / self.period, -limit, limit)
        return rates + slope * np.abs(slope) / (2.0 * self.converters.jerks)


@dataclass(frozen=True, eq=False, repr=False)
class FollowVelocityCommand(ShortRepr):
    """The rates of a reference, compensated for the lag of converters, and a share of the distance
    from it.

    Attributes:
        crane: The crane.
        reference: The reference to follow.
        lead: Compensation of the converters.
        recovery: Share of the distance that is corrected per second [1/s].
    """

    crane: Crane
    reference: Reference
    lead: _LagCompensation
    recovery: float = RECOVERY

    def begin_run(self, t: float, control_period: float) -> None:
        """See `cranedyn.clocks.Clocked`."""
        soon_enough(self.lead.period, control_period)

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return rates of the drives [rad/s or m/s], shape (m,)."""
        error = setpoint.position - state.q[self.crane.layout.drives]
        return self._rates(np.array([t]))[0] + self.recovery * error

    def affine(self, times: np.ndarray, positions: np.ndarray) -> Affine:
        """Return the affine form, see `cranedyn.controllers.affine`."""
        m = self.crane.layout.m
        gain = feedback_gain(self.crane, np.full(m, self.recovery), np.zeros(m))
        rates = self._rates(times)
        return without_integral(
            rates,
            np.tile(gain, (len(rates), 1, 1)),
            at_drives(self.crane, positions, np.zeros_like(positions)),
        )

    def _rates(self, times: np.ndarray) -> np.ndarray:
        """Return the rates to command at some times [s], shape (rows, m)."""
        rates = self._reference_rates(times + self.lead.ahead)
        later_rates = self._reference_rates(times + self.lead.ahead + self.lead.period)
        return self.lead.commands_for(rates, later_rates)

    def _reference_rates(self, times: np.ndarray) -> np.ndarray:
        """Return the rates r for which drives with a lag T have the rates v of the reference at
        some times [s], shape (rows, m): from a = (r - v)/T follows r = v + T a.
        """
        setpoint = tabulated(self.reference, times, self.crane.layout.m)
        return setpoint.velocity + self.lead.converters.lags * setpoint.acceleration


@dataclass(frozen=True, eq=False, repr=False)
class DampingVelocityCommand(DampingController):
    """A damping controller that commands rates."""

    def command(
        self, wanted: np.ndarray, position: np.ndarray, q: np.ndarray, v: np.ndarray
    ) -> np.ndarray:
        """Return rates of the drives [rad/s or m/s], shape (m,), see `DampingController`."""
        return self.velocity(wanted, position, q)


@dataclass(eq=False, repr=False)
class VelocityCommand(ShortRepr):
    """The rates v + τ a for the efforts or accelerations of another controller.

    Attributes:
        crane: The crane that the controller assumes.
        controller: The other controller.
        drive: Kind of its commands.
        lead: τ for each drive [s], shape (m,).
    """

    crane: Crane
    controller: Controller
    drive: DirectDrive
    lead: np.ndarray

    def begin_run(self, t: float, control_period: float) -> None:
        """See `cranedyn.clocks.Clocked`."""
        if isinstance(self.controller, Clocked):
            self.controller.begin_run(t, control_period)

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return rates of the drives [rad/s or m/s], shape (m,)."""
        drives = self.crane.layout.drives
        output = self.controller(t, state, setpoint)
        if self.drive == "effort":
            output = acceleration(self.crane, state, output)[drives]
        return state.v[drives] + self.lead * output


@dataclass(eq=False, repr=False)
class ShapedVelocityCommand(ShortRepr):
    """Input shaping of the setpoint of the loop, for drives that take rates.

    Each drive is commanded the shaped rate of its setpoint, and a share of its distance from the
    shaped position. It remembers past setpoints: make one for each run.

    Attributes:
        crane: The crane.
        delays: Delay of each part of the setpoint [s], see `cranedyn.references.shaped.Shaped`.
        amplitudes: Share of the setpoint that each part carries; they add up to 1.
        period: Control period [s].
        recovery: Share of the distance that each drive corrects per second [1/s], shape (m,).
    """

    crane: Crane
    delays: np.ndarray
    amplitudes: np.ndarray
    period: float
    recovery: np.ndarray
    # Positions and rates of the setpoints of the last calls, the present one first.
    _past: deque[np.ndarray] = field(init=False)
    # Delay of each part as a number of calls, and the share of one more.
    _calls: list[int] = field(init=False)
    _shares: list[float] = field(init=False)

    def __post_init__(self) -> None:
        """Begin without a past."""
        calls, shares = whole_calls_and_share(self.delays, self.period)
        self._calls = calls.tolist()
        self._shares = shares.tolist()
        # A share of a call is interpolated between two of them.
        self._past = deque(maxlen=max(self._calls) + 2)

    def begin_run(self, t: float, control_period: float) -> None:
        """Forget the setpoints of the run before.

        Raises:
            OutOfRange: If the control period of the run [s] is another one.
        """
        if abs(control_period - self.period) > SAME_PERIOD * self.period:
            allowed = f"that of the shaper, {self.period:g}"
            raise OutOfRange("control period of the run", control_period, allowed, "s")
        self._past.clear()

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return rates of the drives [rad/s or m/s], shape (m,)."""
        self._past.appendleft(np.array([setpoint.position, setpoint.velocity], dtype=float))
        position, rate = self._shaped_setpoint()
        return rate + self.recovery * (position - state.q[self.crane.layout.drives])

    def _shaped_setpoint(self) -> np.ndarray:
        """Return positions and rates of the shaped setpoint, shape (2, m)."""
        # Before the first call the drives are taken to have stood at its setpoint.
        before_first = self._past[-1].copy()
        before_first[1] = 0.0

        def past(calls: int) -> np.ndarray:
            return self._past[calls] if calls < len(self._past) else before_first

        shaped = np.zeros_like(before_first)
        for calls, share, amplitude in zip(
            self._calls, self._shares, self.amplitudes.tolist(), strict=True
        ):
            # On the line between the setpoints of two calls.
            delayed = past(calls) + share * (past(calls + 1) - past(calls))
            shaped += amplitude * delayed
        return shaped


def whole_calls_and_share(delays: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Return delays [s] as whole numbers of calls, and as the share of one more call that is left,
    both of the shape of the delays.

    A share within `SAME_PERIOD` of 0 or of 1 is the rounding of a clock, and counts as none.
    """
    calls = delays / period
    whole_calls = np.floor(calls + SAME_PERIOD)
    shares = calls - whole_calls
    return whole_calls.astype(int), np.where(np.abs(shares) > SAME_PERIOD, shares, 0.0)


def as_velocity_command(
    crane: Crane,
    controller: Controller,
    *,
    drive: DirectDrive,
    converters: Converters | None = None,
    control_period: float = 5e-3,
) -> Controller:
    """Return a controller for `simulate(..., drive="velocity")` from one that commands efforts or
    accelerations.

    Args:
        crane: The crane that the controller assumes.
        controller: The controller.
        drive: Kind of its commands: efforts, or with "motion" accelerations.
        converters: Frequency converters of the drives; None for typical ones.
        control_period: Time between control instants [s], the same as in `simulate`.

    Raises:
        OutOfRange: If a hold controller has no damping, or a number is out of range.
    """
    check_choice("drive", drive, DirectDrive)
    period = number("control_period", control_period, "s", "> 0")
    drive_converters = converters_of_run(crane, "velocity", converters)
    assert drive_converters is not None
    lead = _LagCompensation(drive_converters, drive_converters.ahead(period), period)
    if isinstance(controller, Hold):
        for damping in controller.damping.tolist():
            number("damping of a hold controller for velocity drives", damping, "", "> 0")
        # At the rate k_p (setpoint - position) / k_d damping and stiffness balance. It is a hold
        # controller with the gain k_p / k_d that commands rates.
        zero = np.zeros(crane.layout.m)
        return Hold(
            crane,
            stiffness=controller.stiffness / controller.damping,
            damping=zero,
            feed_forward=zero,
        )
    if isinstance(controller, Tracking):
        return _rate_tracking(crane, controller, lead)[0]
    if isinstance(controller, HoistIntegral):
        tracking, rates_per_effort = _rate_tracking(crane, controller.tracking, lead)
        hoist = crane.layout.drive_of("hoist")
        return replace(
            controller,
            tracking=tracking,
            integral_gain=controller.integral_gain * float(rates_per_effort[hoist, hoist]),
            limit=float(drive_converters.rates[hoist]),
        )
    if isinstance(controller, Follow):
        return FollowVelocityCommand(crane, controller.reference, lead)
    if isinstance(controller, DampingController):
        return DampingVelocityCommand(
            crane=controller.crane,
            reference=controller.reference,
            ratio=controller.ratio,
            recovery=controller.recovery,
            rates=controller.rates,
            accelerations=controller.accelerations,
            control_period=controller.control_period,
        )
    return VelocityCommand(crane, controller, drive, lead.total)


def _rate_tracking(
    crane: Crane, tracking: Tracking, lead: _LagCompensation
) -> tuple[Tracking, np.ndarray]:
    """Return the tracking controller that commands the rates which the efforts of another one would
    give, and the rates per effort at the end of the motion, shape (m, m).
    """
    layout = crane.layout
    n = layout.n
    drives = layout.drives
    tau = lead.total[:, None]
    rates = np.empty_like(tracking.feed_forward)
    gains = np.empty_like(tracking.gain)

    # Under efforts u - K δz, with δz the deviation from the motion, the drives accelerate by
    # δa = (A - B K) δz. Commanded rates are v + τ a, so that their gain is τ (B K - A) less one for
    # the rates of the drives themselves.
    for k, (z, effort) in enumerate(zip(tracking.setpoint, tracking.feed_forward, strict=True)):
        state = State(z[:n], z[n:])
        by_state, by_effort = linearise(crane, state, effort)
        a = acceleration(crane, state, effort)[drives]
        rates[k] = state.v[drives] + lead.converters.lags * a
        gains[k] = tau * (by_effort[drives] @ tracking.gain[k] - by_state[drives])
    gains[:, range(layout.m), n + drives] -= 1.0

    def rates_at(times: np.ndarray) -> np.ndarray:
        """Return the rates at some times [s], shape (times, m)."""
        row, share = locate_many(times, tracking.period, len(rates))
        return interpolate_many(rates, row, share)

    times = tracking.period * np.arange(len(rates)) + lead.ahead
    commands = lead.commands_for(rates_at(times), rates_at(times + lead.period))
    # A subclass stays what it is, such as one whose setpoint is that of the loop.
    rate_tracking = replace(tracking, feed_forward=commands, gain=gains)
    return rate_tracking, tau * by_effort[drives]
