"""Pinocchio's inverse dynamics on CasADi symbols, so that an optimiser gets exact derivatives; the model stays the only source."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from cranedyn.crane import DRIVES, PASSIVE, Crane
from cranedyn.errors import CraneError, ModelError

try:
    import casadi as ca
except ModuleNotFoundError as error:
    raise CraneError("Optimal moves need CasADi, which is not installed: pip install 'cranedyn[optimal]'.") from error


def rnea(model: pin.Model, q: ca.SX, v: ca.SX, a: ca.SX) -> ca.SX:
    """Generalized forces that cause accelerations, as `pin.rnea`: damping and friction not counted, gravity and armature counted.

    Recursive Newton-Euler in the frames of the joints (Featherstone, Rigid Body Dynamics Algorithms, §5.3). Spatial vectors stack
    the linear over the angular part, as Pinocchio's do.

    Args:
        model: A model whose joints are revolute or prismatic, with one coordinate each.
        q: Coordinates [rad or m], shape (n,).
        v: Their rates, shape (n,).
        a: Their accelerations, shape (n,).

    Returns:
        Torques [N m] or forces [N], shape (n,).

    Raises:
        ModelError: If a joint has more than one coordinate.
    """
    velocities, accelerations, forces = [ca.SX(6, 1)], [ca.SX(-model.gravity.vector)], [ca.SX(6, 1)]
    axes, to_child = [ca.DM(6, 1)], [ca.SX(6, 6)]
    for i in range(1, model.njoints):
        k, parent, inertia = _coordinate(model, i), model.parents[i], ca.DM(model.inertias[i].matrix())
        axis = _axis(model, i)
        turn = _to_child(model.jointPlacements[i], axis, q[k])
        velocity = turn @ velocities[parent] + axis * v[k]
        acceleration = turn @ accelerations[parent] + axis * a[k] + _cross(velocity) @ axis * v[k]
        axes.append(axis)
        to_child.append(turn)
        velocities.append(velocity)
        accelerations.append(acceleration)
        forces.append(inertia @ acceleration - _cross(velocity).T @ (inertia @ velocity))
    effort = ca.DM(model.armature) * a
    for i in range(model.njoints - 1, 0, -1):
        effort[_coordinate(model, i)] += ca.dot(axes[i], forces[i])
        forces[model.parents[i]] += to_child[i].T @ forces[i]
    return effort


def _coordinate(model: pin.Model, joint: int) -> int:
    if model.joints[joint].nq != 1 or model.joints[joint].nv != 1:
        raise ModelError(f"{model.names[joint]} is a {model.joints[joint].shortname()}; only joints of one coordinate can be made symbols.")
    return model.joints[joint].idx_v


def _axis(model: pin.Model, joint: int) -> ca.DM:
    """Velocity of the joint per unit of its rate, in its own frame, shape (6,)."""
    at = model.joints[joint].createData()
    model.joints[joint].calc(at, pin.neutral(model))
    return ca.sparsify(ca.DM(at.S))


def _to_child(placement: pin.SE3, axis: ca.DM, q: ca.SX) -> ca.SX:
    """Matrix that turns velocities from the parent's frame to the joint's; its transpose turns forces back, shape (6, 6)."""
    spin = ca.skew(axis[3:])
    rotation = ca.DM(placement.rotation) @ (ca.DM.eye(3) + ca.sin(q) * spin + (1 - ca.cos(q)) * (spin @ spin))
    position = ca.DM(placement.translation) + ca.DM(placement.rotation) @ axis[:3] * q
    return ca.blockcat([[rotation.T, -rotation.T @ ca.skew(position)], [ca.SX(3, 3), rotation.T]])


def _cross(velocity: ca.SX) -> ca.SX:
    """Matrix of the cross product of a velocity with another; minus its transpose is that with a force, shape (6, 6)."""
    linear, angular = ca.skew(velocity[:3]), ca.skew(velocity[3:])
    return ca.blockcat([[angular, linear], [ca.SX(3, 3), angular]])


def prescribed_acceleration(crane: Crane, q: ca.SX, v: ca.SX, drive_acceleration: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Accelerations of all five joints when those of the drives are given, and the drive efforts that this costs.

    The same as `cranedyn.dynamics.prescribed_acceleration`, on symbols: shapes (5,), (5,), (3,) to (5,) and (3,).
    """
    drives, passive = DRIVES.tolist(), PASSIVE.tolist()
    a, swing = ca.SX(5, 1), ca.SX.sym("swing", 2)
    a[drives], a[passive] = drive_acceleration, swing
    force = rnea(crane.model, q, v, a) + crane.damping * v
    mass, force = ca.jacobian(force, swing), ca.substitute(force, swing, np.zeros(2))
    solved = -ca.solve(mass[passive, :], force[passive])
    a[passive] = solved
    return a, (force + mass @ solved)[drives]
