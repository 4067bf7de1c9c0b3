"""Where an experiment takes place: gravity, clocks and crane from the command line, data from
elsewhere, and who watches.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import get_args

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from cranedyn.clocks import clocks
from cranedyn.data.external import parse_sources, read_external
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.converters import Converters
from cranedyn.dynamics.integrators import rk4, semi_implicit_euler
from cranedyn.errors import DataError, quoted
from cranedyn.interfaces import (
    Controller,
    Disturbance,
    Drive,
    EngineName,
    Reference,
    State,
    Validity,
)
from cranedyn.model.crane import STANDARD_GRAVITY, Crane
from cranedyn.model.description import add_values, parse_values
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate
from experiments.harness.arguments import ROS, add_mode
from experiments.harness.lines import Lines

_LARGEST, _FASTEST, _LONGEST_GAP = 1e6, 10.0, 0.5
"""Of what was recorded elsewhere: largest number in any unit, fastest angle [rad/s], and longest
time from row to row [s]."""

_BEAT = 0.5
"""How much time passes in a run before its progress is shown again [s]."""


INTEGRATORS = {"euler": semi_implicit_euler, "rk4": rk4}
"""Stepping rules by their names on the command line."""


def add_setup(made: argparse.ArgumentParser, *fixed: str) -> None:
    """Add the arguments of the world: gravity, the two clocks, and the numbers of the crane but
    those fixed by the experiment itself.
    """
    made.set_defaults(fixed=fixed)
    made.add_argument(
        "--gravity",
        type=float,
        default=STANDARD_GRAVITY,
        metavar="G",
        help="gravity of the world [m/s²]; the article's was 9.8",
    )
    made.add_argument("--dt", type=float, default=5e-4, help="physics step [s]")
    made.add_argument(
        "--control-period",
        type=float,
        default=5e-3,
        metavar="T",
        help="time between control instants [s], a multiple of dt",
    )
    made.add_argument(
        "--integrator",
        choices=INTEGRATORS,
        default="euler",
        help="stepping rule: semi-implicit Euler, for which the claims are made, or rk4, under "
        "which they are not judged",
    )
    made.add_argument(
        "--validity",
        choices=get_args(Validity),
        default="stop",
        help="where a joint leaves its range, the rope would have to push, the load swings to 90 "
        "degrees or touches the ground: stop, "
        "let buffers end the ranges of the drives, or mark it and go on",
    )
    add_values(made, "numbers of the crane, see python -m cranedyn.model.description --list")


def add_files(made: argparse.ArgumentParser, columns: Sequence[str], *uses: str) -> None:
    """Add the argument for files recorded elsewhere, and say which others their analysis uses."""
    add_mode(made, "files", *uses, "columns", "joints")
    text = (
        f"analyse files with columns {', '.join(columns)} instead of simulating: CSV, Parquet, "
        "or .mcap and .bag with joint states"
    )
    made.add_argument("--from", dest="files", nargs="+", metavar="FILE", help=text)
    made.add_argument(
        "--columns",
        nargs="+",
        action="extend",
        default=[],
        metavar="OURS=NAME[UNIT]",
        help="what columns of CSV and Parquet files are called, and their units where they are "
        "others than ours, as phi_rad=Angle[deg] "
        "t_s=time[ms]",
    )
    named = "names of joints in .mcap and .bag files, where they are not those of this crane"
    made.add_argument("--joints", nargs="+", default=[], metavar="l=NAME", help=named)


@dataclass(frozen=True)
class ProgressReporter:
    """Shows how far a run is: as bars on a terminal, else in a plain line now and then, or not at
    all.

    Attributes:
        progress: The bars.
        lines: The lines.
    """

    progress: Progress | None
    lines: Lines | None = None

    def run(self, name: str, duration: float) -> Callable[[float], None] | None:
        """A callback for `simulate`, or None where nobody watches."""
        progress = self.progress
        if progress is None:
            return None if self.lines is None else self.lines.run(name, duration)
        task, shown = progress.add_task(name, total=duration, speed=""), -math.inf

        def update(t: float) -> None:
            nonlocal shown
            if t > min(shown + _BEAT, duration) - 1e-9:
                shown, elapsed = t, progress.tasks[task].elapsed or 0.0
                progress.update(
                    task,
                    completed=t,
                    speed=f"{t:6.1f} s, {t / elapsed:.0f}x real time" if elapsed > 0.1 else "",
                )

        return update

    def count(self, name: str, total: int) -> Callable[[int], None]:
        """A callback for how many of several tasks are done."""
        progress = self.progress
        if progress is None:
            return (lambda done: None) if self.lines is None else self.lines.count(name, total)
        task = progress.add_task(name, total=total, speed="")
        return lambda done: progress.update(task, completed=done, speed=f"{done} of {total}")


@contextmanager
def reporting() -> Iterator[ProgressReporter]:
    """A watcher for as long as the context lasts."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield ProgressReporter(None, Lines())
        return
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[speed]}"),
        TimeElapsedColumn(),
        console=console,
        transient=True,
    ) as progress:
        yield ProgressReporter(progress)


