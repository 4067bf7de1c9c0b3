"""Public records of real cranes: where they are, what their owners wrote, and how they are read.

None of these repositories has a licence, so that no row of them is part of this project. The
readers take a clone that the user has made.
"""

from __future__ import annotations

import io
import subprocess
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.io.matlab import MatReadError

from cranedyn.errors import CraneError, DataError

Columns = dict[str, np.ndarray]


@dataclass(frozen=True)
class PublicRecords:
    """Public repository with records of one crane.

    Attributes:
        name: Name of the crane.
        repository: Owner and name on GitHub.
        commit: Commit that was read.
        values: Numbers of the crane that its owner wrote, as arguments of the overhead crane.
        names: Parameters to be estimated.
        read: Function that yields name and columns of each record of a clone.
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
_FULL = 1023.0
"""Command of a motor's full voltage, in steps of its pulses."""

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
            columns["x_command"] /= _FULL
            yield f"{drive} {pwm}, {i}", columns


def read_workbook(path: Path) -> Iterator[Columns]:
    """Yield the records of a workbook, a sheet each; the first sheet has a row of headings.

    Raises:
        CraneError: If python-calamine is not installed.
        DataError: If a column is missing, a cell is no number, or a number cannot be.
    """
    try:
        from python_calamine import CalamineError, CalamineWorkbook
    except ImportError as error:
        raise CraneError(
            "To read a workbook install the extra measured: pip install 'cranedyn[measured]'."
        ) from error
    try:
        workbook = CalamineWorkbook.from_path(path)
        sheets = [
            (name, workbook.get_sheet_by_name(name).to_python()) for name in workbook.sheet_names
        ]
    except (CalamineError, OSError) as error:
        raise DataError(f"{path} cannot be read as a workbook: {error}.") from error
    headings = [str(cell).strip() for cell in sheets[0][1][0]] if sheets and sheets[0][1] else []
    for name in _GANTRY_COLUMNS:
        if name not in headings:
            raise DataError(f"{path.name}, sheet {sheets[0][0]}, row 1 has no column {name!r}.")
    for name, cells in sheets:
        body = [(i, row) for i, row in enumerate(cells, start=1) if any(c != "" for c in row)]
        if body and [str(cell).strip() for cell in body[0][1]] == headings:
            body = body[1:]
        columns = {
            ours: np.array([_cell(row, headings.index(theirs), path, name, i) for i, row in body])
            for theirs, ours in _GANTRY_COLUMNS.items()
        }
        _check(columns, [i for i, _ in body], f"{path.name}, sheet {name}")
        yield columns


def _cell(row: Sequence[object], index: int, path: Path, sheet: str, number: int) -> float:
    value = row[index] if index < len(row) else ""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise DataError(f"{path.name}, sheet {sheet}, row {number}: {value!r} is no number.")
    return float(value)


def _check(columns: Columns, rows: list[int], context: str) -> None:
    """Check that times increase and that numbers are possible."""
    t = columns["t_s"]
    if len(t) < 2:
        raise DataError(f"{context} has {len(t)} rows of numbers; allowed are two or more.")
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


_AAU_LENGTH, _THIN = 0.65, 10


def _free_swing(
    commit: str, path: str, since: float
) -> Callable[[Path], Iterator[tuple[str, Columns]]]:
    """Return a reader of a record in the history of a clone, from where its trolley stands [s]."""

    def read(clone: Path) -> Iterator[tuple[str, Columns]]:
        command = ["git", "-C", str(clone), "show", f"{commit}:{path}"]
        try:
            content = subprocess.run(command, capture_output=True, check=True).stdout
        except (OSError, subprocess.CalledProcessError) as error:
            raise DataError(
                f"{clone} has no {path} in commit {commit}; is it that clone, with its history?"
            ) from error
        name = Path(path).stem
        columns = read_mat(content, name)
        kept = columns["t_s"] >= since
        yield f"{name}, free swing", {key: values[kept][::_THIN] for key, values in columns.items()}

    return read


def read_mat(content: bytes, name: str) -> Columns:
    """Return times and swing of a ``.mat`` file with the arrays t and y.

    Raises:
        DataError: If it is another file, or lacks one of them.
    """
    try:
        arrays = loadmat(io.BytesIO(content), variable_names=("t", "y"))
        t, y = (np.asarray(arrays[key], dtype=float).ravel() for key in ("t", "y"))
    except (MatReadError, ValueError, TypeError, KeyError, NotImplementedError, OSError) as error:
        raise DataError(
            f"{name}.mat cannot be read ({error}); allowed are files of MATLAB 5 to 7.2 with t, y."
        ) from error
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
