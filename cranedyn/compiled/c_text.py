"""Function blocks in C99: without heap, recursion and library, and with memory of a fixed size."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from string import Template
from typing import ClassVar, Literal

import numpy as np

from cranedyn.compiled.angles import COSINE, HALF_PI, LARGEST_ANGLE, SINE
from cranedyn.compiled.block import KINDS, LARGEST, FunctionBlock, Variable
from cranedyn.compiled.c_routines import routines
from cranedyn.compiled.printing import ATOM, CHOICE, Expression, Language, Walk
from cranedyn.errors import ModelError

Precision = Literal["double", "single"]
"""Type of all numbers: double or float."""

_FUNCTIONS = Path(__file__).with_name("functions.c.in")
_TYPES = {"real": "real", "integer": "int32_t", "truth": "bool"}


class _C(Language):
    and_or: ClassVar = {"and": "&&", "or": "||"}
    comparison: ClassVar = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}
    remainder = "%"

    def __init__(self, name: str, precision: Precision) -> None:
        self.name, self.precision = name, precision

    def number(self, value: float) -> str:
        if self.precision == "double":
            return repr(float(value))
        text = str(np.float32(value))
        return f"{text}F" if "." in text or "e" in text else f"{text}.0F"

    def variable(self, name: str) -> str:
        return f"self->{name}"

    def element(self, name: str, index: str, *, table: bool) -> str:
        return f"{self.name}_{name}[{index}]" if table else f"self->{name}[{index}]"

    def chosen(self, condition: Expression, yes: Expression, no: Expression) -> Expression:
        operands = [part.within(CHOICE, right=True) for part in (condition, yes, no)]
        return Expression("{} ? {} : {}".format(*operands), CHOICE)

    def call(self, function: str, operand: Expression) -> Expression:
        return Expression(f"{self.name}_{function}({operand.text})", ATOM)

    def routine(self, name: str, arrays: Sequence[str]) -> str:
        return f"{self.name}_{name}({', '.join(f'self->{array}' for array in arrays)})"


def c_header(block: FunctionBlock, precision: Precision = "double") -> str:
    """Return the header of a block."""
    name, number = block.name, "double" if precision == "double" else "float"
    lines = [
        f"/* {block.about} */",
        f"#ifndef {name.upper()}_H",
        f"#define {name.upper()}_H",
        "",
        "#include <stdbool.h>",
        "#include <stdint.h>",
        "",
        "typedef struct {",
    ]
    for kind in KINDS:
        if variables := block.of_kind(kind):
            lines.append(f"  /* {kind}s */")
            lines += [f"  {number} {v.name};{_comment(v)}" for v in variables]
    lines += [f"  {number} {array}[{len(v)}];" for array, v in block.arrays.items()]
    lines += ["  int32_t count; /* calls since the reset, up to the last row of its tables */"]
    lines += ["  bool fault; /* an input was not a number; held until the reset */"]
    lines += [f"}} {name};", "", "/* Set parameters and memory to their values at the start. */"]
    lines += [f"void {name}_reset({name} *self);"]
    for function in block.functions:
        when = f", every {block.period:g} s" if function == "step" else ""
        lines += ["", f"/* Compute outputs{' and memory' * bool(when)}{when}; return no fault. */"]
        lines += [f"bool {name}_{function}({name} *self);"]
    return "\n".join([*lines, "", "#endif", ""])


def c_source(block: FunctionBlock, precision: Precision = "double") -> str:
    """Return the source of a block.

    Raises:
        ModelError: If it optimises, which single precision does not allow.
    """
    if block.routines and precision == "single":
        raise ModelError("Predictive control needs double precision: its optimisation would stop.")
    language, name = _C(block.name, precision), block.name
    real = "double" if precision == "double" else "float"
    walks = {key: Walk(block, function, language) for key, function in block.functions.items()}
    below = routines(block.routines, language, name)
    called = set().union(*(text.functions for text in (*walks.values(), *below)))
    lines = [f'#include "{name}.h"', "", f"typedef {real} real;", ""]
    for table, values in block.tables.items():
        lines += [f"static const real {name}_{table}[{values.size}] = {{"]
        lines += _rows([language.signed(x) for x in values.ravel().tolist()])
        lines += ["};", ""]
    lines += _helpers(called, language)
    lines += [line for text in below for line in text.lines]
    lines += [f"void {name}_reset({name} *self) {{"]
    for v in block.of_kind(*KINDS):
        lines.append(f"  self->{v.name} = {language.signed(v.start)};")
    for array, values in block.arrays.items():
        lines.append(f"  for (int32_t i = 0; i < {len(values)}; i++) self->{array}[i] = 0;")
        for i in np.flatnonzero(values).tolist():
            lines.append(f"  self->{array}[{i}] = {language.signed(float(values[i]))};")
    lines += ["  self->count = 0;", "  self->fault = false;", "}", ""]
    for function, walk in walks.items():
        lines += [f"bool {name}_{function}({name} *self) {{", *_fault_check(block, language)]
        for assignment in walk.assignments:
            kind = f"const {_TYPES[assignment.kind]} " if assignment.kind else ""
            target = f"{kind}{assignment.target} = " if assignment.target else ""
            lines.append(f"  {target}{assignment.value};")
        if function == "step" and block.last:
            text = f"self->count < {block.last} ? self->count + 1 : {block.first}"
            lines.append(f"  self->count = {text};")
        lines += ["  return true;", "}", ""]
    return "\n".join(lines)


def _comment(variable: Variable) -> str:
    notes = [f"[{variable.unit}]"] if variable.unit else []
    notes += [variable.about] if variable.about else []
    if math.isfinite(variable.lower) or math.isfinite(variable.upper):
        notes.append(f"{variable.lower:.9g} to {variable.upper:.9g}")
    return f" /* {', '.join(notes)} */" if notes else ""


def _rows(numbers: Sequence[str]) -> list[str]:
    return [f"  {', '.join(numbers[i : i + 6])}," for i in range(0, len(numbers), 6)]


def _fault_check(block: FunctionBlock, language: _C) -> list[str]:
    """Return the statements that find an input which is not a number and then hold the outputs."""
    checks = [f"{block.name}_sound(self->{v.name})" for v in block.of_kind("input")]
    lines = [f"  if (!{check}) self->fault = true;" for check in checks]
    safe = [f"    self->{v.name} = {language.signed(v.start)};" for v in block.of_kind("output")]
    return [*lines, "  if (self->fault) {", *safe, "    return false;", "  }"]


def _helpers(called: set[str], language: _C) -> list[str]:
    """Return the functions that the code calls."""
    number = language.signed
    numbers = {"largest": LARGEST, "quarters": 2.0 / math.pi, "far": LARGEST_ANGLE, "one": 1.0}
    numbers["whole"] = 2.0**52 if language.precision == "double" else 2.0**23
    numbers |= zip(("first", "second", "third"), HALF_PI, strict=True)
    series = {"sine": _horner(SINE, number), "cosine": _horner(COSINE, number)}
    terms = {key: number(value) for key, value in numbers.items()} | series
    texts = Template(_FUNCTIONS.read_text()).substitute(terms, name=language.name).split("\n\n")
    trigonometric = called & {"sin", "cos"}
    needed = called | {"sound"} | ({"rint", "sin"} if trigonometric else set())
    keyed = zip(("sound", "fabs", "rint", "sqrt", "sin"), texts, strict=True)
    return [line for key, text in keyed if key in needed for line in [*text.splitlines(), ""]]


def _horner(coefficients: Sequence[float], number: Callable[[float], str]) -> str:
    text = ""
    for coefficient in reversed(coefficients):
        text = f"{number(coefficient)}{f' + square * ({text})' if text else ''}"
    return text
