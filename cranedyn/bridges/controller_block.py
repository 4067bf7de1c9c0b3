"""Controllers as function blocks, for exporters of code.

A block takes what is measured and the setpoints as inputs, and is called once in each control
period. What lies on tables in Python, such as gains along a motion, lies on constant tables in the
block; the count of calls since the reset is the row.

A block at fault does what is safe for the kind of its outputs until the program closes the brakes,
see `FaultReaction`.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from cranedyn.bridges.joints import finite_form, input_names, state_names
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
from cranedyn.compiled.horizon.control import emit_instant, emit_plan
from cranedyn.compiled.horizon.receding import Receding
from cranedyn.controllers.affine import Affine, AffineController, integrated_command
from cranedyn.controllers.damping import DampingController
from cranedyn.dynamics.converters import Converters, fitting
from cranedyn.dynamics.converters import converters as typical_converters
from cranedyn.dynamics.pinocchio import holding_effort
from cranedyn.dynamics.scalars import array, clipped
from cranedyn.errors import DataError, OutOfRange
from cranedyn.estimation.observer import ObserverController
from cranedyn.interfaces import Drive, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.references.motion import Motion
from cranedyn.references.shaped import Shaped
from cranedyn.references.tabulated import tabulated

Emitted = tuple[np.ndarray, dict[str, Any]]
"""Commands of the drives, shape (m,), and new values of memory by name."""


class ControlSetting:
    """Crane, clock and identifiers of a block.

    Attributes:
        crane: The crane.
        period, duration: Control period, and time that tables cover [s].
        times: Control instants of that time [s].
        identifier: Identifiers by names of signals.
        state: Measured coordinates and rates, 2 n identifiers.
        setpoint, rate: Positions of the setpoint, and its rates one control period later, m
            identifiers.
        command: Commands, m identifiers.
        drive: Drives, m identifiers.
    """

    def __init__(self, crane: Crane, signals: list[str], period: float, duration: float) -> None:
        driven = [joint.symbol for joint in crane.layout.driven]
        self.crane, self.period, self.duration = crane, period, duration
        self.times = period * np.arange(intervals("duration", duration, period) + 1)
        groups = [
            state_names(crane),
            [f"{symbol}_set" for symbol in driven],
            [f"{symbol}_dot_set" for symbol in driven],
            signals,
        ]
        self.identifier = identifiers([name for group in groups for name in group])
        self.state, self.setpoint, self.rate, self.command = (
            [self.identifier[name] for name in group] for group in groups
        )
        self.drive = [self.state[i] for i in crane.layout.drives.tolist()]


class Part(ABC):
    """A controller in code.

    Attributes:
        about: Sentence that says what it does.
        lowest: Smallest values of measured inputs, by their identifiers; a fault below.
        braking: Largest accelerations of the drives at a fault, shape (m,); None for those of
            typical frequency converters.
        memory: Variables that it keeps.
        arrays: Arrays that it keeps, with their start.
        tables: Its tables.
        rows: Calls after which nothing depends on their count any more, and one.
        repeats: Calls after which the count starts again; 0 for one that ends at the last row.
        routines: Functions that it calls, see `FunctionBlock`.
    """

    about: str
    lowest: Mapping[str, float] = {}
    braking: np.ndarray | None = None
    memory: Sequence[Variable] = ()
    arrays: Mapping[str, np.ndarray] = {}
    tables: Mapping[str, np.ndarray] = {}
    rows = 1
    repeats = 0
    routines: Sequence[Any] = ()

    @abstractmethod
    def emit(self, code: BlockCode, z: np.ndarray) -> Emitted:
        """Emit the command at coordinates and rates, shape (2 n,)."""


class _AffinePart(Part):
    """A controller that is affine in the state, on tables; its setpoint stays an input."""

    def __init__(self, setting: ControlSetting, controller: Any) -> None:
        self._setting, layout, times = setting, setting.crane.layout, setting.times
        if isinstance(controller, Clocked):
            controller = copy.copy(controller)
            controller.begin_run(0.0, setting.period)
        rng = np.random.default_rng(0)
        still, units, mixed = (
            np.tile(positions, (len(times), 1))
            for positions in (np.zeros(layout.m), np.ones(layout.m), rng.uniform(1, 2, layout.m))
        )
        form, at_units, at_mixed = (
            finite_form(controller, times, positions, 2 * layout.n, "a block")
            for positions in (still, units, mixed)
        )
        self._shift = (at_units.setpoint - form.setpoint)[0, layout.drives]
        self._target_shift = (at_units.target - form.target)[0]
        _check_shift(controller, form, at_mixed, self, layout)
        self._tables = Tables(
            feed_forward=form.feed_forward,
            gain=form.gain.reshape(len(form.gain), -1),
            setpoint=form.setpoint,
            target=form.target,
        )
        self._form, self.tables, self.rows = form, self._tables.packed, self._tables.rows
        self.about = f"{type(controller).__name__}: commands that are affine in the state."
        self.memory = [
            Variable(f"integral_{name}", "state", f"{joint.unit}.s", float(start))
            for name, joint, start, gain in zip(
                setting.drive, layout.driven, form.integral, form.integral_gain, strict=True
            )
            if gain
        ]

    def shifted(self, positions: np.ndarray, drives: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the shifts of setpoint, shape (2 n,), and target, shape (m,), with positions."""
        shift = array([0.0] * (2 * self._setting.crane.layout.n))
        shift[drives] = array(self._shift.tolist()) * positions
        return shift, array(self._target_shift.tolist()) * positions

    def emit(self, code: BlockCode, z: np.ndarray) -> Emitted:
        tables, setting = self._tables, self._setting
        layout = setting.crane.layout
        shift, target_shift = self.shifted(code.get_all(setting.setpoint), layout.drives)
        gain = tables.row(code, "gain").reshape(layout.m, -1)
        setpoint = tables.row(code, "setpoint") + shift
        command = tables.row(code, "feed_forward") - gain @ (z - setpoint)
        target, memory = tables.row(code, "target") + target_shift, {}
        for i, (name, drive) in enumerate(zip(setting.drive, layout.drives, strict=True)):
            if gain_of_integral := float(self._form.integral_gain[i]):
                error, limit = target[i] - z[drive], float(self._form.limit[i])
                integral = code.get(f"integral_{name}")
                command[i], memory[f"integral_{name}"] = integrated_command(
                    command[i], error, integral, gain_of_integral, limit, setting.period
                )
        return command, memory


