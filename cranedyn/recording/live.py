"""A recording that grows while the run goes: into a file, into a viewer, or both."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType

import rerun as rr

from cranedyn.data.files import Draft, check_writable, sync_folder
from cranedyn.data.trajectory import Trajectory, join
from cranedyn.errors import DataError
from cranedyn.model.crane import Crane
from cranedyn.recording.dashboard import dashboard
from cranedyn.recording.record import check_enabled, describe
from cranedyn.recording.run import Run, utf8
from cranedyn.recording.scene import PATH_SECONDS, Scene, looks
from cranedyn.recording.series import log_series, table

_PATIENCE = 10.0


class Live:
    """Streams pieces of a run as they come; everything appended so far is in the file even if the
    program is killed.

    The file has its name from the first piece on; until then a file that was there stays.
    The scene shows the past that its path needs, so pieces may be short.
    """

    def __init__(
        self,
        crane: Crane,
        name: str,
        *,
        title: str,
        text: str = "",
        file: str | Path | None = None,
        viewer: str = "",
    ) -> None:
        """Open the recording.

        Args:
            crane: The crane.
            name: Name of the run.
            title: Heading of the recording.
            text: What it shows, in Markdown.
            file: Where to write, None for nowhere.
            viewer: Address of a running viewer, from `open_viewer` or `Server.data`, empty for
                none.

        Raises:
            DataError: If the file cannot be written.
            CraneError: If Rerun is switched off in the environment.
        """
        self._crane, self._name, self._title, self._text = crane, name, utf8(title), utf8(text)
        check_enabled()
        self._recording = rr.RecordingStream("cranedyn-live", send_properties=False)
        self._file = None if file is None else Path(file)
        if self._file:
            # Where not even the first bytes can be written, Rerun waits for ever.
            check_writable(self._file)
        self._draft = Draft(self._file) if self._file else None
        try:
            sinks = [rr.FileSink(self._draft.path)] if self._draft else []
            self._recording.set_sinks(*sinks, *([rr.GrpcSink(viewer)] if viewer else []))
        except (OSError, RuntimeError, ValueError) as error:
            self.close()
            raise DataError(f"Cannot write {file}: {error}.") from error
        self._scene: Scene | None = None
        self._past: Trajectory | None = None
        self._start_energy = 0.0

    def append(self, piece: Trajectory) -> None:
        """Add what happened since the last piece.

        Raises:
            DataError: If it cannot be written within ten seconds.
        """
        first = float(piece.t[0])
        shown = piece if self._past is None else join([self._past, piece])
        run, fresh = (
            Run(self._name, self._crane, shown),
            Run(self._name, self._crane, shown.since(first)),
        )
        if self._scene is None:
            self._scene, self._start_energy = self._begin(run), float(piece.energy[0])
        self._scene.move(run, since=first)
        log_series(self._recording, fresh, table(fresh, self._start_energy))
        self._past = shown.since(float(piece.t[-1]) - PATH_SECONDS)
        try:
            self._recording.flush(timeout_sec=_PATIENCE)
        except (RuntimeError, ValueError) as error:
            raise DataError(
                f"The recording{f' {self._file}' if self._file else ''} could not be written: "
                f"{error}."
            ) from error
        if self._draft:
            self._draft.sync()
            self._draft.name()
            sync_folder(self._draft.final.parent)
            self._draft = None

    def _begin(self, run: Run) -> Scene:
        self._recording.send_blueprint(dashboard([run], []), make_active=True, make_default=True)
        self._recording.send_recording_name(self._title)
        text = rr.TextDocument(describe([run], self._title, self._text), media_type="text/markdown")
        self._recording.log("text", text, static=True)
        self._recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        return Scene(self._recording, run, looks([run])[0])

    def close(self) -> None:
        """Finish the file and let the viewer go."""
        self._recording.disconnect()
        if self._draft:
            self._draft.drop()

    def __enter__(self) -> Live:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
