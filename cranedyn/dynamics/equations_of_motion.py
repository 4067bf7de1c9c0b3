"""The equations of motion of a crane: accelerations, efforts, energy and positions at a state, by
Pinocchio's algorithms.

The equation of motion of the n joints is

    M(q) a + b(q, v) = τ + τ_joint(q, v) + τ_outside,

with the mass matrix M, the bias b of gravity, Coriolis and centrifugal forces, the efforts τ of the
drives among zeros, the forces τ_joint of damping, dry friction and springs, see
`cranedyn.dynamics.joint_forces`, and those from outside. Of Pinocchio's algorithms RNEA returns
M a + b, ABA solves for a, and CRBA returns M (Featherstone, Rigid Body Dynamics Algorithms, 2008,
chapters 5 to 7).

Where joints follow others, a = G a with the coupling matrix G, and both sides are multiplied by Gᵀ,
see `cranedyn.model.mimics`. A taut inextensible rope is a constraint: its stretch does not
accelerate, and the equation of that row gives the tension instead.

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


def over_all_joints(crane: Crane, drive_values: np.ndarray) -> np.ndarray:
    """Return an array over all joints, shape (n,), from values of the drives, shape (m,), with
    zeros for passive joints and followers.
    """
    all_joints = np.zeros(crane.layout.n, np.asarray(drive_values).dtype)
    all_joints[crane.layout.drives] = drive_values
    return all_joints


def acceleration(crane: Crane, state: State, effort: np.ndarray) -> np.ndarray:
    """Return the accelerations of all joints under efforts of the drives.

    Damping, dry friction and springs are included. A taut inextensible rope holds its stretch, see
    `JointForces.phase`. The algorithm is ABA where all joints are free; elsewhere the equation of
    motion of the free ones is solved.

    Args:
        crane: The crane.
        state: Its state.
        effort: Efforts of the drives [N m or N], shape (m,).

    Returns:
        Accelerations [rad/s² or m/s²], shape (n,).
    """
    joint_forces = JointForces.of(crane)
    tau = over_all_joints(crane, effort) + joint_forces.effort(state.q, state.v)
    holds_stretch = _holds_stretch(joint_forces, state)
    if crane.coupling is None and not holds_stretch:
        return pin.aba(crane.model, crane.data, state.q, state.v, tau)
    free = crane.layout.independent
    return solve_accelerations(
        crane.model,
        crane.data,
        state.q,
        state.v,
        given=np.zeros(crane.layout.n),
        forces=tau,
        unknown=crane.springs.free(free) if holds_stretch else free,
        coupling=crane.coupling,
    )


def _holds_stretch(joint_forces: JointForces, state: State) -> bool:
    """Return whether an inextensible rope is taut at a state, so that its stretch cannot move."""
    rope = joint_forces.rope
    if rope is None or not rope.inextensible:
        return False
    return bool(joint_forces.phase(state.q, state.v) == TAUT)


def prescribed_acceleration(
    crane: Crane, state: State, drive_acceleration: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the accelerations of all joints when those of the drives are given, and the drive
    efforts that this takes.

    The passive rows of the equation of motion give the accelerations of the passive joints, its
    drive rows then the efforts. A taut inextensible rope holds its stretch, see
    `JointForces.phase`.

    Args:
        crane: The crane.
        state: Its state.
        drive_acceleration: Accelerations of the drives [rad/s² or m/s²], shape (m,).

    Returns:
        Accelerations of all joints, shape (n,), and efforts of the drives [N m or N], shape (m,).

    Raises:
        OutOfRange: If a passive joint has no inertia.
    """
    q = state.q
    v = state.v
    model = crane.model
    data = crane.data
    coupling = crane.coupling
    layout = crane.layout
    joint_forces = JointForces.of(crane)
    passive = layout.passive
    if _holds_stretch(joint_forces, state):
        passive = crane.springs.free(passive)
    forces = joint_forces.effort(q, v)
    a = over_all_joints(crane, drive_acceleration)
    a = solve_accelerations(model, data, q, v, a, forces, passive, coupling=coupling)
    needed = inverse_dynamics(model, data, q, v, a, forces, coupling=coupling)
    return a, needed[layout.drives]


