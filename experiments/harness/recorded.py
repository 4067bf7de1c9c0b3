"""Data that an experiment reads instead of simulating: CSV, Parquet, ROS, results of a sweep."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from cranedyn.bridges import bags
from cranedyn.command import Parser
from cranedyn.data.external import parse_sources, read_external
from cranedyn.errors import CraneError, DataError
from cranedyn.model.options import parse_pairs
from cranedyn.sweep import results
from experiments.harness.arguments import add_condition, add_mode

Analysis = TypeVar("Analysis")

_LARGEST, _FASTEST, _LONGEST_GAP = 1e6, 10.0, 0.5
"""Largest number in any unit, fastest angle [rad/s], longest time from row to row [s]."""


def add_files(parser: Parser, columns: Sequence[str], *uses: str) -> None:
    """Add the argument for recorded files.

    Args:
        parser: The parser.
        columns: Columns that the analysis needs.
        uses: Destinations of further arguments that have an effect on the analysis.
    """
    add_mode(parser, "files", *uses, "columns", "joints")
    text = (
        f"analyse files with columns {', '.join(columns)} instead of simulating: CSV, Parquet, "
        "or .mcap and .bag with joint states"
    )
    parser.add_argument("--from", dest="files", nargs="+", metavar="FILE", help=text)
    add_sources(parser, "--from and {} file")


def add_sources(parser: Parser, place: str) -> None:
    """Add the arguments for the names of columns and joints in recorded files.

    Args:
        parser: The parser, whose argument `files` has the files.
        place: What these arguments need, with braces for the ending of a file: "{} FILE".
    """
    text = (
        "what columns of CSV and Parquet files are called, and their units where they are "
        "others than ours, as phi_rad=Angle[deg] t_s=time[ms]"
    )
    parser.common.add_argument(
        "--columns", nargs="+", action="extend", default=[], metavar="OURS=NAME[UNIT]", help=text
    )
    text = "names of joints in .mcap and .bag files, where they are not those of this crane"
    parser.common.add_argument("--joints", nargs="+", default=[], metavar="l=NAME", help=text)

    def has_file(options: argparse.Namespace, *, ros: bool) -> bool:
        return any((Path(file).suffix in bags.ENDINGS) is ros for file in options.files or ())

    bag, table = place.format("an .mcap or .bag"), place.format("a .csv or .parquet")
    add_condition(parser, bag, lambda options: has_file(options, ros=True), "joints")
    add_condition(parser, table, lambda options: has_file(options, ros=False), "columns")


def analyse_files(
    options: argparse.Namespace,
    columns: Sequence[str],
    analyse: Callable[[str, dict[str, np.ndarray]], Analysis],
) -> list[tuple[str, Analysis]]:
    """Return the names of the files of ``--from``, each with the analysis of its columns.

    Args:
        options: The arguments of the command line.
        columns: Our names of the columns.
        analyse: Function of the name of a file and its columns, shape (n,) each.

    Raises:
        DataError: If a file cannot be read or analysed; the message begins with its name.
    """
    analyses = []
    for file in options.files:
        data = _read(file, columns, options)
        try:
            analyses.append((file, analyse(file, data)))
        except DataError as error:
            raise DataError(f"{file}: {error}") from error
    return analyses


def _read(file: str, columns: Sequence[str], options: argparse.Namespace) -> dict[str, np.ndarray]:
    """Return columns of a recorded file, time `t_s` and the cable length `l_m` among them.

    Raises:
        DataError: As `read_external`; if a cable is shorter than a millimetre, an angle changes by
            more than 10 rad/s, any other number is beyond a million of its unit, or rows are more
            than half a second apart.
    """
    if Path(file).suffix in bags.ENDINGS:
        data = bags.read_joint_states(file, columns, parse_pairs("joints", options.joints))
    else:
        data = read_external(file, columns, parse_sources(options.columns))
    for name, values in data.items():
        high = _FASTEST if name.endswith("_rad_s") else _LARGEST
        low = 1e-3 if name == "l_m" else -high
        for extreme in (values.min(), values.max()):
            if not low <= extreme <= high:
                raise DataError(
                    f"{file}: {name} is {extreme:g} in some row; allowed is {low:g} to {high:g}."
                )
    if (gap := np.diff(data["t_s"]).max()) > _LONGEST_GAP:
        raise DataError(
            f"{file}: t_s leaves a gap of {gap:g} s; allowed are {_LONGEST_GAP:g} s from row to "
            "row."
        )
    return data


def swept_columns(folder: Path) -> dict[str, np.ndarray]:
    """Return the columns of a finished sweep by name, shape (cases,) each.

    Raises:
        CraneError: If no case of it went well.
    """
    table = results(folder)
    errors = table["error"]
    if errors.null_count == 0:
        raise CraneError(f"Each of {len(errors):,} cases is bad; the first: {errors[0].as_py()}")
    return {name: table[name].to_numpy() for name in table.column_names}
