"""Log of a run: one row at each control instant, which become the trajectory with its energy
ledger.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.bodies import point_paths
from cranedyn.dynamics.contact import ground_phases
from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.dynamics.validity import Bound, conditions, first_event, hoisting, valid
from cranedyn.errors import OutOfRange, RunError
from cranedyn.interfaces import Setpoint, State, Validity
from cranedyn.simulation.engine import Actuation, Setting

_CHUNK = 1000
"""Rows that are collected as bytes, then written and checked at once, which is faster than one by
one."""

_MEMORY = 4e9
"""Memory that the log of a run and the trajectory made of it may take [byte]."""

Energies = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""From coordinates and rates, shape (rows, n) each, to mechanical energies [J], shape (rows,)."""


class Log:
    """Rows at the control instants, checked for the validity of the model as they are written.

    The columns are coordinates q, rates v, positions of the setpoint, and those of `Actuation`.
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
        crane, period = setting.crane, setting.clocks.period
        self._names = crane.layout.columns(rope=crane.springs.rope is not None)
        row_size = 2 * 8 * sum(map(len, self._names.values()))
        if rows * row_size > _MEMORY:
            most = f"{(_MEMORY / row_size - 1) * period:.3g} s at most"
            size = (
                f"its {rows} rows would take {rows * row_size / 1e9:.3g} GB of {_MEMORY / 1e9:g} GB"
            )
            raise OutOfRange("duration", f"{(rows - 1) * period:g}", f"{most}: {size}", "s")
        self._setting, self._crane, self._t_start = setting, crane, t_start
        self._validity = validity
        n, m, points = crane.layout.n, crane.layout.m, len(crane.points)
        widths = {"q": n, "v": n, "setpoint": m, "needed": m, "effort": m, "effort_before": m}
        widths |= {"force": 3 * points, "contacts": 3, "saturated": 1}
        self._columns = {name: np.empty((rows, width)) for name, width in widths.items()}
        self._energy, self._valid = np.full(rows, np.nan), np.full(rows, np.nan)
        self._written, self._checked, self._pending = 0, 0, list[bytes]()
        self._most_pending = 1  # the first row is checked at once

    def __len__(self) -> int:
        """Return the number of rows so far."""
        return self._written + len(self._pending)

    def append(self, state: State, setpoint: Setpoint, actuation: Actuation) -> None:
        """Add a row.

        Raises:
            RunError: As `check`.
        """
        row: Any = (*state, np.ascontiguousarray(setpoint.position, dtype=float), *actuation)
        pending = self._pending
        pending.append(b"".join(row))
        if len(pending) >= self._most_pending:
            self._most_pending = _CHUNK
            self.check()

    def _write(self) -> None:
        """Write the pending rows into the columns."""
        rows = slice(self._written, len(self))
        ends = np.cumsum([column.shape[1] for column in self._columns.values()])
        pending = np.frombuffer(b"".join(self._pending)).reshape(-1, ends[-1])
        blocks = np.split(pending, ends[:-1], axis=1)
        for column, block in zip(self._columns.values(), blocks, strict=True):
            column[rows] = block
        self._written = rows.stop
        self._pending.clear()

    def extend(self, columns: Mapping[str, np.ndarray], energy: np.ndarray, *, valid: bool) -> None:
        """Add many rows at once.

        Args:
            columns: The columns of the log by name, shape (rows, width) each; those that are
                missing are zero.
            energy: Mechanical energies [J], shape (rows,).
            valid: Whether the model is known to hold at all of them, and the drives can follow.

        Raises:
            RunError: As `check`.
        """
        rows = slice(self._written, self._written + len(energy))
        for name, column in self._columns.items():
            column[rows] = columns.get(name, 0.0)
        self._energy[rows] = energy
        if valid:
            self._valid[rows] = 1.0
        self._written = rows.stop
        self.check()

    def check(self) -> None:
        """Judge the rows that are not judged yet, and check that the model holds unless rows are
        only to be marked.

        A frequency converter that cannot follow, or a drive that takes efforts and moves too fast,
        makes a row invalid but does not stop a run.

        Raises:
            RunError: If the model does not hold at one of them, which is then the last of the log.
        """
        rows = self._judge()
        if self._validity != "mark" and not (self._valid[rows] == 1.0).all():
            motion = self._setting.drive == "motion"
            state_bounds = self._conditions(rows, needed=motion, rates=motion)
            if event := first_event(self._crane, state_bounds):
                last = rows.start + event.row
                self._written, t = last + 1, self._t_start + self._setting.clocks.period * last
                hint = "; validity = mark goes on all the same" * (self._validity == "stop")
                message = f"At t = {t:.4g} s {event.words}{hint}."
                raise RunError(message, t=t, joint=event.joint, value=event.value)
        self._checked = rows.stop

    def _judge(self) -> slice:
        """Set the validity of the rows that are not checked yet, and return these rows: 1 where the
        model holds and the drives can follow, else 0.
        """
        self._write()
        rows = slice(self._checked, self._written)
        missing = rows.start + np.flatnonzero(np.isnan(self._valid[rows]))
        if len(missing):
            holds = valid(self._all_conditions(missing))
            self._valid[missing] = holds & (self._columns["saturated"][missing, 0] == 0.0)
        return rows

    def _conditions(self, rows: slice | np.ndarray, *, needed: bool, rates: bool) -> list[Bound]:
        """Return the conditions under which the model holds in some rows."""
        column = {name: values[rows] for name, values in self._columns.items()}
        contacts = self._setting.contacts
        return conditions(
            self._crane,
            column["q"],
            column["v"],
            hoisting(self._crane, column["effort"]) + column["contacts"][:, 2],
            buffers=self._setting.buffers,
            needed=column["needed"] if needed else None,
            rates=rates,
            level=0.0 if contacts is None else contacts.level,
        )

    def trajectory(
        self,
        energies: Energies,
        parameters: dict[str, float | str],
        record: Mapping[str, Any],
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
        self._judge()
        rows, crane = self._written, self._crane
        column = {name: values[:rows] for name, values in self._columns.items()}
        q, v, effort, force = (column[name] for name in ("q", "v", "effort", "force"))
        middle = q - self._setting.lead * v
        mean_effort = (effort[:-1] + column["effort_before"][1:]) / 2
        work = _cumulated(mean_effort * np.diff(middle[:, crane.layout.drives], axis=0), rows)
        joint, rope = JointForces.of(crane), crane.springs.rope is not None
        phase, contacts = joint.phase(q.T, v.T) if rope else None, self._setting.contacts
        if phase is not None and contacts is not None:
            phase = ground_phases(crane, contacts, q, v, phase)
        power = joint.dissipation(q.T, v.T)
        valid = self._valid[:rows]
        if (valid != 1.0).any():
            record = {**record, "not_valid": self._reason()}
        return Trajectory(
            t=self._t_start + self._setting.clocks.period * np.arange(rows),
            q=q,
            v=v,
            setpoint=column["setpoint"],
            command=column["needed"],
            effort=effort,
            energy=self._energies(energies),
            work=work,
            dissipated=_cumulated((power[:-1] + power[1:]) / 2 * self._setting.clocks.period, rows),
            force=force,
            outside=np.column_stack(
                [self._work_of_forces(middle, force), column["contacts"][:, : 2 if rope else 1]]
            ),
            valid=valid,
            phase=phase,
            columns=self._names,
            parameters=parameters,
            record=record,
        )

    def _energies(self, energies: Energies) -> np.ndarray:
        """Return the mechanical energy of each row [J], computed where it was not logged."""
        energy = self._energy[: self._written].copy()
        missing = np.flatnonzero(np.isnan(energy))
        if len(missing):
            energy[missing] = energies(self._columns["q"][missing], self._columns["v"][missing])
        return energy

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

    def _work_of_forces(self, middle: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Return the work of the external forces up to each row [J], shape (rows,)."""
        if not force.any():
            return np.zeros(len(force))
        positions = point_paths(self._crane, middle).reshape(len(middle), -1)
        return _cumulated((force[:-1] * np.diff(positions, axis=0)).sum(axis=1), len(force))


def _cumulated(steps: np.ndarray, rows: int) -> np.ndarray:
    """Return the sum of the steps before each row, shape (rows, ...)."""
    return np.concatenate([np.zeros((1, *steps.shape[1:])), np.cumsum(steps, axis=0)])[:rows]
