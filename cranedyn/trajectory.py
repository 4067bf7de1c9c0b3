"""What happened: the record of a run, with named columns that carry their units."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from cranedyn.crane import State
from cranedyn.errors import DataError
from cranedyn.files import written

COLUMNS = {
    "t": ("t_s",),
    "q": ("gamma_rad", "x_m", "phi_rad", "theta_rad", "l_m"),
    "v": ("gamma_dot_rad_s", "x_dot_m_s", "phi_dot_rad_s", "theta_dot_rad_s", "l_dot_m_s"),
    "wanted": ("gamma_wanted_rad", "x_wanted_m", "l_wanted_m"),
    "command": ("T_gamma_command_Nm", "F_x_command_N", "F_l_command_N"),
    "effort": ("T_gamma_Nm", "F_x_N", "F_l_N"),
    "energy": ("energy_J",),
    "work": ("W_gamma_J", "W_x_J", "W_l_J"),
    "dissipated": ("dissipated_J",),
}
"""Column names behind each array of a trajectory."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One row per control instant, n rows.

    Attributes:
        t: Time [s], shape (n,).
        q: Coordinates gamma, x, phi, theta, l [rad or m], shape (n, 5).
        v: Their rates, shape (n, 5).
        wanted: Where the reference wants slew, trolley and hoist [rad, m, m], shape (n, 3).
        command: Efforts that the controller asked for, from this instant to the next [N m, N, N], shape (n, 3).
            Where the drives follow prescribed motion they are the efforts that this motion costs.
        effort: Efforts that acted: the command within the limits of the drives, shape (n, 3).
        energy: Mechanical energy of the whole crane [J], zero of height at the ground, shape (n,).
        work: Work done by each drive since the start [J], shape (n, 3).
        dissipated: Energy taken by joint damping since the start [J], shape (n,).
        parameters: What the run was made with, by name.
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    wanted: np.ndarray
    command: np.ndarray
    effort: np.ndarray
    energy: np.ndarray
    work: np.ndarray
    dissipated: np.ndarray
    parameters: Mapping[str, float | str] = field(default_factory=dict)

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.t)

    def __getitem__(self, column: str) -> np.ndarray:
        """A column by its name, shape (n,).

        Raises:
            KeyError: If there is no such column.
        """
        for name, columns in COLUMNS.items():
            if column in columns:
                values = getattr(self, name)
                return values if len(columns) == 1 else values[:, columns.index(column)]
        raise KeyError(column)

    def state(self, row: int) -> State:
        """The state at a row; -1 is the last."""
        return State(self.q[row], self.v[row])

    def since(self, t: float) -> Trajectory:
        """The rows from a time on [s]."""
        late = self.t >= t
        return replace(self, **{name: getattr(self, name)[late] for name in COLUMNS})

    @property
    def unexplained(self) -> np.ndarray:
        """What the energy ledger leaves open since the start [J], shape (n,): energy gained less work done plus energy dissipated."""
        return self.energy - self.energy[0] - self.work.sum(axis=1) + self.dissipated

    def table(self) -> pa.Table:
        """All columns as an Arrow table, the parameters in its metadata."""
        names = [column for columns in COLUMNS.values() for column in columns]
        return pa.table(
            {name: np.ascontiguousarray(self[name]) for name in names}, metadata={"cranedyn": json.dumps(dict(self.parameters))}
        )

    def write(self, path: str | Path) -> Path:
        """Write to a ``.csv`` or ``.parquet`` file; both hold every number to the bit, Parquet the parameters too.

        Raises:
            DataError: If the ending is another or the file cannot be written.
        """
        path = Path(path)
        writer = {".csv": pyarrow.csv.write_csv, ".parquet": pyarrow.parquet.write_table}.get(path.suffix)
        if writer is None:
            raise DataError(f"Cannot write {path}: the ending must be .csv or .parquet.")
        with written(path) as file:
            writer(self.table(), str(file))
        return path


def read(path: str | Path) -> Trajectory:
    """Read a whole trajectory back from what `Trajectory.write` wrote.

    Raises:
        DataError: If the file cannot be read, a column is missing, or a value is not a finite number.
    """
    table = _read_table(path)
    arrays = {name: _columns(table, columns, path) for name, columns in COLUMNS.items()}
    parameters = json.loads((table.schema.metadata or {}).get(b"cranedyn", b"{}"))
    return Trajectory(
        **{name: np.stack(list(a.values()), axis=1) if len(a) > 1 else next(iter(a.values())) for name, a in arrays.items()},
        parameters=parameters,
    )


def read_columns(path: str | Path, columns: Sequence[str]) -> dict[str, np.ndarray]:
    """Read some columns of a ``.csv`` or ``.parquet`` file, ours or recorded elsewhere.

    Raises:
        DataError: If the file cannot be read, a column is missing, a value is not a finite number, or time does not increase.
    """
    found = _columns(_read_table(path), columns, path)
    if "t_s" in found and not (len(found["t_s"]) > 1 and (np.diff(found["t_s"]) > 0).all()):
        raise DataError(f"{path}: t_s must increase from row to row, over two rows at least.")
    return found


def _read_table(path: str | Path) -> pa.Table:
    path = Path(path)
    try:
        return pyarrow.parquet.read_table(path) if path.suffix == ".parquet" else pyarrow.csv.read_csv(path)
    except (OSError, pa.ArrowException) as error:
        raise DataError(f"Cannot read {path}: {str(error).splitlines()[0].rstrip('.')}.") from error


def _columns(table: pa.Table, columns: Sequence[str], path: str | Path) -> dict[str, np.ndarray]:
    missing = [name for name in columns if name not in table.column_names]
    if missing:
        raise DataError(f"{path} has no column {', '.join(missing)}; needed are {', '.join(columns)}.")
    found = {}
    for name in columns:
        try:
            values = table[name].cast(pa.float64()).to_numpy()
        except pa.ArrowException:
            raise DataError(f"{path}: column {name} holds something that is not a number.") from None
        if not np.isfinite(values).all():
            raise DataError(
                f"{path}: column {name} holds a value that is not finite, in data row {int(np.argmin(np.isfinite(values))) + 1}."
            )
        found[name] = values
    return found
