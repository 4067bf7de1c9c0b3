"""A machine that runs PTX on NumPy's arrays, a place of an array a thread, and a driver as NVIDIA's
around it: what a GPU would be told to do is done, and every address that it touches is looked at.

Products and sums that are fused there are rounded twice here.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

BASE, CELLS, GAP = 1 << 60, 1 << 20, 64

_INSTRUCTION = re.compile(r"\t(?:@(!?)(%p\d+) )?\t?([a-z][\w.]*)\s*(.*?);")
_LABEL = re.compile(r"(\$\w+):")

Bits = np.ndarray
"""What is in a register, for each thread, as unsigned numbers of 64 bits."""


def _doubles(f: Callable[..., Any]) -> Callable[..., Bits]:
    return lambda *bits: np.asarray(f(*(b.view(float) for b in bits)), float).view(np.uint64)


def _integers(f: Callable[..., Any]) -> Callable[..., Bits]:
    return lambda *bits: np.asarray(f(*(b.view(np.int64) for b in bits)), np.int64).view(np.uint64)


def _condition(f: Callable[..., Any], kind: type) -> Callable[..., np.ndarray]:
    return lambda *bits: f(*(b.view(kind) for b in bits))


def _unordered(f: Callable[..., Any]) -> Callable[..., Any]:
    return lambda a, b: f(a, b) | np.isnan(a) | np.isnan(b)


_COMPARED = {
    "lt": np.less,
    "le": np.less_equal,
    "gt": np.greater,
    "ge": np.greater_equal,
    "eq": np.equal,
    "ne": np.not_equal,
}

OPERATIONS: dict[str, Callable[..., Any]] = {
    "add.f64": _doubles(np.add),
    "sub.f64": _doubles(np.subtract),
    "mul.f64": _doubles(np.multiply),
    "div.f64": _doubles(np.divide),
    "rcp.f64": _doubles(np.reciprocal),
    "sqrt.f64": _doubles(np.sqrt),
    "fma.f64": _doubles(lambda a, b, c: a * b + c),
    "neg.f64": _doubles(np.negative),
    "abs.f64": _doubles(np.abs),
    "min.f64": _doubles(np.fmin),
    "max.f64": _doubles(np.fmax),
    "cvt.rmi.f64.f64": _doubles(np.floor),
    "cvt.rni.f64.f64": _doubles(np.rint),
    "cvt.f64.s64": lambda a: a.view(np.int64).astype(float).view(np.uint64),
    "add.s64": _integers(np.add),
    "sub.s64": _integers(np.subtract),
    "mul.lo.s64": _integers(np.multiply),
    "mul.wide.u32": _integers(np.multiply),
    "mad.lo.s64": _integers(lambda a, b, c: a * b + c),
    "div.s64": _integers(lambda a, b: np.sign(a) * np.sign(b) * (np.abs(a) // np.abs(b))),
    "div.u32": _integers(np.floor_divide),
    "rem.s64": _integers(np.fmod),
    "rem.u32": _integers(np.fmod),
    "min.s64": _integers(np.minimum),
    "max.s64": _integers(np.maximum),
    "shl.b64": np.left_shift,
    "shr.u64": np.right_shift,
    "shr.s64": _integers(np.right_shift),
    "and.b64": np.bitwise_and,
    "or.b64": np.bitwise_or,
    "and.pred": np.logical_and,
    "or.pred": np.logical_or,
    "not.pred": np.logical_not,
    "selp.f64": lambda a, b, condition: np.where(condition, a, b),
    "selp.b64": lambda a, b, condition: np.where(condition, a, b),
    **dict.fromkeys(
        ("mov.b64", "mov.u32", "mov.pred", "cvt.u64.u32", "cvt.u32.u64", "cvta.to.global.u64"),
        np.array,
    ),
    **{f"setp.{name}.f64": _condition(f, float) for name, f in _COMPARED.items()},
    **{f"setp.{name}u.f64": _condition(_unordered(f), float) for name, f in _COMPARED.items()},
    **{f"setp.{name}.{kind}": _condition(f, np.int64) for name, f in _COMPARED.items() for kind in
       ("s64", "b64")},
}  # fmt: skip
"""What an instruction computes, by its name without the way of rounding."""


class Memory:
    """Cells of eight bytes; those between two allocations belong to nobody."""

    def __init__(self) -> None:
        self.cells, self.free = np.zeros(CELLS, np.uint64), 0
        self.owned = np.zeros(CELLS, bool)

    def allocate(self, size: int) -> int:
        """The address of room for so many bytes."""
        first, self.free = self.free + GAP, self.free + GAP + -(-size // 8)
        self.owned[first : self.free] = True
        return BASE + 8 * first

    def at(self, addresses: Bits) -> np.ndarray:
        """The cells at some addresses, each of which must be somebody's."""
        cells = (addresses - np.uint64(BASE)).view(np.int64) // 8
        assert (addresses % 8 == 0).all() and ((0 <= cells) & (cells < CELLS)).all()
        assert self.owned[cells].all(), "an address that nobody has allocated"
        return cells


def _number(operand: str) -> Any:
    """A constant as bits, and all else as it is."""
    if operand.startswith("0d"):
        return np.full(1, int(operand[2:], 16), np.uint64)
    if re.fullmatch(r"-?\d+", operand):
        return np.full(1, int(operand) % 2**64, np.uint64)
    return operand


