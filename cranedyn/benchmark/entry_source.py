"""Where an entry comes from: how it is named on the command line, and the file that it is in."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from cranedyn.benchmark.baselines import NAMES
from cranedyn.benchmark.entry_kinds import KINDS, MATRICES, OPCUA_PROGRAM, OPCUA_URL, UNPICKLED
from cranedyn.data.files import digest
from cranedyn.errors import CraneError, DataError, UnknownName, quoted

FORMS = (
    "FILE.py:FUNCTION, FILE.so in C, FILE.fmu, FILE.onnx, FILE.zip of Stable-Baselines3, FILE.json "
    "or FILE.mat with matrices, opcua:PROGRAM, opc.tcp://127.0.0.1:PORT, or the name of a baseline"
)
"""Forms in which an entry is named."""

BASELINES = Path(__file__).resolve().with_name("baselines.py")
"""File of the baselines, which are entries like all others."""


@dataclass(frozen=True)
class EntrySource:
    """Where an entry comes from.

    Attributes:
        name: Its name in tables.
        source: How it is opened, see `cranedyn.benchmark.entry_kinds.open_entry`.
        file: The file; None for a program that the user starts, of which no file is known.
    """

    name: str
    source: str
    file: Path | None

    @property
    def files(self) -> dict[str, str]:
        """SHA-256 of the file by its name; empty where there is none. The other files of an entry
        are found while it runs, see `cranedyn.benchmark.entry_files`.
        """
        return {} if self.file is None else {self.file.name: digest(self.file)}

    def absolute(self) -> EntrySource:
        """Return the entry with the whole path of its file, for processes that work elsewhere.

        Raises:
            CraneError: If it is a program that the user starts, which is reached from here only.
        """
        if self.file is None:
            raise CraneError(
                f"{self.source} is reached from this machine only; leave out --scheduler."
            )
        file = self.file.absolute()
        if self.source.startswith(OPCUA_PROGRAM):
            return EntrySource(self.name, f"{OPCUA_PROGRAM}{file}", file)
        _, colon, function = self.source.rpartition(":")
        if self.file.suffix == ".py":
            return EntrySource(self.name, f"{file}{colon}{function}", file)
        return EntrySource(self.name, str(file), file)

    @property
    def max_jobs(self) -> int | None:
        """Largest number of processes of the entry at once; None for any number."""
        return 1 if self.source.startswith(OPCUA_URL) else None


def find_entry(text: str, *, trusted: bool = False) -> EntrySource:
    """Return where the entry is that a text names, without opening it.

    Args:
        text: The text.
        trusted: Whether the user trusts who made the entry, so that a file may be unpickled.

    Raises:
        DataError: If the text has none of the `FORMS`, or there is no such file.
        UnknownName: If it is a word, but no baseline.
        CraneError: If the file is to be unpickled and not trusted.
    """
    if text.startswith(OPCUA_URL):
        return EntrySource(_opcua_name(text), text, None)
    if text.startswith(OPCUA_PROGRAM):
        file = Path(text.removeprefix(OPCUA_PROGRAM))
        return _existing(EntrySource(file.stem, text, file))
    name, _, function = text.rpartition(":")
    path = Path(text)
    if name.endswith(".py"):
        return _existing(EntrySource(function, text, Path(name)))
    if path.suffix in KINDS or path.suffix in MATRICES:
        entry = _existing(EntrySource(path.stem, text, path))
        if path.suffix in UNPICKLED and not trusted:
            raise CraneError(
                f"{path} is {KINDS[path.suffix].what}, which is unpickled: that can run any code "
                "in it. Add --trust if you trust who made it; a policy in ONNX runs no code."
            )
        return entry
    if path.suffix == ".py":
        raise DataError(f"{quoted(text)} names no function; write {path}:FUNCTION.")
    if "/" in text or "." in text:
        raise DataError(f"{quoted(text)} names no entry; allowed is {FORMS}.")
    if text not in NAMES:
        raise UnknownName("baseline", text, NAMES, "Your own entry is FILE.py:FUNCTION.")
    return EntrySource(text, f"{BASELINES}:{text}", BASELINES)


def _opcua_name(url: str) -> str:
    """Return a name for a program that the user starts.

    Raises:
        DataError: If the address is not one of this machine with a port.
    """
    match = re.fullmatch(r"opc\.tcp://(127\.0\.0\.1|localhost):(\d{1,5})/?", url)
    if match is None or not 0 < int(match[2]) < 65536:
        raise DataError(
            f"{quoted(url)} is no address for an entry; allowed is opc.tcp://127.0.0.1:PORT: the "
            "benchmark listens there, on this machine only."
        )
    return "opcua"


def _existing(entry: EntrySource) -> EntrySource:
    """Return an entry whose file is there.

    Raises:
        DataError: If it is not.
    """
    if entry.file is None or not entry.file.is_file():
        raise DataError(f"Cannot read {entry.file}: there is no such file.")
    return entry
