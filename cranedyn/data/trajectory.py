"""The record of a run: named columns that carry their units."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np

from cranedyn.data.columns import QUANTITIES, columns_by_quantity
from cranedyn.data.files import parse_json, read_text
from cranedyn.data.time_series import TimeSeries
from cranedyn.errors import DataError, OutOfRange, UnknownColumn, UnknownName
from cranedyn.interfaces import State

_SCALARS = ("t", "energy", "dissipated", "valid", "phase")
"""Quantities of one number a row."""

_TIME_TOLERANCE = 1e-9
"""Round-off of a time at which rows are cut [s]."""

_ACCUMULATED = ("work", "dissipated", "outside")
"""Quantities that count since the start of a run."""


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(TimeSeries):
    """One row for each control instant of a crane with n joints and m drives.

    Attributes:
        t: Time [s], shape (rows,).
        q: Coordinates [rad or m], shape (rows, n).
        v: Rates of the coordinates [rad/s or m/s], shape (rows, n).
        setpoint: Setpoints of the drives [rad or m], shape (rows, m).
        command: Efforts that the controller commanded, from this instant to the next [N m or N],
            shape (rows, m). Where the drives follow prescribed motion they are the efforts that
            this motion takes.
        effort: Efforts that acted: the command within the limits of the drives, shape (rows, m).
        energy: Mechanical energy of the whole crane [J], zero of height at the ground, shape
            (rows,).
        work: Work done by each drive since the start [J], shape (rows, m).
        dissipated: Energy dissipated by joint damping since the start [J], shape (rows,).
        force: External forces in the world frame from this instant to the next, on the points of
            the crane [N], shape (rows, 3 points).
        outside: Work done on the crane since the start by these forces, by buffers at the ends of
            the ranges, if the rope may go slack, by impacts where it becomes taut, which is
            negative where kinetic energy is lost, if the base moves, by the base, and, if loads are
            attached or released, by them [J], shape (rows, 2 to 5).
        valid: 1 where the model is valid, 0 elsewhere, see `cranedyn.dynamics.validity`; shape
            (rows,).
        phase: 0 where the rope is taut, 1 where it is slack, 2 where the load stands on the ground,
            3 where it is lifted off-lead, shape (rows,); None if the rope cannot go slack.
        base: Surge, sway, heave [m], roll, pitch and yaw [rad] of the base on which the crane
            stands, see `cranedyn.disturbances.base_motion`, shape (rows, 6); None for a crane that
            stands in the world. Coordinates and rates are those relative to the base. The energy is
            that in the world.
        columns: Names of the columns of each of these quantities.
        parameters: Numbers and words that describe the run, by name.
        record: All that is needed to repeat the run: crane, controller, reference and disturbance
            by name with their numbers, and versions of programs.
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
    phase: np.ndarray | None = None
    base: np.ndarray | None = None

    def keys(self) -> list[str]:
        """Return the names of the columns."""
        return list(itertools.chain.from_iterable(self.columns.values()))

    def __getitem__(self, column: str) -> np.ndarray:
        """Return a column by its name, shape (rows,).

        Raises:
            UnknownColumn: If there is no such column; it is also a KeyError.
        """
        for name, columns in self.columns.items():
            if column in columns:
                values = getattr(self, name)
                return values if values.ndim == 1 else values[:, columns.index(column)]
        raise UnknownColumn("column", column, self.keys())

    def coordinates(self, *symbols: str) -> np.ndarray:
        """Return coordinates by their symbols, for example "phi", "theta" [rad or m], shape (rows,
        number of symbols).

        Raises:
            UnknownName: If there is no coordinate of a symbol.
        """
        return self.q[:, self._indices(symbols)]

    def rates(self, *symbols: str) -> np.ndarray:
        """Return rates of coordinates by their symbols [rad/s or m/s], shape (rows, number of
        symbols).

        Raises:
            UnknownName: If there is no coordinate of a symbol.
        """
        return self.v[:, self._indices(symbols)]

    @property
    def symbols(self) -> tuple[str, ...]:
        """Symbols of the coordinates."""
        return tuple(column.rpartition("_")[0] for column in self.columns["q"])

    def check_coordinates(self, columns: Sequence[str]) -> None:
        """Check that the run is one of a crane whose coordinates have these columns.

        Raises:
            OutOfRange: If it is not, with the symbols of both.
        """
        if tuple(self.columns["q"]) != tuple(columns):
            expected = ", ".join(column.rpartition("_")[0] for column in columns)
            given = f"of joints {', '.join(self.symbols)}"
            raise OutOfRange("run", given, f"a run of this crane, of joints {expected}")

    def check_base_at_rest(self, purpose: str) -> None:
        """Check that the base on which the crane stands does not move.

        Args:
            purpose: What knows no base that moves, such as "The load chart".

        Raises:
            OutOfRange: If it moves.
        """
        if self.base is not None:
            allowed = f"one of a crane that stands in the world: {purpose} knows no base that moves"
            raise OutOfRange("run", "one with a base that moves", allowed)

    @property
    def drives(self) -> list[int]:
        """Indices of the driven coordinates among all coordinates."""
        symbols = [column.rpartition("_setpoint_")[0] for column in self.columns["setpoint"]]
        return self._indices(symbols)

    def _indices(self, symbols: Sequence[str]) -> list[int]:
        """Return the indices of coordinates by their symbols."""
        for symbol in symbols:
            if symbol not in self.symbols:
                raise UnknownName("coordinate", symbol, self.symbols)
        return [self.symbols.index(symbol) for symbol in symbols]

    def state(self, row: int) -> State:
        """Return the state at a row; -1 is the last.

        Raises:
            OutOfRange: If there is no such row.
        """
        if not (isinstance(row, Integral) and -len(self) <= row < len(self)):
            raise OutOfRange("row", row, f"a whole number from {-len(self)} to {len(self) - 1}")
        return State(self.q[row], self.v[row])

    def since(self, t: float) -> Trajectory:
        """Return the rows at and after a time [s]."""
        return self._rows(self.t >= t)

    def before(self, t: float) -> Trajectory:
        """Return the rows before a time [s]."""
        return self._rows(self.t < t)

    def between(self, first: float, last: float) -> Trajectory:
        """Return the rows from one time to another [s], including both."""
        is_after = self.t >= first - _TIME_TOLERANCE
        is_before = self.t <= last + _TIME_TOLERANCE
        return self._rows(is_after & is_before)

    def _rows(self, mask: np.ndarray) -> Trajectory:
        """Return the rows where a mask is true."""
        arrays = {name: getattr(self, name)[mask] for name in self._quantities}
        return replace(self, **arrays)

    @property
    def _quantities(self) -> tuple[str, ...]:
        """Names of the arrays."""
        names = list(QUANTITIES)
        if self.phase is not None:
            names.append("phase")
        if self.base is not None:
            names.append("base")
        return tuple(names)

    @property
    def ledger(self) -> np.ndarray:
        """Energy less the work done on the crane plus the energy dissipated [J], shape (rows,);
        constant up to the integration error.
        """
        return self.energy - self.work.sum(axis=1) - self.outside.sum(axis=1) + self.dissipated

    @property
    def unexplained(self) -> np.ndarray:
        """Change of the energy ledger since the first row [J], shape (rows,)."""
        return self.ledger - self.ledger[0]


