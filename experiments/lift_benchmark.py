"""Lifts on random sites, beside other means.

How often one is found and certified, how fast, how near the best.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cranedyn.analysis.swing import swing_amplitude
from cranedyn.checks import whole
from cranedyn.compiled.batch import simulate_batch
from cranedyn.controllers import follow, hold_controller
from cranedyn.interfaces import Controller, Drive, Reference
from cranedyn.lifts.planning.certificate import AFTER, Certificate, certify
from cranedyn.lifts.planning.clearance_of import clearance_of
from cranedyn.lifts.planning.joystick import joystick_path
from cranedyn.lifts.planning.lift import Lift, NoWay, plan_lift
from cranedyn.lifts.planning.site import Site
from cranedyn.lifts.planning.solids import Solid, box
from cranedyn.model.crane import Crane
from cranedyn.references.simple import shortest, spline
from experiments import harness
from experiments.harness import Claim, Outcome, ResultTable, Setup
from experiments.harness.table import Cell
from experiments.lift import (
    LEAST_TIME,
    MAX_LEAST_TIME_RATIO,
    MAX_MOTION_RATIO,
    MAX_PATH_RATIO,
    arrival,
    certify_in_least_time,
)
from experiments.scenarios.moves import LIMITS, instant

SITES = 100
"""Number of random sites."""

SEED = 14
"""Seed of the sites."""

LOAD_SIZE = (1.5, 2.0, 1.2)
"""Sides of the load along X, Y and Z [m]."""

MIN_END_MARGIN = 0.1
"""Least distance of the load from obstacles at start and goal, beyond what its swing takes [m]."""

RECORD_STRIDE = 20
"""Control periods from one instant to the next at which the clearance of other means is measured.
"""

PLANNED = "planned"
"""Name of the planned motion among the means."""


class Measures(NamedTuple):
    """What a motion along the way of a lift is like.

    Attributes:
        duration: Its duration [s].
        clearance: Least distance from obstacles in the run [m].
        arrival_swing: Amplitude of the swing at the arrival [rad].
    """

    duration: float
    clearance: float
    arrival_swing: float


@dataclass(frozen=True, eq=False)
class SiteLift:
    """Result of a site.

    Attributes:
        certificate: The planned lift, simulated and checked; None if no way was found.
        refused: Why no way was found; empty if one was.
        seconds: Time that plan and certificate took [s].
        means: The measures of the planned motion and of other means along the same way, by name.
        least: The same lift in least time; None if it was not asked for.
    """

    certificate: Certificate | None
    refused: str
    seconds: float
    means: dict[str, Measures]
    least: Certificate | None = None

    @property
    def why(self) -> str:
        """Why there is no certified lift; empty if there is."""
        if self.certificate is None:
            return self.refused
        failed = [check.sentence for check in self.certificate.checks if not check.holds]
        return "; ".join(failed)


class CertifiedLift(NamedTuple):
    """A site whose lift is certified.

    Attributes:
        result: Result of the site.
        certificate: Its certificate.
    """

    result: SiteLift
    certificate: Certificate

    @property
    def lift(self) -> Lift:
        """The planned lift."""
        return self.certificate.lift


def sites(crane: Crane, count: int, seed: int = SEED) -> Iterator[Site]:
    """Yield random sites with 4 to 10 boxes, on which start and goal are free.

    Args:
        crane: The crane.
        count: Number of sites.
        seed: Seed of all that is random.
    """
    rng = np.random.default_rng(seed)
    load = _load_corners()
    found = 0
    while found < count:
        solids = tuple(_random_box(rng, i) for i in range(rng.integers(4, 11)))
        start, goal = _random_ends(rng)
        site = Site(f"site {found + 1}", solids, load=load, start=start, goal=goal)
        clearance = clearance_of(crane, site)
        margins = [clearance.swing_margin(clearance.place(point)) for point in (start, goal)]
        if min(margins) > MIN_END_MARGIN:
            found += 1
            yield site


def _load_corners() -> np.ndarray:
    """Return the corners of the load from its centre [m], shape (8, 3)."""
    signs = itertools.product((-0.5, 0.5), repeat=3)
    return np.array([np.array(sign) * LOAD_SIZE for sign in signs])


def _random_box(rng: np.random.Generator, i: int) -> Solid:
    """Return a box on the ground; the highest are as high as the jib allows."""
    angle = rng.uniform(-math.pi, math.pi)
    radius = rng.uniform(6.0, 22.0)
    size = [*rng.uniform(1.0, 7.0, 2), float(rng.uniform(3.0, 20.0))]
    centre = radius * math.cos(angle), radius * math.sin(angle)
    return box(f"box {i + 1}", centre, size, 0.0, rng.uniform(0.0, math.pi))


def _random_ends(rng: np.random.Generator) -> list[np.ndarray]:
    """Return start and goal [m], shape (3,) each, between which the jib turns by 0.8 to 2.8 rad."""
    begin = rng.uniform(-math.pi, math.pi)
    turn = rng.uniform(0.8, 2.8) * rng.choice([-1.0, 1.0])
    points = []
    for angle in (begin, begin + turn):
        radius = rng.uniform(6.0, 20.0)
        height = rng.uniform(3.0, 12.0)
        points.append(np.array([radius * math.cos(angle), radius * math.sin(angle), height]))
    return points


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Plan and certify a lift on each site."""
    count = whole("sites", options.sites, 1)
    update = setup.reporter.count("sites", count)
    results: list[SiteLift] = []
    for site in sites(setup.crane, count):
        results.append(_lift_on(setup, site, options.least_time))
        update(len(results))
    return Outcome(
        tables=[_summary(results), _means_table(results), _uncertified_table(results)],
        claims=_claims(results),
        parameters={"sites": count, "seed": SEED},
    )


