"""Drives: how commands become forces at the joints.

Drives exert an effort, follow an acceleration, or follow a rate as frequency converters do. Each
kind has the same methods: `take_command` at a control instant, `begin_step` before each physics
step, and `acceleration` and `effort` at a state under the last command.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from cranedyn.dynamics.converters import Converters, DrivenMotion, saturate_acceleration
from cranedyn.dynamics.equations_of_motion import (
    inverse_dynamics,
    outside_effort,
    solve_accelerations,
)
from cranedyn.dynamics.joint_forces import JointForces, Stops
from cranedyn.dynamics.root_motion import RootForces
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane


def cable_buffers(crane: Crane, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the force of the buffers at the ends of the cable, with the sign of the hoist's [N].

    At the longest cable it is negative: the buffer carries part of the load. At the shortest cable
    the hook block meets the trolley, which pushes it down.

    Args:
        crane: The crane; the force is zero without a hoist.
        q: Coordinates, shape (rows, n).
        v: Their rates, shape (rows, n).

    Returns:
        Forces, shape (rows,).
    """
    hoist = crane.layout.drive_of("hoist")
    if hoist is None:
        return np.zeros(len(q))
    stops = Stops.of(crane)
    joint = stops.drives[hoist]
    return stops.effort_of(hoist, q[:, joint], v[:, joint])


