"""Dynamics of a tree of bodies in any kind of numbers: the recursions behind Pinocchio's
algorithms, for tracing.

Arrays hold Python floats and, where something is not known yet, elements that add, subtract,
multiply, divide and know `sin` and `cos`: symbols of CasADi, or values of a program under
construction. They fold what is 0 or 1, so what is left is the arithmetic of that one crane. A
motion or a force of a body is a pair, linear and angular, in the frame of its joint.

Source: Featherstone, Rigid Body Dynamics Algorithms (2008), §5.3 (Newton-Euler), §6.2 (composite
bodies), §6.5 (factorisation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from cranedyn.dynamics.bodies import Bodies
from cranedyn.dynamics.scalars import array, cross_product, is_zero, solve_linear

_AGREEMENT = 1e-11
"""Relative difference of accelerations that is round-off whatever the mass matrix."""


def regrouped(tree: Bodies) -> Bodies:
    """Return the same tree with less in its bodies: what a joint moves as its parent does anyway is
    counted with the parent, which leaves dynamics and energy as they are.

    That is the inertia about the centre of mass where the joint does not turn, and the mass where
    the centre lies on an axis of the frame about which it turns.

    Source: Gautier and Khalil, IEEE Trans. Robotics and Automation 6 (1990), 368-373.
    """
    mass, lever, inertia = tree.mass.copy(), tree.lever.copy(), tree.inertia.copy()
    for i in range(len(tree) - 1, -1, -1):
        parent, (_, about), turn = tree.parents[i], tree.axis[i], tree.rotation[i]
        axes = [k for k, component in enumerate(about) if not is_zero(component)]
        if parent < 0 or len(axes) > 1:
            continue
        if not axes:
            inertia[parent] = inertia[parent] + turn @ inertia[i] @ turn.T
            inertia[i] = 0.0
        elif all(is_zero(component) for component in np.delete(lever[i], axes)):
            _add_mass(mass, lever, inertia, parent, mass[i], tree.translation[i] + turn @ lever[i])
            mass[i], lever[i] = 0.0, 0.0
    return replace(tree, mass=mass, lever=lever, inertia=inertia)


def _add_mass(
    mass: np.ndarray,
    lever: np.ndarray,
    inertia: np.ndarray,
    i: int,
    point_mass: Any,
    point: np.ndarray,
) -> None:
    """Put a point mass [kg] somewhere on a body [m]."""
    if is_zero(point_mass):
        return
    total = mass[i] + point_mass
    offset = point - lever[i]
    share = point_mass / total
    arm = _skew(offset)
    inertia[i] = inertia[i] - arm @ arm * (mass[i] * share)
    mass[i], lever[i] = total, lever[i] + offset * share


class Frame(NamedTuple):
    """A joint's frame in that of its parent: rotation, shape (3, 3), and origin [m], shape (3,)."""

    rotation: np.ndarray
    origin: np.ndarray


class ExternalForce(NamedTuple):
    """A force on a body.

    Attributes:
        body: Its row.
        point: Where, in the joint's frame [m], shape (3,).
        force: In the world [N], shape (3,).
    """

    body: int
    point: np.ndarray
    force: np.ndarray


def frames(tree: Bodies, q: np.ndarray) -> list[Frame]:
    """Return each joint's frame at coordinates q, shape (n,)."""
    joint_frames = []
    for i in range(len(tree)):
        (along, about), rotation, coordinate = tree.axis[i], tree.rotation[i], q[i : i + 1]
        if any(not is_zero(component) for component in about):
            projection = np.multiply.outer(about, about)
            turn = (
                np.cos(coordinate) * (np.eye(3).astype(object) - projection)
                + projection
                + np.sin(coordinate) * _skew(about)
            )
            rotation = rotation @ turn
        joint_frames.append(
            Frame(rotation, tree.translation[i] + tree.rotation[i] @ (along * coordinate))
        )
    return joint_frames


