"""How a crane shows itself in Python and in a notebook."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from html import escape
from typing import TYPE_CHECKING, cast

from cranedyn.interfaces import State

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cranedyn.model.crane import Crane

_HEADS = ("symbol", "joint", "unit", "from", "to", "start", "drive")


class ShownCrane:
    """What a crane shows of itself."""

    def plot(self, state: State | None = None) -> Figure:
        """The crane from the side in a state, by default where it starts; a notebook shows the
        figure.
        """
        # By name: a crane knows nothing of those who draw it.
        figure: Figure = importlib.import_module("cranedyn.recording.sketch").sketch(self, state)
        return figure

    def __repr__(self) -> str:
        """A few lines: what hangs on it, and a line for each joint."""
        rows = [_HEADS, *_rows(_crane(self))]
        return "\n".join(
            [
                _head(_crane(self)),
                *(
                    f"{a:7} {b:24} {c:4} {d:>9} {e:>9} {f:>9} {g:>12}".rstrip()
                    for a, b, c, d, e, f, g in rows
                ),
            ]
        )

    def _repr_html_(self) -> str:
        """The same for a notebook."""
        head = "".join(f"<th>{escape(word)}</th>" for word in _HEADS)
        body = "".join(
            f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>"
            for row in _rows(_crane(self))
        )
        return (
            f"<p>{escape(_head(_crane(self)))}</p>"
            f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
        )


def _crane(shown: ShownCrane) -> Crane:
    return cast("Crane", shown)


def _head(crane: Crane) -> str:
    return f"Crane with a payload of {crane.payload_mass:g} kg in gravity of {crane.gravity:g} m/s²"


def _rows(crane: Crane) -> Iterator[tuple[str, ...]]:
    """Each joint: symbol, name, unit, range, where it starts, and the most that its drive can
    do.
    """
    limits = dict(zip(crane.layout.drives.tolist(), crane.effort_limit, strict=True))
    columns = zip(crane.layout.joints, crane.lower, crane.upper, crane.start.q, strict=True)
    for i, (joint, low, high, start) in enumerate(columns):
        effort = f"{limits[i]:g} {joint.effort_unit}" if joint.driven else "passive"
        yield (
            joint.symbol,
            joint.name,
            joint.unit,
            f"{low:.5g}",
            f"{high:.5g}",
            f"{start:.5g}",
            effort,
        )
