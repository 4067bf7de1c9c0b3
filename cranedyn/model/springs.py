"""Springs in the joints: read from a URDF, their efforts and energy on any kind of number, and the
rest at which they and gravity balance.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import Counter
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from cranedyn.checks import number
from cranedyn.errors import ModelError, UnknownName
from cranedyn.model.layout import ALIGNED, Layout
from cranedyn.model.mimics import Coupling

_TAGS = ("springStiffness", "springReference", "ropeStiffness", "fallSpacing")


class Rope(NamedTuple):
    """An elastic rope that pulls and does not push: its stiffness is EA/l over the present cable
    length l, so that its strain energy is EA s²/(2 l) where it is stretched, s > 0.

    Attributes:
        stretch: Index of the passive coordinate that is its stretch s.
        length: Index of the coordinate that is the cable length l.
        stiffness: EA, Young's modulus times the cross-section [N]; 0 for an inextensible rope.
        inextensible: Whether the rope does not stretch: then s <= 0, and s = 0 where it is taut.
    """

    stretch: int
    length: int
    stiffness: Any
    inextensible: bool = False

    def strain(self, q: np.ndarray) -> Any:
        """Return the strain of the rope, 0 where it is not stretched."""
        strain = q[self.stretch] / q[self.length]
        return 0.5 * (strain + abs(strain))


class Bifilar(NamedTuple):
    """Two parallel falls at half spacing a on which a load of weight W yaws by ψ: falls of length l
    lift it by a² (1 - cos ψ)/l, which is its potential energy over W.

    That is the lift but for a share a² (1 - cos ψ)/(2 l²) of it, so small yaws are exact. The
    tension is the weight at rest: a load that the hoist accelerates by a_l upward has a yaw
    stiffness that is larger by a share a_l/g. The kinetic energy of the lift is left out, a share
    m a⁴ sin² ψ/(I l²) of that of the yaw with inertia I. The load tilts as on one rope.

    Attributes:
        yaw: Index of the passive coordinate ψ.
        length: Index of the coordinate that is the cable length l.
        stiffness: W a² [N m²], yaw stiffness times length.
        spacing: Distance 2 a of the falls [m], above and below.
    """

    yaw: int
    length: int
    stiffness: Any
    spacing: float = 0.0

    def energy(self, q: np.ndarray) -> Any:
        """Return the potential energy of the lift [J]."""
        return self.stiffness * (1.0 - np.cos(q[self.yaw])) / q[self.length]

    def torque(self, q: np.ndarray) -> Any:
        """Return the torque against the yaw [N m]."""
        return self.stiffness * np.sin(q[self.yaw]) / q[self.length]


@dataclass(frozen=True, eq=False)
class Springs:
    """A linear spring in each joint, an elastic rope, and two falls that resist yaw.

    Attributes:
        stiffness: Stiffness of each joint [N m/rad or N/m], shape (n,); 0 for none.
        rest: Coordinates at which the springs are slack [rad or m], shape (n,).
        rope: The rope; None if it does not stretch.
        bifilar: The two falls; None if the load hangs on a single line.
    """

    stiffness: np.ndarray
    rest: np.ndarray
    rope: Rope | None = None
    bifilar: Bifilar | None = None

    @cached_property
    def elastic(self) -> np.ndarray:
        """Whether each joint is held by a spring, the rope or two falls, shape (n,)."""
        elastic = self.stiffness != 0.0
        elastic[[part[0] for part in (self.rope, self.bifilar) if part]] = True
        return elastic

    @cached_property
    def any(self) -> bool:
        """Whether there is any spring."""
        return bool(self.elastic.any())

    def in_units(self, force: Any) -> Springs:
        """Return the springs with forces in units of 1/`force` newtons."""
        rope, falls = self.rope, self.bifilar
        return Springs(
            self.stiffness * force,
            self.rest,
            rope and rope._replace(stiffness=rope.stiffness * force),
            falls and falls._replace(stiffness=falls.stiffness * force),
        )

    def carrying(self, model: pin.Model) -> Springs:
        """Return springs whose two falls carry the weight that a model has below them: all that
        the joint of their length moves, whether it yaws or not.
        """
        if (falls := self.bifilar) is None:
            return self
        mass = sum(model.inertias[body].mass for body in list(model.subtrees[falls.length + 1]))
        weight = -float(model.gravity.linear[2]) * mass
        stiffness = weight * (0.5 * falls.spacing) ** 2
        return replace(self, bifilar=falls._replace(stiffness=stiffness))

    def free(self, joints: np.ndarray) -> np.ndarray:
        """Return the joints, by their indices, that move while the rope is taut."""
        rope = self.rope
        return joints[joints != rope.stretch] if rope and rope.inextensible else joints

    def effort(self, q: np.ndarray) -> np.ndarray:
        """Return the efforts on the joints at coordinates q [N m or N], shape (n,): the negative
        gradient of the energy.
        """
        effort = -(self.stiffness * (q - self.rest))
        if self.rope is not None:
            stretch, length, stiffness, _ = self.rope
            strain = self.rope.strain(q)
            effort[stretch] = effort[stretch] - stiffness * strain
            effort[length] = effort[length] + 0.5 * stiffness * strain * strain
        if (falls := self.bifilar) is not None:
            effort[falls.yaw] = effort[falls.yaw] - falls.torque(q)
            effort[falls.length] = effort[falls.length] + falls.energy(q) / q[falls.length]
        return effort

    def energy(self, q: np.ndarray) -> Any:
        """Return the energy stored at coordinates q [J], a number for shape (n,) and shape (rows,)
        for shape (n, rows).
        """
        offset = q - (self.rest if np.ndim(q) == 1 else self.rest[:, None])
        energy = 0.5 * (self.stiffness @ (offset * offset))
        if self.rope is not None:
            strain = self.rope.strain(q)
            energy = energy + 0.5 * self.rope.stiffness * strain * strain * q[self.rope.length]
        if self.bifilar is not None:
            energy = energy + self.bifilar.energy(q)
        return energy

    def tangent(self, q: np.ndarray) -> np.ndarray:
        """Return the second derivatives of the energy at q [N m/rad, N/m, ...], shape (n, n)."""
        tangent = np.diag(np.asarray(self.stiffness, dtype=float))
        if self.rope is not None and q[self.rope.stretch] >= 0.0:
            s, length, stiffness, _ = self.rope
            strain = q[s] / q[length]
            per_length = stiffness / q[length]
            tangent[s, s] += per_length
            tangent[length, length] += per_length * strain * strain
            tangent[s, length] -= per_length * strain
            tangent[length, s] -= per_length * strain
        if (falls := self.bifilar) is not None:
            yaw, length, stiffness, _ = falls
            tangent[yaw, yaw] += stiffness * np.cos(q[yaw]) / q[length]
            tangent[length, length] += 2.0 * falls.energy(q) / q[length] ** 2
            tangent[[yaw, length], [length, yaw]] -= falls.torque(q) / q[length]
        return tangent


def read_springs(robot: ET.Element, layout: Layout, path: Path) -> Springs:
    """Read springs from a URDF.

    Springs stand in the tags of Gazebo, ``<springStiffness>`` and ``<springReference>``. The rope
    is in a tag of this project, ``<ropeStiffness>``: EA [N], inf for an inextensible rope, at the
    joint that is the stretch of the rope, whose length is the joint in the role hoist. So are two
    falls of this length, ``<fallSpacing>``: their distance [m], at the joint about which all that
    hangs on them yaws.

    Raises:
        UnknownName: If a spring is at no moving joint.
        ModelError: If a tag is given twice, or the stretch of the rope is no passive prismatic
            joint, or the yaw no passive joint about the vertical, or there are both.
        OutOfRange: If a number is not finite, or a stiffness negative.
    """
    stiffness = np.zeros(layout.n)
    rest_angles = np.zeros(layout.n)
    rope = None
    falls = None
    names = [joint.name for joint in layout.joints]
    elements = [
        (block.get("reference", ""), tag)
        for block in robot.iterfind("gazebo")
        for tag in block
        if tag.tag in _TAGS
    ]
    counts = Counter((name, tag.tag) for name, tag in elements)
    for name, tag in elements:
        if name not in names:
            raise UnknownName("moving joint", name, names)
        if counts[name, tag.tag] > 1:
            raise ModelError(f"{path} gives {tag.tag} of {name} twice; allowed is once.")
        i = names.index(name)
        text = (tag.text or "").strip()
        joint = layout.joints[i]
        if tag.tag == "springStiffness":
            unit = "N m/rad" if joint.kind == "revolute" else "N/m"
            stiffness[i] = number(f"spring stiffness of {name}", text, unit, ">= 0")
        elif tag.tag == "springReference":
            rest_angles[i] = number(f"rest position of the spring of {name}", text, joint.unit)
        elif tag.tag == "fallSpacing":
            if joint.driven or joint.kind != "revolute" or abs(joint.axis[2]) < ALIGNED:
                must = "it must be a passive revolute joint about the rope"
                raise ModelError(f"{path} gives the spacing of two falls to {name}; {must}.")
            length = layout.role("hoist", "A load on two falls")
            spacing = number(f"spacing of the falls at {name}", text, "m", "> 0")
            falls = Bifilar(i, length, 0.0, spacing)
        elif joint.driven or joint.kind != "prismatic":
            raise ModelError(
                f"{path} gives the rope's stretch to {name}; it must be a passive prismatic joint."
            )
        else:
            length = layout.role("hoist", "A rope that stretches")
            rigid = text == "inf"
            ea = 0.0 if rigid else number(f"EA of the rope at {name}", text, "N", "> 0")
            rope = Rope(i, length, ea, rigid)
    if rope and falls:
        raise ModelError(
            f"{path} has two falls and a rope that stretches or may go slack; allowed is one of "
            "both (rope_stiffness or fall_spacing 0)."
        )
    return Springs(stiffness, rest_angles, rope, falls)


_ITERATIONS = 50
"""Most steps of Newton's method."""

