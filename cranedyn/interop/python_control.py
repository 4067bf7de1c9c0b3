"""Linear crane as a system of python-control, and state feedback from python-control as a
controller.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from cranedyn.checks import check_choice, finite, short_repr
from cranedyn.clocks import SAME_PERIOD
from cranedyn.controllers.lqr import linearised
from cranedyn.controllers.tracking import Tracking
from cranedyn.dynamics.converters import Converters, converters_of_run
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.dynamics.linearisation import held_states
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.export.crane_data import input_names, state_names
from cranedyn.export.matlab import linear_system
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


def to_control(
    crane: Crane,
    state: State | None = None,
    *,
    effort: np.ndarray | None = None,
    drive: Drive = "effort",
    control_period: float | None = None,
    dt: float = 5e-4,
    outputs: Sequence[str] | None = None,
    converters: Converters | None = None,
) -> ct.StateSpace:
    """Return the crane linearised about a state as a state-space system with named states, inputs
    and outputs.

    Its variables are deviations from that state and from the command there, in SI units and
    radians. The stretch of a taut inextensible rope is no state.

    Args:
        crane: The crane.
        state: State to linearise about; None for the start.
        effort: Efforts of the drives there, see `cranedyn.export.matlab.linear_system`.
        drive: What the inputs are, see `linear_system`.
        control_period: Period of a sampled system [s]; None for a continuous one.
        dt: Physics step of the sampled system [s].
        outputs: Names of the states that are outputs; None for all of the crane.
        converters: Frequency converters of "velocity"; None for typical ones.

    Raises:
        OutOfRange, UnknownName: As `linear_system`.
    """
    system = linear_system(
        crane,
        state,
        effort=effort,
        drive=drive,
        control_period=control_period,
        dt=dt,
        outputs=outputs,
        converters=converters,
    )
    no_feedthrough = np.zeros((len(system.c), crane.layout.m))
    return ct.ss(
        system.a,
        system.b,
        system.c,
        no_feedthrough,
        dt=system.period,
        name="crane",
        states=system.states,
        inputs=system.inputs,
        outputs=system.outputs,
    )


@dataclass(eq=False)
class StateSpaceController:
    """Controller with states x: u = tracking + c x, after which x becomes a x + b (z - setpoint).

    It starts each run at x = 0.

    Attributes:
        a: Matrix of its states in their next values, shape (k, k).
        b: Matrix of the deviation from the setpoint in these, shape (k, 2 n).
        c: Matrix of its states in the command, shape (m, k).
        tracking: The rest of the command, and the setpoint.
        period: Its control period [s]; None for one without a period of its own, which remembers
            its last commands alone.
        delay: Number of commands on their way to the converters that it feeds back, in control
            periods.
        converters: Converters whose delay that must be; None where `delay` is 0.
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    tracking: Tracking
    period: float | None
    delay: int = 0
    converters: Converters | None = None
    _x: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Begin at x = 0, also where no run is begun."""
        self._x = np.zeros(len(self.a))

    def begin_run(self, t: float, control_period: float) -> None:
        """Return to x = 0.

        Raises:
            OutOfRange: If the control period of the run [s] is another one, or the delay of the
                converters is another number of its control periods than that of the feedback.
        """
        if self.period is not None:
            difference = abs(control_period - self.period)
            if difference > SAME_PERIOD * self.period:
                allowed = f"that of the controller, {self.period:g}"
                raise OutOfRange("control period of the run", control_period, allowed, "s")
        if self.converters is not None:
            steps = self.converters.delay_steps(0.0, control_period)
            if steps != self.delay:
                raise OutOfRange(
                    f"delay of {self.converters.delay:g} s in control periods of "
                    f"{control_period:g} s",
                    steps,
                    f"{self.delay}, the commands on their way that the feedback has gains for; run "
                    "it with the control period that it was designed with",
                )
        self._x = np.zeros(len(self.a))

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return the command of a control instant, shape (m,), and go on to the next one."""
        table = self.tracking.setpoint
        place = locate(t, self.tracking.period, len(table))
        deviation = np.concatenate(state) - interpolate(table, *place)
        x = self._x
        self._x = self.a @ x + self.b @ deviation
        return self.tracking(t, state, setpoint) + self.c @ x


