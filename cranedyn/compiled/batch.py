"""Simulation of many cranes at once, one in each lane of the processor's vectors."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from cranedyn.checks import check_choice, number, read_only, whole, within, worker_count
from cranedyn.clocks import Clocks, clocks
from cranedyn.compiled import cuda, inputs
from cranedyn.compiled.binding import Loop
from cranedyn.compiled.horizon.receding import Receding
from cranedyn.compiled.kernel import Recipe
from cranedyn.compiled.layout import BufferLayout, size, slices
from cranedyn.compiled.step import check_rule
from cranedyn.compiled.tables import group_lanes, ungroup_lanes
from cranedyn.compiled.threads import WARP
from cranedyn.compiled.verify import compile_kernel
from cranedyn.dynamics.contact import Ground
from cranedyn.dynamics.converters import Converters
from cranedyn.dynamics.drives import GroundForces
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import Controller, Drive, Reference, State
from cranedyn.model.crane import Crane
from cranedyn.plant.cranes import Cranes

_LANES, _CHUNKS = 8, 8
"""Cranes in a group; chunks of groups for each thread, so that threads end at about the same time.
"""

Device = Literal["cpu", "cuda"]
"""Where a batch runs."""


def _recorded(name: str) -> cached_property[np.ndarray]:
    """Return a property that copies columns of a log when they are first read: most never are."""

    def columns(batch: Batch) -> np.ndarray:
        log = batch.log[:, :, batch.columns[name]].transpose(0, 3, 2, 1)
        groups, lanes, *shape = log.shape
        rows = log.reshape(groups * lanes, *shape)[: len(batch)].swapaxes(1, 2)
        return rows[:, :, 0] if name == "energy" else rows

    return cached_property(columns)


@dataclass(frozen=True, eq=False)
class Batch:
    """Results of n cranes; a crane that diverged has numbers that are not finite.

    Attributes:
        end: Coordinates and rates at the end, shape (cranes, n) each.
        peak_swing: Largest swing, all swing joints together [rad], shape (cranes,).
        residual_swing: Largest amplitude of the swing from `residual_from` on [rad], see
            `cranedyn.analysis.swing.swing_amplitude`, shape (cranes,).
        largest_effort: Of the drives [N m or N], shape (cranes, m).
        valid_until: Time at which the model ceased to hold, see `cranedyn.dynamics.validity` [s];
            inf where it held throughout; shape (cranes,).
        t: Times of the recorded rows [s], shape (rows,).
        q, v: Coordinates and rates at these, shape (cranes, rows, n) each.
        command, effort: Commands of the controllers and efforts from a row on, shape (cranes, rows,
            m) each.
        before, energy: Efforts up to a row, shape (cranes, rows, m); mechanical energy [J], shape
            (cranes, rows).
        log, columns: All these, shape (groups, rows, columns, lanes), and their columns by name.
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

    q, v, command = _recorded("q"), _recorded("v"), _recorded("command")
    effort, before, energy = _recorded("effort"), _recorded("before"), _recorded("energy")

    def __repr__(self) -> str:
        """Return how many cranes and rows there are, and where the model ceased to hold."""
        invalid = int(np.isfinite(self.valid_until).sum())
        rows = f"{len(self.t)} rows each, {invalid} not valid throughout"
        return f"Batch of {len(self)} cranes, {rows}"

    def __len__(self) -> int:
        return len(self.peak_swing)


