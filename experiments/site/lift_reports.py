"""A lift report for each lift of a shift, in a folder of its own beside the page of the shift."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from cranedyn.command import command_line
from cranedyn.errors import CraneError
from cranedyn.lifts.judging.plan_record import PlanOptions
from cranedyn.lifts.judging.plan_writing import PlanSource, write_plan
from cranedyn.lifts.sites.lift_site import folder_name, write_lift_site
from cranedyn.lifts.sites.shift_plan import PlannedLift, ShiftPlan
from cranedyn.lifts.sites.site_page import LiftPage
from cranedyn.references.limits import Limits
from experiments.lift_judging import COARSE_GUSTS, COARSE_LIFTS, judge_plan

REPORTS_FOLDER = "lifts"
"""Name of the folder of all reports in the folder of the shift."""


def lift_reports(
    shift: ShiftPlan, source: Path, folder: Path, progress: Callable[[int], None]
) -> list[LiftPage]:
    """Judge each lift of a shift, and write its report; return where they are.

    A lift that cannot be judged by itself, such as one whose only way is past a crane that stands
    in it when the load leaves, has no report, and the reason instead.

    Args:
        shift: The plan of the shift.
        source: The site file that it was planned from.
        folder: Folder of the shift.
        progress: Takes the number of lifts that are done, after each.

    Raises:
        DataError: If a file cannot be read or written.
    """
    pages = []
    for count, planned in enumerate(shift.lifts, start=1):
        pages.append(_report(shift, planned, source, folder))
        progress(count)
    return pages


def _report(shift: ShiftPlan, planned: PlannedLift, source: Path, folder: Path) -> LiftPage:
    """Write the report of a lift, and return where it is."""
    name = folder_name(shift, planned)
    own_folder = folder / REPORTS_FOLDER / name
    site = write_lift_site(shift, planned, source, own_folder)
    options = PlanOptions(site.name, lifts=COARSE_LIFTS, gusts=COARSE_GUSTS)
    stations = shift.plan.site.stations
    drives = stations[shift.plan.site.index_of(planned.crane)].converters
    try:
        plan = PlanSource.of(options, site)
        limits = Limits(drives.rates.tolist(), drives.accelerations.tolist())
        judgement = judge_plan(options, site=site, limits=limits)
    except CraneError as error:
        return LiftPage(planned.lift.name, "no report", str(error), "")
    arguments = ("--site", site, "--lifts", options.lifts, "--gusts", options.gusts)
    again = command_line("cranedyn", "run", "lift_report", *arguments, "--out", own_folder)
    written = write_plan(judgement, own_folder, again, plan)
    reasons = " ".join(judgement.reasons[:1])
    address = f"{REPORTS_FOLDER}/{name}/{written.page.name}"
    return LiftPage(planned.lift.name, judgement.word, reasons, address)
