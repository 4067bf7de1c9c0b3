"""Program that reads one binary file of a stranger, in a process of its own.

`cranedyn.data.bounded` starts it. It imports nothing of cranedyn, reads the file that is its
standard input, and writes a line of JSON and then bytes, which the line describes, to its standard
output. A library that fails, hangs, or asks for all memory over a damaged file ends this process
and nothing else.

Usage: binary_reader.py KIND MEMORY CPU_TIME LARGEST, with memory and the largest output in bytes
and the processor time in seconds.
"""

from __future__ import annotations

import datetime
import json
import resource
import sys
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

MAX_DEPTH = 6
"""Deepest nesting of structures whose fields become columns."""

MAX_COLUMNS = 4096
"""Largest number of columns of a file."""

MAX_MATRIX_WIDTH = 256
"""Widest matrix whose columns become columns of the table; a wider one is a picture or a map."""

MAX_TEXT_CELLS = 200_000
"""Largest number of cells of a workbook that hold words."""

MAX_MESSAGES = 20_000_000
"""Largest number of messages of a recording."""

MAX_STRUCTURES = 64
"""Number of elements of an array of structures whose fields become columns."""

MAX_REMARKS = 20
"""Number of remarks on a file that are passed on."""

MAX_WORD_LENGTH = 500
"""Number of characters of a cell of a workbook that are passed on."""

MAX_REASON_LENGTH = 300
"""Number of characters of the message of a library that are passed on."""

HEADER_ALLOWANCE = 100_000_000
"""Bytes that may be written beside those of the numbers: the line that describes them."""

EPOCH = datetime.datetime(1970, 1, 1)
"""Time from which dates of a workbook are counted."""

JOINT_STATE = "sensor_msgs/msg/JointState"
"""Type of the messages that are taken from a recording."""


class Refusal(Exception):
    """What is wrong with the file, as the end of the sentence "Cannot read FILE: ..."."""


def write(header: dict[str, Any], *parts: Any) -> None:
    """Write a header and arrays to the standard output."""
    size = sum(part.nbytes for part in parts)
    if size > LARGEST:
        raise Refusal(f"it holds {size / 1e6:.0f} MB of numbers; allowed are {LARGEST / 1e6:.0f}")
    out = sys.stdout.buffer
    out.write(json.dumps(header | {"bytes": size}).encode() + b"\n")
    for part in parts:
        if part.nbytes:  # a view of no bytes cannot be cast
            out.write(memoryview(part).cast("B"))
    out.flush()


def write_columns(columns: Iterator[tuple[str, Any]], remarks: list[str]) -> None:
    """Write columns of numbers by name, of any lengths."""
    import numpy as np

    names: list[str] = []
    arrays: list[Any] = []
    total = 0
    for name, values in columns:
        if len(names) == MAX_COLUMNS:
            raise Refusal(f"it has more than {MAX_COLUMNS} columns")
        total += 8 * len(values)
        if total > LARGEST:
            raise Refusal(f"it holds more than {LARGEST / 1e6:.0f} MB of numbers")
        names.append(name)
        arrays.append(np.ascontiguousarray(values, dtype="<f8"))
    lengths = [len(array) for array in arrays]
    write({"names": names, "lengths": lengths, "remarks": remarks[:MAX_REMARKS]}, *arrays)


def matrix_columns(name: str, array: Any, remarks: list[str]) -> Iterator[tuple[str, Any]]:
    """Yield the columns of a vector or matrix in MATLAB's notation; a scalar has none."""
    if array.size <= 1:
        return
    if array.ndim > 2:  # dimensions of one element say nothing
        array = array.reshape([n for n in array.shape if n != 1] or [1])
    if array.ndim > 2:
        remarks.append(f"{name} has {array.ndim} dimensions and is left out")
    elif array.ndim == 1 or 1 in array.shape:
        yield name, array.ravel()
    elif array.shape[1] > MAX_MATRIX_WIDTH:
        remarks.append(f"{name} has {array.shape[1]} columns and is left out")
    else:
        for j in range(array.shape[1]):
            yield f"{name}(:,{j + 1})", array[:, j]


# --- MATLAB 4 to 7.2 ------------------------------------------------------------------------------


def read_matlab_arrays() -> None:
    """Read variables and fields of structures of a file of MATLAB up to version 7.2."""
    from scipy.io import loadmat

    with open(0, "rb", closefd=False) as file:
        variables = loadmat(file)
    remarks: list[str] = []

    def columns() -> Iterator[tuple[str, Any]]:
        """Yield the columns of all variables but those that SciPy adds, such as __header__."""
        for name, value in variables.items():
            if not name.startswith("__"):
                yield from mat_columns(name, value, remarks, 0)

    write_columns(columns(), remarks)


