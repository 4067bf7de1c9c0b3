"""What moves of the trolley leave of swing: rectangular pulses of acceleration, and quintic splines
from rest to rest.
"""

from __future__ import annotations

import math

import numpy as np

from cranedyn import theory
from cranedyn.data.trajectory import Trajectory
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.references import spline
from experiments.oracles.check import G, Oracle
from experiments.oracles.reading import Bench

LENGTH, SMALL = 20.0, 1e-4
"""Cable length [m]; by how much moves are scaled down in their runs, since the closed forms are for
small angles."""

PUSH, PULSE, COAST = 0.3, 4.0, 6.0
"""Acceleration of the trolley [m/s²], how long it lasts, and how long the trolley runs on before it
brakes [s]."""

DISTANCE, DURATIONS = 10.0, (10.0, 15.0)
"""Way of a spline [m] and times for it [s]."""

QUIET, QUIET_DURATION = (1.834566, 2.895032, 4.938452), 20.0
"""Durations in periods of the swing at which a spline leaves none (to six decimals), and the time
for which cables are chosen so [s]."""


def oracles(bench: Bench) -> list[Oracle]:
    """Return the oracles of residual swings."""
    crane = bench.build()
    splines = [_spline(bench, crane, LENGTH, duration) for duration in DURATIONS]
    return [
        _pulse(bench, crane),
        _coast(bench, crane),
        *splines,
        *(_quiet(bench, crane, ratio) for ratio in QUIET),
    ]


def _left(run: Trajectory) -> float:
    """Return the amplitude of the residual radial swing [rad], scaled up again."""
    phi, rate, length = (float(run[column][-1]) for column in ("phi_rad", "phi_dot_rad_s", "l_m"))
    return math.hypot(phi, rate * math.sqrt(length / G)) / SMALL


def _finite(swing: float) -> float:
    """Return the change by a finite swing on the way [rad]: its square, scaled down, of itself."""
    return swing * (SMALL * swing) ** 2


def _pulsed(bench: Bench, crane: Crane, duration: float, dt: float) -> float:
    def trolley_pulse(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        braking = t > PULSE + COAST - dt / 2.0
        return SMALL * PUSH * ((t < PULSE - dt / 2.0) - braking) * crane.layout.along("x")

    return _left(bench.run(crane, crane.state(l=LENGTH), duration, dt, trolley_pulse))


def _pulse(bench: Bench, crane: Crane) -> Oracle:
    closed = theory.pulse_residual(PUSH, PULSE, LENGTH, G)
    name = f"swing left by {PUSH:g} m/s² for {PULSE:g} s"
    return Oracle(
        name,
        "rad",
        closed,
        lambda dt: _pulsed(bench, crane, PULSE + COAST, dt),
        _finite(2.0 * PUSH / G),
        "finite swing",
    )


def _coast(bench: Bench, crane: Crane) -> Oracle:
    closed = theory.coast_residual(PUSH, PULSE, COAST, LENGTH, G)
    name = f"the same, {COAST:g} s of coasting and braking"
    return Oracle(
        name,
        "rad",
        closed,
        lambda dt: _pulsed(bench, crane, 2.0 * PULSE + COAST, dt),
        _finite(2.0 * PUSH / G),
        "finite swing",
    )


def _moved(bench: Bench, crane: Crane, length: float, duration: float, dt: float) -> float:
    start = crane.state(l=length)
    goal = (0.0, float(start.q[crane.layout.index("x")]) + SMALL * DISTANCE, length)
    return _left(bench.moved(crane, start, spline(crane, start, [goal], [duration]), duration, dt))


def _spline(bench: Bench, crane: Crane, length: float, duration: float) -> Oracle:
    closed = math.degrees(theory.quintic_residual(DISTANCE, duration, length, G))
    name = f"swing left by a spline of {DISTANCE:g} m in {duration:g} s"

    def read(dt: float) -> float:
        return math.degrees(_moved(bench, crane, length, duration, dt))

    return Oracle(name, "°", closed, read, math.degrees(_finite(0.2)), "finite swing")


def _quiet(bench: Bench, crane: Crane, ratio: float) -> Oracle:
    length, *beside = (
        G * (QUIET_DURATION / (2.0 * math.pi * r)) ** 2 for r in (ratio, ratio - 5e-7, ratio + 5e-7)
    )
    name = f"swing left by one in {ratio:.6f} periods, l = {length:.3f} m"
    decimals = max(theory.quintic_residual(DISTANCE, QUIET_DURATION, near, G) for near in beside)
    return Oracle(
        name,
        "rad",
        0.0,
        lambda dt: _moved(bench, crane, length, QUIET_DURATION, dt),
        decimals,
        "six decimals",
    )
