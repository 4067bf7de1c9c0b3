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
    import numpy as np
    from matplotlib.figure import Figure

    from cranedyn.data.time_series import TimeSeries
    from cranedyn.model.crane import Crane
    from cranedyn.recording import Run

Claim = Check
"""What an experiment shows, in a sentence: it holds, fails, or the arguments do not allow to judge
it."""

SCREEN_LINES = 19
"""Lines for table and claims on a screen of 24.

The other five are the blank line below the table, the count of claims, and up to three lines that
say where files are and which commands show more.
"""

MAX_CLAIM_LINES = 8
"""Lines on a screen for claims that do not fail; those that fail are all shown."""

VERDICT_WIDTH = 11
"""Width of the column of verdicts [characters]."""


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
        gaps: Distances between cranes by name [m], recorded with the runs, a number for each row of
            the first one.
        contacts: Times at which contacts of cranes begin, recorded with the runs [s].
        texts: Texts to store, by file name.
        next_commands: Command lines that go on with the files of this outcome, in which
            ``{folder}`` stands for their folder.
    """

    tables: Sequence[ResultTable]
    claims: Sequence[Claim] = ()
    parameters: Mapping[str, object] = field(default_factory=dict)
    trajectories: Mapping[str, TimeSeries] = field(default_factory=dict)
    figures: Mapping[str, Figure] = field(default_factory=dict)
    recording: Sequence[Run] = ()
    gaps: Mapping[str, np.ndarray] = field(default_factory=dict)
    contacts: Sequence[float] = ()
    texts: Mapping[str, str] = field(default_factory=dict)
    next_commands: Sequence[str] = ()


def side_by_side(runs: Mapping[str, tuple[Crane, Trajectory]], apart: float = 20.0) -> list[Run]:
    """Return runs for the viewer whose cranes stand in a row along X.

    Args:
        runs: Crane and trajectory of each run, by name.
        apart: Distance from one crane to the next [m].
    """
    from cranedyn.recording import Run

    return [
        Run(name, crane, trajectory, (apart * i, 0.0, 0.0))
        for i, (name, (crane, trajectory)) in enumerate(runs.items())
    ]


def show(outcome: Outcome, *, whole: bool = True) -> str:
    """Print tables, claims, and how many of the claims hold.

    The width is that of the terminal. Where the output goes elsewhere, it is that of the variable
    COLUMNS, or 80.

    Args:
        outcome: The outcome.
        whole: Whether to print all of it. Otherwise only what fits a screen of 24 lines is printed:
            the first columns and rows of the first table, all claims that fail, and as many of the
            others as there is room for. A claim is never cut.

    Returns:
        What is left out, for example "3 tables and 5 columns"; empty if nothing is.
    """
    console = Console(highlight=False)
    if whole:
        for table in outcome.tables:
            for block in blocks(table, console.width):
                console.print(block)
            console.print()
        for claim in outcome.claims:
            _print_claim(console, claim)
        left_out: dict[str, int] = {}
    else:
        left_out = _show_screen(console, outcome)
    if outcome.claims:
        console.print(summary(outcome.claims))
    return _listed(left_out)


def _show_screen(console: Console, outcome: Outcome) -> dict[str, int]:
    """Print what fits a screen, and return how many tables, columns, rows and claims do not."""
    failed = [claim for claim in outcome.claims if claim.verdict is Verdict.FAILS]
    # Claims that were not judged stand first, so that they are not the ones that are left out.
    others = [claim for claim in outcome.claims if claim.verdict is Verdict.NOT_JUDGED]
    others += [claim for claim in outcome.claims if claim.verdict is Verdict.HOLDS]
    shown = _first_that_fit(console, others)
    left_out_claims = len(others) - len(shown)
    claim_lines = sum(_line_count(console, claim) for claim in [*failed, *shown])

    left_out = {"table": 0, "column": 0, "row": 0, "claim": left_out_claims}
    if outcome.tables:
        first = excerpt(outcome.tables[0], console.width, SCREEN_LINES - claim_lines)
        left_out["table"] = len(outcome.tables) - 1
        left_out["column"] = first.columns_left_out
        left_out["row"] = first.rows_left_out
        console.print(first.block)
        console.print()
    for claim in [*failed, *shown]:
        _print_claim(console, claim)
    return left_out


def _first_that_fit(console: Console, claims: Sequence[Claim]) -> list[Claim]:
    """Return the first claims that take `MAX_CLAIM_LINES` together, and one in any case."""
    fitting: list[Claim] = []
    lines = 0
    for claim in claims:
        lines += _line_count(console, claim)
        if fitting and lines > MAX_CLAIM_LINES:
            break
        fitting.append(claim)
    return fitting


def _line_count(console: Console, claim: Claim) -> int:
    """Return how many lines a claim takes where `_print_claim` prints it."""
    if not console.is_terminal:
        return 1
    return len(console.render_lines(_claim_grid(claim)))


def _claim_grid(claim: Claim) -> RichTable:
    """Return a claim whose sentence is folded beside its verdict."""
    grid = RichTable.grid(padding=(0, 1, 0, 0))
    grid.add_row(Text(f"{claim.verdict.word:{VERDICT_WIDTH - 1}}"), Text(claim.sentence))
    return grid


def _print_claim(console: Console, claim: Claim) -> None:
    """Print a claim in full: folded in its column on a terminal, else on one line."""
    if console.is_terminal:
        console.print(_claim_grid(claim))
    else:
        # A line each, so that tools such as grep find whole claims.
        print(f"{claim.verdict.word:{VERDICT_WIDTH}}{claim.sentence}")


def _listed(counts: Mapping[str, int]) -> str:
    """Return counts in words, "1 table, 2 columns and 3 claims"; those that are 0 are not named."""
    phrases = [f"{count} {noun}{'s' * (count > 1)}" for noun, count in counts.items() if count]
    if len(phrases) < 2:
        return "".join(phrases)
    return f"{', '.join(phrases[:-1])} and {phrases[-1]}"


def summary(claims: Sequence[Claim]) -> str:
    """Return how many claims hold, and how many were not judged.

    A claim that was not judged counts neither as one that holds nor as one that fails.
    """
    verdicts = [claim.verdict for claim in claims]
    count = verdicts.count(Verdict.HOLDS)
    unknown = verdicts.count(Verdict.NOT_JUDGED)
    return f"{count} of {len(claims)} claims hold, {unknown} not judged."
