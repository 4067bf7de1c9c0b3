"""The swing whose energy is audited: its runs, its energy, and the closed forms for both."""

from __future__ import annotations

import cmath
import math
import sys
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from cranedyn.controllers import hold_controller
from cranedyn.controllers.hold import zero_command
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.bodies import point_paths
from cranedyn.dynamics.equations_of_motion import energy
from cranedyn.interfaces import State, Validity
from cranedyn.model.crane import STANDARD_GRAVITY, Crane
from cranedyn.references import spline
from experiments.harness import PlannedRun, Setup

SWING = 0.15
"""Swing at the start [rad]."""

LENGTH = 15.0
"""Cable length [m]."""

AUDIT = 6.0
"""Time at which the article audits the energy [s]."""

LONG = 60.0
"""Duration of the long run [s]."""

DAMPINGS = (0.0, 1.0, 2.0e5)
"""Damping of the swing joints compared [N m s/rad]."""


class PublishedLedger(NamedTuple):
    """The article's ledger while a plugin overwrote its passive joints [J].

    Attributes:
        first: Swing energy at the start.
        last: Swing energy after `AUDIT`.
        work: Work of the drives.
        unexplained: What is not explained.
    """

    first: float
    last: float
    work: float
    unexplained: float


PUBLISHED = PublishedLedger(first=1651.8, last=19.3, work=-30.7, unexplained=-1601.8)
"""The article's ledger."""


def run(setup: Setup, crane: Crane, swing: float, length: float, duration: float) -> Trajectory:
    """Let the load swing from rest with the drives held.

    Args:
        setup: Clocks and engine.
        crane: The crane.
        swing: Swing at the start [rad].
        length: Cable length [m].
        duration: Duration [s].
    """
    planned = planned_free_swing(crane, crane.state(l=length, phi=swing), duration)
    return setup.make(replace(planned, label=f"dt = {1000 * setup.dt:g} ms"))


def planned_free_swing(crane: Crane, start: State, duration: float) -> PlannedRun:
    """Return the run in which the load swings from a start with the drives held.

    Args:
        crane: The crane.
        start: State at the start.
        duration: Duration [s].
    """
    controller = hold_controller(crane, gravity=STANDARD_GRAVITY)
    return PlannedRun(crane, controller, None, start, duration, "free swing")


def resting_energy(crane: Crane, q: np.ndarray) -> float:
    """Return the energy of the load hanging at rest with the drives where they are [J]."""
    hanging = q.copy()
    hanging[crane.swings] = 0.0
    return energy(crane, State(hanging, np.zeros_like(hanging)))


def swing_energy(crane: Crane, trajectory: Trajectory) -> np.ndarray:
    """Return the mechanical energy above that of the load hanging at rest where the drives started
    [J], shape (n,).
    """
    return trajectory.energy - resting_energy(crane, trajectory.q[0])


def half_step(crane: Crane, trajectory: Trajectory, dt: float) -> float:
    """Return the largest work of the load's weight in half a step [J].

    With semi-implicit Euler positions are half a step ahead of velocities.
    """
    height = point_paths(crane, trajectory.q)[:, 0, 2]
    rate = float(np.abs(np.gradient(height, trajectory.t)).max())
    return dt / 2.0 * crane.payload_mass * crane.gravity * rate


def lowered(setup: Setup, length: float) -> tuple[float, float]:
    """Lower a plumb load by a tenth of the cable [m].

    No force depends on a velocity there and no inertia changes, so that the step keeps the balance
    of energy exactly, if positions are taken back by the half step that they are ahead of the
    velocities, in the energy here and in the work of the drives by the log.

    Returns:
        The largest error of the ledger, and the error that rounding may cause [J].
    """
    crane = setup.variant(damp_slew=0, damp_trolley=0, damp_swing=0, damp_hoist=0)
    start = crane.state(l=length)
    gamma = start.q[crane.layout.index("gamma")]
    x = start.q[crane.layout.index("x")]
    run = setup.simulate(
        crane,
        hold_controller(crane, gravity=STANDARD_GRAVITY),
        spline(crane, start, [(gamma, x, 1.1 * length)], [AUDIT]),
        start=start,
        duration=AUDIT,
        label="a plumb load lowered",
        validity="mark",
    )
    energies = []
    for q, v in zip(run.q, run.v, strict=True):
        in_step = State(q - setup.dt / 2.0 * v, v)
        energies.append(energy(crane, in_step))
    level = np.array(energies)
    error = level - level[0] - run.work.sum(axis=1)
    # Rounding errors of as many sums add like random steps.
    rounding = math.sqrt(len(error)) * sys.float_info.epsilon * float(np.abs(level).max())
    return float(np.abs(error).max()), rounding


