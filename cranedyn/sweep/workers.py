"""Worker processes of this machine; they end with the process that started them."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess

import numpy as np
import pyarrow as pa

from cranedyn.command import defer_sigint
from cranedyn.errors import CraneError
from cranedyn.sweep.study import DIED, LATE, Rows, Task, failure

_SPAWN = multiprocessing.get_context("spawn")
_PR_SET_PDEATHSIG = 1
"""Option of prctl(2): the signal that a process gets when its parent ends."""


class LocalPool:
    """Processes that compute chunks, each with a pipe of its own: if one dies, no other suffers.

    Attributes:
        exact: Whether a chunk whose worker died is itself to blame, and not one beside it.
        died: Error of a case whose worker died.

    Raises:
        CraneError: If a process cannot be started, or cannot import the study.
    """

    exact = True
    died = DIED

    def __init__(self, task: Task, count: int) -> None:
        """Start so many processes at once, and wait for them."""
        self._task = task
        self._workers: list[_Worker] = []
        self._busy: dict[object, tuple[_Worker, Rows]] = {}
        try:
            for _ in range(count):
                self._workers.append(_Worker(task))
            for worker in self._workers:
                worker.check_started()
        except BaseException:
            self.close()
            raise
        self._idle = [*self._workers]

    def capacity(self) -> int:
        """Return how many chunks may be under way, one at least."""
        return len(self._workers)

    def submit(self, rows: Rows, columns: Mapping[str, np.ndarray]) -> None:
        """Begin to compute a chunk."""
        worker = self._idle.pop()
        self._busy[worker.pipe] = worker, rows
        with suppress(OSError):  # it has died, which `wait` notices
            worker.pipe.send(columns)

    def wait(self) -> list[tuple[Rows, pa.Table | None]]:
        """Wait for chunks, one at least; return each with its results, None if its worker died.

        Raises:
            CraneError: If nothing can be computed any more.
        """
        done = []
        for pipe in wait(list(self._busy)):  # type: ignore[arg-type]
            worker, rows = self._busy.pop(pipe)
            try:
                table = worker.receive()
            except (EOFError, OSError):
                # The timer of `Task.evaluate` ended it. Of several cases it is open which was late.
                first, last = rows
                is_late = worker.kill() == -signal.SIGALRM and last - first == 1
                table = failure(LATE.format(self._task.limit)) if is_late else None
                self._workers.remove(worker)
                worker = _Worker(self._task)
                self._workers.append(worker)
                worker.check_started()
            self._idle.append(worker)
            done.append((rows, table))
        return done

    def close(self) -> None:
        """End the processes, whatever they do."""
        for worker in self._workers:
            worker.kill()


class _Worker:
    """A process and the pipe to it."""

    def __init__(self, task: Task) -> None:
        try:
            self.pipe, theirs = _SPAWN.Pipe()
            with theirs, ignore_sigint():
                self.process = _SPAWN.Process(target=_serve, args=(theirs, task), daemon=True)
                self.process.start()
        except OSError as error:
            raise CraneError(
                f"Cannot start a worker process: {error.strerror or error}."
            ) from error

    def check_started(self) -> None:
        """Wait until the process has imported the study."""
        try:
            self.receive()
        except (EOFError, OSError):
            raise CraneError(
                "A worker process ended before it began; a script that sweeps must do so under if "
                "__name__ == '__main__'."
            ) from None

    def receive(self) -> pa.Table | None:
        """Return what the process sends; raise a `CraneError` that it sends."""
        message = self.pipe.recv()
        if isinstance(message, CraneError):
            raise message
        return message

    def kill(self) -> int | None:
        """End the process and return its exit code, minus the signal that ended it."""
        self.process.kill()
        self.process.join()
        self.pipe.close()
        return self.process.exitcode


def _serve(pipe: Connection, task: Task) -> None:
    """Compute chunks until none is requested any more."""
    end_with_parent()
    with suppress(EOFError, OSError):
        try:
            task.load()
            pipe.send(None)
            while True:
                pipe.send(task.evaluate(pipe.recv()))
        except CraneError as error:
            pipe.send(error)


def end_with_parent() -> None:
    """End this process, a spawned one of `multiprocessing`, as soon as its parent has ended.

    A thread waits for the parent. Native code that keeps Python's lock does not let it run; there
    Linux kills the process, but also when the thread that started it ends, which must outlive it.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
    threading.Thread(target=_exit_after, args=(parent,), daemon=True).start()


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
