"""Control without a swing sensor: a Kalman filter estimates it from the motion of the drives.

The load pulls at trolley, jib and hoist. The model contains this pull, and the efforts of the
drives are known; so the swing is observable from the drives alone.

The gains of the filter begin with the deviations that are expected of the start, and converge.
About a rest the converged ones can be used from the first instant on, see `steady` of
`with_observer`. That is one table of gains instead of thousands, which is worth its slower first
seconds where memory is small.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import NamedTuple

import numpy as np

from cranedyn.checks import ShortRepr, whole
from cranedyn.clocks import SAME_PERIOD, Clocked
from cranedyn.controllers.lqr import Linearised, linearised
from cranedyn.dynamics.scalars import solve_linear
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.estimation.sensor_model import noise_of, standard_deviations
from cranedyn.interfaces import Controller, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.references.motion import Motion

DISTURBANCE = {
    ("revolute", True): 2e-3,
    ("prismatic", True): 0.2,
    ("revolute", False): 0.1,
    ("prismatic", False): 0.1,
}
"""Standard deviations of accelerations that the model lacks [rad/s² or m/s²], white from one
control instant to the next, by kind of joint and whether it is driven; ours. For the drives of the
tower crane they are about 2 kN m, 100 N and 200 N."""

INITIAL_STD = {
    ("revolute", True): 1e-3,
    ("prismatic", True): 0.01,
    ("revolute", False): 0.1,
    ("prismatic", False): 0.1,
}
"""Standard deviations of coordinates and of rates at the start, by the same keys; ours: the load
may swing by 0.1 rad."""


def disturbance_of(crane: Crane) -> np.ndarray:
    """Return standard deviations of the accelerations that the model lacks, shape (n,)."""
    return _each(crane, DISTURBANCE)


def initial_std_of(crane: Crane) -> np.ndarray:
    """Return standard deviations of coordinates and rates at the start, shape (2 n,)."""
    return np.tile(_each(crane, INITIAL_STD), 2)


def _each(crane: Crane, table: Mapping[tuple[str, bool], float]) -> np.ndarray:
    """Return a number for each joint from a table, shape (n,); a joint held by a spring counts as
    one held by a drive.
    """
    has_spring = (crane.springs.stiffness > 0.0).tolist()
    numbers = []
    for joint, is_elastic in zip(crane.layout.joints, has_spring, strict=True):
        numbers.append(table[joint.kind, joint.driven or is_elastic])
    return np.array(numbers)


def kalman_gain(cross: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Return the gain of a correction, shape (unknowns, measured).

    Args:
        cross: Covariance of measurements and unknowns, shape (measured, unknowns).
        spread: Covariance of the measurements, noise included, shape (measured, measured).

    Raises:
        CraneError: If the covariance of the measurements is not positive definite.
    """
    # Traced numbers of the compiled filter have the data type object.
    if spread.dtype == object:
        return solve_linear(spread, cross).T
    # LAPACK itself: for so few numbers NumPy's checks take longer than the solution.
    from scipy.linalg.lapack import dposv

    _, solution, failed = dposv(spread, cross)
    if failed:
        raise CraneError(
            "The observer cannot go on: the covariance of its readings is not positive definite "
            "any more. Give it a larger noise, or first deviations that differ less."
        )
    return solution.T


def corrected_covariance(
    covariance: np.ndarray, by: np.ndarray, gain: np.ndarray, noise: np.ndarray
) -> np.ndarray:
    """Return the covariance after a correction, in Joseph's form.

    Args:
        covariance: Covariance before it, shape (unknowns, unknowns).
        by: Derivatives of the measurements by the unknowns, shape (measured, unknowns).
        gain: Gain of the correction, shape (unknowns, measured).
        noise: Covariance of the measurements, shape (measured, measured).
    """
    # (I - K H) P (I - K H)ᵀ + K R Kᵀ stays symmetric and positive in spite of round-off, for any
    # gain K.
    residual = np.eye(len(covariance)) - gain @ by
    return residual @ covariance @ residual.T + gain @ noise @ gain.T


