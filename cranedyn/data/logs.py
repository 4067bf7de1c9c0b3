"""Tables as programs log them, in any supported format: named columns of numbers.

`open_log` finds the format of a file by its content and its ending. Each format is one function of
`FORMATS`, which returns a `LoggedTable`: names, units, and a function that reads columns. What was
decided about the file is said in `LoggedTable.remarks`, and what is ambiguous is refused.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from cranedyn.data.bounded import BoundedResult, Kind, read_bounded
from cranedyn.data.clock_times import clock_seconds
from cranedyn.data.files import open_file, read_bytes
from cranedyn.data.tables import (
    TextFormat,
    arrow_errors,
    csv_columns,
    parquet_columns,
    parquet_schema,
)
from cranedyn.data.text_layout import (
    BLANKS,
    SAMPLE,
    HeaderLine,
    TextLayout,
    not_a_table,
    table_header,
    text_layout,
)
from cranedyn.data.workbooks import Sheet, read_sheets
from cranedyn.errors import DataError, quoted

LARGEST_RECODED = 200_000_000
"""Largest text that is not UTF-8, or has blanks as delimiters, and is written anew in memory
before it is read [byte]."""

_WORKBOOK_ENDINGS = (".xlsx", ".xlsm", ".xlsb", ".xls", ".ods")
"""Endings of workbooks."""

_HDF5_ENDINGS = (".h5", ".hdf5", ".hdf")
"""Endings of HDF5 files."""

_HDF5_MARK = b"\x89HDF"
"""First bytes of an HDF5 file; MATLAB puts 512 bytes of its own in front of them."""

_OLD_WORKBOOK_MARK = b"\xd0\xcf\x11\xe0"
"""First bytes of a workbook in the format of .xls."""

_ZIP_MARK = b"PK\x03\x04"
"""First bytes of a ZIP archive; workbooks are archives, too."""

_PACKED_MARKS = (b"\x1f\x8b", b"\x28\xb5\x2f\xfd", b"BZh", b"7z\xbc\xaf")
"""First bytes of other packed files: gzip, Zstandard, bzip2 and 7-Zip."""


@dataclass(frozen=True, eq=False)
class LoggedColumn:
    """Column of a file of another program.

    Attributes:
        values: Numbers, not finite where the file says so or a cell is empty, shape (rows,).
        empty: Whether a cell is empty, shape (rows,).
        remark: What was decided about the column, a sentence; may be empty.
    """

    values: np.ndarray
    empty: np.ndarray
    remark: str = ""

    @classmethod
    def full(cls, values: np.ndarray) -> LoggedColumn:
        """Return a column without empty cells."""
        return cls(values, np.zeros(len(values), dtype=bool))


@dataclass(frozen=True, eq=False)
class LoggedTable:
    """Table of a file of another program, whose columns are read when they are asked for.

    Attributes:
        path: The file.
        names: Names of the columns; empty where one has none.
        units: Units of the columns in a row of their own; empty where there is none.
        remarks: What was decided about the file, a sentence each.
        read: Function that reads columns of some indices; with whether each may hold times such as
            10:15:30, which become seconds.
    """

    path: Path
    names: tuple[str, ...]
    units: tuple[str, ...]
    remarks: tuple[str, ...]
    read: Callable[[Sequence[int], Sequence[bool]], list[LoggedColumn]]

    def index(self, name: str) -> int | None:
        """Return the index of a column by its name or by its number, as in "#3"; None if there is
        none.

        Raises:
            DataError: If there are several of this name.
        """
        count = self.names.count(name)
        if count > 1:
            first = self.names.index(name) + 1
            raise DataError(
                f"{self.path} has {count} columns {quoted(name)}; needed is one. Say which by its "
                f"number, as in #{first}."
            )
        if count == 1:
            return self.names.index(name)
        if re.fullmatch(r"#\d{1,5}", name) and 1 <= int(name[1:]) <= len(self.names):
            return int(name[1:]) - 1
        return None

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the columns, and numbers of those without a name."""
        return tuple(name or f"#{i}" for i, name in enumerate(self.names, start=1))


def open_log(path: str | Path) -> LoggedTable:
    """Open a file of another program.

    Raises:
        DataError: If it cannot be read, or is no table.
        CraneError: If a library that reads such files is not installed.
    """
    path = Path(path)
    return FORMATS[find_format(path)](path)