def _check_shift(
    controller: Any, still: Affine, mixed: Affine, block: _AffinePart, layout: Any
) -> None:
    """Check that the setpoint of the drives does nothing but shift the setpoint of the form.

    Raises:
        DataError: If it does more.
    """
    position = np.random.default_rng(0).uniform(1, 2, layout.m)
    shift, target = (s.astype(float) for s in block.shifted(position, layout.drives))
    same = (
        np.array_equal(still.gain, mixed.gain)
        and np.array_equal(still.feed_forward, mixed.feed_forward)
        and np.allclose(mixed.setpoint - still.setpoint, shift, rtol=1e-9, atol=1e-9)
        and np.allclose(mixed.target - still.target, target, rtol=1e-9, atol=1e-9)
    )
    if not same:
        raise DataError(
            f"The controller {type(controller).__name__} depends on the setpoint of the drives "
            "otherwise than by its distance; a block takes the setpoint as an input."
        )


class _YieldingPart(Part):
    """Drives that yield to the swing; rates of the reference are inputs."""

    about = "Drives that yield to the load, which damps its swing."

    def __init__(self, setting: ControlSetting, controller: Any) -> None:
        _check_period(setting, controller.control_period)
        self._controller, self._setting = controller, setting
        self.braking = controller.accelerations
        # The frequency of the swing is the square root of gravity over the length of the rope.
        *_, hoist = setting.crane.layout.tower("Drives that yield to the swing")
        self.lowest = {setting.state[hoist]: 0.0}

    def emit(self, code: BlockCode, z: np.ndarray) -> Emitted:
        rates, positions = code.get_all(self._setting.rate), code.get_all(self._setting.setpoint)
        return self._controller.command(rates, positions, *np.split(z, 2)), {}


def _check_period(setting: ControlSetting, period: float) -> None:
    if abs(period - setting.period) > SAME_PERIOD * period:
        raise OutOfRange("control period", setting.period, f"{period:g}: the controller's", "s")


