"""The linear crane about a rest or a motion: what a small motion does, step by step, under a held
command and in a closed loop.

Deviations are stacked as z = (coordinates, rates), shape (2 n,); u are the deviations of the m
commands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from cranedyn.checks import as_array, check_choice, finite, whole, within
from cranedyn.clocks import clocks
from cranedyn.dynamics.equations_of_motion import holding_effort, linearise
from cranedyn.dynamics.joint_forces import TAUT, JointForces
from cranedyn.errors import Misshapen, ModelError, OutOfRange
from cranedyn.interfaces import DirectDrive, State
from cranedyn.model.crane import Crane
from cranedyn.model.springs import rest_stiffness

MIN_FREQUENCY = 1e-3
"""Frequency below which a mode of a loop does not count as an oscillation [rad/s]."""


@dataclass(frozen=True, eq=False)
class Sampled:
    """The linear crane in discrete time: z after one control period is a z + b u, with the drive
    efforts u held.

    Attributes:
        a: Derivative of z by z a period before, shape (2 n, 2 n).
        b: Derivative of z by the efforts, shape (2 n, m).
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
    """The linear crane in continuous time, dz/dt = a z + b u.

    Attributes:
        a: Derivative of dz/dt by z, shape (2 n, 2 n).
        b: Derivative of dz/dt by the command, shape (2 n, m).
        held: Indices in z of coordinates and rates that a taut rope or a leader determines, see
            `held_states`.
    """

    a: np.ndarray
    b: np.ndarray
    held: Sequence[int] = ()

    def sampled(self, *, dt: float = 5e-4, control_period: float = 5e-3) -> Sampled:
        """Return the discrete model of the steps that `simulate` takes.

        They are those of semi-implicit Euler under a command that is held for a control period.

        Args:
            dt: Physics step [s].
            control_period: Time for which a command is held [s].

        Raises:
            OutOfRange: If a time is out of range, the period is not a multiple of `dt`, or a state
                would be beyond what a number can hold.
        """
        steps = clocks(control_period, dt, control_period).steps
        n = len(self.b) // 2
        # The lower halves are the derivatives of the accelerations, of one crane.
        by_state = self.a[None, n:]
        by_effort = self.b[None, n:]
        a, b = over_period(by_state, by_effort, dt, steps, self.held)
        return Sampled(a[0], b[0], control_period)


