"""Closed loop in code: control, drives, log and steps, for one crane or for one in each lane."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from itertools import chain, count
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from llvmlite import ir

from cranedyn.compiled.angles import SHORTER, all_within
from cranedyn.compiled.code import INTEGER, Code, StackVariable, Value, uses
from cranedyn.compiled.layout import SLOTS, TURNS, BufferLayout, Sections, size, slices
from cranedyn.compiled.machine import Machine, translate
from cranedyn.compiled.step import Step, StepState
from cranedyn.compiled.threads import KINDS, THREAD, emit_lane_loop
from cranedyn.controllers.affine import integrated_command
from cranedyn.dynamics.contact import Contacts
from cranedyn.dynamics.integrators import Integrator
from cranedyn.dynamics.scalars import array
from cranedyn.plant.plant import SI, Plant, Topology, Units, plant
from cranedyn.simulation.stepper import DIVERGED

if TYPE_CHECKING:
    from cranedyn.compiled.horizon.memory import Programme


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
        ledger: Whether the rows are those of the log of `simulate`, with its energy ledger.
        areas: Drag areas of the points [m²] in a wind, whose velocities then stand in place of the
            forces; empty without wind. It needs the ledger.
        delay_steps: Control periods by which frequency converters delay commands; None for drives
            without converters.
        turns: Steps after which sines and cosines are computed afresh; with 1 a motion is the same
            to the bit for any division into control periods.
        programme: Parameters of a predictive controller; None for one that is affine in the state.
        delayed: Whether the sensors have delays.
        threads: Whether each lane is a thread with plain doubles, as on a GPU, instead of a part of
            a vector.
        contacts: Contacts of the load with the ground; None for none.
    """

    lanes: int
    drive: str
    integrator: Integrator
    buffers: bool = False
    integral: bool = False
    offset: bool = False
    forces: bool = False
    shared: tuple[bool, ...] = (True, True, True)
    log: bool = False
    summary: bool = False
    delay_steps: int | None = None
    turns: int = TURNS
    programme: Programme | None = None
    delayed: bool = False
    threads: bool = False
    contacts: Contacts | None = None
    ledger: bool = False
    areas: tuple[float, ...] = ()


class KernelSource(NamedTuple):
    """What code is made from; equal sources give equal code.

    Attributes:
        topology: Topology of the cranes.
        constants: Their numbers, None where each lane has its own.
        recipe: Features of the code.
    """

    topology: Topology
    constants: tuple[float | None, ...]
    recipe: Recipe

    @property
    def sizes(self) -> BufferLayout:
        """Layout of the buffers."""
        recipe = self.recipe
        sizes = BufferLayout.of(self.topology.layout, recipe.delay_steps, recipe.contacts)
        return replace(sizes, ledger=recipe.ledger)

    @property
    def varied(self) -> int:
        """Number of numbers that each lane has of its own."""
        return self.constants.count(None)

    def plant(self, code: Code, numbers: ir.Value) -> Plant:
        """Return the crane whose varied numbers are at an address."""
        varied = count()
        values = [
            code.load(numbers, next(varied) * code.stride) if constant is None else constant
            for constant in self.constants
        ]
        recipe = self.recipe
        numbered = plant(self.topology, values, recipe.drive, recipe.buffers)
        return replace(numbered, contacts=recipe.contacts)

    def in_steps(self, crane: Plant, dt: Any) -> tuple[Plant, Units]:
        """Return the crane and the units in which it steps. A thread has too few registers for
        constants in other units, and converting rates after every step would add a rounding error.
        """
        return (crane, SI) if self.recipe.threads or self.recipe.turns == 1 else crane.in_steps(dt)


class Kernel(NamedTuple):
    """Compiled closed loop, to be called through `cranedyn.compiled.binding`.

    Attributes:
        source: What it is made from.
        sizes: Layout of its buffers.
        machine: Its functions: run, the loop; answer, accelerations at one state for each lane;
            and, for many lanes without a log, several, the loop for each of many groups.
        verified: Varied numbers of the cranes for which it was compared with Pinocchio.
    """

    source: KernelSource
    sizes: BufferLayout
    machine: Machine
    verified: set[bytes]


def kernel(source: KernelSource) -> Kernel:
    """Compile the loop."""
    module = build_module(source)
    if source.recipe.threads:
        emit_lane_loop(module)
    machine = translate(module, inlining=source.recipe.lanes > 1)
    return Kernel(source, source.sizes, machine, set())