def from_control(
    crane: Crane,
    feedback: object,
    about: State | Motion,
    *,
    drive: Drive = "effort",
    dt: float = 5e-4,
    converters: Converters | None = None,
) -> Tracking | StateSpaceController:
    """Return a feedback designed with python-control as a controller.

    A feedback without states of its own becomes a `Tracking`, which `simulate` and `simulate_batch`
    run compiled, any other one a `StateSpaceController`. Commands on their way to the converters,
    which are states of a sampled plant with ``drive="velocity"``, cannot be measured: a feedback of
    them remembers its own last commands, also one beyond the rate of its drive as it was given.

    Args:
        crane: The crane.
        feedback: One of three: the gain K of u = -K z, with a column for each state of
            `to_control`, as `control.lqr` and `control.dlqr` give it; a state-space system from
            the states of the crane to the commands, whose inputs may be some of the states only if
            it has states of its own; or the controller of `control.create_statefbk_iosystem`.
        about: The rest, or the motion, from which z and u are deviations. The commands there are
            fed forward.
        drive: Outputs of the feedback: "effort", with "motion" the accelerations of the drives, or
            with "velocity" their rates.
        dt: Physics step of the run [s]; a motion's period is a multiple of it.
        converters: Frequency converters of "velocity", those of the plant; None for typical ones.

    Raises:
        OutOfRange: If the feedback is no gain of that shape, or a number in it is not finite; or
            for a rest at which something moves.
        CraneError: If the system has states in continuous time, or does not say how it feeds each
            state back.
    """
    check_choice("drive", drive, Drive)
    converters = converters_of_run(crane, drive, converters)
    names = state_names(crane)
    inputs = input_names(crane, drive)
    if isinstance(about, Motion):
        first_state = State(about.q[0], about.v[0])
    else:
        first_state = crane.layout.as_state("rest", about)
    # The states of `to_control`: all but those that are held, such as the stretch of a rigid rope.
    moving = np.setdiff1d(np.arange(len(names)), held_states(crane, first_state))
    delay = _commands_on_their_way(feedback, len(moving), inputs, drive)
    feedback_names = [names[i] for i in moving]
    # The oldest command first, which is the order of `linear_system`.
    for periods in range(delay, 0, -1):
        feedback_names += [f"{name}_{periods}" for name in inputs]
    law = _matrices(feedback, feedback_names, inputs)
    selection = np.eye(len(names))[moving]
    gain = law.gain[:, : len(moving)] @ selection
    memory = _with_memory(law, len(moving), delay, selection)
    if isinstance(about, Motion):
        tracking = _along(crane, about, gain, drive, dt)
    else:
        tracking = _at_rest(crane, first_state, gain, drive)
    if not len(memory.a):
        return tracking
    elements = [memory.a.ravel(), memory.b.ravel(), memory.c.ravel()]
    finite("matrices of the feedback", np.concatenate(elements), ("k",))
    # A memory of commands alone takes any control period whose delay fits.
    period = float(feedback.dt) if len(law.a) else None  # type: ignore[attr-defined]
    return StateSpaceController(
        memory.a,
        memory.b,
        memory.c,
        tracking,
        period,
        delay,
        converters if delay else None,
    )


def _along(crane: Crane, motion: Motion, gain: np.ndarray, drive: Drive, dt: float) -> Tracking:
    """Return the feedback of a gain about a motion, whose commands are fed forward."""
    table = linearised(crane, motion, dt=dt, every=len(motion.q))
    if drive == "effort":
        commands = table.efforts
    elif drive == "motion":
        commands = motion.a[:, motion.drives]
    else:
        commands = motion.v[:, motion.drives]
    gains = np.broadcast_to(gain, (len(commands), *gain.shape))
    return Tracking(motion.period, commands, gains, table.setpoint)


