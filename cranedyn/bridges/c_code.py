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
from typing import Any, get_args

import numpy as np

from cranedyn.bridges.controller_block import controller_block, vectors
from cranedyn.bridges.target import check_free, name_default_rates, new_folder
from cranedyn.bridges.usual_controllers import CONTROLLERS
from cranedyn.checks import check_choice
from cranedyn.clocks import clocks
from cranedyn.compiled.block import FunctionBlock
from cranedyn.compiled.c_text import Precision, c_header, c_source
from cranedyn.compiled.crane_block import COMMUNICATION, crane_block
from cranedyn.dynamics.converters import fitting
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.interfaces import Drive
from cranedyn.model.crane import Crane
from cranedyn.model.options import crane_from_options
from cranedyn.simulation.simulate import simulate

TARGET = "DIR"
EXAMPLE = "controller_c --controller lqr"
"""Target of the command line."""

TOLERANCE = {"double": 1e-12, "single": 1e-3, "predictive": 1e-8}
"""Largest difference between C and Python over the larger of 1 and the largest value: round-off of
sums in another order; in single precision that of 2,000 physics steps; of predictive control the
tolerance of an optimisation, whose last iteration round-off may decide."""

_TEMPLATES = Path(__file__).with_name("templates")


@dataclass(frozen=True)
class BlockTest:
    """Rows of a test: inputs, calls of step, and expected values.

    Attributes:
        block: The block.
        calls: Calls of step for each row.
        inputs: Shape (rows, inputs).
        names: Names of the expected values.
        expected: Shape (rows, names).
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
        controller: The controller, see `cranedyn.bridges.controller_block`; None for none.
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
        inputs, outputs = vectors(crane, controller, block)
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
    """Return a test of a crane's block: its state in a run of `simulate` under random commands."""
    block = crane_block(crane, drive=drive, dt=dt, integrator=integrator)
    rng = np.random.default_rng(0)
    layout = crane.layout
    rows = 200
    inputs = np.tile([variable.start for variable in block.of_kind("input")], (rows, 1))
    commands = inputs[:, : layout.m]
    inertia = np.diag(crane.mass_matrix(crane.start.q))[layout.drives]
    drives = fitting(crane, drive, None)
    size = drives.rates if drives else 0.5 * (inertia if drive == "effort" else np.ones(layout.m))
    commands += rng.uniform(-size, size, (rows // 20, layout.m)).repeat(20, axis=0)
    period = COMMUNICATION * dt
    run = simulate(
        crane,
        lambda t, state, setpoint: commands[min(round(t / period), rows - 1)],
        duration=rows * period,
        dt=dt,
        control_period=period,
        drive=drive,
        integrator=integrator,
        validity="mark",
    )
    names = [variable.name for variable in block.of_kind("state")]
    return BlockTest(block, COMMUNICATION, inputs, names, np.hstack([run.q, run.v])[1:])


def _test_program(tests: Sequence[BlockTest], precision: Precision) -> str:
    """Return the program that compares the blocks with Python."""
    number = "double" if precision == "double" else "float"
    lines = ["/* Compares the blocks with numbers of Python. */", "#include <stdio.h>", ""]
    lines += [f'#include "{test.block.name}.h"' for test in tests]
    for test in tests:
        name = test.block.name
        for title, rows in (("inputs", test.inputs), ("expected", test.expected)):
            lines += ["", f"static const double {name}_{title}[{len(rows)}][{rows.shape[1]}] = {{"]
            lines += [f"  {{{', '.join(map(repr, row))}}}," for row in rows.tolist()] + ["};"]
        inputs = enumerate(v.name for v in test.block.of_kind("input"))
        terms = {
            **{"name": name, "number": number, "rows": len(test.inputs), "calls": test.calls},
            "sizes": ", ".join(map(repr, np.fmax(np.abs(test.expected).max(axis=0), 1.0).tolist())),
            "setting": "\n".join(f"    block.{v} = ({number})in[{i}];" for i, v in inputs),
            "found": ", ".join(f"block.{name}" for name in test.names),
            "values": len(test.names),
            "tables": sum(table.size for table in test.block.tables.values()),
        }
        lines += ["", Template((_TEMPLATES / "test_block.c.in").read_text()).substitute(terms)[:-1]]
    bounds = [TOLERANCE["predictive" if t.block.routines else precision] for t in tests]
    pairs = zip(tests, bounds, strict=True)
    worst = " || ".join(f"!(test_{test.block.name}() <= {bound!r})" for test, bound in pairs)
    return "\n".join([*lines, "", "int main(void) {", f"  return {worst};", "}", ""])


def _readme(tests: Sequence[BlockTest], precision: Precision) -> str:
    """Return the page of the folder."""
    lines = []
    for test in tests:
        block = test.block
        inputs, outputs = (
            ", ".join(f"`{v.name}`{f' [{v.unit}]' if v.unit else ''}" for v in block.of_kind(kind))
            for kind in ("input", "output")
        )
        lines += [f"## {block.name}.c", "", block.about, ""]
        lines += [f"`{block.name}_step` is called every {block.period:g} s.", ""]
        lines += [f"Inputs: {inputs}.", "", f"Outputs: {outputs}.", "", block.at_fault, ""]
        for name, identifier in block.renamed.items():
            lines += [f"`{name}` is called `{identifier}`.", ""]
    text = (_TEMPLATES / "c_readme.md").read_text()
    name = tests[-1].block.name
    return text.replace("NAME", name).replace("PRECISION", precision) + "\n".join(lines)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments beside the folder and the crane."""
    add = parser.add_argument
    either = parser.add_mutually_exclusive_group()
    either.add_argument("--controller", choices=CONTROLLERS, help="controller beside the crane")
    text = "what the drives of a crane without controller take (default effort)"
    either.add_argument("--drive", choices=get_args(Drive), default="effort", help=text)
    add("--single", action="store_true", help="numbers in single precision")
    text = "time from one call of the controller to the next [s]"
    add("--period", type=float, default=5e-3, metavar="T", help=text)
    add("--dt", type=float, default=5e-4, metavar="DT", help="physics step [s]")


def run(options: argparse.Namespace) -> Path:
    """Write what the command line describes, and return its folder."""
    crane = crane_from_options(options)
    controller = None
    drive: Drive = options.drive
    if options.controller is not None:
        drive, make = CONTROLLERS[options.controller]
        controller = make(crane, options.period)
    if drive != "effort" or options.controller == "predictive":
        name_default_rates(crane)
    precision: Precision = "single" if options.single else "double"
    clock = {"dt": options.dt, "control_period": options.period}
    return export(crane, options.target, controller, drive=drive, precision=precision, **clock)
