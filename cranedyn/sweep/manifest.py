"""The folder of a sweep: which it is, and that one process at a time is at it."""

from __future__ import annotations

import hashlib
import json
import os
import re
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

from cranedyn.data.files import atomic_write, make_folder, parse_json, read_text, try_flock
from cranedyn.errors import CraneError, DataError, shown
from cranedyn.sweep.sources import changed

MANIFEST, LOCK, PART = "_sweep.json", ".lock", "part-{:06d}.parquet"
"""Files of a sweep; Parquet readers that are given the folder skip the first two."""

_ANY_PART, _NUMBERED = re.compile(r"part-.*\.parquet"), re.compile(r"part-(\d{6,16})\.parquet")
_DRAFT = re.compile(r"\.(part-.*\.parquet|_sweep\..*\.json)")
_MOST = 2**53


@dataclass(frozen=True)
class Manifest:
    """What makes a sweep this one and no other.

    Attributes:
        study: Module and name of the study.
        version: Of cranedyn.
        sources: Checksums of the files that the study is computed by, see
            `cranedyn.sweep.sources.sources`.
        design: Fingerprint of the design.
        parameters: Its columns, in order.
        cases: Its number of cases.
        chunk: Cases in a part; the last may have fewer.
    """

    study: str
    version: str
    sources: Mapping[str, str]
    design: str
    parameters: tuple[str, ...]
    cases: int
    chunk: int

    @property
    def parts(self) -> int:
        """Number of parts."""
        return -(-self.cases // self.chunk)

    @cached_property
    def checksum(self) -> str:
        """SHA-256 of all of it."""
        return hashlib.sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()

    def rows(self, part: int) -> tuple[int, int]:
        """The first case of a part, and that after its last."""
        return part * self.chunk, min((part + 1) * self.chunk, self.cases)

    def parts_in(self, folder: Path) -> list[int]:
        """The parts of which there is a file, in order, whatever is in it."""
        names = _names(folder)
        numbers = (int(found[1]) for name in names if (found := _NUMBERED.fullmatch(name)))
        return sorted(part for part in numbers if part < self.parts and PART.format(part) in names)


def as_folder(given: str | Path) -> Path:
    """The path of a folder.

    Raises:
        DataError: If it cannot be one.
    """
    if not isinstance(given, (str, os.PathLike)) or not str(given) or "\0" in str(given):
        raise DataError(f"The folder of a sweep is {shown(given)}; allowed is a path.")
    return Path(given)


def read_manifest(folder: Path) -> Manifest:
    """The manifest in a folder.

    Raises:
        DataError: If there is none that can be read, or it is not as it was written.
    """
    path = folder / MANIFEST
    if not os.path.isfile(path):  # which a name too long is not
        raise DataError(f"{folder} holds no sweep: there is no {MANIFEST} in it.")
    text = read_text(path)
    try:
        found = parse_json(text)
        checksum = found.pop("checksum")
        manifest = Manifest(**{**found, "parameters": tuple(found["parameters"])})
        if not (_sound(manifest) and manifest.checksum == checksum):
            raise ValueError
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise DataError(
            f"{path} is damaged, or of another version of cranedyn; the parts beside it may be "
            "whole: "
            "put the file back as it was, or sweep into another folder."
        ) from None
    return manifest


def _sound(manifest: Manifest) -> bool:
    """Whether all is of the kind that it should be, and numbers are such that parts can be
    counted.
    """
    words = (manifest.study, manifest.version, manifest.design, *manifest.parameters)
    numbers = (manifest.cases, manifest.chunk)
    return (
        all(isinstance(word, str) for word in words)
        and all(type(number) is int and 1 <= number <= _MOST for number in numbers)
        and isinstance(manifest.sources, dict)
        and all(isinstance(checksum, str) for checksum in manifest.sources.values())
    )


@contextmanager
def claimed(folder: Path, manifest: Manifest, chunk_given: bool) -> Iterator[Manifest]:
    """Have the folder for this process alone, begun anew if no part is there; what a killed process
    left half written is removed.

    What was made for it goes again if it is refused, or the sweep is before anything is done.

    Yields:
        The manifest that holds: that given, with chunks of the size begun with if none was asked
        for.

    Raises:
        DataError: If the folder holds another sweep or anything else, another process is at it, or
            it cannot be written to.
    """
    if strangers := _strangers(folder):
        shown = ", ".join(strangers[:3]) + (", …" if strangers[3:] else "")
        raise DataError(
            f"Cannot sweep in {folder}: it holds other things ({shown}); give a folder of its own."
        )
    with _made(folder), _locked(folder):
        parts, ours = False, False
        try:
            names = _names(folder)
            for draft in filter(_DRAFT.fullmatch, names):
                with suppress(OSError):
                    (folder / draft).unlink()
            parts = any(map(_ANY_PART.fullmatch, names))
            if parts and MANIFEST in names:
                manifest = _same(folder, read_manifest(folder), manifest, chunk_given)
            else:
                _write(folder / MANIFEST, manifest)
                ours = True
            yield manifest
        except CraneError:
            if not (parts or (ours and manifest.parts_in(folder))):
                for name in (MANIFEST, LOCK)[not ours :]:
                    (folder / name).unlink(missing_ok=True)
            raise


def _write(path: Path, manifest: Manifest) -> None:
    with atomic_write(path) as draft:
        draft.write_text(
            json.dumps({**asdict(manifest), "checksum": manifest.checksum}, indent=1),
            encoding="utf-8",
        )


def _strangers(folder: Path) -> list[str]:
    """What is in a folder that is none of a sweep."""
    names = _names(folder)
    return (
        []
        if MANIFEST in names
        else sorted(name for name in names if name != LOCK and not name.startswith("._sweep."))
    )


def _names(folder: Path) -> set[str]:
    """What is in a folder, nothing if there is none."""
    try:
        return {path.name for path in folder.iterdir()}
    except (FileNotFoundError, NotADirectoryError):
        return set()
    except OSError as error:
        raise DataError(f"Cannot read the folder {folder}: {error.strerror}.") from error


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """The folder, with those above it; after an error those that were not there before go again if
    they are empty.
    """
    missing = [path for path in (folder, *folder.parents) if not os.path.exists(path)]
    try:
        make_folder(folder)
        yield
    except CraneError:
        for path in missing:
            with suppress(OSError):
                path.rmdir()
        raise


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    path = folder / LOCK
    try:
        file = os.open(
            path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o666
        )
    except OSError as error:
        raise DataError(f"Cannot sweep in {folder}: {error.strerror}.") from error
    try:
        if not stat.S_ISREG(os.fstat(file).st_mode):
            raise DataError(f"Cannot sweep in {folder}: {LOCK} in it is no file.")
        # Gone with a refused sweep, which has just removed it.
        if try_flock(file, path) in ("taken", "gone"):
            raise DataError(f"Cannot sweep in {folder}: another process is sweeping there.")
        yield
    finally:
        os.close(file)


def _same(folder: Path, found: Manifest, asked: Manifest, chunk_given: bool) -> Manifest:
    differs = [
        f"its {name} {there}, not {here}"
        for name, there, here in (
            ("study is", found.study, asked.study),
            ("parameters are", ", ".join(found.parameters), ", ".join(asked.parameters)),
            ("number of cases is", found.cases, asked.cases),
            (
                "number of cases in a part is",
                found.chunk,
                asked.chunk if chunk_given else found.chunk,
            ),
        )
        if there != here
    ]
    if not differs and found.design != asked.design:
        differs = ["its parameters have other values"]
    if differs:
        raise DataError(f"Cannot sweep in {folder}: it holds another sweep; {', '.join(differs)}.")
    _check_code(folder, found, asked)
    return found


def _check_code(folder: Path, found: Manifest, asked: Manifest) -> None:
    """Return if the same code goes on that has begun."""
    if found.version != asked.version:
        one, other = (manifest.version or "of no version" for manifest in (found, asked))
        code, way_back = f"by cranedyn {one}, this is {other}", "go on with that"
    elif names := changed(found.sources, asked.sources):
        shown = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if names[3:] else "")
        code, way_back = f"by other code: {shown} changed since", "put that back as it was"
    else:
        return
    raise DataError(
        f"Cannot sweep on in {folder}: what is there was computed {code}; {way_back}, or sweep "
        "into another folder."
    )
