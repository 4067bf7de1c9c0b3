"""The setup of an experiment: gravity, clocks and crane from the command line."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, get_args

from cranedyn.clocks import clocks
from cranedyn.command import Parser
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.integrators import rk4, semi_implicit_euler
from cranedyn.errors import DataError
from cranedyn.interfaces import (
    Controller,
    Disturbance,
    Drive,
    EngineName,
    Monitor,
    Reference,
    State,
    Validity,
)
from cranedyn.model.crane import STANDARD_GRAVITY, Crane
from cranedyn.model.load import load_crane
from cranedyn.model.options import add_values, parse_values
from cranedyn.simulation.simulate import simulate
from experiments.harness.progress import ProgressReporter

INTEGRATORS = {"euler": semi_implicit_euler, "rk4": rk4}
"""Stepping rules by their names on the command line."""


def add_setup(parser: Parser, *fixed: str) -> None:
    """Add the arguments of the setup: gravity, both clocks, and numbers of the crane except those
    that the experiment sets itself.
    """
    parser.set_defaults(fixed=fixed)
    add = parser.common.add_argument
    text = "gravity of the world [m/s²]; the article's was 9.8"
    add("--gravity", type=float, default=STANDARD_GRAVITY, metavar="G", help=text)
    add("--dt", type=float, default=5e-4, help="physics step [s]")
    text = "time between control instants [s], a multiple of dt"
    add("--control-period", type=float, default=5e-3, metavar="T", help=text)
    text = (
        "stepping rule: semi-implicit Euler, for which the claims are made, or rk4, under "
        "which they are not judged"
    )
    add("--integrator", choices=INTEGRATORS, default="euler", help=text)
    text = (
        "where a joint leaves its range, the rope would have to push, the load swings to 90 "
        "degrees or touches the ground: stop, "
        "let buffers end the ranges of the drives, or mark it and go on"
    )
    add("--validity", choices=get_args(Validity), default="stop", help=text)
    add_values(parser.common, "numbers of the crane, see cranedyn describe --list")


@dataclass(frozen=True, eq=False)
class PlannedRun:
    """A run that is described and not made yet: what it is, but for clocks and engine.

    Whoever runs it elsewhere, as in another simulator, reads this; `Setup.make` makes it here.

    Attributes:
        crane: The crane.
        controller: Its controller.
        reference: Reference of the drives; None holds them where they start.
        start: State at the start.
        duration: Duration [s].
        label: Name of the run while it is made.
        drive: Kind of the drives.
        disturbance: External forces; None for none.
    """

    crane: Crane
    controller: Controller
    reference: Reference | None
    start: State
    duration: float
    label: str
    drive: Drive = "effort"
    disturbance: Disturbance | None = None


@dataclass(frozen=True)
class Setup:
    """The world of an experiment.

    Attributes:
        gravity: Gravity [m/s²].
        values: Numbers of the crane that differ from its defaults, by name.
        dt: Physics step [s].
        control_period: Time between control instants [s].
        validity: What to do where the model ceases to hold, see
            `cranedyn.simulation.simulate.simulate`.
        engine: The engine that computes a step. Ground and ropes that may go slack are computed by
            the compiled engine also where this is "pinocchio".
        integrator: The stepping rule, by its name in `INTEGRATORS`.
        reporter: Shows progress.

    Raises:
        OutOfRange: If the physics step or the control period is out of range.
    """

    gravity: float = STANDARD_GRAVITY
    values: Mapping[str, object] = field(default_factory=dict)
    dt: float = 5e-4
    control_period: float = 5e-3
    validity: Validity = "stop"
    engine: EngineName = "pinocchio"
    integrator: str = "euler"
    reporter: ProgressReporter = field(default_factory=ProgressReporter)

    def __post_init__(self) -> None:
        """Check the clocks."""
        clocks(self.control_period, self.dt, self.control_period)

    @cached_property
    def crane(self) -> Crane:
        """The crane of this world."""
        return self.variant()

    def variant(self, **values: object) -> Crane:
        """Return the crane of this world with some more numbers changed."""
        return load_crane(gravity=self.gravity, values={**self.values, **values})

    @property
    def engine_of_runs(self) -> EngineName | None:
        """The engine to hand to `cranedyn.simulation.simulate.simulate`.

        It is None where Pinocchio is asked for: `simulate` then takes the compiled engine for
        ground and for ropes that stretch or may go slack, which Pinocchio does not compute.
        """
        return None if self.engine == "pinocchio" else self.engine

    def make(self, planned: PlannedRun) -> Trajectory:
        """Make a planned run, see `simulate`."""
        return self.simulate(
            planned.crane,
            planned.controller,
            planned.reference,
            start=planned.start,
            duration=planned.duration,
            label=planned.label,
            drive=planned.drive,
            disturbance=planned.disturbance,
        )

    def simulate(
        self,
        crane: Crane,
        controller: Controller,
        reference: Reference | None,
        *,
        start: State,
        duration: float,
        label: str,
        **options: Any,
    ) -> Trajectory:
        """Run a crane on the clocks of this world, with progress under a label; further options are
        those of `cranedyn.simulation.simulate.simulate`.
        """
        return simulate(
            crane,
            controller,
            reference,
            start=start,
            duration=duration,
            dt=self.dt,
            control_period=self.control_period,
            engine=self.engine_of_runs,
            integrator=INTEGRATORS[self.integrator],
            monitors=self.monitors(label, duration),
            # An experiment may ask for another validity than the command line.
            **{"validity": self.validity, **options},
        )

    def monitors(self, label: str, duration: float) -> list[Monitor]:
        """Return what shows the progress of a run of a duration [s] under a label; an empty list
        where nothing is shown.
        """
        show = self.reporter.run(label, duration)
        return [] if show is None else [lambda row, t, state: show(t)]

    def judged(self, holds: bool) -> bool | None:
        """Return the verdict of a claim about numbers that the article published.

        Args:
            holds: Whether it holds in this world.

        Returns:
            The same; None, for not judged, unless gravity is the article's 9.8 m/s² and everything
            else the default. Engines agree to round-off, so any may be used.
        """
        article = replace(Setup(9.8), engine=self.engine, reporter=self.reporter)
        return bool(holds) if self == article else None

    def parameters(self) -> dict[str, object]:
        """Return the numbers of this world, with units in the names."""
        return {
            "gravity_m_s2": self.gravity,
            "dt_s": self.dt,
            "control_period_s": self.control_period,
            "validity": self.validity,
            "engine": self.engine,
            "integrator": self.integrator,
            **self.values,
        }


def setup_of(options: argparse.Namespace, reporter: ProgressReporter) -> Setup:
    """Return the setup of a command line, the default one if the experiment has no such arguments.

    Raises:
        DataError: If a number of the crane is given twice, or the experiment sets it itself.
    """
    if not hasattr(options, "gravity"):
        return Setup(engine=options.engine, reporter=reporter)
    values = parse_values(options.values)
    for name in options.fixed:
        if name in values:
            raise DataError(
                f"{name} is set by the experiment {options.experiment} itself; leave it out of "
                "--set."
            )
    return Setup(
        gravity=options.gravity,
        values=values,
        dt=options.dt,
        control_period=options.control_period,
        validity=options.validity,
        engine=options.engine,
        integrator=options.integrator,
        reporter=reporter,
    )
