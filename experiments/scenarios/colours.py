"""The colour of each strategy, the same in every figure and recording of every experiment."""

from __future__ import annotations

from cranedyn.plotting.style import run_colour
from experiments.scenarios.strategies import FLAT, LQR, MPC, PAPER, PD, STRATEGIES, TIME

_FIRST = (FLAT, PAPER, LQR, PD, "spline alone", TIME, MPC, "operator")
"""Those that are shown together most often have colours that nobody else of these has."""

_SHAPED = {"spline + ZV": TIME, "spline + ZVD": MPC, "spline + ZV for a moving cable": "operator"}
"""Strategies of the sweep, each with the colour of one that is not shown beside it."""

_ORDER = (*_FIRST, *(strategy for strategy in STRATEGIES if strategy not in _FIRST))


def strategy_colour(strategy: str) -> str:
    """Return the hex colour of a strategy by its name; an unknown one has the last of the first
    eight.
    """
    name = _SHAPED.get(strategy, strategy)
    return run_colour(_ORDER.index(name) if name in _ORDER else len(_FIRST) - 1)
