"""What happened: the record of a run, with named columns that carry their units."""

from __future__ import annotations

import itertools
import json
import operator
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cranedyn.checks import short_repr
from cranedyn.data.files import parse_json, read_text
from cranedyn.data.shown import Shown
from cranedyn.errors import DataError, OutOfRange, UnknownColumn, UnknownName
from cranedyn.interfaces import State

if TYPE_CHECKING:
    import pyarrow

QUANTITIES = (
    "t",
    "q",
    "v",
    "setpoint",
    "command",
    "effort",
    "energy",
    "work",
    "dissipated",
    "force",
    "outside",
    "valid",
)
"""The arrays of a trajectory, in the order of their columns."""

_OF_RUN = {
    "t": ("t_s",),
    "energy": ("energy_J",),
    "dissipated": ("dissipated_J",),
    "outside": ("W_force_J", "W_buffers_J"),
    "valid": ("valid",),
}
"""Columns that every record has, whatever crane it is of."""


_FORMS = {
    "v": re.compile(r"(?P<of>.+)_dot_(?P<unit>rad|m)_s"),
    "setpoint": re.compile(r"(?P<of>.+)_setpoint_(rad|m)"),
    "command": re.compile(r"[TF]_(?P<of>.+)_command_Nm?"),
    "force": re.compile(r"(?P<of>.+)_force_[xyz]_N"),
    "effort": re.compile(r"[TF]_(?P<of>.+)_Nm?"),
    "work": re.compile(r"W_(?P<of>.+)_J"),
    "q": re.compile(r"(?P<of>.+)_(?P<unit>rad|m)"),
}
"""What the names of all other columns look like, as `cranedyn.model.layout.Layout.columns` gives
them; the first that fits tells."""


def columns_of(names: Sequence[str], path: str | Path) -> dict[str, tuple[str, ...]]:
    """Which quantity each column of a record is of; columns of no quantity are left out.

    Args:
        names: Of the columns.
        path: Where they stand, for the sentence.

    Raises:
        DataError: If a column is missing that belongs to one that is there.
    """
    found: dict[str, list[str]] = {quantity: [] for quantity in QUANTITIES}
    known = {name: quantity for quantity, own in _OF_RUN.items() for name in own}
    units: dict[str, str] = {}
    parts: dict[str, list[str]] = {quantity: [] for quantity in _FORMS}
    for name in names:
        fits = [
            (quantity, match)
            for quantity, form in _FORMS.items()
            if (match := form.fullmatch(name))
        ]
        if name in known:
            found[known[name]].append(name)
        elif fits:
            quantity, match = fits[0]
            found[quantity].append(name)
            parts[quantity].append(match["of"])
            units |= {match["of"]: match["unit"]} if quantity in ("q", "v") else {}
    lacking = [name for name in _belonging(units, parts) if name not in names]
    if lacking:
        raise DataError(
            f"{path} has no column {', '.join(dict.fromkeys(lacking))}; a whole record of these "
            "joints has it."
        )
    if not (units and parts["effort"]):
        raise DataError(
            f"{path} has columns of no joint, or of no drive; a record has them of one each at "
            "least."
        )
    return {quantity: tuple(columns) for quantity, columns in found.items()}


