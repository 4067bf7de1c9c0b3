"""A lift judged: GO, NO GO or NOT COMPLETE, and every number for a method statement.

Utilisation, clearances, factors, wind and robustness on a page that begins with the verdict.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from cranedyn.command import FAILED, Parser, command
from cranedyn.lifts.judging.factors import DriveClass, HoistingClass
from cranedyn.verdict import Verdict, overall
from experiments import harness
from experiments.harness.arguments import command_name
from experiments.lift_comparison import add_comparison, compare_lifts
from experiments.lift_judging import (
    COARSE_GUSTS,
    COARSE_LIFTS,
    GUSTS,
    LIFTS,
    comparison_asked_for,
    judge_plan,
    plan_options,
)

if TYPE_CHECKING:
    from cranedyn.lifts.judging.judgement import Judgement
    from cranedyn.lifts.judging.plan_writing import PlanSource

CRANE = (
    "crane as a .xacro with the arguments that the site enters, or as a plain URDF with the masses "
    "and efforts that it enters; instead of ours"
)
"""Help of the option of that name."""


def _outcome(judgement: Judgement, command: str) -> harness.Outcome:
    from cranedyn.lifts.judging.lift_figures import scenery
    from cranedyn.recording import Run

    lift = judgement.analysis
    required = judgement.analysis.requirements
    begins = 0.0 if lift.grounded is None else lift.grounded.lift.phases["motion"]
    shown = scenery(lift.certificate, begins=begins)
    return harness.Outcome(
        tables=[harness.ResultTable(*table) for table in judgement.tables(command)],
        claims=judgement.checks,
        parameters={
            "site": lift.site.name,
            "chart": "" if lift.chart is None else lift.chart.name,
            "falls": lift.inputs.falls or 0,
            "hoisting": lift.hoisting,
            "drive": lift.drive,
            "wind_asked_m_s": required.wind,
            "swing_allowed_rad": required.swing,
            "risk_allowed": required.risk,
            "lifts": required.lifts,
            "gusts": required.gusts,
        },
        trajectories={"lift": lift.run, "loads": lift.loads},
        figures={name: figure for name, (figure, _) in judgement.figures.items()},
        recording=[Run(lift.site.name, lift.run_crane, lift.run, scenery=shown)],
    )


@dataclass(frozen=True)
class _Judged:
    """A lift that was judged, and what its plan is written with.

    Attributes:
        judgement: The judgement.
        folder: Folder of the experiment.
        command_line: The command that makes the numbers again.
        plan: Options and files of the plan.
    """

    judgement: Judgement
    folder: Path
    command_line: str
    plan: PlanSource


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line, then write the page and, where a browser is there, the PDF."""
    judged: list[_Judged] = []
    compared: list[harness.Outcome] = []

    def experiment(options: argparse.Namespace, setup: harness.Setup) -> harness.Outcome:
        from cranedyn.lifts.judging.plan_folder import next_revision
        from cranedyn.lifts.judging.plan_writing import PlanSource

        if comparison_asked_for(options):
            compared.append(compare_lifts(options, plan_options(options, setup), setup))
            return compared[0]
        # Before the lift is judged, which takes long: whether the plan can be written, and what it
        # is made of.
        next_revision(options.folder)
        site = options.site or "open_yard"
        plan = PlanSource.of(plan_options(options, setup), site, options.chart, options.crane)
        judgement = judge_plan(
            plan.options,
            site=site,
            chart=options.chart,
            crane=options.crane,
            progress=setup.reporter.count("plan, perturbed lifts, wind", 3),
        )
        command_line = " ".join([command_name("lift_report"), *options.argv])
        judged.append(_Judged(judgement, options.folder, command_line, plan))
        return _outcome(judgement, command_line)

    code = harness.run_experiment(_parser(), experiment, argv)
    if code not in (0, FAILED):
        return code
    if compared:
        # As of one lift: what is not complete is no success.
        return 0 if overall(compared[0].claims) is Verdict.HOLDS else FAILED
    if not judged:
        return code
    one = judged[0]
    return command(lambda: write_pages(one.judgement, one.folder, one.command_line, one.plan))


def write_pages(judgement: Judgement, folder: Path, command_line: str, plan: PlanSource) -> int:
    """Write the page, the PDF where a browser is installed, the drawings as DXF where ezdxf is, and
    the record of the plan; return the exit code.

    Args:
        judgement: The judged lift.
        folder: Folder of the experiment.
        command_line: The command that makes the numbers again.
        plan: Options and files of the plan.
    """
    from cranedyn.lifts.judging.plan_writing import write_plan

    written = write_plan(judgement, folder, command_line, plan)
    for sentence in judgement.analysis.unusual:
        print(f"Unusual: {sentence}")
    print(f"{judgement.word}: {written.page}.")
    if written.pdf is not None:
        print(f"On paper: {written.pdf}.")
    else:
        print(f"No PDF: {written.why_no_pdf}", file=sys.stderr)
    for drawing in written.drawings:
        print(f"For CAD: {drawing}.")
    if written.why_no_drawings:
        print(f"No DXF: {written.why_no_drawings}", file=sys.stderr)
    record = written.record
    print(f"Plan: {written.path}, revision {record.revision}, digest {record.short_digest}.")
    return 0 if judgement.verdict is Verdict.HOLDS else FAILED


def _parser() -> Parser:
    parser = harness.parser("lift_report", __doc__, engines=("compiled", "pinocchio"))
    harness.add_setup(parser, "payload_mass")
    add = parser.add_argument
    text = "site as TOML, see docs/howto/plan_lift.md, or name of an example; open_yard"
    add("--site", metavar="FILE", help=text)
    add("--crane", metavar="FILE", help=CRANE)
    add("--load", type=float, metavar="KG", help="all that hangs, with hook and slings [kg]")
    text = (
        "chart as TOML, see docs/howto/judge_lift.md, or name of an example; that of the site, or "
        "for our crane its own"
    )
    add("--chart", metavar="FILE", help=text)
    add("--falls", type=int, metavar="N", help="falls of rope; those of the site")
    add("--hoisting", choices=get_args(HoistingClass), default="HC2", help="class of the hoist")
    add("--drive", choices=get_args(DriveClass), default="HD4", help="class of its drive")
    add("--wind", type=float, metavar="V", help="gust to bear [m/s]; that of the site")
    text = "swing allowed in wind [degrees]; that of the site"
    add("--swing", type=float, metavar="DEG", help=text)
    text = "largest probability that a perturbed lift comes closer than required, in percent; that "
    add("--risk", type=float, metavar="P", help=f"{text}of the site")
    text = f"perturbed lifts, 0: not judged; {LIFTS}, in a comparison {COARSE_LIFTS}"
    add("--lifts", type=int, metavar="N", help=text)
    text = f"gusts drawn at the wind limit, 0: not judged; {GUSTS}, in a comparison {COARSE_GUSTS}"
    add("--gusts", type=int, metavar="N", help=text)
    add_comparison(parser)
    return parser


if __name__ == "__main__":
    sys.exit(main())
