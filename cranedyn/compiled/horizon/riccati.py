"""Riccati recursion in code: the linear algebra of a quadratic programme over a horizon.

The programme has no bounds; those of an iteration of `cranedyn.compiled.horizon.interior` enter as
curvature and gradient. Its model is x⁺ = F z + f, with z = (x, u), and its further quantities are
E z + e. With the cost-to-go ½ x⁺ᵀ P x⁺ + pᵀ x⁺ of all later stages, the cost by z of a stage and
all that follow has the second derivatives and the gradient at zero

    H = W + Fᵀ P F + Eᵀ C E + C_z,    h = c_z + Fᵀ (P f + p) + Eᵀ c_e,

where W is the weight, C the curvature of the barriers and c the gradient, variables by z and by the
further quantities, where these are e. The inputs that minimise it are u = -K x - k, with
K = H_uu⁻¹ H_ux and k = H_uu⁻¹ h_u. Eliminating them leaves a cost-to-go of the state before the
stage,

    P ← H_xx - H_xu K,    p ← h_x - Kᵀ h_u.

K and H_uu⁻¹ are stored as `feedback`, P f as `shift_gradient` and k as `open_loop`. So the same
programme with another gradient takes one backward and one forward sweep (Rao, Wright and Rawlings
1998, "Application of interior-point methods to model predictive control"). Numbers that are the
same in every stage are folded.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir

from cranedyn.compiled.code import StackVariable
from cranedyn.compiled.horizon.memory import Constants, HorizonShape, MemoryRows, Work
from cranedyn.dynamics.scalars import array, solve_linear


def emit(module: ir.Module, shape: HorizonShape, constants: Constants | None = None) -> None:
    """Add the functions `end`, `free`, `factor` and `sweep`, which work on the memory of an
    optimisation.

    * `end`: the cost-to-go beyond the horizon, as that of a horizon as long again on which the
      model of the last stage stays and nothing is bounded.
    * `free`: the feedback of every stage without bounds; the gradient is that of the cost.
    * `factor`: the feedback of every stage with the curvature of the barriers.
    * `sweep`: states, inputs and further quantities that minimise the cost under the gradients of
      the stages; they become the trial point.

    Args:
        module: Module to which they are added.
        shape: Dimensions of the programme.
        constants: Numbers that are the same in every stage.
    """
    _emit_end(Work(module, "end", shape, constants))
    _emit_factor(Work(module, "free", shape, constants), bounded=False)
    _emit_factor(Work(module, "factor", shape, constants), bounded=True)
    _emit_sweep(Work(module, "sweep", shape, constants))


def _emit_end(work: Work) -> None:
    """Emit the function `end`."""
    states = work.shape.states
    shared = work.shared
    _put_symmetric(shared, "cost_to_go", shared.table("weight", states)[:states])
    last = work.stage(work.code.integer(work.shape.stages - 1))
    with work.code.loop(0, work.shape.stages):
        _eliminate_inputs(work, last, bounded=False)
    _put_symmetric(shared, "end", symmetric(shared, "cost_to_go", states))
    work.code.end()


def _emit_factor(work: Work, *, bounded: bool) -> None:
    """Emit the function `factor`, or `free` if nothing is bounded."""
    shape = work.shape
    states = shape.states
    shared = work.shared
    _put_symmetric(shared, "cost_to_go", symmetric(shared, "end", states))
    with work.stages_backward() as stage:
        if not bounded:
            # The further quantities have no cost of their own.
            gradient = [*stage.row("gradient", shape.variables), *[0.0] * shape.inputs]
            stage.put_row("total_gradient", gradient)
        shift = stage.row("shift", states)
        stage.put_row("shift_gradient", symmetric(shared, "cost_to_go", states) @ shift)
        _eliminate_inputs(work, stage, bounded=bounded)
    work.code.end()


def _eliminate_inputs(work: Work, stage: MemoryRows, *, bounded: bool) -> None:
    """Replace the cost-to-go of the state after a stage by that of the state before it, and store
    the feedback.

    Args:
        work: Memory of the optimisation.
        stage: Rows of the stage.
        bounded: Whether the barriers of bounds have a curvature.
    """
    shared = work.shared
    states = work.shape.states
    variables = work.shape.variables
    inputs = work.shape.inputs
    cost_to_go = symmetric(shared, "cost_to_go", states)
    weight = shared.table("weight", variables)
    forward = stage.table("forward", variables)
    extra = stage.table("extra", variables)
    curvature = stage.row("barrier_curvature", variables + inputs)

    # H is symmetric: its upper triangle is computed, column by column.
    cost = np.empty((variables, variables), dtype=object)
    for j in range(variables):
        forward_cost = cost_to_go @ forward[:, j]
        extra_cost = curvature[variables:] * extra[:, j]
        for i in range(j + 1):
            entry = weight[i, j] + forward[:, i] @ forward_cost
            if bounded:
                of_barriers = extra[:, i] @ extra_cost
                entry = entry + of_barriers + (curvature[i] if i == j else 0.0)
            cost[i, j] = entry
            cost[j, i] = entry

    cost_of_inputs = cost[states:, states:]
    right = np.hstack([cost[states:, :states], np.eye(inputs).astype(object)])
    gains = solve_linear(cost_of_inputs, right)
    for i, row in enumerate(gains):
        stage.put_row("feedback", row, i)
    eliminated = cost[:states, states:] @ gains[:, :states]
    _put_symmetric(shared, "cost_to_go", cost[:states, :states] - eliminated)


def symmetric(shared: MemoryRows, name: str, count: int) -> np.ndarray:
    """Return a symmetric matrix, of whose rows only the lower triangle is loaded.

    Args:
        shared: Rows that all stages share.
        name: Name of the matrix.
        count: Number of its rows.
    """
    lower = [shared.row(name, i + 1, i) for i in range(count)]
    matrix = np.empty((count, count), dtype=object)
    for i in range(count):
        for j in range(i + 1):
            matrix[i, j] = lower[i][j]
            matrix[j, i] = lower[i][j]
    return matrix


def _put_symmetric(shared: MemoryRows, name: str, matrix: np.ndarray) -> None:
    """Store the lower triangle of a symmetric matrix."""
    for i, row in enumerate(matrix):
        shared.put_row(name, row[: i + 1], i)


def _emit_sweep(work: Work) -> None:
    """Emit the function `sweep`."""
    code = work.code
    shape = work.shape
    slope = code.variables([*work.shared.row("end_gradient", shape.states)])
    with work.stages_backward() as stage:
        _sweep_backward(stage, shape, slope)
    state = code.variables([*work.shared.row("start", shape.states)])
    with code.loop(0, shape.stages) as k:
        _sweep_forward(work.stage(k), shape, state)
    code.end()


def _sweep_backward(stage: MemoryRows, shape: HorizonShape, slope: list[StackVariable]) -> None:
    """Store the inputs of a stage that do not depend on its state, and replace the gradient of the
    cost-to-go of the state after the stage by that of the state before it.

    Args:
        stage: Rows of the stage.
        shape: Dimensions of the programme.
        slope: The gradient, p in the equations of this module.
    """
    states = shape.states
    variables = shape.variables
    gradient = stage.row("total_gradient", variables + shape.inputs)
    gains = stage.table("feedback", variables)
    ahead = array([variable.get() for variable in slope]) + stage.row("shift_gradient", states)
    total = gradient[:variables] + stage.table("forward", variables).T @ ahead
    total = total + stage.table("extra", variables).T @ gradient[variables:]
    by_state = total[:states]
    by_input = total[states:]
    stage.put_row("open_loop", gains[:, states:] @ by_input)
    eliminated = by_state - gains[:, :states].T @ by_input
    for variable, value in zip(slope, eliminated, strict=True):
        variable.set(value)


def _sweep_forward(stage: MemoryRows, shape: HorizonShape, state: list[StackVariable]) -> None:
    """Store the trial point of a stage, and replace its state by the next.

    Args:
        stage: Rows of the stage.
        shape: Dimensions of the programme.
        state: The state.
    """
    states = shape.states
    variables = shape.variables
    inputs = shape.inputs
    now = array([variable.get() for variable in state])
    feedback = stage.table("feedback", states) @ now
    input_ = -feedback - stage.row("open_loop", inputs)
    state_and_input = np.concatenate([now, input_])
    extra = stage.table("extra", variables) @ state_and_input
    further = extra + stage.row("extra_shift", inputs, first=variables)
    stage.put_row("trial", [*state_and_input, *further])
    coming = stage.table("forward", variables) @ state_and_input + stage.row("shift", states)
    for variable, value in zip(state, coming, strict=True):
        variable.set(value)
