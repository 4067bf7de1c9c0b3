"""Step one drive aside and back."""

from __future__ import annotations

from cranedyn.errors import number
from cranedyn.references.wanted import Reference, Wanted, along


def pulse(base: Reference, drive: str, amplitude: float, *, at: float, width: float) -> Reference:
    """Add a rectangular pulse to one drive of a reference.

    A pivot that follows it and comes back after half a swing period leaves a swing of 2 amplitude / cable length (small angles).

    Args:
        base: What is wanted otherwise.
        drive: "gamma", "x" or "l".
        amplitude: How far aside [rad or m].
        at: When it starts [s].
        width: How long it lasts [s].

    Raises:
        UnknownName: For another drive.
        OutOfRange: For a number that is not finite, or a width that is not positive.
    """
    step = number("pulse amplitude", amplitude) * along(drive)
    first, last = number("pulse start", at, "s"), at + number("pulse width", width, "s", "> 0")

    def reference(t: float) -> Wanted:
        wanted = base(t)
        return wanted._replace(position=wanted.position + step) if first <= t < last else wanted

    return reference
