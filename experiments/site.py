"""Cranes whose jibs overlap: contacts and lost time in zones, supervised, by plans, or without.

Operators lift loads between random places of all that their crane reaches; adversaries try to
collide, over a network that loses messages.

Each site has two parts:

* *Shifts.* The operators of all cranes lift loads for a while, protected in each of the ways
  `PROTECTIONS`. The first shift, without protection, gives the *list* of each crane: as many of its
  lifts as it does in the time. The other shifts are measured by how much of this list they do.
* *Attacks.* Adversaries steer the cranes for longer than operators lift, to find a contact that the
  supervisor does not prevent, see `attacks_on`.

In addition the cycle of a supervisor for eight cranes is timed.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.special import pdtri

from cranedyn.checks import number, whole, worker_count
from cranedyn.interfaces import State
from cranedyn.sites.assumptions import site_assumptions
from cranedyn.sites.bodies import place_capsules
from cranedyn.sites.brakes import CYCLE
from cranedyn.sites.guard import BoxRequest, Guard, gentle
from cranedyn.sites.page import site_html
from cranedyn.sites.plan import SitePlan, leaves_room, plan_site
from cranedyn.sites.proof import least_distances
from cranedyn.sites.simulate import (
    MessageChannel,
    SiteExtremes,
    SiteRun,
    simulate_copies,
    simulate_site,
)
from cranedyn.sites.site import CraneSite
from cranedyn.sites.site_file import EXAMPLES, read_crane_site
from cranedyn.sites.supervisor import Supervisor
from cranedyn.sweep.workers import ignore_sigint
from experiments import harness
from experiments.harness import Claim, Column, Outcome, ResultTable, Setup, make_table
from experiments.harness.processes import processes
from experiments.oracles.real_shapes import RealDistances, real_distances

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PROTECTIONS = ("none", "zones", "supervisor", "plan")
"""What protects the cranes of a shift: nothing, static zones, the supervisor, or a common plan."""

# --- operators ------------------------------------------------------------------------------------

HOOKING_TIME = 20.0
"""Time to hook or unhook a load [s]."""

DAMPING_RATIO = 0.05
"""Damping ratio of the swing that an operator adds by following the load."""

CARRYING_CLEARANCE = 1.0
"""Cable length beyond the shortest while a load is carried [m]: it passes over lower jibs."""

PLACING_RATIO = 0.8
"""Cable length over the longest where a load is put."""

MIN_LOAD_HEIGHT = 4.0
"""Least height above ground of the centre of a load where a plan puts it [m]."""

ARRIVAL_TOLERANCE = {"rad": 4e-3, "m": 0.1}
"""Distance from its goal at which a drive has arrived, by the unit of the drive."""

RERAISE_FACTOR = 10.0
"""Distance in arrival tolerances beside its goal from which on a load is raised before it goes
back: it was moved away by the supervisor while it was lowered."""

EDGE_RATIO = 0.05
"""Share of the range of each drive, at both of its ends, in which no lift begins or ends."""

OPERATOR_RAMP_RATIO = 0.75
"""Acceleration by which an operator changes rates, over the deceleration that the guard plans with.

