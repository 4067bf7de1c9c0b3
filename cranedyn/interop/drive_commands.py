"""Actions of the task as commands of the drives, which stop before the ends of their ranges.

The functions are written for any kind of number, see `cranedyn.dynamics.scalars`, and compiled for
arrays with a column for each crane. A state z is the coordinates and then their rates.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from cranedyn.compiled.binding import ColumnFunction
from cranedyn.compiled.rows import compile_columns
from cranedyn.dynamics.scalars import larger, smaller, square_root
from cranedyn.model.layout import Layout


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


@cache
def acceleration_code(
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
def rate_code(
    layout: Layout, reaction_times: tuple[float, ...], limits: tuple[DriveLimits, ...]
) -> ColumnFunction:
    """Return the function from actions and states to the rates that frequency converters are
    commanded, compiled.

    Args:
        layout: Layout of the crane.
        reaction_times: Time from a state to the full braking that it makes necessary, of each
            drive [s].
        limits: Limits of each drive.
    """

    def rates(value: Callable[[float], Any], numbers: np.ndarray) -> Iterator[Any]:
        action, z = np.split(numbers, [layout.m])
        positions = z[layout.drives]
        for i, limit in enumerate(limits):
            wanted = action[i] * limit.rate
            up = _stoppable_rate(limit.upper - positions[i], reaction_times[i], limit)
            down = _stoppable_rate(positions[i] - limit.lower, reaction_times[i], limit)
            yield smaller(larger(wanted, -down), up)

    return compile_columns(rates, [layout.m, 2 * layout.n], layout.m)


def _stoppable_rate(distance: Any, reaction_time: float, limit: DriveLimits) -> Any:
    """Return the largest rate w from which a drive stops within a distance d.

    It goes on for the reaction time τ and then brakes with the acceleration a: w τ + w²/(2 a) <= d,
    so that w = √((a τ)² + 2 a d) - a τ.
    """
    lead = limit.acceleration * reaction_time
    radicand = lead * lead + 2.0 * limit.acceleration * larger(distance, 0.0)
    return smaller(square_root(radicand) - lead, limit.rate)
