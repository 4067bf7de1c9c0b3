"""Binding of compiled code to arrays: the only module that passes addresses to it.

Shapes, types and counts are checked once, when a function is bound to its arrays. Numbers must be
finite, except for the state, which may diverge. Long runs are called in pieces, between which
Python handles Ctrl-C.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, NamedTuple, NoReturn

import numpy as np

from cranedyn.checks import number, whole
from cranedyn.compiled.layout import SLOTS, TURNS, size
from cranedyn.errors import CraneError, Misshapen, OutOfRange

if TYPE_CHECKING:
    from cranedyn.clocks import Clocks
    from cranedyn.compiled.horizon.memory import Programme
    from cranedyn.compiled.kernel import Kernel
    from cranedyn.compiled.machine import Machine
    from cranedyn.compiled.tables import RowTable

_PIECE = 100_000
"""Physics steps, or rows, of one call, after which Python handles Ctrl-C: some tenths of a second
for eight cranes at once."""

_INSTANT = 4
"""Cost of control and log at an instant, in steps."""

_WRITTEN = frozenset(("state", "readings", "summary", "log", "horizon"))
"""Arrays that code writes to."""

_PIECE_SLOTS = [SLOTS[name] for name in ("first", "last", "steps", "resumed")]

_TIME_SLOTS = [SLOTS[name] for name in ("dt", "period")]

COLUMN_LANES = 8, 1
"""Columns of a group, and of those that fill none."""

_STAGE = 4
"""Largest cost of a stage of an optimisation of one crane, in steps: some microseconds."""


def _address(
    name: str,
    array: object,
    shape: tuple[int, ...],
    kind: type = np.float64,
    *,
    written: bool = False,
) -> int:
    """Return the address of an array after checking its type, shape and memory order.

    Raises:
        Misshapen: If it is anything else.
    """
    if isinstance(array, np.ndarray):
        flags = array.flags
        stored = flags.c_contiguous and flags.aligned and (flags.writeable or not written)
        if stored and array.shape == shape and array.dtype == kind:
            return array.__array_interface__["data"][0]  # quicker than `array.ctypes`
        ending = "" if flags.c_contiguous else ", not contiguous"
        description = f"an array of {array.dtype.name} of shape {array.shape}{ending}"
    else:
        description = type(array).__name__
    ending = ", that can be written to" if written else ""
    allowed = f"an array of {kind.__name__} of shape {shape}, contiguous{ending}"
    raise Misshapen(name, description, allowed)


def _check_finite(name: str, array: np.ndarray, *, infinite: bool = False) -> None:
    """Check that every number is finite, or only not NaN.

    Raises:
        OutOfRange: If not.
    """
    wrong = np.isnan(array) if infinite else ~np.isfinite(array)
    if wrong.any():
        raise OutOfRange(name, float(array[wrong][0]), "a number" if infinite else "finite")


def aligned_copy(numbers: np.ndarray) -> np.ndarray:
    """Return a copy of doubles that begins where a line of the cache begins."""
    space = np.empty(len(numbers) + 8)
    copy = space[-space.ctypes.data // 8 % 8 :][: len(numbers)]
    copy[:] = numbers
    return copy


class RowFunction:
    """Compiled function that maps each row of numbers, and numbers that rows share, to a row of
    results.
    """

    def __init__(
        self, machine: Machine, name: str, width_in: int, width_out: int, shared: int = 0
    ) -> None:
        """Bind a function of a module by its name, with the numbers that it reads and writes for
        each row, and those that rows share.
        """
        self._machine, self._run = machine, machine.function(name, 4)
        self._given, self._answered, self._shared = width_in, width_out, shared

    def __call__(self, rows: np.ndarray, shared: np.ndarray = np.empty(0)) -> np.ndarray:  # noqa: B008
        """Return the results for rows, shape (n, width_in), in rows, shape (n, width_out).

        Raises:
            Misshapen: If the rows or the shared numbers are of another length, or no contiguous
                doubles.
        """
        answers, count = np.empty((len(rows), self._answered)), np.empty(1, dtype=np.int64)
        common = _address("shared", shared, (self._shared,))
        for first in range(0, len(rows), _PIECE):
            row_chunk, answer_chunk = (array[first : first + _PIECE] for array in (rows, answers))
            count[0] = len(row_chunk)
            self._run(
                _address("rows", row_chunk, (len(row_chunk), self._given)),
                count.ctypes.data,
                _address("answers", answer_chunk, (len(row_chunk), self._answered)),
                common,
            )
        return answers

    def bind_row(self) -> tuple[np.ndarray, np.ndarray, Callable[[], None]]:
        """Return memory of a row and its results, and a function that computes these quickly."""
        row, answers = np.zeros(self._given), np.zeros(self._answered)
        arrays = row, np.ones(1, dtype=np.int64), answers, np.zeros(self._shared)
        run = partial(self._run, *(array.ctypes.data for array in arrays))
        run.kept = self._machine, arrays  # type: ignore[attr-defined]  # by no address
        return row, answers, run


class ColumnFunction:
    """Compiled function that maps columns of numbers to columns of results."""

    def __init__(self, machine: Machine, widths: Sequence[int]) -> None:
        """Bind the functions of a module, with the rows of each array, the results last."""
        self._runs = [machine.function(f"columns_{lanes}", 1) for lanes in COLUMN_LANES]
        self._machine, self._widths = machine, widths

    def __call__(self, *blocks: np.ndarray) -> np.ndarray:
        """Return the results for arrays with a column each, shape (width, n).

        Raises:
            Misshapen: If an array has another shape or is not of doubles.
        """
        count = blocks[0].shape[1]
        arrays = [*map(np.ascontiguousarray, blocks), np.empty((self._widths[-1], count))]
        pairs = zip(arrays, self._widths, strict=True)
        starts = [(_address("columns", a, (width, count)), width) for a, width in pairs]
        rows = [start + 8 * count * i for start, width in starts for i in range(width)]
        done = 0
        for lanes, run in zip(COLUMN_LANES, self._runs, strict=True):
            if done < count:
                call = np.array([done // lanes, count // lanes, *rows])
                run(call.__array_interface__["data"][0])
                done = count // lanes * lanes
        return arrays[-1]


def kernel_accelerations(code: Kernel, query: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Return the accelerations by the code of a crane at one state in each lane, shape (n, lanes).

    Args:
        code: The code.
        query: q, v, command and force, see `BufferLayout.query`, shape (numbers, lanes).
        numbers: The varied numbers, shape (varied, lanes).
    """
    source, lanes = code.source, code.source.recipe.lanes
    result = np.empty((source.sizes.n, lanes))
    code.machine.function("answer", 3)(
        _address("given", query, (size(source.sizes.query), lanes)),
        _address("numbers", numbers, (source.varied, lanes)),
        result.ctypes.data,
    )
    return result


