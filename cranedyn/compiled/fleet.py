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
from cranedyn.compiled.binding import Loop
from cranedyn.compiled.inputs import (
    check_fits_memory,
    common_layout,
    converter_memory,
    converter_response,
    start_states,
)
from cranedyn.compiled.kernel import Kernel, Recipe
from cranedyn.compiled.layout import BufferLayout, size, slices
from cranedyn.compiled.step import check_rule
from cranedyn.compiled.tables import RowTable, command_tables, single_table
from cranedyn.compiled.verify import compile_kernel
from cranedyn.dynamics.converters import Converters
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import DirectDrive, State
from cranedyn.model.crane import Crane

_LANES, _SHARE, _MOST = 8, 1500, 512
"""Cranes in a group; fewest steps of groups for which a thread is worth its start; most groups of a
chunk, whose numbers stay in a processor's cache."""


class Fleet:
    """Cranes that each take a command for a control period, and move as in `simulate` with validity
    = mark.

    All arguments are checked and copied, so that the code stays within its arrays.

    Attributes:
        layout: Layout of all cranes.
        z: Coordinates and rates, one column a crane, shape (2 joints, n); a read-only view that the
            next step updates.
        chunks: Slices of columns, each advanced by one thread at a time.
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
    ) -> None:
        """Create n cranes of the first kind, at its start.

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

        Raises:
            OutOfRange: If a number is out of range, there is no crane, one has another layout, they
                would not fit into 4 GB, or there is no code for the stepping rule.
            ModelError: If the code does not agree with Pinocchio.
        """
        kind, converters = ("velocity", drive) if isinstance(drive, Converters) else (drive, None)
        if converters is None:
            check_choice("drive", kind, DirectDrive)
        check_rule(integrator)
        self.cranes = [cranes] if isinstance(cranes, Crane) else list(cranes)
        if not self.cranes:
            raise OutOfRange("number of cranes to choose from", 0, "1 or more")
        self.layout = common_layout(self.cranes)
        self._clock = clocks(control_period, dt, control_period)
        numbers, delay_steps = converter_response(self.cranes[0], kind, converters, self._clock)
        self._sizes = sizes = BufferLayout.of(self.layout, delay_steps)
        self.count = whole("number of cranes", count, 1)
        self.control_period, self.drive = control_period, kind
        workers = worker_count("threads", threads)
        options: Any = {"forces": forces, "shared": (True, True, not forces)}
        self._recipe = Recipe(_LANES, kind, integrator, delay_steps=delay_steps, **options)
        self._converters = converters, numbers
        code, self._own = compile_kernel(self.cranes, self._recipe, numbers)
        groups, varied = -(-self.count // _LANES), code.source.varied
        numbers_of_each = 3 * size(sizes.state) + varied + size(sizes.force) + 10
        check_fits_memory("number of cranes", str(count), groups * _LANES * numbers_of_each)
        self._state = np.zeros((groups, size(sizes.state), _LANES))
        self._numbers = np.zeros((groups, varied, _LANES))
        self._force = np.zeros((groups * _LANES if forces else 1, size(sizes.force)))
        self._pushed, self._at = forces, slices(sizes.state)
        worthwhile = groups * self._clock.steps // _SHARE
        count_of_parts = max(min(workers, worthwhile), -(-groups // _MOST), 1)
        groups_of = np.linspace(0, groups, count_of_parts + 1).astype(int)
        ends = np.minimum(_LANES * groups_of, self.count).tolist()
        self.chunks = [slice(first, last) for first, last in pairwise(ends)]
        self._workers = min(workers, count_of_parts)
        self._z = np.empty((sizes.z, groups, _LANES))
        self._bind(code)
        self._limit = np.full((sizes.m, self.count), np.inf)
        start = State(*(rows[None] for rows in self.cranes[0].start))
        self._put(np.arange(groups * _LANES), start, np.zeros(1, dtype=int))

    def _bind(self, code: Kernel) -> None:
        """Bind code to the memory and create a view of it."""
        groups = len(self._state)
        memory: dict[str, Any] = {"state": self._state, "numbers": self._numbers}
        table = single_table(self._force)
        if self._pushed:
            table = RowTable(self._force, 1, np.arange(groups * _LANES))
            memory["starts"] = np.zeros((groups, 3, _LANES), dtype=np.int64)
            memory["starts"][:, 2] = table.starts.reshape(groups, _LANES)
        tables = (*map(single_table, command_tables(self._sizes)), table)
        loop = Loop(code, self._clock, tables, last=1, end=1, **memory)
        self._steps = loop.step_function()
        self.z = read_only(self._z.reshape(len(self._z), -1)[:, : self.count])
        self._pool, self._process = None, 0

    def __getstate__(self) -> dict[str, Any]:
        """Return all but what is bound to the memory, for a copy with its own memory."""
        bound = ("_steps", "z", "_pool")
        return {name: value for name, value in vars(self).items() if name not in bound}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a copy and bind its code to the memory."""
        vars(self).update(state)
        self._bind(compile_kernel(self.cranes, self._recipe, self._converters[1])[0])

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
        rows = _indices("which crane", indices, self.count)
        kinds = np.zeros(len(rows), dtype=int)
        if crane is not None:
            kinds = _indices("crane to choose", crane, len(self.cranes))
        if len(kinds) != len(rows):
            allowed = f"{len(rows)}, one for each that is placed"
            raise OutOfRange("cranes chosen", len(kinds), allowed)
        self._put(rows, start_states(start, len(rows), self._sizes.n), kinds)

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
        if not self._pushed:
            allowed = "none, unless the fleet is made with forces = True"
            raise OutOfRange("forces from outside", short_repr(force), allowed)
        rows = _indices("which crane", indices, self.count)
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
        chunks = iter(range(len(self.chunks)))  # of which each thread takes the next

        def take_chunks() -> None:
            for chunk in chunks:
                work(chunk)

        if self._workers > 1 and (self._pool is None or self._process != os.getpid()):
            # A fork leaves threads behind.
            self._pool, self._process = ThreadPoolExecutor(self._workers - 1), os.getpid()
        futures = [self._pool.submit(take_chunks) for _ in range(self._workers - 1) if self._pool]
        try:
            take_chunks()
        finally:
            wait(futures)  # whatever happens: none may go on while the next step begins
        for future in futures:
            future.result()

    def advance(self, chunk: int, command: np.ndarray) -> np.ndarray:
        """Advance one chunk, from a thread of `spread`; see `step`, with the columns of that chunk.

        Raises:
            OutOfRange: If there is no such chunk, or a command is not finite.
        """
        if whole("part", chunk, 0) >= len(self.chunks):
            raise OutOfRange("part", chunk, f"0 to {len(self.chunks) - 1}")
        columns = self.chunks[chunk]
        shape = self._sizes.m, columns.stop - columns.start
        self._advance(chunk, finite("command", command, shape))
        return self.z[:, columns]

    def _advance(self, chunk: int, command: np.ndarray) -> None:
        columns = self.chunks[chunk]
        if self.drive == "effort":
            command = np.clip(command, -self._limit[:, columns], self._limit[:, columns])
        first, last = columns.start // _LANES, -(-columns.stop // _LANES)
        if (converters := self._converters[0]) is not None:
            command = np.array(converters.response.heard(command))
        commands = np.zeros((len(command), _LANES * (last - first)))
        commands[:, : command.shape[1]] = command
        by_group = commands.reshape(len(command), -1, _LANES).transpose(1, 0, 2)
        state, unheard = self._state[first:last], self._at.get("unheard", slice(0, 0))
        waiting = np.concatenate([state[:, unheard], by_group], axis=1)
        state[:, self._at["last_command"]] = waiting[:, : len(command)]
        state[:, unheard] = waiting[:, len(command) :]
        self._steps(first, last)
        self._z[:, first:last] = self._state[first:last, : len(self._z)].transpose(1, 0, 2)

    def _put(self, rows: np.ndarray, start: State, kinds: np.ndarray) -> None:
        groups, lanes = np.divmod(rows, _LANES)
        z = np.hstack(start)
        self._state[groups, :, lanes] = 0.0
        self._state[groups, : z.shape[1], lanes] = z
        memory = converter_memory(self._sizes, z[:, self._sizes.n + self.layout.drives])
        if memory:  # the last sections of the state
            self._state[groups, self._at["reference"].start :, lanes] = np.hstack(memory)
        self._numbers[groups, :, lanes] = self._own[kinds]
        self._z[:, groups, lanes] = z.T
        inside = rows < self.count
        limits = np.array([crane.effort_limit for crane in self.cranes])[kinds]
        self._limit[:, rows[inside]] = np.broadcast_to(limits, (len(rows), self._sizes.m))[inside].T


def _indices(name: str, values: np.ndarray, count: int) -> np.ndarray:
    """Check that values are whole numbers from 0 to below a count, and return them, shape (k,)."""
    indices = finite(name, values, ("k",))
    wrong = (indices != np.floor(indices)) | (indices < 0) | (indices >= count)
    if wrong.any():
        raise OutOfRange(name, float(indices[wrong][0]), f"a whole number from 0 to {count - 1}")
    return indices.astype(int)