def read(path: str | Path) -> Trajectory:
    """Read a trajectory from a file that `Trajectory.write` wrote.

    Raises:
        DataError: As `cranedyn.data.tables.read_table`; if there is no row, time does not increase,
            or the parameters are not a JSON object of numbers and words.
    """
    from cranedyn.data.tables import column_names, read_table

    columns = columns_by_quantity(column_names(path), path)
    values, metadata = read_table(path, list(itertools.chain.from_iterable(columns.values())))
    _check_times(values["t_s"], 1, path)
    arrays = {}
    for quantity, names in columns.items():
        if quantity in _SCALARS:
            arrays[quantity] = values[names[0]]
        else:
            arrays[quantity] = np.stack([values[name] for name in names], axis=1)
    message = f"{path}: its parameters are not a JSON object of numbers and words."
    parameters = _json_object(metadata, b"cranedyn", message)
    if not all(isinstance(value, float | int | str) for value in parameters.values()):
        raise DataError(message)
    return Trajectory(
        **arrays, columns=columns, parameters=parameters, record=_record(metadata, path)
    )


def read_columns(path: str | Path, columns: Sequence[str]) -> dict[str, np.ndarray]:
    """Read some columns of a ``.csv`` or ``.parquet`` file, whichever program wrote it.

    Raises:
        DataError: As `cranedyn.data.tables.read_table`, and if time does not increase.
    """
    from cranedyn.data.tables import read_table

    values, _ = read_table(path, columns)
    if "t_s" in values:
        _check_times(values["t_s"], 2, path)
    return values