def over_period(
    by_state: np.ndarray, by_effort: np.ndarray, dt: float, steps: int, held: Sequence[int] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """Return the discrete model of several physics steps, as in `Sampled`, for many cranes at once.

    A step of semi-implicit Euler is v' = v + dt (A_q q + A_v v + B u) and q' = q + dt v'. As a
    matrix on (q, v, u), with u' = u, its power is the model of so many steps.

    Args:
        by_state: Derivatives of the accelerations by coordinates and rates, shape (k, n, 2 n).
        by_effort: Derivatives by the efforts, which are held, shape (k, n, m).
        dt: Physics step [s].
        steps: Number of steps.
        held: Indices in z whose deviations vanish, see `held_states`.

    Returns:
        Derivatives of z after these steps by z before, shape (k, 2 n, 2 n), and by the efforts,
        shape (k, 2 n, m).

    Raises:
        OutOfRange: If a state would be beyond what a number can hold.
    """
    k, n, m = by_effort.shape
    nz = 2 * n
    step = np.tile(np.eye(nz + m), (k, 1, 1))
    step[:, n:nz, :nz] += dt * by_state
    step[:, :n, :nz] += dt * step[:, n:nz, :nz]  # positions move by the new rates
    step[:, n:nz, nz:] = dt * by_effort
    step[:, :n, nz:] = dt * dt * by_effort
    # An overflow is reported below.
    with np.errstate(over="ignore", invalid="ignore"):
        power = np.linalg.matrix_power(step, steps)
    finite("what a control period does to a state", power, ("k", nz + m, nz + m))
    power[:, :, list(held)] = 0.0
    return power[:, :nz, :nz], power[:, :nz, nz:]


def held_states(crane: Crane, state: State) -> list[int]:
    """Return the indices in z of coordinates and rates that a taut rope or a leader determines.

    These are those of the stretch of an inextensible rope that is taut at the state, and those of
    joints that follow others, whose effect is counted with their leaders.
    """
    n = crane.layout.n
    joints = np.arange(n)
    rope = crane.springs.rope
    if crane.coupling is not None:
        held = list(crane.coupling.followers)
    elif rope is None or JointForces.of(crane).phase(state.q, state.v) != TAUT:
        held = []
    else:
        held = np.setdiff1d(joints, crane.springs.free(joints)).tolist()
    return [*held, *(n + joint for joint in held)]


def linear(
    crane: Crane, state: State, effort: np.ndarray | None = None, *, drive: DirectDrive = "effort"
) -> Linear:
    """Linearise a crane about a state.

    Args:
        crane: The crane.
        state: A state of rest, or one that a motion passes.
        effort: Efforts of the drives there [N m or N], shape (m,); None for those that balance
            gravity.
        drive: Kind of the command u: "effort", or with "motion" the accelerations of the drives.

    Raises:
        OutOfRange: If the effort is not one finite number for each drive, or `drive` is none of
            these.
    """
    check_choice("drive", drive, DirectDrive)
    n = crane.layout.n
    m = crane.layout.m
    drives = crane.layout.drives
    state = crane.layout.as_state("state", state)
    exerted = holding_effort(crane, state.q) if effort is None else finite("effort", effort, (m,))
    by_state, by_command = linearise(crane, state, exerted)
    if drive == "motion":
        # The efforts are those that give the drives their accelerations a_d: with the rows d of the
        # drives, a_d = A_d z + B_d u becomes u = B_d⁻¹ (a_d - A_d z). The rows of the drives are
        # then a_d itself, without round-off.
        by_acceleration = by_command @ np.linalg.inv(by_command[drives])
        by_state = by_state - by_acceleration @ by_state[drives]
        by_command = by_acceleration
        by_state[drives] = 0.0
        by_command[drives] = np.eye(m)
    held = held_states(crane, state)
    rates_by_state = np.eye(n, 2 * n, n)
    by_z = np.vstack([rates_by_state, by_state])
    by_u = np.vstack([np.zeros_like(by_command), by_command])
    if crane.coupling is not None:
        # The derivatives of the accelerations of followers are those of their motion with their
        # leaders, which is counted with the leaders already. (The stretch that a taut rope holds
        # has no accelerations and no columns; its row ds/dt = v_s stays, and v_s is zero.)
        by_z[held] = 0.0
        by_z[:, held] = 0.0
        by_u[held] = 0.0
    return Linear(by_z, by_u, held)


def sampled(
    crane: Crane,
    state: State,
    effort: np.ndarray | None = None,
    *,
    dt: float = 5e-4,
    control_period: float = 5e-3,
) -> Sampled:
    """Linearise a crane that takes efforts about a state, and step it as `simulate` does.

    Arguments and errors are those of `linear` and `Linear.sampled`.
    """
    return linear(crane, state, effort).sampled(dt=dt, control_period=control_period)


def feedback_gain(crane: Crane, stiffness: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """Return the gain of proportional-derivative control of each drive by itself, shape (m, 2 n).

    Args:
        crane: The crane.
        stiffness: Proportional gains k_p of the drives [N m/rad or N/m], shape (m,).
        damping: Derivative gains k_d of the drives [N m s/rad or N s/m], shape (m,).
    """
    layout = crane.layout
    gain = np.zeros((layout.m, 2 * layout.n))
    rows = range(layout.m)
    gain[rows, layout.drives] = finite("stiffness", stiffness, (layout.m,))
    gain[rows, layout.n + layout.drives] = finite("damping", damping, (layout.m,))
    return gain


@dataclass(frozen=True, eq=False)
class FreeModes:
    """How p passive joints swing about a rest while the drives are locked, undamped, the slowest
    first. They are all passive joints but the stretch of an inextensible rope, which is taut.

    Attributes:
        frequencies: Frequencies [rad/s], shape (p,).
        shapes: Column k is the deviation of the passive joints in mode k [rad or m], scaled to a
            modal mass of 1, shape (p, p).
        weights: Inverse of the shapes: row k times a deviation of the passive joints is the share
            of mode k in it, shape (p, p).
        rest: Coordinates about which they swing, shape (n,).
        passive: Indices of the passive joints among the coordinates, shape (p,).
    """

    frequencies: np.ndarray
    shapes: np.ndarray
    weights: np.ndarray
    rest: np.ndarray
    passive: np.ndarray

    def amplitudes(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the amplitude of each mode in small motions, shape (rows, p).

        A mode with the deviation y, the rate ẏ and the frequency ω has the amplitude √(y² + ẏ²/ω²).
        Times the column of `shapes` it is the amplitude in each passive joint.

        Args:
            q: Coordinates, shape (rows, n).
            v: Their rates, shape (rows, n).
        """
        q = as_array("q", q, ("rows", len(self.rest)))
        v = as_array("v", v, q.shape)
        deviations = (q - self.rest)[:, self.passive] @ self.weights.T
        rates = v[:, self.passive] @ self.weights.T
        return np.hypot(deviations, rates / self.frequencies)


def free_modes(crane: Crane, state: State) -> FreeModes:
    """Return frequencies and shapes of the passive joints with the drives locked, and with an
    inextensible rope taut.

    They solve K x = ω² M x, with the second derivatives K of the energy of gravity and springs and
    the mass matrix M, both of the passive joints alone.

    Args:
        crane: The crane.
        state: A state at which it hangs at rest; its rates do not enter.

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
        # The stiffness is symmetric but for round-off.
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
    # The shapes are normal, shapesᵀ M shapes = 1, so that shapesᵀ M is their inverse.
    return FreeModes(
        frequencies=np.sqrt(squares),
        shapes=shapes,
        weights=shapes.T @ mass,
        rest=q.copy(),
        passive=free,
    )


@dataclass(frozen=True, eq=False)
class Mode:
    """An oscillation of the linear loop, z(t) = Re(c shape exp(rate t)).

    Attributes:
        rate: Complex growth rate [1/s]; its imaginary part is the frequency [rad/s].
        shape: Complex deviations, shape (2 n,); that of the coordinate asked for is 1.
        weights: Left eigenvector, shape (2 n,): the amplitude c of the mode in z is weights @ z.
    """

    rate: complex
    shape: np.ndarray
    weights: np.ndarray

    @property
    def period(self) -> float:
        """Duration of one oscillation [s]."""
        return float(2.0 * np.pi / self.rate.imag)

    @property
    def damping_ratio(self) -> float:
        """Fraction of critical damping."""
        return float(-self.rate.real / abs(self.rate))


def dominant_mode(loop: np.ndarray, period: float, coordinate: int) -> Mode:
    """Return the oscillation of a sampled closed loop in which a coordinate has the largest share.

    Args:
        loop: Derivative of z by z a period before, see `Sampled.closed`, shape (2 n, 2 n).
        period: The control period [s].
        coordinate: Index of the coordinate.

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
    # An eigenvalue is exp(rate period).
    rates = np.log(values.astype(complex)) / within("period", period, 1e-9, 1e13, "s")
    share = np.abs(vectors[coordinate]) / np.linalg.norm(vectors[:n], axis=0)
    # Of a pair of conjugate modes that with the positive frequency is taken.
    shares = np.where(rates.imag > MIN_FREQUENCY, share, 0.0)
    i = int(np.argmax(shares))
    if not shares[i] > 0.0:
        value = "one in which this coordinate does not oscillate"
        raise OutOfRange("loop", value, "one in which it does")
    scale = vectors[coordinate, i]
    return Mode(
        rate=complex(rates[i]),
        shape=vectors[:, i] / scale,
        weights=np.linalg.inv(vectors)[i] * scale,
    )
