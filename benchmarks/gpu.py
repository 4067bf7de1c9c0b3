"""What NVIDIA's assembler makes of the code of a batch; and, where there is a GPU, how fast it
is.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np

from benchmarks.conduct import add_document, teller
from benchmarks.timing import seconds
from benchmarks.workload import Case
from cranedyn.command import command
from cranedyn.compiled import cuda
from cranedyn.compiled.batch import Device, simulate_batch
from cranedyn.compiled.kernel import Recipe
from cranedyn.compiled.ptx import ptx
from cranedyn.compiled.threads import WARP
from cranedyn.dynamics.integrators import Integrator, rk4, semi_implicit_euler
from cranedyn.errors import CraneError
from cranedyn.interfaces import State
from cranedyn.model.load import load_crane
from cranedyn.plant.plant import Topology, numbers
from experiments.harness.outcome import Table

CRANES: dict[str, dict[str, Any]] = {
    "tower crane": {},
    "hook and slung load": {"hook_mass": 300.0, "sling_length": 4.0},
}
CHIPS = ("sm_75", "sm_90")
COUNTS = (1_000, 10_000, 100_000, 1_000_000)


def recipe(
    integrator: Integrator = semi_implicit_euler,
    *,
    drive: str = "effort",
    buffers: bool = False,
    everything: bool = False,
) -> Recipe:
    """Code of threads; with everything, each crane has its own controller, forces, wrong sensors
    and rows.
    """
    shared = (not everything,) * (3 + everything)
    return Recipe(
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
    "cranes that are alike": (recipe(), False),
    "cranes with loads of their own": (recipe(), True),
    "all that there is": (recipe(buffers=True, everything=True), True),
    "RK4 with buffers": (recipe(rk4, buffers=True), False),
    "prescribed motion": (recipe(drive="motion"), False),
}
"""What the code can do, and whether the cranes differ in their loads."""


def text(description: dict[str, Any], kind: str) -> str:
    """The PTX of one kind of code for a crane."""
    crane, (made, differ) = load_crane(**description), KINDS[kind]
    constants: list[float | None] = numbers(crane).tolist()
    if differ:
        other = numbers(load_crane(**description, payload_mass=crane.payload_mass / 2.0))
        constants = [one if one == two else None for one, two in zip(constants, other, strict=True)]
    return ptx(Topology.of(crane), constants, made)


class Assembled(NamedTuple):
    """What the assembler says of the loop.

    Attributes:
        registers: Of 32 bits each, of a thread, 255 at most.
        spilled: Bytes that a thread keeps in memory for want of registers.
    """

    registers: int
    spilled: int


def assembler() -> Path | None:
    """NVIDIA's ptxas from its package on PyPI, None where it is not installed."""
    found = find_spec("nvidia.cuda_nvcc") if find_spec("nvidia") else None
    places = [Path(place) for place in (found.submodule_search_locations or ())] if found else []
    return next((file for place in places for file in place.glob("bin/ptxas*")), None)


def assembled(assembler: Path, text: str, chip: str) -> Assembled:
    """What it makes of PTX for a kind of chip, such as "sm_90".

    Raises:
        CraneError: If it cannot assemble it.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "crane.ptx"
        file.write_text(text, encoding="ascii")
        done = subprocess.run(
            [str(assembler), "-v", f"-arch={chip}", str(file), "-o", str(file) + ".cubin"],
            capture_output=True,
            text=True,
            check=False,
        )
    loop = re.search(
        r"'run' for.*?(\d+) bytes spill stores, (\d+) bytes spill.*?Used (\d+) reg",
        done.stderr,
        re.DOTALL,
    )
    if done.returncode or not loop:
        raise CraneError(f"ptxas does not assemble it: {done.stderr}")
    return Assembled(int(loop[3]), max(int(loop[1]), int(loop[2])))


def assembly() -> Table:
    """A row for each crane and kind of code."""
    if (program := assembler()) is None:
        raise CraneError(
            "ptxas, NVIDIA's assembler, is not installed: pip install 'cranedyn[ptxas]'"
        )
    rows: list[list[float | str | None]] = []
    for name, description in CRANES.items():
        for kind in KINDS:
            made = text(description, kind)
            found = [assembled(program, made, chip) for chip in CHIPS]
            most = max(one.registers for one in found), max(one.spilled for one in found)
            rows.append([name, kind, len(made.splitlines()), *most])
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
    return Table("Assembled for a GPU", columns, rows, note)


def speed(simulated: float = 1e5, rounds: int = 3) -> Iterator[tuple[int, float, float, float]]:
    """For each number of cranes million steps a second on the GPU and on the processor, copies to
    and fro included, the best of some rounds.

    Args:
        simulated: Time of all cranes together [s], 1 to 70 s of each.
        rounds: How many.
    """
    for count in COUNTS:
        duration = max(1.0, min(70.0, simulated / count))
        gpu, processor = (
            measured(count, device, duration, rounds) for device in get_args(Device)[::-1]
        )
        yield count, gpu, processor, gpu / processor


def measured(count: int, device: Device, duration: float, rounds: int) -> float:
    """Million steps a second of so many cranes for a time [s], to three digits."""
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


def tables() -> list[Table]:
    """What can be said on this machine."""
    found = [assembly()]
    try:
        cuda.check_available()
    except CraneError as error:
        print(f"Not measured: {error}")
        return found
    columns = (
        ("cranes", ",d"),
        ("GPU [million steps/s]", ",.6g"),
        ("processor [million steps/s]", ",.6g"),
        ("ratio", ".3g"),
    )
    return [*found, Table("On a GPU", columns, list(speed()), "Copies to and fro included.")]


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.gpu", description=__doc__)
    add_document(parser, "gpu")
    options = parser.parse_args(argv)

    def run() -> int:
        tell = teller("gpu", options)
        tell(tables())
        return 0

    return command(run)


if __name__ == "__main__":
    sys.exit(main())
