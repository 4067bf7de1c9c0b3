"""Tables of a site's TOML file, whose fields are refused with their line."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import date, time
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from cranedyn.checks import number, whole
from cranedyn.errors import CraneError, DataError, OutOfRange, UnknownName, quoted

_HEADER = re.compile(r"\s*\[\[?\s*([\w.]+)\s*\]\]?")
"""Line that begins a table, with its name."""

_KEY = re.compile(r"\s*([\w]+)\s*=")
"""Line that begins a field, with its name."""

MAX_COUNT = 2000
"""Largest number of obstacles of a site, and of corners of an outline."""

MAX_POINTS = 24
"""Largest number of points of a load."""

POINT_RANGE = "-1000000 to 1000000"
"""Coordinates that a point of a load may have [m], in the words of `cranedyn.checks.number`: wide
enough for millimetres, which are then asked about."""

FieldLines = Mapping[tuple[str, int], dict[str, int]]
"""Number of the line of each field, by the name of its table and the index among the tables of that
name, then by the name of the field; "" is the line that begins the table."""


class SiteTable:
    """Table of a site's file with the lines of its fields; its methods refuse a value with them."""

    def __init__(
        self,
        path: Path,
        name: str,
        values: dict[str, Any],
        lines: dict[str, int],
        fields: Sequence[str],
    ) -> None:
        """Take a table, and refuse fields that it cannot have.

        Args:
            path: The file.
            name: Name of the table.
            values: Its fields.
            lines: Number of the line of each field, "" for the line that begins the table.
            fields: Names of the fields that it may have.

        Raises:
            DataError: If it has another field.
        """
        self.path = path
        self.name = name
        self.values = values
        self.lines = lines
        for key in values:
            if key not in fields:
                noun = "table" if _is_table(values[key]) else "field"
                self.fail(key, UnknownName(noun, key, fields))

    def fail(self, key: str, reason: object) -> NoReturn:
        """Refuse a field, with the line where it is, or where its table begins.

        Raises:
            DataError: With file, line, table, field and the reason.
        """
        line = self.lines.get(key, self.lines.get("", 1))
        raise DataError(f"{self.path}, line {line}, [{self.name}] {key}: {reason}")

    def take(self, key: str, convert: Callable[[str, Any], Any], default: Any = None) -> Any:
        """Return a field, converted; without a default it must be there.

        The default None means that the field is required. A caller for whom a missing field is None
        first asks whether it is among `values`, as `optional_number` does.
        """
        if key not in self.values:
            if default is None:
                self.fail(key, "it is missing.")
            return default
        try:
            return convert(key, self.values[key])
        except CraneError as error:
            self.fail(key, error)

    def number(
        self, key: str, default: float | None = None, unit: str = "m", allowed: str = "any"
    ) -> float:
        """Return a number in a range, see `cranedyn.checks.number`."""
        return self.take(key, partial(_number, unit=unit, allowed=allowed), default)

    def numbers(
        self,
        key: str,
        count: int,
        allowed: str = "any",
        default: Any = None,
        units: Sequence[str] = ("m",),
    ) -> Any:
        """Return a list of a count of numbers, all in a range, see `cranedyn.checks.number`. Their
        units, or the one of all, are for the error message.
        """
        convert = partial(_numbers, count=count, allowed=allowed, units=units)
        return self.take(key, convert, default)

    def text(self, key: str, default: str | None = None) -> str:
        """Return a printable text."""
        return self.take(key, _text, default)

    def flag(self, key: str) -> bool:
        """Return true or false, by default false."""
        value = self.values.get(key, False)
        if not isinstance(value, bool):
            self.fail(key, "allowed is true or false.")
        return value

    def angle(self, key: str, default: float = 0.0, allowed: str = "any") -> float:
        """Return an angle [rad] that the file gives in degrees."""
        return math.radians(self.number(key, math.degrees(default), "degrees", allowed))

    def optional_number(self, key: str, unit: str, allowed: str) -> float | None:
        """Return a number in a range; None if it is left out."""
        return self.number(key, unit=unit, allowed=allowed) if key in self.values else None

    def optional_whole(self, key: str) -> int | None:
        """Return a whole number from 1; None if it is left out."""
        return self.whole(key) if key in self.values else None

    def optional_angle(self, key: str, allowed: str) -> float | None:
        """Return an angle [rad] that the file gives in degrees; None if it is left out."""
        return self.angle(key, allowed=allowed) if key in self.values else None

    def optional_kilonewtons(self, key: str) -> float | None:
        """Return a force [N] above 0 that the file gives in kilonewtons; None if it is left out."""
        force = self.optional_number(key, "kN", "> 0")
        return None if force is None else 1e3 * force

    def optional_text(self, key: str) -> str | None:
        """Return a text that is for people only, and which TOML may also write as a whole number or
        a date, such as the number of a job; None if it is left out.
        """
        return self.take(key, _label) if key in self.values else None

    def choice(
        self, key: str, allowed: Sequence[str], default: str | None = None, noun: str = ""
    ) -> str:
        """Return a text that is one of several; without a default it must be there. What an error
        calls it is the noun, or the field's name.
        """
        value = self.text(key, default)
        if value not in allowed:
            self.fail(key, UnknownName(noun or key, value, allowed))
        return value

    def optional_choice(self, key: str, allowed: Sequence[str]) -> Any:
        """Return a text that is one of several; None if it is left out."""
        return self.choice(key, allowed) if key in self.values else None

    def optional_flag(self, key: str) -> bool | None:
        """Return true or false; None if it is left out."""
        return self.flag(key) if key in self.values else None

    def optional_numbers(
        self, key: str, count: int, unit: str = "m", allowed: str = "any"
    ) -> tuple[float, ...] | None:
        """Return a list of a count of numbers of one unit; None if it is left out."""
        if key not in self.values:
            return None
        return tuple(self.numbers(key, count, allowed, units=(unit,)))

    def texts(self, key: str) -> tuple[str, ...]:
        """Return a list of printable texts, or a single one; empty if it is left out."""
        value = self.values.get(key, [])
        if isinstance(value, str):
            return (self.text(key),)
        return tuple(self.take(key, names_of, []))

    def named_texts(self, key: str) -> dict[str, str]:
        """Return a table of printable texts by name; empty if it is left out."""
        return self.take(key, _named_texts, {})

    def points(self, key: str) -> tuple[tuple[float, float, float], ...]:
        """Return a list of points [m]; empty if it is left out."""
        return self.take(key, _points, ())

    def child(self, key: str, fields: Sequence[str], lines: FieldLines) -> SiteTable:
        """Return a table within this one, such as [rigging.slings]; empty if it is left out, or if
        something else than a table stands there.

        Args:
            key: Name of the inner table.
            fields: Names of the fields that it may have.
            lines: Lines of all fields of the file.
        """
        values = self.values.get(key, {})
        if not isinstance(values, dict):
            values = {}
        return self._inner(key, f"{self.name}.{key}", values, fields, lines)

    def top_table(self, key: str, fields: Sequence[str], lines: FieldLines) -> SiteTable:
        """Return a table of the file of which this is the whole, such as [load]; empty if
        it is left out.

        Args:
            key: Name of the table.
            fields: Names of the fields that it may have.
            lines: Lines of all fields of the file.

        Raises:
            DataError: If it is no table, or has another field.
        """
        values = self.values.get(key, {})
        if not isinstance(values, dict):
            self.fail(key, "it must be a table.")
        return self._inner(key, key, values, fields, lines)

    def _inner(
        self,
        key: str,
        name: str,
        values: dict[str, Any],
        fields: Sequence[str],
        lines: FieldLines,
    ) -> SiteTable:
        """Return the table of a field, which messages call by a name."""
        # A table that is written in one line, {...}, has the line of its field.
        own_lines = lines.get((name, 0), {"": self.lines.get(key, self.lines.get("", 1))})
        return SiteTable(self.path, name, values, own_lines, fields)

    def tables(self, kind: str, fields: Sequence[str], lines: FieldLines) -> list[SiteTable]:
        """Return all tables of a kind; an empty list if there are no such tables.

        Args:
            kind: Name of the tables.
            fields: Names of the fields that they may have.
            lines: Lines of all fields of the file.
        """
        tables = self.values.get(kind, [])
        if not isinstance(tables, list) or not all(isinstance(values, dict) for values in tables):
            self.fail(kind, f"write each as [[{kind}]].")
        return [
            SiteTable(self.path, kind, values, lines.get((kind, i), {}), fields)
            for i, values in enumerate(tables)
        ]

    def file(self, key: str) -> Path:
        """Return the path of a file, which must lie in the folder of the site, links resolved."""
        name = self.text(key)
        folder = Path(os.path.realpath(self.path.parent))
        path = Path(os.path.realpath(folder / name))
        if not path.is_relative_to(folder):
            self.fail(
                key,
                f"{quoted(name)} lies outside of the folder of the site; allowed are files in it.",
            )
        return path

    def whole(self, key: str) -> int:
        """Return a whole number from 1."""
        return self.take(key, _whole)

    def outline(self, key: str) -> np.ndarray:
        """Return the corners of an outline [m], shape (n, 2)."""
        return self.take(key, _outline)


