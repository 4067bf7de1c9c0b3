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

RADAU_POINT_COUNT = 3
"""Number of Radau points of a step; the last of them is the end of the step."""

_RADAU = np.array(ca.collocation_points(RADAU_POINT_COUNT, "radau"))
"""Times of these points since the beginning of their step, as shares of its length."""

_coefficients = ca.collocation_coeff(_RADAU.tolist())

_DERIVATIVE_MATRIX = np.array(_coefficients[0])
"""Derivatives of the polynomial of a step at its Radau points, over the length of the step, by its
values at the beginning and at these points, shape (4, 3): values @ matrix = h dx/dt."""

_WEIGHTS = np.array(_coefficients[2])
"""Weights by which values at the Radau points are integrated over a step, as shares of its length,
shape (3, 1)."""

_GAPS = np.diff(_RADAU, append=1.0 + _RADAU[0])
"""Time from each Radau point to the next, as a share of the length of a step. The next point after
the end of a step is the first of a step that is as long."""

_OPTIONS: dict[str, Any] = {
    # IPOPT prints nothing; points of the search at which an expression is NaN are nothing to tell.
    "print_time": False,
    "show_eval_warnings": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.mu_init": 1e-2,
    # By default IPOPT widens all bounds, so that a plan would exceed its limits a little.
    "ipopt.bound_relax_factor": 0.0,
}
"""Options of CasADi and IPOPT that are the same for all programs."""

TOLERANCE = 1e-8
"""Relative error at which a motion counts as solved."""

ITERATIONS = 300
"""Largest number of iterations of the optimiser."""


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
    """An optimal control problem; expressions are in the symbols x, u and gap.

    Attributes:
        x: State, symbols, shape (nx,).
        u: Control, symbols, shape (nu,).
        gap: Time to the next point [s], as if the next interval lasted as long as this one; a
            symbol.
        rates: dx/dt, an expression in x and u, shape (nx,).
        cost: Cost per second, an expression in x and u; 1 for least time.
        path: Expressions in x, u, gap and the parameters, which stay within `path_bounds` at every
            point but the first, shape (np,).
        bounds: Least and largest state, shape (2, nx).
        control_bounds: Least and largest control, finite, shape (2, nu).
        path_bounds: Least and largest values of `path`, shape (2, np).
        scale: Typical size of each number of the state, shape (nx,), by which the program is
            scaled.
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
        durations: Durations of the n intervals [s], shape (n,).
        controls: Control over each interval, shape (n, nu).
        states: States at the start and at the Radau points of all steps, shape (1 + 3 n steps, nx).
    """

    durations: np.ndarray
    controls: np.ndarray
    states: np.ndarray


