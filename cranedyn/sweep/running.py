"""Run a study on every case of a design, once, whatever happens meanwhile."""

from __future__ import annotations

import math
import shutil
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pyarrow as pa

from cranedyn.checks import whole, within, worker_count
from cranedyn.command import interrupted
from cranedyn.errors import CraneError, DataError, shown
from cranedyn.sweep.cluster import DaskPool
from cranedyn.sweep.design import Design
from cranedyn.sweep.folder import DamagedChunk, Manifest, SweepFolder, claim
from cranedyn.sweep.pool import Pool
from cranedyn.sweep.study import (
    CaseRange,
    Study,
    Task,
    code_digest,
    concatenate,
    failure,
    source_digests,
    study_name,
)
from cranedyn.sweep.workers import LocalPool
from cranedyn.version import __version__

if TYPE_CHECKING:
    from distributed.security import Security

_DEFAULT_CHUNKS = 64
"""Number of chunk files of a sweep, unless they would hold more than `_MAX_DEFAULT_CHUNK` cases."""

_MAX_DEFAULT_CHUNK = 1000
"""Largest number of cases in a chunk, unless another one is asked for."""

_MAX_TRIES = 2
"""How often a case that stands alone is computed before its worker's death is its result."""

_MIN_LIMIT = 1e-3
"""Least time limit of a case [s]."""

_MAX_LIMIT = 1e6
"""Largest time limit of a case [s]."""


class Progress(NamedTuple):
    """Progress of a sweep.

    Attributes:
        done: Cases that are done, the bad ones included.
        cases: All cases.
        errors: Bad cases among those done.
        before: Cases that had been done when this process began.
    """

    done: int
    cases: int
    errors: int
    before: int

    def left(self, elapsed: float) -> float | None:
        """Return the estimated time left [s], None before there is a pace.

        Args:
            elapsed: Time that this process has swept for [s].
        """
        computed = self.done - self.before
        if not computed:
            return None
        return elapsed * (self.cases - self.done) / computed


Report = Callable[[Progress], None]
"""Called with the progress at the beginning of a sweep and after every chunk."""