def process_noise(disturbance: np.ndarray, period: float) -> np.ndarray:
    """Return the covariance of coordinates and rates that accelerations held over a period [s] add,
    shape (2 n, 2 n), from their standard deviations, shape (n,).
    """
    n = len(disturbance)
    # An acceleration a held over a period h moves a coordinate by a h²/2 and its rate by a h.
    by_acceleration = np.vstack([np.eye(n) * period**2 / 2.0, np.eye(n) * period])
    return by_acceleration @ np.diag(disturbance) ** 2 @ by_acceleration.T


def check_next_call(t: float, previous: float, period: float) -> None:
    """Check that an observer is called once in each period.

    Raises:
        CraneError: If the call is not one period [s] after the previous one.
    """
    if abs(t - previous - period) > SAME_PERIOD * period:
        raise CraneError(
            f"This observer has seen t = {previous:g} s and is asked for t = {t:g} s; it needs "
            f"a call every {period:g} s, and a new one for each run."
        )


class Correction(NamedTuple):
    """Correction of an estimate by a measurement.

    Attributes:
        gain: Gain of the measured deviations, shape (2 n, 2 m).
        covariance: Covariance of the error after it, shape (2 n, 2 n).
    """

    gain: np.ndarray
    covariance: np.ndarray


_SETTLED_CHANGE = 1e-14
"""Change of a covariance from one correction to the next, relative to the standard deviations, from
which on it is round-off, and the gain counts as settled."""


@dataclass(eq=False, repr=False)
class KalmanGains(ShortRepr):
    """Gains of Kalman's filter (1960) for the deviation from a motion; the covariance is kept in
    Joseph's form. No measurement changes either, so that the observers of several runs may share
    them.

    Attributes:
        model: The crane along the motion.
        measured: Indices of positions and rates of the drives among coordinates and rates, shape
            (2 m,).
        disturbance: Covariance added in each control period, shape (2 n, 2 n).
        noise: Covariance of the measurements, shape (2 m, 2 m).
        covariance: Covariance of the error at the start, shape (2 n, 2 n).
        steady: The correction of all instants, see `steady_correction`; None where it varies.
    """

    model: Linearised
    measured: np.ndarray
    disturbance: np.ndarray
    noise: np.ndarray
    covariance: np.ndarray
    steady: Correction | None = None
    # The corrections that are computed so far, and whether they have settled, by the row of the
    # motion at which an observer begins.
    _corrections: dict[int, list[Correction]] = field(default_factory=dict)
    _settled: set[int] = field(default_factory=set)

    def correction(self, first: int, k: int) -> Correction:
        """Return correction k, counted from the one at the row `first` of the motion, computed when
        it is first needed. Behind the motion corrections settle, and the last one holds.
        """
        if self.steady is not None:
            return self.steady
        corrections = self._corrections.setdefault(first, [])
        while len(corrections) <= k and first not in self._settled:
            if not corrections:
                corrections.append(self._corrected(self.covariance))
                continue
            # The covariance is predicted from the row of the correction before.
            row = first + len(corrections) - 1
            before = corrections[-1].covariance
            corrections.append(self._corrected(self._predicted(before, row)))
            if row >= len(self.model.stretch) - 1:
                change = np.abs(corrections[-1].covariance - before)
                std = np.sqrt(before.diagonal())
                if (change <= _SETTLED_CHANGE * np.outer(std, std)).all():
                    self._settled.add(first)
        return corrections[min(k, len(corrections) - 1)]

    def _predicted(self, covariance: np.ndarray, row: int) -> np.ndarray:
        """Return the covariance one control period after a row of the motion."""
        last = len(self.model.stretch) - 1
        a = self.model.a[self.model.stretch[min(max(row, 0), last)]]
        return a @ covariance @ a.T + self.disturbance

    def _corrected(self, covariance: np.ndarray) -> Correction:
        """Return the correction of an estimate with a covariance."""
        indices = self.measured
        cross = covariance[indices]
        gain = kalman_gain(cross, cross[:, indices] + self.noise)
        by = np.eye(len(covariance))[indices]
        return Correction(gain, corrected_covariance(covariance, by, gain, self.noise))


