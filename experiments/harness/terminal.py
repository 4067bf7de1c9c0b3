"""Layout of a result table on a terminal of any width.

A number is never cut. The first of these that fits the width is printed:

1. the table as it is, with headers folded to at most `MAX_HEADER_LINES` lines;
2. the table transposed: a row for each column;
3. several tables one below the other, each of which repeats the columns that tell rows apart.
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

FRAME_WIDTH = 3
"""Width of the frame of a column [characters]: two spaces and a line."""

MAX_HEADER_LINES = 4
"""Largest number of lines of a folded header."""

KEY_WIDTH = 26
"""Width to which repeated columns of text are folded where a table is split [characters].

It leaves more than half of a terminal of 80 characters to the other columns.
"""


class TextColumn(NamedTuple):
    """A column of a table whose cells are formatted.

    Attributes:
        head: The header.
        cells: The formatted cells.
        is_text: Whether the cells may be folded at spaces; numbers may not.
    """

    head: str
    cells: tuple[str, ...]
    is_text: bool

    @property
    def unfolded_width(self) -> int:
        """Width in which neither the header nor a cell is folded [characters]."""
        return max(cell_len(text) for text in (self.head, *self.cells))

    @property
    def min_width(self) -> int:
        """Smallest width in which every word and every number is whole [characters]."""
        unbreakable = self.head.split()
        for cell in self.cells:
            unbreakable += cell.split() if self.is_text else [cell]
        return max((cell_len(text) for text in unbreakable), default=1)


def blocks(table: ResultTable, width: int) -> Iterator[RichTable]:
    """Yield the table in one or several blocks that fit a width [characters].

    The title stands above the first block and the note below the last.
    """
    groups = _arrange(columns_of(table), width)
    last = len(groups) - 1
    for i, columns in enumerate(groups):
        title = table.title if i == 0 else ""
        note = table.note if i == last else ""
        yield _block(columns, width, title, note)


class Excerpt(NamedTuple):
    """The beginning of a table.

    Attributes:
        block: What is printed.
        columns_left_out: Number of columns that do not fit.
        rows_left_out: Number of rows that do not fit.
    """

    block: RichTable
    columns_left_out: int
    rows_left_out: int


def excerpt(table: ResultTable, width: int, lines: int) -> Excerpt:
    """Return the first columns and rows of a table that fit a screen.

    The note is left out before a row is. One row is kept even where it does not fit.

    Args:
        table: The table.
        width: Width of the screen [characters].
        lines: Number of lines for the table, with title, header and note.
    """
    columns = columns_of(table)
    column_count = len(columns)
    while column_count > 1 and not _fits_folded(columns[:column_count], width):
        column_count -= 1

    # Only the rendered block tells how many lines it takes, since cells of text fold. So rows are
    # dropped one by one, from as many as there could be if each took a line.
    console = Console(width=width)
    most_rows = min(len(table.rows), max(lines, 1))
    for row_count in range(most_rows, -1, -1):
        first = [
            column._replace(cells=column.cells[:row_count]) for column in columns[:column_count]
        ]
        for note in dict.fromkeys((table.note, "")):
            block = _block(first, width, table.title, note)
            is_smallest = row_count <= 1 and not note
            if is_smallest or len(console.render_lines(block)) <= lines:
                return Excerpt(block, len(columns) - column_count, len(table.rows) - row_count)
    raise AssertionError("a table without rows and note is always returned")


def columns_of(table: ResultTable) -> list[TextColumn]:
    """Return the columns of a table with formatted cells."""
    rows = table.shown()
    return [
        TextColumn(head, tuple(row[i] for row in rows), not form)
        for i, (head, form) in enumerate(table.columns)
    ]


def _arrange(columns: list[TextColumn], width: int) -> list[list[TextColumn]]:
    """Return the columns of each block to print: all of them in one block, the transposed table,
    or several blocks, whichever fits first.
    """
    unfolded = _table_width(column.unfolded_width for column in columns)
    if unfolded <= width or _fits_folded(columns, width):
        return [columns]

    key_count = _key_count(columns)
    row_count = len(columns[0].cells)
    # A transposed table with as many columns as before would not be narrower. It needs one name a
    # row, for its header.
    if key_count == 1 and row_count < len(columns):
        transposed = _transposed(columns)
        if _table_width(column.min_width for column in transposed) <= width:
            return [transposed]
    return _split(columns, key_count, width)


def _fits_folded(columns: Sequence[TextColumn], width: int) -> bool:
    """Return whether columns fit a width with headers and text folded, but no header to more than
    `MAX_HEADER_LINES`.
    """
    if _table_width(column.min_width for column in columns) > width:
        return False
    return max(_header_lines(column) for column in columns) <= MAX_HEADER_LINES


def _key_count(columns: Sequence[TextColumn]) -> int:
    """Return the number of first columns that tell rows apart: one, or two where cells of the first
    come more than once.
    """
    names = columns[0].cells
    names_differ = len(set(names)) == len(names)
    return 1 if names_differ or len(columns) < 3 else 2


def _split(columns: list[TextColumn], key_count: int, width: int) -> list[list[TextColumn]]:
    """Return blocks that each begin with the key columns and are filled up to a width."""
    keys = columns[:key_count]
    key_width = 0
    for column in keys:
        folded = max(column.min_width, min(column.unfolded_width, KEY_WIDTH))
        key_width += folded + FRAME_WIDTH

    groups: list[list[TextColumn]] = []
    for column in columns[key_count:]:
        is_full = True
        if groups:
            with_column = [*groups[-1][key_count:], column]
            is_full = key_width + _table_width(c.min_width for c in with_column) > width
        if is_full:
            groups.append([*keys])
        groups[-1].append(column)
    return groups or [columns]


def _table_width(widths: Iterable[int]) -> int:
    """Return the width of a table of columns with these widths, frame included [characters]."""
    return sum(width + FRAME_WIDTH for width in widths) + 1


def _transposed(columns: Sequence[TextColumn]) -> list[TextColumn]:
    """Return a table with a row for each column, the headers in front.

    Its first column is text. The others hold numbers of different columns, which are not folded.
    """
    headers = TextColumn(columns[0].head, tuple(c.head for c in columns[1:]), is_text=True)
    result = [headers]
    for row in range(len(columns[0].cells)):
        name = columns[0].cells[row]
        values = tuple(column.cells[row] for column in columns[1:])
        result.append(TextColumn(name, values, is_text=False))
    return result


def _header_lines(column: TextColumn) -> int:
    """Return the number of lines of a header folded to the smallest width of its column."""
    lines = wrap(column.head, column.min_width, break_long_words=False, break_on_hyphens=False)
    return len(lines)


def _column_widths(columns: Sequence[TextColumn], width: int) -> list[int]:
    """Return the widths of columns [characters]: the smallest ones, widened where they are folded.

    What is left of the width goes to columns of text first, because folded text takes more lines,
    and then to the headers of numbers.
    """
    widths = [column.min_width for column in columns]
    spare = width - _table_width(widths)
    for is_text in (True, False):
        for i, column in enumerate(columns):
            if column.is_text is is_text:
                extra = max(0, min(spare, column.unfolded_width - widths[i]))
                widths[i] += extra
                spare -= extra
    return widths


def _block(columns: Sequence[TextColumn], width: int, title: str, note: str) -> RichTable:
    """Return a table for the terminal; without a line for a title or a note that is empty."""
    block = RichTable(title_justify="left", caption_justify="left")
    block.title = Text(title) if title else None
    block.caption = Text(note) if note else None
    for column, column_width in zip(columns, _column_widths(columns, width), strict=True):
        side: Literal["left", "right"] = "left" if column.is_text else "right"
        block.add_column(Text(column.head), justify=side, width=column_width, overflow="fold")
    for row in zip(*(column.cells for column in columns), strict=True):
        block.add_row(*(Text(cell) for cell in row))
    return block
