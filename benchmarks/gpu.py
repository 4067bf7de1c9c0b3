"""What NVIDIA's assembler makes of the code of a batch; and, where there is a GPU, how fast it
is.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.conduct import print_tables
from benchmarks.timing import seconds
from benchmarks.workload import Case
from cranedyn.compiled import cuda
from cranedyn.compiled.batch import Device, simulate_batch
from cranedyn.compiled.kernel import KernelOptions, KernelSource
from cranedyn.compiled.plant.plant import Topology, plant_numbers
from cranedyn.compiled.threads import WARP
from cranedyn.dynamics.integrators import Integrator, rk4, semi_implicit_euler
from cranedyn.errors import CraneError
from cranedyn.interfaces import State
from cranedyn.model.load import load_crane
from experiments.harness.outcome import ResultTable

CRANES: dict[str, dict[str, Any]] = {
    "tower crane": {},
    "hook and slung load": {"hook_mass": 300.0, "sling_length": 4.0},
}
"""Numbers of the cranes for which code is made, by name."""

CHIPS = ("sm_75", "sm_90")
"""Kinds of GPU for which code is assembled."""

COUNTS = (1_000, 10_000, 100_000, 1_000_000)
"""Numbers of cranes whose speed is measured."""


def kernel_options(
    integrator: Integrator = semi_implicit_euler,
    *,
    drive: str = "effort",
    buffers: bool = False,
    everything: bool = False,
) -> KernelOptions:
    """Return a recipe of code for threads.

    Args:
        integrator: The stepping rule.
        drive: Kind of the drives.
        buffers: Whether buffers end the ranges of the drives.
        everything: Whether each crane has its own controller, forces, sensor errors and rows.
    """
    # Gains, setpoints and forces are shared, or nothing is, sensor offsets included.
    shared = (False,) * 4 if everything else (True,) * 3
    return KernelOptions(
        WARP,
        drive,
        integrator,
        buffers,
        integral=everything,
        offset=everything,
        forces=everything,
        shared=shared,
        log=everything,
        summary=True,
        threads=True,
    )


KINDS = {
    "cranes that are alike": (kernel_options(), False),
    "cranes with loads of their own": (kernel_options(), True),
    "all that there is": (kernel_options(buffers=True, everything=True), True),
    "RK4 with buffers": (kernel_options(rk4, buffers=True), False),
    "prescribed motion": (kernel_options(drive="motion"), False),
}
"""What the code can do, and whether the cranes differ in their loads."""


def ptx_text(description: dict[str, Any], kind: str) -> str:
    """Return the PTX of one kind of code for a crane."""
    crane = load_crane(**description)
    variant, differ = KINDS[kind]
    constants: list[float | None] = plant_numbers(crane).tolist()
    if differ:
        half_loaded = plant_numbers(
            load_crane(**description, payload_mass=crane.payload_mass / 2.0)
        )
        constants = [a if a == b else None for a, b in zip(constants, half_loaded, strict=True)]
    return cuda.ptx(KernelSource(Topology.of(crane), tuple(constants), variant))


class AssemblerReport(NamedTuple):
    """What the assembler says of the loop.

    Attributes:
        registers: Of 32 bits each, of a thread, 255 at most.
        spilled: Bytes that a thread keeps in memory for want of registers.
    """

    registers: int
    spilled: int


def assembler() -> Path | None:
    """Return the path of NVIDIA's ptxas: from its package on PyPI, else that of a CUDA toolkit on
    the path of programs; None if there is neither.
    """
    package = find_spec("nvidia.cuda_nvcc") if find_spec("nvidia") else None
    if package is not None:
        for folder in package.submodule_search_locations or ():
            for file in Path(folder).glob("bin/ptxas*"):
                return file
    on_path = shutil.which("ptxas")
    return None if on_path is None else Path(on_path)


def assemble(assembler: Path, ptx_source: str, chip: str) -> AssemblerReport:
    """Assemble PTX for a kind of chip, such as "sm_90".

    Raises:
        CraneError: If it cannot assemble it.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "crane.ptx"
        file.write_text(ptx_source, encoding="ascii")
        call = [str(assembler), "-v", f"-arch={chip}", str(file), "-o", f"{file}.cubin"]
        done = subprocess.run(call, capture_output=True, text=True, check=False)
    numbers = r"'run' for.*?(\d+) bytes spill stores, (\d+) bytes spill.*?Used (\d+) reg"
    loop = re.search(numbers, done.stderr, re.DOTALL)
    if done.returncode or not loop:
        raise CraneError(f"ptxas does not assemble it: {done.stderr}")
    return AssemblerReport(int(loop[3]), max(int(loop[1]), int(loop[2])))


