"""How a crane gets from one control instant to the next, by Pinocchio's algorithms;
`cranedyn.compiled.engine` does the same by code.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from cranedyn.clocks import Clocks
from cranedyn.dynamics.converters import Converters
from cranedyn.dynamics.drives import EffortDrives, MotionDrives, Outside, VelocityDrives
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.interfaces import Reference, State
from cranedyn.model.crane import Crane
from cranedyn.simulation.log import Log

DIVERGED = 1e6
"""No joint of a crane moves this fast [rad/s or m/s]."""


@dataclass(frozen=True, eq=False)
class Setting:
    """What a run is made with.

    Attributes:
        crane: The crane.
        clocks: Physics steps and control periods.
        drive: "effort", "motion" or "velocity".
        forces: Whether there are forces from outside.
        buffers: Whether buffers end the ranges of the drives.
        integrator: The stepping rule.
        converters: Frequency converters of drives that take velocities; None for others.
    """

    crane: Crane
    clocks: Clocks
    drive: str
    forces: bool
    buffers: bool
    integrator: Integrator
    converters: Converters | None = None

    def outside(self, dt: float, *, buffers: bool) -> Outside | None:
        """What acts from outside, time counted in steps [s]; None if nothing can."""
        return Outside(self.crane, dt, buffers=buffers) if self.forces or self.buffers else None

    @property
    def late(self) -> int | None:
        """By how many control periods commands are heard late; None without converters."""
        made = self.converters
        return None if made is None else made.late(self.clocks.dt, self.clocks.period)

    def drives(
        self, dt: float, outside: Outside | None
    ) -> EffortDrives | MotionDrives | VelocityDrives:
        """The drives, time counted in steps [s]."""
        if self.converters is not None:
            return VelocityDrives(self.crane, dt, outside, self.converters, self.late or 0)
        return (EffortDrives if self.drive == "effort" else MotionDrives)(self.crane, dt, outside)


class Engine:
    """A crane that moves from one control instant to the next.

    Where buffers act, a stepping rule that asks for a smooth motion gives way to small
    semi-implicit steps: a step at whose beginning or end a drive is beyond its range is made with
    these instead.

    Attributes:
        state: Where the crane is.
        look_back: After how many control instants the log should be looked through for what the
            model does not hold for.
    """

    look_back = 1000

    def __init__(self, setting: Setting, start: State) -> None:
        """Begin at a state, without command."""
        self._setting = setting
        self._steps, self._integrator = setting.clocks.steps, setting.integrator
        self._per_second = np.full(setting.crane.layout.n, 1.0 / setting.clocks.dt)
        self.begin(start)

    def begin(self, start: State) -> None:
        """Begin anew at a state, without command, force or work."""
        setting, clocks = self._setting, self._setting.clocks
        self.state, self._u = start, clocks.dt * start.v
        gives_way = setting.buffers and setting.integrator.smooth
        self._outside = setting.outside(clocks.dt, buffers=setting.buffers and not gives_way)
        self._drives = setting.drives(clocks.dt, self._outside)
        if isinstance(self._drives, VelocityDrives):
            self._drives.begin(start)
        self._rough = _Rough(setting) if gives_way else None

    def run_ahead(
        self, controller: object, reference: Reference, since: float, periods: int, log: Log
    ) -> Iterator[int]:
        """Log rows without asking anybody where that can be done, and say from time to time how
        many there are; here it cannot.
        """
        return iter(())

    def take(self, command: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Take a command until the next one; returns the effort asked for, or what the motion
        costs, and what acts, shape (m,) each.
        """
        if self._rough is not None:
            self._rough.drives.take(command, self.state)
        return self._drives.take(command, self.state)

    def energies(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Mechanical energy of states in rows [J], zero of height at the ground, shape (n,)."""
        crane = self._setting.crane
        mechanical, model, data = pin.computeMechanicalEnergy, crane.model, crane.data
        # A generator is Python, which answers Ctrl-C.
        rigid = (mechanical(model, data, *row) for row in zip(q, v, strict=True))
        found = np.fromiter(rigid, float, len(q))
        return found + crane.springs.energy(q.T) if crane.springs.any else found

    @property
    def cut(self) -> bool:
        """Whether the last command was more than a frequency converter follows."""
        return isinstance(self._drives, VelocityDrives) and self._drives.cut

    def effort(self) -> np.ndarray:
        """What acts here under the last command, shape (m,)."""
        return self._drives.effort(self.state)

    def take_force(self, force: np.ndarray) -> np.ndarray:
        """Take forces from outside until the next, in the world [N], on the points of the crane,
        shape (points, 3); returns them.
        """
        for outside in (self._outside, None if self._rough is None else self._rough.outside):
            if outside is not None:
                outside.force = force
        return force

    def buffers(self) -> tuple[float, float]:
        """Work done on the crane by the buffers so far [J], and what those at the ends of the cable
        push [N].
        """
        outside = self._outside if self._rough is None else self._rough.outside
        return (
            (0.0, 0.0)
            if outside is None
            else (outside.buffer_work(self.state), outside.stop_force(self.state))
        )

    def advance(self) -> State:
        """Go on to the next control instant."""
        if isinstance(self._drives, VelocityDrives):
            q = self._advance_by_rates(self._drives)
        elif self._rough is None:
            q, self._u = self._integrator.advance(
                self._drives.acceleration, self._drives.model, self.state.q, self._u, self._steps
            )
        else:
            q = self._advance_to_buffers(self._rough)
        v = self._u * self._per_second
        q.setflags(write=False)
        v.setflags(write=False)
        self.state = State(q, v)
        return self.state

    def _advance_by_rates(self, drives: VelocityDrives) -> np.ndarray:
        q, u = self.state.q, self._u
        for _ in range(self._steps):
            drives.step(u)
            q, u = self._integrator.advance(drives.acceleration, drives.model, q, u, 1)
        self._u = u
        return q

    def _advance_to_buffers(self, rough: _Rough) -> np.ndarray:
        q, u = self.state.q, self._u
        for _ in range(self._steps):
            there, faster = self._integrator.advance(
                self._drives.acceleration, self._drives.model, q, u, 1
            )
            q, u = (
                rough.advance(q, u) if rough.beyond(q) or rough.beyond(there) else (there, faster)
            )
        self._u = u
        return q


class _Rough:
    """Small semi-implicit steps, in which buffers act."""

    def __init__(self, setting: Setting) -> None:
        self._count = setting.clocks.small
        dt = setting.clocks.dt / self._count
        self.outside = setting.outside(dt, buffers=True)
        self.drives = setting.drives(dt, self.outside)
        self._drives = setting.crane.layout.drives
        self._lower, self._upper = (
            setting.crane.lower[self._drives],
            setting.crane.upper[self._drives],
        )

    def beyond(self, q: np.ndarray) -> bool:
        """Whether a drive is beyond its range."""
        here = q[self._drives]
        return bool((here < self._lower).any() or (here > self._upper).any())

    def advance(self, q: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """One step in small ones."""
        q, fine = semi_implicit_euler.advance(
            self.drives.acceleration, self.drives.model, q, u / self._count, self._count
        )
        return q, fine * self._count