def inertia_of(crane: Crane, length: float) -> float:
    """Return the moment of inertia of a radial swing on a cable [m] about the trolley [kg m²]."""
    return crane.payload_mass * length**2 + crane.payload_inertia[0, 0] + crane.dummy_inertia[0]


class Oscillation(NamedTuple):
    """A small swing let go from rest, drives fixed: J φ̈ + d φ̇ + m g l φ = 0.

    Attributes:
        frequency: ω = √(m g l/J) [rad/s].
        ratio: ζ = d/(2 J ω).
    """

    frequency: float
    ratio: float

    def __call__(self, t: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """Return swing, and rate over ω, at given times, as shares of the swing at the start."""
        # Imaginary beyond critical damping, where cosine and sine become hyperbolic.
        damped = cmath.sqrt(1.0 - self.ratio**2)
        turned = self.frequency * damped * np.asarray(t)
        decay = np.exp(-self.ratio * self.frequency * np.asarray(t))
        swing = decay * (np.cos(turned) + self.ratio / damped * np.sin(turned))
        return swing.real, -(decay / damped * np.sin(turned)).real


def oscillation(crane: Crane, length: float, damping: float) -> Oscillation:
    """Return the small swing on a cable [m] under a damping of the joint d [N m s/rad]."""
    inertia = inertia_of(crane, length)
    frequency = math.sqrt(crane.payload_mass * crane.gravity * length / inertia)
    return Oscillation(frequency, damping / (2.0 * inertia * frequency))


def damped_share(crane: Crane, damping: float, length: float, t: float) -> float:
    """Return the share of energy left of a small swing from rest under a damping of the joint."""
    swing, rate = oscillation(crane, length, damping)(t)
    return float(swing**2 + rate**2)


def locked_off(setup: Setup, crane: Crane, swing: float, length: float) -> tuple[float, float]:
    """Compare a swing [rad] on a cable [m] with the drives locked to the damped pendulum.

    Returns:
        Largest difference in energy up to the time of the audit, and that of semi-implicit Euler
        for a swing without damping, ω dt/2; both as shares of the energy at the start.
    """
    weight = crane.payload_mass * crane.gravity * length
    inertia = inertia_of(crane, length)
    damping = float(crane.damping[crane.layout.index("phi")])

    def rates(_: float, y: np.ndarray) -> list[float]:
        """Return the derivative of the angle and the rate of the damped pendulum."""
        return [y[1], -(damping * y[1] + weight * math.sin(y[0])) / inertia]

    # Locked drives need no buffers.
    validity: Validity = "stop" if setup.validity == "buffers" else setup.validity
    run = setup.simulate(
        crane,
        zero_command(crane),
        None,
        start=crane.state(l=length, phi=swing),
        duration=AUDIT,
        drive="motion",
        validity=validity,
        label="drives locked",
    )
    solution = solve_ivp(
        rates,
        (0.0, AUDIT),
        [swing, 0.0],
        t_eval=run.t,
        method="DOP853",
        rtol=1e-10,
        atol=1e-12 * swing,
    )
    phi, rate = solution.y
    # m g l (1 - cos φ) = 2 m g l sin²(φ/2), which loses no digits where φ is small.
    pendulum = inertia * rate**2 / 2.0 + 2.0 * weight * np.sin(phi / 2.0) ** 2
    error = float(np.abs(swing_energy(crane, run) - pendulum).max() / pendulum[0])
    return error, math.sqrt(weight / inertia) * setup.dt / 2.0
