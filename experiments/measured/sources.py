"""Public records of real cranes: where they are, what their owners wrote, and how they are read.

None of these repositories has a licence, so that no row of them is part of this project. The
readers take a clone that the user has made.
"""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cranedyn.data.bounded import read_bounded
from cranedyn.data.workbooks import Sheet, read_sheets
from cranedyn.errors import DataError, quoted

Columns = dict[str, np.ndarray]
"""Columns of a record by name, shape (rows,) each."""


@dataclass(frozen=True)
class PublicRecords:
    """A public repository with records of one crane.

    Attributes:
        name: Name of the crane in tables.
        repository: Owner and name on GitHub.
        commit: Commit that is read.
        values: Numbers of the crane as its owner states them, as arguments of the overhead crane.
        names: Names of the parameters that are estimated.
        read: Function that takes the folder of a clone, and yields name and columns of each record.
    """

    name: str
    repository: str
    commit: str
    values: dict[str, float]
    names: tuple[str, ...]
    read: Callable[[Path], Iterator[tuple[str, Columns]]]

    @property
    def folder(self) -> str:
        """Folder of a clone, below the folder of all."""
        return self.repository.partition("/")[2]

    @property
    def command(self) -> str:
        """Command that makes the clone."""
        url = f"https://github.com/{self.repository}"
        return (
            f"git clone {url} DIR/{self.folder} && git -C DIR/{self.folder} checkout {self.commit}"
        )


_GANTRY_COLUMNS = {
    "timestamp": "t_s",
    "trolley_position": "x_m",
    "cable_length": "l_m",
    "sway_angle": "phi_rad",
    "pwm_trolley_motor": "x_command",
}
"""Our names of the columns of the gantry crane's workbooks, by theirs."""

_FULL_COMMAND = 1023.0
"""Command of the motor at full voltage, as its pulse-width modulation counts."""

_LARGEST = {"x_m": 100.0, "l_m": 100.0, "phi_rad": np.pi}
"""Largest number that each column of a laboratory crane can hold [m or rad]."""

_LIGHT = {
    "payload_inertia": 1e-4, "bridge_mass": 10.0, "dummy_mass": 1e-3, "dummy_inertia": 1e-6,
    "span": 3.0, "runway": 2.0, "height": 2.0, "damp_swing": 0.01, "hoist_min": 0.02,
    "hoist_max": 1.5, "trolley_init": 0.7, "bridge_init": 1.0,
}  # fmt: skip
"""Numbers of a laboratory crane that no record of these depends on, and a first damping."""


def _gantry(clone: Path) -> Iterator[tuple[str, Columns]]:
    """Yield the sheets of the workbooks, positions counted from the crane's own zero."""
    paths = sorted((clone / "data").glob("*_step_response_*_with_random.xlsx"))
    if not paths:
        raise DataError(f"{clone} has no data/*_step_response_*.xlsx; is it that clone?")
    for path in paths:
        drive, *_, pwm, _, _ = path.stem.split("_")
        for i, columns in enumerate(read_workbook(path), start=1):
            columns["x_m"] += _LIGHT["trolley_init"]
            columns["x_command"] /= _FULL_COMMAND
            yield f"{drive} {pwm}, {i}", columns


def read_workbook(path: Path) -> Iterator[Columns]:
    """Yield the records of a workbook, a sheet each; the first sheet has a row of headings.

    Raises:
        CraneError: If python-calamine is not installed.
        DataError: If the file cannot be read, a column is missing, a cell is no number, or a number
            cannot be.
    """
    sheets = read_sheets(path)
    if not sheets:
        raise DataError(f"{path.name} has no sheet; allowed is a workbook with one or more.")
    first = sheets[0]
    headings = [str(cell).strip() for cell in first.row(0)] if len(first.numbers) else []
    for name in _GANTRY_COLUMNS:
        if name not in headings:
            raise DataError(
                f"{path.name}, sheet {quoted(first.name)}, row 1 has no column {name!r}."
            )
    for sheet in sheets:
        rows = [i for i in range(len(sheet.numbers)) if any(cell != "" for cell in sheet.row(i))]
        if rows and [str(cell).strip() for cell in sheet.row(rows[0])] == headings:
            rows = rows[1:]
        columns: Columns = {}
        for theirs, ours in _GANTRY_COLUMNS.items():
            column = headings.index(theirs)
            columns[ours] = np.array([_cell(sheet, i, column, path) for i in rows])
        _check(columns, [i + 1 for i in rows], f"{path.name}, sheet {sheet.name}")
        yield columns


def _cell(sheet: Sheet, row: int, column: int, path: Path) -> float:
    """Return the number in a cell."""
    value = sheet.cell(row, column) if column < sheet.numbers.shape[1] else ""
    if isinstance(value, str):
        raise DataError(
            f"{path.name}, sheet {quoted(sheet.name)}, row {row + 1}: {value!r} is no number."
        )
    return value


def _check(columns: Columns, rows: list[int], context: str) -> None:
    """Check that times increase and that numbers are possible."""
    t = columns["t_s"]
    if len(t) < 2:
        raise DataError(f"{context} has {len(t)} rows of numbers; allowed are two or more.")
    finite = np.isfinite(t)
    if not finite.all():
        row = rows[int(np.argmin(finite))]
        raise DataError(f"{context}, row {row}: the time is {t[np.argmin(finite)]:g}.")
    steps = np.diff(t)
    if not (steps > 0.0).all():
        row = rows[int(np.argmin(steps)) + 1]
        raise DataError(f"{context}, row {row}: the time runs back or stands.")
    for name, largest in _LARGEST.items():
        if name in columns and not (np.abs(columns[name]) <= largest).all():
            worst = int(np.argmax(~(np.abs(columns[name]) <= largest)))
            raise DataError(
                f"{context}, row {rows[worst]}: {name} is {columns[name][worst]:g}; allowed is up "
                f"to {largest:.4g}."
            )


