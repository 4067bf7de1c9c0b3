"""Ropes that go slack and taut: the load that falls onto its rope, bounces and is caught, beside
closed forms; and the energy ledger through a thousand changes of phase.

Drives stand still, so that an elastic rope is a linear spring while it is taut. The motion is along
the rope, by RK4 with a step that leaves less than a thousandth of what is allowed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from cranedyn import theory
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.integrators import Integrator, rk4, semi_implicit_euler
from cranedyn.interfaces import Drive, State
from cranedyn.lifting.chart import Reeving
from cranedyn.model.crane import Crane
from experiments.harness import Claim, ResultTable, make_table
from experiments.oracles.bench import MASS, Bench, G, curve, zero_between

LENGTH, EA, DRUM = 10.0, 1e6, 3000.0
"""Cable length [m], EA of a fall of the rope [N], and mass of the drum at the rope [kg]."""

SPEED, HEIGHT, RELEASED, DT = 2.0, 0.5, 200.0, 2.5e-3
"""Speed of the load [m/s], height of its fall [m], part that is released [kg], and step [s]."""

ALLOWED, CHANGES = 1e-6, 1000
"""Relative error allowed, and changes of phase."""


class SlackCheck(NamedTuple):
    """A number in closed form and in a run."""

    name: str
    unit: str
    closed: float
    simulated: float

    @property
    def error(self) -> float:
        """Relative error."""
        return self.simulated / self.closed - 1.0


def study(bench: Bench) -> tuple[ResultTable, list[Claim], int]:
    """Return the table, its claims, and the number of closed forms."""
    results = [
        check._replace(closed=float(check.closed), simulated=float(check.simulated))
        for check in (*_elastic(bench), *_reeved(bench), *_inextensible(bench))
    ]
    table = make_table(
        "Ropes that go slack",
        results,
        ("quantity", "", lambda c: f"{c.name} [{c.unit}]".removesuffix(" []")),
        ("closed form", ".10g", lambda c: c.closed),
        (f"dt = {1000 * DT:g} ms", ".7g", lambda c: c.simulated),
        ("error", "+.0e>1e-9", lambda c: c.error),
    )
    claims = [
        Claim(f"{c.name}: {c.closed:.10g} {c.unit}".rstrip() + f" within {ALLOWED:.0e}.",
              abs(c.error) < ALLOWED)
        for c in results
    ]  # fmt: skip
    return table, [*claims, *_ledgers(bench)], len(results)


def _run(
    bench: Bench,
    crane: Crane,
    start: State,
    duration: float,
    *,
    dt: float = DT,
    drive: Drive = "motion",
    rule: Integrator = rk4,
) -> Trajectory:
    duration = math.ceil(duration / dt) * dt
    return bench.run(crane, start, duration, dt, substeps=1, drive=drive, integrator=rule)


def _crane(bench: Bench, **values: float) -> Crane:
    return bench.build(**{"rope_stiffness": EA, "hoist_init": LENGTH, "damp_swing": 0.0, **values})


def _from(crane: Crane, stretch: float, rate: float = 0.0) -> State:
    return crane.state(rope_stretch=stretch, rope_stretch_dot=rate)


def _elastic(bench: Bench) -> Iterator[SlackCheck]:
    crane = _crane(bench)
    weight = MASS * G
    stiffness = EA / LENGTH
    static = weight / stiffness
    omega = theory.rope_bounce(EA, LENGTH, MASS)
    period = 2.0 * math.pi / omega

    def peak(start: State, duration: float) -> float:
        return _peaks(_run(bench, crane, start, duration))[0][1] / static

    taken_up = peak(_from(crane, static, SPEED), 0.5 * period)
    factor = theory.pickup_factor(SPEED, omega, G)
    yield SlackCheck(f"T/W, taken up at {SPEED:g} m/s", "", factor, taken_up)
    snap = SPEED * math.sqrt(stiffness * MASS)
    yield SlackCheck("snap load then, v √(k m)", "N", snap, (taken_up - 1.0) * weight)
    fallen = peak(_from(crane, -HEIGHT), period)
    factor = theory.fall_factor(HEIGHT, stiffness, weight)
    yield SlackCheck(f"T/W after a fall by {HEIGHT:g} m", "", factor, fallen)
    start = _from(crane, 0.0, SPEED)
    run = _run(bench, crane, start, 3.0 * (period + 2.0 * SPEED / G))
    leaves, back = _slack_times(run, crane.gravity)
    yield SlackCheck(f"slack after leaving at {SPEED:g} m/s", "s", 2.0 * SPEED / G, back - leaves)
    (first, _), (second, _), *_ = _peaks(run)
    bounce = _bounce_period(SPEED, omega, G)
    yield SlackCheck(f"bounce period at {SPEED:g} m/s", "s", bounce, second - first)
    for ratio in (0.02, 0.1):
        damped = _crane(bench, rope_damping=2.0 * ratio * omega * MASS)
        run = _run(bench, damped, start, period)
        v = run["rope_stretch_dot_m_s"]
        phase = run["phase"]
        s = run["rope_stretch_m"]
        free = np.flatnonzero((phase == 1.0) & (s < 0.0))[0]
        rebound = math.sqrt(v[free] ** 2 - 2.0 * G * s[free])
        closed = _rebound(SPEED, omega, ratio, G)
        yield SlackCheck(
            f"rebound from {SPEED:g} m/s, damping ratio {ratio:g}", "m/s", closed, rebound
        )
    mass = MASS - RELEASED
    light = _crane(bench, payload_mass=mass)
    half = math.pi / theory.rope_bounce(EA, LENGTH, mass)
    run = _run(bench, light, _from(light, static), period)
    lowest = curve(run.t, run["rope_stretch_m"], int(half / DT))(half) * stiffness / (mass * G)
    closed = 1.0 - theory.drop_factor(RELEASED, mass)
    yield SlackCheck(f"T/W at least, {RELEASED:g} kg released", "", closed, lowest)
    for falls in (2, 4):
        reeved = _crane(bench, falls=falls)
        start = _from(reeved, static / falls, 0.1 * SPEED)
        run = _run(bench, reeved, start, period)
        (first, _), (second, _), *_ = _peaks(run)
        closed = 2.0 * math.pi / theory.rope_bounce(falls * EA, LENGTH, MASS)
        yield SlackCheck(f"period on {falls} falls", "s", closed, second - first)


def _reeved(bench: Bench) -> Iterator[SlackCheck]:
    crane = _crane(bench, rope_stiffness=0.0)
    n = 4
    eta = 0.95
    for verb, rate, share in (("hoists", -0.1, eta), ("lowers", 0.1, 1.0 / eta)):
        run = _run(bench, crane, crane.state(l_dot=rate), 0.1)
        line = Reeving(n, eta).columns(crane, run)["line_N"][-1]
        closed = MASS * G * (1.0 - share) / (1.0 - share**n)
        yield SlackCheck(f"line of {n} falls that {verb}, η = {eta:g}", "N", closed, line)


def _inextensible(bench: Bench) -> Iterator[SlackCheck]:
    crane = _crane(bench, rope_stiffness=math.inf, drum_inertia=DRUM)
    start = _from(crane, -HEIGHT)
    time = math.sqrt(2.0 * HEIGHT / G)
    run = _run(bench, crane, start, 2.0 * time, drive="effort")
    speed = G * time
    reduced = MASS * DRUM / (MASS + DRUM)
    after = MASS * speed / (MASS + DRUM) + MASS * G / (MASS + DRUM) * (run.t[-1] - time)
    yield SlackCheck("load and drum after an impact", "m/s", after, run["l_dot_m_s"][-1])
    lost = -reduced * speed**2 / 2.0
    yield SlackCheck("work of that impact", "J", lost, run["W_impacts_J"][-1])
    aside = math.radians(40.0)
    run = _run(bench, crane, crane.state(phi=aside, rope_stretch=-2.0), 4.0)
    caught = np.flatnonzero(run["phase"] == 0.0)[0]
    name = "work, load caught beside its pivot"
    work = _caught(LENGTH - 2.0, aside, LENGTH, MASS, G)
    yield SlackCheck(name, "J", work, run["W_impacts_J"][caught])


def _rebound(speed: float, frequency: float, ratio: float, gravity: float) -> float:
    """Return the speed at which a load passes the length of the unstretched rope again, after the
    rope caught it at a speed [m/s]: a spring with a damper of a ratio that pulls only.
    """
    static = gravity / frequency**2
    decay = ratio * frequency
    damped = frequency * math.sqrt(1.0 - ratio**2)

    def motion(t: float) -> tuple[float, float]:
        """Return stretch [m] and its rate [m/s]."""
        # z = exp(-decay t) (-static cos + b sin) about the stretch at rest
        b = (speed - decay * static) / damped
        cosine = math.cos(damped * t)
        sine = math.sin(damped * t)
        z = math.exp(-decay * t) * (b * sine - static * cosine)
        rate = math.exp(-decay * t) * damped * (b * cosine + static * sine) - decay * z
        return static + z, rate

    def pull(t: float) -> float:
        stretch, rate = motion(t)
        return frequency**2 * stretch + 2.0 * decay * rate

    half = math.pi / damped
    released = brentq(pull, 0.25 * half, 1.75 * half, xtol=1e-15)
    stretch, rate = motion(released)
    return math.sqrt(rate**2 - 2.0 * gravity * stretch)


def _caught(distance: float, angle: float, length: float, mass: float, gravity: float) -> float:
    """Return the work of the impact [J] in which an inextensible rope catches a load that falls
    freely from rest at a distance and an angle from plumb: the speed along the rope is lost.
    """
    down = math.sqrt(length**2 - (distance * math.sin(angle)) ** 2)
    height = down - distance * math.cos(angle)
    return -mass * gravity * height * (down / length) ** 2


def _bounce_period(speed: float, frequency: float, gravity: float) -> float:
    """Return the period of a load that bounces on a rope and leaves it slack [s]: 2 v/g in flight
    and (π + 2 atan(g/(ω v)))/ω on the rope.
    """
    taut = (math.pi + 2.0 * math.atan(gravity / (frequency * speed))) / frequency
    return 2.0 * speed / gravity + taut


def _peaks(run: Trajectory) -> list[tuple[float, float]]:
    """Return times [s] and values [m] of the largest stretches."""
    t = run.t
    s = run["rope_stretch_m"]
    peaks = []
    for row in (
        np.flatnonzero((s[1:-1] > s[:-2]) & (s[1:-1] >= s[2:]) & (s[1:-1] > 0.0)) + 1
    ).tolist():
        smooth = curve(t, s, row)
        time = zero_between(smooth.derivative(), t[row - 1], t[row + 1])
        peaks.append((time, float(smooth(time))))
    return peaks


def _slack_times(run: Trajectory, gravity: float) -> tuple[float, float]:
    """Return the times [s] between which the rope is slack for the first time: where the parabolas
    of the first and last slack rows meet zero.
    """
    rows = np.flatnonzero(run["phase"] == 1.0)
    last = rows[np.flatnonzero(np.diff(rows, append=rows[-1] + 2) > 1)[0]]
    times = []
    for row, side in ((rows[0], -1.0), (last, 1.0)):
        s = run["rope_stretch_m"][row]
        v = run["rope_stretch_dot_m_s"][row]
        times.append(run.t[row] + (side * math.sqrt(v**2 - 2.0 * gravity * s) - v) / gravity)
    return times[0], times[1]


def _ledgers(bench: Bench) -> Iterator[Claim]:
    """Bounce until the rope has changed its phase a thousand times, and see what energy is left
    over; by semi-implicit Euler a part of it, with two steps.
    """
    stiffness = 1e3 * EA
    speed = 3e-3 * SPEED
    crane = _crane(bench, rope_stiffness=stiffness)
    omega = theory.rope_bounce(stiffness, LENGTH, MASS)
    start = _from(crane, 0.0, speed)
    period = _bounce_period(speed, omega, G)
    run = _run(bench, crane, start, (CHANGES // 2 + 1) * period, dt=2.5e-4)
    changes = np.count_nonzero(np.diff(run["phase"]))
    unexplained = _unexplained(run)
    yield Claim(
        f"RK4: through {CHANGES:g} changes of phase the ledger closes to 1e-9 of the energy.",
        bool(changes >= CHANGES and unexplained < 1e-9),
    )
    coarse, fine = (
        _unexplained(_run(bench, crane, start, 5 * period, dt=dt, rule=semi_implicit_euler))
        for dt in (4e-5, 1e-5)
    )
    yield Claim(
        "Semi-implicit Euler: the energy left over falls with the step, 3 to 5 times for a fourth.",
        3.0 < coarse / fine < 5.0,
    )


def _unexplained(run: Trajectory) -> float:
    return float(np.abs(run.unexplained).max() / np.abs(run["energy_J"]).max())
