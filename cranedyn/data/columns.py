"""Names of the columns of a trajectory, which carry their units, such as ``x_dot_m_s``."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from cranedyn.errors import DataError

QUANTITIES = (
    "t",
    "q",
    "v",
    "setpoint",
    "command",
    "effort",
    "energy",
    "work",
    "dissipated",
    "force",
    "outside",
    "valid",
)
"""Arrays of every trajectory, in the order of their columns."""

BASE_COLUMNS = (
    "base_surge_m",
    "base_sway_m",
    "base_heave_m",
    "base_roll_rad",
    "base_pitch_rad",
    "base_yaw_rad",
)
"""Columns of the coordinates of a base that moves, see `cranedyn.disturbances.base_motion`."""

LOADS_COLUMN = "W_loads_J"
"""Column of the energy that attached loads have brought until then, less what released ones and
impacts have taken [J], see `cranedyn.simulation.stages`."""

_PATTERNS = {
    "v": re.compile(r"(?P<symbol>.+)_dot_(?P<unit>rad|m)_s"),
    "setpoint": re.compile(r"(?P<symbol>.+)_setpoint_(rad|m)"),
    "command": re.compile(r"[TF]_(?P<symbol>.+)_command_Nm?"),
    "force": re.compile(r"(?P<symbol>.+)_force_[xyz]_N"),
    "effort": re.compile(r"[TF]_(?P<symbol>.+)_Nm?"),
    "work": re.compile(r"W_(?P<symbol>.+)_J"),
    "q": re.compile(r"(?P<symbol>.+)_(?P<unit>rad|m)"),
}
"""Patterns of the names that contain a symbol; the first match counts."""


def trajectory_columns(
    units: Mapping[str, str],
    drives: Iterable[str],
    points: Iterable[str],
    *,
    rope: bool = False,
    base: bool = False,
    loads: bool = False,
) -> dict[str, tuple[str, ...]]:
    """Return the names of the columns of a trajectory by quantity.

    Args:
        units: Unit of each coordinate, "rad" or "m", by its symbol.
        drives: Symbols of the driven coordinates.
        points: Names of the points on which forces act.
        rope: Whether the rope may go slack, see `Trajectory.phase`.
        base: Whether the base moves, see `Trajectory.base`.
        loads: Whether loads are attached and released, see `cranedyn.simulation.stages`.
    """
    drives = list(drives)
    efforts = []
    commands = []
    for symbol in drives:
        letter, unit = ("T", "Nm") if units[symbol] == "rad" else ("F", "N")
        efforts.append(f"{letter}_{symbol}_{unit}")
        commands.append(f"{letter}_{symbol}_command_{unit}")
    forces = []
    for point in points:
        forces += [f"{point}_force_{axis}_N" for axis in "xyz"]
    outside = ["W_force_J", "W_buffers_J"]
    if rope:
        outside.append("W_impacts_J")
    if base:
        outside.append("W_base_J")
    if loads:
        outside.append(LOADS_COLUMN)
    columns = {
        "t": ("t_s",),
        "q": tuple(f"{symbol}_{unit}" for symbol, unit in units.items()),
        "v": tuple(f"{symbol}_dot_{unit}_s" for symbol, unit in units.items()),
        "setpoint": tuple(f"{symbol}_setpoint_{units[symbol]}" for symbol in drives),
        "command": tuple(commands),
        "effort": tuple(efforts),
        "energy": ("energy_J",),
        "work": tuple(f"W_{symbol}_J" for symbol in drives),
        "dissipated": ("dissipated_J",),
        "force": tuple(forces),
        "outside": tuple(outside),
        "valid": ("valid",),
    }
    if rope:
        columns["phase"] = ("phase",)
    if base:
        columns["base"] = BASE_COLUMNS
    return columns


_GENERAL_COLUMNS = frozenset(
    itertools.chain.from_iterable(
        trajectory_columns({}, (), (), rope=True, base=True, loads=True).values()
    )
)
"""Columns without the symbol of a joint, drive or point."""


def columns_by_quantity(names: Sequence[str], path: str | Path) -> dict[str, tuple[str, ...]]:
    """Return the columns of a trajectory by quantity, as found among the columns of a file.

    Args:
        names: Columns of the file; columns of no quantity are ignored.
        path: The file, for error messages.

    Raises:
        DataError: If a column of some joint, drive or point is missing while others of it are
            there, or there is no joint or no drive.
    """
    units: dict[str, dict[str, str]] = {quantity: {} for quantity in _PATTERNS}
    for name in names:
        if name in _GENERAL_COLUMNS:
            continue
        for quantity, pattern in _PATTERNS.items():
            match = pattern.fullmatch(name)
            if match is not None:
                units[quantity][match["symbol"]] = match.groupdict().get("unit", "m")
                break
    # Symbols in the order in which they are found; a dictionary keeps each once.
    drives: dict[str, None] = {}
    for quantity in ("setpoint", "command", "effort", "work"):
        drives |= dict.fromkeys(units[quantity])
    joints = units["q"] | units["v"]
    for symbol in drives:
        # A drive without a coordinate is missing below; its unit does not matter.
        joints.setdefault(symbol, "m")
    columns = trajectory_columns(
        joints,
        drives,
        units["force"],
        rope="phase" in names,
        base=any(name in names for name in BASE_COLUMNS),
        loads=LOADS_COLUMN in names,
    )
    missing = [
        name for name in itertools.chain.from_iterable(columns.values()) if name not in names
    ]
    if missing:
        raise DataError(
            f"{path} has no column {', '.join(missing)}; a complete record of these joints has it."
        )
    if not (joints and drives):
        raise DataError(
            f"{path} has columns of no joint, or of no drive; a record has those of one joint with "
            "a drive at least, such as x_m, x_dot_m_s and x_setpoint_m."
        )
    return columns
