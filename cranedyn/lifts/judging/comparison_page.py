"""A comparison of lifts as a table, a CSV file, a map and a page."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from cranedyn.lifts.judging.comparison import REFUSED, WORD_ORDER, ComparedCase
from cranedyn.lifts.judging.lift_figures import LiftFigure, solid_outlines
from cranedyn.lifts.judging.lift_tables import Row, Table
from cranedyn.lifts.judging.report_page import page_figures, page_tables
from cranedyn.lifts.planning.site import Site
from cranedyn.plotting.figures import COLOURS, panels
from cranedyn.plotting.html import render

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_TEMPLATE = Path(__file__).with_name("templates") / "comparison.html"

_COLUMNS = [
    ("no.", "d"),
    ("crane", ""),
    ("lift", ""),
    ("x [m]", ".1f"),
    ("y [m]", ".1f"),
    ("heading [°]", ".0f"),
    ("verdict", ""),
    ("share of capacity [%]", ".1f"),
    ("clearance [m]", ".2f"),
    ("time [s]", ".1f"),
    ("wind limit [m/s]", ".1f"),
    ("reason", ""),
]
"""Header and format of the columns of the table."""

_MARKERS = {"GO": "o", "NOT COMPLETE": "s", "NO GO": "X", REFUSED: "x"}
"""Marker of a place on the map by what came of its lift."""

_COLOUR_MAP = colormaps["viridis"]
"""Colours of numbers; it keeps its order in grey, too."""

COLOURED_BY = {"share": "share of capacity [%]", "time": "time [s]"}
"""Quantities by which places are coloured, with their labels."""


def comparison_table(rows: Sequence[ComparedCase], note: str) -> Table:
    """Return rows as a table.

    Args:
        rows: The rows in their order.
        note: What to know about it.
    """
    cells: list[Row] = []
    for row in rows:
        place = row.case.place
        cells.append(
            [
                row.number,
                row.case.crane,
                None if row.case.lift is None else row.case.lift.name,
                None if place is None else place.x,
                None if place is None else place.y,
                None if place is None else place.heading,
                row.word,
                None if row.share is None else 100.0 * row.share,
                row.clearance,
                row.time,
                row.wind,
                row.reason or None,
            ]
        )
    return Table("Which crane, which place, which lift", _COLUMNS, cells, note)


def without_empty_columns(table: Table) -> Table:
    """Return a table without the columns in which there is nothing, such as the lifts where those
    of the files were judged.
    """
    kept = []
    for i in range(len(table.columns)):
        if any(row[i] is not None for row in table.rows):
            kept.append(i)
    columns = [table.columns[i] for i in kept]
    rows = [[row[i] for i in kept] for row in table.rows]
    return Table(table.title, columns, rows, table.note)


def comparison_csv(table: Table) -> str:
    """Return a table as CSV: numbers in all their digits, and empty cells for what there is not."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([header for header, _ in table.columns])
    for row in table.rows:
        writer.writerow(["" if value is None else value for value in row])
    return text.getvalue()


