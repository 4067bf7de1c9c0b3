"""Parameters that can be identified: arguments of the crane, errors of drives and sensors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from cranedyn.controllers import hold_controller
from cranedyn.errors import UnknownName
from cranedyn.identification.checked_record import MAX_OFFSET_SHARE, Record
from cranedyn.identification.prior import Prior
from cranedyn.model.crane import Crane
from cranedyn.model.layout import Joint, Layout

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

_MIN_START_ROWS = 4
"""Least number of rows through which it is laid."""


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
        Parameter(
            name="delay",
            kind="delay",
            of="",
            unit="s",
            start=0.0,
            low=MIN_DELAY,
            high=MAX_DELAY,
            scale=0.1,
        ),
        Parameter(
            name="window",
            kind="window",
            of="",
            unit="s",
            start=0.2,
            low=1e-3,
            high=2.0 * MAX_DELAY,
            scale=0.1,
        ),
    ]
    for drive in range(layout.m):
        devices += _drive_parameters(crane, drive)
    for i in crane.swings.tolist():
        symbol = layout.symbols[i]
        devices.append(
            Parameter(
                name=f"{symbol}_bias",
                kind="bias",
                of=symbol,
                unit="rad",
                start=0.0,
                low=-0.3,
                high=0.3,
                scale=0.01,
            )
        )
    return {p.name: p for p in devices}


def _drive_parameters(crane: Crane, drive: int) -> list[Parameter]:
    """Return the parameters of one drive: offset, lag, dry friction, and the gains of a hold
    controller about the usual ones.
    """
    joint = crane.layout.driven[drive]
    coordinate = int(crane.layout.drives[drive])
    symbol = joint.symbol
    max_offset = MAX_OFFSET_SHARE * float(crane.upper[coordinate] - crane.lower[coordinate])
    max_effort = float(crane.effort_limit[drive])
    usual = hold_controller(crane)
    return [
        Parameter(
            name=f"{symbol}_offset",
            kind="offset",
            of=symbol,
            unit=joint.unit,
            start=0.0,
            low=-max_offset,
            high=max_offset,
            scale=0.1,
        ),
        Parameter(
            name=f"{symbol}_lag",
            kind="lag",
            of=symbol,
            unit="s",
            start=0.1,
            low=1e-3,
            high=5.0,
            scale=0.1,
        ),
        Parameter(
            name=f"{symbol}_friction",
            kind="friction",
            of=symbol,
            unit=joint.effort_unit,
            start=1e-4 * max_effort,
            low=0.0,
            high=max_effort,
            scale=1e-3 * max_effort,
        ),
        _gain_parameter(joint, "stiffness", float(usual.stiffness[drive])),
        _gain_parameter(joint, "damping", float(usual.damping[drive])),
    ]


def _gain_parameter(joint: Joint, kind: Literal["stiffness", "damping"], usual: float) -> Parameter:
    """Return a gain of the hold controller of a drive, up to a hundred times the usual one or as
    many times less.
    """
    per = f"/{joint.unit}" if kind == "stiffness" else f" s/{joint.unit}"
    return Parameter(
        name=f"{joint.symbol}_{kind}",
        kind=kind,
        of=joint.symbol,
        unit=joint.effort_unit + per,
        start=usual,
        low=1e-2 * usual,
        high=1e2 * usual,
        scale=0.1 * usual,
    )


def default_names(prior: Prior, records: Sequence[Record], drives: Drives) -> list[str]:
    """Return the names of the parameters that the recorded columns can determine."""
    layout = prior.crane.layout
    winch = prior.crane.winch
    names = []
    if winch is not None:
        names.append(f"{layout.driven[winch].symbol}_offset")

    # Swings that are recorded, and those of them of which the angle is recorded.
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
    if drives == "motion" and _a_drive_moves(layout, records):
        names.append("delay")
    names += [f"{symbol}_bias" for symbol in layout.symbols if symbol in with_angle]
    for drive in range(layout.m):
        names += _default_drive_names(prior, records, drives, drive)
    return names


def _a_drive_moves(layout: Layout, records: Sequence[Record]) -> bool:
    """Return whether a drive moves in a record.

    A free swing that is recorded late is the same free swing: only the motion of a drive shows when
    the swing began.
    """
    for record in records:
        for joint in layout.driven:
            if any(record.moves(column) for column in (*joint.columns, joint.setpoint_column)):
                return True
    return False


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
    period.

    A swing that is late by half a period is one of the other sign: without bounds, delay and sign
    could not be told apart.
    """
    quarter = 0.25 * min(record.swing_period for record in records)
    if p.kind == "delay":
        return replace(p, low=max(p.low, -quarter), high=min(p.high, quarter))
    if p.kind == "window":
        # An average is late by half of its window.
        return replace(p, start=min(p.start, quarter), high=min(p.high, 2.0 * quarter))
    return p


