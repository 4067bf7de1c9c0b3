"""The linear crane as matrices with names, for python-control and MATLAB."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cranedyn.bridges.joints import input_names, state_names
from cranedyn.checks import check_choice
from cranedyn.dynamics.converters import Converters, fitting
from cranedyn.dynamics.linearisation import Linear, Sampled, linear
from cranedyn.errors import UnknownName
from cranedyn.interfaces import Drive, State
from cranedyn.model.crane import Crane


class LinearSystem(NamedTuple):
    """dz/dt = a z + b u, or z after a period = a z + b u, and y = c z, of k states, m inputs and p
    outputs; deviations in SI units and radians.

    Attributes:
        a, b, c: Shapes (k, k), (k, m) and (p, k).
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
    """Return the crane linearised about a state, see `cranedyn.bridges.control.to_control`.

    Raises:
        OutOfRange, UnknownName: As `to_control`.
    """
    check_choice("drive", drive, Drive)
    model = linear(
        crane,
        crane.start if state is None else state,
        effort,
        drive="motion" if drive == "velocity" else drive,
    )
    names, m = state_names(crane), crane.layout.m
    selected = names if outputs is None else list(outputs)
    for name in selected:
        if name not in names:
            raise UnknownName("state", str(name), names)
    converters = fitting(crane, drive, converters)
    if converters is not None:  # T dv/dt = u - v
        b = model.b / converters.lags
        a = model.a.copy()
        a[:, crane.layout.n + crane.layout.drives] -= b
        model = Linear(a, b)
    system: Linear | Sampled = model
    delay = 0
    if control_period is not None:
        system = model.sampled(dt=dt, control_period=control_period)
        delay = converters.delay_steps(dt, control_period) if converters else 0
    a, b, inputs = system.a, system.b, input_names(crane, drive)
    for k in range(delay):  # the command of so many periods ago drives, and is a state
        a = np.block([[a, b], [np.zeros((m, len(a) + m))]])
        b = np.vstack([np.zeros((len(a) - m, m)), np.eye(m)])
        names = [*names, *(f"{name}_{delay - k}" for name in inputs)]
    c = np.eye(len(a))[[names.index(name) for name in selected]]
    return LinearSystem(a, b, c, names, inputs, selected, control_period or 0.0)
