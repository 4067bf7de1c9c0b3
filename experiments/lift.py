"""From a site with obstacles to a planned motion that is proven to keep clear.

Planned, certified, and simulated ten thousand times with perturbations.
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
from cranedyn.command import command
from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import DataError
from cranedyn.interfaces import EngineName
from cranedyn.lifts.planning.certificate import Certificate, certify
from cranedyn.lifts.planning.ground_lift import (
    GroundLift,
    certify_ground_lift,
    from_ground,
    not_grounded,
    stands_at,
)
from cranedyn.lifts.planning.lift import Lift, crane_of, plan_lift
from cranedyn.lifts.planning.lift_chain import CertifiedChain
from cranedyn.lifts.planning.perturbed import CONFIDENCE, Perturbed, perturb
from cranedyn.lifts.planning.site import Site
from cranedyn.lifts.planning.site_file import EXAMPLES, read_site
from cranedyn.verdict import Check, Verdict, overall
from experiments import harness
from experiments.lift_chain import chain_outcome, write_recording
from experiments.scenarios.moves import LIMITS

LIFTS = 10_000
"""Number of perturbed lifts."""

# A claim compares durations with `Lift.least_duration`: about the time that the drives alone need
# from start to goal, past the obstacles and whatever the load does.

MAX_PATH_RATIO = 1.25
"""Largest time that the drives may need along the planned path, over that bound."""

MAX_MOTION_RATIO = 1.4
"""Largest duration of a planned motion over that bound."""

MAX_LEAST_TIME_RATIO = 1.25
"""Largest duration of a motion in least time over that bound."""

LEAST_TIME = "also make each lift as short as it can be, some ten seconds a site (extra `optimal`)"
"""Help of the option of that name."""

SITE_SPACING = 90.0
"""Distance from one site to the next in the recording [m]."""


@dataclass(frozen=True, eq=False)
class GroundLiftResult:
    """A lift with lift-off from the ground, set-down, or both.

    Attributes:
        lift: The lift, by phases.
        run: Its simulation.
        checks: What was checked of the phases.
    """

    lift: GroundLift
    run: Trajectory
    checks: list[Check]


@dataclass(frozen=True, eq=False)
class SiteResult:
    """The lift of a site.

    Attributes:
        name: Name of its file.
        is_example: Whether it is an example of the package, with start and goal as they are there.
        site: The site.
        certificate: The planned lift, simulated and checked against the site.
        perturbed: Perturbed lifts; None if none were made.
        planning_seconds: Time that planning took [s].
        certifying_seconds: Time that certifying took, with lift-off and set-down [s].
        perturbing_seconds: Time that the perturbed lifts took [s].
        least: The same lift in least time; None if it was not asked for.
        least_seconds: Time that finding it took [s].
        grounded: The lift with lift-off and set-down; None where the load hangs at both ends, or
            the lift between them is not certified.
    """

    name: str
    is_example: bool
    site: Site
    certificate: Certificate
    perturbed: Perturbed | None
    planning_seconds: float
    certifying_seconds: float
    perturbing_seconds: float
    least: Certificate | None
    least_seconds: float
    grounded: GroundLiftResult | None = None

    @property
    def lift(self) -> Lift:
        """The planned lift."""
        return self.certificate.lift

    def swing(self, certificate: Certificate) -> float:
        """Return the largest swing of a lift of this site [mrad]."""
        return 1e3 * certificate.lift.timed.shares["swing"] * self.site.swing


def arrival(certificate: Certificate) -> float:
    """Return the duration of the motion of a lift [s]."""
    return certificate.lift.timed.motion.arrival


def certify_in_least_time(lift: Lift, dt: float, engine: EngineName = "compiled") -> Certificate:
    """Find the motion of least time along the path of a lift, and certify it.

    Args:
        lift: The planned lift.
        dt: Step of the simulation [s].
        engine: Engine of the simulation.
    """
    from cranedyn.lifts.planning.least_time import in_least_time

    return certify(in_least_time(lift), dt=dt, engine=engine)


def experiment(options: argparse.Namespace, setup: harness.Setup) -> harness.Outcome:
    """Plan and certify a lift on each site."""
    from cranedyn.lifts.judging.lift_figures import clearance_over_time, scenery, site_views
    from cranedyn.recording import Run

    count = whole("lifts", options.lifts, 0)
    sites = _sites(options)
    results = list[SiteResult]()
    update = setup.reporter.count("sites", len(sites))
    for name, site in sites:
        results.append(_result(setup, name, site, options, count))
        update(len(results))

    certified = [result for result in results if result.certificate.holds]
    figures = {f"site_{result.name}": site_views(result.certificate) for result in certified}
    for result in certified:
        figures[f"time_{result.name}"] = clearance_over_time(result.certificate)

    trajectories = {f"lift_{result.name}": result.certificate.run for result in results}
    claims: list[harness.Claim] = []
    limits = {}
    recording = []
    for i, result in enumerate(results):
        claims += _claims(result)
        of_drives = result.lift.limits
        limits[result.name] = [list(of_drives.rates), list(of_drives.accelerations)]
        if result.grounded:
            trajectories[f"grounded_{result.name}"] = result.grounded.run
        if result.least:
            trajectories[f"least_time_{result.name}"] = result.least.run

        # Where a load begins on the ground, the whole lift is shown, and the scenery, which shows
        # the planned path, begins with its motion.
        crane = result.lift.crane
        run = result.certificate.run
        motion_begins = 0.0
        if result.grounded:
            crane = result.grounded.lift.crane
            run = result.grounded.run
            motion_begins = result.grounded.lift.phases["motion"]
        shown = scenery(result.certificate, begins=motion_begins)
        place = (SITE_SPACING * i, 0.0, 0.0)
        recording.append(Run(result.site.name, crane, run, place, scenery=shown))

    return harness.Outcome(
        tables=_tables(certified, results),
        claims=claims,
        parameters={
            "sites": [result.name for result in results],
            "lifts": count,
            "limits": limits,
        },
        trajectories=trajectories,
        figures=figures,
        recording=recording,
    )


def _sites(options: argparse.Namespace) -> list[tuple[str, Site]]:
    """Return the name and the site of each file, all examples without any.

    Raises:
        DataError: If two files have one name, or ends of a lift are given for several sites.
    """
    files = options.site or EXAMPLES
    names = [Path(file).stem for file in files]
    if len(set(names)) < len(names):
        raise DataError(
            f"Two sites have one name: {', '.join(names)}. Results are named after the files of "
            "sites; rename one."
        )
    sites = [read_site(file) for file in files]
    for end, option in (("start", "--from"), ("goal", "--to")):
        if getattr(options, end) is not None and len(sites) != 1:
            raise DataError(f"{option} is for one site; give one with --site.")
    return list(zip(names, sites, strict=True))


def _point(coordinates: Sequence[float] | None) -> np.ndarray | None:
    """Return a point of the command line [m], None if it was not given.

    Raises:
        OutOfRange: If a coordinate is not finite.
    """
    if coordinates is None:
        return None
    return np.array([number("coordinate", value, "m") for value in coordinates])


def _result(
    setup: harness.Setup, name: str, site: Site, options: argparse.Namespace, count: int
) -> SiteResult:
    """Plan, certify and perturb the lift of a site, and take the time of each.

    Args:
        setup: Gravity, clocks, engine and numbers of the crane.
        name: Name of the site's file.
        site: The site.
        options: Arguments of the command line.
        count: Number of perturbed lifts.
    """
    crane = crane_of(site, gravity=setup.gravity, urdf=None, **setup.values)
    start = _point(options.start)
    goal = _point(options.goal)
    limits = site.limits or LIMITS

    planning = time.monotonic()
    lift = plan_lift(site, limits, start=start, goal=goal, crane=crane, period=setup.control_period)

    certifying = time.monotonic()
    for sentence in site.unusual:
        print(f"{name}, unusual: {sentence}", file=sys.stderr)
    certificate = certify(lift, dt=setup.dt, engine=setup.engine)
    stands_at_start = stands_at(site.start if start is None else start)
    stands_at_goal = stands_at(site.goal if goal is None else goal)
    grounded = None
    stands = stands_at_start or stands_at_goal
    if stands and not not_grounded(lift, certified=certificate.holds):
        whole_lift = from_ground(lift, stands=(stands_at_start, stands_at_goal))
        run, checks = certify_ground_lift(whole_lift)
        grounded = GroundLiftResult(whole_lift, run, checks)

    perturbing = time.monotonic()
    perturbed = None
    if count and certificate.holds:
        perturbed = perturb(certificate, count, dt=setup.control_period)

    shortening = time.monotonic()
    least = None
    if options.least_time and certificate.holds:
        least = certify_in_least_time(lift, setup.dt, setup.engine)
    end = time.monotonic()

    files = options.site or EXAMPLES
    has_own_ends = options.start is not None or options.goal is not None
    return SiteResult(
        name=name,
        is_example=name in files and name in EXAMPLES and not has_own_ends,
        site=site,
        certificate=certificate,
        perturbed=perturbed,
        planning_seconds=certifying - planning,
        certifying_seconds=perturbing - certifying,
        perturbing_seconds=shortening - perturbing,
        least=least,
        least_seconds=end - shortening,
        grounded=grounded,
    )


def _tables(
    certified: Sequence[SiteResult], results: Sequence[SiteResult]
) -> list[harness.ResultTable]:
    """Return all tables; those of what was not made are left out.

    Args:
        certified: Results whose lift is certified.
        results: All results.
    """
    tables = [_certified(certified)]
    perturbed = [result for result in certified if result.perturbed]
    if perturbed:
        tables.append(_perturbed(perturbed))
    shorter = [result for result in certified if result.least and result.least.holds]
    if shorter:
        tables.append(_least_time(shorter))
    if certified:
        tables.append(_assumptions(certified))
    tables.append(
        harness.make_table(
            "How long it took on this machine",
            results,
            _SITE,
            ("planned [s]", ".1f", lambda r: r.planning_seconds),
            ("certified [s]", ".1f", lambda r: r.certifying_seconds),
            ("perturbed [s]", ".1f", lambda r: r.perturbing_seconds),
        )
    )
    return tables


_SITE: harness.Column = ("site", "", lambda r: r.name)
"""The first column of the tables with a row for each site."""


def _certified(results: Sequence[SiteResult]) -> harness.ResultTable:
    return harness.make_table(
        "Certified lifts",
        results,
        _SITE,
        ("way [s]", ".2f", lambda r: r.lift.way_duration),
        ("grid [s]", ".2f", lambda r: r.lift.grid_duration),
        ("bound [s]", ".2f", lambda r: r.lift.least_duration),
        ("drives [s]", ".2f", lambda r: r.lift.timed.bound),
        ("motion [s]", ".2f", lambda r: arrival(r.certificate)),
        ("motion / bound", ".3f", lambda r: arrival(r.certificate) / r.lift.least_duration),
        ("clearance [m]", ".2f", lambda r: r.certificate.nearest.distance),
        ("of", "", lambda r: f"{r.certificate.nearest.body}, {r.certificate.nearest.obstacle}"),
        ("swing [mrad]", ".1f", lambda r: r.swing(r.certificate)),
        note="Way: the path at full speed. Grid: the best on cells of 0.5 s, either way round. "
        "Bound: the least time of the drives from start to goal. Drives: their least time along "
        "the path. Motion: with the load at rest at the end. Clearance: the least in simulation.",
    )


def _assumptions(results: Sequence[SiteResult]) -> harness.ResultTable:
    rows = []
    for result in results:
        for assumption in result.certificate.assumptions:
            rows.append((result.name, assumption))
    return harness.make_table(
        "What the certificates rest on",
        rows,
        ("site", "", lambda r: r[0]),
        ("quantity", "", lambda r: r[1].name),
        ("value", "", lambda r: r[1].value),
        ("origin", "", lambda r: r[1].origin.value),
        note="A default is a value of this program that nobody entered.",
    )


def _perturbed(results: Sequence[SiteResult]) -> harness.ResultTable:
    return harness.make_table(
        "Perturbed lifts",
        [(result.name, result.perturbed) for result in results],
        ("site", "", lambda r: r[0]),
        ("lifts", "d", lambda r: len(r[1].least)),
        ("below required clearance", "d", lambda r: r[1].failures),
        ("%", ".2f", lambda r: 100.0 * (r[1].failures / len(r[1].least))),
        ("from %", ".3f", lambda r: 100.0 * r[1].interval()[0]),
        ("to %", ".3f", lambda r: 100.0 * r[1].interval()[1]),
        ("least [m]", ".2f", lambda r: float(np.nanmin(r[1].least))),
        ("swing after [mrad]", ".1f", lambda r: 1e3 * float(r[1].swing.max())),
        note=f"From, to: {100 * CONFIDENCE:g} % interval of the probability (Clopper and Pearson). "
        "Load ±30 %, cable ±0.5 m, wind up to 4 m/s with a gust of up to 6 m/s more, sensors up to "
        "20 ms late. Least: negative for a collision.",
    )


def _least_time(results: Sequence[SiteResult]) -> harness.ResultTable:
    return harness.make_table(
        "In least time",
        results,
        _SITE,
        ("planned [s]", ".2f", lambda r: arrival(r.certificate)),
        ("least time [s]", ".2f", lambda r: arrival(r.least)),
        ("planned / bound", ".3f", lambda r: arrival(r.certificate) / r.lift.least_duration),
        ("least / bound", ".3f", lambda r: arrival(r.least) / r.lift.least_duration),
        ("clearance [m]", ".2f", lambda r: r.least.nearest.distance),
        ("swing [mrad]", ".1f", lambda r: r.swing(r.least)),
        ("at arrival [mrad]", ".4f", lambda r: 1e3 * r.least.residual_swing),
        ("found in [s]", ".1f", lambda r: r.least_seconds),
        note="The same lifts with motions of least time. Bound: the least time of the drives.",
    )


def _claims(result: SiteResult) -> Iterator[harness.Claim]:
    """Yield the claims on the lift of a site."""
    name = result.name
    lift = result.lift
    checks = list(result.certificate.checks)
    if result.grounded:
        checks += result.grounded.checks
    for check in checks:
        yield harness.Claim(f"{name}: {check.sentence}", check.verdict)
    # Whoever plans a lift needs a certificate: what is not judged leaves them without one.
    yield harness.Claim(
        f"{name}: the lift is certified, all {len(checks)} checks hold.",
        overall(checks) is Verdict.HOLDS,
    )
    # How fast the planner is, is a claim about the examples. On a site of somebody's own the ratio
    # is in the table, and no fault of theirs.
    if result.certificate.holds and result.is_example:
        for phrase, duration, ratio in (
            ("along the way the drives need", lift.timed.bound, MAX_PATH_RATIO),
            ("the motion lasts", arrival(result.certificate), MAX_MOTION_RATIO),
        ):
            yield harness.Claim(
                f"{name}: {phrase} {duration / lift.least_duration:.3f} times what drives need at "
                f"least, whichever way round; at most {ratio:g}.",
                duration <= ratio * lift.least_duration,
            )
    if result.least is None:
        return
    for check in result.least.checks:
        yield harness.Claim(f"{name} in least time: {check.sentence}", check.verdict)
    if not result.is_example:
        return
    shortest = arrival(result.least)
    yield harness.Claim(
        f"{name}: in least time it lasts {shortest / lift.least_duration:.3f} times what drives "
        f"need at least, at most {MAX_LEAST_TIME_RATIO:g}, and less than planned.",
        shortest <= lift.least_duration * MAX_LEAST_TIME_RATIO
        and shortest < arrival(result.certificate),
    )


def _refuse_options_of_single_lifts(options: argparse.Namespace) -> None:
    """Refuse options that do not apply to a chain.

    Raises:
        DataError: With the option.
    """
    given = {
        "--from": options.start is not None,
        "--to": options.goal is not None,
        "--least-time": options.least_time,
        "--lifts": options.lifts not in (0, LIFTS),
        "--view": options.view,
        "--serve": options.serve,
        "--film": options.film is not None,
    }
    for option, is_given in given.items():
        if is_given:
            raise DataError(f"{option} is for single lifts; leave it out with --chain.")


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("lift", __doc__, engines=("compiled", "pinocchio"))
    parser.example = f"{parser.prog} --lifts 20"
    harness.add_setup(parser, "payload_mass")
    add = parser.add_argument
    text = "sites as TOML, see docs/howto/plan_lift.md, or names of examples (default all of them)"
    add("--site", nargs="+", metavar="FILE", default=None, help=text)
    # An end on the ground has no height of its own.
    text = "centre of the load at the start, in the site's frame [m]: X Y Z, or X Y to lift it off"
    add("--from", dest="start", nargs="+", type=float, metavar=("X", "Y"), help=text)
    text = "the same at the end, or X Y to set it down"
    add("--to", dest="goal", nargs="+", type=float, metavar=("X", "Y"), help=text)
    add("--lifts", type=int, default=LIFTS, metavar="N", help="perturbed lifts; 0 for none")
    add("--least-time", action="store_true", help=LEAST_TIME)
    text = (
        "lifts one after the other, from a .toml file with [[lift]], see docs/howto/lift_chain.md"
    )
    add("--chain", metavar="FILE", default=None, help=text)
    chains: list[tuple[CertifiedChain, Path]] = []

    def experiment_or_chain(options: argparse.Namespace, setup: harness.Setup) -> harness.Outcome:
        if options.chain is None:
            return experiment(options, setup)
        _refuse_options_of_single_lifts(options)
        outcome, certified = chain_outcome(options, setup)
        chains.append((certified, options.recording))
        return outcome

    code = harness.run_experiment(parser, experiment_or_chain, argv)
    return command(lambda: write_recording(*chains[0], code)) if chains else code


if __name__ == "__main__":
    sys.exit(main())
