"""A recording to look at: in a window, or in a browser on this machine."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import rerun as rr

from cranedyn.checks import whole
from cranedyn.data.files import open_file
from cranedyn.errors import CraneError, DataError, OutOfRange
from cranedyn.recording.page import Page
from cranedyn.recording.process import HOST, await_ready, end, free, free_port, start

_INSTEAD = "write the recording with --save, or look at it in a browser with --serve"


def check(path: str | Path) -> Path:
    """The path, if a recording stands there that this version of Rerun shows.

    Raises:
        DataError: If the file cannot be read, is no recording, or was written by another version.
    """
    path = Path(path)
    try:
        with open_file(path) as file:
            head = file.read(8)
    except (OSError, ValueError) as error:
        raise DataError(
            f"Cannot read {path}: {getattr(error, 'strerror', None) or error}."
        ) from error
    if len(head) < 8 or head[:4] != b"RRF2":
        raise DataError(f"{path} is not a Rerun recording.")
    theirs, ours = f"{head[4]}.{head[5]}", ".".join(rr.__version__.split(".")[:2])
    if theirs != ours:
        raise DataError(
            f"{path} was written by Rerun {theirs} and this is Rerun {ours}; record it again."
        )
    return path


def check_display() -> None:
    """Return if a window can be opened.

    Raises:
        CraneError: If there is no display.
    """
    if sys.platform == "linux" and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        raise CraneError(f"There is no display to open a window on; {_INSTEAD}.")


def open_viewer(path: str | Path | None = None) -> str:
    """Show a recording in a window, which stays open when the program ends.

    Args:
        path: The recording; None for a window that waits for a live one.

    Returns:
        Where the window takes live data.

    Raises:
        DataError: If there is no recording there.
        CraneError: If there is no display, or the viewer cannot be started.
    """
    shown = [] if path is None else [str(check(path).resolve())]
    check_display()
    port = free_port()
    process = start(*shown, "--bind", HOST, "--port", str(port), own_session=True)
    await_ready(process, lambda: not free(port), f"Instead, {_INSTEAD}.")
    return _data(port)


def _data(port: int) -> str:
    return f"rerun+http://{HOST}:{port}/proxy"


@dataclass(frozen=True)
class Server:
    """A recording being served, until the context is left, `stop` is called, or the program is
    interrupted while it waits.

    Attributes:
        address: What to open in a browser on this machine.
        data: Where it takes live data.
        process: The viewer behind it.
        page: What browsers are handed.
    """

    address: str
    data: str
    process: subprocess.Popen[bytes]
    page: Page

    @property
    def words(self) -> str:
        """What to tell the user."""
        return (
            f"Serving at {self.address} until Ctrl-C. Every program on this machine can read "
            "what is served, and add to it."
        )

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *exception: object) -> None:
        self.stop()

    def wait(self) -> None:
        """Return when the server has ended; Ctrl-C or SIGTERM, which serving was asked for until,
        ends it.
        """
        try:
            self.process.wait()
        except KeyboardInterrupt:
            pass
        finally:
            self.stop()

    def stop(self) -> None:
        """End the server."""
        self.page.stop()
        end(self.process)


def check_port(port: int) -> None:
    """Return if a port and the next are free on this machine.

    Raises:
        OutOfRange: If there is no such port.
        CraneError: If one of the two is in use.
    """
    if not 1 <= whole("port", port, 1) <= 65534:
        raise OutOfRange("port", port, "1 to 65534")
    for taken in (port, port + 1):
        if not free(taken):
            raise CraneError(
                f"Port {taken} of {HOST} is in use; serving takes {port} and {port + 1}: choose "
                "another first port with --port."
            )


def serve(path: str | Path | None = None, *, port: int = 9090) -> Server:
    """Serve a recording with its viewer to browsers on this machine alone; the page talks to nobody
    else.

    Args:
        path: The recording; None for a page that waits for a live one.
        port: Where the page is; the data is at the next port.

    Raises:
        DataError: If there is no recording there.
        OutOfRange: If there is no such port.
        CraneError: If a port is in use, or the viewer cannot be started.
    """
    shown = [] if path is None else [str(check(path).resolve())]
    check_port(port)
    inner, data = free_port(), _data(port + 1)
    process = start(
        "--serve-web",
        "--bind",
        HOST,
        "--web-viewer-port",
        str(inner),
        "--port",
        str(port + 1),
        *shown,
    )
    await_ready(
        process, lambda: not free(inner) and not free(port + 1), "It could not serve the recording."
    )
    try:
        page = Page(port, inner, port + 1)
    except OSError as error:
        end(process)
        raise CraneError(
            f"The page cannot be served at port {port} of {HOST}: {error.strerror}."
        ) from error
    return Server(f"http://{HOST}:{port}/?url={quote(data, safe='')}", data, process, page)
