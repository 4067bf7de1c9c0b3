"""Trajectories into a Rerun file: at once by `record`, piece by piece by `Live`."""

from __future__ import annotations

import os
import re
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import rerun as rr

from cranedyn.data.files import Draft, check_writable, sync_folder, with_ending
from cranedyn.data.trajectory import Trajectory, join
from cranedyn.dynamics.validity import events
from cranedyn.errors import CraneError, DataError, OutOfRange, printable, quoted
from cranedyn.model.crane import Crane
from cranedyn.recording.contents import Run, utf8
from cranedyn.recording.dashboard import dashboard
from cranedyn.recording.scene import PATH_SECONDS, Scene, looks
from cranedyn.recording.series import (
    Table,
    log_gaps,
    log_readout,
    log_series,
    series_table,
    table_cell,
)
from cranedyn.recording.stream import recording_file, send_layout

_FLUSH_SECONDS = 10.0
"""Longest wait for Rerun to write what it was given [s]."""

_MAX_SLUG_LENGTH = 40
"""Number of characters to which the title is cut in the id of an application."""


def check_enabled() -> None:
    """Return if Rerun records; its own function for this prints lines.

    Raises:
        CraneError: If the environment switches it off.
    """
    if os.environ.get("RERUN", "").lower() in ("off", "false", "0"):
        message = "Rerun is switched off by the environment variable RERUN; unset it to record."
        raise CraneError(message)


def record(
    path: str | Path,
    runs: Sequence[Run],
    *,
    title: str,
    text: str = "",
    gaps: Mapping[str, np.ndarray] | None = None,
    contacts: Sequence[float] = (),
) -> Path:
    """Write runs into one ``.rrd`` file with its layout.

    A recording is for looking at; every row to the bit is in the file that the run writes. The
    scene has 25 rows a second, the numbers have 50 and those where an effort jumps, in single
    precision, angles in degrees, energy since the start: see
    `cranedyn.recording.series.series_table`.

    Args:
        path: The file, ending in ``.rrd``.
        runs: One or several, on one timeline.
        title: Heading of the recording.
        text: Description in Markdown.
        gaps: Distances between cranes by name [m], a number for each row of the first run.
        contacts: Times at which contacts begin [s].

    Raises:
        OutOfRange: If there is no run, two share a name, or one has no rows or a value that is not
            finite.
        DataError: If the file cannot be written.
        CraneError: If Rerun is switched off in the environment.
    """
    path = with_ending(path, ".rrd")
    title = utf8(title)
    names = [run.name for run in runs]
    if not names or not all(names) or len(set(names)) < len(names):
        raise OutOfRange("names of the runs", names, "one name or more, each different")
    check_enabled()
    tables = [_finite_table(run) for run in runs]
    with recording_file(path, _application(title, runs)) as recording:
        scenes = _log_static(recording, runs, tables, title, utf8(text), gaps=bool(gaps))
        for run, scene, columns in zip(runs, scenes, tables, strict=True):
            scene.move(run.trajectory)
            log_series(recording, run, columns)
        log_readout(recording, runs)
        log_gaps(recording, runs[0].trajectory.t, gaps or {}, contacts)
    return path


class Live:
    """A recording that grows while a run goes on, in a file, in a viewer, or in both.

    All appended pieces are in the file even if the program is killed. The file gets its name with
    the first piece; until then an earlier file of that name stays.
    """

    def __init__(
        self,
        crane: Crane,
        name: str,
        *,
        title: str,
        file: str | Path | None = None,
        viewer: str = "",
    ) -> None:
        """Open the recording.

        Args:
            crane: The crane.
            name: Name of the run.
            title: Heading of the recording.
            file: The file; None for none.
            viewer: Address of a running viewer, from `open_viewer` or `Server.data`; empty for
                none.

        Raises:
            DataError: If the file cannot be written.
            CraneError: If Rerun is switched off in the environment.
        """
        self._crane = crane
        self._name = name
        self._title = utf8(title)
        check_enabled()
        self._recording = rr.RecordingStream("cranedyn-live", send_properties=False)
        self._file = None if file is None else Path(file)
        self._draft: Draft | None = None
        if self._file is not None:
            # Rerun waits for ever where it cannot write its first bytes.
            check_writable(self._file)
            self._draft = Draft(self._file)
        try:
            self._recording.set_sinks(*self._sinks(viewer))
        except (OSError, RuntimeError, ValueError) as error:
            self.close()
            raise DataError(f"Cannot write {file}: {error}.") from error
        self._scene: Scene | None = None
        self._past: Trajectory | None = None
        self._start_energy = 0.0

    def _sinks(self, viewer: str) -> list[rr.FileSink | rr.GrpcSink]:
        """Return where Rerun is to send the recording: the draft, a viewer, or both."""
        sinks: list[rr.FileSink | rr.GrpcSink] = []
        if self._draft is not None:
            sinks.append(rr.FileSink(self._draft.path))
        if viewer:
            sinks.append(rr.GrpcSink(viewer))
        return sinks

    def append(self, piece: Trajectory) -> None:
        """Add the rows since the last piece.

        Args:
            piece: The rows, one at least.

        Raises:
            OutOfRange: If there is no row.
            DataError: If they cannot be written within ten seconds.
        """
        if not len(piece):
            raise OutOfRange("number of rows of a piece", 0, ">= 1")
        t_start = float(piece.t[0])
        # The path of the payload reaches back into earlier pieces; no plot does.
        recent = piece if self._past is None else join([self._past, piece])
        run = Run(self._name, self._crane, recent.since(t_start))
        if self._scene is None:
            (self._scene,) = _log_static(self._recording, [run], [], self._title, "")
            self._start_energy = float(piece.energy[0])
        self._scene.move(recent, t_start)
        log_series(self._recording, run, series_table(run, self._start_energy))
        log_readout(self._recording, [run])
        self._past = recent.since(float(piece.t[-1]) - PATH_SECONDS)
        try:
            self._recording.flush(timeout_sec=_FLUSH_SECONDS)
        except (RuntimeError, ValueError) as error:
            file = f" {self._file}" if self._file else ""
            raise DataError(f"The recording{file} could not be written: {error}.") from error
        if self._draft is not None:
            # The first piece is on the disk: now the file replaces an earlier one of its name.
            self._draft.sync()
            self._draft.name()
            sync_folder(self._draft.final.parent)
            self._draft = None

    def close(self) -> None:
        """Finish the file and disconnect from the viewer."""
        self._recording.disconnect()
        if self._draft is not None:
            self._draft.drop()

    def __enter__(self) -> Live:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def describe_runs(runs: Sequence[Run], title: str, text: str) -> str:
    """Return the text beside the scene, in Markdown: title, description, where the model does not
    hold, parameters of the runs, and how to read the scene.
    """
    sections = [f"## {title}", text]
    violations = _list_violations(runs)
    if violations:
        sections.append(f"**Where the model does not hold:**\n\n{violations}")
    sections.append(_parameter_table(runs))
    sections.append(_how_to_read(runs))
    return "\n\n".join(section for section in sections if section)


