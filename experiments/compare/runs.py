"""Runs of the comparison: a strategy under every case, and the tour, each in a process."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from cranedyn.command import interrupted
from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import CraneError
from cranedyn.interfaces import Controller, Setpoint, State
from cranedyn.interop.controller_file import open_controller
from experiments.harness import Setup
from experiments.scenarios import perturbations as cases
from experiments.scenarios import strategies
from experiments.scenarios.moves import (
    AFTER,
    COMBINED,
    DWELL,
    IDEAL,
    TOUR_LIMITS,
    MovePlan,
    RestToRest,
    Score,
    on_converters,
    residual,
)
from experiments.scenarios.own_controller import own_plan
from experiments.scenarios.tours import CONTROLS

NO_SWING_FEEDBACK = "it does not look at the swing"
"""Why a strategy without feedback of the swing has no result where only its measurement differs."""

PREDICTIVE = (strategies.MPC, strategies.COMPILED_MPC, strategies.TO_GOAL)
"""Strategies whose time to compute is noted."""


class StrategyResult(NamedTuple):
    """Result of a strategy in one case.

    Attributes:
        score: Its score; None if there is none.
        why: Why there is none; empty if there is one.
        run: The run, if it is recorded.
        calls: Processor time of each call of the controller [s], shape (calls,); empty if it was
            not taken.
    """

    score: Score | None
    why: str = ""
    run: Trajectory | None = None
    calls: np.ndarray = np.empty(0)


Results = dict[str, dict[str, StrategyResult]]
"""Results by strategy, then by case."""


def score_of(results: Results, strategy: str, case: str) -> Score | None:
    """Return the score of a strategy under a case, None if there is none."""
    result = results.get(strategy, {}).get(case)
    return result.score if result else None


class TourResult(NamedTuple):
    """Result of the seven legs under one control.

    Attributes:
        cycle: Duration of the cycle [s].
        worst: Largest residual swing in a dwell [mrad].
        mean: Mean residual swing in the dwells [mrad].
        hook: Largest amplitude of the hook in a dwell [mm].
        peak: Largest swing on the way [mrad].
    """

    cycle: float
    worst: float
    mean: float
    hook: float
    peak: float


def strategy_results(
    setup: Setup,
    moves: Sequence[RestToRest],
    strategy: str,
    drive: str = IDEAL,
    controller_file: str = "",
) -> dict[str, dict[str, StrategyResult]]:
    """Make moves by one strategy, or by a controller of one's own.

    Each move is made as planned, and the combined one in every case besides. An error becomes the
    reason of a result.

    Args:
        setup: The world.
        moves: The moves.
        strategy: Name of the strategy.
        drive: Kind of the drives, `IDEAL` or "velocity".
        controller_file: Where the controller of one's own is, see
            `cranedyn.interop.controller_file`; empty for a strategy of `STRATEGIES`.

    Returns:
        The results by the name of the move, then of the case.
    """
    all_cases = list(cases.PERTURBATIONS)
    if drive == IDEAL:
        all_cases += cases.UNTOLD
    # Moves that differ in their starting swing only share a plan.
    plans = dict[tuple, MovePlan]()
    # Opened here, since this runs in a process of its own.
    own = open_controller(controller_file) if controller_file else None
    results: dict[str, dict[str, StrategyResult]] = {move.name: {} for move in moves}
    for move, by_case in zip(moves, results.values(), strict=True):
        ends = move.start, move.goal, move.duration
        try:
            if ends not in plans:
                if own is not None:
                    plan = own_plan(setup, move, own, drive)
                else:
                    plan = strategies.STRATEGIES[strategy](setup, move)
                plans[ends] = plan if drive == IDEAL else on_converters(setup, plan)
        except CraneError as error:
            by_case[cases.NOMINAL.name] = StrategyResult(None, str(error))
            continue
        for case in all_cases if move == COMBINED else [cases.NOMINAL]:
            # Cases that differ in nothing but their name share a run: that of the first, which is
            # watched longest.
            equal = next(c for c in all_cases if replace(c, name=case.name) == case)
            if equal.name in by_case:
                # Its calls are counted once.
                by_case[case.name] = by_case[equal.name]._replace(calls=np.empty(0))
            else:
                by_case[case.name] = _result(setup, move, strategy, plans[ends], case)
    return results


def _result(
    setup: Setup, move: RestToRest, strategy: str, plan: MovePlan, case: cases.Perturbation
) -> StrategyResult:
    """Return the result of a move under a case, with the run as planned."""
    if case.sensors_only and not plan.uses_swing_sensor:
        return StrategyResult(None, NO_SWING_FEEDBACK)
    calls: list[float] = []
    untold = case in cases.UNTOLD
    timed = strategy in PREDICTIVE and not untold
    if timed:
        plan = plan._replace(controller=partial(_timed, plan.controller, calls))
    try:
        with collector_waits(timed):
            after = cases.AFTER_UNTOLD if untold else AFTER
            run, score = cases.make(setup, move, plan, case, after=after)
    except CraneError as error:
        if interrupted(error):
            raise KeyboardInterrupt from None
        return StrategyResult(None, str(error))
    is_recorded = case == cases.NOMINAL and move == COMBINED
    return StrategyResult(score, "", run if is_recorded else None, np.array(calls))


@contextmanager
def collector_waits(timed: bool) -> Iterator[None]:
    """Let Python collect its garbage after a run whose controller is timed, not during it.

    Going through all that a process holds takes 0.15 s, which would be counted as the controller's.

    Args:
        timed: Whether the run is timed.
    """
    was_enabled = gc.isenabled()
    if timed:
        gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def _timed(make_controller: Callable[[], Controller], calls: list[float]) -> Controller:
    """Return a controller that records the processor time of each call [s]."""
    controller = make_controller()

    def timed(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        if not calls:
            # The first call in a process compiles the controller. Another one of the same kind pays
            # for that, as a program does before it closes a loop.
            make_controller()(t, state, setpoint)
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
    at_hook = []
    for swing, dwell in zip(swings, dwells, strict=True):
        at_hook.append(swing * float(dwell["l_m"][-1]))
    peak = 1000.0 * float(np.linalg.norm(run.coordinates("phi", "theta"), axis=1).max())
    return TourResult(duration, max(swings), float(np.mean(swings)), max(at_hook), peak)
