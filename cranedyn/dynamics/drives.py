"""How a command acts on the crane: drives that exert an effort, drives that follow a motion, and
drives with frequency converters. Inside, time is counted in steps.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from cranedyn.dynamics.converters import Converters, held_back
from cranedyn.dynamics.integrators import Acceleration, in_steps
from cranedyn.dynamics.joint_forces import JointForces, Stops
from cranedyn.dynamics.pinocchio import follow_drives, inverse_dynamics, outside_effort
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane


def cable_buffers(crane: Crane, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """What the buffers at the ends of the cable push, with the sign of the hoist's force [N], in
    rows, shape (rows,).

    At the longest cable that is negative, what the buffer takes of the load. At the shortest the
    hook block meets the trolley, which pushes it down.

    Args:
        crane: The crane; without a hoist there are none.
        q: Coordinates, shape (rows, n).
        v: Their rates, shape (rows, n).
    """
    hoist = crane.layout.drive_of("hoist")
    if hoist is None:
        return np.zeros(len(q))
    stops = Stops.of(crane)
    return stops.one(hoist, q[:, stops.drives[hoist]], v[:, stops.drives[hoist]])


class Outside:
    """What acts on the joints from outside: forces on the points of the crane, and buffers at the
    ends of the ranges of the drives.

    Attributes:
        force: On the points of the crane in the world [N], shape (points, 3).
        buffer_work: Work done on the crane by the buffers so far [J].
    """

    def __init__(self, crane: Crane, dt: float, *, buffers: bool) -> None:
        self.force = np.zeros((len(crane.points), 3))
        self._work = 0.0
        self._points, self._drives = crane.points, crane.layout.drives
        self._model, self._data, self._dt = crane.model, crane.model.createData(), dt
        self._stops = Stops.of(crane) if buffers else None
        self._scaled = None if self._stops is None else self._stops.in_steps(dt)
        self._stop_effort, self._u = np.zeros(crane.layout.m), np.zeros(crane.layout.m)
        self._hoist = crane.layout.drive_of("hoist")

    def __call__(self, q: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Generalized forces, shape (n,)."""
        self._book(u)
        effort = outside_effort(self._points, self._model, self._data, q, self._dt**2 * self.force)
        if self._scaled is not None:
            self._stop_effort = self._scaled.effort(q, u)
            effort[self._drives] += self._stop_effort
        return effort

    def stop_force(self, state: State) -> float:
        """What the buffers at the ends of the cable push [N], see `cable_buffers`."""
        if self._stops is None or self._hoist is None:
            return 0.0
        return float(self._stops.effort(*state)[self._hoist])

    def buffer_work(self, state: State) -> float:
        """Work done on the crane by the buffers up to this state [J]."""
        self._book(self._dt * state.v)
        return self._work / self._dt**2

    def _book(self, u: np.ndarray) -> None:
        """Add the last step's work: its force times the mean of the velocities before and after
        it.
        """
        if self._stop_effort.any():
            self._work += float(self._stop_effort @ (self._u + u[self._drives])) / 2.0
            self._stop_effort = np.zeros(len(self._drives))
        self._u = u[self._drives]


class Limits:
    """The largest efforts of a crane's drives."""

    def __init__(self, crane: Crane) -> None:
        self._most = crane.effort_limit
        self._plain = crane.effort_limit.tolist()

    def cut(self, command: np.ndarray) -> np.ndarray:
        """A command within the limits, shape (m,)."""
        for drive, effort in enumerate(command.tolist()):
            if not abs(effort) <= self._plain[drive]:
                return command.clip(-self._most, self._most)
        return command