def build_module(source: KernelSource) -> ir.Module:
    """Return the loop as a module for LLVM; for threads it is the loop of one thread, see
    `cranedyn.compiled.threads`.
    """
    module, recipe = ir.Module(), source.recipe
    lanes = 1 if recipe.threads else recipe.lanes
    if recipe.programme is not None:
        from cranedyn.compiled.horizon.control import emit_instant, emit_plan  # few runs need it

        emit_plan(module, recipe.programme, lanes)
        if recipe.lanes == 1:
            emit_instant(module, recipe.programme)
    run, answer = THREAD if recipe.threads else ("run", "answer")
    _Loop(Code(module, run, ["call"], lanes, recipe.lanes), source).emit()
    arguments = ["given", "numbers", "accelerations"]
    _emit_answer(Code(module, answer, arguments, lanes, recipe.lanes), source)
    if lanes > 1 and not recipe.log:
        _emit_several(Code(module, "several", ["calls", "count"], 1), module.globals["run"])
    return module


def _emit_answer(code: Code, source: KernelSource) -> None:
    for attribute in () if source.recipe.threads else ("noinline", "optnone"):  # called rarely
        code.function.attributes.add(attribute)
    crane, units = source.in_steps(source.plant(code, code.argument["numbers"]), 1.0)
    sections = source.sizes.query
    query = [code.load(code.argument["given"], i * code.stride) for i in range(size(sections))]
    q, v, command, forces = (array(query[section]) for section in slices(sections).values())
    pushes = forces * units.force if source.recipe.forces else None
    for i, a in enumerate(crane.answer(q, v, command * units.command, pushes)[0]):
        code.store(a, code.argument["accelerations"], i * code.stride)
    code.end()


def _emit_several(code: Code, run: ir.Function) -> None:
    calls = code.argument["calls"]
    with code.loop(0, code.load_one(code.argument["count"], 0, INTEGER)) as group:
        first = code.product(group, len(SLOTS))
        code.builder.call(run, [code.builder.gep(calls, [first], source_etype=INTEGER)])
    code.end()