def _at_rest(crane: Crane, rest: State, gain: np.ndarray, drive: Drive) -> Tracking:
    """Return the feedback of a gain about a rest, whose command is fed forward.

    Raises:
        OutOfRange: If something moves there.
    """
    if rest.v.any():
        allowed = "0; a motion is given as a Motion"
        raise OutOfRange("rates of the rest", rest.v.tolist(), allowed, "/s")
    command = np.zeros(crane.layout.m)
    if drive == "effort":
        command = holding_effort(crane, rest.q)
    any_period = 1.0  # of a table of one row
    return Tracking(any_period, command[None], gain[None], np.concatenate(rest)[None])


class _Law(NamedTuple):
    """A feedback u = c x - gain z, after which x becomes a x + b z.

    Attributes:
        a: Shape (k, k).
        b: Shape (k, z).
        c: Shape (m, k).
        gain: Shape (m, z).
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    gain: np.ndarray


class _Memory(NamedTuple):
    """What a feedback remembers, x: it adds c x to the command, and x becomes a x + b z.

    Attributes:
        a: Shape (k, k).
        b: Shape (k, 2 n).
        c: Shape (m, k).
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray


def _commands_on_their_way(feedback: Any, states: int, inputs: Sequence[str], drive: Drive) -> int:
    """Return for how many commands of each drive on their way a feedback has gains.

    Args:
        feedback: The gain or the system.
        states: Number of the states of the crane that it may feed back.
        inputs: Names of the commands.
        drive: What the commands are; only rates take time on their way.
    """
    if drive != "velocity":
        return 0
    if isinstance(feedback, ct.InputOutputSystem):
        # By name; create_statefbk_iosystem has them beside others.
        delay = 0
        while f"{inputs[0]}_{delay + 1}" in feedback.input_labels:
            delay += 1
        return delay
    shape = np.shape(feedback)
    further = shape[1] - states if len(shape) == 2 else 0
    return further // len(inputs) if further > 0 and further % len(inputs) == 0 else 0


def _with_memory(law: _Law, states: int, delay: int, selection: np.ndarray) -> _Memory:
    """Return the memory of a feedback that remembers its last commands, as far as it feeds them
    back.

    With the commands p on their way, the oldest first, and the last columns of b and of the gain
    for them, u = c x - K z - K_p p. Then x becomes a x + b z + b_p p, and p moves on by one with u
    at its end.

    Args:
        law: The feedback, of the states and the commands on their way.
        states: Number of the states among its columns.
        delay: Number of control periods for which a command is on its way.
        selection: The states among coordinates and rates, shape (states, 2 n).
    """
    if not delay:
        return _Memory(law.a, law.b @ selection, law.c)
    m = law.gain.shape[0]
    k = len(law.a)
    from_states = law.b[:, :states]
    from_memory = law.b[:, states:]
    gain_of_states = law.gain[:, :states]
    gain_of_memory = law.gain[:, states:]
    moved_on = np.eye(m * delay, k=m)
    newest = np.zeros((m * delay, m))
    newest[-m:] = np.eye(m)
    a = np.block([[law.a, from_memory], [newest @ law.c, moved_on - newest @ gain_of_memory]])
    b = np.vstack([from_states, -newest @ gain_of_states]) @ selection
    return _Memory(a, b, np.hstack([law.c.reshape(m, k), -gain_of_memory]))


