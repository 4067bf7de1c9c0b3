"""What is made from text alone, shared by all processes of a test run: it is made once.

Half of the processor time of the tests of compiled code is LLVM's, and most of what it translates
it has translated before, in another process: each worker and each mutation compiles the same loops.
LLVM's object file of a module is kept under a digest of its text. Whatever changes the code that is
made, such as a mutation, changes the text.

The same holds of descriptions: xacro takes a third of a second of the processor for a crane with
its looks, and each process asks for the same cranes. An expansion is kept under a digest of the
xacro files, of its values and of the module that expands them.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import hashlib
import importlib.metadata
import os
import sys
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

FOLDER = "CRANEDYN_TEST_OBJECTS"
"""Name of the environment variable with the folder that the processes share."""


UNUSED_DAYS = 30.0
"""Days after which a file that no run has used is forgotten."""


def is_private(folder: Path) -> bool:
    """Return whether nobody but this user may write to a folder."""
    status = folder.stat()
    return not hasattr(os, "getuid") or (
        status.st_uid == os.getuid() and not status.st_mode & 0o022
    )


def forget_unused(folder: Path) -> None:
    """Remove the files of a shared folder that no run has used for `UNUSED_DAYS`."""
    last = time.time() - 86400.0 * UNUSED_DAYS
    for file in folder.iterdir():
        # Another run may remove it at the same time.
        with contextlib.suppress(FileNotFoundError):
            if file.stat().st_mtime < last:
                file.unlink()


def made_once(name: str, make: Callable[[Path], object]) -> Path:
    """Return a file of the shared folder; make it if no process has made it yet.

    Args:
        name: Name of the file.
        make: Writes the file.
    """
    file = Path(os.environ[FOLDER], name)
    with open(f"{file}.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not file.exists():
            draft = Path(f"{file}.draft")
            make(draft)
            draft.replace(file)
    file.touch()
    return file


class _Text:
    """The text of a module, in the place of the module: printing a large one takes a while."""

    def __init__(self, module: object) -> None:
        self._text = str(module)

    def __str__(self) -> str:
        return self._text


def share(folder: Path) -> None:
    """Let compilers and xacro keep in a folder what they make, and take it from there.

    It must be called before anything imports the functions that are replaced.
    """
    _share_machine_code(folder)
    _share_descriptions(folder)


def _share_descriptions(folder: Path) -> None:
    """Let `description._expand` keep expansions of the files of this project in a folder, and take
    them from there. These files read nothing but each other.
    """
    from cranedyn.model import description

    expand = description._expand

    @functools.wraps(expand)
    def expand_once(
        path: str,
        mappings: tuple[tuple[str, str], ...],
        packages: Mapping[str, str | Path] | None = None,
    ) -> str:
        ours = description.XACRO.parent
        if Path(path).parent != ours:
            return expand(path, mappings, packages)
        sources = sorted([*ours.glob("*.xacro"), Path(description.__file__)])
        name = _digest_of(
            Path(path).name,
            repr(mappings),
            *(source.read_text("utf-8") for source in sources),
            importlib.metadata.version("xacro"),
            sys.version,
        )
        file = folder / f"{name}.urdf"
        if not file.exists():
            _write(file, expand(path, mappings, packages).encode())
        return _used(file).decode()

    description._expand = expand_once


def _share_machine_code(folder: Path) -> None:
    """Let `machine.translate` and `machine.object_code` keep object files in a folder, and take
    them from there.
    """
    # NumPy comes along, and must not be imported before its settings.
    from llvmlite import binding

    from cranedyn.compiled import machine

    translate = machine.translate
    object_code = machine.object_code
    optimise = machine._optimise
    create_engine = binding.create_mcjit_compiler
    # What translates is replaced for one module at a time.
    lock = threading.Lock()

    @functools.wraps(translate)
    def translate_once(module: Any, *, inlining: bool = False) -> machine.Machine:
        text = _Text(module)
        file = folder / _digest(str(text), str(inlining))

        def create(code: Any, target: Any) -> Any:
            engine = create_engine(code, target)
            engine.set_object_cache(_writer(file), _reader(file))
            return engine

        with lock:
            binding.create_mcjit_compiler = create
            if file.exists():
                machine._optimise = _leave
            try:
                return translate(text, inlining=inlining)
            finally:
                binding.create_mcjit_compiler = create_engine
                machine._optimise = optimise

    @functools.wraps(object_code)
    def object_code_once(module: Any, triple: str, features: str = "") -> bytes:
        file = folder / _digest(str(module), triple, features)
        with lock:
            if not file.exists():
                _writer(file)(None, object_code(module, triple, features))
        return _used(file)

    machine.translate = translate_once
    machine.object_code = object_code_once


def _leave(code: Any, target: Any, *args: Any, **options: Any) -> None:
    """Do not optimise a module whose object file is there."""


def _digest(text: str, *options: str) -> str:
    """Return a name for the object file of a module: of its text, the options of its translation,
    and all else that it depends on.
    """
    import llvmlite
    from llvmlite import binding

    from cranedyn.compiled import machine

    return _digest_of(
        text,
        *options,
        Path(machine.__file__).read_text("utf-8"),
        llvmlite.__version__,
        binding.get_host_cpu_name(),
        binding.get_host_cpu_features().flatten(),
    )


def _digest_of(*parts: str) -> str:
    """Return a digest of texts and of where one ends and the next begins."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part.encode())
        digest.update(b"\0")
    return digest.hexdigest()


def _writer(file: Path) -> Callable[[Any, bytes], None]:
    """Return a function that LLVM calls with an object file that it has made."""

    def write(_: Any, content: bytes) -> None:
        _write(file, content)

    return write


def _write(file: Path, content: bytes) -> None:
    """Write a file of which another process never sees a part; it may write the same."""
    draft = file.with_name(f"{file.name}.{os.getpid()}.{threading.get_ident()}")
    draft.write_bytes(content)
    draft.replace(file)


def _reader(file: Path) -> Callable[[Any], bytes | None]:
    """Return a function that LLVM asks for an object file before it makes one."""

    def read(_: Any) -> bytes | None:
        return _used(file) if file.exists() else None

    return read


def _used(file: Path) -> bytes:
    """Return the content of a file, and keep it from being forgotten."""
    file.touch()
    return file.read_bytes()
