"""Riccati recursion in code: the linear algebra of a quadratic programme over a horizon.

Eliminating the inputs of a stage turns the cost of all later stages into a cost of its state; the
eliminated terms are stored as feedback, so that the same problem with another gradient takes one
backward and one forward sweep (Rao, Wright and Rawlings 1998, "Application of interior-point
methods to model predictive control"). Numbers that are the same in every stage are folded.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir

from cranedyn.compiled.horizon.memory import Constants, HorizonShape, MemoryRows, Work
from cranedyn.dynamics.scalars import array, solve_linear


def emit(module: ir.Module, shape: HorizonShape, constants: Constants | None = None) -> None:
    """Add the functions `end`, `free`, `factor` and `sweep`, which work on the memory of an
    optimisation.

    end: the cost-to-go beyond the horizon, as that of a horizon as long again on which the last
    stage's model stays and nothing is bounded. free, factor: the feedback of every stage without
    bounds, whose slope is the gradient, and under its curvature. sweep: states, inputs and what
    else is bounded under the stages' slopes.
    """
    _emit_end(Work(module, "end", shape, constants))
    _emit_factor(Work(module, "free", shape, constants), bounded=False)
    _emit_factor(Work(module, "factor", shape, constants), bounded=True)
    _emit_sweep(Work(module, "sweep", shape, constants))


def _emit_end(work: Work) -> None:
    states = work.shape.states
    common = work.common
    _put_symmetric(common, "togo", common.table("weight", states)[:states])
    last = work.stage(work.code.integer(work.shape.stages - 1))
    with work.code.loop(0, work.shape.stages):
        _eliminate(work, last, bounded=False)
    _put_symmetric(common, "end", symmetric(common, "togo", states))
    work.code.end()


def _emit_factor(work: Work, *, bounded: bool) -> None:
    states = work.shape.states
    common = work.common
    _put_symmetric(common, "togo", symmetric(common, "end", states))
    with work.backward() as stage:
        if not bounded:
            slope = [*stage.row("gradient", work.shape.both), *[0.0] * work.shape.inputs]
            stage.put_row("slope", slope)
        shift = stage.row("shift", states)
        stage.put_row("carried", symmetric(common, "togo", states) @ shift)
        _eliminate(work, stage, bounded=bounded)
    work.code.end()


def _eliminate(work: Work, stage: MemoryRows, *, bounded: bool) -> None:
    """Replace the cost-to-go of the state after a stage by that of the state before it, and store
    the feedback.
    """
    common = work.common
    z = work.shape.states
    w = work.shape.both
    m = work.shape.inputs
    togo = symmetric(common, "togo", z)
    weight = common.table("weight", w)
    forward, extra = stage.table("forward", w), stage.table("extra", w)
    curve = stage.row("curve", w + m)
    cost = np.empty((w, w), dtype=object)
    for j in range(w):
        ahead = togo @ forward[:, j]
        curved = curve[w:] * extra[:, j]
        for i in range(j + 1):
            entry = weight[i, j] + forward[:, i] @ ahead
            if bounded:
                entry = entry + extra[:, i] @ curved + (curve[i] if i == j else 0.0)
            cost[i, j] = cost[j, i] = entry
    gains = solve_linear(cost[z:, z:], np.hstack([cost[z:, :z], np.eye(m).astype(object)]))
    for c, row in enumerate(gains):
        stage.put_row("feedback", row, c)
    _put_symmetric(common, "togo", cost[:z, :z] - cost[:z, z:] @ gains[:, :z])


def symmetric(common: MemoryRows, name: str, count: int) -> np.ndarray:
    """Return a symmetric matrix from its lower triangle."""
    rows = [common.row(name, i + 1, i) for i in range(count)]
    return np.array([[rows[max(i, j)][min(i, j)] for j in range(count)] for i in range(count)])


def _put_symmetric(common: MemoryRows, name: str, matrix: np.ndarray) -> None:
    for i, row in enumerate(matrix):
        common.put_row(name, row[: i + 1], i)


def _emit_sweep(work: Work) -> None:
    code, common = work.code, work.common
    z, w, m = work.shape.states, work.shape.both, work.shape.inputs
    slope = code.variables([*common.row("end_gradient", z)])
    with work.backward() as stage:
        steep = stage.row("slope", w + m)
        gains = stage.table("feedback", w)
        ahead = array([variable.get() for variable in slope]) + stage.row("carried", z)
        felt = (
            steep[:w] + stage.table("forward", w).T @ ahead + stage.table("extra", w).T @ steep[w:]
        )
        stage.put_row("open", gains[:, z:] @ felt[z:])
        for variable, value in zip(slope, felt[:z] - gains[:, :z].T @ felt[z:], strict=True):
            variable.set(value)
    state = code.variables([*common.row("start", z)])
    with code.loop(0, work.shape.stages) as k:
        stage = work.stage(k)
        now = array([variable.get() for variable in state])
        inputs = -(stage.table("feedback", z) @ now) - stage.row("open", m)
        both = np.concatenate([now, inputs])
        further = stage.table("extra", w) @ both + stage.row("extra_shift", m, first=w)
        stage.put_row("trial", [*both, *further])
        coming = stage.table("forward", w) @ both + stage.row("shift", z)
        for variable, value in zip(state, coming, strict=True):
            variable.set(value)
    code.end()
