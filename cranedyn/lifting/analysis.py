"""One lift with all that is known of it: planned, certified, weighed against a chart, blown at, and
made many times not quite as planned.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from cranedyn.errors import OutOfRange
from cranedyn.lifting.chart import CUT_OUT, WARNING, Chart, CutOut, cut_outs, utilisation
from cranedyn.lifting.loads import Loads, loads
from cranedyn.model.crane import Crane
from cranedyn.planning.certificate import Certificate, Check, certify
from cranedyn.planning.lift import crane_of, plan_lift
from cranedyn.planning.perturbed import CONFIDENCE, Perturbed, Spread, perturb
from cranedyn.planning.site import Site
from cranedyn.lifting.wind_limit import WindLimit, wind_limit
from experiments import harness
from experiments.scenarios.moves import LIMITS


@dataclass(frozen=True)
class Asked:
    """What is asked of a lift.

    Attributes:
        wind: Gust that it must bear [m/s].
        swing: Largest angle of the rope from plumb in wind [rad].
        risk: Largest probability of coming nearer than required, when not quite as planned.
        lifts: How many are made that are not quite as planned.
        gusts: How many are made in each wind.
    """

    wind: float
    swing: float
    risk: float
    lifts: int
    gusts: int


@dataclass(frozen=True, eq=False)
class Case:
    """A lift and what was found.

    Attributes:
        site: Where.
        chart: Of the crane.
        falls: How many carry the hook.
        asked: What is asked of it.
        certificate: The plan, simulated and held against the site.
        carried: Its loads.
        used: Utilisation at each row; None where the chart does not reach.
        beyond: Why the chart does not reach; empty where it does.
        wind: What gusts do to it; None where the chart does not reach or the plan does not hold.
        perturbed: Lifts not quite as planned; None likewise.
        seconds: How long making these took [s].
    """

    site: Site
    chart: Chart
    falls: int
    asked: Asked
    certificate: Certificate
    carried: Loads
    used: np.ndarray | None
    beyond: str
    wind: WindLimit | None
    perturbed: Perturbed | None
    seconds: float

    @property
    def crane(self) -> Crane:
        """The crane."""
        return self.certificate.lift.crane

    @property
    def stops(self) -> list[CutOut]:
        """Where a load moment limiter would act."""
        return [] if self.used is None else cut_outs(self.carried.t, self.used)


def case(
    setup: harness.Setup,
    site: Site,
    chart: Chart,
    falls: int | None,
    asked: Asked,
    **values: Any,
) -> Case:
    """Make a lift and all that it is judged by.

    Args:
        setup: Gravity and clocks.
        site: Where.
        chart: Of the crane.
        falls: How many carry the hook; None for the fewest of the chart.
        asked: What is asked.
        values: Numbers of the crane that differ from those of the site, and its file as `urdf`.
    """
    on = chart.on(falls)
    crane = crane_of(site, gravity=setup.gravity, **setup.values, **values)
    lift = plan_lift(site, site.limits or LIMITS, crane=crane, period=setup.control_period)
    certificate = certify(lift, dt=setup.dt, engine=setup.engine)
    carried = loads(crane, certificate.run, base=site.base, arms=site.arms)
    used, beyond = None, ""
    try:
        used = utilisation(carried, chart, falls, gravity=crane.gravity)
    except OutOfRange as error:
        beyond = str(error)
    wind = perturbed = None
    begun = time.monotonic()
    if certificate.holds and asked.lifts:
        perturbed = perturb(certificate, asked.lifts, dt=2.0 * setup.dt)
    seconds = time.monotonic() - begun
    if certificate.holds and used is not None and asked.gusts:
        wind = wind_limit(
            certificate, chart, falls, swing=asked.swing, count=asked.gusts, dt=2.0 * setup.dt
        )
    return Case(
        site,
        chart,
        on.count,
        asked,
        certificate,
        carried,
        used,
        beyond,
        wind,
        perturbed,
        seconds,
    )


def checks(made: Case) -> list[Check]:
    """All that must hold for a lift to go, each in a sentence with its numbers."""
    return [
        *made.certificate.checks,
        *_entered(made),
        _chart(made),
        _heavier(made),
        _rope(made),
        _corners(made),
        _wind(made),
        _risk(made),
    ]


def _entered(made: Case) -> list[Check]:
    """Whether somebody entered what plan and proof rest on; a go rests on no default."""
    site, limits = made.site, made.certificate.lift.limits
    rates = (
        f"{math.degrees(limits.rates[0]):.2g} °/s, {limits.rates[1]:.2f} and "
        f"{limits.rates[2]:.2f} m/s at most"
    )
    counter_jib = site.crane.get("counter_jib")
    return [
        Check(f"The drives are as entered: {rates}.", True)
        if site.limits is not None
        else Check(f"Nobody entered what the drives can do ([drives]); assumed: {rates}.", None),
        Check(f"The counter-jib is as long as entered, {counter_jib:g} m.", True)
        if counter_jib
        else Check(
            "Nobody entered how long the counter-jib is ([counter_jib] length); it turns freely "
            "as long as it is drawn.",
            None,
        ),
    ]


def _heavier(made: Case) -> Check:
    more = Spread().load
    if made.used is None:
        return Check("What a heavier load would use of the chart is not known.", None)
    most = (1.0 + more) * float(made.used.max())
    return Check(
        f"A load {100.0 * more:.0f} % heavier than entered uses {100.0 * most:.1f} % of the chart; "
        f"a limiter cuts out at {100.0 * CUT_OUT:g} %.",
        most < CUT_OUT,
    )


def _chart(made: Case) -> Check:
    if made.used is None:
        return Check(f"The chart does not reach: {made.beyond}", False)
    most = float(made.used.max())
    at = float(made.carried.t[int(made.used.argmax())])
    stops = "no warning" if not made.stops else f"{made.stops[0].kind} at {made.stops[0].t:.1f} s"
    return Check(
        f"Utilisation is {100.0 * most:.1f} % of the chart at most, at t = {at:.1f} s; a limiter "
        f"warns at {100.0 * WARNING:g} % and cuts out at {100.0 * CUT_OUT:g} %: {stops}.",
        most < WARNING,
    )


def _rope(made: Case) -> Check:
    slack, snag = (float(made.carried[f"{one}_margin"].min()) for one in ("slack", "snag"))
    return Check(
        f"The rope stays taut: it carries {100.0 * slack:.0f} % of the weight at least; the hoist "
        f"has {100.0 * snag:.0f} % of its force left.",
        slack > 0.0 and snag > 0.0,
    )


def _corners(made: Case) -> Check:
    site = made.site
    if site.base is None or len(site.arms) < 2:
        missing = ["[base]"] * (site.base is None) + ["[jib]", "[counter_jib]"] * (
            len(site.arms) < 2
        )
        return Check(
            "Whether all corners of the base press on the ground is not known: nobody entered "
            f"masses and centres of {', '.join(missing)}.",
            None,
        )
    corners = np.stack([made.carried[f"corner_{i}_N"] for i in range(1, 5)])
    least, most, permitted = float(corners.min()), float(corners.max()), site.base.permitted
    bears = "" if permitted is None else f"; the ground may bear {permitted / 1e3:.0f} kN"
    return Check(
        f"All corners of the base press on the ground, by {least / 1e3:.0f} kN at least and "
        f"{most / 1e3:.0f} kN at most{bears}.",
        least > 0.0 and (permitted is None or most <= permitted),
    )


def _wind(made: Case) -> Check:
    if made.wind is None:
        return Check("The wind limit was not looked for.", made.asked.gusts == 0)
    limit, broken = made.wind.interval()
    found = f"not in one of {broken:g} m/s" if broken < math.inf else "none stronger was tried"
    return Check(
        f"Gusts up to {limit:g} m/s are borne, {found}; {made.asked.wind:g} asked for; "
        f"{made.wind.binding} is met first.",
        limit >= made.asked.wind,
    )


def _risk(made: Case) -> Check:
    if made.perturbed is None:
        return Check("Lifts not quite as planned were not made.", made.asked.lifts == 0)
    _, high = made.perturbed.interval()
    return Check(
        f"Of {len(made.perturbed.least)} lifts not quite as planned {made.perturbed.nearer} come "
        f"nearer than {made.site.distance:g} m: a probability of {100.0 * high:.2f} % at most, "
        f"with {100.0 * CONFIDENCE:g} % confidence; {100.0 * made.asked.risk:g} % allowed.",
        high <= made.asked.risk,
    )
