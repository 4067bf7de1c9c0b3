"""Parts of a sweep, a Parquet file for every chunk that is done, and the table they make."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa

from cranedyn.errors import DataError
from cranedyn.sweep.chunk import joined
from cranedyn.sweep.limits import check_memory
from cranedyn.sweep.manifest import PART, Manifest, as_folder, read_manifest
from cranedyn.sweep.part import Damaged, opened, write

_SHOWN = 5


def finished(folder: Path, manifest: Manifest, part: int) -> tuple[int, int] | None:
    """Bad cases and bytes of a part, or None if it is not there as it was written.

    Raises:
        DataError: If it cannot be read, is no file, or is of another sweep.
    """
    path = folder / PART.format(part)
    try:
        with opened(folder, manifest, part) as file:
            groups = [file.metadata.row_group(i) for i in range(file.metadata.num_row_groups)]
            error = file.metadata.schema.names.index("error")
            good = sum(group.column(error).statistics.null_count for group in groups)
            return file.metadata.num_rows - good, path.stat().st_size
    except Damaged:
        return None
    except DataError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            return None
        raise


def write_part(
    folder: Path,
    manifest: Manifest,
    part: int,
    parameters: Mapping[str, np.ndarray],
    found: pa.Table,
) -> int:
    """Write a part: number and parameters of the cases, then what was found; returns its bytes.

    Raises:
        DataError: If it cannot be written.
    """
    cases = {"case": np.arange(*manifest.rows(part)), **parameters}
    columns = {name: found[name] for name in sorted(found.column_names, key="error".__eq__)}
    return write(folder, manifest, part, pa.table({**cases, **columns}))


def unify(folder: Path, manifest: Manifest) -> None:
    """Give all parts the same columns, so that the folder is one dataset to any reader: where all
    cases are bad, results are missing.

    Raises:
        DataError: If a result is a number in one part and a word in another, or a part cannot be
            read or written.
    """
    schemas = []
    for part in range(manifest.parts):
        with opened(folder, manifest, part) as file:
            schemas.append(file.schema_arrow.remove_metadata())
    whole = joined([schema.empty_table() for schema in schemas]).schema
    names = [*(name for name in whole.names if name != "error"), "error"]
    whole = pa.schema([whole.field(name) for name in names])
    for part, schema in enumerate(schemas):
        if not schema.equals(whole):
            table = joined([_read(folder, manifest, part), whole.empty_table()])
            write(folder, manifest, part, table.select(names).cast(whole))


def results(folder: str | Path, *, partial: bool = False) -> pa.Table:
    """All cases of a sweep in their order: `case`, the parameters, the results, and `error`, null
    where a case went well.

    Args:
        folder: Where it was swept.
        partial: Whether a sweep that is not finished gives what there is, but for damaged parts.

    Raises:
        DataError: If there is no sweep, it is not finished, a part is damaged or cannot be read, or
            the table would not fit the memory.
    """
    folder = as_folder(folder)
    manifest = read_manifest(folder)
    tables, damaged = _whole_parts(folder, manifest)
    rows = sum(map(len, tables))
    if rows < manifest.cases and not partial:
        names = ", ".join(damaged[:_SHOWN]) + (
            f" and {len(damaged) - _SHOWN} more" if damaged[_SHOWN:] else ""
        )
        raise DataError(
            f"The sweep in {folder} is not finished: {rows} of {manifest.cases} cases are there; "
            "sweep on, or ask for a partial table."
            + (f" Damaged, and computed again as it goes on: {names}." if names else "")
        )
    if not tables:
        raise DataError(f"The sweep in {folder} has no finished case yet.")
    table = joined(tables)
    return table.select([*(name for name in table.column_names if name != "error"), "error"])


def _whole_parts(folder: Path, manifest: Manifest) -> tuple[list[pa.Table], list[str]]:
    """Tables of the parts that are as they were written, and names of those that are not."""
    tables: list[pa.Table] = []
    damaged = []
    there = manifest.parts_in(folder)
    rows = sum(last - first for first, last in map(manifest.rows, there))
    for part in there:
        try:
            tables.append(_read(folder, manifest, part))
        except Damaged:
            damaged.append(PART.format(part))
        if len(tables) == 1:
            check_memory(f"The table of {rows} cases", rows * 8.0 * len(tables[0].column_names))
    return tables, damaged


def _read(folder: Path, manifest: Manifest, part: int) -> pa.Table:
    with opened(folder, manifest, part) as file:
        return file.read().replace_schema_metadata(None)
