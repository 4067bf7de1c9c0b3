"""Processor time of the experiments of the report, each in a process of its own."""

import argparse
import subprocess
import sys
from collections.abc import Sequence
from resource import RUSAGE_CHILDREN, getrusage
from tempfile import TemporaryDirectory

from benchmarks.conduct import print_tables
from experiments.catalogue import EXPERIMENTS
from experiments.harness import ResultTable


def processor_time() -> float:
    """Return the processor time of all processes that were started and have ended [s]."""
    usage = getrusage(RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def measure(options: argparse.Namespace) -> Sequence[ResultTable]:
    """Return the table of experiments, with processor times [s] and exit codes."""
    rows = []
    for name in options.only or EXPERIMENTS:
        before = processor_time()
        with TemporaryDirectory() as folder:
            command = [sys.executable, "-m", "cranedyn", "report", "--only", name, "--out", folder]
            code = subprocess.run(command, stdout=subprocess.DEVNULL).returncode
        rows.append((name, processor_time() - before, code))
    total = sum(row[1] for row in rows)
    worst_code = max(row[2] for row in rows)
    rows.append(("all", total, worst_code))
    columns = [("experiment", ""), ("processor [s]", ".1f"), ("exit code", "d")]
    return [ResultTable("Experiments of the report", columns, rows)]


if __name__ == "__main__":
    names = {"nargs": "+", "choices": EXPERIMENTS, "metavar": "NAME", "help": "which (default all)"}
    sys.exit(print_tables("commands", __doc__, measure, None, only=names))
