"""From a site with obstacles to a motion that provably touches nothing: planned, certified, and
made ten thousand times not quite so.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cranedyn.errors import DataError, number, whole
from cranedyn.planning.certificate import Certificate, certify
from cranedyn.planning.lift import Lift, crane_of, plan_lift
from cranedyn.planning.perturbed import CONFIDENCE, Perturbed, perturb
from cranedyn.planning.site import Site
from cranedyn.planning.site_file import SITES, read_site
from experiments import harness
from experiments.scenarios.moves import LIMITS

EXAMPLES = ("open_yard", "city_block", "tower", "neighbour")
"""Sites that come with the project."""

LIFTS = 10_000
"""How many lifts are made that are not quite as planned."""

OF_BOUND, OF_LEAST, IN_LEAST_TIME = 1.25, 1.4, 1.25
"""How long the drives may need along the way, how long a planned motion may last, and one in least
time, over the time that no motion falls short of."""

_APART = 90.0


@dataclass(frozen=True, eq=False)
class Made:
    """A lift with all that is known of it.

    Attributes:
        site: Where.
        certificate: What it is held against.
        perturbed: What became of lifts not quite like it; None if none were made.
        seconds: How long planning, certifying and perturbing took [s].
        least: The same lift in least time; None if it was not asked for.
        searched: How long that took to find [s].
    """

    site: Site
    certificate: Certificate
    perturbed: Perturbed | None
    seconds: tuple[float, float, float]
    least: Certificate | None = None
    searched: float = 0.0


def experiment(options: argparse.Namespace, setup: harness.Setup) -> harness.Outcome:
    """Plan and certify a lift on each site."""
    from cranedyn.recording import Run
    from experiments.lift_figures import over_time, scenery, views

    count = whole("lifts", options.lifts, 0)
    names = [Path(file).stem for file in options.site] if options.site else list(EXAMPLES)
    if len(set(names)) < len(names):
        raise DataError(f"Two sites have one name: {', '.join(names)}.")
    sites = [
        read_site(file) for file in options.site or [SITES / f"{name}.toml" for name in EXAMPLES]
    ]
    for what in ("start", "goal"):
        if getattr(options, what) is not None and len(sites) != 1:
            raise DataError(
                f"--{'from' if what == 'start' else 'to'} is for one site; give one with --site."
            )
    made = {
        name: _made(setup, site, options, count) for name, site in zip(names, sites, strict=True)
    }
    certified = {name: one for name, one in made.items() if one.certificate.holds}
    return harness.Outcome(
        tables=[*_tables(certified), *_least_time(certified), _times(made)],
        claims=[
            claim
            for name, one in made.items()
            for claim in [*_claims(name, one), *_least_claims(name, one)]
        ],
        parameters=setup.parameters()
        | {
            "sites": names,
            "lifts": count,
            "limits": {
                name: [list(kept.rates), list(kept.accelerations)]
                for name, kept in ((n, one.certificate.lift.limits) for n, one in made.items())
            },
        },
        trajectories={f"lift_{name}": one.certificate.run for name, one in made.items()}
        | {f"least_time_{name}": one.least.run for name, one in made.items() if one.least},
        figures={
            f"{kind}_{name}": draw(one.certificate)
            for name, one in certified.items()
            for kind, draw in (("site", views), ("time", over_time))
        },
        recording=[
            Run(
                one.site.name,
                one.certificate.lift.crane,
                one.certificate.run,
                (_APART * i, 0.0, 0.0),
                scenery=scenery(one.certificate),
            )
            for i, one in enumerate(made.values())
        ],
    )


def _made(setup: harness.Setup, site: Site, options: argparse.Namespace, count: int) -> Made:
    begun = time.monotonic()
    crane = crane_of(site, gravity=setup.gravity, **setup.values)
    start, goal = (
        None if point is None else np.array([number("coordinate", one, "m") for one in point])
        for point in (options.start, options.goal)
    )
    limits = site.limits or LIMITS
    lift = plan_lift(site, limits, start=start, goal=goal, crane=crane, period=setup.control_period)
    planned = time.monotonic()
    certificate = certify(lift, dt=setup.dt, engine=setup.engine)
    done = time.monotonic()
    perturbed = (
        perturb(certificate, count, dt=2.0 * setup.dt) if count and certificate.holds else None
    )
    seconds = planned - begun, done - planned, time.monotonic() - done
    least, begun = None, time.monotonic()
    if options.least_time and certificate.holds:
        least = certify(_shortened(lift), dt=setup.dt, engine=setup.engine)
    return Made(site, certificate, perturbed, seconds, least, time.monotonic() - begun)


def _shortened(lift: Lift) -> Lift:
    from cranedyn.planning.least_time import in_least_time

    return in_least_time(lift)


def _least_time(made: dict[str, Made]) -> list[harness.Table]:
    """The same lifts as fast as they can be, beside the planned ones."""
    rows: list[list[float | str | None]] = []
    for name, one in made.items():
        if one.least is not None and one.least.holds:
            timed, planned = one.least.lift.timed, one.certificate.lift.timed.motion.arrival
            least = timed.motion.arrival
            bound = one.certificate.lift.least
            times = [planned, least, planned / bound, least / bound]
            near, swing = one.least.nearest.distance, 1e3 * timed.shares["swing"] * one.site.swing
            rows.append([name, *times, near, swing, 1e3 * one.least.left, one.searched])
    columns = [
        ("site", ""),
        ("planned [s]", ".2f"),
        ("least time [s]", ".2f"),
        ("planned over bound", ".3f"),
        ("least over bound", ".3f"),
        ("clearance [m]", ".2f"),
        ("swing [mrad]", ".1f"),
        ("at arrival [mrad]", ".4f"),
        ("found in [s]", ".1f"),
    ]
    note = (
        "The same lifts with motions of least time near the planned ones, as proven and as "
        "certified. Over bound: beside what drives need at least, whichever way round."
    )
    return [harness.Table("In least time", columns, rows, note)] if rows else []


def _least_claims(name: str, made: Made) -> list[harness.Claim]:
    if made.least is None:
        return []
    planned, least = made.certificate.lift, made.least.lift.timed.motion.arrival
    claims = [
        harness.Claim(f"{name} in least time: {check.sentence}", check.holds)
        for check in made.least.checks
    ]
    sentence = (
        f"{name}: in least time it lasts {least / planned.least:.3f} times what drives need at "
        f"least, at most {IN_LEAST_TIME:g}, and less than planned."
    )
    holds = planned.least * IN_LEAST_TIME >= least < planned.timed.motion.arrival
    return [*claims, harness.Claim(sentence, holds)]


def _tables(made: dict[str, Made]) -> list[harness.Table]:
    """What was certified, and what became of lifts not quite like it; nothing of a plan that does
    not hold.
    """
    rows: list[list[float | str | None]] = []
    spread: list[list[float | str | None]] = []
    for name, one in made.items():
        lift, certificate = one.certificate.lift, one.certificate
        timed = lift.timed
        near = certificate.nearest
        ways = [lift.way, lift.on_grid, lift.least]
        motion = [timed.bound, timed.motion.arrival, timed.motion.arrival / lift.least]
        swing = 1e3 * timed.shares["swing"] * one.site.swing
        rows.append([name, *ways, *motion, near.distance, f"{near.body}, {near.obstacle}", swing])
        if one.perturbed is not None:
            low, high = one.perturbed.interval()
            least, lifts = float(np.nanmin(one.perturbed.least)), len(one.perturbed.least)
            share = 100.0 * one.perturbed.nearer / lifts
            swing = 1e3 * float(one.perturbed.swing.max())
            spread.append(
                [name, lifts, one.perturbed.nearer, share, 100.0 * low, 100.0 * high, least, swing]
            )
    columns = [
        ("site", ""),
        ("way [s]", ".2f"),
        ("grid [s]", ".2f"),
        ("bound [s]", ".2f"),
        ("drives [s]", ".2f"),
        ("motion [s]", ".2f"),
        ("over bound", ".3f"),
    ]
    columns += [("clearance [m]", ".2f"), ("of", ""), ("swing [mrad]", ".1f")]
    note = (
        "Way: the path at full speed of the drives; grid: the best on cells of 0.5 s with no more "
        "room than required, whichever way round. Bound: what the drives need at least, by that "
        "grid and from start to goal. Drives: what they need along the path without a thought of "
        "the load; motion: "
        "with the load at rest at the end. Clearance: the least in the simulation."
    )
    tables = [harness.Table("Certified lifts", columns, rows, note)]
    if spread:
        columns = [
            ("site", ""),
            ("lifts", "d"),
            ("nearer", "d"),
            ("%", ".2f"),
            ("from %", ".3f"),
            ("to %", ".3f"),
            ("least [m]", ".2f"),
            ("swing after [mrad]", ".1f"),
        ]
        note = (
            f"Nearer than required; its probability lies from … to with {100 * CONFIDENCE:g} % "
            "confidence (Clopper "
            "and Pearson). Load ±30 %, cable ±0.5 m off its measure, wind up to 4 m/s with a gust "
            "of up to 6 m/s "
            "more, sensors up to 20 ms late. Least: negative where something is run into."
        )
        tables.append(harness.Table("Lifts not quite as planned", columns, spread, note))
    return tables


def _times(made: dict[str, Made]) -> harness.Table:
    columns = [
        ("site", ""),
        ("planned [s]", ".1f"),
        ("certified [s]", ".1f"),
        ("perturbed [s]", ".1f"),
    ]
    return harness.Table(
        "How long it took on this machine",
        columns,
        [(name, *one.seconds) for name, one in made.items()],
    )


def _claims(name: str, made: Made) -> list[harness.Claim]:
    lift = made.certificate.lift
    claims = [
        harness.Claim(f"{name}: {check.sentence}", check.holds) for check in made.certificate.checks
    ]
    if made.certificate.holds:
        claims += [
            harness.Claim(
                f"{name}: {what} {lasts / lift.least:.3f} times what drives need at least, "
                f"whichever way round; at most {most:g}.",
                lasts <= most * lift.least,
            )
            for what, lasts, most in (
                ("along the way the drives need", lift.timed.bound, OF_BOUND),
                ("the motion lasts", lift.timed.motion.arrival, OF_LEAST),
            )
        ]
    return claims


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    made = harness.parser(
        "lift",
        "From a site with obstacles to a motion that provably touches nothing.",
        engines=("compiled", "pinocchio"),
    )
    harness.add_setup(made, "payload_mass")
    made.add_argument(
        "--site",
        nargs="+",
        metavar="FILE",
        default=None,
        help="sites as TOML, see docs/lift.md; all examples if not given",
    )
    made.add_argument(
        "--from",
        dest="start",
        nargs=3,
        type=float,
        metavar=("X", "Y", "Z"),
        help="centre of the load at the start, in the site's frame [m]",
    )
    made.add_argument(
        "--to",
        dest="goal",
        nargs=3,
        type=float,
        metavar=("X", "Y", "Z"),
        help="the same at the end",
    )
    made.add_argument(
        "--lifts",
        type=int,
        default=LIFTS,
        metavar="N",
        help="how many lifts to make that are not quite as planned; 0 for none",
    )
    made.add_argument(
        "--least-time",
        action="store_true",
        help="also make each lift as short as it can be, some ten seconds a site (extra `optimal`)",
    )
    return harness.run_experiment(made, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
