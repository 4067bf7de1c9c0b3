"""C99 for microcontrollers and other programs: the crane, and a controller, each as a struct and
functions without heap and libraries, with a test against numbers of Python.

``python -m cranedyn export c DIR`` writes them.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from cranedyn.checks import check_choice
from cranedyn.clocks import clocks
from cranedyn.command import command_line
from cranedyn.compiled.block import FunctionBlock, Variable
from cranedyn.compiled.c_text import Precision, c_header, c_source
from cranedyn.compiled.crane_block import COMMUNICATION, crane_block
from cranedyn.dynamics.converters import converters_of_run
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.export.controller_block import controller_block, reference_calls
from cranedyn.export.controller_options import (
    PERIOD,
    add_controller_options,
    controller_from_options,
)
from cranedyn.export.target import check_free, name_default_rates, new_folder
from cranedyn.interfaces import Drive, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.options import crane_from_options
from cranedyn.simulation.simulate import simulate

TARGET = "DIR"
"""What the command line calls the target of the export."""

EXAMPLE = "controller_c --controller lqr"
"""Example of a target, for the help of the command line."""

TOLERANCE = {"double": 1e-12, "single": 1e-3, "predictive": 1e-8}
"""Largest difference between C and Python, as a share of the larger of 1 and the largest value.

