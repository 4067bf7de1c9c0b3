"""Controllers, references and forces as tables for compiled code; cranes share equal tables."""

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


def stack_tables(arrays: Sequence[np.ndarray], chosen: np.ndarray) -> RowTable:
    """Return tables of different lengths, shape (n, columns) each, as one; chosen is the index of
    each crane's table.
    """
    length = max(len(rows) for rows in arrays)
    padded = [
        rows
        if len(rows) == length
        else np.concatenate([rows, rows[-1:].repeat(length - len(rows), axis=0)])
        for rows in arrays
    ]
    stacked = np.ascontiguousarray(
        padded[0] if len(padded) == 1 else np.concatenate(padded), dtype=float
    )
    return RowTable(stacked, length, chosen.astype(np.int64) * length)


def gain_table(sizes: BufferLayout, form: Affine, rows: np.ndarray | None = None) -> np.ndarray:
    """Return the rows of a controller, shape (n, columns), written to an array of that shape if
    there is one.
    """
    n, columns = len(form.feed_forward), slices(sizes.gain_table)
    rows = np.empty((n, size(sizes.gain_table))) if rows is None else rows
    rows[:, columns["feed_forward"]], rows[:, columns["gain"]] = (
        form.feed_forward,
        form.gain.reshape(n, -1),
    )
    rows[:, columns["integral_gain"]], rows[:, columns["limit"]] = form.integral_gain, form.limit
    return rows


def setpoint_table(
    sizes: BufferLayout, form: Affine, n: int, rows: np.ndarray | None = None
) -> np.ndarray:
    """Return rows of the state about which a controller acts and of its setpoint of the drives,
    shape (n, columns), written to an array as for `gain_table`.
    """
    columns = slices(sizes.setpoint_table)
    rows = np.empty((n, size(sizes.setpoint_table))) if rows is None else rows
    for values, section in (
        (form.setpoint, columns["setpoint"]),
        (form.target, columns["position"]),
    ):
        rows[: len(values), section], rows[len(values) :, section] = values[:n], values[-1]
    return rows


def drop_repeated_rows(rows: np.ndarray) -> np.ndarray:
    """Return rows without those at the end that repeat the row before."""
    changes = np.flatnonzero((rows[1:] != rows[:-1]).any(axis=1))
    return rows[: int(changes[-1]) + 2 if len(changes) else 1].copy()


def without_gains(sizes: BufferLayout, positions: np.ndarray) -> Affine:
    """Return the affine form without gains: zero, about the setpoint of the drives, shape (rows,
    m).
    """
    nothing, z = np.zeros((1, sizes.m)), sizes.z
    form = without_integral(nothing, np.zeros((1, sizes.m, z)), np.zeros((1, z)))
    return replace(form, target=positions)


def command_tables(sizes: BufferLayout) -> tuple[np.ndarray, np.ndarray]:
    """Return tables of one row that hold a command, zero at first."""
    return np.zeros((1, size(sizes.gain_table))), np.zeros((1, size(sizes.setpoint_table)))
