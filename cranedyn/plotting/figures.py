"""Figures in one style: SI labels, colours by quantity, legible at the width of a README; curves of
runs over time.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import LogFormatter

from cranedyn.data.files import atomic_write
from cranedyn.data.time_series import TimeSeries
from cranedyn.plotting.style import COLOURS, GREEK, LINE_STYLES, RC, colour_of, run_colour

__all__ = ["COLOURS", "panels", "save"]

_DPI = 130
"""Resolution of a picture [dots per inch]."""


class _NotebookFigure(Figure):
    """A figure that notebooks display, and whose texts are names and no formulas."""

    def draw(self, renderer: Any) -> None:
        """Draw as Matplotlib does, with texts as they are."""
        take_texts_literally(self)
        super().draw(renderer)

    def _repr_png_(self) -> bytes:
        with mpl.rc_context(RC), io.BytesIO() as file:
            self.savefig(file, format="png", dpi=90)
            return file.getvalue()


def take_texts_literally(figure: Figure) -> None:
    """Show each text of a figure as it is written.

    Matplotlib takes what stands between two dollar signs for a formula, so that a crane named "$5
    or $6" would lose its signs, and one whose name is no formula would not be drawn at all. The
    labels of logarithmic axes stay formulas, which Matplotlib writes itself.
    """
    formulas = set[int]()
    for ax in figure.axes:
        for axis in (ax.xaxis, ax.yaxis):
            if isinstance(axis.get_major_formatter(), LogFormatter):
                formulas.update(id(label) for label in axis.get_ticklabels(which="both"))
    for text in figure.findobj(Text):
        if isinstance(text, Text) and id(text) not in formulas:
            text.set_parse_math(False)


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
    with mpl.rc_context(RC):
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
    take_texts_literally(figure)  # before their sizes are asked for
    with mpl.rc_context(RC):
        if engine is not None:
            dpi = figure.dpi  # panels stand as they do at the resolution of a picture
            figure.set_dpi(_DPI)
            engine.execute(figure)
            figure.set_dpi(dpi)
            figure.set_layout_engine(None)  # none to draw once more for
        try:
            for file in (path, *further):
                ending = Path(file).suffix.removeprefix(".")
                # Matplotlib would leave a file of its own open if Ctrl-C interrupts it.
                with atomic_write(Path(file)) as draft:
                    draft.write_bytes(svg(figure) if ending == "svg" else _picture(figure, ending))
        finally:
            figure.set_layout_engine(engine)
    return Path(path)


def svg(figure: Figure) -> bytes:
    """Return a figure as SVG whose paper is dark where its reader prefers that; the same figure
    gives the same bytes.
    """
    with mpl.rc_context(RC):
        content = _picture(figure, "svg", metadata={"Date": None})
    return content.replace(b"</style>", _NIGHT + b"</style>", 1)


def _picture(figure: Figure, ending: str, **arguments: Any) -> bytes:
    file = io.BytesIO()
    take_texts_literally(figure)
    figure.savefig(file, format=ending, dpi=_DPI, **arguments)
    return file.getvalue()


_NIGHT = Path(__file__).with_name("night.css").read_bytes()


_LEAST_SPAN = 1e-3
"""Smallest span of an axis [° or m]."""

_PASSIVE_TITLES = {"rad": "swing", "m": "stretch"}
"""Label of the passive coordinates by their unit."""


def plot_columns(series: TimeSeries, *columns: str) -> Figure:
    """Draw columns over time in one panel each.

    Without columns draw the drives of a trajectory beside their setpoints and its swing, and of any
    other table its principal columns.

    Raises:
        UnknownColumn: If there is no column of a name.
    """
    if not columns and series.coordinate_keys:
        return plot_runs({"": series})
    columns = columns or tuple(series.principal_keys)
    curves = [_in_degrees(series[name], name.rpartition("_")[2]) for name in columns]
    figure, axes = panels(len(columns), height=1.8 if len(columns) > 1 else 3.0, sharex=True)
    for ax, name, (values, unit) in zip(axes, columns, curves, strict=True):
        ax.plot(series.t, values, color=colour_of(name.split("_")[0]))
        ax.set_ylabel(f"{name.removesuffix('_rad')} [°]" if unit == "°" else name)
    axes[-1].set_xlabel("time [s]")
    return figure


def plot_runs(runs: Mapping[str, TimeSeries]) -> Figure:
    """Draw drives, swing and stretch of several runs of one crane, each run in its own colour.

    Args:
        runs: Trajectories by name; the name of a single one may be empty.
    """
    first = next(iter(runs.values()))
    units = dict(name.rsplit("_", 1) for name in first.coordinate_keys)
    drives = [symbol for symbol, unit in units.items() if f"{symbol}_setpoint_{unit}" in first]
    groups = [
        [symbol for symbol in units if symbol not in drives and units[symbol] == unit]
        for unit in _PASSIVE_TITLES
    ]
    groups = [symbols for symbols in groups if symbols]
    figure, axes = panels(len(drives) + len(groups), height=1.7, sharex=True)
    for ax, symbol in zip(axes, drives, strict=False):
        _draw_drive(ax, runs, symbol, units[symbol])
    for ax, symbols in zip(axes[len(drives) :], groups, strict=True):
        _draw_passive(ax, runs, symbols, units[symbols[0]])
    axes[-1].set_xlabel("time [s]")
    return figure


def _draw_drive(ax: Axes, runs: Mapping[str, TimeSeries], symbol: str, unit: str) -> None:
    label = GREEK.get(symbol, symbol)
    for i, (name, run) in enumerate(runs.items()):
        setpoint, label_unit = _in_degrees(run[f"{symbol}_setpoint_{unit}"], unit)
        position, _ = _in_degrees(run[f"{symbol}_{unit}"], unit)
        grey = COLOURS["setpoint"]
        legend = "setpoint" if i == 0 else None
        ax.plot(run.t, setpoint, ":", color=grey, label=legend)
        ax.plot(run.t, position, color=run_colour(i), label=name or label)
        ax.set_ylabel(f"{label} [{label_unit}]")
    _widen(ax)
    ax.legend(ncols=3, fontsize=9.0)


def _draw_passive(
    ax: Axes, runs: Mapping[str, TimeSeries], symbols: Sequence[str], unit: str
) -> None:
    styles = dict(zip(symbols, ("-", "--", ":", "-."), strict=False)) | LINE_STYLES
    for i, (name, run) in enumerate(runs.items()):
        for symbol in symbols:
            values, label_unit = _in_degrees(run[f"{symbol}_{unit}"], unit)
            label = f"{GREEK.get(symbol, symbol)} {name}".strip()
            ax.plot(run.t, values, styles.get(symbol, "-"), color=run_colour(i), label=label)
            ax.set_ylabel(f"{_PASSIVE_TITLES[unit]} [{label_unit}]")
    _widen(ax)
    ax.legend(ncols=4, fontsize=9.0)


def _widen(ax: Axes) -> None:
    """Widen the axis of a constant quantity, so that round-off is not magnified."""
    low, high = ax.get_ylim()
    if high - low < _LEAST_SPAN:
        middle = (low + high) / 2
        ax.set_ylim(middle - _LEAST_SPAN / 2, middle + _LEAST_SPAN / 2)


def _in_degrees(values: np.ndarray, unit: str) -> tuple[np.ndarray, str]:
    """Return values and unit as they are drawn: angles in degrees, all else unchanged."""
    return (np.degrees(values), "°") if unit == "rad" else (values, unit)
