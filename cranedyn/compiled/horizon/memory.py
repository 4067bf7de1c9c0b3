"""Parameters of a predictive controller, the layout of its memory, and access to it in code."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir

from cranedyn.compiled.code import Code, Value, lane_type
from cranedyn.dynamics.scalars import array
from cranedyn.model.layout import Layout
from cranedyn.plant.plant import Plant, Topology, plant


@dataclass(frozen=True)
class HorizonShape:
    """Dimensions of a problem, and of the code that solves it.

    A row of memory holds the states of a stage, its inputs, and the values of its other bounded
    functions, one linear function for each input. A number of memory is one of each crane.

    Attributes:
        states: Numbers of a state.
        inputs: Numbers of an input.
        stages: Number of stages of the horizon.
        width: Lanes of the vectors in which numbers of one crane are computed together, where they
            do not depend on each other; 1 for code without vectors.
        cranes: Number of problems that are solved at once, one in each lane.
    """

    states: int
    inputs: int
    stages: int
    width: int = 8
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
    def wide(self) -> int:
        """Lanes of the widest vectors: of numbers of one crane, or of one number of each."""
        return self.width if self.cranes == 1 else self.cranes

    @cached_property
    def common(self) -> dict[str, int]:
        """Numbers of rows that all stages share, by name.

        They are weights; the first state; bounds and the price of exceeding them; least and largest
        plausible state; cost-to-go at the end and its gradient; cost-to-go of a stage; the goal;
        and the report, see `REPORT`.
        """
        rows = {"weight": self.both, "start": 1}
        rows |= dict.fromkeys(("low", "high", "price", "least", "most"), 1)
        rows |= {"end": self.states, "end_gradient": 1, "togo": self.states}
        return rows | {"goal": 1, "report": 1}

    @cached_property
    def stage(self) -> dict[str, int]:
        """Numbers of rows of each stage, by name.

        The model is next state = forward @ (state, input) + shift, and the other bounded values are
        extra @ (state, input) + extra_shift. The others are the gradient of the cost; bounded
        values at the node of linearisation, at the iterate, and at the trial point; feedback; and
        slacks, multipliers and terms of an iteration for the upper and lower bounds.
        """
        sides = ("slack", "excess", "force", "relief", "per_force", "per_relief")
        steps = ("stiff", "dslack", "dexcess", "dforce")
        rows = {"forward": self.states, "shift": 1, "extra": self.inputs, "extra_shift": 1}
        rows |= dict.fromkeys(("gradient", "slope", "curve", "carried"), 1)
        rows |= {"feedback": self.inputs, "open": 1, "node": 1, "iterate": 1, "trial": 1}
        bounds = [f"{name}_{side}" for side in ("high", "low") for name in (*sides, *steps)]
        return rows | dict.fromkeys(bounds, 1)

    @property
    def size(self) -> int:
        """Total size of the memory of one crane [doubles]."""
        return self.first + self.stages * self.stride

    @property
    def stride(self) -> int:
        """Distance from a stage to the next [doubles]."""
        return self.lanes * sum(self.stage.values())

    @property
    def first(self) -> int:
        """Offset of the first stage."""
        return self.lanes * sum(self.common.values())

    @cached_property
    def _offsets(self) -> dict[str, int]:
        ends: dict[str, int] = {}
        for rows in (self.common, self.stage):
            last = np.cumsum(list(rows.values())).tolist()
            ends |= {name: end - rows[name] for name, end in zip(rows, last, strict=True)}
        return ends

    def place(self, name: str, row: int = 0) -> int:
        """Return the offset of a row: of a shared one from the beginning of memory, of another from
        the beginning of its stage.
        """
        return self.lanes * (self._offsets[name] + row)


REPORT = ("barrier", "flag", "iterations", "gap", "open", "excess", "first")
"""First numbers of the report.

