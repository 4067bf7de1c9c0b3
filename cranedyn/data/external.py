"""Files of other programs: their columns under our names and in our units, as the user states them;
units are never guessed.

`cranedyn.data.logs` says which files can be read.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from cranedyn.data.logs import LoggedColumn, LoggedTable, open_log
from cranedyn.data.text_layout import is_unit, unit_in_brackets
from cranedyn.data.trajectory import check_increasing
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

_SPELLINGS = {
    "sec": "s",
    "seconds": "s",
    "µs": "us",
    "μs": "us",
    "°": "deg",
    "degree": "deg",
    "degrees": "deg",
    "radians": "rad",
    "°/s": "deg/s",
    "N·m": "Nm",
    "N m": "Nm",
    "kN·m": "kNm",
    "kN m": "kNm",
}
"""Our names of units by other names that files use."""

_SWINGS = ("phi_rad", "theta_rad")
"""Columns of swing angles."""

_LARGEST_SWING = math.pi / 2
"""Largest swing angle [rad]."""

_ROUND_OFF = 1e-9
"""Round-off of a time at which a record begins or ends [s]."""

SPARSE = 0.2
"""Share of empty cells above which a column belongs to another topic than the others, which reports
at times of its own."""

_LONGEST_GAP = 5.0
"""Longest time between values of a swing that is in some rows only, in usual ones."""

_ARGUMENT = re.compile(
    r"""(?P<column>\w+)=
    (?:"(?P<double>[^"]+)"|'(?P<single>[^']+)'|(?P<bare>(?:[^=\[\]]|\[[^\[\]]*\])+?))
    (?:\s*\[(?P<unit>[^\[\]]+)\])?""",
    re.VERBOSE,
)
"""An argument such as phi_rad=Swing[deg], with the name between quotation marks or not."""

Filling = Literal["hold", "interpolate"]
"""What stands in rows in which a column has no value, where rows of several topics are mixed: the
value before, or one on the straight line between those before and after."""


class Source(NamedTuple):
    """Column of a file.

    Attributes:
        name: Name in the file, or "#3" for the third column.
        unit: Unit in the file; empty for our unit.
        whole: Name and unit as they were given, which may be the name of a column, too; empty if
            only the name can be meant.
    """

    name: str
    unit: str = ""
    whole: str = ""


@dataclass(frozen=True, eq=False)
class ExternalTable:
    """Columns of a file of another program.

    Attributes:
        columns: The columns by our name and in our units, shape (rows,) each.
        remarks: What was decided about the file, a sentence each without its full stop.
    """

    columns: Mapping[str, np.ndarray]
    remarks: tuple[str, ...]


def parse_sources(arguments: Iterable[str]) -> dict[str, Source]:
    """Return sources by the name of our column from arguments such as ``phi_rad=Swing[deg]``,
    ``l_m=rope``, ``phi_rad="a [b]"[deg]`` or ``l_m=#3``.

    Raises:
        DataError: If an argument has another form, or a column is given twice.
        UnknownName: If a unit does not fit the column.
    """
    sources: dict[str, Source] = {}
    for argument in arguments:
        match = _ARGUMENT.fullmatch(argument)
        if match is None:
            raise DataError(
                f"{quoted(argument)} is not a column; it is given as phi_rad=NAME or "
                "phi_rad=NAME[deg]."
            )
        column = match["column"]
        unit = match["unit"] or ""
        bare = (match["bare"] or "").strip()
        name = match["double"] or match["single"] or bare
        # "angle [deg]" may be a name with its unit, or a name that ends so.
        whole = argument.partition("=")[2].strip() if bare and unit else ""
        source = Source(name.strip(), unit, whole)
        if column in sources:
            raise DataError(f"The column {column} is given twice; leave one out.")
        _factor(column, source.unit)
        sources[column] = source
    return sources


def read_external(
    path: str | Path, columns: Sequence[str], sources: Mapping[str, Source] | None = None
) -> dict[str, np.ndarray]:
    """Read columns of a file of another program, in our units; see `load_external`.

    Returns:
        The columns by our name, shape (rows,) each.
    """
    return dict(load_external(open_log(path), columns, sources).columns)


def load_external(
    log: LoggedTable,
    columns: Sequence[str],
    sources: Mapping[str, Source] | None = None,
    *,
    since: float = -math.inf,
    until: float = math.inf,
    filling: Filling = "interpolate",
) -> ExternalTable:
    """Read columns of a file of another program, in our units.

    Args:
        log: The file, see `cranedyn.data.logs.open_log`.
        columns: Our names of the columns needed.
        sources: Name and unit in the file by our name; a column that is not listed has our name and
            our unit.
        since: Time of the first row [s], on the clock of the file; earlier ones are not judged.
        until: Time of the last row [s].
        filling: What stands in rows in which a column has no value.

    Raises:
        DataError: If the file cannot be read, lacks a column, says another unit than the user,
            or a value is missing or not finite; if time does not increase, or a swing exceeds 90°.
        UnknownName: If a source is given for none of these columns, or its unit does not fit.
    """
    sources = sources or {}
    for column in sources:
        if column not in columns:
            raise UnknownName("needed column", column, columns)
    origin = {column: sources.get(column, Source(column)) for column in columns}
    indices = _indices(log, origin)
    doubts = [_check_unit(log, c, origin[c], indices[c]) for c in columns]
    times = [column == "t_s" for column in columns]
    found = dict(zip(columns, log.read(list(indices.values()), times), strict=True))
    remarks = [*log.remarks, *(c.remark for c in found.values() if c.remark)]
    remarks += [doubt for doubt in doubts if doubt]
    for column, values in found.items():
        # What is not finite, or no longer, is refused below.
        with np.errstate(invalid="ignore", over="ignore"):
            scaled = values.values * _factor(column, origin[column].unit)
        found[column] = LoggedColumn(scaled, values.empty)
    names = {column: printable(log.labels[index]) for column, index in indices.items()}
    rows = _rows_between(found, since, until)
    found = {c: LoggedColumn(v.values[rows], v.empty[rows]) for c, v in found.items()}
    _check_finite(log.path, found, names, rows)
    if any(column.empty.any() for column in found.values()):
        found = _filled(log.path, found, names, rows, filling, remarks)
    data = {column: values.values for column, values in found.items()}
    t = data.get("t_s")
    if t is not None:
        if len(t) < 2:
            raise DataError(
                f"{log.path} has too few rows, {len(t)} between the times asked for; it needs two "
                "rows or more."
            )
        check_increasing(t, names["t_s"], log.path, rows)
    _check_swings(log.path, data, names)
    return ExternalTable(data, tuple(remarks))


def _indices(log: LoggedTable, origin: Mapping[str, Source]) -> dict[str, int]:
    """Return the indices of columns in a file by our name.

    Raises:
        DataError: If the file lacks one.
    """
    indices: dict[str, int] = {}
    for column, source in origin.items():
        index = log.index(source.whole) if source.whole else None
        if index is None:
            index = log.index(source.name)
        if index is not None:
            indices[column] = index
    missing = [source.name for column, source in origin.items() if column not in indices]
    if missing:
        needed = ", ".join(source.name for source in origin.values())
        present = quoted(", ".join(log.labels))
        raise DataError(
            f"{log.path} has no column {', '.join(missing)}; needed are {needed}, it has {present}."
        )
    return indices


def _check_unit(log: LoggedTable, column: str, source: Source, index: int) -> str:
    """Return a remark if a file says another unit of a column than the user, who is believed; empty
    if there is nothing to remark.

    Raises:
        DataError: If the user says none and the file says another than ours.
    """
    written = log.units[index] or unit_in_brackets(log.names[index])
    factors = _unit_factors(column)
    theirs = _known_unit(written, factors)
    factor = _factor(column, source.unit)
    if factors.get(theirs) == factor:
        return ""
    label = printable(log.labels[index])
    if theirs not in factors:
        if source.unit or not factors or not is_unit(written):
            return ""
        raise DataError(
            f"{log.path} says that {quoted(label)} is in {quoted(written)}; allowed for {column} "
            f"are {', '.join(factors)}. Say the unit if the file is wrong: --columns "
            f"'{column}=\"{label}\"[{next(iter(factors), '')}]'."
        )
    if not source.unit:
        raise DataError(
            f"{log.path} says that {quoted(label)} is in {written}; say so, too: --columns "
            f"'{column}=\"{label}\"[{theirs}]'."
        )
    return f"{column} is taken in {source.unit} although the file says {printable(written)}"


def _known_unit(written: str, factors: Mapping[str, float]) -> str:
    """Return a unit as a file writes it by our name, whatever its case; as written if it is none
    of ours.
    """
    spelled = _SPELLINGS.get(written) or _SPELLINGS.get(written.lower(), written)
    if spelled in factors:
        return spelled
    for unit in factors:
        if unit.lower() == spelled.lower():
            return unit
    return spelled


def _rows_between(found: Mapping[str, LoggedColumn], since: float, until: float) -> np.ndarray:
    """Return the indices of the rows from one time to another that hold any value."""
    filled = ~np.all([column.empty for column in found.values()], axis=0)
    if "t_s" in found:
        t = found["t_s"].values
        if since > -math.inf or until < math.inf:
            filled &= (t >= since - _ROUND_OFF) & (t <= until + _ROUND_OFF)
    return np.flatnonzero(filled)


def _check_finite(
    path: Path, found: Mapping[str, LoggedColumn], names: Mapping[str, str], rows: np.ndarray
) -> None:
    """Check that all values that are there are finite, and that each row has a time.

    Raises:
        DataError: If one is not.
    """
    for column, values in found.items():
        wrong = ~values.empty & ~np.isfinite(values.values)
        if column == "t_s":
            wrong |= values.empty
        if wrong.any():
            raise DataError(
                f"{path}: column {names[column]} holds a value that is not finite, in data row "
                f"{rows[np.argmax(wrong)] + 1}."
            )


def _filled(
    path: Path,
    found: Mapping[str, LoggedColumn],
    names: Mapping[str, str],
    rows: np.ndarray,
    filling: Filling,
    remarks: list[str],
) -> dict[str, LoggedColumn]:
    """Return columns without empty cells, of a table in which several topics report at times of
    their own, as PlotJuggler writes it.

    Rows before the first and after the last value of any column are left out. Where values are
    held, the few empty cells of the fastest topic lie on straight lines between its values; else
    rows without a value of it are left out, too.

    Raises:
        DataError: If a column has values nowhere, a value is missing in a column of few empty
            cells, or a swing is missing for long.
    """
    sparse = [c for c, v in found.items() if v.empty.mean() > SPARSE]
    if not sparse or "t_s" not in found:
        _check_no_empty_cell(path, found, names, rows)
    t = found["t_s"].values
    if not (t[1:] > t[:-1]).all():
        raise DataError(f"{path}: {names['t_s']} must increase from row to row.")
    # The rows that count: those of the fastest topic, or all where a value is held, so that each
    # fresh value keeps its own time.
    rows_kept = np.ones(len(t), dtype=bool)
    required = _required_columns(found, sparse) if filling == "interpolate" else []
    for column in required:
        rows_kept &= ~found[column].empty
    filled: dict[str, LoggedColumn] = {}
    for column, values in found.items():
        present = np.flatnonzero(~values.empty)
        if len(present) == len(t):
            filled[column] = values
            continue
        longest = _check_gaps(path, column, names, t, present)
        rows_kept &= (t >= t[present[0]]) & (t <= t[present[-1]])
        if filling == "hold" and column in sparse:
            latest = np.searchsorted(present, np.arange(len(t)), side="right") - 1
            numbers = values.values[present[np.maximum(latest, 0)]]
            done = "the value before stands in the others"
        else:
            numbers = np.interp(t, t[present], values.values[present])
            done = "the others lie on straight lines between them"
            if column not in sparse or column in required:
                done = "rows without one are left out"
        filled[column] = LoggedColumn.full(numbers)
        remarks.append(
            f"{column} has values in {len(present)} of {len(t)} rows, at most {longest:.3g} s "
            f"apart; {done}"
        )
    return {c: LoggedColumn.full(v.values[rows_kept]) for c, v in filled.items()}


def _check_no_empty_cell(
    path: Path, found: Mapping[str, LoggedColumn], names: Mapping[str, str], rows: np.ndarray
) -> None:
    """Check that each column has a value in each row.

    Raises:
        DataError: If one has not.
    """
    for column, values in found.items():
        if values.empty.any():
            row = rows[np.argmax(values.empty)] + 1
            raise DataError(
                f"{path}: column {names[column]} is empty in data row {row}; fill the cell in, or "
                "leave the row out."
            )


def _required_columns(found: Mapping[str, LoggedColumn], sparse: Sequence[str]) -> list[str]:
    """Return the columns of the fastest topic: those with few empty cells, or, where all have
    many, the swing or else the column that has fewest.
    """
    required = [column for column in found if column not in sparse and column != "t_s"]
    return required or [min(sparse, key=lambda c: (c not in _SWINGS, found[c].empty.mean()))]


def _check_gaps(
    path: Path, column: str, names: Mapping[str, str], t: np.ndarray, present: np.ndarray
) -> float:
    """Return the longest time between values of a column that is in some rows only [s].

    Raises:
        DataError: If it has fewer than two values, or is a swing that is missing for long.
    """
    if len(present) < 2:
        raise DataError(
            f"{path}: column {names[column]} has {len(present)} values; needed are two."
        )
    gaps = np.diff(t[present])
    longest = float(gaps.max())
    usual = float(np.median(gaps))
    if column.startswith(("phi", "theta")) and longest > _LONGEST_GAP * usual:
        raise DataError(
            f"{path}: column {names[column]} has no value for {longest:.3g} s from "
            f"{names['t_s']} = {t[present[np.argmax(gaps)]]:g} s on; allowed are "
            f"{_LONGEST_GAP * usual:.3g} s, {_LONGEST_GAP:g} of its usual intervals."
        )
    return longest


def _check_swings(path: Path, data: Mapping[str, np.ndarray], names: Mapping[str, str]) -> None:
    """Check that no swing is beyond 90 degrees.

    Raises:
        DataError: If one is.
    """
    for column in _SWINGS:
        largest = float(np.abs(data[column]).max()) if column in data else 0.0
        if largest > _LARGEST_SWING:
            raise DataError(
                f"{path}: {names[column]} is {largest:.4g} rad in some row; a swing is "
                f"{_LARGEST_SWING:.4f} rad (90 degrees) at most. If the file has degrees, say so: "
                f"--columns {column}={names[column]}[deg]."
            )


def _unit_factors(column: str) -> Mapping[str, float]:
    """Return the factors to the unit of our column by unit."""
    ending = max((unit for unit in _FACTORS if column.endswith(f"_{unit}")), key=len, default="")
    return _FACTORS.get(ending, {})


def _factor(column: str, unit: str) -> float:
    """Return the factor from a unit, empty for ours, to the unit of our column."""
    factors = _unit_factors(column)
    if unit and unit not in factors:
        raise UnknownName(f"unit of {column}", unit, factors or ["none"])
    return factors.get(unit, 1.0)
