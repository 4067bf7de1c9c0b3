"""A lift judged: GO, NO GO or NOT COMPLETE, and every number for a method statement.

Utilisation, clearances, factors, wind and robustness on a page that begins with the verdict.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from cranedyn.checks import number, within
from cranedyn.command import FAILED, Parser, command
from cranedyn.lifts.judging.chart import read_chart
from cranedyn.lifts.judging.factors import DriveClass, HoistingClass
from cranedyn.verdict import Verdict
from experiments import harness
from experiments.harness.arguments import command_name
from experiments.scenarios.moves import LIMITS

if TYPE_CHECKING:
    from cranedyn.lifts.judging.judgement import Judgement

CRANE = (
    "crane as a .xacro with the arguments that the site enters, or as a plain URDF with the masses "
    "and efforts that it enters; instead of ours"
)
"""Help of the option of that name."""


def _judge(options: argparse.Namespace, setup: harness.Setup) -> Judgement:
    from cranedyn.lifts.judging.analysis import Requirements
    from cranedyn.lifts.judging.judgement import judge
    from cranedyn.lifts.planning.lift import crane_of
    from cranedyn.lifts.planning.site_file import read_site

    requirements = Requirements(
        wind=options.wind,
        swing=None
        if options.swing is None
        else math.radians(within("swing allowed", options.swing, 0.1, 45.0, "degrees")),
        risk=None
        if options.risk is None
        else within("risk allowed", options.risk, 0.0, 100.0, "%") / 100.0,
        lifts=options.lifts,
        gusts=options.gusts,
    )
    chart = None if options.chart is None else read_chart(options.chart)
    site = read_site(options.site or "open_yard")
    if options.load is not None:
        # The mass of all that hangs, so that the rigging of the site's file is not added to it.
        load = number("load", options.load, "kg", "> 0")
        crane_values = {**site.crane, "payload_mass": load}
        site = replace(site, crane=crane_values, rigging={"hook": 0.0, "slings": 0.0})
    if chart is not None:
        chart.on(options.falls)
    return judge(
        site,
        chart,
        requirements,
        falls=options.falls,
        crane=crane_of(site, gravity=setup.gravity, urdf=options.crane, **setup.values),
        limits=LIMITS,
        hoisting=options.hoisting,
        drive=options.drive,
        period=setup.control_period,
        dt=setup.dt,
        engine=setup.engine,
        progress=setup.reporter.count("plan, perturbed lifts, wind", 3),
    )


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


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line, then write the page and, where a browser is there, the PDF."""
    judged: list[tuple[Judgement, Path, str]] = []

    def experiment(options: argparse.Namespace, setup: harness.Setup) -> harness.Outcome:
        command_line = " ".join([command_name("lift_report"), *options.argv])
        judged.append((_judge(options, setup), options.folder, command_line))
        return _outcome(judged[0][0], command_line)

    code = harness.run_experiment(_parser(), experiment, argv)
    return command(lambda: write_pages(*judged[0])) if judged and code in (0, FAILED) else code


def write_pages(judgement: Judgement, folder: Path, command_line: str) -> int:
    """Write the page, the drawings as DXF where ezdxf is installed, and the PDF where a browser is;
    return the exit code.

    Args:
        judgement: The judged lift.
        folder: Folder of the experiment.
        command_line: The command that makes the numbers again.
    """
    from cranedyn.lifts.judging.drawings import DrawingTooLarge, NoDxf, write_drawings
    from cranedyn.lifts.judging.report_page import NoBrowser, print_pdf

    page = judgement.report(folder / "lift.html", command_line)
    for sentence in judgement.analysis.unusual:
        print(f"Unusual: {sentence}")
    print(f"{judgement.word}: {page}.")
    try:
        for drawing in write_drawings(judgement.analysis, folder):
            print(f"For CAD: {drawing}.")
    except (NoDxf, DrawingTooLarge) as error:
        print(f"No DXF: {error}", file=sys.stderr)
    try:
        print(f"On paper: {print_pdf(page, folder / 'lift.pdf')}.")
    except NoBrowser as error:
        print(f"No PDF: {error}", file=sys.stderr)
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
    add("--lifts", type=int, default=10_000, metavar="N", help="perturbed lifts; 0: not judged")
    add("--gusts", type=int, default=32, metavar="N", help="gusts in each wind; 0: not judged")
    return parser


if __name__ == "__main__":
    sys.exit(main())
