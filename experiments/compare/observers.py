"""What observers that see the drives alone make of loads and cables that nobody told them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from experiments.harness import Claim, Table
from experiments.scenarios.perturbations import UNTOLD
from experiments.scenarios.strategies import FASTEST, FLAT, MPC

Found = Mapping[str, Mapping[str, Any]]

LEFT = 0.5e-3
"""What may be left at the arrival [rad]."""

STILL = (FLAT, MPC, FASTEST)
"""Strategies that leave nothing where all is as planned and measured."""


def observer_table(found: Found) -> Table:
    """Swing at the arrival of every strategy under each case."""
    names = [case.name for case in UNTOLD]
    rows = []
    for strategy, results in found.items():
        scores = [results[name].score if name in results else None for name in names]
        if any(scores):
            rows.append((strategy, *(1e3 * s.arrival if s else None for s in scores)))
    return Table(
        "Swing at the arrival where the drives alone are seen [mrad], combined move",
        [("strategy", ""), *((name, ".3g") for name in names)],
        rows,
        "State alone: an observer that believes load and cable as planned. Load too: one that "
        "estimates both beside the state. A dash: it breaks off.",
    )


def observer_claims(found: Found) -> list[Claim]:
    """That those strategies leave nothing with a load and a cable that nobody told."""
    left = {
        strategy: [
            found[strategy][case.name].score
            for case in UNTOLD
            if case.observer != "state" and case.name in found[strategy]
        ]
        for strategy in STILL
        if strategy in found
    }
    if not any(left.values()):
        return []
    swings = {
        strategy: max(s.arrival if s else float("inf") for s in scores)
        for strategy, scores in left.items()
        if scores
    }
    worst = max(swings, key=lambda strategy: swings[strategy])
    return [
        Claim(
            "Where the drives alone are seen and half of the load, or a tenth of the cable, is "
            f"not known, {1e3 * LEFT:g} mrad are left at the arrival at most: "
            f"{1e3 * swings[worst]:.3f} mrad by {worst}.",
            swings[worst] <= LEFT,
        )
    ]
