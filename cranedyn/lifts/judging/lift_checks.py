"""Checks of a lift. A new check or load case is one more function in `CHECKS`."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from cranedyn.assumptions import check_entered
from cranedyn.lifts.judging.analysis import LiftAnalysis
from cranedyn.lifts.judging.chart import CUT_OUT, WARNING
from cranedyn.lifts.judging.lift_positions import interpolation
from cranedyn.lifts.judging.load_joints import LoadJoints
from cranedyn.lifts.judging.plan_checks import (
    JIB_TOLERANCE,
    corner_range,
    plan_checks,
    wind_text,
)
from cranedyn.lifts.planning.crane_bodies import corners_of
from cranedyn.lifts.planning.ground_lift import not_grounded, stands_at
from cranedyn.lifts.planning.perturbed import CONFIDENCE
from cranedyn.lifts.planning.plan_assumptions import (
    EARTH_GRAVITY,
    in_words,
    rates_text,
    shipped_masses,
)
from cranedyn.lifts.planning.tower_clearance import TowerClearance
from cranedyn.verdict import Check

CheckFunction = Callable[[LiftAnalysis], Check]
"""A check: from what was computed of a lift to a sentence with its numbers and a verdict. It is not
judged where what decides it was not entered or not computed."""


def run_checks(
    analysis: LiftAnalysis, functions: Sequence[CheckFunction] | None = None
) -> list[Check]:
    """Return the checks of the certificate, of lift-off and set-down, then those of functions, by
    default `CHECKS`, and at last those of what the site enters for its lift plan. Where some of
    `CHECKS` are not among the functions, that is not judged.
    """
    functions = CHECKS if functions is None else functions
    checks = [*analysis.certificate.checks, *_ground_checks(analysis)]
    left_out = [function.__name__ for function in CHECKS if function not in functions]
    if left_out:
        names = ", ".join(name.replace("_", " ") for name in left_out)
        checks.append(Check(f"Checks were left out: {names}.", None))
    checks += [_named_check(function, analysis) for function in functions]
    return checks + plan_checks(analysis)


def _named_check(function: CheckFunction, analysis: LiftAnalysis) -> Check:
    """Return the check of a function under the function's name, by which a plan records it."""
    check = function(analysis)
    return Check(check.sentence, check.verdict, getattr(function, "__name__", ""))


def _ground_checks(analysis: LiftAnalysis) -> Sequence[Check]:
    """Return the checks of lift-off and set-down, none where the load hangs at both ends."""
    site = analysis.site
    if analysis.grounded is not None:
        # Those of what stands are made of the planned motion and of the run from the ground alike.
        of_motion = analysis.certificate.checks
        return [check for check in analysis.grounded.checks if check not in of_motion]
    if not (stands_at(site.start) or stands_at(site.goal)):
        return ()
    certificate = analysis.certificate
    why = not_grounded(certificate.lift, certified=certificate.holds)
    return [Check(f"Lift-off and set-down were not simulated: {why}.", None)]


def assumptions_entered(analysis: LiftAnalysis) -> Check:
    """Check that nothing that the judgement rests on is a default of this program."""
    return check_entered(analysis.inputs.assumptions)


def gravity_is_that_of_the_earth(analysis: LiftAnalysis) -> Check:
    """Check that the lift was computed in the gravity in which it will be made."""
    gravity = analysis.crane.gravity
    if EARTH_GRAVITY[0] <= gravity <= EARTH_GRAVITY[1]:
        return Check(f"The lift is computed in a gravity of {gravity:g} m/s².", True)
    return Check(
        f"The lift is computed in a gravity of {gravity:g} m/s²; on the ground it is "
        f"{EARTH_GRAVITY[0]:g} to {EARTH_GRAVITY[1]:g}.",
        None,
    )


