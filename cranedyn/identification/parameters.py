"""Parameters that can be identified: arguments of the crane, errors of drives and sensors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from cranedyn.controllers import hold_controller
from cranedyn.errors import UnknownName
from cranedyn.identification.checked_record import LARGEST_OFFSET, Record
from cranedyn.identification.prior import Prior
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

MIN_DELAY = -0.5
"""Least delay of the swing sensor [s]; negative where the columns of the drives are late instead.
`bound_lateness` also keeps it within a quarter of a period of the swing."""

MAX_DELAY = 1.0
"""Largest delay of the swing sensor [s], see `MIN_DELAY`."""

_UNBOUNDED = (-math.inf, math.inf)
"""Bounds of a parameter that may take any value."""

_MAX_INITIAL_SWING = 1.5
"""Largest initial angle of a swing [rad]: less than a right angle."""

_START_STRETCH = 0.8
"""First stretch of a record through which a parabola is laid to find how it begins [s]."""

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
    first = prior.value(name)
    argument = prior.arguments[name]
    low = 0.0
    if argument.allowed == "any":
        low = -math.inf
    elif argument.allowed == "> 0":
        low = 1e-3 * first
    scale = 0.1 * abs(first) or 1.0
    return Parameter(name, "argument", name, argument.unit, first, low, math.inf, scale)


def _device_parameters(crane: Crane) -> dict[str, Parameter]:
    """Return the parameters of the drives and sensors of a crane by name."""
    layout = crane.layout
    devices = [
        Parameter("delay", "delay", "", "s", 0.0, MIN_DELAY, MAX_DELAY, 0.1),
        Parameter("window", "window", "", "s", 0.2, 1e-3, 2.0 * MAX_DELAY, 0.1),
    ]
    for drive in range(layout.m):
        devices += _drive_parameters(crane, drive)
    for i in crane.swings.tolist():
        symbol = layout.symbols[i]
        devices.append(Parameter(f"{symbol}_bias", "bias", symbol, "rad", 0.0, -0.3, 0.3, 0.01))
    return {p.name: p for p in devices}


def _drive_parameters(crane: Crane, drive: int) -> list[Parameter]:
    """Return the parameters of one drive: offset, lag, dry friction, and the gains of a hold
    controller about the usual ones.
    """
    joint = crane.layout.driven[drive]
    coordinate = int(crane.layout.drives[drive])
    of = joint.symbol
    unit = joint.unit
    effort_unit = joint.effort_unit
    max_offset = LARGEST_OFFSET * float(crane.upper[coordinate] - crane.lower[coordinate])
    max_effort = float(crane.effort_limit[drive])
    parameters = [
        Parameter(f"{of}_offset", "offset", of, unit, 0.0, -max_offset, max_offset, 0.1),
        Parameter(f"{of}_lag", "lag", of, "s", 0.1, 1e-3, 5.0, 0.1),
        Parameter(
            name=f"{of}_friction",
            kind="friction",
            of=of,
            unit=effort_unit,
            start=1e-4 * max_effort,
            low=0.0,
            high=max_effort,
            scale=1e-3 * max_effort,
        ),
    ]
    usual = hold_controller(crane)
    stiffness = float(usual.stiffness[drive])
    damping = float(usual.damping[drive])
    gains: tuple[tuple[Kind, str, float], ...] = (
        ("stiffness", f"{effort_unit}/{unit}", stiffness),
        ("damping", f"{effort_unit} s/{unit}", damping),
    )
    for kind, gain_unit, gain in gains:
        parameters.append(
            Parameter(
                name=f"{of}_{kind}",
                kind=kind,
                of=of,
                unit=gain_unit,
                start=gain,
                low=1e-2 * gain,
                high=1e2 * gain,
                scale=0.1 * gain,
            )
        )
    return parameters


def default_names(prior: Prior, records: Sequence[Record], drives: Drives) -> list[str]:
    """Return the names of the parameters that the recorded columns can determine."""
    layout = prior.crane.layout
    winch = prior.crane.winch
    names = []
    if winch is not None:
        names.append(f"{layout.driven[winch].symbol}_offset")
    recorded = set()
    with_angle = set()
    for record in records:
        for joint in record.swings:
            recorded.add(joint.symbol)
            if joint.columns[0] in record.columns:
                with_angle.add(joint.symbol)
    dampings = ["damp_swing"]
    dampings += [f"damp_{symbol}" for symbol in layout.symbols if symbol in recorded]
    names += [name for name in dampings if name in prior.arguments]
    if drives == "motion":
        names.append("delay")
    names += [f"{symbol}_bias" for symbol in layout.symbols if symbol in with_angle]
    for drive in range(layout.m):
        names += _default_drive_names(prior, records, drives, drive)
    return names


def _default_drive_names(
    prior: Prior, records: Sequence[Record], drives: Drives, drive: int
) -> list[str]:
    """Return the names of the parameters of a drive that the recorded columns can determine."""
    joint = prior.crane.layout.driven[drive]
    has_position = any(record.moves(joint.columns[0]) for record in records)
    has_setpoint = any(record.moves(joint.setpoint_column) for record in records)
    has_effort = any(record.moves(joint.effort_column) for record in records)
    names = []
    if drives == "motion" and has_setpoint:
        names.append(f"{joint.symbol}_lag")
    if has_effort and drive == prior.crane.winch and "payload_mass" in prior.arguments:
        names.append("payload_mass")
    has_motion = has_position or has_setpoint
    if drives == "motion" and has_effort and has_motion and joint.role == "trolley":
        names.append(f"{joint.symbol}_friction")
    if drives == "hold" and has_position:
        names += [f"{joint.symbol}_stiffness", f"{joint.symbol}_damping"]
    return names


def bound_lateness(p: Parameter, records: Sequence[Record]) -> Parameter:
    """Return a parameter with bounds by which the swing is late by less than a quarter of its
    period; an average is late by half its window.

    A swing that is late by half a period is one of the other sign: without bounds, delay and sign
    could not be told apart.
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
    parameters = list[Parameter]()
    for joint in record.swings:
        is_angle = joint.kind == "revolute"
        ends = (-_MAX_INITIAL_SWING, _MAX_INITIAL_SWING) if is_angle else _UNBOUNDED
        parameters += _start(record, index, joint, ends, 0.02)
        if joint.columns[0] not in record.columns:  # a gyroscope
            for kind, unit, scale in _RATE_ERRORS:
                name = f"{joint.symbol} {kind}"
                parameters.append(
                    Parameter(name, kind, joint.symbol, unit, 0.0, *_UNBOUNDED, scale, index)
                )
    if drives == "motion":
        return parameters
    for joint in record.crane.layout.driven:
        column = joint.columns[0]
        if not record.moves(column):
            continue
        parameters += _start(record, index, joint, _UNBOUNDED, 0.01)
        if drives == "hold" and joint.setpoint_column not in record.columns:
            name = f"{joint.symbol}_setpoint"
            mean = float(np.mean(record.columns[column]))
            parameters.append(
                Parameter(
                    name, "setpoint", joint.symbol, joint.unit, mean, *_UNBOUNDED, 0.01, index
                )
            )
    return parameters


def _start(
    record: Record, index: int, joint: Joint, ends: tuple[float, float], scale: float
) -> list[Parameter]:
    """Return the initial coordinate and rate of a joint, by a parabola through the first rows. Of a
    swing whose rate was recorded the coordinate follows from the slope of the rate.
    """
    rows = max(4, int(np.searchsorted(record.t, _START_STRETCH)))
    column = record.swing_column(joint)
    _, slope, value = np.polyfit(record.t[:rows], record.columns[column][:rows], 2)
    if column == joint.columns[1]:
        # Of a free swing φ̈ = -ω² φ with ω = 2 π / period.
        rate = value
        position = -slope * (record.swing_period / (2.0 * math.pi)) ** 2
    else:
        rate = slope
        position = value
    symbol = joint.symbol
    unit = joint.unit
    first = float(np.clip(position, *ends))
    first_rate = float(rate)
    rate_unit = f"{unit}/s"
    return [
        Parameter(f"{symbol}_start", "start", symbol, unit, first, *ends, scale, index),
        Parameter(
            f"{symbol}_dot_start", "start rate", symbol, rate_unit, first_rate, *_UNBOUNDED, scale,
            index,
        ),
    ]  # fmt: skip
