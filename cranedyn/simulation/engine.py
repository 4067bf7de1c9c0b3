"""What an engine is: it carries out runs, or moves a crane for a loop that somebody else writes.

Two modules are engines: `cranedyn.simulation.pinocchio_engine`, a plain loop that calls Pinocchio's
algorithms, and `cranedyn.compiled.compiled_engine`, which compiles code for a crane. Other packages
add theirs, see `cranedyn.plugins`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Protocol

import numpy as np

from cranedyn import plugins
from cranedyn.interfaces import Controller, EngineName, Monitor, Reference, State
from cranedyn.simulation import pinocchio_engine
from cranedyn.simulation.log import Actuation, Log
from cranedyn.simulation.run_spec import RunSpec


class Engine(Protocol):
    """A module, or an object, that carries out runs.

    What an engine keeps in memory during a run, in which order and in which units, is its own
    affair. It gives back a log.
    """

    def run(
        self,
        spec: RunSpec,
        controller: Controller,
        reference: Reference,
        monitors: Sequence[Monitor],
    ) -> Log:
        """Carry out a run and return its log.

        An error of the controller, of the reference, of the disturbance or of a monitor ends the
        run, and so does Ctrl-C. The engine does not raise it but hands it to `Log.end_early`, so
        that what was recorded until then is not lost.

        Raises:
            CraneError: If the engine cannot carry out a run of this kind.
        """

    def begin(self, spec: RunSpec) -> MovingCrane:
        """Return the crane of a run at its start, for a loop that somebody else writes. Of the
        clocks, the control period and the physics step count; whoever writes the loop ends it.

        Raises:
            CraneError: If the engine cannot carry out a run of this kind.
        """


class MovingCrane(Protocol):
    """A crane that an engine moves on by one control period at a time.

    Attributes:
        state: State of the crane. Its arrays are read-only.
    """

    state: State

    @property
    def actuation(self) -> Actuation:
        """What acts on the crane from the last control instant on. It may be read after the first
        step; its arrays change with the next one.
        """

    def reset(self, start: State) -> None:
        """Return to a state, without command, force or work."""

    def step(self, command: np.ndarray, force: np.ndarray | None) -> State:
        """Hold a command and external forces for a control period, and return the state at its end.

        Args:
            command: Of the drives, in the unit of their kind, shape (m,).
            force: On the points of the crane in the world [N], shape (points, 3); None if none act
                in this period.
        """


@cache
def load_engine(name: EngineName | str) -> Engine:
    """Return the engine of a name: "pinocchio", "compiled", or that of another package.

    Raises:
        UnknownName: If there is no such engine.
    """
    # Reading the entry points takes longer than a short run lasts, and the default needs none of
    # them.
    if name == "pinocchio":
        return pinocchio_engine
    engine: Engine = plugins.load("engine", name)
    return engine


def default_engine(spec: RunSpec) -> EngineName:
    """Return the name of the engine for a run whose user names none.

    The Pinocchio engine is the one that a reader can follow. Changes of contact within a step, of
    the load with the ground or of a rope that goes slack, are known to the compiled engine only.
    """
    if spec.ground is not None or spec.rope_may_go_slack:
        return "compiled"
    return "pinocchio"