def simulate_batch(
    crane: Crane | Cranes | Sequence[Crane],
    controller: Controller | Sequence[Controller],
    reference: Reference | Sequence[Reference] | None = None,
    *,
    start: State | Sequence[State] | None = None,
    t_start: float = 0.0,
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
) -> Batch:
    """Run many cranes under controllers that are affine in the state, by compiled code; each as
    `simulate` with validity = mark.

    A single argument applies to all cranes. A controller or reference that several cranes share
    should be the same object: its table is then stored once.

    Args:
        crane: One crane or n, or `Cranes` of `cranedyn.plant.cranes.load_cranes`.
        controller: One or n, such as `Hold`, `Tracking`, `HoistIntegral` or `Follow`, or one
            predictive controller of `cranedyn.compiled.horizon.receding` for all. Those with a
            memory begin with its contents, which stay unchanged.
        reference: One or n; None holds the drives where they start.
        start: One state, n states, or one with n rows; None for where each crane starts.
        t_start: Time at the start [s].
        duration: Duration of the run [s].
        dt: Physics step [s].
        control_period: Time between control instants [s].
        drive: What the controllers command, see `simulate`.
        force: From outside in the world [N] at each control instant, on the points of the crane,
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

    Raises:
        OutOfRange: If numbers of cranes differ, an array has another shape or a number that is not
            finite, a time is not in the run, or cranes, records and tables would not fit into 4 GB.
        CraneError: If a controller is not affine in the state, or the device is "cuda" and there is
            no GPU.
        ModelError: If the code does not agree with Pinocchio.
    """
    clock = clocks(duration, dt, control_period)
    check_choice("drive", drive, Drive)
    check_choice("device", device, Device)
    if device == "cuda":
        if threads is not None:
            raise OutOfRange("threads", threads, "None on a GPU, where each crane has one")
        cuda.check_available()
    lanes = WARP if device == "cuda" else _LANES
    if buffers and drive != "effort":
        raise OutOfRange("buffers", buffers, "False where the drives take no efforts")
    if force is None and force_interval != 1:
        raise OutOfRange("force_interval", force_interval, "1 where there is no force")
    check_rule(integrator)
    number("time at the start", t_start, "s", "-1e9 to 1e9")
    after = _instant(residual_from, t_start, clock)
    interval = min(whole("record", record, 0), clock.periods + 1)
    workers = worker_count("threads", threads)
    if start is None:
        start = crane.start if isinstance(crane, Crane | Cranes) else [one.start for one in crane]
    cranes = inputs.crane_count(
        crane=crane, controller=controller, reference=reference, start=start, converter=converters
    )
    rows = clock.periods // interval + 1 if interval else 0
    crane_index, distinct = inputs.distinct_objects(crane, cranes)
    layout = inputs.common_layout(distinct)
    response, delay_steps = inputs.converter_response(distinct[0], drive, converters, clock)
    contacts = None if ground is None else ground.contacts(distinct[0])
    sizes = BufferLayout.of(layout, delay_steps, contacts)
    delays, reading_count = inputs.sensor_delays(sensor_delay, cranes)
    used = inputs.required_numbers(sizes, cranes, rows, clock.periods, reading_count * sizes.z)
    state = inputs.start_states(start, cranes, sizes.n)
    times = t_start + control_period * np.arange(clock.periods + 1)
    forces = inputs.force_table(force, cranes, sizes)
    offsets = inputs.offset_tables(sensor_offset, cranes, sizes)
    used += sum(table.rows.size for table in (forces, *offsets))
    control = inputs.control_tables(
        distinct[0], controller, reference, state, read_only(times), used
    )
    tables = (control.gain_table, control.setpoint_table, forces, *offsets)
    if (control.predictive is not None or contacts is not None) and device == "cuda":
        allowed = "cpu where the controller is a predictive one or the load may touch the ground"
        raise OutOfRange("device", device, allowed)
    recipe = Recipe(
        lanes,
        drive,
        integrator,
        buffers,
        integral=control.integrates,
        offset=len(offsets) > 0,
        forces=force is not None,
        shared=tuple(table.shared for table in tables),
        log=rows > 0,
        summary=True,
        delay_steps=delay_steps,
        programme=None if control.predictive is None else control.predictive.programme,
        delayed=reading_count > 0,
        threads=device == "cuda",
        contacts=contacts,
    )
    anchors = []
    if contacts is not None:
        loads = [GroundForces(distinct[i], contacts) for i in range(len(distinct))]
        starts = zip(crane_index.tolist(), state.q, state.v, strict=True)
        anchors = [np.array([loads[i].anchors_at(State(q, v)).T.ravel() for i, q, v in starts])]
    if response is not None and len(response) > 1:  # numbers of their own: of crane and converter
        if not isinstance(distinct, Cranes):
            distinct = [distinct[i] for i in crane_index.tolist()]
        crane_index = np.arange(cranes)
    code, varied = compile_kernel(distinct, recipe, response)
    needed = used + 2 * cranes * code.source.varied
    inputs.check_fits_memory("number of cranes", str(cranes), needed)
    nothing = np.broadcast_to(0.0, (cranes, sizes.m + 2))  # last command, work of contacts
    converter_memory = inputs.converter_memory(sizes, state.v[:, layout.drives])
    first_state = [state.q, state.v, control.integrals, nothing, *anchors, *converter_memory]
    first_summary = np.array([0.0, 0.0, math.inf, *[0.0] * sizes.m])
    memory: dict[str, Any] = {
        "state": group_lanes(first_state, lanes),
        "numbers": group_lanes([varied[crane_index]], lanes),
        "summary": group_lanes([np.broadcast_to(first_summary, (cranes, sizes.m + 3))], lanes),
    }
    memory["log"] = np.empty((len(memory["state"]), rows * size(sizes.row), lanes))
    if reading_count:
        memory["delay"] = group_lanes([delays[:, None]], lanes, np.int64)
        memory["readings"] = np.zeros((len(memory["state"]), reading_count * sizes.z, lanes))
    if control.predictive is not None:
        groups = len(memory["state"])
        memory |= _horizon(control.predictive, drive, t_start, clock, groups, used)
    if not all(recipe.shared):
        memory["starts"] = group_lanes([table.starts[:, None] for table in tables], lanes, np.int64)
    counts: Any = {"force_interval": force_interval, "log_interval": max(interval, 1)}
    counts |= {"residual_from": after, "reading_count": reading_count, "end": clock.periods}
    loop = Loop(code, clock, tables, last=clock.periods + 1, **counts, **memory)
    if device == "cuda":
        cuda.run(loop, code, distinct, varied, response)
    else:
        run_in_threads(loop, workers)
    predictive = control.predictive
    del loop, control, tables, forces, offsets  # frees their memory before results are copied
    state_at, kept_at = slices(sizes.state), slices(sizes.summary)
    end = ungroup_lanes(memory["state"][:, : sizes.z], cranes)
    summary = ungroup_lanes(memory["summary"], cranes)
    first_invalid = summary[:, kept_at["invalid"]][:, 0]
    return Batch(
        end=State(end[:, state_at["q"]], end[:, state_at["v"]]),
        peak_swing=np.sqrt(summary[:, kept_at["peak"]][:, 0]),
        residual_swing=np.sqrt(summary[:, kept_at["residual"]][:, 0]),
        largest_effort=summary[:, kept_at["effort"]],
        valid_until=t_start + control_period * first_invalid,
        t=times[:: max(interval, 1)][:rows],
        log=memory["log"].reshape(len(memory["log"]), rows, size(sizes.row), lanes),
        columns=slices(sizes.row),
        **_marks(predictive, memory, cranes),
    )


