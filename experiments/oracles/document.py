"""A Markdown document that has the tables of an experiment between two marks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cranedyn.errors import DataError
from cranedyn.files import written
from experiments.outcome import Table

BEGIN, END = "<!-- tables -->\n", "<!-- end of tables -->\n"
"""The marks, each a line."""


@dataclass(frozen=True)
class Document:
    """A document without its tables.

    Attributes:
        path: Where it is.
        before, after: What it has before and after them.
    """

    path: Path
    before: str
    after: str

    def write(self, tables: Sequence[Table]) -> None:
        """Put tables where the others were.

        Raises:
            DataError: If the file cannot be written.
        """
        with written(self.path) as file:
            file.write_text(
                "\n".join([self.before + BEGIN, *(f"{table.markdown()}\n" for table in tables), END + self.after]), encoding="utf-8"
            )


def read_document(path: str | Path) -> Document:
    """A document as it is.

    Raises:
        DataError: If the file cannot be read or has not both marks once each.
    """
    try:
        before, rest = Path(path).read_text(encoding="utf-8").split(BEGIN)
        _, after = rest.split(END)
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"Cannot read {path}: {getattr(error, 'strerror', None) or 'it is not text'}.") from error
    except ValueError:
        raise DataError(f"{path} must have the lines {BEGIN.strip()} and {END.strip()} once each; the tables go between them.") from None
    return Document(Path(path), before, after)
