"""A table of a lift, with what is needed to print its cells."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

Row = list[float | str | None]
"""Values of a row; None is shown as a dash."""

BLANK = "____________"
"""What is shown in place of a text that nobody entered: a line to be filled in by hand."""


class Table(NamedTuple):
    """A table of the report.

    Attributes:
        title: Title.
        columns: Header and format of each column; an empty format is for text.
        rows: Values; None is shown as a dash.
        note: What to know about it.
    """

    title: str
    columns: Sequence[tuple[str, str]]
    rows: Sequence[Row]
    note: str = ""

    def cells(self) -> list[list[str]]:
        """Return the rows as text."""
        formats = [form for _, form in self.columns]
        cells = []
        for row in self.rows:
            pairs = zip(row, formats, strict=True)
            cells.append(["-" if value is None else format(value, form) for value, form in pairs])
        return cells


def tonnes(mass: float) -> str:
    """Return a mass [kg] to read: in tonnes, or in kilograms where it is so small that tonnes would
    round it away.
    """
    return f"{mass / 1e3:.2f} t" if mass >= 100.0 else f"{mass:.3g} kg"


def place_text(point: Sequence[float] | np.ndarray, digits: int = 1) -> str:
    """Return a point to read [m], with some digits after the decimal point."""
    return f"({', '.join(f'{float(coordinate):.{digits}f}' for coordinate in point)})"
