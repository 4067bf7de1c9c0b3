"""The task of moving a load to a goal and leaving no swing, for reinforcement learning.

`SwingTask` holds many tower cranes at once. It draws the starts and goals of episodes (`begin`),
turns actions into accelerations of the drives and steps the cranes (`act`), and observes and
rewards them. `cranedyn.interop.gymnasium` makes environments of it.

Arrays have a column for each of n cranes. Angles are in rad, lengths in m, times in s. A state z is
the coordinates and then their rates, shape (2 coordinates, n): slew, trolley, radial swing,
tangential swing and hoist, of which the swings are the passive joints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, NamedTuple

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

INTEGRATOR = rk4
"""Stepping rule: of order 4, since accelerations and wind are constant during a control period."""

DT = 1e-2
"""Physics step [s]."""

_MAX_UNDIVIDED_COUNT = 4096
"""Largest number of cranes for which the threads share only the physics steps.

The rest of the work on so few cranes is so short that the threads would wait for the lock of the
interpreter. With more cranes each thread does all the work on some of them, since the arrays of all
cranes would not stay in the cache.
"""

ACTIONS = ("velocity", "acceleration")
"""Kinds of actions, see `Rules`."""

OBSERVED = (
    "gamma_to_go",
    "x_to_go",
    "l_to_go",
    "gamma_dot",
    "x_dot",
    "l_dot",
    "phi",
    "theta",
    "phi_dot",
    "theta_dot",
    "x",
    "l",
)
"""Observations in their order, in SI units.

They are the distance of each drive to its goal, the rate of each drive, both swings, their rates,
the trolley radius and the cable length.
"""

PENALTY = -50.0
"""Reward of a swing beyond the limit, which ends the episode.

A policy must not gain by ending an episode early. A step costs at most about 0.4 at distances of
100 m, so at a discount of 0.99 all steps to come cost less than 0.4/(1 - 0.99) = 40.
"""

_MAX_WIND = 1e3
"""Largest speed of the wind that may be asked for [m/s]."""

_MAX_AREA = 1e6
"""Largest drag area of the payload that may be asked for [m²]."""

_REWARD_SCALE = 0.01
"""Distance to the goal below which coming closer is hardly rewarded any more [m]."""

_MAX_SWING_RATE = 20.0
"""Bound of swing rates [rad/s]: more than a load on a cable of 10 cm reaches in a fall from 90°."""

_RANGE_MARGIN = 0.05
"""Distance that drives keep from the ends of their ranges [rad or m], against round-off."""

_PURPOSE = "The task of moving a load without swing"
"""Beginning of the error message for a crane that is no tower crane."""


@dataclass(frozen=True, eq=False)
class Rules:
    """Rules of the task.

    Attributes:
        action: What an action is: with "velocity" a share of the rate limit of each drive, which
            the drive approaches as fast as its acceleration limit allows, with "acceleration" a
            share of the acceleration limit. Either way the drives keep their rate limits and brake
            before the ends of their ranges.
        limits: Limits of rates and accelerations of the drives.
        reach: Farthest goal from the start of slew [rad], trolley [m] and hoist [m].
        swing: Largest amplitude of the swing at the start [rad].
        swing_limit: Swing that ends an episode [rad], at most 45°: up to there the rope stays taut
            under accelerations of less than half of gravity.
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
    """Return tower cranes of this project with some of their numbers drawn at random.

    Loading takes a tenth of a second for each crane.

    Args:
        count: Number of cranes.
        seed: Seed of the random numbers.
        ranges: Bounds between which an argument of `load_crane` is drawn uniformly, by its name,
            such as ``payload_mass=(500, 3000)``.

    Raises:
        UnknownName: If there is no such argument.
        OutOfRange: If a range is not two numbers, or a crane cannot have a number of it.
    """
    bounds = {}
    for name, values in ranges.items():
        try:
            low, high = values
        except (TypeError, ValueError):
            raise OutOfRange(f"range of {name}", short_repr(values), "two numbers") from None
        bounds[name] = (number(f"range of {name}", low), number(f"range of {name}", high))
    rng = np.random.default_rng(whole("seed", seed, 0))
    cranes = []
    for _ in range(whole("number of cranes", count, 1)):
        arguments: dict[str, Any] = {}
        for name, (low, high) in bounds.items():
            arguments[name] = float(rng.uniform(low, high))
        cranes.append(load_crane(**arguments))
    return cranes


