"""Every number of a run as time series: one table for each run, and the plots of its columns.

All columns stand in one component of one entity: an entity for each plot makes a recording 40 %
larger.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import VisualizerComponentMapping

from cranedyn.data.trajectory import Trajectory
from cranedyn.model.layout import Joint, Layout
from cranedyn.plotting.style import colour_of, mixed, rgb
from cranedyn.recording.run import Run, clock, colours

_RADIANS = re.compile(r"_rad(?=$|_s$)")
"""The unit at the end of a column's name; a joint may be called radial."""

Table = dict[str, np.ndarray]
"""Columns by name, shape (n,) each."""


class Curve(NamedTuple):
    """One curve of a plot: its label, the quantity that gives its colour, and the column it
    shows.
    """

    label: str
    quantity: str
    column: str


class Plot(NamedTuple):
    """What a plot shows: its title with the unit, the smallest span of its axis in that unit, and
    its curves, the last on top.
    """

    title: str
    least: float
    curves: tuple[Curve, ...]


_TITLES = {"gamma": "Slew", "x": "Trolley", "l": "Cable"}
_LABELS = {"gamma": "γ", "phi": "φ", "theta": "θ"}
_WORDS = {"phi": "φ radial", "theta": "θ tangential"}
_DRIVES = {"gamma": "slew", "x": "trolley", "l": "hoist"}


def plots(layout: Layout) -> dict[str, Plot]:
    """The plots of a crane by name: a drive's by its symbol, its effort's by its column without the
    unit.
    """
    found = {joint.symbol: _position(joint) for joint in layout.driven}
    passive = [joint for joint in layout.joints if not joint.driven]
    for name, title, kind in (("swing", "Swing", "revolute"), ("stretch", "Stretch", "prismatic")):
        if some := [joint for joint in reversed(passive) if joint.kind == kind]:
            curves = tuple(
                Curve(
                    _WORDS.get(joint.symbol, joint.symbol),
                    joint.symbol,
                    f"{joint.symbol}_{_shown(joint)[1]}",
                )
                for joint in some
            )
            found[name] = Plot(f"{title} [{_shown(some[0])[0]}]", _shown(some[0])[2], curves)
    for name, kind in (("speeds", "prismatic"), ("angular speeds", "revolute")):
        order = (
            [*(joint for joint in layout.driven), *reversed(passive)]
            if kind == "revolute"
            else [*reversed(layout.driven), *passive]
        )
        if some := [joint for joint in order if joint.kind == kind]:
            unit, ending, least = _shown(some[0])
            curves = tuple(
                Curve(f"d{_label(joint)}/dt", joint.symbol, f"{joint.symbol}_dot_{ending}_s")
                for joint in some
            )
            found[name] = Plot(f"Speed [{unit}/s]", least, curves)
    for joint, column in zip(layout.driven, layout.columns()["effort"], strict=True):
        found[column.rpartition("_")[0]] = _effort(joint, column)
    work = [
        Curve(
            f"work of {_DRIVES.get(joint.symbol, joint.symbol)}",
            joint.symbol,
            f"W_{joint.symbol}_J",
        )
        for joint in layout.driven
    ]
    taken = (
        Curve("dissipated", "dissipated", "dissipated_J"),
        Curve("unexplained", "unexplained", "unexplained_J"),
        Curve("gained", "energy", "energy_J"),
    )
    return found | {"energy": Plot("Energy [J]", 20.0, (*work, *taken))}


def _shown(joint: Joint) -> tuple[str, str, float]:
    """Unit of a coordinate before people and in columns, and the smallest span of its axis."""
    return ("°", "deg", 0.2) if joint.kind == "revolute" else ("m", "m", 0.02)


def _label(joint: Joint) -> str:
    return _LABELS.get(joint.symbol, joint.symbol)


def _position(joint: Joint) -> Plot:
    unit, ending, least = _shown(joint)
    curves = (
        Curve("setpoint", "setpoint", f"{joint.symbol}_setpoint_{ending}"),
        Curve(_label(joint), joint.symbol, f"{joint.symbol}_{ending}"),
    )
    return Plot(f"{_TITLES.get(joint.symbol, joint.symbol)} [{unit}]", least, curves)


def _effort(joint: Joint, column: str) -> Plot:
    limits = (
        Curve("limit", "limit", f"{column}_lower"),
        Curve("limit", "limit", f"{column}_upper"),
    )
    drive, what = (
        _DRIVES.get(joint.symbol, joint.symbol),
        "torque" if joint.kind == "revolute" else "force",
    )
    title = f"{drive[:1].upper()}{drive[1:]} {what} [{joint.effort_unit}]"
    return Plot(title, 20.0, (*limits, Curve(f"{column[0]}_{_label(joint)}", joint.symbol, column)))


def table(run: Run, start_energy: float | None = None) -> Table:
    """What is recorded of a run: its columns with angles in degrees and energy since the start, and
    the limits of the drives.

    Where the trajectory goes on from earlier pieces, the energy at their start [J] is given.
    """
    trajectory, columns, names = run.trajectory, {}, run.trajectory.columns
    start = trajectory.energy[0] if start_energy is None else start_energy
    for name in (
        name
        for key in ("q", "v", "setpoint", "effort", "work", "dissipated", *_outside(trajectory))
        for name in names[key]
    ):
        degrees = _RADIANS.sub("_deg", name)
        columns[degrees] = trajectory[name] if degrees == name else np.degrees(trajectory[name])
    columns |= {"energy_J": trajectory.energy - start, "unexplained_J": trajectory.ledger - start}
    for name, limit in zip(names["effort"], run.crane.effort_limit, strict=True):
        columns |= {
            f"{name}_lower": np.full(len(trajectory), -limit),
            f"{name}_upper": np.full(len(trajectory), limit),
        }
    return columns


