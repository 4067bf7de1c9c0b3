"""Dry friction in the joints: read from a URDF, and the width of the smooth law by which it is
simulated.

Coulomb's law jumps where a joint changes its direction: at rest, friction takes whatever value up
to f keeps the joint still. An explicit integrator cannot step such a law. Here friction is

    F(v) = -f v / sqrt(v² + w²),

which is Coulomb's law at rates far above the width w, and viscous damping f/w far below it. A joint
under a force F < f therefore does not stand still but creeps at the rate w F / sqrt(f² - F²).

The width follows from how fast friction brings a joint to rest, see `STOPPING_TIME`. The law itself
is in `cranedyn.dynamics.joint_forces`.
"""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from cranedyn.checks import number
from cranedyn.errors import OutOfRange
from cranedyn.model.layout import Layout
from cranedyn.model.mimics import Coupling

STOPPING_TIME = 5e-3
"""Time in which full friction slows a joint by the width w of its law [s].

The slope of the law at rest is then that of a damper whose time constant is no shorter than this,
see `smooth_friction`. Semi-implicit Euler is stable in steps up to twice the time constant, RK4 up
to 2.8 times."""

MAX_WIDTH = 1.0
"""Largest width of the law [rad/s or m/s]: with a wider one friction would be a mere damper at the
rates of a crane."""

MAX_COMBINED_DRIVES = 8
"""Number of drives up to which all combinations of the ends of their ranges are looked at for the
least inertia, 256 at most."""


@dataclass(frozen=True, eq=False)
class DryFriction:
    """Dry friction in some of n joints.

    Attributes:
        joints: Indices among the coordinates of the joints that have friction.
        effort: Largest friction f of each [N m or N].
        width: Rate w of each [rad/s or m/s]. At this rate 1/√2 = 71 % of the largest friction acts.
    """

    joints: tuple[int, ...]
    effort: Any
    width: Any

    def in_units(self, force: Any, rate: Any) -> DryFriction:
        """Return the same friction with forces in units of 1/`force` newtons and rates in units of
        1/`rate` rad/s or m/s.
        """
        return DryFriction(self.joints, self.effort * force, self.width * rate)


def read_friction(robot: ET.Element, layout: Layout) -> np.ndarray:
    """Return the dry friction of each joint of a URDF, the attribute ``friction`` of its element
    ``<dynamics>`` [N m or N], shape (n,).

    Raises:
        OutOfRange: If a friction is not finite or negative.
    """
    friction = np.zeros(layout.n)
    names = [joint.name for joint in layout.joints]
    for element in robot.iterfind("joint"):
        name = element.get("name", "")
        dynamics = element.find("dynamics")
        if dynamics is None or name not in names:
            continue
        joint = names.index(name)
        text = dynamics.get("friction", "0")
        unit = layout.joints[joint].effort_unit
        friction[joint] = number(f"dry friction of {name}", text, unit, ">= 0")
    return friction


