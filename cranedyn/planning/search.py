"""Ways around obstacles: the best way on a grid of places, every edge proven, then shortened. The
best way on a fine grid is also the measure of other ways, and gives the reason where there is none.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections import Counter
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

from cranedyn.planning.clearance import Clearance
from cranedyn.planning.curve import leg_durations
from cranedyn.planning.proof import Line, is_proven_free

EDGES, CELLS = (1.0, 0.5), 50_000
"""Edges of the cells of the grids to try, one after the other [s], and the most cells of each."""

_TIGHT = 0.2
"""Additional cost of a second without margin: of ways that last equally long the one with more
margin is the quicker, since rounding and averaging need some."""

_TRIES, _ROUNDS, _DRAWS = 3, 6, 25
"""Seeds from which shortcuts of a way are drawn, rounds of shortening, and shortcuts in a round."""

_STEPS = (4.0, 2.0, 1.0, 0.5, 0.25)
"""Distances by which corners are shifted on trial [s]."""

_STRAIGHT = 0.03
"""Cost of a second of all drives together beside one of the slowest: of ways that last equally long
the straight one."""

IsFree = Callable[[np.ndarray, np.ndarray], bool]
"""Whether the straight line between two places is proven free."""

_TIE = 1e-3
"""Cost of a step of a further drive beside one of the slowest: of ways that last equally long the
straight one."""

_BLOCKED = 200
"""Number of blocked places to keep, to name the obstacles there."""

_NEIGHBOURS = [step for step in itertools.product((-1, 0, 1), repeat=3) if any(step)]

_DIRECTIONS = [np.array(step, dtype=float) for step in _NEIGHBOURS if not all(step)]
"""Shifts of one drive or two."""

Node = tuple[int, ...]
"""A cell, by whole numbers from the first place."""


def search(
    clearance: Clearance, ends: np.ndarray, bounds: np.ndarray, rates: np.ndarray
) -> list[np.ndarray]:
    """Return ways: the straight line, or the best on a grid shortened by a few seeds; none if there
    is none on the finest grid either.

    Args:
        clearance: Crane and site.
        ends: First and last place, shape (2, 3).
        bounds: Least and largest place, shape (2, 3).
        rates: Rates of the drives, in whose time a way is measured, shape (3,).

    Returns:
        Places of each way, shape (n, 3), each proven to be reached from the one before along a
        straight line.
    """
    free = _proofs(clearance)
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


def _proofs(clearance: Clearance) -> IsFree:
    """Return a function that proves straight lines between places free, each of them once."""

    @cache
    def proven(*ends: tuple[float, ...]) -> bool:
        return is_proven_free(clearance, *map(np.array, ends))

    return lambda start, end: proven(tuple(start.tolist()), tuple(end.tolist()))


def shortened(
    free: IsFree,
    points: np.ndarray,
    rates: np.ndarray,
    bounds: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """Return a way along places, shape (n, 3), with shortcuts taken, corners left out and corners
    shifted while it gets shorter.
    """
    before = np.inf
    for _ in range(_ROUNDS):
        points = _shortcuts(free, _fewer(free, points, rates), rates, rng)
        points = _shifted(free, _fewer(free, points, rates), rates, bounds)
        if _cost(points, rates) > 0.999 * before:
            break
        before = _cost(points, rates)
    return points


def _cost(points: np.ndarray, rates: np.ndarray) -> float:
    legs = np.abs(points[1:] - points[:-1]) / rates
    return float(legs.max(axis=1).sum() + _STRAIGHT * np.sqrt((legs * legs).sum(axis=1)).sum())


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
    free: IsFree, points: np.ndarray, rates: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Take straight lines between points of the way that are drawn at random."""
    for _ in range(_DRAWS if len(points) > 2 else 0):
        knots = np.concatenate([[0.0], np.cumsum(leg_durations(points, rates))])
        span = np.sort(rng.uniform(0.0, knots[-1], 2))
        first, last = np.searchsorted(knots, span, side="right")
        if first == last or last >= len(points):
            continue
        cut = np.column_stack([np.interp(span, knots, column) for column in points.T])
        trial = np.concatenate([points[:first], cut, points[last:]])
        # Parts of lines that are proven free need no proof.
        if _cost(trial, rates) < _cost(points, rates) - 1e-6 and free(*cut):
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


class GridSearch(NamedTuple):
    """Result of a search on a grid.

    Attributes:
        points: Places of the best way, shape (n, 3); None if there is none.
        duration: Its length as time at full speed [s], inf if there is none.
        reached: Number of cells that were reached.
        blocked: Names of obstacles where the search ended, the most frequent first.
    """

    points: np.ndarray | None
    duration: float
    reached: int
    blocked: list[str]


