"""Options of a command line that name a crane, and the crane that they name."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cranedyn.data.files import parse_json, read_text
from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import DataError, quoted
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane


def add_crane_options(parser: argparse._ActionsContainer) -> None:
    """Add ``--machine``, ``--urdf``, ``--swing``, ``--driven``, ``--payload``, ``--locked``,
    ``--role`` and ``--package`` to a parser.
    """
    add = parser.add_argument
    add("--machine", metavar="NAME", help="a real crane; describe --machines names all")
    add(
        "--urdf",
        metavar="FILE",
        help="another crane: a plain URDF, MJCF or SDF, or a .xacro that you trust",
    )
    add(
        "--swing",
        nargs="*",
        metavar="name:=value",
        help="hang the hook of that URDF on a rope; length:=, mass:= and damping:= may be given",
    )
    add("--driven", nargs="+", metavar="JOINT", help="joints that drives move")
    add(
        "--payload",
        metavar="JOINT",
        help="joint that carries the payload, where several carry no other",
    )
    add(
        "--locked",
        nargs="+",
        metavar="JOINT[=VALUE]",
        help="joints that are held fixed where they start, or at a coordinate in rad or m",
    )
    add(
        "--role",
        nargs="+",
        metavar="ROLE=JOINT",
        help="slew, trolley, radial_swing, tangential_swing or hoist of a tower crane",
    )
    add(
        "--package",
        nargs="+",
        metavar="NAME=FOLDER",
        help="folders of ROS packages that are not above the file",
    )


def add_gravity(parser: argparse._ActionsContainer) -> None:
    """Add ``--gravity`` to a parser."""
    text = "gravity of the world [m/s²]; by default that of the file, or standard gravity"
    parser.add_argument("--gravity", type=float, metavar="G", help=text)


def add_values(parser: argparse._ActionsContainer, text: str) -> None:
    """Add the option ``--set`` for `parse_values` to a parser."""
    parser.add_argument(
        "--set",
        dest="values",
        nargs="+",
        action="extend",
        default=[],
        metavar="name:=value",
        help=text,
    )


def parse_values(pairs: Sequence[str]) -> dict[str, str]:
    """Return values by name from pairs such as ``payload_mass:=2000``, or from the ``.json`` file
    of an identified twin, which contains its arguments.

    Raises:
        DataError: If a pair has another form, a name is given twice, or a file has no arguments.
    """
    values: dict[str, str] = {}
    for pair in pairs:
        # A value may end like the name of a file, too.
        if pair.endswith(".json") and ":=" not in pair:
            entries = _twin_arguments(pair)
        else:
            name, mark, value = pair.partition(":=")
            if not mark:
                raise DataError(f"{pair!r} is not of the form name:=value.")
            entries = {name: value}
        for name, value in entries.items():
            if name in values:
                raise DataError(
                    f"{quoted(name)} is given twice, as {values[name]!r} and as {value!r}."
                )
            values[name] = value
    return values


def _twin_arguments(path: str) -> dict[str, str]:
    """Return the arguments of this project's crane in the record of a crane, as text."""
    try:
        values = parse_json(read_text(path))["crane"]["arguments"]
        for value in values.values():
            # JSON has no infinite number: a record has the word.
            if not isinstance(value, float | int) and value not in ("inf", "-inf"):
                raise TypeError
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        raise DataError(
            f"{path} lists no arguments of this project's crane; allowed is a twin that identify "
            "wrote."
        ) from None
    return {str(name): str(value) for name, value in values.items()}


def load_options(options: argparse.Namespace) -> dict[str, Any]:
    """Return the arguments of `load_crane` that the options of `add_crane_options`, values and
    gravity name.

    Raises:
        DataError: If an option has another form, or is allowed only with ``--urdf``.
    """
    for name in ("swing", "driven", "payload", "locked", "role", "package"):
        if options.urdf is None and getattr(options, name) is not None:
            raise DataError(f"--{name} is allowed only with --urdf; leave it out.")
    arguments: dict[str, Any] = {
        "urdf": options.urdf,
        "machine": options.machine,
        "driven": options.driven,
        "payload": options.payload,
        "gravity": getattr(options, "gravity", None),
        "values": parse_values(options.values),
    }
    if options.swing is not None:
        arguments["swing"] = parse_values(options.swing)
    if options.locked is not None:
        arguments["locked"] = parse_locked(options.locked)
    if options.role is not None:
        arguments["joints"] = parse_pairs("role", options.role)
    if options.package is not None:
        arguments["packages"] = parse_pairs("package", options.package)
    return arguments


def crane_from_options(options: argparse.Namespace) -> Crane:
    """Load the crane that the command line names."""
    return load_crane(**load_options(options))


def crane_words(options: argparse.Namespace, *, gravity: bool = True) -> list[str]:
    """Return the words of a command line that name the crane that the options name, for a command
    with the options of `add_crane_options` and `add_values`.

    Args:
        options: The options.
        gravity: Whether to name its gravity, for a command that also has `add_gravity`.
    """
    words: list[str] = []
    for name in ("machine", "urdf", "payload"):
        value = getattr(options, name)
        if value is not None:
            words += [f"--{name}", value]
    for name in ("swing", "driven", "locked", "role", "package"):
        values = getattr(options, name)
        if values is not None:
            words += [f"--{name}", *values]
    if gravity and getattr(options, "gravity", None) is not None:
        words += ["--gravity", repr(options.gravity)]
    if options.values:
        words += ["--set", *options.values]
    return words


def crane_of_run(options: argparse.Namespace, run: Trajectory, file: str | Path) -> Crane:
    """Load the crane that the command line names; if none, that of the record of a run.

    Args:
        options: The options of `add_crane_options`.
        run: The run.
        file: Its file, for the error message.

    Raises:
        DataError: If the run is one of a crane with other coordinates.
    """
    named = options.urdf is not None or options.machine is not None or options.values
    if run.record and not named:
        return load_crane(from_record=run.record)
    crane = crane_from_options(options)
    recorded = run.columns["q"]
    expected = crane.layout.columns()["q"]
    if recorded != expected:
        advice = "name the crane that it was made with"
        if run.record:
            advice = "leave out --urdf, --machine and --set, since the file says which crane it is"
        if options.urdf is not None and options.swing is None and len(recorded) > len(expected):
            advice = f"{advice}, or give --swing as for the run"
        raise DataError(
            f"{file} is a run of a crane with the coordinates {', '.join(recorded)}; the crane "
            f"that the command line names has {', '.join(expected)}. To read it, {advice}."
        )
    return crane


def parse_locked(texts: Sequence[str]) -> dict[str, str | None]:
    """Return the coordinates of locked joints by name, None for where they start, from texts such
    as ``outrigger`` or ``boom=0.5``.

    Raises:
        DataError: If a joint comes twice, or has no name.
    """
    locked: dict[str, str | None] = {}
    for text in texts:
        name, mark, value = text.partition("=")
        if not name or name in locked:
            raise DataError(f"{quoted(text)} of --locked is not of the form JOINT or JOINT=VALUE.")
        locked[name] = value if mark else None
    return locked


def parse_pairs(option: str, texts: Sequence[str]) -> dict[str, str]:
    """Return values by name from the texts of an option, such as ``hoist=lift_joint``.

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
