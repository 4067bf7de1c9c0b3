"""Controllers as function blocks, for exporters of code.

The inputs of a block are the measured state and the setpoints, its outputs the commands of the
drives. A program calls it once in each control period. Tables of a controller, such as gains along
a motion, are constant tables of the block; a call takes the row whose number is the count of calls
since the reset.

`controller_block` is the entry point. There is one class for each family of controllers, a `Part`,
which knows what the controller keeps in memory and emits its law; `PARTS` lists them. After a
fault, such as a measurement that is not a number, the block does what is safe for its kind of
outputs until the program closes the brakes, see `FaultReaction`.

Conventions: n coordinates, m drives, z = (coordinates, rates) of shape (2 n,). To *emit* is to add
statements to the code under construction. Meanwhile arrays hold values of that code and not
numbers, and the order in which they are made is the order of the statements in the exported files.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np

from cranedyn.checks import check_choice, number
from cranedyn.clocks import SAME_PERIOD, Clocked, intervals
from cranedyn.compiled.block import (
    FAULT,
    BlockCode,
    FunctionBlock,
    Tables,
    Variable,
    identifiers,
)
from cranedyn.compiled.horizon.control_instant import emit_instant, emit_plan
from cranedyn.compiled.horizon.receding import Receding
from cranedyn.controllers.affine import (
    Affine,
    AffineController,
    ControllerStates,
    integrated_command,
    next_states,
)
from cranedyn.controllers.damping import DampingController
from cranedyn.controllers.velocity_command import ShapedVelocityCommand, whole_calls_and_share
from cranedyn.dynamics.converters import Converters, converters_of_run
from cranedyn.dynamics.converters import converters as typical_converters
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.dynamics.scalars import array, clipped
from cranedyn.errors import DataError, OutOfRange
from cranedyn.estimation.observer import ObserverController
from cranedyn.export.crane_data import finite_form
from cranedyn.interfaces import Drive, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.signals import input_names, state_names
from cranedyn.references.motion import Motion
from cranedyn.references.shaped import Shaped
from cranedyn.references.tabulated import tabulated

Emitted = tuple[np.ndarray, dict[str, Any]]
"""Commands of the drives, shape (m,), and new values of memory by name."""


class ControlSetting:
    """Crane, clock and identifiers of a block, which its parts share.

    Attributes:
        crane: The crane.
        period: Control period [s].
        duration: Time that the tables cover [s].
        times: Control instants within that time [s].
        identifier: Identifier of each signal, by the name of the signal.
        state: Identifiers of the measured coordinates, then of their rates, 2 n in all.
        setpoint: Identifiers of the positions of the setpoint, one for each drive.
        rate: Identifiers of the rates of the setpoint one control period later, one for each drive.
        command: Identifiers of the commands, one for each drive.
        drive: Identifiers of the measured positions of the drives.
    """

    def __init__(self, crane: Crane, signals: list[str], period: float, duration: float) -> None:
        """Choose the identifiers.

        Args:
            crane: The crane.
            signals: Names of the commands, one for each drive.
            period: Control period [s].
            duration: Time that the tables cover [s].
        """
        self.crane = crane
        self.period = period
        self.duration = duration
        self.times = period * np.arange(intervals("duration", duration, period) + 1)

        state_signals = state_names(crane)
        symbols = [joint.symbol for joint in crane.layout.driven]
        setpoint_signals = [f"{symbol}_set" for symbol in symbols]
        rate_signals = [f"{symbol}_dot_set" for symbol in symbols]
        # All at once: an identifier is distinct among the names that are given together.
        self.identifier = identifiers([*state_signals, *setpoint_signals, *rate_signals, *signals])
        self.state = [self.identifier[name] for name in state_signals]
        self.setpoint = [self.identifier[name] for name in setpoint_signals]
        self.rate = [self.identifier[name] for name in rate_signals]
        self.command = [self.identifier[name] for name in signals]
        self.drive = [self.state[i] for i in crane.layout.drives.tolist()]


class Part(ABC):
    """A family of controllers, in code.

    Attributes:
        about: Sentence that says what the controller does, for the head of the exported files.
        input_minimum: Smallest value of a measured input, by its identifier; a smaller one is a
            fault.
        braking_accelerations: Largest accelerations with which the drives brake at a fault
            [rad/s² or m/s²], shape (m,); None for those of typical frequency converters.
        memory: Variables that it keeps from one call to the next.
        arrays: Arrays that it keeps, by name, with their values after a reset.
        tables: Its constant tables, by name.
        rows: Number of rows of its longest table. From call `rows` - 1 on, counted from 0, all
            calls take the last row.
        repeats: Period, in calls, with which the code depends on the count of calls; 0 for a
            controller that depends on it by the rows of its tables only.
        routines: Functions that it calls, see `FunctionBlock`; the last is the entry point.
    """

    about: str
    input_minimum: Mapping[str, float] = {}
    braking_accelerations: np.ndarray | None = None
    memory: Sequence[Variable] = ()
    arrays: Mapping[str, np.ndarray] = {}
    tables: Mapping[str, np.ndarray] = {}
    rows = 1
    repeats = 0
    routines: Sequence[Any] = ()

    @abstractmethod
    def emit(self, code: BlockCode, z: np.ndarray) -> Emitted:
        """Emit the commands of the drives. The block clips them to their limits afterwards.

        Args:
            code: The function under construction.
            z: Coordinates and rates, measured or estimated, shape (2 n,).
        """


class _AffinePart(Part):
    """A controller that is affine in the state (`Affine`), with tables of its gains. Its integrals
    and its states are memory of the block.

    The tables hold the form for drives whose setpoint is 0. The positions of the setpoint are
    inputs of the block, which shift the setpoint and the target of the form, see `shifted`.
    """

    def __init__(self, setting: ControlSetting, controller: Any) -> None:
        layout = setting.crane.layout

        def form_at(positions: np.ndarray, instants: int = len(setting.times)) -> Affine:
            """Return the form for a setpoint of the drives that stays at these positions."""
            times = setting.times[:instants]
            rows = np.tile(positions, (instants, 1))
            return finite_form(controller, times, rows, 2 * layout.n, setting.period, "a block")

        form = form_at(np.zeros(layout.m))
        self._setting = setting
        self._form = form
        # How far the setpoint and the target of the form move if the position of the setpoint of a
        # drive moves by one unit, one column for each drive.
        moved = [form_at(position, instants=1) for position in np.eye(layout.m)]
        self._setpoint_shift = np.array([one.setpoint[0] - form.setpoint[0] for one in moved]).T
        self._target_shift = (form_at(np.ones(layout.m), instants=1).target - form.target)[0]
        # At positions that all differ, a form in which one drive depends on the position of another
        # is another one than these shifts say.
        positions = np.random.default_rng(0).uniform(1, 2, layout.m)
        self._check_shift(controller, positions, form_at(positions))

        self._tables = Tables(
            feed_forward=form.feed_forward,
            gain=form.gain.reshape(len(form.gain), -1),
            setpoint=form.setpoint,
            target=form.target,
        )
        self.tables = self._tables.packed
        self.rows = self._tables.rows
        self.about = f"{type(controller).__name__}: commands that are affine in the state."
        self.memory = []
        for i, joint in enumerate(layout.driven):
            if form.integral_gain[i]:
                name = _integral_name(setting.drive[i])
                start = float(form.integral[i])
                self.memory.append(Variable(name, "state", f"{joint.unit}.s", start))
        self._state_names = []
        if form.states is not None:
            self.about = f"{type(controller).__name__}: a linear controller with states of its own."
            for number_of_state, start in enumerate(form.states.initial.tolist(), 1):
                name = f"controller_state_{number_of_state}"
                self._state_names.append(name)
                self.memory.append(Variable(name, "state", "", start))

    def shifted(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return by how much the form moves for positions of the setpoint, for floats and in code.

        Args:
            positions: Positions of the setpoint [rad or m], shape (m,).

        Returns:
            Shift of its setpoint, shape (2 n,), and of its target, shape (m,).
        """
        setpoint_shift = self._setpoint_shift.astype(object) @ positions
        target_shift = array(self._target_shift.tolist()) * positions
        return setpoint_shift, target_shift

    def _check_shift(self, controller: Any, positions: np.ndarray, form: Affine) -> None:
        """Check that the setpoint of the drives does nothing else than shift the form.

        Args:
            controller: The controller, for the error message.
            positions: Positions of the setpoint [rad or m], shape (m,).
            form: Form of the controller there.

        Raises:
            DataError: If it does.
        """
        at_zero = self._form
        shifts = self.shifted(positions)
        setpoint_shift = shifts[0].astype(float)
        target_shift = shifts[1].astype(float)
        is_shifted = (
            _equal_states(at_zero.states, form.states)
            and np.array_equal(at_zero.gain, form.gain)
            and np.array_equal(at_zero.feed_forward, form.feed_forward)
            and np.allclose(form.setpoint - at_zero.setpoint, setpoint_shift, rtol=1e-9, atol=1e-9)
            and np.allclose(form.target - at_zero.target, target_shift, rtol=1e-9, atol=1e-9)
        )
        if not is_shifted:
            raise DataError(
                f"The controller {type(controller).__name__} depends on the setpoint of the drives "
                "otherwise than by its distance; a block takes the setpoint as an input."
            )

    def emit(self, code: BlockCode, z: np.ndarray) -> Emitted:
        setting = self._setting
        layout = setting.crane.layout
        positions = code.get_all(setting.setpoint)
        setpoint_shift, target_shift = self.shifted(positions)
        gain = self._tables.row(code, "gain").reshape(layout.m, -1)
        setpoint = self._tables.row(code, "setpoint") + setpoint_shift
        deviation = z - setpoint
        command = self._tables.row(code, "feed_forward") - gain @ deviation
        target = self._tables.row(code, "target") + target_shift
        states = self._form.states
        x = code.get_all(self._state_names)
        if states is not None:
            command = command + states.c @ x

        memory = {}
        for i, drive in enumerate(layout.drives):
            integral_gain = float(self._form.integral_gain[i])
            if not integral_gain:
                continue
            name = _integral_name(setting.drive[i])
            error = target[i] - z[drive]
            integral = code.get(name)
            limit = float(self._form.limit[i])
            command[i], memory[name] = integrated_command(
                command[i], error, integral, integral_gain, limit, setting.period
            )
        if states is not None:
            # The whole command enters, since the limits of the drives act on it.
            memory |= dict(
                zip(self._state_names, next_states(states, x, deviation, command), strict=True)
            )
        return command, memory


