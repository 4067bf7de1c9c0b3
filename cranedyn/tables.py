"""Columns of numbers out of CSV and Parquet files, whoever wrote them."""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from cranedyn.errors import DataError
from cranedyn.files import opened

LARGEST = 1_000_000_000
"""Most bytes that are read: of a CSV file itself, of a Parquet file, which may hold far more than its size, the numbers asked for."""

_LARGEST_FOOTER = 20_000_000
"""Most bytes in which a Parquet file says what is in it; they take some ten times as much memory."""

_HEAD = 1_000_000
"""Bytes among which the header of a CSV file must end."""


def read_table(path: str | Path, columns: Sequence[str]) -> tuple[dict[str, np.ndarray], dict[bytes, bytes]]:
    """Read some columns of numbers.

    Args:
        path: A ``.parquet`` file; any other is read as CSV with a header, and never unpacked.
        columns: Their names.

    Returns:
        The columns by name, shape (n,) each, and what a Parquet file says of itself.

    Raises:
        DataError: If the file cannot be read, is no regular file or larger than `LARGEST`, a column is missing, there twice or not of
            numbers, or a value is missing or not finite.
    """
    path = Path(path)
    try:
        with opened(path) as file:
            table = (_parquet if path.suffix == ".parquet" else _csv)(file, columns, path)
        found = {name: table[name].cast(pa.float64(), safe=False).to_numpy() for name in columns}
    except (OSError, ValueError, pa.ArrowException) as error:
        raise DataError(f"Cannot read {path}: {str(error).strip().partition(chr(10))[0].rstrip('.')}.") from error
    for name, values in found.items():
        finite = np.isfinite(values)
        if not finite.all():
            raise DataError(f"{path}: column {name} holds a value that is not finite, in data row {int(np.argmin(finite)) + 1}.")
    return found, dict(table.schema.metadata or {})


def _parquet(file: BinaryIO, columns: Sequence[str], path: Path) -> pa.Table:
    file.seek(max(0, os.fstat(file.fileno()).st_size - 8))
    end = file.read(8)
    if end[4:] == b"PAR1" and (footer := int.from_bytes(end[:4], "little")) > _LARGEST_FOOTER:
        raise DataError(f"{path} says in {footer / 1e6:.0f} MB what is in it; allowed are {_LARGEST_FOOTER / 1e6:.0f}.")
    source = pyarrow.parquet.ParquetFile(file)
    _check_names(source.schema_arrow.names, columns, path)
    _check_kinds(source.schema_arrow, columns, path)
    rows = [source.metadata.row_group(i).num_rows for i in range(source.metadata.num_row_groups)]
    _check_size(8 * len(columns) * max(source.metadata.num_rows, sum(rows)), path)
    return source.read(columns=list(columns))


def _csv(file: BinaryIO, columns: Sequence[str], path: Path) -> pa.Table:
    """Only what is asked for is kept, block by block."""
    _check_size(os.fstat(file.fileno()).st_size, path)
    head = file.read(_HEAD)
    whole_lines = head[: max(head.rfind(b"\n"), head.rfind(b"\r")) + 1] or head
    _check_names(pyarrow.csv.open_csv(io.BytesIO(whole_lines)).schema.names, columns, path)
    file.seek(0)
    options = pyarrow.csv.ConvertOptions(include_columns=list(columns), column_types=dict.fromkeys(columns, pa.float64()))
    blocks, kept = [], 0
    with pyarrow.csv.open_csv(file, convert_options=options) as reader:
        for block in reader:
            blocks.append(block)
            kept += block.nbytes
            _check_size(max(kept, file.tell()), path)  # the file may grow meanwhile
        return pa.Table.from_batches(blocks, reader.schema)


def _check_size(size: float, path: Path) -> None:
    if size > LARGEST:
        raise DataError(f"{path} holds {size / 1e6:.0f} MB to read; allowed are {LARGEST / 1e6:.0f}.")


def _check_names(names: Sequence[str], columns: Sequence[str], path: Path) -> None:
    missing = [name for name in columns if name not in names]
    if missing:
        raise DataError(f"{path} has no column {', '.join(missing)}; needed are {', '.join(columns)}.")
    for name in columns:
        if (count := names.count(name)) > 1:
            raise DataError(f"{path} has {count} columns {name}; needed is one.")


def _check_kinds(schema: pa.Schema, columns: Sequence[str], path: Path) -> None:
    for name in columns:
        kind = schema.field(name).type
        if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)):
            raise DataError(f"{path}: column {name} holds something that is not a number ({kind}).")
