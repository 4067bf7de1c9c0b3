"""The crane as a co-simulation unit of FMI 3.0 (an FMU): the compiled loop in a shared library that
needs no Python.

``python -m cranedyn export fmu FILE.fmu`` writes one.
"""

from __future__ import annotations

import argparse
import hashlib
import platform
import shutil
import subprocess
import tempfile
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cranedyn.bridges.joints import (
    add,
    force_names,
    input_names,
    state_names,
    xml_bytes,
)
from cranedyn.bridges.target import check_free, new_file
from cranedyn.checks import check_choice
from cranedyn.clocks import clocks
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.dynamics.pinocchio import holding_effort
from cranedyn.errors import CraneError, ModelError, OutOfRange, quoted
from cranedyn.interfaces import DirectDrive
from cranedyn.model.crane import Crane
from cranedyn.model.options import crane_from_options

TARGET = "FILE"
EXAMPLE = "crane.fmu"
"""Target of the command line."""

NAME = "cranedyn_crane"
"""Name of the model and of its library."""

_WRAPPER = Path(__file__).with_name("fmi.c")
"""C code of the interface of FMI, around the compiled loop."""

_SUFFIX = ".so" if platform.system() == "Linux" else ".dylib"
"""Ending of the library."""

_COMPILERS = ("cc", "gcc", "clang")
_DATE = (1980, 1, 1, 0, 0, 0)
"""Date of the files in a unit, fixed so that equal cranes give equal units."""


@dataclass(frozen=True)
class FmiVariable:
    """Variable of the unit.

    Attributes:
        name: Name.
        unit: Unit; empty for a pure number.
        causality: Causality of FMI: independent, input, parameter or output.
        start: Start value; None for a computed variable.
        lower, upper: Range.
        about: Description.
    """

    name: str
    unit: str
    causality: str
    start: float | None = None
    lower: float = -np.inf
    upper: float = np.inf
    about: str = ""


def export(
    crane: Crane,
    path: str | Path,
    *,
    drive: DirectDrive = "effort",
    dt: float = 5e-4,
    integrator: Integrator = semi_implicit_euler,
) -> Path:
    """Write a crane as an FMU for this kind of machine.

    Its inputs are the commands of the drives and forces from outside, held over a communication
    step, which is a multiple of `dt`; its outputs are the state, the efforts, the energy, and
    whether the model holds. It moves as in `simulate` with validity = mark and the communication
    step as control period.

    Args:
        crane: The crane.
        path: New file, ending in ``.fmu``.
        drive: Drive mode, see `simulate`.
        dt: Physics step [s].
        integrator: The stepping rule.

    Raises:
        OutOfRange: If the file does not end so, a number is out of range, or there is no code for
            the stepping rule.
        DataError: If the file exists or cannot be written.
        CraneError: If there is no C compiler, or the machine is of a kind that is not known.
        ModelError: If the code would not do what Pinocchio does, or two variables of the crane
            would have the same name.
    """
    final = Path(path)
    if final.suffix != ".fmu":
        raise OutOfRange("name of the unit", str(final), "one that ends in .fmu")
    check_free(final)
    check_choice("drive", drive, DirectDrive)
    clocks(dt, dt, dt)
    from cranedyn.compiled.kernel import Recipe
    from cranedyn.compiled.verify import object_file  # other exporters need no llvmlite

    recipe = Recipe(
        lanes=1,
        drive=drive,
        integrator=integrator,
        buffers=False,
        integral=False,
        offset=False,
        forces=True,
        shared=(True, True, True),
        log=True,
        summary=True,
        turns=1,
    )
    variables, code = _variables(crane, drive), object_file(crane, recipe)
    content = code + repr((variables, dt)).encode() + _WRAPPER.read_bytes()
    token = f"{{{hashlib.sha256(content).hexdigest()[:32]}}}"
    library = _link(code, _header(crane, variables, token, dt))
    with new_file(final) as draft, zipfile.ZipFile(draft, "w", zipfile.ZIP_DEFLATED) as unit:
        parts = {
            "modelDescription.xml": _description(variables, token, dt, drive),
            f"binaries/{_platform()}/{NAME}{_SUFFIX}": library,
        }
        for name, part in parts.items():
            unit.writestr(zipfile.ZipInfo(name, _DATE), part, zipfile.ZIP_DEFLATED)
    return final


