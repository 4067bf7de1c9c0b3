"""The linear crane about a rest or a motion: what a small motion does, step by step, under a held command and in a closed loop.

Deviations are stacked as z = (coordinates, rates), shape (10,).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cranedyn.arguments import checked
from cranedyn.arrays import finite
from cranedyn.dynamics.pinocchio import holding_effort, linearise
from cranedyn.errors import OutOfRange, whole, within
from cranedyn.interfaces import Drive, State
from cranedyn.model.crane import DRIVES, Crane
from cranedyn.simulation.clocks import clocks


@dataclass(frozen=True, eq=False)
class Sampled:
    """z after one control period = a z + b u, with the drive efforts u held.

    Attributes:
        a: Shape (10, 10).
        b: Shape (10, 3).
        period: The control period [s].
    """

    a: np.ndarray
    b: np.ndarray
    period: float

    @checked
    def closed(self, gain: np.ndarray) -> np.ndarray:
        """The loop closed with u = -gain z; gain has shape (3, 10), the answer (10, 10).

        Raises:
            OutOfRange: If the gain is not 3 by 10 finite numbers.
        """
        return self.a - self.b @ finite("gain", gain, (3, 10))


@dataclass(frozen=True, eq=False)
class Linear:
    """dz/dt = a z + b u.

    Attributes:
        a: Shape (10, 10).
        b: Shape (10, 3).
    """

    a: np.ndarray
    b: np.ndarray

    @checked
    def sampled(self, *, dt: float = 5e-4, control_period: float = 5e-3) -> Sampled:
        """Step it exactly as `simulate` does: semi-implicit Euler in steps of `dt` [s] under a command held for a control period [s].

        Raises:
            OutOfRange: If a time is out of range, or the period is not a multiple of `dt`.
        """
        steps = clocks(control_period, dt, control_period).steps
        nz, m = self.b.shape
        n = nz // 2
        step_v = np.hstack([np.zeros((n, n)), np.eye(n)]) + dt * self.a[n:]
        step = np.vstack([np.eye(n, nz) + dt * step_v, step_v])
        input_matrix = np.vstack([dt * dt * self.b[n:], dt * self.b[n:]])
        over_period = np.linalg.matrix_power(np.block([[step, input_matrix], [np.zeros((m, nz)), np.eye(m)]]), steps)
        return Sampled(over_period[:nz, :nz], over_period[:nz, nz:], control_period)


@checked
def linear(crane: Crane, state: State, effort: np.ndarray | None = None, *, drive: Drive = "effort") -> Linear:
    """Linearise a crane about a state.

    Args:
        crane: The crane.
        state: Where it hangs at rest, or passes by in a motion.
        effort: What the drives exert there, shape (3,); None for what balances gravity.
        drive: What u is: "effort", or with "motion" the accelerations of the drives.

    Raises:
        OutOfRange: If the effort is not three finite numbers, or `drive` is none of these.
    """
    if drive not in ("effort", "motion"):
        raise OutOfRange("drive", drive, "effort or motion")
    exerted = holding_effort(crane, state.q) if effort is None else finite("effort", effort, (3,), unit="N m, N, N")
    by_state, by_command = linearise(crane, state, exerted)
    if drive == "motion":  # the efforts are then what gives the drives their accelerations
        moved = by_command @ np.linalg.inv(by_command[DRIVES])
        by_state, by_command = by_state - moved @ by_state[DRIVES], moved
        by_state[DRIVES], by_command[DRIVES] = 0.0, np.eye(len(DRIVES))
    n = len(by_state)
    return Linear(np.vstack([np.eye(n, 2 * n, n), by_state]), np.vstack([np.zeros_like(by_command), by_command]))


@checked
def sampled(crane: Crane, state: State, effort: np.ndarray | None = None, *, dt: float = 5e-4, control_period: float = 5e-3) -> Sampled:
    """Linearise a crane that takes efforts about a state, and step it as `simulate` does, see `linear` and `Linear.sampled`.

    Raises:
        OutOfRange: As these.
    """
    return linear(crane, state, effort).sampled(dt=dt, control_period=control_period)


@checked
def feedback_gain(stiffness: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """Gain of proportional-derivative control of each drive by itself, shape (3, 10), from its k_p and k_d, shape (3,) each."""
    gain = np.zeros((3, 10))
    gain[range(3), DRIVES] = finite("stiffness", stiffness, (3,))
    gain[range(3), 5 + DRIVES] = finite("damping", damping, (3,))
    return gain


@dataclass(frozen=True, eq=False)
class Mode:
    """A swing of the linear loop: z(t) = Re(c shape exp(rate t)).

    Attributes:
        rate: Complex growth rate [1/s]; its imaginary part is the frequency [rad/s].
        shape: Complex deviations, shape (10,), one at the coordinate asked for.
        weights: How much of the mode a state z holds is weights @ z, shape (10,).
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
    """The oscillation of a sampled closed loop, shape (10, 10), in which a coordinate (2 for φ, 3 for θ) has the largest share.

    Raises:
        OutOfRange: If the loop has another shape, the period is out of range, or the coordinate does not oscillate.
    """
    if whole("coordinate", coordinate, 0) > 4:
        raise OutOfRange("coordinate", coordinate, "0 to 4")
    values, vectors = np.linalg.eig(finite("loop", loop, (10, 10)))
    rates = np.log(values.astype(complex)) / within("period", period, 1e-9, 1e13, "s")
    share = np.abs(vectors[coordinate]) / np.linalg.norm(vectors[:5], axis=0)
    shares = np.where(rates.imag > 1e-3, share, 0.0)
    i = int(np.argmax(shares))
    if not shares[i] > 0.0:
        raise OutOfRange("loop", "one in which this coordinate does not oscillate", "one in which it does")
    scale = vectors[coordinate, i]
    return Mode(complex(rates[i]), vectors[:, i] / scale, np.linalg.inv(vectors)[i] * scale)
