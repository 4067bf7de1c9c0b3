"""Ways around obstacles: the best way on a grid of places, every edge proven, then shortened.

A *way* is places that are joined by straight lines in slew, trolley radius and cable length. A
search on a grid also gives the length that other ways are compared with, and names the obstacles
where there is no way.

Lengths are *times at full speed*: the length of a straight line is the time that the slowest drive
needs for it at its rate. Many ways are equally long in this measure, since the other drives have
time to spare; small additional costs choose among them.
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

from cranedyn.lifts.planning.clearance import Clearance
from cranedyn.lifts.planning.curve import leg_durations
from cranedyn.lifts.planning.motion_proof import Line, is_proven_free

CELL_EDGES = (1.0, 0.5)
"""Edges of the cells of the grids that are searched, one after the other [s]."""

MAX_CELLS = 50_000
"""Largest number of cells that a search for a way reaches on each grid."""

_TIGHT_COST = 0.2
"""Additional cost of a second without margin. Of ways of equal length the one with more margin
becomes the quicker motion: its corners can be rounded more widely, and averaging may take the
motion farther off it."""

_FULL_MARGIN = 1.0
"""Margin from which on a place has no additional cost [m]; below it the cost grows linearly."""

_SEED_COUNT = 3
"""Number of seeds from which shortcuts of a way are drawn."""

_ROUNDS = 6
"""Largest number of rounds in which a way is shortened."""

_SHORTCUTS = 25
"""Number of shortcuts that are drawn in a round."""

_WORTHWHILE_RATIO = 0.999
"""Ratio of the cost of a way to its cost a round before above which no further round is tried."""

_SHIFTS = (4.0, 2.0, 1.0, 0.5, 0.25)
"""Distances by which corners are shifted on trial, the largest first [s]."""

_STRAIGHT_COST = 0.03
"""Weight of the Euclidean length of a way in its cost, beside the time of the slowest drive: of
ways that last equally long the straight one is the best."""

_TIE_COST = 1e-3
"""Additional cost of each further drive that moves in a step on the grid, as a share of the cost of
the step: of ways that last equally long the straight one is the best."""

_MIN_GAIN = 1e-6
"""Least reduction of its cost for which a way is changed [s]."""

_COST_ROUNDING = 1e-9
"""Rounding error of the cost of a way [s]."""

_SAME_PLACE = 1e-9
"""Largest difference of the coordinates of two places that count as one [rad or m]."""

_MAX_BLOCKED = 200
"""Number of blocked places that a search keeps, to name the obstacles there."""

_ON_GRID = 1e-9
"""Rounding error of a position on the grid [cells]."""

_NEIGHBOURS = [step for step in itertools.product((-1, 0, 1), repeat=3) if any(step)]
"""Steps from a cell to its 26 neighbours."""

_DIRECTIONS = [np.array(step, dtype=float) for step in _NEIGHBOURS if not all(step)]
"""Shifts of one drive or two."""

IsFree = Callable[[np.ndarray, np.ndarray], bool]
"""Whether the straight line between two places is proven free."""

Node = tuple[int, ...]
"""A cell, by whole numbers of cells from the first place."""

_START: Node = (0, 0, 0)
"""The cell of the first place."""


def search(
    clearance: Clearance, ends: np.ndarray, bounds: np.ndarray, rates: np.ndarray
) -> list[np.ndarray]:
    """Return ways: the straight line if it is proven free, else the best way on the coarsest grid
    that has one, shortened several times with shortcuts from different seeds. There is none if no
    grid has one, or the search on each of them gave up.

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
    for cell in CELL_EDGES:
        points = best_on_grid(
            clearance, ends, bounds, rates, cell=cell, cell_limit=MAX_CELLS, tight_cost=_TIGHT_COST
        ).points
        if points is not None:
            ways = []
            for seed in range(_SEED_COUNT):
                rng = np.random.default_rng(seed)
                ways.append(shortened(free, points, rates, bounds, rng))
            return ways
    return []


def _proofs(clearance: Clearance) -> IsFree:
    """Return a function that proves straight lines between places free, each of them once."""

    @cache
    def proven(start: tuple[float, ...], end: tuple[float, ...]) -> bool:
        return is_proven_free(clearance, np.array(start), np.array(end))

    # Arrays are no keys of a cache, tuples are.
    return lambda start, end: proven(tuple(start.tolist()), tuple(end.tolist()))


# --- shortening -----------------------------------------------------------------------------------


