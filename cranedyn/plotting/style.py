"""One colour for each quantity, the same in every plot and figure: the colour-blind-safe palette of Okabe and Ito."""

from __future__ import annotations

COLOURS = {
    "gamma": "#0072B2",
    "x": "#D55E00",
    "phi": "#E69F00",
    "theta": "#56B4E9",
    "l": "#009E73",
    "energy": "#CC79A7",
    "dissipated": "#F0E442",
    "unexplained": "#000000",
    "setpoint": "#999999",
    "limit": "#999999",
}
"""Hex colour by quantity: a coordinate shares it with its rate and with the effort and the work of its drive. Black is for white paper."""


_FURTHER = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")


def colour_of(quantity: str) -> str:
    """The hex colour of a quantity; one of no name of its own always gets the same."""
    return COLOURS.get(quantity) or _FURTHER[sum(quantity.encode()) % len(_FURTHER)]


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue of a hex colour, 0 to 255."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


def mixed(colour: str, other: str, share: float) -> str:
    """A hex colour with a share of another mixed in, 0 to 1."""
    return "#" + bytes(round((1 - share) * a + share * b) for a, b in zip(rgb(colour), rgb(other), strict=True)).hex().upper()
