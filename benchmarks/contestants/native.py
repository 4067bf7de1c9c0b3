"""The equations of this one crane written out in C and compiled on the spot: the limit."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pinocchio as pin

from benchmarks.workload import Case, Contestant, Result, Run
from cranedyn.dynamics.equations_of_motion import point_positions
from cranedyn.errors import CraneError, ModelError

SOURCE = Path(__file__).with_name("crane.c")

FLAGS = (
    "-O3",
    "-march=native",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fno-signed-zeros",
    "-fassociative-math",
    "-ffinite-math-only",
)
"""What makes -ffast-math fast, without what it does to the processor's handling of tiny numbers in
everything else that runs."""

LANES = 8
"""Number of cranes in a vector of the processor."""

GROUPS = 2
"""Number of vectors that are computed in turn: 16 cranes go together."""

_CHUNKS = 4
"""Parts that each thread gets, so that all end at about the same time."""


def compiler() -> str | None:
    """Return the C compiler: $CC, or cc."""
    return shutil.which(os.environ.get("CC", "cc"))


def c_constants(case: Case) -> dict[str, float]:
    """Return the parameters of a crane under the names of the C source, from its loaded model.

    Raises:
        ModelError: If the crane is not one the equations were written for: inertias the same about
            each axis, centres on the joints.
    """
    crane = case.crane
    hold = case.controller
    trolley, outer, inner, payload = list(crane.model.inertias)[2:]
    links = {"trolley": trolley, "outer link": outer, "inner link": inner, "payload": payload}
    for name, body in links.items():
        if body.lever.any() or not np.array_equal(body.inertia, body.inertia[0, 0] * np.eye(3)):
            raise ModelError(
                f"The {name} has a centre beside its joint or an inertia that differs by axis; the "
                "C crane knows neither."
            )
    constants = {
        "PAYLOAD": payload.mass,
        "TROLLEY": trolley.mass + outer.mass + inner.mass,
        "INNER": payload.inertia[0, 0] + inner.inertia[0, 0],
        "OUTER": outer.inertia[0, 0],
        "SLEWING": crane.slewing_inertia + trolley.inertia[0, 0],
        "GRAVITY": crane.gravity,
        "DT": case.dt,
    }
    joints = ("SLEW", "TROLLEY", "PHI", "THETA", "HOIST")
    for letters, values in (
        ("DAMP", crane.damping),
        ("KP", hold.stiffness),
        ("KD", hold.damping),
        ("FF", hold.feed_forward),
        ("MAX", crane.effort_limit),
    ):
        names = joints if letters == "DAMP" else joints[:2] + joints[4:]
        constants |= {f"{letters}_{name}": x for name, x in zip(names, values, strict=True)}
    return constants


def ledger_constants(case: Case) -> dict[str, float]:
    """Return the further parameters with which a single crane logs what `simulate` logs."""
    crane = case.crane
    joints = ("SLEW", "TROLLEY", "PHI", "THETA", "HOIST")
    zero = np.zeros(crane.layout.n)
    weight = crane.payload_mass * crane.gravity
    constants = {
        "BASE": pin.computePotentialEnergy(crane.model, crane.data, zero) / weight,
        "PIVOT": point_positions(crane, zero)[0][2],
        "OUTSIDE": 3 * len(crane.points) + 2,
    }
    for name, values in (("LOW", crane.lower), ("HIGH", crane.upper)):
        constants |= {f"{name}_{joint}": x for joint, x in zip(joints, values, strict=True)}
    rates = zip(joints[:2] + joints[4:], crane.rate_limit, strict=True)
    return constants | {f"RATE_{joint}": x for joint, x in rates}


def compile_source(
    case: Case, lanes: int, groups: int, output: Path, *options: str, **further: float
) -> None:
    """Compile the source for a case.

    Args:
        case: The case.
        lanes: Cranes of a vector.
        groups: Vectors whose steps take turns.
        output: The file to write.
        options: Options of the compiler that say what to write.
        further: Constants besides those of `c_constants`.

    Raises:
        CraneError: If the compiler refuses it.
    """
    values = {
        **{name: repr(float(value)) for name, value in (c_constants(case) | further).items()},
        "STEPS": case.steps,
        "LANES": lanes,
        "GROUPS": groups,
    }
    defined = [f"-D{name}={value}" for name, value in values.items()]
    command = [compiler() or "cc", *FLAGS, *defined, *options, "-o", str(output), str(SOURCE)]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode:
        message = result.stderr.strip().splitlines()[-1]
        raise CraneError(f"{command[0]} cannot compile {SOURCE.name}: {message}")


def load_library(case: Case, lanes: int, groups: int, **further: float) -> ctypes.CDLL:
    """Compile the source for a case, and further constants, and load it.

    Raises:
        CraneError: If the compiler refuses it.
    """
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "crane.so"
        compile_source(case, lanes, groups, library, "-shared", "-fPIC", **further)
        loaded = ctypes.CDLL(str(library))
    loaded.run.argtypes = [ctypes.c_long, ctypes.c_long, *4 * [ctypes.c_void_p]]
    loaded.run.restype = None
    return loaded


def _one(case: Case, columns: int = 13, **further: float) -> Run:
    """Return a run of one crane that logs a number of columns at each control instant.

    Args:
        case: What is run.
        columns: Number of columns: 13 for coordinates, rates and efforts.
        further: Further constants of the source.
    """
    library = load_library(case, 1, 1, **further)

    def run(starts: np.ndarray, duration: float) -> Result:
        periods = case.periods(duration)
        starts = np.ascontiguousarray(starts, float)
        ends = np.empty((1, 10))
        peaks = np.empty(1)
        log = np.empty((periods + 1, columns))
        library.run(1, periods, *(array.ctypes.data for array in (starts, ends, peaks, log)))
        return Result(ends, np.sqrt(peaks), lambda: log[:, :13])

    return run


def _whole_log(case: Case) -> Run:
    """Return a run of one crane that logs what `simulate` logs."""
    further = ledger_constants(case)
    return _one(case, 25 + int(further["OUTSIDE"]), **further)


def _many(threads: int, case: Case) -> Run:
    """Return a run of many cranes on threads, 16 at a time."""
    library = load_library(case, LANES, GROUPS)
    pool = ThreadPoolExecutor(threads)

    def run(starts: np.ndarray, duration: float) -> Result:
        together = LANES * GROUPS
        cranes = len(starts)
        periods = case.periods(duration)
        # The last crane is repeated until the number is a multiple of 16.
        last = np.repeat(starts[-1:], -cranes % together, axis=0)
        full = np.ascontiguousarray(np.concatenate([starts, last]), float)
        ends = np.empty_like(full)
        peaks = np.empty(len(full))

        def part(rounds: np.ndarray) -> None:
            """Run the groups of cranes of these numbers, which follow each other."""
            rows = slice(together * rounds[0], together * (rounds[-1] + 1))
            arrays = (array[rows].ctypes.data for array in (full, ends, peaks))
            library.run(len(rounds), periods, *arrays, None)

        rounds = np.arange(len(full) // together)
        chunks = min(len(rounds), 1 if threads == 1 else _CHUNKS * threads)
        list(pool.map(part, np.array_split(rounds, chunks)))
        return Result(ends[:cranes], np.sqrt(peaks[:cranes]))

    return run


def _missing() -> str | None:
    """Return why nothing can be compiled here, None if it can."""
    return None if compiler() else "there is no C compiler, neither cc nor $CC"


def _threads(count: int) -> Contestant:
    """Return the contestant that runs many cranes on a number of threads."""
    return Contestant(
        f"C by hand, {count} thread{'s' * (count > 1)}",
        _missing,
        lambda case: _many(count, case),
        many=True,
    )


CONTESTANTS = (
    Contestant("C by hand", _missing, _one),
    Contestant("C by hand, whole log", _missing, _whole_log),
    *(_threads(count) for count in sorted({1, os.cpu_count() or 1})),
)
