"""All experiments on one page: claims, tables beside the published numbers, figures, and how to
make each again.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from typing import Any, get_args

from cranedyn.checks import whole
from cranedyn.command import INTERRUPTED, Parser, command, command_line, next_lines, open_line
from cranedyn.data.files import (
    check_writable,
    digest,
    lock_folder,
    parse_json,
    read_bytes,
    read_text,
    write_text,
)
from cranedyn.errors import DataError, UnknownName
from cranedyn.interfaces import EngineName
from cranedyn.plotting.html import IMAGE_TYPES, PageTable, image_address, render
from cranedyn.progress import bar
from cranedyn.verdict import Check, Verdict, overall
from experiments import harness
from experiments.catalogue import EXPERIMENTS, Entry, expected_duration
from experiments.harness.document import naming_result

BY_PINOCCHIO = ("a1", "a2", "a3", "energy", "gazebo", "mass_ratio", "validate")
"""Experiments that test Pinocchio's algorithms, and therefore run by them."""

ONLY_PINOCCHIO = ("tandem",)
"""Experiments whose steps nothing but Pinocchio computes, whatever `--engine` says."""

LONGEST = (
    "lift",
    "compare",
    "lift_benchmark",
    "sweep",
    "lift_report",
    "observer",
    "margins",
    "cranes",
)
"""Experiments that take longest, the longest first."""

NEW_FINDINGS = (
    "At the cranes' slew rates",
    "Flat feed-forward with LQR leaves no swing",
    "the move of least time settles before any other",
    "Where the drives alone are seen",
    "the least delay for the full-model LQR",
    "tower: Nothing that hangs",
    "trolley: a joystick that brakes",
    "Setpoints alone do not tell",
)
"""Phrases of the claims that say what was not known before."""

FIRST_PICTURES = (
    "a1-budget",
    "a3-slewing",
    "energy-ledger",
    "linear_vs_full-slews",
    "compare-robustness",
    "margins-margins_map",
    "sweep-sweep_map",
    "lift-site_tower",
    "factors-needed",
    "identify-twin_1",
)
"""Figures of the first screen: name of the experiment and of the figure."""

COMMAND = (sys.executable, "-m", "cranedyn", "run")
"""What runs an experiment."""

_MAX_FIGURE_SIZE = 50_000_000
"""Largest size of a figure that is read [byte]."""


def page(folders: Sequence[Path]) -> str:
    """Return the report as one HTML document that needs nothing else.

    Args:
        folders: Folders of results, each with a ``result.json`` and figures.

    Raises:
        DataError: If a result cannot be read.
    """
    entries = []
    for folder in folders:
        with naming_result(folder / "result.json"):
            entries.append(_page_entry(folder, read_result(folder)))
    claims: list[PageClaim] = []
    for entry in entries:
        claims += entry.claims
    return render(
        Path(__file__).with_suffix(".html"),
        experiments=entries,
        verdict=overall(Check(claim.sentence, claim.verdict) for claim in claims),
        claims=len(claims),
        holding=sum(claim.verdict is Verdict.HOLDS for claim in claims),
        unknown=sum(claim.verdict is Verdict.NOT_JUDGED for claim in claims),
        machines=", ".join(sorted({entry.machine for entry in entries})),
        failing=[claim for claim in claims if claim.verdict is Verdict.FAILS],
        found=[claim for claim in claims if _is_new(claim)],
        pictures=_first_pictures(entries),
    )


def _is_new(claim: PageClaim) -> bool:
    """Return whether a claim says what was not known before."""
    return any(phrase in claim.sentence for phrase in NEW_FINDINGS)


@dataclass(frozen=True)
class PageClaim:
    """A claim on the page.

    Attributes:
        name: Name of its experiment.
        title: Title of its experiment.
        sentence: The claim.
        verdict: Whether it holds.
    """

    name: str
    title: str
    sentence: str
    verdict: Verdict


@dataclass(frozen=True)
class ReportFigure:
    """A figure of an experiment on the page.

    Attributes:
        id: Name of experiment and figure, to which links lead.
        stem: Name of its file without the ending.
        title: Title of its experiment.
        caption: What it shows.
        address: Data URL of the image.
    """

    id: str
    stem: str
    title: str
    caption: str
    address: str


@dataclass(frozen=True)
class PageEntry:
    """An experiment on the page.

    Attributes:
        name: Name of the experiment.
        title: Its title.
        line: What it is about, in a line.
        about: What it is about, in a paragraph.
        command: Command line that makes it again.
        claims: Its claims.
        figures: Its figures.
        tables: Its tables.
        parameters: Its parameters as JSON.
        versions: Packages and their versions.
        machine: The machine on which it ran.
    """

    name: str
    title: str
    line: str
    about: str
    command: str
    claims: list[PageClaim]
    figures: list[ReportFigure]
    tables: list[PageTable]
    parameters: str
    versions: str
    machine: str

    @property
    def verdict(self) -> Verdict:
        """The verdict of all its claims together."""
        return overall(Check(claim.sentence, claim.verdict) for claim in self.claims)

    @property
    def holding(self) -> int:
        """Number of its claims that hold."""
        return sum(claim.verdict is Verdict.HOLDS for claim in self.claims)