def point_motions(
    tree: Bodies, poses: Sequence[Frame], v: np.ndarray, body: int, points: Sequence[np.ndarray]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return positions [m] and velocities [m/s] in the world of points of a body, shape (3,) each.

    Args:
        tree: The bodies.
        poses: Their frames.
        v: Rates of the coordinates, shape (n,).
        body: The row of the body.
        points: In the joint's frame [m], shape (3,) each.
    """
    zero = array([0.0] * 3)
    turn = array(np.eye(3).ravel().tolist()).reshape(3, 3)
    place = zero
    speed = zero
    spin = zero
    for i in tree.path(body):
        (along, about), rate, (rotation, origin) = tree.axis[i], v[i : i + 1], poses[i]
        arm = turn @ origin
        speed = speed + cross_product(spin, arm) + turn @ (tree.rotation[i] @ (along * rate))
        turn = turn @ rotation
        place = place + arm
        spin = spin + turn @ (about * rate)
    arms = [turn @ point for point in points]
    return [(place + arm, speed + cross_product(spin, arm)) for arm in arms]


def tree_inverse_dynamics(
    tree: Bodies,
    poses: Sequence[Frame],
    v: np.ndarray,
    a: np.ndarray | None = None,
    external_forces: Sequence[ExternalForce] = (),
    pulled: tuple[int, Any] | None = None,
) -> np.ndarray:
    """Return generalized forces that cause accelerations against gravity and pushes, as `pin.rnea`;
    damping is not counted.

    Args:
        tree: The bodies.
        poses: Their frames.
        v: Rates of the coordinates, shape (n,).
        a: Their accelerations, shape (n,); None for zero.
        external_forces: What pushes from outside.
        pulled: A body that slides along an axis of its frame, and the effort that acts on it there,
            which is what the others feel of it along the axis, whatever its acceleration.
    """
    return _newton_euler(tree, poses, v, a, external_forces, pulled)[0]


def transmitted(
    tree: Bodies,
    poses: Sequence[Frame],
    v: np.ndarray,
    a: np.ndarray,
    external_forces: Sequence[ExternalForce],
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return force and torque that each joint passes on to its body, in the frame of the joint,
    shape (3,) each; arguments as of `tree_inverse_dynamics`.
    """
    _, forces, torques = _newton_euler(tree, poses, v, a, external_forces)
    return list(zip(forces, torques, strict=True))


def _newton_euler(
    tree: Bodies,
    poses: Sequence[Frame],
    v: np.ndarray,
    a: np.ndarray | None,
    external_forces: Sequence[ExternalForce],
    pulled: tuple[int, Any] | None = None,
) -> tuple[np.ndarray, list[np.ndarray], list[np.ndarray]]:
    """Return generalized forces, and forces and torques on the bodies through their joints."""
    n = len(tree)
    zero = array([0.0] * 3)
    motions: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    forces, torques = [], []
    for i in range(n):
        (along, about), rate, (rotation, origin) = tree.axis[i], v[i : i + 1], poses[i]
        spin, turn, gain = (
            motions[tree.parents[i]] if tree.parents[i] >= 0 else (zero, zero, -tree.gravity)
        )
        sliding = 2.0 * (tree.rotation[i] @ (along * rate))
        gain = rotation.T @ (gain + _of_point(spin, turn, origin, sliding))
        spin, turn = rotation.T @ spin, rotation.T @ turn
        turn = turn + cross_product(spin, about * rate)
        spin = spin + about * rate
        if a is not None:
            gain, turn = gain + along * a[i : i + 1], turn + about * a[i : i + 1]
        motions.append((spin, turn, gain))
        inertia, lever = tree.inertia[i], tree.lever[i]
        force = tree.mass[i : i + 1] * (gain + _of_point(spin, turn, lever))
        unequal = inertia - np.diag(inertia[[2], [2]].repeat(3))
        forces.append(force)
        torques.append(
            inertia @ turn + cross_product(spin, unequal @ spin) + cross_product(lever, force)
        )
    for body_row, point, external in external_forces:
        local = into(tree, poses, body_row, external)
        forces[body_row] = forces[body_row] - local
        torques[body_row] = torques[body_row] - cross_product(point, local)
    effort = array([0.0] * n) if a is None else tree.armature * a
    for i in range(n - 1, -1, -1):
        effort[i] = effort[i] + tree.axis[i, 0] @ forces[i] + tree.axis[i, 1] @ torques[i]
        if pulled is not None and i == pulled[0]:
            sides = zip(tree.axis[i, 0], forces[i], strict=True)
            force = array(
                [f if is_zero(component) else component * pulled[1] for component, f in sides]
            )
            torques[i] = torques[i] + cross_product(tree.lever[i], force - forces[i])
            forces[i] = force
        if (parent := tree.parents[i]) >= 0:
            force, torque = _to_parent(poses[i], forces[i], torques[i])
            forces[parent], torques[parent] = forces[parent] + force, torques[parent] + torque
    return effort, forces, torques


def mass_matrix(tree: Bodies, poses: Sequence[Frame]) -> np.ndarray:
    """Return the mass matrix, as `pin.crba`, both triangles, shape (n, n)."""
    n = len(tree)
    composites = [
        _Body(tree.mass[i : i + 1], tree.mass[i : i + 1] * tree.lever[i], _about_origin(tree, i))
        for i in range(n)
    ]
    mass = np.empty((n, n), dtype=object)
    mass[:] = 0.0
    for i in range(n - 1, -1, -1):
        row = _exerted(tree, poses, i, *composites[i].times(*tree.axis[i]))
        row[i] = row[i] + tree.armature[i]
        mass[i, : i + 1] = mass[: i + 1, i] = row[: i + 1]
        if (parent := tree.parents[i]) >= 0:
            composites[parent] = composites[parent].plus(composites[i].seen_from_parent(poses[i]))
    return mass


def tree_forward_dynamics(
    tree: Bodies,
    poses: Sequence[Frame],
    v: np.ndarray,
    effort: np.ndarray,
    external_forces: Sequence[ExternalForce] = (),
) -> np.ndarray:
    """Return accelerations that generalized forces cause, as `pin.aba`.

    Of a load that hangs on nothing but its rope the others feel its mass across the rope, and along
    it the effort of the rope: what is left to solve has one unknown less, and nothing that cancels.

    Args:
        tree: The bodies.
        poses: Their frames.
        v: Rates of the coordinates, shape (n,).
        effort: Generalized forces, damping and springs among them, shape (n,).
        external_forces: What pushes from outside.
    """
    last = len(tree) - 1
    if not _is_sliding_point(tree, last):
        resisting = tree_inverse_dynamics(tree, poses, v, external_forces=external_forces)
        return solve_linear(mass_matrix(tree, poses), effort - resisting)
    resisting = tree_inverse_dynamics(
        tree, poses, v, external_forces=external_forces, pulled=(last, effort[last])
    )
    masses = tree.mass.copy()
    masses[last] = 0.0
    mass = mass_matrix(replace(tree, mass=masses), poses)[:last, :last]
    along = array([0.0] * last)
    for side, component in zip(np.eye(3), tree.axis[last, 0], strict=True):
        # What a unit force on the point exerts is how fast each coordinate moves it that way.
        unit = array(side.tolist())
        moved = _exerted(tree, poses, last, unit, cross_product(tree.lever[last], unit))[:last]
        if is_zero(component):
            mass = mass + np.multiply.outer(moved, moved) * tree.mass[last]
        else:
            along = component * moved
    free = effort - resisting
    a = solve_linear(mass, free[:last])
    return array([*a, free[last] / tree.mass[last] - along @ a])


def _is_sliding_point(tree: Bodies, i: int) -> bool:
    """Return whether a body has nothing but mass, and slides along an axis of its frame."""
    along, about = tree.axis[i]
    nothing = np.concatenate([about, tree.inertia[i].ravel(), tree.armature[[i]]])
    return (
        tree.parents[i] >= 0
        and all(map(is_zero, nothing))
        and all(isinstance(component, float) for component in along)
        and sorted(map(abs, along)) == [0.0, 0.0, 1.0]
        and not is_zero(tree.mass[i])
    )


def _exerted(
    tree: Bodies, poses: Sequence[Frame], body: int, force: np.ndarray, torque: np.ndarray
) -> np.ndarray:
    """Return the generalized force of a force and a torque on a body, shape (n,)."""
    effort = array([0.0] * len(tree))
    effort[body] = tree.axis[body, 0] @ force + tree.axis[body, 1] @ torque
    while (parent := tree.parents[body]) >= 0:
        force, torque = _to_parent(poses[body], force, torque)
        body = parent
        effort[body] = tree.axis[body, 0] @ force + tree.axis[body, 1] @ torque
    return effort


def angular_velocity(tree: Bodies, poses: Sequence[Frame], body: int, v: np.ndarray) -> np.ndarray:
    """Return the angular velocity of a body in the frame of its joint [rad/s], shape (3,)."""
    zero = array([0.0] * 3)
    axes = np.eye(3).tolist()
    return array([_exerted(tree, poses, body, zero, array(axis)) @ v for axis in axes])


def lost_digits(mass: np.ndarray) -> float:
    """Return the relative difference to expect between two solutions with a mass matrix: 1000
    roundings for each unit of its condition number.

    Args:
        mass: The matrix in numbers; it is scaled to a unit diagonal first.
    """
    root = np.sqrt(np.diag(mass))
    return float(1e3 * np.finfo(float).eps * np.linalg.cond(mass / root / root[:, None]))


def disagreement(computed: np.ndarray, expected: np.ndarray, mass: np.ndarray) -> float:
    """Return the largest difference of accelerations from expected ones over the largest of these;
    0 if it is round-off.

    Args:
        computed: One state or the same in each row, shape (n,) or (m, n).
        expected: By Pinocchio, shape (n,).
        mass: The mass matrix there, shape (n, n).
    """
    off = float(np.abs(computed - expected).max() / np.abs(expected).max())
    return 0.0 if off <= _AGREEMENT or off <= lost_digits(mass) else off


def potential_energy(tree: Bodies, poses: Sequence[Frame]) -> Any:
    """Return the potential energy in gravity [J], zero at the origin of the world."""
    fallen: list[tuple[np.ndarray, Any]] = []
    energy: Any = 0.0
    for i, (rotation, origin) in enumerate(poses):
        gravity, depth = fallen[tree.parents[i]] if tree.parents[i] >= 0 else (tree.gravity, 0.0)
        fallen.append((rotation.T @ gravity, depth + gravity @ origin))
        energy = energy - tree.mass[i] * (fallen[i][1] + fallen[i][0] @ tree.lever[i])
    return energy


def into(tree: Bodies, poses: Sequence[Frame], body: int, vector: np.ndarray) -> np.ndarray:
    """Return a vector of the world in the frame of a joint, shape (3,)."""
    for i in tree.path(body):
        vector = poses[i].rotation.T @ vector
    return vector


def _of_point(
    spin: np.ndarray, turn: np.ndarray, point: np.ndarray, sliding: np.ndarray | float = 0.0
) -> np.ndarray:
    """Return the acceleration of a point beyond that of the origin, in a frame that spins at a rate
    and turns up at an acceleration; sliding is twice the rate at which the point moves in it.
    """
    return cross_product(turn, point) + cross_product(spin, cross_product(spin, point) + sliding)


class _Body(NamedTuple):
    """Mass, shape (1,), first moment and inertia about the origin of a frame."""

    mass: np.ndarray
    first: np.ndarray
    second: np.ndarray

    def times(self, linear: np.ndarray, angular: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the momentum of a velocity, or the force of an acceleration."""
        return self.mass * linear + cross_product(angular, self.first), cross_product(
            self.first, linear
        ) + self.second @ angular

    def plus(self, body: _Body) -> _Body:
        return _Body(self.mass + body.mass, self.first + body.first, self.second + body.second)

    def seen_from_parent(self, frame: Frame) -> _Body:
        first = frame.rotation @ self.first
        arm = _skew(frame.origin)
        mixed = arm @ _skew(first)
        # the part that is the same about every axis is the same in every frame
        same = np.diag(self.second[[0], [0]].repeat(3))
        second = (
            frame.rotation @ (self.second - same) @ frame.rotation.T
            + same
            - mixed
            - mixed.T
            - arm @ arm * self.mass
        )
        second[[1, 2, 2], [0, 0, 1]] = second[[0, 0, 1], [1, 2, 2]]
        return _Body(self.mass, first + self.mass * frame.origin, second)


def _about_origin(tree: Bodies, i: int) -> np.ndarray:
    arm = _skew(tree.lever[i])
    return tree.inertia[i] - arm @ arm * tree.mass[i : i + 1]


def _to_parent(
    frame: Frame, force: np.ndarray, torque: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    turned = frame.rotation @ force
    return turned, frame.rotation @ torque + cross_product(frame.origin, turned)


def _skew(a: np.ndarray) -> np.ndarray:
    return array([0.0, -a[2], a[1], a[2], 0.0, -a[0], -a[1], a[0], 0.0]).reshape(3, 3)
