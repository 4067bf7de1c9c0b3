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
import time
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cranedyn.checks import number, whole, worker_count
from cranedyn.interfaces import State
from cranedyn.lifts.sites.adversaries import CHANNEL, Attack, attacks_on
from cranedyn.lifts.sites.brakes import CYCLE
from cranedyn.lifts.sites.crane_site import CraneSite
from cranedyn.lifts.sites.crane_site_file import EXAMPLES, read_crane_site
from cranedyn.lifts.sites.guard import BoxRequest, Guard
from cranedyn.lifts.sites.operators import HOOKING_TIME, LiftOperator
from cranedyn.lifts.sites.plan import SitePlan, plan_site
from cranedyn.lifts.sites.promise import site_assumptions
from cranedyn.lifts.sites.site_page import site_html
from cranedyn.lifts.sites.site_simulation import SiteExtremes, SiteRun, simulate_site
from cranedyn.lifts.sites.supervisor import Supervisor
from cranedyn.lifts.sites.zones import static_zones
from cranedyn.sweep.workers import ignore_sigint
from experiments import harness
from experiments.harness import Claim, Column, Outcome, ResultTable, Setup, make_table
from experiments.harness.processes import processes
from experiments.site.real_shapes import RealDistances, real_distances

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PROTECTIONS = ("none", "zones", "supervisor", "plan")
"""What protects the cranes of a shift: nothing, static zones, the supervisor, or a common plan."""

MIN_LOAD_HEIGHT = 4.0
"""Least height above ground of the centre of a load where a plan puts it [m]."""

MAX_SEARCH_TIME = 12000.0
"""Longest time of adversaries in one search [min]; more is divided among searches, which can run in
processes of their own."""

# --- time of a cycle, and claims ------------------------------------------------------------------

TOWER_SPACING = 45.0
"""Distance between eight towers in two rows, for the time of a cycle [m]."""

MIN_LISTED = 8
"""Number of lifts on the lists of a site from which on lost time is judged."""


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


def _attack_of_shift(shift: Shift) -> Attack:
    """Return the result of a shift in the terms of an attack, with its protection as the kind."""
    run = shift.run
    contacts = np.array([len(run.contacts)])
    least = np.array([run.least_distance])
    extremes = SiteExtremes(contacts, least, run.swing, run.outside)
    return Attack.of(run.site, shift.protection, run.t[-1], extremes)


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
                tasks.append(workers.submit(_attacks_on_file, name, duration, seed))
        for done, _ in enumerate(as_completed(tasks), start=1):
            update(len(options.site) + done)

    by_kind: dict[tuple[str, str], list[Attack]] = {}
    for task in tasks:
        for attack in task.result():
            by_kind.setdefault((attack.site, attack.kind), []).append(attack)
    return [Attack.all_of(runs) for runs in by_kind.values()]


def _attacks_on_file(name: str, duration: float, seed: Sequence[int]) -> list[Attack]:
    """Return attacks on a site by its name or file, see `attacks_on`."""
    return attacks_on(read_crane_site(name), duration, seed)


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
    runs = Attack.all_of([*attacks, *(_attack_of_shift(shift) for shift in supervised)])
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
    plans = Attack.all_of([_attack_of_shift(shift) for shift in planned])
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
