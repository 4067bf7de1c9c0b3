"""How every experiment runs from the command line, and the files it writes."""

from __future__ import annotations

import argparse
import json
import math
import platform
import shlex
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

from cranedyn.command import (
    FAILED,
    INTERRUPTED,
    command,
    command_line,
    defer_sigint,
    interrupted,
    next_lines,
    open_line,
)
from cranedyn.data.files import (
    atomic_write_set,
    check_writable,
    digest,
    lock_folder,
    make_folder,
    parse_json,
    read_text,
    write_text,
)
from cranedyn.errors import CraneError, DataError, RunError
from cranedyn.progress import bar
from cranedyn.verdict import Verdict, overall
from experiments.catalogue import EXPERIMENTS
from experiments.harness.arguments import command_name, parse_arguments
from experiments.harness.document import Document, read_document
from experiments.harness.events import with_events
from experiments.harness.outcome import Claim, Outcome, show
from experiments.harness.progress import reporting
from experiments.harness.setup import Setup, setup_of

FIGURES = (".png", ".svg")
"""Endings under which each figure is stored: one for a glance, one for pages and papers."""

Experiment = Callable[[argparse.Namespace, Setup], Outcome]
"""What an experiment does, from the arguments of its command line and its setup."""


def run_experiment(
    parser: argparse.ArgumentParser, experiment: Experiment, argv: Sequence[str] | None = None
) -> int:
    """Run an experiment from the command line: print its tables and claims, and write its files.

    Among the parameters in ``result.json`` are those of its setup.

    A claim that cannot be judged under the arguments given does not count as a pass: it is printed
    as "not judged". The last line counts the claims that hold, all claims, and those not judged.

    Args:
        parser: Parser of the command line, see `harness.parser`.
        experiment: Function that computes the outcome.
        argv: Arguments of the command line; those of the process if None.

    Returns:
        0 if no claim fails, 1 if one does or a run failed, 2 for bad arguments, 130 if interrupted.
    """
    return command(lambda: _run(parser, experiment, argv))


def _run(
    parser: argparse.ArgumentParser, experiment: Experiment, argv: Sequence[str] | None
) -> int:
    options = parse_arguments(parser, argv)
    options.about = parser.description
    options.argv = sys.argv[1:] if argv is None else argv
    # Two runs that write into one folder would mix their files.
    with lock_folder(options.folder):
        # Before the run, which may take minutes.
        for file in (options.folder / "result.json", options.recording):
            check_writable(file)
        try:
            outcome = _outcome(experiment, options)
        except RunError as error:
            return _store_partial_run(error, options.folder)
    left_out = show(outcome, whole=options.all)
    print(_pointers(outcome, options, left_out))
    # A live demo has been shown while it ran.
    if outcome.recording and not options.live:
        _view(options)
    return FAILED if overall(outcome.claims) is Verdict.FAILS else 0


def _outcome(experiment: Experiment, options: argparse.Namespace) -> Outcome:
    """Return the outcome of an experiment, and write its files."""
    # Read before the run, so that a document without blocks for the tables is refused at once.
    file = getattr(options, "document", None)
    document = None if file is None else read_document(file, options.experiment)
    with reporting() as reporter:
        setup = setup_of(options, reporter)
        outcome = with_events(experiment(options, setup))
    # Experiments without `add_setup` have no gravity; recorded files have a world of their own.
    if hasattr(options, "gravity") and not getattr(options, "files", None):
        parameters = {**setup.parameters(), **outcome.parameters}
        outcome = replace(outcome, parameters=parameters)
    # Claims hold within the errors of the default stepping rule; under another they say nothing.
    if setup.integrator != "euler":
        unjudged = [Claim(claim.sentence, None) for claim in outcome.claims]
        outcome = replace(outcome, claims=unjudged)
    _write(outcome, options, document)
    return outcome