class _ObserverPart(Part):
    """A controller behind a Kalman filter, whose gains do not depend on the measurements."""

    def __init__(self, setting: ControlSetting, controller: Any) -> None:
        if controller.delay or controller.estimate is not None:
            raise DataError(
                "An observer is exported new and with measurements without delay; this one "
                f"{'has a delay' if controller.delay else 'has run'}."
            )
        model, layout = controller.gains.model, setting.crane.layout
        _check_period(setting, model.period)
        self._inner = controller_code(setting, controller.controller)
        if self._inner.repeats:
            raise DataError("A shaper does not act on an estimate; export it as a block by itself.")
        self._model, self._setting, self._measured = model, setting, controller.gains.measured
        self._limit = controller.effort_limit.tolist()
        changes = np.flatnonzero(np.diff(model.stretch))
        self._every = int(changes[0]) + 1 if len(changes) else len(model.stretch)
        gains = [controller.gains.correction(0, k)[0].ravel() for k in range(len(setting.times))]
        self._tables = Tables(
            kalman=np.array(gains),
            motion=np.hstack([model.setpoint, model.efforts]),
            model=np.dstack([model.a, model.b]).reshape(len(model.a), -1),
        )
        self.tables = {**self._inner.tables, **self._tables.packed}
        self.rows = max(self._tables.rows, self._inner.rows, len(model.stretch) + 1)
        self.about = f"A Kalman filter that estimates the swing; behind it: {self._inner.about}"
        start = np.zeros(2 * layout.n)
        if controller.start is not None:
            start = controller.start - model.setpoint[0]
        self._deviations = [f"deviation_{name}" for name in setting.state]
        self._corrections = [f"correction_{name}" for name in setting.drive]
        pairs = zip(self._deviations, start.tolist(), strict=True)
        self.memory = [
            *self._inner.memory,
            *(Variable(name, "state", "", value) for name, value in pairs),
            *(Variable(name, "state") for name in self._corrections),
        ]

    def emit(self, code: BlockCode, z: np.ndarray) -> Emitted:
        build, n2 = code.builder, len(z)
        last, before = code.integer(len(self._model.stretch) - 1), code.plus(code.count, -1)
        stretch = build.select(
            build.icmp_signed("<", before, last),
            build.sdiv(code.most(before, code.integer(0)), code.integer(self._every)),
            code.integer(len(self._model.a) - 1),
        )
        model = self._tables.row(code, "model", stretch).reshape(n2, -1)
        old = code.get_all(self._deviations)
        new = model[:, :n2] @ old + model[:, n2:] @ code.get_all(self._corrections)
        first = build.icmp_signed("==", code.count, code.integer(0))
        predicted = array([code.chosen(first, x, y) for x, y in zip(old, new, strict=True)])
        motion = self._tables.row(code, "motion")
        gain = self._tables.row(code, "kalman").reshape(n2, -1)
        setpoint, efforts = motion[:n2], motion[n2:]
        measured = z[self._measured] - setpoint[self._measured]
        deviation = predicted + gain @ (measured - predicted[self._measured])
        command, memory = self._inner.emit(code, setpoint + deviation)
        acting = [clipped(c, -x, x) for c, x in zip(command, self._limit, strict=True)]
        memory |= dict(zip(self._deviations, deviation, strict=True))
        memory |= dict(zip(self._corrections, array(acting) - efforts, strict=True))
        return command, memory


