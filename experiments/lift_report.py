"""A lift judged: utilisation, clearances, factors, wind and robustness on a page for a method
statement, with go or no go at its beginning.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from cranedyn.command import FAILED, command
from cranedyn.data.files import write_text
from cranedyn.errors import number, whole, within
from cranedyn.lifting.chart import CHARTS, read_chart
from cranedyn.lifting.factors import DriveClass, HoistingClass
from experiments import harness
from experiments.harness.arguments import command_name
from experiments.report import read_result

if TYPE_CHECKING:
    from experiments.judgement.case import Case

LIFTS, GUSTS = 10_000, 32
"""How many lifts are made that are not quite as planned, and how many gusts are drawn."""

WIND, SWING, RISK = 8.0, 5.0, 1.0
"""Gust that a lift must bear [m/s], swing in wind [degrees] and risk [%] that are allowed if
nothing else is said; ours."""


def experiment(options: argparse.Namespace, setup: harness.Setup) -> harness.Outcome:
    """Plan, certify, weigh, blow, perturb."""
    from cranedyn.planning.site_file import SITES, read_site
    from cranedyn.recording import Run
    from experiments.judgement import figures
    from experiments.judgement.case import Asked, case, checks
    from experiments.judgement.tables import tables
    from experiments.lift_figures import over_time, scenery, views

    asked = Asked(
        number("wind asked for", options.wind, "m/s", ">= 0"),
        math.radians(within("swing allowed", options.swing, 0.1, 45.0, "degrees")),
        within("risk allowed", options.risk, 0.0, 100.0, "%") / 100.0,
        whole("lifts", options.lifts, 0),
        whole("gusts", options.gusts, 0),
    )
    chart = read_chart(options.chart or CHARTS / "laboratory.toml")
    site = read_site(options.site or SITES / "open_yard.toml")
    if options.load is not None:  # instead of what the site says
        others = {name: one for name, one in site.crane.items() if name != "payload_mass"}
        site = replace(site, crane=others, rigging={})
    made = case(setup, site, chart, options.falls, asked, **_changed(options))
    again = " ".join([command_name("lift_report"), *options.argv])
    shown: dict[str, Any] = {
        "site": views(made.certificate),
        "clearance": over_time(made.certificate),
        "loads": figures.over_time(made),
        "chart": figures.chart(made),
    }
    if made.wind is not None:
        shown["wind"] = figures.wind(made)
    return harness.Outcome(
        tables=tables(made, options.hoisting, options.drive, again),
        claims=[harness.Claim(check.sentence, check.holds) for check in checks(made)],
        parameters=setup.parameters() | _parameters(made, options),
        trajectories={"lift": made.certificate.run, "loads": made.carried},
        figures=shown,
        recording=[
            Run(site.name, made.crane, made.certificate.run, scenery=scenery(made.certificate))
        ],
    )


def _changed(options: argparse.Namespace) -> dict[str, Any]:
    """What the command line changes of the site's crane."""
    load = None if options.load is None else number("load", options.load, "kg", "> 0")
    found: dict[str, Any] = {} if load is None else {"payload_mass": load}
    return found if options.crane is None else {**found, "urdf": Path(options.crane)}


def _parameters(made: Case, options: argparse.Namespace) -> dict[str, object]:
    return {
        "site": made.site.name,
        "chart": made.chart.name,
        "falls": made.falls,
        "hoisting": options.hoisting,
        "drive": options.drive,
        "wind_asked_m_s": made.asked.wind,
        "swing_allowed_rad": made.asked.swing,
        "risk_allowed": made.asked.risk,
        "lifts": made.asked.lifts,
        "gusts": made.asked.gusts,
    }


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line, then write the page and, where a browser is there, the PDF."""
    made = _parser()
    words = sys.argv[1:] if argv is None else argv
    result = Path("out") / "lift_report" / "result.json"
    before = None

    def judged(options: argparse.Namespace, setup: harness.Setup) -> harness.Outcome:
        nonlocal result, before
        result = Path(options.folder) / "result.json"
        before = result.stat().st_mtime_ns if result.exists() else None
        return experiment(options, setup)

    code = harness.run_experiment(made, judged, words)
    if code in (0, FAILED) and result.exists() and result.stat().st_mtime_ns != before:
        claims = read_result(result.parent)["claims"]
        go = all(claim["holds"] is True for claim in claims)  # what is not judged is no go
        return command(lambda: _paged(result.parent, 0 if go else FAILED))
    return code


def _paged(folder: Path, code: int) -> int:
    from experiments.judgement.page import page
    from experiments.judgement.printed import NoBrowser, print_page

    write_text(folder / "lift.html", page(folder))
    print(f"The page: {folder / 'lift.html'}.")
    try:
        print(f"On paper: {print_page(folder / 'lift.html', folder / 'lift.pdf')}.")
    except NoBrowser as error:
        print(f"No PDF: {error}", file=sys.stderr)
    return code


def _parser() -> argparse.ArgumentParser:
    made = harness.parser(
        "lift_report",
        "A lift judged: go or no go, and every number for a method statement.",
        engines=("compiled", "pinocchio"),
    )
    harness.add_setup(made, "payload_mass")
    made.add_argument("--site", metavar="FILE", help="site as TOML, see docs/lift.md; open_yard")
    made.add_argument("--crane", metavar="FILE", help="crane as xacro or URDF instead of ours")
    made.add_argument("--load", type=float, metavar="KG", help="mass that hangs, hook counted [kg]")
    made.add_argument("--chart", metavar="FILE", help="chart as TOML, see docs/lifting.md")
    made.add_argument("--falls", type=int, metavar="N", help="falls of rope; the fewest there are")
    made.add_argument(
        "--hoisting", choices=get_args(HoistingClass), default="HC2", help="class of the hoist"
    )
    made.add_argument(
        "--drive", choices=get_args(DriveClass), default="HD4", help="class of its drive"
    )
    made.add_argument("--wind", type=float, default=WIND, metavar="V", help="gust to bear [m/s]")
    made.add_argument(
        "--swing", type=float, default=SWING, metavar="DEG", help="swing allowed in wind [degrees]"
    )
    made.add_argument(
        "--risk",
        type=float,
        default=RISK,
        metavar="P",
        help="largest probability of coming nearer than required, not quite as planned, in percent",
    )
    made.add_argument(
        "--lifts", type=int, default=LIFTS, metavar="N", help="lifts not quite as planned; 0: none"
    )
    made.add_argument(
        "--gusts", type=int, default=GUSTS, metavar="N", help="gusts drawn in each wind; 0: none"
    )
    return made


if __name__ == "__main__":
    sys.exit(main())
