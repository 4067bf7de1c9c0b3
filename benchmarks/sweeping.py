"""What a sweep adds to its cases: by processes of this machine and by Dask's workers, how it grows
with them, and what follows for a billion cases.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.conduct import print_tables
from benchmarks.sweep_studies import PAUSE, SWING, nothing, swinging, waiting
from cranedyn.errors import CraneError
from cranedyn.sweep import Design, Progress, Study, results, sweep
from experiments.harness.outcome import ResultTable

WORKERS = (2, 4, 8)
"""Numbers of Dask's workers."""

CRANES = 256
"""Number of cases in a chunk that computes."""

COST_COLUMNS = (
    ("by", ""),
    ("first part after [s]", ".2f"),
    ("a part [ms]", ".2f"),
    ("a case [µs]", ".2f"),
)
"""Columns of the table of what a sweep adds."""

GROWTH_COLUMNS = (
    ("by", ""),
    ("waiting [%]", ".0f"),
    ("swings/s", ",.0f"),
    ("ratio", ".2f"),
    ("a swing [ms]", ".3f"),
)
"""Columns of the table of growth with the number of workers."""


class Way(NamedTuple):
    """What computes the cases of a sweep.

    Attributes:
        name: Name in tables.
        workers: Number of processes.
        scheduler: Address of Dask's scheduler; None for processes of the sweep's own.
    """

    name: str
    workers: int
    scheduler: str | None


def _counted(count: int, word: str, plural: str) -> str:
    """Return a number with its noun."""
    return f"{count} {word if count == 1 else plural}"


@contextmanager
def way(kind: str, workers: int) -> Iterator[Way]:
    """Yield processes, or workers of Dask that live as long as the context."""
    if kind == "processes":
        yield Way(_counted(workers, "process", "processes"), workers, None)
        return
    try:
        from distributed import LocalCluster
    except ModuleNotFoundError:
        raise CraneError("Dask is not installed: pip install 'cranedyn[dask]'") from None
    with LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        worker_dashboard_address="127.0.0.1:0",
        silence_logs=50,
    ) as cluster:
        yield Way(
            f"Dask, {_counted(workers, 'worker', 'workers')}", workers, cluster.scheduler_address
        )


class Pace(NamedTuple):
    """Times of a sweep.

    Attributes:
        first: Time to its first part [s].
        each: Time between parts from then on [s].
        busy: Processor time of the program that sweeps, for each part [s].
        spent: Median processor time of a case [s], where the study tells it; 0 otherwise.
    """

    first: float
    each: float
    busy: float
    spent: float


def pace(study: Study, by: Way, chunks: int, chunk: int) -> Pace:
    """Measure a sweep of equal chunks while all workers are busy."""
    design = Design({"x": np.linspace(0.0, 1.0, chunks * chunk)})
    stamps = [(time.perf_counter(), time.process_time())]

    def stamp(progress: Progress) -> None:
        if progress.errors:
            raise CraneError(f"{progress.errors} of {progress.done} cases went wrong.")
        if progress.done:
            stamps.append((time.perf_counter(), time.process_time()))

    with tempfile.TemporaryDirectory() as folder:
        sweep(
            study,
            design,
            Path(folder) / "sweep",
            chunk=chunk,
            workers=None if by.scheduler else by.workers,
            scheduler=by.scheduler,
            progress=stamp,
        )
        table = results(Path(folder) / "sweep")
    spent = table["spent_s"].to_numpy() if "spent_s" in table.column_names else np.zeros(1)
    begin = 2 * by.workers
    end = chunks + 1 - by.workers
    wall, busy = (np.array(stamps[end]) - np.array(stamps[begin])) / (end - begin)
    return Pace(stamps[1][0] - stamps[0][0], float(wall), float(busy), float(np.median(spent)))


class Overhead(NamedTuple):
    """What a sweep costs besides its cases.

    Attributes:
        once: Time until its first part is there [s].
        part: Processor time of the program that sweeps for each part [s].
        case: Processor time of the program that sweeps for each case [s].
    """

    once: float
    part: float
    case: float


def overhead(by: Way, chunks: int, chunk: int) -> Overhead:
    """Return the overhead from sweeps that compute nothing, of single cases and of large chunks."""
    small = pace(nothing, by, chunks, 1)
    large = pace(nothing, by, chunks, chunk)
    return Overhead(small.first, small.busy, (large.busy - small.busy) / (chunk - 1))


class Scaling(NamedTuple):
    """How fast a number of workers is.

    Attributes:
        efficiency: Rate of chunks that only wait, over that of ideal workers.
        rate: Swings a second.
        spent: Processor time of a swing [s].
    """

    efficiency: float
    rate: float
    spent: float


