"""Options of the command line that choose the controller which an exporter of code writes."""

from __future__ import annotations

import argparse
from typing import Any, Protocol, get_args

from cranedyn.errors import DataError
from cranedyn.export.target import name_default_rates
from cranedyn.export.usual_controllers import CONTROLLERS, rest_at_start, usual_controller
from cranedyn.interfaces import Controller, Drive
from cranedyn.model.crane import Crane
from cranedyn.references.motion import Motion

PERIOD = 5e-3
"""Control period of an exported controller, unless ``--period`` gives another one [s]."""


class OwnController(Protocol):
    """A controller of one's own. The command line opens its file, see
    `cranedyn.interop.controller_file`, and hands it on in the place of a name.

    Attributes:
        source: How it was named.
    """

    source: str

    def make(self, crane: Crane, motion: Motion) -> tuple[Controller, Drive]:
        """Return the controller about a motion, of one row for a rest, and what it commands."""


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
        help=f"{controller_help}: {names}, or one of one's own in FILE.py:FUNCTION (the file is "
        "run, and the function called with crane and motion), FILE.json or FILE.mat"
        + (f" (default {default})" if default else ""),
    )
    parser.add_argument(
        "--drive",
        choices=get_args(Drive),
        help="what the controller commands, by default what it usually does: velocity for drives "
        f"behind frequency converters, which take rates{drive_help}",
    )


def controller_words(options: argparse.Namespace) -> list[str]:
    """Return the words of a command line that name the same controller with the same period.

    Args:
        options: Options of `add_controller_options` that name a controller, and ``--period``.
    """
    controller = options.controller
    name = controller if isinstance(controller, str) else controller.source
    words = ["--controller", name]
    if options.drive is not None:
        words += ["--drive", options.drive]
    if options.period != PERIOD:
        words += ["--period", f"{options.period!r}"]
    return words


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
        CraneError: If one of one's own cannot be made.
    """
    if isinstance(options.controller, str):
        controller, drive = usual_controller(options.controller, crane, period, options.drive)
    else:
        controller, drive = _own_controller(options.controller, crane, period, options.drive)
    if drive != "effort" or options.controller == "predictive":
        name_default_rates(crane)
    return controller, drive


def _own_controller(
    own: OwnController, crane: Crane, period: float, drive: Drive | None
) -> tuple[Any, Drive]:
    """Return a controller of one's own about the start of a crane, and what it commands.

    Args:
        own: The controller.
        crane: The crane.
        period: Control period [s].
        drive: What it must command; None for what it does.

    Raises:
        DataError: If it commands something else.
        CraneError: If it cannot be made.
    """
    controller, own_drive = own.make(crane, rest_at_start(crane, period))
    if drive not in (None, own_drive):
        raise DataError(
            f"{own.source} commands drives of the mode {own_drive}, and --drive asks for {drive}; "
            "leave --drive out, or give the controller outputs of that mode."
        )
    return controller, own_drive
