"""The report of a lift as one HTML document: the verdict and why, then every number; and as PDF,
printed by a browser.

Every sentence and picture on it is made from the lift that it reports. A sentence that is the same
for every lift states what the method does, and never a fact about what was entered.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import tempfile
from collections import Counter
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cranedyn.assumptions import Origin
from cranedyn.data.files import atomic_write, write_text
from cranedyn.errors import CraneError, quoted
from cranedyn.interfaces import State
from cranedyn.lifts.judging.analysis import LiftAnalysis
from cranedyn.lifts.judging.drawings import DrawingTooLarge, LiftScene, LiftSheet, sheets
from cranedyn.lifts.judging.drawings.sheet import MARGIN
from cranedyn.lifts.judging.hook_radius import hook_radii
from cranedyn.lifts.judging.judged_inputs import CHART_FIELD
from cranedyn.lifts.judging.lift_figures import LiftFigure
from cranedyn.lifts.judging.lift_positions import lift_category
from cranedyn.lifts.judging.lift_tables import SUMMARY_TITLE
from cranedyn.lifts.judging.load_joints import LoadJoints
from cranedyn.lifts.judging.plan_checks import ground_caveat, not_checked, sling_force
from cranedyn.lifts.judging.plan_fields import (
    counting_assumptions,
    field_groups,
    identification,
    other_assumptions,
    signatures,
)
from cranedyn.lifts.judging.plan_record import NO_GO, PlanMark
from cranedyn.lifts.judging.plan_tables import (
    PLACES_TITLE,
    POSITIONS_TITLE,
    SEQUENCE_TITLE,
    WIND_TITLE,
)
from cranedyn.lifts.judging.table import Table
from cranedyn.lifts.planning.ground_lift import not_grounded, stands_at
from cranedyn.lifts.planning.perturbed import drag_area
from cranedyn.lifts.planning.site import Site
from cranedyn.plotting.html import PageFigure, PageTable, render, worst_first
from cranedyn.recording.sketch import sketch
from cranedyn.verdict import Check, Verdict, overall

WORDS = {
    Verdict.HOLDS: "GO",
    Verdict.FAILS: NO_GO,
    Verdict.NOT_JUDGED: "NOT COMPLETE",
}
"""What a report says by its verdict."""

STATEMENT = (
    "This page is an appendix to a method statement. It is made by a program from a model of a "
    "crane, and no substitute for a competent person, who answers for the lift, knows the ground, "
    "the rigging, the weather and the people, and has read what is said here of its limits."
)

_TEMPLATE = Path(__file__).with_name("templates") / "lift.html"

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome", "msedge")
"""Browsers that print without a window, by their names on the path."""

SHEET_FOOT = MARGIN - 1.0
"""Height of the foot of a drawing's page, in which revision, digest and number of the page stand
[mm]: a little less than the margin below the frame of a sheet, so that nothing of it is cut off."""

ONE_MOTION = (
    "This is about one motion, that of the sequence, its drives together, as a program drives "
    "them. By hand, or one after the other, the load takes other ways, which are not proven."
)
"""What the verdict is about, for the first page."""

_OPTIONS = (
    "--headless=new",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-pdf-header-footer",
)
"""Options of such a browser: no window, no GPU, no traffic of its own, and paper without the
address and the date that browsers add."""

_TIMEOUT = 120.0
"""Time that a browser may take to print a page [s]."""


def lift_html(
    scene: LiftScene,
    checks: Sequence[Check],
    tables: Sequence[Table],
    figures: Sequence[LiftFigure],
    command: str = "",
    plan: PlanMark | None = None,
) -> str:
    """Return the report of a lift: a page to decide by and to sign, then every number.

    Args:
        scene: The lift, and what its drawings show.
        checks: Its checks, whose verdict together is that of the report.
        tables: Its tables, see `cranedyn.lifts.judging.lift_tables.tables`.
        figures: Its figures.
        command: The command that makes its numbers again; empty if there is none.
        plan: What the page says of the record that lies beside it; None if there is none.
    """
    analysis = scene.analysis
    verdict = overall(checks)
    named = {table.title: shown for table, shown in zip(tables, page_tables(tables), strict=True)}
    places = POSITIONS_TITLE if POSITIONS_TITLE in named else PLACES_TITLE
    drawn, not_drawn = _sheets_or_reason(scene)
    return render(
        _TEMPLATE,
        title=f"Lift: {analysis.site.name}",
        verdict=verdict,
        word=WORDS[verdict],
        reason=_reason(checks),
        category=lift_category(analysis, scene.in_exclusion_zone),
        picture=_picture(analysis),
        identification=identification(analysis),
        against=[check for check in worst_first(checks) if check.verdict is not Verdict.HOLDS],
        one_motion=ONE_MOTION,
        notices=first_page_notices(analysis),
        numbers=named.pop(SUMMARY_TITLE),
        wind=named.pop(WIND_TITLE),
        positions=named.pop(places),
        counting=counting_assumptions(analysis),
        others=other_assumptions(analysis),
        caveat=ground_caveat(analysis),
        signatures=signatures(analysis),
        checks=worst_first(checks),
        not_checked=not_checked(analysis, checks),
        unusual=analysis.unusual,
        statement=STATEMENT,
        sequence=named.pop(SEQUENCE_TITLE),
        groups=field_groups(analysis, scene.in_exclusion_zone),
        tables=list(named.values()),
        figures=page_figures(figures),
        limits=[*limits_of(analysis), *not_drawn],
        sheets=drawn,
        foot_mm=SHEET_FOOT,
        command=command,
        versions=_versions(),
        plan=plan,
    )


class Notice(NamedTuple):
    """A sentence on the first page.

    Attributes:
        sentence: The sentence.
        warns: Whether nothing may be lifted by the page because of it.
    """

    sentence: str
    warns: bool


def first_page_notices(analysis: LiftAnalysis) -> list[Notice]:
    """Return what whoever signs must know before any number: that the chart is of no real crane or
    an estimate, that the load hangs at an end, and which lift of a shift this is.
    """
    notices = []
    assumptions = analysis.inputs.assumptions
    if analysis.chart is not None and analysis.chart.example:
        sentence = (
            "The load chart is an example, of no real crane: lift nothing by this page. Enter the "
            "chart of your crane as [crane] chart (cranedyn template chart), and judge again."
        )
        notices.append(Notice(sentence, warns=True))
    if any(a.origin is Origin.ESTIMATED and a.field == CHART_FIELD for a in assumptions):
        sentence = (
            "The load chart is an estimate: lift nothing by this page. Enter the chart of the "
            "crane's maker, and judge again."
        )
        notices.append(Notice(sentence, warns=True))
    hangs = _hangs_at(analysis.site)
    if hangs:
        notices.append(Notice(hangs, warns=False))
    shift = analysis.site.details.shift
    if shift is not None:
        sentence = (
            f"Lift {quoted(shift.lift or '')} of a shift: {shift.crane} leaves with it at "
            f"{shift.leaves} and delivers it at {shift.delivered}."
        )
        notices.append(Notice(sentence, warns=False))
    return notices


def _hangs_at(site: Site) -> str:
    """Return at which ends of a lift the load hangs, and what the verdict leaves out therefore, in
    a sentence; empty if it stands at both.
    """
    hanging = []
    for end, name, left_out in (
        (site.start, "start", "its pick-up"),
        (site.goal, "end", "its set-down"),
    ):
        if not stands_at(end):
            hanging.append((name, left_out))
    if not hanging:
        return ""
    if len(hanging) == 2:
        return (
            "The load hangs at the start and at the end of this lift: its pick-up and its set-down "
            "are not in this plan, nor in its verdict."
        )
    ((name, left_out),) = hanging
    return (
        f"The load hangs at the {name} of this lift: {left_out} is not in this plan, nor in its "
        "verdict."
    )


def _sheets_or_reason(scene: LiftScene) -> tuple[list[LiftSheet], list[str]]:
    """Return the drawings of a lift, or a sentence that says why there are none: a report has its
    numbers also where a drawing fits on no paper.
    """
    try:
        return sheets(scene), []
    except DrawingTooLarge as error:
        return [], [f"There are no drawings. {error}"]


def _reason(checks: Sequence[Check]) -> str:
    """Return how many checks hold, fail and were not judged, in a sentence."""
    counts = Counter(check.verdict for check in checks)
    if counts[Verdict.HOLDS] == len(checks):
        return f"All {len(checks)} checks hold."
    failed = counts[Verdict.FAILS]
    unknown = counts[Verdict.NOT_JUDGED]
    does = "does" if failed == 1 else "do"
    was = "was" if unknown == 1 else "were"
    return (
        f"Of {len(checks)} checks {failed} {does} not hold and {unknown} {was} not judged; "
        f"{counts[Verdict.HOLDS]} hold."
    )


def _picture(analysis: LiftAnalysis) -> PageFigure:
    """Return a picture of the lift's own crane from the side, where the load is farthest out."""
    crane = analysis.crane
    run = analysis.certificate.run
    radius = analysis.loads.values.get("radius_m")
    if radius is None:
        row = 0
        caption = "The crane of this lift from the side, at the start."
    else:
        # The certified run has the same places as that with lift-off, and other rows.
        clearance = analysis.certificate.lift.clearance
        radii = hook_radii(clearance, analysis.certificate.lift.timed.places)
        assert radii is not None  # the loads have a radius
        centres = clearance.point(run.q[:, clearance.drive_joints])
        row = int(np.linalg.norm(centres[:, :2], axis=1).argmax())
        caption = (
            "The crane of this lift from the side, its hook at a radius of "
            f"{radii.max():.1f} m, where the load is farthest out."
        )
    q = run.q[row].copy()
    slew = LoadJoints.of(crane).slew
    if slew is not None:
        q[slew] = 0.0  # the eye looks square to the jib
    shown = State(q, np.zeros_like(q))
    return PageFigure.of(sketch(crane, shown), caption)


