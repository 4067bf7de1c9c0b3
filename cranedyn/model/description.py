"""The crane as text: arguments checked, xacro expanded, comments stripped, a plain URDF.

Run ``python -m cranedyn.model.description [name:=value ...] [-o FILE]`` to write one, ``--list`` to
see every argument.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import re
import sys
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from xml.dom import Node, minidom

import xacro

from cranedyn.arguments import checked
from cranedyn.command import Parser, command, interrupted
from cranedyn.data.files import parse_json, read_text, written
from cranedyn.errors import DataError, ModelError, UnknownName, number, quoted
from cranedyn.model.urdf import parse

_PACKAGE = Path(__file__).resolve().parents[1]
XACRO = next(
    folder / "urdf" / "tower_crane.urdf.xacro"
    for folder in (_PACKAGE, _PACKAGE.parent)
    if (folder / "urdf").is_dir()
)
"""The crane of this project: inside the package once installed, beside it in a checkout."""


_EXPANDING = threading.Lock()  # xacro keeps the file that it is at in a variable of its module

_DOCUMENTED = re.compile(r"\[(?P<unit>[^\]]*)\] (?P<allowed>any|> 0|>= 0): (?P<meaning>.+)")


@dataclass(frozen=True)
class Argument:
    """One argument of a xacro file.

    Attributes:
        default: Its value when none is given, as written in the file.
        unit: Its unit; empty if the file documents none, then any text is allowed.
        allowed: ``"any"``, ``"> 0"`` or ``">= 0"``.
        meaning: What it is.
    """

    default: str
    unit: str = ""
    allowed: str = ""
    meaning: str = ""


@checked
def arguments(path: str | Path = XACRO) -> dict[str, Argument]:
    """The arguments that a xacro file declares, by name, with the unit and range that the comment
    behind each one gives.

    Raises:
        DataError: If the file cannot be read.
        ModelError: If it is not XML.
    """
    found = {}
    for element in _parse(path).getElementsByTagName("xacro:arg"):
        comment = element.nextSibling
        while (
            comment is not None and comment.nodeType == Node.TEXT_NODE and "\n" not in comment.data
        ):
            comment = comment.nextSibling
        text = (
            comment.data.strip()
            if comment is not None and comment.nodeType == Node.COMMENT_NODE
            else ""
        )
        documented = _DOCUMENTED.fullmatch(text)
        found[element.getAttribute("name")] = Argument(
            element.getAttribute("default"), **(documented.groupdict() if documented else {})
        )
    return found


@checked
def describe(
    path: str | Path = XACRO, values: Mapping[str, object] | None = None, *, visuals: bool = True
) -> str:
    """Expand a xacro file into a plain URDF without comments.

    A xacro file is a program: its ``${}`` are Python expressions, and it can read other files.
    Expand only files that you would also run; from anyone else take a plain URDF.

    Args:
        path: The xacro file.
        values: Values of its arguments by name, numbers or text.
        visuals: False leaves the links of this project's crane bare, which takes a small part of
            the time; other files stay as they are.

    Raises:
        UnknownName: If an argument is not declared in the file (xacro itself would ignore it
            silently).
        OutOfRange: If a value is not a number in the range that the file documents.
        DataError: If the file cannot be read.
        ModelError: If the file cannot be expanded.
    """
    known = arguments(path)
    mappings = {} if visuals else {"visuals": "false"}
    for name, value in (values or {}).items():
        if name not in known:
            raise UnknownName("argument", name, known)
        unit, allowed = known[name].unit, known[name].allowed
        mappings[name] = repr(number(name, value, unit, allowed)) if allowed else str(value)
    given = str(path), tuple(mappings.items())
    own = Path(path).parent == XACRO.parent
    return _remembered(*given, _written()) if own else _expanded(*given)


def _written() -> tuple[tuple[int, int], ...]:
    """When each xacro file of this project was written last [ns], and how long it is."""
    found = (file.stat() for file in sorted(XACRO.parent.glob("*.xacro")))
    return tuple((one.st_mtime_ns, one.st_size) for one in found)


@lru_cache(maxsize=64)
def _remembered(
    path: str, mappings: tuple[tuple[str, str], ...], _: tuple[tuple[int, int], ...]
) -> str:
    """What one of this project's files expands to for as long as all stay as they are: they read
    nothing but each other.
    """
    return _expanded(path, mappings)


def _expanded(path: str, mappings: tuple[tuple[str, str], ...]) -> str:
    try:
        with _EXPANDING, contextlib.redirect_stderr(io.StringIO()):
            # A node that xacro moves from document to document: an interruption in its midst would
            # leave it in none, and nothing could be expanded any more.
            xacro._empty_text_node = minidom.Document().createTextNode("\n\n")
            document = xacro.process_file(path, mappings=dict(mappings))
        _strip_comments(document)
        return (
            "\n".join(
                line for line in document.toprettyxml(indent="  ").splitlines() if line.strip()
            )
            + "\n"
        )
    except Exception as error:
        if interrupted(error):
            raise KeyboardInterrupt from None
        raise ModelError(
            f"{path} cannot be expanded: {str(error) or type(error).__name__}."
        ) from error


def add_values(made: argparse.ArgumentParser, text: str) -> None:
    """Add the argument ``--set``, whose words `parse_values` takes."""
    made.add_argument(
        "--set",
        dest="values",
        nargs="+",
        action="extend",
        default=[],
        metavar="name:=value",
        help=text,
    )


@checked
def parse_values(pairs: Sequence[str]) -> dict[str, str]:
    """Values by name from words like ``payload_mass:=2000``, or from a ``.json`` file of a twin
    that was identified, which says its arguments.

    Raises:
        DataError: If a word is not of that form, two have the same name, or a file says no
            arguments.
    """
    values: dict[str, str] = {}
    words = [
        word for pair in pairs for word in (_of_twin(pair) if pair.endswith(".json") else [pair])
    ]
    for pair in words:
        name, mark, value = pair.partition(":=")
        if not mark:
            raise DataError(f"{pair!r} is not of the form name:=value.")
        if name in values:
            raise DataError(f"{quoted(name)} is given twice, as {values[name]!r} and as {value!r}.")
        values[name] = value
    return values


def _of_twin(path: str) -> list[str]:
    """The arguments of this project's crane in the record of a crane, as words."""
    try:
        values = parse_json(read_text(path))["crane"]["arguments"]
        if not all(isinstance(value, float | int) for value in values.values()):
            raise TypeError
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        raise DataError(
            f"{path} says no arguments of this crane; allowed is a twin that identify wrote."
        ) from None
    return [f"{name}:={value!r}" for name, value in values.items()]


