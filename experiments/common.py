"""What every experiment shares: arguments, tables, claims, and the files it leaves."""

from __future__ import annotations

import argparse
import json
import platform
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table as RichTable

from cranedyn.crane import STANDARD_GRAVITY, Crane, State, load_crane
from cranedyn.description import parse_values
from cranedyn.errors import CraneError, DataError, RunError
from cranedyn.files import written
from cranedyn.references import Reference
from cranedyn.simulate import Controller, Drive, simulate
from cranedyn.trajectory import Trajectory, read_columns

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cranedyn.recording import Run

FAILED, REFUSED, INTERRUPTED = 1, 2, 130
"""Exit codes: a claim does not hold or a run failed; bad arguments; stopped by the user."""


_MARKS = {True: "holds", False: "FAILS", None: "not judged"}


@dataclass(frozen=True)
class Table:
    """A table as printed and as kept.

    Attributes:
        title: What it shows.
        columns: Header and format of each column, for example ``("T [s]", ".3f")``; an empty format is for text.
        rows: The values; None is shown as a dash.
        note: What to know about it.
    """

    title: str
    columns: Sequence[tuple[str, str]]
    rows: Sequence[Sequence[float | str | None]]
    note: str = ""

    def shown(self) -> list[list[str]]:
        """The rows as text."""
        return [
            ["-" if value is None else format(value, form) for value, (_, form) in zip(row, self.columns, strict=True)] for row in self.rows
        ]

    def markdown(self) -> str:
        """The table in Markdown."""
        head = [[header for header, _ in self.columns], ["---:" if form else "---" for _, form in self.columns]]
        lines = "\n".join(f"| {' | '.join(row)} |" for row in [*head, *self.shown()])
        return "\n\n".join(part for part in (f"**{self.title}**", lines, self.note) if part)


@dataclass(frozen=True)
class Claim:
    """A sentence that holds or does not, or could not be judged (None) under the arguments given."""

    sentence: str
    holds: bool | None


@dataclass(frozen=True)
class Outcome:
    """What an experiment leaves behind.

    Attributes:
        tables: In the order to print.
        claims: What it set out to show.
        parameters: What it was made with.
        trajectories: Runs to keep, by file name without ending.
        figures: Figures to keep, by file name without ending.
        recording: Runs to record for the viewer.
    """

    tables: Sequence[Table]
    claims: Sequence[Claim]
    parameters: Mapping[str, object] = field(default_factory=dict)
    trajectories: Mapping[str, Trajectory] = field(default_factory=dict)
    figures: Mapping[str, Figure] = field(default_factory=dict)
    recording: Sequence[Run] = ()


