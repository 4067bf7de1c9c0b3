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

A site whose file lists lifts of its own, as [[lift]], is not attacked: these lifts are planned as
one shift, simulated under the supervisor and shown with their timetable, see
`experiments.site.shift_outcome`.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed

from cranedyn.checks import number, whole, worker_count
from cranedyn.errors import DataError
from cranedyn.lifts.sites.adversaries import Attack, attacks_on
from cranedyn.lifts.sites.crane_site_file import (
    EXAMPLES,
    crane_site_path,
    lists_lifts,
    read_crane_site,
)
from cranedyn.lifts.sites.site_page import site_html
from cranedyn.sweep.workers import ignore_sigint
from experiments import harness
from experiments.harness import Outcome, Setup
from experiments.harness.processes import processes
from experiments.site.shift_outcome import shift_outcome
from experiments.site.shifts import Shift, shifts_on
from experiments.site.site_results import (
    assumption_table,
    attack_table,
    shift_tables,
    site_claims,
)
from experiments.site.supervisor_timing import slews_figure, timed_cycles

MAX_SEARCH_TIME = 12000.0
"""Longest time of adversaries in one search [min]; more is divided among searches, which can run in
processes of their own."""


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Work and attack on each site."""
    # Checked before the shifts, which take minutes.
    number("hours", options.hours, "h", "> 0")
    number("minutes", options.minutes, "min", "> 0")
    whole("seed", options.seed, 0)
    whole("cycles", options.cycles, 1)
    worker_count("jobs", options.jobs)

    sites = [read_crane_site(name) for name in options.site]
    listed = [name for name, site in zip(options.site, sites, strict=True) if site.lifts]
    if listed and len(sites) > 1:
        raise DataError(f"{listed[0]} lists lifts, which are planned alone; give no other --site.")
    if listed:
        source = crane_site_path(options.site[0])
        return shift_outcome(sites[0], setup, source, options.folder if options.reports else None)

    searches = math.ceil(options.minutes / MAX_SEARCH_TIME)
    update = setup.reporter.count("shifts and searches", len(options.site) * (1 + searches))
    shifts: list[Shift] = []
    for count, site in enumerate(sites, start=1):
        shifts += shifts_on(site, 3600.0 * options.hours)
        update(count)
    attacks = _search_all(options, searches, update)

    cycles = timed_cycles(options.cycles)
    supervised = [shift.run for shift in shifts if shift.protection == "supervisor"]
    are_ours = set(options.site) <= set(EXAMPLES)
    return Outcome(
        tables=[*shift_tables(shifts), attack_table(attacks), assumption_table(shifts)],
        claims=site_claims(shifts, attacks, cycles.times, are_ours),
        figures={"invariant": slews_figure(cycles.slews)},
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


def main(argv: Sequence[str] | None = None) -> int:
    """Run the experiment and return the exit code."""
    parser = harness.parser("site", __doc__, engines=("compiled",))
    harness.add_setup(parser)
    add = parser.add_argument
    text = "sites as TOML, see docs/howto/several_cranes.md, or names of examples"
    add("--site", nargs="+", metavar="FILE", default=EXAMPLES, help=text)
    add("--hours", type=float, default=0.4, help="length of a shift [h]")
    add("--minutes", type=float, default=12.0, help="time of all adversaries on a site [min]")
    add("--jobs", type=int, default=1, metavar="N", help="processes for the adversaries")
    add("--seed", type=int, default=1, help="seed of the adversaries")
    add("--cycles", type=int, default=1000, help="cycles of eight cranes")
    text = "write a report of each lift, too, see docs/howto/several_cranes.md"
    add("--reports", action="store_true", help=text)
    needed = "a site without [[lift]] entries"
    of_attacks = ("hours", "minutes", "jobs", "seed", "cycles")
    harness.add_condition(parser, needed, lambda options: not _lists_lifts(options), *of_attacks)
    needed = "a site with [[lift]] entries"
    of_shifts = ("save", "view", "serve", "film", "reports")
    harness.add_condition(parser, needed, _lists_lifts, *of_shifts)
    return harness.run_experiment(parser, experiment, argv)


def _lists_lifts(options: argparse.Namespace) -> bool:
    """Return whether a site of the command line lists lifts."""
    return any(lists_lifts(name) for name in options.site)
