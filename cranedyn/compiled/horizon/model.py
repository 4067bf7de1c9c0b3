"""Crane model over a horizon, in code: the traced equations of motion and their derivatives.

The inputs are the accelerations of the drives, held over a stage; the efforts that they need are
linear functions, used for effort limits and the tension of the rope. Several stages are linearised
at once, one in each lane. A stage is integrated by the exponential of its own linearisation, to
fourth order in its length: exact for small motions (Hochbruck and Ostermann 2010, "Exponential
integrators", §2.4).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir

from cranedyn.compiled.code import Value
from cranedyn.compiled.horizon.dual import constants, slopes, variables
from cranedyn.compiled.horizon.memory import HorizonShape, Work
from cranedyn.dynamics.scalars import array, is_zero, solve_linear
from cranedyn.plant import rigid_body
from cranedyn.plant.plant import Plant

_ORDER = 4

Entries = list[tuple[str, int, int, Any]]
"""Entries of a stage: name of the row, its number, lane, value."""


class CraneDerivatives(NamedTuple):
    """Accelerations and efforts of a crane at a state, and their derivatives.

    Attributes:
        a: Accelerations, shape (n,).
        effort: Efforts of the drives, shape (m,).
        rates: Derivatives of the accelerations by coordinates, rates and inputs, shape (n, 2 n +
            m).
        efforts: Derivatives of the efforts by the same, shape (m, 2 n + m).
    """

    a: np.ndarray
    effort: np.ndarray
    rates: np.ndarray
    efforts: np.ndarray


def crane_derivatives(
    plant: Plant, q: np.ndarray, v: np.ndarray, u: np.ndarray
) -> CraneDerivatives:
    """Linearise a crane under accelerations of its drives, in any kind of number."""
    layout = plant.topology.layout
    n, m, drives, passive = layout.n, layout.m, layout.drives, layout.passive
    a, effort = plant.answer(q, v, u, None)[:2]
    q_dual, moving = variables(q, v)
    placements = rigid_body.frames(plant.tree, q_dual)
    forces = rigid_body.tree_inverse_dynamics(
        plant.tree, placements, moving, constants(a, 2 * n)
    ) - plant.joint.effort(q_dual, moving)
    by_state = slopes(forces, 2 * n)
    mass = rigid_body.mass_matrix(plant.tree, rigid_body.frames(plant.tree, q))
    by_all = np.zeros((n, 2 * n + m), dtype=object)
    by_all[:, : 2 * n], by_all[:, 2 * n :] = by_state, mass[:, drives]
    rates = np.zeros((n, 2 * n + m), dtype=object)
    rates[:] = 0.0
    rates[drives, range(2 * n, 2 * n + m)] = 1.0
    block = mass[np.ix_(passive, passive)]
    for j in range(2 * n + m):
        if any(not is_zero(x) for x in by_all[passive, j]):
            rates[passive, j] = solve_linear(block, -by_all[passive, j])
    efforts = by_all[drives] + mass[np.ix_(drives, passive)] @ rates[passive]
    return CraneDerivatives(a, effort, rates, efforts)


def hanging(plant: Plant, drives: np.ndarray) -> np.ndarray:
    """Return coordinates at rest for positions of the drives, shape (n,), in any kind of number:
    the swing joints by a step of Newton's method from the first-order rest.
    """
    layout = plant.topology.layout
    swings = [i for i, _ in plant.topology.swings]
    still = array([0.0] * layout.n)
    q = still.copy()
    q[layout.drives] = drives
    if plant.plumb_at_zero:
        return q
    q[swings] = plant.hanging_angles(drives)
    (q_dual,) = variables(q)
    forces = rigid_body.tree_inverse_dynamics(
        plant.tree, rigid_body.frames(plant.tree, q_dual), still, constants(still, layout.n)
    )
    stiffness = slopes(forces[swings], layout.n)[:, swings]
    pull = array([force.value for force in forces[swings]])
    q[swings] = q[swings] - solve_linear(stiffness, pull)
    return q


def stage(plant: Plant, length: float, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> Entries:
    """Return the model of a stage of a length [s] about a node, by row of its memory."""
    layout = plant.topology.layout
    n, m = layout.n, layout.m
    z, w = 2 * n, 2 * n + m
    derivatives = crane_derivatives(plant, q, v, u)
    node = np.concatenate([q, v, u])
    # Time derivatives of the motion as linear functions of coordinates, rates and inputs, with the
    # value at the node in the last column.
    faster = np.hstack([derivatives.rates, derivatives.a[:, None]])
    moved = np.zeros((n, w + 1), dtype=object)
    moved[:] = 0.0
    moved[range(n), range(n, z)] = 1.0
    moved[:, w] = v
    after = np.zeros((z, w + 1), dtype=object)
    after[:] = 0.0
    after[range(z), range(z)] = 1.0
    after[:, w] = node[:z]
    share = 1.0
    by_q = derivatives.rates[:, :n]
    by_v = derivatives.rates[:, n:z]
    for order in range(1, _ORDER + 1):
        share *= length / order
        after = after + share * np.vstack([moved, faster])
        moved, faster = faster, by_q @ moved + by_v @ faster
    entries: Entries = [("forward", i, j, after[i, j]) for i in range(z) for j in range(w)]
    entries += [("shift", 0, i, after[i, w] - after[i, :w] @ node) for i in range(z)]
    for i in range(m):
        entries += [("extra", i, j, derivatives.efforts[i, j]) for j in range(w)]
    for i in range(m):
        shift = derivatives.effort[i] - derivatives.efforts[i] @ node
        entries.append(("extra_shift", 0, w + i, shift))
    return entries


def payload_jacobian(plant: Plant, q: np.ndarray) -> np.ndarray:
    """Return the derivatives of the payload's position in the world by the coordinates, shape (3,
    n).
    """
    tree = plant.tree
    body = plant.topology.bodies[0]
    (q_dual,) = variables(q)
    placements = rigid_body.frames(tree, q_dual)
    point = plant.levers[0]
    while body >= 0:
        point = placements[body].origin + placements[body].rotation @ point
        body = tree.parents[body]
    return slopes(point, len(q))


def emit_weights(
    module: ir.Module,
    shape: HorizonShape,
    plant: Plant,
    errors: np.ndarray,
    payload_errors: np.ndarray,
) -> None:
    """Add the function `weigh`, which writes the weight of the states for a goal: errors of the
    payload's position and rate, and errors of coordinates and rates, with equal weight.
    """
    work = Work(module, "weigh", shape)
    n = plant.topology.layout.n
    jacobian = payload_jacobian(plant, work.common.row("goal", n))
    for block, error in enumerate(payload_errors.tolist()):
        for i in range(n):
            for j in range(n):
                product: Any = error**-2.0 * (jacobian[:, i] @ jacobian[:, j])
                if i == j:
                    product = product + float(errors[block, i]) ** -2.0
                work.common.put("weight", product, block * n + i, block * n + j)
    work.code.end()


def emit(module: ir.Module, shape: HorizonShape, plant: Plant, length: float) -> Entries:
    """Add the function `linearise`, from the nodes of all stages to their models; return the
    entries that are the same for every node, which the code does not write.
    """
    work = Work(module, "linearise", shape)
    code = work.code
    n = plant.topology.layout.n
    z = shape.states
    together = shape.wide // shape.cranes
    last = code.integer(shape.stages - 1)
    with code.loop(0, -(-shape.stages // together)) as block:
        first = code.product(block, together)
        stages = [work.stage(code.least(code.plus(first, i), last)) for i in range(together)]
        nodes = [rows.row("node", shape.both) for rows in stages]
        node = array([work.joined(values) for values in zip(*nodes, strict=True)])
        entries = stage(plant, length, node[:n], node[n:z], node[z:])
        for name, row, i, value in entries:
            if isinstance(value, Value):
                for rows, number in zip(stages, work.split(value), strict=True):
                    rows.put(name, number, row, i)
    code.end()
    return [(*place, float(value)) for *place, value in entries if not isinstance(value, Value)]  # type: ignore[misc]
