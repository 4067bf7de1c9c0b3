"""Cranes of the size of those on building sites, the moves that they make at full speed, and the
runs of the plant and of the linear models in these.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from cranedyn import theory
from cranedyn.analysis.swing import swing_amplitude
from cranedyn.controllers import follow
from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import DataError
from cranedyn.interfaces import Reference, State
from cranedyn.lifts.planning.joystick import JoystickPulse, joystick
from cranedyn.model.crane import Crane
from cranedyn.references import shortest, spline
from experiments.harness import Setup
from experiments.linear_vs_full.linear_equations import (
    Miss,
    Model,
    all_rates,
    dropped,
    integrate,
    miss,
    paper,
)
from experiments.scenarios.crane_variants import POINT
from experiments.scenarios.moves import instant

RAMPS = (5.0, 4.0)
"""Time in which slew and trolley reach their speed [s]; ours."""

HOISTING = 0.4
"""Acceleration of the hoist [m/s²]; ours."""

QUARTER = math.pi / 2.0
"""How far every slew goes [rad]."""


class SiteCrane(NamedTuple):
    """A crane with its speeds.

    Attributes:
        name: What it is called.
        jib: Largest trolley radius [m].
        height: Of the hook at most, taken as the longest cable [m].
        trolley: Speed of the trolley [m/s].
        slew: Slew rate [rad/s].
        hoist: Speed of the hoist with a heavy load and with a light one [m/s].
    """

    name: str
    jib: float
    height: float
    trolley: float
    slew: float
    hoist: tuple[float, float]

    def crane(self, setup: Setup, **values: float) -> Crane:
        """Return the crane, by default with a point load; its mast is high enough for the
        drawing.
        """
        mast = {
            "mast_height": self.height + 2.0,
            "pivot_height": self.height + 4.0,
            "total_height": self.height + 10.0,
        }
        ranges = {"trolley_max": self.jib, "hoist_max": self.height, "hoist_min": 1.0}
        return setup.variant(**{**POINT, **mast, **ranges, **values})

    @property
    def accelerations(self) -> tuple[float, float, float]:
        """Of slew [rad/s²], trolley and hoist [m/s²]."""
        return self.slew / RAMPS[0], self.trolley / RAMPS[1], HOISTING


_HOIST = (17.0 / 60.0, 134.0 / 60.0)


def _site(name: str, jib: float, height: float, trolley: float, slew: float) -> SiteCrane:
    return SiteCrane(name, jib, height, trolley / 60.0, slew * math.pi / 30.0, _HOIST)


SITES = (
    SiteCrane("article's crane", 22.0, 26.4, 0.8, 0.08, (17.0 / 60.0, 0.8)),
    _site("71 EC-B 5", 50.0, 45.0, 63.0, 0.8),
    _site("380 EC-B 16", 75.0, 83.0, 95.0, 0.8),
    _site("L1-24", 25.0, 19.0, 22.0, 0.5),
)
"""The article's crane with the speeds of the demo, and three of a maker's list: jib [m], hook
height [m], trolley [m/min], slew [1/min].

Their hoists run at 17 to 134 m/min, the slower the heavier the load.
"""


class Job(NamedTuple):
    """A move that begins with the load hanging at rest.

    Attributes:
        name: What it is called.
        start: Where it begins.
        reference: The way of the drives.
        arrival: When they stand still again [s].
    """

    name: str
    start: State
    reference: Reference
    arrival: float


def jobs(site: SiteCrane, crane: Crane) -> list[Job]:
    """Return the moves: single drives, in splines and at constant speed between ramps, then pairs,
    then all.
    """
    middle = 0.5 * site.jib
    tip = 0.9 * site.jib
    high = 2.0 / 3.0 * site.height
    outward = JoystickPulse("x", site.trolley, 0.0, 0.4 * site.jib / site.trolley)
    slew = JoystickPulse("gamma", site.slew, 0.0, QUARTER / site.slew)
    slow, fast = (
        JoystickPulse("l", -speed, 0.0, share_of_height * site.height / speed)
        for speed, share_of_height in zip(site.hoist, (0.3, 0.6), strict=True)
    )
    inside, outside, below = (
        crane.state(x=x, l=cable)
        for x, cable in ((middle, high), (tip, high), (middle, 0.9 * site.height))
    )
    pulsed = partial(_pulsed, crane, site.accelerations)
    return [
        _splined("trolley, spline", site, crane, inside, (0.0, tip, high)),
        pulsed("trolley", inside, outward),
        _splined("slew, spline", site, crane, outside, (QUARTER, tip, high)),
        pulsed("slew", outside, slew),
        pulsed("slew, trolley", inside, slew, outward),
        pulsed("trolley, slow hoist", below, outward, slow),
        pulsed("trolley, fast hoist", below, outward, fast),
        pulsed("slew, trolley, fast hoist", below, slew, outward, fast),
    ]


SHARES = (1.0, 1 / 2, 1 / 4, 1 / 8, 1 / 16, 1 / 32)
"""Rates at which a crane turns, over its largest slew rate."""

HOLD = 30.0
"""Time for which the joystick is held [s]."""

ANGLES = (1.0, 2.0, 5.0, 10.0, 20.0)
"""Short slews [°]."""


def slow_slews(site: SiteCrane, crane: Crane) -> list[Job]:
    """Return slews at shares of the crane's rate, reached in the usual time."""
    slew, *accelerations = site.accelerations
    return [
        _pulsed(
            crane,
            (share * slew, *accelerations),
            f"slew at {share:g} of the rate",
            _outside(site, crane),
            JoystickPulse("gamma", share * site.slew, 0.0, HOLD),
        )
        for share in SHARES
    ]


