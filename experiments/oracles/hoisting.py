"""Swings while the cable runs: at constant speed, and slowly."""

from __future__ import annotations

import math

import numpy as np

from cranedyn import theory
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.references import spline
from experiments.oracles.check import G, Oracle
from experiments.oracles.reading import Bench

SMALL = 1e-4
"""By how much a swing of the small-angle theory is scaled down in its run; what is left of the
finite angle is the square of that."""

CONSTANT = ((10.0, 0.5), (40.0, -0.8))
"""Cable length at the start [m] and its rate [m/s], positive downward."""

SWING, AFTER = 0.05, 40.0
"""Swing at the start [rad] and time at which it is looked at [s]."""

FROM, TO, SLOWLY, LARGE = 20.0, 10.0, 100.0, 45.0
"""Cable length before and after slow hoisting [m], the time it takes [s], and a swing that is not
small [°]."""


def oracles(bench: Bench) -> list[Oracle]:
    """Return the oracles of Bessel's functions, the three quarter power, and the action."""
    crane = bench.build()
    return [
        *(_constant(bench, crane, *case) for case in CONSTANT),
        _power(bench, crane),
        _action(bench, crane),
    ]


def _constant(bench: Bench, crane: Crane, length: float, rate: float) -> Oracle:
    def read(dt: float) -> float:
        run = bench.run(crane, crane.state(l=length, l_dot=rate, phi=SMALL * SWING), AFTER, dt)
        return float(run["phi_rad"][-1]) / SMALL

    times = np.array([0.0, AFTER])
    closed = float(theory.constant_hoisting(times, length, rate, G, SWING, 0.0)[-1])
    largest = float(theory.constant_hoisting_envelope(times, length, rate, G, SWING, 0.0).max())
    phase = abs(np.diff(2.0 * np.sqrt(G * (length + rate * times)) / rate)[0])
    late = largest * (SMALL * largest) ** 2 / 16.0 * phase
    return Oracle(
        f"φ after {AFTER:g} s at {rate:+g} m/s from l = {length:g} m",
        "rad",
        closed,
        read,
        late,
        "finite swing",
    )


def _hoisted(bench: Bench, crane: Crane, start: State, dt: float) -> tuple[float, float]:
    """Return φ and its rate at the end of slow hoisting."""
    slow = spline(crane, start, [(0.0, start.q[crane.layout.index("x")], TO)], [SLOWLY])
    run = bench.moved(crane, start, slow, SLOWLY, dt, substeps=10)
    return float(run["phi_rad"][-1]), float(run["phi_dot_rad_s"][-1])


def _fast() -> float:
    """Return the square of the largest l̇/(ω l), which slow hoisting neglects."""
    s = np.linspace(0.0, 1.0, 1001)
    length = FROM + (TO - FROM) * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    return float(np.abs(np.gradient(length, SLOWLY * s) / np.sqrt(G * length)).max() ** 2)


def _power(bench: Bench, crane: Crane) -> Oracle:
    def read(dt: float) -> float:
        small = SMALL * SWING
        phi, rate = _hoisted(bench, crane, crane.state(l=FROM, phi=small), dt)
        return math.log(math.hypot(phi, rate * math.sqrt(TO / G)) / small) / math.log(TO / FROM)

    return Oracle(
        "exponent of the amplitude, l slowly 20 to 10 m", "", -0.75, read, _fast(), "(l̇/ωl)²"
    )


def _action(bench: Bench, crane: Crane) -> Oracle:
    """Return the oracle of a swing for which the three quarter power does not hold."""
    large = math.radians(LARGE)

    def read(dt: float) -> float:
        phi, rate = _hoisted(bench, crane, crane.state(l=FROM, phi=large), dt)
        return math.acos(math.cos(phi) - TO * rate**2 / (2.0 * G))

    closed = float(theory.adiabatic_amplitude(np.array([TO]), FROM, large)[0])
    return Oracle(
        f"amplitude then, {LARGE:g}° at first, by the action",
        "rad",
        closed,
        read,
        closed * _fast(),
        "(l̇/ωl)²",
    )