def _matrices(feedback: Any, names: Sequence[str], commands: Sequence[str]) -> _Law:
    """Return a feedback of the states of these names that gives these commands.

    Args:
        feedback: A gain, or a system of python-control.
        names: Names of the states that it may feed back.
        commands: Names of the commands.

    Raises:
        OutOfRange: If it is neither, or a gain of another shape or not finite.
        CraneError: If the system has other outputs or inputs, or states in continuous time.
    """
    if not isinstance(feedback, ct.InputOutputSystem):
        return _gain_matrices(feedback, names, commands)
    if not isinstance(feedback, ct.StateSpace):
        raise CraneError(
            f"The feedback is a {type(feedback).__name__}; allowed is a StateSpace from states of "
            "the crane to the commands of its drives, such as control.ss makes of it."
        )
    m = len(commands)
    if feedback.noutputs != m:
        raise CraneError(
            f"The feedback has {feedback.noutputs} outputs ({', '.join(feedback.output_labels)}); "
            f"it needs one for each drive: {', '.join(commands)}. A filter of one signal, such as "
            "a notch, is put in series with a gain of all drives first."
        )
    k = feedback.nstates
    if k and (feedback.dt is True or not feedback.dt):
        raise CraneError(
            f"The feedback has {k} states in continuous time or without a period; "
            "control.sample_system makes it one of the control period."
        )
    by_state = _by_state(feedback, names)
    gain = finite("gain of the feedback", -by_state[k:], (m, len(names)))
    return _Law(feedback.A, by_state[:k], feedback.C.reshape(m, k), gain)


def _gain_matrices(gain: Any, names: Sequence[str], commands: Sequence[str]) -> _Law:
    """Return a feedback of a gain, which has no states of its own, see `_matrices`."""
    states = len(names)
    m = len(commands)
    try:
        gain = np.asarray(gain, dtype=float)
    except (TypeError, ValueError):
        allowed = "a gain or a system of python-control"
        raise OutOfRange("feedback", short_repr(gain), allowed) from None
    columns_meaning = (
        f"of {m} rows and {states} columns, a row for each command ({', '.join(commands)}) and a "
        f"column for each state ({', '.join(names)})"
    )
    gain = finite("gain of the feedback", gain, (m, states), meaning=columns_meaning)
    return _Law(np.zeros((0, 0)), np.zeros((0, states)), np.zeros((m, 0)), gain)


def _by_state(feedback: Any, names: Sequence[str]) -> np.ndarray:
    """Return the matrix from the states of the crane to the next states of a system and then its
    commands, shape (k + m, states).

    Inputs without any of these names are taken in their order. Further inputs must be those of
    `control.create_statefbk_iosystem`: the desired states and commands, from which the states are
    subtracted and to which the commands are added.

    Args:
        feedback: The system, of k states.
        names: Names of the states of the crane.

    Raises:
        CraneError: If a gain lacks a state, or there are other inputs.
    """
    k = feedback.nstates
    labels = list(feedback.input_labels)
    # Rows: the next states, then the commands. Columns: the inputs of the system.
    output = np.vstack([feedback.B, feedback.D])
    is_positional = len(labels) == len(names) and not set(labels) & set(names)
    columns = {name: i for i, name in enumerate(names if is_positional else labels)}
    lacking = [name for name in names if name not in columns]
    if lacking and not k:
        raise CraneError(
            f"The feedback has no input {lacking[0]}; its inputs are to be {', '.join(names)}."
        )
    by_state = np.zeros((len(output), len(names)))
    for i, name in enumerate(names):
        if name in columns:
            by_state[:, i] = output[:, columns[name]]
    further = output[:, [i for name, i in columns.items() if name not in names]]
    # Columns of the desired states, which are subtracted, and of the desired commands, which are
    # added.
    desired = np.hstack([-by_state, np.eye(len(output))[:, k:]])
    if further.size and not np.array_equal(further, desired):
        raise CraneError(
            f"The feedback has {further.shape[1]} inputs besides the states; allowed are the "
            "desired states and inputs of control.create_statefbk_iosystem, or none."
        )
    return by_state
