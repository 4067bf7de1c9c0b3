"""Motions of least time or cost of any system dx/dt = f(x, u) under bounds, as a nonlinear program
for IPOPT.

The control is constant over each interval, and an interval has one or more steps. Over a step the
state is a polynomial of third degree that obeys the differential equation at the three Radau
points, the last of which is the end of the step: order 5 (Hairer & Wanner, Solving Ordinary
Differential Equations II, §IV.5). Unlike shooting this needs no derivatives of nested steps, so it
is faster.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from cranedyn.command import defer_sigint
from cranedyn.errors import CraneError

try:
    import casadi as ca
except ModuleNotFoundError as error:
    raise CraneError(
        "Optimal moves need CasADi, which is not installed: pip install 'cranedyn[optimal]'."
    ) from error

_POINTS = 3
_RADAU = np.array(ca.collocation_points(_POINTS, "radau"))
_SLOPES, _, _WEIGHTS = (np.array(matrix) for matrix in ca.collocation_coeff(_RADAU.tolist()))
_OPTIONS: dict[str, Any] = {
    "print_time": False,
    "show_eval_warnings": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.mu_init": 1e-2,
    "ipopt.bound_relax_factor": 0.0,
}

TOLERANCE, ITERATIONS = 1e-8, 300
"""Relative error at which a motion counts as solved, and most iterations."""

_GAPS = np.diff(_RADAU, append=1.0 + _RADAU[0])


class Unsolved(CraneError):
    """A program that the optimiser could not solve.

    Attributes:
        status: Status of IPOPT, for example ``"Infeasible_Problem_Detected"``.
    """

    def __init__(self, status: str) -> None:
        """Keep the status and phrase the sentence."""
        self.status = status
        super().__init__(
            f"The optimiser found no motion that keeps the limits; IPOPT ends with {status}."
        )


@dataclass(frozen=True, eq=False)
class Problem:
    """System, cost and bounds; expressions are in the symbols x, u and gap.

    Attributes:
        x: State, shape (nx,).
        u: Control, shape (nu,).
        gap: Time to the next point [s], as if the next interval lasted as long as this one.
        rates: dx/dt in x and u, shape (nx,).
        cost: Cost per second in x and u; 1 for least time.
        path: Expressions within `path_bounds` at every point but the first, in x, u and gap, shape
            (np,).
        bounds: Least and largest state, shape (2, nx).
        control_bounds: Least and largest control, finite, shape (2, nu).
        path_bounds: Shape (2, np).
        scale: Size of the state, shape (nx,).
        parameters: Symbols in `path` whose values differ from point to point, shape (nd,); None if
            there are none.
        values: Their values, shape (nd, points).
    """

    x: ca.SX
    u: ca.SX
    gap: ca.SX
    rates: ca.SX
    cost: ca.SX
    path: ca.SX
    bounds: np.ndarray
    control_bounds: np.ndarray
    path_bounds: np.ndarray
    scale: np.ndarray
    parameters: ca.SX | None = None
    values: np.ndarray | None = None


class CollocationPlan(NamedTuple):
    """A motion at the points of its steps.

    Attributes:
        durations: Of the intervals [s], shape (n,).
        controls: One for each interval, shape (n, nu).
        states: At the start and at the points of all steps, shape (1 + 3 n steps, nx).
    """

    durations: np.ndarray
    controls: np.ndarray
    states: np.ndarray


def times(durations: np.ndarray, steps: int = 1) -> np.ndarray:
    """Return the times of the states of a plan [s], shape (1 + 3 n steps,), by the durations of its
    intervals [s], shape (n,), of so many steps each.
    """
    lengths = np.repeat(durations / steps, steps)
    ends = np.cumsum(lengths)
    return np.concatenate([[0.0], (ends[:, None] + lengths[:, None] * (_RADAU - 1.0)).ravel()])


def solve(
    problem: Problem,
    guess: CollocationPlan,
    *,
    equal: bool,
    shortest: float = 0.0,
    longest: float = np.inf,
    tolerance: float = TOLERANCE,
    iterations: int = ITERATIONS,
) -> CollocationPlan:
    """Return the motion of least cost from the first to the last state of a guess.

    Args:
        problem: System, cost and bounds.
        guess: First plan of the search. Its first and last states are kept, and so is the number of
            its intervals and steps.
        equal: Whether all intervals last alike, or each as long as suits, so that the control
            switches when it should.
        shortest: Least duration of an interval [s].
        longest: Largest duration of an interval [s].
        tolerance: Relative error at which the optimiser ends.
        iterations: Most iterations of the optimiser.

    Raises:
        Unsolved: If the optimiser does not converge.
        KeyboardInterrupt: If it is interrupted, as soon as an iteration is done; or what else the
            program does on SIGINT and SIGTERM.
    """
    controls, states = np.abs(problem.control_bounds).max(axis=0), problem.scale
    scale = _pack(_alike(guess, 1.0, controls, states))
    limits = zip((shortest, longest), problem.control_bounds, problem.bounds, strict=True)
    bounds = [_alike(guess, *limit) for limit in limits]
    for bound in bounds:
        bound.states[[0, -1]] = guess.states[[0, -1]]
    lower, upper = (_pack(bound) / scale for bound in bounds)
    program, low, high = _program(problem, guess, equal, scale)
    stop = _Stop(scale.size, low.size)
    options = {"ipopt.tol": tolerance, "ipopt.max_iter": iterations, "iteration_callback": stop}
    solver = ca.nlpsol("plan", "ipopt", program, _OPTIONS | options)
    with defer_sigint() as stop.arrived:
        solution = solver(x0=_pack(guess) / scale, lbx=lower, ubx=upper, lbg=low, ubg=high)
    if not solver.stats()["success"]:
        raise Unsolved(solver.stats()["return_status"])
    solved = solution["x"].full().ravel() * scale
    parts = np.split(solved, np.cumsum([part.size for part in guess])[:-1])
    shaped = (part.reshape(like.shape) for part, like in zip(parts, guess, strict=True))
    return CollocationPlan(*shaped)


class _Stop(ca.Callback):  # type: ignore[misc]
    """Ends IPOPT after an iteration in which a signal came, which CasADi would take for a failure
    of the program and not pass on.
    """

    def __init__(self, unknowns: int, constraints: int) -> None:
        ca.Callback.__init__(self)
        self._sizes = {"x": unknowns, "lam_x": unknowns, "g": constraints, "lam_g": constraints}
        self.arrived: Callable[[], bool] = lambda: False
        self.construct("stop", {})

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        name = ca.nlpsol_out(i)
        return ca.Sparsity.dense(1 if name == "f" else self._sizes.get(name, 0), 1)

    def eval(self, arg: Sequence[ca.DM]) -> list[int]:
        return [int(self.arrived())]


def _pack(plan: CollocationPlan) -> np.ndarray:
    return np.concatenate([array.ravel() for array in plan])


def _alike(
    plan: CollocationPlan, duration: float, control: np.ndarray, state: np.ndarray
) -> CollocationPlan:
    """Return a plan of the same size with one duration, one control and one state throughout."""
    controls = np.tile(control, (len(plan.controls), 1))
    states = np.tile(state, (len(plan.states), 1))
    return CollocationPlan(np.full_like(plan.durations, duration), controls, states)


def _program(
    problem: Problem, guess: CollocationPlan, equal: bool, scale: np.ndarray
) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
    """Return scaled unknowns, cost and constraints, with the bounds of the constraints."""
    n, points = len(guess.durations), len(guess.states) - 1
    steps = points // (_POINTS * n)
    unknown = ca.MX.sym("unknown", scale.size)
    durations, controls, states = ca.vertsplit(
        unknown * scale, np.cumsum([0, *(array.size for array in guess)]).tolist()
    )
    of_point = np.repeat(np.arange(n), steps * _POINTS).tolist()
    h = (durations.T / steps)[:, of_point]
    u = ca.reshape(controls, -1, n)[:, of_point]
    x = ca.reshape(states, -1, points + 1)
    slopes = np.zeros((points + 1, points))
    for k in range(0, points, _POINTS):
        slopes[k : k + _POINTS + 1, k : k + _POINTS] = _SLOPES
    flow = ca.Function(
        "flow", [problem.x, problem.u], [problem.rates, problem.cost], {"cse": True}
    ).map(points)
    parameters = ca.SX(0, 1) if problem.parameters is None else problem.parameters
    values = np.zeros((0, points)) if problem.values is None else problem.values
    path = ca.Function(
        "path", [problem.x, problem.u, problem.gap, parameters], [problem.path], {"cse": True}
    ).map(points)
    rates, cost = flow(x[:, 1:], u)
    defects = x @ ca.sparsify(ca.DM(slopes)) - rates * ca.repmat(h, x.shape[0], 1)
    defects = ca.vec(defects / ca.repmat(problem.scale, 1, points))
    unequal = durations[1:] - durations[:-1] if equal else ca.MX(0, 1)
    first, last = np.zeros(defects.numel()), np.zeros(unequal.numel())
    limits = (np.tile(bound, points) for bound in problem.path_bounds)
    low, high = (np.concatenate([first, limit, last]) for limit in limits)
    gaps, weights = (
        ca.DM(np.tile(shares.ravel(), points // _POINTS)).T for shares in (_GAPS, _WEIGHTS)
    )
    constraints = ca.vertcat(defects, ca.vec(path(x[:, 1:], u, gaps * h, ca.DM(values))), unequal)
    return {"x": unknown, "f": ca.dot(cost * h, weights), "g": constraints}, low, high
