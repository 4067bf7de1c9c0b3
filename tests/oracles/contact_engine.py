"""A second engine for loads on the ground and ropes that go slack, by Pinocchio's algorithms.

The product computes these in compiled code only, see `cranedyn.compiled.step`. This engine does the
same in the plain loop, step by step: it divides a step where the rope becomes taut or slack, takes
small steps where the load touches the ground, and changes the rates at impacts. Both engines must
agree to round-off.

`registered` makes it an engine that `simulate` finds under the name "oracle".
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pinocchio as pin
from scipy.optimize import brentq

from cranedyn import plugins
from cranedyn.compiled.step import PHASE_CHANGES
from cranedyn.dynamics.contact import Contacts, anchors_at
from cranedyn.dynamics.drives import (
    Drives,
    EffortDrives,
    ExternalForces,
    MotionDrives,
    VelocityDrives,
)
from cranedyn.dynamics.equations_of_motion import (
    body_points,
    inverse_dynamics,
    outside_effort,
    solve_accelerations,
)
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.interfaces import Controller, Monitor, Reference, State
from cranedyn.model.crane import Crane, Point
from cranedyn.references.simple import checked_reference
from cranedyn.simulation.log import Actuation, Log
from cranedyn.simulation.loop_checks import as_command, as_force, check_bounded
from cranedyn.simulation.pinocchio_engine import make_drives
from cranedyn.simulation.run_spec import RunSpec

_ROUND_OFF = 1e-15
"""Share of a step to which the instant of a change is found."""


def run(
    spec: RunSpec, controller: Controller, reference: Reference, monitors: Sequence[Monitor]
) -> Log:
    """Carry out a run and return its log, see `cranedyn.simulation.engine.Engine`."""
    layout = spec.crane.layout
    setpoint_at = checked_reference(reference, layout, spec.t_start, spec.clocks.period)
    moving = begin(spec)
    log = Log(spec)
    t = spec.t_start
    force = None
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            for instant in range(spec.instants):
                t = spec.time(instant)
                state = moving.state
                check_bounded(layout, t, state)
                setpoint = setpoint_at(t)
                if spec.disturbance is not None:
                    force = as_force(spec.disturbance(t, state), layout)
                command = as_command(controller(t, state, setpoint), t, layout)
                log.append(state, setpoint.position, moving.hold(command, force))
                for monitor in monitors:
                    monitor(instant, t, state)
                if instant < spec.clocks.periods:
                    moving.advance()
            log.judge()
    except (Exception, KeyboardInterrupt) as error:
        log.end_early(t, error)
    return log


def begin(spec: RunSpec) -> TouchingCrane:
    """Return the crane of a run at its start."""
    return TouchingCrane(spec)


@contextmanager
def registered() -> Iterator[str]:
    """Let `simulate` find this engine, and give its name."""
    name = "oracle"
    ours = plugins._own("engine")
    ours[name] = __name__
    try:
        assert plugins.load("engine", name) is sys.modules[__name__]
        yield name
    finally:
        del ours[name]


class GroundForces:
    """Forces of the ground on the load.

    Attributes:
        contacts: Its contacts.
        anchors: Places where its points came to rest, in the world [m], shape (3, points).
        moved: The same after the state at which the effort was last computed.
    """

    def __init__(self, crane: Crane, contacts: Contacts, start: State) -> None:
        self.contacts = contacts
        self._body = contacts.body
        self._levers = np.array(contacts.points)
        self._points = [Point("", self._body, lever) for lever in self._levers]
        self._model = crane.model
        self._data = crane.model.createData()
        self.anchors = anchors_at(crane, contacts, start)
        self.moved = self.anchors

    def touches(self, q: np.ndarray) -> bool:
        """Return whether a point is in a support."""
        position, _ = self._motion(q, 0.0 * q)
        return bool((self.contacts.depth(position)[0] > 0.0).any())

    def effort(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return generalized forces [N m or N], shape (n,)."""
        force, moved = self.contacts.reaction(*self._motion(q, v), self.anchors)
        self.moved = np.array(moved)
        forces = np.array(force).T
        if not forces.any():
            return np.zeros(len(v))
        return outside_effort(self._points, self._model, self._data, q, forces)

    def _motion(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return body_points(self._model, self._data, self._body, self._levers, q, v)


class GroundedForces(ExternalForces):
    """External forces with those of the ground.

    Attributes:
        ground: Forces of the ground; None for none.
        ground_effort: Its generalized forces, held for a step [N m or N], shape (n,).
    """

    def __init__(self, crane: Crane, *, buffers: bool, ground: GroundForces | None) -> None:
        super().__init__(crane, buffers=buffers)
        self.ground = ground
        self.ground_effort = np.zeros(crane.layout.n)

    def effort(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return generalized forces [N m or N], shape (n,)."""
        effort = super().effort(q, v)
        return effort if self.ground is None else effort + self.ground_effort


class RopeOfDrives:
    """A rope that may go slack, below drives of any kind, which it tells the joints that it holds.

    Attributes:
        rope: The rope.
        tension: Least tension of a taut inextensible rope since it was last taken as taut or slack
            [N].
    """

    def __init__(self, crane: Crane, drives: Drives) -> None:
        rope = crane.springs.rope
        assert rope is not None
        self.rope = rope
        self.tension = math.inf
        self._crane = crane
        self._data = crane.model.createData()
        self._drives = drives
        self._all_joints = drives.free
        self._free_when_taut = crane.springs.free(drives.free)

    def acceleration(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return accelerations of all joints, shape (n,), and note the tension."""
        drives = self._drives
        a = drives.acceleration(q, v)
        joint, external = drives.joint_and_external_forces(q, v)
        needed = inverse_dynamics(self._crane.model, self._data, q, v, a, joint, external)
        self.tension = min(self.tension, -float(needed[self.rope.stretch]))
        return a

    def pull(self, q: np.ndarray, v: np.ndarray) -> float:
        """Return a force that is positive where the rope pulls [N]."""
        if not self.rope.inextensible:
            return float(self._drives._joint_forces.pull(q, v))
        if q[self.rope.stretch] < 0.0 or v[self.rope.stretch] < 0.0:
            return -1.0
        self.take(taut=True)
        self.acceleration(q, v)
        return self.tension

    def margin(self, q: np.ndarray, v: np.ndarray, *, taut: bool) -> float:
        """Return a number that falls below zero where the rope ceases to be taut, or slack."""
        if taut:
            return self.pull(q, v)
        if self.rope.inextensible:
            return -float(q[self.rope.stretch])
        return -self.pull(q, v)

    def take(self, *, taut: bool | None) -> None:
        """Take the rope as taut or as slack from now on; None where the state decides."""
        self._drives._joint_forces = replace(self._drives._joint_forces, taut=taut)
        self._drives.free = self._free_when_taut if taut else self._all_joints
        self.tension = math.inf

    def settle(self, state: State) -> None:
        """Take an inextensible rope as taut or as slack as a state says."""
        if self.rope.inextensible:
            self.take(taut=self.pull(*state) > 0.0)

    def impact(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the rates after an inextensible rope has become taut at rates v, shape (n,), and
        the kinetic energy gained [J], negative for a loss.

        The impact is plastic: the rate of the stretch becomes zero. Joints keep their momentum, but
        for those whose motion is prescribed, which keep their rates.
        """
        model = self._crane.model
        stretch = self.rope.stretch
        still = np.zeros(len(v))
        weight = pin.rnea(model, self._data, q, still, still).copy()
        wanted = still.copy()
        wanted[stretch] = -v[stretch]
        change = solve_accelerations(
            model, self._data, q, still, wanted, weight, self._free_when_taut
        )
        mean_momentum = pin.rnea(model, self._data, q, still, v + 0.5 * change) - weight
        after = v + change
        after[stretch] = 0.0
        return after, float(change @ mean_momentum)


class TouchingCrane:
    """A crane whose load may touch the ground and whose rope may go slack.

    Attributes:
        state: State of the crane.
        actuation: What acts on it from the last control instant on.
    """

    actuation: Actuation

    def __init__(self, spec: RunSpec) -> None:
        self._spec = spec
        self._dt = np.full(spec.crane.layout.n, spec.clocks.dt)
        self.reset(spec.start)

    def reset(self, start: State) -> None:
        """Return to a state, without command, force or work."""
        spec = self._spec
        self.state = start
        ground = None
        if spec.contacts is not None:
            ground = GroundForces(spec.crane, spec.contacts, start)
        self._external = GroundedForces(spec.crane, buffers=spec.has_buffers, ground=ground)
        self._drives = make_drives(spec, self._external, start)
        self._rope = RopeOfDrives(spec.crane, self._drives) if spec.rope_may_go_slack else None
        self._contact_work = 0.0
        self._impact_work = 0.0

    def step(self, command: np.ndarray, force: np.ndarray | None) -> State:
        """Hold a command and external forces for a control period; return the state at its end."""
        self.hold(command, force)
        return self.advance()

    def hold(self, command: np.ndarray, force: np.ndarray | None) -> Actuation:
        """Hold a command and external forces from now on, and return what acts."""
        state = self.state
        drives = self._drives
        ground = self._external.ground
        if ground is not None:
            self._external.ground_effort = ground.effort(*state)
        if not isinstance(drives, EffortDrives):
            self._settle(state)
        effort_before = drives.effort(state)
        if force is not None:
            self._external.force = force
        needed_effort, effort = drives.take_command(command, state)
        if isinstance(drives, MotionDrives) and self._settle(state):
            needed_effort = effort = drives.effort(state)
        if isinstance(drives, VelocityDrives):
            # Whether the rope pulls depends on the rates that are heard from now on.
            reference_before = drives._reference
            reference, _ = drives._ramp(state.v)
            drives._reference = reference
            is_settled = self._settle(state)
            drives._reference = reference_before
            if is_settled:
                _, effort, needed_effort = drives._driven(*state, reference)
        self.actuation = Actuation(
            needed_effort,
            effort,
            effort_before,
            force,
            self._contact_work,
            self._impact_work,
            self._cable_buffer_force(state),
            drives.saturated,
        )
        return self.actuation

    def advance(self) -> State:
        """Return the state a control period later, under the command and the forces held."""
        q, v = self.state
        for _ in range(self._spec.clocks.steps):
            self._drives.begin_step(v)
            if self._spec.has_buffers or self._spec.contacts is not None:
                q, v = self._step_with_contacts(q, v)
            else:
                q, v = self._step(q, v, self._spec.clocks.dt, self._spec.integrator)
        q.setflags(write=False)
        v.setflags(write=False)
        self.state = State(q, v)
        return self.state

    def _step(
        self, q: np.ndarray, v: np.ndarray, dt: float, integrator: Integrator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Step once, divided where a rope becomes taut or slack: where it is inextensible, or the
        integrator needs a smooth motion.
        """
        rope = self._rope
        acceleration = self._drives.acceleration if rope is None else rope.acceleration

        def advanced(q: np.ndarray, v: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
            return integrator.advance(acceleration, self._drives.model, q, v, dt, 1)

        if rope is None or not (rope.rope.inextensible or integrator.smooth):
            return advanced(q, v, dt)

        def margin_after(time: float, q: np.ndarray, v: np.ndarray, taut: bool) -> float:
            return rope.margin(*advanced(q, v, time), taut=taut)

        rest = dt
        taut = rope.pull(q, v) > 0.0
        for _ in range(PHASE_CHANGES):
            rope.take(taut=taut)
            after = advanced(q, v, rest)
            pulled_all_along = rope.tension > 0.0
            if taut and rope.rope.inextensible and pulled_all_along:
                return after
            if rope.margin(*after, taut=taut) >= 0.0:
                return after
            time = 0.0
            if rope.margin(q, v, taut=taut) > 0.0:
                time = brentq(margin_after, 0.0, rest, (q, v, taut), xtol=_ROUND_OFF * dt)
            q, v = advanced(q, v, time)
            taut = not taut
            rest = rest - time
            if taut and rope.rope.inextensible:
                q[rope.rope.stretch] = 0.0
                v, gained = rope.impact(q, v)
                self._impact_work += gained
        rope.take(taut=taut)
        return advanced(q, v, rest)

    def _step_with_contacts(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Step once without the ground, and without buffers where the integrator needs a smooth
        motion. Where the load touches the ground, or such a drive is beyond its range, before or
        after that, small semi-implicit steps replace it.
        """
        external = self._external
        clocks = self._spec.clocks
        integrator = self._spec.integrator
        stops = external.stops
        ground = external.ground
        if ground is None and not integrator.smooth:
            return self._step_and_count_work(q, v, integrator, clocks.dt)

        if not self._is_in_contact(q):
            contact_work = self._contact_work
            impact_work = self._impact_work
            external.ground = None
            external.stops = None if integrator.smooth else stops
            q_free, v_free = self._step_and_count_work(q, v, integrator, clocks.dt)
            external.ground = ground
            external.stops = stops
            if not self._is_in_contact(q_free):
                return q_free, v_free
            self._contact_work = contact_work
            self._impact_work = impact_work

        if self._rope is not None:
            self._rope.take(taut=None)
        for _ in range(clocks.substeps):
            dt = clocks.dt / clocks.substeps
            q, v = self._step_and_count_work(q, v, semi_implicit_euler, dt)
        return q, v

    def _step_and_count_work(
        self, q: np.ndarray, v: np.ndarray, integrator: Integrator, dt: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Step once under a constant force of the ground, count the work of ground and buffers, and
        move the anchors of the ground.
        """
        external = self._external
        ground = external.ground
        v_before = v
        if ground is not None:
            external.ground_effort = ground.effort(q, v)
        q, v = self._step(q, v, dt, integrator)
        displacement = 0.5 * dt * (v_before + v)
        if external.stops is not None:
            drives = self._spec.crane.layout.drives
            self._contact_work += float(external.stop_effort @ displacement[drives])
        if ground is not None:
            self._contact_work += float(external.ground_effort @ displacement)
            ground.anchors = ground.moved
        return q, v

    def _is_in_contact(self, q: np.ndarray) -> bool:
        """Return whether a contact acts at which a step is no smooth motion."""
        stops = self._external.stops
        ground = self._external.ground
        if ground is not None and ground.touches(q):
            return True
        return self._spec.integrator.smooth and stops is not None and any(stops.beyond(q))

    def _settle(self, state: State) -> bool:
        """Take an inextensible rope as taut or as slack; return whether there is one."""
        if self._rope is None or not self._rope.rope.inextensible:
            return False
        self._rope.settle(state)
        return True

    def _cable_buffer_force(self, state: State) -> float:
        """Return the force of the buffers at the ends of the cable [N]."""
        hoist = self._spec.crane.layout.drive_of("hoist")
        stops = self._external.stops
        if hoist is None or stops is None:
            return 0.0
        return float(stops.effort(*state)[hoist])
