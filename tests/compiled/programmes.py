"""Random quadratic programmes over a horizon, laid out for our solver and for others."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from llvmlite import ir

from cranedyn.compiled.horizon import interior, riccati
from cranedyn.compiled.horizon.memory import REPORT, Shape
from cranedyn.compiled.machine import Machine, translated


class Problem(NamedTuple):
    """States follow next = a state + b input + c; e (state, input) + d is bounded besides them."""

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

    @property
    def shape(self) -> Shape:
        """How large it is."""
        return Shape(self.a.shape[1], self.b.shape[2], len(self.a))

    def value(self, found: np.ndarray) -> float:
        """Cost of what is found, what exceeding bounds costs among it."""
        z, w = self.shape.states, self.shape.both
        last = self.a[-1] @ found[-1, :z] + self.b[-1] @ found[-1, z:w] + self.c[-1]
        weight = sp.block_diag([self.q, self.r]).toarray()
        both = found[:, :w]
        over = np.maximum(found - self.high, 0.0) + np.maximum(self.low - found, 0.0)
        cost = 0.5 * np.einsum("ki,ij,kj", both, weight, both) + (self.gradient * both).sum()
        return float(cost + 0.5 * last @ self.end @ last + (over @ self.price).sum())

    def gap(self, found: np.ndarray) -> float:
        """How far from the model what is found is."""
        z, w = self.shape.states, self.shape.both
        coming = (
            np.einsum("kij,kj->ki", self.a, found[:, :z])
            + np.einsum("kij,kj->ki", self.b, found[:, z:w])
            + self.c
        )
        besides = np.einsum("kij,kj->ki", self.e, found[:, :w]) + self.d
        apart = found[0, :z] - self.start, coming[:-1] - found[1:, :z], besides - found[:, w:]
        return max(float(np.abs(part).max()) for part in apart)


def random(rng: np.random.Generator, tight: float, shape: Shape) -> Problem:
    """A stable model of any numbers, with bounds that are met the more, the tighter they are."""
    z, m, n = shape.states, shape.inputs, shape.stages
    a = rng.normal(size=(z, z))
    a *= 0.99 / np.abs(np.linalg.eigvals(a)).max()
    both = shape.both + m
    q = np.diag(rng.uniform(0.1, 2.0, z))
    return Problem(
        a + 0.01 * rng.normal(size=(n, z, z)),
        0.3 * rng.normal(size=(z, m)) + 0.01 * rng.normal(size=(n, z, m)),
        0.05 * rng.normal(size=(n, z)),
        0.3 * rng.normal(size=(n, m, z + m)),
        0.1 * rng.normal(size=(n, m)),
        q,
        np.diag(rng.uniform(0.1, 1.0, m)),
        0.3 * rng.normal(size=(n, z + m)),
        -rng.uniform(0.3, 1.5, both) / tight,
        rng.uniform(0.3, 1.5, both) / tight,
        np.full(both, 1e3),
        rng.normal(size=z),
        5.0 * q,
    )


def made(shape: Shape) -> Machine:
    """The solver's code."""
    module = ir.Module()
    riccati.emit(module, shape)
    interior.emit(module, shape)
    return translated(module)


class Solved(NamedTuple):
    """What our solver found, by stage: states, inputs, and what is bounded besides; its report."""

    found: np.ndarray
    report: dict[str, float]


def solved(machine: Machine, problem: Problem) -> Solved:
    """By our solver."""
    shape, work = problem.shape, np.zeros(problem.shape.size)
    z, w, m = shape.states, shape.both, shape.inputs

    def common(name: str, i: int = 0) -> np.ndarray:
        return work[shape.place(name, i) :][: shape.lanes]

    stages = work[shape.first :].reshape(shape.padded, shape.stride)

    def put(name: str, values: np.ndarray, i: int = 0, first: int = 0) -> None:
        place = shape.place(name, i) + first
        stages[: shape.stages, place : place + values.shape[1]] = values

    for i in range(z):
        common("weight", i)[:z], common("end", i)[:z] = problem.q[i], problem.end[i]
        put("forward", np.hstack([problem.a[:, i], problem.b[:, i]]), i)
    for i in range(m):
        common("weight", z + i)[z:w] = problem.r[i]
        put("extra", problem.e[:, i], i)
    for j in range(w):
        put("columns", np.dstack([problem.a, problem.b])[:, :, j], j)
    put("shift", problem.c)
    put("gradient", problem.gradient)
    put("apart", problem.d, first=w)
    common("start")[:z] = problem.start
    common("low")[:], common("high")[:], common("price")[:] = -1e9, 1e9, problem.price[0]
    for name in ("low", "high", "price"):
        common(name)[: w + m] = getattr(problem, name)
    common("report")[REPORT.index("barrier")] = 0.1 * problem.price[0]
    machine.function("solve", 1)(work.ctypes.data)
    place = shape.place("here")
    found = stages[: shape.stages, place : place + w + m].copy()
    return Solved(found, dict(zip(REPORT, common("report").tolist(), strict=False)))


