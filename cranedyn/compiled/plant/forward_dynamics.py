"""Accelerations of a tree of bodies under generalized forces, in any kind of numbers, see
`cranedyn.compiled.plant.rigid_body`.

In general they are the solution of the equations of all joints with the mass matrix of the tree.
Where a load hangs from a rope, as on nearly every crane, most terms of these equations drop out of
their solution, and are not computed. Two kinds of joints make that possible:

* The last body is the *load*: a point of mass m that slides along the rope.
* Between the rope and the rest there may be *hinges*, such as the two joints of the pendulum at the
  pivot of a rope: revolute joints whose bodies have inertia but no mass, each of which moves the
  load in one direction across the rope, a direction of its own, and shares no inertia with another
  joint. All other joints are said to be *before* the hinges.

There are three observations.

1. Along the rope the others feel the load only by the pull T of the rope, whatever the acceleration
   of the load. T is the effort of the rope less what forces from outside take of it, and is known.
2. About its axis u a hinge transmits nothing but its effort. We are free to choose unknowns: for a
   hinge we take the angular acceleration w = α·u of its body against the world, and not that of the
   joint against the body before it. Written with w, the joints before the hinge do not turn its
   body about u, and its inertia about u is in no equation but that of the hinge. The acceleration
   of the joint follows from w at the end.
3. Take one direction across the rope. There the load accelerates by A + J a + j w. A is the part
   that depends on no acceleration, gravity included; a are the accelerations of the joints before
   the hinges; and j is the lever about the one hinge that moves the load in this direction. With
   the inertia d of the hinge's body about its axis, and the effort h of the hinge less what forces
   from outside and gyroscopic torques take of it,

       d w + m j (A + J a + j w) = h,     so that     w = h/D - (m j/D) (A + J a),  D = d + m j².

   The force on the load in this direction is then

       m (A + J a + j w) = s (A + J a) + (m j/D) h,     s = m d/D.

   So the joints before the hinges feel the share s of the mass only, which is small where the load
   has most of the inertia about the hinge, and a push p = s A + (m j/D) h, which is known.

What is left to solve are the equations of the joints before the hinges, with a sum over both
directions. M' is the mass matrix of the tree without the load, b are the efforts of these joints
less what forces and velocities take of them there, and E is the velocity of the load along the rope
per rate of each of these joints:

    (M' + Σ s Jᵀ J) a = b - Σ p Jᵀ - T Eᵀ.

In a direction in which no hinge moves the load, s = m and p = m A. Without hinges the equations are
those of all joints but the rope.

The share s is computed as a product. Eliminating the hinges from the general equations would find
it as the difference m - m² j²/D of two large numbers, and lose digits. Of the five joints of a
tower crane two are left to solve for, slew and trolley.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from cranedyn.compiled.plant.rigid_body import (
    ExternalForce,
    Frame,
    generalized_force,
    mass_matrix,
    newton_euler,
    relative_acceleration,
    tree_inverse_dynamics,
)
from cranedyn.dynamics.bodies import Bodies
from cranedyn.dynamics.root_motion import RootMotion
from cranedyn.dynamics.scalars import array, common_factor, cross_product, is_zero, solve_linear


def tree_forward_dynamics(
    tree: Bodies,
    poses: Sequence[Frame],
    v: np.ndarray,
    effort: np.ndarray,
    external_forces: Sequence[ExternalForce] = (),
    root: RootMotion | None = None,
) -> np.ndarray:
    """Return the accelerations that generalized forces cause, as `pin.aba` does, see the module.

    Args:
        tree: The bodies.
        poses: Their frames.
        v: Rates of the coordinates, shape (n,).
        effort: Generalized forces, damping and springs among them, shape (n,).
        external_forces: Forces from outside.
        root: Motion of the frame in which the tree stands; None for one at rest.
    """
    last = len(tree) - 1
    if not is_sliding_point(tree, last):
        resisting = tree_inverse_dynamics(
            tree, poses, v, external_forces=external_forces, root=root
        )
        return solve_linear(mass_matrix(tree, poses), effort - resisting)

    masses = tree.mass.copy()
    masses[last] = 0.0
    without_load = replace(tree, mass=masses)
    hanging = _hanging(without_load, poses)
    hinges = {i: effort[i] for i in hanging.hinge_in.values()}
    # Without acceleration of the joints before the hinges, and of the hinges against the world.
    resisting_motion = newton_euler(without_load, poses, v, None, external_forces, root, hinges)
    unbalanced = effort - resisting_motion.efforts
    motion = resisting_motion.motions[last]
    bias = motion.acceleration + relative_acceleration(motion.omega, motion.alpha, tree.lever[last])

    # The joints before the hinges.
    before = [i for i in range(last) if i not in hinges]
    load = tree.mass[last]
    rope = hanging.rope
    pull = unbalanced[last] * tree.axis[last, 0, rope]
    mass = hanging.mass[np.ix_(before, before)]
    right = unbalanced[before] - hanging.jacobian[rope][before] * array([pull])
    shares = {}
    # A row of the Jacobian as a factor of all its entries, and what is left of them.
    factored = {}
    for k in hanging.across:
        shares[k] = _across_rope(hanging, k, load, bias[k], unbalanced)
        factor, rest = factored[k] = common_factor(hanging.jacobian[k][before])
        mass = mass + np.multiply.outer(rest * array([shares[k].mass * (factor * factor)]), rest)
        right = right - rest * array([factor * shares[k].push])
    solved = solve_linear(mass, right)

    # The hinges, against the world, and the rope.
    a = array([0.0] * len(tree))
    for i, acceleration in zip(before, solved, strict=True):
        a[i] = acceleration
    for k, i in hanging.hinge_in.items():
        factor, rest = factored[k]
        given = bias[k] + factor * (rest @ solved)
        a[i] = shares[k].inverse * unbalanced[i] - shares[k].ratio * given
    others = bias[rope] + hanging.jacobian[rope][:last] @ a[:last]
    a[last] = (pull / load - others) * tree.axis[last, 0, rope]

    # The hinges against the bodies before them.
    of_joints = a.copy()
    for i in hinges:
        axis = tree.rotation[i] @ tree.axis[i, 1]
        no_force = array([0.0] * 3)
        # The generalized force of a unit torque is also the angular acceleration about its axis per
        # acceleration of each coordinate.
        turning = generalized_force(tree, poses, tree.parents[i], no_force, axis, hinges)
        of_joints[i] = a[i] - turning @ a - resisting_motion.drifts[i]
    return of_joints


def is_sliding_point(tree: Bodies, i: int) -> bool:
    """Return whether a body has nothing but mass, and slides along an axis of its frame."""
    along, about = tree.axis[i]
    must_be_zero = np.concatenate([about, tree.inertia[i].ravel(), tree.armature[[i]]])
    return (
        tree.parents[i] >= 0
        and all(is_zero(number) for number in must_be_zero)
        and _is_axis_of_frame(along)
        and not is_zero(tree.mass[i])
    )


def _is_axis_of_frame(vector: np.ndarray) -> bool:
    """Return whether a vector is known to be a unit vector along an axis of its frame."""
    return all(isinstance(component, float) for component in vector) and sorted(
        abs(component) for component in vector
    ) == [0.0, 0.0, 1.0]


class _Hanging(NamedTuple):
    """How a load hangs.

    Attributes:
        rope: Axis of the frame of the load along which it slides, 0 to 2.
        across: The other two.
        jacobian: Velocity of the load along each axis of its frame per rate of each coordinate,
            that of a hinge against the world, shape (3, n).
        hinge_in: The hinge that moves the load in a direction across the rope, by that axis.
        mass: Mass matrix without the load for the same rates, shape (n, n).
    """

    rope: int
    across: list[int]
    jacobian: list[np.ndarray]
    hinge_in: dict[int, int]
    mass: np.ndarray


def _hanging(tree: Bodies, poses: Sequence[Frame]) -> _Hanging:
    """Return how the last body hangs, which is a sliding point.

    There are hinges only if each moves the load in one direction, which is across the rope and
    another one for each, and shares no inertia with any other joint.

    Args:
        tree: The bodies, without the mass of the last one.
        poses: Their frames.
    """
    hinges = _free_hinges(tree)
    hanging = _hanging_from(tree, poses, hinges)
    in_directions = list(hanging.hinge_in.values())
    is_coupled = False
    for i in hinges:
        coupled = np.delete(hanging.mass[i], i)
        is_coupled |= not all(is_zero(number) for number in coupled)
        moved = [k for k in range(3) if not is_zero(hanging.jacobian[k][i])]
        # One that also moves a load along the rope, such as one that hangs aside of it, feels the
        # rope, too.
        is_coupled |= len(moved) != 1 or moved[0] == hanging.rope
    if is_coupled or sorted(in_directions) != sorted(hinges):
        return _hanging_from(tree, poses, [])
    return hanging


def _free_hinges(tree: Bodies) -> list[int]:
    """Return the revolute joints next to the rope whose bodies have no mass, so that none of them
    has a first moment about its joint.

    A hinge needs a body before it, which `tree_forward_dynamics` asks for its motion, and no
    armature, which would feel the motion against that body.
    """
    hinges: list[int] = []
    child = len(tree) - 1
    i = tree.parents[child]
    while i >= 0:
        along, about = tree.axis[i]
        children = [j for j, parent in enumerate(tree.parents) if parent == i]
        must_be_zero = [*along, tree.mass[i], tree.armature[i]]
        is_hinge = (
            children == [child]
            and tree.parents[i] >= 0
            and all(is_zero(number) for number in must_be_zero)
            and _is_axis_of_frame(about)
        )
        if not is_hinge:
            break
        hinges.append(i)
        child = i
        i = tree.parents[i]
    return hinges


def _hanging_from(tree: Bodies, poses: Sequence[Frame], hinges: Sequence[int]) -> _Hanging:
    """Return how the last body hangs if these joints are hinges."""
    last = len(tree) - 1
    jacobian = []
    for axis in np.eye(3):
        # The generalized force of a unit force on the point is also the velocity of the point along
        # that force per rate of each coordinate.
        unit = array(axis.tolist())
        torque = cross_product(tree.lever[last], unit)
        jacobian.append(generalized_force(tree, poses, last, unit, torque, hinges))
    rope = int(np.argmax(np.abs(tree.axis[last, 0].astype(float))))
    across = [k for k in range(3) if k != rope]
    hinge_in = {}
    for k in across:
        for i in hinges:
            if not is_zero(jacobian[k][i]):
                hinge_in[k] = i
    return _Hanging(rope, across, jacobian, hinge_in, mass_matrix(tree, poses, hinges))


class _Share(NamedTuple):
    """What the joints before the hinges feel of the load in a direction across the rope, see the
    module.

    Attributes:
        mass: The share s of the mass.
        push: The push p.
        inverse: 1/D; without a hinge it is not used.
        ratio: m j/D; without a hinge it is not used.
    """

    mass: Any
    push: Any
    inverse: Any = 0.0
    ratio: Any = 0.0


def _across_rope(hanging: _Hanging, k: int, load: Any, bias: Any, unbalanced: np.ndarray) -> _Share:
    """Return what is felt of the load in a direction across the rope.

    Args:
        hanging: How the load hangs.
        k: The direction, an axis of the frame of the load.
        load: Mass of the load.
        bias: Its acceleration in this direction without those of the coordinates.
        unbalanced: Efforts that are left for accelerations, shape (n,).
    """
    if k not in hanging.hinge_in:
        return _Share(load, load * bias)
    i = hanging.hinge_in[k]
    lever = hanging.jacobian[k][i]
    inertia = hanging.mass[i, i]
    inverse = 1.0 / (inertia + load * (lever * lever))
    ratio = load * (lever * inverse)
    mass = load * (inertia * inverse)
    return _Share(mass, mass * bias + ratio * unbalanced[i], inverse, ratio)
