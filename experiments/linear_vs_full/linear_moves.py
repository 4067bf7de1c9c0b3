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

SLEW_RAMP = 5.0
"""Time in which the slew reaches its rate [s]; our choice."""

TROLLEY_RAMP = 4.0
"""Time in which the trolley reaches its speed [s]; our choice."""

HOIST_ACCELERATION = 0.4
"""Acceleration of the hoist [m/s²]; our choice."""

QUARTER_TURN = math.pi / 2.0
"""Angle of every slew at full rate [rad]."""


class SiteCrane(NamedTuple):
    """A crane with its speeds.

    Attributes:
        name: What it is called.
        jib: Largest trolley radius [m].
        height: Largest height of the hook, which is taken as the longest cable [m].
        trolley: Speed of the trolley [m/s].
        slew: Slew rate [rad/s].
        slow_hoist: Speed of the hoist with a heavy load [m/s].
        fast_hoist: Speed of the hoist with a light load [m/s].
    """

    name: str
    jib: float
    height: float
    trolley: float
    slew: float
    slow_hoist: float
    fast_hoist: float

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
        """Accelerations of slew [rad/s²], trolley and hoist [m/s²]."""
        return self.slew / SLEW_RAMP, self.trolley / TROLLEY_RAMP, HOIST_ACCELERATION


SLOW_HOIST = 17.0
"""Speed of the makers' hoists with the heaviest load [m/min]."""

FAST_HOIST = 134.0
"""Speed of the makers' hoists with a light load [m/min]."""


def _listed_crane(name: str, jib: float, height: float, trolley: float, slew: float) -> SiteCrane:
    """Return a crane of a maker's list.

    Args:
        name: What it is called.
        jib: Largest trolley radius [m].
        height: Largest height of the hook [m].
        trolley: Speed of the trolley [m/min].
        slew: Slew rate [1/min].
    """
    return SiteCrane(
        name,
        jib,
        height,
        trolley / 60.0,
        slew * math.pi / 30.0,
        SLOW_HOIST / 60.0,
        FAST_HOIST / 60.0,
    )


ARTICLE_CRANE = SiteCrane("article's crane", 22.0, 26.4, 0.8, 0.08, SLOW_HOIST / 60.0, 0.8)
"""The article's crane with the speeds of the demo."""

SITES = (
    ARTICLE_CRANE,
    _listed_crane("71 EC-B 5", 50.0, 45.0, 63.0, 0.8),
    _listed_crane("380 EC-B 16", 75.0, 83.0, 95.0, 0.8),
    _listed_crane("L1-24", 25.0, 19.0, 22.0, 0.5),
)
"""The article's crane, and three of a maker's list."""


class MoveJob(NamedTuple):
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


def jobs(site: SiteCrane, crane: Crane) -> list[MoveJob]:
    """Return the moves: single drives, in splines and at constant speed between ramps, then pairs,
    then all.
    """
    middle = 0.5 * site.jib
    tip = 0.9 * site.jib
    high = 2.0 / 3.0 * site.height
    low = 0.9 * site.height
    inside = crane.state(x=middle, l=high)
    outside = crane.state(x=tip, l=high)
    below = crane.state(x=middle, l=low)
    outward = _full_speed("x", site.trolley, 0.4 * site.jib)
    slew = _full_speed("gamma", site.slew, QUARTER_TURN)
    slow = _full_speed("l", -site.slow_hoist, 0.3 * site.height)
    fast = _full_speed("l", -site.fast_hoist, 0.6 * site.height)
    pulsed = partial(_pulsed, crane, site.accelerations)
    return [
        _splined("trolley, spline", site, crane, inside, (0.0, tip, high)),
        pulsed("trolley", inside, outward),
        _splined("slew, spline", site, crane, outside, (QUARTER_TURN, tip, high)),
        pulsed("slew", outside, slew),
        pulsed("slew, trolley", inside, slew, outward),
        pulsed("trolley, slow hoist", below, outward, slow),
        pulsed("trolley, fast hoist", below, outward, fast),
        pulsed("slew, trolley, fast hoist", below, slew, outward, fast),
    ]


