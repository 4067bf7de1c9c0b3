"""``export``: one word names the door, the next where to write; ``python -m
cranedyn.bridges.command gazebo DIR``.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from cranedyn.command import Parser, command
from cranedyn.model.crane import STANDARD_GRAVITY
from cranedyn.model.description import add_values

DOORS = {
    "fmu": "cranedyn.bridges.fmi",
    "gazebo": "cranedyn.bridges.gazebo",
    "mcap": "cranedyn.bridges.mcap",
    "mjcf": "cranedyn.bridges.mjcf",
    "ros2": "cranedyn.bridges.ros2",
}
"""Doors by name: a module with `TARGET`, `add_arguments(parser)` and `run(options)`, whose first
paragraph of documentation says what it is.

`run` writes to `options.target` and returns it; `cranedyn.bridges.joints.loaded(options)` is the
crane that the command line describes.
"""


def parser() -> argparse.ArgumentParser:
    """The command line of all doors."""
    made = Parser(
        prog="python -m cranedyn export",
        description="Write a crane, or a run, for another program.",
    )
    doors = made.add_subparsers(
        dest="door", required=True, metavar="DOOR", help=f"one of {', '.join(DOORS)}"
    )
    for name, module in DOORS.items():
        door = import_module(module)
        about = " ".join((door.__doc__ or "").partition("\n\n")[0].split())
        one = doors.add_parser(
            name,
            help=about,
            description=about,
            formatter_class=argparse.ArgumentDefaultsHelpFormatter,
        )
        one.set_defaults(run=door.run)
        one.add_argument(
            "target",
            type=Path,
            metavar=door.TARGET,
            help="where to write; it must not be there yet",
        )
        one.add_argument(
            "--urdf",
            metavar="FILE",
            help="another crane than that of this project: a plain URDF, or a .xacro that you "
            "trust",
        )
        one.add_argument(
            "--gravity",
            type=float,
            default=STANDARD_GRAVITY,
            metavar="G",
            help="gravity of the world [m/s²]",
        )
        add_values(one, "numbers of the crane")
        door.add_arguments(one)
    return made


def main(arguments: Sequence[str] | None = None) -> int:
    """Write what the words ask for; 0, or 2 with one sentence for bad arguments."""
    return command(lambda: _main(parser().parse_args(arguments)))


def _main(options: argparse.Namespace) -> int:
    print(f"Written to {options.run(options)}.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
