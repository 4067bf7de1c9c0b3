"""How every experiment runs from the command line, and the files it leaves."""

from __future__ import annotations

import argparse
import json
import platform
import sys
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from cranedyn.errors import CraneError, DataError, RunError
from cranedyn.files import written
from experiments.document import read_document
from experiments.outcome import MARKS, Claim, Outcome, Table, show
from experiments.watched import watched
from experiments.world import Watcher, World, add_files, add_world, analysing, recorded, watching, world_of

__all__ = [
    "Claim",
    "CraneError",
    "Outcome",
    "Table",
    "Watcher",
    "World",
    "add_files",
    "add_world",
    "analysing",
    "conduct",
    "make_folder",
    "parser",
    "recorded",
]

FAILED, REFUSED, INTERRUPTED = 1, 2, 130
"""Exit codes: a claim does not hold or a run failed; bad arguments; stopped by the user."""


def parser(name: str, description: str) -> argparse.ArgumentParser:
    """A parser with the arguments that every experiment has."""
    made = argparse.ArgumentParser(
        prog=f"python -m experiments.{name}", description=description, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    made.add_argument("--out", metavar="DIR", help=f"folder for results, default out/{name}", default=argparse.SUPPRESS)
    made.add_argument("--save", metavar="FILE.rrd", help="write the recording here instead of into the folder", default=argparse.SUPPRESS)
    made.add_argument(
        "--document", metavar="FILE.md", help="put the tables between their marks in this document, too", default=argparse.SUPPRESS
    )
    made.add_argument("--view", action="store_true", help="open the recording in the Rerun viewer")
    made.add_argument("--serve", action="store_true", help="serve the recording to a browser on this machine until Ctrl-C")
    made.add_argument("--port", type=int, default=9090, metavar="P", help="where --serve has its page; the data is at the next port")
    made.set_defaults(experiment=name, live=False)
    return made


Experiment = Callable[[argparse.Namespace, World], Outcome]


def conduct(made: argparse.ArgumentParser, experiment: Experiment, argv: Sequence[str] | None = None) -> int:
    """Run an experiment from the command line: print its tables and claims, write its files.

    Returns:
        0 if every claim that could be judged holds, 1 if one does not or a run failed, 2 for bad arguments, 130 if interrupted.
    """
    options = made.parse_args(argv)
    options.about, options.words = made.description, sys.argv[1:] if argv is None else argv
    try:
        folder, recording = options.folder, options.recording = _targets(options)
        _check_viewer(options)
        document = read_document(options.document, options.experiment) if hasattr(options, "document") else None
        with watching() as watcher:
            outcome = watched(experiment(options, world_of(options, watcher)))
        _write(outcome, options, folder, recording)
        if document is not None:
            document.write(outcome.tables)
        show(outcome)
        print(f"Written to {folder}.")
        if outcome.recording:
            _look(options, recording)
    except RunError as error:
        return _broken_off(error, options)
    except CraneError as error:
        print(f"error: {error}", file=sys.stderr)
        return REFUSED
    except KeyboardInterrupt:
        print("Interrupted.", file=sys.stderr)
        return INTERRUPTED
    return FAILED if any(claim.holds is not None and not claim.holds for claim in outcome.claims) else 0


def _targets(options: argparse.Namespace) -> tuple[Path, Path]:
    given = getattr(options, "out", None)
    folder = Path(given if given is not None else Path("out") / options.experiment)
    if folder.exists() and not folder.is_dir():
        raise DataError(f"Cannot write to {folder}: it is not a folder.")
    if given is not None and not folder.absolute().parent.is_dir():
        raise DataError(f"Cannot make the folder {folder}: its parent {folder.absolute().parent} does not exist.")
    recording = Path(getattr(options, "save", folder / f"{options.experiment}.rrd"))
    if recording.suffix != ".rrd":
        raise DataError(f"Cannot save the recording as {recording}: the ending must be .rrd.")
    if hasattr(options, "save") and not recording.absolute().parent.is_dir():
        raise DataError(f"Cannot save the recording as {recording}: its folder does not exist.")
    return folder, recording


def _check_viewer(options: argparse.Namespace) -> None:
    """Say before a run, not after it, that it cannot be shown."""
    if options.view or options.serve:
        from cranedyn import recording

        if options.view:
            recording.check_display()
        if options.serve:
            recording.check_port(options.port)


def make_folder(folder: Path) -> Path:
    """The folder, made if it is not there.

    Raises:
        DataError: If it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"Cannot make the folder {folder}: {error.strerror}.") from error
    return folder


def _write(outcome: Outcome, options: argparse.Namespace, folder: Path, recording: Path) -> None:
    from cranedyn.figures import save

    make_folder(folder)
    for name, trajectory in outcome.trajectories.items():
        for ending in (".csv", ".parquet"):
            trajectory.write(folder / f"{name}{ending}")
    for name, figure in outcome.figures.items():
        save(figure, folder / f"{name}.png")
    with written(folder / "result.json") as file:
        file.write_text(
            json.dumps(_result(outcome, options), indent=1, ensure_ascii=False, allow_nan=False, default=lambda number: number.item()),
            encoding="utf-8",
        )
    if outcome.recording:
        _record(outcome, options, recording)


def _record(outcome: Outcome, options: argparse.Namespace, path: Path) -> None:
    from cranedyn import recording

    text = [
        options.about,
        *(f"**{MARKS[claim.holds]}**: {claim.sentence}" for claim in outcome.claims),
        *(table.markdown() for table in outcome.tables),
    ]
    recording.record(path, outcome.recording, title=f"Experiment {options.experiment}", text="\n\n".join(text))


def _look(options: argparse.Namespace, path: Path) -> None:
    """Show the recording as asked for; the demo has shown it already."""
    if options.live or not (options.view or options.serve):
        return
    from cranedyn import recording

    if options.view:
        recording.open_viewer(path)
    if options.serve:
        with recording.serve(path, port=options.port) as served:
            print(f"Serving at {served.address} until Ctrl-C.")
            served.wait()


def _result(outcome: Outcome, options: argparse.Namespace) -> dict[str, Any]:
    packages = ("cranedyn", "pin", "numpy", "scipy", "rerun-sdk")
    return {
        "experiment": options.experiment,
        "about": options.about,
        "command": " ".join(["python -m", f"experiments.{options.experiment}", *options.words]),
        "claims": [{"sentence": claim.sentence, "holds": claim.holds} for claim in outcome.claims],
        "parameters": dict(outcome.parameters),
        "figures": [f"{name}.png" for name in outcome.figures],
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
        "versions": {"python": platform.python_version(), **{name: _version(name) for name in packages}},
        "machine": f"{platform.system()} {platform.machine()}",
    }


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _broken_off(error: RunError, options: argparse.Namespace) -> int:
    print(f"error: {error}", file=sys.stderr)
    if error.trajectory is not None and len(error.trajectory) > 0:
        folder = make_folder(_targets(options)[0])
        print(f"What was recorded up to then is in {error.trajectory.write(folder / 'broken_off.parquet')}.", file=sys.stderr)
    return INTERRUPTED if isinstance(error.__context__, KeyboardInterrupt) else FAILED
