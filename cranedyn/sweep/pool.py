"""Where chunks are computed: by what rules, and in processes of this machine."""

from __future__ import annotations

import math
import multiprocessing
import time
from collections.abc import Mapping
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from typing import Any, NamedTuple, Protocol

import numpy as np
import pyarrow as pa

from cranedyn.errors import CraneError
from cranedyn.sweep.chunk import DIED, LATE, evaluate, failed, load
from cranedyn.sweep.processes import deaf, end_with_parent

Rows = tuple[int, int]
"""The first case of a chunk, and that after its last."""

_SPAWN = multiprocessing.get_context("spawn")

_LONGEST_WAIT = 3600.0


class Pool(Protocol):
    """Takes chunks of cases and gives back their results.

    Attributes:
        exact: Whether a chunk whose worker died is itself to blame; elsewhere another that was
            computed beside it may be.
        lost: What is said of a case that is to blame.
    """

    exact: bool
    lost: str

    def room(self) -> int:
        """How many chunks it takes at a time, one at least."""

    def submit(self, rows: Rows, columns: Mapping[str, np.ndarray]) -> None:
        """Have a chunk computed."""

    def wait(self) -> list[tuple[Rows, pa.Table | None]]:
        """The chunks that are done, one at least, each with its results, or None where its worker
        died.

        Raises:
            CraneError: If nothing can be computed here any more.
        """

    def close(self) -> None:
        """End what is under way."""


class Cores:
    """Processes of this machine, each with a pipe of its own: of one that dies it is known over
    which chunk, and no other suffers.
    """

    exact, lost = True, DIED

    def __init__(self, study: str, code: str, count: int, limit: float = math.inf) -> None:
        """Start the processes and wait until they have imported the study.

        Args:
            study: Its name, see `cranedyn.sweep.chunk.name_of`.
            code: Checksum of its sources.
            count: Number of processes.
            limit: How long a case may take [s]; a chunk of more has so many times as long.

        Raises:
            CraneError: If they cannot be started, or cannot import the study.
        """
        self._study, self._code, self._limit = study, code, limit
        self._lanes: list[_Lane] = []
        self._free: list[_Lane] = []
        self._busy: dict[Any, _Task] = {}
        try:
            for _ in range(count):
                self._lanes.append(_Lane(study, code))
            for lane in self._lanes:
                lane.check()
        except BaseException:
            self.close()
            raise
        self._free += self._lanes

    def room(self) -> int:
        """As many as there are processes."""
        return len(self._lanes)

    def submit(self, rows: Rows, columns: Mapping[str, np.ndarray]) -> None:
        """Give a chunk to a process that has nothing to do."""
        lane = self._free.pop()
        self._busy[lane.pipe] = _Task(
            lane, rows, time.monotonic() + self._limit * (rows[1] - rows[0])
        )
        with suppress(OSError):  # it has died: that is found by waiting
            lane.pipe.send(columns)

    def wait(self) -> list[tuple[Rows, pa.Table | None]]:
        """The chunks that are done; a process that died, or had to be ended at its time limit, has
        a successor.
        """
        done: list[tuple[Rows, pa.Table | None]] = []
        while not done:
            left = min(task.deadline for task in self._busy.values()) - time.monotonic()
            for pipe in wait(list(self._busy), timeout=min(max(left, 0.0), _LONGEST_WAIT)):
                lane, rows, _ = self._busy.pop(pipe)
                try:
                    done.append((rows, lane.received()))
                except (EOFError, OSError):
                    done.append((rows, None))
                    lane = self._replaced(lane)
                self._free.append(lane)
            for lane, rows, _ in [
                task
                for task in self._busy.values()
                if task.deadline <= time.monotonic() and not task.lane.pipe.poll()
            ]:
                del self._busy[lane.pipe]
                done.append(
                    (rows, failed(1, LATE.format(self._limit)) if rows[1] - rows[0] == 1 else None)
                )
                self._free.append(self._replaced(lane))
        return done

    def close(self) -> None:
        """Kill the processes, whatever they do."""
        for lane in self._lanes:
            lane.end()

    def _replaced(self, lane: _Lane) -> _Lane:
        lane.end()
        self._lanes.remove(lane)
        self._lanes.append(_Lane(self._study, self._code))
        self._lanes[-1].check()
        return self._lanes[-1]


class _Task(NamedTuple):
    """A chunk under way: in which process, and until when it must be done [s], on the monotonic
    clock.
    """

    lane: _Lane
    rows: Rows
    deadline: float


class _Lane:
    """A process and the pipe to it."""

    def __init__(self, study: str, code: str) -> None:
        try:
            self.pipe, theirs = _SPAWN.Pipe()
            with theirs:
                self.process = _SPAWN.Process(
                    target=_serve, args=(theirs, study, code), daemon=True
                )
                with deaf():
                    self.process.start()
        except OSError as error:
            raise CraneError(
                f"Cannot start a worker process: {error.strerror or error}."
            ) from error

    def check(self) -> None:
        try:
            self.received()
        except (EOFError, OSError):
            raise CraneError(
                "A worker process ended before it began; a script that sweeps must do so under if "
                "__name__ == '__main__'."
            ) from None

    def received(self) -> pa.Table | None:
        found = self.pipe.recv()
        if isinstance(found, CraneError):
            raise found
        return found

    def end(self) -> None:
        self.process.kill()
        self.process.join()
        self.pipe.close()


def _serve(pipe: Connection, study: str, code: str) -> None:
    """Compute chunks until there is nobody to compute for."""
    end_with_parent()
    with suppress(EOFError, OSError):
        try:
            load(study, code)
            pipe.send(None)
            while True:
                pipe.send(evaluate(study, pipe.recv()))
        except CraneError as error:
            pipe.send(error)
