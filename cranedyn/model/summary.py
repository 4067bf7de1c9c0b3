"""Summary of a crane as text and HTML: a title and a row for each joint."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from cranedyn.model.layout import Layout

Row = tuple[str, ...]

_HEADINGS: Row = ("symbol", "joint", "unit", "from", "to", "start", "drive")


def joint_rows(
    layout: Layout,
    lower: np.ndarray,
    upper: np.ndarray,
    start: np.ndarray,
    effort_limit: np.ndarray,
) -> list[Row]:
    """Return a row of texts for each joint, below the row of headings."""
    limits = dict(zip(layout.drives.tolist(), effort_limit, strict=True))
    rows = [_HEADINGS]
    for i, joint in enumerate(layout.joints):
        ends = f"{lower[i]:.5g}", f"{upper[i]:.5g}", f"{start[i]:.5g}"
        drive = f"{limits[i]:g} {joint.effort_unit}" if joint.driven else "passive"
        rows.append((joint.symbol, joint.name, joint.unit, *ends, drive))
    return rows


def as_text(title: str, rows: Sequence[Row]) -> str:
    """Return title and rows as aligned text."""
    line = "{:7} {:24} {:4} {:>9} {:>9} {:>9} {:>12}"
    return "\n".join([title, *(line.format(*row).rstrip() for row in rows)])


def as_html(title: str, rows: Sequence[Row]) -> str:
    """Return title and rows as an HTML table."""
    head, *body = rows
    cells = "".join(f"<th>{escape(cell)}</th>" for cell in head)
    lines = ("".join(f"<td>{escape(cell)}</td>" for cell in row) for row in body)
    return (
        f"<p>{escape(title)}</p><table><thead><tr>{cells}</tr></thead>"
        f"<tbody>{''.join(f'<tr>{line}</tr>' for line in lines)}</tbody></table>"
    )
