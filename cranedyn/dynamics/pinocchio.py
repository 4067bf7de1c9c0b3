"""How the crane moves: functions of a crane and a state, by Pinocchio's algorithms.

Efforts are those of the m drives [N m or N]; for the tower crane slew torque, trolley force and
hoist force (negative holds the load). Positions are in the world frame [m]: Z up, for the tower
crane the origin on the ground at the slew axis, the jib along -Y at zero slew.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
import scipy

from cranedyn.dynamics.joint_forces import TAUT, JointForces
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane, Point
from cranedyn.model.mimics import Coupling
from cranedyn.model.springs import rest_stiffness


def full(crane: Crane, drives: np.ndarray) -> np.ndarray:
    """Return the numbers of the drives, shape (m,), among those of all joints, shape (n,): zero for
    the passive ones.
    """
    among = np.zeros(crane.layout.n, np.asarray(drives).dtype)
    among[crane.layout.drives] = drives
    return among


def acceleration(crane: Crane, state: State, effort: np.ndarray) -> np.ndarray:
    """Return the accelerations of all joints [rad/s² or m/s²], shape (n,), under drive efforts,
    with damping, dry friction and springs: ABA, or from the reduced mass matrix where joints follow
    others.
    """
    tau = full(crane, effort) + JointForces.of(crane).effort(*state)
    if crane.coupling is None:
        return pin.aba(crane.model, crane.data, *state, tau)
    return follow_drives(
        crane.model,
        crane.data,
        *state,
        np.zeros(crane.layout.n),
        tau,
        crane.layout.independent,
        coupling=crane.coupling,
    )


def prescribed_acceleration(
    crane: Crane, state: State, drive_acceleration: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the accelerations of all joints when those of the drives are given, and the drive
    efforts that this costs.

    Solves the passive rows of M a + b = τ for the passive joints, then reads the drive rows.

    Args:
        crane: The crane.
        state: Where it is.
        drive_acceleration: Of the drives [rad/s² or m/s²], shape (m,).

    Returns:
        Accelerations, shape (n,), and efforts [N m or N], shape (m,).
    """
    joint = JointForces.of(crane).effort(*state)
    layout = crane.layout
    a = full(crane, drive_acceleration)
    model, data, coupling = crane.model, crane.data, crane.coupling
    a = follow_drives(model, data, *state, a, joint, layout.passive, coupling=coupling)
    needed = inverse_dynamics(model, data, *state, a, joint, coupling=coupling)
    return a, needed[layout.drives]


def follow_drives(
    model: pin.Model,
    data: pin.Data,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    joint: np.ndarray,
    passive: np.ndarray,
    outside: np.ndarray | None = None,
    coupling: Coupling | None = None,
) -> np.ndarray:
    """Return the accelerations of all joints, shape (n,), from those of the drives; in any unit of
    time.

    The passive rows of M a + b = joint + outside are as many equations as there are passive joints.
    Where joints follow others these are the rows of Gᵀ M G and Gᵀ b, see `cranedyn.model.mimics`.

    Args:
        model: A crane's model.
        data: Its scratch memory.
        q: Coordinates, shape (n,).
        v: Their rates, shape (n,).
        a: Accelerations of the drives among zeros, shape (n,).
        joint: Generalized forces of damping and springs, shape (n,).
        passive: Indices of the passive joints.
        outside: Generalized forces from outside, shape (n,); None for none.
        coupling: Joints that follow others; None if there are none.

    Raises:
        OutOfRange: If a passive joint has no inertia, as the swing of a point load on a cable of no
            length, or it is no number.
    """
    if coupling is not None:
        a = coupling.spread(a)
    if not len(passive):
        return a.copy()
    still_open = inverse_dynamics(model, data, q, v, a, joint, outside, coupling)
    mass = pin.crba(model, data, q)
    solved = a.copy()
    if coupling is not None:
        mass = coupling.reduce(mass)
    if len(passive) == 2:  # the tower crane's, by determinants: quicker than NumPy's
        i, j = passive.tolist()
        m11, m12, m22 = mass.item(i, i), mass.item(i, j), mass.item(j, j)
        open_i, open_j = still_open.item(i), still_open.item(j)
        determinant = m11 * m22 - m12 * m12
        if not determinant > 0.0:
            raise _no_inertia(m11, m22)
        solved[i] = (m12 * open_j - m22 * open_i) / determinant
        solved[j] = (m12 * open_i - m11 * open_j) / determinant
        return solved if coupling is None else coupling.spread(solved)
    passive_mass = mass[passive[:, None], passive]
    if not (np.isfinite(passive_mass).all() and np.linalg.eigvalsh(passive_mass)[0] > 0.0):
        raise _no_inertia(*passive_mass.diagonal().tolist())
    solved[passive] = -np.linalg.solve(passive_mass, still_open[passive])
    return solved if coupling is None else coupling.spread(solved)