def _equal_states(first: ControllerStates | None, second: ControllerStates | None) -> bool:
    """Return whether two forms of a controller have the same states."""
    if first is None or second is None:
        return first is second
    return all(
        np.array_equal(getattr(first, entry.name), getattr(second, entry.name))
        for entry in fields(ControllerStates)
    )


def _integral_name(drive: str) -> str:
    """Return the name of the variable that integrates the error of a drive."""
    return f"integral_{drive}"


class _YieldingPart(Part):
    """Drives that yield to the swing; the rates of the reference are inputs of the block."""

    about = "Drives that yield to the load, which damps its swing."

    def __init__(self, setting: ControlSetting, controller: Any) -> None:
        _check_period(setting, controller.control_period)
        self._controller = controller
        self._setting = setting
        self.braking_accelerations = controller.accelerations
        # The law takes the frequency of the swing, √(g/l), from the measured cable length l, and a
        # negative number has no root.
        *_, hoist = setting.crane.layout.tower("Drives that yield to the swing")
        self.input_minimum = {setting.state[hoist]: 0.0}

    def emit(self, code: BlockCode, z: np.ndarray) -> Emitted:
        rates = code.get_all(self._setting.rate)
        positions = code.get_all(self._setting.setpoint)
        q, v = np.split(z, 2)
        return self._controller.command(rates, positions, q, v), {}


