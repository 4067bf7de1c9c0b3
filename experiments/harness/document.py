"""Documents that show tables of experiments as printed, between marks that say which, and whether
they still do.

``python -m experiments.harness.document README.md docs/control.md`` says which cells are no longer
those of the results in ``out``; with ``--write`` it puts these in.
"""

from __future__ import annotations

import argparse
import math
import os
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from cranedyn.command import FAILED, Parser, command
from cranedyn.data.files import check_writable, parse_json, read_bytes, read_text, write_text
from cranedyn.errors import DataError, quoted
from experiments.harness.outcome import Table, resolution

_BLOCK = re.compile(
    r"(<!-- (?P<experiment>\w+): ?(?P<title>[^\n]*?) ?-->\n)(?P<content>.*?)(<!-- end -->\n)",
    re.DOTALL,
)

_Item = TypeVar("_Item")


@dataclass(frozen=True)
class Document:
    """A Markdown document with blocks for the tables of an experiment.

    A block begins with a line ``<!-- NAME: title -->`` and ends with ``<!-- end -->``; it holds the
    tables of the experiment NAME whose titles begin with that title, all of them where none is
    given.

    Attributes:
        path: Where it is.
        experiment: Whose tables are put in.
        text: What it holds.
    """

    path: Path
    experiment: str
    text: str

    def write(self, tables: Sequence[Table]) -> None:
        """Put tables where those of the same titles were.

        Raises:
            DataError: If the file cannot be written, or a block asks for a table that is not there.
        """
        write_text(self.path, self.filled(tables))

    def filled(self, tables: Sequence[Table]) -> str:
        """The text with tables where those of the same titles were.

        Raises:
            DataError: If a block asks for a table that is not there.
        """

        def filled(block: re.Match[str]) -> str:
            if block["experiment"] != self.experiment:
                return block[0]
            return "\n".join(
                [
                    block[1],
                    *(f"{table.markdown()}\n" for table in self._asked(block, tables)),
                    block[5],
                ]
            )

        return _BLOCK.sub(filled, self.text)

    def stale(self, tables: Sequence[Table], *, part: bool = False) -> list[str]:
        """Where it shows something else than tables made anew, a sentence each.

        A number may be off by one of its last digit: half of it is rounding, and the other half is
        what other processors and libraries may add to a digit that is printed.

        Args:
            tables: Those of the experiment.
            part: Whether rows that were not made are left alone.

        Raises:
            DataError: If a block asks for a table that is not there.
        """
        return [
            f"{self.path}, {table.title}: {sentence}."
            for block in _BLOCK.finditer(self.text)
            if block["experiment"] == self.experiment
            for table in self._asked(block, tables)
            for sentence in _differences(table, _shown(block["content"], table.title), part)
        ]

    def _asked(self, block: re.Match[str], tables: Sequence[Table]) -> list[Table]:
        shown = [table for table in tables if table.title.startswith(block["title"])]
        if not shown:
            raise DataError(
                f"{self.path} asks for a table {block['title']!r}, which is not among those of "
                f"{self.experiment}."
            )
        return shown


def read_document(path: str | Path, experiment: str) -> Document:
    """A document as it is.

    Raises:
        DataError: If the file cannot be read or written, has no block for the experiment, or one
            that begins before another has ended.
    """
    try:
        text = read_bytes(path).decode("utf-8").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise DataError(f"Cannot read {path}: it is not text.") from error
    blocks = list(_BLOCK.finditer(text))
    for block in blocks:
        if "<!--" in block["content"] or "-->" in block["content"]:
            raise DataError(
                f"{path}: the block {quoted(block[1].strip())} has no line <!-- end --> before the "
                "next one begins."
            )
    if not any(block["experiment"] == experiment for block in blocks):
        raise DataError(
            f"{path} has no lines <!-- {experiment}: --> and <!-- end -->; the tables go between "
            "them."
        )
    check_writable(path)
    return Document(Path(path), experiment, text)


def _shown(content: str, title: str) -> list[list[str]]:
    """Rows of the table with a title in a block, its head first; none if it is not there."""
    _, _, rest = content.partition(f"**{title}**\n\n")
    lines = [line for line in rest.partition("\n\n")[0].splitlines() if line.startswith("|")]
    rows = [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in lines]
    return [*rows[:1], *rows[2:]]


