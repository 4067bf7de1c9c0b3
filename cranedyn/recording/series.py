"""The numbers of a run: one table of columns for each run, and the plots that show them.

All columns of a run are fields of one component of one entity, "RUN/numbers". An entity for each
plot would make a recording 40 % larger. A curve selects its column by a mapping, see `_line`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import VisualizerComponentMapping

from cranedyn.data.tables import number_array
from cranedyn.errors import printable
from cranedyn.model.layout import Joint, Layout
from cranedyn.plotting.style import GREEK, colour_of, distinct_colours, mixed, rgb, run_colour
from cranedyn.recording.contents import Run, clock, colours, rows_every

READOUT = "readout"
"""Entity of the table of coordinates."""

GAPS = "gaps"
"""Entity of distances between cranes, and of contacts."""

_PERIOD = 0.02
"""Time between rows that are recorded [s]."""

_READOUT_PERIOD = 0.1
"""Time between tables of coordinates that are recorded [s]."""

_JUMP_RATIO = 0.01
"""Share of its limit by which an effort changes between two rows that are recorded in any case."""

_LEGEND_WIDTH = 0.4
"""Smallest width of a legend over that of the curves."""

_MAX_LEGEND_WIDTH = 1.0
"""Largest width of a legend over that of the curves, which longer names may overlap."""

_PLOT_PIXELS = 530.0
"""Width of a plot in a window of 1,200 pixels [pixel]."""

_LETTER_PIXELS = 5.8
"""Mean width of a letter of a legend [pixel]."""

_LEGEND_MARGIN_PIXELS = 35.0
"""Width of a legend beside its letters [pixel]."""

_MAX_TICKS = 9
"""Largest number of ticks of an axis that Rerun numbers."""

_ROUND_END_RATIO = 0.2
"""Share of its span by which the range of an axis grows at most to end at a round number."""

_MARGIN_RATIO = 0.05
"""Share of the span of its curves that an axis reaches beyond them."""

_EFFORT_LEAST_SPAN = 20.0
"""Least span of the axis of an effort [N m or N]."""

_ENERGY_LEAST_SPAN = 20.0
"""Least span of the axis of energies [J]."""

_CONTACT_COLOUR = (242, 43, 5)
"""Colour of the points where contacts begin: red, green and blue, 0 to 255."""

_RADIANS = re.compile(r"_rad(?=$|_s$)")
"""The unit at the end of the name of a column; elsewhere it may belong to the name of a joint, such
as "radial".
"""

Table = dict[str, np.ndarray]
"""Columns by name, shape (n,) each."""


class Curve(NamedTuple):
    """One curve of a plot.

    Attributes:
        label: Its label.
        quantity: Quantity that gives its colour: a symbol, or such as "setpoint" or "limit".
        column: Its column in the table, see `series_table`.
    """

    label: str
    quantity: str
    column: str


class _PlotUnit(NamedTuple):
    """How a coordinate is plotted.

    Attributes:
        symbol: Its unit in titles.
        suffix: Its unit at the end of names of columns.
        least_span: Least span of its axis, in that unit.
    """

    symbol: str
    suffix: str
    least_span: float


_DEGREES = _PlotUnit("°", "deg", 0.2)
"""How angles are plotted."""

_METRES = _PlotUnit("m", "m", 0.02)
"""How lengths are plotted."""


class Plot(NamedTuple):
    """A plot.

    Attributes:
        title: Title with unit.
        least_span: Least span of its axis, in that unit.
        curves: Its curves, the last on top.
    """

    title: str
    least_span: float
    curves: tuple[Curve, ...]


_TITLES = {"gamma": "Slew", "x": "Trolley", "l": "Cable"}
"""Titles of plots of coordinates, by symbol; the symbol for others."""

_SWINGS = {"phi": "φ radial", "theta": "θ tangential"}
"""Labels of swings, by symbol."""

_DRIVES = {"gamma": "slew", "x": "trolley", "l": "hoist"}
"""Names of drives, by the symbol of the coordinate; the symbol for others."""


def plots(layout: Layout) -> dict[str, Plot]:
    """Return the plots of a crane by name.

    The plot of a drive has the symbol of its coordinate as name, that of its effort the name of the
    effort.
    """
    by_name: dict[str, Plot] = {}
    for joint in layout.driven:
        by_name[joint.symbol] = _position_plot(joint)
    # The last curve is drawn on top: the first passive joint, which is the radial swing of a tower
    # crane.
    passive = [joint for joint in reversed(layout.joints) if not joint.driven]
    all_joints = [*layout.driven, *passive]
    for name, joints, kind in (
        ("swing", passive, "revolute"),
        ("stretch", passive, "prismatic"),
        ("speeds", all_joints, "prismatic"),
        ("angular speeds", all_joints, "revolute"),
    ):
        same_unit = [joint for joint in joints if joint.kind == kind]
        if same_unit:
            by_name[name] = _joint_plot(name, same_unit)
    for joint in layout.driven:
        by_name[joint.effort_name] = _effort_plot(joint)
    by_name["energy"] = _energy_plot(layout)
    return by_name


def run_plots(run: Run) -> dict[str, Plot]:
    """Return the plots of a run by name: those of its crane, and those of a base that moves."""
    by_name = plots(run.crane.layout)
    if run.trajectory.base is not None:
        by_name["base"] = _base_plot("Base", ("surge", "sway", "heave"), _METRES)
        by_name["base attitude"] = _base_plot("Base", ("roll", "pitch", "yaw"), _DEGREES)
    return by_name


def _base_plot(title: str, names: Sequence[str], unit: _PlotUnit) -> Plot:
    """Return the plot of some coordinates of a base that moves."""
    curves = [Curve(name, name, f"base_{name}_{unit.suffix}") for name in names]
    return Plot(f"{title} [{unit.symbol}]", unit.least_span, tuple(curves))


def _position_plot(joint: Joint) -> Plot:
    """Return the plot of a drive: its setpoint and its position."""
    unit = _plot_unit(joint)
    setpoint = Curve("setpoint", "setpoint", f"{joint.symbol}_setpoint_{unit.suffix}")
    position = Curve(joint_label(joint), joint.symbol, f"{joint.symbol}_{unit.suffix}")
    title = f"{_TITLES.get(joint.symbol, joint.symbol)} [{unit.symbol}]"
    return Plot(title, unit.least_span, (setpoint, position))


def _effort_plot(joint: Joint) -> Plot:
    """Return the plot of the effort of a drive, with its limits."""
    column = joint.effort_column
    drive = _drive_name(joint)
    kind = "torque" if joint.kind == "revolute" else "force"
    lower = Curve("limit", "limit", f"{column}_lower")
    upper = Curve("limit", "limit", f"{column}_upper")
    # T of a torque or F of a force, as its column begins.
    effort = Curve(f"{column[0]}_{joint_label(joint)}", joint.symbol, column)
    title = f"{drive[:1].upper()}{drive[1:]} {kind} [{joint.effort_unit}]"
    return Plot(title, _EFFORT_LEAST_SPAN, (lower, upper, effort))


def _energy_plot(layout: Layout) -> Plot:
    """Return the plot of the energy: work of the drives, losses, and what the crane has gained."""
    curves = []
    for joint in layout.driven:
        curves.append(Curve(f"work of {_drive_name(joint)}", joint.symbol, f"W_{joint.symbol}_J"))
    curves.append(Curve("dissipated", "dissipated", "dissipated_J"))
    curves.append(Curve("unexplained", "unexplained", "unexplained_J"))
    curves.append(Curve("gained", "energy", "energy_J"))
    return Plot("Energy [J]", _ENERGY_LEAST_SPAN, tuple(curves))


def _drive_name(joint: Joint) -> str:
    """Return the name of a drive, such as hoist."""
    return _DRIVES.get(joint.symbol, joint.symbol)


def _plot_unit(joint: Joint) -> _PlotUnit:
    """Return how a coordinate is plotted."""
    return _DEGREES if joint.kind == "revolute" else _METRES


def joint_label(joint: Joint) -> str:
    """Return the letter of a coordinate, such as φ."""
    return GREEK.get(joint.symbol, joint.symbol)


def _joint_plot(name: str, joints: Sequence[Joint]) -> Plot:
    """Return a plot of the coordinates of joints with one unit, or of their rates."""
    unit = _plot_unit(joints[0])
    curves = []
    if "speeds" in name:
        for joint in joints:
            column = f"{joint.symbol}_dot_{unit.suffix}_s"
            curves.append(Curve(f"d{joint_label(joint)}/dt", joint.symbol, column))
        return Plot(f"Speed [{unit.symbol}/s]", unit.least_span, tuple(curves))
    for joint in joints:
        label = _SWINGS.get(joint.symbol, joint.symbol)
        curves.append(Curve(label, joint.symbol, f"{joint.symbol}_{unit.suffix}"))
    return Plot(f"{name.capitalize()} [{unit.symbol}]", unit.least_span, tuple(curves))


def series_table(run: Run, start_energy: float | None = None) -> Table:
    """Return the recorded columns of a run: angles in degrees, energy since the start, limits.

    Forces from outside are columns only of a run that has any, and so are the coordinates of a base
    that moves.

    Args:
        run: The run.
        start_energy: Energy at the start [J], where the trajectory continues earlier pieces.
    """
    trajectory = run.trajectory
    names = trajectory.columns
    keys = ["q", "v", "setpoint", "effort", "work", "dissipated"]
    if trajectory.force.any() or trajectory.outside.any():
        keys += ["force", "outside"]
    if trajectory.base is not None:
        keys.append("base")
    columns: Table = {}
    for key in keys:
        for name in names[key]:
            name_in_degrees = _RADIANS.sub("_deg", name)
            is_angle = name_in_degrees != name
            values = trajectory[name]
            columns[name_in_degrees] = np.degrees(values) if is_angle else values
    start = trajectory.energy[0] if start_energy is None else start_energy
    columns["energy_J"] = trajectory.energy - start
    columns["unexplained_J"] = trajectory.ledger - start
    for name, limit in zip(names["effort"], run.crane.effort_limit, strict=True):
        columns[f"{name}_lower"] = np.full(len(trajectory), -limit)
        columns[f"{name}_upper"] = np.full(len(trajectory), limit)
    return columns


def log_series(recording: rr.RecordingStream, run: Run, columns: Table) -> None:
    """Log the table of one run in single precision: 50 rows a second, and those where an effort
    jumps.
    """
    t = run.trajectory.t
    jumps = np.abs(np.diff(run.trajectory.effort, axis=0)) > _JUMP_RATIO * run.crane.effort_limit
    # Both the row before a jump and the one after it, so that the jump is drawn upright.
    rows_of_jumps = np.flatnonzero(jumps.any(axis=1))
    instants = np.unique(np.concatenate([rows_every(t, _PERIOD), rows_of_jumps, rows_of_jumps + 1]))
    arrays = [number_array(values[instants].astype(np.float32)) for values in columns.values()]
    rows = pa.StructArray.from_arrays(arrays, names=list(columns))
    component = rr.DynamicArchetype.columns(archetype="Run", components={"row": rows})
    recording.send_columns(run.entity("numbers"), clock(t[instants]), component)


def log_gaps(
    recording: rr.RecordingStream,
    t: np.ndarray,
    gaps: Mapping[str, np.ndarray],
    contacts: Sequence[float],
) -> None:
    """Log distances over time [m], shape (rows,) each, and points where contacts begin [s]."""
    for i, (name, values) in enumerate(gaps.items()):
        entity = rr.new_entity_path([GAPS, name])
        line = rr.SeriesLines(colors=rgb(run_colour(i)), names=printable(name), widths=1.5)
        recording.log(entity, line, static=True)
        recording.send_columns(entity, clock(t), rr.Scalars.columns(scalars=values))
    if len(contacts):
        entity = f"{GAPS}/contacts"
        zeros = rr.Scalars.columns(scalars=np.zeros(len(contacts)))
        recording.log(
            entity, rr.SeriesPoints(colors=_CONTACT_COLOUR, marker_sizes=6.0), static=True
        )
        recording.send_columns(entity, clock(np.array(contacts)), zeros)


def log_readout(recording: rr.RecordingStream, runs: Sequence[Run]) -> None:
    """Log the coordinates of all runs as one table in Markdown, ten times a second."""
    joints: dict[str, Joint] = {}
    for run in runs:
        for joint in run.crane.layout.joints:
            joints[joint.symbol] = joint
    titles = [""]
    for joint in joints.values():
        titles.append(f"{joint_label(joint)} [{_plot_unit(joint).symbol}]")
    # Markdown aligns a column to the right whose rule ends with a colon.
    rules = ["---"] + ["---:"] * len(joints)
    head = f"{_row(titles)}\n{_row(rules)}"

    first = min(run.trajectory.t[0] for run in runs)
    last = max(run.trajectory.t[-1] for run in runs)
    instants = np.append(np.arange(first, last, _READOUT_PERIOD), last)
    texts = [head] * len(instants)
    for run in runs:
        for i, row in enumerate(_readout_rows(run, list(joints), instants)):
            texts[i] += f"\n{row}"
    columns = rr.TextDocument.columns(text=texts, media_type=["text/markdown"] * len(texts))
    recording.send_columns(READOUT, clock(instants), columns)


def _readout_rows(run: Run, symbols: Sequence[str], instants: np.ndarray) -> list[str]:
    """Return the row of a run in the table of coordinates at instants [s].

    Args:
        run: The run.
        symbols: Coordinates in the table, some of which the crane may lack.
        instants: The instants; the last row at or before each counts.
    """
    # A nanosecond decides nothing but whether a row at the instant itself, up to rounding, counts.
    rows = np.clip(np.searchsorted(run.trajectory.t, instants + 1e-9) - 1, 0, None)
    layout = run.crane.layout
    q = run.trajectory.q[rows]
    is_angle = [joint.kind == "revolute" for joint in layout.joints]
    values = np.where(is_angle, np.degrees(q), q)
    lines = []
    for row in values:
        texts = [f"{value:.2f}" for value in row]
        readings = dict(zip(layout.symbols, texts, strict=True))
        cells = [readings.get(symbol, "-") for symbol in symbols]
        lines.append(_row([table_cell(run.name), *cells]))
    return lines


def table_cell(value: float | str) -> str:
    """Return a cell of a table in Markdown."""
    return f"{value:g}" if isinstance(value, float) else printable(value).replace("|", "\\|")


def _row(cells: Sequence[str]) -> str:
    """Return a row of a table in Markdown."""
    return f"| {' | '.join(cells)} |"


def time_series_view(
    name: str, runs: Sequence[Run], tables: Sequence[Table], title: str = ""
) -> rrb.TimeSeriesView:
    """Return the view of one plot, with the curves of each run whose crane has it.

    The curves of a single run have a colour for each quantity, those of several a colour for each
    run, θ paler than φ. The legend stands in the time after the last row.

    Args:
        name: Name of the plot, see `plots`.
        runs: The runs.
        tables: Their tables; empty while the run goes on, and the axes find their own ranges.
        title: Title of the view; empty for that of the plot.
    """
    plot_of_run = [run_plots(run).get(name) for run in runs]
    several = len(runs) > 1 and not title
    overrides: dict[Any, Any] = {}
    for run, run_plot, colour in zip(runs, plot_of_run, colours(runs), strict=True):
        if run_plot is not None:
            label = run.name if several else ""
            layout = run.crane.layout
            lines = [_line(curve, label, colour, layout) for curve in run_plot.curves]
            overrides[run.entity("numbers")] = lines
    first = next(run_plot for run_plot in plot_of_run if run_plot is not None)

    curves = []
    # There are no tables while the run goes on.
    for run_plot, columns in zip(plot_of_run, tables, strict=False):
        if run_plot is not None:
            for curve in run_plot.curves:
                if curve.quantity != "limit":
                    curves.append(columns[curve.column])
    return rrb.TimeSeriesView(
        name=title or first.title,
        origin="/",
        contents=[f"+ {path}" for path in overrides],
        overrides=overrides,
        axis_x=rrb.TimeAxis(view_range=time_range(runs)) if tables else None,
        axis_y=rrb.ScalarAxis(range=_axis_range(curves, first.least_span)) if tables else None,
        plot_legend=rrb.PlotLegend(corner="RightTop"),
    )


def _line(curve: Curve, run: str, run_colour: str, layout: Layout) -> rrb.visualizers.Visualizer:
    """Return a curve, named after its run and in its colour where there are several runs.

    Where many rows share a pixel, efforts and energies show their extremes, the others their mean.
    """
    coordinate_colours = distinct_colours(layout.symbols)
    colour = coordinate_colours.get(curve.quantity) or colour_of(curve.quantity)
    # Black would not be seen in a dark viewer.
    colour = colour.replace("#000000", "#9A9A9A")
    if run:
        # All curves of a run have its colour. Limits and setpoints, which accompany them, are mixed
        # with grey, and θ with white, so that it is paler than φ.
        shares = {"limit": 0.7, "setpoint": 0.7, "theta": 0.55}
        tint = "#FFFFFF" if curve.quantity == "theta" else colour
        colour = mixed(run_colour, tint, shares.get(curve.quantity, 0.0))
    # Names of columns of efforts, works and the energy begin with these.
    has_peaks = curve.column.split("_")[0] in ("T", "F", "W", "energy")
    policy: Literal["MinMax", "Average"] = "MinMax" if has_peaks else "Average"
    # Plots the field of this name of the component "Run:row" as if it were logged as a scalar.
    source = VisualizerComponentMapping(
        "Scalars:scalars",
        "SourceComponent",
        source_component="Run:row",
        selector=f".{curve.column}",
    )
    return rr.SeriesLines(
        colors=[rgb(colour)],
        names=[f"{curve.label.split()[0]} · {run}" if run else curve.label],
        widths=[1.5],
        aggregation_policy=policy,
    ).visualizer(mappings=[source])


def time_range(runs: Sequence[Run]) -> rr.TimeRange:
    """Return the time from the first to the last row, and as much more as the legend hides; by
    default Rerun shows a minute.
    """
    first = min(run.trajectory.t[0] for run in runs)
    last = max(run.trajectory.t[-1] for run in runs)
    last += _legend_width(runs) * (last - first)
    boundary = rrb.TimeRangeBoundary.absolute
    return rr.TimeRange(start=boundary(seconds=float(first)), end=boundary(seconds=float(last)))


def _legend_width(runs: Sequence[Run]) -> float:
    """Return the width of the widest legend over that of the curves beside it.

    The legend of several runs names quantity and run, such as "setpoint · without control".
    """
    if len(runs) == 1:
        return _LEGEND_WIDTH
    letters = len("setpoint · ") + max(len(run.name) for run in runs)
    legend = _LEGEND_MARGIN_PIXELS + _LETTER_PIXELS * letters
    curves = max(_PLOT_PIXELS - legend, 1.0)
    return min(max(legend / curves, _LEGEND_WIDTH), _MAX_LEGEND_WIDTH)


def _axis_range(curves: Sequence[np.ndarray], least_span: float) -> tuple[float, float]:
    """Return the range of an axis: that of the curves, out to a round number nearby, and a margin.

    Limits of drives do not count; one appears when an effort comes near it. Rerun numbers powers of
    ten that are some 20 pixels apart; the range reaches two of them.
    """
    low = float(min(values.min() for values in curves))
    high = float(max(values.max() for values in curves))
    span = max(high - low, least_span)
    step = 10.0 ** np.floor(np.log10(span))
    round_below = step * np.floor(low / step)
    round_above = step * np.ceil(high / step)
    if low - round_below < _ROUND_END_RATIO * span:
        low = round_below
    if round_above - high < _ROUND_END_RATIO * span:
        high = round_above

    # Multiples of the tick from `first` to `last` are in the range. It grows at the end where less
    # is missing until there are two.
    tick = 10.0 ** np.ceil(np.log10(max(high - low, least_span) / _MAX_TICKS))
    first = np.ceil(low / tick)
    last = np.floor(high / tick)
    while last - first < 1:
        is_nearer_above = tick * (last + 1) - high <= low - tick * (first - 1)
        if is_nearer_above:
            last += 1
        else:
            first -= 1
        low = min(low, tick * first)
        high = max(high, tick * last)
    margin = max(_MARGIN_RATIO * span, (least_span - (high - low)) / 2)
    return low - margin, high + margin
