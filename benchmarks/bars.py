"""What may not become slower: each workload as a ratio to work of the same kind that is not ours,
measured side by side in one run, against a bar 15 % below what it usually is.
"""

from __future__ import annotations

import argparse
import random
import resource
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from time import process_time

import numpy as np

from benchmarks.loop import bare_calls
from benchmarks.timing import fresh
from benchmarks.workload import Case, plain
from cranedyn.command import command
from cranedyn.compiled.batch import simulate_batch
from cranedyn.interfaces import Controller, EngineName, State
from cranedyn.model.load import load_crane
from experiments.harness.outcome import Outcome, ResultTable, show

SHARE = 0.85
"""Share of its usual ratio that each workload must reach."""

SECONDS = 90.0
"""Processor time after which who has not passed has failed."""

_ROUNDS = 20
"""Rounds before anybody has passed, and between two looks at who has."""

_OTHERS = "import numpy, pinocchio"
"""Script that imports what is not ours."""

_FIRST_STEP = """
from cranedyn import load_crane, simulate
from cranedyn.controllers import hold_controller
crane = load_crane()
simulate(crane, hold_controller(crane), duration=5e-3, engine="compiled")
"""
"""Script that does the first compiled control period of a process."""


@dataclass(frozen=True)
class Workload:
    """Work whose time is measured.

    Attributes:
        run: Function that does it once.
        amount: How much it does then, such as a number of steps.
        every: Number of rounds in one of which it is done, 1 for each.
        clock: Function that returns the processor time so far [s] of what does it.
    """

    run: Callable[[], object]
    amount: float = 1.0
    every: int = 1
    clock: Callable[[], float] = process_time


@dataclass(frozen=True)
class Bar:
    """Work of ours, and the work that it is compared with.

    Attributes:
        name: Name of the work.
        work: Our work.
        yardstick: Work that is not ours. What a computer is slow at, it is slow at in both.
        usual: How much of our work is done in the time of one of the yardstick, on two cores of a
            server with AVX-512.
    """

    name: str
    work: Workload
    yardstick: Workload
    usual: float


def all_bars() -> list[Bar]:
    """Return all bars; each workload takes about 20 ms, except the processes."""
    case = Case()
    hook = Case(load_crane(hook_mass=200.0))
    aba_calls = Workload(partial(bare_calls, case.crane, 6000), 6000)
    imports = Workload(partial(fresh, _OTHERS), 1.0, _ROUNDS // 5, _of_children)
    first = Workload(partial(fresh, _FIRST_STEP), 1.0, _ROUNDS // 5, _of_children)
    return [
        Bar("plain loop", _run(case, 1.0), aba_calls, 0.33),
        Bar("Python controller, compiled steps", _stepping(case, 10.0), aba_calls, 3.6),
        Bar("compiled closed loop", _closed(case, 70.0), aba_calls, 40.0),
        Bar("compiled batch, 1 thread", _batch(case, 1.0), aba_calls, 230.0),
        Bar("double pendulum: plain loop", _run(hook, 1.0), aba_calls, 0.285),
        Bar("double pendulum: compiled closed loop", _closed(hook, 35.0), aba_calls, 19.5),
        Bar("first compiled step of a process", first, imports, 0.35),
    ]


def _run(
    case: Case,
    duration: float,
    *,
    engine: EngineName = "pinocchio",
    controller: Controller | None = None,
) -> Workload:
    """Return the run of one crane for a simulated time [s], by default in the plain loop."""
    start = case.starts(1)[0]
    run = partial(plain, case, start, duration, engine=engine, controller=controller)
    return Workload(run, case.periods(duration) * case.steps)


def _closed(case: Case, duration: float) -> Workload:
    """Return the run of one crane with control and steps compiled."""
    return _run(case, duration, engine="compiled")


def _stepping(case: Case, duration: float) -> Workload:
    """Return the run of one crane with steps compiled and control in Python.

    The engine does not look into a `partial`, and so cannot compile the controller.
    """
    return _run(case, duration, engine="compiled", controller=partial(case.controller))


def _batch(case: Case, duration: float, cranes: int = 512) -> Workload:
    """Return the run of many cranes on one thread."""
    q, v = np.split(case.starts(cranes), 2, axis=1)
    run = partial(
        simulate_batch,
        case.crane,
        case.controller,
        start=State(q, v),
        duration=duration,
        threads=1,
    )
    return Workload(run, cranes * case.periods(duration) * case.steps)


def _of_children() -> float:
    """Return the processor time of all processes that this one has started and that ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def measure_bars(bars: Sequence[Bar], seconds: float, share: float = SHARE) -> list[float]:
    """Return the ratio of each bar, once all are at their bars or the time is over.

    Everything takes turns in shuffled rounds, and its least processor time counts: it is the same
    work every time, and whatever else the machine does only adds to it.

    Args:
        bars: What to measure.
        seconds: Processor time after which to give up [s].
        share: Share of their usual ratios that is asked for.
    """
    # Several bars share a yardstick, which is measured once.
    works: list[Workload] = []
    for bar in bars:
        for work in (bar.work, bar.yardstick):
            if not any(work is other for other in works):
                works.append(work)
    least_times = {id(work): float("inf") for work in works}
    end = process_time() + seconds
    shuffled = random.Random(0)
    # The first run of each is not measured: it may compile.
    for work in works:
        work.run()
    rounds = 0
    while True:
        for work in shuffled.sample(works, len(works)):
            if rounds % work.every == 0:
                before = work.clock()
                work.run()
                least_times[id(work)] = min(least_times[id(work)], work.clock() - before)
        rounds += 1
        ratios = []
        for bar in bars:
            yardstick = least_times[id(bar.yardstick)] / bar.yardstick.amount
            ours = least_times[id(bar.work)] / bar.work.amount
            ratios.append(yardstick / ours)
        passed = all(ratio >= share * bar.usual for ratio, bar in zip(ratios, bars, strict=True))
        if (rounds % _ROUNDS == 0 and passed) or process_time() >= end:
            return ratios


def judge_bars(bars: Sequence[Bar], seconds: float, share: float = SHARE) -> int:
    """Measure and print; return 0 if each reaches its bar, else 1; arguments as `measure_bars`."""
    ratios = measure_bars(bars, seconds, share)
    rows = []
    for bar, ratio in zip(bars, ratios, strict=True):
        rows.append((bar.name, ratio, bar.usual, share * bar.usual))
    columns = [("workload", ""), ("ratio", ".3g"), ("usual", ".3g"), ("bar", ".3g")]
    note = (
        "Ratio: physics steps in the time of one bare call of `pin.aba` from Python; of the "
        "process, to one that imports NumPy and Pinocchio only. Least processor time of shuffled "
        "rounds."
    )
    show(Outcome([ResultTable("Bars", columns, rows, note)], ()))
    missed = [name for name, ratio, _, bar in rows if ratio < bar]
    if missed:
        print(f"Slower than allowed: {', '.join(missed)}.")
    return 1 if missed else 0


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bars", description=__doc__)
    late = f"processor time after which who has not passed has failed (default {SECONDS:g})"
    parser.add_argument("--seconds", type=float, default=SECONDS, metavar="T", help=late)
    least = "of the usual ratios that must be reached; less on processors of another kind "
    least += f"(default {SHARE:g})"
    parser.add_argument("--share", type=float, default=SHARE, metavar="S", help=least)
    options = parser.parse_args(argv)
    return command(lambda: judge_bars(all_bars(), options.seconds, options.share))


if __name__ == "__main__":
    sys.exit(main())
