"""Look at a recording: in a window, or in a browser on this machine.

See `cranedyn.recording.process` for why Rerun's own `spawn` and `serve_web_viewer` are not used.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import closing, suppress
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPException
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import quote

import rerun as rr

from cranedyn.checks import whole
from cranedyn.data.files import open_file
from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import CraneError, DataError, OutOfRange
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.recording.contents import Run
from cranedyn.recording.process import HOST, end, free_port, is_free, start
from cranedyn.recording.recorder import record

_INSTEAD = "show the recording in a browser instead: cranedyn view {} --serve"
"""What to do where no window can be opened, with a place for the file."""

_MAGIC = b"RRF2"
"""First bytes of a recording; Rerun's version follows: major and minor number in a byte each."""

_HEADER_BYTES = 8
"""Number of bytes of which both are the beginning."""

_MAX_PORT = 65534
"""Largest port of a page: its data is at the next one, which must be a port, too."""

_POLLING_PERIOD = 0.1
"""Time between two looks at whether the viewer has ended [s]."""

_NOT_FORWARDED = ("server", "date", "connection", "transfer-encoding")
"""Headers of the viewer's own server that are left out: they are about that connection, or set by
the server that answers."""

_POLICY = (
    "default-src 'self' data: blob:; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; "
    "connect-src 'self' data: blob: http://{host}:{data}; object-src 'none'; form-action 'none'; "
    "base-uri 'none'"
)
"""Rerun's page without it sends analytics, asks for its newest version, and fetches examples."""


