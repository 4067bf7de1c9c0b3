"""Binding of compiled code to arrays: the only module that passes addresses to it.

Compiled code trusts the addresses and counts that it is given, so one wrong shape would read or
write beside an array. Shapes, types and counts are therefore checked here, once, when a function is
bound to its arrays. Numbers must be finite, except for the state, which may diverge.

There is one class for each kind of function:

* `BoundKernel`: the closed loop of `cranedyn.compiled.kernel`, over groups of lanes.
* `Instant`: a control instant of a predictive controller, for one crane.
* `RowFunction` and `ColumnFunction`: functions of arrays, see `cranedyn.compiled.rows`.

Python handles Ctrl-C only between two calls of compiled code. A long run is therefore divided into
pieces of some tenths of a second, a call each, see `BoundKernel._pieces`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np

from cranedyn.checks import number, whole
from cranedyn.compiled.memory_layout import ANGLE_REFRESH_STEPS, SLOTS, TABLES, size
from cranedyn.compiled.team import TEAM, teams_of
from cranedyn.dynamics.root_motion import ROOT_NUMBERS, SAMPLES_PER_STEP
from cranedyn.errors import CraneError, Misshapen, OutOfRange

if TYPE_CHECKING:
    from cranedyn.clocks import Clocks
    from cranedyn.compiled.horizon.memory import Programme
    from cranedyn.compiled.kernel import Kernel, KernelOptions
    from cranedyn.compiled.loop_tables import RowTable
    from cranedyn.compiled.machine import Machine

_MAX_STEPS_PER_CALL = 100_000
"""Physics steps, or rows, of one call, after which Python handles Ctrl-C: some tenths of a second
for eight cranes at once."""

_INSTANT_COST = 4
"""Time that control and log take at a control instant, in physics steps; estimated."""

_STAGE_COST = 4
"""Longest time that one stage of an optimisation of one crane takes, in physics steps: some
microseconds; estimated."""

COLUMN_LANES = (8, 1)
"""Columns that a function of columns handles at once: groups of eight, then the rest one by one."""

_BYTES_PER_DOUBLE = 8

_DOUBLES_PER_CACHE_LINE = 8
"""Doubles in a line of the cache, which has 64 bytes on the processors of today."""

_WRITTEN_ARRAYS = frozenset(("state", "readings", "summary", "log", "horizon"))
"""Arrays that the code of a loop writes to."""

_INTEGER_ARRAYS = frozenset(("delay", "starts", "root_starts"))
"""Arrays of a loop that hold whole numbers, all others being of doubles."""

_NO_SHARED_NUMBERS = np.empty(0)


def _never() -> bool:
    """Return False: a run that nothing stops."""
    return False


def _bound_call(
    function: Callable[..., None], addresses: Iterable[int], kept: object
) -> Callable[[], None]:
    """Return a function without arguments that calls machine code with addresses.

    An address keeps no memory alive. The returned function itself holds on to `kept`, what the
    addresses point to. It is a `partial`, which takes less time to call than a function of Python.
    """
    call = partial(function, *addresses)
    call.kept = kept  # type: ignore[attr-defined]
    return call


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
        Misshapen: If the array is anything else, or is written to and read-only.
    """
    if isinstance(array, np.ndarray):
        flags = array.flags
        stored = flags.c_contiguous and flags.aligned and (flags.writeable or not written)
        if stored and array.shape == shape and array.dtype == kind:
            # Takes less time than `array.ctypes.data`, which makes an object of ctypes first.
            return array.__array_interface__["data"][0]
        order = "" if flags.c_contiguous else ", not contiguous"
        given = f"an array of {array.dtype.name} of shape {array.shape}{order}"
    else:
        given = type(array).__name__
    access = ", that can be written to" if written else ""
    allowed = f"an array of {kind.__name__} of shape {shape}, contiguous{access}"
    raise Misshapen(name, given, allowed)


def _check_finite(name: str, array: np.ndarray, *, allow_infinite: bool = False) -> None:
    """Check that no number of an array is NaN and, unless it is allowed, that none is infinite.

    Raises:
        OutOfRange: If one is.
    """
    wrong = np.isnan(array) if allow_infinite else ~np.isfinite(array)
    if wrong.any():
        allowed = "a number" if allow_infinite else "finite"
        raise OutOfRange(name, float(array[wrong][0]), allowed)


