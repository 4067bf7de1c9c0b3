"""Springs in the joints: read from a URDF, their efforts and energy on any kind of number, and the
rest at which they and gravity balance.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Mapping
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

_ROPE_TAGS = ("ropeStiffness", "fallSpacing", "ropeMass", "ropeMassLength")
"""Tags of a URDF that describe the rope, each of which one joint may have."""

_SPRING_TAGS = ("springStiffness", "springReference", *_ROPE_TAGS)
"""Tags of a URDF that are read here, see `read_springs`."""


class Rope(NamedTuple):
    """A rope that pulls and does not push, elastic or inextensible.

    The stiffness of an elastic rope is EA/l with the present cable length l, so that its strain
    energy is EA s²/(2 l) where it is stretched, s > 0.

    Attributes:
        stretch: Index of the passive coordinate that is its stretch s; negative where it is slack.
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
        # max(strain, 0) without a condition, which symbols do not have.
        return 0.5 * (strain + abs(strain))


class Bifilar(NamedTuple):
    """Two parallel falls at half spacing a on which a load of weight W yaws by ψ: falls of length l
    lift it by a² (1 - cos ψ)/l, which is its potential energy over W.

    The ends of a fall are 2 a sin(ψ/2) apart horizontally, so that the load is lifted by

        l - √(l² - 2 a² (1 - cos ψ)) = a² (1 - cos ψ)/l + ...

    The terms left out are a share a² (1 - cos ψ)/(2 l²) of that, which vanishes with the yaw. The
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


class RopeMass(NamedTuple):
    """The mass of a rope that the hoist pays out and winds up.

    Bodies along the rope carry the mass μ l₀ of one reference length l₀. Their number and their
    masses do not depend on the cable length l, so that their potential energy is -μ g l₀ l/2. That
    of a rope which hangs from the pivot is -μ g l²/2. The difference

        U = -μ g l (l - l₀)/2 = -½ μ g (l - l₀/2)² + constant

    is that of a spring of stiffness -μ g which acts on the coordinate l and is slack at l₀/2: the
    stiffness is negative since each metre that is paid out weighs on the hoist. With it the hoist
    at rest holds the weight of the load and of all the rope that hangs, M g + μ g l, which is the
    tension at the pivot.

    Left out are the change of the rope's inertia with l; that the bodies move along the rope at a
    share of l', where all of the rope moves at l', so that the hoist accelerates about a third of
    the rope's mass; and that U does not depend on how far the rope leans.

    Attributes:
        length: Index of the coordinate that is the cable length l.
        mass: Mass of a metre of all falls together, μ [kg/m].
        reference_length: Length l₀ whose mass the bodies carry [m].
    """

    length: int
    mass: float
    reference_length: float


@dataclass(frozen=True, eq=False)
class Springs:
    """A linear spring in each joint, a rope that may go slack, and two falls that resist yaw.

    Attributes:
        stiffness: Stiffness of each joint [N m/rad or N/m], shape (n,); 0 for none.
        rest: Coordinates at which the springs are slack [rad or m], shape (n,).
        rope: The rope that may stretch or go slack; None for one that does neither, whose length is
            the coordinate of the hoist.
        bifilar: The two falls; None if the load hangs on a single line.
        rope_mass: The mass that the hoist pays out; None for a rope without mass.
    """

    stiffness: np.ndarray
    rest: np.ndarray
    rope: Rope | None = None
    bifilar: Bifilar | None = None
    rope_mass: RopeMass | None = None

    @cached_property
    def elastic(self) -> np.ndarray:
        """Whether each joint is held by a spring, the rope or two falls, shape (n,)."""
        elastic = self.stiffness != 0.0
        if self.rope is not None:
            elastic[self.rope.stretch] = True
        if self.bifilar is not None:
            elastic[self.bifilar.yaw] = True
        if self.rope_mass is not None:
            elastic[self.rope_mass.length] = False  # a weight, see `RopeMass`
        return elastic

    @cached_property
    def any(self) -> bool:
        """Whether there is any spring, or a weight that the hoist pays out."""
        return bool(self.elastic.any()) or self.rope_mass is not None

    def in_units(self, force: Any) -> Springs:
        """Return the springs with forces in units of 1/`force` newtons."""
        rope = self.rope
        if rope is not None:
            rope = rope._replace(stiffness=rope.stiffness * force)
        falls = self.bifilar
        if falls is not None:
            falls = falls._replace(stiffness=falls.stiffness * force)
        return Springs(
            self.stiffness * force,
            self.rest,
            rope,
            falls,
            self.rope_mass,
        )

    def carrying(self, model: pin.Model) -> Springs:
        """Return the springs with what depends on gravity and masses of a model.

        The stiffness of the two falls is W a²: W is the weight of all that the joint of their
        length moves, whether it yaws or not. The mass of the rope acts on the hoist as a spring of
        the stiffness -μ g that is slack at half of the length whose mass the bodies have.
        """
        gravity = -float(model.gravity.linear[2])
        if self.rope_mass is not None:
            length = self.rope_mass.length
            stiffness = self.stiffness.copy()
            rest = self.rest.copy()
            stiffness[length] = -gravity * self.rope_mass.mass
            rest[length] = 0.5 * self.rope_mass.reference_length
            return replace(self, stiffness=stiffness, rest=rest)._with_falls(model, gravity)
        return self._with_falls(model, gravity)

    def _with_falls(self, model: pin.Model, gravity: float) -> Springs:
        """Return the springs with the stiffness of the two falls, see `carrying`."""
        falls = self.bifilar
        if falls is None:
            return self
        # Coordinate i belongs to joint i + 1 of Pinocchio, whose joint 0 is the world.
        mass = sum(model.inertias[body].mass for body in list(model.subtrees[falls.length + 1]))
        stiffness = gravity * mass * (0.5 * falls.spacing) ** 2
        return replace(self, bifilar=falls._replace(stiffness=stiffness))

    def free(self, joints: np.ndarray) -> np.ndarray:
        """Return the joints that can move while the rope is taut, out of some joints by their
        indices: a taut inextensible rope holds its stretch at 0.
        """
        if self.rope is not None and self.rope.inextensible:
            return joints[joints != self.rope.stretch]
        return joints

    def effort(self, q: np.ndarray) -> np.ndarray:
        """Return the efforts on the joints at coordinates q [N m or N], shape (n,): the negative
        gradient of the energy.

        The damper of an elastic rope, and that the two together do not push, are in
        `cranedyn.dynamics.joint_forces.JointForces.effort`, which replaces the effort on the
        stretch.
        """
        effort = -(self.stiffness * (q - self.rest))

        # Efforts of the rope, U = EA s²/(2 l) with the strain ε = s/l:
        #
        #     -∂U/∂s = -EA ε,   -∂U/∂l = EA ε²/2.
        rope = self.rope
        if rope is not None:
            strain = rope.strain(q)
            effort[rope.stretch] = effort[rope.stretch] - rope.stiffness * strain
            effort[rope.length] = effort[rope.length] + 0.5 * rope.stiffness * strain * strain

        # Efforts of the two falls, U = W a² (1 - cos ψ)/l: -∂U/∂l = U/l.
        falls = self.bifilar
        if falls is not None:
            effort[falls.yaw] = effort[falls.yaw] - falls.torque(q)
            effort[falls.length] = effort[falls.length] + falls.energy(q) / q[falls.length]
        return effort

    def energy(self, q: np.ndarray) -> Any:
        """Return the energy stored at coordinates q [J], a number for shape (n,) and shape (rows,)
        for shape (n, rows).
        """
        rest = self.rest if np.ndim(q) == 1 else self.rest[:, None]
        offset = q - rest
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

        # Of the rope, U = EA s²/(2 l) with the strain ε = s/l, while it is taut:
        #
        #     ∂²U/∂s² = EA/l,   ∂²U/∂s∂l = -EA/l ε,   ∂²U/∂l² = EA/l ε².
        rope = self.rope
        if rope is not None and q[rope.stretch] >= 0.0:
            stretch = rope.stretch
            length = rope.length
            strain = q[stretch] / q[length]
            per_length = rope.stiffness / q[length]
            tangent[stretch, stretch] += per_length
            tangent[length, length] += per_length * strain * strain
            tangent[stretch, length] -= per_length * strain
            tangent[length, stretch] -= per_length * strain

        # Of the two falls, U = W a² (1 - cos ψ)/l with the torque T = W a² sin ψ/l:
        #
        #     ∂²U/∂ψ² = W a² cos ψ/l,   ∂²U/∂ψ∂l = -T/l,   ∂²U/∂l² = 2 U/l².
        falls = self.bifilar
        if falls is not None:
            yaw = falls.yaw
            length = falls.length
            mixed = falls.torque(q) / q[length]
            tangent[yaw, yaw] += falls.stiffness * np.cos(q[yaw]) / q[length]
            tangent[length, length] += 2.0 * falls.energy(q) / q[length] ** 2
            tangent[yaw, length] -= mixed
            tangent[length, yaw] -= mixed
        return tangent


def read_springs(robot: ET.Element, layout: Layout, path: Path) -> Springs:
    """Read springs from a URDF.

    Springs stand in the tags of Gazebo, ``<springStiffness>`` and ``<springReference>``. The rope
    is in a tag of this project, ``<ropeStiffness>``: EA [N], inf for an inextensible rope, at the
    joint that is the stretch of the rope, whose length is the joint in the role hoist. So are two
    falls of this length, ``<fallSpacing>``: their distance [m], at the joint about which all that
    hangs on them yaws. The mass of a metre of the rope, all falls together, is ``<ropeMass>``
    [kg/m] at the hoist; bodies above it carry the mass of ``<ropeMassLength>`` [m], see `RopeMass`.

    Raises:
        UnknownName: If a spring is at no moving joint.
        MissingRole: If there is a rope or two falls, and no joint has the role hoist.
        ModelError: If a tag is given twice, or the stretch of the rope is no passive prismatic
            joint, or the yaw no passive joint about the vertical, or there are both, or the mass of
            the rope is not at the hoist.
        OutOfRange: If a number is not finite, or a stiffness negative.
    """
    stiffness = np.zeros(layout.n)
    rest = np.zeros(layout.n)
    rope = None
    falls = None
    rope_mass: dict[str, float] = {}
    for index, element in _checked_elements(robot, layout, path):
        joint = layout.joints[index]
        name = joint.name
        text = (element.text or "").strip()
        if element.tag == "springStiffness":
            unit = "N m/rad" if joint.kind == "revolute" else "N/m"
            stiffness[index] = number(f"spring stiffness of {name}", text, unit, ">= 0")
        elif element.tag == "springReference":
            rest[index] = number(f"rest position of the spring of {name}", text, joint.unit)
        elif element.tag == "fallSpacing":
            falls = _read_falls(layout, index, text, path)
        elif element.tag == "ropeStiffness":
            rope = _read_rope(layout, index, text, path)
        else:
            if joint.role != "hoist":
                raise ModelError(f"{path} gives {element.tag} to {name}; it must be the hoist.")
            unit = "kg/m" if element.tag == "ropeMass" else "m"
            rope_mass[element.tag] = number(f"{element.tag} of {name}", text, unit, "> 0")
    if rope is not None and falls is not None:
        raise ModelError(
            f"{path} has two falls and a rope that stretches or may go slack; allowed is one of "
            "both (rope_stiffness or fall_spacing 0)."
        )
    return Springs(stiffness, rest, rope, falls, _rope_mass(rope_mass, stiffness, layout, path))


def _checked_elements(
    robot: ET.Element, layout: Layout, path: Path
) -> list[tuple[int, ET.Element]]:
    """Return the elements of a URDF that describe springs and ropes, each with the index of its
    joint.

    Raises:
        UnknownName: If one is at no moving joint.
        ModelError: If a joint has two of a kind, or two joints describe a rope.
    """
    names = [joint.name for joint in layout.joints]
    elements = _spring_elements(robot)
    counts = Counter((name, element.tag) for name, element in elements)
    for tag in _ROPE_TAGS:
        places = [name for name, element in elements if element.tag == tag]
        if len(set(places)) > 1:
            raise ModelError(
                f"{path} gives {tag} of {' and of '.join(places)}; allowed is one joint, since a "
                "crane has one rope."
            )
    checked = []
    for name, element in elements:
        if name not in names:
            raise UnknownName("moving joint", name, names)
        if counts[name, element.tag] > 1:
            raise ModelError(f"{path} gives {element.tag} of {name} twice; allowed is once.")
        checked.append((names.index(name), element))
    return checked


def _rope_mass(
    values: Mapping[str, float], stiffness: np.ndarray, layout: Layout, path: Path
) -> RopeMass | None:
    """Return the mass that the hoist pays out; None for a rope without mass.

    Args:
        values: Mass of a metre of all falls [kg/m] and length whose mass the bodies have [m], by
            tag.
        stiffness: Stiffness of the spring of each joint, shape (n,).
        layout: Joints of the crane.
        path: File for error messages.

    Raises:
        ModelError: If one of the two is missing, or the hoist has a spring, too.
    """
    if not values:
        return None
    if len(values) == 1:
        raise ModelError(
            f"{path} gives {next(iter(values))} alone; ropeMass and ropeMassLength need each other."
        )
    hoist = layout.role("hoist", "A rope with mass")
    if stiffness[hoist]:
        raise ModelError(
            f"{path} gives a spring and a rope with mass to {layout.joints[hoist].name}; allowed "
            "is one of both."
        )
    return RopeMass(hoist, values["ropeMass"], values["ropeMassLength"])


def _spring_elements(robot: ET.Element) -> list[tuple[str, ET.Element]]:
    """Return the elements of a URDF that describe springs, each with the name of its joint."""
    elements = []
    for block in robot.iterfind("gazebo"):
        name = block.get("reference", "")
        elements += [(name, element) for element in block if element.tag in _SPRING_TAGS]
    return elements


def _read_falls(layout: Layout, index: int, text: str, path: Path) -> Bifilar:
    """Return two falls.

    Args:
        layout: Joints of the crane.
        index: Index of the joint about which the load yaws.
        text: Distance of the falls as the file states it [m].
        path: File for error messages.

    Raises:
        ModelError: If the joint is not a passive revolute joint about the vertical.
        MissingRole: If no joint has the role hoist.
        OutOfRange: If the distance is not a positive number.
    """
    joint = layout.joints[index]
    if not joint.passive or joint.kind != "revolute" or abs(joint.axis[2]) < ALIGNED:
        must = "it must be a passive revolute joint about the vertical"
        raise ModelError(f"{path} gives the spacing of two falls to {joint.name}; {must}.")
    length = layout.role("hoist", "A load on two falls")
    spacing = number(f"spacing of the falls at {joint.name}", text, "m", "> 0")
    # The stiffness follows from the weight below the falls, see `Springs.carrying`.
    return Bifilar(index, length, stiffness=0.0, spacing=spacing)


def _read_rope(layout: Layout, index: int, text: str, path: Path) -> Rope:
    """Return a rope.

    Args:
        layout: Joints of the crane.
        index: Index of the joint that is the stretch of the rope.
        text: EA [N] as the file states it, inf for an inextensible rope.
        path: File for error messages.

    Raises:
        ModelError: If the joint is not a passive prismatic joint.
        MissingRole: If no joint has the role hoist.
        OutOfRange: If EA is not a positive number.
    """
    joint = layout.joints[index]
    if not joint.passive or joint.kind != "prismatic":
        raise ModelError(
            f"{path} gives the rope's stretch to {joint.name}; it must be a passive prismatic "
            "joint."
        )
    length = layout.role("hoist", "A rope that stretches")
    if text == "inf":
        return Rope(index, length, stiffness=0.0, inextensible=True)
    stiffness = number(f"EA of the rope at {joint.name}", text, "N", "> 0")
    return Rope(index, length, stiffness)


def check_stretch(
    springs: Springs, damping: np.ndarray, friction: np.ndarray, layout: Layout, path: Path
) -> None:
    """Check that nothing but the rope acts on its stretch: a slack rope would be held by a spring
    or friction of its own, and an inextensible one by its damping, too, which has no effect while
    it is taut.

    Args:
        springs: The springs.
        damping: Viscous damping of each joint [N m s/rad or N s/m], shape (n,).
        friction: Dry friction of each joint [N m or N], shape (n,).
        layout: Joints of the crane.
        path: File for error messages.

    Raises:
        ModelError: If something else acts on it.
    """
    rope = springs.rope
    if rope is None:
        return
    effects = {
        "a spring (springStiffness)": springs.stiffness[rope.stretch],
        "friction": friction[rope.stretch],
    }
    if rope.inextensible:
        effects["damping"] = damping[rope.stretch]
    for name, value in effects.items():
        if value != 0.0:
            raise ModelError(
                f"{path} gives {name} of {value:g} to {layout.joints[rope.stretch].name}, the "
                "stretch of the rope, which would hold a rope that hangs loose; leave it out."
            )


# --- rest -----------------------------------------------------------------------------------------


_MAX_ITERATIONS = 50
"""Largest number of steps of Newton's method."""

