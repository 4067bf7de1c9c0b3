"""Quadratic programmes over a horizon, in the forms that other solvers take.

A programme has N stages. Of each stage k the state x_k follows from the one before, and inputs u_k
are sought; in addition to both, some linear functions of them are bounded, the *further* quantities
of the stage. All bounds are soft: to exceed them has a price.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from cranedyn.compiled.horizon.memory import HorizonShape

UNBOUNDED = 1e8
"""Size from which on a bound counts as none."""

Solve = Callable[[], np.ndarray]
"""Function that solves a programme and returns states, inputs and further quantities of each stage,
shape (stages, states + 2 inputs)."""


class HorizonProblem(NamedTuple):
    """A quadratic programme over a horizon.

    The cost is the sum of ½ zᵀ diag(q, r) z + gradientᵀ z over the stages, with z = (x, u), of
    ½ xᵀ end x + end_gradientᵀ x for the state after the last stage, and of all penalties.

    Attributes:
        a: Matrix of x_(k+1) = a x_k + b u_k + c, shape (stages, states, states).
        b: Matrix of the inputs in it, shape (stages, states, inputs).
        c: Constant in it, shape (stages, states).
        e: Matrix of the further quantities e z + d, shape (stages, inputs, states + inputs).
        d: Constant in them, shape (stages, inputs).
        q: Weight of states, shape (states, states).
        r: Weight of inputs, shape (inputs, inputs).
        gradient: Linear cost, shape (stages, states + inputs).
        low: Lower bounds of states, inputs and further quantities, shape (states + 2 inputs,).
        high: Upper bounds likewise.
        price: Cost of exceeding each bound by one.
        start: State at the beginning, shape (states,).
        end: Weight of the state after the last stage.
        end_gradient: Linear cost of that state.
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    e: np.ndarray
    d: np.ndarray
    q: np.ndarray
    r: np.ndarray
    gradient: np.ndarray
    low: np.ndarray
    high: np.ndarray
    price: np.ndarray
    start: np.ndarray
    end: np.ndarray
    end_gradient: np.ndarray

    @property
    def shape(self) -> HorizonShape:
        """Numbers of states, inputs and stages."""
        return HorizonShape(self.a.shape[1], self.b.shape[2], len(self.a))

    @property
    def weight(self) -> np.ndarray:
        """Weight of states and inputs together."""
        return scipy.linalg.block_diag(self.q, self.r)

    def value(self, solution: np.ndarray) -> float:
        """Return the cost of a solution, penalties for exceeded bounds included.

        Args:
            solution: States, inputs and further quantities, as `Solve` returns them.
        """
        z = self.shape.states
        w = self.shape.variables
        last = self.a[-1] @ solution[-1, :z] + self.b[-1] @ solution[-1, z:w] + self.c[-1]
        both = solution[:, :w]
        excess = np.maximum(solution - self.high, 0.0) + np.maximum(self.low - solution, 0.0)
        cost = 0.5 * np.einsum("ki,ij,kj", both, self.weight, both) + (self.gradient * both).sum()
        cost += 0.5 * last @ self.end @ last + self.end_gradient @ last
        return float(cost + (excess @ self.price).sum())

    def gap(self, solution: np.ndarray) -> float:
        """Return the largest residual of the equations of a solution, the start included."""
        z = self.shape.states
        w = self.shape.variables
        next_states = (
            np.einsum("kij,kj->ki", self.a, solution[:, :z])
            + np.einsum("kij,kj->ki", self.b, solution[:, z:w])
            + self.c
        )
        further = np.einsum("kij,kj->ki", self.e, solution[:, :w]) + self.d
        gaps = (
            solution[0, :z] - self.start,
            next_states[:-1] - solution[1:, :z],
            further - solution[:, w:],
        )
        return max(float(np.abs(gap).max()) for gap in gaps)


