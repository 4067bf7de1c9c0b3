"""Files recorded elsewhere: their columns under our names and in our units, which are said and
never guessed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cranedyn.checks import short_repr
from cranedyn.data.trajectory import read_columns
from cranedyn.errors import DataError, OutOfRange, UnknownName, printable, quoted

_UNITS = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "rad": {"rad": 1.0, "deg": math.pi / 180.0, "mrad": 1e-3},
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "ft": 0.3048},
    "rad_s": {"rad/s": 1.0, "deg/s": math.pi / 180.0, "mrad/s": 1e-3, "rpm": math.pi / 30.0},
    "m_s": {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "m/min": 1.0 / 60.0, "km/h": 1.0 / 3.6},
    "N": {"N": 1.0, "kN": 1e3},
    "Nm": {"Nm": 1.0, "kNm": 1e3},
    "J": {"J": 1.0, "kJ": 1e3},
}
"""By our unit, as it ends the name of a column: each unit that a file may have, and how many of
ours it is."""

_SWINGS, _UPRIGHT = ("phi_rad", "theta_rad"), math.pi / 2


class Source(NamedTuple):
    """Where a column of ours comes from.

    Attributes:
        name: What it is called in the file.
        unit: Its unit there; empty for ours.
    """

    name: str
    unit: str = ""


def parse_sources(words: Iterable[str]) -> dict[str, Source]:
    """Sources from words such as ``phi_rad=Swing[deg]`` or ``l_m=rope``, by the name of our column.

    Raises:
        DataError: If a word is none, or one column is given twice.
        UnknownName: If a unit is not one for this column.
    """
    found: dict[str, Source] = {}
    for word in words:
        match = re.fullmatch(r"(?P<ours>\w+)=(?P<name>[^=\[\]]+)(\[(?P<unit>[^\[\]]+)\])?", word)
        if match is None:
            raise DataError(
                f"{quoted(word)} is not a column; it is given as phi_rad=NAME or phi_rad=NAME[deg]."
            )
        if match["ours"] in found:
            raise DataError(f"The column {match['ours']} is given twice; leave one out.")
        found[match["ours"]] = source = Source(match["name"].strip(), match["unit"] or "")
        _factor(match["ours"], source)
    return found


def read_elsewhere(
    path: str | Path, columns: Sequence[str], sources: Mapping[str, Source] | None = None
) -> dict[str, np.ndarray]:
    """Read columns of a file recorded elsewhere, in our units.

    Args:
        path: A ``.csv`` or ``.parquet`` file.
        columns: Our names of those needed.
        sources: What some of them are called there and in which unit, by our name; the others have
            our name and our unit.

    Returns:
        The columns by our name, shape (n,) each.

    Raises:
        DataError: As `cranedyn.data.trajectory.read_columns`; if time does not increase, or a swing
            is beyond 90°.
        UnknownName: If a source is given for none of these columns, or has a unit that is none for
            it.
        OutOfRange: If a source is no `Source`.
    """
    sources = sources or {}
    for ours in sources:
        if ours not in columns:
            raise UnknownName("needed column", ours, columns)
    for ours, source in sources.items():
        if not isinstance(source, Source):
            raise OutOfRange(f"source of {ours}", short_repr(source), "a Source")
    each = {ours: sources.get(ours, Source(ours)) for ours in columns}
    found = read_columns(path, list(dict.fromkeys(source.name for source in each.values())))
    data = {ours: found[source.name] * _factor(ours, source) for ours, source in each.items()}
    t = data.get("t_s")
    if t is not None and not (len(t) > 1 and (t[1:] > t[:-1]).all()):
        raise DataError(
            f"{path}: {printable(each['t_s'].name)} must increase from row to row, over two rows "
            "at least."
        )
    for ours in _SWINGS:
        if ours in data and (most := float(np.abs(data[ours]).max())) > _UPRIGHT:
            name = printable(each[ours].name)
            raise DataError(
                f"{path}: {name} is {most:.4g} rad in some row; a swing is {_UPRIGHT:.4f} rad (90 "
                "degrees) at most. "
                f"If the file has degrees, say so: --columns {ours}={name}[deg]."
            )
    return data


def _factor(ours: str, source: Source) -> float:
    """How many of our units one of the file's is."""
    ending = next(
        (unit for unit in sorted(_UNITS, key=len, reverse=True) if ours.endswith(f"_{unit}")), ""
    )
    known = _UNITS.get(ending, {})
    if source.unit and source.unit not in known:
        raise UnknownName(f"unit of {ours}", source.unit, known or ["none"])
    return known[source.unit] if source.unit else 1.0
