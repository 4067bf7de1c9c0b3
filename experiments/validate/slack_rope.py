"""Ropes that go slack and taut.

The load falls onto its rope, bounces and is caught, beside closed forms; and the energy ledger is
followed through a thousand changes of phase.

Drives stand still, so that an elastic rope is a linear spring while it is taut. The motion is along
the rope, by RK4 with a step that leaves less than a thousandth of what is allowed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from cranedyn import theory
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.integrators import Integrator, rk4, semi_implicit_euler
from cranedyn.interfaces import Drive, State
from cranedyn.lifts.judging.chart import Reeving
from cranedyn.model.crane import Crane
from experiments.harness import Claim, ResultTable, make_table
from experiments.validate.bench import MASS, Bench, G
from experiments.validate.reading import curve, zero_between

LENGTH = 10.0
"""Cable length [m]."""

EA = 1e6
"""Stiffness E A of one fall of the rope [N]."""

DRUM_MASS = 3000.0
"""Mass of the drum as it shows at the rope [kg]: its inertia over the square of its radius."""

SPEED = 2.0
"""Speed of the load at which its rope is taken up, or leaves it slack [m/s]."""

FALL_HEIGHT = 0.5
"""Height from which the load falls into its rope [m]."""

RELEASED_MASS = 200.0
"""Part of the load that is released [kg]."""

STEP = 2.5e-3
"""Step of the runs [s]."""

MAX_ERROR = 1e-6
"""Largest relative error of a run."""

PHASE_CHANGES = 1000
"""Number of changes from taut to slack and back through which the ledger is followed."""

TAUT = 0.0
"""Phase of a rope that pulls, as a run records it."""

SLACK = 1.0
"""Phase of a rope that does not."""


class SlackOracle(NamedTuple):
    """A number that mechanics knows of a rope that goes slack, and how to read it off a run.

    Attributes:
        name: What the number is.
        unit: Its unit, empty for a pure number.
        closed: Value in closed form.
        read: Function that makes the run and returns the value that it has.
    """

    name: str
    unit: str
    closed: float
    read: Callable[[], float]


class SlackCheck(NamedTuple):
    """An oracle and the number that its run has.

    Attributes:
        oracle: The oracle.
        simulated: Value in the run.
    """

    oracle: SlackOracle
    simulated: float

    @property
    def error(self) -> float:
        """Relative error."""
        return self.simulated / self.oracle.closed - 1.0

    @property
    def holds(self) -> bool:
        """Whether the run has the closed form."""
        return abs(self.error) < MAX_ERROR


def check_slack_oracle(oracle: SlackOracle) -> SlackCheck:
    """Make the run of an oracle and compare."""
    # Numbers read from a run are scalars of NumPy, which print differently.
    return SlackCheck(oracle._replace(closed=float(oracle.closed)), float(oracle.read()))


def slack_table(checks: Sequence[SlackCheck]) -> ResultTable:
    """Return the table of all checks."""
    return make_table(
        "Ropes that go slack",
        checks,
        ("quantity", "", lambda c: f"{c.oracle.name} [{c.oracle.unit}]".removesuffix(" []")),
        ("closed form", ".10g", lambda c: c.oracle.closed),
        (f"dt = {1000 * STEP:g} ms", ".7g", lambda c: c.simulated),
        ("error", "+.0e>1e-9", lambda c: c.error),
    )


def slack_claim(check: SlackCheck) -> Claim:
    """Return the claim that a run has the closed form."""
    quantity = f"{check.oracle.name}: {check.oracle.closed:.10g} {check.oracle.unit}".rstrip()
    return Claim(f"{quantity} within {MAX_ERROR:.0e}.", check.holds)


def oracles(bench: Bench) -> list[SlackOracle]:
    """Return the oracles of all ropes."""
    return [*_elastic(bench), *_reeved(bench), *_inextensible(bench)]


def _run(
    bench: Bench,
    crane: Crane,
    start: State,
    duration: float,
    *,
    dt: float = STEP,
    drive: Drive = "motion",
    rule: Integrator = rk4,
) -> Trajectory:
    """Run a crane with a row for each step, for at least a duration [s]."""
    duration = math.ceil(duration / dt) * dt
    return bench.run(crane, start, duration, dt, substeps=1, drive=drive, integrator=rule)


def _crane(bench: Bench, **values: float) -> Crane:
    """Return a crane with an elastic rope, with some numbers changed."""
    return bench.build(**{"rope_stiffness": EA, "hoist_init": LENGTH, "damp_swing": 0.0, **values})


def _stretched(crane: Crane, stretch: float, rate: float = 0.0) -> State:
    """Return the state with the rope stretched [m], at a rate [m/s]; negative if it is slack."""
    return crane.state(rope_stretch=stretch, rope_stretch_dot=rate)


def _elastic(bench: Bench) -> list[SlackOracle]:
    """Return the oracles of an elastic rope: T is its tension and W the weight of the load."""
    crane = _crane(bench)
    omega = theory.rope_bounce(EA, LENGTH, MASS)
    return [
        *_caught_by_spring(bench, crane, omega),
        *_bounces(bench, crane, omega),
        *_rebounds(bench, crane, omega),
        _released(bench),
        *_on_falls(bench),
    ]


def _caught_by_spring(bench: Bench, crane: Crane, omega: float) -> list[SlackOracle]:
    """Return the oracles of the largest tension of a load that its rope takes up or catches.

    Args:
        bench: Where it runs.
        crane: A crane with an elastic rope.
        omega: Frequency of the load on its rope [rad/s].
    """
    weight = MASS * G
    stiffness = EA / LENGTH
    static = weight / stiffness
    period = 2.0 * math.pi / omega

    def largest_tension(start: State, duration: float) -> float:
        """Return the largest tension over the weight."""
        first = _peaks(_run(bench, crane, start, duration))[0]
        return first.stretch / static

    @cache
    def taken_up() -> float:
        return largest_tension(_stretched(crane, static, SPEED), 0.5 * period)

    def snap() -> float:
        return (taken_up() - 1.0) * weight

    def fallen() -> float:
        return largest_tension(_stretched(crane, -FALL_HEIGHT), period)

    pickup_factor = theory.pickup_factor(SPEED, omega, G)
    # The kinetic energy goes into the spring: m v² = F²/k, beside the weight.
    snap_load = SPEED * math.sqrt(stiffness * MASS)
    fall_factor = theory.fall_factor(FALL_HEIGHT, stiffness, weight)
    return [
        SlackOracle(f"T/W, taken up at {SPEED:g} m/s", "", pickup_factor, taken_up),
        SlackOracle("snap load then, v √(k m)", "N", snap_load, snap),
        SlackOracle(f"T/W after a fall by {FALL_HEIGHT:g} m", "", fall_factor, fallen),
    ]


def _bounces(bench: Bench, crane: Crane, omega: float) -> list[SlackOracle]:
    """Return the oracles of a load that bounces: how long the rope is slack, and the period."""
    period = 2.0 * math.pi / omega
    flight = 2.0 * SPEED / G

    @cache
    def bouncing() -> Trajectory:
        start = _stretched(crane, 0.0, SPEED)
        return _run(bench, crane, start, 3.0 * (period + flight))

    def slack_time() -> float:
        slack_from, slack_to = _slack_times(bouncing(), crane.gravity)
        return slack_to - slack_from

    def bounce_period() -> float:
        first, second, *_ = _peaks(bouncing())
        return second.time - first.time

    bounce = _bounce_period(SPEED, omega, G)
    return [
        SlackOracle(f"slack after leaving at {SPEED:g} m/s", "s", flight, slack_time),
        SlackOracle(f"bounce period at {SPEED:g} m/s", "s", bounce, bounce_period),
    ]


def _rebounds(bench: Bench, crane: Crane, omega: float) -> list[SlackOracle]:
    """Return the oracles of the speed at which a damped rope throws its load back."""
    period = 2.0 * math.pi / omega
    start = _stretched(crane, 0.0, SPEED)

    def rebound(ratio: float) -> float:
        damped = _crane(bench, rope_damping=2.0 * ratio * omega * MASS)
        run = _run(bench, damped, start, period)
        rate = run["rope_stretch_dot_m_s"]
        stretch = run["rope_stretch_m"]
        free = np.flatnonzero((run["phase"] == SLACK) & (stretch < 0.0))[0]
        # In free fall v² - 2 g s stays. Where the rope has its own length, s = 0, it is v².
        return math.sqrt(rate[free] ** 2 - 2.0 * G * stretch[free])

    found = []
    for ratio in (0.02, 0.1):
        name = f"rebound from {SPEED:g} m/s, damping ratio {ratio:g}"
        closed = _rebound(SPEED, omega, ratio, G)
        found.append(SlackOracle(name, "m/s", closed, partial(rebound, ratio)))
    return found


def _released(bench: Bench) -> SlackOracle:
    """Return the oracle of the least tension after a part of the load is released.

    The run has the mass that is left, and starts with the stretch under the whole load.
    """
    mass = MASS - RELEASED_MASS
    stiffness = EA / LENGTH
    light = _crane(bench, payload_mass=mass)
    omega = theory.rope_bounce(EA, LENGTH, mass)
    # The load is highest half a period later.
    half = math.pi / omega
    period = 2.0 * math.pi / theory.rope_bounce(EA, LENGTH, MASS)

    def least() -> float:
        run = _run(bench, light, _stretched(light, MASS * G / stiffness), period)
        stretch = curve(run.t, run["rope_stretch_m"], int(half / STEP))(half)
        return float(stretch * stiffness / (mass * G))

    closed = 1.0 - theory.drop_factor(RELEASED_MASS, mass)
    return SlackOracle(f"T/W at least, {RELEASED_MASS:g} kg released", "", closed, least)


def _on_falls(bench: Bench) -> list[SlackOracle]:
    """Return the oracles of the period on several falls, which carry the load together."""
    static = MASS * G / (EA / LENGTH)
    period = 2.0 * math.pi / theory.rope_bounce(EA, LENGTH, MASS)

    def bounce_period(falls: int) -> float:
        crane = _crane(bench, falls=falls)
        run = _run(bench, crane, _stretched(crane, static / falls, 0.1 * SPEED), period)
        first, second, *_ = _peaks(run)
        return second.time - first.time

    found = []
    for falls in (2, 4):
        closed = 2.0 * math.pi / theory.rope_bounce(falls * EA, LENGTH, MASS)
        read = partial(bounce_period, falls)
        found.append(SlackOracle(f"period on {falls} falls", "s", closed, read))
    return found


def _reeved(bench: Bench) -> list[SlackOracle]:
    """Return the oracles of the pull in the line that leads to the drum.

    Of n falls each has η times the tension of the one before it, where sheaves turn with an
    efficiency η. The tensions are a geometric series whose sum is the weight. While the load is
    lowered, the line has the least of them and not the largest: 1/η stands for η.
    """
    crane = _crane(bench, rope_stiffness=0.0)
    falls = 4
    efficiency = 0.95

    def line(rate: float) -> float:
        run = _run(bench, crane, crane.state(l_dot=rate), 0.1)
        return float(Reeving(falls, efficiency).columns(crane, run)["line_N"][-1])

    found = []
    for verb, rate, ratio in (("hoists", -0.1, efficiency), ("lowers", 0.1, 1.0 / efficiency)):
        closed = MASS * G * (1.0 - ratio) / (1.0 - ratio**falls)
        name = f"line of {falls} falls that {verb}, η = {efficiency:g}"
        found.append(SlackOracle(name, "N", closed, partial(line, rate)))
    return found


def _inextensible(bench: Bench) -> list[SlackOracle]:
    """Return the oracles of a rope that does not stretch: it catches the load by an impact."""
    crane = _crane(bench, rope_stiffness=math.inf, drum_inertia=DRUM_MASS)
    return [*_impact_below(bench, crane), _impact_beside(bench, crane)]


def _impact_below(bench: Bench, crane: Crane) -> list[SlackOracle]:
    """Return the oracles of a load that falls below its pivot and is caught by a free drum."""
    time = math.sqrt(2.0 * FALL_HEIGHT / G)
    speed = G * time
    total_mass = MASS + DRUM_MASS
    reduced_mass = MASS * DRUM_MASS / total_mass
    # `_run` ends at a multiple of the step.
    end = math.ceil(2.0 * time / STEP) * STEP

    @cache
    def caught() -> Trajectory:
        return _run(bench, crane, _stretched(crane, -FALL_HEIGHT), 2.0 * time, drive="effort")

    # Load and drum share the momentum, and then fall together under the weight of the load.
    after = MASS * speed / total_mass + MASS * G / total_mass * (end - time)
    lost = -reduced_mass * speed**2 / 2.0
    return [
        SlackOracle(
            "load and drum after an impact",
            "m/s",
            after,
            lambda: float(caught()["l_dot_m_s"][-1]),
        ),
        SlackOracle("work of that impact", "J", lost, lambda: float(caught()["W_impacts_J"][-1])),
    ]


def _impact_beside(bench: Bench, crane: Crane) -> SlackOracle:
    """Return the oracle of a load that starts 2 m nearer to the pivot than the rope is long, and
    aside of it.
    """
    aside = math.radians(40.0)
    slack = 2.0

    def work() -> float:
        run = _run(bench, crane, crane.state(phi=aside, rope_stretch=-slack), 4.0)
        caught = np.flatnonzero(run["phase"] == TAUT)[0]
        return float(run["W_impacts_J"][caught])

    closed = _work_of_catching(LENGTH - slack, aside, LENGTH, MASS, G)
    return SlackOracle("work, load caught beside its pivot", "J", closed, work)


def _rebound(speed: float, frequency: float, ratio: float, gravity: float) -> float:
    """Return the speed at which a damped rope throws its load back [m/s], where it has the length
    of the unstretched rope again.

    The rope is a spring with a damper that pulls but does not push: it lets go before that length.

    Args:
        speed: Speed at which the rope catches the load [m/s].
        frequency: Frequency of the load on its rope without damping [rad/s].
        ratio: Damping ratio of the rope.
        gravity: Gravity [m/s²].
    """
    static = gravity / frequency**2
    decay = ratio * frequency
    damped = frequency * math.sqrt(1.0 - ratio**2)

    def motion(t: float) -> tuple[float, float]:
        """Return stretch [m] and its rate [m/s]."""
        # z = exp(-decay t) (-static cos + b sin), about the stretch at rest under the weight.
        b = (speed - decay * static) / damped
        cosine = math.cos(damped * t)
        sine = math.sin(damped * t)
        z = math.exp(-decay * t) * (b * sine - static * cosine)
        rate = math.exp(-decay * t) * damped * (b * cosine + static * sine) - decay * z
        return static + z, rate

    def pull(t: float) -> float:
        """Return the tension over the mass [m/s²]."""
        stretch, rate = motion(t)
        return frequency**2 * stretch + 2.0 * decay * rate

    half = math.pi / damped
    released = brentq(pull, 0.25 * half, 1.75 * half, xtol=1e-15)
    stretch, rate = motion(released)
    return math.sqrt(rate**2 - 2.0 * gravity * stretch)


def _work_of_catching(
    distance: float, angle: float, length: float, mass: float, gravity: float
) -> float:
    """Return the work of the impact in which an inextensible rope catches a load beside its pivot.

    The load falls freely from rest until it is as far from the pivot as the rope is long. Then the
    part of its speed along the rope is lost.

    Args:
        distance: Distance from the pivot at first [m].
        angle: Angle from plumb at first [rad].
        length: Length of the rope [m].
        mass: Mass of the load [kg].
        gravity: Gravity [m/s²].

    Returns:
        The work [J], negative.
    """
    down = math.sqrt(length**2 - (distance * math.sin(angle)) ** 2)
    height = down - distance * math.cos(angle)
    # m v²/2 = m g h, of which the square of the cosine between fall and rope is lost.
    return -mass * gravity * height * (down / length) ** 2


def _bounce_period(speed: float, frequency: float, gravity: float) -> float:
    """Return the period of a load that bounces on a rope and leaves it slack [s].

    It is 2 v/g in flight and (π + 2 atan(g/(ω v)))/ω on the rope.

    Args:
        speed: Speed at which the load leaves the rope, and comes back, v [m/s].
        frequency: Frequency of the load on its rope, ω [rad/s].
        gravity: Gravity, g [m/s²].
    """
    taut = (math.pi + 2.0 * math.atan(gravity / (frequency * speed))) / frequency
    return 2.0 * speed / gravity + taut


class _Peak(NamedTuple):
    """A largest stretch of the rope.

    Attributes:
        time: When it is [s].
        stretch: How large it is [m].
    """

    time: float
    stretch: float


def _peaks(run: Trajectory) -> list[_Peak]:
    """Return the largest stretches of the rope in a run, read between the rows."""
    t = run.t
    stretch = run["rope_stretch_m"]
    before = stretch[:-2]
    here = stretch[1:-1]
    after = stretch[2:]
    rows = np.flatnonzero((here > before) & (here >= after) & (here > 0.0)) + 1
    peaks = []
    for row in rows.tolist():
        smooth = curve(t, stretch, row)
        time = zero_between(smooth.derivative(), t[row - 1], t[row + 1])
        peaks.append(_Peak(time, float(smooth(time))))
    return peaks


def _slack_times(run: Trajectory, gravity: float) -> tuple[float, float]:
    """Return the times between which the rope is slack for the first time [s]: where the parabolas
    of the first and the last slack row meet zero.
    """
    rows = np.flatnonzero(run["phase"] == SLACK)
    # The first slack rows end where the next one does not follow, or there is none.
    first = rows[0]
    last = rows[np.flatnonzero(np.diff(rows, append=rows[-1] + 2) > 1)[0]]
    times = []
    for row, side in ((first, -1.0), (last, 1.0)):
        # s + v t + g t²/2 = 0, before the first row and after the last.
        s = run["rope_stretch_m"][row]
        v = run["rope_stretch_dot_m_s"][row]
        times.append(run.t[row] + (side * math.sqrt(v**2 - 2.0 * gravity * s) - v) / gravity)
    return times[0], times[1]


class _BouncingLoad(NamedTuple):
    """A slow load on a stiff rope, whose bounces are short: it changes phase twice in each.

    Attributes:
        crane: The crane.
        start: State in which the load stretches the rope.
        period: Period of a bounce [s].
    """

    crane: Crane
    start: State
    period: float


def _bouncing_load(bench: Bench) -> _BouncingLoad:
    """Return the load whose energy is followed."""
    stiffness = 1e3 * EA
    speed = 3e-3 * SPEED
    crane = _crane(bench, rope_stiffness=stiffness)
    omega = theory.rope_bounce(stiffness, LENGTH, MASS)
    return _BouncingLoad(crane, _stretched(crane, 0.0, speed), _bounce_period(speed, omega, G))


def ledger_of_rk4(bench: Bench) -> Claim:
    """Return the claim on the energy that the ledger leaves unexplained by RK4, which follows the
    load through all changes of phase.
    """
    crane, start, period = _bouncing_load(bench)
    # Two changes in a bounce.
    run = _run(bench, crane, start, (PHASE_CHANGES // 2 + 1) * period, dt=2.5e-4)
    changes = np.count_nonzero(np.diff(run["phase"]))
    return Claim(
        f"RK4: through {PHASE_CHANGES:g} changes of phase the ledger closes to 1e-9 of the energy.",
        bool(changes >= PHASE_CHANGES and _unexplained(run) < 1e-9),
    )


def ledger_of_semi_implicit_euler(bench: Bench) -> Claim:
    """Return the claim on the same energy by semi-implicit Euler, with two steps through a few
    changes of phase.
    """
    crane, start, period = _bouncing_load(bench)
    unexplained = []
    for dt in (4e-5, 1e-5):
        run = _run(bench, crane, start, 5 * period, dt=dt, rule=semi_implicit_euler)
        unexplained.append(_unexplained(run))
    coarse, fine = unexplained
    return Claim(
        "Semi-implicit Euler: the energy left over falls with the step, 3 to 5 times for a fourth.",
        3.0 < coarse / fine < 5.0,
    )


def _unexplained(run: Trajectory) -> float:
    """Return the largest energy that the ledger leaves unexplained, over the largest energy."""
    return float(np.abs(run.unexplained).max() / np.abs(run["energy_J"]).max())
