"""Numbers of a loaded model: those with which the crane can be simulated."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pinocchio as pin

from cranedyn.checks import number
from cranedyn.errors import ModelError, OutOfRange
from cranedyn.model.layout import Layout

_LEAST_EIGENVALUE = 1e-10
"""Least eigenvalue of the scaled mass matrix, so that its inverse keeps some digits of a double."""

_LARGEST_DEVIATION = 1e-3
"""Largest relative deviation of the articulated-body algorithm from the mass matrix."""

_LIGHTEST = 1e-15
"""Least payload [kg]: Pinocchio adds up bodies that weigh less than 2.2e-16 kg together as if they
weighed that."""


def check_ranges(model: pin.Model, layout: Layout, payload: int) -> None:
    """Check joint ranges, effort limits, damping and payload mass.

    Raises:
        OutOfRange: If one is not a number that a crane can have.
    """
    for i, joint in enumerate(layout.joints):
        low, high = float(model.lowerPositionLimit[i]), float(model.upperPositionLimit[i])
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            name, ends = f"range of {joint.name}", f"{low:g} to {high:g}"
            raise OutOfRange(name, ends, "finite, lower below upper", joint.unit)
        if joint.driven:
            effort = float(model.effortLimit[i])
            number(f"effort limit of {joint.name}", effort, joint.effort_unit, "> 0")
        number(f"damping of {joint.name}", model.damping[i], allowed=">= 0")
        if joint.role == "hoist":
            number("shortest cable", low, "m", "> 0")
    number("payload mass", model.inertias[payload + 1].mass, "kg", f"{_LIGHTEST:g} to 1e30")


def check_solvable(model: pin.Model, q: np.ndarray, layout: Layout, path: Path) -> None:
    """Check that accelerations can be computed.

    The mass matrix, scaled to a unit diagonal, must be far enough from singular. The articulated-
    body algorithm, which computes with other numbers, must accelerate the crane under all its
    efforts as that matrix does.

    Raises:
        OutOfRange: If masses differ too much.
        ModelError: If numbers overflow, a joint moves nothing, or accelerations lose all digits.
    """
    data, zeros = model.createData(), np.zeros(layout.n)
    mass = pin.crba(model, data, q)
    diagonal = np.diag(mass)
    energy = pin.computePotentialEnergy(model, data, q)
    if not (np.isfinite(mass).all() and math.isfinite(energy) and (diagonal > 0.0).all()):
        raise ModelError(
            f"{path} cannot be simulated: masses, lengths or gravity are beyond what a number "
            "holds, or a joint moves nothing."
        )
    scale = np.sqrt(diagonal)
    scaled = mass / scale / scale[:, None]
    smallest = float(np.linalg.eigvalsh(scaled)[0])
    if not smallest > _LEAST_EIGENVALUE:
        allowed = f"> {_LEAST_EIGENVALUE:g}: masses differ too much"
        name = "smallest eigenvalue of the scaled mass matrix"
        raise OutOfRange(name, f"{smallest:.1e}", allowed)
    effort = np.zeros(layout.n)
    effort[layout.drives] = model.effortLimit[layout.drives]
    bias = pin.rnea(model, data, q, zeros, zeros)
    expected = np.linalg.solve(scaled, (effort - bias) / scale)
    acceleration = pin.aba(model, data, q, zeros, effort, pin.Convention.WORLD) * scale
    if not np.abs(acceleration - expected).max() <= _LARGEST_DEVIATION * np.abs(expected).max():
        raise ModelError(
            f"{path} cannot be simulated: its masses and lengths differ so much that accelerations "
            "lose all their digits."
        )
