"""Function blocks in Structured Text of IEC 61131-3, and in PLCopen's XML around it."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

from cranedyn.compiled.block import FAULT, FunctionBlock, Variable
from cranedyn.compiled.printing import Assignment, Expression, FunctionPrinter, Language
from cranedyn.errors import ModelError

_FUNCTIONS = {"fabs": "ABS", "sqrt": "SQRT", "sin": "SIN", "cos": "COS"}
"""Functions of Structured Text by the names of LLVM's intrinsics."""

_TYPES = {"real": "LREAL", "integer": "DINT", "truth": "BOOL"}
"""Types of Structured Text of local constants, by their kind, see `Assignment`."""

_SECTIONS = {"input": "VAR_INPUT", "output": "VAR_OUTPUT", "local": "VAR"}
"""Sections of declarations, with the words that begin them in Structured Text."""

_NUMBERS_IN_LINE = 6
"""Numbers of a table in a line."""

_CREATED = "2000-01-01T00:00:00"
"""Time in the head of XML files, fixed so that equal blocks give equal files."""


class _StructuredText(Language):
    """Structured Text, in which names of a block stand alone."""

    and_or: ClassVar = {"and": "AND", "or": "OR"}
    comparison: ClassVar = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "="}
    remainder: ClassVar = "MOD"

    def number(self, value: float) -> str:
        digits, mark, exponent = repr(float(value)).upper().partition("E")
        fraction = digits if "." in digits else f"{digits}.0"
        return f"{fraction}{mark}{exponent.replace('+', '')}"

    def variable(self, name: str) -> str:
        return name

    def element(self, name: str, index: str, *, table: bool) -> str:
        return f"{name}[{index}]"

    def where(self, condition: Expression, yes: Expression, no: Expression) -> Expression:
        return Expression(f"SEL({condition.text}, {no.text}, {yes.text})")

    def in_range(self, value: str, low: float, high: float) -> str:
        return f"({value} >= {self.signed(low)}) AND ({value} <= {self.signed(high)})"

    def call(self, function: str, operand: Expression) -> Expression:
        if function not in _FUNCTIONS:
            raise ModelError(f"Structured Text has no function {function} of real numbers.")
        return Expression(f"{_FUNCTIONS[function]}({operand.text})")


@dataclass(frozen=True)
class _Declaration:
    """Declaration of a variable of a block.

    Attributes:
        section: Section in which it is declared, one of `_SECTIONS`.
        name: Name of the variable.
        kind: Its type, or that of the elements of an array.
        start: Initial values; none for the default of the type.
        about: Description.
        length: Number of elements of an array; 0 for a single variable.
    """

    section: str
    name: str
    kind: str
    start: Sequence[str] = ()
    about: str = ""
    length: int = 0

    def text(self) -> str:
        """Return the declaration in Structured Text."""
        kind = self.kind
        if self.length:
            kind = f"ARRAY [0..{self.length - 1}] OF {self.kind}"
        start = ""
        if self.start and not self.length:
            start = f" := {', '.join(self.start)}"
        elif self.start:
            rows = []
            for first in range(0, self.length, _NUMBERS_IN_LINE):
                rows.append(", ".join(self.start[first : first + _NUMBERS_IN_LINE]))
            numbers = ",\n    ".join(rows)
            start = f" := [{numbers}]"
        about = f" (* {self.about} *)" if self.about else ""
        return f"  {self.name} : {kind}{start};{about}"

    def element(self, parent: ET.Element) -> None:
        """Add the declaration to a list of variables in PLCopen's XML."""
        variable = ET.SubElement(parent, "variable", name=self.name)
        kind = ET.SubElement(variable, "type")
        if self.length:
            kind = ET.SubElement(kind, "array")
            ET.SubElement(kind, "dimension", lower="0", upper=str(self.length - 1))
            kind = ET.SubElement(kind, "baseType")
        ET.SubElement(kind, self.kind)
        if self.start:
            value = ET.SubElement(variable, "initialValue")
            if self.length:
                value = ET.SubElement(value, "arrayValue")
            for number in self.start:
                entry = ET.SubElement(value, "value") if self.length else value
                ET.SubElement(entry, "simpleValue", value=number)


def structured_text(block: FunctionBlock) -> str:
    """Return a block in Structured Text.

    Raises:
        ModelError: If its code has a function that Structured Text lacks.
    """
    declarations, body = _parts(block)
    lines = [
        f"(* {block.about} Called every {block.period:g} s. *)",
        f"(* {block.at_fault} *)",
        f"FUNCTION_BLOCK {block.name}",
    ]
    for section, title in _SECTIONS.items():
        lines.append(title)
        for declaration in declarations:
            if declaration.section == section:
                lines.append(declaration.text())
        lines.append("END_VAR")
    return "\n".join([*lines, *body, "END_FUNCTION_BLOCK", ""])