def sweep(
    study: Study,
    design: Design,
    folder: str | Path,
    *,
    chunk: int | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    security: Security | None = None,
    limit: float | None = None,
    progress: Report | None = None,
) -> Progress:
    """Run a study on every case of a design and keep the results in a folder, or resume that.

    Every chunk that is done is a Parquet file, written whole or not at all. When the process ends,
    however it ends, only chunks under way are lost. A case that goes wrong has its reason in the
    column `error` and no results: the study raised on it, returned a number that is not finite,
    took longer than it may, or twice killed its process. Chunks in which that happens are halved
    and tried again. A chunk file that fails its checksum counts as not done.

    The scheduler at an address, and every worker behind it, can run code in this program, since
    Dask's processes exchange pickles. Name one that you trust.

    Args:
        study: The function; workers import it by its name.
        design: The cases.
        folder: Folder of the results; it is made, and belongs to this sweep alone.
        chunk: Cases that the study gets at a time, and a file holds; by default such that there are
            64 files, of 1000 cases at most, or what the sweep was begun with.
        workers: Processes on this machine, by default one per core.
        scheduler: Address of a Dask scheduler whose workers compute instead.
        security: Certificates for a scheduler whose address begins with ``tls://``, see
            `cranedyn.sweep.cluster.tls`; by default those of Dask's configuration.
        limit: Time that a case may take [s], 0.001 to 1e6; by default any. A chunk of n cases may
            take n times as long, then its process is ended. On a cluster that ends all that this
            worker does, four times for a chunk.
        progress: Called at the beginning and after every chunk.

    Returns:
        Progress at the end.

    Raises:
        CraneError: If an argument is out of range; the study has no name to import it by; the
            folder holds another sweep, one by other code, or anything else, or another process
            sweeps there; the results would not fit the disk; workers cannot be started, cannot
            import the study or have another; there is no scheduler or no worker.
        KeyboardInterrupt: After Ctrl-C; its message says how many cases are done.
    """
    if not isinstance(design, Design):
        raise CraneError(f"design is {shown(design)}; allowed is a Design, see grid and sample.")
    if scheduler is not None and workers is not None:
        raise CraneError("The number of workers has no effect beside a scheduler; give one only.")
    if scheduler is None and security is not None:
        raise CraneError("Certificates have no effect without a scheduler; give its address, too.")
    processes = worker_count("number of workers", workers)
    time_limit = math.inf
    if limit is not None:
        time_limit = within("limit", limit, _MIN_LIMIT, _MAX_LIMIT, "s")
    if chunk is None:
        # Rounded up, so that there are no more chunks than that.
        chunk_size = min(_MAX_DEFAULT_CHUNK, -(-len(design) // _DEFAULT_CHUNKS))
    else:
        chunk_size = whole("chunk", chunk, 1)
    name = study_name(study)
    sources = source_digests(name)
    manifest = Manifest(
        study=name,
        version=__version__,
        sources=sources,
        design=design.fingerprint,
        parameters=tuple(design.columns),
        cases=len(design),
        chunk=chunk_size,
    )
    with claim(Path(folder), manifest, fixed_chunk=chunk is not None) as files:
        ledger = _Ledger(files, design, progress)
        try:
            if ledger.missing:
                # At least the number of the case and its parameters, eight bytes each, are written.
                ledger.check_disk(8.0 * (1 + len(design.columns)))
                task = Task(name, code_digest(sources), time_limit)
                processes = min(processes, len(ledger.missing))
                with closing(_start_pool(task, processes, scheduler, security)) as pool:
                    for rows, table in _compute(pool, design, ledger.missing):
                        ledger.add(rows, table)
            files.unify()
        except BaseException as error:
            # Some libraries turn an interruption into an error of their own.
            if not interrupted(error):
                raise
            done = ledger.count_written()
            raise KeyboardInterrupt(
                f"Interrupted: {done} of {len(design)} cases are done, and kept in {folder}; the "
                "same sweep goes on from there."
            ) from None
    return ledger.progress


def _compute(
    pool: Pool, design: Design, chunks: list[CaseRange]
) -> Iterator[tuple[CaseRange, pa.Table]]:
    """Yield chunks and their results as they come.

    A chunk whose worker died is halved and tried again when all others are done; alone, where
    another chunk could be to blame. A case that stands alone is tried twice, since a process may
    also be killed from outside, as for lack of memory.
    """
    fresh = deque(chunks)
    suspects = deque[CaseRange]()
    deaths = Counter[CaseRange]()
    ready: list[tuple[CaseRange, pa.Table]] = []
    while fresh or suspects or pool.under_way or ready:
        capacity = pool.capacity()
        while fresh and pool.under_way < capacity:
            rows = fresh.popleft()
            pool.submit(rows, design.rows(*rows))
        if not pool.isolates_deaths:
            capacity = 1
        while suspects and not fresh and pool.under_way < capacity:
            rows = suspects.popleft()
            pool.submit(rows, design.rows(*rows))
        yield from ready  # to be written while others are computed
        ready = []
        if not pool.under_way:
            continue
        for rows, table in pool.wait():
            if table is not None:
                ready.append((rows, table))
                continue
            deaths[rows] += 1
            if rows.size > 1:
                suspects += rows.halves()
            elif deaths[rows] < _MAX_TRIES:
                suspects.append(rows)
            else:
                ready.append((rows, failure(pool.death_message)))


def _start_pool(
    task: Task, processes: int, scheduler: str | None, security: Security | None
) -> Pool:
    """Return workers of a cluster if there is the address of a scheduler, else of this machine."""
    if scheduler is None:
        return LocalPool(task, processes)
    return DaskPool(task, scheduler, security)


class _Ledger:
    """Account of what is done: the progress, and pieces of chunks that are not whole yet.

    Attributes:
        missing: Chunks to compute.
        damaged: Numbers of the chunks whose file is damaged, until they are computed again.
        progress: Progress so far.
    """

    def __init__(self, files: SweepFolder, design: Design, report: Report | None) -> None:
        """Read which chunks are done and which of their cases are bad; report that."""
        self._files = files
        self._design = design
        self._report = report
        # Tables of halved chunks by their first case, by the number of the chunk.
        self._pieces = defaultdict[int, dict[int, pa.Table]](dict)
        self.missing: list[CaseRange] = []
        self.damaged: set[int] = set()
        done = 0
        bad = 0
        indices = set(files.indices())
        for i in range(files.manifest.chunks):
            error = None
            if i in indices:
                error = _read_errors(files, i)
                if error is None:
                    self.damaged.add(i)
            if error is None:
                self.missing.append(files.manifest.rows(i))
            else:
                done += len(error)
                bad += len(error) - error.null_count
        self.progress = Progress(done=done, cases=len(design), errors=bad, before=done)
        self._report_progress()

    def add(self, rows: CaseRange, table: pa.Table) -> None:
        """Keep results; write the chunk file when its last ones have come.

        Raises:
            DataError: If it cannot be written, or all that is to come would not fit the disk.
        """
        i = rows.first // self._files.manifest.chunk
        chunk = self._files.manifest.rows(i)
        pieces = self._pieces[i]
        pieces[rows.first] = table
        if sum(len(piece) for piece in pieces.values()) < chunk.size:
            return
        del self._pieces[i]
        table = concatenate([pieces[first] for first in sorted(pieces)])
        columns = {"case": np.arange(*chunk), **self._design.rows(*chunk)}
        for name in table.column_names:
            columns[name] = table[name]
        size = self._files.write(i, pa.table(columns))
        self.damaged.discard(i)
        self.progress = self.progress._replace(
            done=self.progress.done + len(table),
            errors=self.progress.errors + len(table) - table["error"].null_count,
        )
        self._report_progress()
        self.check_disk(size / len(table))

    def count_written(self) -> int:
        """Return the number of cases in whole chunk files.

        Unlike `progress` it counts a file also if an interruption has come between the file and its
        entry here.
        """
        count = 0
        for i in self._files.indices():
            if i not in self.damaged:
                count += self._files.manifest.rows(i).size
        return count

    def check_disk(self, case_size: float) -> None:
        """Check that the results to come fit the disk.

        Args:
            case_size: Size of the results of a case [byte].

        Raises:
            DataError: If they do not.
        """
        count = self.progress.cases - self.progress.done
        size = count * case_size
        free = shutil.disk_usage(self._files.path).free
        if size > free:
            raise DataError(
                f"The results of {count} cases would take {size / 1e9:.3g} GB; {free / 1e9:.3g} GB "
                f"are free in {self._files.path}."
            )

    def _report_progress(self) -> None:
        if self._report is not None:
            self._report(self.progress)


def _read_errors(files: SweepFolder, index: int) -> pa.ChunkedArray | None:
    """Return the errors of the cases of a chunk file; None if it is damaged."""
    try:
        return files.read(index, ["error"])["error"]
    except DamagedChunk:
        return None
