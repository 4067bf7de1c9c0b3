"""Tables, figures and check marks as HTML that needs no other file, and the style sheet of such
pages.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from cranedyn.plotting.figures import svg
from cranedyn.verdict import Verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

IMAGE_TYPES = {".svg": "image/svg+xml", ".png": "image/png"}
"""Media types of figures by file ending, drawings first."""

_MARKS = {
    Verdict.HOLDS: ("held", "✔"),
    Verdict.FAILS: ("fails", "✘"),
    Verdict.NOT_JUDGED: ("open", "–"),
}


def mark_html(verdict: Verdict) -> str:
    """Return the sign of a verdict."""
    style, sign = _MARKS[verdict]
    return f'<span class="mark {style}" title="{verdict.word}">{sign}</span>'


def table_html(
    title: str, columns: Sequence[tuple[str, bool]], rows: Sequence[Sequence[str]], note: str = ""
) -> str:
    """Return a table as HTML.

    Args:
        title: Caption.
        columns: Header of each column, and whether it is text, which may be folded.
        rows: Cells.
        note: Text below the table.
    """
    kinds = [' class="text"' if is_text else "" for _, is_text in columns]
    head = "".join(
        f"<th{kind}>{escape(header)}</th>" for (header, _), kind in zip(columns, kinds, strict=True)
    )
    body = "".join(
        f"<tr>{''.join(map('<td{}>{}</td>'.format, kinds, map(escape, row)))}</tr>" for row in rows
    )
    width = 2 * len(columns)
    for i, (header, is_text) in enumerate(columns):
        texts = [word for row in rows for word in (row[i].split() if is_text else [row[i]])]
        width += max(map(len, [*header.split(), *texts]), default=1)
    note = f'<p class="note">{escape(note)}</p>' if note else ""
    return (
        f'<div class="table"><table style="--letters: {width}"><caption>{escape(title)}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>{note}"
    )


def image_address(content: bytes, ending: str) -> str:
    """Return a data URL of an image whose file would have an ending of `IMAGE_TYPES`."""
    return f"data:{IMAGE_TYPES[ending]};base64,{base64.b64encode(content).decode('ascii')}"


def svg_address(figure: Figure) -> str:
    """Return a figure as a data URL; the same figure gives the same text."""
    return image_address(svg(figure), ".svg")


STYLE = Path(__file__).with_name("page.css").read_text(encoding="utf-8")
"""Style sheet of a page."""