def _list_violations(runs: Sequence[Run]) -> str:
    """Return the events at which the model ceases to hold as a list in Markdown; empty for none."""
    lines = []
    for run in runs:
        if run.trajectory.valid.all():
            continue
        for event in events(run.crane, run.trajectory):
            t = run.trajectory.t[event.row]
            lines.append(f"- {printable(run.name)}, {t:.3f} s: {event.words}")
    return "\n".join(lines)


def _how_to_read(runs: Sequence[Run]) -> str:
    """Return what the parts of the scene mean, in Markdown."""
    text = (
        "**How to read the scene.** Dots: the payload in the last "
        f"{PATH_SECONDS:g} s. Wire box and grey line: payload and cable at the setpoint of the "
        "drives. Arrows under the trolley: the payload's deviation from the plumb line, orange "
        f"along the jib and blue across it, {looks(runs)[0].arrow:g} m for a degree. The tab "
        "*Payload* follows the payload."
    )
    if any("<mesh" in run.crane.urdf and run.meshes is None for run in runs):
        text += " Meshes of the URDF are not drawn."
    return text


def _parameter_table(runs: Sequence[Run]) -> str:
    """Return the parameters of runs as a table in Markdown, a column for each run."""
    parameters = [run.trajectory.parameters for run in runs]
    # A dictionary keeps the order in which the parameters come, which a set would not.
    names = dict[str, None]()
    for values in parameters:
        names.update(dict.fromkeys(values))
    run_names = [table_cell(run.name) for run in runs]
    rows = [["parameter", *run_names], ["---"] * (len(runs) + 1)]
    for name in names:
        cells = [table_cell(values.get(name, "")) for values in parameters]
        rows.append([table_cell(name), *cells])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _log_static(
    recording: rr.RecordingStream,
    runs: Sequence[Run],
    tables: Sequence[Table],
    title: str,
    text: str,
    *,
    gaps: bool = False,
) -> list[Scene]:
    """Log layout, text and all that does not move; return the scene of each run.

    Args:
        recording: Where to log.
        runs: The runs.
        tables: Their tables; empty for a run that is only beginning.
        title: Heading of the recording.
        text: Description in Markdown.
        gaps: Whether there are distances between cranes to plot.
    """
    send_layout(recording, dashboard(runs, tables, gaps=gaps))
    recording.send_recording_name(title)
    document = rr.TextDocument(describe_runs(runs, title, text), media_type="text/markdown")
    recording.log("text", document, static=True)
    recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    scenes = []
    for run, look in zip(runs, looks(runs), strict=True):
        scenes.append(Scene(recording, run, look))
    return scenes


def _finite_table(run: Run) -> Table:
    """Return the recorded columns of a run.

    Raises:
        OutOfRange: If it has no rows, or a value that is not finite.
    """
    if not len(run.trajectory):
        raise OutOfRange(f"number of rows of run {quoted(run.name)}", 0, ">= 1")
    columns = series_table(run)
    for name, values in columns.items():
        if not np.isfinite(values).all():
            value = values[~np.isfinite(values)][0]
            raise OutOfRange(f"{name} of run {quoted(run.name)}", value, "a finite number")
    return columns


def _application(title: str, runs: Sequence[Run]) -> str:
    """Return an application id for a title and runs.

    The viewer keeps one layout for each id: recordings of one id would be shown in the layout of
    the first. So the id holds a checksum of what tells recordings apart.
    """
    key = []
    for run in runs:
        last = run.trajectory.q[-1].tolist()
        key.append((run.name, run.offset, len(run.trajectory), last))
    slug = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")[:_MAX_SLUG_LENGTH]
    checksum = zlib.crc32(repr([title, key]).encode())
    return f"cranedyn-{slug}-{checksum:08x}"
