"""Cranes whose jibs overlap: contacts and lost time in zones, supervised, by plans, or without.

Operators lift loads between random places of all that their crane reaches; adversaries try to
collide, over a network that loses messages.
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

HOOKING, DAMPING = 20.0, 0.05
"""Time to hook or unhook a load [s], and damping ratio of the swing by which an operator follows
the load."""

CARRIED, PLACED = 1.0, 0.8
"""Cable length beyond the shortest while a load is carried, over lower jibs [m], and over the
longest where it is put."""

LOWEST = 4.0
"""Height above ground of the centre of a load where a plan puts it, at least [m]."""

AT, AWAY = {"rad": 4e-3, "m": 0.1}, 10.0
"""Distance at which a drive has arrived, and multiple at which a load is raised again."""

CHANNEL = MessageChannel(0.2, 0.3)
"""Network of the adversaries: latency [s] and share of messages lost."""

ZONE_STEPS = {"rad": math.radians(5.0), "m": 2.5}
"""Steps by which static zones grow."""

PERIOD_OF_PUSHES, PUSHES, LOOK = 10.0, 12, 0.5
"""Time between pushes of an adversary [s], their number before they repeat, and time after which it
looks where the others are [s]."""

GREEDY, MUTATED = 0.8, 0.2
"""Share of the pushes of greedy adversaries that go to the nearest load, and share that a search
draws anew."""

PROTECTIONS = "none", "zones", "supervisor", "plan"
"""What cranes of a shift are protected by."""

KINDS = "random", "greedy", "optimised"
"""Kinds of adversaries."""

COPIES, SEARCH = 300, 12000.0
"""Most copies of a site with adversaries of one kind in lockstep; longest search [min]."""

SPACING, LISTED = 45.0, 8
"""Distance between eight towers in two rows [m], for the time of a cycle; lifts on the lists of a
site from which lost time is judged."""


@dataclass
class LiftOperator:
    """A person who lifts loads from place to place, and follows a load that swings.

    Attributes:
        site: The site.
        index: Index of the crane.
        seed: Seed of the places.
        zone: Box of positions outside of which it lifts nothing, shape (2, m).
        drawn: Number of lifts so far, with those that would lead out of the zone.
        finished: Number in the list of each lift that is done, from 1.
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
        self._rng = np.random.default_rng(self.seed)
        brakes = gentle(self.station, self.site.swing, self.site.working_wind)
        self._ramp = 0.75 * brakes.decelerations
        self._base, self._waits_until = np.zeros(layout.m), 0.0
        self.tolerances = np.array([AT[joint.unit] for joint in layout.driven])
        self._legs: list[np.ndarray] = []

    def places(self) -> np.ndarray:
        """Return where the next lift begins and ends, shape (2, m)."""
        low, high = reach(self.site, self.index)
        while True:
            edge = 0.05 * (high - low)
            drawn = self._rng.uniform(low + edge, high - edge, (2, len(low)))
            drawn[:, self.station.crane.winch] = PLACED * high[self.station.crane.winch]
            if not all(leaves_room(self.site, self.index, position) for position in drawn):
                continue
            self.drawn += 1
            if self.zone is None or ((drawn >= self.zone[0]) & (drawn <= self.zone[1])).all():
                return drawn

    def __call__(self, t: float, states: Sequence[State]) -> np.ndarray:
        """Return the rates [rad/s or m/s], shape (m,)."""
        state, drives = states[self.index], self.station.crane.layout.drives
        q, v, winch = state.q[drives], state.v[drives], self.station.crane.winch
        if not self._legs:
            self._legs = [leg for position in self.places() for leg in self._lift(position)]
        if t < self._waits_until:
            return self._follow(np.zeros_like(q), state, v)
        beside = np.abs(self._legs[0] - q) > AWAY * self.tolerances
        beside[winch] = False
        if len(self._legs) % 3 == 1 and beside.any():  # it withdrew while it lowered the load
            self._legs[:1] = self._lift(self._legs[0])
        gap = np.where(np.isnan(self._legs[0]), 0.0, self._legs[0] - q)
        stands = np.abs(self._base) < 0.02 * self.station.converters.rates
        if ((np.abs(gap) < self.tolerances) & stands).all():
            self._legs.pop(0)
            if len(self._legs) % 3 == 0:
                self._waits_until = t + HOOKING
            if not self._legs:
                self.finished.append(self.drawn)
            return self._follow(np.zeros_like(q), state, v)
        stops = np.sqrt(1.6 * self._ramp * np.maximum(np.abs(gap) - 0.5 * np.abs(self._base), 0.0))
        creeps = 0.15 * np.abs(gap) * (np.abs(gap) < 4.0 * self.tolerances)
        fastest = 0.9 * self.station.converters.rates
        return self._follow(np.sign(gap) * np.minimum(stops + creeps, fastest), state, v)

    def _lift(self, position: np.ndarray) -> list[np.ndarray]:
        """Return where the drives go to bring a load to a position: up, over it, and down."""
        up, over, winch = np.full_like(position, np.nan), position.copy(), self.station.crane.winch
        up[winch] = over[winch] = reach(self.site, self.index)[0][winch] + CARRIED
        return [up, over, position]

    def _follow(self, rates: np.ndarray, state: State, v: np.ndarray) -> np.ndarray:
        crane = self.station.crane
        near = np.clip(self._base, v - 2.0 * self._ramp, v + 2.0 * self._ramp)
        step = self._ramp * CYCLE
        self._base = np.clip(rates, near - step, near + step)
        cable = abs(float(state.q[crane.layout.drives[crane.winch]]))
        _, rope, motion = self.station.rope(state.q[None])
        towards = 2.0 * DAMPING * math.sqrt(crane.gravity * cable) * rope[0, :2]
        return self._base + towards @ np.linalg.pinv(motion[0, :, :2], rcond=1e-3)


