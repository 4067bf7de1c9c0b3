"""Arrays for compiled code: tables of controllers, references and forces, which cranes share where
they are equal, and rows of many cranes in groups of lanes.

In a `RowTable` the tables of several cranes stand one after another. Each crane knows the first row
of its own, and at a control instant k reads k rows further on, up to the last row of its table.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cranedyn.compiled.memory_layout import BufferLayout, size, slices
from cranedyn.controllers.affine import Affine, ControllerStates, without_integral


@dataclass(frozen=True, eq=False)
class RowTable:
    """Rows by control instant, one table after another.

    Attributes:
        rows: Rows of all tables, shape (tables · n, columns).
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
    def number_count(self) -> int:
        """How many numbers the stack has."""
        return len(self.arrays) * self._length * self.arrays[0].shape[1]

    def stacked(self, index: np.ndarray) -> RowTable:
        """Return the tables as one, for cranes that have the tables of an index each, shape
        (cranes,).
        """
        # Beyond the end of a table its last row applies, so that padding repeats it.
        padded = []
        for rows in self.arrays:
            missing = self._length - len(rows)
            padded.append(np.pad(rows, ((0, missing), (0, 0)), "edge"))
        stacked = np.ascontiguousarray(np.concatenate(padded), dtype=float)
        return RowTable(stacked, self._length, index.astype(np.int64) * self._length)


def gain_table(sizes: BufferLayout, form: Affine) -> np.ndarray:
    """Return the rows of a controller, shape (n, columns), see `BufferLayout.gain_table`.

    A controller with fewer states than the layout has room for gets further ones that stay zero.
    """
    count = len(form.feed_forward)
    rows = np.empty((count, size(sizes.gain_table)))
    states = padded_states(form.states, sizes) if sizes.controller_states else None
    for name, columns in slices(sizes.gain_table).items():
        of_states = name.removeprefix("states.")
        if of_states != name:
            values = getattr(states, of_states).ravel()  # the same in all rows
        elif name == "gain":
            values = form.gain.reshape(count, -1)  # a matrix, row by row
        else:
            values = getattr(form, name)
        rows[:, columns] = values
    return rows


def padded_states(states: ControllerStates | None, sizes: BufferLayout) -> ControllerStates:
    """Return the states of a controller and as many more, which stay zero, as a layout has room
    for.

    Args:
        states: The states; None for a controller without.
        sizes: Layout of the buffers.
    """
    k = sizes.controller_states
    padded = ControllerStates(
        a=np.zeros((k, k)),
        b=np.zeros((k, sizes.z)),
        c=np.zeros((sizes.m, k)),
        anti_windup=np.zeros((k, sizes.m)),
        limit=np.full(sizes.m, np.inf),
        initial=np.zeros(k),
    )
    if states is not None:
        count = len(states)
        padded.a[:count, :count] = states.a
        padded.b[:count] = states.b
        padded.c[:, :count] = states.c
        padded.anti_windup[:count] = states.anti_windup
        padded.limit[:] = states.limit
        padded.initial[:count] = states.initial
    return padded


def setpoint_table(sizes: BufferLayout, form: Affine, n: int) -> np.ndarray:
    """Return rows of the state about which a controller acts and of its setpoint of the drives, see
    `BufferLayout.setpoint_table`.

    Args:
        sizes: Layout of the buffers.
        form: Affine form of the controller; beyond the end of its arrays the last row applies.
        n: Number of control instants.

    Returns:
        Rows, shape (as many as may differ, n at most, columns).
    """
    columns = slices(sizes.setpoint_table)
    count = min(n, max(len(form.setpoint), len(form.target)))
    rows = np.empty((count, size(sizes.setpoint_table)))
    for name, values in (("setpoint", form.setpoint), ("position", form.target)):
        rows[: len(values), columns[name]] = values[:count]
        rows[len(values) :, columns[name]] = values[-1]
    return rows


def drop_repeated_rows(rows: np.ndarray) -> np.ndarray:
    """Return a copy of rows without those at the end that repeat the row before."""
    changes = np.flatnonzero((rows[1:] != rows[:-1]).any(axis=1))
    count = int(changes[-1]) + 2 if len(changes) else 1
    return rows[:count].copy()


def without_gains(sizes: BufferLayout, positions: np.ndarray) -> Affine:
    """Return the affine form of a controller that commands zero, with setpoints of the drives,
    shape (rows, m).
    """
    feed_forward = np.zeros((1, sizes.m))
    gain = np.zeros((1, sizes.m, sizes.z))
    setpoint = np.zeros((1, sizes.z))
    return replace(without_integral(feed_forward, gain, setpoint), target=positions)


def command_tables(sizes: BufferLayout) -> tuple[np.ndarray, np.ndarray]:
    """Return a gain table and a setpoint table of one row each, all zero: the feed-forward of the
    gain table then is the command.
    """
    return np.zeros((1, size(sizes.gain_table))), np.zeros((1, size(sizes.setpoint_table)))


def group_lanes(arrays: Sequence[np.ndarray], lanes: int, kind: type = np.float64) -> np.ndarray:
    """Arrange arrays with a row for each crane in groups of lanes.

    The last crane fills the lanes that are left in the last group: they run like the others, and
    their results are dropped.

    Args:
        arrays: Arrays, shape (cranes, m) each.
        lanes: Number of lanes of a group.
        kind: Type of the numbers.

    Returns:
        Numbers of all arrays one after another, shape (groups, sum of all m, lanes).
    """
    group_count = -(-len(arrays[0]) // lanes)
    width = sum(array.shape[1] for array in arrays)
    groups = np.empty((group_count, width, lanes), dtype=kind)
    first = 0
    for array in arrays:
        last = first + array.shape[1]
        for lane in range(lanes):
            rows = array[lane::lanes]
            groups[: len(rows), first:last, lane] = rows
            groups[len(rows) :, first:last, lane] = array[-1]
        first = last
    return groups


def ungroup_lanes(groups: np.ndarray, count: int) -> np.ndarray:
    """Return groups of lanes, shape (groups, m, lanes), as one row for each crane, shape (count,
    m).
    """
    group_count, width, lanes = groups.shape
    return groups.transpose(0, 2, 1).reshape(group_count * lanes, width)[:count]