def _differences(table: Table, shown: Sequence[Sequence[str]], part: bool) -> Iterator[str]:
    """What is shown of a table and is not in it any more, or is in it and not shown."""
    headers = [header.strip() for header, _ in table.columns]
    if not shown or list(shown[0]) != headers:
        yield "it is not there, or has other columns"
        return
    before = _by_name([row[0] for row in shown[1:]], shown[1:])
    cells = table.shown()
    made = _by_name([row[0] for row in cells], list(zip(cells, table.rows, strict=True)))
    if not part:
        yield from (f"its row {name!r} was not made" for name in before if name not in made)
    yield from (f"a row {name!r} is not there" for name in made if name not in before)
    for name, (row, values) in made.items():
        forms = [form for _, form in table.columns]
        for header, form, old, new, value in zip(
            headers, forms, before.get(name, row), row, values, strict=True
        ):
            if not (old == new or _rounds(old, value, form)):
                yield f"{header} of {name!r} is {old}, now {new}"


def _by_name(names: Sequence[str], items: Sequence[_Item]) -> dict[str, _Item]:
    """Items by name, a name that comes again with its number."""
    found: dict[str, _Item] = {}
    for name, item in zip(names, items, strict=True):
        again = sum(other == name or other.startswith(f"{name} #") for other in found)
        found[f"{name} #{again + 1}" if again else name] = item
    return found


def _rounds(shown: str, value: float | str | None, form: str) -> bool:
    """Whether a cell is what a value is rounded to."""
    if value is None or isinstance(value, str) or shown == "-":
        return False
    before = resolution(form) / 2.0 if shown[0] == "<" else float(shown.replace(",", ""))
    # 1e-9 of it for decimal fractions that are no binary ones
    return abs(before - value) <= (1.0 + 1e-9) * last_digit(value, form)


def last_digit(value: float, form: str) -> float:
    """Return one of the last digit with which a format shows a value."""
    found = re.fullmatch(r"[+-]?,?(?:\.(\d+))?([a-z%]?)", form.partition(">")[0])
    if found is None or found[2] not in "efg" or not math.isfinite(value):
        return 0.0
    digits = 6 if found[1] is None else int(found[1])
    if found[2] == "f":
        return max(10.0**-digits, resolution(form))
    exponent = math.floor(math.log10(abs(value))) if value else 0
    return max(10.0 ** (exponent - digits + (found[2] == "g")), resolution(form))


def main(argv: Sequence[str] | None = None) -> int:
    """Exit code 0 if all that documents show is what the results hold, 1 if not, 2 for bad
    arguments.
    """
    made = Parser(
        prog="python -m experiments.harness.document",
        description="Say which cells of documents are stale.",
    )
    made.add_argument(
        "documents", nargs="+", metavar="FILE.md", help="documents with tables between marks"
    )
    made.add_argument(
        "--results",
        metavar="DIR",
        type=Path,
        default=Path("out"),
        help="folder of the results (default: %(default)s)",
    )
    made.add_argument("--write", action="store_true", help="put the tables of the results in")
    return command(lambda: _main(made.parse_args(argv)))


def _main(options: argparse.Namespace) -> int:
    stale = []
    for path in options.documents:
        for name in _experiments(path):
            folder = options.results / name
            if not os.path.isfile(folder / "result.json"):
                print(
                    f"{path}: there is no result of {name} in {options.results}; its tables are "
                    "not looked at."
                )
                continue
            document, tables = read_document(path, name), _kept(folder / "result.json")
            stale += document.stale(tables)
            if options.write:
                document.write(tables)
    print(
        *stale, f"{len(stale)} cells or rows {'were' if options.write else 'are'} stale.", sep="\n"
    )
    return FAILED if stale and not options.write else 0


def _experiments(path: str) -> list[str]:
    """Names of those whose tables a document shows, each once."""
    return list(dict.fromkeys(block["experiment"] for block in _BLOCK.finditer(read_text(path))))


def _kept(file: Path) -> list[Table]:
    """The tables of a result."""
    text = read_text(file)
    try:
        return [Table.of(kept) for kept in parse_json(text)["tables"]]
    except (LookupError, TypeError, ValueError, RecursionError) as error:
        raise DataError(
            f"Cannot read {file}: it is not the result of an experiment ({type(error).__name__}: "
            f"{error})."
        ) from error


if __name__ == "__main__":
    sys.exit(main())
