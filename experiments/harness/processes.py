"""Worker processes of an experiment."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, get_context
from queue import SimpleQueue
from typing import TypeVar

from cranedyn.checks import number
from cranedyn.errors import CraneError
from cranedyn.sweep.workers import end_with_parent

_Result = TypeVar("_Result")


class Workers:
    """Processes that compute one call at a time each, and are started as calls come in.

    Each has an executor of its own. The processes of one executor write their results into the same
    pipe. If one of them is killed while it writes, the executor waits for the rest of its message
    for ever, as the others keep the pipe open and wait for their turn to write.
    """

    def __init__(self, count: int) -> None:
        """Start no process yet.

        Args:
            count: The number of processes, at most.
        """
        self._count = count
        self._executors: list[ProcessPoolExecutor] = []
        self._idle: SimpleQueue[ProcessPoolExecutor] = SimpleQueue()
        # One thread for each process: it waits for the result.
        self._threads = ThreadPoolExecutor(count)

    def submit(self, function: Callable[..., _Result], *arguments: object) -> Future[_Result]:
        """Let the next process that is idle call a function.

        Returns:
            The result to come. It is a `CraneError` if any process is ended from outside.
        """
        if len(self._executors) < self._count:
            self._start_process()
        return self._threads.submit(self._call, function, *arguments)

    def kill(self) -> None:
        """End all processes at once, whatever they do; calls that are left fail."""
        for child in active_children():
            child.kill()

    def close(self) -> None:
        """End the processes once they have done what they are doing."""
        self._threads.shutdown(cancel_futures=True)
        for executor in self._executors:
            executor.shutdown()

    def _start_process(self) -> None:
        executor = ProcessPoolExecutor(
            max_workers=1, mp_context=get_context("spawn"), initializer=end_with_parent
        )
        self._executors.append(executor)
        executor.submit(os.getpid)  # The first call starts the process.
        # Now only the process itself holds the writing end of the pipe, so that the pipe ends with
        # it.
        executor._result_queue._writer.close()  # type: ignore[attr-defined]
        self._idle.put(executor)

    def _call(self, function: Callable[..., _Result], *arguments: object) -> _Result:
        """Call a function in a process, and wait for the result."""
        executor = self._idle.get()
        try:
            return executor.submit(function, *arguments).result()
        except BrokenProcessPool:
            # Without this result those of the others are of no use.
            self.kill()
            raise CraneError(
                "A process of the experiment was ended from outside; what it had done is lost."
            ) from None
        finally:
            self._idle.put(executor)


@contextmanager
def processes(jobs: int | None) -> Iterator[Workers]:
    """Yield processes that end with the context and with this process, even if that is killed.

    Args:
        jobs: The number of processes; None for one per processor.

    Raises:
        OutOfRange: If the number of jobs is not from 1 to 1024.
    """
    if jobs is None:
        jobs = os.cpu_count() or 1
    else:
        number("jobs", jobs, "", "1 to 1024")
    workers = Workers(jobs)
    try:
        yield workers
    except BaseException:
        workers.kill()
        raise
    finally:
        workers.close()
