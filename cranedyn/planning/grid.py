"""The best way on a grid of places, every edge proven: the measure of other ways, and the reason
where there is none.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections import Counter
from typing import NamedTuple

import numpy as np

from cranedyn.planning.clearance import Clearance
from cranedyn.planning.curve import leg_durations
from cranedyn.planning.proof import Line, is_proven_free

CELL = 1.0
"""Edge of a cell [s]: as far as each drive gets in that time."""

_TIE = 1e-3
"""Cost of a step of a further drive beside one of the slowest: of ways that last equally long the
straight one."""

_BLOCKED = 200
"""Number of blocked places to keep, to name the obstacles there."""

_STEPS = [step for step in itertools.product((-1, 0, 1), repeat=3) if any(step)]

Node = tuple[int, ...]
"""A cell, by whole numbers from the first place."""


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
    cell: float = CELL,
    cell_limit: int = 400_000,
    tight: float = 0.0,
) -> GridSearch:
    """Return the shortest way by A* (Hart, Nilsson, Raphael 1968) over cells with 26 neighbours.

    Args:
        clearance: Crane and site.
        ends: First and last place, shape (2, 3).
        bounds: Least and largest slew, trolley radius and cable length, shape (2, 3).
        rates: Rates of the drives, shape (3,).
        cell: Edge of a cell [s].
        cell_limit: Number of cells after which the search gives up.
        tight: Additional cost of a second without margin, less so up to a margin of a metre.
    """
    grid, start = _Grid(clearance, ends, bounds, rates, cell), (0, 0, 0)
    parents: dict[Node, Node] = {}
    queue: list[tuple[float, float, Node, Node]] = [(grid.cost_to_goal(start), 0.0, start, start)]
    blocked: list[np.ndarray] = []
    best: float = math.inf
    last: Node = start
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
        if grid.beside_goal(node) and cost + to_goal < best and grid.is_free_to_goal(node):
            best, last = cost + to_goal, node
        for step in _STEPS:
            neighbour = (node[0] + step[0], node[1] + step[1], node[2] + step[2])
            if neighbour not in parents and grid.inside(neighbour):
                factor = 1.0 + _TIE * (sum(map(abs, step)) - 1)
                if tight:
                    factor += tight * max(0.0, 1.0 - grid.margin(neighbour))
                reached = cost + cell * factor
                item = (reached + grid.cost_to_goal(neighbour), -reached, neighbour, node)
                heapq.heappush(queue, item)
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
        self._margins: dict[Node, float] = {}

    def place(self, node: Node) -> np.ndarray:
        return np.clip(self._ends[0] + np.array(node) * self._step, *self._bounds)

    def inside(self, node: Node) -> bool:
        return all(
            low - 1e-9 <= i <= high + 1e-9
            for low, i, high in zip(self._low, node, self._high, strict=True)
        )

    def cost_to_goal(self, node: Node) -> float:
        """Return a lower bound of the cost of a way from a cell to the goal."""
        differences = [abs(goal - i) for goal, i in zip(self._goal, node, strict=True)]
        farthest = max(differences)
        return self._cell * (farthest + _TIE * (sum(differences) - farthest))

    def beside_goal(self, node: Node) -> bool:
        return all(abs(goal - i) <= 1.0 + 1e-9 for goal, i in zip(self._goal, node, strict=True))

    def is_free_to_goal(self, node: Node) -> bool:
        return is_proven_free(self._clearance, self.place(node), self._ends[1])

    def margin(self, node: Node) -> float:
        if node not in self._margins:
            self._margins[node] = self._clearance.swing_margin(self.place(node))
        return self._margins[node]

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