def smooth_friction(
    efforts: np.ndarray,
    model: pin.Model,
    lower: np.ndarray,
    upper: np.ndarray,
    drives: Sequence[int],
    start: np.ndarray,
    coupling: Coupling | None = None,
) -> DryFriction | None:
    """Return the smooth law of dry friction; None where no joint has any.

    The law is a damper f/w at small rates. With the inverse M⁻¹ of the mass matrix, the fastest of
    its time constants belongs to the largest eigenvalue of M⁻¹ diag(f/w). The widths are

        w_i = T c f_i max(M⁻¹)_ii,

    where the maximum is over the postures of `_inverse_masses`, T is `STOPPING_TIME`, and c is the
    least factor with which that eigenvalue is no more than 1/T in any of these postures: 1 for a
    single joint, and up to the number of joints where they are strongly coupled. A joint whose
    entry of M⁻¹ is zero, a follower with the multiplier 0, never moves and has no friction; nor has
    one whose friction is so small that the square of its width is zero.

    Args:
        efforts: Dry friction of each joint [N m or N], shape (n,).
        model: Pinocchio model of the crane.
        lower: Lower ends of the ranges of the joints, shape (n,).
        upper: Their upper ends, shape (n,).
        drives: Indices of the driven joints among the coordinates.
        start: Coordinates at the start as the URDF states them, shape (n,); the passive joints need
            not be at rest.
        coupling: Joints that follow others; None if there are none.

    Raises:
        OutOfRange: If friction is so large for the inertia of a joint that the law is too wide.
    """
    if not efforts.any():
        return None
    all_inverses = _inverse_masses(model, lower, upper, drives, start, coupling)
    all_mobilities = np.max([np.diag(inverse) for inverse in all_inverses], axis=0)
    # Friction so small that the square of its width is 0 in floating point has no effect on
    # anything, and its law would be 0/0 at rest.
    least_widths = STOPPING_TIME * efforts * all_mobilities
    joints = tuple(np.flatnonzero(least_widths * least_widths > 0.0).tolist())
    if not joints:
        return None
    among = np.ix_(joints, joints)
    inverses = [inverse[among] for inverse in all_inverses]
    mobility = all_mobilities[list(joints)]

    # With the mobility p_i = max(M⁻¹)_ii and f_i/w_i = 1/(T c p_i), the eigenvalues of
    # M⁻¹ diag(f/w) are those of diag(p)^-½ M⁻¹ diag(p)^-½ over T c. None exceeds 1/T if c is the
    # largest of the latter.
    scale = np.sqrt(mobility)
    scaled_inverses = [inverse / scale / scale[:, None] for inverse in inverses]
    interaction = max(float(np.linalg.eigvalsh(scaled)[-1]) for scaled in scaled_inverses)
    effort = efforts[list(joints)]
    width_per_effort = STOPPING_TIME * interaction * mobility
    for joint, friction, width_of_unit in zip(joints, effort, width_per_effort, strict=True):
        rate_limit = float(model.velocityLimit[joint])
        widest = min(rate_limit, MAX_WIDTH) if rate_limit > 0.0 else MAX_WIDTH
        largest = widest / width_of_unit
        if friction > largest:
            name = model.names[joint + 1]
            raise OutOfRange(
                f"dry friction of {name}",
                float(friction),
                f"{largest:.3g} at most for the inertia of that joint, which such friction keeps "
                f"from moving: hold it by locked=[{name!r}], or --locked, or leave friction out",
                "N m or N",
            )
    return DryFriction(joints, effort, width_per_effort * effort)


def _inverse_masses(
    model: pin.Model,
    lower: np.ndarray,
    upper: np.ndarray,
    drives: Sequence[int],
    start: np.ndarray,
    coupling: Coupling | None,
) -> list[np.ndarray]:
    """Return the inverse of the mass matrix, the accelerations per unit of effort, at the start and
    at all combinations of the ends of the ranges of the drives, shape (n, n) each. With more than
    `MAX_COMBINED_DRIVES` drives only the start counts.

    Postures in which the mass matrix is singular, such as a rope without length, are left out: no
    crane moves there.
    """
    postures = [start]
    if len(drives) <= MAX_COMBINED_DRIVES:
        ranges = [(lower[i], upper[i]) for i in drives]
        for ends in itertools.product(*ranges):
            posture = start.copy()
            posture[list(drives)] = ends
            postures.append(posture if coupling is None else coupling.complete(posture))
    data = model.createData()
    inverses = []
    for posture in postures:
        mass = pin.crba(model, data, posture)
        if coupling is not None:
            mass = coupling.reduce(mass)
        scale = np.sqrt(np.diag(mass))
        if not (np.isfinite(scale).all() and (scale > 0.0).all()):
            continue
        if np.linalg.cond(mass / scale / scale[:, None]) > 1.0 / np.finfo(float).eps:
            continue
        inverse = np.linalg.inv(mass)
        if coupling is not None:
            # Followers take what acts on them to their leaders (Gᵀ), and move with them (G).
            inverse = coupling.matrix @ inverse @ coupling.matrix.T
        inverses.append(inverse)
    return inverses


def friction_notes(friction: DryFriction | None, layout: Layout) -> list[str]:
    """Return a sentence on each joint with dry friction, which states the width of its law."""
    if friction is None:
        return []
    notes = []
    for i, effort, width in zip(friction.joints, friction.effort, friction.width, strict=True):
        joint = layout.joints[i]
        notes.append(
            f"Dry friction of {joint.name}: {effort:g} {joint.effort_unit} in motion. Slower than "
            f"about {width:.3g} {joint.unit}/s it falls with the rate to zero, so that the joint "
            "creeps where a real one would stick."
        )
    return notes
