"""Statements of other languages from the code of function blocks: the walk over its instructions,
which C and Structured Text share.

LLVM's code has one instruction for each operation. Its text would be as many statements. Where the
result of an instruction is used once and is short, its expression is therefore put into that of the
instruction that uses it; everything else becomes a local constant.

* `Language`: what differs from language to language.
* `ExpressionPrinter`: expressions of instructions.
* `FunctionPrinter`: the statements of a function of a block, which has no branches.
* `cranedyn.compiled.c_routines.Routine`: functions with loops and conditions, in C only.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, ClassVar

from llvmlite import ir

from cranedyn.compiled.block import FINITE_CHECK, LARGEST_RESULT, FunctionBlock
from cranedyn.compiled.code import uses
from cranedyn.errors import ModelError

MAX_NESTED_LENGTH = 72
"""Largest number of characters of an expression that may stand within another one."""

_SUMS = {"fadd": "+", "fsub": "-", "add": "+", "sub": "-"}
"""Signs of sums and differences, by the name of LLVM's instruction."""

_PRODUCTS = {"fmul": "*", "fdiv": "/", "mul": "*"}
"""Signs of products and quotients, by the name of LLVM's instruction."""


class Precedence(IntEnum):
    """How strongly the outermost operator of an expression binds, from the weakest."""

    CHOICE = 1
    """A choice between two expressions."""

    LOGIC = 2
    """And, or."""

    COMPARISON = 3
    """A comparison."""

    SUM = 4
    """A sum or a difference."""

    PRODUCT = 5
    """A product, a quotient or a remainder."""

    SIGN = 6
    """A minus sign."""

    ATOM = 7
    """No operator: a name, a number or a call."""


@dataclass(frozen=True)
class Expression:
    """Text of an expression.

    Attributes:
        text: The text.
        precedence: How strongly its outermost operator binds.
        operator: That operator; empty for none.
    """

    text: str
    precedence: Precedence = Precedence.ATOM
    operator: str = ""

    def as_operand(self, precedence: Precedence, operator: str = "", *, right: bool = False) -> str:
        """Return the text as an operand of another operator, in parentheses where it needs them.

        Args:
            precedence: How strongly that operator binds.
            operator: That operator.
            right: Whether it is the right operand, which needs parentheses where the left one does
                not: a - (b - c). A sign on the right gets them too, as in a - (-b).
        """
        is_sign_on_right = right and self.precedence == Precedence.SIGN
        binds_more = self.precedence > precedence and not is_sign_on_right
        # (a - b) - c may be written a - b - c. But "and" beside "or", or one comparison within
        # another, is not left to the precedence of a language, which readers do not remember.
        needs_clarity = precedence in (Precedence.LOGIC, Precedence.COMPARISON)
        is_mixed = needs_clarity and self.operator != operator
        is_left_of_equal = self.precedence == precedence and not right and not is_mixed
        return self.text if binds_more or is_left_of_equal else f"({self.text})"


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
        """Return the text of a finite number that is not negative."""

    @abstractmethod
    def variable(self, name: str) -> str:
        """Return a variable of the block."""

    @abstractmethod
    def element(self, name: str, index: str, *, table: bool) -> str:
        """Return an element of an array of the block, or of one of its tables."""

    @abstractmethod
    def where(self, condition: Expression, yes: Expression, no: Expression) -> Expression:
        """Return one expression where a condition holds, and another elsewhere."""

    def routine(self, name: str, arrays: Sequence[str]) -> str:
        """Return the call of a routine on arrays of the block.

        Raises:
            ModelError: If the language has none.
        """
        raise ModelError(f"This language has no routine for {name}: it has no loops; export C.")

    def signed(self, value: float) -> str:
        """Return the text of a finite number of any sign."""
        return f"-{self.number(-value)}" if value < 0.0 else self.number(value)

    @abstractmethod
    def in_range(self, value: str, low: float, high: float) -> str:
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


