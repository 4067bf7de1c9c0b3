"""Structured Text (IEC 61131-3): a controller as a function block of a PLC, with PLCopen XML
beside.

``python -m cranedyn export st FILE.st`` writes both.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from cranedyn.command import command_line
from cranedyn.compiled.horizon.receding import Receding
from cranedyn.compiled.structured_text import plcopen_xml, structured_text
from cranedyn.data.files import with_ending
from cranedyn.dynamics.converters import Converters
from cranedyn.errors import DataError
from cranedyn.export.controller_block import controller_block
from cranedyn.export.controller_options import (
    PERIOD,
    add_controller_options,
    controller_from_options,
    controller_words,
)
from cranedyn.export.target import check_free, new_file
from cranedyn.interfaces import Drive
from cranedyn.model.crane import Crane
from cranedyn.model.options import crane_from_options, crane_words

TARGET = "FILE"
"""What the command line calls the target of the export."""

EXAMPLE = "controller.st --controller lqr"
"""Example of a target, for the help of the command line."""


def export(
    crane: Crane,
    path: str | Path,
    controller: Any,
    *,
    drive: Drive = "effort",
    control_period: float = 5e-3,
    duration: float = 30.0,
    converters: Converters | None = None,
) -> Path:
    """Write a controller as Structured Text, and as PLCopen XML in a file beside that ends in .xml.

    Args:
        crane: The crane.
        path: New file, ending in ``.st``.
        controller: The controller, see `cranedyn.export.controller_block.controller_block`.
        drive: What the commands are.
        control_period: Cycle of the task that calls the block [s].
        duration: Time that the tables cover [s].
        converters: Frequency converters of the drives; None for typical ones.

    Raises:
        OutOfRange: If a number is out of range.
        DataError: If a file does not end so, exists or cannot be written, or the controller cannot
            be exported, such as predictive control.
        ModelError: If the controller needs a function that Structured Text lacks.
    """
    final = with_ending(path, ".st")
    beside = final.with_suffix(".xml")
    check_free(final)
    check_free(beside)
    if isinstance(controller, Receding):
        raise DataError(
            "Predictive control is an optimisation with loops, which is not written in Structured "
            "Text. Export it as C or as an FMU, for a controller that runs C; on a PLC take "
            "lqr or yielding, whose calls have about a hundred operations and fit a cycle of 5 ms."
        )
    block = controller_block(
        crane,
        controller,
        drive=drive,
        control_period=control_period,
        duration=duration,
        converters=converters,
        name="crane_controller",
    )
    with new_file(beside) as draft:
        draft.write_bytes(plcopen_xml(block))
    with new_file(final) as draft:
        draft.write_text(structured_text(block))
    return final


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments beside the file and the crane."""
    add_controller_options(parser, "the controller", "", default="lqr")
    parser.add_argument(
        "--period",
        type=float,
        default=PERIOD,
        metavar="T",
        help="cycle of the task that calls the block [s]",
    )


def run(options: argparse.Namespace) -> Path:
    """Write what the command line describes, and return its path."""
    crane = crane_from_options(options)
    controller, drive = controller_from_options(options, crane, options.period)
    return export(crane, options.target, controller, drive=drive, control_period=options.period)


def next_commands(options: argparse.Namespace) -> list[str]:
    """Return command lines that work with what `run` has written."""
    crane = crane_words(options)
    same_in_c = options.target.with_name(f"{options.target.stem}_c")
    controller = controller_words(options)
    return [
        command_line("cranedyn", "serve", "--opcua", "127.0.0.1:4840", *crane),
        command_line("cranedyn", "export", "c", same_in_c, *controller, *crane),
    ]
