"""Statements of other languages from the code of function blocks: the walk over its instructions,
which C and Structured Text share.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from llvmlite import ir

from cranedyn.compiled.block import FINITE_CHECK, LARGEST_RESULT, FunctionBlock
from cranedyn.compiled.code import uses
from cranedyn.errors import ModelError

ATOM, NEGATIVE, PRODUCT, SUM, COMPARISON, LOGIC, CHOICE = range(7, 0, -1)
"""How strongly an expression binds, from a name to a choice."""

LONGEST = 72
"""Characters of an expression that may stand within another one."""

_SUMS = {"fadd": "+", "fsub": "-", "add": "+", "sub": "-"}
_PRODUCTS = {"fmul": "*", "fdiv": "/", "mul": "*"}


@dataclass(frozen=True)
class Expression:
    """Text of an expression.

    Attributes:
        text: The text.
        binding: How strongly its outermost operator binds.
        operator: That operator; empty for none.
    """

    text: str
    binding: int = ATOM
    operator: str = ""

    def within(self, binding: int, operator: str = "", *, right: bool = False) -> str:
        """Return the text as an operand, in parentheses where it needs them."""
        same = self.binding == binding and not right
        mixed = binding in (LOGIC, COMPARISON) and self.operator != operator
        plain = self.binding > binding and not (right and self.binding == NEGATIVE)
        return self.text if plain or (same and not mixed) else f"({self.text})"


class Language(ABC):
    """What differs from language to language."""

    and_or: ClassVar[dict[str, str]]
    comparison: ClassVar[dict[str, str]]
    remainder: ClassVar[str]

    @abstractmethod
    def number(self, value: float) -> str:
        """Return a number that is not negative."""

    @abstractmethod
    def variable(self, name: str) -> str:
        """Return a variable of the block."""

    @abstractmethod
    def element(self, name: str, index: str, *, table: bool) -> str:
        """Return an element of an array or a table of the block."""

    @abstractmethod
    def chosen(self, condition: Expression, yes: Expression, no: Expression) -> Expression:
        """Return one expression where a condition holds, and another elsewhere."""

    def routine(self, name: str, arrays: Sequence[str]) -> str:
        """Return the call of a routine on arrays of the block.

        Raises:
            ModelError: If the language has none.
        """
        raise ModelError(f"This language has no routine for {name}: it has no loops; export C.")

    def signed(self, value: float) -> str:
        """Return a number of any sign."""
        return f"-{self.number(-value)}" if value < 0.0 else self.number(value)

    @abstractmethod
    def within(self, value: str, low: float, high: float) -> str:
        """Return the condition that a value lies in a range, which NaN fails."""

    @abstractmethod
    def call(self, function: str, operand: Expression) -> Expression:
        """Return a function, named as LLVM's intrinsic, of an expression."""


@dataclass(frozen=True)
class Assignment:
    """Statement that assigns an expression.

    Attributes:
        target: What is assigned to; empty for a call.
        value: The expression.
        kind: Type of a new local constant: "real", "integer" or "truth"; empty for a variable of
            the block.
    """

    target: str
    value: str
    kind: str = ""


