"""Swings with the drives locked: in a plane at any amplitude, and on ovals that turn."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from cranedyn import theory
from cranedyn.data.trajectory import Trajectory
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from experiments.oracles.check import MASS, G, Oracle
from experiments.oracles.reading import Bench, crossing, curve, payload_from_pivot, zero_between

LENGTH, SHORT = 20.0, 5.0
"""Cable lengths [m]: of a point load, and of a load with inertia, which shows on a short cable."""

OVALS = ((2.0, 1.0), (8.0, 4.0))
"""Half axes of the ovals [m]."""


def oracles(bench: Bench) -> list[Oracle]:
    """Return the oracles of periods, tensions and precessions."""
    point, rigid = (
        bench.build(),
        bench.build(payload_inertia=400.0, dummy_mass=50.0, dummy_inertia=50.0),
    )
    return [
        *(_period(bench, point, "phi", LENGTH, 0.0, degrees) for degrees in (30.0, 60.0, 90.0)),
        _period(bench, rigid, "phi", SHORT, 500.0, 60.0),
        _period(bench, rigid, "theta", SHORT, 450.0, 60.0),
        *_tensions(bench, point),
        *_precessions(bench, point),
    ]


def _period(
    bench: Bench, crane: Crane, joint: str, length: float, inertia: float, degrees: float
) -> Oracle:
    """Return the oracle of the period: twice the time between passages of the vertical, where the
    run starts with the speed that carries the load to its amplitude.
    """
    amplitude = math.radians(degrees)
    rate = (
        2.0
        * math.sin(amplitude / 2.0)
        * 2.0
        * math.pi
        / theory.rigid_period(length, G, MASS, inertia)
    )

    def read(dt: float) -> float:
        run = bench.run(crane, crane.state(l=length, **{f"{joint}_dot": rate}), 12.0, dt)
        return crossing(run.t, run[f"{joint}_rad"], 2)

    name = f"period of {degrees:g}°, l = {length:g} m" + (
        f", {'φ' if joint == 'phi' else 'θ'} with {inertia:g} kg m²" if inertia else ""
    )
    closed = theory.rigid_period(length, G, MASS, inertia) * float(
        theory.amplitude_factor(amplitude)
    )
    return Oracle(name, "s", closed, read)


def _tensions(bench: Bench, crane: Crane) -> list[Oracle]:
    """Return the oracles of the tension: at the lowest point by conservation of energy, and at
    every row by Newton's law along the rope.
    """
    swing = cache(
        lambda dt: bench.run(crane, crane.state(l=LENGTH, phi=math.radians(60.0)), 10.0, dt)
    )

    def lowest(dt: float) -> float:
        t, tension = swing(dt).t, -swing(dt)["F_l_N"]
        bottom = crossing(t, swing(dt)["phi_rad"], 1)
        return float(curve(t, tension, int(np.searchsorted(t, bottom)))(bottom))

    def everywhere(dt: float) -> float:
        run = swing(dt)
        newton = MASS * (G * np.cos(run["phi_rad"]) + LENGTH * run["phi_dot_rad_s"] ** 2)
        return float(np.abs(-run["F_l_N"] / newton - 1.0).max())

    return [
        Oracle(
            "tension at the lowest point after 60°",
            "N",
            MASS * G * (3.0 - 2.0 * math.cos(math.radians(60.0))),
            lowest,
        ),
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
    t, offset = (
        trajectory.t,
        payload_from_pivot(trajectory.q)[:, :2]
        - payload_from_pivot(trajectory.q * [1, 1, 0, 0, 0])[:, :2],
    )
    square, angle = (offset**2).sum(axis=1), np.unwrap(np.arctan2(offset[:, 1], offset[:, 0]))
    late = t > 0.7 * theory.point_period(LENGTH, G)
    row = int(np.argmax(np.where(late, square, 0.0)))
    t_apse = zero_between(curve(t, square, row).derivative(), t[row - 1], t[row + 1])
    return t_apse, float(curve(t, angle, row)(t_apse)) - float(angle[0]) - 2.0 * math.pi


def _precessions(bench: Bench, crane: Crane) -> list[Oracle]:
    oracles = []
    for far, near in OVALS:
        turned = cache(
            lambda dt, far=far, near=near: apse(bench.run(crane, oval(crane, far, near), 10.0, dt))[
                1
            ]
        )
        name = f"precession of an oval of {far:g} m by {near:g} m"
        oracles.append(
            Oracle(
                f"{name}, a revolution", "rad", theory.apsidal_precession(LENGTH, far, near), turned
            )
        )
        if (far, near) == OVALS[0]:
            airy, square = theory.airy_precession(LENGTH, far, near), (far**2 + near**2) / LENGTH**2
            oracles.append(
                Oracle(f"{name}, by Airy", "rad", airy, turned, airy * square, "(a² + b²)/l²")
            )
    return oracles
