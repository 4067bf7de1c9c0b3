"""Streams of Rerun that end with what they record.

Each `rerun.RecordingStream` has threads and buffers of its own. Rerun keeps them until the process
ends where a stream writes to memory, since the stream and its memory refer to each other
(https://github.com/rerun-io/rerun/issues/2116). A process that makes hundreds of recordings, such
as a notebook or a server, would keep two streams and 4 MB for each; so the streams here are
disconnected, and Rerun is told to drop them.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb
import rerun_bindings

from cranedyn.data.files import atomic_write


@contextmanager
def recording_file(path: Path, application: str) -> Iterator[rr.RecordingStream]:
    """Yield a stream; write what was logged to it into a file, unless an error is raised.

    Args:
        path: The file, which gets its name once it is whole.
        application: Name of the application that the recording says it is from; Rerun's viewer
            keeps a layout for each.

    Raises:
        DataError: If the file cannot be written.
    """
    recording = rr.RecordingStream(application, send_properties=False)
    memory = recording.memory_recording()
    try:
        yield recording
    finally:
        # Also after Ctrl-C: Rerun prints that it drops data where nobody takes it.
        content = memory.drain_as_bytes()
        recording.disconnect()
        # Those before this one, which the caller still holds.
        rerun_bindings.flush_and_cleanup_orphaned_recordings()
    with atomic_write(path) as draft:
        draft.write_bytes(content)


def send_layout(recording: rr.RecordingStream, layout: rrb.Blueprint) -> None:
    """Send the layout that a viewer shows a recording in.

    It does what `rerun.RecordingStream.send_blueprint` does, and disconnects the stream of the
    layout, to which nobody has access there.
    """
    stream = rr.RecordingStream._from_native(
        rerun_bindings.new_blueprint(
            application_id=rr.get_application_id(recording) or "",
            make_default=False,
            make_thread_default=False,
        )
    )
    stream.set_time("blueprint", sequence=0)
    layout._log_to_stream(stream)
    rerun_bindings.send_blueprint(
        stream.memory_recording().storage,
        make_active=True,
        make_default=True,
        recording=recording.to_native(),
    )
    stream.disconnect()
