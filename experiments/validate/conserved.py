"""What is conserved: energy and momenta with drives locked or free, and the balance of work."""

from __future__ import annotations

import math
from functools import cache, partial

import numpy as np

from cranedyn import theory
from cranedyn.dynamics.equations_of_motion import prescribed_acceleration
from cranedyn.interfaces import Controller, Drive, Setpoint, State
from cranedyn.model.crane import Crane
from experiments.validate.bench import MASS, Bench, G
from experiments.validate.oracle import FINITE_SWING, Oracle
from experiments.validate.reading import (
    crossing,
    curve,
    offset_from_plumb,
    payload_from_pivot,
    rate_along,
)

LENGTH = 20.0
"""Cable length [m]."""

TROLLEY_MASS = 500.0
"""Mass of the trolley [kg]."""

STRUCTURE_INERTIA = 2e5 + 50.0
"""Inertia about the slew axis of the upper structure, and of the trolley about its own axis
[kg m²]."""

DURATION = 20.0
"""Duration of a run [s]."""

FREE_DURATION = 9.0
"""Duration of a run with a free drive [s]; its controller computes a motion at every step."""


def oracles(bench: Bench) -> list[Oracle]:
    """Return the oracles of energy, momenta and the ledger."""
    crane = bench.build()
    return [
        *_locked(bench, crane),
        _ripple(bench, crane),
        _slewing(bench, crane),
        *_rolling(bench, crane),
        *_ledgers(bench),
    ]


