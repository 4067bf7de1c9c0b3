"""A run for another program: a crane, its start, and its controller as tables without Python."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cranedyn.clocks import Clocked, Clocks, clocks
from cranedyn.controllers.affine import Affine, affine_form
from cranedyn.errors import DataError, OutOfRange
from cranedyn.interfaces import Controller, Drive, Reference, State
from cranedyn.model.crane import Crane
from cranedyn.references import hold
from cranedyn.references.tabulated import tabulated


@dataclass(frozen=True)
class Program:
    """Run with the arguments of `cranedyn.simulation.simulate.simulate`.

    Attributes:
        crane: Crane.
        controller: Controller, affine in the state.
        reference: Reference of the drives; None holds them at the start.
        start: Initial state.
        duration: Duration [s].
        dt: Physics step [s].
        control_period: Time between control instants [s].
        drive: Drive mode.
    """

    crane: Crane
    controller: Controller
    reference: Reference | None
    start: State
    duration: float
    dt: float = 5e-4
    control_period: float = 5e-3
    drive: Drive = "effort"

    @property
    def clock(self) -> Clocks:
        """Clock of the run."""
        return clocks(self.duration, self.dt, self.control_period)

    def tables(self, program: str) -> Affine:
        """Return the controller as tables.

        Args:
            program: Name of the other program, for error messages.

        Raises:
            DataError: If the controller is not affine.
            OutOfRange: If the drives follow prescribed motion, or the affine form holds a number
                that is not finite.
        """
        if self.drive != "effort":
            allowed = "effort: another engine's joints take forces"
            raise OutOfRange(f"drive of a run in {program}", self.drive, allowed)
        clock, layout = self.clock, self.crane.layout
        times = clock.period * np.arange(clock.periods + 1)
        reference = hold(self.crane, self.start) if self.reference is None else self.reference
        positions = tabulated(reference, times, layout.m).position
        if isinstance(self.controller, Clocked):
            self.controller.begin_run(0.0, clock.period)
        return finite_form(self.controller, times, positions, 2 * layout.n, program)


def finite_form(
    controller: Controller, times: np.ndarray, positions: np.ndarray, width: int, program: str
) -> Affine:
    """Return the affine form of a controller for another program, see `affine_form`.

    Raises:
        DataError: If there is none.
        OutOfRange: If it holds a number that is not finite.
    """
    form = affine_form(controller, times, positions, width)
    if form is None:
        raise DataError(
            f"The controller {type(controller).__name__} is not affine in the state, or has run "
            f"before; {program} runs tables, not Python."
        )
    if lacking := form.lacking():
        name = f"{lacking} of the controller"
        raise OutOfRange(name, "not finite in some row", "finite numbers")
    return form
