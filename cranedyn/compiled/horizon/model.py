"""A crane predicted over a horizon, in code: the trace of its equations of motion and their
derivatives.

The inputs are the accelerations of the drives, held over a stage; what they cost is then a linear
function at hand for limits of the efforts and for the tension of the rope. Stages are linearised
eight at once, one in each lane. A stage is taken by the exponential of its own linearisation, to
fourth order in its length: exact for small motions (Hochbruck and Ostermann 2010, "Exponential
integrators", §2.4).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir

from cranedyn.compiled.code import INTEGER, Code, Value
from cranedyn.compiled.horizon.dual import constants, slopes, variables
from cranedyn.compiled.horizon.memory import BLOCK, Other, Shape, Work
from cranedyn.dynamics.scalars import array, solve_linear
from cranedyn.plant import rigid_body
from cranedyn.plant.plant import Plant

_ORDER = 4

Entries = list[tuple[str, int, int, Any]]
"""Numbers of a stage: name of the row, its number, lane, what stands there."""


class Linear(NamedTuple):
    """A crane about a state and accelerations of its drives.

    Attributes:
        a: Accelerations, shape (n,).
        effort: Of the drives, shape (m,).
        rates: Derivatives of the accelerations by coordinates, rates and inputs, shape (n, 2 n +
            m).
        efforts: The same of the efforts, shape (m, 2 n + m).
    """

    a: np.ndarray
    effort: np.ndarray
    rates: np.ndarray
    efforts: np.ndarray


def linear(plant: Plant, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> Linear:
    """Linearise a crane whose drives accelerate as told, in any kind of number."""
    layout = plant.topology.layout
    n, m, drives, passive = layout.n, layout.m, layout.drives, layout.passive
    a, effort = plant.answer(q, v, u, None)
    at, moving = variables(q, v)
    where = rigid_body.frames(plant.tree, at)
    forces = rigid_body.tree_inverse_dynamics(
        plant.tree, where, moving, constants(a, 2 * n)
    ) - plant.joint.effort(at, moving)
    by_state = slopes(forces, 2 * n)
    mass = rigid_body.mass_matrix(plant.tree, rigid_body.frames(plant.tree, q))
    by_all = np.zeros((n, 2 * n + m), dtype=object)
    by_all[:, : 2 * n], by_all[:, 2 * n :] = by_state, mass[:, drives]
    rates = np.zeros((n, 2 * n + m), dtype=object)
    rates[:] = 0.0
    rates[drives, range(2 * n, 2 * n + m)] = 1.0
    block = mass[np.ix_(passive, passive)]
    for j in range(2 * n + m):
        if any(not _zero(part) for part in by_all[passive, j]):
            rates[passive, j] = solve_linear(block, -by_all[passive, j])
    efforts = by_all[drives] + mass[np.ix_(drives, passive)] @ rates[passive]
    return Linear(a, effort, rates, efforts)


def _zero(part: Any) -> bool:
    return isinstance(part, float) and part == 0.0


def hanging(plant: Plant, drives: np.ndarray) -> np.ndarray:
    """Coordinates at rest for places of the drives, shape (n,), in any kind of number: of the swing
    joints by a step of Newton's method from where they hang to first order.
    """
    layout, swings = plant.topology.layout, [i for i, _ in plant.topology.swings]
    still = array([0.0] * layout.n)
    q = still.copy()
    q[layout.drives] = drives
    if plant.plumb_at_zero:
        return q
    q[swings] = plant.hanging_angles(drives)
    (at,) = variables(q)
    forces = rigid_body.tree_inverse_dynamics(
        plant.tree, rigid_body.frames(plant.tree, at), still, constants(still, layout.n)
    )
    stiffness = slopes(forces[swings], layout.n)[:, swings]
    pull = array([force.value for force in forces[swings]])
    q[swings] = q[swings] - solve_linear(stiffness, pull)
    return q


def stage(plant: Plant, length: float, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> Entries:
    """The model of a stage of a length [s] about a node, by place in its memory."""
    layout = plant.topology.layout
    n, m = layout.n, layout.m
    z, w = 2 * n, 2 * n + m
    found = linear(plant, q, v, u)
    node = np.concatenate([q, v, u])
    # Derivatives of the motion by time, each a linear function of coordinates, rates and inputs,
    # with its value at the node last.
    faster = np.hstack([found.rates, found.a[:, None]])
    moved = np.zeros((n, w + 1), dtype=object)
    moved[:] = 0.0
    moved[range(n), range(n, z)] = 1.0
    moved[:, w] = v
    after = np.zeros((z, w + 1), dtype=object)
    after[:] = 0.0
    after[range(z), range(z)] = 1.0
    after[:, w] = node[:z]
    share = 1.0
    by_q, by_v = found.rates[:, :n], found.rates[:, n:z]
    for order in range(1, _ORDER + 1):
        share *= length / order
        after = after + share * np.vstack([moved, faster])
        moved, faster = faster, by_q @ moved + by_v @ faster
    return [
        *((("forward"), i, j, after[i, j]) for i in range(z) for j in range(w)),
        *((("columns"), j, i, after[i, j]) for i in range(z) for j in range(w)),
        *(("shift", 0, i, after[i, w] - after[i, :w] @ node) for i in range(z)),
        *(("extra", i, j, found.efforts[i, j]) for i in range(m) for j in range(w)),
        *(("apart", 0, w + i, found.effort[i] - found.efforts[i] @ node) for i in range(m)),
    ]


def payload(plant: Plant, q: np.ndarray) -> np.ndarray:
    """Derivatives of the payload's place in the world by the coordinates, shape (3, n)."""
    tree, body = plant.tree, plant.topology.bodies[0]
    (at,) = variables(q)
    where, place = rigid_body.frames(tree, at), plant.levers[0]
    while body >= 0:
        place = where[body].origin + where[body].rotation @ place
        body = tree.parents[body]
    return slopes(place, len(q))


