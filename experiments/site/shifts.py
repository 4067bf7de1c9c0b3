"""Shifts on a site: the cranes lift loads for a while, protected in one way or another."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cranedyn.lifts.sites.brakes import CYCLE
from cranedyn.lifts.sites.crane_site import CraneSite
from cranedyn.lifts.sites.lift_list import HOOKING_TIME
from cranedyn.lifts.sites.operators import LiftOperator
from cranedyn.lifts.sites.plan import SitePlan, plan_site
from cranedyn.lifts.sites.site_simulation import SiteRun, simulate_site
from cranedyn.lifts.sites.zones import static_zones
from experiments.site.real_shapes import RealDistances, real_distances

PROTECTIONS = ("none", "zones", "supervisor", "plan")
"""What protects the cranes of a shift: nothing, static zones, the supervisor, or a common plan."""

MIN_LOAD_HEIGHT = 4.0
"""Least height above ground of the centre of a load where a plan puts it [m]."""


class Shift(NamedTuple):
    """A shift on a site.

    Attributes:
        site: Name of the site.
        protection: What protects the cranes, one of `PROTECTIONS`.
        run: Its run.
        operators: Its operators. Where cranes follow a plan, they drew the lifts in it.
        listed: Number of lifts on the list of each crane: those that it does without protection.
        real: Distances by the shapes of the cranes. They know nothing of the capsules by which the
            cranes are kept apart and contacts are counted.
        plan: The plan that the cranes follow; None if operators lift.
        planning: Processor time of the plan for each lift in it [s].
    """

    site: str
    protection: str
    run: SiteRun
    operators: list[LiftOperator]
    listed: list[int]
    real: RealDistances
    plan: SitePlan | None = None
    planning: float = 0.0

    @property
    def done(self) -> int:
        """Number of lifts on the lists that are done."""
        count = 0
        for operator, listed in zip(self.operators, self.listed, strict=True):
            count += sum(number <= listed for number in operator.finished)
        return count

    @property
    def lost(self) -> float:
        """Share of planned lifts left undone in the shift [%]."""
        return 100.0 * (1.0 - self.done / max(sum(self.listed), 1))

    @property
    def crane_minutes(self) -> float:
        """Time of all cranes together [min]."""
        return len(self.operators) * self.run.t[-1] / 60.0


def shifts_on(site: CraneSite, duration: float) -> list[Shift]:
    """Return a shift of a duration [s] under each protection, in the order of `PROTECTIONS`."""
    results: list[Shift] = []
    listed: list[int] = []
    crane_count = len(site.stations)
    for protection in ("none", "zones", "supervisor"):
        zones: Sequence[np.ndarray | None] = [None] * crane_count
        if protection == "zones":
            zones = static_zones(site)
        operators = [LiftOperator(site, i, _place_seed(i), zones[i]) for i in range(crane_count)]
        run = simulate_site(
            site, operators, duration=duration, supervised=protection == "supervisor"
        )
        if protection == "none":
            listed = [len(operator.finished) for operator in operators]
        results.append(Shift(site.name, protection, run, operators, listed, real_distances(run)))
    return [*results, planned_shift(site, duration, listed)]


def _place_seed(index: int) -> int:
    """Return the seed of the places of a crane: the same in all shifts, so that lists are."""
    return 100 + index


def planned_shift(site: CraneSite, duration: float, listed: list[int]) -> Shift:
    """Return a shift in which all cranes follow one plan of the lists, without a supervisor.

    Args:
        site: The site.
        duration: Duration of the shift [s].
        listed: Number of lifts on the list of each crane.
    """
    operators = [LiftOperator(site, i, _place_seed(i)) for i in range(len(site.stations))]
    lifts = []
    for operator in operators:
        for point in _load_points(site, operator, duration):
            lifts.append((operator.station.name, point))

    begin = time.process_time()
    plan = plan_site(site, lifts, stay=HOOKING_TIME, until=duration, strict=False)
    planning = time.process_time() - begin
    planned_count = sum(bool(motion.lift) for motion in plan.lifts) / 2.0

    run = simulate_site(site, plan.operators(), duration=duration, supervised=False)
    arrived = _arrivals(plan, run, operators)
    for i, operator in enumerate(operators):
        # The plan numbers the places of a crane from 1: lift n leads from place 2 n - 1 to 2 n.
        for n in range(1, operator.drawn + 1):
            if {(i, 2 * n - 1), (i, 2 * n)} <= arrived:
                operator.finished.append(n)
    return Shift(
        site=site.name,
        protection="plan",
        run=run,
        operators=operators,
        listed=listed,
        real=real_distances(run),
        plan=plan,
        planning=planning / max(planned_count, 1.0),
    )


def _load_points(site: CraneSite, operator: LiftOperator, duration: float) -> list[np.ndarray]:
    """Return the places of a crane's lifts in turn, as points of the load [m], shape (3,) each.

    There are more than fit into the duration [s]: a lift takes at least the time to hook and to
    unhook its load.
    """
    lowest = [-np.inf, -np.inf, site.ground + MIN_LOAD_HEIGHT]
    points: list[np.ndarray] = []
    for _ in range(math.ceil(duration / (2.0 * HOOKING_TIME))):
        _, load = operator.station.plumb(operator.places())
        points += [*np.maximum(load, lowest)]
    return points


def _arrivals(
    plan: SitePlan, run: SiteRun, operators: Sequence[LiftOperator]
) -> set[tuple[int, int]]:
    """Return crane and number of each place at which the drives stood, within the tolerances of an
    operator, for as long as the load is hooked or unhooked.
    """
    hooking_rows = round(HOOKING_TIME / CYCLE)
    arrived = set()
    for crane, motion, begins, lift in plan.lifts:
        first_row = math.ceil((begins + motion.arrival) / CYCLE)
        q = run.trajectories[crane].q[first_row : first_row + hooking_rows, motion.drives]
        beside = np.abs(q - motion.q[-1, motion.drives])
        stays = len(q) == hooking_rows and (beside <= operators[crane].tolerances).all()
        if stays and lift:  # 0 is a motion that makes way for another crane
            arrived.add((crane, lift))
    return arrived
