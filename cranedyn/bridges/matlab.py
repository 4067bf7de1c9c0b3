"""MATLAB: the linear crane about its start as matrices with names and units, for its `ss`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np
from scipy.io import savemat

from cranedyn.bridges.joints import input_names, state_names
from cranedyn.bridges.target import new_file
from cranedyn.checks import check_choice
from cranedyn.data.files import with_ending
from cranedyn.dynamics.converters import Converters, fitting
from cranedyn.dynamics.linearisation import Linear, Sampled, linear
from cranedyn.errors import UnknownName
from cranedyn.interfaces import Drive, State
from cranedyn.model.crane import Crane
from cranedyn.model.options import crane_from_options

TARGET = "FILE"
EXAMPLE = "crane.mat"


class LinearSystem(NamedTuple):
    """dz/dt = a z + b u, or z after a period = a z + b u, and y = c z; deviations in SI units.

    Attributes:
        a, b, c: Matrices.
        states, inputs, outputs: Names.
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
        drive: Inputs: "effort", or with "motion" the accelerations of the drives, or with
            "velocity" the rates that frequency converters are commanded. Then the drives follow as
            lags of first order; ramps and rounding are left out, and the delay is in the sampled
            system only, where commands on their way are states.
        control_period: None for a continuous system. A time [s] for the system that `simulate`
            steps: the command held over it, and semi-implicit Euler between.
        dt: Physics step of the sampled system [s].
        outputs: Names of the states that are outputs; None for all of the crane.
        converters: Frequency converters of "velocity"; None for typical ones.

    Raises:
        OutOfRange: If a time or an effort is out of range, or `drive` is none of these.
        UnknownName: If an output is no state.
    """
    check_choice("drive", drive, Drive)
    state = crane.start if state is None else state
    kind = "motion" if drive != "effort" else drive
    continuous = linear(crane, state, effort, drive=kind)  # type: ignore[arg-type]
    names = state_names(crane)
    m = crane.layout.m
    delay = 0
    moving = np.setdiff1d(np.arange(len(names)), continuous.held)
    names = [names[i] for i in moving]
    selected = names if outputs is None else list(outputs)
    for name in selected:
        if name not in names:
            raise UnknownName("state", str(name), names)
    converters = fitting(crane, drive, converters)
    if converters is not None:  # T dv/dt = u - v
        a, b = continuous.a.copy(), continuous.b / converters.lags
        a[:, crane.layout.n + crane.layout.drives] -= b
        continuous = replace(continuous, a=a, b=b)
    system: Linear | Sampled = continuous
    if control_period is not None:
        system = continuous.sampled(dt=dt, control_period=control_period)
        delay = converters.delay_steps(dt, control_period) if converters else 0
    a = system.a[np.ix_(moving, moving)]
    b = system.b[moving]
    inputs = input_names(crane, drive)
    for k in range(delay, 0, -1):  # the command of k periods ago, on its way
        a, b = (
            np.block([[a, b], [np.zeros((m, len(a) + m))]]),
            np.vstack([np.zeros_like(b), np.eye(m)]),
        )
        names = [*names, *(f"{name}_{k}" for name in inputs)]
    c = np.eye(len(a))[[names.index(name) for name in selected]]
    return LinearSystem(a, b, c, names, inputs, selected, control_period or 0.0)


def to_matlab(
    file: str | Path,
    crane: Crane,
    state: State | None = None,
    *,
    drive: Drive = "effort",
    **options: Any,
) -> Path:
    """Write A, B, C, D, Ts, the names and units of states, inputs and outputs, and the state z0 to
    a new file, ending in .mat, which MATLAB's `load` opens. Arguments as of `linear_system`.

    Raises:
        DataError: If the ending is not .mat, or the file exists or cannot be written.
        OutOfRange, UnknownName: As `linear_system`.
    """
    file = with_ending(file, ".mat")
    system = linear_system(crane, state, drive=drive, **options)
    units = {joint.symbol: joint.unit for joint in crane.layout.joints}
    units |= {f"{symbol}_dot": f"{unit}/s" for symbol, unit in units.items()}
    per = {"motion": "/s^2", "velocity": "/s"}.get(drive)
    for joint, name in zip(crane.layout.driven, system.inputs, strict=True):
        units[name] = joint.effort_unit if per is None else joint.unit + per
    content: dict[str, Any] = {"A": system.a, "B": system.b, "C": system.c, "Ts": system.period}
    content["D"] = np.zeros((len(system.c), crane.layout.m))
    z0 = dict(zip(state_names(crane), np.concatenate(state or crane.start), strict=True))
    content["z0"] = np.array([[z0[name]] for name in system.states if name in z0])
    for kind in ("state", "input", "output"):
        names = content[f"{kind}s"] = np.array(getattr(system, f"{kind}s"), dtype=object)
        known = [units.get(name) or units[name.rpartition("_")[0]] for name in names]
        content[f"{kind}_units"] = np.array(known, dtype=object)
    with new_file(file) as draft, draft.open("wb") as stream:
        savemat(stream, content)
    return file


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments beside the file and the crane."""
    text = "kind of the inputs: efforts, accelerations, or rates of frequency converters"
    parser.add_argument("--drive", choices=get_args(Drive), default="effort", help=text)
    text = "of a sampled system [s]; continuous if left out"
    parser.add_argument("--control-period", type=float, metavar="T", help=text)


def run(options: argparse.Namespace) -> Path:
    """Write what the command line describes, and return its path."""
    crane = crane_from_options(options)
    period = options.control_period
    return to_matlab(options.target, crane, drive=options.drive, control_period=period)
