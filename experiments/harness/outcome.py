"""The outcome of an experiment: tables and claims, as printed and as stored."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import printable
from experiments.harness.terminal import blocks

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cranedyn.lifting.loads import Loads
    from cranedyn.recording import Run

MARKS = {True: "holds", False: "FAILS", None: "not judged"}
"""The word printed before a claim."""

FORMAT = re.compile(r"([+-]?,?(?:\.\d\d?)?[a-z%]?)(?:>(1e-\d\d?|0\.0{0,5}1|1))?")
"""Formats that a column may have: sign, thousands, digits, kind, and a resolution. None of them can
make a long text of a short number.

A resolution is a power of ten at the end, as in ``.3g>0.1``: no digit below it is shown, and a
smaller number is "< 0.1". It is for columns in which rounding decides what is smaller, as
``python -m tests.determined`` measures."""


def resolution(form: str) -> float:
    """Return the resolution of a column's format, 0 where it has none."""
    return float(form.partition(">")[2] or 0.0)


def cell(value: float | str | None, form: str) -> str:
    """Return a value as a column with a format shows it."""
    if value is None:
        return "-"
    plain, _, least = form.partition(">")
    if least:
        if abs(float(value)) < float(least):
            return f"< {least}"
        value = round(float(value), -round(math.log10(float(least))))
    return printable(format(value, plain))


Cell = float | str | None
"""A value of a table; None is shown as a dash."""

Column = tuple[str, str, Callable[[Any], Cell]]
"""Header with the unit, format, and the function that returns the value of an item."""


@dataclass(frozen=True)
class Table:
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
    def of(cls, stored: Mapping[str, Any]) -> Table:
        """Return the table of a ``result.json``.

        Raises:
            LookupError, TypeError, ValueError: If it is none.
        """
        columns = list(zip(stored["columns"], stored["formats"], strict=True))
        return cls(stored["title"], columns, stored["rows"], stored["note"])

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


def tabulate(
    title: str,
    items: Iterable[Any],
    columns: Sequence[Column],
    note: str = "",
    *,
    last_row: Sequence[Cell] = (),
) -> Table:
    """Return a table with a row for each item, and perhaps a last row of other origin, such as the
    published values.
    """
    rows = [tuple(value(item) for *_, value in columns) for item in items]
    heads = [(header, form) for header, form, _ in columns]
    return Table(title, heads, [*rows, last_row] if last_row else rows, note)


@dataclass(frozen=True)
class Claim:
    """A sentence that holds or does not; None if the arguments do not allow to judge it."""

    sentence: str
    holds: bool | None


@dataclass(frozen=True)
class Outcome:
    """The result of an experiment.

    Attributes:
        tables: In the order to print.
        claims: What the experiment shows.
        parameters: The numbers it was made with, with units in the names.
        trajectories: Runs, and loads of runs, to store, by file name without ending.
        figures: Figures to store, by file name without ending.
        recording: Runs to record for the viewer.
        texts: Texts to store, by file name.
    """

    tables: Sequence[Table]
    claims: Sequence[Claim]
    parameters: Mapping[str, object] = field(default_factory=dict)
    trajectories: Mapping[str, Trajectory | Loads] = field(default_factory=dict)
    figures: Mapping[str, Figure] = field(default_factory=dict)
    recording: Sequence[Run] = ()
    texts: Mapping[str, str] = field(default_factory=dict)


def show(outcome: Outcome) -> None:
    """Print tables, claims, and how many of these hold; on a terminal in its width, else in that of
    the variable COLUMNS or 80.
    """
    console = Console(highlight=False)
    for table in outcome.tables:
        for block in blocks(table, console.width):
            console.print(block)
        console.print()
    for claim in outcome.claims:
        if console.is_terminal:
            line = RichTable.grid(padding=(0, 1, 0, 0))
            line.add_row(Text(f"{MARKS[claim.holds]:10}"), Text(claim.sentence))
            console.print(line)
        else:  # a line each, for searching
            print(f"{MARKS[claim.holds]:11}{claim.sentence}")
    if outcome.claims:
        console.print(summary(outcome.claims))


def summary(claims: Sequence[Claim]) -> str:
    """Return how many claims hold, and how many were not judged, which counts as neither."""
    held = sum(bool(claim.holds) for claim in claims)
    unknown = sum(claim.holds is None for claim in claims)
    return f"{held} of {len(claims)} claims hold, {unknown} not judged."