def parser(name: str, description: str) -> argparse.ArgumentParser:
    """A parser with the arguments that every experiment has."""
    made = argparse.ArgumentParser(
        prog=f"python -m experiments.{name}", description=description, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    made.add_argument("--out", metavar="DIR", help=f"folder for results, default out/{name}", default=argparse.SUPPRESS)
    made.add_argument("--save", metavar="FILE.rrd", help="write the recording here instead of into the folder", default=argparse.SUPPRESS)
    made.add_argument("--view", action="store_true", help="open the recording in the Rerun viewer")
    made.add_argument("--serve", action="store_true", help="serve the recording to a browser on this machine until Ctrl-C")
    made.add_argument("--port", type=int, default=9090, metavar="P", help="where --serve has its page; the data is at the next port")
    made.set_defaults(experiment=name, live=False)
    return made


def add_world(made: argparse.ArgumentParser) -> None:
    """Add the arguments of the world: gravity, the two clocks, and the numbers of the crane."""
    made.add_argument(
        "--gravity", type=float, default=STANDARD_GRAVITY, metavar="G", help="gravity of the world [m/s²]; the article's was 9.8"
    )
    made.add_argument("--dt", type=float, default=5e-4, help="physics step [s]")
    made.add_argument("--control-period", type=float, default=5e-3, metavar="T", help="time between control instants [s], a multiple of dt")
    made.add_argument(
        "--set",
        dest="values",
        nargs="+",
        default=[],
        metavar="name:=value",
        help="numbers of the crane, see python -m cranedyn.description --list",
    )


@dataclass(frozen=True)
class Watcher:
    """Shows how far a run is, on a terminal only."""

    progress: Progress | None

    def run(self, name: str, duration: float) -> Callable[[float], None] | None:
        """A callback for `simulate`, or None where nobody watches."""
        progress = self.progress
        if progress is None:
            return None
        task = progress.add_task(name, total=duration, speed="")

        def update(t: float) -> None:
            elapsed = progress.tasks[task].elapsed or 0.0
            progress.update(task, completed=t, speed=f"{t:6.1f} s, {t / elapsed:.0f}x real time" if elapsed > 0.1 else "")

        return lambda t: update(t) if round(t * 200) % 100 == 0 or t >= duration else None


@dataclass(frozen=True)
class World:
    """Where an experiment takes place.

    Attributes:
        gravity: Gravity [m/s²].
        values: Numbers of the crane that differ from its defaults, by name.
        dt: Physics step [s].
        control_period: Time between control instants [s].
        watcher: Shows progress.
    """

    gravity: float = STANDARD_GRAVITY
    values: Mapping[str, object] = field(default_factory=dict)
    dt: float = 5e-4
    control_period: float = 5e-3
    watcher: Watcher = field(default_factory=lambda: Watcher(None))

    @cached_property
    def crane(self) -> Crane:
        """The crane of this world."""
        return self.variant()

    def variant(self, **values: object) -> Crane:
        """The crane of this world with some more numbers changed."""
        return load_crane(gravity=self.gravity, **{**self.values, **values})  # type: ignore[arg-type]

    def simulate(
        self,
        crane: Crane,
        controller: Controller,
        reference: Reference | None,
        *,
        start: State,
        duration: float,
        label: str,
        since: float = 0.0,
        drive: Drive = "effort",
    ) -> Trajectory:
        """Run a crane on the clocks of this world, with progress under a label."""
        return simulate(
            crane,
            controller,
            reference,
            start=start,
            since=since,
            duration=duration,
            drive=drive,
            dt=self.dt,
            control_period=self.control_period,
            progress=self.watcher.run(label, duration),
        )

    def judged(self, holds: bool) -> bool | None:
        """Whether a claim about published numbers holds; None unless gravity is the article's 9.8 m/s² and all else is the default."""
        return bool(holds) if self == replace(World(9.8), watcher=self.watcher) else None

    def parameters(self) -> dict[str, object]:
        """What this world is made of, with units in the names."""
        return {"gravity_m_s2": self.gravity, "dt_s": self.dt, "control_period_s": self.control_period, **self.values}


def _world(options: argparse.Namespace, watcher: Watcher) -> World:
    if not hasattr(options, "gravity"):
        return World(watcher=watcher)
    return World(options.gravity, parse_values(options.values), options.dt, options.control_period, watcher)


def recorded(file: str, columns: Sequence[str]) -> dict[str, np.ndarray]:
    """Columns of a file recorded elsewhere, the cable length `l_m` among them.

    Raises:
        DataError: As `read_columns`, and if a cable length is not positive.
    """
    data = read_columns(file, columns)
    if not data["l_m"].min() > 0.0:
        raise DataError(f"{file}: l_m is {data['l_m'].min():g} m in some row; allowed is > 0.")
    return data


@contextmanager
def analysing(file: str) -> Iterator[None]:
    """Name the file in what is wrong with its content."""
    try:
        yield
    except DataError as error:
        raise DataError(f"{file}: {error}") from error


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
        with _watcher() as watcher:
            outcome = experiment(options, _world(options, watcher))
        _print(outcome)
        _write(outcome, options, folder, recording)
    except RunError as error:
        return _broken_off(error, options)
    except CraneError as error:
        print(f"error: {error}", file=sys.stderr)
        return REFUSED
    except KeyboardInterrupt:
        print("Interrupted.", file=sys.stderr)
        return INTERRUPTED
    return FAILED if any(claim.holds is not None and not claim.holds for claim in outcome.claims) else 0


@contextmanager
def _watcher() -> Iterator[Watcher]:
    console = Console(stderr=True)
    if not console.is_terminal:
        yield Watcher(None)
        return
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[speed]}"),
        TimeElapsedColumn(),
        console=console,
        transient=True,
    ) as progress:
        yield Watcher(progress)


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


def _print(outcome: Outcome) -> None:
    console = Console(width=None if sys.stdout.isatty() else 150, highlight=False)
    for table in outcome.tables:
        shown = RichTable(title=table.title, title_justify="left", caption=table.note or None, caption_justify="left")
        for header, form in table.columns:
            shown.add_column(header, justify="right" if form else "left")
        for row in table.shown():
            shown.add_row(*row)
        console.print(shown)
        console.print()
    for claim in outcome.claims:
        console.print(f"{_MARKS[claim.holds]:11}{claim.sentence}", markup=False)


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
    print(f"Written to {folder}.")


def _record(outcome: Outcome, options: argparse.Namespace, path: Path) -> None:
    from cranedyn import recording

    text = [
        options.about,
        *(f"**{_MARKS[claim.holds]}**: {claim.sentence}" for claim in outcome.claims),
        *(table.markdown() for table in outcome.tables),
    ]
    recording.record(path, outcome.recording, title=f"Experiment {options.experiment}", text="\n\n".join(text))
    if options.view and not options.live:
        recording.open_viewer(path)
    if options.serve and not options.live:
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
