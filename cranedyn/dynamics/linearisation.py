"""The linear crane about a rest or a motion: what a small motion does, step by step, under a held
command and in a closed loop.

Deviations are stacked as z = (coordinates, rates), shape (2 n,).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from cranedyn.checks import as_array, check_choice, finite, whole, within
from cranedyn.clocks import clocks
from cranedyn.dynamics.joint_forces import TAUT, JointForces
from cranedyn.dynamics.pinocchio import holding_effort, linearise
from cranedyn.errors import Misshapen, ModelError, OutOfRange
from cranedyn.interfaces import DirectDrive, State
from cranedyn.model.crane import Crane
from cranedyn.model.springs import rest_stiffness


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

    def closed(self, gain: np.ndarray) -> np.ndarray:
        """Return the loop closed with u = -gain z, shape (2 n, 2 n); the gain has shape (m, 2 n).

        Raises:
            OutOfRange: If the gain is not m by 2 n finite numbers.
        """
        return self.a - self.b @ finite("gain", gain, self.b.T.shape)


@dataclass(frozen=True, eq=False)
class Linear:
    """dz/dt = a z + b u.

    Attributes:
        a: Shape (2 n, 2 n).
        b: Shape (2 n, m).
        held: Indices in z of what has no motion of its own, see `held_states`.
    """

    a: np.ndarray
    b: np.ndarray
    held: Sequence[int] = ()

    def sampled(self, *, dt: float = 5e-4, control_period: float = 5e-3) -> Sampled:
        """Step it exactly as `simulate` does: semi-implicit Euler in steps of `dt` [s] under a
        command held for a control period [s].

        Raises:
            OutOfRange: If a time is out of range, the period is not a multiple of `dt`, or a state
                would be beyond what a number can hold.
        """
        steps = clocks(control_period, dt, control_period).steps
        n = len(self.b) // 2
        (a,), (b,) = over_period(self.a[None, n:], self.b[None, n:], dt, steps, self.held)
        return Sampled(a, b, control_period)


def over_period(
    by_state: np.ndarray, by_effort: np.ndarray, dt: float, steps: int, held: Sequence[int] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """Return the discrete model of several physics steps of `dt` [s], as in `Sampled`, for many
    cranes at once.

    Args:
        by_state: Derivatives of the accelerations by coordinates and rates, shape (k, n, 2 n).
        by_effort: Derivatives by the efforts, which are held, shape (k, n, m).
        dt: Physics step [s].
        steps: Number of steps.
        held: Indices in z whose deviations vanish, see `held_states`.

    Returns:
        States after these steps by those before, shape (k, 2 n, 2 n), and by the efforts, shape (k,
        2 n, m).

    Raises:
        OutOfRange: If a state would be beyond what a number can hold.
    """
    k, n, m = by_effort.shape
    nz = 2 * n
    step = np.tile(np.eye(nz + m), (k, 1, 1))
    step[:, n:nz, :nz] += dt * by_state
    step[:, :n, :nz] += dt * step[:, n:nz, :nz]  # positions by the new rates
    step[:, n:nz, nz:], step[:, :n, nz:] = dt * by_effort, dt * dt * by_effort
    with np.errstate(over="ignore", invalid="ignore"):
        power = np.linalg.matrix_power(step, steps)
    finite("what a control period does to a state", power, ("k", nz + m, nz + m))
    power[:, :, list(held)] = 0.0
    return power[:, :nz, :nz], power[:, :nz, nz:]


def held_states(crane: Crane, state: State) -> list[int]:
    """Return the indices in z of what has no motion of its own: the stretch of a taut inextensible
    rope and its rate, none at a state with another rope or a slack one; and joints that follow
    others, whose effect is counted with their leaders.
    """
    joints = np.arange(crane.layout.n)
    rope = crane.springs.rope
    if crane.coupling is not None:
        followers = list(crane.coupling.followers)
        return [*followers, *(len(joints) + follower for follower in followers)]
    if rope is None or JointForces.of(crane).phase(*state) != TAUT:
        return []
    taut = np.setdiff1d(joints, crane.springs.free(joints))
    return [*taut.tolist(), *(len(joints) + taut).tolist()]


def linear(
    crane: Crane, state: State, effort: np.ndarray | None = None, *, drive: DirectDrive = "effort"
) -> Linear:
    """Linearise a crane about a state.

    Args:
        crane: The crane.
        state: Where it hangs at rest, or passes by in a motion.
        effort: What the drives exert there, shape (m,); None for what balances gravity.
        drive: What u is: "effort", or with "motion" the accelerations of the drives.

    Raises:
        OutOfRange: If the effort is not one finite number for each drive, or `drive` is none of
            these.
    """
    check_choice("drive", drive, DirectDrive)
    n, m, drives = crane.layout.n, crane.layout.m, crane.layout.drives
    state = crane.layout.as_state("state", state)
    exerted = holding_effort(crane, state.q) if effort is None else finite("effort", effort, (m,))
    by_state, by_command = linearise(crane, state, exerted)
    if drive == "motion":  # the efforts are then what gives the drives their accelerations
        moved = by_command @ np.linalg.inv(by_command[drives])
        by_state = by_state - moved @ by_state[drives]
        by_command = moved
        by_state[drives], by_command[drives] = 0.0, np.eye(m)
    held = held_states(crane, state)
    by_z = np.vstack([np.eye(n, 2 * n, n), by_state])
    by_u = np.vstack([np.zeros_like(by_command), by_command])
    if crane.coupling is not None:
        by_z[held], by_u[held] = 0.0, 0.0
        by_z[:, held] = 0.0
    return Linear(by_z, by_u, held)


def sampled(
    crane: Crane,
    state: State,
    effort: np.ndarray | None = None,
    *,
    dt: float = 5e-4,
    control_period: float = 5e-3,
) -> Sampled:
    """Linearise a crane that takes efforts about a state, and step it as `simulate` does, see
    `linear` and `Linear.sampled`.

    Raises:
        OutOfRange: As these.
    """
    return linear(crane, state, effort).sampled(dt=dt, control_period=control_period)


def feedback_gain(crane: Crane, stiffness: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """Return the gain of proportional-derivative control of each drive by itself, shape (m, 2 n),
    from its k_p and k_d, shape (m,) each.
    """
    layout = crane.layout
    gain = np.zeros((layout.m, 2 * layout.n))
    gain[range(layout.m), layout.drives] = finite("stiffness", stiffness, (layout.m,))
    gain[range(layout.m), layout.n + layout.drives] = finite("damping", damping, (layout.m,))
    return gain


@dataclass(frozen=True, eq=False)
class FreeModes:
    """How the p passive joints swing about a rest while the drives are locked, undamped, the
    slowest first.

    Attributes:
        frequencies: [rad/s], shape (p,).
        shapes: Column k holds the passive joints in mode k [rad or m], scaled to a modal mass of 1,
            shape (p, p).
        weights: Row k tells how much of mode k a deviation of the passive joints holds, shape (p,
            p).
        rest: Coordinates about which they swing, shape (n,).
        passive: Where the passive joints stand among the coordinates, shape (p,).
    """

    frequencies: np.ndarray
    shapes: np.ndarray
    weights: np.ndarray
    rest: np.ndarray
    passive: np.ndarray

    def amplitudes(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the amplitude of each mode in small motions, shape (rows, p), of coordinates and
        rates, shape (rows, n) each.

        Times the column of `shapes` it is the amplitude in each passive joint.
        """
        q, v = as_array("q", q, ("rows", len(self.rest))), as_array("v", v, q.shape)
        modal = (q - self.rest)[:, self.passive] @ self.weights.T
        return np.hypot(modal, v[:, self.passive] @ self.weights.T / self.frequencies)


