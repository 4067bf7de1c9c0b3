"""Lifts on random sites, beside other means.

How often one is found and certified, how fast, how near the best.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cranedyn.analysis.swing import swing_amplitude
from cranedyn.checks import whole
from cranedyn.compiled.batch import simulate_batch
from cranedyn.controllers import follow, hold_controller
from cranedyn.interfaces import Controller, Reference
from cranedyn.lifts.planning.certificate import AFTER, Certificate, certify
from cranedyn.lifts.planning.clearance import Clearance
from cranedyn.lifts.planning.lift import Lift, NoWay, plan_lift
from cranedyn.lifts.planning.site import Site
from cranedyn.lifts.planning.solids import Solid, box
from cranedyn.model.crane import Crane
from cranedyn.references.simple import shortest, spline
from experiments import harness
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
from experiments.scenarios.shaping import joystick_path

SITES = 100
"""Number of random sites."""

SEED = 14
"""Seed of the sites."""

_LOAD = np.array([[x, y, z] for x in (-0.75, 0.75) for y in (-1.0, 1.0) for z in (-0.6, 0.6)])


Measures = tuple[float, float, float]
"""Duration [s], least distance [m] and swing at the arrival [rad]."""


@dataclass(frozen=True, eq=False)
class SiteLift:
    """What came of a site.

    Attributes:
        certificate: The planned lift, simulated and checked; None if there is none.
        refused: Why there is none.
        seconds: For plan and certificate [s].
        means: The measures along the same way as planned and by other means, by name.
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
        checks = self.certificate.checks if self.certificate else ()
        return self.refused or "; ".join(check.sentence for check in checks if not check.holds)


def sites(crane: Crane, count: int, seed: int = SEED) -> Iterator[Site]:
    """Random sites on which start and goal are free: 4 to 10 boxes, some of them as high as the jib
    allows.
    """
    rng = np.random.default_rng(seed)
    index = 0
    while index < count:
        solids = tuple(_box(rng, i) for i in range(rng.integers(4, 11)))
        start, goal = (
            np.array([radius * math.cos(a), radius * math.sin(a), z]) for radius, a, z in _ends(rng)
        )
        site = Site(f"site {index + 1}", solids, load=_LOAD, start=start, goal=goal)
        clearance = Clearance(crane, site)
        if min(clearance.swing_margin(clearance.place(point)) for point in (start, goal)) > 0.1:
            index += 1
            yield site


def _box(rng: np.random.Generator, i: int) -> Solid:
    angle = rng.uniform(-math.pi, math.pi)
    radius = rng.uniform(6.0, 22.0)
    size = [*rng.uniform(1.0, 7.0, 2), float(rng.uniform(3.0, 20.0))]
    centre = radius * math.cos(angle), radius * math.sin(angle)
    return box(f"box {i + 1}", centre, size, 0.0, rng.uniform(0.0, math.pi))


def _ends(rng: np.random.Generator) -> list[tuple[float, float, float]]:
    begin = rng.uniform(-math.pi, math.pi)
    turn = rng.uniform(0.8, 2.8) * rng.choice([-1.0, 1.0])
    return [
        (rng.uniform(6.0, 20.0), angle, rng.uniform(3.0, 12.0)) for angle in (begin, begin + turn)
    ]


def experiment(options: argparse.Namespace, setup: harness.Setup) -> harness.Outcome:
    """Plan and certify a lift on each site."""
    count = whole("sites", options.sites, 1)
    update = setup.reporter.count("sites", count)
    tried = list[SiteLift]()
    for site in sites(setup.crane, count):
        tried.append(_tried(setup, site, options.least_time))
        update(len(tried))
    return harness.Outcome(
        tables=[_summary(tried), _beside(tried), _failed(tried)],
        claims=_claims(tried),
        parameters={"sites": count, "seed": SEED},
    )


def _tried(setup: harness.Setup, site: Site, least_time: bool) -> SiteLift:
    begun = time.monotonic()
    try:
        lift = plan_lift(site, LIMITS, crane=setup.crane, period=setup.control_period)
    except NoWay as error:
        return SiteLift(None, str(error), time.monotonic() - begun, {})
    certificate = certify(lift, dt=setup.dt)
    seconds = time.monotonic() - begun
    means = {"planned": _measures(certificate), **_others(setup, lift)}
    least = None
    if least_time and certificate.holds:
        least = certify_in_least_time(lift, setup.dt)
        means["in least time"] = _measures(least)
    return SiteLift(certificate, "", seconds, means, least)


def _measures(certificate: Certificate) -> Measures:
    return arrival(certificate), certificate.nearest.distance, certificate.residual_swing


def _others(setup: harness.Setup, lift: Lift) -> dict[str, Measures]:
    """Run the same path stopping at every corner, by splines under PD, and by an operator."""
    start, _ = lift.states()
    corners = lift.points[1:].tolist()
    durations = shortest(
        lift.crane, start, corners, rates=lift.limits.rates, accelerations=lift.limits.accelerations
    )
    splines = spline(lift.crane, start, corners, durations)
    joystick, end = joystick_path(lift.crane, start, lift.points.tolist(), lift.limits)
    return {
        "stop at corners": _run(setup, lift, splines, splines.arrival, True),
        "spline + PD": _run(setup, lift, splines, splines.arrival, False),
        "operator": _run(setup, lift, joystick, end, True),
    }


