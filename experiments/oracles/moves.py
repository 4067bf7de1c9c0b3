"""A jib that turns steadily: where the load hangs, how it pulls, and its swing as seen from the
jib; and what moves of the trolley leave of swing: pulses of acceleration, quintic splines.
"""

from __future__ import annotations

import math
from functools import cache, partial

import numpy as np

from cranedyn import theory
from cranedyn.data.trajectory import Trajectory
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.references import spline
from experiments.oracles.bench import FINITE, MASS, SELDOM, SMALL, Bench, Build, G, Oracle

STEADY = ((50.0, 45.0, 0.8), (25.0, 19.0, 0.5))
"""Trolley radius, cable length [m] and slew rate [1/min] of a 71 EC-B 5 and an L1-24 at the tip of
their jibs."""

SETTLING, MINUTE = 140.0, 60.0
"""How long the load has to settle, and how long it must stay there [s]."""

LENGTH, RATE, SAMPLE = 20.0, 0.1, 0.5
"""Cable length [m] of all but steady slewing; slew rate [rad/s] and time between samples [s] of the
swing seen from the jib."""


def turning_jib(bench: Bench) -> list[Oracle]:
    """Return the oracles of angles and tensions of steady slewing, and of the two frequencies."""
    crane = bench.build()
    steady = [oracle for case in STEADY for oracle in _steady(bench, *case)]
    return [*steady, _stay(bench, crane, *STEADY[0]), *_modes(bench, crane)]


def turning(build: Build, radius: float, length: float, rpm: float) -> tuple[Crane, State]:
    """Return a crane whose load hangs plumb under a jib that turns, with swing joints damped so
    that it settles; at rest they exert nothing.
    """
    damping = 1.2 * MASS * length**2 * math.sqrt(G / length)
    crane = build(damp_swing=damping)
    return crane, crane.state(x=radius, l=length, gamma_dot=rpm * math.pi / 30.0)


def _steady(bench: Bench, radius: float, length: float, rpm: float) -> list[Oracle]:
    rate = rpm * math.pi / 30.0
    crane, plumb = turning(bench.build, radius, length, rpm)
    settled = cache(lambda dt: bench.run(crane, plumb, SETTLING, dt, substeps=SELDOM))
    location = f"x = {radius:g} m, l = {length:g} m, {rpm:g} rpm"
    angle = -math.degrees(theory.slewing_swing(radius, length, rate, G))
    pull = theory.slewing_tension(radius, length, rate, G, MASS)

    def outward(dt: float) -> float:
        return -math.degrees(settled(dt)["phi_rad"][-1])

    return [
        Oracle(f"load settles outward, {location}", "°", angle, outward),
        Oracle(f"tension then, {location}", "N", pull, lambda dt: -float(settled(dt)["F_l_N"][-1])),
    ]


def _stay(bench: Bench, crane: Crane, radius: float, length: float, rpm: float) -> Oracle:
    rate = rpm * math.pi / 30.0
    phi = theory.slewing_swing(radius, length, rate, G)
    start = crane.state(x=radius, l=length, gamma_dot=rate, phi=phi)

    def strays(dt: float) -> float:
        swing = bench.run(crane, start, MINUTE, dt, substeps=SELDOM).coordinates("phi", "theta")
        return float(np.abs(swing - swing[0]).max())

    return Oracle("strays from there in a minute without damping", "rad", 0.0, strays)


def _modes(bench: Bench, crane: Crane) -> list[Oracle]:
    """Return the oracles of a swing from the slew axis, where no centrifugal force bends the cable;
    two frequencies fitted to φ + iθ (Prony).
    """
    start = crane.state(x=0.0, l=LENGTH, gamma_dot=RATE, phi=1e-6, theta_dot=2e-7)

    @cache
    def rates(dt: float) -> list[float]:
        """Return the rates of the parts that turn forward and backward in the plane of φ and θ
        [rad/s].
        """
        run = bench.run(crane, start, MINUTE, dt)
        stride = round(SAMPLE / (run.t[1] - run.t[0]))
        z = (run["phi_rad"] + 1j * run["theta_rad"])[::stride]
        a, b = np.linalg.lstsq(np.stack([z[1:-1], z[:-2]], axis=1), z[2:], rcond=None)[0]
        back, forth = np.sort(np.log(np.roots([1.0, -a, -b])).imag / SAMPLE).tolist()
        return [forth, -back]

    omega = math.sqrt(G / LENGTH)
    observed = f"seen from a jib at {RATE:g} rad/s"
    return [
        Oracle(f"{observed}: slow swing, ω - Ω", "rad/s", omega - RATE, lambda dt: rates(dt)[0]),
        Oracle(f"{observed}: fast swing, ω + Ω", "rad/s", omega + RATE, lambda dt: rates(dt)[1]),
    ]


