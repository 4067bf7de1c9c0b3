"""Random quadratic programmes over a horizon, laid out for our solver and for others."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from llvmlite import ir

from benchmarks.horizon import HorizonProblem
from cranedyn.compiled.horizon import interior, riccati
from cranedyn.compiled.horizon.memory import REPORT, HorizonShape
from cranedyn.compiled.machine import Machine, translate


def random(rng: np.random.Generator, tight: float, shape: HorizonShape) -> HorizonProblem:
    """A stable model of any numbers, with bounds that are met the more, the tighter they are."""
    z, m, n = shape.states, shape.inputs, shape.stages
    a = rng.normal(size=(z, z))
    a *= 0.99 / np.abs(np.linalg.eigvals(a)).max()
    both = shape.variables + m
    q = np.diag(rng.uniform(0.1, 2.0, z))
    return HorizonProblem(
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
        np.zeros(z),
    )


@cache
def made(shape: HorizonShape) -> Machine:
    """The solver's code, made once for each shape."""
    module = ir.Module()
    riccati.emit(module, shape, {})
    interior.emit(module, shape)
    return translate(module)


class Solved(NamedTuple):
    """What our solver found, by stage: states, inputs, and what is bounded besides; its report."""

    found: np.ndarray
    report: dict[str, float]


def solved(machine: Machine, problem: HorizonProblem) -> Solved:
    """By our solver."""
    shape = problem.shape
    work = np.zeros(problem.shape.size)
    z, w, m = shape.states, shape.variables, shape.inputs

    def common(name: str, i: int = 0) -> np.ndarray:
        return work[shape.offset(name, i) :][: shape.row_length]

    stages = work[shape.first_stage :].reshape(shape.stages, shape.stage_size)

    def put(name: str, values: np.ndarray, i: int = 0, first: int = 0) -> None:
        place = shape.offset(name, i) + first
        stages[:, place : place + values.shape[1]] = values

    for i in range(z):
        common("weight", i)[:z], common("end", i)[:z] = problem.q[i], problem.end[i]
        put("forward", np.hstack([problem.a[:, i], problem.b[:, i]]), i)
    for i, weights in enumerate(problem.r):
        common("weight", z + i)[z:w] = weights
        put("extra", problem.e[:, i], i)
    put("shift", problem.c)
    put("gradient", problem.gradient)
    put("extra_shift", problem.d, first=w)
    common("start")[:z] = problem.start
    common("low")[:], common("high")[:], common("price")[:] = -1e9, 1e9, problem.price[0]
    for name in ("low", "high", "price"):
        common(name)[: w + m] = getattr(problem, name)
    common("report")[REPORT.index("barrier")] = 0.1 * problem.price[0]
    machine.function("solve", 1)(work.ctypes.data)
    found = stages[:, shape.offset("iterate") :][:, : w + m].copy()
    return Solved(found, dict(zip(REPORT, common("report").tolist(), strict=False)))
