"""Chunks computed by the workers of a Dask cluster. Nothing else imports Dask.

What is sent to and fro is pickled: the scheduler and every worker can run code in each other and in
the program that sweeps.
"""

from __future__ import annotations

import logging
import math
import os
import signal
import socket
import threading
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from contextlib import contextmanager, suppress
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import numpy as np
import pyarrow as pa

from cranedyn.errors import CraneError, DataError, shown, written_out
from cranedyn.sweep.chunk import DIED, evaluate
from cranedyn.sweep.pool import Rows

if TYPE_CHECKING:
    from distributed.security import Security

CONNECTING, WORKERLESS = 5.0, 60
"""Seconds in which a scheduler must answer, and in which a worker must come."""

CLOSING = 0.3
"""Seconds for taking leave of a scheduler."""

_PAUSE, _LONGEST_GREETING, _LONGEST_ALARM = 0.1, 1_000_000, 1e8

_LATE = (
    "The worker process died on this case, or was ended since the case took longer than the "
    "{:g} s that a case may."
)


class Cluster:
    """The workers behind a scheduler.

    The scheduler gives the work of a worker that dies to others, and gives up a chunk whose fourth
    worker died (its ``allowed-failures``); any other chunk on those workers may be given up with
    it.
    """

    exact = False

    def __init__(
        self,
        study: str,
        code: str,
        scheduler: str,
        security: Security | None = None,
        limit: float = math.inf,
    ) -> None:
        """Connect.

        Args:
            study: Name of the study, see `cranedyn.sweep.chunk.name_of`.
            code: Checksum of its sources.
            scheduler: Its address, for example ``tcp://127.0.0.1:8786``.
            security: Certificates for an address that begins with ``tls://``; by default those of
                Dask's configuration.
            limit: How long a case may take [s]; a chunk of more has so many times as long. The
                worker whose chunk takes longer ends itself.

        Raises:
            CraneError: If Dask is not installed, the certificates cannot be used, or no scheduler
                answers.
        """
        try:
            from distributed import Client, KilledWorker
        except ImportError as error:
            raise _no_dask(error) from None
        _check_security(scheduler, security)
        _check_address(scheduler)
        self._task = study, code, limit
        self._address, self._killed = scheduler, KilledWorker
        self.lost = DIED if limit == math.inf else _LATE.format(limit)
        try:
            self._client = _client(Client)(
                scheduler, timeout=CONNECTING, set_as_default=False, security=security
            )
        except Exception as error:
            raise CraneError(
                f"No Dask scheduler answers at {scheduler}: {error or type(error).__name__}."
            ) from error
        self._executor = self._client.get_executor(pure=False)
        self._busy: dict[Future, Rows] = {}

    def room(self) -> int:
        """Two for each thread of a worker, so that none has to wait for the next."""
        return max(1, 2 * self._threads())

    def submit(self, rows: Rows, columns: Mapping[str, np.ndarray]) -> None:
        """Send a chunk to the scheduler."""
        study, code, limit = self._task
        self._busy[self._executor.submit(evaluated, study, dict(columns), code, limit)] = rows

    def wait(self) -> list[tuple[Rows, pa.Table | None]]:
        """The chunks that are done.

        Raises:
            CraneError: If the scheduler is gone, there is no worker for `WORKERLESS` seconds, or
                workers cannot import the study.
        """
        idle = 0
        while not (done := wait(self._busy, timeout=1.0, return_when=FIRST_COMPLETED).done):
            idle = 0 if self._threads() else idle + 1
            if idle >= WORKERLESS:
                raise CraneError(
                    f"The scheduler at {self._address} has no worker; start some with: dask worker "
                    f"{self._address} --host 127.0.0.1 "
                    "--no-dashboard --dashboard-address 127.0.0.1:0 (of another machine, its own "
                    "address and certificates for TLS)"
                )
        return [(self._busy.pop(future), self._table(future)) for future in done]

    def close(self) -> None:
        """Take back what is under way; a scheduler that is gone has been told of, and not again in
        Dask's log.
        """
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
                f"The scheduler at {self._address} is gone, or runs a version of Dask that does "
                "not go with this one."
            ) from None
        except Exception as error:
            raise CraneError(
                f"The cluster at {self._address} failed: {type(error).__name__}: {error}"
            ) from error

    def _threads(self) -> int:
        try:
            return sum(self._client.nthreads().values())
        except Exception as error:
            raise CraneError(
                f"The scheduler at {self._address} is gone: {error or type(error).__name__}."
            ) from error


def _client(kind: Any) -> Any:
    """A kind of client that takes leave soon, also of a scheduler that never answered; its
    interpreter would wait for that to end.
    """

    class Brief(kind):  # type: ignore[misc]
        def close(self, timeout: float = CLOSING) -> None:
            with suppress(TimeoutError):
                super().close(timeout)

    return Brief


def evaluated(study: str, columns: Mapping[str, np.ndarray], code: str, limit: float) -> pa.Table:
    """What a worker does, see `cranedyn.sweep.chunk.evaluate`; its process ends if that takes
    longer than so long a case [s].
    """
    with _alarm(limit * len(next(iter(columns.values())))):
        return evaluate(study, columns, code)


_deadlines: dict[object, float] = {}
_setting = threading.Lock()