PUSH, PULSE, COAST = 0.3, 4.0, 6.0
"""Acceleration of the trolley [m/s²], how long it lasts, and how long the trolley runs on before it
brakes [s]."""

DISTANCE, DURATIONS = 10.0, (10.0, 15.0)
"""Way of a spline [m] and times for it [s]."""

QUIET, QUIET_DURATION = (1.834566, 2.895032, 4.938452), 20.0
"""Durations in periods of the swing at which a spline leaves none (to six decimals), and the time
for which cables are chosen so [s]."""


def trolley_moves(bench: Bench) -> list[Oracle]:
    """Return the oracles of residual swings."""
    crane = bench.build()
    return [
        *_pulses(bench, crane),
        *(_spline(bench, crane, duration) for duration in DURATIONS),
        *(_quiet(bench, crane, ratio) for ratio in QUIET),
    ]


def _left(run: Trajectory) -> float:
    """Return the amplitude of the residual radial swing [rad], scaled up again."""
    phi, rate, length = (float(run[column][-1]) for column in ("phi_rad", "phi_dot_rad_s", "l_m"))
    return math.hypot(phi, rate * math.sqrt(length / G)) / SMALL


def _finite(swing: float) -> float:
    """Return the change by a finite swing on the way [rad]: its square, scaled down, of itself."""
    return swing * (SMALL * swing) ** 2


def _pulses(bench: Bench, crane: Crane) -> list[Oracle]:
    def pulse(t: float, state: State, setpoint: Setpoint, dt: float) -> np.ndarray:
        braking = t > PULSE + COAST - dt / 2.0
        return SMALL * PUSH * ((t < PULSE - dt / 2.0) - braking) * crane.layout.along("x")

    def left(duration: float, dt: float) -> float:
        controller = partial(pulse, dt=dt)
        return _left(bench.run(crane, crane.state(l=LENGTH), duration, dt, controller))

    allowed = _finite(2.0 * PUSH / G)
    return [
        Oracle(name, "rad", closed, partial(left, duration), allowed, FINITE)
        for name, closed, duration in (
            (
                f"swing left by {PUSH:g} m/s² for {PULSE:g} s",
                theory.pulse_residual(PUSH, PULSE, LENGTH, G),
                PULSE + COAST,
            ),
            (
                f"the same, {COAST:g} s of coasting and braking",
                theory.coast_residual(PUSH, PULSE, COAST, LENGTH, G),
                2.0 * PULSE + COAST,
            ),
        )
    ]


def _moved(bench: Bench, crane: Crane, length: float, duration: float, dt: float) -> float:
    start = crane.state(l=length)
    goal = (0.0, float(start.q[crane.layout.index("x")]) + SMALL * DISTANCE, length)
    return _left(bench.moved(crane, start, spline(crane, start, [goal], [duration]), duration, dt))


def _spline(bench: Bench, crane: Crane, duration: float) -> Oracle:
    closed = math.degrees(theory.quintic_residual(DISTANCE, duration, LENGTH, G))
    name = f"swing left by a spline of {DISTANCE:g} m in {duration:g} s"

    def read(dt: float) -> float:
        return math.degrees(_moved(bench, crane, LENGTH, duration, dt))

    return Oracle(name, "°", closed, read, math.degrees(_finite(0.2)), FINITE)


def _quiet(bench: Bench, crane: Crane, ratio: float) -> Oracle:
    length, *beside = (
        G * (QUIET_DURATION / (2.0 * math.pi * r)) ** 2 for r in (ratio, ratio - 5e-7, ratio + 5e-7)
    )
    name = f"swing left by one in {ratio:.6f} periods, l = {length:.3f} m"
    decimals = max(theory.quintic_residual(DISTANCE, QUIET_DURATION, near, G) for near in beside)
    read = partial(_moved, bench, crane, length, QUIET_DURATION)
    return Oracle(name, "rad", 0.0, read, decimals, "six decimals")