def _lift_on(setup: Setup, site: Site, least_time: bool) -> SiteLift:
    """Plan and certify the lift of a site, and run other means along its way.

    Args:
        setup: Crane and clocks.
        site: The site.
        least_time: Whether to find the same lift in least time, too.
    """
    begun = time.monotonic()
    try:
        lift = plan_lift(site, LIMITS, crane=setup.crane, period=setup.control_period)
    except NoWay as error:
        return SiteLift(None, str(error), time.monotonic() - begun, {})
    certificate = certify(lift, dt=setup.dt)
    seconds = time.monotonic() - begun
    means = {PLANNED: _measures(certificate), **_other_means(setup, lift)}
    least = None
    if least_time and certificate.holds:
        least = certify_in_least_time(lift, setup.dt)
        means["in least time"] = _measures(least)
    return SiteLift(certificate, "", seconds, means, least)


def _measures(certificate: Certificate) -> Measures:
    return Measures(
        duration=arrival(certificate),
        clearance=certificate.nearest.distance,
        arrival_swing=certificate.residual_swing,
    )


def _other_means(setup: Setup, lift: Lift) -> dict[str, Measures]:
    """Run the same path with a stop at every corner, by splines under PD, and by an operator."""
    start, _ = lift.states()
    corners = lift.points[1:].tolist()
    durations = shortest(
        lift.crane, start, corners, rates=lift.limits.rates, accelerations=lift.limits.accelerations
    )
    splines = spline(lift.crane, start, corners, durations)
    joystick, end = joystick_path(lift.crane, start, lift.points.tolist(), lift.limits)
    exact_splines = follow(lift.crane, splines, setup.control_period)
    exact_joystick = follow(lift.crane, joystick, setup.control_period)
    brake = hold_controller(lift.crane)
    return {
        "stop at corners": _run(setup, lift, exact_splines, "motion", splines, splines.arrival),
        "spline + PD": _run(setup, lift, brake, "effort", splines, splines.arrival),
        "operator": _run(setup, lift, exact_joystick, "motion", joystick, end),
    }


def _run(
    setup: Setup,
    lift: Lift,
    controller: Controller,
    drive: Drive,
    reference: Reference,
    arrives: float,
) -> Measures:
    """Run a motion along the way of a lift.

    Args:
        setup: The clocks.
        lift: The lift.
        controller: Controller of the drives.
        drive: Kind of the drives.
        reference: Motion of the drives.
        arrives: Time at which it arrives [s].
    """
    batch = simulate_batch(
        lift.crane,
        controller,
        reference,
        start=lift.states()[0],
        duration=instant(arrives + AFTER, setup.control_period),
        dt=setup.dt,
        control_period=setup.control_period,
        drive=drive,
        record=RECORD_STRIDE,
        threads=1,
    )
    row = int(np.searchsorted(batch.t, arrives))
    passive = lift.crane.layout.passive
    q = batch.q[:, row]
    v = batch.v[:, row]
    cable = float(q[0, lift.clearance.hoist])
    swing = swing_amplitude(q[:, passive], v[:, passive], cable, lift.crane.gravity)
    return Measures(
        duration=arrives,
        clearance=min(lift.clearance.least_distance(q) for q in batch.q[0]),
        arrival_swing=float(swing[0]),
    )


def _certified(results: Sequence[SiteLift]) -> list[CertifiedLift]:
    """Return the sites whose lift is certified."""
    found = []
    for result in results:
        if result.certificate is not None and not result.why:
            found.append(CertifiedLift(result, result.certificate))
    return found


