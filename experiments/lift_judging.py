"""How the command ``cranedyn run lift_report`` judges a lift, alone or one of a comparison."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

from cranedyn.checks import check_choice, number, within
from cranedyn.errors import DataError, printable
from cranedyn.interfaces import EngineName
from cranedyn.lifts.judging.chart import read_chart
from cranedyn.lifts.judging.factors import DriveClass, HoistingClass
from cranedyn.lifts.judging.plan_record import PlanOptions
from cranedyn.references.limits import Limits
from experiments import harness
from experiments.scenarios.moves import LIMITS

if TYPE_CHECKING:
    from cranedyn.lifts.judging.judgement import Judgement
    from cranedyn.lifts.planning.site import Site

LIFTS = 10_000
"""Number of perturbed lifts where none is given."""

GUSTS = 32
"""Number of gusts drawn at the wind limit where none is given."""

COARSE_LIFTS = 400
"""Perturbed lifts of a case of a comparison where none are given. Without a failure they show a
probability of one of 0.92 % at most, just below the 1 % that is usually allowed."""

COARSE_GUSTS = 2
"""Gusts drawn at the wind limit in a case of a comparison where none are given. The limit rests on
the gusts that are always tried; few that are drawn say little besides."""


def comparison_asked_for(options: argparse.Namespace) -> bool:
    """Return whether a command line asks for a comparison."""
    return any((options.cranes, options.positions, options.list))


def plan_options(options: argparse.Namespace, setup: harness.Setup) -> PlanOptions:
    """Return what a command line judges a lift with, as the record of a plan holds it."""

    def name_of(file: str | None) -> str | None:
        """Return the name of a file without its folder, which another machine does not have."""
        return None if file is None else printable(Path(file).name)

    return PlanOptions(
        site=name_of(options.site) or "open_yard",
        chart=name_of(options.chart),
        crane=name_of(options.crane),
        load=options.load,
        falls=options.falls,
        hoisting=options.hoisting,
        drive=options.drive,
        wind=options.wind,
        swing=options.swing,
        risk=options.risk,
        lifts=_count(options.lifts, LIFTS, COARSE_LIFTS, options),
        gusts=_count(options.gusts, GUSTS, COARSE_GUSTS, options),
        gravity=setup.gravity,
        dt=setup.dt,
        control_period=setup.control_period,
        engine=setup.engine,
        values={name: _plain(value) for name, value in setup.values.items()},
    )


def _count(given: int | None, usual: int, coarse: int, options: argparse.Namespace) -> int:
    """Return a number of lifts or gusts: as given, or else the usual one, in a comparison a
    smaller one.
    """
    if given is not None:
        return given
    return coarse if comparison_asked_for(options) else usual


def _plain(value: object) -> float | str:
    """Return a number of the crane as JSON holds it."""
    return value if isinstance(value, int | float) else str(value)


def judge_plan(
    options: PlanOptions,
    *,
    site: str | Path,
    chart: str | Path | None = None,
    crane: str | Path | None = None,
    change: Callable[[Site], Site] = lambda site: site,
    limits: Limits = LIMITS,
    progress: Callable[[int], None] = lambda done: None,
) -> Judgement:
    """Judge a lift as a plan records it.

    Args:
        options: What it is judged with beside the files.
        site: The site file, or the name of an example.
        chart: The chart file, or the name of an example; None for that of the site.
        crane: The file of the crane; None for that of the site.
        change: What to change of the site after it is read, such as where the crane stands.
        limits: Limits of the drives of a site that enters none.
        progress: Called after each of three stages.

    Raises:
        CraneError: As `cranedyn.lifts.judging.judgement.judge`, or if a value is out of its range.
    """
    from cranedyn.lifts.judging.analysis import Requirements
    from cranedyn.lifts.judging.judgement import judge
    from cranedyn.lifts.planning.lift import crane_of
    from cranedyn.lifts.planning.site_file import read_site

    check_choice("hoisting", options.hoisting, HoistingClass)
    check_choice("drive", options.drive, DriveClass)
    check_choice("engine", options.engine, EngineName)
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
    for name in ("site", "gravity", "urdf"):
        if name in options.values:
            raise DataError(f"{name} is no number of a crane that --set can change; leave it out.")
    entered_chart = None if chart is None else read_chart(chart)
    judged_site = change(read_site(site))
    if options.load is not None:
        # The mass of all that hangs, so that the rigging of the site's file is not added to it.
        load = number("load", options.load, "kg", "> 0")
        crane_values = {**judged_site.crane, "payload_mass": load}
        no_rigging = {"hook": 0.0, "slings": 0.0}
        judged_site = replace(judged_site, crane=crane_values, rigging=no_rigging)
    if entered_chart is not None:
        entered_chart.of_falls(options.falls)  # refuses a number that the chart does not have
    return judge(
        judged_site,
        entered_chart,
        requirements,
        falls=options.falls,
        crane=crane_of(judged_site, gravity=options.gravity, urdf=crane, **options.values),
        limits=limits,
        hoisting=cast("HoistingClass", options.hoisting),
        drive=cast("DriveClass", options.drive),
        period=options.control_period,
        dt=options.dt,
        engine=cast("EngineName", options.engine),
        progress=progress,
    )
