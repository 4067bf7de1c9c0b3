"""Engines: how a crane gets from one control instant to the next; what they are made for, and what
they say of an instant.

This one steps by Pinocchio's algorithms. `cranedyn.compiled.engine` does the same by compiled code.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from cranedyn import plugins
from cranedyn.checks import check_choice
from cranedyn.clocks import Clocks
from cranedyn.dynamics.contact import Contacts, Ground
from cranedyn.dynamics.converters import Converters, fitting
from cranedyn.dynamics.drives import (
    Drives,
    EffortDrives,
    ExternalForces,
    GroundForces,
    MotionDrives,
    VelocityDrives,
)
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.errors import OutOfRange, shown
from cranedyn.interfaces import Disturbance, Drive, EngineName, Reference, Setpoint, State
from cranedyn.model.crane import Crane

_FLAGS = (np.zeros(1), np.ones(1))
"""How a log says False and True."""

_NOTHING_OUTSIDE = np.zeros(4)
"""What a log says of forces from outside where none act."""

PHASE_CHANGES = 2
"""Changes between a taut and a slack rope that are looked for within a step."""

_ROUND_OFF = 1e-15
"""Share of a step to which the instant of a change is found."""


@dataclass(frozen=True, eq=False)
class Setting:
    """What an engine is made for.

    Attributes:
        crane: The crane.
        clocks: Physics steps and control periods.
        drive: "effort", "motion" or "velocity".
        forces: Whether there are external forces on the points of the crane.
        buffers: Whether buffers end the ranges of the drives.
        integrator: The integrator.
        converters: Frequency converters of drives that take velocities; None for other drives.
        contacts: Contacts of the load with the ground; None for none.
        disturbance: What exerts the external forces; None where the caller does.
    """

    crane: Crane
    clocks: Clocks
    drive: str
    forces: bool
    buffers: bool
    integrator: Integrator
    converters: Converters | None = None
    contacts: Contacts | None = None
    disturbance: Disturbance | None = None

    @classmethod
    def of(
        cls,
        crane: Crane,
        clock: Clocks,
        drive: Drive | Converters,
        integrator: Integrator,
        *,
        buffers: bool,
        forces: bool = False,
        disturbance: Disturbance | None = None,
        ground: Ground | None = None,
    ) -> Setting:
        """Return settings that fit together, with typical converters for drives that take rates and
        where none are given.

        Raises:
            OutOfRange: If there is no such kind of drives, buffers are for drives that take no
                efforts, or there is not one converter for each drive.
        """
        kind, converters = ("velocity", drive) if isinstance(drive, Converters) else (drive, None)
        check_choice("drive", kind, Drive)
        if not isinstance(integrator, Integrator):
            allowed = "an Integrator, such as rk4 of cranedyn.dynamics.integrators"
            raise OutOfRange("integrator", shown(integrator), allowed)
        if buffers and kind != "effort":
            raise OutOfRange("buffers", "True", "False where the drives take no efforts")
        converters = fitting(crane, kind, converters)
        contacts = None if ground is None else ground.contacts(crane)
        acting = forces or disturbance is not None, buffers
        return cls(crane, clock, kind, *acting, integrator, converters, contacts, disturbance)

    @property
    def lead(self) -> float:
        """Time by which positions run ahead of velocities [s]."""
        return self.integrator.lead * self.clocks.dt

    @property
    def delay_steps(self) -> int | None:
        """Control periods by which commands are delayed; None without converters."""
        converters, clocks = self.converters, self.clocks
        return None if converters is None else converters.delay_steps(clocks.dt, clocks.period)

    def external(self, start: State) -> ExternalForces | None:
        """Return the external forces from a state on; None if there can be none."""
        contacts = self.contacts
        ground = None
        if contacts is not None:
            ground = GroundForces(self.crane, contacts)
            ground.anchors = ground.anchors_at(start)
        elif not (self.forces or self.buffers):
            return None
        return ExternalForces(self.crane, buffers=self.buffers, ground=ground)

    def drives(self, external: ExternalForces | None) -> Drives:
        """Return the drives."""
        if self.converters is not None:
            return VelocityDrives(
                self.crane, external, self.converters, self.clocks.dt, self.delay_steps or 0
            )
        return (EffortDrives if self.drive == "effort" else MotionDrives)(self.crane, external)


class Actuation(NamedTuple):
    """What acts on the crane at a control instant, as the log keeps it: arrays of doubles.

    Attributes:
        needed: Efforts that the command asks for [N m or N], shape (m,).
        effort: Efforts exerted from this instant on, shape (m,).
        effort_before: Efforts exerted until this instant, shape (m,).
        force: External forces on the points in the world [N], shape (3 points,).
        outside: Work so far of external forces, which the log computes, of all buffers and of the
            ground, and of impacts of the rope [J], and the force of the buffers at the ends of the
            cable [N], shape (4,).
        saturated: 1 if the command was beyond the largest rate of a converter, else 0, shape (1,).
    """

    needed: np.ndarray
    effort: np.ndarray
    effort_before: np.ndarray
    force: np.ndarray
    outside: np.ndarray
    saturated: np.ndarray


@cache
def load_engine(name: EngineName | str) -> type[Engine]:
    """Return the engine of a name, "pinocchio" or that of a plugin.

    Raises:
        UnknownName: If there is no such engine.
    """
    return Engine if name == "pinocchio" else plugins.load("engine", name)


class Engine:
    """A crane that steps by Pinocchio's algorithms.

    Attributes:
        state: The state of the crane.
        actuation: What acted on it from the last control instant on.
    """

    actuation: Actuation

    def __init__(self, setting: Setting, start: State) -> None:
        self._setting = setting
        self._dt = np.full(setting.crane.layout.n, setting.clocks.dt)
        self.reset(start)

    def reset(self, start: State) -> None:
        """Restart at a state, without command, force or work."""
        self.state = start
        self._external = self._setting.external(start)
        self._drives = self._setting.drives(self._external)
        self._no_force = np.zeros(3 * len(self._setting.crane.points))
        self._buffer_work = self._impact_work = 0.0
        if isinstance(self._drives, VelocityDrives):
            self._drives.reset(start)

    def run_ahead(
        self, controller: object, reference: Reference, t: np.ndarray, rows: np.ndarray
    ) -> Iterator[tuple[int, bool]]:
        """Write rows of the log at times [s], see `cranedyn.simulation.log.row_sections`, without
        the loop where an engine can; this one cannot. Yield how many there are so far, and whether
        the model is known to hold at all of them; else the log judges rows whose validity is NaN.
        """
        return iter(())

    def advance(
        self, command: np.ndarray, force: np.ndarray | None = None, *, last: bool = False
    ) -> State:
        """Hold a command, and external forces, and step to the next control instant; return the
        state there.

        Args:
            command: Of the drives, in the unit of their kind, shape (m,). The array is the
                controller's own: an engine copies what it keeps.
            force: On the points of the crane in the world [N], shape (points, 3); None for none.
            last: Whether to stay at this instant.
        """
        self._instant = self.state
        self._apply(command, force)
        return self.state if last else self._advance()

    def _apply(self, command: np.ndarray, force: np.ndarray | None) -> None:
        drives, state = self._drives, self.state
        rope = drives.rope is not None
        ground = None
        if self._external is not None and (ground := self._external.ground) is not None:
            self._external.ground_effort = ground.effort(*state)
        effort_before = drives.effort(state)
        acts = self._setting.buffers or rope or ground is not None
        outside = self._outside() if acts else _NOTHING_OUTSIDE
        if force is None:
            flat_force = self._no_force
        else:
            assert self._external is not None
            self._external.force = force
            flat_force = force.ravel()
        needed, effort = drives.take_command(np.ascontiguousarray(command), state)
        self.actuation = Actuation(
            needed, effort, effort_before, flat_force, outside, _FLAGS[drives.saturated]
        )

    def row(self, setpoint: Setpoint) -> bytes:
        """Return what the log keeps of the last control instant: positions of the setpoint,
        coordinates, rates and what acted, see `cranedyn.simulation.log.row_sections`.
        """
        position = np.ascontiguousarray(setpoint.position, dtype=float)
        parts: Any = (position, *self._instant, *self.actuation)
        return b"".join(parts)

    def _outside(self) -> np.ndarray:
        """Return zero, the work of buffers and ground, that of impacts, and the force of the
        buffers of the cable.
        """
        hoist = self._setting.crane.layout.drive_of("hoist")
        push = 0.0
        if self._setting.buffers and hoist is not None:
            assert self._external is not None and self._external.stops is not None
            push = float(self._external.stops.effort(*self.state)[hoist])
        return np.array([0.0, self._buffer_work, self._impact_work, push])

    def _advance(self) -> State:
        q, v = self.state
        if self._setting.buffers or self._setting.contacts is not None:
            for _ in range(self._setting.clocks.steps):
                self._drives.begin_step(v)
                q, v = self._step_with_contacts(q, v)
        elif isinstance(self._drives, VelocityDrives):
            for _ in range(self._setting.clocks.steps):
                self._drives.begin_step(v)
                q, v = self._steps(q, v, 1)
        else:
            q, v = self._steps(q, v, self._setting.clocks.steps)
        q.setflags(write=False)
        v.setflags(write=False)
        self.state = State(q, v)
        return self.state

    def _steps(self, q: np.ndarray, v: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
        integrator = self._setting.integrator
        drives = self._drives
        if drives.rope is None:
            return integrator.advance(drives.acceleration, drives.model, q, v, self._dt, steps)
        for _ in range(steps):
            q, v = self._step_once(q, v, self._setting.clocks.dt, integrator)
        return q, v

    def _step_once(
        self, q: np.ndarray, v: np.ndarray, dt: float, integrator: Integrator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Step once, divided where a rope becomes taut or slack: where it is inextensible, or the
        integrator needs a smooth motion.
        """
        drives = self._drives
        rope = self._drives.rope
        rest = dt

        def advanced(q: np.ndarray, v: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
            return integrator.advance(drives.acceleration, drives.model, q, v, dt, 1)

        if rope is None or not (rope.inextensible or integrator.smooth):
            return advanced(q, v, dt)
        taut = drives.pull(q, v) > 0.0
        for _ in range(PHASE_CHANGES):
            drives.take_rope(taut=taut)
            after = advanced(q, v, rest)
            if taut and rope.inextensible and drives.tension > 0.0:  # at all stages of the rule
                return after
            if drives.margin(*after, taut=taut) >= 0.0:
                return after
            time = 0.0
            if drives.margin(q, v, taut=taut) > 0.0:
                from scipy.optimize import brentq  # takes long to import, and few runs need it

                time = brentq(
                    lambda time, q, v, taut: drives.margin(*advanced(q, v, time), taut=taut),
                    *(0.0, rest, (q, v, taut)),
                    xtol=_ROUND_OFF * dt,
                )
            q, v = advanced(q, v, time)
            taut = not taut
            rest = rest - time
            if taut and rope.inextensible:
                q[rope.stretch] = 0.0
                v, gained = drives.impact(q, v)
                self._impact_work += gained
        drives.take_rope(taut=taut)
        return advanced(q, v, rest)

    def _step_with_contacts(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Step once without the ground, and without buffers where the integrator needs a smooth
        motion. Where the load touches the ground, or such a drive is beyond its range, before or
        after that, small semi-implicit steps replace it.
        """
        external, setting = self._external, self._setting
        clocks, integrator = setting.clocks, setting.integrator
        assert external is not None
        stops, ground = external.stops, external.ground
        works = self._buffer_work, self._impact_work
        if ground is None and not integrator.smooth:
            return self._step_and_count(q, v, integrator, clocks.dt)
        if not self._rough(q):
            external.ground = None
            external.stops = None if integrator.smooth else stops
            free = self._step_and_count(q, v, integrator, clocks.dt)
            external.ground = ground
            external.stops = stops
            if not self._rough(free[0]):
                return free
            self._buffer_work, self._impact_work = works
        self._drives.take_rope(taut=None)
        for _ in range(clocks.substeps):
            q, v = self._step_and_count(q, v, semi_implicit_euler, clocks.dt / clocks.substeps)
        return q, v

    def _rough(self, q: np.ndarray) -> bool:
        """Return whether a contact acts at which a step is no smooth motion."""
        assert self._external is not None
        stops, ground = self._external.stops, self._external.ground
        if ground is not None and ground.touches(q):
            return True
        return self._setting.integrator.smooth and stops is not None and any(stops.beyond(q))

    def _step_and_count(
        self, q: np.ndarray, v: np.ndarray, integrator: Integrator, dt: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Step once under a constant force of the ground, count the work of ground and buffers, and
        move the anchors of the ground.
        """
        external = self._external
        before = v
        drives = self._setting.crane.layout.drives
        assert external is not None
        if external.ground is not None:
            external.ground_effort = external.ground.effort(q, v)
        q, v = self._step_once(q, v, dt, integrator)
        moved = 0.5 * dt * (before + v)
        if external.stops is not None:
            self._buffer_work += float(external.stop_effort @ moved[drives])
        if external.ground is not None:
            self._buffer_work += float(external.ground_effort @ moved)
            external.ground.anchors = external.ground.moved
        return q, v

    def energies(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return mechanical energies [J], with zero height at the ground, shape (rows,).

        Args:
            q: Coordinates, shape (rows, n).
            v: Rates, shape (rows, n).
        """
        crane = self._setting.crane
        rows = zip(q, v, strict=True)
        # A generator is Python code, which answers Ctrl-C.
        rigid = (pin.computeMechanicalEnergy(crane.model, crane.data, *row) for row in rows)
        energies = np.fromiter(rigid, float, len(q))
        return energies + crane.springs.energy(q.T) if crane.springs.any else energies
