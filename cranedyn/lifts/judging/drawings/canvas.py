"""A page of exact millimetres as SVG, whose texts are texts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np

from cranedyn.lifts.judging.drawings.labels import FONT_SIZE, text_width

INK = "#111111"
"""Colour of lines and texts that have none of their own."""


@dataclass(frozen=True)
class Stroke:
    """How lines and areas are drawn.

    Attributes:
        colour: Colour of the line; "none" for no line.
        width: Its width [mm].
        dashes: Lengths of dashes and gaps [mm], separated by spaces; empty for a full line.
        fill: Colour of the area; "none" for no fill.
        opacity: Opacity of the area.
    """

    colour: str = INK
    width: float = 0.25
    dashes: str = ""
    fill: str = "none"
    opacity: float = 1.0

    @property
    def attributes(self) -> str:
        """The attributes of an SVG element."""
        text = f'stroke="{self.colour}" stroke-width="{self.width:g}" fill="{self.fill}"'
        if self.dashes:
            text += f' stroke-dasharray="{self.dashes}"'
        if self.opacity != 1.0:
            text += f' fill-opacity="{self.opacity:g}"'
        return text


THIN = Stroke(width=0.18)
"""Lines of frames, leaders and rulings."""


_BEHIND_TEXT = Stroke("none", fill="#ffffff", opacity=0.7)
"""What makes the lines behind a text pale."""

_SHARE_BEFORE = {"start": 0.0, "middle": 0.5, "end": 1.0}
"""Share of a text that stands before its point, by where that is."""


@dataclass(eq=False)
class Canvas:
    """A page on which one draws in millimetres from its upper left corner, Y down.

    Attributes:
        name: Name of the page, unique in a document, from which identifiers are made.
        width, height: Size of the page [mm].
        elements: What was drawn, as SVG.
    """

    name: str
    width: float
    height: float
    elements: list[str] = field(default_factory=list)

    def path(self, points: np.ndarray, stroke: Stroke, *, closed: bool = False) -> None:
        """Draw lines through points, shape (n, 2)."""
        words = " ".join(f"{x:.3f},{y:.3f}" for x, y in points)
        shape = "polygon" if closed else "polyline"
        self.elements.append(f'<{shape} points="{words}" {stroke.attributes}/>')

    def line(self, x1: float, y1: float, x2: float, y2: float, stroke: Stroke = THIN) -> None:
        """Draw a straight line."""
        self.path(np.array([[x1, y1], [x2, y2]]), stroke)

    def box(self, left: float, top: float, width: float, height: float, stroke: Stroke) -> None:
        """Draw a rectangle."""
        self.elements.append(
            f'<rect x="{left:.3f}" y="{top:.3f}" width="{width:.3f}" height="{height:.3f}" '
            f"{stroke.attributes}/>"
        )

    def circle(self, x: float, y: float, radius: float, stroke: Stroke) -> None:
        """Draw a circle."""
        self.elements.append(
            f'<circle cx="{x:.3f}" cy="{y:.3f}" r="{radius:.3f}" {stroke.attributes}/>'
        )

    def text(
        self,
        x: float,
        y: float,
        text: str,
        *,
        anchor: str = "start",
        bold: bool = False,
        size: float = FONT_SIZE,
        colour: str = INK,
        halo: bool = False,
    ) -> None:
        """Write a text whose baseline begins, ends or has its middle at a point.

        Args:
            x: Distance of the point from the left edge [mm].
            y: Its distance from the upper edge [mm].
            text: The text.
            anchor: "start", "middle" or "end".
            bold: Whether it is bold.
            size: Size of its letters.
            colour: Its colour.
            halo: Whether lines behind it are made pale.
        """
        weight = ' font-weight="bold"' if bold else ""
        if halo:
            # A box behind it and no rim around its letters, which would be a second text in a PDF.
            width = text_width(text) * size / FONT_SIZE
            left = x - width * _SHARE_BEFORE[anchor]
            self.box(left, y - 0.85 * size, width, 1.1 * size, _BEHIND_TEXT)
        self.elements.append(
            f'<text x="{x:.3f}" y="{y:.3f}" text-anchor="{anchor}" font-size="{size:g}" '
            f'fill="{colour}"{weight}>{escape(text)}</text>'
        )

    def lines_of_text(self, x: float, y: float, lines: Sequence[str], spacing: float) -> None:
        """Write texts below each other from the first baseline on."""
        for i, line in enumerate(lines):
            self.text(x, y + i * spacing, line)

    def begin_window(self, left: float, top: float, width: float, height: float) -> None:
        """Cut off all that is drawn beyond a rectangle, up to `end_window`."""
        identifier = f"{self.name}-window-{len(self.elements)}"
        self.elements.append(
            f'<clipPath id="{identifier}"><rect x="{left:.3f}" y="{top:.3f}" '
            f'width="{width:.3f}" height="{height:.3f}"/></clipPath>'
            f'<g clip-path="url(#{identifier})">'
        )

    def end_window(self) -> None:
        """Draw on the whole page again."""
        self.elements.append("</g>")

    @property
    def svg(self) -> str:
        """The page as an SVG element."""
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{self.width:g}mm" '
            f'height="{self.height:g}mm" viewBox="0 0 {self.width:g} {self.height:g}" '
            "font-family=\"Arial, Helvetica, 'Liberation Sans', 'DejaVu Sans', sans-serif\">"
            f'<rect width="{self.width:g}" height="{self.height:g}" fill="#fff"/>'
            + "\n".join(self.elements)
            + "</svg>"
        )
