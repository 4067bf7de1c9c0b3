"""Tables of experiments in documents, between marks that name them, and which of them are stale.

A table stands in the document itself, in a CSV file beside it to which the document links, or in
both. In the last case the table on the page is made from the file, so the two can be compared
without running the experiment.

``python -m experiments.harness.document docs/results/control.md`` prints which cells differ from
the results in ``out``, and which tables differ from their files; with ``--write`` it puts the
results in.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import math
import os
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cranedyn.command import FAILED, Parser, command
from cranedyn.data.files import check_writable, parse_json, read_bytes, read_text, write_text
from cranedyn.errors import DataError, quoted
from experiments.harness.table import ResultTable, resolution

END = "<!-- end -->"
"""Last line of a block."""


_FILE_NAME = re.compile(r"[a-z0-9_]+\.csv")
"""Name of a CSV file beside a document; it cannot name another folder."""


@dataclass(frozen=True)
class Block:
    """A part of a document that holds tables of an experiment.

    Attributes:
        first_line: Its first line, see `Document`.
        experiment: Name of the experiment.
        title: Beginning of the titles of its tables; empty for all tables.
        file: Name of the CSV file of its table, which lies beside the document; empty if there is
            none.
        is_shown: Whether the document shows the tables. If not, it only links to the file.
        content: The lines between its first and its last, each with its end.
    """

    first_line: str
    experiment: str
    title: str
    file: str = ""
    is_shown: bool = True
    content: str = ""

    def text(self, content: str) -> str:
        """Return the block with another content."""
        return f"{self.first_line}\n{content}{END}\n"

    def selected(self, tables: Sequence[ResultTable]) -> list[ResultTable]:
        """Return those of the tables that belong into the block."""
        return [table for table in tables if table.title.startswith(self.title)]

    def filled(self, tables: Sequence[ResultTable]) -> str:
        """Return what the block holds with these tables, which are those that it asks for."""
        if not self.file:
            return "\n" + "\n".join(f"{table.markdown()}\n" for table in tables) + "\n"
        (table,) = tables
        if not self.is_shown:
            return f"\n* [{_subject(table.title)}]({self.file})\n\n"
        return self.shown(_heading(table.title), _csv_rows(_csv(table)))

    def shown(self, heading: str, rows: Sequence[Sequence[str]]) -> str:
        """Return what the block holds if it shows the table in its file.

        Args:
            heading: What stands above the table.
            rows: Rows of the file, the header first.
        """
        return f"\n**{heading}** {self._link}\n\n{_markdown(rows)}\n"

    @property
    def _link(self) -> str:
        """The link to the file that stands behind the heading of its table."""
        return f"([CSV]({self.file}))"

    def shown_heading(self) -> str:
        """Return the heading of the table that the block shows; empty if it shows none."""
        for line in self.content.splitlines():
            heading = line.removesuffix(f"** {self._link}")
            if heading != line and heading.startswith("**"):
                return heading.removeprefix("**")
        return ""

    def matches_file(self, folder: Path) -> bool:
        """Return whether the block shows or links its file, if it has one, as the file is.

        Args:
            folder: Folder of the document.
        """
        if not self.file:
            return True
        if not os.path.isfile(folder / self.file):
            return False
        if not self.is_shown:
            return f"]({self.file})" in self.content
        rows = _csv_rows(read_text(folder / self.file))
        if len({len(row) for row in rows}) != 1:
            return False
        return self.content == self.shown(self.shown_heading(), rows)


@dataclass(frozen=True)
class Document:
    """A Markdown document with blocks for the tables of an experiment.

    A block ends with ``<!-- end -->``, and its first line says what it holds:

    * ``<!-- NAME: title -->``: the tables of the experiment NAME whose titles begin with that
      title, all of them if it is empty, with their notes;
    * ``<!-- NAME FILE.csv: title -->``: a link to the one such table, in that file beside the
      document;
    * ``<!-- NAME table FILE.csv: title -->``: the table in that file, and the link. The document
      itself explains the columns.

    Attributes:
        path: Its file.
        experiment: The experiment whose tables are put in.
        pieces: Its lines outside of blocks, each with its end, and its blocks, in turn.
    """

    path: Path
    experiment: str
    pieces: Sequence[str | Block]

    def write(self, tables: Sequence[ResultTable]) -> None:
        """Write the document with these tables in place of those of the same titles.

        Raises:
            DataError: If a file cannot be written, a block asks for a table that is missing, or a
                block with one file asks for several.
        """
        text = self.filled(tables)
        for block, table in self._wanted(tables):
            if block.file:
                write_text(self.path.parent / block.file, _csv(table))
        write_text(self.path, text)

    def filled(self, tables: Sequence[ResultTable]) -> str:
        """Return the text with these tables in place of those of the same titles.

        Raises:
            DataError: If a block asks for a table that is missing, or a block with one file asks
                for several.
        """
        texts = []
        for piece in self.pieces:
            if isinstance(piece, str):
                texts.append(piece)
            elif piece.experiment == self.experiment:
                texts.append(piece.text(piece.filled(self._tables(piece, tables))))
            else:
                texts.append(piece.text(piece.content))
        return "".join(texts)

    def stale(self, tables: Sequence[ResultTable], *, subset: bool = False) -> list[str]:
        """Return a sentence for each cell or row that differs from newly computed tables.

        A number may differ by one in its last printed digit: half of that is rounding, and the
        other half allows for other processors and libraries.

        Args:
            tables: The tables of the experiment.
            subset: Whether rows may be missing in them.

        Raises:
            DataError: If a block asks for a table that is missing, or a block with one file asks
                for several.
        """
        sentences = []
        for block, table in self._wanted(tables):
            for sentence in _differences(table, self._stored(block, table), subset):
                sentences.append(f"{self.path}, {table.title}: {sentence}.")
        return sentences

    def _wanted(self, tables: Sequence[ResultTable]) -> Iterator[tuple[Block, ResultTable]]:
        """Yield each block of the experiment with each of the tables that it asks for."""
        for block in self.pieces:
            if isinstance(block, Block) and block.experiment == self.experiment:
                for table in self._tables(block, tables):
                    yield block, table

    def _stored(self, block: Block, table: ResultTable) -> list[list[str]]:
        """Return the rows of a table as the document or its file has them, the header first; none
        if they are not there.
        """
        if not block.file:
            return _rows(block.content, table.title)
        file = self.path.parent / block.file
        if f"]({block.file})" not in block.content or not os.path.isfile(file):
            return []
        return _csv_rows(read_text(file))

    def _tables(self, block: Block, tables: Sequence[ResultTable]) -> list[ResultTable]:
        """Return the tables that a block asks for.

        Raises:
            DataError: If there is none, or several for one file.
        """
        result = block.selected(tables)
        if not result:
            raise DataError(
                f"{self.path} asks for a table {block.title!r}, which is not among those of "
                f"{self.experiment}."
            )
        if block.file and len(result) > 1:
            raise DataError(
                f"{self.path}: the title {block.title!r} of the block for {block.file} is the "
                f"beginning of those of {len(result)} tables; make it longer, up to one table."
            )
        return result


def read_document(path: str | Path, experiment: str) -> Document:
    """Read a document that shows tables of an experiment.

    Raises:
        DataError: If the file cannot be read or written, has no block for the experiment, or one
            that begins before another has ended.
    """
    try:
        text = read_bytes(path).decode("utf-8").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise DataError(f"Cannot read {path}: it is not text.") from error
    pieces = _split(path, text)
    if experiment not in _experiments(pieces):
        raise DataError(
            f"{path} has no lines <!-- {experiment}: --> and <!-- end -->; the tables go between "
            "them."
        )
    check_writable(path)
    return Document(Path(path), experiment, pieces)


def _split(path: str | Path, text: str) -> list[str | Block]:
    """Return the lines of a document outside of blocks, and its blocks, in turn.

    Args:
        path: File of the document, for messages.
        text: Its text.

    Raises:
        DataError: If a block does not end before the next one begins, or has no beginning.
    """
    pieces: list[str | Block] = []
    block: Block | None = None
    content = ""
    for line in text.splitlines(keepends=True):
        if block is None:
            block = _begun_block(line)
            content = ""
            if block is None and line.strip() == END:
                raise DataError(
                    f"{path} has a line {END} without a block before it. A block begins with "
                    "<!-- NAME: title -->, <!-- NAME FILE.csv: title --> or "
                    "<!-- NAME table FILE.csv: title -->."
                )
            if block is None:
                pieces.append(line)
        elif line.strip() == END:
            pieces.append(replace(block, content=content))
            block = None
        elif "<!--" in line or "-->" in line:
            break
        else:
            content += line
    if block is not None:
        raise DataError(
            f"{path}: the block {quoted(block.first_line)} has no line {END} before the next one "
            "begins."
        )
    return pieces


def _begun_block(line: str) -> Block | None:
    """Return the block that a line begins, without content; None if it begins none."""
    text = line.strip()
    if not (text.startswith("<!--") and text.endswith("-->")):
        return None
    description, colon, title = text.removeprefix("<!--").removesuffix("-->").partition(":")
    experiment, _, form = description.strip().partition(" ")
    file = form.removeprefix("table ")
    has_known_form = not form or _FILE_NAME.fullmatch(file) is not None
    if not colon or not experiment.isidentifier() or not has_known_form:
        return None
    is_shown = not file or form != file
    return Block(text, experiment, title.strip(), file, is_shown)


def _experiments(pieces: Sequence[str | Block]) -> list[str]:
    """Return the names of the experiments that have a block, each once."""
    names = [piece.experiment for piece in pieces if isinstance(piece, Block)]
    return list(dict.fromkeys(names))


def _heading(title: str) -> str:
    """Return a title without the coordinates that follow it, such as ": (x, l)"."""
    return re.sub(r": \(.*", "", title)


def _subject(title: str) -> str:
    """Return a title without what follows it in brackets: units such as " [m]", coordinates such as
    ": (x, l)".
    """
    return re.sub(r"(: \(| \[).*", "", title)


def _csv(table: ResultTable) -> str:
    """Return a table as the text of a CSV file."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([header.strip() for header, _ in table.columns])
    forms = [form for _, form in table.columns]
    for row in table.shown():
        # Programs that read the file take a separator of thousands for one of columns.
        cells = [
            cell.replace(",", "") if form else cell for cell, form in zip(row, forms, strict=True)
        ]
        writer.writerow(cells)
    return text.getvalue()


