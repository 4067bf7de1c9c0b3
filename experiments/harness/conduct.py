"""How every experiment runs from the command line, and the files it leaves."""

from __future__ import annotations

import argparse
import json
import math
import platform
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

from cranedyn.command import FAILED, INTERRUPTED, command, interrupted
from cranedyn.data.files import (
    atomic_write_set,
    check_writable,
    digest,
    lock_folder,
    make_folder,
    write_text,
)
from cranedyn.errors import CraneError, DataError, RunError
from experiments.harness.arguments import called, parsed
from experiments.harness.document import read_document
from experiments.harness.events import with_events
from experiments.harness.outcome import MARKS, Outcome, show
from experiments.harness.setup import Setup, reporting, setup_of

FIGURES = (".png", ".svg")
"""Endings under which a figure is kept: for a glance, and for pages and papers."""

Experiment = Callable[[argparse.Namespace, Setup], Outcome]


def conduct(
    made: argparse.ArgumentParser, experiment: Experiment, argv: Sequence[str] | None = None
) -> int:
    """Run an experiment from the command line: print its tables and claims, write its files.

    A claim that could not be judged under the arguments given is no pass: it is printed as "not
    judged", and the last line of the claims counts those that hold, out of how many, and those not
    judged.

    Returns:
        0 if no claim fails, 1 if one does or a run failed, 2 for bad arguments, 130 if interrupted.
    """
    return command(lambda: _conducted(made, experiment, argv))


def _conducted(
    made: argparse.ArgumentParser, experiment: Experiment, argv: Sequence[str] | None
) -> int:
    options = parsed(made, argv)
    options.about, options.words = made.description, sys.argv[1:] if argv is None else argv
    with lock_folder(options.folder):
        for file in (options.folder / "result.json", options.recording):
            check_writable(file)
        try:
            outcome = _ran(experiment, options)
        except RunError as error:
            return _broken_off(error, options.folder)
    show(outcome)
    print(f"Written to {options.folder}.")
    if outcome.recording:
        _look(options)
    return (
        FAILED
        if any(claim.holds is not None and not claim.holds for claim in outcome.claims)
        else 0
    )


def _ran(experiment: Experiment, options: argparse.Namespace) -> Outcome:
    """The outcome of an experiment, its files written."""
    document = (
        read_document(options.document, options.experiment)
        if hasattr(options, "document")
        else None
    )
    with reporting() as reporter:
        outcome = with_events(experiment(options, setup_of(options, reporter)))
    # Errors of the step are claimed of the rule that is usual.
    if getattr(options, "integrator", "euler") != "euler":
        outcome = replace(outcome, claims=[replace(claim, holds=None) for claim in outcome.claims])
    if document is not None:
        document.filled(outcome.tables)  # what it asks for is there, or nothing is written
    _write(outcome, options)
    if document is not None:
        document.write(outcome.tables)
    return outcome


def _write(outcome: Outcome, options: argparse.Namespace) -> None:
    """Write the files of a run as one set; the last, ``result.json``, names the others that are
    beside it, each with its digest.
    """
    from cranedyn.data.tables import write_table
    from cranedyn.plotting.figures import save

    result, folder = _result(outcome, options), options.folder
    _json(result)
    with atomic_write_set() as drafts:
        for name, trajectory in outcome.trajectories.items():
            table = trajectory.table()
            for ending in (".csv", ".parquet"):
                write_table(folder / f"{name}{ending}", table)
        for name, figure in outcome.figures.items():
            save(figure, *(folder / f"{name}{ending}" for ending in FIGURES))
        for name, text in outcome.texts.items():
            write_text(folder / name, text)
        if outcome.recording:
            _record(outcome, options)
        result["files"] = {
            draft.final.name: digest(draft.path) for draft in drafts if draft.final.parent == folder
        }
        write_text(folder / "result.json", _json(result))


def _json(result: dict[str, Any]) -> str:
    """The result as text, refused before anything is written if there is a number in it that is
    none.
    """
    try:
        return json.dumps(
            result,
            indent=1,
            ensure_ascii=False,
            allow_nan=False,
            default=lambda number: number.item(),
        )
    except ValueError:
        bad = [
            f"{column} in row {i + 1} of the table {table['title']!r}"
            for table in result["tables"]
            for i, row in enumerate(table["rows"])
            for column, value in zip(table["columns"], row, strict=True)
            if not isinstance(value, str | None) and not math.isfinite(value)
        ]
        raise DataError(
            "These arguments give a result that is not finite: "
            f"{', '.join(bad) or 'one of its parameters'}."
        ) from None


def _record(outcome: Outcome, options: argparse.Namespace) -> None:
    from cranedyn import recording

    text = [
        options.about,
        *(f"**{MARKS[claim.holds]}**: {claim.sentence}" for claim in outcome.claims),
        *(table.markdown() for table in outcome.tables),
    ]
    recording.record(
        options.recording,
        outcome.recording,
        title=f"Experiment {options.experiment}",
        text="\n\n".join(text),
    )


def _look(options: argparse.Namespace) -> None:
    """Show the recording as asked for; the demo has shown it already."""
    if options.live or not (options.view or options.serve):
        return
    from cranedyn import recording

    if options.view:
        recording.open_viewer(options.recording)
    if options.serve:
        with (
            recording.serve(options.recording, port=options.port) as served,
            suppress(KeyboardInterrupt),
        ):
            print(served.words)
            served.wait()


def _result(outcome: Outcome, options: argparse.Namespace) -> dict[str, Any]:
    packages = ("cranedyn", "pin", "numpy", "scipy", "rerun-sdk")
    return {
        "experiment": options.experiment,
        "about": options.about,
        "command": " ".join([called(options.experiment), *options.words]),
        "claims": [{"sentence": claim.sentence, "holds": claim.holds} for claim in outcome.claims],
        "parameters": dict(outcome.parameters),
        "runs": {name: dict(run.record) for name, run in outcome.trajectories.items()},
        "figures": [f"{name}.png" for name in outcome.figures],
        "files": {},
        "tables": [
            {
                "title": table.title,
                "columns": [h for h, _ in table.columns],
                "formats": [f for _, f in table.columns],
                "rows": list(table.rows),
                "note": table.note,
            }
            for table in outcome.tables
        ],
        "versions": {
            "python": platform.python_version(),
            **{name: _version(name) for name in packages},
        },
        "machine": f"{platform.system()} {platform.machine()}",
    }


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _broken_off(error: RunError, folder: Path) -> int:
    print(f"error: {error}", file=sys.stderr)
    if error.trajectory is not None and len(error.trajectory) > 0:
        try:
            kept = error.trajectory.write(make_folder(folder) / "broken_off.parquet")
            print(f"What was recorded up to then is in {kept}.", file=sys.stderr)
        except CraneError as lost:
            print(f"What was recorded up to then is lost: {lost}", file=sys.stderr)
    return INTERRUPTED if interrupted(error) else FAILED
