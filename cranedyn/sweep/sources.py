"""Source files that a study is computed by, with their checksums."""

from __future__ import annotations

import hashlib
import importlib.util
from collections.abc import Iterator, Mapping
from pathlib import Path

from cranedyn.data.files import digest
from cranedyn.errors import DataError

_ROOT = Path(__file__).resolve().parents[2]


def source_digests(study: str) -> dict[str, str]:
    """Return the SHA-256 of each source file that a study is computed by.

    These are all Python files of the study's top package, or the one file of a module in no
    package, and all of cranedyn with its descriptions of cranes. Other packages are left out.

    Returns:
        By file name below the folder that it is imported from; sorted.

    Raises:
        DataError: If a file cannot be read.
    """
    package = study.partition(":")[0].partition(".")[0]
    try:
        files = dict([*_source_files(package), *_source_files("cranedyn")])
        return {name: digest(path) for name, path in sorted(files.items())}
    except OSError as error:
        raise DataError(
            f"Cannot read {error.filename}, which the study may be made of: {error.strerror}."
        ) from error


def code_digest(digests: Mapping[str, str]) -> str:
    """Return one digest of all source files."""
    lines = "".join(f"{checksum} {name}\n" for name, checksum in digests.items())
    return hashlib.sha256(lines.encode()).hexdigest()


def _source_files(package: str) -> Iterator[tuple[str, Path]]:
    try:
        spec = importlib.util.find_spec(package)
    except (ImportError, ValueError):
        spec = None
    if spec is None:
        return
    folders = {folder: package for folder in spec.submodule_search_locations or ()}
    if package == "cranedyn" and (_ROOT / "urdf").is_dir():
        folders[str(_ROOT / "urdf")] = "cranedyn/urdf"  # inside the package once installed
    for folder, name in folders.items():
        for path in Path(folder).rglob("*"):
            if path.suffix in (".py", ".xacro") and path.is_file():
                yield f"{name}/{path.relative_to(folder).as_posix()}", path
    if not folders and spec.origin and spec.origin.endswith(".py"):
        yield f"{package}.py", Path(spec.origin)