class Walk:
    """The walk over one function of a block.

    A call of the function runs the assignments; if all checks hold, the results are stored.

    Attributes:
        assignments: Statements that compute, in order.
        checks: Conditions that every result is a number of possible size.
        results: Statements that store outputs and memory.
        functions: Names of the functions that they call.
    """

    def __init__(
        self,
        block: FunctionBlock,
        function: ir.Function,
        language: Language,
        numbered_from: int = 0,
    ) -> None:
        """Walk over a function.

        Args:
            block: The block.
            function: One of its functions.
            language: The language.
            numbered_from: Number of local constants that have names already, of another walk whose
                constants stand in the same scope.
        """
        (code,) = function.blocks
        self._numbered_from = numbered_from
        self._block = block
        self._language = language
        names = ["self", "count", *block.arrays, *block.tables]
        self._argument = dict(zip(function.args, names, strict=True))
        self._text: dict[Any, Expression] = {}
        self.assignments: list[Assignment] = []
        self.checks: list[str] = []
        self.results: list[Assignment] = []
        self.functions: set[str] = set()
        stores = [i for i in code.instructions if isinstance(i, ir.instructions.StoreInstr)]
        self._stored = {self._place(store.operands[1]) for store in stores}
        needed = uses(function)
        for instruction in code.instructions:
            if isinstance(instruction, ir.instructions.StoreInstr):
                value, pointer = instruction.operands
                assignment = Assignment(self._reference(pointer), self._of(value).text)
                in_block = self._place(pointer)[0] == "self"
                (self.results if in_block else self.assignments).append(assignment)
            elif isinstance(instruction.type, ir.VoidType) and instruction.opname == "call":
                callee, *addresses = instruction.operands
                if callee.name == FINITE_CHECK:
                    result = self._of(addresses[0]).text
                    check = language.within(result, -LARGEST_RESULT, LARGEST_RESULT)
                    self.checks.append(check)
                    continue
                names = [self._argument[address] for address in addresses]
                self.assignments.append(Assignment("", self._language.routine(callee.name, names)))
            elif needed[instruction] and not isinstance(instruction, ir.instructions.GEPInstr):
                self._name(instruction, needed[instruction])

    def _name(self, instruction: Any, count: int) -> None:
        """Keep the expression of an instruction, as a local constant unless it is used once or is
        short.
        """
        expression = self._expression(instruction)
        fixed = isinstance(instruction, ir.instructions.LoadInstr) and (
            self._place(instruction.operands[0]) not in self._stored
        )
        loaded = isinstance(instruction, ir.instructions.LoadInstr)
        short = count == 1 and len(expression.text) <= LONGEST and not loaded
        if not ((fixed and expression.binding == ATOM) or short):
            kind = {"double": "real", "i64": "integer", "i1": "truth"}[str(instruction.type)]
            count_before = sum(bool(assignment.kind) for assignment in self.assignments)
            name = f"v{self._numbered_from + count_before + 1}"
            if loaded and self._place(instruction.operands[0])[0] == "self":
                place = instruction.operands[0].operands[1].constant
                name = f"{self._block.variables[place].name}_now"
            self.assignments.append(Assignment(name, expression.text, kind))
            expression = Expression(name)
        self._text[instruction] = expression

    def _of(self, value: Any) -> Expression:
        if not isinstance(value, ir.Constant):
            return self._text[value]
        number = value.constant
        if isinstance(number, float):
            text = self._language.number(abs(number))
            return Expression(f"-{text}", NEGATIVE) if number < 0.0 else Expression(text)
        return Expression(str(number), ATOM if number >= 0 else NEGATIVE)

    def _place(self, pointer: Any) -> tuple[str, int | None]:
        """Return what an address is in: the name of an argument, and the index in "self"."""
        name = self._argument[pointer.operands[0]]
        index = pointer.operands[1]
        return name, int(index.constant) if name == "self" else None

    def _reference(self, pointer: Any) -> str:
        name = self._argument[pointer.operands[0]]
        index = pointer.operands[1]
        if name == "self":
            return self._language.variable(self._block.variables[int(index.constant)].name)
        if name == "count":
            return self._language.variable("count")
        return self._language.element(name, self._of(index).text, table=name in self._block.tables)

    def _expression(self, instruction: Any) -> Expression:
        operation, operands = instruction.opname, instruction.operands
        if operation == "load":
            return Expression(self._reference(operands[0]))
        if operation == "call":
            return self._call(instruction.callee.name.split(".")[1], operands[1:])
        values = [self._of(operand) for operand in operands]
        if operation == "fneg":
            return Expression(f"-{values[0].within(NEGATIVE, right=True)}", NEGATIVE)
        if operation in ("fcmp", "icmp"):
            sign = self._language.comparison[instruction.op[-2:]]
            return self._infix(values, sign, COMPARISON)
        if operation == "select":
            return self._language.chosen(*values)
        if operation in ("and", "or"):
            return self._infix(values, self._language.and_or[operation], LOGIC)
        if operation in _SUMS:
            return self._infix(values, _SUMS[operation], SUM)
        if operation in _PRODUCTS:
            return self._infix(values, _PRODUCTS[operation], PRODUCT)
        if operation in ("sdiv", "srem"):
            sign = "/" if operation == "sdiv" else self._language.remainder
            return self._infix(values, sign, PRODUCT)
        raise ModelError(f"A function block cannot be printed: it has the instruction {operation}.")

    def _infix(self, values: list[Expression], sign: str, binding: int) -> Expression:
        left, right = values
        text = f"{left.within(binding, sign)} {sign} {right.within(binding, sign, right=True)}"
        return Expression(text, binding, sign)

    def _call(self, function: str, operands: Any) -> Expression:
        values = [self._of(operand) for operand in operands]
        if function == "fmuladd":
            product = self._infix(values[:2], "*", PRODUCT)
            return self._infix([product, values[2]], "+", SUM)
        self.functions.add(function)
        return self._language.call(function, values[0])