class Instant:
    """Control instant of a predictive controller, bound to the memory of one crane."""

    def __init__(self, machine: Machine, memory: np.ndarray, programme: Programme) -> None:
        """Check the memory and bind the function to it.

        Raises:
            Misshapen: If it is of another size, or no contiguous doubles.
        """
        layout, size = programme.topology.layout, programme.offsets(1).size
        self._numbers = 2 * layout.n + layout.m
        self._given, self._command = np.zeros(self._numbers + 2), np.zeros(layout.m)
        self._counts = self._given[self._numbers :].view(np.int64)
        self._run, self._kept = machine.function("instant", 3), (machine, memory)
        self._addresses = (
            _address("memory", memory, (size,), written=True),
            self._given.ctypes.data,
            self._command.ctypes.data,
        )

    def __reduce__(self) -> NoReturn:
        """Refuse to be copied: the addresses would still be those of the original memory."""
        raise CraneError("Code that is bound to memory cannot be copied.")

    def __call__(self, numbers: np.ndarray, row: int, due: bool) -> np.ndarray:
        """Return the command for coordinates, rates and a setpoint of the drives, all in a row; row
        is that of the path, due says whether to optimise.

        Raises:
            Misshapen: If there are more or fewer numbers.
            OutOfRange: If one is not finite.
        """
        if numbers.shape != (self._numbers,):
            raise Misshapen("state and setpoint", f"{numbers.size} numbers", f"{self._numbers}")
        _check_finite("state and setpoint", numbers)
        self._given[: self._numbers] = numbers
        self._counts[:] = whole("row", row, 0), due
        self._run(*self._addresses)
        return self._command.copy()


class _Bound(NamedTuple):
    """Array, its address, the distance from group to group [byte], and whether code writes it."""

    array: np.ndarray
    address: int
    stride: int
    written: bool


