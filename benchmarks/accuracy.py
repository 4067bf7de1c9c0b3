"""What a stepping rule costs and what it errs by, and how long each way takes from the start of
Python to its first step.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp

from benchmarks.conduct import Results, conduct
from benchmarks.contestants import CONTESTANTS
from benchmarks.timing import fresh, race
from benchmarks.workload import Case, Contestant
from cranedyn.analysis.swing import zero_crossings
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics import equations_of_motion as dynamics
from cranedyn.dynamics.integrators import Integrator, rk4, semi_implicit_euler
from cranedyn.errors import CraneError
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.plotting.figures import legend_above, panels
from cranedyn.simulation.simulate import simulate
from experiments.harness.outcome import ResultTable

INTEGRATORS = (semi_implicit_euler, rk4)
"""Integrators that are compared."""

STEPS = (1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4)
"""Physics steps [s]; each divides the control period."""

DURATION = 10.0
"""Duration of the run [s]."""

PERIOD = 1e-2
"""Control period [s]."""

_MARKS = "os^Dv"
"""Marks of curves; they repeat."""

_FIRST_STEP = """
import sys
from benchmarks.contestants import CONTESTANTS
from benchmarks.workload import Case
case = Case()
(one,) = (one for one in CONTESTANTS if one.name == sys.argv[1])
one.prepare(case)(case.starts(1), case.period)
"""
"""Script that runs one control period by the contestant of a name."""


@dataclass(frozen=True)
class Errors:
    """Errors of a run against an exact solution.

    Attributes:
        place: Largest distance of the payload from where it should be [m].
        period: Error of the period of the radial swing [s].
        energy: Most energy that the ledger does not explain [J].
    """

    place: float
    period: float
    energy: float


def reference(case: Case, duration: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times [s] and exact coordinates at the control instants, shapes (n,) and (n, 5).

    Dormand and Prince's method of order 8 on `pin.aba`, started anew at each control instant
    because the efforts jump there. Its tolerances are as small as rounding allows.
    """
    crane = case.crane
    n = case.n
    hold = case.controller
    limit = case.crane.effort_limit
    times = case.period * np.arange(case.periods(duration) + 1)
    # Coordinates, then rates.
    rows = np.empty((len(times), 2 * n))
    rows[0] = case.starts(1)[0]

    def derivative(t: float, y: np.ndarray, effort: np.ndarray) -> np.ndarray:
        q = y[:n]
        v = y[n:]
        return np.concatenate([v, dynamics.acceleration(crane, State(q, v), effort)])

    drives = crane.layout.drives
    for k in range(len(rows) - 1):
        q = rows[k, :n]
        v = rows[k, n:]
        offset = rows[0, drives] - q[drives]
        effort = hold.feed_forward + hold.stiffness * offset - hold.damping * v[drives]
        solution = solve_ivp(
            derivative,
            (0.0, case.period),
            rows[k],
            method="DOP853",
            rtol=1e-13,
            atol=1e-15,
            args=(effort.clip(-limit, limit),),
        )
        rows[k + 1] = solution.y[:, -1]
    return times, rows[:, :n]


def swung(case: Case, integrator: Integrator, duration: float) -> Trajectory:
    """Simulate the same run with an integrator, with the step of the case."""
    q, v = np.split(case.starts(1)[0], 2)
    return simulate(
        case.crane,
        case.controller,
        start=State(q, v),
        duration=duration,
        dt=case.dt,
        control_period=case.period,
        integrator=integrator,
    )


def errors(crane: Crane, run: Trajectory, times: np.ndarray, exact: np.ndarray) -> Errors:
    """Return the errors of a run against exact coordinates at control instants, shape (n, 5)."""
    distance = 0.0
    for q, exact_q in zip(run.q, exact, strict=True):
        offset = dynamics.payload_position(crane, q) - dynamics.payload_position(crane, exact_q)
        distance = max(distance, float(np.linalg.norm(offset)))
    period = _period(times, run["phi_rad"]) - _period(times, exact[:, 2])
    return Errors(distance, abs(period), float(np.abs(run.unexplained).max()))


def _period(t: np.ndarray, swing: np.ndarray) -> float:
    """Return the mean period of a swing [s]: twice the time between two crossings of zero."""
    crossings = zero_crossings(t, swing)
    return 2.0 * float(crossings[-1] - crossings[0]) / (len(crossings) - 1)


