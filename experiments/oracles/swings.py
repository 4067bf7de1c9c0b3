"""Swings with the drives locked, in a plane at any amplitude and on ovals that turn; and while the
cable runs, at constant speed and slowly.
"""

from __future__ import annotations

import math
from functools import cache, partial

import numpy as np

from cranedyn import theory
from cranedyn.data.trajectory import Trajectory
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.references import spline
from experiments.oracles.bench import (
    FINITE,
    MASS,
    SMALL,
    Bench,
    G,
    Oracle,
    crossing,
    curve,
    offset_from_plumb,
    zero_between,
)

LENGTH, SHORT = 20.0, 5.0
"""Cable lengths [m]: of a point load, and of a load with inertia, which shows on a short cable."""

BEAM, SPACING = 500.0, 2.0
"""Inertia of a thin beam across its axis [kg m²], and distance of the two falls it hangs on [m]."""

OVALS = ((2.0, 1.0), (8.0, 4.0))
"""Half axes of the ovals [m]."""


def locked_drives(bench: Bench) -> list[Oracle]:
    """Return the oracles of periods, tensions and precessions."""
    point = bench.build()
    rigid = bench.build(payload_inertia=400.0, dummy_mass=50.0, dummy_inertia=50.0)
    beam = bench.build(fall_spacing=SPACING, payload_ixx=BEAM, payload_izz=BEAM)
    period = partial(_period, bench)
    small = partial(theory.rigid_period, gravity=G, mass=MASS)
    sway, yaw = theory.bifilar(MASS, BEAM, SPACING / 2.0, LENGTH, G)
    return [
        *(period(point, "phi", LENGTH, small(LENGTH, inertia=0.0), a) for a in (30.0, 60.0, 90.0)),
        period(rigid, "phi", SHORT, small(SHORT, inertia=500.0), 60.0, ", φ with 500 kg m²"),
        period(rigid, "theta", SHORT, small(SHORT, inertia=450.0), 60.0, ", θ with 450 kg m²"),
        period(beam, "theta", LENGTH, 2.0 * math.pi / sway, 1.0, ", sway on two falls"),
        period(beam, "load_yaw", LENGTH, 2.0 * math.pi / yaw, 1.0, ", yaw on two falls"),
        *_tensions(bench, point),
        *_precessions(bench, point),
    ]


def _period(
    bench: Bench,
    crane: Crane,
    joint: str,
    length: float,
    small: float,
    degrees: float,
    of: str = "",
) -> Oracle:
    """Return the oracle of the period, from that of small swings: twice the time between passages
    of the vertical, where the run starts with the speed that carries the load to its amplitude.
    """
    amplitude = math.radians(degrees)
    rate = 2.0 * math.sin(amplitude / 2.0) * 2.0 * math.pi / small

    def read(dt: float) -> float:
        run = bench.run(crane, crane.state(l=length, **{f"{joint}_dot": rate}), 12.0, dt)
        return crossing(run.t, run[f"{joint}_rad"], 2)

    name = f"period of {degrees:g}°, l = {length:g} m{of}"
    return Oracle(name, "s", small * float(theory.amplitude_factor(amplitude)), read)


def _tensions(bench: Bench, crane: Crane) -> list[Oracle]:
    """Return the oracles of the tension: at the lowest point by conservation of energy, and at
    every row by Newton's law along the rope.
    """
    amplitude = math.radians(60.0)
    swing = cache(lambda dt: bench.run(crane, crane.state(l=LENGTH, phi=amplitude), 10.0, dt))

    def lowest(dt: float) -> float:
        t = swing(dt).t
        tension = -swing(dt)["F_l_N"]
        bottom = crossing(t, swing(dt)["phi_rad"], 1)
        return float(curve(t, tension, int(np.searchsorted(t, bottom)))(bottom))

    def everywhere(dt: float) -> float:
        run = swing(dt)
        newton = MASS * (G * np.cos(run["phi_rad"]) + LENGTH * run["phi_dot_rad_s"] ** 2)
        return float(np.abs(-run["F_l_N"] / newton - 1.0).max())

    bottom = MASS * G * (3.0 - 2.0 * math.cos(amplitude))
    return [
        Oracle("tension at the lowest point after 60°", "N", bottom, lowest),
        Oracle("tension over m (g cos φ + l φ̇²), less 1, at most", "", 0.0, everywhere),
    ]


