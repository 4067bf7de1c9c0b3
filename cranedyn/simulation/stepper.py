"""Step a crane by one control period at a time, in a loop of your own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from cranedyn.checks import as_array, finite
from cranedyn.clocks import clocks
from cranedyn.dynamics.contact import Ground
from cranedyn.dynamics.converters import Converters
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.errors import OutOfRange, RunError
from cranedyn.interfaces import Drive, EngineName, State
from cranedyn.model.crane import Crane
from cranedyn.model.layout import Layout
from cranedyn.simulation.engine import Setting, load_engine

DIVERGED = 1e6
"""No joint of a crane moves this fast [rad/s or m/s]."""


class Stepper:
    """A crane that advances by one control period at each command.

    Attributes:
        crane: The crane.
        setting: Settings of the run, one control period long.
        engine: The engine that computes the steps.
        t: Time since the start [s].
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
        engine: EngineName | str = "pinocchio",
    ) -> None:
        """Start at a state.

        Args:
            crane: The crane.
            start: The state at the start; None hangs at rest where the URDF says.
            dt: Physics step [s].
            control_period: Time for which each command is held [s], a multiple of `dt`.
            drive: Kind of command, see `cranedyn.simulation.simulate.simulate`.
            forces: Whether external forces come with the commands.
            buffers: Whether buffers end the ranges of the drives; for drives that take efforts.
            ground: Ground and platforms that the load may touch; None for none.
            integrator: The integrator.
            engine: "pinocchio", "compiled", or the name of a plugin, see `cranedyn.plugins`.

        Raises:
            OutOfRange: If an argument is out of its range or has no effect, or the state is not one
                of this crane.
            UnknownName: If there is no such engine.
        """
        clock = clocks(control_period, dt, control_period)
        self.crane = crane
        self._periods = 0
        acting: Any = {"forces": forces, "buffers": buffers, "ground": ground}
        self.setting = Setting.of(crane, clock, drive, integrator, **acting)
        self.engine = load_engine(engine)(self.setting, initial_state(crane, start))

    @property
    def t(self) -> float:
        """Time since the start [s]."""
        return self._periods * self.setting.clocks.period

    @property
    def state(self) -> State:
        """State of the crane."""
        return self.engine.state

    def reset(self, state: State | None = None) -> State:
        """Return to a state at time 0; None hangs at rest where the URDF says.

        Raises:
            OutOfRange: If the state is not one of this crane.
        """
        self.engine.reset(initial_state(self.crane, state))
        self._periods = 0
        return self.engine.state

    def step(self, command: Sequence[float] | np.ndarray, force: np.ndarray | None = None) -> State:
        """Hold a command for a control period; return the state at its end.

        Args:
            command: Commands of the drives [N m or N; rad/s² or m/s²; rad/s or m/s], shape (m,).
            force: External forces on the points of the crane in the world [N], shape (points, 3);
                None for none.

        Raises:
            OutOfRange: If a shape is wrong, or a force is given to a stepper without forces.
            RunError: If a command is not finite, or the crane moves beyond all bounds.
        """
        layout = self.crane.layout
        check_bounded(layout, self.t, self.engine.state)
        if self.setting.forces:
            force = as_force(np.zeros((len(layout.points), 3)) if force is None else force, layout)
        elif force is not None:
            raise OutOfRange("force", "given", "none, unless the stepper is made with forces=True")
        state = self.engine.advance(as_command(command, self.t, layout), force)
        self._periods += 1
        return state


def initial_state(crane: Crane, start: State | None) -> State:
    """Return a state of a crane as a read-only copy; None hangs at rest where the URDF says.

    Raises:
        OutOfRange: If it is not as many finite coordinates and rates as the crane has joints.
    """
    return crane.layout.as_state("start", crane.start if start is None else start)


def as_command(answer: object, t: float, layout: Layout) -> np.ndarray:
    """Return the answer of a controller at a time [s] as an array, shape (m,).

    Raises:
        OutOfRange: If it is not one number for each drive.
        RunError: If a number is not finite.
    """
    name = "command of the controller"
    meaning = layout.drives_in_words
    command = as_array(name, answer, (layout.m,), meaning=meaning)
    if not math.isfinite(sum(command.tolist())) and not np.isfinite(command).all():
        joint = layout.driven[int(np.argmin(np.isfinite(command)))].name
        raise RunError(
            f"The controller commanded {command.tolist()} at t = {t:.4f} s; {joint} needs a finite "
            "number.",
            t=t,
            joint=joint,
        )
    return command


def as_force(answer: object, layout: Layout) -> np.ndarray:
    """Return the answer of a disturbance as an array of its own [N], shape (points, 3).

    Raises:
        OutOfRange: If it is not a finite vector for each point of the crane.
    """
    shape = len(layout.points), 3
    meaning = f"a vector for each of {', '.join(layout.points)}"
    return finite("force of the disturbance", answer, shape, unit="N", meaning=meaning).copy()


def check_bounded(layout: Layout, t: float, state: State) -> None:
    """Return if no joint moves too fast.

    Raises:
        RunError: If a joint moves at 1e6 rad/s or m/s or more at a time [s].
    """
    if math.hypot(*state.v.tolist()) < DIVERGED:
        return
    i = int(np.argmax(np.nan_to_num(np.abs(state.v), nan=np.inf)))
    name = layout.joints[i].name
    value = float(state.v[i])
    raise RunError(
        f"The run diverged at t = {t:.4f} s: {name} moves at {value:g} per second; a smaller dt or "
        "softer gains may help.",
        t=t,
        joint=name,
        value=value,
    )
