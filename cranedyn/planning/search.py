"""Ways around obstacles: random trees by OMPL (Sucan, Moll, Kavraki 2012) and a grid, every edge
proven, then made short.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from cranedyn.command import held_back
from cranedyn.errors import CraneError
from cranedyn.planning.clearance import Clearance
from cranedyn.planning.curve import lasts
from cranedyn.planning.grid import best_on_grid
from cranedyn.planning.proof import Line, unproven

TRIES, LONGEST, CELLS = 8, 2.5, 15_000
"""How many trees are grown for a way, for how long one may grow in vain [s], and how many cells of
a grid are looked at."""

_SEED = 1
_STEPS = (4.0, 2.0, 1.0, 0.5, 0.25)
"""By how much corners are shifted on trial [s]."""

_NEAR = 1.01
"""A way is not looked for on a grid, too, if it lasts no more than so many times what a straight
one would."""

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
    clearance: Clearance,
    ends: np.ndarray,
    bounds: np.ndarray,
    rates: np.ndarray,
    *,
    tries: int = TRIES,
    thorough: bool = True,
) -> np.ndarray | None:
    """Places to go by: the shortest way by random trees or, if it is much longer than a straight
    one, on a grid; None if there is none.

    Args:
        clearance: Crane and site.
        ends: First and last place, shape (2, 3).
        bounds: Least and largest slew, trolley radius and cable length, shape (2, 3).
        rates: Rates of the drives, in whose time a way is measured, shape (3,).
        tries: How many trees are grown.
        thorough: Whether to look on a grid, too, where trees found nothing.

    Returns:
        Places, shape (n, 3), each proven to be reached from the one before along a straight line.

    Raises:
        CraneError: If OMPL is not installed.
    """
    free, rng = Proofs(clearance), np.random.default_rng(_SEED)
    if free(ends[0], ends[1]):
        return ends
    grow = _planner(free, ends, bounds, rates)
    best: np.ndarray | None = None
    for _ in range(tries):
        found = grow()
        if found is None:
            break
        found = _shortcuts(free, _fewer(free, found, rates), rates, rng)
        if best is None or _cost(found, rates) < _cost(best, rates):
            best = found
    ways = [] if best is None else [shortened(free, best, rates, bounds, rng)]
    if thorough if not ways else lasts(ways[0], rates).sum() > _NEAR * lasts(ends, rates).sum():
        on_grid = best_on_grid(clearance, ends, bounds, rates, most=CELLS).points
        ways += [] if on_grid is None else [shortened(free, on_grid, rates, bounds, rng)]
    return min(ways, key=lambda points: _cost(points, rates), default=None)


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


def _planner(
    free: Proofs, ends: np.ndarray, bounds: np.ndarray, rates: np.ndarray
) -> Callable[[], np.ndarray | None]:
    """What grows two trees towards each other, from the first place and from the last, measured in
    time at full speed.
    """
    base, geometric = _ompl()
    space = base.RealVectorStateSpace(3)
    limits = base.RealVectorBounds(3)
    for i in range(3):
        limits.setLow(i, float(bounds[0, i] / rates[i]))
        limits.setHigh(i, float(bounds[1, i] / rates[i]))
    space.setBounds(limits)
    information = base.SpaceInformation(space)

    def place(state: Any) -> np.ndarray:
        return np.array([state[i] for i in range(3)]) * rates

    class Proving(base.MotionValidator):  # type: ignore[misc, name-defined]
        def checkMotion(self, one: Any, other: Any) -> bool:
            return free(place(one), place(other))

    validator = Proving(information)
    information.setStateValidityChecker(lambda state: free.clearance.room(place(state)) > 0.0)
    information.setMotionValidator(validator)
    information.setup()
    states = []
    for end in ends:
        state = space.allocState()
        for i in range(3):
            state[i] = float(end[i] / rates[i])
        states.append(state)

    def grow() -> np.ndarray | None:
        problem = base.ProblemDefinition(information)
        problem.setStartAndGoalStates(*states)
        planner = geometric.RRTConnect(information)
        planner.setRange(float(np.abs((ends[1] - ends[0]) / rates).max()) / 2.0 + 4.0)
        planner.setProblemDefinition(problem)
        planner.setup()
        until = time.monotonic() + LONGEST
        with held_back() as interrupted:
            planner.solve(
                base.PlannerTerminationCondition(lambda: interrupted() or time.monotonic() > until)
            )
        if not problem.hasExactSolution():
            return None
        return np.array([place(state) for state in problem.getSolutionPath().getStates()])

    grow.kept = (validator, space, information)  # type: ignore[attr-defined]  # OMPL's C++ holds them by bare pointers
    return grow


def _ompl() -> tuple[Any, Any]:
    try:
        with held_back():  # which would end the process in the midst of its C++
            from ompl import base, geometric, util
    except ImportError as error:
        raise CraneError(
            "To plan a path install the extra planning: pip install 'cranedyn[planning]'."
        ) from error
    util.setLogLevel(util.LOG_NONE)
    if not _SEEDED:
        util.RNG.setSeed(_SEED)
        _SEEDED.append(True)
    return base, geometric


_SEEDED: list[bool] = []
