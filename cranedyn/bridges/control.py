"""Linear crane as a system of python-control, and state feedback from python-control as a
controller.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cranedyn.bridges.joints import state_names
from cranedyn.bridges.matlab import linear_system
from cranedyn.checks import check_choice, finite, short_repr
from cranedyn.clocks import SAME_PERIOD
from cranedyn.controllers.lqr import linearised
from cranedyn.controllers.tracking import Tracking
from cranedyn.dynamics.linearisation import held_states
from cranedyn.dynamics.pinocchio import holding_effort
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.interfaces import Drive, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.references.motion import Motion
from cranedyn.references.tabulated import interpolate, locate

try:
    import control as ct
except ModuleNotFoundError as error:
    raise CraneError(
        "This bridge needs python-control, which is not installed: pip install 'cranedyn[control]'."
    ) from error


def to_control(crane: Crane, state: State | None = None, **options: Any) -> ct.StateSpace:
    """Return the crane linearised about a state as a state-space system with named states, inputs
    and outputs.

    Its variables are deviations from that state and from the command there, in SI units and
    radians. The stretch of a taut inextensible rope is no state.

    Args:
        crane: The crane.
        state: State to linearise about; None for the start.
        options: As `cranedyn.bridges.matlab.linear_system` takes them: effort, drive,
            control_period, dt, outputs, converters.

    Raises:
        OutOfRange, UnknownName: As `linear_system`.
    """
    system = linear_system(crane, state, **options)
    names = {kind: getattr(system, kind) for kind in ("states", "inputs", "outputs")}
    matrices = system.a, system.b, system.c, np.zeros((len(system.c), crane.layout.m))
    return ct.ss(*matrices, dt=system.period, name="crane", **names)


@dataclass(eq=False)
class StateSpaceController:
    """Controller with states x: u = tracking + c x, then x becomes a x + b (z - setpoint). It
    starts each run at x = 0.

    Attributes:
        a, b, c: Shapes (k, k), (k, 2 n) and (m, k).
        tracking: The rest of the command, and the setpoint.
        period: Its control period [s].
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    tracking: Tracking
    period: float
    _x: np.ndarray | float = 0.0

    def begin_run(self, t: float, control_period: float) -> None:
        """Return to x = 0.

        Raises:
            OutOfRange: If the control period of the run [s] is another one.
        """
        if abs(control_period - self.period) > SAME_PERIOD * self.period:
            allowed = f"that of the controller, {self.period:g}"
            raise OutOfRange("control period of the run", control_period, allowed, "s")
        self._x = 0.0

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return the command of a control instant, shape (m,), and go on to the next one."""
        table = self.tracking.setpoint
        deviation = np.concatenate(state) - interpolate(
            table, *locate(t, self.tracking.period, len(table))
        )
        x = self._x + np.zeros(len(self.a))
        self._x = self.a @ x + self.b @ deviation
        return self.tracking(t, state, setpoint) + self.c @ x


def from_control(
    crane: Crane,
    feedback: object,
    about: State | Motion,
    *,
    drive: Drive = "effort",
    dt: float = 5e-4,
) -> Tracking | StateSpaceController:
    """Return a feedback designed with python-control as a controller.

    Without states of its own it is a `Tracking`, which `simulate` and `simulate_batch` run
    compiled.

    Args:
        crane: The crane.
        feedback: The gain K of u = -K z, one column for each state of `to_control`, as
            `control.lqr` and `control.dlqr` give it; or a system from states of the crane, all or
            with states of its own some, to the commands; or the controller of
            `control.create_statefbk_iosystem`.
        about: The rest, or the motion, from which z and u are deviations. The commands there are
            fed forward.
        drive: Outputs of the feedback: "effort", with "motion" the accelerations of the drives, or
            with "velocity" their rates.
        dt: Physics step of the run [s]; a motion's period is a multiple of it.

    Raises:
        OutOfRange: If the feedback is no gain of that shape, or a number in it is not finite; or
            for a rest at which something moves.
        CraneError: If the system has states in continuous time, or does not say how it feeds each
            state back.
    """
    check_choice("drive", drive, Drive)
    names, m = state_names(crane), crane.layout.m
    if isinstance(about, Motion):
        at = State(about.q[0], about.v[0])
    else:
        at = crane.layout.as_state("rest", about)
    moving = np.setdiff1d(np.arange(len(names)), held_states(crane, at))
    a, b, c, gain = _matrices(feedback, [names[i] for i in moving])
    selection = np.eye(len(names))[moving]
    b, gain = b @ selection, finite("gain", gain, (m, len(moving))) @ selection
    if isinstance(about, Motion):
        table = linearised(crane, about, dt=dt, every=len(about.q))
        rates = {"motion": about.a, "velocity": about.v}
        commands = table.efforts if drive == "effort" else rates[drive][:, about.drives]
        gains = np.broadcast_to(gain, (len(commands), *gain.shape))
        tracking = Tracking(about.period, commands, gains, table.setpoint)
    else:
        if at.v.any():
            allowed = "0; a motion is given as a Motion"
            raise OutOfRange("rates of the rest", at.v.tolist(), allowed, "/s")
        command = holding_effort(crane, at.q) if drive == "effort" else np.zeros(m)
        tracking = Tracking(1.0, command[None], gain[None], np.concatenate(at)[None])
    if not len(a):
        return tracking
    finite("matrices of the feedback", np.concatenate([a.ravel(), b.ravel(), c.ravel()]), ("k",))
    return StateSpaceController(a, b, c, tracking, float(feedback.dt))  # type: ignore[attr-defined]


def _matrices(
    feedback: Any, names: Sequence[str]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return a, b, c and K of x after a period = a x + b z and u = c x - K z."""
    nz = len(names)
    if not isinstance(feedback, ct.InputOutputSystem):
        try:
            gain = np.asarray(feedback, dtype=float)
        except (TypeError, ValueError):
            allowed = "a gain or a system of python-control"
            raise OutOfRange("feedback", short_repr(feedback), allowed) from None
        return np.zeros((0, 0)), np.zeros((0, nz)), np.zeros((0, 0)), gain
    if not isinstance(feedback, ct.StateSpace):
        raise CraneError(f"The feedback is a {type(feedback).__name__}; allowed is a StateSpace.")
    k, labels = feedback.nstates, list(feedback.input_labels)
    if k and (feedback.dt is True or not feedback.dt):
        raise CraneError(
            f"The feedback has {k} states in continuous time or without a period; "
            "control.sample_system makes it one of the control period."
        )
    output = np.vstack([feedback.B, feedback.D])  # of the next states and of the commands
    positional = len(labels) == nz and not set(labels) & set(names)
    columns = {name: i for i, name in enumerate(names if positional else labels)}
    if lacking := [name for name in names if name not in columns and not k]:
        raise CraneError(
            f"The feedback has no input {lacking[0]}; its inputs are to be {', '.join(names)}."
        )
    fed = [name for name in names if name in columns]
    by_state = np.zeros((len(output), nz))
    by_state[:, [names.index(name) for name in fed]] = output[:, [columns[n] for n in fed]]
    further = output[:, [i for name, i in columns.items() if name not in names]]
    desired = np.hstack([-by_state, np.eye(len(output))[:, k:]])
    if further.size and not np.array_equal(further, desired):
        raise CraneError(
            f"The feedback has {further.shape[1]} inputs besides the states; allowed are the "
            "desired states and inputs of control.create_statefbk_iosystem, or none."
        )
    return feedback.A, by_state[:k], feedback.C, -by_state[k:]
