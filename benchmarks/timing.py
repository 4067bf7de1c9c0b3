"""Measuring in turn, in shuffled rounds: what else the machine does meets everyone alike."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.workload import DURATION, Case, Run
from cranedyn.errors import CraneError


def seconds(task: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> float:
    """Time of one call by a clock: wall time, since some tasks use several processors."""
    before = clock()
    task()
    return clock() - before


def fresh(script: str, *arguments: str) -> str:
    """Run a script in a fresh process, as users start it. From the second time on Python finds the
    modules compiled, also where this environment forbids bytecode files.

    Returns:
        What it printed.

    Raises:
        CraneError: If it fails.
    """
    usual = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    done = subprocess.run(
        [sys.executable, "-c", script, *arguments],
        cwd=Path(__file__).parents[1],
        env=usual,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise CraneError(f"A process that was measured failed: {done.stderr}")
    return done.stdout


def race(
    tasks: Sequence[Callable[[], object]],
    rounds: int,
    rng: np.random.Generator,
    clock: Callable[[], float] = time.perf_counter,
) -> np.ndarray:
    """Return the time of each task in each round by a clock [s], shape (tasks, rounds); the order
    is shuffled in every round.
    """
    times = np.empty((len(tasks), rounds))
    for k in range(rounds):
        for i in rng.permutation(len(tasks)):
            times[i, k] = seconds(tasks[i], clock)
    return times


def stretch(case: Case, run: Run, cranes: int, budget: float) -> float:
    """Return the simulated time [s] that takes a contestant about a wall time [s], between a
    control period and 70 s.

    It is longer where a run has fixed costs, such as laying out many cranes, so that these are
    about a tenth of it.
    """
    starts = case.starts(cranes)
    most_periods = case.periods(DURATION)
    run(starts, case.period)
    periods = 1
    fixed = seconds(lambda: run(starts, case.period))
    elapsed = fixed
    while elapsed < 0.1 * budget + fixed and periods < most_periods:
        periods = min(10 * periods, most_periods)
        elapsed = seconds(partial(run, starts, periods * case.period))
    period_time = elapsed / periods
    if periods > 1 and elapsed > fixed:
        period_time = (elapsed - fixed) / (periods - 1)
    periods = round(max(budget, 10.0 * (fixed - period_time)) / period_time)
    return min(max(periods, 1), most_periods) * case.period


def step_rates(
    case: Case,
    entries: Sequence[tuple[Run, int]],
    rounds: int,
    budget: float,
    rng: np.random.Generator,
) -> np.ndarray:
    """Return the physics steps a second of each entry in each round, shape (entries, rounds).

    Args:
        case: What to run.
        entries: How, and how many cranes together.
        rounds: How often.
        budget: How long each takes in a round [s]; a run is cut to fit, see `stretch`.
        rng: Shuffles the rounds.
    """
    lengths = [stretch(case, run, cranes, budget) for run, cranes in entries]
    tasks = [
        partial(run, case.starts(cranes), length)
        for (run, cranes), length in zip(entries, lengths, strict=True)
    ]
    periods = [
        cranes * case.periods(length) for (_, cranes), length in zip(entries, lengths, strict=True)
    ]
    return case.steps * np.array(periods)[:, None] / race(tasks, rounds, rng)
