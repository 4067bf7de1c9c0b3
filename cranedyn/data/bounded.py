"""Binary files of strangers, read in a process of their own with bounds on memory and time.

`cranedyn.data.binary_reader` reads them, and what it found comes back as a line of JSON and bytes.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np

from cranedyn.data import reading_process
from cranedyn.data.files import open_file
from cranedyn.data.reading_process import json_reply, run_reader, why_it_ended
from cranedyn.errors import CraneError, DataError

Kind = Literal["mat", "hdf5", "workbook", "rosbag2"]
"""Kinds of files: MATLAB up to 7.2, HDF5 and MATLAB 7.3, workbooks, SQLite files of rosbag2."""

LARGEST_FILE = 1_000_000_000
"""Largest binary file that is read, and most bytes that may be found in it [byte]."""

_MAX_HEADER = 100_000_000
"""Longest line of JSON in front of the bytes [byte]."""

_PROGRAM = Path(__file__).with_name("binary_reader.py")
"""Program that reads a binary file."""

_EXTRAS = {"h5py": "hdf5", "python_calamine": "excel"}
"""Extra of this package that installs a module, by the name of the module."""


@dataclass(frozen=True, eq=False)
class BoundedResult:
    """What was found in a file.

    Attributes:
        header: Description of the content, see `cranedyn.data.binary_reader`.
        content: The content, shape (bytes,).
    """

    header: Mapping[str, Any]
    content: np.ndarray


def read_bounded(path: str | Path, kind: Kind, content: bytes | None = None) -> BoundedResult:
    """Read a binary file in a process of its own.

    Args:
        path: A regular file of at most `LARGEST_FILE` bytes.
        kind: What it is.
        content: What to read instead; `path` is only a name for messages then.

    Raises:
        DataError: If it cannot be read, or reading it takes too much memory or time.
        CraneError: If a library that reads such files is not installed.
    """
    with _input(path, content) as file, tempfile.TemporaryFile() as output:
        if file.seek(0, os.SEEK_END) > LARGEST_FILE:
            raise DataError(f"Cannot read {path}: it is larger than {LARGEST_FILE / 1e6:g} MB.")
        file.seek(0)
        limits = [str(reading_process.MEMORY), str(reading_process.CPU_TIME), str(LARGEST_FILE)]
        code = run_reader(_PROGRAM, [kind, *limits], path, output, source=file)
        output.seek(0)
        line = output.readline(_MAX_HEADER)
        header = json_reply(line)
        _check_header(header, code, path)
        array = np.frombuffer(output.read(), dtype=np.uint8)
    if len(array) != header["bytes"]:
        raise DataError(f"Cannot read {path}: its reader broke off; the file is damaged.")
    return BoundedResult(header, array)


def _check_header(header: Mapping[str, Any], code: int, path: str | Path) -> None:
    """Check that a reading process has read its file.

    Args:
        header: What it says, see `cranedyn.data.binary_reader`; empty if it says nothing.
        code: Its exit status.
        path: The file.

    Raises:
        CraneError: If a library that reads such files is not installed.
        DataError: If the process refused the file, or ended without a result.
    """
    if "missing" in header:
        module = str(header["missing"]).partition(".")[0]
        extra = _EXTRAS.get(module)
        hint = f"pip install 'cranedyn[{extra}]'" if extra else f"pip install {module}"
        raise CraneError(f"To read {path} the module {module} is needed; install it: {hint}.")
    if "error" in header:
        raise DataError(f"Cannot read {path}: {str(header['error']).rstrip('.')}.")
    if code != 0 or "bytes" not in header:
        raise DataError(f"Cannot read {path}: {why_it_ended(code)}.")


def _input(path: str | Path, content: bytes | None) -> BinaryIO:
    """Return a file, or a temporary one with a content."""
    if content is None:
        return open_file(path)
    file = tempfile.TemporaryFile()
    file.write(content)
    return file
