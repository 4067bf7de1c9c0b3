"""Routines in C99: functions with loops on memory, such as those of a predictive controller."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from llvmlite import ir

from cranedyn.compiled.code import uses
from cranedyn.compiled.printing import ATOM, LONGEST, SUM, Expression, Language, Walk

_TYPES = {"double": "real", "i64": "int32_t", "i1": "bool"}


def routines(functions: Iterable[ir.Function], language: Language, name: str) -> list[Routine]:
    """Return the text of functions that are defined, each below those that it calls."""
    defined = [function for function in functions if function.blocks]
    plain = [f for f in defined if isinstance(f.function_type.return_type, ir.VoidType)]
    return [Routine(function, language, name) for function in plain]


class Routine(Walk):
    """Text of a function.

    Attributes:
        lines: Its lines.
        functions: Names of the functions that they call.
    """

    def __init__(self, function: ir.Function, language: Language, name: str) -> None:
        self._language = language
        self._prefix = name
        self._argument = {argument: f"p{i + 1}" for i, argument in enumerate(function.args)}
        self._text = {}
        self.functions = set()
        self._count = 0
        self._needed = uses(function)
        self._depth = 1
        self._changed = set[str]()
        self._lines: list[str] = []
        self._sequence(function.entry_basic_block, None)
        names = [self._argument[argument] for argument in function.args]
        arguments = ", ".join(f"{'const ' * (n not in self._changed)}real *{n}" for n in names)
        heading = f"static void {name}_{function.name}({arguments}) {{"
        self.lines = [heading, *self._lines, "}", ""]

    def _sequence(self, block: Any, end: Any) -> None:
        """Print blocks up to one."""
        while block is not end:
            for instruction in block.instructions[:-1]:
                self._print(instruction)
            if isinstance(block.terminator, ir.instructions.Ret):
                return
            targets = block.terminator.operands
            if len(targets) == 1:
                if targets[0] is end:
                    return
                block = self._for(targets[0])
            else:
                condition, body, block = targets
                self._braces(f"if ({self._of(condition).text})", body, block)

    def _for(self, head: Any) -> Any:
        """Print a loop and return the block after it."""
        counter, compared = head.instructions[:2]
        begin = self._of(counter.incomings[0][0])
        last = self._of(compared.operands[1])
        name = self._new("k")
        self._text[counter] = Expression(name)
        heading = f"for (int32_t {name} = {begin.text}; {name} < {last.text}; {name}++)"
        _, body, after = head.terminator.operands
        self._braces(heading, body, head)
        return after

    def _braces(self, heading: str, body: Any, end: Any) -> None:
        self._line(f"{heading} {{")
        self._depth += 1
        self._sequence(body, end)
        self._depth -= 1
        self._line("}")

    def _line(self, text: str) -> None:
        self._lines.append("  " * self._depth + text)

    def _new(self, letter: str) -> str:
        self._count += 1
        return f"{letter}{self._count}"

    def _print(self, instruction: Any) -> None:
        operation, operands = instruction.opname, instruction.operands
        if operation == "store":
            value, pointer = operands
            kind = ""
            if _local(pointer) and pointer not in self._argument:  # the first value of a variable
                self._argument[pointer], kind = self._new("s"), "real "
            whole = "(real)" * (str(value.type) == "i64")
            self._line(f"{kind}{self._at(pointer)} = {whole}{self._of(value).text};")
            self._changed.add(self._address(pointer)[0])
        elif operation == "call" and str(instruction.type) == "void":
            places = list(map(self._address, operands[1:]))
            arguments = ", ".join(" + ".join(filter(None, place)) for place in places)
            self._line(f"{self._prefix}_{instruction.callee.name}({arguments});")
            self._changed |= {name for name, _ in places}
        elif instruction in self._needed and operation not in ("alloca", "getelementptr", "phi"):
            self._name(instruction, self._needed[instruction])

    def _name(self, instruction: Any, count: int) -> None:
        """Keep the expression of an instruction."""
        expression = self._expression(instruction)
        compound = count > 1 and expression.binding < ATOM
        if instruction.opname in ("load", "select") or compound or len(expression.text) > LONGEST:
            name = self._new("v")
            self._line(f"const {_TYPES[str(instruction.type)]} {name} = {expression.text};")
            expression = Expression(name)
        self._text[instruction] = expression

    def _address(self, pointer: Any) -> tuple[str, str]:
        """Return what an address is in, and the index there; empty for the first."""
        if pointer in self._argument:
            return self._argument[pointer], ""
        base, offset = self._address(pointer.operands[0])
        index = self._of(pointer.operands[1]).within(SUM)
        return base, " + ".join(x for x in (offset, index) if x not in ("", "0"))

    def _at(self, pointer: Any) -> str:
        base, index = self._address(pointer)
        return base if _local(pointer) else f"{base}[{index or '0'}]"

    def _expression(self, instruction: Any) -> Expression:
        operation, operands = instruction.opname, instruction.operands
        if operation == "load":
            whole = "(int32_t)" * (str(instruction.type) == "i64")
            return Expression(f"{whole}{self._at(operands[0])}")
        if operation == "extractvalue":
            angle = self._text[operands[0]].text
            function = ("sin", "cos")[instruction.indices[0]]
            self.functions.add(function)
            return Expression(f"{self._prefix}_{function}({angle})")
        if operation == "call" and "." not in instruction.callee.name:  # sine and cosine
            return self._of(operands[1])
        return super()._expression(instruction)


def _local(pointer: Any) -> bool:
    """Return whether an address is a variable of the function."""
    return getattr(pointer, "opname", "") == "alloca"
