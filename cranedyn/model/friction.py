"""Dry friction in the joints: read from a URDF, and the width of the smooth law by which it is
simulated.

Coulomb's law jumps where a joint changes its direction: friction is whatever holds the joint there,
up to its largest value f. An explicit integrator cannot step such a law. Here friction is

    F(v) = -f v / sqrt(v² + w²),

which is Coulomb's law at rates far above the width w, and viscous damping f/w far below it. A joint
under a force F < f therefore does not stand: it creeps at the rate w F / sqrt(f² - F²).

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

STOPPING_TIME = 5e-3
"""The width w is the rate that friction takes off a joint in this time [s].

The slope of the law at rest is then that of a damper with this time constant. Semi-implicit Euler
is stable in steps up to twice the time constant, RK4 up to 2.8 times, so that all steps in use here
(0.5 to 10 ms) are stable."""

_LARGEST_WIDTH = 1.0
"""Largest width of the law [rad/s or m/s]: with a wider one friction would be a mere damper at the
rates of a crane."""

_MOST_COMBINED_DRIVES = 8
"""Number of drives up to which all combinations of the ends of their ranges are looked at for the
least inertia, 256 at most."""


@dataclass(frozen=True, eq=False)
class DryFriction:
    """Dry friction in some of n joints.

    Attributes:
        joints: Indices among the coordinates of the joints that have friction.
        effort: Largest friction f of each [N m or N].
        width: Rate w of each [rad/s or m/s] at which 71 % of the largest friction acts.
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
        name, dynamics = element.get("name", ""), element.find("dynamics")
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
) -> DryFriction | None:
    """Return the smooth law of dry friction; None where no joint has any.

    Args:
        efforts: Dry friction of each joint [N m or N], shape (n,).
        model: Pinocchio model of the crane.
        lower: Lower ends of the ranges of the joints, shape (n,).
        upper: Their upper ends, shape (n,).
        drives: Indices of the driven joints among the coordinates.
        start: Coordinates at which runs start, shape (n,).

    Raises:
        OutOfRange: If friction is so large for the inertia of a joint that the law is too wide.
    """
    joints = tuple(np.flatnonzero(efforts).tolist())
    if not joints:
        return None
    mobility = _largest_mobility(model, lower, upper, drives, start)[list(joints)]
    effort = efforts[list(joints)]
    width = STOPPING_TIME * effort * mobility
    for joint, friction, moved in zip(joints, effort, mobility, strict=True):
        fastest = float(model.velocityLimit[joint])
        widest = min(fastest, _LARGEST_WIDTH) if fastest > 0.0 else _LARGEST_WIDTH
        largest = widest / (STOPPING_TIME * moved)
        if friction > largest:
            name = model.names[joint + 1]
            raise OutOfRange(
                f"dry friction of {name}",
                float(friction),
                f"{largest:.3g} at most for the inertia of that joint; one that rubs more hardly "
                f"moves: hold it by locked=[{name!r}], or --locked, or leave its friction out",
                "N m or N",
            )
    return DryFriction(joints, effort, width)


def _largest_mobility(
    model: pin.Model,
    lower: np.ndarray,
    upper: np.ndarray,
    drives: Sequence[int],
    start: np.ndarray,
) -> np.ndarray:
    """Return the largest acceleration of each joint per unit of effort on it, with all others free,
    over the ends of the ranges of the drives: the diagonal of the inverse mass matrix, shape (n,).

    Postures in which the mass matrix is singular, such as a rope without length, are left out: no
    crane moves there.
    """
    postures = [start]
    if len(drives) <= _MOST_COMBINED_DRIVES:
        for ends in itertools.product(*[(lower[i], upper[i]) for i in drives]):
            posture = start.copy()
            posture[list(drives)] = ends
            postures.append(posture)
    data, largest = model.createData(), np.zeros(model.nv)
    for posture in postures:
        mass = pin.crba(model, data, posture)
        scale = np.sqrt(np.diag(mass))
        if not (np.isfinite(scale).all() and (scale > 0.0).all()):
            continue
        if np.linalg.cond(mass / scale / scale[:, None]) > 1.0 / np.finfo(float).eps:
            continue
        largest = np.maximum(largest, np.diag(np.linalg.inv(mass)))
    return largest


def friction_notes(friction: DryFriction | None, layout: Layout) -> list[str]:
    """Return a sentence on each joint with dry friction, which states the width of its law."""
    notes = []
    if friction is not None:
        for i, effort, width in zip(friction.joints, friction.effort, friction.width, strict=True):
            joint = layout.joints[i]
            notes.append(
                f"Dry friction of {joint.name}: {effort:g} {joint.effort_unit}, simulated as a "
                f"smooth function of the rate that reaches 71 % at {width:.3g} {joint.unit}/s."
            )
    return notes
