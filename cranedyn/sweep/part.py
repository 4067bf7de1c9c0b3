"""One part of a sweep: a Parquet file that carries the checksum of itself and says of which sweep
it is which part.

The checksum is looked at before anything else: Arrow's reader is not made for damaged files, some
of which end the process.
"""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import pyarrow as pa
import pyarrow.parquet as pq

from cranedyn.data.files import atomic_write
from cranedyn.errors import DataError
from cranedyn.sweep.manifest import PART, Manifest

_KEY, _MARK, _EMPTY = b"cranedyn.sweep", b" sha256 ", b"0" * 64
_TAIL, _BLOCK = 2**20, 2**20


class Damaged(DataError):
    """A part that is not as it was written, or not the one that its name says."""


def write(folder: Path, manifest: Manifest, part: int, table: pa.Table) -> int:
    """Write a part, whole or not at all, and onto the disk; returns its bytes.

    Raises:
        DataError: If it cannot be written.
    """
    path = folder / PART.format(part)
    sink = pa.BufferOutputStream()
    with pq.ParquetWriter(sink, table.schema) as writer:
        writer.write_table(table)
        writer.add_key_value_metadata({_KEY: _label(manifest, part) + _MARK + _EMPTY})
    content = bytearray(sink.getvalue())
    place = content.rindex(_MARK + _EMPTY) + len(_MARK)
    content[place : place + len(_EMPTY)] = hashlib.sha256(content).hexdigest().encode()
    with atomic_write(path) as draft:
        draft.write_bytes(content)
    return len(content)


@contextmanager
def opened(folder: Path, manifest: Manifest, part: int) -> Iterator[pq.ParquetFile]:
    """A part, when its checksum and its number have been found to be what they should be.

    Raises:
        Damaged: If they are not.
        DataError: If the file cannot be read, is none, or is of another sweep.
    """
    path = folder / PART.format(part)
    try:
        with open(path, "rb", opener=_without_waiting) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise DataError(f"{path} is no file; move it away, and its cases are computed.")
            if not is_whole(file):
                raise Damaged(f"{path} is not as it was written.")
        # by a name of the system's, which may be no UTF-8: threads of Arrow that hold an object of
        # Python's abort a program that ends
        with (
            open(path, "rb") as file,
            pa.OSFile(f"/dev/fd/{file.fileno()}") as same,
            pq.ParquetFile(same) as found,
        ):
            label = (found.metadata.metadata or {}).get(_KEY, b"").partition(_MARK)[0]
            if not label.endswith(manifest.checksum.encode()):
                raise DataError(
                    f"{path} is whole, but of another sweep; move it away, and its cases are "
                    "computed."
                )
            if label != _label(manifest, part):
                raise Damaged(f"{path} is another part of the same sweep.")
            yield found
    except (OSError, pa.ArrowException) as error:
        raise DataError(
            f"Cannot read {path}: {getattr(error, 'strerror', None) or error}."
        ) from error


def _label(manifest: Manifest, part: int) -> bytes:
    return f"part {part} of sweep {manifest.checksum}".encode()


def is_whole(file: BinaryIO) -> bool:
    """Whether a part has the checksum that it names in its last megabyte, where this itself counts
    as zeros.
    """
    size = file.seek(0, os.SEEK_END)
    start = file.seek(max(0, size - _TAIL))
    tail = file.read(_TAIL)
    place = tail.rfind(_MARK) + len(_MARK)
    if place < len(_MARK) or place + len(_EMPTY) > len(tail):
        return False
    sum_ = hashlib.sha256()
    file.seek(0)
    for begin in range(0, start, _BLOCK):
        sum_.update(file.read(min(_BLOCK, start - begin)))
    sum_.update(tail[:place] + _EMPTY + tail[place + len(_EMPTY) :])
    return tail[place : place + len(_EMPTY)] == sum_.hexdigest().encode()


def _without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK)  # of a pipe nobody may ever write to
