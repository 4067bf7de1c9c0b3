"""What stands where in the memory of one optimisation, and how code gets at it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from llvmlite import ir

from cranedyn.compiled.code import DOUBLE, Code, Value, lane_type

BLOCK = 8
"""Stages that are linearised at once, one in each lane."""


@dataclass(frozen=True)
class HorizonShape:
    """How large a problem is.

    A row of memory holds, one after another, the states of a stage, its inputs, and what else is
    bounded there: a linear function for each input.

    Attributes:
        states: Numbers of a state.
        inputs: Numbers of an input.
        stages: Of the horizon.
    """

    states: int
    inputs: int
    stages: int

    @property
    def both(self) -> int:
        """States and inputs together."""
        return self.states + self.inputs

    @property
    def lanes(self) -> int:
        """Numbers of a row: all that is bounded, in whole vectors."""
        return -(-(self.both + self.inputs) // 8) * 8

    @property
    def entries(self) -> int:
        """Numbers of a stage's model, at most."""
        return 2 * self.states * self.both + self.states + self.inputs * (self.both + 1)

    @property
    def padded(self) -> int:
        """Stages that there is memory for: whole blocks."""
        return -(-self.stages // BLOCK) * BLOCK

    @property
    def common(self) -> dict[str, int]:
        """Rows that all stages share, by name: weights; the first state; bounds and what exceeding
        them costs; least and most that a state can be; cost-to-go of the end and its gradient; room
        for intermediate results; where the path ends; a report, see `REPORT`.
        """
        z, w = self.states, self.both
        return {
            "weight": w,
            "start": 1,
            "low": 1,
            "high": 1,
            "price": 1,
            "least": 1,
            "most": 1,
            "end": z,
            "end_gradient": 1,
            "togo": z,
            "product": w,
            "spill": 1,
            "goal": 1,
            "report": 1,
            "block": -(-BLOCK * self.entries // self.lanes),
        }

    @property
    def stage(self) -> dict[str, int]:
        """Rows of each stage, by name.

        The model: next state = forward @ (state, input) + shift, by rows and by columns, and what
        else is bounded, extra @ (state, input) + apart. The cost's gradient. What is bounded at the
        node about which all is linear, now, and after a step. Feedback. Slacks, multipliers and
        what an iteration keeps of them, above and below.
        """
        z, w, u = self.states, self.both, self.inputs
        sides = ("slack", "excess", "force", "relief", "per_force", "per_relief")
        steps = ("stiff", "bend", "dslack", "dexcess", "dforce")
        return {
            "forward": z,
            "columns": w,
            "shift": 1,
            "extra": u,
            "extra_shift": 1,
            "gradient": 1,
            "slope": 1,
            "curve": 1,
            "carried": 1,
            "feedback": u,
            "open": 1,
            "node": 1,
            "iterate": 1,
            "trial": 1,
            **{f"{name}_{side}": 1 for side in ("high", "low") for name in (*sides, *steps)},
        }

    @property
    def size(self) -> int:
        """Doubles in all."""
        return self.lanes * (sum(self.common.values()) + self.padded * sum(self.stage.values()))

    @property
    def stride(self) -> int:
        """Doubles from a stage to the next."""
        return self.lanes * sum(self.stage.values())

    def place(self, name: str, row: int = 0) -> int:
        """Where a row begins: of the shared ones, or of a stage after the stage's beginning."""
        rows = self.common if name in self.common else self.stage
        before = sum(list(rows.values())[: list(rows).index(name)])
        return self.lanes * (before + row)

    @property
    def first(self) -> int:
        """Where the first stage begins."""
        return self.lanes * sum(self.common.values())


REPORT = ("barrier", "flag", "iterations", "gap", "open", "excess", "first")
"""What stands in the first lanes of the report. Given: the barrier to begin with; last, a constant,
that of an optimisation after one that succeeded. Found: 1 if
solved, 0 if not; iterations; mean product of slacks and multipliers; what is left of the gradient
at the beginning; largest share by which a bound is exceeded without bounds in the way."""


class LaneView(Code):
    """The same function with values of another number of lanes."""

    def __init__(self, code: Code, lanes: int) -> None:
        self.lanes = self.stride = lanes
        self.function, self.builder = code.function, code.builder
        self.type = lane_type(lanes)
        self.argument = code.argument
        self._know_nothing()


class MemoryRows:
    """Rows of memory by name, from a place on."""

    def __init__(self, code: Code, shape: HorizonShape, base: Any) -> None:
        self._code, self._shape, self._base = code, shape, base
        self._one = LaneView(code, 1)

    def at(self, name: str, row: int = 0, lane: int = 0) -> Any:
        """Index of a number."""
        offset = self._shape.place(name, row) + lane
        if isinstance(self._base, int):
            return self._base + offset
        return self._code.builder.add(self._base, self._code.integer(offset))

    def get(self, name: str, row: int = 0) -> Value:
        """A row."""
        return self._code.load(self._code.argument["work"], self.at(name, row))

    def put(self, name: str, value: Any, row: int = 0) -> None:
        """Write a row."""
        self._code.store(value, self._code.argument["work"], self.at(name, row))

    def every(self, name: str, row: int, lane: int) -> Value:
        """One number of a row in all lanes."""
        return self._code.spread(self._code.argument["work"], self.at(name, row, lane))

    def one(self, name: str, row: int, lane: int) -> Value:
        """One number of a row."""
        return self._one.spread(self._code.argument["work"], self.at(name, row, lane))

    def put_one(self, name: str, row: int, lane: int, value: Any) -> None:
        """Write one number of a row."""
        self._one.store(value, self._code.argument["work"], self.at(name, row, lane))


class Work:
    """The whole memory in a function under construction, whose argument `work` it is."""

    def __init__(self, code: Code, shape: HorizonShape) -> None:
        self.code, self.shape, self.common = code, shape, MemoryRows(code, shape, 0)

    def stage(self, k: Any) -> MemoryRows:
        """The rows of a stage."""
        if isinstance(k, int):
            return MemoryRows(self.code, self.shape, self.shape.first + k * self.shape.stride)
        code = self.code
        return MemoryRows(
            code,
            self.shape,
            code.builder.add(code.product(k, self.shape.stride), code.integer(self.shape.first)),
        )


def element(code: Code, value: Value, lane: int) -> Value:
    """One number of a vector."""
    if code.lanes == 1:
        return value
    index = ir.Constant(ir.IntType(32), lane)
    return Value(LaneView(code, 1), code.builder.extract_element(value.register, index))


def everywhere(code: Code, value: Value) -> Value:
    """One number in every lane."""
    return code.from_double(value.register)


def with_elements(code: Code, value: Value, elements: Mapping[int, Value]) -> Value:
    """A vector with other numbers in some lanes."""
    register = value.register
    for lane, number in elements.items():
        index = ir.Constant(ir.IntType(32), lane)
        register = code.builder.insert_element(register, number.register, index)
    return Value(code, register)


def over_lanes(code: Code, value: Value, operation: str) -> Value:
    """Sum ("fadd") or largest ("fmax") of the numbers of a vector."""
    kind = value.register.type
    arguments = [value.register]
    if operation == "fadd":
        arguments = [ir.Constant(DOUBLE, -0.0), *arguments]
    name, module = f"llvm.vector.reduce.{operation}.v{code.lanes}f64", code.function.module
    function = module.globals.get(name) or ir.Function(
        module, ir.FunctionType(DOUBLE, [argument.type for argument in arguments]), name
    )
    assert kind == code.type
    return Value(
        LaneView(code, 1),
        code.builder.call(function, arguments, fastmath=("reassoc", "nsz", "contract")),
    )


def unit(code: Code, lane: int) -> Value:
    """1 in one lane, 0 in the others."""
    return constant(code, [float(i == lane) for i in range(code.lanes)])


def constant(code: Code, numbers: list[float]) -> Value:
    """Numbers known now, one for each lane."""
    return Value(code, ir.Constant(code.type, numbers))


def pointer(code: Code, base: ir.Value, offset: Any) -> ir.Value:
    """The address so many doubles after another."""
    index = offset if isinstance(offset, ir.Value) else code.integer(offset)
    return code.builder.gep(base, [index], source_etype=DOUBLE)
