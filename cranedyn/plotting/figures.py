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
from matplotlib.legend import Legend
from matplotlib.text import Text
from matplotlib.ticker import LogFormatter

from cranedyn.data.files import atomic_write, with_ending
from cranedyn.data.time_series import TimeSeries
from cranedyn.errors import CraneError
from cranedyn.plotting.style import COLOURS, GREEK, LINE_STYLES, RC, colour_of, run_colour

__all__ = ["COLOURS", "legend_above", "panels", "save"]

_DPI = 130
"""Resolution of a picture [dots per inch]."""


_ENDINGS = (".png", ".svg", ".pdf")
"""Endings of the files in which a figure can be saved."""

_NOTEBOOK_DPI = 90
"""Resolution of a figure in a notebook [dots per inch]."""

_NIGHT = Path(__file__).with_name("night.css").read_bytes()
"""Style sheet of a drawing for readers who prefer a dark page."""

_MIN_SPAN = 1e-3
"""Smallest span of an axis [° or m]."""

_LEGEND_FONT_SIZE = 9.0
"""Size of the letters of a legend [points]."""

_LEGEND_SHARE = 0.85
"""Largest width of a legend over that of its panel with labels, which take the rest."""

_PASSIVE_TITLES = {"rad": "swing", "m": "stretch"}
"""Label of the passive coordinates by their unit."""

_PASSIVE_LINE_STYLES = ("-", "--", ":", "-.")
"""Line styles of passive coordinates in their order, where `LINE_STYLES` names none."""


class _NotebookFigure(Figure):
    """A figure that notebooks display, and whose texts are names and no formulas."""

    def draw(self, renderer: Any) -> None:
        """Draw as Matplotlib does, with texts as they are."""
        take_texts_literally(self)
        super().draw(renderer)

    def _repr_png_(self) -> bytes:
        """Return the picture that a notebook shows."""
        with mpl.rc_context(RC), io.BytesIO() as file:
            self.savefig(file, format="png", dpi=_NOTEBOOK_DPI)
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
                for label in axis.get_ticklabels(which="both"):
                    formulas.add(id(label))
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
        axes = figure.subplots(rows, columns, squeeze=False, **arguments)
        return figure, list(axes.flat)