def emit_weights(
    module: ir.Module, shape: Shape, plant: Plant, errors: np.ndarray, payload_errors: np.ndarray
) -> None:
    """Add the function `weigh`, which writes the weight of the states for a goal: errors of the
    payload's place and rate, and by themselves those of coordinates and rates, that weigh alike.
    """
    work = Work(Code(module, "weigh", ["work"], 1), shape)
    n = plant.topology.layout.n
    places = payload(plant, array([work.common.one("goal", 0, i) for i in range(n)]))
    for part, error in enumerate(payload_errors.tolist()):
        for i in range(n):
            for j in range(n):
                product: Any = error**-2.0 * (places[:, i] @ places[:, j])
                if i == j:
                    product = product + float(errors[part, i]) ** -2.0
                work.common.put_one("weight", part * n + i, part * n + j, product)
    work.code.end()


def emit(module: ir.Module, shape: Shape, plant: Plant, length: float) -> Entries:
    """Add the function `linearise`, from the nodes of all stages to their models; returns what is
    the same for every node, which the code does not write.
    """
    work = Work(Code(module, "linearise", ["work"], BLOCK), shape)
    code, layout = work.code, plant.topology.layout
    n, z = layout.n, shape.states
    with code.loop(0, shape.padded // BLOCK) as block:
        stages = [
            work.stage(code.builder.add(code.product(block, BLOCK), code.integer(lane)))
            for lane in range(BLOCK)
        ]
        node = array(
            [
                code.gathered(code.argument["work"], [each.at("node", 0, i) for each in stages])
                for i in range(shape.both)
            ]
        )
        entries = stage(plant, length, node[:n], node[n:z], node[z:])
        written = [entry for entry in entries if isinstance(entry[3], Value)]
        for row, (_, _, _, value) in enumerate(written):
            code.store(value, code.argument["work"], BLOCK * row + shape.place("block"))
        _scatter(work, block, written)
    code.end()
    return list(_known(entries))


def _scatter(work: Work, block: ir.Value, written: Entries) -> None:
    """From rows with a lane for each stage to the memory of each stage."""
    code, shape = work.code, work.shape
    one, builder = Other(code, 1), code.builder
    places = [shape.place(name, row) + lane for name, row, lane, _ in written]
    kind = ir.ArrayType(INTEGER, len(places))
    table = ir.GlobalVariable(code.function.module, kind, "places")
    table.global_constant, table.initializer = True, ir.Constant(kind, places)
    first = builder.add(code.product(block, BLOCK * shape.stride), code.integer(shape.first))
    with code.loop(0, len(places)) as row:
        at = builder.add(code.product(row, BLOCK), code.integer(shape.place("block")))
        place = builder.load(builder.gep(table, [row], source_etype=INTEGER), typ=INTEGER)
        place = builder.add(first, place)
        for lane in range(BLOCK):
            value = one.load(code.argument["work"], builder.add(at, code.integer(lane)))
            to = builder.add(place, code.integer(lane * shape.stride))
            one.store(value, code.argument["work"], to)


def _known(entries: Entries) -> Iterator[tuple[str, int, int, float]]:
    for name, row, lane, value in entries:
        if not isinstance(value, Value):
            yield name, row, lane, float(value)
