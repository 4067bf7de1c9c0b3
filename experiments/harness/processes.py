"""Worker processes of an experiment."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, get_context

from cranedyn.checks import number
from cranedyn.errors import CraneError
from cranedyn.sweep.workers import end_with_parent


@contextmanager
def processes(jobs: int | None) -> Iterator[ProcessPoolExecutor]:
    """Yield processes that end with the context and with this process, even if that is killed.

    Raises:
        OutOfRange: If the number of jobs is not from 1 to 1024.
        CraneError: If a process is ended from outside.
    """
    if jobs is not None:
        number("jobs", jobs, "", "1 to 1024")
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=end_with_parent)
    try:
        yield pool
    except BaseException as error:
        for child in active_children():
            child.terminate()
        if isinstance(error, BrokenProcessPool):
            raise CraneError(
                "A process of the experiment was ended from outside; what it had done is lost."
            ) from None
        raise
    finally:
        pool.shutdown(cancel_futures=True)