Inputs are barrier, the initial barrier, and first, a constant, the initial barrier after a
successful optimisation. Outputs are flag, 1 if solved, else 0; iterations; gap, the mean product of
slacks and multipliers; open, the residual of the gradient as a share of the initial one; and
excess, the largest excess of a bound at the optimum without bounds."""


Constants = Mapping[tuple[str, int, int], float]
"""Entries that are the same in every stage, by name of the row, its number, and place in it."""


class LaneView(Code):
    """The same function with values of another number of lanes."""

    def __init__(self, code: Code, lanes: int) -> None:
        self.lanes = self.stride = lanes
        self.function = code.function
        self.builder = code.builder
        self.type = lane_type(lanes)
        self.argument = code.argument
        self._clear_caches()
        self._align_stack()


def _index(i: int) -> ir.Constant:
    return ir.Constant(ir.IntType(32), i)


class MemoryRows:
    """Rows of memory by name, from an address on."""

    def __init__(
        self, code: Code, shape: HorizonShape, address: ir.Value, constants: Constants
    ) -> None:
        self._code = code
        self._shape = shape
        self._address = address
        self._constants = constants

    def _at(self, name: str, row: int, i: int) -> int:
        return self._shape.cranes * (self._shape.place(name, row) + i)

    def get(self, name: str, row: int = 0, i: int = 0) -> Any:
        """Return a number; a constant as a float, which folds."""
        if (name, row, i) in self._constants:
            return self._constants[name, row, i]
        return self._code.load(self._address, self._at(name, row, i))

    def put(self, name: str, value: Any, row: int = 0, i: int = 0) -> None:
        """Write a number."""
        self._code.store(value, self._address, self._at(name, row, i))

    def row(self, name: str, count: int, row: int = 0, first: int = 0) -> np.ndarray:
        """Return numbers of a row, shape (count,)."""
        return array([self.get(name, row, first + i) for i in range(count)])

    def table(self, name: str, columns: int) -> np.ndarray:
        """Return the rows of a matrix, shape (rows, columns)."""
        rows = (self._shape.common | self._shape.stage)[name]
        return np.array([self.row(name, columns, i) for i in range(rows)])

    def put_row(self, name: str, values: Any, row: int = 0, first: int = 0) -> None:
        """Write numbers of a row."""
        for i, value in enumerate(values, first):
            self.put(name, value, row, i)


class Vector(NamedTuple):
    """Numbers of a stage that are computed together, in the widest vectors.

    Attributes:
        rows: Rows of the stage, from these numbers on.
        common: Rows that all stages share, from the same numbers on.
        stage: Number of the stage.
        first: Offset of these numbers in a row [doubles].
    """

    rows: MemoryRows
    common: MemoryRows
    stage: ir.Value
    first: ir.Value


class Work:
    """Memory of optimisations, the argument `work` of a function under construction.

    Attributes:
        code: The function, whose values are one number of each crane.
        wide: The same function with the widest vectors.
        shape: Dimensions of the problem.
        common: Rows that all stages share.
    """

    def __init__(
        self,
        module: ir.Module,
        name: str,
        shape: HorizonShape,
        constants: Constants | None = None,
        arguments: Sequence[str] = (),
    ) -> None:
        self.code = Code(module, name, ["work", *arguments], shape.cranes)
        self.shape = shape
        self.wide = LaneView(self.code, shape.wide)
        self._constants = constants or {}
        self.common = self._rows(self.code, self.code.argument["work"])

    def report(self, **values: Any) -> None:
        """Write numbers of the report."""
        for name, value in values.items():
            self.common.put("report", value, i=REPORT.index(name))

    def reported(self, name: str) -> Value:
        """Return a number of the report."""
        return self.common.get("report", i=REPORT.index(name))

    def stage(self, k: ir.Value) -> MemoryRows:
        """Return the rows of a stage."""
        return self._rows(self.code, self._stage_address(k))

    @contextmanager
    def backward(self) -> Iterator[MemoryRows]:
        """Emit statements for each stage from the last to the first; yield its rows."""
        last = self.code.integer(self.shape.stages - 1)
        with self.code.loop(0, self.shape.stages) as count:
            yield self.stage(self.code.builder.sub(last, count))

    @contextmanager
    def each(self) -> Iterator[Vector]:
        """Emit statements for a vector of numbers of each stage after the other."""
        code, wide, shape = self.code, self.wide, self.shape
        length = shape.lanes * shape.cranes
        with code.loop(0, shape.stages) as k, code.loop(0, length // wide.lanes) as i:
            first = code.product(i, wide.lanes)
            addresses = self._stage_address(k), code.argument["work"]
            rows = [self._rows(wide, code.address(base, first)) for base in addresses]
            yield Vector(rows[0], rows[1], k, first)

    def call(self, name: str) -> None:
        """Call a function of the module on this memory."""
        code = self.code
        code.builder.call(code.function.module.globals[name], [code.argument["work"]])

    def repeated(self, value: Value) -> Value:
        """Return a number of each crane, for all numbers of the widest vectors."""
        same = self.wide.lanes == self.code.lanes
        return value if same else self.wide.from_double(value.register)

    def joined(self, values: Sequence[Value]) -> Value:
        """Return one of the widest vectors from its numbers."""
        if len(values) == 1:
            return Value(self.wide, values[0].register)
        register = ir.Constant(self.wide.type, ir.Undefined)
        for i, value in enumerate(values):
            register = self.code.builder.insert_element(register, value.register, _index(i))
        return Value(self.wide, register)

    def split(self, value: Value) -> list[Value]:
        """Return the numbers of one of the widest vectors."""
        code = self.code
        count = self.wide.lanes // self.code.lanes
        if count == 1:
            return [Value(code, value.register)]
        extract = code.builder.extract_element
        return [Value(code, extract(value.register, _index(i))) for i in range(count)]

    def over_numbers(self, value: Value, combined: Callable[[Any, Any], Any]) -> Value:
        """Return the sum or the largest of the numbers of each crane in a vector."""
        numbers = self.split(value)
        while len(numbers) > 1:
            numbers = list(map(combined, numbers[::2], numbers[1::2]))
        return numbers[0]

    def _stage_address(self, k: ir.Value) -> ir.Value:
        code, shape = self.code, self.shape
        offset = code.plus(code.product(k, shape.stride * shape.cranes), shape.first * shape.cranes)
        return code.address(code.argument["work"], offset)

    def _rows(self, code: Code, address: ir.Value) -> MemoryRows:
        constants = self._constants if code is self.code else {}
        return MemoryRows(code, self.shape, address, constants)


@dataclass(frozen=True)
class Programme:
    """Parameters of a predictive controller that its code depends on.

    Attributes:
        topology: Topology of its crane model.
        numbers: Parameters of its crane model, see `cranedyn.plant.plant.numbers`.
        drive: Kind of command, "effort", "motion" or "velocity".
        stages: Number of stages of the horizon.
        length: Length of a stage [s].
        period: Control period [s].
        ratio: Control periods from one optimisation to the next.
        rows: Rows of the path that it tracks; 0 for the present setpoint.
        share: Share of the error of the disturbance estimate that is corrected at each instant.
        swing_share: Share of the error of the filtered swing that is corrected.
        rate_share: Share of the error of planned rates that is corrected, for velocity commands.
        swing: Largest angle of each swing joint from its rest [rad].
        taut: Least tension of the rope [N].
        errors: Errors of coordinates and rates of each joint with equal weight.
        payload_errors: Errors of the payload's position [m] and rate [m/s] with equal weight.
        lead: Lead of the command of each drive [s], for velocity commands; else empty.
        width: Lanes of vectors, see `HorizonShape`.
    """

    topology: Topology
    numbers: tuple[float, ...]
    drive: str
    stages: int
    length: float
    period: float
    ratio: int
    rows: int
    share: float
    swing_share: float
    rate_share: float
    swing: float
    taut: float
    errors: tuple[float, ...]
    payload_errors: tuple[float, ...]
    lead: tuple[float, ...] = ()
    width: int = 8

    def shape(self, lanes: int) -> HorizonShape:
        """Return the dimensions of the optimisation for a crane in each lane."""
        layout = self.topology.layout
        return HorizonShape(2 * layout.n, layout.m, self.stages, self.width, lanes)

    def offsets(self, lanes: int) -> MemoryOffsets:
        """Return the offsets of the sections in the memory of a group of lanes."""
        shape = self.shape(lanes)
        counts = [
            lanes * (shape.states + 1) + 1,
            2,
            lanes * lane_memory(self.topology.layout)["begun"].stop,
            lanes * (shape.stages + 1) * shape.lanes,
            max(self.rows, lanes) * shape.states,
            lanes * shape.size,
        ]
        return MemoryOffsets(0, *np.cumsum([-(-count // 8) * 8 for count in counts]).tolist())

    @property
    def plant(self) -> Plant:
        """Model of the crane, commanded by accelerations."""
        return self.driven("motion")

    def driven(self, drive: str) -> Plant:
        """Return the model of the crane, commanded by accelerations, "motion", or efforts,
        "effort".
        """
        return plant(self.topology, list(self.numbers), drive, False)

    @property
    def hop(self) -> int:
        """Rows of the path from one stage to the next."""
        return round(self.length / self.period) if self.rows else 0


class MemoryOffsets(NamedTuple):
    """Offsets of the sections in the memory of a group of lanes [doubles].

    Attributes:
        query: See `cranedyn.compiled.horizon.planning`.
        counts: Whole numbers: control instants up to now, and up to the start of the run.
        lanes: Memory of each lane, see `lane_memory`.
        plans: Plan of each lane.
        path: Rows of the path, or the goal of each lane.
        work: Memory of the optimisation.
        size: Total size.
    """

    query: int
    counts: int
    lanes: int
    plans: int
    path: int
    work: int
    size: int


def lane_memory(layout: Layout) -> dict[str, range]:
    """Return the slots of each lane's memory by name.

    They are the accelerations held, the estimated disturbances of the drives, the expected rates,
    the filtered swing of the instant before and its rates, the last plausible coordinates and
    rates, the number of implausible readings, the last of these, and 1 after the first instant.
    """
    n, m = layout.n, layout.m
    sizes = {"held": m, "estimate": m, "expected": m, "swing": 2 * (n - m)}
    sizes |= {"read": 2 * n, "refusals": 1, "refused": 2 * n, "begun": 1}
    ends = zip(sizes, np.cumsum(list(sizes.values())).tolist(), strict=True)
    return {name: range(end - sizes[name], end) for name, end in ends}
