"""Controllers of other papers, each from its equations, and its published case computed again.

* `CraneMpc`: predictive control of B. Käpernick and K. Graichen, "Model predictive control of an
  overhead crane using constraint substitution", American Control Conference, 2013, as GRAMPC has it
  in its example Crane_2D (github.com/grampc/grampc at 6ea171c, version 2.3.3; configuration in its
  manual, listing 6.1.1). The paper itself was not read: model, weights, bounds and horizon are
  those of the example.
* `minimum_swing`: the container crane of Y. Sakawa and Y. Shindo (1982) and of K. L. Teo and C. J.
  Goh, with the numbers of D. Augustin and H. Maurer, "Sensitivity analysis and real-time control of
  a container crane under state constraints", Online Optimization of Large Scale Systems, Springer,
  2001, pp. 69-82. The problem, and the cost that is the reference, are those of MAPTOR
  (github.com/maptor/maptor at c484791, examples/container_crane) and agree with PSOPT's
  examples/crane; the papers were not read.
* The shapers of N. C. Singer and W. P. Seering (zero vibration and derivative, 1990) and of W.
  Singhose, W. Seering and N. Singer (extra insensitive, 1994) are `cranedyn.references.shaped`;
  `insensitivity` says for which errors of the frequency they leave less than a share of the swing.
  The published numbers are those of Klipper's documentation (github.com/Klipper3d/klipper at
  0a2e826, docs/Resonance_Compensation.md), which calls them approximate.

``cranedyn benchmark papers`` prints all of them beside ours. It needs the extra `optimal`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from cranedyn.errors import CraneError
from cranedyn.references.shaped import Shaper, ei, zv, zvd

# --- predictive control ---------------------------------------------------------------------------

GRAMPC_GRAVITY = 9.81
"""Gravity of the example [m/s²]."""

GRAMPC_HORIZON = 2.0
"""Horizon of the example [s]."""

GRAMPC_POINTS = 20
"""Points of the horizon."""

GRAMPC_WEIGHTS = (1.0, 2.0, 2.0, 1.0, 1.0, 4.0, 0.05, 0.05)
"""Weights of trolley, its rate, rope, its rate, angle, its rate, and of both accelerations."""

GRAMPC_ACCELERATION = 2.0
"""Largest acceleration of trolley and hoist [m/s²]."""

GRAMPC_SWING_RATE = 0.3
"""Largest rate of the angle [rad/s]."""

GRAMPC_ROPE = 2.0
"""Rope at start and goal [m]."""

GRAMPC_TRAVEL = (-2.0, 2.0)
"""Trolley at the start and at the goal [m]."""

GRAMPC_OBSTACLE = (0.2, 1.25)
"""Numbers a and b of the bound l cos φ <= a x² + b of the height of the load at its place x [1/m
and m]."""

GRAMPC_COST = 27.0826
"""Cost of the first plan of the example that GRAMPC's own program finds with MaxGradIter = 100 and
MaxMultIter = 5000; with 20 and 200 it is 27.0831."""

GRAMPC_PRINTED = {
    2.0: (-0.17181, 1.25362),
    4.0: (1.54854, 1.74070),
    6.0: (1.87513, 1.96693),
    8.0: (1.95723, 1.99830),
    10.0: (1.98861, 1.99992),
}
"""Trolley and rope at some times [m], as GRAMPC's own program wrote them with the configuration of
the example, which stops each optimisation after two steps of a gradient and begins one each 2 ms.
"""


class CraneMpc:
    """Predictive control of a trolley with its rope, in a plane.

    State: x, ẋ, l, l̇, φ, φ̇ with the angle φ by which the load lags. Inputs are the accelerations u₁
    of the trolley and u₂ of the hoist:

        φ̈ = (u₁ cos φ - g sin φ - 2 l̇ φ̇)/l

    In each call the sum of the squares of all deviations from the goal, with `GRAMPC_WEIGHTS`, is
    least over the horizon, under bounds of both inputs and of φ̇, and if wanted of the height of the
    load. Lengths and times may be scaled, so that the rope is as long as in the example, and a
    horizon as long for it.

    Attributes:
        cost: Cost of the last plan, in the units of the example.
    """

    def __init__(
        self,
        *,
        accelerations: Sequence[float],
        swing_rate: float,
        scale: float = 1.0,
        gravity: float = GRAMPC_GRAVITY,
        obstacle: Sequence[float] | None = None,
        hoists: bool = True,
    ) -> None:
        """Set up the optimisation.

        Args:
            accelerations: Largest accelerations of trolley and hoist [m/s²].
            swing_rate: Largest rate of the angle [rad/s].
            scale: Length that the unit of the example is here: rope over `GRAMPC_ROPE`.
            gravity: Gravity [m/s²].
            obstacle: Numbers a and b of `GRAMPC_OBSTACLE`; None for no obstacle.
            hoists: Whether the hoist is an input; else the rope stays as it is.

        Raises:
            CraneError: If CasADi is not installed.
        """
        casadi = _casadi()
        self._scale = scale
        # With lengths over L and times over √L accelerations stay what they are.
        self._time = math.sqrt(scale)
        largest = np.array(accelerations, dtype=float) * (1.0 if hoists else np.array([1.0, 0.0]))
        step = GRAMPC_HORIZON / (GRAMPC_POINTS - 1)

        def rates(x: Any, u: Any) -> Any:
            angle = (u[0] * casadi.cos(x[4]) - gravity * casadi.sin(x[4])) / x[2]
            return casadi.vertcat(x[1], u[0], x[3], u[1], x[5], angle - 2.0 * x[3] * x[5] / x[2])

        states = casadi.SX.sym("x", 6, GRAMPC_POINTS)
        inputs = casadi.SX.sym("u", 2, GRAMPC_POINTS)
        start = casadi.SX.sym("start", 6)
        goal = casadi.SX.sym("goal", 6)
        weights = GRAMPC_WEIGHTS
        cost = 0.0
        equations = [states[:, 0] - start]
        heights = []
        for k in range(GRAMPC_POINTS):
            deviation = states[:, k] - goal
            terms = [weights[i] * deviation[i] ** 2 for i in range(6)]
            terms += [weights[6 + i] * inputs[i, k] ** 2 for i in range(2)]
            share = 0.5 if k in (0, GRAMPC_POINTS - 1) else 1.0
            cost += share * step * casadi.sum1(casadi.vertcat(*terms))
            if k + 1 < GRAMPC_POINTS:
                # Heun's rule, as in the example.
                first = rates(states[:, k], inputs[:, k])
                second = rates(states[:, k] + step * first, inputs[:, k + 1])
                equations.append(states[:, k + 1] - states[:, k] - 0.5 * step * (first + second))
            if obstacle is not None and k > 0:
                rope = states[2, k]
                angle = states[4, k]
                # The angle of the example has the other sign.
                place = states[0, k] - casadi.sin(angle) * rope
                a, b = obstacle
                heights.append(casadi.cos(angle) * rope - a * place**2 - b)
        variables = casadi.vertcat(casadi.vec(states), casadi.vec(inputs))
        constraints = casadi.vertcat(*equations, *heights)
        self._lower = np.full(variables.shape[0], -np.inf)
        bounded = self._lower[: 6 * GRAMPC_POINTS].reshape(GRAMPC_POINTS, 6)
        # The first state is measured, and may be beyond the bound.
        bounded[1:, 5] = -swing_rate * self._time
        self._lower[6 * GRAMPC_POINTS :] = np.tile(-largest, GRAMPC_POINTS)
        self._upper = -self._lower
        self._least = np.concatenate([np.zeros(6 * GRAMPC_POINTS), np.full(len(heights), -np.inf)])
        self._most = np.zeros(6 * GRAMPC_POINTS + len(heights))
        problem = {
            "x": variables,
            "f": cost,
            "g": constraints,
            "p": casadi.vertcat(start, goal),
        }
        ipopt = {"print_level": 0, "sb": "yes", "max_iter": 60, "tol": 1e-6}
        # Each plan begins at the last one.
        ipopt |= {"warm_start_init_point": "yes", "mu_init": 1e-3}
        options = {"print_time": False, "ipopt": ipopt}
        self._solver = casadi.nlpsol("mpc", "ipopt", problem, options)
        self._guess: np.ndarray | None = None
        self.cost = math.nan

    def plan(self, state: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the best states and inputs over the horizon, shapes (points, 6) and (points, 2),
        in SI units; row k is k steps of `step` away.

        Args:
            state: The state now, shape (6,).
            goal: The state to go to, shape (6,).
        """
        scales = self._scales
        start = state / scales
        if self._guess is None:
            # The last points are inputs: none.
            self._guess = np.concatenate(
                [np.tile(start, GRAMPC_POINTS), np.zeros(2 * GRAMPC_POINTS)]
            )
        solution = self._solver(
            x0=self._guess,
            p=np.concatenate([start, goal / scales]),
            lbx=self._lower,
            ubx=self._upper,
            lbg=self._least,
            ubg=self._most,
        )
        self._guess = np.array(solution["x"]).ravel()
        self.cost = float(solution["f"])
        states = self._guess[: 6 * GRAMPC_POINTS].reshape(GRAMPC_POINTS, 6)
        inputs = self._guess[6 * GRAMPC_POINTS :].reshape(GRAMPC_POINTS, 2)
        return states * scales, inputs

    @property
    def step(self) -> float:
        """Time between the points of the horizon [s]."""
        return self._time * GRAMPC_HORIZON / (GRAMPC_POINTS - 1)

    @property
    def _scales(self) -> np.ndarray:
        """SI units of a unit of each state of the example."""
        length = self._scale
        rate = length / self._time
        return np.array([length, rate, length, rate, 1.0, 1.0 / self._time])


