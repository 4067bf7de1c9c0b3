"""A table on a terminal of any width: as it is, with folded heads, turned on its side, or in
blocks; a number is never cut.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

from rich.cells import cell_len
from rich.table import Table as RichTable
from rich.text import Text

if TYPE_CHECKING:
    from experiments.harness.outcome import Table

_FRAME = 3
"""What a column takes beside its words: two spaces and a line."""

_LINES = 4
"""Most lines of a head that is folded."""

_NAME = 26
"""Width that a column of text keeps where a table becomes blocks."""


class Column(NamedTuple):
    """A column as text.

    Attributes:
        head: Its header.
        cells: Its cells.
        words: Whether the cells are text, which may be folded; a number may not.
    """

    head: str
    cells: tuple[str, ...]
    words: bool

    @property
    def natural(self) -> int:
        """The width that needs no folding."""
        return max(map(cell_len, (self.head, *self.cells)))

    @property
    def least(self) -> int:
        """The smallest width in which every word and every number stands whole."""
        cells = [word for cell in self.cells for word in cell.split()] if self.words else self.cells
        return max((cell_len(word) for word in (*self.head.split(), *cells)), default=1)


def blocks(table: Table, width: int) -> Iterator[RichTable]:
    """The table as one or several that fit a width, the title over the first and the note under the
    last.

    Args:
        table: What to show.
        width: Of the terminal [columns].
    """
    columns = columns_of(table)
    parts = _parts(columns, width)
    for i, part in enumerate(parts):
        yield _drawn(
            part, width, table.title if i == 0 else "", table.note if i == len(parts) - 1 else ""
        )


def columns_of(table: Table) -> list[Column]:
    """The columns of a table as text."""
    rows = table.shown()
    return [
        Column(head, tuple(row[i] for row in rows), not form)
        for i, (head, form) in enumerate(table.columns)
    ]


def _parts(columns: Sequence[Column], width: int) -> list[list[Column]]:
    """The columns side by side if they fit, else turned if that fits, else with the first ones
    again in every block.
    """
    heads = max(_lines(column.head, column.least) for column in columns)
    if _taken(column.natural for column in columns) <= width:
        return [[*columns]]
    if _taken(column.least for column in columns) <= width and heads <= _LINES:
        return [[*columns]]
    keys = _keys(columns)
    turned = _turned(columns)
    if (
        keys == 1
        and len(columns[0].cells) < len(columns)
        and _taken(column.least for column in turned) <= width
    ):
        return [turned]
    names = sum(max(column.least, min(column.natural, _NAME)) + _FRAME for column in columns[:keys])
    found: list[list[Column]] = []
    for column in columns[keys:]:
        if not found or names + _taken(one.least for one in (*found[-1][keys:], column)) > width:
            found.append([*columns[:keys]])
        found[-1].append(column)
    return found or [[*columns]]


def _taken(widths: Iterable[int]) -> int:
    return sum(width + _FRAME for width in widths) + 1


def _keys(columns: Sequence[Column]) -> int:
    """How many columns, of two at most, tell one row from another."""
    return 1 if len(set(columns[0].cells)) == len(columns[0].cells) or len(columns) < 3 else 2


def _turned(columns: Sequence[Column]) -> list[Column]:
    """Rows as columns, with the heads in front."""
    first, rest = columns[0], columns[1:]
    heads = Column(first.head, tuple(column.head for column in rest), True)
    return [
        heads,
        *(
            Column(head, tuple(column.cells[i] for column in rest), False)
            for i, head in enumerate(first.cells)
        ),
    ]


def _lines(head: str, width: int) -> int:
    """In how many lines a head folds."""
    lines, room = 1, 0
    for word in head.split():
        room = room + 1 + cell_len(word) if room else cell_len(word)
        if room > width:
            lines, room = lines + 1, cell_len(word)
    return lines


def _widths(columns: Sequence[Column], width: int) -> list[int]:
    """What is left beyond the least goes where it is missed, to the columns of text first."""
    found = [column.least for column in columns]
    left = width - _taken(found)
    for words in (True, False):
        for i, column in enumerate(columns):
            if column.words is words:
                more = max(0, min(left, column.natural - found[i]))
                found[i], left = found[i] + more, left - more
    return found


def _drawn(columns: Sequence[Column], width: int, title: str, note: str) -> RichTable:
    drawn = RichTable(
        title=Text(title) if title else None,
        title_justify="left",
        caption=Text(note) if note else None,
        caption_justify="left",
    )
    for column, wide in zip(columns, _widths(columns, width), strict=True):
        drawn.add_column(
            Text(column.head),
            justify="left" if column.words else "right",
            width=wide,
            overflow="fold",
        )
    for row in zip(*(column.cells for column in columns), strict=True):
        drawn.add_row(*map(Text, row))
    return drawn
