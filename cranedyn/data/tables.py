"""Columns of numbers in CSV and Parquet files of any program."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from cranedyn.command import defer_sigint
from cranedyn.data.files import atomic_write, open_file, with_ending
from cranedyn.errors import DataError, quoted

LARGEST = 1_000_000_000
"""Most bytes that are read: of a CSV file its size, of a Parquet file, which may be compressed, the
numbers of the columns needed."""

_MAX_FOOTER = 20_000_000
"""Most bytes of the footer of a Parquet file; parsed it takes some ten times as much memory."""

_BLOCK_SIZE = 500_000
"""Bytes of a CSV file that are read at once, and most bytes of a line."""


@cache
def arrow() -> Any:
    """Return pyarrow after its first array, which imports pandas; Ctrl-C waits until it has."""
    with defer_sigint():
        pa.array([""])
    return pa


def number_array(values: np.ndarray) -> pa.Array:
    """Return numbers as an Arrow array, without a copy where they lie one after the other.

    pyarrow's own conversion of NumPy's arrays imports pandas where that is installed, which takes
    longer than most runs take to write. Floating-point numbers need none of it: an Arrow array of
    numbers without missing ones is the memory of NumPy's array.

    Args:
        values: The numbers, shape (rows,). Types other than float32 and float64 are converted by
            pyarrow, see `arrow`.
    """
    if values.ndim != 1 or values.dtype not in (np.float32, np.float64):
        return arrow().array(values)
    contiguous = np.ascontiguousarray(values)
    no_missing = None
    return pa.Array.from_buffers(
        pa.from_numpy_dtype(contiguous.dtype),
        len(contiguous),
        [no_missing, pa.py_buffer(contiguous)],
    )


def read_table(
    path: str | Path, columns: Sequence[str]
) -> tuple[dict[str, np.ndarray], dict[bytes, bytes]]:
    """Read columns of numbers.

    Args:
        path: A ``.parquet`` file; any other is read as CSV with a header, never decompressed.
        columns: Names of the columns.

    Returns:
        The columns by name, shape (rows,) each, and the metadata of a Parquet file.

    Raises:
        DataError: If the file cannot be read, is no regular file or larger than `LARGEST`, a column
            is missing, there twice or not of numbers, or a value is missing or not finite.
    """
    path = Path(path)
    with _opened(path) as file:
        if path.suffix == ".parquet":
            table = _parquet(file, columns, path)
        else:
            table = _csv(file, columns, path)
        arrays = {name: table[name].cast(pa.float64(), safe=False).to_numpy() for name in columns}
    for name, values in arrays.items():
        finite = np.isfinite(values)
        if not finite.all():
            raise DataError(
                f"{path}: column {name} holds a value that is not finite, in data row "
                f"{int(np.argmin(finite)) + 1}."
            )
    return arrays, dict(table.schema.metadata or {})


def write_table(path: str | Path, table: pa.Table) -> Path:
    """Write a ``.csv`` or ``.parquet`` file, every number to the bit, and return its path.

    Raises:
        DataError: If the ending is another or the file cannot be written.
    """
    writers = {".csv": pyarrow.csv.write_csv, ".parquet": _write_parquet}
    path = with_ending(path, *writers)
    # Arrow accepts only names that are UTF-8.
    with atomic_write(path) as draft, draft.open("wb") as file:
        writers[path.suffix](table, file)
    return path


def _write_parquet(table: pa.Table, file: BinaryIO) -> None:
    """Write a table with the bytes of its numbers split, which Zstandard then halves."""
    floats = [field.name for field in table.schema if pa.types.is_floating(field.type)]
    names = [name for name in table.column_names if name not in floats]
    pyarrow.parquet.write_table(
        table, file, compression="zstd", use_dictionary=names, use_byte_stream_split=floats
    )


def column_names(path: str | Path) -> list[str]:
    """Return the names of the columns of a file, in its order.

    Raises:
        DataError: As `read_table`.
    """
    path = Path(path)
    with _opened(path) as file:
        if path.suffix != ".parquet":
            return _csv_names(file)
        with _source(file, path) as source:
            return list(source.schema_arrow.names)


def metadata_of(path: str | Path) -> dict[bytes, bytes]:
    """Return the metadata of a Parquet file.

    Raises:
        DataError: If it cannot be read or is no Parquet file.
    """
    path = Path(path)
    with _opened(path) as file, _source(file, path) as source:
        return dict(source.schema_arrow.metadata or {})


@dataclass(frozen=True)
class TextFormat:
    """Format of a text table of another program.

    Attributes:
        delimiter: What separates cells.
        decimal: Decimal mark.
        labels: Names of the columns, or their numbers, as in "#3".
        first_line: Index of the line of the first row, from 0.
        words: Indices of the columns that are read as words.
    """

    delimiter: str
    decimal: str
    labels: Sequence[str]
    first_line: int
    words: Collection[int]


def csv_columns(
    path: str | Path, indices: Sequence[int], text_format: TextFormat, content: bytes | None = None
) -> list[pa.Array]:
    """Read columns of a text table of another program, null where a cell is empty.

    Args:
        path: The file.
        indices: Indices of the columns, from 0.
        text_format: Format of the table.
        content: What to read instead of the file, in UTF-8.

    Raises:
        DataError: If the file cannot be read or is too large, a row has more or fewer cells than
            the others, or a cell is no number.
    """
    path = Path(path)
    # Columns are named by their indices here: names in the file may be empty, or come twice.
    names = [str(index) for index in range(len(text_format.labels))]
    types = {}
    for index in indices:
        is_word = index in text_format.words
        types[names[index]] = pa.string() if is_word else pa.float64()
    convert = pyarrow.csv.ConvertOptions(
        include_columns=list(types),
        column_types=types,
        null_values=[""],
        strings_can_be_null=True,
        decimal_point=text_format.decimal,
    )
    read = pyarrow.csv.ReadOptions(
        use_threads=False,
        block_size=_BLOCK_SIZE,
        column_names=names,
        skip_rows=text_format.first_line,
    )
    parse = pyarrow.csv.ParseOptions(delimiter=text_format.delimiter)
    with _opened(path) as file:
        _check_size(os.fstat(file.fileno()).st_size, path)
        source = _native_file(file) if content is None else pa.BufferReader(content)
        with (
            _located(path, text_format),
            pyarrow.csv.open_csv(source, read, parse, convert) as reader,
        ):
            table = _read_blocks(reader, path)
        return [table[names[index]].combine_chunks() for index in indices]


def _native_file(file: BinaryIO) -> pa.OSFile:
    """Return an open file as one that Arrow reads by itself: threads of Arrow that hold a Python
    file abort a program that ends.
    """
    return pa.OSFile(f"/dev/fd/{file.fileno()}")


def _read_blocks(reader: pyarrow.csv.CSVStreamingReader, path: Path) -> pa.Table:
    """Return the table that a reader reads block by block.

    Raises:
        DataError: If it becomes larger than `LARGEST`; the file may grow meanwhile.
    """
    blocks: list[pa.RecordBatch] = []
    size = 0
    for block in reader:
        blocks.append(block)
        size += block.nbytes
        _check_size(size, path)
    return pa.Table.from_batches(blocks, reader.schema)


@contextmanager
def _located(path: Path, text_format: TextFormat) -> Iterator[None]:
    """Turn errors of Arrow over a cell or a row into a `DataError` that names column and row."""
    try:
        yield
    except pa.ArrowInvalid as error:
        text = str(error)
        # Arrow counts the lines above the table, too, and leaves out blank ones below.
        row = re.search(r"Row #(\d+):", text)
        place = f"data row {int(row[1]) - text_format.first_line}" if row else "some row"
        cells = re.search(r"Expected (\d+) columns, got (\d+)", text)
        if cells:
            raise DataError(
                f"{path} has {cells[2]} cells in {place} and {cells[1]} in the rows above; needed "
                "is one number of cells. A line that was cut off at the end can be deleted."
            ) from error
        column = re.search(r"column #(\d+):", text)
        value = re.search(r"invalid value '(.*)'", text, re.DOTALL)
        if column and value:
            label = quoted(text_format.labels[_read_index(text_format, int(column[1]))])
            raise DataError(
                f"{path}: column {label} holds {quoted(value[1])} in {place}, which is no number "
                f"with the decimal mark {text_format.decimal!r}."
            ) from error
        raise


def _read_index(text_format: TextFormat, column: int) -> int:
    """Return the index of a column of the file by its number in a message of Arrow."""
    return min(column, len(text_format.labels) - 1)


def parquet_schema(path: str | Path) -> pa.Schema:
    """Return the names and types of the columns of a Parquet file.

    Raises:
        DataError: If it cannot be read or is no Parquet file.
    """
    path = Path(path)
    with _opened(path) as file, _source(file, path) as source:
        return source.schema_arrow


def parquet_columns(path: str | Path, columns: Sequence[str], numbers: Sequence[str]) -> pa.Table:
    """Read columns of a Parquet file.

    Args:
        path: The file.
        columns: Names of the columns.
        numbers: Names of those that must be of numbers.

    Raises:
        DataError: As `read_table`, but for values that are missing or not finite.
    """
    path = Path(path)
    with _opened(path) as file:
        return _parquet(file, columns, path, numbers)


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    """Open a file and turn errors of Arrow into a `DataError`."""
    with arrow_errors(path), open_file(path) as file:
        yield file


@contextmanager
def arrow_errors(path: str | Path) -> Iterator[None]:
    """Turn errors of Arrow over a file into a `DataError`."""
    try:
        yield
    except (OSError, ValueError, pa.ArrowException) as error:
        reason = str(error).strip().partition("\n")[0].rstrip(".")
        if "straddling" in reason:
            reason = f"it has a line of more than {_BLOCK_SIZE / 1e6:g} MB"
        raise DataError(f"Cannot read {path}: {reason}.") from error


@contextmanager
def _source(file: BinaryIO, path: Path) -> Iterator[pyarrow.parquet.ParquetFile]:
    """Open a Parquet file, unless its footer is too large.

    A file ends with the footer, the length of that in four bytes, and the mark PAR1.
    """
    file.seek(max(0, os.fstat(file.fileno()).st_size - 8))
    end = file.read(8)
    if end[4:] == b"PAR1":
        footer = int.from_bytes(end[:4], "little")
        if footer > _MAX_FOOTER:
            raise DataError(
                f"{path} says in {footer / 1e6:.0f} MB what is in it; allowed are "
                f"{_MAX_FOOTER / 1e6:.0f}."
            )
    with _native_file(file) as native, pyarrow.parquet.ParquetFile(native) as source:
        yield source


def _parquet(
    file: BinaryIO, columns: Sequence[str], path: Path, numbers: Sequence[str] | None = None
) -> pa.Table:
    """Read columns of a Parquet file, all of numbers or those named."""
    with _source(file, path) as source:
        _check_names(source.schema_arrow.names, columns, path)
        _check_types(source.schema_arrow, columns if numbers is None else numbers, path)
        # The footer says the number of rows twice, and a damaged one may say it differently.
        footer = source.metadata
        rows = sum(footer.row_group(i).num_rows for i in range(footer.num_row_groups))
        _check_size(8 * len(columns) * max(footer.num_rows, rows), path)
        return source.read(columns=list(columns))


def _csv(file: BinaryIO, columns: Sequence[str], path: Path) -> pa.Table:
    """Read a CSV file block by block, keeping only the columns needed."""
    _check_size(os.fstat(file.fileno()).st_size, path)
    _check_names(_csv_names(file), columns, path)
    convert = pyarrow.csv.ConvertOptions(
        include_columns=list(columns), column_types=dict.fromkeys(columns, pa.float64())
    )
    with _csv_blocks(file, convert) as reader:
        return _read_blocks(reader, path)


def _csv_names(file: BinaryIO) -> list[str]:
    """Return the names of the columns of a CSV file."""
    with _csv_blocks(file) as reader:
        return list(reader.schema.names)


def _csv_blocks(
    file: BinaryIO, convert: pyarrow.csv.ConvertOptions | None = None
) -> pyarrow.csv.CSVStreamingReader:
    """Return a reader of a CSV file from its beginning on, block by block."""
    options = pyarrow.csv.ReadOptions(use_threads=False, block_size=_BLOCK_SIZE)
    return pyarrow.csv.open_csv(_native_file(file), read_options=options, convert_options=convert)


def _check_size(size: float, path: Path) -> None:
    """Check that so many bytes are not more than are read."""
    if size > LARGEST:
        raise DataError(
            f"{path} holds {size / 1e6:.0f} MB to read; allowed are {LARGEST / 1e6:.0f}."
        )


def _check_names(names: Sequence[str], columns: Sequence[str], path: Path) -> None:
    """Check that each column needed is among the names of a file, once."""
    missing = [name for name in columns if name not in names]
    if missing:
        needed = ", ".join(columns)
        present = quoted(", ".join(names))
        raise DataError(
            f"{path} has no column {', '.join(missing)}; needed are {needed}, it has {present}."
        )
    for name in columns:
        count = names.count(name)
        if count > 1:
            raise DataError(f"{path} has {count} columns {name}; needed is one.")


def _check_types(schema: pa.Schema, columns: Sequence[str], path: Path) -> None:
    """Check that columns are of numbers."""
    for name in columns:
        dtype = schema.field(name).type
        is_number = (
            pa.types.is_integer(dtype) or pa.types.is_floating(dtype) or pa.types.is_decimal(dtype)
        )
        if not is_number:
            raise DataError(
                f"{path}: column {name} holds something that is not a number ({dtype}). Numbers "
                "have a decimal point, as 3600.5; cells that are empty or words are no numbers."
            )