def initial_parameters(record: Record, index: int, drives: Drives) -> list[Parameter]:
    """Return the parameters of the initial state of a record: its swing, and drives whose motion is
    not prescribed.
    """
    parameters = list[Parameter]()
    for joint in record.swings:
        is_angle = joint.kind == "revolute"
        bounds = (-_MAX_INITIAL_SWING, _MAX_INITIAL_SWING) if is_angle else _UNBOUNDED
        parameters += _initial_state(record, index, joint, bounds, 0.02)
        if joint.columns[0] not in record.columns:
            # A gyroscope adds a bias to the rate, which drifts.
            parameters.append(_of_record(joint, index, "rate bias", "rad/s", 0.0, 1e-3))
            parameters.append(_of_record(joint, index, "rate drift", "rad/s²", 0.0, 1e-5))
    if drives == "motion":
        return parameters
    for joint in record.crane.layout.driven:
        column = joint.columns[0]
        if not record.moves(column):
            continue
        parameters += _initial_state(record, index, joint, _UNBOUNDED, 0.01)
        if drives == "hold" and joint.setpoint_column not in record.columns:
            # The drive is held at a setpoint that nobody recorded, about where it stands.
            mean = float(np.mean(record.columns[column]))
            setpoint = _of_record(joint, index, "setpoint", joint.unit, mean, 0.01)
            parameters.append(replace(setpoint, name=f"{joint.symbol}_setpoint"))
    return parameters


def _of_record(
    joint: Joint, index: int, kind: Kind, unit: str, start: float, scale: float
) -> Parameter:
    """Return an unbounded parameter of a joint in a record.

    Args:
        joint: The joint.
        index: Index of the record.
        kind: Kind of the parameter, which its name ends in.
        unit: Its unit.
        start: First value of the search.
        scale: Its typical change.
    """
    low, high = _UNBOUNDED
    return Parameter(
        name=f"{joint.symbol} {kind}",
        kind=kind,
        of=joint.symbol,
        unit=unit,
        start=start,
        low=low,
        high=high,
        scale=scale,
        record=index,
    )


def _initial_state(
    record: Record, index: int, joint: Joint, bounds: tuple[float, float], scale: float
) -> list[Parameter]:
    """Return the initial coordinate and rate of a joint, by a parabola through the first rows. Of a
    swing whose rate was recorded the coordinate follows from the slope of the rate.

    Args:
        record: The record.
        index: Its index.
        joint: The joint.
        bounds: Bounds of the coordinate.
        scale: Typical change of the coordinate and of the rate.
    """
    rows = max(_MIN_START_ROWS, int(np.searchsorted(record.t, _START_STRETCH)))
    column = record.swing_column(joint)
    _, slope, value = np.polyfit(record.t[:rows], record.columns[column][:rows], 2)
    if column == joint.columns[1]:
        # Of a free swing φ̈ = -ω² φ with ω = 2 π / period.
        rate = value
        position = -slope * (record.swing_period / (2.0 * math.pi)) ** 2
    else:
        rate = slope
        position = value
    low, high = bounds
    initial_position = Parameter(
        name=f"{joint.symbol}_start",
        kind="start",
        of=joint.symbol,
        unit=joint.unit,
        start=float(np.clip(position, low, high)),
        low=low,
        high=high,
        scale=scale,
        record=index,
    )
    initial_rate = _of_record(joint, index, "start rate", f"{joint.unit}/s", float(rate), scale)
    return [initial_position, replace(initial_rate, name=f"{joint.symbol}_dot_start")]
