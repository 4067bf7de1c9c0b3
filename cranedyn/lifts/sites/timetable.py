"""The timetable of a shift: as a table, as a CSV file, and as a chart over time."""

from __future__ import annotations

import csv
import io
import math
from typing import TYPE_CHECKING

from cranedyn.lifts.judging.lift_tables import Row, Table
from cranedyn.lifts.sites.shift_plan import PlannedLift, ShiftPlan
from cranedyn.plotting.figures import panels
from cranedyn.plotting.style import run_colour

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CSV_COLUMNS = (
    "lift",
    "crane",
    "load_kg",
    "from_x_m",
    "from_y_m",
    "from_z_m",
    "to_x_m",
    "to_y_m",
    "to_z_m",
    "leaves_s",
    "at_load_s",
    "leaves_with_load_s",
    "delivered_s",
    "unhooked_s",
    "waited_s",
    "waits_for",
)
"""Columns of the timetable as a CSV file."""

_ROW_HEIGHT = 0.8
"""Height of the row of a crane in the chart [inch]."""

_BAR_HEIGHT = 0.5
"""Height of a bar over the distance of two rows."""

_CHARACTER_WIDTH = 0.085
"""Width of a character of a name in the chart [inch]."""

_CHART_WIDTH = 9.0
"""Width of the chart [inch]."""


def clock_time(seconds: float) -> str:
    """Return a time as hours, minutes and seconds, such as "1:02:03"."""
    whole_seconds = math.floor(seconds + 0.5)
    minutes, second = divmod(whole_seconds, 60)
    hour, minute = divmod(minutes, 60)
    return f"{hour}:{minute:02d}:{second:02d}"


def load_of(shift: ShiftPlan, planned: PlannedLift) -> float:
    """Return the mass of the load of a lift [kg]: of its own, or that of its crane."""
    if planned.lift.load is not None:
        return planned.lift.load
    site = shift.plan.site
    return site.stations[site.index_of(planned.crane)].crane.payload_mass


def timetable(shift: ShiftPlan) -> Table:
    """Return a row for each lift, with times as hours, minutes and seconds."""
    rows: list[Row] = []
    for planned in shift.lifts:
        times = [planned.begin, planned.at_load, planned.off, planned.delivered, planned.end]
        rows.append(
            [
                planned.lift.name,
                planned.crane,
                load_of(shift, planned),
                *[clock_time(seconds) for seconds in times],
                planned.waited,
                planned.waits_for or "-",
            ]
        )
    columns = [("lift", ""), ("crane", ""), ("load [kg]", ".0f")]
    columns += [("leaves", ""), ("at the load", ""), ("leaves with it", "")]
    columns += [("delivered", ""), ("unhooked", ""), ("waited [s]", ".0f"), ("because", "")]
    return Table("Timetable", columns, rows)


def timetable_csv(shift: ShiftPlan) -> str:
    """Return the timetable as the text of a CSV file, times in seconds."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for planned in shift.lifts:
        points = [*planned.lift.start.tolist(), *planned.lift.goal.tolist()]
        times = [planned.begin, planned.at_load, planned.off, planned.delivered, planned.end]
        writer.writerow(
            [
                planned.lift.name,
                planned.crane,
                f"{load_of(shift, planned):g}",
                *[f"{coordinate:g}" for coordinate in points],
                *[f"{seconds:.1f}" for seconds in times],
                f"{planned.waited:.1f}",
                planned.waits_for,
            ]
        )
    return text.getvalue()


def timetable_chart(shift: ShiftPlan) -> Figure:
    """Draw the timetable as a Gantt chart: a row for each crane, and in it each lift.

    A lift is a pale bar while the empty hook travels to the load, a grey one while the load is
    hooked on and unhooked, and a full one while the crane carries it; its name stands above. A
    crane that makes way for another is a thin bar.
    """
    stations = shift.plan.site.stations
    figure, (ax,) = panels(height=1.2 + _ROW_HEIGHT * len(stations), width=_CHART_WIDTH)
    minutes = max(shift.duration, 1.0) / 60.0
    names = [station.name for station in stations]
    for planned in shift.lifts:
        row = names.index(planned.crane)
        colour = run_colour(row)
        spans = [
            (planned.begin, planned.at_load, colour, 0.35),
            (planned.at_load, planned.off, "0.75", 1.0),
            (planned.off, planned.delivered, colour, 1.0),
            (planned.delivered, planned.end, "0.75", 1.0),
        ]
        for begin, end, fill, alpha in spans:
            left = begin / 60.0
            ax.barh(
                row, (end - begin) / 60.0, _BAR_HEIGHT, left=left, color=fill, alpha=alpha, lw=0.0
            )
        length = (planned.end - planned.begin) / 60.0
        fits = int(_CHART_WIDTH * length / minutes / _CHARACTER_WIDTH)
        # A name that is longer than its bar would run into the next one; the table has all names.
        if len(planned.lift.name) <= fits:
            left = planned.begin / 60.0
            above = row - _BAR_HEIGHT / 2.0 - 0.03
            ax.text(left, above, planned.lift.name, va="bottom", parse_math=False)
    for motion in shift.plan.lifts:
        if not _is_of_a_lift(shift, names[motion.crane], motion.begin):
            length = (motion.end - motion.begin) / 60.0
            left = motion.begin / 60.0
            ax.barh(motion.crane, length, 0.2, left=left, color=run_colour(motion.crane), lw=0.0)
    # The first crane of the site is at the top.
    ax.set(yticks=range(len(names)), yticklabels=names, xlabel="time [min]", xlim=(0.0, minutes))
    for label in ax.get_yticklabels():
        label.set_parse_math(False)
    ax.set_ylim(len(names) - 0.5, -0.7)
    return figure


def _is_of_a_lift(shift: ShiftPlan, crane: str, begin: float) -> bool:
    """Return whether a motion of a crane that begins at a time [s] is part of one of its lifts."""
    return any(x.crane == crane and x.begin <= begin < x.delivered for x in shift.lifts)
