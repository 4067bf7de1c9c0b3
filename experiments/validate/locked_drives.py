"""Oracles of swings with the drives locked: in a plane at any amplitude, and on ovals that turn."""

from __future__ import annotations

import math
from functools import cache, partial

import numpy as np

from cranedyn import theory
from cranedyn.data.trajectory import Trajectory
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from experiments.validate.bench import MASS, Bench, G
from experiments.validate.oracle import Oracle
from experiments.validate.reading import crossing, curve, offset_from_plumb, zero_between

LENGTH = 20.0
"""Cable length of a point load [m]."""

SHORT_LENGTH = 5.0
"""Cable length of a load with inertia [m], which shows on a short cable."""

LOAD_INERTIA = 400.0
"""Inertia of a rigid load about each axis [kg m²]."""

LINK_INERTIA = 50.0
"""Inertia of each of the two links between the swing joints and the load [kg m²], and their mass
[kg].

Both turn with the load in φ, one of them in θ.
"""

BEAM_INERTIA = 500.0
"""Inertia of a thin beam across its axis [kg m²]."""

FALL_SPACING = 2.0
"""Distance of the two falls on which the beam hangs [m]."""

OVALS = ((2.0, 1.0), (8.0, 4.0))
"""Half axes of the ovals [m]."""


def oracles(bench: Bench) -> list[Oracle]:
    """Return the oracles of periods, tensions and precessions."""
    point = bench.build()
    rigid = bench.build(
        payload_inertia=LOAD_INERTIA, dummy_mass=LINK_INERTIA, dummy_inertia=LINK_INERTIA
    )
    beam = bench.build(
        fall_spacing=FALL_SPACING, payload_ixx=BEAM_INERTIA, payload_izz=BEAM_INERTIA
    )
    small_period = partial(theory.rigid_period, gravity=G, mass=MASS)
    of_point = small_period(LENGTH, inertia=0.0)
    of_phi = small_period(SHORT_LENGTH, inertia=LOAD_INERTIA + 2.0 * LINK_INERTIA)
    of_theta = small_period(SHORT_LENGTH, inertia=LOAD_INERTIA + LINK_INERTIA)
    sway, yaw = theory.bifilar(MASS, BEAM_INERTIA, FALL_SPACING / 2.0, LENGTH, G)
    of_sway = 2.0 * math.pi / sway
    of_yaw = 2.0 * math.pi / yaw
    return [
        _period(bench, point, "phi", LENGTH, of_point, 30.0),
        _period(bench, point, "phi", LENGTH, of_point, 60.0),
        _period(bench, point, "phi", LENGTH, of_point, 90.0),
        _period(bench, rigid, "phi", SHORT_LENGTH, of_phi, 60.0, ", φ with 500 kg m²"),
        _period(bench, rigid, "theta", SHORT_LENGTH, of_theta, 60.0, ", θ with 450 kg m²"),
        _period(bench, beam, "theta", LENGTH, of_sway, 1.0, ", sway on two falls"),
        _period(bench, beam, "load_yaw", LENGTH, of_yaw, 1.0, ", yaw on two falls"),
        *_tensions(bench, point),
        *_precessions(bench, point),
    ]


def _period(
    bench: Bench,
    crane: Crane,
    joint: str,
    length: float,
    small_period: float,
    degrees: float,
    suffix: str = "",
) -> Oracle:
    """Return the oracle of the period of a swing, twice the time from one passage of the vertical
    to the next.

    Args:
        bench: Where it runs.
        crane: The crane.
        joint: Coordinate that swings.
        length: Cable length [m].
        small_period: Period of small swings [s].
        degrees: Amplitude [°].
        suffix: What the name of the oracle says of the load.
    """
    amplitude = math.radians(degrees)
    # The run starts at the lowest point, by conservation of energy with the rate 2 ω sin(A/2).
    rate = 2.0 * math.sin(amplitude / 2.0) * 2.0 * math.pi / small_period

    def read(dt: float) -> float:
        run = bench.run(crane, crane.state(l=length, **{f"{joint}_dot": rate}), 12.0, dt)
        # The run starts at a passage, so that the second change of sign is a whole period later.
        return crossing(run.t, run[f"{joint}_rad"], 2)

    name = f"period of {degrees:g}°, l = {length:g} m{suffix}"
    return Oracle(name, "s", small_period * float(theory.amplitude_factor(amplitude)), read)


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
    """Return the state in which a load on an oval is at the end of its first half axis.

    A small swing with the amplitude b passes the vertical at the speed b ω; here it does so at a
    right angle to the first half axis, to the left seen from above.

    Args:
        crane: The crane.
        half_axis: Distance from the vertical [m].
        other_half_axis: The other half axis, b [m].
    """
    return crane.state(
        l=LENGTH,
        phi=math.asin(half_axis / LENGTH),
        theta_dot=other_half_axis / LENGTH * math.sqrt(G / LENGTH),
    )


def apse(trajectory: Trajectory) -> tuple[float, float]:
    """Return when an oval comes back to its far end, and how far it has turned meanwhile.

    Args:
        trajectory: A run from that end.

    Returns:
        The time [s], and the angle [rad] by which the direction of the far end has turned.
    """
    t = trajectory.t
    offset = offset_from_plumb(trajectory.q)[:, :2]
    square = (offset**2).sum(axis=1)
    angle = np.unwrap(np.arctan2(offset[:, 1], offset[:, 0]))
    # An oval is at a far end each half period. The one after a whole period is the largest
    # distance beyond 0.7 of it.
    late = t > 0.7 * theory.point_period(LENGTH, G)
    row = int(np.argmax(np.where(late, square, 0.0)))
    t_apse = zero_between(curve(t, square, row).derivative(), t[row - 1], t[row + 1])
    return t_apse, float(curve(t, angle, row)(t_apse)) - float(angle[0]) - 2.0 * math.pi


def _precessions(bench: Bench, crane: Crane) -> list[Oracle]:
    """Return the oracles of the angle by which an oval turns in a revolution.

    They are exact, but for one more of Airy's formula for small ovals.
    """

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
            # The next term of the series is smaller by about the square of the angles.
            square = (far**2 + near**2) / LENGTH**2
            why = "(a² + b²)/l²"
            oracles.append(Oracle(f"{name}, by Airy", "rad", airy, read, airy * square, why))
    return oracles
