"""Entries that are shared libraries in C, by the interface of ``crane_entry.h`` in this folder.

The library is loaded into the process of the entry: what it breaks ends that process only.
"""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import numpy as np

from cranedyn.benchmark.entries.plain_briefing import PlainBriefing, plain_briefing
from cranedyn.benchmark.entries.targets import Targets
from cranedyn.benchmark.entry import Briefing, Declined, Entry, Opened
from cranedyn.benchmark.sensors import SensorReading
from cranedyn.errors import CraneError, DataError

HEADER = Path(__file__).with_name("crane_entry.h")
"""The interface in C."""

_DECLINES = 1
"""What `crane_begin` returns where the library does not take part."""

_Doubles = ctypes.POINTER(ctypes.c_double)
_Texts = ctypes.POINTER(ctypes.c_char_p)

_TYPES: dict[str, Any] = {
    "str": ctypes.c_char_p,
    "int": ctypes.c_int32,
    "float": ctypes.c_double,
    "list[str]": _Texts,
    "list[float]": _Doubles,
    "list[float] | None": _Doubles,
}
"""Types of C by the annotations of `PlainBriefing`."""


class _CBriefing(ctypes.Structure):
    """``crane_briefing`` of ``crane_entry.h``, which has the fields of `PlainBriefing`."""

    _fields_ = [
        (name, _TYPES[annotation]) for name, annotation in PlainBriefing.__annotations__.items()
    ]


class _CReading(ctypes.Structure):
    """``crane_reading`` of ``crane_entry.h``."""

    _fields_ = [
        ("t", ctypes.c_double),
        ("position", _Doubles),
        ("rate", _Doubles),
        ("swing", _Doubles),
        ("swing_rate", _Doubles),
        ("operator_rate", _Doubles),
        ("target", _Doubles),
        ("target_rate", _Doubles),
    ]


def open_source(source: str) -> Opened:
    """Load a shared library.

    Raises:
        DataError: If it cannot be loaded, or has not the functions of ``crane_entry.h``.
    """
    path = Path(source).resolve()
    try:
        library = ctypes.CDLL(str(path))
    except OSError as error:
        raise DataError(f"{source} is no shared library of this machine: {error}.") from error
    for name in ("crane_begin", "crane_command"):
        if not hasattr(library, name):
            raise DataError(
                f"{source} has no function {name}; an entry in C defines those of crane_entry.h, "
                "which cranedyn benchmark header writes."
            )
    library.crane_begin.argtypes = [ctypes.POINTER(_CBriefing)]
    library.crane_begin.restype = ctypes.c_int32
    library.crane_command.argtypes = [ctypes.POINTER(_CReading), _Doubles]
    library.crane_command.restype = ctypes.c_int32

    def make(briefing: Briefing) -> Entry:
        return _LibraryEntry(library, briefing)

    return make


class _LibraryEntry:
    """The functions of a library in an instance. Numbers are handed over in arrays that stay."""

    def __init__(self, library: ctypes.CDLL, briefing: Briefing) -> None:
        plain = plain_briefing(briefing)
        told = _CBriefing()
        for name, annotation in PlainBriefing.__annotations__.items():
            setattr(told, name, _in_c(annotation, getattr(plain, name)))
        self._library = library
        status = library.crane_begin(ctypes.byref(told))
        if status == _DECLINES:
            raise Declined(self._message() or "The library declines this task.")
        if status != 0:
            raise CraneError(f"crane_begin returned {status}{self._reason()}.")

        m = plain.drives
        s = plain.swings
        self._targets = Targets(briefing)
        self._rates = np.zeros(m)
        self._rates_in_c = self._rates.ctypes.data_as(_Doubles)
        self._arrays = [np.zeros(size) for size in (m, m, s, s, m, m, m)]
        self._reading = _CReading(0.0, *(array.ctypes.data_as(_Doubles) for array in self._arrays))
        self._address = ctypes.byref(self._reading)

    def __call__(self, reading: SensorReading) -> np.ndarray:
        """Return the rates for a reading."""
        self._reading.t = reading.t
        target = self._targets(reading)
        for array, values in zip(self._arrays, (*reading[1:], *target), strict=True):
            array[:] = values
        # What the library does not write is no number, and found to be none.
        self._rates[:] = np.nan
        status = self._library.crane_command(self._address, self._rates_in_c)
        if status != 0:
            raise CraneError(f"crane_command returned {status}{self._reason()}.")
        return self._rates.copy()

    def _message(self) -> str:
        """Return what the library says of its last call; empty if nothing."""
        if not hasattr(self._library, "crane_message"):
            return ""
        self._library.crane_message.restype = ctypes.c_char_p
        text = self._library.crane_message()
        return "" if text is None else text.decode(errors="replace")

    def _reason(self) -> str:
        """Return the same to be put behind a sentence."""
        message = self._message()
        return f": {message.rstrip('.')}" if message else ""


def _in_c(annotation: str, value: Any) -> Any:
    """Return a field of a briefing as a value of C."""
    if value is None:
        return _Doubles()
    if annotation == "str":
        return value.encode()
    if annotation == "list[str]":
        return (ctypes.c_char_p * len(value))(*(text.encode() for text in value))
    if annotation.startswith("list[float]"):
        return (ctypes.c_double * len(value))(*value)
    return value
