"""The benchmark of predictive control hands other solvers the programme that was solved."""

from __future__ import annotations

import pytest

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")

from benchmarks.mpc import problem_of
from cranedyn.compiled.horizon.receding import receding
from cranedyn.references import hold
from experiments.scenarios.moves import LIMITS
from tests.helpers import crane


@pytest.mark.slow
def test_the_programme_of_an_optimisation_has_its_solution() -> None:
    controller = receding(crane(), LIMITS)
    goal = crane().state(gamma=0.6, x=20.0, l=10.0)
    controller(0.0, crane().state(phi=0.05), hold(crane(), goal)(0.0))
    assert controller.status.iterations > 0
    problem, solution = problem_of(controller)
    assert problem.gap(solution) < 1e-9  # rounding
    longer = solution.copy()
    longer[:, :3] *= 1.01
    assert problem.value(solution) < problem.value(longer)
