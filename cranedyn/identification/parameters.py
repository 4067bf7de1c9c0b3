"""Parameters that can be identified: arguments of the crane, errors of drives and sensors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from cranedyn.controllers import hold_controller
from cranedyn.errors import UnknownName
from cranedyn.identification.prior import Prior
from cranedyn.identification.record import LARGEST_OFFSET, Record
from cranedyn.model.crane import Crane
from cranedyn.model.layout import Joint

Drives = Literal["motion", "effort", "hold"]
"""How the drives of a record are simulated: their motion is prescribed, their recorded efforts act,
or a hold controller holds them at their setpoints."""

Kind = Literal[
    "argument", "offset", "lag", "delay", "window", "bias", "friction", "stiffness", "damping",
    "start", "start rate", "setpoint", "rate bias", "rate drift",
]  # fmt: skip

MEANINGS = {
    "offset": "true coordinate less the recorded one",
    "lag": "time constant with which the drive follows its setpoint",
    "delay": "how late the swing is recorded, beside the drives",
    "window": "time over which the swing sensor averages, up to the row",
    "bias": "what the swing sensor adds",
    "friction": "dry friction of the drive",
    "stiffness": "k_p of the hold controller of the drive",
    "damping": "k_d of the hold controller of the drive",
}

EARLY, LATE = -0.5, 1.0
"""Bounds of the delay of the swing sensor [s], and a quarter of the period of the swing: a delay of
half a period is the other sign."""


_RATE_ERRORS: tuple[tuple[Kind, str, float], ...] = (
    ("rate bias", "rad/s", 1e-3),
    ("rate drift", "rad/s²", 1e-5),
)
"""What a gyroscope adds to a rate, and how fast that changes: kind, unit and scale."""


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
        name: ``delay`` or ``window``; ``l_offset``, ``x_lag``, ``x_friction``, ``x_stiffness`` or
            ``x_damping`` of any drive; ``phi_bias`` of any swing; or an argument of the description
            or ``gravity``.

    Raises:
        UnknownName: If there is no parameter of this name.
    """
    devices = _device_parameters(prior.crane)
    if name in devices:
        return devices[name]
    if name not in prior.arguments:
        raise UnknownName("parameter", name, [*devices, *prior.arguments])
    first, argument = prior.value(name), prior.arguments[name]
    low = {"any": -math.inf, "> 0": 1e-3 * first}.get(argument.allowed, 0.0)
    scale = 0.1 * abs(first) or 1.0
    return Parameter(name, "argument", name, argument.unit, first, low, math.inf, scale)


def _device_parameters(crane: Crane) -> dict[str, Parameter]:
    """Return the parameters of the drives and sensors of a crane by name."""
    layout, usual = crane.layout, hold_controller(crane)
    devices = [
        Parameter("delay", "delay", "", "s", 0.0, EARLY, LATE, 0.1),
        Parameter("window", "window", "", "s", 0.2, 1e-3, 2.0 * LATE, 0.1),
    ]
    for drive, (joint, i) in enumerate(zip(layout.driven, layout.drives.tolist(), strict=True)):
        of, unit, effort = joint.symbol, joint.unit, joint.effort_unit
        reach = LARGEST_OFFSET * float(crane.upper[i] - crane.lower[i])
        limit = float(crane.effort_limit[drive])
        k_p, k_d = float(usual.stiffness[drive]), float(usual.damping[drive])
        devices += [
            Parameter(f"{of}_offset", "offset", of, unit, 0.0, -reach, reach, 0.1),
            Parameter(f"{of}_lag", "lag", of, "s", 0.1, 1e-3, 5.0, 0.1),
            Parameter(
                f"{of}_friction", "friction", of, effort, 1e-4 * limit, 0.0, limit, 1e-3 * limit
            ),
            Parameter(
                f"{of}_stiffness", "stiffness", of, f"{effort}/{unit}", k_p, 1e-2 * k_p, 1e2 * k_p,
                0.1 * k_p,
            ),
            Parameter(
                f"{of}_damping", "damping", of, f"{effort} s/{unit}", k_d, 1e-2 * k_d, 1e2 * k_d,
                0.1 * k_d,
            ),
        ]  # fmt: skip
    for symbol in (layout.symbols[i] for i in crane.swings.tolist()):
        devices.append(Parameter(f"{symbol}_bias", "bias", symbol, "rad", 0.0, -0.3, 0.3, 0.01))
    return {p.name: p for p in devices}


