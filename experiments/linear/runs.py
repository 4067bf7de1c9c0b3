"""Runs of the plant and of the linear models under the same motion of the drives."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cranedyn import theory
from cranedyn.analysis.swing import swing_amplitude
from cranedyn.controllers import follow
from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import DataError
from cranedyn.model.crane import Crane
from cranedyn.references import spline
from experiments.harness import Setup
from experiments.linear.model import Miss, Model, all_rates, dropped, integrate, miss, paper
from experiments.linear.sites import SITES, Job, SiteCrane, jobs

INERTIA = {"payload_inertia": 400.0, "dummy_mass": 50.0, "dummy_inertia": 50.0}
"""The article's load and links [kg m², kg, kg m²]."""

SWING, DEEP, HIGH = 0.02, 0.9, 0.45
"""Swing at the start of slow hoisting [rad], and the cable before and after it as shares of the
longest."""


@dataclass(frozen=True, eq=False)
class LinearCase:
    """One move of one crane: the run of the plant with a point load, and how far each model is from
    it.

    Attributes:
        site, job: Which crane and move.
        run: What the plant did.
        paper: The paper's equations against it.
        rates: The equations with all rates against it.
        rigid: The paper's equations against the plant with the article's inertia, where that was
            run.
        kept: The larger of ẍ and x γ̈ [m/s²].
        dropped: What the paper drops, by formula, as a share of that.
    """

    site: SiteCrane
    job: Job
    run: Trajectory
    paper: Miss
    rates: Miss
    rigid: Miss | None
    kept: float
    dropped: Mapping[str, float]


def move(setup: Setup, crane: Crane, job: Job, label: str) -> Trajectory:
    """Make a move and one swing after it, the drives in prescribed motion."""
    length = job.reference(job.arrival).position[crane.layout.drive("l")]
    period = float(theory.point_period(length, setup.gravity))
    duration = math.ceil((job.arrival + period) / setup.control_period) * setup.control_period
    drives = follow(crane, job.reference, setup.control_period)
    return setup.simulate(
        crane,
        drives,
        job.reference,
        start=job.start,
        duration=duration,
        label=label,
        drive="motion",
    )


def run_cases(setup: Setup, site: SiteCrane, crane: Crane) -> list[LinearCase]:
    """Make every move of one crane with a point load; with inertia besides where it is known, on
    the article's crane.
    """
    rigid = site.crane(setup, **INERTIA) if site is SITES[0] else None

    def missed(run: Trajectory, model: Model) -> Miss:
        return miss(run, integrate(run, model, setup.gravity))

    cases = []
    for job in jobs(site, crane):
        label = f"{site.name}: {job.name}"
        run = move(setup, crane, job, label)
        inertia = missed(move(setup, rigid, job, f"{label}, inertia"), paper) if rigid else None
        misses = missed(run, paper), missed(run, all_rates), inertia
        cases.append(LinearCase(site, job, run, *misses, *dropped(run)))
    return cases


def scan(setup: Setup, crane: Crane, jobs_of_crane: Sequence[Job]) -> list[float]:
    """Return the error of the paper's equations in each of some moves, root mean square over the
    largest swing.
    """
    trajectories = [move(setup, crane, job, job.name) for job in jobs_of_crane]
    return [miss(run, integrate(run, paper, setup.gravity)).rms for run in trajectories]


def reaches(values: Sequence[float], errors: Sequence[float], good: float) -> float:
    """Return the value at which an error that grows with it reaches `good`, interpolated between
    two neighbours by their logarithms.

    Raises:
        DataError: If it is not that large, or not that small, at any.
    """
    by_size = sorted(zip(errors, values, strict=True))
    for (low, value), (high, next_value) in itertools.pairwise(by_size):
        if low <= good < high:
            return value * (next_value / value) ** (math.log(good / low) / math.log(high / low))
    raise DataError(
        f"The errors run from {by_size[0][0]:g} to {by_size[-1][0]:g}; {good:g} is not among them."
    )


def powers(setup: Setup, site: SiteCrane, crane: Crane) -> list[float]:
    """Return the power of the cable length with which a free swing changes when it is hoisted
    slowly: in the plant, and by Eq. (8).
    """
    swings = ("phi", "theta")
    first, last = DEEP * site.height, HIGH * site.height
    start = crane.state(l=first, phi=SWING)
    duration = 15.0 / 8.0 * (first - last) / site.hoist[0]
    goal = (0.0, start.q[crane.layout.index("x")], last)
    job = Job("", start, spline(crane, start, [goal], [duration]), duration)
    run = move(setup, crane, job, f"{site.name}: slow hoisting")
    ends = (
        np.concatenate([run.coordinates(*swings)[-1], run.rates(*swings)[-1]]),
        integrate(run, paper, setup.gravity)[-1],
    )
    amplitudes = [
        swing_amplitude(end[None, :2], end[None, 2:], last, setup.gravity)[0] for end in ends
    ]
    return [math.log(amplitude / SWING) / math.log(last / first) for amplitude in amplitudes]
