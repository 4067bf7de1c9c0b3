"""The crane, or a controller, as a unit of FMI 3.0 or 2.0 (an FMU), with its sources in C and
libraries that need no Python.

``python -m cranedyn export fmu FILE.fmu`` writes one. A unit is a zip file with

* ``modelDescription.xml``, which lists the variables and what an importer may do with the unit;
* ``sources``: the block in C99, the interface of FMI (``fmi2.c`` or ``fmi3.c``), and ``unit.h``,
  which connects the two by a table of the variables;
* ``binaries``: the same sources as a shared library for each platform.
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
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from cranedyn.command import command_line
from cranedyn.compiled.block import FunctionBlock, Variable
from cranedyn.compiled.c_text import c_header, c_source
from cranedyn.compiled.crane_block import crane_block
from cranedyn.data.files import with_ending
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.errors import CraneError, DataError, ModelError, OutOfRange, UnknownName, quoted
from cranedyn.export.controller_block import controller_block
from cranedyn.export.controller_options import add_controller_options, controller_from_options
from cranedyn.export.crane_data import add, xml_bytes
from cranedyn.export.target import check_free, new_file
from cranedyn.interfaces import Drive
from cranedyn.model.crane import Crane
from cranedyn.model.options import crane_from_options

TARGET = "FILE"
"""What the command line calls the target of the export."""

EXAMPLE = "crane.fmu"
"""Example of a target, for the help of the command line."""

Version = Literal[2, 3]
"""Version of FMI."""

NAME = "cranedyn_crane"
"""Name of the model of a crane, and of its library."""

CONTROLLER_NAME = "cranedyn_controller"
"""Name of the model of a controller, and of its library."""


class TargetPlatform(NamedTuple):
    """A kind of machine for which units are made.

    Attributes:
        fmi2_name: Its name in FMI 2.0, the folder of the library in a unit.
        zig_target: Target of the compiler Zig; on Linux with the oldest glibc on which a unit runs.
        ending: Ending of a shared library.
    """

    fmi2_name: str
    zig_target: str
    ending: str


PLATFORMS = {
    "x86_64-linux": TargetPlatform("linux64", "x86_64-linux-gnu.2.17", ".so"),
    "aarch64-linux": TargetPlatform("aarch64-linux", "aarch64-linux-gnu.2.17", ".so"),
    "x86_64-windows": TargetPlatform("win64", "x86_64-windows-gnu", ".dll"),
    "x86_64-darwin": TargetPlatform("darwin64", "x86_64-macos", ".dylib"),
    "aarch64-darwin": TargetPlatform("aarch64-darwin", "aarch64-macos", ".dylib"),
}
"""Platforms by their name in FMI 3.0."""

CONTROL_PERIOD = 5e-3
"""Period of a controller, unless another is asked for [s]."""

PHYSICS_STEP = 5e-4
"""Physics step of a crane, unless another is asked for [s]."""

_STEPS_OF_COMMUNICATION = 10
"""Physics steps in the communication step that the description of a crane suggests: those of a
control period of `simulate`."""

_COMPILER_TIMEOUT = 600
"""Longest time for which a compiler may run [s]."""

_MAX_COMPILER_MESSAGE = 500
"""Number of characters of the end of a compiler's output that an error shows."""

_SOURCES = Path(__file__).parent
"""Folder of the sources in C that all units share."""

_HEADERS = ("fmi_unit.h", "fmi_shared.h")
"""Headers that all units share."""

_COMPILERS = ("cc", "gcc", "clang")
"""Commands of C compilers, in the order in which they are looked for."""

_DATE = (1980, 1, 1, 0, 0, 0)
"""Date of the files in a unit, the earliest of a zip file: a fixed one makes units of equal cranes
equal."""