def _horizon(
    predictive: Receding, drive: Drive, t_start: float, clock: Clocks, groups: int, used: int
) -> dict[str, np.ndarray]:
    """Return the memory of a predictive controller for groups of lanes, shape (groups, doubles),
    and its workspace, after checking that they fit beside the numbers that are used.

    Raises:
        OutOfRange: If its drives or control period differ from the run's, or it does not fit.
    """
    if predictive.programme.drive != drive:
        raise OutOfRange("drive", drive, f"the controller's, {predictive.programme.drive}")
    predictive.begin_run(t_start, clock.period)
    memory = predictive.initial_memory(t_start, _LANES)
    end = predictive.programme.offsets(_LANES).path
    needed = used + groups * end + len(memory)
    inputs.check_fits_memory("number of cranes", f"{groups * _LANES}", needed)
    return {"horizon": np.tile(memory[:end], (groups, 1)), "workspace": memory[end:]}


def _marks(
    predictive: Receding | None, memory: dict[str, np.ndarray], cranes: int
) -> dict[str, np.ndarray]:
    """Return the numbers of failed optimisations and of refused readings by crane."""
    if predictive is None:
        return dict.fromkeys(("failures", "refusals"), np.zeros(cranes, dtype=int))
    horizon = memory["horizon"]
    marks = [mark for group in horizon for mark in predictive.marks_by_lane(group, _LANES)]
    refusals = np.concatenate([predictive.refusals(group, _LANES) for group in horizon])
    failures = np.array([mark.failures for mark in marks[:cranes]], dtype=int)
    return {"failures": failures, "refusals": refusals[:cranes]}


def _instant(t: float | None, t_start: float, clock: Clocks) -> int:
    """Return the first control instant at or after a time within the run [s]; the last for None."""
    if t is None:
        return clock.periods
    end = t_start + clock.periods * clock.period
    periods = (within("residual_from", t, t_start, end, "s") - t_start) / clock.period
    return min(clock.periods, math.ceil(periods - 1e-6))


def run_in_threads(loop: Loop, threads: int) -> None:
    """Run a loop over all its groups of lanes in so many threads; Ctrl-C is raised as soon as every
    thread has ended its piece.
    """
    groups = len(loop)
    workers = min(threads, groups)
    if workers == 1:
        return loop.run_groups(range(groups))
    share = max(1, groups // (workers * _CHUNKS))
    ended = threading.Event()

    def work(first: int) -> None:
        loop.run_groups(range(first, min(first + share, groups)), ended.is_set)

    with ThreadPoolExecutor(workers) as pool:
        try:
            list(pool.map(work, range(0, groups, share)))
        finally:
            ended.set()
