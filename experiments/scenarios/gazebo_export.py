"""Gazebo Classic: a folder with the crane, the world, a plugin that runs an affine controller from
tables, and what builds and runs it.

The runs are those of the experiments; from Python, `cranedyn.bridges.gazebo.export` takes any
program.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from cranedyn.bridges.gazebo import SOLVERS, export
from cranedyn.errors import DataError
from cranedyn.model.description import parse_values
from experiments import harness
from experiments.scenarios import programs

TARGET = "DIR"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments beside the folder and the crane."""
    parser.add_argument(
        "--experiment", default="a1", metavar="RUN", help="what to run: a1, a2, a3, swing or move"
    )
    parser.add_argument(
        "--length", type=float, metavar="L", help="cable length of a1 and swing [m] (default 15)"
    )
    parser.add_argument(
        "--strategy",
        metavar="NAME",
        help="strategy of a move, such as 'flat + LQR' (default), see experiments.compare",
    )
    parser.add_argument("--solver", default="world", choices=SOLVERS, help="ODE's solver")
    parser.add_argument(
        "--erp", type=float, default=0.8, metavar="SHARE", help="ODE's error reduction in a step"
    )
    parser.add_argument(
        "--every",
        type=int,
        default=1,
        metavar="N",
        help="control instants from one row of the log to the next",
    )
    parser.add_argument(
        "--overwritten",
        action="store_true",
        help="set the rates of the passive joints to zero at every step",
    )


def run(options: argparse.Namespace) -> Path:
    """Write the run that the command line names, and return its folder."""
    if options.urdf is not None:
        raise DataError(
            "--urdf has no effect here: the runs are those of this project's crane; from Python, "
            "export takes any program."
        )
    setup = harness.Setup(options.gravity, parse_values(options.values))
    program = programs.program(
        options.experiment, setup, length=options.length, strategy=options.strategy
    )
    return export(
        options.target,
        program,
        solver=options.solver,
        erp=options.erp,
        every=options.every,
        overwritten=options.overwritten,
    )
