"""Routines in C99: functions with loops on memory, such as those of a predictive controller.

What is computed in every lane of a vector stands in a loop over the lanes. A loop ends where a
number is needed that it computes, and at the next scalar memory access after a store.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from llvmlite import ir

from cranedyn.compiled.code import uses
from cranedyn.compiled.printing import (
    ATOM,
    CHOICE,
    LONGEST,
    SUM,
    Expression,
    Language,
    Walk,
)

_REDUCED = {
    "fadd": ("0.0", "{0} += {1};"),
    "fmax": ("-1e300", "{0} = {1} > {0} ? {1} : {0};"),
    "and": ("true", "{0} = {0} && {1};"),
}
"""First value of a number over all lanes, and statement that adds a lane, by the operation."""

_TYPES = {"double": "real", "i64": "int32_t", "i1": "bool"}


def routines(functions: Iterable[ir.Function], language: Language, name: str) -> list[Routine]:
    """Return the text of functions that are defined, each below those that it calls."""
    tables: dict[str, str] = {}
    defined = [function for function in functions if function.blocks]
    plain = [f for f in defined if isinstance(f.function_type.return_type, ir.VoidType)]
    return [Routine(function, language, name, tables) for function in plain]


class Routine(Walk):
    """Text of a function.

    Attributes:
        lines: Its lines, below those of the constant tables that no routine before it has.
        functions: Names of the functions that they call.
    """

    def __init__(
        self, function: ir.Function, language: Language, name: str, tables: dict[str, str]
    ) -> None:
        self._language, self._prefix, self._tables = language, name, tables
        self._argument = {argument: f"p{i + 1}" for i, argument in enumerate(function.args)}
        self._text, self.functions, self._count = {}, set(), 0
        self._left = uses(function)
        self._needed = dict(self._left)
        self._loop: list[str] = []
        self._computed: list[Any] = []
        self._stores: list[str] = []
        self._lanes, self._depth, self._changed = 0, 1, set[str]()
        before = len(tables)
        self._lines: list[str] = []
        self._sequence(function.entry_basic_block, None)
        names = [self._argument[argument] for argument in function.args]
        arguments = ", ".join(f"{'const ' * (n not in self._changed)}real *{n}" for n in names)
        heading = f"static void {name}_{function.name}({arguments}) {{"
        self.lines = [*list(tables)[before:], heading, *self._lines, "}", ""]

    def _sequence(self, block: Any, end: Any) -> None:
        """Print blocks up to one."""
        while block is not end:
            for instruction in block.instructions[:-1]:
                self._print(instruction)
            self._end_loop()
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
        begin, last = self._of(counter.incomings[0][0]), self._of(compared.operands[1])
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

    def _end_loop(self) -> None:
        """Print the loop over lanes; what is used after it is kept in arrays."""
        kept = [value for value in self._computed if self._left[value]]
        for value in kept:
            name = self._new("a")
            self._loop.append(f"{name}[i] = {self._text[value].text};")
            self._line(f"{_type(value)} {name}[{self._lanes}];")
            self._text[value] = Expression(f"{name}[i]")
        if self._loop:
            self._line(f"for (int32_t i = 0; i < {self._lanes}; i++) {{")
            self._lines += ["  " * (self._depth + 1) + text for text in self._loop]
            self._line("}")
        loop = f"for (int32_t i = 0; i < {self._lanes}; i++)"
        for store in self._stores:
            self._line(f"{loop} {store}")
        self._loop, self._computed, self._stores = [], [], []

    def _print(self, instruction: Any) -> None:
        operation, operands = instruction.opname, instruction.operands
        if operation == "store":
            value, pointer = operands
            lanes, kind = _lanes(value), ""
            if _local(pointer) and pointer not in self._argument:  # the first value of a variable
                self._argument[pointer], kind = self._new("s"), "real "
                if lanes:
                    self._line(f"real {self._argument[pointer]}[{lanes}];")
            if lanes:
                self._lanes, target = lanes, self._at(pointer, "i")
                if not _local(pointer):
                    name = self._new("a")
                    self._line(f"real {name}[{lanes}];")
                    self._stores.append(f"{target} = {name}[i];")
                    target = f"{name}[i]"
                self._loop.append(f"{target} = {self._of(value).text};")
            else:
                self._end_loop()
                whole = "(real)" * (str(value.type) == "i64")
                self._line(f"{kind}{self._at(pointer)} = {whole}{self._of(value).text};")
            self._changed.add(self._address(pointer)[0])
        elif operation == "call" and str(instruction.type) == "void":
            self._end_loop()
            places = list(map(self._address, operands[1:]))
            arguments = ", ".join(" + ".join(filter(None, place)) for place in places)
            self._line(f"{self._prefix}_{instruction.callee.name}({arguments});")
            self._changed |= {name for name, _ in places}
        elif instruction in self._needed and operation not in ("alloca", "getelementptr", "phi"):
            self._name(instruction, self._needed[instruction])

    def _name(self, instruction: Any, count: int) -> None:
        """Keep the expression of an instruction, in a loop over lanes if it is a vector."""
        operation, operands = instruction.opname, instruction.operands
        lanes = _lanes(instruction)
        if "reduce" in str(getattr(getattr(instruction, "callee", None), "name", "")):
            self._reduce(instruction)
            return
        if lanes and lanes != self._lanes:
            self._end_loop()
            self._lanes = lanes
        if operation == "load" and self._stores and not _local(operands[0]):
            self._end_loop()
        expression = self._expression(instruction)
        compound = count > 1 and expression.binding < ATOM
        if operation == "load" or compound or len(expression.text) > LONGEST:
            name = self._new("v")
            line = f"const {_type(instruction)} {name} = {expression.text};"
            self._loop.append(line) if lanes else self._line(line)
            expression = Expression(name)
        self._text[instruction] = expression
        if lanes:
            self._computed.append(instruction)

    def _reduce(self, instruction: Any) -> None:
        """Print the sum, the largest, or the conjunction of the numbers of a vector."""
        first, statement = _REDUCED[instruction.callee.name.split(".")[3]]
        vector, name = instruction.operands[-1], self._new("v")
        self._lanes = _lanes(vector)
        self._loop.append(statement.format(name, self._of(vector).text))
        self._line(f"{_type(instruction)} {name} = {first};")
        self._end_loop()
        self._text[instruction] = Expression(name)

    def _of(self, value: Any) -> Expression:
        if isinstance(value, ir.Instruction):
            self._left[value] -= 1
            return self._text[value]
        if value in self._argument:
            return Expression(self._argument[value])
        if not isinstance(value.type, ir.VectorType):
            return super()._of(value)
        numbers = [float(getattr(x, "constant", x)) for x in value.constant]
        if len({repr(x) for x in numbers}) == 1:
            return super()._of(ir.Constant(ir.DoubleType(), numbers[0]))
        return Expression(f"{self._table('real', list(map(self._language.signed, numbers)))}[i]")

    def _table(self, kind: str, numbers: list[str]) -> str:
        """Return the name of a constant table."""
        text = f" [{len(numbers)}] = {{{', '.join(numbers)}}};"
        for line in self._tables:
            if line.endswith(text[1:]):
                return self._tables[line]
        name = f"{self._prefix}_row_{len(self._tables) + 1}"
        self._tables[f"static const {kind} {name}{text[1:]}"] = name
        return name

    def _address(self, pointer: Any) -> tuple[str, str]:
        """Return what an address is in, and the index there; empty for the first."""
        if isinstance(pointer, ir.GlobalVariable):
            numbers = [str(getattr(x, "constant", x)) for x in pointer.initializer.constant]
            return self._table("int32_t", numbers), ""
        if pointer in self._argument:
            return self._argument[pointer], ""
        base, offset = self._address(pointer.operands[0])
        index = self._of(pointer.operands[1]).within(SUM)
        return base, " + ".join(x for x in (offset, index) if x not in ("", "0"))

    def _at(self, pointer: Any, lane: str = "") -> str:
        base, index = self._address(pointer)
        if _local(pointer):
            return f"{base}[i]" if lane else base
        return f"{base}[{' + '.join(filter(None, (index, lane))) or '0'}]"

    def _expression(self, instruction: Any) -> Expression:
        operation, operands = instruction.opname, instruction.operands
        if operation == "load":
            whole = "(int32_t)" * (str(instruction.type) == "i64")
            return Expression(f"{whole}{self._at(operands[0], 'i' * bool(_lanes(instruction)))}")
        if operation == "extractvalue":
            angle = self._text[operands[0]].text
            function = ("sin", "cos")[instruction.indices[0]]
            self.functions.add(function)
            return Expression(f"{self._prefix}_{function}({angle})")
        if operation == "call" and "." not in instruction.callee.name:  # sine and cosine
            return self._of(operands[1])
        if operation == "shufflevector":
            return self._of(operands[0])
        if operation == "insertelement":
            return self._inserted(*operands)
        if operation == "extractelement":
            vector, index = operands
            if vector in self._computed:
                self._end_loop()
            text = self._of(vector).text
            if not text.endswith("[i]"):
                return Expression(text)  # the same in all lanes
            return Expression(f"{text[:-3]}[{index.constant}]")
        return super()._expression(instruction)

    def _inserted(self, vector: Any, number: Any, index: Any) -> Expression:
        if isinstance(vector, ir.Constant) and "undef" in str(vector):
            return self._of(number)
        values = Expression(f"i == {index.constant}", SUM), self._of(number), self._of(vector)
        return self._language.chosen(*values)

    def _call(self, function: str, operands: Any) -> Expression:
        if function in ("minnum", "maxnum"):
            a, b = (self._of(operand).within(SUM) for operand in operands)
            return Expression(f"{a} {'<' if function == 'minnum' else '>'} {b} ? {a} : {b}", CHOICE)
        return super()._call(function, operands)


def _local(pointer: Any) -> bool:
    """Return whether an address is a variable of the function."""
    return getattr(pointer, "opname", "") == "alloca"


def _lanes(value: Any) -> int:
    """Return the number of lanes of a vector, 0 for a scalar."""
    return value.type.count if isinstance(value.type, ir.VectorType) else 0


def _type(value: Any) -> str:
    kind = value.type.element if isinstance(value.type, ir.VectorType) else value.type
    return _TYPES[str(kind)]