class MpcRun(NamedTuple):
    """The closed loop of the example.

    Attributes:
        t: Times [s], shape (rows,).
        x: States, shape (rows, 6).
    """

    t: np.ndarray
    x: np.ndarray


def _grampc_example() -> tuple[CraneMpc, np.ndarray, np.ndarray]:
    """Return the control of GRAMPC's example, its start and its goal."""
    control = CraneMpc(
        accelerations=[GRAMPC_ACCELERATION, GRAMPC_ACCELERATION],
        swing_rate=GRAMPC_SWING_RATE,
        obstacle=GRAMPC_OBSTACLE,
    )
    before, after = GRAMPC_TRAVEL
    start = np.array([before, 0.0, GRAMPC_ROPE, 0.0, 0.0, 0.0])
    goal = np.array([after, 0.0, GRAMPC_ROPE, 0.0, 0.0, 0.0])
    return control, start, goal


def grampc_run(duration: float = 10.0) -> MpcRun:
    """Return the closed loop of GRAMPC's example: from x = -2 m to 2 m, over an obstacle.

    It plans at each point of the horizon, and the accelerations between two points are those of the
    plan, straight lines. Plans in between would meet the bound of the rate at the next point alone,
    and go beyond it on the way.

    Args:
        duration: Duration [s].
    """
    control, state, goal = _grampc_example()
    times = control.step * np.arange(round(duration / control.step) + 1)
    rows = [state]
    for _ in times[1:]:
        _, inputs = control.plan(state, goal)
        state = integrated(_grampc_rates, state, inputs[0], inputs[1], control.step)
        rows.append(state)
    return MpcRun(times, np.array(rows))