def _no_inertia(*inertias: float) -> OutOfRange:
    values = " and ".join(f"{inertia:g}" for inertia in inertias)
    allowed = "> 0; a load without rotational inertia needs a cable"
    return OutOfRange("inertia against swing", values, allowed, "kg m²")


def inverse_dynamics(
    model: pin.Model,
    data: pin.Data,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    joint: np.ndarray,
    outside: np.ndarray | None = None,
    coupling: Coupling | None = None,
) -> np.ndarray:
    """Return the generalized forces that cause these accelerations beside those of joints and
    outside, shape (n,); arguments as `follow_drives`. Leaders carry those of their followers.
    """
    needed = pin.rnea(model, data, q, v, a) - joint
    if outside is not None:
        needed = needed - outside
    return needed if coupling is None else coupling.gather(needed)


def outside_effort(
    points: Sequence[Point], model: pin.Model, data: pin.Data, q: np.ndarray, force: np.ndarray
) -> np.ndarray:
    """Return the generalized forces of a force on each of some points, shape (n,).

    Args:
        points: The points.
        model: A crane's model.
        data: Its scratch memory.
        q: Coordinates, shape (n,).
        force: In the world [N], shape (points, 3).
    """
    pairs = zip(force, _jacobians(points, model, data, q), strict=True)
    return sum(point_force @ jacobian for point_force, jacobian in pairs)


def _jacobians(
    points: Sequence[Point], model: pin.Model, data: pin.Data, q: np.ndarray
) -> list[np.ndarray]:
    """Return the velocity of each point in the world per rate of the coordinates, shape (3, n)
    each.
    """
    pin.computeJointJacobians(model, data, q)
    jacobians = []
    for _, body, lever in points:
        # Pinocchio gives a matrix of one column without its second dimension.
        jacobian = pin.getJointJacobian(model, data, body + 1, pin.LOCAL_WORLD_ALIGNED)
        jacobian = jacobian.reshape(6, model.nv)
        jacobians.append(
            jacobian[:3] - pin.skew(data.oMi[body + 1].rotation @ lever) @ jacobian[3:]
        )
    return jacobians


