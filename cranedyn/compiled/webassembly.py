"""WebAssembly: the code of a crane as a module for browsers and Node, without a linker.

LLVM's object file for wasm32 is a WebAssembly module that exports nothing. Its indices are valid as
they stand, since relocations matter only where several files are joined. So one object file becomes
a module when its functions are exported and the sections for linkers are left out.

A module is a magic number, a version, and sections; a section is the byte of its kind, the length
of its content, and the content. Numbers are in LEB128: seven bits in each byte, the lowest first,
and the highest bit says that another byte follows. A name is the length of its text, and the text.
Custom sections, such as those for linkers, begin with a name.

Sources: the WebAssembly core specification, on the binary format; WebAssembly/tool-conventions,
Linking.md, on relocation sections and the symbol table.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from llvmlite import ir

from cranedyn.compiled.machine import object_code

TRIPLE = "wasm32-unknown-unknown"
"""LLVM's name of the platform."""

_HEADER_LENGTH = 8
"""Bytes of magic number and version, before the first section."""

# Kinds of sections of a module, from the core specification. Sections are in the order of their
# kinds, but for custom ones and for that of the number of data segments.
_CUSTOM_SECTION = 0
_EXPORT_SECTION = 7

_EXPORTED_FUNCTION = 0
"""Kind of an export that is a function, from the core specification."""

# From the tool conventions: the subsection of the custom section "linking" that holds the table of
# symbols; kinds of symbols; and bits of their flags.
_SYMBOL_TABLE = 8
_FUNCTION_SYMBOL = 0
_DATA_SYMBOL = 1
_SECTION_SYMBOL = 3
_IS_UNDEFINED = 0x10
_HAS_EXPLICIT_NAME = 0x40


class _Section(NamedTuple):
    """Section of a module, or subsection.

    Attributes:
        kind: Its kind.
        content: Its bytes without kind and length.
    """

    kind: int
    content: bytes


@dataclass(frozen=True)
class _Function:
    """Function of a module.

    Attributes:
        name: Its name.
        index: Its index among the functions of the module.
    """

    name: str
    index: int


def webassembly(module: ir.Module, *, simd: bool = True) -> bytes:
    """Translate a module to WebAssembly, with all functions that it defines exported by name.

    It imports ``env.__linear_memory``, ``env.__stack_pointer``, and functions such as ``env.fmin``.
    An address has 32 bits: of the eight bytes for one in the layout of a call the lower four count.

    Args:
        module: The code.
        simd: Whether it may work on two numbers at once; results are the same to the bit.
    """
    object_file = object_code(module, TRIPLE, "+simd128" if simd else "")
    sections = list(_sections(object_file, _HEADER_LENGTH))

    exports = []
    for section in sections:
        if section.kind == _CUSTOM_SECTION:
            for function in _defined_functions(section.content):
                entry = _name_bytes(function.name)
                entry += bytes([_EXPORTED_FUNCTION]) + _leb128(function.index)
                exports.append(entry)

    kept = [section for section in sections if section.kind != _CUSTOM_SECTION]
    place = sum(section.kind < _EXPORT_SECTION for section in kept)
    kept.insert(place, _Section(_EXPORT_SECTION, _leb128(len(exports)) + b"".join(exports)))

    parts = [object_file[:_HEADER_LENGTH]]
    for section in kept:
        parts.append(bytes([section.kind]) + _leb128(len(section.content)) + section.content)
    return b"".join(parts)


def _sections(data: bytes, position: int) -> Iterator[_Section]:
    """Yield each section from a position on."""
    while position < len(data):
        kind = data[position]
        length, first = _read_leb128(data, position + 1)
        yield _Section(kind, data[first : first + length])
        position = first + length


def _defined_functions(custom_section: bytes) -> Iterator[_Function]:
    """Yield the functions that the module defines, if this is the custom section that says so: the
    symbol table in "linking".
    """
    title, position = _read_name(custom_section, 0)
    if title != "linking":
        return
    _, position = _read_leb128(custom_section, position)  # version of the conventions
    for subsection in _sections(custom_section, position):
        if subsection.kind == _SYMBOL_TABLE:
            yield from _functions_of_symbol_table(subsection.content)


def _functions_of_symbol_table(table: bytes) -> Iterator[_Function]:
    """Yield the defined functions of a symbol table.

    It is the number of symbols, and for each its kind, its flags, and what the kind has:

    * data: a name; and if it is defined, its segment, offset and size;
    * a section: its index;
    * a function or anything else: its index; and a name, if it is defined or has one of its own
      (an undefined one otherwise has the name of its import).
    """
    count, position = _read_leb128(table, 0)
    for _ in range(count):
        kind = table[position]
        flags, position = _read_leb128(table, position + 1)
        is_defined = not flags & _IS_UNDEFINED
        if kind == _DATA_SYMBOL:
            _, position = _read_name(table, position)
            if is_defined:
                for _ in ("segment", "offset", "size"):
                    _, position = _read_leb128(table, position)
            continue
        index, position = _read_leb128(table, position)
        if kind == _SECTION_SYMBOL:
            continue
        if is_defined or flags & _HAS_EXPLICIT_NAME:
            name, position = _read_name(table, position)
            if kind == _FUNCTION_SYMBOL and is_defined:
                yield _Function(name, index)


def _name_bytes(name: str) -> bytes:
    """Return a name as a module has it."""
    text = name.encode()
    return _leb128(len(text)) + text


def _read_name(data: bytes, position: int) -> tuple[str, int]:
    """Return a name and the position after it."""
    length, first = _read_leb128(data, position)
    return data[first : first + length].decode(), first + length


def _leb128(number: int) -> bytes:
    """Return an unsigned number in LEB128."""
    encoded = bytearray()
    while number >= 0x80:
        encoded.append(number & 0x7F | 0x80)
        number >>= 7
    encoded.append(number)
    return bytes(encoded)


def _read_leb128(data: bytes, position: int) -> tuple[int, int]:
    """Return an unsigned number in LEB128 and the position after it."""
    number = 0
    shift = 0
    while True:
        byte = data[position]
        number |= (byte & 0x7F) << shift
        position += 1
        shift += 7
        if byte < 0x80:
            return number, position
