"""The command line of an experiment, and the checks before it runs."""

from __future__ import annotations

import argparse
import os
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import get_args

from cranedyn.command import Parser
from cranedyn.data.files import with_ending
from cranedyn.errors import DataError
from cranedyn.interfaces import EngineName
from experiments.catalogue import example


def command_name(name: str) -> str:
    """Return how the command line of an experiment begins."""
    return f"cranedyn run {name}"


def parser(
    name: str,
    description: str | None,
    *,
    recording: bool = True,
    engines: Sequence[str] = get_args(EngineName),
) -> Parser:
    """Return a parser with the arguments that every experiment has.

    Args:
        name: Name of the experiment.
        description: What it shows: the first paragraph of a text, such as the module's docstring.
        recording: Whether it writes a recording, which can be saved elsewhere and viewed.
        engines: Engines that may compute its steps, the default first.
    """
    result = Parser(
        prog=command_name(name),
        description=" ".join((description or "").partition("\n\n")[0].split()),
        example=shlex.join([*command_name(name).split(), *example(name)]),
    )
    result.set_defaults(experiment=name, live=False, modes={}, conditions=[])
    result.set_defaults(view=False, serve=False, film=None)
    add = result.common.add_argument
    no_default = argparse.SUPPRESS
    text = f"folder for results, default out/{name}"
    add("--out", metavar="DIR", help=text, default=no_default)
    add("--all", action="store_true", help="print all tables and claims, not one screen of them")
    text = "put the tables between their marks in this document, too"
    add("--document", metavar="FILE.md", help=text, default=no_default)
    if recording:
        text = "write the recording here instead of into the folder"
        add("--save", metavar="FILE.rrd", help=text, default=no_default)
        add("--view", action="store_true", help="open the recording in the Rerun viewer")
        text = "serve the recording to a browser on this machine until Ctrl-C"
        add("--serve", action="store_true", help=text)
        add("--film", metavar="FILE.mp4", help="write a film of the recording, too")
        text = "where --serve has its page; the data is at the next port"
        add("--port", type=int, default=9090, metavar="P", help=text)
        add_condition(result, "--serve", lambda options: options.serve, "port")
    add_engine(result.common, engines)
    return result


def add_engine(
    parser: argparse._ActionsContainer, engines: Sequence[str] = get_args(EngineName)
) -> None:
    """Add the choice of the engine, the default first."""
    text = (
        "what computes a step: Pinocchio's algorithms, or code compiled for the crane, which "
        "agrees to round-off, is faster, and alone computes ground and slack ropes"
    )
    parser.add_argument("--engine", choices=engines, default=engines[0], help=text)


def add_mode(parser: argparse.ArgumentParser, name: str, *uses: str) -> None:
    """Add a mode: beside its argument all others are refused that would have no effect.

    Args:
        parser: The parser.
        name: Destination of the argument that asks for the mode.
        *uses: Destinations of the arguments that have an effect in it, besides those that say what
            to print and where to write.
    """
    parser.set_defaults(modes={**parser.get_default("modes"), name: uses})


def add_condition(
    parser: argparse.ArgumentParser,
    needed: str,
    holds: Callable[[argparse.Namespace], bool],
    *names: str,
) -> None:
    """Refuse the arguments with these names unless a condition holds.

    Args:
        parser: The parser.
        needed: What they need, as the error message says it: "--serve".
        holds: Function that returns whether it is there.
        names: Destinations of the arguments.
    """
    conditions = [*parser.get_default("conditions"), (needed, holds, names)]
    parser.set_defaults(conditions=conditions)


def parse_arguments(
    parser: argparse.ArgumentParser, argv: Sequence[str] | None
) -> argparse.Namespace:
    """Return the arguments, with the folder of the results and the file of the recording, checked
    as far as possible before a run.

    Raises:
        DataError: If an argument has no effect, or a file cannot have its name.
        CraneError: If a recording could not be made or viewed.
    """
    options = parser.parse_args(argv)
    _check_effect(parser, options)
    _check_recording(options)
    options.folder, options.recording = _targets(options)
    return options


def _check_effect(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Refuse arguments that have no effect beside others, see `add_mode` and `add_condition`."""
    changed = _changed_arguments(parser, options)
    for mode, uses in options.modes.items():
        if mode not in changed:
            continue
        allowed = {mode, "out", "all", "document", *uses}
        for name, flag in changed.items():
            if name not in allowed:
                raise DataError(f"{flag} has no effect beside {changed[mode]}; leave it out.")
    for needed, holds, names in options.conditions:
        for name in names:
            if name in changed and not holds(options):
                raise DataError(f"{changed[name]} has no effect without {needed}; leave it out.")


def _changed_arguments(
    parser: argparse.ArgumentParser, options: argparse.Namespace
) -> dict[str, str]:
    """Return how an error message names each argument that is not at its default, by destination.

    An argument that was given its default value cannot be told from one that was not given.
    """
    flags = {}
    for action in parser._actions:
        named = action.option_strings
        flags[action.dest] = named[0] if named else f"A {action.metavar}"

    changed = {}
    for name, value in vars(options).items():
        if name in flags and value != parser.get_default(name):
            changed[name] = flags[name]
    return changed


def _check_recording(options: argparse.Namespace) -> None:
    """Check before the run that its recording can be made, shown, served and filmed as asked.

    Nothing is recorded by experiments without these arguments, nor in a mode, which reads files.
    """
    has_mode = any(getattr(options, mode, None) for mode in options.modes)
    if hasattr(options, "port") and not has_mode:
        from cranedyn import recording
        from cranedyn.recording.film import check_film

        recording.check_enabled()
        if options.film:
            check_film(options.film)
        if options.view:
            recording.check_display()
        if options.serve:
            recording.check_port(options.port)


def _targets(options: argparse.Namespace) -> tuple[Path, Path]:
    """Return the folder of the results and the file of the recording.

    Raises:
        DataError: If they cannot be written: the folder is a file, the folder of a recording that
            is named does not exist, or the recording has another ending than ``.rrd``.
    """
    folder = Path(getattr(options, "out", Path("out") / options.experiment))
    recording = Path(getattr(options, "save", folder / f"{options.experiment}.rrd"))
    if os.path.exists(folder) and not os.path.isdir(folder):
        raise DataError(f"Cannot write to {folder}: it is not a folder.")
    with_ending(recording, ".rrd")
    if hasattr(options, "save") and not os.path.isdir(recording.absolute().parent):
        raise DataError(f"Cannot save the recording as {recording}: its folder does not exist.")
    return folder, recording
