"""Routines in C99: functions with loops on memory, such as those of a predictive controller.

LLVM's code of a function is a graph of basic blocks. The loops and conditions of the text are found
again from the form that `Code.loop` and `Code.when` give that graph, and other forms do not occur:

    loop                              condition
        ...                               ...
        branch to head                    branch to body or after
    head:                             body:
        counter = phi                     ...
        branch to body or after           branch to after
    body:                             after:
        ...                               ...
        branch to head
    after:
        ...
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from llvmlite import ir

from cranedyn.compiled.printing import (
    MAX_NESTED_LENGTH,
    Expression,
    ExpressionPrinter,
    Language,
    Precedence,
)

_TYPES = {"double": "real", "i64": "int32_t", "i1": "bool"}
"""Types of C by those of LLVM."""

_WITHOUT_EXPRESSION = ("alloca", "getelementptr", "phi")
"""Instructions that are printed where they are used: as a variable, an element, or a counter."""


def routines(functions: Iterable[ir.Function], language: Language, name: str) -> list[Routine]:
    """Return the texts of functions of a module, each below those that it calls.

    Functions without statements, such as intrinsics, have no text, and neither have those that
    return something: sine and cosine together, for which the text in C has functions of its own.

    Args:
        functions: The functions, each below those that it calls.
        language: The language.
        name: Name of the block, which stands before the names of functions.
    """
    texts = []
    for function in functions:
        returns_nothing = isinstance(function.function_type.return_type, ir.VoidType)
        if function.blocks and returns_nothing:
            texts.append(Routine(function, language, name))
    return texts


class Routine(ExpressionPrinter):
    """Text of a function with loops and conditions, whose arguments are arrays.

    Arguments are called p1, p2 and so on, local variables s, constants v and counters of loops k,
    with a number each.

    Attributes:
        lines: Its lines.
    """

    def __init__(self, function: ir.Function, language: Language, block_name: str) -> None:
        """Print a function.

        Args:
            function: The function.
            language: The language.
            block_name: Name of the block, which stands before the names of functions.
        """
        super().__init__(function, language)
        self._block_name = block_name
        # Names of arguments, and of local variables from their first value on, by their addresses.
        self._array_names = {argument: f"p{i + 1}" for i, argument in enumerate(function.args)}
        self._changed_arrays = set[str]()
        self._name_count = 0
        self._body: list[str] = []
        self._depth = 1
        self._print_blocks(function.entry_basic_block, None)

        arguments = []
        for argument in function.args:
            argument_name = self._array_names[argument]
            qualifier = "" if argument_name in self._changed_arrays else "const "
            arguments.append(f"{qualifier}real *{argument_name}")
        heading = f"static void {block_name}_{function.name}({', '.join(arguments)}) {{"
        self.lines = [heading, *self._body, "}", ""]

    def _print_blocks(self, block: Any, last: Any) -> None:
        """Print the code of the basic blocks from one up to, and not including, the last; None for
        all up to the end of the function.
        """
        while block is not last:
            for instruction in block.instructions[:-1]:
                self._print(instruction)
            if isinstance(block.terminator, ir.instructions.Ret):
                return
            targets = block.terminator.operands
            if len(targets) == 1:
                # A branch without condition leads to the head of a loop, or out of the statements
                # in braces: back to the head of their loop, or behind their condition.
                if targets[0] is last:
                    return
                block = self._print_loop(targets[0])
            else:
                condition, body, block = targets
                self._print_braces(f"if ({self._operand(condition).text})", body, block)

    def _print_loop(self, head: Any) -> Any:
        """Print a loop, given its first basic block, and return the one after it."""
        counter, comparison = head.instructions[:2]
        begin = self._operand(counter.incomings[0][0])
        last = self._operand(comparison.operands[1])
        name = self._new_name("k")
        self._expressions[counter] = Expression(name)
        heading = f"for (int32_t {name} = {begin.text}; {name} < {last.text}; {name}++)"
        _, body, after = head.terminator.operands
        self._print_braces(heading, body, head)
        return after

    def _print_braces(self, heading: str, body: Any, last: Any) -> None:
        """Print basic blocks up to the last in braces below a heading."""
        self._add_line(f"{heading} {{")
        self._depth += 1
        self._print_blocks(body, last)
        self._depth -= 1
        self._add_line("}")

    def _add_line(self, text: str) -> None:
        """Add a line of the body, indented."""
        self._body.append("  " * self._depth + text)

    def _new_name(self, letter: str) -> str:
        """Return a name that nothing has yet."""
        self._name_count += 1
        return f"{letter}{self._name_count}"

    def _print(self, instruction: Any) -> None:
        """Print an instruction, or keep its expression until it is needed."""
        operation = instruction.opname
        if operation == "store":
            self._print_store(instruction)
        elif operation == "call" and str(instruction.type) == "void":
            self._print_call(instruction)
        elif instruction in self._use_counts and operation not in _WITHOUT_EXPRESSION:
            self._keep(instruction, self._use_counts[instruction])

    def _print_store(self, instruction: Any) -> None:
        """Print an assignment to an element of an array, or to a local variable, which its first
        value declares.
        """
        value, pointer = instruction.operands
        declaration = ""
        if _is_local(pointer) and pointer not in self._array_names:
            self._array_names[pointer] = self._new_name("s")
            declaration = "real "
        # Whole numbers are kept among real ones.
        cast = "(real)" if str(value.type) == "i64" else ""
        self._add_line(f"{declaration}{self._at(pointer)} = {cast}{self._operand(value).text};")
        self._changed_arrays.add(self._address(pointer)[0])

    def _print_call(self, instruction: Any) -> None:
        """Print the call of another routine, which may change each array that it is given."""
        arguments = []
        for operand in instruction.operands[1:]:
            base, index = self._address(operand)
            arguments.append(f"{base} + {index}" if index else base)
            self._changed_arrays.add(base)
        self._add_line(f"{self._block_name}_{instruction.callee.name}({', '.join(arguments)});")

    def _keep(self, instruction: Any, count: int) -> None:
        """Keep the expression of an instruction that is used `count` times, as a local constant if
        it is used several times or is long.

        What is loaded becomes a constant in any case, since it may be stored before it is used.
        """
        expression = self._expression(instruction)
        # A name or a number may be written several times; an expression is computed once. A choice
        # reads better in a line of its own.
        compound = count > 1 and expression.precedence < Precedence.ATOM
        is_constant = instruction.opname in ("load", "select") or compound
        if is_constant or len(expression.text) > MAX_NESTED_LENGTH:
            name = self._new_name("v")
            c_type = _TYPES[str(instruction.type)]
            self._add_line(f"const {c_type} {name} = {expression.text};")
            expression = Expression(name)
        self._expressions[instruction] = expression

    def _address(self, pointer: Any) -> tuple[str, str]:
        """Return what an address is in, and the index there; empty for the first."""
        if pointer in self._array_names:
            return self._array_names[pointer], ""
        base, offset = self._address(pointer.operands[0])
        index = self._operand(pointer.operands[1]).as_operand(Precedence.SUM)
        terms = [term for term in (offset, index) if term not in ("", "0")]
        return base, " + ".join(terms)

    def _at(self, pointer: Any) -> str:
        """Return the variable or the element at an address."""
        base, index = self._address(pointer)
        return base if _is_local(pointer) else f"{base}[{index or '0'}]"

    def _load(self, address: Any, kind: str) -> Expression:
        # Whole numbers are kept among real ones.
        cast = "(int32_t)" if kind == "i64" else ""
        return Expression(f"{cast}{self._at(address)}")

    def _expression(self, instruction: Any) -> Expression:
        """Return the expression of an instruction.

        In LLVM a function returns sine and cosine together, see `cranedyn.compiled.angles`, and in
        C they are two functions. So the expression of the call is its angle, and that of one of its
        two results is the sine or the cosine of the angle.

        Raises:
            ModelError: If it is none that a block can have.
        """
        operation = instruction.opname
        operands = instruction.operands
        if operation == "call" and not instruction.callee.name.startswith("llvm."):
            return self._operand(operands[1])
        if operation == "extractvalue":
            angle = self._expressions[operands[0]].text
            function = ("sin", "cos")[instruction.indices[0]]
            self.functions.add(function)
            return Expression(f"{self._block_name}_{function}({angle})")
        return super()._expression(instruction)


def _is_local(pointer: Any) -> bool:
    """Return whether an address is a variable of the function."""
    return getattr(pointer, "opname", "") == "alloca"
