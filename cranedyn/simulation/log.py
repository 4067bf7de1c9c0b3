"""The log of a run, row by row while it goes, and the trajectory with its energy ledger that it
becomes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from inspect import unwrap
from typing import Any

import numpy as np

from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.pinocchio import point_positions
from cranedyn.dynamics.validity import Event, first_event, hoisting, valid
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane

# Arrays of the log are what they should be.
_first_event, _hoisting, _valid = unwrap(first_event), unwrap(hoisting), unwrap(valid)

_TOGETHER = 256
"""Rows that are kept in one piece each until they are written together."""

_LARGEST = 4e9
"""Memory that the log of a run and the trajectory made of it may take [byte]."""

Energies = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""From coordinates and rates in rows, shape (rows, n) each, to mechanical energies [J], shape
(rows,)."""


class Log:
    """Rows at the control instants."""

    def __init__(self, crane: Crane, since: float, period: float, rows: int, lead: float) -> None:
        """Make room for all rows.

        Args:
            crane: The crane.
            since: Time of the first row [s].
            period: Time between rows [s].
            rows: How many there will be at most.
            lead: By how much the positions run ahead of the velocities [s].

        Raises:
            OutOfRange: If they would take more than 4 GB.
        """
        each = 2 * 8 * sum(map(len, crane.layout.columns().values()))
        if rows * each > _LARGEST:
            most = f"{(_LARGEST / each - 1) * period:.3g} s at most"
            takes = (
                f"its {rows} rows would take {rows * each / 1e9:.3g} GB of {_LARGEST / 1e9:g} GB"
            )
            raise OutOfRange("duration", f"{(rows - 1) * period:g}", f"{most}: {takes}", "s")
        self._crane, self._since, self._period, self._lead = crane, since, period, lead
        self._rows, self._looked = 0, 0
        self._fresh = list[bytes]()
        self._q, self._v = np.empty((rows, crane.layout.n)), np.empty((rows, crane.layout.n))
        self._setpoint, self._command, self._effort, self._before = (
            np.empty((rows, crane.layout.m)) for _ in range(4)
        )
        self._force, self._buffer_work, self._stop_force = (
            np.zeros((rows, 3 * len(crane.points))),
            np.zeros(rows),
            np.zeros(rows),
        )
        self._energy, self._valid = np.full(rows, np.nan), np.full(rows, np.nan)
        self._cut = np.zeros(rows, dtype=bool)

    def __len__(self) -> int:
        """Number of rows so far."""
        return self._rows + len(self._fresh)

    def row(
        self,
        state: State,
        setpoint: np.ndarray,
        command: np.ndarray,
        effort: np.ndarray,
        before: np.ndarray,
    ) -> None:
        """Add a row: effort is what acts from here on, before what acted until here; contiguous
        arrays of doubles.
        """
        row: Any = (*state, setpoint, command, effort, before)
        self._fresh.append(b"".join(row))
        if len(self._fresh) == _TOGETHER:
            self._write()

    def _write(self) -> None:
        """Put fresh rows where they belong; many together take less time than one by one."""
        rows = slice(self._rows, len(self))
        columns = self._q, self._v, self._setpoint, self._command, self._effort, self._before
        ends = np.cumsum([column.shape[1] for column in columns])
        fresh = np.frombuffer(b"".join(self._fresh)).reshape(-1, ends[-1])
        for column, part in zip(columns, np.split(fresh, ends[:-1], axis=1), strict=True):
            column[rows] = part
        self._rows = rows.stop
        self._fresh.clear()

    def force(self, force: np.ndarray) -> None:
        """Add the forces from outside to the row that comes next, shape (points, 3)."""
        self._force[len(self)] = force.ravel()

    def buffers(self, work: float, stop_force: float) -> None:
        """Add to the row that comes next what the buffers did [J], and what those at the ends of
        the cable push [N].
        """
        self._buffer_work[len(self)], self._stop_force[len(self)] = work, stop_force

    def cut(self, cut: bool) -> None:
        """Say of the row that comes next whether a converter was told more than it follows."""
        self._cut[len(self)] = cut

    def block(self, setpoint: np.ndarray, block: Mapping[str, np.ndarray], holds: bool) -> None:
        """Add many rows at once.

        Args:
            setpoint: Setpoint of the drives, shape (rows, m).
            block: q, v, command, effort, before as for `row`; energy, buffers, stop_force, and of
                converters cut, in columns, shape (rows, 1).
            holds: Whether the model is known to hold at all of them, and drives can.
        """
        rows = slice(self._rows, self._rows + len(setpoint))
        self._q[rows], self._v[rows], self._setpoint[rows] = block["q"], block["v"], setpoint
        self._command[rows], self._effort[rows], self._before[rows] = (
            block["command"],
            block["effort"],
            block["before"],
        )
        self._energy[rows], self._buffer_work[rows], self._stop_force[rows] = (
            block[name][:, 0] for name in ("energy", "buffers", "stop_force")
        )
        if "cut" in block:
            self._cut[rows] = block["cut"][:, 0] == 1.0
        if holds:
            self._valid[rows] = 1.0
        self._rows = rows.stop

    def event(self, drive: str, *, buffers: bool) -> Event | None:
        """Where the model ceases to hold among the rows not looked at before, which are looked at
        then; None if it holds at all of them. That frequency converters cannot follow, or that a
        drive which takes efforts is too fast, is no event.
        """
        self._write()
        rows = slice(self._looked, self._rows)
        if not (self._valid[rows] == 1.0).all():
            q, v, hoist = self._q[rows], self._v[rows], self._hoist(rows)
            needed = self._command[rows] if drive == "motion" else None
            if event := _first_event(
                self._crane, q, v, hoist, buffers=buffers, needed=needed, rates=drive == "motion"
            ):
                return event
            if drive == "motion":
                self._valid[rows] = 1.0
        self._looked = rows.stop
        return None

    def _hoist(self, rows: slice | np.ndarray) -> np.ndarray:
        """What holds the load at some rows [N]."""
        return _hoisting(self._crane, self._effort[rows]) + self._stop_force[rows]

    def keep(self, fresh_row: int) -> float:
        """Drop what comes behind a row, counted from the first not looked at; returns its time
        [s].
        """
        self._rows = self._looked + fresh_row + 1
        return self._since + self._period * (self._rows - 1)

    def trajectory(
        self,
        parameters: dict[str, float | str],
        record: Mapping[str, Any],
        energies: Energies,
        *,
        buffers: bool,
        drive: str = "effort",
    ) -> Trajectory:
        """The log as arrays, with its energy ledger.

        Valid are rows in which the model holds and drives that follow a motion or a rate can.

        Work is a force times the displacement that belongs to the velocities, so the lead of the
        positions is taken off. Where motion is prescribed the mean of the efforts at both ends of a
        period stands for them. Dissipation is integrated by the trapezoidal rule.
        """
        self._write()
        n, crane, period = self._rows, self._crane, self._period
        q, v, effort, force = self._q[:n], self._v[:n], self._effort[:n], self._force[:n]
        middle = q - self._lead * v
        work = np.zeros((n, crane.layout.m))
        np.cumsum(
            (effort[:-1] + self._before[1:n]) / 2 * np.diff(middle[:, crane.layout.drives], axis=0),
            axis=0,
            out=work[1:],
        )
        valid = self._judged(drive, buffers=buffers)
        if (valid != 1.0).any():
            record = {**record, "not_valid": self._reason(drive, buffers=buffers)}
        power = v**2 @ crane.damping
        dissipated = np.zeros(n)
        np.cumsum((power[:-1] + power[1:]) / 2 * period, out=dissipated[1:])
        return Trajectory(
            t=self._since + period * np.arange(n),
            q=q,
            v=v,
            setpoint=self._setpoint[:n],
            command=self._command[:n],
            effort=effort,
            energy=self._filled(energies),
            work=work,
            dissipated=dissipated,
            force=force,
            outside=np.stack([self._work_of_forces(middle, force), self._buffer_work[:n]], axis=1),
            valid=valid,
            columns=crane.layout.columns(),
            parameters=parameters,
            record=record,
        )

    def _filled(self, energies: Energies) -> np.ndarray:
        """Mechanical energy of each row [J], computed where it was not logged."""
        energy = self._energy[: self._rows].copy()
        missing = np.isnan(energy)
        if missing.any():
            energy[missing] = energies(
                self._q[: self._rows][missing], self._v[: self._rows][missing]
            )
        return energy

    def _judged(self, drive: str, *, buffers: bool) -> np.ndarray:
        """Whether the model holds at each row, and drives can, found out where nobody has."""
        known = self._valid[: self._rows].copy()
        missing = np.flatnonzero(np.isnan(known))
        if len(missing):
            holds = _valid(
                self._crane,
                self._q[missing],
                self._v[missing],
                self._hoist(missing),
                buffers=buffers,
                needed=None if drive == "effort" else self._command[missing],
                rates=drive != "velocity",
            )
            known[missing] = holds & ~self._cut[missing]
        return known

    def _reason(self, drive: str, *, buffers: bool) -> str:
        """Return why the first row that is not valid is not."""
        rows = slice(self._rows)
        event = _first_event(
            self._crane,
            self._q[rows],
            self._v[rows],
            self._hoist(rows),
            buffers=buffers,
            needed=None if drive == "effort" else self._command[rows],
            rates=drive != "velocity",
        )
        cut = np.flatnonzero(self._cut[rows])
        if event is None or (len(cut) and cut[0] < event.row):
            return "a drive is commanded beyond its largest rate"
        return event.words

    def _work_of_forces(self, middle: np.ndarray, force: np.ndarray) -> np.ndarray:
        work = np.zeros(len(force))
        if force.any():
            places = np.array([point_positions(self._crane, q) for q in middle])
            np.cumsum(
                (force[:-1] * np.diff(places.reshape(len(middle), -1), axis=0)).sum(axis=1),
                out=work[1:],
            )
        return work
