"""No swing sensor: a Kalman filter sees the swing in how the drives, whose efforts are known, move.

The load pulls at trolley, jib and hoist. What that pull does is in the model; so the swing is
observable from the drives alone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module

import numpy as np

from cranedyn.checks import ShortRepr, number, whole
from cranedyn.clocks import SAME_PERIOD
from cranedyn.controllers.linearised import Linearised, linearised
from cranedyn.controllers.sensed import noise_of
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.interfaces import Controller, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.references.motion import Motion

DISTURBANCE = {
    ("revolute", True): 2e-3,
    ("prismatic", True): 0.2,
    ("revolute", False): 0.1,
    ("prismatic", False): 0.1,
}
"""Standard deviations of accelerations that the model does not know [rad/s² or m/s²], white from
one control instant to the next, by kind of joint and whether it is driven; ours. For the drives of
the tower crane they are about 2 kN m, 100 N and 200 N."""

INITIAL_STD = {
    ("revolute", True): 1e-3,
    ("prismatic", True): 0.01,
    ("revolute", False): 0.1,
    ("prismatic", False): 0.1,
}
"""Standard deviations of coordinates and of rates at the start, likewise, ours: the load may swing
by 0.1 rad."""


def disturbance_of(crane: Crane) -> np.ndarray:
    """Standard deviations of the accelerations that the model does not know, shape (n,)."""
    return _each(crane, DISTURBANCE)


def initial_std_of(crane: Crane) -> np.ndarray:
    """Standard deviations of coordinates and rates at the start, shape (2 n,)."""
    return np.tile(_each(crane, INITIAL_STD), 2)


def _each(crane: Crane, table: Mapping[tuple[str, bool], float]) -> np.ndarray:
    """A number for each joint, shape (n,); a joint that a spring holds is as quiet as one that a
    drive holds.
    """
    elastic = crane.springs.stiffness > 0.0
    return np.array(
        [
            table[joint.kind, joint.driven or bool(held)]
            for joint, held in zip(crane.layout.joints, elastic, strict=True)
        ]
    )


def kalman_gain(seen: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Gain of a correction, shape (unknowns, measured).

    Args:
        seen: Covariance of what is measured with the unknowns, shape (measured, unknowns).
        spread: Covariance of what is measured, noise included, shape (measured, measured).

    Raises:
        CraneError: If that is not positive definite.
    """
    # LAPACK itself: for so few numbers NumPy's way there takes longer than the solution
    from scipy.linalg.lapack import dposv

    _, solution, failed = dposv(spread, seen)
    if failed:
        raise CraneError("What the observer believes of its errors is no covariance any more.")
    return solution.T


def load_lapack() -> None:
    """Have SciPy's at hand when an observer is made: it takes some tenths of a second to come,
    which no control instant has, and who observes nothing need not wait for it.
    """
    import_module("scipy.linalg.lapack")