def times(durations: np.ndarray, steps: int = 1) -> np.ndarray:
    """Return the times of the states of a plan [s], shape (1 + 3 n steps,).

    Args:
        durations: Durations of its intervals [s], shape (n,).
        steps: Number of steps of each interval.
    """
    lengths = np.repeat(durations / steps, steps)
    ends = np.cumsum(lengths)
    # Each point counted back from the end of its step.
    points = ends[:, None] + lengths[:, None] * (_RADAU - 1.0)
    return np.concatenate([[0.0], points.ravel()])


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
        KeyboardInterrupt: If it is interrupted, as soon as an iteration is done; or whatever the
            handlers of SIGINT and SIGTERM raise that the program has installed.
    """
    layout = _UnknownsLayout.of(guess)
    control_scale = np.abs(problem.control_bounds).max(axis=0)
    scale = layout.pack(layout.constant_plan(1.0, control_scale, problem.scale))
    lowest = layout.constant_plan(shortest, problem.control_bounds[0], problem.bounds[0])
    highest = layout.constant_plan(longest, problem.control_bounds[1], problem.bounds[1])
    for bound in (lowest, highest):
        bound.states[[0, -1]] = guess.states[[0, -1]]

    program = _program(problem, layout, equal, scale)
    stop = _StopOnSignal(scale.size, program.lower.size)
    options = {
        **_OPTIONS,
        "ipopt.tol": tolerance,
        "ipopt.max_iter": iterations,
        "iteration_callback": stop,
    }
    expressions = {"x": program.unknowns, "f": program.cost, "g": program.constraints}
    solver = ca.nlpsol("plan", "ipopt", expressions, options)
    with defer_sigint() as signal_arrived:
        stop.signal_arrived = signal_arrived
        solution = solver(
            x0=layout.pack(guess) / scale,
            lbx=layout.pack(lowest) / scale,
            ubx=layout.pack(highest) / scale,
            lbg=program.lower,
            ubg=program.upper,
        )
    if not solver.stats()["success"]:
        raise Unsolved(solver.stats()["return_status"])
    return layout.unpack(solution["x"].full().ravel() * scale)


class _StopOnSignal(ca.Callback):  # type: ignore[misc]
    """Ends IPOPT after an iteration in which a signal came.

    CasADi would take the exception of a signal handler for a failure of the program, and not pass
    it on. So signals are deferred while IPOPT runs, and asked for after each iteration.

    Attributes:
        signal_arrived: Whether a signal came since the optimiser began.
    """

    def __init__(self, unknown_count: int, constraint_count: int) -> None:
        ca.Callback.__init__(self)
        # CasADi passes all that a solver returns. The callback is an option of the solver and made
        # before it, so that it has to say itself how long these vectors are.
        self._sizes = {
            "x": unknown_count,
            "lam_x": unknown_count,
            "g": constraint_count,
            "lam_g": constraint_count,
            "f": 1,
        }
        self.signal_arrived: Callable[[], bool] = lambda: False
        self.construct("stop", {})

    # `ca.Callback` asks for the numbers and sizes of inputs and outputs by these names.

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._sizes.get(ca.nlpsol_out(i), 0), 1)

    def eval(self, arg: Sequence[ca.DM]) -> list[int]:
        """Return 1 to end the optimiser, 0 to go on."""
        return [int(self.signal_arrived())]


@dataclass(frozen=True)
class _UnknownsLayout:
    """Order in which the vector of unknowns holds the numbers of a plan.

    First the durations, then the controls interval by interval, then the states point by point.

    Attributes:
        interval_count: Number of intervals, n.
        state_count: Number of states: one more than there are points.
        control_size: Length of a control, nu.
        state_size: Length of a state, nx.
    """

    interval_count: int
    state_count: int
    control_size: int
    state_size: int

    @classmethod
    def of(cls, plan: CollocationPlan) -> _UnknownsLayout:
        """Return the layout of plans of this size."""
        interval_count, control_size = plan.controls.shape
        state_count, state_size = plan.states.shape
        return cls(interval_count, state_count, control_size, state_size)

    @property
    def point_count(self) -> int:
        """Number of Radau points of all steps."""
        return self.state_count - 1

    @property
    def steps(self) -> int:
        """Number of steps of an interval."""
        return self.point_count // (RADAU_POINT_COUNT * self.interval_count)

    @property
    def offsets(self) -> list[int]:
        """Where durations, controls and states begin, and where the last end."""
        controls = self.interval_count
        states = controls + self.interval_count * self.control_size
        return [0, controls, states, states + self.state_count * self.state_size]

    def pack(self, plan: CollocationPlan) -> np.ndarray:
        """Return the vector of a plan."""
        return np.concatenate([plan.durations, plan.controls.ravel(), plan.states.ravel()])

    def unpack(self, numbers: np.ndarray) -> CollocationPlan:
        """Return the plan of a vector."""
        _, controls, states, _ = self.offsets
        return CollocationPlan(
            durations=numbers[:controls],
            controls=numbers[controls:states].reshape(self.interval_count, self.control_size),
            states=numbers[states:].reshape(self.state_count, self.state_size),
        )

    def unpack_symbols(self, unknowns: ca.MX) -> tuple[ca.MX, ca.MX, ca.MX]:
        """Return durations, shape (n,), controls, shape (nu, n), and states, shape (nx, states), of
        a vector of expressions. CasADi fills matrices column by column, so that these are the
        transposed ones of a plan.
        """
        durations, controls, states = ca.vertsplit(unknowns, self.offsets)
        return (
            durations,
            ca.reshape(controls, -1, self.interval_count),
            ca.reshape(states, -1, self.state_count),
        )

    def constant_plan(
        self, duration: float, control: np.ndarray, state: np.ndarray
    ) -> CollocationPlan:
        """Return a plan with one duration, one control and one state throughout."""
        return CollocationPlan(
            durations=np.full(self.interval_count, duration),
            controls=np.tile(control, (self.interval_count, 1)),
            states=np.tile(state, (self.state_count, 1)),
        )


@dataclass(frozen=True, eq=False)
class _Program:
    """A nonlinear program: least cost of unknowns whose constraints stay within bounds.

    Attributes:
        unknowns: Numbers of a plan over their scale, symbols.
        cost: The cost.
        constraints: Expressions that are constrained, shape (constraints,).
        lower: Their least values, shape (constraints,).
        upper: Their largest values, shape (constraints,).
    """

    unknowns: ca.MX
    cost: ca.MX
    constraints: ca.MX
    lower: np.ndarray
    upper: np.ndarray


def _program(problem: Problem, layout: _UnknownsLayout, equal: bool, scale: np.ndarray) -> _Program:
    """Return the program of a problem.

    Args:
        problem: The problem.
        layout: Order of the unknowns.
        equal: Whether all intervals last alike.
        scale: Size of each unknown, by which it is divided.
    """
    points = layout.point_count
    unknowns = ca.MX.sym("unknown", scale.size)
    durations, controls, states = layout.unpack_symbols(unknowns * scale)

    # Length of its step and control of each point, one column for a point.
    interval_of_point = np.repeat(
        np.arange(layout.interval_count), layout.steps * RADAU_POINT_COUNT
    ).tolist()
    h = (durations.T / layout.steps)[:, interval_of_point]
    u = controls[:, interval_of_point]
    x = states[:, 1:]
    rates, cost = _flow(problem, points)(x, u)

    # Collocation: at each point the derivative of the polynomial of its step is that of the system,
    # h dx/dt = h f(x, u).
    derivatives = states @ ca.sparsify(ca.DM(_derivative_matrix(points)))
    defects = derivatives - rates * ca.repmat(h, states.shape[0], 1)
    defects = ca.vec(defects / ca.repmat(problem.scale, 1, points))

    gaps = _at_all_points(_GAPS, points)
    values = np.zeros((0, points)) if problem.values is None else problem.values
    path = ca.vec(_path(problem, points)(x, u, gaps * h, ca.DM(values)))

    differences = durations[1:] - durations[:-1] if equal else ca.MX(0, 1)

    no_defects = np.zeros(defects.numel())
    no_differences = np.zeros(differences.numel())
    lowest_path = np.tile(problem.path_bounds[0], points)
    highest_path = np.tile(problem.path_bounds[1], points)
    return _Program(
        unknowns=unknowns,
        cost=ca.dot(cost * h, _at_all_points(_WEIGHTS, points)),
        constraints=ca.vertcat(defects, path, differences),
        lower=np.concatenate([no_defects, lowest_path, no_differences]),
        upper=np.concatenate([no_defects, highest_path, no_differences]),
    )


def _flow(problem: Problem, points: int) -> ca.Function:
    """Return dx/dt and cost per second as a function of states and controls, a column for each
    point.
    """
    arguments = [problem.x, problem.u]
    flow = ca.Function("flow", arguments, [problem.rates, problem.cost], {"cse": True})
    return flow.map(points)


def _path(problem: Problem, points: int) -> ca.Function:
    """Return the path expressions as a function of states, controls, gaps and parameters, a column
    for each point.
    """
    parameters = ca.SX(0, 1) if problem.parameters is None else problem.parameters
    arguments = [problem.x, problem.u, problem.gap, parameters]
    path = ca.Function("path", arguments, [problem.path], {"cse": True})
    return path.map(points)


def _derivative_matrix(points: int) -> np.ndarray:
    """Return the matrix by which the states of all steps give h dx/dt at all points, shape (1 +
    points, points). The first state of a step is the last of the one before.
    """
    matrix = np.zeros((points + 1, points))
    for k in range(0, points, RADAU_POINT_COUNT):
        matrix[k : k + RADAU_POINT_COUNT + 1, k : k + RADAU_POINT_COUNT] = _DERIVATIVE_MATRIX
    return matrix


def _at_all_points(shares: np.ndarray, points: int) -> ca.DM:
    """Return numbers of the Radau points of a step, repeated for all steps, shape (1, points)."""
    return ca.DM(np.tile(shares.ravel(), points // RADAU_POINT_COUNT)).T
