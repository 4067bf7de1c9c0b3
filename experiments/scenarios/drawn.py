"""Moves that differ from what was planned in everything at once, drawn at random."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cranedyn.sweep import Design, cross, grid
from experiments.harness.setup import Setup
from experiments.scenarios import strategies
from experiments.scenarios.robustness import COMBINED

RANGES = {
    "load": (0.5, 1.5),
    "cable_error_m": (-1.5, 1.5),
    "gust_m_s": (0.0, 12.0),
    "gust_to_rad": (-math.pi, math.pi),
    "gust_at_s": (0.0, 8.0),
    "gust_lasts_s": (4.0, 8.0),
    "noise": (0.0, 2.0),
    "delay": (0.0, 5.0),
    "lag": (0.5, 2.0),
}
"""Between which numbers each is drawn, all of them alike likely: mass of the payload over that
planned for; length of the cable less that measured; a gust of wind, its largest speed, where it
blows to as an angle from the world's +X, when it begins and how long it lasts; noise of the sensors
as a multiple of `sensor_model.noise_of`; by how many control periods they are late,
0 to 4; lags of frequency converters over the typical ones."""

LEVELS = 129
"""How many different loads there are, evenly, so that not every case needs a crane of its own."""

UNBATCHED = {
    strategies.MPC: "its optimiser is called from Python; the compiled one stands for it",
    strategies.YIELD: "its rates are not affine in the state",
}
"""Strategies that no batch runs, and why."""

DRAWN = [name for name in strategies.STRATEGIES if name not in UNBATCHED]
"""Those that are drawn for."""


def drawn(setup: Setup, names: Sequence[str], drive: str, count: int, seed: int) -> Design:
    """Draw the same cases for each strategy; fewer of one seed are the first of more.

    Args:
        setup: Where it takes place.
        names: Of strategies.
        drive: "ideal" or "velocity".
        count: Cases for each strategy.
        seed: Of the random numbers.

    Raises:
        CraneError: If the table would not fit the memory.
    """
    plans = grid(
        strategy=list(names),
        drive=drive,
        duration_s=COMBINED.duration,
        gravity_m_s2=setup.gravity,
        dt_s=setup.dt,
        control_period_s=setup.control_period,
        seed=seed,
    )
    low, high = np.array(list(RANGES.values())).T
    shares = np.random.default_rng(seed).random((count, len(RANGES)))
    columns = dict(zip(RANGES, (low + (high - low) * shares).T, strict=True))
    lightest, heaviest = RANGES["load"]
    columns["load"] = np.linspace(lightest, heaviest, LEVELS)[
        np.rint((columns["load"] - lightest) / (heaviest - lightest) * (LEVELS - 1)).astype(int)
    ]
    columns["delay"] = np.floor(columns["delay"])
    return cross(plans, Design(columns | {"number": np.arange(count, dtype=float)}))