def oval(crane: Crane, half_axis: float, other_half_axis: float) -> State:
    """Return a load let go at a distance from the vertical [m], with a speed to the left seen from
    above that makes the other half axis [m].
    """
    return crane.state(
        l=LENGTH,
        phi=math.asin(half_axis / LENGTH),
        theta_dot=other_half_axis / LENGTH * math.sqrt(G / LENGTH),
    )


def apse(trajectory: Trajectory) -> tuple[float, float]:
    """Return the time at which an oval first comes back to its far end [s], and its turn since the
    start [rad].
    """
    t = trajectory.t
    offset = offset_from_plumb(trajectory.q)[:, :2]
    square = (offset**2).sum(axis=1)
    angle = np.unwrap(np.arctan2(offset[:, 1], offset[:, 0]))
    late = t > 0.7 * theory.point_period(LENGTH, G)
    row = int(np.argmax(np.where(late, square, 0.0)))
    t_apse = zero_between(curve(t, square, row).derivative(), t[row - 1], t[row + 1])
    return t_apse, float(curve(t, angle, row)(t_apse)) - float(angle[0]) - 2.0 * math.pi


def _precessions(bench: Bench, crane: Crane) -> list[Oracle]:
    def turned(far: float, near: float, dt: float) -> float:
        return apse(bench.run(crane, oval(crane, far, near), 10.0, dt))[1]

    oracles = []
    for far, near in OVALS:
        read = cache(partial(turned, far, near))
        name = f"precession of an oval of {far:g} m by {near:g} m"
        closed = theory.apsidal_precession(LENGTH, far, near)
        oracles.append(Oracle(f"{name}, a revolution", "rad", closed, read))
        if (far, near) == OVALS[0]:
            airy = theory.airy_precession(LENGTH, far, near)
            square = (far**2 + near**2) / LENGTH**2
            why = "(a² + b²)/l²"
            oracles.append(Oracle(f"{name}, by Airy", "rad", airy, read, airy * square, why))
    return oracles


CONSTANT = ((10.0, 0.5), (40.0, -0.8))
"""Cable length at the start [m] and its rate [m/s], positive downward."""

SWING, AFTER = 0.05, 40.0
"""Swing at the start [rad] and time at which it is looked at [s]."""

FROM, TO, SLOWLY, LARGE = 20.0, 10.0, 100.0, 45.0
"""Cable length before and after slow hoisting [m], the time it takes [s], and a swing that is not
small [°]."""


def running_cable(bench: Bench) -> list[Oracle]:
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
    name = f"φ after {AFTER:g} s at {rate:+g} m/s from l = {length:g} m"
    return Oracle(name, "rad", closed, read, late, FINITE)


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

    name = "exponent of the amplitude, l slowly 20 to 10 m"
    return Oracle(name, "", -0.75, read, _fast(), "(l̇/ωl)²")


def _action(bench: Bench, crane: Crane) -> Oracle:
    """Return the oracle of a swing for which the three quarter power does not hold."""
    large = math.radians(LARGE)

    def read(dt: float) -> float:
        phi, rate = _hoisted(bench, crane, crane.state(l=FROM, phi=large), dt)
        return math.acos(math.cos(phi) - TO * rate**2 / (2.0 * G))

    closed = float(theory.adiabatic_amplitude(np.array([TO]), FROM, large)[0])
    name = f"amplitude then, {LARGE:g}° at first, by the action"
    return Oracle(name, "rad", closed, read, closed * _fast(), "(l̇/ωl)²")
