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
"""Resolution of a picture [dots per inch]."""


class _NotebookFigure(Figure):
    """A figure that notebooks display."""

    def _repr_png_(self) -> bytes:
        with mpl.rc_context(_STYLE), io.BytesIO() as file:
            self.savefig(file, format="png", dpi=90)
            return file.getvalue()


def panels(
    rows: int = 1, columns: int = 1, *, height: float = 3.2, width: float = 9.0, **arguments: Any
) -> tuple[Figure, list[Axes]]:
    """Return a figure and its panels in reading order.

    Args:
        rows: Number of rows of panels.
        columns: Number of columns of panels.
        height: Height of one row [inch].
        width: Width of the figure [inch].
        arguments: Arguments of matplotlib's ``Figure.subplots``, for example ``sharex=True``.
    """
    with mpl.rc_context(_STYLE):
        figure = _NotebookFigure(figsize=(width, rows * height), layout="constrained")
        return figure, list(figure.subplots(rows, columns, squeeze=False, **arguments).flat)


def save(figure: Figure, path: str | Path, *further: str | Path) -> Path:
    """Write a figure as ``.png`` or ``.svg`` and return the first path; the same figure gives the
    same files.

    Args:
        figure: The figure.
        path: The file.
        further: More files of the same figure, with the panels at the same positions.

    Raises:
        DataError: If a file cannot be written.
    """
    engine = figure.get_layout_engine()
    with mpl.rc_context(_STYLE):
        if engine is not None:
            _lay_out(figure, engine)
        try:
            for file in (path, *further):
                _save(figure, Path(file))
        finally:
            figure.set_layout_engine(engine)
    return Path(path)


def _lay_out(figure: Figure, engine: LayoutEngine) -> None:
    """Fix the positions of the panels as they are at the resolution of a picture."""
    dpi = figure.dpi
    figure.set_dpi(_DPI)
    engine.execute(figure)
    figure.set_dpi(dpi)
    figure.set_layout_engine("none")


def _save(figure: Figure, path: Path) -> None:
    ending = path.suffix.removeprefix(".")
    # Matplotlib would leave a file of its own open if Ctrl-C interrupts it.
    picture = io.BytesIO()
    metadata = {"Date": None} if ending == "svg" else None
    figure.savefig(picture, format=ending, dpi=_DPI, metadata=metadata)
    with atomic_write(path) as draft:
        draft.write_bytes(picture.getvalue())
