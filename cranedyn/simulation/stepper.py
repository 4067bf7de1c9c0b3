"""One control period at a time: what `simulate` is a loop around, for loops of one's own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pkgutil import resolve_name

import numpy as np

from cranedyn.checks import check_choice, short_repr
from cranedyn.clocks import clocks
from cranedyn.dynamics.converters import Converters, fitting
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.errors import OutOfRange, RunError
from cranedyn.interfaces import Drive, EngineName, State
from cranedyn.model.crane import Crane
from cranedyn.model.layout import Layout
from cranedyn.simulation.engine import DIVERGED, Engine, Setting

ENGINES = {
    "pinocchio": "cranedyn.simulation.engine:Engine",
    "compiled": "cranedyn.compiled.engine:CompiledEngine",
}
"""Where each engine is; looked up when it is asked for, since the compiled one needs an extra."""


class Stepper:
    """A crane that goes on by one control period at each command.

    Attributes:
        crane: The crane.
        clocks: Physics steps in a control period.
        converters: Frequency converters of drives that take velocities; None for others.
        engine: What computes the steps.
        t: Time since the start [s].
    """

    def __init__(
        self,
        crane: Crane,
        *,
        start: State | None = None,
        dt: float = 5e-4,
        control_period: float = 5e-3,
        drive: Drive = "effort",
        forces: bool = False,
        buffers: bool = False,
        integrator: Integrator = semi_implicit_euler,
        engine: EngineName = "pinocchio",
        converters: Converters | None = None,
    ) -> None:
        """Stand at a state.

        Args:
            crane: The crane.
            start: Where it starts; None for hanging at rest where its URDF says.
            dt: Physics step [s].
            control_period: Time that each command lasts [s], a multiple of `dt`.
            drive: "effort": commands are efforts, cut to the limits of the drives. "motion": they
                are accelerations, followed exactly. "velocity": they are rates, followed as
                frequency converters do.
            forces: Whether forces from outside will come with the commands.
            buffers: Whether buffers end the ranges of the drives; for drives that take efforts.
            integrator: The stepping rule.
            engine: "pinocchio", or "compiled" for code made for this crane.
            converters: Frequency converters of drives that take velocities; None for typical ones.

        Raises:
            OutOfRange: If an argument is of another kind, or has no effect, or the state is not one
                of this crane.
        """
        check_choice("drive", drive, Drive)
        check_choice("engine", engine, EngineName)
        if buffers and drive != "effort":
            allowed = "False where the drives take no efforts"
            raise OutOfRange("buffers", "True", allowed)
        self.crane, self._forces, self._steps = crane, forces, 0
        self.clocks = clocks(control_period, dt, control_period)
        self.converters = fitting(crane, drive, converters)
        setting = Setting(crane, self.clocks, drive, forces, buffers, integrator, self.converters)
        self.engine: Engine = resolve_name(ENGINES[engine])(setting, started(crane, start))

    @property
    def t(self) -> float:
        """Time since the start [s]."""
        return self._steps * self.clocks.period

    @property
    def state(self) -> State:
        """Where the crane is."""
        return self.engine.state

    def reset(self, state: State | None = None) -> State:
        """Stand at a state again, None for where the URDF says, at time 0; returns it.

        Raises:
            OutOfRange: If it is not one of this crane.
        """
        self.engine.begin(started(self.crane, state))
        self._steps = 0
        return self.engine.state

    def step(self, command: Sequence[float] | np.ndarray, force: np.ndarray | None = None) -> State:
        """Go on for one control period under a command.

        Args:
            command: Of the drives [N m or N; or rad/s² or m/s²; or rad/s or m/s], shape (m,).
            force: From outside on the points of the crane, in the world [N], shape (points, 3);
                None for none.

        Returns:
            Where the crane is then.

        Raises:
            OutOfRange: If a shape is another, or there is a force though none was announced.
            RunError: If a command is not finite, or the crane moves beyond all bounds.
        """
        if not math.hypot(*self.engine.state.v.tolist()) < DIVERGED:
            raise diverged(self.crane.layout, self.t, self.engine.state)
        if force is not None and not self._forces:
            raise OutOfRange("force", "given", "none, unless the stepper is made with forces=True")
        if self._forces:
            shape = len(self.crane.points), 3
            self.engine.take_force(
                force_of(np.zeros(shape) if force is None else force, self.crane.layout)
            )
        self.engine.take(command_of(command, self.t, self.crane.layout))
        state = self.engine.advance()
        self._steps += 1
        return state


def started(crane: Crane, start: State | None) -> State:
    """A state of a crane that nobody else can change; None for where it starts.

    Raises:
        OutOfRange: If it is not as many finite coordinates and rates as the crane has joints.
    """
    return crane.layout.as_state("start", crane.start if start is None else start)


def command_of(answer: object, t: float, layout: Layout) -> np.ndarray:
    """What a controller answered at a time [s], if it is one finite number for each drive.

    Raises:
        OutOfRange: If there are more or fewer.
        RunError: If one is not finite.
    """
    if type(answer) is np.ndarray and answer.dtype == float and answer.shape == (layout.m,):
        command = answer.copy()
    else:
        command = _array(answer, "command of the controller", (layout.m,), layout.drives_in_words)
    if not math.isfinite(sum(command.tolist())) and not np.isfinite(command).all():
        joint = layout.driven[int(np.argmin(np.isfinite(command)))].name
        raise RunError(
            f"The controller commanded {command.tolist()} at t = {t:.4f} s; {joint} needs a finite "
            "number.",
            t=t,
            joint=joint,
        )
    return command


def force_of(answer: object, layout: Layout) -> np.ndarray:
    """What a disturbance answered, if it is a finite vector for each point of the crane.

    Raises:
        OutOfRange: If it is not.
    """
    force = _array(
        answer,
        "force of the disturbance",
        (len(layout.points), 3),
        f"a vector for each of {', '.join(layout.points)}",
    )
    if not np.isfinite(force).all():
        raise OutOfRange("force of the disturbance", force.tolist(), "finite numbers", "N")
    return force


def diverged(layout: Layout, t: float, state: State) -> RunError:
    """The error that a state at a time [s] is, in which a joint moves too fast."""
    i = int(np.argmax(np.nan_to_num(np.abs(state.v), nan=np.inf)))
    name, value = layout.joints[i].name, float(state.v[i])
    return RunError(
        f"The run diverged at t = {t:.4f} s: {name} moves at {value:g} per second; a smaller dt or "
        "softer gains may help.",
        t=t,
        joint=name,
        value=value,
    )


def _array(answer: object, name: str, shape: tuple[int, ...], allowed: str) -> np.ndarray:
    try:
        array = (
            None
            if isinstance(answer, np.ndarray)
            and (np.iscomplexobj(answer) or np.ma.is_masked(answer))
            else np.array(answer, dtype=float)
        )
    except (TypeError, ValueError, OverflowError):
        array = None
    if array is None or array.shape != shape:
        given = short_repr(answer) if array is None else f"an array of shape {array.shape}"
        raise OutOfRange(name, given, allowed)
    return array