def view(
    run: Trajectory,
    crane: Crane | None = None,
    *,
    name: str = "run",
    file: str | Path | None = None,
) -> Path:
    """Record a run and open the recording in a window.

    Args:
        run: The run.
        crane: Its crane; None for the crane that its record names.
        name: Name of the run.
        file: The recording; None for a temporary file.

    Returns:
        The recording.

    Raises:
        DataError: If the recording cannot be written, or the record names no crane.
        CraneError: If there is no display; the recording is kept.
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


def check_recording(path: str | Path) -> Path:
    """Return the path of a recording that this version of Rerun shows.

    Raises:
        DataError: If the file cannot be read, is no recording, or is of another version of Rerun.
    """
    path = Path(path)
    with open_file(path) as file:
        head = file.read(_HEADER_BYTES)
    if len(head) < _HEADER_BYTES or not head.startswith(_MAGIC):
        raise DataError(f"{path} is not a Rerun recording.")
    file_version = f"{head[4]}.{head[5]}"
    installed_version = ".".join(rr.__version__.split(".")[:2])
    if file_version != installed_version:
        raise DataError(
            f"{path} was written by Rerun {file_version} and this is Rerun {installed_version}; "
            "record it again."
        )
    return path


def check_display(path: str | Path = "FILE.rrd") -> None:
    """Return if a window can be opened for a recording.

    Raises:
        CraneError: If there is no display; the message says what to do instead.
    """
    displays = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform == "linux" and not displays:
        instead = _INSTEAD.format(shlex.quote(str(path)))
        raise CraneError(f"There is no display to open a window on; {instead}.")


def check_port(port: int) -> None:
    """Return if a port and the next are free on this machine.

    Raises:
        OutOfRange: If there is no such port.
        CraneError: If one of the two is in use.
    """
    if not 1 <= whole("port", port, 1) <= _MAX_PORT:
        raise OutOfRange("port", port, f"1 to {_MAX_PORT}")
    for number in (port, port + 1):
        if not is_free(number):
            raise CraneError(
                f"Port {number} of {HOST} is in use; serving takes {port} and {port + 1}: choose "
                "another first port with --port."
            )


def open_viewer(path: str | Path | None = None) -> str:
    """Show a recording in a window, which stays open when the program ends.

    Args:
        path: The recording; None for a window that waits for a live one.

    Returns:
        The address at which the window takes live data.

    Raises:
        DataError: If the path is no recording of this version of Rerun.
        CraneError: If there is no display, or the viewer cannot be started.
    """
    files = [] if path is None else [str(check_recording(path).resolve())]
    check_display(*files)
    port = free_port()
    shown = files[0] if files else "FILE.rrd"
    hint = f"You can {_INSTEAD.format(shlex.quote(shown))}."
    start(*files, "--port", str(port), ports=[port], hint=hint, detached=True)
    return data_address(port)


def serve(path: str | Path | None = None, *, port: int = 9090) -> Server:
    """Serve a recording to browsers on this machine; the page connects to nothing else.

    Args:
        path: The recording; None for a page that waits for a live one.
        port: Port of the page; the data is at the next port.

    Returns:
        The server, which ends with this program at the latest.

    Raises:
        DataError: If the path is no recording of this version of Rerun.
        OutOfRange: If there is no such port.
        CraneError: If a port is in use, or the viewer cannot be started.
    """
    files = [] if path is None else [str(check_recording(path).resolve())]
    check_port(port)
    web_port = free_port()
    data_port = port + 1
    options = ["--serve-web", "--web-viewer-port", str(web_port), "--port", str(data_port)]
    hint = "It could not serve the recording."
    process = start(*options, *files, ports=[web_port, data_port], hint=hint)
    try:
        page = _serve_page(port, web_port, data_port)
    except OSError as error:
        end(process)
        raise CraneError(
            f"The page cannot be served at port {port} of {HOST}: {error.strerror}."
        ) from error
    data = data_address(data_port)
    return Server(f"http://{HOST}:{port}/?url={quote(data, safe='')}", data, process, page)


def data_address(port: int) -> str:
    """Return the address at which a viewer takes data."""
    return f"rerun+http://{HOST}:{port}/proxy"


def _serve_page(port: int, web_port: int, data_port: int) -> ThreadingHTTPServer:
    """Serve the page of the viewer's own web server at another port, with `_POLICY`.

    Rerun has no option for headers of its answers, so this server passes them on with one more.

    Args:
        port: Port of the page.
        web_port: Port of the viewer's own web server.
        data_port: Port from which the page takes its data.

    Raises:
        OSError: If the port cannot be taken.
    """
    policy = _POLICY.format(host=HOST, data=data_port)

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            # A browser that goes away, or a viewer that has ended, is no error of this server.
            with (
                suppress(OSError, HTTPException, ValueError),
                closing(HTTPConnection(HOST, web_port, timeout=30.0)) as source,
            ):
                encoding = self.headers.get("Accept-Encoding", "identity")
                source.request("GET", self.path, headers={"Accept-Encoding": encoding})
                response = source.getresponse()
                self.send_response(response.status)
                for name, value in response.getheaders():
                    if name.lower() not in _NOT_FORWARDED:
                        self.send_header(name, value)
                self.send_header("Content-Security-Policy", policy)
                self.end_headers()
                shutil.copyfileobj(response, self.wfile)

        def log_message(self, *arguments: object) -> None:
            """Print nothing; the inherited method prints a line for each request."""

    page = ThreadingHTTPServer((HOST, port), Handler)
    threading.Thread(target=page.serve_forever, daemon=True).start()
    return page


@dataclass(frozen=True)
class Server:
    """A recording being served until `stop`, the end of the context, or Ctrl-C during `wait`.

    Attributes:
        address: Address for a browser on this machine.
        data: Address at which it takes live data.
        process: The viewer's process.
        page: The server of the page.
    """

    address: str
    data: str
    process: subprocess.Popen[bytes]
    page: ThreadingHTTPServer

    @property
    def message(self) -> str:
        """Where it serves, until when, and who can connect."""
        return (
            f"Serving at {self.address} until Ctrl-C. Every program on this machine can read "
            "what is served, and add to it."
        )

    def wait(self) -> None:
        """Return when the server has ended; Ctrl-C or SIGTERM ends it."""
        with self, suppress(KeyboardInterrupt):
            # A signal just before a wait without limit would be seen only after it.
            while self.process.poll() is None:
                time.sleep(_POLLING_PERIOD)

    def stop(self) -> None:
        """End the server."""
        self.page.shutdown()
        self.page.server_close()
        end(self.process)

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *exception: object) -> None:
        self.stop()
