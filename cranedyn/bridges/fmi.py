"""The crane, or a controller, as a unit of FMI 3.0 or 2.0 (an FMU), with its sources in C and
libraries that need no Python.

``python -m cranedyn export fmu FILE.fmu`` writes one.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import platform
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from cranedyn.bridges.controller_block import controller_block
from cranedyn.bridges.joints import add, xml_bytes
from cranedyn.bridges.target import check_free, new_file
from cranedyn.bridges.usual_controllers import CONTROLLERS
from cranedyn.compiled.block import FunctionBlock
from cranedyn.compiled.c_text import c_header, c_source
from cranedyn.compiled.crane_block import crane_block
from cranedyn.data.files import with_ending
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.errors import CraneError, DataError, ModelError, OutOfRange, UnknownName, quoted
from cranedyn.interfaces import Drive
from cranedyn.model.crane import Crane
from cranedyn.model.options import crane_from_options

TARGET = "FILE"
EXAMPLE = "crane.fmu"
"""Target of the command line."""

Version = Literal[2, 3]
"""Version of FMI."""

NAME, CONTROLLER_NAME = "cranedyn_crane", "cranedyn_controller"
"""Names of the models and of their libraries: of a crane, and of a controller."""

PLATFORMS = {
    "x86_64-linux": ("linux64", "x86_64-linux-gnu.2.17", ".so"),
    "aarch64-linux": ("aarch64-linux", "aarch64-linux-gnu.2.17", ".so"),
    "x86_64-windows": ("win64", "x86_64-windows-gnu", ".dll"),
    "x86_64-darwin": ("darwin64", "x86_64-macos", ".dylib"),
    "aarch64-darwin": ("aarch64-darwin", "aarch64-macos", ".dylib"),
}
"""Platforms by name in FMI 3.0: name in FMI 2.0, target of the compiler Zig, ending of a file."""

_SOURCES, _HEADERS = Path(__file__).parent, ("fmi_unit.h", "fmi_shared.h")

_COMPILERS = ("cc", "gcc", "clang")
_DATE = (1980, 1, 1, 0, 0, 0)
"""Date of the files in a unit, fixed so that equal cranes give equal units."""


@dataclass(frozen=True)
class FmiVariable:
    """Variable of the unit.

    Attributes:
        name: Name.
        member: Place in the memory of the unit, as C.
        unit: Unit; empty for a pure number.
        causality: Causality of FMI: independent, input, parameter or output.
        start: Start value; None for a computed variable.
        lower, upper: Range.
        about: Description.
        fixed: Whether it is constant once stepping has begun.
        rate_of: Index of the variable whose derivative it is; None for none.
    """

    name: str
    member: str
    unit: str
    causality: str
    start: float | None = None
    lower: float = -np.inf
    upper: float = np.inf
    about: str = ""
    fixed: bool = False
    rate_of: int | None = None


def export(
    crane: Crane,
    path: str | Path,
    *,
    drive: Drive = "effort",
    dt: float = 5e-4,
    integrator: Integrator = semi_implicit_euler,
    controller: Any = None,
    control_period: float = 5e-3,
    duration: float = 30.0,
    version: Version = 3,
    platforms: Sequence[str] = (),
) -> Path:
    """Write a crane, or a controller for it, as an FMU.

    The inputs of a crane are the commands of the drives and forces from outside, held over a
    communication step, which is a multiple of `dt`; its outputs are the state, the efforts, the
    energy, and whether the model holds. It moves as in `simulate` with validity = mark and the
    communication step as control period. Parameters can be changed while it runs. A controller's
    outputs follow its inputs at once; a step of one control period advances its memory.

    Args:
        crane: The crane.
        path: New file, ending in ``.fmu``.
        drive: Drive mode, see `simulate`. With "velocity" the unit is for co-simulation alone.
        dt: Physics step [s].
        integrator: The stepping rule.
        controller: The controller, see `cranedyn.bridges.controller_block`; None for the crane.
        control_period: Period of the controller [s].
        duration: Time that tables of the controller cover [s].
        version: Version of FMI.
        platforms: Names in `PLATFORMS`; none for this kind of machine. Other kinds need the extra
            ``cross``.

    Raises:
        OutOfRange: If a number is out of range, or there is no code for the stepping rule.
        DataError: If the file has another ending, exists or cannot be written, or the controller
            cannot be exported.
        CraneError: If there is no C compiler, or the machine is of a kind that is not known.
        ModelError: If the code would not do what Pinocchio does, or two variables of the crane
            would have the same name.
    """
    final = with_ending(path, ".fmu")
    check_free(final)
    if version not in get_args(Version):
        raise OutOfRange("version of FMI", version, "2 or 3")
    for name in platforms:
        if name not in PLATFORMS:
            raise UnknownName("platform", name, PLATFORMS)
    if controller is None:
        block = crane_block(crane, drive=drive, dt=dt, integrator=integrator)
    else:
        block = controller_block(
            crane, controller, drive=drive, control_period=control_period, duration=duration
        )
    unit = _Unit(block, version)
    libraries = {name: unit.library(name) for name in dict.fromkeys(platforms or [_platform()])}
    with new_file(final) as draft, zipfile.ZipFile(draft, "w", zipfile.ZIP_DEFLATED) as file:
        entries = {"modelDescription.xml": unit.description()}
        entries |= {f"sources/{name}": text.encode() for name, text in unit.sources.items()}
        if version == 3:
            entries["sources/buildDescription.xml"] = unit.build_description()
        for name, library in libraries.items():
            folder, _, ending = PLATFORMS[name]
            folder = folder if version == 2 else name
            entries[f"binaries/{folder}/{unit.name}{ending}"] = library
        for name, content in entries.items():
            file.writestr(zipfile.ZipInfo(name, _DATE), content, zipfile.ZIP_DEFLATED)
    return final


def _variables(block: FunctionBlock) -> list[FmiVariable]:
    """Return all variables; the value reference of each is its index."""
    signal = {identifier: name for name, identifier in block.renamed.items()}
    variables = [FmiVariable("time", "time", "s", "independent")]
    moving = "outputs" in block.functions  # a crane; the memory of a controller is its own

    def variable(v: Any, causality: str, **settings: Any) -> FmiVariable:
        name = signal.get(v.name, v.name)
        return FmiVariable(name, f"model.{v.name}", v.unit, causality, about=v.about, **settings)

    for v in block.of_kind("input"):
        variables.append(variable(v, "input", start=v.start))
    for v in block.of_kind("parameter"):
        limits = {"start": v.start, "lower": v.lower, "upper": v.upper}
        variables.append(variable(v, "parameter", **limits))
    states = block.of_kind("state") if moving else []
    for i, v in enumerate(states):
        name, about = f"{signal.get(v.name, v.name)}_start", "where it begins"
        settings = (v.unit, "parameter", v.start, v.lower, v.upper, about)
        variables.append(FmiVariable(name, f"start[{i}]", *settings, fixed=True))
    first, half = len(variables), len(states) // 2
    outputs = [v for v in block.of_kind("output") if v.name != "valid"]
    for i, v in enumerate([*states, *outputs]):
        rate_of = first + i - half if half <= i < 3 * half else None
        variables.append(variable(v, "output", rate_of=rate_of))
    about = "false where the model or the inputs do not hold"
    if moving:
        about = (
            "false once a joint has left its range, the rope is slack or the load touches the "
            "ground"
        )
    variables.append(FmiVariable("valid", "valid", "", "output", about=about))
    names = [variable.name for variable in variables]
    if twice := [name for name in names if names.count(name) > 1]:
        raise ModelError(
            f"Two variables of the unit would have the name {quoted(twice[0])}; rename a joint or "
            "a point of the crane."
        )
    return variables


class _Unit:
    """Files of a unit.

    Attributes:
        name: Name of the model and of its library.
        sources: Texts in C by the name of the file.
    """

    def __init__(self, block: FunctionBlock, version: Version) -> None:
        self._block, self._version = block, version
        self._moving = "outputs" in block.functions
        self.name = NAME if self._moving else CONTROLLER_NAME
        self._variables = _variables(block)
        self._interface = f"fmi{version}.c"
        self.sources = {
            f"{block.name}.h": c_header(block),
            f"{block.name}.c": c_source(block),
            **{name: (_SOURCES / name).read_text() for name in (*_HEADERS, self._interface)},
        }
        content = repr((self._variables, block.period, self.sources)).encode()
        self._token = f"{{{hashlib.sha256(content).hexdigest()[:32]}}}"
        self.sources["unit.h"] = self._header()

    def _header(self) -> str:
        """Return unit.h for `fmi_unit.h`."""
        name, variables = self._block.name, self._variables
        starts = [i for i, variable in enumerate(variables) if variable.fixed]
        first = starts[-1] + 1 if starts else 0
        defined = {
            "TOKEN": f'"{self._token}"',
            "DT": repr(self._block.period),
            "RESET": f"{name}_reset",
            "STEP": f"{name}_step",
            "LAST_COUNT": self._block.last,
            "STATES": len(starts),
            "START": starts[0] if starts else 0,
            "FIRST_STATE": first,
        }
        if self._moving:
            defined["OUTPUTS"] = f"{name}_outputs"
        lines = [f'#include "{name}.h"', ""]
        lines += [f"#define {key} {value}" for key, value in defined.items()]
        lines += [
            "",
            "typedef struct {",
            f"  {name} model;",
            f"  double start[{len(starts) or 1}];",
        ]
        lines += ["  double time;", "  int32_t mode, stale, invalid, valid, sound;", "} Data;", ""]
        lines += ["static const struct {", "  const char *name;", "  size_t offset;"]
        lines += ["  double start, least, most;", "  bool output, fixed;", "} VARIABLE[] = {"]
        for v in variables:
            numbers = ", ".join(map(_c, (v.start or 0.0, v.lower, v.upper)))
            flags = f"{int(v.causality == 'output')}, {int(v.fixed)}"
            lines.append(f"  {{{_text(v.name)}, offsetof(Data, {v.member}), {numbers}, {flags}}},")
        return "\n".join([*lines, "};", ""])

    def description(self) -> bytes:
        """Return the text of modelDescription.xml."""
        root = ET.Element("fmiModelDescription", fmiVersion=f"{self._version}.0")
        root.set("modelName", self.name)
        root.set("instantiationToken" if self._version == 3 else "guid", self._token)
        root.set("description", self._block.about)
        root.set("generationTool", "cranedyn")
        if self._version == 2:
            root.set("variableNamingConvention", "flat")
            root.set("numberOfEventIndicators", "0")
        state = "FMUState" if self._version == 3 else "FMUstate"
        able = {f"canGetAndSet{state}": "true", f"canSerialize{state}": "true"}
        kinds = {"ModelExchange": able} if self._moving and not self._block.arrays else {}
        if self._version == 3:
            able = able | {"fixedInternalStepSize": repr(self._block.period)}
        kinds["CoSimulation"] = able | {"canHandleVariableCommunicationStepSize": "true"}
        for kind, abilities in kinds.items():
            entry = add(root, kind, modelIdentifier=self.name, **abilities)
            if self._version == 2:
                files = add(entry, "SourceFiles")
                for name in (self._interface, f"{self._block.name}.c"):
                    add(files, "File", name=name)
        units = add(root, "UnitDefinitions")
        for unit in sorted({variable.unit for variable in self._variables} - {""}):
            add(add(units, "Unit", name=unit), "BaseUnit", **_BASE[unit])
        size = self._block.period * (10 if self._moving else 1)
        add(root, "DefaultExperiment", startTime="0", stopTime="10", stepSize=f"{size!r}")
        self._list(root)
        return xml_bytes(root)

    def _list(self, root: ET.Element) -> None:
        """Add the variables and the structure; indices of FMI 2.0 begin at 1."""
        new, variables = self._version == 3, self._variables
        listed, structure = add(root, "ModelVariables"), add(root, "ModelStructure")
        for reference, variable in enumerate(variables):
            entries, numbers = self._entries(reference, variable), self._numbers(variable)
            if variable.rate_of is not None:
                numbers["derivative"] = str(variable.rate_of + (not new))
            kind = ("Float64" if new else "Real") if variable.unit else "Boolean"
            if new:
                ET.SubElement(listed, kind, entries | numbers)
            else:
                ET.SubElement(ET.SubElement(listed, "ScalarVariable", entries), kind, numbers)
        outputs = [i for i, variable in enumerate(variables) if variable.causality == "output"]
        rates = [i for i, variable in enumerate(variables) if variable.rate_of is not None]
        derivative = "ContinuousStateDerivative" if new else "Derivative"
        for name, references in (
            ("Output", outputs),
            (derivative, rates),
            ("InitialUnknown", outputs),
        ):
            group = structure if new or not references else add(structure, f"{name}s")
            for i in references:
                if new:
                    add(group, name, valueReference=str(i))
                else:
                    add(group, "Unknown", index=str(i + 1))

    @staticmethod
    def _entries(reference: int, variable: FmiVariable) -> dict[str, str]:
        entries = {
            "name": variable.name,
            "valueReference": str(reference),
            "causality": variable.causality,
        }
        if variable.about:
            entries["description"] = variable.about
        entries["variability"] = "continuous" if variable.unit else "discrete"
        if variable.causality == "parameter":
            entries["variability"] = "fixed" if variable.fixed else "tunable"
        if variable.causality == "output":
            entries["initial"] = "calculated"
        return entries

    @staticmethod
    def _numbers(variable: FmiVariable) -> dict[str, str]:
        entries = {"unit": variable.unit} if variable.unit else {}
        numbers = {"start": variable.start, "min": variable.lower, "max": variable.upper}
        return entries | {
            name: repr(value)
            for name, value in numbers.items()
            if value is not None and np.isfinite(value)
        }

    def build_description(self) -> bytes:
        """Return the text of buildDescription.xml."""
        root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
        configuration = add(root, "BuildConfiguration", modelIdentifier=self.name)
        files = add(configuration, "SourceFileSet", language="C99")
        for name in (self._interface, f"{self._block.name}.c"):
            add(files, "SourceFile", name=name)
        return xml_bytes(root)

    def library(self, platform_name: str) -> bytes:
        """Compile the shared library for a platform.

        Raises:
            CraneError: If there is no C compiler for it, or it fails.
        """
        compiler = _compiler(platform_name)
        with tempfile.TemporaryDirectory() as folder:
            workspace = Path(folder)
            for name, text in self.sources.items():
                (workspace / name).write_text(text)
            options = ["-std=c99", "-shared", "-O2", "-ffp-contract=off", "-fvisibility=hidden"]
            if not platform_name.endswith("windows"):
                options.append("-fPIC")
            files = [self._interface, f"{self._block.name}.c", "-o", "library", "-lm"]
            build = subprocess.run(
                [*compiler, *options, *files],
                cwd=workspace,
                capture_output=True,
                text=True,
                timeout=600,
                check=False,
            )
            if build.returncode:
                message = build.stderr.strip()[-500:]
                raise CraneError(f"The C compiler {compiler[0]} could not make the unit: {message}")
            return (workspace / "library").read_bytes()


def _compiler(platform_name: str) -> list[str]:
    """Return the command of a C compiler for a platform: that of this machine for its own kind,
    else Zig's.

    Raises:
        CraneError: If there is none.
    """
    if platform_name == _platform():
        compiler = next(filter(None, map(shutil.which, _COMPILERS)), None)
        if compiler is not None:
            return [compiler]
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc", "-target", PLATFORMS[platform_name][1]]
    if platform_name == _platform():
        raise CraneError(
            f"A unit is linked by a C compiler, and none of {', '.join(_COMPILERS)} is installed; "
            "on Debian: apt install gcc."
        )
    raise CraneError(
        f"A unit for {platform_name} is compiled by Zig: pip install 'cranedyn[cross]'."
    )


_BASE = {
    "s": {"s": "1"},
    "rad": {"rad": "1"},
    "m": {"m": "1"},
    "rad/s": {"rad": "1", "s": "-1"},
    "m/s": {"m": "1", "s": "-1"},
    "rad/s2": {"rad": "1", "s": "-2"},
    "m/s2": {"m": "1", "s": "-2"},
    "rad/s3": {"rad": "1", "s": "-3"},
    "m/s3": {"m": "1", "s": "-3"},
    "N": {"kg": "1", "m": "1", "s": "-2"},
    "N.m": {"kg": "1", "m": "2", "s": "-2"},
    "J": {"kg": "1", "m": "2", "s": "-2"},
    "kg": {"kg": "1"},
    "m2": {"m": "2"},
    "N.m.s/rad": {"kg": "1", "m": "2", "s": "-1", "rad": "-1"},
    "N.s/m": {"kg": "1", "s": "-1"},
}
"""Units in terms of SI base units."""


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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments beside the file and the crane."""
    add_option = parser.add_argument
    text = "what a crane's drives take (default: effort)"
    add_option("--drive", choices=get_args(Drive), help=text)
    text = "physics step of a crane [s] (default: 0.0005)"
    add_option("--dt", type=float, metavar="DT", help=text)
    add_option("--fmi", type=int, choices=(2, 3), default=3, help="version of FMI")
    add_option("--controller", choices=CONTROLLERS, help="a controller instead of the crane")
    text = f"all, or some of {', '.join(PLATFORMS)} (extra cross); this machine's by default"
    add_option("--platform", nargs="+", default=[], metavar="NAME", help=text)


def run(options: argparse.Namespace) -> Path:
    """Write what the command line describes, and return its path."""
    crane, controller = crane_from_options(options), None
    drive: Drive = options.drive or "effort"
    if options.controller is not None:
        for name in ("drive", "dt"):
            if getattr(options, name) is not None:
                raise DataError(f"--{name} has no effect with --controller; leave it out.")
        drive, make = CONTROLLERS[options.controller]
        controller = make(crane, 5e-3)
    platforms = [*PLATFORMS] if "all" in options.platform else options.platform
    dt = 5e-4 if options.dt is None else options.dt
    unit = {"controller": controller, "version": options.fmi, "platforms": platforms}
    return export(crane, options.target, drive=drive, dt=dt, **unit)
