"""Engine of compiled code: from one control instant to the next, or through a whole run if nothing
in the loop is Python.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast
from weakref import ref

import numpy as np

from cranedyn.checks import equal_rows, finite, read_only
from cranedyn.compiled.binding import Loop
from cranedyn.compiled.kernel import Kernel, Recipe
from cranedyn.compiled.layout import BufferLayout, size, slices
from cranedyn.compiled.step import check_rule
from cranedyn.compiled.tables import (
    command_tables,
    gain_table,
    setpoint_table,
    single_table,
    without_gains,
)
from cranedyn.compiled.verify import crane_kernel
from cranedyn.controllers.affine import Affine, affine_form
from cranedyn.disturbances.wind import Wind
from cranedyn.dynamics.drives import GroundForces
from cranedyn.errors import Misshapen
from cranedyn.interfaces import Reference, Setpoint, State
from cranedyn.references.tabulated import tabulated
from cranedyn.simulation.engine import Actuation, Engine, Setting
from cranedyn.simulation.stepper import DIVERGED

if TYPE_CHECKING:
    from cranedyn.compiled.horizon.memory import Programme
    from cranedyn.compiled.horizon.receding import Receding

_BLOCK = 20_000
"""Largest number of control instants in a block."""

_STEPS = 1_000_000
"""Largest number of physics steps in a block."""

# Looked up once: a row of a run takes microseconds.
_frozen = np.frombuffer
_new_tuple = tuple.__new__


class CompiledEngine(Engine):
    """Engine that steps by compiled code, which also computes what acts at control instants.

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
        self._sizes = sizes = replace(sizes, ledger=True)
        self._at = slices(sizes.state)
        self._memory = np.zeros(size(sizes.state))
        # before and from a control instant, of which there is a row in the same place
        self._force = np.zeros((2, size(sizes.force)))
        self._predictive: Receding | None = None
        self._wind: tuple[tuple, np.ndarray] = (), self._force  # drag areas, and forces or air
        self._calls: tuple[Callable[[], None], Callable[[], None]] | None = None
        self._horizon: np.ndarray | None = None
        self._create_views()
        self.reset(start)

    def _bind_calls(self) -> tuple[Callable[[], None], Callable[[], None]]:
        """Return the calls of a control period and of its instant alone, bound to a command."""
        rows = np.zeros((2, size(self._sizes.row)))
        tables = *command_tables(self._sizes), self._force
        self._command = tables[0][0, slices(self._sizes.gain_table)["feed_forward"]]
        row = slices(self._sizes.row)
        self._acting = rows[1, self._sizes.m :]
        self.actuation = Actuation(*(rows[1, row[name]] for name in Actuation._fields))
        return self._loop(self._code(), tables, rows, first=1, end=2).bind_calls()

    def __getstate__(self) -> dict[str, Any]:
        """Return all but what is bound to the memory, for a copy with its own memory."""
        return vars(self) | {"_calls": None, "_horizon": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a copy and its views of the memory."""
        vars(self).update(state)
        self._create_views()

    def _create_views(self) -> None:
        """Create the views of the memory."""
        self._position = self._memory[self._at["q"]]
        self._rate = self._memory[self._at["v"]]

    def reset(self, start: State) -> None:
        """Reset as `Engine.reset`; compiled code is kept."""
        self.state = start
        self._memory[:] = self._force[:] = 0.0
        self._memory[: self._sizes.z] = np.concatenate(start)
        if (contacts := self._setting.contacts) is not None:
            anchors = GroundForces(self._setting.crane, contacts).anchors_at(start)
            self._memory[self._at["anchors"]] = anchors.T.ravel()
        if self._setting.converters is not None:
            self._memory[self._at["reference"]] = start.v[self._setting.crane.layout.drives]
            unheard = self._memory[self._at["unheard"]].reshape(-1, self._sizes.m)
            unheard[:] = self._memory[self._at["reference"]]

    def _code(
        self, programme: Programme | None = None, areas: tuple = (), *, integral: bool = False
    ) -> Kernel:
        """Return the code, compiled and verified at the first use."""
        setting = self._setting
        recipe = Recipe(
            1,
            setting.drive,
            setting.integrator,
            setting.buffers,
            integral=integral,
            forces=setting.forces,
            log=True,
            delay_steps=setting.delay_steps,
            programme=programme,
            contacts=setting.contacts,
            ledger=True,
            areas=areas,
        )
        converters = setting.converters
        response = None if converters is None else np.concatenate(converters.response).tobytes()
        return crane_kernel(ref(setting.crane), recipe, response)

    def _loop(
        self, code: Kernel, tables: tuple[np.ndarray, ...], rows: np.ndarray, **call: Any
    ) -> Loop:
        """Return code bound to the memory of this crane, to tables of gains, setpoints and forces,
        and to the rows that it writes.
        """
        memory: dict[str, Any] = {
            "state": self._memory.reshape(1, -1, 1),
            "log": rows.reshape(1, -1, 1),
        }
        if self._horizon is not None and code.source.recipe.programme is not None:
            memory["horizon"] = self._horizon
        bound = [single_table(table) for table in tables]
        return Loop(code, self._setting.clocks, bound, last=len(rows), **call, **memory)

    def advance(
        self, command: np.ndarray, force: np.ndarray | None = None, *, last: bool = False
    ) -> State:
        """Advance as `Engine.advance`; the arrays of the actuation change at the next command."""
        if self._calls is None:
            self._calls = self._bind_calls()
        self._command[...] = command
        if force is not None:
            self._force[0] = self._force[1]
            self._force[1] = force.ravel()
        self._calls[last]()
        return self._read_state()

    def row(self, setpoint: Setpoint) -> bytes:
        """Return a row as `Engine.row`, with energy ledger and validity."""
        return setpoint.position.tobytes() + self._acting.tobytes()

    def _read_state(self) -> State:
        # what State(q, v) makes in twice the time, of copies that cannot be written to
        arrays = _frozen(self._position.tobytes()), _frozen(self._rate.tobytes())
        self.state = state = _new_tuple(State, arrays)
        return state

    def run_ahead(
        self, controller: object, reference: Reference, t: np.ndarray, rows: np.ndarray
    ) -> Iterator[tuple[int, bool]]:
        """Write rows under a controller that is affine in the state, block by block, see
        `Engine.run_ahead`.

        A block with a number that is not finite or a diverged state is repeated up to the row
        before; from there the caller goes on instant by instant.

        Raises:
            Misshapen: If an array of the controller's affine form or of the reference has another
                shape.
        """
        disturbance = self._setting.disturbance
        wind = disturbance if type(disturbance) is Wind else None
        if disturbance is not wind or (wind and wind.crane is not self._setting.crane):
            return
        clocks = self._setting.clocks
        first = 0
        self._predictive = predictive = (
            cast("Receding", controller) if hasattr(controller, "programme") else None
        )
        # code of a predictive controller takes longer to compile than wind to compute
        if predictive is not None and (wind or predictive.programme.drive != self._setting.drive):
            return
        ahead = max(1, min(_BLOCK, _STEPS // clocks.steps))
        while ahead and first < len(rows):
            block = rows[first : first + ahead]
            times = read_only(t[first : first + ahead])
            tabulated_block = self._tabulate(controller, reference, wind, times)
            if predictive is not None:
                self._horizon = predictive.resume_memory(float(times[0]))
            if tabulated_block is None:
                break
            form, setpoint = tabulated_block
            if not self._run(form, setpoint, block, len(rows) - 1 - first):
                ahead = self._rows_before_divergence(block)
                continue
            if predictive is not None:
                predictive.advance_to(float(times[-1]))
            if hasattr(controller, "resume"):
                controller.resume(float(times[-1]), self._memory[self._at["integral"]].copy())
            first += len(block)
            self._force[1] = self._memory[self._at["pushed"]]
            self._read_state()
            yield first, bool(self._memory[self._at["worst"]] < 1.0)

    def _tabulate(
        self, controller: object, reference: Reference, wind: Wind | None, times: np.ndarray
    ) -> tuple[Affine, np.ndarray] | None:
        """Return the affine form of a controller and the setpoints at the instants of a block, and
        tabulate the wind there; None if one of them fails or lacks a number. The caller then goes
        on instant by instant, and what fails is raised at the instant where it occurs.

        Raises:
            Misshapen: If an array of the controller's affine form or of the reference has another
                shape.
        """
        try:
            setpoint = equal_rows(tabulated(reference, times, self._sizes.m).position)
            if wind is not None:
                self._set_wind(wind, times)
            form: Affine | None
            if self._predictive is None:
                form = affine_form(controller, times, setpoint, self._sizes.z)
            else:
                form = without_gains(self._sizes, setpoint)
        except Misshapen:
            raise
        except Exception:
            return None
        return None if form is None or form.lacking() else (form, setpoint)

    def _set_wind(self, wind: Wind, times: np.ndarray) -> None:
        """Tabulate the velocity of the air at each point that it pushes, at instants of a block."""
        speeds = np.array([wind.speed(t) for t in times.tolist()])
        air = np.multiply.outer(speeds, np.tile(wind.along, self._sizes.points))
        self._wind = tuple(wind.areas.tolist()), finite("wind", air, air.shape)

    def _rows_before_divergence(self, rows: np.ndarray) -> int:
        """Return how many rows of a block come before the first whose rates are those of a diverged
        run, or no numbers.
        """
        rates = rows[:, slices(self._sizes.row)["v"]]
        return int(np.argmin((rates * rates).sum(axis=1) < DIVERGED**2))

    def _run(self, form: Affine, setpoint: np.ndarray, rows: np.ndarray, end: int) -> bool:
        """Write a block of rows up to an instant that no steps follow; return False and restore the
        state if a number is not finite or a joint moves too fast.
        """
        before = self._memory.copy()
        predictive = None if self._horizon is None else self._horizon.copy()
        integral = bool(form.integral_gain.any())
        if not integral:  # code logs where integrals take the drives
            form = replace(form, target=setpoint)
        self._memory[self._at["integral"]] = form.integral
        programme = None if self._predictive is None else self._predictive.programme
        areas, air = self._wind
        tables = gain_table(self._sizes, form), setpoint_table(self._sizes, form, len(rows)), air
        code = self._code(programme, areas, integral=integral)
        self._loop(code, tables, rows, end=end).run_groups([0])
        if integral:
            rows[:, : self._sizes.m] = setpoint
        if self._memory[self._at["worst"]] < 2.0:
            return True
        self._memory[:] = before
        if self._horizon is not None:
            self._horizon[:] = predictive
        return False
