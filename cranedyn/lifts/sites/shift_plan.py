"""Plan a shift: which crane of a site brings which load from where to where, and when.

    site = read_crane_site("site.toml")  # with [[lift]] entries
    shift = plan_shift(site)
    print(timetable(shift))
    run = simulate_site(site, shift.plan.operators(), duration=shift.plan.duration + 5.0)

A lift of the list is two lifts of `cranedyn.lifts.sites.plan`: with an empty hook to the load, and
with the load to its goal. Both are planned together, so that no crane is left with a load on its
hook that it cannot set down.

Which lift is planned next is one rule. A lift can begin as soon as its crane is ready, its earliest
time has come, and the loads for which it waits are unhooked. All lifts that can begin within
`_TIME_BEFORE_MAKING_WAY` of the first one are tried, each past all that is planned already. Next is
the one for which least time is lost: by which it can begin later than the first one, and for which
its crane stands because of others. Of equal ones, next is the one that is done first. Where the
planner chooses the crane, each crane is tried, and the one that is done first gets the lift.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cranedyn.errors import CraneError, OutOfRange, quoted
from cranedyn.lifts.planning.lift import NoWay
from cranedyn.lifts.sites.crane_site import CraneSite
from cranedyn.lifts.sites.lift_list import ANY_CRANE, ListedLift
from cranedyn.lifts.sites.plan import (
    SLICE,
    GoalOutOfReach,
    Schedule,
    ScheduledLift,
    ScheduleState,
    SitePlan,
    missing_reach,
)

_TIME_BEFORE_MAKING_WAY = 60.0
"""Time by which a lift may begin after the first one, and still be planned before any crane makes
way [s]."""

# A motion ends in the middle of a slice, and the next one begins at the second slice after that.
_SLACK_BETWEEN_MOTIONS = 3.0 * SLICE
"""Longest time between two motions that is no wait [s]."""


@dataclass(frozen=True, eq=False)
class PlannedLift:
    """A lift of the list with its times.

    Attributes:
        lift: The lift.
        crane: Name of the crane that carries it out.
        begin: Time at which the crane leaves for the load [s].
        at_load: Time at which the empty hook has arrived, and the load is hooked on [s].
        off: Time at which the crane leaves with the load [s].
        delivered: Time at which the load has arrived at its goal [s].
        end: Time at which it is unhooked [s].
        waited: Time for which the crane stood because of other cranes [s].
        waits_for: What it waited for longest, in words; empty if it did not wait.
    """

    lift: ListedLift
    crane: str
    begin: float
    at_load: float
    off: float
    delivered: float
    end: float
    waited: float
    waits_for: str = ""


@dataclass(frozen=True, eq=False)
class ShiftPlan:
    """Lifts of a shift, planned in space and time.

    Attributes:
        plan: The motions of all cranes, with their proof.
        lifts: The lifts that are planned, in the order in which their cranes leave for the load.
        refusals: Why each of the other lifts is left out.
    """

    plan: SitePlan
    lifts: tuple[PlannedLift, ...]
    refusals: tuple[str, ...] = ()

    @property
    def duration(self) -> float:
        """Time at which the last load is unhooked [s]; 0 if all lifts are left out."""
        return max((planned.end for planned in self.lifts), default=0.0)

    @property
    def least(self) -> float:
        """Lower bound of the duration of a shift in which each crane carries out the same lifts.

        It is what the drives of one crane need [s], see `SitePlan.least`, with the time in which
        its last load is unhooked.
        """
        return self.plan.least + self.plan.stay if self.lifts else 0.0


def plan_shift(
    site: CraneSite,
    lifts: Sequence[ListedLift] | None = None,
    *,
    strict: bool = False,
    progress: Callable[[int], None] | None = None,
) -> ShiftPlan:
    """Plan the lifts of a shift.

    Args:
        site: The site; its cranes begin where they start, with empty hooks.
        lifts: The lifts; None for those of the site.
        strict: Whether a lift for which there is no path raises an error. Otherwise it is left out,
            see `ShiftPlan.refusals`.
        progress: Function that takes the number of lifts that are planned or refused, after each.

    Raises:
        NoWay: If there is no path for a lift, and `strict` is set.
        OutOfRange: If there is no lift.
        DataError: If two lifts have one name, or lifts wait for each other in a circle.
        UnknownName: If a lift names a crane or a lift that there is not.
    """
    if lifts is not None:
        site = replace(site, lifts=tuple(lifts))
    if not site.lifts:
        raise OutOfRange("number of lifts", 0, ">= 1; write each as [[lift]]")
    planner = _ShiftPlanner(site)
    while planner.remaining:
        planner.plan_next()
        if strict and planner.refusals:
            raise NoWay(planner.refusals[-1])
        if progress is not None:
            progress(len(site.lifts) - len(planner.remaining))
    in_order = sorted(planner.planned, key=lambda planned: planned.begin)
    plan = SitePlan(site, tuple(planner.schedule.lifts), site.hooking_time)
    return ShiftPlan(plan, tuple(in_order), tuple(planner.refusals))


@dataclass(frozen=True, eq=False)
class _Trial:
    """A lift as one crane would carry it out.

    Attributes:
        planned: The lift with its times.
        state: The schedule with its motions.
    """

    planned: PlannedLift
    state: ScheduleState


class _NoCrane(NoWay):
    """A lift that no crane can carry out, whatever the others do.

    Attributes:
        lift: The lift.
    """

    def __init__(self, lift: ListedLift, sentence: str) -> None:
        super().__init__(sentence)
        self.lift = lift


class _NotReached(NoWay):
    """A place of a lift that a crane does not reach.

    Attributes:
        where: The place, in words.
        out_of_reach: What is missing.
    """

    def __init__(self, where: str, out_of_reach: GoalOutOfReach) -> None:
        super().__init__(f"cannot bring it {where}: {out_of_reach.words}")
        self.where = where
        self.out_of_reach = out_of_reach


class _Refusal(NamedTuple):
    """Why a crane cannot carry out a lift.

    Attributes:
        crane: Its name.
        error: The reason.
    """

    crane: str
    error: CraneError


def _refusal_text(site: CraneSite, lift: ListedLift, refusals: Sequence[_Refusal]) -> str:
    """Return why no crane can carry out a lift, the cranes that reach both places first, and the
    least change of one that does not by which it would.
    """
    sentences = []
    not_reached: dict[str, list[str]] = {}
    missing: dict[str, float] = {}
    stations = {station.name: station for station in site.stations}
    for crane, error in refusals:
        if not isinstance(error, _NotReached):
            sentences.append(f"{crane} {error}")
            continue
        not_reached.setdefault(error.where, []).append(f"{crane} ({error.out_of_reach.words})")
        ends = (lift.start, lift.goal)
        missing[crane] = max(
            missing_reach(stations[crane], tuple(np.asarray(end, dtype=float).tolist()))
            for end in ends
        )
    for where, cranes in not_reached.items():
        verb = "does" if len(cranes) == 1 else "do"
        sentences.append(f"{', '.join(cranes)} {verb} not reach it {where}.")
    if missing:
        nearest = min(missing, key=lambda crane: missing[crane])
        sentences.append(
            f"Of these, {nearest} needs the least: {missing[nearest]:.1f} m more for both places."
        )
    return " ".join(sentences)


class _ShiftPlanner:
    """A schedule that grows by a lift at a time.

    Attributes:
        schedule: The motions that are planned.
        remaining: The lifts that are neither planned nor refused, in the order of the list.
        planned: The lifts that are planned, in the order in which they were.
        refusals: Why each of the other lifts is left out.
    """

    def __init__(self, site: CraneSite) -> None:
        """Begin without any motion, all cranes with empty hooks."""
        self.site = site
        self.schedule = Schedule(site, site.hooking_time, arched=True)
        self.schedule.masses = [0.0] * len(site.stations)
        self.remaining = list(site.lifts)
        self.planned: list[PlannedLift] = []
        self.refusals: list[str] = []
        self._ends: dict[str, float] = {}
        self._refused: set[str] = set()

    def plan_next(self) -> None:
        """Plan one lift, or refuse one."""
        for lift in self.remaining:
            refused = [name for name in lift.after if name in self._refused]
            if refused:
                self._refuse(lift, f"it is to follow {quoted(refused[0])}, which is left out.")
                return

        possible = [lift for lift in self.remaining if set(lift.after) <= self._ends.keys()]
        # Of lifts that can begin at once the first of the list comes first: sorting is stable.
        possible.sort(key=self._earliest_begin)
        first_begin = self._earliest_begin(possible[0])
        latest = first_begin + _TIME_BEFORE_MAKING_WAY
        soon = [lift for lift in possible if self._earliest_begin(lift) <= latest]
        later = possible[len(soon) :]
        try:
            next_trial = self._least_lost(soon, first_begin)
            conflict = self.schedule.conflict
            if next_trial is None:
                next_trial = self._first_possible(soon, cleared=True)
            if next_trial is None:
                next_trial = self._first_possible(later, cleared=False)
        except _NoCrane as error:
            self._refuse(error.lift, str(error))
            return
        if next_trial is not None:
            self._accept(next_trial)
            return
        reason = "no crane can pass the others, and nothing brings them out of its way"
        if conflict is not None:
            reason += f": {conflict.words(self.site)}"
        self._refuse(possible[0], f"{reason}.")

    def _least_lost(self, lifts: Sequence[ListedLift], first_begin: float) -> _Trial | None:
        """Return the lift for which least time is lost; None if none has a path past the others.
        If none has, the conflict of the schedule is that of the first lift.

        Args:
            lifts: The lifts, in the order in which they can begin.
            first_begin: Time from which on the first one can begin [s].

        Raises:
            _NoCrane: If no crane can carry out one of them, whatever the others do.
        """
        best: _Trial | None = None
        least = (math.inf, math.inf)
        for lift in reversed(lifts):
            trial = self._best_trial(lift, cleared=False)
            if trial is None:
                continue
            begins_later = self._earliest_begin(lift) - first_begin
            lost = begins_later + trial.planned.waited
            # Of equal ones the first of the list is taken, which is tried last.
            if (lost, trial.planned.end) <= least:
                least = (lost, trial.planned.end)
                best = trial
        return best

    def _first_possible(self, lifts: Sequence[ListedLift], *, cleared: bool) -> _Trial | None:
        """Return the first lift that has a path; None if none has.

        Args:
            lifts: The lifts.
            cleared: Whether other cranes make way.

        Raises:
            _NoCrane: If no crane can carry out one of them, whatever the others do.
        """
        for lift in lifts:
            trial = self._best_trial(lift, cleared=cleared)
            if trial is not None:
                return trial
        return None

    def _accept(self, trial: _Trial) -> None:
        """Keep a lift as it was tried."""
        lift = trial.planned.lift
        self.schedule.restore(trial.state)
        self.planned.append(trial.planned)
        self.remaining.remove(lift)
        self._ends[lift.name] = trial.planned.end

    def _refuse(self, lift: ListedLift, reason: str) -> None:
        """Leave a lift out."""
        self.refusals.append(f"Lift {quoted(lift.name)}: {reason}")
        self.remaining.remove(lift)
        self._refused.add(lift.name)

    def _cranes_of(self, lift: ListedLift) -> list[int]:
        """Return the indices of the cranes that may carry out a lift."""
        names = [station.name for station in self.site.stations]
        return [i for i, name in enumerate(names) if lift.crane in (name, ANY_CRANE)]

    def _due(self, lift: ListedLift) -> float:
        """Return the time from which on the load of a lift may be hooked on [s]."""
        return max(lift.earliest, *(self._ends[name] for name in lift.after), 0.0)

    def _earliest_begin(self, lift: ListedLift) -> float:
        """Return the time from which on a lift can begin [s]."""
        ready = min(self.schedule.ready[crane] for crane in self._cranes_of(lift))
        return max(ready * SLICE, self._due(lift))

    def _best_trial(self, lift: ListedLift, *, cleared: bool) -> _Trial | None:
        """Return a lift by the crane that is done with it first; None if all would wait for ever.

        Args:
            lift: The lift.
            cleared: Whether other cranes make way.

        Raises:
            _NoCrane: If no crane can carry it out, whatever the others do; with the reason of each.
        """
        best: _Trial | None = None
        refusals: list[_Refusal] = []
        cranes = self._cranes_of(lift)
        for crane in cranes:
            saved = self.schedule.saved()
            try:
                trial = self._trial(lift, crane, cleared=cleared)
            except CraneError as error:
                refusals.append(_Refusal(self.site.stations[crane].name, error))
                trial = None
            self.schedule.restore(saved)
            if trial is not None and (best is None or trial.planned.end < best.planned.end):
                best = trial
        if len(refusals) == len(cranes):
            raise _NoCrane(lift, _refusal_text(self.site, lift, refusals))
        return best

    def _trial(self, lift: ListedLift, crane: int, *, cleared: bool) -> _Trial | None:
        """Return a lift as a crane carries it out; None if it would wait for ever. The schedule is
        left with its motions.

        Raises:
            CraneError: If the crane cannot carry it out, whatever the others do.
        """
        schedule = self.schedule
        station = self.site.stations[crane]
        mass = station.crane.payload_mass if lift.load is None else lift.load
        self._check_wind(crane, mass)
        before = len(schedule.lifts)
        number = 1 + sum(bool(m.lift) for m in schedule.lifts if m.crane == crane)
        ready = schedule.ready[crane] * SLICE
        due = self._due(lift)

        waits = []
        for place, goal in (("from", lift.start), ("to", lift.goal)):
            schedule.masses[crane] = mass if place == "to" else 0.0
            earliest = due if place == "from" else 0.0
            try:
                arrives = self._go(crane, goal, number, earliest, cleared=cleared)
            except GoalOutOfReach as error:
                raise _NotReached(f"{place} {_place(goal)}", error) from error
            except CraneError as error:
                raise NoWay(f"cannot bring it {place} {_place(goal)}: {error}") from error
            if not arrives:
                return None
            if schedule.conflict is not None:
                waits.append(schedule.conflict)
            number += 1
        schedule.masses[crane] = 0.0

        motions = [m for m in schedule.lifts[before:] if m.crane == crane]
        fetched = next(m for m in motions if m.lift)
        delivered = motions[-1].end
        hooking = self.site.hooking_time
        waited = self._waited(motions, fetched, ready, due)
        reason = max(waits, key=lambda conflict: conflict.wait, default=None)
        planned = PlannedLift(
            lift=lift,
            crane=station.name,
            begin=motions[0].begin,
            at_load=fetched.end,
            off=motions[motions.index(fetched) + 1].begin,
            delivered=delivered,
            end=delivered + hooking,
            waited=waited,
            waits_for=reason.words(self.site) if reason is not None and waited else "",
        )
        return _Trial(planned, schedule.saved())

    def _go(
        self, crane: int, goal: np.ndarray, number: int, earliest: float, *, cleared: bool
    ) -> bool:
        """Put in a lift of `Schedule`, past the other cranes as they are planned if that is
        possible; return whether it arrives.

        Args:
            crane: Index of the crane.
            goal: Goal of its hook or load [m], shape (3,).
            number: Number of the lift among those of the crane.
            earliest: Time before which it does not arrive [s].
            cleared: Whether the other cranes make way where it cannot pass them.
        """
        point = tuple(goal.tolist())
        if self.schedule.lift(crane, point, number, cleared=False, earliest=earliest):
            return True
        if not cleared:
            return False
        return self.schedule.lift(crane, point, number, cleared=True, earliest=earliest)

    def _check_wind(self, crane: int, mass: float) -> None:
        """Check that a load is as heavy as the one for which the guard counts with wind.

        Raises:
            NoWay: If the site states a wind, and the mass [kg] is less.
        """
        assumed = self.site.stations[crane].crane.payload_mass
        if self.site.working_wind.gust > 0.0 and mass < assumed:
            raise NoWay(
                f"cannot carry {mass:g} kg in wind, which swings a load farther than the "
                f"{assumed:g} kg of the crane (payload_mass) that its guard counts on."
            )

    def _waited(
        self, motions: Sequence[ScheduledLift], fetched: ScheduledLift, ready: float, due: float
    ) -> float:
        """Return for how long a crane stood because of others during a lift [s].

        Args:
            motions: Its motions in the lift, in the order of time.
            fetched: The one of them that ends at the load.
            ready: Time at which the crane could begin [s].
            due: Time from which on the load may be hooked on [s].
        """
        time_stood = 0.0
        travel_to_load = 0.0
        free_from = ready
        for motion in motions:
            time_stood += _beyond_slack(motion.begin - free_from)
            free_from = motion.end
            if motion.begin <= fetched.begin:
                travel_to_load += motion.motion.arrival
            if motion is fetched:
                free_from += self.site.hooking_time
        # A crane that is at the load as soon as this may be hooked on has waited for nobody.
        not_due = max(due - ready - travel_to_load, 0.0)
        return _beyond_slack(time_stood - not_due)


def _beyond_slack(seconds: float) -> float:
    """Return a time between motions [s]; 0 if it comes from slices alone and is no wait."""
    return seconds if seconds > _SLACK_BETWEEN_MOTIONS else 0.0


def _place(point: np.ndarray) -> str:
    """Return a point in words."""
    x, y, z = point
    return f"[{x:g}, {y:g}, {z:g}] m"