def _csv_rows(text: str) -> list[list[str]]:
    """Return the rows of a CSV file, the header first."""
    return [[cell.strip() for cell in row] for row in csv.reader(io.StringIO(text))]


def _markdown(rows: Sequence[Sequence[str]]) -> str:
    """Return rows, the header first, as a Markdown table with columns of numbers set to the
    right.
    """
    header, *body = rows
    alignment = []
    for column in range(len(header)):
        is_numeric = all(_is_number(row[column]) for row in body)
        alignment.append("---:" if is_numeric else "---")
    text = ""
    for row in (header, alignment, *body):
        # A bar would end the cell.
        cells = [cell.replace("|", "\\|") for cell in row]
        text += f"| {' | '.join(cells)} |\n"
    return text


def _is_number(cell: str) -> bool:
    """Return whether a cell is a number, a number below the resolution, or the dash of none."""
    if cell == "-":
        return True
    try:
        float(cell.removeprefix("< "))
    except ValueError:
        return False
    return True


def _rows(content: str, title: str) -> list[list[str]]:
    """Return the rows of a Markdown table with a title, the header first; none if it is not there.

    Args:
        content: Text of a block.
        title: Title of the table.
    """
    text = content.partition(f"**{title}**\n\n")[2].partition("\n\n")[0]
    lines = [line for line in text.splitlines() if line.startswith("|")]
    rows = []
    for line in lines:
        cells = line.strip().strip("|").split("|")
        rows.append([cell.strip() for cell in cells])
    # The second line holds the alignment of the columns.
    return [*rows[:1], *rows[2:]]