class ExpressionPrinter:
    """Expressions of the instructions of a function.

    Attributes:
        functions: Names of LLVM's intrinsic functions that they call, such as "sqrt".
    """

    def __init__(self, function: ir.Function, language: Language) -> None:
        """Begin without any expression.

        Args:
            function: The function.
            language: The language.
        """
        self.functions: set[str] = set()
        self._language = language
        # How often each instruction is used, and the expressions of those that were met so far.
        self._use_counts = uses(function)
        self._expressions: dict[Any, Expression] = {}

    def _operand(self, value: Any) -> Expression:
        """Return the expression of an operand: of a constant, or of an instruction before."""
        if not isinstance(value, ir.Constant):
            return self._expressions[value]
        number = value.constant
        if isinstance(number, float):
            text = self._language.number(abs(number))
            return Expression(f"-{text}", Precedence.SIGN) if number < 0.0 else Expression(text)
        return Expression(str(number), Precedence.ATOM if number >= 0 else Precedence.SIGN)

    def _load(self, address: Any, kind: str) -> Expression:
        """Return the variable or element at an address, of one of LLVM's types."""
        raise NotImplementedError

    def _expression(self, instruction: Any) -> Expression:
        """Return the expression of an instruction.

        Raises:
            ModelError: If it is none that a block can have.
        """
        operation = instruction.opname
        operands = instruction.operands
        if operation == "load":
            return self._load(operands[0], str(instruction.type))
        if operation == "call":
            intrinsic = instruction.callee.name.split(".")[1]  # such as llvm.sqrt.f64
            return self._intrinsic(intrinsic, operands[1:])
        values = [self._operand(operand) for operand in operands]
        if operation == "fneg":
            operand = values[0].as_operand(Precedence.SIGN, right=True)
            return Expression(f"-{operand}", Precedence.SIGN)
        if operation in ("fcmp", "icmp"):
            # The names of LLVM begin with what they say of NaN or signs: olt, slt.
            sign = self._language.comparison[instruction.op[-2:]]
            return _infix(values, sign, Precedence.COMPARISON)
        if operation == "select":
            return self._language.where(*values)
        if operation in ("and", "or"):
            return _infix(values, self._language.and_or[operation], Precedence.LOGIC)
        if operation in _SUMS:
            return _infix(values, _SUMS[operation], Precedence.SUM)
        if operation in _PRODUCTS:
            return _infix(values, _PRODUCTS[operation], Precedence.PRODUCT)
        if operation in ("sdiv", "srem"):
            sign = "/" if operation == "sdiv" else self._language.remainder
            return _infix(values, sign, Precedence.PRODUCT)
        raise ModelError(f"A function block cannot be printed: it has the instruction {operation}.")

    def _intrinsic(self, function: str, operands: Any) -> Expression:
        """Return the call of an intrinsic function, such as "sqrt"."""
        values = [self._operand(operand) for operand in operands]
        if function == "fmuladd":
            # a b + c; the language decides how often it is rounded.
            product = _infix(values[:2], "*", Precedence.PRODUCT)
            return _infix([product, values[2]], "+", Precedence.SUM)
        self.functions.add(function)
        return self._language.call(function, values[0])


def _infix(values: Sequence[Expression], sign: str, precedence: Precedence) -> Expression:
    """Return an expression of two operands with a sign between them."""
    left, right = values
    left_text = left.as_operand(precedence, sign)
    right_text = right.as_operand(precedence, sign, right=True)
    return Expression(f"{left_text} {sign} {right_text}", precedence, sign)


