"""Function blocks in Structured Text of IEC 61131-3, and in PLCopen's XML around it."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

from cranedyn.compiled.block import FAULT, FunctionBlock, Variable
from cranedyn.compiled.printing import ATOM, Assignment, Expression, Language, Walk
from cranedyn.errors import ModelError

_FUNCTIONS = {"fabs": "ABS", "sqrt": "SQRT", "sin": "SIN", "cos": "COS"}
_TYPES = {"real": "LREAL", "integer": "DINT", "truth": "BOOL"}
_SECTIONS = {"input": "VAR_INPUT", "output": "VAR_OUTPUT", "local": "VAR"}


class _StructuredText(Language):
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

    def chosen(self, condition: Expression, yes: Expression, no: Expression) -> Expression:
        return Expression(f"SEL({condition.text}, {no.text}, {yes.text})", ATOM)

    def within(self, value: str, low: float, high: float) -> str:
        return f"({value} >= {self.signed(low)}) AND ({value} <= {self.signed(high)})"

    def call(self, function: str, operand: Expression) -> Expression:
        if function not in _FUNCTIONS:
            raise ModelError(f"Structured Text has no function {function} of real numbers.")
        return Expression(f"{_FUNCTIONS[function]}({operand.text})", ATOM)


@dataclass(frozen=True)
class _Declaration:
    """Variable of a block: where it is declared, its type, initial values, and a description;
    an array has a length.
    """

    section: str
    name: str
    kind: str
    start: Sequence[str] = ()
    about: str = ""
    length: int = 0

    def text(self) -> str:
        """Return the declaration in Structured Text."""
        kind = f"ARRAY [0..{self.length - 1}] OF {self.kind}" if self.length else self.kind
        start = f" := {', '.join(self.start)}" if self.start else ""
        if self.length and self.start:
            rows = [", ".join(self.start[i : i + 6]) for i in range(0, self.length, 6)]
            start = f" := [{(',' + chr(10) + '    ').join(rows)}]"
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
    lines = [f"(* {block.about} Called every {block.period:g} s. *)", f"(* {block.at_fault} *)"]
    lines += [f"FUNCTION_BLOCK {block.name}"]
    for section, title in _SECTIONS.items():
        lines += [title, *(d.text() for d in declarations if d.section == section), "END_VAR"]
    return "\n".join([*lines, *body, "END_FUNCTION_BLOCK", ""])


def plcopen_xml(block: FunctionBlock) -> bytes:
    """Return a block as a project of PLCopen TC6 2.01.

    Raises:
        ModelError: As of `structured_text`.
    """
    declarations, body = _parts(block)
    when = "2000-01-01T00:00:00"  # fixed, so that equal blocks give equal files
    root = ET.Element("project", xmlns="http://www.plcopen.org/xml/tc6_0201")
    about = {"companyName": "cranedyn", "productName": "cranedyn", "productVersion": "1"}
    ET.SubElement(root, "fileHeader", about, creationDateTime=when)
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
    """Return declarations and body of a block."""
    language = _StructuredText()
    step = Walk(block, block.functions["step"], language)
    # The constants of both functions are variables of the block, so their names must differ.
    named = sum(bool(assignment.kind) for assignment in step.assignments)
    fault = Walk(block, block.functions[FAULT], language, named)
    declarations = _declarations(block, [*step.assignments, *fault.assignments], language)
    return [*declarations], [*_body(block, step, fault, language)]


def _declarations(
    block: FunctionBlock, assignments: Sequence[Assignment], language: _StructuredText
) -> Iterator[_Declaration]:
    def declaration(section: str, variable: Variable) -> _Declaration:
        unit = f"[{variable.unit}]" if variable.unit else ""
        about = " ".join(filter(None, (unit, variable.about)))
        start = [language.signed(variable.start)]
        return _Declaration(section, variable.name, "LREAL", start, about)

    yield _Declaration("input", "reset", "BOOL", about="memory to its start")
    for variable in block.of_kind("input", "parameter"):
        yield declaration("input", variable)
    yield _Declaration("output", "fault", "BOOL", about="until the reset")
    for variable in block.of_kind("output"):
        yield declaration("output", variable)
    for variable in block.of_kind("state"):
        yield declaration("local", variable)
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
    block: FunctionBlock, step: Walk, fault: Walk, language: _StructuredText
) -> Iterator[str]:
    yield "IF reset THEN"
    yield "  fault := FALSE;"
    yield "  count := 0;"
    for variable in block.of_kind("state"):
        yield f"  {variable.name} := {language.signed(variable.start)};"
    yield "END_IF;"
    for variable in block.of_kind("input", "parameter"):
        yield from _fault_unless(language.within(variable.name, *variable.allowed), "")
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
    for assignment in assignments:
        yield f"  {assignment.target} := {assignment.value};"


def _fault_unless(condition: str, indent: str) -> Iterator[str]:
    """Yield the statements that put the block at fault unless a condition holds."""
    yield f"{indent}IF NOT ({condition}) THEN"
    yield f"{indent}  fault := TRUE;"
    yield f"{indent}END_IF;"
