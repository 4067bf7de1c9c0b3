"""Structured Text as Python runs it: what `structured_text` prints, without a PLC or MATIEC.

It is stricter than a PLC: a square root of a negative number, a quotient by zero and an index
beyond an array stop it, as they stop the tasks of some PLCs.
"""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np

_FUNCTIONS = {"SEL": "_sel", "SQRT": "_sqrt", "ABS": "abs", "SIN": "_sin", "COS": "_cos"}
_WORDS = {
    **{"AND": "and", "OR": "or", "NOT": "not", "MOD": "%", "TRUE": "True", "FALSE": "False"},
    **_FUNCTIONS,
}
_DECLARATION = re.compile(
    r"(\w+) : (?:ARRAY \[0\.\.(\d+)\] OF )?(BOOL|LREAL|DINT)(?: := (.*))?", re.DOTALL
)


class Whole(int):
    """A DINT: its quotients are whole numbers, rounded towards zero."""

    def __add__(self, other: Any) -> Whole:
        return Whole(int(self) + other)

    def __sub__(self, other: Any) -> Whole:
        return Whole(int(self) - other)

    def __mul__(self, other: Any) -> Whole:
        return Whole(int(self) * other)

    def __mod__(self, other: Any) -> Whole:
        return Whole(math.fmod(int(self), other))

    def __truediv__(self, other: Any) -> Whole:  # type: ignore[override]
        return Whole(int(self) / other)


class Real(float):
    """An LREAL: sums and products beyond its range are infinite, a quotient by zero is refused."""

    def __truediv__(self, other: Any) -> Real:
        return Real(float(self) / other)


class InterpretedBlock:
    """A function block in Structured Text; its variables are in `memory`, by name."""

    def __init__(self, text: str) -> None:
        plain = re.sub(r"\(\*.*?\*\)", "", text, flags=re.DOTALL)
        self.memory: dict[str, Any] = {}
        self._kinds: dict[str, type] = {}
        *sections, body = plain.split("END_VAR")
        for section in sections:
            declarations = re.split(r"VAR(?:_INPUT|_OUTPUT)?\n", section)[-1]
            for declaration in filter(str.strip, declarations.split(";")):
                self._declare(declaration.strip())
        lines = ["def body(m):"]
        depth = 1
        for statement in filter(None, map(str.strip, body.splitlines())):
            if statement == "END_FUNCTION_BLOCK":
                break
            depth -= statement in ("ELSE", "END_IF;")
            lines.append("    " * depth + self._python(statement))
            depth += statement == "ELSE" or statement.startswith("IF ")
        names: dict[str, Any] = {"_sqrt": math.sqrt, "_sel": _sel, "Whole": Whole, "Real": Real}
        names |= {"_sin": np.sin, "_cos": np.cos}
        exec("\n".join(lines), names)
        self._body = names["body"]

    def call(self, **inputs: Any) -> None:
        """Run the block with inputs."""
        self.memory.update(inputs)
        self._body(self.memory)

    def _declare(self, declaration: str) -> None:
        match = _DECLARATION.fullmatch(declaration)
        assert match, declaration
        name, last, kind, start = match.groups()
        self._kinds[name] = {"BOOL": bool, "LREAL": Real, "DINT": Whole}[kind]
        make = self._kinds[name]
        if last is None:
            self.memory[name] = make(float(start)) if start and kind != "BOOL" else make(0)
            return
        numbers = [float(x) for x in start.strip("[] \n").split(",")] if start else [0.0]
        size = int(last) + 1
        self.memory[name] = [make(x) for x in (numbers if start else numbers * size)]
        assert len(self.memory[name]) == size

    def _python(self, statement: str) -> str:
        if statement == "ELSE":
            return "else:"
        if statement == "END_IF;":
            return "    pass"
        if statement.startswith("IF "):
            return f"if {self._expression(statement[3:].removesuffix(' THEN'))}:"
        target, value = statement.removesuffix(";").split(" := ")
        kind = self._kinds[target.split("[")[0]].__name__
        return f"{self._expression(target)} = {kind}({self._expression(value)})"

    def _expression(self, text: str) -> str:
        def word(match: re.Match[str]) -> str:
            name = match.group()
            return _WORDS.get(name) or f'm["{name}"]'

        return re.sub(r"\b[A-Za-z_]\w*", word, re.sub(r"(?<![<>])=", "==", text))


def _sel(condition: bool, no: Any, yes: Any) -> Any:
    return yes if condition else no
