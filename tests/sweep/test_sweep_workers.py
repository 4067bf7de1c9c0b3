"""Worker processes of this machine: each stands alone, and costs no more files than it says."""

from __future__ import annotations

import os
import resource
from collections.abc import Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from multiprocessing import active_children
from pathlib import Path

import numpy as np
import pytest

from cranedyn.sweep.study import CaseRange, Task
from cranedyn.sweep.workers import FILES_PER_WORKER, SPARE_FILES, LocalPool, _allow_open_files
from tests.helpers import python
from tests.sweep.test_sweep_interrupted import proc

pytestmark = [pytest.mark.usefixtures("limited"), pytest.mark.slow]

_CUT_OFF_SWEEP = """
import os
import sys
from cranedyn.sweep import grid, results, sweep
from tests import studies

if __name__ == "__main__":
    os.environ["SWEEP_LOG"] = sys.argv[2]
    sweep(studies.cut_off, grid(x=range(20_000)), sys.argv[1], chunk=20_000, workers=1)
    print(results(sys.argv[1])["error"].null_count)
"""


@contextmanager
def _pool(study: str, workers: int) -> Iterator[LocalPool]:
    with closing(LocalPool(Task(f"tests.studies:{study}"), workers)) as pool:
        yield pool


def _submit(pool: LocalPool, x: float) -> None:
    """Begin to compute a chunk of one case."""
    pool.submit(CaseRange(0, 1), {"x": np.array([x])})


def test_a_worker_that_ends_while_it_is_idle_costs_no_chunk_a_try() -> None:
    with _pool("squares", 1) as pool:
        (worker,) = pool._idle
        worker.process.kill()
        with pytest.raises(BrokenProcessPool):
            while True:  # until the executor has noticed
                worker.executor.submit(int).result()
        _submit(pool, 3.0)
        ((rows, table),) = pool.wait()
    assert rows == CaseRange(0, 1)
    assert table is not None
    assert table["y"].to_pylist() == [9.0]


def test_a_worker_that_dies_fails_its_own_chunk_only() -> None:
    with _pool("deadly", 2) as pool:
        _submit(pool, 3.0)  # kills its process
        _submit(pool, 2.0)
        tables = []
        while pool.under_way:
            tables += [table for _, table in pool.wait()]
    assert sorted(table is None for table in tables) == [False, True]


def test_a_study_that_raises_what_ends_a_program_does_not_end_the_sweep() -> None:
    with _pool("interrupting", 1) as pool:
        for _ in range(2):  # the worker goes on
            _submit(pool, 1.0)
            assert pool.wait() == [(CaseRange(0, 1), None)]


def test_no_process_is_left_when_a_pool_is_closed() -> None:
    before = active_children()
    with _pool("stuck", 2) as pool:
        _submit(pool, 3.0)  # never ends
        assert len(active_children()) == len(before) + 2
    assert active_children() == before


@proc
def test_a_worker_that_is_killed_while_it_sends_results_is_replaced(tmp_path: Path) -> None:
    """The executor alone would wait for the rest of the message for ever."""
    log = tmp_path / "log"
    run = python(_CUT_OFF_SWEEP, tmp_path / "sweep", log, timeout=120.0)
    assert run.stdout == "20000\n"
    assert len(log.read_text().splitlines()) == 3  # whole, and in halves


@proc
def test_a_worker_opens_no_more_files_than_the_limit_is_raised_for() -> None:
    before = len(os.listdir("/proc/self/fd"))
    with _pool("squares", 2) as pool:
        _submit(pool, 1.0)
        pool.wait()
        opened = len(os.listdir("/proc/self/fd")) - before
    assert opened <= 2 * FILES_PER_WORKER < SPARE_FILES


def test_the_limit_of_open_files_is_raised_if_it_is_too_low_and_never_lowered() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (200, hard))
        _allow_open_files(100)
        assert resource.getrlimit(resource.RLIMIT_NOFILE) == (200, hard)
        _allow_open_files(300)
        assert resource.getrlimit(resource.RLIMIT_NOFILE) == (300, hard)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