def constraint_tension(
    crane: Crane, state: State, effort: np.ndarray, force: np.ndarray | None = None
) -> float:
    """Return the tension of an inextensible rope that may go slack [N]; 0 where it is slack.

    It is the force that holds the stretch s where it is: T = -(M a + b - τ)_s with the row s of the
    equation of motion and the accelerations a with which the stretch stands still.

    Args:
        crane: A crane with such a rope.
        state: Its state.
        effort: Efforts of the drives [N m or N], shape (m,).
        force: Forces from outside on the points of the crane in the world [N], shape (points, 3);
            None for none.
    """
    rope = crane.springs.rope
    assert rope is not None and rope.inextensible
    joint_forces = JointForces.of(crane)
    if not _holds_stretch(joint_forces, state):
        return 0.0
    q = state.q
    v = state.v
    model = crane.model
    data = crane.data
    tau = over_all_joints(crane, effort) + joint_forces.effort(q, v)
    outside = None
    if force is not None:
        outside = outside_effort(crane.points, model, data, q, force)
    free = crane.springs.free(crane.layout.independent)
    a = solve_accelerations(model, data, q, v, np.zeros(len(q)), tau, free, outside)
    needed = inverse_dynamics(model, data, q, v, a, tau, outside)
    return max(-float(needed[rope.stretch]), 0.0)


def solve_accelerations(
    model: pin.Model,
    data: pin.Data,
    q: np.ndarray,
    v: np.ndarray,
    given: np.ndarray,
    forces: np.ndarray,
    unknown: np.ndarray,
    outside: np.ndarray | None = None,
    coupling: Coupling | None = None,
) -> np.ndarray:
    """Return the accelerations of all joints, shape (n,), some of which are given; in any unit of
    time.

    The unknown accelerations u follow from the equation of motion, the others g are given. For
    drives whose motion is prescribed the unknown ones are those of the passive joints. The rows of
    the unknown ones are as many equations:

        M_uu a_u = -(M_ug a_g + b_u - τ_u - τ_outside,u).

    The bracket is what the inverse dynamics leaves in these rows with a_u = 0. Where joints follow
    others these are the rows of Gᵀ M G and Gᵀ b, see `cranedyn.model.mimics`.

    Args:
        model: A crane's model.
        data: Its scratch memory.
        q: Coordinates, shape (n,).
        v: Their rates, shape (n,).
        given: Given accelerations, and zeros for the unknown ones, shape (n,).
        forces: Generalized forces of damping, dry friction and springs, and the efforts of drives
            whose accelerations are unknown, shape (n,).
        unknown: Indices of the joints whose accelerations are unknown.
        outside: Generalized forces from outside, shape (n,); None for none.
        coupling: Joints that follow others; None if there are none.

    Raises:
        OutOfRange: If such a joint has no inertia, as the swing of a point load on a cable of no
            length, or its inertia is not a number.
    """
    if coupling is not None:
        given = coupling.spread(given)
    if not len(unknown):
        return given.copy()
    unbalanced = inverse_dynamics(model, data, q, v, given, forces, outside, coupling)
    mass = pin.crba(model, data, q)
    if coupling is not None:
        mass = coupling.reduce(mass)
    a = given.copy()
    if len(unknown) == 2:
        # A tower crane's two swings are solved by determinants, which is quicker than NumPy.
        _solve_two(mass, unbalanced, unknown, a)
    else:
        unknown_mass = mass[unknown[:, None], unknown]
        if not (np.isfinite(unknown_mass).all() and np.linalg.eigvalsh(unknown_mass)[0] > 0.0):
            raise _no_inertia(*unknown_mass.diagonal().tolist())
        a[unknown] = -np.linalg.solve(unknown_mass, unbalanced[unknown])
    return a if coupling is None else coupling.spread(a)


