"""Gazebo Classic: a folder with the crane, the world, a plugin that runs an affine controller from
tables, and what builds and runs it.

The runs are those of the experiments, by name, and the swing of any other crane. From Python,
`cranedyn.bridges.gazebo.export` takes any program.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NoReturn

from cranedyn.bridges.gazebo import SOLVERS, Program, export
from cranedyn.controllers import hold_controller
from cranedyn.errors import DataError, UnknownName
from cranedyn.model.crane import STANDARD_GRAVITY, Crane
from cranedyn.model.description import parse_values
from cranedyn.model.options import crane_from_options
from experiments import a1, a2, a3, energy
from experiments.harness import Setup
from experiments.scenarios.moves import COMBINED
from experiments.scenarios.perturbations import make
from experiments.scenarios.strategies import FLAT, STRATEGIES

TARGET = "DIR"
EXAMPLE = "gazebo_a1 --experiment a1"

RUNS = ("a1", "a2", "a3", "swing", "move")
"""Free swing, hoisting, slewing, the swing of the energy ledger, and the combined move of the
control experiments."""

_LENGTH = 15.0


class _Asked(Exception):
    """What an experiment wanted to run."""

    def __init__(self, program: Program) -> None:
        super().__init__()
        self.program = program


@dataclass(frozen=True)
class _Asking(Setup):
    """A setup in which an experiment gets no further than to say what it wants to run."""

    def simulate(
        self,
        crane: Any,
        controller: Any,
        reference: Any,
        *,
        start: Any,
        duration: float,
        label: str,
        **options: Any,
    ) -> NoReturn:
        clocks = (self.dt, self.control_period)
        drive = options.get("drive", "effort")
        raise _Asked(Program(crane, controller, reference, start, duration, *clocks, drive))


def program(
    name: str, setup: Setup, *, length: float | None = None, strategy: str | None = None
) -> Program:
    """Return a run of the experiments by its name.

    Args:
        name: One of `RUNS`.
        setup: Its gravity, crane and clocks.
        length: Cable length of a1 and swing [m], 15 by default.
        strategy: Of a move, one of `STRATEGIES`, flat + LQR by default.

    Raises:
        UnknownName: If there is no such run or strategy.
        DataError: If an argument has no effect on this run.
    """
    if name not in RUNS:
        raise UnknownName("run", name, RUNS)
    for flag, value, users in (
        ("--length", length, ("a1", "swing")),
        ("--strategy", strategy, ("move",)),
    ):
        if value is not None and name not in users:
            raise DataError(f"{flag} has no effect on the run {name}; leave it out.")
    asking = _Asking(**{field.name: getattr(setup, field.name) for field in fields(setup)})
    along = _LENGTH if length is None else length
    try:
        if name == "a1":
            a1.run(asking, along)
        elif name == "a2":
            a2.run(asking)
        elif name == "a3":
            a3.run(asking)
        elif name == "swing":
            energy.run(asking, asking.crane, energy.SWING, along, energy.AUDIT)
        elif (strategy := strategy or FLAT) in STRATEGIES:
            make(asking, COMBINED, STRATEGIES[strategy](asking, COMBINED))
        else:
            raise UnknownName("strategy", strategy, STRATEGIES)
    except _Asked as asked:
        return asked.program
    raise AssertionError(name)  # every experiment runs something


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments beside the folder and the crane."""
    add = parser.add_argument
    text = "a1 (default), a2, a3, move or swing (another crane)"
    add("--experiment", metavar="RUN", help=text)
    text = f"cable length of a1 and swing [m] (default {_LENGTH:g})"
    add("--length", type=float, metavar="L", help=text)
    text = "strategy of a move, such as 'flat + LQR' (default), see experiments.compare"
    add("--strategy", metavar="NAME", help=text)
    add("--solver", default="world", choices=SOLVERS, help="ODE's solver")
    text = "ODE's error reduction in a step"
    add("--erp", type=float, default=0.8, metavar="SHARE", help=text)
    text = "control instants from one row of the log to the next"
    add("--every", type=int, default=1, metavar="N", help=text)
    text = "set the rates of the passive joints to zero at every step"
    add("--overwritten", action="store_true", help=text)


def run(options: argparse.Namespace) -> Path:
    """Write the run that the command line names, and return its folder."""
    name = options.experiment
    choices = {"length": options.length, "strategy": options.strategy}
    if options.urdf is None and options.machine is None:
        setup = Setup(options.gravity, parse_values(options.values))
        handed_on = program(name or "a1", setup, **choices)
    elif name in (None, "swing") and not any(choices.values()):
        handed_on = _swing(crane_from_options(options))
    else:
        raise DataError("Another crane swings; leave --experiment, --length and --strategy out.")
    switches = {name: getattr(options, name) for name in ("solver", "erp", "every", "overwritten")}
    return export(options.target, handed_on, **switches)


def _swing(crane: Crane) -> Program:
    """Return the free swing of any crane, its drives held."""
    swings = {crane.layout.symbols[i]: energy.SWING for i in crane.swings[:1].tolist()}
    return Program(
        crane,
        hold_controller(crane, gravity=STANDARD_GRAVITY),
        None,
        crane.state(**swings),
        energy.AUDIT,
    )
