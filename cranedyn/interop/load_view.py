"""What is observed of a crane and its load in the task for any crane.

The numbers come from one compiled function of the state, written for any kind of number, see
`cranedyn.dynamics.scalars`. Arrays have a column for each crane. A state z is the coordinates and
then their rates.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple, Protocol

import numpy as np

from cranedyn.compiled.binding import ColumnFunction
from cranedyn.compiled.plant.rigid_body import frames, point_motions
from cranedyn.compiled.rows import compile_columns
from cranedyn.dynamics.bodies import Bodies, blank, bodies_of_crane, point_paths
from cranedyn.dynamics.scalars import array, larger, smaller, square_root
from cranedyn.errors import ModelError
from cranedyn.interop.hanging_loads import rest_places
from cranedyn.model.crane import Crane, Point
from cranedyn.model.layout import ALIGNED, Layout

MAX_SWING_RATE = 20.0
"""Bound of swing rates [rad/s]: more than a load on a cable of 10 cm reaches in a fall from 90°."""

_RATE_MARGIN = 1.01
"""Bound of the observed rates of drives, as a share of their limits, which round-off may exceed,
also that of single precision."""

_MIN_PENDULUM = 1e-3
"""Shortest pendulum that counts as a hanging load [m]."""

_DISTANCE = 0
"""Row of the results of `_observation_code` with the distance of each crane to its goal."""

_SWING_SQUARED = 1
"""Row with the sum of the squares of its swings."""

_PENDULUM_LENGTH = 2
"""Row with the length of its pendulum."""

_FIRST_OBSERVATION = 3
"""First of the rows that are observed."""


class DriveRanges(NamedTuple):
    """Where the drives move in the episodes, and how fast, shape (m,) each.

    Attributes:
        lowest: Lower ends of the ranges that all cranes have [rad or m].
        highest: Upper ends.
        drawn_lower: Lower ends of the ranges in which starts and goals are drawn [rad or m].
        drawn_upper: Upper ends.
        reach: Farthest goals from a start [rad or m].
        rates: Largest rates [rad/s or m/s].
    """

    lowest: np.ndarray
    highest: np.ndarray
    drawn_lower: np.ndarray
    drawn_upper: np.ndarray
    reach: np.ndarray
    rates: np.ndarray


class Measured(NamedTuple):
    """What is judged of k cranes.

    Attributes:
        distance: Distance of each crane to its goal, see the view [m], shape (k,).
        swing_squared: Sum of the squares of its swings [rad²], shape (k,).
    """

    distance: np.ndarray
    swing_squared: np.ndarray


class View(Protocol):
    """What is observed of k cranes, and how far they are from their goals.

    Attributes:
        names: Names of the observations in their order.
        swings: Indices of the coordinates that swing at the start of an episode.
    """

    names: tuple[str, ...]
    swings: np.ndarray

    def targets(self, goal: np.ndarray, kinds: np.ndarray) -> np.ndarray:
        """Return the places of the loads at goals of the drives, shape (3, k) [m].

        Args:
            goal: Goals of the drives, shape (m, k).
            kinds: Which crane each column is, shape (k,).
        """

    def pendulum_lengths(self, q: np.ndarray, kinds: np.ndarray) -> np.ndarray:
        """Return the lengths of the pendulums [m], shape (k,), at coordinates, shape (n, k)."""

    def measure(
        self,
        z: np.ndarray,
        goal: np.ndarray,
        target: np.ndarray,
        kinds: np.ndarray,
        observations: np.ndarray,
    ) -> Measured:
        """Return what is judged of cranes, and fill in their observations.

        Args:
            z: Coordinates and rates, shape (2 n, k).
            goal: Goals of the drives, shape (m, k).
            target: Places of the loads at these goals, see `targets`.
            kinds: Which crane each column is, shape (k,).
            observations: Array for the observations, shape (k, names).
        """

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the smallest and the largest possible observations, in single precision, shape
        (names,) each.
        """


