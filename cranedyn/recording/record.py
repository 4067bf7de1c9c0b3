"""Trajectories into one Rerun file: the moving crane, every number as a time series, and the layout
that shows them.
"""

from __future__ import annotations

import os
import re
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr

from cranedyn.data.files import atomic_write
from cranedyn.dynamics.validity import events
from cranedyn.errors import CraneError, DataError, OutOfRange, printable, quoted
from cranedyn.recording.dashboard import dashboard
from cranedyn.recording.run import Run, utf8
from cranedyn.recording.scene import PATH_SECONDS, Scene, looks
from cranedyn.recording.series import Table, log_series, table


def check_enabled() -> None:
    """Return if Rerun records; to ask Rerun itself would make it print lines of its own.

    Raises:
        CraneError: If it is switched off in the environment.
    """
    if os.environ.get("RERUN", "").lower() in ("off", "false", "0"):
        raise CraneError(
            "Rerun is switched off by the environment variable RERUN; unset it to write a "
            "recording."
        )


def record(path: str | Path, runs: Sequence[Run], *, title: str, text: str = "") -> Path:
    """Write runs into one ``.rrd`` file on one clock, with the layout inside.

    The scene is drawn at 50 Hz in single precision. The numbers stand in it at full rate and to the
    bit, angles in degrees, energy since the start: see `cranedyn.recording.series.table`.

    Args:
        path: The file, ending in ``.rrd``.
        runs: One or several.
        title: Heading of the recording.
        text: What the recording shows, in Markdown.

    Raises:
        OutOfRange: If there is no run, one has no rows or holds a value that is not finite, or two
            share a name.
        DataError: If the file cannot be written.
        CraneError: If Rerun is switched off in the environment.
    """
    path, title, text = Path(path), utf8(title), utf8(text)
    _check(path, runs)
    check_enabled()
    tables = [_finite_table(run) for run in runs]
    recording = rr.RecordingStream(_application(title, runs), send_properties=False)
    memory = recording.memory_recording()
    try:
        recording.send_blueprint(dashboard(runs, tables), make_active=True, make_default=True)
        recording.send_recording_name(title)
        recording.log(
            "text",
            rr.TextDocument(describe(runs, title, text), media_type="text/markdown"),
            static=True,
        )
        recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for run, look, columns in zip(runs, looks(runs), tables, strict=True):
            Scene(recording, run, look).move(run)
            log_series(recording, run, columns)
    finally:  # also after Ctrl-C, or Rerun says on standard error that it drops data
        data = memory.drain_as_bytes()
    with atomic_write(path) as draft:
        draft.write_bytes(data)
    return path


def describe(runs: Sequence[Run], title: str, text: str) -> str:
    """The words beside the pictures, in Markdown: title, text, parameters of the runs, and how to
    read the scene.
    """
    names = dict.fromkeys(name for run in runs for name in run.trajectory.parameters)
    rows = [
        [_shown(name), *(_shown(run.trajectory.parameters.get(name, "")) for run in runs)]
        for name in names
    ]
    lines = [["parameter", *(_shown(run.name) for run in runs)], ["---"] * (len(runs) + 1), *rows]
    scene = (
        f"**How to read the scene.** Dots: where the payload was in the last {PATH_SECONDS:g} s. "
        "Wire box and grey line: the payload and "
        "the cable at the setpoint of the drives. Arrows under the trolley: where the payload "
        "hangs off the plumb line, orange along the "
        f"jib and blue across it, {looks(runs)[0].arrow:g} m for a degree. The tab *Payload* "
        "follows the payload."
    )
    if any("<mesh" in run.crane.urdf and run.meshes is None for run in runs):
        scene += " Meshes of the URDF are not drawn."
    beyond = "\n".join(
        f"- {printable(run.name)}, {at:.3f} s: {words}"
        for run in runs
        for at, words in _beyond(run)
    )
    warning = f"**Where the model does not hold:**\n\n{beyond}" if beyond else ""
    parts = (
        f"## {title}",
        text,
        warning,
        "\n".join(f"| {' | '.join(line)} |" for line in lines),
        scene,
    )
    return "\n\n".join(part for part in parts if part)


def _beyond(run: Run) -> list[tuple[float, str]]:
    """When and why a run leaves what the model holds for."""
    if run.trajectory.valid.all():
        return []
    return [
        (float(run.trajectory.t[event.row]), event.words)
        for event in events(run.crane, run.trajectory)
    ]


def _shown(value: float | str) -> str:
    return f"{value:g}" if isinstance(value, float) else printable(value).replace("|", "\\|")


def _check(path: Path, runs: Sequence[Run]) -> None:
    if path.suffix != ".rrd":
        raise DataError(f"Cannot write {path}: the ending must be .rrd.")
    names = [run.name for run in runs]
    if not names or not all(names) or len(set(names)) < len(names):
        raise OutOfRange("names of the runs", names, "one name or more, each different")
    for run in runs:
        if not len(run.trajectory):
            raise OutOfRange(f"number of rows of run {quoted(run.name)}", 0, ">= 1")


def _finite_table(run: Run) -> Table:
    columns = table(run)
    for name, values in columns.items():
        if not np.isfinite(values).all():
            raise OutOfRange(
                f"{name} of run {quoted(run.name)}",
                values[~np.isfinite(values)][0],
                "a finite number",
            )
    return columns


def _application(title: str, runs: Sequence[Run]) -> str:
    """A name for the viewer, which keeps one layout per application: another for every other title
    or set of runs.
    """
    key = repr(
        [
            title,
            *(
                (run.name, run.offset, len(run.trajectory), run.trajectory.q[-1].tolist())
                for run in runs
            ),
        ]
    )
    words = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")[:40]
    return f"cranedyn-{words}-{zlib.crc32(key.encode()):08x}"
