"""Documents that show tables of experiments as printed, between marks that say which."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cranedyn.errors import DataError
from cranedyn.files import read_bytes, written
from experiments.outcome import Table

_BLOCK = re.compile(r"(<!-- (?P<experiment>\w+): ?(?P<title>[^\n]*?) ?-->\n).*?(<!-- end -->\n)", re.DOTALL)


@dataclass(frozen=True)
class Document:
    """A Markdown document with blocks for the tables of an experiment.

    A block begins with a line ``<!-- NAME: title -->`` and ends with ``<!-- end -->``; it holds the tables of the experiment NAME whose
    titles begin with that title, all of them where none is given.

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

        def filled(block: re.Match[str]) -> str:
            if block["experiment"] != self.experiment:
                return block[0]
            shown = [table for table in tables if table.title.startswith(block["title"])]
            if not shown:
                raise DataError(f"{self.path} asks for a table {block['title']!r}, which is not among those of {self.experiment}.")
            return "\n".join([block[1], *(f"{table.markdown()}\n" for table in shown), block[4]])

        with written(self.path) as file:
            file.write_text(_BLOCK.sub(filled, self.text), encoding="utf-8")


def read_document(path: str | Path, experiment: str) -> Document:
    """A document as it is.

    Raises:
        DataError: If the file cannot be read or has no block for the experiment.
    """
    try:
        text = read_bytes(path).decode("utf-8").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise DataError(f"Cannot read {path}: it is not text.") from error
    if not any(block["experiment"] == experiment for block in _BLOCK.finditer(text)):
        raise DataError(f"{path} has no lines <!-- {experiment}: --> and <!-- end -->; the tables go between them.")
    return Document(Path(path), experiment, text)