def places_map(
    site: Site, rows: Sequence[ComparedCase], *, coloured_by: str = "share", title: str = ""
) -> Figure:
    """Draw the places of a crane on the plan of its site: a colour for each by share of capacity or
    time, and a marker by its verdict. Of several lifts from one place the worst counts. A place
    that is no GO has the number of its row in the table, where the reason stands.

    Args:
        site: The site.
        rows: Rows of one crane, each with a place.
        coloured_by: One of `COLOURED_BY`.
        title: Title.
    """
    figure, axes = panels(1, height=5.5, width=7.5)
    ax = axes[0]
    for solid in site.solids:
        ax.add_collection(solid_outlines(solid, 0, 1))
    for start, goal in _ways(site, rows):
        ax.plot(*zip(start[:2], goal[:2], strict=True), ":", color=COLOURS["x"])
        ax.plot(*start[:2], ".", color=COLOURS["x"])
        ax.plot(*goal[:2], "*", color=COLOURS["x"], markersize=12)
    worst = worst_by_place(rows, coloured_by)
    scale = 100.0 if coloured_by == "share" else 1.0
    numbers = [scale * value for row in worst if (value := getattr(row, coloured_by)) is not None]
    lowest = min(numbers, default=0.0)
    highest = max(numbers, default=1.0)
    # Of one number alone the range of colours would be empty.
    norm = Normalize(lowest, highest if highest > lowest else lowest + 1.0)
    for word in WORD_ORDER:
        for row in [row for row in worst if row.word == word]:
            value = getattr(row, coloured_by)
            colour = "#CC3311" if value is None else _COLOUR_MAP(norm(scale * value))
            point = _point_of(row)
            ax.scatter(*point, color=[colour], marker=_MARKERS[word], s=90, zorder=3)
            if word != "GO":
                ax.annotate(f"{row.number}", point, xytext=(7, 5), textcoords="offset points")
    counts = Counter(row.word for row in worst)
    for word in WORD_ORDER:
        if counts[word]:
            # The legend tells markers apart, and has no colour.
            label = f"{word} ({counts[word]})"
            ax.scatter([], [], color="#555555", marker=_MARKERS[word], s=60, label=label)
    if numbers:
        bar = ScalarMappable(norm, _COLOUR_MAP)
        figure.colorbar(bar, ax=ax, label=COLOURED_BY[coloured_by], shrink=0.8)
    ax.set(xlabel="x [m]", ylabel="y [m]")
    ax.set_aspect("equal", adjustable="datalim")
    ax.autoscale_view()
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    figure.suptitle(title)
    return figure


def _ways(
    site: Site, rows: Sequence[ComparedCase]
) -> list[tuple[tuple[float, ...], tuple[float, ...]]]:
    """Return start and goal of each lift of some rows, of the site where they name none."""
    ways = []
    for row in rows:
        lift = row.case.lift
        if lift is not None:
            way = (lift.start, lift.goal)
        elif site.start is not None and site.goal is not None:
            way = (tuple(site.start.tolist()), tuple(site.goal.tolist()))
        else:
            continue
        if way not in ways:
            ways.append(way)
    return ways


def _point_of(row: ComparedCase) -> tuple[float, float]:
    """Return the place of a row [m]."""
    assert row.case.place is not None  # see `places_map`
    return row.case.place.x, row.case.place.y


def worst_by_place(rows: Sequence[ComparedCase], key: str) -> list[ComparedCase]:
    """Return of each place, headings apart, the row of the worst word, and of equal ones that with
    the largest share or time. So a place is as good as the worst lift from it.
    """
    worst: dict[object, ComparedCase] = {}
    for row in rows:
        kept = worst.get(row.case.place)
        if kept is None or _badness(row, key) > _badness(kept, key):
            worst[row.case.place] = row
    return list(worst.values())


def _badness(row: ComparedCase, key: str) -> tuple[int, float]:
    """Return a number pair that is larger the worse a row is."""
    value = getattr(row, key)
    return WORD_ORDER.index(row.word), -1.0 if value is None else value


def comparison_html(
    table: Table, figures: Sequence[LiftFigure], rows: Sequence[ComparedCase], command: str
) -> str:
    """Return a comparison as one HTML document that needs no other file.

    Args:
        table: The table of all cases.
        figures: The maps.
        rows: The rows of the table.
        command: The command that makes it again.
    """
    counts = Counter(row.word for row in rows)
    counted = ", ".join(f"{counts[word]} {word}" for word in WORD_ORDER if counts[word])
    return render(
        _TEMPLATE,
        title="Lifts compared",
        counted=f"{len(rows)} cases: {counted}.",
        tables=page_tables([without_empty_columns(table)]),
        figures=page_figures(figures),
        command=command,
    )
