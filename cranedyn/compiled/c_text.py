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
from cranedyn.compiled.printing import (
    Assignment,
    Expression,
    FunctionPrinter,
    Language,
    Precedence,
)
from cranedyn.errors import ModelError

Precision = Literal["double", "single"]
"""Type of all numbers: double or float."""

_FUNCTIONS = Path(__file__).with_name("functions.c.in")
"""Template of the functions that C without its library lacks, with an empty line between two."""

_FUNCTION_NAMES = ("within", "fabs", "rint", "sqrt", "turned", "sin", "cos")
"""Names of these functions, in the order of the template."""

_TYPES = {"real": "real", "integer": "int32_t", "truth": "bool"}
"""Types of C of local constants, by their kind, see `Assignment`."""

_NUMBERS_IN_LINE = 6
"""Numbers of a table in a line."""

_NEEDS_NAN = (
    "#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__",
    "#error -ffast-math and -ffinite-math-only remove the checks that find NaN",
    "#endif",
)
"""Compilers that assume finite numbers take every check of this code for true."""


class _C(Language):
    """C99; the name of the block stands before the names of its functions and tables."""

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

    def where(self, condition: Expression, yes: Expression, no: Expression) -> Expression:
        condition_text = condition.as_operand(Precedence.CHOICE, right=True)
        yes_text = yes.as_operand(Precedence.CHOICE, right=True)
        no_text = no.as_operand(Precedence.CHOICE, right=True)
        return Expression(f"{condition_text} ? {yes_text} : {no_text}", Precedence.CHOICE)

    def call(self, function: str, operand: Expression) -> Expression:
        return Expression(f"{self.name}_{function}({operand.text})")

    def in_range(self, value: str, low: float, high: float) -> str:
        return f"{self.name}_within({value}, {self.signed(low)}, {self.signed(high)})"

    def routine(self, name: str, arrays: Sequence[str]) -> str:
        arguments = ", ".join(f"self->{array}" for array in arrays)
        return f"{self.name}_{name}({arguments})"


def c_header(block: FunctionBlock, precision: Precision = "double") -> str:
    """Return the header of a block."""
    name = block.name
    number = _type_name(precision)
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
        variables = block.of_kind(kind)
        if variables:
            lines.append(f"  /* {kind}s */")
        for variable in variables:
            lines.append(f"  {number} {variable.name};{_comment(variable)}")
    for array, values in block.arrays.items():
        lines.append(f"  {number} {array}[{len(values)}];")
    lines += [
        "  int32_t count; /* calls since the reset, up to the last row of its tables */",
        "  bool fault; /* a value was out of range or a result not finite; until the reset */",
        f"}} {name};",
        "",
        "/* Set parameters and memory to their values at the start. */",
        f"void {name}_reset({name} *self);",
    ]
    for function in block.calls:
        task = "Compute outputs; return no fault."
        if function == "step":
            task = f"Compute outputs and memory, every {block.period:g} s; return no fault."
        lines += [
            "",
            f"/* {task}",
            f"   {block.at_fault} */",
            f"bool {name}_{function}({name} *self);",
        ]
    return "\n".join([*lines, "", "#endif", ""])


def _type_name(precision: Precision) -> str:
    """Return the type of C of all numbers."""
    return "double" if precision == "double" else "float"


def c_source(block: FunctionBlock, precision: Precision = "double") -> str:
    """Return the source of a block.

    Raises:
        ModelError: If it optimises, which single precision does not allow.
    """
    if block.routines and precision == "single":
        raise ModelError("Predictive control needs double precision: its optimisation would stop.")
    language = _C(block.name, precision)
    name = block.name
    printed = {}
    for key, function in block.functions.items():
        printed[key] = FunctionPrinter(block, function, language)
    printed_routines = routines(block.routines, language, name)
    called: set[str] = set()
    for printer in [*printed.values(), *printed_routines]:
        called |= printer.functions

    lines = [f'#include "{name}.h"', "", *_NEEDS_NAN, ""]
    lines += [f"typedef {_type_name(precision)} real;", ""]
    for table, values in block.tables.items():
        lines.append(f"static const real {name}_{table}[{values.size}] = {{")
        lines += _rows([language.signed(number) for number in values.ravel().tolist()])
        lines += ["};", ""]
    lines += _helpers(called, language)
    for routine in printed_routines:
        lines += routine.lines
    lines += _reset_function(block, language)
    lines += _fault_function(block, printed.get(FAULT))
    for function in block.calls:
        lines += _called_function(block, function, printed[function], language)
    return "\n".join(lines)


def _reset_function(block: FunctionBlock, language: _C) -> list[str]:
    """Return the function that sets parameters and memory to their values at the start."""
    name = block.name
    lines = [f"void {name}_reset({name} *self) {{"]
    for variable in block.of_kind(*KINDS):
        lines.append(f"  self->{variable.name} = {language.signed(variable.start)};")
    for array, values in block.arrays.items():
        # Most numbers of an array are zero; the others are set one by one.
        lines.append(f"  for (int32_t i = 0; i < {len(values)}; i++) self->{array}[i] = 0;")
        for i in np.flatnonzero(values).tolist():
            lines.append(f"  self->{array}[{i}] = {language.signed(float(values[i]))};")
    return [*lines, "  self->count = 0;", "  self->fault = false;", "}", ""]