def _write(outcome: Outcome, options: argparse.Namespace, document: Document | None) -> None:
    """Write the files of a run and its document as one set: all of them or none.

    ``result.json`` lists the files in the folder with their digests, and is written last. Files of
    the run before it that this run does not replace are removed.
    """
    from cranedyn.data.tables import write_table
    from cranedyn.plotting.figures import save

    result = _result(outcome, options)
    folder = options.folder
    earlier = _removable_files(folder)
    with atomic_write_set() as drafts:
        if document is not None:
            document.write(outcome.tables)
        with bar("files", len(outcome.trajectories) + len(outcome.figures)) as show_written:
            written = 0
            for name, trajectory in outcome.trajectories.items():
                write_table(folder / f"{name}.parquet", trajectory.table())
                written += 1
                show_written(written)
            for name, figure in outcome.figures.items():
                save(figure, *(folder / f"{name}{ending}" for ending in FIGURES))
                written += 1
                show_written(written)
        for name, text in outcome.texts.items():
            write_text(folder / name, text)
        if outcome.recording:
            _record(outcome, options)
        result["files"] = {
            draft.final.name: digest(draft.path) for draft in drafts if draft.final.parent == folder
        }
        write_text(folder / "result.json", _json(result))
    # Only now: a run that is cut off while it writes leaves the earlier one whole.
    for name in earlier - {draft.final.name for draft in drafts}:
        (folder / name).unlink(missing_ok=True)


def _removable_files(folder: Path) -> set[str]:
    """Return the names of the files of the earlier run in a folder that a new run may remove.

    These are the files that the earlier ``result.json`` lists and that are still as that run wrote
    them. Files whose names a user chose, such as a film, are kept, and so are all files if the
    result does not say which these are, or cannot be read.
    """
    names = set[str]()
    # Whatever is wrong with the earlier result: the new one takes its place.
    with suppress(DataError, OSError, LookupError, TypeError, ValueError, RecursionError):
        result = parse_json(read_text(folder / "result.json"))
        for name in set(result["files"]) - set(result["named_by_user"]):
            # A result is read from a file: it may name no file outside of its folder.
            is_in_folder = Path(name).name == name and (folder / name).is_file()
            if is_in_folder and digest(folder / name) == result["files"][name]:
                names.add(name)
    return names


def _named_by_user(options: argparse.Namespace) -> list[str]:
    """Return the names of the files in the folder of the results that the command line chose."""
    chosen = [options.film, getattr(options, "document", None), getattr(options, "save", None)]
    files = [Path(name) for name in chosen if name is not None]
    return [file.name for file in files if file.parent == options.folder]


def _json(result: dict[str, Any]) -> str:
    """Return the result as text.

    Raises:
        DataError: If a number in it is not finite.
    """
    try:
        # Scalars of NumPy are written as the numbers that they hold.
        return json.dumps(
            result, indent=1, ensure_ascii=False, allow_nan=False, default=lambda n: n.item()
        )
    except ValueError:
        cells = _cells_not_finite(result)
        raise DataError(
            "These arguments give a result that is not finite: "
            f"{', '.join(cells) or 'one of its parameters'}."
        ) from None


def _cells_not_finite(result: dict[str, Any]) -> list[str]:
    """Return column, row and table of each number in the tables that is NaN or infinite."""
    found = []
    for table in result["tables"]:
        for i, row in enumerate(table["rows"]):
            for column, value in zip(table["columns"], row, strict=True):
                is_number = not isinstance(value, str | None)
                if is_number and not math.isfinite(value):
                    found.append(f"{column} in row {i + 1} of the table {table['title']!r}")
    return found


def _record(outcome: Outcome, options: argparse.Namespace) -> None:
    """Write the recording, with claims and tables as a text in it, and the film if one is asked
    for.
    """
    from cranedyn.recording import record
    from cranedyn.recording.film import film

    claims = [f"**{claim.verdict.word}**: {claim.sentence}" for claim in outcome.claims]
    tables = [table.markdown() for table in outcome.tables]
    text = "\n\n".join([options.about, *claims, *tables])
    title = f"Experiment {options.experiment}"
    with bar("recording"):
        record(
            options.recording,
            outcome.recording,
            title=title,
            text=text,
            gaps=outcome.gaps,
            contacts=outcome.contacts,
        )
    if options.film:
        first = min(run.trajectory.t[0] for run in outcome.recording)
        last = max(run.trajectory.t[-1] for run in outcome.recording)
        with reporting() as reporter:
            show_time = reporter.run("film", float(last - first))
            film(options.film, outcome.recording, progress=show_time)


