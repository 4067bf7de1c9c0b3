"""What a statement about safety rests on, and where each part of it comes from.

A certificate, a lift report and a site page hold only as long as what they assume is so: how far
the load may swing, how strong the wind is, how heavy the load may be. They list these assumptions,
each with its origin, and `check_entered` keeps a default from ever making a GO.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from cranedyn.verdict import Check


class Origin(Enum):
    """Where the value of an assumption comes from."""

    ENTERED = "entered"
    """Somebody entered it for this lift or site."""

    ESTIMATED = "estimated"
    """Somebody entered it, and says that it is an estimate."""

    COMPUTED = "computed"
    """It follows from what was entered."""

    SHIPPED = "shipped"
    """It belongs to the crane that comes with the package, which is the crane that was chosen."""

    ASSUMED = "assumed"
    """It holds for every lift or site, and nobody can enter another."""

    DEFAULT = "default"
    """Nobody entered it, so that this program's own value was taken."""


@dataclass(frozen=True)
class Assumption:
    """A value that a statement rests on.

    Attributes:
        name: The quantity, such as "largest swing of the rope".
        value: Its value with its unit, as text.
        origin: Where the value comes from.
        field: Where to enter it: a field of a file or an option, such as "[lift] swing"; empty
            where it cannot be entered.
    """

    name: str
    value: str
    origin: Origin
    field: str = ""

    def __str__(self) -> str:
        """Return the assumption with its origin in one line."""
        is_entered = self.origin in (Origin.ENTERED, Origin.ESTIMATED)
        entered_where = f", {self.field}" if self.field and is_entered else ""
        return f"{self.name}: {self.value} ({self.origin.value}{entered_where})"


def check_entered(assumptions: Iterable[Assumption]) -> Check:
    """Return a check that no assumption is a default of this program; otherwise it is not judged,
    since nobody answers for a value that nobody entered. What is shipped is named to be checked.
    """
    assumptions = list(assumptions)
    defaults = [a for a in assumptions if a.origin is Origin.DEFAULT]
    if not defaults:
        sentence = "No value listed under what the result rests on is a default of this program."
        shipped = " and ".join(a.name for a in assumptions if a.origin is Origin.SHIPPED)
        if shipped:
            sentence += f" Shipped with it, so check that it is yours: {shipped}."
        return Check(sentence, True)
    listed = ", ".join(a.field or a.name for a in defaults)
    values = "value" if len(defaults) == 1 else "values"
    return Check(
        f"Nobody entered {len(defaults)} {values} that the result rests on: {listed}.", None
    )
