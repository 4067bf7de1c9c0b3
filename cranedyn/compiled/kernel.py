"""Closed loop in code: control, drives, log and steps, for one crane or for one in each lane."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir

from cranedyn.compiled.angles import SHORTER, all_within
from cranedyn.compiled.code import INTEGER, Code, StackVariable, Value
from cranedyn.compiled.horizon.control import PredictiveControl, Programme, emit_instant, emit_plan
from cranedyn.compiled.layout import CALL, SLOTS, TURNS, BufferLayout, Sections, size, slices
from cranedyn.compiled.machine import Machine, translate
from cranedyn.compiled.step import take_step
from cranedyn.compiled.threads import THREAD, emit_lane_loop
from cranedyn.dynamics.integrators import Integrator
from cranedyn.dynamics.scalars import array
from cranedyn.plant.plant import SI, Plant, Topology, Units, plant


@dataclass(frozen=True)
class Recipe:
    """Features of the code to generate.

    Attributes:
        lanes: Number of cranes that run at once.
        drive: "effort", "motion" or "velocity".
        integrator: The stepping rule.
        buffers: Whether buffers end the ranges of the drives.
        integral: Whether the controller integrates.
        offset: Whether the sensors add an offset.
        forces: Whether external forces act.
        shared: Whether all lanes share the gain table, the setpoint table, the forces, and the
            sensor offsets.
        log, summary: Whether rows are recorded, and whether a summary is computed.
        delay_steps: Control periods by which frequency converters delay commands; None for drives
            without converters.
        turns: Steps after which sines and cosines are computed afresh; with 1 a motion is the same
            to the bit for any division into control periods.
        programme: Parameters of a predictive controller; None for one that is affine in the state.
        delayed: Whether the sensors have delays.
        threads: Whether each lane is a thread with plain doubles, as on a GPU, instead of a part of
            a vector.
    """

    lanes: int
    drive: str
    integrator: Integrator
    buffers: bool
    integral: bool
    offset: bool
    forces: bool
    shared: tuple[bool, ...]
    log: bool
    summary: bool
    delay_steps: int | None = None
    turns: int = TURNS
    programme: Programme | None = None
    delayed: bool = False
    threads: bool = False


class Kernel(NamedTuple):
    """Compiled closed loop, to be called through `cranedyn.compiled.binding`.

    Attributes:
        recipe: Its features.
        sizes: Layout of its buffers.
        machine: Its functions: run, the loop; answer, accelerations at one state for each lane;
            and, without a log, energies, of many states of one crane, or several, the loop for each
            of many groups.
        varied: Number of varied numbers of each lane.
        verified: Varied numbers of the cranes for which it was compared with Pinocchio.
        topology, constants: Its sources, to compile it for a GPU.
    """

    recipe: Recipe
    sizes: BufferLayout
    machine: Machine
    varied: int
    verified: set[bytes]
    topology: Topology
    constants: tuple[float | None, ...]


def kernel(topology: Topology, constants: Sequence[float | None], recipe: Recipe) -> Kernel:
    """Compile the loop for a crane whose numbers are constants, or None where each lane has its
    own.
    """
    module = build_module(topology, constants, recipe)
    if recipe.threads:
        emit_lane_loop(module)
    varied, sizes = (
        list(constants).count(None),
        BufferLayout.of(topology.layout, recipe.delay_steps),
    )
    return Kernel(recipe, sizes, translate(module), varied, set(), topology, tuple(constants))


def build_module(
    topology: Topology, constants: Sequence[float | None], recipe: Recipe
) -> ir.Module:
    """Return the loop as a module for LLVM, see `kernel`; for threads it is the loop of one thread,
    see `cranedyn.compiled.threads`.
    """
    module, lanes = ir.Module(), 1 if recipe.threads else recipe.lanes
    if recipe.programme is not None:
        emit_plan(module, recipe.programme)
        if recipe.lanes == 1:
            emit_instant(module, recipe.programme)
    run, accelerations = THREAD if recipe.threads else ("run", "answer")
    _Loop(Code(module, run, ["call"], lanes, recipe.lanes), topology, constants, recipe).emit()
    _emit_answer(
        Code(module, accelerations, ["given", "numbers", "accelerations"], lanes, recipe.lanes),
        topology,
        constants,
        recipe,
    )
    if recipe.lanes == 1 and not recipe.log:
        _emit_energies(
            Code(module, "energies", ["given", "count", "energies"], 1), topology, constants, recipe
        )
    if lanes > 1 and not recipe.log:
        _emit_several(Code(module, "several", ["calls", "count"], 1), module.globals["run"])
    return module


def _plant(
    code: Code,
    numbers: ir.Value,
    topology: Topology,
    constants: Sequence[float | None],
    recipe: Recipe,
) -> Plant:
    varied = count()
    values = [
        code.load(numbers, next(varied) * code.stride) if constant is None else constant
        for constant in constants
    ]
    return plant(topology, values, recipe.drive, recipe.buffers)


def _step_units(crane: Plant, dt: Any, recipe: Recipe) -> tuple[Plant, Units]:
    """Return the crane and the units in which it steps. A thread has too few registers for
    constants in other units, and converting rates after every step would add a rounding error.
    """
    return (crane, SI) if recipe.threads or recipe.turns == 1 else crane.in_steps(dt)


def _emit_answer(
    code: Code, topology: Topology, constants: Sequence[float | None], recipe: Recipe
) -> None:
    for attribute in () if recipe.threads else ("noinline", "optnone"):  # called a few times only
        code.function.attributes.add(attribute)
    crane = _plant(code, code.argument["numbers"], topology, constants, recipe)
    crane, units = _step_units(crane, 1.0, recipe)
    sections = BufferLayout.of(topology.layout).query
    query = [code.load(code.argument["given"], i * code.stride) for i in range(size(sections))]
    q, v, command, forces = (array(query[section]) for section in slices(sections).values())
    pushes = forces * units.force if recipe.forces else None
    for i, a in enumerate(crane.answer(q, v, command * units.command, pushes)[0]):
        code.store(a, code.argument["accelerations"], i * code.stride)
    code.end()


def _emit_energies(
    code: Code, topology: Topology, constants: Sequence[float | None], recipe: Recipe
) -> None:
    states, crane = (
        code.argument["given"],
        _plant(code, code.argument["given"], topology, constants, recipe),
    )
    n = topology.layout.n
    with code.loop(0, code.load_one(code.argument["count"], 0, INTEGER)) as row:
        first = code.product(row, 2 * n)
        state = array(
            [code.spread(states, code.builder.add(first, code.integer(i))) for i in range(2 * n)]
        )
        code.store(crane.energy(state[:n], state[n:]), code.argument["energies"], row)
    code.end()


def _emit_several(code: Code, run: ir.Function) -> None:
    with code.loop(0, code.load_one(code.argument["count"], 0, INTEGER)) as group:
        call = code.builder.gep(
            code.argument["calls"], [code.product(group, len(SLOTS))], source_etype=INTEGER
        )
        code.builder.call(run, [call])
    code.end()


class _Loop:
    """Loop over control instants under construction."""

    def __init__(
        self, code: Code, topology: Topology, constants: Sequence[float | None], recipe: Recipe
    ) -> None:
        self.code, self.recipe, self.call_values = code, recipe, {}
        self.sizes = BufferLayout.of(topology.layout, recipe.delay_steps)
        for kind, names in CALL.items():
            self.call_values.update(
                {name: code.load_one(code.argument["call"], SLOTS[name], kind) for name in names}
            )
        self.dt, self.period = (
            code.from_double(self.call_values[name]) for name in ("dt", "period")
        )
        self.plant = _plant(code, self.call_values["numbers"], topology, constants, recipe)
        self.moving, self.units = _step_units(self.plant, self.dt, recipe)
        self.state = self._variables("state", self.sizes.state)
        self.summary = self._variables("summary", self.sizes.summary) if recipe.summary else {}
        self.turns = {
            i: code.variables([0.0, 0.0])
            for i, joint in enumerate(topology.layout.joints)
            if joint.kind == "revolute" and not recipe.threads  # threads have few registers
        }

    def _variables(self, name: str, sections: Sections) -> dict[str, list[StackVariable]]:
        code = self.code
        variables = [
            StackVariable(code, code.load(self.call_values[name], i * code.stride))
            for i in range(size(sections))
        ]
        return {name_: variables[section] for name_, section in slices(sections).items()}

    def _keep(self, name: str, variables: dict[str, list[StackVariable]]) -> None:
        for i, variable in enumerate(
            variable for group in variables.values() for variable in group
        ):
            self.code.store(variable.get(), self.call_values[name], i * self.code.stride)

    def _row(
        self, table: int, name: str, sections: Sections, instant: ir.Value
    ) -> dict[str, np.ndarray]:
        """Return the row of a table for an instant; beyond its end the last row."""
        code = self.code
        row = code.least(
            instant, code.builder.sub(self.call_values[f"{name}_rows"], code.integer(1))
        )
        if self.recipe.shared[table]:
            firsts = [code.product(row, size(sections))]
        else:
            starts = [
                code.load_one(self.call_values["starts"], table * code.stride + lane, INTEGER)
                for lane in range(code.lanes)
            ]
            firsts = [
                code.product(code.builder.add(start, row), size(sections)) for start in starts
            ]
        pointer = self.call_values[name]
        values = [
            code.spread(pointer, code.builder.add(firsts[0], code.integer(i)))
            if self.recipe.shared[table]
            else code.gather(
                pointer, [code.builder.add(first, code.integer(i)) for first in firsts]
            )
            for i in range(size(sections))
        ]
        return {key: array(values[section]) for key, section in slices(sections).items()}

    def _get(self, section: str) -> np.ndarray:
        return array([variable.get() for variable in self.state[section]])

    def _coordinates(self) -> np.ndarray:
        """Return coordinates, with their sines and cosines cached."""
        q = self._get("q")
        for i, pair in self.turns.items():
            self.code.cache_angle(q[i], *(variable.get() for variable in pair))
        return q

    def _keep_angles(self, q: np.ndarray) -> None:
        for i in self.turns:
            self._keep_angle(i, self.code.sine_and_cosine(q[i]))

    def _keep_angle(self, i: int, pair: tuple[Value, Value]) -> None:
        for variable, value in zip(self.turns[i], pair, strict=True):
            variable.set(value)

    def _set(self, section: str, values: Iterable[Any]) -> None:
        for variable, value in zip(self.state[section], values, strict=True):
            variable.set(value)

    def emit(self) -> None:
        code = self.code
        self._keep_angles(self._get("q"))
        with code.loop(self.call_values["first"], self.call_values["last"]) as instant:
            forces = self._forces(instant)
            begun = code.both(
                code.builder.icmp_signed("==", instant, self.call_values["first"]),
                code.builder.icmp_signed("!=", self.call_values["resumed"], code.integer(0)),
            )
            with code.when(code.builder.not_(begun)):
                self._control(instant, forces)
            with code.when(code.builder.icmp_signed("<", instant, self.call_values["end"])):
                self._period(forces)
        self._keep("state", self.state)
        if self.recipe.summary:
            self._keep("summary", self.summary)
        code.end()

    def _period(self, forces: np.ndarray | None) -> None:
        """Emit the steps of a control period. Sines and cosines are updated step by step, and
        computed afresh every `TURNS` steps and at the end; in between, rates are in the units of
        the steps.
        """
        code, steps, turns = self.code, self.call_values["steps"], self.recipe.turns
        if self.recipe.threads:
            return self._steps(code.integer(0), steps, forces)
        pieces = code.builder.sdiv(
            code.builder.add(steps, code.integer(turns - 1)), code.integer(turns)
        )
        with code.loop(0, pieces) as piece:
            first = code.product(piece, turns)
            last = code.least(code.builder.add(first, code.integer(turns)), steps)
            self._set("v", self._get("v") * self.units.time)
            self._steps(first, last, forces)
            self._set("v", [code.quotient(rate, self.units.time) for rate in self._get("v")])
            self._keep_angles(self._get("q"))

    def _steps(self, first: ir.Value, last: ir.Value, forces: np.ndarray | None) -> None:
        """Emit steps from the first to the one before the last."""
        code, units = self.code, self.units
        with code.fast_loop(first, last) as end:
            q_before, work = self._coordinates(), self.state["buffers"][0].get()
            v, last_command = self._get("v"), self._get("last_command")
            if self.recipe.delay_steps is not None:
                reference, rising = self._next_reference(last_command, v * (1.0 / units.time))
                self._set("reference", reference)
                self._set("rising", rising)
                last_command = array(reference)
            q, v, work = take_step(
                self.recipe.integrator,
                self.moving,
                q_before,
                v,
                last_command * units.command,
                None if forces is None else forces * units.force,
                self.dt / units.time,
                work,
                units.work,
                self.call_values["substeps"],
            )
            self._set("q", q)
            self._set("v", v)
            self._set("buffers", [work])
            used = [i for i in self.turns if code.uses_angle(q_before[i])]
            turns = {i: turn for i in used if (turn := code.turn(q[i])) is not None}
            pairs = {i: turn.rotate(SHORTER) for i, turn in turns.items()}
            for i in used:
                self._keep_angle(i, pairs[i] if i in pairs else code.sine_and_cosine(q[i]))
            little = all_within(code, [*turns.values()], SHORTER)
            end(little)
            with code.when(code.builder.not_(little)):
                for i, turn in turns.items():
                    self._keep_angle(i, turn.refine(pairs[i]))

    def _forces(self, instant: ir.Value) -> np.ndarray | None:
        return (
            self._row(2, "force", self.sizes.force, self.code.most(instant, self.code.integer(0)))[
                "force"
            ]
            if self.recipe.forces
            else None
        )

    def _control(self, instant: ir.Value, forces: np.ndarray | None) -> None:
        code = self.code
        q, v, before = self._coordinates(), self._get("v"), self._get("last_command")
        command = self._controller_command(instant, q, v)
        requested = command
        last_command = self.plant.within(command)
        if self.recipe.delay_steps is not None:
            last_command = self._delay_command(command)
        self._set("last_command", last_command)
        effort = last_command
        if self.recipe.delay_steps is not None and (self.recipe.log or self.recipe.summary):
            if self.recipe.log:
                acted = self._forces(code.builder.sub(instant, code.integer(1)))
                before = self.plant.answer(q, v, self._get("reference"), acted)[1]
            next_reference = array(self._next_reference(last_command, v)[0])
            _, effort, command = self.plant.driven(q, v, next_reference, forces)
        if self.recipe.drive == "motion" and (self.recipe.log or self.recipe.summary):
            before = self.plant.answer(
                q, v, before, self._forces(code.builder.sub(instant, code.integer(1)))
            )[1]
            command = effort = self.plant.answer(q, v, command, forces)[1]
        buffer = self.plant.stop_force(q, v)
        if self.recipe.log:
            row = [
                *q,
                *v,
                *command,
                *effort,
                *before,
                self.plant.energy(q, v),
                self.state["buffers"][0].get(),
                buffer,
                *self._cut(requested),
            ]
            self._log(instant, row)
        if self.recipe.summary:
            self._summarise(instant, q, v, effort, buffer, command, self._cut(requested))

    def _delay_command(self, command: np.ndarray) -> np.ndarray:
        """Return the rounded and delayed commands of the converters, shape (m,)."""
        assert self.plant.response is not None
        waiting = [*self._get("unheard"), *self.plant.response.heard(command)]
        self._set("unheard", waiting[self.sizes.m :])
        return array(waiting[: self.sizes.m])

    def _next_reference(self, heard: np.ndarray, v: np.ndarray) -> tuple[list[Any], list[Any]]:
        """Return reference rates of converters after the next step, and their rates of change, m
        numbers each.
        """
        assert self.plant.response is not None
        rate = v[self.plant.topology.layout.drives]
        before = self._get("reference"), self._get("rising")
        return self.plant.response.ramped(heard, *before, rate, self.dt)

    def _cut(self, command: np.ndarray) -> list[Any]:
        """Return 1 where a command exceeds the largest rate of a converter, else 0; nothing without
        converters.
        """
        if self.plant.response is None:
            return []
        beyond = self.code.either(*self.plant.response.cuts(map(self.code.value, command)))
        return [self.code.chosen(beyond, 1.0, 0.0)]

    def _controller_command(self, instant: ir.Value, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the command of the controller, shape (m,)."""
        code = self.code
        gains, setpoints = (
            self._row(0, "gain_table", self.sizes.gain_table, instant),
            self._row(1, "setpoint_table", self.sizes.setpoint_table, instant),
        )
        z = np.concatenate([q, v])
        if self.recipe.offset:
            z = z + self._row(3, "offset", self.sizes.offset, instant)["reading"]
        if self.recipe.delayed:
            z = self._delay_reading(instant, z)
        if self.recipe.programme is not None:
            control = PredictiveControl(code, self.recipe.programme, self.call_values["horizon"])
            row, due = control.count_instant()
            n = self.sizes.n
            control_function = control.call_instant if code.lanes == 1 else control.command
            return control_function(z[:n], z[n:], setpoints["position"], row, due)
        command = gains["feed_forward"] - gains["gain"].reshape(self.sizes.m, self.sizes.z) @ (
            z - setpoints["setpoint"]
        )
        if not self.recipe.integral:
            return command
        integrals = self._get("integral")
        for i, drive in enumerate(self.plant.topology.layout.drives):
            error = setpoints["position"][i] - z[drive]
            integrated = integrals[i] + error * self.period
            total = command[i] + gains["integral_gain"][i] * integrated
            free = code.either(
                code.call("llvm.fabs", total) <= gains["limit"][i], error * total < 0.0
            )
            integrals[i] = code.chosen(free, integrated, integrals[i])
            command[i] = command[i] + gains["integral_gain"][i] * integrals[i]
        self._set("integral", integrals)
        return command

    def _delay_reading(self, instant: ir.Value, z: np.ndarray) -> np.ndarray:
        """Store the present reading and return the delayed one, shape (2 n,)."""
        code, build, stored = self.code, self.code.builder, self.call_values["reading_count"]
        width = self.sizes.z

        def place(count: ir.Value, i: int) -> ir.Value:
            first = code.product(build.srem(count, stored), width * code.stride)
            return build.add(first, code.integer(i * code.stride))

        for i, value in enumerate(z):
            code.store(value, self.call_values["readings"], place(instant, i))
        lanes = range(code.lanes)
        delays = [code.load_one(self.call_values["delay"], lane, INTEGER) for lane in lanes]
        visible = [code.most(build.sub(instant, delay), code.integer(0)) for delay in delays]
        return array(
            [
                code.gather(
                    self.call_values["readings"],
                    [build.add(place(visible[lane], i), code.integer(lane)) for lane in lanes],
                )
                for i in range(width)
            ]
        )

    def _log(self, instant: ir.Value, row: Sequence[Any]) -> None:
        code, log_interval = self.code, self.call_values["log_interval"]
        with code.when(
            code.builder.icmp_signed(
                "==", code.builder.srem(instant, log_interval), code.integer(0)
            )
        ):
            first = code.product(code.builder.sdiv(instant, log_interval), len(row) * code.stride)
            for i, value in enumerate(row):
                code.store(
                    value,
                    self.call_values["log"],
                    code.builder.add(first, code.integer(i * code.stride)),
                )

    def _summarise(
        self,
        instant: ir.Value,
        q: np.ndarray,
        v: np.ndarray,
        effort: np.ndarray,
        buffer: Any,
        needed: np.ndarray,
        cut: Sequence[Any],
    ) -> None:
        code, crane, summary = self.code, self.plant, self.summary
        swing, amplitude = (code.value(square) for square in crane.swing(q, v))
        _largest(code, summary["peak"][0], swing)
        counts = code.builder.icmp_signed(">=", instant, self.call_values["residual_from"])
        with code.when(counts):
            _largest(code, summary["residual"][0], amplitude)
        for variable, value in zip(summary["effort"], effort, strict=True):
            _largest(code, variable, code.call("llvm.fabs", value))
        hoist = crane.topology.layout.drive_of("hoist")
        holds = code.both(
            *crane.conditions(q, v, buffer if hoist is None else effort[hoist] + buffer, needed),
            *(number < 0.5 for number in cut),
        )
        now = code.from_integer(instant)
        first = summary["invalid"][0]
        first.set(code.chosen(holds, first.get(), code.call("llvm.minnum", first.get(), now)))


def _largest(code: Code, variable: StackVariable, value: Value) -> None:
    """Keep the larger; what is not a number stays."""
    old = variable.get()
    variable.set(code.chosen(value <= old, old, value))