@dataclass(eq=False, repr=False)
class Observed(ShortRepr):
    """A controller that is told an estimate of the state. It remembers: make a new one for each
    run.

    Predictor and corrector of Kalman (1960) for the deviation from the motion; the covariance is
    kept in Joseph's form.

    Attributes:
        controller: What acts on the estimate.
        model: The crane along the motion.
        measured: Where positions and rates of the drives stand among coordinates and rates, shape
            (2 m,).
        effort_limit: What the drives give at most [N m or N], shape (m,).
        disturbance: Covariance added in each control period, shape (2 n, 2 n).
        noise: Covariance of the measurements, shape (2 m, 2 m).
        covariance: Of the estimate's error, shape (2 n, 2 n).
        delay: How many control periods the measurements are late.
        start: Where it is believed to start, shape (2 n,); None for where the motion is.
        estimate: The state as last estimated, None before the first call.
        gain: That of the last correction, shape (2 n, 2 m).

    What it has commanded since the last measurement was true waits in a queue, by row of the motion
    and effort beyond the feed-forward.
    """

    controller: Controller
    model: Linearised
    measured: np.ndarray
    effort_limit: np.ndarray
    disturbance: np.ndarray
    noise: np.ndarray
    covariance: np.ndarray
    delay: int = 0
    start: np.ndarray | None = None
    estimate: State | None = None
    gain: np.ndarray = field(init=False)
    _t: float = 0.0
    _deviation: np.ndarray = field(init=False)
    _since: deque[tuple[int, np.ndarray]] = field(default_factory=deque)
    _identity: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        """Begin without deviation and correction."""
        load_lapack()
        self._identity = np.eye(len(self.covariance))
        self.gain, self._deviation = (
            np.zeros((len(self.covariance), len(self.measured))),
            np.zeros(len(self.covariance)),
        )

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """What the controller commands, shape (m,); of the state it looks at the drives only.

        Raises:
            CraneError: If it is not called once in each period of the motion, at the time of a row.
        """
        row = self.model.row(t)
        if self.estimate is None:
            self._at_row(t)
            self._deviation = (
                np.zeros(len(self.covariance))
                if self.start is None
                else self.start - self.model.setpoint[row]
            )
            self._correct(row, state)
        else:
            self._expect(t)
            if len(self._since) > self.delay:
                self._predict()
                self._correct(self._since[0][0] if self._since else row, state)
        deviation = self._deviation
        for then, correction in self._since:
            deviation = self._stepped(deviation, then, correction)
        self.estimate = State(*(self.model.setpoint[row] + deviation).reshape(2, -1))
        command = np.asarray(self.controller(t, self.estimate, setpoint), dtype=float)
        self._since.append(
            (row, command.clip(-self.effort_limit, self.effort_limit) - self.model.efforts[row])
        )
        self._t = t
        return command

    def _at_row(self, t: float) -> None:
        rows = t / self.model.period
        if rows < len(self.model.setpoint) - 1 and abs(rows - round(rows)) > SAME_PERIOD:
            raise CraneError(
                f"This observer is first asked for t = {t:g} s; its motion has rows every "
                f"{self.model.period:g} s only."
            )

    def _expect(self, t: float) -> None:
        if abs(t - self._t - self.model.period) > 1e-6 * self.model.period:
            raise CraneError(
                f"This observer has seen t = {self._t:g} s and is asked for t = {t:g} s; it needs "
                f"a call every {self.model.period:g} s, "
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
        which = self.measured
        measured = np.concatenate(state)[which] - self.model.setpoint[row, which]
        seen = self.covariance[which]
        self.gain = kalman_gain(seen, seen[:, which] + self.noise)
        self._deviation = self._deviation + self.gain @ (measured - self._deviation[which])
        left = self._identity - self.gain @ self._identity[which]
        self.covariance = left @ self.covariance @ left.T + self.gain @ self.noise @ self.gain.T


def observed(
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
) -> Observed:
    """Let a controller that wants the whole state work with sensors on the drives alone; one for
    each run.

    Args:
        controller: The controller.
        crane: The crane that the filter believes in.
        motion: What the model is linearised about; its period is the control period.
        dt: Physics step of the simulation [s].
        disturbance: Standard deviations of the accelerations that the model does not know, shape
            (n,); more makes the filter trust its measurements more. None for `disturbance_of`.
        noise: Standard deviations of the measured drives [rad or m] and their rates [per second],
            shape (2 m,); None for `noise_of`.
        delay: How many control periods the measurements are late, as in `sensed`; the estimate is
            predicted on over this time.
        start: Where it is believed to start; by default where the motion is, the load plumb.
        initial_std: Standard deviations of that belief in coordinates and rates, shape (2 n,); None
            for `initial_std_of`.
        every: Control instants between linearisations.

    Raises:
        OutOfRange: If a standard deviation is negative or not finite, that of a measurement not
            positive, their number not as asked, or the delay not a whole number from 0 on.
    """
    late = whole("delay of the observer", delay, 0, "control periods")
    period, layout = motion.period, crane.layout
    n, measured = layout.n, layout.measured
    disturbance = disturbance_of(crane) if disturbance is None else disturbance
    noise = noise_of(crane)[measured] if noise is None else noise
    initial_std = initial_std_of(crane) if initial_std is None else initial_std
    reach = np.vstack([np.eye(n) * period**2 / 2.0, np.eye(n) * period])
    return Observed(
        controller,
        linearised(crane, motion, dt=dt, every=every),
        measured,
        crane.effort_limit,
        reach @ _covariance("disturbance of the observer", disturbance, n) @ reach.T,
        _covariance("noise of the observer", noise, len(measured), "> 0"),
        _covariance("initial deviation of the observer", initial_std, 2 * n),
        late,
        None if start is None else np.concatenate(start),
    )


def _covariance(
    name: str, deviations: Sequence[float] | np.ndarray, count: int, allowed: str = ">= 0"
) -> np.ndarray:
    given = [
        number(name, part, allowed=allowed) for part in np.asarray(deviations, dtype=object).ravel()
    ]
    if len(given) != count:
        raise OutOfRange(name, deviations, f"{count} standard deviations")
    return np.diag(given) ** 2
