"""Linear crane as a system of python-control, and state feedback from python-control as a
controller.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from cranedyn.checks import check_choice, finite, short_repr
from cranedyn.controllers.linear import (
    AntiWindup,
    LinearController,
    SetpointSource,
    linear_controller,
)
from cranedyn.controllers.tracking import Tracking
from cranedyn.dynamics.converters import Converters
from cranedyn.dynamics.linearisation import held_states
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.export.matlab import linear_system
from cranedyn.interfaces import Drive, State
from cranedyn.model.crane import Crane
from cranedyn.model.signals import input_names, state_names
from cranedyn.references.motion import Motion

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


def from_control(
    crane: Crane,
    feedback: object,
    about: State | Motion,
    *,
    drive: Drive = "effort",
    setpoint: SetpointSource = "rest",
    anti_windup: AntiWindup = None,
    dt: float = 5e-4,
    converters: Converters | None = None,
) -> Tracking | LinearController:
    """Return a feedback designed with python-control as a controller.

    A feedback without states of its own becomes a `Tracking`, any other one a `LinearController`.
    Commands on their way to the converters, which are states of a sampled plant with
    ``drive="velocity"``, cannot be measured: a feedback of them remembers its own last commands.

    Args:
        crane: The crane.
        feedback: One of three: the gain K of u = -K z, with a column for each state of
            `to_control`, as `control.lqr` and `control.dlqr` give it; a state-space system from
            the states of the crane to the commands, whose inputs may be some of the states only if
            it has states of its own; or the controller of `control.create_statefbk_iosystem`.
            Outputs with the names of some commands command these drives, and the others are held,
            see `linear_controller`.
        about: The rest, or the motion, from which z and u are deviations. The commands there are
            fed forward.
        drive: Outputs of the feedback: "effort", with "motion" the accelerations of the drives, or
            with "velocity" their rates.
        setpoint: Positions of the drives about which it acts, see `linear_controller`.
        anti_windup: What the states of the feedback know about the limits of the drives, see
            `linear_controller`; None for nothing. Without it a command on its way is remembered as
            it was given, also beyond the rate of its drive.
        dt: Physics step of the run [s]; a motion's period is a multiple of it.
        converters: Frequency converters of "velocity", those of the plant; None for typical ones.

    Raises:
        OutOfRange: If the feedback is no gain of that shape, or a number in it is not finite; or
            for a rest at which something moves.
        CraneError: If the system has states in continuous time, or does not say how it feeds each
            state back.
    """
    check_choice("drive", drive, Drive)
    names = state_names(crane)
    commands = input_names(crane, drive)
    if isinstance(about, Motion):
        first_state = State(about.q[0], about.v[0])
    else:
        first_state = crane.layout.as_state("rest", about)
    # The states of `to_control`: all but those that are held, such as the stretch of a rigid rope.
    held = held_states(crane, first_state)
    feedback_names = [name for i, name in enumerate(names) if i not in held]
    delay = _commands_on_their_way(feedback, feedback_names, commands, drive)
    # The oldest command first, which is the order of `linear_system`.
    for periods in range(delay, 0, -1):
        feedback_names += [f"{name}_{periods}" for name in commands]
    law = _matrices(feedback, feedback_names, commands)
    controller = linear_controller(
        crane,
        law.a,
        law.b,
        law.c,
        -law.gain,
        about=about,
        inputs=feedback_names,
        outputs=law.outputs,
        period=float(feedback.dt) if len(law.a) else None,  # type: ignore[attr-defined]
        anti_windup=anti_windup,
        setpoint=setpoint,
        drive=drive,
        dt=dt,
        converters=converters,
    )
    if len(controller.states) or setpoint == "run":
        return controller
    return controller.tracking


class _Law(NamedTuple):
    """A feedback u = c x - gain z, after which x becomes a x + b z.

    Attributes:
        a: Shape (k, k).
        b: Shape (k, z).
        c: Shape (outputs, k).
        gain: Shape (outputs, z).
        outputs: Names of the commands u, shape (outputs,).
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    gain: np.ndarray
    outputs: Sequence[str]


def _commands_on_their_way(
    feedback: Any, states: Sequence[str], commands: Sequence[str], drive: Drive
) -> int:
    """Return for how many commands of each drive on their way a feedback has gains.

    Args:
        feedback: The gain or the system.
        states: Names of the states of the crane that it may feed back.
        commands: Names of the commands.
        drive: What the commands are; only rates take time on their way.
    """
    if drive != "velocity":
        return 0
    if isinstance(feedback, ct.InputOutputSystem) and set(feedback.input_labels) & set(states):
        # By name; create_statefbk_iosystem has them beside others.
        delay = 0
        while any(f"{name}_{delay + 1}" in feedback.input_labels for name in commands):
            delay += 1
        return delay
    if isinstance(feedback, ct.InputOutputSystem):
        columns = feedback.ninputs
    else:
        shape = np.shape(feedback)
        columns = shape[1] if len(shape) == 2 else 0
    further = columns - len(states)
    return further // len(commands) if further > 0 and further % len(commands) == 0 else 0


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
    # By name where all outputs are named after commands, else in the order of the drives.
    outputs = list(feedback.output_labels)
    if not set(outputs) <= set(commands):
        if len(outputs) != len(commands):
            raise CraneError(
                f"The feedback has {len(outputs)} outputs ({', '.join(outputs)}); it needs one for "
                f"each drive: {', '.join(commands)}. A filter of one signal, such as a notch, is "
                "put in series with a gain first; outputs with the names of some of these commands "
                "leave the other drives held."
            )
        outputs = list(commands)
    k = feedback.nstates
    if k and (feedback.dt is True or not feedback.dt):
        raise CraneError(
            f"The feedback has {k} states in continuous time or without a period; "
            "control.sample_system makes it one of the control period."
        )
    by_state = _by_state(feedback, names, in_full=len(outputs) == len(commands))
    gain = finite("gain of the feedback", -by_state[k:], (len(outputs), len(names)))
    matrices = [feedback.A.ravel(), by_state[:k].ravel(), feedback.C.ravel()]
    finite("matrices of the feedback", np.concatenate(matrices), ("k",))
    return _Law(feedback.A, by_state[:k], feedback.C.reshape(len(outputs), k), gain, outputs)


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
    return _Law(np.zeros((0, 0)), np.zeros((0, states)), np.zeros((m, 0)), gain, commands)


def _by_state(feedback: Any, names: Sequence[str], *, in_full: bool) -> np.ndarray:
    """Return the matrix from the states of the crane to the next states of a system and then its
    commands, shape (k + outputs, states).

    Inputs without any of these names are taken in their order. Further inputs must be those of
    `control.create_statefbk_iosystem`: the desired states and commands, from which the states are
    subtracted and to which the commands are added.

    Args:
        feedback: The system, of k states.
        names: Names of the states of the crane.
        in_full: Whether it commands all drives; a gain of all drives has all states as inputs.

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
    if lacking and not k and in_full:
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
