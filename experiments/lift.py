"""From a site with obstacles to a motion that provably touches nothing: planned, certified, and
simulated ten thousand times with perturbations.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cranedyn.checks import number, whole
from cranedyn.errors import DataError
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
"""Number of perturbed lifts."""

OF_BOUND, OF_LEAST, IN_LEAST_TIME = 1.25, 1.4, 1.25
"""How long the drives may need along the way, how long a planned motion may last, and one in least
time, over the time that no motion falls short of."""

_APART = 90.0
"""Distance between the sites in the recording [m]."""

Rows = list[list[float | str | None]]


@dataclass(frozen=True, eq=False)
class SiteResult:
    """The lift of a site.

    Attributes:
        site: The site.
        certificate: The planned lift, simulated and checked against the site.
        perturbed: Perturbed lifts; None if none were made.
        seconds: Time that planning, certifying and perturbing took [s].
        least: The same lift in least time; None if it was not asked for.
        least_seconds: Time that finding it took [s].
    """

    site: Site
    certificate: Certificate
    perturbed: Perturbed | None
    seconds: tuple[float, float, float]
    least: Certificate | None = None
    least_seconds: float = 0.0


def experiment(options: argparse.Namespace, setup: harness.Setup) -> harness.Outcome:
    """Plan and certify a lift on each site."""
    from cranedyn.lifting.figures import clearance_over_time, scenery, site_views
    from cranedyn.recording import Run

    count = whole("lifts", options.lifts, 0)
    results = {name: _result(setup, site, options, count) for name, site in _sites(options)}
    certified = {name: result for name, result in results.items() if result.certificate.holds}
    figures = {}
    for name, result in certified.items():
        figures[f"site_{name}"] = site_views(result.certificate)
        figures[f"time_{name}"] = clearance_over_time(result.certificate)
    trajectories = {f"lift_{name}": result.certificate.run for name, result in results.items()}
    for name, result in results.items():
        if result.least:
            trajectories[f"least_time_{name}"] = result.least.run
    limits = {name: result.certificate.lift.limits for name, result in results.items()}
    return harness.Outcome(
        tables=[*_tables(certified), *_least_time(certified), _times(results)],
        claims=[claim for name, result in results.items() for claim in _claims(name, result)],
        parameters=setup.parameters()
        | {
            "sites": list(results),
            "lifts": count,
            "limits": {
                name: [list(limit.rates), list(limit.accelerations)]
                for name, limit in limits.items()
            },
        },
        trajectories=trajectories,
        figures=figures,
        recording=[
            Run(
                result.site.name,
                result.certificate.lift.crane,
                result.certificate.run,
                (_APART * i, 0.0, 0.0),
                scenery=scenery(result.certificate),
            )
            for i, result in enumerate(results.values())
        ],
    )


def _sites(options: argparse.Namespace) -> list[tuple[str, Site]]:
    files = options.site or [SITES / f"{name}.toml" for name in EXAMPLES]
    names = [Path(file).stem for file in files]
    if len(set(names)) < len(names):
        raise DataError(f"Two sites have one name: {', '.join(names)}.")
    sites = [read_site(file) for file in files]
    for end, option in (("start", "--from"), ("goal", "--to")):
        if getattr(options, end) is not None and len(sites) != 1:
            raise DataError(f"{option} is for one site; give one with --site.")
    return list(zip(names, sites, strict=True))


def _result(
    setup: harness.Setup, site: Site, options: argparse.Namespace, count: int
) -> SiteResult:
    started = time.monotonic()
    crane = crane_of(site, gravity=setup.gravity, **setup.values)
    start, goal = (
        None if point is None else np.array([number("coordinate", value, "m") for value in point])
        for point in (options.start, options.goal)
    )
    limits = site.limits or LIMITS
    lift = plan_lift(site, limits, start=start, goal=goal, crane=crane, period=setup.control_period)
    planned = time.monotonic()
    certificate = certify(lift, dt=setup.dt, engine=setup.engine)
    certified = time.monotonic()
    perturbed = (
        perturb(certificate, count, dt=2.0 * setup.dt) if count and certificate.holds else None
    )
    seconds = planned - started, certified - planned, time.monotonic() - certified
    shortest_lift, started = None, time.monotonic()
    if options.least_time and certificate.holds:
        shortest_lift = certify(_shortened(lift), dt=setup.dt, engine=setup.engine)
    return SiteResult(
        site, certificate, perturbed, seconds, shortest_lift, time.monotonic() - started
    )


def _shortened(lift: Lift) -> Lift:
    from cranedyn.planning.least_time import in_least_time

    return in_least_time(lift)


def _tables(results: dict[str, SiteResult]) -> list[harness.ResultTable]:
    tables = [_certified(results)]
    perturbed = {name: result.perturbed for name, result in results.items() if result.perturbed}
    return [*tables, _perturbed(perturbed)] if perturbed else tables


def _certified(results: dict[str, SiteResult]) -> harness.ResultTable:
    rows: Rows = []
    for name, result in results.items():
        lift, nearest = result.certificate.lift, result.certificate.nearest
        times = [lift.way, lift.on_grid, lift.least, lift.timed.bound, lift.timed.motion.arrival]
        swing = 1e3 * lift.timed.shares["swing"] * result.site.swing
        bodies = f"{nearest.body}, {nearest.obstacle}"
        share = lift.timed.motion.arrival / lift.least
        rows.append([name, *times, share, nearest.distance, bodies, swing])
    columns = [
        ("site", ""),
        ("way [s]", ".2f"),
        ("grid [s]", ".2f"),
        ("bound [s]", ".2f"),
        ("drives [s]", ".2f"),
        ("motion [s]", ".2f"),
        ("motion / bound", ".3f"),
        ("clearance [m]", ".2f"),
        ("of", ""),
        ("swing [mrad]", ".1f"),
    ]
    note = (
        "Way: the path at full speed of the drives; grid: the best on cells of 0.5 s with no more "
        "clearance than required, whichever way round. Bound: what the drives need at least, by "
        "that grid and from start to goal. Drives: what they need along the path without a thought "
        "of the load; motion: with the load at rest at the end. Clearance: the least in the "
        "simulation."
    )
    return harness.ResultTable("Certified lifts", columns, rows, note)


def _perturbed(results: dict[str, Perturbed]) -> harness.ResultTable:
    rows: Rows = []
    for name, perturbed in results.items():
        count, failures = len(perturbed.least), perturbed.failures
        shares = [100.0 * share for share in (failures / count, *perturbed.interval())]
        clearance, swing = float(np.nanmin(perturbed.least)), 1e3 * float(perturbed.swing.max())
        rows.append([name, count, failures, *shares, clearance, swing])
    columns = [
        ("site", ""),
        ("lifts", "d"),
        ("below required clearance", "d"),
        ("%", ".2f"),
        ("from %", ".3f"),
        ("to %", ".3f"),
        ("least [m]", ".2f"),
        ("swing after [mrad]", ".1f"),
    ]
    note = (
        f"The probability lies from … to with {100 * CONFIDENCE:g} % confidence (Clopper and "
        "Pearson). Load ±30 %, cable ±0.5 m off its measure, wind up to 4 m/s with a gust of up to "
        "6 m/s more, sensors up to 20 ms late. Least: negative where something is run into."
    )
    return harness.ResultTable("Perturbed lifts", columns, rows, note)


def _least_time(results: dict[str, SiteResult]) -> list[harness.ResultTable]:
    rows: Rows = []
    for name, result in results.items():
        if result.least is not None and result.least.holds:
            timed, bound = result.least.lift.timed, result.certificate.lift.least
            planned, shortest_time = (
                result.certificate.lift.timed.motion.arrival,
                timed.motion.arrival,
            )
            times = [planned, shortest_time, planned / bound, shortest_time / bound]
            swing = 1e3 * timed.shares["swing"] * result.site.swing
            nearest, residual = result.least.nearest.distance, 1e3 * result.least.residual_swing
            rows.append([name, *times, nearest, swing, residual, result.least_seconds])
    columns = [
        ("site", ""),
        ("planned [s]", ".2f"),
        ("least time [s]", ".2f"),
        ("planned / bound", ".3f"),
        ("least / bound", ".3f"),
        ("clearance [m]", ".2f"),
        ("swing [mrad]", ".1f"),
        ("at arrival [mrad]", ".4f"),
        ("found in [s]", ".1f"),
    ]
    note = (
        "The same lifts with motions of least time near the planned ones, as proven and as "
        "certified. Bound: what drives need at least, whichever way round."
    )
    return [harness.ResultTable("In least time", columns, rows, note)] if rows else []


def _times(results: dict[str, SiteResult]) -> harness.ResultTable:
    columns = [
        ("site", ""),
        ("planned [s]", ".1f"),
        ("certified [s]", ".1f"),
        ("perturbed [s]", ".1f"),
    ]
    rows = [(name, *result.seconds) for name, result in results.items()]
    return harness.ResultTable("How long it took on this machine", columns, rows)


def _claims(name: str, result: SiteResult) -> Iterator[harness.Claim]:
    lift = result.certificate.lift
    for check in result.certificate.checks:
        yield harness.Claim(f"{name}: {check.sentence}", check.holds)
    if result.certificate.holds:
        for phrase, duration, ratio in (
            ("along the way the drives need", lift.timed.bound, OF_BOUND),
            ("the motion lasts", lift.timed.motion.arrival, OF_LEAST),
        ):
            yield harness.Claim(
                f"{name}: {phrase} {duration / lift.least:.3f} times what drives need at "
                f"least, whichever way round; at most {ratio:g}.",
                duration <= ratio * lift.least,
            )
    if result.least is None:
        return
    for check in result.least.checks:
        yield harness.Claim(f"{name} in least time: {check.sentence}", check.holds)
    shortest_time = result.least.lift.timed.motion.arrival
    yield harness.Claim(
        f"{name}: in least time it lasts {shortest_time / lift.least:.3f} times what drives need "
        f"at least, at most {IN_LEAST_TIME:g}, and less than planned.",
        lift.least * IN_LEAST_TIME >= shortest_time < lift.timed.motion.arrival,
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser(
        "lift",
        "From a site with obstacles to a motion that provably touches nothing.",
        engines=("compiled", "pinocchio"),
    )
    harness.add_setup(parser, "payload_mass")
    parser.add_argument(
        "--site",
        nargs="+",
        metavar="FILE",
        default=None,
        help="sites as TOML, see docs/howto/plan_lift.md; all examples if not given",
    )
    parser.add_argument(
        "--from",
        dest="start",
        nargs=3,
        type=float,
        metavar=("X", "Y", "Z"),
        help="centre of the load at the start, in the site's frame [m]",
    )
    parser.add_argument(
        "--to",
        dest="goal",
        nargs=3,
        type=float,
        metavar=("X", "Y", "Z"),
        help="the same at the end",
    )
    parser.add_argument(
        "--lifts", type=int, default=LIFTS, metavar="N", help="perturbed lifts; 0 for none"
    )
    parser.add_argument(
        "--least-time",
        action="store_true",
        help="also make each lift as short as it can be, some ten seconds a site (extra `optimal`)",
    )
    return harness.run_experiment(parser, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