def _refuse_to_copy() -> NoReturn:
    """Refuse to copy or pickle bound code, since the addresses would still be those of the original
    memory.
    """
    raise CraneError("Code that is bound to memory cannot be copied.")


def aligned_copy(numbers: np.ndarray) -> np.ndarray:
    """Return a copy of doubles, shape (n,), that begins where a line of the cache begins, so that
    no vector of its first numbers crosses the end of a line.
    """
    space = np.empty(len(numbers) + _DOUBLES_PER_CACHE_LINE)
    place = space.ctypes.data // _BYTES_PER_DOUBLE
    to_next_line = -place % _DOUBLES_PER_CACHE_LINE
    copy = space[to_next_line : to_next_line + len(numbers)]
    copy[:] = numbers
    return copy


class RowFunction:
    """Compiled function that maps each row of numbers, and numbers that all rows share, to a row of
    results.
    """

    def __init__(
        self, machine: Machine, name: str, width_in: int, width_out: int, shared: int = 0
    ) -> None:
        """Bind a function of a module.

        Args:
            machine: The module.
            name: Name of the function.
            width_in: How many numbers the function reads of each row.
            width_out: How many results the function writes for each row.
            shared: How many numbers all rows share.
        """
        self._machine = machine
        self._run = machine.function(name, 4)
        self._width_in = width_in
        self._width_out = width_out
        self._shared_count = shared

    def __call__(self, rows: np.ndarray, shared: np.ndarray = _NO_SHARED_NUMBERS) -> np.ndarray:
        """Return the results for rows, shape (n, width_in), in rows, shape (n, width_out).

        Raises:
            Misshapen: If the rows or the shared numbers are of another length, or no contiguous
                doubles.
        """
        results = np.empty((len(rows), self._width_out))
        count = np.empty(1, dtype=np.int64)
        shared_address = _address("shared", shared, (self._shared_count,))
        for first in range(0, len(rows), _MAX_STEPS_PER_CALL):
            row_chunk = rows[first : first + _MAX_STEPS_PER_CALL]
            result_chunk = results[first : first + _MAX_STEPS_PER_CALL]
            count[0] = len(row_chunk)
            self._run(
                _address("rows", row_chunk, (len(row_chunk), self._width_in)),
                count.ctypes.data,
                _address("results", result_chunk, (len(row_chunk), self._width_out)),
                shared_address,
            )
        return results

    def bind_row(self) -> tuple[np.ndarray, np.ndarray, Callable[[], None]]:
        """Return memory of one row and of its results, and a function that computes these without
        any check, for callers to whom microseconds matter. Shared numbers are zero.
        """
        row = np.zeros(self._width_in)
        results = np.zeros(self._width_out)
        arrays = (row, np.ones(1, dtype=np.int64), results, np.zeros(self._shared_count))
        addresses = [array.ctypes.data for array in arrays]
        return row, results, _bound_call(self._run, addresses, (self._machine, arrays))


class ColumnFunction:
    """Compiled function that maps columns of numbers to columns of results.

    It handles all columns in one call, which Ctrl-C does not interrupt.
    """

    def __init__(self, machine: Machine, widths: Sequence[int]) -> None:
        """Bind the functions of a module, one for each of `COLUMN_LANES`.

        Args:
            machine: The module.
            widths: Number of rows of each array that it reads, and last that of the results.
        """
        self._machine = machine
        self._runs = [machine.function(f"columns_{lanes}", 1) for lanes in COLUMN_LANES]
        self._widths = widths

    def __call__(self, *blocks: np.ndarray) -> np.ndarray:
        """Return the results, shape (width, n), for arrays of n columns each, shape (width, n).

        Raises:
            Misshapen: If an array has another shape or is not of doubles.
        """
        count = blocks[0].shape[1]
        results = np.empty((self._widths[-1], count))
        arrays = [*map(np.ascontiguousarray, blocks), results]
        row_addresses = []
        for array, width in zip(arrays, self._widths, strict=True):
            start = _address("columns", array, (width, count))
            for i in range(width):
                row_addresses.append(start + _BYTES_PER_DOUBLE * count * i)
        # First the columns in groups of eight, then those that are left.
        done = 0
        for lanes, run in zip(COLUMN_LANES, self._runs, strict=True):
            if done < count:
                first_group = done // lanes
                last_group = count // lanes
                call = np.array([first_group, last_group, *row_addresses])
                run(call.__array_interface__["data"][0])
                done = last_group * lanes
        return results