def _check_period(setting: ControlSetting, period: float) -> None:
    """Check that a block is called with the period [s] for which its controller was made.

    Raises:
        OutOfRange: If its control period is another one.
    """
    if abs(period - setting.period) > SAME_PERIOD * period:
        raise OutOfRange("control period", setting.period, f"{period:g}: the controller's", "s")


class _ObserverPart(Part):
    """A controller behind a Kalman filter, whose gains do not depend on the measurements.

    The filter estimates the deviation d = z - setpoint from the motion about which the crane was
    linearised. With the efforts c of the drives beyond the feed-forward it predicts
    d⁻ = a d + b c from one call to the next, and then corrects that by the measurement y of a part
    of the state, d = d⁻ + K (y - d⁻ at the measured entries). Prediction and correction both stand
    at the beginning of a call, so the block keeps d and c of the call before.
    """

    def __init__(self, setting: ControlSetting, controller: Any) -> None:
        if controller.delay or controller.estimate is not None:
            raise DataError(
                "An observer is exported new and with measurements without delay; this one "
                f"{'has a delay' if controller.delay else 'has run'}."
            )
        model = controller.gains.model
        _check_period(setting, model.period)
        self._inner = controller_code(setting, controller.controller)
        if self._inner.repeats:
            raise DataError("A shaper does not act on an estimate; export it as a block by itself.")
        self._setting = setting
        self._model = model
        self._measured = controller.gains.measured
        self._effort_limit = controller.effort_limit.tolist()

        # The motion is linearised once for each stretch of rows. All stretches but the last have as
        # many rows as each other, so that a division tells the stretch of a row, see `_stretch`.
        new_stretch = np.flatnonzero(np.diff(model.stretch))
        self._rows_of_stretch = int(new_stretch[0]) + 1 if len(new_stretch) else len(model.stretch)

        gains = []
        for k in range(len(setting.times)):
            gain = controller.gains.correction(0, k).gain
            gains.append(gain.ravel())
        self._tables = Tables(
            kalman=np.array(gains),
            motion=np.hstack([model.setpoint, model.efforts]),
            model=np.dstack([model.a, model.b]).reshape(len(model.a), -1),
        )
        self.tables = {**self._inner.tables, **self._tables.packed}
        # One row more than the motion, since a call predicts with the model of the row before.
        self.rows = max(self._tables.rows, self._inner.rows, len(model.stretch) + 1)
        self.about = f"A Kalman filter that estimates the swing; behind it: {self._inner.about}"

        start = np.zeros(2 * setting.crane.layout.n)
        if controller.start is not None:
            start = controller.start - model.setpoint[0]
        self._deviations = [f"deviation_{name}" for name in setting.state]
        self._corrections = [f"correction_{name}" for name in setting.drive]
        self.memory = list(self._inner.memory)
        for name, value in zip(self._deviations, start.tolist(), strict=True):
            self.memory.append(Variable(name, "state", "", value))
        for name in self._corrections:
            self.memory.append(Variable(name, "state"))

    def emit(self, code: BlockCode, z: np.ndarray) -> Emitted:
        predicted = self._predicted_deviation(code)
        motion = self._tables.row(code, "motion")
        gain = self._tables.row(code, "kalman").reshape(len(z), -1)
        setpoint = motion[: len(z)]
        efforts = motion[len(z) :]

        measured = z[self._measured] - setpoint[self._measured]
        deviation = predicted + gain @ (measured - predicted[self._measured])
        command, memory = self._inner.emit(code, setpoint + deviation)

        # The model is driven by the efforts that act, and a drive exerts no more than its limit.
        acting = []
        for effort, limit in zip(command, self._effort_limit, strict=True):
            acting.append(clipped(effort, -limit, limit))
        memory |= dict(zip(self._deviations, deviation, strict=True))
        memory |= dict(zip(self._corrections, array(acting) - efforts, strict=True))
        return command, memory

    def _predicted_deviation(self, code: BlockCode) -> np.ndarray:
        """Emit the deviation that the model predicts from the call before, shape (2 n,); in the
        first call it is that of the expected start.
        """
        size = len(self._deviations)
        model = self._tables.row(code, "model", self._stretch(code)).reshape(size, -1)
        a = model[:, :size]
        b = model[:, size:]
        start = code.get_all(self._deviations)
        advanced = a @ start + b @ code.get_all(self._corrections)
        is_first = code.builder.icmp_signed("==", code.count, code.integer(0))
        predicted = []
        for at_start, after_step in zip(start, advanced, strict=True):
            predicted.append(code.where(is_first, at_start, after_step))
        return array(predicted)

    def _stretch(self, code: BlockCode) -> Any:
        """Emit the index of the model that leads from the call before to this one."""
        build = code.builder
        last_row = code.integer(len(self._model.stretch) - 1)
        row = code.plus(code.count, -1)
        is_on_motion = build.icmp_signed("<", row, last_row)
        # In the first call the row is -1, and the prediction is not used; 0 is a row of the table.
        from_first = code.most(row, code.integer(0))
        stretch = build.sdiv(from_first, code.integer(self._rows_of_stretch))
        # The last row of a motion has a model of its own, which also stands for all that follows.
        return build.select(is_on_motion, stretch, code.integer(len(self._model.a) - 1))


