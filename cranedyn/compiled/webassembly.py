"""WebAssembly: the code of a crane as a module for browsers and Node, without a linker.

LLVM's object file for wasm32 is a WebAssembly module that exports nothing. Its indices are valid as
they stand, since relocations matter only where several files are joined. So one object file becomes
a module when its functions are exported and the sections for linkers are left out.

Source: WebAssembly/tool-conventions, Linking.md, on relocation sections and the symbol table.
"""

from __future__ import annotations

from collections.abc import Iterator

from llvmlite import ir

from cranedyn.compiled.machine import object_code

TRIPLE = "wasm32-unknown-unknown"

# Numbers of sections of a module, from the WebAssembly core specification.
_CUSTOM = 0
_EXPORTS = 7

# The table of symbols in the section "linking", kinds of symbols and their flags, from the tool
# conventions of WebAssembly object files.
_SYMBOL_TABLE = 8
_FUNCTION = 0
_DATA = 1
_UNDEFINED = 0x10
_EXPLICIT_NAME = 0x40


def webassembly(module: ir.Module, *, simd: bool = True) -> bytes:
    """Translate a module to WebAssembly, with its functions exported by name.

    With SIMD it works on two numbers at once; results are the same to the bit.

    It imports ``env.__linear_memory``, ``env.__stack_pointer``, and functions such as ``env.fmin``.
    An address has 32 bits: of the eight bytes for one in the layout of a call the lower four count.
    """
    object_file = object_code(module, TRIPLE, "+simd128" if simd else "")
    sections = list(_sections(object_file, 8))  # after magic number and version
    exports = [
        _name(name) + bytes([_FUNCTION]) + _leb(index)
        for kind, body in sections
        if kind == _CUSTOM
        for name, index in _functions(body)
    ]
    kept = [(kind, body) for kind, body in sections if kind != _CUSTOM]
    position = sum(kind < _EXPORTS for kind, _ in kept)
    kept.insert(position, (_EXPORTS, _leb(len(exports)) + b"".join(exports)))
    return object_file[:8] + b"".join(bytes([kind]) + _leb(len(body)) + body for kind, body in kept)


def _sections(data: bytes, position: int) -> Iterator[tuple[int, bytes]]:
    """Yield kind and content of each section from a position on."""
    while position < len(data):
        length, first = _read_leb(data, position + 1)
        yield data[position], data[first : first + length]
        position = first + length


def _functions(body: bytes) -> Iterator[tuple[str, int]]:
    """Yield name and index of each function in a custom section: those of the symbol table in the
    section "linking".
    """
    title, position = _read_name(body, 0)
    if title != "linking":
        return
    _, position = _read_leb(body, position)  # version
    for kind, table in _sections(body, position):
        if kind == _SYMBOL_TABLE:
            yield from _defined_functions(table)


def _defined_functions(table: bytes) -> Iterator[tuple[str, int]]:
    count, position = _read_leb(table, 0)
    for _ in range(count):
        kind = table[position]
        flags, position = _read_leb(table, position + 1)
        defined = not flags & _UNDEFINED
        if kind == _DATA:
            _, position = _read_name(table, position)
            for _ in range(3 * defined):  # segment, offset and size
                _, position = _read_leb(table, position)
            continue
        index, position = _read_leb(table, position)
        if defined or flags & _EXPLICIT_NAME:
            name, position = _read_name(table, position)
            if kind == _FUNCTION and defined:
                yield name, index


def _name(text: str) -> bytes:
    return _leb(len(text)) + text.encode()


def _read_name(data: bytes, position: int) -> tuple[str, int]:
    length, first = _read_leb(data, position)
    return data[first : first + length].decode(), first + length


def _leb(number: int) -> bytes:
    """Return an unsigned number in LEB128."""
    out = bytearray()
    while number > 127:
        out.append(number & 127 | 128)
        number >>= 7
    return bytes([*out, number])


def _read_leb(data: bytes, position: int) -> tuple[int, int]:
    """Return an unsigned number in LEB128 and the position after it."""
    number = shift = 0
    while True:
        byte = data[position]
        number |= (byte & 127) << shift
        position, shift = position + 1, shift + 7
        if byte < 128:
            return number, position