class Sparse(NamedTuple):
    """A programme as general solvers take it.

    Minimise ½ xᵀ weight x + costᵀ x with equality x = right and inequality x <= limits. The vector
    x has states and inputs of all stages, the last state, and a slack for each bound.

    Attributes:
        weight: Weight.
        cost: Linear cost.
        equality: Matrix of the equations of the model.
        right: Their right side.
        inequality: Matrix of the bounds and of the slacks, which are not negative.
        limits: Their limits.
        bounded: Matrix of the bounded quantities, bounded x + offset, without columns of slacks.
        offset: Constant in them.
    """

    weight: sp.csc_matrix
    cost: np.ndarray
    equality: sp.csc_matrix
    right: np.ndarray
    inequality: sp.csc_matrix
    limits: np.ndarray
    bounded: np.ndarray
    offset: np.ndarray

    def by_stage(self, x: np.ndarray, stages: int) -> np.ndarray:
        """Return states, inputs and further quantities of each stage, see `Solve`."""
        without_slacks = x[: self.bounded.shape[1]]
        return (self.bounded @ without_slacks + self.offset).reshape(stages, -1)


def sparse(problem: HorizonProblem) -> Sparse:
    """Return a programme in states, inputs and slacks of bounds."""
    shape = problem.shape
    z = shape.states
    w = shape.variables
    n = shape.stages
    size = n * w + z
    both = w + shape.inputs
    equality = np.zeros((z * (n + 1), size))
    right = np.zeros(z * (n + 1))
    equality[:z, :z] = np.eye(z)
    right[:z] = problem.start
    bounded = np.zeros((n * both, size))
    offset = np.zeros(n * both)
    for k in range(n):
        rows = slice(z * (k + 1), z * (k + 2))
        columns = slice(k * w, (k + 1) * w)
        equality[rows, columns] = -np.hstack([problem.a[k], problem.b[k]])
        equality[rows, (k + 1) * w : (k + 1) * w + z] = np.eye(z)
        right[rows] = problem.c[k]
        bounded[k * both : k * both + w, columns] = np.eye(w)
        bounded[k * both + w : (k + 1) * both, columns] = problem.e[k]
        offset[k * both + w : (k + 1) * both] = problem.d[k]
    high = np.tile(problem.high, n)
    low = np.tile(problem.low, n)
    above = np.flatnonzero(high < UNBOUNDED)
    below = np.flatnonzero(low > -UNBOUNDED)
    price = np.tile(problem.price, n)
    # Bounds are scaled by their prices, so that all slacks have one price.
    scale = np.concatenate([price[above], price[below]]) / problem.price.max()
    count = len(scale)
    weights = [*[problem.weight] * n, problem.end, sp.csc_matrix((count, count))]
    costs = [problem.gradient.ravel(), problem.end_gradient, np.full(count, problem.price.max())]
    limits = np.concatenate([(high - offset)[above], (offset - low)[below]]) * scale
    scaled = sp.diags(scale) @ np.vstack([bounded[above], -bounded[below]])
    inequality: list[list[Any]] = [
        [scaled, -sp.eye(count)],
        [None, -sp.eye(count)],
    ]
    return Sparse(
        weight=sp.csc_matrix(sp.block_diag(weights)),
        cost=np.concatenate(costs),
        equality=sp.csc_matrix(np.hstack([equality, np.zeros((len(equality), count))])),
        right=right,
        inequality=sp.csc_matrix(sp.bmat(inequality)),
        limits=np.concatenate([limits, np.zeros(count)]),
        bounded=bounded,
        offset=offset,
    )


def by_clarabel(problem: HorizonProblem) -> Solve:
    """Solve by Clarabel's interior-point method, to 1e-10."""
    import clarabel

    form = sparse(problem)
    n = problem.shape.stages
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-10
    upper = sp.csc_matrix(sp.triu(form.weight))
    rows = sp.csc_matrix(sp.vstack([form.equality, form.inequality]))
    limits = np.concatenate([form.right, form.limits])
    cones = [clarabel.ZeroConeT(len(form.right)), clarabel.NonnegativeConeT(len(form.limits))]

    def solve() -> np.ndarray:
        answer = clarabel.DefaultSolver(upper, form.cost, rows, limits, cones, settings).solve()
        return form.by_stage(np.array(answer.x), n)

    return solve