def _solve_two(
    mass: np.ndarray, unbalanced: np.ndarray, unknown: np.ndarray, a: np.ndarray
) -> None:
    """Write two unknown accelerations by Cramer's rule, see `solve_accelerations`.

    Args:
        mass: Mass matrix, shape (n, n).
        unbalanced: Generalized forces that are left where the two do not accelerate, shape (n,).
        unknown: Indices of the two joints.
        a: Accelerations, shape (n,), of which those of the two joints are written.

    Raises:
        OutOfRange: If the determinant is not positive.
    """
    # Scalars of Python are several times quicker than arrays with two elements.
    i, j = unknown.tolist()
    m11 = mass.item(i, i)
    m12 = mass.item(i, j)
    m22 = mass.item(j, j)
    force_i = unbalanced.item(i)
    force_j = unbalanced.item(j)
    determinant = m11 * m22 - m12 * m12
    # Written so that a determinant that is NaN is refused, too.
    if not determinant > 0.0:
        raise _no_inertia(m11, m22)
    a[i] = (m12 * force_j - m22 * force_i) / determinant
    a[j] = (m12 * force_i - m11 * force_j) / determinant


def _no_inertia(*inertias: float) -> OutOfRange:
    """Return the error for joints whose inertias [kg m²] are not all positive."""
    values = " and ".join(f"{inertia:g}" for inertia in inertias)
    allowed = "> 0; a load without rotational inertia needs a cable"
    return OutOfRange("inertia against swing", values, allowed, "kg m²")


def inverse_dynamics(
    model: pin.Model,
    data: pin.Data,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    forces: np.ndarray,
    outside: np.ndarray | None = None,
    coupling: Coupling | None = None,
) -> np.ndarray:
    """Return the generalized forces that cause accelerations in addition to forces that act
    already, shape (n,): M a + b - τ - τ_outside.

    Leaders carry the forces of their followers.

    Args:
        model: A crane's model.
        data: Its scratch memory.
        q: Coordinates, shape (n,).
        v: Their rates, shape (n,).
        a: Accelerations, shape (n,).
        forces: Generalized forces that act already, shape (n,).
        outside: Generalized forces from outside, shape (n,); None for none.
        coupling: Joints that follow others; None if there are none.
    """
    needed = pin.rnea(model, data, q, v, a) - forces
    if outside is not None:
        needed = needed - outside
    return needed if coupling is None else coupling.gather(needed)


def outside_effort(
    points: Sequence[Point], model: pin.Model, data: pin.Data, q: np.ndarray, force: np.ndarray
) -> np.ndarray:
    """Return the generalized forces of a force on each of some points, shape (n,).

    A force F on a point with the Jacobian J = ∂ṗ/∂v does the power F·ṗ = F·J v, so that its
    generalized force is Jᵀ F.

    Args:
        points: The points.
        model: A crane's model.
        data: Its scratch memory.
        q: Coordinates, shape (n,).
        force: Forces in the world [N], shape (points, 3).
    """
    pairs = zip(force, _jacobians(points, model, data, q), strict=True)
    return sum(point_force @ jacobian for point_force, jacobian in pairs)


