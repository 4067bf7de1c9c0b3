"""Many cranes at once whose loads are attached and released: the stages of
`cranedyn.simulation.stages`, run by the compiled batch.

The cranes run one stage after the other, all lanes together: each on its own clock, from where and
when its stage before ended. A stage is computed for as long as the longest of its lanes takes, and
each lane keeps the rows until its own end. So loads, controllers and times may differ between the
lanes, and a lane is what `cranedyn.simulation.stages.simulate_stages` computes of it alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from cranedyn.clocks import clocks
from cranedyn.compiled.batch import Batch, simulate_batch
from cranedyn.compiled.inputs import start_times
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.contact import Ground
from cranedyn.dynamics.converters import Converters
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.errors import CraneError, OutOfRange, format_error
from cranedyn.interfaces import Drive, Reference, State
from cranedyn.references import hold
from cranedyn.references.tabulated import tabulated
from cranedyn.simulation.log import Log
from cranedyn.simulation.run_record import run_parameters, run_record
from cranedyn.simulation.run_spec import make_run_spec
from cranedyn.simulation.stages import (
    LoadChange,
    LoadStage,
    StagedRun,
    change_load,
    join_stages,
    until_end,
)


@dataclass(frozen=True, eq=False)
class StageBatch:
    """Results of n cranes whose loads change, in k stages each.

    Attributes:
        end: Coordinates and rates at the end, shape (cranes, n) each.
        t_end: Time at which each stage of each crane ended [s], shape (cranes, k).
        changes: The changes of the load of each crane, k - 1 each.
        valid: Whether the model held throughout, shape (cranes,).
    """

    end: State
    t_end: np.ndarray
    changes: tuple[tuple[LoadChange, ...], ...]
    valid: np.ndarray
    _lanes: tuple[tuple[_StageOfLane, ...], ...]

    def __repr__(self) -> str:
        """Return how many cranes and stages there are, and where the model ceased to hold."""
        invalid = int((~self.valid).sum())
        stages = self.t_end.shape[1]
        return (
            f"StageBatch of {len(self)} cranes in {stages} stages, {invalid} not valid throughout"
        )

    def __len__(self) -> int:
        return len(self.t_end)

    def mass(self) -> np.ndarray:
        """Return what was attached in each change, negative for what was released [kg], shape
        (cranes, k - 1).
        """
        return self._of_changes("mass")

    def brought(self) -> np.ndarray:
        """Return the energy that loads brought in each change [J], see `LoadChange`, shape
        (cranes, k - 1).
        """
        return self._of_changes("brought")

    def lost(self) -> np.ndarray:
        """Return the energy that the impact of each change took [J], shape (cranes, k - 1)."""
        return self._of_changes("lost")

    def run(self, crane: int) -> StagedRun:
        """Return the whole run of one crane, as `cranedyn.simulation.stages.simulate_stages` does.

        Raises:
            OutOfRange: If there is no such crane.
        """
        if not 0 <= crane < len(self):
            raise OutOfRange("crane of a batch", crane, f"0 to {len(self) - 1}")
        pieces = tuple(stage.trajectory for stage in self._lanes[crane])
        changes = self.changes[crane]
        return StagedRun(join_stages(pieces, changes), pieces, changes)

    def _of_changes(self, name: str) -> np.ndarray:
        """Return an attribute of all changes, shape (cranes, k - 1)."""
        values = [[getattr(change, name) for change in of_crane] for of_crane in self.changes]
        return np.array(values).reshape(len(self), self.t_end.shape[1] - 1)


@dataclass(frozen=True)
class _RunOptions:
    """What all stages have in common, see `simulate_stage_batch`."""

    dt: float
    control_period: float
    drive: Drive
    converters: Converters | None
    integrator: Integrator


@dataclass(frozen=True, eq=False)
class _StageOfLane:
    """A stage of a crane in a batch.

    Attributes:
        stage: The stage.
        reference: Its reference.
        batch: The batch that computed it.
        row: Row of this crane in that batch.
        rows: Number of its rows until its end, or until it ends at the latest.
        options: Options of the run.
    """

    stage: LoadStage
    reference: Reference
    batch: Batch
    row: int
    rows: int
    options: _RunOptions

    @property
    def last_state(self) -> State:
        """State at the last row."""
        batch = self.batch
        last = self.rows - 1
        return State(batch.q[self.row, last].copy(), batch.v[self.row, last].copy())

    @property
    def last_time(self) -> float:
        """Time of the last row [s]."""
        return float(self.batch.t[self.row, self.rows - 1])

    @property
    def valid(self) -> bool:
        """Whether the model held until there."""
        return bool(self.batch.valid_until[self.row] > self.last_time)

    @cached_property
    def trajectory(self) -> Trajectory:
        """The rows as the trajectory of a run.

        The batch has written what the controller and the crane did. Setpoints, the work of drives
        and damping, phases of the rope and validity follow from that, as in the log of a run.
        """
        options = self.options
        batch = self.batch
        rows = slice(0, self.rows)
        of_crane = self.row, rows
        t = batch.t[of_crane]
        spec = make_run_spec(
            self.stage.crane,
            start=State(batch.q[of_crane][0], batch.v[of_crane][0]),
            t_start=float(t[0]),
            duration=(self.rows - 1) * options.control_period,
            dt=options.dt,
            control_period=options.control_period,
            drive=options.drive if options.converters is None else options.converters,
            integrator=options.integrator,
            validity="mark",
            disturbance=None,
            ground=self.stage.ground,
        )
        log = Log(spec)
        log.q = batch.q[of_crane]
        log.v = batch.v[of_crane]
        log.setpoint = tabulated(self.reference, log.t, spec.crane.layout.m).position
        log.needed_effort = batch.command[of_crane]
        log.effort = batch.effort[of_crane]
        log.effort_before = batch.before[of_crane]
        log.contact_work, log.impact_work = batch.recorded("contact_and_impact_work")[of_crane].T
        log.cable_buffer_force = batch.recorded("cable_buffer_force")[of_crane][:, 0]
        if "saturated" in batch.columns:
            log.saturated = batch.recorded("saturated")[of_crane][:, 0]
        log.extend_to(self.rows)
        record = run_record(spec, self.stage.controller, self.stage.reference)
        return log.trajectory(run_parameters(spec, "compiled"), record)


def simulate_stage_batch(
    stages: Sequence[Sequence[LoadStage]],
    *,
    start: State | Sequence[State] | None = None,
    t_start: float | Sequence[float] = 0.0,
    dt: float = 5e-4,
    control_period: float = 5e-3,
    drive: Drive = "effort",
    converters: Converters | None = None,
    integrator: Integrator = semi_implicit_euler,
    threads: int | None = None,
) -> StageBatch:
    """Run many cranes at once whose loads are attached and released between stages.

    Each crane is what `cranedyn.simulation.stages.simulate_stages` with validity = mark computes of
    it alone: in coordinates and rates up to round-off. A controller or reference that several
    cranes share should be the same object, and so should a ground.

    Args:
        stages: For each crane its stages, as many for each; the controllers are affine in the
            state, see `cranedyn.compiled.batch.simulate_batch`.
        start: State at the start of all cranes, or of each; None for where each crane starts.
        t_start: Time at the start of all cranes, or of each [s].
        dt: Physics step [s].
        control_period: Time between control instants [s]; stages last multiples of it.
        drive: What the controllers command, see `cranedyn.simulation.simulate.simulate`.
        converters: Frequency converters of all cranes for the drive "velocity"; None for those
            typical for the first crane.
        integrator: The stepping rule.
        threads: Number of threads; by default one for each processor.

    Raises:
        OutOfRange: If there is no crane or no stage, cranes have different numbers of stages, or as
            `simulate_batch`.
        CraneError: As `simulate_batch`, or if a stage of a crane never may end; the message names
            the crane.
    """
    lanes = [list(of_lane) for of_lane in stages]
    count = _stage_count(lanes)
    options = _RunOptions(dt, control_period, drive, converters, integrator)
    states = _start_states(start, [of_lane[0] for of_lane in lanes])
    times = start_times(t_start, len(lanes)).copy()
    t_end = np.zeros((len(lanes), count))
    changes: list[list[LoadChange]] = [[] for _ in lanes]
    computed: list[list[_StageOfLane]] = [[] for _ in lanes]
    valid = np.ones(len(lanes), dtype=bool)
    for k in range(count):
        of_stage = [of_lane[k] for of_lane in lanes]
        if k > 0:
            for i, state in enumerate(states):
                before = lanes[i][k - 1].crane
                change = change_load(before, of_stage[i].crane, state, prescribed=drive != "effort")
                changes[i].append(change)
                states[i] = change.state
        for i, longest in enumerate(_stage_of_lanes(of_stage, states, times, options, threads)):
            ended = replace(longest, rows=_rows_until_end(longest, k, i))
            computed[i].append(ended)
            states[i] = ended.last_state
            times[i] = ended.last_time
            t_end[i, k] = times[i]
            valid[i] &= ended.valid
    return StageBatch(
        end=State(np.array([state.q for state in states]), np.array([state.v for state in states])),
        t_end=t_end,
        changes=tuple(tuple(of_lane) for of_lane in changes),
        valid=valid,
        _lanes=tuple(tuple(of_lane) for of_lane in computed),
    )


def _stage_count(lanes: Sequence[Sequence[LoadStage]]) -> int:
    """Return the number of stages that all cranes have.

    Raises:
        OutOfRange: If there is none, or they have different numbers.
    """
    if not lanes or not lanes[0]:
        raise OutOfRange("stages", "none", "one or more for one crane or more")
    count = len(lanes[0])
    for i, of_lane in enumerate(lanes):
        if len(of_lane) != count:
            allowed = f"{count}, as many as of crane 0"
            raise OutOfRange(f"number of stages of crane {i}", len(of_lane), allowed)
    return count


def _start_states(start: State | Sequence[State] | None, first: Sequence[LoadStage]) -> list[State]:
    """Return the state of each crane at the start, whose first stages are given.

    Raises:
        OutOfRange: If there is not one for all, or one for each.
    """
    if start is None:
        return [stage.crane.start for stage in first]
    if isinstance(start, State):
        if np.ndim(start.q) == 1:
            return [start] * len(first)
        start = [State(q, v) for q, v in zip(*start, strict=True)]
    if len(start) != len(first):
        raise OutOfRange("number of starts", len(start), f"{len(first)}, one for each crane")
    return list(start)


def _stage_of_lanes(
    stages: Sequence[LoadStage],
    states: Sequence[State],
    times: np.ndarray,
    options: _RunOptions,
    threads: int | None,
) -> list[_StageOfLane]:
    """Compute one stage of all cranes, from a state and a time of each.

    All cranes without a ground run together. A batch has one ground, as stiff as for its first
    crane, so that cranes with a ground run together where they are the same crane on the same
    ground.
    """
    groups: dict[Any, list[int]] = {}
    for i, stage in enumerate(stages):
        key = None if stage.ground is None else (id(stage.ground), id(stage.crane))
        groups.setdefault(key, []).append(i)
    found: dict[int, _StageOfLane] = {}
    for members in groups.values():
        of_group = [stages[i] for i in members]
        periods = [
            clocks(stage.duration, options.dt, options.control_period).periods for stage in of_group
        ]
        references = _references(of_group, [states[i] for i in members])
        ground: Ground | None = of_group[0].ground
        batch = simulate_batch(
            [stage.crane for stage in of_group],
            [stage.controller for stage in of_group],
            references,
            start=[states[i] for i in members],
            t_start=times[members].tolist(),
            duration=max(stage.duration for stage in of_group),
            dt=options.dt,
            control_period=options.control_period,
            drive=options.drive,
            integrator=options.integrator,
            converters=options.converters,
            ground=ground,
            record=1,
            threads=threads,
        )
        for row, (i, stage) in enumerate(zip(members, of_group, strict=True)):
            found[i] = _StageOfLane(stage, references[row], batch, row, periods[row] + 1, options)
    return [found[i] for i in range(len(stages))]


def _references(stages: Sequence[LoadStage], states: Sequence[State]) -> list[Reference]:
    """Return the reference of each stage; one that has none holds its drives where they are."""
    references: list[Reference] = []
    for stage, state in zip(stages, states, strict=True):
        given = stage.reference
        references.append(hold(stage.crane, state) if given is None else given)
    return references


def _rows_until_end(of_lane: _StageOfLane, index: int, crane: int) -> int:
    """Return the number of rows of a stage until it ends.

    Args:
        of_lane: The stage of a crane.
        index: Index of the stage.
        crane: Index of the crane.

    Raises:
        CraneError: If it never may end, with the crane.
    """
    if of_lane.stage.ends_when is None:
        return of_lane.rows
    try:
        return len(until_end(of_lane.trajectory, of_lane.stage, index))
    except CraneError as error:
        raise CraneError(f"Crane {crane} of the batch: {format_error(error)}") from error