class ExternalForces:
    """Forces on the points of the crane, buffers at the ends of the ranges of the drives, and what
    the crane feels of a base that moves.

    Attributes:
        force: Forces on the points, in the axes of the frame in which the crane stands [N], shape
            (points, 3).
        stops: The buffers; None for none.
        stop_effort: Efforts of the buffers when they were last computed [N m or N], shape (m,).
        root: Forces from the motion of the base; None for a crane that stands in the world.
    """

    def __init__(self, crane: Crane, *, buffers: bool, moving_base: bool = False) -> None:
        self.force = np.zeros((len(crane.points), 3))
        self.stops = Stops.of(crane) if buffers else None
        self.root = RootForces(crane.model) if moving_base else None
        self.stop_effort = np.zeros(crane.layout.m)
        self._points = crane.points
        self._drives = crane.layout.drives
        self._model = crane.model
        self._data = crane.model.createData()

    def effort(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return generalized forces [N m or N], shape (n,)."""
        if self.force.any():
            effort = outside_effort(self._points, self._model, self._data, q, self.force)
        else:
            effort = np.zeros(len(v))
        if self.stops is not None:
            self.stop_effort = self.stops.effort(q, v)
            effort[self._drives] += self.stop_effort
        if self.root is not None:
            effort += self.root.effort(q, v)
        return effort


class _Drives:
    """Model, joint forces and external forces of a crane, which all kinds of drives need.

    Attributes:
        model: Pinocchio's model of the crane.
        external: External forces; None for none.
        saturated: Whether the last command was beyond the largest rate of a frequency converter.
        free: Indices of the joints whose accelerations follow from forces: all independent joints
            of drives that exert efforts, the passive ones of others. A simulation of a taut
            inextensible rope replaces this array by one without the stretch, see `Springs.free`.
    """

    saturated = False

    def __init__(self, crane: Crane, external: ExternalForces | None, free: np.ndarray) -> None:
        self.model = crane.model
        self.external = external
        self.free = free
        self._data = crane.model.createData()
        self._layout = crane.layout
        self._joint_forces = JointForces.of(crane)
        self._coupling = crane.coupling

    def begin_step(self, v: np.ndarray) -> None:
        """Prepare for a physics step from rates v, shape (n,)."""

    def take_command(self, command: np.ndarray, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Take a command of the drives for the time until the next one.

        Args:
            command: Efforts [N m or N], accelerations [rad/s² or m/s²] or rates [rad/s or m/s], as
                the kind of drives takes them, shape (m,).
            state: The state of the crane.

        Returns:
            The effort needed and the effort exerted [N m or N], shape (m,) each.
        """
        raise NotImplementedError

    def acceleration(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return accelerations of all joints, shape (n,)."""
        raise NotImplementedError

    def joint_and_external_forces(
        self, q: np.ndarray, v: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Return generalized forces on all joints, shape (n,) each: those of damping, dry friction
        and springs, and those from outside (None for none).
        """
        external = None if self.external is None else self.external.effort(q, v)
        return self._joint_forces.effort(q, v), external


class EffortDrives(_Drives):
    """Drives that exert the effort commanded, within their limits.

    Attributes:
        convention: Frame in which Pinocchio's algorithm computes. That of the world is faster,
            those of the joints lose fewer digits.
    """

    convention = pin.Convention.WORLD

    def __init__(self, crane: Crane, external: ExternalForces | None) -> None:
        super().__init__(crane, external, crane.layout.independent)
        self._all_joints = self.free
        self._lowest = -crane.effort_limit
        self._highest = crane.effort_limit
        self._effort = np.zeros(crane.layout.m)
        self._tau = np.zeros(crane.layout.n)
        self._damping = self._joint_forces.damping
        self._viscous_only = self._joint_forces.viscous_only

    def take_command(self, command: np.ndarray, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Hold efforts until the next command."""
        self._effort = np.minimum(np.maximum(command, self._lowest), self._highest)
        self._tau[self._layout.drives] = self._effort
        return command, self._effort

    def effort(self, state: State) -> np.ndarray:
        """Return the effort exerted at a state [N m or N], shape (m,)."""
        return self._effort

    def acceleration(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return accelerations of all joints, shape (n,)."""
        # Most cranes have viscous damping only, for which this takes the least time.
        if self._viscous_only:
            tau = self._tau - self._damping * v
        else:
            tau = self._tau + self._joint_forces.effort(q, v)
        if self.external is not None:
            tau += self.external.effort(q, v)
        # ABA moves all joints: it cannot hold the stretch of a taut rope, for which `free` has been
        # replaced, nor let joints follow others.
        if self.free is self._all_joints and self._coupling is None:
            return pin.aba(self.model, self._data, q, v, tau, self.convention)
        return solve_accelerations(
            self.model,
            self._data,
            q,
            v,
            given=np.zeros(len(v)),
            forces=tau,
            unknown=self.free,
            coupling=self._coupling,
        )


class MotionDrives(_Drives):
    """Drives that accelerate as commanded, at whatever effort that takes."""

    def __init__(self, crane: Crane, external: ExternalForces | None) -> None:
        super().__init__(crane, external, crane.layout.passive)
        self._command = np.zeros(crane.layout.n)

    def take_command(self, command: np.ndarray, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Hold accelerations until the next command; the effort needed is exerted.

        Raises:
            OutOfRange: If that effort is not finite.
        """
        self._command[self._layout.drives] = command
        effort = self.effort(state)
        if not np.isfinite(effort).all():
            units = ", ".join(joint.effort_unit for joint in self._layout.driven)
            name = "effort that the motion costs"
            raise OutOfRange(name, effort.tolist(), "finite numbers", units)
        return effort, effort

    def effort(self, state: State) -> np.ndarray:
        """Return the effort exerted at a state [N m or N], shape (m,)."""
        q = state.q
        v = state.v
        forces, external = self.joint_and_external_forces(q, v)
        model = self.model
        data = self._data
        coupling = self._coupling
        a = solve_accelerations(
            model, data, q, v, self._command, forces, self.free, external, coupling
        )
        effort = inverse_dynamics(model, data, q, v, a, forces, external, coupling)
        return effort[self._layout.drives]

    def acceleration(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return accelerations of all joints, shape (n,)."""
        forces, external = self.joint_and_external_forces(q, v)
        model = self.model
        data = self._data
        coupling = self._coupling
        return solve_accelerations(
            model, data, q, v, self._command, forces, self.free, external, coupling
        )


class VelocityDrives(_Drives):
    """Drives with frequency converters, see `cranedyn.dynamics.converters`.

    Args:
        crane: The crane.
        external: External forces; None for none.
        converters: The converters.
        dt: Physics step [s].
        delay_steps: Number of control periods by which commands are late.
    """

    def __init__(
        self,
        crane: Crane,
        external: ExternalForces | None,
        converters: Converters,
        dt: float,
        delay_steps: int,
    ) -> None:
        super().__init__(crane, external, crane.layout.passive)
        self._dt = dt
        self._delay_steps = delay_steps
        self._response = converters.response
        self._limit = crane.effort_limit
        self.reset(crane.start)

    def reset(self, state: State) -> None:
        """Hold the rates of a state until the delay of the first command has passed."""
        rate = state.v[self._layout.drives]
        self.recall(rate, np.zeros_like(rate), np.tile(rate, (self._delay_steps, 1)))

    def recall(self, reference: np.ndarray, slope: np.ndarray, queue: np.ndarray) -> None:
        """Set the memory of the converters.

        Args:
            reference: Reference rates [rad/s or m/s], shape (m,).
            slope: Their rates of change [rad/s² or m/s²], shape (m,).
            queue: Commands whose delay has not passed yet, the oldest first, shape (delay_steps,
                m).
        """
        self._reference = reference.copy()
        self._slope = slope.copy()
        self._queue = [*queue]
        # Until the next command is taken, which is before the next physics step.
        self._followed = self._reference

    def take_command(self, command: np.ndarray, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Queue rates until their delay has passed, and follow those whose delay has.

        The efforts returned are those of the next physics step, whose reference rates follow from
        the command.
        """
        rates = command.tolist()
        self.saturated = any(self._response.saturates(rates))
        queue = [*self._queue, np.array(self._response.quantize_commands(rates))]
        self._followed = queue[0]
        self._queue = queue[1:]
        reference, _ = self._ramp(state.v)
        motion = self._driven(state.q, state.v, reference)
        return motion.needed, motion.effort

    def begin_step(self, v: np.ndarray) -> None:
        """Move the ramps on by a physics step from rates v, shape (n,)."""
        self._reference, self._slope = self._ramp(v)

    def effort(self, state: State) -> np.ndarray:
        """Return the effort exerted at a state [N m or N], shape (m,)."""
        return self._driven(state.q, state.v, self._reference).effort

    def acceleration(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return accelerations of all joints, shape (n,)."""
        return self._driven(q, v, self._reference).acceleration

    def _ramp(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return reference rates after a physics step and their slopes, shape (m,) each."""
        # Lists of floats are several times quicker than elements of arrays.
        reference, slope = self._response.ramped(
            self._followed.tolist(),
            self._reference.tolist(),
            self._slope.tolist(),
            v[self._layout.drives].tolist(),
            self._dt,
        )
        return np.array(reference), np.array(slope)

    def _driven(self, q: np.ndarray, v: np.ndarray, reference: np.ndarray) -> DrivenMotion:
        """Return the motion of all joints under reference rates of the drives, shape (m,).

        The accelerations that the speed control asks for are tried first. Where they take more
        effort than a drive has, see `saturate_acceleration`, which needs the mass matrix.
        """
        drives = self._layout.drives
        model = self.model
        data = self._data
        coupling = self._coupling
        target = np.zeros(len(v))
        target[drives] = self._response.accelerations_at(reference, v[drives].tolist())
        forces, external = self.joint_and_external_forces(q, v)
        a = solve_accelerations(model, data, q, v, target, forces, self.free, external, coupling)
        needed = inverse_dynamics(model, data, q, v, a, forces, external, coupling)[drives]
        # Written so that an effort that is NaN takes the second way.
        if (np.abs(needed) <= self._limit).all():
            return DrivenMotion(a, needed, needed)

        mass = pin.crba(model, data, q)
        if coupling is not None:
            mass = coupling.reduce(mass)
        without_motion = np.zeros(len(v))
        bias = inverse_dynamics(model, data, q, v, without_motion, forces, external, coupling)
        limited = saturate_acceleration(mass, bias, target[drives], self._limit, drives, self.free)
        if coupling is None:
            return limited
        return limited._replace(acceleration=coupling.spread(limited.acceleration))


Drives = EffortDrives | MotionDrives | VelocityDrives