def best_on_grid(
    clearance: Clearance,
    ends: np.ndarray,
    bounds: np.ndarray,
    rates: np.ndarray,
    *,
    cell: float = 1.0,
    cell_limit: int = 400_000,
    tight: float = 0.0,
) -> GridSearch:
    """Return the shortest way by A* (Hart, Nilsson, Raphael 1968) over cells with 26 neighbours.

    Args:
        clearance: Crane and site.
        ends: First and last place, shape (2, 3).
        bounds: Least and largest place, shape (2, 3).
        rates: Rates of the drives, shape (3,).
        cell: Edge of a cell [s]: as far as each drive gets in that time.
        cell_limit: Number of cells after which the search gives up.
        tight: Additional cost of a second without margin, less so up to a margin of a metre.
    """
    grid, start = _Grid(clearance, ends, bounds, rates, cell), (0, 0, 0)
    parents: dict[Node, Node] = {}
    queue: list[tuple[float, float, Node, Node]] = [(0.0, 0.0, start, start)]
    blocked: list[np.ndarray] = []
    best: float = math.inf
    last: Node = start
    steps = [(step, 1.0 + _TIE * (sum(map(abs, step)) - 1)) for step in _NEIGHBOURS]
    # Edges are proven when their turn comes: most never are.
    while queue and len(parents) < cell_limit:
        guess, negative_cost, node, parent = heapq.heappop(queue)
        if guess >= best:
            break
        if node in parents:
            continue
        if node != start and not grid.is_free(parent, node):
            if len(blocked) < _BLOCKED:
                blocked.append(grid.place(node))
            continue
        parents[node], cost = parent, -negative_cost
        to_goal = grid.cost_to_goal(node)
        if (
            grid.beside_goal(node)
            and cost + to_goal < best
            and is_proven_free(clearance, grid.place(node), ends[1])
        ):
            best, last = cost + to_goal, node
        for step, factor in steps:
            neighbour = (node[0] + step[0], node[1] + step[1], node[2] + step[2])
            if neighbour not in parents and (to_goal := grid.cost_to_goal(neighbour)) < math.inf:
                if tight:
                    factor += tight * max(0.0, 1.0 - grid.margin(neighbour))
                reached = cost + cell * factor
                heapq.heappush(queue, (reached + to_goal, -reached, neighbour, node))
    if best == math.inf:
        names = Counter(
            clearance.nearest(clearance.q(drive_position), beside_zones=True).obstacle
            for drive_position in blocked
        )
        return GridSearch(None, best, len(parents), [name for name, _ in names.most_common()])
    nodes: list[Node] = [last]
    while nodes[-1] != start:
        nodes.append(parents[nodes[-1]])
    points = np.array([*(grid.place(node) for node in reversed(nodes)), ends[1]])
    points = points[np.append(True, np.abs(np.diff(points, axis=0)).max(axis=1) > 1e-9)]
    return GridSearch(points, float(leg_durations(points, rates).sum()), len(parents), [])


class _Grid:
    """Cells about the first place."""

    def __init__(
        self,
        clearance: Clearance,
        ends: np.ndarray,
        bounds: np.ndarray,
        rates: np.ndarray,
        cell: float,
    ) -> None:
        self._clearance, self._ends, self._bounds = clearance, ends, bounds
        self._step, self._cell = rates * cell, cell
        self._goal = ((ends[1] - ends[0]) / self._step).tolist()
        self._low, self._high = ((bounds - ends[0]) / self._step).tolist()
        self.margin, self.place = cache(self._margin), cache(self._place)
        self.cost_to_goal = cache(self._cost_to_goal)

    def _place(self, node: Node) -> np.ndarray:
        return np.clip(self._ends[0] + np.array(node) * self._step, *self._bounds)

    def _cost_to_goal(self, node: Node) -> float:
        """Return a lower bound of the cost of a way from a cell to the goal, inf out of bounds."""
        for low, i, high in zip(self._low, node, self._high, strict=True):
            if not low - 1e-9 <= i <= high + 1e-9:
                return math.inf
        differences = [abs(goal - i) for goal, i in zip(self._goal, node, strict=True)]
        farthest = max(differences)
        return self._cell * (farthest + _TIE * (sum(differences) - farthest))

    def beside_goal(self, node: Node) -> bool:
        return all(abs(goal - i) <= 1.0 + 1e-9 for goal, i in zip(self._goal, node, strict=True))

    def _margin(self, node: Node) -> float:
        return self._clearance.swing_margin(self.place(node))

    def is_free(self, start: Node, end: Node) -> bool:
        """Return whether the line between two cells is proven free; the margins at its ends prove
        it where they are large enough.
        """
        margins = self.margin(start), self.margin(end)
        if min(margins) <= 0.0:
            return False
        line = Line(self.place(start), self.place(end))
        if self._clearance.travel(line.at(0.5), np.abs(line.end - line.start)) < sum(margins):
            return True
        return is_proven_free(self._clearance, line.start, line.end)
