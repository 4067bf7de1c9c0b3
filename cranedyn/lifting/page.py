"""The report of a lift as one HTML document: GO or NO GO and why, then every number; and as PDF,
printed by a browser.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from datetime import date
from html import escape
from importlib import metadata
from pathlib import Path

from cranedyn.data.files import atomic_write, write_text
from cranedyn.errors import CraneError
from cranedyn.lifting.figures import LiftFigure
from cranedyn.lifting.tables import Table
from cranedyn.model.load import load_crane
from cranedyn.plotting.html import STYLE, mark_html, svg_address, table_html
from cranedyn.recording.sketch import sketch
from cranedyn.verdict import Check
from cranedyn.version import __version__

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
"""Limits of the model that a reader must know."""

_SHEET = """
.verdict { font-size: 3.2rem; font-weight: 800; line-height: 1; margin: 1rem 0 0.4rem; }
.statement { border-left: 4px solid var(--line); padding-left: 0.8rem; max-width: 46rem; }
main { max-width: 64rem; }
section { margin-top: 1.6rem; padding-top: 0.8rem; }
@media (min-width: 60rem) { body { display: block; } main { margin: 0 auto; } }
@media print { section { break-before: auto; margin-top: 6mm; } figure { max-width: 100%; }
  .verdict { font-size: 26pt; } .first { flex-wrap: nowrap; gap: 6mm; }
  .first > div { flex: 1 1 auto; } .first figure { flex: 0 0 48mm; }
  section.pages { break-before: page; } }
"""


BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome", "msedge")
"""Browsers that print without a window, by their names on the path."""

_OPTIONS = (
    "--headless=new",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-pdf-header-footer",
)
_TIMEOUT = 120.0
"""Time that a browser may take [s]."""


def lift_html(
    title: str,
    checks: Sequence[Check],
    tables: Sequence[Table],
    figures: Sequence[LiftFigure],
    command: str,
) -> str:
    """Return the report of a lift, see `Judgement.html`; its first table is on the first screen."""
    crane, held = load_crane(), [check.holds is True for check in checks]
    reason = f"All {len(checks)} checks hold."
    if not all(held):
        failed = sum(check.holds is False for check in checks)
        does, unknown = "does" if failed == 1 else "do", held.count(False) - failed
        reason = f"{failed} of {len(held)} checks {does} not hold, {unknown} could not be judged:"
    style, verdict = ("held", "GO") if all(held) else ("fails", "NO GO")
    return document(
        title,
        f'<div class="first"><div><p class="verdict {style}">{verdict}</p><p>{reason}</p></div>'
        '<figure><img alt="The crane from the side" '
        f'src="{svg_address(sketch(crane, crane.state(phi=0.06)))}">'
        "<figcaption>The kind of crane, from the side.</figcaption></figure></div>"
        f'{checks_html(checks)}<p class="statement">{STATEMENT}</p>{tables_html(tables)}'
        f'<section class="pages"><h2>Figures</h2>{figures_html(figures)}</section>'
        f"{_limits_and_command(command)}",
    )


def document(title: str, body: str) -> str:
    """Return an HTML document that needs no other file, with its title, date and version first."""
    today = date.today()
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
        'content="width=device-width, initial-scale=1"><link rel="icon" href="data:,">'
        f"<title>{escape(title)}</title><style>{STYLE}{_SHEET}</style></head><body>\n<main>"
        f'<h1>{escape(title)}</h1><p class="lead">{today.day} {today:%B %Y} · cranedyn '
        f"{escape(__version__)}</p>{body}</main></body></html>\n"
    )


def checks_html(checks: Sequence[Check]) -> str:
    """Return checks as HTML, those first that do not hold."""
    ordered = sorted(checks, key=lambda check: check.holds is True)
    lines = (f"<li>{mark_html(check.verdict)}{escape(check.sentence)}</li>" for check in ordered)
    return f'<ul class="claims">{"".join(lines)}</ul>'


def figures_html(figures: Sequence[LiftFigure]) -> str:
    """Return figures with their captions as HTML."""
    return "".join(
        f'<figure><img alt="{escape(caption)}" src="{svg_address(figure)}"><figcaption>'
        f"{escape(caption)}</figcaption></figure>"
        for figure, caption in figures
    )


def tables_html(tables: Sequence[Table]) -> str:
    """Return tables as HTML, each but the first in a section."""
    first, *further = (
        table_html(t.title, [(head, not form) for head, form in t.columns], t.cells(), t.note)
        for t in tables
    )
    return first + "".join(f"<section>{text}</section>" for text in further)


def _limits_and_command(command: str) -> str:
    """Return the limits of the model, and how to make the numbers again."""
    limits = "".join(f"<li>{escape(sentence)}</li>" for sentence in LIMITS)
    packages = ("cranedyn", "pin", "numpy", "scipy")
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in packages)
    source_note = (
        f"Every number of this page: <code>{escape(command)}</code>; derivations"
        if command
        else "Derivations"
    )
    return (
        f"<section><h2>What these numbers do not say</h2><ul>{limits}</ul></section>"
        f"<section><h2>Again</h2><p>{source_note} of the factors: <code>cranedyn "
        "run factors</code>. The experiment keeps the run and its loads beside the page "
        "as CSV and Parquet."
        f'</p><p class="note">python {platform.python_version()}, {versions}; '
        f"{platform.system()} {platform.machine()}</p></section>"
    )


def write_html(path: str | Path, text: str) -> Path:
    """Write an HTML document as a ``.html`` file, or as a ``.pdf`` file that a browser prints.

    Raises:
        NoBrowser: If a PDF is asked for and no browser prints it.
        DataError: If the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() != ".pdf":
        write_text(path, text)
        return path
    with tempfile.TemporaryDirectory() as folder:
        draft = Path(folder) / "page.html"
        write_text(draft, text)
        return print_pdf(draft, path)


class NoBrowser(CraneError):
    """No browser is installed, or it made no PDF."""


def print_pdf(page: Path, pdf: Path) -> Path:
    """Print an HTML page as PDF.

    Args:
        page: An HTML file that needs no other file.
        pdf: The file to write.

    Raises:
        NoBrowser: If no browser is installed, or it makes no PDF within two minutes.
        DataError: If the PDF cannot be written.
    """
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        raise NoBrowser(
            f"There is no browser to print {page} with; install Chromium, or print the page from "
            "any browser."
        )
    # Browsers refuse their sandbox to root, as in most containers.
    root = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
    with tempfile.TemporaryDirectory() as folder:
        printed = Path(folder) / "page.pdf"
        options = [*root, f"--user-data-dir={folder}/profile", f"--print-to-pdf={printed}"]
        command = [browser, *_OPTIONS, *options, page.absolute().as_uri()]
        try:
            # Not to pipes: processes of a browser that outlive it would keep them open.
            nothing = subprocess.DEVNULL
            subprocess.run(command, stdout=nothing, stderr=nothing, timeout=_TIMEOUT, check=True)
            content = printed.read_bytes()
        except (OSError, subprocess.SubprocessError) as error:
            why = type(error).__name__
            raise NoBrowser(f"{browser} did not print {page} ({why}); print it by hand.") from None
    with atomic_write(pdf) as draft:
        draft.write_bytes(content)
    return pdf