Rates that follow the load come on top.
"""

OPERATOR_RATE_RATIO = 0.9
"""Largest rate that an operator commands, over that of the drive; following comes on top."""

STANDSTILL_RATIO = 0.02
"""Rate below which a drive stands, over its largest."""

# --- zones ----------------------------------------------------------------------------------------

ZONE_STEPS = {"rad": math.radians(5.0), "m": 2.5}
"""Steps by which static zones grow, by the unit of the drive."""

# --- adversaries ----------------------------------------------------------------------------------

CHANNEL = MessageChannel(0.2, 0.3)
"""Network of the adversaries: latency [s], and share of the messages that it loses."""

PUSH_PERIOD = 10.0
"""Time for which an adversary pushes each drive at one rate [s]."""

PUSHES = 12
"""Number of pushes of an adversary before they repeat."""

LOOK_PERIOD = 0.5
"""Time after which a greedy adversary looks again where the other loads are [s]."""

GREEDY_RATIO = 0.8
"""Share of the pushes of greedy adversaries that go towards the nearest load."""

MUTATION_RATIO = 0.2
"""Share of the pushes that the search of optimised adversaries draws anew."""

ATTACK_KINDS = ("random", "greedy", "optimised")
"""Kinds of adversaries, see `attacks_on`."""

MAX_COPIES = 300
"""Largest number of copies of a site that run in lockstep with adversaries of one kind."""

MAX_SEARCH_TIME = 12000.0
"""Longest time of adversaries in one search [min]; more is divided among searches, which can run in
processes of their own."""

# --- time of a cycle, and claims ------------------------------------------------------------------

TOWER_SPACING = 45.0
"""Distance between eight towers in two rows, for the time of a cycle [m]."""

MIN_LISTED = 8
"""Number of lifts on the lists of a site from which on lost time is judged."""


@dataclass
class LiftOperator:
    """A person who lifts loads from place to place, and follows a load that swings.

    A lift goes to two places: where the load is hooked, and where it is put. To each place lead
    three *legs*: raise the hook, move over the place, lower. A leg is a position of the drives; NaN
    stands for a drive that may stay where it is.

    Attributes:
        site: The site.
        index: Index of the crane.
        seed: Seed of the places.
        zone: Box of positions outside of which it lifts nothing, shape (2, m); None for no zone.
        drawn: Number of lifts drawn so far, those included that would lead out of the zone.
        finished: Number of each lift that is done, counted from 1 as they are drawn.
    """

    site: CraneSite
    index: int
    seed: int
    zone: np.ndarray | None = None
    drawn: int = 0
    finished: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Begin with nothing to do."""
        self.station = self.site.stations[self.index]
        layout = self.station.crane.layout
        brakes = gentle(self.station, self.site.swing, self.site.working_wind)
        self.tolerances = np.array([ARRIVAL_TOLERANCE[joint.unit] for joint in layout.driven])
        self._rng = np.random.default_rng(self.seed)
        self._ramp = OPERATOR_RAMP_RATIO * brakes.decelerations
        # Rates without those that follow the load.
        self._base_rates = np.zeros(layout.m)
        self._waits_until = 0.0
        self._legs: list[np.ndarray] = []

    def places(self) -> np.ndarray:
        """Return where the next lift begins and ends, shape (2, m).

        Places are drawn until one is found that leaves lower cranes room and lies in the zone.
        Those outside of the zone count as drawn: so the n-th lift is the same one in all shifts.
        """
        winch = self.station.crane.winch
        low, high = reach(self.site, self.index)
        edge = EDGE_RATIO * (high - low)
        while True:
            places = self._rng.uniform(low + edge, high - edge, (2, len(low)))
            places[:, winch] = PLACING_RATIO * high[winch]
            if not all(leaves_room(self.site, self.index, place) for place in places):
                continue
            self.drawn += 1
            if self.zone is None:
                return places
            if ((places >= self.zone[0]) & (places <= self.zone[1])).all():
                return places

    def __call__(self, t: float, states: Sequence[State]) -> np.ndarray:
        """Return the rates that the operator commands [rad/s or m/s], shape (m,).

        Args:
            t: Time [s].
            states: State of each crane.
        """
        state = states[self.index]
        drives = self.station.crane.layout.drives
        position = state.q[drives]
        velocity = state.v[drives]
        at_rest = np.zeros_like(position)

        if not self._legs:
            for place in self.places():
                self._legs += self._legs_to(place)
        if t < self._waits_until:
            return self._follow_load(at_rest, state, velocity)

        if self._was_moved_away(position):
            self._legs[:1] = self._legs_to(self._legs[0])
        gap = np.where(np.isnan(self._legs[0]), 0.0, self._legs[0] - position)
        if self._has_arrived(gap):
            self._finish_leg(t)
            return self._follow_load(at_rest, state, velocity)
        return self._follow_load(self._rates_over(gap), state, velocity)

    def _legs_to(self, place: np.ndarray) -> list[np.ndarray]:
        """Return the legs that bring a load to a place: up, over it, and down."""
        winch = self.station.crane.winch
        shortest, _ = reach(self.site, self.index)
        carrying_length = shortest[winch] + CARRYING_CLEARANCE
        up = np.full_like(place, np.nan)
        up[winch] = carrying_length
        over = place.copy()
        over[winch] = carrying_length
        return [up, over, place]

    def _was_moved_away(self, position: np.ndarray) -> bool:
        """Return whether the crane is beside the place while it lowers the load: the supervisor
        moved it to let another crane pass.
        """
        is_lowering = len(self._legs) % 3 == 1
        beside = np.abs(self._legs[0] - position) > RERAISE_FACTOR * self.tolerances
        beside[self.station.crane.winch] = False
        return bool(is_lowering and beside.any())

    def _has_arrived(self, gap: np.ndarray) -> bool:
        """Return whether all drives stand at the end of the leg."""
        stands = np.abs(self._base_rates) < STANDSTILL_RATIO * self.station.converters.rates
        return bool(((np.abs(gap) < self.tolerances) & stands).all())

    def _finish_leg(self, t: float) -> None:
        """Go on to the next leg; at a place the load is hooked or unhooked first."""
        self._legs.pop(0)
        if len(self._legs) % 3 == 0:
            self._waits_until = t + HOOKING_TIME
        if not self._legs:
            self.finished.append(self.drawn)

    def _rates_over(self, gap: np.ndarray) -> np.ndarray:
        """Return rates from which the drives can stop over the gap to the end of the leg."""
        distance = np.abs(gap)
        # v² = 2 a d with 80 % of the ramp. The operator sees the end half a second too late.
        remaining = np.maximum(distance - 0.5 * np.abs(self._base_rates), 0.0)
        stopping = np.sqrt(1.6 * self._ramp * remaining)
        # By these alone a drive would come to rest before it arrives: near the end it creeps.
        creeping = 0.15 * distance * (distance < 4.0 * self.tolerances)
        fastest = OPERATOR_RATE_RATIO * self.station.converters.rates
        return np.sign(gap) * np.minimum(stopping + creeping, fastest)

    def _follow_load(self, wanted: np.ndarray, state: State, velocity: np.ndarray) -> np.ndarray:
        """Return the wanted rates, changed by no more than the ramp in a cycle, and with those that
        move the pivot towards the load.
        """
        # A guard may hold the drives back. Then the operator goes on from rates that they can reach
        # within two seconds.
        reachable = np.clip(
            self._base_rates, velocity - 2.0 * self._ramp, velocity + 2.0 * self._ramp
        )
        step = self._ramp * CYCLE
        self._base_rates = np.clip(wanted, reachable - step, reachable + step)

        # A pivot that follows the load at 2 ζ ω times its distance in plan damps the swing with the
        # ratio ζ. The distance is l times the inclination of the rope, and ω l = √(g l).
        crane = self.station.crane
        cable = abs(float(state.q[crane.layout.drives[crane.winch]]))
        _, rope, motion = self.station.rope(state.q[None])
        pivot_velocity = 2.0 * DAMPING_RATIO * math.sqrt(crane.gravity * cable) * rope[0, :2]
        # The drives that move the pivot so, with the smallest rates; the winch does not move it.
        drive_rates = pivot_velocity @ np.linalg.pinv(motion[0, :, :2], rcond=1e-3)
        return self._base_rates + drive_rates


