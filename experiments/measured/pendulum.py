"""Pendulum under a moving trolley, independent of the plant, and records as a logger writes them.

With the angle φ from plumb, the length l and the acceleration of the trolley a, see
`simulate_swing`,

    φ̈ = (a cos φ - g sin φ) / l - (c + k |φ̇|) φ̇ - f sign(φ̇) - r sign(φ)

with viscous damping c, drag k, dry friction f and a centring acceleration r. Here, a positive
acceleration of the trolley drives the swing to positive angles.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import CubicSpline

from cranedyn.model.crane import STANDARD_GRAVITY

STEP = 0.01
"""Integration step [s]."""

CENTRING_WIDTH = 1e-3
"""Swing within which the centring acceleration changes its sign [rad].

The sign is a tanh, so that integrator and fit have a smooth function.
"""

FRICTION_WIDTH = 2e-3
"""Rate of the swing within which dry friction changes its sign [rad/s], likewise."""


def simulate_swing(
    acceleration: np.ndarray,
    length: np.ndarray,
    start: np.ndarray,
    damping: np.ndarray,
    drag: np.ndarray,
    friction: np.ndarray,
    centring: np.ndarray,
) -> np.ndarray:
    """Return the swing of pendulums by RK4 [rad], shape (steps + 1, lanes).

    Args:
        acceleration: Acceleration of the trolley each half step [m/s²], shape (2 steps + 1, lanes).
        length: Lengths [m], shape (lanes,).
        start: First swing [rad] and its rate [rad/s], shape (2, lanes).
        damping: Deceleration per rate [1/s], shape (lanes,).
        drag: Deceleration per squared rate [1/rad], shape (lanes,).
        friction: Deceleration by dry friction [rad/s²], shape (lanes,).
        centring: Acceleration towards the rest position, the same at each swing [rad/s²], shape
            (lanes,).
    """

    def rate(y: np.ndarray, pull: np.ndarray) -> np.ndarray:
        """Return rate and acceleration of the swing, shape (2, lanes)."""
        phi, omega = y
        driving = (pull * np.cos(phi) - STANDARD_GRAVITY * np.sin(phi)) / length
        losses = (damping + drag * np.abs(omega)) * omega
        losses += friction * np.tanh(omega / FRICTION_WIDTH)
        return np.stack([omega, driving - losses - centring * np.tanh(phi / CENTRING_WIDTH)])

    # Each step of the classical Runge-Kutta method takes the acceleration at its two ends and in
    # its middle.
    steps = len(acceleration) // 2
    phi = np.empty((steps + 1, len(length)))
    y = np.array(start, dtype=float)
    for k in range(steps):
        phi[k] = y[0]
        first, middle, last = acceleration[2 * k : 2 * k + 3]
        k1 = rate(y, first)
        k2 = rate(y + 0.5 * STEP * k1, middle)
        k3 = rate(y + 0.5 * STEP * k2, middle)
        k4 = rate(y + STEP * k3, last)
        y = y + STEP / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    phi[steps] = y[0]
    return phi


def reported(t: np.ndarray, phi: np.ndarray, delay: float, window: float) -> np.ndarray:
    """Return a swing as its sensor reports it: late, and averaged over a window [rad].

    Args:
        t: Times of the reports [s], shape (rows,).
        phi: Swing each `STEP` from time zero on [rad], shape (steps + 1,); before, it is the first.
        delay: Time by which reports are late [s].
        window: Time before that over which they are averaged [s]; 0 for none.
    """
    curve = CubicSpline(STEP * np.arange(len(phi)), phi)
    late = np.clip(t - delay, 0.0, STEP * (len(phi) - 1))
    if window <= 0.0:
        return np.asarray(curve(late))
    begin = late - window
    integral = curve.antiderivative()
    # The part of a window before time zero, where the swing is the first one; it is negative.
    before = phi.item(0) * np.minimum(begin, 0.0)
    return np.asarray((integral(late) - integral(np.maximum(begin, 0.0)) - before) / window)


def logged(
    seed: int,
    sign: int = 1,
    *,
    travel: float = 1.2,
    lasts: float = 3.5,
    length: float = 0.343,
    cable: float = 0.381,
    damping: float = 0.0618,
    bias: float = 0.002,
    delay: float = 0.17,
    window: float = 0.0,
) -> dict[str, np.ndarray]:
    """Return a record of 21 s as a logger writes it that polls its sensors: a trolley that moves
    once, positions in steps of 0.05 mm every 30 ms, swings in steps of 1 mrad every 33 ms.

    Args:
        seed: Seed of the jitter of the clock.
        sign: Sign of the swing.
        travel: Distance that the trolley moves [m].
        lasts: Duration of this move [s].
        length: Length of the pendulum [m].
        cable: Length of the cable as recorded [m].
        damping: Deceleration of the swing per rate [1/s].
        bias: Bias of the swing sensor [rad].
        delay: Delay of the swing sensor [s].
        window: Time over which it averages [s].
    """
    rng = np.random.default_rng(seed)
    one_lane = np.ones(1)
    half = 0.5 * STEP * np.arange(4301)
    motion = CubicSpline(half, trolley(half, travel, lasts))
    phi = simulate_swing(
        motion(half, 2)[:, None],
        length * one_lane,
        np.zeros((2, 1)),
        damping=damping * one_lane,
        drag=0.0 * one_lane,
        friction=0.0 * one_lane,
        centring=0.0 * one_lane,
    ).ravel()
    # The logger polls as often as it can: mostly every 7 or 12.5 ms, and at times twice at once.
    t = np.cumsum(rng.choice([1e-4, 0.007, 0.0125], size=3200, p=[0.25, 0.45, 0.3]))
    t = t[t < 21.0]
    columns = {"t_s": t, "l_m": np.full(len(t), cable)}
    # Time between two readings [s], step of the reading, and what is read, by column.
    sensors: dict[str, tuple[float, float, Callable[[np.ndarray], np.ndarray]]] = {
        "x_m": (0.030, 5e-5, lambda s: trolley(s, travel, lasts)),
        "phi_rad": (0.033, 1e-3, lambda s: sign * (reported(s, phi, delay, window) + bias)),
    }
    for name, (interval, quantum, sensor) in sensors.items():
        last_reading = np.floor(t / interval) * interval
        columns[name] = np.round(sensor(last_reading) / quantum) * quantum
    return columns


def trolley(t: np.ndarray, travel: float = 1.2, lasts: float = 3.5) -> np.ndarray:
    """Return the position of a trolley that moves once, by a quintic spline from rest to rest [m].

    Args:
        t: Times [s].
        travel: Distance that it moves [m].
        lasts: Time for the move [s]; it begins at 0.5 s.
    """
    s = np.clip((np.asarray(t) - 0.5) / lasts, 0.0, 1.0)
    return np.asarray(travel * s**3 * (10.0 - 15.0 * s + 6.0 * s**2))
