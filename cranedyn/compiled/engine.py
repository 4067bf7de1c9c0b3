"""Engine of compiled code: from one control instant to the next, or through a whole run if nothing
in the loop is Python.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from cranedyn.checks import read_only
from cranedyn.compiled.binding import Loop, RowFunction
from cranedyn.compiled.kernel import Kernel, Recipe
from cranedyn.compiled.layout import BufferLayout, size, slices
from cranedyn.compiled.step import check_rule
from cranedyn.compiled.tables import (
    RowTable,
    command_tables,
    gain_table,
    setpoint_table,
    single_table,
    without_gains,
)
from cranedyn.compiled.verify import compile_kernel
from cranedyn.controllers.affine import Affine, Stateful, affine_form
from cranedyn.dynamics.drives import VelocityDrives
from cranedyn.errors import Misshapen
from cranedyn.interfaces import Reference, State
from cranedyn.references.tabulated import tabulated
from cranedyn.simulation.engine import Actuation, Engine, Extend, Setting
from cranedyn.simulation.stepper import DIVERGED

if TYPE_CHECKING:
    from cranedyn.compiled.horizon.control import Programme

_BLOCK, _STEPS = 2000, 1_000_000
"""Largest numbers of control instants, and of physics steps, in a block."""


@runtime_checkable
class Predictive(Protocol):
    """Controller whose optimisation runs in compiled loops: `Receding` of
    `cranedyn.compiled.horizon.receding`, which takes long to import.
    """

    programme: Programme

    def resume_memory(self, t: float) -> np.ndarray:
        """Return its memory for a loop that continues from a control instant [s]."""

    def advance_to(self, t: float) -> None:
        """Record that a loop has advanced through a control instant [s]."""


class _Block(NamedTuple):
    """Tables to fill, shape (gain rows, columns) and (instants, columns), the resulting log, the
    instant at which the model ceases to hold, shape (1,), and the function that runs the block.
    """

    gain_table: np.ndarray
    setpoint_table: np.ndarray
    rows: np.ndarray
    invalid: np.ndarray
    run: Callable[[], None]


class CompiledEngine(Engine):
    """Engine that steps by compiled code; drive efforts and buffer forces at control instants are
    computed by Pinocchio.

    Attributes:
        state: State of the crane.
    """

    def __init__(self, setting: Setting, start: State) -> None:
        """Start at a state, without command.

        Raises:
            OutOfRange: If there is no code for the stepping rule.
        """
        check_rule(setting.integrator)
        self._setting = setting
        sizes = BufferLayout.of(setting.crane.layout, setting.delay_steps, setting.contacts)
        self._sizes = sizes
        self._at, self._force = slices(sizes.state), np.zeros((1, size(sizes.force)))
        self._memory = np.zeros(size(sizes.state))
        self._gain_table, self._setpoint_table = command_tables(sizes)
        self._create_views()
        self._codes: dict[tuple[bool, bool, Programme | None], Kernel] = {}
        self._predictive: Predictive | None = None
        self._step: Callable[[], None] | None = None
        self._horizon: np.ndarray | None = None
        self._blocks: dict[tuple[bool, int, int, int], _Block] = {}
        self.reset(start)

    def _create_views(self) -> None:
        """Create the views of the memory."""
        self._here = self._memory[: self._sizes.z]
        self._position, self._rate = np.split(self._here, 2)
        self._last_command = self._gain_table[0, slices(self._sizes.gain_table)["feed_forward"]]

    def __getstate__(self) -> dict[str, Any]:
        """Return all but what is bound to the memory, for a copy with its own memory."""
        return vars(self) | {"_codes": {}, "_blocks": {}, "_step": None, "_horizon": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a copy and its views of the memory."""
        vars(self).update(state)
        self._create_views()

    def reset(self, start: State) -> None:
        """Reset as `Engine.reset`; compiled code is kept."""
        super().reset(start)
        self._memory[:] = self._force[:] = self._last_command[:] = 0.0
        self._here[:] = np.concatenate(start)
        if self._external is not None and self._external.ground is not None:
            self._memory[self._at["anchors"]] = self._external.ground.anchors.T.ravel()
        if self._setting.converters is not None:
            self._memory[self._at["reference"]] = start.v[self._setting.crane.layout.drives]
            unheard = self._memory[self._at["unheard"]].reshape(-1, self._sizes.m)
            unheard[:] = self._memory[self._at["reference"]]

    def _code(self, *, integral: bool, log: bool) -> Kernel:
        """Return the code, compiled and verified at the first use.

        To find it again by the numbers of the crane would take half a millisecond.
        """
        setting = self._setting
        programme = self._predictive.programme if self._predictive and log else None
        if code := self._codes.get((integral, log, programme)):
            return code
        recipe = Recipe(
            1,
            setting.drive,
            setting.integrator,
            setting.buffers,
            integral=integral,
            forces=setting.forces,
            log=log,
            summary=log,
            delay_steps=setting.delay_steps,
            programme=programme,
            contacts=setting.contacts,
        )
        converters = setting.converters
        numbers = None if converters is None else np.concatenate(converters.response)
        code = compile_kernel([setting.crane], recipe, numbers)[0]
        self._codes[integral, log, programme] = code
        return code

    def _loop(
        self,
        code: Kernel,
        gain_table: RowTable,
        setpoint_table: RowTable,
        last: int,
        end: int,
        **memory: Any,
    ) -> Loop:
        """Return code bound to the memory of this crane."""
        memory = {name: array.reshape(1, -1, 1) for name, array in memory.items()}
        if self._horizon is not None:
            memory["horizon"] = self._horizon
        return Loop(
            code,
            self._setting.clocks,
            (gain_table, setpoint_table, single_table(self._force)),
            last=last,
            end=end,
            state=self._memory.reshape(1, -1, 1),
            **memory,
        )

    def energies(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return energies as `Engine.energies`; by code if stepping has compiled it."""
        if self._step is None:
            return super().energies(q, v)
        machine = self._code(integral=False, log=False).machine
        return RowFunction(machine, "energies", self._sizes.z, 1)(np.hstack([q, v]))[:, 0]

    def apply_command(self, command: np.ndarray, force: np.ndarray | None = None) -> Actuation:
        """As `Engine.apply_command`."""
        setting = self._setting
        if setting.converters or setting.buffers or setting.contacts or self._drives.rope:
            self._recall()
        actuation = super().apply_command(command, force)
        self._last_command[...] = actuation.effort if self._setting.drive == "effort" else command
        if force is not None:
            self._force[0] = actuation.force
        return actuation

    def _recall(self) -> None:
        """Copy the memory of converters, contacts and ground from compiled code to Pinocchio's
        drives.
        """
        self._buffer_work, self._impact_work = self._memory[self._at["contacts"]].tolist()
        if self._external is not None and self._external.ground is not None:
            anchors = self._memory[self._at["anchors"]]
            self._external.ground.anchors = anchors.reshape(-1, 3).T.copy()
        if isinstance(self._drives, VelocityDrives):
            names = "reference", "rising", "unheard"
            reference, rising, unheard = (self._memory[self._at[name]] for name in names)
            self._drives.recall(reference, rising, unheard.reshape(-1, self._sizes.m).copy())

    def advance(self) -> State:
        """Advance as `Engine.advance`."""
        if self._step is None:
            code = self._code(integral=False, log=False)
            tables = single_table(self._gain_table), single_table(self._setpoint_table)
            self._step = self._loop(code, *tables, 1, 1).bind_call()
        self._step()
        return self._read_state()

    def _read_state(self) -> State:
        q, v = self._position.tobytes(), self._rate.tobytes()  # copies that cannot be written to
        # what State(q, v) makes, in half the time
        self.state = tuple.__new__(State, (np.frombuffer(q), np.frombuffer(v)))
        return self.state

    def run_ahead(
        self, controller: object, reference: Reference, t_start: float, periods: int, extend: Extend
    ) -> Iterator[int]:
        """Log rows under a controller that is affine in the state, block by block, and yield the
        number of rows.

        A block with a number that is not finite or a diverged state is discarded; the caller then
        runs it instant by instant.

        Raises:
            Misshapen: If an array of the controller's affine form or of the reference has another
                shape.
        """
        if self._setting.forces:
            return
        clocks, first = self._setting.clocks, 0
        predictive = controller if isinstance(controller, Predictive) else None
        if predictive is not None and predictive.programme.drive != self._setting.drive:
            return
        ahead = max(1, min(_BLOCK, _STEPS // clocks.steps))
        while first <= periods:
            instants = np.arange(first, min(first + ahead, periods + 1))
            times = read_only(t_start + clocks.period * instants)
            try:
                setpoint = tabulated(reference, times, self._sizes.m).position
                common = (
                    affine_form(controller, times, setpoint, self._sizes.z)
                    if predictive is None
                    else without_gains(self._sizes, setpoint)
                )
            except Misshapen:
                raise
            except Exception:  # raised again at the instant where it occurs
                common = None
            self._plan_with(predictive, float(times[0]))
            ran = None if common is None else self._run(common, setpoint, periods - first)
            if ran is None:
                break
            if predictive is not None:
                predictive.advance_to(float(times[-1]))
            if isinstance(controller, Stateful):
                controller.resume(float(times[-1]), self._memory[self._at["integral"]].copy())
            rows, valid = ran
            columns = {
                "setpoint": setpoint,
                **{name: rows[name] for name in ("q", "v", "effort")},
                "needed": rows["command"],
                "effort_before": rows["before"],
                "contacts": np.hstack([rows["contacts"], rows["stop_force"]]),
                "saturated": rows.get("cut", np.zeros((len(times), 1))),
            }
            extend(columns, rows["energy"][:, 0], valid=valid)
            first += len(times)
            self._read_state()
            yield first
        if self._setting.converters is None:
            self.apply_command(self._memory[self._at["last_command"]].copy())

    def _run(
        self, common: Affine, setpoint: np.ndarray, end: int
    ) -> tuple[dict[str, np.ndarray], bool] | None:
        """Return a block of rows by name, and whether the model holds at all of them; return None
        and restore the state if a number is not finite or a joint moves too fast.
        """
        before, n = self._memory.copy(), len(setpoint)
        predictive = None if self._horizon is None else self._horizon.copy()
        integral = bool(common.integral_gain.any())
        block = self._block(integral, len(common.feed_forward), n, min(end, n))
        gain_table(self._sizes, common, block.gain_table)
        setpoint_table(self._sizes, common, n, block.setpoint_table)
        self._memory[self._at["integral"]] = common.integral
        block.invalid[:] = np.inf
        block.run()
        rows = {name: block.rows[:, columns] for name, columns in slices(self._sizes.row).items()}
        finite = all(np.isfinite(numbers).all() for numbers in (block.rows, common.integral))
        finite = finite and not np.isnan(common.limit).any()
        if finite and (np.square(rows["v"]).sum(axis=1) < DIVERGED**2).all():
            return rows, bool(np.isinf(block.invalid[0]))
        self._memory[:] = before
        if self._horizon is not None:
            self._horizon[:] = predictive
        return None

    def _plan_with(self, predictive: Predictive | None, t: float) -> None:
        """Prepare the memory of a predictive controller that continues from a time [s]."""
        if predictive is not self._predictive:
            self._blocks.clear()
        self._predictive = predictive
        self._horizon = None if predictive is None else predictive.resume_memory(t)

    def _block(self, integral: bool, gain_rows: int, instants: int, end: int) -> _Block:
        """Return the block of a size, cached."""
        key, sizes = (integral, gain_rows, instants, end), self._sizes
        if key not in self._blocks:
            gains = np.zeros((gain_rows, size(sizes.gain_table)))
            setpoints = np.zeros((instants, size(sizes.setpoint_table)))
            rows, summary = np.empty((instants, size(sizes.row))), np.zeros(size(sizes.summary))
            code = self._code(integral=integral, log=True)
            tables = single_table(gains), single_table(setpoints)
            run = self._loop(code, *tables, instants, end, log=rows, summary=summary)
            invalid = summary[slices(sizes.summary)["invalid"]]
            self._blocks[key] = _Block(gains, setpoints, rows, invalid, run.bind_call())
        return self._blocks[key]
