"""Crane model over a horizon, in code: the traced equations of motion and their derivatives.

The inputs are the accelerations of the drives, held over a stage; the efforts that they need are
linear functions, used for effort limits and the tension of the rope. Several stages are linearised
at once, one in each lane. A stage is integrated by the exponential of its own linearisation, to
fourth order in its length: exact for small motions (Hochbruck and Ostermann 2010, "Exponential
integrators", §2.4).

Conventions: n coordinates, m drives; z = (coordinates, rates, inputs) of length 2 n + m.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir

from cranedyn.compiled.code import Value
from cranedyn.compiled.horizon.dual import constants, slopes, variables
from cranedyn.compiled.horizon.memory import HorizonShape, Work
from cranedyn.compiled.plant import rigid_body
from cranedyn.compiled.plant.plant import Plant
from cranedyn.dynamics.scalars import array, is_zero, solve_linear

_ORDER = 4
"""Power of the length of a stage to which its exponential is computed."""

Entries = list[tuple[str, int, int, Any]]
"""Numbers of a stage for `HorizonShape.stage_rows`: name of the quantity, its row, place in it, and
value. A value that is a float is the same in every stage, and folds in the code; the others are
stored for each stage."""


class CraneDerivatives(NamedTuple):
    """Accelerations and efforts of a crane at a state, and their derivatives.

    Attributes:
        acceleration: Accelerations of all joints, shape (n,).
        effort: Efforts of the drives, shape (m,).
        acceleration_slopes: Derivatives of the accelerations by coordinates, rates and inputs,
            shape (n, 2 n + m).
        effort_slopes: Derivatives of the efforts by the same, shape (m, 2 n + m).
    """

    acceleration: np.ndarray
    effort: np.ndarray
    acceleration_slopes: np.ndarray
    effort_slopes: np.ndarray


def crane_derivatives(
    plant: Plant, q: np.ndarray, v: np.ndarray, u: np.ndarray
) -> CraneDerivatives:
    """Linearise a crane under accelerations of its drives, in any kind of number.

    The equations of motion f(q, v, a) = (efforts of the drives, 0) hold along with a_d = u for the
    drives. Differentiation with M = ∂f/∂a gives, for the passive joints p and any variable,

        M_pp da_p = -(∂f_p + M_pd du),    d efforts = ∂f_d + M_dd du + M_dp da_p,

    where ∂f is the derivative of f by coordinates and rates at constant a. That takes the solution
    of equations for the passive joints only. Dry friction is in the accelerations and efforts, but
    not in their derivatives, see `cranedyn.dynamics.joint_forces.JointForces.without_dry_friction`.

    Args:
        plant: Model of the crane, commanded by accelerations.
        q: Coordinates, shape (n,).
        v: Rates, shape (n,).
        u: Accelerations of the drives, shape (m,).
    """
    layout = plant.topology.layout
    n = layout.n
    m = layout.m
    drives = layout.drives
    passive = layout.passive
    dynamics = plant.forward_dynamics(q, v, u, None)
    a = dynamics.acceleration
    effort = dynamics.effort

    q_dual, v_dual = variables(q, v)
    frames = rigid_body.frames(plant.tree, q_dual)
    a_dual = constants(a, 2 * n)
    inertial = rigid_body.tree_inverse_dynamics(plant.tree, frames, v_dual, a_dual)
    forces = inertial - plant.joint.without_dry_friction().effort(q_dual, v_dual)
    mass = rigid_body.mass_matrix(plant.tree, rigid_body.frames(plant.tree, q))
    force_derivatives = np.zeros((n, 2 * n + m), dtype=object)
    force_derivatives[:, : 2 * n] = slopes(forces, 2 * n)
    force_derivatives[:, 2 * n :] = mass[:, drives]

    # An array of objects holds zeros that are ints; the code folds those that are floats.
    acceleration_slopes = np.zeros((n, 2 * n + m), dtype=object)
    acceleration_slopes[:] = 0.0
    acceleration_slopes[drives, range(2 * n, 2 * n + m)] = 1.0
    passive_mass = mass[np.ix_(passive, passive)]
    for j in range(2 * n + m):
        passive_forces = force_derivatives[passive, j]
        # Nothing is solved for a variable on which the passive joints do not depend.
        if not all(is_zero(x) for x in passive_forces):
            acceleration_slopes[passive, j] = solve_linear(passive_mass, -passive_forces)
    effort_slopes = (
        force_derivatives[drives] + mass[np.ix_(drives, passive)] @ acceleration_slopes[passive]
    )
    return CraneDerivatives(a, effort, acceleration_slopes, effort_slopes)


def hanging(plant: Plant, drives: np.ndarray) -> np.ndarray:
    """Return coordinates at rest for positions of the drives, shape (n,), in any kind of number.

    The swing joints follow by a step of Newton's method from the rest to first order, which is that
    of the start of the crane and of small motions of its drives.

    Args:
        plant: Model of the crane.
        drives: Positions of the drives, shape (m,).
    """
    layout = plant.topology.layout
    swings = [i for i, _ in plant.topology.swings]
    at_rest = array([0.0] * layout.n)
    q = at_rest.copy()
    q[layout.drives] = drives
    if plant.plumb_at_zero:
        return q
    q[swings] = plant.hanging_angles(drives)
    (q_dual,) = variables(q)
    frames = rigid_body.frames(plant.tree, q_dual)
    no_acceleration = constants(at_rest, layout.n)
    forces = rigid_body.tree_inverse_dynamics(plant.tree, frames, at_rest, no_acceleration)
    stiffness = slopes(forces[swings], layout.n)[:, swings]
    pull = array([force.value for force in forces[swings]])
    q[swings] = q[swings] - solve_linear(stiffness, pull)
    return q


def stage_model(
    plant: Plant, length: float, q: np.ndarray, v: np.ndarray, u: np.ndarray
) -> Entries:
    """Return the model of a stage, linearised about a node: `forward`, `shift`, `extra` and
    `extra_shift`, see `HorizonShape.stage`.

    Args:
        plant: Model of the crane, commanded by accelerations.
        length: Length of the stage [s].
        q: Coordinates of the node, shape (n,).
        v: Rates of the node, shape (n,).
        u: Inputs of the node, shape (m,).
    """
    layout = plant.topology.layout
    n = layout.n
    m = layout.m
    states = 2 * n
    variable_count = 2 * n + m
    derivatives = crane_derivatives(plant, q, v, u)
    node = np.concatenate([q, v, u])
    next_state = _state_after_stage(derivatives, length, node)

    # Written for z itself and not for its difference from the node: the shift takes the node.
    entries: Entries = []
    for i in range(states):
        for j in range(variable_count):
            entries.append(("forward", i, j, next_state[i, j]))
    for i in range(states):
        entries.append(
            ("shift", 0, i, next_state[i, variable_count] - next_state[i, :variable_count] @ node)
        )
    for i in range(m):
        for j in range(variable_count):
            entries.append(("extra", i, j, derivatives.effort_slopes[i, j]))
    for i in range(m):
        shift = derivatives.effort[i] - derivatives.effort_slopes[i] @ node
        entries.append(("extra_shift", 0, variable_count + i, shift))
    return entries


def _state_after_stage(
    derivatives: CraneDerivatives, length: float, node: np.ndarray
) -> np.ndarray:
    """Return the state at the end of a stage as a linear function, shape (2 n, 2 n + m + 1): its
    derivatives by the difference of z from the node, and in the last column its value for the node.

    It is the Taylor series of the linear motion, x + Σ hᵏ/k! dᵏx/dtᵏ, up to the power `_ORDER`. The
    time derivatives are linear functions of the same form: the first are the rates and the
    accelerations, and with constant inputs each further one follows from the one before by
    d(rates) = accelerations and d(accelerations) = ∂a/∂q rates + ∂a/∂v accelerations.

    Args:
        derivatives: The crane at the node.
        length: Length of the stage, h [s].
        node: Coordinates, rates and inputs of the node, shape (2 n + m,).
    """
    n, variable_count = derivatives.acceleration_slopes.shape
    states = 2 * n
    of_rates = np.zeros((n, variable_count + 1), dtype=object)
    of_rates[:] = 0.0
    of_rates[range(n), range(n, states)] = 1.0
    of_rates[:, variable_count] = node[n:states]
    of_accelerations = np.hstack(
        [derivatives.acceleration_slopes, derivatives.acceleration[:, None]]
    )
    state = np.zeros((states, variable_count + 1), dtype=object)
    state[:] = 0.0
    state[range(states), range(states)] = 1.0
    state[:, variable_count] = node[:states]

    by_q = derivatives.acceleration_slopes[:, :n]
    by_v = derivatives.acceleration_slopes[:, n:states]
    factor = 1.0
    for order in range(1, _ORDER + 1):
        factor *= length / order
        state = state + factor * np.vstack([of_rates, of_accelerations])
        of_jerks = by_q @ of_rates + by_v @ of_accelerations
        of_rates = of_accelerations
        of_accelerations = of_jerks
    return state


def payload_jacobian(plant: Plant, q: np.ndarray) -> np.ndarray:
    """Return the derivatives of the payload's position in the world by the coordinates, shape (3,
    n).
    """
    tree = plant.tree
    body = plant.topology.bodies[0]
    (q_dual,) = variables(q)
    frames = rigid_body.frames(tree, q_dual)
    point = plant.levers[0]
    # From the frame of the payload down the chain to the world.
    while body >= 0:
        point = frames[body].origin + frames[body].rotation @ point
        body = tree.parents[body]
    return slopes(point, len(q))


def emit_weights(
    module: ir.Module,
    shape: HorizonShape,
    plant: Plant,
    errors: np.ndarray,
    payload_errors: np.ndarray,
) -> None:
    """Add the function `weigh`, which stores the weight of the states for a goal.

    With the Jacobian J of the payload's position at the goal, the weight of the coordinates is
    Jᵀ J / e² + diag(1 / errors²), where e is the error of the payload; that of the rates likewise.

    Args:
        module: Module to which it is added.
        shape: Dimensions of the programme.
        plant: Model of the crane.
        errors: Errors of the coordinates and of the rates with equal weight, shape (2, n).
        payload_errors: Errors of the payload's position [m] and velocity [m/s] with that weight,
            shape (2,).
    """
    work = Work(module, "weigh", shape)
    n = plant.topology.layout.n
    jacobian = payload_jacobian(plant, work.shared.row("goal", n))
    for block, error in enumerate(payload_errors.tolist()):
        for i in range(n):
            for j in range(n):
                weight: Any = error**-2.0 * (jacobian[:, i] @ jacobian[:, j])
                if i == j:
                    weight = weight + float(errors[block, i]) ** -2.0
                work.shared.put("weight", weight, block * n + i, block * n + j)
    work.code.end()


def emit(module: ir.Module, shape: HorizonShape, plant: Plant, length: float) -> Entries:
    """Add the function `linearise`, from the nodes of all stages to their models.

    Args:
        module: Module to which it is added.
        shape: Dimensions of the programme.
        plant: Model of the crane, commanded by accelerations.
        length: Length of a stage [s].

    Returns:
        The numbers that are the same for every node, as floats; the code does not store them.
    """
    work = Work(module, "linearise", shape)
    code = work.code
    n = plant.topology.layout.n
    states = shape.states
    together = shape.vector_lanes // shape.cranes  # stages that are computed at once
    groups = -(-shape.stages // together)  # rounded up
    last = code.integer(shape.stages - 1)
    with code.loop(0, groups) as group:
        first = code.product(group, together)
        # Lanes beyond the last stage compute that once more.
        stages = [work.stage(code.least(code.plus(first, i), last)) for i in range(together)]
        nodes = [rows.row("node", shape.variables) for rows in stages]
        node = array([work.join_lanes(values) for values in zip(*nodes, strict=True)])
        entries = stage_model(plant, length, node[:n], node[n:states], node[states:])
        for name, row, place, value in entries:
            if isinstance(value, Value):
                for rows, number in zip(stages, work.split_lanes(value), strict=True):
                    rows.put(name, number, row, place)
    code.end()

    same_in_every_stage: Entries = []
    for name, row, place, value in entries:
        if not isinstance(value, Value):
            same_in_every_stage.append((name, row, place, float(value)))
    return same_in_every_stage