def integrators(
    rounds: int,
    rng: np.random.Generator,
    *,
    steps: Sequence[float] = STEPS,
    duration: float = DURATION,
) -> ResultTable:
    """Return cost and errors of each integrator at each step."""
    crane = Case().crane
    times, exact = reference(Case(crane, period=PERIOD), duration)
    cases = list(itertools.product(INTEGRATORS, [Case(crane, dt, PERIOD) for dt in steps]))
    # These runs are not measured: so nothing in the race is a first.
    runs = [swung(case, rule, duration) for rule, case in cases]
    tasks = [partial(swung, case, rule, duration) for rule, case in cases]
    costs = np.median(race(tasks, rounds, rng), axis=1) / duration
    rows = []
    for (rule, case), run, cost in zip(cases, runs, costs, strict=True):
        error = errors(crane, run, times, exact)
        rows.append(
            (rule.name, 1e3 * case.dt, 1e3 * float(cost), error.place, error.period, error.energy)
        )
    columns = [
        ("integrator", ""),
        ("step [ms]", "g"),
        ("ms per simulated s", ".3g"),
        ("payload off [m]", ".1e"),
        ("period off [s]", ".1e"),
        ("energy off [J]", ".1e"),
    ]
    note = (
        f"Free swing of 0.1 rad at 15 m for {duration:g} s with the drives held at "
        f"{1.0 / PERIOD:g} Hz, against a solution of order 8 with "
        f"tolerance 1e-13. Cost: median of {rounds} shuffled rounds of the whole plain loop. "
        "Payload off: its largest distance from where "
        f"it should be. Energy off: the most that the ledger does not explain."
    )
    return ResultTable("Error against cost", columns, rows, note)


def start_up(
    rounds: int, rng: np.random.Generator, contestants: Sequence[Contestant] = CONTESTANTS
) -> ResultTable:
    """Return the wall time of fresh processes until the first control period is done."""
    names = []
    for contestant in contestants:
        if contestant.missing() is None and _can_start(contestant.name):
            names.append(contestant.name)
    tasks = [partial(fresh, "pass")]
    for name in names:
        tasks.append(partial(fresh, _FIRST_STEP, name))
    times = np.median(race(tasks, rounds, rng), axis=1)
    note = (
        "Wall time of a process from the start of Python until one control period is simulated, "
        f"median of {rounds} shuffled rounds. "
        f"All but the first import cranedyn, load the crane and make its controller; C is compiled."
    )
    rows = []
    for name, seconds in zip(["Python, nothing else", *names], times, strict=True):
        rows.append((name, 1e3 * float(seconds)))
    return ResultTable("To the first step", [("strategy", ""), ("ms", ".0f")], rows, note)


def _can_start(name: str) -> bool:
    """Return whether a contestant reaches its first step in a process of its own."""
    try:
        fresh(_FIRST_STEP, name)
    except CraneError:
        return False
    return True


def accuracy_figure(table: ResultTable) -> Figure:
    """Plot the largest payload error against the step and against the cost."""
    figure, (left, right) = panels(1, 2, height=4.0, sharey=True)
    names = list(dict.fromkeys(row[0] for row in table.rows))
    for k, name in enumerate(names):
        numbers = [row[1:4] for row in table.rows if row[0] == name]
        steps, costs, place_errors = np.array(numbers, dtype=float).T
        mark = _MARKS[k % len(_MARKS)]
        left.plot(steps, place_errors, marker=mark, label=name)
        right.plot(costs, place_errors, marker=mark, label=name)
    left.set(xscale="log", yscale="log", xlabel="physics step [ms]", ylabel="payload off by [m]")
    decades = np.log10(np.array([row[2] for row in table.rows], dtype=float))
    # Whole decades, so that the axis has numbers at both ends.
    limits = 10.0 ** np.floor(decades.min()), 10.0 ** np.ceil(decades.max())
    right.set(xscale="log", xlim=limits, xlabel="computing time per simulated second [ms]")
    legend_above(left)
    return figure


def accuracy_benchmark(rounds: int, quick: bool) -> Results:
    """Return both tables and the figure; quick leaves out the finest steps."""
    rng = np.random.default_rng(0)
    table = integrators(rounds, rng, steps=STEPS[:5] if quick else STEPS)
    return [table, start_up(rounds, rng)], lambda: accuracy_figure(table)


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    return conduct("accuracy", __doc__, accuracy_benchmark, argv, rounds=3)


if __name__ == "__main__":
    sys.exit(main())