class _PredictivePart(Part):
    """A predictive controller to the setpoint, with the memory of its optimisation."""

    about = "Predictive control: an optimisation over a horizon drives the load to the setpoint."

    def __init__(self, setting: ControlSetting, controller: Receding) -> None:
        from llvmlite import ir

        _check_period(setting, controller.programme.period)
        # Single numbers instead of vectors, which C99 does not have.
        programme = replace(controller.programme, vector_width=1)
        if programme.rows:
            raise DataError(
                "A predictive controller is exported to a setpoint, not along a motion."
            )
        drives = programme.topology.layout.m
        self._setting = setting
        self.arrays = {
            "memory": controller.memory(1),
            # State, setpoint, row of the path, and whether to optimise, see `emit_instant`.
            "query": np.zeros(2 * programme.crane_joints + drives + 2),
            "answer": np.zeros(drives),
        }
        self.repeats = programme.ratio
        module = ir.Module()
        emit_plan(module, programme)
        emit_instant(module, programme)
        self.routines = module.functions

    def emit(self, code: BlockCode, z: np.ndarray) -> Emitted:
        build = code.builder
        positions = code.get_all(self._setting.setpoint)
        # The motion over the horizon is optimised once in `repeats` calls; the other calls go on
        # along the last plan.
        calls_since = build.srem(code.count, code.integer(self.repeats))
        is_due = build.icmp_signed("==", calls_since, code.integer(0))
        row_of_path = 0.0
        query = [*z, *positions, row_of_path, code.where(is_due, 1.0, 0.0)]
        for i, value in enumerate(query):
            code.store(value, code.argument["query"], i)
        instant = self.routines[-1]
        build.call(instant, [code.argument[name] for name in self.arrays])
        commands = [code.element("answer", i) for i in range(len(self._setting.command))]
        return array(commands), {}