def free(crane: Crane, drive: int) -> Controller:
    """Return a controller in prescribed motion under which a drive exerts nothing.

    The others keep their speed.

    Args:
        crane: The crane.
        drive: Index of the drive: 0 slew, 1 trolley.
    """

    def accelerations(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        # The effort of a drive is linear in its acceleration: two values tell where it is zero.
        standing = np.zeros(crane.layout.m)
        unit = np.eye(crane.layout.m)[drive]
        _, efforts = prescribed_acceleration(crane, state, standing)
        _, unit_efforts = prescribed_acceleration(crane, state, unit)
        needed = efforts[drive]
        return -needed / (unit_efforts[drive] - needed) * unit

    return accelerations


def _locked(bench: Bench, crane: Crane) -> list[Oracle]:
    """Return the oracles of energy and angular momentum of a swing on an oval, drives locked."""
    start = crane.state(l=LENGTH, phi=0.6, theta=-0.2, theta_dot=0.3, phi_dot=0.1)
    swing = cache(lambda dt: bench.run(crane, start, DURATION, dt))

    def energy(dt: float) -> float:
        gained = swing(dt).energy - swing(dt).energy[0]
        # Over the potential energy at the start.
        return float(gained[-1]) / (MASS * G * LENGTH * (1.0 - math.cos(0.6) * math.cos(0.2)))

    def momentum(dt: float) -> float:
        run = swing(dt)
        arm = offset_from_plumb(run.q)
        rate = rate_along(payload_from_pivot, run)
        momenta = arm[:, 0] * rate[:, 1] - arm[:, 1] * rate[:, 0]
        return float(momenta[-1] / momenta[0])

    return [
        Oracle("energy gained by an oval swing in 20 s, of itself", "", 0.0, energy),
        Oracle("angular momentum about the vertical, of the first", "", 1.0, momentum),
    ]


def _ripple(bench: Bench, crane: Crane) -> Oracle:
    """Return the oracle of the ripple of the energy, which the step itself makes.

    Semi-implicit Euler keeps E - dt/2 m g l φ φ̇ of a small swing. From rest at an amplitude A,
    φ φ̇ = -A² ω sin(2ωt)/2 is largest three eighths of a period later, where it is A² ω/2; there E
    has gained ω dt/2 of itself.
    """
    small = 3e-3
    omega = math.sqrt(G / LENGTH)
    t_full = 0.75 * math.pi / omega
    full_energy = MASS * G * LENGTH * small**2 / 2.0

    def read(dt: float) -> float:
        run = bench.run(crane, crane.state(l=LENGTH, phi=small), 5.0, dt)
        gained = curve(run.t, run.energy - run.energy[0], int(np.searchsorted(run.t, t_full)))
        return float(gained(t_full)) / full_energy / (omega * dt / 2.0)

    name = "ripple of the energy over that of the step, ω dt/2"
    return Oracle(name, "", 1.0, read, small**2, FINITE_SWING)


def _slewing(bench: Bench, crane: Crane) -> Oracle:
    """Return the oracle of the angular momentum about the slew axis, with a free slew."""
    start = crane.state(x=20.0, phi=0.4, theta=0.5, gamma_dot=0.05)

    def read(dt: float) -> float:
        run = bench.run(crane, start, FREE_DURATION, dt, free(crane, 0), substeps=1)
        load = payload_from_pivot(run.q)
        rate = rate_along(payload_from_pivot, run)
        inertia = STRUCTURE_INERTIA + TROLLEY_MASS * run["x_m"] ** 2
        structure = inertia * run["gamma_dot_rad_s"]
        # Of structure, trolley and load about the slew axis [kg m²/s].
        momenta = structure + MASS * (load[:, 0] * rate[:, 1] - load[:, 1] * rate[:, 0])
        return float(momenta[-1] / momenta[0])

    return Oracle("total angular momentum, free slew, of the first", "", 1.0, read)


def _rolling(bench: Bench, crane: Crane) -> list[Oracle]:
    """Return the oracles of a free trolley under a thrown load and under a small swing."""
    start = crane.state(l=LENGTH, phi=0.5, x_dot=0.2)

    def along_the_jib(dt: float) -> float:
        """Return the momentum of trolley and load; at zero slew the jib points along -Y."""
        run = bench.run(crane, start, FREE_DURATION, dt, free(crane, 1), substeps=1)
        load_rate = rate_along(payload_from_pivot, run)[-1, 1]
        return float(TROLLEY_MASS * run["x_dot_m_s"][-1] - MASS * load_rate)

    def period(dt: float) -> float:
        small = crane.state(l=LENGTH, phi=1e-6)
        run = bench.run(crane, small, FREE_DURATION, dt, free(crane, 1), substeps=1)
        return 2.0 * (crossing(run.t, run["phi_rad"], 3) - crossing(run.t, run["phi_rad"], 2))

    first = 0.2 * (TROLLEY_MASS + MASS)
    closed = theory.rolling_period(LENGTH, G, MASS, TROLLEY_MASS)
    return [
        Oracle("momentum along the jib, free trolley", "N s", first, along_the_jib),
        Oracle("period under a free trolley of half the mass", "s", closed, period),
    ]


def _ledgers(bench: Bench) -> list[Oracle]:
    """Return the oracles of the energy ledger, in which all joints are damped and all drives move.

    It is the energy gained, less the work of the drives, plus what dampers took.
    """
    crane = bench.build(damp_slew=3e4, damp_trolley=200.0, damp_swing=5e3, damp_hoist=700.0)
    start = crane.state(x=15.0, l=LENGTH, phi=0.2, theta=-0.1, gamma_dot=0.03)
    weight = MASS * G * crane.layout.along("l")

    def waves(t: float, *amplitudes: float) -> np.ndarray:
        waves_of_one = [math.sin(0.5 * t), math.cos(0.4 * t), math.sin(0.3 * t)]
        return np.array(amplitudes) * waves_of_one

    def efforts(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        return waves(t, 2e4, 300.0, 50.0) - weight

    def motions(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        return waves(t, 0.02, 0.2, 0.1)

    controllers: dict[Drive, Controller] = {"effort": efforts, "motion": motions}

    def unexplained(drive: Drive, dt: float) -> float:
        run = bench.run(crane, start, DURATION, dt, controllers[drive], drive=drive)
        return float(run.unexplained[-1] / np.abs(run.work[-1]).sum())

    oracles = []
    for drive in controllers:
        name = f"energy unexplained, drives by {drive}, of their work"
        oracles.append(Oracle(name, "", 0.0, partial(unexplained, drive)))
    return oracles