def by_osqp(problem: HorizonProblem) -> Solve:
    """Solve by OSQP's operator splitting, to 1e-4."""
    import osqp

    form = sparse(problem)
    n = problem.shape.stages
    upper = sp.csc_matrix(sp.triu(form.weight))
    rows = sp.csc_matrix(sp.vstack([form.equality, form.inequality]))
    high = np.concatenate([form.right, form.limits])
    low = np.concatenate([form.right, np.full(len(form.limits), -np.inf)])

    def solve() -> np.ndarray:
        solver = osqp.OSQP()
        solver.setup(upper, form.cost, rows, low, high, verbose=False, eps_abs=1e-4, eps_rel=1e-4)
        return form.by_stage(np.array(solver.solve().x), n)

    return solve


def by_piqp(problem: HorizonProblem) -> Solve:
    """Solve by PIQP's proximal interior-point method, with its defaults."""
    import piqp

    form = sparse(problem)
    n = problem.shape.stages
    low = np.full(len(form.limits), -np.inf)

    def solve() -> np.ndarray:
        solver = piqp.SparseSolver()
        solver.setup(
            form.weight, form.cost, form.equality, form.right, form.inequality, low, form.limits
        )
        solver.solve()
        return form.by_stage(np.array(solver.result.x), n)

    return solve


def by_daqp(problem: HorizonProblem) -> Solve:
    """Solve by DAQP's active-set method, condensed to the inputs, with soft bounds."""
    from daqp import solve

    shape = problem.shape
    z = shape.states
    n = shape.stages
    m = shape.inputs
    width = n * m + 1
    state = np.zeros((z, width))
    rows = []
    state[:, -1] = problem.start
    hessian = np.zeros((width, width))
    linear = np.zeros(width)
    for k in range(n):
        inputs = np.zeros((m, width))
        inputs[:, k * m : (k + 1) * m] = np.eye(m)
        both = np.vstack([state, inputs])
        besides = problem.e[k] @ both
        besides[:, -1] += problem.d[k]
        rows.append(np.vstack([both, besides]))
        hessian += both.T @ problem.weight @ both
        linear += problem.gradient[k] @ both
        state = problem.a[k] @ state + problem.b[k] @ inputs
        state[:, -1] += problem.c[k]
    hessian += state.T @ problem.end @ state
    linear += problem.end_gradient @ state
    # The state at the start is given: no input moves it.
    stacked = np.vstack(rows)[z:]
    high = np.tile(problem.high, n)[z:]
    low = np.tile(problem.low, n)[z:]
    real = (high < UNBOUNDED) | (low > -UNBOUNDED)
    stacked = stacked[real]
    high = high[real] - stacked[:, -1]
    low = low[real] - stacked[:, -1]
    square = np.ascontiguousarray(hessian[:-1, :-1])
    cost = hessian[:-1, -1] + linear[:-1]
    sides = np.ascontiguousarray(stacked[:, :-1])
    kinds = np.zeros(len(low), dtype=np.int32)

    def answer() -> np.ndarray:
        inputs, _, flag, _ = solve(square, cost, sides, high, low, kinds)
        if flag != 1:
            return np.full((n, shape.variables + m), np.nan)
        return np.array([row @ np.append(inputs, 1.0) for row in rows])

    return answer


SOLVERS: dict[str, Callable[[HorizonProblem], Solve]] = {
    "DAQP": by_daqp,
    "Clarabel": by_clarabel,
    "PIQP": by_piqp,
    "OSQP": by_osqp,
}
"""Those that are measured beside ours, by name."""
