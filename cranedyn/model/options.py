"""Options of a command line that name a crane, and the crane that they name."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import Any

from cranedyn.errors import DataError, quoted
from cranedyn.model.crane import Crane
from cranedyn.model.description import parse_values
from cranedyn.model.load import load_crane


def add_crane_options(parser: argparse._ActionsContainer) -> None:
    """Add ``--machine``, ``--urdf``, ``--swing``, ``--driven``, ``--role`` and ``--package`` to a
    parser.
    """
    add, text = parser.add_argument, "a real crane; describe --machines names all"
    add("--machine", metavar="NAME", help=text)
    text = "another crane: a plain URDF, MJCF or SDF, or a .xacro that you trust"
    add("--urdf", metavar="FILE", help=text)
    text = "hang the hook of that URDF on a rope; length:=, mass:= and damping:= may be given"
    add("--swing", nargs="*", metavar="name:=value", help=text)
    add("--driven", nargs="+", metavar="JOINT", help="joints that drives move")
    text = "slew, trolley, radial_swing, tangential_swing or hoist of a tower crane"
    add("--role", nargs="+", metavar="ROLE=JOINT", help=text)
    text = "folders of ROS packages that are not above the file"
    add("--package", nargs="+", metavar="NAME=FOLDER", help=text)


def load_options(options: argparse.Namespace) -> dict[str, Any]:
    """Return the arguments of `load_crane` that the options of `add_crane_options`, values and
    gravity name.

    Raises:
        DataError: If an option has another form, or no effect without ``--urdf``.
    """
    for name in ("swing", "driven", "role", "package"):
        if options.urdf is None and getattr(options, name) is not None:
            raise DataError(f"--{name} has no effect without --urdf; leave it out.")
    arguments: dict[str, Any] = {
        "urdf": options.urdf,
        "machine": options.machine,
        "driven": options.driven,
        "gravity": getattr(options, "gravity", None),
        "values": parse_values(options.values),
    }
    if options.swing is not None:
        arguments["swing"] = parse_values(options.swing) or True
    if options.role is not None:
        arguments["joints"] = parse_pairs("role", options.role)
    if options.package is not None:
        arguments["packages"] = parse_pairs("package", options.package)
    return arguments


def crane_from_options(options: argparse.Namespace) -> Crane:
    """Load the crane that the command line names."""
    return load_crane(**load_options(options))


def crane_of_run(options: argparse.Namespace, record: Mapping[str, Any]) -> Crane:
    """Load the crane that the command line names; if none, that of the record of a run."""
    named = options.urdf is not None or options.machine is not None or options.values
    return load_crane(from_record=record) if record and not named else crane_from_options(options)


def parse_pairs(option: str, texts: Sequence[str]) -> dict[str, str]:
    """Return values by name from the texts of an option, such as ``l=hoist``.

    Raises:
        DataError: If a text has another form, or a name comes twice.
    """
    pairs: dict[str, str] = {}
    for text in texts:
        name, _, value = text.partition("=")
        if not (name and value) or name in pairs:
            form = "is not of the form NAME=VALUE, each name once"
            raise DataError(f"{quoted(text)} of --{option} {form}.")
        pairs[name] = value
    return pairs