_SUBSTEPS = 20
"""Steps of RK4 between two points: of 5 ms each, whose error is of the order of 1e-10."""


def _grampc_rates(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the rates of the state of `CraneMpc`, with the gravity of the example."""
    angle = u[0] * math.cos(x[4]) - GRAMPC_GRAVITY * math.sin(x[4]) - 2.0 * x[3] * x[5]
    return np.array([x[1], u[0], x[3], u[1], x[5], angle / x[2]])


def integrated(
    rates: Callable[[np.ndarray, np.ndarray], np.ndarray],
    state: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    period: float,
    substeps: int = _SUBSTEPS,
) -> np.ndarray:
    """Return the state after a period in which inputs go from one value to another on straight
    lines, by RK4.

    Args:
        rates: From state and inputs to the rates of the state.
        state: The state at the beginning.
        before: Inputs at the beginning.
        after: Inputs at the end.
        period: The period [s].
        substeps: Number of steps.
    """

    def inputs(share: float) -> np.ndarray:
        return before + share * (after - before)

    step = period / substeps
    for i in range(substeps):
        middle = inputs((i + 0.5) / substeps)
        first = rates(state, inputs(i / substeps))
        second = rates(state + 0.5 * step * first, middle)
        third = rates(state + 0.5 * step * second, middle)
        fourth = rates(state + step * third, inputs((i + 1.0) / substeps))
        state = state + step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
    return state


# --- least swing ----------------------------------------------------------------------------------

REFERENCE_COST = 0.0375195
"""Cost of the container crane that MAPTOR's example states as reference."""


@dataclass(frozen=True)
class ContainerCrane:
    """Numbers of the problem of least swing, by default those of Augustin and Maurer.

    With the angle x₃ by which the load leads, its rate x₆, the rope x₂ and the trolley x₁:

        ẍ₁ = u₁ + c₄ x₃        ẍ₂ = u₂        ẍ₃ = -(u₁ + c₅ x₃ + 2 ẋ₂ ẋ₃)/x₂

    Attributes:
        start: x₁ to x₆ at the start: trolley and rope [m], angle [rad], and their rates.
        goal: The same at the end.
        duration: Time for the move [s].
        c4: Number c₄ [m/s²]; 0 for a trolley whose acceleration is u₁.
        c5: Number c₅ [m/s²]; gravity for such a trolley.
        trolley: Largest u₁ to either side [m/s²].
        hoist: Smallest and largest u₂ [m/s²].
        rates: Largest rates of trolley and rope [m/s].
        weight: Weight ρ of the inputs in the cost ½ ∫ (x₃² + x₆² + ρ (u₁² + u₂²)) dt.
    """

    start: tuple[float, ...] = (0.0, 22.0, 0.0, 0.0, -1.0, 0.0)
    goal: tuple[float, ...] = (10.0, 14.0, 0.0, 2.5, 0.0, 0.0)
    duration: float = 9.0
    c4: float = 17.2656
    c5: float = 27.0756
    trolley: float = 2.83374
    hoist: tuple[float, float] = (-0.80865, 0.71265)
    rates: tuple[float, float] = (2.5, 1.0)
    weight: float = 0.01


class LeastSwing(NamedTuple):
    """A motion of least swing.

    Attributes:
        cost: Its cost.
        t: Times [s], shape (rows,).
        x: States, shape (rows, 6).
        u: Inputs, shape (rows, 2).
    """

    cost: float
    t: np.ndarray
    x: np.ndarray
    u: np.ndarray


def minimum_swing(crane: ContainerCrane, intervals: int = 90) -> LeastSwing:
    """Return the motion of least cost, by collocation of Hermite and Simpson with inputs that are
    linear between the rows: its error is of the order of the fourth power of a row.

    Args:
        crane: The problem.
        intervals: Number of intervals.

    Raises:
        CraneError: If CasADi is not installed, or the optimisation finds nothing.
    """
    casadi = _casadi()
    opti = casadi.Opti()
    x = opti.variable(6, intervals + 1)
    u = opti.variable(2, intervals + 1)
    step = crane.duration / intervals

    def rates(at: Any, by: Any) -> Any:
        angle = -(by[0] + crane.c5 * at[2] + 2.0 * at[4] * at[5]) / at[1]
        return casadi.vertcat(at[3], at[4], at[5], by[0] + crane.c4 * at[2], by[1], angle)

    def density(at: Any, by: Any) -> Any:
        return 0.5 * (at[2] ** 2 + at[5] ** 2 + crane.weight * (by[0] ** 2 + by[1] ** 2))

    cost = 0.0
    for k in range(intervals):
        before = x[:, k]
        after = x[:, k + 1]
        first = rates(before, u[:, k])
        last = rates(after, u[:, k + 1])
        middle = 0.5 * (before + after) + step / 8.0 * (first - last)
        between = 0.5 * (u[:, k] + u[:, k + 1])
        slope = first + 4.0 * rates(middle, between) + last
        opti.subject_to(after == before + step / 6.0 * slope)
        ends = density(before, u[:, k]) + density(after, u[:, k + 1])
        cost += step / 6.0 * (ends + 4.0 * density(middle, between))
    opti.subject_to(x[:, 0] == np.array(crane.start))
    opti.subject_to(x[:, intervals] == np.array(crane.goal))
    opti.subject_to(opti.bounded(-crane.trolley, u[0, :], crane.trolley))
    opti.subject_to(opti.bounded(crane.hoist[0], u[1, :], crane.hoist[1]))
    opti.subject_to(opti.bounded(-crane.rates[0], x[3, :], crane.rates[0]))
    opti.subject_to(opti.bounded(-crane.rates[1], x[4, :], crane.rates[1]))
    opti.minimize(cost)
    shares = np.linspace(0.0, 1.0, intervals + 1)
    guess = np.outer(crane.start, 1.0 - shares) + np.outer(crane.goal, shares)
    opti.set_initial(x, guess)
    opti.solver("ipopt", {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"})
    try:
        solution = opti.solve()
    except RuntimeError as error:
        raise CraneError(f"No motion of least swing was found: {error}") from error
    times = crane.duration * shares
    return LeastSwing(float(solution.value(cost)), times, solution.value(x).T, solution.value(u).T)


# --- input shaping --------------------------------------------------------------------------------

KLIPPER_RANGES = {"zv": (0.10, 0.05), "zvd": (0.05, 0.15), "ei": (0.05, 0.20)}
"""Share of vibration that is left, and the error of the frequency to either side up to which it is
not more, of each shaper, as Klipper's documentation prints them."""

_SHAPERS: dict[str, Callable[[], Shaper]] = {"zv": zv, "zvd": zvd, "ei": ei}


def insensitivity(shaper: Shaper, left: float) -> tuple[float, float]:
    """Return by how much the frequency may be lower and higher than assumed, as shares of it, for
    the swing left to be at most a share of that without the shaper.

    Args:
        shaper: The shaper.
        left: The share.
    """
    from scipy.optimize import brentq

    def excess(ratio: float) -> float:
        return float(shaper.residual(ratio)) - left

    ends = []
    for direction in (-1.0, 1.0):
        # Outwards in small steps to the first crossing, since beyond others may come. A shaper that
        # is just at its tolerance in the middle is within it.
        inner = 1.0
        while excess(inner + 0.005 * direction) <= 1e-9:
            inner += 0.005 * direction
        outer = inner + 0.005 * direction
        if excess(inner) >= 0.0:
            ends.append(abs(inner - 1.0))
            continue
        ends.append(abs(float(brentq(excess, inner, outer)) - 1.0))
    return ends[0], ends[1]


# --- all cases ------------------------------------------------------------------------------------


class Reproduced(NamedTuple):
    """A published number beside ours.

    Attributes:
        case: Which case.
        quantity: What it is, with its unit.
        published: The published number.
        ours: Ours.
    """

    case: str
    quantity: str
    published: float
    ours: float


@cache
def reproduced() -> tuple[Reproduced, ...]:
    """Return all published numbers beside ours."""
    found = [
        Reproduced(
            "Augustin, Maurer",
            "cost of the container crane",
            REFERENCE_COST,
            minimum_swing(ContainerCrane()).cost,
        )
    ]
    control, start, goal = _grampc_example()
    control.plan(start, goal)
    found.append(Reproduced("GRAMPC", "cost of the first plan", GRAMPC_COST, control.cost))
    run = grampc_run()
    for t, (trolley, rope) in GRAMPC_PRINTED.items():
        row = round(t / (run.t[1] - run.t[0]))
        found.append(Reproduced("GRAMPC", f"trolley after {t:g} s [m]", trolley, run.x[row, 0]))
        found.append(Reproduced("GRAMPC", f"rope after {t:g} s [m]", rope, run.x[row, 2]))
    for name, (left, stated) in KLIPPER_RANGES.items():
        ours = insensitivity(_SHAPERS[name](), left)
        for side, value in zip(("lower", "higher"), ours, strict=True):
            quantity = f"{100.0 * left:g} % left, {side} by [%]"
            found.append(Reproduced(f"shaper {name}", quantity, 100.0 * stated, 100.0 * value))
    return tuple(found)


def paper_table(found: Sequence[Reproduced]) -> str:
    """Return the table of published numbers beside ours."""
    lines = ["case              number                            published        ours"]
    for one in found:
        lines.append(f"{one.case:<18}{one.quantity:<32}{one.published:>11.6g}{one.ours:>12.6g}")
    return "\n".join(lines)


def _casadi() -> Any:
    """Return CasADi.

    Raises:
        CraneError: If it is not installed.
    """
    try:
        import casadi
    except ModuleNotFoundError as error:
        raise CraneError(
            "This needs CasADi, which is not installed: pip install 'cranedyn[optimal]'."
        ) from error
    return casadi
