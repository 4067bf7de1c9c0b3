"""Quadratic programmes over a horizon in the forms that solvers of other people take."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from cranedyn.compiled.horizon.memory import HorizonShape

NONE = 1e8
"""From here on a bound is none."""

Solve = Callable[[], np.ndarray]
"""Answers states and inputs by stage, what is bounded besides included."""


class HorizonProblem(NamedTuple):
    """States follow next = a state + b input + c; e (state, input) + d is bounded besides them. To
    exceed a bound costs its price.
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
        """How large it is."""
        return HorizonShape(self.a.shape[1], self.b.shape[2], len(self.a))

    @property
    def weight(self) -> np.ndarray:
        """Of states and inputs together."""
        return scipy.linalg.block_diag(self.q, self.r)

    def value(self, solution: np.ndarray) -> float:
        """Return the cost of a solution, penalties for exceeded bounds included."""
        z = self.shape.states
        w = self.shape.both
        last = self.a[-1] @ solution[-1, :z] + self.b[-1] @ solution[-1, z:w] + self.c[-1]
        both = solution[:, :w]
        over = np.maximum(solution - self.high, 0.0) + np.maximum(self.low - solution, 0.0)
        cost = 0.5 * np.einsum("ki,ij,kj", both, self.weight, both) + (self.gradient * both).sum()
        cost += 0.5 * last @ self.end @ last + self.end_gradient @ last
        return float(cost + (over @ self.price).sum())

    def gap(self, solution: np.ndarray) -> float:
        """Return the largest residual of the model equations."""
        z = self.shape.states
        w = self.shape.both
        coming = (
            np.einsum("kij,kj->ki", self.a, solution[:, :z])
            + np.einsum("kij,kj->ki", self.b, solution[:, z:w])
            + self.c
        )
        besides = np.einsum("kij,kj->ki", self.e, solution[:, :w]) + self.d
        gaps = (
            solution[0, :z] - self.start,
            coming[:-1] - solution[1:, :z],
            besides - solution[:, w:],
        )
        return max(float(np.abs(gap).max()) for gap in gaps)


class Sparse(NamedTuple):
    """½ xᵀ weight x + costᵀ x with follow x = right and sides x <= limits; what is bounded is
    bounded x + apart.
    """

    weight: sp.csc_matrix
    cost: np.ndarray
    follow: sp.csc_matrix
    right: np.ndarray
    sides: sp.csc_matrix
    limits: np.ndarray
    bounded: np.ndarray
    apart: np.ndarray

    def found(self, x: np.ndarray, stages: int) -> np.ndarray:
        """States, inputs and what else is bounded, by stage."""
        return (self.bounded @ x[: self.bounded.shape[1]] + self.apart).reshape(stages, -1)


def sparse(problem: HorizonProblem) -> Sparse:
    """Return the programme in states, inputs and slacks of bounds."""
    shape = problem.shape
    z = shape.states
    w = shape.both
    n = shape.stages
    size = n * w + z
    both = w + shape.inputs
    follow = np.zeros((z * (n + 1), size))
    right = np.zeros(z * (n + 1))
    follow[:z, :z] = np.eye(z)
    right[:z] = problem.start
    bounded = np.zeros((n * both, size))
    offset = np.zeros(n * both)
    for k in range(n):
        rows = slice(z * (k + 1), z * (k + 2))
        columns = slice(k * w, (k + 1) * w)
        follow[rows, columns] = -np.hstack([problem.a[k], problem.b[k]])
        follow[rows, (k + 1) * w : (k + 1) * w + z] = np.eye(z)
        right[rows] = problem.c[k]
        bounded[k * both : k * both + w, columns] = np.eye(w)
        bounded[k * both + w : (k + 1) * both, columns] = problem.e[k]
        offset[k * both + w : (k + 1) * both] = problem.d[k]
    high, low = (np.tile(bound, n) for bound in (problem.high, problem.low))
    above = np.flatnonzero(high < NONE)
    below = np.flatnonzero(low > -NONE)
    price = np.tile(problem.price, n)
    scale = np.concatenate([price[above], price[below]]) / problem.price.max()
    count = len(scale)
    weight = [*[problem.weight] * n, problem.end, sp.csc_matrix((count, count))]
    limits = np.concatenate([(high - offset)[above], (offset - low)[below]]) * scale
    rows_of: list[list[Any]] = [
        [sp.diags(scale) @ np.vstack([bounded[above], -bounded[below]]), -sp.eye(count)],
        [None, -sp.eye(count)],
    ]
    return Sparse(
        sp.csc_matrix(sp.block_diag(weight)),
        np.concatenate(
            [problem.gradient.ravel(), problem.end_gradient, np.full(count, problem.price.max())]
        ),
        sp.csc_matrix(np.hstack([follow, np.zeros((len(follow), count))])),
        right,
        sp.csc_matrix(sp.bmat(rows_of)),
        np.concatenate([limits, np.zeros(count)]),
        bounded,
        offset,
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
    rows = sp.csc_matrix(sp.vstack([form.follow, form.sides]))
    limits = np.concatenate([form.right, form.limits])
    cones = [clarabel.ZeroConeT(len(form.right)), clarabel.NonnegativeConeT(len(form.limits))]

    def solve() -> np.ndarray:
        answer = clarabel.DefaultSolver(upper, form.cost, rows, limits, cones, settings).solve()
        return form.found(np.array(answer.x), n)

    return solve


def by_osqp(problem: HorizonProblem) -> Solve:
    """Solve by OSQP's operator splitting, to 1e-4."""
    import osqp

    form = sparse(problem)
    n = problem.shape.stages
    upper = sp.csc_matrix(sp.triu(form.weight))
    rows = sp.csc_matrix(sp.vstack([form.follow, form.sides]))
    high = np.concatenate([form.right, form.limits])
    low = np.concatenate([form.right, np.full(len(form.limits), -np.inf)])

    def solve() -> np.ndarray:
        solver = osqp.OSQP()
        solver.setup(upper, form.cost, rows, low, high, verbose=False, eps_abs=1e-4, eps_rel=1e-4)
        return form.found(np.array(solver.solve().x), n)

    return solve


def by_piqp(problem: HorizonProblem) -> Solve:
    """Solve by PIQP's proximal interior-point method, with its defaults."""
    import piqp

    form = sparse(problem)
    n = problem.shape.stages
    low = np.full(len(form.limits), -np.inf)

    def solve() -> np.ndarray:
        solver = piqp.SparseSolver()
        solver.setup(form.weight, form.cost, form.follow, form.right, form.sides, low, form.limits)
        solver.solve()
        return form.found(np.array(solver.result.x), n)

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
    high, low = (np.tile(bound, n)[z:] for bound in (problem.high, problem.low))
    real = (high < NONE) | (low > -NONE)
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
            return np.full((n, shape.both + m), np.nan)
        return np.array([row @ np.append(inputs, 1.0) for row in rows])

    return answer


SOLVERS: dict[str, Callable[[HorizonProblem], Solve]] = {
    "DAQP": by_daqp,
    "Clarabel": by_clarabel,
    "PIQP": by_piqp,
    "OSQP": by_osqp,
}
"""Those that are measured beside ours, by name."""
