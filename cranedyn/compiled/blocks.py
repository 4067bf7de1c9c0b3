"""Runs without Python in the loop: blocks of control instants under a controller that compiled code
computes itself.

Such a controller is affine in the state, or a predictive one with a programme. Its tables, the
setpoints and the wind of a block are computed before the block begins.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from enum import Enum, auto
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np

from cranedyn.checks import equal_rows, finite, read_only
from cranedyn.compiled.loop_tables import gain_table, setpoint_table, without_gains
from cranedyn.compiled.memory_layout import slices
from cranedyn.compiled.moving_crane import CompiledCrane
from cranedyn.controllers.affine import Affine, Dynamic, affine_form
from cranedyn.disturbances.wind import Wind
from cranedyn.errors import Misshapen
from cranedyn.interfaces import Reference
from cranedyn.references.tabulated import tabulated
from cranedyn.simulation.loop_checks import DIVERGED

if TYPE_CHECKING:
    from cranedyn.compiled.horizon.receding import Receding

_MAX_BLOCK_LENGTH = 20_000
"""Largest number of control instants in a block; Python handles Ctrl-C between blocks."""

_MAX_BLOCK_STEPS = 1_000_000
"""Largest number of physics steps in a block."""

_MAX_BLOCK_STEPS_ON_BASE = 100_000
"""Largest number of physics steps in a block where the base moves: its motion at each half step
takes 144 bytes a step."""


class _BlockOutcome(Enum):
    """What happened when a block was to be written."""

    WRITTEN = auto()
    """The rows are written, and the crane has moved on."""

    DIVERGED = auto()
    """A number was not finite, or a joint too fast; the crane is where it was before."""

    NOT_TABULATED = auto()
    """The controller, the reference or the wind cannot be tabulated; nothing was computed."""


def run_blocks(
    moving: CompiledCrane, controller: object, reference: Reference, t: np.ndarray, rows: np.ndarray
) -> Iterator[int]:
    """Write rows of the log block by block, and yield how many there are so far.

    It ends where the whole run is written, or where the loop must go on instant by instant: at once
    under a controller or a disturbance that only Python computes, and later where a function fails
    or the run diverges. Then the error is raised at the instant where it occurs.

    Args:
        moving: The crane at the start of the run.
        controller: The controller.
        reference: The reference.
        t: Times of all control instants of the run [s], shape (instants,).
        rows: Rows of the log, see `cranedyn.compiled.memory_layout.row_sections`, shape (instants,
            columns).

    Raises:
        Misshapen: If an array of the controller's affine form or of the reference has another
            shape.
    """
    spec = moving.spec
    wind = None
    if spec.disturbance is not None:
        # A subclass may compute other forces.
        if type(spec.disturbance) is not Wind or spec.disturbance.crane is not spec.crane:
            return
        if spec.base is not None:
            # The code knows no wind against the motion of a base.
            return
        wind = spec.disturbance
    predictive = None
    if hasattr(controller, "programme"):
        # A predictive controller, whose programme is what its code is made of.
        predictive = cast("Receding", controller)
        # There is no code for it beside wind: to compile that would take longer than it saves.
        if wind is not None or predictive.programme.drive != spec.drive:
            return
    blocks = _Blocks(moving, controller, reference, wind, predictive)
    most_steps = _MAX_BLOCK_STEPS if spec.base is None else _MAX_BLOCK_STEPS_ON_BASE
    length = max(1, min(_MAX_BLOCK_LENGTH, most_steps // spec.clocks.steps))
    first = 0
    while length > 0 and first < len(rows):
        block = rows[first : first + length]
        times = read_only(t[first : first + length])
        last_instant = len(rows) - 1 - first
        outcome = blocks.write(block, times, end=last_instant)
        if outcome is _BlockOutcome.NOT_TABULATED:
            return
        if outcome is _BlockOutcome.DIVERGED:
            length = _rows_before_divergence(moving, block)
            continue
        first += len(block)
        yield first


class _Blocks:
    """Writer of blocks of rows."""

    def __init__(
        self,
        moving: CompiledCrane,
        controller: object,
        reference: Reference,
        wind: Wind | None,
        predictive: Receding | None,
    ) -> None:
        self._moving = moving
        self._controller = controller
        self._reference = reference
        self._wind = wind
        self._predictive = predictive

    def write(self, rows: np.ndarray, times: np.ndarray, *, end: int) -> _BlockOutcome:
        """Write a block of rows and move the crane on.

        Args:
            rows: The rows, shape (instants, columns).
            times: Times of their instants [s], shape (instants,).
            end: Instant, counted from the first of the block, that no steps follow: the last of the
                run.

        Raises:
            Misshapen: If an array of the controller's affine form or of the reference has another
                shape.
        """
        moving = self._moving
        # Steps follow each instant of the block but the end of the run.
        tables = self._tabulate(times, min(len(rows), end))
        horizon = None
        if self._predictive is not None:
            horizon = self._predictive.resume_memory(float(times[0]))
        if tables is None:
            return _BlockOutcome.NOT_TABULATED
        states = self._run(tables, rows, end, horizon)
        if states is None:
            return _BlockOutcome.DIVERGED
        if self._predictive is not None:
            self._predictive.advance_to(float(times[-1]))
        if hasattr(self._controller, "resume"):
            integral = moving.memory[moving.places["integral"]].copy()
            self._controller.resume(float(times[-1]), integral)
        if tables.form.states is not None:
            cast(Dynamic, self._controller).resume_states(float(times[-1]), states)
        # The forces of the last row, if the loop goes on instant by instant from here.
        moving.force[1] = moving.memory[moving.places["previous_force"]]
        moving.read_state()
        return _BlockOutcome.WRITTEN

    def _tabulate(self, times: np.ndarray, periods: int) -> _Tables | None:
        """Return the affine form of the controller, the setpoints, the wind and the motion of the
        base in a block; None if one of them fails or lacks a number.

        Args:
            times: Control instants of the block [s], shape (instants,).
            periods: Number of control periods in it.

        Raises:
            Misshapen: If an array of the affine form or of the reference has another shape.
        """
        sizes = self._moving.sizes
        areas: tuple[float, ...] = ()
        # Without wind the code reads no table of forces, but is given one.
        air = self._moving.force
        try:
            setpoint = equal_rows(tabulated(self._reference, times, sizes.m).position)
            if self._wind is not None:
                areas = tuple(self._wind.areas.tolist())
                air = self._velocity_of_air(self._wind, times)
            root = None
            if self._moving.base is not None:
                root = self._moving.base.of_periods(self._moving.instant, periods)
            form: Affine | None
            if self._predictive is None:
                form = affine_form(self._controller, times, setpoint, sizes.z)
            else:
                form = without_gains(sizes, setpoint)
        except Misshapen:
            raise
        except Exception:
            # Whatever a function of the user raises is raised again at its instant, by the loop.
            return None
        if form is None or form.not_finite_field():
            return None
        return _Tables(form, setpoint, areas, air, root)

    def _velocity_of_air(self, wind: Wind, times: np.ndarray) -> np.ndarray:
        """Return the velocity of the air at each point of the crane [m/s], shape (instants, 3
        points).
        """
        speeds = np.array([wind.speed(t) for t in times.tolist()])
        along = np.tile(wind.along, self._moving.sizes.points)
        air = np.multiply.outer(speeds, along)
        return finite("wind", air, air.shape)

    def _run(
        self, tables: _Tables, rows: np.ndarray, end: int, horizon: np.ndarray | None
    ) -> np.ndarray | None:
        """Write a block of rows and return the states of the controller after it, shape (k,).

        If a number is not finite or a joint moves too fast, return None and restore the crane and
        the predictive controller.
        """
        moving = self._moving
        form = tables.form
        memory_before = moving.memory.copy()
        horizon_before = None if horizon is None else horizon.copy()

        integral = bool(form.integral_gain.any())
        if not integral:
            # The code logs the target as the setpoint. Without integrals nothing else reads it.
            form = replace(form, target=tables.setpoint)
        moving.memory[moving.places["integral"]] = form.integral
        # The states of the controller stand behind the memory of the crane.
        states_before = np.zeros(0) if form.states is None else form.states.initial
        sizes = replace(moving.sizes, controller_states=len(states_before))
        memory = moving.memory
        if len(states_before):
            memory = np.concatenate([moving.memory, states_before])
        programme = None if self._predictive is None else self._predictive.programme
        code = moving.code(
            programme, tables.areas, integral=integral, controller_states=len(states_before)
        )
        arrays = (gain_table(sizes, form), setpoint_table(sizes, form, len(rows)), tables.air)
        loop = moving.loop(
            code, arrays, rows, end=end, horizon=horizon, memory=memory, root=tables.root
        )
        loop.run_groups([0])
        crane_memory, states_after = np.split(memory, [len(moving.memory)])
        moving.memory[:] = crane_memory
        if integral:
            # The code has logged where the integrals take the drives.
            rows[:, : moving.sizes.m] = tables.setpoint

        if moving.memory[moving.places["diverged"]] == 0.0:
            moving.instant += len(rows)
            return states_after
        moving.memory[:] = memory_before
        if horizon is not None:
            horizon[:] = horizon_before
        return None


class _Tables(NamedTuple):
    """What a block is computed from.

    Attributes:
        form: Affine form of the controller at each instant.
        setpoint: Positions of the setpoint of the drives, shape (instants, m).
        areas: Drag areas of the points [m²]; empty without wind.
        air: Velocity of the air at each point of the crane [m/s], shape (instants, 3 points);
            unused without wind.
        root: Motion of the base at each half physics step; None for a base at rest.
    """

    form: Affine
    setpoint: np.ndarray
    areas: tuple[float, ...]
    air: np.ndarray
    root: np.ndarray | None


def _rows_before_divergence(moving: CompiledCrane, rows: np.ndarray) -> int:
    """Return how many rows of a block come before the first whose rates are those of a diverged
    run, or no numbers; 0 if there is none, since then the run diverged after the last row, and the
    loop finds out where.
    """
    rates = rows[:, slices(moving.sizes.row)["v"]]
    is_bounded = (rates * rates).sum(axis=1) < DIVERGED**2
    return int(np.argmin(is_bounded))
