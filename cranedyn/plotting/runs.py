"""One colour for each run, the same in the scene, in plots and in figures, legible on white and on
black.
"""

from __future__ import annotations

RUN_COLOURS = (
    "#E0341A",
    "#0072B2",
    "#008C66",
    "#B0569A",
    "#9A6A00",
    "#0086A8",
    "#7A5FC0",
    "#7A7A7A",
)
"""Hex colours of the runs of one picture, in their order; the first is that of the payload of a run
alone."""

STYLES = {"phi": "-", "theta": "--"}
"""Line styles: radial swing is solid and tangential swing dashed, in every figure."""


def run_colour(i: int) -> str:
    """The colour of the run of a number; after the last the first comes again."""
    return RUN_COLOURS[i % len(RUN_COLOURS)]


def luminance(colour: str) -> float:
    """Relative luminance of a hex colour, 0 to 1 (WCAG 2.2)."""
    channels = [part / 255 for part in bytes.fromhex(colour[1:])]
    red, green, blue = (
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels
    )
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(colour: str, other: str) -> float:
    """Contrast of two hex colours, 1 to 21 (WCAG 2.2); lines want 3."""
    light, dark = sorted((luminance(colour), luminance(other)), reverse=True)
    return (light + 0.05) / (dark + 0.05)
