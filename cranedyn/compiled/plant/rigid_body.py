"""Dynamics of a tree of bodies in any kind of numbers: the recursions behind Pinocchio's
algorithms, for tracing.

Arrays hold Python floats and, where something is not known yet, elements that add, subtract,
multiply, divide and know `sin` and `cos`: symbols of CasADi, or values of a program under
construction. They fold what is 0 or 1, so what is left is the arithmetic of that one crane. A
motion or a force of a body is a pair, linear and angular, in the frame of its joint.

Single elements of arrays are taken as arrays of one element, such as ``v[i : i + 1]``: NumPy then
multiplies element by element, where a symbol times an array would be left to the symbol's class.

Notation in comments: of joint i with the rate q̇ and the acceleration q̈, s is the linear and u the
angular velocity per rate, in the frame of the joint (`Bodies.axis`); E is the rotation of that
frame in the frame of its parent, and r its origin there [m] (`Frame`).

Source: Featherstone, Rigid Body Dynamics Algorithms (2008), §5.3 (Newton-Euler), §6.2 (composite
bodies), §6.5 (factorisation).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from cranedyn.dynamics.bodies import Bodies
from cranedyn.dynamics.root_motion import RootMotion
from cranedyn.dynamics.scalars import array, cross_product, is_zero

_AGREEMENT = 1e-11
"""Relative difference of accelerations that is round-off whatever the mass matrix."""

_ROUNDINGS = 1e3
"""Number of roundings that is expected for each unit of the condition number of a mass matrix."""


NO_HINGES: Mapping[int, Any] = MappingProxyType({})
"""No joint is taken as a hinge."""


def regrouped(tree: Bodies) -> Bodies:
    """Return the same tree with fewer numbers in its bodies that are not zero.

    What a joint moves exactly as its parent does is counted with the parent, which leaves dynamics
    and energy as they are:

    * A prismatic joint does not turn its body against the parent. The parent takes over the inertia
      about the centre of mass.
    * A revolute joint about an axis of its frame on which the centre of mass lies does not move the
      centre against the parent. The parent takes over the mass, as a point there. A helical joint
      moves it along the axis, and keeps its mass.

    Source: Gautier and Khalil, IEEE Trans. Robotics and Automation 6 (1990), 368-373.
    """
    mass = tree.mass.copy()
    lever = tree.lever.copy()
    inertia = tree.inertia.copy()
    # From the tips to the base, so that what a body took over can be handed on.
    for i in range(len(tree) - 1, -1, -1):
        parent = tree.parents[i]
        along, about = tree.axis[i]
        slides = not all(is_zero(component) for component in along)
        rotation = tree.rotation[i]
        turned_axes = [k for k, component in enumerate(about) if not is_zero(component)]
        if parent < 0 or len(turned_axes) > 1:
            continue
        if not turned_axes:
            inertia[parent] = inertia[parent] + rotation @ inertia[i] @ rotation.T
            inertia[i] = 0.0
        elif not slides and all(is_zero(x) for x in np.delete(lever[i], turned_axes)):
            place = tree.translation[i] + rotation @ lever[i]
            _add_mass(mass, lever, inertia, parent, mass[i], place)
            mass[i] = 0.0
            lever[i] = 0.0
    return replace(tree, mass=mass, lever=lever, inertia=inertia)


def _add_mass(
    mass: np.ndarray,
    lever: np.ndarray,
    inertia: np.ndarray,
    i: int,
    point_mass: Any,
    point: np.ndarray,
) -> None:
    """Put a point mass on body i, in place.

    Two masses m and p at the offset d from each other have the common centre at p/(m + p) d, and
    add -m p/(m + p) [d]² to the inertia about it, with the matrix [d] of the product d ×.

    Args:
        mass: Masses of all bodies [kg], shape (n,).
        lever: Their centres of mass [m], shape (n, 3).
        inertia: Their inertias about these [kg m²], shape (n, 3, 3).
        i: The body.
        point_mass: Mass that is added [kg].
        point: Its place in the frame of the body's joint [m], shape (3,).
    """
    if is_zero(point_mass):
        return
    total = mass[i] + point_mass
    offset = point - lever[i]
    share = point_mass / total
    offset_cross = _skew(offset)
    inertia[i] = inertia[i] - offset_cross @ offset_cross * (mass[i] * share)
    mass[i] = total
    lever[i] = lever[i] + offset * share


class Frame(NamedTuple):
    """Frame of a joint in that of its parent.

    Attributes:
        rotation: Rotation from this frame to that of the parent, shape (3, 3).
        origin: Its origin in the frame of the parent [m], shape (3,).
    """

    rotation: np.ndarray
    origin: np.ndarray


class ExternalForce(NamedTuple):
    """A force on a body.

    Attributes:
        body: Row of the body.
        point: Point on which the force acts, in the joint's frame [m], shape (3,).
        force: The force in the world [N], shape (3,).
    """

    body: int
    point: np.ndarray
    force: np.ndarray


def frames(tree: Bodies, q: np.ndarray) -> list[Frame]:
    """Return each joint's frame at coordinates q, shape (n,).

    A revolute joint turns by Rodrigues' formula, with the unit vector u and [u] of the product u ×:

        R(q) = cos q (1 - u uᵀ) + u uᵀ + sin q [u].
    """
    joint_frames = []
    for i in range(len(tree)):
        along, about = tree.axis[i]
        rotation = tree.rotation[i]
        coordinate = q[i : i + 1]
        if any(not is_zero(component) for component in about):
            projection = np.multiply.outer(about, about)
            turn = (
                np.cos(coordinate) * (np.eye(3).astype(object) - projection)
                + projection
                + np.sin(coordinate) * _skew(about)
            )
            rotation = rotation @ turn
        origin = tree.translation[i] + tree.rotation[i] @ (along * coordinate)
        joint_frames.append(Frame(rotation, origin))
    return joint_frames


def point_motions(
    tree: Bodies,
    poses: Sequence[Frame],
    v: np.ndarray,
    body: int,
    points: Sequence[np.ndarray],
    turning: np.ndarray | None = None,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return positions [m] and velocities [m/s] in the world of points of a body, shape (3,) each.

    Args:
        tree: The bodies.
        poses: Their frames.
        v: Rates of the coordinates, shape (n,).
        body: The row of the body.
        points: The points, in the frame of the body's joint [m], shape (3,) each.
        turning: Angular velocity of the frame in which the tree stands, in its axes [rad/s], shape
            (3,); None for one that does not turn. Positions and velocities are in these axes.
    """
    zero = array([0.0] * 3)
    # Pose and motion in the world of the joint that was reached.
    rotation = array(np.eye(3).ravel().tolist()).reshape(3, 3)
    position = zero
    velocity = zero
    omega = zero if turning is None else turning
    for i in tree.path(body):
        along, about = tree.axis[i]
        rate = v[i : i + 1]
        frame = poses[i]
        arm = rotation @ frame.origin
        velocity = velocity + cross_product(omega, arm)
        velocity = velocity + rotation @ (tree.rotation[i] @ (along * rate))
        rotation = rotation @ frame.rotation
        position = position + arm
        omega = omega + rotation @ (about * rate)
    arms = [rotation @ point for point in points]
    return [(position + arm, velocity + cross_product(omega, arm)) for arm in arms]


