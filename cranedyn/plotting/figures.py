"""One style for all figures: SI labels, colours by quantity, legible at the width of a README."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import LayoutEngine

from cranedyn.data.files import atomic_write
from cranedyn.plotting.style import COLOURS

__all__ = ["COLOURS", "panels", "save"]

_STYLE: Any = {
    "font.size": 11.0,
    "axes.grid": True,
    "grid.color": "#DDDDDD",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "lines.linewidth": 1.6,
    "legend.frameon": False,
    "figure.facecolor": "white",
    "axes.formatter.useoffset": False,
    "svg.hashsalt": "cranedyn",
}


_DPI = 130
"""Dots of a picture along an inch."""


class Drawing(Figure):
    """A figure that a notebook shows by itself."""

    def _repr_png_(self) -> bytes:
        with mpl.rc_context(_STYLE), io.BytesIO() as file:
            self.savefig(file, format="png", dpi=90)
            return file.getvalue()


def panels(
    rows: int = 1, columns: int = 1, *, height: float = 3.2, width: float = 9.0, **arguments: Any
) -> tuple[Figure, list[Axes]]:
    """A figure with panels in reading order.

    Args:
        rows: Panels one above the other.
        columns: Panels side by side.
        height: Of one row [inch].
        width: Of the figure [inch].
        arguments: Handed to matplotlib's ``Figure.subplots``, for example ``sharex=True``.
    """
    with mpl.rc_context(_STYLE):
        figure = Drawing(figsize=(width, rows * height), layout="constrained")
        return figure, list(figure.subplots(rows, columns, squeeze=False, **arguments).flat)


def save(figure: Figure, path: str | Path, *further: str | Path) -> Path:
    """Write a figure as ``.png``, or as ``.svg`` for pages and papers; the same figure gives the
    same file, alone or with others.

    Args:
        figure: The figure.
        path: The file.
        further: More files of the same figure, whose panels are placed once for all.

    Returns:
        The first file.

    Raises:
        DataError: If a file cannot be written.
    """
    engine = figure.get_layout_engine()
    with mpl.rc_context(_STYLE):
        if engine is not None:
            _place(figure, engine)
        try:
            for one in (path, *further):
                _save(figure, Path(one))
        finally:
            figure.set_layout_engine(engine)
    return Path(path)


def _place(figure: Figure, engine: LayoutEngine) -> None:
    """Put the panels of a figure where they stay while it is written, as large as in a picture."""
    usual = figure.dpi
    figure.set_dpi(_DPI)
    engine.execute(figure)
    figure.set_dpi(usual)
    figure.set_layout_engine("none")


def _save(figure: Figure, path: Path) -> None:
    kind = path.suffix.removeprefix(".")
    # Given a path, the library leaves the file open where Ctrl-C comes meanwhile.
    picture = io.BytesIO()
    figure.savefig(
        picture, format=kind, dpi=_DPI, metadata={"Date": None} if kind == "svg" else None
    )
    with atomic_write(path) as draft:
        draft.write_bytes(picture.getvalue())
