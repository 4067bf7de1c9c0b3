"""What a study is computed by: the Python files of its package and of cranedyn, by checksum."""

from __future__ import annotations

import hashlib
import importlib.util
from collections.abc import Iterator, Mapping
from pathlib import Path

from cranedyn.data.files import digest as digest_of
from cranedyn.errors import DataError

_OURS = Path(__file__).resolve().parents[2]
_ENDINGS = ("*.py", "*.xacro")


def sources(study: str) -> dict[str, str]:
    """Checksums of what a study is computed by.

    These are all files of the package at the top of its name, or the one file of a module in none,
    and all of cranedyn with its descriptions of cranes. Other packages are not looked at.

    Args:
        study: Its name, see `cranedyn.sweep.chunk.name_of`.

    Returns:
        By file, under its name below the folder that it is imported from, the SHA-256 of its
        content; sorted.

    Raises:
        DataError: If a file cannot be read.
    """
    found = {}
    try:
        for name, path in (*_files(study.partition(":")[0].partition(".")[0]), *_files("cranedyn")):
            found[name] = digest_of(path)
    except OSError as error:
        raise DataError(
            f"Cannot read {error.filename}, which the study may be made of: {error.strerror}."
        ) from error
    return dict(sorted(found.items()))


def digest(files: Mapping[str, str]) -> str:
    """One checksum of them all."""
    return hashlib.sha256(
        "".join(f"{checksum} {name}\n" for name, checksum in files.items()).encode()
    ).hexdigest()


def changed(before: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Files that are not what they were, or are there no more, or were not there."""
    return sorted(name for name in before.keys() | now.keys() if before.get(name) != now.get(name))


def _files(package: str) -> Iterator[tuple[str, Path]]:
    """The files of a package or of a module, each with its name below the folder that it is
    imported from.
    """
    try:
        spec = importlib.util.find_spec(package)
    except (ImportError, ValueError):
        spec = None
    if spec is None:
        return
    folders = {folder: package for folder in spec.submodule_search_locations or ()}
    if package == "cranedyn" and (_OURS / "urdf").is_dir():
        # Beside the package in a checkout, inside of it once installed.
        folders[str(_OURS / "urdf")] = "cranedyn/urdf"
    for folder, name in folders.items():
        for path in (
            path for ending in _ENDINGS for path in Path(folder).rglob(ending) if path.is_file()
        ):
            yield f"{name}/{path.relative_to(folder).as_posix()}", path
    if not folders and spec.origin and spec.origin.endswith(".py"):
        yield f"{package}.py", Path(spec.origin)