def find_format(path: Path) -> str:
    """Return the format of a file, a key of `FORMATS`, by its first bytes and its ending.

    Raises:
        DataError: If it cannot be read, or is in a format that is not supported.
    """
    with open_file(path) as file:
        head = file.read(520)
    ending = path.suffix.lower()
    if head.startswith(b"PAR1") or ending == ".parquet":
        return "parquet"
    if head.startswith(_HDF5_MARK) or head[512:].startswith(_HDF5_MARK) or ending in _HDF5_ENDINGS:
        return "hdf5"
    if head.startswith(b"MATLAB 5.0") or ending == ".mat":
        return "mat"
    if head.startswith(_OLD_WORKBOOK_MARK) or ending in _WORKBOOK_ENDINGS:
        return "workbook"
    if head.startswith((_ZIP_MARK, *_PACKED_MARKS)):
        raise DataError(f"Cannot read {path}: it is packed; unpack it first.")
    if head.startswith(b"SQLite format 3"):
        raise DataError(
            f"Cannot read {path} as a table: it is a database. A recording of ROS 2 has the ending "
            ".db3."
        )
    return "text"


# --- text -----------------------------------------------------------------------------------------


def _open_text(path: Path) -> LoggedTable:
    """Open a text table, such as CSV."""
    with open_file(path) as file:
        sample = file.read(SAMPLE)
        complete = os.fstat(file.fileno()).st_size <= len(sample)
    if not sample.strip():
        raise DataError(f"Cannot read {path}: Empty CSV file.")
    try:
        layout = text_layout(sample, complete=complete)
    except ValueError as error:
        raise not_a_table(path, error) from None
    return LoggedTable(
        path, layout.names, layout.units, layout.remarks, partial(_read_text, path, layout)
    )


def _read_text(
    path: Path, layout: TextLayout, indices: Sequence[int], may_be_times: Sequence[bool]
) -> list[LoggedColumn]:
    """Read columns of a text table."""
    _check_clocks(path, layout.names, layout.clocks, indices, may_be_times)
    content = None
    if layout.encoding not in ("utf-8", "utf-8-sig") or layout.delimiter == BLANKS:
        content = _recoded(read_bytes(path, LARGEST_RECODED), layout)
    text_format = TextFormat(
        delimiter=layout.delimiter,
        decimal=layout.decimal,
        labels=[name or f"#{i}" for i, name in enumerate(layout.names, start=1)],
        first_line=layout.first_line,
        words=layout.clocks & set(indices),
    )
    columns = []
    arrays = csv_columns(path, indices, text_format, content)
    for index, array in zip(indices, arrays, strict=True):
        empty = array.is_null().to_numpy(zero_copy_only=False)
        if index not in layout.clocks:
            columns.append(LoggedColumn(array.to_numpy(zero_copy_only=False), empty))
            continue
        texts = [(text or "").strip() for text in array.to_pylist()]
        columns.append(_clock_column(path, layout.names[index] or f"#{index + 1}", texts))
    return columns


def _recoded(content: bytes, layout: TextLayout) -> bytes:
    """Return a text as UTF-8, and with one blank between cells where blanks separate them."""
    text = content.decode(layout.encoding, "replace")
    if layout.delimiter == BLANKS:
        lines = re.split(r"\r\n|\n|\r", text)
        text = "\n".join(" ".join(line.split()) for line in lines)
    return text.encode()


def _clock_column(path: Path, name: str, texts: Sequence[str]) -> LoggedColumn:
    """Return a column of times such as 10:15:30 in seconds."""
    try:
        seconds = clock_seconds(texts)
    except ValueError as error:
        raise DataError(f"{path}: column {quoted(name)}: {error}.") from None
    empty = np.array([not text for text in texts], dtype=bool)
    first = next(filter(None, texts), "")
    has_date = re.match(r"\d+[-./]\d+[-./]", first)
    origin = f"from {first}" if has_date else "from 0:00:00"
    return LoggedColumn(seconds, empty, f"times count in seconds {origin}")


