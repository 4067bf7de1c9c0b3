"""Runs of the comparison: a strategy under every case, and the tour, each in a process."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from multiprocessing import active_children, get_context

import numpy as np

from cranedyn.checks import number
from cranedyn.command import interrupted
from cranedyn.errors import CraneError
from cranedyn.interfaces import Controller, Setpoint, State
from cranedyn.sweep.workers import end_with_parent
from experiments.compare.result import IDEAL, PREDICTIVE, UNSEEING, StrategyResult, TourResult
from experiments.harness import Setup
from experiments.scenarios.moves import (
    AFTER,
    DWELL,
    TOUR_LIMITS,
    RestToRest,
    on_converters,
    residual,
)
from experiments.scenarios.perturbations import AFTER_UNTOLD, NOMINAL, PERTURBATIONS, UNTOLD, make
from experiments.scenarios.strategies import (
    STRATEGIES,
)
from experiments.scenarios.tours import CONTROLS


@contextmanager
def processes(jobs: int | None) -> Iterator[ProcessPoolExecutor]:
    """Yield processes that end with the context and with this process, even if that is killed."""
    if jobs is not None:
        number("jobs", jobs, "", "1 to 1024")
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=end_with_parent)
    try:
        yield pool
    except BaseException as error:
        for child in active_children():
            child.terminate()
        if isinstance(error, BrokenProcessPool):
            raise CraneError(
                "A process of the comparison was ended from outside; what it had done is lost."
            ) from None
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def strategy_results(
    setup: Setup, move: RestToRest, strategy: str, all_cases: bool, drive: str = IDEAL
) -> dict[str, StrategyResult]:
    """Return the results of a move by one strategy, as planned and perhaps under every case; an
    error becomes the reason of a result.
    """
    try:
        plan = STRATEGIES[strategy](setup, move)
        if drive != IDEAL:
            plan = on_converters(setup, plan)
    except CraneError as error:
        return {NOMINAL.name: StrategyResult(None, str(error))}
    results = {}
    cases = (*PERTURBATIONS, *(UNTOLD if drive == IDEAL else ())) if all_cases else (NOMINAL,)
    for case in cases:
        if case.sensors_only and not plan.uses_swing_sensor:
            results[case.name] = StrategyResult(None, UNSEEING)
            continue
        calls: list[float] = []
        timed = strategy in PREDICTIVE and case not in UNTOLD
        case_plan = plan
        if timed:
            case_plan = plan._replace(controller=partial(_timed, plan.controller, calls))
        after = AFTER_UNTOLD if case in UNTOLD else AFTER
        try:
            with collector_waits(timed):
                run, score = make(setup, move, case_plan, case, after=after)
            nominal_run = run if case == NOMINAL and all_cases else None
            results[case.name] = StrategyResult(score, "", nominal_run, np.array(calls))
        except CraneError as error:
            if interrupted(error):
                raise KeyboardInterrupt from None
            results[case.name] = StrategyResult(None, str(error))
    return results


@contextmanager
def collector_waits(timed: bool) -> Iterator[None]:
    """Collect Python's garbage after a run that is timed, not during it: going through all that a
    process holds takes 0.15 s, which would be counted as the controller's.
    """
    collects = gc.isenabled()
    if timed:
        gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def _timed(make_controller: Callable[[], Controller], calls: list[float]) -> Controller:
    """Return a controller that records the processor time of each call [s]."""
    controller = make_controller()

    def timed(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        start = time.thread_time()
        command = controller(t, state, setpoint)
        calls.append(time.thread_time() - start)
        return command

    return timed


def tour_results(setup: Setup, control: str) -> TourResult | str:
    """Return the seven legs under one control, or why there are none."""
    try:
        return _tour(setup, control)
    except CraneError as error:
        if interrupted(error):
            raise KeyboardInterrupt from None
        return str(error)


def _tour(setup: Setup, control: str) -> TourResult:
    reference, controller = CONTROLS[control](setup, TOUR_LIMITS, DWELL)
    duration = setup.control_period * round(reference.duration / setup.control_period)
    crane = setup.crane
    run = setup.simulate(
        crane, controller, reference, start=crane.start, duration=duration, label=""
    )
    dwells = [run.between(stage.arrival, stage.end) for stage in reference.stages]
    swings = [1000.0 * residual(dwell) for dwell in dwells]
    hook = max(swing * float(dwell["l_m"][-1]) for swing, dwell in zip(swings, dwells, strict=True))
    peak = 1000.0 * float(np.linalg.norm(run.coordinates("phi", "theta"), axis=1).max())
    return TourResult(duration, max(swings), float(np.mean(swings)), hook, peak)
