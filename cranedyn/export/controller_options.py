"""Options of the command line that choose the controller which an exporter of code writes."""

from __future__ import annotations

import argparse
from typing import Any, get_args

from cranedyn.export.target import name_default_rates
from cranedyn.export.usual_controllers import CONTROLLERS, usual_controller
from cranedyn.interfaces import Drive
from cranedyn.model.crane import Crane


def add_controller_options(
    parser: argparse.ArgumentParser, controller_help: str, drive_help: str, default: str | None
) -> None:
    """Add ``--controller`` and ``--drive``.

    Args:
        parser: The parser.
        controller_help: What the exporter does with the controller.
        drive_help: What the drive mode is for besides the controller; may be empty.
        default: The controller where none is given; None for no controller.
    """
    names = ", ".join(CONTROLLERS)
    parser.add_argument(
        "--controller",
        metavar="NAME",
        default=default,
        help=f"{controller_help}: {names}" + (f" (default {default})" if default else ""),
    )
    parser.add_argument(
        "--drive",
        choices=get_args(Drive),
        help="what the controller commands, by default what it usually does: velocity for drives "
        f"behind frequency converters, which take rates{drive_help}",
    )


def controller_from_options(
    options: argparse.Namespace, crane: Crane, period: float
) -> tuple[Any, Drive]:
    """Return the controller that a command line names, and what its commands are.

    A line is printed for each drive whose rate is not that of the crane, if the controller uses it.

    Args:
        options: Options of `add_controller_options`, which name a controller.
        crane: The crane.
        period: Control period [s].

    Raises:
        UnknownName: If there is no such controller.
        DataError: If it does not exist for drives of the mode that is asked for.
    """
    controller, drive = usual_controller(options.controller, crane, period, options.drive)
    if drive != "effort" or options.controller == "predictive":
        name_default_rates(crane)
    return controller, drive
