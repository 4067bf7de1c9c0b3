"""Files of other programs: their columns under our names and in our units, as the user states them;
units are never guessed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cranedyn.data.trajectory import check_increasing, read_columns
from cranedyn.errors import DataError, UnknownName, printable, quoted

_FACTORS = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "rad": {"rad": 1.0, "deg": math.pi / 180.0, "mrad": 1e-3},
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "ft": 0.3048},
    "rad_s": {"rad/s": 1.0, "deg/s": math.pi / 180.0, "mrad/s": 1e-3, "rpm": math.pi / 30.0},
    "m_s": {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "m/min": 1.0 / 60.0, "km/h": 1.0 / 3.6},
    "N": {"N": 1.0, "kN": 1e3},
    "Nm": {"Nm": 1.0, "kNm": 1e3},
    "J": {"J": 1.0, "kJ": 1e3},
}
"""Conversion factors to our unit, which ends the name of a column, by the unit of a file."""

_SWINGS, _LARGEST_SWING = ("phi_rad", "theta_rad"), math.pi / 2


class Source(NamedTuple):
    """Column of a file.

    Attributes:
        name: Name in the file.
        unit: Unit in the file; empty for our unit.
    """

    name: str
    unit: str = ""


def parse_sources(arguments: Iterable[str]) -> dict[str, Source]:
    """Return sources by the name of our column from arguments such as ``phi_rad=Swing[deg]`` or
    ``l_m=rope``.

    Raises:
        DataError: If an argument has another form, or a column is given twice.
        UnknownName: If a unit does not fit the column.
    """
    sources: dict[str, Source] = {}
    for argument in arguments:
        match = re.fullmatch(
            r"(?P<column>\w+)=(?P<name>[^=\[\]]+)(\[(?P<unit>[^\[\]]+)\])?", argument
        )
        if match is None:
            raise DataError(
                f"{quoted(argument)} is not a column; it is given as phi_rad=NAME or "
                "phi_rad=NAME[deg]."
            )
        column, source = match["column"], Source(match["name"].strip(), match["unit"] or "")
        if column in sources:
            raise DataError(f"The column {column} is given twice; leave one out.")
        _factor(column, source)
        sources[column] = source
    return sources


def read_external(
    path: str | Path, columns: Sequence[str], sources: Mapping[str, Source] | None = None
) -> dict[str, np.ndarray]:
    """Read columns of a file of another program, in our units.

    Args:
        path: A ``.csv`` or ``.parquet`` file.
        columns: Our names of the columns needed.
        sources: Name and unit in the file by our name; a column that is not listed has our name and
            our unit.

    Returns:
        The columns by our name, shape (rows,) each.

    Raises:
        DataError: As `cranedyn.data.trajectory.read_columns`; if time does not increase, or a swing
            exceeds 90°.
        UnknownName: If a source is given for none of these columns, or its unit does not fit.
    """
    sources = sources or {}
    for column in sources:
        if column not in columns:
            raise UnknownName("needed column", column, columns)
    origin = {column: sources.get(column, Source(column)) for column in columns}
    values = read_columns(path, list(dict.fromkeys(source.name for source in origin.values())))
    data = {
        column: values[source.name] * _factor(column, source) for column, source in origin.items()
    }
    t = data.get("t_s")
    if t is not None:
        if len(t) < 2:
            raise DataError(f"{path} has too few rows, {len(t)}; it needs two rows or more.")
        check_increasing(t, printable(origin["t_s"].name), path)
    for column in _SWINGS:
        largest = float(np.abs(data[column]).max()) if column in data else 0.0
        if largest > _LARGEST_SWING:
            name = printable(origin[column].name)
            raise DataError(
                f"{path}: {name} is {largest:.4g} rad in some row; a swing is {_LARGEST_SWING:.4f} "
                "rad (90 degrees) at most. If the file has degrees, say so: "
                f"--columns {column}={name}[deg]."
            )
    return data


def _factor(column: str, source: Source) -> float:
    """Return the factor from the unit of a source to the unit of our column."""
    ending = max((unit for unit in _FACTORS if column.endswith(f"_{unit}")), key=len, default="")
    factors = _FACTORS.get(ending, {})
    if source.unit and source.unit not in factors:
        raise UnknownName(f"unit of {column}", source.unit, factors or ["none"])
    return factors.get(source.unit, 1.0)