def _first_pictures(entries: Sequence[PageEntry]) -> list[ReportFigure]:
    """Return the figures of the first screen, as far as they were made."""
    figures = {}
    for entry in entries:
        for figure in entry.figures:
            figures[figure.id] = figure
    return [figures[name] for name in FIRST_PICTURES if name in figures]


def _catalogue_entry(result: Mapping[str, Any]) -> Entry:
    """Return the entry of an experiment in the catalogue, or one made of its result."""
    name = str(result["experiment"])
    return EXPERIMENTS.get(name) or Entry(name, str(result["about"]))


def read_result(folder: Path) -> dict[str, Any]:
    """Read the result in a folder.

    Raises:
        DataError: If there is none, or a file of it is of another run.
    """
    file = folder / "result.json"
    with naming_result(file):
        result = parse_json(read_text(file))
        _check_files(folder, result["files"])
        texts = [result[name] for name in ("experiment", "about", "command", "machine")]
        texts += [claim["sentence"] for claim in result["claims"]]
        if not all(isinstance(text, str) for text in texts):
            raise TypeError("a word is not text")
        if not all(claim["holds"] in (True, False, None) for claim in result["claims"]):
            raise TypeError("a claim is none")
    return dict(result)


def _is_made(folder: Path) -> bool:
    """Return whether a folder has a result with every file that it lists.

    A result that cannot be read counts as made: reading it for the page then says what is wrong
    with it, instead of a run that replaces it.
    """
    file = folder / "result.json"
    if not os.path.isfile(file):
        return False
    try:
        names = [*parse_json(read_text(file))["files"]]
        return all(os.path.isfile(folder / name) for name in names)
    except (DataError, LookupError, TypeError, ValueError, RecursionError):
        return True


def _check_files(folder: Path, digests: Mapping[str, str]) -> None:
    """Check that each file of a result is the one that its run wrote.

    Args:
        folder: Folder of the result.
        digests: Digest of each file, by its name.

    Raises:
        ValueError: If a name is not that of a file in the folder.
        DataError: If a file is of another run.
    """
    for name, expected in digests.items():
        if Path(name).name != name or not os.path.isfile(folder / name):
            raise ValueError(f"{name!r} is no file in its folder")
        if digest(folder / name) != expected:
            raise DataError(
                f"Cannot read {folder}: {name} there is of another run than its result.json; run "
                "it --again."
            )


def _page_entry(folder: Path, result: Mapping[str, Any]) -> PageEntry:
    """Return the result in a folder as an entry of the page."""
    entry = _catalogue_entry(result)
    name = str(result["experiment"])
    claims = []
    for claim in result["claims"]:
        verdict = Verdict.of(claim["holds"])
        claims.append(PageClaim(name, entry.title, claim["sentence"], verdict))
    versions = [
        f"{package} {version}" for package, version in result["versions"].items() if version
    ]
    about = result["about"]
    return PageEntry(
        name=name,
        title=entry.title,
        line=entry.line,
        about=about[:1].upper() + about[1:],
        command=result["command"],
        claims=claims,
        figures=_figures(folder, result, entry),
        tables=[_table(table) for table in result["tables"]],
        parameters=json.dumps(result["parameters"], indent=1, ensure_ascii=False),
        versions=", ".join(versions),
        machine=result["machine"],
    )


def _figures(folder: Path, result: Mapping[str, Any], entry: Entry) -> list[ReportFigure]:
    """Return the figures of a result, drawings where there are some."""
    strange = set(result["figures"]) - set(result["files"])
    if strange:
        raise ValueError(f"its figures {sorted(strange)} are not among its files")
    figures = []
    for file in result["figures"]:
        stem = Path(file).stem
        drawing = f"{stem}.svg"
        address = figure_address(folder, drawing if drawing in result["files"] else file)
        name = f"{result['experiment']}-{stem}"
        figures.append(ReportFigure(name, stem, entry.title, entry.caption(stem), address))
    return figures


def _table(entry: dict[str, Any]) -> PageTable:
    """Return a table of a ``result.json`` as one of the page."""
    table = harness.ResultTable.of(entry)
    columns = [(header, not form) for header, form in table.columns]
    return PageTable(table.title, columns, table.shown(), table.note)