def limits_of(analysis: LiftAnalysis) -> list[str]:
    """Return what the numbers of a lift do not say, in sentences."""
    sentences = []
    lift = analysis.certificate.lift
    if analysis.grounded is None:
        sentences.append(
            "The model's rope has no mass and does not stretch, and the crane has no play."
        )
    else:
        rope = analysis.grounded.lift.crane.springs.rope
        assert rope is not None  # see `cranedyn.lifts.planning.ground_lift`
        sentences.append(
            f"The model's rope has no mass; it stretches by its stiffness EA of "
            f"{float(rope.stiffness):.3g} N. The crane has no play."
        )
    unchecked = "Structure, ropes and lifting points are not checked for strength"
    if sling_force(analysis) is None:
        unchecked += ", and neither are the slings"
    sentences.append(f"{unchecked}.")
    sentences += _limits_of_the_ends(analysis)
    if analysis.site.details.shift is not None:
        sentences.append(
            "The lift is planned with the other cranes of the shift standing where they are when "
            "the load leaves. What keeps the cranes apart while all of them move is the plan of "
            "the shift, whose motion of this crane may be another one."
        )
    if analysis.perturbed is not None or analysis.wind is not None:
        sentences.append(
            "Perturbed lifts and gusts are of the load that hangs. Wind acts on the load alone, "
            f"whose area times drag coefficient is {drag_area(lift.clearance):.3g} m²; what it "
            "does to the crane's structure is not in it."
        )
    else:
        sentences.append("Nothing was computed in wind.")
    sentences.append("Standards were read second hand; where a clause is named, read it there.")
    if analysis.chart is not None:
        sentences.append(f"The chart is {analysis.chart.name}. Source: {analysis.chart.source}.")
    return sentences


