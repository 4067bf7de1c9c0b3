"""A run of a site on one page that needs no network: plan, distances, contacts and lost time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cranedyn.assumptions import check_entered
from cranedyn.data.files import with_ending
from cranedyn.lifts.judging.lift_figures import LiftFigure, solid_outlines
from cranedyn.lifts.judging.lift_tables import Row, Table
from cranedyn.lifts.judging.report_page import page_figures, page_tables, write_html_or_pdf
from cranedyn.lifts.sites.brakes import CYCLE
from cranedyn.lifts.sites.promise import site_assumptions
from cranedyn.lifts.sites.site_simulation import SiteRun
from cranedyn.plotting.figures import panels
from cranedyn.plotting.html import render, worst_first
from cranedyn.plotting.style import COLOURS, run_colour
from cranedyn.recording.shapes import CONTACT
from cranedyn.verdict import Check

_SCALE = 20.0
"""Scale of distances over time, in required ones."""


def write_page(run: SiteRun, path: str | Path) -> Path:
    """Write a run as a ``.html`` file, or as a ``.pdf`` file that a browser prints.

    Raises:
        NoBrowser: If a PDF is asked for and no browser prints it.
        DataError: If the ending is another or the file cannot be written.
    """
    return write_html_or_pdf(with_ending(path, ".html", ".pdf"), site_html(run))


def site_html(run: SiteRun) -> str:
    """Return a run as one HTML document that needs no other file."""
    kind = "under the supervisor" if run.boxes else "without a supervisor"
    lost = lost_time(run)
    figures = [
        LiftFigure(_plan(run), "Towers, reach, ways of hooks, obstacles, and contacts in red."),
        LiftFigure(_histories(run, lost), "Distances, the required one dashed, and lost time."),
    ]
    return render(
        Path(__file__).with_name("templates") / "site.html",
        title=f"Site: {run.site.name}",
        about=f"{len(run.swing)} cranes {kind}, {len(run.t) * CYCLE / 60.0:.1f} min.",
        checks=worst_first(_checks(run)),
        figures=page_figures(figures),
        tables=page_tables(_tables(run, lost)),
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
    site, violation = run.site, run.violation
    broken = run.broken_assumptions
    swing, allowed = np.degrees([run.swing.max(), site.swing]).tolist()
    distance = f"{max(run.least_distance, 0.0):.2f} m, required {site.distance:g} m"
    return [
        Check(f"{len(run.contacts)} contacts.", not run.contacts),
        Check(f"Least distance of two cranes {distance}.", run.least_distance >= site.distance),
        Check(f"Largest swing of a rope {swing:.1f}°, allowed {allowed:.1f}°.", swing <= allowed),
        Check(f"The model {violation or 'holds'}.", not violation),
        # Neither can be a pass: what rests on a default, or was never promised, is not judged.
        *(Check(f"Outside of what the site assumes: {words}.", None) for words in broken),
        check_entered(site_assumptions(site)),
    ]


def _tables(run: SiteRun, lost: list[np.ndarray]) -> list[Table]:
    """Return the tables that have rows."""
    drives: list[Row] = []
    columns = run.site.stations, run.commands, run.passed, lost
    for station, *rates, losses in zip(*columns, strict=True):
        seconds = CYCLE * np.abs(np.nan_to_num(rates) / station.converters.rates).sum(axis=1)
        for joint, *row in zip(station.crane.layout.driven, *seconds, losses[-1], strict=True):
            drives.append([station.name, joint.role or joint.name, *row])
    gaps: list[Row] = [[k, max(x.min(), 0.0), run.t[x.argmin()]] for k, x in run.gaps().items()]
    crane, t = ("crane", ""), ("time [s]", ".1f")
    numbers = [(name, ".1f") for name in ("commanded [s]", "passed on [s]", "lost [s]")]
    bodies = [(name, "") for name in ("crane or obstacle", "body", "of the second")]
    assumed: list[Row] = [[x.name, x.value, x.origin.value] for x in site_assumptions(run.site)]
    about = [("what the promise rests on", ""), ("assumed", ""), ("from", "")]
    waits = run.waits
    chain = [t, ("for [s]", ".1f"), ("cranes", "")]
    tables = [
        Table("Ways of drives at full rate", [crane, ("drive", ""), *numbers], drives),
        Table("Least distances", [("pair", ""), ("distance [m]", ".2f"), t], gaps),
        Table(f"{len(run.contacts)} contacts", [t, crane, *bodies], [[*c] for c in run.contacts]),
        Table(f"{len(waits)} waits in a circle", chain, [[*wait] for wait in waits]),
        Table("Assumptions", about, assumed),
    ]
    return [table for table in tables if table.rows]


def _plan(run: SiteRun) -> Figure:
    """Draw the site from above; at contacts the hook that touches, or the jib."""
    figure, (ax,) = panels(height=6.5)
    for solid in run.site.solids:
        ax.add_collection(solid_outlines(solid, 0, 1))
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    for i, (station, path) in enumerate(zip(run.site.stations, run.trajectories, strict=True)):
        foot = station.foot[:2]
        drives = station.crane.layout.drives
        colour = run_colour(i)
        reach = np.linalg.norm(station.outline(station.ranges[None])[..., :2], axis=-1).max()
        circle = foot[:, None] + reach * np.array([np.cos(angle), np.sin(angle)])
        pivot, rope, _ = station.rope(path.q)
        hook = (pivot + path.q[:, drives[station.bodies.columns[-1:]]] * rope)[:, :2]
        ax.plot(*circle, ":", color=colour, linewidth=1.0)
        ax.plot(*hook.T, color=colour, linewidth=1.0)
        ax.plot(*foot, "s", color=colour, markersize=9)
        ax.text(foot[0], foot[1], f"\u00a0\u00a0{station.name}", color=colour, va="center")
        for t, *names, first, second in run.contacts:
            if station.name in names:
                point = hook[round(t / CYCLE)]
                jib = foot, foot + (point - foot) * reach / np.linalg.norm(point - foot)
                hangs = (first, second)[names.index(station.name)] in ("rope", "load")
                line = np.transpose([point] if hangs else jib)
                ax.plot(*line, "x-" if hangs else "-", color=CONTACT, linewidth=1.0, zorder=3.0)
    ax.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    return figure


def _histories(run: SiteRun, lost: list[np.ndarray]) -> Figure:
    """Draw distances and lost time."""
    figure, (near, late) = panels(2, height=2.8, sharex=True)
    for i, (pair, values) in enumerate(run.gaps().items()):
        near.plot(run.t / 60.0, values, color=run_colour(i), label=pair)
    near.axhline(run.site.distance, color=COLOURS["limit"], linestyle="--", linewidth=1.0)
    for contact in run.contacts:
        near.plot(contact.t / 60.0, 0.0, "x", color=CONTACT, clip_on=False)
    near.set(ylabel="distance [m]", ylim=(0.0, _SCALE * run.site.distance))
    for i, (station, seconds) in enumerate(zip(run.site.stations, lost, strict=True)):
        late.plot(run.t / 60.0, seconds.max(axis=1), color=run_colour(i), label=station.name)
    late.set(ylabel="lost time [s]", xlabel="time [min]")
    for ax in (near, late):
        ax.legend(*ax.get_legend_handles_labels(), loc="upper left", ncols=4, fontsize=9)
    return figure