def _differences(table: ResultTable, rows: Sequence[Sequence[str]], subset: bool) -> Iterator[str]:
    """Yield in words how a newly computed table differs from what a document shows of it.

    Args:
        table: The newly computed table.
        rows: Rows that the document shows, the header first.
        subset: Whether rows may be missing in the new table.
    """
    headers = [header.strip() for header, _ in table.columns]
    if not rows or list(rows[0]) != headers:
        yield "it is not there, or has other columns"
        return
    old_rows = _by_name(rows[1:])
    new_rows = _by_name([(*cells, table.rows[i]) for i, cells in enumerate(table.shown())])
    if not subset:
        yield from (f"its row {name!r} was not made" for name in old_rows if name not in new_rows)
    yield from (f"a row {name!r} is not there" for name in new_rows if name not in old_rows)
    for name, (*cells, values) in new_rows.items():
        for (header, form), old, new, value in zip(
            table.columns, old_rows.get(name, cells), cells, values, strict=True
        ):
            if not (old == new or _rounds(old, value, form)):
                yield f"{header.strip()} of {name!r} is {old}, now {new}"


def _by_name(rows: Sequence[Sequence[Any]]) -> dict[str, Sequence[Any]]:
    """Return rows by their first cell, with "#2", "#3" after one that occurs again."""
    result: dict[str, Sequence[Any]] = {}
    for row in rows:
        count = sum(name == row[0] or name.startswith(f"{row[0]} #") for name in result)
        result[f"{row[0]} #{count + 1}" if count else row[0]] = row
    return result


