"""Memory layout of one optimisation, and its access in code."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from llvmlite import ir

from cranedyn.compiled.code import DOUBLE, Code, Value, lane_type


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
    """

    states: int
    inputs: int
    stages: int
    block: int = 8

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
        steps = ("stiff", "bend", "dslack", "dexcess", "dforce")
        rows = {"forward": z, "columns": w, "shift": 1, "extra": u, "extra_shift": 1}
        rows |= dict.fromkeys(("gradient", "slope", "curve", "carried"), 1)
        rows |= {"feedback": u, "open": 1, "node": 1, "iterate": 1, "trial": 1}
        bounds = [f"{name}_{side}" for side in ("high", "low") for name in (*sides, *steps)]
        return rows | dict.fromkeys(bounds, 1)

    @property
    def size(self) -> int:
        """Total size [doubles]."""
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


class MemoryRows:
    """Rows of memory by name, relative to a base index."""

    def __init__(self, code: Code, shape: HorizonShape, base: Any, constants: Constants) -> None:
        self._code, self._shape, self._base, self._constants = code, shape, base, constants
        self._one = LaneView(code, 1)

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


class Work:
    """Memory of an optimisation, the argument `work` of a function under construction."""

    def __init__(self, code: Code, shape: HorizonShape, constants: Constants | None = None) -> None:
        self.code, self.shape, self._constants = code, shape, constants or {}
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

    def _rows(self, base: Any) -> MemoryRows:
        return MemoryRows(self.code, self.shape, base, self._constants)


def element(code: Code, value: Value, lane: int) -> Value:
    """Return one number of a vector."""
    if code.lanes == 1:
        return value
    index = ir.Constant(ir.IntType(32), lane)
    return Value(LaneView(code, 1), code.builder.extract_element(value.register, index))


def everywhere(code: Code, value: Value) -> Value:
    """Return one number in every lane."""
    return code.from_double(value.register)


def with_elements(code: Code, value: Value, elements: Mapping[int, Value]) -> Value:
    """Return a vector with other numbers in some lanes."""
    register = value.register
    for lane, number in elements.items():
        index = ir.Constant(ir.IntType(32), lane)
        register = code.builder.insert_element(register, number.register, index)
    return Value(code, register)


def over_lanes(code: Code, value: Value, operation: str) -> Value:
    """Return the sum ("fadd") or maximum ("fmax") of the numbers of a vector."""
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


def constant(code: Code, numbers: list[float]) -> Value:
    """Return constants, one for each lane."""
    return Value(code, ir.Constant(code.type, numbers))
