"""Judge a lift: plan, certify and simulate it, check all that is required, report what follows.

The outcome is GO, NO GO or NOT COMPLETE. NO GO means that a check fails. NOT COMPLETE means that
none fails and something was not judged: it was not computed, or rests on a value that nobody
entered.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from cranedyn.errors import CraneError, OutOfRange
from cranedyn.interfaces import EngineName
from cranedyn.lifts.judging import report_page
from cranedyn.lifts.judging.analysis import (
    DEFAULT_REQUIREMENTS,
    GroundedLift,
    JudgedInputs,
    LiftAnalysis,
    Requirements,
)
from cranedyn.lifts.judging.chart import (
    CUT_OUT,
    Chart,
    NotCovered,
    refuse_planned_radii,
    utilisation,
)
from cranedyn.lifts.judging.chart_setup import setup_gap
from cranedyn.lifts.judging.drawings import LiftScene
from cranedyn.lifts.judging.factors import DriveClass, HoistingClass
from cranedyn.lifts.judging.hook_radius import hook_radii
from cranedyn.lifts.judging.judged_inputs import resolve_inputs
from cranedyn.lifts.judging.lift_checks import CheckFunction, run_checks
from cranedyn.lifts.judging.lift_figures import LiftFigure, figures
from cranedyn.lifts.judging.lift_tables import tables, with_command
from cranedyn.lifts.judging.load_joints import LoadJoints
from cranedyn.lifts.judging.loads import loads
from cranedyn.lifts.judging.plan_record import (
    PlanMark,
    PlanResult,
    recorded_checks,
    recorded_table,
)
from cranedyn.lifts.judging.plausible_chart import chart_findings
from cranedyn.lifts.judging.table import Table
from cranedyn.lifts.judging.wind_limit import wind_limit
from cranedyn.lifts.planning.certificate import Certificate, certify
from cranedyn.lifts.planning.clearance_of import clearance_of
from cranedyn.lifts.planning.ground_lift import (
    certify_ground_lift,
    from_ground,
    not_grounded,
    stands_at,
)
from cranedyn.lifts.planning.lift import crane_of, plan_lift
from cranedyn.lifts.planning.perturbed import perturb
from cranedyn.lifts.planning.plausibility import WIND, findings, judge_value, unusual_or_refuse
from cranedyn.lifts.planning.site import Site
from cranedyn.model.crane import Crane
from cranedyn.references.limits import Limits
from cranedyn.verdict import Check, Verdict, overall


@dataclass(frozen=True, eq=False)
class Judgement:
    """A lift and whether it may go.

    Attributes:
        analysis: Everything that was computed of the lift.
        checks: Sentences with their numbers, each with its verdict.
    """

    analysis: LiftAnalysis
    checks: Sequence[Check]

    @property
    def verdict(self) -> Verdict:
        """The verdict of all checks together."""
        return overall(self.checks)

    @property
    def word(self) -> str:
        """GO, NO GO or NOT COMPLETE."""
        return report_page.WORDS[self.verdict]

    @property
    def go(self) -> bool:
        """Whether every check holds; one that was not judged does not."""
        return self.verdict is Verdict.HOLDS

    @property
    def reasons(self) -> list[str]:
        """Sentences of the checks that do not hold or were not judged: why it is no GO."""
        return [c.sentence for c in self.checks if c.verdict is not Verdict.HOLDS]

    @cached_property
    def figures(self) -> dict[str, LiftFigure]:
        """Figures of the lift by name, each with a caption."""
        return figures(self.analysis)

    @cached_property
    def scene(self) -> LiftScene:
        """What the drawings of the lift show."""
        return LiftScene.of(self.analysis)

    def tables(self, command: str = "") -> list[Table]:
        """Return the tables of the lift, whose notes name the command that makes them again."""
        return with_command(self._tables, command)

    @cached_property
    def _tables(self) -> list[Table]:
        """The tables of the lift."""
        return tables(self.analysis)

    @cached_property
    def result(self) -> PlanResult:
        """What came of the judgement, as the record of a plan holds it."""
        recorded = []
        for table in self.tables():
            headers = [header for header, _ in table.columns]
            recorded.append(recorded_table(table.title, headers, table.cells()))
        return PlanResult(self.word, recorded_checks(self.checks), tuple(recorded))

    def html(self, command: str = "", plan: PlanMark | None = None) -> str:
        """Return the report as one HTML document that needs no other file, names the command that
        makes it again, and carries the digest of a plan if one is given.
        """
        figures = [*self.figures.values()]
        return report_page.lift_html(
            self.scene, self.checks, self.tables(command), figures, command, plan
        )

    def report(self, path: str | Path, command: str = "") -> Path:
        """Write `html` as a ``.html`` or ``.pdf`` file, see
        `cranedyn.lifts.judging.report_page.write_html_or_pdf`.
        """
        return report_page.write_html_or_pdf(path, self.html(command))


def judge(
    site: Site,
    chart: Chart | None = None,
    requirements: Requirements = DEFAULT_REQUIREMENTS,
    *,
    falls: int | None = None,
    crane: Crane | None = None,
    limits: Limits | None = None,
    hoisting: HoistingClass = "HC2",
    drive: DriveClass = "HD4",
    checks: Sequence[CheckFunction] | None = None,
    period: float = 5e-3,
    dt: float = 5e-4,
    engine: EngineName = "compiled",
    progress: Callable[[int], None] = lambda done: None,
) -> Judgement:
    """Plan a lift, certify it, and check all that is required of it.

    A lift whose start or goal has two coordinates stands there; its lift-off and set-down are
    simulated and checked too.

    Args:
        site: The site with the start and goal of the lift.
        chart: Load chart of the crane; None for that of the site or, for the crane of this project,
            the one that is shipped with it. Without any, the utilisation is not judged.
        requirements: Requirements on the lift.
        falls: Number of falls that carry the hook; None for that of the site, or the fewest of the
            chart, which is a default.
        crane: The crane; None for that of the site.
        limits: Rates and accelerations of the drives for a site that enters none. The judgement is
            then not complete: a GO rests on drives that were entered with the site.
        hoisting: Hoisting class of the crane.
        drive: Class of its hoist drive.
        checks: Checks beside those of the certificate; None for
            `cranedyn.lifts.judging.lift_checks.CHECKS`.
        period: Control period [s].
        dt: Physics step [s]; twice as much in perturbed lifts and in wind.
        engine: Engine of the certificate's simulation.
        progress: Called after each of three stages: plan, perturbed lifts, wind.

    Raises:
        NoWay: If no way is found for the lift, with the reason.
        DataError: If an entered value cannot be meant, see `cranedyn.lifts.planning.plausibility`,
            or the chart of the site cannot be read.
        UnknownName: If the chart has no such number of falls.
        RunError: If the simulation breaks off.
        CraneError: If neither the site nor `limits` gives limits of the drives, as
            `cranedyn.lifts.planning.lift.plan_lift`, or an extra is not installed.
    """
    limits = site.limits or limits
    if limits is None:
        raise CraneError("The site does not say what its drives can do ([drives]); give limits.")
    crane = crane_of(site) if crane is None else crane
    inputs = resolve_inputs(site, crane, limits, requirements, chart, falls)
    reach = clearance_of(crane, site).reach
    turns = LoadJoints.of(crane).slew is not None
    unusual = _plausible(site, inputs, reach, turns=turns)

    certificate = certify(plan_lift(site, limits, crane=crane, period=period), dt=dt, engine=engine)
    grounded = _grounded(certificate, inputs.falls)
    progress(1)

    run_crane = crane if grounded is None else grounded.lift.crane
    run = certificate.run if grounded is None else grounded.run
    run_loads = loads(
        run_crane,
        run,
        base=site.base,
        arms=site.arms,
        runway=site.runway,
        heading=site.heading,
    )
    used = None
    chart_error = ""
    chart_covers = True
    if inputs.chart is not None:
        chart_error = setup_gap(inputs.chart, inputs.falls, site)
        chart_covers = not chart_error
    if inputs.chart is not None and chart_covers:
        lift = certificate.lift
        try:
            planned = hook_radii(lift.clearance, lift.timed.places)
            if planned is not None:
                refuse_planned_radii(planned, run_loads, inputs.chart, inputs.falls)
            used = utilisation(run_loads, inputs.chart, inputs.falls, gravity=crane.gravity)
        except OutOfRange as error:
            chart_error = str(error)
            chart_covers = not isinstance(error, NotCovered)
    wind = perturbed = None
    if certificate.holds and requirements.lifts:
        perturbed = perturb(certificate, requirements.lifts, spread=inputs.spread, dt=2.0 * dt)
    progress(2)
    if certificate.holds and used is not None and requirements.gusts:
        assert inputs.chart is not None and inputs.requirements.swing is not None
        share = site.details.limits.chart_share
        wind = wind_limit(
            certificate,
            inputs.chart,
            inputs.falls,
            share=CUT_OUT if share is None else share,
            swing=inputs.requirements.swing,
            count=requirements.gusts,
            dt=2.0 * dt,
        )
    progress(3)
    analysis = LiftAnalysis(
        site=site,
        inputs=inputs,
        certificate=certificate,
        loads=run_loads,
        utilisation=used,
        chart_error=chart_error,
        wind=wind,
        perturbed=perturbed,
        grounded=grounded,
        unusual=unusual,
        chart_covers=chart_covers,
        hoisting=hoisting,
        drive=drive,
    )
    return Judgement(analysis, run_checks(analysis, checks))


def _plausible(
    site: Site, inputs: JudgedInputs, reach: tuple[float, float], *, turns: bool
) -> tuple[str, ...]:
    """Return sentences about values that are unusual.

    Args:
        site: The site.
        inputs: What the lift is judged with.
        reach: Least and largest radius of the load [m].
        turns: Whether the crane slews, so that its chart has radii.

    Raises:
        DataError: If a value cannot be meant.
    """
    found = findings(site, reach)
    if inputs.requirements.wind is not None:
        found += judge_value(WIND, inputs.requirements.wind, "wind", "gust")
    if inputs.chart is not None:
        found += chart_findings(inputs.chart, reach[1] if turns else None)
    return unusual_or_refuse(found)


def _grounded(certificate: Certificate, falls: int | None) -> GroundedLift | None:
    """Return the lift with lift-off and set-down on a number of falls, None for that of the site;
    None if its load hangs at both ends, or for a reason of
    `cranedyn.lifts.planning.ground_lift.not_grounded`.
    """
    lift = certificate.lift
    site = lift.clearance.site
    ends = stands_at(site.start), stands_at(site.goal)
    if not any(ends) or not_grounded(lift, certified=certificate.holds):
        return None
    grounded = from_ground(lift, falls=falls, stands=ends)
    return GroundedLift(grounded, *certify_ground_lift(grounded))
