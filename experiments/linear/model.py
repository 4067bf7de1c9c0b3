"""Equations of a small swing under given drives, integrated beside a run of the plant, and what the
paper's leave out.
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
"""Motion of the drives at an instant by the names of `cranedyn.theory.small_swing`: x, x_rate,
x_acceleration of the trolley [m, s], slew_rate, slew_acceleration [rad, s], length, length_rate of
the cable [m, s]."""

Model = Callable[[np.ndarray, np.ndarray, Drives, float], np.ndarray]
"""From swing, its rates, drives and gravity [m/s²] to φ̈, θ̈."""


def paper(swing: np.ndarray, rates: np.ndarray, drives: Drives, gravity: float) -> np.ndarray:
    """Return Eqs. (8) and (10) of Muddassir et al."""
    pendulum = {"length": drives["length"], "gravity": gravity}
    phi = _radial(swing[0], **pendulum, excitation=drives["x_acceleration"])
    along_arc = drives["x"] * drives["slew_acceleration"]
    return np.array([phi, _tangential(swing[1], **pendulum, excitation=along_arc)])


def all_rates(swing: np.ndarray, rates: np.ndarray, drives: Drives, gravity: float) -> np.ndarray:
    """Return the same with everything that is linear in the swing."""
    return _small_swing(swing, rates, gravity=gravity, **drives)


def integrate(run: Trajectory, model: Model, gravity: float) -> np.ndarray:
    """Integrate φ, θ and their rates of a model along a run, from its start and under the motion of
    its drives, shape (n, 4).

    Runge-Kutta of order 4, one step for each row; between rows the drives accelerate evenly, as in
    prescribed motion.
    """
    names = "gamma", "x", "l"
    h = float(run.t[1] - run.t[0])
    q = run.coordinates(*names)
    v = run.rates(*names)
    a = drive_accelerations(run)

    def rates(y: np.ndarray, k: int, s: float) -> np.ndarray:
        _, x, length = q[k] + (2.0 * v[k] + a[k] * s) / 2.0 * s
        drives = {"x": x, "length": length, "slew_acceleration": a[k, 0], "x_acceleration": a[k, 1]}
        speeds = zip(("slew_rate", "x_rate", "length_rate"), v[k] + a[k] * s, strict=True)
        drives.update(speeds)
        return np.concatenate([y[2:], model(y[:2], y[2:], drives, gravity)])

    swing = [np.hstack([run.coordinates("phi", "theta"), run.rates("phi", "theta")])[0]]
    for k in range(len(a)):
        y = swing[-1]
        k1 = rates(y, k, 0.0)
        k2 = rates(y + h / 2.0 * k1, k, h / 2.0)
        k3 = rates(y + h / 2.0 * k2, k, h / 2.0)
        swing.append(y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rates(y + h * k3, k, h)))
    return np.array(swing)


def drive_accelerations(run: Trajectory) -> np.ndarray:
    """Return the accelerations of the drives between each row and the next [rad/s², m/s², m/s²],
    shape (n - 1, 3).
    """
    return np.diff(run.rates("gamma", "x", "l"), axis=0) / np.diff(run.t)[:, None]


class Miss(NamedTuple):
    """How far a model is from the plant, as a share of the largest swing of the plant, both angles
    together.

    Attributes:
        swing: That largest swing [rad].
        phi, theta: Root mean square of each angle's error.
        peak: Largest error, both angles together.
    """

    swing: float
    phi: float
    theta: float
    peak: float

    @property
    def rms(self) -> float:
        """Root mean square of the error, both angles together."""
        return float(np.hypot(self.phi, self.theta))


def miss(run: Trajectory, modelled: np.ndarray) -> Miss:
    """Compare what `integrate` made of a model with the run that it follows."""
    angles = run.coordinates("phi", "theta")
    swing = float(np.linalg.norm(angles, axis=1).max())
    error = (modelled[:, :2] - angles) / swing
    phi, theta = np.sqrt(np.mean(error**2, axis=0)).tolist()
    return Miss(swing, phi, theta, float(np.linalg.norm(error, axis=1).max()))


def dropped(run: Trajectory) -> tuple[float, dict[str, float]]:
    """Return what the paper's equations keep of the drives, and what they drop, at their largest
    along a run.

    Returns:
        The larger of ẍ and x γ̈ [m/s²]; each dropped term by its formula, as a share of that.
    """
    x, phi, theta, length = run.coordinates("x", "phi", "theta", "l")[:-1].T
    slew_rate, x_rate, phi_rate, theta_rate, length_rate = run.rates(
        "gamma", "x", "phi", "theta", "l"
    )[:-1].T
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
    return largest, {
        name: float(max(np.abs(term).max() for term in components)) / largest
        for name, components in terms.items()
    }