@cache
def reach(site: CraneSite, index: int) -> tuple[np.ndarray, np.ndarray]:
    """Return what the drives of a crane can reach without touching the tower of another crane.

    Args:
        site: The site.
        index: Index of the crane.

    Returns:
        Lower and upper ends of the intervals of the drives [rad or m], shape (m,) each. The slew
        goes from zero at most half around to either side, and stops before a tower.
    """
    station = site.stations[index]
    layout = station.crane.layout
    slew = layout.drive_of("slew")
    low = station.crane.lower[layout.drives].copy()
    high = station.crane.upper[layout.drives].copy()
    if slew is None:
        return low, high
    low[slew] = max(low[slew], -math.pi)
    high[slew] = min(high[slew], math.pi)

    for ends, sign in ((low, -1.0), (high, 1.0)):
        angles = np.arange(0.0, sign * ends[slew], math.radians(1.0)) * sign
        for angle in angles:
            if not _passes_towers(site, index, angle, (low, high)):
                ends[slew] = angle
                break
    return low, high


def _passes_towers(
    site: CraneSite, index: int, angle: float, ends: tuple[np.ndarray, np.ndarray]
) -> bool:
    """Return whether a crane at a slew angle [rad] keeps away from the towers of all others.

    It has to keep half as much again as the required distance, with its other drives at either end.
    """
    bodies = site.bodies
    slew = site.stations[index].crane.layout.drive_of("slew")
    moves_with_crane = ~bodies.hangs[index] & (bodies.joint[index] > 0)
    my_capsules = np.nonzero(moves_with_crane)[0]
    is_other = np.arange(len(site.stations)) != index
    towers = np.argwhere((bodies.joint == 0) & is_other[:, None])
    pairs = np.array(list(itertools.product(my_capsules, range(len(towers)))))

    for other_drives in ends:
        position = other_drives.copy()
        position[slew] = angle
        places = np.repeat(site.positions(index, position)[None], len(pairs), axis=0)
        crane = np.full(len(pairs), index)
        tower = towers[pairs[:, 1]]
        moving = place_capsules(bodies, crane, pairs[:, 0], places, places, site.swing)
        still = place_capsules(bodies, tower[:, 0], tower[:, 1], 0 * places, 0 * places, 0.0)
        # `not >=` is true for NaN as well.
        if not least_distances(moving, still).min() >= 1.5 * site.distance:
            return False
    return True


