"""The page of a judged lift: go or no go and why, then every number; made of what the experiment
left in its folder.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import date
from html import escape
from pathlib import Path
from typing import Any

from cranedyn import __version__
from experiments.catalogue import EXPERIMENTS
from experiments.report import (
    best_figure,
    crane_address,
    figure_html,
    mark_html,
    read_result,
    table_html,
)
from experiments.report_style import STYLE

STATEMENT = (
    "This page is an appendix to a method statement. It is made by a program from a model of a "
    "crane, and no substitute for a competent person, who answers for the lift, knows the ground, "
    "the rigging, the weather and the people, and has read what is said here of its limits."
)

LIMITS = (
    "The model's rope has no mass and its crane no play; structure, ropes, slings and lifting "
    "points are not checked for strength.",
    "The lift begins and ends with the load hanging free. Picking up and setting down are not in "
    "it.",
    "Wind acts on the load alone, as a box of drag coefficient 1.2; what it does to the crane's "
    "structure is not in it.",
    "Standards were read second hand; where a clause is named, read it there.",
    "The chart of this project's own crane is chosen here, no maker stands behind it.",
)
"""What the numbers do not say."""

_SHEET = """
.verdict { font-size: 3.2rem; font-weight: 800; line-height: 1; margin: 1rem 0 0.4rem; }
.statement { border-left: 4px solid var(--line); padding-left: 0.8rem; max-width: 46rem; }
main { max-width: 64rem; }
section { margin-top: 1.6rem; padding-top: 0.8rem; }
@media (min-width: 70rem) { body { display: block; } main { margin: 0 auto; } }
@media print { section { break-before: auto; margin-top: 6mm; } figure { max-width: 100%; }
  .verdict { font-size: 26pt; } .first { flex-wrap: nowrap; gap: 6mm; }
  .first > div { flex: 1 1 auto; } .first figure { flex: 0 0 48mm; }
  section.pages { break-before: page; } }
"""


def page(folder: Path) -> str:
    """The page as one HTML document that needs nothing else.

    Args:
        folder: Where experiment lift_report left its results.

    Raises:
        DataError: If there is no such result.
    """
    result = read_result(folder)
    title = f"Lift: {result['parameters']['site']}"
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
        'content="width=device-width, initial-scale=1"><link rel="icon" href="data:,">'
        f"<title>{escape(title)}</title><style>{STYLE}{_SHEET}</style></head><body>\n<main>"
        f"{_first(result, title)}{_numbers(folder, result)}{_again(result)}"
        "</main></body></html>\n"
    )


def _first(result: Mapping[str, Any], title: str) -> str:
    """Go or no go, and why."""
    today, claims = date.today(), result["claims"]
    failed = [claim for claim in claims if claim["holds"] is not True]
    go, unknown = not failed, sum(claim["holds"] is None for claim in claims)
    does = "does" if len(failed) - unknown == 1 else "do"
    why = (
        f"All {len(claims)} checks hold."
        if go
        else f"{len(failed) - unknown} of {len(claims)} checks {does} not hold, {unknown} could "
        "not be judged:"
    )
    listed = "".join(
        f"<li>{mark_html(claim['holds'])}{escape(claim['sentence'])}</li>"
        for claim in [*failed, *(one for one in claims if one["holds"] is True)]
    )
    return (
        f'<div class="first"><div><h1>{escape(title)}</h1><p class="lead">{today.day} '
        f"{today:%B %Y} · cranedyn {escape(__version__)}</p>"
        f'<p class="verdict {"held" if go else "fails"}">{"GO" if go else "NO GO"}</p>'
        f"<p>{why}</p></div>"
        f'<figure><img alt="The crane from the side" src="{crane_address()}">'
        "<figcaption>The kind of crane, from the side.</figcaption></figure></div>"
        f'<ul class="claims">{listed}</ul><p class="statement">{STATEMENT}</p>'
        f"{table_html(result['tables'][0])}"
    )


def _numbers(folder: Path, result: Mapping[str, Any]) -> str:
    """Every table, and the figures."""
    entry = EXPERIMENTS["lift_report"]
    tables = "".join(f"<section>{table_html(table)}</section>" for table in result["tables"][1:])
    figures = "".join(
        f"<figure>{figure_html(folder, best_figure(name, result['files']))}<figcaption>"
        f"{escape(entry.caption(Path(name).stem))}</figcaption></figure>"
        for name in result["figures"]
    )
    return f'{tables}<section class="pages"><h2>Figures</h2>{figures}</section>'


def _again(result: Mapping[str, Any]) -> str:
    """What the numbers do not say, and how to make them again."""
    limits = "".join(f"<li>{escape(one)}</li>" for one in LIMITS)
    versions = ", ".join(f"{name} {one}" for name, one in result["versions"].items() if one)
    return (
        f"<section><h2>What these numbers do not say</h2><ul>{limits}</ul></section>"
        f"<section><h2>Again</h2><p>Every number of this page: <code>{escape(result['command'])}"
        "</code>; derivations of the factors: <code>python -m experiments.factors</code>. The run "
        "and its loads are kept beside the page as CSV and Parquet.</p>"
        f'<p class="note">{escape(versions)}; {escape(result["machine"])}</p></section>'
    )