def steady_correction(gains: KalmanGains) -> Correction:
    """Return the correction to which those of a filter about a rest converge.

    Raises:
        CraneError: If they do not converge: the measurements do not show all that moves.
    """
    from scipy.linalg import solve_discrete_are

    a = gains.model.a[-1]
    by = np.eye(len(a))[gains.measured]
    # The covariance before a correction solves the Riccati equation of the dual regulator
    # (Anderson & Moore, Optimal Filtering, 1979, §4.4).
    try:
        predicted = solve_discrete_are(a.T, by.T, gains.disturbance, gains.noise)
    except (np.linalg.LinAlgError, ValueError) as error:
        reason = str(error).strip().partition("\n")[0].rstrip(".")
        raise CraneError(
            "The gains of this observer do not converge: its measurements do not show all that "
            f"moves, or its numbers differ too much for double precision ({reason})."
        ) from error
    cross = by @ predicted
    gain = kalman_gain(cross, cross @ by.T + gains.noise)
    return Correction(gain, corrected_covariance(predicted, by, gain, gains.noise))


class _Command(NamedTuple):
    """Command of one control period.

    Attributes:
        row: Row of the motion at its beginning.
        correction: Effort beyond the feed-forward [N m or N], shape (m,).
    """

    row: int
    correction: np.ndarray