def drives_entered(analysis: LiftAnalysis) -> Check:
    """Check that the limits of the drives were entered, since a go rests on no default."""
    planned = analysis.certificate.lift.limits.rates
    rates = f"{rates_text(analysis.crane, planned)} at most"
    entered = analysis.site.limits
    if entered is None:
        return Check(f"[drives] of the site is missing; assumed: {rates}.", None)
    if np.allclose(planned, entered.rates, rtol=1e-9):
        return Check(f"The drives are as entered: {rates}.", True)
    # Of the crane's own rates a plan leaves a part to the controller, see `plan_lift`.
    return Check(
        f"The drives were entered, and are planned with less than that, so that the crane's own "
        f"rates leave a reserve for corrections: {rates}.",
        True,
    )


def counter_jib_entered(analysis: LiftAnalysis) -> Check:
    """Check that the length of the counter-jib was entered. Another crane than a tower crane is
    compared as its description draws it.
    """
    clearance = analysis.certificate.lift.clearance
    if not isinstance(clearance, TowerClearance) or not analysis.site.is_tower:
        return Check(
            "Every part of the crane that moves is compared as its description draws it: "
            f"{', '.join(clearance.parts.moving)}.",
            None if clearance.parts.undrawn else True,
        )
    arguments = analysis.crane.record.get("arguments")
    length = analysis.site.crane.get("counter_jib")
    if length and isinstance(arguments, dict) and arguments.get("counter_jib") != length:
        return Check(
            f"The site enters a counter-jib of {length:g} m, and the judged crane has another.",
            None,
        )
    if length and not isinstance(arguments, dict):
        # A description without arguments: what keeps its distance is what its shapes show. The jib
        # points along -Y at zero slew, so that the counter-jib ends at the largest Y.
        upper = clearance.bodies.upper
        drawn = max(float(corners_of(shape)[:, 1].max()) for shape in upper)
        return Check(
            f"The counter-jib of the crane's description reaches {drawn:.2f} m behind the slew "
            f"axis; {length:g} m entered, which may be at most {JIB_TOLERANCE:g} m longer "
            "than drawn.",
            drawn >= length - JIB_TOLERANCE,
        )
    if length:
        return Check(f"The counter-jib is as long as entered, {length:g} m.", True)
    return Check(
        "[counter_jib] length of the site is missing; it turns freely with the length drawn.", None
    )


def utilisation_below_warning(analysis: LiftAnalysis) -> Check:
    """Check that no more of the chart is used than the site allows, or, where it says nothing, that
    a load moment limiter gives no warning.
    """
    if analysis.chart is None:
        return Check(
            "Utilisation: no load chart of this crane was entered, and another crane's says "
            "nothing of it.",
            None,
        )
    if not analysis.chart_covers:
        return Check(f"The chart says nothing about this lift: {analysis.chart_error}", None)
    if analysis.utilisation is None:
        return Check(f"The chart does not reach: {analysis.chart_error}", False)
    highest = float(analysis.utilisation.max())
    of_site = analysis.site.details.limits.chart_share
    limit = "" if of_site is None else f"{100.0 * of_site:g} % allowed on this site; "
    row = int(analysis.utilisation.argmax())
    t = float(analysis.loads.t[row])
    between = ""
    if "radius_m" in analysis.loads.values:
        between = interpolation(analysis, float(analysis.loads["radius_m"][row]))
    of_chart = f"the chart, interpolated {between}," if between else "the chart"
    return Check(
        f"Utilisation is {100.0 * highest:.1f} % of {of_chart} at most, at t = {t:.1f} s; {limit}a "
        f"limiter warns at {100.0 * WARNING:g} % and cuts out at {100.0 * CUT_OUT:g} %: "
        f"{_first_act(analysis)}.",
        highest < chart_share(analysis),
    )


def chart_share(analysis: LiftAnalysis) -> float:
    """Return the share of the rated load that may be used: that of the site, or else the one at
    which a load moment limiter warns.
    """
    of_site = analysis.site.details.limits.chart_share
    return WARNING if of_site is None else of_site


def _first_act(analysis: LiftAnalysis) -> str:
    """Return what a limiter does first, in words: its first cut-out, since that stops the lift, or
    else its first warning.
    """
    for kind in ("cut-out", "warning"):
        for interval in analysis.cut_outs:
            if interval.kind == kind:
                return f"{kind} at {interval.t:.1f} s"
    return "no warning"


