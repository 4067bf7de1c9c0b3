"""How a command acts on the crane: drives that push with an effort, and drives that follow a motion. Inside, time is counted in steps."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from cranedyn.dynamics.integrators import Acceleration, in_steps
from cranedyn.dynamics.pinocchio import follow_drives, inverse_dynamics, outside_effort
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import State
from cranedyn.model.crane import DRIVES, Crane

_STOP_FREQUENCY, _STOP_DAMPING = 20.0, 0.5


def buffer_numbers(crane: Crane) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and damping of the buffers of slew, trolley and hoist [N m/rad, N/m, N/m; per second], shape (3,) each.

    They make each drive, with what hangs on it, swing at 20 rad/s with half of critical damping.
    """
    inertia = np.diag(pin.crba(crane.model, crane.data, crane.start.q))[DRIVES]
    return _STOP_FREQUENCY**2 * inertia, 2.0 * _STOP_DAMPING * _STOP_FREQUENCY * inertia


def stop_effort(beyond: np.ndarray, rate: np.ndarray, stiffness: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """What springs with dampers that can push but not pull exert, by how far drives are beyond their ranges and by their rates."""
    effort_of_stop = -stiffness * beyond - damping * rate
    return np.where(effort_of_stop * beyond < 0.0, effort_of_stop, 0.0)


def cable_buffers(crane: Crane, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """What the buffers at the ends of the cable push [N] at coordinates and rates in rows, shape (n, 5) each; see `Outside.held`."""
    stiffness, damping = buffer_numbers(crane)
    beyond = q[:, 4] - np.clip(q[:, 4], crane.lower[4], crane.upper[4])
    return stop_effort(beyond, v[:, 4], stiffness[2], damping[2])


class Outside:
    """What acts on the joints besides drives, gravity and damping: a force on payload and trolley, and buffers at the ends of the ranges.

    A buffer is a spring with a damper that can push but not pull, see `buffer_numbers`.

    Attributes:
        force: On payload and trolley in the world [N], shape (2, 3).
        buffer_work: Work done on the crane by the buffers so far [J].
    """

    def __init__(self, crane: Crane, dt: float, *, buffers: bool) -> None:
        self.force = np.zeros((2, 3))
        self._work = 0.0
        self._model, self._data, self._dt = crane.model, crane.model.createData(), dt
        stiffness, damping = buffer_numbers(crane) if buffers else (np.zeros(3), np.zeros(3))
        self._stiffness, self._damping = dt * dt * stiffness, dt * damping
        self._lower, self._upper = crane.lower[DRIVES], crane.upper[DRIVES]
        self._stop_effort, self._u = np.zeros(3), np.zeros(3)

    def __call__(self, q: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Generalized forces, shape (5,)."""
        self._book(u)
        effort = outside_effort(self._model, self._data, q, self._dt**2 * self.force)
        beyond = q[DRIVES] - np.clip(q[DRIVES], self._lower, self._upper)
        if beyond.any():
            self._stop_effort = stop_effort(beyond, u[DRIVES], self._stiffness, self._damping)
            effort[DRIVES] += self._stop_effort
        return effort

    def stop_force(self, state: State) -> float:
        """What the buffers at the ends of the cable push [N], with the sign of the hoist's force.

        At the longest cable that is negative, what the buffer takes of the load. At the shortest the hook block meets the trolley, which
        pushes it down.
        """
        length = state.q[4]
        beyond = length - min(max(length, self._lower[2]), self._upper[2])
        if not beyond:
            return 0.0
        return float(stop_effort(beyond, self._dt * state.v[4], self._stiffness[2], self._damping[2])) / self._dt**2

    def buffer_work(self, state: State) -> float:
        """Work done on the crane by the buffers up to this state [J]."""
        self._book(self._dt * state.v)
        return self._work / self._dt**2

    def _book(self, u: np.ndarray) -> None:
        """Add the last step's work: its force times the mean of the velocities before and after it."""
        if self._stop_effort.any():
            self._work += float(self._stop_effort @ (self._u + u[DRIVES])) / 2.0
            self._stop_effort = np.zeros(3)
        self._u = u[DRIVES]


class Limits:
    """The largest efforts of a crane's drives."""

    def __init__(self, crane: Crane) -> None:
        self._most = crane.effort_limit
        self._slew, self._trolley, self._hoist = crane.effort_limit.tolist()

    def cut(self, command: np.ndarray) -> np.ndarray:
        """A command within the limits, shape (3,)."""
        slew, trolley, hoist = command.tolist()
        inside = abs(slew) <= self._slew and abs(trolley) <= self._trolley and abs(hoist) <= self._hoist
        return command if inside else command.clip(-self._most, self._most)


class EffortDrives:
    """Drives that push with the effort commanded, within their limits."""

    def __init__(self, crane: Crane, dt: float, outside: Outside | None) -> None:
        self.model = in_steps(crane.model, dt)
        self._limits = Limits(crane)
        self._dt2 = np.full(3, dt * dt)
        self._effort = np.zeros(3)
        self._tau = np.zeros(5)
        self.acceleration = self._damped_aba(dt * crane.damping, outside)

    def _damped_aba(self, damping: np.ndarray, outside: Outside | None) -> Acceleration:
        # pin.integrate adds, which is quicker for five numbers than NumPy
        aba, world, add, multiply = pin.aba, pin.Convention.WORLD, pin.integrate, np.multiply
        model, data, tau, resistance, scratch = self.model, self.model.createData(), self._tau, -damping, np.empty(5)
        if outside is not None:
            return lambda q, u: aba(model, data, q, u, tau - damping * u + outside(q, u), world)
        return lambda q, u: aba(model, data, q, u, add(model, tau, multiply(resistance, u, scratch)), world)

    def take(self, command: np.ndarray, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Take a command until the next one; returns the effort asked for and the effort that acts, shape (3,) each."""
        self._effort = self._limits.cut(command)
        self._tau[0], self._tau[1], self._tau[4] = (self._dt2 * self._effort).tolist()
        return command, self._effort

    def effort(self, state: State) -> np.ndarray:
        """What acts at a state under the last command, shape (3,)."""
        return self._effort


class MotionDrives:
    """Drives that accelerate as commanded, whatever effort it costs."""

    def __init__(self, crane: Crane, dt: float, outside: Outside | None) -> None:
        self.model = in_steps(crane.model, dt)
        self._data = self.model.createData()
        self._damping = dt * crane.damping
        self._dt = dt
        self._command = np.zeros(5)
        self._outside = outside

    def take(self, command: np.ndarray, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Take a command until the next one; returns the effort that it costs at this state, twice, shape (3,) each.

        Raises:
            OutOfRange: If that is not finite.
        """
        self._command[DRIVES] = self._dt**2 * command
        effort = self.effort(state)
        if not np.isfinite(effort).all():
            raise OutOfRange("effort that the motion costs", effort.tolist(), "finite numbers", "N m, N, N")
        return effort, effort

    def effort(self, state: State) -> np.ndarray:
        """What acts at a state under the last command, shape (3,)."""
        u = self._dt * state.v
        a = self.acceleration(state.q, u)
        return inverse_dynamics(self.model, self._data, state.q, u, a, self._damping, self._external(state.q, u)) / self._dt**2

    def acceleration(self, q: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Of all five joints, shape (5,)."""
        return follow_drives(self.model, self._data, q, u, self._command, self._damping, self._external(q, u))

    def _external(self, q: np.ndarray, u: np.ndarray) -> np.ndarray | None:
        return None if self._outside is None else self._outside(q, u)