def _variables(crane: Crane, drive: str) -> list[FmiVariable]:
    """Return all variables; the value reference of each is its index."""
    layout, names, free = crane.layout, state_names(crane), np.full(crane.layout.n, np.inf)
    units = [*layout.units, *(f"{unit}/s" for unit in layout.units)]
    efforts = [joint.effort_unit.replace(" ", ".") for joint in layout.driven]
    commands, holding = input_names(crane, drive), np.zeros(layout.m)
    commanded = [f"{joint.unit}/s2" for joint in layout.driven]
    if drive == "effort":
        commanded, holding = efforts, holding_effort(crane, crane.start.q)
    starts = np.concatenate(crane.start).tolist()
    low, high = np.append(crane.lower, -free).tolist(), np.append(crane.upper, free).tolist()
    variables = [FmiVariable("time", "s", "independent")]
    about = "held over a communication step"
    for name, unit, value in zip(commands, commanded, holding.tolist(), strict=True):
        variables.append(FmiVariable(f"{name}_command", unit, "input", value, about=about))
    about = "from outside, in the world"
    for name in force_names(crane):
        variables.append(FmiVariable(name, "N", "input", 0.0, about=about))
    about = "where it begins"
    for name, unit, value, lower, upper in zip(names, units, starts, low, high, strict=True):
        parameter = FmiVariable(f"{name}_start", unit, "parameter", value, lower, upper, about)
        variables.append(parameter)
    for name, unit in zip(names, units, strict=True):
        variables.append(FmiVariable(name, unit, "output"))
    for name, unit in zip(input_names(crane, "effort"), efforts, strict=True):
        variables.append(FmiVariable(name, unit, "output", about="what acts"))
    about = "mechanical, zero of height at the ground"
    variables.append(FmiVariable("energy", "J", "output", about=about))
    about = (
        "false once a joint has left its range, the rope is slack or the load touches the ground"
    )
    variables.append(FmiVariable("valid", "", "output", about=about))
    variable_names = [variable.name for variable in variables]
    if twice := [name for name in variable_names if variable_names.count(name) > 1]:
        raise ModelError(
            f"Two variables of the unit would have the name {quoted(twice[0])}; rename a joint or "
            "a point of the crane."
        )
    return variables


def _description(variables: Sequence[FmiVariable], token: str, dt: float, drive: str) -> bytes:
    """Return the text of modelDescription.xml."""
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=NAME,
        instantiationToken=token,
        generationTool="cranedyn",
    )
    commands = "efforts" if drive == "effort" else "accelerations"
    root.set("description", f"A crane whose drives take {commands}")
    add(
        root,
        "CoSimulation",
        modelIdentifier=NAME,
        canHandleVariableCommunicationStepSize="true",
        canGetAndSetFMUState="true",
        canSerializeFMUState="true",
    )
    units = add(root, "UnitDefinitions")
    for unit in sorted({variable.unit for variable in variables} - {""}):
        add(add(units, "Unit", name=unit), "BaseUnit", **_BASE[unit])
    add(root, "DefaultExperiment", startTime="0", stopTime="10", stepSize=f"{10 * dt!r}")
    listed, structure = add(root, "ModelVariables"), add(root, "ModelStructure")
    for reference, variable in enumerate(variables):
        entries = {
            "name": variable.name,
            "valueReference": str(reference),
            "causality": variable.causality,
        }
        if variable.about:
            entries["description"] = variable.about
        entries["variability"] = "continuous" if variable.unit else "discrete"
        if variable.causality == "parameter":
            entries["variability"] = "fixed"
        if variable.causality == "output":
            entries["initial"] = "calculated"
        if variable.unit:
            entries["unit"] = variable.unit
        numbers = {"start": variable.start, "min": variable.lower, "max": variable.upper}
        for name, value in numbers.items():
            if value is not None and np.isfinite(value):
                entries[name] = repr(value)
        ET.SubElement(listed, "Float64" if variable.unit else "Boolean", entries)
    outputs = [str(i) for i, variable in enumerate(variables) if variable.causality == "output"]
    for kind in ("Output", "InitialUnknown"):
        for output in outputs:
            add(structure, kind, valueReference=output)
    return xml_bytes(root)


_BASE = {
    "s": {"s": "1"},
    "rad": {"rad": "1"},
    "m": {"m": "1"},
    "rad/s": {"rad": "1", "s": "-1"},
    "m/s": {"m": "1", "s": "-1"},
    "rad/s2": {"rad": "1", "s": "-2"},
    "m/s2": {"m": "1", "s": "-2"},
    "N": {"kg": "1", "m": "1", "s": "-2"},
    "N.m": {"kg": "1", "m": "2", "s": "-2"},
    "J": {"kg": "1", "m": "2", "s": "-2"},
}
"""Units in terms of SI base units."""


