"""The log of a run: one row for each control instant, in arrays with names.

An engine appends rows, or fills the arrays itself and says how many rows there are. The log judges
in blocks whether the model holds. After the run it computes the energy ledger and becomes a
trajectory.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.bodies import point_paths
from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.dynamics.validity import Bound, conditions, first_event, hoist_force, valid
from cranedyn.errors import OutOfRange, RunError
from cranedyn.interfaces import State
from cranedyn.simulation.base_energy import RowsOnBase
from cranedyn.simulation.run_spec import RunSpec

BLOCK = 1000
"""Rows that are judged at once. Row by row, the judgement would take longer than the dynamics."""

MEMORY_LIMIT = 4e9
"""Memory that the log of a run and the trajectory made of it may take [byte]."""

_SATURATED = "a drive is commanded beyond its largest rate"
"""Why a row is not valid in which a frequency converter saturates."""

_FLOAT_SIZE = 8
"""Size of a double [byte]."""


class Actuation(NamedTuple):
    """What acts on a crane with m drives from a control instant on.

    Attributes:
        needed_effort: Efforts that the command asks for [N m or N], shape (m,).
        effort: Efforts exerted from the instant on [N m or N], shape (m,).
        effort_before: Efforts exerted until the instant [N m or N], shape (m,).
        force: External forces on the points in the world [N], shape (points, 3); None for none.
        contact_work: Work since the start of the buffers and of the ground [J].
        impact_work: Work since the start of the impacts at which the rope becomes taut [J].
        cable_buffer_force: Force of the buffers at the ends of the cable [N], positive where the
            effort of the hoist is.
        saturated: Whether the command is beyond the largest rate of a converter.
    """

    needed_effort: np.ndarray
    effort: np.ndarray
    effort_before: np.ndarray
    force: np.ndarray | None
    contact_work: float = 0.0
    impact_work: float = 0.0
    cable_buffer_force: float = 0.0
    saturated: bool = False


@dataclass(frozen=True)
class EarlyEnd:
    """Why a run ended before its time.

    Attributes:
        t: Time of the control instant at which it ended [s].
        error: What ended it, a KeyboardInterrupt where the user did.
    """

    t: float
    error: BaseException


@dataclass(frozen=True, eq=False)
class EnergyLedger:
    """Where the energy of the crane comes from and where it goes, over some rows.

    Attributes:
        energy: Mechanical energy with that of springs [J], with zero height at the origin of the
            world, shape (rows,).
        drive_work: Work of each drive since the start [J], shape (rows, m).
        dissipated: Energy dissipated by damping since the start [J], shape (rows,).
    """

    energy: np.ndarray
    drive_work: np.ndarray
    dissipated: np.ndarray


class Log:
    """Rows of a run of a crane with n joints and m drives.

    Every array has one row for each control instant of the whole run from the beginning on. The
    rows from `len(log)` on are not written yet.

    Attributes:
        spec: The run.
        t: Times [s], shape (instants,).
        q: Coordinates [rad or m], shape (instants, n).
        v: Their rates [rad/s or m/s], shape (instants, n).
        setpoint: Positions of the setpoint of the drives [rad or m], shape (instants, m).
        needed_effort: Efforts that the commands ask for [N m or N], shape (instants, m).
        effort: Efforts exerted from the instant on [N m or N], shape (instants, m).
        effort_before: Efforts exerted until the instant [N m or N], shape (instants, m). They
            differ from the row before where the drives follow a motion, whose effort changes
            within a control period.
        force: External forces on the points in the world from the instant on [N], shape
            (instants, 3 points).
        contact_work: Work since the start of the buffers and of the ground [J], shape (instants,).
        impact_work: Work since the start of the impacts at which the rope becomes taut [J], shape
            (instants,).
        cable_buffer_force: Force of the buffers at the ends of the cable [N], positive where the
            effort of the hoist is, shape (instants,).
        saturated: 1 where a command is beyond the largest rate of a converter, shape (instants,).
        valid: 1 where the model holds and the drives can follow, else 0, shape (instants,). NaN
            marks a row that is not judged yet.
        ledger: Energy ledger of all instants, if the engine computes it itself; None otherwise.
        early_end: Why the run ended before its time; None for a run that lasted to its end.
    """

    def __init__(self, spec: RunSpec) -> None:
        """Reserve memory for all rows; the system assigns it as they are written.

        Raises:
            OutOfRange: If the rows would take more than `MEMORY_LIMIT`.
        """
        layout = spec.crane.layout
        instants = spec.instants
        self._columns = layout.columns(rope=spec.rope_may_go_slack, base=spec.base is not None)
        _check_memory(spec, self._columns)
        self.spec = spec
        self.t = spec.t_start + spec.clocks.period * np.arange(instants)
        self.q = np.empty((instants, layout.n))
        self.v = np.empty((instants, layout.n))
        self.setpoint = np.empty((instants, layout.m))
        self.needed_effort = np.empty((instants, layout.m))
        self.effort = np.empty((instants, layout.m))
        self.effort_before = np.empty((instants, layout.m))
        self.force = np.zeros((instants, 3 * len(layout.points)))
        self.contact_work = np.zeros(instants)
        self.impact_work = np.zeros(instants)
        self.cable_buffer_force = np.zeros(instants)
        self.saturated = np.zeros(instants)
        self.valid = np.full(instants, np.nan)
        self.ledger: EnergyLedger | None = None
        self.early_end: EarlyEnd | None = None
        self._has_contacts = spec.has_buffers or spec.ground is not None or spec.rope_may_go_slack
        self._rows = 0
        self._judged_rows = 0
        # A start that is not valid is a mistake of the user, who wants to know at once.
        self._next_judgement = 1

    def __len__(self) -> int:
        """Return the number of rows so far."""
        return self._rows

    def append(self, state: State, setpoint: np.ndarray, actuation: Actuation) -> None:
        """Add the row of the next control instant. Arrays are copied: they may be the caller's.

        Args:
            state: State of the crane.
            setpoint: Positions of the setpoint of the drives [rad or m], shape (m,).
            actuation: What acts on the crane from now on.

        Raises:
            RunError: As `judge`, where this row completes a block.
        """
        row = self._rows
        self.q[row] = state.q
        self.v[row] = state.v
        self.setpoint[row] = setpoint
        self.needed_effort[row] = actuation.needed_effort
        self.effort[row] = actuation.effort
        self.effort_before[row] = actuation.effort_before
        # The other arrays are zero from the beginning on.
        if actuation.force is not None:
            self.force[row] = actuation.force.ravel()
        if self._has_contacts:
            self.contact_work[row] = actuation.contact_work
            self.impact_work[row] = actuation.impact_work
            self.cable_buffer_force[row] = actuation.cable_buffer_force
        if actuation.saturated:
            self.saturated[row] = 1.0
        self.extend_to(row + 1)

    def extend_to(self, rows: int) -> None:
        """Take rows that an engine has written into the arrays itself, up to a number of rows.

        The engine has written the array `valid` as well: 1, 0, or NaN for the log to judge.

        Raises:
            RunError: As `judge`, where these rows complete a block.
        """
        self._rows = rows
        if self._rows >= self._next_judgement:
            self.judge()

    def judge(self) -> None:
        """Judge the rows that are not judged yet. Where the model does not hold, end the log there
        unless such rows are only to be marked.

        A frequency converter that cannot follow its command, or a drive that takes efforts and
        moves too fast, makes a row invalid but does not end a run: the model holds all the same.

        Raises:
            RunError: If the model does not hold at a row, which is then the last of the log.
        """
        new = slice(self._judged_rows, self._rows)
        self._mark(new)
        if self.spec.validity != "mark" and not (self.valid[new] == 1.0).all():
            self._stop_at_first_violation(new)
        self._judged_rows = self._rows
        self._next_judgement = self._rows + BLOCK

    def end_early(self, t: float, error: BaseException) -> None:
        """Note what ended the run at a time [s].

        If the model ceased to hold before, in a row that was not judged yet, that is what ended it.
        A user who interrupts a run wants to keep all rows, so that then none is judged.
        """
        self.early_end = EarlyEnd(t, error)
        if isinstance(error, KeyboardInterrupt):
            return
        try:
            self.judge()
        except RunError as violation:
            self.early_end = EarlyEnd(violation.t, violation)

    def trajectory(
        self, parameters: Mapping[str, float | str], record: Mapping[str, Any]
    ) -> Trajectory:
        """Return the rows so far as a trajectory with its energy ledger.

        Args:
            parameters: Parameters of the run.
            record: Record of the run. The reason why a row is not valid is added to it.
        """
        rows = slice(self._rows)
        self._mark(slice(self._judged_rows, self._rows))
        if not (self.valid[rows] == 1.0).all():
            record = {**record, "not_valid": self._first_invalidity()}
        on_base = None
        if self.spec.base is not None:
            on_base = RowsOnBase(
                self.spec, self.t[rows], self.q[rows], self.v[rows], self.force[rows]
            )
        ledger = self.energy_ledger(on_base) if self.ledger is None else self.ledger
        outside = [self.force_work(on_base), self.contact_work[rows]]
        if self.spec.rope_may_go_slack:
            outside.append(self.impact_work[rows])
        base = None
        if on_base is not None:
            assert self.spec.base is not None
            outside.append(on_base.base_work())
            base = self.spec.base.at(self.t[rows]).position
        return Trajectory(
            t=self.t[rows],
            q=self.q[rows],
            v=self.v[rows],
            setpoint=self.setpoint[rows],
            # Of all kinds of drives: the efforts that their commands ask for, which compare with
            # those exerted.
            command=self.needed_effort[rows],
            effort=self.effort[rows],
            energy=ledger.energy[rows],
            work=ledger.drive_work[rows],
            dissipated=ledger.dissipated[rows],
            force=self.force[rows],
            outside=np.stack(outside, axis=1),
            valid=self.valid[rows],
            phase=self.rope_phase(),
            base=base,
            columns=self._columns,
            parameters=parameters,
            record=record,
        )

    def energy_ledger(self, on_base: RowsOnBase | None) -> EnergyLedger:
        """Return the energy ledger of the rows so far.

        Args:
            on_base: What the rows so far are on a base that moves; None for a base at rest.
        """
        spec = self.spec
        crane = spec.crane
        joint_forces = JointForces.of(crane)
        q = self.q[: self._rows]
        v = self.v[: self._rows]
        effort = self.effort[: self._rows]
        effort_before = self.effort_before[: self._rows]

        if on_base is not None:
            energy = on_base.energy()
        else:
            energy = np.zeros(self._rows)
            for row in range(self._rows):
                energy[row] = pin.computeMechanicalEnergy(crane.model, crane.data, q[row], v[row])
        if crane.springs.any:
            energy += crane.springs.energy(q.T)

        # A prescribed motion takes an effort that changes within a period, so the mean of both
        # ends of the period stands for it. A held effort is its own mean.
        mean_effort = (effort[:-1] + effort_before[1:]) / 2
        driven_coordinates = self._synchronous_coordinates()[:, crane.layout.drives]
        drive_steps = np.diff(driven_coordinates, axis=0)

        power = joint_forces.dissipation(q.T, v.T)
        mean_power = (power[:-1] + power[1:]) / 2

        return EnergyLedger(
            energy=energy,
            drive_work=_sum_from_zero(mean_effort * drive_steps, self._rows),
            dissipated=_sum_from_zero(mean_power * spec.clocks.period, self._rows),
        )

    def force_work(self, on_base: RowsOnBase | None) -> np.ndarray:
        """Return the work of the external forces since the start at each row so far [J].

        Args:
            on_base: What the rows so far are on a base that moves; None for a base at rest.
        """
        force = self.force[: self._rows]
        if not self.spec.has_forces or not force.any():
            return np.zeros(self._rows)
        if on_base is not None:
            return on_base.force_work()
        positions = point_paths(self.spec.crane, self._synchronous_coordinates())
        point_steps = np.diff(positions.reshape(self._rows, -1), axis=0)
        return _sum_from_zero((force[:-1] * point_steps).sum(axis=1), self._rows)

    def rope_phase(self) -> np.ndarray | None:
        """Return the phase of the rope at each row so far, see `Trajectory.phase`; None for a rope
        that cannot go slack.
        """
        if not self.spec.rope_may_go_slack:
            return None
        q = self.q[: self._rows]
        v = self.v[: self._rows]
        phase = JointForces.of(self.spec.crane).phase(q.T, v.T)
        if self.spec.contacts is not None:
            # Contacts take long to import, and few runs have them.
            from cranedyn.dynamics.contact import ground_phases

            phase = ground_phases(self.spec.crane, self.spec.contacts, q, v, phase)
        return phase

    def _synchronous_coordinates(self) -> np.ndarray:
        """Return the coordinates at the times to which the rates belong, shape (rows, n).

        Semi-implicit Euler steps coordinates with the rates at the end of the step, so that they
        run ahead of the rates by half a step. Work is a force times the displacement that belongs
        to the rates, and so needs coordinates without this lead.
        """
        return self.q[: self._rows] - self.spec.position_lead * self.v[: self._rows]

    def _mark(self, rows: slice) -> None:
        """Write whether rows are valid, except those whose validity the engine has written."""
        unmarked = rows.start + np.flatnonzero(np.isnan(self.valid[rows]))
        if len(unmarked) == 0:
            return
        holds = valid(self._validity_conditions(unmarked))
        self.valid[unmarked] = holds & (self.saturated[unmarked] == 0.0)

    def _stop_at_first_violation(self, rows: slice) -> None:
        """Raise an error if a condition that ends a run does not hold, and cut the log there."""
        event = first_event(self.spec.crane, self._stopping_conditions(rows))
        if event is None:
            return
        last = rows.start + event.row
        self._rows = last + 1
        self._judged_rows = last + 1
        t = float(self.t[last])
        hint = ""
        if self.spec.validity == "stop":
            hint = '; validity="mark", or --validity mark, goes on all the same'
        message = f"At t = {t:.4g} s {event.words}{hint}."
        raise RunError(message, t=t, joint=event.joint, value=event.value)

    def _first_invalidity(self) -> str:
        """Return why the first row that is not valid is not."""
        rows = slice(0, self._rows)
        event = first_event(self.spec.crane, self._validity_conditions(rows))
        saturated_rows = np.flatnonzero(self.saturated[rows])
        if event is None:
            return _SATURATED
        if len(saturated_rows) > 0 and saturated_rows[0] < event.row:
            return _SATURATED
        return event.words

    def _validity_conditions(self, rows: slice | np.ndarray) -> list[Bound]:
        """Return the conditions under which the model holds and the drives can follow.

        Drives that take efforts cannot exceed the limits of effort, and frequency converters not
        those of the rates. So each kind is checked for the other limit only, and drives that follow
        a motion for both.
        """
        drive = self.spec.drive
        return self._conditions(
            rows, check_efforts=drive != "effort", check_rates=drive != "velocity"
        )

    def _stopping_conditions(self, rows: slice) -> list[Bound]:
        """Return the conditions without which a run ends.

        The limits of effort and rate end a run only where the drives follow a motion exactly. The
        other kinds saturate, and the model describes that.
        """
        follows_motion = self.spec.drive == "motion"
        return self._conditions(rows, check_efforts=follows_motion, check_rates=follows_motion)

    def _conditions(
        self, rows: slice | np.ndarray, *, check_efforts: bool, check_rates: bool
    ) -> list[Bound]:
        """Return conditions of validity for some rows, given as a slice or by their indices."""
        contacts = self.spec.contacts
        # Height of the ground, below which a load must not be.
        level = 0.0 if contacts is None else contacts.level
        hoist_effort = hoist_force(self.spec.crane, self.effort[rows])
        return conditions(
            self.spec.crane,
            self.q[rows],
            self.v[rows],
            hoist_effort + self.cable_buffer_force[rows],
            buffers=self.spec.has_buffers,
            needed=self.needed_effort[rows] if check_efforts else None,
            rates=check_rates,
            level=level,
        )


def _check_memory(spec: RunSpec, names_of_columns: Mapping[str, Sequence[str]]) -> None:
    """Check that the log of a run and its trajectory fit into `MEMORY_LIMIT`.

    Raises:
        OutOfRange: If they do not.
    """
    columns = sum(len(names) for names in names_of_columns.values())
    # The log holds about as many numbers in a row as the trajectory does.
    row_size = 2 * _FLOAT_SIZE * columns
    size = spec.instants * row_size
    if size <= MEMORY_LIMIT:
        return
    period = spec.clocks.period
    longest = (MEMORY_LIMIT / row_size - 1) * period
    raise OutOfRange(
        "duration",
        f"{spec.clocks.periods * period:g}",
        f"{longest:.3g} s at most: its {spec.instants} rows would take {size / 1e9:.3g} GB of "
        f"{MEMORY_LIMIT / 1e9:g} GB",
        "s",
    )


def _sum_from_zero(increments: np.ndarray, rows: int) -> np.ndarray:
    """Return 0 and the sums of the first 1, 2, ... increments, shape (rows, ...).

    Args:
        increments: From each row to the next, shape (rows - 1, ...); none if there are no rows.
        rows: Number of rows.
    """
    sums = np.zeros((rows, *increments.shape[1:]))
    sums[1:] = np.cumsum(increments, axis=0)
    return sums
