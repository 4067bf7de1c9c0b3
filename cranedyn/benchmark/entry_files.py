"""Which files an entry consists of, found while it runs.

A result names each of them with its SHA-256, so that `verify` can say which one differs. They are
the file of the entry, and whatever lies in its folder and was imported, opened or mapped into
memory by the process of the entry: helper modules, tables, weights, libraries. What is installed
does not count, nor does cranedyn itself; of these a result names the versions.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from cranedyn.benchmark.task import FOLDER as TASKS
from cranedyn.data.files import digest
from cranedyn.errors import DataError, quoted
from cranedyn.model.description import XACRO

_INSTALLED = (sys.prefix, sys.base_prefix, str(XACRO.parent), str(TASKS))
"""Folders whose files are not the entry's, whatever the folder of the entry is."""

_PACKAGE = str(Path(__file__).resolve().parents[1])
"""Folder of cranedyn, whose modules are not the entry's. Data beside the baselines are."""

_MAPPED = Path("/proc/self/maps")
"""List of the files that are mapped into the memory of this process, on Linux."""

_WRITING = os.O_WRONLY | os.O_RDWR
"""Flags of a file that is opened to be written."""


class EntryFiles:
    """The files of an entry that this process has used.

    Python's own audit tells which files were opened, `sys.modules` which modules were imported
    (whose sources need not be opened, if they were compiled before), and the system which libraries
    were loaded. Files that a library opened and closed by itself are not found.
    """

    def __init__(self, file: Path) -> None:
        """Watch the files that are opened from now on.

        Args:
            file: File of the entry.
        """
        self._file = file.resolve()
        self._prefix = str(self._file.parent) + os.sep
        self._opened: set[str] = set()
        # Digests by path, with the time of the last change and the size at which they were taken.
        self._known: dict[str, tuple[tuple[int, int], str]] = {}
        sys.addaudithook(self._audit)

    def digests(self) -> dict[str, str]:
        """Return the SHA-256 of each file by its path in the folder of the entry, with slashes. The
        file of the entry itself comes first.
        """
        found = {}
        main = str(self._file)
        for path in [main, *sorted(self._candidates() - {main})]:
            try:
                status = os.stat(path)
                version = (status.st_mtime_ns, status.st_size)
                known = self._known.get(path)
                if known is None or known[0] != version:
                    known = (version, digest(Path(path)))
                    self._known[path] = known
            except (OSError, DataError):
                continue  # opened in vain, or removed since
            found[Path(path[len(self._prefix) :]).as_posix()] = known[1]
        return found

    def _audit(self, event: str, arguments: tuple[Any, ...]) -> None:
        """Note a file that is opened to be read; Python calls this for each event."""
        if event != "open":
            return
        path, mode, flags = arguments
        is_read = not (flags & _WRITING) if mode is None else not set(mode) & set("wax+")
        if is_read and isinstance(path, str | bytes):
            self._opened.add(os.path.abspath(os.fsdecode(path)))

    def _candidates(self) -> set[str]:
        """Return the paths of all files that belong to the entry, but perhaps for its own."""
        paths = set()
        # Most of the thousand paths share their folders. To resolve each path by itself took 40 ms,
        # a tenth of a short instance. Links may change, so nothing is kept for the next call.
        real_folder = cache(os.path.realpath)
        for path in set(self._used()):
            folder, name = os.path.split(path)
            real = os.path.join(real_folder(folder), name)
            if os.path.islink(real):
                real = os.path.realpath(real)
            if real.startswith(self._prefix) and not self._is_foreign(real):
                paths.add(real)
        return paths

    def _used(self) -> Iterator[str]:
        """Yield the paths of all files that were used in this process, whosever they are."""
        yield from list(self._opened)
        for module in list(sys.modules.values()):
            path = getattr(module, "__file__", None)
            if isinstance(path, str):
                yield path
        if _MAPPED.exists():
            for line in _MAPPED.read_text().splitlines():
                # Address, permissions, offset, device, inode, path.
                columns = line.split(maxsplit=5)
                if len(columns) == 6 and columns[5].startswith("/"):
                    yield columns[5]

    def _is_foreign(self, path: str) -> bool:
        """Return whether a file in the folder of the entry is installed, hidden or compiled by
        Python.
        """
        if path.endswith(".py") and path.startswith(_PACKAGE + os.sep):
            return True
        if any(path.startswith(folder + os.sep) for folder in _INSTALLED):
            return True
        parts = Path(path[len(self._prefix) :]).parts
        return "__pycache__" in parts or any(part.startswith(".") for part in parts)


def add_digests(files: dict[str, str], found: Mapping[str, str]) -> set[str]:
    """Add files of an entry to those that are known, and return the names of those that are known
    with another SHA-256.

    Args:
        files: SHA-256 of the files that are known by their names; the others are added here.
        found: SHA-256 of the files that were found now.
    """
    changed = set[str]()
    for name, sha in found.items():
        if files.setdefault(name, sha) != sha:
            changed.add(name)
    return changed


def changed_files(stated: Mapping[str, str], file: Path) -> list[str]:
    """Return which files of an entry are not those of a result, a sentence each.

    Args:
        stated: SHA-256 of each file of the result by its path in the folder of the entry, see
            `EntryFiles.digests`.
        file: File of the entry here, which may have another name than in the result.

    Raises:
        DataError: If a path leads out of that folder.
    """
    found = []
    for i, (name, expected) in enumerate(stated.items()):
        relative = Path(name)
        if relative.is_absolute() or ".." in relative.parts:
            raise DataError(
                f"The result names {quoted(name)} as a file of the entry, which is not in the "
                "folder of the entry."
            )
        path = file if i == 0 else file.parent / relative
        if not path.is_file():
            found.append(f"{path} is missing.")
            continue
        present = digest(path)
        if present != expected:
            found.append(
                f"{path} is not the file of the result: its SHA-256 begins with {present[:12]}, "
                f"that of the result with {expected[:12]}."
            )
    return found
