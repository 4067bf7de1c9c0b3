"""A table on a terminal of any width: upright with folded headers, turned on its side, or in
blocks; a number is never cut.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from textwrap import wrap
from typing import Literal, NamedTuple

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from experiments.harness.table import ResultTable

_FRAME = 3
"""Width of the frame of a column: two spaces and a line."""

_LINES = 4
"""Most lines of a folded header."""

_TEXT_WIDTH = 26
"""Width of a column of text where a table becomes blocks."""


class TextColumn(NamedTuple):
    """A column as text.

    Attributes:
        head: Its header.
        cells: Its cells.
        is_text: Whether its cells may be folded; numbers may not.
    """

    head: str
    cells: tuple[str, ...]
    is_text: bool

    @property
    def natural(self) -> int:
        """The width that needs no folding."""
        return max(map(cell_len, (self.head, *self.cells)))

    @property
    def least(self) -> int:
        """The smallest width in which every word and every number is whole."""
        cells = [w for cell in self.cells for w in cell.split()] if self.is_text else self.cells
        return max((cell_len(word) for word in (*self.head.split(), *cells)), default=1)


def blocks(table: ResultTable, width: int) -> Iterator[RichTable]:
    """Yield the table in one or several blocks that fit a terminal of a width [columns], the title
    over the first and the note under the last.
    """
    groups = _split(columns_of(table), width)
    for i, columns in enumerate(groups):
        last = i == len(groups) - 1
        yield _block(columns, width, "" if i else table.title, table.note if last else "")


def excerpt(table: ResultTable, width: int, lines: int) -> tuple[RichTable, int, int]:
    """Return the first columns and rows of a table that fit into a width [columns] and a number of
    lines, but one row at least, and how many columns and rows are left out.
    """
    columns, count = columns_of(table), len(table.columns)
    while count > 1 and (
        _total(column.least for column in columns[:count]) > width
        or max(_lines(column.head, column.least) for column in columns[:count]) > _LINES
    ):
        count -= 1
    console = Console(width=width)
    for rows in range(min(len(table.rows), max(lines, 1)), -1, -1):
        first = [c._replace(cells=c.cells[:rows]) for c in columns[:count]]
        for note in dict.fromkeys((table.note, "")):
            block = _block(first, width, table.title, note)
            if (rows <= 1 and not note) or len(console.render_lines(block)) <= lines:
                return block, len(columns) - count, len(table.rows) - rows
    raise AssertionError("no row always fits")


def columns_of(table: ResultTable) -> list[TextColumn]:
    """Return the columns of a table as text."""
    rows = table.shown()
    return [
        TextColumn(head, tuple(row[i] for row in rows), not form)
        for i, (head, form) in enumerate(table.columns)
    ]


def _split(columns: list[TextColumn], width: int) -> list[list[TextColumn]]:
    """Return all columns, turned ones, or blocks that repeat the first columns, whichever fits."""
    if _total(column.natural for column in columns) <= width or (
        _total(column.least for column in columns) <= width
        and max(_lines(column.head, column.least) for column in columns) <= _LINES
    ):
        return [columns]
    # One column tells rows apart, or two do.
    names = columns[0].cells
    keys = 1 if len(set(names)) == len(names) or len(columns) < 3 else 2
    turned = _turned(columns)
    if (
        keys == 1
        and len(names) < len(columns)
        and _total(column.least for column in turned) <= width
    ):
        return [turned]
    fixed = sum(max(c.least, min(c.natural, _TEXT_WIDTH)) + _FRAME for c in columns[:keys])
    result: list[list[TextColumn]] = []
    for column in columns[keys:]:
        if not result or fixed + _total(c.least for c in (*result[-1][keys:], column)) > width:
            result.append([*columns[:keys]])
        result[-1].append(column)
    return result or [columns]


def _total(widths: Iterable[int]) -> int:
    return sum(width + _FRAME for width in widths) + 1


def _turned(columns: Sequence[TextColumn]) -> list[TextColumn]:
    """Return the rows as columns, with the headers in front."""
    heads, *rows = zip(*((column.head, *column.cells) for column in columns), strict=True)
    return [TextColumn(row[0], row[1:], row is heads) for row in (heads, *rows)]


def _lines(head: str, width: int) -> int:
    """Return the number of lines of a header folded to a width."""
    return len(wrap(head, width, break_long_words=False, break_on_hyphens=False))


def _widths(columns: Sequence[TextColumn], width: int) -> list[int]:
    """Return the widths of columns: the least ones, and what is left goes to text first."""
    widths = [column.least for column in columns]
    spare = width - _total(widths)
    for is_text in (True, False):
        for i, column in enumerate(columns):
            if column.is_text is is_text:
                extra = max(0, min(spare, column.natural - widths[i]))
                widths[i], spare = widths[i] + extra, spare - extra
    return widths


def _block(columns: Sequence[TextColumn], width: int, title: str, note: str) -> RichTable:
    block = RichTable(title_justify="left", caption_justify="left")
    block.title, block.caption = (Text(text) if text else None for text in (title, note))
    for column, size in zip(columns, _widths(columns, width), strict=True):
        side: Literal["left", "right"] = "left" if column.is_text else "right"
        block.add_column(Text(column.head), justify=side, width=size, overflow="fold")
    for row in zip(*(column.cells for column in columns), strict=True):
        block.add_row(*map(Text, row))
    return block
