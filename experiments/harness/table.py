"""Tables: rows of values, and columns with header, unit and format."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cranedyn.errors import printable

FORMAT = re.compile(r"([+-]?,?(?:\.\d\d?)?[a-z%]?)(?:>(1e-\d\d?|0\.0{0,5}1|1))?")
"""Formats that a column may have: sign, thousands, digits, kind, and a resolution. None of them can
make a long text of a short number.

A resolution is a power of ten at the end, as in ``.3g>0.1``: no digit below it is shown, and a
smaller number is "< 0.1". It is for columns in which rounding decides what is smaller."""


def resolution(form: str) -> float:
    """Return the resolution of a column's format, 0 where it has none."""
    return float(form.partition(">")[2] or 0.0)


def cell(value: float | str | None, form: str) -> str:
    """Return a value as a column with a format shows it."""
    if value is None:
        return "-"
    plain, _, step = form.partition(">")
    if step:
        if abs(float(value)) < float(step):
            return f"< {step}"
        value = round(float(value), -round(math.log10(float(step))))
    return printable(format(value, plain))


Cell = float | str | None
"""A value of a table; None is shown as a dash."""

Column = tuple[str, str, Callable[[Any], Cell]]
"""Header with the unit, format, and the function that returns the value of an item."""


def finite_or_none(value: float) -> float | None:
    """Return a value for a table, None if it is not finite."""
    return value if math.isfinite(value) else None


@dataclass(frozen=True)
class ResultTable:
    """A table as printed and as stored.

    Attributes:
        title: Its title.
        columns: Header and format of each column, for example ``("T [s]", ".3f")``; an empty format
            is for text.
        rows: The values.
        note: A remark below it.

    Raises:
        ValueError: If a column has another format than `FORMAT` allows, or a row does not fit the
            columns.
    """

    title: str
    columns: Sequence[tuple[str, str]]
    rows: Sequence[Sequence[Cell]]
    note: str = ""

    def __post_init__(self) -> None:
        """Format the rows once, so that a table that is stored can be shown again."""
        for header, form in self.columns:
            if not FORMAT.fullmatch(form):
                raise ValueError(f"the column {header!r} has the format {form!r}")
        self.shown()

    @classmethod
    def of(cls, stored: Mapping[str, Any]) -> ResultTable:
        """Return the table of a ``result.json``.

        Raises:
            LookupError, TypeError, ValueError: If it is none.
        """
        columns = list(zip(stored["columns"], stored["formats"], strict=True))
        return cls(stored["title"], columns, stored["rows"], stored["note"])

    def stored(self) -> dict[str, Any]:
        """Return the table as ``result.json`` holds it."""
        headers, formats = ([column[i] for column in self.columns] for i in (0, 1))
        values = {"columns": headers, "formats": formats, "rows": list(self.rows)}
        return {"title": self.title, **values, "note": self.note}

    def shown(self) -> list[list[str]]:
        """Return the rows as text, each cell on one line."""
        return [
            [cell(value, form) for value, (_, form) in zip(row, self.columns, strict=True)]
            for row in self.rows
        ]

    def markdown(self) -> str:
        """Return the table in Markdown."""
        head = [
            [header for header, _ in self.columns],
            ["---:" if form else "---" for _, form in self.columns],
        ]
        rows = [[cell.replace("|", "\\|") for cell in row] for row in self.shown()]
        lines = "\n".join(f"| {' | '.join(row)} |" for row in [*head, *rows])
        return "\n\n".join(text for text in (f"**{self.title}**", lines, self.note) if text)


def make_table(
    title: str,
    items: Iterable[Any],
    *columns: Column,
    note: str = "",
    last_row: Sequence[Cell] = (),
) -> ResultTable:
    """Return a table with a row for each item, and perhaps a last row of other origin, such as the
    published values.
    """
    rows = [tuple(value(item) for *_, value in columns) for item in items]
    heads = [(header, form) for header, form, _ in columns]
    return ResultTable(title, heads, [*rows, last_row] if last_row else rows, note)