@dataclass(frozen=True)
class Setup:
    """Where an experiment takes place.

    Attributes:
        gravity: Gravity [m/s²].
        values: Numbers of the crane that differ from its defaults, by name.
        dt: Physics step [s].
        control_period: Time between control instants [s].
        validity: What to do where the model ceases to hold, see
            `cranedyn.simulation.simulate.simulate`.
        engine: What computes a step.
        integrator: The stepping rule, by its name among `INTEGRATORS`.
        reporter: Shows progress.

    Raises:
        OutOfRange: If the physics step or the control period is none that a run can have.
    """

    gravity: float = STANDARD_GRAVITY
    values: Mapping[str, object] = field(default_factory=dict)
    dt: float = 5e-4
    control_period: float = 5e-3
    validity: Validity = "stop"
    engine: EngineName = "pinocchio"
    integrator: str = "euler"
    reporter: ProgressReporter = field(default_factory=lambda: ProgressReporter(None))

    def __post_init__(self) -> None:
        """Judge the clocks before anything is planned by them."""
        clocks(self.control_period, self.dt, self.control_period)

    @cached_property
    def crane(self) -> Crane:
        """The crane of this world."""
        return self.variant()

    def variant(self, **values: object) -> Crane:
        """The crane of this world with some more numbers changed."""
        return load_crane(gravity=self.gravity, values={**self.values, **values})

    def simulate(
        self,
        crane: Crane,
        controller: Controller,
        reference: Reference | None,
        *,
        start: State,
        duration: float,
        label: str,
        t_start: float = 0.0,
        drive: Drive | Converters = "effort",
        disturbance: Disturbance | None = None,
        validity: Validity | None = None,
    ) -> Trajectory:
        """Run a crane on the clocks of this world, with progress under a label, and with its watch
        if none is given.
        """
        show = self.reporter.run(label, duration)
        return simulate(
            crane,
            controller,
            reference,
            start=start,
            t_start=t_start,
            duration=duration,
            drive=drive,
            disturbance=disturbance,
            validity=self.validity if validity is None else validity,
            dt=self.dt,
            control_period=self.control_period,
            engine=self.engine,
            integrator=INTEGRATORS[self.integrator],
            monitors=[] if show is None else [lambda row, t, state: show(t)],
        )

    def judged(self, holds: bool) -> bool | None:
        """Whether a claim about published numbers holds; None unless gravity is the article's 9.8
        m/s² and all but engine the default.
        """
        return (
            bool(holds)
            if self == replace(Setup(9.8), engine=self.engine, reporter=self.reporter)
            else None
        )

    def parameters(self) -> dict[str, object]:
        """What this world is made of, with units in the names."""
        clocks = {"dt_s": self.dt, "control_period_s": self.control_period}
        means = {"validity": self.validity, "engine": self.engine, "integrator": self.integrator}
        return {"gravity_m_s2": self.gravity, **clocks, **means, **self.values}


def setup_of(options: argparse.Namespace, reporter: ProgressReporter) -> Setup:
    """The world that the command line describes.

    Raises:
        DataError: If a number of the crane is given twice, or would be overridden by the
            experiment.
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
    means = options.validity, options.engine, options.integrator
    return Setup(options.gravity, values, options.dt, options.control_period, *means, reporter)


def recorded(
    file: str, columns: Sequence[str], sources: Sequence[str] = (), joints: Sequence[str] = ()
) -> dict[str, np.ndarray]:
    """Columns of a file recorded elsewhere, time `t_s` and the cable length `l_m` among them.

    Args:
        file: CSV, Parquet, or a recording of ROS (.mcap, .bag).
        columns: Our names of the columns.
        sources: What they are called in CSV and Parquet, as on the command line, see
            `cranedyn.data.external.parse_sources`.
        joints: Names of joints in a recording of ROS, such as ``l=hoist``.

    Raises:
        DataError: As `read_external`, if a cable is shorter than a millimetre, an angle changes by
            more than 10 rad/s, any other number is beyond a million of its unit, or rows are more
            than half a second apart.
    """
    if Path(file).suffix in ROS:
        data = _of_ros(file, columns, joints)
    else:
        data = read_external(file, columns, parse_sources(sources))
    for name, values in data.items():
        high = _FASTEST if name.endswith("_rad_s") else _LARGEST
        low = 1e-3 if name == "l_m" else -high
        for extreme in (values.min(), values.max()):
            if not low <= extreme <= high:
                raise DataError(
                    f"{file}: {name} is {extreme:g} in some row; allowed is {low:g} to {high:g}."
                )
    if (gap := np.diff(data["t_s"]).max()) > _LONGEST_GAP:
        raise DataError(
            f"{file}: t_s leaves a gap of {gap:g} s; allowed are {_LONGEST_GAP:g} s from row to "
            "row."
        )
    return data


def _of_ros(file: str, columns: Sequence[str], joints: Sequence[str]) -> dict[str, np.ndarray]:
    """Columns from the joint states of a recording."""
    from cranedyn.bridges import bags

    names: dict[str, str] = {}
    for pair in joints:
        symbol, mark, name = pair.partition("=")
        if not mark or not name or symbol in names:
            raise DataError(
                f"{quoted(pair)} among --joints is not of the form l=NAME, each coordinate once."
            )
        names[symbol] = name
    return bags.read_columns(file, columns, names)


@contextmanager
def analysing(file: str) -> Iterator[None]:
    """Name the file in what is wrong with its content."""
    try:
        yield
    except DataError as error:
        raise DataError(f"{file}: {error}") from error
