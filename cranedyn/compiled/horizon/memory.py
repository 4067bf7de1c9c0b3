"""Memory layout of one optimisation, and its access in code."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial, reduce
from operator import add
from typing import Any

import numpy as np
from llvmlite import ir

from cranedyn.compiled.code import DOUBLE, Code, Value, lane_type
from cranedyn.dynamics.scalars import array


@dataclass(frozen=True)
class HorizonShape:
    """Dimensions of a problem.

    A row of memory holds the states of a stage, its inputs, and the values of its other bounded
    functions, one linear function for each input.

    Attributes:
        states: Numbers of a state.
        inputs: Numbers of an input.
        stages: Number of stages of the horizon.
        block: Number of stages that are linearised at once, one in each lane.
        cranes: Number of problems that are solved at once, one in each lane: each number of memory
            is then one of each crane.
    """

    states: int
    inputs: int
    stages: int
    block: int = 8
    cranes: int = 1

    @property
    def both(self) -> int:
        """States and inputs together."""
        return self.states + self.inputs

    @property
    def lanes(self) -> int:
        """Numbers in a row: all bounded values, in whole vectors."""
        return -(-(self.both + self.inputs) // 8) * 8

    @property
    def entries(self) -> int:
        """Largest number of entries in a stage's model."""
        return 2 * self.states * self.both + self.states + self.inputs * (self.both + 1)

    @property
    def padded(self) -> int:
        """Number of stages in memory: whole blocks."""
        return -(-self.stages // self.block) * self.block

    @property
    def common(self) -> dict[str, int]:
        """Numbers of rows that all stages share, by name.

        They are weights; the first state; bounds and the price of exceeding them; least and largest
        plausible state; cost-to-go at the end and its gradient; space for intermediate results; the
        goal; and the report, see `REPORT`.
        """
        z, w = self.states, self.both
        rows = {"weight": w, "start": 1}
        rows |= dict.fromkeys(("low", "high", "price", "least", "most"), 1)
        rows |= {"end": z, "end_gradient": 1, "togo": z, "product": w, "spill": 1}
        block = -(-self.block * self.entries // self.lanes)
        return rows | {"goal": 1, "report": 1, "block": block}

    @property
    def stage(self) -> dict[str, int]:
        """Numbers of rows of each stage, by name.

        The model is next state = forward @ (state, input) + shift, by rows and by columns, and the
        other bounded values are extra @ (state, input) + extra_shift. The others are the gradient
        of the cost; bounded values at the node of linearisation, at the iterate, and at the trial
        point; feedback; and slacks, multipliers and terms of an iteration for the upper and lower
        bounds.
        """
        z, w, u = self.states, self.both, self.inputs
        sides = ("slack", "excess", "force", "relief", "per_force", "per_relief")
        steps = ("stiff", "dslack", "dexcess", "dforce")
        rows = {"forward": z, "columns": w, "shift": 1, "extra": u, "extra_shift": 1}
        rows |= dict.fromkeys(("gradient", "slope", "curve", "carried"), 1)
        rows |= {"feedback": u, "open": 1, "node": 1, "iterate": 1, "trial": 1}
        bounds = [f"{name}_{side}" for side in ("high", "low") for name in (*sides, *steps)]
        return rows | dict.fromkeys(bounds, 1)

    @property
    def zeros(self) -> dict[tuple[str, int, int], float]:
        """Numbers that are zero since a row is longer than what it holds."""
        rows, z, w = self.common | self.stage, self.states, self.both
        used = dict.fromkeys(("forward", "extra", "gradient", "weight"), range(w))
        used |= dict.fromkeys(("columns", "shift", "start", "end", "togo", "carried"), range(z))
        used["extra_shift"] = range(w, self.lanes)
        places = [(name, i) for name in used for i in range(rows[name])]
        return {
            (*place, lane): 0.0
            for place in places
            for lane in range(self.lanes)
            if lane not in used[place[0]]
        }

    @property
    def size(self) -> int:
        """Total size of the memory of one crane [doubles]."""
        return self.lanes * (sum(self.common.values()) + self.padded * sum(self.stage.values()))

    @property
    def stride(self) -> int:
        """Distance from a stage to the next [doubles]."""
        return self.lanes * sum(self.stage.values())

    def place(self, name: str, row: int = 0) -> int:
        """Return the offset of a row: of a shared one from the beginning of memory, of another from
        the beginning of its stage.
        """
        rows = self.common if name in self.common else self.stage
        before = sum(list(rows.values())[: list(rows).index(name)])
        return self.lanes * (before + row)

    @property
    def first(self) -> int:
        """Offset of the first stage."""
        return self.lanes * sum(self.common.values())


REPORT = ("barrier", "flag", "iterations", "gap", "open", "excess", "first")
"""First lanes of the report.

Inputs are barrier, the initial barrier, and first, a constant, the initial barrier after a
successful optimisation. Outputs are flag, 1 if solved, else 0; iterations; gap, the mean product of
slacks and multipliers; open, the residual of the gradient as a share of the initial one; and
excess, the largest excess of a bound at the optimum without bounds."""


Constants = Mapping[tuple[str, int, int], float]
"""Entries that are the same in every stage, by name of the row, its number, and lane."""


class LaneView(Code):
    """The same function with values of another number of lanes."""

    def __init__(self, code: Code, lanes: int) -> None:
        self.lanes = self.stride = lanes
        self.function, self.builder = code.function, code.builder
        self.type = lane_type(lanes)
        self.argument = code.argument
        self._clear_caches()


class CraneView(LaneView):
    """The same function with values of one number of each crane."""

    def address(self, pointer: ir.Value, index: Any) -> ir.Value:
        """Return the address of a number of the first crane."""
        known = isinstance(index, int)
        return super().address(
            pointer, index * self.lanes if known else self.product(index, self.lanes)
        )


class RowCode(Code):
    """A function for a crane in each lane, in which a row is an array of values.

    Attributes:
        one: The same function with values of one number of each crane.
        lanes: Numbers of a row.
    """

    def __init__(
        self, module: ir.Module, name: str, arguments: list[str], shape: HorizonShape
    ) -> None:
        super().__init__(module, name, arguments, shape.cranes)
        self.one, self.lanes = CraneView(self, shape.cranes), shape.lanes

    def address(self, pointer: ir.Value, index: Any) -> ir.Value:
        """Return the address of a number of the first crane."""
        return self.one.address(pointer, index)

    def row(self, value: Any) -> np.ndarray:
        """Return a row, of one number the same in all places."""
        return value if isinstance(value, np.ndarray) else np.full(self.lanes, value, dtype=object)

    def load(self, pointer: ir.Value, first: Any = 0) -> Any:
        """Load a row from an index."""
        places = [
            first + i if isinstance(first, int) else self.plus(first, i) for i in range(self.lanes)
        ]
        return array([self.one.load(pointer, place) for place in places])

    def store(self, value: Any, pointer: ir.Value, first: Any = 0) -> None:
        """Store a row from an index."""
        for i, number in enumerate(self.row(value)):
            self.one.store(number, pointer, self.plus(first, i))

    def chosen(self, condition: Any, yes: Any, no: Any) -> Any:
        """Return one row in the lanes in which a condition holds and another elsewhere."""
        pairs = zip(self.row(yes), self.row(no), strict=True)
        return array([self.one.chosen(condition, a, b) for a, b in pairs])

    def variables(self, values: Any) -> Any:
        """Return variables for rows."""
        return [RowVariable(self, self.row(value)) for value in values]


class RowVariable:
    """A row on the stack."""

    def __init__(self, code: RowCode, row: np.ndarray) -> None:
        self._code, self._numbers = code, code.one.variables(row.tolist())

    def get(self) -> np.ndarray:
        """Return its value at this point of the code."""
        return array([number.get() for number in self._numbers])

    def set(self, row: Any) -> None:
        """Assign a value."""
        for number, value in zip(self._numbers, self._code.row(row), strict=True):
            number.set(value)


def row_code(module: ir.Module, name: str, arguments: list[str], shape: HorizonShape) -> Any:
    """Begin a function whose values are rows: of one crane a vector, of several an array."""
    if shape.cranes > 1:
        return RowCode(module, name, arguments, shape)
    return Code(module, name, arguments, shape.lanes)


def single(code: Code) -> Any:
    """Return the same function with values of one number of a row."""
    return code.one if isinstance(code, RowCode) else LaneView(code, 1)


class MemoryRows:
    """Rows of memory by name, relative to a base index."""

    def __init__(self, code: Code, shape: HorizonShape, base: Any, constants: Constants) -> None:
        self._code, self._shape, self._base, self._constants = code, shape, base, constants
        self._one = single(code)

    def at(self, name: str, row: int = 0, lane: int = 0) -> Any:
        """Return the index of a number."""
        offset = self._shape.place(name, row) + lane
        if isinstance(self._base, int):
            return self._base + offset
        return self._code.plus(self._base, offset)

    def get(self, name: str, row: int = 0) -> Value:
        """Return a row."""
        return self._code.load(self._code.argument["work"], self.at(name, row))

    def put(self, name: str, value: Any, row: int = 0) -> None:
        """Write a row."""
        self._code.store(value, self._code.argument["work"], self.at(name, row))

    def every(self, name: str, row: int, lane: int) -> Any:
        """Return one number of a row in all lanes; a constant as a float, which folds."""
        if (name, row, lane) in self._constants:
            return self._constants[name, row, lane]
        return self._code.spread(self._code.argument["work"], self.at(name, row, lane))

    def one(self, name: str, row: int, lane: int) -> Value:
        """Return one number of a row."""
        return self._one.spread(self._code.argument["work"], self.at(name, row, lane))

    def put_one(self, name: str, row: int, lane: int, value: Any) -> None:
        """Write one number of a row."""
        self._one.store(value, self._code.argument["work"], self.at(name, row, lane))


class CraneRows(MemoryRows):
    """The same of a crane in each lane; what is written to scratch rows stays in registers."""

    def __init__(self, code: Any, shape: HorizonShape, base: Any, constants: Constants) -> None:
        super().__init__(code, shape, base, constants)
        self._row = code.row
        self._kept: dict[tuple[str, int, int], Any] = {}

    def at(self, name: str, row: int = 0, lane: int = 0) -> Any:
        """Return the index of a number; columns are those of the rows, the cost is symmetric."""
        if name == "columns":
            name, row, lane = "forward", lane, row
        elif name == "togo":
            row, lane = sorted((row, lane))
        return super().at(name, row, lane)

    def one(self, name: str, row: int, lane: int) -> Any:
        """Return one number of a row; a constant as a float."""
        place = name, row, lane
        for known in (self._kept, self._constants):
            if place in known:
                return known[place]
        return self._one.load(self._code.argument["work"], self.at(*place))

    def put_one(self, name: str, row: int, lane: int, value: Any) -> None:
        """Write one number of a row."""
        place = name, row, lane
        if name in ("spill", "product"):
            self._kept[place] = value
        elif place not in self._constants and not (name == "togo" and lane < row):
            self._one.store(value, self._code.argument["work"], self.at(*place))

    def get(self, name: str, row: int = 0) -> Any:
        """Return a row."""
        return array([self.one(name, row, lane) for lane in range(self._shape.lanes)])

    def put(self, name: str, value: Any, row: int = 0) -> None:
        """Write a row."""
        for lane, number in enumerate(self._row(value)):
            self.put_one(name, row, lane, number)

    def every(self, name: str, row: int, lane: int) -> Any:
        """Return one number in all places of a row."""
        return self._row(self.one(name, row, lane))


class Work:
    """Memory of an optimisation, the argument `work` of a function under construction."""

    def __init__(self, code: Code, shape: HorizonShape, constants: Constants | None = None) -> None:
        self.code, self.shape = code, shape
        self._constants = dict(constants or {}) | (shape.zeros if shape.cranes > 1 else {})
        self.common = self._rows(0)

    def report(self, name: str, value: Any) -> None:
        """Write a number of the report."""
        self.common.put_one("report", 0, REPORT.index(name), value)

    def reported(self, name: str) -> Value:
        """Return a number of the report."""
        return self.common.one("report", 0, REPORT.index(name))

    def stage(self, k: Any) -> MemoryRows:
        """Return the rows of a stage."""
        shape, code = self.shape, self.code
        if isinstance(k, int):
            return self._rows(shape.first + k * shape.stride)
        return self._rows(code.plus(code.product(k, shape.stride), shape.first))

    @contextmanager
    def each(self) -> Iterator[Sequence[MemoryRows]]:
        """Emit statements for each number of each stage; yield its rows and the shared ones."""
        with self.code.loop(0, self.shape.stages) as k:
            if not isinstance(self.code, RowCode):
                yield self.stage(k), self.common
                return
            base = self.code.plus(self.code.product(k, self.shape.stride), self.shape.first)
            with self.code.loop(0, self.shape.lanes) as i:
                bases = self.code.builder.add(base, i), i
                yield tuple(MemoryRows(self.code.one, self.shape, at, {}) for at in bases)

    def _rows(self, base: Any) -> MemoryRows:
        kind = CraneRows if self.shape.cranes > 1 else MemoryRows
        return kind(self.code, self.shape, base, self._constants)


def element(code: Any, value: Any, lane: int) -> Any:
    """Return one number of a vector."""
    if isinstance(value, np.ndarray):
        return value[lane]
    if code.lanes == 1:
        return value
    index = ir.Constant(ir.IntType(32), lane)
    return Value(LaneView(code, 1), code.builder.extract_element(value.register, index))


def everywhere(code: Any, value: Any) -> Any:
    """Return one number in every lane."""
    if isinstance(code, CraneView):
        return value
    return code.row(value) if isinstance(code, RowCode) else code.from_double(value.register)


def with_elements(code: Any, value: Any, elements: Mapping[int, Value]) -> Any:
    """Return a vector with other numbers in some lanes."""
    if isinstance(value, np.ndarray):
        return array([elements.get(lane, number) for lane, number in enumerate(value)])
    register = value.register
    for lane, number in elements.items():
        index = ir.Constant(ir.IntType(32), lane)
        register = code.builder.insert_element(register, number.register, index)
    return Value(code, register)


def over_lanes(code: Any, value: Any, operation: str) -> Any:
    """Return the sum ("fadd") or maximum ("fmax") of the numbers of a vector."""
    if isinstance(value, np.ndarray):
        return reduce(add if operation == "fadd" else partial(code.one.call, "llvm.maxnum"), value)
    if code.lanes == 1 or isinstance(code, CraneView):
        return value
    assert value.register.type == code.type
    arguments = [value.register]
    if operation == "fadd":
        arguments = [ir.Constant(DOUBLE, -0.0), *arguments]
    name, module = f"llvm.vector.reduce.{operation}.v{code.lanes}f64", code.function.module
    kind = ir.FunctionType(DOUBLE, [argument.type for argument in arguments])
    function = module.globals.get(name) or ir.Function(module, kind, name)
    flags = ("reassoc", "nsz", "contract")
    return Value(LaneView(code, 1), code.builder.call(function, arguments, fastmath=flags))


def unit(code: Code, lane: int) -> Value:
    """Return 1 in one lane, 0 in the others."""
    return constant(code, [float(i == lane) for i in range(code.lanes)])


def constant(code: Any, numbers: list[float]) -> Any:
    """Return constants, one for each lane."""
    if isinstance(code, RowCode):
        return array(numbers)
    return Value(code, ir.Constant(code.type, numbers))
