"""Log of a run: one row at each control instant, which become the trajectory with its energy
ledger.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from itertools import accumulate
from typing import Any

import numpy as np

from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.bodies import point_paths
from cranedyn.dynamics.contact import ground_phases
from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.dynamics.validity import Bound, conditions, first_event, hoisting, valid
from cranedyn.errors import OutOfRange, RunError
from cranedyn.interfaces import Validity
from cranedyn.simulation.engine import Setting

_CHUNK = 1000
"""Rows that are collected as bytes, then written and checked at once, which is faster than one by
one."""

_MEMORY = 4e9
"""Memory that the log of a run and the trajectory made of it may take [byte]."""

Energies = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""From coordinates and rates, shape (rows, n) each, to mechanical energies [J], shape (rows,)."""


class Log:
    """Rows at the control instants, checked for the validity of the model as they are written.

    Attributes:
        t: Times of the rows [s].
        rows: The rows, see `row_sections`.
    """

    def __init__(self, setting: Setting, validity: Validity, t_start: float, rows: int) -> None:
        """Reserve memory for all rows.

        Args:
            setting: Settings of the run.
            validity: With "mark" the run goes on where the model ceases to hold.
            t_start: Time of the first row [s].
            rows: Largest number of rows.

        Raises:
            OutOfRange: If the rows would take more than 4 GB.
        """
        crane = setting.crane
        period = setting.clocks.period
        self._names = crane.layout.columns(rope=crane.springs.rope is not None)
        row_size = 2 * 8 * sum(map(len, self._names.values()))
        if rows * row_size > _MEMORY:
            most = f"{(_MEMORY / row_size - 1) * period:.3g} s at most"
            size = f"{rows * row_size / 1e9:.3g} GB of {_MEMORY / 1e9:g} GB"
            allowed = f"{most}: its {rows} rows would take {size}"
            raise OutOfRange("duration", f"{(rows - 1) * period:g}", allowed, "s")
        self._setting = setting
        self._crane = crane
        self._validity = validity
        sections = row_sections(crane.layout.n, crane.layout.m, len(crane.points))
        ends = dict(zip(sections, accumulate(sections.values()), strict=True))
        self.t = t_start + period * np.arange(rows)
        self.rows = np.empty((rows, ends["valid"]))
        self._columns = {
            name: self.rows[:, ends[name] - width : ends[name]] for name, width in sections.items()
        }
        self._valid = self._columns["valid"][:, 0]
        self._ahead = 0
        self._written = 0
        self._checked = 0
        self._pending = list[bytes]()
        # the first row is checked at once
        self._most_pending = 1
        self._holds = True

    def __len__(self) -> int:
        """Return the number of rows so far."""
        return self._written + len(self._pending)

    def append(self, row: bytes) -> None:
        """Add a row, see `cranedyn.simulation.engine.Engine.row`.

        Raises:
            RunError: As `check`.
        """
        self._pending.append(row)
        if len(self._pending) >= self._most_pending:
            self._most_pending = _CHUNK
            self.check()

    def extend_to(self, rows: int, *, holds: bool) -> float:
        """Take the first rows, which an engine has written as a whole, and return the time of the
        last [s]; where the model does not hold at all of them they are checked.

        Raises:
            RunError: As `check`.
        """
        self._ahead = self._written = rows
        if holds:
            self._checked = rows
        self.check()
        return float(self.t[rows - 1])

    def check(self) -> None:
        """Judge the rows that are not judged yet, and check that the model holds unless rows are
        only to be marked.

        A frequency converter that cannot follow, or a drive that takes efforts and moves too fast,
        makes a row invalid but does not stop a run.

        Raises:
            RunError: If the model does not hold at one of them, which is then the last of the log.
        """
        rows, self._holds = self._judge()
        if self._validity != "mark" and not self._holds:
            motion = self._setting.drive == "motion"
            state_bounds = self._conditions(rows, needed=motion, rates=motion)
            if event := first_event(self._crane, state_bounds):
                last = rows.start + event.row
                self._written = last + 1
                t = float(self.t[last])
                hint = "; validity = mark goes on all the same" * (self._validity == "stop")
                message = f"At t = {t:.4g} s {event.words}{hint}."
                raise RunError(message, t=t, joint=event.joint, value=event.value)
        self._checked = rows.stop

    def _judge(self) -> tuple[slice, bool]:
        """Set the validity of the rows that are not checked yet, 1 where the model holds and the
        drives can follow, else 0; return these rows, and whether it holds in all rows so far.
        """
        if self._pending:
            rows = slice(self._written, len(self))
            pending = np.frombuffer(b"".join(self._pending)).reshape(len(self._pending), -1)
            self._valid[rows] = np.nan
            self.rows[rows, : pending.shape[1]] = pending
            self._written = rows.stop
            if pending.shape[1] == self.rows.shape[1]:
                self._ahead = rows.stop
            self._pending.clear()
        rows = slice(self._checked, self._written)
        if (self._valid[rows] == 1.0).all():
            return rows, self._holds
        missing = rows.start + np.flatnonzero(np.isnan(self._valid[rows]))
        holds = valid(self._all_conditions(missing))
        self._valid[missing] = holds & (self._columns["saturated"][missing, 0] == 0.0)
        return rows, self._holds and bool((self._valid[rows] == 1.0).all())

    def _conditions(self, rows: slice | np.ndarray, *, needed: bool, rates: bool) -> list[Bound]:
        """Return the conditions under which the model holds in some rows."""
        column = {name: values[rows] for name, values in self._columns.items()}
        contacts, buffers = self._setting.contacts, self._setting.buffers
        options: Any = {"buffers": buffers, "needed": column["needed"] if needed else None}
        options |= {"rates": rates, "level": 0.0 if contacts is None else contacts.level}
        hoist = hoisting(self._crane, column["effort"]) + column["outside"][:, 3]
        return conditions(self._crane, column["q"], column["v"], hoist, **options)

    def trajectory(
        self, energies: Energies, parameters: dict[str, float | str], record: Mapping[str, Any]
    ) -> Trajectory:
        """Return the log as a trajectory with its energy ledger.

        Work is a force times the displacement that belongs to the velocities, so the lead of the
        positions is taken off. Where motion is prescribed, the mean of the efforts at both ends of
        a period stands for the effort. Dissipation is integrated by the trapezoidal rule.

        Args:
            energies: Returns the mechanical energies of rows.
            parameters: Parameters of the run.
            record: Record of the run; the reason why rows are not valid is added.
        """
        holds = self._judge()[1]
        rows = self._written
        crane = self._crane
        if self._ahead < rows:
            self._balance(slice(self._ahead, rows), energies)
        column = {name: values[:rows] for name, values in self._columns.items()}
        q, v, force, outside = (column[name] for name in ("q", "v", "force", "outside"))
        if self._setting.forces and force.any():
            middle = q - self._setting.lead * v
            positions = point_paths(crane, middle).reshape(rows, -1)
            work = (force[:-1] * np.diff(positions, axis=0)).sum(axis=1)
            outside[:, 0] = np.concatenate([[0.0], np.cumsum(work)])
        rope = crane.springs.rope is not None
        phase = None
        if rope:
            phase = JointForces.of(crane).phase(q.T, v.T)
            if (contacts := self._setting.contacts) is not None:
                phase = ground_phases(crane, contacts, q, v, phase)
        if not holds:
            record = {**record, "not_valid": self._reason()}
        return Trajectory(
            t=self.t[:rows],
            command=column["needed"],
            **{name: column[name] for name in ("q", "v", "setpoint", "effort", "work", "force")},
            **{name: column[name][:, 0] for name in ("energy", "dissipated")},
            outside=outside[:, : 3 if rope else 2],
            valid=self._valid[:rows],
            phase=phase,
            columns=self._names,
            parameters=parameters,
            record=record,
        )

    def _balance(self, rows: slice, energies: Energies) -> None:
        """Write energy, work and dissipation into rows, after those of the row before."""
        column = {name: values[rows] for name, values in self._columns.items()}
        column["energy"][:, 0] = energies(column["q"], column["v"])
        rows = slice(max(rows.start - 1, 0), rows.stop)
        column = {name: values[rows] for name, values in self._columns.items()}
        q, v, effort = column["q"], column["v"], column["effort"]
        middle = (q - self._setting.lead * v)[:, self._crane.layout.drives]
        mean_effort = (effort[:-1] + column["effort_before"][1:]) / 2
        power = JointForces.of(self._crane).dissipation(q.T, v.T)[:, None]
        steps = {
            "work": mean_effort * np.diff(middle, axis=0),
            "dissipated": (power[:-1] + power[1:]) / 2 * self._setting.clocks.period,
        }
        for name, increments in steps.items():
            first = column[name][:1] if self._ahead else np.zeros((1, increments.shape[1]))
            column[name][:] = np.cumsum(np.concatenate([first, increments]), axis=0)

    def _reason(self) -> str:
        """Return why the first row that is not valid is not."""
        rows = slice(self._written)
        event = first_event(self._crane, self._all_conditions(rows))
        saturated = np.flatnonzero(self._columns["saturated"][rows, 0])
        if event is None or (len(saturated) and saturated[0] < event.row):
            return "a drive is commanded beyond its largest rate"
        return event.words

    def _all_conditions(self, rows: slice | np.ndarray) -> list[Bound]:
        drive = self._setting.drive
        return self._conditions(rows, needed=drive != "effort", rates=drive != "velocity")


@cache
def row_sections(n: int, m: int, points: int) -> dict[str, int]:
    """Return the width of each part of a row, in the order of memory, for numbers of joints, drives
    and points of a crane: those of `Engine.row`, then the energy ledger and validity.
    """
    appended = {"setpoint": m, "q": n, "v": n, "needed": m, "effort": m, "effort_before": m}
    appended |= {"force": 3 * points, "outside": 4, "saturated": 1}
    return appended | {"energy": 1, "work": m, "dissipated": 1, "valid": 1}
