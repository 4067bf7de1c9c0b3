"""A run of a site on one page that needs no network: plan, distances, contacts and lost time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cranedyn.assumptions import check_entered
from cranedyn.data.files import with_ending
from cranedyn.lifts.judging.lift_figures import LiftFigure, solid_outlines
from cranedyn.lifts.judging.lift_tables import Row, Table
from cranedyn.lifts.judging.report_page import page_figures, page_tables, write_html_or_pdf
from cranedyn.lifts.sites.brakes import CYCLE
from cranedyn.lifts.sites.crane_site import Station
from cranedyn.lifts.sites.placed_capsules import travels
from cranedyn.lifts.sites.promise import site_assumptions
from cranedyn.lifts.sites.shift_checks import shift_checks
from cranedyn.lifts.sites.shift_plan import ShiftPlan
from cranedyn.lifts.sites.site_simulation import SiteContact, SiteRun
from cranedyn.lifts.sites.timetable import timetable, timetable_chart
from cranedyn.plotting.figures import legend_above, panels
from cranedyn.plotting.html import render, worst_first
from cranedyn.plotting.style import COLOURS, run_colour
from cranedyn.recording.shapes import CONTACT
from cranedyn.verdict import Check

_DISTANCE_RANGE = 20.0
"""Largest distance that is drawn over time, in required distances."""


class LiftPage(NamedTuple):
    """The report of a lift of a shift.

    Attributes:
        lift: Name of the lift.
        word: GO, NO GO or NOT COMPLETE; "no report" if there is none.
        reason: The first reason why it is no GO, or why there is no report; empty for a GO.
        address: Address of the page, relative to that of the shift; empty if there is none.
    """

    lift: str
    word: str
    reason: str
    address: str


def write_page(run: SiteRun, path: str | Path, shift: ShiftPlan | None = None) -> Path:
    """Write a run as a ``.html`` file, or as a ``.pdf`` file that a browser prints.

    Args:
        run: The run.
        path: The file.
        shift: The plan of the shift that the cranes follow; None if they follow none.

    Raises:
        NoBrowser: If a PDF is asked for and no browser prints it.
        DataError: If the ending is another or the file cannot be written.
    """
    return write_html_or_pdf(with_ending(path, ".html", ".pdf"), site_html(run, shift))


def site_html(
    run: SiteRun, shift: ShiftPlan | None = None, lift_pages: Sequence[LiftPage] = ()
) -> str:
    """Return a run as one HTML document that needs no other file.

    Args:
        run: The run.
        shift: The plan of the shift that the cranes follow, whose timetable is shown; None if they
            follow none.
        lift_pages: The reports of its lifts, to which the page links.
    """
    kind = "under the supervisor" if run.boxes else "without a supervisor"
    lost = lost_time(run)
    checks = site_run_checks(run)
    tables = _tables(run, lost)
    figures = []
    if shift is not None:
        checks = shift_checks(shift, run) + checks
        tables = [timetable(shift), *tables]
        caption = "Timetable: pale to the load, grey hooking on and off, full with the load."
        figures.append(LiftFigure(timetable_chart(shift), caption))
    figures += [
        LiftFigure(_plan(run), _plan_caption(run)),
        LiftFigure(_histories(run, lost), "Distances, the required one dashed, and lost time."),
    ]
    return render(
        Path(__file__).with_name("templates") / "site.html",
        title=f"Site: {run.site.name}",
        about=f"{len(run.swing)} cranes {kind}, {len(run.t) * CYCLE / 60.0:.1f} min.",
        checks=worst_first(checks),
        lift_pages=lift_pages,
        figures=page_figures(figures),
        tables=page_tables(tables),
    )


def lost_time(run: SiteRun) -> list[np.ndarray]:
    """Return how much time the drives of each crane have lost up to each row [s], shape (rows, m)
    each: the time at full rate for the travel that was commanded and not passed on to them.
    """
    lost = []
    for station, command, passed in zip(run.site.stations, run.commands, run.passed, strict=True):
        rates = station.converters.rates
        # No drive goes faster than its largest rate, and NaN is no rate.
        wanted = np.clip(np.nan_to_num(command), -rates, rates)
        lost.append(np.cumsum(CYCLE * np.abs(wanted - passed) / rates, axis=0))
    return lost


def site_run_checks(run: SiteRun) -> list[Check]:
    """Return what is judged of a run, a sentence each."""
    site = run.site
    violation = run.violation
    swing = float(np.degrees(run.swing.max()))
    allowed = float(np.degrees(site.swing))
    distance = f"{max(run.least_distance, 0.0):.2f} m, required {site.distance:g} m"
    checks = [
        Check(f"{len(run.contacts)} contacts.", not run.contacts),
        Check(f"Least distance of two cranes {distance}.", run.least_distance >= site.distance),
        Check(f"Largest swing of a rope {swing:.1f}°, allowed {allowed:.1f}°.", swing <= allowed),
        Check(f"The model {violation or 'holds'}.", not violation),
    ]
    # Neither of what follows can pass: what was never promised, or rests on a default, is not
    # judged.
    for words in run.broken_assumptions:
        checks.append(Check(f"Outside of what the site assumes: {words}.", None))
    checks.append(check_entered(site_assumptions(site)))
    return checks


def _tables(run: SiteRun, lost: list[np.ndarray]) -> list[Table]:
    """Return the tables that have rows.

    Args:
        run: The run.
        lost: Its lost time, see `lost_time`.
    """
    tables = [
        _travel_table(run, lost),
        _distance_table(run),
        _contact_table(run),
        _wait_table(run),
        _assumption_table(run),
    ]
    return [table for table in tables if table.rows]


def _travel_table(run: SiteRun, lost: list[np.ndarray]) -> Table:
    """Return how long each drive would have travelled at full rate as commanded, as passed on, and
    as lost.
    """
    rows: list[Row] = []
    for i, station in enumerate(run.site.stations):
        rates = station.converters.rates
        # An operator may command NaN, which is no rate.
        commanded = CYCLE * np.abs(np.nan_to_num(run.commands[i]) / rates).sum(axis=0)
        passed = CYCLE * np.abs(np.nan_to_num(run.passed[i]) / rates).sum(axis=0)
        for drive, joint in enumerate(station.crane.layout.driven):
            times = [commanded[drive], passed[drive], lost[i][-1, drive]]
            rows.append([station.name, joint.role or joint.symbol, *times])
    columns = [("crane", ""), ("drive", "")]
    columns += [("commanded [s]", ".1f"), ("passed on [s]", ".1f"), ("lost [s]", ".1f")]
    return Table("Travel of drives at full rate", columns, rows)


def _distance_table(run: SiteRun) -> Table:
    """Return the least distance of each pair, and when it was."""
    rows: list[Row] = []
    for pair, distances in run.gaps().items():
        rows.append([pair, max(distances.min(), 0.0), run.t[distances.argmin()]])
    columns = [("pair", ""), ("distance [m]", ".2f"), ("time [s]", ".1f")]
    return Table("Least distances", columns, rows)


def _contact_table(run: SiteRun) -> Table:
    """Return the contacts."""
    rows: list[Row] = []
    for contact in run.contacts:
        bodies = [contact.first_body, contact.second_body]
        rows.append([contact.t, contact.first, contact.second, *bodies])
    columns = [("time [s]", ".1f"), ("crane", ""), ("crane or obstacle", "")]
    columns += [("body", ""), ("of the second", "")]
    return Table(f"{len(run.contacts)} contacts", columns, rows)


def _wait_table(run: SiteRun) -> Table:
    """Return the times in which cranes waited for each other in a circle."""
    rows: list[Row] = []
    for wait in run.waits:
        rows.append([wait.begin, wait.duration, wait.words])
    columns = [("time [s]", ".1f"), ("for [s]", ".1f"), ("cranes", "")]
    return Table(f"{len(rows)} waits in a circle", columns, rows)


def _assumption_table(run: SiteRun) -> Table:
    """Return all that the promise of the site rests on."""
    rows: list[Row] = []
    for assumption in site_assumptions(run.site):
        rows.append([assumption.name, assumption.value, assumption.origin.value])
    columns = [("what the promise rests on", ""), ("assumed", ""), ("from", "")]
    return Table("Assumptions", columns, rows)


def _plan_caption(run: SiteRun) -> str:
    """Return what the drawing of the site from above shows."""
    kinds = {travels(station.crane) for station in run.site.stations}
    standing = {(False,): "Towers", (True,): "Runways", (False, True): "Towers, runways"}
    return f"{standing[tuple(sorted(kinds))]}, reach, paths of hooks, obstacles, contacts in red."


def _plan(run: SiteRun) -> Figure:
    """Draw the site from above: obstacles, and each crane with its reach, the path of its hook and
    its contacts.

    The reach of a crane that slews is a circle, and its name stands at its tower. That of a crane
    that travels is the area of its hook; its rails are drawn in grey, and its name stands where the
    run begins.
    """
    figure, (ax,) = panels(height=6.5)
    for solid in run.site.solids:
        ax.add_collection(solid_outlines(solid, 0, 1))
    for i, (station, path) in enumerate(zip(run.site.stations, run.trajectories, strict=True)):
        colour = run_colour(i)
        rope = station.rope(path.q)
        winch = station.crane.layout.drives[station.crane.winch]
        cable = path.q[:, [winch]]
        hook = (rope.pivot + cable * rope.direction)[:, :2]
        ax.plot(*_reach(station).T, ":", color=colour, linewidth=1.0)
        ax.plot(*hook.T, color=colour, linewidth=1.0)
        named_at = station.foot[:2]
        if travels(station.crane):
            named_at = rope.pivot[0, :2]
            # Cranes on one runway have the same rails, which are drawn once.
            if not station.runway:
                _draw_runway(ax, station)
        ax.plot(*named_at, "s", color=colour, markersize=9)
        x, y = named_at.tolist()
        ax.text(x, y, f"\u00a0\u00a0{station.name}", color=colour, va="center")
        for contact in run.contacts:
            body = _touching_body(contact, station.name)
            if body:
                row = round(contact.t / CYCLE)
                _draw_contact(ax, body, station, path.q[row], hook[row])
    ax.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    return figure


def _reach(station: Station) -> np.ndarray:
    """Return the line around all that the pivot of a crane reaches, seen from above [m], shape
    (points, 2): a circle around a crane that slews.
    """
    line = station.outline(station.ranges[None])[0] @ station.bodies.foot[:, :3].T
    if travels(station.crane):
        return (line + station.foot)[:, :2]
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    radius = np.linalg.norm(line[:, :2], axis=-1).max()
    return station.foot[:2] + radius * np.column_stack([np.cos(angle), np.sin(angle)])


def _draw_runway(ax: Axes, station: Station) -> None:
    """Draw the rails and columns of a crane from above, as the axes of its capsules."""
    bodies = station.bodies
    for ends in bodies.ends[bodies.joint == 0]:
        placed = ends @ bodies.foot[:, :3].T + bodies.foot[:, 3]
        ax.plot(placed[:, 0], placed[:, 1], "-", color="0.6", linewidth=3.0, zorder=0.5)


def _touching_body(contact: SiteContact, crane: str) -> str:
    """Return the body of a crane that touches in a contact; "" if the crane has no part in it."""
    if contact.first == crane:
        return contact.first_body
    # An obstacle may have the name of a crane, but it has no body.
    return contact.second_body if contact.second == crane else ""


def _draw_contact(ax: Axes, body: str, station: Station, q: np.ndarray, hook: np.ndarray) -> None:
    """Draw a contact seen from above: at the hook if rope or load touch, else along the jib or the
    bridge.

    Args:
        ax: Where to draw.
        body: Name of the body that touches.
        station: The crane.
        q: Its coordinates, shape (n,).
        hook: Place of the hook [m], shape (2,).
    """
    line = hook[None]
    style = "x-"
    if body not in ("rope", "load"):
        line = _across(station, q, hook)
        style = "-"
    ax.plot(line[:, 0], line[:, 1], style, color=CONTACT, linewidth=1.0, zorder=3.0)


def _across(station: Station, q: np.ndarray, hook: np.ndarray) -> np.ndarray:
    """Return the ends of the jib or the bridge of a crane seen from above [m], shape (2, 2).

    Args:
        station: The crane.
        q: Its coordinates, shape (n,).
        hook: Place of the hook [m], shape (2,), towards which the jib points.
    """
    foot = station.foot[:2]
    if not travels(station.crane):
        reach = np.linalg.norm(_reach(station)[0] - foot)
        return np.array([foot, foot + (hook - foot) * reach / np.linalg.norm(hook - foot)])

    # Where the pivot is with the last drive before the rope at both ends of its way.
    drives = q[station.crane.layout.drives]
    positions = np.array([drives, drives])
    last = station.bodies.columns[-2]
    positions[:, last] = station.ranges[:, last]
    coordinates, _ = station.plumb(positions)
    return station.rope(coordinates).pivot[:, :2]


def _histories(run: SiteRun, lost: list[np.ndarray]) -> Figure:
    """Draw the distances of all pairs and the lost time of all cranes over time.

    Args:
        run: The run.
        lost: Its lost time, see `lost_time`.
    """
    figure, (distance_ax, lost_ax) = panels(2, height=2.8, sharex=True)
    minutes = run.t / 60.0
    for i, (pair, distances) in enumerate(run.gaps().items()):
        distance_ax.plot(minutes, distances, color=run_colour(i), label=pair)
    distance_ax.axhline(run.site.distance, color=COLOURS["limit"], linestyle="--", linewidth=1.0)
    for contact in run.contacts:
        distance_ax.plot(contact.t / 60.0, 0.0, "x", color=CONTACT, clip_on=False)
    distance_ax.set(ylabel="distance [m]", ylim=(0.0, _DISTANCE_RANGE * run.site.distance))
    for i, (station, seconds) in enumerate(zip(run.site.stations, lost, strict=True)):
        # Of the drives of a crane the one that lost most.
        lost_ax.plot(minutes, seconds.max(axis=1), color=run_colour(i), label=station.name)
    lost_ax.set(ylabel="lost time [s]", xlabel="time [min]")
    for ax in (distance_ax, lost_ax):
        # A site with a single crane has no distance between cranes.
        if ax.get_legend_handles_labels()[0]:
            legend_above(ax)
    return figure