class FunctionPrinter(ExpressionPrinter):
    """Statements of one function of a block, which has no branches.

    A call of the function runs the assignments; if all checks hold, the results are stored.

    Attributes:
        assignments: Statements that compute, in order.
        checks: Conditions that every result is a number of possible size.
        results: Statements that store outputs and memory.
    """

    def __init__(
        self,
        block: FunctionBlock,
        function: ir.Function,
        language: Language,
        first_number: int = 1,
    ) -> None:
        """Print a function.

        Args:
            block: The block.
            function: One of its functions.
            language: The language.
            first_number: Number in the name of its first local constant. Two functions whose
                constants stand in the same scope number them one after the other.
        """
        super().__init__(function, language)
        self.assignments: list[Assignment] = []
        self.checks: list[str] = []
        self.results: list[Assignment] = []
        self._block = block
        self._first_number = first_number
        # The arguments of `BlockCode`, by LLVM's value.
        names = ["self", "count", *block.arrays, *block.tables]
        self._argument_names = dict(zip(function.args, names, strict=True))

        (code,) = function.blocks  # straight code, see `BlockCode`
        self._stored_places = set()
        for instruction in code.instructions:
            if isinstance(instruction, ir.instructions.StoreInstr):
                self._stored_places.add(self._place(instruction.operands[1]))
        for instruction in code.instructions:
            self._print(instruction)

    @property
    def constant_count(self) -> int:
        """Number of local constants so far."""
        return sum(bool(assignment.kind) for assignment in self.assignments)

    def _print(self, instruction: Any) -> None:
        """Print an instruction, or keep its expression until it is needed."""
        if isinstance(instruction, ir.instructions.StoreInstr):
            value, address = instruction.operands
            assignment = Assignment(self._reference(address), self._operand(value).text)
            if self._place(address)[0] == "self":
                self.results.append(assignment)
            else:
                self.assignments.append(assignment)
        elif isinstance(instruction.type, ir.VoidType) and instruction.opname == "call":
            self._print_call(instruction)
        elif self._use_counts[instruction] and instruction.opname != "getelementptr":
            self._keep(instruction, self._use_counts[instruction])

    def _print_call(self, instruction: Any) -> None:
        """Print a call without a result: a check, or a routine on arrays of the block."""
        callee, *operands = instruction.operands
        if callee.name == FINITE_CHECK:
            result = self._operand(operands[0]).text
            check = self._language.in_range(result, -LARGEST_RESULT, LARGEST_RESULT)
            self.checks.append(check)
            return
        names = [self._argument_names[address] for address in operands]
        self.assignments.append(Assignment("", self._language.routine(callee.name, names)))

    def _keep(self, instruction: Any, count: int) -> None:
        """Keep the expression of an instruction that is used `count` times, as a local constant
        unless it is used once and is short.

        What is loaded becomes a constant in any case, since it may be stored before it is used. The
        exceptions are inputs and the like, which nothing stores.
        """
        expression = self._expression(instruction)
        is_loaded = isinstance(instruction, ir.instructions.LoadInstr)
        is_fixed = is_loaded and self._place(instruction.operands[0]) not in self._stored_places
        is_short = count == 1 and len(expression.text) <= MAX_NESTED_LENGTH
        is_fixed_atom = is_fixed and expression.precedence == Precedence.ATOM
        if is_fixed_atom or (is_short and not is_loaded):
            self._expressions[instruction] = expression
            return
        kind = {"double": "real", "i64": "integer", "i1": "truth"}[str(instruction.type)]
        name = self._constant_name(instruction, is_loaded)
        self.assignments.append(Assignment(name, expression.text, kind))
        self._expressions[instruction] = Expression(name)

    def _constant_name(self, instruction: Any, is_loaded: bool) -> str:
        """Return the name of a local constant: that of the variable of the block that it is loaded
        from, or a number. `cranedyn.compiled.block.identifiers` keeps variables from these names.
        """
        if is_loaded:
            base, index = self._place(instruction.operands[0])
            if base == "self":
                assert index is not None  # the index of a variable of the block
                return f"{self._block.variables[index].name}_now"
        return f"v{self._first_number + self.constant_count}"

    def _place(self, address: Any) -> tuple[str, int | None]:
        """Return what an address is in: the name of an argument, and the index in "self"."""
        name = self._argument_names[address.operands[0]]
        index = address.operands[1]
        return name, int(index.constant) if name == "self" else None

    def _load(self, address: Any, kind: str) -> Expression:
        return Expression(self._reference(address))

    def _reference(self, address: Any) -> str:
        """Return the variable or element at an address."""
        name = self._argument_names[address.operands[0]]
        index = address.operands[1]
        if name == "self":
            return self._language.variable(self._block.variables[int(index.constant)].name)
        if name == "count":
            return self._language.variable("count")
        table = name in self._block.tables
        return self._language.element(name, self._operand(index).text, table=table)
