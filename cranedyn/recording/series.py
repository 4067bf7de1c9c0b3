"""Every number of a run as time series: one table for each run, and the plots of its columns.

All columns stand in one component of one entity: an entity for each plot makes a recording 40 % larger.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import VisualizerComponentMapping

from cranedyn.data.trajectory import COLUMNS, Trajectory
from cranedyn.plotting.style import COLOURS, mixed, rgb
from cranedyn.recording.run import Run, clock, colours

Table = dict[str, np.ndarray]
"""Columns by name, shape (n,) each."""


class Curve(NamedTuple):
    """One curve of a plot: its label, the quantity that gives its colour, and the column it shows."""

    label: str
    quantity: str
    column: str


class Plot(NamedTuple):
    """What a plot shows: its title with the unit, the smallest span of its axis in that unit, and its curves, the last on top."""

    title: str
    least: float
    curves: tuple[Curve, ...]


def _effort(title: str, label: str, quantity: str, column: str) -> Plot:
    limits = (Curve("limit", "limit", f"{column}_lower"), Curve("limit", "limit", f"{column}_upper"))
    return Plot(title, 20.0, (*limits, Curve(label, quantity, column)))


PLOTS = {
    "gamma": Plot("Slew [°]", 0.2, (Curve("setpoint", "setpoint", "gamma_setpoint_deg"), Curve("γ", "gamma", "gamma_deg"))),
    "x": Plot("Trolley [m]", 0.02, (Curve("setpoint", "setpoint", "x_setpoint_m"), Curve("x", "x", "x_m"))),
    "l": Plot("Cable [m]", 0.02, (Curve("setpoint", "setpoint", "l_setpoint_m"), Curve("l", "l", "l_m"))),
    "swing": Plot("Swing [°]", 0.2, (Curve("θ tangential", "theta", "theta_deg"), Curve("φ radial", "phi", "phi_deg"))),
    "speeds": Plot("Speed [m/s]", 0.02, (Curve("dl/dt", "l", "l_dot_m_s"), Curve("dx/dt", "x", "x_dot_m_s"))),
    "angular speeds": Plot(
        "Speed [°/s]",
        0.2,
        (Curve("dγ/dt", "gamma", "gamma_dot_deg_s"), Curve("dθ/dt", "theta", "theta_dot_deg_s"), Curve("dφ/dt", "phi", "phi_dot_deg_s")),
    ),
    "T_gamma": _effort("Slew torque [N m]", "T_γ", "gamma", "T_gamma_Nm"),
    "F_x": _effort("Trolley force [N]", "F_x", "x", "F_x_N"),
    "F_l": _effort("Hoist force [N]", "F_l", "l", "F_l_N"),
    "energy": Plot(
        "Energy [J]",
        20.0,
        (
            Curve("work of slew", "gamma", "W_gamma_J"),
            Curve("work of trolley", "x", "W_x_J"),
            Curve("work of hoist", "l", "W_l_J"),
            Curve("dissipated", "dissipated", "dissipated_J"),
            Curve("unexplained", "unexplained", "unexplained_J"),
            Curve("gained", "energy", "energy_J"),
        ),
    ),
}
"""The plots by name."""


def table(run: Run, start_energy: float | None = None) -> Table:
    """What is recorded of a run: its columns with angles in degrees and energy since the start, and the limits of the drives.

    Where the trajectory goes on from earlier pieces, the energy at their start [J] is given.
    """
    trajectory, columns = run.trajectory, {}
    start = trajectory.energy[0] if start_energy is None else start_energy
    for name in (name for key in ("q", "v", "setpoint", "effort", "work", "dissipated", *_outside(trajectory)) for name in COLUMNS[key]):
        columns[name.replace("_rad", "_deg")] = np.degrees(trajectory[name]) if "_rad" in name else trajectory[name]
    columns |= {"energy_J": trajectory.energy - start, "unexplained_J": trajectory.ledger - start}
    for name, limit in zip(COLUMNS["effort"], run.crane.effort_limit, strict=True):
        columns |= {f"{name}_lower": np.full(len(trajectory), -limit), f"{name}_upper": np.full(len(trajectory), limit)}
    return columns


def _outside(trajectory: Trajectory) -> tuple[str, ...]:
    """The columns of what acts from outside, where anything does."""
    return ("force", "outside") if trajectory.force.any() or trajectory.outside.any() else ()


def log_series(recording: rr.RecordingStream, run: Run, columns: Table) -> None:
    """Write the table of one run, all its rows."""
    rows = pa.StructArray.from_arrays([pa.array(np.ascontiguousarray(values)) for values in columns.values()], names=list(columns))
    component = rr.DynamicArchetype.columns(archetype="Run", components={"row": rows})
    recording.send_columns(run.entity("numbers"), clock(run.trajectory.t), component)


def plot(name: str, runs: Sequence[Run], tables: Sequence[Table], title: str = "") -> rrb.TimeSeriesView:
    """The view of one plot: one run has a colour for each quantity, of several each has its own colour; the legend names every curve.

    Where several runs show two angles, the radial one is the broad line and the tangential one the fine line.

    Without tables the axes find their own ranges, as they must while a run is under way.
    """
    shown = PLOTS[name]
    overrides: dict[Any, Any] = {}
    for run, colour in zip(runs, colours(runs), strict=True):
        several = len(runs) > 1 and not title
        lines = [
            _line(curve, f"{curve.label} · {run.name}" if several else curve.label, _ink(curve, colour, several), _width(curve, several))
            for curve in shown.curves
        ]
        overrides[run.entity("numbers")] = lines
    return rrb.TimeSeriesView(
        name=title or shown.title,
        origin="/",
        contents=[f"+ {path}" for path in overrides],
        overrides=overrides,
        axis_x=rrb.TimeAxis(view_range=_whole_time(runs)) if tables else None,
        axis_y=rrb.ScalarAxis(range=_span(shown, tables)) if tables else None,
        plot_legend=rrb.PlotLegend(corner="RightTop"),
    )


def _ink(curve: Curve, colour: str, several: bool) -> str:
    """The hex colour of a curve: of its quantity where there is one run, of its run where there are several; limits and setpoints grey."""
    if several and curve.quantity not in ("limit", "setpoint"):
        return colour
    ink = COLOURS[curve.quantity].replace("#000000", "#9A9A9A")
    return mixed(ink, colour, 0.3) if several else ink


def _width(curve: Curve, several: bool) -> float:
    """Of a line [points]: Rerun has no dashes, so that of several runs the tangential swing is finer."""
    return {"phi": 2.2, "theta": 1.0}.get(curve.quantity, 1.5) if several else 1.5


def _line(curve: Curve, label: str, ink: str, width: float) -> rrb.visualizers.Visualizer:
    """A curve; where many rows fall on one pixel, efforts and energies show their extremes, all else the mean."""
    policy: Literal["MinMax", "Average"] = "MinMax" if curve.column.split("_")[0] in ("T", "F", "W", "energy") else "Average"
    source = VisualizerComponentMapping("Scalars:scalars", "SourceComponent", source_component="Run:row", selector=f".{curve.column}")
    return rr.SeriesLines(colors=[rgb(ink)], names=[label], widths=[width], aggregation_policy=policy).visualizer(mappings=[source])


def _whole_time(runs: Sequence[Run]) -> rr.TimeRange:
    """From the first to the last row of all runs; of a long run Rerun would show a minute."""
    first, last = min(run.trajectory.t[0] for run in runs), max(run.trajectory.t[-1] for run in runs)
    boundary = rrb.TimeRangeBoundary.absolute
    return rr.TimeRange(start=boundary(seconds=float(first)), end=boundary(seconds=float(last)))


def _span(shown: Plot, tables: Sequence[Table]) -> tuple[float, float]:
    """Range of the axis: what the drives and the load do, out to a round number that the axis names if one is near, and a margin.

    The limit of a drive appears in the margin when an effort comes near it.
    """
    values = [columns[curve.column] for columns in tables for curve in shown.curves if curve.quantity != "limit"]
    low, high = float(min(v.min() for v in values)), float(max(v.max() for v in values))
    span = max(high - low, shown.least)
    step = 10.0 ** np.floor(np.log10(span))
    below, above = step * np.floor(low / step), step * np.ceil(high / step)
    low, high = (below if low - below < 0.2 * span else low), (above if above - high < 0.2 * span else high)
    margin = max(0.05 * span, (shown.least - (high - low)) / 2)
    return low - margin, high + margin