@dataclass
class Adversary:
    """Operators of a crane on N copies of a site who try to collide.

    Each pushes every drive at a rate for `PUSH_PERIOD`, then at another one.

    Attributes:
        site: The site.
        index: Index of the crane.
        pushes: Rates over the largest ones, shape (N, `PUSHES`, m). NaN stands for a greedy push:
            it slews towards the nearest load of another crane, and takes the own load to its
            radius.
    """

    site: CraneSite
    index: int
    pushes: np.ndarray

    def __post_init__(self) -> None:
        """Begin without having looked where the other loads are."""
        self._looks_at = np.zeros(len(self.pushes))
        self._greedy_signs = 0.0 * self.pushes[:, 0]

    def __call__(self, t: float, states: Sequence[State]) -> np.ndarray:
        """Return the rates [rad/s or m/s], shape (N, m).

        Args:
            t: Time [s].
            states: State of each crane, on all copies.
        """
        push = self.pushes[:, int(t / PUSH_PERIOD) % PUSHES]
        is_greedy = np.isnan(push)
        looking = np.flatnonzero(is_greedy.any(axis=1) & (t >= self._looks_at))
        if len(looking):
            seen = [State(q[looking], v[looking]) for q, v in states]
            self._greedy_signs[looking] = self._towards_nearest(seen)
            self._looks_at[looking] = t + LOOK_PERIOD
        shares = np.where(is_greedy, self._greedy_signs, push)
        return shares * self.site.stations[self.index].converters.rates

    def _towards_nearest(self, states: Sequence[State]) -> np.ndarray:
        """Return the sign of the rate of each drive that moves the pivot, in plan, towards the
        nearest pivot of another crane, shape (N, m).
        """
        poses = []
        for station, state in zip(self.site.stations, states, strict=True):
            poses.append(station.rope(state.q))
        my_pivot, _, motion = poses.pop(self.index)
        offsets = np.array([pivot[:, :2] - my_pivot[:, :2] for pivot, _, _ in poses])
        nearest = np.argmin((offsets * offsets).sum(axis=2), axis=0)
        offset = offsets[nearest, np.arange(len(my_pivot))]
        return np.sign((motion[:, :, :2] * offset[:, None]).sum(axis=2))


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


