"""Linear crane as a system of python-control, and state feedback from python-control as a
controller.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cranedyn.bridges.joints import input_names, state_names
from cranedyn.checks import check_choice, finite, short_repr
from cranedyn.controllers.lqr import linearised
from cranedyn.controllers.tracking import Tracking
from cranedyn.dynamics.linearisation import linear
from cranedyn.dynamics.pinocchio import holding_effort
from cranedyn.errors import CraneError, OutOfRange, UnknownName
from cranedyn.interfaces import DirectDrive, State
from cranedyn.model.crane import Crane
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
    drive: DirectDrive = "effort",
    control_period: float | None = None,
    dt: float = 5e-4,
    outputs: Sequence[str] | None = None,
) -> ct.StateSpace:
    """Return the crane linearised about a state as a state-space system with named states, inputs
    and outputs.

    Its variables are deviations from that state and from the command there, in SI units and
    radians.

    Args:
        crane: The crane.
        state: State to linearise about, at rest or in a motion; None for the start.
        effort: Efforts of the drives there [N m or N], shape (m,); None for those that balance
            gravity.
        drive: Inputs: "effort", or with "motion" the accelerations of the drives.
        control_period: None for a continuous system. A time [s] for the system that `simulate`
            steps: the command held over it, and semi-implicit Euler between.
        dt: Physics step of the sampled system [s].
        outputs: Names of the states that are outputs; None for all.

    Raises:
        OutOfRange: If a time or an effort is out of range, or `drive` is none of these.
        UnknownName: If an output is no state.
    """
    names = state_names(crane)
    model = linear(crane, crane.start if state is None else state, effort, drive=drive)
    system: Any = model
    if control_period is not None:
        system = model.sampled(dt=dt, control_period=control_period)
    output_names = names if outputs is None else list(outputs)
    for name in output_names:
        if name not in names:
            raise UnknownName("state", str(name), names)
    selection = np.eye(len(names))[[names.index(name) for name in output_names]]
    return ct.ss(
        system.a,
        system.b,
        selection,
        np.zeros((len(output_names), crane.layout.m)),
        dt=control_period or 0,
        states=names,
        inputs=input_names(crane, drive),
        outputs=output_names,
        name="crane",
    )


def from_control(
    crane: Crane,
    feedback: object,
    about: State | Motion,
    *,
    drive: DirectDrive = "effort",
    dt: float = 5e-4,
) -> Tracking:
    """Return a state feedback designed with python-control as a controller that `simulate` and
    `simulate_batch` run compiled.

    Args:
        crane: The crane.
        feedback: The gain K of u = -K z, shape (m, 2 n), as `control.lqr` and `control.dlqr` give
            it; or a system without states from the states to the commands, u = D z; or the
            controller of `control.create_statefbk_iosystem`.
        about: The rest, or the motion, from which z and u are deviations. The efforts there are fed
            forward.
        drive: Outputs of the feedback: "effort", or with "motion" the accelerations of the
            drives.
        dt: Physics step of the run [s]; a motion's period is a multiple of it.

    Raises:
        OutOfRange: If the feedback is no gain of that shape, or a number in it is not finite; or
            for a rest at which something moves.
        CraneError: If the system has states of its own, or does not say how it feeds each state
            back.
    """
    check_choice("drive", drive, DirectDrive)
    names = state_names(crane)
    gain = finite("gain", _gain(feedback, names), (crane.layout.m, len(names)))
    if isinstance(about, Motion):
        table = linearised(crane, about, dt=dt, every=len(about.q))
        commands = table.efforts if drive == "effort" else about.a[:, about.drives]
        gains = np.broadcast_to(gain, (len(commands), *gain.shape))
        return Tracking(about.period, commands, gains, table.setpoint)
    state = crane.layout.as_state("rest", about)
    if state.v.any():
        allowed = "0; a motion is given as a Motion"
        raise OutOfRange("rates of the rest", state.v.tolist(), allowed, "/s")
    command = holding_effort(crane, state.q) if drive == "effort" else np.zeros(crane.layout.m)
    return Tracking(1.0, command[None], gain[None], np.concatenate(state)[None])


def _gain(feedback: Any, names: Sequence[str]) -> np.ndarray:
    """Return K of u = -K z."""
    if not isinstance(feedback, ct.InputOutputSystem):
        try:
            return np.asarray(feedback, dtype=float)
        except (TypeError, ValueError):
            allowed = "a gain or a system of python-control"
            raise OutOfRange("feedback", short_repr(feedback), allowed) from None
    if not isinstance(feedback, ct.StateSpace) or feedback.nstates:
        raise CraneError(
            f"The feedback is a {type(feedback).__name__} with {feedback.nstates} states of its "
            "own; allowed is a gain or a StateSpace without states, u = D z."
        )
    labels = list(feedback.input_labels)
    if labels == list(names) or (len(labels) == len(names) and not set(labels) & set(names)):
        return -feedback.D
    if lacking := [name for name in names if name not in labels]:
        raise CraneError(
            f"The feedback has no input {lacking[0]}; its inputs are to be {', '.join(names)}."
        )
    gain = -feedback.D[:, [labels.index(name) for name in names]]
    further = [i for i, name in enumerate(labels) if name not in names]
    if further and not np.array_equal(feedback.D[:, further], np.hstack([gain, np.eye(len(gain))])):
        raise CraneError(
            f"The feedback has {len(further)} inputs besides the states; allowed are the desired "
            "states and inputs of control.create_statefbk_iosystem, or none."
        )
    return gain
