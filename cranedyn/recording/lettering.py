"""Text that changes with each picture of a film, put together from pictures of its characters.

Matplotlib lays out and draws a text anew whenever one of its characters changes. For two lines that
takes 5 ms, as long as everything else in a picture. Here it draws each character once.
"""

from __future__ import annotations

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties

_OPAQUE = 255
"""Largest value of a channel of a picture."""

_LINE_SPACING = 1.2
"""Share of the height of letters above their line that is left for them, as in Matplotlib."""


class Lettering:
    """Black text in one font and size, for a light background.

    Each character stands at a whole pixel. That is where Matplotlib, too, sets those of a font of
    fixed width, whose widths it rounds to whole pixels.
    """

    def __init__(self, *, family: str, size: float, dots_per_inch: float) -> None:
        """Choose the font.

        Args:
            family: Name of the font.
            size: Its size [points].
            dots_per_inch: Resolution of the pictures.
        """
        self._font = FontProperties(family=family, size=size)
        self._dots_per_inch = dots_per_inch
        self._renderer = FigureCanvasAgg(Figure(dpi=dots_per_inch)).get_renderer()
        _, height, descent = self._extent("lp")
        self._ascent = round(height - descent)
        self._line_distance = _LINE_SPACING * (height - descent) + descent
        # Characters such as Å are higher than letters, and brackets reach lower.
        self._above = self._ascent + round(0.5 * height)
        self._below = round(2.0 * descent)
        self._tiles: dict[str, np.ndarray] = {}

    def write(self, picture: np.ndarray, left: int, top: int, text: str) -> None:
        """Draw a text on a picture; what would stand beyond its edges is left out.

        Args:
            picture: Channels of the pixels, red, green and blue first, shape (height, width,
                channels).
            left: Column of the left end of the text.
            top: Row of the upper end of its letters.
            text: The text, which may have several lines.
        """
        for i, line in enumerate(text.split("\n")):
            baseline = top + self._ascent + round(i * self._line_distance)
            # The empty first part is there for a line without a character.
            empty = np.zeros((self._above + self._below, 0), dtype=np.uint16)
            parts = [empty, *map(self._tile, line)]
            strip = np.concatenate(parts, axis=1)
            upper = baseline - self._above
            # A negative number would count from the lower edge.
            lower = max(baseline + self._below, 0)
            area = picture[max(upper, 0) : lower, left:, :3]
            strip = strip[max(-upper, 0) :][: area.shape[0], : area.shape[1]]
            area = area[:, : strip.shape[1]]
            area[:] = area * strip[..., None] // _OPAQUE

    def _tile(self, character: str) -> np.ndarray:
        """Return how much of its background is seen at each pixel of a character, 0 to 255, shape
        (height, width).
        """
        tile = self._tiles.get(character)
        if tile is None:
            tile = self._draw_tile(character)
            self._tiles[character] = tile
        return tile

    def _draw_tile(self, character: str) -> np.ndarray:
        """Draw a character in black on white, as wide as the next one is away."""
        # Matplotlib tells the width of what is drawn, which leaves out the room beside a letter.
        many = 8
        wide, _, _ = self._extent("|" + many * character + "|")
        narrow, _, _ = self._extent("||")
        width = round((wide - narrow) / many)
        height = self._above + self._below
        inches = (max(width, 1) / self._dots_per_inch, height / self._dots_per_inch)
        figure = Figure(figsize=inches, dpi=self._dots_per_inch, facecolor="white")
        canvas = FigureCanvasAgg(figure)
        figure.text(
            0.0,
            self._below / height,
            character,
            fontproperties=self._font,
            va="baseline",
            color="black",
            parse_math=False,
        )
        canvas.draw()
        red = np.asarray(canvas.buffer_rgba())[..., 0]
        # Products of two channels do not fit eight bits.
        return red[:, :width].astype(np.uint16)

    def _extent(self, text: str) -> tuple[float, float, float]:
        """Return width, height and descent of a text [pixels]."""
        return self._renderer.get_text_width_height_descent(text, self._font, False)
