"""Chunks computed by the workers of a Dask cluster. Nothing else imports Dask."""

from __future__ import annotations

import logging
import socket
import time
from collections.abc import Mapping
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from urllib.parse import urlsplit

import numpy as np
import pyarrow as pa

from cranedyn.errors import CraneError
from cranedyn.sweep.chunk import evaluate
from cranedyn.sweep.pool import Rows

CONNECTING, WORKERLESS = 5.0, 60
"""Seconds in which a scheduler must answer, and in which a worker must come."""

_PAUSE, _LONGEST_GREETING = 0.1, 1_000_000


class Cluster:
    """The workers behind a scheduler.

    The scheduler gives the work of a worker that dies to others, and gives up a chunk whose fourth worker died (its
    ``allowed-failures``); any other chunk on those workers may be given up with it.
    """

    exact = False

    def __init__(self, study: str, scheduler: str) -> None:
        """Connect.

        Args:
            study: Name of the study, see `cranedyn.sweep.chunk.name_of`.
            scheduler: Its address, for example ``tcp://127.0.0.1:8786``.

        Raises:
            CraneError: If Dask is not installed or no scheduler answers.
        """
        try:
            from distributed import Client, KilledWorker
        except ImportError:
            raise CraneError("Sweeping on a cluster needs Dask; install it with: pip install 'cranedyn[dask]'") from None
        _check_address(scheduler)
        self._study, self._address, self._killed = study, scheduler, KilledWorker
        try:
            self._client = Client(scheduler, timeout=CONNECTING, set_as_default=False)
        except Exception as error:
            raise CraneError(f"No Dask scheduler answers at {scheduler}: {error or type(error).__name__}.") from error
        self._executor = self._client.get_executor(pure=False)
        self._busy: dict[Future, Rows] = {}

    def room(self) -> int:
        """Two for each thread of a worker, so that none has to wait for the next."""
        return max(1, 2 * self._threads())

    def submit(self, rows: Rows, columns: Mapping[str, np.ndarray]) -> None:
        """Send a chunk to the scheduler."""
        self._busy[self._executor.submit(evaluate, self._study, dict(columns))] = rows

    def wait(self) -> list[tuple[Rows, pa.Table | None]]:
        """The chunks that are done.

        Raises:
            CraneError: If the scheduler is gone, there is no worker for `WORKERLESS` seconds, or workers cannot import the study.
        """
        idle = 0
        while not (done := wait(self._busy, timeout=1.0, return_when=FIRST_COMPLETED).done):
            idle = 0 if self._threads() else idle + 1
            if idle >= WORKERLESS:
                raise CraneError(f"The scheduler at {self._address} has no worker; start some with: dask worker {self._address}")
        return [(self._busy.pop(future), self._table(future)) for future in done]

    def close(self) -> None:
        """Take back what is under way; a scheduler that is gone has been told of, and not again in Dask's log."""
        log = logging.getLogger("distributed.client")
        level = log.level
        log.setLevel(logging.CRITICAL)
        try:
            self._executor.shutdown(wait=False)
            self._client.close()
        finally:
            log.setLevel(level)

    def _table(self, future: Future) -> pa.Table | None:
        try:
            return future.result()
        except self._killed:
            return None
        except CraneError:
            raise
        except CancelledError:
            raise CraneError(
                f"The scheduler at {self._address} is gone, or runs a version of Dask that does not go with this one."
            ) from None
        except Exception as error:
            raise CraneError(f"The cluster at {self._address} failed: {type(error).__name__}: {error}") from error

    def _threads(self) -> int:
        try:
            return sum(self._client.nthreads().values())
        except Exception as error:
            raise CraneError(f"The scheduler at {self._address} is gone: {error or type(error).__name__}.") from error


def _check_address(scheduler: str) -> None:
    """Return if a Dask server greets there, with the length of its first message; Dask itself would wait for that without end."""
    try:
        parts = urlsplit(scheduler)
        host, port = parts.hostname, parts.port
    except (ValueError, TypeError, AttributeError):
        host = port = None
    if not (host and port and parts.scheme in ("tcp", "tls")):
        raise CraneError(f"The address of a scheduler is {scheduler!r}; allowed is one like tcp://127.0.0.1:8786.")
    greeting = _greeting(scheduler, (host, port)) if parts.scheme == "tcp" else bytes(8)
    if len(greeting) < 8 or int.from_bytes(greeting, "little") > _LONGEST_GREETING:
        raise CraneError(f"No Dask scheduler answers at {scheduler}: what listens there is something else.")


def _greeting(scheduler: str, place: tuple[str, int]) -> bytes:
    """The first bytes that are said there; a scheduler that is just being started may take its time to listen."""
    for again in range(round(CONNECTING / _PAUSE), -1, -1):
        try:
            with socket.create_connection(place, timeout=CONNECTING) as probe:
                return probe.recv(8, socket.MSG_WAITALL)
        except OSError as error:
            if not (again and isinstance(error, ConnectionRefusedError)):
                raise CraneError(f"No Dask scheduler answers at {scheduler}: {error.strerror or error}.") from error
        time.sleep(_PAUSE)
    return b""
