"""The claims of the comparison."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from experiments.compare.runs import PREDICTIVE, Results, score_of
from experiments.harness import Claim, Setup
from experiments.scenarios.moves import CLOSE, of_sampling
from experiments.scenarios.perturbations import NOMINAL, UNOBSERVED, UNTOLD
from experiments.scenarios.strategies import FASTEST, FLAT, MPC, SWING, TIME, mpc_period

LEFT = 0.5e-3
"""Largest swing allowed at the arrival where the drives alone are seen [rad]."""

STILL = (FLAT, MPC, FASTEST)
"""Strategies that leave nothing where all is as planned and measured."""


def ideal_claims(setup: Setup, results: Results) -> Iterator[Claim]:
    """Claim what ideal drives do in the combined move."""
    flat, shortest = (score_of(results, strategy, NOMINAL.name) for strategy in (FLAT, TIME))
    if flat:
        sampling = of_sampling(setup.gravity, flat.length, setup.control_period, flat.peak)
        yield Claim(
            f"On arrival flat paths with LQR leave no swing: {1e3 * flat.arrival:.4f} mrad, "
            "where efforts that are held for "
            f"{1e3 * setup.control_period:g} ms may leave {1e3 * sampling:.4f} mrad.",
            flat.arrival < sampling,
        )
    loads = [s for case in ("load -50 %", "load +50 %") if (s := score_of(results, FLAT, case))]
    if loads:
        slowest = max(s.settled for s in loads)
        yield Claim(
            "With half or one and a half of the load they settle within a second of the "
            f"arrival ({slowest:.2f} s).",
            slowest < 1.0,
        )
    scores = {name: score_of(results, name, NOMINAL.name) for name in results if name != TIME}
    cycles = {name: score.cycle for name, score in scores.items() if score}
    if shortest and FASTEST in cycles:
        second = min(cycles, key=lambda strategy: cycles[strategy])
        yield Claim(
            "Under the same limits the move of least time settles before any other "
            f"({shortest.cycle:.2f} s; next is {second} after {cycles[second]:.2f} s).",
            shortest.cycle < cycles[second],
        )


def converter_claims(of_move: Mapping[str, Results]) -> Iterator[Claim]:
    """Claim that an LQR about the planned path of the load arrives with it on converters, in every
    move and case.
    """
    judged = [
        result.score
        for results in of_move.values()
        for strategy in (FLAT, FASTEST, SWING, TIME)
        for result in results.get(strategy, {}).values()
        if result.score or result.why != UNOBSERVED
    ]
    if judged:
        worst = max(math.inf if s is None else s.later * s.length for s in judged)
        yield Claim(
            "On frequency converters an LQR about the planned path of the load leaves it within "
            f"{1e3 * CLOSE:g} mm of plumb 20 s after the arrival, in every move and case "
            f"({1e3 * worst:.0f} mm at most).",
            worst < CLOSE,
        )


def time_claims(setup: Setup, of_move: Mapping[str, Results]) -> Iterator[Claim]:
    """Claim that each MPC is done within its period, in every period of every run."""
    period = mpc_period(setup)
    for strategy in PREDICTIVE:
        results = [r for by_case in of_move.values() for r in by_case.get(strategy, {}).values()]
        runs = [result.calls for result in results if len(result.calls)]
        if not runs:
            continue
        name = "The MPC" if strategy == MPC else f"{strategy[0].upper()}{strategy[1:]}"
        calls = np.concatenate(runs)
        solves = np.concatenate([run[:: round(period / setup.control_period)] for run in runs])
        yield Claim(
            f"{name} is done within its period of {1e3 * period:g} ms: it takes "
            f"{1e3 * calls.max():.2g} ms of processor time at most, "
            f"{1e3 * np.median(solves):.2g} ms in the median, in {len(solves):,} periods on "
            "this machine, garbage of Python's aside.",
            bool(calls.max() < period),
        )


def observer_claims(results: Results) -> Iterator[Claim]:
    """Claim that those strategies leave nothing with a load and a cable that are not known."""
    swings: dict[str, float] = {}
    for case in UNTOLD:
        for strategy in STILL if case.observer != "state" else ():
            if case.name in results.get(strategy, {}):
                score = score_of(results, strategy, case.name)
                swing = score.arrival if score else math.inf
                swings[strategy] = max(swing, swings.get(strategy, 0.0))
    if swings:
        worst = max(swings, key=lambda strategy: swings[strategy])
        yield Claim(
            "Where the drives alone are seen and half of the load, or a tenth of the cable, is "
            f"not known, {1e3 * LEFT:g} mrad are left at the arrival at most: "
            f"{1e3 * swings[worst]:.3f} mrad by {worst}.",
            swings[worst] <= LEFT,
        )
