"""Kinds of entries by the form of their name, and how each one is opened.

`open_entry` is called in the process in which entries run, since opening one runs its code. Each
kind but Python has a module of its own in `cranedyn.benchmark.entries`, which is imported only when
such an entry is opened: most of them need an extra.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from cranedyn.benchmark.entry import Briefing, Entry, Opened
from cranedyn.errors import CraneError, DataError, OutOfRange, format_error, quoted
from cranedyn.interop.controller_file import load_function, open_controller


class EntryKind(NamedTuple):
    """A kind of entries that are files with an ending of their own.

    Attributes:
        what: What such a file is, with an article.
        module: Module whose function `open_source` opens it.
        packages: Packages whose versions a result names beside those of all entries.
    """

    what: str
    module: str
    packages: tuple[str, ...] = ()


LIBRARY = EntryKind("a shared library in C", "cranedyn.benchmark.entries.c_library")
"""A shared library in C, whatever the system calls its file."""

OPCUA = EntryKind("a program on OPC UA", "cranedyn.benchmark.entries.opcua", ("asyncua",))
"""A program that talks by OPC UA, whatever its file is called."""

KINDS = {
    ".so": LIBRARY,
    ".dylib": LIBRARY,
    ".dll": LIBRARY,
    ".fmu": EntryKind("an FMU", "cranedyn.benchmark.entries.fmu", ("fmpy",)),
    ".onnx": EntryKind(
        "a policy in ONNX", "cranedyn.benchmark.entries.onnx_policy", ("onnxruntime",)
    ),
    ".zip": EntryKind(
        "a policy of Stable-Baselines3",
        "cranedyn.benchmark.entries.sb3_policy",
        ("stable-baselines3", "torch"),
    ),
}
"""Kinds of entries by the ending of their file."""

MATRICES = (".json", ".mat")
"""Endings of files of matrices."""

UNPICKLED = (".zip",)
"""Endings of files that look like data, but run code when they are opened, since they are
unpickled."""

OPCUA_PROGRAM = "opcua:"
"""Beginning of the name of a program that is started and talks by OPC UA."""

OPCUA_URL = "opc.tcp://"
"""Beginning of the address at which a program that the user starts talks by OPC UA."""


def kind_of(source: str) -> EntryKind | None:
    """Return the kind of an entry; None for functions in Python and files of matrices."""
    if source.startswith((OPCUA_PROGRAM, OPCUA_URL)):
        return OPCUA
    return KINDS.get(Path(source).suffix)


def open_entry(source: str) -> Opened:
    """Open an entry; code in it is run. For the process in which entries run.

    Raises:
        CraneError: If it cannot be opened.
    """
    kind = kind_of(source)
    if kind is not None:
        opened: Opened = import_module(kind.module).open_source(source)
        return opened
    file, _, function = source.rpartition(":")
    if file.endswith(".py"):
        return _checked(source, load_function(Path(file), function, ("briefing",)))
    if Path(source).suffix not in MATRICES:
        raise DataError(f"{quoted(source)} names no entry.")
    matrices = open_controller(source)

    def make(briefing: Briefing) -> Entry:
        made = matrices.make(briefing.crane, briefing.motion, briefing.step)
        return briefing.entry(made.controller, briefing.motion, made.drive)

    return make


def _checked(source: str, function: Callable[..., object]) -> Opened:
    """Return a function of an entry that raises sentences."""

    def make(briefing: Briefing) -> Entry:
        try:
            made = function(briefing)
        except CraneError:
            raise
        except Exception as error:
            raise CraneError(f"{source} failed: {format_error(error)}") from error
        if not callable(made):
            allowed = "a function of a reading that returns rates"
            raise OutOfRange(f"result of {source}", type(made).__name__, allowed)
        return made

    return make
