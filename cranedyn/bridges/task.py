"""The task of moving a load to a goal and leaving no swing, for learning: actions, observations,
rewards and starts of many cranes at once.

Arrays have a column for each of n cranes. Angles [rad], lengths [m], times [s].
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np

from cranedyn.checks import finite, number, short_repr, whole, within
from cranedyn.compiled.binding import ColumnFunction
from cranedyn.compiled.fleet import Fleet
from cranedyn.compiled.rows import compile_columns
from cranedyn.disturbances.wind import drag_force
from cranedyn.dynamics.integrators import rk4
from cranedyn.dynamics.scalars import larger, smaller, square_root
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.model.layout import Layout
from cranedyn.model.load import load_crane
from cranedyn.references.limits import LARGE_CRANE, Limits

INTEGRATOR, DT = rk4, 1e-2
"""Stepping rule, exact to order 4 while accelerations and wind are constant, and its step [s]."""

_AT_ONCE = 4096
"""Number of cranes up to which threads share the steps only: other work is so short that threads
would wait for the lock of the interpreter. Arrays of more would not stay in the cache."""

ACTIONS = ("velocity", "acceleration")

OBSERVED = (
    *("gamma_to_go", "x_to_go", "l_to_go", "gamma_dot", "x_dot", "l_dot"),
    *("phi", "theta", "phi_dot", "theta_dot", "x", "l"),
)
"""Observations: distance of each drive to its goal and its rate, both swings and their rates,
trolley radius, cable length; SI units."""

PENALTY = -50.0
"""Reward of a swing beyond the limit, which ends the episode; at a discount of 0.99 a longer one
cannot cost more."""

_MAX_WIND, _MAX_AREA = 1e3, 1e6
"""Largest wind [m/s] and drag area [m²]."""

_CLOSE = 0.01
"""Scale of distances in the reward [m]."""

_FASTEST = 20.0
"""Bound of swing rates [rad/s]: more than a load on a cable of 10 cm reaches in a fall from 90°."""

_MARGIN = 0.05
"""Margin of drives to the ends of their ranges [rad, m], against round-off."""


@dataclass(frozen=True, eq=False)
class Rules:
    """Rules of the task.

    Attributes:
        action: "velocity": shares of the rate limits, approached as fast as the acceleration limits
            allow. "acceleration": shares of the acceleration limits. Either
            way drives keep their rate limits and brake before the ends of their ranges.
        limits: Limits of rates and accelerations.
        reach: Farthest goal from the start of slew [rad], trolley [m], hoist [m].
        swing: Largest amplitude of swing at the start [rad].
        swing_limit: Swing that ends an episode [rad]; up to 45° the rope stays taut under
            accelerations of less than half of gravity.
        wind: Strongest wind [m/s]; each episode has a steady wind from a random direction.
        payload_area: Drag coefficient times area of the payload [m²].
    """

    action: str = "velocity"
    limits: Limits = LARGE_CRANE
    reach: Sequence[float] = (0.6, 10.0, 5.0)
    swing: float = 0.1
    swing_limit: float = np.pi / 4
    wind: float = 0.0
    payload_area: float = 4.0

    def __post_init__(self) -> None:
        if self.action not in ACTIONS:
            raise OutOfRange("action", self.action, " or ".join(ACTIONS))
        within("swing_limit", self.swing_limit, 1e-3, np.pi / 4, "rad")
        within("swing at the start", self.swing, 0.0, self.swing_limit, "rad")
        within("wind", self.wind, 0.0, _MAX_WIND, "m/s")
        within("drag area of the payload", self.payload_area, 0.0, _MAX_AREA, "m²")


def cranes_between(count: int, seed: int = 0, **ranges: tuple[float, float]) -> list[Crane]:
    """Return cranes with some numbers drawn uniformly between two bounds, such as
    ``payload_mass=(500, 3000)``; a tenth of a second for each.

    Raises:
        UnknownName: If there is no such number.
        OutOfRange: If a range is none, or a crane cannot have a number of it.
    """
    ends = {}
    for name, values in ranges.items():
        try:
            low, high = values
        except (TypeError, ValueError):
            raise OutOfRange(f"range of {name}", short_repr(values), "two numbers") from None
        ends[name] = number(f"range of {name}", low), number(f"range of {name}", high)
    rng = np.random.default_rng(whole("seed", seed, 0))
    indices = range(whole("number of cranes", count, 1))
    drawn: list[dict[str, Any]] = [
        {name: float(rng.uniform(*pair)) for name, pair in ends.items()} for _ in indices
    ]
    return [load_crane(**values) for values in drawn]


class SwingTask:
    """Cranes and their goals.

    Attributes:
        goal: Goals of the drives [rad, m, m], shape (3, n).
        goal_distance: Distance of each crane to its goal, see `distance` [m], shape (n,).
        fleet: The cranes.
        layout: Layout of all cranes.
        tower: Indices of slew, trolley, both swings and hoist among the coordinates.
    """

    def __init__(
        self,
        cranes: Crane | Sequence[Crane],
        count: int,
        rules: Rules,
        period: float,
        dt: float,
        threads: int | None,
    ) -> None:
        """Create the cranes, see `Fleet`.

        Raises:
            MissingRole, ModelError: If the cranes are no tower cranes of five joints.
            OutOfRange: If a rule has not one number for each drive, or as `Fleet`.
        """
        self.rules = rules
        clock: Any = {"dt": dt, "control_period": period, "threads": threads}
        self.fleet = Fleet(cranes, count, forces=rules.wind > 0.0, integrator=INTEGRATOR, **clock)
        self.layout = layout = self.fleet.layout
        self.tower = np.array(layout.tower("The task of moving a load without swing"))
        _, self._trolley, *_, self._hoist = self.tower.tolist()
        first = self.fleet.cranes[0]
        self.goal = np.tile(first.start.q[layout.drives][:, None], count)
        limits = [rules.limits.for_crane(crane) for crane in self.fleet.cranes]
        self._rates = np.min([limit.rates for limit in limits], axis=0)[:, None]
        self._reach = layout.for_drives("reach", rules.reach, "", ">= 0")[:, None]
        low, high = (
            np.array([getattr(crane, end)[layout.drives] for crane in self.fleet.cranes])
            for end in ("lower", "upper")
        )
        self._range = low.max(axis=0), high.min(axis=0)
        self._lower = (self._range[0] + _MARGIN)[:, None]
        self._upper = (self._range[1] - _MARGIN)[:, None]
        if not (self._lower < self._upper).all():
            raise OutOfRange(
                "ranges of the drives that all cranes have",
                [end.tolist() for end in self._range],
                "wider than 0.1 rad or m",
            )
        columns = self._rates[:, 0], limits[0].accelerations, self._lower[:, 0], self._upper[:, 0]
        # Arguments by which compiled code is found: a copy of the task has no functions to copy.
        self._motion = layout, period, rules.action == "velocity", tuple(zip(*columns, strict=True))
        n, passive, ends = layout.n, layout.passive, self.tower[[1, -1]]
        self._observed = np.concatenate([n + layout.drives, passive, n + passive, ends]).tolist()
        self._gravity, self._kind = first.gravity, np.zeros(count, dtype=int)
        self._force = np.zeros((count, 3 * len(layout.points)))
        self.goal_distance = self.distance(self.fleet.z, self.goal)

    def check_reset(
        self, start: State | None = None, goal: Sequence[float] | None = None
    ) -> dict[str, Any]:
        """Return start and goal of an episode in the form of `begin`.

        Raises:
            OutOfRange: If a goal is not in the ranges of the drives, or a start is no state of the
                crane.
        """
        if start is not None:
            start = self.layout.as_state("start", start)
        if goal is not None:
            ends = zip(self.layout.for_drives("goal", goal), *self._range, strict=True)
            goal = [within("goal", value, low, high) for value, low, high in ends]
        return {"start": start, "goal": goal}

    def begin(
        self,
        rng: np.random.Generator,
        indices: np.ndarray,
        start: State | None = None,
        goal: Sequence[float] | None = None,
    ) -> None:
        """Begin an episode of some cranes, given by their indices, shape (k,): random, or with
        start and goal as `check_reset` returns them.
        """
        rows, n, passive = indices.astype(int), len(indices), self.layout.passive
        low, high = self._lower, self._upper
        drives = rng.uniform(low, high, (self.layout.m, n))
        self.goal[:, rows] = rng.uniform(
            np.maximum(low, drives - self._reach), np.minimum(high, drives + self._reach)
        )
        q, v = np.zeros((2, self.layout.n, n))
        q[self.layout.drives] = drives
        swing = rng.uniform(0.0, self.rules.swing + 0.0, n)  # -0.0 would be less than 0.0
        angle, phase = rng.uniform(0.0, 2.0 * np.pi, (2, n))
        across = np.stack([np.cos(angle), np.sin(angle)]) * swing
        q[passive] = across * np.cos(phase)
        v[passive] = across * np.sin(phase) * np.sqrt(self._gravity / q[self._hoist])
        if start is not None:
            q, v = (np.repeat(array[:, None], n, axis=1) for array in start)
        if goal is not None:
            self.goal[:, rows] = np.array(goal)[:, None]
        self._kind[rows] = rng.integers(len(self.fleet.cranes), size=n)
        self.fleet.place(rows, State(q.T, v.T), self._kind[rows])
        if self.rules.wind:
            speed, side = rng.uniform(0.0, self.rules.wind, n), rng.uniform(-np.pi, np.pi, n)
            wind = speed[:, None] * np.column_stack([np.cos(side), np.sin(side)])
            # The force is that on a load at rest: its own velocity is neglected.
            self._force[rows, :2] = drag_force(self.rules.payload_area, wind)
            self.fleet.push(rows, self._force[rows])
        self.goal_distance = self.goal_distance.copy()
        self.goal_distance[rows] = self.distance(self.fleet.z[:, rows], self.goal[:, rows])

    def crane_of(self, index: int) -> Crane:
        """Return the crane of this episode, by its index."""
        return self.fleet.cranes[self._kind[index]]

    def force_on(self, index: int) -> list[float]:
        """Return the wind's force on the payload of a crane in this episode, in the world [N],
        three numbers.
        """
        return self._force[index, :3].tolist()

    def act(self, action: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Apply actions, shape (3, n), for a period.

        Returns:
            Rewards, shape (n,), whether the swing went beyond the limit, shape (n,), and the
            observations, see `observe`.

        Raises:
            OutOfRange: If an action is no number from -1 to 1.
        """
        checked, n = finite("action", action, self.goal.shape), self.fleet.count
        if (beyond := np.abs(checked) > 1.0).any():
            raise OutOfRange("action", float(checked[beyond][0]), "-1 to 1")
        reward, over, self.goal_distance = np.empty(n), np.empty(n, dtype=bool), np.empty(n)
        observations = np.empty((n, len(OBSERVED)), dtype=np.float32)

        def work(columns: slice, advance: Callable[[np.ndarray], np.ndarray]) -> None:
            goal, now = self.goal[:, columns], self.fleet.z[:, columns]
            z = advance(self.accelerations(checked[:, columns], now))
            distance, swing = _distance_code(self.layout, self._gravity)(z, goal)
            over[columns] = ~(swing < self.rules.swing_limit**2)
            lost = -self.fleet.control_period * np.log10(1.0 + distance / _CLOSE)
            reward[columns] = np.where(over[columns], PENALTY, lost)
            self.goal_distance[columns] = distance
            self.observation(z, goal, observations[columns])

        if n <= _AT_ONCE:
            work(slice(n), self.fleet.step)
        else:
            self.fleet.spread(lambda i: work(self.fleet.chunks[i], partial(self.fleet.advance, i)))
        return reward, over, observations

    def accelerations(self, action: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return the accelerations of the drives for actions from -1 to 1 at states, shape (3,
        n).
        """
        return _acceleration_code(*self._motion)(action, z)

    def distance(self, z: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Return how far from its goal each load would come if its drives stopped at once [m]:
        distance of the drives to the goal and amplitude of swing.
        """
        return _distance_code(self.layout, self._gravity)(z, goal)[0]

    def observe(self, which: Any = slice(None)) -> np.ndarray:
        """Return observations of some cranes or of all now, see `OBSERVED`, in single precision."""
        return self.observation(self.fleet.z[:, which], self.goal[:, which])

    def observation(self, z: np.ndarray, goal: np.ndarray, out: Any = None) -> np.ndarray:
        """Return the observations at states with goals, a column each, shape (n, 12), in `out`."""
        out = np.empty((z.shape[1], len(OBSERVED)), dtype=np.float32) if out is None else out
        out[:, :3] = (goal - z[self.layout.drives]).T
        for i, row in enumerate(self._observed, 3):
            out[:, i] = z[row]
        return out

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the least and largest observations, in single precision, shape (12,) each; a swing
        may be observed once beyond its limit.
        """
        first, ends = self.fleet.cranes[0], [self._trolley, self._hoist]
        width, rates = (first.upper - first.lower)[self.layout.drives], 1.01 * self._rates[:, 0]
        high = np.concatenate(
            [width, rates, np.full(2, np.pi), np.full(2, _FASTEST), first.upper[ends]]
        )
        low = np.concatenate([-high[:-2], first.lower[ends]])
        return low.astype(np.float32), high.astype(np.float32)


@cache
def _acceleration_code(
    layout: Layout, period: float, velocity: bool, limits: tuple[tuple[float, ...], ...]
) -> ColumnFunction:
    """Return the accelerations for actions and states, compiled; limits are rate, acceleration,
    lower and upper end of each drive.
    """

    def accelerations(value: Callable[[float], Any], numbers: np.ndarray) -> Iterator[Any]:
        action, z = np.split(numbers, [layout.m])
        drives = zip(action, z[layout.drives], z[layout.n + layout.drives], limits, strict=True)
        for share, position, rate, (fastest, slope, low, high) in drives:
            change = slope * period
            aim = share * fastest - rate if velocity else share * slope * period
            faster = rate + smaller(larger(aim, -change), change)
            # w after the period must let a drive stop: w²/(2a) + (w + rate) t/2 = its room.
            half, used = 0.5 * change, 2.0 * slope * position + change * rate
            room = half * half + 2.0 * slope * high - used, half * half - 2.0 * slope * low + used
            up, down = (smaller(square_root(larger(x, 0.0)) - half, fastest) for x in room)
            yield (smaller(larger(faster, -down), up) - rate) / value(period)

    return compile_columns(accelerations, [layout.m, 2 * layout.n], layout.m)


@cache
def _distance_code(layout: Layout, gravity: float) -> ColumnFunction:
    """Return distances, see `SwingTask.distance`, and squares of the swing, compiled."""
    slew, trolley, *_, hoist = layout.tower("The task of moving a load without swing")

    def distance(value: Callable[[float], Any], numbers: np.ndarray) -> list[Any]:
        z, goal = np.split(numbers, [2 * layout.n])
        passive, length = layout.passive, z[hoist]
        off = goal - z[layout.drives]
        off[slew] = off[slew] * z[trolley]
        swing, rate = z[passive] * z[passive], z[layout.n + passive]
        amplitude = (swing + rate * rate * (length / value(gravity))).sum()
        return [square_root((off * off).sum()) + length * square_root(amplitude), swing.sum()]

    return compile_columns(distance, [2 * layout.n, layout.m], 2)
