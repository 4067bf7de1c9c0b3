"""Pinocchio's inverse dynamics on CasADi symbols, so that an optimiser gets exact derivatives; the
model stays the only source.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from cranedyn.dynamics.bodies import bodies
from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.dynamics.scalars import array
from cranedyn.errors import CraneError, ModelError
from cranedyn.model.crane import Crane
from cranedyn.plant import rigid_body

try:
    import casadi as ca
except ModuleNotFoundError as error:
    raise CraneError(
        "Optimal moves need CasADi, which is not installed: pip install 'cranedyn[optimal]'."
    ) from error


def rnea(model: pin.Model, q: ca.SX, v: ca.SX, a: ca.SX) -> ca.SX:
    """Return generalized forces that cause accelerations, as `pin.rnea`: damping and friction not
    counted, gravity and armature counted.

    Args:
        model: A model whose joints are revolute, prismatic or helical, with one coordinate each.
        q: Coordinates [rad or m], shape (n,).
        v: Their rates, shape (n,).
        a: Their accelerations, shape (n,).

    Returns:
        Torques [N m] or forces [N], shape (n,).

    Raises:
        ModelError: If a joint has more than one degree of freedom or, as one that turns without
            limits, more than one coordinate.
    """
    tree = bodies(model)
    if model.nq != model.nv:
        raise ModelError(
            f"{model.name} has {model.nq} coordinates for {model.nv} rates; to be made symbols it "
            "needs one for each."
        )
    tree = tree.with_numbers(tree.numbers().tolist())
    angles, rates, accelerations = (array(ca.vertsplit(ca.densify(column))) for column in (q, v, a))
    return ca.vertcat(
        *rigid_body.tree_inverse_dynamics(
            tree, rigid_body.frames(tree, angles), rates, accelerations
        )
    )


def hybrid_dynamics(
    crane: Crane, q: ca.SX, v: ca.SX, drive_acceleration: ca.SX
) -> tuple[ca.SX, ca.SX]:
    """Return accelerations of all joints when those of the drives are given, and the drive efforts
    that this costs.

    The same as `cranedyn.dynamics.pinocchio.prescribed_acceleration`, on symbols: shapes (n,),
    (n,), (m,) to (n,) and (m,).
    """
    drives, passive = crane.layout.drives.tolist(), crane.layout.passive.tolist()
    a, free = ca.SX(crane.layout.n, 1), ca.SX.sym("free", len(passive))
    a[drives], a[passive] = drive_acceleration, free
    angles, rates = (array(ca.vertsplit(ca.densify(column))) for column in (q, v))
    force = rnea(crane.model, q, v, a) - ca.vertcat(*JointForces.of(crane).effort(angles, rates))
    mass, force = ca.jacobian(force, free), ca.substitute(force, free, np.zeros(len(passive)))
    solved = -ca.solve(mass[passive, :], force[passive])
    a[passive] = solved
    return a, (force + mass @ solved)[drives]
