"""Numbers read off runs between their rows, and the place of the load by hand.

Nothing here uses the code of the plant, which is what the oracles judge.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.optimize import brentq

from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import DataError


def curve(t: np.ndarray, y: np.ndarray, row: int) -> BSpline:
    """Return the polynomial of degree 7 through the eight rows about one.

    Its error is below rounding for swings sampled at 0.1 s.

    Args:
        t: Times of the rows [s].
        y: Values.
        row: The row.
    """
    first = min(max(row - 3, 0), len(t) - 8)
    return make_interp_spline(t[first : first + 8], y[first : first + 8], k=7)


def crossing(t: np.ndarray, y: np.ndarray, count: int) -> float:
    """Return the time at which a signal changes its sign for the n-th time [s].

    Args:
        t: Times of the rows [s].
        y: The signal.
        count: Number n of the change, from 1.

    Raises:
        DataError: If the sign changes less often.
    """
    rows = np.flatnonzero(y[:-1] * y[1:] < 0.0)
    if len(rows) < count:
        raise DataError(
            f"A swing passes the vertical {len(rows)} times in {t[-1]:g} s, where its oracle needs "
            f"{count}."
        )
    i = int(rows[count - 1])
    return zero_between(curve(t, y, i), t[i], t[i + 1])


def zero_between(function: BSpline, low: float, high: float) -> float:
    """Return the time between two times at which a function is zero [s].

    Raises:
        DataError: If it has the same sign at both.
    """
    if function(low) * function(high) > 0.0:
        raise DataError(
            f"A run has nothing to read between {low:g} and {high:g} s, where its oracle needs a "
            "turning point."
        )
    return float(brentq(function, low, high, xtol=1e-15))


def payload_from_pivot(q: np.ndarray) -> np.ndarray:
    """Return the position of the payload [m], shape (rows, 3), from coordinates of shape (rows, 5).

    Heights count from the pivot. The equation is derived by hand, without the code of the plant, in
    docs/concepts/model.md.
    """
    gamma, x, phi, theta, length = q.T
    outward = np.stack([np.sin(gamma), -np.cos(gamma), 0.0 * gamma])
    leftward = np.stack([np.cos(gamma), np.sin(gamma), 0.0 * gamma])
    radius = x - length * np.sin(phi) * np.cos(theta)
    aside = -length * np.sin(theta)
    down = length * np.cos(phi) * np.cos(theta)
    return (radius * outward + aside * leftward - down * np.array([[0.0], [0.0], [1.0]])).T


def offset_from_plumb(q: np.ndarray) -> np.ndarray:
    """Return the position of the payload from the trolley, from which the rope hangs [m], shape
    (rows, 3), from coordinates of shape (rows, 5).
    """
    return payload_from_pivot(q) - payload_from_pivot(q * [1, 1, 0, 0, 0])


def rate_along(position: Callable[[np.ndarray], np.ndarray], trajectory: Trajectory) -> np.ndarray:
    """Return the rate of a function of the coordinates along a run, exact to rounding.

    By a complex step: f(q + i h v) = f(q) + i h f'(q) v up to h², and no difference of two large
    numbers is taken, so that h can be as small as one likes.

    Args:
        position: Function of the coordinates that works with complex numbers.
        trajectory: The run.
    """
    return position(trajectory.q + 1e-30j * trajectory.v).imag / 1e-30
