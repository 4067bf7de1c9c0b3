"""One colour for each quantity, the same in every plot and figure.

The colour-blind-safe palette of Okabe and Ito, its pale ones darker, so that every one is legible
on white and on black.
"""

from __future__ import annotations

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
"""Hex colour by quantity: a coordinate shares it with its rate and with the effort and the work of
its drive. Black is for white paper."""

_FURTHER = ("#0072B2", "#D55E00", "#009E73", "#B0569A", "#B87800", "#2E8BC0")


def colour_of(quantity: str) -> str:
    """The hex colour of a quantity; one of no name of its own always gets the same."""
    return COLOURS.get(quantity) or _FURTHER[sum(quantity.encode()) % len(_FURTHER)]


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue of a hex colour, 0 to 255."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


def mixed(colour: str, other: str, share: float) -> str:
    """A hex colour with a share of another mixed in, 0 to 1."""
    return (
        "#"
        + bytes(
            round((1 - share) * a + share * b) for a, b in zip(rgb(colour), rgb(other), strict=True)
        )
        .hex()
        .upper()
    )