def _fault_function(block: FunctionBlock, printed: FunctionPrinter | None) -> list[str]:
    """Return the function that ends a call at fault, with the outputs of `FAULT` if it has one."""
    name = block.name
    lines = [f"/* {block.at_fault} */", f"static bool {name}_at_fault({name} *self) {{"]
    lines.append("  self->fault = true;")
    if printed is not None:
        lines += _statements(printed.assignments)
        lines += _statements(printed.results)
    return [*lines, "  return false;", "}", ""]


def _called_function(
    block: FunctionBlock, function: str, printed: FunctionPrinter, language: _C
) -> list[str]:
    """Return a function that a caller runs.

    It checks all inputs before it computes, and all results before it stores one.
    """
    name = block.name
    lines = [f"bool {name}_{function}({name} *self) {{", *_input_check(block, language)]
    lines += _statements(printed.assignments)
    lines += _return_if_any_fails(printed.checks, language)
    lines += _statements(printed.results)
    if function == "step" and block.last:
        count = f"self->count < {block.last} ? self->count + 1 : {block.first}"
        lines.append(f"  self->count = {count};")
    return [*lines, "  return true;", "}", ""]


def _statements(assignments: Sequence[Assignment]) -> list[str]:
    """Return the lines of assignments and calls."""
    lines = []
    for assignment in assignments:
        text = assignment.value
        if assignment.target:
            text = f"{assignment.target} = {text}"
        if assignment.kind:
            text = f"const {_TYPES[assignment.kind]} {text}"
        lines.append(f"  {text};")
    return lines


def _comment(variable: Variable) -> str:
    """Return unit, description and range of a variable as a comment; empty if it has none."""
    notes = []
    if variable.unit:
        notes.append(f"[{variable.unit}]")
    if variable.about:
        notes.append(variable.about)
    if math.isfinite(variable.lower) and math.isinf(variable.upper):
        notes.append(f"at least {variable.lower:.9g}")
    elif math.isinf(variable.lower) and math.isfinite(variable.upper):
        notes.append(f"at most {variable.upper:.9g}")
    elif math.isfinite(variable.lower) and math.isfinite(variable.upper):
        notes.append(f"{variable.lower:.9g} to {variable.upper:.9g}")
    return f" /* {', '.join(notes)} */" if notes else ""


def _rows(numbers: Sequence[str]) -> list[str]:
    """Return the lines of the numbers of a table."""
    lines = []
    for first in range(0, len(numbers), _NUMBERS_IN_LINE):
        lines.append(f"  {', '.join(numbers[first : first + _NUMBERS_IN_LINE])},")
    return lines


def _input_check(block: FunctionBlock, language: _C) -> list[str]:
    """Return the statements that end a call at fault, or with an input or parameter that is out of
    its range.
    """
    checks = ["!self->fault"]
    for variable in block.of_kind("input", "parameter"):
        checks.append(language.in_range(f"self->{variable.name}", *variable.allowed))
    return _return_if_any_fails(checks, language)


def _return_if_any_fails(checks: Sequence[str], language: _C) -> list[str]:
    """Return the statements that end a call at fault unless all conditions hold."""
    if not checks:
        return []
    every = " &&\n        ".join(checks)
    return [f"  if (!({every}))", f"    return {language.name}_at_fault(self);"]


def _helpers(called: set[str], language: _C) -> list[str]:
    """Return the lines of the functions that the code calls, for C without its library.

    Sine and cosine are polynomials within an eighth of a turn, to which `turned` reduces an angle.
    """
    is_double = language.precision == "double"
    first, second, third = HALF_PI
    terms = {
        "name": language.name,
        "quarters": language.signed(2.0 / math.pi),
        "far": language.signed(LARGEST_ANGLE),
        "one": language.signed(1.0),
        # A number so large has no digits behind the point: to add and subtract it rounds.
        "whole": language.signed(2.0**52 if is_double else 2.0**23),
        "first": language.signed(first),
        "second": language.signed(second),
        "third": language.signed(third),
        "sine": _horner(SINE, language.signed),
        "cosine": _horner(COSINE, language.signed),
    }
    texts = Template(_FUNCTIONS.read_text()).substitute(terms).split("\n\n")
    needed = called | {"within"}
    if called & {"sin", "cos"}:
        needed |= {"rint", "turned"}
    lines = []
    for name, text in zip(_FUNCTION_NAMES, texts, strict=True):
        if name in needed:
            lines += [*text.splitlines(), ""]
    return lines


def _horner(coefficients: Sequence[float], number: Callable[[float], str]) -> str:
    """Return the polynomial of `square` with some coefficients, the constant first, in C, by
    Horner's rule.
    """
    text = ""
    for coefficient in reversed(coefficients):
        further = f" + square * ({text})" if text else ""
        text = f"{number(coefficient)}{further}"
    return text