def _limits_of_the_ends(analysis: LiftAnalysis) -> list[str]:
    """Return what the numbers of a lift do not say of picking up and setting down, in sentences."""
    hanging = []
    not_simulated = []
    for end, phase in (
        (analysis.site.start, "picking up"),
        (analysis.site.goal, "setting down"),
    ):
        if not stands_at(end):
            hanging.append(phase)
        elif analysis.grounded is None:
            not_simulated.append(phase)
    sentences = []
    if hanging:
        sentences.append(
            f"The load hangs where {' and '.join(hanging)} would be; that is not in this lift."
        )
    if not_simulated:
        certificate = analysis.certificate
        why = not_grounded(certificate.lift, certified=certificate.holds)
        sentences.append(f"Not simulated: {' and '.join(not_simulated)}; {why}.")
    return sentences


def page_figures(figures: Sequence[LiftFigure]) -> list[PageFigure]:
    """Return figures as those of a page."""
    return [PageFigure.of(figure, caption) for figure, caption in figures]


def page_tables(tables: Sequence[Table]) -> list[PageTable]:
    """Return tables as those of a page."""
    result = []
    for table in tables:
        columns = [(header, not form) for header, form in table.columns]
        result.append(PageTable(table.title, columns, table.cells(), table.note))
    return result


def _versions() -> str:
    """Return with which versions and on which machine the numbers were made."""
    packages = ("cranedyn", "pin", "numpy", "scipy")
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in packages)
    return (
        f"python {platform.python_version()}, {versions}; {platform.system()} {platform.machine()}"
    )


def write_html_or_pdf(path: str | Path, text: str) -> Path:
    """Write an HTML document as a ``.html`` file, or as a ``.pdf`` file that a browser prints.

    Raises:
        NoBrowser: If a PDF is asked for and no browser prints it.
        DataError: If the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() != ".pdf":
        write_text(path, text)
        return path
    with tempfile.TemporaryDirectory() as folder:
        draft = Path(folder) / "page.html"
        write_text(draft, text)
        return print_pdf(draft, path)


class NoBrowser(CraneError):
    """No browser is installed, or it made no PDF."""


def print_pdf(page: Path, pdf: Path) -> Path:
    """Print an HTML page as PDF.

    Args:
        page: An HTML file that needs no other file.
        pdf: The file to write.

    Raises:
        NoBrowser: If no browser is installed, or it makes no PDF within two minutes.
        DataError: If the PDF cannot be written.
    """
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        raise NoBrowser(
            f"There is no browser to print {page} with; install Chromium, or print the page from "
            "any browser."
        )
    # Browsers refuse their sandbox to root, as in most containers.
    root = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
    with tempfile.TemporaryDirectory() as folder:
        printed = Path(folder) / "page.pdf"
        options = [*root, f"--user-data-dir={folder}/profile", f"--print-to-pdf={printed}"]
        command = [browser, *_OPTIONS, *options, page.absolute().as_uri()]
        try:
            # Not to pipes: processes of a browser that outlive it would keep them open.
            nothing = subprocess.DEVNULL
            subprocess.run(command, stdout=nothing, stderr=nothing, timeout=_TIMEOUT, check=True)
            content = printed.read_bytes()
        except (OSError, subprocess.SubprocessError) as error:
            why = type(error).__name__
            raise NoBrowser(f"{browser} did not print {page} ({why}); print it by hand.") from None
    with atomic_write(pdf) as draft:
        draft.write_bytes(content)
    return pdf
