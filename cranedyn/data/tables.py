"""Columns of numbers in CSV and Parquet files, read whoever wrote them."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from cranedyn.data.files import atomic_write, open_file
from cranedyn.errors import DataError

LARGEST = 1_000_000_000
"""Most bytes that are read: of a CSV file itself, of a Parquet file, which may hold far more than
its size, the numbers asked for."""

_LARGEST_FOOTER = 20_000_000
"""Most bytes in which a Parquet file says what is in it; they take some ten times as much
memory."""

_BLOCK = 1_000_000
"""Bytes of a CSV file that are read at a time; most bytes of a line."""


def read_table(
    path: str | Path, columns: Sequence[str]
) -> tuple[dict[str, np.ndarray], dict[bytes, bytes]]:
    """Read some columns of numbers.

    Args:
        path: A ``.parquet`` file; any other is read as CSV with a header, and never unpacked.
        columns: Their names.

    Returns:
        The columns by name, shape (n,) each, and what a Parquet file says of itself.

    Raises:
        DataError: If the file cannot be read, is no regular file or larger than `LARGEST`, a column
            is missing, there twice or not of numbers, or a value is missing or not finite.
    """
    path = Path(path)
    try:
        with open_file(path) as file:
            table = (_parquet if path.suffix == ".parquet" else _csv)(file, columns, path)
        found = {name: table[name].cast(pa.float64(), safe=False).to_numpy() for name in columns}
    except (OSError, ValueError, pa.ArrowException) as error:
        raise _unreadable(path, error) from error
    for name, values in found.items():
        finite = np.isfinite(values)
        if not finite.all():
            raise DataError(
                f"{path}: column {name} holds a value that is not finite, in data row "
                f"{int(np.argmin(finite)) + 1}."
            )
    return found, dict(table.schema.metadata or {})


def write_table(path: str | Path, table: pa.Table) -> Path:
    """Write a table to a ``.csv`` or ``.parquet`` file, every number to the bit.

    Raises:
        DataError: If the ending is another or the file cannot be written.
    """
    path = Path(path)
    writer = {".csv": pyarrow.csv.write_csv, ".parquet": pyarrow.parquet.write_table}.get(
        path.suffix
    )
    if writer is None:
        raise DataError(f"Cannot write {path}: the ending must be .csv or .parquet.")
    # Arrow takes no name that is not UTF-8.
    with atomic_write(path) as draft, draft.open("wb") as file:
        writer(table, file)
    return path


def column_names(path: str | Path) -> list[str]:
    """Names of the columns of a file, in its order; arguments and errors as of `read_table`."""
    path = Path(path)
    try:
        with open_file(path) as file:
            if path.suffix != ".parquet":
                head = pyarrow.csv.ReadOptions(use_threads=False)
                return list(
                    pyarrow.csv.open_csv(
                        pa.BufferReader(next(_lines(file, path))), read_options=head
                    ).schema.names
                )
            with _source(file, path) as source:
                return list(source.schema_arrow.names)
    except (OSError, ValueError, pa.ArrowException) as error:
        raise _unreadable(path, error) from error


def metadata_of(path: str | Path) -> dict[bytes, bytes]:
    """What a Parquet file says of itself.

    Raises:
        DataError: If it cannot be read or is none.
    """
    path = Path(path)
    try:
        with open_file(path) as file, _source(file, path) as source:
            return dict(source.schema_arrow.metadata or {})
    except (OSError, ValueError, pa.ArrowException) as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Path, error: Exception) -> DataError:
    return DataError(f"Cannot read {path}: {str(error).strip().partition(chr(10))[0].rstrip('.')}.")


def _parquet(file: BinaryIO, columns: Sequence[str], path: Path) -> pa.Table:
    with _source(file, path) as source:
        return _asked(source, columns, path)


@contextmanager
def _source(file: BinaryIO, path: Path) -> Iterator[pyarrow.parquet.ParquetFile]:
    file.seek(max(0, os.fstat(file.fileno()).st_size - 8))
    end = file.read(8)
    if end[4:] == b"PAR1" and (footer := int.from_bytes(end[:4], "little")) > _LARGEST_FOOTER:
        raise DataError(
            f"{path} says in {footer / 1e6:.0f} MB what is in it; allowed are "
            f"{_LARGEST_FOOTER / 1e6:.0f}."
        )
    # the same file by a name of the system's: threads of Arrow that hold an object of Python's
    # abort a program that ends
    with pa.OSFile(f"/dev/fd/{file.fileno()}") as same, pyarrow.parquet.ParquetFile(same) as source:
        yield source


def _asked(source: pyarrow.parquet.ParquetFile, columns: Sequence[str], path: Path) -> pa.Table:
    _check_names(source.schema_arrow.names, columns, path)
    _check_kinds(source.schema_arrow, columns, path)
    rows = [source.metadata.row_group(i).num_rows for i in range(source.metadata.num_row_groups)]
    _check_size(8 * len(columns) * max(source.metadata.num_rows, sum(rows)), path)
    return source.read(columns=list(columns))


def _csv(file: BinaryIO, columns: Sequence[str], path: Path) -> pa.Table:
    """Only what is asked for is kept, block by block."""
    _check_size(os.fstat(file.fileno()).st_size, path)
    convert = pyarrow.csv.ConvertOptions(
        include_columns=list(columns), column_types=dict.fromkeys(columns, pa.float64())
    )
    blocks: list[pa.Table] = []
    names: list[str] | None = None
    kept = 0
    for lines in _lines(file, path):
        if names is None:
            head = pyarrow.csv.ReadOptions(use_threads=False)
            names = pyarrow.csv.open_csv(pa.BufferReader(lines), read_options=head).schema.names
            _check_names(names, columns, path)
            options = head
        else:
            options = pyarrow.csv.ReadOptions(use_threads=False, column_names=names)
        blocks.append(
            pyarrow.csv.read_csv(
                pa.BufferReader(lines), read_options=options, convert_options=convert
            )
        )
        kept += blocks[-1].nbytes
        _check_size(max(kept, file.tell()), path)  # the file may grow meanwhile
    return pa.concat_tables(blocks)


def _lines(file: BinaryIO, path: Path) -> Iterator[bytes]:
    """Whole lines, a block of them at a time, one block at least."""
    rest, first = b"", True
    while (more := file.read(_BLOCK)) or rest or first:
        text = rest + more
        end = max(text.rfind(b"\n"), text.rfind(b"\r")) + 1 if more else len(text)
        if len(text) - end > _BLOCK:
            raise DataError(f"{path} has a line of more than {_BLOCK / 1e6:g} MB.")
        rest = text[end:]
        if text[:end].strip() or not more:
            yield text[:end]
            first = False


def _check_size(size: float, path: Path) -> None:
    if size > LARGEST:
        raise DataError(
            f"{path} holds {size / 1e6:.0f} MB to read; allowed are {LARGEST / 1e6:.0f}."
        )


def _check_names(names: Sequence[str], columns: Sequence[str], path: Path) -> None:
    missing = [name for name in columns if name not in names]
    if missing:
        raise DataError(
            f"{path} has no column {', '.join(missing)}; needed are {', '.join(columns)}."
        )
    for name in columns:
        if (count := names.count(name)) > 1:
            raise DataError(f"{path} has {count} columns {name}; needed is one.")


def _check_kinds(schema: pa.Schema, columns: Sequence[str], path: Path) -> None:
    for name in columns:
        kind = schema.field(name).type
        if not (
            pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)
        ):
            raise DataError(f"{path}: column {name} holds something that is not a number ({kind}).")
