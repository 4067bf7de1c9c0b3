"""MATLAB: the linear crane about its start, or a linear controller, as matrices with names and
units, for its `ss`.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from scipy.io import savemat

from cranedyn.checks import check_choice, number
from cranedyn.command import command_line
from cranedyn.data.files import with_ending
from cranedyn.dynamics.converters import Converters, converters_of_run
from cranedyn.dynamics.linearisation import Linear, Sampled, linear
from cranedyn.errors import UnknownName
from cranedyn.export.crane_data import linear_law
from cranedyn.export.target import new_file
from cranedyn.interfaces import Controller, Drive, State
from cranedyn.model.crane import Crane
from cranedyn.model.options import crane_from_options
from cranedyn.model.signals import input_names, state_names

TARGET = "FILE"
"""What the command line calls the target of the export."""

EXAMPLE = "crane.mat"
"""Example of a target, for the help of the command line."""


class LinearSystem(NamedTuple):
    """A linear system dz/dt = a z + b u, or z after a period = a z + b u, with y = c z.

    States z, inputs u and outputs y are deviations in SI units.

    Attributes:
        a: Matrix of the states.
        b: Matrix of the inputs.
        c: Matrix of the outputs.
        states: Names of the states.
        inputs: Names of the inputs.
        outputs: Names of the outputs.
        period: Control period [s]; 0 in continuous time.
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    states: list[str]
    inputs: list[str]
    outputs: list[str]
    period: float


def linear_system(
    crane: Crane,
    state: State | None = None,
    *,
    effort: np.ndarray | None = None,
    drive: Drive = "effort",
    control_period: float | None = None,
    dt: float = 5e-4,
    outputs: Sequence[str] | None = None,
    converters: Converters | None = None,
) -> LinearSystem:
    """Return the crane linearised about a state.

    Args:
        crane: The crane.
        state: State to linearise about, at rest or in a motion; None for the start.
        effort: Efforts of the drives there [N m or N], shape (m,); None for those that balance
            gravity.
        drive: What the inputs are: with "effort" efforts, with "motion" the accelerations of the
            drives, with "velocity" the rates that frequency converters are commanded. The drives
            of "velocity" follow as lags of first order; ramps and rounding are left out, and the
            delay is in the sampled system only, where commands on their way are states.
        control_period: None for a continuous system. A time [s] for the system that `simulate`
            steps: the command is held over it, with steps of semi-implicit Euler between.
        dt: Physics step of the sampled system [s].
        outputs: Names of the states that are outputs; None for all of the crane.
        converters: Frequency converters of "velocity"; None for typical ones.

    Raises:
        OutOfRange: If a time or an effort is out of range, or `drive` is none of these.
        UnknownName: If an output is no state.
    """
    check_choice("drive", drive, Drive)
    state = crane.start if state is None else state
    # Drives that take rates are linearised with their accelerations as inputs first, from which
    # `_behind_lags` goes on to the rates.
    kind: Literal["effort", "motion"] = "effort" if drive == "effort" else "motion"
    continuous = linear(crane, state, effort, drive=kind)
    every_name = state_names(crane)
    # States that are held, such as the stretch of a rope that does not stretch, are left out.
    moving = np.setdiff1d(np.arange(len(every_name)), continuous.held)
    names = [every_name[i] for i in moving]
    selected = names if outputs is None else list(outputs)
    for name in selected:
        if name not in names:
            raise UnknownName("state", str(name), names)

    converters = converters_of_run(crane, drive, converters)
    if converters is not None:
        continuous = _behind_lags(crane, continuous, converters)
    system: Linear | Sampled = continuous
    delay = 0
    if control_period is not None:
        system = continuous.sampled(dt=dt, control_period=control_period)
        if converters is not None:
            delay = converters.delay_steps(dt, control_period)
    a = system.a[np.ix_(moving, moving)]
    b = system.b[moving]
    inputs = input_names(crane, drive)
    for periods in range(delay, 0, -1):
        a, b = _delayed_by_a_period(a, b)
        names = [*names, *(f"{name}_{periods}" for name in inputs)]
    c = np.eye(len(a))[[names.index(name) for name in selected]]
    return LinearSystem(a, b, c, names, inputs, selected, control_period or 0.0)


