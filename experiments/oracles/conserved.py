"""What stays: energy, momenta, and the balance of work, with drives locked, free or moving."""

from __future__ import annotations

import math
from functools import cache, partial

import numpy as np

from cranedyn import theory
from cranedyn.dynamics.pinocchio import prescribed_acceleration
from cranedyn.interfaces import Controller, Drive, Setpoint, State
from cranedyn.model.crane import Crane
from experiments.oracles.bench import (
    FINITE,
    MASS,
    Bench,
    G,
    Oracle,
    crossing,
    curve,
    offset_from_plumb,
    payload_from_pivot,
    rate_along,
)

LENGTH, TROLLEY, STRUCTURE = 20.0, 500.0, 2e5 + 50.0
"""Cable length [m]; mass of the trolley [kg]; inertia about the slew axis of the upper structure
and of the trolley itself [kg m²]."""

DURATION, FREE = 20.0, 9.0
"""Length of a run, and of one with a free drive, which is asked at every step [s]."""


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
    """Return a controller in prescribed motion under which one drive (0 slew, 1 trolley) exerts
    nothing and the others keep their speed.
    """

    def accelerations(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        none = np.zeros(crane.layout.m)
        unit = np.eye(crane.layout.m)[drive]
        needed, with_unit = (
            prescribed_acceleration(crane, state, a)[1][drive] for a in (none, unit)
        )
        return -needed / (with_unit - needed) * unit

    return accelerations


def _locked(bench: Bench, crane: Crane) -> list[Oracle]:
    start = crane.state(l=LENGTH, phi=0.6, theta=-0.2, theta_dot=0.3, phi_dot=0.1)
    swing = cache(lambda dt: bench.run(crane, start, DURATION, dt))

    def energy(dt: float) -> float:
        above = swing(dt).energy - swing(dt).energy[0]
        return float(above[-1]) / (MASS * G * LENGTH * (1.0 - math.cos(0.6) * math.cos(0.2)))

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
    """Return the ripple of the energy: semi-implicit Euler keeps E - dt/2 m g l φ φ̇ of a small
    swing, so E has gained ω dt/2 of itself three eighths of a period later.
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
    return Oracle(name, "", 1.0, read, small**2, FINITE)


def _slewing(bench: Bench, crane: Crane) -> Oracle:
    start = crane.state(x=20.0, phi=0.4, theta=0.5, gamma_dot=0.05)

    def read(dt: float) -> float:
        run = bench.run(crane, start, FREE, dt, free(crane, 0), substeps=1)
        load = payload_from_pivot(run.q)
        rate = rate_along(payload_from_pivot, run)
        structure = (STRUCTURE + TROLLEY * run["x_m"] ** 2) * run["gamma_dot_rad_s"]
        # Of structure, trolley and load about the slew axis [kg m²/s].
        momenta = structure + MASS * (load[:, 0] * rate[:, 1] - load[:, 1] * rate[:, 0])
        return float(momenta[-1] / momenta[0])

    return Oracle("total angular momentum, free slew, of the first", "", 1.0, read)


def _rolling(bench: Bench, crane: Crane) -> list[Oracle]:
    """Return the oracles of a free trolley under a thrown load and under a small swing."""
    start = crane.state(l=LENGTH, phi=0.5, x_dot=0.2)

    def along_the_jib(dt: float) -> float:
        """Return the momentum of trolley and load; at zero slew the jib points along -Y."""
        run = bench.run(crane, start, FREE, dt, free(crane, 1), substeps=1)
        return float(
            TROLLEY * run["x_dot_m_s"][-1] - MASS * rate_along(payload_from_pivot, run)[-1, 1]
        )

    def period(dt: float) -> float:
        small = crane.state(l=LENGTH, phi=1e-6)
        run = bench.run(crane, small, FREE, dt, free(crane, 1), substeps=1)
        return 2.0 * (crossing(run.t, run["phi_rad"], 3) - crossing(run.t, run["phi_rad"], 2))

    first = 0.2 * (TROLLEY + MASS)
    closed = theory.rolling_period(LENGTH, G, MASS, TROLLEY)
    return [
        Oracle("momentum along the jib, free trolley", "N s", first, along_the_jib),
        Oracle("period under a free trolley of half the mass", "s", closed, period),
    ]


def _ledgers(bench: Bench) -> list[Oracle]:
    """Return the oracles of the ledger: energy gained less work of the drives plus dissipation,
    over the energy that was moved; all joints damped.
    """
    crane = bench.build(damp_slew=3e4, damp_trolley=200.0, damp_swing=5e3, damp_hoist=700.0)
    start = crane.state(x=15.0, l=LENGTH, phi=0.2, theta=-0.1, gamma_dot=0.03)
    weight = MASS * G * crane.layout.along("l")

    def waves(t: float, *amplitudes: float) -> np.ndarray:
        shapes = math.sin(0.5 * t), math.cos(0.4 * t), math.sin(0.3 * t)
        return np.array(amplitudes) * shapes

    def efforts(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        return waves(t, 2e4, 300.0, 50.0) - weight

    def motions(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        return waves(t, 0.02, 0.2, 0.1)

    controllers: dict[Drive, Controller] = {"effort": efforts, "motion": motions}

    def unexplained(drive: Drive, dt: float) -> float:
        run = bench.run(crane, start, DURATION, dt, controllers[drive], drive=drive)
        return float(run.unexplained[-1] / np.abs(run.work[-1]).sum())

    name = "energy unexplained, drives by {}, of their work"
    return [Oracle(name.format(d), "", 0.0, partial(unexplained, d)) for d in controllers]
