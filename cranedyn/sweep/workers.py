"""Worker processes of this machine; they end with the process that started them."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import resource
import signal
import sys
import threading
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.process import BaseProcess
from typing import Any

import numpy as np
import pyarrow as pa

from cranedyn.command import defer_sigint
from cranedyn.errors import CraneError
from cranedyn.sweep.pool import Pool
from cranedyn.sweep.study import DIED, LATE, CaseRange, Task, failure

FILES_PER_WORKER = 8
"""Files that a worker takes in this process, at most: both ends of the three pipes of its executor,
and two more by which a process and its parent notice each other's end."""

SPARE_FILES = 256
"""Files that this process may open beside those of its workers."""

_PR_SET_PDEATHSIG = 1
"""Option of prctl(2): the signal that a process gets when its parent ends."""


class LocalPool(Pool):
    """Processes of this machine, each with an executor of its own.

    When one process of a `ProcessPoolExecutor` dies, all futures of the executor fail, and none
    says which call was to blame. With one process in each, one chunk fails, the others go on, and
    the exit code tells whether a case took too long.

    Raises:
        CraneError: If a process cannot be started, or cannot import the study.
    """

    isolates_deaths = True
    death_message = DIED

    def __init__(self, task: Task, count: int) -> None:
        """Start so many processes at once, and wait until they have imported the study."""
        super().__init__(task)
        self._workers: list[_Worker] = []
        self._idle: list[_Worker] = []
        self._busy: dict[Future[pa.Table], _Worker] = {}
        _allow_open_files(SPARE_FILES + FILES_PER_WORKER * count)
        try:
            started = [self._start_worker() for _ in range(count)]
            for worker in started:
                worker.check_started()
        except BaseException:
            self.close()
            raise
        self._idle += started

    def capacity(self) -> int:
        """Return the number of processes: a chunk that waited for one would fail with it."""
        return len(self._workers)

    def close(self) -> None:
        """End the processes, whatever they do."""
        # `Executor.shutdown` lets a call that runs go on to its end. Executors have `kill_workers`
        # from Python 3.14 on.
        for worker in self._workers:
            worker.process.kill()
        for worker in self._workers:
            worker.end()

    def _start_worker(self) -> _Worker:
        with ignore_sigint():  # until `close` knows of the process
            worker = _Worker(self._task)
            self._workers.append(worker)
        return worker

    def _replace(self, worker: _Worker) -> _Worker:
        """Start a process in the place of one that has ended, and wait for it."""
        self._workers.remove(worker)
        successor = self._start_worker()
        successor.check_started()
        return successor

    def _start(self, columns: Mapping[str, np.ndarray]) -> Future[pa.Table]:
        worker = self._idle.pop()
        try:
            future = worker.executor.submit(self._task.evaluate, columns)
        except BrokenProcessPool:  # it was ended while it was idle: this chunk is not to blame
            worker.end()
            worker = self._replace(worker)
            future = worker.executor.submit(self._task.evaluate, columns)
        self._busy[future] = worker
        return future

    def _result(self, future: Future[pa.Table], rows: CaseRange) -> pa.Table | None:
        worker = self._busy.pop(future)
        # Not raised, as Ctrl-C may be raised here, too.
        error = future.exception()
        if isinstance(error, CraneError):
            raise error
        table: pa.Table | None = None
        if error is None:
            table = future.result()
        elif isinstance(error, BrokenProcessPool):
            # The timer of `Task.evaluate` ends a process by SIGALRM. Of several cases it is open
            # which took too long.
            is_late = worker.end() == -signal.SIGALRM
            if is_late and rows.size == 1:
                table = failure(LATE.format(self._task.limit))
            worker = self._replace(worker)
        # Any other error is none of the study's, such as a lack of memory for the table of the
        # results: the chunk is halved, as if its process had died.
        self._idle.append(worker)
        return table

    def _check_workers(self) -> None:
        """Do nothing, since processes that die are replaced."""


class _Context(SpawnContext):
    """Context of an executor of one process, which it remembers; executors keep theirs private.

    A new interpreter is started, as a copy of this process would inherit locks that other threads
    hold.
    """

    process: SpawnProcess

    def Process(self, *args: Any, **keywords: Any) -> SpawnProcess:  # type: ignore[override]
        # A daemon: the interpreter does not wait for it at its end.
        self.process = SpawnProcess(*args, daemon=True, **keywords)
        return self.process


class _Worker:
    """A process and its executor.

    Attributes:
        executor: Runs one call at a time, in that process.
        process: The process.
    """

    def __init__(self, task: Task) -> None:
        """Start the process, by a first call that imports the study.

        An initializer that imported it would have its errors logged instead of returned.
        """
        context = _Context()
        try:
            self.executor = ProcessPoolExecutor(
                max_workers=1, mp_context=context, initializer=end_with_parent
            )
            self._started = self.executor.submit(_import_study, task)
        except OSError as error:
            raise CraneError(
                f"Cannot start a worker process: {error.strerror or error}."
            ) from error
        self.process = context.process
        # The executor keeps the writing end of the pipe of results open, for processes to come. If
        # a process is killed while it writes, the thread of the executor would wait for the rest of
        # the message for ever, and the interpreter for that thread at its end. Without it, the
        # thread finds the end of the file.
        self.executor._result_queue._writer.close()  # type: ignore[attr-defined]

    def check_started(self) -> None:
        """Wait until the process has imported the study.

        Raises:
            CraneError: If it cannot.
        """
        try:
            self._started.result()
        except BrokenProcessPool:
            raise CraneError(
                "A worker process ended before it began; a script that sweeps must do so under if "
                "__name__ == '__main__'."
            ) from None

    def end(self) -> int | None:
        """End the process and return its exit code, minus the signal that ended it."""
        self.process.kill()
        self.executor.shutdown(cancel_futures=True)
        return self.process.exitcode


def _import_study(task: Task) -> None:
    """Import the study in a worker."""
    task.load()


def _allow_open_files(count: int) -> None:
    """Raise the number of files that this process may open, as far as the system allows.

    The usual 1024 are too few for the workers of a machine with 128 cores. They are that few for
    the sake of select(2), which neither executors nor sweeps use.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= count:
        return
    if hard != resource.RLIM_INFINITY:
        count = min(count, hard)
    with suppress(OSError, ValueError):  # macOS has a limit below the hard one
        resource.setrlimit(resource.RLIMIT_NOFILE, (count, hard))


def end_with_parent() -> None:
    """End this process, a spawned one of `multiprocessing`, as soon as its parent has ended.

    A thread waits for the parent. Native code that keeps Python's lock does not let it run; there
    Linux kills the process, but also when the thread that started it ends, which must outlive it.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    kill_with_parent()
    threading.Thread(target=_exit_after, args=(parent,), daemon=True).start()


def kill_with_parent() -> None:
    """Let Linux kill this process when its parent ends, or the thread of it that started this
    process. Elsewhere nothing happens.
    """
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)


def _exit_after(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)


@contextmanager
def ignore_sigint() -> Iterator[None]:
    """Start processes that ignore Ctrl-C, which a terminal sends to all; their parent ends them."""
    resource_tracker.ensure_running()  # which would unblock the signal when it starts
    # The mask is inherited. Another thread of this process may still get the signal, which waits.
    with defer_sigint():
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
