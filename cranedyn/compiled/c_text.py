"""Function blocks in C99: without heap, recursion and library, and with memory of a fixed size."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from string import Template
from typing import ClassVar, Literal

import numpy as np

from cranedyn.compiled.angles import COSINE, HALF_PI, LARGEST_ANGLE, SINE
from cranedyn.compiled.block import FAULT, KINDS, FunctionBlock, Variable
from cranedyn.compiled.c_routines import routines
from cranedyn.compiled.printing import ATOM, CHOICE, Assignment, Expression, Language, Walk
from cranedyn.errors import ModelError

Precision = Literal["double", "single"]
"""Type of all numbers: double or float."""

_FUNCTIONS = Path(__file__).with_name("functions.c.in")
_TYPES = {"real": "real", "integer": "int32_t", "truth": "bool"}

_NEEDS_NAN = (
    "#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__",
    "#error -ffast-math and -ffinite-math-only remove the checks that find NaN",
    "#endif",
)
"""Compilers that assume finite numbers take every check of this code for true."""


class _C(Language):
    and_or: ClassVar = {"and": "&&", "or": "||"}
    comparison: ClassVar = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}
    remainder = "%"

    def __init__(self, name: str, precision: Precision) -> None:
        self.name = name
        self.precision = precision

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

    def within(self, value: str, low: float, high: float) -> str:
        return f"{self.name}_within({value}, {self.signed(low)}, {self.signed(high)})"

    def routine(self, name: str, arrays: Sequence[str]) -> str:
        return f"{self.name}_{name}({', '.join(f'self->{array}' for array in arrays)})"


def c_header(block: FunctionBlock, precision: Precision = "double") -> str:
    """Return the header of a block."""
    name = block.name
    number = "double" if precision == "double" else "float"
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
    lines += [
        "  bool fault; /* a value was out of range or a result not finite; until the reset */"
    ]
    lines += [f"}} {name};", "", "/* Set parameters and memory to their values at the start. */"]
    lines += [f"void {name}_reset({name} *self);"]
    for function in block.calls:
        when = f", every {block.period:g} s" if function == "step" else ""
        lines += ["", f"/* Compute outputs{' and memory' * bool(when)}{when}; return no fault."]
        lines += [f"   {block.at_fault} */"]
        lines += [f"bool {name}_{function}({name} *self);"]
    return "\n".join([*lines, "", "#endif", ""])


def c_source(block: FunctionBlock, precision: Precision = "double") -> str:
    """Return the source of a block.

    Raises:
        ModelError: If it optimises, which single precision does not allow.
    """
    if block.routines and precision == "single":
        raise ModelError("Predictive control needs double precision: its optimisation would stop.")
    language = _C(block.name, precision)
    name = block.name
    real = "double" if precision == "double" else "float"
    walks = {key: Walk(block, function, language) for key, function in block.functions.items()}
    below = routines(block.routines, language, name)
    called = set().union(*(text.functions for text in (*walks.values(), *below)))
    lines = [f'#include "{name}.h"', "", *_NEEDS_NAN, "", f"typedef {real} real;", ""]
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
    lines += [f"/* {block.at_fault} */", f"static bool {name}_at_fault({name} *self) {{"]
    lines += ["  self->fault = true;"]
    if FAULT in walks:
        lines += [*_statements(walks[FAULT].assignments), *_statements(walks[FAULT].results)]
    lines += ["  return false;", "}", ""]
    for function in block.calls:
        walk = walks[function]
        lines += [f"bool {name}_{function}({name} *self) {{", *_input_check(block, language)]
        lines += _statements(walk.assignments)
        lines += _return_if_any_fails(walk.checks, language)
        lines += _statements(walk.results)
        if function == "step" and block.last:
            text = f"self->count < {block.last} ? self->count + 1 : {block.first}"
            lines.append(f"  self->count = {text};")
        lines += ["  return true;", "}", ""]
    return "\n".join(lines)


def _statements(assignments: Sequence[Assignment]) -> list[str]:
    lines = []
    for assignment in assignments:
        kind = f"const {_TYPES[assignment.kind]} " if assignment.kind else ""
        target = f"{kind}{assignment.target} = " if assignment.target else ""
        lines.append(f"  {target}{assignment.value};")
    return lines


def _comment(variable: Variable) -> str:
    notes = [f"[{variable.unit}]"] if variable.unit else []
    notes += [variable.about] if variable.about else []
    if math.isfinite(variable.lower) and math.isinf(variable.upper):
        notes.append(f"at least {variable.lower:.9g}")
    elif math.isfinite(variable.lower) or math.isfinite(variable.upper):
        notes.append(f"{variable.lower:.9g} to {variable.upper:.9g}")
    return f" /* {', '.join(notes)} */" if notes else ""


def _rows(numbers: Sequence[str]) -> list[str]:
    return [f"  {', '.join(numbers[i : i + 6])}," for i in range(0, len(numbers), 6)]


def _input_check(block: FunctionBlock, language: _C) -> list[str]:
    """Return the statements that end a call at fault, or with an input or parameter that is out of
    its range.
    """
    checks = ["!self->fault"]
    for variable in block.of_kind("input", "parameter"):
        checks.append(language.within(f"self->{variable.name}", *variable.allowed))
    return _return_if_any_fails(checks, language)


def _return_if_any_fails(checks: Sequence[str], language: _C) -> list[str]:
    if not checks:
        return []
    every = " &&\n        ".join(checks)
    return [f"  if (!({every}))", f"    return {language.name}_at_fault(self);"]


def _helpers(called: set[str], language: _C) -> list[str]:
    """Return the functions that the code calls."""
    number = language.signed
    numbers = {"quarters": 2.0 / math.pi, "far": LARGEST_ANGLE, "one": 1.0}
    numbers["whole"] = 2.0**52 if language.precision == "double" else 2.0**23
    numbers |= zip(("first", "second", "third"), HALF_PI, strict=True)
    series = {"sine": _horner(SINE, number), "cosine": _horner(COSINE, number)}
    terms = {key: number(value) for key, value in numbers.items()} | series
    texts = Template(_FUNCTIONS.read_text()).substitute(terms, name=language.name).split("\n\n")
    trigonometric = called & {"sin", "cos"}
    needed = called | {"within"} | ({"rint", "turned"} if trigonometric else set())
    names = ("within", "fabs", "rint", "sqrt", "turned", "sin", "cos")
    keyed = zip(names, texts, strict=True)
    return [line for key, text in keyed if key in needed for line in [*text.splitlines(), ""]]


def _horner(coefficients: Sequence[float], number: Callable[[float], str]) -> str:
    text = ""
    for coefficient in reversed(coefficients):
        text = f"{number(coefficient)}{f' + square * ({text})' if text else ''}"
    return text