class _PredictivePart(Part):
    """A predictive controller to the setpoint, with the memory of its optimisation."""

    about = "Predictive control: an optimisation over a horizon drives the load to the setpoint."

    def __init__(self, setting: ControlSetting, controller: Receding) -> None:
        _check_period(setting, controller.programme.period)
        programme = replace(controller.programme, width=1)
        from llvmlite import ir

        if programme.rows:
            raise DataError(
                "A predictive controller is exported to a setpoint, not along a motion."
            )
        shape = programme.shape(1)
        sizes = {"query": shape.states + shape.inputs + 2, "answer": shape.inputs}
        self.arrays = {"memory": controller.memory(1)}
        self.arrays |= {name: np.zeros(n) for name, n in sizes.items()}
        self.repeats, self._setting = programme.ratio, setting
        module = ir.Module()
        emit_plan(module, programme)
        emit_instant(module, programme)
        self.routines = module.functions

    def emit(self, code: BlockCode, z: np.ndarray) -> Emitted:
        build, query = code.builder, code.argument["query"]
        numbers = [*z, *code.get_all(self._setting.setpoint)]
        turn = build.srem(code.count, code.integer(self.repeats))
        due = build.icmp_signed("==", turn, code.integer(0))
        for i, value in enumerate([*numbers, 0.0, code.chosen(due, 1.0, 0.0)]):
            code.store(value, query, i)
        arrays = [code.argument[name] for name in self.arrays]
        build.call(self.routines[-1], arrays)
        return array([code.element("answer", i) for i in range(len(self._setting.command))]), {}


class _ShaperPart(Part):
    """Input shaping of setpoints, which lie on a line in memory."""

    about = "Input shaping: setpoints in parts, so that the swings they cause cancel."

    def __init__(self, setting: ControlSetting, shaped: Any) -> None:
        delays = shaped.delays / setting.period
        self._setting, self._amplitudes = setting, shaped.amplitudes.tolist()
        self._m = setting.crane.layout.m
        calls = np.floor(delays + SAME_PERIOD)
        self._parts = list(zip(calls.astype(int).tolist(), (delays - calls).tolist(), strict=True))
        self.repeats = int(calls.max()) + 2
        self.arrays = {"line": np.zeros(self.repeats * self._m)}
        self._first = [f"first_{name}" for name in setting.drive]
        self.memory = [Variable(name, "state") for name in self._first]

    def emit(self, code: BlockCode, z: np.ndarray) -> Emitted:
        build, count, length = code.builder, code.count, code.integer(self.repeats)
        begins = build.icmp_signed("==", count, code.integer(0))
        now = code.get_all(self._setting.setpoint)
        initial = code.get_all(self._first)
        first = [code.chosen(begins, x, y) for x, y in zip(now, initial, strict=True)]

        def past(i: int, calls: int) -> Any:
            if calls == 0:
                return now[i]
            row = build.srem(code.plus(count, self.repeats - calls), length)
            stored = code.element("line", code.plus(code.product(row, self._m), i))
            early = build.icmp_signed("<", count, code.integer(calls))
            return code.chosen(early, first[i], stored)

        outputs = []
        for i in range(self._m):
            output: Any = 0.0
            for (calls, share), amplitude in zip(self._parts, self._amplitudes, strict=True):
                value = past(i, calls)
                if abs(share) > SAME_PERIOD:
                    value = value + share * (past(i, calls + 1) - value)
                output = output + amplitude * value
            outputs.append(output)
        row = build.srem(count, length)
        for i, value in enumerate(now):
            code.put("line", code.plus(code.product(row, self._m), i), value)
        return array(outputs), dict(zip(self._first, first, strict=True))


PARTS: tuple[tuple[type, Callable[..., Part]], ...] = (
    (DampingController, _YieldingPart),
    (ObserverController, _ObserverPart),
    (Shaped, _ShaperPart),
    (Receding, _PredictivePart),
    (AffineController, _AffinePart),
)
"""Controllers that can be exported, and what emits them; the first that fits is taken."""


def controller_code(setting: ControlSetting, controller: Any) -> Part:
    """Return a controller in code.

    Raises:
        DataError: If it cannot be exported.
    """
    for kind, emitter in PARTS:
        if isinstance(controller, kind):
            return emitter(setting, controller)
    raise DataError(
        f"The controller {type(controller).__name__} is neither affine in the state, nor one of "
        "drives that yield, nor an observer, a shaper, or predictive; a block runs no Python."
    )


EFFORT_RAMP_TIME = 0.25
"""Time in which an effort goes from its limit to zero at a fault [s]. Brakes of cranes close in
about a quarter of a second; the drive hands its effort over to them meanwhile."""


