"""C compilers and linters of this machine, and blocks that they compile."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path

import pytest

from cranedyn.compiled.block import KINDS, FunctionBlock
from cranedyn.compiled.c_text import Precision, c_header, c_source

STRICT = ("-std=c99", "-O1", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror")


def tool(name: str, package: str = "") -> str:
    """The path of a program; without it the test is skipped."""
    path = shutil.which(name)
    if path is None:
        pytest.skip(f"{name} is not installed: apt install {package or name}")
    return path


def output(*command: str | Path, folder: Path) -> str:
    """What a program prints, which must end well."""
    found = subprocess.run(
        [str(word) for word in command],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )
    assert found.returncode == 0, found.stdout + found.stderr
    return found.stdout + found.stderr


class CompiledBlock:
    """A block in C, compiled and loaded; its variables are attributes of `memory`."""

    def __init__(self, block: FunctionBlock, folder: Path, precision: Precision = "double") -> None:
        name = block.name
        folder = folder / block.name
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.h").write_text(c_header(block, precision))
        (folder / f"{name}.c").write_text(c_source(block, precision))
        library = folder / f"{name}.so"
        compiler = tool("gcc")
        output(compiler, *STRICT, "-shared", "-fPIC", f"{name}.c", "-o", library, folder=folder)
        number = ctypes.c_double if precision == "double" else ctypes.c_float
        fields = [(v.name, number) for kind in KINDS for v in block.of_kind(kind)]
        arrays = [(key, number * len(values)) for key, values in block.arrays.items()]
        tail = [("count", ctypes.c_int32), ("fault", ctypes.c_bool)]
        kind = type("Memory", (ctypes.Structure,), {"_fields_": [*fields, *arrays, *tail]})
        self.block = block
        self.memory = kind()
        self._library = ctypes.CDLL(str(library))
        self.call("reset")

    def call(self, function: str = "step") -> bool:
        """Call a function of the block; whether it found no fault."""
        code = getattr(self._library, f"{self.block.name}_{function}")
        code.restype = ctypes.c_bool
        return bool(code(ctypes.byref(self.memory)))
