"""Simulation of many cranes at once, one in each lane of the processor's vectors.

A *group* is the cranes that run together: 8 in the lanes of the vectors of a processor, 16 in
single precision, or 32 threads of a GPU. Arrays of the loop have the group as first axis and the
lane as last.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from cranedyn.checks import check_choice, read_only, whole, within, worker_count
from cranedyn.clocks import Clocks, clocks
from cranedyn.compiled import cuda, inputs
from cranedyn.compiled.binding import BoundKernel
from cranedyn.compiled.horizon.receding import Receding
from cranedyn.compiled.kernel import LANES, Kernel, KernelOptions, Precision, check_precision
from cranedyn.compiled.loop_tables import group_lanes, ungroup_lanes
from cranedyn.compiled.memory_layout import BufferLayout, size, slices
from cranedyn.compiled.plant.cranes import Cranes
from cranedyn.compiled.plant.plant import Topology
from cranedyn.compiled.step import check_rule
from cranedyn.compiled.threads import WARP
from cranedyn.compiled.verify import compile_kernel
from cranedyn.disturbances.base_motion import BaseMotion
from cranedyn.dynamics.contact import Contacts, Ground, anchors_at
from cranedyn.dynamics.converters import Converters
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import Controller, Drive, Reference, State
from cranedyn.model.crane import Crane

_CHUNKS_PER_THREAD = 8
"""Chunks of groups for each thread, so that threads end at about the same time."""

_ROUNDING = 1e-6
"""Rounding error of a number of control periods: a time this little after an instant is at it."""

Device = Literal["cpu", "cuda"]
"""Where a batch runs."""


def _recorded(name: str) -> cached_property[np.ndarray]:
    """Return a property: a section of the log, crane by crane, shape (cranes, rows, columns), or
    (cranes, rows) for the energy. It is a copy, made when it is first read, as most never are.
    """

    def columns(batch: Batch) -> np.ndarray:
        values = batch.recorded(name)
        return values[:, :, 0] if name == "energy" else values

    return cached_property(columns)


@dataclass(frozen=True, eq=False)
class Batch:
    """Results of n cranes; a crane that diverged has numbers that are not finite.

    Attributes:
        end: Coordinates and rates at the end, shape (cranes, n) each.
        peak_swing: Largest swing, all swing joints together [rad], shape (cranes,).
        residual_swing: Largest amplitude of the swing from `residual_from` on [rad], see
            `cranedyn.analysis.swing.swing_amplitude`, shape (cranes,).
        largest_effort: Largest efforts of the drives [N m or N], shape (cranes, m).
        valid_until: Time at which the model ceased to hold, see `cranedyn.dynamics.validity` [s];
            inf where it held throughout; shape (cranes,).
        t: Times of the recorded rows [s], shape (rows,); shape (cranes, rows) where cranes begin at
            times of their own.
        q: Coordinates at these times [rad or m], shape (cranes, rows, n).
        v: Rates at these times [rad/s or m/s], shape (cranes, rows, n).
        command: Efforts that the commands of the controllers ask for [N m or N], shape (cranes,
            rows, m).
        effort: Efforts of the drives from a row on [N m or N], shape (cranes, rows, m).
        before: Efforts of the drives up to a row [N m or N], shape (cranes, rows, m).
        energy: Mechanical energy [J], shape (cranes, rows).
        log: The recorded rows as the code has written them, shape (groups, rows, columns, lanes).
        columns: Columns of the log by name, see
            `cranedyn.compiled.memory_layout.BufferLayout.row`.
        failures: Number of failed optimisations of a predictive controller, after which the last
            plan continues, shape (cranes,).
        refusals: Number of implausible readings that it refused, shape (cranes,).
    """

    end: State
    peak_swing: np.ndarray
    residual_swing: np.ndarray
    largest_effort: np.ndarray
    valid_until: np.ndarray
    t: np.ndarray
    log: np.ndarray
    columns: Mapping[str, slice]
    failures: np.ndarray
    refusals: np.ndarray

    q = _recorded("q")
    v = _recorded("v")
    command = _recorded("command")
    effort = _recorded("effort")
    before = _recorded("before")
    energy = _recorded("energy")

    def __repr__(self) -> str:
        """Return how many cranes and rows there are, and where the model ceased to hold."""
        invalid = int(np.isfinite(self.valid_until).sum())
        rows = f"{self.t.shape[-1]} rows each, {invalid} not valid throughout"
        return f"Batch of {len(self)} cranes, {rows}"

    def __len__(self) -> int:
        return len(self.peak_swing)

    def recorded(self, name: str) -> np.ndarray:
        """Return a section of the log by its name in `columns`, crane by crane, shape (cranes,
        rows, columns).
        """
        section = self.log[:, :, self.columns[name]]  # (groups, rows, columns, lanes)
        by_lane = section.transpose(0, 3, 2, 1)
        groups, lanes, width, rows = by_lane.shape
        by_crane = by_lane.reshape(groups * lanes, width, rows)[: len(self)]
        return by_crane.swapaxes(1, 2)


def simulate_batch(
    crane: Crane | Cranes | Sequence[Crane],
    controller: Controller | Sequence[Controller],
    reference: Reference | Sequence[Reference] | None = None,
    *,
    start: State | Sequence[State] | None = None,
    t_start: float | Sequence[float] = 0.0,
    duration: float,
    dt: float = 5e-4,
    control_period: float = 5e-3,
    drive: Drive = "effort",
    force: np.ndarray | None = None,
    force_interval: int = 1,
    sensor_offset: np.ndarray | None = None,
    sensor_delay: int | Sequence[int] = 0,
    buffers: bool = False,
    integrator: Integrator = semi_implicit_euler,
    residual_from: float | None = None,
    record: int = 0,
    threads: int | None = None,
    converters: Converters | Sequence[Converters] | None = None,
    device: Device = "cpu",
    ground: Ground | None = None,
    precision: Precision = "double",
    base: BaseMotion | Sequence[BaseMotion] | None = None,
) -> Batch:
    """Run many cranes at once by compiled code, each as `simulate` with validity = mark does.

    The controllers must be affine in the state, so that they are tables, or one predictive
    controller for all. A single argument applies to all cranes. A controller or reference that
    several cranes share should be the same object: its table is then stored once.

    Args:
        crane: One crane or n, or `Cranes` of `cranedyn.compiled.plant.cranes.load_cranes`.
        controller: One or n, such as `Hold`, `Tracking`, `HoistIntegral` or `Follow`, or one
            predictive controller of `cranedyn.compiled.horizon.receding` for all. Those with a
            memory begin with its contents, which stay unchanged.
        reference: One or n; None holds the drives where they start.
        start: One state, n states, or one with n rows; None for where each crane starts.
        t_start: Time at the start [s], one for all, or n, so that each crane has a clock of its
            own: then without a base that moves, `residual_from` and predictive controllers.
        duration: Duration of the run [s].
        dt: Physics step [s].
        control_period: Time between control instants [s].
        drive: What the controllers command, see `simulate`.
        force: External forces in the world [N] at each control instant, on the points of the crane,
            shape (rows, 3 points) for all or (cranes, rows, 3 points); beyond its end the last row
            holds. Wind that depends on how the load moves needs `simulate`.
        force_interval: Control instants from one row of forces to the next, until which it holds.
        sensor_offset: Offset that the sensors add to coordinates and rates, shape (2 n,) for all or
            (cranes, 2 n); with noise, at each control instant, shape (cranes, rows, 2 n), beyond
            its end the last row.
        sensor_delay: Delay of the sensors [control periods], 1000 at most, one for all or one for
            each crane; until it has passed the controllers read the first state.
        buffers: Whether buffers end the ranges of the drives.
        integrator: The stepping rule.
        residual_from: When swing begins to count as residual [s], within the run; by default at its
            end.
        record: Control instants from one recorded row to the next; 0 for no record.
        threads: Number of threads, 1024 at most; by default one for each processor.
        converters: Frequency converters of drives that take velocities, one set for all cranes or
            n, of one delay; None for those typical for the first crane.
        device: "cpu", or "cuda" for an NVIDIA GPU, one crane a thread, see
            `cranedyn.compiled.cuda`, but for predictive controllers and ground.
        ground: Ground and platforms for all, as stiff as for the first crane; None for none.
        precision: "double", or "single" for about half the time: positions and swings then differ
            by some 1e-5 of their size after a minute, see docs/howto/batch.md. It is for motions on
            a processor without ground, buffers, predictive controllers and ropes that may go slack.
        base: Motion of the base on which all cranes stand, or n motions, see `simulate`; None for
            cranes that stand in the world. Recorded energies are then those that a standing crane
            would have with the same coordinates and rates, and a force has a row for each control
            instant.

    Raises:
        OutOfRange: If numbers of cranes differ, an array has another shape or a number that is not
            finite, a time is not in the run, or cranes, records and tables would not fit into 4 GB.
        CraneError: If a controller is not affine in the state, or the device is "cuda" and there is
            no GPU.
        ModelError: If the code does not agree with Pinocchio.
    """
    clock = clocks(duration, dt, control_period)
    _check_choices(drive, device, precision)
    _check_together(device, threads, drive, buffers, force, force_interval, base)
    check_rule(integrator)
    log_interval = min(whole("record", record, 0), clock.periods + 1)
    log_rows = clock.periods // log_interval + 1 if log_interval else 0
    workers = worker_count("threads", threads)
    on_gpu = device == "cuda"
    lanes = WARP if on_gpu else LANES[precision]

    # The cranes, and what they have in common. `used` counts the numbers in memory from here on, so
    # that what would not fit is refused before it is made.
    if start is None:
        start = crane.start if isinstance(crane, Crane | Cranes) else [one.start for one in crane]
    cranes = inputs.crane_count(
        crane=crane,
        controller=controller,
        reference=reference,
        start=start,
        converter=converters,
        base=base,
        start_time=t_start,
    )
    begins = _begins(t_start, cranes, clock, residual_from, base)
    models = _models(crane, cranes, drive, converters, clock, ground)
    sizes = models.sizes
    delays, reading_count = inputs.sensor_delays(sensor_delay, cranes)
    used = inputs.required_numbers(
        sizes, cranes, log_rows, clock.periods, extra=reading_count * sizes.z
    )
    state = inputs.start_states(start, cranes, sizes.n)
    times = read_only(begins.first + begins.since_start)

    # Tables of what acts and what is commanded at each control instant.
    root = inputs.root_table(base, models.distinct, models.index, begins.first, clock, used)
    used += 0 if root is None else root.rows.size
    # From here on, forces are in the axes of the base.
    force = inputs.force_in_base_axes(force, base, cranes, times)
    forces = inputs.force_table(force, cranes, sizes)
    offsets = inputs.offset_tables(sensor_offset, cranes, sizes)
    used += sum(table.rows.size for table in (forces, *offsets))
    control = inputs.control_tables(
        models.distinct[0], controller, reference, state, begins.of_each, begins.since_start, used
    )
    tables = (control.gain_table, control.setpoint_table, forces, *offsets)
    predictive = control.predictive
    _check_device_and_precision(
        device, precision, models, predictive, buffers=buffers, moves=base is not None
    )
    begins.check_together(predictive)

    # The code, one for all cranes.
    options = KernelOptions(
        lanes=lanes,
        single=precision == "single",
        drive=drive,
        integrator=integrator,
        buffers=buffers,
        integral=control.integrates,
        offset=len(offsets) > 0,
        forces=force is not None,
        shared=tuple(table.shared for table in tables),
        log=log_rows > 0,
        summary=True,
        delay_steps=models.delay_steps,
        programme=None if predictive is None else predictive.programme,
        delayed=reading_count > 0,
        threads=on_gpu,
        contacts=models.contacts,
        controller_states=control.states.shape[1],
        base=base is not None,
        base_by_lane=root is not None and not root.shared,
    )
    compiled = _compile(models, options, cranes)
    # The varied numbers of the cranes stand in rows and, arranged in lanes, for the code.
    needed = used + 2 * cranes * compiled.code.source.varied
    inputs.check_fits_memory("number of cranes", str(cranes), needed)

    # Memory of each crane.
    memory = _allocate(models, compiled, state, control, log_rows)
    if reading_count:
        memory.delay = group_lanes([delays[:, None]], lanes, np.int64)
        memory.readings = np.zeros((memory.groups, reading_count * sizes.z, lanes))
    if predictive is not None:
        memory.horizon, memory.workspace = _horizon(
            predictive, drive, begins.first, clock, memory.groups, used
        )
    if not all(options.shared):
        starts = [table.starts[:, None] for table in tables]
        memory.starts = group_lanes(starts, lanes, np.int64)
    # The run.
    loop = BoundKernel(
        compiled.code,
        clock,
        tables,
        last=clock.periods + 1,
        end=clock.periods,
        force_interval=force_interval,
        log_interval=max(log_interval, 1),
        residual_from=_instant(residual_from, begins.first, clock),
        reading_count=reading_count,
        state=memory.state,
        numbers=memory.numbers,
        starts=memory.starts,
        delay=memory.delay,
        readings=memory.readings,
        summary=memory.summary,
        log=memory.log,
        horizon=memory.horizon,
        workspace=memory.workspace,
        root=root,
        root_starts=None if root is None else group_lanes([root.starts[:, None]], lanes, np.int64),
    )
    if on_gpu:
        cuda.run(loop, compiled.code, compiled.cranes, compiled.varied, models.response)
    else:
        run_in_threads(loop, workers)
    # Frees the memory of the tables before results are copied, so that both never stand in memory
    # together.
    del loop, control, tables, forces, offsets
    return _results(memory, sizes, predictive, begins.times, control_period, log_interval, log_rows)


def _check_choices(drive: Drive, device: Device, precision: Precision) -> None:
    """Check the arguments of `simulate_batch` that are one of several words.

    Raises:
        OutOfRange: If one is none of these.
    """
    check_choice("drive", drive, Drive)
    check_choice("device", device, Device)
    check_choice("precision", precision, Precision)


def _check_together(
    device: Device,
    threads: int | None,
    drive: Drive,
    buffers: bool,
    force: np.ndarray | None,
    force_interval: int,
    base: BaseMotion | Sequence[BaseMotion] | None,
) -> None:
    """Check arguments of `simulate_batch` that must fit each other.

    Raises:
        OutOfRange: If they do not.
        CraneError: If the device is "cuda" and there is no GPU.
    """
    if device == "cuda":
        if threads is not None:
            raise OutOfRange("threads", threads, "None on a GPU, where each crane has one")
        cuda.check_available()
    if buffers and drive != "effort":
        raise OutOfRange("buffers", buffers, "False where the drives take no efforts")
    if force is None and force_interval != 1:
        raise OutOfRange("force_interval", force_interval, "1 where there is no force")
    if base is not None and force_interval != 1:
        # The base turns against a force in the world from one instant to the next.
        raise OutOfRange("force_interval", force_interval, "1 on a base that moves")


@dataclass(frozen=True, eq=False)
class _Begins:
    """When the cranes of a batch begin.

    Attributes:
        of_each: Time at the start of each crane [s], shape (cranes,).
        clock: How the run is divided.
        own: Whether each crane has a time of its own, even if these are the same.
    """

    of_each: np.ndarray
    clock: Clocks
    own: bool

    @property
    def since_start(self) -> np.ndarray:
        """Control instants from the start on [s], shape (instants,)."""
        return self.clock.period * np.arange(self.clock.periods + 1)

    @property
    def first(self) -> float:
        """Time at the start of the first crane, which is that of all unless they have their own
        [s].
        """
        return float(self.of_each[0])

    @property
    def times(self) -> np.ndarray:
        """Control instants [s], shape (instants,), or (cranes, instants) where cranes begin at
        times of their own.
        """
        if self.own:
            return read_only(self.of_each[:, None] + self.since_start)
        return read_only(self.first + self.since_start)

    def check_together(self, predictive: Receding | None) -> None:
        """Refuse a predictive controller, whose clock is one for all cranes, where they have their
        own.

        Raises:
            OutOfRange: If there is one.
        """
        if self.own and predictive is not None:
            allowed = "one for all cranes where the controller is a predictive one"
            raise OutOfRange("time at the start", "one for each crane", allowed)


def _begins(
    t_start: float | Sequence[float],
    cranes: int,
    clock: Clocks,
    residual_from: float | None,
    base: BaseMotion | Sequence[BaseMotion] | None,
) -> _Begins:
    """Return when the cranes begin, see `simulate_batch` for the arguments.

    Raises:
        OutOfRange: If a time is out of range, or an argument needs one time for all.
    """
    own = np.ndim(t_start) > 0
    allowed = "None where cranes begin at times of their own"
    if own and residual_from is not None:
        raise OutOfRange("residual_from", residual_from, allowed)
    if own and base is not None:
        raise OutOfRange("base", "one that moves", allowed)
    return _Begins(inputs.start_times(t_start, cranes), clock, own)


def _check_device_and_precision(
    device: Device,
    precision: Precision,
    models: _Models,
    predictive: Receding | None,
    *,
    buffers: bool,
    moves: bool,
) -> None:
    """Check that a device in a precision can do what is asked for.

    Args:
        device: The device.
        precision: The precision.
        models: The cranes.
        predictive: The predictive controller; None for another one.
        buffers: Whether buffers end the ranges of the drives.
        moves: Whether the base moves.

    Raises:
        OutOfRange: If it cannot.
    """
    on_gpu = device == "cuda"
    if on_gpu and (predictive is not None or models.contacts is not None):
        allowed = "cpu where the controller is a predictive one or the load may touch the ground"
        raise OutOfRange("device", device, allowed)
    excluded = {
        "the device cuda": on_gpu,
        "a ground": models.contacts is not None,
        "buffers": buffers,
        "a predictive controller": predictive is not None,
        "a base that moves": moves,
    }
    check_precision(precision, Topology.of(models.distinct[0]), excluded)


def _instant(t: float | None, t_start: float, clock: Clocks) -> int:
    """Return the first control instant at or after a time within the run [s]; the last for None."""
    if t is None:
        return clock.periods
    end = t_start + clock.periods * clock.period
    periods = (within("residual_from", t, t_start, end, "s") - t_start) / clock.period
    return min(clock.periods, math.ceil(periods - _ROUNDING))


# --- cranes and their code ------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Models:
    """Cranes of a batch, and what all of them have in common.

    Attributes:
        distinct: The distinct cranes.
        index: Index of each crane's model among them, shape (cranes,).
        response: Parameters of the frequency converters, one row for all cranes or one for each;
            None for drives without converters.
        delay_steps: Delay of the converters [control periods]; None for drives without converters.
        contacts: Contacts of the loads with the ground; None without ground.
        sizes: Layout of the buffers of each crane.
    """

    distinct: Sequence[Crane] | Cranes
    index: np.ndarray
    response: np.ndarray | None
    delay_steps: int | None
    contacts: Contacts | None
    sizes: BufferLayout


def _models(
    crane: Crane | Cranes | Sequence[Crane],
    cranes: int,
    drive: Drive,
    converters: Converters | Sequence[Converters] | None,
    clock: Clocks,
    ground: Ground | None,
) -> _Models:
    """Return the cranes of a batch; see `simulate_batch` for the arguments. `cranes` is the number
    of all.
    """
    index, distinct = inputs.distinct_objects(crane, cranes)
    layout = inputs.common_layout(distinct)
    response, delay_steps = inputs.converter_response(distinct[0], drive, converters, clock)
    contacts = None if ground is None else ground.contacts(distinct[0])
    sizes = BufferLayout.of(layout, delay_steps, contacts)
    return _Models(distinct, index, response, delay_steps, contacts, sizes)


@dataclass(frozen=True, eq=False)
class _CompiledCranes:
    """Code of the cranes of a batch.

    Attributes:
        code: The code, the same for all of them.
        cranes: The distinct cranes.
        varied: Parameters in which these differ, a row for each, shape (distinct cranes, varied).
        index: Row of each crane of the batch in `varied`, shape (cranes,).
    """

    code: Kernel
    cranes: Sequence[Crane] | Cranes
    varied: np.ndarray
    index: np.ndarray


def _compile(models: _Models, options: KernelOptions, cranes: int) -> _CompiledCranes:
    """Compile the code of the cranes of a batch.

    Args:
        models: The cranes.
        options: Features of the code.
        cranes: Number of cranes in the batch.
    """
    distinct = models.distinct
    crane_index = models.index
    if models.response is not None and len(models.response) > 1:
        # Each crane has converters of its own. A row of parameters is that of its model and of its
        # converters, so that no two cranes share one.
        if not isinstance(distinct, Cranes):
            distinct = [distinct[i] for i in crane_index.tolist()]
        crane_index = np.arange(cranes)
    code, varied = compile_kernel(distinct, options, models.response)
    return _CompiledCranes(code, distinct, varied, crane_index)


# --- memory ---------------------------------------------------------------------------------------


@dataclass(eq=False)
class _Memory:
    """Arrays that the loop of a batch reads and writes, see `BoundKernel`; None for those that it
    does not have.

    Attributes:
        cranes: Number of cranes; the last one fills the last group.
        state: State of each crane.
        numbers: Crane parameters that differ between the lanes.
        summary: Summary of the run.
        log: Rows of the log.
        delay: Delays of the sensors.
        readings: Readings of delayed sensors.
        horizon: Memory of a predictive controller.
        workspace: Its path and the memory of its optimisations.
        starts: First row of each lane's part of each table.
    """

    cranes: int
    state: np.ndarray
    numbers: np.ndarray
    summary: np.ndarray
    log: np.ndarray
    delay: np.ndarray | None = None
    readings: np.ndarray | None = None
    horizon: np.ndarray | None = None
    workspace: np.ndarray | None = None
    starts: np.ndarray | None = None

    @property
    def groups(self) -> int:
        """Number of groups."""
        return len(self.state)


def _allocate(
    models: _Models,
    compiled: _CompiledCranes,
    start: State,
    control: inputs.ControlTables,
    log_rows: int,
) -> _Memory:
    """Return the memory of a loop before the first control instant.

    Args:
        models: The cranes.
        compiled: Their code.
        start: Coordinates and rates at the start, shape (cranes, n) each.
        control: Integrals and states of the controllers at the start.
        log_rows: Rows to record of each crane.
    """
    sizes = models.sizes
    lanes = compiled.code.source.options.lanes
    cranes = len(start.q)

    # The sections of `BufferLayout.state`, in their order.
    last_command_and_work = np.broadcast_to(0.0, (cranes, sizes.m + 2))
    drives = models.distinct[0].layout.drives
    first_state = [start.q, start.v, control.integrals, last_command_and_work]
    if models.contacts is not None:
        first_state.append(_anchors(models, models.contacts, start))
    first_state += inputs.converter_memory(sizes, start.v[:, drives])
    first_state.append(control.states)

    # The sections of `BufferLayout.summary`: squares of swings, the first invalid row, efforts.
    first_summary = np.array([0.0, 0.0, math.inf, *[0.0] * sizes.m])
    state = group_lanes(first_state, lanes)
    summary = np.broadcast_to(first_summary, (cranes, len(first_summary)))
    return _Memory(
        cranes=cranes,
        state=state,
        numbers=group_lanes([compiled.varied[compiled.index]], lanes),
        summary=group_lanes([summary], lanes),
        log=np.empty((len(state), log_rows * size(sizes.row), lanes)),
    )


def _anchors(models: _Models, contacts: Contacts, start: State) -> np.ndarray:
    """Return the anchors of the points that touch the ground at the start, shape (cranes, 3
    points).
    """
    anchors = []
    for i, q, v in zip(models.index.tolist(), start.q, start.v, strict=True):
        anchors.append(anchors_at(models.distinct[i], contacts, State(q, v)).T.ravel())
    return np.array(anchors)


def _horizon(
    predictive: Receding, drive: Drive, t_start: float, clock: Clocks, groups: int, used: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the memory of a predictive controller for groups of lanes, shape (groups, doubles),
    and its workspace, which all groups share.

    Args:
        predictive: The controller.
        drive: Kind of the commands of the run.
        t_start: Time at the start [s].
        clock: How the run is divided.
        groups: Number of groups.
        used: Numbers of memory that the batch has besides.

    Raises:
        OutOfRange: If its drives or control period differ from the run's, or it does not fit.
    """
    if predictive.programme.drive != drive:
        raise OutOfRange("drive", drive, f"the controller's, {predictive.programme.drive}")
    predictive.begin_run(t_start, clock.period)
    memory = predictive.initial_memory(t_start, LANES["double"])
    end = predictive.programme.offsets(LANES["double"]).path
    needed = used + groups * end + len(memory)
    inputs.check_fits_memory("number of cranes", f"{groups * LANES['double']}", needed)
    return np.tile(memory[:end], (groups, 1)), memory[end:]