def free_modes(crane: Crane, state: State) -> FreeModes:
    """Return frequencies and shapes of the passive joints with the drives locked,
    from K x = ω² M x.

    K are the second derivatives of the energy of gravity and springs, M is the mass matrix, both of
    the passive joints alone.

    Args:
        crane: The crane.
        state: Where it hangs at rest; its rates do not enter.

    Raises:
        ModelError: If a passive joint has no inertia there, or would fall instead of swinging.
        OutOfRange: If a coordinate is so large that masses or stiffnesses are not finite.
    """
    q = crane.layout.as_state("state", state).q
    free = crane.springs.free(crane.layout.passive)
    data = crane.data
    block = np.ix_(free, free)
    stiffness = rest_stiffness(crane.model, data, crane.springs, q, crane.coupling)[block]
    mass = crane.mass_matrix(q)[block]
    if not (np.isfinite(stiffness).all() and np.isfinite(mass).all()):
        allowed = "one at which gravity, springs and masses have finite effects"
        raise OutOfRange("state", crane.layout.coordinates_text(q), allowed)
    try:
        squares, shapes = scipy.linalg.eigh((stiffness + stiffness.T) / 2.0, mass)
    except np.linalg.LinAlgError:
        raise ModelError(
            f"At {crane.layout.coordinates_text(q)} a passive joint of this crane moves no inertia "
            "of its own, so that it has no frequency; give its links a mass or an inertia."
        ) from None
    if not (squares > 0.0).all():
        raise ModelError(
            f"At {crane.layout.coordinates_text(q)} the passive joints of this crane would fall, "
            f"not swing: ω² = {float(squares.min()):g} /s². Start from a state that hangs, as "
            "crane.hanging returns it."
        )
    return FreeModes(np.sqrt(squares), shapes, shapes.T @ mass, q.copy(), free)


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


def swing_mode(loop: np.ndarray, period: float, coordinate: int) -> Mode:
    """Return the oscillation of a sampled closed loop, shape (2 n, 2 n), in which a coordinate, by
    its index, has the largest share.

    Raises:
        OutOfRange: If the loop has another shape, the period is out of range, or the coordinate
            does not oscillate.
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
        value = "one in which this coordinate does not oscillate"
        raise OutOfRange("loop", value, "one in which it does")
    scale = vectors[coordinate, i]
    return Mode(complex(rates[i]), vectors[:, i] / scale, np.linalg.inv(vectors)[i] * scale)
