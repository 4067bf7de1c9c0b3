"""What is judged of a shift: its plan, and where its loads are in a simulation of it."""

from __future__ import annotations

import numpy as np

from cranedyn.errors import quoted
from cranedyn.lifts.sites.brakes import CYCLE
from cranedyn.lifts.sites.shift_plan import PlannedLift, ShiftPlan
from cranedyn.lifts.sites.site_simulation import SiteRun
from cranedyn.verdict import Check

# Operators correct a deviation from the plan with a gain of 0.3/s while the load is hooked on, and
# the plan leaves no swing; 3 mrad of swing on 50 m of rope are 0.15 m.
GOAL_TOLERANCE = 0.2
"""Largest distance of a load from its place when it is hooked on or unhooked [m]."""


def shift_checks(shift: ShiftPlan, run: SiteRun | None) -> list[Check]:
    """Return what is judged of a shift, a sentence each.

    Args:
        shift: The plan.
        run: A run in which the cranes follow the plan; None if there is none.
    """
    checks = [Check(refusal, False) for refusal in shift.refusals]
    count = len(shift.lifts)
    if not count:
        return [*checks, Check("No lift is planned.", False)]
    checks.append(Check(f"{count} of {count + len(shift.refusals)} lifts are planned.", True))
    distance = f"{shift.plan.site.distance:g} m"
    sentence = f"The plan is proven to keep all cranes {distance} apart at all times."
    checks.append(Check(sentence, shift.plan.holds))
    checks.append(_chart_check(shift))
    if run is not None:
        checks.append(_arrival_check(shift, run))
    return checks


def _chart_check(shift: ShiftPlan) -> Check:
    """Return whether each load is within the chart of its crane. A plan keeps to the charts that
    there are, so that a load without a chart is not judged.
    """
    carrying = {planned.crane for planned in shift.lifts}
    without = []
    for station in shift.plan.site.stations:
        if station.name in carrying and station.chart is None:
            without.append(quoted(station.name))
    if without:
        sentence = f"Loads within load charts: no chart is entered for {', '.join(without)}."
        return Check(sentence, None)
    return Check("Each load is within the chart of its crane on its whole way.", True)


def _arrival_check(shift: ShiftPlan, run: SiteRun) -> Check:
    """Return whether all loads are where the list says when they are hooked on and unhooked."""
    farthest = max(_miss(planned, run) for planned in shift.lifts)
    sentence = (
        f"Simulated, hooks are within {farthest:.2f} m of their places when loads are hooked on "
        f"and unhooked, allowed {GOAL_TOLERANCE:g} m."
    )
    return Check(sentence, farthest <= GOAL_TOLERANCE)


def _miss(planned: PlannedLift, run: SiteRun) -> float:
    """Return the larger distance of a load from its start and its goal at the end of the time in
    which it is hooked on or unhooked [m]; infinite if the run ends before.
    """
    i = run.site.index_of(planned.crane)
    station = run.site.stations[i]
    crane = station.crane
    distances = []
    for time, place in ((planned.off, planned.lift.start), (planned.end, planned.lift.goal)):
        row = int(time / CYCLE)
        if row >= len(run.t):
            return np.inf
        q = run.trajectories[i].q[row : row + 1]
        rope = station.rope(q)
        cable = q[:, crane.layout.drives[crane.winch]]
        load = rope.pivot[0] + cable * rope.direction[0]
        distances.append(float(np.linalg.norm(load - place)))
    return max(distances)