def mat_columns(name: str, value: Any, remarks: list[str], depth: int) -> Iterator[tuple[str, Any]]:
    """Yield the columns of a variable: a vector, a matrix, or fields of a structure.

    Args:
        name: Its name, with those of the structures that it is in.
        value: Its value, as SciPy gives it.
        remarks: Remarks on the file; those on what is left out are added.
        depth: Number of structures that it is in.
    """
    import numpy as np

    if not isinstance(value, np.ndarray) or depth > MAX_DEPTH:
        return
    # SciPy gives a structure the names of its fields, and an object of a class a field s0.
    if value.dtype.names is not None and value.dtype.names[:1] != ("s0",):
        elements = value.ravel()
        for i, element in enumerate(elements[:MAX_STRUCTURES].tolist(), start=1):
            place = name if len(elements) == 1 else f"{name}({i})"
            for field, content in zip(value.dtype.names, element, strict=True):
                yield from mat_columns(f"{place}.{field}", content, remarks, depth + 1)
    elif value.dtype.names is not None or type(value).__name__ == "MatlabOpaque":
        remarks.append(
            f"{name} is an object of a class, which only MATLAB can read; save its vectors, such "
            "as ts.Time and ts.Data"
        )
    elif value.dtype.kind in "iufb":
        yield from matrix_columns(name, value, remarks)


# --- MATLAB 7.3 and HDF5 --------------------------------------------------------------------------


def read_hdf5() -> None:
    """Read data sets of an HDF5 file, such as one of MATLAB 7.3; links to other files are not
    followed.
    """
    import h5py

    remarks: list[str] = []
    with h5py.File("/dev/fd/0", "r") as file:
        is_matlab = b"MATLAB" in open("/dev/fd/0", "rb").read(128)
        write_columns(group_columns(file, "", is_matlab, remarks, 0), remarks)


def group_columns(
    group: Any, prefix: str, is_matlab: bool, remarks: list[str], depth: int
) -> Iterator[tuple[str, Any]]:
    """Yield the columns of the data sets of a group and its groups."""
    import h5py

    if depth > MAX_DEPTH:
        return
    for key in sorted(group):
        if key.startswith("#"):  # MATLAB's contents of cells and objects
            continue
        name = f"{prefix}{key}"
        if not isinstance(group.get(key, getlink=True), h5py.HardLink):
            remarks.append(f"{name} is a link and is left out")
            continue
        item = group[key]
        if isinstance(item, h5py.Group):
            yield from group_columns(item, f"{name}.", is_matlab, remarks, depth + 1)
        elif isinstance(item, h5py.Dataset):
            yield from dataset_columns(item, name, is_matlab, remarks)


def dataset_columns(
    item: Any, name: str, is_matlab: bool, remarks: list[str]
) -> Iterator[tuple[str, Any]]:
    """Yield the columns of a data set of numbers that lie in this file."""
    kind = item.attrs.get("MATLAB_class", b"double")
    if "MATLAB_empty" in item.attrs or kind in (b"char", b"cell", b"function_handle"):
        return
    if item.dtype.kind not in "iufb":
        remarks.append(f"{name} holds no numbers and is left out")
        return
    if item.is_virtual or item.external:
        raise Refusal(f"{name} lies in another file, which is not opened")
    if 8 * item.size > LARGEST:
        raise Refusal(f"{name} holds {8e-6 * item.size:.0f} MB; allowed are {LARGEST / 1e6:.0f}")
    array = item[()]
    # MATLAB stores columns first, HDF5 rows first.
    yield from matrix_columns(name, array.T if is_matlab else array, remarks)


# --- workbooks ------------------------------------------------------------------------------------


def read_workbook_cells() -> None:
    """Read the sheets of a workbook: a matrix of numbers each, and the cells that hold words."""
    from python_calamine import CalamineWorkbook

    with open(0, "rb", closefd=False) as file:
        workbook = CalamineWorkbook.from_filelike(file)
    sheets: list[dict[str, Any]] = []
    matrices: list[Any] = []
    for name in workbook.sheet_names:
        sheet = workbook.get_sheet_by_name(name)
        described, matrix = sheet_content(sheet.to_python(skip_empty_area=False))
        sheets.append({"name": name, **described})
        matrices.append(matrix)
        if sum(len(one["texts"]) for one in sheets) > MAX_TEXT_CELLS:
            raise Refusal(f"more than {MAX_TEXT_CELLS} of its cells hold words")
    write({"sheets": sheets}, *matrices)


def sheet_content(rows: list[list[Any]]) -> tuple[dict[str, Any], Any]:
    """Return the description of a sheet and its numbers, NaN where a cell has none. Dates count in
    seconds from 1970, times of day and durations in seconds.
    """
    import numpy as np

    height = len(rows)
    width = max((len(row) for row in rows), default=0)
    if 8 * height * width > LARGEST:
        raise Refusal(
            f"a sheet has {height} rows of {width} cells; allowed are {LARGEST // 8} cells"
        )
    matrix = np.full((height, width), np.nan)
    texts: list[tuple[int, int, str]] = []
    last_date = [-1] * width
    last_number = [-1] * width
    for i, row in enumerate(rows):
        for j, cell in enumerate(row):
            if isinstance(cell, str | bool):
                if cell != "":
                    texts.append((i, j, str(cell)[:MAX_WORD_LENGTH]))
                continue
            matrix[i, j], kind = cell_number(cell)
            if kind == "date":
                last_date[j] = i
            else:
                last_number[j] = i
        if len(texts) > MAX_TEXT_CELLS:
            raise Refusal(f"more than {MAX_TEXT_CELLS} of its cells hold words")
    description = {
        "height": height,
        "width": width,
        "texts": texts,
        # The last rows tell what the table holds, whatever stands above it.
        "last_date": last_date,
        "last_number": last_number,
    }
    return description, matrix