def default_names(prior: Prior, records: Sequence[Record], drives: Drives) -> list[str]:
    """Return the names of the parameters that the recorded columns can determine."""
    layout, winch = prior.crane.layout, prior.crane.winch
    chosen = [] if winch is None else [f"{layout.driven[winch].symbol}_offset"]
    swings = [(record, joint) for record in records for joint in record.swings]
    recorded = {joint.symbol for _, joint in swings}
    biased = {joint.symbol for record, joint in swings if joint.columns[0] in record.columns}
    damped = ("damp_swing", *(f"damp_{symbol}" for symbol in layout.symbols if symbol in recorded))
    chosen += [name for name in damped if name in prior.arguments]
    chosen += ["delay"] if drives == "motion" else []
    chosen += [f"{symbol}_bias" for symbol in layout.symbols if symbol in biased]
    for drive, joint in enumerate(layout.driven):
        moved = any(record.moves(joint.columns[0]) for record in records)
        aimed = any(record.moves(joint.setpoint_column) for record in records)
        effort = any(record.moves(joint.effort_column) for record in records)
        if drives == "motion" and aimed:
            chosen.append(f"{joint.symbol}_lag")
        if effort and drive == winch and "payload_mass" in prior.arguments:
            chosen.append("payload_mass")
        if drives == "motion" and effort and (moved or aimed) and joint.role == "trolley":
            chosen.append(f"{joint.symbol}_friction")
        if drives == "hold":
            chosen += [f"{joint.symbol}_{gain}" for gain in ("stiffness", "damping") if moved]
    return chosen


def bound_lateness(p: Parameter, records: Sequence[Record]) -> Parameter:
    """Return a parameter with bounds by which the swing is late by less than a quarter of its
    period; an average is late by half its window.
    """
    quarter = 0.25 * min(record.swing_period for record in records)
    if p.kind == "delay":
        return replace(p, low=max(p.low, -quarter), high=min(p.high, quarter))
    if p.kind == "window":
        return replace(p, start=min(p.start, quarter), high=min(p.high, 2.0 * quarter))
    return p


def initial_parameters(record: Record, index: int, drives: Drives) -> list[Parameter]:
    """Return the parameters of the initial state of a record: its swing, and drives whose motion is
    not prescribed.
    """
    parameters, free = list[Parameter](), (-math.inf, math.inf)
    for joint in record.swings:
        ends = (-1.5, 1.5) if joint.kind == "revolute" else free
        parameters += _start(record, index, joint, ends, 0.02)
        if joint.columns[0] not in record.columns:  # a gyroscope
            of = joint.symbol
            parameters += [
                Parameter(f"{of} {kind}", kind, of, unit, 0.0, *free, scale, index)
                for kind, unit, scale in _RATE_ERRORS
            ]
    for joint in record.crane.layout.driven if drives != "motion" else ():
        column = joint.columns[0]
        if not record.moves(column):
            continue
        parameters += _start(record, index, joint, free, 0.01)
        if drives == "hold" and joint.setpoint_column not in record.columns:
            name, mean = f"{joint.symbol}_setpoint", float(np.mean(record.columns[column]))
            parameters.append(
                Parameter(name, "setpoint", joint.symbol, joint.unit, mean, *free, 0.01, index)
            )
    return parameters


def _start(
    record: Record, index: int, joint: Joint, ends: tuple[float, float], scale: float
) -> list[Parameter]:
    """Return the initial coordinate and rate of a joint, by a parabola through the first rows. Of a
    swing whose rate was recorded the coordinate follows from the slope of the rate.
    """
    rows, column = max(4, int(np.searchsorted(record.t, 0.8))), record.swing_column(joint)
    _, rate, position = np.polyfit(record.t[:rows], record.columns[column][:rows], 2)
    if column == joint.columns[1]:
        rate, position = position, -rate * (record.swing_period / (2.0 * math.pi)) ** 2
    symbol, unit, first = joint.symbol, joint.unit, float(np.clip(position, *ends))
    free = (-math.inf, math.inf)
    return [
        Parameter(f"{symbol}_start", "start", symbol, unit, first, *ends, scale, index),
        Parameter(
            f"{symbol}_dot_start", "start rate", symbol, f"{unit}/s", float(rate), *free, scale,
            index,
        ),
    ]  # fmt: skip