class _ShaperPart(Part):
    """Input shaping of setpoints.

    A shaper adds up delayed setpoints s, each times its amplitude: Σ A_i s(t - d_i). The past
    setpoints lie in a ring of rows in memory, one row for each of the last calls. The row of a call
    is its count modulo the number of rows.
    """

    about = "Input shaping: setpoints in parts, so that the swings they cause cancel."

    def __init__(self, setting: ControlSetting, shaper: Shaped | ShapedVelocityCommand) -> None:
        self._setting = setting
        self._amplitudes = shaper.amplitudes.tolist()
        calls, shares = whole_calls_and_share(shaper.delays, setting.period)
        self._delay_calls = calls.tolist()
        self._delay_shares = shares.tolist()

        # The ring reaches from the present call back to the one before the longest delay: a share
        # of a call is interpolated between two of them.
        self.repeats = max(self._delay_calls) + 2
        self._signals = self._shaped_signals()
        self.arrays = {"line": np.zeros(self.repeats * len(self._signals))}
        self._first = [f"first_{name}" for name in setting.drive]
        self.memory = [Variable(name, "state") for name in self._first]

    def _shaped_signals(self) -> list[str]:
        """Return the inputs that are shaped: the positions of the setpoint first."""
        return self._setting.setpoint

    def emit(self, code: BlockCode, z: np.ndarray) -> Emitted:
        return self._emit_shaped(code)

    def _emit_shaped(self, code: BlockCode) -> Emitted:
        """Emit the shaped signals, shape (signals,), and the new values of memory by name."""
        build = code.builder
        count = code.count
        ring_rows = code.integer(self.repeats)
        width = len(self._signals)
        is_first_call = build.icmp_signed("==", count, code.integer(0))
        signal = code.get_all(self._signals)
        # Before the first call the drives are taken to have stood at its setpoint: positions have
        # been those of the first call, and rates 0.
        stored_first = code.get_all(self._first)
        before_first: list[Any] = []
        for new, stored in zip(signal[: len(stored_first)], stored_first, strict=True):
            before_first.append(code.where(is_first_call, new, stored))
        memory = dict(zip(self._first, before_first, strict=True))
        before_first += [0.0] * (width - len(before_first))

        def past(i: int, calls: int) -> Any:
            """Return signal i so many calls ago."""
            if calls == 0:
                return signal[i]
            row = build.srem(code.plus(count, self.repeats - calls), ring_rows)
            stored = code.element("line", code.plus(code.product(row, width), i))
            is_before_first = build.icmp_signed("<", count, code.integer(calls))
            return code.where(is_before_first, before_first[i], stored)

        def delayed(i: int, calls: int, share: float) -> Any:
            """Return signal i so many calls and a share of one ago."""
            value = past(i, calls)
            if share:
                # On the line between the values of two calls.
                value = value + share * (past(i, calls + 1) - value)
            return value

        outputs = []
        for i in range(width):
            output: Any = 0.0
            for calls, share, amplitude in zip(
                self._delay_calls, self._delay_shares, self._amplitudes, strict=True
            ):
                output = output + amplitude * delayed(i, calls, share)
            outputs.append(output)

        row = build.srem(count, ring_rows)
        for i, value in enumerate(signal):
            code.put("line", code.plus(code.product(row, width), i), value)
        return array(outputs), memory


class _ShapedVelocityPart(_ShaperPart):
    """Rates of shaped setpoints, and a share of the distance from them."""

    about = "Input shaping: rates of setpoints in parts, so that the swings they cause cancel."

    def __init__(self, setting: ControlSetting, shaper: ShapedVelocityCommand) -> None:
        _check_period(setting, shaper.period)
        super().__init__(setting, shaper)
        self._recovery = array(shaper.recovery.tolist())

    def _shaped_signals(self) -> list[str]:
        return [*self._setting.setpoint, *self._setting.rate]

    def emit(self, code: BlockCode, z: np.ndarray) -> Emitted:
        shaped, memory = self._emit_shaped(code)
        positions, rates = np.split(shaped, 2)
        drives = z[self._setting.crane.layout.drives]
        return rates + self._recovery * (positions - drives), memory


PARTS: tuple[tuple[type, Callable[..., Part]], ...] = (
    (DampingController, _YieldingPart),
    (ObserverController, _ObserverPart),
    (Shaped, _ShaperPart),
    (ShapedVelocityCommand, _ShapedVelocityPart),
    (Receding, _PredictivePart),
    (AffineController, _AffinePart),
)
"""Controllers that can be exported, each with its part; the first that fits is taken."""


def controller_code(setting: ControlSetting, controller: Any) -> Part:
    """Return the part that emits a controller.

    Raises:
        DataError: If it cannot be exported.
    """
    for kind, part in PARTS:
        if isinstance(controller, kind):
            return part(setting, controller)
    raise DataError(
        f"The controller {type(controller).__name__} is neither affine in the state, nor one of "
        "drives that yield, nor an observer, a shaper, or predictive; a block runs no Python."
    )


