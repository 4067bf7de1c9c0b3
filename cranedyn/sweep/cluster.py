"""Workers of a Dask cluster. Nothing else imports Dask.

What is sent to and fro is pickled: the scheduler and every worker can run code in each other and in
the program that sweeps.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Mapping
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
    from distributed import Client
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


class DaskPool(Pool):
    """Workers behind a Dask scheduler.

    The scheduler gives the work of a worker that dies to others, and gives up a chunk whose fourth
    worker died (its ``allowed-failures``), and with it any other chunk on those workers.

    Raises:
        CraneError: If Dask is not installed, the certificates cannot be used, or no scheduler
            answers.
    """

    isolates_deaths = False

    def __init__(self, task: Task, scheduler: str, security: Security | None = None) -> None:
        """Connect to a scheduler, for example at ``tcp://127.0.0.1:8786``."""
        super().__init__(task)
        self._client = connect(scheduler, security)
        from distributed import KilledWorker

        # Not pure: a chunk that is tried again is computed again.
        self._executor = self._client.get_executor(pure=False)
        self._address = scheduler
        self._worker_death = KilledWorker
        self._last_worker_time = time.monotonic()
        self.death_message = DIED if task.limit == math.inf else _DIED_OR_LATE.format(task.limit)

    def capacity(self) -> int:
        """Return two for each thread of a worker, so that none waits for its next chunk.

        Without a worker it is one, so that the sweep waits for a worker to come.
        """
        return max(1, 2 * self._count_threads())

    def close(self) -> None:
        """Take back what is under way; a scheduler that is gone is not reported again."""
        disconnect(self._client, self._executor)

    def _start(self, columns: Mapping[str, np.ndarray]) -> Future[pa.Table]:
        return self._executor.submit(self._task.evaluate, columns)

    def _result(self, future: Future[pa.Table], rows: CaseRange) -> pa.Table | None:
        try:
            return future.result()
        except self._worker_death:
            return None
        except CraneError:
            raise
        except BaseException as error:
            raise self._failure(error) from error

    def _check_workers(self) -> None:
        if self._count_threads() or time.monotonic() - self._last_worker_time < WORKER_TIMEOUT:
            return
        raise no_worker(self._address)

    def _count_threads(self) -> int:
        """Return the number of threads of all workers, and note the time if there are any."""
        try:
            count = sum(self._client.nthreads().values())
        except Exception as error:
            raise self._failure(error) from error
        if count:
            self._last_worker_time = time.monotonic()
        return count

    def _failure(self, error: BaseException) -> CraneError:
        """Return the error of a sweep whose cluster raised one that is not the study's."""
        return cluster_failure(self._address, error)


def cluster_failure(scheduler: str, error: BaseException) -> CraneError:
    """Return the error for the user of a cluster that raised an error of its own."""
    reason = f"{type(error).__name__}: {error}".rstrip(": ")
    return CraneError(f"The cluster at {scheduler} failed or is gone: {reason}.")


def no_worker(scheduler: str) -> CraneError:
    """Return the error for a scheduler that has no worker."""
    return CraneError(
        f"The scheduler at {scheduler} has no worker; start some with: dask worker {scheduler} "
        "--host 127.0.0.1 --no-dashboard --dashboard-address 127.0.0.1:0 (of another machine, its "
        "own address and certificates for TLS)"
    )


def connect(scheduler: str, security: Security | None = None) -> Client:
    """Return a client of a Dask scheduler, for example at ``tcp://127.0.0.1:8786``.

    Raises:
        CraneError: If Dask is not installed, the certificates cannot be used, or no scheduler
            answers.
    """
    try:
        from distributed import Client
        from distributed.security import Security
    except ImportError as error:
        raise CraneError(_NO_DASK.format(error)) from None

    import asyncio

    try:
        asyncio.run(_check_answers(scheduler, security or Security()))
        return Client(scheduler, timeout=CONNECT_TIMEOUT, set_as_default=False, security=security)
    except Exception as error:
        reason = str(error).rstrip(".") or "it timed out"
        raise CraneError(f"No Dask scheduler answers at {scheduler}: {reason}.") from error


def disconnect(client: Client, executor: Any) -> None:
    """Take back what is under way on a cluster, and end the connection to its scheduler; one that
    is gone is not reported again.
    """
    from distributed.utils import silence_logging_cmgr

    with silence_logging_cmgr(logging.CRITICAL), suppress(TimeoutError):
        executor.shutdown(wait=False)
        client.close(CLOSE_TIMEOUT)


async def _check_answers(scheduler: str, security: Security) -> None:
    """Check that a Dask scheduler answers; a client would wait for ever for one that hangs."""
    import asyncio

    from distributed.comm import connect

    async with asyncio.timeout(CONNECT_TIMEOUT):
        comm = await connect(scheduler, CONNECT_TIMEOUT, **security.get_connection_args("client"))
        comm.abort()