def _behind_lags(crane: Crane, system: Linear, converters: Converters) -> Linear:
    """Return a system whose inputs are accelerations with rates as inputs instead.

    A drive with the lag T follows the commanded rate u by T dv/dt = u - v, so its acceleration is
    u/T - v/T.
    """
    a = system.a.copy()
    b = system.b / converters.lags
    a[:, crane.layout.n + crane.layout.drives] -= b
    return replace(system, a=a, b=b)


def _delayed_by_a_period(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a sampled system whose inputs take effect a period later.

    The inputs p of the period before are further states: z ← a z + b p, and p ← u.
    """
    m = b.shape[1]
    delayed_a = np.block([[a, b], [np.zeros((m, len(a) + m))]])
    delayed_b = np.vstack([np.zeros_like(b), np.eye(m)])
    return delayed_a, delayed_b


def to_matlab(
    file: str | Path,
    crane: Crane,
    state: State | None = None,
    *,
    effort: np.ndarray | None = None,
    drive: Drive = "effort",
    control_period: float | None = None,
    dt: float = 5e-4,
    outputs: Sequence[str] | None = None,
    converters: Converters | None = None,
) -> Path:
    """Write the crane linearised about a state to a file that MATLAB's `load` opens.

    It holds the matrices A, B, C and D, the period Ts [s], 0 in continuous time, the names and
    units of states, inputs and outputs, and the state z0 about which the system is linearised.

    Args:
        file: New file, ending in .mat.
        crane: The crane.
        state: State to linearise about, see `linear_system`.
        effort: Efforts of the drives there, see `linear_system`.
        drive: What the inputs are, see `linear_system`.
        control_period: Period of a sampled system [s]; None for a continuous one.
        dt: Physics step of the sampled system [s].
        outputs: Names of the states that are outputs; None for all of the crane.
        converters: Frequency converters of "velocity"; None for typical ones.

    Raises:
        DataError: If the ending is not .mat, or the file exists or cannot be written.
        OutOfRange, UnknownName: As `linear_system`.
    """
    file = with_ending(file, ".mat")
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
    units = _units(crane, drive, system.inputs)
    names = {"state": system.states, "input": system.inputs, "output": system.outputs}

    content: dict[str, Any] = {"A": system.a, "B": system.b, "C": system.c, "Ts": system.period}
    content["D"] = np.zeros((len(system.c), crane.layout.m))
    about = crane.start if state is None else state
    z0_of = dict(zip(state_names(crane), np.concatenate(about), strict=True))
    # Commands on their way, which are states too, are no part of the crane's state.
    content["z0"] = np.array([[z0_of[name]] for name in system.states if name in z0_of])
    for kind, names_of_kind in names.items():
        units_of_kind = [_unit_of(name, units) for name in names_of_kind]
        content[f"{kind}s"] = np.array(names_of_kind, dtype=object)
        content[f"{kind}_units"] = np.array(units_of_kind, dtype=object)
    with new_file(file) as draft, draft.open("wb") as stream:
        savemat(stream, content)
    return file


def controller_to_matlab(
    file: str | Path,
    crane: Crane,
    controller: Controller,
    *,
    drive: Drive = "effort",
    control_period: float = 5e-3,
    duration: float = 30.0,
) -> Path:
    """Write a linear controller to a file that MATLAB's `load` opens.

    It holds the matrices A, B, C and D of a system in discrete time with the period Ts [s], and the
    names and units of its inputs and outputs. The inputs are the coordinates and rates of the
    crane, as deviations from z0, and then the positions of the setpoint of the drives, as
    deviations from those in z0; the outputs are the commands, as deviations from u0. A drive that
    is held at a rest of the controller has a zero column for its setpoint. The states begin at x0.
    Where a command u is limited to u_limits, the next states get anti_windup times what that
    changes in u.

    Args:
        file: New file, ending in .mat.
        crane: The crane.
        controller: A controller with an affine form, see `cranedyn.controllers.affine`.
        drive: What its commands are: efforts, accelerations or rates.
        control_period: Control period [s].
        duration: Time over which it must stay the same [s].

    Raises:
        DataError: If the ending is not .mat, the file exists or cannot be written, or the
            controller is not linear and the same at all times.
        OutOfRange: If a time is out of range, or the controller is for another control period.
    """
    file = with_ending(file, ".mat")
    check_choice("drive", drive, Drive)
    period = float(number("control_period", control_period, "s", "> 0"))
    law = linear_law(crane, controller, period, duration, "MATLAB")
    states = law.states
    gain = law.gain
    inputs = [*state_names(crane), *(f"{joint.symbol}_set" for joint in crane.layout.driven)]
    outputs = input_names(crane, drive)
    units = _units(crane, drive, outputs)
    for joint in crane.layout.driven:
        units[f"{joint.symbol}_set"] = joint.unit
    content = {
        "A": states.a,
        "B": np.hstack([states.b, -states.b @ law.shift]),
        "C": states.c,
        "D": np.hstack([-gain, gain @ law.shift]),
        "Ts": period,
        "z0": law.setpoint[:, None],
        "u0": law.feed_forward[:, None],
        "x0": states.initial[:, None],
        "anti_windup": states.anti_windup,
        "u_limits": states.limit[:, None],
    }
    for kind, names in (("input", inputs), ("output", outputs)):
        content[f"{kind}s"] = np.array(names, dtype=object)
        content[f"{kind}_units"] = np.array([units[name] for name in names], dtype=object)
    with new_file(file) as draft, draft.open("wb") as stream:
        savemat(stream, content)
    return file


def _units(crane: Crane, drive: Drive, inputs: Sequence[str]) -> dict[str, str]:
    """Return the units of states and inputs by their names."""
    units = {}
    for joint in crane.layout.joints:
        units[joint.symbol] = joint.unit
        units[f"{joint.symbol}_dot"] = f"{joint.unit}/s"
    for joint, name in zip(crane.layout.driven, inputs, strict=True):
        if drive == "effort":
            units[name] = joint.effort_unit
        elif drive == "motion":
            units[name] = f"{joint.unit}/s^2"
        else:
            units[name] = f"{joint.unit}/s"
    return units


def _unit_of(name: str, units: dict[str, str]) -> str:
    """Return the unit of a state or an input.

    A command on its way is a state, whose name is that of the input with an underline and a number
    of periods; its unit is that of the input.
    """
    if name in units:
        return units[name]
    input_name, _, _ = name.rpartition("_")
    return units[input_name]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments beside the file and the crane."""
    parser.add_argument(
        "--drive",
        choices=get_args(Drive),
        default="effort",
        help="kind of the inputs: efforts, accelerations, or rates of frequency converters",
    )
    parser.add_argument(
        "--control-period",
        type=float,
        metavar="T",
        help="of a sampled system [s]; continuous if left out",
    )


def run(options: argparse.Namespace) -> Path:
    """Write what the command line describes, and return its path."""
    crane = crane_from_options(options)
    period = options.control_period
    return to_matlab(options.target, crane, drive=options.drive, control_period=period)


def next_commands(options: argparse.Namespace) -> list[str]:
    """Return command lines that work with what `run` has written."""
    load = f"load('{options.target}'), whos"
    list_variables = f"import scipy.io; print(scipy.io.whosmat({str(options.target)!r}))"
    return [
        command_line("matlab", "-batch", load),
        command_line("python", "-c", list_variables),
    ]
