"""Rest: coordinates at which gravity and springs balance."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from cranedyn.model.layout import Layout
from cranedyn.model.springs import Springs

_ITERATIONS, _LEAST_STEP = 50, 1e-13
"""Most steps of Newton's method, and the step at which it has converged [rad or m]."""

_ROUND_OFF = 1e-12
"""Angles and slopes of rest below this are zero."""


class Rest(NamedTuple):
    """Angles of the swing joints at rest: `angle + slope @ drives`.

    Both are exactly zero for a load that hangs plumb when its swing joints are at zero.

    Attributes:
        q: Coordinates at rest with the drives as at the start, shape (n,).
        angle: Shape (swings,) [rad].
        slope: Derivative by the coordinates of the drives, shape (swings, m) [rad per rad or m].
        hangs: Whether the passive joints have a stable rest near the start; false for a mechanism
            that is no crane, such as a robot with free joints. Then angle and slope are zero.
    """

    q: np.ndarray
    angle: np.ndarray
    slope: np.ndarray
    hangs: bool


def solve_rest(
    model: pin.Model, data: pin.Data, springs: Springs, passive: np.ndarray, q: np.ndarray
) -> np.ndarray:
    """Return the coordinates at rest by Newton's method from q, shape (n,); the passive ones are
    NaN if it does not converge.
    """
    q = q.copy()
    # Round-off of the torques of a load that hangs plumb.
    gravity = float(-model.gravity.linear[2])
    rounding = 1e-15 * gravity * sum(inertia.mass for inertia in model.inertias)
    for _ in range(_ITERATIONS):
        torque = pin.computeGeneralizedGravity(model, data, q) - springs.effort(q)
        if np.abs(torque[passive]).max(initial=0.0) <= rounding:
            return q
        # Down the energy also where its curvature is negative, half a radian or metre at most.
        curvature = stiffness(model, data, springs, q)[np.ix_(passive, passive)]
        step = _compliance(curvature) @ torque[passive]
        largest = float(np.abs(step).max())
        q[passive] -= step * min(1.0, 0.5 / max(largest, _LEAST_STEP))
        if largest < _LEAST_STEP:
            return q
    q[passive] = np.nan
    return q


def linearise_rest(
    stiffness: np.ndarray, q: np.ndarray, layout: Layout, swings: np.ndarray
) -> Rest:
    """Return rest to first order in the drives about coordinates q at rest, from the stiffness
    there, shape (n, n), and the indices of the swings.
    """
    passive, drives = layout.passive, layout.drives
    passive_stiffness = stiffness[np.ix_(passive, passive)]
    curvature = np.linalg.eigvalsh(passive_stiffness)
    if curvature.min(initial=0.0) < -1e-9 * np.abs(curvature).max(initial=0.0):
        return no_rest(q, layout, swings)  # unstable: it would fall
    by_drives = -_compliance(passive_stiffness) @ stiffness[np.ix_(passive, drives)]
    slope = by_drives[np.isin(passive, swings)]
    slope[np.abs(slope) < _ROUND_OFF] = 0.0
    angle = q[swings] - slope @ q[drives]
    angle[np.abs(angle) < _ROUND_OFF] = 0.0
    return Rest(q, angle, slope, hangs=True)


def no_rest(q: np.ndarray, layout: Layout, swings: np.ndarray) -> Rest:
    """Return the `Rest` of a mechanism that does not hang at rest near coordinates q."""
    return Rest(q, np.zeros(len(swings)), np.zeros((len(swings), layout.m)), hangs=False)


def stiffness(model: pin.Model, data: pin.Data, springs: Springs, q: np.ndarray) -> np.ndarray:
    """Return the second derivatives of the energy of gravity and springs, shape (n, n)."""
    return pin.computeGeneralizedGravityDerivatives(model, data, q) + springs.tangent(q)


def _compliance(stiffness: np.ndarray) -> np.ndarray:
    """Return the inverse of a symmetric stiffness with all its eigenvalues taken as positive, and
    as infinite where they are zero, as about a vertical axis.
    """
    values, vectors = np.linalg.eigh(stiffness)
    size = np.abs(values)
    nonzero = size > max(1e-12 * size.max(initial=0.0), np.finfo(float).tiny)
    return (vectors[:, nonzero] / size[nonzero]) @ vectors[:, nonzero].T
