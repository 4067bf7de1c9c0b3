"""Tables of experiments in documents, between marks that name them, and which of them are stale.

A long table is a CSV file beside the document; the document then holds a link to it.

``python -m experiments.harness.document docs/results/control.md`` prints which cells differ from
the results in ``out``; with ``--write`` it puts the results in.
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


@dataclass(frozen=True)
class Block:
    """A part of a document that holds tables of an experiment.

    Attributes:
        first_line: Its first line, ``<!-- NAME: title -->`` or ``<!-- NAME csv: title -->``.
        experiment: Name of the experiment.
        title: Beginning of the titles of its tables; empty for all tables.
        in_csv: Whether each table is a CSV file beside the document, and the block a list of links.
        content: The lines between its first and its last, each with its end.
    """

    first_line: str
    experiment: str
    title: str
    in_csv: bool
    content: str = ""

    def text(self, content: str) -> str:
        """Return the block with another content."""
        return f"{self.first_line}\n{content}{END}\n"

    def selected(self, tables: Sequence[ResultTable]) -> list[ResultTable]:
        """Return those of the tables that belong into the block."""
        return [table for table in tables if table.title.startswith(self.title)]


@dataclass(frozen=True)
class Document:
    """A Markdown document with blocks for the tables of an experiment.

    A block begins with a line ``<!-- NAME: title -->`` and ends with ``<!-- end -->``; it holds the
    tables of the experiment NAME whose titles begin with that title, all of them if it is empty.
    ``<!-- NAME csv: title -->`` puts each of these tables into a CSV file beside the document and
    links to it; the document itself explains the columns.

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
            DataError: If a file cannot be written, or a block asks for a table that is missing.
        """
        text = self.filled(tables)
        for block, table in self._wanted(tables):
            if block.in_csv:
                write_text(self._csv_file(table), _csv(table))
        write_text(self.path, text)

    def filled(self, tables: Sequence[ResultTable]) -> str:
        """Return the text with these tables in place of those of the same titles.

        Raises:
            DataError: If a block asks for a table that is missing.
        """
        texts = []
        for piece in self.pieces:
            if isinstance(piece, str):
                texts.append(piece)
            elif piece.experiment == self.experiment:
                texts.append(piece.text(self._content(piece, tables)))
            else:
                texts.append(piece.text(piece.content))
        return "".join(texts)

    def _content(self, block: Block, tables: Sequence[ResultTable]) -> str:
        """Return what a block holds with these tables."""
        selection = self._tables(block, tables)
        if not block.in_csv:
            return "\n" + "\n".join(f"{table.markdown()}\n" for table in selection) + "\n"
        links = ""
        for table in selection:
            links += f"* [{_subject(table.title)}]({self._csv_file(table).name})\n"
        return f"\n{links}\n"

    def stale(self, tables: Sequence[ResultTable], *, subset: bool = False) -> list[str]:
        """Return a sentence for each cell or row that differs from newly computed tables.

        A number may differ by one in its last printed digit: half of that is rounding, and the
        other half allows for other processors and libraries.

        Args:
            tables: The tables of the experiment.
            subset: Whether rows may be missing in them.

        Raises:
            DataError: If a block asks for a table that is missing.
        """
        sentences = []
        for block, table in self._wanted(tables):
            for sentence in _differences(table, self._shown(block, table), subset):
                sentences.append(f"{self.path}, {table.title}: {sentence}.")
        return sentences

    def _wanted(self, tables: Sequence[ResultTable]) -> Iterator[tuple[Block, ResultTable]]:
        """Yield each block of the experiment with each of the tables that it asks for."""
        for block in self.pieces:
            if isinstance(block, Block) and block.experiment == self.experiment:
                for table in self._tables(block, tables):
                    yield block, table

    def _shown(self, block: Block, table: ResultTable) -> list[list[str]]:
        """Return the rows of a table as the document shows them, the header first."""
        if not block.in_csv:
            return _rows(block.content, table.title)
        file = self._csv_file(table)
        if f"({file.name})" not in block.content or not os.path.isfile(file):
            return []
        rows = csv.reader(io.StringIO(read_text(file)))
        return [[cell.strip() for cell in row] for row in rows]

    def _csv_file(self, table: ResultTable) -> Path:
        """Return the CSV file of a table: beside the document, named by the words of its title."""
        words = re.findall(r"[a-z]+", _subject(table.title).lower())
        return self.path.parent / f"{'_'.join([self.experiment, *words])[:80]}.csv"

    def _tables(self, block: Block, tables: Sequence[ResultTable]) -> list[ResultTable]:
        """Return the tables that a block asks for.

        Raises:
            DataError: If there is none.
        """
        result = block.selected(tables)
        if not result:
            raise DataError(
                f"{self.path} asks for a table {block.title!r}, which is not among those of "
                f"{self.experiment}."
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
        DataError: If a block does not end before the next one begins.
    """
    pieces: list[str | Block] = []
    block: Block | None = None
    content = ""
    for line in text.splitlines(keepends=True):
        if block is None:
            block = _begun_block(line)
            content = ""
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
    words, colon, title = text.removeprefix("<!--").removesuffix("-->").partition(":")
    experiment, _, form = words.strip().partition(" ")
    if not colon or not experiment.isidentifier() or form not in ("", "csv"):
        return None
    return Block(text, experiment, title.strip(), in_csv=form == "csv")


def _experiments(pieces: Sequence[str | Block]) -> list[str]:
    """Return the names of the experiments that have a block, each once."""
    names = [piece.experiment for piece in pieces if isinstance(piece, Block)]
    return list(dict.fromkeys(names))


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
    verb = "were" if options.write else "are"
    print(*stale, f"{len(stale)} cells or rows {verb} stale.", sep="\n")
    return FAILED if stale and not options.write else 0


if __name__ == "__main__":
    sys.exit(main())
