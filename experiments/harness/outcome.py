"""What an experiment leaves behind: tables and claims, as printed and as kept."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
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
"""What is said of a claim."""

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
    """Return a value as a column of a format shows it."""
    if value is None:
        return "-"
    plain, _, least = form.partition(">")
    if least:
        if abs(float(value)) < float(least):
            return f"< {least}"
        value = round(float(value), -round(math.log10(float(least))))
    return printable(format(value, plain))


@dataclass(frozen=True)
class Table:
    """A table as printed and as kept.

    Attributes:
        title: What it shows.
        columns: Header and format of each column, for example ``("T [s]", ".3f")``; an empty format
            is for text.
        rows: The values; None is shown as a dash.
        note: What to know about it.

    Raises:
        ValueError: If a column has another format than `FORMAT` allows, or a row does not fit the
            columns.
    """

    title: str
    columns: Sequence[tuple[str, str]]
    rows: Sequence[Sequence[float | str | None]]
    note: str = ""

    def __post_init__(self) -> None:
        """Show the rows once, so that whatever is kept can be shown again."""
        for header, form in self.columns:
            if not FORMAT.fullmatch(form):
                raise ValueError(f"the column {header!r} has the format {form!r}")
        self.shown()

    @classmethod
    def of(cls, kept: Mapping[str, Any]) -> Table:
        """The table that stands in a ``result.json``.

        Raises:
            LookupError, TypeError, ValueError: If it is none.
        """
        return cls(
            kept["title"],
            list(zip(kept["columns"], kept["formats"], strict=True)),
            kept["rows"],
            kept["note"],
        )

    def shown(self) -> list[list[str]]:
        """The rows as text; a cell is one line, whatever is quoted in it."""
        return [
            [cell(value, form) for value, (_, form) in zip(row, self.columns, strict=True)]
            for row in self.rows
        ]

    def markdown(self) -> str:
        """The table in Markdown."""
        head = [
            [header for header, _ in self.columns],
            ["---:" if form else "---" for _, form in self.columns],
        ]
        rows = [[cell.replace("|", "\\|") for cell in row] for row in self.shown()]
        lines = "\n".join(f"| {' | '.join(row)} |" for row in [*head, *rows])
        return "\n\n".join(part for part in (f"**{self.title}**", lines, self.note) if part)


@dataclass(frozen=True)
class Claim:
    """A sentence that holds or does not, or could not be judged (None) under the arguments
    given.
    """

    sentence: str
    holds: bool | None


@dataclass(frozen=True)
class Outcome:
    """What an experiment leaves behind.

    Attributes:
        tables: In the order to print.
        claims: What it set out to show.
        parameters: What it was made with.
        trajectories: Runs to keep, and loads of runs, by file name without ending.
        figures: Figures to keep, by file name without ending.
        recording: Runs to record for the viewer.
        texts: Texts to keep, by file name.
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
        for part in blocks(table, console.width):
            console.print(part)
        console.print()
    for claim in outcome.claims:
        line = RichTable.grid(padding=(0, 1, 0, 0))
        line.add_row(Text(f"{MARKS[claim.holds]:10}"), Text(claim.sentence))
        if console.is_terminal:
            console.print(line)
        else:  # for whoever searches in it, a line each
            print(f"{MARKS[claim.holds]:11}{claim.sentence}")
    if outcome.claims:
        console.print(summary(outcome.claims))


def summary(claims: Sequence[Claim]) -> str:
    """How many claims hold, and how many were not judged, which counts as neither."""
    held, unknown = (
        sum(bool(claim.holds) for claim in claims),
        sum(claim.holds is None for claim in claims),
    )
    return f"{held} of {len(claims)} claims hold, {unknown} not judged."
