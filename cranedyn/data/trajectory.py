"""What happened: the record of a run, with named columns that carry their units."""

from __future__ import annotations

import itertools
import json
import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cranedyn.arguments import checked, described
from cranedyn.data.files import parse_json, written
from cranedyn.data.shown import Shown
from cranedyn.errors import DataError, OutOfRange, UnknownColumn
from cranedyn.interfaces import State

if TYPE_CHECKING:
    import pyarrow

COLUMNS = {
    "t": ("t_s",),
    "q": ("gamma_rad", "x_m", "phi_rad", "theta_rad", "l_m"),
    "v": ("gamma_dot_rad_s", "x_dot_m_s", "phi_dot_rad_s", "theta_dot_rad_s", "l_dot_m_s"),
    "setpoint": ("gamma_setpoint_rad", "x_setpoint_m", "l_setpoint_m"),
    "command": ("T_gamma_command_Nm", "F_x_command_N", "F_l_command_N"),
    "effort": ("T_gamma_Nm", "F_x_N", "F_l_N"),
    "energy": ("energy_J",),
    "work": ("W_gamma_J", "W_x_J", "W_l_J"),
    "dissipated": ("dissipated_J",),
    "force": (
        "payload_force_x_N",
        "payload_force_y_N",
        "payload_force_z_N",
        "trolley_force_x_N",
        "trolley_force_y_N",
        "trolley_force_z_N",
    ),
    "outside": ("W_force_J", "W_buffers_J"),
    "valid": ("valid",),
}
"""Column names behind each array of a trajectory."""


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(Shown):
    """One row per control instant, n rows.

    Attributes:
        t: Time [s], shape (n,).
        q: Coordinates gamma, x, phi, theta, l [rad or m], shape (n, 5).
        v: Their rates, shape (n, 5).
        setpoint: Setpoint of slew, trolley and hoist [rad, m, m], shape (n, 3).
        command: Efforts that the controller asked for, from this instant to the next [N m, N, N], shape (n, 3).
            Where the drives follow prescribed motion they are the efforts that this motion costs.
        effort: Efforts that acted: the command within the limits of the drives, shape (n, 3).
        energy: Mechanical energy of the whole crane [J], zero of height at the ground, shape (n,).
        work: Work done by each drive since the start [J], shape (n, 3).
        dissipated: Energy taken by joint damping since the start [J], shape (n,).
        force: Outside forces in the world from this instant to the next, on the payload and on the trolley [N], shape (n, 6).
        outside: Work done on the crane since the start by these forces, and by buffers at the ends of the ranges [J], shape (n, 2).
        valid: 1 where the model holds, 0 where not, see `cranedyn.dynamics.validity`; shape (n,).
        parameters: What the run was made with, by name.
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    setpoint: np.ndarray
    command: np.ndarray
    effort: np.ndarray
    energy: np.ndarray
    work: np.ndarray
    dissipated: np.ndarray
    force: np.ndarray
    outside: np.ndarray
    valid: np.ndarray
    parameters: Mapping[str, float | str] = field(default_factory=dict)

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.t)

    def __getitem__(self, column: str) -> np.ndarray:
        """A column by its name, shape (n,).

        Raises:
            UnknownColumn: If there is no such column, which is also a KeyError.
        """
        for name, columns in COLUMNS.items():
            if column in columns:
                values = getattr(self, name)
                return values if len(columns) == 1 else values[:, columns.index(column)]
        raise UnknownColumn("column", column, self.keys())

    def state(self, row: int) -> State:
        """The state at a row; -1 is the last.

        Raises:
            OutOfRange: If there is no such row.
        """
        try:
            q, v = self.q[operator.index(row)], self.v[operator.index(row)]
        except (IndexError, OverflowError, TypeError):
            raise OutOfRange("row", described(row), f"a whole number from {-len(self)} to {len(self) - 1}") from None
        return State(q, v)

    @checked
    def since(self, t: float) -> Trajectory:
        """The rows from a time on [s]."""
        return self._rows(self.t >= t)

    @checked
    def before(self, t: float) -> Trajectory:
        """The rows before a time [s]."""
        return self._rows(self.t < t)

    @checked
    def between(self, first: float, last: float) -> Trajectory:
        """The rows from one time to another [s], both included."""
        return self._rows((self.t >= first - 1e-9) & (self.t <= last + 1e-9))

    def _rows(self, chosen: np.ndarray) -> Trajectory:
        return replace(self, **{name: getattr(self, name)[chosen] for name in COLUMNS})

    @property
    def ledger(self) -> np.ndarray:
        """Energy less the work done on the crane plus what damping took [J], shape (n,); constant but for the error of the step."""
        return self.energy - self.work.sum(axis=1) - self.outside.sum(axis=1) + self.dissipated

    @property
    def unexplained(self) -> np.ndarray:
        """What the energy ledger leaves open since the first row [J], shape (n,)."""
        return self.ledger - self.ledger[0]

    def table(self) -> pyarrow.Table:
        """All columns as an Arrow table, the parameters in its metadata."""
        import pyarrow

        names = [column for columns in COLUMNS.values() for column in columns]
        return pyarrow.table(
            {name: np.ascontiguousarray(self[name]) for name in names}, metadata={"cranedyn": json.dumps(dict(self.parameters))}
        )

    @checked
    def write(self, path: str | Path) -> Path:
        """Write to a ``.csv`` or ``.parquet`` file; both hold every number to the bit, Parquet the parameters too.

        Raises:
            DataError: If the ending is another or the file cannot be written.
        """
        import pyarrow.csv
        import pyarrow.parquet

        path = Path(path)
        writer = {".csv": pyarrow.csv.write_csv, ".parquet": pyarrow.parquet.write_table}.get(path.suffix)
        if writer is None:
            raise DataError(f"Cannot write {path}: the ending must be .csv or .parquet.")
        with written(path) as draft, draft.open("wb") as file:  # Arrow takes no name that is not UTF-8
            writer(self.table(), file)
        return path


@checked
def read(path: str | Path) -> Trajectory:
    """Read a whole trajectory back from what `Trajectory.write` wrote.

    Raises:
        DataError: As `cranedyn.data.tables.read_table`; if there is no row, time does not increase, or the parameters are not a JSON
            object of numbers and words.
    """
    from cranedyn.data.tables import read_table

    found, metadata = read_table(path, [column for columns in COLUMNS.values() for column in columns])
    t = found["t_s"]
    if not (len(t) > 0 and (t[1:] > t[:-1]).all()):
        raise DataError(f"{path}: t_s must increase from row to row, over one row at least.")
    arrays = {name: [found[column] for column in columns] for name, columns in COLUMNS.items()}
    return Trajectory(
        **{name: np.stack(values, axis=1) if len(values) > 1 else values[0] for name, values in arrays.items()},
        parameters=_parameters(metadata, path),
    )


@checked
def read_columns(path: str | Path, columns: Sequence[str]) -> dict[str, np.ndarray]:
    """Read some columns of a ``.csv`` or ``.parquet`` file, ours or recorded elsewhere.

    Raises:
        DataError: As `cranedyn.data.tables.read_table`, and if time does not increase.
    """
    from cranedyn.data.tables import read_table

    found = read_table(path, columns)[0]
    t = found.get("t_s")
    if t is not None and not (len(t) > 1 and (t[1:] > t[:-1]).all()):
        raise DataError(f"{path}: t_s must increase from row to row, over two rows at least.")
    return found


def _parameters(metadata: Mapping[bytes, bytes], path: str | Path) -> dict[str, float | str]:
    try:
        found = parse_json(metadata.get(b"cranedyn", b"{}"))
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict) or not all(isinstance(value, float | int | str) for value in found.values()):
        raise DataError(f"{path}: its parameters are not a JSON object of numbers and words.")
    return found


@checked
def join(pieces: Sequence[Trajectory]) -> Trajectory:
    """One trajectory from pieces of a run, each beginning at the time and state at which the one before ended.

    Work and dissipation go on from piece to piece; parameters are those of the first.

    Raises:
        DataError: If there is no piece, one is empty, or one does not begin where the one before ended.
    """
    if not len(pieces):
        raise DataError("There are no pieces to join.")
    if not all(len(piece) for piece in pieces):
        raise DataError("A piece to join has no rows.")
    for one, next_one in itertools.pairwise(pieces):
        if one.t[-1] != next_one.t[0] or not np.array_equal(one.q[-1], next_one.q[0]):
            raise DataError(f"A piece that begins at t = {next_one.t[0]:g} s does not go on from one that ends at t = {one.t[-1]:g} s.")
    ends = [-1] * (len(pieces) - 1) + [None]
    whole = {name: np.concatenate([getattr(piece, name)[:end] for piece, end in zip(pieces, ends, strict=True)]) for name in COLUMNS}
    for name in ("work", "dissipated", "outside"):
        before = np.cumsum([getattr(piece, name)[-1] for piece in pieces[:-1]], axis=0)
        on = [getattr(piece, name) + (before[k - 1] if k else 0.0) for k, piece in enumerate(pieces)]
        whole[name] = np.concatenate([values[:end] for values, end in zip(on, ends, strict=True)])
    return Trajectory(**whole, parameters=pieces[0].parameters)
