"""Step a crane by one control period at a time, in a loop of your own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from cranedyn.data.trajectory import Trajectory
from cranedyn.disturbances.base_motion import BaseMotion
from cranedyn.dynamics.converters import Converters
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import Drive, EngineName, State
from cranedyn.model.crane import Crane
from cranedyn.simulation.engine import default_engine, load_engine
from cranedyn.simulation.log import Actuation, Log
from cranedyn.simulation.loop_checks import as_command, as_force, check_bounded
from cranedyn.simulation.run_record import run_parameters, run_record, with_notes
from cranedyn.simulation.run_spec import RunSpec, make_run_spec

if TYPE_CHECKING:
    # Contacts take long to import, and few runs have them.
    from cranedyn.dynamics.contact import Ground


class Stepper:
    """A crane that advances by one control period at each command.

    Attributes:
        crane: The crane.
        t: Time since the start [s].
        state: State of the crane.
    """

    def __init__(
        self,
        crane: Crane,
        *,
        start: State | None = None,
        dt: float = 5e-4,
        control_period: float = 5e-3,
        drive: Drive | Converters = "effort",
        forces: bool = False,
        buffers: bool = False,
        ground: Ground | None = None,
        integrator: Integrator = semi_implicit_euler,
        engine: EngineName | str | None = None,
        base: BaseMotion | None = None,
    ) -> None:
        """Start at a state.

        Args:
            crane: The crane.
            start: The state at the start. If None, the crane hangs at rest where the URDF says.
            dt: Physics step [s].
            control_period: Time for which each command is held [s], a multiple of `dt`.
            drive: Kind of command, see `cranedyn.simulation.simulate.simulate`.
            forces: Whether external forces come with the commands.
            buffers: Whether buffers end the ranges of the drives; for drives that take efforts.
            ground: Ground and platforms that the load may touch; None for none.
            integrator: Rule that steps coordinates and rates.
            engine: Engine that computes the steps, see `cranedyn.simulation.simulate.simulate`.
            base: Motion of the base on which the crane stands, over the time since the start; None
                for a crane that stands in the world.

        Raises:
            OutOfRange: If an argument is out of its range or has no effect, or the state is not one
                of this crane.
            UnknownName: If there is no such engine.
            CraneError: If the engine cannot compute such a crane.
        """
        if buffers and drive != "effort":
            raise OutOfRange("buffers", "True", "False where the drives take no efforts")
        self.crane = crane
        self._spec = make_run_spec(
            crane,
            start=start,
            t_start=0.0,
            duration=control_period,
            dt=dt,
            control_period=control_period,
            drive=drive,
            integrator=integrator,
            # A stepper judges no rows; this says whether there are buffers.
            validity="buffers" if buffers else "stop",
            disturbance=None,
            ground=ground,
            has_forces=forces,
            base=base,
        )
        engine_name = default_engine(self._spec) if engine is None else engine
        self._moving = load_engine(engine_name).begin(self._spec)
        self._periods = 0

    @property
    def t(self) -> float:
        """Time since the start [s]."""
        return self._periods * self._spec.clocks.period

    @property
    def state(self) -> State:
        """State of the crane."""
        return self._moving.state

    def reset(self, state: State | None = None) -> State:
        """Return to a state at time 0. If it is None, the crane hangs at rest where the URDF says,
        whatever the state was that it began with.

        Raises:
            OutOfRange: If the state is not one of this crane.
        """
        start = self.crane.start if state is None else state
        self._moving.reset(self.crane.layout.as_state("start", start))
        self._periods = 0
        return self._moving.state

    def step(self, command: Sequence[float] | np.ndarray, force: np.ndarray | None = None) -> State:
        """Hold a command for a control period; return the state at its end.

        Args:
            command: Commands of the drives [N m or N; rad/s² or m/s²; rad/s or m/s], shape (m,).
            force: External forces on the points of the crane in the world [N], shape (points, 3);
                None for none.

        Raises:
            OutOfRange: If a shape is wrong, or a force is given to a stepper without forces.
            RunError: If a command is not finite, or the crane has moved beyond all bounds in the
                step before.
        """
        layout = self.crane.layout
        check_bounded(layout, self.t, self.state)
        if self._spec.has_forces:
            # Without a force now, the one before must end.
            force = np.zeros((len(layout.points), 3)) if force is None else as_force(force, layout)
        elif force is not None:
            raise OutOfRange("force", "given", "none, unless the stepper is made with forces=True")
        state = self._moving.step(as_command(command, self.t, layout), force)
        self._periods += 1
        return state


class RecordedCrane:
    """A crane in another program's loop, with a log of it that becomes a trajectory.

    Sites and served plants have such loops: several cranes take turns there, or a controller behind
    a network commands one. A `Stepper` has no log, and goes on as long as one likes.

    Attributes:
        crane: The crane.
        t: Time of the control instant that comes next [s].
        state: State of the crane then.
        actuation: What acted on it from the last control instant on.
    """

    def __init__(
        self,
        spec: RunSpec,
        engine: EngineName | str,
        controller: object,
    ) -> None:
        """Begin at the start of a run.

        Args:
            spec: The run. Its clocks say how many rows the log has room for; a step beyond them
                is an IndexError.
            engine: Name of the engine.
            controller: What commands the crane, for the record.

        Raises:
            UnknownName: If there is no such engine.
            CraneError: If the engine cannot carry out such a run.
        """
        self.crane = spec.crane
        self._controller = controller
        self._parameters = run_parameters(spec, engine)
        self._record = run_record(spec, controller, None)
        self._log = Log(spec)
        self._spec = spec
        self._moving = load_engine(engine).begin(spec)

    @property
    def t(self) -> float:
        """Time of the control instant that comes next [s]."""
        return self._spec.time(len(self._log))

    @property
    def state(self) -> State:
        """State of the crane."""
        return self._moving.state

    @property
    def actuation(self) -> Actuation:
        """What acted on the crane from the last control instant on."""
        return self._moving.actuation

    def step(
        self, command: np.ndarray, setpoint: np.ndarray, force: np.ndarray | None = None
    ) -> State:
        """Hold a command for a control period, log the row of its first instant, and return the
        state at its end.

        Args:
            command: Commands of the drives, shape (m,).
            setpoint: Positions of the setpoint of the drives, for the log, shape (m,).
            force: External forces on the points in the world [N], shape (points, 3); None if none
                act in this period. They need a spec with `has_forces`.

        Raises:
            RunError: If a command is not finite, the crane moves beyond all bounds, or the model
                ceases to hold.
        """
        layout = self.crane.layout
        before = self.state
        check_bounded(layout, self.t, before)
        command = as_command(command, self.t, layout)
        state = self._moving.step(command, force)
        self._log.append(before, setpoint, self._moving.actuation)
        return state

    def judge(self) -> None:
        """Judge the rows that are not judged yet, which the log does by itself in blocks.

        Raises:
            RunError: If the model ceases to hold.
        """
        self._log.judge()

    def trajectory(self) -> Trajectory:
        """Return all rows so far as a trajectory, with the notes of the controller."""
        record = with_notes(self._record, self._controller)
        return self._log.trajectory(self._parameters, record)
