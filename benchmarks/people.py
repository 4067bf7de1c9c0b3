"""What people wait for: processor time of the commands that they run first and most often, each in
a process of its own with all processes that it starts, beside the last committed table.
"""

from __future__ import annotations

import argparse
import csv
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from benchmarks.commands import processor_time
from benchmarks.conduct import print_tables
from cranedyn.errors import CraneError
from experiments.harness import ResultTable

ROOT = Path(__file__).parent.parent

COMMITTED = ROOT / "docs" / "results" / "people_commands.csv"
"""The last committed table, which `python -m benchmarks.people --document docs/results/speed.md`
writes."""

COMMAND_HEADER = "command"
"""Header of the column with the command lines."""

BEFORE_HEADER = "before [s]"
"""Header of the column with the processor times of the measurement before the last."""

NOW_HEADER = "now [s]"
"""Header of the column with the processor times of the last measurement."""

CODE_HEADER = "exit code"
"""Header of the column with the exit codes."""

_NOT_MEASURED = "-"
"""What a table has in place of a number that was not measured."""

_PYTHON = "python"
"""First word of a command line that stands for the interpreter that runs this benchmark."""


@dataclass(frozen=True)
class Wait:
    """A command that people wait for.

    Attributes:
        line: The command line, as a page shows it. It runs in an empty folder.
        goal: Processor time that it shall take at most [s]; None for a yardstick of others.
        preparation: A command line that runs before it in the same folder, and whose time does not
            count; empty for none.
    """

    line: str
    goal: float | None
    preparation: str = ""


_FIRST_STEP = (
    "from cranedyn import load_crane, simulate; "
    "from cranedyn.controllers import hold_controller; "
    "crane = load_crane(); "
    "simulate(crane, hold_controller(crane), duration=5e-3, engine='compiled')"
)
"""Program that does the first compiled control period of a process."""

WAITS: Mapping[str, Wait] = {
    "python": Wait("python -c pass", None),
    "first_step": Wait(f'python -c "{_FIRST_STEP}"', 0.2),  # eight starts of Python
    "a1": Wait("python -m experiments.a1 --gravity 9.8", 5.0),
    "first_run": Wait(f"python {ROOT / 'examples' / 'first_run.py'}", 1.2),
    "page": Wait("python -m cranedyn export page crane.html", 8.0),
    "compare": Wait(
        "python -m cranedyn run compare --only 'spline alone' 'flat + LQR' 'MPC to the goal'", 10.0
    ),
    "lift": Wait("python -m cranedyn run lift", 20.0),
    "shift": Wait(
        f"python -m cranedyn run site --site {ROOT / 'benchmarks' / 'three_towers_shift.toml'}",
        30.0,
    ),
    "lift_report": Wait("python -m cranedyn run lift_report --lifts 1000", 20.0),
    "film": Wait(
        "python -m cranedyn view out/a1/a1_l5.parquet --film swing.mp4",
        20.0,
        preparation="python -m cranedyn run a1 --length 5 --engine compiled",
    ),
    "report": Wait("python -m cranedyn report", 300.0),
    "tests": Wait(f"python -m pytest -q -n auto --rootdir {ROOT} {ROOT / 'tests'}", 600.0),
}
"""The commands by the names that `--only` takes."""


def run_line(line: str, folder: str) -> int:
    """Run a command line in a folder without its output, and return its exit code."""
    words = split_line(line)
    # Modules are found in this checkout, wherever the command runs.
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    # As for users: what Python has translated, it finds again.
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    return subprocess.run(
        words,
        cwd=folder,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ).returncode


def split_line(line: str) -> list[str]:
    """Return the words of a command line, with the path of this interpreter for "python"."""
    words = shlex.split(line)
    if words[0] == _PYTHON:
        words[0] = sys.executable
    return words


def measure_wait(wait: Wait) -> tuple[float, int]:
    """Return the processor time [s] and the exit code of a command.

    Raises:
        CraneError: If its preparation fails.
    """
    with TemporaryDirectory() as folder:
        if wait.preparation:
            code = run_line(wait.preparation, folder)
            if code != 0:
                raise CraneError(
                    f"{wait.preparation} ended with exit code {code}; {wait.line} needs its files. "
                    "Run it by itself to see why."
                )
        before = processor_time()
        code = run_line(wait.line, folder)
        return processor_time() - before, code


def shown_line(line: str) -> str:
    """Return a command line as a table shows it: without the folder of the checkout, and with a
    program in quotation marks left out.
    """
    line = line.replace(f"{ROOT}{os.sep}", "")
    line = line.replace(f'"{_FIRST_STEP}"', "FIRST_COMPILED_STEP")
    return line.replace(f" --rootdir {ROOT}", "")


class CommittedRow(NamedTuple):
    """A row of the committed table.

    Attributes:
        before: Processor time of the table before that one, as written [s].
        now: Its own processor time, as written [s].
        code: Exit code, as written.
    """

    before: str = _NOT_MEASURED
    now: str = _NOT_MEASURED
    code: str = _NOT_MEASURED


def committed_rows(path: Path = COMMITTED) -> dict[str, CommittedRow]:
    """Return the rows of the committed table by command line; none if there is no table."""
    if not path.is_file():
        return {}
    rows = {}
    with path.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            committed = CommittedRow(row[BEFORE_HEADER], row[NOW_HEADER], row[CODE_HEADER])
            rows[row[COMMAND_HEADER]] = committed
    return rows


def processor_name() -> str:
    """Return the name of the processor of this machine."""
    for line in _lines_of("/proc/cpuinfo"):
        key, _, value = line.partition(":")
        if key.strip() == "model name":
            return value.strip()
    return platform.processor() or platform.machine()


def _lines_of(path: str) -> list[str]:
    """Return the lines of a file, none where it does not exist."""
    file = Path(path)
    return file.read_text("utf-8", "replace").splitlines() if file.is_file() else []


def measure(options: argparse.Namespace) -> Sequence[ResultTable]:
    """Return the table of commands, with goals and processor times [s], and exit codes.

    A table for a document has all commands; those that were not measured are in it as in the
    committed table, with a dash for what is not there.
    """
    committed = committed_rows()
    chosen = options.only or [name for name in WAITS if name != "tests"]
    rows = []
    for name, wait in WAITS.items():
        if name not in chosen and not options.document:
            continue
        line = shown_line(wait.line)
        before, now, code = committed.get(line, CommittedRow())
        if name in chosen:
            seconds, exit_code = measure_wait(wait)
            before = now
            now = f"{seconds:.1f}"
            code = str(exit_code)
        rows.append((line, wait.goal, before, now, code))
    columns = [
        (COMMAND_HEADER, ""),
        ("goal [s]", ".1f"),
        (BEFORE_HEADER, ""),
        (NOW_HEADER, ""),
        (CODE_HEADER, ""),
    ]
    title = f"Processor time of commands, {processor_name()}, {os.cpu_count()} cores"
    return [ResultTable(title, columns, rows)]


if __name__ == "__main__":
    names = {
        "nargs": "+",
        "choices": list(WAITS),
        "metavar": "NAME",
        "help": f"which of {', '.join(WAITS)} (default all but tests)",
    }
    sys.exit(print_tables("people", __doc__, measure, None, only=names))