def heavier_load(analysis: LiftAnalysis) -> Check:
    """Check that the chart bears a load heavier by the tolerance of its mass."""
    spread = analysis.inputs.spread.load
    if analysis.utilisation is None:
        return Check("The utilisation by a heavier load is not known.", None)
    utilisation = (1.0 + spread) * float(analysis.utilisation.max())
    return Check(
        f"A load {100.0 * spread:.3g} % heavier than entered uses {100.0 * utilisation:.1f} % of "
        f"the chart; a limiter cuts out at {100.0 * CUT_OUT:g} %.",
        utilisation < CUT_OUT,
    )


def taut_rope_and_strong_hoist(analysis: LiftAnalysis) -> Check:
    """Check that the rope stays taut while the load hangs, and that the hoist is strong enough for
    a load heavier by the tolerance of its mass.
    """
    slack = float(analysis.loads["slack_margin"][analysis.hangs].min())
    heavier = 1.0 + analysis.inputs.spread.load
    # The hoist uses the share 1 - snag_margin of its force, which grows with the load.
    snag = 1.0 - heavier * (1.0 - float(analysis.loads["snag_margin"].min()))
    return Check(
        f"The rope stays taut: it carries {100.0 * slack:.0f} % of the weight at least; the hoist "
        f"has {100.0 * snag:.0f} % of its force left with a load heavier by its tolerance.",
        slack > 0.0 and snag > 0.0,
    )


def corners_pressed(analysis: LiftAnalysis) -> Check:
    """Check that all corners of the base press on the ground, and no more than it may bear; of a
    crane that travels on rails, that its wheels do.
    """
    site = analysis.site
    if LoadJoints.of(analysis.crane).travel is not None:
        return _wheels_pressed(analysis)
    if "radius_m" not in analysis.loads.values:
        return Check("What the crane stands on is not judged: it neither slews nor travels.", None)
    missing = []
    if site.base is None:
        missing.append("[base]")
    # The description of another crane has the masses of its boom and counterweight.
    is_tower = analysis.site.is_tower
    if is_tower and not any(arm.centre >= 0.0 for arm in site.arms):
        missing.append("[jib]")
    if is_tower and not any(arm.centre <= 0.0 for arm in site.arms):
        missing.append("[counter_jib]")
    if site.base is None or missing:
        return Check(
            f"{', '.join(missing)} of the site missing: corner forces of the base are not known.",
            None,
        )
    permitted = site.base.permitted
    corners = corner_range(analysis)
    assert corners is not None  # the base is known, and a crane that slews has a radius
    smallest, largest = corners
    presses = (
        f"All corners of the base press on the ground, by {smallest / 1e3:.0f} kN at least and "
        f"{largest / 1e3:.0f} kN at most, with a load heavier by its tolerance and without wind on "
        "the crane"
    )
    if permitted is None and site.details.ground.permitted_pressure is not None:
        return Check(f"{presses}; what the ground bears is judged by its pressure.", smallest > 0.0)
    if permitted is None:
        # Pressing is not enough: whether the ground bears it is not known.
        unknown = "; [base] permitted is missing, what the ground may bear"
        return Check(f"{presses}{unknown}.", None if smallest > 0.0 else False)
    return Check(
        f"{presses}; the ground may bear {permitted / 1e3:.0f} kN.",
        0.0 < smallest and largest <= permitted,
    )


