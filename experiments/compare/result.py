"""The result of a strategy under a case, shared by tables, figures and claims."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cranedyn.data.trajectory import Trajectory
from experiments.scenarios.moves import Score
from experiments.scenarios.strategies import COMPILED_MPC, MPC, TO_GOAL


class StrategyResult(NamedTuple):
    """A strategy under a case: its score, or why there is none; calls [s] are processor times."""

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


UNSEEING = "it does not look at the swing"


IDEAL = "ideal"
"""Drives that take what each strategy answers."""


PREDICTIVE = (MPC, COMPILED_MPC, TO_GOAL)
"""Strategies whose time to compute is noted."""


class TourResult(NamedTuple):
    """The seven legs under one control: length of the cycle [s], swing left in the dwells [mrad],
    at the hook [mm], on the way [mrad].
    """

    cycle: float
    worst: float
    mean: float
    hook: float
    peak: float
