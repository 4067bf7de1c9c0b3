"""Parameters of a predictive controller, the layout of its memory, and access to it in code.

The memory of an optimisation, the *work*, is a table of rows of doubles: first the rows that all
stages of the horizon share, then the rows of each stage, see `HorizonShape`. Where several cranes
are optimised at once, each number of the table is one number of each crane, side by side.

A row holds a number for each *variable* of a stage, states and then inputs, and for each of its
further quantities, which are linear functions of the variables. Many operations do the same to each
number of a row, such as all of the interior-point method: one instruction does several of them.

* `HorizonShape` says where each row stands, and `MemoryRows` reads and writes rows in code.
* `Work` is the memory of an optimisation in a function under construction.
* `Programme` has the parameters of a controller, and `MemoryOffsets` says where its plan, its
  memory from one control instant to the next, and the work of its optimisations stand.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir

from cranedyn.compiled.code import DOUBLE, Code, Value, lane_type
from cranedyn.compiled.plant.plant import Plant, Topology, make_plant
from cranedyn.dynamics.scalars import array
from cranedyn.model.layout import Layout

_VECTOR_LENGTH = 8
"""Doubles in the widest vector of a processor and in a line of its cache.

Rows and sections of memory are filled up to whole vectors, so that each begins where one does.
"""


def _whole_vectors(count: int) -> int:
    """Round a number of doubles up to whole vectors."""
    return -(-count // _VECTOR_LENGTH) * _VECTOR_LENGTH


_BOUND_ROWS = (
    "slack",
    "excess",
    "multiplier",
    "excess_multiplier",
    "inverse_multiplier",
    "inverse_excess_multiplier",
    "stiffness",
    "slack_step",
    "excess_step",
    "multiplier_step",
)
"""Quantities of the interior-point method that each bound has, in the order of memory."""


@dataclass(frozen=True)
class HorizonShape:
    """Dimensions of a quadratic programme, and of the code that solves it.

    All lengths and offsets are those of one crane, in doubles. In memory there are `cranes` numbers
    for each.

    Attributes:
        states: Number of states of a stage.
        inputs: Number of its inputs, and of its further bounded quantities.
        stages: Number of stages of the horizon.
        vector_width: Lanes of the vectors in which numbers of one crane are computed together,
            where they do not depend on each other; a power of two; 1 for code without vectors.
        cranes: Number of programmes that are solved at once, one in each lane.
    """

    states: int
    inputs: int
    stages: int
    vector_width: int = 8
    cranes: int = 1

    @property
    def variables(self) -> int:
        """Number of states and inputs together."""
        return self.states + self.inputs

    @property
    def row_length(self) -> int:
        """Length of a row: states, inputs and further quantities, in whole vectors."""
        return _whole_vectors(self.variables + self.inputs)

    @property
    def vector_lanes(self) -> int:
        """Lanes of the widest vectors: several numbers of one crane, or one number of each."""
        return self.vector_width if self.cranes == 1 else self.cranes

    @cached_property
    def shared_rows(self) -> dict[str, int]:
        """Number of rows of each quantity that all stages share, by its name and in the order of
        memory.
        """
        return {
            "weight": self.variables,  # second derivatives of the cost of a stage
            "start": 1,  # state at the start
            "low": 1,  # lower bounds
            "high": 1,  # upper bounds
            "price": 1,  # cost of exceeding each bound by one
            "least_plausible": 1,  # least plausible state
            "most_plausible": 1,  # largest plausible state
            "end": self.states,  # cost-to-go of the state after the last stage
            "end_gradient": 1,  # its gradient
            "cost_to_go": self.states,  # that of the stage that the Riccati recursion has reached
            "goal": 1,  # state to reach at the end
            "report": 1,  # see `REPORT`
        }

    @cached_property
    def stage_rows(self) -> dict[str, int]:
        """Number of rows of each quantity of a stage, by its name and in the order of memory.

        The model of a stage is next state = forward @ (state, input) + shift, and its further
        quantities are extra @ (state, input) + extra_shift. All bounded quantities are kept at the
        node of the linearisation, at the iterate, and at the trial point. The rows of `_BOUND_ROWS`
        belong to the upper and to the lower bounds, see `cranedyn.compiled.horizon.interior`.
        """
        rows = {
            "forward": self.states,
            "shift": 1,
            "extra": self.inputs,
            "extra_shift": 1,
            "gradient": 1,  # of the cost
            "total_gradient": 1,  # of cost and bounds, in an iteration
            "barrier_curvature": 1,  # second derivatives of the bounds, in an iteration
            # Results of the Riccati recursion, see `cranedyn.compiled.horizon.riccati`.
            "shift_gradient": 1,
            "feedback": self.inputs,
            "open_loop": 1,
            "node": 1,
            "iterate": 1,
            "trial": 1,
        }
        for side in ("high", "low"):
            for name in _BOUND_ROWS:
                rows[f"{name}_{side}"] = 1
        return rows

    @property
    def size(self) -> int:
        """Length of the memory."""
        return self.first_stage + self.stages * self.stage_size

    @property
    def stage_size(self) -> int:
        """Distance from a stage to the next."""
        return self.row_length * sum(self.stage_rows.values())

    @property
    def first_stage(self) -> int:
        """Offset of the first stage."""
        return self.row_length * sum(self.shared_rows.values())

    @cached_property
    def _first_rows(self) -> dict[str, int]:
        """Number of the first row of each quantity, from the beginning of the shared rows or of
        those of its stage.
        """
        first_rows: dict[str, int] = {}
        for quantities in (self.shared_rows, self.stage_rows):
            next_row = 0
            for name, count in quantities.items():
                first_rows[name] = next_row
                next_row += count
        return first_rows

    def offset(self, name: str, row: int = 0) -> int:
        """Return the offset of a row: of a shared one from the beginning of memory, of another from
        the beginning of its stage.

        Args:
            name: Name of the quantity.
            row: Number of the row among those of the quantity.
        """
        return self.row_length * (self._first_rows[name] + row)


REPORT = ("barrier", "solved", "iterations", "gap", "residual", "excess", "usual_barrier")
"""Numbers at the beginning of the report.

