"""No swing sensor: a Kalman filter sees the swing in how the drives, whose efforts are known, move.

The load pulls at trolley, jib and hoist. What that pull does is in the model; so the swing is observable from the drives alone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from cranedyn.arguments import checked
from cranedyn.controllers.linearised import Linearised, linearised
from cranedyn.controllers.sensed import NOISE
from cranedyn.errors import CraneError, OutOfRange, number, whole
from cranedyn.interfaces import Controller, Setpoint, State
from cranedyn.model.crane import DRIVES, Crane
from cranedyn.references.motion import Motion
from cranedyn.simulation.clocks import SAME_PERIOD

MEASURED = np.concatenate([DRIVES, 5 + DRIVES])
"""What is measured of coordinates and rates: γ, x, l and their rates."""

DISTURBANCE = (2e-3, 0.2, 0.1, 0.1, 0.2)
"""Standard deviations of γ̈ [rad/s²], ẍ [m/s²], φ̈, θ̈ [rad/s²], l̈ [m/s²] that the model does not know, white from one control instant to
the next; ours. For the drives they are about 2 kN m, 100 N and 200 N."""

INITIAL_STD = (1e-3, 0.01, 0.1, 0.1, 0.01, 1e-3, 0.01, 0.1, 0.1, 0.01)
"""Standard deviations of coordinates and rates at the start, ours: the load may swing by 0.1 rad."""


@dataclass(eq=False)
class Observed:
    """A controller that is told an estimate of the state. It remembers: make a new one for each run.

    Predictor and corrector of Kalman (1960) for the deviation from the motion; the covariance is kept in Joseph's form.

    Attributes:
        controller: What acts on the estimate.
        model: The crane along the motion.
        effort_limit: What the drives give at most [N m, N, N], shape (3,).
        disturbance: Covariance added in each control period, shape (10, 10).
        noise: Covariance of the six measurements, shape (6, 6).
        covariance: Of the estimate's error, shape (10, 10).
        delay: How many control periods the measurements are late.
        start: Where it is believed to start, shape (10,); None for where the motion is.
        estimate: The state as last estimated, None before the first call.
        gain: That of the last correction, shape (10, 6).

    What it has commanded since the last measurement was true waits in a queue, by row of the motion and effort beyond the feed-forward.
    """

    controller: Controller
    model: Linearised
    effort_limit: np.ndarray
    disturbance: np.ndarray
    noise: np.ndarray
    covariance: np.ndarray
    delay: int = 0
    start: np.ndarray | None = None
    estimate: State | None = None
    gain: np.ndarray = field(default_factory=lambda: np.zeros((10, 6)))
    _t: float = 0.0
    _deviation: np.ndarray = field(default_factory=lambda: np.zeros(10))
    _since: deque[tuple[int, np.ndarray]] = field(default_factory=deque)

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """What the controller commands, shape (3,); of the state it looks at the drives only.

        Raises:
            CraneError: If it is not called once in each period of the motion, at the time of a row.
        """
        row = self.model.row(t)
        if self.estimate is None:
            self._at_row(t)
            self._deviation = np.zeros(10) if self.start is None else self.start - self.model.setpoint[row]
            self._correct(row, state)
        else:
            self._expect(t)
            if len(self._since) > self.delay:
                self._predict()
                self._correct(self._since[0][0] if self._since else row, state)
        deviation = self._deviation
        for then, correction in self._since:
            deviation = self._stepped(deviation, then, correction)
        self.estimate = State(*(self.model.setpoint[row] + deviation).reshape(2, 5))
        command = np.asarray(self.controller(t, self.estimate, setpoint), dtype=float)
        self._since.append((row, command.clip(-self.effort_limit, self.effort_limit) - self.model.efforts[row]))
        self._t = t
        return command

    def _at_row(self, t: float) -> None:
        rows = t / self.model.period
        if rows < len(self.model.setpoint) - 1 and abs(rows - round(rows)) > SAME_PERIOD:
            raise CraneError(f"This observer is first asked for t = {t:g} s; its motion has rows every {self.model.period:g} s only.")

    def _expect(self, t: float) -> None:
        if abs(t - self._t - self.model.period) > 1e-6 * self.model.period:
            raise CraneError(
                f"This observer has seen t = {self._t:g} s and is asked for t = {t:g} s; it needs a call every {self.model.period:g} s, "
                "and a new one for each run."
            )

    def _predict(self) -> None:
        row, correction = self._since.popleft()
        a = self.model.a[self.model.stretch[row]]
        self._deviation = self._stepped(self._deviation, row, correction)
        self.covariance = a @ self.covariance @ a.T + self.disturbance

    def _stepped(self, deviation: np.ndarray, row: int, correction: np.ndarray) -> np.ndarray:
        k = self.model.stretch[row]
        return self.model.a[k] @ deviation + self.model.b[k] @ correction

    def _correct(self, row: int, state: State) -> None:
        measured = np.concatenate(state)[MEASURED] - self.model.setpoint[row, MEASURED]
        seen = self.covariance[MEASURED]
        self.gain = np.linalg.solve(seen[:, MEASURED] + self.noise, seen).T
        self._deviation = self._deviation + self.gain @ (measured - self._deviation[MEASURED])
        left = np.eye(10)
        left[:, MEASURED] -= self.gain
        self.covariance = left @ self.covariance @ left.T + self.gain @ self.noise @ self.gain.T


@checked
def observed(
    controller: Controller,
    crane: Crane,
    motion: Motion,
    *,
    dt: float = 5e-4,
    disturbance: Sequence[float] | np.ndarray = DISTURBANCE,
    noise: Sequence[float] | np.ndarray = NOISE[MEASURED],
    delay: int = 0,
    start: State | None = None,
    initial_std: Sequence[float] | np.ndarray = INITIAL_STD,
    every: int = 10,
) -> Observed:
    """Let a controller that wants the whole state work with sensors on the drives alone; one for each run.

    Args:
        controller: The controller.
        crane: The crane that the filter believes in.
        motion: What the model is linearised about; its period is the control period.
        dt: Physics step of the simulation [s].
        disturbance: Standard deviations of the accelerations that the model does not know, shape (5,); more makes the filter trust its
            measurements more.
        noise: Standard deviations of the measured γ, x, l [rad, m, m] and their rates [per second], shape (6,).
        delay: How many control periods the measurements are late, as in `sensed`; the estimate is predicted on over this time.
        start: Where it is believed to start; by default where the motion is, the load plumb.
        initial_std: Standard deviations of that belief in coordinates and rates, shape (10,).
        every: Control instants between linearisations.

    Raises:
        OutOfRange: If a standard deviation is negative or not finite, that of a measurement not positive, their number not as asked, or the
            delay not a whole number from 0 on.
    """
    late = whole("delay of the observer", delay, 0, "control periods")
    period = motion.period
    reach = np.vstack([np.eye(5) * period**2 / 2.0, np.eye(5) * period])
    return Observed(
        controller,
        linearised(crane, motion, dt=dt, every=every),
        crane.effort_limit,
        reach @ _covariance("disturbance of the observer", disturbance, 5) @ reach.T,
        _covariance("noise of the observer", noise, 6, "> 0"),
        _covariance("initial deviation of the observer", initial_std, 10),
        late,
        None if start is None else np.concatenate(start),
    )


def _covariance(name: str, deviations: Sequence[float] | np.ndarray, count: int, allowed: str = ">= 0") -> np.ndarray:
    given = [number(name, part, allowed=allowed) for part in np.asarray(deviations, dtype=object).ravel()]
    if len(given) != count:
        raise OutOfRange(name, deviations, f"{count} standard deviations")
    return np.diag(given) ** 2