EFFORT_RAMP_TIME = 0.25
"""Time in which an effort goes from its limit to zero at a fault [s].

Brakes of cranes close in about a quarter of a second; the drive hands its effort over to them
meanwhile.
"""


class FaultReaction:
    """What the outputs of a controller do at a fault, by their kind.

    * Positions hold their last values: a drive that is told another position would go there.
    * Rates ramp to zero at the accelerations of the drives, which stops the crane.
    * Accelerations brake each drive to rest: an acceleration of zero would keep its rate. They
      begin with the rate that was measured in the last sound call, since the present one may be
      what is not a number.
    * Efforts ramp to those that hold the crane at its start: for a hoist the weight of the load,
      for slew and trolley zero. The last effort would go on to accelerate the crane, and none at
      all would drop the load.

    Attributes:
        about: Sentence that says what the outputs do at a fault.
        memory: Variables that it keeps from one call to the next.
    """

    def __init__(
        self,
        setting: ControlSetting,
        outputs: Sequence[Variable],
        kind: Drive | Literal["position"],
        accelerations: np.ndarray | None,
    ) -> None:
        """Prepare the reaction.

        Args:
            setting: Crane, clock and identifiers of the block.
            outputs: Outputs of the block; at a fault efforts go to their values after a reset.
            kind: What the outputs are: positions, or what drives of this mode take.
            accelerations: Largest accelerations of the drives [rad/s² or m/s²], shape (m,), by
                which rates ramp and accelerations brake; None for positions and efforts.
        """
        self._setting = setting
        self._kind = kind
        self._accelerations = accelerations
        self._held = [f"held_{output.name}" for output in outputs]
        self._braking_rates = [f"braking_rate_{name}" for name in setting.drive]
        self._targets = [output.start for output in outputs]
        about = "for the reaction to a fault"
        if kind == "motion":
            rates = [f"{joint.unit}/s" for joint in setting.crane.layout.driven]
            self.memory = Variable.several(self._braking_rates, "state", rates, about=about)
        else:
            units = [output.unit for output in outputs]
            self.memory = Variable.several(self._held, "state", units, self._targets, about=about)

    @property
    def about(self) -> str:
        """Sentence that says what the outputs do at a fault."""
        sentences = {
            "position": "At a fault the outputs hold their last values.",
            "velocity": "At a fault the rates ramp to zero at the accelerations of the drives.",
            "motion": "At a fault the accelerations brake the drives to rest.",
            "effort": (
                f"At a fault the efforts ramp within {EFFORT_RAMP_TIME:g} s to those that hold "
                "the crane at its start."
            ),
        }
        return sentences[self._kind]

    @property
    def output_of_memory(self) -> dict[str, str]:
        """Names of the outputs whose last values memory keeps, by the names of that memory."""
        if self._kind == "motion":
            return {}
        return dict(zip(self._held, self._setting.command, strict=True))

    def remember(self, rates: np.ndarray) -> dict[str, Any]:
        """Return the new values of its memory other than of outputs, after a call without a fault.

        Args:
            rates: Measured rates of the drives, shape (m,).
        """
        if self._kind != "motion":
            return {}
        # No drive is faster than its limit, whatever a sensor says: from a rate without a limit the
        # drive would be braked long after it stands, and so driven backwards.
        limits = self._setting.crane.rate_limit.tolist()
        memory = {}
        for name, rate, limit in zip(self._braking_rates, rates, limits, strict=True):
            memory[name] = _within(rate, limit)
        return memory

    def emit(self, code: BlockCode) -> Emitted:
        """Emit the outputs of a call at fault."""
        if self._kind == "motion":
            return self._brake(code)
        held = code.get_all(self._held)
        if self._kind == "position":
            return held, {}
        outputs = []
        for last, target, step in zip(held, self._targets, self._largest_steps(), strict=True):
            outputs.append(last + _within(target - last, step))
        return array(outputs), dict(zip(self._held, outputs, strict=True))

    def _brake(self, code: BlockCode) -> Emitted:
        """Emit accelerations that brake the drives to rest, and count down the rates left."""
        assert self._accelerations is not None
        period = self._setting.period
        rates = code.get_all(self._braking_rates)
        braking = []
        for rate, limit in zip(rates, self._accelerations.tolist(), strict=True):
            # -v/T would stop a drive within this period T; the limit stretches it over several.
            braking.append(_within(rate * (-1.0 / period), limit))
        outputs = array(braking)
        return outputs, dict(zip(self._braking_rates, rates + outputs * period, strict=True))

    def _largest_steps(self) -> list[float]:
        """Return the largest change of each output from one call at fault to the next."""
        period = self._setting.period
        if self._kind == "effort":
            steps = period * self._setting.crane.effort_limit / EFFORT_RAMP_TIME
        else:
            assert self._accelerations is not None
            steps = period * self._accelerations
        return steps.tolist()


