"""Processes in which untrusted files are read, with bounds on memory and time.

Libraries in C, C++ and Rust read such files. A file with one wrong byte may end the process that
reads it, or ask for a terabyte of memory; neither can be caught. So small programs, which import
nothing of this package, read them in processes of their own, which limit themselves.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

from cranedyn.errors import DataError

MEMORY = 4_000_000_000
"""Largest address space of a reading process [byte]."""

CPU_TIME = 60
"""Longest processor time of a reading process [s]."""

WALL_TIME = 120.0
"""Longest time that a reading process may take [s]."""


def run_reader(
    program: Path,
    arguments: Sequence[str],
    path: str | Path,
    output: BinaryIO,
    *,
    source: BinaryIO | None = None,
    folder: str | Path | None = None,
) -> int:
    """Run a program that reads a file, and return its exit status, negative for a signal.

    Args:
        program: The program; it sets the limits, which are among its arguments, itself.
        arguments: Its arguments.
        path: The file that it reads, for error messages.
        output: Takes its standard output.
        source: Its standard input; None for none.
        folder: Its current folder; None for that of this process.

    Raises:
        DataError: If it takes more than `WALL_TIME`, or cannot be started.
    """
    environment = {
        **os.environ,
        "OPENBLAS_NUM_THREADS": "1",  # each thread would reserve memory
        "OMP_NUM_THREADS": "1",
        "HDF5_PLUGIN_PRELOAD": "::",  # no filter is loaded from a folder
        "HDF5_USE_FILE_LOCKING": "FALSE",
    }
    try:
        # -P: no module beside the program takes the place of one that is installed.
        return subprocess.run(
            [sys.executable, "-P", str(program), *arguments],
            stdin=subprocess.DEVNULL if source is None else source,
            stdout=output,
            stderr=subprocess.DEVNULL,
            env=environment,
            cwd=folder,
            timeout=WALL_TIME,
            check=False,
        ).returncode
    except subprocess.TimeoutExpired:
        raise DataError(
            f"Cannot read {path}: reading it takes more than {WALL_TIME:g} s."
        ) from None
    except OSError as error:
        raise DataError(f"Cannot read {path}: no process to read it can be started.") from error


def json_reply(line: str | bytes) -> dict[str, Any]:
    """Return what a reading process says on a line of JSON; nothing if it is no such line."""
    try:
        reply = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return reply if isinstance(reply, dict) else {}


def why_it_ended(code: int) -> str:
    """Return why a reading process ended without output, by its exit status."""
    if code in (-getattr(signal, "SIGXCPU", 24), -getattr(signal, "SIGKILL", 9)):
        return f"reading it takes more than {CPU_TIME} s of processor time, or too much memory"
    if code == -signal.SIGABRT:
        return (
            f"its reader gave up; the file may be damaged, or need more than {MEMORY / 1e9:.0f} GB "
            "of memory"
        )
    if code < 0:
        return f"its reader crashed ({signal.Signals(-code).name}); the file may be damaged"
    return "its reader ended without a result; the file may be damaged"
