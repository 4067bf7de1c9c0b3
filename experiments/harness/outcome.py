"""The outcome of an experiment: tables and claims, as printed and as stored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from cranedyn.data.trajectory import Trajectory
from cranedyn.verdict import Check, Verdict
from experiments.harness.table import ResultTable
from experiments.harness.terminal import blocks, excerpt

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cranedyn.lifting.loads import Loads
    from cranedyn.model.crane import Crane
    from cranedyn.recording import Run

Claim = Check
"""What an experiment shows, in a sentence: it holds, fails, or the arguments do not allow to judge
it."""

_LINES, _MOST_CLAIMS = 19, 5
"""Lines of a screen for its table and claims, and most claims there that do not fail."""


@dataclass(frozen=True)
class Outcome:
    """The result of an experiment.

    Attributes:
        tables: In the order to print, the one that matters most first, its columns likewise.
        claims: What the experiment shows.
        parameters: The numbers it was made with, with units in the names.
        trajectories: Runs, and loads of runs, to store, by file name without ending.
        figures: Figures to store, by file name without ending.
        recording: Runs to record for the viewer.
        texts: Texts to store, by file name.
    """

    tables: Sequence[ResultTable]
    claims: Sequence[Claim] = ()
    parameters: Mapping[str, object] = field(default_factory=dict)
    trajectories: Mapping[str, Trajectory | Loads] = field(default_factory=dict)
    figures: Mapping[str, Figure] = field(default_factory=dict)
    recording: Sequence[Run] = ()
    texts: Mapping[str, str] = field(default_factory=dict)


def side_by_side(runs: Mapping[str, tuple[Crane, Trajectory]], apart: float = 20.0) -> list[Run]:
    """Return cranes and their trajectories by name as runs for the viewer, some way apart [m]."""
    from cranedyn.recording import Run

    return [
        Run(name, crane, trajectory, (apart * i, 0.0, 0.0))
        for i, (name, (crane, trajectory)) in enumerate(runs.items())
    ]


def show(outcome: Outcome, *, whole: bool = True) -> str:
    """Print tables, claims, and how many of these hold; on a terminal in its width, else in that of
    the variable COLUMNS or 80.

    Args:
        outcome: The outcome.
        whole: Whether to print all of it. Else what fits a screen of 24 lines is printed: the
            first columns and rows of the first table, and the claims; those that fail in full, the
            others cut to a line.

    Returns:
        What is left out, as "3 tables and 5 columns"; empty for nothing.
    """
    console = Console(highlight=False)
    if whole:
        for table in outcome.tables:
            for block in blocks(table, console.width):
                console.print(block)
            console.print()
    failed = [claim for claim in outcome.claims if claim.verdict is Verdict.FAILS]
    others = [claim for claim in outcome.claims if claim.verdict is Verdict.NOT_JUDGED]
    others += [claim for claim in outcome.claims if claim.verdict is Verdict.HOLDS]
    claims = outcome.claims if whole else [*failed, *others[:_MOST_CLAIMS]]
    folded = {"table": 0, "column": 0, "row": 0, "claim": len(outcome.claims) - len(claims)}
    if not whole and outcome.tables:
        table, lines = outcome.tables[0], _LINES - len(claims)
        block, folded["column"], folded["row"] = excerpt(table, console.width, lines)
        folded["table"] = len(outcome.tables) - 1
        console.print(block)
        console.print()
    for claim in claims:
        if not whole and claim in others:
            line = Text(f"{claim.verdict.word:11}{claim.sentence}")
            line.truncate(console.width, overflow="ellipsis")
            console.print(line)
        elif console.is_terminal:
            grid = RichTable.grid(padding=(0, 1, 0, 0))
            grid.add_row(Text(f"{claim.verdict.word:10}"), Text(claim.sentence))
            console.print(grid)
        else:  # a line each, for searching
            print(f"{claim.verdict.word:11}{claim.sentence}")
    if outcome.claims:
        console.print(summary(outcome.claims))
    counts = [f"{n} {noun}{'s' * (n > 1)}" for noun, n in folded.items() if n]
    return " and ".join(filter(None, (", ".join(counts[:-1]), *counts[-1:])))


def summary(claims: Sequence[Claim]) -> str:
    """Return how many claims hold, and how many were not judged, which counts as neither."""
    verdicts = [claim.verdict for claim in claims]
    count, unknown = verdicts.count(Verdict.HOLDS), verdicts.count(Verdict.NOT_JUDGED)
    return f"{count} of {len(claims)} claims hold, {unknown} not judged."