class Kernel:
    """An entry of a text of PTX."""

    def __init__(self, text: str, name: str) -> None:
        head, body = text.split(f".entry {name}(", 1)[1].split("\n}", 1)[0].split("\n{", 1)
        self.parameters = head.count(".param")
        self.lines: list[tuple[str, str, str, list[Any]]] = []
        self.labels: dict[str, int] = {}
        for line in body.splitlines():
            if label := _LABEL.match(line):
                self.labels[label[1]] = len(self.lines)
            elif line.strip() and not line.strip().startswith((".reg", "//", ".loc")):
                found = _INSTRUCTION.match(line)
                assert found, line
                inverted, guard, operation, operands = found.groups()
                parts = [_number(operand) for operand in operands.split(", ")]
                self.lines.append((inverted, guard or "", operation, parts))

        self.targets = set(self.labels.values())

    def run(self, memory: Memory, arguments: np.ndarray, blocks: int, block: int) -> None:
        """Run all threads to their ends; those that are behind go first."""
        threads = np.arange(blocks * block, dtype=np.uint64)
        self.memory, self.arguments = memory, arguments
        self.registers: dict[str, np.ndarray] = {
            "%ctaid.x": threads // block,
            "%tid.x": threads % block,
            "%ntid.x": np.full_like(threads, block),
        }
        places = np.zeros(len(threads), int)
        while (alive := places < len(self.lines)).any():
            place = places[alive].min()
            together = places == place
            active = slice(None) if together.all() else np.flatnonzero(together)
            while not self._step(place, places, active):
                place += 1

    def _step(self, place: int, places: np.ndarray, active: Any) -> bool:
        """Do one instruction, and tell whether threads may part after it."""
        inverted, guard, operation, operands = self.lines[place]
        if operation in ("bra", "bra.uni"):
            taken = self.registers[guard][active] ^ bool(inverted) if guard else True
            places[active] = np.where(taken, self.labels[operands[0]], place + 1)
            return True
        assert not guard, "only jumps depend on conditions"
        if operation == "ret":
            places[active] = len(self.lines)
            return True
        self._compute(operation, operands, active)
        # Others may wait behind a label.
        if place + 1 in self.targets:
            places[active] = place + 1
            return True
        return False

    def _compute(self, operation: str, operands: list[Any], active: Any) -> None:
        if operation == "ld.param.b64":
            number = int(operands[1].rstrip("]").rsplit("_", 1)[1])
            return self._write(operands[0], active, self.arguments[number].view(np.uint64))
        if operation in ("ld.global.b64", "st.global.b64"):
            where, value = operands if operation[0] == "s" else operands[::-1]
            base, _, offset = where.strip("[]").partition("+")
            cells = self.memory.at(self._read(base, active) + np.uint64(int(offset or 0)))
            if operation[0] == "s":
                self.memory.cells[cells] = self._read(value, active)
                return None
            return self._write(value, active, self.memory.cells[cells])
        known = operation if operation in OPERATIONS else operation.replace(".rn", "")
        values = [self._read(operand, active) for operand in operands[1:]]
        return self._write(operands[0], active, OPERATIONS[known](*values))

    def _read(self, operand: Any, active: Any) -> np.ndarray:
        return self.registers[operand][active] if isinstance(operand, str) else operand

    def _write(self, register: str, active: Any, values: np.ndarray) -> None:
        if register not in self.registers:
            kind = bool if register.startswith("%p") else np.uint64
            self.registers[register] = np.zeros(len(self.registers["%tid.x"]), kind)
        self.registers[register][active] = values


def driver() -> SimpleNamespace:
    """The functions of `cuda.bindings.driver` that a run needs, for such a machine; `calls` tells
    which were called.
    """
    done = SimpleNamespace(name="CUDA_SUCCESS")
    memory, calls = Memory(), list[str]()

    def launch(kernel: Kernel, *given: Any) -> None:
        values, kinds = given[8]
        assert len(values) == len(kinds) == kernel.parameters
        with np.errstate(all="ignore"):
            kernel.run(memory, np.array(values, np.int64), given[0], given[3])

    def inside(place: int, array: np.ndarray, size: int) -> np.ndarray:
        assert size == array.nbytes and array.itemsize == 8
        cells = memory.at(np.uint64(place) + np.arange(0, size, 8, dtype=np.uint64))
        assert (np.diff(cells) == 1).all()
        return cells

    def brought(place: int, array: np.ndarray, size: int) -> None:
        memory.cells[inside(place, array, size)] = array.reshape(-1).view(np.uint64)

    def taken(array: np.ndarray, place: int, size: int) -> None:
        array.reshape(-1).view(np.uint64)[:] = memory.cells[inside(place, array, size)]

    functions: dict[str, Callable[..., Any]] = {
        "cuInit": lambda flags: None,
        "cuDeviceGet": lambda ordinal: ordinal,
        "cuDevicePrimaryCtxRetain": lambda device: "context",
        "cuCtxPushCurrent": lambda context: None,
        "cuCtxPopCurrent": lambda: "context",
        "cuCtxSynchronize": lambda: None,
        "cuModuleLoadData": lambda image: image.decode(),
        "cuModuleGetFunction": lambda text, name: Kernel(text, name.decode()),
        "cuMemAlloc": memory.allocate,
        "cuMemFree": lambda place: None,
        "cuMemcpyHtoD": brought,
        "cuMemcpyDtoH": taken,
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
