"""The cells that the matrix shall have, from cells.toml."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

TABLE = Path(__file__).with_name("cells.toml")
"""The table: why something does not work (`reasons`), and in which cells (`no`)."""


@dataclass(frozen=True)
class Refusal:
    """A cell in which a job does not work.

    Attributes:
        reason: Name of the reason.
        sentence: The whole text of the error.
    """

    reason: str
    sentence: str


@dataclass(frozen=True)
class ExpectedMatrix:
    """What the table says.

    Attributes:
        reasons: Why a job does not work and what to do instead, in Markdown, by name and in the
            order of the footnotes of the page.
        refusals: The cells that do not work by (crane, job); all others do.
    """

    reasons: dict[str, str]
    refusals: dict[tuple[str, str], Refusal]


def read_cells() -> ExpectedMatrix:
    """Read the table."""
    table = tomllib.loads(TABLE.read_text("utf-8"))
    refusals = {}
    for entry in table["no"]:
        for job in entry["jobs"]:
            cell = (entry["crane"], job)
            assert cell not in refusals, f"{cell} is in the table twice"
            refusals[cell] = Refusal(entry["reason"], entry["sentence"])
    return ExpectedMatrix(table["reasons"], refusals)