@cache
def reach(site: CraneSite, index: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper ends of what the drives of a crane reach, shape (m,) each; it
    slews once around at most, and not through the tower of another.
    """
    station, bodies = site.stations[index], site.bodies
    layout = station.crane.layout
    slew = layout.drive_of("slew")
    low, high = (ends[layout.drives].copy() for ends in (station.crane.lower, station.crane.upper))
    if slew is None:
        return low, high
    low[slew], high[slew] = max(low[slew], -math.pi), min(high[slew], math.pi)
    mine = np.nonzero(~bodies.hangs[index] & (bodies.joint[index] > 0))[0]
    towers = np.argwhere((bodies.joint == 0) & (np.arange(len(site.stations)) != index)[:, None])
    rows = np.array(list(itertools.product(mine, range(len(towers)))))

    def free(angle: float) -> bool:
        for ends in (low, high):
            values = ends.copy()
            values[slew] = angle
            places = np.repeat(site.positions(index, values)[None], len(rows), axis=0)
            crane, tower = np.full(len(rows), index), towers[rows[:, 1]]
            moving = place_capsules(bodies, crane, rows[:, 0], places, places, site.swing)
            still = place_capsules(bodies, tower[:, 0], tower[:, 1], 0 * places, 0 * places, 0.0)
            if not least_distances(moving, still).min() >= 1.5 * site.distance:
                return False
        return True

    for ends, sign in ((low, -1.0), (high, 1.0)):
        angles = np.arange(0.0, sign * ends[slew], math.radians(1.0)) * sign
        ends[slew] = next((a for a in angles if not free(a)), ends[slew] + 0.0)
    return low, high


@dataclass
class Adversary:
    """Operators of a crane on N copies of a site who try to collide: a push of each drive for a
    while, again and again.

    Attributes:
        site: The site.
        index: Index of the crane.
        pushes: Shares of the largest rates, shape (N, `PUSHES`, m); NaN slews towards the nearest
            other crane's load and takes the own load to its radius.
    """

    site: CraneSite
    index: int
    pushes: np.ndarray

    def __post_init__(self) -> None:
        """Begin without a look."""
        self._looks_at, self._signs = np.zeros(len(self.pushes)), 0.0 * self.pushes[:, 0]

    def __call__(self, t: float, states: Sequence[State]) -> np.ndarray:
        """Return the rates [rad/s or m/s], shape (N, m)."""
        push = self.pushes[:, int(t / PERIOD_OF_PUSHES) % PUSHES]
        free = np.isnan(push)
        looks = np.flatnonzero(free.any(axis=1) & (t >= self._looks_at))
        if len(looks):
            self._signs[looks] = self._towards([State(q[looks], v[looks]) for q, v in states])
            self._looks_at[looks] = t + LOOK
        return np.where(free, self._signs, push) * self.site.stations[self.index].converters.rates

    def _towards(self, states: Sequence[State]) -> np.ndarray:
        """Return signs of rates towards the nearest load, shape (N, m)."""
        poses = [x.rope(state.q) for x, state in zip(self.site.stations, states, strict=True)]
        pivot, _, motion = poses.pop(self.index)
        offsets = np.array([point[:, :2] - pivot[:, :2] for point, *_ in poses])
        nearest = np.argmin((offsets * offsets).sum(axis=2), axis=0)
        offset = offsets[nearest, np.arange(len(pivot))]
        return np.sign((motion[:, :, :2] * offset[:, None]).sum(axis=2))


class Shift(NamedTuple):
    """A shift on a site.

    Attributes:
        site: Name of the site.
        protection: What the cranes are protected by.
        run: Its run.
        operators: Its operators.
        listed: Number of lifts on the list of each crane: those that it does without protection.
        real: Distances by the shapes of the cranes, which know nothing of the capsules by which the
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
        """Number of lifts of the lists that are done."""
        pairs = zip(self.operators, self.listed, strict=True)
        return sum(number <= listed for operator, listed in pairs for number in operator.finished)

    @property
    def lost(self) -> float:
        """Share of the lists that is not done in the shift [%]."""
        return 100.0 * (1.0 - self.done / max(sum(self.listed), 1))

    @property
    def crane_minutes(self) -> float:
        """Minutes of all cranes together."""
        return len(self.operators) * self.run.t[-1] / 60.0


class Attack(NamedTuple):
    """Runs of adversaries on a site.

    Attributes:
        site: Name of the site.
        kind: Kind of adversaries.
        crane_minutes: Minutes of all cranes together.
        contacts: Number of contacts.
        least: Least distance beyond the required one [m].
        swing: Largest swing over the largest allowed.
        outside: Largest way of a drive out of its box [rad or m]; negative inside.
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
        """Return what came of copies of a site that ran for a duration [s]."""
        minutes, contacts = len(site.stations) * len(run.least) * duration / 60.0, run.contacts
        least, swing = float(run.least.min()) - site.distance, float(run.swing.max()) / site.swing
        outside = float(run.outside.max())
        return cls(site.name, kind, minutes, int(contacts.sum()), least, swing, outside)

    @classmethod
    def of_shift(cls, shift: Shift) -> Attack:
        """Return what came of a shift."""
        run = shift.run
        each = np.array([len(run.contacts)]), np.array([run.least_distance])
        extremes = SiteExtremes(*each, run.swing, run.outside)
        return cls.of(run.site, shift.protection, run.t[-1], extremes)

    @property
    def most_contacts(self) -> float:
        """Upper bound at 95 % of the contacts in 10⁶ crane-minutes, of a Poisson process."""
        return float(1e6 * pdtri(self.contacts, 0.05) / self.crane_minutes)

    @classmethod
    def all_of(cls, runs: Sequence[Attack]) -> Attack:
        """Return runs of one kind on one site as one."""
        (site, *_), (kind, *_), minutes, contacts, least, swing, outside = zip(*runs, strict=True)
        return cls(site, kind, sum(minutes), sum(contacts), min(least), max(swing), max(outside))


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Work and attack on each site."""
    # Before the shifts, which take minutes.
    number("hours", options.hours, "h", "> 0")
    number("minutes", options.minutes, "min", "> 0")
    whole("seed", options.seed, 0)
    whole("cycles", options.cycles, 1)
    worker_count("jobs", options.jobs)
    shifts, searches = [], math.ceil(options.minutes / SEARCH)
    update = setup.reporter.count("shifts and searches", len(options.site) * (1 + searches))
    for site in map(read_crane_site, options.site):
        shifts += _shifts(site, 3600.0 * options.hours)
        update(len(shifts) // 4)
    minutes, seeds = options.minutes / searches, range(searches)
    with processes(options.jobs) as workers:
        with ignore_sigint():  # submitting starts processes
            tasks = [
                workers.submit(attacks_on, name, 60.0 * minutes, (options.seed, k))
                for name, k in itertools.product(options.site, seeds)
            ]
        for done, _ in enumerate(as_completed(tasks), start=1):
            update(len(options.site) + done)
    runs = [attack for task in tasks for attack in task.result()]
    kinds = dict.fromkeys((run.site, run.kind) for run in runs)
    attacks = [Attack.all_of([x for x in runs if (x.site, x.kind) == kind]) for kind in kinds]
    passes, (slews, *_) = zip(*(supervisor_cycles(options.cycles) for _ in range(3)), strict=True)
    supervised = [shift.run for shift in shifts if shift.protection == "supervisor"]
    return Outcome(
        tables=[*_shift_tables(shifts), _attack_table(attacks), _assumption_table(shifts)],
        claims=_claims(shifts, attacks, np.min(passes, axis=0), set(options.site) <= set(EXAMPLES)),
        figures={"invariant": _figure(slews)},
        texts={f"site_{i + 1}.html": site_html(run) for i, run in enumerate(supervised)},
    )


def _shifts(site: CraneSite, duration: float) -> list[Shift]:
    """Return a shift without protection, in static zones, under the supervisor, and by a plan."""
    results, listed, cranes = [], list[int](), range(len(site.stations))
    for protection in PROTECTIONS[:3]:
        zones = static_zones(site) if protection == "zones" else [None for _ in cranes]
        operators = [LiftOperator(site, i, 100 + i, zones[i]) for i in cranes]
        guarded = protection == "supervisor"
        run = simulate_site(site, operators, duration=duration, supervised=guarded)
        listed = listed or [len(operator.finished) for operator in operators]
        real = real_distances(run)
        results.append(Shift(site.name, protection, run, operators, listed, real))
    return [*results, planned_shift(site, duration, listed)]


def planned_shift(site: CraneSite, duration: float, listed: list[int]) -> Shift:
    """Return a shift in which all cranes follow one plan of the lists, without a supervisor.

    A lift is done if the drives stand at both of its places while the load is hooked and unhooked.
    """
    operators = [LiftOperator(site, i, 100 + i) for i in range(len(site.stations))]
    lowest = [-np.inf, -np.inf, site.ground + LOWEST]
    lifts = [
        (operator.station.name, point)
        for operator in operators
        for _ in range(math.ceil(duration / (2.0 * HOOKING)))
        for point in np.maximum(operator.station.plumb(operator.places())[1], lowest)
    ]
    begin = time.process_time()
    plan = plan_site(site, lifts, stay=HOOKING, until=duration, strict=False)
    planning = time.process_time() - begin
    run = simulate_site(site, plan.operators(), duration=duration, supervised=False)
    arrived: set[tuple[int, int]] = set()
    for crane, motion, begins, lift in plan.lifts:
        rows = slice(math.ceil((begins + motion.arrival) / CYCLE), None)
        q = run.trajectories[crane].q[rows, motion.drives][: round(HOOKING / CYCLE)]
        off = np.abs(q - motion.q[-1, motion.drives])
        if len(q) == round(HOOKING / CYCLE) and (off <= operators[crane].tolerances).all() and lift:
            arrived.add((crane, lift))
    for i, operator in enumerate(operators):
        pairs = range(1, operator.drawn + 1)
        operator.finished = [n for n in pairs if {(i, 2 * n - 1), (i, 2 * n)} <= arrived]
    count = sum(bool(motion.lift) for motion in plan.lifts) / 2.0
    each = planning / max(count, 1.0)
    return Shift(site.name, "plan", run, operators, listed, real_distances(run), plan, each)


@cache
def static_zones(site: CraneSite) -> list[np.ndarray]:
    """Return a box of positions for each crane, shape (2, m), all of them proven apart: in turn
    each end of each drive is moved outwards by a step, until none can be.
    """
    zones = [Guard(station, site.swing).box[0] for station in site.stations]
    units = [[joint.unit for joint in station.crane.layout.driven] for station in site.stations]
    ends = [np.array(reach(site, i)) for i in range(len(site.stations))]
    for i, station in enumerate(site.stations):  # hoists at first
        larger = zones[i].copy()
        larger[:, station.crane.winch] = ends[i][:, station.crane.winch]
        if site.apart(i, larger, zones).all():
            zones[i] = larger
    grown = True
    while grown:
        grown = False
        for i, end in itertools.product(range(len(zones)), (0, 1)):
            for drive, unit in enumerate(units[i]):
                larger = zones[i].copy()
                step = ZONE_STEPS[unit] * (2 * end - 1)
                larger[end, drive] = np.clip(larger[end, drive] + step, *ends[i][:, drive])
                moved = abs(larger[end, drive] - zones[i][end, drive]) > 1e-9
                if moved and site.apart(i, larger, zones).all():
                    zones[i], grown = larger, True
    return zones


def attacks_on(name: str, duration: float, seed: Sequence[int]) -> list[Attack]:
    """Return attacks on a site of a third of a duration [s] each: random, greedy, and optimised."""
    site = read_crane_site(name)
    rng, length = np.random.default_rng(seed), PERIOD_OF_PUSHES * PUSHES
    count = max(1, round(duration / 3.0 / length))
    rounds = math.ceil(count / COPIES)
    copies = math.ceil(count / rounds)
    shapes = [(copies, PUSHES, station.crane.layout.m) for station in site.stations]

    def drawn(fresh: float, pushes: Sequence[np.ndarray | float]) -> list[np.ndarray]:
        """Return pushes with a share of random ones."""
        return [
            np.where(rng.random(shape) < fresh, rng.integers(-1, 2, shape), x)
            for shape, x in zip(shapes, pushes, strict=True)
        ]

    best, nearest = drawn(1.0, [0.0] * len(shapes)), np.full(copies, math.inf)
    attacks: list[Attack] = []
    for _ in range(rounds):
        trial = drawn(MUTATED, best)
        kinds = drawn(1.0, best), drawn(1.0 - GREEDY, [math.nan] * len(shapes)), trial
        pushes = [np.concatenate(x) for x in zip(*kinds, strict=True)]
        run = simulate_copies(
            site,
            [Adversary(site, i, mine) for i, mine in enumerate(pushes)],
            copies=3 * copies,
            duration=length,
            channel=CHANNEL,
            seed=int(rng.integers(2**32)),
        )
        by_kind = zip(*(np.split(x, 3) for x in run), strict=True)
        for kind, extremes in zip(KINDS, by_kind, strict=True):
            attacks.append(Attack.of(site, kind, length - CYCLE, SiteExtremes(*extremes)))
        # A random search: copies of the nearest, of which some pushes are drawn anew.
        merged = np.concatenate([nearest, run.least[-copies:]])
        order = np.resize(np.argsort(merged, kind="stable")[: math.ceil(copies / 4)], copies)
        best = [np.concatenate(pair)[order] for pair in zip(best, trial, strict=True)]
        nearest = merged[order]
    return attacks


def supervisor_cycles(cycles: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the processor time of each cycle of a supervisor for eight cranes [s], shape
    (cycles,), whose drives follow exactly, and slews of the cranes and both ends of their boxes
    [rad], shape (cycles, 8, 3).
    """
    four = read_crane_site("four_towers")
    feet = [np.array([SPACING * (i % 4), SPACING * (i // 4), 3.0 * i]) for i in range(8)]
    headings = [math.copysign(math.pi / 2.0, i - 3.5) for i in range(8)]
    stations = [
        replace(four.stations[i % 4], name=str(i), foot=foot, heading=heading)
        for i, (foot, heading) in enumerate(zip(feet, headings, strict=True))
    ]
    site = CraneSite("eight towers", tuple(stations), swing=four.swing)
    guards, rng = [Guard(station, site.swing) for station in stations], np.random.default_rng(0)
    supervisor = Supervisor(site, [guard.box for guard in guards])
    states = [State(*(x[None].copy() for x in station.crane.start)) for station in stations]
    commands = [np.zeros((1, 3))] * len(stations)
    times, rows = np.zeros(cycles), []
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
        pairs = zip(guards, states, strict=True)
        rows.append([(*state.q[0, drives[:1]], *guard.box[0, :, 0]) for guard, state in pairs])
    return times, np.array(rows)


def _shift_tables(shifts: Sequence[Shift]) -> list[ResultTable]:
    """Return tables of the shifts of all sites together, and of each."""

    def total(value: Callable[[Shift], float]) -> Callable[[Sequence[Shift]], float]:
        return lambda group: sum(map(value, group))

    def minutes(time: Callable[[SitePlan], float]) -> Callable[[Sequence[Shift]], float | None]:
        return lambda group: sum(time(x.plan) for x in group if x.plan) / 60.0 or None

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
    kinds = [[x for x in shifts if x.protection == kind] for kind in PROTECTIONS]
    site: Column = ("site", "", lambda group: group[0].site)
    note = """The list: what a crane lifts without protection; zones leave lifts out, do later ones.
Operators raise each load first; plans only where that is quicker."""
    texts = [f"{x.site}: {text}" for x in shifts if x.plan for text in x.plan.refusals]
    return [
        make_table("Shifts of random lifts", kinds, *columns, note=note),
        make_table("By site", [[x] for x in shifts], site, *columns, note="\n".join(texts)),
    ]


def _attack_table(attacks: Sequence[Attack]) -> ResultTable:
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
    """Return what the promises of all sites rest on."""
    sites = [shift.run.site for shift in shifts if shift.protection == PROTECTIONS[0]]
    rows = [(site.name, x) for site in sites for x in site_assumptions(site)]
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
    kinds = {kind: [x for x in shifts if x.protection == kind] for kind in PROTECTIONS}
    bare, zoned, guarded, planned = kinds.values()
    runs = Attack.all_of([*attacks, *map(Attack.of_shift, guarded)])
    plans, minutes = Attack.all_of([*map(Attack.of_shift, planned)]), runs.crane_minutes
    lost = [(shift.lost, zone.lost) for shift, zone in zip(guarded, zoned, strict=True)]
    judged = ours and min(sum(shift.listed) for shift in shifts) >= LISTED
    proven = all(shift.plan.holds for shift in planned if shift.plan)
    both = [(shift.done, bound.done) for shift, bound in zip(planned, guarded, strict=True)]
    slowest = max(shift.planning for shift in planned)
    touches = sum(len(shift.run.contacts) for shift in bare)
    overlaps = sum(shift.real.overlaps for shift in bare)
    uncounted = sum(shift.real.uncounted for shift in bare)
    kept = [*guarded, *planned]
    beyond = min(shift.real.least - shift.run.site.distance for shift in kept)
    instants = sum(shift.real.instants for shift in shifts)
    excess = max(shift.real.excess for shift in shifts)
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
        Claim(
            f"Without protection they touch (contacts: {touches}): a contact was counted before "
            f"each of {overlaps} instants in which real shapes overlap.",
            (touches > 0 and not uncounted) if touches or overlaps else None,
        ),
        Claim(
            "Supervised cranes leave less than half of the lifts undone that static zones do: "
            f"{', '.join(f'{share:.0f} of {zones:.0f} %' for share, zones in lost)}.",
            all(share < zones / 2.0 for share, zones in lost) if judged else None,
        ),
        Claim(
            f"Planned cranes are proven apart, do not touch in {plans.crane_minutes:.0f} crane-"
            "minutes without a supervisor, keep distance and swing "
            f"({100.0 * plans.swing:.0f} % of it).",
            proven and plans.contacts == 0 and plans.least >= 0.0 and plans.swing <= 1.0,
        ),
        Claim(
            "Plans do at least as many lifts of the lists as operators under the supervisor: "
            f"{', '.join(f'{mine} and {supervised}' for mine, supervised in both)}.",
            all(mine >= supervised for mine, supervised in both) if judged else None,
        ),
        Claim(
            f"Measured by real shapes and not by capsules, supervised and planned cranes keep the "
            f"required distance, too ({beyond:.2f} m beyond it at least), and in all {instants} "
            f"instants shapes are no nearer than capsules say (by {-excess:.2f} m at least).",
            beyond >= 0.0 and excess <= 0.0,
        ),
        Claim(f"Plans take less than 2 s a lift ({slowest:.2f} s, slowest site).", slowest < 2.0),
        Claim(
            f"A cycle for eight cranes takes less than 5 ms ({1e3 * times.max():.1f} ms at most, "
            f"{1e3 * np.median(times):.1f} ms in the median; the least of three passes).",
            bool(times.max() < 5e-3),
        ),
    ]


def _figure(slews: np.ndarray) -> Figure:
    """Draw the slews of two cranes in their boxes."""
    from cranedyn.plotting.figures import panels

    drawing, axes = panels(2)
    t, sides = CYCLE * np.arange(len(slews)), np.degrees(np.moveaxis(slews[:, :2], 0, 2))
    for axis, (slew, low, high), name in zip(axes, sides, "ab", strict=True):
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