def tree_inverse_dynamics(
    tree: Bodies,
    poses: Sequence[Frame],
    v: np.ndarray,
    a: np.ndarray | None = None,
    external_forces: Sequence[ExternalForce] = (),
    root: RootMotion | None = None,
) -> np.ndarray:
    """Return the generalized forces that cause accelerations, given gravity and external forces, as
    `pin.rnea` does. Damping is not counted.

    Args:
        tree: The bodies.
        poses: Their frames.
        v: Rates of the coordinates, shape (n,).
        a: Their accelerations, shape (n,); None for zero.
        external_forces: Forces from outside, in the axes of the frame in which the tree stands.
        root: Motion of the frame in which the tree stands; None for one at rest.
    """
    return newton_euler(tree, poses, v, a, external_forces, root).efforts


def transmitted(
    tree: Bodies,
    poses: Sequence[Frame],
    v: np.ndarray,
    a: np.ndarray,
    external_forces: Sequence[ExternalForce],
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the force and the torque about its origin that each joint transmits to its body, in
    the frame of the joint, shape (3,) each. The arguments are those of `tree_inverse_dynamics`.
    """
    loads = newton_euler(tree, poses, v, a, external_forces)
    return list(zip(loads.forces, loads.torques, strict=True))


class JointLoads(NamedTuple):
    """What the joints carry.

    Attributes:
        efforts: Generalized forces, shape (n,).
        forces: Forces on the bodies through their joints, in the frames of these, shape (3,) each.
        torques: Torques likewise, about the origins of the frames.
        motions: Motions of the bodies.
        drifts: Angular acceleration of the body of each hinge about its axis that is left out of
            its motion [rad/s²], by joint.
    """

    efforts: np.ndarray
    forces: list[np.ndarray]
    torques: list[np.ndarray]
    motions: list[BodyMotion]
    drifts: dict[int, Any]


class BodyMotion(NamedTuple):
    """Motion of a body, in the frame of its joint.

    Attributes:
        omega: Angular velocity ω [rad/s], shape (3,).
        alpha: Angular acceleration α [rad/s²], shape (3,).
        acceleration: Acceleration of the origin, less gravity [m/s²], shape (3,).
    """

    omega: np.ndarray
    alpha: np.ndarray
    acceleration: np.ndarray


def newton_euler(
    tree: Bodies,
    poses: Sequence[Frame],
    v: np.ndarray,
    a: np.ndarray | None,
    external_forces: Sequence[ExternalForce],
    root: RootMotion | None = None,
    hinges: Mapping[int, Any] = NO_HINGES,
) -> JointLoads:
    """Return what the joints carry, by the recursive Newton-Euler algorithm: motions from the base
    to the tips, then forces from the tips to the base.

    Args:
        tree: The bodies.
        poses: Their frames.
        v: Rates of the coordinates, shape (n,).
        a: Their accelerations, shape (n,); None for zero.
        external_forces: Forces from outside.
        root: Motion of the frame in which the tree stands; None for one at rest.
        hinges: Efforts of hinges, by joint, see `cranedyn.compiled.plant.forward_dynamics`: a body
            does not turn about the axis of its hinge against the world, apart from its rate, and
            the hinge transmits its effort alone about that axis.
    """
    zero = array([0.0] * 3)
    # The base accelerates against gravity, which puts the weight into the inertial forces.
    base = BodyMotion(zero, zero, -tree.gravity)
    if root is not None:
        base = BodyMotion(root.omega, root.alpha, root.acceleration)
    motions: list[BodyMotion] = []
    drifts: dict[int, Any] = {}
    torques_on_parents: dict[int, np.ndarray] = {}
    forces = []
    torques = []
    for i, frame in enumerate(poses):
        parent_motion = motions[tree.parents[i]] if tree.parents[i] >= 0 else base
        motion = _body_motion(tree, i, frame, parent_motion, v, a)
        if i in hinges:
            drifts[i] = tree.axis[i, 1] @ motion.alpha
            motion = motion._replace(alpha=across_axis(tree, i, motion.alpha))
        if i in hinges and _is_round(tree, i):
            torques_on_parents[i] = _round_torque(tree, i, parent_motion, v)
            force = zero
            torque = zero
        else:
            force, torque = _inertial_load(tree, i, motion)
        motions.append(motion)
        forces.append(force)
        torques.append(torque)
    for body, point, external in external_forces:
        local = into(tree, poses, body, external)
        forces[body] = forces[body] - local
        torques[body] = torques[body] - cross_product(point, local)

    n = len(tree)
    efforts = array([0.0] * n) if a is None else tree.armature * a
    for i in range(n - 1, -1, -1):
        along, about = tree.axis[i]
        efforts[i] = efforts[i] + along @ forces[i] + about @ torques[i]
        if i in hinges:
            torques[i] = across_axis(tree, i, torques[i]) + about * array([hinges[i]])
        parent = tree.parents[i]
        if parent >= 0:
            force_on_parent, torque_on_parent = _to_parent(poses[i], forces[i], torques[i])
            forces[parent] = forces[parent] + force_on_parent
            torques[parent] = torques[parent] + torque_on_parent
            if i in torques_on_parents:
                torques[parent] = torques[parent] + torques_on_parents[i]
    return JointLoads(efforts, forces, torques, motions, drifts)


def across_axis(tree: Bodies, i: int, vector: np.ndarray) -> np.ndarray:
    """Return a vector in the frame of a joint without its component along the axis of the joint,
    which is an axis of the frame.
    """
    components = []
    for along_axis, component in zip(tree.axis[i, 1], vector, strict=True):
        components.append(component if is_zero(along_axis) else 0.0)
    return array(components)


def _is_round(tree: Bodies, i: int) -> bool:
    """Return whether a body has no mass, and the same moment of inertia about every axis."""
    unequal = tree.inertia[i] - _unit_matrix_times(tree.inertia[i], 0)
    return is_zero(tree.mass[i]) and all(is_zero(number) for number in unequal.ravel())


def _round_torque(tree: Bodies, i: int, parent: BodyMotion, v: np.ndarray) -> np.ndarray:
    """Return the torque that gives a round body on a hinge its motion, in the frame of its parent,
    without its component along the axis of the hinge, shape (3,).

    The torque I α on a round body has the direction of its angular acceleration in every frame. In
    that of the parent, α = αp + ωp × u q̇ is there without being turned, and neither need the torque
    be turned back.

    Args:
        tree: The bodies.
        i: The body.
        parent: Motion of its parent.
        v: Rates of the coordinates, shape (n,).
    """
    axis = tree.rotation[i] @ tree.axis[i, 1]
    alpha = parent.alpha + cross_product(parent.omega, axis * v[i : i + 1])
    alpha = alpha - axis * array([axis @ alpha])
    return tree.inertia[i, 0, :1] * alpha


def _body_motion(
    tree: Bodies,
    i: int,
    frame: Frame,
    parent: BodyMotion,
    v: np.ndarray,
    a: np.ndarray | None,
) -> BodyMotion:
    """Return the motion of body i from that of its parent.

    With the latter marked by a p, and s q̇ in the bracket turned into the frame of the parent,

        ω = Eᵀ ωp + u q̇
        α = Eᵀ αp + (Eᵀ ωp) × u q̇ + u q̈
        a = Eᵀ (ap + αp × r + ωp × (ωp × r + 2 s q̇)) + s q̈.
    """
    along, about = tree.axis[i]
    rate = v[i : i + 1]
    rotation = frame.rotation
    twice_slide = 2.0 * (tree.rotation[i] @ (along * rate))
    at_origin = relative_acceleration(parent.omega, parent.alpha, frame.origin, twice_slide)
    acceleration = rotation.T @ (parent.acceleration + at_origin)
    omega = rotation.T @ parent.omega
    alpha = rotation.T @ parent.alpha
    alpha = alpha + cross_product(omega, about * rate)
    omega = omega + about * rate
    if a is not None:
        acceleration = acceleration + along * a[i : i + 1]
        alpha = alpha + about * a[i : i + 1]
    return BodyMotion(omega, alpha, acceleration)


def _inertial_load(tree: Bodies, i: int, motion: BodyMotion) -> tuple[np.ndarray, np.ndarray]:
    """Return the force and the torque about the origin of its joint that give a body its motion.

    With the mass m, the centre of mass c and the inertia I about it,

        f = m (a + α × c + ω × (ω × c))
        t = I α + ω × I ω + c × f.
    """
    inertia = tree.inertia[i]
    lever = tree.lever[i]
    omega = motion.omega
    alpha = motion.alpha
    at_centre = motion.acceleration + relative_acceleration(omega, alpha, lever)
    force = tree.mass[i : i + 1] * at_centre
    # A multiple of the unit matrix adds nothing to ω × I ω. Less one moment, the inertia of a round
    # body is mostly zeros.
    unequal = inertia - _unit_matrix_times(inertia, 2)
    torque = inertia @ alpha + cross_product(omega, unequal @ omega) + cross_product(lever, force)
    return force, torque


def mass_matrix(tree: Bodies, poses: Sequence[Frame], hinges: Collection[int] = ()) -> np.ndarray:
    """Return the mass matrix, as `pin.crba`, both triangles, shape (n, n).

    Args:
        tree: The bodies.
        poses: Their frames.
        hinges: Joints whose accelerations are those of their bodies against the world, about their
            axes, see `cranedyn.compiled.plant.forward_dynamics`.
    """
    n = len(tree)
    # Body i with all bodies that it carries, as one rigid body.
    composites = []
    for i in range(n):
        mass_of_body = tree.mass[i : i + 1]
        first_moment = mass_of_body * tree.lever[i]
        composites.append(_RigidBody(mass_of_body, first_moment, _inertia_about_origin(tree, i)))
    mass = np.empty((n, n), dtype=object)
    mass[:] = 0.0
    for i in range(n - 1, -1, -1):
        # The force and torque for a unit acceleration of joint i act on the joints below it, too.
        along, about = tree.axis[i]
        force, torque = composites[i].times(along, about)
        row = generalized_force(tree, poses, i, force, torque, hinges)
        row[i] = row[i] + tree.armature[i]
        mass[i, : i + 1] = row[: i + 1]
        mass[: i + 1, i] = row[: i + 1]
        equal_axis = 0
        if i in hinges:
            composites[i] = composites[i].without_turning(about)
            # There is no inertia left about the axis of the hinge; the other two are often equal.
            equal_axis = int(np.argmin(np.abs(about.astype(float))))
        parent = tree.parents[i]
        if parent >= 0:
            seen = composites[i].seen_from_parent(poses[i], equal_axis)
            composites[parent] = composites[parent].plus(seen)
    return mass


def generalized_force(
    tree: Bodies,
    poses: Sequence[Frame],
    body: int,
    force: np.ndarray,
    torque: np.ndarray,
    hinges: Collection[int] = (),
) -> np.ndarray:
    """Return the generalized force, shape (n,), of a force and a torque on a body, which are in the
    frame of its joint. Hinges do not transmit torques about their axes, see `mass_matrix`.
    """
    effort = array([0.0] * len(tree))
    effort[body] = tree.axis[body, 0] @ force + tree.axis[body, 1] @ torque
    while (parent := tree.parents[body]) >= 0:
        if body in hinges:
            torque = across_axis(tree, body, torque)
        force, torque = _to_parent(poses[body], force, torque)
        body = parent
        effort[body] = tree.axis[body, 0] @ force + tree.axis[body, 1] @ torque
    return effort


def angular_velocity(tree: Bodies, poses: Sequence[Frame], body: int, v: np.ndarray) -> np.ndarray:
    """Return the angular velocity of a body in the frame of its joint [rad/s], shape (3,).

    The generalized force of a unit torque is also the angular velocity about its axis per rate of
    each coordinate.
    """
    no_force = array([0.0] * 3)
    components = []
    for axis in np.eye(3).tolist():
        jacobian = generalized_force(tree, poses, body, no_force, array(axis))
        components.append(jacobian @ v)
    return array(components)


def lost_digits(mass: np.ndarray) -> float:
    """Return the relative difference to expect between two solutions with a mass matrix: 1000
    roundings for each unit of its condition number.

    Args:
        mass: The matrix in numbers; it is scaled to a unit diagonal first.
    """
    root = np.sqrt(np.diag(mass))
    scaled = mass / root / root[:, None]
    return float(_ROUNDINGS * np.finfo(float).eps * np.linalg.cond(scaled))


def disagreement(computed: np.ndarray, expected: np.ndarray, mass: np.ndarray) -> float:
    """Return the largest difference of accelerations from expected ones over the largest of these;
    0 if it is round-off.

    Args:
        computed: Accelerations at one state, shape (n,), or the same in each row, shape (m, n).
        expected: Accelerations there by Pinocchio, shape (n,).
        mass: Mass matrix there, shape (n, n).
    """
    difference = float(np.abs(computed - expected).max() / np.abs(expected).max())
    if difference <= _AGREEMENT or difference <= lost_digits(mass):
        return 0.0
    return difference


def potential_energy(tree: Bodies, poses: Sequence[Frame]) -> Any:
    """Return the potential energy in gravity [J], zero at the origin of the world.

    It is -m g·p for each body with its centre of mass at p. Gravity is turned from frame to frame,
    and with it the share -g·p of the origins adds up.
    """
    in_frames: list[tuple[np.ndarray, Any]] = []
    energy: Any = 0.0
    for i, (rotation, origin) in enumerate(poses):
        parent = tree.parents[i]
        gravity_of_parent, fall_of_parent = (
            in_frames[parent] if parent >= 0 else (tree.gravity, 0.0)
        )
        gravity = rotation.T @ gravity_of_parent
        fall = fall_of_parent + gravity_of_parent @ origin
        in_frames.append((gravity, fall))
        energy = energy - tree.mass[i] * (fall + gravity @ tree.lever[i])
    return energy


def into(tree: Bodies, poses: Sequence[Frame], body: int, vector: np.ndarray) -> np.ndarray:
    """Return a vector of the world in the frame of a joint, shape (3,)."""
    for i in tree.path(body):
        vector = poses[i].rotation.T @ vector
    return vector


def relative_acceleration(
    omega: np.ndarray,
    alpha: np.ndarray,
    point: np.ndarray,
    twice_slide: np.ndarray | float = 0.0,
) -> np.ndarray:
    """Return the acceleration of a point beyond that of the origin of a turning frame,
    α × p + ω × (ω × p + 2 ṗ), but for p̈.

    Args:
        omega: Angular velocity ω of the frame, shape (3,).
        alpha: Angular acceleration α of the frame, shape (3,).
        point: The point p in the frame, shape (3,).
        twice_slide: 2 ṗ, twice the velocity of the point in the frame, shape (3,).
    """
    tangential = cross_product(alpha, point)
    centripetal_and_coriolis = cross_product(omega, cross_product(omega, point) + twice_slide)
    return tangential + centripetal_and_coriolis


class _RigidBody(NamedTuple):
    """Inertia of a body about the origin of a frame.

    Attributes:
        mass: Mass [kg], shape (1,).
        first_moment: Mass times centre of mass [kg m], shape (3,).
        inertia: Rotational inertia about the origin of the frame [kg m²], shape (3, 3).
    """

    mass: np.ndarray
    first_moment: np.ndarray
    inertia: np.ndarray

    def times(self, linear: np.ndarray, angular: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return linear and angular momentum of a velocity, or force and torque of an acceleration.

        About the origin they are f = m v + ω × m c and t = m c × v + I ω.
        """
        force = self.mass * linear + cross_product(angular, self.first_moment)
        torque = cross_product(self.first_moment, linear) + self.inertia @ angular
        return force, torque

    def plus(self, body: _RigidBody) -> _RigidBody:
        """Return both bodies as one."""
        return _RigidBody(
            self.mass + body.mass,
            self.first_moment + body.first_moment,
            self.inertia + body.inertia,
        )

    def without_turning(self, axis: np.ndarray) -> _RigidBody:
        """Return what is felt of a body without a first moment that is free to turn about an axis
        of the frame: no inertia about this axis.
        """
        inertia = self.inertia.copy()
        for k, component in enumerate(axis):
            if not is_zero(component):
                inertia[k, :] = 0.0
                inertia[:, k] = 0.0
        return self._replace(inertia=inertia)

    def seen_from_parent(self, frame: Frame, equal_axis: int = 0) -> _RigidBody:
        """Return the body about the origin of the parent, in whose frame its frame stands.

        With the matrix [x] of the product x ×, the first moment h = E m c and the origin r of the
        frame, both in that of the parent, I' = E I Eᵀ - [r] [h] - ([r] [h])ᵀ - m [r] [r].

        Args:
            frame: The frame.
            equal_axis: Axis whose moment of inertia is taken as that of a round body, with which
                the others are compared; one that makes most of them zero leaves the least to turn.
        """
        first_moment = frame.rotation @ self.first_moment
        origin_cross = _skew(frame.origin)
        mixed = origin_cross @ _skew(first_moment)
        # A multiple of the unit matrix is the same in every frame, so that it need not be turned.
        equal = _unit_matrix_times(self.inertia, equal_axis)
        inertia = (
            frame.rotation @ (self.inertia - equal) @ frame.rotation.T
            + equal
            - mixed
            - mixed.T
            - origin_cross @ origin_cross * self.mass
        )
        # The matrix is symmetric; taking one triangle for both leaves one to compute.
        inertia[[1, 2, 2], [0, 0, 1]] = inertia[[0, 0, 1], [1, 2, 2]]
        return _RigidBody(self.mass, first_moment + self.mass * frame.origin, inertia)


def _inertia_about_origin(tree: Bodies, i: int) -> np.ndarray:
    """Return the inertia of a body about the origin of its joint [kg m²], by Steiner's theorem."""
    lever_cross = _skew(tree.lever[i])
    return tree.inertia[i] - lever_cross @ lever_cross * tree.mass[i : i + 1]


def _unit_matrix_times(inertia: np.ndarray, k: int) -> np.ndarray:
    """Return the unit matrix times the moment of inertia about axis k, shape (3, 3)."""
    return np.diag(inertia[[k], [k]].repeat(3))


def _to_parent(
    frame: Frame, force: np.ndarray, torque: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return a force and a torque about the origin of a frame as those about the origin of the
    parent, in its frame.
    """
    turned = frame.rotation @ force
    return turned, frame.rotation @ torque + cross_product(frame.origin, turned)


def _skew(a: np.ndarray) -> np.ndarray:
    """Return the matrix [a] with [a] b = a × b, shape (3, 3)."""
    return array([0.0, -a[2], a[1], a[2], 0.0, -a[0], -a[1], a[0], 0.0]).reshape(3, 3)
