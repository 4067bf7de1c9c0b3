"""Equations of a small swing under given drives, integrated beside a run of the plant.

There are two models: the equations of the paper, and those with everything that is linear in the
swing. `miss` tells how far a model is from the plant, `dropped` how large the terms are that the
paper leaves out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from inspect import unwrap
from typing import NamedTuple

import numpy as np

from cranedyn import theory
from cranedyn.data.trajectory import Trajectory

# Without the checks of their arguments: these come from runs, and are taken four times a row.
_radial = unwrap(theory.radial_paper)
_tangential = unwrap(theory.tangential_paper)
_small_swing = unwrap(theory.small_swing)


Drives = Mapping[str, float]
"""Motion of the drives at an instant, by the names of `cranedyn.theory.small_swing`.

These are x, x_rate and x_acceleration of the trolley [m, m/s, m/s²]; slew_rate and
slew_acceleration [rad/s, rad/s²]; length and length_rate of the cable [m, m/s].
"""

Model = Callable[[np.ndarray, np.ndarray, Drives, float], np.ndarray]
"""Function that takes the swing (φ, θ) [rad], its rates [rad/s], the motion of the drives and
gravity [m/s²], and returns φ̈ and θ̈ [rad/s²]."""


def paper(swing: np.ndarray, rates: np.ndarray, drives: Drives, gravity: float) -> np.ndarray:
    """Return φ̈ and θ̈ [rad/s²] by Eqs. (8) and (10) of Muddassir et al."""
    length = drives["length"]
    along_jib = drives["x_acceleration"]
    along_arc = drives["x"] * drives["slew_acceleration"]
    phi = _radial(swing[0], length=length, gravity=gravity, excitation=along_jib)
    theta = _tangential(swing[1], length=length, gravity=gravity, excitation=along_arc)
    return np.array([phi, theta])


def all_rates(swing: np.ndarray, rates: np.ndarray, drives: Drives, gravity: float) -> np.ndarray:
    """Return φ̈ and θ̈ [rad/s²] with everything that is linear in the swing."""
    return _small_swing(swing, rates, gravity=gravity, **drives)


def integrate(run: Trajectory, model: Model, gravity: float) -> np.ndarray:
    """Integrate a model along a run, from its start and under the motion of its drives.

    The method is Runge-Kutta of order 4 with a step for each row. Between rows the drives
    accelerate evenly, as in prescribed motion.

    Args:
        run: A run whose rows are equally far apart.
        model: The model.
        gravity: Gravity [m/s²].

    Returns:
        φ, θ [rad] and their rates [rad/s], shape (rows, 4).
    """
    h = float(run.t[1] - run.t[0])
    q = run.coordinates("gamma", "x", "l")
    v = run.rates("gamma", "x", "l")
    a = drive_accelerations(run)

    def rates(y: np.ndarray, k: int, s: float) -> np.ndarray:
        """Return the derivative of φ, θ and their rates, a time s after row k."""
        _, x, length = q[k] + (2.0 * v[k] + a[k] * s) / 2.0 * s
        slew_rate, x_rate, length_rate = v[k] + a[k] * s
        drives = {
            "x": x,
            "x_rate": x_rate,
            "x_acceleration": a[k, 1],
            "slew_rate": slew_rate,
            "slew_acceleration": a[k, 0],
            "length": length,
            "length_rate": length_rate,
        }
        return np.concatenate([y[2:], model(y[:2], y[2:], drives, gravity)])

    swing = [np.hstack([run.coordinates("phi", "theta"), run.rates("phi", "theta")])[0]]
    for k in range(len(a)):
        y = swing[-1]
        k1 = rates(y, k, 0.0)
        k2 = rates(y + h / 2.0 * k1, k, h / 2.0)
        k3 = rates(y + h / 2.0 * k2, k, h / 2.0)
        k4 = rates(y + h * k3, k, h)
        swing.append(y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4))
    return np.array(swing)


def drive_accelerations(run: Trajectory) -> np.ndarray:
    """Return the accelerations of the drives between each row and the next [rad/s², m/s², m/s²],
    shape (rows - 1, 3).
    """
    return np.diff(run.rates("gamma", "x", "l"), axis=0) / np.diff(run.t)[:, None]


class Miss(NamedTuple):
    """Error of a model beside the plant, over the largest swing of the plant.

    Where both angles count together, it is by the root of the sum of their squares.

    Attributes:
        swing: Largest swing of the plant, both angles together [rad].
        phi: Root mean square of the error of φ, over this swing.
        theta: Root mean square of the error of θ, over this swing.
        peak: Largest error of both angles together, over this swing.
    """

    swing: float
    phi: float
    theta: float
    peak: float

    @property
    def rms(self) -> float:
        """Root mean square of the error of both angles together, over the largest swing."""
        return float(np.hypot(self.phi, self.theta))


def miss(run: Trajectory, modelled: np.ndarray) -> Miss:
    """Return the error of a model.

    Args:
        run: The run of the plant.
        modelled: Swing of the model along this run, see `integrate`.
    """
    angles = run.coordinates("phi", "theta")
    swing = float(np.linalg.norm(angles, axis=1).max())
    error = (modelled[:, :2] - angles) / swing
    phi, theta = np.sqrt(np.mean(error**2, axis=0)).tolist()
    return Miss(swing, phi, theta, float(np.linalg.norm(error, axis=1).max()))


def dropped(run: Trajectory) -> tuple[float, dict[str, float]]:
    """Return how large the terms are along a run that the paper's equations leave out.

    Returns:
        The largest excitation that they keep, ẍ or x γ̈ [m/s²]; and the largest value of each term
        that they leave out over this, by its formula.
    """
    # Accelerations are between rows: one less.
    coordinates = run.coordinates("x", "phi", "theta", "l")[:-1]
    rates = run.rates("gamma", "x", "phi", "theta", "l")[:-1]
    x, phi, theta, length = coordinates.T
    slew_rate, x_rate, phi_rate, theta_rate, length_rate = rates.T
    slew, trolley, _ = drive_accelerations(run).T
    terms: Mapping[str, Sequence[np.ndarray]] = {
        "γ̇² (x - lφ)": [slew_rate**2 * (x - length * phi)],
        "2γ̇ (lθ)˙": [2.0 * slew_rate * (length_rate * theta + length * theta_rate)],
        "2γ̇ (ẋ - (lφ)˙)": [2.0 * slew_rate * (x_rate - length_rate * phi - length * phi_rate)],
        "γ̈ lθ, γ̈ lφ": [slew * length * theta, slew * length * phi],
        "γ̇² lθ": [slew_rate**2 * length * theta],
        "2l̇φ̇, 2l̇θ̇": [2.0 * length_rate * phi_rate, 2.0 * length_rate * theta_rate],
    }
    largest = float(max(np.abs(trolley).max(), np.abs(x * slew).max()))
    shares = {}
    for name, components in terms.items():
        shares[name] = float(max(np.abs(term).max() for term in components)) / largest
    return largest, shares
