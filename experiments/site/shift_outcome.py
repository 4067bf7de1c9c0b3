"""The lifts of a site's file: planned as one shift, simulated under the supervisor, and shown."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cranedyn.lifts.sites.crane_site import CraneSite
from cranedyn.lifts.sites.shift_checks import shift_checks
from cranedyn.lifts.sites.shift_plan import ShiftPlan, plan_shift
from cranedyn.lifts.sites.site_page import LiftPage, site_html, site_run_checks
from cranedyn.lifts.sites.site_simulation import simulate_site
from cranedyn.lifts.sites.timetable import clock_time, timetable, timetable_chart, timetable_csv
from experiments.harness import Outcome, ResultTable, Setup, make_table
from experiments.site.lift_reports import lift_reports

_TIME_AFTER_LAST_LIFT = 5.0
"""Simulated time after the last load is unhooked [s]."""


def shift_outcome(
    site: CraneSite, setup: Setup, source: Path, reports_into: Path | None = None
) -> Outcome:
    """Plan the lifts of a site, let its cranes follow the plan, and return what came of it.

    Args:
        site: The site.
        setup: Setup of the experiment.
        source: The file of the site.
        reports_into: Folder in which a report of each lift is written, too; None for no reports.
    """
    shift = plan_shift(site, progress=setup.reporter.count("lifts", len(site.lifts)))
    tables = [_timetable(shift), _summary(shift)]
    if not shift.lifts:
        return Outcome(tables=tables, claims=shift_checks(shift, None))
    operators = shift.plan.operators()
    run = simulate_site(site, operators, duration=shift.duration + _TIME_AFTER_LAST_LIFT)
    pages: list[LiftPage] = []
    if reports_into is not None:
        progress = setup.reporter.count("lift reports", len(shift.lifts))
        pages = lift_reports(shift, source, reports_into, progress)
        tables.append(_reports(pages))
    trajectories = {}
    for count, trajectory in enumerate(run.trajectories, start=1):
        trajectories[f"crane_{count}"] = trajectory
    return Outcome(
        tables=tables,
        claims=[*shift_checks(shift, run), *site_run_checks(run)],
        parameters={"cranes": [station.name for station in site.stations]},
        trajectories=trajectories,
        figures={"timetable": timetable_chart(shift)},
        recording=run.runs_to_record(),
        gaps=run.gaps(),
        contacts=[contact.t for contact in run.contacts],
        texts={"shift.html": site_html(run, shift, pages), "timetable.csv": timetable_csv(shift)},
    )


def _timetable(shift: ShiftPlan) -> ResultTable:
    """Return the timetable as a table of the harness, with its times as text."""
    table = timetable(shift)
    note = "Times are h:mm:ss from the begin of the shift."
    return ResultTable(table.title, table.columns, table.rows, note)


def _reports(pages: Sequence[LiftPage]) -> ResultTable:
    """Return what came of the reports of the lifts as a table of the harness."""
    return make_table(
        "Lift reports",
        pages,
        ("lift", "", lambda page: page.lift),
        ("report", "", lambda page: page.word),
        ("page", "", lambda page: page.address or page.reason),
    )


def _summary(shift: ShiftPlan) -> ResultTable:
    """Return how long the shift lasts, and what of it is lost."""
    drives_need = shift.least
    return make_table(
        "Shift",
        [shift],
        ("lifts", "d", lambda x: len(x.lifts)),
        ("left out", "d", lambda x: len(x.refusals)),
        ("duration", "", lambda x: clock_time(x.duration)),
        ("drives need", "", lambda x: clock_time(drives_need)),
        ("ratio", ".2f", lambda x: x.duration / drives_need if drives_need else None),
        ("waited [s]", ".0f", lambda x: sum(planned.waited for planned in x.lifts)),
        note="Drives need: the crane that needs longest, as if it were alone, hooking included.",
    )
