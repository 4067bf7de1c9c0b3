"""Observers that see the drives alone, with loads and cables that are not known."""

from __future__ import annotations

import math
from functools import partial

from experiments.compare.result import Results, score_of
from experiments.harness import Claim, Column, ResultTable, tabulate
from experiments.scenarios.perturbations import UNTOLD
from experiments.scenarios.strategies import FASTEST, FLAT, MPC

LEFT = 0.5e-3
"""Largest swing allowed at the arrival [rad]."""

STILL = (FLAT, MPC, FASTEST)
"""Strategies that leave nothing where all is as planned and measured."""


def observer_table(results: Results) -> ResultTable:
    """Return the swing at the arrival of every strategy under each case."""

    def arrival(strategy: str, case: str) -> float | None:
        score = score_of(results, strategy, case)
        return 1e3 * score.arrival if score else None

    names = [case.name for case in UNTOLD]
    strategies = [s for s in results if any(score_of(results, s, name) for name in names)]
    columns: list[Column] = [(name, ".3g", partial(arrival, case=name)) for name in names]
    return tabulate(
        "Swing at the arrival where the drives alone are seen [mrad], combined move",
        strategies,
        [("strategy", "", str), *columns],
        "State alone: an observer that believes load and cable as planned. Load too: one that "
        "estimates both beside the state. A dash: it breaks off.",
    )


def observer_claims(results: Results) -> list[Claim]:
    """Claim that those strategies leave nothing with a load and a cable that are not known."""
    cases = [case.name for case in UNTOLD if case.observer != "state"]
    scores = {
        strategy: [score_of(results, strategy, name) for name in cases if name in results[strategy]]
        for strategy in STILL
        if strategy in results
    }
    swings = {
        strategy: max(s.arrival if s else math.inf for s in of_cases)
        for strategy, of_cases in scores.items()
        if of_cases
    }
    if not swings:
        return []
    worst = max(swings, key=lambda strategy: swings[strategy])
    return [
        Claim(
            "Where the drives alone are seen and half of the load, or a tenth of the cable, is "
            f"not known, {1e3 * LEFT:g} mrad are left at the arrival at most: "
            f"{1e3 * swings[worst]:.3f} mrad by {worst}.",
            swings[worst] <= LEFT,
        )
    ]