def plcopen_xml(block: FunctionBlock) -> bytes:
    """Return a block as a project of PLCopen TC6 2.01.

    Raises:
        ModelError: As of `structured_text`.
    """
    declarations, body = _parts(block)
    root = ET.Element("project", xmlns="http://www.plcopen.org/xml/tc6_0201")
    about = {"companyName": "cranedyn", "productName": "cranedyn", "productVersion": "1"}
    ET.SubElement(root, "fileHeader", about, creationDateTime=_CREATED)
    header = ET.SubElement(root, "contentHeader", name=block.name)
    coordinates = ET.SubElement(header, "coordinateInfo")
    for kind in ("fbd", "ld", "sfc"):
        ET.SubElement(ET.SubElement(coordinates, kind), "scaling", x="1", y="1")
    types = ET.SubElement(root, "types")
    ET.SubElement(types, "dataTypes")
    pous = ET.SubElement(types, "pous")
    pou = ET.SubElement(pous, "pou", name=block.name, pouType="functionBlock")
    interface = ET.SubElement(pou, "interface")
    for section in _SECTIONS:
        group = ET.SubElement(interface, f"{section}Vars")
        for declaration in declarations:
            if declaration.section == section:
                declaration.element(group)
    text = ET.SubElement(ET.SubElement(pou, "body"), "ST")
    paragraph = ET.SubElement(text, "p", xmlns="http://www.w3.org/1999/xhtml")
    paragraph.text = "\n".join(body)
    ET.SubElement(ET.SubElement(root, "instances"), "configurations")
    return ET.tostring(root, encoding="utf-8", xml_declaration=True)


def _parts(block: FunctionBlock) -> tuple[list[_Declaration], list[str]]:
    """Return the declarations of a block, and the lines of its body."""
    language = _StructuredText()
    step = FunctionPrinter(block, block.functions["step"], language)
    # The constants of both functions are variables of the block, so their names must differ.
    first_number = step.constant_count + 1
    fault = FunctionPrinter(block, block.functions[FAULT], language, first_number)
    declarations = _declarations(block, [*step.assignments, *fault.assignments], language)
    return [*declarations], [*_body(block, step, fault, language)]


def _declaration(section: str, variable: Variable, language: _StructuredText) -> _Declaration:
    """Return the declaration of a variable, with its unit and description."""
    notes = []
    if variable.unit:
        notes.append(f"[{variable.unit}]")
    if variable.about:
        notes.append(variable.about)
    start = [language.signed(variable.start)]
    return _Declaration(section, variable.name, "LREAL", start, " ".join(notes))


def _declarations(
    block: FunctionBlock, assignments: Sequence[Assignment], language: _StructuredText
) -> Iterator[_Declaration]:
    """Yield the declarations of a block.

    Args:
        block: The block.
        assignments: Statements of its body; local constants that they assign are declared, too.
        language: The language.
    """
    yield _Declaration("input", "reset", "BOOL", about="memory to its start")
    for variable in block.of_kind("input", "parameter"):
        yield _declaration("input", variable, language)
    yield _Declaration("output", "fault", "BOOL", about="until the reset")
    for variable in block.of_kind("output"):
        yield _declaration("output", variable, language)
    for variable in block.of_kind("state"):
        yield _declaration("local", variable, language)
    yield _Declaration("local", "count", "DINT", ["0"], "calls since the reset")
    for name, values in block.arrays.items():
        yield _Declaration("local", name, "LREAL", length=values.size)
    for name, values in block.tables.items():
        numbers = [language.signed(value) for value in values.ravel().tolist()]
        yield _Declaration("local", name, "LREAL", numbers, "constant", values.size)
    for assignment in assignments:
        if assignment.kind:
            yield _Declaration("local", assignment.target, _TYPES[assignment.kind])


def _body(
    block: FunctionBlock, step: FunctionPrinter, fault: FunctionPrinter, language: _StructuredText
) -> Iterator[str]:
    """Yield the lines of the body of a block.

    Args:
        block: The block.
        step: Its function "step".
        fault: Its function `FAULT`.
        language: The language.
    """
    yield "IF reset THEN"
    yield "  fault := FALSE;"
    yield "  count := 0;"
    for variable in block.of_kind("state"):
        yield f"  {variable.name} := {language.signed(variable.start)};"
    yield "END_IF;"
    for variable in block.of_kind("input", "parameter"):
        yield from _fault_unless(language.in_range(variable.name, *variable.allowed), "")
    # Computed only without a fault: some controllers halt at the square root of a negative number.
    yield "IF NOT fault THEN"
    yield from _statements(step.assignments)
    for check in step.checks:
        yield from _fault_unless(check, "  ")
    yield "END_IF;"
    yield "IF fault THEN"
    yield from _statements([*fault.assignments, *fault.results])
    yield "ELSE"
    yield from _statements(step.results)
    if block.last:
        yield f"  IF count < {block.last} THEN"
        yield "    count := count + 1;"
        yield "  ELSE"
        yield f"    count := {block.first};"
        yield "  END_IF;"
    yield "END_IF;"


def _statements(assignments: Sequence[Assignment]) -> Iterator[str]:
    """Yield the lines of assignments."""
    for assignment in assignments:
        yield f"  {assignment.target} := {assignment.value};"


def _fault_unless(condition: str, indent: str) -> Iterator[str]:
    """Yield the statements that put the block at fault unless a condition holds."""
    yield f"{indent}IF NOT ({condition}) THEN"
    yield f"{indent}  fault := TRUE;"
    yield f"{indent}END_IF;"