def read_record(path: str | Path) -> dict[str, Any]:
    """Read `Trajectory.record` from a Parquet file, empty if it has none, or from a ``.json`` file
    that holds nothing else.

    Raises:
        DataError: If the file cannot be read, or its record is no JSON object.
    """
    from cranedyn.data.tables import metadata_of

    if Path(path).suffix == ".json":
        return _record({b"cranedyn.record": read_text(path).encode()}, path)
    return _record(metadata_of(path), path)


def _record(metadata: Mapping[bytes, bytes], path: str | Path) -> dict[str, Any]:
    """Return the record in the metadata of a file, empty if there is none."""
    message = f"{path}: its record is not a JSON object."
    return _json_object(metadata, b"cranedyn.record", message)


def _json_object(metadata: Mapping[bytes, bytes], key: bytes, message: str) -> dict[str, Any]:
    """Return the JSON object at a key of the metadata of a file, empty if there is none.

    Raises:
        DataError: With a message, if it is no JSON object.
    """
    try:
        content = parse_json(metadata.get(key, b"{}"))
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise DataError(message)
    return content


def _check_times(t: np.ndarray, least_rows: int, path: str | Path) -> None:
    """Check that there are so many rows, one or two, at least, and that time increases."""
    if len(t) < least_rows:
        rows = "one row" if least_rows == 1 else "two rows"
        raise DataError(f"{path} has too few rows, {len(t)}; it needs {rows} or more.")
    check_increasing(t, "t_s", path)


def check_increasing(
    t: np.ndarray, name: str, path: str | Path, rows: np.ndarray | None = None
) -> None:
    """Check that times increase from row to row [s].

    Args:
        t: The times, two at least.
        name: Name of their column, for the error message.
        path: File that they are from, for the error message.
        rows: Rows of the file that they are from, counted from 0; None for all.

    Raises:
        DataError: If they do not, with the first row in which one does not.
    """
    not_later = np.flatnonzero(~(t[1:] > t[:-1]))  # NaN among them
    if len(not_later):
        row = int(not_later[0])
        # The number of the later of both rows, counted from 1.
        number = row + 2 if rows is None else int(rows[row + 1]) + 1
        raise DataError(
            f"{path}: {name} must increase from row to row; in data row {number} it is "
            f"{t[row + 1]:.9g} s after {t[row]:.9g} s. Leave out rows that come twice, or sort "
            "them by time."
        )


def join(pieces: Sequence[Trajectory]) -> Trajectory:
    """Join pieces of a run, each beginning at the last time and state of the one before.

    Work and dissipation accumulate over the pieces; the parameters are those of the first.

    Raises:
        DataError: If there is no piece, a piece is empty, or does not begin where the one before
            ended.
    """
    if not len(pieces):
        raise DataError("There are no pieces to join; give one or more.")
    if not all(len(piece) for piece in pieces):
        raise DataError("A piece to join has no rows.")
    for previous, piece in itertools.pairwise(pieces):
        if previous.t[-1] != piece.t[0] or not np.array_equal(previous.q[-1], piece.q[0]):
            raise DataError(
                f"A piece that begins at t = {piece.t[0]:g} s does not go on from one that ends at "
                f"t = {previous.t[-1]:g} s."
            )
    first = pieces[0]
    arrays = {}
    for name in first._quantities:
        stacks = [getattr(piece, name) for piece in pieces]
        if name in _ACCUMULATED:
            stacks = _accumulated(stacks)
        # A piece begins with the row in which the one before ended: that of the later piece counts.
        trimmed = [values[:-1] for values in stacks[:-1]]
        arrays[name] = np.concatenate([*trimmed, stacks[-1]])
    return Trajectory(
        **arrays,
        columns=first.columns,
        parameters=first.parameters,
        record=first.record,
    )


def _accumulated(stacks: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return a quantity of each of some pieces of a run, with what had come together at the end of
    the pieces before.
    """
    totals = np.cumsum([values[-1] for values in stacks[:-1]], axis=0)
    later = [values + total for values, total in zip(stacks[1:], totals, strict=True)]
    return [stacks[0], *later]