def _full_speed(symbol: str, rate: float, distance: float) -> JoystickPulse:
    """Return the pulse of the joystick that moves a drive by a distance at a rate.

    Args:
        symbol: Symbol of the drive.
        rate: Rate, with the sign of the direction [rad/s or m/s].
        distance: Distance [rad or m].
    """
    return JoystickPulse(symbol, rate, 0.0, distance / abs(rate))


SHARES = (1.0, 1 / 2, 1 / 4, 1 / 8, 1 / 16, 1 / 32)
"""Rates at which a crane turns, over its largest slew rate."""

HOLD = 30.0
"""Time for which the joystick is held [s]."""

ANGLES = (1.0, 2.0, 5.0, 10.0, 20.0)
"""Short slews [°]."""


def slow_slews(site: SiteCrane, crane: Crane) -> list[MoveJob]:
    """Return slews at shares of the crane's rate, reached in the usual time."""
    slew, trolley, hoist = site.accelerations
    slews = []
    for share in SHARES:
        name = f"slew at {share:g} of the rate"
        pulse = JoystickPulse("gamma", share * site.slew, 0.0, HOLD)
        accelerations = (share * slew, trolley, hoist)
        slews.append(_pulsed(crane, accelerations, name, _outside(site, crane), pulse))
    return slews


def short_slews(site: SiteCrane, crane: Crane) -> list[MoveJob]:
    """Return slews by small angles at the usual acceleration, most of which never reach the
    rate.
    """
    slews = []
    for angle in ANGLES:
        angle_rad = math.radians(angle)
        # The joystick is held while the jib speeds up over half of the angle, t = √(angle/a); or,
        # if the jib reaches its rate before, for as long as the angle takes at this rate.
        hold = max(math.sqrt(angle_rad / site.accelerations[0]), angle_rad / site.slew)
        pulse = JoystickPulse("gamma", site.slew, 0.0, hold)
        name = f"slew of {angle:g}°"
        slews.append(_pulsed(crane, site.accelerations, name, _outside(site, crane), pulse))
    return slews


def _outside(site: SiteCrane, crane: Crane) -> State:
    """Return the crane at rest with the trolley near the tip of the jib."""
    return crane.state(x=0.9 * site.jib, l=2.0 / 3.0 * site.height)


def _splined(
    name: str, site: SiteCrane, crane: Crane, start: State, goal: Sequence[float]
) -> MoveJob:
    """Return a move by a quintic spline, as fast as the limits of the drives allow."""
    (duration,) = shortest(
        crane,
        start,
        [goal],
        rates=(site.slew, site.trolley, site.fast_hoist),
        accelerations=site.accelerations,
    )
    return MoveJob(name, start, spline(crane, start, [goal], [duration]), duration)


def _pulsed(
    crane: Crane, accelerations: Sequence[float], name: str, start: State, *pulses: JoystickPulse
) -> MoveJob:
    """Return a move by pulses of the joystick, which ends once all drives stand still again."""
    limits = dict(zip(("gamma", "x", "l"), accelerations, strict=True))
    ends = [pulse.at + pulse.hold + abs(pulse.rate) / limits[pulse.drive] for pulse in pulses]
    reference = joystick(crane, start, pulses, accelerations=accelerations)
    return MoveJob(name, start, reference, max(ends))


INERTIA = {"payload_inertia": 400.0, "dummy_mass": 50.0, "dummy_inertia": 50.0}
"""The article's load and links [kg m², kg, kg m²]."""

SWING = 0.02
"""Swing at the start of slow hoisting [rad]."""

SLOW_START = 0.9
"""Cable length before slow hoisting, over the longest."""

SLOW_END = 0.45
"""Cable length after slow hoisting, over the longest."""