def _parse(path: str | Path) -> minidom.Document:
    text = read_text(path)
    parse(text, path)
    return minidom.parseString(text)


def _strip_comments(node: minidom.Node) -> None:
    for child in list(node.childNodes):
        if child.nodeType == Node.COMMENT_NODE:
            node.removeChild(child)  # type: ignore[misc]
        else:
            _strip_comments(child)


def main(argv: list[str] | None = None) -> int:
    """Write the URDF to standard output or a file; return 0, or 2 for bad arguments."""
    parser = Parser(
        prog="python -m cranedyn.model.description", description="Write the crane as a plain URDF."
    )
    add_arguments(parser)
    return command(lambda: write_description(parser.parse_args(argv)))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command to a parser."""
    parser.add_argument(
        "values", nargs="*", metavar="name:=value", help="arguments of the xacro file"
    )
    parser.add_argument(
        "-o", "--output", metavar="FILE", help="write to this file instead of standard output"
    )
    parser.add_argument(
        "--list",
        action="store_true",
        help="list the arguments with default, unit, range and meaning",
    )


def write_description(options: argparse.Namespace) -> int:
    """Write the URDF, or list the arguments of the xacro file; return the exit code."""
    if options.list:
        for name, a in arguments().items():
            print(f"{name:17} {a.default:>9} {a.unit:11} {a.allowed:5} {a.meaning}")
        return 0
    urdf = describe(values=parse_values(options.values))
    if options.output:
        with written(options.output) as file:
            file.write_text(urdf, encoding="utf-8")
    else:
        sys.stdout.write(urdf)
    return 0


if __name__ == "__main__":
    sys.exit(main())
