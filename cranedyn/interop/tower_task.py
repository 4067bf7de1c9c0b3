"""The task of `cranedyn.interop.task` for a tower crane of five joints, with its own observations.

They are in SI units and hold the trolley radius and the cable length, and the distance to the goal
is that of the drives. Results that were published with ``cranedyn/TowerCrane-v0`` rest on them.

The coordinates are slew, trolley, radial swing, tangential swing and hoist, of which the swings are
the passive joints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from cranedyn.compiled.binding import ColumnFunction
from cranedyn.compiled.rows import compile_columns
from cranedyn.dynamics.scalars import square_root
from cranedyn.interop.load_view import MAX_SWING_RATE, Measured, View
from cranedyn.interop.task import SwingTask
from cranedyn.model.crane import Crane
from cranedyn.model.layout import Layout
from cranedyn.model.load import load_crane
from cranedyn.references.limits import LARGE_CRANE, Limits

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

REACH = (0.6, 10.0, 5.0)
"""Farthest goal from the start of slew [rad], trolley [m] and hoist [m] where the rules state
none."""

_RANGE_MARGIN = 0.05
"""Distance that drives keep from the ends of their ranges [rad or m], against round-off."""

_PURPOSE = "The environment TowerCrane-v0 (Crane-v0 takes any crane)"
"""Beginning of the error message for a crane that is no tower crane."""


class TowerSwingTask(SwingTask):
    """Many tower cranes, each with its goal, see `SwingTask`."""

    @staticmethod
    def default_crane() -> Crane:
        """Return the crane where none is given: the tower crane of this project."""
        return load_crane()

    def _check_crane(self, crane: Crane, dt: float) -> None:
        """Check that a crane is a tower crane of five joints.

        Raises:
            MissingRole, ModelError: If it is not.
        """
        crane.layout.tower(_PURPOSE)

    def _default_limits(self, crane: Crane) -> Limits:
        """Return the limits of a large tower crane."""
        return LARGE_CRANE

    def _default_reach(self) -> Sequence[float]:
        """Return the farthest goals of slew [rad], trolley [m] and hoist [m]."""
        return REACH

    def _range_margins(self, widths: np.ndarray) -> np.ndarray:
        """Return how far drives keep from the ends of their ranges [rad or m], shape (3,)."""
        return np.full(len(widths), _RANGE_MARGIN)

    def _working_range(self) -> np.ndarray:
        """Return that drives are drawn anywhere in their ranges, shape (3,)."""
        return np.full(self.layout.m, np.inf)

    def _rest_coordinates(self, drives: np.ndarray, kinds: np.ndarray) -> np.ndarray:
        """Return the coordinates with both swings at zero, shape (5, k)."""
        q = np.zeros((self.layout.n, drives.shape[1]))
        q[self.layout.drives] = drives
        return q

    def _make_view(self) -> View:
        """Return what is observed of the cranes."""
        return TowerView(self.fleet.cranes[0], self._rates, self._gravity)


class TowerView:
    """View of a tower crane, see `OBSERVED`.

    The distance to the goal is that of the drives, plus the amplitude with which the load would
    swing if the drives stopped at once.
    """

    names: tuple[str, ...] = OBSERVED

    def __init__(self, crane: Crane, rates: np.ndarray, gravity: float) -> None:
        """Set what is observed.

        Args:
            crane: The first crane.
            rates: Largest rates of the drives [rad/s or m/s], shape (3,).
            gravity: Gravity in which all cranes stand [m/s²].
        """
        layout = crane.layout
        self._crane = crane
        self._rates = rates
        self._gravity = gravity
        self.swings = layout.passive
        _, self._trolley, *_, self._hoist = layout.tower(_PURPOSE)
        # Rows of (coordinates, rates) that are observed, after the three distances to go.
        self._observed_rows = np.concatenate(
            [
                layout.n + layout.drives,
                layout.passive,
                layout.n + layout.passive,
                [self._trolley, self._hoist],
            ]
        ).tolist()

    def targets(self, goal: np.ndarray, kinds: np.ndarray) -> np.ndarray:
        """Return zeros, shape (3, k): distances are those of the drives."""
        return np.zeros((3, goal.shape[1]))

    def pendulum_lengths(self, q: np.ndarray, kinds: np.ndarray) -> np.ndarray:
        """Return the cable lengths [m], shape (k,)."""
        return q[self._hoist]

    def measure(
        self,
        z: np.ndarray,
        goal: np.ndarray,
        target: np.ndarray,
        kinds: np.ndarray,
        observations: np.ndarray,
    ) -> Measured:
        """Return what is judged of cranes, and fill in their observations, see
        `cranedyn.interop.load_view.View`.
        """
        observations[:, :3] = (goal - z[self._crane.layout.drives]).T
        # Row by row, not by an index array, which would copy all of them first.
        for i, row in enumerate(self._observed_rows, 3):
            observations[:, i] = z[row]
        distance, swing_squared = _distance_code(self._crane.layout, self._gravity)(z, goal)
        return Measured(distance, swing_squared)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the smallest and the largest possible observations, in single precision, shape
        (12,) each.

        Swings are bounded by 180° and not by the limit of the rules, since the last observation of
        an episode may be beyond that.
        """
        crane = self._crane
        radius_and_length = [self._trolley, self._hoist]
        distances = (crane.upper - crane.lower)[crane.layout.drives]
        # Rates may exceed their limits by round-off, also that of single precision.
        rates = 1.01 * self._rates
        swings = np.full(2, np.pi)
        swing_rates = np.full(2, MAX_SWING_RATE)
        symmetric = np.concatenate([distances, rates, swings, swing_rates])
        low = np.concatenate([-symmetric, crane.lower[radius_and_length]])
        high = np.concatenate([symmetric, crane.upper[radius_and_length]])
        return low.astype(np.float32), high.astype(np.float32)


@cache
def _distance_code(layout: Layout, gravity: float) -> ColumnFunction:
    """Return the compiled function from states and goals to the distances of `TowerView` [m] and
    the squares of the swings [rad²].

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
