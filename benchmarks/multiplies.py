"""Arithmetic of a physics step in machine code: that of the compiled engine for some cranes, beside
that of the C by hand.

The loop over the steps is translated for this processor and its instructions are counted. A product
that is fused with a sum is one instruction. It needs a processor with the vectors of AVX-512, whose
instructions it knows by name.
"""

from __future__ import annotations

import re
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from llvmlite import ir

from benchmarks.conduct import print_tables
from benchmarks.contestants.native import GROUPS, LANES, compile_source, compiler
from benchmarks.workload import Case
from cranedyn.compiled.kernel import KernelOptions, KernelSource, build_module
from cranedyn.compiled.machine import native_assembly
from cranedyn.compiled.plant.plant import Topology, plant_numbers
from cranedyn.dynamics.integrators import semi_implicit_euler
from cranedyn.errors import CraneError
from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO
from cranedyn.model.load import load_crane
from experiments.harness.outcome import ResultTable

COLUMNS = (
    ("step", ""),
    ("joints", ",d"),
    ("products", ",d"),
    ("products with a sum", ",d"),
    ("both", ",d"),
    ("sums", ",d"),
    ("quotients", ",d"),
)

_LABEL = re.compile(r"^(\.?[\w$]+):")
_JUMP = re.compile(r"^j\w+\s+(\.?[\w$]+)")


class Arithmetic(NamedTuple):
    """Instructions of a loop.

    Attributes:
        products: Products alone.
        fused: Products with a sum.
        sums: Sums and differences.
        quotients: Quotients.
    """

    products: int
    fused: int
    sums: int
    quotients: int


def arithmetic_of_step(assembly: str) -> Arithmetic:
    """Return the instructions of the loop over physics steps: of all loops that are one block, the
    one with the most products.

    Args:
        assembly: Assembly language of an x86 processor.

    Raises:
        CraneError: If there is no loop with products.
    """
    counts = [_counted(block) for block in _loops(assembly)]
    largest = max(counts, key=lambda count: count.products + count.fused, default=None)
    if largest is None or not largest.products:
        raise CraneError("No loop over steps was found; this needs a processor with AVX-512.")
    return largest


def _loops(assembly: str) -> list[list[str]]:
    """Return the instructions of each block that jumps back to its own beginning."""
    found = []
    name = ""
    block: list[str] = []
    for line in assembly.splitlines():
        label = _LABEL.match(line)
        if label:
            name = label.group(1)
            block = []
            continue
        instruction = line.strip()
        if instruction and not instruction.startswith((".", "#")):
            block.append(instruction)
            jump = _JUMP.match(instruction)
            if jump and jump.group(1) == name:
                found.append(block.copy())
    return found


def _counted(block: Sequence[str]) -> Arithmetic:
    names = [instruction.split()[0] for instruction in block]
    return Arithmetic(
        products=sum(name.startswith("vmul") for name in names),
        fused=sum(re.match(r"vfn?m(add|sub)", name) is not None for name in names),
        sums=sum(name.startswith(("vadd", "vsub")) for name in names),
        quotients=sum(name.startswith("vdiv") for name in names),
    )


def step_of_batch(crane: Crane) -> Arithmetic:
    """Return the arithmetic of a step of a batch of equal cranes under efforts."""
    numbers = tuple(plant_numbers(crane).tolist())
    options = KernelOptions(
        lanes=LANES, drive="effort", integrator=semi_implicit_euler, summary=True
    )
    source = KernelSource(Topology.of(crane), numbers, options)
    module: ir.Module = build_module(source)
    return arithmetic_of_step(native_assembly(module))


def step_of_c(case: Case) -> Arithmetic:
    """Return the arithmetic of a step of the C by hand, in the same vectors.

    Raises:
        CraneError: If there is no C compiler, or it refuses the source.
    """
    if compiler() is None:
        raise CraneError("There is no C compiler, neither cc nor $CC.")
    with tempfile.TemporaryDirectory() as folder:
        assembly = Path(folder) / "crane.s"
        compile_source(case, LANES, GROUPS, assembly, "-S")
        return arithmetic_of_step(assembly.read_text())


def multiplies_tables() -> list[ResultTable]:
    """Return the table of cranes.

    Raises:
        CraneError: If there is no C compiler, or the processor has other instructions.
    """
    cranes = {
        "tower crane": load_crane(),
        "overhead crane": load_crane(XACRO.with_name("overhead_crane.urdf.xacro")),
        "hook and slung load": load_crane(hook_mass=200.0),
    }
    rows = []
    for name, crane in cranes.items():
        rows.append(_row(f"compiled batch, {name}", crane.layout.n, step_of_batch(crane)))
    case = Case()
    rows.append(_row("C by hand, tower crane", case.n, step_of_c(case)))
    return [ResultTable("Arithmetic of a step", COLUMNS, rows)]


def _row(name: str, joints: int, count: Arithmetic) -> list[float | str | None]:
    both = count.products + count.fused
    return [name, joints, count.products, count.fused, both, count.sums, count.quotients]


def main(argv: Sequence[str] | None = None) -> int:
    """Count and print; returns 0."""
    return print_tables("multiplies", __doc__, lambda _: multiplies_tables(), argv)


if __name__ == "__main__":
    sys.exit(main())
