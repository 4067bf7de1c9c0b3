"""What can be identified: arguments of the crane, and how its drives and sensors are off."""

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
"""How the drives of a record are made again: their motion is prescribed, their recorded efforts
act, or a hold controller holds them at their setpoints."""

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
"""Ends of what is looked for as a delay of the swing sensor [s]."""


@dataclass(frozen=True)
class Parameter:
    """Something to be found.

    Attributes:
        name: What it is called.
        kind: What it is.
        of: Symbol of the coordinate that it belongs to, or name of the argument; may be empty.
        unit: Its unit.
        start: Where the search begins.
        low, high: Between what it must be.
        scale: A usual size of a change of it.
        record: Of which record alone it is; None if of the crane. What is of one record is
            found beside the rest and not spoken of.
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
    """What a name stands for.

    Args:
        prior: Prior knowledge of the crane.
        name: ``delay``; ``l_offset``, ``x_lag``, ``x_friction``, ``x_stiffness`` or ``x_damping``
            of any drive; ``phi_bias`` of any swing; or an argument of the description or
            ``gravity``.

    Raises:
        UnknownName: If it stands for nothing.
    """
    if name == "delay":
        return Parameter(name, "delay", "", "s", 0.0, EARLY, LATE, 0.1)
    layout = prior.crane.layout
    symbol, _, kind = name.rpartition("_")
    drives = {joint.symbol: i for i, joint in enumerate(layout.driven)}
    if symbol in drives and (made := _of_drive(prior, drives[symbol], kind, name)) is not None:
        return made
    swings = [layout.joints[i].symbol for i in prior.crane.swings.tolist()]
    if symbol in swings and kind == "bias":
        return Parameter(name, "bias", symbol, "rad", 0.0, -0.3, 0.3, 0.01)
    if name in prior.arguments:
        first, one = prior.value(name), prior.arguments[name]
        low = {"any": -math.inf, "> 0": 1e-3 * first, ">= 0": 0.0}[one.allowed]
        scale = 0.1 * abs(first) or 1.0
        return Parameter(name, "argument", name, one.unit, first, low, math.inf, scale)
    raise UnknownName("parameter", name, names(prior))


def names(prior: Prior) -> list[str]:
    """Names of all that can be identified."""
    layout = prior.crane.layout
    kinds = ("offset", "lag", "friction", "stiffness", "damping")
    return [
        "delay",
        *(f"{joint.symbol}_{kind}" for joint in layout.driven for kind in kinds),
        *(f"{layout.joints[i].symbol}_bias" for i in prior.crane.swings.tolist()),
        *prior.arguments,
    ]


def usual(prior: Prior, records: Sequence[Record], drives: Drives) -> list[str]:
    """Names of what is identified if nothing is said: whatever the columns could tell."""
    layout = prior.crane.layout
    found = ["l_offset"] if layout.has("hoist") and layout.symbols.count("l") else []
    found += [name for name in ("damp_swing",) if name in prior.arguments]
    found += ["delay"] if drives == "motion" else []
    biased = {joint.symbol for record in records for joint in record.swings}
    found += [f"{symbol}_bias" for symbol in layout.symbols if symbol in biased]
    for joint in layout.driven:
        moved = any(record.moves(joint.columns[0]) for record in records)
        aimed = any(record.moves(joint.setpoint_column) for record in records)
        effort = any(record.moves(joint.effort_column) for record in records)
        if drives == "motion" and aimed:
            found.append(f"{joint.symbol}_lag")
        if effort and joint.role == "hoist" and "payload_mass" in prior.arguments:
            found.append("payload_mass")
        if drives == "motion" and effort and (moved or aimed) and joint.role == "trolley":
            found.append(f"{joint.symbol}_friction")
        if drives == "hold":
            found += [f"{joint.symbol}_{gain}" for gain in ("stiffness", "damping") if moved]
    return found


def starts(record: Record, index: int, drives: Drives) -> list[Parameter]:
    """How a record begins, which is found beside the rest: its swing, and drives that nobody
    prescribes.
    """
    crane, found = record.crane, list[Parameter]()
    for joint in record.swings:
        found += _start(record, index, joint, record.crane.swings.tolist(), 0.02)
    if drives == "motion":
        return found
    for joint in crane.layout.driven:
        column = joint.columns[0]
        if record.moves(column):
            found += _start(record, index, joint, crane.layout.drives.tolist(), 0.01)
            if drives == "hold" and joint.setpoint_column not in record.columns:
                mean = float(np.mean(record.columns[column]))
                found.append(
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
    return found


def _start(
    record: Record, index: int, joint: Joint, among: Sequence[int], scale: float
) -> list[Parameter]:
    """Coordinate and rate of a joint at the first row, by a parabola through the first rows."""
    rows = max(4, int(np.searchsorted(record.t, 0.8)))
    values = record.columns[joint.columns[0]][:rows]
    _, rate, place = np.polyfit(record.t[:rows], values, 2)
    ends = (-1.5, 1.5) if joint.kind == "revolute" and not joint.driven else (-math.inf, math.inf)
    symbol, unit = joint.symbol, joint.unit
    return [
        Parameter(
            f"{symbol}_start", "start", symbol, unit, float(np.clip(place, *ends)), *ends, scale,
            index,
        ),
        Parameter(
            f"{symbol}_dot_start", "start rate", symbol, f"{unit}/s", float(rate), -math.inf,
            math.inf, scale, index,
        ),
    ]  # fmt: skip


def _of_drive(prior: Prior, drive: int, kind: str, name: str) -> Parameter | None:
    joint = prior.crane.layout.driven[drive]
    at = int(prior.crane.layout.drives[drive])
    width = float(prior.crane.upper[at] - prior.crane.lower[at])
    symbol, unit, effort = joint.symbol, joint.unit, joint.effort_unit
    if kind == "offset":
        reach = 0.25 * width
        return Parameter(name, "offset", symbol, unit, 0.0, -reach, reach, 0.1)
    if kind == "lag":
        return Parameter(name, "lag", symbol, "s", 0.1, 1e-3, 5.0, 0.1)
    if kind == "friction":
        most = float(prior.crane.effort_limit[drive])
        return Parameter(name, "friction", symbol, effort, 1e-4 * most, 0.0, most, 1e-3 * most)
    if kind in ("stiffness", "damping"):
        gain = float(getattr(hold_controller(prior.crane), kind)[drive])
        per = f"{effort}/{unit}" if kind == "stiffness" else f"{effort} s/{unit}"
        made: Kind = "stiffness" if kind == "stiffness" else "damping"
        return Parameter(name, made, symbol, per, gain, 1e-2 * gain, 1e2 * gain, 0.1 * gain)
    return None
