"""Everything that a lift is judged by: what is required of it, and what was computed of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cranedyn.assumptions import Assumption
from cranedyn.checks import number, whole, within
from cranedyn.data.trajectory import Trajectory
from cranedyn.lifts.judging.chart import Chart, CutOut, cut_outs
from cranedyn.lifts.judging.factors import DriveClass, HoistingClass
from cranedyn.lifts.judging.loads import Loads
from cranedyn.lifts.judging.wind_limit import WindLimit
from cranedyn.lifts.planning.certificate import Certificate
from cranedyn.lifts.planning.ground_lift import GroundLift
from cranedyn.lifts.planning.perturbed import Perturbed, Spread
from cranedyn.lifts.planning.plausibility import WIND
from cranedyn.lifts.planning.site import Site
from cranedyn.model.crane import Crane
from cranedyn.verdict import Check


@dataclass(frozen=True)
class Requirements:
    """Requirements on a lift.

    A requirement that is None is that of the site. Where the site has none, either, the lift is
    computed with a default, see `cranedyn.lifts.judging.judged_inputs`, and the judgement is not
    complete.

    Attributes:
        wind: Gust that the lift must bear [m/s].
        swing: Largest angle of the rope from plumb in wind [rad].
        risk: Largest probability that a perturbed lift comes closer than the required distance.
        lifts: Number of perturbed lifts; 0 for none, then the risk is not judged.
        gusts: Number of gusts drawn at the wind limit, beside those that are always tried; 0 for
            no gusts at all, then the wind is not judged.

    Raises:
        OutOfRange: If the wind is not from 0 to 100 m/s, the swing not from 1e-6 to π/2, the risk
            not from 0 to 1, or a number of lifts or gusts not a whole number from 0 on.
    """

    wind: float | None = None
    swing: float | None = None
    risk: float | None = None
    lifts: int = 10_000
    gusts: int = 32

    def __post_init__(self) -> None:
        """Check the numbers."""
        if self.wind is not None:
            within("wind asked for", self.wind, *WIND.possible, "m/s")
        if self.swing is not None:
            within("swing allowed", self.swing, 1e-6, math.pi / 2.0, "rad")
        if self.risk is not None:
            number("risk allowed", self.risk, "", "0 to 1")
        whole("lifts", self.lifts, 0)
        whole("gusts", self.gusts, 0)


DEFAULT_REQUIREMENTS = Requirements()


@dataclass(frozen=True, eq=False)
class GroundedLift:
    """A lift with lift-off and set-down.

    Attributes:
        lift: The lift from the ground or to it.
        run: Its simulated run.
        checks: The checks of its phases.
    """

    lift: GroundLift
    run: Trajectory
    checks: Sequence[Check]


@dataclass(frozen=True)
class JudgedInputs:
    """Values that a lift is judged with, see `cranedyn.lifts.judging.judged_inputs.resolve_inputs`.

    Attributes:
        requirements: Requirements with a number for each.
        spread: How far lifts may differ from the plan.
        chart: Load chart; None if none of this crane was entered.
        falls: Number of falls that carry the hook; None without a chart.
        assumptions: All that the judgement rests on, each with its origin.
    """

    requirements: Requirements
    spread: Spread
    chart: Chart | None
    falls: int | None
    assumptions: tuple[Assumption, ...]


@dataclass(frozen=True, eq=False)
class LiftAnalysis:
    """A lift with everything that was computed of it.

    Attributes:
        site: The site of the lift.
        inputs: What the lift is judged with: requirements, tolerances, chart, falls.
        certificate: The planned lift, simulated and checked against the site.
        loads: Loads of the simulated run, from lift-off to set-down where these are in it.
        utilisation: Utilisation of the chart in each row; None without a chart or where it does not
            reach.
        chart_error: Why the chart does not reach; empty where it does.
        chart_covers: Whether the chart is for this crane as it stands, and for the boom and the
            radii of the lift. If not, nothing follows from it; if it is and does not reach, the
            lift is not permitted.
        wind: Wind limit; None if there is no chart or it does not reach, the plan does not hold, or
            no gusts were asked for.
        perturbed: Perturbed lifts; None if the plan does not hold or none were asked for.
        grounded: The lift with lift-off and set-down; None if the load hangs at both ends, or the
            plan has no certificate.
        unusual: Sentences about entered values that are unusual.
        hoisting: Hoisting class of the crane.
        drive: Class of its hoist drive.
    """

    site: Site
    inputs: JudgedInputs
    certificate: Certificate
    loads: Loads
    utilisation: np.ndarray | None
    chart_error: str
    wind: WindLimit | None
    perturbed: Perturbed | None
    grounded: GroundedLift | None = None
    unusual: tuple[str, ...] = ()
    chart_covers: bool = True
    hoisting: HoistingClass = "HC2"
    drive: DriveClass = "HD4"

    @property
    def requirements(self) -> Requirements:
        """The requirements, each with a number."""
        return self.inputs.requirements

    @property
    def chart(self) -> Chart | None:
        """Load chart of the crane; None if there is none."""
        return self.inputs.chart

    @property
    def run(self) -> Trajectory:
        """The simulated run, from lift-off to set-down where these are in it."""
        return self.certificate.run if self.grounded is None else self.grounded.run

    @property
    def run_crane(self) -> Crane:
        """The crane of that run; its rope stretches where the load stands on the ground."""
        return self.crane if self.grounded is None else self.grounded.lift.crane

    @property
    def duration(self) -> float:
        """Time of the whole lift [s], lift-off and set-down included where these are in it."""
        if self.grounded is not None:
            return self.grounded.lift.motion.arrival
        return self.certificate.lift.timed.motion.arrival

    @property
    def hangs(self) -> slice:
        """The rows of that run in which the load hangs: those of the planned motion."""
        if self.grounded is None:
            return slice(None)
        period = self.grounded.lift.motion.period
        phases = self.grounded.lift.phases
        set_down = phases.get("set-down")
        last = None if set_down is None else round(set_down / period)
        return slice(round(phases["motion"] / period), last)

    @property
    def crane(self) -> Crane:
        """The crane."""
        return self.certificate.lift.crane

    @property
    def cut_outs(self) -> list[CutOut]:
        """Intervals in which a load moment limiter would act."""
        return [] if self.utilisation is None else cut_outs(self.loads.t, self.utilisation)