def _check_clocks(
    path: Path,
    names: Sequence[str],
    clocks: frozenset[int],
    indices: Sequence[int],
    may_be_times: Sequence[bool],
) -> None:
    """Check that no column of times is read as one of numbers."""
    for index, may_be_time in zip(indices, may_be_times, strict=True):
        if index in clocks and not may_be_time:
            name = quoted(names[index] or f"#{index + 1}")
            raise DataError(f"{path}: column {name} holds times; needed are numbers.")


# --- Parquet --------------------------------------------------------------------------------------


def _open_parquet(path: Path) -> LoggedTable:
    """Open a Parquet file."""
    schema = parquet_schema(path)
    names = tuple(schema.names)
    clocks = frozenset(i for i, field in enumerate(schema) if pa.types.is_timestamp(field.type))
    return LoggedTable(
        path, names, ("",) * len(names), (), partial(_read_parquet, path, names, clocks)
    )


def _read_parquet(
    path: Path,
    names: tuple[str, ...],
    clocks: frozenset[int],
    indices: Sequence[int],
    may_be_times: Sequence[bool],
) -> list[LoggedColumn]:
    """Read columns of a Parquet file."""
    _check_clocks(path, names, clocks, indices, may_be_times)
    wanted = [names[index] for index in indices]
    numbers = [name for index, name in zip(indices, wanted, strict=True) if index not in clocks]
    table = parquet_columns(path, wanted, numbers)
    columns = []
    for index, name in zip(indices, wanted, strict=True):
        array = table[name].combine_chunks()
        empty = array.is_null().to_numpy(zero_copy_only=False)
        if index not in clocks:
            with arrow_errors(path):
                values = array.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
            columns.append(LoggedColumn(values, empty))
            continue
        with arrow_errors(path):
            # From one unit to a finer one exactly; a date beyond the range of ns is an error.
            nanoseconds = array.cast(pa.timestamp("ns")).cast(pa.int64())
            ticks = nanoseconds.fill_null(0).to_numpy(zero_copy_only=False)
        first = ticks[np.argmin(empty)] if len(ticks) else 0
        seconds = np.where(empty, np.nan, (ticks - first) / 1e9)
        columns.append(LoggedColumn(seconds, empty, "times count in seconds from the first"))
    return columns


# --- MATLAB and HDF5 ------------------------------------------------------------------------------


def _open_arrays(kind: Kind, path: Path) -> LoggedTable:
    """Open a file of arrays: .mat or HDF5."""
    result = read_bounded(path, kind)
    names = tuple(str(name) for name in result.header["names"])
    remarks = tuple(str(remark) for remark in result.header["remarks"])
    if not names:
        reason = f": {'; '.join(remarks)}" if remarks else ""
        raise DataError(f"{path} holds no vector of numbers{reason}.")
    read = partial(_read_arrays, path, result, names)
    return LoggedTable(path, names, ("",) * len(names), remarks, read)


def _read_arrays(
    path: Path,
    result: BoundedResult,
    names: tuple[str, ...],
    indices: Sequence[int],
    may_be_times: Sequence[bool],
) -> list[LoggedColumn]:
    """Return columns of arrays, all of one length."""
    ends = np.cumsum(result.header["lengths"])
    numbers = result.content.view("<f8")
    columns = []
    for index in indices:
        begin = int(ends[index - 1]) if index else 0
        columns.append(LoggedColumn.full(numbers[begin : int(ends[index])].astype(float)))
    lengths = {len(column.values) for column in columns}
    if len(lengths) > 1:
        sizes = ", ".join(
            f"{names[index]} has {len(column.values)}"
            for index, column in zip(indices, columns, strict=True)
        )
        raise DataError(f"{path}: its columns differ in length: {sizes}; needed is one length.")
    return columns


# --- workbooks ------------------------------------------------------------------------------------


class _Place(NamedTuple):
    """Place of a column in a workbook.

    Attributes:
        sheet: Its sheet.
        first: Index of its first row of numbers.
        column: Its index in the sheet.
    """

    sheet: Sheet
    first: int
    column: int


