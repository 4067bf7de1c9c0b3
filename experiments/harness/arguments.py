"""The command line of an experiment, and all that can be refused before it runs."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path
from typing import get_args

from cranedyn.command import Parser
from cranedyn.errors import DataError
from cranedyn.interfaces import EngineName

ROS = (".mcap", ".bag")
"""Endings of recordings of ROS."""


def called(name: str) -> str:
    """How the command line of an experiment begins: from a checkout, or from inside an installed
    package.
    """
    bundled = Path(__file__).parents[2].name == "_bundled"
    return f"python -m cranedyn run {name}" if bundled else f"python -m experiments.{name}"


def parser(
    name: str,
    description: str,
    *,
    recording: bool = True,
    engines: Sequence[str] = get_args(EngineName),
) -> argparse.ArgumentParser:
    """A parser with the arguments that every experiment has.

    Args:
        name: Of the experiment.
        description: What it shows.
        recording: Whether it leaves a recording, which can be saved elsewhere and looked at.
        engines: What may compute its steps, the default first.
    """
    made = Parser(
        prog=called(name),
        description=description,
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    made.add_argument(
        "--out",
        metavar="DIR",
        help=f"folder for results, default out/{name}",
        default=argparse.SUPPRESS,
    )
    made.add_argument(
        "--document",
        metavar="FILE.md",
        help="put the tables between their marks in this document, too",
        default=argparse.SUPPRESS,
    )
    made.set_defaults(experiment=name, live=False, modes={}, view=False, serve=False)
    if recording:
        _add_recording(made)
    add_engine(made, engines)
    return made


def _add_recording(made: argparse.ArgumentParser) -> None:
    made.add_argument(
        "--save",
        metavar="FILE.rrd",
        help="write the recording here instead of into the folder",
        default=argparse.SUPPRESS,
    )
    made.add_argument("--view", action="store_true", help="open the recording in the Rerun viewer")
    made.add_argument(
        "--serve",
        action="store_true",
        help="serve the recording to a browser on this machine until Ctrl-C",
    )
    made.add_argument(
        "--port",
        type=int,
        default=9090,
        metavar="P",
        help="where --serve has its page; the data is at the next port",
    )


def add_engine(
    made: argparse.ArgumentParser, engines: Sequence[str] = get_args(EngineName)
) -> None:
    """Add the choice of what computes a step, the default first."""
    made.add_argument(
        "--engine",
        choices=engines,
        default=engines[0],
        help="what computes a step: Pinocchio's algorithms, or code compiled for the crane, which "
        "agrees to round-off and is faster",
    )


def add_mode(made: argparse.ArgumentParser, name: str, *uses: str) -> None:
    """Say that with one argument of an experiment only these have an effect, beside where things
    are written; others are refused.
    """
    made.set_defaults(modes={**made.get_default("modes"), name: uses})


def parsed(made: argparse.ArgumentParser, argv: Sequence[str] | None) -> argparse.Namespace:
    """The arguments, checked as far as they can be before a run, with the folder of the results and
    the file of the recording.

    Raises:
        DataError: If an argument would be ignored, or a file has a name that it cannot have.
        CraneError: If a recording could not be made, or not shown as asked for.
    """
    options = made.parse_args(argv)
    _check_effect(made, options)
    _check_recording(options)
    options.folder, options.recording = _targets(options)
    return options


def _check_effect(made: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    given = [name for name, value in vars(options).items() if value != made.get_default(name)]
    flags = {
        name: f"--{ {'files': 'from', 'values': 'set'}.get(name, name.replace('_', '-')) }"
        for name in given
    }
    for mode, uses in options.modes.items():
        if mode in given:
            for name in given:
                if name not in (mode, "out", "document", *uses):
                    raise DataError(
                        f"{flags[name]} has no effect beside {flags[mode]}; leave it out."
                    )
    kinds = (
        {Path(file).suffix in ROS for file in options.files or ()} if "files" in options else set()
    )
    if "joints" in given and True not in kinds:
        raise DataError(
            "--joints has no effect without --from and an .mcap or .bag file; leave it out."
        )
    if "columns" in given and False not in kinds:
        raise DataError(
            "--columns has no effect without --from and a .csv or .parquet file; leave it out."
        )
    if "port" in given and not options.serve:
        raise DataError("--port has no effect without --serve; leave it out.")


def _check_recording(options: argparse.Namespace) -> None:
    if hasattr(options, "port") and not any(getattr(options, mode, None) for mode in options.modes):
        from cranedyn import recording

        recording.check_enabled()
        if options.view:
            recording.check_display()
        if options.serve:
            recording.check_port(options.port)


def _targets(options: argparse.Namespace) -> tuple[Path, Path]:
    given = getattr(options, "out", None)
    folder = Path(given if given is not None else Path("out") / options.experiment)
    if os.path.exists(folder) and not os.path.isdir(folder):
        raise DataError(f"Cannot write to {folder}: it is not a folder.")
    if given is not None and not os.path.isdir(folder.absolute().parent):
        raise DataError(
            f"Cannot make the folder {folder}: its parent {folder.absolute().parent} does not "
            "exist."
        )
    recording = Path(getattr(options, "save", folder / f"{options.experiment}.rrd"))
    if recording.suffix != ".rrd":
        raise DataError(f"Cannot save the recording as {recording}: the ending must be .rrd.")
    if hasattr(options, "save") and not os.path.isdir(recording.absolute().parent):
        raise DataError(f"Cannot save the recording as {recording}: its folder does not exist.")
    return folder, recording
