"""Ways around obstacles: the best on a grid, every edge proven, then made short."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cranedyn.planning.clearance import Clearance
from cranedyn.planning.curve import lasts
from cranedyn.planning.grid import best_on_grid
from cranedyn.planning.proof import Line, unproven

EDGES, CELLS = (1.0, 0.5), 50_000
"""Edges of the cells of grids that are looked at, one after the other [s], and at how many cells of
each."""

_TIGHT = 0.2
"""What a second costs more where there is no room: of ways that last equally long the one with more
of it is the quicker, and less of it is left by rounding and averaging."""

_TRIES = 3
"""How often shortcuts of a way are drawn, from as many seeds."""

_STEPS = (4.0, 2.0, 1.0, 0.5, 0.25)
"""By how much corners are shifted on trial [s]."""

_STRAIGHT = 0.03
"""What a second of the way of all drives is worth beside one of the longest: of ways that last
equally long the straight one."""


class Proofs:
    """Straight lines between places that are proven free, each looked at once."""

    def __init__(self, clearance: Clearance) -> None:
        """Begin with none."""
        self.clearance = clearance
        self._found: dict[tuple[float, ...], bool] = {}

    def __call__(self, one: np.ndarray, other: np.ndarray) -> bool:
        """Whether the line from a place to another is proven free."""
        key = (*one.tolist(), *other.tolist())
        if key not in self._found:
            self._found[key] = unproven(self.clearance, Line(one, other), 0.0, 1.0) is None
        return self._found[key]


def search(
    clearance: Clearance, ends: np.ndarray, bounds: np.ndarray, rates: np.ndarray
) -> list[np.ndarray]:
    """Return ways: the straight line, or the best on a grid made short in a few ways; none if there
    is none on the finest grid either.

    Args:
        clearance: Crane and site.
        ends: First and last place, shape (2, 3).
        bounds: Least and largest slew, trolley radius and cable length, shape (2, 3).
        rates: Rates of the drives, in whose time a way is measured, shape (3,).

    Returns:
        Places of each, shape (n, 3), each proven to be reached from the one before along a straight
        line.
    """
    free = Proofs(clearance)
    if free(ends[0], ends[1]):
        return [ends]
    for cell in EDGES:
        points = best_on_grid(
            clearance, ends, bounds, rates, cell=cell, most=CELLS, tight=_TIGHT
        ).points
        if points is not None:
            draws = (np.random.default_rng(seed) for seed in range(_TRIES))
            return [shortened(free, points, rates, bounds, rng) for rng in draws]
    return []


def shortened(
    free: Callable[[np.ndarray, np.ndarray], bool],
    points: np.ndarray,
    rates: np.ndarray,
    bounds: np.ndarray,
    rng: np.random.Generator,
    *,
    rounds: int = 6,
) -> np.ndarray:
    """A way along places, shape (n, 3), with shortcuts taken, corners left out and corners shifted
    while it gets shorter.
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
    return float(
        lasts(points, rates).sum()
        + _STRAIGHT * np.linalg.norm(np.diff(points, axis=0) / rates, axis=1).sum()
    )


def _fewer(free: Callable[..., bool], points: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Without corners that can be left out."""
    k = 1
    while k < len(points) - 1:
        less = np.delete(points, k, axis=0)
        if _cost(less, rates) <= _cost(points, rates) + 1e-9 and free(points[k - 1], points[k + 1]):
            points = less
        else:
            k += 1
    return points


def _shortcuts(
    free: Callable[..., bool],
    points: np.ndarray,
    rates: np.ndarray,
    rng: np.random.Generator,
    tries: int = 25,
) -> np.ndarray:
    """With straight lines between points of the way taken at random."""
    for _ in range(tries if len(points) > 2 else 0):
        knots = np.concatenate([[0.0], np.cumsum(lasts(points, rates))])
        low, high = np.sort(rng.uniform(0.0, knots[-1], 2))
        first, last = np.searchsorted(knots, (low, high), side="right")
        if first == last or last >= len(points):
            continue
        cut = np.stack(
            [np.array([np.interp(s, knots, points[:, i]) for i in range(3)]) for s in (low, high)]
        )
        trial = np.concatenate([points[:first], cut, points[last:]])
        if (
            _cost(trial, rates) < _cost(points, rates) - 1e-6
            and free(*cut)
            and free(points[first - 1], cut[0])
            and free(cut[1], points[last])
        ):
            points = trial
    return points


def _shifted(
    free: Callable[..., bool], points: np.ndarray, rates: np.ndarray, bounds: np.ndarray
) -> np.ndarray:
    """With each corner where it makes the way shortest, as far as small steps of one drive or two
    tell.
    """
    points = points.copy()
    directions = [
        np.array([i, j, k], dtype=float)
        for i in (-1, 0, 1)
        for j in (-1, 0, 1)
        for k in (-1, 0, 1)
        if 1 <= abs(i) + abs(j) + abs(k) <= 2
    ]
    for step in _STEPS:
        for k in range(1, len(points) - 1):
            for direction in directions:
                trial = points.copy()
                trial[k] = np.clip(points[k] + step * direction * rates, *bounds)
                shorter = (
                    _cost(trial[k - 1 : k + 2], rates) < _cost(points[k - 1 : k + 2], rates) - 1e-6
                )
                if shorter and free(trial[k - 1], trial[k]) and free(trial[k], trial[k + 1]):
                    points = trial
    return points