def body_points(
    model: pin.Model, data: pin.Data, body: int, points: np.ndarray, q: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return positions [m] and velocities [m/s] in the world of points of a body, shape (3, points)
    each.

    Args:
        model: A crane's model.
        data: Its scratch memory.
        body: Index of the joint that carries the points.
        points: In its frame [m], shape (points, 3).
        q: Coordinates, shape (n,).
        v: Their rates, shape (n,).
    """
    pin.forwardKinematics(model, data, q, v)
    placement, motion = data.oMi[body + 1], data.v[body + 1]
    velocity = motion.linear[:, None] + pin.skew(motion.angular) @ points.T
    position = placement.rotation @ points.T + placement.translation[:, None]
    return position, placement.rotation @ velocity


def energy(crane: Crane, state: State) -> float:
    """Return the mechanical energy, that of springs included [J], zero of height at the ground."""
    rigid = float(pin.computeMechanicalEnergy(crane.model, crane.data, *state))
    return rigid + float(crane.springs.energy(state.q)) if crane.springs.any else rigid


def point_positions(crane: Crane, q: np.ndarray) -> np.ndarray:
    """Return the positions of a crane's points in the world [m], shape (points, 3)."""
    pin.forwardKinematics(crane.model, crane.data, q)
    return np.array([crane.data.oMi[body + 1].act(lever) for _, body, lever in crane.points])


def point_velocities(crane: Crane, state: State) -> np.ndarray:
    """Return the velocities of a crane's points in the world [m/s], shape (points, 3)."""
    jacobians = _jacobians(crane.points, crane.model, crane.data, state.q)
    return np.array([jacobian @ state.v for jacobian in jacobians])


def payload_position(crane: Crane, q: np.ndarray) -> np.ndarray:
    """Return the centre of the payload in the world [m], shape (3,)."""
    return point_positions(crane, q)[0]


def pivot_position(crane: Crane, q: np.ndarray) -> np.ndarray:
    """Return the point above the payload in the world [m], shape (3,): the swing pivot at the
    trolley, if there is one.
    """
    return point_positions(crane, q)[min(1, len(crane.points) - 1)]


def natural_frequencies(crane: Crane, q: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Return the frequencies of small motions of some joints, by their indices, about a rest at
    coordinates q with all others locked [rad/s], increasing; 0 where nothing restores them.
    """
    among = np.ix_(joints, joints)
    stiffness = rest_stiffness(crane.model, crane.data, crane.springs, q, crane.coupling)[among]
    squares = scipy.linalg.eigvalsh(stiffness, crane.mass_matrix(q)[among])
    return np.sqrt(np.maximum(squares, 0.0))


def payload_orientation(crane: Crane, q: np.ndarray) -> np.ndarray:
    """Return the orientation of the payload in the world, a unit quaternion x, y, z, w, shape
    (4,).
    """
    pin.forwardKinematics(crane.model, crane.data, q)
    return pin.Quaternion(crane.data.oMi[crane.payload.body + 1].rotation).coeffs()


def holding_effort(crane: Crane, q: np.ndarray) -> np.ndarray:
    """Drive efforts that balance gravity and springs at rest, shape (m,); with swing, what they
    balance of it.
    """
    weight = pin.computeGeneralizedGravity(crane.model, crane.data, q)
    held = weight - crane.springs.effort(q) if crane.springs.any else weight
    if crane.coupling is not None:
        held = crane.coupling.gather(held)
    return held[crane.layout.drives]


def linearise(crane: Crane, state: State, effort: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives of the accelerations, with damping and springs.

    Returns:
        A, shape (n, 2 n): by coordinates then rates; B, shape (n, m): by drive efforts.
    """
    by_state, inverse_mass = by_state_and_force(crane, state, effort)
    return by_state, inverse_mass[:, crane.layout.drives]


def by_state_and_force(
    crane: Crane, state: State, effort: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return A as `linearise`, and the inverse of the mass matrix, shape (n, n), in place of B.

    The accelerations are in `crane.data.ddq` afterwards, unless a taut inextensible rope holds.
    """
    joint = JointForces.of(crane)
    rope = crane.springs.rope
    if rope is not None and rope.inextensible and joint.phase(*state) == TAUT:
        return _by_state_and_force_when_taut(crane, state, effort, rope.stretch)
    if crane.coupling is not None:
        return _by_state_and_force_when_coupled(crane, crane.coupling, state, effort)
    tau = full(crane, effort) + joint.effort(*state)
    by_q, by_v, inverse_mass = pin.computeABADerivatives(crane.model, crane.data, *state, tau)
    stiffness, damping = joint.tangent(*state)
    if crane.springs.any:
        by_q = by_q - inverse_mass @ stiffness
    by_state = np.concatenate([by_q, by_v - inverse_mass * damping], axis=1)
    return by_state, inverse_mass.copy()


def _by_state_and_force_when_coupled(
    crane: Crane, coupling: Coupling, state: State, effort: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return `by_state_and_force` where joints follow others.

    From the derivatives of the inverse dynamics, with a = G x and the reduced mass matrix
    R = Gᵀ M G,

        R dx = Gᵀ (dτ - ∂(M a + b)/∂q G dq - ∂(M a + b)/∂v G dv).

    What followers do by themselves has no effect, so that their columns are zero.
    """
    joint = JointForces.of(crane)
    spread = coupling.matrix
    a = acceleration(crane, state, effort)
    pin.computeRNEADerivatives(crane.model, crane.data, *state, a)
    stiffness, damping = joint.tangent(*state)
    by_q = (crane.data.dtau_dq + stiffness) @ spread
    by_v = (crane.data.dtau_dv + np.diag(damping)) @ spread
    inverse_mass = spread @ np.linalg.inv(crane.mass_matrix(state.q)) @ spread.T
    crane.data.ddq = a
    return -inverse_mass @ np.hstack([by_q, by_v]), inverse_mass


def _by_state_and_force_when_taut(
    crane: Crane, state: State, effort: np.ndarray, stretch: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return `by_state_and_force` of the joints that a taut inextensible rope lets move, from the
    derivatives of the inverse dynamics.
    """
    n = crane.layout.n
    data = crane.data
    joint = JointForces.of(crane)
    free = crane.springs.free(np.arange(n))
    inverse_mass = np.zeros((n, n))
    tau = full(crane, effort) + joint.effort(*state)
    a = follow_drives(crane.model, data, *state, np.zeros(n), tau, free)
    pin.computeRNEADerivatives(crane.model, data, *state, a)
    stiffness, damping = joint.tangent(*state)
    resisting = np.hstack([data.dtau_dq + stiffness, data.dtau_dv + np.diag(damping)])
    inverse_mass[np.ix_(free, free)] = np.linalg.inv(data.M[np.ix_(free, free)])
    by_state = -inverse_mass @ resisting
    by_state[:, [stretch, n + stretch]] = 0.0
    return by_state, inverse_mass
