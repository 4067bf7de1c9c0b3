"""Data that an experiment reads instead of simulating.

These are tables of other programs, recordings of ROS, and results of a sweep.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from cranedyn.command import Parser
from cranedyn.data.external import ExternalTable, load_external, parse_sources
from cranedyn.data.logs import open_log
from cranedyn.errors import CraneError, DataError
from cranedyn.interop import bags
from cranedyn.model.options import parse_pairs
from cranedyn.sweep import results
from experiments.harness.arguments import add_condition, add_mode
from experiments.harness.table import ResultTable

Analysis = TypeVar("Analysis")

MAX_VALUE = 1e6
"""Largest magnitude of any other recorded number, in the unit of its column."""

MAX_ANGULAR_RATE = 10.0
"""Largest magnitude of a recorded angular rate [rad/s]."""

MIN_CABLE_LENGTH = 1e-3
"""Shortest recorded cable [m]. A pendulum of no length has no period."""

MAX_GAP = 0.5
"""Longest time from one row of a recorded file to the next [s]."""


def add_files(parser: Parser, columns: Sequence[str], *uses: str) -> None:
    """Add the argument for recorded files.

    Args:
        parser: The parser.
        columns: Names of the columns that the analysis needs.
        uses: Destinations of further arguments that have an effect on the analysis.
    """
    add_mode(parser, "files", *uses, "columns", "joints")
    text = (
        f"analyse files with columns {', '.join(columns)} instead of simulating: CSV, Parquet, "
        ".mat, .xlsx, or .mcap, .db3, .bag and folders of ROS 2 with joint states"
    )
    parser.add_argument("--from", dest="files", nargs="+", metavar="FILE", help=text)
    add_sources(parser, "--from and {} file")


def add_sources(parser: Parser, place: str) -> None:
    """Add the arguments for the names of columns and joints in recorded files.

    Args:
        parser: The parser. Its argument `files` has the recorded files.
        place: What these arguments need, as the error message names it, with braces for the kind of
            file, for example "{} FILE".
    """
    text = (
        "what columns of tables are called, or #3 for the third, and their units where they are "
        "others than ours, as phi_rad=Angle[deg] t_s=time[ms]"
    )
    parser.common.add_argument(
        "--columns", nargs="+", action="extend", default=[], metavar="OURS=NAME[UNIT]", help=text
    )
    text = (
        "names of joints in recordings of ROS, where they are not those of this crane; for another "
        "zero or sign a formula as describe prints it, such as 'l=8 m - lift_joint'"
    )
    parser.common.add_argument("--joints", nargs="+", default=[], metavar="l=NAME", help=text)

    def has_file(options: argparse.Namespace, *, ros: bool) -> bool:
        """Return whether a file is a recording of ROS, or whether one is a table."""
        return any(bags.is_recording(file) is ros for file in options.files or ())

    bag = place.format("an .mcap or .bag")
    table = place.format("a .csv or .parquet")
    add_condition(parser, bag, lambda options: has_file(options, ros=True), "joints")
    add_condition(parser, table, lambda options: has_file(options, ros=False), "columns")


@dataclass(frozen=True)
class FileAnalyses(Generic[Analysis]):
    """Analyses of recorded files.

    Attributes:
        results: Name of each file, with its analysis.
        remarks: Sentences about how files were read, such as which of several columns was taken.
    """

    results: list[tuple[str, Analysis]]
    remarks: tuple[str, ...]

    def noted(self, table: ResultTable) -> ResultTable:
        """Return a table whose note ends with the remarks."""
        return replace(table, note=" ".join([table.note, *self.remarks]).strip())


def analyse_files(
    options: argparse.Namespace,
    columns: Sequence[str],
    analyse: Callable[[str, dict[str, np.ndarray]], Analysis],
) -> FileAnalyses[Analysis]:
    """Read and analyse the files of ``--from``.

    Args:
        options: The arguments of the command line.
        columns: Names of the columns that are needed, as this project calls them.
        analyse: Function that takes the name of a file and its columns, shape (rows,) each.

    Raises:
        DataError: If a file cannot be read or analysed; the message begins with its name.
    """
    results: list[tuple[str, Analysis]] = []
    remarks: list[str] = []
    for file in options.files:
        table = _read(file, columns, options)
        remarks += [f"{Path(file).name}: {remark}." for remark in table.remarks]
        try:
            results.append((file, analyse(file, dict(table.columns))))
        except DataError as error:
            raise DataError(f"{file}: {error}") from error
    return FileAnalyses(results, tuple(remarks))


def _read(file: str, columns: Sequence[str], options: argparse.Namespace) -> ExternalTable:
    """Return columns of a recorded file, among them the time `t_s` and the cable length `l_m`.

    Raises:
        DataError: As `load_external`; also if a cable is shorter than `MIN_CABLE_LENGTH`, an angle
            changes faster than `MAX_ANGULAR_RATE`, another number is larger than `MAX_VALUE`, or
            rows are more than `MAX_GAP` apart.
    """
    if bags.is_recording(file):
        joints = parse_pairs("joints", options.joints)
        table = ExternalTable(bags.read_joint_states(file, columns, joints), ())
    else:
        table = load_external(open_log(file), columns, parse_sources(options.columns))
    data = table.columns
    for name, values in data.items():
        high = MAX_ANGULAR_RATE if name.endswith("_rad_s") else MAX_VALUE
        low = MIN_CABLE_LENGTH if name == "l_m" else -high
        for extreme in (values.min(), values.max()):
            # NaN fails this comparison, too.
            if not low <= extreme <= high:
                raise DataError(
                    f"{file}: {name} is {extreme:g} in some row; allowed is {low:g} to {high:g}."
                )
    gap = np.diff(data["t_s"]).max()
    if gap > MAX_GAP:
        raise DataError(
            f"{file}: t_s leaves a gap of {gap:g} s; allowed are {MAX_GAP:g} s from row to row."
        )
    return table


def swept_columns(folder: Path) -> dict[str, np.ndarray]:
    """Return the columns of a finished sweep by name, shape (cases,) each.

    Raises:
        CraneError: If every case of it failed.
    """
    table = results(folder)
    errors = table["error"]
    # The column holds the error of each case that failed, and null for the others.
    if errors.null_count == 0:
        raise CraneError(f"Each of {len(errors):,} cases is bad; the first: {errors[0].as_py()}")
    return {name: table[name].to_numpy() for name in table.column_names}
