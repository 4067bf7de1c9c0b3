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

_UNIT_FACTORS = {
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

_MAX_SWING = math.pi / 2
"""Largest swing angle [rad]."""

_TIME_TOLERANCE = 1e-9
"""Round-off of a time at which a record begins or ends [s]."""

SPARSE = 0.2
"""Share of empty cells of a column above which it is taken for that of a topic that reports at
times of its own; below it an empty cell is a missing value."""

_MAX_GAP_RATIO = 5.0
"""Longest allowed time between two values of a swing that is in some rows only, over the median of
these times."""

_ARGUMENT = re.compile(
    r"""(?P<column>\w+)=
    (?:"(?P<double>[^"]+)"|'(?P<single>[^']+)'|(?P<bare>(?:[^=\[\]]|\[[^\[\]]*\])+?))
    (?:\s*\[(?P<unit>[^\[\]]+)\])?""",
    re.VERBOSE,
)
"""An argument such as phi_rad=Swing[deg], with the name between quotation marks or not."""

Filling = Literal["hold", "interpolate"]
"""How the rows of a column without a value are filled, where rows of several topics are mixed.

"hold" repeats the value before, "interpolate" takes the straight line between the values before
and after.
"""


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
    origins = {column: sources.get(column, Source(column)) for column in columns}
    indices = _indices(log, origins)
    unit_remarks = []
    for column in columns:
        remark = _check_unit(log, column, origins[column], indices[column])
        if remark:
            unit_remarks.append(remark)
    table, read_remarks = _read_in_our_units(log, origins, indices)
    remarks = [*log.remarks, *read_remarks, *unit_remarks]
    names = {column: printable(log.labels[index]) for column, index in indices.items()}
    rows = _rows_between(table, since, until)
    for column, values in table.items():
        table[column] = LoggedColumn(values.values[rows], values.empty[rows])
    _check_finite(log.path, table, names, rows)
    if any(column.empty.any() for column in table.values()):
        table = _filled(log.path, table, names, rows, filling, remarks)
    data = {column: values.values for column, values in table.items()}
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


def _read_in_our_units(
    log: LoggedTable, origins: Mapping[str, Source], indices: Mapping[str, int]
) -> tuple[dict[str, LoggedColumn], list[str]]:
    """Return columns by our name in our units, and what was decided about them.

    Args:
        log: The file.
        origins: Name and unit in the file of each column, by our name.
        indices: Index in the file of each column, by our name.
    """
    may_be_times = [column == "t_s" for column in origins]
    logged = log.read(list(indices.values()), may_be_times)
    table: dict[str, LoggedColumn] = {}
    remarks = []
    for (column, source), values in zip(origins.items(), logged, strict=True):
        # A number that is not finite, or no longer once it is converted, is refused later.
        with np.errstate(invalid="ignore", over="ignore"):
            converted = values.values * _factor(column, source.unit)
        table[column] = LoggedColumn(converted, values.empty)
        if values.remark:
            remarks.append(values.remark)
    return table, remarks


def _indices(log: LoggedTable, origins: Mapping[str, Source]) -> dict[str, int]:
    """Return the indices of columns in a file by our name.

    Raises:
        DataError: If the file lacks one.
    """
    indices: dict[str, int] = {}
    for column, source in origins.items():
        index = log.index(source.whole) if source.whole else None
        if index is None:
            index = log.index(source.name)
        if index is not None:
            indices[column] = index
    missing = [source.name for column, source in origins.items() if column not in indices]
    if missing:
        needed = ", ".join(source.name for source in origins.values())
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
    unit_of_file = log.units[index] or unit_in_brackets(log.names[index])
    factors = _unit_factors(column)
    known_unit = _known_unit(unit_of_file, factors)
    if factors.get(known_unit) == _factor(column, source.unit):
        return ""
    label = printable(log.labels[index])
    if known_unit not in factors:
        # What stands in brackets may be no unit at all, as in "position (filtered)".
        if source.unit or not factors or not is_unit(unit_of_file):
            return ""
        raise DataError(
            f"{log.path} says that {quoted(label)} is in {quoted(unit_of_file)}; allowed for "
            f"{column} are {', '.join(factors)}. Say the unit if the file is wrong: --columns "
            f"'{column}=\"{label}\"[{next(iter(factors), '')}]'."
        )
    if not source.unit:
        raise DataError(
            f"{log.path} says that {quoted(label)} is in {unit_of_file}; say so, too: --columns "
            f"'{column}=\"{label}\"[{known_unit}]'."
        )
    return f"{column} is taken in {source.unit} although the file says {printable(unit_of_file)}"


def _known_unit(unit_of_file: str, factors: Mapping[str, float]) -> str:
    """Return our name of the unit that a file writes, whatever its case; the unit as the file
    writes it if it is none of ours.
    """
    spelled = _SPELLINGS.get(unit_of_file) or _SPELLINGS.get(unit_of_file.lower(), unit_of_file)
    if spelled in factors:
        return spelled
    for unit in factors:
        if unit.lower() == spelled.lower():
            return unit
    return spelled


def _rows_between(table: Mapping[str, LoggedColumn], since: float, until: float) -> np.ndarray:
    """Return the indices of the rows from one time [s] to another that hold any value."""
    is_empty = np.all([column.empty for column in table.values()], axis=0)
    is_wanted = ~is_empty
    is_bounded = since > -math.inf or until < math.inf
    if "t_s" in table and is_bounded:
        # Rows without a time go, too: a comparison with NaN is false.
        t = table["t_s"].values
        is_wanted &= (t >= since - _TIME_TOLERANCE) & (t <= until + _TIME_TOLERANCE)
    return np.flatnonzero(is_wanted)


def _check_finite(
    path: Path, table: Mapping[str, LoggedColumn], names: Mapping[str, str], rows: np.ndarray
) -> None:
    """Check that all values that are there are finite, and that each row has a time.

    Raises:
        DataError: If one is not.
    """
    for column, values in table.items():
        is_wrong = ~values.empty & ~np.isfinite(values.values)
        if column == "t_s":
            is_wrong |= values.empty
        if is_wrong.any():
            first_wrong = rows[np.argmax(is_wrong)]
            raise DataError(
                f"{path}: column {names[column]} holds a value that is not finite, in data row "
                f"{first_wrong + 1}."
            )


def _filled(
    path: Path,
    table: Mapping[str, LoggedColumn],
    names: Mapping[str, str],
    rows: np.ndarray,
    filling: Filling,
    remarks: list[str],
) -> dict[str, LoggedColumn]:
    """Return the columns of a table without empty cells.

    Empty cells are usual where several topics report at times of their own, as PlotJuggler writes
    them into one table. Rows before the first and after the last value of any column are left out.
    Where values are held, the few empty cells of the fastest topic are filled by straight lines
    between its values. Where they are interpolated, rows without a value of the fastest topic are
    left out, too.

    Args:
        path: The file, for error messages.
        table: The columns by our name.
        names: Their names in the file, by our name.
        rows: Indices in the file of their rows.
        filling: What stands in rows in which a column has no value.
        remarks: Remarks on the file; those on each filled column are added.

    Raises:
        DataError: If a column has values nowhere, a value is missing in a column of few empty
            cells, or a swing is missing for long.
    """
    sparse = [column for column, values in table.items() if values.empty.mean() > SPARSE]
    if not sparse or "t_s" not in table:
        _check_no_empty_cell(path, table, names, rows)
    t = table["t_s"].values
    if not (t[1:] > t[:-1]).all():
        raise DataError(f"{path}: {names['t_s']} must increase from row to row.")

    # The rows that count: those of the fastest topic, or all where a value is held, so that each
    # fresh value keeps its own time.
    is_kept = np.ones(len(t), dtype=bool)
    required = _required_columns(table, sparse) if filling == "interpolate" else []
    for column in required:
        is_kept &= ~table[column].empty

    filled: dict[str, np.ndarray] = {}
    for column, values in table.items():
        present = np.flatnonzero(~values.empty)
        if len(present) == len(t):
            filled[column] = values.values
            continue
        longest = _check_gaps(path, column, names, t, present)
        is_kept &= (t >= t[present[0]]) & (t <= t[present[-1]])
        if filling == "hold" and column in sparse:
            filled[column] = _held(values.values, present)
            decision = "the value before stands in the others"
        else:
            filled[column] = np.interp(t, t[present], values.values[present])
            decision = "the others lie on straight lines between them"
            if column in required:
                decision = "rows without one are left out"
        remarks.append(
            f"{column} has values in {len(present)} of {len(t)} rows, at most {longest:.3g} s "
            f"apart; {decision}"
        )
    return {column: LoggedColumn.full(numbers[is_kept]) for column, numbers in filled.items()}


def _held(values: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Return values in which each that is missing is the one before; the first one stands in the
    rows before it.

    Args:
        values: The values, shape (rows,).
        present: Indices of the rows that have one.
    """
    places = np.searchsorted(present, np.arange(len(values)), side="right") - 1
    return values[present[np.maximum(places, 0)]]


def _check_no_empty_cell(
    path: Path, table: Mapping[str, LoggedColumn], names: Mapping[str, str], rows: np.ndarray
) -> None:
    """Check that each column has a value in each row.

    Raises:
        DataError: If one has not.
    """
    for column, values in table.items():
        if values.empty.any():
            row = rows[np.argmax(values.empty)] + 1
            raise DataError(
                f"{path}: column {names[column]} is empty in data row {row}; fill the cell in, or "
                "leave the row out."
            )


def _required_columns(table: Mapping[str, LoggedColumn], sparse: Sequence[str]) -> list[str]:
    """Return the columns of the fastest topic: those with few empty cells, or, where all have
    many, the swing or else the column that has fewest.
    """
    required = [column for column in table if column not in sparse and column != "t_s"]
    if required:
        return required
    swings = [column for column in sparse if column in _SWINGS]
    return [min(swings or sparse, key=lambda column: table[column].empty.mean())]


def _check_gaps(
    path: Path, column: str, names: Mapping[str, str], t: np.ndarray, present: np.ndarray
) -> float:
    """Return the longest time between values of a column that is in some rows only [s].

    Args:
        path: The file, for error messages.
        column: Our name of the column.
        names: Names of columns in the file by our name.
        t: Times of all rows [s].
        present: Indices of the rows that have a value.

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
    allowed = _MAX_GAP_RATIO * usual
    if column.startswith(("phi", "theta")) and longest > allowed:
        begin = t[present[np.argmax(gaps)]]
        raise DataError(
            f"{path}: column {names[column]} has no value for {longest:.3g} s from "
            f"{names['t_s']} = {begin:g} s on; allowed are {allowed:.3g} s, {_MAX_GAP_RATIO:g} of "
            "its usual intervals."
        )
    return longest


def _check_swings(path: Path, data: Mapping[str, np.ndarray], names: Mapping[str, str]) -> None:
    """Check that no swing is beyond 90 degrees.

    Raises:
        DataError: If one is.
    """
    for column in _SWINGS:
        if column not in data:
            continue
        largest = float(np.abs(data[column]).max())
        if largest > _MAX_SWING:
            raise DataError(
                f"{path}: {names[column]} is {largest:.4g} rad in some row; a swing is "
                f"{_MAX_SWING:.4f} rad (90 degrees) at most. If the file has degrees, say so: "
                f"--columns {column}={names[column]}[deg]."
            )


def _unit_factors(column: str) -> Mapping[str, float]:
    """Return the factors to the unit of our column by unit; none for a column without a unit."""
    endings = [unit for unit in _UNIT_FACTORS if column.endswith(f"_{unit}")]
    ending = max(endings, key=len, default="")  # x_dot_rad_s ends with _s, too
    return _UNIT_FACTORS.get(ending, {})


def _factor(column: str, unit: str) -> float:
    """Return the factor from a unit, empty for ours, to the unit of our column."""
    factors = _unit_factors(column)
    if unit and unit not in factors:
        raise UnknownName(f"unit of {column}", unit, factors or ["none"])
    return factors.get(unit, 1.0)