def by_clarabel(problem: Problem) -> np.ndarray:
    """By Clarabel, sparse, an excess of each bound as a variable."""
    import clarabel

    shape = problem.shape
    z, w, n = shape.states, shape.both, shape.stages
    size, both = n * w + z, w + shape.inputs
    follow, right = np.zeros((z * (n + 1), size)), np.zeros(z * (n + 1))
    follow[:z, :z], right[:z] = np.eye(z), problem.start
    bounded, apart = np.zeros((n * both, size)), np.zeros(n * both)
    for k in range(n):
        rows, here = slice(z * (k + 1), z * (k + 2)), slice(k * w, (k + 1) * w)
        follow[rows, here] = -np.hstack([problem.a[k], problem.b[k]])
        follow[rows, (k + 1) * w : (k + 1) * w + z] = np.eye(z)
        right[rows] = problem.c[k]
        bounded[k * both : k * both + w, here] = np.eye(w)
        bounded[k * both + w : (k + 1) * both, here] = problem.e[k]
        apart[k * both + w : (k + 1) * both] = problem.d[k]
    count = 2 * n * both
    weight = sp.block_diag(
        [*[sp.block_diag([problem.q, problem.r])] * n, problem.end, sp.csc_matrix((count, count))]
    )
    cost = np.concatenate([problem.gradient.ravel(), np.zeros(z), np.tile(problem.price, 2 * n)])
    sides = sp.csc_matrix(np.vstack([bounded, -bounded]))
    rows_of: list[list[Any]] = [
        [sp.csc_matrix(follow), None],
        [sides, -sp.eye(count)],
        [None, -sp.eye(count)],
    ]
    limits = np.concatenate([np.tile(problem.high, n) - apart, apart - np.tile(problem.low, n)])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
    answer = clarabel.DefaultSolver(
        sp.triu(weight, format="csc"),
        cost,
        sp.bmat(rows_of, format="csc"),
        np.concatenate([right, limits, np.zeros(count)]),
        [clarabel.ZeroConeT(len(right)), clarabel.NonnegativeConeT(2 * count)],
        settings,
    ).solve()
    return (bounded @ np.array(answer.x)[:size] + apart).reshape(n, both)


def by_daqp(problem: Problem) -> np.ndarray:
    """By DAQP, dense in the inputs, with bounds that cannot be exceeded."""
    from daqp import solve

    shape = problem.shape
    z, n, m = shape.states, shape.stages, shape.inputs
    width = n * m + 1
    state, rows = np.zeros((z, width)), []
    state[:, -1] = problem.start
    hessian, linear = np.zeros((width, width)), np.zeros(width)
    weight = sp.block_diag([problem.q, problem.r]).toarray()
    for k in range(n):
        inputs = np.zeros((m, width))
        inputs[:, k * m : (k + 1) * m] = np.eye(m)
        both = np.vstack([state, inputs])
        besides = problem.e[k] @ both
        besides[:, -1] += problem.d[k]
        rows.append(np.vstack([both, besides]))
        hessian += both.T @ weight @ both
        linear += problem.gradient[k] @ both
        state = problem.a[k] @ state + problem.b[k] @ inputs
        state[:, -1] += problem.c[k]
    hessian += state.T @ problem.end @ state
    # The state at the start is given: no input moves it.
    all_rows = np.vstack(rows)[z:]
    low = (np.tile(problem.low, n))[z:] - all_rows[:, -1]
    high = (np.tile(problem.high, n))[z:] - all_rows[:, -1]
    inputs, _, flag, _ = solve(
        np.ascontiguousarray(hessian[:-1, :-1]),
        hessian[:-1, -1] + linear[:-1],
        np.ascontiguousarray(all_rows[:, :-1]),
        high,
        low,
        np.zeros(len(low), dtype=np.int32),
    )
    assert flag == 1
    return np.array([row @ np.append(inputs, 1.0) for row in rows])
