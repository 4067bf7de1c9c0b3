"""A stand-in for NVIDIA's driver that runs the kernels on this processor, one thread after another,
from the text that LLVM would make PTX of.
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from cranedyn.compiled.machine import Machine, translate

_SPECIAL = ("ctaid", "ntid", "tid")
"""Registers of a GPU by which a thread knows its place."""

_KINDS = {"ptr": ctypes.c_int64, "i64": ctypes.c_int64, "double": ctypes.c_double}


def _for_processor(text: str) -> str:
    """Return a module whose kernels are plain functions, and whose special registers variables."""
    text = text.replace("ptx_kernel ", "")
    for name in _SPECIAL:
        full = f'@"llvm.nvvm.read.ptx.sreg.{name}.x"'
        text = text.replace(f"declare i32 {full}()", "").replace(full, f'@"read_{name}"')
        text += (
            f'\n@"{name}" = global i32 0\ndefine i32 @"read_{name}"() {{\n'
            f'  %"value" = load i32, ptr @"{name}"\n  ret i32 %"value"\n}}\n'
        )
    return text


class _Kernel:
    """A kernel of a module."""

    def __init__(self, text: str, machine: Machine, name: str) -> None:
        head = re.search(rf'define void @"{name}"\((.*?)\)', text)
        assert head
        self.kinds: list[Any] = [_KINDS[argument.split()[0]] for argument in head[1].split(", ")]
        self._machine = machine
        address = machine.engine.get_function_address(name)
        self._run = ctypes.CFUNCTYPE(None, *self.kinds)(address)

    def run(self, arguments: np.ndarray, blocks: int, block: int) -> None:
        """Run all threads to their ends."""
        values = [
            (number.view(float) if kind is ctypes.c_double else number).item()
            for number, kind in zip(arguments, self.kinds, strict=True)
        ]
        place, size, within = (
            ctypes.c_int32.from_address(self._machine.engine.get_global_value_address(name))
            for name in _SPECIAL
        )
        size.value = block
        for thread in range(blocks * block):
            place.value, within.value = divmod(thread, block)
            self._run(*values)


def driver(change: Callable[[str], str] = str) -> SimpleNamespace:
    """Return the functions of `cuda.bindings.driver` that a run needs; `calls` tells which were
    called.

    Args:
        change: What becomes of the text of a module, for code that is wrong.
    """
    done = SimpleNamespace(name="CUDA_SUCCESS")
    calls = list[str]()
    memory: dict[int, np.ndarray] = {}

    def load(image: bytes) -> tuple[str, Machine]:
        text = _for_processor(change(image.rstrip(b"\0").decode()))
        return text, translate(text)  # type: ignore[arg-type]

    def launch(kernel: _Kernel, blocks: int, *given: Any) -> None:
        values, kinds = given[7]
        assert len(values) == len(kinds) == len(kernel.kinds)
        kernel.run(np.array(values, np.int64), blocks, given[2])

    def allocate(size: int) -> int:
        array = np.empty(max(size, 1), np.uint8)
        memory[array.ctypes.data] = array
        return array.ctypes.data

    def copy_in(place: int, array: np.ndarray, size: int) -> None:
        memory[place][:size] = array.reshape(-1).view(np.uint8)

    def copy_out(array: np.ndarray, place: int, size: int) -> None:
        array.reshape(-1).view(np.uint8)[:] = memory[place][:size]

    functions: dict[str, Callable[..., Any]] = {
        "cuInit": lambda flags: None,
        "cuDeviceGet": lambda ordinal: ordinal,
        "cuDevicePrimaryCtxRetain": lambda device: "context",
        "cuCtxPushCurrent": lambda context: None,
        "cuCtxPopCurrent": lambda: "context",
        "cuCtxSynchronize": lambda: None,
        "cuModuleLoadData": load,
        "cuModuleGetFunction": lambda module, name: _Kernel(module[0], module[1], name.decode()),
        "cuMemAlloc": allocate,
        "cuMemFree": memory.pop,
        "cuMemcpyHtoD": copy_in,
        "cuMemcpyDtoH": copy_out,
        "cuLaunchKernel": launch,
    }

    def answering(name: str) -> Callable[..., Any]:
        def called(*arguments: Any) -> tuple[Any, ...]:
            calls.append(name)
            answer = functions[name](*arguments)
            return (done,) if answer is None else (done, answer)

        return called

    names = {name: answering(name) for name in functions}
    return SimpleNamespace(CUresult=SimpleNamespace(CUDA_SUCCESS=done), calls=calls, **names)