Inputs are `barrier`, the initial barrier, and `usual_barrier`, a constant: the initial barrier
after a successful optimisation. Outputs are `solved`, 1 or 0; `iterations`; `gap`, the mean product
of slacks and multipliers; `residual`, that of the gradient as a share of the initial one; and
`excess`, the largest excess of a bound at the optimum without bounds."""


Constants = Mapping[tuple[str, int, int], float]
"""Numbers that are the same in every stage, by name of the quantity, its row, and place in it.

The code does not load them: as constants they fold, which saves products with 0 and 1.
"""


class LaneView(Code):
    """The same function, with the same builder, for values of another number of lanes."""

    def __init__(self, code: Code, lanes: int) -> None:
        """Make a view.

        Args:
            code: The function under construction.
            lanes: Number of lanes of the values of the view.
        """
        # No call of the constructor of the base class, which would begin a new function.
        self.lanes = lanes
        self.stride = lanes
        self.function = code.function
        self.builder = code.builder
        self.scalar = DOUBLE
        self.type = lane_type(lanes)
        self.argument = code.argument
        self._clear_caches()
        self._align_stack()


def _lane_index(i: int) -> ir.Constant:
    """Return the index of a lane as LLVM takes it."""
    return ir.Constant(ir.IntType(32), i)


class MemoryRows:
    """Access by name to the rows of memory that begin at an address."""

    def __init__(
        self, code: Code, shape: HorizonShape, address: ir.Value, constants: Constants
    ) -> None:
        self._code = code
        self._shape = shape
        self._address = address
        self._constants = constants

    def _at(self, name: str, row: int, i: int) -> int:
        """Return the index in memory of number i of a row, that of the first crane."""
        return self._shape.cranes * (self._shape.offset(name, row) + i)

    def get(self, name: str, row: int = 0, i: int = 0) -> Any:
        """Return a number: a value of the code, or a float where it is the same in every stage."""
        if (name, row, i) in self._constants:
            return self._constants[name, row, i]
        return self._code.load(self._address, self._at(name, row, i))

    def put(self, name: str, value: Any, row: int = 0, i: int = 0) -> None:
        """Store a number."""
        self._code.store(value, self._address, self._at(name, row, i))

    def row(self, name: str, count: int, row: int = 0, first: int = 0) -> np.ndarray:
        """Return numbers of a row from its place `first` on, shape (count,)."""
        return array([self.get(name, row, first + i) for i in range(count)])

    def table(self, name: str, columns: int) -> np.ndarray:
        """Return all rows of a quantity as a matrix, shape (rows, columns)."""
        row_counts = self._shape.shared_rows | self._shape.stage_rows
        return np.array([self.row(name, columns, i) for i in range(row_counts[name])])

    def put_row(self, name: str, values: Any, row: int = 0, first: int = 0) -> None:
        """Store numbers of a row from its place `first` on."""
        for i, value in enumerate(values, first):
            self.put(name, value, row, i)


class StageVector(NamedTuple):
    """Numbers of a stage that are computed together, in the widest vectors.

    Attributes:
        rows: Rows of the stage, from these numbers on.
        shared: Rows that all stages share, from the same numbers on.
        stage: Number of the stage.
        first: Offset of these numbers in a row [doubles].
    """

    rows: MemoryRows
    shared: MemoryRows
    stage: ir.Value
    first: ir.Value


class Work:
    """Memory of optimisations, the argument `work` of a function under construction.

    Attributes:
        code: The function, whose values are one number of each crane.
        wide: The same function with the widest vectors.
        shape: Dimensions of the programme.
        shared: Rows that all stages share.
    """

    def __init__(
        self,
        module: ir.Module,
        name: str,
        shape: HorizonShape,
        constants: Constants | None = None,
        arguments: Sequence[str] = (),
    ) -> None:
        """Begin a function.

        Args:
            module: Module to which the function is added.
            name: Name of the function.
            shape: Dimensions of the programme.
            constants: Numbers that are the same in every stage.
            arguments: Names of the arguments beside `work`.
        """
        self.code = Code(module, name, ["work", *arguments], shape.cranes)
        self.shape = shape
        self.wide = LaneView(self.code, shape.vector_lanes)
        self._constants = constants or {}
        self.shared = self._rows(self.code, self.code.argument["work"])

    def put_report(self, name: str, value: Any) -> None:
        """Store a number of the report, see `REPORT`."""
        self.shared.put("report", value, i=REPORT.index(name))

    def reported(self, name: str) -> Value:
        """Return a number of the report, see `REPORT`."""
        return self.shared.get("report", i=REPORT.index(name))

    def stage(self, k: ir.Value) -> MemoryRows:
        """Return the rows of a stage."""
        return self._rows(self.code, self._stage_address(k))

    @contextmanager
    def stages_backward(self) -> Iterator[MemoryRows]:
        """Emit statements for each stage from the last to the first; yield its rows."""
        last = self.code.integer(self.shape.stages - 1)
        with self.code.loop(0, self.shape.stages) as count:
            yield self.stage(self.code.builder.sub(last, count))

    @contextmanager
    def each_vector(self) -> Iterator[StageVector]:
        """Emit statements for each vector of numbers of each stage."""
        code = self.code
        wide = self.wide
        numbers_in_row = self.shape.row_length * self.shape.cranes
        vectors_in_row = numbers_in_row // wide.lanes
        with code.loop(0, self.shape.stages) as k, code.loop(0, vectors_in_row) as i:
            first = code.product(i, wide.lanes)
            stage = self._stage_address(k)
            rows = self._rows(wide, code.address(stage, first))
            shared = self._rows(wide, code.address(code.argument["work"], first))
            yield StageVector(rows, shared, k, first)

    def call(self, name: str) -> None:
        """Call a function of the module on this memory."""
        code = self.code
        code.builder.call(code.function.module.globals[name], [code.argument["work"]])

    def in_all_lanes(self, value: Value) -> Value:
        """Return one number of each crane as a value of the widest vectors, in all of its lanes."""
        if self.wide.lanes == self.code.lanes:
            return value
        return self.wide.from_double(value.register)

    def join_lanes(self, values: Sequence[Value]) -> Value:
        """Return a value of the widest vectors from the numbers in its lanes."""
        if len(values) == 1:
            return Value(self.wide, values[0].register)
        register = ir.Constant(self.wide.type, ir.Undefined)
        for i, value in enumerate(values):
            index = _lane_index(i)
            register = self.code.builder.insert_element(register, value.register, index)
        return Value(self.wide, register)

    def split_lanes(self, value: Value) -> list[Value]:
        """Return the numbers in the lanes of a value of the widest vectors."""
        code = self.code
        count = self.wide.lanes // self.code.lanes
        if count == 1:
            return [Value(code, value.register)]
        extract = code.builder.extract_element
        return [Value(code, extract(value.register, _lane_index(i))) for i in range(count)]

    def reduce_lanes(self, value: Value, combine: Callable[[Any, Any], Any]) -> Value:
        """Combine the numbers of each crane in a value of the widest vectors, such as to their sum
        or to the largest of them.

        They are combined by pairs, so that few operations have to wait for others; the number of
        lanes is a power of two.
        """
        numbers = self.split_lanes(value)
        while len(numbers) > 1:
            pairs = zip(numbers[::2], numbers[1::2], strict=True)
            numbers = [combine(a, b) for a, b in pairs]
        return numbers[0]

    def _stage_address(self, k: ir.Value) -> ir.Value:
        """Return the address of the rows of a stage."""
        code = self.code
        shape = self.shape
        from_first = code.product(k, shape.stage_size * shape.cranes)
        offset = code.plus(from_first, shape.first_stage * shape.cranes)
        return code.address(code.argument["work"], offset)

    def _rows(self, code: Code, address: ir.Value) -> MemoryRows:
        """Return the rows at an address, read in numbers of `code` or in the widest vectors."""
        # A vector takes numbers from several places of a row, of which only some are constants.
        constants = self._constants if code is self.code else {}
        return MemoryRows(code, self.shape, address, constants)


@dataclass(frozen=True)
class Programme:
    """Parameters of a predictive controller that its code depends on.

    Attributes:
        topology: Topology of its crane model.
        numbers: Parameters of its crane model, see `cranedyn.compiled.plant.plant.plant_numbers`.
        kept: Index of each coordinate of the model among those of the crane that it controls, see
            `cranedyn.model.rigid_rope`.
        left_out: Names of the joints of that crane which the model holds fixed.
        drive: Kind of command, "effort", "motion" or "velocity".
        stages: Number of stages of the horizon.
        stage_length: Length of a stage [s].
        period: Control period [s].
        ratio: Control periods from one optimisation to the next.
        rows: Rows of the path that it tracks, one for each control instant; 0 where it goes to the
            setpoint of each instant.
        disturbance_gain: Share of the error of the disturbance estimate that is corrected at each
            instant.
        swing_gain: Share of the error of the filtered swing that is corrected at each instant.
        rate_gain: Share of the error of the planned rates that is corrected at each instant, for
            velocity commands.
        swing_limit: Largest angle of each swing joint from its rest [rad].
        min_tension: Least tension of the rope [N].
        joint_errors: Errors of the coordinates, then of the rates of each joint with equal weight
            [rad or m, rad/s or m/s], 2 n in all.
        payload_errors: Errors of the payload's position [m] and velocity [m/s] with equal weight.
        leads: Time by which the command of each drive leads [s], for velocity commands; else empty.
        vector_width: Lanes of vectors, see `HorizonShape`.
    """

    topology: Topology
    numbers: tuple[float, ...]
    kept: tuple[int, ...]
    left_out: tuple[str, ...]
    drive: str
    stages: int
    stage_length: float
    period: float
    ratio: int
    rows: int
    disturbance_gain: float
    swing_gain: float
    rate_gain: float
    swing_limit: float
    min_tension: float
    joint_errors: tuple[float, ...]
    payload_errors: tuple[float, ...]
    leads: tuple[float, ...] = ()
    vector_width: int = 8

    @property
    def crane_joints(self) -> int:
        """Number of coordinates of the controlled crane; the model may have fewer."""
        return len(self.kept) + len(self.left_out)

    def shape(self, lanes: int) -> HorizonShape:
        """Return the dimensions of the optimisation for a crane in each lane."""
        layout = self.topology.layout
        return HorizonShape(2 * layout.n, layout.m, self.stages, self.vector_width, lanes)

    def offsets(self, lanes: int) -> MemoryOffsets:
        """Return the offsets of the sections in the memory of a group of lanes."""
        shape = self.shape(lanes)
        numbers_of_lane = lane_memory(self.topology.layout)["begun"].stop
        rows_of_plan = shape.stages + 1
        rows_of_path = max(self.rows, lanes)
        # In the order of `MemoryOffsets`.
        lengths = [
            lanes * (shape.states + 1) + 1,
            2,
            lanes * numbers_of_lane,
            lanes * rows_of_plan * shape.row_length,
            rows_of_path * shape.states,
            lanes * shape.size,
        ]
        offsets = [0]
        for length in lengths:
            offsets.append(offsets[-1] + _whole_vectors(length))
        return MemoryOffsets(*offsets)

    @property
    def plant(self) -> Plant:
        """Model of the crane, commanded by accelerations."""
        return self.driven("motion")

    def driven(self, drive: str) -> Plant:
        """Return the model of the crane, commanded by accelerations, "motion", or efforts,
        "effort".
        """
        return make_plant(self.topology, list(self.numbers), drive, False)

    @property
    def path_rows_per_stage(self) -> int:
        """Rows of the path from one stage to the next; 0 without a path."""
        return round(self.stage_length / self.period) if self.rows else 0


class MemoryOffsets(NamedTuple):
    """Offsets of the sections in the memory of a group of lanes [doubles].

    Attributes:
        query: Input of an optimisation, see `cranedyn.compiled.horizon.planning.emit`: the state
            of each lane and whether it is plausible, and the row of the path.
        counts: Two whole numbers: control instants up to now, and up to the start of the run.
        lanes: Memory of each lane, see `lane_memory`.
        plans: Plan of each lane.
        path: Rows of the path, or the goal of each lane.
        work: Memory of the optimisation.
        size: Length of all sections.
    """

    query: int
    counts: int
    lanes: int
    plans: int
    path: int
    work: int
    size: int


def lane_memory(layout: Layout) -> dict[str, range]:
    """Return the places of what each lane remembers from one control instant to the next, by
    name.
    """
    n = layout.n
    m = layout.m
    lengths = {
        # Planned accelerations of the drives, which hold until the next optimisation.
        "acceleration": m,
        # Estimate of what accelerates the drives besides their efforts.
        "disturbance": m,
        # Rates of the drives that are expected at the next instant.
        "expected_rates": m,
        # Filtered swing of the instant before, coordinates and rates.
        "swing": 2 * (n - m),
        # Last plausible state.
        "reading": 2 * n,
        # Number of implausible readings, and the last of them.
        "refusals": 1,
        "refused_reading": 2 * n,
        # 1 after the first instant.
        "begun": 1,
    }
    places = {}
    first = 0
    for name, length in lengths.items():
        places[name] = range(first, first + length)
        first += length
    return places
