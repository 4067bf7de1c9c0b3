"""The linear crane about a rest or a motion: what a small motion does, step by step, under a held command and in a closed loop.

Deviations are stacked as z = (coordinates, rates), shape (2 n,).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cranedyn.arguments import checked
from cranedyn.arrays import finite
from cranedyn.clocks import clocks
from cranedyn.dynamics.pinocchio import holding_effort, linearise
from cranedyn.errors import Misshapen, OutOfRange, whole, within
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane


@dataclass(frozen=True, eq=False)
class Sampled:
    """z after one control period = a z + b u, with the drive efforts u held.

    Attributes:
        a: Shape (2 n, 2 n).
        b: Shape (2 n, m).
        period: The control period [s].
    """

    a: np.ndarray
    b: np.ndarray
    period: float

    @checked
    def closed(self, gain: np.ndarray) -> np.ndarray:
        """The loop closed with u = -gain z; gain has shape (m, 2 n), the answer (2 n, 2 n).

        Raises:
            OutOfRange: If the gain is not m by 2 n finite numbers.
        """
        return self.a - self.b @ finite("gain", gain, self.b.T.shape)


@checked
def sampled(crane: Crane, state: State, effort: np.ndarray | None = None, *, dt: float = 5e-4, control_period: float = 5e-3) -> Sampled:
    """Linearise a crane about a state and step it exactly as `simulate` does: semi-implicit Euler under a held effort.

    Args:
        crane: The crane.
        state: Where it hangs at rest, or passes by in a motion.
        effort: What the drives exert there, shape (m,); None for what balances gravity.
        dt: Physics step [s].
        control_period: Time over which efforts are held [s], a multiple of `dt`.

    Raises:
        OutOfRange: If a time is out of range or the period not a multiple of `dt`, or the effort not one finite number for each drive.
    """
    n, m = crane.layout.n, crane.layout.m
    steps = clocks(control_period, dt, control_period).steps
    exerted = holding_effort(crane, state.q) if effort is None else finite("effort", effort, (m,))
    by_state, by_effort = linearise(crane, state, exerted)
    step_v = np.hstack([np.zeros((n, n)), np.eye(n)]) + dt * by_state
    step = np.vstack([np.eye(n, 2 * n) + dt * step_v, step_v])
    input_matrix = np.vstack([dt * dt * by_effort, dt * by_effort])
    over_period = np.linalg.matrix_power(np.block([[step, input_matrix], [np.zeros((m, 2 * n)), np.eye(m)]]), steps)
    a, b = over_period[: 2 * n, : 2 * n], over_period[: 2 * n, 2 * n :]
    return Sampled(a, b, control_period)


@checked
def feedback_gain(crane: Crane, stiffness: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """Gain of proportional-derivative control of each drive by itself, shape (m, 2 n), from its k_p and k_d, shape (m,) each."""
    layout = crane.layout
    gain = np.zeros((layout.m, 2 * layout.n))
    gain[range(layout.m), layout.drives] = finite("stiffness", stiffness, (layout.m,))
    gain[range(layout.m), layout.n + layout.drives] = finite("damping", damping, (layout.m,))
    return gain


@dataclass(frozen=True, eq=False)
class Mode:
    """A swing of the linear loop: z(t) = Re(c shape exp(rate t)).

    Attributes:
        rate: Complex growth rate [1/s]; its imaginary part is the frequency [rad/s].
        shape: Complex deviations, shape (2 n,), one at the coordinate asked for.
        weights: How much of the mode a state z holds is weights @ z, shape (2 n,).
    """

    rate: complex
    shape: np.ndarray
    weights: np.ndarray

    @property
    def period(self) -> float:
        """Time of one swing [s]."""
        return float(2.0 * np.pi / self.rate.imag)

    @property
    def damping_ratio(self) -> float:
        """Fraction of critical damping."""
        return float(-self.rate.real / abs(self.rate))


@checked
def swing_mode(loop: np.ndarray, period: float, coordinate: int) -> Mode:
    """The oscillation of a sampled closed loop, shape (2 n, 2 n), in which a coordinate, by its place, has the largest share.

    Raises:
        OutOfRange: If the loop has another shape, the period is out of range, or the coordinate does not oscillate.
    """
    loop = finite("loop", loop, ("2 n", "2 n"))
    n = len(loop) // 2
    if loop.shape != (2 * n, 2 * n) or not n:
        raise Misshapen("loop", f"an array of shape {loop.shape}", "one of shape (2 n, 2 n)")
    if whole("coordinate", coordinate, 0) > n - 1:
        raise OutOfRange("coordinate", coordinate, f"0 to {n - 1}")
    values, vectors = np.linalg.eig(loop)
    rates = np.log(values.astype(complex)) / within("period", period, 1e-9, 1e13, "s")
    share = np.abs(vectors[coordinate]) / np.linalg.norm(vectors[:n], axis=0)
    shares = np.where(rates.imag > 1e-3, share, 0.0)
    i = int(np.argmax(shares))
    if not shares[i] > 0.0:
        raise OutOfRange("loop", "one in which this coordinate does not oscillate", "one in which it does")
    scale = vectors[coordinate, i]
    return Mode(complex(rates[i]), vectors[:, i] / scale, np.linalg.inv(vectors)[i] * scale)
