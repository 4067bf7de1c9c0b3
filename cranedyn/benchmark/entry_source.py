"""Where an entry comes from: how it is named on the command line, and the file that it is in."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cranedyn.benchmark.baselines import NAMES
from cranedyn.data.files import digest
from cranedyn.errors import DataError, UnknownName, quoted

FORMS = "FILE.py:FUNCTION, FILE.json or FILE.mat, or the name of a baseline"
"""Forms in which an entry is named."""

NOT_YET = {
    ".so": "a shared library in C",
    ".dll": "a shared library in C",
    ".fmu": "an FMU",
    ".zip": "a policy of Stable-Baselines3",
    ".onnx": "a policy in ONNX",
}
"""Entries that cannot be entered yet, by the ending of their file."""

BASELINES = Path(__file__).resolve().with_name("baselines.py")
"""File of the baselines, which are entries like all others."""


@dataclass(frozen=True)
class EntrySource:
    """Where an entry comes from.

    Attributes:
        name: Its name in tables.
        source: How it is opened: FILE.py:FUNCTION, or a file of matrices.
        file: The file.
    """

    name: str
    source: str
    file: Path

    @property
    def digest(self) -> str:
        """SHA-256 of the file, in hexadecimal digits. Other files that it reads do not count."""
        return digest(self.file)


def find_entry(text: str) -> EntrySource:
    """Return where the entry is that a text names, without opening it.

    Raises:
        DataError: If the text has none of the `FORMS`, or there is no such file.
        UnknownName: If it is a word, but no baseline.
    """
    file, _, function = text.rpartition(":")
    path = Path(text)
    if file.endswith(".py"):
        return _existing(EntrySource(function, text, Path(file)))
    if path.suffix in NOT_YET:
        raise DataError(
            f"{quoted(text)} is {NOT_YET[path.suffix]}, which cannot be entered yet; allowed is "
            f"{FORMS}. A function in Python may call it."
        )
    if path.suffix in (".json", ".mat"):
        return _existing(EntrySource(path.stem, text, path))
    if path.suffix == ".py":
        raise DataError(f"{quoted(text)} names no function; write {path}:FUNCTION.")
    if "/" in text or "." in text:
        raise DataError(f"{quoted(text)} names no entry; allowed is {FORMS}.")
    if text not in NAMES:
        raise UnknownName("baseline", text, NAMES, "Your own entry is FILE.py:FUNCTION.")
    return EntrySource(text, f"{BASELINES}:{text}", BASELINES)


def _existing(entry: EntrySource) -> EntrySource:
    """Return an entry whose file is there.

    Raises:
        DataError: If it is not.
    """
    if not entry.file.is_file():
        raise DataError(f"Cannot read {entry.file}: there is no such file.")
    return entry
