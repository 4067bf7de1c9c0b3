"""Arrays for compiled code: tables of controllers, references and forces, which cranes share where
they are equal, and rows of many cranes in groups of lanes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cranedyn.compiled.layout import BufferLayout, size, slices
from cranedyn.controllers.affine import Affine, without_integral


@dataclass(frozen=True, eq=False)
class RowTable:
    """Rows by control instant, one table after another.

    Attributes:
        rows: Shape (tables n, columns).
        length: Rows of one table, n; beyond its end the last row applies.
        starts: First row of each crane's table, shape (cranes,).
    """

    rows: np.ndarray
    length: int
    starts: np.ndarray

    @property
    def shared(self) -> bool:
        """Whether all cranes have the same table."""
        return len(self.rows) == self.length


def single_table(rows: np.ndarray) -> RowTable:
    """Return the table of a single crane, shape (n, columns)."""
    return RowTable(rows, len(rows), np.zeros(1, dtype=np.int64))


class TableStack:
    """Tables of different lengths, which are stacked after padding to the longest.

    Attributes:
        arrays: Rows of each table, shape (n, columns).
    """

    def __init__(self) -> None:
        self.arrays: list[np.ndarray] = []
        self._length = 0

    def add(self, rows: np.ndarray) -> int:
        """Add a table and return its index."""
        self.arrays.append(rows)
        self._length = max(self._length, len(rows))
        return len(self.arrays) - 1

    @property
    def numbers(self) -> int:
        """Numbers in the stack."""
        return len(self.arrays) * self._length * self.arrays[0].shape[1]

    def stacked(self, chosen: np.ndarray) -> RowTable:
        """Return the tables as one; chosen is the index of each crane's table."""
        rows = [np.pad(a, ((0, self._length - len(a)), (0, 0)), "edge") for a in self.arrays]
        stacked = np.ascontiguousarray(np.concatenate(rows), dtype=float)
        return RowTable(stacked, self._length, chosen.astype(np.int64) * self._length)


def gain_table(sizes: BufferLayout, form: Affine) -> np.ndarray:
    """Return the rows of a controller, shape (n, columns)."""
    n, columns = len(form.feed_forward), slices(sizes.gain_table)
    rows = np.empty((n, size(sizes.gain_table)))
    for name in columns:
        values = getattr(form, name)
        rows[:, columns[name]] = values.reshape(n, -1) if name == "gain" else values
    return rows


def setpoint_table(sizes: BufferLayout, form: Affine, n: int) -> np.ndarray:
    """Return rows of the state about which a controller acts and of its setpoint of the drives,
    shape (n, columns), as many as differ.
    """
    columns, n = slices(sizes.setpoint_table), min(n, max(len(form.setpoint), len(form.target)))
    rows = np.empty((n, size(sizes.setpoint_table)))
    for values, name in ((form.setpoint, "setpoint"), (form.target, "position")):
        rows[: len(values), columns[name]] = values[:n]
        rows[len(values) :, columns[name]] = values[-1]
    return rows


def drop_repeated_rows(rows: np.ndarray) -> np.ndarray:
    """Return rows without those at the end that repeat the row before."""
    changes = np.flatnonzero((rows[1:] != rows[:-1]).any(axis=1))
    return rows[: int(changes[-1]) + 2 if len(changes) else 1].copy()


def without_gains(sizes: BufferLayout, positions: np.ndarray) -> Affine:
    """Return the affine form without gains: zero, about the setpoint of the drives, shape (rows,
    m).
    """
    m, z = sizes.m, sizes.z
    form = without_integral(np.zeros((1, m)), np.zeros((1, m, z)), np.zeros((1, z)))
    return replace(form, target=positions)


def command_tables(sizes: BufferLayout) -> tuple[np.ndarray, np.ndarray]:
    """Return tables of one row that hold a command, zero at first."""
    return np.zeros((1, size(sizes.gain_table))), np.zeros((1, size(sizes.setpoint_table)))


def group_lanes(arrays: Sequence[np.ndarray], lanes: int, kind: type = np.float64) -> np.ndarray:
    """Arrange arrays with a row for each crane, shape (n, m) each, in groups of lanes, shape
    (groups, all m, lanes).

    The last crane fills the last group.
    """
    groups = np.empty(
        (-(-len(arrays[0]) // lanes), sum(array.shape[1] for array in arrays), lanes), dtype=kind
    )
    first = 0
    for array in arrays:
        for lane in range(lanes):
            target, rows = groups[:, first : first + array.shape[1], lane], array[lane::lanes]
            target[: len(rows)], target[len(rows) :] = rows, array[-1]
        first += array.shape[1]
    return groups


def ungroup_lanes(groups: np.ndarray, count: int) -> np.ndarray:
    """Return groups of lanes as one row for each crane, shape (count, m)."""
    return groups.transpose(0, 2, 1).reshape(groups.shape[0] * groups.shape[2], groups.shape[1])[
        :count
    ]
