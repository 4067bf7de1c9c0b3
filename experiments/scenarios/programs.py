"""The runs of the article, and a move of the control experiments, as folders for Gazebo Classic.

``python -m experiments.scenarios.programs a1_gazebo --run a1`` writes one. Any other run is
exported by `cranedyn.export.gazebo.export`, and the free swing of any crane by ``cranedyn export
gazebo``.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from cranedyn.command import Parser, command
from cranedyn.controllers import hold_controller
from cranedyn.errors import DataError, UnknownName
from cranedyn.export.gazebo import Program, add_world, export_with_options
from cranedyn.model.crane import STANDARD_GRAVITY
from cranedyn.model.options import parse_values
from experiments import a1, a2, a3
from experiments.energy.swing import AUDIT, SWING, planned_free_swing
from experiments.harness import PlannedRun, Setup
from experiments.scenarios.moves import COMBINED
from experiments.scenarios.perturbations import planned_move
from experiments.scenarios.strategies import FLAT, STRATEGIES

RUNS = ("a1", "a2", "a3", "swing", "move")
"""Names of the runs: free swing, hoisting, slewing, the swing of the energy ledger, and the
combined move of the control experiments."""

LENGTH = 15.0
"""Cable length of a1 and swing, unless another is asked for [m]."""


def program(
    name: str, setup: Setup, *, length: float | None = None, strategy: str | None = None
) -> Program:
    """Return a run of the experiments by its name.

    Args:
        name: Name of the run, one of `RUNS`.
        setup: Its gravity, crane and clocks.
        length: Cable length of a1 and swing [m]; None for `LENGTH`.
        strategy: Strategy of a move, one of `STRATEGIES`; None for flat + LQR.

    Raises:
        UnknownName: If there is no such run or strategy.
        DataError: If an argument has no effect on this run.
    """
    if name not in RUNS:
        raise UnknownName("run", name, RUNS)
    if length is not None and name not in ("a1", "swing"):
        raise DataError(f"--length has no effect on the run {name}; leave it out.")
    if strategy is not None and name != "move":
        raise DataError(f"--strategy has no effect on the run {name}; leave it out.")
    length = LENGTH if length is None else length
    strategy = FLAT if strategy is None else strategy
    planned = _planned(name, setup, length, strategy)
    return Program(
        planned.crane,
        planned.controller,
        planned.reference,
        planned.start,
        planned.duration,
        setup.dt,
        setup.control_period,
        planned.drive,
    )


def _planned(name: str, setup: Setup, length: float, strategy: str) -> PlannedRun:
    """Return a run as its experiment plans it."""
    crane = setup.crane
    if name == "a1":
        controller = hold_controller(crane, gravity=STANDARD_GRAVITY)
        return a1.planned_swing(crane, controller, length)
    if name == "a2":
        return a2.planned_hoisting(crane)
    if name == "a3":
        return a3.planned_slewing(crane)
    if name == "swing":
        start = crane.state(l=length, phi=SWING)
        return planned_free_swing(crane, start, AUDIT)
    if strategy not in STRATEGIES:
        raise UnknownName("strategy", strategy, STRATEGIES)
    return planned_move(setup, COMBINED, STRATEGIES[strategy](setup, COMBINED))


def main(argv: Sequence[str] | None = None) -> int:
    """Write the folder of a run; return the exit code."""
    parser = Parser(
        prog="python -m experiments.scenarios.programs",
        description="Write a run of the article as a folder for Gazebo Classic.",
        example="python -m experiments.scenarios.programs a1_gazebo --run a1",
    )
    parser.add_argument("target", metavar="DIR", help="new folder")
    parser.add_argument("--run", required=True, choices=RUNS, help="the run")
    text = f"cable length of a1 and swing [m] (default {LENGTH:g})"
    parser.add_argument("--length", type=float, metavar="L", help=text)
    text = "strategy of a move, such as 'flat + LQR' (default), see experiments.compare"
    parser.add_argument("--strategy", metavar="NAME", help=text)
    text = "gravity [m/s²] (default %(default)s; the article's world has 9.8)"
    parser.add_argument("--gravity", type=float, metavar="G", default=STANDARD_GRAVITY, help=text)
    text = "numbers of the crane, as payload_mass:=2000"
    parser.add_argument("--set", dest="values", nargs="+", metavar="N:=V", default=[], help=text)
    add_world(parser)

    def write() -> int:
        options = parser.parse_args(argv)
        setup = Setup(options.gravity, parse_values(options.values))
        planned = program(options.run, setup, length=options.length, strategy=options.strategy)
        folder = export_with_options(options, planned)
        print(f"Written to {folder}; run.sh there builds and runs it.")
        return 0

    return command(write)


if __name__ == "__main__":
    sys.exit(main())