class EffortDrives:
    """Drives that exert the effort commanded, within their limits."""

    def __init__(self, crane: Crane, dt: float, outside: Outside | None) -> None:
        self.model = in_steps(crane.model, dt)
        self._limits = Limits(crane)
        self._dt2, self._drives = dt * dt, crane.layout.drives.tolist()
        self._effort = np.zeros(crane.layout.m)
        self._driving, self._tau = [0.0] * crane.layout.n, np.zeros(crane.layout.n)
        self._joint, self._outside = JointForces.of(crane).in_steps(dt), outside
        self.acceleration = self._with_joint_forces()

    def __getstate__(self) -> dict[str, Any]:
        """Return all but the function of this memory, for a copy that has memory of its own."""
        return {name: value for name, value in vars(self).items() if name != "acceleration"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take what a copy has, and make the function of its memory."""
        vars(self).update(state)
        self.acceleration = self._with_joint_forces()

    def _with_joint_forces(self) -> Acceleration:
        joint, outside = self._joint, self._outside
        aba, model, data, world = pin.aba, self.model, self.model.createData(), pin.Convention.WORLD
        driving, tau = self._driving, self._tau
        if outside is not None:
            return lambda q, u: aba(
                model, data, q, u, tau + joint.effort(q, u) + outside(q, u), world
            )
        if joint.springs is not None:
            return lambda q, u: aba(model, data, q, u, tau + joint.effort(q, u), world)
        dampers = [(i, damping) for i, damping in enumerate(joint.damping.tolist()) if damping]

        def damped(q: np.ndarray, u: np.ndarray) -> np.ndarray:
            # one by one: quicker than NumPy for the few joints that have a damper
            for i, damping in dampers:
                tau[i] = driving[i] - damping * u.item(i)
            return aba(model, data, q, u, tau, world)

        return damped

    def take(self, command: np.ndarray, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Take a command until the next one; returns the effort asked for and the effort that acts,
        shape (m,) each.
        """
        self._effort = self._limits.cut(command)
        for drive, effort in enumerate(self._effort.tolist()):
            joint = self._drives[drive]
            self._driving[joint] = self._tau[joint] = self._dt2 * effort
        return command, self._effort

    def effort(self, state: State) -> np.ndarray:
        """What acts at a state under the last command, shape (m,)."""
        return self._effort


class MotionDrives:
    """Drives that accelerate as commanded, whatever effort it costs."""

    def __init__(self, crane: Crane, dt: float, outside: Outside | None) -> None:
        self.model = in_steps(crane.model, dt)
        self._data = self.model.createData()
        self._joint = JointForces.of(crane).in_steps(dt)
        self._layout = crane.layout
        self._dt = dt
        self._command = np.zeros(crane.layout.n)
        self._outside = outside

    def take(self, command: np.ndarray, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Take a command until the next one; returns the effort that it costs at this state, twice,
        shape (m,) each.

        Raises:
            OutOfRange: If that is not finite.
        """
        self._command[self._layout.drives] = self._dt**2 * command
        effort = self.effort(state)
        if not np.isfinite(effort).all():
            units = ", ".join(joint.effort_unit for joint in self._layout.driven)
            raise OutOfRange(
                "effort that the motion costs", effort.tolist(), "finite numbers", units
            )
        return effort, effort

    def effort(self, state: State) -> np.ndarray:
        """What acts at a state under the last command, shape (m,)."""
        u = self._dt * state.v
        joint, outside = self._forces(state.q, u)
        a = follow_drives(
            self.model, self._data, state.q, u, self._command, joint, self._layout.passive, outside
        )
        needed = inverse_dynamics(self.model, self._data, state.q, u, a, joint, outside)
        return needed[self._layout.drives] / self._dt**2

    def acceleration(self, q: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Of all joints, shape (n,)."""
        joint, outside = self._forces(q, u)
        return follow_drives(
            self.model, self._data, q, u, self._command, joint, self._layout.passive, outside
        )

    def _forces(self, q: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Generalized forces of damping and springs, and from outside."""
        return self._joint.effort(q, u), None if self._outside is None else self._outside(q, u)


class VelocityDrives:
    """Drives with frequency converters, see `cranedyn.dynamics.converters`.

    Attributes:
        cut: Whether the last command was beyond the largest rate of a drive.
    """

    def __init__(
        self, crane: Crane, dt: float, outside: Outside | None, made: Converters, late: int
    ) -> None:
        self.model, self.cut, self._late = in_steps(crane.model, dt), False, late
        self._data, self._layout, self._dt = self.model.createData(), crane.layout, dt
        self._joint, self._outside = JointForces.of(crane).in_steps(dt), outside
        self._response, self._limits = made.response, dt * dt * crane.effort_limit
        self.begin(crane.start)

    def begin(self, state: State) -> None:
        """Go on as the drives do at a state until the first command is heard."""
        rate = state.v[self._layout.drives]
        self.remember(rate, np.zeros_like(rate), np.tile(rate, (self._late, 1)))

    def remember(self, reference: np.ndarray, rising: np.ndarray, unheard: np.ndarray) -> None:
        """Have reference rates that change at a rate, shape (m,) each, and commands that are not
        yet heard, shape (late, m).
        """
        self._reference, self._rising, self._unheard = reference.copy(), rising.copy(), [*unheard]
        self._heard = self._reference

    def take(self, command: np.ndarray, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Take commanded rates until the next ones; returns the efforts that the drives would need
        from here on, and those that they exert, shape (m,) each.
        """
        self.cut = any(self._response.cuts(command.tolist()))
        waiting = [*self._unheard, np.array(self._response.heard(command.tolist()))]
        self._heard, self._unheard = waiting[0], waiting[1:]
        u = self._dt * state.v
        _, effort, needed = self._driven(state.q, u, self._ramped(u)[0])
        return needed / self._dt**2, effort / self._dt**2

    def step(self, u: np.ndarray) -> None:
        """Let the ramps go on by a step in which drives move at rates u, in steps."""
        self._reference, self._rising = self._ramped(u)

    def _ramped(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rate = (u[self._layout.drives] / self._dt).tolist()
        before = self._reference.tolist(), self._rising.tolist()
        reference, rising = self._response.ramped(self._heard.tolist(), *before, rate, self._dt)
        return np.array(reference), np.array(rising)

    def effort(self, state: State) -> np.ndarray:
        """What acted until a state, shape (m,)."""
        return self._driven(state.q, self._dt * state.v, self._reference)[1] / self._dt**2

    def acceleration(self, q: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Of all joints, shape (n,)."""
        return self._driven(q, u, self._reference)[0]

    def _driven(
        self, q: np.ndarray, u: np.ndarray, reference: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Accelerations of all joints, shape (n,), efforts of the drives and those that they would
        need, shape (m,) each.
        """
        drives, dt = self._layout.drives, self._dt
        wanted = np.zeros(len(u))
        wanted[drives] = [
            dt * dt * a
            for a in self._response.accelerations_at(reference, (u[drives] / dt).tolist())
        ]
        joint = self._joint.effort(q, u)
        outside = None if self._outside is None else self._outside(q, u)
        given = self.model, self._data, q, u
        a = follow_drives(*given, wanted, joint, self._layout.passive, outside)
        needed = inverse_dynamics(*given, a, joint, outside)[drives]
        if (np.abs(needed) <= self._limits).all():
            return a, needed, needed
        mass = pin.crba(self.model, self._data, q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        resisting = inverse_dynamics(*given, np.zeros(len(u)), joint, outside)
        return held_back(mass, resisting, wanted[drives], self._limits, self._layout)
