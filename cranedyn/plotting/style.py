"""Colours, line styles and font: the same in every plot, figure and recording.

Colours of quantities are the colour-blind-safe palette of Okabe and Ito, its pale ones darkened, so
that every one is legible on white and on black.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from cycler import cycler

COLOURS = {
    "gamma": "#0072B2",
    "x": "#D55E00",
    "phi": "#B87800",
    "theta": "#2E8BC0",
    "l": "#009E73",
    "energy": "#B0569A",
    "dissipated": "#8F8500",
    "unexplained": "#000000",
    "setpoint": "#8A8A8A",
    "limit": "#8A8A8A",
}
"""Hex colours of quantities. A coordinate shares its colour with its rate and with effort and work
of its drive. Black is for white paper."""

_FURTHER_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#B0569A", "#B87800", "#2E8BC0")
"""Hex colours of quantities that `COLOURS` does not name, and of Matplotlib's cycle of colours."""

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
"""Hex colours of the runs of one picture in their order. The first is the colour of the payload
where there is one run."""

RC: Any = {
    "font.sans-serif": ["DejaVu Sans", "Verdana"],
    "font.size": 11.0,
    "axes.prop_cycle": cycler(color=_FURTHER_COLOURS),
    "axes.grid": True,
    "grid.color": "#DDDDDD",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "lines.linewidth": 1.6,
    "legend.frameon": False,
    "figure.facecolor": "white",
    "axes.formatter.useoffset": False,
    # Words, not outlines: fewer bytes, and the browser finds them.
    "svg.fonttype": "none",
    # TrueType fonts, which publishers accept and editors can change; Matplotlib's default, Type 3,
    # is neither.
    "pdf.fonttype": 42,
    # Without a salt of its own each drawing would have other ids, and no two files be the same.
    "svg.hashsalt": "cranedyn",
}
"""Settings of Matplotlib with which figures are drawn and saved."""

_OTHER_COLOURS = (
    "#0072B2",
    "#D55E00",
    "#009E73",
    "#B87800",
    "#7A5FC0",
    "#C8205A",
    "#5E9A00",
    "#8C5A3C",
    "#00939C",
)
"""Hex colours of the coordinates of other cranes. Any two of them are at least 25 apart in CIELAB,
and as far from the colours of energy, losses, setpoints and limits, beside which they are drawn."""

_LOOKALIKES = {"#2E8BC0": "#0072B2"}
"""Colour of `_OTHER_COLOURS` that is too like a colour of `COLOURS`, by the latter: blue and the
sky blue of the tangential swing are only 12 apart in CIELAB."""

GREEK = {"gamma": "γ", "phi": "φ", "theta": "θ"}
"""Letters of coordinates by their symbols."""

LINE_STYLES = {"phi": "-", "theta": "--"}
"""Line styles: solid for radial swing and dashed for tangential swing, in every figure."""


def run_colour(index: int) -> str:
    """Return the hex colour of the run of an index; the colours repeat."""
    return RUN_COLOURS[index % len(RUN_COLOURS)]


def colour_of(quantity: str) -> str:
    """Return the hex colour of a quantity.

    A quantity that `COLOURS` does not name has the same colour in every figure, too, but others may
    share it; see `distinct_colours`.
    """
    if quantity in COLOURS:
        return COLOURS[quantity]
    # A sum and no hash: Python's hashes of texts differ from process to process.
    return _FURTHER_COLOURS[sum(quantity.encode()) % len(_FURTHER_COLOURS)]


def distinct_colours(quantities: Iterable[str]) -> dict[str, str]:
    """Return hex colours of quantities that one picture shows: those of `COLOURS` for its names,
    and for other names in their order those that none of these has or is like. They repeat after
    eight or nine others.
    """
    names = list(dict.fromkeys(quantities))
    result = {name: COLOURS[name] for name in names if name in COLOURS}
    taken = set(result.values())
    for colour in result.values():
        taken.add(_LOOKALIKES.get(colour, colour))
    free = [colour for colour in _OTHER_COLOURS if colour not in taken]
    others = [name for name in names if name not in COLOURS]
    for i, name in enumerate(others):
        result[name] = free[i % len(free)]
    return result


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue of a hex colour, 0 to 255."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


def mixed(colour: str, background: str, share: float) -> str:
    """Return the hex colour that has a share of a background colour mixed in, 0 to 1."""
    channels = []
    for own, other in zip(rgb(colour), rgb(background), strict=True):
        channels.append(round((1 - share) * own + share * other))
    return f"#{bytes(channels).hex().upper()}"