def _summary(results: Sequence[SiteLift]) -> ResultTable:
    """Return median and worst values of certified lifts."""
    certified = _certified(results)
    lifts = [one.lift for one in certified]
    motions = [lift.timed.motion.arrival for lift in lifts]
    bounds = [lift.least_duration for lift in lifts]
    rows: list[list[Cell]] = []
    for name, values in (
        ("plan and certificate [s]", [one.result.seconds for one in certified]),
        ("way / grid", [lift.way_duration / lift.grid_duration for lift in lifts]),
        (
            "drives along the way / bound",
            [lift.timed.bound / lift.least_duration for lift in lifts],
        ),
        ("motion / bound", _ratios(motions, bounds)),
        ("motion [s]", motions),
        # The worst clearance is the least, and so the largest of the negative ones.
        ("least clearance [m]", [-one.certificate.nearest.distance for one in certified]),
        ("least time / bound", [least / bound for least, bound in _least_times(certified)]),
    ):
        if values:
            quantiles = [abs(float(np.quantile(values, share))) for share in (0.5, 0.9, 1.0)]
            rows.append([name, *quantiles])
    columns = [
        ("of certified lifts", ""),
        ("median", ".3f"),
        ("worst tenth", ".3f"),
        ("worst", ".3f"),
    ]
    note = f"{len(certified)} of {len(results)} sites certified, every segment proven."
    return ResultTable("Random sites", columns, rows, note)


def _ratios(values: Sequence[float], bounds: Sequence[float]) -> list[float]:
    return [value / bound for value, bound in zip(values, bounds, strict=True)]


def _least_times(certified: Sequence[CertifiedLift]) -> list[tuple[float, float]]:
    """Return the duration of each lift in least time that is certified, and its bound [s]."""
    pairs = []
    for one in certified:
        least = one.result.least
        if least is not None and least.holds:
            pairs.append((arrival(least), one.lift.least_duration))
    return pairs


def _means_table(results: Sequence[SiteLift]) -> ResultTable:
    """Return a row for each means along the same paths."""
    certified = _certified(results)
    names = [*certified[0].result.means] if certified else []
    rows: list[list[Cell]] = []
    for name in names:
        measures = [one.result.means[name] for one in certified]
        too_near = 0
        for one, measure in zip(certified, measures, strict=True):
            too_near += measure.clearance < one.lift.clearance.site.distance
        rows.append(
            [
                name,
                float(np.median([measure.duration for measure in measures])),
                min(measure.clearance for measure in measures),
                too_near,
                1e3 * max(measure.arrival_swing for measure in measures),
            ]
        )
    columns = [
        ("along the same way", ""),
        ("median [s]", ".1f"),
        ("least clearance [m]", ".2f"),
        ("below required clearance", "d"),
        ("swing at arrival [mrad]", ".3g"),
    ]
    return ResultTable("Beside other means", columns, rows)


def _uncertified_table(results: Sequence[SiteLift]) -> ResultTable:
    rows = []
    for number, result in enumerate(results, start=1):
        if result.why:
            rows.append((f"site {number}", result.why))
    return ResultTable("Sites without a certified lift", [("site", ""), ("because", "")], rows)


def _claims(results: Sequence[SiteLift]) -> list[Claim]:
    certified = _certified(results)
    planned = sum(result.certificate is not None for result in results)
    lifts = [one.lift for one in certified]
    claims = []
    if any(one.result.least for one in certified):
        least_times = _least_times(certified)
        subject = f"In least time {len(least_times)} of {len(certified)} are certified and last"
        # The claim is about all of them: it fails if one is not certified.
        times = least_times if len(least_times) == len(certified) else []
        claims.append(_at_most(subject, MAX_LEAST_TIME_RATIO, times))
    claims += [
        Claim(
            f"Every lift that is planned is certified: {len(certified)} of {planned}; "
            f"{len(results) - planned} sites are refused.",
            len(certified) == planned > 0,
        ),
        _at_most(
            "Along its way a lift takes the drives",
            MAX_PATH_RATIO,
            [(lift.timed.bound, lift.least_duration) for lift in lifts],
        ),
        _at_most(
            "A planned motion lasts",
            MAX_MOTION_RATIO,
            [(lift.timed.motion.arrival, lift.least_duration) for lift in lifts],
        ),
    ]
    return claims


def _at_most(subject: str, ratio: float, times: Sequence[tuple[float, float]]) -> Claim:
    """Return the claim that no duration is longer than its bound times a ratio.

    Args:
        subject: What lasts.
        ratio: The ratio.
        times: Durations with their bounds [s]; without any the claim fails.
    """
    worst = max((duration / bound for duration, bound in times), default=math.inf)
    sentence = f"{subject} at most {ratio:g} times what drives need at least: {worst:.3f}."
    return Claim(sentence, worst <= ratio)


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("lift_benchmark", __doc__, recording=False, engines=("compiled",))
    harness.add_setup(parser)
    parser.add_argument("--sites", type=int, default=SITES, metavar="N", help="how many sites")
    parser.add_argument("--least-time", action="store_true", help=LEAST_TIME)
    return harness.run_experiment(parser, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
