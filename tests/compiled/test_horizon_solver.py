"""The structured quadratic programme in compiled code against solvers of other people."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from benchmarks.horizon import HorizonProblem, by_clarabel, by_daqp
from cranedyn.compiled.horizon.memory import HorizonShape
from cranedyn.compiled.machine import Machine
from tests.compiled.programmes import Solved, made, random, solved

SHAPE = HorizonShape(10, 3, 40)
PRODUCTS = 4 * SHAPE.stages * SHAPE.row_length
"""Slacks with multipliers: the sum of their products is the gap of duality, by which a cost is
above the best one at most."""


@pytest.mark.slow
@pytest.mark.skipif(
    importlib.util.find_spec("clarabel") is None,
    reason="clarabel is not installed: pip install 'cranedyn[benchmarks]'",
)
@pytest.mark.parametrize("tight", [0.3, 1.0, 2.0, 4.0])
def test_what_it_finds_costs_no_more_than_what_clarabel_finds(tight: float) -> None:
    rng = np.random.default_rng(int(10 * tight))
    for _ in range(4):
        problem = random(rng, tight, SHAPE)
        ours = solved(made(SHAPE), problem)
        theirs = by_clarabel(problem)()
        assert ours.report["solved"] == 1.0
        assert problem.gap(ours.found) < 1e-9  # rounding
        best = problem.value(theirs)
        gap = PRODUCTS * ours.report["gap"]
        assert gap < 3e-3  # the barrier ends at 1e-8 of where it begins
        # Clarabel stops at 1e-11 of its own scale.
        assert best - 1e-7 * (1.0 + abs(best)) < problem.value(ours.found) < best + gap + 1e-7


def check_against_daqp(machine: Machine, problem: HorizonProblem) -> Solved:
    """Keep bounds, at the cost of DAQP's answer, which cannot exceed them."""
    ours = solved(machine, problem)
    theirs = by_daqp(problem)()
    shape = problem.shape
    gap = 4 * shape.stages * shape.row_length * ours.report["gap"]
    best = problem.value(theirs)
    assert ours.report["solved"] == 1.0
    assert problem.gap(ours.found) < 1e-9  # rounding
    over = np.maximum(ours.found - problem.high, problem.low - ours.found).max()
    assert over < gap / problem.price[0] + 1e-12
    # DAQP may exceed a bound by its tolerance of 1e-6, which saves up to the price of it.
    assert abs(problem.value(ours.found) - best) < gap + 1e-6 * problem.price[0]
    return ours


def keepable(rng: np.random.Generator, shape: HorizonShape) -> HorizonProblem:
    """A problem whose bounds can be kept, at a price for which it pays to keep them."""
    problem = random(rng, 1.0, shape)
    inside = np.clip(problem.start, problem.low[: shape.states], problem.high[: shape.states])
    return problem._replace(
        start=0.2 * inside, c=0.2 * problem.c, price=np.full(shape.variables + shape.inputs, 1e3)
    )


def test_bounds_that_can_be_kept_are_kept_at_the_cost_that_daqp_finds() -> None:
    rng = np.random.default_rng(5)
    met = [check_against_daqp(made(SHAPE), keepable(rng, SHAPE)) for _ in range(8)]
    assert sum(one.report["iterations"] > 0.0 for one in met) >= 4


def test_without_a_bound_in_the_way_it_is_the_riccati_solution_at_once() -> None:
    problem = random(np.random.default_rng(3), 1e-3, SHAPE)
    ours = solved(made(SHAPE), problem)
    assert ours.report["iterations"] == 0.0
    assert ours.report["excess"] < 0.0
    np.testing.assert_allclose(ours.found, by_daqp(problem)(), atol=1e-9)  # rounding


@pytest.mark.parametrize(("states", "inputs", "stages"), [(4, 1, 7), (6, 2, 16), (8, 3, 9)])
@pytest.mark.slow
def test_problems_of_other_sizes_are_solved_as_well(states: int, inputs: int, stages: int) -> None:
    shape = HorizonShape(states, inputs, stages)
    machine = made(shape)
    rng = np.random.default_rng(states)
    for _ in range(4):
        check_against_daqp(machine, keepable(rng, shape))


@pytest.mark.slow
def test_the_cost_beyond_the_horizon_is_that_of_a_horizon_as_long_again() -> None:
    shape = HorizonShape(4, 1, 5)  # after many stages more the cost would change no more
    problem = random(np.random.default_rng(8), 1.0, shape)
    z = shape.states
    w = shape.variables
    work = np.zeros(shape.size)
    last = work[shape.first_stage :].reshape(shape.stages, shape.stage_size)[-1]
    a, b = problem.a[-1], problem.b[-1]
    weight = np.zeros((w, w))
    weight[:z, :z], weight[z:, z:] = problem.q, problem.r
    for i in range(w):
        work[shape.offset("weight", i) :][:w] = weight[i]
    for i in range(z):
        last[shape.offset("forward", i) :][:w] = [*a[i], *b[i]]
    machine = made(shape)
    machine.function("end", 1)(work.ctypes.data)
    cost = problem.q
    for _ in range(shape.stages):  # Riccati's equation of the model of the last stage
        gain = np.linalg.solve(problem.r + b.T @ cost @ b, b.T @ cost @ a)
        cost = problem.q + a.T @ cost @ (a - b @ gain)
    found = np.array([work[shape.offset("end", i) :][:z] for i in range(z)])
    lower = np.tril_indices(z)
    np.testing.assert_allclose(found[lower], cost[lower], rtol=1e-9, atol=1e-12)