class Attack(NamedTuple):
    """Runs of adversaries on a site.

    Attributes:
        site: Name of the site.
        kind: Kind of the adversaries, one of `ATTACK_KINDS`, or the protection of a shift.
        crane_minutes: Time of all cranes together [min].
        contacts: Number of contacts.
        least: Least distance less the required one [m].
        swing: Largest swing over the largest that is allowed.
        outside: Largest distance by which a drive left its box [rad or m]; negative inside.
    """

    site: str
    kind: str
    crane_minutes: float
    contacts: int
    least: float
    swing: float
    outside: float

    @classmethod
    def of(cls, site: CraneSite, kind: str, duration: float, run: SiteExtremes) -> Attack:
        """Return the result of copies of a site.

        Args:
            site: The site.
            kind: Kind of the adversaries.
            duration: Time from the first to the last row of each copy [s].
            run: Extremes of the copies.
        """
        return cls(
            site=site.name,
            kind=kind,
            crane_minutes=len(site.stations) * len(run.least) * duration / 60.0,
            contacts=int(run.contacts.sum()),
            least=float(run.least.min()) - site.distance,
            swing=float(run.swing.max()) / site.swing,
            outside=float(run.outside.max()),
        )

    @classmethod
    def of_shift(cls, shift: Shift) -> Attack:
        """Return the result of a shift in the same terms."""
        run = shift.run
        contacts = np.array([len(run.contacts)])
        least = np.array([run.least_distance])
        extremes = SiteExtremes(contacts, least, run.swing, run.outside)
        return cls.of(run.site, shift.protection, run.t[-1], extremes)

    @property
    def most_contacts(self) -> float:
        """Upper bound of the number of contacts in 10⁶ crane-minutes, at 95 %.

        It is the rate of a Poisson process that gives no more contacts than were counted with a
        probability of 5 %.
        """
        return float(1e6 * pdtri(self.contacts, 0.05) / self.crane_minutes)

    @classmethod
    def all_of(cls, runs: Sequence[Attack]) -> Attack:
        """Return several runs as one, with the site and the kind of the first."""
        return cls(
            site=runs[0].site,
            kind=runs[0].kind,
            crane_minutes=sum(run.crane_minutes for run in runs),
            contacts=sum(run.contacts for run in runs),
            least=min(run.least for run in runs),
            swing=max(run.swing for run in runs),
            outside=max(run.outside for run in runs),
        )


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Work and attack on each site."""
    # Checked before the shifts, which take minutes.
    number("hours", options.hours, "h", "> 0")
    number("minutes", options.minutes, "min", "> 0")
    whole("seed", options.seed, 0)
    whole("cycles", options.cycles, 1)
    worker_count("jobs", options.jobs)

    searches = math.ceil(options.minutes / MAX_SEARCH_TIME)
    update = setup.reporter.count("shifts and searches", len(options.site) * (1 + searches))
    shifts: list[Shift] = []
    for count, name in enumerate(options.site, start=1):
        shifts += _shifts(read_crane_site(name), 3600.0 * options.hours)
        update(count)
    attacks = _search_all(options, searches, update)

    # Other programs of the computer only slow a pass down: the least of three comes nearest to what
    # a cycle takes.
    passes = []
    for _ in range(3):
        times, slews = supervisor_cycles(options.cycles)
        passes.append((times, slews))
    cycle_times = np.min([times for times, _ in passes], axis=0)
    first_slews = passes[0][1]

    supervised = [shift.run for shift in shifts if shift.protection == "supervisor"]
    are_ours = set(options.site) <= set(EXAMPLES)
    return Outcome(
        tables=[*_shift_tables(shifts), _attack_table(attacks), _assumption_table(shifts)],
        claims=_claims(shifts, attacks, cycle_times, are_ours),
        figures={"invariant": _figure(first_slews)},
        texts={f"site_{i + 1}.html": site_html(run) for i, run in enumerate(supervised)},
    )


def _search_all(
    options: argparse.Namespace, searches: int, update: Callable[[int], None]
) -> list[Attack]:
    """Return the attacks on all sites, one for each site and kind of adversaries.

    Args:
        options: Arguments of the command line.
        searches: Number of searches on each site, among which the time is divided.
        update: Shows how many shifts and searches are done.
    """
    duration = 60.0 * (options.minutes / searches)
    tasks = []
    with processes(options.jobs) as workers:
        with ignore_sigint():  # submitting starts processes
            for name, search in itertools.product(options.site, range(searches)):
                seed = (options.seed, search)
                tasks.append(workers.submit(attacks_on, name, duration, seed))
        for done, _ in enumerate(as_completed(tasks), start=1):
            update(len(options.site) + done)

    by_kind: dict[tuple[str, str], list[Attack]] = {}
    for task in tasks:
        for attack in task.result():
            by_kind.setdefault((attack.site, attack.kind), []).append(attack)
    return [Attack.all_of(runs) for runs in by_kind.values()]


def _shifts(site: CraneSite, duration: float) -> list[Shift]:
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


@cache
def static_zones(site: CraneSite) -> list[np.ndarray]:
    """Return a box of positions for each crane, shape (2, m), all of them proven apart.

    The boxes begin around the cranes at their start. First the hoists get their ranges, then in
    turn each end of each drive is moved outwards by a step, until none can be.
    """
    zones = [Guard(station, site.swing).box[0] for station in site.stations]
    ranges = [np.array(reach(site, i)) for i in range(len(site.stations))]
    for i, station in enumerate(site.stations):
        winch = station.crane.winch
        larger = zones[i].copy()
        larger[:, winch] = ranges[i][:, winch]
        if site.apart(i, larger, zones).all():
            zones[i] = larger

    grown = True
    while grown:
        grown = False
        for i, end in itertools.product(range(len(zones)), (0, 1)):
            grown |= _grow_end(site, zones, i, end, ranges[i])
    return zones


def _grow_end(
    site: CraneSite, zones: list[np.ndarray], crane: int, end: int, ranges: np.ndarray
) -> bool:
    """Move one end of each drive of a zone outwards by a step where it stays proven apart.

    Args:
        site: The site.
        zones: Zones of all cranes; that of the crane is replaced.
        crane: Index of the crane.
        end: 0 for the lower ends, 1 for the upper ones.
        ranges: Farthest ends, shape (2, m).

    Returns:
        Whether an end was moved.
    """
    outwards = 2 * end - 1
    grown = False
    for drive, joint in enumerate(site.stations[crane].crane.layout.driven):
        zone = zones[crane]
        larger = zone.copy()
        step = ZONE_STEPS[joint.unit] * outwards
        larger[end, drive] = np.clip(larger[end, drive] + step, *ranges[:, drive])
        moved = abs(larger[end, drive] - zone[end, drive]) > 1e-9
        if moved and site.apart(crane, larger, zones).all():
            zones[crane] = larger
            grown = True
    return grown


def attacks_on(name: str, duration: float, seed: Sequence[int]) -> list[Attack]:
    """Return attacks on a site by each kind of adversaries, for a third of a duration each.

    Random adversaries push at one of three rates: the largest to either side, or none. Greedy ones
    push towards the nearest load most of the time. Optimised ones come from a random search: in
    each round the quarter of the copies in which cranes came nearest is kept, and copies of them
    are tried again of which some pushes are drawn anew.

    Args:
        name: Name or file of the site.
        duration: Time of all copies together [s].
        seed: Seed of the pushes and of the network.
    """
    site = read_crane_site(name)
    rng = np.random.default_rng(seed)
    run_time = PUSH_PERIOD * PUSHES
    run_count = max(1, round(duration / 3.0 / run_time))
    rounds = math.ceil(run_count / MAX_COPIES)
    copies = math.ceil(run_count / rounds)
    shapes = [(copies, PUSHES, station.crane.layout.m) for station in site.stations]

    def redrawn(ratio: float, pushes: Sequence[np.ndarray | float]) -> list[np.ndarray]:
        """Return the pushes of each crane, of which a share is replaced by random ones."""
        result = []
        for shape, mine in zip(shapes, pushes, strict=True):
            is_replaced = rng.random(shape) < ratio
            result.append(np.where(is_replaced, rng.integers(-1, 2, shape), mine))
        return result

    all_greedy = [math.nan] * len(shapes)
    best = redrawn(1.0, [0.0] * len(shapes))
    least_of_best = np.full(copies, math.inf)
    attacks: list[Attack] = []
    for _ in range(rounds):
        # All kinds run in lockstep, as three groups of copies in the order of `ATTACK_KINDS`.
        trial = redrawn(MUTATION_RATIO, best)
        random = redrawn(1.0, best)
        greedy = redrawn(1.0 - GREEDY_RATIO, all_greedy)
        adversaries = []
        for i, groups in enumerate(zip(random, greedy, trial, strict=True)):
            adversaries.append(Adversary(site, i, np.concatenate(groups)))
        run = simulate_copies(
            site,
            adversaries,
            copies=3 * copies,
            duration=run_time,
            channel=CHANNEL,
            seed=int(rng.integers(2**32)),
        )
        for k, kind in enumerate(ATTACK_KINDS):
            group = slice(k * copies, (k + 1) * copies)
            extremes = SiteExtremes(
                run.contacts[group], run.least[group], run.swing[group], run.outside[group]
            )
            # The rows are a cycle apart, and the last one stands a cycle before the end.
            attacks.append(Attack.of(site, kind, run_time - CYCLE, extremes))

        least = np.concatenate([least_of_best, run.least[-copies:]])
        nearest_quarter = np.argsort(least, kind="stable")[: math.ceil(copies / 4)]
        kept = np.resize(nearest_quarter, copies)
        best = [np.concatenate([old, tried])[kept] for old, tried in zip(best, trial, strict=True)]
        least_of_best = least[kept]
    return attacks


def supervisor_cycles(cycles: int) -> tuple[np.ndarray, np.ndarray]:
    """Time a supervisor of eight cranes whose drives do exactly what their guards pass on.

    Two rows of four towers face each other. Every hundred cycles each drive gets another command:
    its largest rate to either side, or none.

    Args:
        cycles: Number of cycles.

    Returns:
        The processor time of the supervisor in each cycle [s], shape (cycles,); and the slew of
        each crane with the lower and the upper end of its box [rad], shape (cycles, 8, 3).
    """
    site = _eight_towers()
    stations = site.stations
    rng = np.random.default_rng(0)
    guards = [Guard(station, site.swing) for station in stations]
    supervisor = Supervisor(site, [guard.box for guard in guards])
    states = []
    for station in stations:
        start = station.crane.start
        states.append(State(start.q[None].copy(), start.v[None].copy()))
    commands = [np.zeros((1, 3))] * len(stations)

    times = np.zeros(cycles)
    rows = []
    for cycle in range(cycles):
        requests: list[tuple[int, BoxRequest]] = []
        for i, (guard, state, station) in enumerate(zip(guards, states, stations, strict=True)):
            if cycle % 100 == 0:
                commands[i] = rng.integers(-1, 2, (1, 3)) * station.converters.rates
            rates, request = guard.step(cycle * CYCLE, state, commands[i])
            drives = station.crane.layout.drives
            state.q[:, drives] += rates * CYCLE
            state.v[:, drives] = rates
            if len(request.copies):
                requests.append((i, request))

        begin = time.process_time()
        grants = [(i, supervisor.receive(i, request)) for i, request in requests]
        times[cycle] = time.process_time() - begin
        for i, grant in grants:
            guards[i].receive(grant)

        row = []
        for guard, state, station in zip(guards, states, stations, strict=True):
            slew = station.crane.layout.drives[0]
            low, high = guard.box[0, :, 0]
            row.append((state.q[0, slew], low, high))
        rows.append(row)
    return times, np.array(rows)


def _eight_towers() -> CraneSite:
    """Return a site of two rows of four towers, each row turned towards the other, with jibs 3 m
    one above the next.
    """
    four = read_crane_site("four_towers")
    stations = []
    for i in range(8):
        foot = np.array([TOWER_SPACING * (i % 4), TOWER_SPACING * (i // 4), 3.0 * i])
        heading = math.copysign(math.pi / 2.0, i - 3.5)
        stations.append(replace(four.stations[i % 4], name=str(i), foot=foot, heading=heading))
    return CraneSite("eight towers", tuple(stations), swing=four.swing)


def _shift_tables(shifts: Sequence[Shift]) -> list[ResultTable]:
    """Return a table of the shifts of all sites together, and one of each shift."""

    def total(value: Callable[[Shift], float]) -> Callable[[Sequence[Shift]], float]:
        return lambda group: sum(value(shift) for shift in group)

    def minutes(value: Callable[[SitePlan], float]) -> Callable[[Sequence[Shift]], float | None]:
        """Return the sum of a time of plans [s] in minutes; None where there is none."""
        return lambda group: sum(value(x.plan) for x in group if x.plan) / 60.0 or None

    columns: list[Column] = [
        ("protection", "", lambda group: group[0].protection),
        ("contacts", "d", total(lambda x: len(x.run.contacts))),
        ("distance [m]", ".2f", lambda group: max(0.0, min(x.run.least_distance for x in group))),
        ("on the list", "d", total(lambda x: sum(x.listed))),
        ("of these done", "d", total(lambda x: x.done)),
        ("all lifts", "d", total(lambda x: sum(len(one.finished) for one in x.operators))),
        ("plan [min]", ".1f", minutes(lambda plan: plan.duration)),
        ("least [min]", ".1f", minutes(lambda plan: plan.least)),
        ("in a deadlock [min]", ".1f", total(lambda x: CYCLE * len(x.run.deadlocks) / 60.0)),
        ("crane-minutes", ".0f", total(lambda x: x.crane_minutes)),
    ]
    site: Column = ("site", "", lambda group: group[0].site)

    by_protection = [[x for x in shifts if x.protection == kind] for kind in PROTECTIONS]
    note = """The list: what a crane lifts without protection; zones leave lifts out, do later ones.