def _header(crane: Crane, variables: Sequence[FmiVariable], token: str, dt: float) -> str:
    """Return unit.h for `fmi.c`: indices and offsets of the buffers."""
    from cranedyn.compiled.layout import SLOTS, BufferLayout, size, slices

    sizes = BufferLayout.of(crane.layout)
    gains, row, summary = slices(sizes.gain_table), slices(sizes.row), slices(sizes.summary)
    names, kinds = [v.name for v in variables], [v.causality for v in variables]
    numbers = {
        "VARIABLES": len(variables),
        "COMMAND": kinds.index("input"),
        "FORCE": names.index(force_names(crane)[0]),
        "START": kinds.index("parameter"),
        "OUTPUT": kinds.index("output"),
        "VALID": len(variables) - 1,
        "STATES": kinds.count("parameter"),
        "DRIVES": sizes.m,
        "SLOTS": len(SLOTS),
        **{f"SLOT_{name.upper()}": slot for name, slot in SLOTS.items()},
        "SIZE_STATE": size(sizes.state),
        "SIZE_GAIN_TABLE": size(sizes.gain_table),
        "SIZE_SETPOINT_TABLE": size(sizes.setpoint_table),
        "SIZE_ROW": size(sizes.row),
        "SIZE_SUMMARY": size(sizes.summary),
        "AT_FEED_FORWARD": gains["feed_forward"].start,
        "AT_LIMIT": gains["limit"].start,
        "AT_EFFORT": row["effort"].start,
        "AT_ENERGY": row["energy"].start,
        "AT_INVALID": summary["invalid"].start,
    }
    defined = {"TOKEN": f'"{token}"', "DT": repr(dt), **numbers}
    lines = [f"#define {name} {value}" for name, value in defined.items()]
    lines += ["static const struct { const char *name; double start, least, most; } VARIABLE[] = {"]
    for v in variables:
        lines.append(f"  {{{_text(v.name)}, {_c(v.start or 0.0)}, {_c(v.lower)}, {_c(v.upper)}}},")
    return "\n".join([*lines, "};", ""])


def _c(value: float) -> str:
    return repr(float(value)) if np.isfinite(value) else "INFINITY" if value > 0.0 else "-INFINITY"


def _text(name: str) -> str:
    """Return a name as a string literal of C, whatever characters it has."""
    return '"' + "".join(f"\\{byte:03o}" for byte in name.encode()) + '"'


def _platform() -> str:
    """Return the platform's name in FMI.

    Raises:
        CraneError: If units cannot be built for this platform.
    """
    system, machine = platform.system().lower(), platform.machine()
    kind = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine.lower(), machine)
    if system not in ("linux", "darwin") or kind not in ("x86_64", "aarch64"):
        machine = f"this machine is {system} on {kind}"
        raise CraneError(f"Units are made on Linux and macOS, x86_64 or aarch64; {machine}.")
    return f"{kind}-{system}"


def _link(code: bytes, header: str) -> bytes:
    """Link the shared library of the compiled loop and `fmi.c`.

    Raises:
        CraneError: If there is no C compiler, or it fails.
    """
    compiler = next(filter(None, map(shutil.which, _COMPILERS)), None)
    if compiler is None:
        raise CraneError(
            f"A unit is linked by a C compiler, and none of {', '.join(_COMPILERS)} is installed; "
            "on Debian: apt install gcc."
        )
    with tempfile.TemporaryDirectory() as folder:
        workspace = Path(folder)
        (workspace / "loop.o").write_bytes(code)
        (workspace / "unit.h").write_text(header)
        shutil.copy(_WRAPPER, workspace)
        (workspace / "exports").write_text("{ global: fmi3*; local: *; };")
        export_options = ["-Wl,--version-script=exports"] if platform.system() == "Linux" else []
        options = ["-shared", "-fPIC", "-O2", "-w", *export_options, "-o", "library"]
        command = [compiler, *options, "fmi.c", "loop.o", "-lm"]
        build = subprocess.run(
            command, cwd=workspace, capture_output=True, text=True, timeout=120, check=False
        )
        if build.returncode:
            raise CraneError(
                f"The C compiler {compiler} could not make the unit: {build.stderr.strip()[-500:]}"
            )
        return (workspace / "library").read_bytes()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments beside the file and the crane."""
    parser.add_argument(
        "--drive", choices=("effort", "motion"), default="effort", help="what is commanded"
    )
    parser.add_argument("--dt", type=float, default=5e-4, metavar="DT", help="physics step [s]")


def run(options: argparse.Namespace) -> Path:
    """Write what the command line describes, and return its path."""
    return export(crane_from_options(options), options.target, drive=options.drive, dt=options.dt)
