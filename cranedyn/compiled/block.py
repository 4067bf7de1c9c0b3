"""Function blocks: a crane or a controller as straight code with named variables, which
`cranedyn.compiled.c_text` and `cranedyn.compiled.structured_text` print.

A block is what IEC 61131-3 calls so: inputs, parameters, outputs and memory with names and units,
and functions that a caller runs in each period. Its code is that of the compiled engine, but
without branches: `BlockCode` is a function of a block under construction, which `FunctionBlock`
keeps once it is complete.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np
from llvmlite import ir

from cranedyn.compiled.code import DOUBLE, INTEGER, Code, Value, uses
from cranedyn.compiled.loop_tables import drop_repeated_rows
from cranedyn.dynamics.scalars import array

Kind = Literal["input", "parameter", "output", "state"]
"""Kind of a variable of a block: inputs may change at each call, parameters rarely do, and a state
is kept in memory from one call to the next."""

KINDS: tuple[Kind, ...] = get_args(Kind)
"""All kinds of variables."""

LARGEST = 1e12
"""Largest magnitude of an input or a parameter; one beyond it is a fault, as NaN is."""

LARGEST_RESULT = 1e30
"""Largest magnitude of a result; one beyond it is a fault, as NaN is.

It lies within single precision, and compilers of Structured Text refuse larger literals.
"""

FAULT = "fault"
"""Name of the function that gives the outputs of a block at fault, see `FunctionBlock`."""

FINITE_CHECK = "check.finite"
"""Name of the call by which the code of a block demands that a result is a number, of at most
`LARGEST_RESULT`. The printers make a fault of one that is not."""

_RESERVED = frozenset(
    "auto break case char const continue default do double else enum extern float for goto if "
    "inline int long register restrict return short signed sizeof static struct switch "
    "typedef union unsigned void volatile while bool true false real self fault reset count "
    "abs acos and any array asin at atan begin by byte configuration constant cos date dint "
    "dt dword exit exp expt function limit lint ln log lreal lword max min mod move mux not "
    "of on or program repeat resource retain sel sin sint sqrt step string tan task then time "
    "tod to trunc type udint uint ulint until usint var with word xor en eno sd ds sl ld st "
    "jmp call ret cal eq ge gt le lt ne add sub mul div date_and_time time_of_day end_case "
    "end_for end_function end_function_block end_if end_repeat end_var end_while f_edge r_edge "
    "function_block var_external var_in_out var_input var_output var_temp".split()
)
"""Words of C and of Structured Text, and names of the printers, which no variable may have."""

_PRINTERS_NAME = re.compile(r"v\d+|.*_now", re.IGNORECASE)
"""Names that the printers give to local constants, which no variable may have either. Structured
Text does not tell capital letters from small ones."""

_MAX_NAME_LENGTH = 40
"""Largest number of characters of an identifier before a number that makes it distinct."""


@dataclass(frozen=True)
class Variable:
    """Variable of a block.

    Attributes:
        name: Name, an identifier.
        kind: Whether it is an input, a parameter, an output or memory.
        unit: Unit; empty for a pure number.
        start: Value after a reset.
        lower: Lower end of its range. Outputs are clipped to the range; an input or a parameter
            beyond it is a fault.
        upper: Upper end of its range.
        about: Description.
    """

    name: str
    kind: Kind
    unit: str = ""
    start: float = 0.0
    lower: float = -np.inf
    upper: float = np.inf
    about: str = ""

    @property
    def allowed(self) -> tuple[float, float]:
        """Smallest and largest value of an input or parameter that is no fault."""
        return max(self.lower, -LARGEST), min(self.upper, LARGEST)

    @staticmethod
    def several(
        names: Sequence[str],
        kind: Kind,
        units: str | Sequence[str],
        start: float | Sequence[float] | np.ndarray = 0.0,
        lower: float | Sequence[float] | np.ndarray = -np.inf,
        upper: float | Sequence[float] | np.ndarray = np.inf,
        *,
        about: str = "",
    ) -> list[Variable]:
        """Return variables of one kind; units and numbers are one for all or one for each.

        Args:
            names: Their names.
            kind: Their kind.
            units: Their units.
            start: Values after a reset.
            lower: Lower ends of their ranges.
            upper: Upper ends of their ranges.
            about: Description of all.
        """
        count = len(names)
        unit_of = [units] * count if isinstance(units, str) else units
        start_of = np.broadcast_to(start, count).tolist()
        lower_of = np.broadcast_to(lower, count).tolist()
        upper_of = np.broadcast_to(upper, count).tolist()
        variables = []
        for i, name in enumerate(names):
            variables.append(
                Variable(name, kind, unit_of[i], start_of[i], lower_of[i], upper_of[i], about)
            )
        return variables


@dataclass(frozen=True, eq=False)
class FunctionBlock:
    """A block.

    A call is a fault if an input or a parameter is out of its range, or if a result is NaN or
    beyond `LARGEST_RESULT`. The block then stays at fault until its reset: its memory and the
    outputs of the call are not stored, and this and every later call give the outputs of the
    function `FAULT` instead, which reads nothing but memory. An output that `FAULT` does not assign
    keeps its last value.

    Attributes:
        name: Name, an identifier.
        about: Sentence that says what it does.
        at_fault: Sentence that says what its outputs do at a fault.
        period: Time from one call of `step` to the next [s].
        variables: Its variables, in the order of memory.
        arrays: Arrays in its memory, by name, with their values after a reset.
        tables: Constant tables by name, row by row.
        last: Largest count of calls since the reset; 0 if calls are not counted.
        first: Count after the largest one. A block that repeats its tables counts in a circle, and
            one whose last row holds stays at the largest count.
        renamed: Identifiers of the signals whose names are no identifiers, by those names.
        functions: Its functions by name; "step" is one, and `FAULT`.
        routines: Functions with loops that they call, on arrays.
    """

    name: str
    about: str
    period: float
    variables: tuple[Variable, ...]
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)
    tables: Mapping[str, np.ndarray] = field(default_factory=dict)
    last: int = 0
    first: int = 0
    renamed: Mapping[str, str] = field(default_factory=dict)
    functions: dict[str, ir.Function] = field(default_factory=dict)
    routines: Sequence[ir.Function] = ()
    at_fault: str = ""

    @property
    def calls(self) -> dict[str, ir.Function]:
        """The functions that a caller runs: all but `FAULT`."""
        return {name: code for name, code in self.functions.items() if name != FAULT}

    def of_kind(self, *kinds: Kind) -> list[Variable]:
        """Return the variables of some kinds; only inputs and parameters that the code uses."""
        loaded = self._loaded_names()
        variables = []
        for variable in self.variables:
            is_used = variable.name in loaded or variable.kind not in ("input", "parameter")
            if variable.kind in kinds and is_used:
                variables.append(variable)
        return variables

    def _loaded_names(self) -> set[str]:
        """Return the names of the variables that its functions load."""
        loaded = set()
        for function in self.functions.values():
            memory_of_block = function.args[0]
            for instruction in uses(function):
                if instruction.opname != "load":
                    continue
                address = instruction.operands[0]
                base, index = address.operands
                if base is memory_of_block:
                    loaded.add(self.variables[int(index.constant)].name)
        return loaded

    def emit(
        self,
        name: str,
        text: Callable[[BlockCode], Mapping[str, Any]],
        copies: Mapping[str, str] | None = None,
    ) -> None:
        """Make a function and add it.

        Outputs are clipped to their ranges. Values are checked before they are clipped, since an
        infinite command means that the block has failed, although a limit would make it finite.

        Args:
            name: Name of the function.
            text: Emits its statements, and returns the values of outputs and memory by name.
            copies: States that keep an output as it was clipped: the name of the output by that of
                the state. It is known only here, after the statements.
        """
        code = BlockCode(self, name)
        values = dict(text(code))
        if name != FAULT:
            for value in values.values():
                code.demand_finite(value)
        for variable in self.of_kind("output"):
            if variable.name in values:
                values[variable.name] = _clipped(code, values[variable.name], variable)
        for memory, output in (copies or {}).items():
            values[memory] = values[output]
        for variable_name, value in values.items():
            code.store(value, code.argument["self"], code.place[variable_name])
        code.end()
        self.functions[name] = code.function


class BlockCode(Code):
    """A function of a block under construction.

    It has no branches, so that every language can print it: sine and cosine, which have some in
    `cranedyn.compiled.angles`, are calls of functions that the language has.

    Attributes:
        block: The block.
        place: Index of each variable in the memory of the block, by its name.
    """

    def __init__(self, block: FunctionBlock, name: str) -> None:
        arguments = ["self", "count", *block.arrays, *block.tables]
        super().__init__(ir.Module(), name, arguments, 1)
        self.block = block
        self.place = {variable.name: i for i, variable in enumerate(block.variables)}

    def get(self, name: str) -> Value:
        """Return a variable of the block as it is at the begin of the call, loaded once."""
        key = ("variable", name)
        if key not in self._results:
            self._results[key] = self.load(self.argument["self"], self.place[name])
        return self._results[key]

    def get_all(self, names: Iterable[str]) -> np.ndarray:
        """Return variables of the block, shape (n,)."""
        return array([self.get(name) for name in names])

    @property
    def count(self) -> ir.Value:
        """Number of calls since the reset, as far as the block counts, see `FunctionBlock.last`."""
        return self.load_one(self.argument["count"], 0, INTEGER)

    def element(self, name: str, index: Any) -> Value:
        """Return an element of an array or a table."""
        return self.load(self.argument[name], index)

    def put(self, name: str, index: Any, value: Any) -> None:
        """Store an element of an array."""
        self.store(value, self.argument[name], index)

    def demand_finite(self, value: Any) -> None:
        """Make it a fault of the block if a value is NaN or beyond `LARGEST_RESULT`."""
        if not isinstance(value, Value):
            return
        module = self.function.module
        kind = ir.FunctionType(ir.VoidType(), [DOUBLE])
        check = module.globals.get(FINITE_CHECK) or ir.Function(module, kind, FINITE_CHECK)
        self.builder.call(check, [value.register])

    def sine_and_cosine(self, angle: Value) -> tuple[Value, Value]:
        """Return sine and cosine of an angle [rad], computed once."""
        if angle.register not in self._angles:
            pair = self.call("llvm.sin", angle), self.call("llvm.cos", angle)
            self._angles[angle.register] = pair
        return self._angles[angle.register]

    def advanced(self, before: Value, by: Any) -> Value:
        """Return the sum."""
        return before + by


class Tables:
    """Tables of a block: columns that do not change are numbers in its code.

    Attributes:
        packed: The other columns by name of the table; a table without such columns has no entry.
        rows: Largest number of rows.
    """

    def __init__(self, **tables: np.ndarray) -> None:
        """Take the tables by name, shape (rows, columns) each."""
        self._first: dict[str, np.ndarray] = {}
        self._varying: dict[str, np.ndarray] = {}
        self.packed: dict[str, np.ndarray] = {}
        self.rows = 0
        for name, table in tables.items():
            shortened = drop_repeated_rows(table)
            varying = np.flatnonzero((shortened != shortened[0]).any(axis=0))
            self._first[name] = shortened[0]
            self._varying[name] = varying
            if len(varying):
                self.packed[name] = shortened[:, varying]
            self.rows = max(self.rows, len(shortened))

    def row(self, code: BlockCode, name: str, index: ir.Value | None = None) -> np.ndarray:
        """Return a row of a table, shape (columns,); beyond the last row the last.

        Args:
            code: The function under construction.
            name: Name of the table.
            index: Number of the row; None for the count of calls.
        """
        values: list[Any] = self._first[name].tolist()
        if name in self.packed:
            rows, width = self.packed[name].shape
            row = code.least(code.count if index is None else index, code.integer(rows - 1))
            first = code.product(row, width)
            for i, column in enumerate(self._varying[name]):
                values[column] = code.element(name, code.plus(first, i))
        return array(values)


def _clipped(code: BlockCode, value: Any, variable: Variable) -> Any:
    """Return the value of an output, clipped to the ends of its range that are finite: no language
    has a literal for infinity.
    """
    if math.isfinite(variable.lower):
        value = code.value(value)
        value = code.where(value < variable.lower, variable.lower, value)
    if math.isfinite(variable.upper):
        value = code.value(value)
        value = code.where(value > variable.upper, variable.upper, value)
    return value


def identifiers(names: Sequence[str]) -> dict[str, str]:
    """Return a distinct identifier of C and Structured Text for each name.

    They differ by more than case, which Structured Text does not distinguish.
    """
    identifier_of: dict[str, str] = {}
    taken: set[str] = set()
    for name in names:
        plain = _identifier(name)
        candidate = plain
        number = 2
        while candidate.lower() in taken:
            candidate = f"{plain}_{number}"
            number = number + 1
        taken.add(candidate.lower())
        identifier_of[name] = candidate
    return identifier_of


def _identifier(name: str) -> str:
    """Return an identifier like a name: Structured Text allows no underscores side by side, at the
    beginning or at the end.
    """
    with_underscores = re.sub(r"[^A-Za-z0-9]", "_", name)
    plain = re.sub(r"_+", "_", with_underscores).strip("_")
    # The cut may leave an underscore at the end.
    plain = plain[:_MAX_NAME_LENGTH].rstrip("_")
    if not plain:
        plain = "joint"
    is_reserved = plain.lower() in _RESERVED or _PRINTERS_NAME.fullmatch(plain) is not None
    if not plain[0].isdigit() and not is_reserved:
        return plain
    distinct = f"the_{plain}"
    while _PRINTERS_NAME.fullmatch(distinct):
        distinct = distinct[: -len("_now")]
    return distinct
