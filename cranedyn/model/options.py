"""Options of a command line that name a crane."""

from __future__ import annotations

import argparse
from typing import Any

from cranedyn.errors import DataError
from cranedyn.model.description import parse_values


def add_crane_options(parser: argparse._ActionsContainer) -> None:
    """Add ``--urdf``, ``--swing``, ``--driven``, ``--role`` and ``--package`` to a parser."""
    parser.add_argument(
        "--urdf",
        metavar="FILE",
        default=None,
        help="another crane: a plain URDF or MJCF, or a .xacro that you trust",
    )
    parser.add_argument(
        "--swing",
        nargs="*",
        default=None,
        metavar="name:=value",
        help="hang the hook of that URDF on a rope; length:=, mass:= and damping:= may be given",
    )
    parser.add_argument(
        "--driven", nargs="+", default=None, metavar="JOINT", help="joints that drives move"
    )
    parser.add_argument(
        "--role",
        nargs="+",
        default=None,
        metavar="ROLE=JOINT",
        help="slew, trolley, radial_swing, tangential_swing or hoist of a tower crane",
    )
    parser.add_argument(
        "--package",
        nargs="+",
        default=None,
        metavar="NAME=FOLDER",
        help="folders of ROS packages that are not above the file",
    )


def load_options(options: argparse.Namespace) -> dict[str, Any]:
    """Return the arguments of `load_crane` that the options of `add_crane_options` name.

    Raises:
        DataError: If an option has another form, or no effect without ``--urdf``.
    """
    for name in ("swing", "driven", "role", "package"):
        if options.urdf is None and getattr(options, name) is not None:
            raise DataError(f"--{name} has no effect without --urdf; leave it out.")
    if options.urdf is None:
        return {}
    arguments: dict[str, Any] = {"urdf": options.urdf, "driven": options.driven}
    if options.swing is not None:
        arguments["swing"] = parse_values(options.swing) or True
    if options.role is not None:
        arguments["joints"] = _pairs("role", options.role)
    if options.package is not None:
        arguments["packages"] = _pairs("package", options.package)
    return arguments


def _pairs(option: str, texts: list[str]) -> dict[str, str]:
    pairs = {}
    for text in texts:
        name, mark, value = text.partition("=")
        if not mark:
            raise DataError(f"{text!r} of --{option} is not of the form NAME=VALUE.")
        pairs[name] = value
    return pairs