@dataclass(frozen=True, eq=False)
class EpisodeStart:
    """How an episode begins; what is None is drawn at random.

    Attributes:
        start: State of the crane.
        goal: Goals of slew [rad], trolley [m] and hoist [m].
    """

    start: State | None = None
    goal: Sequence[float] | None = None


class SwingTask:
    """Many cranes, each with its goal.

    Attributes:
        rules: The rules.
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

        Args:
            cranes: The crane, or several, one of which is drawn for each episode.
            count: Number of cranes at once, n.
            rules: The rules.
            period: Time from one action to the next [s].
            dt: Physics step [s].
            threads: Number of threads; None for one on each processor.

        Raises:
            MissingRole, ModelError: If the cranes are no tower cranes of five joints.
            OutOfRange: If a rule has not one number for each drive, the cranes stand in different
                gravities or have no range of a drive in common, or as `Fleet`.
        """
        self.rules = rules
        self.fleet = Fleet(
            cranes,
            count,
            forces=rules.wind > 0.0,
            integrator=INTEGRATOR,
            dt=dt,
            control_period=period,
            threads=threads,
        )
        self.layout = self.fleet.layout
        self.tower = np.array(self.layout.tower(_PURPOSE))
        _, self._trolley, *_, self._hoist = self.tower.tolist()
        first = self.fleet.cranes[0]
        self._gravity = _common_gravity(self.fleet.cranes)
        self.goal = np.tile(first.start.q[self.layout.drives][:, None], count)
        self._reach = self.layout.for_drives("reach", rules.reach, "", ">= 0")[:, None]

        self._set_ranges()
        self._set_limits(period)
        n = self.layout.n
        passive = self.layout.passive
        radius_and_length = self.tower[[1, -1]]
        # Rows of (coordinates, rates) that are observed, after the three distances to go.
        self._observed_rows = np.concatenate(
            [n + self.layout.drives, passive, n + passive, radius_and_length]
        ).tolist()
        # Which of `fleet.cranes` each episode has.
        self._crane_index = np.zeros(count, dtype=int)
        # Forces of the wind on the points of each crane, of which the payload is the first [N].
        self._force = np.zeros((count, 3 * len(self.layout.points)))
        self.goal_distance = self.distance(self.fleet.z, self.goal)

    def _set_ranges(self) -> None:
        """Set the ranges of the drives to those that all cranes have.

        Raises:
            OutOfRange: If there is none.
        """
        drives = self.layout.drives
        lower = np.array([crane.lower[drives] for crane in self.fleet.cranes])
        upper = np.array([crane.upper[drives] for crane in self.fleet.cranes])
        self._lowest = lower.max(axis=0)
        self._highest = upper.min(axis=0)
        self._lower = (self._lowest + _RANGE_MARGIN)[:, None]
        self._upper = (self._highest - _RANGE_MARGIN)[:, None]
        if not (self._lower < self._upper).all():
            raise OutOfRange(
                "ranges of the drives that all cranes have",
                [self._lowest.tolist(), self._highest.tolist()],
                "wider than 0.1 rad or m",
            )

    def _set_limits(self, period: float) -> None:
        """Set the limits of the drives: the smallest rates of all cranes, since one compiled
        function serves them all. Their accelerations are those of the rules.

        Args:
            period: Time from one action to the next [s].
        """
        limits = [self.rules.limits.for_crane(crane) for crane in self.fleet.cranes]
        self._rates = np.min([limit.rates for limit in limits], axis=0)
        drive_limits = []
        for i in range(self.layout.m):
            drive_limits.append(
                DriveLimits(
                    self._rates[i],
                    limits[0].accelerations[i],
                    self._lower[i, 0],
                    self._upper[i, 0],
                )
            )
        # These arguments are kept instead of the compiled function, which cannot be copied, so that
        # a task can be; `_acceleration_code` caches the function.
        self._acceleration_key = (
            self.layout,
            period,
            self.rules.action == "velocity",
            tuple(drive_limits),
        )

    def check_reset(
        self, start: State | None = None, goal: Sequence[float] | None = None
    ) -> EpisodeStart:
        """Check how an episode shall begin, and return that for `begin`.

        Args:
            start: State of the crane; None for a random one.
            goal: Goals of slew [rad], trolley [m] and hoist [m]; None for random ones.

        Raises:
            OutOfRange: If a goal is not in the ranges of the drives, or the start is no state of
                the crane.
        """
        if start is not None:
            start = self.layout.as_state("start", start)
        if goal is not None:
            goals = self.layout.for_drives("goal", goal)
            goal = []
            for value, low, high in zip(goals, self._lowest, self._highest, strict=True):
                goal.append(within("goal", value, low, high))
        return EpisodeStart(start, goal)

    def begin(
        self,
        rng: np.random.Generator,
        indices: np.ndarray,
        initial: EpisodeStart | None = None,
    ) -> None:
        """Begin an episode of some cranes.

        Start and goal are drawn even where they are given, so that the random numbers of later
        episodes depend on the seed alone.

        Args:
            rng: Source of the random numbers.
            indices: Indices of the cranes, shape (k,).
            initial: Start and goal, as `check_reset` returns them; None for random ones.
        """
        if initial is None:
            initial = EpisodeStart()
        rows = indices.astype(int)
        n = len(indices)
        state = self._draw_state_and_goal(rng, rows)
        if initial.start is not None:
            q, v = initial.start
            state = State(np.repeat(q[:, None], n, axis=1), np.repeat(v[:, None], n, axis=1))
        if initial.goal is not None:
            self.goal[:, rows] = np.array(initial.goal)[:, None]
        self._crane_index[rows] = rng.integers(len(self.fleet.cranes), size=n)
        self.fleet.place(rows, State(state.q.T, state.v.T), self._crane_index[rows])
        if self.rules.wind:
            self._draw_wind(rng, rows)
        # A new array, since the infos of earlier steps hold the old one.
        self.goal_distance = self.goal_distance.copy()
        self.goal_distance[rows] = self.distance(self.fleet.z[:, rows], self.goal[:, rows])

    def _draw_state_and_goal(self, rng: np.random.Generator, rows: np.ndarray) -> State:
        """Draw goals of some cranes and set them, and draw and return their states, shape
        (coordinates, k) each.

        The load swings with an amplitude A in a random direction and phase. The swing of a pendulum
        is A cos(ω t), so its rate has the amplitude ω A with ω = √(g/l).
        """
        n = len(rows)
        drives = rng.uniform(self._lower, self._upper, (self.layout.m, n))
        nearest = np.maximum(self._lower, drives - self._reach)
        farthest = np.minimum(self._upper, drives + self._reach)
        self.goal[:, rows] = rng.uniform(nearest, farthest)

        q = np.zeros((self.layout.n, n))
        v = np.zeros((self.layout.n, n))
        q[self.layout.drives] = drives
        # Adding 0.0 makes 0.0 of -0.0, which NumPy refuses as an upper end below the lower one.
        amplitude = rng.uniform(0.0, self.rules.swing + 0.0, n)
        direction, phase = rng.uniform(0.0, 2.0 * np.pi, (2, n))
        swing = np.stack([np.cos(direction), np.sin(direction)]) * amplitude
        passive = self.layout.passive
        q[passive] = swing * np.cos(phase)
        v[passive] = swing * np.sin(phase) * np.sqrt(self._gravity / q[self._hoist])
        return State(q, v)

    def _draw_wind(self, rng: np.random.Generator, rows: np.ndarray) -> None:
        """Draw a steady wind for the episodes of some cranes, and let it push their payloads."""
        speed = rng.uniform(0.0, self.rules.wind, len(rows))
        direction = rng.uniform(-np.pi, np.pi, len(rows))
        wind = speed[:, None] * np.column_stack([np.cos(direction), np.sin(direction)])
        # The force is that on a load at rest: its own velocity is neglected.
        self._force[rows, :2] = drag_force(self.rules.payload_area, wind)
        self.fleet.push(rows, self._force[rows])

    def crane_of(self, index: int) -> Crane:
        """Return which crane the present episode of a column has."""
        return self.fleet.cranes[self._crane_index[index]]

    def force_on(self, index: int) -> list[float]:
        """Return the force of the wind on the payload of a column in the present episode [N]: three
        numbers, in the axes of the world.
        """
        return self._force[index, :3].tolist()

    def act(self, action: np.ndarray) -> ActResult:
        """Apply actions for a control period.

        Args:
            action: Actions from -1 to 1, shape (3, n).

        Raises:
            OutOfRange: If an action is no number from -1 to 1.
        """
        action = finite("action", action, self.goal.shape)
        n = self.fleet.count
        too_large = np.abs(action) > 1.0
        if too_large.any():
            raise OutOfRange("action", float(action[too_large][0]), "-1 to 1")
        result = ActResult(
            np.empty(n), np.empty(n, dtype=bool), np.empty((n, len(OBSERVED)), dtype=np.float32)
        )
        self.goal_distance = np.empty(n)

        def step(columns: slice, advance: Callable[[np.ndarray], np.ndarray]) -> None:
            """Move the cranes of some columns by `advance`, which takes the accelerations of their
            drives and returns their states, and judge these.
            """
            accelerations = self.accelerations(action[:, columns], self.fleet.z[:, columns])
            self._judge(columns, advance(accelerations), result)

        def step_chunk(i: int) -> None:
            step(self.fleet.chunks[i], partial(self.fleet.advance, i))

        if n <= _MAX_UNDIVIDED_COUNT:
            step(slice(n), self.fleet.step)
        else:
            self.fleet.spread(step_chunk)
        return result

    def _judge(self, columns: slice, z: np.ndarray, result: ActResult) -> None:
        """Fill in rewards, ends and observations of the cranes of some columns at states z."""
        goal = self.goal[:, columns]
        distance, swing_squared = _distance_code(self.layout, self._gravity)(z, goal)
        # Written with "not smaller", a swing that is not a number is beyond the limit, too.
        is_too_large = ~(swing_squared < self.rules.swing_limit**2)
        # The logarithm rewards the last centimetres as much as the first metres.
        reward = -self.fleet.control_period * np.log10(1.0 + distance / _REWARD_SCALE)
        result.terminated[columns] = is_too_large
        result.reward[columns] = np.where(is_too_large, PENALTY, reward)
        self.goal_distance[columns] = distance
        self.observation(z, goal, result.observations[columns])

    def accelerations(self, action: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return the accelerations of the drives [rad/s² or m/s²], shape (3, n).

        Args:
            action: Actions from -1 to 1, shape (3, n).
            z: Coordinates and rates, a column for each crane.
        """
        return _acceleration_code(*self._acceleration_key)(action, z)

    def distance(self, z: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Return the distance of each crane to its goal [m], shape (n,).

        It is the distance of the drives, plus the amplitude with which the load would swing if the
        drives stopped at once.

        Args:
            z: Coordinates and rates, a column for each crane.
            goal: Goals of the drives, a column for each crane.
        """
        return _distance_code(self.layout, self._gravity)(z, goal)[0]

    def observe(self, which: Any = slice(None)) -> np.ndarray:
        """Return the present observations, see `OBSERVED`, in single precision.

        Args:
            which: Index, mask or slice of the cranes; by default all.
        """
        return self.observation(self.fleet.z[:, which], self.goal[:, which])

    def observation(self, z: np.ndarray, goal: np.ndarray, out: Any = None) -> np.ndarray:
        """Return the observations at states with goals, shape (n, 12).

        Args:
            z: Coordinates and rates, a column for each crane.
            goal: Goals of the drives, a column for each crane.
            out: Array for the observations; None for a new one.
        """
        if out is None:
            out = np.empty((z.shape[1], len(OBSERVED)), dtype=np.float32)
        out[:, :3] = (goal - z[self.layout.drives]).T
        # Row by row, not by an index array, which would copy all of them first.
        for i, row in enumerate(self._observed_rows, 3):
            out[:, i] = z[row]
        return out

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the smallest and the largest possible observations, in single precision, shape
        (12,) each.

        Swings are bounded by 180° and not by the limit of the rules, since the last observation of
        an episode may be beyond that.
        """
        first = self.fleet.cranes[0]
        radius_and_length = [self._trolley, self._hoist]
        distances = (first.upper - first.lower)[self.layout.drives]
        # Rates may exceed their limits by round-off, also that of single precision.
        rates = 1.01 * self._rates
        swings = np.full(2, np.pi)
        swing_rates = np.full(2, _MAX_SWING_RATE)
        symmetric = np.concatenate([distances, rates, swings, swing_rates])
        low = np.concatenate([-symmetric, first.lower[radius_and_length]])
        high = np.concatenate([symmetric, first.upper[radius_and_length]])
        return low.astype(np.float32), high.astype(np.float32)


@dataclass(frozen=True, eq=False)
class ActResult:
    """Result of a period of all n cranes.

    Attributes:
        reward: Rewards, shape (n,).
        terminated: Whether the swing went beyond the limit, which ends an episode, shape (n,).
        observations: Observations, see `OBSERVED`, in single precision, shape (n, 12).
    """

    reward: np.ndarray
    terminated: np.ndarray
    observations: np.ndarray


class DriveLimits(NamedTuple):
    """Limits of a drive.

    Attributes:
        rate: Largest rate [rad/s or m/s].
        acceleration: Largest acceleration [rad/s² or m/s²].
        lower: Lower end of its range [rad or m].
        upper: Upper end of its range [rad or m].
    """

    rate: float
    acceleration: float
    lower: float
    upper: float


def _common_gravity(cranes: Sequence[Crane]) -> float:
    """Return the gravity in which all cranes stand [m/s²]: distances and starts take it for that of
    every crane.

    Raises:
        OutOfRange: If they stand in different gravities.
    """
    gravities = sorted({crane.gravity for crane in cranes})
    if len(gravities) > 1:
        raise OutOfRange("gravity of the cranes", gravities, "the same for all", "m/s²")
    return gravities[0]


@cache
def _acceleration_code(
    layout: Layout, period: float, is_velocity: bool, limits: tuple[DriveLimits, ...]
) -> ColumnFunction:
    """Return the function from actions and states to accelerations of the drives, compiled.

    Args:
        layout: Layout of the crane.
        period: Time from one action to the next [s].
        is_velocity: Whether actions are shares of the rates, not of the accelerations.
        limits: Limits of each drive.
    """

    def accelerations(value: Callable[[float], Any], numbers: np.ndarray) -> Iterator[Any]:
        action, z = np.split(numbers, [layout.m])
        positions = z[layout.drives]
        rates = z[layout.n + layout.drives]
        for i, limit in enumerate(limits):
            new_rate = _next_rate(action[i], positions[i], rates[i], limit, period, is_velocity)
            yield (new_rate - rates[i]) / value(period)

    return compile_columns(accelerations, [layout.m, 2 * layout.n], layout.m)


def _next_rate(
    action: Any, position: Any, rate: Any, limit: DriveLimits, period: float, is_velocity: bool
) -> Any:
    """Return the rate of a drive after a period, within its limits, for floats and compiled code.

    The drive must be able to stop before the end of its range. In a period T it goes from the rate
    v to w, which takes it by (v + w) T/2, and then it brakes with the acceleration a, which takes
    it by w²/(2 a). Both must fit into the distance d to the end: w²/(2 a) + (v + w) T/2 <= d. The
    largest such w is √((a T/2)² + 2 a d - a T v) - a T/2. For the other end all signs are reversed.
    """
    max_change = limit.acceleration * period
    if is_velocity:
        change = action * limit.rate - rate
    else:
        change = action * limit.acceleration * period
    wanted = rate + smaller(larger(change, -max_change), max_change)

    half = 0.5 * max_change
    # With d = upper - position up, and d = position - lower down, both radicands have this part of
    # the position and of the rate.
    moving_part = 2.0 * limit.acceleration * position + max_change * rate
    radicand_up = half * half + 2.0 * limit.acceleration * limit.upper - moving_part
    radicand_down = half * half - 2.0 * limit.acceleration * limit.lower + moving_part
    max_up = smaller(square_root(larger(radicand_up, 0.0)) - half, limit.rate)
    max_down = smaller(square_root(larger(radicand_down, 0.0)) - half, limit.rate)
    return smaller(larger(wanted, -max_down), max_up)


@cache
def _distance_code(layout: Layout, gravity: float) -> ColumnFunction:
    """Return the compiled function from states and goals to the distances of `SwingTask.distance`
    [m] and the squares of the swings [rad²].

    A swing with the angle φ and the rate φ' has the amplitude A = √(φ² + φ'² l/g): its energy per
    mass is g l φ²/2 + (l φ')²/2 = g l A²/2. It takes the load l A from plumb. The way of the slew
    counts as the arc at the radius of the trolley.
    """
    slew, trolley, *_, hoist = layout.tower(_PURPOSE)

    def distance(value: Callable[[float], Any], numbers: np.ndarray) -> list[Any]:
        z, goal = np.split(numbers, [2 * layout.n])
        length = z[hoist]
        to_go = goal - z[layout.drives]
        # The slew is the first joint and the first drive of a tower crane, see `Layout.tower`.
        to_go[slew] = to_go[slew] * z[trolley]
        angles = z[layout.passive]
        rates = z[layout.n + layout.passive]
        angles_squared = angles * angles
        amplitude_squared = (angles_squared + rates * rates * (length / value(gravity))).sum()
        load_swing = length * square_root(amplitude_squared)
        return [square_root((to_go * to_go).sum()) + load_swing, angles_squared.sum()]

    return compile_columns(distance, [2 * layout.n, layout.m], 2)
