"""The best way on a grid of places, every edge proven: what other ways are measured against, and
why there is none.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections import Counter
from typing import NamedTuple

import numpy as np

from cranedyn.planning.clearance import Clearance
from cranedyn.planning.curve import lasts
from cranedyn.planning.proof import Line, unproven

CELL = 1.0
"""Edge of a cell [s]: as far as each drive gets in that time."""

_TIE = 1e-3
"""What a step of a further drive costs beside one of the slowest: of ways that last equally long
the straight one."""

_BLOCKED = 200
"""How many places in the way are kept, to say what stands there."""

_STEPS = [step for step in itertools.product((-1, 0, 1), repeat=3) if any(step)]


class Searched(NamedTuple):
    """What a search on a grid found.

    Attributes:
        points: Places of the best way, shape (n, 3); None if there is none.
        duration: Its length as time at full speed [s], inf if there is none.
        reached: How many cells were reached.
        blocked: Names of what stood in the way where the search ended, the most frequent first.
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
    most: int = 400_000,
    tight: float = 0.0,
) -> Searched:
    """The shortest way by A* (Hart, Nilsson, Raphael 1968) over cells, all 26 neighbours of each.

    Args:
        clearance: Crane and site.
        ends: First and last place, shape (2, 3).
        bounds: Least and largest slew, trolley radius and cable length, shape (2, 3).
        rates: Rates of the drives, shape (3,).
        cell: Edge of a cell [s].
        most: Cells after which it gives up.
        tight: What a second costs more where there is no room, less so up to a metre of it.
    """
    grid, start = _Grid(clearance, ends, bounds, rates, cell), (0, 0, 0)
    before: dict[tuple[int, ...], tuple[int, ...]] = {}
    waiting = [(grid.left(start), 0.0, start, start)]
    blocked: list[np.ndarray] = []
    best, last = math.inf, start
    # Edges are proven when their turn comes: most never are.
    while waiting and len(before) < most:
        guess, behind, here, parent = heapq.heappop(waiting)
        if guess >= best:
            break
        if here in before:
            continue
        if here != start and not grid.free(parent, here):
            if len(blocked) < _BLOCKED:
                blocked.append(grid.place(here))
            continue
        before[here], gone = parent, -behind
        to_goal = grid.left(here)
        if grid.beside_goal(here) and gone + to_goal < best and grid.free_to_goal(here):
            best, last = gone + to_goal, here
        for step in _STEPS:
            there = (here[0] + step[0], here[1] + step[1], here[2] + step[2])
            if there not in before and grid.inside(there):
                share = 1.0 + _TIE * (sum(map(abs, step)) - 1)
                if tight:
                    share += tight * max(0.0, 1.0 - grid.room(there))
                beyond = gone + cell * share
                heapq.heappush(waiting, (beyond + grid.left(there), -beyond, there, here))
    if best == math.inf:
        names = Counter(
            clearance.nearest(clearance.q(place), beside_zones=True).obstacle for place in blocked
        )
        return Searched(None, best, len(before), [name for name, _ in names.most_common()])
    way: list[tuple[int, ...]] = [last]
    while way[-1] != start:
        way.append(before[way[-1]])
    points = np.array([*(grid.place(node) for node in reversed(way)), ends[1]])
    points = points[np.append(True, np.abs(np.diff(points, axis=0)).max(axis=1) > 1e-9)]
    return Searched(points, float(lasts(points, rates).sum()), len(before), [])


class _Grid:
    """Cells about the first place, by whole numbers."""

    def __init__(
        self,
        clearance: Clearance,
        ends: np.ndarray,
        bounds: np.ndarray,
        rates: np.ndarray,
        cell: float,
    ) -> None:
        self._clearance, self._ends, self._step, self._bounds = (
            clearance,
            ends,
            rates * cell,
            bounds,
        )
        self._way = ((ends[1] - ends[0]) / self._step).tolist()
        self._cell = cell
        self._low, self._high = ((bounds - ends[0]) / self._step).tolist()
        self._rooms: dict[tuple[int, ...], float] = {}

    def place(self, node: tuple[int, ...]) -> np.ndarray:
        return np.clip(self._ends[0] + np.array(node) * self._step, *self._bounds)

    def inside(self, node: tuple[int, ...]) -> bool:
        return all(
            low - 1e-9 <= part <= high + 1e-9
            for low, part, high in zip(self._low, node, self._high, strict=True)
        )

    def left(self, node: tuple[int, ...]) -> float:
        """Return what a way from a cell to the goal costs at least."""
        apart = [abs(way - part) for way, part in zip(self._way, node, strict=True)]
        most = max(apart)
        return self._cell * (most + _TIE * (sum(apart) - most))

    def beside_goal(self, node: tuple[int, ...]) -> bool:
        return all(abs(way - part) <= 1.0 + 1e-9 for way, part in zip(self._way, node, strict=True))

    def free_to_goal(self, node: tuple[int, ...]) -> bool:
        return unproven(self._clearance, Line(self.place(node), self._ends[1]), 0.0, 1.0) is None

    def room(self, node: tuple[int, ...]) -> float:
        if node not in self._rooms:
            self._rooms[node] = self._clearance.room(self.place(node))
        return self._rooms[node]

    def free(self, one: tuple[int, ...], other: tuple[int, ...]) -> bool:
        """Whether the line between two cells is proven; by the room at its ends where that is
        enough.
        """
        rooms = self.room(one), self.room(other)
        if min(rooms) <= 0.0:
            return False
        line = Line(self.place(one), self.place(other))
        if self._clearance.travel(line.at(0.5), np.abs(line.end - line.start)) < sum(rooms):
            return True
        return unproven(self._clearance, line, 0.0, 1.0) is None