@dataclass(frozen=True)
class FmiVariable:
    """Variable of the unit.

    The token of a unit is computed from the texts of its variables, so names and order of these
    fields are part of it.

    Attributes:
        name: Name.
        member: Member of the C structure `Data` in which its value lies, see `_Unit`.
        unit: Unit; empty for a Boolean.
        causality: Causality of FMI: independent, input, parameter or output.
        start: Start value; None for a computed variable.
        lower: Smallest value.
        upper: Largest value.
        about: Description.
        fixed: Whether it is constant once stepping has begun.
        rate_of: Index of the variable whose time derivative it is; None if it is none.
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
    dt: float = PHYSICS_STEP,
    integrator: Integrator = semi_implicit_euler,
    controller: Any = None,
    control_period: float = CONTROL_PERIOD,
    duration: float = 30.0,
    version: Version = 3,
    platforms: Sequence[str] = (),
    base: bool = False,
) -> Path:
    """Write a crane, or a controller for it, as an FMU.

    The inputs of a crane are the commands of the drives and forces from outside, held over a
    communication step, which is a multiple of `dt`; its outputs are the state, the efforts, the
    energy, and whether the model holds. It moves as in `simulate` with validity="mark" and the
    communication step as control period. Its parameters can be changed while it runs.

    With `base` the crane stands on a base that moves, whose motion is an input, see
    `cranedyn.compiled.crane_block.base_inputs`. In model exchange the base moves as smoothly as the
    importer lets it. In co-simulation its motion is held over a communication step H like all
    inputs: values from the beginning of each step let the base move H/2 late, and values from the
    middle leave an error of the order of H².

    The inputs of a controller are the measured state and the setpoints, its outputs the commands.
    They follow the inputs at once; a step of one control period advances the memory.

    Args:
        crane: The crane.
        path: New file, ending in ``.fmu``.
        drive: Drive mode, see `simulate`. With "velocity" the unit is for co-simulation only.
        dt: Physics step [s].
        integrator: The stepping rule.
        controller: The controller, see `cranedyn.export.controller_block`; None for the crane.
        control_period: Period of the controller [s].
        duration: Time that tables of the controller cover [s].
        version: Version of FMI.
        platforms: Names in `PLATFORMS`; none for this kind of machine. Other kinds need the extra
            ``cross``.
        base: Whether the base on which the crane stands moves; not for a controller.

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
    version = 2 if version == 2 else 3  # an integer, also where 2.0 is given
    for name in platforms:
        if name not in PLATFORMS:
            raise UnknownName("platform", name, PLATFORMS)
    if controller is None:
        block = crane_block(crane, drive=drive, dt=dt, integrator=integrator, base=base)
    elif base:
        raise OutOfRange("base", True, "False for a controller, which has no base")
    else:
        block = controller_block(
            crane, controller, drive=drive, control_period=control_period, duration=duration
        )
    unit = _Unit(block, version)
    entries = {"modelDescription.xml": unit.description()}
    for name, text in unit.sources.items():
        entries[f"sources/{name}"] = text.encode()
    if version == 3:
        entries["sources/buildDescription.xml"] = unit.build_description()
    # Each platform once, in the order in which they are named.
    for name in dict.fromkeys(platforms or [_platform()]):
        target = PLATFORMS[name]
        folder = target.fmi2_name if version == 2 else name
        entries[f"binaries/{folder}/{unit.name}{target.ending}"] = unit.library(name)
    with new_file(final) as draft, zipfile.ZipFile(draft, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in entries.items():
            file.writestr(zipfile.ZipInfo(name, _DATE), content, zipfile.ZIP_DEFLATED)
    return final


def _is_crane(block: FunctionBlock) -> bool:
    """Return whether a block is a crane and not a controller: a crane has a function that computes
    its outputs without a step.
    """
    return "outputs" in block.functions


def _variables(block: FunctionBlock) -> list[FmiVariable]:
    """Return all variables of the unit; the value reference of each is its index.

    Their order is that of the state of a unit: time, inputs, parameters, start values, states,
    outputs, and whether the model holds.

    Raises:
        ModelError: If two of them have the same name.
    """
    name_of = {identifier: name for name, identifier in block.renamed.items()}

    def name(v: Variable) -> str:
        """Return the name of a variable of the block as the crane has it, which need not be an
        identifier of C.
        """
        return name_of.get(v.name, v.name)

    variables = [FmiVariable("time", "time", "s", "independent")]
    for v in block.of_kind("input"):
        member = f"model.{v.name}"
        variables.append(
            FmiVariable(name(v), member, v.unit, "input", start=v.start, about=v.about)
        )
    for v in block.of_kind("parameter"):
        member = f"model.{v.name}"
        variables.append(
            FmiVariable(name(v), member, v.unit, "parameter", v.start, v.lower, v.upper, v.about)
        )
    # The state of a crane is what a simulation shows; the memory of a controller is its own.
    states = block.of_kind("state") if _is_crane(block) else []
    for i, v in enumerate(states):
        variables.append(
            FmiVariable(
                f"{name(v)}_start",
                f"start[{i}]",
                v.unit,
                "parameter",
                v.start,
                v.lower,
                v.upper,
                "where it begins",
                fixed=True,
            )
        )

    # The states are the coordinates and then the rates, and the first outputs the accelerations. So
    # each rate, and each acceleration, is the derivative of the variable `half` places before.
    first_state = len(variables)
    half = len(states) // 2
    outputs = [v for v in block.of_kind("output") if v.name != "valid"]
    for i, v in enumerate([*states, *outputs]):
        rate_of = first_state + i - half if half <= i < 3 * half else None
        member = f"model.{v.name}"
        variables.append(
            FmiVariable(name(v), member, v.unit, "output", about=v.about, rate_of=rate_of)
        )

    validity = "false where the model or the inputs do not hold"
    if _is_crane(block):
        validity = (
            "false once a joint has left its range, the rope is slack or the load touches the "
            "ground"
        )
    variables.append(FmiVariable("valid", "valid", "", "output", about=validity))
    _check_names([variable.name for variable in variables])
    return variables


def _check_names(names: Sequence[str]) -> None:
    """Check that no two variables have the same name.

    Raises:
        ModelError: If two have.
    """
    repeated = [name for name in names if names.count(name) > 1]
    if repeated:
        raise ModelError(
            f"Two variables of the unit would have the name {quoted(repeated[0])}; rename a joint "
            "or a point of the crane."
        )


class _Unit:
    """Files of a unit.

    The sources are the block in C, the interface of the FMI version, the headers of all units, and
    ``unit.h``, which tells them about this block: its functions and a table of the variables.

    Attributes:
        name: Name of the model and of its library.
        sources: Texts in C, by the name of the file.
    """

    def __init__(self, block: FunctionBlock, version: Version) -> None:
        self._block = block
        self._version = version
        self._is_crane = _is_crane(block)
        self.name = NAME if self._is_crane else CONTROLLER_NAME
        self._variables = _variables(block)
        self._interface = f"fmi{version}.c"
        self._block_source = f"{block.name}.c"
        self.sources = {f"{block.name}.h": c_header(block), self._block_source: c_source(block)}
        for name in (*_HEADERS, self._interface):
            self.sources[name] = (_SOURCES / name).read_text()

        # An importer refuses a library whose token is not that of the description, which shows that
        # the two are of different exports. Equal units have equal tokens.
        content = repr((self._variables, block.period, self.sources)).encode()
        self._token = f"{{{hashlib.sha256(content).hexdigest()[:32]}}}"
        self.sources["unit.h"] = self._header()

    def _header(self) -> str:
        """Return the text of unit.h, which `fmi_unit.h` includes.

        It has the names of the functions and numbers of the block, the structure `Data` of one
        instance, and the table of the variables.
        """
        name = self._block.name
        starts = [i for i, variable in enumerate(self._variables) if variable.fixed]
        definitions = {
            "TOKEN": f'"{self._token}"',
            "DT": repr(self._block.period),
            "RESET": f"{name}_reset",
            "STEP": f"{name}_step",
            "LAST_COUNT": self._block.last,
            "STATES": len(starts),
            "START": starts[0] if starts else 0,
            # The states follow their start values.
            "FIRST_STATE": starts[-1] + 1 if starts else 0,
        }
        if self._is_crane:
            definitions["OUTPUTS"] = f"{name}_outputs"

        lines = [f'#include "{name}.h"', ""]
        for key, value in definitions.items():
            lines.append(f"#define {key} {value}")
        lines += [
            "",
            "typedef struct {",
            f"  {name} model;",
            f"  double start[{len(starts) or 1}];",  # C has no arrays without elements
            "  double time;",
            "  int32_t mode, stale, invalid, valid, sound;",
            "} Data;",
            "",
            "static const struct {",
            "  const char *name;",
            "  size_t offset;",
            "  double start, least, most;",
            "  bool output, fixed;",
            "} VARIABLE[] = {",
        ]
        for v in self._variables:
            numbers = ", ".join([_c(v.start or 0.0), _c(v.lower), _c(v.upper)])
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
        self._add_interfaces(root)

        units = add(root, "UnitDefinitions")
        for unit in sorted({variable.unit for variable in self._variables} - {""}):
            add(add(units, "Unit", name=unit), "BaseUnit", **_BASE_UNITS[unit])
        steps = _STEPS_OF_COMMUNICATION if self._is_crane else 1
        step_size = repr(self._block.period * steps)
        add(root, "DefaultExperiment", startTime="0", stopTime="10", stepSize=step_size)
        self._add_variables(root)
        self._add_structure(root)
        return xml_bytes(root)

    def _add_interfaces(self, root: ET.Element) -> None:
        """Add the kinds of simulation that the unit is for, each with its capabilities.

        Any crane or controller can be stepped (CoSimulation). A crane also gives its derivatives to
        a solver of the importer (ModelExchange), unless it keeps arrays, such as commands on their
        way to the converters, which have no derivatives.
        """
        state = "FMUState" if self._version == 3 else "FMUstate"
        common = {f"canGetAndSet{state}": "true", f"canSerialize{state}": "true"}
        capabilities_of = {}
        if self._is_crane and not self._block.arrays:
            capabilities_of["ModelExchange"] = common
        stepping = dict(common)
        if self._version == 3:
            stepping["fixedInternalStepSize"] = repr(self._block.period)
        stepping["canHandleVariableCommunicationStepSize"] = "true"
        capabilities_of["CoSimulation"] = stepping

        for kind, capabilities in capabilities_of.items():
            entry = add(root, kind, modelIdentifier=self.name, **capabilities)
            if self._version == 2:
                files = add(entry, "SourceFiles")
                for name in (self._interface, self._block_source):
                    add(files, "File", name=name)

    def _add_variables(self, root: ET.Element) -> None:
        """Add the variables. FMI 2.0 refers to a variable by its index from 1, FMI 3.0 by its value
        reference, which begins at 0.
        """
        is_fmi3 = self._version == 3
        listed = add(root, "ModelVariables")
        for reference, variable in enumerate(self._variables):
            entries = self._common_attributes(reference, variable)
            numbers = self._type_attributes(variable)
            if variable.rate_of is not None:
                numbers["derivative"] = str(variable.rate_of + (0 if is_fmi3 else 1))
            if is_fmi3:
                kind = "Float64" if variable.unit else "Boolean"
                ET.SubElement(listed, kind, entries | numbers)
            else:
                kind = "Real" if variable.unit else "Boolean"
                ET.SubElement(ET.SubElement(listed, "ScalarVariable", entries), kind, numbers)

    def _add_structure(self, root: ET.Element) -> None:
        """Add the lists of outputs, derivatives and unknowns of the initialisation; the last are
        the outputs again.
        """
        is_fmi3 = self._version == 3
        structure = add(root, "ModelStructure")
        outputs = [
            i for i, variable in enumerate(self._variables) if variable.causality == "output"
        ]
        rates = [i for i, variable in enumerate(self._variables) if variable.rate_of is not None]
        derivative = "ContinuousStateDerivative" if is_fmi3 else "Derivative"
        groups = {"Output": outputs, derivative: rates, "InitialUnknown": outputs}
        for name, references in groups.items():
            if is_fmi3:
                for i in references:
                    add(structure, name, valueReference=str(i))
            elif references:  # FMI 2.0 allows no list without entries
                group = add(structure, f"{name}s")
                for i in references:
                    add(group, "Unknown", index=str(i + 1))

    @staticmethod
    def _common_attributes(reference: int, variable: FmiVariable) -> dict[str, str]:
        """Return the attributes that a variable has in both versions, whatever its type."""
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
    def _type_attributes(variable: FmiVariable) -> dict[str, str]:
        """Return the attributes of the type of a variable: its unit, and start and range as far as
        they are finite.
        """
        entries = {"unit": variable.unit} if variable.unit else {}
        numbers = {"start": variable.start, "min": variable.lower, "max": variable.upper}
        for name, value in numbers.items():
            if value is not None and np.isfinite(value):
                entries[name] = repr(value)
        return entries

    def build_description(self) -> bytes:
        """Return the text of buildDescription.xml."""
        root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
        configuration = add(root, "BuildConfiguration", modelIdentifier=self.name)
        files = add(configuration, "SourceFileSet", language="C99")
        for name in (self._interface, self._block_source):
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
            # Products and sums are not fused, so that all platforms give the same numbers. Of the
            # library only the functions of FMI are visible.
            options = ["-std=c99", "-shared", "-O2", "-ffp-contract=off", "-fvisibility=hidden"]
            if not platform_name.endswith("windows"):
                options.append("-fPIC")
            files = [self._interface, self._block_source, "-o", "library", "-lm"]
            build = subprocess.run(
                [*compiler, *options, *files],
                cwd=workspace,
                capture_output=True,
                text=True,
                timeout=_COMPILER_TIMEOUT,
                check=False,
            )
            if build.returncode:
                message = build.stderr.strip()[-_MAX_COMPILER_MESSAGE:]
                raise CraneError(f"The C compiler {compiler[0]} could not make the unit: {message}")
            return (workspace / "library").read_bytes()


def _compiler(platform_name: str) -> list[str]:
    """Return the command of a C compiler for a platform.

    For the platform of this machine it is an installed compiler, where there is one; for any other
    it is that of Zig.

    Raises:
        CraneError: If there is none.
    """
    is_this_platform = platform_name == _platform()
    if is_this_platform:
        for command in _COMPILERS:
            compiler = shutil.which(command)
            if compiler is not None:
                return [compiler]
    if importlib.util.find_spec("ziglang") is not None:
        target = PLATFORMS[platform_name].zig_target
        return [sys.executable, "-m", "ziglang", "cc", "-target", target]
    if is_this_platform:
        raise CraneError(
            f"A unit is linked by a C compiler, and none of {', '.join(_COMPILERS)} is installed; "
            "on Debian: apt install gcc."
        )
    raise CraneError(
        f"A unit for {platform_name} is compiled by Zig: pip install 'cranedyn[cross]'."
    )


_BASE_UNITS = {
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
"""Exponents of the SI base units, and of the radian, in each unit."""


def _c(value: float) -> str:
    """Return a number as an expression of C."""
    if np.isfinite(value):
        return repr(float(value))
    return "INFINITY" if value > 0.0 else "-INFINITY"


def _text(name: str) -> str:
    """Return a name as a string literal of C. All its bytes are octal escapes, so that it may have
    any characters.
    """
    return '"' + "".join(f"\\{byte:03o}" for byte in name.encode()) + '"'


def _platform() -> str:
    """Return the name of this machine's platform in FMI 3.0.

    Raises:
        CraneError: If units cannot be built on it.
    """
    system = platform.system().lower()
    machine = platform.machine()
    # Windows and macOS have other names for the same processors.
    processor = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine.lower(), machine)
    if system not in ("linux", "darwin") or processor not in ("x86_64", "aarch64"):
        raise CraneError(
            "Units are made on Linux and macOS, x86_64 or aarch64; this machine is "
            f"{system} on {processor}."
        )
    return f"{processor}-{system}"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments beside the file and the crane."""
    add_controller_options(
        parser, "a controller instead of the crane", "; of a crane effort", default=None
    )
    parser.add_argument(
        "--dt", type=float, metavar="DT", help="physics step of a crane [s] (default: 0.0005)"
    )
    parser.add_argument(
        "--period",
        type=float,
        metavar="T",
        help=f"time from one call of the controller to the next [s] (default: {CONTROL_PERIOD})",
    )
    parser.add_argument(
        "--base", action="store_true", help="the motion of the crane's base is an input"
    )
    parser.add_argument("--fmi", type=int, choices=(2, 3), default=3, help="version of FMI")
    parser.add_argument(
        "--platform",
        nargs="+",
        default=[],
        metavar="NAME",
        help=f"all, or some of {', '.join(PLATFORMS)} (extra cross); this machine's by default",
    )


def run(options: argparse.Namespace) -> Path:
    """Write what the command line describes, and return its path."""
    crane = crane_from_options(options)
    platforms = [*PLATFORMS] if "all" in options.platform else options.platform
    if options.controller is None:
        if options.period is not None:
            raise DataError(
                "--period has no effect without --controller, since a crane is called in any "
                "multiple of its physics step; leave it out."
            )
        return export(
            crane,
            options.target,
            drive=options.drive or "effort",
            dt=PHYSICS_STEP if options.dt is None else options.dt,
            version=options.fmi,
            platforms=platforms,
            base=options.base,
        )
    if options.dt is not None:
        raise DataError("--dt has no effect with --controller, which has no physics; leave it out.")
    if options.base:
        raise DataError("--base has no effect with --controller, which has no base; leave it out.")
    period = CONTROL_PERIOD if options.period is None else options.period
    controller, drive = controller_from_options(options, crane, period)
    return export(
        crane,
        options.target,
        drive=drive,
        controller=controller,
        control_period=period,
        version=options.fmi,
        platforms=platforms,
    )


def next_commands(options: argparse.Namespace) -> list[str]:
    """Return command lines that work with what `run` has written."""
    return [
        command_line("fmpy", "validate", options.target),
        command_line("fmpy", "info", options.target),
    ]
