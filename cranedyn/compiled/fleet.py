"""Cranes that advance from one command to the next, for external loops such as reinforcement
learning.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from itertools import pairwise
from typing import Any

import numpy as np

from cranedyn.checks import check_choice, finite, read_only, short_repr, whole, worker_count
from cranedyn.clocks import clocks
from cranedyn.compiled.binding import BoundKernel
from cranedyn.compiled.inputs import (
    check_fits_memory,
    common_gravity,
    common_layout,
    converter_memory,
    converter_response,
    start_states,
)
from cranedyn.compiled.kernel import LANES, Kernel, KernelOptions, Precision, check_precision
from cranedyn.compiled.lane_bases import LaneBases
from cranedyn.compiled.loop_tables import RowTable, command_tables, single_table
from cranedyn.compiled.memory_layout import BufferLayout, size, slices
from cranedyn.compiled.plant.plant import Topology
from cranedyn.compiled.step import check_rule
from cranedyn.compiled.verify import compile_kernel
from cranedyn.disturbances.base_motion import BaseMotion
from cranedyn.dynamics.converters import Converters
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.dynamics.root_motion import ROOT_NUMBERS
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import DirectDrive, Drive, State
from cranedyn.model.crane import Crane

_MIN_STEPS_PER_THREAD = 1500
"""Fewest steps of groups in a control period for which a thread is worth its start."""

_MAX_GROUPS_PER_CHUNK = 512
"""Most groups of a chunk, so that its numbers stay in a processor's cache."""

_OTHER_NUMBERS = 10
"""Numbers of each crane that are reckoned with besides its state, its parameters and its force."""


