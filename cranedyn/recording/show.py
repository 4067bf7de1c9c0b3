"""A run recorded and opened in the viewer: `view` of the API."""

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


def view(
    run: Trajectory,
    crane: Crane | None = None,
    *,
    name: str = "run",
    file: str | Path | None = None,
) -> Path:
    """Record a run, open the recording in the viewer's window, and return its path.

    Args:
        run: The run.
        crane: The crane that ran; by default the crane that the record of the run names.
        name: Name of the run in the recording.
        file: Path of the recording; None for a temporary folder.

    Raises:
        DataError: If the recording cannot be written, or the record names no crane, as of a run
            from a CSV file.
        CraneError: If there is no display; the recording is written nevertheless.
    """
    if crane is None:
        if not run.record:
            raise DataError(
                "This record names no crane, as none of a CSV file does; say which it was: "
                "cd.view(run, crane)."
            )
        crane = load_crane(from_record=run.record)
    path = Path(tempfile.mkdtemp(prefix="cranedyn-"), "run.rrd") if file is None else Path(file)
    record(path, [Run(name, crane, run)], title=name)
    open_viewer(path)
    return path
