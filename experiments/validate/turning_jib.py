"""Oracles of a jib that turns steadily.

Where the load hangs, how it pulls, and its swing as seen from the jib.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from cranedyn import theory
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from experiments.validate.bench import MASS, SPARSE_SUBSTEPS, Bench, Build, G
from experiments.validate.oracle import Oracle


class SteadySlewing(NamedTuple):
    """A load under a jib that turns steadily.

    Attributes:
        radius: Position of the trolley [m].
        length: Cable length [m].
        rpm: Slew rate [1/min], as makers state it.
    """

    radius: float
    length: float
    rpm: float

    @property
    def rate(self) -> float:
        """Slew rate [rad/s]."""
        return self.rpm * math.pi / 30.0


STEADY = (SteadySlewing(50.0, 45.0, 0.8), SteadySlewing(25.0, 19.0, 0.5))
"""A 71 EC-B 5 and an L1-24, with the trolley at the tip of the jib."""

SETTLING_TIME = 140.0
"""Time for which the load settles [s]."""

STAYING_TIME = 60.0
"""Time for which a load that hangs at rest under a turning jib must stay there [s]."""

LENGTH = 20.0
"""Cable length in all but steady slewing [m]."""

SLEW_RATE = 0.1
"""Slew rate at which the swing is seen from the jib [rad/s]."""

SAMPLE_TIME = 0.5
"""Time between the samples of this swing [s]."""


def oracles(bench: Bench) -> list[Oracle]:
    """Return the oracles of angles and tensions of steady slewing, and of the two frequencies."""
    crane = bench.build()
    oracles = []
    for case in STEADY:
        oracles += _steady(bench, case)
    return [*oracles, _stay(bench, crane, STEADY[0]), *_modes(bench, crane)]


def turning(build: Build, case: SteadySlewing) -> tuple[Crane, State]:
    """Return a crane whose load hangs plumb under a jib that turns, and settles.

    Its swing joints are damped. Dampers act on the swing relative to the jib, so that they exert
    nothing once the load rests there, wherever that is.

    Args:
        build: Makes the crane.
        case: Where the trolley stands, the cable length and the slew rate.
    """
    # 2 ζ m l² ω with a damping ratio ζ of 0.6.
    damping = 1.2 * MASS * case.length**2 * math.sqrt(G / case.length)
    crane = build(damp_swing=damping)
    return crane, crane.state(x=case.radius, l=case.length, gamma_dot=case.rate)


def _steady(bench: Bench, case: SteadySlewing) -> list[Oracle]:
    """Return the oracles of the angle at which the load settles, and of the tension there."""
    radius, length, rpm = case
    crane, plumb = turning(bench.build, case)
    settled = cache(lambda dt: bench.run(crane, plumb, SETTLING_TIME, dt, substeps=SPARSE_SUBSTEPS))
    location = f"x = {radius:g} m, l = {length:g} m, {rpm:g} rpm"
    # φ is positive where the load lags inwards of the trolley; centrifugal force pulls it outwards.
    angle = -math.degrees(theory.slewing_swing(radius, length, case.rate, G))
    tension = theory.slewing_tension(radius, length, case.rate, G, MASS)

    def read_angle(dt: float) -> float:
        return -math.degrees(settled(dt)["phi_rad"][-1])

    def read_tension(dt: float) -> float:
        return -float(settled(dt)["F_l_N"][-1])

    return [
        Oracle(f"load settles outward, {location}", "°", angle, read_angle),
        Oracle(f"tension then, {location}", "N", tension, read_tension),
    ]


def _stay(bench: Bench, crane: Crane, case: SteadySlewing) -> Oracle:
    """Return the oracle of a load that starts where it rests relative to the jib, undamped."""
    phi = theory.slewing_swing(case.radius, case.length, case.rate, G)
    start = crane.state(x=case.radius, l=case.length, gamma_dot=case.rate, phi=phi)

    def strays(dt: float) -> float:
        run = bench.run(crane, start, STAYING_TIME, dt, substeps=SPARSE_SUBSTEPS)
        swing = run.coordinates("phi", "theta")
        return float(np.abs(swing - swing[0]).max())

    return Oracle("strays from there in a minute without damping", "rad", 0.0, strays)


def _modes(bench: Bench, crane: Crane) -> list[Oracle]:
    """Return the oracles of the two frequencies of a small swing as seen from a turning jib.

    The trolley stands at the slew axis, where no centrifugal force bends the cable. In the frame
    at rest a small swing is the sum of two circular ones at ω and -ω. Seen from a jib that turns at
    Ω, z = φ + iθ has them at ω - Ω and -(ω + Ω).
    """
    start = crane.state(x=0.0, l=LENGTH, gamma_dot=SLEW_RATE, phi=1e-6, theta_dot=2e-7)

    @cache
    def rates(dt: float) -> tuple[float, float]:
        """Return the magnitudes of both rates [rad/s], the slow one first, by Prony's method.

        Samples of a sum of two exponentials obey z_k = a z_(k-1) + b z_(k-2). The roots of
        r² - a r - b are exp(i rate T), with the time T between samples.
        """
        run = bench.run(crane, start, STAYING_TIME, dt)
        stride = round(SAMPLE_TIME / (run.t[1] - run.t[0]))
        z = (run["phi_rad"] + 1j * run["theta_rad"])[::stride]
        before = np.stack([z[1:-1], z[:-2]], axis=1)
        a, b = np.linalg.lstsq(before, z[2:], rcond=None)[0]
        roots = np.roots([1.0, -a, -b])
        backward, forward = np.sort(np.log(roots).imag / SAMPLE_TIME).tolist()
        return forward, -backward

    omega = math.sqrt(G / LENGTH)
    slow = omega - SLEW_RATE
    fast = omega + SLEW_RATE
    observed = f"seen from a jib at {SLEW_RATE:g} rad/s"
    return [
        Oracle(f"{observed}: slow swing, ω - Ω", "rad/s", slow, lambda dt: rates(dt)[0]),
        Oracle(f"{observed}: fast swing, ω + Ω", "rad/s", fast, lambda dt: rates(dt)[1]),
    ]