# --- conversions of fields, which raise without a line; `SiteTable.take` adds it ------------------


def _number(name: str, value: Any, unit: str = "m", allowed: str = "any") -> float:
    """Return a number in a range. `number` alone would take true, and texts of numbers."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise OutOfRange(name, quoted(value), "a number", unit)
    return number(name, value, unit, allowed)


def _whole(name: str, value: Any) -> int:
    """Return a whole number from 1."""
    return whole(name, value, 1)


def _numbers(
    name: str, value: Any, count: int, allowed: str = "any", units: Sequence[str] = ("m",)
) -> list[float]:
    """Return a list of a count of numbers in a range, of units that are one for each or one for
    all.
    """
    if not isinstance(value, list) or len(value) != count:
        raise OutOfRange(name, quoted(value), f"{count} numbers", ", ".join(units))
    each_unit = units if len(units) == count else [units[0]] * count
    return [
        _number(f"one of {name}", item, unit, allowed)
        for item, unit in zip(value, each_unit, strict=True)
    ]


def _outline(name: str, value: Any) -> np.ndarray:
    """Return the corners of an outline [m], shape (n, 2)."""
    if not isinstance(value, list) or not 3 <= len(value) <= MAX_COUNT:
        raise OutOfRange(name, quoted(value), "a list of 3 or more")
    return np.array([_numbers("corner", corner, 2) for corner in value])


def _text(name: str, value: Any) -> str:
    """Return a printable text that is not empty."""
    if not isinstance(value, str) or not value.strip() or not value.isprintable():
        raise OutOfRange(name, quoted(value), "a printable text")
    return value


def _label(name: str, value: Any) -> str:
    """Return a printable text, also of a whole number or a date."""
    if isinstance(value, date | time) or (isinstance(value, int) and not isinstance(value, bool)):
        return str(value)
    return _text(name, value)


def _points(name: str, value: Any) -> tuple[tuple[float, float, float], ...]:
    """Return a list of points [m]."""
    if not isinstance(value, list) or not 1 <= len(value) <= MAX_POINTS:
        raise OutOfRange(
            name, quoted(value), f"a list of 1 to {MAX_POINTS} points, each of 3 numbers", "m"
        )
    points = []
    for point in value:
        x, y, z = _numbers(f"point of {name}", point, 3, POINT_RANGE)
        points.append((x, y, z))
    return tuple(points)


def crane_values(name: str, table: Any) -> dict[str, float]:
    """Return numbers of a crane by name."""
    if not isinstance(table, dict):
        raise OutOfRange(name, quoted(table), "a table of numbers of the crane")
    return {argument: _number(argument, value, "") for argument, value in table.items()}


def names_of(name: str, value: Any) -> list[str]:
    """Return a list of printable names."""
    if not isinstance(value, list):
        raise OutOfRange(name, quoted(value), "a list of names")
    return [_text(name, entry) for entry in value]


def _named_texts(name: str, value: Any) -> dict[str, str]:
    """Return printable texts by name."""
    if not isinstance(value, dict):
        raise OutOfRange(name, quoted(value), 'a table of sentences by name, {"name" = "sentence"}')
    return {key: _text(f"{name} of {quoted(key)}", text) for key, text in value.items()}


def positions_of(name: str, value: Any) -> dict[str, float | None]:
    """Return where joints are held [rad or m] by name, from a table of numbers, or a list of names
    of joints that are held where they start, each None.
    """
    if isinstance(value, list):
        return dict.fromkeys(names_of(name, value))
    if not isinstance(value, dict):
        raise OutOfRange(name, quoted(value), "a list of joints, or a table of their coordinates")
    return {joint: _number(joint, position, "rad or m") for joint, position in value.items()}


def _is_table(value: object) -> bool:
    """Return whether a value of a file is a table, or a list of tables."""
    if isinstance(value, list):
        return all(isinstance(entry, dict) for entry in value)
    return isinstance(value, dict)


def field_lines(text: str) -> Iterator[tuple[tuple[str, int], dict[str, int]]]:
    """Yield the lines of the fields of each table, by its name and its index among the tables of
    that name; see `FieldLines`. The fields before the first table have the name "".
    """
    counts: dict[str, int] = {}

    def index(name: str) -> int:
        """Return the index of the latest table of a name. What comes before the first table was
        not counted, and is the only one of its name.
        """
        return counts[name] - 1 if name in counts else 0

    name = ""
    fields = {"": 1}
    for i, line in enumerate(text.splitlines(), start=1):
        header = _HEADER.match(line)
        key = _KEY.match(line)
        if header:
            yield (name, index(name)), fields
            name = header[1]
            fields = {"": i}
            counts[name] = counts.get(name, 0) + 1
        elif key:
            fields.setdefault(key[1], i)
    yield (name, index(name)), fields