def _pointers(outcome: Outcome, options: argparse.Namespace, left_out: str) -> str:
    """Return the lines below the claims: where the files are, and two commands to go on with.

    Args:
        outcome: The outcome.
        options: The arguments of the command line.
        left_out: What the screen left out, see `show`.
    """
    written = f"Written to {options.folder}"
    if outcome.figures:
        first_figure = next(iter(outcome.figures))
        written += f"; picture: {options.folder / first_figure}.png"
    if hasattr(options, "port") and not (outcome.recording or options.live):
        written += "; no run to record"
    run_name = command_name(options.experiment)
    folder = shlex.quote(str(options.folder))
    pages = [options.folder / name for name in outcome.texts if name.endswith(".html")]
    commands = [open_line(page) for page in pages[:1]]
    commands += [line.format(folder=folder) for line in outcome.next_commands]
    if outcome.recording:
        commands.append(command_line("cranedyn", "view", options.recording))
    if left_out:
        # What the screen has no room for is never further than one command away.
        again = f"{run_name} {command_line(*options.argv, '--all')}"
        commands = [*commands[:1], f"{again}  # {left_out} more"]
    if options.experiment in EXPERIMENTS and options.folder.name == options.experiment:
        of_report = ("--only", options.experiment, "--out", options.folder.parent)
        commands.append(command_line("cranedyn", "report", *of_report))
    commands += [f"{run_name} --help", "cranedyn list"]
    return f"{written}.\n{next_lines(*commands[:2])}"


def _view(options: argparse.Namespace) -> None:
    """Open the recording in the viewer, and serve it to browsers until Ctrl-C, where asked to."""
    from cranedyn import recording

    if options.view:
        recording.open_viewer(options.recording)
    if options.serve:
        with (
            recording.serve(options.recording, port=options.port) as server,
            suppress(KeyboardInterrupt),
        ):
            print(server.message)
            server.wait()


def _result(outcome: Outcome, options: argparse.Namespace) -> dict[str, Any]:
    """Return what ``result.json`` holds, but for the digests of the files."""
    versions: dict[str, str | None] = {"python": platform.python_version()}
    for package in ("cranedyn", "pin", "numpy", "scipy", "rerun-sdk"):
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[package] = None
    return {
        "experiment": options.experiment,
        "about": options.about,
        "command": " ".join([command_name(options.experiment), *options.argv]),
        "claims": [claim.stored() for claim in outcome.claims],
        "parameters": dict(outcome.parameters),
        "runs": {name: dict(run.record) for name, run in outcome.trajectories.items()},
        "figures": [f"{name}.png" for name in outcome.figures],
        "files": {},
        "named_by_user": _named_by_user(options),
        "tables": [table.stored() for table in outcome.tables],
        "versions": versions,
        "machine": f"{platform.system()} {platform.machine()}",
    }


def _store_partial_run(error: RunError, folder: Path) -> int:
    """Write what a run that broke off had recorded, and return the exit code."""
    # Until the file is there, a second Ctrl-C waits.
    with defer_sigint():
        print(f"error: {error}", file=sys.stderr)
        if error.trajectory is not None and len(error.trajectory) > 0:
            try:
                file = error.trajectory.write(make_folder(folder) / "broken_off.parquet")
                print(f"What was recorded up to then is in {file}.", file=sys.stderr)
            except CraneError as write_error:
                print(f"What was recorded up to then is lost: {write_error}", file=sys.stderr)
    return INTERRUPTED if interrupted(error) else FAILED
