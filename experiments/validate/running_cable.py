"""Oracles of swings while the cable runs.

It runs at a constant speed, or so slowly that the action of the swing stays.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cranedyn import theory
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.references import spline
from experiments.validate.bench import Bench, G
from experiments.validate.oracle import FINITE_SWING, SMALL_SCALE, Oracle


class ConstantHoisting(NamedTuple):
    """A cable that runs at a constant speed.

    Attributes:
        length: Cable length at the start [m].
        rate: Rate of the cable length [m/s], positive downwards.
    """

    length: float
    rate: float


CONSTANT = (ConstantHoisting(10.0, 0.5), ConstantHoisting(40.0, -0.8))
"""A load that is lowered, and one that is hoisted."""

SWING = 0.05
"""Swing at the start [rad]."""

READ_TIME = 40.0
"""Time at which the swing is read while the cable runs at a constant speed [s]."""

SLOW_START = 20.0
"""Cable length before slow hoisting [m]."""

SLOW_END = 10.0
"""Cable length after slow hoisting [m]."""

SLOW_DURATION = 100.0
"""Duration of slow hoisting [s], a dozen periods of the swing."""

LARGE_SWING = 45.0
"""Swing before slow hoisting that is not small [°]."""


def oracles(bench: Bench) -> list[Oracle]:
    """Return the oracles of Bessel's functions, the three quarter power, and the action."""
    crane = bench.build()
    return [
        *(_constant(bench, crane, case.length, case.rate) for case in CONSTANT),
        _power(bench, crane),
        _action(bench, crane),
    ]


def _constant(bench: Bench, crane: Crane, length: float, rate: float) -> Oracle:
    """Return the oracle of a small swing at a constant rate of the cable, by Bessel's functions."""

    def read(dt: float) -> float:
        start = crane.state(l=length, l_dot=rate, phi=SMALL_SCALE * SWING)
        run = bench.run(crane, start, READ_TIME, dt)
        return float(run["phi_rad"][-1]) / SMALL_SCALE

    times = np.array([0.0, READ_TIME])
    closed = float(theory.constant_hoisting(times, length, rate, G, SWING, 0.0)[-1])
    largest = float(theory.constant_hoisting_envelope(times, length, rate, G, SWING, 0.0).max())
    # The period of a swing with amplitude A is longer by A²/16 of itself. Its phase is the integral
    # of √(g/l) over time, which is 2 √(g l)/l̇ where l̇ is constant.
    phase = abs(np.diff(2.0 * np.sqrt(G * (length + rate * times)) / rate)[0])
    late = largest * (SMALL_SCALE * largest) ** 2 / 16.0 * phase
    name = f"φ after {READ_TIME:g} s at {rate:+g} m/s from l = {length:g} m"
    return Oracle(name, "rad", closed, read, late, FINITE_SWING)


def _after_slow_hoisting(
    bench: Bench, crane: Crane, start: State, dt: float
) -> tuple[float, float]:
    """Return φ [rad] and its rate [rad/s] at the end of slow hoisting by a spline."""
    goal = (0.0, start.q[crane.layout.index("x")], SLOW_END)
    slow = spline(crane, start, [goal], [SLOW_DURATION])
    run = bench.moved(crane, start, slow, SLOW_DURATION, dt, substeps=10)
    return float(run["phi_rad"][-1]), float(run["phi_dot_rad_s"][-1])


def _adiabatic_error() -> float:
    """Return the order of the relative error of laws for slow hoisting: the square of the largest
    l̇/(ω l), the change of the cable in a radian of the swing.
    """
    s = np.linspace(0.0, 1.0, 1001)
    length = SLOW_START + (SLOW_END - SLOW_START) * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    rate = np.gradient(length, SLOW_DURATION * s)
    return float(np.abs(rate / np.sqrt(G * length)).max() ** 2)


def _power(bench: Bench, crane: Crane) -> Oracle:
    """Return the oracle of a small swing while the cable is hoisted slowly: its amplitude goes with
    the cable length to the power of -3/4.
    """

    def read(dt: float) -> float:
        small = SMALL_SCALE * SWING
        start = crane.state(l=SLOW_START, phi=small)
        phi, rate = _after_slow_hoisting(bench, crane, start, dt)
        amplitude = math.hypot(phi, rate * math.sqrt(SLOW_END / G))
        return math.log(amplitude / small) / math.log(SLOW_END / SLOW_START)

    name = "exponent of the amplitude, l slowly 20 to 10 m"
    return Oracle(name, "", -0.75, read, _adiabatic_error(), "(l̇/ωl)²")


def _action(bench: Bench, crane: Crane) -> Oracle:
    """Return the oracle of a large swing, for which that power does not hold: its action stays."""
    large = math.radians(LARGE_SWING)

    def read(dt: float) -> float:
        phi, rate = _after_slow_hoisting(bench, crane, crane.state(l=SLOW_START, phi=large), dt)
        # At the amplitude A the energy l²φ̇²/2 - g l cos φ is all potential: -g l cos A.
        return math.acos(math.cos(phi) - SLOW_END * rate**2 / (2.0 * G))

    closed = float(theory.adiabatic_amplitude(np.array([SLOW_END]), SLOW_START, large)[0])
    name = f"amplitude then, {LARGE_SWING:g}° at first, by the action"
    return Oracle(name, "rad", closed, read, closed * _adiabatic_error(), "(l̇/ωl)²")
