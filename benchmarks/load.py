"""How long a crane takes to load, each time in a process of its own: imports, the first crane, ten
others, and the text with its looks.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
from collections.abc import Sequence
from typing import NamedTuple

from benchmarks.timing import fresh

_PROGRAM = """
import json, time
start = time.perf_counter()
from cranedyn.model.load import load_crane
imported = time.perf_counter()
crane = load_crane()
first = time.perf_counter()
for i in range(10):
    load_crane(payload_mass=100.0 * (i + 1))
others = time.perf_counter()
crane.urdf
last = time.perf_counter()
print(json.dumps([imported - start, first - imported, (others - first) / 10, last - others]))
"""
"""Script that prints the numbers of `LoadingTimes`."""


class LoadingTimes(NamedTuple):
    """Times of a process that loads cranes.

    Attributes:
        imports: Time for the imports [s].
        first: Time for the first crane [s].
        another: Time for each of ten other cranes [s].
        urdf: Time for the whole URDF of a crane [s].
    """

    imports: float
    first: float
    another: float
    urdf: float


def measure_loading(rounds: int) -> LoadingTimes:
    """Return the median of each time over a number of processes."""
    # Python translates the modules in the first process, which is not measured.
    fresh(_PROGRAM)
    runs = [json.loads(fresh(_PROGRAM)) for _ in range(rounds)]
    medians = [statistics.median(times) for times in zip(*runs, strict=True)]
    return LoadingTimes(*medians)


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print; 0 if the first crane is loaded in the time asked for, 1 if not."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.load", description=__doc__)
    parser.add_argument("--rounds", type=int, default=7, help="processes (default 7)")
    parser.add_argument(
        "--most", type=float, default=0.15, help="time for the first crane [s] (default 0.15)"
    )
    options = parser.parse_args(argv)
    times = measure_loading(max(options.rounds, 1))
    names = ("imports", "first crane", "another crane", "its whole URDF")
    for name, seconds in zip(names, times, strict=True):
        print(f"{name:15} {1e3 * seconds:6.1f} ms")
    return 0 if times.first <= options.most else 1


if __name__ == "__main__":
    sys.exit(main())