class Loop:
    """Closed loop bound to its arrays, for some groups of lanes."""

    def __init__(
        self,
        code: Kernel,
        clock: Clocks,
        tables: Sequence[RowTable],
        *,
        last: int,
        end: int,
        first: int = 0,
        force_interval: int = 1,
        log_interval: int = 1,
        residual_from: int = 0,
        reading_count: int = 0,
        workspace: np.ndarray | None = None,
        **memory: np.ndarray,
    ) -> None:
        """Check all arrays and counts, and bind the loop to them.

        Args:
            code: The code.
            clock: How the run is divided.
            tables: Gain table, setpoint table, forces, and sensor offsets, as far as the code has
                them.
            last: Control instant after the last.
            end: Instant that no steps follow.
            first: First control instant.
            force_interval: Control instants from one row of the forces to the next.
            log_interval: The same of the log.
            residual_from: Instant from which swing counts as residual.
            reading_count: Number of readings stored for delayed sensors.
            workspace: Path and memory of optimisations for several lanes, of which each call of
                `run_groups` has a copy; for one lane they stand in the memory of the controller.
            memory: Arrays with the group as first axis: state, numbers, starts of the tables, delay
                and readings of sensors, summary, log, as far as the code has them.

        Raises:
            OutOfRange: If an array has another type or shape, or a number is not finite.
        """
        recipe, lanes, sizes = code.source.recipe, code.source.recipe.lanes, code.sizes
        self._instant = _INSTANT
        if (programme := recipe.programme) is not None:
            self._instant += -(-_STAGE * programme.stages * lanes // programme.ratio)
        self._first = whole("first", first, 0)
        self._last, self._end = whole("control instants", last, first + 1), whole("end", end, 0)
        self._steps = whole("steps", clock.steps, 1)
        substeps = whole("small steps", clock.substeps, 1)
        self._weight = substeps if recipe.buffers and recipe.integrator.smooth else 1
        self._machine, self._groups, self._lanes = code.machine, len(memory["state"]), lanes
        self._run = code.machine.function("run", 1)
        self._call = np.zeros(len(SLOTS), dtype=np.int64)
        self._arrays = dict[str, _Bound]()
        counts = {
            "end": end,
            "substeps": substeps,
            "force_interval": whole("force_interval", force_interval, 1),
            "log_interval": whole("log_interval", log_interval, 1),
            "residual_from": whole("residual_from", residual_from, 0),
            "reading_count": whole("reading_count", reading_count, int(recipe.delayed)),
        }
        self._call[[SLOTS[name] for name in counts]] = [*counts.values()]
        times = number("dt", clock.dt, "s", "> 0"), number("period", clock.period, "s", "> 0")
        self._call.view(np.float64)[_TIME_SLOTS] = times
        horizon, self._workspace = 0, workspace
        if programme is not None:
            offsets = programme.offsets(lanes)
            horizon = offsets.size if lanes == 1 else offsets.path
        if horizon and lanes > 1:
            address = _address("workspace", workspace, (offsets.size - horizon,), written=True)
            self._call[SLOTS["workspace"]] = address
        row_interval = 1 if recipe.ledger else log_interval
        row_width = ((self._last - 1) // row_interval + 1) * size(sizes.row)
        shapes: dict[str, tuple[int, ...]] = {
            "state": (size(sizes.state), lanes),
            "numbers": (code.source.varied, lanes),
            "readings": (reading_count * sizes.z * recipe.delayed, lanes),
            "summary": (size(sizes.summary) * recipe.summary, lanes),
            "log": (row_width * recipe.log, lanes),
            "delay": (int(recipe.delayed), lanes),
            "horizon": (horizon,),
            "starts": (0 if all(recipe.shared) else len(recipe.shared), lanes),
        }
        for name, shape in shapes.items():
            if shape[0]:
                self._bind(name, memory[name], (self._groups, *shape))
        if code.source.varied:
            _check_finite("numbers", memory["numbers"], infinite=True)
        if recipe.delayed:
            first, final = int(memory["delay"].min()), int(memory["delay"].max())
            if first < 0 or final >= reading_count:
                allowed = f"0 to {reading_count - 1}"
                raise OutOfRange("delay", f"{first} to {final}", allowed, "control periods")
        columns = {
            "gain_table": sizes.gain_table,
            "setpoint_table": sizes.setpoint_table,
            "force": sizes.force,
            "offset": sizes.offset,
        }
        bound_tables = zip(columns.items(), tables, recipe.shared, strict=False)
        for i, ((name, sections), table, shared) in enumerate(bound_tables):
            starts = None if shared else memory["starts"][:, i]
            self._bind_table(name, table, size(sections), starts)

    def _bind(self, name: str, array: np.ndarray, shape: tuple[int, ...]) -> None:
        written = name in _WRITTEN
        kind = np.int64 if name in ("delay", "starts") else np.float64
        address = _address(name, array, shape, kind, written=written)
        self._arrays[name] = _Bound(array, address, array.strides[0], written)

    def _bind_table(
        self, name: str, table: RowTable, columns: int, starts: np.ndarray | None
    ) -> None:
        total, length = len(table.rows), whole(f"rows of {name}", table.length, 1)
        first, final = (0, 0) if starts is None else (int(starts.min()), int(starts.max()))
        if first < 0 or final + length > total:
            given = f"one of {total} rows, read from {first} to {final + length}"
            raise Misshapen(f"rows of {name}", given, "to read what is in it")
        address = _address(f"rows of {name}", table.rows, (total, columns))
        self._arrays[name] = _Bound(table.rows, address, 0, False)
        self._call[SLOTS[f"{name}_rows"]] = length
        # Limits of a gain table may be infinite.
        _check_finite(f"rows of {name}", table.rows, infinite=name == "gain_table")

    __reduce__ = Instant.__reduce__

    def __len__(self) -> int:
        """Return the number of groups."""
        return self._groups

    def _pieces(self, piece: int) -> Iterator[tuple[int, int, int, bool]]:
        """Yield pieces of about so many steps: first instant, instant after the last, steps of
        each, and whether the control of the first instant has already run.
        """
        together = piece // (self._steps * self._weight + self._instant)
        if together:
            for first in range(self._first, self._last, together):
                yield first, min(first + together, self._last), self._steps, False
            return
        together = TURNS * max(1, piece // (TURNS * self._weight))
        for instant in range(self._first, self._last):
            for done in range(0, self._steps if instant < self._end else 1, together):
                yield instant, instant + 1, min(together, self._steps - done), done > 0

    def run_groups(self, groups: Iterable[int], stopped: Callable[[], bool] = bool) -> None:
        """Run some groups, one after another, until stopped between two pieces."""
        call = self._call.copy()
        address = call.ctypes.data
        if self._workspace is not None:
            workspace = aligned_copy(self._workspace)
            call[SLOTS["workspace"]] = workspace.ctypes.data
        for group in groups:
            if not 0 <= group < self._groups:
                raise OutOfRange("group", group, f"0 to {self._groups - 1}")
            self._point_to(call, group)
            for piece in self._pieces(_PIECE):
                if stopped():
                    return
                call[_PIECE_SLOTS] = piece
                self._run(address)

    def _point_to(self, call: np.ndarray, group: int | np.ndarray) -> None:
        """Set the addresses of a call, or of calls in rows, to the memory of a group."""
        for name, bound in self._arrays.items():
            call[..., SLOTS[name]] = bound.address + group * bound.stride

    def device_calls(
        self, upload: Callable[[np.ndarray, bool], int], strides: Sequence[str], max_steps: int
    ) -> Iterator[np.ndarray]:
        """Yield the arguments of one call for each piece of the run, for a device with its own
        memory.

        Args:
            upload: Puts an array into that memory and answers its address there; it is told whether
                the code writes to it.
            strides: Whose strides, from group to group, stand behind the slots of each call
                [numbers].
            max_steps: Steps of all cranes together in a piece, or those of one control instant.
        """
        call = np.concatenate([self._call, np.zeros(len(strides), dtype=np.int64)])
        for name, bound in self._arrays.items():
            call[SLOTS[name]] = upload(bound.array, bound.written)
            if bound.stride:
                call[len(SLOTS) + strides.index(name)] = bound.stride // bound.array.itemsize
        cranes = self._groups * self._lanes
        for piece in self._pieces(min(_PIECE, max(1, max_steps // cranes))):
            call[_PIECE_SLOTS] = piece
            yield call

    def bind_calls(self) -> tuple[Callable[[], None], Callable[[], None]]:
        """Return functions of one group that run all, which with one piece has the least overhead,
        and the control of the first instant alone.
        """
        piece, *later = islice(self._pieces(_PIECE), 2)
        calls = np.repeat(self._call[None], 2, axis=0)
        self._point_to(calls, 0)
        calls[:, _PIECE_SLOTS] = piece
        calls[1, SLOTS["end"]] = self._first
        run, control = (partial(self._run, call.ctypes.data) for call in calls)
        control.kept = run.kept = self, calls  # type: ignore[attr-defined]  # by no address
        return partial(self.run_groups, [0]) if later else run, control

    def step_function(self) -> Callable[[int, int], None]:
        """Return a function that advances a range of groups by one control period under the
        commands in their states.

        One call handles many groups and takes some tenths of a second at most.

        Raises:
            OutOfRange: If a period has too many steps for that.
        """
        groups_per_call = _PIECE // (self._steps * self._weight)
        if not groups_per_call:
            allowed = f"{_PIECE // self._weight} or less"
            raise OutOfRange("steps in a control period", self._steps, allowed)
        run = self._machine.function("several", 2)
        calls = np.repeat(self._call[None], self._groups, axis=0)
        self._point_to(calls, np.arange(self._groups))
        calls[:, _PIECE_SLOTS] = 0, 1, self._steps, 1

        def over(first: int, last: int) -> None:
            if not 0 <= first <= last <= self._groups:
                raise OutOfRange("groups", f"{first} to {last}", f"0 to {self._groups}")
            for begin in range(first, last, groups_per_call):
                chunk = calls[begin : min(begin + groups_per_call, last)]
                count = np.array([len(chunk)])
                run(chunk.ctypes.data, count.ctypes.data)

        return over
