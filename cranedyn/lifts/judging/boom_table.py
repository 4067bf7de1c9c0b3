"""Load charts of telescopic booms as makers print them: a CSV file with a row for each radius and a
column for each length of the boom.

    radius_m, 11.0, 18.0, 24.5
    3.0,     60000, 42000,
    5.0,     33000, 31000, 22000
    8.0,     16500, 17000, 15500
    10.0,         , 11800, 11500

The first line has the lengths of the boom [m] behind any word, the first column the radii [m]. An
empty cell means that no load is permitted.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

from cranedyn.checks import number
from cranedyn.data.files import read_text
from cranedyn.errors import CraneError, DataError, quoted

_MAX_CELLS = 100_000
"""Largest number of cells of a table."""


@dataclass(frozen=True)
class BoomColumn:
    """Loads of one length of the boom.

    Attributes:
        boom: Length of the boom [m].
        radii: Radii at which a load is permitted [m].
        loads: These loads, in the unit of the table.
    """

    boom: float
    radii: list[float]
    loads: list[float]


def read_boom_table(path: Path) -> list[BoomColumn]:
    """Read the table of a telescopic boom.

    Raises:
        DataError: If the file cannot be read, a cell is no number above 0, a row is longer or
            shorter than the first, a column has no load, or an empty cell stands between two loads.
    """
    try:
        lines = list(csv.reader(io.StringIO(read_text(path)), skipinitialspace=True))
    except csv.Error as error:
        raise DataError(f"{path} is no CSV file: {error}.") from error
    rows = [(i, row) for i, row in enumerate(lines, start=1) if any(cell.strip() for cell in row)]
    if len(rows) < 2 or len(rows[0][1]) < 2:
        raise DataError(
            f"{path} is no load chart: it needs a first line with the lengths of the boom, and a "
            "line for each radius."
        )
    if len(rows) * len(rows[0][1]) > _MAX_CELLS:
        raise DataError(f"{path} has more than {_MAX_CELLS} cells.")
    (head_line, head), *body = rows
    booms = [_cell(path, head_line, "length of the boom", text) for text in head[1:]]
    radii: list[float] = []
    loads: list[list[float | None]] = []
    for line, row in body:
        if len(row) != len(head):
            raise DataError(
                f"{path}, line {line}: it has {len(row)} cells, and the first line {len(head)}. "
                "Write an empty cell where no load is permitted, and decimal points."
            )
        radii.append(_cell(path, line, "radius", row[0]))
        loads.append(
            [_cell(path, line, "load", text) if text.strip() else None for text in row[1:]]
        )
    columns = []
    for i, boom in enumerate(booms):
        columns.append(_column(path, boom, radii, [of_radius[i] for of_radius in loads]))
    return columns


def _column(path: Path, boom: float, radii: list[float], loads: list[float | None]) -> BoomColumn:
    """Return the loads of one length of the boom [m] from those at all radii, None where no load is
    permitted.

    Raises:
        DataError: If there is no load, or one is missing between two others.
    """
    given = [i for i, load in enumerate(loads) if load is not None]
    if not given:
        raise DataError(f"{path}: the boom of {boom:g} m has no load; leave its column out.")
    for i in range(given[0], given[-1] + 1):
        if loads[i] is None:
            raise DataError(
                f"{path}: the boom of {boom:g} m has no load at {radii[i]:g} m, and has some at "
                "smaller and larger radii. A chart has one range of radii for each boom; leave out "
                "the loads on one side."
            )
    within = slice(given[0], given[-1] + 1)
    return BoomColumn(boom, radii[within], [load for load in loads if load is not None])


def _cell(path: Path, line: int, name: str, text: str) -> float:
    """Return the number of a cell.

    Raises:
        DataError: If it is none above 0, with its line.
    """
    try:
        return number(name, float(text), "", "> 0")
    except ValueError:
        reason = f"{name} is {quoted(text)}; allowed is a number above 0."
    except CraneError as error:
        reason = str(error)
    raise DataError(f"{path}, line {line}: {reason}")
