"""A run as a figure: its drives beside where they should be, and the swing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cranedyn.data.trajectory import Trajectory
from cranedyn.plotting.figures import panels
from cranedyn.plotting.runs import STYLES, run_colour
from cranedyn.plotting.style import COLOURS, colour_of

_LEAST = 1e-3
"""Smallest span of an axis [° or m]."""

_PASSIVE = {"rad": "swing", "m": "stretch"}
"""What passive joints do, by the unit of their coordinates."""

_GREEK = {"gamma": "γ", "phi": "φ", "theta": "θ"}


def plot(run: Trajectory, *columns: str) -> Figure:
    """Columns of a run over time, one panel for each; without names the drives and the swing.

    Raises:
        UnknownColumn: If there is no column of a name.
    """
    if not columns:
        return plot_runs({"": run})
    for name in columns:
        run[name]
    figure, axes = panels(len(columns), height=1.8 if len(columns) > 1 else 3.0, sharex=True)
    for ax, name in zip(axes, columns, strict=True):
        values, unit = _for_people(run[name], name.rpartition("_")[2])
        ax.plot(run.t, values, color=colour_of(name.split("_")[0]))
        ax.set_ylabel(f"{name.removesuffix('_rad')} [°]" if unit == "°" else name)
    axes[-1].set_xlabel("time [s]")
    return figure


def plot_runs(runs: Mapping[str, Trajectory]) -> Figure:
    """The drives, the swing and the stretch of several runs, each in a colour of its own; solid is
    radial and dashed tangential swing.

    Args:
        runs: By name; a single one may be without.
    """
    first = next(iter(runs.values()))
    symbols = {symbol: unit for symbol, unit in _coordinates(first.keys())}
    drives = [
        symbol for symbol, unit in symbols.items() if f"{symbol}_setpoint_{unit}" in first.keys()
    ]
    passive = [
        [symbol for symbol in symbols if symbol not in drives and symbols[symbol] == unit]
        for unit in _PASSIVE
    ]
    together = [of_unit for of_unit in passive if of_unit]
    figure, axes = panels(len(drives) + len(together), height=1.7, sharex=True)
    for ax, symbol in zip(axes, drives, strict=False):
        _draw_drive(ax, runs, symbol, symbols[symbol])
    for ax, of_unit in zip(axes[len(drives) :], together, strict=True):
        _draw_passive(ax, runs, of_unit, symbols[of_unit[0]])
    axes[-1].set_xlabel("time [s]")
    return figure


def _draw_drive(ax: Axes, runs: Mapping[str, Trajectory], symbol: str, unit: str) -> None:
    for i, (name, run) in enumerate(runs.items()):
        wanted, shown = _for_people(run[f"{symbol}_setpoint_{unit}"], unit)
        ax.plot(run.t, wanted, ":", color=COLOURS["setpoint"], label="setpoint" if i == 0 else None)
        ax.plot(
            run.t,
            _for_people(run[f"{symbol}_{unit}"], unit)[0],
            color=run_colour(i),
            label=name or _word(symbol),
        )
        ax.set_ylabel(f"{_word(symbol)} [{shown}]")
    _widen(ax)
    ax.legend(ncols=3, fontsize=9.0)


def _draw_passive(
    ax: Axes, runs: Mapping[str, Trajectory], symbols: Sequence[str], unit: str
) -> None:
    styles = dict(zip(symbols, ("-", "--", ":", "-."), strict=False)) | STYLES
    for i, (name, run) in enumerate(runs.items()):
        for symbol in symbols:
            values, shown = _for_people(run[f"{symbol}_{unit}"], unit)
            label = " ".join(filter(None, (_word(symbol), name)))
            ax.plot(run.t, values, styles.get(symbol, "-"), color=run_colour(i), label=label)
            ax.set_ylabel(f"{_PASSIVE[unit]} [{shown}]")
    _widen(ax)
    ax.legend(ncols=4, fontsize=9.0)


def _widen(ax: Axes) -> None:
    """Show what stands still as that, and not the noise of its last digits."""
    low, high = ax.get_ylim()
    if high - low < _LEAST:
        middle = (low + high) / 2
        ax.set_ylim(middle - _LEAST / 2, middle + _LEAST / 2)


def _coordinates(names: Sequence[str]) -> list[tuple[str, str]]:
    """Symbol and unit of each coordinate: a column that has a rate."""
    split = [name.rpartition("_") for name in names]
    return [(symbol, unit) for symbol, _, unit in split if f"{symbol}_dot_{unit}_s" in names]


def _for_people(values: np.ndarray, unit: str) -> tuple[np.ndarray, str]:
    """Angles in degrees."""
    return (np.degrees(values), "°") if unit == "rad" else (values, unit)


def _word(symbol: str) -> str:
    return _GREEK.get(symbol, symbol)
