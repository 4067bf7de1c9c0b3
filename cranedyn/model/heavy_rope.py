"""The bodies of a rope with mass, and how many of them a rope needs.

`urdf/heavy_rope.xacro` makes the bodies, and `cranedyn.model.springs.RopeMass` accounts for the
weight that the hoist pays out.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from cranedyn import theory
from cranedyn.checks import number, whole, within
from cranedyn.errors import OutOfRange
from cranedyn.model.crane import Crane

MAX_BODIES = 100
"""Largest number of bodies that `bodies_for` tries."""


def rope_bodies(crane: Crane) -> tuple[int, ...]:
    """Return the indices of the joints that carry the bodies of a rope with mass, from its upper
    end on; none for a rope without mass.
    """
    if crane.springs.rope_mass is None:
        return ()
    hoist = crane.springs.rope_mass.length
    bodies = []
    for index in _above(crane, hoist):
        follows_hoist = crane.layout.joints[index].follows == crane.layout.joints[hoist].name
        if follows_hoist and crane.model.inertias[index + 1].mass > 0.0:
            bodies.append(index)
    return tuple(bodies)


def rope_bends(crane: Crane) -> tuple[int, ...]:
    """Return the indices of the passive joints at which a rope with mass bends, from its upper end
    on; none for a rope without mass.
    """
    bodies = rope_bodies(crane)
    if not bodies:
        return ()
    assert crane.springs.rope_mass is not None
    above_hoist = _above(crane, crane.springs.rope_mass.length)
    below_first_body = above_hoist[above_hoist.index(bodies[0]) + 1 :]
    joints = crane.layout.joints
    return tuple(index for index in below_first_body if joints[index].kind == "revolute")


def _above(crane: Crane, joint: int) -> list[int]:
    """Return the indices of the joints between the world and a joint, without that joint itself, in
    this order.
    """
    # Coordinate i belongs to joint i + 1 of Pinocchio, whose joint 0 is the world.
    supports = crane.model.supports[joint + 1].tolist()
    return [support - 1 for support in supports if 0 < support <= joint]


def chain_frequencies(
    bodies: int, length: float, mass_per_metre: float, load: float, gravity: float
) -> np.ndarray:
    """Return the frequencies of small swings of a load on a rope whose mass is in some bodies
    [rad/s], shape (bodies + 1,), increasing.

    They are those of the discretised rope of a crane with a point load and a pivot at rest.
    `theory.heavy_rope` has those of the rope itself.

    Args:
        bodies: Number of bodies on the rope.
        length: Cable length l [m].
        mass_per_metre: Mass of a metre of all falls together μ [kg/m].
        load: Mass of the load [kg].
        gravity: g [m/s²].

    Raises:
        OutOfRange: If a number is not positive and finite, or `bodies` is no positive whole number.
    """
    count = whole("number of bodies", bodies, 1)
    number("cable length", length, "m", "> 0")
    number("mass of a metre of rope", mass_per_metre, "kg/m", "> 0")
    number("load", load, "kg", "> 0")
    number("gravity", gravity, "m/s²", "> 0")
    body = mass_per_metre * length / count
    masses = np.append(np.full(count, body), load)
    pieces = np.full(count + 1, length / count)
    pieces[[0, -1]] /= 2.0
    # The piece above a mass carries it and all below it.
    tensions = gravity * np.cumsum(masses[::-1])[::-1]
    # A piece of the length a under the tension T is, for displacements across, a spring of the
    # stiffness T/a between its ends.
    springs = tensions / pieces
    diagonal = springs + np.append(springs[1:], 0.0)
    roots = np.sqrt(masses)
    squares = scipy.linalg.eigvalsh_tridiagonal(
        diagonal / masses, -springs[1:] / (roots[:-1] * roots[1:])
    )
    return np.sqrt(squares)


def bodies_for(
    error: float,
    length: float,
    mass_per_metre: float,
    load: float,
    gravity: float,
    mode: int = 1,
) -> int:
    """Return the least number of bodies with which a frequency of a load on a rope with mass is
    right to a relative error.

    The error falls with the square of the number of bodies.

    Args:
        error: Largest relative error of the frequency, more than 0 and less than 1.
        length: Cable length [m].
        mass_per_metre: Mass of a metre of all falls together [kg/m].
        load: Mass of the load [kg].
        gravity: g [m/s²].
        mode: Which frequency: 1 is that of the load's swing, 2 the first at which the rope vibrates
            between pivot and load.

    Raises:
        OutOfRange: If a number is out of its range, or more than `MAX_BODIES` would be needed.
    """
    within("error", error, 1e-12, 0.999, "")
    mode = whole("mode", mode, 1)
    if mode > MAX_BODIES + 1:
        raise OutOfRange("mode", mode, f"1 to {MAX_BODIES + 1}, of {MAX_BODIES} bodies")
    exact = theory.heavy_rope(length, mass_per_metre, load, gravity, mode)[-1]
    for bodies in range(max(1, mode - 1), MAX_BODIES + 1):
        found = chain_frequencies(bodies, length, mass_per_metre, load, gravity)[mode - 1]
        if abs(found / exact - 1.0) <= error:
            return bodies
    allowed = f"larger: mode {mode} needs more than {MAX_BODIES} bodies for it"
    raise OutOfRange("error", error, allowed)