_STEP_TOLERANCE = 1e-13
"""Largest change of a coordinate at which Newton's method has converged [rad or m]."""

_MAX_STEP = 0.5
"""Largest change of a coordinate in a step of Newton's method [rad or m]."""

_ROUND_OFF_EFFORT = 1e-15
"""Effort on the joints, over the weight of the crane, that is round-off [m or 1]: a load that hangs
plumb is left exactly where it is."""

_REST_TOLERANCE = 1e-6
"""Effort over the weight of the crane that may be left on a joint at rest [m or 1]."""

_UNSTABLE = 1e-9
"""Size of a negative eigenvalue of the stiffness, as a share of the largest, from which on a rest
is unstable; a smaller one is round-off of zero."""

_SINGULAR = 1e-12
"""Eigenvalue of a stiffness, as a share of the largest, up to which it counts as zero."""

_ROUND_OFF = 1e-12
"""Angles [rad] and slopes [rad per rad or m] of rest below this are zero."""


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
    rope = springs.rope
    if rope is not None:
        # Newton's method starts from a taut rope, since a slack one has no stiffness.
        q[rope.stretch] = 0.0 if rope.inextensible else max(q[rope.stretch], 0.0)
        passive = springs.free(passive)
    gravity = float(-model.gravity.linear[2])
    mass = pin.computeTotalMass(model)
    for _ in range(_MAX_ITERATIONS):
        unbalanced = pin.computeGeneralizedGravity(model, data, q) - springs.effort(q)
        if coupling is not None:
            unbalanced = coupling.gather(unbalanced)
        if np.abs(unbalanced[passive]).max(initial=0.0) <= _ROUND_OFF_EFFORT * gravity * mass:
            return q
        # `_compliance` takes negative curvatures as positive, so that the step goes down the energy
        # there, too. It is bounded, since the curvature far from rest tells little about it.
        stiffness = rest_stiffness(model, data, springs, q, coupling)
        curvature = stiffness[np.ix_(passive, passive)]
        step = _compliance(curvature) @ unbalanced[passive]
        largest = float(np.abs(step).max())
        q[passive] -= step * min(1.0, _MAX_STEP / max(largest, _STEP_TOLERANCE))
        if coupling is not None:
            q = coupling.complete(q)
        if largest < _STEP_TOLERANCE:
            if np.abs(unbalanced[passive]).max() <= _REST_TOLERANCE * gravity * mass:
                return q
            # A joint without stiffness takes no step, though its weight acts on it: a free slide
            # along the vertical falls.
            break
    q[passive] = np.nan
    return q


def linearise_rest(
    stiffness: np.ndarray, q: np.ndarray, layout: Layout, swings: np.ndarray
) -> Rest:
    """Return rest to first order in the drives about coordinates q at rest, from the stiffness
    there, shape (n, n), and the indices of the swings.
    """
    # At rest the gradient of the energy by the passive joints stays zero while drives move:
    #
    #     K_pp δq_p + K_pd δq_d = 0,   so that   δq_p = -K_pp⁻¹ K_pd δq_d.
    passive = layout.passive
    drives = layout.drives
    passive_stiffness = stiffness[np.ix_(passive, passive)]
    curvature = np.linalg.eigvalsh(passive_stiffness)
    if curvature.min(initial=0.0) < -_UNSTABLE * np.abs(curvature).max(initial=0.0):
        return no_rest(q, layout, swings)
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
    nonzero = size > max(_SINGULAR * size.max(initial=0.0), np.finfo(float).tiny)
    return (vectors[:, nonzero] / size[nonzero]) @ vectors[:, nonzero].T