def _wheels_pressed(analysis: LiftAnalysis) -> Check:
    """Check that all wheels press on their rails, and no more than these may bear."""
    runway = analysis.site.runway
    if runway is None:
        return Check("[runway] of the site is missing: the wheel loads are not known.", None)
    shipped = shipped_masses(analysis.site)
    if shipped:
        return Check(
            "The wheel loads are not judged: they would be those of a crane as it is shipped with "
            f"this program, {in_words(shipped)}. Enter these masses of yours in [crane.values].",
            None,
        )
    heavier = analysis.inputs.spread.load
    smallest = math.inf
    largest = -math.inf
    for i in range(1, 5):
        force = analysis.loads[f"wheel_{i}_N"]
        added = heavier * analysis.loads[f"wheel_{i}_load_N"]
        smallest = min(smallest, float((force + np.minimum(added, 0.0)).min()))
        largest = max(largest, float((force + np.maximum(added, 0.0)).max()))
    presses = (
        f"All wheels press on their rails, by {smallest / 1e3:.0f} kN at least and "
        f"{largest / 1e3:.0f} kN at most, with a load heavier by its tolerance"
    )
    if runway.permitted is None:
        unknown = "; [runway] permitted is missing, what a rail may bear"
        return Check(f"{presses}{unknown}.", None if smallest > 0.0 else False)
    return Check(
        f"{presses}; a rail may bear {runway.permitted / 1e3:.0f} kN of a wheel.",
        0.0 < smallest and largest <= runway.permitted,
    )


def wind_borne(analysis: LiftAnalysis) -> Check:
    """Check that the lift bears the required gust."""
    required = analysis.requirements
    if analysis.wind is None:
        if not required.gusts:
            reason = "no gusts were asked for"
        elif not analysis.certificate.holds:
            reason = "the plan has no certificate"
        else:
            reason = "it needs a load chart that reaches"
        return Check(f"The wind limit was not computed: {reason}.", None)
    assert required.wind is not None  # see `cranedyn.lifts.judging.judged_inputs`
    limit, broken = analysis.wind.interval()
    beyond = f"not {broken:g} m/s" if broken < math.inf else "none stronger was tried"
    first = analysis.wind.binding
    first_limit = "No limit is exceeded" if first is None else f"The first limit is {first}"
    nearest = analysis.wind.nearest
    if first == "clearance" and nearest is not None:
        first_limit += f", between {nearest.body} and {nearest.obstacle}"
    holds: bool | None = limit >= required.wind
    if not holds and broken == math.inf:
        holds = None  # the strongest gust that was tried is weaker than the one required
    return Check(
        f"The lift bears gusts up to {wind_text(limit)}, {beyond}; {required.wind:g} m/s required. "
        f"{first_limit}.",
        holds,
    )


def perturbed_lifts(analysis: LiftAnalysis) -> Check:
    """Check the probability that a perturbed lift comes too close or breaks off."""
    required = analysis.requirements
    perturbed = analysis.perturbed
    if perturbed is None:
        reason = "the plan has no certificate" if required.lifts else "none were asked for"
        return Check(f"No perturbed lifts were simulated: {reason}.", None)
    assert required.risk is not None  # see `cranedyn.lifts.judging.judged_inputs`
    _, high = perturbed.interval()
    needed = ""
    if perturbed.failures == 0 and high > required.risk > 0.0:
        # Clopper and Pearson's bound of no failure among n is 1 - (α/2)^(1/n).
        least = math.ceil(math.log(0.5 * (1.0 - CONFIDENCE)) / math.log1p(-required.risk))
        needed = f" That none fails shows so little of so few; it takes {least}."
    return Check(
        f"Of {len(perturbed.least)} perturbed lifts {perturbed.failures - perturbed.broken_off} "
        f"come nearer than {analysis.site.distance:g} m, and {perturbed.broken_off} take a drive "
        f"out of its range or slacken the rope: a probability of {100.0 * high:.2f} % at most, "
        f"with {100.0 * CONFIDENCE:g} % confidence; {100.0 * required.risk:g} % "
        f"allowed.{needed}",
        high <= required.risk,
    )


CHECKS: tuple[CheckFunction, ...] = (
    assumptions_entered,
    gravity_is_that_of_the_earth,
    drives_entered,
    counter_jib_entered,
    utilisation_below_warning,
    heavier_load,
    taut_rope_and_strong_hoist,
    corners_pressed,
    wind_borne,
    perturbed_lifts,
)
"""The checks of a lift beside those of its certificate, in the order of the report."""
