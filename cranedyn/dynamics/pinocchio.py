"""How the crane moves: functions of a crane and a state, by Pinocchio's algorithms.

Efforts are those of the three drives: slew torque [N m], trolley force [N], hoist force [N] (negative holds the load).
Positions are in the world frame [m]: origin on the ground at the slew axis, Z up, jib along -Y at zero slew.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from cranedyn.errors import OutOfRange
from cranedyn.interfaces import State
from cranedyn.model.crane import DRIVES, Crane


def full(effort: np.ndarray) -> np.ndarray:
    """Drive efforts, shape (3,), among all five generalized forces, shape (5,): the passive joints get none."""
    tau = np.zeros(5)
    tau[DRIVES] = effort
    return tau


def acceleration(crane: Crane, state: State, effort: np.ndarray) -> np.ndarray:
    """Accelerations of all five joints [rad/s² or m/s²], shape (5,), under drive efforts: articulated-body algorithm with damping."""
    return pin.aba(crane.model, crane.data, *state, full(effort) - crane.damping * state.v)


def prescribed_acceleration(crane: Crane, state: State, drive_acceleration: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Accelerations of all five joints when those of the drives are given, and the drive efforts that this costs.

    Solves the passive rows of M a + b + d v = τ for the swing, then reads the drive rows.

    Args:
        crane: The crane.
        state: Where it is.
        drive_acceleration: Of slew [rad/s²], trolley and hoist [m/s²], shape (3,).

    Returns:
        Accelerations, shape (5,), and efforts [N m, N, N], shape (3,).
    """
    a = follow_drives(crane.model, crane.data, *state, full(drive_acceleration), crane.damping)
    return a, inverse_dynamics(crane.model, crane.data, *state, a, crane.damping)


def follow_drives(
    model: pin.Model, data: pin.Data, q: np.ndarray, v: np.ndarray, a: np.ndarray, damping: np.ndarray, outside: np.ndarray | None = None
) -> np.ndarray:
    """All five accelerations, shape (5,), when `a` holds those of the drives and zeros for the swing; for any unit of time.

    The passive rows of M a + b + d v = outside are two equations in the two swing accelerations.

    Raises:
        OutOfRange: If the swing has no inertia, as a point load on a cable of no length, or it is no number.
    """
    resisting = pin.rnea(model, data, q, v, a) + damping * v
    open_phi, open_theta = (resisting if outside is None else resisting - outside)[2:4].tolist()
    (m11, m12), (_, m22) = pin.crba(model, data, q)[2:4, 2:4].tolist()
    determinant = m11 * m22 - m12 * m12
    if not determinant > 0.0:
        raise OutOfRange("inertia against swing", f"{m11:g} and {m22:g}", "> 0; a load without rotational inertia needs a cable", "kg m²")
    solved = a.copy()
    solved[2:4] = (m12 * open_theta - m22 * open_phi) / determinant, (m12 * open_phi - m11 * open_theta) / determinant
    return solved


def inverse_dynamics(
    model: pin.Model, data: pin.Data, q: np.ndarray, v: np.ndarray, a: np.ndarray, damping: np.ndarray, outside: np.ndarray | None = None
) -> np.ndarray:
    """Drive efforts that cause these accelerations against damping, with generalized forces from outside; shape (3,); any unit of time."""
    needed = pin.rnea(model, data, q, v, a) + damping * v
    return (needed if outside is None else needed - outside)[DRIVES]


def outside_effort(model: pin.Model, data: pin.Data, q: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Generalized forces of a force on the centre of the payload and one on the trolley at the swing pivot, shape (5,).

    Args:
        model: A crane's model.
        data: Its scratch memory.
        q: Coordinates, shape (5,).
        force: In the world [N], shape (2, 3): on the payload, on the trolley.
    """
    load, pivot = _jacobians(model, data, q)
    return force[0] @ load + force[1] @ pivot


def _jacobians(model: pin.Model, data: pin.Data, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Velocity in the world per rate of the coordinates, of the centre of the payload and of the swing pivot, shape (3, 5) each."""
    pin.computeJointJacobians(model, data, q)
    load, pivot = (pin.getJointJacobian(model, data, i, pin.LOCAL_WORLD_ALIGNED) for i in (5, 3))
    arm = data.oMi[5].rotation @ model.inertias[5].lever
    return load[:3] + np.cross(load[3:].T, arm).T, pivot[:3]


def energy(crane: Crane, state: State) -> float:
    """Mechanical energy [J], zero of height at the ground."""
    return float(pin.computeMechanicalEnergy(crane.model, crane.data, *state))


def payload_position(crane: Crane, q: np.ndarray) -> np.ndarray:
    """Centre of the payload in the world [m], shape (3,)."""
    pin.forwardKinematics(crane.model, crane.data, q)
    return crane.data.oMi[5].act(crane.model.inertias[5].lever)


def pivot_position(crane: Crane, q: np.ndarray) -> np.ndarray:
    """Swing pivot at the trolley in the world [m], shape (3,)."""
    pin.forwardKinematics(crane.model, crane.data, q)
    return crane.data.oMi[3].translation.copy()


def payload_velocity(crane: Crane, state: State) -> np.ndarray:
    """Velocity of the centre of the payload in the world [m/s], shape (3,)."""
    return _jacobians(crane.model, crane.data, state.q)[0] @ state.v


def pivot_velocity(crane: Crane, state: State) -> np.ndarray:
    """Velocity of the swing pivot at the trolley in the world [m/s], shape (3,)."""
    return _jacobians(crane.model, crane.data, state.q)[1] @ state.v


def rope_tension(crane: Crane, state: State, effort: np.ndarray) -> float:
    """Tension of the rope [N]; at zero or below a real rope would be slack.

    The hoist joint lies along the rope, so its generalized force is the force along the rope: the drive's, less damping.
    """
    return float(crane.damping[4] * state.v[4] - effort[2])


def holding_effort(crane: Crane, q: np.ndarray) -> np.ndarray:
    """Drive efforts that balance gravity at rest [N m, N, N], shape (3,); with swing, what they balance of it."""
    return pin.computeGeneralizedGravity(crane.model, crane.data, q)[DRIVES]


def linearise(crane: Crane, state: State, effort: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of the accelerations, with damping.

    Returns:
        A, shape (5, 10): by coordinates then rates; B, shape (5, 3): by drive efforts.
    """
    tau = full(effort) - crane.damping * state.v
    by_q, by_v, inverse_mass = pin.computeABADerivatives(crane.model, crane.data, *state, tau)
    inverse_mass = np.triu(inverse_mass) + np.triu(inverse_mass, 1).T
    return np.hstack([by_q, by_v - inverse_mass * crane.damping]), inverse_mass[:, DRIVES]