def _run(
    setup: harness.Setup, lift: Lift, reference: Reference, arrives: float, exact: bool
) -> Measures:
    if exact:
        controller: Controller = follow(lift.crane, reference, setup.control_period)
    else:
        controller = hold_controller(lift.crane)
    duration = instant(arrives + AFTER, setup.control_period)
    start = lift.states()[0]
    batch = simulate_batch(
        lift.crane,
        controller,
        reference,
        start=start,
        duration=duration,
        dt=setup.dt,
        control_period=setup.control_period,
        drive="motion" if exact else "effort",
        record=20,
        threads=1,
    )
    clearance = min(lift.clearance.least_distance(q) for q in batch.q[0])
    k = int(np.searchsorted(batch.t, arrives))
    passive = lift.crane.layout.passive
    hoist = lift.clearance.joints.hoist
    q = batch.q[:, k]
    v = batch.v[:, k]
    swing = swing_amplitude(q[:, passive], v[:, passive], float(q[0, hoist]), lift.crane.gravity)
    return arrives, clearance, float(swing[0])


def _held(tried: Sequence[SiteLift]) -> list[tuple[SiteLift, Certificate]]:
    return [(r, r.certificate) for r in tried if r.certificate is not None and not r.why]


def _summary(tried: Sequence[SiteLift]) -> harness.ResultTable:
    """Return median and worst values of certified lifts."""
    certified = _held(tried)
    lifts = [certificate.lift for _, certificate in certified]
    measured: dict[str, list[float]] = {
        "plan and certificate [s]": [result.seconds for result, _ in certified],
        "way / grid": [lift.way_duration / lift.grid_duration for lift in lifts],
        "drives along the way / bound": [lift.timed.bound / lift.least_duration for lift in lifts],
        "motion / bound": [lift.timed.motion.arrival / lift.least_duration for lift in lifts],
        "motion [s]": [lift.timed.motion.arrival for lift in lifts],
        "least clearance [m]": [-certificate.nearest.distance for _, certificate in certified],
        "least time / bound": [
            arrival(result.least) / certificate.lift.least_duration
            for result, certificate in certified
            if result.least and result.least.holds
        ],
    }
    rows: list[list[Cell]] = [
        [name, *(abs(float(np.quantile(values, share))) for share in (0.5, 0.9, 1.0))]
        for name, values in measured.items()
        if values
    ]
    quantiles = ((name, ".3f") for name in ("median", "worst tenth", "worst"))
    columns = [("of certified lifts", ""), *quantiles]
    note = f"{len(certified)} of {len(tried)} sites certified, every segment proven."
    return harness.ResultTable("Random sites", columns, rows, note)


def _beside(tried: Sequence[SiteLift]) -> harness.ResultTable:
    """Return the table of other means along the same paths."""
    certified = _held(tried)
    rows: list[list[Cell]] = []
    for name in certified[0][0].means if certified else ():
        times, clearances, swings = zip(*(r.means[name] for r, _ in certified), strict=True)
        required = (certificate.lift.clearance.site.distance for _, certificate in certified)
        nearer = sum(near < least for near, least in zip(clearances, required, strict=True))
        rows.append([name, float(np.median(times)), min(clearances), nearer, 1e3 * max(swings)])
    columns = [
        ("along the same way", ""),
        ("median [s]", ".1f"),
        ("least clearance [m]", ".2f"),
        ("below required clearance", "d"),
        ("swing at arrival [mrad]", ".3g"),
    ]
    return harness.ResultTable("Beside other means", columns, rows)


def _failed(tried: Sequence[SiteLift]) -> harness.ResultTable:
    rows = [(f"site {i + 1}", result.why) for i, result in enumerate(tried) if result.why]
    return harness.ResultTable(
        "Sites without a certified lift", [("site", ""), ("because", "")], rows
    )


def _claims(tried: Sequence[SiteLift]) -> list[harness.Claim]:
    certified = _held(tried)
    planned = sum(result.certificate is not None for result in tried)
    shorter = [
        (arrival(result.least), certificate.lift.least_duration)
        for result, certificate in certified
        if result.least is not None and result.least.holds
    ]

    def at_most(subject: str, ratio: float, times: list[tuple[float, float]]) -> harness.Claim:
        worst = max((lasts / bound for lasts, bound in times), default=math.inf)
        sentence = f"{subject} at most {ratio:g} times what drives need at least: {worst:.3f}."
        return harness.Claim(sentence, worst <= ratio)

    claims = [
        harness.Claim(
            f"Every lift that is planned is certified: {len(certified)} of {planned}; "
            f"{len(tried) - planned} sites are refused.",
            len(certified) == planned > 0,
        ),
        at_most(
            "Along its way a lift takes the drives",
            MAX_PATH_RATIO,
            [(c.lift.timed.bound, c.lift.least_duration) for _, c in certified],
        ),
        at_most(
            "A planned motion lasts",
            MAX_MOTION_RATIO,
            [(arrival(c), c.lift.least_duration) for _, c in certified],
        ),
    ]
    if any(result.least for result, _ in certified):
        subject = f"In least time {len(shorter)} of {len(certified)} are certified and last"
        times = shorter if len(shorter) == len(certified) else []
        claims.insert(0, at_most(subject, MAX_LEAST_TIME_RATIO, times))
    return claims


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("lift_benchmark", __doc__, recording=False, engines=("compiled",))
    harness.add_setup(parser)
    parser.add_argument("--sites", type=int, default=SITES, metavar="N", help="how many sites")
    parser.add_argument("--least-time", action="store_true", help=LEAST_TIME)
    return harness.run_experiment(parser, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