def _rounds(cell: str, value: float | str | None, form: str) -> bool:
    """Return whether a cell shows a number to within one in its last digit."""
    if value is None or isinstance(value, str) or cell == "-":
        return False
    if cell[0] == "<":
        # "< 0.1" says that the number is from 0 to 0.1: take the middle.
        number = resolution(form) / 2.0
    else:
        number = float(cell.replace(",", ""))
    # Decimal fractions are no binary ones, so a difference of exactly one digit is rounded.
    return abs(number - value) <= (1.0 + 1e-9) * last_digit(value, form)


def last_digit(value: float, form: str) -> float:
    """Return the value of one in the last digit that a format shows, for example 0.01 for ".2f".

    Args:
        value: The number that is shown; the last digit of formats e and g depends on its size.
        form: The format, as a column of a table has it.

    Returns:
        The value; 0 for formats of whole numbers and for numbers that are not finite, which have to
        agree exactly.
    """
    match = re.fullmatch(r"[+-]?,?(?:\.(\d+))?([a-z%]?)", form.partition(">")[0])
    if match is None or match[2] not in "efg" or not math.isfinite(value):
        return 0.0
    digits = 6 if match[1] is None else int(match[1])
    if match[2] == "f":
        return max(10.0**-digits, resolution(form))
    exponent = math.floor(math.log10(abs(value))) if value else 0
    # Format e counts the digits after the point, format g all of them.
    decimals = digits - 1 if match[2] == "g" else digits
    return max(10.0 ** (exponent - decimals), resolution(form))


@contextmanager
def naming_result(file: Path) -> Iterator[None]:
    """Name the file in the errors that occur while its content is read.

    Raises:
        DataError: If it cannot be read, or is not the result of an experiment.
    """
    try:
        yield
    except json.JSONDecodeError as error:
        raise DataError(f"Cannot read {file}: it is not JSON.") from error
    except OSError as error:
        raise DataError(f"Cannot read {error.filename}: {error.strerror}.") from error
    except (LookupError, TypeError, AttributeError, ValueError, RecursionError) as error:
        raise DataError(
            f"Cannot read {file}: it is not the result of an experiment ({type(error).__name__}: "
            f"{error})."
        ) from error


def unlike_files(path: str | Path) -> list[str]:
    """Return a sentence for each block of a document that does not show, or link to, its CSV file
    as the file is.

    Raises:
        DataError: If the document cannot be read, or a block does not end.
    """
    sentences = []
    for block in _split(path, read_text(path)):
        if isinstance(block, Block) and not block.matches_file(Path(path).parent):
            sentences.append(f"{path}: the block of {block.file} is not what the file holds.")
    return sentences


def main(argv: Sequence[str] | None = None) -> int:
    """Compare documents with stored results; exit code 0 if they agree, 1 if not, 2 for bad
    arguments.
    """
    parser = Parser(
        prog="python -m experiments.harness.document",
        description="Say which cells of documents are stale.",
        example="python -m experiments.harness.document docs/results/article.md",
    )
    text = "documents with tables between marks"
    parser.add_argument("documents", nargs="+", metavar="FILE.md", help=text)
    text = "folder of the results (default: %(default)s)"
    parser.add_argument("--results", metavar="DIR", type=Path, default=Path("out"), help=text)
    parser.add_argument("--write", action="store_true", help="put the tables of the results in")
    return command(lambda: _main(parser.parse_args(argv)))


def _main(options: argparse.Namespace) -> int:
    """Print which cells are stale, write the tables if asked to, and return the exit code."""
    stale = []
    for path in options.documents:
        for name in _experiments(_split(path, read_text(path))):
            file = options.results / name / "result.json"
            if not os.path.isfile(file):
                print(
                    f"{path}: there is no result of {name} in {options.results}; its tables are "
                    "not looked at."
                )
                continue
            document = read_document(path, name)
            with naming_result(file):
                tables = [ResultTable.of(item) for item in parse_json(read_text(file))["tables"]]
            stale += document.stale(tables)
            if options.write:
                document.write(tables)
        stale += unlike_files(path)
    verb = "were" if options.write else "are"
    print(*stale, f"{len(stale)} cells or rows {verb} stale.", sep="\n")
    return FAILED if stale and not options.write else 0


if __name__ == "__main__":
    sys.exit(main())