def cell_number(cell: Any) -> tuple[float, str]:
    """Return the number of a cell and whether it is a number, a date or a time of day."""
    if isinstance(cell, datetime.datetime):
        return (cell - EPOCH).total_seconds(), "date"
    if isinstance(cell, datetime.date):
        return float(86_400 * (cell - EPOCH.date()).days), "date"
    if isinstance(cell, datetime.time):
        seconds = 3600 * cell.hour + 60 * cell.minute + cell.second
        return seconds + 1e-6 * cell.microsecond, "time"
    if isinstance(cell, datetime.timedelta):
        return cell.total_seconds(), "time"
    return float(cell), "number"


# --- recordings of ROS 2 --------------------------------------------------------------------------


def read_rosbag2() -> None:
    """Read the messages of joint states of an SQLite file of rosbag2."""
    import sqlite3

    import numpy as np

    database = sqlite3.connect("file:/dev/fd/0?mode=ro&immutable=1", uri=True)
    # A database may define views and functions; none of them is to run.
    database.execute("PRAGMA trusted_schema = OFF")
    database.execute("PRAGMA cell_size_check = ON")
    kinds = dict(database.execute("SELECT name, type FROM sqlite_schema").fetchmany(1000))
    if kinds.get("topics") != "table" or kinds.get("messages") != "table":
        raise Refusal("it is no recording of ROS 2: it has no tables topics and messages")
    topics = joint_state_topics(database)
    names = list(topics.values())
    index = {number: i for i, number in enumerate(topics)}
    # Of each message the index of its topic, its time [ns] and its length [byte].
    times: list[tuple[int, int, int]] = []
    content = bytearray()
    query = "SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp"
    for number, time, data in database.execute(query):
        if number not in index:
            continue
        if not isinstance(data, bytes) or not isinstance(time, int):
            raise Refusal("a message in it is no message of ROS 2")
        times.append((index[number], time, len(data)))
        content += data
        if len(content) > LARGEST or len(times) > MAX_MESSAGES:
            raise Refusal(f"its joint states hold more than {LARGEST / 1e6:.0f} MB")
    numbers = np.array(times, dtype="<i8").reshape(-1, 3)
    header = {"topics": names, "messages": len(times)}
    write(header, numbers, np.frombuffer(content, dtype=np.uint8))


def joint_state_topics(database: Any) -> dict[int, str]:
    """Return the names of the topics of joint states of a recording by their numbers in it."""
    topics: dict[int, str] = {}
    query = "SELECT id, name, type, serialization_format FROM topics"
    for number, name, kind, serialization in database.execute(query):
        if kind == JOINT_STATE and serialization == "cdr":
            topics[int(number)] = str(name)
    return topics


READERS = {
    "mat": read_matlab_arrays,
    "hdf5": read_hdf5,
    "workbook": read_workbook_cells,
    "rosbag2": read_rosbag2,
}
"""Readers by kind of file."""

LARGEST = 0
"""Most bytes of output; set by `main`."""


def main(kind: str, memory: int, cpu_time: int, largest: int) -> None:
    """Read the standard input within limits; a file that is refused is a line with "error"."""
    global LARGEST
    LARGEST = largest
    limits = {
        resource.RLIMIT_AS: memory,
        resource.RLIMIT_CPU: cpu_time,
        resource.RLIMIT_FSIZE: largest + HEADER_ALLOWANCE,
        resource.RLIMIT_CORE: 0,
    }
    for limit, value in limits.items():
        with suppress(ValueError, OSError):  # a lower limit is set already, or the system has none
            resource.setrlimit(limit, (value, value))
    try:
        READERS[kind]()
    except ImportError as error:
        sys.stdout.write(json.dumps({"missing": error.name or str(error)}) + "\n")
    except MemoryError:
        message = f"reading it takes more than {memory / 1e9:.0f} GB of memory"
        sys.stdout.write(json.dumps({"error": message}) + "\n")
    except Refusal as refusal:
        sys.stdout.write(json.dumps({"error": str(refusal)}) + "\n")
    except Exception as error:  # whatever a parser raises over the bytes of a stranger
        reason = str(error).strip().partition("\n")[0][:MAX_REASON_LENGTH] or "it is damaged"
        sys.stdout.write(json.dumps({"error": f"{type(error).__name__}: {reason}"}) + "\n")


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:5]))