Operators raise each load first; plans only where that is quicker."""

    refusals = []
    for shift in shifts:
        if shift.plan:
            refusals += [f"{shift.site}: {text}" for text in shift.plan.refusals]
    return [
        make_table("Shifts of random lifts", by_protection, *columns, note=note),
        make_table("By site", [[x] for x in shifts], site, *columns, note="\n".join(refusals)),
    ]


def _attack_table(attacks: Sequence[Attack]) -> ResultTable:
    """Return a row for each site and kind of adversaries."""
    return make_table(
        "Adversaries",
        attacks,
        ("site", "", lambda attack: attack.site),
        ("adversaries", "", lambda attack: attack.kind),
        ("contacts", "d", lambda attack: attack.contacts),
        ("beyond required distance [m]", ".2f", lambda attack: attack.least),
        ("swing / largest", ".2f", lambda attack: attack.swing),
        ("95 %: in 10⁶ crane-minutes", ".3g", lambda attack: attack.most_contacts),
        ("crane-minutes", ".0f", lambda attack: attack.crane_minutes),
        note=f"Messages take {CHANNEL.latency:g} s, {100.0 * CHANNEL.loss:g} % are lost.",
    )


def _assumption_table(shifts: Sequence[Shift]) -> ResultTable:
    """Return a row for each assumption on which the promises of a site rest."""
    rows = []
    for shift in shifts:
        # The assumptions are those of the site: once is enough.
        if shift.protection == PROTECTIONS[0]:
            site = shift.run.site
            rows += [(site.name, assumption) for assumption in site_assumptions(site)]
    return make_table(
        "Assumptions",
        rows,
        ("site", "", lambda row: row[0]),
        ("the promise rests on", "", lambda row: row[1].name),
        ("assumed", "", lambda row: row[1].value),
        ("from", "", lambda row: row[1].origin.value),
        note="Supervised cranes do not meet as long as all of it holds. Enter what is a default.",
    )


def _claims(
    shifts: Sequence[Shift], attacks: Sequence[Attack], times: np.ndarray, ours: bool
) -> list[Claim]:
    """Return what the experiment shows.

    Args:
        shifts: All shifts.
        attacks: All attacks.
        times: Time of each cycle of a supervisor for eight cranes [s], shape (cycles,).
        ours: Whether all sites are examples. On other sites supervision may be worth less: it is
            not judged there.
    """
    unprotected = [shift for shift in shifts if shift.protection == "none"]
    zoned = [shift for shift in shifts if shift.protection == "zones"]
    supervised = [shift for shift in shifts if shift.protection == "supervisor"]
    planned = [shift for shift in shifts if shift.protection == "plan"]
    judged = ours and min(sum(shift.listed) for shift in shifts) >= MIN_LISTED
    slowest_plan = max(shift.planning for shift in planned)
    return [
        *_supervision_claims(supervised, attacks),
        _unprotected_claim(unprotected),
        _lost_time_claim(supervised, zoned, judged),
        _plan_claim(planned),
        _done_claim(planned, supervised, judged),
        _real_shapes_claim(shifts),
        Claim(
            f"Plans take less than 2 s a lift ({slowest_plan:.2f} s, slowest site).",
            slowest_plan < 2.0,
        ),
        Claim(
            f"A cycle for eight cranes takes less than 5 ms ({1e3 * times.max():.1f} ms at most, "
            f"{1e3 * np.median(times):.1f} ms in the median; the least of three passes).",
            bool(times.max() < 5e-3),
        ),
    ]


def _supervision_claims(supervised: Sequence[Shift], attacks: Sequence[Attack]) -> list[Claim]:
    """Return the claims on contacts, distance, swing and boxes of supervised cranes."""
    runs = Attack.all_of([*attacks, *(Attack.of_shift(shift) for shift in supervised)])
    minutes = runs.crane_minutes
    # A Poisson process that gives no event with a probability of 5 % expects -ln 0.05 = 3.0.
    return [
        Claim(
            f"Supervised cranes do not touch in {minutes:.0f} crane-minutes: at 95 % fewer than "
            f"{3.0 / minutes:.2g} contacts a crane-minute, {3e6 / minutes:.0f} in 10⁶.",
            runs.contacts == 0,
        ),
        Claim(
            f"They keep the required distance, ropes their largest swing ({100.0 * runs.swing:.0f} "
            "% of it), drives their boxes.",
            runs.least >= 0.0 and runs.swing <= 1.0 and runs.outside <= 0.0,
        ),
    ]


def _unprotected_claim(unprotected: Sequence[Shift]) -> Claim:
    """Return the claim that contacts are seen where cranes are not protected.

    It is not judged where nothing touches: then it shows nothing of how contacts are counted.
    """
    touches = sum(len(shift.run.contacts) for shift in unprotected)
    overlaps = sum(shift.real.overlaps for shift in unprotected)
    uncounted = sum(shift.real.uncounted for shift in unprotected)
    return Claim(
        f"Without protection they touch (contacts: {touches}): a contact was counted before "
        f"each of {overlaps} instants in which real shapes overlap.",
        (touches > 0 and not uncounted) if touches or overlaps else None,
    )


def _lost_time_claim(supervised: Sequence[Shift], zoned: Sequence[Shift], judged: bool) -> Claim:
    """Return the claim that supervision loses less time than static zones."""
    lost = [(shift.lost, zone.lost) for shift, zone in zip(supervised, zoned, strict=True)]
    return Claim(
        "Supervised cranes leave less than half of the lifts undone that static zones do: "
        f"{', '.join(f'{share:.0f} of {zones:.0f} %' for share, zones in lost)}.",
        all(share < zones / 2.0 for share, zones in lost) if judged else None,
    )


def _plan_claim(planned: Sequence[Shift]) -> Claim:
    """Return the claim that planned cranes keep apart without a supervisor."""
    plans = Attack.all_of([Attack.of_shift(shift) for shift in planned])
    proven = all(shift.plan.holds for shift in planned if shift.plan)
    return Claim(
        f"Planned cranes are proven apart, do not touch in {plans.crane_minutes:.0f} crane-"
        "minutes without a supervisor, keep distance and swing "
        f"({100.0 * plans.swing:.0f} % of it).",
        proven and plans.contacts == 0 and plans.least >= 0.0 and plans.swing <= 1.0,
    )


def _done_claim(planned: Sequence[Shift], supervised: Sequence[Shift], judged: bool) -> Claim:
    """Return the claim that plans do as many lifts as operators under the supervisor."""
    done = [(shift.done, bound.done) for shift, bound in zip(planned, supervised, strict=True)]
    return Claim(
        "Plans do at least as many lifts of the lists as operators under the supervisor: "
        f"{', '.join(f'{mine} and {theirs}' for mine, theirs in done)}.",
        all(mine >= theirs for mine, theirs in done) if judged else None,
    )


def _real_shapes_claim(shifts: Sequence[Shift]) -> Claim:
    """Return the claim that real shapes keep the distance, too, and lie in their capsules."""
    kept = [shift for shift in shifts if shift.protection in ("supervisor", "plan")]
    beyond = min(shift.real.least - shift.run.site.distance for shift in kept)
    instants = sum(shift.real.instants for shift in shifts)
    excess = max(shift.real.excess for shift in shifts)
    return Claim(
        f"Measured by real shapes and not by capsules, supervised and planned cranes keep the "
        f"required distance, too ({beyond:.2f} m beyond it at least), and in all {instants} "
        f"instants shapes are no nearer than capsules say (by {-excess:.2f} m at least).",
        beyond >= 0.0 and excess <= 0.0,
    )


def _figure(slews: np.ndarray) -> Figure:
    """Draw the slews of the first two cranes in their boxes.

    Args:
        slews: Slew and ends of the box of each crane [rad], shape (cycles, cranes, 3).
    """
    from cranedyn.plotting.figures import panels

    drawing, axes = panels(2)
    t = CYCLE * np.arange(len(slews))
    for axis, crane, name in zip(axes, (0, 1), "ab", strict=True):
        slew, low, high = np.degrees(slews[:, crane]).T
        axis.fill_between(t, low, high, alpha=0.3, linewidth=0.0)
        axis.plot(t, slew)
        axis.set_ylabel(f"slew of {name} [°]")
    axes[-1].set_xlabel("t [s]")
    return drawing


def main(argv: Sequence[str] | None = None) -> int:
    """Run the experiment and return the exit code."""
    parser = harness.parser("site", __doc__, recording=False, engines=("compiled",))
    harness.add_setup(parser)
    add = parser.add_argument
    text = "sites as TOML, see docs/howto/several_cranes.md, or names of examples"
    add("--site", nargs="+", metavar="FILE", default=EXAMPLES, help=text)
    add("--hours", type=float, default=0.4, help="length of a shift [h]")
    add("--minutes", type=float, default=12.0, help="time of all adversaries on a site [min]")
    add("--jobs", type=int, default=1, metavar="N", help="processes for the adversaries")
    add("--seed", type=int, default=1, help="seed of the adversaries")
    add("--cycles", type=int, default=1000, help="cycles of eight cranes")
    return harness.run_experiment(parser, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
