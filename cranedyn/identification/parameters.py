"""Parameters that can be identified: arguments of the crane, errors of drives and sensors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cranedyn.controllers import hold_controller
from cranedyn.errors import UnknownName
from cranedyn.identification.prior import Prior
from cranedyn.identification.record import Record
from cranedyn.model.layout import Joint

Drives = Literal["motion", "effort", "hold"]
"""How the drives of a record are simulated: their motion is prescribed, their recorded efforts act,
or a hold controller holds them at their setpoints."""

Kind = Literal[
    "argument",
    "offset",
    "lag",
    "delay",
    "bias",
    "friction",
    "stiffness",
    "damping",
    "start",
    "start rate",
    "setpoint",
]

MEANINGS = {
    "offset": "true coordinate less the recorded one",
    "lag": "time constant with which the drive follows its setpoint",
    "delay": "how late the swing is recorded, beside the drives",
    "bias": "what the swing sensor adds",
    "friction": "dry friction of the drive",
    "stiffness": "k_p of the hold controller of the drive",
    "damping": "k_d of the hold controller of the drive",
}

EARLY, LATE = -0.5, 1.0
"""Bounds of the delay of the swing sensor [s]."""


@dataclass(frozen=True)
class Parameter:
    """Parameter to be estimated.

    Attributes:
        name: Name of the parameter.
        kind: Kind of the parameter.
        of: Symbol of its coordinate, or name of the argument; may be empty.
        unit: Unit.
        start: First value of the search.
        low, high: Bounds.
        scale: Typical change of the parameter.
        record: Index of the record that the parameter describes; None for the crane. Parameters of
            a record are estimated along with the others and not reported.
    """

    name: str
    kind: Kind
    of: str
    unit: str
    start: float
    low: float
    high: float
    scale: float
    record: int | None = None


def parameter(prior: Prior, name: str) -> Parameter:
    """Return the parameter of a name.

    Args:
        prior: Prior knowledge of the crane.
        name: ``delay``; ``l_offset``, ``x_lag``, ``x_friction``, ``x_stiffness`` or ``x_damping``
            of any drive; ``phi_bias`` of any swing; or an argument of the description or
            ``gravity``.

    Raises:
        UnknownName: If there is no parameter of this name.
    """
    if name == "delay":
        return Parameter(name, "delay", "", "s", 0.0, EARLY, LATE, 0.1)
    layout = prior.crane.layout
    symbol, _, kind = name.rpartition("_")
    drives = {joint.symbol: i for i, joint in enumerate(layout.driven)}
    if symbol in drives and (p := _of_drive(prior, drives[symbol], kind, name)) is not None:
        return p
    swings = [layout.joints[i].symbol for i in prior.crane.swings.tolist()]
    if symbol in swings and kind == "bias":
        return Parameter(name, "bias", symbol, "rad", 0.0, -0.3, 0.3, 0.01)
    if name in prior.arguments:
        first, argument = prior.value(name), prior.arguments[name]
        low = {"any": -math.inf, "> 0": 1e-3 * first, ">= 0": 0.0}[argument.allowed]
        scale = 0.1 * abs(first) or 1.0
        return Parameter(name, "argument", name, argument.unit, first, low, math.inf, scale)
    raise UnknownName("parameter", name, parameter_names(prior))


def parameter_names(prior: Prior) -> list[str]:
    """Return the names of all parameters that can be identified."""
    layout = prior.crane.layout
    kinds = ("offset", "lag", "friction", "stiffness", "damping")
    return [
        "delay",
        *(f"{joint.symbol}_{kind}" for joint in layout.driven for kind in kinds),
        *(f"{layout.joints[i].symbol}_bias" for i in prior.crane.swings.tolist()),
        *prior.arguments,
    ]


def default_names(prior: Prior, records: Sequence[Record], drives: Drives) -> list[str]:
    """Return the names of the parameters that the recorded columns can determine."""
    layout = prior.crane.layout
    chosen = ["l_offset"] if layout.has("hoist") and layout.symbols.count("l") else []
    chosen += [name for name in ("damp_swing",) if name in prior.arguments]
    chosen += ["delay"] if drives == "motion" else []
    biased = {joint.symbol for record in records for joint in record.swings}
    chosen += [f"{symbol}_bias" for symbol in layout.symbols if symbol in biased]
    for joint in layout.driven:
        moved = any(record.moves(joint.columns[0]) for record in records)
        aimed = any(record.moves(joint.setpoint_column) for record in records)
        effort = any(record.moves(joint.effort_column) for record in records)
        if drives == "motion" and aimed:
            chosen.append(f"{joint.symbol}_lag")
        if effort and joint.role == "hoist" and "payload_mass" in prior.arguments:
            chosen.append("payload_mass")
        if drives == "motion" and effort and (moved or aimed) and joint.role == "trolley":
            chosen.append(f"{joint.symbol}_friction")
        if drives == "hold":
            chosen += [f"{joint.symbol}_{gain}" for gain in ("stiffness", "damping") if moved]
    return chosen


def initial_parameters(record: Record, index: int, drives: Drives) -> list[Parameter]:
    """Return the parameters of the initial state of a record: its swing, and drives whose motion is
    not prescribed.
    """
    crane, parameters = record.crane, list[Parameter]()
    for joint in record.swings:
        parameters += _start(record, index, joint, record.crane.swings.tolist(), 0.02)
    if drives == "motion":
        return parameters
    for joint in crane.layout.driven:
        column = joint.columns[0]
        if record.moves(column):
            parameters += _start(record, index, joint, crane.layout.drives.tolist(), 0.01)
            if drives == "hold" and joint.setpoint_column not in record.columns:
                mean = float(np.mean(record.columns[column]))
                parameters.append(
                    Parameter(
                        f"{joint.symbol}_setpoint",
                        "setpoint",
                        joint.symbol,
                        joint.unit,
                        mean,
                        -math.inf,
                        math.inf,
                        0.01,
                        index,
                    )
                )
    return parameters


def _start(
    record: Record, index: int, joint: Joint, among: Sequence[int], scale: float
) -> list[Parameter]:
    """Return the initial coordinate and rate of a joint, by a parabola through the first rows."""
    rows = max(4, int(np.searchsorted(record.t, 0.8)))
    values = record.columns[joint.columns[0]][:rows]
    _, rate, position = np.polyfit(record.t[:rows], values, 2)
    ends = (-1.5, 1.5) if joint.kind == "revolute" and not joint.driven else (-math.inf, math.inf)
    symbol, unit = joint.symbol, joint.unit
    return [
        Parameter(
            f"{symbol}_start", "start", symbol, unit, float(np.clip(position, *ends)), *ends, scale,
            index,
        ),
        Parameter(
            f"{symbol}_dot_start", "start rate", symbol, f"{unit}/s", float(rate), -math.inf,
            math.inf, scale, index,
        ),
    ]  # fmt: skip


def _of_drive(prior: Prior, drive: int, kind: str, name: str) -> Parameter | None:
    joint = prior.crane.layout.driven[drive]
    coordinate = int(prior.crane.layout.drives[drive])
    width = float(prior.crane.upper[coordinate] - prior.crane.lower[coordinate])
    symbol, unit, effort = joint.symbol, joint.unit, joint.effort_unit
    if kind == "offset":
        reach = 0.25 * width
        return Parameter(name, "offset", symbol, unit, 0.0, -reach, reach, 0.1)
    if kind == "lag":
        return Parameter(name, "lag", symbol, "s", 0.1, 1e-3, 5.0, 0.1)
    if kind == "friction":
        limit = float(prior.crane.effort_limit[drive])
        return Parameter(name, "friction", symbol, effort, 1e-4 * limit, 0.0, limit, 1e-3 * limit)
    if kind in ("stiffness", "damping"):
        gain = float(getattr(hold_controller(prior.crane), kind)[drive])
        per = f"{effort}/{unit}" if kind == "stiffness" else f"{effort} s/{unit}"
        gain_kind: Kind = "stiffness" if kind == "stiffness" else "damping"
        return Parameter(name, gain_kind, symbol, per, gain, 1e-2 * gain, 1e2 * gain, 0.1 * gain)
    return None
