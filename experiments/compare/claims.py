"""The claims of the comparison."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from experiments.compare.runs import PREDICTIVE, Results, score_of
from experiments.harness import Claim, Setup
from experiments.scenarios.moves import SETTLED_DISTANCE, sampling_swing
from experiments.scenarios.perturbations import NOMINAL, UNOBSERVED, UNTOLD
from experiments.scenarios.strategies import FASTEST, FLAT, MPC, SWING, TIME, mpc_period

MAX_UNSEEN_SWING = 0.5e-3
"""Largest swing allowed at the arrival where the drives alone are seen [rad]."""

MAX_SETTLING_TIME = 1.0
"""Largest time after the arrival in which flat paths settle with another load [s]."""

LEAVE_NOTHING = (FLAT, MPC, FASTEST)
"""Strategies that leave nothing where all is as planned and measured."""


def ideal_claims(setup: Setup, results: Results) -> Iterator[Claim]:
    """Yield the claims on ideal drives in the combined move, as far as strategies were run."""
    flat = score_of(results, FLAT, NOMINAL.name)
    if flat:
        sampling = sampling_swing(setup.gravity, flat.length, setup.control_period, flat.peak)
        yield Claim(
            f"On arrival flat paths with LQR leave no swing: {1e3 * flat.arrival:.4f} mrad, "
            "where efforts that are held for "
            f"{1e3 * setup.control_period:g} ms may leave {1e3 * sampling:.4f} mrad.",
            flat.arrival < sampling,
        )
    other_loads = [score_of(results, FLAT, case) for case in ("load -50 %", "load +50 %")]
    settling_times = [score.settled for score in other_loads if score]
    if settling_times:
        slowest = max(settling_times)
        yield Claim(
            "With half or one and a half of the load they settle within a second of the "
            f"arrival ({slowest:.2f} s).",
            slowest < MAX_SETTLING_TIME,
        )
    cycles = {}
    for strategy in results:
        score = score_of(results, strategy, NOMINAL.name)
        if score and strategy != TIME:
            cycles[strategy] = score.cycle
    least_time = score_of(results, TIME, NOMINAL.name)
    # Without the fastest of the others there is nothing to be faster than.
    if least_time and FASTEST in cycles:
        second = min(cycles, key=lambda strategy: cycles[strategy])
        yield Claim(
            "Under the same limits the move of least time settles before any other "
            f"({least_time.cycle:.2f} s; next is {second} after {cycles[second]:.2f} s).",
            least_time.cycle < cycles[second],
        )


def converter_claims(of_move: Mapping[str, Results]) -> Iterator[Claim]:
    """Yield the claim that on converters an LQR about the planned path of the load arrives with it,
    in every move and case. There is none if no such strategy was run.
    """
    judged = []
    for results in of_move.values():
        for strategy in (FLAT, FASTEST, SWING, TIME):
            for result in results.get(strategy, {}).values():
                # A strategy that broke off counts; one that cannot be observed does not.
                if result.score or result.why != UNOBSERVED:
                    judged.append(result.score)
    if judged:
        at_hook = [score.later * score.length if score else math.inf for score in judged]
        worst = max(at_hook)
        yield Claim(
            "On frequency converters an LQR about the planned path of the load leaves it within "
            f"{1e3 * SETTLED_DISTANCE:g} mm of plumb 20 s after the arrival, in every move and "
            f"case ({1e3 * worst:.0f} mm at most).",
            worst < SETTLED_DISTANCE,
        )


def time_claims(setup: Setup, of_move: Mapping[str, Results]) -> Iterator[Claim]:
    """Yield the claims that each MPC is done within its period, in every period of every run."""
    period = mpc_period(setup)
    # A control instant in so many has an optimisation.
    stride = round(period / setup.control_period)
    for strategy in PREDICTIVE:
        runs = []
        for by_case in of_move.values():
            for result in by_case.get(strategy, {}).values():
                if len(result.calls):
                    runs.append(result.calls)
        if not runs:
            continue
        name = "The MPC" if strategy == MPC else f"{strategy[0].upper()}{strategy[1:]}"
        calls = np.concatenate(runs)
        optimisations = np.concatenate([of_run[::stride] for of_run in runs])
        yield Claim(
            f"{name} is done within its period of {1e3 * period:g} ms: it takes "
            f"{1e3 * calls.max():.2g} ms of processor time at most, "
            f"{1e3 * np.median(optimisations):.2g} ms in the median, in {len(optimisations):,} "
            "periods on this machine, garbage of Python's aside.",
            bool(calls.max() < period),
        )


def observer_claims(results: Results) -> Iterator[Claim]:
    """Yield the claim that strategies which leave nothing when all is known also do so with a load
    and a cable that are not known. There is none if no such strategy was run.
    """
    # An observer that trusts the planned load is not expected to.
    estimating = [case for case in UNTOLD if case.observer != "state"]
    swings: dict[str, float] = {}
    for strategy in LEAVE_NOTHING:
        for case in estimating:
            if case.name in results.get(strategy, {}):
                score = score_of(results, strategy, case.name)
                swing = score.arrival if score else math.inf
                swings[strategy] = max(swing, swings.get(strategy, 0.0))
    if swings:
        worst = max(swings, key=lambda strategy: swings[strategy])
        yield Claim(
            "Where the drives alone are seen and half of the load, or a tenth of the cable, is "
            f"not known, {1e3 * MAX_UNSEEN_SWING:g} mrad are left at the arrival at most: "
            f"{1e3 * swings[worst]:.3f} mrad by {worst}.",
            swings[worst] <= MAX_UNSEEN_SWING,
        )