class _Loop:
    """Loop over control instants under construction."""

    def __init__(self, code: Code, source: KernelSource) -> None:
        self.code, self.recipe, self.sizes = code, source.recipe, source.sizes
        call = code.argument["call"]
        self.call_values = {name: code.load_one(call, SLOTS[name], KINDS[name]) for name in SLOTS}
        self.dt = code.from_double(self.call_values["dt"])
        self.period = code.from_double(self.call_values["period"])
        self.plant = source.plant(code, self.call_values["numbers"])
        self.moving, self.units = source.in_steps(self.plant, self.dt)
        self.state = self._variables("state", self.sizes.state)
        self.summary = self._variables("summary", self.sizes.summary) if self.recipe.summary else {}
        self.turns = {
            i: code.variables([0.0, 0.0])
            for i, joint in enumerate(source.topology.layout.joints)
            if joint.kind == "revolute" and not self.recipe.threads  # threads have few registers
        }
        self.loaded: dict[int, list[Value]] = {i: [] for i in self.turns}

    def _variables(self, name: str, sections: Sections) -> dict[str, list[StackVariable]]:
        code, address = self.code, self.call_values[name]
        variables = [
            StackVariable(code, code.load(address, i * code.stride)) for i in range(size(sections))
        ]
        return {key: variables[section] for key, section in slices(sections).items()}

    def _keep(self, name: str, variables: dict[str, list[StackVariable]]) -> None:
        for i, variable in enumerate(chain.from_iterable(variables.values())):
            self.code.store(variable.get(), self.call_values[name], i * self.code.stride)

    def _row(self, table: int, name: str, instant: ir.Value) -> Callable[[str], np.ndarray]:
        """Return a function that loads a section of the row of a table for an instant; beyond its
        end of the last row.
        """
        code, pointer, sections = self.code, self.call_values[name], getattr(self.sizes, name)
        width, columns = size(sections), slices(sections)
        last = code.builder.sub(self.call_values[f"{name}_rows"], code.integer(1))
        rows = [row := code.least(instant, last)]
        if not self.recipe.shared[table]:
            first, starts = table * code.stride, self.call_values["starts"]
            begins = [code.load_one(starts, first + lane, INTEGER) for lane in range(code.lanes)]
            rows = [code.builder.add(start, row) for start in begins]
        addresses = [code.address(pointer, code.product(row, width)) for row in rows]
        return lambda section: array(
            [code.gather(addresses, i) for i in range(width)[columns[section]]]
        )

    def _get(self, section: str) -> np.ndarray:
        return array([variable.get() for variable in self.state[section]])

    def _anchors(self) -> np.ndarray:
        """Return the anchors of the ground, shape (3 points,); empty without ground."""
        return self._get("anchors") if self.sizes.touching else array([])

    def _coordinates(self) -> np.ndarray:
        """Return coordinates, with their sines and cosines cached."""
        q = self._get("q")
        for i, pair in self.turns.items():
            sine, cosine = (variable.get() for variable in pair)
            self.code.cache_angle(q[i], sine, cosine)
            self.loaded[i] += sine, cosine
        return q

    def _used_turns(self) -> list[int]:
        """Return the joints of whose angles the code so far needs sines or cosines."""
        needed = uses(self.code.function)
        return [i for i in self.turns if any(x.register in needed for x in self.loaded[i])]

    def _keep_angles(self, joints: Iterable[int]) -> None:
        q = self._get("q")
        for i in joints:
            self._keep_angle(i, self.code.sine_and_cosine(q[i]))

    def _keep_angle(self, i: int, pair: tuple[Value, Value]) -> None:
        for variable, value in zip(self.turns[i], pair, strict=True):
            variable.set(value)

    def _set(self, section: str, values: Iterable[Any]) -> None:
        for variable, value in zip(self.state[section], values, strict=True):
            variable.set(value)

    def emit(self) -> None:
        code = self.code
        self._keep_angles(self.turns)
        call, compared = self.call_values, code.builder.icmp_signed
        with code.loop(call["first"], call["last"]) as instant:
            forces = self._forces(instant)
            first = compared("==", instant, call["first"])
            begun = code.both(first, compared("!=", call["resumed"], code.integer(0)))
            with code.when(code.builder.not_(begun)):
                self._control(instant, forces)
            with code.when(compared("<", instant, call["end"])):
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
        pieces = code.builder.sdiv(code.plus(steps, turns - 1), code.integer(turns))
        with code.loop(0, pieces) as piece:
            first = code.product(piece, turns)
            last = code.least(code.plus(first, turns), steps)
            self._set("v", self._get("v") * self.units.time)
            self._steps(first, last, forces)
            self._set("v", [code.quotient(rate, self.units.time) for rate in self._get("v")])
            self._keep_angles(self._used_turns())

    def _steps(self, first: ir.Value, last: ir.Value, forces: np.ndarray | None) -> None:
        """Emit steps from the first to the one before the last."""
        code, units = self.code, self.units
        with code.fast_loop(first, last) as end:
            q_before, works = self._coordinates(), self._get("contacts")
            v, last_command = self._get("v"), self._get("last_command")
            if self.recipe.delay_steps is not None:
                reference, rising = self._next_reference(last_command, v * (1.0 / units.time))
                self._set("reference", reference)
                self._set("rising", rising)
                last_command = array(reference)
            step = Step(
                self.recipe.integrator,
                self.moving,
                last_command * units.command,
                None if forces is None else forces * units.force,
                self.dt / units.time,
                units.work,
                self.call_values["substeps"],
            )
            q, v, works, anchors = step.after(StepState(q_before, v, works, self._anchors()))
            self._set("q", q)
            self._set("v", v)
            self._set("contacts", works)
            if self.sizes.touching:
                self._set("anchors", anchors)
            used = self._used_turns()
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
        if not self.recipe.forces:
            return None
        since = self.code.most(instant, self.code.integer(0))
        row = self.code.builder.sdiv(since, self.call_values["force_interval"])
        forces = self._row(2, "force", row)("force")
        if not self.recipe.areas:
            return forces
        return self.plant.drag(self._coordinates(), self._get("v"), forces, self.recipe.areas)

    def _forces_before(self, instant: ir.Value) -> np.ndarray | None:
        if self.recipe.areas:
            return self._get("pushed")
        return self._forces(self.code.builder.sub(instant, self.code.integer(1)))

    def _control(self, instant: ir.Value, forces: np.ndarray | None) -> None:
        code, recipe = self.code, self.recipe
        q, v, before = self._coordinates(), self._get("v"), self._get("last_command")
        requested = command = self._controller_command(instant, q, v)
        effort = self.plant.within(command)
        if recipe.delay_steps is not None:
            assert self.plant.response is not None
            waiting = [*self._get("unheard"), *self.plant.response.heard(command)]
            self._set("unheard", waiting[self.sizes.m :])
            effort = array(waiting[: self.sizes.m])
        self._set("last_command", effort)
        if not (recipe.log or recipe.summary):
            return
        reactions = self.plant.ground_reactions(q, v, self._anchors())[0]
        if recipe.delay_steps is not None:
            if recipe.log:
                acted = self._forces_before(instant)
                before = self.plant.answer(q, v, self._get("reference"), acted, reactions)[1]
            next_reference = array(self._next_reference(effort, v)[0])
            _, effort, command, _ = self.plant.answer(q, v, next_reference, forces, reactions)
        if recipe.drive == "motion":
            acted = self._forces_before(instant)
            before = self.plant.answer(q, v, before, acted, reactions)[1]
            command = effort = self.plant.answer(q, v, command, forces, reactions)[1]
        buffer, cut = self.plant.stop_force(q, v), self._cut(requested)
        hoist = self.plant.topology.layout.drive_of("hoist")
        hoist_force = buffer if hoist is None else effort[hoist] + buffer
        conditions = self.plant.conditions(q, v, hoist_force, command)
        holds = code.both(*conditions, *(number < 0.5 for number in cut))
        if recipe.log:
            acts, energy = [*command, *effort, *before], self.plant.energy(q, v)
            contacts = [*self._get("contacts"), buffer]
            row = [*q, *v, *acts, energy, *contacts, *cut]
            if recipe.ledger:
                table = self._row(1, "setpoint_table", instant)
                pushes = [0.0] * size(self.sizes.force) if forces is None else forces
                outside = [0.0, *contacts, *(cut or [0.0])]
                row = [*table("position"), *q, *v, *acts, *pushes, *outside, energy]
                self._set("pushed", pushes)
                row = self._balanced(row, (q, v, effort, before), holds)
            self._log(instant, row)
        if recipe.summary:
            self._summarise(instant, q, v, effort, holds)

    def _next_reference(self, heard: np.ndarray, v: np.ndarray) -> tuple[list[Any], list[Any]]:
        """Return reference rates of converters after the next step, and their rates of change, m
        numbers each.
        """
        assert self.plant.response is not None
        rate = v[self.plant.topology.layout.drives]
        before = self._get("reference"), self._get("rising")
        return self.plant.response.ramped(heard, *before, rate, self.dt)

    def _cut(self, command: np.ndarray) -> list[Any]:
        """Return 1 where a command exceeds the largest rate of a converter, else 0; empty without
        converters.
        """
        if self.plant.response is None:
            return []
        beyond = self.code.either(*self.plant.response.cuts(map(self.code.value, command)))
        return [self.code.chosen(beyond, 1.0, 0.0)]

    def _controller_command(self, instant: ir.Value, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the command of the controller, shape (m,)."""
        code, sizes = self.code, self.sizes
        gains = self._row(0, "gain_table", instant)
        setpoints = self._row(1, "setpoint_table", instant)
        z = np.concatenate([q, v])
        if self.recipe.offset:
            z = z + self._row(3, "offset", instant)("reading")
        if self.recipe.delayed:
            z = self._delay_reading(instant, z)
        if self.recipe.programme is not None:
            from cranedyn.compiled.horizon.control import PredictiveControl

            addresses = (self.call_values[name] for name in ("horizon", "workspace"))
            control = PredictiveControl(code, self.recipe.programme, *addresses)
            row, due = control.count_instant()
            command_of = control.call_instant if code.lanes == 1 else control.command
            return command_of(z[: sizes.n], z[sizes.n :], setpoints("position"), row, due)
        gain = gains("gain").reshape(sizes.m, sizes.z)
        command = gains("feed_forward") - gain @ (z - setpoints("setpoint"))
        if not self.recipe.integral:
            return command
        integrals, position = self._get("integral"), setpoints("position")
        factor, limit = gains("integral_gain"), gains("limit")
        for i, drive in enumerate(self.plant.topology.layout.drives):
            error = position[i] - z[drive]
            command[i], integrals[i] = integrated_command(
                command[i], error, integrals[i], factor[i], limit[i], self.period
            )
        self._set("integral", integrals)
        return command

    def _delay_reading(self, instant: ir.Value, z: np.ndarray) -> np.ndarray:
        """Store the present reading and return the delayed one, shape (2 n,)."""
        code, build, readings = self.code, self.code.builder, self.call_values["readings"]

        def place(count: ir.Value, i: int) -> ir.Value:
            row = build.srem(count, self.call_values["reading_count"])
            return code.plus(code.product(row, self.sizes.z * code.stride), i * code.stride)

        for i, value in enumerate(z):
            code.store(value, readings, place(instant, i))
        lanes = range(code.lanes)
        delays = [code.load_one(self.call_values["delay"], lane, INTEGER) for lane in lanes]
        visible = [code.most(build.sub(instant, delay), code.integer(0)) for delay in delays]
        delayed = []
        for i in range(len(z)):
            places = [code.plus(place(visible[lane], i), lane) for lane in lanes]
            delayed.append(code.gather([code.address(readings, place) for place in places]))
        return array(delayed)

    def _log(self, instant: ir.Value, row: Sequence[Any]) -> None:
        code, build, interval = self.code, self.code.builder, self.call_values["log_interval"]
        whole_log = self.recipe.ledger  # has a row at each instant
        due = build.icmp_signed("==", build.srem(instant, interval), code.integer(0))
        with nullcontext() if whole_log else code.when(due):
            index = instant if whole_log else build.sdiv(instant, interval)
            first = code.product(index, len(row) * code.stride)
            begin = code.address(self.call_values["log"], first)
            for i, value in enumerate(row):
                code.store(value, begin, i * code.stride)

    def _balanced(self, row: list[Any], at: tuple[np.ndarray, ...], holds: ir.Value) -> list[Any]:
        """Return a row of the log of `simulate` with work, dissipation and validity, as
        `cranedyn.simulation.log.Log` computes them, and note the worst row.
        """
        code, drives, (q, v, effort, before) = self.code, self.plant.topology.layout.drives, at
        with code.as_written():
            power = self.plant.joint.dissipation(q, v)
            reached = q[drives] - v[drives] * (self.recipe.integrator.lead * self.dt)
            again, moved = self._get("again"), reached - self._get("reached")
            work = (self._get("acted") + before) / 2.0 * moved * again
            loss = (self._get("power") + power) / 2.0 * self.period * again
            self._set("work", self._get("work") + work)
            self._set("dissipated", self._get("dissipated") + loss)
        for name, values in (("reached", reached), ("acted", effort), ("power", [power])):
            self._set(name, values)
        self._set("again", [1.0])
        row = [*row, *self._get("work"), *self._get("dissipated")]
        checked = [*q, *row[self.sizes.m + self.sizes.z :]]  # setpoints are from a checked table
        fine = code.both(abs(_pairwise_sum(checked)) < np.inf, v @ v < DIVERGED**2)
        worst = code.chosen(fine, code.chosen(holds, 0.0, 1.0), 2.0)
        _largest(code, self.state["worst"][0], worst)
        return [*row, code.chosen(holds, 1.0, np.nan)]

    def _summarise(
        self, instant: ir.Value, q: np.ndarray, v: np.ndarray, effort: np.ndarray, holds: ir.Value
    ) -> None:
        code, crane, summary = self.code, self.plant, self.summary
        swing, amplitude = (code.value(square) for square in crane.swing(q, v))
        _largest(code, summary["peak"][0], swing)
        counts = code.builder.icmp_signed(">=", instant, self.call_values["residual_from"])
        with code.when(counts):
            _largest(code, summary["residual"][0], amplitude)
        for variable, value in zip(summary["effort"], effort, strict=True):
            _largest(code, variable, code.call("llvm.fabs", value))
        now = code.from_integer(instant)
        first = summary["invalid"][0]
        first.set(code.chosen(holds, first.get(), code.call("llvm.minnum", first.get(), now)))


def _largest(code: Code, variable: StackVariable, value: Value) -> None:
    """Keep the larger; what is not a number stays."""
    old = variable.get()
    variable.set(code.chosen(value <= old, old, value))


def _pairwise_sum(numbers: Sequence[Any]) -> Any:
    """Return a sum in which no term waits for all others."""
    half = len(numbers) // 2
    if not half:
        return numbers[0]
    return _pairwise_sum(numbers[:half]) + _pairwise_sum(numbers[half:])