def legend_above(ax: Axes, *, columns: int = 4) -> Legend:
    """Put the legend of a panel above it, where it covers no curve; a title moves above both.

    Args:
        ax: The panel.
        columns: Largest number of entries side by side. There are fewer where so many would be
            wider than the panel: they would meet the legend of the next panel, and the layout of
            the figure would make the panel itself narrower.
    """
    legend = _legend_with_columns(ax, columns)
    while columns > 1 and legend.get_window_extent().width > _LEGEND_SHARE * _width(ax):
        columns -= 1
        legend = _legend_with_columns(ax, columns)
    rows = -(-len(legend.get_texts()) // columns)
    for place in ("left", "center", "right"):
        title = ax.get_title(loc=place)
        if title:
            ax.set_title(title, loc=place, pad=6.0 + 1.7 * _LEGEND_FONT_SIZE * rows)
    return legend


def _legend_with_columns(ax: Axes, columns: int) -> Legend:
    """Put a legend with a number of columns above a panel, instead of the one that is there."""
    legend = ax.legend(
        loc="lower left",
        bbox_to_anchor=(-0.01, 0.99),
        ncols=columns,
        fontsize=_LEGEND_FONT_SIZE,
        frameon=False,
        borderaxespad=0.2,
    )
    # Before its size is asked for, see `take_texts_literally`.
    for entry in legend.get_texts():
        entry.set_parse_math(False)
    return legend


def _width(ax: Axes) -> float:
    """Return the width that a panel and its labels have in a figure [pixel]."""
    width = float(ax.figure.bbox.width)
    place = ax.get_subplotspec()
    if place is None:
        return width
    return width * len(place.colspan) / place.get_gridspec().ncols


def save(figure: Figure, path: str | Path, *further: str | Path) -> Path:
    """Write a figure as ``.png``, ``.svg`` or ``.pdf`` and return the first path; the same figure
    gives the same files.

    Args:
        figure: The figure.
        path: The file.
        further: More files of the same figure, with the panels at the same positions.

    Raises:
        DataError: If a file cannot be written, or has another ending.
    """
    for file in (path, *further):
        with_ending(file, *_ENDINGS)
    engine = figure.get_layout_engine()
    # Before the layout asks for the sizes of the texts.
    take_texts_literally(figure)
    with mpl.rc_context(RC):
        if engine is not None:
            # All files get the layout of a picture, and keep it: an engine would lay the figure out
            # anew for each, and sizes of texts depend on the resolution.
            dpi = figure.dpi
            figure.set_dpi(_DPI)
            engine.execute(figure)
            figure.set_dpi(dpi)
            figure.set_layout_engine(None)
        try:
            for file in (path, *further):
                ending = Path(file).suffix.removeprefix(".")
                # Matplotlib would leave a file of its own open if Ctrl-C interrupts it.
                with atomic_write(Path(file)) as draft:
                    draft.write_bytes(_content(figure, ending))
        finally:
            figure.set_layout_engine(engine)
    return Path(path)


def _content(figure: Figure, ending: str) -> bytes:
    """Return the content of a file of a figure with an ending of `_ENDINGS`, without its dot."""
    if ending == "svg":
        return svg(figure)
    if ending == "pdf":
        # Matplotlib writes the time of day unless the date is None.
        return _picture(figure, ending, metadata={"CreationDate": None})
    return _picture(figure, ending)


def svg(figure: Figure) -> bytes:
    """Return a figure as SVG whose paper is dark where its reader prefers that; the same figure
    gives the same bytes.
    """
    with mpl.rc_context(RC):
        # Matplotlib writes the time of day unless the date is None.
        content = _picture(figure, "svg", metadata={"Date": None})
    return content.replace(b"</style>", _NIGHT + b"</style>", 1)


def _picture(figure: Figure, ending: str, **arguments: Any) -> bytes:
    """Return the content of a file of a figure with an ending, such as "png"."""
    file = io.BytesIO()
    take_texts_literally(figure)
    figure.savefig(file, format=ending, dpi=_DPI, **arguments)
    return file.getvalue()


def plot_columns(series: TimeSeries, *columns: str) -> Figure:
    """Draw columns over time in one panel each.

    Without columns draw the drives of a trajectory beside their setpoints and its swing, and of any
    other table its principal columns.

    Args:
        series: A trajectory or another table.
        columns: Names of columns.

    Raises:
        UnknownColumn: If there is no column of a name.
    """
    if not columns and series.coordinate_keys:
        return plot_runs({"": series})
    columns = columns or tuple(series.principal_keys)
    # All columns are looked up before anything is drawn: an unknown one leaves no figure behind.
    curves = [_column_in_degrees(series, name) for name in columns]
    figure, axes = panels(len(columns), height=_height_for(columns), sharex=True)
    for ax, name, values in zip(axes, columns, curves, strict=True):
        ax.plot(series.t, values, color=colour_of(name.split("_")[0]))
        ax.set_ylabel(_column_label(name))
    axes[-1].set_xlabel("time [s]")
    return figure


def plot_runs(
    runs: Mapping[str, TimeSeries],
    *columns: str,
    width: float = 9.0,
    height: float | None = None,
    font_size: float | None = None,
) -> Figure:
    """Draw several runs over time, each in its own colour: columns of them, one panel each.

    Without columns draw the drives beside their setpoints, the swing and the stretch of runs of one
    crane.

    Args:
        runs: Trajectories or other tables by name; the name of a single one may be empty.
        columns: Names of columns that all runs have.
        width: Width of the figure [inch].
        height: Height of one panel [inch]; by default it suits the number of panels.
        font_size: Size of all letters [points]; by default those of `cranedyn.plotting.style.RC`.

    Raises:
        UnknownColumn: If a run has no column of a name.
        CraneError: If there is no run.
    """
    if not runs:
        raise CraneError("There is no run to draw: give at least one, by its name.")
    if columns:
        figure = _column_panels(runs, columns, width, height)
    else:
        figure = _coordinate_panels(runs, width, height)
    if font_size is not None:
        _set_font_size(figure, font_size)
    return figure


def _column_panels(
    runs: Mapping[str, TimeSeries], columns: Sequence[str], width: float, height: float | None
) -> Figure:
    """Return a figure with a panel for each column, which shows it in all runs."""
    # All columns are looked up before anything is drawn: an unknown one leaves no figure behind.
    curves = [[_column_in_degrees(run, name) for run in runs.values()] for name in columns]
    if height is None:
        height = _height_for(columns)
    figure, axes = panels(len(columns), height=height, width=width, sharex=True)
    for ax, column, values_of_runs in zip(axes, columns, curves, strict=True):
        for i, (name, run) in enumerate(runs.items()):
            ax.plot(run.t, values_of_runs[i], color=run_colour(i), label=name)
        ax.set_ylabel(_column_label(column))
    # One legend: a run has the same colour in every panel.
    if len(runs) > 1:
        legend_above(axes[0])
    axes[-1].set_xlabel("time [s]")
    return figure


def _coordinate_panels(
    runs: Mapping[str, TimeSeries], width: float, height: float | None
) -> Figure:
    """Return a figure with a panel for each drive, and one for the passive coordinates of each
    unit.
    """
    first = next(iter(runs.values()))
    # Names of coordinates are those of their symbols with the unit: phi_rad, l_m.
    units = dict(name.rsplit("_", 1) for name in first.coordinate_keys)
    # A coordinate with a setpoint is that of a drive.
    drives = [symbol for symbol, unit in units.items() if f"{symbol}_setpoint_{unit}" in first]
    passive_groups = []
    for group_unit in _PASSIVE_TITLES:
        symbols = []
        for symbol, unit in units.items():
            if unit == group_unit and symbol not in drives:
                symbols.append(symbol)
        if symbols:
            passive_groups.append(symbols)

    if height is None:
        height = 1.7
    count = len(drives) + len(passive_groups)
    figure, axes = panels(count, height=height, width=width, sharex=True)
    for ax, symbol in zip(axes, drives, strict=False):
        _draw_drive(ax, runs, symbol, units[symbol])
    for ax, symbols in zip(axes[len(drives) :], passive_groups, strict=True):
        _draw_passive(ax, runs, symbols, units[symbols[0]])
    axes[-1].set_xlabel("time [s]")
    return figure


def _draw_drive(ax: Axes, runs: Mapping[str, TimeSeries], symbol: str, unit: str) -> None:
    """Draw the coordinate of a drive beside its setpoint, which the legend names once."""
    label = GREEK.get(symbol, symbol)
    is_named = False
    for i, (name, run) in enumerate(runs.items()):
        position, label_unit = _in_degrees(run[f"{symbol}_{unit}"], unit)
        if _has_reference(run):
            setpoint, _ = _in_degrees(run[f"{symbol}_setpoint_{unit}"], unit)
            legend = None if is_named else "setpoint"
            ax.plot(run.t, setpoint, ":", color=COLOURS["setpoint"], label=legend)
            is_named = True
        ax.plot(run.t, position, color=run_colour(i), label=name or label)
        ax.set_ylabel(f"{label} [{label_unit}]")
    _widen(ax)
    # The label of the axis says what a single curve is.
    if len(ax.lines) > 1:
        legend_above(ax)


def _has_reference(run: TimeSeries) -> bool:
    """Return whether somebody commanded the setpoints of a run.

    A run without a reference has its start as setpoints, which nobody commanded. A table without a
    record, such as one from a CSV file, does not say.
    """
    record = getattr(run, "record", {})
    return "reference" in record or "controller" not in record


def _draw_passive(
    ax: Axes, runs: Mapping[str, TimeSeries], symbols: Sequence[str], unit: str
) -> None:
    """Draw passive coordinates of one unit: colours tell runs apart, line styles coordinates."""
    styles = dict(zip(symbols, _PASSIVE_LINE_STYLES, strict=False))
    styles.update(LINE_STYLES)
    for i, (name, run) in enumerate(runs.items()):
        for symbol in symbols:
            values, label_unit = _in_degrees(run[f"{symbol}_{unit}"], unit)
            label = f"{GREEK.get(symbol, symbol)} {name}".strip()
            ax.plot(run.t, values, styles.get(symbol, "-"), color=run_colour(i), label=label)
            ax.set_ylabel(f"{_PASSIVE_TITLES[unit]} [{label_unit}]")
    _widen(ax)
    # The label of the axis says what a single curve is.
    if len(ax.lines) > 1:
        legend_above(ax)


def _widen(ax: Axes) -> None:
    """Widen the axis of a constant quantity, so that round-off is not magnified."""
    low, high = ax.get_ylim()
    if high - low < _MIN_SPAN:
        middle = (low + high) / 2
        ax.set_ylim(middle - _MIN_SPAN / 2, middle + _MIN_SPAN / 2)


def _height_for(columns: Sequence[str]) -> float:
    """Return the usual height of a panel of so many columns below each other [inch]."""
    return 1.8 if len(columns) > 1 else 3.0


def _column_in_degrees(series: TimeSeries, name: str) -> np.ndarray:
    """Return a column as it is drawn: angles in degrees, all else unchanged."""
    values, _ = _in_degrees(series[name], name.rpartition("_")[2])
    return values


def _column_label(name: str) -> str:
    """Return the label of the axis of a column: its name, which has its unit, or degrees."""
    return f"{name.removesuffix('_rad')} [°]" if name.endswith("_rad") else name


def _set_font_size(figure: Figure, size: float) -> None:
    """Give all letters of the panels of a figure the same size [points]."""
    for ax in figure.axes:
        # Also of the labels that Matplotlib makes later.
        ax.tick_params(labelsize=size)
        ax.xaxis.label.set_fontsize(size)
        ax.yaxis.label.set_fontsize(size)
        legend = ax.get_legend()
        if legend is not None:
            for text in legend.get_texts():
                text.set_fontsize(size)


def _in_degrees(values: np.ndarray, unit: str) -> tuple[np.ndarray, str]:
    """Return values and unit as they are drawn: angles in degrees, all else unchanged."""
    return (np.degrees(values), "°") if unit == "rad" else (values, unit)
