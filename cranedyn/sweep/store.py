"""Parts of a sweep, a Parquet file for every chunk that is done, and the table they make."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from cranedyn.errors import DataError
from cranedyn.files import written
from cranedyn.sweep.chunk import joined
from cranedyn.sweep.limits import check_memory
from cranedyn.sweep.manifest import PART, Manifest, read_manifest


def finished(folder: Path, manifest: Manifest, part: int) -> tuple[int, int] | None:
    """Bad cases and bytes of a part, or None if it is not there whole."""
    path, (first, last) = folder / PART.format(part), manifest.rows(part)
    try:
        found = pq.read_metadata(path)
        groups = [found.row_group(i) for i in range(found.num_row_groups)]
        error = found.schema.names.index("error")
        good = sum(group.column(error).statistics.null_count for group in groups)
        return (found.num_rows - good, path.stat().st_size) if found.num_rows == last - first else None
    except (OSError, ValueError, AttributeError, pa.ArrowException):
        return None


def write_part(folder: Path, manifest: Manifest, part: int, parameters: Mapping[str, np.ndarray], found: pa.Table) -> int:
    """Write a part: number and parameters of the cases, then what was found; returns its bytes.

    Raises:
        DataError: If it cannot be written.
    """
    cases = {"case": np.arange(*manifest.rows(part)), **parameters}
    path = folder / PART.format(part)
    _write(path, pa.table({**cases, **{name: found[name] for name in sorted(found.column_names, key="error".__eq__)}}))
    return path.stat().st_size


def unify(folder: Path, manifest: Manifest) -> None:
    """Give all parts the same columns, so that the folder is one dataset to any reader: where all cases are bad, results are missing.

    Raises:
        DataError: If a result is a number in one part and a word in another.
    """
    paths = [folder / PART.format(part) for part in range(len(manifest))]
    schemas = [pq.read_schema(path).remove_metadata() for path in paths]
    whole = joined([schema.empty_table() for schema in schemas]).schema
    names = [*(name for name in whole.names if name != "error"), "error"]
    whole = pa.schema([whole.field(name) for name in names])
    for path, schema in zip(paths, schemas, strict=True):
        if not schema.equals(whole):
            table = joined([pq.read_table(path, partitioning=None), whole.empty_table()])
            _write(path, table.select(names).cast(whole))


def results(folder: str | Path, *, partial: bool = False) -> pa.Table:
    """All cases of a sweep in their order: `case`, the parameters, the results, and `error`, null where a case went well.

    Args:
        folder: Where it was swept.
        partial: Whether a sweep that is not finished gives what there is.

    Raises:
        DataError: If there is no sweep, it is not finished, a part is damaged, or the table would not fit the memory.
    """
    folder = Path(folder)
    manifest = read_manifest(folder)
    parts = [part for part in range(len(manifest)) if finished(folder, manifest, part)]
    rows = sum(last - first for first, last in map(manifest.rows, parts))
    if rows < manifest.cases and not partial:
        raise DataError(
            f"The sweep in {folder} is not finished: {rows} of {manifest.cases} cases are there; sweep on, or ask for a partial table."
        )
    if not parts:
        raise DataError(f"The sweep in {folder} has no finished case yet.")
    paths = [folder / PART.format(part) for part in parts]
    check_memory(f"The table of {rows} cases", rows * 8.0 * len(pq.read_schema(paths[0])))
    try:
        table = joined([pq.read_table(path, partitioning=None) for path in paths])
    except (OSError, ValueError, pa.ArrowException) as error:
        raise DataError(f"Cannot read {folder}: {error}.") from error
    return table.select([*(name for name in table.column_names if name != "error"), "error"])


def _write(path: Path, table: pa.Table) -> None:
    with written(path) as file:
        pq.write_table(table, file)
        with file.open("rb") as whole:
            os.fsync(whole.fileno())  # a machine that goes down must not leave the name without the content