class Fleet:
    """Cranes that each take a command for a control period, and move as in `simulate` with validity
    = mark.

    All arguments are checked and copied, so that the code stays within its arrays.

    Attributes:
        layout: Layout of all cranes.
        z: Coordinates and rates, one column a crane, shape (2 joints, n); a read-only view that the
            next step updates.
        chunks: Slices of columns, each advanced by one thread at a time.
        bases: Bases of the cranes; None for a fleet whose bases cannot move.
    """

    z: np.ndarray
    _pool: ThreadPoolExecutor | None

    def __init__(
        self,
        cranes: Crane | Sequence[Crane],
        count: int,
        *,
        dt: float = 5e-4,
        control_period: float = 0.1,
        drive: DirectDrive | Converters = "motion",
        forces: bool = False,
        integrator: Integrator = semi_implicit_euler,
        threads: int | None = None,
        precision: Precision = "double",
        base: bool = False,
    ) -> None:
        """Create n cranes of the first kind, at its start, on bases at rest.

        Args:
            cranes: One crane, or several from which `place` chooses.
            count: Number of cranes, n.
            dt: Physics step [s].
            control_period: Time for which a command holds [s].
            drive: Kind of command, see `simulate`, or the frequency converters of all cranes, which
                take rates.
            forces: Whether external forces can act.
            integrator: The stepping rule.
            threads: Number of threads, 1024 at most; by default one for each processor.
            precision: "double", or "single" for steps that take about half the time and are precise
                to six digits, see `cranedyn.compiled.batch.simulate_batch`.
            base: Whether the bases on which the cranes stand can move, see `stand_on`; in double
                precision only.

        Raises:
            OutOfRange: If a number is out of range, there is no crane, one has another layout, they
                would not fit into 4 GB, there is no code for the stepping rule, or cranes on bases
                that move stand in different gravities.
            ModelError: If the code does not agree with Pinocchio.
        """
        kind: Drive = "velocity"
        converters = None
        if isinstance(drive, Converters):
            converters = drive
        else:
            check_choice("drive", drive, DirectDrive)
            kind = drive
        check_rule(integrator)
        self.cranes = [cranes] if isinstance(cranes, Crane) else list(cranes)
        if not self.cranes:
            raise OutOfRange("number of cranes to choose from", 0, "1 or more")
        self.layout = common_layout(self.cranes)
        check_precision(precision, Topology.of(self.cranes[0]), {"a base that moves": base})
        self._lanes = LANES[precision]
        self._clock = clocks(control_period, dt, control_period)
        response, delay_steps = converter_response(self.cranes[0], kind, converters, self._clock)
        self._sizes = BufferLayout.of(self.layout, delay_steps)
        self.count = whole("number of cranes", count, 1)
        self.control_period = control_period
        self.drive = kind
        workers = worker_count("threads", threads)
        self._recipe = KernelOptions(
            lanes=self._lanes,
            single=precision == "single",
            drive=kind,
            integrator=integrator,
            forces=forces,
            shared=(True, True, not forces),
            delay_steps=delay_steps,
            base=base,
            base_by_lane=base,
        )
        self._converters = converters
        self._response = response
        code, self._parameters = compile_kernel(self.cranes, self._recipe, response)
        self._forces_act = forces
        self.bases: LaneBases | None = None
        if base:
            gravity = common_gravity(self.cranes)
            lanes = -(-self.count // self._lanes) * self._lanes
            self.bases = LaneBases(lanes, self._clock, gravity)
        self._allocate(code.source.varied)
        self._divide(workers)
        self._bind(code)
        self._effort_limit = np.full((self._sizes.m, self.count), np.inf)

        # The lanes that are left in the last group have a crane each, too: they run like the rest.
        q, v = self.cranes[0].start
        every_lane = np.arange(len(self._state) * self._lanes)
        self._put(every_lane, State(q[None], v[None]), np.zeros(1, dtype=int))

    def _allocate(self, varied: int) -> None:
        """Allocate the memory of all cranes, each with so many parameters that may differ.

        Raises:
            OutOfRange: If it would not fit into 4 GB.
        """
        sizes = self._sizes
        groups = -(-self.count // self._lanes)
        root_rows = 0 if self.bases is None else self.bases.rows_per_period
        numbers_of_each = 3 * size(sizes.state) + varied + size(sizes.force) + _OTHER_NUMBERS
        numbers_of_each += 2 * root_rows * ROOT_NUMBERS
        needed = groups * self._lanes * numbers_of_each
        check_fits_memory("number of cranes", str(self.count), needed)
        self._state = np.zeros((groups, size(sizes.state), self._lanes))
        self._numbers = np.zeros((groups, varied, self._lanes))
        force_rows = groups * self._lanes if self._forces_act else 1
        self._force = np.zeros((force_rows, size(sizes.force)))
        # The same in the axes of the bases, in which the code computes.
        self._force_in_base_axes = self._force if self.bases is None else self._force.copy()
        self._root = np.zeros((groups * self._lanes, root_rows, ROOT_NUMBERS))
        self._z = np.empty((sizes.z, groups, self._lanes))
        self._columns = slices(sizes.state)

    def _divide(self, workers: int) -> None:
        """Divide the groups into chunks for so many threads at most."""
        groups = len(self._state)
        worthwhile_threads = groups * self._clock.steps // _MIN_STEPS_PER_THREAD
        fewest_chunks = -(-groups // _MAX_GROUPS_PER_CHUNK)
        chunk_count = max(min(workers, worthwhile_threads), fewest_chunks, 1)
        group_ends = np.linspace(0, groups, chunk_count + 1).astype(int)
        crane_ends = np.minimum(self._lanes * group_ends, self.count).tolist()
        self.chunks = [slice(first, last) for first, last in pairwise(crane_ends)]
        self._workers = min(workers, chunk_count)

    def _bind(self, code: Kernel) -> None:
        """Bind code to the memory and create a view of it."""
        groups = len(self._state)
        force_table = single_table(self._force_in_base_axes)
        starts = None
        root = None
        root_starts = None
        if self._forces_act:
            # A row of the forces for each lane; all lanes share the other two tables.
            first_rows = np.arange(groups * self._lanes)
            force_table = RowTable(self._force_in_base_axes, 1, first_rows)
            starts = np.zeros((groups, 3, self._lanes), dtype=np.int64)
            starts[:, 2] = first_rows.reshape(groups, self._lanes)
        if self.bases is not None:
            length = self.bases.rows_per_period
            first_of_each = length * np.arange(groups * self._lanes)
            root = RowTable(self._root.reshape(-1, ROOT_NUMBERS), length, first_of_each)
            root_starts = first_of_each.reshape(groups, 1, self._lanes)
        gain_rows, setpoint_rows = command_tables(self._sizes)
        loop = BoundKernel(
            code,
            self._clock,
            (single_table(gain_rows), single_table(setpoint_rows), force_table),
            last=1,
            end=1,
            state=self._state,
            numbers=self._numbers,
            starts=starts,
            root=root,
            root_starts=root_starts,
        )
        self._step_groups = loop.step_function()
        self.z = read_only(self._z.reshape(len(self._z), -1)[:, : self.count])
        self._pool = None
        self._process = 0

    def __getstate__(self) -> dict[str, Any]:
        """Return all but what is bound to the memory, for a copy with its own memory."""
        bound = ("_step_groups", "z", "_pool")
        return {name: value for name, value in vars(self).items() if name not in bound}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a copy and bind its code to the memory."""
        vars(self).update(state)
        code, _ = compile_kernel(self.cranes, self._recipe, self._response)
        self._bind(code)

    def place(
        self, indices: np.ndarray, start: State | Sequence[State], crane: np.ndarray | None = None
    ) -> None:
        """Set the states, and optionally the kinds, of some cranes.

        Args:
            indices: Indices of the cranes to set, shape (k,).
            start: New states: one for all, k states, or one with k rows.
            crane: Index of the kind of each crane, shape (k,); None for the first.

        Raises:
            OutOfRange: If a number is not finite, or an index is out of range.
        """
        rows = _indices("index of a crane", indices, self.count)
        kinds = np.zeros(len(rows), dtype=int)
        if crane is not None:
            kinds = _indices("index of a kind of crane", crane, len(self.cranes))
        if len(kinds) != len(rows):
            allowed = f"{len(rows)}, one for each that is placed"
            raise OutOfRange("cranes chosen", len(kinds), allowed)
        self._put(rows, start_states(start, len(rows), self._sizes.n), kinds)

    def stand_on(
        self,
        indices: np.ndarray,
        bases: BaseMotion | Sequence[BaseMotion | None] | None,
        t: float | np.ndarray = 0.0,
    ) -> None:
        """Let some cranes stand on other bases.

        Coordinates and rates of the cranes, which are relative to their bases, stay as they are.

        Args:
            indices: Indices of the cranes, shape (k,).
            bases: Motion of the base of all of them, or k motions; None for a base at rest.
            t: Time at which a base is now [s], one for all or k; it goes on with each step.

        Raises:
            OutOfRange: If an index is out of range, one is no motion, there are not as many as
                cranes, a time is not finite, or the fleet has no bases that move.
        """
        if self.bases is None:
            allowed = "none, unless the fleet is made with base = True"
            raise OutOfRange("base", short_repr(bases), allowed)
        rows = _indices("index of a crane", indices, self.count)
        motions: list[BaseMotion | None]
        if bases is None or isinstance(bases, BaseMotion):
            motions = [bases] * len(rows)
        else:
            motions = list(bases)
        if len(motions) != len(rows):
            allowed = f"{len(rows)}, one for each crane"
            raise OutOfRange("bases", len(motions), allowed)
        times = finite("time of the base", t, (), (len(rows),), unit="s")
        self.bases.stand_on(rows, motions, np.broadcast_to(times, len(rows)))

    def push(self, indices: np.ndarray, force: np.ndarray) -> None:
        """Apply external forces to some cranes until they are changed.

        Args:
            indices: Indices of the cranes, shape (k,).
            force: Force in the world [N] on the points of each crane, the payload first, shape
                (k, 3 points).

        Raises:
            OutOfRange: If a number is not finite, an index is out of range, or the fleet has no
                external forces.
        """
        if not self._forces_act:
            allowed = "none, unless the fleet is made with forces = True"
            raise OutOfRange("forces from outside", short_repr(force), allowed)
        rows = _indices("index of a crane", indices, self.count)
        self._force[rows] = finite("force", force, (len(rows), size(self._sizes.force)), unit="N")

    def step(self, command: np.ndarray) -> np.ndarray:
        """Advance all cranes by a control period.

        Args:
            command: Efforts, clipped to the limits of the drives, accelerations, or rates, one
                column a crane, shape (drives, n).

        Returns:
            Coordinates and rates after the period, `z`; not finite for a crane that diverged.

        Raises:
            OutOfRange: If a command is not finite.
        """
        commands = finite("command", command, (self._sizes.m, self.count))
        self.spread(lambda chunk: self._advance(chunk, commands[:, self.chunks[chunk]]))
        return self.z

    def spread(self, work: Callable[[int], object]) -> None:
        """Run a function for the index of each chunk of cranes in threads, see `chunks`."""
        chunks = iter(range(len(self.chunks)))  # shared: each thread takes the next one

        def take_chunks() -> None:
            for chunk in chunks:
                work(chunk)

        futures = []
        if self._workers > 1:
            # A fork leaves threads behind: the child needs a pool of its own.
            if self._pool is None or self._process != os.getpid():
                self._pool = ThreadPoolExecutor(self._workers - 1)
                self._process = os.getpid()
            futures = [self._pool.submit(take_chunks) for _ in range(self._workers - 1)]
        try:
            take_chunks()
        finally:
            # Also after an exception: no thread may go on while the next step begins.
            wait(futures)
        for future in futures:
            future.result()

    def advance(self, chunk: int, command: np.ndarray) -> np.ndarray:
        """Advance one chunk, from a thread of `spread`; see `step`, with the columns of that chunk.

        Raises:
            OutOfRange: If there is no such chunk, or a command is not finite.
        """
        if whole("chunk", chunk, 0) >= len(self.chunks):
            raise OutOfRange("chunk", chunk, f"0 to {len(self.chunks) - 1}")
        columns = self.chunks[chunk]
        shape = self._sizes.m, columns.stop - columns.start
        self._advance(chunk, finite("command", command, shape))
        return self.z[:, columns]

    def _advance(self, chunk: int, command: np.ndarray) -> None:
        """Advance one chunk under checked commands, shape (m, cranes of the chunk)."""
        columns = self.chunks[chunk]
        if self.drive == "effort":
            limit = self._effort_limit[:, columns]
            command = np.clip(command, -limit, limit)
        if self._converters is not None:
            command = np.array(self._converters.response.quantize_commands(command))
        m, count = command.shape
        first = columns.start // self._lanes
        last = -(-columns.stop // self._lanes)
        commands = np.zeros((m, self._lanes * (last - first)))
        commands[:, :count] = command
        by_group = commands.reshape(m, last - first, self._lanes).transpose(1, 0, 2)

        # Commands wait for the delay of the converters, the first in front; without one they act at
        # once.
        state = self._state[first:last]
        delayed = self._columns.get("delayed_commands", slice(0, 0))
        waiting = np.concatenate([state[:, delayed], by_group], axis=1)
        state[:, self._columns["last_command"]] = waiting[:, :m]
        state[:, delayed] = waiting[:, m:]
        lanes = slice(self._lanes * first, self._lanes * last)
        if self.bases is not None:
            frames = self.bases.frames(lanes)
            self._root[lanes] = self.bases.root_numbers(frames)
            if self._forces_act:
                now = frames.rotation[:: self.bases.rows_per_period]
                self._force_in_base_axes[lanes] = self._turned_forces(now, lanes)
        self._step_groups(first, last)
        if self.bases is not None:
            self.bases.advance(lanes)
        self._z[:, first:last] = self._state[first:last, : len(self._z)].transpose(1, 0, 2)

    def _turned_forces(self, rotation: np.ndarray, lanes: slice) -> np.ndarray:
        """Return the external forces of some lanes in the axes of their bases [N], shape (lanes, 3
        points). They are held in these axes for a control period.

        Args:
            rotation: Attitude of the base of each lane, shape (lanes, 3, 3).
            lanes: The lanes.
        """
        in_world = self._force[lanes].reshape(lanes.stop - lanes.start, -1, 3)
        turned = np.einsum("kij,kpi->kpj", rotation, in_world)
        return turned.reshape(len(turned), -1)

    def _put(self, rows: np.ndarray, start: State, kinds: np.ndarray) -> None:
        """Set the states and kinds of cranes.

        Args:
            rows: Indices of the cranes, shape (k,); from `count` on, lanes that are left.
            start: New states, shape (k, n) each, or (1, n) for all.
            kinds: Index of the kind of each crane, shape (k,), or (1,) for all.
        """
        groups, lanes = np.divmod(rows, self._lanes)
        z = np.hstack(start)
        self._state[groups, :, lanes] = 0.0
        self._state[groups, : z.shape[1], lanes] = z
        memory = converter_memory(self._sizes, z[:, self._sizes.n + self.layout.drives])
        if memory:
            # The sections of the converters are the last of the state.
            first = self._columns["reference"].start
            self._state[groups, first:, lanes] = np.hstack(memory)
        self._numbers[groups, :, lanes] = self._parameters[kinds]
        self._z[:, groups, lanes] = z.T
        is_crane = rows < self.count
        limits = np.array([crane.effort_limit for crane in self.cranes])[kinds]
        limit_of_each = np.broadcast_to(limits, (len(rows), self._sizes.m))
        self._effort_limit[:, rows[is_crane]] = limit_of_each[is_crane].T


def _indices(name: str, values: np.ndarray, count: int) -> np.ndarray:
    """Check that values are whole numbers from 0 to below a count, and return them, shape (k,)."""
    indices = finite(name, values, ("k",))
    wrong = (indices != np.floor(indices)) | (indices < 0) | (indices >= count)
    if wrong.any():
        raise OutOfRange(name, float(indices[wrong][0]), f"a whole number from 0 to {count - 1}")
    return indices.astype(int)