In double precision it is round-off of sums in another order, in single precision that of 2,000
physics steps. Predictive control has the tolerance of its optimisation, since round-off may decide
which of its iterations is the last.
"""

_TEMPLATES = Path(__file__).with_name("templates")
"""Folder of the texts that do not depend on the crane."""

_TEST_ROWS = 200
"""Number of rows of the test of a crane."""

_ROWS_OF_COMMAND = 20
"""Number of rows for which a command of that test holds."""


@dataclass(frozen=True)
class BlockTest:
    """Test of a block: for each row it gets inputs, is called, and must then have expected values.

    Attributes:
        block: The block.
        calls: Number of calls of its step for each row.
        inputs: Values of its inputs, shape (rows, inputs).
        names: Names of the variables that are compared.
        expected: Values of these after the calls, shape (rows, names).
    """

    block: FunctionBlock
    calls: int
    inputs: np.ndarray
    names: Sequence[str]
    expected: np.ndarray


def export(
    crane: Crane,
    folder: str | Path,
    controller: Any = None,
    *,
    drive: Drive = "effort",
    dt: float = 5e-4,
    control_period: float = 5e-3,
    duration: float = 30.0,
    integrator: Integrator = semi_implicit_euler,
    precision: Precision = "double",
) -> Path:
    """Write a crane and a controller as C99.

    Args:
        crane: The crane.
        folder: New folder.
        controller: The controller, see `cranedyn.export.controller_block`; None for none.
        drive: What the controller commands, and the crane takes.
        dt: Physics step [s].
        control_period: Time from one call of the controller to the next [s].
        duration: Time that tables of the controller cover [s].
        integrator: The stepping rule.
        precision: Type of all numbers.

    Raises:
        DataError: If the folder exists or cannot be written, or the controller cannot be exported.
        OutOfRange: If a number is out of range.
    """
    check_choice("precision", precision, Precision)
    clocks(control_period, dt, control_period)
    check_free(Path(folder))
    tests = [crane_test(crane, drive, dt, integrator)]
    if controller is not None:
        block = controller_block(
            crane, controller, drive=drive, control_period=control_period, duration=duration
        )
        inputs, outputs = reference_calls(crane, controller, block)
        names = [variable.name for variable in block.of_kind("output")]
        tests.append(BlockTest(block, 1, inputs, names, outputs))
    with new_folder(Path(folder)) as draft:
        for test in tests:
            name = test.block.name
            (draft / f"{name}.h").write_text(c_header(test.block, precision))
            (draft / f"{name}.c").write_text(c_source(test.block, precision))
        (draft / "test.c").write_text(_test_program(tests, precision))
        sources = " ".join(f"{test.block.name}.c" for test in tests)
        cmake = (_TEMPLATES / "CMakeLists.txt.c99").read_text().replace("SOURCES", sources)
        (draft / "CMakeLists.txt").write_text(cmake)
        (draft / "README.md").write_text(_readme(tests, precision))
    return Path(folder)


def crane_test(crane: Crane, drive: Drive, dt: float, integrator: Integrator) -> BlockTest:
    """Return a test of a crane's block: its state in a run of `simulate` under random commands.

    Args:
        crane: The crane.
        drive: What the drives take.
        dt: Physics step [s].
        integrator: The stepping rule.
    """
    block = crane_block(crane, drive=drive, dt=dt, integrator=integrator)
    rng = np.random.default_rng(0)
    m = crane.layout.m
    largest = _largest_test_commands(crane, drive)
    changes = rng.uniform(-largest, largest, (_TEST_ROWS // _ROWS_OF_COMMAND, m))
    inputs = np.tile([variable.start for variable in block.of_kind("input")], (_TEST_ROWS, 1))
    commands = inputs[:, :m]  # a view: the commands are the first inputs
    commands += changes.repeat(_ROWS_OF_COMMAND, axis=0)
    period = COMMUNICATION * dt

    def commanded(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        return commands[min(round(t / period), _TEST_ROWS - 1)]

    run = simulate(
        crane,
        commanded,
        duration=_TEST_ROWS * period,
        dt=dt,
        control_period=period,
        drive=drive,
        integrator=integrator,
        validity="mark",
    )
    names = [variable.name for variable in block.of_kind("state")]
    return BlockTest(block, COMMUNICATION, inputs, names, np.hstack([run.q, run.v])[1:])


def _largest_test_commands(crane: Crane, drive: Drive) -> np.ndarray:
    """Return the largest changes of the commands in the test of a crane, shape (m,).

    They are the rates of the converters, or what accelerates each drive by half a rad/s² or m/s²:
    enough to move the crane, and too little to leave its ranges within the test.
    """
    layout = crane.layout
    converters = converters_of_run(crane, drive, None)
    if converters is not None:
        return converters.rates
    if drive == "effort":
        inertia = np.diag(crane.mass_matrix(crane.start.q))[layout.drives]
        return 0.5 * inertia
    return 0.5 * np.ones(layout.m)


def _test_program(tests: Sequence[BlockTest], precision: Precision) -> str:
    """Return the program that compares the blocks with Python."""
    lines = ["/* Compares the blocks with numbers of Python. */", "#include <stdio.h>", ""]
    for test in tests:
        lines.append(f'#include "{test.block.name}.h"')
    failures = []
    for test in tests:
        lines += _test_function(test, precision)
        tolerance = TOLERANCE["predictive" if test.block.routines else precision]
        # Written with "not <=", a difference that is NaN fails, too.
        failures.append(f"!(test_{test.block.name}() <= {tolerance!r})")
    any_fails = " || ".join(failures)
    return "\n".join([*lines, "", "int main(void) {", f"  return {any_fails};", "}", ""])


def _test_function(test: BlockTest, precision: Precision) -> list[str]:
    """Return the lines of a test in C: its numbers, and the function that returns the largest
    difference.
    """
    block = test.block
    number = "double" if precision == "double" else "float"
    lines = []
    for title, rows in (("inputs", test.inputs), ("expected", test.expected)):
        size = f"[{len(rows)}][{rows.shape[1]}]"
        lines += ["", f"static const double {block.name}_{title}{size} = {{"]
        for row in rows.tolist():
            lines.append(f"  {{{_numbers(row)}}},")
        lines.append("};")

    assignments = []
    for i, variable in enumerate(block.of_kind("input")):
        assignments.append(f"    block.{variable.name} = ({number})in[{i}];")
    largest_values = np.fmax(np.abs(test.expected).max(axis=0), 1.0)
    terms = {
        "name": block.name,
        "number": number,
        "rows": len(test.inputs),
        "calls": test.calls,
        "sizes": _numbers(largest_values.tolist()),
        "setting": "\n".join(assignments),
        "found": ", ".join(f"block.{name}" for name in test.names),
        "values": len(test.names),
        "tables": sum(table.size for table in block.tables.values()),
    }
    template = Template((_TEMPLATES / "test_block.c.in").read_text())
    return [*lines, "", template.substitute(terms).removesuffix("\n")]


def _numbers(values: Sequence[float]) -> str:
    """Return numbers as a list in C, with as many digits as tell them from all other doubles."""
    return ", ".join(repr(value) for value in values)


def _readme(tests: Sequence[BlockTest], precision: Precision) -> str:
    """Return the README of the folder: when to call each block, with its inputs and outputs."""
    lines = []
    for test in tests:
        block = test.block
        lines += [f"## {block.name}.c", "", block.about, ""]
        lines += [f"`{block.name}_step` is called every {block.period:g} s.", ""]
        lines += [f"Inputs: {_listed(block.of_kind('input'))}.", ""]
        lines += [f"Outputs: {_listed(block.of_kind('output'))}.", ""]
        lines += [block.at_fault, ""]
        for name, identifier in block.renamed.items():
            lines += [f"`{name}` is called `{identifier}`.", ""]
    text = (_TEMPLATES / "c_readme.md").read_text()
    name = tests[-1].block.name
    return text.replace("NAME", name).replace("PRECISION", precision) + "\n".join(lines)


def _listed(variables: Sequence[Variable]) -> str:
    """Return the names of variables with their units, in Markdown."""
    entries = []
    for variable in variables:
        unit = f" [{variable.unit}]" if variable.unit else ""
        entries.append(f"`{variable.name}`{unit}")
    return ", ".join(entries)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments beside the folder and the crane."""
    add_controller_options(
        parser,
        "controller beside the crane",
        "; of a crane without controller effort",
        default=None,
    )
    parser.add_argument("--single", action="store_true", help="numbers in single precision")
    parser.add_argument(
        "--period",
        type=float,
        default=PERIOD,
        metavar="T",
        help="time from one call of the controller to the next [s]",
    )
    parser.add_argument("--dt", type=float, default=5e-4, metavar="DT", help="physics step [s]")


def run(options: argparse.Namespace) -> Path:
    """Write what the command line describes, and return its folder."""
    crane = crane_from_options(options)
    if options.controller is not None:
        controller, drive = controller_from_options(options, crane, options.period)
    else:
        controller = None
        drive = options.drive or "effort"
        if drive != "effort":
            name_default_rates(crane)
    return export(
        crane,
        options.target,
        controller,
        drive=drive,
        dt=options.dt,
        control_period=options.period,
        precision="single" if options.single else "double",
    )


def next_commands(options: argparse.Namespace) -> list[str]:
    """Return command lines that work with what `run` has written."""
    build = options.target / "build"
    compile_line = command_line("cmake", "--build", build)
    test_line = command_line("ctest", "--test-dir", build, "--output-on-failure")
    return [
        command_line("cmake", "-S", options.target, "-B", build),
        f"{compile_line} && {test_line}",
    ]