def _jacobians(
    points: Sequence[Point], model: pin.Model, data: pin.Data, q: np.ndarray
) -> list[np.ndarray]:
    """Return the derivative of the velocity of each point in the world by the rates of the
    coordinates, shape (3, n) each.
    """
    pin.computeJointJacobians(model, data, q)
    jacobians = []
    for _, body, lever in points:
        # Joint 0 of Pinocchio is the world. A matrix of one column comes without its second
        # dimension.
        joint_jacobian = pin.getJointJacobian(model, data, body + 1, pin.LOCAL_WORLD_ALIGNED)
        joint_jacobian = joint_jacobian.reshape(6, model.nv)
        linear = joint_jacobian[:3]
        angular = joint_jacobian[3:]
        # A point at r from the origin of the joint has the velocity v + ω × r = v - r × ω.
        arm = pin.skew(data.oMi[body + 1].rotation @ lever)
        jacobians.append(linear - arm @ angular)
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
        points: Points in its frame [m], shape (points, 3).
        q: Coordinates, shape (n,).
        v: Their rates, shape (n,).
    """
    pin.forwardKinematics(model, data, q, v)
    placement = data.oMi[body + 1]
    motion = data.v[body + 1]
    # Pinocchio's velocity of a joint is in the frame of the joint, as the points are.
    velocity = motion.linear[:, None] + pin.skew(motion.angular) @ points.T
    position = placement.rotation @ points.T + placement.translation[:, None]
    return position, placement.rotation @ velocity


def energy(crane: Crane, state: State) -> float:
    """Return the mechanical energy, including that of springs [J]; potential energy is zero at the
    height of the origin of the world.
    """
    rigid = float(pin.computeMechanicalEnergy(crane.model, crane.data, state.q, state.v))
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
    trolley; the hook where no swing carries the payload; the payload itself where a crane has no
    other point.
    """
    positions = point_positions(crane, q)
    return positions[1] if len(positions) > 1 else positions[0]


