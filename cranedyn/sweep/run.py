"""Run a study on every case of a design, once, whatever happens meanwhile."""

from __future__ import annotations

import math
import os
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pyarrow as pa

from cranedyn.checks import within
from cranedyn.command import interrupted
from cranedyn.errors import CraneError, shown
from cranedyn.sweep.chunk import Study, failed, joined, name_of
from cranedyn.sweep.cluster import Cluster
from cranedyn.sweep.design import Design
from cranedyn.sweep.limits import check_disk, whole
from cranedyn.sweep.manifest import Manifest, as_folder, claimed
from cranedyn.sweep.pool import Cores, Pool, Rows
from cranedyn.sweep.sources import digest, sources
from cranedyn.sweep.store import finished, unify, write_part
from cranedyn.version import __version__

if TYPE_CHECKING:
    from distributed.security import Security

_PARTS, _LARGEST, _TRIES, _MOST_WORKERS, _LIMITS = 64, 1000, 2, 1024, (1e-3, 1e6)


class Progress(NamedTuple):
    """How far a sweep is.

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
        """Estimate of the time left [s] when this process has swept for so long [s], at the pace so
        far; None before there is one.
        """
        ran = self.done - self.before
        return elapsed * (self.cases - self.done) / ran if ran else None


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
    progress: Callable[[Progress], None] | None = None,
) -> Progress:
    """Run a study on every case of a design and keep the results in a folder; where it was
    interrupted before, it goes on.

    Every chunk that is done is a Parquet file, written whole or not at all; only chunks under way
    are lost when the process ends, however it ends. A case that goes wrong has its reason in the
    column `error` and no results: the study raised on it, returned a number that is not finite,
    took longer than it may, or twice killed the process that ran it. Chunks in which that happens
    are halved and tried again. Every part carries a checksum; one that is not as it was written
    counts as not done.

    Whoever listens at the address of a scheduler, and every worker behind it, can run code in this
    program: what Dask's processes say to each other is pickled. Give one that you trust.

    Args:
        study: The function; workers import it by its name.
        design: The cases.
        folder: Where results are kept; it is made, and belongs to this sweep alone.
        chunk: Cases that the study gets at a time, and a file holds; by default such that there are
            64 files, of 1000 cases at most, or what the sweep was begun with.
        workers: Processes on this machine, by default one for each core.
        scheduler: Address of a Dask scheduler whose workers are used instead.
        security: Certificates for a scheduler whose address begins with ``tls://``, see
            `cranedyn.sweep.cluster.tls`; by default those of Dask's configuration.
        limit: How long a case may take [s], 0.001 to 1e6; by default any time. A chunk of n cases
            may take n times as long, then the process that runs it is ended. On a cluster that ends
            all that this worker does, four times for a chunk.
        progress: Called at the beginning and whenever a part is done.

    Returns:
        How it ended.

    Raises:
        CraneError: If an argument is none of these; the study has no name to import it by; the
            folder holds another sweep, one by other code, or anything else, or another process is
            at it; the results would not fit the disk; workers cannot be started, cannot import the
            study or have another; there is no scheduler or no worker.
        KeyboardInterrupt: After Ctrl-C, with a sentence that says what is done.
    """
    if not isinstance(design, Design):
        raise CraneError(
            f"design is {shown(design)}; allowed is a Design, of which grid, sampled and cross "
            "make some."
        )
    pool_of = _pool(workers, scheduler, security, limit)
    size = (
        max(1, min(_LARGEST, -(-len(design) // _PARTS)))
        if chunk is None
        else whole("chunk", chunk, 1)
    )
    name, folder = name_of(study), as_folder(folder)
    files = sources(name)
    asked = Manifest(
        name, __version__, files, design.fingerprint, tuple(design.columns), len(design), size
    )
    with claimed(folder, asked, chunk is not None) as manifest:
        books = _Books(folder, manifest, design, progress)
        try:
            if books.missing:
                check_disk(
                    folder, manifest.cases - books.progress.done, 8.0 * (1 + len(design.columns))
                )
                pool = pool_of(name, digest(files), len(books.missing))
                with closing(pool):
                    for rows, found in _computed(pool, design, map(manifest.rows, books.missing)):
                        books.take(rows, found)
            unify(folder, manifest)
        except BaseException as error:
            if not interrupted(error):  # what ends the work after Ctrl-C may fail in its own words
                raise
            done = f"{books.kept()} of {manifest.cases} cases are done"
            raise KeyboardInterrupt(
                f"Interrupted: {done}, and kept in {folder}; the same sweep goes on from there."
            ) from None
    return books.progress


def _pool(
    workers: int | None, scheduler: str | None, security: Security | None, limit: float | None
) -> Callable[[str, str, int], Pool]:
    """How to start what computes, from name and checksum of the study and the number of chunks; the
    arguments are checked here.
    """
    longest = math.inf if limit is None else within("limit", limit, *_LIMITS, "s")
    if scheduler is None:
        if security is not None:
            raise CraneError(
                "Certificates have no effect without a scheduler; give its address, too."
            )
        count = (
            _cores() if workers is None else whole("number of workers", workers, 1, _MOST_WORKERS)
        )
        return lambda study, code, chunks: Cores(study, code, min(count, chunks), longest)
    if workers is not None:
        raise CraneError(
            "The number of workers has no effect beside a scheduler, which has its own; give one "
            "of them."
        )
    return lambda study, code, _: Cluster(study, code, scheduler, security, longest)


def _computed(
    pool: Pool, design: Design, chunks: Iterable[Rows]
) -> Iterator[tuple[Rows, pa.Table]]:
    """Chunks and their results as they come.

    Those whose worker died are halved and tried again when all others are done; one at a time,
    where another could be blamed.
    """
    fresh, suspects, lone = deque(chunks), deque[Rows](), Counter[Rows]()
    ready: list[tuple[Rows, pa.Table]] = []
    under_way = 0
    while fresh or suspects or under_way or ready:
        room = pool.room()
        while (queue := fresh or suspects) and under_way < (room if fresh or pool.exact else 1):
            rows = queue.popleft()
            pool.submit(rows, design.rows(*rows))
            under_way += 1
        yield from ready
        done = pool.wait() if under_way else []
        under_way -= len(done)
        ready = [(rows, found) for rows, found in done if found is not None]
        for first, last in (rows for rows, found in done if found is None):
            middle = (first + last) // 2
            lone[first, last] += last - first == 1
            if lone[first, last] == _TRIES:
                ready.append(((first, last), failed(1, pool.lost)))
            else:
                suspects += [(first, middle), (middle, last)] if middle > first else [(first, last)]


class _Books:
    """What is done, and the pieces of parts that are not."""

    def __init__(
        self,
        folder: Path,
        manifest: Manifest,
        design: Design,
        tell: Callable[[Progress], None] | None,
    ) -> None:
        self._folder, self._manifest, self._design, self._tell = folder, manifest, design, tell
        there = {
            part: found
            for part in manifest.parts_in(folder)
            if (found := finished(folder, manifest, part))
        }
        self.missing = [part for part in range(manifest.parts) if part not in there]
        self._kept = set(there)
        self._writing: int | None = None
        done = sum(last - first for first, last in map(manifest.rows, there))
        self._bytes = sum(size for _, size in there.values())
        self._pieces: dict[int, dict[int, pa.Table]] = {}
        self._say(Progress(done, manifest.cases, sum(errors for errors, _ in there.values()), done))

    def take(self, rows: Rows, found: pa.Table) -> None:
        """Keep the results of a chunk; write its part when that is whole.

        Raises:
            DataError: If it cannot be written, or all that is to come would not fit the disk.
        """
        part = rows[0] // self._manifest.chunk
        pieces = self._pieces.setdefault(part, {})
        pieces[rows[0]] = found
        first, last = self._manifest.rows(part)
        if sum(map(len, pieces.values())) < last - first:
            return
        table = joined([piece for _, piece in sorted(self._pieces.pop(part).items())])
        self._writing = part
        self._bytes += write_part(
            self._folder, self._manifest, part, self._design.rows(first, last), table
        )
        self._kept.add(part)
        done, errors = (
            self.progress.done + len(table),
            self.progress.errors + len(table) - table["error"].null_count,
        )
        self._say(self.progress._replace(done=done, errors=errors))
        check_disk(self._folder, self._manifest.cases - done, self._bytes / done)

    def kept(self) -> int:
        """Cases whose parts are there, even if it was interrupted while one was written."""
        writing = self._writing
        if writing is not None and finished(self._folder, self._manifest, writing):
            self._kept.add(writing)
        return sum(last - first for first, last in map(self._manifest.rows, self._kept))

    def _say(self, progress: Progress) -> None:
        self.progress = progress
        if self._tell is not None:
            self._tell(progress)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