def _open_workbook(path: Path) -> LoggedTable:
    """Open a workbook. Where several sheets hold a table, names are those of sheet and column, as
    in "Sheet1!time".
    """
    sheets = read_sheets(path)
    tables = []
    for sheet in sheets:
        first = sheet.first_row()
        if first is not None:
            tables.append((sheet, first))
    if not tables:
        raise DataError(
            f"Cannot read {path} as a table: none of its {len(sheets)} sheets has two rows of "
            "numbers one below the other."
        )
    names: list[str] = []
    units: list[str] = []
    remarks: list[str] = []
    places: list[_Place] = []
    for sheet, first in tables:
        width = sheet.numbers.shape[1]
        above = []
        for row in range(first):
            cells = [str(cell).strip() for cell in sheet.row(row)]
            if any(cells):
                above.append(HeaderLine(row + 1, cells))
        try:
            header = table_header(above, width, first + 1, ends_empty=False)
        except ValueError as error:
            raise not_a_table(path, error) from None
        name_prefix = f"{sheet.name}!" if len(tables) > 1 else ""
        remark_prefix = f"sheet {quoted(sheet.name)}: " if len(tables) > 1 else ""
        for number, name in enumerate(header.names, start=1):
            names.append(f"{name_prefix}{name or f'#{number}'}")
        units += header.units
        remarks += [f"{remark_prefix}{remark}" for remark in header.remarks]
        places += [_Place(sheet, first, column) for column in range(width)]
    read = partial(_read_workbook, path, places)
    return LoggedTable(path, tuple(names), tuple(units), tuple(remarks), read)


def _read_workbook(
    path: Path,
    places: Sequence[_Place],
    indices: Sequence[int],
    may_be_times: Sequence[bool],
) -> list[LoggedColumn]:
    """Return columns of a sheet of a workbook from its first row of numbers on."""
    sheets: list[Sheet] = []
    for index in indices:
        if places[index].sheet not in sheets:
            sheets.append(places[index].sheet)
    if len(sheets) > 1:
        used = " and ".join(quoted(sheet.name) for sheet in sheets)
        raise DataError(f"{path}: the columns are on the sheets {used}; needed is one sheet.")
    columns = []
    for index, may_be_time in zip(indices, may_be_times, strict=True):
        place = places[index]
        columns.append(_sheet_column(path, place.sheet, place.first, place.column, may_be_time))
    # Rows below the table that are empty in all columns are left out.
    filled = np.flatnonzero(~np.all([column.empty for column in columns], axis=0))
    end = int(filled[-1]) + 1 if len(filled) else 0
    trimmed = []
    for column in columns:
        trimmed.append(LoggedColumn(column.values[:end], column.empty[:end], column.remark))
    return trimmed


def _sheet_column(
    path: Path, sheet: Sheet, first: int, column: int, may_be_time: bool
) -> LoggedColumn:
    """Return a column of a sheet from its first row of numbers on.

    Args:
        path: The workbook, for error messages.
        sheet: The sheet.
        first: Index of that row.
        column: Index of the column.
        may_be_time: Whether it may hold dates or times.

    Raises:
        DataError: If it holds words, dates where it may not, or dates and numbers.
    """
    place = f"{path}, sheet {quoted(sheet.name)}, column {column + 1}"
    values = sheet.numbers[first:, column].astype(float)
    words = {}
    for (row, column_of_word), text in sheet.words.items():
        if column_of_word == column and row >= first:
            words[row] = text
    if words and may_be_time:
        texts = [words.get(row, "") for row in range(first, first + len(values))]
        if not np.isfinite(values).any():
            return _clock_column(path, f"{column + 1}", texts)
    for row, text in sorted(words.items()):
        raise DataError(f"{place}: {quoted(text)} in row {row + 1} is no number.")
    has_dates = sheet.holds_dates(column, first)
    if has_dates and sheet.holds_numbers(column, first):
        raise DataError(f"{place} holds dates and numbers; needed is one of both.")
    if has_dates and not may_be_time:
        raise DataError(f"{place} holds dates; needed are numbers.")
    empty = np.isnan(values)
    if not has_dates:
        return LoggedColumn(values, empty)
    seconds = values - values[np.argmin(empty)]
    return LoggedColumn(seconds, empty, "times count in seconds from the first")


FORMATS: dict[str, Callable[[Path], LoggedTable]] = {
    "text": _open_text,
    "parquet": _open_parquet,
    "mat": partial(_open_arrays, "mat"),
    "hdf5": partial(_open_arrays, "hdf5"),
    "workbook": _open_workbook,
}
"""Function that opens a file, by its format."""