class LinearCase(NamedTuple):
    """One move of one crane: the run of the plant with a point load, and how far each model is from
    it.

    Attributes:
        site: The crane.
        job: The move.
        run: The run of the plant.
        paper: Error of the paper's equations.
        rates: Error of the equations with all rates.
        rigid: Error of the paper's equations beside the plant with the article's inertia; None
            where that was not run.
        kept: The larger of ẍ and x γ̈, which the paper keeps [m/s²].
        dropped: Largest value of each term that the paper drops, over this, by its formula.
    """

    site: SiteCrane
    job: MoveJob
    run: Trajectory
    paper: Miss
    rates: Miss
    rigid: Miss | None
    kept: float
    dropped: Mapping[str, float]


def move(setup: Setup, crane: Crane, job: MoveJob, label: str) -> Trajectory:
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
    """Make every move of one crane with a point load.

    The article's crane, whose inertia is known, makes it with that besides.
    """
    rigid_crane = site.crane(setup, **INERTIA) if site is ARTICLE_CRANE else None
    cases = []
    for job in jobs(site, crane):
        label = f"{site.name}: {job.name}"
        run = move(setup, crane, job, label)
        rigid = None
        if rigid_crane is not None:
            rigid_run = move(setup, rigid_crane, job, f"{label}, inertia")
            rigid = _missed(setup, rigid_run, paper)
        kept, dropped_terms = dropped(run)
        case = LinearCase(
            site=site,
            job=job,
            run=run,
            paper=_missed(setup, run, paper),
            rates=_missed(setup, run, all_rates),
            rigid=rigid,
            kept=kept,
            dropped=dropped_terms,
        )
        cases.append(case)
    return cases


def _missed(setup: Setup, run: Trajectory, model: Model) -> Miss:
    """Return the error of a model beside a run."""
    return miss(run, integrate(run, model, setup.gravity))


def scan(setup: Setup, crane: Crane, jobs_of_crane: Sequence[MoveJob]) -> list[float]:
    """Return the error of the paper's equations in each of some moves, root mean square over the
    largest swing.
    """
    errors = []
    for job in jobs_of_crane:
        run = move(setup, crane, job, job.name)
        errors.append(_missed(setup, run, paper).rms)
    return errors


def reaches(values: Sequence[float], errors: Sequence[float], good: float) -> float:
    """Return the value at which an error that grows with it is just good enough.

    It is interpolated between two neighbours by their logarithms.

    Args:
        values: Values.
        errors: Error at each.
        good: Largest error that is good enough.

    Raises:
        DataError: If the error is good enough at all values, or at none.
    """
    by_size = sorted(zip(errors, values, strict=True))
    for (low, value), (high, next_value) in itertools.pairwise(by_size):
        if low <= good < high:
            return value * (next_value / value) ** (math.log(good / low) / math.log(high / low))
    raise DataError(
        f"The errors run from {by_size[0][0]:g} to {by_size[-1][0]:g}; {good:g} is not among them."
    )


class HoistingPowers(NamedTuple):
    """Powers of the cable length with which a free swing changes when it is hoisted slowly.

    Attributes:
        plant: In the run of the plant.
        paper: By the paper's Eq. (8).
    """

    plant: float
    paper: float


def powers(setup: Setup, site: SiteCrane, crane: Crane) -> HoistingPowers:
    """Return the powers of slow hoisting of a crane."""
    first = SLOW_START * site.height
    last = SLOW_END * site.height
    start = crane.state(l=first, phi=SWING)
    # The largest rate of a quintic spline is 15/8 of its mean: it is the slow speed of the hoist.
    duration = 15.0 / 8.0 * (first - last) / site.slow_hoist
    goal = (0.0, start.q[crane.layout.index("x")], last)
    job = MoveJob("", start, spline(crane, start, [goal], [duration]), duration)
    run = move(setup, crane, job, f"{site.name}: slow hoisting")
    by_paper, by_paper_rates = np.split(integrate(run, paper, setup.gravity), 2, axis=1)

    def power(swing: np.ndarray, rates: np.ndarray) -> float:
        """Return the power from the swing at the end."""
        amplitude = swing_amplitude(swing[-1:], rates[-1:], last, setup.gravity)[0]
        return math.log(amplitude / SWING) / math.log(last / first)

    return HoistingPowers(
        plant=power(run.coordinates("phi", "theta"), run.rates("phi", "theta")),
        paper=power(by_paper, by_paper_rates),
    )
