"""A run of a site on one page that needs no network: plan, distances, contacts and lost time."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cranedyn.data.files import with_ending
from cranedyn.lifting.figures import LiftFigure, solid_outlines
from cranedyn.lifting.page import checks_html, document, figures_html, tables_html, write_html
from cranedyn.lifting.tables import Row, Table
from cranedyn.planning.certificate import Check
from cranedyn.plotting.figures import panels
from cranedyn.plotting.style import COLOURS, run_colour
from cranedyn.recording.shapes import CONTACT
from cranedyn.sites.brakes import CYCLE
from cranedyn.sites.simulate import SiteRun

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SCALE, _LISTED = 20.0, 100
"""Scale of distances over time, in required ones, and rows of a list at most."""


def write_page(run: SiteRun, path: str | Path) -> Path:
    """Write a run as a ``.html`` file, or as a ``.pdf`` file that a browser prints.

    Raises:
        NoBrowser: If a PDF is asked for and no browser prints it.
        DataError: If the ending is another or the file cannot be written.
    """
    return write_html(with_ending(path, ".html", ".pdf"), site_html(run))


def site_html(run: SiteRun) -> str:
    """Return a run as one HTML document that needs no other file."""
    kind = "under the supervisor" if run.boxes else "without a supervisor"
    figures = (
        LiftFigure(_plan(run), "Towers, reach, ways of hooks, obstacles, and contacts in red."),
        LiftFigure(_histories(run), "Distances, the required one dashed, and lost time."),
    )
    return document(
        f"Site: {run.site.name}",
        f"<p>{len(run.swing)} cranes {kind}, {len(run.t) * CYCLE / 60.0:.1f} min.</p>"
        f"{checks_html(_checks(run))}{figures_html(figures)}{tables_html(_tables(run))}",
    )


def lost_time(run: SiteRun) -> list[np.ndarray]:
    """Return the time at full rate [s] of the way of each drive that was commanded and not passed
    on up to each row, shape (rows, m) for each crane.
    """
    lost = []
    for station, command, passed in zip(run.site.stations, run.commands, run.passed, strict=True):
        rates = station.converters.rates
        short = np.clip(np.nan_to_num(command), -rates, rates) - passed
        lost.append(np.cumsum(CYCLE * np.abs(short) / rates, axis=0))
    return lost


def _checks(run: SiteRun) -> list[Check]:
    site, (swing, allowed) = run.site, np.degrees([run.swing.max(), run.site.swing]).tolist()
    distance = f"{max(run.least_distance, 0.0):.2f} m, required {site.distance:g} m"
    violations = [f"{name}, from {t:.1f} s on: {message}." for t, name, message in run.violations]
    return [
        Check(f"{len(run.contacts)} contacts.", not run.contacts),
        Check(f"Least distance of two cranes {distance}.", run.least_distance >= site.distance),
        Check(f"Largest swing of a rope {swing:.1f}°, allowed {allowed:.1f}°.", swing <= allowed),
        *(Check(sentence, False) for sentence in violations[:_LISTED]),
    ]


def _tables(run: SiteRun) -> list[Table]:
    """Return the tables that have rows."""
    drives: list[Row] = []
    columns = run.site.stations, run.commands, run.passed, lost_time(run)
    for station, *rates, lost in zip(*columns, strict=True):
        travels = CYCLE * np.abs(np.nan_to_num(rates)).sum(axis=1)
        for k, joint in enumerate(station.crane.layout.driven):
            unit, scale = ("°", math.degrees(1.0)) if joint.unit == "rad" else ("m", 1.0)
            commanded, passed = scale * travels[:, k]
            name = joint.role or joint.name
            drives.append([station.name, name, unit, commanded, passed, lost[-1, k]])
    gaps: list[Row] = [
        [pair, max(gap.min(), 0.0), run.t[gap.argmin()]] for pair, gap in run.gaps().items()
    ]
    contacts: list[Row] = [[t, a, body, b, second] for t, a, b, body, second in run.contacts]
    crane, t, body = ("crane", ""), ("time [s]", ".1f"), ("body", "")
    numbers = [(name, ".1f") for name in ("commanded", "passed on", "lost at full rate [s]")]
    heads = [crane, body, ("crane or obstacle", ""), body]
    waits = f"{len(run.waits)} waits in a circle"
    tables = [
        Table("Drives", [crane, ("drive", ""), ("unit", ""), *numbers], drives),
        Table("Least distances", [("pair", ""), ("distance [m]", ".2f"), t], gaps),
        Table(f"{len(contacts)} contacts", [t, *heads], contacts[:_LISTED]),
        Table(waits, [t, ("for [s]", ".1f"), ("who", "")], [[*w] for w in run.waits[:_LISTED]]),
    ]
    return [table for table in tables if table.rows]


def _plan(run: SiteRun) -> Figure:
    """Draw the site from above; at contacts the hook that touches, or the jib."""
    figure, (ax,) = panels(height=6.5)
    for solid in run.site.solids:
        ax.add_collection(solid_outlines(solid, 0, 1))
    angle = np.linspace(0.0, 2.0 * math.pi, 181)
    for i, (station, path) in enumerate(zip(run.site.stations, run.trajectories, strict=True)):
        foot, drives, colour = station.foot[:2], station.crane.layout.drives, run_colour(i)
        ends = np.array([station.crane.lower, station.crane.upper])[:, drives]
        reach = np.linalg.norm(station.outline(ends[None])[..., :2], axis=-1).max()
        circle = foot[:, None] + reach * np.array([np.cos(angle), np.sin(angle)])
        pivot, rope, _ = station.rope(path.q)
        hook = (pivot + path.q[:, drives[station.bodies.columns[-1:]]] * rope)[:, :2]
        ax.plot(*circle, ":", color=colour, linewidth=1.0)
        ax.plot(*hook.T, color=colour, linewidth=1.0)
        ax.plot(*foot, "s", color=colour, markersize=9)
        ax.annotate(
            station.name, (foot[0], foot[1]), (7.0, -4.0), color=colour, textcoords="offset points"
        )
        for t, *names, first, second in run.contacts:
            if station.name in names:
                point = hook[round(t / CYCLE)]
                jib = foot, foot + (point - foot) * reach / np.linalg.norm(point - foot)
                hangs = (first, second)[names.index(station.name)] in ("rope", "load")
                line = np.transpose([point] if hangs else jib)
                ax.plot(*line, "x-" if hangs else "-", color=CONTACT, linewidth=1.0, zorder=3.0)
    ax.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    return figure


def _histories(run: SiteRun) -> Figure:
    """Draw distances and lost time."""
    figure, (near, lost) = panels(2, height=2.8, sharex=True)
    for i, (pair, values) in enumerate(run.gaps().items()):
        near.plot(run.t / 60.0, values, color=run_colour(i), label=pair)
    near.axhline(run.site.distance, color=COLOURS["limit"], linestyle="--", linewidth=1.0)
    for contact in run.contacts:
        near.plot(contact.t / 60.0, 0.0, "x", color=CONTACT, clip_on=False)
    near.set(ylabel="distance [m]", ylim=(0.0, _SCALE * run.site.distance))
    for i, (station, seconds) in enumerate(zip(run.site.stations, lost_time(run), strict=True)):
        lost.plot(run.t / 60.0, seconds.max(axis=1), color=run_colour(i), label=station.name)
    lost.set(ylabel="lost time [s]", xlabel="time [min]")
    for ax in (near, lost):
        ax.legend(*ax.get_legend_handles_labels(), loc="upper left", ncols=4, fontsize=9)
    return figure