def figure_address(folder: Path, name: str) -> str:
    """Return a figure of a folder of results as a data URL."""
    if Path(name).name != name or Path(name).suffix not in IMAGE_TYPES:
        raise ValueError(f"{name!r} is no figure in its folder")
    content = read_bytes(folder / name, _MAX_FIGURE_SIZE)
    return image_address(content, Path(name).suffix)


def report_parser() -> Parser:
    """Return the parser of the arguments of the report."""
    parser = Parser(
        prog="cranedyn report",
        description="All experiments on one page, report.html.",
        example="cranedyn report --quick --only a1 a3",
    )
    text = "folder of all results, one folder inside for each experiment (default out)"
    parser.add_argument("--out", metavar="DIR", default="out", help=text)
    text = "which experiments (default all)"
    parser.add_argument("--only", nargs="+", metavar="NAME", default=list(EXPERIMENTS), help=text)
    parser.add_argument(
        "--again", action="store_true", help="run experiments whose results are there already, too"
    )
    text = "run the least of what is missing, to see the page; claims need not hold"
    parser.add_argument("--quick", action="store_true", help=text)
    text = "how many experiments run side by side (default 2)"
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help=text)
    text = "what computes steps, default compiled code, for these Pinocchio: "
    text += ", ".join(BY_PINOCCHIO)
    parser.add_argument("--engine", choices=get_args(EngineName), help=text)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run what is missing, write the page; 0, or the largest exit code of an experiment."""
    parser = report_parser()
    return command(lambda: _main(parser.parse_args(argv)))


def _main(options: argparse.Namespace) -> int:
    """Run what is missing and write the page; return the exit code."""
    folder = Path(options.out)
    for name in options.only:
        if name not in EXPERIMENTS:
            raise UnknownName("experiment", name, EXPERIMENTS)
    whole("jobs", options.jobs, 1)
    missing = [name for name in options.only if options.again or not _is_made(folder / name)]
    # Checked before the runs, which take minutes.
    check_writable(folder / "report.html")
    for name in missing:
        check_writable(folder / name / "result.json")
    # The folder is there for the runs, and gone again if they leave nothing.
    with lock_folder(folder):
        codes = _run(missing, options)
        finished = [name for name in options.only if os.path.isfile(folder / name / "result.json")]
        for name in set(options.only) - set(finished):
            print(
                f"{EXPERIMENTS[name].title} ({name}) could not be made and is not on the page.",
                file=sys.stderr,
            )
        if finished:
            write_text(folder / "report.html", page([folder / name for name in finished]))
    if finished:
        file = folder / "report.html"
        print(f"Written to {file}.")
        again = command_line(
            "cranedyn", "report", "--only", finished[0], "--again", "--out", folder
        )
        print(next_lines(open_line(file), again))
    # The code of a process that was killed by a signal is negative.
    return max((abs(code) for code in codes), default=0)


def _run(names: Sequence[str], options: argparse.Namespace) -> list[int]:
    """Run experiments side by side, the longest first; return their exit codes."""
    started: list[subprocess.Popen[str]] = []
    finished: list[float] = []

    def run(number: int, name: str) -> int:
        print(f"Experiment {number} of {len(names)}: {name}", flush=True)
        process = subprocess.Popen(
            [*COMMAND, name, *experiment_arguments(name, options)],
            text=True,
            errors="replace",
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        started.append(process)
        lines = process.communicate()[0].splitlines()
        if process.returncode == 0:
            lines = [line for line in lines if " claims hold, " in line]
        for line in lines:
            print(f"{name}: {line}", flush=True)
        if process.returncode == INTERRUPTED:
            raise KeyboardInterrupt
        finished.append(expected_duration(name))
        show_finished(sum(finished))
        return process.returncode

    # The longest first; experiments that are not among them follow in their order.
    ordered = sorted(names, key=lambda name: (*LONGEST, name).index(name))
    total = sum(expected_duration(name) for name in names)
    with bar("report", total) as show_finished, ThreadPoolExecutor(options.jobs) as pool:
        try:
            return list(pool.map(run, count(1), ordered))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in started:
                process.terminate()
            raise


def experiment_arguments(name: str, options: argparse.Namespace) -> list[str]:
    """Return the arguments with which the report runs an experiment.

    Args:
        name: Name of the experiment.
        options: Arguments of the report itself, see `report_parser`.
    """
    entry = EXPERIMENTS[name]
    engine = options.engine
    if engine is None:
        cannot_compile = find_spec("llvmlite") is None
        engine = "pinocchio" if name in BY_PINOCCHIO or cannot_compile else "compiled"
    arguments = [*(entry.quick if options.quick else entry.arguments)]
    # Pinocchio is the default of most experiments, and no engine of the others.
    if engine == "compiled" and name not in ONLY_PINOCCHIO:
        arguments += ["--engine", "compiled"]
    return [*arguments, f"--out={Path(options.out) / name}"]


if __name__ == "__main__":
    sys.exit(main())
