"""Everything that a lift is judged by: what is required of it, and what was computed of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cranedyn.checks import number, whole
from cranedyn.lifting.chart import Chart, CutOut, cut_outs
from cranedyn.lifting.factors import DriveClass, HoistingClass
from cranedyn.lifting.loads import Loads
from cranedyn.lifting.wind_limit import WindLimit
from cranedyn.model.crane import Crane
from cranedyn.planning.certificate import Certificate
from cranedyn.planning.perturbed import Perturbed
from cranedyn.planning.site import Site


@dataclass(frozen=True)
class Requirements:
    """Requirements on a lift; the defaults are this project's own.

    Attributes:
        wind: Gust that the lift must bear [m/s].
        swing: Largest angle of the rope from plumb in wind [rad].
        risk: Largest probability that a perturbed lift comes closer than the required distance.
        lifts: Number of perturbed lifts; 0 for none.
        gusts: Number of gusts drawn at each wind speed; 0 for none.

    Raises:
        OutOfRange: If a number is negative, or the risk more than 1.
    """

    wind: float = 8.0
    swing: float = math.radians(5.0)
    risk: float = 0.01
    lifts: int = 10_000
    gusts: int = 32

    def __post_init__(self) -> None:
        """Check the numbers."""
        number("wind asked for", self.wind, "m/s", ">= 0")
        number("swing allowed", self.swing, "rad", "> 0")
        number("risk allowed", self.risk, "", "0 to 1")
        whole("lifts", self.lifts, 0)
        whole("gusts", self.gusts, 0)


DEFAULT_REQUIREMENTS = Requirements()


@dataclass(frozen=True, eq=False)
class LiftAnalysis:
    """A lift with everything that was computed of it.

    Attributes:
        site: The site of the lift.
        chart: Load chart of the crane.
        falls: Number of falls that carry the hook.
        requirements: Requirements on the lift.
        certificate: The planned lift, simulated and checked against the site.
        loads: Loads of the simulated run.
        utilisation: Utilisation of the chart in each row; None where the chart does not reach.
        chart_error: Why the chart does not reach; empty where it does.
        wind: Wind limit; None if the chart does not reach, the plan does not hold, or no gusts were
            required.
        perturbed: Perturbed lifts; None if the plan does not hold or none were required.
        hoisting: Hoisting class of the crane.
        drive: Class of its hoist drive.
    """

    site: Site
    chart: Chart
    falls: int
    requirements: Requirements
    certificate: Certificate
    loads: Loads
    utilisation: np.ndarray | None
    chart_error: str
    wind: WindLimit | None
    perturbed: Perturbed | None
    hoisting: HoistingClass = "HC2"
    drive: DriveClass = "HD4"

    @property
    def crane(self) -> Crane:
        """The crane."""
        return self.certificate.lift.crane

    @property
    def cut_outs(self) -> list[CutOut]:
        """Intervals in which a load moment limiter would act."""
        return [] if self.utilisation is None else cut_outs(self.loads.t, self.utilisation)
