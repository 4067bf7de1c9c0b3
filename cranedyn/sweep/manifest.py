"""The folder of a sweep: which it is, and that one process at a time is at it."""

from __future__ import annotations

import fcntl
import json
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from cranedyn.errors import DataError
from cranedyn.files import make_folder, read_text, remove_empty, written

MANIFEST, LOCK, PART = "_sweep.json", ".lock", "part-{:06d}.parquet"
"""Files of a sweep; Parquet readers that are given the folder skip the first two."""


@dataclass(frozen=True)
class Manifest:
    """What makes a sweep this one and no other.

    Attributes:
        study: Module and name of the study.
        design: Fingerprint of the design.
        parameters: Its columns, in order.
        cases: Its number of cases.
        chunk: Cases in a part; the last may have fewer.
    """

    study: str
    design: str
    parameters: tuple[str, ...]
    cases: int
    chunk: int

    def __len__(self) -> int:
        """Number of parts."""
        return math.ceil(self.cases / self.chunk)

    def rows(self, part: int) -> tuple[int, int]:
        """The first case of a part, and that after its last."""
        return part * self.chunk, min((part + 1) * self.chunk, self.cases)


def read_manifest(folder: Path) -> Manifest:
    """The manifest in a folder.

    Raises:
        DataError: If there is none that can be read.
    """
    path = folder / MANIFEST
    if not path.is_file():
        raise DataError(f"{folder} holds no sweep: there is no {MANIFEST} in it.")
    try:
        found = json.loads(read_text(path))
        manifest = Manifest(**{**found, "parameters": tuple(found["parameters"])})
        if not (manifest.cases >= 1 and manifest.chunk >= 1 and {type(manifest.cases), type(manifest.chunk)} == {int}):
            raise ValueError
    except (ValueError, TypeError, KeyError, RecursionError):
        raise DataError(f"{path} is not what a sweep writes; delete the folder or give another.") from None
    return manifest


@contextmanager
def claimed(folder: Path, manifest: Manifest, chunk_given: bool) -> Iterator[Manifest]:
    """Have the folder for this process alone, begun anew if no part is done; what a killed process left half written is removed.

    If it breaks off before a part is done, nothing is left of it, nor of folders made here.

    Yields:
        The manifest that holds: that given, with chunks of the size begun with if none was asked for.

    Raises:
        DataError: If the folder holds another sweep or anything else, another process is at it, or it cannot be written to.
    """
    if strangers := _strangers(folder):
        shown = ", ".join(strangers[:3]) + (", …" if strangers[3:] else "")
        raise DataError(f"Cannot sweep in {folder}: it holds other things ({shown}); give a folder of its own.")
    missing = [one for one in (folder, *folder.parents) if not one.exists()]
    with _locked(folder):
        for draft in [*folder.glob(".part-*.parquet"), *folder.glob("._sweep.*.json")]:
            with suppress(OSError):
                draft.unlink()
        if (folder / MANIFEST).exists() and _begun(folder):
            manifest = _same(folder, read_manifest(folder), manifest, chunk_given)
        else:
            with written(folder / MANIFEST) as file:
                file.write_text(json.dumps(asdict(manifest), indent=1), encoding="utf-8")
        try:
            yield manifest
        except BaseException:
            if not _begun(folder):
                for name in (MANIFEST, LOCK):
                    (folder / name).unlink(missing_ok=True)
                remove_empty(missing)
            raise


def _begun(folder: Path) -> bool:
    return any(folder.glob(PART.replace("{:06d}", "*")))


def _strangers(folder: Path) -> list[str]:
    """What is in a folder that is none of a sweep."""
    try:
        names = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
    except OSError as error:
        raise DataError(f"Cannot sweep in {folder}: {error.strerror}.") from error
    return [] if MANIFEST in names else [name for name in names if name != LOCK and not name.startswith("._sweep.")]


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    try:
        file = (make_folder(folder) / LOCK).open("a")
    except OSError as error:
        raise DataError(f"Cannot sweep in {folder}: {error.strerror}.") from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if not os.path.samestat(os.fstat(file.fileno()), (folder / LOCK).stat()):
                raise FileNotFoundError  # the other process has just ended and removed it
        except OSError:
            raise DataError(f"Cannot sweep in {folder}: another process is sweeping there.") from None
        yield


def _same(folder: Path, found: Manifest, asked: Manifest, chunk_given: bool) -> Manifest:
    differs = [
        f"its {name} {there}, not {here}"
        for name, there, here in (
            ("study is", found.study, asked.study),
            ("parameters are", ", ".join(map(str, found.parameters)), ", ".join(asked.parameters)),
            ("number of cases is", found.cases, asked.cases),
            ("number of cases in a part is", found.chunk, asked.chunk if chunk_given else found.chunk),
        )
        if there != here
    ]
    if not differs and found.design != asked.design:
        differs = ["its parameters have other values"]
    if differs:
        raise DataError(f"Cannot sweep in {folder}: it holds another sweep; {', '.join(differs)}.")
    return found
