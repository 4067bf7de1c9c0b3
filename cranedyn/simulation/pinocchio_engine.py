"""The engine that steps by Pinocchio's algorithms: the loop of a run, as one writes it by hand.

It knows rigid and springy cranes, drives of all kinds, external forces, and buffers. A load on the
ground and a rope that goes slack are contacts, whose instants must be found within a step; the
compiled engine does that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cranedyn.dynamics.drives import (
    Drives,
    EffortDrives,
    ExternalForces,
    MotionDrives,
    VelocityDrives,
)
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.dynamics.root_motion import SAMPLES_PER_STEP, RootMotion, interpolated_root
from cranedyn.errors import CraneError
from cranedyn.interfaces import Controller, Monitor, Reference, State
from cranedyn.references.simple import checked_reference
from cranedyn.simulation.base_samples import BaseSamples
from cranedyn.simulation.log import Actuation, Log
from cranedyn.simulation.loop_checks import as_command, as_force, check_bounded
from cranedyn.simulation.run_spec import RunSpec

_PHASE_TOLERANCE = 1e-9
"""Rounding error of an elapsed time, in physics steps: a stage this little before the end of a step
is at its end."""


def run(
    spec: RunSpec, controller: Controller, reference: Reference, monitors: Sequence[Monitor]
) -> Log:
    """Carry out a run and return its log, see `cranedyn.simulation.engine.Engine`.

    Raises:
        CraneError: If the load may touch the ground or the rope may go slack.
        OutOfRange: If the log would take too much memory, or the reference is one of another crane.
    """
    layout = spec.crane.layout
    setpoint_at = checked_reference(reference, layout, spec.t_start, spec.clocks.period)
    moving = begin(spec)
    log = Log(spec)
    state = spec.start
    t = spec.t_start
    force = None
    try:
        # NumPy warns of overflows in a run that diverges; `check_bounded` reports it in words.
        with np.errstate(over="ignore", invalid="ignore"):
            for instant in range(spec.instants):
                t = spec.time(instant)
                check_bounded(layout, t, state)

                setpoint = setpoint_at(t)
                if spec.disturbance is not None:
                    force = as_force(spec.disturbance(t, state), layout)
                command = as_command(controller(t, state, setpoint), t, layout)

                actuation = moving.hold(command, force)
                log.append(state, setpoint.position, actuation)
                for monitor in monitors:
                    monitor(instant, t, state)

                if instant < spec.clocks.periods:
                    state = moving.advance()
            log.judge()
    except (Exception, KeyboardInterrupt) as error:
        log.end_early(t, error)
    return log


def begin(spec: RunSpec) -> DrivenCrane:
    """Return the crane of a run at its start, see `cranedyn.simulation.engine.Engine`.

    Raises:
        CraneError: If the load may touch the ground or the rope may go slack.
    """
    _check_supported(spec)
    return DrivenCrane(spec)


class DrivenCrane:
    """A crane with its drives, buffers and external forces, which moves on by control periods.

    Attributes:
        state: State of the crane.
        actuation: What acts on it from the last control instant on.
    """

    actuation: Actuation

    def __init__(self, spec: RunSpec) -> None:
        """Begin at the start of a run, without command and force."""
        self._spec = spec
        self._clocks = spec.clocks
        self._integrator = spec.integrator
        # Index of the hoist among the drives, whose buffers push on the cable; None without them.
        self._hoist = spec.crane.layout.drive_of("hoist") if spec.has_buffers else None
        # NumPy multiplies two arrays of n numbers faster than an array and a Python float.
        self._dt = np.full(spec.crane.layout.n, spec.clocks.dt)
        self._base = None if spec.base is None else BaseSamples(spec)
        self.reset(spec.start)

    def reset(self, start: State) -> None:
        """Return to a state, without command, force or work."""
        spec = self._spec
        self.state = start
        self._external: ExternalForces | None = None
        if spec.has_forces or spec.has_buffers or spec.base is not None:
            self._external = ExternalForces(
                spec.crane, buffers=spec.has_buffers, moving_base=spec.base is not None
            )
            self._no_force = self._external.force
        # Control periods since the start, and physics steps since the last control instant: the
        # clock of a base that moves.
        self._periods = 0
        self._elapsed = 0.0
        self._drives = make_drives(spec, self._external, start)
        self._buffer_work = 0.0

    def step(self, command: np.ndarray, force: np.ndarray | None) -> State:
        """Hold a command and external forces for a control period, and return the state at its end,
        see `hold` and `advance`.
        """
        self.hold(command, force)
        return self.advance()

    def hold(self, command: np.ndarray, force: np.ndarray | None) -> Actuation:
        """Hold a command and external forces from now on, and return what acts.

        Args:
            command: Of the drives, in the unit of their kind, shape (m,).
            force: On the points of the crane in the world [N], shape (points, 3); None if none act
                from now on.
        """
        state = self.state
        if self._base is not None:
            self._set_root(RootMotion.of(self._base.of_instant(self._periods)))
        # In this order: it is the last command and the last force that acted until now.
        effort_before = self._drives.effort(state)
        if self._spec.has_forces:
            assert self._external is not None
            self._external.force = self._no_force if force is None else self._in_base_axes(force)
        needed_effort, effort = self._drives.take_command(command, state)
        self.actuation = Actuation(
            needed_effort,
            effort,
            effort_before,
            force,
            contact_work=self._buffer_work,
            cable_buffer_force=self._cable_buffer_force(state),
            saturated=self._drives.saturated,
        )
        return self.actuation

    def advance(self) -> State:
        """Return the state a control period later, under the command and the forces held.

        Its arrays are read-only, since controllers and monitors get to see them.
        """
        q, v = self.state
        if self._base is not None:
            self._samples = self._base.of_period(self._periods)
            self._elapsed = 0.0
        if self._spec.has_buffers:
            for _ in range(self._clocks.steps):
                q, v = self._step_with_buffers(q, v)
        elif isinstance(self._drives, VelocityDrives):
            # The ramps of the converters move on in between, so that steps are taken one by one.
            for _ in range(self._clocks.steps):
                self._drives.begin_step(v)
                q, v = self._steps(q, v, 1)
        else:
            q, v = self._steps(q, v, self._clocks.steps)
        self._periods += 1
        q.setflags(write=False)
        v.setflags(write=False)
        self.state = State(q, v)
        return self.state

    def _steps(self, q: np.ndarray, v: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
        """Return q and v, shape (n,) each, after a number of physics steps."""
        return self._advanced(q, v, self._integrator, self._dt, 1.0, steps)

    def _advanced(
        self,
        q: np.ndarray,
        v: np.ndarray,
        integrator: Integrator,
        dt: float | np.ndarray,
        span: float,
        steps: int,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return q and v, shape (n,) each, after steps of `dt` [s], each a share `span` of a
        physics step.
        """
        if self._base is not None:
            return self._steps_on_base(q, v, integrator, span, steps)
        return integrator.advance(self._drives.acceleration, self._drives.model, q, v, dt, steps)

    def _steps_on_base(
        self, q: np.ndarray, v: np.ndarray, integrator: Integrator, span: float, steps: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return q and v after steps in which the base moves.

        A stepping rule knows no time. So the elapsed time is one more coordinate, whose rate is 1,
        and the rule itself carries it to each of its stages. It is counted in physics steps.

        Args:
            q: Coordinates, shape (n,).
            v: Rates, shape (n,).
            integrator: The stepping rule.
            span: Length of a step, in physics steps.
            steps: Number of steps.
        """
        n = len(q)
        step = np.full(n + 1, span * self._clocks.dt)
        step[n] = span

        def acceleration(coordinates: np.ndarray, rates: np.ndarray) -> np.ndarray:
            self._set_base(coordinates.item(n))
            of_joints = self._drives.acceleration(coordinates[:n], rates[:n])
            return np.append(of_joints, 0.0)

        def advanced(quantity: np.ndarray, rate: np.ndarray) -> np.ndarray:
            return quantity + step * rate

        coordinates, rates = integrator.rule(
            acceleration, advanced, advanced, np.append(q, self._elapsed), np.append(v, 1.0), steps
        )
        self._elapsed = coordinates.item(n)
        return coordinates[:n].copy(), rates[:n].copy()

    def _set_base(self, elapsed: float) -> None:
        """Let the base move as it does a number of physics steps after the control instant."""
        # At the end of the period the last step counts, and not one that would come after it.
        step = min(int(elapsed + _PHASE_TOLERANCE), self._clocks.steps - 1)
        row = SAMPLES_PER_STEP * step
        samples = self._samples[row : row + SAMPLES_PER_STEP + 1]
        self._set_root(interpolated_root(samples, elapsed - step))

    def _set_root(self, motion: RootMotion) -> None:
        """Let the base move in a given way from now on."""
        assert self._external is not None and self._external.root is not None
        self._external.root.motion = motion

    def _in_base_axes(self, force: np.ndarray) -> np.ndarray:
        """Return forces in the axes in which the crane stands, from those in the world [N], shape
        (points, 3). They are held in these axes for a control period.
        """
        return force if self._base is None else force @ self._base.rotation(self._periods)

    def _step_with_buffers(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return q and v after one physics step with buffers at the ends of the drives' ranges.

        The force of a buffer has a kink where the drive meets it. The order of an integrator such
        as RK4 is lost there, and its long steps may be unstable on so stiff a spring. Such a step
        is first tried without buffers. Where a drive is beyond its range before or after it, short
        semi-implicit steps with buffers replace it.
        """
        assert self._external is not None and self._external.stops is not None
        dt = self._clocks.dt
        stops = self._external.stops
        elapsed = self._elapsed
        if not self._integrator.smooth:
            return self._step_and_count_work(q, v, self._integrator, dt)

        if not any(stops.beyond(q)):
            self._external.stops = None
            try:
                q_free, v_free = self._steps(q, v, 1)
            finally:
                self._external.stops = stops
            if not any(stops.beyond(q_free)):
                return q_free, v_free

        substeps = self._clocks.substeps
        self._elapsed = elapsed
        for _ in range(substeps):
            q, v = self._step_and_count_work(q, v, semi_implicit_euler, dt / substeps)
        return q, v

    def _step_and_count_work(
        self, q: np.ndarray, v: np.ndarray, integrator: Integrator, dt: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return q and v after one step of `dt` [s], and add the work of the buffers in it.

        The work is the effort of the buffers in the last evaluation of the forces, times the
        displacement at the mean of the rates at both ends of the step: under a constant force, the
        kinetic energy changes by just this much.
        """
        assert self._external is not None
        v_before = v
        q, v = self._advanced(q, v, integrator, dt, dt / self._clocks.dt, 1)
        displacement = 0.5 * dt * (v_before + v)
        driven_displacement = displacement[self._spec.crane.layout.drives]
        self._buffer_work += float(self._external.stop_effort @ driven_displacement)
        return q, v

    def _cable_buffer_force(self, state: State) -> float:
        """Return the force of the buffers at the ends of the cable, with the sign of the hoist's
        [N]; 0 without buffers or without a hoist.
        """
        if self._hoist is None:
            return 0.0
        assert self._external is not None and self._external.stops is not None
        return float(self._external.stops.effort(*state)[self._hoist])


def make_drives(spec: RunSpec, external: ExternalForces | None, start: State) -> Drives:
    """Return the drives of a run at a start.

    Args:
        spec: The run.
        external: Forces that act beside the drives; None for none.
        start: State at which they begin.
    """
    if spec.drive == "effort":
        return EffortDrives(spec.crane, external)
    if spec.drive == "motion":
        return MotionDrives(spec.crane, external)
    assert spec.converters is not None
    drives = VelocityDrives(
        spec.crane, external, spec.converters, spec.clocks.dt, spec.command_delay
    )
    drives.reset(start)
    return drives


def _check_supported(spec: RunSpec) -> None:
    """Check that this engine can carry out a run.

    Raises:
        CraneError: If it cannot.
    """
    if spec.ground is not None:
        raise CraneError(
            'The engine "pinocchio" computes no contact of the load with the ground; run this with '
            'engine="compiled", or without ground.'
        )
    if spec.rope_may_go_slack:
        raise CraneError(
            'The engine "pinocchio" computes no rope that stretches or goes slack; run this crane '
            'with engine="compiled", or load it without rope_stiffness.'
        )