def assembly_table() -> ResultTable:
    """Return a row for each crane and kind of code."""
    program = assembler()
    if program is None:
        missing = "ptxas, NVIDIA's assembler, is not installed: pip install 'cranedyn[ptxas]'"
        raise CraneError(missing)
    rows: list[list[float | str | None]] = []
    for name, description in CRANES.items():
        for kind in KINDS:
            code = ptx_text(description, kind)
            reports = [assemble(program, code, chip) for chip in CHIPS]
            worst = max(r.registers for r in reports), max(r.spilled for r in reports)
            rows.append([name, kind, len(code.splitlines()), *worst])
    columns = (
        ("crane", ""),
        ("code", ""),
        ("lines of PTX", ",d"),
        ("registers", "d"),
        ("spilled [byte]", "d"),
    )
    note = (
        f"By NVIDIA's ptxas for {' and '.join(CHIPS)}, the worse of both. A thread has 255 "
        "registers of 32 bits at most, and a double takes two."
    )
    return ResultTable("Assembled for a GPU", columns, rows, note)


class Speed(NamedTuple):
    """Speed of a number of cranes, copies included.

    Attributes:
        cranes: Number of cranes.
        gpu: Million steps a second on the GPU.
        processor: Million steps a second on the processor.
        ratio: The one over the other.
    """

    cranes: int
    gpu: float
    processor: float
    ratio: float


def measure_speed(simulated: float = 1e5, rounds: int = 3) -> Iterator[Speed]:
    """Yield the speed of each number of cranes.

    Args:
        simulated: Simulated time of all cranes together [s], 1 to 70 s of each.
        rounds: Number of rounds.
    """
    for count in COUNTS:
        duration = max(1.0, min(70.0, simulated / count))
        gpu = measured(count, "cuda", duration, rounds)
        processor = measured(count, "cpu", duration, rounds)
        yield Speed(count, gpu, processor, gpu / processor)


def measured(count: int, device: Device, duration: float, rounds: int) -> float:
    """Return million steps a second of many cranes for a time [s], to three digits."""
    case = Case()
    task = partial(
        simulate_batch,
        case.crane,
        case.controller,
        start=State(*np.split(case.starts(count), 2, axis=1)),
        dt=case.dt,
        control_period=case.period,
        duration=duration,
        device=device,
    )
    task()
    best = min(seconds(task) for _ in range(rounds))
    return float(f"{1e-6 * count * case.steps * case.periods(duration) / best:.3g}")


def gpu_tables() -> list[ResultTable]:
    """Return the tables that can be measured on this machine."""
    result = [assembly_table()]
    try:
        cuda.check_available()
    except CraneError as error:
        print(f"Not measured: {error}")
        return result
    columns = (
        ("cranes", ",d"),
        ("GPU [million steps/s]", ",.6g"),
        ("processor [million steps/s]", ",.6g"),
        ("ratio", ".3g"),
    )
    rows = list(measure_speed())
    note = "Copies to and fro included."
    return [*result, ResultTable("On a GPU", columns, rows, note)]


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    return print_tables("gpu", __doc__, lambda options: gpu_tables(), argv)


if __name__ == "__main__":
    sys.exit(main())
