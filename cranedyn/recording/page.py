"""The page of Rerun's web viewer, handed on so that a browser talks to nobody but this machine."""

from __future__ import annotations

import shutil
import threading
from contextlib import closing, suppress
from http.client import HTTPConnection, HTTPException
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from cranedyn.recording.process import HOST

_POLICY = (
    "default-src 'self' data: blob:; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; "
    "connect-src 'self' data: blob: http://{host}:{data}; object-src 'none'; form-action 'none'; "
    "base-uri 'none'"
)
"""The page as it is sends what is done in it to Rerun, asks for its newest version, and fetches
examples and fonts."""


class Page(ThreadingHTTPServer):
    """Serves, on this machine alone, what the viewer's own web server does, with a policy that
    browsers keep.
    """

    daemon_threads = True

    def __init__(self, port: int, source: int, data: int) -> None:
        """Begin to serve, in a thread of this program.

        Args:
            port: Where.
            source: The port of the viewer's own web server.
            data: The port of the data.

        Raises:
            OSError: If the port is in use.
        """
        self.source, self.policy = source, _POLICY.format(host=HOST, data=data)
        super().__init__((HOST, port), _Handler)
        threading.Thread(target=self.serve_forever, daemon=True).start()

    def stop(self) -> None:
        """Serve no more."""
        self.shutdown()
        self.server_close()


class _Handler(BaseHTTPRequestHandler):
    server: Page

    def do_GET(self) -> None:
        with (
            closing(HTTPConnection(HOST, self.server.source, timeout=30.0)) as source,
            suppress(OSError),
        ):
            try:
                source.request(
                    "GET",
                    self.path,
                    headers={"Accept-Encoding": self.headers.get("Accept-Encoding", "identity")},
                )
                found = source.getresponse()
            except (OSError, HTTPException, ValueError):
                self.send_error(502)
                return
            self.send_response(found.status)
            for name, value in found.getheaders():
                if name.lower() not in ("server", "date", "connection", "transfer-encoding"):
                    self.send_header(name, value)
            self.send_header("Content-Security-Policy", self.server.policy)
            self.end_headers()
            shutil.copyfileobj(found, self.wfile)

    def log_message(self, form: str, *values: object) -> None:
        """Say nothing."""
