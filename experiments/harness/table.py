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
    """Return the resolution of a column's format in the unit of the column, 0 if it has none."""
    return float(form.partition(">")[2] or 0.0)


def cell(value: float | str | None, form: str) -> str:
    """Return a value as a column with a format shows it."""
    if value is None:
        return "-"
    plain, _, smallest = form.partition(">")
    if smallest:
        if abs(float(value)) < float(smallest):
            return f"< {smallest}"
        # The resolution is a power of ten, 10^-k: round to k decimals.
        decimals = -round(math.log10(float(smallest)))
        value = round(float(value), decimals)
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
        """Return a table as `stored` wrote it into a ``result.json``.

        Raises:
            LookupError, TypeError, ValueError: If what was read is no such table.
        """
        columns = list(zip(stored["columns"], stored["formats"], strict=True))
        return cls(stored["title"], columns, stored["rows"], stored["note"])

    def stored(self) -> dict[str, Any]:
        """Return the table as ``result.json`` holds it."""
        return {
            "title": self.title,
            "columns": [header for header, _ in self.columns],
            "formats": [form for _, form in self.columns],
            "rows": list(self.rows),
            "note": self.note,
        }

    def shown(self) -> list[list[str]]:
        """Return the formatted cells of each row; no cell has a line break."""
        forms = [form for _, form in self.columns]
        rows = []
        for row in self.rows:
            rows.append([cell(value, form) for value, form in zip(row, forms, strict=True)])
        return rows

    def markdown(self) -> str:
        """Return the table in Markdown: title, table and note, with numbers set to the right."""
        headers = [header for header, _ in self.columns]
        alignment = ["---:" if form else "---" for _, form in self.columns]
        rows = [headers, alignment]
        for shown in self.shown():
            # A bar would end the cell.
            rows.append([text.replace("|", "\\|") for text in shown])

        lines = "\n".join(f"| {' | '.join(row)} |" for row in rows)
        parts = [f"**{self.title}**", lines, self.note]
        return "\n\n".join(part for part in parts if part)


def make_table(
    title: str,
    items: Iterable[Any],
    *columns: Column,
    note: str = "",
    last_row: Sequence[Cell] = (),
) -> ResultTable:
    """Return a table with a row for each item.

    Args:
        title: Title of the table.
        items: What the rows are about.
        *columns: Header, format, and function that returns the value of an item, for each column.
        note: Remark below the table.
        last_row: Values of one more row that is of no item, such as published values.
    """
    rows: list[Sequence[Cell]] = []
    for item in items:
        rows.append(tuple(value(item) for _, _, value in columns))
    if last_row:
        rows.append(last_row)
    heads = [(header, form) for header, form, _ in columns]
    return ResultTable(title, heads, rows, note)