class LoadView:
    """View of any crane: where its drives are and how its load swings, scaled to about -1 to 1.

    The observations are, in this order: of each drive the distance to its goal over the reach, its
    position in the range in which goals are drawn, from -1 to 1, and its rate over the rate limit;
    of each swing its angle from rest over the swing limit, and its rate over that of a pendulum
    that swings to this limit. A quantity beyond its bound is observed at the bound.

    The distance to the goal is the amplitude with which the load would swing about the place where
    it shall rest, if it hung from there: √(e² + u² L/g), with its distance e from there, its
    velocity u and the length L of the pendulum. It vanishes only for a load that is there, at rest.
    """

    def __init__(
        self, cranes: Sequence[Crane], ranges: DriveRanges, swing_limit: float, gravity: float
    ) -> None:
        """Compile what is observed.

        Args:
            cranes: The cranes to choose from, of one layout.
            ranges: Ranges and rates of their drives.
            swing_limit: Swing that ends an episode [rad].
            gravity: Gravity in which they stand [m/s²].
        """
        first = cranes[0]
        layout = first.layout
        self._cranes = cranes
        self.swings = tilting_swings(first)
        rows = np.array([_load_geometry(crane).numbers() for crane in cranes])
        varied = np.flatnonzero((rows != rows[0]).any(axis=0))
        # Numbers in which the cranes differ, shape (varied, cranes).
        self._varied_numbers = np.ascontiguousarray(rows[:, varied].T)
        pivot = pivot_joint(first)
        # The rate of the pendulum of the first crane, at its start, that swings to the limit.
        swing_rate = swing_limit * np.sqrt(gravity / pendulum_length(first, pivot))
        # The function itself is cached by `_observation_code` and not kept here, since a compiled
        # function cannot be copied.
        self._observed = _ObservedCranes(
            layout=layout,
            parents=tuple(bodies_of_crane(first).parents),
            payload=first.payload.body,
            pivot=pivot,
            swings=tuple(self.swings.tolist()),
            numbers=tuple(rows[0].tolist()),
            varied=tuple(varied.tolist()),
            gravity=gravity,
            scales=_scales(ranges, len(self.swings), swing_limit, swing_rate),
        )
        drives = [joint.symbol for joint in layout.driven]
        swings = [layout.symbols[i] for i in self.swings.tolist()]
        self.names = (
            *(f"{symbol}_to_go" for symbol in drives),
            *drives,
            *(f"{symbol}_dot" for symbol in drives),
            *swings,
            *(f"{symbol}_dot" for symbol in swings),
        )

    @property
    def scales(self) -> ObservationScales:
        """How the quantities are scaled, for whoever computes observations of measured numbers."""
        return self._observed.scales

    def targets(self, goal: np.ndarray, kinds: np.ndarray) -> np.ndarray:
        """Return the places at which the loads hang at rest with the drives at their goals, see
        `View`.

        Raises:
            ModelError: If a load does not hang at rest there.
        """
        return rest_places(self._cranes, kinds, goal)

    def pendulum_lengths(self, q: np.ndarray, kinds: np.ndarray) -> np.ndarray:
        """Return the distances of the loads from their pivots, see `View`."""
        count = q.shape[1]
        z = np.concatenate([q, np.zeros_like(q)])
        nothing = np.zeros((3, count))
        return self._results(z, q[self._observed.layout.drives], nothing, kinds)[_PENDULUM_LENGTH]

    def measure(
        self,
        z: np.ndarray,
        goal: np.ndarray,
        target: np.ndarray,
        kinds: np.ndarray,
        observations: np.ndarray,
    ) -> Measured:
        """Return what is judged of cranes, and fill in their observations, see `View`."""
        results = self._results(z, goal, target, kinds)
        observations[:] = results[_FIRST_OBSERVATION:].T
        return Measured(results[_DISTANCE], results[_SWING_SQUARED])

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the smallest and the largest possible observations, see `View`."""
        bound = np.array(self._observed.scales.bound, dtype=np.float32)
        return -bound, bound

    def _results(
        self, z: np.ndarray, goal: np.ndarray, target: np.ndarray, kinds: np.ndarray
    ) -> np.ndarray:
        """Return the results of `_observation_code`."""
        arguments = [z, goal, target]
        if self._observed.varied:
            arguments.append(self._varied_numbers[:, kinds])
        return _observation_code(self._observed)(*arguments)


def tilting_swings(crane: Crane) -> np.ndarray:
    """Return the indices of the swings that tilt the rope or a sling: all but those about the
    vertical, about which a hook merely turns.
    """
    joints = crane.layout.joints
    tilting = [i for i in crane.swings.tolist() if abs(joints[i].axis[2]) < ALIGNED]
    return np.array(tilting, dtype=int)


def pivot_joint(crane: Crane) -> int:
    """Return the index of the joint about which the load swings: the first that tilts the rope, on
    the way from the ground to the payload.

    Raises:
        ModelError: If the load hangs on no such joint, or no drive moves it.
    """
    path = bodies_of_crane(crane).path(crane.payload.body)
    joints = crane.layout.joints
    payload = joints[crane.payload.body].name
    swings = [i for i in path if i in tilting_swings(crane)]
    if not swings or not crane.rest.hangs:
        raise ModelError(
            "The task of moving a load needs one that hangs: a passive revolute joint without a "
            f"spring, about a horizontal axis, from which {payload} hangs at rest. "
            "load_crane(swing=True) puts such joints above a hook that a file makes rigid."
        )
    if not any(joints[i].driven for i in path):
        raise ModelError(
            "The task of moving a load needs a driven joint that moves it; between the ground and "
            f"{payload} all joints of this crane are passive."
        )
    if pendulum_length(crane, swings[0]) < _MIN_PENDULUM:
        raise ModelError(
            f"The task of moving a load needs one below the joint about which it swings; {payload} "
            f"is at the axis of {joints[swings[0]].name} itself."
        )
    return swings[0]


def pendulum_length(crane: Crane, pivot: int) -> float:
    """Return the distance of the load from the joint about which it swings, at rest [m]."""
    points = [crane.payload, Point("pivot", pivot, np.zeros(3))]
    ((payload, hinge),) = point_paths(crane, crane.rest.q[None], points)
    return float(np.linalg.norm(payload - hinge))


# --- the compiled function ------------------------------------------------------------------------


@dataclass(frozen=True)
class ObservationScales:
    """How the quantities of an observation are scaled to about -1 to 1.

    Attributes:
        reach: Distance of a drive to its goal that counts as 1 [rad or m], m numbers.
        middle: Position of a drive that counts as 0 [rad or m], m numbers.
        half_range: Distance from there that counts as 1 [rad or m], m numbers.
        rate: Rate of a drive that counts as 1 [rad/s or m/s], m numbers.
        swing: Swing that counts as 1 [rad].
        swing_rate: Rate of a swing that counts as 1 [rad/s].
        bound: Bound of each element of an observation, the same up and down.
    """

    reach: tuple[float, ...]
    middle: tuple[float, ...]
    half_range: tuple[float, ...]
    rate: tuple[float, ...]
    swing: float
    swing_rate: float
    bound: tuple[float, ...]


def _scales(
    ranges: DriveRanges, swings: int, swing_limit: float, swing_rate: float
) -> ObservationScales:
    """Return the scales of observations of so many swings.

    Args:
        ranges: Ranges and rates of the drives.
        swings: Number of swings that are observed.
        swing_limit: Swing that counts as 1 [rad].
        swing_rate: Rate of a swing that counts as 1 [rad/s].
    """
    middle = 0.5 * (ranges.drawn_upper + ranges.drawn_lower)
    half_range = 0.5 * (ranges.drawn_upper - ranges.drawn_lower)
    # A drive whose goals are all at its start has a reach of zero, and nothing to scale.
    reach = np.where(ranges.reach > 0.0, ranges.reach, 1.0)
    farthest = np.maximum(ranges.highest - middle, middle - ranges.lowest)
    bound = np.concatenate(
        [
            (ranges.highest - ranges.lowest) / reach,
            farthest / half_range,
            np.full(len(middle), _RATE_MARGIN),
            np.full(swings, np.pi / swing_limit),
            np.full(swings, MAX_SWING_RATE / swing_rate),
        ]
    )
    return ObservationScales(
        reach=tuple(reach.tolist()),
        middle=tuple(middle.tolist()),
        half_range=tuple(half_range.tolist()),
        rate=tuple(ranges.rates.tolist()),
        swing=swing_limit,
        swing_rate=float(swing_rate),
        # Rounded to single precision, so that no observation rounds to beyond its bound.
        bound=tuple(bound.astype(np.float32).tolist()),
    )


@dataclass(frozen=True, eq=False)
class _LoadGeometry:
    """Numbers of a crane that say where its load is and how it hangs.

    Attributes:
        tree: The bodies without their masses.
        lever: Centre of mass of the payload in the frame of its joint [m], shape (3,).
        rest_angle: Angles of the observed swings at rest, with `rest_slope`, see
            `cranedyn.model.springs.Rest` [rad], shape (swings,).
        rest_slope: Their derivatives by the coordinates of the drives [rad per rad or m], shape
            (swings, m).
    """

    tree: Bodies
    lever: np.ndarray
    rest_angle: np.ndarray
    rest_slope: np.ndarray

    def numbers(self) -> np.ndarray:
        """Return all numbers in a row, attribute by attribute."""
        parts = [self.tree.numbers(), self.lever, self.rest_angle, self.rest_slope.ravel()]
        return np.concatenate(parts).astype(float)

    def with_numbers(self, numbers: Sequence[Any]) -> _LoadGeometry:
        """Return the same crane with other numbers or symbols, in the order of `numbers`."""
        sizes = [len(self.tree.numbers()), len(self.lever), len(self.rest_angle)]
        tree, lever, angle, slope = np.split(array(list(numbers)), np.cumsum(sizes))
        return _LoadGeometry(
            self.tree.with_numbers(tree), lever, angle, slope.reshape(self.rest_slope.shape)
        )


def _load_geometry(crane: Crane) -> _LoadGeometry:
    """Return the numbers of a crane that say where its load is and how it hangs."""
    tree = bodies_of_crane(crane)
    # Cranes that differ in their masses alone shall not differ in these numbers.
    massless = replace(
        blank(tree.parents), rotation=tree.rotation, translation=tree.translation, axis=tree.axis
    )
    tilting = np.isin(crane.swings, tilting_swings(crane))
    return _LoadGeometry(
        massless, crane.payload.lever, crane.rest.angle[tilting], crane.rest.slope[tilting]
    )


@dataclass(frozen=True)
class _ObservedCranes:
    """What a function is compiled for: cranes of one layout.

    Attributes:
        layout: Layout of all cranes.
        parents: The joint before each joint, -1 for the world.
        payload: Index of the joint that carries the payload.
        pivot: Index of the joint about which the load swings.
        swings: Indices of the swings that are observed.
        numbers: Numbers of the first crane, see `_LoadGeometry.numbers`.
        varied: Which of these differ between the cranes, by their indices.
        gravity: Gravity in which all cranes stand [m/s²].
        scales: Scales of the observations.
    """

    layout: Layout
    parents: tuple[int, ...]
    payload: int
    pivot: int
    swings: tuple[int, ...]
    numbers: tuple[float, ...]
    varied: tuple[int, ...]
    gravity: float
    scales: ObservationScales


@cache
def _observation_code(cranes: _ObservedCranes) -> ColumnFunction:
    """Return the compiled function from states to what is observed, see `LoadView`.

    Its arguments are states z, goals of the drives, shape (m, k), places of the loads at these
    goals, shape (3, k), and the numbers in which the cranes differ, shape (varied, k). The last is
    left out where they differ in none.

    Its results, a row each, are the distance to the goal [m], the sum of the squares of the swings
    [rad²], the length of the pendulum [m], and the observations.
    """
    layout = cranes.layout
    scales = cranes.scales
    swings = np.array(cranes.swings, dtype=int)
    slots = _LoadGeometry(
        blank(cranes.parents),
        lever=np.zeros(3),
        rest_angle=np.zeros(len(swings)),
        rest_slope=np.zeros((len(swings), layout.m)),
    )
    origin = array([0.0, 0.0, 0.0])

    def results(value: Callable[[float], Any], inputs: np.ndarray) -> list[Any]:
        ends = np.cumsum([2 * layout.n, layout.m, 3])
        z, goal, target, differing = np.split(inputs, ends)
        numbers: list[Any] = list(cranes.numbers)
        for index, number in zip(cranes.varied, differing, strict=True):
            numbers[index] = number
        load = slots.with_numbers(numbers)
        q = z[: layout.n]
        v = z[layout.n :]
        poses = frames(load.tree, q)
        ((position, velocity),) = point_motions(load.tree, poses, v, cranes.payload, [load.lever])
        ((pivot, _),) = point_motions(load.tree, poses, v, cranes.pivot, [origin])

        # A pendulum of length L swings with the frequency √(g/L): from the displacement e and the
        # velocity u it reaches the amplitude √(e² + u² L/g).
        rope = position - pivot
        length = square_root(rope @ rope)
        error = position - target
        squared_speed = velocity @ velocity
        distance = square_root(error @ error + squared_speed * length / value(cranes.gravity))

        drives = q[layout.drives]
        angles = q[swings] - (load.rest_angle + load.rest_slope @ drives)
        observed = np.concatenate(
            [
                (goal - drives) / array(scales.reach),
                (drives - array(scales.middle)) / array(scales.half_range),
                v[layout.drives] / array(scales.rate),
                angles / scales.swing,
                v[swings] / scales.swing_rate,
            ]
        )
        # Written so that what is not a number becomes the lower bound: one observation that is not
        # a number would make all weights of a network so.
        bounded = []
        for number, bound in zip(observed, scales.bound, strict=True):
            bounded.append(smaller(larger(number, -bound), bound))
        return [distance, angles @ angles, length, *bounded]

    widths = [2 * layout.n, layout.m, 3]
    if cranes.varied:
        widths.append(len(cranes.varied))
    return compile_columns(results, widths, _FIRST_OBSERVATION + len(scales.bound))