@dataclass(eq=False, repr=False)
class ObserverController(ShortRepr):
    """A controller that acts on an estimate of the state. It remembers: make one for each run, by
    `dataclasses.replace` with the same gains.

    Measurements come late by `delay` control periods. So the estimate is corrected for the time of
    the last measurement, and predicted from there to the present by the commands since, which a
    queue holds.

    Attributes:
        controller: The controller that gets the estimate.
        gains: Gains of the corrections.
        effort_limit: Largest efforts of the drives [N m or N], shape (m,).
        delay: Delay of the measurements [control periods].
        start: Expected start, shape (2 n,); None for the start of the motion.
        estimate: The last estimate of the state, None before the first call.
    """

    controller: Controller
    gains: KalmanGains
    effort_limit: np.ndarray
    delay: int = 0
    start: np.ndarray | None = None
    estimate: State | None = field(default=None, init=False)
    # Row of the motion at which the run began, and the number of corrections since.
    _first: int = field(init=False)
    _count: int = field(default=0, init=False)
    _t: float = field(default=0.0, init=False)
    # Deviation at the time of the last measurement, and the commands since.
    _deviation: np.ndarray = field(init=False)
    _commands: deque[_Command] = field(default_factory=deque, init=False)

    def __post_init__(self) -> None:
        """Begin without deviation."""
        # The import takes tenths of a second, which no control period has: so it is done here.
        import_module("scipy.linalg.lapack")
        self._deviation = np.zeros(len(self.gains.covariance))

    def begin_run(self, t: float, control_period: float) -> None:
        """Begin the run of the controller, see `cranedyn.clocks.Clocked`."""
        if isinstance(self.controller, Clocked):
            self.controller.begin_run(t, control_period)

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return the command of the controller, shape (m,); of the state only the drives are used.

        Raises:
            CraneError: If it is not called once in each period of the motion, at the time of a row.
        """
        model = self.gains.model
        row = model.row(t)
        if self.estimate is None:
            self._begin(t, row)
            self._correct(row, state)
        else:
            check_next_call(t, self._t, model.period)
            if len(self._commands) > self.delay:
                self._deviation = self._stepped(self._deviation, self._commands.popleft())
                # A late measurement was made when the oldest command left began to act.
                self._correct(self._commands[0].row if self._commands else row, state)
        deviation = self._deviation
        for past_command in self._commands:
            deviation = self._stepped(deviation, past_command)
        self.estimate = State(*(model.setpoint[row] + deviation).reshape(2, -1))
        command = np.asarray(self.controller(t, self.estimate, setpoint), dtype=float)
        # The drives do not exert more than their limits, whatever is commanded.
        effort = command.clip(-self.effort_limit, self.effort_limit)
        self._commands.append(_Command(row, effort - model.efforts[row]))
        self._t = t
        return command

    def _begin(self, t: float, row: int) -> None:
        """Begin a run at a time [s], that of a row of the motion or after its end.

        Raises:
            CraneError: If the motion has no row at this time.
        """
        model = self.gains.model
        last = len(model.setpoint) - 1
        rows = t / model.period
        if rows < last and abs(rows - round(rows)) > SAME_PERIOD:
            raise CraneError(
                f"This observer is first asked for t = {t:g} s; its motion has rows every "
                f"{model.period:g} s only."
            )
        self._first = min(round(rows), last)
        if self.start is not None:
            self._deviation = self.start - model.setpoint[row]

    def _stepped(self, deviation: np.ndarray, command: _Command) -> np.ndarray:
        """Return the deviation one control period after that of a command, shape (2 n,)."""
        model = self.gains.model
        k = model.stretch[command.row]
        return model.a[k] @ deviation + model.b[k] @ command.correction

    def _correct(self, row: int, state: State) -> None:
        """Correct the deviation by what was measured at a row of the motion."""
        indices = self.gains.measured
        measured = np.concatenate(state)[indices] - self.gains.model.setpoint[row, indices]
        gain = self.gains.correction(self._first, self._count).gain
        self._count += 1
        self._deviation = self._deviation + gain @ (measured - self._deviation[indices])


def with_observer(
    controller: Controller,
    crane: Crane,
    motion: Motion,
    *,
    dt: float = 5e-4,
    disturbance: Sequence[float] | np.ndarray | None = None,
    noise: Sequence[float] | np.ndarray | None = None,
    delay: int = 0,
    start: State | None = None,
    initial_std: Sequence[float] | np.ndarray | None = None,
    every: int = 10,
    steady: bool = False,
) -> ObserverController:
    """Return a controller of the whole state that works with sensors on the drives alone; make one
    for each run.

    Args:
        controller: The controller.
        crane: The crane that the filter assumes.
        motion: The motion about which the model is linearised; its period is the control period.
        dt: Physics step of the simulation [s].
        disturbance: Standard deviations of the accelerations that the model lacks, shape (n,); a
            larger one makes the filter trust its measurements more. None for `disturbance_of`.
        noise: Standard deviations of the measured drives [rad or m] and their rates [per second],
            shape (2 m,); None for `noise_of`.
        delay: Delay of the measurements [control periods], as in `with_sensor_model`; the
            estimate is predicted over it.
        start: Expected start; None for the start of the motion, with the load plumb.
        initial_std: Standard deviations of the start in coordinates and rates, shape (2 n,); None
            for `initial_std_of`.
        every: Control instants between linearisations.
        steady: Whether the gains are from the first instant on those to which they converge, for
            which `initial_std` does not matter. The motion must be a rest, a `Motion` of one row.

    Raises:
        CraneError: If the gains do not converge and `steady` asks for it.
        OutOfRange: If a standard deviation is negative or not finite, that of a measurement not
            positive, their number another, the delay not a whole number from 0 on, or the motion no
            rest and `steady` asks for one.
    """
    delay = whole("delay of the observer", delay, 0, "control periods")
    crane.require_independent_joints("An observer")
    n = crane.layout.n
    measured = crane.layout.measured
    if disturbance is None:
        disturbance = disturbance_of(crane)
    if noise is None:
        noise = noise_of(crane)[measured]
    if initial_std is None:
        initial_std = initial_std_of(crane)
    model = linearised(crane, motion, dt=dt, every=every)
    disturbance = standard_deviations("disturbance of the observer", disturbance, n)
    noise = standard_deviations("noise of the observer", noise, len(measured), "> 0")
    initial_std = standard_deviations("initial deviation of the observer", initial_std, 2 * n)
    if steady and len(motion.q) > 1:
        allowed = "1, a rest: along a motion the gains of an observer vary"
        raise OutOfRange("rows of the motion of a steady observer", len(motion.q), allowed)
    gains = KalmanGains(
        model=model,
        measured=measured,
        disturbance=process_noise(disturbance, motion.period),
        noise=np.diag(noise) ** 2,
        covariance=np.diag(initial_std) ** 2,
    )
    if steady:
        gains.steady = steady_correction(gains)
    expected_start = None if start is None else np.concatenate(start)
    return ObserverController(controller, gains, crane.effort_limit, delay, expected_start)