def _within(value: Any, limit: float) -> Any:
    """Return a value clipped to [-limit, limit], or as it is if the limit is infinite."""
    return clipped(value, -limit, limit) if np.isfinite(limit) else value


def controller_block(
    crane: Crane,
    controller: Any,
    *,
    drive: Drive = "effort",
    control_period: float = 5e-3,
    duration: float = 30.0,
    converters: Converters | None = None,
    name: str = "controller",
) -> FunctionBlock:
    """Return a controller or a shaped reference as a block, whose function "step" a program calls.

    Args:
        crane: The crane.
        controller: The controller; or a reference of `cranedyn.references.shaped.shaped`, whose
            outputs are shaped positions, and whose setpoint is an input instead of its base.
        drive: What the commands are; efforts and rates are clipped to the limits of the drives.
        control_period: Time from one call to the next [s].
        duration: Time that the tables cover [s]; after it their last row holds.
        converters: Frequency converters of the drives; None for typical ones.
        name: Name of the block.

    Raises:
        DataError: If it cannot be exported.
        OutOfRange: If a number is out of range, or the controller is for another control period.
    """
    check_choice("drive", drive, Drive)
    period = float(number("control_period", control_period, "s", "> 0"))
    drives = converters_of_run(crane, drive, converters)
    outputs = _outputs(crane, drive, drives, is_shaper=isinstance(controller, Shaped))
    setting = ControlSetting(crane, outputs.signals, period, duration)
    law = controller_code(setting, controller)
    if 1 < len(setting.times) <= law.rows:
        raise OutOfRange("duration", duration, "longer: the tables still change at its end", "s")

    commands = Variable.several(
        setting.command, "output", outputs.units, outputs.start, -outputs.limits, outputs.limits
    )
    accelerations = drives.accelerations if drives is not None else None
    if outputs.kind == "motion":
        accelerations = law.braking_accelerations
        if accelerations is None:
            accelerations = typical_converters(crane).accelerations
    reaction = FaultReaction(setting, commands, outputs.kind, accelerations)
    variables = [*_inputs(setting, law), *commands, *law.memory, *reaction.memory]

    # The count of calls must not overflow. Where a law depends on it by the rows of tables, it
    # stays at the last row. Where a law depends on its remainder by `repeats`, it goes 0, 1, ...,
    # 2 repeats - 1, repeats, ...: the remainder runs on, and only the first call has the count 0.
    if law.repeats:
        first = law.repeats
        last = 2 * law.repeats - 1
    else:
        first = law.rows - 1
        last = first
    block = FunctionBlock(
        name,
        law.about,
        period,
        tuple(variables),
        law.arrays,
        law.tables,
        last=last,
        first=first,
        renamed={signal: new for signal, new in setting.identifier.items() if signal != new},
        routines=law.routines,
        at_fault=reaction.about,
    )

    def step(code: BlockCode) -> Mapping[str, Any]:
        """Emit a call without a fault, and return the new values of outputs and memory."""
        layout = crane.layout
        z = code.get_all(setting.state)
        command, memory = law.emit(code, z)
        remembered = reaction.remember(z[layout.n + layout.drives])
        return {**dict(zip(setting.command, command, strict=True)), **memory, **remembered}

    def fault(code: BlockCode) -> Mapping[str, Any]:
        """Emit a call at fault, and return the new values of outputs and memory."""
        command, memory = reaction.emit(code)
        return {**dict(zip(setting.command, command, strict=True)), **memory}

    block.emit("step", step, reaction.output_of_memory)
    block.emit(FAULT, fault)
    return block


@dataclass(frozen=True, eq=False)
class _Outputs:
    """The outputs of a block: their signals, units and ranges.

    Attributes:
        kind: "position" for a shaper, else what drives of this mode take.
        signals: Names of the signals, one for each drive.
        units: Units, one for each drive.
        start: Values after a reset, shape (m,).
        limits: Largest magnitudes, shape (m,); inf for none.
    """

    kind: Drive | Literal["position"]
    signals: list[str]
    units: list[str]
    start: np.ndarray
    limits: np.ndarray


def _outputs(crane: Crane, drive: Drive, drives: Converters | None, *, is_shaper: bool) -> _Outputs:
    """Return the outputs of a block.

    Args:
        crane: The crane.
        drive: What the commands are.
        drives: Frequency converters of the drives; None if they take no rates.
        is_shaper: Whether the outputs are shaped positions instead of commands.
    """
    layout = crane.layout
    driven = layout.driven
    at_rest = np.zeros(layout.m)
    unlimited = np.full(layout.m, np.inf)
    if is_shaper:
        signals = [f"{joint.symbol}_shaped" for joint in driven]
        units = [joint.unit for joint in driven]
        return _Outputs("position", signals, units, crane.start.q[layout.drives], unlimited)

    signals = [f"{name}_command" for name in input_names(crane, drive)]
    if drive == "effort":
        units = [joint.effort_unit.replace(" ", ".") for joint in driven]
        holding = holding_effort(crane, crane.start.q)
        return _Outputs(drive, signals, units, holding, crane.effort_limit)
    if drives is not None:
        # Names of rates end in "_command" already.
        units = [f"{joint.unit}/s" for joint in driven]
        return _Outputs(drive, input_names(crane, drive), units, at_rest, drives.rates)
    units = [f"{joint.unit}/s2" for joint in driven]
    return _Outputs(drive, signals, units, at_rest, unlimited)


