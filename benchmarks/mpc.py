"""Predictive control: what an optimisation costs in compiled code, beside other people's solvers on
the same quadratic programmes.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np

from benchmarks.conduct import print_tables
from benchmarks.horizon import SOLVERS, HorizonProblem, Solve
from benchmarks.timing import seconds
from cranedyn.checks import whole
from cranedyn.compiled.batch import simulate_batch
from cranedyn.compiled.horizon.receding import Receding, receding
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import Reference, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.references import flat, hold
from cranedyn.simulation.simulate import simulate
from experiments.harness import ResultTable
from experiments.scenarios.moves import AFTER, LIMITS, MOVES, RestToRest

MODULES = {"DAQP": "daqp", "Clarabel": "clarabel", "PIQP": "piqp", "OSQP": "osqp"}
"""Module of each solver of `benchmarks.horizon.SOLVERS`."""

BATCH_CRANES = 16
"""Number of cranes in a batch."""


class Optimised(NamedTuple):
    """An optimisation by the compiled code of this project.

    Attributes:
        taken: Processor time of the whole control instant [s]: prediction, solution, efforts.
        iterations: Iterations of the interior-point method; 0 where no bound is active.
        problem: The quadratic programme; None if it was not kept.
        found: The solution, see `benchmarks.horizon.Solve`; empty if the programme was not kept.
    """

    taken: float
    iterations: int
    problem: HorizonProblem | None
    found: np.ndarray


def controlled(crane: Crane, move: RestToRest, along: bool) -> tuple[State, Receding, Reference]:
    """Return start, controller and reference of a move along its path or to its goal."""
    start, goal = move.ends(crane)
    motion = flat(crane, start, goal, move.duration) if along else None
    reference = hold(crane, goal) if motion is None else motion
    return start, receding(crane, LIMITS, motion=motion), reference


def optimisations_of(crane: Crane, move: RestToRest, along: bool, stride: int) -> list[Optimised]:
    """Return all optimisations of a move; keep every n-th programme with active bounds."""
    start, controller, reference = controlled(crane, move, along)
    optimisations: list[Optimised] = []
    bounded = 0

    def timed(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        nonlocal bounded
        began = time.thread_time()
        command = controller(t, state, setpoint)
        seconds_spent = time.thread_time() - began
        if round(t / controller.programme.period) % controller.programme.ratio == 0:
            iterations = int(controller.status.iterations)
            bounded += iterations > 0
            keeps = iterations > 0 and bounded % stride == 0
            problem, solution = problem_of(controller) if keeps else (None, np.empty(0))
            optimisations.append(Optimised(seconds_spent, iterations, problem, solution))
        return command

    duration = move.duration + AFTER
    simulate(crane, timed, reference, start=start, duration=duration, engine="compiled")
    return optimisations


def batch_rate(crane: Crane, move: RestToRest, along: bool, rounds: int) -> float:
    """Return optimisations a second of 16 cranes on a thread, swinging by up to 0.02 rad."""
    start, controller, reference = controlled(crane, move, along)
    q = np.tile(start.q, (BATCH_CRANES, 1))
    v = np.tile(start.v, (BATCH_CRANES, 1))
    q[:, crane.swings] += np.linspace(0.0, 0.02, BATCH_CRANES)[:, None]
    duration = move.duration + AFTER
    task = partial(
        simulate_batch,
        crane,
        controller,
        reference,
        start=State(q, v),
        duration=duration,
        threads=1,
    )
    # The first run is not measured: it compiles.
    task()
    least = min(seconds(task, time.process_time) for _ in range(rounds))
    time_between = controller.programme.ratio * controller.programme.period
    return BATCH_CRANES * duration / (time_between * least)


def problem_of(controller: Receding) -> tuple[HorizonProblem, np.ndarray]:
    """Return the last programme of a controller and its solution.

    Both are read from the memory of the optimisation: blocks that all stages share, and then the
    blocks of each stage, at the places that `HorizonShape` gives by name.
    """
    shape = controller.programme.shape(1)
    work = controller.memory_of_optimisation()
    z = shape.states
    w = shape.variables
    m = shape.inputs
    stages = work[shape.first_stage :].reshape(shape.stages, shape.stage_size)

    def common(name: str, rows: int, columns: int) -> np.ndarray:
        """Return a matrix that all stages share, of the first crane of a batch."""
        return (
            work[shape.offset(name) :][: rows * shape.row_length]
            .reshape(rows, -1)[:, :columns]
            .copy()
        )

    def each(name: str, rows: int, columns: int) -> np.ndarray:
        """Return a matrix of each stage."""
        block = stages[:, shape.offset(name) :][:, : rows * shape.row_length]
        return block.reshape(len(stages), rows, -1)[:, :, :columns].copy()

    forward = each("forward", z, w)
    weight = common("weight", w, w)
    end = common("end", z, z)
    problem = HorizonProblem(
        a=forward[:, :, :z],
        b=forward[:, :, z:],
        c=each("shift", 1, z)[:, 0],
        e=each("extra", m, w),
        d=each("extra_shift", 1, w + m)[:, 0, w:],
        q=weight[:z, :z],
        r=weight[z:, z:],
        gradient=each("gradient", 1, w)[:, 0],
        low=common("low", 1, w + m)[0],
        high=common("high", 1, w + m)[0],
        price=common("price", 1, w + m)[0],
        start=common("start", 1, z)[0],
        # Only the lower triangle of a symmetric matrix is kept.
        end=np.tril(end) + np.tril(end, -1).T,
        end_gradient=common("end_gradient", 1, z)[0],
    )
    return problem, each("iterate", 1, w + m)[:, 0]


class _Answers(NamedTuple):
    """Results of a solver.

    Attributes:
        times: Processor time for each programme [s].
        costs: Cost of the solution of each programme.
    """

    times: np.ndarray
    costs: np.ndarray


def _answers(solver: Callable[[HorizonProblem], Solve], problems: list[HorizonProblem]) -> _Answers:
    """Solve each problem, then three times again, and return the shortest times."""
    times = []
    costs = []
    for problem in problems:
        task = solver(problem)
        costs.append(problem.value(task()))
        times.append(min(seconds(task, time.thread_time) for _ in range(3)))
    return _Answers(np.array(times), np.array(costs))


def repeated(
    crane: Crane, move: RestToRest, along: bool, stride: int, rounds: int
) -> list[Optimised]:
    """Run a move several times and return the shortest time of each optimisation."""
    runs = [optimisations_of(crane, move, along, stride) for _ in range(rounds)]
    result = []
    # The runs are the same but for their times: an item is one optimisation in all of them.
    for repetitions in zip(*runs, strict=True):
        shortest = min(repetition.taken for repetition in repetitions)
        result.append(repetitions[0]._replace(taken=shortest))
    return result


def measure_mpc(options: argparse.Namespace) -> list[ResultTable]:
    """Measure all moves along their paths and to their goals, and all solvers of programmes."""
    crane = load_crane()
    stride = whole("every", options.every, 1)
    rounds = whole("rounds", options.rounds, 1)
    rows = []
    programmes = list[Optimised]()
    # Largest number of programmes of a move that have bounds in the way.
    most = 0
    for name, along in (("along a flat path", True), ("to the goal", False)):
        optimisations: list[Optimised] = []
        for move in MOVES:
            of_move = repeated(crane, move, along, stride, rounds)
            most = max(most, sum(o.iterations > 0 for o in of_move))
            optimisations += of_move
        programmes += [o for o in optimisations if o.problem is not None]
        times = 1e3 * np.array([o.taken for o in optimisations])
        bound = np.array([o.iterations > 0 for o in optimisations])
        rows.append(
            (
                name,
                len(optimisations),
                float(np.median(times)),
                float(np.median(times[bound])) if bound.any() else None,
                float(times.max()),
                100.0 * float(bound.mean()),
                max(o.iterations for o in optimisations),
                float(np.median([batch_rate(crane, move, along, rounds) for move in MOVES])),
            )
        )
    columns = [
        ("moves", ""),
        ("optimisations", ",d"),
        ("median [ms]", ".3f"),
        ("median with bounds [ms]", ".3f"),
        ("most [ms]", ".3f"),
        ("with bounds [%]", ".0f"),
        ("most iterations", "d"),
        ("in a batch [1/s]", ",.0f"),
    ]
    ours = ResultTable(
        "A control instant with an optimisation, 10 states, 3 inputs, 40 stages",
        columns,
        rows,
        "Processor time of prediction, quadratic programme and efforts, called from Python; of "
        f"each the shortest of {rounds} runs. In a batch of 16 cranes, with steps.",
    )
    if not programmes:
        raise OutOfRange("every", stride, f"1 to {most}, the programmes of a move with bounds")
    return [ours, _beside(programmes)]


def _beside(programmes: Sequence[Optimised]) -> ResultTable:
    """Return the table of all solvers on the programmes that were kept."""
    problems: list[HorizonProblem] = []
    times_of_ours = []
    costs_of_ours = []
    for programme in programmes:
        if programme.problem is not None:
            problems.append(programme.problem)
            times_of_ours.append(programme.taken)
            costs_of_ours.append(programme.problem.value(programme.found))
    results = {
        "ours, all of the instant": _Answers(np.array(times_of_ours), np.array(costs_of_ours))
    }
    for name, solver in SOLVERS.items():
        if find_spec(MODULES[name]) is not None:
            results[name] = _answers(solver, problems)

    # The cost of what a solver did not solve is not a number.
    best = np.nanmin([result.costs for result in results.values()], axis=0)
    rows: list[tuple[float | str | None, ...]] = []
    for name, result in results.items():
        is_solved = np.isfinite(result.costs)
        largest_excess = None
        if is_solved.any():
            largest_excess = float(np.nanmax((result.costs - best) / np.abs(best)))
        median = 1e3 * float(np.median(result.times))
        most = 1e3 * float(result.times.max())
        rows.append((name, median, most, largest_excess, int((~is_solved).sum())))
    columns = [
        ("solver", ""),
        ("median [ms]", ".3f"),
        ("most [ms]", ".3f"),
        ("cost above the best", ".1e"),
        ("unsolved", "d"),
    ]
    return ResultTable(
        f"The same {len(problems)} quadratic programmes, all with bounds in the way",
        columns,
        rows,
        "Processor time, of each the shortest of three; of others from their matrices to their "
        "answer, prediction not counted. Cost: largest, as a share of the lowest that a solver "
        "found. DAQP cannot exceed a bound.",
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print."""
    kept = "keep every that manieth programme with bounds for the others (default 25)"
    every: dict[str, Any] = {"type": int, "default": 25, "help": kept}
    rounds: dict[str, Any] = {"type": int, "default": 3, "help": "runs of each move (default 3)"}
    return print_tables("mpc", __doc__, measure_mpc, argv, every=every, rounds=rounds)


if __name__ == "__main__":
    sys.exit(main())
