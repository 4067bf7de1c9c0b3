"""A jib that turns steadily: where the load hangs, how it pulls, and its swing as seen from the
jib.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from cranedyn import theory
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from experiments.oracles.check import MASS, Build, G, Oracle
from experiments.oracles.reading import SELDOM, Bench

STEADY = ((50.0, 45.0, 0.8), (25.0, 19.0, 0.5))
"""Trolley radius, cable length [m] and slew rate [1/min] of a 71 EC-B 5 and an L1-24 at the tip of
their jibs."""

SETTLING, MINUTE = 140.0, 60.0
"""How long the load has to settle, and how long it must stay there [s]."""

RATE, LENGTH, SAMPLE = 0.1, 20.0, 0.5
"""Slew rate [rad/s], cable length [m] and time between samples [s] of the swing seen from the
jib."""


def oracles(bench: Bench) -> list[Oracle]:
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
    rate, (crane, plumb) = rpm * math.pi / 30.0, turning(bench.build, radius, length, rpm)
    settled = cache(lambda dt: bench.run(crane, plumb, SETTLING, dt, substeps=SELDOM))
    location = f"x = {radius:g} m, l = {length:g} m, {rpm:g} rpm"
    angle = -math.degrees(theory.slewing_swing(radius, length, rate, G))
    pull = theory.slewing_tension(radius, length, rate, G, MASS)
    return [
        Oracle(
            f"load settles outward, {location}",
            "°",
            angle,
            lambda dt: -math.degrees(settled(dt)["phi_rad"][-1]),
        ),
        Oracle(f"tension then, {location}", "N", pull, lambda dt: -float(settled(dt)["F_l_N"][-1])),
    ]


def _stay(bench: Bench, crane: Crane, radius: float, length: float, rpm: float) -> Oracle:
    rate = rpm * math.pi / 30.0
    start = crane.state(
        x=radius, l=length, gamma_dot=rate, phi=theory.slewing_swing(radius, length, rate, G)
    )

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

    omega, observed = math.sqrt(G / LENGTH), f"seen from a jib at {RATE:g} rad/s"
    return [
        Oracle(f"{observed}: slow swing, ω - Ω", "rad/s", omega - RATE, lambda dt: rates(dt)[0]),
        Oracle(f"{observed}: fast swing, ω + Ω", "rad/s", omega + RATE, lambda dt: rates(dt)[1]),
    ]
