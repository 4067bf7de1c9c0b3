"""Whether a load swings as a point at the end of its rope, or as its rotational inertia has it.

The inertias of the cranes of this project belong to loads of a tonne. Under a load of some hundred
grams they would slow the swing many times over, and nothing in a run would look wrong. So a crane
reports when its compound pendulum is not the point pendulum that its rope lets one expect.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from cranedyn.model.crane import Crane
from cranedyn.model.springs import rest_stiffness

_MIN_STIFFNESS_RATIO = 0.02
"""A joint counts as a swing where its stiffness is more than this share of m g l, the stiffness of
a point load m at the distance l from a horizontal axis."""

LARGEST_DIFFERENCE = 0.2
"""Relative difference of the two periods from which on a crane reports it. Loads on ropes of the
usual length differ by a few per cent at most."""

_MIN_FREQUENCY_RATIO = 1e-3
"""Frequency over the highest one below which a joint, such as a swivel, turns freely."""


@dataclass(frozen=True)
class Pendulum:
    """The slowest swing of a load at the start of its crane, with all joints locked but the swings
    that gravity restores.

    Attributes:
        period: Its period [s].
        length: Distance from the uppermost swing joint to the centre of mass of the load [m].
        point_period: Period of a point at that distance, 2π √(l/g) [s].
    """

    period: float
    length: float
    point_period: float


def pendulum(crane: Crane) -> Pendulum | None:
    """Return the slowest swing of a load; None if the crane does not hang or nothing swings."""
    carriers = crane.model.supports[crane.payload.body + 1].tolist()
    swings = [i for i in crane.swings.tolist() if i + 1 in carriers]
    if not swings or not crane.rest.hangs:
        return None
    model = crane.model
    data = crane.data
    q = crane.rest.q
    pin.forwardKinematics(model, data, q)
    load = data.oMi[crane.payload.body + 1].act(crane.payload.lever)
    all_stiffness = rest_stiffness(model, data, crane.springs, q, crane.coupling)
    weight = crane.payload_mass * crane.gravity
    # Joints about the vertical, such as a swivel, turn freely: gravity does not restore them.
    restored = []
    for i in swings:
        distance = float(np.linalg.norm(load - data.oMi[i + 1].translation))
        if all_stiffness[i, i] > _MIN_STIFFNESS_RATIO * weight * distance:
            restored.append(i)
    if not restored:
        return None
    among = np.ix_(restored, restored)
    stiffness = all_stiffness[among]
    try:
        # K x = ω² M x becomes an ordinary eigenvalue problem by the factors of M = L Lᵀ:
        #
        #     (L⁻¹ K L⁻ᵀ) y = ω² y   with   y = Lᵀ x.
        #
        # SciPy solves K x = ω² M x at once, but loading a crane need not wait for its import.
        factor = np.linalg.cholesky(crane.mass_matrix(q)[among])
        half = np.linalg.solve(factor, stiffness)
        squares = np.linalg.eigvalsh(np.linalg.solve(factor, half.T))
    except np.linalg.LinAlgError:  # masses that differ too much for double precision
        return None
    if not np.isfinite(squares).all():
        return None
    squares = squares[squares > _MIN_FREQUENCY_RATIO**2 * squares.max()]
    length = float(np.linalg.norm(load - data.oMi[restored[0] + 1].translation))
    if not len(squares) or not length > 0.0:
        return None
    return Pendulum(
        period=2.0 * math.pi / math.sqrt(float(squares.min())),
        length=length,
        point_period=2.0 * math.pi * math.sqrt(length / crane.gravity),
    )


def pendulum_note(crane: Crane) -> tuple[str, ...]:
    """Return a sentence for `Crane.assumptions` if the load of a crane does not swing as a point at
    the end of its rope; none if it does.
    """
    swing = pendulum(crane)
    if swing is None:
        return ()
    ratio = swing.period / swing.point_period
    if abs(ratio - 1.0) <= LARGEST_DIFFERENCE:
        return ()
    sentence = (
        f"At the start the load swings with a period of {swing.period:.3g} s; a point load "
        f"{swing.length:.3g} m below the pivot would swing with {swing.point_period:.3g} s."
    )
    if ratio < 1.0:
        return (f"{sentence} Masses above the load make the difference.",)
    # A compound pendulum of mass m and inertia J about its centre of mass, at the distance l, has
    # the period 2π √((m l² + J)/(m g l)): the square of the ratio is 1 + J/(m l²).
    of_mass = crane.payload_mass * swing.length**2
    rotational = of_mass * (ratio**2 - 1.0)
    sentence = (
        f"{sentence} Rotational inertias make the difference: {rotational:.3g} kg m², where mass "
        f"times length squared is {of_mass:.3g} kg m²."
    )
    arguments = crane.record.get("arguments")
    if isinstance(arguments, dict):
        defaults = [name for name in ("payload_inertia", "dummy_inertia") if name not in arguments]
        if defaults:
            sentence += (
                f" {' and '.join(defaults)} are at their defaults, which are those of a load of a "
                "tonne; set them to the size of this load."
            )
    return (sentence,)
