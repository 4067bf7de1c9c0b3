"""Curves of runs over time: columns, drives beside their setpoints, and swing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cranedyn.data.time_series import TimeSeries
from cranedyn.plotting.figures import panels
from cranedyn.plotting.style import COLOURS, LINE_STYLES, colour_of, run_colour

_LEAST_SPAN = 1e-3
"""Smallest span of an axis [° or m]."""

_PASSIVE_TITLES = {"rad": "swing", "m": "stretch"}
"""Label of the passive coordinates by their unit."""

_GREEK = {"gamma": "γ", "phi": "φ", "theta": "θ"}


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
    label = _GREEK.get(symbol, symbol)
    for i, (name, run) in enumerate(runs.items()):
        setpoint, label_unit = _in_degrees(run[f"{symbol}_setpoint_{unit}"], unit)
        position, _ = _in_degrees(run[f"{symbol}_{unit}"], unit)
        grey, legend = COLOURS["setpoint"], "setpoint" if i == 0 else None
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
            label = f"{_GREEK.get(symbol, symbol)} {name}".strip()
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
