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

CHOICE = 1
"""Binding of a choice between two expressions, the weakest."""

LOGIC = 2
"""Binding of "and" and "or"."""

COMPARISON = 3
"""Binding of a comparison."""

SUM = 4
"""Binding of a sum or a difference."""

PRODUCT = 5
"""Binding of a product, a quotient or a remainder."""

NEGATIVE = 6
"""Binding of a sign."""

ATOM = 7
"""Binding of a name, a number or a call, the strongest."""

LONGEST = 72
"""Largest number of characters of an expression that may stand within another one."""

_SUMS = {"fadd": "+", "fsub": "-", "add": "+", "sub": "-"}
"""Signs of sums and differences, by the name of LLVM's instruction."""

_PRODUCTS = {"fmul": "*", "fdiv": "/", "mul": "*"}
"""Signs of products and quotients, by the name of LLVM's instruction."""


@dataclass(frozen=True)
class Expression:
    """Text of an expression.

    Attributes:
        text: The text.
        binding: How strongly its outermost operator binds, from `CHOICE` to `ATOM`.
        operator: That operator; empty for none.
    """

    text: str
    binding: int = ATOM
    operator: str = ""

    def within(self, binding: int, operator: str = "", *, right: bool = False) -> str:
        """Return the text as an operand, in parentheses where it needs them.

        Args:
            binding: Binding of the operator whose operand it is.
            operator: That operator.
            right: Whether it is the right operand, which needs parentheses where the left one does
                not: a - (b - c). A sign on the right gets them too, as in a - (-b).
        """
        binds_more = self.binding > binding and not (right and self.binding == NEGATIVE)
        # a - b - c is (a - b) - c; "and" beside "or" is not left to the precedence of a language.
        is_mixed = binding in (LOGIC, COMPARISON) and self.operator != operator
        is_left_of_same = self.binding == binding and not right and not is_mixed
        return self.text if binds_more or is_left_of_same else f"({self.text})"


class Language(ABC):
    """What differs from language to language.

    Attributes:
        and_or: Signs of "and" and "or".
        comparison: Signs of comparisons, by the end of the name that LLVM has for them.
        remainder: Sign of the remainder of a division.
    """

    and_or: ClassVar[dict[str, str]]
    comparison: ClassVar[dict[str, str]]
    remainder: ClassVar[str]

    @abstractmethod
    def number(self, value: float) -> str:
        """Return the text of a number that is not negative."""

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
        """Return the text of a number of any sign."""
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
        kind: Type of the local constant that it declares: "real", "integer" or "truth"; empty for a
            variable of the block.
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
        (code,) = function.blocks  # straight code, see `BlockCode`
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
        self._needed = uses(function)
        self._stored = set()
        for instruction in code.instructions:
            if isinstance(instruction, ir.instructions.StoreInstr):
                self._stored.add(self._place(instruction.operands[1]))
        for instruction in code.instructions:
            self._walk_over(instruction)

    def _walk_over(self, instruction: Any) -> None:
        """Print an instruction, or keep its expression until it is needed."""
        if isinstance(instruction, ir.instructions.StoreInstr):
            value, pointer = instruction.operands
            assignment = Assignment(self._reference(pointer), self._of(value).text)
            if self._place(pointer)[0] == "self":
                self.results.append(assignment)
            else:
                self.assignments.append(assignment)
        elif isinstance(instruction.type, ir.VoidType) and instruction.opname == "call":
            self._walk_over_call(instruction)
        elif self._needed[instruction] and not isinstance(instruction, ir.instructions.GEPInstr):
            self._keep(instruction, self._needed[instruction])

    def _walk_over_call(self, instruction: Any) -> None:
        """Print a call without a result: a check, or a routine on arrays of the block."""
        callee, *operands = instruction.operands
        if callee.name == FINITE_CHECK:
            result = self._of(operands[0]).text
            check = self._language.within(result, -LARGEST_RESULT, LARGEST_RESULT)
            self.checks.append(check)
            return
        names = [self._argument[address] for address in operands]
        self.assignments.append(Assignment("", self._language.routine(callee.name, names)))

    def _keep(self, instruction: Any, count: int) -> None:
        """Keep the expression of an instruction that is used `count` times, as a local constant
        unless it is used once and is short.

        What is loaded becomes a constant in any case, since it may be stored before it is used. The
        exceptions are inputs and the like, which nothing stores.
        """
        expression = self._expression(instruction)
        is_loaded = isinstance(instruction, ir.instructions.LoadInstr)
        is_fixed = is_loaded and self._place(instruction.operands[0]) not in self._stored
        is_short = count == 1 and len(expression.text) <= LONGEST
        if (is_fixed and expression.binding == ATOM) or (is_short and not is_loaded):
            self._text[instruction] = expression
            return
        kind = {"double": "real", "i64": "integer", "i1": "truth"}[str(instruction.type)]
        name = self._constant_name(instruction, is_loaded)
        self.assignments.append(Assignment(name, expression.text, kind))
        self._text[instruction] = Expression(name)

    def _constant_name(self, instruction: Any, is_loaded: bool) -> str:
        """Return the name of a local constant: that of the variable of the block that it is loaded
        from, or a number.
        """
        if is_loaded:
            pointer = instruction.operands[0]
            base, index = self._place(pointer)
            if base == "self":
                assert index is not None  # the index of a variable of the block
                return f"{self._block.variables[index].name}_now"
        count_before = sum(bool(assignment.kind) for assignment in self.assignments)
        return f"v{self._numbered_from + count_before + 1}"

    def _of(self, value: Any) -> Expression:
        """Return the expression of an operand."""
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
        """Return the variable or element at an address."""
        name = self._argument[pointer.operands[0]]
        index = pointer.operands[1]
        if name == "self":
            return self._language.variable(self._block.variables[int(index.constant)].name)
        if name == "count":
            return self._language.variable("count")
        return self._language.element(name, self._of(index).text, table=name in self._block.tables)

    def _expression(self, instruction: Any) -> Expression:
        """Return the expression of an instruction.

        Raises:
            ModelError: If it is none that a block can have.
        """
        operation = instruction.opname
        operands = instruction.operands
        if operation == "load":
            return Expression(self._reference(operands[0]))
        if operation == "call":
            intrinsic = instruction.callee.name.split(".")[1]  # such as llvm.sqrt.f64
            return self._call(intrinsic, operands[1:])
        values = [self._of(operand) for operand in operands]
        if operation == "fneg":
            return Expression(f"-{values[0].within(NEGATIVE, right=True)}", NEGATIVE)
        if operation in ("fcmp", "icmp"):
            # The names of LLVM begin with what they say of NaN or signs: olt, slt.
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
        """Return an expression of two operands with a sign between them."""
        left, right = values
        text = f"{left.within(binding, sign)} {sign} {right.within(binding, sign, right=True)}"
        return Expression(text, binding, sign)

    def _call(self, function: str, operands: Any) -> Expression:
        """Return the call of an intrinsic function, such as "sqrt"."""
        values = [self._of(operand) for operand in operands]
        if function == "fmuladd":
            product = self._infix(values[:2], "*", PRODUCT)
            return self._infix([product, values[2]], "+", SUM)
        self.functions.add(function)
        return self._language.call(function, values[0])