_AAU_LENGTH = 0.65
"""Length of the cable of the container crane [m]."""

_THIN = 10
"""Every how many rows of its records are kept."""

_GIT_TIME = 60.0
"""Longest time that git may take to find a file of a clone [s]."""


def _free_swing(
    commit: str, path: str, since: float
) -> Callable[[Path], Iterator[tuple[str, Columns]]]:
    """Return a reader of a record in the history of a clone, from where its trolley stands [s]."""

    def read(clone: Path) -> Iterator[tuple[str, Columns]]:
        content = committed_file(clone, commit, path)
        name = Path(path).stem
        columns = read_mat(content, name)
        kept = columns["t_s"] >= since
        yield f"{name}, free swing", {key: values[kept][::_THIN] for key, values in columns.items()}

    return read


def committed_file(clone: Path, commit: str, path: str) -> bytes:
    """Return a file of a commit of a clone.

    A clone is data, and its configuration may name programs: one that fetches a missing object,
    one that turns a file into text, one that shows a page. So git runs on an empty repository of
    ours, which borrows nothing but the objects of the clone, and may not use any network.

    Raises:
        DataError: If the clone has no such commit or file, or git is not there.
    """
    objects = clone.resolve() / ".git" / "objects"
    if not objects.is_dir():
        raise DataError(f"{clone} has no folder .git/objects; is it that clone?")
    # A path with a colon or a newline would be read as several.
    with tempfile.TemporaryDirectory(prefix="cranedyn-") as folder:
        repository = Path(folder)
        (repository / "objects" / "info").mkdir(parents=True)
        (repository / "refs").mkdir()
        (repository / "HEAD").write_text("ref: refs/heads/none\n")
        borrowed = repository / "borrowed"
        borrowed.symlink_to(objects, target_is_directory=True)
        environment = {
            "PATH": os.environ.get("PATH", os.defpath),
            "GIT_DIR": str(repository),
            "GIT_ALTERNATE_OBJECT_DIRECTORIES": str(borrowed),
            "GIT_CONFIG_NOSYSTEM": "1",
            "GIT_CONFIG_GLOBAL": os.devnull,
            "GIT_ALLOW_PROTOCOL": "none",
            "GIT_NO_LAZY_FETCH": "1",
            "GIT_TERMINAL_PROMPT": "0",
            "GIT_NO_REPLACE_OBJECTS": "1",
        }
        try:
            return subprocess.run(
                ["git", "cat-file", "blob", f"{commit}:{path}"],
                capture_output=True,
                check=True,
                env=environment,
                cwd=folder,
                timeout=_GIT_TIME,
            ).stdout
        except (OSError, subprocess.SubprocessError) as error:
            raise DataError(
                f"{clone} has no {path} in commit {commit}; is it that clone, with its history?"
            ) from error


def read_mat(content: bytes, name: str) -> Columns:
    """Return times and swing of a ``.mat`` file with the arrays t and y.

    Raises:
        DataError: If it is another file, or lacks one of them.
    """
    result = read_bounded(f"{name}.mat", "mat", content)
    names = result.header["names"]
    ends = np.cumsum(result.header["lengths"])
    arrays: dict[str, np.ndarray] = {}
    for variable in ("t", "y"):
        if names.count(variable) != 1:
            present = quoted(", ".join(names[:20])) if names else "none"
            raise DataError(
                f"{name}.mat has no vector {variable}, but {present}; needed are t and y."
            )
        index = names.index(variable)
        numbers = result.content.view("<f8")
        arrays[variable] = numbers[ends[index] - result.header["lengths"][index] : ends[index]]
    t = arrays["t"]
    y = arrays["y"]
    if len(t) != len(y):
        raise DataError(f"{name}.mat has {len(t)} times and {len(y)} angles.")
    columns = {"t_s": t, "phi_rad": y, "l_m": np.full(len(t), _AAU_LENGTH)}
    _check(columns, list(range(1, len(t) + 1)), f"{name}.mat")
    return columns


SOURCES = (
    PublicRecords(
        "gantry",
        "Cristian-Napitupulu/gantry_crane_model_optimizer",
        "dc22e97",
        {**_LIGHT, "trolley_mass": 2.0, "payload_mass": 1.128, "hoist_init": 0.38},
        ("l_offset", "damp_swing", "window", "phi_bias"),
        _gantry,
    ),
    *(
        PublicRecords(
            f"container crane, {path.rpartition('/')[2]}",
            "borlum/aaucrane",
            commit,
            {**_LIGHT, "trolley_mass": 0.3, "payload_mass": 3.786, "hoist_init": _AAU_LENGTH},
            ("l_offset", "damp_swing", "phi_bias"),
            _free_swing(commit, path, since),
        )
        for commit, path, since in (
            ("e48d9cb", "matlab/model/ang/measang.mat", 24.0),
            ("cdbc2e4", "matlab/model/crane/meascrane.mat", 6.0),
        )
    ),
)
"""The records that are known; the two of the container crane tell no cable length of their own."""
