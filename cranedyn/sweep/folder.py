"""Folder of a sweep: a manifest that says which sweep it is, and a Parquet file per finished chunk.

Every chunk file carries the SHA-256 of itself and says which chunk of which sweep it is. That is
checked before Arrow reads it, whose reader a damaged file may crash.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from cranedyn.command import defer_sigint
from cranedyn.data.files import atomic_write, lock_folder, open_file, parse_json, read_text
from cranedyn.errors import DataError
from cranedyn.sweep.design import check_memory
from cranedyn.sweep.study import CaseRange, concatenate

MANIFEST = "_sweep.json"
"""Name of the manifest. Readers that are given the folder as a dataset skip it, as it begins with
an underscore."""

CHUNK_FILE = "part-{:06d}.parquet"
"""Name of the file of a chunk by its number."""

_KEY = b"cranedyn.sweep"
"""Key of the label of a chunk in the metadata of its file."""

_CHECKSUM_MARK = b" sha256 "
"""What stands between the label of a chunk and the checksum of its file."""

_NO_CHECKSUM = b"0" * 64
"""What stands for the checksum while it is computed."""


_MAX_LISTED = 3
"""Number of names in a message that are given in full."""


class DamagedChunk(DataError):
    """A chunk file that is not as it was written, or is another chunk of the same sweep."""


@dataclass(frozen=True)
class Manifest:
    """Identity of a sweep. Chunk files of different manifests are never mixed.

    Attributes:
        study: The study as ``module:function``.
        version: Version of cranedyn.
        sources: SHA-256 of each source file, see `cranedyn.sweep.study.source_digests`.
        design: Fingerprint of the design.
        parameters: Columns of the design.
        cases: Number of cases.
        chunk: Number of cases in a chunk; the last may have fewer.
    """

    study: str
    version: str
    sources: Mapping[str, str]
    design: str
    parameters: tuple[str, ...]
    cases: int
    chunk: int

    @property
    def chunks(self) -> int:
        """Number of chunks; the last may have fewer cases."""
        return -(-self.cases // self.chunk)  # rounded up

    @cached_property
    def checksum(self) -> str:
        """SHA-256 of all attributes."""
        return hashlib.sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()

    def rows(self, index: int) -> CaseRange:
        """Return the cases of a chunk."""
        return CaseRange(index * self.chunk, min((index + 1) * self.chunk, self.cases))


def read_manifest(path: Path) -> Manifest:
    """Read the manifest in a folder.

    Raises:
        DataError: If there is none, or it is not as it was written.
    """
    file = path / MANIFEST
    # `Path.is_file` would raise for a name that is too long.
    if not os.path.isfile(file):
        raise DataError(f"{path} holds no sweep: there is no {MANIFEST} in it.")
    text = read_text(file)
    try:
        fields = parse_json(text)
        checksum = fields.pop("checksum")
        manifest = Manifest(**{**fields, "parameters": tuple(fields["parameters"])})
        if manifest.checksum != checksum:
            raise ValueError
        for size in (manifest.cases, manifest.chunk):
            if type(size) is not int or size <= 0:
                raise ValueError
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise DataError(
            f"{file} is damaged, or of another version of cranedyn; the chunk files beside it may "
            "be whole: put the file back as it was, or sweep into another folder."
        ) from None
    return manifest


@dataclass(frozen=True)
class SweepFolder:
    """Chunk files of one sweep.

    Attributes:
        path: The folder.
        manifest: The sweep to which its files belong.
    """

    path: Path
    manifest: Manifest

    def indices(self) -> list[int]:
        """Return the numbers of the chunks that have a file, in order, whatever is in it."""
        indices = []
        for name in _names(self.path):
            match = re.fullmatch(r"part-(\d{6,})\.parquet", name)
            if match and int(match[1]) < self.manifest.chunks:
                indices.append(int(match[1]))
        return sorted(indices)

    def write(self, index: int, table: pa.Table) -> int:
        """Write a chunk file, the first one after the manifest; return its size [byte]."""
        if not (self.path / MANIFEST).exists():
            fields = {**asdict(self.manifest), "checksum": self.manifest.checksum}
            with atomic_write(self.path / MANIFEST) as draft:
                draft.write_text(json.dumps(fields, indent=1), encoding="utf-8")
        # A writer of Arrow has a destructor in Python. Ctrl-C in a destructor would be lost, as
        # Python ignores the exceptions of destructors, and the sweep would go on.
        with defer_sigint():
            content = self._chunk_file(index, table)
        with atomic_write(self.path / CHUNK_FILE.format(index)) as draft:
            draft.write_bytes(content)
        return len(content)

    def _chunk_file(self, index: int, table: pa.Table) -> bytearray:
        """Return what the file of a chunk holds."""
        sink = pa.BufferOutputStream()
        with pq.ParquetWriter(sink, table.schema) as writer:
            writer.write_table(table)
            label = self._label(index) + _CHECKSUM_MARK + _NO_CHECKSUM
            writer.add_key_value_metadata({_KEY: label})
        # The checksum of the file stands in the file: it is computed with zeros in its place. The
        # metadata are at the end, so that the last mark is the right one.
        content = bytearray(sink.getvalue())
        start = content.rindex(_CHECKSUM_MARK + _NO_CHECKSUM) + len(_CHECKSUM_MARK)
        content[start : start + len(_NO_CHECKSUM)] = hashlib.sha256(content).hexdigest().encode()
        return content

    def open(self, index: int) -> pq.ParquetFile:
        """Open a chunk file after checking it.

        Raises:
            DamagedChunk: If its checksum or its number is wrong.
            DataError: If the file cannot be read, or is of another sweep.
        """
        path = self.path / CHUNK_FILE.format(index)
        with open_file(path) as file:
            content = file.read()
        if not is_whole(content):
            raise DamagedChunk(f"{path} is not as it was written.")
        chunk = pq.ParquetFile(pa.BufferReader(content))
        label = (chunk.metadata.metadata or {}).get(_KEY, b"").partition(_CHECKSUM_MARK)[0]
        if not label.endswith(self.manifest.checksum.encode()):
            raise DataError(
                f"{path} is whole, but of another sweep; move it away, and its cases are computed."
            )
        if label != self._label(index):
            raise DamagedChunk(f"{path} is another chunk of the same sweep.")
        return chunk

    def read(self, index: int, columns: list[str] | None = None) -> pa.Table:
        """Read a chunk file, or some of its columns; raise as `open`."""
        # One thread: those of Arrow that hold a Python object abort a program that ends meanwhile.
        return self.open(index).read(columns, use_threads=False).replace_schema_metadata(None)

    def unify(self) -> None:
        """Give all chunk files the same columns, so that any reader takes them for one dataset.

        Results of a chunk whose cases are all bad become null.

        Raises:
            DataError: If a result is a number in one chunk and a word in another.
        """
        schemas = []
        for i in range(self.manifest.chunks):
            schemas.append(self.open(i).schema_arrow.remove_metadata())
        empty = concatenate([schema.empty_table() for schema in schemas])
        for i, schema in enumerate(schemas):
            if not schema.equals(empty.schema):
                self.write(i, concatenate([empty, self.read(i)]).cast(empty.schema))

    def _label(self, index: int) -> bytes:
        """Return which chunk of which sweep a file is, as its metadata say it."""
        return f"part {index} of sweep {self.manifest.checksum}".encode()


def is_whole(content: bytes) -> bool:
    """Return whether a chunk file has the checksum that it names, which itself counts as zeros."""
    start = content.rfind(_CHECKSUM_MARK) + len(_CHECKSUM_MARK)
    end = start + len(_NO_CHECKSUM)
    digest = hashlib.sha256(content[:start])
    digest.update(_NO_CHECKSUM)
    digest.update(content[end:])
    has_mark = start >= len(_CHECKSUM_MARK)  # otherwise rfind returned -1
    return has_mark and content[start:end] == digest.hexdigest().encode()


@contextmanager
def claim(path: Path, manifest: Manifest, *, fixed_chunk: bool) -> Iterator[SweepFolder]:
    """Reserve the folder of a sweep for this process: a new one, or one to resume.

    Drafts that a killed process left are removed. A folder that is new and stays empty goes again.

    Args:
        path: The folder.
        manifest: The sweep.
        fixed_chunk: Whether a sweep that was begun with other chunks is refused, or goes on so.

    Raises:
        DataError: If the folder holds another sweep or anything else, another process has it, or it
            cannot be written to.
    """
    with lock_folder(path):
        names = _names(path)
        visible = [name for name in names if not name.startswith(".")]
        if visible and MANIFEST not in names:
            raise DataError(
                f"Cannot sweep in {path}: it holds other things ({_listed(visible)}); give a "
                "folder of its own."
            )
        for name in names:
            if name.startswith((".part-", "._sweep.")):
                (path / name).unlink()
        if MANIFEST in names:
            first = read_manifest(path)
            if SweepFolder(path, first).indices():
                if not fixed_chunk:
                    manifest = replace(manifest, chunk=first.chunk)
                _check_same(path, first, manifest)
            else:  # nothing is done, so it is in nobody's way
                (path / MANIFEST).unlink()
        yield SweepFolder(path, manifest)


def _names(path: Path) -> list[str]:
    """Return the names of all files and folders in a folder, sorted."""
    try:
        return sorted(os.listdir(path))
    except OSError as error:
        raise DataError(f"Cannot read the folder {path}: {error.strerror}.") from error


def _listed(names: list[str]) -> str:
    """Return some names as part of a sentence, and how many there are beside the first ones."""
    listed = ", ".join(names[:_MAX_LISTED])
    further = len(names) - _MAX_LISTED
    return f"{listed} and {further} more" if further > 0 else listed


def _check_same(path: Path, first: Manifest, now: Manifest) -> None:
    """Check that a folder holds the same sweep, by the same code.

    Args:
        path: The folder, for the message.
        first: The sweep that the folder was begun with.
        now: The sweep to resume.

    Raises:
        DataError: If they differ.
    """
    differences = []
    for key in ("study", "parameters", "cases", "chunk", "version"):
        before = getattr(first, key)
        after = getattr(now, key)
        if before != after:
            differences.append(f"{key} was {before}, now {after}")
    if first.design != now.design and not differences:
        differences.append("parameters have other values")
    changed_items = first.sources.items() ^ now.sources.items()
    changed_files = sorted({name for name, _ in changed_items})
    if changed_files:
        differences.append(f"the code changed: {_listed(changed_files)}")
    if differences:
        raise DataError(
            f"Cannot sweep in {path}: it holds another sweep ({'; '.join(differences)}); undo "
            "that, or sweep into another folder."
        )


def results(folder: str | Path, *, partial: bool = False) -> pa.Table:
    """Read all cases of a sweep, in order.

    Args:
        folder: Where it was swept.
        partial: Whether a sweep that is not finished gives the chunks there are, without damaged
            ones, instead of an error.

    Returns:
        The columns `case`, the parameters, the results, and `error`, null where a case went well.

    Raises:
        DataError: If there is no sweep, it is not finished, a chunk file is damaged or cannot be
            read, or the table would not fit the memory.
    """
    files = SweepFolder(Path(folder), read_manifest(Path(folder)))
    cases = files.manifest.cases
    tables = list[pa.Table]()
    damaged = list[str]()
    for i in files.indices():
        try:
            tables.append(files.read(i))
        except DamagedChunk:
            damaged.append(CHUNK_FILE.format(i))
        if len(tables) == 1:
            # Before the others are read; a value takes eight bytes, or about as many.
            check_memory(f"The table of {cases} cases", cases * 8.0 * tables[0].num_columns)
    done = sum(map(len, tables))
    if done < cases and not partial:
        message = (
            f"The sweep in {folder} is not finished: {done} of {cases} cases are there; sweep on, "
            "or ask for a partial table."
        )
        if damaged:
            message += f" Damaged, and computed again as it goes on: {', '.join(damaged)}."
        raise DataError(message)
    if not tables:
        raise DataError(f"The sweep in {folder} has no finished case yet.")
    return concatenate(tables)
