"""Tables, figures and check marks as HTML that needs no other file, and the style sheet of such
pages.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

import matplotlib as mpl

if TYPE_CHECKING:
    from matplotlib.figure import Figure

IMAGE_TYPES = {".svg": "image/svg+xml", ".png": "image/png"}
"""Media types of figures by file ending, drawings first."""

_MARKS = {
    True: ("held", "holds", "✔"),
    False: ("fails", "FAILS", "✘"),
    None: ("open", "not judged", "–"),
}


def mark_html(holds: bool | None) -> str:
    """Return the sign of a claim or check: held, failed or, for None, not judged."""
    style, title, sign = _MARKS[holds]
    return f'<span class="mark {style}" title="{title}">{sign}</span>'


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
    content = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "cranedyn"}):
        figure.savefig(content, format="svg", metadata={"Date": None})
    return image_address(content.getvalue(), ".svg")


STYLE = """
:root { color-scheme: light dark; --ink: #1c2430; --soft: #5a6675; --line: #d5dbe3; --page: #fff;
  --card: #f5f7fa;
  --held: #00734f; --fails: #c02a1d; --link: #0b5cad; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6eaf0; --soft: #a3adba; --line: #39424f;
  --page: #14181f;
  --card: #1d232c; --held: #4cc79b; --fails: #ff8a7d; --link: #7db8f5; } }
* { box-sizing: border-box; }
body { font: 16px/1.55 system-ui, sans-serif; margin: 0; color: var(--ink);
  background: var(--page); }
a { color: var(--link); }
h1, h2 { line-height: 1.2; }
h1 { font-size: 2rem; margin: 0 0 0.3rem; }
h2 { margin: 0 0 0.3rem; }
nav { position: sticky; top: 0; z-index: 1; background: var(--page);
  border-bottom: 1px solid var(--line);
  display: flex; gap: 1rem; overflow-x: auto; padding: 0.6rem 1rem; white-space: nowrap; }
main { padding: 1.5rem 1rem 4rem; min-width: 0; }
section { border-top: 1px solid var(--line); margin-top: 3rem; padding-top: 1.5rem;
  scroll-margin-top: 3rem; }
p, ul { max-width: 46rem; }
.lead, .note { color: var(--soft); }
.note { font-size: 0.85rem; margin: 0.2rem 0 1.5rem; }
.first { display: flex; flex-wrap: wrap; gap: 2rem; align-items: center; }
.first > div { flex: 1 1 26rem; min-width: 0; }
.first figure { flex: 0 1 20rem; margin: 0; }
.count { font-size: 2.6rem; font-weight: 700; line-height: 1.1; margin: 0.8rem 0 0; }
.table { overflow-x: auto; margin: 1.2rem 0 0.4rem; }
table { border-collapse: collapse; font-size: 0.875rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: 600; padding: 0.3rem 0; }
th, td { border-bottom: 1px solid var(--line); padding: 0.25rem 0.6rem; text-align: right;
  vertical-align: bottom; }
td { white-space: nowrap; }
td.text { white-space: normal; min-width: 9rem; }
th.text, td.text { text-align: left; }
.summary td, .summary th { text-align: left; white-space: normal; vertical-align: top; }
.summary td:last-child { white-space: nowrap; }
ul.claims { list-style: none; padding: 0; }
ul.claims li { padding-left: 1.6rem; text-indent: -1.6rem; margin: 0.25rem 0; }
.mark { display: inline-block; width: 1.6rem; text-indent: 0; font-weight: 700; }
.held { color: var(--held); } .fails { color: var(--fails); } .open { color: var(--soft); }
figure { margin: 1.5rem 0; max-width: 60rem; }
figure img { width: 100%; height: auto; background: #fff; border-radius: 6px; padding: 0.4rem;
  display: block; }
figcaption { color: var(--soft); font-size: 0.9rem; padding-top: 0.4rem; }
code, pre { background: var(--card); border-radius: 4px; padding: 0.1rem 0.3rem;
  overflow-wrap: anywhere; }
pre { padding: 0.8rem; overflow-x: auto; white-space: pre-wrap; }
@media (min-width: 70rem) {
  body { display: grid; grid-template-columns: 13rem minmax(0, 1fr); }
  nav { flex-direction: column; gap: 0.35rem; height: 100vh; border-bottom: 0;
    border-right: 1px solid var(--line);
    padding: 2rem 1.2rem; }
  main { padding: 2rem 3rem 4rem; max-width: 110rem; }
  section { scroll-margin-top: 0; }
}
@page { size: A4; margin: 14mm 12mm; }
@media print {
  :root { --ink: #000; --soft: #444; --line: #bbb; --page: #fff; --card: #f2f2f2; --held: #00734f;
    --fails: #c02a1d;
    --link: #000; }
  body { display: block; font-size: 10pt; }
  nav, details { display: none; }
  main { padding: 0; max-width: none; }
  section { break-before: page; border: 0; margin: 0; padding: 0; }
  .table { overflow: visible; }
  table { font-size: min(8.5pt, calc(180mm / (var(--letters, 40) * 0.62))); }
  th, td { padding: 0.1rem 0.35em; }
  td.text { min-width: 0; }
  tr, figure, li { break-inside: avoid; }
  h2, caption { break-after: avoid; }
}
"""
