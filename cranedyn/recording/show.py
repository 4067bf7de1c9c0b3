"""A run that is recorded and looked at in one step."""

from __future__ import annotations

import tempfile
from pathlib import Path

from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import DataError
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.recording.record import record
from cranedyn.recording.run import Run
from cranedyn.recording.viewer import open_viewer


def view(run: Trajectory, crane: Crane | None, name: str, file: str | Path | None = None) -> Path:
    """Record a run and open the recording; see `Trajectory.view`."""
    if crane is None:
        if not run.record:
            raise DataError(
                "This record names no crane, as none of a CSV file does; say which it was: "
                "run.view(crane)."
            )
        crane = load_crane(from_record=run.record)
    path = Path(tempfile.mkdtemp(prefix="cranedyn-"), "run.rrd") if file is None else Path(file)
    record(path, [Run(name, crane, run)], title=name)
    open_viewer(path)
    return path