def scaling(by: Way, chunks: int) -> Scaling:
    """Measure how fast the workers are."""
    waited = pace(waiting, by, chunks, 1)
    swung = pace(swinging, by, chunks, CRANES)
    return Scaling(
        efficiency=PAUSE / by.workers / waited.each,
        rate=CRANES / swung.each,
        spent=swung.spent,
    )


def bytes_a_case(chunks: int = 2, chunk: int = 1000) -> float:
    """Return the bytes of a case on disk, with a parameter and an incompressible result."""
    design = Design({"x": np.random.default_rng(0).uniform(size=chunks * chunk)})
    with tempfile.TemporaryDirectory() as folder:
        sweep(nothing, design, Path(folder) / "sweep", chunk=chunk, workers=1)
        files = (Path(folder) / "sweep").glob("*.parquet")
        return sum(file.stat().st_size for file in files) / (chunks * chunk)


def billion_case_table(measured: Overhead, spent: float, size: float, workers: int) -> ResultTable:
    """Extrapolate the measured numbers to a billion cases; nothing is run.

    Args:
        measured: Of a sweep by Dask.
        spent: Processor time of a case [s].
        size: Of a case on disk [byte].
        workers: Of the sweep that was measured.
    """
    cases = 1e9
    chunk = 1e5
    at_once = 1e7
    chunks = cases / chunk
    sweeps = cases / at_once
    writing = sweeps * measured.once + chunks * measured.part + cases * measured.case
    computing = cases * spent
    rows: list[list[float | str | None]] = [
        ["sweeps, each a folder that goes on by itself", f"{sweeps:,.0f} of {at_once:,.0f} cases"],
        ["parts of a sweep, of 100,000 cases each", f"{chunks / sweeps:,.0f}"],
        ["memory of a design with three parameters", f"{at_once * 3 * 8 / 1e9:.2g} GB"],
        ["disk, a parameter and a result of a case", f"{cases * size / 1e9:,.0f} GB"],
        ["computing on one processor", f"{computing / 86400:,.1f} days"],
    ]
    note = (
        "Calculated from the tables above, not run. A case is a free swing of "
        f"{SWING:g} s; overhead is that of Dask with {workers} workers."
    )
    if measured.case > 0.0:
        rows += [
            ["the one program that hands out and writes", f"{writing / 3600:.1f} h"],
            ["processors that it keeps busy", f"{computing / writing:,.0f}"],
            ["with 64 processors", f"{max(computing / 64, writing) / 3600:,.1f} h"],
        ]
    else:
        note += " What a case adds was lost in the noise, so nothing is said of many processors."
    return ResultTable("A billion cases, on paper", (("what", ""), ("how much", "")), rows, note)


def sweeping_tables(workers: Sequence[int], chunks: int, chunk: int) -> list[ResultTable]:
    """Return the tables of overhead, scaling, and a billion cases."""
    rate_of_one = 0.0
    costs: list[list[float | str | None]] = []
    grown: list[list[float | str | None]] = []
    kinds = [("processes", 1), ("processes", workers[0]), *(("Dask", count) for count in workers)]
    for kind, count in kinds:
        print(f"measuring: {kind}, {count}", file=sys.stderr)
        with way(kind, count) as by:
            cost = overhead(by, chunks, chunk)
            speed = scaling(by, 6 * count)
        # The first is one process, with which the others are compared.
        rate_of_one = rate_of_one or speed.rate
        costs.append([by.name, cost.once, 1e3 * cost.part, 1e6 * cost.case])
        grown.append(
            [
                by.name,
                100.0 * speed.efficiency,
                speed.rate,
                speed.rate / rate_of_one,
                1e3 * speed.spent,
            ]
        )
    note = (
        f"On {os.cpu_count()} processors that had {os.getloadavg()[1]:.0f} processes to run on "
        "average. First part: by the clock; a part, a case: processor time of the program that "
        f"sweeps, by sweeps that compute nothing, of {chunks} parts of one case and of {chunk:,}."
    )
    return [
        ResultTable("What a sweep adds", COST_COLUMNS, costs, note),
        ResultTable(
            "Growth",
            GROWTH_COLUMNS,
            grown,
            f"Waiting: share of the ideal where each chunk waits {1e3 * PAUSE:g} ms and needs no "
            f"processor. Swings: of {SWING:g} s, in chunks of {CRANES}, and the ratio to one "
            f"process, on {os.cpu_count()} processors; a swing: processor time of one.",
        ),
        billion_case_table(cost, speed.spent, bytes_a_case(), count),
    ]


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    quick = {"action": "store_true", "help": "less of each, and less precisely"}

    def measure(options: argparse.Namespace) -> list[ResultTable]:
        if options.quick:
            return sweeping_tables((1,), chunks=24, chunk=100)
        return sweeping_tables(WORKERS, chunks=128, chunk=4000)

    return print_tables("sweeping", __doc__, measure, argv, quick=quick)


if __name__ == "__main__":
    sys.exit(main())