def natural_frequencies(crane: Crane, q: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Return the frequencies ω of small motions of some joints about a rest with all others locked.

    They solve K x = ω² M x, with the second derivatives K of the energy of gravity and springs and
    the mass matrix M, both of these joints alone.

    Args:
        crane: The crane.
        q: Coordinates at rest, shape (n,).
        joints: Indices of the joints.

    Returns:
        Frequencies [rad/s], increasing; 0 where nothing restores a motion.
    """
    block = np.ix_(joints, joints)
    stiffness = rest_stiffness(crane.model, crane.data, crane.springs, q, crane.coupling)[block]
    squares = scipy.linalg.eigvalsh(stiffness, crane.mass_matrix(q)[block])
    return np.sqrt(np.maximum(squares, 0.0))


def payload_orientation(crane: Crane, q: np.ndarray) -> np.ndarray:
    """Return the orientation of the payload in the world, a unit quaternion x, y, z, w, shape
    (4,).
    """
    pin.forwardKinematics(crane.model, crane.data, q)
    return pin.Quaternion(crane.data.oMi[crane.payload.body + 1].rotation).coeffs()


def holding_effort(crane: Crane, q: np.ndarray) -> np.ndarray:
    """Return the drive efforts that balance gravity and springs in the joints of the drives [N m or
    N], shape (m,). Where the load does not hang at rest, its passive joints stay unbalanced.
    """
    forces = pin.computeGeneralizedGravity(crane.model, crane.data, q)
    if crane.springs.any:
        forces = forces - crane.springs.effort(q)
    if crane.coupling is not None:
        forces = crane.coupling.gather(forces)
    return forces[crane.layout.drives]


def linearise(crane: Crane, state: State, effort: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives of the accelerations of all joints, with damping and springs.

    Dry friction is left out, see `JointForces.tangent`.

    Args:
        crane: The crane.
        state: Where it is linearised.
        effort: Efforts of the drives there [N m or N], shape (m,).

    Returns:
        A, shape (n, 2 n): by coordinates, then rates; B, shape (n, m): by efforts of the drives.
    """
    by_state, inverse_mass = by_state_and_force(crane, state, effort)
    return by_state, inverse_mass[:, crane.layout.drives]


def by_state_and_force(
    crane: Crane, state: State, effort: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return A as `linearise`, and the inverse of the mass matrix, shape (n, n), in place of B.

    The accelerations are in `crane.data.ddq` afterwards, unless a taut inextensible rope holds its
    stretch.

    Pinocchio differentiates ABA for a fixed τ (Carpentier and Mansard, Analytical derivatives of
    rigid body dynamics algorithms, RSS 2018). The forces of joints depend on the state as well,
    ∂τ/∂q = -K and ∂τ/∂v = -D, and add -M⁻¹ K and -M⁻¹ D.
    """
    joint_forces = JointForces.of(crane)
    rope = crane.springs.rope
    if rope is not None and _holds_stretch(joint_forces, state):
        return _by_state_and_force_when_taut(crane, state, effort, rope.stretch)
    if crane.coupling is not None:
        return _by_state_and_force_when_coupled(crane, crane.coupling, state, effort)
    tau = over_all_joints(crane, effort) + joint_forces.effort(state.q, state.v)
    by_q, by_v, inverse_mass = pin.computeABADerivatives(
        crane.model, crane.data, state.q, state.v, tau
    )
    stiffness, damping = joint_forces.tangent(state.q, state.v)
    if crane.springs.any:
        by_q = by_q - inverse_mass @ stiffness
    by_state = np.concatenate([by_q, by_v - inverse_mass * damping], axis=1)
    # Pinocchio returns a view of its scratch memory.
    return by_state, inverse_mass.copy()


def _by_state_and_force_when_coupled(
    crane: Crane, coupling: Coupling, state: State, effort: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return `by_state_and_force` where joints follow others.

    From the derivatives of the inverse dynamics, with a = G a and the reduced mass matrix
    R = Gᵀ M G,

        R da = Gᵀ (dτ - ∂(M a + b)/∂q G dq - ∂(M a + b)/∂v G dv).

    A follower has no motion of its own, so that its columns are zero.
    """
    joint_forces = JointForces.of(crane)
    spread = coupling.matrix
    a = acceleration(crane, state, effort)
    pin.computeRNEADerivatives(crane.model, crane.data, state.q, state.v, a)
    stiffness, damping = joint_forces.tangent(state.q, state.v)
    by_q = (crane.data.dtau_dq + stiffness) @ spread
    by_v = (crane.data.dtau_dv + np.diag(damping)) @ spread
    inverse_mass = spread @ np.linalg.inv(crane.mass_matrix(state.q)) @ spread.T
    crane.data.ddq = a
    return -inverse_mass @ np.hstack([by_q, by_v]), inverse_mass


def _by_state_and_force_when_taut(
    crane: Crane, state: State, effort: np.ndarray, stretch: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return `by_state_and_force` where an inextensible rope is taut.

    The rope holds its stretch, so that rows and columns of the stretch are zero. For the free
    joints f the derivatives of the inverse dynamics give

        M_ff da_f = dτ_f - (∂(M a + b)/∂q + K)_f dq - (∂(M a + b)/∂v + D)_f dv.

    Args:
        crane: A crane with an inextensible rope.
        state: A state in which the rope is taut.
        effort: Efforts of the drives [N m or N], shape (m,).
        stretch: Index of the stretch of the rope among the coordinates.
    """
    n = crane.layout.n
    data = crane.data
    q = state.q
    v = state.v
    joint_forces = JointForces.of(crane)
    free = crane.springs.free(np.arange(n))
    tau = over_all_joints(crane, effort) + joint_forces.effort(q, v)
    a = solve_accelerations(crane.model, data, q, v, np.zeros(n), tau, free)
    pin.computeRNEADerivatives(crane.model, data, q, v, a)
    mass = data.M  # which the derivatives of the inverse dynamics contain
    stiffness, damping = joint_forces.tangent(q, v)
    resisting = np.hstack([data.dtau_dq + stiffness, data.dtau_dv + np.diag(damping)])
    inverse_mass = np.zeros((n, n))
    inverse_mass[np.ix_(free, free)] = np.linalg.inv(mass[np.ix_(free, free)])
    by_state = -inverse_mass @ resisting
    by_state[:, [stretch, n + stretch]] = 0.0
    return by_state, inverse_mass
