"""Judge a lift: plan, certify and simulate it, check all that is required, report GO or NO GO."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from cranedyn.errors import CraneError, OutOfRange
from cranedyn.interfaces import EngineName
from cranedyn.lifting import page
from cranedyn.lifting.analysis import DEFAULT_REQUIREMENTS, LiftAnalysis, Requirements
from cranedyn.lifting.chart import Chart, utilisation
from cranedyn.lifting.checks import CheckFunction, run_checks
from cranedyn.lifting.factors import DriveClass, HoistingClass
from cranedyn.lifting.figures import LiftFigure, figures
from cranedyn.lifting.loads import loads
from cranedyn.lifting.tables import Table, tables
from cranedyn.lifting.wind_limit import wind_limit
from cranedyn.model.crane import Crane
from cranedyn.planning.certificate import certify
from cranedyn.planning.lift import crane_of, plan_lift
from cranedyn.planning.perturbed import perturb
from cranedyn.planning.site import Site
from cranedyn.references.limits import Limits
from cranedyn.verdict import Check


@dataclass(frozen=True, eq=False)
class Judgement:
    """A lift and whether it may go.

    Attributes:
        analysis: Everything that was computed of the lift.
        checks: Sentences with their numbers, each with whether it holds, or None where it could not
            be judged.
    """

    analysis: LiftAnalysis
    checks: Sequence[Check]

    @property
    def go(self) -> bool:
        """Whether every check holds; one that could not be judged does not."""
        return not self.reasons

    @property
    def reasons(self) -> list[str]:
        """Sentences of the checks that do not hold or could not be judged: why it is NO GO."""
        return [check.sentence for check in self.checks if check.holds is not True]

    @cached_property
    def figures(self) -> dict[str, LiftFigure]:
        """Figures of the lift by name, each with a caption."""
        return figures(self.analysis)

    def tables(self, command: str = "") -> list[Table]:
        """Return the tables of the lift, whose notes name the command that makes them again."""
        return tables(self.analysis, command)

    def html(self, command: str = "") -> str:
        """Return the report as one HTML document that needs no other file and names the command
        that makes it again.
        """
        figures, title = [*self.figures.values()], f"Lift: {self.analysis.site.name}"
        return page.lift_html(title, self.checks, self.tables(command), figures, command)

    def report(self, path: str | Path, command: str = "") -> Path:
        """Write `html` as a ``.html`` or ``.pdf`` file, see `cranedyn.lifting.page.write_html`."""
        return page.write_html(path, self.html(command))


def judge(
    site: Site,
    chart: Chart,
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

    Args:
        site: The site with the start and goal of the lift.
        chart: Load chart of the crane.
        requirements: Requirements on the lift.
        falls: Number of falls that carry the hook; None for the fewest of the chart.
        crane: The crane; None for that of the site.
        limits: Rates and accelerations of the drives where the site enters none; the lift is then
            NO GO, since a go rests on what was entered.
        hoisting: Hoisting class of the crane.
        drive: Class of its hoist drive.
        checks: Checks beside those of the certificate; None for `cranedyn.lifting.checks.CHECKS`.
        period: Control period [s].
        dt: Physics step [s]; twice as much in perturbed lifts and in wind.
        engine: Engine of the certificate's simulation.
        progress: Called after each of three stages: plan, perturbed lifts, wind.

    Raises:
        NoWay: If no way is found for the lift.
        UnknownName: If the chart has no such number of falls.
        RunError: If the simulation breaks off.
        CraneError: If neither the site nor `limits` gives limits of the drives, as
            `cranedyn.planning.lift.plan_lift`, or an extra is not installed.
    """
    limits = site.limits or limits
    if limits is None:
        raise CraneError("The site does not say what its drives can do ([drives]); give limits.")
    reeving = chart.on(falls)
    crane = crane_of(site) if crane is None else crane
    certificate = certify(plan_lift(site, limits, crane=crane, period=period), dt=dt, engine=engine)
    progress(1)
    run_loads = loads(crane, certificate.run, base=site.base, arms=site.arms)
    used, chart_error = None, ""
    try:
        used = utilisation(run_loads, chart, falls, gravity=crane.gravity)
    except OutOfRange as error:
        chart_error = str(error)
    wind = perturbed = None
    if certificate.holds and requirements.lifts:
        perturbed = perturb(certificate, requirements.lifts, dt=2.0 * dt)
    progress(2)
    if certificate.holds and used is not None and requirements.gusts:
        swing, count = requirements.swing, requirements.gusts
        wind = wind_limit(certificate, chart, falls, swing=swing, count=count, dt=2.0 * dt)
    progress(3)
    analysis = LiftAnalysis(
        site=site,
        chart=chart,
        falls=reeving.count,
        requirements=requirements,
        certificate=certificate,
        loads=run_loads,
        utilisation=used,
        chart_error=chart_error,
        wind=wind,
        perturbed=perturbed,
        hoisting=hoisting,
        drive=drive,
    )
    return Judgement(analysis, run_checks(analysis, checks))
