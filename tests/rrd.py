"""What stands in a recording, read back."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa


def chunks(path: Path) -> Iterator[tuple[str, pa.RecordBatch]]:
    """Entities of a recording with what is logged there."""
    from rerun.chunk import RrdReader

    for chunk in RrdReader(path).stream():
        yield chunk.entity_path, chunk.to_record_batch()


def rows(path: Path, ending: str, component: str) -> tuple[np.ndarray, np.ndarray]:
    """Times [ns] and values of one component, flat within each row, of the one entity whose path
    ends so.
    """
    (batch,) = (
        b
        for entity, b in chunks(path)
        if entity.endswith(ending) and component in b.schema.names and "sim_time" in b.schema.names
    )
    values = batch[component]
    while pa.types.is_nested(values.type):
        values = values.flatten()
    return batch["sim_time"].cast(pa.int64()).to_numpy(), np.array(values, dtype=float).reshape(
        batch.num_rows, -1
    )


def numbers(path: Path, run: str = "") -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times [ns] and columns of the table of a run."""
    (batch,) = (b for entity, b in chunks(path) if entity.endswith(f"{run}/numbers"))
    table = batch["Run:row"].flatten()
    return batch["sim_time"].cast(pa.int64()).to_numpy(), {
        field.name: table.field(field.name).to_numpy() for field in table.type
    }