class FaultReaction:
    """What the outputs of a controller do at a fault, by their kind.

    * Positions hold their last values: a drive that is told another position would go there.
    * Rates ramp to zero at the accelerations of the drives, which stops the crane.
    * Accelerations brake each drive to rest: an acceleration of zero would keep its rate. They
      begin with the last measured rate, since the present one may be what is not a number.
    * Efforts ramp to those that hold the crane at its start: for a hoist the weight of the load,
      for slew and trolley zero. The last effort would go on to accelerate the crane, and none at
      all would drop the load.

    Attributes:
        about: Sentence that says it.
        memory: Variables that it keeps.
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
        self._setting, self._kind, self._accelerations = setting, kind, accelerations
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
        """Sentence that says what the outputs do."""
        return {
            "position": "At a fault the outputs hold their last values.",
            "velocity": "At a fault the rates ramp to zero at the accelerations of the drives.",
            "motion": "At a fault the accelerations brake the drives to rest.",
            "effort": (
                f"At a fault the efforts ramp within {EFFORT_RAMP_TIME:g} s to those that hold "
                "the crane at its start."
            ),
        }[self._kind]

    @property
    def copies(self) -> dict[str, str]:
        """Memory that keeps the last value of an output: name of the output by that of memory."""
        if self._kind == "motion":
            return {}
        return dict(zip(self._held, self._setting.command, strict=True))

    def remember(self, rates: np.ndarray) -> dict[str, Any]:
        """Return the new values of its other memory in a call without a fault.

        Args:
            rates: Measured rates of the drives, shape (m,).
        """
        if self._kind != "motion":
            return {}
        # No drive is faster than its limit, whatever a sensor says; it would be braked for ever.
        limits = self._setting.crane.rate_limit.tolist()
        return {
            name: _within(rate, limit)
            for name, rate, limit in zip(self._braking_rates, rates, limits, strict=True)
        }

    def emit(self, code: BlockCode) -> Emitted:
        """Emit the outputs of a call at fault."""
        if self._kind == "motion":
            return self._brake(code)
        held = code.get_all(self._held)
        if self._kind == "position":
            return held, {}
        steps = self._largest_steps()
        outputs = [
            last + _within(target - last, step)
            for last, target, step in zip(held, self._targets, steps, strict=True)
        ]
        return array(outputs), dict(zip(self._held, outputs, strict=True))

    def _brake(self, code: BlockCode) -> Emitted:
        """Emit accelerations that brake the drives to rest, and count down the rates left."""
        assert self._accelerations is not None
        period = self._setting.period
        rates = code.get_all(self._braking_rates)
        limits = self._accelerations.tolist()
        outputs = array(
            [_within(rate * (-1.0 / period), a) for rate, a in zip(rates, limits, strict=True)]
        )
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
    """Return a value cut to a limit on either side, or as it is for an infinite limit."""
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
    """Return a controller or a shaped reference as a block; its function is "step".

    Args:
        crane: The crane.
        controller: The controller, or a reference of `cranedyn.references.shaped.shaped`, whose
            base is then the input.
        drive: What the commands are; efforts and rates are cut to the limits of the drives.
        control_period: Time from one call to the next [s].
        duration: Time that tables cover [s]; after it their last row holds.
        converters: Frequency converters of the drives; None for typical ones.
        name: Name of the block.

    Raises:
        DataError: If it cannot be exported.
        OutOfRange: If a number is out of range, or the controller is for another control period.
    """
    check_choice("drive", drive, Drive)
    control_period = float(number("control_period", control_period, "s", "> 0"))
    layout, driven = crane.layout, crane.layout.driven
    limits, holding = np.full(layout.m, np.inf), np.zeros(layout.m)
    positions = [joint.unit for joint in driven]
    rates, units = ([f"{unit}/{per}" for unit in positions] for per in ("s", "s2"))
    signals = [f"{name}_command" for name in input_names(crane, drive)]
    kind: Drive | Literal["position"] = drive
    drives = fitting(crane, drive, converters)
    if isinstance(controller, Shaped):
        kind = "position"
        units, holding = positions, crane.start.q[layout.drives]
        signals = [f"{joint.symbol}_shaped" for joint in driven]
    elif drive == "effort":
        limits, holding = crane.effort_limit, holding_effort(crane, crane.start.q)
        units = [joint.effort_unit.replace(" ", ".") for joint in driven]
    elif drives is not None:
        limits, units, signals = drives.rates, rates, input_names(crane, drive)
    setting = ControlSetting(crane, signals, control_period, duration)
    law = controller_code(setting, controller)
    if 1 < len(setting.times) <= law.rows:
        raise OutOfRange("duration", duration, "longer: the tables still change at its end", "s")
    state_units = [*layout.units, *(f"{unit}/s" for unit in layout.units)]
    start = np.concatenate(crane.start)
    lowest = [law.lowest.get(name, -np.inf) for name in setting.state]
    several = Variable.several
    outputs = several(setting.command, "output", units, holding, -limits, limits)
    accelerations = drives.accelerations if drives is not None else None
    if kind == "motion":
        accelerations = law.braking
        if accelerations is None:
            accelerations = typical_converters(crane).accelerations
    reaction = FaultReaction(setting, outputs, kind, accelerations)
    variables = [
        *several(setting.state, "input", state_units, start, lowest, about="measured"),
        *several(setting.setpoint, "input", positions, start[layout.drives], about="setpoint"),
        *several(setting.rate, "input", rates, about="of the setpoint a period later"),
        *outputs,
        *law.memory,
        *reaction.memory,
    ]
    first = law.repeats or law.rows - 1
    block = FunctionBlock(
        name,
        law.about,
        control_period,
        tuple(variables),
        law.arrays,
        law.tables,
        last=2 * law.repeats - 1 if law.repeats else first,
        first=first,
        renamed={signal: new for signal, new in setting.identifier.items() if signal != new},
        routines=law.routines,
        at_fault=reaction.about,
    )

    def step(code: BlockCode) -> Mapping[str, Any]:
        z = code.get_all(setting.state)
        command, memory = law.emit(code, z)
        kept = reaction.remember(z[layout.n + layout.drives])
        return {**dict(zip(setting.command, command, strict=True)), **memory, **kept}

    def fault(code: BlockCode) -> Mapping[str, Any]:
        command, memory = reaction.emit(code)
        return {**dict(zip(setting.command, command, strict=True)), **memory}

    block.emit("step", step, reaction.copies)
    block.emit(FAULT, fault)
    return block


def vectors(
    crane: Crane, controller: Any, block: FunctionBlock, rows: int = 200
) -> tuple[np.ndarray, np.ndarray]:
    """Return inputs of a controller's block in consecutive calls, and the outputs that the
    controller gives in Python, cut to their ranges, for tests of its code.

    Args:
        crane: The crane.
        controller: The controller, new.
        block: Its block.
        rows: Number of calls.

    Returns:
        Inputs that the block uses, shape (rows, k), and outputs, shape (rows, m).
    """
    rng, layout, period = np.random.default_rng(0), crane.layout, block.period
    n, m = layout.n, layout.m
    z = np.concatenate(crane.start) + rng.uniform(-0.05, 0.05, (rows, 2 * n))
    positions = crane.start.q[layout.drives] + rng.uniform(-0.05, 0.05, (rows, m))
    times, rates = period * np.arange(rows), np.zeros((rows, m))
    outputs, controller = np.empty((rows, m)), copy.copy(controller)
    if isinstance(controller, Shaped):
        q = np.tile(crane.start.q, (rows, 1))
        q[:, layout.drives] = positions
        motion = Motion(period, q, 0.0 * q, 0.0 * q, layout.drives)
        outputs[:] = replace(controller, base=motion).at(times).position
    else:
        if isinstance(controller, DampingController):
            rates = tabulated(controller.reference, times + period, m).velocity
        if isinstance(controller, Clocked):
            controller.begin_run(0.0, period)
        for k, t in enumerate(times.tolist()):
            setpoint = Setpoint(positions[k], rates[k], 0.0 * rates[k])
            outputs[k] = controller(t, State(z[k, :n], z[k, n:]), setpoint)
    limits = block.of_kind("output")
    lower, upper = ([getattr(v, end) for v in limits] for end in ("lower", "upper"))
    every = [variable.name for variable in block.variables if variable.kind == "input"]
    used = [every.index(variable.name) for variable in block.of_kind("input")]
    return np.hstack([z, positions, rates])[:, used], np.clip(outputs, lower, upper)