def short_slews(site: SiteCrane, crane: Crane) -> list[Job]:
    """Return slews by small angles at the usual acceleration, most of which never reach the
    rate.
    """
    slews = []
    for angle in ANGLES:
        angle_rad = math.radians(angle)
        hold = max(math.sqrt(angle_rad / site.accelerations[0]), angle_rad / site.slew)
        pulse = JoystickPulse("gamma", site.slew, 0.0, hold)
        name = f"slew of {angle:g}°"
        start = _outside(site, crane)
        slews.append(_pulsed(crane, site.accelerations, name, start, pulse))
    return slews


def _outside(site: SiteCrane, crane: Crane) -> State:
    return crane.state(x=0.9 * site.jib, l=2.0 / 3.0 * site.height)


def _splined(name: str, site: SiteCrane, crane: Crane, start: State, goal: Sequence[float]) -> Job:
    rates = (site.slew, site.trolley, site.hoist[1])
    accelerations = site.accelerations
    (duration,) = shortest(crane, start, [goal], rates=rates, accelerations=accelerations)
    return Job(name, start, spline(crane, start, [goal], [duration]), duration)


def _pulsed(
    crane: Crane, accelerations: Sequence[float], name: str, start: State, *pulses: JoystickPulse
) -> Job:
    limits = dict(zip(("gamma", "x", "l"), accelerations, strict=True))
    arrival = max(pulse.at + pulse.hold + abs(pulse.rate) / limits[pulse.drive] for pulse in pulses)
    return Job(name, start, joystick(crane, start, pulses, accelerations=accelerations), arrival)


INERTIA = {"payload_inertia": 400.0, "dummy_mass": 50.0, "dummy_inertia": 50.0}
"""The article's load and links [kg m², kg, kg m²]."""

SWING = 0.02
"""Swing at the start of slow hoisting [rad]."""

DEEP = 0.9
"""Cable length before slow hoisting, over the longest."""

HIGH = 0.45
"""Cable length after slow hoisting, over the longest."""


class LinearCase(NamedTuple):
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
    return setup.simulate(
        crane,
        follow(crane, job.reference, setup.control_period),
        job.reference,
        start=job.start,
        duration=instant(job.arrival + period, setup.control_period),
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
    first = DEEP * site.height
    last = HIGH * site.height
    start = crane.state(l=first, phi=SWING)
    duration = 15.0 / 8.0 * (first - last) / site.hoist[0]
    goal = (0.0, start.q[crane.layout.index("x")], last)
    job = Job("", start, spline(crane, start, [goal], [duration]), duration)
    run = move(setup, crane, job, f"{site.name}: slow hoisting")
    by_model = integrate(run, paper, setup.gravity)
    amplitudes = [
        swing_amplitude(swing[-1:], rates[-1:], last, setup.gravity)[0]
        for swing, rates in (
            (run.coordinates("phi", "theta"), run.rates("phi", "theta")),
            np.split(by_model, 2, axis=1),
        )
    ]
    return [math.log(amplitude / SWING) / math.log(last / first) for amplitude in amplitudes]
