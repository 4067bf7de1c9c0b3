"""Ways around obstacles: the best way on a grid, every edge proven, then shortened."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from cranedyn.planning.clearance import Clearance
from cranedyn.planning.curve import leg_durations
from cranedyn.planning.grid import best_on_grid
from cranedyn.planning.proof import is_proven_free

EDGES, CELLS = (1.0, 0.5), 50_000
"""Edges of the cells of the grids to try, one after the other [s], and the most cells of each."""

_TIGHT = 0.2
"""Additional cost of a second without margin: of ways that last equally long the one with more
margin is the quicker, since rounding and averaging need some."""

_TRIES = 3
"""Number of seeds from which shortcuts of a way are drawn."""

_STEPS = (4.0, 2.0, 1.0, 0.5, 0.25)
"""Distances by which corners are shifted on trial [s]."""

_STRAIGHT = 0.03
"""Cost of a second of all drives together beside one of the slowest: of ways that last equally long
the straight one."""

_DIRECTIONS = [
    np.array(step, dtype=float)
    for step in itertools.product((-1, 0, 1), repeat=3)
    if 1 <= sum(map(abs, step)) <= 2
]
"""Shifts of one drive or two."""

IsFree = Callable[[np.ndarray, np.ndarray], bool]
"""Whether the straight line between two places is proven free."""


class Proofs:
    """Straight lines between places that are proven free; each is examined once."""

    def __init__(self, clearance: Clearance) -> None:
        """Begin with none."""
        self.clearance = clearance
        self._free: dict[tuple[float, ...], bool] = {}

    def __call__(self, start: np.ndarray, end: np.ndarray) -> bool:
        """Return whether the line between two places is proven free."""
        key = (*start.tolist(), *end.tolist())
        if key not in self._free:
            self._free[key] = is_proven_free(self.clearance, start, end)
        return self._free[key]


def search(
    clearance: Clearance, ends: np.ndarray, bounds: np.ndarray, rates: np.ndarray
) -> list[np.ndarray]:
    """Return ways: the straight line, or the best on a grid shortened by a few seeds; none if there
    is none on the finest grid either.

    Args:
        clearance: Crane and site.
        ends: First and last place, shape (2, 3).
        bounds: Least and largest slew, trolley radius and cable length, shape (2, 3).
        rates: Rates of the drives, in whose time a way is measured, shape (3,).

    Returns:
        Places of each way, shape (n, 3), each proven to be reached from the one before along a
        straight line.
    """
    free = Proofs(clearance)
    if free(ends[0], ends[1]):
        return [ends]
    for cell in EDGES:
        points = best_on_grid(
            clearance, ends, bounds, rates, cell=cell, cell_limit=CELLS, tight=_TIGHT
        ).points
        if points is not None:
            generators = (np.random.default_rng(seed) for seed in range(_TRIES))
            return [shortened(free, points, rates, bounds, rng) for rng in generators]
    return []


def shortened(
    free: IsFree,
    points: np.ndarray,
    rates: np.ndarray,
    bounds: np.ndarray,
    rng: np.random.Generator,
    *,
    rounds: int = 6,
) -> np.ndarray:
    """Return a way along places, shape (n, 3), with shortcuts taken, corners left out and corners
    shifted while it gets shorter.
    """
    before = np.inf
    for _ in range(rounds):
        points = _shortcuts(free, _fewer(free, points, rates), rates, rng)
        points = _shifted(free, _fewer(free, points, rates), rates, bounds)
        if _cost(points, rates) > 0.999 * before:
            break
        before = _cost(points, rates)
    return points


def _cost(points: np.ndarray, rates: np.ndarray) -> float:
    lengths = np.linalg.norm(np.diff(points, axis=0) / rates, axis=1)
    return float(leg_durations(points, rates).sum() + _STRAIGHT * lengths.sum())


def _fewer(free: IsFree, points: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Leave out corners that can be left out."""
    k = 1
    while k < len(points) - 1:
        trial = np.delete(points, k, axis=0)
        shorter = _cost(trial, rates) <= _cost(points, rates) + 1e-9
        if shorter and free(points[k - 1], points[k + 1]):
            points = trial
        else:
            k += 1
    return points


def _shortcuts(
    free: IsFree, points: np.ndarray, rates: np.ndarray, rng: np.random.Generator, tries: int = 25
) -> np.ndarray:
    """Take straight lines between points of the way that are drawn at random."""
    for _ in range(tries if len(points) > 2 else 0):
        knots = np.concatenate([[0.0], np.cumsum(leg_durations(points, rates))])
        span = np.sort(rng.uniform(0.0, knots[-1], 2))
        first, last = np.searchsorted(knots, span, side="right")
        if first == last or last >= len(points):
            continue
        cut = np.column_stack([np.interp(span, knots, column) for column in points.T])
        trial = np.concatenate([points[:first], cut, points[last:]])
        if (
            _cost(trial, rates) < _cost(points, rates) - 1e-6
            and free(*cut)
            and free(points[first - 1], cut[0])
            and free(cut[1], points[last])
        ):
            points = trial
    return points


def _shifted(free: IsFree, points: np.ndarray, rates: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """Shift each corner by small steps of one drive or two while the way gets shorter."""
    points = points.copy()
    for step, k, direction in itertools.product(_STEPS, range(1, len(points) - 1), _DIRECTIONS):
        trial = points[k - 1 : k + 2].copy()
        trial[1] = np.clip(points[k] + step * direction * rates, *bounds)
        shorter = _cost(trial, rates) < _cost(points[k - 1 : k + 2], rates) - 1e-6
        if shorter and free(trial[0], trial[1]) and free(trial[1], trial[2]):
            points[k] = trial[1]
    return points
