"""Chunks under way on workers, whoever they are; the sweep sees nothing else of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait

import numpy as np
import pyarrow as pa

from cranedyn.sweep.study import CaseRange, Task

CHECK_INTERVAL = 1.0
"""Time after which workers that return nothing are checked [s]."""


class Pool(ABC):
    """Workers behind executors of `concurrent.futures`, and the chunks that they compute.

    Attributes:
        isolates_deaths: Whether a chunk fails only if its own worker died. Otherwise a chunk beside
            it may be to blame.
        death_message: Error of a case whose worker died.
    """

    isolates_deaths: bool
    death_message: str

    def __init__(self, task: Task) -> None:
        """Set what workers run."""
        self._task = task
        self._under_way: dict[Future[pa.Table], CaseRange] = {}

    @property
    def under_way(self) -> int:
        """Number of chunks that were submitted and not yet returned by `wait`."""
        return len(self._under_way)

    @abstractmethod
    def capacity(self) -> int:
        """Return how many chunks may be under way, one at least."""

    def submit(self, rows: CaseRange, columns: Mapping[str, np.ndarray]) -> None:
        """Begin to compute a chunk.

        Args:
            rows: The cases.
            columns: Their parameters, shape (n,) each.
        """
        self._under_way[self._start(columns)] = rows

    def wait(self) -> list[tuple[CaseRange, pa.Table | None]]:
        """Wait for the results of one chunk or more.

        Returns:
            Each chunk that is done, with its results, or with None if its worker died.

        Raises:
            CraneError: If the study cannot be run at all, or no worker is left to run it.
        """
        done: set[Future[pa.Table]] = set()
        while not done:
            done = wait(self._under_way, CHECK_INTERVAL, FIRST_COMPLETED).done
            if not done:
                self._check_workers()
        results = []
        for future in done:
            rows = self._under_way.pop(future)
            results.append((rows, self._result(future, rows)))
        return results

    @abstractmethod
    def close(self) -> None:
        """Drop what is under way, at once. Processes that the pool has started are ended."""

    @abstractmethod
    def _start(self, columns: Mapping[str, np.ndarray]) -> Future[pa.Table]:
        """Submit `Task.evaluate` to an executor."""

    @abstractmethod
    def _result(self, future: Future[pa.Table], rows: CaseRange) -> pa.Table | None:
        """Return the results of a chunk that is done; None if its worker died."""

    @abstractmethod
    def _check_workers(self) -> None:
        """Raise CraneError if there has been no worker for too long."""