def _outside(trajectory: Trajectory) -> tuple[str, ...]:
    """The columns of what acts from outside, where anything does."""
    return ("force", "outside") if trajectory.force.any() or trajectory.outside.any() else ()


def log_series(recording: rr.RecordingStream, run: Run, columns: Table) -> None:
    """Write the table of one run, all its rows."""
    rows = pa.StructArray.from_arrays(
        [pa.array(np.ascontiguousarray(values)) for values in columns.values()], names=list(columns)
    )
    component = rr.DynamicArchetype.columns(archetype="Run", components={"row": rows})
    recording.send_columns(run.entity("numbers"), clock(run.trajectory.t), component)


def plot(
    name: str, runs: Sequence[Run], tables: Sequence[Table], title: str = ""
) -> rrb.TimeSeriesView:
    """The view of one plot: its curves of each run whose crane has it.

    One run has a colour for each quantity, of several each has its own colour; the legend names
    every curve. Where several runs show two angles, the radial one is the broad line and the
    tangential one the fine line.

    Without tables the axes find their own ranges, as they must while a run is under way.
    """
    kinds = [plots(run.crane.layout).get(name) for run in runs]
    columns = [
        (kind, of_run) for kind, of_run in zip(kinds, tables, strict=False) if kind is not None
    ]
    overrides: dict[Any, Any] = {}
    several = len(runs) > 1 and not title
    for run, kind, colour in zip(runs, kinds, colours(runs), strict=True):
        if kind is not None:
            overrides[run.entity("numbers")] = [
                _line(
                    curve,
                    f"{curve.label} · {run.name}" if several else curve.label,
                    _ink(curve, colour, several),
                    _width(curve, several),
                )
                for curve in kind.curves
            ]
    return rrb.TimeSeriesView(
        name=title or next(kind.title for kind in kinds if kind is not None),
        origin="/",
        contents=[f"+ {path}" for path in overrides],
        overrides=overrides,
        axis_x=rrb.TimeAxis(view_range=_whole_time(runs)) if tables else None,
        axis_y=rrb.ScalarAxis(range=_span(columns)) if tables else None,
        plot_legend=rrb.PlotLegend(corner="RightTop"),
    )


def _ink(curve: Curve, colour: str, several: bool) -> str:
    """The hex colour of a curve: of its quantity where there is one run, of its run where there are
    several; limits and setpoints grey.
    """
    if several and curve.quantity not in ("limit", "setpoint"):
        return colour
    ink = colour_of(curve.quantity).replace("#000000", "#9A9A9A")
    return mixed(ink, colour, 0.3) if several else ink


def _width(curve: Curve, several: bool) -> float:
    """Of a line [points]: Rerun has no dashes, so that of several runs the tangential swing is
    finer.
    """
    return {"phi": 2.2, "theta": 1.0}.get(curve.quantity, 1.5) if several else 1.5


def _line(curve: Curve, label: str, ink: str, width: float) -> rrb.visualizers.Visualizer:
    """A curve; where many rows fall on one pixel, efforts and energies show their extremes, all
    else the mean.
    """
    policy: Literal["MinMax", "Average"] = (
        "MinMax" if curve.column.split("_")[0] in ("T", "F", "W", "energy") else "Average"
    )
    source = VisualizerComponentMapping(
        "Scalars:scalars",
        "SourceComponent",
        source_component="Run:row",
        selector=f".{curve.column}",
    )
    return rr.SeriesLines(
        colors=[rgb(ink)], names=[label], widths=[width], aggregation_policy=policy
    ).visualizer(mappings=[source])


def _whole_time(runs: Sequence[Run]) -> rr.TimeRange:
    """From the first to the last row of all runs; of a long run Rerun would show a minute."""
    first, last = (
        min(run.trajectory.t[0] for run in runs),
        max(run.trajectory.t[-1] for run in runs),
    )
    boundary = rrb.TimeRangeBoundary.absolute
    return rr.TimeRange(start=boundary(seconds=float(first)), end=boundary(seconds=float(last)))


def _span(columns: Sequence[tuple[Plot, Table]]) -> tuple[float, float]:
    """Range of the axis: what the drives and the load do, out to a round number that the axis names
    if one is near, and a margin.

    The limit of a drive appears in the margin when an effort comes near it.
    """
    values = [
        of_run[curve.column]
        for shown, of_run in columns
        for curve in shown.curves
        if curve.quantity != "limit"
    ]
    low, high = float(min(v.min() for v in values)), float(max(v.max() for v in values))
    least = columns[0][0].least
    span = max(high - low, least)
    step = 10.0 ** np.floor(np.log10(span))
    below, above = step * np.floor(low / step), step * np.ceil(high / step)
    low, high = (
        (below if low - below < 0.2 * span else low),
        (above if above - high < 0.2 * span else high),
    )
    margin = max(0.05 * span, (least - (high - low)) / 2)
    return low - margin, high + margin