def shortened(
    free: IsFree,
    points: np.ndarray,
    rates: np.ndarray,
    bounds: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """Shorten a way along places: take shortcuts, leave corners out and shift corners while its
    cost falls.

    Args:
        free: Function that says whether the straight line between two places is proven free.
        points: Places of the way, shape (n, 3).
        rates: Rates of the drives, shape (3,).
        bounds: Least and largest place, shape (2, 3).
        rng: Source of the shortcuts that are tried.
    """
    before = math.inf
    for _ in range(_ROUNDS):
        points = _without_needless_corners(free, points, rates)
        points = _with_shortcuts(free, points, rates, rng)
        points = _without_needless_corners(free, points, rates)
        points = _with_shifted_corners(free, points, rates, bounds)
        cost = _cost(points, rates)
        if cost > _WORTHWHILE_RATIO * before:
            break
        before = cost
    return points


def _cost(points: np.ndarray, rates: np.ndarray) -> float:
    """Return the cost of a way along places, shape (n, 3): its time at full speed [s], and a share
    `_STRAIGHT_COST` of its Euclidean length in the times of all drives.
    """
    times_of_drives = np.abs(points[1:] - points[:-1]) / rates
    slowest = times_of_drives.max(axis=1)
    euclidean = np.sqrt((times_of_drives * times_of_drives).sum(axis=1))
    return float(slowest.sum() + _STRAIGHT_COST * euclidean.sum())


def _without_needless_corners(free: IsFree, points: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Leave out each corner without which the way costs no more and is proven free."""
    k = 1
    while k < len(points) - 1:
        candidate = np.delete(points, k, axis=0)
        is_no_longer = _cost(candidate, rates) <= _cost(points, rates) + _COST_ROUNDING
        if is_no_longer and free(points[k - 1], points[k + 1]):
            points = candidate
        else:
            k += 1
    return points


def _with_shortcuts(
    free: IsFree, points: np.ndarray, rates: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Replace parts of a way by straight lines between points of it that are drawn at random."""
    if len(points) <= 2:
        return points
    for _ in range(_SHORTCUTS):
        knots = np.concatenate([[0.0], np.cumsum(leg_durations(points, rates))])
        span = np.sort(rng.uniform(0.0, knots[-1], 2))
        first, last = np.searchsorted(knots, span, side="right")
        # On one leg there is nothing to shorten; rounding may put the end beyond the last leg.
        if first == last or last >= len(points):
            continue
        shortcut = np.column_stack([np.interp(span, knots, column) for column in points.T])
        candidate = np.concatenate([points[:first], shortcut, points[last:]])
        # What is left of both legs is part of lines that are proven free.
        is_shorter = _cost(candidate, rates) < _cost(points, rates) - _MIN_GAIN
        if is_shorter and free(shortcut[0], shortcut[1]):
            points = candidate
    return points


def _with_shifted_corners(
    free: IsFree, points: np.ndarray, rates: np.ndarray, bounds: np.ndarray
) -> np.ndarray:
    """Shift each corner by steps of one drive or two that make the way cost less."""
    points = points.copy()
    corners = range(1, len(points) - 1)
    for step, k, direction in itertools.product(_SHIFTS, corners, _DIRECTIONS):
        two_legs = points[k - 1 : k + 2]
        candidate = two_legs.copy()
        candidate[1] = np.clip(points[k] + step * direction * rates, bounds[0], bounds[1])
        is_shorter = _cost(candidate, rates) < _cost(two_legs, rates) - _MIN_GAIN
        if is_shorter and free(candidate[0], candidate[1]) and free(candidate[1], candidate[2]):
            points[k] = candidate[1]
    return points


# --- search on a grid -----------------------------------------------------------------------------


class GridSearch(NamedTuple):
    """Result of a search on a grid.

    Attributes:
        points: Places of the best way that was found, shape (n, 3); None if none was found.
        duration: Its length as time at full speed [s]; infinite if none was found.
        reached: Number of cells that were reached.
        gave_up: Whether the search ended because it had reached as many cells as it may. Then there
            may be a better way than the one found, and a way where none was found.
        blocked: Names of obstacles where the search ended, the most frequent first.
    """

    points: np.ndarray | None
    duration: float
    reached: int
    gave_up: bool
    blocked: list[str]


def best_on_grid(
    clearance: Clearance,
    ends: np.ndarray,
    bounds: np.ndarray,
    rates: np.ndarray,
    *,
    cell: float = 1.0,
    cell_limit: int = 400_000,
    tight_cost: float = 0.0,
) -> GridSearch:
    """Search for the shortest way over cells with 26 neighbours, by A*
    (Hart, Nilsson, Raphael 1968).

    Args:
        clearance: Crane and site.
        ends: First and last place, shape (2, 3).
        bounds: Least and largest place, shape (2, 3).
        rates: Rates of the drives, shape (3,).
        cell: Edge of a cell [s]: as far as each drive gets in that time.
        cell_limit: Number of cells after which the search gives up.
        tight_cost: Additional cost of a second without margin, see `_TIGHT_COST`.
    """
    grid = _Grid(clearance, ends, bounds, rates, cell)
    found = _a_star(grid, cell_limit, tight_cost)
    points = None
    duration = math.inf
    blocked = []
    if found.last is None:
        blocked = _obstacles_at(clearance, found.blocked)
    else:
        points = _way_to(grid, found.parents, found.last)
        duration = float(leg_durations(points, rates).sum())
    return GridSearch(points, duration, len(found.parents), found.gave_up, blocked)


class _Tree(NamedTuple):
    """Cells that A* has reached.

    Attributes:
        parents: The cell from which each reached cell is reached at the least cost; the start is
            its own parent.
        last: The cell from which the best way that was found goes straight to the goal; None if
            none was found.
        gave_up: Whether the search ended with cells in the queue that could have led to a better
            way, or to one at all.
        blocked: Places that could not be reached from a neighbour, up to `_MAX_BLOCKED` of them.
    """

    parents: dict[Node, Node]
    last: Node | None
    gave_up: bool
    blocked: list[np.ndarray]


def _a_star(grid: _Grid, cell_limit: int, tight_cost: float) -> _Tree:
    """Return the cells that A* reaches until it has proven its way to the goal to be the best, no
    cell is left, or it has reached so many cells that it gives up.

    A cell is taken from the queue in the order of its guess: the sum of the cost of the way to it
    and a lower bound of the cost from it to the goal.
    """
    parents: dict[Node, Node] = {}
    blocked: list[np.ndarray] = []
    best_cost = math.inf
    last: Node | None = None

    # Of cells with the same guess the one with the larger cost comes first: it is nearer to the
    # goal. A heap puts the least tuple first, so that costs are negative in it.
    queue: list[tuple[float, float, Node, Node]] = [(0.0, 0.0, _START, _START)]
    while queue and len(parents) < cell_limit:
        guess, negative_cost, node, parent = heapq.heappop(queue)
        if guess >= best_cost:
            break
        if node in parents:
            continue
        # Edges are proven when their turn comes: most never are.
        if node != _START and not grid.is_free(parent, node):
            if len(blocked) < _MAX_BLOCKED:
                blocked.append(grid.place(node))
            continue
        parents[node] = parent
        cost = -negative_cost

        # The goal is no cell. From each cell around it the way may go straight to it.
        cost_by_node = cost + grid.cost_to_goal(node)
        if cost_by_node < best_cost and grid.reaches_goal(node):
            best_cost = cost_by_node
            last = node
        _queue_neighbours(grid, queue, parents, node, cost, tight_cost)
    gave_up = len(parents) >= cell_limit and bool(queue) and queue[0][0] < best_cost
    return _Tree(parents, last, gave_up, blocked)


def _queue_neighbours(
    grid: _Grid,
    queue: list[tuple[float, float, Node, Node]],
    parents: dict[Node, Node],
    node: Node,
    cost: float,
    tight_cost: float,
) -> None:
    """Put the neighbours of a cell that are not reached yet into the queue of A*, with their
    guesses.

    Args:
        grid: The grid.
        queue: Guess, negative cost, cell and its parent, as a heap.
        parents: Cells that are reached.
        node: The cell.
        cost: Cost of the way to it.
        tight_cost: Additional cost of a second without margin.
    """
    for step, factor in _STEPS:
        neighbour = (node[0] + step[0], node[1] + step[1], node[2] + step[2])
        if neighbour in parents:
            continue
        to_goal = grid.cost_to_goal(neighbour)
        if to_goal == math.inf:
            continue
        if tight_cost:
            factor += tight_cost * max(0.0, _FULL_MARGIN - grid.margin(neighbour))
        reached = cost + grid.cell * factor
        heapq.heappush(queue, (reached + to_goal, -reached, neighbour, node))


def _cost_factor(step: Node) -> float:
    """Return the cost of a step to a neighbour, as a multiple of the edge of a cell."""
    moving_drives = sum(map(abs, step))
    return 1.0 + _TIE_COST * (moving_drives - 1)


_STEPS = [(step, _cost_factor(step)) for step in _NEIGHBOURS]
"""Steps to the neighbours of a cell, each with its cost as a multiple of the edge of a cell."""


def _obstacles_at(clearance: Clearance, places: list[np.ndarray]) -> list[str]:
    """Return the names of the obstacles nearest to places, the most frequent first."""
    names: Counter[str] = Counter()
    for drive_position in places:
        nearest = clearance.nearest(clearance.q(drive_position), count_zones=True)
        names[nearest.obstacle] += 1
    return [name for name, _ in names.most_common()]


def _way_to(grid: _Grid, parents: dict[Node, Node], last: Node) -> np.ndarray:
    """Return the places of the way from the first one to a last cell, which the parents of cells
    lead back along, and from it to the goal, shape (n, 3); none is equal to the one before.
    """
    nodes = [last]
    while nodes[-1] != _START:
        nodes.append(parents[nodes[-1]])
    places = [grid.place(node) for node in reversed(nodes)]
    places.append(grid.goal)
    points = np.array(places)
    # At the ends of the ranges two cells may have one place, and a cell may be the goal.
    is_new = np.append(True, np.abs(np.diff(points, axis=0)).max(axis=1) > _SAME_PLACE)
    return points[is_new]


class _Grid:
    """Cells about the first place. Neighbours differ by as far as each drive gets in a time.

    Attributes:
        cell: Edge of a cell [s].
        goal: The last place, shape (3,).
    """

    def __init__(
        self,
        clearance: Clearance,
        ends: np.ndarray,
        bounds: np.ndarray,
        rates: np.ndarray,
        cell: float,
    ) -> None:
        self.cell = cell
        self.goal = ends[1]
        self._clearance = clearance
        self._first = ends[0]
        self._bounds = bounds
        self._step = rates * cell

        # Goal and bounds in cells from the first place. Lists are quicker than arrays here.
        self._goal_cell = ((ends[1] - ends[0]) / self._step).tolist()
        self._low, self._high = ((bounds - ends[0]) / self._step).tolist()

        # A cell is asked for by each of its neighbours.
        self.margin = cache(self._margin)
        self.place = cache(self._place)
        self.cost_to_goal = cache(self._cost_to_goal)

    def _place(self, node: Node) -> np.ndarray:
        """Return the place of a cell, shape (3,); where it is out of bounds, the nearest one in
        them.
        """
        return np.clip(self._first + np.array(node) * self._step, self._bounds[0], self._bounds[1])

    def _cost_to_goal(self, node: Node) -> float:
        """Return a lower bound of the cost of a way from a cell to the goal, inf out of bounds."""
        for low, i, high in zip(self._low, node, self._high, strict=True):
            if not low - _ON_GRID <= i <= high + _ON_GRID:
                return math.inf
        differences = self._cells_to_goal(node)
        farthest = max(differences)
        return self.cell * (farthest + _TIE_COST * (sum(differences) - farthest))

    def _cells_to_goal(self, node: Node) -> list[float]:
        """Return how far each drive is from the goal [cells]."""
        return [abs(goal - i) for goal, i in zip(self._goal_cell, node, strict=True)]

    def reaches_goal(self, node: Node) -> bool:
        """Return whether the goal is beside a cell, and the straight line to it is proven free."""
        is_beside = all(cells <= 1.0 + _ON_GRID for cells in self._cells_to_goal(node))
        return is_beside and is_proven_free(self._clearance, self.place(node), self.goal)

    def _margin(self, node: Node) -> float:
        """Return the margin at the place of a cell, with the envelope of the swing [m]."""
        return self._clearance.swing_margin(self.place(node))

    def is_free(self, start: Node, end: Node) -> bool:
        """Return whether the line between two cells is proven free; the margins at its ends prove
        it where they are large enough.
        """
        margin_at_start = self.margin(start)
        margin_at_end = self.margin(end)
        if min(margin_at_start, margin_at_end) <= 0.0:
            return False
        # Let L be a bound of the change of the margin along the line. At the share t of the line
        # the margin is at least that of the start less t L, and at least that of the end less
        # (1 - t) L. If both margins together exceed L, one of the two bounds is positive for each
        # t: so this proves a margin above zero, and not one of `PROOF_MARGIN`.
        line = Line(self.place(start), self.place(end))
        change = self._clearance.travel(line.at(0.5), np.abs(line.end - line.start))
        if change < margin_at_start + margin_at_end:
            return True
        return is_proven_free(self._clearance, line.start, line.end)
