"""What workers of `benchmarks.sweeping` compute, in a module that they import in no time."""

from __future__ import annotations

import time
from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cranedyn.controllers.hold import Hold
    from cranedyn.model.crane import Crane

PAUSE = 0.05
"""Time for which a chunk that computes nothing waits [s]."""

SWING = 20.0
"""Simulated time of a swing [s]."""

Columns = Mapping[str, np.ndarray]


def nothing(cases: Columns) -> Columns:
    """Return a number for each case, at no cost."""
    return {"y": cases["x"]}


def waiting(cases: Columns) -> Columns:
    """Return a number for each case after a pause without processor load."""
    time.sleep(PAUSE)
    return nothing(cases)


def swinging(cases: Columns) -> Columns:
    """Simulate free swings of the crane, eight in a vector, on one thread, and return the cost of
    each.
    """
    from cranedyn.compiled.batch import simulate_batch
    from cranedyn.interfaces import State

    before = time.process_time()
    crane, controller = _crane()
    count = len(cases["x"])
    q = np.tile(crane.start.q, (count, 1))
    v = np.tile(crane.start.v, (count, 1))
    q[:, crane.swings[0]] = 0.3 * cases["x"]
    batch = simulate_batch(crane, controller, start=State(q, v), duration=SWING, threads=1)
    spent = (time.process_time() - before) / len(q)
    return {"peak_rad": batch.peak_swing, "spent_s": np.full(len(q), spent)}


@cache
def _crane() -> tuple[Crane, Hold]:
    from cranedyn.controllers import hold_controller
    from cranedyn.model.load import load_crane

    crane = load_crane()
    return crane, hold_controller(crane)