def kernel_accelerations(code: Kernel, query: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Return the accelerations that the code of a crane computes at one state in each lane.

    Args:
        code: The code.
        query: Coordinates, rates, command and force, see `BufferLayout.query`, shape (numbers,
            lanes).
        numbers: Crane parameters that differ between the lanes, shape (varied, lanes).

    Returns:
        Accelerations of all joints [rad/s² or m/s²], shape (n, lanes).
    """
    source = code.source
    lanes = source.options.lanes
    result = np.empty((source.sizes.n, lanes))
    code.machine.function("accelerate", 3)(
        _address("query", query, (size(source.sizes.query), lanes)),
        _address("numbers", numbers, (source.varied, lanes)),
        result.ctypes.data,
    )
    return result


class Instant:
    """Control instant of a predictive controller, bound to the memory of one crane."""

    def __init__(self, machine: Machine, memory: np.ndarray, programme: Programme) -> None:
        """Check the memory and bind the function to it.

        Raises:
            Misshapen: If the memory is of another size, or no contiguous doubles.
        """
        drives = programme.topology.layout.m
        # Coordinates, rates and setpoint, and behind them two whole numbers.
        self._number_count = 2 * programme.crane_joints + drives
        self._query = np.zeros(self._number_count + 2)
        self._row_and_due = self._query[self._number_count :].view(np.int64)
        self._command = np.zeros(drives)
        self._run = machine.function("instant", 3)
        self._addresses = (
            _address("memory", memory, (programme.offsets(1).size,), written=True),
            self._query.ctypes.data,
            self._command.ctypes.data,
        )
        self._kept = (machine, memory)  # which no address keeps alive

    def __reduce__(self) -> NoReturn:
        """Refuse to be copied."""
        _refuse_to_copy()

    def __call__(self, numbers: np.ndarray, row: int, due: bool) -> np.ndarray:
        """Return the command of the drives, shape (m,).

        Args:
            numbers: Coordinates and rates of the crane, and setpoint of the drives, one after
                another, shape (2 crane_joints + m,).
            row: Present row of the path.
            due: Whether to optimise.

        Raises:
            Misshapen: If there are more or fewer numbers.
            OutOfRange: If one is not finite.
        """
        if numbers.shape != (self._number_count,):
            given = f"{numbers.size} numbers"
            raise Misshapen("state and setpoint", given, f"{self._number_count}")
        _check_finite("state and setpoint", numbers)
        self._query[: self._number_count] = numbers
        self._row_and_due[:] = whole("row", row, 0), due
        self._run(*self._addresses)
        return self._command.copy()


class _BoundArray(NamedTuple):
    """Array whose address is passed to the code of a loop.

    Attributes:
        array: The array.
        address: Address of the memory of the first group.
        stride: Distance from the memory of a group to that of the next [byte]; 0 for a table, which
            all groups share.
        written: Whether the code writes to it.
    """

    array: np.ndarray
    address: int
    stride: int
    written: bool


class _Piece(NamedTuple):
    """Part of a run that is done in one call; its fields are slots of the call.

    Attributes:
        first: First control instant.
        last: Control instant after the last.
        steps: Physics steps that follow each of its instants.
        resumed: Whether the control of the first instant has already run.
        done: Physics steps of the first control period that earlier pieces have taken.
    """

    first: int
    last: int
    steps: int
    resumed: bool
    done: int = 0


_PIECE_SLOTS = [SLOTS[name] for name in _Piece._fields]
"""Slots of a call that differ from piece to piece."""


class BoundKernel:
    """Closed loop bound to its arrays, for some groups of lanes.

    `run_groups` runs it, from Python or from several threads at once, each for other groups. The
    other methods serve callers with needs of their own: `bind_calls` a run whose controller is
    Python, `step_function` a fleet, and `device_calls` a GPU.
    """

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
        state: np.ndarray,
        numbers: np.ndarray | None = None,
        starts: np.ndarray | None = None,
        delay: np.ndarray | None = None,
        readings: np.ndarray | None = None,
        summary: np.ndarray | None = None,
        log: np.ndarray | None = None,
        horizon: np.ndarray | None = None,
        workspace: np.ndarray | None = None,
        root: RowTable | None = None,
        root_starts: np.ndarray | None = None,
    ) -> None:
        """Check all arrays and counts, and bind the loop to them.

        The arrays have the group as first axis and, except for `horizon`, the lane as last; each
        may be None where the code does not use it.

        Args:
            code: The code.
            clock: How the run is divided.
            tables: The tables, in the order of `TABLES`: gains, setpoints, forces, and the offsets
                of the sensors if they add some.
            last: Control instant after the last.
            end: Instant that no steps follow.
            first: First control instant.
            force_interval: Control instants from one row of the forces to the next.
            log_interval: Control instants from one row of the log to the next.
            residual_from: Instant from which swing counts as residual.
            reading_count: Number of readings stored for delayed sensors.
            state: State of the cranes, see `BufferLayout.state`.
            numbers: Crane parameters that differ between the lanes.
            starts: First row of each lane's part of each table, whole numbers.
            delay: Delay of the sensors [control periods], whole numbers.
            readings: Memory of the readings of delayed sensors.
            summary: Summary of the run, see `BufferLayout.summary`.
            log: Rows of the log, see `BufferLayout.row`.
            horizon: Memory of a predictive controller, shape (groups, doubles).
            workspace: Path and memory of optimisations for several lanes, of which each call of
                `run_groups` has a copy; for one lane they stand in the memory of the controller.
            root: Motion of the base, a row for each half physics step from the control instant 0
                on, see `cranedyn.dynamics.root_motion.RootMotion`; None for a base at rest.
            root_starts: First row of each lane's part of it, whole numbers; None where all lanes
                stand on one base.

        Raises:
            Misshapen: If an array is missing, or has another type or shape.
            OutOfRange: If a count is out of its range, or a number is not finite.
        """
        options = code.source.options
        self._machine = code.machine
        self._run = code.machine.function("run", 1)
        self._groups = len(state)
        self.team_size = TEAM if code.source.works_in_teams else 1
        self._lanes = options.lanes
        self._workspace = workspace
        self._arrays = dict[str, _BoundArray]()

        self._first = whole("first", first, 0)
        self._last = whole("control instants", last, first + 1)
        self._end = whole("end", end, 0)
        self._steps = whole("steps", clock.steps, 1)
        substeps = whole("small steps", clock.substeps, 1)
        self._instant_cost = _instant_cost(options)
        # Where a buffer acts, small steps replace each step of a rule for smooth motions.
        self._step_cost = substeps if options.buffers and options.integrator.smooth else 1

        # A slot has eight bytes, whatever it holds, see `memory_layout.SLOT_TYPES`.
        self._call = np.zeros(len(SLOTS), dtype=np.int64)
        self._call[SLOTS["end"]] = end
        self._call[SLOTS["team"]] = 1
        self._call[SLOTS["period_steps"]] = self._steps
        self._call[SLOTS["substeps"]] = substeps
        self._call[SLOTS["force_interval"]] = whole("force_interval", force_interval, 1)
        self._call[SLOTS["log_interval"]] = whole("log_interval", log_interval, 1)
        self._call[SLOTS["residual_from"]] = whole("residual_from", residual_from, 0)
        fewest_readings = 1 if options.delayed else 0
        self._call[SLOTS["reading_count"]] = whole("reading_count", reading_count, fewest_readings)
        times = self._call.view(np.float64)
        times[SLOTS["dt"]] = number("dt", clock.dt, "s", "> 0")
        times[SLOTS["period"]] = number("period", clock.period, "s", "> 0")

        memory = {
            "state": state,
            "numbers": numbers,
            "readings": readings,
            "summary": summary,
            "log": log,
            "delay": delay,
            "horizon": horizon,
            "starts": starts,
            "root_starts": root_starts,
        }
        shapes = self._memory_shapes(code, log_interval, reading_count)
        self._bind_workspace(options)
        for name, shape in shapes.items():
            if shape[0]:
                self._bind(name, memory[name], (self._groups, *shape))
        if numbers is not None and code.source.varied:
            # Among them are the ranges of joints, which may be infinite.
            _check_finite("numbers", numbers, allow_infinite=True)
        if delay is not None and options.delayed:
            _check_delays(delay, reading_count)
        self._bind_tables(code, tables, starts)
        if options.base:
            self._bind_root(root, root_starts if options.base_by_lane else None)

    def _memory_shapes(
        self, code: Kernel, log_interval: int, reading_count: int
    ) -> dict[str, tuple[int, ...]]:
        """Return the shape of the memory of one group by its name; the first number is 0 where the
        code has no such memory.
        """
        options = code.source.options
        sizes = code.sizes
        lanes = options.lanes
        readings = reading_count * sizes.z if options.delayed else 0
        summary = size(sizes.summary) if options.summary else 0
        # A log with an energy ledger has a row at each instant, whatever the interval.
        row_interval = 1 if options.ledger else log_interval
        row_count = (self._last - 1) // row_interval + 1 if options.log else 0
        horizon = 0
        if options.programme is not None:
            offsets = options.programme.offsets(lanes)
            horizon = offsets.size if lanes == 1 else offsets.path
        return {
            "state": (size(sizes.state), lanes),
            "numbers": (code.source.varied, lanes),
            "readings": (readings, lanes),
            "summary": (summary, lanes),
            "log": (row_count * size(sizes.row), lanes),
            "delay": (1 if options.delayed else 0, lanes),
            "horizon": (horizon,),
            "starts": (0 if all(options.shared) else len(options.shared), lanes),
            "root_starts": (1 if options.base_by_lane else 0, lanes),
        }

    def _bind_workspace(self, options: KernelOptions) -> None:
        """Bind the workspace of a predictive controller of several lanes."""
        if options.programme is None or options.lanes == 1:
            return
        offsets = options.programme.offsets(options.lanes)
        shape = (offsets.size - offsets.path,)
        address = _address("workspace", self._workspace, shape, written=True)
        self._call[SLOTS["workspace"]] = address

    def _bind(self, name: str, array: Any, shape: tuple[int, ...]) -> None:
        """Bind an array that has a part for each group."""
        written = name in _WRITTEN_ARRAYS
        kind = np.int64 if name in _INTEGER_ARRAYS else np.float64
        address = _address(name, array, shape, kind, written=written)
        self._arrays[name] = _BoundArray(array, address, array.strides[0], written)

    def _bind_tables(
        self, code: Kernel, tables: Sequence[RowTable], starts: np.ndarray | None
    ) -> None:
        """Bind the tables.

        Args:
            code: The code.
            tables: The tables, in the order of `TABLES`.
            starts: First row of each lane's part of each table, shape (groups, tables, lanes); None
                if all lanes share all tables.

        Raises:
            Misshapen: If there are not as many tables as the code reads.
        """
        options = code.source.options
        # Without offsets, the code reads none of the last table.
        table_count = len(TABLES) if options.offset else len(TABLES) - 1
        if not table_count == len(tables) == len(options.shared):
            given = f"{len(tables)} tables, {len(options.shared)} of them shared or not"
            raise Misshapen("tables of a loop", given, f"{table_count} tables")
        for i, table in enumerate(tables):
            name = TABLES[i]
            columns = size(getattr(code.sizes, name))
            starts_of_table = None if options.shared[i] or starts is None else starts[:, i]
            self._bind_table(name, table, columns, starts_of_table)

    def _bind_table(
        self, name: str, table: RowTable, columns: int, starts: np.ndarray | None
    ) -> None:
        """Bind a table after checking that every lane finds all its rows in it.

        Args:
            name: Name of the table.
            table: The table.
            columns: Number of columns that it must have.
            starts: First row of each lane's part; None where all lanes share the table.
        """
        total = len(table.rows)
        length = whole(f"rows of {name}", table.length, 1)
        first = 0 if starts is None else int(starts.min())
        final = 0 if starts is None else int(starts.max())
        if first < 0 or final + length > total:
            given = f"one of {total} rows, read from {first} to {final + length}"
            raise Misshapen(f"rows of {name}", given, "to read what is in it")
        address = _address(f"rows of {name}", table.rows, (total, columns))
        self._arrays[name] = _BoundArray(table.rows, address, 0, False)
        self._call[SLOTS[f"{name}_rows"]] = length
        # Limits of the integrals in a gain table may be infinite.
        _check_finite(f"rows of {name}", table.rows, allow_infinite=name == "gain_table")

    def _bind_root(self, root: RowTable | None, starts: np.ndarray | None) -> None:
        """Bind the motion of the base after checking that there is a row for each half step.

        Args:
            root: The motion.
            starts: First row of each lane's part; None where all lanes stand on one base.

        Raises:
            Misshapen: If there are too few rows, or no array of contiguous doubles.
            OutOfRange: If a number is not finite.
        """
        # The steps after the last instant belong to the run, unless it is the end.
        periods = min(self._last, self._end)
        count = SAMPLES_PER_STEP * self._steps * periods + 1
        given = 0 if root is None else root.length
        if root is None or given < count:
            raise Misshapen("rows of the base", f"{given} rows", f"{count} rows or more")
        self._bind_table("root", root, ROOT_NUMBERS, starts)

    def __reduce__(self) -> NoReturn:
        """Refuse to be copied."""
        _refuse_to_copy()

    def __len__(self) -> int:
        """Return the number of groups."""
        return self._groups

    def _pieces(self, max_steps: int) -> Iterator[_Piece]:
        """Yield pieces of the run, in order, that take about as long as so many physics steps."""
        period_cost = self._steps * self._step_cost + self._instant_cost
        periods = max_steps // period_cost
        if periods:
            for first in range(self._first, self._last, periods):
                last = min(first + periods, self._last)
                yield _Piece(first, last, self._steps, resumed=False)
            return

        # One control period alone takes longer, and is divided. Code computes sines and cosines
        # afresh after every `ANGLE_REFRESH_STEPS` steps and at the end of a call: a division
        # elsewhere would change the last bits of the motion.
        refreshes = max(1, max_steps // (ANGLE_REFRESH_STEPS * self._step_cost))
        steps_together = ANGLE_REFRESH_STEPS * refreshes
        for instant in range(self._first, self._last):
            # The instant that no steps follow has one piece, too, for its control.
            has_steps = instant < self._end
            for done in range(0, self._steps if has_steps else 1, steps_together):
                count = min(steps_together, self._steps - done)
                yield _Piece(instant, instant + 1, count, resumed=done > 0, done=done)

    def run_groups(self, groups: Iterable[int], stopped: Callable[[], bool] = _never) -> None:
        """Run some groups, one after another.

        Args:
            groups: Indices of the groups.
            stopped: Says between two pieces whether to leave off; by default never.

        Raises:
            OutOfRange: If there is no such group.
        """
        calls = np.repeat(self._call[None], self.team_size, axis=0)
        address = calls.ctypes.data
        if self._workspace is not None:
            # Threads run at the same time, and each needs a workspace of its own.
            workspace = aligned_copy(self._workspace)
            calls[:, SLOTS["workspace"]] = workspace.ctypes.data
        for team in teams_of(groups, self.team_size):
            for call, group in zip(calls, team, strict=False):
                if not 0 <= group < self._groups:
                    raise OutOfRange("group", group, f"0 to {self._groups - 1}")
                self._point_to(call, group)
            calls[:, SLOTS["team"]] = len(team)
            for piece in self._pieces(_MAX_STEPS_PER_CALL // len(team)):
                if stopped():
                    return
                calls[:, _PIECE_SLOTS] = piece
                self._run(address)

    def _point_to(self, call: np.ndarray, group: int | np.ndarray) -> None:
        """Set the addresses of a call to the memory of a group, or those of calls in rows to the
        memory of a group each.
        """
        for name, bound in self._arrays.items():
            call[..., SLOTS[name]] = bound.address + group * bound.stride

    def device_calls(
        self, upload: Callable[[np.ndarray, bool], int], strides: Sequence[str], max_steps: int
    ) -> Iterator[np.ndarray]:
        """Yield the arguments of one call for each piece of the run, for a device with its own
        memory. The call of a piece runs all groups: it has the addresses of the first one, and
        behind its slots the distances from group to group, from which the device finds the others.

        Args:
            upload: Copies an array to that memory and returns its address there; the second
                argument says whether the code writes to the array.
            strides: Names of the arrays whose strides, from group to group, stand behind the slots
                of each call [numbers].
            max_steps: Steps of all cranes together in a piece, unless those of one control instant
                are more.
        """
        call = np.concatenate([self._call, np.zeros(len(strides), dtype=np.int64)])
        for name, bound in self._arrays.items():
            call[SLOTS[name]] = upload(bound.array, bound.written)
            if bound.stride:
                call[len(SLOTS) + strides.index(name)] = bound.stride // bound.array.itemsize
        cranes = self._groups * self._lanes
        steps_of_each = max(1, max_steps // cranes)
        for piece in self._pieces(min(_MAX_STEPS_PER_CALL, steps_of_each)):
            call[_PIECE_SLOTS] = piece
            yield call

    def bind_calls(self) -> tuple[Callable[[], None], Callable[[], None]]:
        """Return two functions of the first group: one runs the whole loop, which has the least
        overhead where it is one piece, and the other only the control of the first instant.
        """
        first_piece, *more_pieces = islice(self._pieces(_MAX_STEPS_PER_CALL), 2)
        calls = np.repeat(self._call[None], 2, axis=0)
        whole_run, first_control = calls
        self._point_to(calls, 0)
        calls[:, _PIECE_SLOTS] = first_piece
        first_control[SLOTS["last"]] = self._first + 1
        first_control[SLOTS["end"]] = self._first  # so that no steps follow the control
        run = _bound_call(self._run, [whole_run.ctypes.data], (self, calls))
        control = _bound_call(self._run, [first_control.ctypes.data], (self, calls))
        if more_pieces:
            return partial(self.run_groups, [0]), control
        return run, control

    def step_function(self) -> Callable[[int, int], None]:
        """Return a function that advances the groups from a first to the one before a last by one
        control period, under the commands in their states.

        One call handles many groups and takes some tenths of a second at most.

        Raises:
            OutOfRange: If a period has too many steps for that.
        """
        groups_per_call = _MAX_STEPS_PER_CALL // (self._steps * self._step_cost)
        if not groups_per_call:
            allowed = f"{_MAX_STEPS_PER_CALL // self._step_cost} or less"
            raise OutOfRange("steps in a control period", self._steps, allowed)
        run = self._machine.function("run_groups", 2)
        calls = np.repeat(self._call[None], self._groups, axis=0)
        self._point_to(calls, np.arange(self._groups))
        # The commands stand in the states already: the code is told that control has run.
        calls[:, _PIECE_SLOTS] = _Piece(0, 1, self._steps, resumed=True)

        def step_groups(first: int, last: int) -> None:
            if not 0 <= first <= last <= self._groups:
                raise OutOfRange("groups", f"{first} to {last}", f"0 to {self._groups}")
            for begin in range(first, last, groups_per_call):
                chunk = calls[begin : min(begin + groups_per_call, last)]
                count = np.array([len(chunk)])
                run(chunk.ctypes.data, count.ctypes.data)

        return step_groups


def _instant_cost(options: KernelOptions) -> int:
    """Return the time that a control instant takes on average, in physics steps, rounded up."""
    programme = options.programme
    if programme is None:
        return _INSTANT_COST
    optimisation = _STAGE_COST * programme.stages * options.lanes
    # The optimisation of every `ratio`-th instant counts at each of them with its share.
    return _INSTANT_COST + math.ceil(optimisation / programme.ratio)


def _check_delays(delay: np.ndarray, reading_count: int) -> None:
    """Check that readings are stored for the delays of all sensors [control periods].

    Raises:
        OutOfRange: If not.
    """
    shortest = int(delay.min())
    longest = int(delay.max())
    if shortest < 0 or longest >= reading_count:
        allowed = f"0 to {reading_count - 1}"
        raise OutOfRange("delay", f"{shortest} to {longest}", allowed, "control periods")