def _belonging(units: Mapping[str, str], parts: Mapping[str, Sequence[str]]) -> list[str]:
    """Columns that a record of such coordinates, drives and points has."""
    needed = [name for own in _OF_RUN.values() for name in own]
    needed += [
        name for of, unit in units.items() for name in (f"{of}_{unit}", f"{of}_dot_{unit}_s")
    ]
    for of in dict.fromkeys(
        of for quantity in ("setpoint", "command", "effort", "work") for of in parts[quantity]
    ):
        unit, sign, of_effort = ("rad", "T", "Nm") if units.get(of) == "rad" else ("m", "F", "N")
        needed += [
            f"{of}_{unit}",
            f"{of}_setpoint_{unit}",
            f"{sign}_{of}_command_{of_effort}",
            f"{sign}_{of}_{of_effort}",
            f"W_{of}_J",
        ]
    return needed + [
        f"{of}_force_{axis}_N" for of in dict.fromkeys(parts["force"]) for axis in "xyz"
    ]


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(Shown):
    """One row per control instant, of a crane with n joints and m drives.

    Attributes:
        t: Time [s], shape (rows,).
        q: Coordinates [rad or m], shape (rows, n).
        v: Their rates, shape (rows, n).
        setpoint: Where the drives should be [rad or m], shape (rows, m).
        command: Efforts that the controller asked for, from this instant to the next [N m or N],
            shape (rows, m). Where the drives follow prescribed motion they are the efforts that
            this motion costs.
        effort: Efforts that acted: the command within the limits of the drives, shape (rows, m).
        energy: Mechanical energy of the whole crane [J], zero of height at the ground, shape
            (rows,).
        work: Work done by each drive since the start [J], shape (rows, m).
        dissipated: Energy taken by joint damping since the start [J], shape (rows,).
        force: Outside forces in the world from this instant to the next, on the points of the crane
            [N], shape (rows, 3 points).
        outside: Work done on the crane since the start by these forces, and by buffers at the ends
            of the ranges [J], shape (rows, 2).
        valid: 1 where the model holds, 0 where not, see `cranedyn.dynamics.validity`; shape
            (rows,).
        columns: Names of the columns of each of these.
        parameters: What the run was made with, by name.
        record: What moved and what moved it, for whoever makes the run again: the crane,
            controller, reference and disturbance by name with their numbers, and versions of
            programs.
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
    columns: Mapping[str, tuple[str, ...]]
    parameters: Mapping[str, float | str] = field(default_factory=dict)
    record: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.t)

    def __getitem__(self, column: str) -> np.ndarray:
        """A column by its name, shape (n,).

        Raises:
            UnknownColumn: If there is no such column, which is also a KeyError.
        """
        for name, columns in self.columns.items():
            if column in columns:
                values = getattr(self, name)
                return values if values.ndim == 1 else values[:, columns.index(column)]
        raise UnknownColumn("column", column, self.keys())

    def coordinates(self, *symbols: str) -> np.ndarray:
        """Some coordinates by their symbols, for example "phi", "theta" [rad or m], shape (rows,
        number of symbols).

        Raises:
            UnknownName: If there is no coordinate of a symbol.
        """
        return self.q[:, self._places(symbols)]

    def rates(self, *symbols: str) -> np.ndarray:
        """The rates of some coordinates by their symbols [rad/s or m/s], shape (rows, number of
        symbols).

        Raises:
            UnknownName: If there is no coordinate of a symbol.
        """
        return self.v[:, self._places(symbols)]

    @property
    def symbols(self) -> tuple[str, ...]:
        """Of the coordinates."""
        return tuple(column.rpartition("_")[0] for column in self.columns["q"])

    @property
    def drives(self) -> list[int]:
        """Where the drives stand among the coordinates."""
        return self._places(
            [column.rpartition("_setpoint_")[0] for column in self.columns["setpoint"]]
        )

    def _places(self, symbols: Sequence[str]) -> list[int]:
        for symbol in symbols:
            if symbol not in self.symbols:
                raise UnknownName("coordinate", symbol, self.symbols)
        return [self.symbols.index(symbol) for symbol in symbols]

    def state(self, row: int) -> State:
        """The state at a row; -1 is the last.

        Raises:
            OutOfRange: If there is no such row.
        """
        try:
            q, v = self.q[operator.index(row)], self.v[operator.index(row)]
        except (IndexError, OverflowError, TypeError):
            raise OutOfRange(
                "row", short_repr(row), f"a whole number from {-len(self)} to {len(self) - 1}"
            ) from None
        return State(q, v)

    def since(self, t: float) -> Trajectory:
        """The rows from a time on [s]."""
        return self._rows(self.t >= t)

    def before(self, t: float) -> Trajectory:
        """The rows before a time [s]."""
        return self._rows(self.t < t)

    def between(self, first: float, last: float) -> Trajectory:
        """The rows from one time to another [s], both included."""
        return self._rows((self.t >= first - 1e-9) & (self.t <= last + 1e-9))

    def _rows(self, chosen: np.ndarray) -> Trajectory:
        return replace(self, **{name: getattr(self, name)[chosen] for name in QUANTITIES})

    @property
    def ledger(self) -> np.ndarray:
        """Energy less the work done on the crane plus what damping took [J], shape (n,); constant
        but for the error of the step.
        """
        return self.energy - self.work.sum(axis=1) - self.outside.sum(axis=1) + self.dissipated

    @property
    def unexplained(self) -> np.ndarray:
        """What the energy ledger leaves open since the first row [J], shape (n,)."""
        return self.ledger - self.ledger[0]

    def table(self) -> pyarrow.Table:
        """All columns as an Arrow table, the parameters in its metadata."""
        import pyarrow

        names = [column for columns in self.columns.values() for column in columns]
        return pyarrow.table(
            {name: np.ascontiguousarray(self[name]) for name in names},
            metadata={
                "cranedyn": json.dumps(dict(self.parameters)),
                "cranedyn.record": json.dumps(dict(self.record)),
            },
        )

    def write(self, path: str | Path) -> Path:
        """Write to a ``.csv`` or ``.parquet`` file; both hold every number to the bit, Parquet the
        parameters too.

        Raises:
            DataError: If the ending is another or the file cannot be written.
        """
        from cranedyn.data.tables import write_table

        return write_table(path, self.table())


def read(path: str | Path) -> Trajectory:
    """Read a whole trajectory back from what `Trajectory.write` wrote.

    Raises:
        DataError: As `cranedyn.data.tables.read_table`; if there is no row, time does not increase,
            or the parameters are not a JSON object of numbers and words.
    """
    from cranedyn.data.tables import column_names, read_table

    columns = columns_of(column_names(path), path)
    found, metadata = read_table(path, [name for own in columns.values() for name in own])
    t = found["t_s"]
    if not (len(t) > 0 and (t[1:] > t[:-1]).all()):
        raise DataError(f"{path}: t_s must increase from row to row, over one row at least.")
    flat = ("t", "energy", "dissipated", "valid")
    return Trajectory(
        **{
            name: found[own[0]]
            if name in flat
            else np.stack([found[column] for column in own], axis=1)
            for name, own in columns.items()
        },
        columns=columns,
        parameters=_parameters(metadata, path),
        record=_record(metadata, path),
    )


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
    if not isinstance(found, dict) or not all(
        isinstance(value, float | int | str) for value in found.values()
    ):
        raise DataError(f"{path}: its parameters are not a JSON object of numbers and words.")
    return found


def _record(metadata: Mapping[bytes, bytes], path: str | Path) -> dict[str, Any]:
    try:
        found = parse_json(metadata.get(b"cranedyn.record", b"{}"))
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise DataError(f"{path}: its record is not a JSON object.")
    return found


def read_record(path: str | Path) -> dict[str, Any]:
    """What a Parquet file says of what moved and what moved it, see `Trajectory.record`; empty if
    it says nothing. A ``.json`` file is such a record by itself.

    Raises:
        DataError: If it cannot be read, or says it in another form.
    """
    from cranedyn.data.tables import metadata_of

    if Path(path).suffix == ".json":
        return _record({b"cranedyn.record": read_text(path).encode()}, path)
    return _record(metadata_of(path), path)


def join(pieces: Sequence[Trajectory]) -> Trajectory:
    """One trajectory from pieces of a run, each beginning at the time and state at which the one
    before ended.

    Work and dissipation go on from piece to piece; parameters are those of the first.

    Raises:
        DataError: If there is no piece, one is empty, or one does not begin where the one before
            ended.
    """
    if not len(pieces):
        raise DataError("There are no pieces to join.")
    if not all(len(piece) for piece in pieces):
        raise DataError("A piece to join has no rows.")
    for one, next_one in itertools.pairwise(pieces):
        if one.t[-1] != next_one.t[0] or not np.array_equal(one.q[-1], next_one.q[0]):
            raise DataError(
                f"A piece that begins at t = {next_one.t[0]:g} s does not go on from one that ends "
                f"at t = {one.t[-1]:g} s."
            )
    ends = [-1] * (len(pieces) - 1) + [None]
    whole = {
        name: np.concatenate(
            [getattr(piece, name)[:end] for piece, end in zip(pieces, ends, strict=True)]
        )
        for name in QUANTITIES
    }
    for name in ("work", "dissipated", "outside"):
        before = np.cumsum([getattr(piece, name)[-1] for piece in pieces[:-1]], axis=0)
        on = [
            getattr(piece, name) + (before[k - 1] if k else 0.0) for k, piece in enumerate(pieces)
        ]
        whole[name] = np.concatenate([values[:end] for values, end in zip(on, ends, strict=True)])
    return Trajectory(
        **whole, columns=pieces[0].columns, parameters=pieces[0].parameters, record=pieces[0].record
    )