def _inputs(setting: ControlSetting, law: Part) -> list[Variable]:
    """Return the inputs of a block: the measured state, and the setpoint with its rates."""
    crane = setting.crane
    layout = crane.layout
    state_units = [*layout.units, *(f"{unit}/s" for unit in layout.units)]
    start = np.concatenate(crane.start)
    lowest = [law.input_minimum.get(name, -np.inf) for name in setting.state]
    units = [joint.unit for joint in layout.driven]
    rate_units = [f"{unit}/s" for unit in units]
    positions = start[layout.drives]
    several = Variable.several
    return [
        *several(setting.state, "input", state_units, start, lowest, about="measured"),
        *several(setting.setpoint, "input", units, positions, about="setpoint"),
        *several(setting.rate, "input", rate_units, about="of the setpoint a period later"),
    ]


def reference_calls(
    crane: Crane, controller: Any, block: FunctionBlock, rows: int = 200
) -> tuple[np.ndarray, np.ndarray]:
    """Return consecutive calls of a controller, against which the code of its block is tested.

    The inputs are random, near the start of the crane. The outputs are those of the controller in
    Python, clipped to the ranges of the block.

    Args:
        crane: The crane.
        controller: The controller, which has not run yet.
        block: Its block.
        rows: Number of calls.

    Returns:
        Inputs that the code of the block uses, shape (rows, k), and outputs, shape (rows, m).
    """
    layout = crane.layout
    rng = np.random.default_rng(0)
    z = np.concatenate(crane.start) + rng.uniform(-0.05, 0.05, (rows, 2 * layout.n))
    positions = crane.start.q[layout.drives] + rng.uniform(-0.05, 0.05, (rows, layout.m))
    times = block.period * np.arange(rows)
    rates = np.zeros((rows, layout.m))
    if isinstance(controller, Shaped):
        outputs = _shaped_positions(crane, controller, block.period, positions)
    else:
        controller = copy.copy(controller)
        if isinstance(controller, DampingController):
            later = times + block.period
            rates = tabulated(controller.reference, later, layout.m).velocity
        elif isinstance(controller, ShapedVelocityCommand):
            rates = rng.uniform(-0.05, 0.05, (rows, layout.m))
        outputs = _commands(controller, block.period, z, positions, rates)

    limits = block.of_kind("output")
    lower = [variable.lower for variable in limits]
    upper = [variable.upper for variable in limits]
    # The block has variables for all inputs, but its code need not use each of them.
    declared = [variable.name for variable in block.variables if variable.kind == "input"]
    used = [declared.index(variable.name) for variable in block.of_kind("input")]
    return np.hstack([z, positions, rates])[:, used], np.clip(outputs, lower, upper)


def _shaped_positions(
    crane: Crane, shaped: Shaped, period: float, positions: np.ndarray
) -> np.ndarray:
    """Return the shaped positions in consecutive calls, shape (rows, m).

    Args:
        crane: The crane.
        shaped: The shaper; its own base is not used.
        period: Time from one call to the next [s].
        positions: Positions of the setpoint [rad or m], shape (rows, m).
    """
    drives = crane.layout.drives
    q = np.tile(crane.start.q, (len(positions), 1))
    q[:, drives] = positions
    motion = Motion(period, q, 0.0 * q, 0.0 * q, drives)
    return replace(shaped, base=motion).at(period * np.arange(len(positions))).position


def _commands(
    controller: Any, period: float, z: np.ndarray, positions: np.ndarray, rates: np.ndarray
) -> np.ndarray:
    """Return the commands of a controller in consecutive calls, shape (rows, m).

    Args:
        controller: The controller.
        period: Time from one call to the next [s].
        z: Coordinates and their rates, shape (rows, 2 n).
        positions: Positions of the setpoint, shape (rows, m).
        rates: Rates of the setpoint, shape (rows, m).
    """
    if isinstance(controller, Clocked):
        controller.begin_run(0.0, period)
    outputs = np.empty(positions.shape)
    times = period * np.arange(len(z))
    for k, t in enumerate(times.tolist()):
        q, v = np.split(z[k], 2)
        setpoint = Setpoint(positions[k], rates[k], 0.0 * rates[k])
        outputs[k] = controller(t, State(q, v), setpoint)
    return outputs