_LEAST_STEP = 1e-13
"""Step at which it has converged [rad or m]."""

_UNHELD = 1e-6
"""Share of the weight of the crane that may act on a joint at rest [m or 1]."""

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
    model: pin.Model,
    data: pin.Data,
    springs: Springs,
    passive: np.ndarray,
    q: np.ndarray,
    coupling: Coupling | None = None,
) -> np.ndarray:
    """Return the coordinates at rest by Newton's method from q, shape (n,); the passive ones are
    NaN if it does not converge. Followers are where their leaders put them.
    """
    q = q.copy() if coupling is None else coupling.complete(q)
    if (rope := springs.rope) is not None:  # from a taut rope, since a slack one has no stiffness
        q[rope.stretch] = 0.0 if rope.inextensible else max(q[rope.stretch], 0.0)
        passive = springs.free(passive)
    # Round-off of the torques of a load that hangs plumb.
    gravity = float(-model.gravity.linear[2])
    rounding = 1e-15 * gravity * sum(inertia.mass for inertia in model.inertias)
    for _ in range(_ITERATIONS):
        torque = pin.computeGeneralizedGravity(model, data, q) - springs.effort(q)
        if coupling is not None:
            torque = coupling.gather(torque)
        if np.abs(torque[passive]).max(initial=0.0) <= rounding:
            return q
        # Down the energy also where its curvature is negative, half a radian or metre at most.
        stiffness = rest_stiffness(model, data, springs, q, coupling)
        curvature = stiffness[np.ix_(passive, passive)]
        step = _compliance(curvature) @ torque[passive]
        largest = float(np.abs(step).max())
        q[passive] -= step * min(1.0, 0.5 / max(largest, _LEAST_STEP))
        if coupling is not None:
            q = coupling.complete(q)
        if largest < _LEAST_STEP:
            if np.abs(torque[passive]).max() <= _UNHELD * gravity * sum(
                inertia.mass for inertia in model.inertias
            ):
                return q
            break  # what nothing restores falls, such as a free slide along the vertical
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


def rest_stiffness(
    model: pin.Model,
    data: pin.Data,
    springs: Springs,
    q: np.ndarray,
    coupling: Coupling | None = None,
) -> np.ndarray:
    """Return the second derivatives of the energy of gravity and springs, shape (n, n); by the
    reduced coordinates where joints follow others.
    """
    stiffness = pin.computeGeneralizedGravityDerivatives(model, data, q) + springs.tangent(q)
    return stiffness if coupling is None else coupling.reduce(stiffness)


def _compliance(stiffness: np.ndarray) -> np.ndarray:
    """Return the inverse of a symmetric stiffness with all its eigenvalues taken as positive, and
    as infinite where they are zero, as about a vertical axis.
    """
    values, vectors = np.linalg.eigh(stiffness)
    size = np.abs(values)
    nonzero = size > max(1e-12 * size.max(initial=0.0), np.finfo(float).tiny)
    return (vectors[:, nonzero] / size[nonzero]) @ vectors[:, nonzero].T