# --- runs and results -----------------------------------------------------------------------------


def run_in_threads(loop: BoundKernel, threads: int) -> None:
    """Run a loop over all its groups of lanes in so many threads; Ctrl-C is raised as soon as every
    thread has ended its piece.
    """
    groups = len(loop)
    workers = min(threads, groups)
    if workers == 1:
        loop.run_groups(range(groups))
        return
    chunk = max(1, groups // (workers * _CHUNKS_PER_THREAD))
    # Whole teams, but never so large that a thread has nothing to do.
    team = min(loop.team_size, groups // workers)
    chunk = max(chunk // team, 1) * team
    interrupted = threading.Event()

    def run_chunk(first: int) -> None:
        loop.run_groups(range(first, min(first + chunk, groups)), interrupted.is_set)

    with ThreadPoolExecutor(workers) as pool:
        try:
            list(pool.map(run_chunk, range(0, groups, chunk)))
        finally:
            interrupted.set()


def _results(
    memory: _Memory,
    sizes: BufferLayout,
    predictive: Receding | None,
    times: np.ndarray,
    period: float,
    log_interval: int,
    log_rows: int,
) -> Batch:
    """Return the results of a batch from its memory after the run.

    Args:
        memory: The memory.
        sizes: Layout of the buffers of each crane.
        predictive: The predictive controller of all cranes; None for others.
        times: Control instants [s], shape (instants,) or (cranes, instants).
        period: Time between them [s].
        log_interval: Control instants from one recorded row to the next; 0 for no record.
        log_rows: Recorded rows of each crane.
    """
    cranes = memory.cranes
    state_columns = slices(sizes.state)
    end = ungroup_lanes(memory.state[:, : sizes.z], cranes)
    summary_columns = slices(sizes.summary)
    summary = ungroup_lanes(memory.summary, cranes)
    first_invalid = summary[:, summary_columns["invalid"]][:, 0]
    failures, refusals = _optimisation_counts(predictive, memory.horizon, cranes)
    groups, _, lanes = memory.log.shape
    return Batch(
        end=State(end[:, state_columns["q"]], end[:, state_columns["v"]]),
        # The code compares squares, and so saves the roots.
        peak_swing=np.sqrt(summary[:, summary_columns["peak"]][:, 0]),
        residual_swing=np.sqrt(summary[:, summary_columns["residual"]][:, 0]),
        largest_effort=summary[:, summary_columns["effort"]],
        valid_until=times[..., 0] + period * first_invalid,
        t=times[..., :: max(log_interval, 1)][..., :log_rows],
        log=memory.log.reshape(groups, log_rows, size(sizes.row), lanes),
        columns=slices(sizes.row),
        failures=failures,
        refusals=refusals,
    )


def _optimisation_counts(
    predictive: Receding | None, horizon: np.ndarray | None, cranes: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of failed optimisations and of refused readings, shape (cranes,) each;
    zeros without a predictive controller.
    """
    if predictive is None or horizon is None:
        zeros = np.zeros(cranes, dtype=int)
        return zeros, zeros
    failures = []
    refusals = []
    for group in horizon:
        failures += [
            status.failures for status in predictive.status_by_lane(group, LANES["double"])
        ]
        refusals.append(predictive.refusals(group, LANES["double"]))
    return np.array(failures[:cranes], dtype=int), np.concatenate(refusals)[:cranes]
