"""What stands in a recording, read back."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation


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


def poses(path: Path, time: int) -> dict[str, np.ndarray]:
    """Return the pose of every frame in the scene at a time [ns], 4 x 4."""
    steps = {}
    for _, batch in chunks(path):
        if "Transform3D:child_frame" not in batch.schema.names:
            continue
        row = 0
        if "sim_time" in batch.schema.names:
            row = int(np.searchsorted(batch["sim_time"].cast("int64"), time, side="right")) - 1
        values = {
            name: batch[f"Transform3D:{name}"][row].as_py()[0]
            for name in (
                "child_frame",
                "parent_frame",
                "translation",
                "quaternion",
                "rotation_axis_angle",
            )
            if f"Transform3D:{name}" in batch.schema.names
        }
        step = np.eye(4)
        if "quaternion" in values:
            step[:3, :3] = Rotation.from_quat(values["quaternion"]).as_matrix()
        if "rotation_axis_angle" in values:
            turn = values["rotation_axis_angle"]
            step[:3, :3] = Rotation.from_rotvec(
                np.multiply(turn["angle"], turn["axis"])
            ).as_matrix()
        step[:3, 3] = values["translation"]
        steps[values["child_frame"]] = values["parent_frame"], step

    def pose(frame: str) -> np.ndarray:
        return np.eye(4) if frame == "tf#/" else pose(steps[frame][0]) @ steps[frame][1]

    return {frame: pose(frame) for frame in steps}
