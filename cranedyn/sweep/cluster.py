"""Workers of a Dask cluster. Nothing else imports Dask.

What is sent to and fro is pickled: the scheduler and every worker can run code in each other and in
the program that sweeps.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from cranedyn.errors import CraneError, DataError
from cranedyn.sweep.pool import Pool
from cranedyn.sweep.study import DIED, CaseRange, Task

if TYPE_CHECKING:
    from distributed.security import Security

CONNECT_TIMEOUT = 5.0
"""Time in which a scheduler must answer [s]."""

WORKER_TIMEOUT = 60
"""Time in which a scheduler without a worker must get one [s]."""

CLOSE_TIMEOUT = 0.3
"""Time for which the end of the connection to a scheduler is waited for [s]."""

_DIED_OR_LATE = (
    "The worker process died on this case, or was ended since the case took longer than the "
    "{:g} s that a case may."
)
"""Error of a case that may have been ended at the time limit; only the worker's machine knows."""

_NO_DASK = "Work on a cluster needs Dask; install it with: pip install 'cranedyn[dask]' ({})."


def tls(ca_file: str, cert: str, key: str) -> Security:
    """Return certificates for an address that begins with ``tls://``.

    They are the same as those of the options of ``dask scheduler`` and ``dask worker``.

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
        raise CraneError(_NO_DASK.format(error)) from None
    for file in (ca_file, cert, key):
        if not Path(file).is_file():
            raise DataError(f"Cannot read {file}: there is no such file.")
    return Security(
        tls_ca_file=ca_file, tls_client_cert=cert, tls_client_key=key, require_encryption=True
    )


class Cluster:
    """Workers behind a Dask scheduler, and the connection to it.

    Attributes:
        address: Address of the scheduler.
        worker_death: Dask's error for work that it gives up, since workers died of it.
    """

    def __init__(self, address: str, security: Security | None = None) -> None:
        """Connect to a scheduler, for example at ``tcp://127.0.0.1:8786``.

        Raises:
            CraneError: If Dask is not installed, the certificates cannot be used, or no scheduler
                answers.
        """
        try:
            from distributed import Client, KilledWorker
            from distributed.security import Security
        except ImportError as error:
            raise CraneError(_NO_DASK.format(error)) from None

        import asyncio

        try:
            asyncio.run(_check_answers(address, security or Security()))
            self._client = Client(
                address, timeout=CONNECT_TIMEOUT, set_as_default=False, security=security
            )
        except Exception as error:
            reason = str(error).rstrip(".") or "it timed out"
            raise CraneError(f"No Dask scheduler answers at {address}: {reason}.") from error
        # Not pure: what is tried again is computed again.
        self._executor = self._client.get_executor(pure=False)
        self.address = address
        self.worker_death = KilledWorker
        self._last_worker_time = time.monotonic()

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Let a worker call a function of a module that it can import."""
        future: Future[Any] = self._executor.submit(function, *arguments)
        return future

    def count_threads(self) -> int:
        """Return the number of threads of all workers, and note the time if there are any.

        Raises:
            CraneError: If the scheduler is gone.
        """
        try:
            count = sum(self._client.nthreads().values())
        except Exception as error:
            raise self.failure(error) from error
        if count:
            self._last_worker_time = time.monotonic()
        return count

    def check_workers(self) -> None:
        """Check that the scheduler has a worker, or has had one a while ago.

        Raises:
            CraneError: If it has had none for `WORKER_TIMEOUT`, or is gone.
        """
        if self.count_threads() or time.monotonic() - self._last_worker_time < WORKER_TIMEOUT:
            return
        raise CraneError(
            f"The scheduler at {self.address} has no worker; start some with: dask worker "
            f"{self.address} --host 127.0.0.1 --no-dashboard --dashboard-address "
            "127.0.0.1:0 (of another machine, its own address and certificates for TLS)"
        )

    def failure(self, error: BaseException) -> CraneError:
        """Return the error for the user of a cluster that raised an error of its own."""
        reason = f"{type(error).__name__}: {error}".rstrip(": ")
        return CraneError(f"The cluster at {self.address} failed or is gone: {reason}.")

    def close(self) -> None:
        """Take back what no worker has begun, and end the connection; a scheduler that is gone is
        not reported again.
        """
        from distributed.utils import silence_logging_cmgr

        with silence_logging_cmgr(logging.CRITICAL), suppress(TimeoutError):
            self._executor.shutdown(wait=False)
            self._client.close(CLOSE_TIMEOUT)


class DaskPool(Pool):
    """Workers of a cluster that evaluate chunks of a sweep.

    The scheduler gives the work of a worker that dies to others, and gives up a chunk whose fourth
    worker died (its ``allowed-failures``), and with it any other chunk on those workers.
    """

    isolates_deaths = False

    def __init__(self, task: Task, scheduler: str, security: Security | None = None) -> None:
        """Connect to a scheduler.

        Raises:
            CraneError: As `Cluster`.
        """
        super().__init__(task)
        self._cluster = Cluster(scheduler, security)
        self.death_message = DIED if task.limit == math.inf else _DIED_OR_LATE.format(task.limit)

    def capacity(self) -> int:
        """Return two for each thread of a worker, so that none waits for its next chunk.

        Without a worker it is one, so that the sweep waits for a worker to come.
        """
        return max(1, 2 * self._cluster.count_threads())

    def close(self) -> None:
        """See `Cluster.close`."""
        self._cluster.close()

    def _start(self, columns: Mapping[str, np.ndarray]) -> Future[pa.Table]:
        return self._cluster.submit(self._task.evaluate, columns)

    def _result(self, future: Future[pa.Table], rows: CaseRange) -> pa.Table | None:
        try:
            return future.result()
        except self._cluster.worker_death:
            return None
        except CraneError:
            raise
        except BaseException as error:
            raise self._cluster.failure(error) from error

    def _check_workers(self) -> None:
        self._cluster.check_workers()


async def _check_answers(scheduler: str, security: Security) -> None:
    """Check that a Dask scheduler answers; a client would wait for ever for one that hangs."""
    import asyncio

    from distributed.comm import connect

    async with asyncio.timeout(CONNECT_TIMEOUT):
        comm = await connect(scheduler, CONNECT_TIMEOUT, **security.get_connection_args("client"))
        comm.abort()