@contextmanager
def _alarm(seconds: float) -> Iterator[None]:
    """End this process unless the context ends before; several threads may be in one.

    The system's own timer does so, of which a process has one, even where compiled code lets no
    other thread have its turn.
    """
    if seconds == math.inf:
        yield
        return
    me = object()
    with _setting:
        _deadlines[me] = time.monotonic() + seconds
        _set_timer()
    try:
        yield
    finally:
        with _setting:
            del _deadlines[me]
            _set_timer()


def _set_timer() -> None:
    left = min(_deadlines.values()) - time.monotonic() if _deadlines else 0.0
    signal.setitimer(
        signal.ITIMER_REAL, min(max(left, 1e-3), _LONGEST_ALARM) if _deadlines else 0.0
    )


def tls(ca_file: str, cert: str, key: str) -> Security:
    """Certificates for an address that begins with ``tls://``, the same as the options of ``dask
    scheduler`` and ``dask worker``.

    Args:
        ca_file: File of the certificates by which others are known, PEM.
        cert: File of the certificate of this program, PEM.
        key: File of its private key, PEM.

    Raises:
        CraneError: If Dask is not installed or one of these is no file.
    """
    try:
        from distributed.security import Security
    except ImportError as error:
        raise _no_dask(error) from None
    for file in (ca_file, cert, key):
        if not os.path.isfile(file):
            raise DataError(f"Cannot read {file}: there is no such file.")
    return Security(
        tls_ca_file=ca_file, tls_client_cert=cert, tls_client_key=key, require_encryption=True
    )


def _no_dask(error: ImportError) -> CraneError:
    if isinstance(error, ModuleNotFoundError):
        return CraneError(
            "Sweeping on a cluster needs Dask; install it with: pip install 'cranedyn[dask]'"
        )
    return CraneError(f"Sweeping on a cluster needs Dask, which cannot be imported: {error}.")


def _check_security(scheduler: str, security: Security | None) -> None:
    """Return if there are certificates that can be used for an address that needs them, and none in
    vain.
    """
    from distributed.security import Security

    if security is not None and not isinstance(security, Security):
        raise CraneError(
            f"security is {shown(security)}; allowed is a distributed.security.Security."
        )
    try:
        context = (security or Security()).get_connection_args("client")["ssl_context"]
    except (OSError, ValueError, TypeError) as error:
        raise DataError(f"The certificates for TLS cannot be used: {error}.") from error
    encrypted = written_out(scheduler).startswith("tls://")
    if encrypted and context is None:
        raise CraneError(
            f"The scheduler at {scheduler} needs certificates for TLS; give them, see "
            "docs/sweeps.md."
        )
    if security is not None and not encrypted:
        raise CraneError(
            f"Certificates have no effect on {written_out(scheduler)}; the address of a scheduler "
            "with TLS begins with tls://."
        )


def _check_address(scheduler: str) -> None:
    """Return if a Dask server greets there, with the length of its first message; Dask itself would
    wait for that without end.

    One with TLS says nothing before it has been spoken to: there it is enough that somebody
    listens.
    """
    try:
        parts = urlsplit(scheduler)
        host, port = parts.hostname, parts.port
        (host or "").encode("idna")
    except (ValueError, TypeError, AttributeError):
        host = port = None
    if not (
        host
        and port
        and parts.scheme in ("tcp", "tls")
        and "@" not in parts.netloc
        and scheduler == f"{parts.scheme}://{parts.netloc}"
    ):
        raise CraneError(
            f"The address of a scheduler is {shown(scheduler)}; allowed is one like "
            "tcp://127.0.0.1:8786."
        )
    greeting = _greeting(scheduler, (host, port), 8 if parts.scheme == "tcp" else 0)
    if parts.scheme == "tcp" and (
        len(greeting) < 8 or int.from_bytes(greeting, "little") > _LONGEST_GREETING
    ):
        raise CraneError(
            f"No Dask scheduler answers at {scheduler}: what listens there is something else."
        )


def _greeting(scheduler: str, place: tuple[str, int], count: int) -> bytes:
    """The first bytes that are said there.

    They are asked for in a thread of its own: the system looks up names as long as it likes, and
    does not hear of Ctrl-C meanwhile.
    """
    answer: SimpleQueue[bytes | Exception] = SimpleQueue()
    threading.Thread(target=lambda: answer.put(_asked(place, count)), daemon=True).start()
    try:
        said = answer.get(timeout=2.0 * CONNECTING + 1.0)
    except Empty:
        said = TimeoutError("timed out")
    if isinstance(said, Exception):
        raise CraneError(
            f"No Dask scheduler answers at {scheduler}: {getattr(said, 'strerror', None) or said}."
        ) from said
    return said


def _asked(place: tuple[str, int], count: int) -> bytes | Exception:
    """What is said there, or why not; a scheduler that is just being started may take its time to
    listen.
    """
    for again in range(round(CONNECTING / _PAUSE), -1, -1):
        try:
            with socket.create_connection(place, timeout=CONNECTING) as probe:
                return probe.recv(count, socket.MSG_WAITALL) if count else b""
        except (OSError, UnicodeError) as error:
            if not (again and isinstance(error, ConnectionRefusedError)):
                return error
        time.sleep(_PAUSE)
    return b""
